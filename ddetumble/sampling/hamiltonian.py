r"""NUTS, by numpyro, of parameters and every record's nuisances together.

The joint density $-\tfrac12\sum_g |r_g(\theta, z_g)|^2 - \tfrac12\sum_g |z_g|^2$ and its gradient $-J^T r$ come from
the Jacobian that the fit uses, in forward mode. Coordinates are whitened by the fit, $z_g$ about where it follows
$\theta$, so that the posterior is nearly a standard normal. A limit within reach of the fit becomes a softplus. As the
nuisances are sampled here and integrated out for emcee, agreement of the two tests the integral.
"""

import dataclasses as dc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from ..inference.problem import evaluate
from .checkpoint import ChainFolder
from .curves import CurveTarget
from .diagnostics import judge_chains
from .ensemble import Progress, Settings
from .posterior import Posterior, summarise_posterior
from .target import AbstractTarget, CampaignTarget


REACH = 6.0  # standard deviations within which a limit counts
ACCEPT = {True: 0.85, False: 0.97}  # wanted of moves: of campaigns, nearly Gaussian; of curves, which need not be
DEEPEST = 8  # doublings of a trajectory


class Walls(NamedTuple):
    """Limits within reach, shape (free,); where there is none, infinite."""

    low: Array
    high: Array
    scale: Array


class Joint(NamedTuple):
    """Arrays of the joint density.

    Attributes:
        centre: coordinates of the parameters, shape (free,), and their whitening `factor`, shape (free, free).
        walls: limits.
        prior_mean, prior_weight: of the coordinates, weight 0 where there is none, shape (free,).
        own: Cholesky factor of the nuisances' covariance at the fit, shape (records, nuisances, nuisances).
    """

    centre: Array
    factor: Array
    walls: Walls
    prior_mean: Array
    prior_weight: Array
    own: Array


@partial(jax.custom_vjp, nondiff_argnums=(0, 1, 2))
def _misfit(space, names, channels, shift, z, plan):
    return _linearise(space, names, channels, shift, z, plan)[0]


def _linearise(space, names, channels, shift, z, plan):
    rows = plan.stack.time.shape[0]
    base = jnp.broadcast_to(plan.base, (rows, plan.base.shape[0]))
    at = evaluate(space, names, channels, shift, z, plan.stack, base, plan.directions, plan.low, plan.high)
    shared = jnp.einsum("grk,gr->k", at.shared, at.residual)
    own = jnp.einsum("grk,gr->gk", at.own, at.residual)
    return 0.5 * jnp.sum(at.residual**2), shared, own


def _forward(space, names, channels, shift, z, plan):
    value, shared, own = _linearise(space, names, channels, shift, z, plan)
    return value, (shared, own, plan)


def _backward(space, names, channels, saved, bar):
    shared, own, plan = saved
    return bar * shared, bar * own, jax.tree.map(_nothing, plan)


def _nothing(x):
    return jnp.zeros_like(x) if jnp.issubdtype(x.dtype, jnp.floating) else np.zeros(x.shape, jax.dtypes.float0)


_misfit.defvjp(_forward, _backward)


def _place(y: Array, joint: Joint) -> tuple[Array, Array]:
    """Coordinates of the parameters from whitened ones, shape (free,), and the logarithm of the volume's change."""
    low, high, scale = joint.walls
    x = joint.centre + joint.factor @ y
    walled = jnp.isfinite(low) | jnp.isfinite(high)
    side = jnp.where(jnp.isfinite(low), 1.0, -1.0)
    wall = jnp.where(jnp.isfinite(low), low, jnp.where(jnp.isfinite(high), high, 0.0))
    far = side * (x - wall) / scale
    inside = wall + side * scale * jax.nn.softplus(far)
    volume = jnp.sum(jnp.where(walled, jax.nn.log_sigmoid(far), 0.0))
    return jnp.where(walled, inside, x), volume


def _potential_of_campaign(space, names, channels, joint: Joint, plan, v: Array) -> Array:
    free = joint.centre.shape[0]
    x, volume = _place(v[:free], joint)
    shift = x - plan.centre
    noise = v[free:].reshape(joint.own.shape[:2])
    z = plan.own + jnp.einsum("gkp,p->gk", plan.slope, shift) + jnp.einsum("gkl,gl->gk", joint.own, noise)
    prior = 0.5 * jnp.sum(((x - joint.prior_mean) * joint.prior_weight) ** 2)
    misfit = cast(Array, _misfit(space, names, channels, shift, z, plan))
    return misfit + 0.5 * jnp.sum(z**2) + prior - volume


def _potential_of_curve(rows: Callable, weight: Callable | None, joint: Joint, data: Any, v: Array) -> Array:
    x, volume = _place(v, joint)
    prior = 0.5 * jnp.sum(((x - joint.prior_mean) * joint.prior_weight) ** 2)
    value = 0.5 * jnp.sum(rows(x, data) ** 2) + prior - volume
    value = value if weight is None else value - weight(x, data)
    return jnp.where(jnp.isfinite(value), value, 1e10)


def _pose(target: AbstractTarget) -> tuple[Joint, int, Callable[[Array], Array]]:
    """Arrays, dimension and potential of a target."""
    sd = np.sqrt(np.diag(target.covariance))
    near = np.abs(target.centre - target.low) < REACH * sd, np.abs(target.centre - target.high) < REACH * sd
    both = near[0] & near[1] & (target.centre - target.low > target.high - target.centre)
    low = np.where(near[0] & ~both, target.low, -np.inf)
    high = np.where(near[1] & (~near[0] | both), target.high, np.inf)
    side, wall = np.where(np.isfinite(low), 1.0, -1.0), np.where(np.isfinite(low), low, high)
    walled = np.isfinite(wall)
    # The place before the softplus that leads to the fit, or to a third of a deviation from the wall.
    gap = np.maximum(np.where(walled, side * (target.centre - np.where(walled, wall, 0.0)), sd) / sd, 0.3)
    start = np.where(walled, np.where(walled, wall, 0.0) + side * sd * np.log(np.expm1(gap)), target.centre)
    mean, weight = np.zeros(len(sd)), np.zeros(len(sd))
    for name, (centre, spread) in target.priors.items():
        mean[target.names.index(name)], weight[target.names.index(name)] = centre, 1.0 / spread
    factor = np.linalg.cholesky(target.covariance + 1e-12 * np.diag(sd**2))
    own = np.zeros((0, 0, 0))
    if isinstance(target, CampaignTarget):
        precision = target.integrate(target.centre[None]).factor[0]
        own = np.linalg.inv(np.swapaxes(precision, -1, -2))
    walls = Walls(jnp.asarray(low), jnp.asarray(high), jnp.asarray(sd))
    start, factor, mean, weight, own = (jnp.asarray(a) for a in (start, factor, mean, weight, own))
    joint = Joint(start, factor, walls, mean, weight, own)
    if isinstance(target, CampaignTarget):
        records = target.records
        return joint, len(sd) + own.shape[0] * own.shape[1], partial(
            _potential_of_campaign, target.space, records.nuisances, records.channels, joint, target.plan)
    assert isinstance(target, CurveTarget)
    return joint, len(sd), partial(_potential_of_curve, target.rows, target.weight, joint, target.data)


def run_nuts(target: AbstractTarget, settings: Settings, folder: Path | None = None, progress: Progress | None = None
             ) -> Posterior:
    """Sample by NUTS; see `ensemble.run_ensembles`. `settings.ensembles` is the number of chains, `burn` their warm-up.

    Raises:
        InputError: numpyro is not installed, or the folder is in use or holds something else.
    """
    try:
        from numpyro.infer import NUTS
    except ImportError:
        raise InputError("NUTS needs numpyro; install it with: pip install 'ddetumble[nuts]'") from None
    settings = dc.replace(settings, walkers=1)
    if folder is None:
        return _run(NUTS, target, settings, None, progress)
    with ChainFolder(folder, {**target.identity, "sampler": "nuts", **settings.fixed()}) as chain:
        return _run(NUTS, target.thaw(chain.keep(target.freeze())), settings, chain, progress)


def _run(kernel_of, target: AbstractTarget, settings: Settings, chain: ChainFolder | None, progress) -> Posterior:
    joint, size, potential = _pose(target)
    plain = isinstance(target, CampaignTarget)  # and whitened by its fit; others learn their mass matrix
    kernel = kernel_of(potential_fn=potential, target_accept_prob=ACCEPT[plain], max_tree_depth=DEEPEST,
                       dense_mass=not plain)
    keys = jax.random.split(jax.random.PRNGKey(settings.seed), settings.ensembles + 1)
    starts = 0.5 * jax.random.normal(keys[-1], (settings.ensembles, size))
    states = [kernel.init(keys[k], settings.burn, starts[k], (), {}) for k in range(settings.ensembles)]
    if not all(bool(jnp.isfinite(s.potential_energy)) for s in states):
        raise ComputationError("the model cannot be computed at draws from the fit's Gaussian: the fit is too "
                               "uncertain to sample from; add priors or bounds, or fix a parameter")
    form = jax.tree.structure(states[0])
    blocks = [chain.read(k) for k in range(chain.blocks)] if chain else []
    resumed = done = sum(b["v"].shape[1] for b in blocks)
    if blocks:
        states = [jax.tree.unflatten(form, [jnp.asarray(blocks[-1][f"state_{j}"][k])
                                            for j in range(form.num_leaves)]) for k in range(settings.ensembles)]

    @partial(jax.jit, static_argnums=1)
    def advance(state, steps):
        def one(state, _):
            state = kernel.sample(state, (), {})
            return state, (state.z, -state.potential_energy, state.num_steps, state.diverging, state.accept_prob)

        return jax.lax.scan(one, state, None, length=steps)

    place = jax.jit(jax.vmap(lambda v: _place(v[: len(target.names)], joint)))
    while True:
        late = np.concatenate([b["v"] for b in blocks], axis=1)[:, settings.burn:] if blocks else np.zeros(
            (settings.ensembles, 0, size))
        x = np.asarray(place(late.reshape(-1, size))[0]).reshape(*late.shape[:2], 1, len(target.names))
        convergence = judge_chains(x, settings.effective)
        if convergence.enough or done >= settings.burn + settings.most:
            break
        steps = settings.block
        results = map_threads(lambda s, n=steps: jax.block_until_ready(advance(s, n)), states)
        states = [r[0] for r in results]
        named = zip(("v", "log_density", "leapfrogs", "diverging", "accept"), range(5), strict=True)
        block = {name: np.stack([np.asarray(r[1][j]) for r in results]) for name, j in named}
        leaves = [jax.tree.leaves(s) for s in states]
        block |= {f"state_{j}": np.stack([np.asarray(own[j]) for own in leaves]) for j in range(form.num_leaves)}
        blocks.append(block)
        if chain:
            chain.append(block)
        done += steps
        if progress:
            share = max(convergence.effective / settings.effective, (done - settings.burn) / settings.most)
            told = "settling" if done <= settings.burn else f"{convergence.effective:.0f} independent draws"
            progress(f"step {done}: {told}", min(max(share, 0.0), 1.0))
    values = {name: np.concatenate([b[name] for b in blocks], axis=1)[:, settings.burn:]
              for name in ("log_density", "leapfrogs", "diverging", "accept")}
    statistics = {"accepted": float(values["accept"].mean()), "divergences": int(values["diverging"].sum()),
                  "leapfrogs": int(sum(b["leapfrogs"].sum() for b in blocks)), "resumed": resumed}
    if joint.own.shape[0]:
        target = dc.replace(target, notes=("every record's nuisances were sampled along with the parameters",))
    return summarise_posterior(target, "nuts", dc.asdict(settings), x, values["log_density"][..., None], convergence,
                               statistics)
