"""`ddetumble paper`: the paper beside the toolkit, computed and written as one page."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .._sentences import say
from ..contact.law import Ball
from ..contact.shell import InflatedShell
from . import contradictions
from .detumbling import write_detumbling
from .friction import (
    draw_friction_errors,
    draw_range,
    draw_rest,
    find_ratio,
    judge_friction,
    read_friction,
    write_friction,
)
from .peaks import (
    KEPT,
    RESTITUTIONS,
    fit_mass,
    read_as_gauge,
    read_mass,
    read_peaks,
    time_impacts,
    vary_restitution,
    write_corrections,
    write_figure_8,
    write_table_3,
)
from .rivals import judge_table
from .section import read_errors, write_section
from .tumbling import write_tumbling


def write_paper(folder, echo: Callable[[str], object] = print) -> Path:
    """Compare the paper's forces, free rotation and impacts with the toolkit and write the page with its figures.

    Args:
        folder: where to write; made where it is not there.
        echo: told one line at a time what was found.

    Returns:
        Path of `report.html`; `figures/` and `paper.json` stand beside it.
    """
    from ..reports.page import write_page

    peaks, forces, slipped = (judge_table("figure-8", "initial_pressure"), judge_table("table-3", "initial_pressure"),
                              judge_friction())
    assert forces.printed is not None
    printed, stated, friction = forces.printed, read_errors("table-3"), read_friction(slipped)
    masses = vary_restitution(peaks)
    mass = masses[RESTITUTIONS.index(KEPT)]["mass"]
    times = {name: time_impacts(fit_mass(peaks.campaign, Ball(**contradictions.READINGS[name][0])))
             for name in ("ours", "quarter", "area")}
    points = contradictions.list_contradictions(
        {"measured": forces.values, "printed": printed, "printed_error": stated},
        {"pressure": peaks.x, "peak": peaks.values}, times) + contradictions.list_friction_points(friction)
    earlier = fit_mass(forces.campaign, Ball(truncated=True))
    shell = [100 * float(np.max(np.abs(read_peaks(fit_mass(one.campaign, InflatedShell())) / one.values - 1.0)))
             for one in (peaks, forces)]
    points += contradictions.list_wall_points({"measured": forces.values, "printed": printed, "pressure": forces.x},
                                              read_mass(earlier), read_peaks(earlier), shell)
    points = {point.number: point for point in sorted(points, key=lambda point: point.number)}
    misses = points[8].values
    figures = {
        "row-01-readings": contradictions.draw_readings(), "row-02-core": contradictions.draw_core(),
        "row-03-pressure": contradictions.draw_pressure(), "row-04-restitution": contradictions.draw_restitution(),
        "row-05-rest": draw_rest(friction["load"]), "row-06-range": draw_range(friction["load"]),
        "row-07-errors": contradictions.draw_errors(forces.values, printed, stated),
        "row-08-abscissae": contradictions.draw_ranges(misses, forces.values, peaks.x / 1e6, peaks.values),
        "row-09-duration": contradictions.draw_duration(peaks.x, peaks.values, mass),
        "row-12-sign": contradictions.draw_sign(mass),
        "row-13-errors": draw_friction_errors(friction["measured"], friction["printed"], friction["printed_error"]),
        "row-14-earlier": contradictions.draw_earlier(),
        "row-15-parabola": contradictions.draw_parabola(printed, forces.reference.fitted),
        "row-16-inflation": contradictions.draw_inflation(),
    }  # fmt: skip
    pages, numbers = write_friction(slipped, friction, misses)
    tumbling, motion = write_tumbling()
    mean, spread = find_ratio(slipped)
    detumbling, impacts = write_detumbling(peaks.values, forces.values, printed, mean)
    sections = [
        write_section("paper.points", figures, points=points.values(), elsewhere=contradictions.ELSEWHERE.items(),
                      drawn=[(name, points[int(name[4:6])]) for name in figures if name.startswith("row-")]),
        write_figure_8(peaks, masses), write_table_3(forces, read_as_gauge(forces)), write_corrections(forces), *pages,
        tumbling, detumbling]
    worst = 100 * float(np.max(np.abs(peaks.reference.fitted / peaks.values - 1.0)))
    sentence = say("paper.summary", points=len(points), worst=worst, verdict=forces.found.verdict,
                   effects=list(forces.found.effects), mean=mean, spread=spread)
    judged = {"Figure 8": peaks, "Table 3": forces, "Table 4": slipped}
    for point in points.values():
        echo(f"{point.number:2d}  {point.sentence}")
    for name, one in judged.items():
        echo(f"{name}: {one.found.sentence}")
    for found in (numbers["band"], motion, impacts):
        echo(found["sentence"])
    facts = [(name, one.found.verdict.replace("-", " "), f"{len(one.values)} {'forces' if one is slipped else 'peaks'}")
             for name, one in judged.items()]
    page = write_page("The paper beside the toolkit: normal force, friction, free rotation, impacts", sentence,
                      sections, folder, "report.html", facts=facts)
    result = {"contradictions": [{"row": p.number, "title": p.title, "printed": p.printed, "found": p.found,
                                  "used": p.used, "sentence": p.sentence, "values": p.values} for p in points.values()],
              "figure-8": {**peaks.to_dict(), "by_restitution": masses}, "table-3": forces.to_dict(),
              "table-4": {**slipped.to_dict(), **numbers},
              "free_rotation": motion, "impacts": impacts}
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    (Path(folder) / "paper.json").write_text(text, encoding="utf-8")
    return page
