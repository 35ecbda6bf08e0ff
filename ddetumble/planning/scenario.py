"""What a scenario stands for: its body, the contact law of its ball on its arm, and the problem of the first impact."""

import dataclasses as dc
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError, error_place
from .._numerics import scalar
from .._rotation import rotate_back
from .._settings import name_folder
from .._user_files import require_trust, run_file, split_name
from ..contact.effect import parameters_of
from ..contact.friction import DIVERGES_ABOVE
from ..contact.gripping import StrikeLaw, Striker
from ..contact.law import Ball, ContactLaw
from ..contact.sliding import AbstractFriction, CoulombFriction, FrictionLaw
from ..dynamics.bodies import AbstractBody, Box, Cylinder, Sphere, read_mesh
from ..dynamics.surfaces import make_debris
from ..inference.archive import load
from ..inference.models import is_fitted
from .draws import Laws, Named, draw_laws, find_models, pair_laws, vary_law
from .problem import Goal, Limits, StrikeProblem
from .scenario_file import OF_A_FIT, BallTable, DebrisTable, Scenario, check_faces
from .surroundings import surround


# Kg, rolling mass of a ball that its mount keeps from turning: 1e9 times a ball's own, so that it stays still.
CLAMPED = 1e9
# What effects may require that the impact itself provides.
GIVEN = ("initial_pressure", "approach_speed", "tangential_speed", "tangential", "slip_speed", "internal_pressure")


def make_body(table: DebrisTable, here: Path) -> AbstractBody:
    """The body of a scenario; a mesh is read from the scenario's folder on."""
    if table.shape == "mesh":
        return read_mesh(here / table.file, table.mass, table.scale)
    if table.shape == "box":
        return Box(table.mass, np.asarray(table.lengths, dtype=float))
    return Sphere(table.mass, table.radius) if table.shape == "sphere" else Cylinder(
        table.mass, table.radius, table.length)


def _load_law(name: str, here: Path, key: str, kinds: tuple[type, ...], what: str) -> Any:
    """The law of a folder that a scenario names; None where it names none."""
    if not name:
        return None
    if not is_fitted(str(here / name)):
        raise InputError(f"{name} is not a folder that fit or discover wrote", key=key)
    law = load(here / name).law()
    if not isinstance(law, kinds):
        raise InputError(f"the model must be one of {what}", key=key)
    return law


def load_laws(ball: BallTable, here: Path) -> tuple[ContactLaw | StrikeLaw | None, FrictionLaw | None]:
    """The fitted contact and the fitted friction that a scenario's ball names.

    Raises:
        InputError: A folder holds no fit, or one of another family.
    """
    return (_load_law(ball.model, here, "ball.model", (ContactLaw, StrikeLaw), "impacts or of oblique impacts"),
            _load_law(ball.friction_model, here, "ball.friction_model", (FrictionLaw,), "slip records"))


def mount_law(scenario: Scenario, fitted: ContactLaw | StrikeLaw | None, rubbed: FrictionLaw | None) -> StrikeLaw:
    """The law of a scenario's ball on its arm, may be traced: of a fitted contact, the paper's ball where there is
    none, and a fitted friction in place of the contact's own, constant friction where neither has one.

    Raises:
        InputError: The contact model has no mass that the arm could set, or an effect reads what is not given.
    """
    ball, arm = scenario.ball, scenario.arm
    normal: Any = ContactLaw(Ball(restitution=scalar(ball.restitution), outer_diameter=scalar(ball.outer_diameter)))
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
    own = surround(own, float(ball.ambient_pressure))
    reference = normal.reference
    mass = reference.inertia() if arm.mass is None else scalar(arm.mass)
    across = scalar(arm.tangential_mass) if arm.tangential_mass else (
        striker.tangential_mass if striker and arm.mass is None else mass)
    if arm.mass is not None:
        if "effective_mass" not in {one.name for one in parameters_of(reference)}:
            raise InputError("this contact model has no effective_mass; leave it out", key="arm.mass")
        reference = eqx.tree_at(lambda one: one.effective_mass, reference, scalar(arm.mass))
    assert isinstance(friction.reference, AbstractFriction)
    _, highest = friction.reference.valid.get("normal_load", (0.0, math.inf))
    if float(scenario.limits.force) > highest:
        raise InputError(f"the slip term of Eqs. 9 and 10 grows without limit above {DIVERGES_ABOVE:.1f} N, but "
                         f"limits.force lets an impact reach {float(scenario.limits.force):g} N; state limits.force = "
                         f"\"{highest:g} N\" or less, or fit the slip records with --model eq8 or coulomb",
                         key="limits.force")
    given = {*reference.provides, *friction.reference.provides, *GIVEN, *ball.conditions}
    power = getattr(reference, "condition", "")
    read = [("the fitted power law", power)] if power else []
    for what, name in [*read, *((f"the effect {effect.id}", name) for effect in own for name in effect.requires)]:
        if name not in given:
            raise InputError(f"{what} reads {name!r}: give its value here, such as conditions = {{ {name} = 1 }}",
                             key="ball.conditions")
    rolling = CLAMPED if arm.clamped else striker.rolling_mass if striker else 0.5
    creep = {} if striker is None else {"creep_speed": striker.creep_speed}
    return Striker(reference, friction.reference, tangential_mass=scalar(across), rolling_mass=scalar(rolling),
                   **creep).extend(own)


def pose_laws(scenario: Scenario, here: Path) -> Laws | None:
    """Draws of a scenario's contact law; None where it says nothing of its uncertainty.

    A mass that the arm sets is the same in all draws.

    Raises:
        InputError: As of `load_laws` and `draw_laws`; nothing says how uncertain the contact is.
    """
    table, ball = scenario.uncertainty, scenario.ball
    if table is None:
        return None
    if table.parameters:
        law = mount_law(scenario, *load_laws(scenario.ball, here))
        if scenario.arm.mass is not None and "effective_mass" in table.parameters:
            raise InputError("arm.mass gives this as known; leave out one of the two",
                             key="uncertainty.parameters.effective_mass")
        stated = {name: (None if one.mean is None else float(one.mean), float(one.sd))
                  for name, one in table.parameters.items()}
        return vary_law(law, stated, table.correlation, draws=table.draws, seed=scenario.seed)
    fits: dict[str, tuple[str, Path, Named, str]] = {}  # by the key of the ball that they stand for
    for name in table.fit or tuple(filter(None, (ball.model, ball.friction_model))):
        folder = here / name
        folder = folder.parent if folder.suffix == ".json" else folder
        if not is_fitted(str(folder)):
            raise InputError(f"{name} is not a folder that fit, sample, discover or average wrote",
                             key="uncertainty.fit")
        models, note = find_models(folder)
        family = models[0][1].space.family
        if not (family.has_contact or family.has_strokes):
            raise InputError("the fit must be one of impacts or of slip records", key="uncertainty.fit")
        if not family.has_strokes and "outer_diameter" in ball.model_fields_set:
            raise InputError(OF_A_FIT, key="ball.outer_diameter")
        own = "friction_model" if family.has_strokes else "model"
        what, taken = "friction" if family.has_strokes else "ball", getattr(ball, own)
        if own in fits:
            raise InputError(f"{fits[own][0]} and {name} are both fits of the {what}; name one of the ball and one of "
                             "its friction", key="uncertainty.fit")
        if taken and (here / taken).resolve() != folder.resolve():
            raise InputError(f"the fit of the {what} is {name} here but {taken} in ball.{own}; name one of them",
                             key="uncertainty.fit")
        fits[own] = name, folder, models, note
    if not fits:
        raise InputError("the uncertainty of the contact is not given: name a fit, or give parameters with their sd",
                         key="uncertainty")
    fitted, rubbed = load_laws(ball.model_copy(update=dict.fromkeys(fits, "")), here)

    def draw(own: str, make: Callable[[Any], Any]) -> Laws:
        _, folder, models, note = fits[own]
        laws = draw_laws(models, make, draws=table.draws, seed=scenario.seed, note=note, name=folder.name)
        return dc.replace(laws, folder=name_folder(folder))

    if len(fits) == 2:
        laws = pair_laws(draw("model", lambda law: law), draw("friction_model", lambda law: law),
                         partial(mount_law, scenario), seed=scenario.seed)
    elif "model" in fits:
        laws = draw("model", lambda law: mount_law(scenario, law, rubbed))
    else:
        laws = draw("friction_model", lambda law: mount_law(scenario, fitted, law))
    # A fit of oblique impacts brings its friction, unless another one is named.
    struck = fits["model"][2][0][1].law() if "model" in fits else fitted
    whole = isinstance(struck, StrikeLaw) and not ball.friction_model and "friction_model" not in fits
    words = {"model": "the ball and its friction"} if whole else {"model": "the ball", "friction_model": "the friction"}
    for own in words:
        name = fits[own][1].name if own in fits else Path(getattr(ball, own)).name
        words[own] += f" ({name})" if name else ""
    return dc.replace(laws, drawn=tuple(one for own, one in words.items() if own in fits),
                      held=tuple(one for own, one in words.items() if own not in fits))


def _find_faces(wanted: tuple[str, ...], names: tuple[str, ...]) -> np.ndarray:
    """Which faces are wanted, shape (faces,)."""
    check_faces(wanted, names)
    return np.isin(names, wanted)


def _load_function(name: str, here: Path) -> Callable:
    """A function of the user's own, `FILE.py:NAME` from the scenario's folder on."""
    own = split_name(name)
    if own is None:
        raise InputError(f"{name!r} is not of the form FILE.py:NAME", key="goal.function")
    with error_place(key="goal.function"):
        require_trust(here / own[0])
    found = getattr(run_file(here / own[0]), own[1], None)
    if not callable(found):
        raise InputError(f"{own[0].name} has no function {own[1]!r}", key="goal.function")
    return found


def _check_function(function: Callable, name: str, rates: np.ndarray, inertia) -> None:
    """Refuse a goal of the user's own that fails, or gives no positive number with a gradient, before it is planned by.

    It is tried at the motion before the first impact.
    """
    try:
        value, slope = jax.value_and_grad(lambda turning: function(turning, inertia))(jnp.asarray(rates))
        value, slope = float(value), np.asarray(slope)
    except Exception as error:
        raise InputError(f"{name} fails at the motion before the first impact ({type(error).__name__}: "
                         f"{str(error).splitlines()[0] if str(error) else 'without a message'}); it is called with the "
                         "angular velocity, shape (3,), and the tensor of inertia, and returns a number, in JAX",
                         key="goal.function") from None
    if not (value > 0.0 and math.isfinite(value) and np.all(np.isfinite(slope))):
        what = f"is {value:.4g}" if not (value > 0.0 and math.isfinite(value)) else "has no finite gradient"
        raise InputError(f"{name} {what} at the motion before the first impact, where it has to be a positive, "
                         "differentiable number", key="goal.function")


def pose_problem(scenario: Scenario, here: Path, laws: Laws | None = None) -> StrikeProblem:
    """The problem of a scenario's first impact, in the folder `here`; the best estimate of `laws` is the contact law
    where they are given.
    """
    table, arm, goal = scenario.debris, scenario.arm, scenario.goal
    try:
        debris = make_debris(make_body(table, here), table.inertia, table.centre)
    except InputError as error:
        key = "debris.inertia" if "inertia" in error.problem else "debris.centre"
        raise (error if error.key or table.inertia is None else InputError(error.problem, key=key)) from None
    attitude = np.asarray(table.attitude, dtype=float)
    attitude = attitude / np.linalg.norm(attitude)
    if table.angular_velocity is not None:
        rates = np.asarray(table.angular_velocity, dtype=float)
    else:
        momentum = rotate_back(jnp.asarray(attitude), jnp.asarray(table.angular_momentum, dtype=float))
        rates = np.linalg.solve(np.asarray(debris.inertia), np.asarray(momentum))
    chaser = np.asarray(arm.chaser, dtype=float)
    given = scenario.limits.model_dump(exclude={"within", "faces", "target", "target_radius"})
    if scenario.limits.faces:
        given["faces"] = _find_faces(scenario.limits.faces, debris.surface.face_names())
    radius = scenario.limits.target_radius
    if scenario.limits.target is not None and radius is not None:
        given["target"] = np.asarray(scenario.limits.target, dtype=float) - np.asarray(table.centre, dtype=float)
        given["radius"] = radius
        # Of a body with edges no less than this, and outside of a corner more.
        off = abs(float(debris.surface.find_foot(jnp.asarray(given["target"])).distance))
        if off > radius:
            raise InputError(f"no place of the body is so near to the target, which is {off:.4g} m from its surface, "
                             f"while target_radius is {radius:g} m; state a target on the surface, in the "
                             "coordinates of the shape", key="limits.target")
    limits = Limits(**given, speed=arm.speed, chaser=chaser / np.linalg.norm(chaser),
                    cone=np.radians(arm.cone_degrees), clearance=arm.clearance_time)
    law = mount_law(scenario, *load_laws(scenario.ball, here)) if laws is None else laws.main
    own = _load_function(goal.function, here) if goal.function else None
    if own is not None:
        _check_function(own, goal.function, rates, debris.inertia)
    return StrikeProblem(law, debris, attitude, rates, limits, Goal(goal.momentum, goal.energy, goal.nutation, own),
                         {name: scalar(value) for name, value in scenario.ball.conditions.items()})
