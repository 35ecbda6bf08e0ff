"""The tables of `SCENARIO.toml`, all numbers SI, angles in degrees where the key says so; `Scenario` is the whole."""

from typing import Annotated, Literal

import pydantic
from pydantic import ConfigDict, Field, StrictBool, StrictFloat, StrictInt, StrictStr


SCHEMA = "ddetumble.plan/1"
Number = Annotated[StrictFloat | StrictInt, Field(allow_inf_nan=False)]
Positive = Annotated[StrictFloat | StrictInt, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[StrictFloat | StrictInt, Field(ge=0, lt=1, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


class _Strict(pydantic.BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DebrisTable(_Strict):
    """`[debris]`: shape and how it moves at time 0.

    Attributes:
        shape: `cylinder` (`radius`, `length`; about body z), `box` (`lengths`), `sphere` (`radius`) or `mesh` (`file`,
            `scale`).
        mass: [kg].
        radius, length: of a cylinder; the radius of a sphere, too [m].
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
        own = {"cylinder": {"radius", "length"}, "box": {"lengths"}, "sphere": {"radius"}, "mesh": {"file", "scale"}}
        idle = sorted(self.model_fields_set & (set().union(*own.values()) - own[self.shape]))
        if idle:
            raise ValueError(f"a {self.shape} has no {', '.join(idle)}; it has {', '.join(sorted(own[self.shape]))}")
        return self


class BallTable(_Strict):
    """`[ball]`: the contact model.

    Attributes:
        model: folder of a fit to impacts, or to oblique impacts (with its friction); '' for the paper's ball.
        friction_model: folder of a fit to slip records, by `--model eq8` or `coulomb` (Eq. 10 grows without limit at
            the loads of an impact).
        restitution: of the paper's ball.
        friction: constant coefficient where no friction model is named.
        conditions: what else the model's effects read, by name, SI: `sequence`, the number of the impact on this ball.
    """

    model: StrictStr = ""
    friction_model: StrictStr = ""
    restitution: Annotated[StrictFloat, Field(gt=0, lt=1)] = 0.7
    friction: Annotated[StrictFloat | StrictInt, Field(ge=0, allow_inf_nan=False)] = 0.218
    conditions: dict[StrictStr, Number] = {}


class ArmTable(_Strict):
    """`[arm]`: what the ball is mounted on.

    Attributes:
        mass: apparent at the tip along the normal [kg]; that of the fitted model where it is not given.
        tangential_mass: apparent across it [kg]; where it is not given, that of an oblique fit, if `mass` is not given
            either, else as along the normal.
        clamped: whether the mount keeps the ball from turning; where not, it turns with the rolling mass of an oblique
            fit, or 0.5 kg.
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
        share: of the angular momentum at which a sequence ends; what the report measures a plan by.
        least: what of a sequence is to be small: the number of impacts, the sum of all impulses, or the time it takes.
    """

    momentum: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 1.0
    energy: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 0.0
    nutation: Annotated[StrictFloat | StrictInt, Field(ge=0)] = 0.0
    impacts: Annotated[StrictInt, Field(ge=1, le=200)] = 1
    share: Share = 0.01
    least: Literal["impacts", "impulse", "time"] = "impacts"

    @pydantic.model_validator(mode="after")
    def _check(self):
        if not self.momentum + self.energy + self.nutation > 0:
            raise ValueError("one of momentum, energy and nutation needs a weight above zero")
        return self


class SpreadTable(_Strict):
    """A parameter of `[uncertainty.parameters]`, in its public unit.

    Attributes:
        mean: that of the contact model where it is not given.
        sd: one standard deviation.
    """

    mean: Number | None = None
    sd: Annotated[StrictFloat | StrictInt, Field(ge=0, allow_inf_nan=False)]


class UncertaintyTable(_Strict):
    """`[uncertainty]`: how well the contact is known, and what the plan makes of that.

    Attributes:
        fit: folder that `fit`, `sample`, `discover` or `average` wrote (or its `result.json`), from the scenario's own
            folder on; it takes the place of the ball's model. That one where neither this nor `parameters` is given.
        parameters: of the contact model by name, each with `sd` and, where it is not the model's own, `mean`.
        correlation: rows of two of these names and their correlation.
        draws: of each model.
        tail: share of the draws that counts as the bad tail.
        plan_for: the best estimate, the mean over all draws, or that over their worst share.
    """

    fit: StrictStr = ""
    parameters: dict[StrictStr, SpreadTable] = {}
    correlation: tuple[tuple[StrictStr, StrictStr, Annotated[StrictFloat | StrictInt, Field(ge=-1, le=1)]], ...] = ()
    draws: Annotated[StrictInt, Field(ge=2, le=1024)] = 32
    tail: Annotated[StrictFloat, Field(gt=0, le=0.5)] = 0.1
    plan_for: Literal["best", "mean", "tail"] = "best"

    @pydantic.model_validator(mode="after")
    def _check(self):
        if self.fit and self.parameters:
            raise ValueError("give either fit or parameters, not both")
        for first, second, _ in self.correlation:
            if first == second or not {first, second} <= set(self.parameters):
                raise ValueError(f"correlation of {first} and {second}: both have to stand under parameters")
        return self


class Scenario(_Strict):
    """Content of `SCENARIO.toml`; its tables are `[debris]`, `[ball]`, `[arm]`, `[limits]`, `[goal]`, `[uncertainty]`.

    Attributes:
        schema_: version of this format, `"ddetumble.plan/1"`.
        title: of the report.
        seed: of the places where the search starts, and of the draws.
        starts: promising designs that are refined on the integrated impact; more find a better optimum now and then.
    """

    schema_: Literal["ddetumble.plan/1"] = Field(alias="schema")
    title: StrictStr = ""
    debris: DebrisTable
    ball: BallTable = BallTable()
    arm: ArmTable = ArmTable()
    limits: LimitTable = LimitTable()
    goal: GoalTable = GoalTable()
    uncertainty: UncertaintyTable | None = None
    seed: Annotated[StrictInt, Field(ge=0)] = 0
    starts: Annotated[StrictInt, Field(ge=1, le=64)] = 6

    @pydantic.model_validator(mode="after")
    def _check(self):
        if self.uncertainty is not None and self.uncertainty.plan_for != "best" and self.goal.least != "impacts":
            raise ValueError("goal.least has to be 'impacts' where uncertainty.plan_for is the mean or the tail: such "
                             "plans are made one impact after the other")
        return self
