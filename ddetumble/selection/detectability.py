r"""How small an effect a campaign could see.

An effect of size $a$ changes the whitened readings by $f(a) - f(0)$. What refitted reference parameters and every
record's own nuisances leave of that, $s(a)$, is what can be seen: its squared length is the expected rise of
chi-square. The family-wise score test of `discover`, over $m$ directions at level $\alpha$, finds it with 95 % power
where

$$\|s(a)\| = z_\alpha + 1.645,\qquad z_\alpha^2 = \chi^2_1{}^{-1}\left((1 - \alpha)^{1/m}\right).$$

Nothing is linear in the size here: the model is computed with the effect in it. Of an effect that jumps at its null,
$f(0)$ is the limit of a vanishing size.
"""

import dataclasses as dc
import math

import numpy as np

from ..contact.effect import Parameter
from ..inference import distributions as stats
from ..inference.problem import Problem, Solution
from .settings import DEFAULT, SelectionSettings


TRIALS = 6  # sizes tried until the length is right: each gains about a digit
CLOSE, NEAR = 0.02, 0.1  # relative error of the length that is good enough, and beyond which there is no size
HUGE = 300.0  # typical changes beyond which an effect counts as unseen: no real one is that large
LEAST = 1e-9  # typical changes below which no size is tried: what shows even then shows at any size
DARK = 1e-6  # share of the length of a change below which what refits leave of it is rounding


@dc.dataclass(frozen=True)
class Signature:
    """What a campaign could see of one amplitude at one shape."""

    name: str  # of the amplitude
    size: float  # value of its field that would be found; nan where none that physics allows would be
    length: float  # of what refits leave of it, in standard deviations of the noise
    visible: float  # share of its signature (squared length) that refits leave
    column: np.ndarray  # direction of what is seen, of unit length, shape (rows,)


def detectable_length(directions: int, settings: SelectionSettings = DEFAULT) -> float:
    """Length of a signature that the family-wise test over so many directions finds, in standard deviations."""
    level = -np.expm1(np.log1p(-settings.level_each) / directions)
    return float(np.sqrt(stats.chi2.isf(level, 1)) + stats.norm.ppf(settings.power))


def measure_signature(problem: Problem, solution: Solution, origin: np.ndarray, name: str, value: float) -> float:
    """Length of what can be seen of an amplitude at a coordinate, in standard deviations; 0 where nothing can be.

    `origin` holds coordinates with the shapes of the effect put in.
    """
    p = problem.space.parameter(name)
    if p.singular:
        solution = _move_beside(problem, solution, origin, name, p.default + float(p.sign or 1) * LEAST * p.typical)
    found = _show(problem, solution, origin, name, value)
    return 0.0 if found is None else found[0]


def find_size(problem: Problem, solution: Solution, origin: np.ndarray, name: str, goal: float,
              first: float | None = None, jumps: bool = False) -> Signature | None:
    """Size of an amplitude at which its signature has the length `goal`; None where none was found.

    Where the signature grows by a jump (a patch that begins to grip), the smallest size tried that shows enough.
    `origin` holds coordinates with the shapes of the effect put in, `first` the distance from the null to try first;
    `jumps` says whether a jump at the null counts, which says nothing of the size, but is there in simulated records.
    """
    p = problem.space.parameter(name)
    null, side = p.default, float(p.sign or 1)
    most = reach_limit(p)
    if p.singular and not jumps:
        solution = _move_beside(problem, solution, origin, name, null + side * LEAST * p.typical)
    size = min(0.1 * p.typical if first is None else first, most)
    before: tuple[float, float] | None = None
    short, enough = 0.0, None  # largest size known to show too little, smallest known to show enough
    for _ in range(TRIALS):
        found = _show(problem, solution, origin, name, null + side * size)
        if found is None or found[0] <= 0.0:
            return None
        length, visible, column = found
        tried = Signature(name, null + side * size, length, visible, column)
        if abs(length / goal - 1.0) < CLOSE:
            return tried
        power = 1.0
        if before is not None and before[0] != size and length != before[1]:
            power = float(np.clip(np.log(length / before[1]) / np.log(size / before[0]), 0.3, 3.0))
        before = (size, length)
        if length > goal and (enough is None or size < abs(enough.size - null)):
            enough = tried
        elif length < goal:
            short = max(short, size)
        new = size * (goal / length) ** (1.0 / power)
        if enough is not None and not short < new < abs(enough.size - null):  # a jump lies between them
            new = math.sqrt(max(short, 1e-3 * abs(enough.size - null)) * abs(enough.size - null))
        if new >= most and size >= 0.99 * most:
            return dc.replace(tried, size=math.nan)
        size = float(np.clip(new, LEAST * p.typical, most))
    return tried if abs(length / goal - 1.0) < NEAR else enough


def _move_beside(problem: Problem, solution: Solution, origin: np.ndarray, name: str, value: float) -> Solution:
    """The same fit, its readings those with an effect as good as absent, of which what is seen is counted.

    Some effects jump at their null: friction that builds up over however short a slip is zero in the one sample at no
    slip. What shows alike at any size says nothing of that size, and hangs on a sample of which nobody knows that it
    lies there exactly; what is left is seen where the effect changes readings over a range that the samples resolve.
    """
    u = origin.copy()
    u[problem.space.index[name]] = value
    beside = problem.solve([], u, solution.z, moving=False)
    return solution if beside.failed else dc.replace(solution, residual=beside.residual)


def reach_limit(p: Parameter) -> float:
    """Farthest that the field of an amplitude may be from its null: within bounds, what physics allows, and reason."""
    low, high = p.transform.interval(*p.limits) if p.transform.reciprocal else p.limits
    low, high = max(low, p.bounds[0]), min(high, p.bounds[1])
    reach = high - p.default if (p.sign or 1) > 0 else p.default - low
    return min(HUGE * p.typical, 0.999 * reach)


def _show(problem: Problem, solution: Solution, origin: np.ndarray, name: str, value: float
          ) -> tuple[float, float, np.ndarray] | None:
    """Length of what can be seen of an effect, its share of the whole signature, and its direction."""
    u = origin.copy()
    u[problem.space.index[name]] = value
    moved = problem.solve([], u, solution.z, moving=False)
    if moved.failed:
        return None
    change = moved.residual - solution.residual
    whole = float(np.sum(change**2))
    records, _, own = solution.own.shape
    shared, left = solution.projected(right=np.concatenate([change, np.zeros((records, own))], axis=1))
    flat = left.reshape(-1)
    if shared.shape[2]:
        q, _ = np.linalg.qr(shared.reshape(-1, shared.shape[2]))
        flat = flat - q @ (q.T @ flat)
    length = float(np.linalg.norm(flat))
    if length < DARK * np.sqrt(max(whole, 1e-300)):
        return 0.0, 0.0, flat
    return length, length**2 / whole, flat / length
