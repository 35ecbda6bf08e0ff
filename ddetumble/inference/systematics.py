r"""What errors that all records share, and nobody stated, do to the estimates of a fit.

No repetition shows that a gauge reads high throughout, and no interval of a fit allows for it unless it is stated
(`common_uncertainty`). To first order a channel $y$ that reads too high by a share $s$ changes the whitened residual by
$-s y$, a condition $c$ by $s c\,\partial r/\partial c$, and the estimates follow by least squares with the nuisances
of every record under their priors; what no parameter takes up is what the records show of it (sensitivity coefficients
of an uncertainty budget: GUM, JCGM 100:2008, section 5).
"""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from .._sentences import say
from ..measurement.campaign import Campaign
from ..measurement.quantities import format_number
from .problem import AbstractProblem, Problem, Solution
from .variance_components import list_settings


SHARE = 0.01  # relative error that is looked at: what an ordinary gauge may be off by
MATTERS = 1.0  # standard deviations of a parameter beyond which its interval misses what the error does to it
SHOWS = 3.0  # standard deviations beyond which the records show the error by themselves


@dc.dataclass(frozen=True)
class Systematic:
    """What a relative error of one gauge, the same in all records, does to a fit, to first order."""

    name: str  # of the channel or condition that reads too high
    share: float  # by which
    moves: Mapping[str, float]  # change of the estimates, in their public units
    deviations: Mapping[str, float]  # the same in standard deviations of the estimate
    seen: float  # standard deviations by which the records show it: the root of what chi-square rises by

    def __str__(self) -> str:
        """What it moves furthest, in words."""
        worst = max(self.deviations, key=lambda name: abs(self.deviations[name]))
        return str(say("words.systematic", cause=self.name, share=self.share, name=worst,
                       deviations=format_number(abs(self.deviations[worst]), 2)))

    @property
    def hidden(self) -> bool:
        """Whether it moves an estimate further than that is uncertain, and the records do not show it."""
        return self.seen < SHOWS and any(abs(away) > MATTERS for away in self.deviations.values())


def measure_systematics(problem: Problem, solution: Solution, covariance: np.ndarray, campaign: Campaign
                        ) -> tuple[Systematic, ...]:
    """What an error by `SHARE` of every channel and condition, each by itself, does to the free parameters of a fit.

    Left out are errors that the campaign states (they are parameters of the fit), and conditions that are taken as
    exact in a record.

    Args:
        problem, solution, campaign: what was fitted, and how.
        covariance: of the free coordinates of the solution, shape (free, free).
    """
    records = problem.records
    stated = {common.column for common in problem.space.commons}
    changes = {channel: np.stack([-records.whiten(r, c, solution.channels[r, c, :n, None])[:, 0]
                                  for r, n in enumerate(records.lengths)])
               for c, channel in enumerate(records.channels) if channel not in stated}
    deviations = np.asarray(records.stack.condition_sd)[: records.count]
    for k in list_settings(records):
        name = records.nuisances[k]
        if name in campaign.records and name not in stated and (deviations[:, k] > 0).all():
            values = campaign.records.loc[list(records.keys), name].to_numpy(dtype=float)
            changes[name] = solution.own[:, :, k] * (values / deviations[:, k])[:, None]
    if not changes or not solution.names:
        return ()
    more = SHARE * np.stack(list(changes.values()), axis=2)
    free = len(solution.names)
    columns, _ = solution.projected(shared=np.concatenate([solution.shared, more], axis=2))
    prior = np.concatenate([np.diag(solution.prior_weight), np.zeros((free, more.shape[2]))], axis=1)
    factor = np.linalg.qr(np.concatenate([columns.reshape(-1, columns.shape[2]), prior]), mode="r")
    left, right = factor[:, :free], factor[:, free:]
    size = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    steps = np.linalg.lstsq(left / size, -right, rcond=1e-12)[0] / size[:, None]
    seen = np.linalg.norm(right + left @ steps, axis=0)
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    return tuple(_describe(problem, solution, name, steps[:, k] * solution.scales, sd, float(seen[k]))
                 for k, name in enumerate(changes))


def _describe(problem: AbstractProblem, solution: Solution, name: str, step: np.ndarray, sd: np.ndarray, seen: float
              ) -> Systematic:
    """A step of the free coordinates in the units of people."""
    moves, own = {}, {}
    for k, free in enumerate(solution.names):
        transform, u = problem.space.parameter(free).transform, float(solution.u[problem.space.index[free]])
        moves[free] = float(transform.from_unconstrained(u + step[k]) - transform.from_unconstrained(u))
        own[free] = float(step[k] / sd[k])
    return Systematic(name, SHARE, moves, own, seen)


def tell_systematics(found: tuple[Systematic, ...]) -> str:
    """The errors that intervals do not allow for and records do not show, in a sentence; '' where there are none."""
    hidden = [str(one) for one in found if one.hidden]
    return str(say("words.systematics", causes=hidden)) if hidden else ""
