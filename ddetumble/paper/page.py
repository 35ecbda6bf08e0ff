"""`ddetumble paper`: the paper beside the toolkit, computed and written as one page."""

import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._sentences import say
from .._settings import find_data
from ..contact.law import AbstractReference, Ball
from ..contact.shell import InflatedShell
from ..effects import IMPACT
from . import contradictions
from .detumbling import write_detumbling
from .forces import PeakRow, compare_rows, describe_estimates, make_interval
from .friction_page import draw_friction_errors, draw_range, draw_rest, read_friction, write_friction
from .judgement import PeakJudgement, fit_exponent, judge_campaign
from .peak_page import draw_corrections, draw_differences, draw_growth, draw_ladder, draw_values
from .peaks import ATMOSPHERE, NONE, Bench, Recipe, choose_effects
from .section import read_errors, write_section
from .tumbling import write_tumbling


# Parameter, range that is scanned, words.
CHANGES = (
    ("sensor-gain.g", (0.85, 1.05), "a sensor that reads low"),
    ("gas-leak.lambda", (0.0, 14.0), "gas that leaks during contact"),
    ("contact_radius_coefficient", (0.62, 0.82), "a smaller contact disc (b over depression)"),
    ("effective_mass", (0.75, 1.15), "a smaller effective mass (share of the fitted one)"),
    ("initial_pressure", (0.7, 1.1), "gas lost before the impact (share that is left)"),
)


def correct_printed(bench: Bench, mass: float, printed: np.ndarray) -> tuple[list[PeakRow], dict[str, np.ndarray]]:
    r"""Multiply the printed column by what one physical change does to our model, $F_{printed} F(\theta)/F(\theta_0)$.

    Pressures are read as gauge here (the atmosphere is added), so that every row has gas for a change to act on.

    Args:
        bench: the measured peaks, and our model with the effects.
        mass: effective mass of our model [kg].
        printed: the printed theory, shape (records,) [N].

    Returns:
        One row a change, and the fitted ratio of each, shape (records,), by label.
    """
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    forces, place, count = bench.forces, bench.space.coordinates, len(bench.forces)
    conditions = {**forces.conditions, "initial_pressure": forces.x + ATMOSPHERE}

    def compute(values: Mapping[str, float], **changed: np.ndarray) -> np.ndarray:
        x = place({"effective_mass": mass, **values})[None]
        return bench.evaluate(x, NONE, {**conditions, **changed})[0][0]

    rows, ratios = [], {}
    for name, (low, high), words in CHANGES:
        grid = np.linspace(low, high, 13)
        if name == "initial_pressure":
            values = [compute({}, initial_pressure=share * conditions[name]) for share in grid]
        else:
            values = [compute({name: share * (mass if name == "effective_mass" else 1.0)}) for share in grid]
        curve = CubicSpline(grid, np.log(np.array(values) / compute({})), axis=0)

        def fit(keep, curve=curve, low=low, high=high):
            found: Any = minimize_scalar(
                lambda t: np.sum((printed * np.exp(curve(t)) / forces.peaks - 1.0)[keep] ** 2), bounds=(low, high),
                method="bounded", options={"xatol": 1e-7})
            return float(found.x)

        best, left = fit(slice(None)), np.array([fit(np.arange(count) != k) for k in range(count)])
        held = printed * np.exp(np.diagonal(curve(left)))
        spread = float(np.sqrt((count - 1) / count * np.sum((left - left.mean()) ** 2)))  # jackknife
        ratios[words] = np.exp(curve(best))
        value = make_interval(best, spread, "1/s" if name == "gas-leak.lambda" else "")
        rows.append(PeakRow(forces, words, "correction", (), 1, printed * ratios[words], held, {name: value},
                            remark="at its limit" if min(best - low, high - best) < 1e-4 else ""))
    return rows, ratios


# Over all that a rubber ball may have, to show that peaks do not tell them apart.
RESTITUTIONS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.99)
KEPT = 0.7  # restitution of our model: that of `Ball` by default


def write_paper(folder, echo: Callable[[str], object] = print) -> Path:
    """Compare the paper's forces, free rotation and impacts with the toolkit and write the page with its figures.

    Args:
        folder: where to write; made where it is not there.
        echo: told one line at a time what was found.

    Returns:
        Path of `report.html`; `figures/` and `paper.json` stand beside it.
    """
    import json

    from ..measurement.package import read_campaign
    from ..reports.page import write_page

    table, figure, slip = (read_campaign(find_data() / "paper" / name) for name in ("table-3", "figure-8", "table-4"))
    peaks: Any
    forces: Any
    slipped: Any
    peaks, forces, slipped = (judge_campaign(campaign) for campaign in (figure, table, slip))
    assert table.peaks is not None
    printed, stated = table.peaks["printed_peak_normal_force"].to_numpy(float), read_errors("table-3")
    friction, masses = read_friction(slipped), vary_restitution(peaks)
    mass = masses[RESTITUTIONS.index(KEPT)]["mass"]
    times = {"ours": peaks.contact[0], **{name: time_impacts(name, peaks) for name in ("quarter", "area")}}
    points = contradictions.list_contradictions(
        {"measured": forces.peaks, "printed": printed, "printed_error": stated},
        {"pressure": peaks.forces.x, "peak": peaks.peaks}, times) + contradictions.list_friction_points(friction)
    earlier = fit_mass(Ball(truncated=True), forces)
    points += contradictions.list_wall_points(
        {"measured": forces.peaks, "printed": printed, "pressure": forces.forces.x},
        earlier.estimates["effective_mass"]["estimate"], earlier.fitted,
        [100 * fit_mass(InflatedShell(), judged).worst_fit for judged in (peaks, forces)])
    points = {point.number: point for point in sorted(points, key=lambda point: point.number)}
    misses = points[8].values
    worst, exponent = 100 * peaks.reference.worst_fit, fit_exponent(peaks.forces)
    figures = {
        "row-01-readings": contradictions.draw_readings(), "row-02-core": contradictions.draw_core(),
        "row-03-pressure": contradictions.draw_pressure(), "row-04-restitution": contradictions.draw_restitution(),
        "row-05-rest": draw_rest(friction["load"]), "row-06-range": draw_range(friction["load"]),
        "row-07-errors": contradictions.draw_errors(forces.peaks, printed, stated),
        "row-08-abscissae": contradictions.draw_ranges(misses, forces.peaks, peaks.forces.x / 1e6, peaks.peaks),
        "row-09-duration": contradictions.draw_duration(peaks.forces.x, peaks.peaks, mass),
        "row-12-sign": contradictions.draw_sign(mass),
        "row-13-errors": draw_friction_errors(friction["measured"], friction["printed"], friction["printed_error"]),
        "row-14-earlier": contradictions.draw_earlier(),
        "row-15-parabola": contradictions.draw_parabola(printed, forces.reference.fitted),
        "row-16-inflation": contradictions.draw_inflation(),
        "figure-8-growth": draw_growth(peaks, exponent), "figure-8-ladder": draw_ladder(peaks),
        "table-3-models": draw_values(forces), "table-3-ladder": draw_ladder(forces),
        "table-3-differences": draw_differences(
            forces.pairs, "mean |error| of the first minus that of the second [percentage points]"),
    }  # fmt: skip
    pages, numbers = write_friction(slipped, friction, misses)
    tumbling, motion = write_tumbling()
    mean, spread = slipped.ratio
    detumbling, impacts = write_detumbling(peaks.peaks, forces.peaks, printed, mean)
    spans = [one["worst"] for one in masses]
    sections = [
        write_section("paper.points", figures, points=points.values(), elsewhere=contradictions.ELSEWHERE.items(),
                      drawn=[(name, points[int(name[4:6])]) for name in figures if name.startswith("row-")]),
        write_section("paper.figure_8", figures, [peaks.table()], verdict=peaks.verdict, sentence=peaks.sentence,
                      notes=peaks.notes, worst=worst, masses=masses, least=min(spans), most=max(spans),
                      exponent=exponent[0], error=exponent[1]),
        write_section("paper.table_3", figures, [forces.table()], verdict=forces.verdict, sentence=forces.sentence,
                      notes=forces.notes),
        _write_corrections(forces, printed), *pages, tumbling, detumbling]
    sentence = say("paper.summary", points=len(points), worst=worst, verdict=forces.verdict,
                   effects=list(forces.effects), mean=mean, spread=spread)
    judged = {"Figure 8": peaks, "Table 3": forces, "Table 4": slipped}
    for point in points.values():
        echo(f"{point.number:2d}  {point.sentence}")
    for name, one in judged.items():
        echo(f"{name}: {one.verdict}. {one.sentence}")
    for found in (numbers["band"], motion, impacts):
        echo(found["sentence"])
    facts = [(name, one.verdict.replace("-", " "), f"{len(one.peaks)} {'forces' if one is slipped else 'peaks'}")
             for name, one in judged.items()]
    page = write_page("The paper beside the toolkit: normal force, friction, free rotation, impacts", sentence,
                      sections, folder, "report.html", facts=facts)
    result = {"contradictions": [{"row": p.number, "title": p.title, "printed": p.printed, "found": p.found,
                                  "used": p.used, "sentence": p.sentence, "values": p.values} for p in points.values()],
              "figure-8": peaks.to_dict(), "table-3": forces.to_dict(), "table-4": {**slipped.to_dict(), **numbers},
              "free_rotation": motion, "impacts": impacts}
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    (Path(folder) / "paper.json").write_text(text, encoding="utf-8")
    return page


def set_up_bench(judged: PeakJudgement) -> Bench:
    """A bench for the peaks of a judgement with the whole catalogue, which shares the judgement's compiled program."""
    return Bench(Ball(), choose_effects(IMPACT, Ball(), judged.forces.conditions)[0], judged.forces)


def vary_restitution(judged: PeakJudgement) -> list[dict[str, float]]:
    """How the fit of Figure 8's peaks depends on the restitution that peaks cannot show.

    Returns:
        One dict a restitution: `restitution`, `mass` [kg], `worst` deviation [-], contact times `first` and `last` [s].
    """
    bench = set_up_bench(judged)
    recipes = [Recipe(f"e = {e:g}", "reference", (), ("effective_mass",), ({"restitution": e},)) for e in RESTITUTIONS]
    found = []
    for e, row in zip(RESTITUTIONS, bench.solve(recipes), strict=True):
        lasting = bench.contact(row)[0]
        found.append({"restitution": e, "mass": row.estimates["effective_mass"]["estimate"], "worst": row.worst_fit,
                      "first": float(lasting.max()), "last": float(lasting.min())})
    return found


def fit_mass(reference: AbstractReference, judged: PeakJudgement) -> PeakRow:
    """Another reference model with the effective mass that fits the peaks of a judgement best."""
    starts = tuple({"effective_mass": mass} for mass in (0.05, 1.0))
    recipe = Recipe(type(reference).__name__, "reference", (), ("effective_mass",), starts)
    return Bench(reference, (), judged.forces).solve([recipe])[0]


def time_impacts(name: str, judged: PeakJudgement) -> np.ndarray:
    """Contact times [s] under the reading `quarter` or `area`, its mass fitted to the same peaks.

    The doubled core, which moves these times by less than a per cent, is left out of `quarter`.
    """
    if name == "quarter":
        bench, start = set_up_bench(judged), {"effective_mass": 4.0, "contact_radius_coefficient": 0.25}
    else:
        bench = Bench(Ball(**contradictions.READINGS[name][0]), (), judged.forces)
        start = {"effective_mass": 4.0}
    return bench.contact(bench.solve([Recipe(name, "reference", (), ("effective_mass",), (start,))])[0])[0]


def _write_corrections(judged: PeakJudgement, printed: np.ndarray):
    """What could make the printed theory too high by one factor."""
    mass, factor = judged.reference.estimates["effective_mass"]["estimate"], judged.printed[0]
    rows, ratios = correct_printed(set_up_bench(judged), mass, printed)
    value = factor.estimates["factor"]
    gaps = {row.label: compare_rows(row, factor) for row in rows}
    alike = [row for row in rows if not gaps[row.label].told]
    pairs = [compare_rows(a, b) for a, b in itertools.combinations(alike, 2)]
    drawn = draw_corrections(printed, ratios, rows, value["estimate"])
    return write_section(
        "paper.corrections", {"table-3-corrections": drawn}, factor=value["estimate"], sd=value["sd"],
        rms=factor.heldout, worst=factor.worst, alike=[row.label for row in alike], pairs=len(pairs),
        other=[row.label for row in rows if gaps[row.label].told], close=sum(not pair.told for pair in pairs),
        rows=[(row, describe_estimates(row.estimates), gaps[row.label]) for row in rows])
