"""A table of the paper as the toolkit's verbs judge it, beside models without physics: the printed theory, and a low
polynomial, each value predicted by a fit without it."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from .._settings import find_data
from ..families.values import choose_degree, fit_linear, polynomial
from ..figures.palette import AFTER, BEFORE, GREY, INK, KIN, OTHER
from ..figures.style import new_axes, point_at, styled
from ..inference.archive import Model
from ..inference.files import make_plain
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from ..selection.compare import Comparison, compare
from ..selection.discover import discover
from ..selection.discovery import Discovery
from ..selection.result import Estimate


WORDS = {"initial_pressure": "pressure", "normal_load": "load"}
FAILED = 10.0  # error over the RMS of the values beyond which a model fails
NAMES = {1: "straight line", 2: "parabola", 3: "cubic"}
COLOURS = {"printed": GREY, "polynomial": OTHER, "physics": AFTER, "effect": BEFORE, "reading": KIN}


@dc.dataclass(frozen=True)
class Row:
    """One model of a column of values.

    Attributes:
        label: what the model is, for people.
        kind: `printed`, `polynomial`, `physics`, `reading` or `correction`.
        free: how many numbers were fitted.
        fitted: values of the fit, shape (records,), SI.
        out: absolute errors of each value as predicted by a fit without it, over the RMS of the values, shape
            (records,) [-].
        nrmse: RMS error of the fit over the RMS of the values [-].
        remark: estimates, or one phrase where something has to be said.
    """

    label: str
    kind: str
    free: int
    fitted: np.ndarray
    out: np.ndarray
    nrmse: float
    remark: str = ""

    @property
    def heldout(self) -> float:
        """RMS of the left-out errors over that of the values [-]."""
        return float(np.sqrt(np.mean(self.out**2)))

    @property
    def worst(self) -> float:
        """Largest left-out error over the RMS of the values [-]."""
        return float(np.max(self.out))


class Difference(NamedTuple):
    """Paired difference of two models' left-out errors: mean of those of the first less those of the second [-]."""

    first: str
    second: str
    mean: float
    error: float  # standard error of the mean, records taken as independent

    @property
    def told(self) -> bool:
        """Whether the two differ by more than two standard errors."""
        return abs(self.mean) > 2.0 * self.error


def make_row(label: str, kind: str, free: int, values: np.ndarray, fitted: np.ndarray, held: np.ndarray,
             remark: str = "") -> Row:
    """A row from fitted values and from those that fits without each record predict, all of shape (records,)."""
    size = np.sqrt(np.mean(values**2))
    return Row(label, kind, free, fitted, np.abs(held - values) / size,
               float(np.sqrt(np.mean((fitted - values) ** 2)) / size), remark)


def fit_columns(label: str, kind: str, columns: np.ndarray, values: np.ndarray, remark: str = "") -> Row:
    """A row of a linear model, fitted to relative errors; `columns` have the shape (records, terms)."""
    return make_row(label, kind, columns.shape[1], values, *fit_linear(columns, values, 1.0 / values), remark)


def list_polynomials(x: np.ndarray, values: np.ndarray, along: str) -> list[Row]:
    """Polynomials over a condition, and last that of the degree with the smallest left-out error.

    That one's left-out errors come from a degree that was chosen anew without the record.
    """
    rows = [fit_columns(f"{NAMES[degree]} in {WORDS[along]}", "polynomial", polynomial(x, degree), values)
            for degree in range(1, min(3, len(np.unique(x)) - 2) + 1)]
    held = np.empty(len(values))
    for k in range(len(values)):
        rest = np.arange(len(values)) != k
        columns = polynomial(x, choose_degree(x[rest], values[rest], 1.0 / values[rest]))
        weighted = columns[rest] / values[rest, None]
        held[k] = columns[k] @ np.linalg.lstsq(weighted, np.ones(rest.sum()), rcond=None)[0]
    degree = choose_degree(x, values, 1.0 / values)
    fitted, _ = fit_linear(polynomial(x, degree), values, 1.0 / values)
    return [*rows, make_row(f"low polynomial (degree {degree})", "polynomial", degree + 1, values, fitted, held,
                            "degree by leave-one-out, chosen anew without each record")]


def compare_rows(first: Row, second: Row) -> Difference:
    """Paired difference of two models' left-out errors."""
    gap = first.out - second.out
    return Difference(first.label, second.label, float(gap.mean()), float(gap.std(ddof=1) / np.sqrt(len(gap))))


@dc.dataclass(frozen=True)
class Judged:
    """One table of the paper, judged by `discover` and `compare`.

    Attributes:
        campaign: the table as it is packaged.
        channel, along: what was measured, and the condition over which polynomials run.
        x, values, printed: that condition, the measured and the theoretical values, shape (records,), SI; no theory
            where the paper prints none.
        found: what `discover` returned.
        compared: what `compare` returned of each model, the reference model first.
        rows: models side by side: printed, polynomials, physics.
    """

    campaign: Campaign
    channel: str
    along: str
    x: np.ndarray
    values: np.ndarray
    printed: np.ndarray | None
    found: Discovery
    compared: tuple[Comparison, ...]
    rows: tuple[Row, ...]

    @property
    def reference(self) -> Row:
        """The reference model's row."""
        return next(row for row in self.rows if row.kind == "physics")

    @property
    def polynomial(self) -> Row:
        """The row of the low polynomial."""
        return [row for row in self.rows if row.kind == "polynomial"][-1]

    def find(self, label: str) -> Row:
        """The row of that label."""
        return next(row for row in self.rows if row.label == label)

    def tabulate(self, against: Row) -> pd.DataFrame:
        """All rows side by side, errors in per cent of the RMS of the values, with paired differences from one."""
        lines = []
        for row in self.rows:
            gap = compare_rows(row, against)
            lines.append({
                "model": row.label, "fitted": row.free, "fit: RMS [%]": round(100 * row.nrmse, 2),
                "left out: RMS [%]": round(100 * row.heldout, 2), "left out: worst [%]": round(100 * row.worst, 2),
                f"behind: {against.label} [%]":
                    "–" if row is against else f"{100 * gap.mean:+.2f} ± {100 * gap.error:.2f}", "": row.remark})
        return pd.DataFrame(lines)

    def tabulate_effects(self) -> pd.DataFrame:
        """The catalogue as `discover` ranked it."""
        return pd.DataFrame([{
            "our model and": one.effect, "explains [%]": f"{100 * one.explains:.1f}",
            "left out: RMS [%]": f"{100 * one.heldout_nrmse:.2f}" if one.heldout_nrmse < FAILED else "fails",
            "cannot be distinguished from": ", ".join(one.indistinguishable_from[:4]),
            "": "beyond what physics allows" if one.beyond else ""} for one in self.found.candidates])

    def to_dict(self) -> dict[str, Any]:
        """What `result.json` of `discover` holds, and the models side by side."""
        models = [{"model": r.label, "kind": r.kind, "free": r.free, "nrmse": r.nrmse, "heldout_nrmse": r.heldout,
                   "heldout_worst": r.worst, "remark": r.remark} for r in self.rows]
        return {**self.found.to_dict(), "models": make_plain(models)}


def judge_table(name: str, along: str, models: Sequence[Model] = ("paper",)) -> Judged:
    """Judge one of the paper's tables by `discover`, and the named models by `compare`, the reference model first.

    What `discover` made of the reference model is compared, too.
    """
    campaign = read_campaign(find_data() / "paper" / name)
    assert campaign.peaks is not None
    channel = next(one for one in campaign.peak_columns if one.startswith("peak_"))
    table = campaign.records.join(campaign.peaks)
    x, values = (table[one].to_numpy(dtype=float) for one in (along, channel))
    theory = f"printed_{channel}"
    printed = table[theory].to_numpy(dtype=float) if theory in table else None
    found = discover(campaign)
    compared = tuple(compare(campaign, model) for model in (*models, *([found] if found.effects else ())))
    rows = []
    if printed is not None:
        rows += [make_row("printed theory as it stands", "printed", 0, values, printed, printed),
                 fit_columns("printed theory × one factor", "printed", printed[:, None], values)]
    rows += list_polynomials(x, values, along)
    rows += [read_row(one) for one in compared[: len(models)]]
    rows += [read_row(one, found.steps[-1].parameters) for one in compared[len(models):]]
    return Judged(campaign, channel, along, x, values, printed, found, compared, tuple(rows))


def read_row(one: Comparison, parameters: Mapping[str, Estimate] | None = None) -> Row:
    """The row of a comparison of a model with values; `parameters` are those of a model that was fitted before."""
    name = " + ".join((one.model.split(" + ")[0], *one.effects))
    told = "; ".join(f"{key} = {p.estimate:.3g} ± {p.sd:.2g} {p.unit}".rstrip()
                     for key, p in (parameters or one.parameters).items())
    return Row(f"model {name}", "physics", one.free, np.array([trace.model[0] for trace in one.traces]),
               np.sqrt(one.heldout_squares * len(one.traces)), one.nrmse, told)


@styled
def draw_ladder(judged: Judged, most: int = 26):
    """Left-out errors of all models and of the reference model with every effect, the low polynomial's as the line."""
    bars = [(row.label, row.heldout, row.kind, f", {row.free} fitted") for row in judged.rows]
    added = {row.label for row in judged.rows}
    bars += [(f"our model + {one.effect}", one.heldout_nrmse, "effect", ", not physical" if one.beyond else "")
             for one in judged.found.candidates if f"model {judged.found.model} + {one.effect}" not in added]
    bars = sorted((bar for bar in bars if bar[1] < FAILED), key=lambda bar: bar[1])[:most][::-1]
    line = 100 * judged.polynomial.heldout
    figure, axes = new_axes(0.9 + 0.24 * len(bars), grid="x")
    for i, (_, error, kind, note) in enumerate(bars):
        colour, lacks = COLOURS[kind], "not physical" in note
        axes.barh(i, 100 * min(error, 1.0), height=0.7, edgecolor=colour, color="white" if lacks else colour,
                  hatch="////" if lacks else "")
        point_at(axes, f"{100 * error:.1f} %{note}", (max(100 * min(error, 1.0), line), i), (4, 0), fontsize=8.5,
                 va="center")
    axes.axvline(line, color=INK, lw=0.9, ls="--")
    axes.set_ylim(-0.6, len(bars) - 0.4)
    axes.set_yticks(range(len(bars)), [bar[0] for bar in bars], fontsize=8.5)
    axes.set(xscale="log", xlim=(0.8, 300), xticks=[1, 2, 5, 10, 20, 50, 100],
             xlabel="RMS error on left-out values over their RMS [%]; dashed: the low polynomial")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    return figure


@styled
def draw_differences(pairs: Sequence[Difference], title: str):
    """Paired differences of left-out errors with two standard errors: what crosses zero cannot be told apart."""
    figure, axes = new_axes(0.8 + 0.26 * len(pairs), grid="x")
    for i, pair in enumerate(pairs[::-1]):
        axes.errorbar(100 * pair.mean, i, xerr=200 * pair.error, fmt="o", capsize=3,
                      color=BEFORE if pair.told else GREY)
    axes.axvline(0, color=INK, lw=0.8)
    axes.set_yticks(range(len(pairs)), [f"{p.first}  against  {p.second}" for p in pairs[::-1]], fontsize=8)
    limit = max(min(max(abs(100 * p.mean) + 200 * p.error for p in pairs) * 1.1, 12.0), 1e-3)
    axes.set_xlim(-limit, limit)
    for i, pair in enumerate(pairs[::-1]):
        if abs(100 * pair.mean) > limit:  # its point cannot be seen
            low, told = pair.mean < 0, f"{100 * abs(pair.mean):.1f} ± {100 * pair.error:.1f}"
            axes.annotate(f"← −{told}" if low else f"{told} →", (0.0 if low else 1.0, i), (2 if low else -2, 4),
                          xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=8,
                          ha="left" if low else "right", va="bottom")
    axes.set_xlabel(title)
    return figure


def draw_models(judged: Judged, labels: Sequence[str]):
    """Measured values beside the models of these labels, over the condition that varies most, and their residuals."""
    from ..figures import draw_values

    traces = judged.compared[0].traces
    drawn = {label: [dc.replace(trace, model=np.array([value])) for trace, value in zip(
        traces, judged.find(label).fitted, strict=True)] for label in labels}
    return draw_values(drawn, judged.channel)
