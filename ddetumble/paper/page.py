"""`ddetumble paper`: the paper beside the toolkit, computed and written as one page."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .._sentences import say
from ..contact.law import Ball
from ..contact.shell import InflatedShell
from ..inference.files import write_json
from . import contradictions, friction, peaks
from .detumbling import list_simulation_points, write_detumbling
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

    figure, forces, slipped = (judge_table("figure-8", "initial_pressure"), judge_table("table-3", "initial_pressure"),
                               friction.judge_friction())
    assert forces.printed is not None
    printed, stated, rubbed = forces.printed, read_errors("table-3"), friction.read_friction(slipped)
    masses = peaks.vary_restitution(figure)
    mass = masses[peaks.RESTITUTIONS.index(peaks.KEPT)]["mass"]
    times = {name: peaks.time_impacts(peaks.fit_mass(figure.campaign, Ball(**contradictions.READINGS[name][0])))
             for name in ("ours", "quarter", "area")}
    found = contradictions.list_contradictions(
        {"measured": forces.values, "printed": printed, "printed_error": stated},
        {"pressure": figure.x, "peak": figure.values}, times) + contradictions.list_friction_points(rubbed)
    earlier = peaks.fit_mass(forces.campaign, Ball(truncated=True))
    shell = [100 * float(np.max(np.abs(peaks.read_peaks(peaks.fit_mass(one.campaign, InflatedShell())) / one.values
                                       - 1.0))) for one in (figure, forces)]
    found += contradictions.list_wall_points({"measured": forces.values, "printed": printed, "pressure": forces.x},
                                             peaks.read_mass(earlier), peaks.read_peaks(earlier), shell)
    misses = next(point.values for point in found if point.row == 8)
    figures = {
        "row-01-readings": contradictions.draw_readings(), "row-02-core": contradictions.draw_core(),
        "row-03-pressure": contradictions.draw_pressure(), "row-04-restitution": contradictions.draw_restitution(),
        "row-05-rest": friction.draw_rest(rubbed["load"]), "row-06-range": friction.draw_range(rubbed["load"]),
        "row-07-errors": contradictions.draw_errors(forces.values, printed, stated),
        "row-08-abscissae": contradictions.draw_ranges(misses, forces.values, figure.x / 1e6, figure.values),
        "row-09-duration": contradictions.draw_duration(figure.x, figure.values, mass),
        "row-12-sign": contradictions.draw_sign(mass),
        "row-13-errors": friction.draw_friction_errors(rubbed["measured"], rubbed["printed"], rubbed["printed_error"]),
        "row-14-earlier": contradictions.draw_earlier(),
        "row-15-parabola": contradictions.draw_parabola(printed, forces.reference.fitted),
        "row-16-inflation": contradictions.draw_inflation(),
    }  # fmt: skip
    pages, numbers = friction.write_friction(slipped, rubbed, misses)
    tumbling, motion = write_tumbling()
    mean, spread = friction.find_ratio(slipped)
    detumbling, impacts = write_detumbling(figure.values, forces.values, printed, mean)
    found += list_simulation_points(impacts)
    points = {point.row: point for point in sorted(found, key=lambda point: point.row)}
    drawn = {int(name[4:6]): name for name in figures}
    sections = [
        write_section("paper.points", {}, points=list(points.values())), write_section("paper.coverage", {}),
        write_section("paper.drawn", figures, drawn=[(name, points[row]) for row, name in drawn.items()],
                      others=[point for row, point in points.items() if row not in drawn]),
        peaks.write_figure_8(figure, masses), peaks.write_table_3(forces, peaks.read_as_gauge(forces)),
        peaks.write_corrections(forces), *pages, tumbling, detumbling]
    worst = 100 * float(np.max(np.abs(figure.reference.fitted / figure.values - 1.0)))
    sentence = say("paper.summary", points=len(points), worst=worst, verdict=forces.found.verdict,
                   effects=list(forces.found.effects), mean=mean, spread=spread)
    judged = {"Figure 8": figure, "Table 3": forces, "Table 4": slipped}
    for row, point in points.items():
        echo(f"{row:2d}  {point.sentence}")
    for name, one in judged.items():
        echo(f"{name}: {one.found.sentence}")
    for told in (numbers["band"], motion, impacts):
        echo(told["sentence"])
    facts = [(name, one.found.verdict.replace("-", " "), f"{len(one.values)} {'forces' if one is slipped else 'peaks'}")
             for name, one in judged.items()]
    page = write_page("The paper beside the toolkit: normal force, friction, free rotation, impacts", sentence,
                      sections, folder, facts=facts)
    write_json(Path(folder) / "paper.json", {
        "contradictions": list(points.values()), "figure-8": {**figure.to_dict(), "by_restitution": masses},
        "table-3": forces.to_dict(), "table-4": {**slipped.to_dict(), **numbers}, "free_rotation": motion,
        "impacts": impacts})
    return page
