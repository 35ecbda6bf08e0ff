"""Looking after every new record: evidence against a model that may be looked at as often as one likes."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import sparse, special

from ..inference import distributions as stats
from ..inference.goodness import doubt_level
from ..inference.noise import Noise
from ..inference.problem import Problem, Solution
from ..inference.smooth import orthonormalise


POWERS = np.linspace(0.05, 0.95, 19)  # of the p-values: small ones bet on strong misfits, large ones on faint ones
TOLD = 1e-9  # singular value of scaled columns, below which a combination of them tells nothing


@dc.dataclass(frozen=True)
class Sequential:
    """Evidence against a model, record by record in the order of the campaign.

    Attributes:
        records: their keys.
        p_values: of the misfit of every record, given all before it; shape (records,).
        e_values: evidence of all records up to each, shape (records,). Of a complete model it passes 1/a at any time at
            all with probability a at most (Ville 1939), so that nobody needs to say beforehand when the tests end.
    """

    records: tuple[str, ...]
    p_values: np.ndarray
    e_values: np.ndarray

    def __str__(self) -> str:
        """The evidence in one sentence."""
        alarm, last, passed = self.find_alarm(), float(self.e_values[-1]), "20 would count at any time"
        if alarm is not None:
            number = self.records.index(alarm) + 1
            passed = f"it passed 20 after {number} of {len(self.records)} records, at {alarm}"
        return ("Looked at after every record, in the order of the campaign, the evidence against the model (e-value) "
                f"is {'above a million' if last > 1e6 else f'{last:.2g}'}; {passed}.")

    def find_alarm(self, level: float = 0.05) -> str | None:
        """Record at which the evidence first passes one over `level`; None where it never does."""
        past = np.flatnonzero(self.e_values >= 1.0 / level)
        return self.records[past[0]] if past.size else None


def follow_records(problem: Problem, solution: Solution, bases: Sequence[sparse.csr_matrix], noise: Mapping[str, Noise]
                   ) -> Sequential:
    """Evidence against a fitted model after every record, from what of its residuals is smooth over a contact.

    Each record's misfit is by how much it raises the least sum of squares of all records up to it, to first order about
    the fit: independent chi-squares under a complete model (recursive residuals: Brown, Durbin & Evans 1975, J. Roy.
    Stat. Soc. B 37, 149). The noise counts as loud as it may be.

    Args:
        problem, solution: a fit of all records.
        bases: of `smooth_bases`.
        noise: by channel.
    """
    p_values = weigh_increments(list_parts(solution, bases), np.diag(solution.prior_weight), solution.prior_residual,
                                float(np.exp(2.0 * doubt_level(noise))))
    return Sequential(problem.records.keys, p_values, accumulate(p_values))


def list_parts(solution: Solution, bases: Sequence[sparse.csr_matrix]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Shared columns, shape (rows, free), and residual, shape (rows,), of every record in the space of what is smooth.

    The record's own settings are eliminated; the noise of every row is one.
    """
    columns, right = solution.projected()
    own, parts = solution.own.shape[2], []
    for r, basis in enumerate(bases):
        settings = np.linalg.qr(np.concatenate([solution.own[r], np.eye(own)]))[0][: len(solution.own[r])]
        aside = basis.T @ settings
        both = np.concatenate([columns[r], right[r][:, None]], axis=1)  # without what settings do: so is their cross
        cross = np.concatenate([basis.T @ both[: len(settings)], columns[r].T @ both])
        square = np.block([[(basis.T @ basis).toarray() - aside @ aside.T, cross[: len(aside), :-1]],
                           [cross[: len(aside), :-1].T, cross[len(aside):, :-1]]])
        smooth = orthonormalise(square).T @ cross
        parts.append((smooth[:, :-1], smooth[:, -1]))
    return parts


def weigh_increments(parts: Sequence[tuple[np.ndarray, np.ndarray]], prior: np.ndarray, prior_residual: np.ndarray,
                     louder: float = 1.0) -> np.ndarray:
    """p-value of what every part adds to the least sum of squares of all parts up to it, shape (parts,).

    Args:
        parts: columns of the shared parameters, shape (rows, free), and residuals with unit noise, shape (rows,).
        prior, prior_residual: rows that count from the start, shapes (rows, free) and (rows,).
        louder: variance that the noise may have.
    """
    known = np.concatenate([prior, prior_residual[:, None]], axis=1)
    rank, least = _reduce(known)
    found = []
    for columns, right in parts:
        known = np.linalg.qr(np.concatenate([known, np.concatenate([columns, right[:, None]], axis=1)]), mode="r")
        (before, rest), (rank, least) = (rank, least), _reduce(known)
        freedom = len(right) - (rank - before)
        found.append(stats.chi2.sf(max(least - rest, 0.0) / louder, freedom) if freedom > 0 else 1.0)
    return np.array(found)


def accumulate(p_values: np.ndarray) -> np.ndarray:
    r"""Evidence after every p-value, shape (times,): the mean over powers $\kappa$ of $\prod \kappa p_t^{\kappa - 1}$.

    Each factor has a mean of one under the hypothesis, whatever came before (Vovk & Wang 2021, Annals of Statistics 49,
    1736), so that the mean of the products does too.
    """
    logarithms = np.log(POWERS) + (POWERS - 1.0) * np.log(np.maximum(p_values, 1e-300))[:, None]
    return np.exp(np.minimum(special.logsumexp(np.cumsum(logarithms, axis=0), axis=1) - np.log(len(POWERS)), 700.0))


def _reduce(known: np.ndarray) -> tuple[int, float]:
    """Rank of the columns but the last, and the sum of squares that they leave of it."""
    columns, right = known[:, :-1], known[:, -1]
    size = np.linalg.norm(columns, axis=0)
    basis, s, _ = np.linalg.svd(columns[:, size > TOLD] / size[size > TOLD], full_matrices=False)
    basis = basis[:, s > TOLD * s[:1].max(initial=0.0)]
    return basis.shape[1], float(np.sum((right - basis @ (basis.T @ right)) ** 2))
