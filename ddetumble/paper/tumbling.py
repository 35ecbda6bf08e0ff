r"""The paper's rocket stage in free rotation (Section 5, Figures 16 and 17): what its printed momentum decides.

Tables 5 and 6 print the angular momentum, Section 5 mass and size. Neither the attitude nor the angular velocity is
printed. Here the body frame coincides with the base frame $OXYZ$ at t = 0, so that the rates are $\omega_0 = I^{-1} L$.
"""

import dataclasses as dc
from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from .._rotation import measure_turn
from .._sentences import say
from .._settings import find_data
from ..dynamics.angles import measure_motion, measure_precession
from ..dynamics.bodies import Cylinder
from ..dynamics.elliptic import quarter_period
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import Tumble, simulate_tumbling, trace_point
from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PALE
from ..figures.style import dress, new_axes, new_figure, point_at, styled
from .section import write_section


DURATION, STEP = 2000.0, 0.2  # s, section 5: 10,000 steps
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
# Relative differences of the transverse moments, from the printed cylinder to a plainly unequal stage.
ASYMMETRIES = (0.0, 0.02, 0.05, 0.1, 0.2)
DRAWN = 0.1  # relative difference of the transverse moments in the figures, an assumption
SHOWN = 300.0  # s, of the simulated 2000: more would draw the curves too densely to read


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

    file = find_data() / "paper" / name / "angular-momentum.csv"
    rows = pd.read_csv(file).set_index("axis").loc[["x", "y", "z"]]
    return Momentum(*(1e-3 * rows[f"angular_momentum_{when}"].to_numpy(float) for when in ("before", "after")))


def measure_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two vectors, 0 to pi, with all digits also where it is small [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def vary_moments(asymmetry: float) -> np.ndarray:
    r"""Principal moments $(I_t (1 + \epsilon), I_t (1 - \epsilon), I_a)$ of the stage, shape (3,) [kg m²]."""
    return np.diag(np.asarray(Cylinder().inertia())) * [1.0 + asymmetry, 1.0 - asymmetry, 1.0]


def follow_stage(momentum: np.ndarray, moments: np.ndarray, times: np.ndarray) -> Course:
    """Free motion in closed form from the assumed attitude, of a momentum in the base frame [N m s] and principal
    moments [kg m²], shapes (3,), at times from 0 on [s].
    """
    motion = propagate_torque_free(moments, UNTURNED, momentum / moments, times)
    inertia = jnp.asarray(moments)
    path = np.asarray(trace_point(motion.attitude, Cylinder().end_face()))
    angles = np.asarray(measure_motion(inertia, motion.attitude, motion.angular_velocity))
    rate = np.asarray(measure_precession(inertia, motion.angular_velocity))
    tilt = np.arctan2(np.hypot(path[:, 0], path[:, 1]), path[:, 2])
    return Course(motion, np.unwrap(angles, axis=0), rate, path, tilt)


def limit_nutation(momentum: np.ndarray, moments: np.ndarray) -> tuple[float, float]:
    r"""Smallest and largest nutation angle, 0 to pi/2 [rad], of a stage whose axial moment is the least.

    The momentum crosses the planes $L_x = 0$ and $L_y = 0$ of the body, where $|L|$ and $2E$ leave $L_z^2 = (2E -
    L^2/I_i)/(1/I_z - 1/I_i)$ with $i = y$ and $i = x$. It has body components at any time [N m s] and must circle body
    z; the moments are the principal ones [kg m²].
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    along = (double - square / moments[:2]) / (1.0 / moments[2] - 1.0 / moments[:2])
    angles = np.arccos(np.sqrt(along / square))
    return float(angles.min()), float(angles.max())


def time_nutation(momentum: np.ndarray, moments: np.ndarray) -> float:
    r"""Period of the nutation angle, $2 K(m)/p$ [s]; its limit for equal transverse moments is $\pi I_t/((I_t - I_a)
    |\omega_z|)$.

    With $I_1 \ge I_2 > I_3$: $p^2 = (2E I_1 - L^2)(I_2 - I_3)/(I_1 I_2 I_3)$, $m = (I_1 - I_2)(L^2 - 2E I_3)/((I_2 -
    I_3)(2E I_1 - L^2))$ (Landau and Lifshitz, Mechanics, section 37). The momentum, body components at any time [N m
    s], must circle the axis of the least of the principal moments [kg m²].
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    small, middle, large = np.sort(moments)
    excess = double * large - square
    pace = np.sqrt(excess * (middle - small) / (small * middle * large))
    parameter = (large - middle) * (square - double * small) / ((middle - small) * excess)
    return float(2.0 * quarter_period(jnp.asarray(1.0 - parameter)) / pace)


@styled
def draw_stage(courses: Mapping[str, Course], momentum: np.ndarray):
    """Figure 16: the stage with its frames at t = 0, and its angles about the momentum, shape (3,) [N m s].

    By label the courses of the printed cylinder and, second, of unequal transverse moments.
    """
    figure, space, panels = _divide((1.0, 1.25), ("nutation [°]", "angles [turns]", "precession\nrate [°/s]"))
    _draw_frames(space, momentum)
    for (label, course), colour, line in zip(courses.items(), (AFTER, BEFORE), ("-", "--"), strict=True):
        time, part = _begin(course)
        precession, nutation, spin = course.angles[part].T
        panels[0].plot(time, np.degrees(nutation), line, color=colour, lw=1.8, label=label)
        for angle in (precession, spin):
            panels[1].plot(time, angle / (2.0 * np.pi), line, color=colour, lw=1.8)
        panels[2].plot(time, np.degrees(course.precession_rate[part]), line, color=colour, lw=1.8)
    panels[0].set(ylim=(30, 60), title="about the angular momentum")
    panels[0].legend(loc="upper left", ncols=2)
    for name, angle, place in (("precession", precession, (-90, -8)), ("spin", spin, (-14, -20))):
        point_at(panels[1], name, (SHOWN, angle[-1] / (2.0 * np.pi)), place, ha="right")
    return figure


@styled
def draw_path(courses: Mapping[str, Course], momentum: np.ndarray):
    """Figure 17: the path of the end-face centre A in the base frame; courses and momentum as in Figure 16."""
    figure, space, panels = _divide((1.15, 1.0), ("X of A [m]", "Y of A [m]", "Z of A [m]"))
    (plain, round_one), (uneven, other) = courses.items()
    space.plot(*other.path.T, color=BEFORE, lw=0.5, alpha=0.6, label=uneven)
    space.plot(*round_one.path.T, color=AFTER, lw=2.2, label=plain)
    space.plot(*round_one.path[:1].T, "o", color=INK, ms=5)
    space.text(*(1.12 * round_one.path[0]), "A at t = 0", color=INK, fontsize=8.5)
    _draw_arrow(space, 1.9 * momentum / np.linalg.norm(momentum), "L", INK)
    space.legend(loc="upper left")
    _set_space(space, (-1.0, 1.4), (-1.7, 0.7), (-0.4, 2.0))
    for column, axes in enumerate(panels):
        for course, colour, line in ((round_one, AFTER, "-"), (other, BEFORE, "--")):
            time, part = _begin(course)
            axes.plot(time, course.path[part, column], line, color=colour, lw=1.6)
    return figure


@styled
def draw_changes(round_ones: Mapping[str, Course], uneven: Mapping[str, Course]):
    """Two readings of a changing nutation angle, before and after the impacts: the printed cylinder, and another."""
    figure, left, right = new_axes(3.4, columns=2)
    for axes, courses in ((left, round_ones), (right, uneven)):
        for (label, course), colour in zip(courses.items(), (GREY, AFTER, BEFORE), strict=True):
            time, part = _begin(course)
            angle = course.tilt if axes is left else course.angles[:, 1]
            axes.plot(time, np.degrees(angle[part]), color=colour, lw=1.6, label=label)
        axes.set(xlim=(0, SHOWN), xlabel="time [s]")
    left.set(ylabel="angle to the base frame's Z [°]", ylim=(0, 118), title="printed cylinder")
    left.legend(loc="upper left", ncols=3, fontsize=8.5)
    right.set(ylabel="angle to the momentum [°]", ylim=(36, 46), title="unequal transverse moments")
    return figure


def _divide(widths: tuple[float, float], labels: tuple[str, str, str]) -> tuple:
    """A figure with a scene in space on the left and three panels over time on the right."""
    figure = new_figure(4.6)
    grid = figure.add_gridspec(3, 2, width_ratios=widths)
    space = figure.add_subplot(grid[:, 0], projection="3d")
    panels = [dress(figure.add_subplot(grid[row, 1])) for row in range(3)]
    for axes, label in zip(panels, labels, strict=True):
        axes.set(xlim=(0, SHOWN), ylabel=label)
        axes.tick_params(labelbottom=axes is panels[2])
    panels[2].set_xlabel("time [s]")
    return figure, space, panels


def _begin(course: Course) -> tuple[np.ndarray, slice]:
    """Times that are shown [s], and where they stand."""
    time = np.asarray(course.motion.time)
    part = slice(int(np.searchsorted(time, SHOWN, side="right")))
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
    for axis, name in zip(2.4 * np.eye(3), "XYZ", strict=True):
        _draw_arrow(axes, axis, name, KIN)
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


def write_tumbling():
    """The section, and what `paper.json` says of it: SI units, angles in degrees."""
    tables = {"Table 5": read_momentum("table-5"), "Table 6": read_momentum("table-6")}
    start = tables["Table 5"].before
    times = STEP * np.arange(round(DURATION / STEP) + 1)
    alike, unlike = vary_moments(0.0), vary_moments(DRAWN)
    free, uneven = follow_stage(start, alike, times), follow_stage(start, unlike, times)
    turns, rates = [], []  # between closed form and integrator
    for course, moments in ((free, alike), (uneven, unlike)):
        motion = simulate_tumbling(moments, UNTURNED, start / moments, times)
        turns.append(float(jnp.max(measure_turn(course.motion.attitude, motion.attitude))))
        rates.append(float(jnp.max(jnp.abs(course.motion.angular_velocity - motion.angular_velocity))))
    size, along = float(np.linalg.norm(start)), start / np.linalg.norm(start)
    heights, rate = free.path @ along, size / alike[0]
    turned = free.angles[-1] - free.angles[0]
    shares = {"before": 1.0, **{f"after {name}": table.share for name, table in tables.items()}}
    nutation = free.angles[:, 1]
    numbers = {
        "moments": alike.tolist(), "momentum": size, "duration": DURATION, "step": STEP,
        "nutation": float(np.degrees(nutation.mean())), "nutation_change": float(np.degrees(np.ptp(nutation))),
        "precession_rate": rate, "spin_rate": float(turned[2] / DURATION),
        "precessions": float(turned[0] / (2.0 * np.pi)),
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
    low, high = np.degrees(limit_nutation(start, unlike))
    found = {"sentence": say("paper.nutation", angle=numbers["nutation"], drawn=DRAWN, low=low, high=high), **numbers}
    both = {"printed cylinder": free, f"transverse moments 1 ± {DRAWN:g}": uneven}
    plain, other = ({when: follow_stage(share * start, moments, times) for when, share in shares.items()}
                    for moments in (alike, unlike))
    figures = {"figure-16": draw_stage(both, start), "figure-17": draw_path(both, start),
               "figure-20-nutation": draw_changes(plain, other)}
    periods = [row["period"] for row in numbers["asymmetry"] if row["period"]]
    return write_section("paper.free_rotation", figures, found=found, duration=DURATION, step=STEP, drawn=DRAWN,
                         periods=periods), found
