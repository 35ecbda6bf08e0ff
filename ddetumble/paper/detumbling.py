r"""Tables 5 and 6: which force, lever arm and attitude take 63.2 % and 27.5 % of the momentum, and what is left open.

The paper prints momenta, the time of impact (0.4 s) and the stage's sizes; no force, no lever arm, no attitude. Its
simulation applies the force as a step (Section 4 says so of the test's loading). A step of normal force $F$ at a lever
arm $\ell$ takes $F \ell t$ of momentum along one transverse axis of the stage.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array

from .._numerics import scalar
from .._rotation import from_matrix, rotate
from .._sentences import say
from ..contact.gripping import Striker
from ..contact.law import Ball
from ..contact.sliding import CoulombFriction
from ..dynamics.angles import measure_nutation
from ..dynamics.bodies import Cylinder
from ..dynamics.collision import simulate_collision
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import Tumble, measure_momentum, simulate_tumbling, trace_point
from ..dynamics.surfaces import make_debris
from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN
from ..figures.style import new_axes, new_figure, styled
from .contradictions import STATED_TIME, Contradiction, make_point
from .section import write_section
from .tumbling import DURATION, STEP, UNTURNED, Momentum, measure_angle, read_momentum


IMPACT_TIME = 0.4  # s, section 5
SPEED, FASTEST = 0.4, 2.0  # m/s: of the tests, and what Table 1 gives the arm
LEVERS = {"side wall, at the rim": 1.5, "end face, at the rim": 1.0}  # m, of a normal force on the stage
MASSES = (1.2, 4.0, 10.0, 20.0)  # kg, over the apparent masses that an arm may have
TOUCH = 1.4  # m, height of the toolkit's own impacts on the side wall: just inside its rim at 1.5 m


def find_demand(table: Momentum, printed: np.ndarray, friction: float) -> dict[str, Any]:
    """What a table asks of an impact.

    Args:
        table: momentum before and after.
        printed: normal forces that the paper prints, shape (forces,) [N].
        friction: coefficient that friction has where it helps [-].

    Returns:
        As `paper.json` has it: `taken`, size of the momentum that it takes [N m s]; `share` of the momentum before [-];
        `turn` of its direction [°]; mean `moment` over 0.4 s [N m]; mean normal `forces` by place [N], and
        `forces_with_friction` that helps along the same moment [N]; `smallest_arm` that any printed force would need
        [m]; `forces_in_test`, the same as `forces` over the time that the tests are said to last; `tilt`, largest angle
        by which the momentum can have been off the plane across the axis [°]; `least_nutation` angle from which a
        normal force can leave as little [°].
    """
    before, after = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    taken = float(np.linalg.norm(table.before - table.after))
    moment = taken / IMPACT_TIME
    body = Cylinder()  # the lever arm of friction is the other one
    others = dict(zip(LEVERS, (float(body.radius), 0.5 * float(body.length)), strict=True))
    # The part a along the axis stays: the direction turns by asin(a/after) - asin(a/before).
    a = np.linspace(0.0, after, 200_001)
    turns = np.arcsin(a / after) - np.arcsin(a / before)
    return {
        "taken": taken, "share": 1.0 - after / before, "turn": float(np.degrees(table.turn)), "moment": moment,
        "forces": {place: moment / arm for place, arm in LEVERS.items()},
        "forces_with_friction": {place: moment / (arm + friction * others[place]) for place, arm in LEVERS.items()},
        "forces_in_test": {place: taken / STATED_TIME / arm for place, arm in LEVERS.items()},
        "smallest_arm": moment / float(np.max(printed)),
        "tilt": float(np.degrees(np.arcsin(np.interp(table.turn, turns, a) / before))),
        "least_nutation": float(np.degrees(np.arccos(min(after / before, 1.0)))),
    }  # fmt: skip


def place_stage(momentum: np.ndarray) -> np.ndarray:
    """An attitude whose body x lies along the momentum, and body z, the axis, across it and across Z."""
    x = momentum / np.linalg.norm(momentum)
    z = np.cross(x, [0.0, 0.0, 1.0])
    z = z / np.linalg.norm(z)
    return np.asarray(from_matrix(jnp.asarray(np.stack([x, np.cross(z, x), z], axis=-1))))


def follow_impact(table: Momentum, before: float, after: float) -> Tumble:
    """Free motion, a step of moment along the momentum from t = 0 on, free motion again; `before` and `after` say how
    long is shown on either side [s].
    """
    inertia, attitude = Cylinder().inertia(), place_stage(table.before)
    size, left = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    spin = jnp.array([size / float(inertia[0, 0]), 0.0, 0.0])
    moment = Partial(_hold, jnp.array([-(size - left) / IMPACT_TIME, 0.0, 0.0]))
    earlier = propagate_torque_free(inertia, attitude, spin, np.arange(-before, 0.0, STEP))
    during = simulate_tumbling(inertia, attitude, spin, np.linspace(0.0, IMPACT_TIME, 9), moment)
    later = propagate_torque_free(inertia, during.attitude[-1], during.angular_velocity[-1],
                                  np.arange(STEP, after, STEP))
    attitude, rates = (jnp.concatenate([getattr(part, name) for part in (earlier, during, later)])
                       for name in ("attitude", "angular_velocity"))
    time = jnp.concatenate([earlier.time, during.time, later.time + IMPACT_TIME])
    return Tumble(time, attitude, rates, during.failed, during.steps)


def _hold(moment: Array, *state: Array) -> Array:
    """A moment fixed in the stage, shape (3,) [N m], whatever the state."""
    return moment


def sample_steps(step: float = STEP) -> float:
    """Impulse of a half sine over 0.4 s, summed at the paper's steps, over what it has [-]."""
    times = np.arange(0.0, IMPACT_TIME - 1e-9, step)
    return float(np.sum(np.sin(np.pi * times / IMPACT_TIME)) * step / (2.0 * IMPACT_TIME / np.pi))


def strike_stage(momentum: np.ndarray, pressure: float = 2.5e6) -> list[dict[str, float]]:
    """The toolkit's own impacts on the flat-spinning stage, one row for each apparent `mass` [kg] of the arm and
    `speed` [m/s]: `share` of the momentum taken [-], `peak_force` [N], `depression` [m], `time` of contact [s].
    """
    debris = make_debris(Cylinder())
    size = float(np.linalg.norm(momentum))
    rates = jnp.array([size / float(debris.inertia[0, 0]), 0.0, 0.0])
    point = jnp.array([0.0, 1.0, -TOUCH])  # moves along +y while omega is along x: the ball comes against it

    @jax.jit
    @jax.vmap
    def run(mass, speed):
        law = Striker(Ball(effective_mass=mass), CoulombFriction(scalar(0.0)), tangential_mass=mass,
                      rolling_mass=scalar(1e9))
        found = simulate_collision(law, debris, UNTURNED, rates, point, jnp.stack([0.0 * speed, -speed, 0.0 * speed]),
                        {"initial_pressure": pressure}, max_steps=512)
        return jnp.stack([1.0 - jnp.linalg.norm(found.angular_momentum) / size, found.peak_force,
                          found.peak_depression, found.separation])

    pairs = np.array([(mass, speed) for speed in (SPEED, FASTEST) for mass in MASSES])
    values = np.asarray(run(*jnp.asarray(pairs.T)))
    names = ("mass", "speed", "share", "peak_force", "depression", "time")
    return [dict(zip(names, map(float, (*pair, *row)), strict=True)) for pair, row in zip(pairs, values, strict=True)]


def find_mass(rows: list[dict[str, float]], share: float) -> tuple[float, float]:
    """Apparent mass [kg] that takes a share of the momentum at the arm's full speed, and its peak force [N].

    Between the rows of `strike_stage` by straight lines.
    """
    fast = [row for row in rows if row["speed"] == FASTEST]
    shares, masses, peaks = ([row[name] for row in fast] for name in ("share", "mass", "peak_force"))
    return float(np.interp(share, shares, masses)), float(np.interp(share, shares, peaks))


@styled
def draw_demand(demands: Mapping[str, Mapping[str, Any]], printed: np.ndarray):
    """Mean force over lever arm of both tables, with the forces that the paper prints and the arms that there are."""
    figure, axes = new_axes(3.6, grid="both")
    arms = np.linspace(0.4, 2.4, 200)
    for (name, one), colour in zip(demands.items(), (BEFORE, AFTER), strict=True):
        axes.plot(arms, one["moment"] / arms, color=colour, lw=2.0, label=name)
    axes.axhspan(printed.min(), printed.max(), color=FLOOR, alpha=0.25, lw=0)
    axes.text(2.38, printed.max() + 2, "normal forces that the paper prints", ha="right", color=GREY)
    for arm, name in ((1.0, "end face"), (1.5, "side wall")):
        axes.axvline(arm, color=INK, lw=1.0, ls=":")
        axes.text(arm + 0.02, 148, f"{name}: at most {arm:g} m", color=INK)
    axes.set(xlabel="lever arm of the normal force [m]", ylabel="step of force over 0.4 s [N]", xlim=(0.4, 2.4),
             ylim=(0, 160))
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.9))
    return figure


@styled
def draw_passages(passages: Mapping[str, Tumble], values: Callable[[Tumble], Mapping[str, Any]], height: float,
                  label: str, limits: tuple[float | None, float | None], place: Any, colours: Sequence[str]):
    """Figures 18 to 22: values of the passages by table, by name, shape (times,) [rad or rad/s], before and after the
    impacts, in a figure of that height [inch]; label and limits are of their axis [° or °/s], the place is the
    legend's.
    """
    figure, *panels = new_axes(height, columns=len(passages), xlabel="time since the impact [s]")
    for axes, (name, passage) in zip(panels, passages.items(), strict=True):
        axes.axvline(0.0, color=INK, lw=0.8, ls=":")
        for (what, value), colour in zip(values(passage).items(), colours, strict=True):
            axes.plot(passage.time, np.degrees(value), color=colour, lw=1.8, label=what)
        axes.set(title=name, xlim=(float(passage.time[0]), float(passage.time[-1])), ylim=limits)
    panels[0].set_ylabel(label)
    if len(colours) > 1:
        panels[0].legend(loc=place, ncols=len(colours))
    return figure


def measure_angles(passage: Tumble) -> dict[str, np.ndarray]:
    """Angles of the stage's axis to its momentum and to the base frame's Z, shape (times,) [rad]."""
    axis = np.asarray(rotate(jnp.asarray(passage.attitude), jnp.array([0.0, 0.0, 1.0])))
    return {"to the momentum": np.asarray(measure_nutation(Cylinder().inertia(), passage.angular_velocity)),
            "to Z": np.arccos(np.clip(axis[:, 2], -1, 1))}


def measure_rates(passage: Tumble) -> dict[str, np.ndarray]:
    """Angular velocity in the base frame, shape (times,) [rad/s]."""
    rates = np.asarray(rotate(jnp.asarray(passage.attitude), jnp.asarray(passage.angular_velocity)))
    return dict(zip("XYZ", rates.T, strict=True))


@styled
def draw_stages(passage: Tumble, duration: float = 40.0, count: int = 5):
    """Figure 23: the axis of the stage over equal times before and after the impact of Table 6."""
    figure = new_figure(3.8)
    for column, (name, start) in enumerate((("before", -duration), ("after", 1.0))):
        axes = figure.add_subplot(1, 2, column + 1, projection="3d")
        axes.set_title(f"{name}: {count} attitudes over {duration:g} s")
        for k, time in enumerate(np.linspace(start, start + duration, count)):
            attitude = passage.attitude[np.argmin(np.abs(passage.time - time))]
            ends = np.asarray(rotate(jnp.asarray(attitude), jnp.array([[0.0, 0.0, -1.5], [0.0, 0.0, 1.5]])))
            axes.plot(*ends.T, color=KIN if k else AFTER, lw=5.0 if k == 0 else 3.0, alpha=1.0 if k == 0 else 0.75)
        for axis in "xyz":
            axes.set(**{f"{axis}ticks": [-1, 0, 1], f"{axis}lim": (-1.5, 1.5), f"{axis}label": f"{axis.upper()} [m]"})
        axes.set_box_aspect((1, 1, 1))
    return figure


@styled
def draw_displacement(passage: Tumble, velocity: np.ndarray):
    """Figure 24: X and Y of the end-face centre A, without and with the motion that the impulse gives the stage."""
    figure, *panels = new_axes(3.4, grid="both", columns=2, xlabel="X of A [m]")
    path = np.asarray(trace_point(jnp.asarray(passage.attitude), Cylinder().end_face()))
    drift = np.maximum(passage.time, 0.0)[:, None] * velocity
    for axes, name, places in zip(panels, ("centre held, as the paper assumes", "centre free"), (path, path + drift),
                                  strict=True):
        for part, colour, label in ((passage.time < 0, BEFORE, "before"), (passage.time >= 0, AFTER, "after")):
            axes.plot(*places[part, :2].T, color=colour, lw=1.6, label=label)
        axes.set_title(name)
        axes.set_aspect("equal", adjustable="datalim")
    panels[0].set_ylabel("Y of A [m]")
    panels[0].legend(loc="upper left", ncols=2)
    return figure


def list_simulation_points(found: Mapping[str, Any]) -> list[Contradiction]:
    """Rows 10 and 11, the attitude and the step, of what `write_detumbling` found."""
    tables = found["tables"].values()
    turn, tilt = (max(one[name] for one in tables) for name in ("turn", "tilt"))
    return [
        make_point(10, {"turn": turn, "nutation": found["assumed_nutation"], "needed_low": 90.0 - tilt,
                       "most_percent": 100 * found["taken_there_at_most"]}),
        make_point(11, {"step": STEP, "time": IMPACT_TIME, "seen_percent": 100 * found["two_steps_see"]}),
    ]


SHOWN = 300.0  # s, on either side of the impact: more would draw the curves too densely to read


def write_detumbling(peaks: np.ndarray, measured: np.ndarray, theory: np.ndarray, friction: float):
    """The section, and what `paper.json` says of it; of the normal forces of Figure 8 and Table 3 (measured, theory),
    shape (records,) [N], and the measured friction over normal force [-].
    """
    printed = np.sort(np.concatenate([peaks, measured, theory]))
    tables = {name: read_momentum(name.lower().replace(" ", "-")) for name in ("Table 5", "Table 6")}
    passages = {name: follow_impact(table, SHOWN, SHOWN) for name, table in tables.items()}
    demands = {name: find_demand(table, printed, friction) for name, table in tables.items()}
    for (name, one), arm in zip(demands.items(), LEVERS.values(), strict=True):
        left = measure_momentum(Cylinder().inertia(), passages[name].attitude[-1], passages[name].angular_velocity[-1])
        one |= {"left": float(np.linalg.norm(left)), "impulse": one["moment"] * IMPACT_TIME / arm}
    five, six = demands.values()
    start, largest = tables["Table 5"].before, float(printed[-1])
    most = float(max(peaks.max(), measured.max()))
    side, end = LEVERS
    nutation = measure_angle(start, np.array([0.0, 0.0, 1.0]))
    own = strike_stage(start)
    mass, peak = find_mass(own, five["share"])
    found = {
        "sentence": say("paper.demand", five=five, six=six, time=IMPACT_TIME, side=side, end=end, largest=largest,
                        measured=most, test=STATED_TIME, half_sine=0.5 * np.pi),
        "largest_printed_force": largest, "largest_measured_force": most, "friction": friction, "tables": demands,
        "assumed_nutation": float(np.degrees(nutation)), "taken_there_at_most": float(1.0 - np.cos(nutation)),
        "two_steps_see": sample_steps(), "own_impacts": own, "own_mass": mass, "own_peak": peak,
    }  # fmt: skip
    # The upper end face at +y moves along +z (omega along x); the impulse is against that, along minus the axis.
    speed = six["impulse"] / float(Cylinder().mass)
    drift = np.asarray(rotate(jnp.asarray(place_stage(tables["Table 6"].before)), jnp.array([0.0, 0.0, -speed])))
    figures = {
        "tables-5-6-force": draw_demand(demands, printed),
        "figure-18-19": draw_passages(passages, lambda one: {"": np.linalg.norm(one.angular_velocity[:, :2], axis=1)},
                                      2.6, "precession rate [°/s]", (0, None), "", (AFTER,)),
        "figure-20-21": draw_passages(passages, measure_angles, 2.9, "angle of the axis [°]", (0, 180), "lower left",
                                      (AFTER, BEFORE)),
        "figure-22": draw_passages(passages, measure_rates, 2.9, "angular velocity [°/s]", (None, None), "lower right",
                                   (BEFORE, AFTER, GREY)),
        "figure-23": draw_stages(passages["Table 6"]), "figure-24": draw_displacement(passages["Table 6"], drift),
    }  # fmt: skip
    return write_section("paper.impacts", figures, found=found, half_sine=0.5 * np.pi, five=five, six=six, side=side,
                         end=end, time=IMPACT_TIME, step=STEP, duration=DURATION, touch=TOUCH, fastest=FASTEST), found
