"""How far a fit moved the settings of the records, in stated deviations: a misfit that settings swallow is a misfit."""

import dataclasses as dc
from collections.abc import Sequence

import equinox as eqx
import numpy as np

from ..inference.goodness import combine_p_values, weigh_shifts
from ..inference.problem import Problem, Solution
from ..inference.stack import DRIFT, ZERO, Records
from .records import SettingShift


LEVEL = 0.01  # probability of calling a complete model incomplete
EACH = LEVEL / 3  # of each of the three statistics of the lack of fit (Bonferroni)


def measure_shifts(records: Records, solution: Solution) -> tuple[SettingShift, ...]:
    """Shifts of every setting with a stated uncertainty; what has none, and zeros that move, are no settings."""
    found = []
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    for k, name in enumerate(records.nuisances):
        if name in records.starts or name.startswith((f"{ZERO}:", f"{DRIFT}:")):
            continue
        stated = deviations[:, k]
        moved = np.where(stated > 0, solution.z[:, k], 0.0)
        count = int(np.sum(stated > 0))
        if not count:
            continue
        worst = int(np.argmax(np.abs(moved)))
        found.append(SettingShift(
            name, float(np.median(stated[stated > 0])), float(np.sqrt(np.sum(moved**2) / count)), float(moved[worst]),
            records.keys[worst], weigh_shifts(moved[stated > 0]), moved))
    return tuple(found)


def is_moved(shifts: Sequence[SettingShift]) -> bool:
    """Whether settings were moved further than chance moves them, at the level of one statistic of the lack of fit."""
    return combine_p_values([shift.p_value for shift in shifts]) < EACH


def hold_settings(problem: Problem, solution: Solution) -> Solution:
    """The same model fitted with every condition as it is written down; the time origin moves as before."""
    records = problem.records
    moves = np.array([name == "time" or name in records.starts or ":" in name for name in records.nuisances])
    deviations = records.stack.condition_sd * moves
    held = dc.replace(records, stack=eqx.tree_at(lambda s: s.condition_sd, records.stack, deviations))
    return Problem(problem.space, held, problem.priors).solve(solution.names, solution.u, solution.z * moves,
                                                              tolerance=1e-2)
