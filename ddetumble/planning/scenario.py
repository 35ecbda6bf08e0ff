"""`SCENARIO.toml` of `ddetumble plan`: what is struck, how it moves, what arm and ball can do, what is wanted.

`planning.tables.Scenario` has every key.
"""

import dataclasses as dc
import tomllib
from pathlib import Path
from typing import Any, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pydantic

from .._errors import InputError
from .._numerics import scalar
from .._rotation import rotate_back
from .._settings import name_folder
from ..contact.effect import parameters_of
from ..contact.friction import DIVERGES_ABOVE
from ..contact.gripping import StrikeLaw, Striker
from ..contact.law import Ball, ContactLaw
from ..contact.sliding import AbstractFriction, CoulombFriction, FrictionLaw, RubberFriction
from ..dynamics.bodies import AbstractBody, Box, Cylinder, Sphere, read_mesh
from ..dynamics.surfaces import Debris, make_debris
from ..inference.archive import load
from ..inference.models import is_fitted
from .draws import Laws, draw_laws, find_models, vary_law
from .strike_problem import Goal, Limits, Problem, make_problem
from .tables import SCHEMA, DebrisTable, Scenario


CLAMPED = 1e9  # kg, rolling mass of a ball that its mount keeps from turning
# What effects may require that the impact itself provides.
GIVEN = ("initial_pressure", "approach_speed", "tangential_speed", "tangential", "slip_speed", "internal_pressure")


def read_scenario(path) -> Scenario:
    """Read a scenario.

    Raises:
        InputError: It is not there, no TOML, or says something that is not understood; the key is named.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise InputError("there is no such file", file=path) from None
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror or error})", file=path) from None
    except UnicodeDecodeError:
        raise InputError("the file is not text in UTF-8", file=path) from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"this is no TOML file: {error}", file=path) from None
    if content.get("schema") != SCHEMA:
        raise InputError(f"the schema has to be {SCHEMA!r}; it is {content.get('schema')!r}", file=path,
                         key="schema")
    try:
        return Scenario.model_validate(content)
    except pydantic.ValidationError as error:
        first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")  # why others may be missing
        place = ".".join(str(part) for part in first["loc"]) or "scenario"
        problem = first["msg"].removeprefix("Value error, ")[:200]
        if first["type"] == "extra_forbidden":
            problem = f"this is not a key here; there are {', '.join(_list_keys(first['loc'][:-1]))}"
        raise InputError(problem, file=path, key=place) from None


def _list_keys(place: tuple) -> list[str]:
    """Keys that the table at a place of the scenario may have."""
    table: type[pydantic.BaseModel] = Scenario
    for part in place:
        if part in table.model_fields:  # else the name of one of many alike
            kinds = (table.model_fields[part].annotation, *get_args(table.model_fields[part].annotation))
            table = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel)),
                         table)
    return [field.alias or name for name, field in table.model_fields.items()]


def make_body(table: DebrisTable, here: Path) -> AbstractBody:
    """The body of a scenario."""
    if table.shape == "box":
        return Box(table.mass, np.asarray(table.lengths, dtype=float))
    if table.shape == "sphere":
        return Sphere(table.mass, table.radius)
    if table.shape == "mesh":
        return read_mesh(here / table.file, table.mass, table.scale)
    return Cylinder(table.mass, table.radius, table.length)


def _load_law(name: str, here: Path, key: str) -> Any:
    folder = here / name
    if not is_fitted(str(folder)):
        raise InputError(f"{name} is no folder that fit or discover wrote", key=key)
    return load(folder).law()


def make_law(scenario: Scenario, here: Path) -> StrikeLaw:
    """The contact law of a scenario: fitted models with their effects, or the paper's ball with constant friction.

    Raises:
        InputError: A folder holds no fit, or one of another family.
    """
    ball = scenario.ball
    fitted = _load_law(ball.model, here, "ball.model") if ball.model else None
    if fitted is not None and not isinstance(fitted, (ContactLaw, StrikeLaw)):
        raise InputError("the model has to be one of impacts or of oblique impacts", key="ball.model")
    rubbed = _load_law(ball.friction_model, here, "ball.friction_model") if ball.friction_model else None
    if rubbed is not None and not isinstance(rubbed, FrictionLaw):
        raise InputError("the model has to be one of slip records", key="ball.friction_model")
    return mount_law(scenario, fitted, rubbed)


def mount_law(scenario: Scenario, fitted: ContactLaw | StrikeLaw | None, rubbed: FrictionLaw | None) -> StrikeLaw:
    """The law of a scenario's ball on its arm; may be traced.

    Args:
        scenario: what was read.
        fitted: of impacts; the paper's ball where there is none.
        rubbed: of friction, in place of `fitted`'s own; constant friction where neither has one.

    Raises:
        InputError: The contact model has no mass that the arm could set, or an effect reads what is not given.
    """
    ball, arm = scenario.ball, scenario.arm
    normal: Any = ContactLaw(Ball(restitution=scalar(ball.restitution)))
    friction: Any = FrictionLaw(CoulombFriction(scalar(ball.friction)))
    own: tuple[Any, ...] = ()
    striker: Striker | None = None
    if isinstance(fitted, StrikeLaw):
        striker, own, normal, friction = fitted.reference, fitted.effects, fitted.normal, fitted.friction
    elif fitted is not None:
        normal, own = fitted, tuple(fitted.effects)
    if rubbed is not None:
        friction, own = rubbed, (*own, *rubbed.effects)
        striker = None
    reference = normal.reference
    mass = reference.inertia() if arm.mass is None else scalar(arm.mass)
    across = scalar(arm.tangential_mass) if arm.tangential_mass else (
        striker.tangential_mass if striker and arm.mass is None else mass)
    if arm.mass is not None:
        if "effective_mass" not in {one.name for one in parameters_of(reference)}:
            raise InputError("this contact model has no effective_mass; leave it out", key="arm.mass")
        reference = eqx.tree_at(lambda one: one.effective_mass, reference, scalar(arm.mass))
    assert isinstance(friction.reference, AbstractFriction)
    if isinstance(friction.reference, RubberFriction):
        raise InputError("the slip term of Eqs. 9 and 10 grows without limit at the loads of an impact (above "
                         f"{DIVERGES_ABOVE:.1f} N); fit the slip records with --model eq8 or coulomb",
                         key="ball.friction_model")
    given = {*reference.provides, *friction.reference.provides, *GIVEN, *ball.conditions}
    condition = getattr(reference, "condition", "")
    if condition and condition not in given:
        raise InputError(f"the fitted power law reads {condition!r}: give its value there, such as "
                         f"conditions = {{ {condition} = 1 }}", key="ball.conditions")
    for effect in own:
        for name in effect.requires:
            if name not in given:
                raise InputError(f"the effect {effect.id} reads {name!r}: give its value there, such as "
                                 f"conditions = {{ {name} = 1 }}", key="ball.conditions")
    rolling = CLAMPED if arm.clamped else striker.rolling_mass if striker else 0.5
    creep = {} if striker is None else {"creep_speed": striker.creep_speed}
    return Striker(reference, friction.reference, tangential_mass=scalar(across), rolling_mass=scalar(rolling),
                   **creep).extend(own)


def pose_laws(scenario: Scenario, here: Path) -> Laws | None:
    """Draws of a scenario's contact law; None where it says nothing of its uncertainty.

    A mass that the arm sets is the same in all draws.

    Raises:
        InputError: As of `make_law` and `draw_laws`; nothing says how uncertain the contact is.
    """
    table, ball = scenario.uncertainty, scenario.ball
    if table is None:
        return None
    if table.parameters:
        law = make_law(scenario, here)
        if scenario.arm.mass is not None and "effective_mass" in table.parameters:
            raise InputError("the arm's mass is given as known; leave one of the two out",
                             key="uncertainty.parameters.effective_mass")
        stated = {name: (None if one.mean is None else float(one.mean), float(one.sd))
                  for name, one in table.parameters.items()}
        return vary_law(law, stated, table.correlation, draws=table.draws, seed=scenario.seed)
    name = table.fit or ball.model or ball.friction_model
    if not name:
        raise InputError("nothing says how uncertain the contact is: name a fit, or give parameters with their sd",
                         key="uncertainty")
    folder = here / name
    folder = folder.parent if folder.suffix == ".json" else folder
    if not is_fitted(str(folder)):
        raise InputError(f"{name} is no folder that fit, sample, discover or average wrote", key="uncertainty.fit")
    models, note = find_models(folder)
    family = models[0][1].space.family
    if not (family.has_contact or family.has_strokes):
        raise InputError("the fit has to be one of impacts or of slip records", key="uncertainty.fit")
    slips = family.has_strokes
    taken = ball.friction_model if slips else ball.model
    if taken and (here / taken).resolve() != folder.resolve():
        raise InputError(f"the ball's model is {taken} and the fit {name}; name one of them", key="uncertainty.fit")
    other = ball.model if slips else ball.friction_model
    beside = _load_law(other, here, "ball.model" if slips else "ball.friction_model") if other else None

    def make(law):
        return mount_law(scenario, *((beside, law) if slips else (law, beside)))

    laws = draw_laws(models, make, draws=table.draws, seed=scenario.seed, note=note)
    return dc.replace(laws, folder=name_folder(folder))


def pose_problem(scenario: Scenario, here: Path, laws: Laws | None = None) -> Problem:
    """The problem of a scenario's first impact.

    Args:
        scenario: what was read.
        here: the file's folder.
        laws: of `pose_laws`, whose best estimate is then the contact law.
    """
    debris: Debris = make_debris(make_body(scenario.debris, here))
    attitude = np.asarray(scenario.debris.attitude, dtype=float)
    attitude = attitude / np.linalg.norm(attitude)
    if scenario.debris.angular_velocity is not None:
        rates = np.asarray(scenario.debris.angular_velocity, dtype=float)
    else:
        momentum = jnp.asarray(scenario.debris.angular_momentum, dtype=float)
        rates = np.linalg.solve(np.asarray(debris.inertia), np.asarray(rotate_back(jnp.asarray(attitude), momentum)))
    arm, limits, goal = scenario.arm, scenario.limits, scenario.goal
    chaser = np.asarray(arm.chaser, dtype=float)
    if not np.any(chaser):
        raise InputError("the direction to the chaser must not be zero", key="arm.chaser")
    allowed = Limits(
        speed=arm.speed, approach=limits.approach, force=limits.force, depression=limits.depression, edge=limits.edge,
        pressure=np.asarray(limits.pressure), window=np.asarray(limits.window),
        chaser=chaser / np.linalg.norm(chaser), cone=np.radians(arm.cone_degrees), clearance=arm.clearance_time)
    law = make_law(scenario, here) if laws is None else laws.main
    conditions = {name: scalar(value) for name, value in scenario.ball.conditions.items()}
    return make_problem(law, debris, attitude, rates, allowed, Goal(goal.momentum, goal.energy, goal.nutation),
                        conditions)
