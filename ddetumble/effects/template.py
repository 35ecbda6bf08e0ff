"""A file to begin an effect of one's own with: ten lines that already work, and the test of their contract."""

import dataclasses as dc
import keyword
import re
from pathlib import Path

from .._errors import InputError


@dc.dataclass(frozen=True)
class Stage:
    """Where an effect acts, and a plain law to begin with.

    Attributes:
        base: class to derive from, of `home`.
        home: module of `ddetumble.contact`.
        method: that gives the law, with its arguments.
        unit: of the amplitude k.
        typical: size of k that shows in a record.
        law: in one line.
        code: the same in Python.
        does: what the method returns, with its unit.
        order: whether the class has to say when it acts among its like.
    """

    base: str
    home: str
    method: str
    unit: str
    typical: float
    law: str
    code: str
    does: str
    order: bool = False


STAGES: dict[str, Stage] = {
    "elastic": Stage("AbstractElasticEffect", "effect", "force(self, contact)", "N/m", 2e3,
                     "F_k gains k delta", "self.k * contact.depression", "Increment of the elastic force [N]"),
    "contact": Stage("AbstractContactForce", "effect", "force(self, contact)", "N s/m", 20.0, "F gains k w",
                     "self.k * contact.depression_rate", "Increment of the contact force, before its clamp [N]"),
    "surface": Stage("AbstractSurfaceForce", "effect", "force(self, contact)", "Pa", -1e3,
                     "F_n gains k pi b^2", "self.k * contact.contact_area",
                     "Increment of the contact force, after its clamp [N]"),
    "stiffness": Stage("AbstractStiffnessEffect", "effect", "factor(self, contact)", "1/m", 10.0,
                       "F_k times 1 + k delta", "1.0 + self.k * contact.depression", "Factor on the elastic force [-]"),
    "gas": Stage("AbstractGasEffect", "effect", "pressure_factor(self, contact)", "1/s", 2.0,
                 "P' times 1 + k t", "1.0 + self.k * contact.time", "Factor on the gas pressure [-]"),
    "geometry": Stage("AbstractGeometryEffect", "effect", "contact_radius(self, contact)", "", 0.1,
                      "b gains k delta", "self.k * contact.depression", "Increment of the contact radius [m]"),
    "size": Stage("AbstractSizeEffect", "effect", "growth(self, contact)", "1/Pa", 2e-8, "D times 1 + k P0",
                  "self.k * contact.initial_pressure", "Relative growth of the diameter [-]"),
    "drive": Stage("AbstractDriveEffect", "effect", "force(self, contact)", "N", 2.0, "arm pushes with k",
                   "self.k", "Force towards the plate [N]"),
    "restitution": Stage("AbstractRestitutionEffect", "effect", "factor(self, contact)", "s/m", 0.1,
                         "e times 1 - k v1", "1.0 - self.k * contact.approach_speed",
                         "Factor on the coefficient of restitution [-]"),
    "sensor": Stage("AbstractSensorEffect", "effect", "reading(self, force)", "1/N", 1e-4,
                    "reading = F (1 + k F)", "force.map(lambda f: f * (1.0 + self.k * f))",
                    "Reading of the gauge [N]", True),
    "rubber": Stage("AbstractRubberEffect", "sliding", "factor(self, slide)", "s/m", 0.5,
                    "Eq. 8 part times 1 + k u", "1.0 + self.k * slide.slip_speed", "Factor on the Eq. 8 part [-]"),
    "load": Stage("AbstractLoadEffect", "sliding", "factor(self, slide)", "1/N", 1e-3, "mu times 1 + k F_n",
                  "1.0 + self.k * slide.normal_load", "Factor on the whole coefficient [-]"),
    "friction": Stage("AbstractFrictionForce", "sliding", "force(self, slide)", "N/m", 20.0, "F_t gains k s",
                      "self.k * slide.slip", "Increment of the friction force, against the motion [N]"),
    "compliance": Stage("AbstractComplianceEffect", "gripping", "compliance_at(self, patch)", "m/N", 2e-5,
                        "tangential compliance gains k", "self.k", "Tangential compliance [m/N]"),
    "reaction": Stage("AbstractReactionEffect", "gripping", "offset_at(self, patch)", "", 0.02,
                      "normal force acts k b ahead", "self.k * patch.contact_radius",
                      "How far ahead the normal force acts [m]"),
    "torque": Stage("AbstractTorque", "torque", "torque(self, spin)", "1/s", 1e-5,
                    "torque over transverse inertia = -k omega", "-self.k * spin.angular_velocity",
                    "Torque over the transverse inertia, body components [1/s²]"),
    "gyroscope": Stage("AbstractGyroEffect", "torque", "reading(self, angular_velocity, time)", "1/s", 1e-6,
                       "reading = omega (1 + k t)", "angular_velocity * (1.0 + self.k * time[:, None])",
                       "Rates as the gyroscopes read them [rad/s]", True),
}


def write_template(name: str, stage: str = "elastic", folder: Path | str = ".") -> tuple[Path, Path]:
    """Write `NAME.py`, an effect that works, and `test_NAME.py`, which proves its contract.

    Args:
        name: id of the effect, such as `rim-stop`.
        stage: where it acts, a key of `STAGES`.
        folder: for the two files.

    Returns:
        Their paths.

    Raises:
        InputError: The name is none or taken, there is no such stage, or a file is there already.
    """
    from . import CATALOGUE

    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"{name!r} is no name for an effect: lower-case words with hyphens, such as rim-stop")
    if any(name == effect.id for effect in CATALOGUE):
        raise InputError(f"the catalogue has an effect {name!r} already; choose another name")
    if stage not in STAGES:
        raise InputError(f"there is no stage {stage!r}; there are {', '.join(STAGES)}")
    module = name.replace("-", "_")
    if keyword.iskeyword(module):
        raise InputError(f"{name!r} is a word of Python's own; choose another name")
    kind = "".join(word.capitalize() for word in name.split("-"))
    paths = Path(folder) / f"{module}.py", Path(folder) / f"test_{module}.py"
    for path in paths:
        if path.exists():
            raise InputError("is there already; nothing was written", file=path)
    paths[0].parent.mkdir(parents=True, exist_ok=True)
    for path, text in zip(paths, (_write_effect(name, kind, STAGES[stage]), _write_test(module, kind)), strict=True):
        draft = path.with_name(f".{path.name}.part")
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    return paths


def _write_effect(name: str, kind: str, at: Stage) -> str:
    unit = f'"{at.unit}"'
    order = "    order: ClassVar[int] = 9  # after those of the catalogue\n" if at.order else ""
    signs = {"AbstractComplianceEffect": ", sign=1, singular=True", "AbstractRestitutionEffect": ", sign=1"}
    more = signs.get(at.base, "")
    return f'''"""{name}: say here what it is. Fields that the law may read: help(ddetumble.contact.{at.home})."""

from typing import ClassVar

from ddetumble.effects import {at.base}, parameter


class {kind}({at.base}):
    """{at.law}."""

    # Where physics sets limits, state them: limits=(0.0, 1e6), limits_reason="why". No value beyond them is an
    # explanation for `ddetumble discover`.
    k: float = parameter({unit}, 0.0, typical={abs(at.typical):g}{more}, starts=({at.typical:g},), text="its size")
    id: ClassVar[str] = "{name}"
    law: ClassVar[str] = "{at.law}"
    reference: ClassVar[str] = "own; say where the law comes from"
{order}
    def {at.method}:
        """{at.does}."""
        return {at.code}
'''


def _write_test(module: str, kind: str) -> str:
    return f'''"""The contract of {kind}: units, gradients, absent at its null, batches, one compilation."""

from {module} import {kind}

from ddetumble import check_effect


def test_contract():
    """Every clause holds."""
    check_effect({kind}).require()
'''
