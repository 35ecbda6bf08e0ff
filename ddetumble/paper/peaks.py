"""Figure 8 and Table 3: peaks of impacts, judged by the toolkit's verbs, and what the paper alone has beside them."""

import dataclasses as dc
import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..contact.law import AbstractReference, Ball
from ..dynamics.impact import follow
from ..effects.impact import GasLeak, SensorGain
from ..families.impact import WINDOW, read_values
from ..figures.palette import AFTER, BEFORE, FLOOR, GREY, INK, KIN, OTHER
from ..figures.style import dress, new_axes, new_figure, point_at, styled
from ..inference.estimation import fit
from ..inference.findings import Fit
from ..inference.parameters import ParameterSpace
from ..measurement.campaign import Campaign
from ..selection.discover import discover
from ..selection.discovery import Discovery
from ..selection.predict import predict_pulses
from .rivals import Judged, Row, compare_rows, draw_differences, draw_ladder, draw_models, make_row
from .section import write_section


ATMOSPHERE = 101325.0  # Pa, the standard atmosphere
RESTITUTIONS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.99)  # over all that a rubber ball may have: peaks do not tell them apart
KEPT = 0.7  # restitution of our model: that of `Ball` by default
# Parameter, range that is scanned, words.
CHANGES = (
    ("sensor-gain.g", (0.85, 1.05), "a sensor that reads low"),
    ("gas-leak.lambda", (0.0, 14.0), "gas that leaks during contact"),
    ("contact_radius_coefficient", (0.62, 0.82), "a smaller contact disc (b over depression)"),
    ("effective_mass", (0.75, 1.15), "a smaller effective mass (share of the fitted one)"),
    ("initial_pressure", (0.7, 1.1), "gas lost before the impact (share that is left)"),
)


def fit_exponent(pressures: np.ndarray, peaks: np.ndarray) -> tuple[float, float]:
    r"""Exponent $p$ of $F \propto P_0^p$, and its standard error."""
    (slope, _), covariance = np.polyfit(np.log(pressures), np.log(peaks), 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def fit_mass(campaign: Campaign, reference: AbstractReference, restitution: float = KEPT) -> Fit:
    """A reference model with the effective mass that fits some peaks best, its restitution held."""
    return fit(campaign, reference, fixed={"restitution": restitution})


def read_mass(found: Fit) -> float:
    """Effective mass of a fit [kg]."""
    return found.parameters["effective_mass"].estimate


def read_peaks(found: Fit) -> np.ndarray:
    """Peak forces of a fit, shape (records,) [N]."""
    return found.solution.channels[:, 0, 0]


def time_impacts(found: Fit) -> np.ndarray:
    """Contact times of the impacts of a campaign under a model that was fitted to it, shape (records,) [s]."""
    records = found.source.records.rename_axis("record").reset_index()
    return predict_pulses(found, records)["contact_duration"].to_numpy(dtype=float)


def vary_restitution(judged: Judged) -> list[dict[str, float]]:
    """How the fit of Figure 8's peaks depends on the restitution that peaks cannot show.

    Returns:
        One dict a restitution: `restitution`, `mass` [kg], `worst` deviation [-], contact times `first` and `last` [s].
    """
    found = []
    for e in RESTITUTIONS:
        own = fit_mass(judged.campaign, Ball(), e)
        lasting = time_impacts(own)
        found.append({"restitution": e, "mass": read_mass(own), "first": float(lasting.max()),
                      "last": float(lasting.min()),
                      "worst": float(np.max(np.abs(read_peaks(own) / judged.values - 1.0)))})
    return found


def read_as_gauge(judged: Judged) -> Discovery:
    """The same table with its pressures read as gauge, the atmosphere added, judged again."""
    campaign = judged.campaign
    records = campaign.records.assign(initial_pressure=judged.x + ATMOSPHERE)
    return discover(dc.replace(campaign, records=records))


@partial(jax.jit, static_argnums=0)
def compute_peaks(space: ParameterSpace, u: Array, conditions: Mapping[str, Array]) -> Array:
    """Peak forces of impacts at coordinates, shape (impacts, parameters), and conditions, shape (impacts,) [N]."""
    def one(place, own):
        law = space.build(place)
        motion = follow(law, own, jnp.asarray(WINDOW), 1e-6, 1e-8)
        return read_values(law, own, motion)[0]["peak_normal_force"]

    return jax.vmap(one)(u, conditions)


def correct_printed(judged: Judged, mass: float) -> tuple[list[Row], dict[str, np.ndarray]]:
    r"""Multiply the printed column by what one physical change does to our model, $F_{printed} F(\theta)/F(\theta_0)$.

    Pressures are read as gauge here (the atmosphere is added), so that every row has gas for a change to act on.

    Args:
        judged: Table 3.
        mass: effective mass of our model [kg].

    Returns:
        One row a change, and the fitted ratio of each, shape (records,), by label.
    """
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    assert judged.printed is not None
    printed, values, count = judged.printed, judged.values, len(judged.values)
    space, table = ParameterSpace(Ball(), (SensorGain, GasLeak)), judged.campaign.records
    conditions = {"initial_pressure": judged.x + ATMOSPHERE, "approach_speed": table["approach_speed"].to_numpy(float)}

    def compute(name: str, grid: np.ndarray) -> np.ndarray:
        """Peaks at every place of a grid, shape (grid, records) [N]."""
        own = {key: np.tile(value, len(grid)) for key, value in conditions.items()}
        if name in own:
            own[name] = own[name] * np.repeat(grid, count)
        size = mass if name == "effective_mass" else 1.0
        places = [space.coordinates({"effective_mass": mass} | ({} if name in own else {name: share * size}))
                  for share in grid]
        return np.asarray(compute_peaks(space, np.repeat(places, count, axis=0), own)).reshape(len(grid), count)

    rows, ratios = [], {}
    for name, (low, high), words in CHANGES:
        grid = np.linspace(low, high, 13)
        curve = CubicSpline(grid, np.log(compute(name, grid) / compute("initial_pressure", np.ones(13))), axis=0)

        def search(keep, curve=curve, low=low, high=high):
            found: Any = minimize_scalar(
                lambda t: np.sum((printed * np.exp(curve(t)) / values - 1.0)[keep] ** 2), bounds=(low, high),
                method="bounded", options={"xatol": 1e-7})
            return float(found.x)

        best, left = search(slice(None)), np.array([search(np.arange(count) != k) for k in range(count)])
        spread = float(np.sqrt((count - 1) / count * np.sum((left - left.mean()) ** 2)))  # jackknife
        ratios[words] = np.exp(curve(best))
        at_limit = ", at its limit" if min(best - low, high - best) < 1e-4 else ""
        unit = " 1/s" if name == "gas-leak.lambda" else ""
        symbol = name.rpartition(".")[2].replace("_", " ")
        rows.append(make_row(words, "correction", 1, values, printed * ratios[words],
                             printed * np.exp(np.diagonal(curve(left))),
                             f"{symbol} = {best:.3g} ± {spread:.2g}{unit}{at_limit}"))
    return rows, ratios


@styled
def draw_growth(judged: Judged, growth: tuple[float, float]):
    """Peaks against pressure on logarithmic scales, with growth as P0^(1/3), as P0 and with the fitted exponent."""
    exponent, error = growth
    figure = new_figure(3.6)
    left, right = figure.subplots(1, 2)
    x, y = judged.x / 1e6, judged.values
    middle = np.exp(np.mean(np.log(x))), np.exp(np.mean(np.log(y)))
    fine = np.geomspace(0.9 * x.min(), 1.1 * x.max(), 50)
    for power, label, colour, line in ((1 / 3, "P0 to the power 1/3: a mass on F ~ P0 δ²", AFTER, "--"),
                                       (1.0, "P0 to the power 1: a press at fixed stroke", GREY, ":"),
                                       (exponent, f"P0 to the power {exponent:.2f} ± {error:.2f} (fit)", BEFORE, "-")):
        left.plot(fine, middle[1] * (fine / middle[0]) ** power, line, color=colour, lw=1.5, label=label)
    left.plot(x, y, "o", color=INK, ms=6, label="measured", zorder=4)
    left.set(xscale="log", yscale="log")
    for axis in (left.xaxis, left.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    left.set(xticks=[1.0, 1.5, 2.0, 2.5], yticks=[40, 50, 60, 70, 80], ylim=(40, 85), xlabel="pressure [MPa]",
             ylabel="peak normal force [N]")
    left.legend(loc="upper left")
    for row, colour, mark in ((judged.reference, AFTER, "s"), (judged.polynomial, OTHER, "D")):
        right.plot(x, 100 * (row.fitted / y - 1.0), f"-{mark}", color=colour, lw=1.2, label=row.label)
    right.axhspan(-3.5, 3.5, color=FLOOR, alpha=0.15, lw=0)
    right.axhline(0, color=FLOOR, lw=0.8)
    dress(left, "")
    dress(right).set(ylim=(-6, 6), xlabel="pressure [MPa]", ylabel="deviation from the measured peak [%]")
    right.legend(loc="upper right")
    point_at(right, "± 3.5 %", (x.min(), -3.5), (0, 3), color=GREY, fontsize=8.5)
    return figure


@styled
def draw_corrections(judged: Judged, ratios: Mapping[str, np.ndarray], rows: Sequence[Row], factor: float):
    """What single changes, with their rows and fitted ratios by label, and one factor do to the printed theory."""
    figure, axes = new_axes(3.4)
    x = judged.x / 1e6
    axes.plot(x, judged.values / judged.printed, "o", color=INK, ms=6, label="measured / printed theory", zorder=4)
    axes.axhline(factor, color=GREY, lw=1.2, ls=":", label=f"one factor, {factor:.3f}")
    for row, colour, line in zip(rows, (OTHER, BEFORE, AFTER, KIN, INK), ("-", "-", "--", "-.", ":"), strict=True):
        axes.plot(x, ratios[row.label], line, color=colour, lw=1.8,
                  label=f"{row.label}: left out {100 * row.heldout:.2f} %")
    axes.set(ylim=(0.905, 1.015), xlabel="pressure [MPa]", ylabel="ratio to the printed theory")
    axes.legend(loc="upper right", ncols=2, fontsize=8.5)
    return figure


def write_figure_8(judged: Judged, masses: Sequence[Mapping[str, float]]):
    """The section on Figure 8; `masses` are from `vary_restitution`."""
    exponent = fit_exponent(judged.x, judged.values)
    figures = {"figure-8-growth": draw_growth(judged, exponent), "figure-8-ladder": draw_ladder(judged)}
    spans = [one["worst"] for one in masses]
    return write_section(
        "paper.figure_8", figures, [judged.tabulate(judged.polynomial)], sentence=judged.found.sentence,
        notes=judged.found.notes, masses=masses, least=min(spans), most=max(spans),
        worst=100 * float(np.max(np.abs(judged.reference.fitted / judged.values - 1.0))), exponent=exponent[0],
        error=exponent[1], reference=judged.reference, polynomial=judged.polynomial)


def write_table_3(judged: Judged, gauge: Discovery):
    """The section on Table 3; `gauge` is from `read_as_gauge`."""
    labels = [judged.reference.label, judged.polynomial.label, "printed theory × one factor",
              *(row.label for row in judged.rows[-1:] if row is not judged.reference)]
    figures = {
        "table-3-models": draw_models(judged, labels), "table-3-ladder": draw_ladder(judged),
        "table-3-differences": draw_differences(
            [compare_rows(row, judged.polynomial) for row in judged.rows if row is not judged.polynomial],
            "mean |error| of the first minus that of the second [percentage points]"),
    }  # fmt: skip
    singles = [one.heldout_nrmse for one in judged.found.candidates if not one.beyond]
    return write_section(
        "paper.table_3", figures, [judged.tabulate(judged.polynomial), judged.tabulate_effects()],
        sentence=judged.found.sentence, notes=judged.found.notes,
        zero=float(judged.values[0]), empty=float(judged.reference.fitted[0]), gauge=gauge,
        polynomial=judged.polynomial, factor=judged.find("printed theory × one factor"),
        best=min(one for one in singles if np.isfinite(one)))


def write_corrections(judged: Judged):
    """The section on what could make the printed theory too high by one factor."""
    assert judged.printed is not None
    rows, ratios = correct_printed(judged, read_mass(fit_mass(judged.campaign, Ball())))
    one = judged.find("printed theory × one factor")
    factor = float(one.fitted[0] / judged.printed[0])
    left = one.fitted / judged.values - 1.0
    sd = factor * float(np.sqrt(np.sum(left**2) / (len(left) - 1) / len(left)))
    gaps = {row.label: compare_rows(row, one) for row in rows}
    alike = [row for row in rows if not gaps[row.label].told]
    pairs = [compare_rows(a, b) for a, b in itertools.combinations(alike, 2)]
    drawn = draw_corrections(judged, ratios, rows, factor)
    return write_section(
        "paper.corrections", {"table-3-corrections": drawn}, factor=factor, sd=sd, rms=one.heldout, worst=one.worst,
        alike=[row.label for row in alike], pairs=len(pairs),
        other=[row.label for row in rows if gaps[row.label].told], close=sum(not pair.told for pair in pairs),
        rows=[(row, gaps[row.label]) for row in rows])
