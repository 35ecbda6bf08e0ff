"""`SCENARIO.toml` of `ddetumble plan`: what is struck, how it moves, what arm and ball can do, what is wanted.

All numbers SI, angles in degrees where the key says so. See `Scenario` for every key.
"""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pydantic
from pydantic import ConfigDict, Field, StrictBool, StrictFloat, StrictInt, StrictStr

from .._errors import InputError
from .._numerics import scalar
from .._rotation import rotate_back
from ..contact.effect import parameters_of
from ..contact.gripping import StrikeLaw, Striker
from ..contact.law import Ball, ContactLaw
from ..contact.sliding import AbstractFriction, CoulombFriction, FrictionLaw
from ..dynamics.bodies import AbstractBody, Box, Cylinder, Sphere, read_mesh
from ..dynamics.surfaces import Debris, make_debris
from ..inference.archive import load_model
from ..inference.models import is_fitted
from .strike_problem import Goal, Limits, Problem, is_symmetric


SCHEMA = "ddetumble.plan/1"
CLAMPED = 1e9  # kg, rolling mass of a ball that its mount keeps from turning
Number = Annotated[StrictFloat | StrictInt, Field(allow_inf_nan=False)]
Positive = Annotated[StrictFloat | StrictInt, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[StrictFloat | StrictInt, Field(ge=0, lt=1, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class _Strict(pydantic.BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DebrisTable(_Strict):
    """`[debris]`: shape and how it moves at time 0.

    Attributes:
        shape: `cylinder` (with `radius`, `length`), `box` (`lengths`), `sphere` (`radius`) or `mesh` (`file`, `scale`).
        mass: [kg].
        radius, length: [m].
        lengths: along body x, y, z [m].
        file: of a closed convex mesh, from the scenario's own folder on.
        scale: metres per unit of the mesh.
        attitude: quaternion, scalar first, body to inertial.
        angular_velocity: body components [rad/s].
        angular_momentum: inertial components [N m s], in place of `angular_velocity`.
    """

    shape: Literal["cylinder", "box", "sphere", "mesh"] = "cylinder"
    mass: Positive = 1000.0
    radius: Positive = 1.0
    length: Positive = 3.0
    lengths: tuple[Positive, Positive, Positive] | None = None
    file: StrictStr = ""
    scale: Positive = 1.0
    attitude: tuple[Number, Number, Number, Number] = (1.0, 0.0, 0.0, 0.0)
    angular_velocity: Vector | None = None
    angular_momentum: Vector | None = None

    @pydantic.model_validator(mode="after")
    def _check(self):
        if (self.angular_velocity is None) == (self.angular_momentum is None):
            raise ValueError("give one of angular_velocity and angular_momentum")
        if not any(self.angular_velocity or self.angular_momentum or ()):
            raise ValueError("debris that does not turn needs no plan: angular_velocity is zero")
        if not any(self.attitude):
            raise ValueError("attitude must be a quaternion that is not zero")
        if self.shape == "box" and self.lengths is None:
            raise ValueError("a box needs lengths")
        if self.shape == "mesh" and not self.file:
            raise ValueError("a mesh needs file")
        return self


class BallTable(_Strict):
    """`[ball]`: the contact model.

    Attributes:
        model: folder of a fit to impacts, or to oblique impacts (with its friction); '' for the paper's ball.
        friction_model: folder of a fit to slip records.
        restitution: of the paper's ball.
        friction: constant coefficient where no friction model is named.
    """

    model: StrictStr = ""
    friction_model: StrictStr = ""
    restitution: Annotated[StrictFloat, Field(gt=0, lt=1)] = 0.7
    friction: Annotated[StrictFloat | StrictInt, Field(ge=0, allow_inf_nan=False)] = 0.218


class ArmTable(_Strict):
    """`[arm]`: what the ball is mounted on.

    Attributes:
        mass: apparent at the tip along the normal [kg]; that of the fitted model where it is not given.
        tangential_mass: apparent across it [kg]; as `mass` where it is not given.
        clamped: whether the mount keeps the ball from turning.
        speed: largest [m/s].
        chaser: direction from the debris to the chaser, inertial.
        cone_degrees: largest angle between that and the outward normal at the place that is struck.
        clearance_time: before and after the contact, in which nothing else may be touched [s].
    """

    mass: Positive | None = None
    tangential_mass: Positive | None = None
    clamped: StrictBool = True
    speed: Positive = 2.0
    chaser: Vector = (1.0, 0.0, 0.0)
    cone_degrees: Annotated[StrictFloat | StrictInt, Field(gt=0, le=180)] = 180.0
    clearance_time: Positive = 0.5


class LimitTable(_Strict):
    """`[limits]`: what ball and debris can take.

    Attributes:
        pressure: lowest and highest, absolute [Pa].
        force: peak normal force [N].
        depression: of the ball [m].
        edge: least distance of the contact disc from an edge [m].
        window: earliest and latest instant of first touch [s]; in a sequence the least and longest wait.
        approach: least speed along the normal [m/s].
    """

    pressure: tuple[Positive, Positive] = (1.0e6, 2.5e6)
    force: Positive = 500.0
    depression: Positive = 0.02
    edge: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 0.02
    window: tuple[Annotated[StrictFloat | StrictInt, Field(ge=0)], Positive] = (0.0, 60.0)
    approach: Positive = 0.05

    @pydantic.model_validator(mode="after")
    def _check(self):
        for name, (low, high) in (("pressure", self.pressure), ("window", self.window)):
            if not low < high:
                raise ValueError(f"{name} has to rise from its lowest to its highest value")
        return self


class GoalTable(_Strict):
    """`[goal]`: what is wanted.

    Attributes:
        momentum, energy, nutation: weights of |L| and of the energy left, and of the nutation angle over 90°.
        impacts: at most so many.
        share: of the angular momentum at which a sequence ends.
    """

    momentum: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 1.0
    energy: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 0.0
    nutation: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 0.0
    impacts: Annotated[StrictInt, Field(ge=1, le=200)] = 1
    share: Share = 0.01

    @pydantic.model_validator(mode="after")
    def _check(self):
        if not self.momentum + self.energy + self.nutation > 0:
            raise ValueError("one of momentum, energy and nutation needs a weight above zero")
        return self


class Scenario(_Strict):
    """Content of `SCENARIO.toml`; its tables are `[debris]`, `[ball]`, `[arm]`, `[limits]` and `[goal]`."""

    schema_: Literal["ddetumble.plan/1"] = Field(alias="schema")
    title: StrictStr = ""
    debris: DebrisTable
    ball: BallTable = BallTable()
    arm: ArmTable = ArmTable()
    limits: LimitTable = LimitTable()
    goal: GoalTable = GoalTable()
    seed: Annotated[StrictInt, Field(ge=0)] = 0
    starts: Annotated[StrictInt, Field(ge=1, le=64)] = 4


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
                         column="schema")
    try:
        return Scenario.model_validate(content)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "scenario"
        raise InputError(f"{first['msg'].removeprefix('Value error, ')[:200]}", file=path, column=place) from None


def make_body(table: DebrisTable, here: Path) -> AbstractBody:
    """The body of a scenario."""
    if table.shape == "box":
        return Box(table.mass, np.asarray(table.lengths, dtype=float))
    if table.shape == "sphere":
        return Sphere(table.mass, table.radius)
    if table.shape == "mesh":
        return read_mesh(here / table.file, table.mass, table.scale)
    return Cylinder(table.mass, table.radius, table.length)


def _load_law(name: str, here: Path, column: str) -> Any:
    folder = here / name
    if not is_fitted(str(folder)):
        raise InputError(f"{name} is no folder that fit or discover wrote", column=column)
    return load_model(folder).law()


def make_law(scenario: Scenario, here: Path) -> StrikeLaw:
    """The contact law of a scenario: fitted models with their effects, or the paper's ball with constant friction.

    Raises:
        InputError: A folder holds no fit, or one of another family.
    """
    ball, arm = scenario.ball, scenario.arm
    normal: Any = ContactLaw(Ball(restitution=scalar(ball.restitution)))
    friction: Any = FrictionLaw(CoulombFriction(scalar(ball.friction)))
    own: tuple[Any, ...] = ()
    striker: Striker | None = None
    if ball.model:
        law = _load_law(ball.model, here, "ball.model")
        if isinstance(law, StrikeLaw):
            striker, own, normal, friction = law.reference, law.effects, law.normal, law.friction
        elif isinstance(law, ContactLaw):
            normal, own = law, tuple(law.effects)
        else:
            raise InputError("the model has to be one of impacts or of oblique impacts", column="ball.model")
    if ball.friction_model:
        law = _load_law(ball.friction_model, here, "ball.friction_model")
        if not isinstance(law, FrictionLaw):
            raise InputError("the model has to be one of slip records", column="ball.friction_model")
        friction, own = law, (*own, *law.effects)
        striker = None
    reference = normal.reference
    mass = float(reference.inertia()) if arm.mass is None else arm.mass
    across = arm.tangential_mass or (float(striker.tangential_mass) if striker and arm.mass is None else mass)
    if arm.mass is not None:
        if "effective_mass" not in {one.name for one in parameters_of(reference)}:
            raise InputError("this contact model has no effective_mass; leave it out", column="arm.mass")
        reference = eqx.tree_at(lambda one: one.effective_mass, reference, scalar(arm.mass))
    assert isinstance(friction.reference, AbstractFriction)
    rolling = CLAMPED if arm.clamped else float(striker.rolling_mass) if striker else 0.5
    creep = {} if striker is None else {"creep_speed": striker.creep_speed}
    return Striker(reference, friction.reference, tangential_mass=scalar(across), rolling_mass=scalar(rolling),
                   **creep).extend(own)


def pose_problem(scenario: Scenario, here: Path) -> Problem:
    """The problem of a scenario's first impact.

    Args:
        scenario: what was read.
        here: the file's folder.
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
        raise InputError("the direction to the chaser must not be zero", column="arm.chaser")
    allowed = Limits(
        speed=arm.speed, approach=limits.approach, force=limits.force, depression=limits.depression, edge=limits.edge,
        pressure=np.asarray(limits.pressure), window=np.asarray(limits.window),
        chaser=chaser / np.linalg.norm(chaser), cone=np.radians(arm.cone_degrees), clearance=arm.clearance_time)
    return Problem(make_law(scenario, here), debris, attitude, rates, allowed,
                   Goal(goal.momentum, goal.energy, goal.nutation), {}, is_symmetric(debris))
