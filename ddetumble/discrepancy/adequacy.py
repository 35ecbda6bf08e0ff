"""Is anything missing? Lack of fit of a model against noise and setting errors, at a stated level.

Three statistics share the level. The first looks everywhere: the part of the whitened residuals that is smooth over a
contact (splines of each record, and what the parameters could still change), with the nuisances' own misfit; under a
complete model it is chi-square, spread a little further by what is not known about the noise's correlation. The second
looks where physics would put it: the largest efficient score of any effect or probe that is not in the model. The third
looks at what the settings of the records had to swallow: how far they were moved from what was written down.
"""

import dataclasses as dc

import numpy as np
from scipy import stats

from ..inference.noise import Noise, whiten
from ..inference.problem import Problem, Solution
from ..inference.whiteness import list_spans, spline_columns
from .records import LackOfFit
from .shifts import LEVEL, combine_p_values, measure_shifts


DRAWS = 4000  # of the parametric bootstrap


def smooth_bases(problem: Problem, end: np.ndarray) -> list[np.ndarray]:
    """Whitened spline basis of each record over all channels, list of (rows, columns)."""
    stack, lengths = problem.records.stack, problem.records.lengths
    time, weights, taps = np.asarray(stack.time), np.asarray(stack.weights), np.asarray(stack.taps)
    bases = []
    for r, n in enumerate(lengths):
        columns = spline_columns(time[r, :n], list_spans(problem.records, r, float(end[r])))
        blocks = []
        for c in range(weights.shape[1]):
            block = np.zeros((weights.shape[2], weights.shape[1] * columns.shape[1]))
            here = slice(c * columns.shape[1], (c + 1) * columns.shape[1])
            block[:n, here] = whiten(weights[r, c, :n], taps[r, c, :n], columns)
            blocks.append(block)
        bases.append(np.concatenate(blocks))
    return bases


def measure_smooth(problem: Problem, solution: Solution, bases: list[np.ndarray]) -> tuple[float, float]:
    """Sum of squares of the smooth part of residuals and nuisances, and its degrees of freedom."""
    total, degrees = 0.0, -float(solution.shared.shape[2])
    own = solution.own.shape[2]
    for r, basis in enumerate(bases):
        rows = np.concatenate([
            np.concatenate([basis, solution.own[r], solution.shared[r]], axis=1),
            np.concatenate([np.zeros((own, basis.shape[1])), np.eye(own),
                            np.zeros((own, solution.shared.shape[2]))], axis=1)])
        scale = np.linalg.norm(rows, axis=0)
        rows = rows[:, scale > 1e-9] / scale[scale > 1e-9]
        right = np.concatenate([solution.residual[r], solution.z[r]])
        if problem.space.family.free_running:  # a tall matrix of many splines: its normal equations do
            values, vectors = np.linalg.eigh(rows.T @ rows)
            kept = values > 1e-11 * values[-1]
            total += float(np.sum((vectors.T @ (rows.T @ right))[kept] ** 2 / values[kept]))
            degrees += int(kept.sum()) - own
            continue
        u, s, _ = np.linalg.svd(rows, full_matrices=False)
        u = u[:, s > 1e-7 * s[0]]
        total += float(np.sum((u.T @ right) ** 2))
        degrees += u.shape[1] - own  # each nuisance was fitted
    return total, degrees


def judge_fit(problem: Problem, solution: Solution, bases: list[np.ndarray], noise: dict[str, Noise],
              score_p_value: float, level: float = LEVEL) -> LackOfFit:
    """Judge whether a model lacks something.

    Args:
        problem, solution: the fitted model.
        bases: of `smooth_bases`.
        noise: by channel.
        score_p_value: family-wise p-value of the largest score outside the model.
        level: probability of a false alarm, shared by the three statistics.
    """
    total, degrees = measure_smooth(problem, solution, bases)
    ratio = total / max(degrees, 1.0)
    spread = max(n.log_level_sd for n in noise.values())
    sd = np.sqrt(2.0 / max(degrees, 1.0) + spread**2)
    smooth = float(stats.norm.sf((np.log(ratio) + 1.0 / max(degrees, 1.0)) / sd))
    shifts = [shift.p_value for shift in measure_shifts(problem.records, solution)]
    settings = combine_p_values(shifts)
    p = combine_p_values((smooth, score_p_value, settings))
    within = problem.space.family.free_running
    how = (f", calibrated within records by a parametric bootstrap of {DRAWS} draws of the whitened noise" if within
           else "")
    moved = ", and how far the settings of the records were moved from what was written down" if shifts else ""
    text = (f"the smallest p-value, counted three times, of three statistics: chi-square of the smooth part of "
            f"whitened residuals over {degrees:.0f} degrees of freedom (noise level known to {spread:.1%}); the "
            f"largest efficient score of any effect or probe outside the model{how}{moved}")
    return LackOfFit(ratio, degrees, p, level, p < level, smooth, score_p_value, settings, text)


@dc.dataclass(frozen=True)
class Score:
    """Efficient score of one direction outside the model.

    Attributes:
        effect: id; `name` of the parameter; `shapes` held fixed, coordinates by name.
        z: standardised score, N(0, 1) if nothing is missing; its sign is that of the amplitude that helps.
        step: amplitude that one Gauss-Newton step proposes (coordinate).
        information: of the amplitude [1/coordinate²].
        visible: share of the signature that refitting parameters and nuisances leaves.
        column: projected signature, shape (records, rows), unit norm.
        records: score of each record, shape (records,).
    """

    effect: str
    name: str
    shapes: dict[str, float]
    z: float
    step: float
    information: float
    visible: float
    column: np.ndarray
    records: np.ndarray


def score_directions(problem: Problem, solution: Solution, wanted: list[tuple[str, str, dict[str, float]]]
                     ) -> list[Score]:
    """Efficient scores at a fitted model.

    Args:
        problem, solution: the fitted model.
        wanted: (effect id, parameter name, shape coordinates by name) of every direction.
    """
    groups: list[list[int]] = []
    for k, (effect, _, shapes) in enumerate(wanted):
        home = next((g for g in groups if all(wanted[m][0] != effect or wanted[m][2] == shapes for m in g)), None)
        if home is None:
            groups.append([k])
        else:
            home.append(k)
    raw = np.zeros((*solution.residual.shape, len(wanted)))
    places = []
    for members in groups:
        u = solution.u.copy()
        for m in members:
            for name, value in wanted[m][2].items():
                u[problem.space.index[name]] = value
        places.append(([wanted[m][1] for m in members], u))
    for members, columns in zip(groups, problem.columns(places, solution.z), strict=True):
        raw[..., members] = columns
    records, _, own = solution.own.shape
    rows = np.concatenate([solution.own, np.broadcast_to(np.eye(own), (records, own, own))], axis=1)
    pad = np.zeros((records, own, 1))
    basis, _ = np.linalg.qr(rows)

    def project(x):
        x = np.concatenate([x, np.broadcast_to(pad, (records, own, x.shape[2]))], axis=1)
        return x - basis @ (np.swapaxes(basis, 1, 2) @ x)

    kept = project(raw)
    flat = kept.reshape(-1, len(wanted))
    if solution.shared.shape[2]:
        q, _ = np.linalg.qr(project(solution.shared).reshape(-1, solution.shared.shape[2]))
        flat = flat - q @ (q.T @ flat)
    residual = np.concatenate([solution.residual, solution.z], axis=1).reshape(-1)
    found = []
    for k, (effect, name, shapes) in enumerate(wanted):
        column = flat[:, k]
        norm = np.linalg.norm(column)
        size = np.linalg.norm(raw[..., k])
        scale = problem.scales[problem.space.index[name]]
        if norm < 1e-8 * max(size, 1e-300) or size < 1e-9:
            found.append(Score(effect, name, shapes, 0.0, 0.0, 0.0, 0.0, np.zeros((records, flat.shape[0] // records)),
                               np.zeros(records)))
            continue
        unit = (column / norm).reshape(records, -1)
        by_record = -(unit * residual.reshape(records, -1)).sum(axis=1)
        z = float(by_record.sum())
        found.append(Score(effect, name, shapes, z, z / norm * scale, (norm / scale) ** 2, float((norm / size) ** 2),
                           unit, by_record))
    return found


def family_p_value(scores: list[Score], noise: dict[str, Noise]) -> float:
    """Family-wise p-value of the largest squared score (Šidák; the noise level's own uncertainty widens it)."""
    if not scores:
        return 1.0
    widen = 1.0 + 2.0 * max(n.log_level_sd for n in noise.values())
    largest = max(s.z**2 for s in scores) / widen
    single = stats.chi2.sf(largest, 1)
    return float(-np.expm1(len(scores) * np.log1p(-min(single, 1 - 1e-16))))


def bootstrap_p_value(scores: list[Score], noise: dict[str, Noise]) -> float:
    """The same for few long records: chance of so large a score by a parametric bootstrap of the whitened noise.

    Under a complete model the scores are normal with the covariance of their signatures; drawn together they count
    directions that look alike once. The observed score counts as a draw of its own, so that the chance is never zero
    (Davison and Hinkley, Bootstrap Methods and their Application, section 4.2.2).
    """
    used = [s for s in scores if s.information > 0]
    if not used:
        return 1.0
    flat = np.stack([s.column.ravel() for s in used])
    values, vectors = np.linalg.eigh(flat @ flat.T)
    generator = np.random.default_rng(20261121)
    drawn = generator.standard_normal((DRAWS, len(used))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    level = np.exp(max(n.log_level_sd for n in noise.values()) * generator.standard_normal(DRAWS))
    largest = np.max(drawn**2, axis=1) * level
    above = int(np.sum(largest >= max(s.z**2 for s in used)))
    return (above + 1.0) / (DRAWS + 1.0)
