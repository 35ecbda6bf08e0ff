"""`SCENARIO.toml` of `ddetumble plan`: what is struck, how it moves, what arm and ball can do, what is wanted.

All numbers are SI, or texts with a unit ("3 deg/s"), and angles in degrees where the key says so; `Scenario` has every
key. Nothing here needs JAX, so that a mistake in a file is told at once.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from pydantic import BeforeValidator, Field, StrictBool, StrictFloat, StrictInt, StrictStr

from .._errors import InputError, error_place
from .._settings import find_data
from .._user_files import split_name
from ..inference.files import Strict, check_settings, read_settings
from ..measurement.units import convert_text


SCHEMA = "ddetumble.plan/1"
# Faces of the bodies that are no mesh, as their surfaces name them.
FACES = {"cylinder": ("side", "upper end", "lower end"), "box": ("+x", "+y", "+z", "-x", "-y", "-z"),
         "sphere": ("sphere",)}
# Why no diameter is taken beside a fit.
OF_A_FIT = ("the ball of a fit has the outer diameter that its campaign states (import --known "
            "'outer_diameter=60 mm'); leave outer_diameter out")
DEEPEST = 0.5  # of the diameter, that a limit of the depression may be: up to there the contact geometry is meant

DEGREES = 180.0 / np.pi  # in a radian

Number = StrictFloat | StrictInt
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]


def _read_in(unit: str, scale: float = 1.0) -> BeforeValidator:
    """Reads a text with a unit as a number in this one, times `scale`; what is no text passes."""
    def read(value: Any) -> Any:
        try:
            return scale * convert_text(value, unit) if isinstance(value, str) else value
        except InputError as error:
            raise ValueError(error.problem) from None

    return BeforeValidator(read)


def _list_names(value: Any) -> Any:
    """One name as a list of it, none where it is empty; what is no text passes."""
    return tuple(filter(None, [value])) if isinstance(value, str) else value


def _refuse_mixed(values: Any) -> Any:
    """Refuse texts with units beside a plain number other than zero, whose unit nobody can be sure of."""
    if isinstance(values, (list, tuple)) and any(isinstance(one, str) for one in values):
        bare = [one for one in values if not isinstance(one, str) and one]
        if bare:
            raise ValueError(f"{bare[0]} has no unit, but others beside it do: is it meant in theirs? Give each value "
                             "its unit, or none of them, for SI")
    return values


ALIKE = BeforeValidator(_refuse_mixed)
Mass = Annotated[Positive, _read_in("kg")]
Length = Annotated[Positive, _read_in("m")]
Distance = Annotated[NotNegative, _read_in("m")]
Speed = Annotated[Positive, _read_in("m/s")]
Force = Annotated[Positive, _read_in("N")]
Pressure = Annotated[Positive, _read_in("Pa")]
Ambient = Annotated[NotNegative, _read_in("Pa")]
Time = Annotated[NotNegative, _read_in("s")]
Rate = Annotated[Number, _read_in("rad/s")]
Momentum = Annotated[Number, _read_in("N*m*s")]
Inertia = Annotated[Number, _read_in("kg*m^2")]
Row = tuple[Inertia, Inertia, Inertia]
Place = Annotated[Number, _read_in("m")]
Places = Annotated[tuple[Place, Place, Place], ALIKE]
Fraction = Annotated[NotNegative, _read_in("")]
Degrees = Annotated[NotNegative, _read_in("rad", DEGREES)]
Vector = tuple[Number, Number, Number]


class DebrisTable(Strict):
    """`[debris]`: shape and how it moves at time 0."""

    shape: Literal["cylinder", "box", "sphere", "mesh"] = Field(default="cylinder", description="`cylinder` (`radius`, "
        "`length`; about body z), `box` (`lengths`), `sphere` (`radius`) or `mesh` (`file`, `scale`).")
    mass: Mass = Field(default=1000.0, description="[kg].")
    radius: Length = Field(default=1.0, description="radius of a cylinder or a sphere [m].")
    length: Length = Field(default=3.0, description="length of a cylinder [m].")
    lengths: Annotated[tuple[Length, Length, Length], ALIKE] | None = Field(
        default=None, description="edges of a box along body x, y, z [m].")
    file: StrictStr = Field(default="", description="file of a closed convex mesh, relative to the scenario's folder.")
    scale: Positive = Field(default=1.0, description="metres per unit of the mesh.")
    inertia: tuple[Row, Row, Row] | None = Field(
        default=None, description="tensor of inertia about the centre of mass, body components, three rows [kg m²]; "
        "that of uniform density if not given.")
    centre: Places = Field(
        default=(0.0, 0.0, 0.0), description="centre of mass, body components, from that of a body of uniform density "
        "[m]; needs `inertia`.")
    attitude: tuple[Number, Number, Number, Number] = Field(
        default=(1.0, 0.0, 0.0, 0.0), description="quaternion, scalar first, body to inertial.")
    angular_velocity: Annotated[tuple[Rate, Rate, Rate], ALIKE] | None = Field(
        default=None, description="angular velocity, body components [rad/s].")
    angular_momentum: Annotated[tuple[Momentum, Momentum, Momentum], ALIKE] | None = Field(
        default=None, description="inertial components [N m s], instead of `angular_velocity`.")

    @pydantic.model_validator(mode="after")
    def _check(self):
        if (self.angular_velocity is None) == (self.angular_momentum is None):
            raise ValueError("give either angular_velocity or angular_momentum")
        if not any(self.angular_velocity or self.angular_momentum or ()):
            raise ValueError("debris that does not turn needs no plan: angular_velocity is zero")
        if not any(self.attitude):
            raise ValueError("attitude must be a non-zero quaternion")
        if any(self.centre) and self.inertia is None:
            raise ValueError("a body with an offset centre of mass is not of uniform density: give inertia too")
        if self.shape == "box" and self.lengths is None:
            raise ValueError("a box needs lengths")
        if self.shape == "mesh" and not self.file:
            raise ValueError("a mesh needs a file")
        own = {"cylinder": {"radius", "length"}, "box": {"lengths"}, "sphere": {"radius"}, "mesh": {"file", "scale"}}
        idle = sorted(self.model_fields_set & (set().union(*own.values()) - own[self.shape]))
        if idle:
            raise ValueError(f"a {self.shape} has no {', '.join(idle)}; its keys are "
                             f"{', '.join(sorted(own[self.shape]))}")
        return self


class BallTable(Strict):
    """`[ball]`: the contact model."""

    model: StrictStr = Field(
        default="", description="folder of a fit to impacts, or to oblique impacts (with its friction); "
        "'' for the paper's ball.")
    outer_diameter: Length = Field(
        default=0.06, description="outer diameter of the ball before deformation [m]; 60 mm is the paper's ball. The "
        "ball of a fit has what its campaign states (`import --known 'outer_diameter=60 mm'`).")
    friction_model: StrictStr = Field(
        default="", description="folder of a fit to slip records. One with the slip term of Eqs. 9 and 10, which grows "
        "without limit above 30.7 N, needs `limits.force` of 30 N or less; one by `--model eq8` or `coulomb` does not.")
    restitution: Annotated[StrictFloat, Field(gt=0, lt=1)] = Field(
        default=0.7, description="restitution of the paper's ball.")
    friction: NotNegative = Field(
        default=0.218, description="constant coefficient of friction if no friction model is named.")
    ambient_pressure: Ambient = Field(
        default=0.0, description="pressure around the ball where it strikes [Pa], which pushes back on the contact; "
        "nothing does in orbit, whatever the tests of a fit were made in. For a rehearsal on the ground \"101.3 kPa\".")
    conditions: dict[StrictStr, Number] = Field(
        default={}, description="further conditions that the model's effects read, by name, SI: `sequence`, the number "
        "of the impact on this ball.")

    @pydantic.model_validator(mode="before")
    @classmethod
    def _point_the_way(cls, table):
        sizes = sorted({"diameter", "radius", "size"} & set(table)) if isinstance(table, dict) else []
        if sizes:
            raise ValueError(f"{sizes[0]} is not a key here; state the ball's size by outer_diameter, such as "
                             "outer_diameter = \"60 mm\"")
        return table

    @pydantic.model_validator(mode="after")
    def _check(self):
        if self.model and "outer_diameter" in self.model_fields_set:
            raise ValueError(OF_A_FIT)
        return self


class ArmTable(Strict):
    """`[arm]`: what the ball is mounted on."""

    mass: Mass | None = Field(
        default=None, description="apparent mass at the tip along the normal [kg]; that of the fitted model if not "
        "given.")
    tangential_mass: Mass | None = Field(
        default=None, description="apparent mass across the normal [kg]; if not given, that of an oblique fit, or as "
        "along the normal if `mass` is given or there is no such fit.")
    clamped: StrictBool = Field(
        default=True, description="whether the mount keeps the ball from turning; if not, it turns with the rolling "
        "mass of an oblique fit, or 0.5 kg.")
    speed: Speed = Field(default=2.0, description="largest speed of the tip [m/s].")
    chaser: Vector = Field(default=(1.0, 0.0, 0.0), description="direction from the debris to the chaser, inertial; it "
        "counts where `cone_degrees` is less than 180.")
    cone_degrees: Annotated[Number, Field(gt=0, le=180), _read_in("rad", DEGREES)] = Field(
        default=180.0, description="largest angle between this direction, `chaser`, and the outward normal at the "
        "place that is struck: which faces the chaser can reach. It is no limit of the angle at which the ball comes "
        "to the face, which no key limits; the page states that of every impact.")
    chaser_mass: Mass | None = Field(
        default=None, description="mass of the chaser, whose recoil the result then states [kg].")
    clearance_time: Annotated[Positive, _read_in("s")] = Field(
        default=0.5, description="time before and after the contact during which nothing else may be touched [s]; two "
        "impacts of a sequence are at least twice that apart.")

    @pydantic.field_validator("chaser")
    @classmethod
    def _check(cls, chaser):
        if not any(chaser):
            raise ValueError("the direction to the chaser must not be zero")
        return chaser


class LimitTable(Strict):
    """`[limits]`: what ball and debris can take."""

    pressure: Annotated[tuple[Pressure, Pressure], ALIKE] = Field(
        default=(1.0e6, 2.5e6), description="lowest and highest initial pressure, absolute [Pa]; twice the same for "
        "one that is given.")
    force: Force = Field(default=500.0, description="largest peak normal force [N].")
    depression: Length = Field(default=0.02, description="largest depression of the ball [m].")
    edge: Distance = Field(default=0.02, description="least distance of the contact disc from an edge [m].")
    window: Annotated[tuple[Time, Annotated[Positive, _read_in("s")]], ALIKE] = Field(
        default=(0.0, 60.0), description="earliest and latest instant of first touch [s]; in a sequence the shortest "
        "and longest wait, which after an impact is at least twice `arm.clearance_time` whatever stands here.")
    approach: Speed = Field(default=0.05, description="least speed along the normal [m/s].")
    faces: tuple[StrictStr, ...] = Field(
        default=(), description="faces that may be struck, by name; all if empty. A cylinder has `side`, `upper end` "
        "and `lower end`, a box `+x` to `-z`, a mesh `face 1`, ...")
    target: Places | None = Field(
        default=None, description="centre of the area that may be struck, in the coordinates of the shape (from the "
        "centre of mass of uniform density) [m]; refused where no place of the surface is so near to it as "
        "`target_radius`.")
    target_radius: Length | None = Field(default=None, description="largest distance of first touch from `target` [m].")
    within: Literal["", "measured"] = Field(
        default="", description="`measured`: the plan stays within what the contact model was fitted to (pressure, "
        "approach and tangential speed, force and depression), and says what that costs. Where nothing that slides was "
        "fitted, as with a ball of normal impacts alone, the tangential speed is not limited (nearly every blow on a "
        "body that turns slides), and the answer and `extrapolated` say that it was never measured.")

    @pydantic.model_validator(mode="after")
    def _check(self):
        for name, (low, high) in (("pressure", self.pressure), ("window", self.window)):
            if low > high:
                raise ValueError(f"{name} must have its lowest value first and its highest second")
        if (self.target is None) != (self.target_radius is None):
            raise ValueError("give target and target_radius together")
        return self


class GoalTable(Strict):
    """`[goal]`: what is wanted."""

    momentum: NotNegative = Field(default=1.0, description="weight of |L| left, over |L| before.")
    energy: NotNegative = Field(default=0.0, description="weight of the rotational energy left, over that before.")
    nutation: NotNegative = Field(default=0.0, description="weight of the nutation angle after, over 90°.")
    function: StrictStr = Field(
        default="", description="in place of the three weights, `FILE.py:NAME` of a function of the angular velocity "
        "after an impact (body components) and the tensor of inertia, in JAX, which returns a positive number to be "
        "made small.")
    impacts: Annotated[StrictInt, Field(ge=1, le=200)] = Field(default=1, description="largest number of impacts.")
    share: Annotated[Number, Field(ge=0, lt=1), _read_in("")] = Field(
        default=0.01, description="share of the angular momentum at which a sequence ends, as planned, without errors; "
        "the report measures a plan by it, unless the goal is another than the momentum and this is the usual share.")
    least: Literal["impacts", "impulse", "time"] = Field(
        default="impacts", description="what is minimised in a sequence: the number of impacts, the sum of all "
        "impulses, or the time it takes.")

    @pydantic.model_validator(mode="after")
    def _check(self):
        if not self.momentum + self.energy + self.nutation > 0:
            raise ValueError("at least one of momentum, energy and nutation needs a positive weight")
        return self


class ErrorTable(Strict):
    """`[errors]`: standard deviations of what arm and estimate of the motion get wrong."""

    instant: Time = Field(default=0.05, description="of the instant of first touch [s].")
    place: Distance = Field(default=0.01, description="of the place where the arm arrives, along each axis [m].")
    direction_degrees: Degrees = Field(
        default=1.0, description="of the direction of the arm's velocity, about each axis across it [°].")
    speed: Fraction = Field(default=0.01, description="of the arm's speed, as a fraction of it.")
    rates: Fraction = Field(
        default=0.01, description="of the angular velocity at time 0, of each component, as a fraction of its size.")
    attitude_degrees: Degrees = Field(default=1.0, description="of the attitude at time 0, about each axis [°].")
    inertia: Fraction = Field(default=0.02, description="of each principal moment of inertia, as a fraction of it.")
    centre: Distance = Field(default=0.0, description="of the centre of mass, along each axis [m].")
    draws: Annotated[StrictInt, Field(ge=8, le=4096)] = Field(default=64, description="number of draws.")
    plan_for: Literal["best", "mean", "tail"] = Field(
        default="best", description="what is minimised: the value if all goes as planned, the mean over draws of these "
        "errors, or the mean over their worst share, `uncertainty.tail`. Every limit then has to hold in the mean of "
        "its own worst share. With `uncertainty.plan_for` the same, contact and errors are drawn together.")

    def sizes(self) -> dict[str, float]:
        """The deviations by what is wrong, in SI or as a fraction."""
        return {name.removesuffix("_degrees"): float(np.radians(size) if name.endswith("_degrees") else size)
                for name, size in self.model_dump(exclude={"draws", "plan_for"}).items()}


class SpreadTable(Strict):
    """A parameter of `[uncertainty.parameters]`, in its public unit."""

    mean: Number | None = Field(default=None, description="mean; if not given, the value of the contact model.")
    sd: NotNegative = Field(..., description="standard deviation.")


class UncertaintyTable(Strict):
    """`[uncertainty]`: how well the contact is known, and what the plan makes of that."""

    fit: Annotated[tuple[StrictStr, ...], BeforeValidator(_list_names)] = Field(
        default=(), description="folder that `fit`, `sample`, `discover` or `average` wrote (or its `result.json`), "
        "relative to the scenario's folder, or a list of two, one of the ball and one of its friction, which are drawn "
        "together. A fit to impacts is the ball's model, one to slip records its friction; the other one is held, and "
        "the page says so. If neither this nor `parameters` is given, all that `model` and `friction_model` of the "
        "ball name are drawn.")
    parameters: dict[StrictStr, SpreadTable] = Field(
        default={}, description="parameters of the contact model by name, each with `sd` and, unless it is the model's "
        "own value, `mean`.")
    correlation: tuple[tuple[StrictStr, StrictStr, Annotated[Number, Field(ge=-1, le=1)]], ...] = Field(
        default=(), description="rows of two of these names and their correlation.")
    draws: Annotated[StrictInt, Field(ge=2, le=1024)] = Field(default=32, description="number of draws of each model.")
    tail: Annotated[StrictFloat, Field(gt=0, le=0.5)] = Field(
        default=0.1, description="share of the draws that counts as the tail of bad outcomes.")
    plan_for: Literal["best", "mean", "tail"] = Field(
        default="best", description="what is minimised: the value for the best estimate, the mean over all draws, "
        "or the mean over their worst share (the tail).")

    @pydantic.model_validator(mode="after")
    def _check(self):
        if self.fit and self.parameters:
            raise ValueError("give either fit or parameters, not both")
        for first, second, _ in self.correlation:
            if first == second or not {first, second} <= set(self.parameters):
                raise ValueError(f"correlation of {first} and {second}: both must be under parameters")
        return self


class Scenario(Strict):
    """Content of `SCENARIO.toml`."""

    schema_: Literal["ddetumble.plan/1"] = Field(
        ..., alias="schema", description=f'version of this format, `"{SCHEMA}"`.')
    title: StrictStr = Field(default="", description="title of the report.")
    debris: DebrisTable
    ball: BallTable = BallTable()
    arm: ArmTable = ArmTable()
    limits: LimitTable = LimitTable()
    goal: GoalTable = GoalTable()
    uncertainty: UncertaintyTable | None = None
    errors: ErrorTable = ErrorTable()
    seed: Annotated[StrictInt, Field(ge=0)] = Field(
        default=0, description="seed of the places where the search starts, and of the draws.")
    starts: Annotated[StrictInt, Field(ge=1, le=64)] = Field(
        default=6, description="number of promising designs that are refined on the integrated impact; more of them "
        "occasionally find a better optimum.")

    @pydantic.model_validator(mode="after")
    def _check(self):
        wanted = {self.errors.plan_for, "best" if self.uncertainty is None else self.uncertainty.plan_for} - {"best"}
        if wanted and self.goal.least != "impacts":
            raise ValueError("goal.least must be 'impacts' if plan_for is the mean or the tail, because such plans are "
                             "made one impact after the other")
        if len(wanted) > 1:
            raise ValueError("uncertainty.plan_for and errors.plan_for must be the same if both are the mean or the "
                             "tail")
        size = self.ball.outer_diameter
        if "outer_diameter" in self.ball.model_fields_set and self.limits.depression > DEEPEST * size:
            raise ValueError(f"limits.depression is {1e3 * self.limits.depression:g} mm, more than half the diameter "
                             f"of a ball of {1e3 * size:g} mm; state a smaller one")
        return self


def find_scenario(name: Path | str) -> Path:
    """Path of a scenario's file: the file of this name, or else the shipped scenario, `flat-spin` or `flat-spin.toml`.
    """
    path = Path(name)
    shipped = find_data() / "scenarios" / path.with_suffix(".toml").name
    return path if path.is_file() or path.parent.name or not shipped.is_file() else shipped


def read_scenario(path) -> Scenario:
    """Read a scenario, and see that the files and folders that it names are there.

    Raises:
        InputError: One of them is not there, or the file is no TOML or says something that is not understood; the key
            is named.
    """
    path = Path(path)
    scenario = read_settings(path, Scenario)
    with error_place(file=path):
        _find_files(scenario, path.parent)
        if scenario.debris.shape in FACES:
            check_faces(scenario.limits.faces, FACES[scenario.debris.shape])
    return scenario


def validate_scenario(scenario: Scenario) -> Scenario:
    """A scenario in hand as one that was read: pydantic's `model_copy` takes whatever it is given.

    Raises:
        InputError: It says something that is not understood; the key is named.
    """
    return check_settings(Scenario, scenario.model_dump(by_alias=True, exclude_unset=True, warnings=False))


def check_faces(wanted: Sequence[str], names: Sequence[str]) -> None:
    """Refuse faces that a body does not have."""
    for name in wanted:
        if name not in names:
            shown = ", ".join(map(repr, names[:12])) + (", ..." if len(names) > 12 else "")
            raise InputError(f"this body has no face {name!r}; its faces are {shown}", key="limits.faces")


def _find_files(scenario: Scenario, here: Path) -> None:
    """Refuse names of folders and files that are not there, seen from the folder `here` on."""
    ball, table, own = scenario.ball, scenario.uncertainty, split_name(scenario.goal.function)
    for key, name in (("ball.model", ball.model), ("ball.friction_model", ball.friction_model)):
        if name and not (here / name).is_dir():
            there = f"; names count from the folder of the scenario on, {here}" if Path(name).is_dir() else ""
            raise InputError(f"{name} is not a folder that fit or discover wrote{there}", key=key)
    for name in () if table is None else table.fit:
        if not (here / name).exists():
            raise InputError(f"{name} is not a folder that fit, sample, discover or average wrote",
                             key="uncertainty.fit")
    if scenario.debris.shape == "mesh" and not (here / scenario.debris.file).is_file():
        raise InputError(f"there is no file {scenario.debris.file}", key="debris.file")
    if scenario.goal.function and own is None:
        raise InputError(f"{scenario.goal.function!r} is not of the form FILE.py:NAME", key="goal.function")
    if own is not None and not (here / own[0]).is_file():
        raise InputError(f"there is no file {own[0]}", key="goal.function")
