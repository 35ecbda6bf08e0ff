"""What the data cannot tell apart: combinations of parameters that hardly change the records, and what would help."""

import dataclasses as dc
import math
from collections.abc import Sequence

import equinox as eqx
import numpy as np

from .parameters import ParameterSpace, to_public
from .problem import Problem, Solution


CLOSE = 0.95  # a correlation beyond it is said in words
SINGULAR = 1e-5  # singular value of unit columns below which a combination changes nothing at all
VAST = {"log": 1.0, "logit": 4.0}  # standard deviation of a coordinate beyond which nothing is known
VAST_LINEAR = 100.0  # the same for other coordinates, in typical changes
ELSEWHERE = {
    "effective_mass": "weigh the moving parts", "sensor-gain.g": "calibrate the force gauge",
    "contact_radius_coefficient": "measure the contact disc", "outer_diameter": "measure the ball",
    "restitution": "measure the rebound speed", "loss_factor": "measure the loss factor on a rheometer",
    "slip_scale": "measure at other loads", "ambient-pressure.p_a": "read the barometer",
}  # fmt: skip
TESTS = (
    ("approach_speed", 1.5, "half as fast again"), ("approach_speed", 0.6, "at six tenths of the speeds"),
    ("initial_pressure", 2.0, "at twice the pressures"), ("initial_pressure", 0.5, "at half the pressures"),
    ("internal_pressure", 2.0, "at twice the pressures"), ("internal_pressure", 0.5, "at half the pressures"),
    ("normal_load", 2.0, "at twice the loads"), ("normal_load", 0.5, "at half the loads"),
    ("slip_speed", 3.0, "at three times the slip speeds"), ("slip_speed", 0.3, "at a third of the slip speeds"),
)  # fmt: skip


@dc.dataclass(frozen=True)
class Blend:
    """A combination of parameters that the data hardly fix.

    Attributes:
        names: of its members, the largest part first.
        direction: change of every free coordinate along it, in units of unit-norm columns, shape (free,).
        step: change of every free coordinate for one standard deviation along it, shape (free,).
        singular: whether it changes the records not at all.
    """

    names: tuple[str, ...]
    direction: np.ndarray
    step: np.ndarray
    singular: bool


@dc.dataclass(frozen=True)
class Knowledge:
    """What a fit knows about its free parameters.

    Attributes:
        covariance: of the free coordinates; large and finite along combinations that nothing fixes.
        correlations: shape (free, free).
        undetermined: names of parameters about which nothing is known.
        silent: names among them that change no record at all.
        blends: combinations that the data hardly fix, worst first.
    """

    covariance: np.ndarray
    correlations: np.ndarray
    undetermined: tuple[str, ...]
    silent: tuple[str, ...]
    blends: tuple[Blend, ...]


def analyse_columns(space: ParameterSpace, names: Sequence[str], columns: np.ndarray, scales: np.ndarray) -> Knowledge:
    """Find what the Jacobian of a fit determines.

    Args:
        space: of the parameters.
        names: of the free ones.
        columns: whitened derivatives by coordinate/scale with nuisances eliminated, priors among the rows, shape
            (rows, free).
        scales: of the free coordinates, shape (free,).
    """
    count = len(names)
    vast = np.array([limit_knowledge(space, name) for name in names])
    norms = np.linalg.norm(columns, axis=0)
    silent = norms * vast < scales
    safe = np.maximum(norms, 1e-6 * scales / vast)
    unit = columns / safe
    _, s, rows = np.linalg.svd(np.concatenate([unit, np.zeros((count, count))]), full_matrices=False)
    spread = rows.T / np.maximum(s, 1e-6)
    covariance = spread @ spread.T * np.outer(scales / safe, scales / safe)
    sd = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(sd, sd)
    blends, lost = [], silent | (sd > vast)
    for k in range(count - 1, -1, -1):
        v = rows[k]
        part = np.abs(v) > 0.25 * np.abs(v).max()
        if s[k] > math.sqrt(1 - CLOSE) or part.sum() < 2 or np.any(silent & part):
            continue
        singular = bool(s[k] < SINGULAR or np.all(np.abs(v / s[k] * scales / safe)[part] > vast[part]))
        lost = lost | (part & singular)
        order = [j for j in np.argsort(-np.abs(v)) if part[j]]
        members = tuple(str(names[int(j)]) for j in order)
        blends.append(Blend(members, v, v / max(s[k], 1e-6) * scales / safe, singular))
    return Knowledge(covariance, correlations, tuple(n for n, x in zip(names, lost, strict=True) if x),
                     tuple(n for n, x in zip(names, silent, strict=True) if x), tuple(blends))


def describe_knowledge(problem: Problem, solution: Solution, columns: np.ndarray, known: Knowledge) -> tuple[str, ...]:
    """What cannot be told apart, in sentences, with the test that would resolve it.

    Args:
        problem, solution: the fit.
        columns: as in `analyse_columns`.
        known: what that found.
    """
    names, found = solution.names, []
    for name in known.silent:
        found.append(f"These records say nothing about {name}: it changes them less than their noise.")
    for k, blend in enumerate(known.blends):
        change = _say_change(problem.space, solution, blend)
        members = _list(blend.names)
        if blend.singular:
            text = (f"{members} cannot be told apart: {change} changes no record beyond its noise, so that only "
                    "their combination is known, and the single values are not")
        else:
            worst = max((abs(known.correlations[names.index(a), names.index(b)]), a, b) for a in blend.names
                        for b in blend.names if a != b)[0]
            text = (f"{members} are hard to tell apart (correlation up to {worst:.3f}): {change} changes the records "
                    "by one standard deviation only")
        found.append(f"{text}; {_say_remedy(problem, solution, columns, blend) if k < 2 else _say_elsewhere(blend)}.")
    told = [set(blend.names) for blend in known.blends]
    for i, a in enumerate(names):
        for j in range(i):
            pair = {a, names[j]}
            value = known.correlations[i, j]
            if abs(value) > CLOSE and not any(pair <= t for t in told) and not pair & set(known.silent):
                found.append(f"{names[j]} and {a} are hard to tell apart (correlation {value:+.3f}).")
    for name in known.undetermined:
        if name not in known.silent and not any(name in t for t in told):
            found.append(f"These records hardly determine {name}: its uncertainty is wider than any likely value.")
    return tuple(found)


def limit_knowledge(space: ParameterSpace, name: str) -> float:
    """Standard deviation of a coordinate beyond which nothing is known about the parameter."""
    p = space.slots[space.index[name]].parameter
    return VAST.get(p.coordinate, VAST_LINEAR * p.typical)


def _say_change(space: ParameterSpace, solution: Solution, blend: Blend) -> str:
    """Such as: raising a by 1 % and lowering b by 0.02."""
    names = solution.names
    first = names.index(blend.names[0])
    step = blend.step if blend.step[first] > 0 else -blend.step
    if blend.singular:  # any length will do
        p = space.slots[space.index[blend.names[0]]].parameter
        step = step / abs(step[first]) * (0.01 if p.coordinate == "log" else 0.05 * _typical(space, blend.names[0]))
    parts = []
    for name in blend.names:
        k = names.index(name)
        p = space.slots[space.index[name]].parameter
        here = solution.u[space.index[name]]
        before, after = to_public(p.coordinate, here), to_public(p.coordinate, here + step[k])
        change = after - before
        if p.coordinate == "log" and before:
            size = f"{abs(change / before) * 100:.2g} %"
        else:
            size = f"{abs(change):.2g}" + (f" {p.unit}" if p.unit else "")
        parts.append(f"{'raising' if change > 0 else 'lowering'} {name} by {size}")
    return _list(parts)


def _typical(space: ParameterSpace, name: str) -> float:
    p = space.slots[space.index[name]].parameter
    return 1.0 if p.coordinate in ("log", "logit") else p.typical


def _say_remedy(problem: Problem, solution: Solution, columns: np.ndarray, blend: Blend) -> str:
    """The test that shortens the combination's uncertainty most, out of a few, or what to take from elsewhere."""
    ratios = []
    for name, factor, text in TESTS:
        if name in problem.records.stack.conditions:
            ratios.append((_try_conditions(problem, solution, columns, blend, name, factor),
                           f"as many records {text}"))
    if problem.records.family != "slip" and "depression" not in problem.records.channels:
        ratios.append((_try_depression(problem, solution, blend), "the depression as a further channel"))
    best, text = min(ratios, default=(1.0, ""))
    size = max(abs(x) / _typical(problem.space, n) for n, x in zip(solution.names, blend.step, strict=True))
    if blend.singular and best * size < 0.3:
        return f"{text} would tell them apart"
    if not blend.singular and best < 0.5:
        times = f"{1 / best:.1f}" if best > 0.1 else "more than ten"
        return f"{text} would make their difference {times} times as certain"
    return _say_elsewhere(blend)


def _say_elsewhere(blend: Blend) -> str:
    known = [ELSEWHERE[name] for name in blend.names if name in ELSEWHERE]
    if known:
        return f"{' or '.join(known)}, and fix what that gives"
    return f"fix one of them ({' or '.join(blend.names)}) at what is known from elsewhere"


def _try_conditions(problem: Problem, solution: Solution, columns: np.ndarray, blend: Blend, name: str,
                    factor: float) -> float:
    """Uncertainty along a combination with as many records again at another condition, over the present one."""
    records = problem.records
    conditions = dict(records.stack.conditions)
    conditions[name] = conditions[name] * factor
    stack = eqx.tree_at(lambda s: s.conditions, records.stack, conditions)
    other = Problem(problem.space, dc.replace(records, stack=stack))
    there = other.solve(solution.names, solution.u, np.zeros_like(solution.z), moving=False)
    if there.failed:
        return 1.0
    more, _ = there.projected()
    both = np.concatenate([columns, more.reshape(-1, columns.shape[1])])
    return _spread(both, columns, blend) / _spread(columns, columns, blend)


def _spread(rows: np.ndarray, columns: np.ndarray, blend: Blend) -> float:
    """Standard deviation along the combination that `rows` leave; lengths are those of unit-norm `columns`."""
    unit = rows / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    _, s, right = np.linalg.svd(unit, full_matrices=False)
    return float(np.linalg.norm((right @ blend.direction) / np.maximum(s, 1e-6)))


def _try_depression(problem: Problem, solution: Solution, blend: Blend) -> float:
    """The same with the depression measured to 0.2 % of its largest value."""
    size = max(abs(x) / _typical(problem.space, n) for n, x in zip(solution.names, blend.step, strict=True))
    share = min(1.0, 0.05 / size) if size else 1.0
    columns = [problem.space.index[name] for name in solution.names]
    there = []
    for sign in (1.0, -1.0):
        u = solution.u.copy()
        u[columns] += sign * share * blend.step
        moved = problem.solve(solution.names, u, solution.z, moving=False)
        if moved.failed:
            return 1.0
        there.append(moved.state)
    sd = 2e-3 * float(np.max(solution.state))
    counted = np.asarray(problem.records.stack.weights)[: problem.records.count, 0] > 0
    change = (there[0] - there[1]) / (2.0 * share) / sd
    # Conditions and time origin of every record take a part of it with them: a quarter is counted.
    gain = 0.25 * float(np.sum(change[counted] ** 2))
    return 1.0 / math.sqrt(1.0 + gain)


def _list(words: Sequence[str]) -> str:
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
