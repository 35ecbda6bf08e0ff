"""Figures of the stage before and after the impacts of Tables 5 and 6, the counterparts of Figures 18 to 24."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from .._rotation import rotate
from ..dynamics.bodies import Cylinder
from ..dynamics.rigid import trace_point
from ..figures.style import AFTER, BEFORE, FLOOR, GREY, INK, KIN, dress, new_figure, styled
from .detumbling import Demand, Passage


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
