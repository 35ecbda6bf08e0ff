r"""The paper's rocket stage in free rotation (Section 5, Figures 16 and 17): what its printed momentum decides.

Tables 5 and 6 print the angular momentum, Section 5 mass and size. Neither the attitude nor the angular velocity is
printed. Here the body frame coincides with the base frame $OXYZ$ at t = 0, so that the rates are $\omega_0 = I^{-1} L$.
"""

import dataclasses as dc
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._rotation import measure_turn
from ..dynamics.angles import measure_motion, measure_precession
from ..dynamics.bodies import Cylinder
from ..dynamics.elliptic import quarter_period
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import Tumble, trace_point
from ..dynamics.tumbling import simulate_tumbling
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PALE, dress, new_figure, styled
from .tables import find_data


DURATION, STEP = 2000.0, 0.2  # s, section 5: 10,000 steps
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


@dc.dataclass(frozen=True)
class Momentum:
    """One of Tables 5 and 6, base-frame components.

    Attributes:
        before, after: the impact, shape (3,) [N m s].
    """

    before: np.ndarray
    after: np.ndarray

    @property
    def share(self) -> float:
        """|L| after the impact over |L| before [-]."""
        return float(np.linalg.norm(self.after) / np.linalg.norm(self.before))

    @property
    def turn(self) -> float:
        """Angle between the two [rad]."""
        return measure_angle(self.before, self.after)


@dc.dataclass(frozen=True)
class Course:
    """Free motion of the stage.

    Attributes:
        motion: times, attitudes, rates.
        angles: precession, nutation and spin about the momentum, without jumps, shape (times, 3) [rad].
        precession_rate: shape (times,) [rad/s].
        path: of the end-face centre A in the base frame, shape (times, 3) [m].
        tilt: angle between the stage's axis and the base frame's Z, shape (times,) [rad].
    """

    motion: Tumble
    angles: np.ndarray
    precession_rate: np.ndarray
    path: np.ndarray
    tilt: np.ndarray


def read_momentum(name: str) -> Momentum:
    """Angular momentum of `table-5` or `table-6`."""
    import pandas as pd

    rows = pd.read_csv(find_data(f"paper/{name}") / "angular-momentum.csv").set_index("axis").loc[["x", "y", "z"]]
    before, after = (1e-3 * rows[f"angular_momentum_{when}"].to_numpy(float) for when in ("before", "after"))
    return Momentum(before, after)


def measure_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two vectors, 0 to pi, with all digits also where it is small [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def vary_moments(asymmetry: float) -> np.ndarray:
    r"""Principal moments $(I_t (1 + \epsilon), I_t (1 - \epsilon), I_a)$ of the stage, shape (3,) [kg m²]."""
    return np.diag(np.asarray(Cylinder().inertia())) * [1.0 + asymmetry, 1.0 - asymmetry, 1.0]


def follow_stage(momentum: np.ndarray, moments: np.ndarray, times: np.ndarray) -> Course:
    """Free motion in closed form from the assumed attitude.

    Args:
        momentum: in the base frame, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²].
        times: from 0 on, shape (times,) [s].
    """
    motion = propagate_torque_free(moments, UNTURNED, momentum / moments, times)
    inertia = jnp.asarray(moments)
    path = np.asarray(trace_point(motion.attitude, Cylinder().end_face()))
    angles = np.asarray(measure_motion(inertia, motion.attitude, motion.angular_velocity))
    rate = np.asarray(measure_precession(inertia, motion.angular_velocity))
    tilt = np.arctan2(np.hypot(path[:, 0], path[:, 1]), path[:, 2])
    return Course(motion, np.unwrap(angles, axis=0), rate, path, tilt)


def integrate_stage(momentum: np.ndarray, moments: np.ndarray, times: np.ndarray) -> Tumble:
    """The same motion by the integrator; arguments as of `follow_stage`."""
    return simulate_tumbling(moments, UNTURNED, momentum / moments, times)


def compare_motions(first: Tumble, second: Tumble) -> tuple[float, float]:
    """Largest angle between the attitudes [rad] and largest difference of a rate [rad/s] at the same times."""
    apart = measure_turn(first.attitude, second.attitude)
    return float(jnp.max(apart)), float(jnp.max(jnp.abs(first.angular_velocity - second.angular_velocity)))


def limit_nutation(momentum: np.ndarray, moments: np.ndarray) -> tuple[float, float]:
    r"""Smallest and largest nutation angle of a stage whose axial moment is the least.

    The momentum crosses the planes $L_x = 0$ and $L_y = 0$ of the body, where $|L|$ and $2E$ leave
    $L_z^2 = (2E - L^2/I_i)/(1/I_z - 1/I_i)$ with $i = y$ and $i = x$.

    Args:
        momentum: body components at any time, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²]; the momentum must circle body z.

    Returns:
        Two angles, 0 to pi/2 [rad].
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    along = (double - square / moments[:2]) / (1.0 / moments[2] - 1.0 / moments[:2])
    angles = np.arccos(np.sqrt(along / square))
    return float(angles.min()), float(angles.max())


def time_nutation(momentum: np.ndarray, moments: np.ndarray) -> float:
    r"""Period of the nutation angle, $2 K(m)/p$ [s]; its limit for equal transverse moments is $\pi I_t/((I_t - I_a)
    |\omega_z|)$.

    With $I_1 \ge I_2 > I_3$: $p^2 = (2E I_1 - L^2)(I_2 - I_3)/(I_1 I_2 I_3)$,
    $m = (I_1 - I_2)(L^2 - 2E I_3)/((I_2 - I_3)(2E I_1 - L^2))$ (Landau and Lifshitz, Mechanics, section 37).

    Args:
        momentum: body components at any time, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²]; the momentum must circle the axis of the least.
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    small, middle, large = np.sort(moments)
    excess = double * large - square
    pace = np.sqrt(excess * (middle - small) / (small * middle * large))
    parameter = (large - middle) * (square - double * small) / ((middle - small) * excess)
    return float(2.0 * quarter_period(jnp.asarray(1.0 - parameter)) / pace)


@styled
def draw_stage(courses: Mapping[str, Course], momentum: np.ndarray, shown: float):
    """Figure 16: the stage with its frames at t = 0, and its angles about the momentum.

    Args:
        courses: of the printed cylinder and, second, of unequal transverse moments, by label.
        momentum: in the base frame, shape (3,) [N m s].
        shown: time up to which the angles are drawn [s].
    """
    figure, space, panels = _divide((1.0, 1.25))
    _draw_frames(space, momentum)
    for (label, course), colour, line in zip(courses.items(), (AFTER, BEFORE), ("-", "--"), strict=True):
        time, part = _begin(course, shown)
        precession, nutation, spin = course.angles[part].T
        panels[0].plot(time, np.degrees(nutation), line, color=colour, lw=1.8, label=label)
        for angle in (precession, spin):
            panels[1].plot(time, angle / (2.0 * np.pi), line, color=colour, lw=1.8)
        panels[2].plot(time, np.degrees(course.precession_rate[part]), line, color=colour, lw=1.8)
    named = ("nutation [°]", "angles [turns]", "precession\nrate [°/s]")
    for axes, name in zip(panels, named, strict=True):
        axes.set_ylabel(name)
        axes.set_xlim(0, shown)
        axes.tick_params(labelbottom=axes is panels[2])
    panels[0].set_ylim(30, 60)
    panels[0].legend(loc="upper left", ncols=2)
    panels[0].set_title("about the angular momentum")
    for name, angle, place in (("precession", precession, (-90, -8)), ("spin", spin, (-14, -20))):
        panels[1].annotate(name, (shown, angle[-1] / (2.0 * np.pi)), place, textcoords="offset points", ha="right")
    panels[2].set_xlabel("time [s]")
    return figure


@styled
def draw_path(courses: Mapping[str, Course], momentum: np.ndarray, shown: float):
    """Figure 17: the path of the end-face centre A in the base frame, and its components over time.

    Args:
        courses: of the printed cylinder and, second, of unequal transverse moments, by label.
        momentum: in the base frame, shape (3,) [N m s].
        shown: time up to which the components are drawn [s].
    """
    figure, space, panels = _divide((1.15, 1.0))
    (plain, round_one), (uneven, other) = courses.items()
    space.plot(*other.path.T, color=BEFORE, lw=0.5, alpha=0.6, label=uneven)
    space.plot(*round_one.path.T, color=AFTER, lw=2.2, label=plain)
    space.plot(*round_one.path[:1].T, "o", color=INK, ms=5)
    x, y, z = 1.12 * round_one.path[0]
    space.text(x, y, z, "A at t = 0", color=INK, fontsize=8.5)
    _draw_arrow(space, 1.9 * momentum / np.linalg.norm(momentum), "L", INK)
    space.legend(loc="upper left")
    _set_space(space, (-1.0, 1.4), (-1.7, 0.7), (-0.4, 2.0))
    for axes, column, name in zip(panels, range(3), "XYZ", strict=True):
        for course, colour, line in ((round_one, AFTER, "-"), (other, BEFORE, "--")):
            time, part = _begin(course, shown)
            axes.plot(time, course.path[part, column], line, color=colour, lw=1.6)
        axes.set_ylabel(f"{name} of A [m]")
        axes.set_xlim(0, shown)
        axes.tick_params(labelbottom=column == 2)
    panels[2].set_xlabel("time [s]")
    return figure


@styled
def draw_changes(round_ones: Mapping[str, Course], uneven: Mapping[str, Course], shown: float):
    """Two readings of a changing nutation angle, before and after the impacts of Tables 5 and 6.

    Args:
        round_ones: of the printed cylinder, by label.
        uneven: of unequal transverse moments, by the same labels.
        shown: time up to which they are drawn [s].
    """
    figure = new_figure(3.4)
    left, right = (dress(axes) for axes in figure.subplots(1, 2))
    for axes, courses, value in ((left, round_ones, "tilt"), (right, uneven, "nutation")):
        for (label, course), colour in zip(courses.items(), (GREY, AFTER, BEFORE), strict=True):
            time, part = _begin(course, shown)
            angle = course.tilt if value == "tilt" else course.angles[:, 1]
            axes.plot(time, np.degrees(angle[part]), color=colour, lw=1.6, label=label)
        axes.set_xlim(0, shown)
        axes.set_xlabel("time [s]")
    left.set_ylabel("angle to the base frame's Z [°]")
    left.set_ylim(0, 118)
    left.set_title("printed cylinder")
    left.legend(loc="upper left", ncols=3, fontsize=8.5)
    right.set_ylabel("angle to the momentum [°]")
    right.set_ylim(36, 46)
    right.set_title("unequal transverse moments")
    return figure


def _divide(widths: tuple[float, float]) -> tuple:
    """A figure with a scene in space on the left and three panels over time on the right."""
    figure = new_figure(4.6)
    grid = figure.add_gridspec(3, 2, width_ratios=widths)
    space = figure.add_subplot(grid[:, 0], projection="3d")
    return figure, space, [dress(figure.add_subplot(grid[row, 1])) for row in range(3)]


def _begin(course: Course, shown: float) -> tuple[np.ndarray, slice]:
    """Times up to `shown` [s], and where they stand."""
    time = np.asarray(course.motion.time)
    part = slice(int(np.searchsorted(time, shown, side="right")))
    return time[part], part


def _draw_frames(axes, momentum: np.ndarray):
    """The cylinder at t = 0 with the base frame, the momentum frame's Y_L, its end-face centres, nutation."""
    body = Cylinder()
    radius, half = float(body.radius), 0.5 * float(body.length)
    turn = np.linspace(0.0, 2.0 * np.pi, 61)
    for height in (-half, half):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), np.full_like(turn, height), color=GREY, lw=1.2)
    for angle in turn[:-1:5]:
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        axes.plot([x, x], [y, y], [-half, half], color=PALE, lw=0.8)
    axes.plot([0, 0], [0, 0], [-half, half], color=FLOOR, lw=1.0, ls="-.")
    for name, height in (("A", half), ("B", -half)):
        axes.plot([0], [0], [height], "o", color=INK, ms=4)
        axes.text(0.12, 0.12, height, name, color=INK, fontsize=9.5)
    for k, (name, length) in enumerate((("X", 2.4), ("Y", 2.4), ("Z", 2.4))):
        _draw_arrow(axes, length * np.eye(3)[k], name, KIN)
    along = momentum / np.linalg.norm(momentum)
    _draw_arrow(axes, 2.4 * along, "L, Y_L", BEFORE)
    nutation = np.arccos(along[2])
    side = along - along[2] * np.eye(3)[2]
    arc = np.linspace(0.0, nutation, 30)[:, None]
    bow = 0.9 * (np.cos(arc) * np.eye(3)[2] + np.sin(arc) * side / np.linalg.norm(side))
    axes.plot(*bow.T, color=BEFORE, lw=1.2)
    axes.text(*(1.25 * bow[14]), f"{np.degrees(nutation):.1f}°", color=BEFORE, fontsize=9.5, ha="center")
    _set_space(axes, (-1.9, 1.9), (-1.9, 1.9), (-1.9, 1.9))
    axes.set_axis_off()


def _draw_arrow(axes, tip: np.ndarray, name: str, colour: str):
    axes.plot(*np.stack([np.zeros(3), tip], axis=-1), color=colour, lw=1.4)
    axes.text(*(1.1 * tip), name, color=colour, fontsize=9.5, ha="center", va="center")


def _set_space(axes, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]):
    """Equal scales, a view from which the momentum of Tables 5 and 6 lies across, labels of the base frame."""
    axes.set(xlim=x, ylim=y, zlim=z, xlabel="X [m]", ylabel="Y [m]")
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel("Z [m]", rotation=90)
    axes.set_box_aspect((x[1] - x[0], y[1] - y[0], z[1] - z[0]))
    axes.view_init(elev=22, azim=25)
    axes.tick_params(labelsize=8)


ASYMMETRIES = (0.0, 0.02, 0.05, 0.1, 0.2)
DRAWN = 0.1  # relative difference of the transverse moments in the figures, an assumption
SHOWN = 300.0  # s


def examine_stage() -> tuple[dict[str, Any], dict[str, Any]]:
    """Motion of the stage from Table 5's momentum.

    Returns:
        The numbers for `paper.json`, SI units and angles in degrees; the figures by name.
    """
    tables = {"Table 5": read_momentum("table-5"), "Table 6": read_momentum("table-6")}
    start = tables["Table 5"].before
    times = STEP * np.arange(round(DURATION / STEP) + 1)
    alike, unlike = (vary_moments(asymmetry) for asymmetry in (0.0, DRAWN))
    free, uneven = follow_stage(start, alike, times), follow_stage(start, unlike, times)
    turns, rates = zip(*(compare_motions(course.motion, integrate_stage(start, moments, times))
                         for course, moments in ((free, alike), (uneven, unlike))), strict=True)
    size, along = float(np.linalg.norm(start)), start / np.linalg.norm(start)
    heights = free.path @ along
    rate = size / alike[0]
    shares = {"before": 1.0, **{f"after {name}": table.share for name, table in tables.items()}}
    numbers = {
        "moments": alike.tolist(), "momentum": size, "duration": DURATION, "step": STEP,
        "nutation": float(np.degrees(free.angles[:, 1].mean())),
        "nutation_change": float(np.degrees(np.ptp(free.angles[:, 1]))),
        "precession_rate": rate, "spin_rate": float((free.angles[-1, 2] - free.angles[0, 2]) / DURATION),
        "precessions": float((free.angles[-1, 0] - free.angles[0, 0]) / (2.0 * np.pi)),
        "circle": {"radius": float(np.mean(np.linalg.norm(free.path - heights[:, None] * along, axis=1))),
                   "height": float(heights.mean())},
        "tilt": [float(np.degrees(free.tilt.min())), float(np.degrees(free.tilt.max()))],
        "integration": {"attitude": max(turns), "rate": max(rates)},
        "cases": {when: {"share": share, "precession_rate": share * rate, "precession_period": 2 * np.pi / rate / share}
                  for when, share in shares.items()},
        "directions": {name: float(np.degrees(table.turn)) for name, table in tables.items()},
        "between_tables": float(np.degrees(measure_angle(start, tables["Table 6"].before))),
        "asymmetry": [{"asymmetry": one, "nutation": np.degrees(limit_nutation(start, vary_moments(one))).tolist(),
                       "period": time_nutation(start, vary_moments(one)) if one else None} for one in ASYMMETRIES],
    }  # fmt: skip
    both = {"printed cylinder": free, f"transverse moments 1 ± {DRAWN:g}": uneven}
    plain, other = ({when: follow_stage(share * start, moments, times) for when, share in shares.items()}
                    for moments in (alike, unlike))
    return numbers, {"figure-16": draw_stage(both, start, SHOWN),
                     "figure-17": draw_path(both, start, SHOWN),
                     "figure-20-nutation": draw_changes(plain, other, SHOWN)}


def describe_stage(found: dict[str, Any]) -> str:
    """The one sentence on nutation, with its numbers."""
    row = next(row for row in found["asymmetry"] if row["asymmetry"] == DRAWN)
    low, high = row["nutation"]
    return (f"The paper speaks of tumbling with a changing nutation angle, but without torque the printed cylinder "
            f"keeps its angle to the momentum ({found['nutation']:.1f}° at the assumed start) for good; unequal "
            f"transverse moments would make it change (1 ± {DRAWN:g}: {low:.1f} to {high:.1f}°), and so would "
            f"measuring it from a fixed axis.")


def write_tumbling():
    """The section, and what `paper.json` says of it."""
    from ..reports.page import Section

    found, drawn = examine_stage()
    cases, tilt = found["cases"], found["tilt"]
    before, five, six = cases.values()
    sentence = describe_stage(found)
    periods = [row["period"] for row in found["asymmetry"] if row["period"]]
    rows = [("transverse moments", "smallest nutation [°]", "largest nutation [°]", "period of nutation [s]")]
    rows += [(f"1 ± {row['asymmetry']:g}" if row["asymmetry"] else "equal, as printed",
              *(f"{angle:.2f}" for angle in row["nutation"]),
              f"{row['period']:.1f}" if row["period"] else "–") for row in found["asymmetry"]]
    turns = [("momentum", "share of |L| left", "precession rate [rad/s]", "time of one precession [s]")]
    turns += [(when, f"{case['share']:.4f}", f"{case['precession_rate']:.5f}", f"{case['precession_period']:.1f}")
              for when, case in cases.items()]
    section = Section(
        "Figures 16 and 17: the stage in free rotation, and which nutation can change",
        [f"{sentence} Two readings remain: three unequal moments, or an angle to an axis of the base frame.",
         f"What agrees with the paper: 1000 kg, 1 m and 3 m make a cylinder of {found['moments'][0]:.0f} and "
         f"{found['moments'][2]:.0f} kg m²; its precession rate is |L|/I_t whatever the attitude, "
         f"{before['precession_rate']:.4f} rad/s from the momentum of Table 5, {found['precessions']:.1f} turns in "
         f"{DURATION:.0f} s; after the impacts it is {100 * (1 - five['share']):.1f} and "
         f"{100 * (1 - six['share']):.1f} % lower, and every cycle takes longer in the same measure "
         f"({before['precession_period']:.0f} s before, {five['precession_period']:.0f} and "
         f"{six['precession_period']:.0f} s after). A moves on a circle about the momentum.",
         f"What does not follow: that the nutation angle is reduced by the impact. A torque along the momentum, which "
         f"is what the paper says and what both tables show within {max(found['directions'].values()):.2f}°, leaves "
         f"the succession of attitudes as it was and only slows it down, for any moments: each reading's range of "
         f"angles is the same before and after.",
         f"What the paper leaves open, and what is assumed here: the attitude and the rates at the start (here the "
         f"body frame coincides with OXYZ, and the components of Table 5 are taken in it; the momentum before the "
         f"impact differs by {found['between_tables']:.3f}° between Tables 5 and 6); the order of the Euler angles and "
         f"the axes X_L and Z_L (here precession about Y_L along the momentum, nutation about the line of nodes, spin "
         f"about the stage's axis; nutation and both rates do not depend on it); the places P₁ and P₂. No number of "
         f"Figures 16 to 24 is printed, so the curves themselves cannot be checked.",
         f"What would decide between the readings is the period of Figure 20's curve before the impact: "
         f"{before['precession_period']:.1f} s for an angle of the printed cylinder to any fixed axis, at the assumed "
         f"start {min(periods):.1f} to {max(periods):.1f} s for unequal moments up to 1 ± {ASYMMETRIES[-1]:g}.",
         f"All motion here is the closed form; the integrator, at the paper's {round(DURATION / STEP):,} steps of "
         f"{STEP:g} s, agrees with it to {found['integration']['attitude']:.0e} rad and "
         f"{found['integration']['rate']:.0e} rad/s."],
        figures=[
            ("figure-16", "Figure 16: the stage at t = 0, where its axes lie along X, Y, Z, with the momentum of "
             "Table 5 along Y_L; right, its angles and precession rate. P₁ and P₂ are not printed. The dashed stage "
             "has unequal transverse moments, an assumption.", drawn["figure-16"]),
            ("figure-17", f"Figure 17: the path of the end-face centre A in the base frame over {DURATION:.0f} s. The "
             f"printed cylinder: a circle of {found['circle']['radius']:.2f} m about the momentum, "
             f"{found['circle']['height']:.2f} m from the centre of mass; with unequal moments a band.",
             drawn["figure-17"]),
            ("figure-20-nutation", f"The two readings of a changing nutation angle before and after the impacts, all "
             f"from the same attitude. Left: the printed cylinder's angle to Z, {tilt[0]:.0f} to {tilt[1]:.1f}°. "
             f"Right: the angle to the momentum with transverse moments 1 ± {DRAWN:g}. Slower after the impacts, not "
             f"smaller.",
             drawn["figure-20-nutation"]),
        ],
        tables=[turns, rows])  # fmt: skip
    return section, {"sentence": sentence, **found}
