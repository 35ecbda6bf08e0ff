"""Figures of the paper's rocket stage in free rotation: its frames and angles, the path of an end-face centre."""

from collections.abc import Mapping

import numpy as np

from ..dynamics.bodies import Cylinder
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, PALE, dress, new_figure, styled
from .free_tumbling import Course


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
