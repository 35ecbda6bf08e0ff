r"""Likelihood of a record with its nuisances integrated out.

For record g with whitened residual $r_g(x, z)$ and nuisances $z \sim N(0, 1)$ in units of their deviations,

$$ p(y_g | x) \propto \int e^{-|r_g(x, z)|^2/2 - |z|^2/2} dz . $$

Where $r_g$ is linear in $z$ over the width of the integrand, with slope $Z$ at any point $z_0$,

$$ \ln p = -\tfrac12 (|r|^2 + |z_0|^2 - g^T A^{-1} g) - \tfrac12 \ln |A|, \quad A = 1 + Z^T Z, \quad g = Z^T r + z_0 $$

exactly. $z_0$ is where the linearised fit expects the best $z$, so that a model that is nearly linear is met close to
its optimum. Where it is not linear, the integral is the mean of importance weights over a fixed set of points drawn
from that Gaussian (common random numbers: a smooth function of $x$).
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg as jsl
import numpy as np
from jaxtyping import Array
from scipy import stats

from ..inference.problem import FAILED, evaluate, simulate_records
from ..inference.stack import Stack


class Plan(eqx.Module):
    """What the likelihood needs beside the parameters: arrays only, so that it is an argument of compiled programs.

    Attributes:
        stack: the records.
        base: coordinates of all parameters of the space at the fit, shape (parameters,).
        directions: rows of the identity that belong to the free parameters, shape (free, parameters).
        low, high: limits of the model, shape (parameters,).
        centre: coordinates of the free parameters at the fit, shape (free,).
        own: best nuisances at the fit, shape (records, nuisances).
        slope: change of these by the free coordinates, shape (records, nuisances, free).
        nodes: standard normal points of the importance sampling, shape (points, nuisances); no points: linear.
        constant: normalisation of each record's Gaussian, shape (records,).
    """

    stack: Stack
    base: Array
    directions: Array
    low: Array
    high: Array
    centre: Array
    own: Array
    slope: Array
    nodes: Array
    constant: Array


class Integral(NamedTuple):
    """One record's (or many records') integral over the nuisances.

    Attributes:
        value: logarithm of the likelihood, -inf where the model failed.
        mean: of the nuisances given the parameters, shape (..., nuisances).
        factor: Cholesky factor of their precision $A$, shape (..., nuisances, nuisances).
    """

    value: Array
    mean: Array
    factor: Array


def draw_nodes(count: int, dimension: int, seed: int = 0) -> np.ndarray:
    """Standard normal points, evenly spread (scrambled Sobol, with their mirror images), shape (count, dimension)."""
    if not count:
        return np.zeros((0, dimension))
    half = stats.qmc.Sobol(dimension, rng=np.random.default_rng(seed)).random(count // 2)
    points = stats.norm.ppf(np.clip(half, 1e-9, 1 - 1e-9))
    return np.concatenate([points, -points])


def _integrate(space, names, channels, x: Array, plan: Plan) -> Integral:
    """All records at one point x, shape (free,)."""
    stack, rows = plan.stack, plan.stack.time.shape[0]
    count = plan.base.shape[0]
    shift = x - plan.centre
    base = jnp.broadcast_to(plan.base + shift @ plan.directions, (rows, count))
    start = plan.own + jnp.einsum("gkp,p->gk", plan.slope, shift)
    start = jnp.clip(jnp.where(jnp.isfinite(start), start, 0.0), -8.0, 8.0) * stack.present[:, None]
    at = evaluate(space, names, channels, jnp.zeros(0), start, stack, base, jnp.zeros((0, count)), plan.low, plan.high)
    size = start.shape[1]
    corner = jnp.eye(size) + jnp.einsum("grk,grl->gkl", at.own, at.own)
    gradient = jnp.einsum("grk,gr->gk", at.own, at.residual) + start
    factor = jnp.linalg.cholesky(corner)
    step = jax.vmap(lambda f, b: jsl.cho_solve((f, True), b))(factor, gradient)
    half = jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    mean = start - step
    square = jnp.sum(at.residual**2, axis=1) + jnp.sum(start**2, axis=1) - jnp.sum(gradient * step, axis=1)
    value = -0.5 * square
    failed = at.failed
    if plan.nodes.shape[0]:
        def weigh(node):
            offset = jax.vmap(lambda f: jsl.solve_triangular(f, node, trans=1, lower=True))(factor)
            z = mean + offset
            residual, bad = simulate_records(space, names, channels, z, stack, base, plan.low, plan.high)[:2]
            here = -0.5 * (jnp.sum(residual**2, axis=1) + jnp.sum(z**2, axis=1)) + 0.5 * jnp.sum(node**2)
            return jnp.where(bad, -0.5 * FAILED**2, here)

        weights = jax.lax.map(weigh, plan.nodes)
        value = jax.scipy.special.logsumexp(weights, axis=0) - jnp.log(plan.nodes.shape[0])
    value = jnp.where(failed | ~jnp.isfinite(value), -jnp.inf, value - half + plan.constant)
    return Integral(jnp.where(stack.present > 0, value, 0.0), mean, factor)


@partial(jax.jit, static_argnums=(0, 1, 2))
def integrate_nuisances(space, names, channels, x: Array, plan: Plan) -> Integral:
    """Likelihood of every record at many points.

    Args:
        space: of the parameters.
        names: of the nuisances.
        channels: that are measured.
        x: coordinates of the free parameters, shape (points, free).
        plan: everything else.

    Returns:
        The integrals, shapes (points, records, ...).
    """
    return jax.lax.map(lambda one: _integrate(space, names, channels, one, plan), x)
