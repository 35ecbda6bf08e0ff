"""Two records whose settings are exchanged, as when files are named the wrong way round.

Each of them spoils the fit without the other, so that neither stands out when records are left out one at a time; and
settings that are moved far enough take most of it.
"""

from itertools import combinations

import numpy as np

from .._errors import ComputationError
from ..inference.problem import Solution, replace_arrays
from ..measurement.faults import Fault
from .leave_record_out import measure_record
from .problem import Fitted, SelectionProblem


def find_exchange(selection: SelectionProblem, fitted: Fitted) -> tuple[str, str] | None:
    """Keys of two records that a model fits far better with the settings of each other; None where there are none.

    Most of the misfit goes then, of settings that were moved included, and nearly all of their own; a single record at
    fault would take its settings to another one, which fitted before. Settings that are
    nearly alike do not count: what scatters may make any two of them fit better exchanged.
    """
    records, stack, limits = selection.records, selection.records.stack, selection.settings.outliers
    names = [str(c) for c in selection.campaign.records.columns if c != "sequence" and c not in records.starts]
    if not names or records.count < 2 * limits.one_in:
        return None
    solution, values = fitted.solution, selection.campaign.records[names].to_numpy(dtype=float)
    before = _add_up(solution)
    least = max(limits.far, limits.removed * (before - (selection.samples - len(solution.names))))
    if before - selection.samples < limits.far:
        return None
    misfit = [measure_record(selection, solution, r) for r in range(records.count)]
    worst = sorted(range(records.count), key=lambda r: misfit[r].degrees - misfit[r].total)[: limits.candidates]
    best = (0.0, ("", ""))
    moved = [k for k, name in enumerate(records.nuisances) if name in names]
    for pair in combinations(worst, 2):
        low, high = np.sort(np.abs(values[list(pair)]), axis=0)
        if not np.any(high - low > limits.apart * high):
            continue
        here, there = np.array(pair), np.array(pair[::-1])
        conditions = {name: stack.conditions[name].at[here].set(stack.conditions[name][there]) for name in names}
        sd, z = np.asarray(stack.condition_sd).copy(), solution.z.copy()
        sd[np.ix_(here, moved)] = sd[np.ix_(there, moved)]
        z[here] = 0.0
        problem = replace_arrays(selection.problem, conditions={**stack.conditions, **conditions}, condition_sd=sd)
        try:
            at = problem.solve(solution.names, solution.u, z, tolerance=1e-2)
        except ComputationError:
            continue
        kept = [_add_up(one, here) - float(records.lengths[here].sum()) for one in (at, solution)]
        if not at.failed and kept[0] < limits.exchanged * kept[1]:
            best = max(best, (before - _add_up(at), (records.keys[pair[0]], records.keys[pair[1]])))
    return best[1] if best[0] > least else None


def _add_up(solution: Solution, of: np.ndarray | slice = slice(None)) -> float:
    """Sum of squares of what some records leave, and of how far their settings were moved, in their deviations."""
    return float(np.sum(solution.residual[of] ** 2) + np.sum(solution.z[of] ** 2))


def tell_exchange(keys: tuple[str, str], keep: bool) -> Fault:
    """Two such records in words; `keep` whether every record is to be kept."""
    seen = f"Records {keys[0]} and {keys[1]} fit far better with the settings of each other."
    return Fault("setting", keys, "", seen, "They are kept as they are, as asked." if keep else "Both are left out.",
                 "Check which file belongs to which test.", left_out=not keep)
