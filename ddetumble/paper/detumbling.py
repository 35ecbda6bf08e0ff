r"""Tables 5 and 6: which force, lever arm and attitude take 63.2 % and 27.5 % of the momentum, and what is left open.

The paper prints momenta, the time of impact (0.4 s) and the stage's sizes; no force, no lever arm, no attitude. Its
simulation applies the force as a step (Section 4 says so of the test's loading). A step of normal force $F$ at a lever
arm $\ell$ takes $F \ell t$ of momentum along one transverse axis of the stage.
"""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import scalar
from .._rotation import from_matrix, rotate
from ..contact.gripping import Striker
from ..contact.law import Ball
from ..contact.sliding import CoulombFriction
from ..dynamics.bodies import Cylinder
from ..dynamics.collision import simulate_collision
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import measure_momentum, trace_point
from ..dynamics.surfaces import make_debris
from ..dynamics.tumbling import simulate_tumbling
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, dress, new_figure, styled
from .tumbling import DURATION, STEP, UNTURNED, Momentum, measure_angle, read_momentum


IMPACT_TIME = 0.4  # s, section 5
SPEED, FASTEST = 0.4, 2.0  # m/s: of the tests, and what Table 1 gives the arm
LEVERS = {"side wall, at the rim": 1.5, "end face, at the rim": 1.0}  # m, of a normal force on the stage
MASSES = (1.2, 4.0, 10.0, 20.0)  # kg
TOUCH = 1.4  # m, height of the toolkit's own impacts on the side wall


@dc.dataclass(frozen=True)
class Demand:
    """What one of the tables asks of an impact.

    Attributes:
        taken: size of the momentum that it takes [N m s].
        share: of the momentum before [-].
        turn: of the momentum's direction [rad].
        moment: mean, over 0.4 s [N m].
        forces: mean normal force by place [N].
        rubbed: the same where friction of the coefficient below helps along the same moment [N].
        arms: lever arm that each printed force would need, shape (forces,) [m].
        tilt: largest angle by which the momentum can have been off the plane across the axis [rad].
        least: smallest nutation angle from which a normal force can leave as little [rad].
    """

    taken: float
    share: float
    turn: float
    moment: float
    forces: dict[str, float]
    rubbed: dict[str, float]
    arms: np.ndarray
    tilt: float
    least: float


def find_demand(table: Momentum, printed: np.ndarray, friction: float) -> Demand:
    """What a table asks of an impact.

    Args:
        table: momentum before and after.
        printed: normal forces that the paper prints, shape (forces,) [N].
        friction: coefficient that friction has where it helps [-].
    """
    before, after = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    taken = float(np.linalg.norm(table.before - table.after))
    moment = taken / IMPACT_TIME
    radius, half = float(Cylinder().radius), 0.5 * float(Cylinder().length)
    others = {"side wall, at the rim": radius, "end face, at the rim": half}  # lever arm of friction, the other way
    forces = {place: moment / arm for place, arm in LEVERS.items()}
    rubbed = {place: moment / (arm + friction * others[place]) for place, arm in LEVERS.items()}
    # The part a along the axis stays: the direction turns by asin(a/after) - asin(a/before).
    a = np.linspace(0.0, after, 200_001)
    turns = np.arcsin(a / after) - np.arcsin(a / before)
    tilt = float(np.arcsin(np.interp(table.turn, turns, a) / before))
    return Demand(taken, 1.0 - after / before, table.turn, moment, forces, rubbed, moment / np.asarray(printed), tilt,
                  float(np.arccos(min(after / before, 1.0))))


@final
class _Step(eqx.Module):
    """A moment fixed in the stage, shape (3,) [N m]."""

    moment: Array

    def __call__(self, time: Array, attitude: Array, rates: Array) -> Array:
        return self.moment


@dc.dataclass(frozen=True)
class Passage:
    """Motion of the stage through one impact, a step of moment along the momentum from t = 0 on.

    Attributes:
        time: shape (times,) [s].
        attitude: shape (times, 4) [-].
        rates: body components, shape (times, 3) [rad/s].
        momentum: base frame, at the end, shape (3,) [N m s].
    """

    time: np.ndarray
    attitude: np.ndarray
    rates: np.ndarray
    momentum: np.ndarray


def place_stage(momentum: np.ndarray) -> np.ndarray:
    """An attitude whose body x lies along the momentum, and body z, the axis, across it and across Z."""
    x = momentum / np.linalg.norm(momentum)
    z = np.cross(x, [0.0, 0.0, 1.0])
    z = z / np.linalg.norm(z)
    return np.asarray(from_matrix(jnp.asarray(np.stack([x, np.cross(z, x), z], axis=-1))))


def follow_impact(table: Momentum, before: float, after: float) -> Passage:
    """Free motion, the step of moment at a place of the stage, free motion again.

    Args:
        table: momentum before and after.
        before, after: how long is shown on either side [s].
    """
    inertia = Cylinder().inertia()
    attitude = place_stage(table.before)
    size, left = (float(np.linalg.norm(x)) for x in (table.before, table.after))
    spin = jnp.array([size / float(inertia[0, 0]), 0.0, 0.0])
    earlier = propagate_torque_free(inertia, attitude, spin, np.arange(-before, 0.0, STEP))
    moment = jnp.array([-(size - left) / IMPACT_TIME, 0.0, 0.0])
    during = simulate_tumbling(inertia, attitude, spin, np.linspace(0.0, IMPACT_TIME, 9), _Step(moment))
    start = during.attitude[-1], during.angular_velocity[-1]
    later = propagate_torque_free(inertia, *start, np.arange(STEP, after, STEP))
    parts = (earlier, during, later)
    time = np.concatenate([earlier.time, during.time, np.asarray(later.time) + IMPACT_TIME])
    attitudes = np.concatenate([np.asarray(part.attitude) for part in parts])
    rates = np.concatenate([np.asarray(part.angular_velocity) for part in parts])
    return Passage(time, attitudes, rates, np.asarray(measure_momentum(inertia, *start)))


def sample_steps(step: float = STEP) -> float:
    """Impulse of a half sine over 0.4 s, summed at the paper's steps, over what it has [-]."""
    times = np.arange(0.0, IMPACT_TIME - 1e-9, step)
    return float(np.sum(np.sin(np.pi * times / IMPACT_TIME)) * step / (2.0 * IMPACT_TIME / np.pi))


def strike_stage(momentum: np.ndarray, pressure: float = 2.5e6) -> list[dict[str, float]]:
    """The toolkit's own impacts on the flat-spinning stage: one row for each apparent mass of the arm and speed.

    Returns:
        `mass` [kg], `speed` of the arm [m/s], `share` of the momentum taken [-], `peak_force` [N], `depression` [m],
        `time` of contact [s].
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
def draw_demand(demands: Mapping[str, Demand], printed: np.ndarray):
    """Mean force over lever arm of both tables, with the forces that the paper prints and the arms that there are."""
    figure = new_figure(3.6)
    axes = dress(figure.add_subplot(), "both")
    arms = np.linspace(0.4, 2.4, 200)
    for (name, one), colour in zip(demands.items(), (BEFORE, AFTER), strict=True):
        axes.plot(arms, one.moment / arms, color=colour, lw=2.0, label=name)
    axes.axhspan(printed.min(), printed.max(), color=FLOOR, alpha=0.25, lw=0)
    axes.text(2.38, printed.max() + 2, "normal forces that the paper prints", ha="right", color=GREY)
    for arm, name in ((1.0, "end face"), (1.5, "side wall")):
        axes.axvline(arm, color=INK, lw=1.0, ls=":")
        axes.text(arm + 0.02, 148, f"{name}: at most {arm:g} m", color=INK)
    axes.set_xlabel("lever arm of the normal force [m]")
    axes.set_ylabel("step of force over 0.4 s [N]")
    axes.set_ylim(0, 160)
    axes.set_xlim(0.4, 2.4)
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.9))
    return figure


def _draw_pair(passages: Mapping[str, Passage], height: float, rows: int):
    figure = new_figure(height)
    grid = [[dress(figure.add_subplot(rows, 2, 2 * row + column + 1)) for column in range(2)] for row in range(rows)]
    for axes, (name, passage) in zip(grid[0], passages.items(), strict=True):
        axes.set_title(name)
        for row in grid:
            place = row[grid[0].index(axes)]
            place.axvline(0.0, color=INK, lw=0.8, ls=":")
            place.set_xlim(float(passage.time[0]), float(passage.time[-1]))
    for axes in grid[-1]:
        axes.set_xlabel("time since the impact [s]")
    return figure, grid


@styled
def draw_precession(passages: Mapping[str, Passage]):
    """Figures 18 and 19: precession rate, |L|/I_t."""
    figure, grid = _draw_pair(passages, 2.6, 1)
    for axes, passage in zip(grid[0], passages.values(), strict=True):
        axes.plot(passage.time, np.degrees(np.linalg.norm(passage.rates[:, :2], axis=1)), color=AFTER, lw=1.8)
        axes.set_ylim(0, None)
    grid[0][0].set_ylabel("precession rate [°/s]")
    return figure


@styled
def draw_nutation(passages: Mapping[str, Passage]):
    """Figures 20 and 21: angle between axis and momentum, and between axis and the base frame's Z."""
    figure, grid = _draw_pair(passages, 2.9, 1)
    for axes, passage in zip(grid[0], passages.values(), strict=True):
        height = np.asarray(rotate(jnp.asarray(passage.attitude), jnp.array([0.0, 0.0, 1.0])))[:, 2]
        momentum = passage.rates * np.diag(np.asarray(Cylinder().inertia()))
        angle = np.arctan2(np.linalg.norm(momentum[:, :2], axis=1), momentum[:, 2])
        axes.plot(passage.time, np.degrees(angle), color=AFTER, lw=2.0, label="to the momentum")
        axes.plot(passage.time, np.degrees(np.arccos(np.clip(height, -1, 1))), color=BEFORE, lw=1.4, label="to Z")
        axes.set_ylim(0, 180)
    grid[0][0].set_ylabel("angle of the axis [°]")
    grid[0][0].legend(loc="lower left", ncols=2)
    return figure


@styled
def draw_rates(passages: Mapping[str, Passage]):
    """Figure 22: angular velocity in the base frame before and after."""
    figure, grid = _draw_pair(passages, 2.9, 1)
    for axes, passage in zip(grid[0], passages.values(), strict=True):
        rates = np.degrees(np.asarray(rotate(jnp.asarray(passage.attitude), jnp.asarray(passage.rates))))
        for column, (name, colour) in enumerate(zip("XYZ", (BEFORE, AFTER, GREY), strict=True)):
            axes.plot(passage.time, rates[:, column], color=colour, lw=1.8, label=name)
    grid[0][0].set_ylabel("angular velocity [°/s]")
    grid[0][0].legend(loc="lower right", ncols=3)
    return figure


@styled
def draw_stages(passage: Passage, duration: float = 40.0, count: int = 5):
    """Figure 23: the axis of the stage over equal times before and after the impact of Table 6."""
    figure = new_figure(3.8)
    for column, (name, start) in enumerate((("before", -duration), ("after", 1.0))):
        axes = figure.add_subplot(1, 2, column + 1, projection="3d")
        axes.set_title(f"{name}: {count} attitudes over {duration:g} s")
        for k, time in enumerate(np.linspace(start, start + duration, count)):
            attitude = passage.attitude[np.argmin(np.abs(passage.time - time))]
            ends = np.asarray(rotate(jnp.asarray(attitude), jnp.array([[0.0, 0.0, -1.5], [0.0, 0.0, 1.5]])))
            axes.plot(*ends.T, color=KIN if k else AFTER, lw=5.0 if k == 0 else 3.0, alpha=1.0 if k == 0 else 0.75)
        axes.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], zticks=[-1, 0, 1], xlim=(-1.5, 1.5), ylim=(-1.5, 1.5),
                 zlim=(-1.5, 1.5))
        axes.set_box_aspect((1, 1, 1))
        for set_label, label in ((axes.set_xlabel, "X [m]"), (axes.set_ylabel, "Y [m]"), (axes.set_zlabel, "Z [m]")):
            set_label(label)
    return figure


@styled
def draw_displacement(passage: Passage, velocity: np.ndarray):
    """Figure 24: X and Y of the end-face centre A, without and with the motion that the impulse gives the stage."""
    figure = new_figure(3.4)
    path = np.asarray(trace_point(jnp.asarray(passage.attitude), Cylinder().end_face()))
    drift = np.maximum(passage.time, 0.0)[:, None] * velocity
    for column, (name, places) in enumerate((("centre held, as the paper assumes", path),
                                             ("centre free", path + drift))):
        axes = dress(figure.add_subplot(1, 2, column + 1), "both")
        for part, colour, label in ((passage.time < 0, BEFORE, "before"), (passage.time >= 0, AFTER, "after")):
            axes.plot(*places[part, :2].T, color=colour, lw=1.6, label=label)
        axes.set_title(name)
        axes.set_xlabel("X of A [m]")
        axes.set_aspect("equal", adjustable="datalim")
    figure.axes[0].set_ylabel("Y of A [m]")
    figure.axes[0].legend(loc="upper left", ncols=2)
    return figure


SHOWN = 300.0  # s, on either side of the impact


def write_detumbling(peaks: np.ndarray, measured: np.ndarray, theory: np.ndarray, friction: float):
    """The section, and what `paper.json` says of it.

    Args:
        peaks, measured, theory: normal forces of Figure 8 and Table 3, shape (records,) [N].
        friction: measured friction over normal force [-].
    """
    from ..reports.page import Section

    printed = np.sort(np.concatenate([peaks, measured, theory]))
    tables = {name: read_momentum(name.lower().replace(" ", "-")) for name in ("Table 5", "Table 6")}
    demands = {name: find_demand(table, printed, friction) for name, table in tables.items()}
    passages = {name: follow_impact(table, SHOWN, SHOWN) for name, table in tables.items()}
    own = strike_stage(tables["Table 5"].before)
    five, six = demands.values()
    start = tables["Table 5"].before
    nutation = measure_angle(start, np.array([0.0, 0.0, 1.0]))
    best = 1.0 - np.cos(nutation)
    largest = float(printed[-1])
    side, end = five.forces.keys()
    impulse = {name: one.moment * IMPACT_TIME / arm for (name, one), arm in zip(demands.items(), (1.5, 1.0),
                                                                               strict=True)}
    speed = impulse["Table 6"] / 1000.0
    after = {name: float(np.linalg.norm(passage.momentum)) for name, passage in passages.items()}
    sentence = (
        f"Table 5 takes {five.taken:.2f} N m s, a moment of {five.moment:.1f} N m over {IMPACT_TIME:g} s: at the "
        f"largest lever arm that a normal force has on this stage, 1.5 m, that is {five.forces[side]:.1f} N all the "
        f"time, above every normal force that the paper prints (at most {largest:.1f} N, which would need "
        f"{five.arms.min():.2f} m). Table 6 takes {six.taken:.2f} N m s: {six.moment:.1f} N at the 1.0 m of an end "
        f"face, within the printed range.")
    lines = [("table", "momentum taken [N m s]", "share [%]", "moment over 0.4 s [N m]", f"force: {side} [N]",
              f"force: {end} [N]", f"with friction {friction:.3f}: {side} [N]", f"{end} [N]",
              "turn of the momentum [°]", "axis off the plane across L, at most [°]")]
    lines += [(name, f"{one.taken:.3f}", f"{100 * one.share:.2f}", f"{one.moment:.2f}", *(
        f"{force:.1f}" for forces in (one.forces, one.rubbed) for force in forces.values()),
               f"{np.degrees(one.turn):.3f}", f"{np.degrees(one.tilt):.3f}") for name, one in demands.items()]
    mine = [("arm's speed [m/s]", "apparent mass [kg]", "share taken [%]", "peak force [N]", "depression [mm]",
             "contact [ms]")]
    mine += [(f"{row['speed']:g}", f"{row['mass']:g}", f"{100 * row['share']:.2f}", f"{row['peak_force']:.0f}",
              f"{1e3 * row['depression']:.1f}", f"{1e3 * row['time']:.0f}") for row in own]
    half, few = 0.5 * np.pi, sample_steps()
    mass, peak = find_mass(own, five.share)
    drift = _find_drift(tables["Table 6"].before, speed)
    section = Section(
        "Tables 5 and 6, Figures 18 to 24: the impacts on the tumbling stage",
        [sentence,
         f"The force, the lever arm and the attitude are not printed; only their product is. With friction of the "
         f"measured {friction:.3f} that acts for the same moment, Table 5 needs {five.rubbed[side]:.1f} N at the rim "
         f"of the side wall, which the paper's ball has reached. A force that rises and falls as a half sine, as "
         f"Section 4 says of the real one, has a peak {half:.2f} times as high ({half * five.forces[side]:.0f} and "
         f"{half * six.forces[end]:.0f} N without friction).",
         f"Attitude (row 10 of the list): the momentum keeps its direction within "
         f"{np.degrees(max(five.turn, six.turn)):.2f}°. A normal force on a cylinder has no moment about its axis, so "
         f"that part of the momentum stays: the momentum must have stood across the axis within "
         f"{np.degrees(five.tilt):.2f}° (Table 5) and {np.degrees(six.tilt):.2f}° (Table 6). That is a flat spin "
         f"without any spin about the axis, not the general tumbling of Figure 16. From a nutation angle of "
         f"{np.degrees(nutation):.1f}°, with the stage's axes along X, Y, Z, one frictionless impact takes at most "
         f"{100 * best:.1f} %; {100 * five.share:.1f} % is out of its reach below {np.degrees(five.least):.1f}°.",
         f"Step (row 11): {IMPACT_TIME:g} s are two steps of {STEP:g} s. That does for a step of force; of a half sine "
         f"two steps of Euler's method see {100 * few:.1f} % of the impulse. Here steps are adapted and the contact "
         f"ends where it ends.",
         f"With the attitude that the tables need, a step of moment of {five.moment:.1f} and {six.moment:.1f} N m "
         f"along the momentum leaves {after['Table 5']:.3f} and {after['Table 6']:.3f} N m s. Precession slows down "
         f"by the same shares; the angle between axis and momentum is 90° before and after, so a reduced nutation "
         f"angle (Figures 20 and 21) does not follow; the angle to a fixed axis swings as far as before, more slowly.",
         f"The same impulses ({impulse['Table 5']:.1f} and {impulse['Table 6']:.1f} N s) push the stage away, at "
         f"{1e3 * impulse['Table 5'] / 1000:.0f} and {1e3 * speed:.0f} mm/s, "
         f"{impulse['Table 5'] / 1000 * DURATION:.0f} and {speed * DURATION:.0f} m in the simulated {DURATION:.0f} s. "
         f"The paper takes the centre as held.",
         f"The toolkit's own impacts on that flat spin, both bodies free, frictionless, 2.5 MPa, at {TOUCH:g} m on the "
         f"side wall: the table below. At the arm's {FASTEST:g} m/s an apparent mass of {mass:.1f} kg would take what "
         f"Table 5 says, in a contact far shorter than {IMPACT_TIME:g} s and with a peak of {peak:.0f} N, "
         f"{peak / largest:.0f} times the largest force that the paper prints: the contact law is used there far from "
         f"where it was measured."],
        figures=[
            ("tables-5-6-force", "The force that Tables 5 and 6 need over its lever arm. Shaded: every normal force "
             "that the paper prints.", draw_demand(demands, printed)),
            ("figure-18-19", "Figures 18 and 19: precession rate before and after the impacts.",
             draw_precession(passages)),
            ("figure-20-21", "Figures 20 and 21: angle of the axis to the momentum, which is the nutation angle and "
             "stays, and to the base frame's Z, which swings as far as before and more slowly.",
             draw_nutation(passages)),
            ("figure-22", "Figure 22: angular velocity in the base frame; constant in a flat spin.",
             draw_rates(passages)),
            ("figure-23", "Figure 23: the stage's axis over equal times before and after Table 6's impact; dark: the "
             "first.",
             draw_stages(passages["Table 6"])),
            ("figure-24", "Figure 24: path of the end-face centre A in X and Y, 300 s before and after; right with the "
             "motion that the impulse gives the stage.", draw_displacement(passages["Table 6"], drift)),
        ],
        tables=[lines, mine])  # fmt: skip
    numbers: dict[str, Any] = {
        "sentence": sentence, "largest_printed_force": largest, "friction": friction,
        "tables": {name: {"taken": one.taken, "share": one.share, "turn": float(np.degrees(one.turn)),
                          "moment": one.moment, "forces": one.forces, "forces_with_friction": one.rubbed,
                          "smallest_arm": float(one.arms.min()), "tilt": float(np.degrees(one.tilt)),
                          "least_nutation": float(np.degrees(one.least)), "left": after[name],
                          "impulse": impulse[name]} for name, one in demands.items()},
        "assumed_nutation": float(np.degrees(nutation)), "taken_there_at_most": float(best),
        "two_steps_see": few, "own_impacts": own, "own_mass": mass, "own_peak": peak}
    return section, numbers


def _find_drift(momentum: np.ndarray, speed: float) -> np.ndarray:
    """Velocity of the centre after an impact on the end face's rim of the flat-spinning stage, shape (3,) [m/s].

    The upper end face at +y moves along +z (omega along x); the impulse is against that, along minus the axis.
    """
    return np.asarray(rotate(jnp.asarray(place_stage(momentum)), jnp.array([0.0, 0.0, -speed])))
