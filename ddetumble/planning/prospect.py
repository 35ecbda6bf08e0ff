"""What a whole sequence leaves when the contact is another than it was planned with.

Every impact is struck as planned: at its place on the body, with its velocity relative to that, its pressure, and its
wait after the impact before. So the arm follows the body as it sees it, and nothing is planned again; what an impact
leaves otherwise than planned, the next ones meet.
"""

import dataclasses as dc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .ambiguity import Spread, summarise_draws
from .chain import SHARE, follow_impacts
from .draws import Laws
from .risk import pose_draws
from .sequence import Sequence
from .strike_plan import ALLOWED
from .strike_problem import CONSTRAINTS, MISSED, StrikeProblem


@dc.dataclass(frozen=True, eq=False)
class Prospect:
    """What a sequence does under the draws of all models.

    Attributes:
        after: share of the angular momentum left after each impact.
        best: the same under the best estimate, shape (impacts,) [-].
        reached: probability that no more than the wanted share is left at the end.
        violated: probability that a constraint of an impact does not hold, by the impact's number and its name; only
            those that are not nought.
        lost: probability that the sequence cannot be struck to its end, as an impact misses or cannot be integrated.
        sentence: all of that in words.
    """

    after: tuple[Spread, ...]
    best: np.ndarray
    reached: float
    violated: dict[str, float]
    lost: float
    sentence: str


def assess_sequence(problem: StrikeProblem, sequence: Sequence, laws: Laws, share: float, *, tail: float = 0.1
                    ) -> Prospect | None:
    """Strike a planned sequence under every drawn law.

    Args:
        problem: of the first impact.
        sequence: of two impacts or more.
        laws: that may be true.
        share: of the angular momentum that was wanted.
        tail: share of the draws that counts as the bad tail.

    Returns:
        What came of it; None where no draw could be followed to the end.
    """
    names = problem.debris.surface.face_names()
    faces = jnp.asarray([names.index(plan.face) for plan in sequence.impacts])
    x = jnp.asarray(np.stack([plan.x for plan in sequence.impacts]))
    best = follow_impacts(eqx.tree_at(lambda p: p.law, problem, laws.main), faces, x)
    rows = np.stack([follow_impacts(one, faces, x) for one in pose_draws(problem, laws)])
    weights = laws.shares()
    approach = rows[:, :, SHARE + 1 + CONSTRAINTS.index("approach")]
    whole = np.isfinite(rows).all(axis=(1, 2)) & ~(approach <= MISSED - 1.0).any(axis=1)
    if not whole.any():
        return None
    lost = float(weights[~whole].sum())
    rows, weights = rows[whole], weights[whole] / weights[whole].sum()
    left = np.sqrt(np.maximum(rows[:, :, SHARE], 0.0))
    after = tuple(summarise_draws(column, weights, tail) for column in left.T)
    broken = np.einsum("d,dkc->kc", weights, rows[:, :, SHARE + 1:] < -ALLOWED)
    violated = {f"{k + 1}: {CONSTRAINTS[c]}": float(broken[k, c]) for k, c in zip(*np.nonzero(broken), strict=True)}
    reached = float(weights @ (left[:, -1] <= share * (1.0 + 1e-3))) * (1.0 - lost)
    return Prospect(after, np.sqrt(np.maximum(best[:, SHARE], 0.0)), reached, violated, lost,
                    _describe(after, reached, violated, lost, share, tail))


def _describe(after: tuple[Spread, ...], reached: float, violated: dict[str, float], lost: float, share: float,
              tail: float) -> str:
    end = after[-1]
    told = (f"Under the uncertainty of the contact the {len(after)} impacts together, nothing being planned again "
            f"between them, leave {100 * end.mean:.2f} ± {100 * end.sd:.2f} % of the angular momentum, in the worst "
            f"{100 * tail:.0f} % of the draws {100 * end.tail:.2f} % on average; the {100 * share:g} % wanted are "
            f"reached in {100 * reached:.0f} % of the draws.")
    if violated:
        worst = max(violated, key=lambda name: violated[name])
        number, name = worst.split(": ")
        told += (f" Limits that not every draw keeps: {len(violated)}, most often the {name} of impact {number} "
                 f"({100 * violated[worst]:.0f} %).")
    if lost > 0:
        told += f" In {100 * lost:.0f} % of the draws the sequence could not be struck to its end."
    if reached < 0.5:
        told += " Measure the motion after each impact, and plan the next ones again."
    return told
