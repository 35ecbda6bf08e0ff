"""ddetumble: compare impact models with measurements, learn which physical effect is missing, add it.

The loop in three lines:

    from ddetumble import discover, read_campaign
    found = discover(read_campaign("data/impact-b"))
    print(found.sentence)

Symbols used throughout, SI units, pressures absolute (`physics.md`'s names):

================  =======================  ====================================================
symbol            name                     unit and meaning
================  =======================  ====================================================
delta             `depression`             m, how far the ball is squeezed along the normal
w                 `depression_rate`        m/s, > 0 while loading
b                 `contact_radius`         m, radius of the flat contact disc
D                 `outer_diameter`         m, ball before deformation
P0, P'            `initial_pressure`,      Pa, gas before and during contact
                  `pressure`
e, v1             `restitution`,           -, m/s, speed at first touch
                  `approach_speed`
m_eff             `effective_mass`         kg, felt along the normal at the contact point
F_n               `normal_force`           N
K, tan delta_L    `adhesion_constant`,     -, Eq. 8
                  `loss_factor`
s, u              `slip`, `slip_speed`     m, m/s, sliding displacement and speed in the contact plane
omega             `angular_velocity`       rad/s, of the debris, body components
q                 `attitude`               -, unit quaternion, scalar first, body to inertial
I                 `inertia`                kg m², about the centre of mass, body components
L                 `angular_momentum`       N m s, inertial components
================  =======================  ====================================================

Nothing heavy is imported until a name is used.
"""

import importlib
from typing import TYPE_CHECKING, Any


__version__ = "0.1.0"

_HOMES = {
    "Campaign": "measurement.campaign", "read_campaign": "measurement.package",
    "write_campaign": "measurement.package", "import_tests": "measurement.laboratory",
    "check_plausibility": "measurement.plausibility",
    "InputError": "_errors", "ComputationError": "_errors",
    "Ball": "contact.law", "PowerLaw": "contact.law", "ContactLaw": "contact.law",
    "RubberFriction": "contact.sliding", "CoulombFriction": "contact.sliding", "FrictionLaw": "contact.sliding",
    "AdhesionHysteresis": "contact.sliding", "Striker": "contact.gripping", "StrikeLaw": "contact.gripping",
    "coast": "dynamics.free_motion", "tumble": "dynamics.tumbling", "Tumble": "dynamics.rigid",
    "measure_energy": "dynamics.rigid", "measure_momentum": "dynamics.rigid", "trace_point": "dynamics.rigid",
    "measure_nutation": "dynamics.angles", "measure_precession": "dynamics.angles", "measure_spin": "dynamics.angles",
    "to_euler_angles": "dynamics.angles", "from_euler_angles": "dynamics.angles",
    "Cylinder": "dynamics.bodies", "HollowCylinder": "dynamics.bodies", "Box": "dynamics.bodies",
    "Sphere": "dynamics.bodies", "Mesh": "dynamics.bodies", "read_mesh": "dynamics.bodies",
    "collide": "dynamics.collision", "Debris": "dynamics.surfaces", "make_debris": "dynamics.surfaces",
    "plan_strike": "planning.strike_plan", "plan_sequence": "planning.sequence",
    "plan_together": "planning.chain",
    "draw_laws": "planning.draws", "plan_robust_strike": "planning.risk", "assess_plan": "planning.ambiguity",
    "assess_sequence": "planning.prospect",
    "strike": "dynamics.strike", "slide": "dynamics.slide", "check_effect": "contact.contract", "catalogue": "effects",
    "simulate": "dynamics.impact", "resolve_model": "inference.archive", "fit": "inference.estimation",
    "compare": "selection.compare", "identify": "reconstruct.force", "discover": "selection.discover",
    "draw_missing_force": "selection.missing.missing_force",
    "fit_slip_curve": "inference.curve_models", "fit_slip_polynomials": "inference.curve_models",
    "fit_rubber": "inference.curve_models", "SlipRecord": "inference.curve_models", "fit_curve": "inference.curve_fit",
    "sample": "posterior.sampling", "pose_fit": "posterior.target", "pose_curve": "posterior.target",
    "weigh": "posterior.stacking",
    "SelectionSettings": "selection.settings", "OutlierSettings": "selection.settings",
    "BaselineSettings": "selection.settings",
    "predict": "selection.predict", "predict_pulses": "selection.pulses",
    "design": "planning.nexttest", "map_effects": "planning.visibility",
    "write_report": "report", "describe": "report",
    "Exam": "exam.drawing", "examine": "exam.examination", "write_scorecard": "exam.scorecard",
    "write_paper": "paper", "run_demo": "demo", "find_data": "_settings",
}

__all__ = ["__version__", *sorted(_HOMES)]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its home when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'ddetumble' has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return list(__all__)


if TYPE_CHECKING:
    from ._errors import ComputationError as ComputationError
    from ._errors import InputError as InputError
    from ._settings import find_data as find_data
    from .contact.contract import check_effect as check_effect
    from .contact.gripping import StrikeLaw as StrikeLaw
    from .contact.gripping import Striker as Striker
    from .contact.law import Ball as Ball
    from .contact.law import ContactLaw as ContactLaw
    from .contact.law import PowerLaw as PowerLaw
    from .contact.sliding import AdhesionHysteresis as AdhesionHysteresis
    from .contact.sliding import CoulombFriction as CoulombFriction
    from .contact.sliding import FrictionLaw as FrictionLaw
    from .contact.sliding import RubberFriction as RubberFriction
    from .demo import run_demo as run_demo
    from .dynamics.angles import from_euler_angles as from_euler_angles
    from .dynamics.angles import measure_nutation as measure_nutation
    from .dynamics.angles import measure_precession as measure_precession
    from .dynamics.angles import measure_spin as measure_spin
    from .dynamics.angles import to_euler_angles as to_euler_angles
    from .dynamics.bodies import Box as Box
    from .dynamics.bodies import Cylinder as Cylinder
    from .dynamics.bodies import HollowCylinder as HollowCylinder
    from .dynamics.bodies import Mesh as Mesh
    from .dynamics.bodies import Sphere as Sphere
    from .dynamics.bodies import read_mesh as read_mesh
    from .dynamics.collision import collide as collide
    from .dynamics.free_motion import coast as coast
    from .dynamics.impact import simulate as simulate
    from .dynamics.rigid import Tumble as Tumble
    from .dynamics.rigid import measure_energy as measure_energy
    from .dynamics.rigid import measure_momentum as measure_momentum
    from .dynamics.rigid import trace_point as trace_point
    from .dynamics.slide import slide as slide
    from .dynamics.strike import strike as strike
    from .dynamics.surfaces import Debris as Debris
    from .dynamics.surfaces import make_debris as make_debris
    from .dynamics.tumbling import tumble as tumble
    from .effects import catalogue as catalogue
    from .exam.drawing import Exam as Exam
    from .exam.examination import examine as examine
    from .exam.scorecard import write_scorecard as write_scorecard
    from .inference.archive import resolve_model as resolve_model
    from .inference.curve_fit import fit_curve as fit_curve
    from .inference.curve_models import SlipRecord as SlipRecord
    from .inference.curve_models import fit_rubber as fit_rubber
    from .inference.curve_models import fit_slip_curve as fit_slip_curve
    from .inference.curve_models import fit_slip_polynomials as fit_slip_polynomials
    from .inference.estimation import fit as fit
    from .measurement.campaign import Campaign as Campaign
    from .measurement.laboratory import import_tests as import_tests
    from .measurement.package import read_campaign as read_campaign
    from .measurement.package import write_campaign as write_campaign
    from .measurement.plausibility import check_plausibility as check_plausibility
    from .paper import write_paper as write_paper
    from .planning.ambiguity import assess_plan as assess_plan
    from .planning.chain import plan_together as plan_together
    from .planning.draws import draw_laws as draw_laws
    from .planning.nexttest import design as design
    from .planning.prospect import assess_sequence as assess_sequence
    from .planning.risk import plan_robust_strike as plan_robust_strike
    from .planning.sequence import plan_sequence as plan_sequence
    from .planning.strike_plan import plan_strike as plan_strike
    from .planning.visibility import map_effects as map_effects
    from .posterior.sampling import sample as sample
    from .posterior.stacking import weigh as weigh
    from .posterior.target import pose_curve as pose_curve
    from .posterior.target import pose_fit as pose_fit
    from .reconstruct.force import identify as identify
    from .report import describe as describe
    from .report import write_report as write_report
    from .selection.compare import compare as compare
    from .selection.discover import discover as discover
    from .selection.missing.missing_force import draw_missing_force as draw_missing_force
    from .selection.predict import predict as predict
    from .selection.pulses import predict_pulses as predict_pulses
    from .selection.settings import BaselineSettings as BaselineSettings
    from .selection.settings import OutlierSettings as OutlierSettings
    from .selection.settings import SelectionSettings as SelectionSettings
