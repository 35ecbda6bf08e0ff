"""Tables 5 and 6 and Figures 18 to 24 as a section of the booklet."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .._rotation import rotate
from . import detumbling_figures as figures
from .detumbling import (
    FASTEST,
    IMPACT_TIME,
    TOUCH,
    find_demand,
    find_mass,
    follow_impact,
    list_forces,
    place_stage,
    sample_steps,
    strike_stage,
)
from .free_tumbling import DURATION, STEP, measure_angle, read_momentum


SHOWN = 300.0  # s, on either side of the impact


def write_detumbling(peaks: np.ndarray, measured: np.ndarray, theory: np.ndarray, friction: float):
    """The section, and what `paper.json` says of it.

    Args:
        peaks, measured, theory: normal forces of Figure 8 and Table 3, shape (records,) [N].
        friction: measured friction over normal force [-].
    """
    from ..reports.page import Section

    printed = list_forces(peaks, measured, theory)
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
             "that the paper prints.", figures.draw_demand(demands, printed)),
            ("figure-18-19", "Figures 18 and 19: precession rate before and after the impacts.",
             figures.draw_precession(passages)),
            ("figure-20-21", "Figures 20 and 21: angle of the axis to the momentum, which is the nutation angle and "
             "stays, and to the base frame's Z, which swings as far as before and more slowly.",
             figures.draw_nutation(passages)),
            ("figure-22", "Figure 22: angular velocity in the base frame; constant in a flat spin.",
             figures.draw_rates(passages)),
            ("figure-23", "Figure 23: the stage's axis over equal times before and after Table 6's impact; dark: the "
             "first.",
             figures.draw_stages(passages["Table 6"])),
            ("figure-24", "Figure 24: path of the end-face centre A in X and Y, 300 s before and after; right with the "
             "motion that the impulse gives the stage.", figures.draw_displacement(passages["Table 6"], drift)),
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
