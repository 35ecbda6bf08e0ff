"""A wrong record beside a missing effect: each hides the other.

The effects that a search finds with a wrong record are not those it finds without, and only under the right ones is
the record seen to be wrong. So where no model is adequate and one record carries most of what is left, it is left out,
the search is made again, and the record is judged by what that finds.
"""

import dataclasses as dc
from collections.abc import Callable

from ..measurement.campaign import Campaign
from .misfits import measure_record, set_aside, settle
from .suspects import Suspect, find_suspects
from .workbench import Fitted, Workbench


Search = Callable[[Campaign], tuple[Workbench, Fitted] | None]


def find_culprit(workbench: Workbench, fitted: Fitted, search: Search) -> Suspect | None:
    """The record without which a model is found that leaves nothing, and that is plainly at fault under that model.

    Args:
        workbench, fitted: a model that leaves a misfit.
        search: a model that leaves nothing smooth of a campaign and where it was found, or None.

    Returns:
        The record, judged under that model; None where none carries most of the misfit, or it is not beyond doubt.
    """
    limits = workbench.settings.outliers
    keys, count = workbench.records.keys, workbench.records.count
    if count <= limits.fewest:
        return None
    found = {r: measure_record(workbench, workbench.problem, fitted.solution, r) for r in range(count)}
    excess = sum(m.total - m.degrees for m in found.values())
    likely = sorted(found, key=lambda r: found[r].degrees - found[r].total)[:limits.candidates]
    asides = [set_aside(workbench, fitted.solution, r) for r in likely]
    aside = min(asides, key=lambda a: a.rest.total / max(a.rest.degrees, 1))
    if aside.own.p_value * count > limits.p_value or aside.rest.total - aside.rest.degrees > (1.0 - limits.removed) * excess:
        return None
    key = keys[aside.record]
    answer = search(workbench.campaign.select([k for k in workbench.campaign.record_keys if k != key]))
    if answer is None:
        return None
    bench, better = answer
    u = workbench.guess.copy()
    for name in better.solution.names:
        u[workbench.space.index[name]] = better.solution.u[bench.space.index[name]]
    there = settle(workbench.problem, better.solution.names, u, fitted.solution.z)
    suspects = find_suspects(workbench, dc.replace(fitted, effects=better.effects, solution=there))
    return next((s for s in suspects if s.sure and s.key == key), None)
