"""Is anything missing? Lack of fit of a model against noise and setting errors, at a stated level.

Three statistics share the level. The first looks everywhere: the part of the whitened residuals that is smooth over a
contact (splines of each record, and what the parameters could still change), with the nuisances' own misfit; under a
complete model it is chi-square, spread a little further by what is not known about the noise's correlation. The second
looks where physics would put it: the largest efficient score of any effect or test direction outside the model. The
third looks at what the settings of the records had to swallow: how far they were moved from what was written down.
Where noise or settings are not taken as stated, a fourth looks at what repeats over the records: physics moves the mean
residual at a given state, noise does not.
"""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from ..families import find_family
from ..inference import distributions as stats
from ..inference.goodness import LEAST, combine_p_values, count_rest, doubt_level, judge_values, weigh_shifts
from ..inference.noise import Noise, widen_by_student
from ..inference.problem import Problem, Solution, replace_arrays
from ..inference.smooth import judge_smooth, measure_smooth, whiten_all
from ..inference.stack import Records, is_added
from ..inference.variance_components import follow_conditions, list_settings
from ..measurement.campaign import Campaign
from .result import LackOfFit, SettingShift
from .settings import DEFAULT, SelectionSettings


# Splines over a contact: of few each still has several samples, so that the mean of what is slow stands out; many show
# what a periodic effect leaves beside one of its harmonics, which noise may otherwise pass for.
PARTS = (24, 120)
FLIPS = 4000  # draws of signs, so that p-values down to 1e-3 are known to a tenth
FEWEST = 8  # records whose signs tell anything: with fewer the smallest p-value is above one in a hundred
SEED = 20261125


def judge_fit(problem: Problem, solution: Solution, bases: Sequence[sparse.csr_matrix], noise: Mapping[str, Noise],
              score_p_value: float, settings: SelectionSettings = DEFAULT, repeats_p_value: float | None = None
              ) -> LackOfFit:
    """Judge whether a model lacks something.

    `score_p_value` is that of the largest score outside the model, `repeats_p_value` that of what repeats over the
    records whatever the noise, where noise or settings are not taken as stated.
    """
    total, degrees = measure_smooth(problem, solution, bases)
    smooth = judge_values(total, degrees, noise) if problem.records.are_values else judge_smooth(total, degrees, noise)
    shifts = [shift.p_value for shift in measure_shifts(problem.records, solution)]
    moves = combine_p_values(shifts)
    p = combine_p_values((smooth, score_p_value, moves, *(() if repeats_p_value is None else (repeats_p_value,))))
    how = (f", calibrated within records by a parametric bootstrap of {settings.bootstrap} draws of the whitened "
           "noise" if problem.space.family.free_running else "")
    moved = ", and how far the settings of the records were moved from what was written down" if shifts else ""
    repeats = "" if repeats_p_value is None else ", and what repeats over the records (random signs of whole records)"
    numbers = ("two", "three", "four")
    times = numbers[1 + bool(repeats)]
    decides = (f"the smallest, times {times} as there are so many chances of a small one, decides" if moved else
               f"the smallest, times {times}, decides (one more than there are, as settings that could move would be "
               "another)")
    text = (f"{numbers[bool(moved) + bool(repeats)]} statistics look for a lack of fit, each with a p-value, and "
            f"{decides}: chi-square of the smooth part of whitened residuals over {degrees:.0f} degrees of freedom "
            f"(noise level known to {100 * doubt_level(noise):.1f} %); the largest efficient score of any effect or "
            f"test direction outside the model{how}{moved}{repeats}")
    tested = not problem.records.are_values or count_rest(degrees, noise) >= LEAST
    if not tested:
        text += ("; the values leave nothing to test with that chi-square, as the model has as many parameters as the "
                 "curve whose scatter takes the place of the noise")
    return LackOfFit(total / max(degrees, 1.0), degrees, p, settings.level, p < settings.level, smooth, score_p_value,
                     moves, text, repeats_p_value, tested)


@dc.dataclass(frozen=True)
class Score:
    """Efficient score of one direction outside the model."""

    effect: str
    name: str  # of the parameter
    shapes: dict[str, float]  # held fixed, coordinates by name
    z: float  # standardised, N(0, 1) if nothing is missing; its sign is that of the amplitude that helps
    step: float  # amplitude that one Gauss-Newton step proposes (coordinate)
    information: float  # of the amplitude [1/coordinate²]
    visible: float  # share of the signature that refitting parameters and nuisances leaves
    cosines: np.ndarray  # of projected signatures with every direction scored with it, shape (directions,)
    place: int  # its own among them


def score_directions(problem: Problem, solution: Solution, wanted: list[tuple[str, str, dict[str, float]]]
                     ) -> list[Score]:
    """Efficient scores at a fitted model of directions (effect id, parameter name, shape coordinates by name)."""
    if not wanted:  # a short catalogue may all be in the model
        return []
    groups: list[list[int]] = []
    for k, (effect, _, shapes) in enumerate(wanted):
        home = next((g for g in groups if all(wanted[m][0] != effect or wanted[m][2] == shapes for m in g)), [])
        if not home:
            groups.append(home)
        home.append(k)
    points, order = [], []
    for members in groups:
        u = solution.u.copy()
        for m in members:
            for name, value in wanted[m][2].items():
                u[problem.space.index[name]] = value
        points.append(([wanted[m][1] for m in members], u))
        order += members
    records, _, own = solution.own.shape
    # One array of all signatures, projected where it stands: there may be a hundred of them.
    columns = problem.columns(points, solution.z, own)
    basis, _ = np.linalg.qr(_append(solution.own, np.eye(own)))
    count = solution.shared.shape[2]
    shared = _project(basis, np.moveaxis(_append(solution.shared, np.zeros((own, count))), 2, 0))
    q = np.linalg.qr(shared.reshape(count, -1).T)[0] if count else np.zeros((basis[..., 0].size, 0))
    residual = np.concatenate([solution.residual, solution.z], axis=1)
    norms, sizes = np.zeros(len(order)), np.zeros(len(order))
    for k, column in enumerate(columns):
        sizes[k] = np.linalg.norm(column)
        column[:] = _project(basis, column)
        column -= (q @ (q.T @ column.ravel())).reshape(column.shape)
        norms[k] = np.linalg.norm(column)
        told = norms[k] >= 1e-8 * max(sizes[k], 1e-300) and sizes[k] >= 1e-9
        column *= 1.0 / norms[k] if told else 0.0
        norms[k] *= told
    flat = columns.reshape(len(order), -1)
    cosines, sums = flat @ flat.T, -np.einsum("kgr,gr->kg", columns, residual).sum(axis=1)
    back, found = np.argsort(order), []
    for m, (effect, name, shapes) in enumerate(wanted):
        k, scale = back[m], problem.scales[problem.space.index[name]]
        z, norm = float(sums[k]), norms[k]
        found.append(Score(effect, name, shapes, z, z / norm * scale if norm else 0.0, (norm / scale) ** 2,
                           float((norm / max(sizes[k], 1e-300)) ** 2), cosines[k, back], m))
    return found


def _append(columns: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Columns of every record, shape (records, rows, columns), with the rows of its nuisances' priors below."""
    return np.concatenate([columns, np.broadcast_to(prior, (len(columns), *prior.shape))], axis=1)


def _project(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns, shape (..., records, rows), without what each record's `basis` spans, shape (records, rows, own)."""
    return columns - np.einsum("grk,...gk->...gr", basis, np.einsum("grk,...gr->...gk", basis, columns))


def family_p_value(scores: list[Score], noise: Mapping[str, Noise]) -> float:
    """Family-wise p-value of the largest squared score (Šidák; the noise level's own uncertainty widens it)."""
    if not scores:
        return 1.0
    largest, known = max(s.z**2 for s in scores), min((n.degrees for n in noise.values() if n.degrees), default=None)
    if known is None:
        alone = stats.chi2.sf(largest / (1.0 + 2.0 * doubt_level(noise)), 1)
    else:  # Student's t of the score, under the noise that is not taken larger
        alone = stats.f.sf(largest * widen_by_student(known) ** 2, 1, known)
    return correct_for_many(float(alone), len(scores))


def correct_for_many(p_value: float, count: int) -> float:
    """Family-wise p-value of the smallest of `count` (Šidák)."""
    return float(-np.expm1(count * np.log1p(-min(p_value, 1 - 1e-16))))


def bootstrap_p_value(scores: list[Score], noise: Mapping[str, Noise], draws: int = DEFAULT.bootstrap) -> float:
    """The same for few long records: chance of so large a score by a parametric bootstrap of the whitened noise.

    Under a complete model the scores are normal with the covariance of their signatures; drawn together they count
    directions that look alike once. The observed score counts as a draw of its own, so that the chance is never zero
    (Davison and Hinkley, Bootstrap Methods and their Application, section 4.2.2).
    """
    used = [s for s in scores if s.information > 0]
    if not used:
        return 1.0
    values, vectors = np.linalg.eigh(np.array([s.cosines[[t.place for t in used]] for s in used]))
    generator = np.random.default_rng(20261121)
    drawn = generator.standard_normal((draws, len(used))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    level = np.exp(doubt_level(noise) * generator.standard_normal(draws))
    largest = np.max(drawn**2, axis=1) * level
    above = int(np.sum(largest >= max(s.z**2 for s in used)))
    return (above + 1.0) / (draws + 1.0)


def measure_shifts(records: Records, solution: Solution, spread: Mapping[str, float] | None = None,
                   campaign: Campaign | None = None) -> tuple[SettingShift, ...]:
    """Shifts of every setting with a stated uncertainty; what has none, and zeros that move, are no settings.

    `spread` is by how much the fit lets them scatter more than stated: shifts are in stated deviations all the same,
    and their p-values are those of the larger scatter. With the `campaign` they are told as shares of the settings.
    """
    found = []
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    for k in list_settings(records):
        name, known = records.nuisances[k], deviations[:, k] > 0
        ratio = (spread or {}).get(name, 1.0)
        moved = np.where(known, solution.z[:, k], 0.0) * ratio
        worst, share = int(np.argmax(np.abs(moved))), None
        if campaign is not None and name in campaign.records:
            values = np.abs(campaign.records[name].to_numpy(dtype=float))
            if np.all(values[known] > 0):
                share = float(np.mean((solution.z[:, k] * deviations[:, k])[known] / values[known]))
        found.append(SettingShift(
            name, float(np.median(deviations[known, k])) / ratio, float(np.sqrt(np.sum(moved**2) / known.sum())),
            float(moved[worst]), records.keys[worst], weigh_shifts(moved[known] / ratio), moved, share))
    return tuple(found)


def is_moved(shifts: Sequence[SettingShift], level: float = DEFAULT.level_each) -> bool:
    """Whether settings were moved further than chance moves them, at the level of one statistic of the lack of fit."""
    return combine_p_values([shift.p_value for shift in shifts]) < level


def hold_settings(problem: Problem, solution: Solution) -> Solution:
    """The same model fitted with every condition as it is written down; the time origin moves as before."""
    records = problem.records
    moves = np.array([name == "time" or name in records.starts or is_added(name) for name in records.nuisances])
    held = replace_arrays(problem, condition_sd=records.stack.condition_sd * moves)
    return held.solve(solution.names, solution.u, solution.z * moves, tolerance=1e-2)


def measure_repeats(records: Records, solution: Solution, groups: np.ndarray, conditions: np.ndarray,
                    onset_bias: float = 0.0) -> float | None:
    """p-value of nothing in the residuals repeating over the records, whatever the size and correlation of the noise.

    Residuals of every record are projected on splines over its contact, few and many, without what its own settings
    can imitate; how far these then have to move counts by itself (`follow_conditions`). Their mean over the records,
    and their slopes over the logarithms of the conditions, are held against the same with the signs of whole records
    drawn at random (Liu, Annals of Statistics 16, 1988, wild bootstrap by cluster).

    Args:
        records: with the filter that whitens the residuals.
        solution: a fit of all records under it.
        groups: number of the condition of every record, shape (records,).
        conditions: of every record, shape (records, conditions), SI; the place in the series may be one.
        onset_bias: standard deviation [s] of what the time origins have in common. Onsets that were found in the force
            are off by the shape of its rise, which goes with the conditions: within this, that they do tells nothing.

    Returns:
        The p-value; None where the records do not share a phase, are single values, or are too few.
    """
    if find_family(records.family).free_running or records.are_values or records.count < FEWEST:
        return None
    time = np.asarray(records.stack.time)
    knots = [np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, parts - 2), [1.0] * 3]) for parts in PARTS]
    scores, shifts = [], []
    for r, n in enumerate(records.lengths):
        low = max(float(time[r, 0]), 0.0)
        phase = (time[r, :n] - low) / max(float(solution.end[r]) - low, 1e-300)
        inside, columns = (phase >= 0) & (phase < 1), np.zeros((n, sum(PARTS)))
        if inside.any():
            columns[inside] = np.hstack([BSpline.design_matrix(phase[inside], own, 3).toarray() for own in knots])
        basis = np.linalg.qr(np.concatenate([solution.own[r], np.eye(solution.own.shape[2])]))[0]
        side = np.concatenate([solution.residual[r], solution.z[r]])
        side = side - basis @ (basis.T @ side)
        rows = solution.residual.shape[1]
        scores.append(whiten_all(records, r, sparse.csr_matrix(columns)).T @ side[:rows])
        shifts.append(side[rows:])
    logarithms = np.log(np.maximum(np.abs(conditions), 1e-300))
    spread = logarithms.std(axis=0)
    slopes = ((logarithms - logarithms.mean(axis=0)) / np.maximum(spread, 1e-300))[:, spread > 0.01]
    over = np.concatenate([np.ones((len(scores), 1)), slopes], axis=1)
    moves = solution.z[: records.count] * np.asarray(records.stack.condition_sd)[: records.count]
    settled = [k for k, name in enumerate(records.nuisances) if name not in records.starts
               and not (name == "time" and np.sqrt(np.mean(moves[:, k] ** 2)) <= onset_bias)]
    moved = [shift for shift in np.array(shifts)[:, settled].T if np.ptp(shift) > 0]
    return combine_p_values([*(_flip_signs(table, over) for table in np.split(np.array(scores), PARTS[:1], axis=1)),
                             *(follow_conditions(shift, groups, conditions) for shift in moved)])


def _flip_signs(table: np.ndarray, over: np.ndarray) -> float:
    """p-value of nothing common in the columns of a table, by signs of its rows.

    Args:
        table: of every record, shape (records, columns).
        over: weights whose sums are looked at, the largest of them, shape (records, weights).
    """
    size = np.sqrt(np.mean(table**2, axis=0))
    table = table[:, size > 0] / size[size > 0]

    def measure(signs: np.ndarray) -> np.ndarray:
        """Largest statistic over the weights, shape (draws,)."""
        sums = np.einsum("dr,rw,rk->dwk", signs, over, table, optimize=True)
        scale = np.einsum("rw,rk->wk", over**2, table**2)
        return np.max(np.sum(sums**2 / np.maximum(scale, 1e-300), axis=2), axis=1)

    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], size=(FLIPS, len(table)))
    seen = measure(np.ones((1, len(table))))[0]
    return float((np.sum(measure(signs) >= seen * (1.0 - 1e-9)) + 1.0) / (FLIPS + 1.0))
