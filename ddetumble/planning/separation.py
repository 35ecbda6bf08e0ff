r"""How far apart two models stay at a test when one of them may be refitted: pure formulas.

Model B, fitted to what was measured so far, has coordinates $\hat u + L\,x$ with $x \sim N(0, I)$; a record's own
nuisances $z \sim N(0, I)$. For whitened readings $r_A$ and $r_B$ of one test, $\Delta = r_A - r_B$, and derivatives $J$
of $r_B$ by $x$ and $Z$ by $z$, what $n$ repeats leave after B has been refitted to them, old records and all, is

$$d^2(n) = \min_x\; n\,\|P(\Delta - J x)\|^2 + \|x\|^2
        = n\left[\Delta^T P \Delta - g^T (I/n + M)^{-1} g\right],\qquad g = J^T P \Delta,\; M = J^T P J$$

with $P = I - Z (I + Z^T Z)^{-1} Z^T$. It is the expected rise of chi-square of B over A where A is true, and twice
the expected logarithm of the Bayes factor less what only the widths of both predictions say (which is never negative).
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


class Contrast(NamedTuple):
    r"""What one test says about two models: $\Delta^T P \Delta$, $g$ and $M$ of the module's equation.

    Attributes:
        size: shape ().
        pull: shape (directions,).
        stiffness: shape (directions, directions).
    """

    size: Array
    pull: Array
    stiffness: Array


def profile_nuisances(columns: Array, own: Array) -> Array:
    """Columns less what the record's own nuisances, with unit priors, can take up.

    Args:
        columns: whitened, shape (rows, columns).
        own: derivatives by the nuisances in units of their deviations, shape (rows, nuisances).

    Returns:
        Shape (rows + nuisances, columns); the last rows are those of the priors.
    """
    count = own.shape[1]
    basis, _ = jnp.linalg.qr(jnp.concatenate([own, jnp.eye(count)]))
    padded = jnp.concatenate([columns, jnp.zeros((count, columns.shape[1]))])
    return padded - basis @ (basis.T @ padded)


def contrast(difference: Array, shared: Array, own: Array) -> Contrast:
    """Reduce one test of two models to a few numbers.

    Args:
        difference: of the whitened readings, shape (rows,).
        shared: derivatives of the model that is refitted, along its principal directions, shape (rows, directions).
        own: by its nuisances in units of their deviations, shape (rows, nuisances).
    """
    both = profile_nuisances(jnp.concatenate([difference[:, None], shared], axis=1), own)
    left, moved = both[:, 0], both[:, 1:]
    return Contrast(left @ left, moved.T @ left, moved.T @ moved)


def separate(found: Contrast, repeats: Array | float = 1.0) -> Array:
    """Squared distance that so many repeats leave after the refit, in noise variances, shape ()."""
    among = jnp.eye(found.pull.shape[0]) / repeats + found.stiffness
    return repeats * (found.size - found.pull @ jnp.linalg.solve(among, found.pull))


def count_repeats(found: Contrast, target: float, most: int) -> int | None:
    """Fewest repeats that leave at least `target` noise variances; None where `most` are too few."""
    if not math.isfinite(float(found.size)) or float(separate(found, float(most))) < target:
        return None
    low, high = 0, most  # the distance grows with every repeat
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if float(separate(found, float(middle))) >= target else (middle, high)
    return high


def gain_information(shared: Array, own: Array, repeats: Array | float = 1.0) -> Array:
    r"""Expected gain of information on the parameters, $\frac12 \ln\det(I + n M)$ [nat], shape ()."""
    moved = profile_nuisances(shared, own)
    return 0.5 * jnp.linalg.slogdet(jnp.eye(shared.shape[1]) + repeats * (moved.T @ moved))[1]


def balance(there: np.ndarray, back: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Harmonic mean $2ab/(a + b)$ of the two squared distances of a pair, and its derivatives by $a$ and $b$.

    It counts whichever of the two is true, and is smooth where they change places.
    """
    total = there + back + 1e-12
    return 2.0 * there * back / total, 2.0 * (back / total) ** 2, 2.0 * (there / total) ** 2
