r"""NUTS, by numpyro, of parameters and every record's nuisances together.

The joint density $-\tfrac12\sum_g |r_g(\theta, z_g)|^2 - \tfrac12\sum_g |z_g|^2$ and its gradient $-J^T r$ come from
the Jacobian that the fit uses, in forward mode. Coordinates are whitened by the fit, $z_g$ about where it follows
$\theta$, so that the posterior is nearly a standard normal. A limit within reach of the fit becomes a softplus. As the
nuisances are sampled here and integrated out for emcee, agreement of the two tests the integral.
"""

import dataclasses as dc
from collections.abc import Callable
from functools import partial
from typing import Any, cast, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from ..inference.problem import evaluate
from .chain import AbstractSampler, Block, Settings
from .target import TOO_UNCERTAIN, AbstractTarget, CampaignTarget, CurveTarget


REACH = 6.0  # standard deviations within which a limit counts: farther off, no draw meets it
# Standard deviations from a limit at which a fit counts that lies closer to it: at the limit itself the transform is
# singular.
NEAREST = 0.3
ACCEPT = {True: 0.85, False: 0.97}  # wanted of moves: of campaigns, nearly Gaussian; of curves, which need not be
DEEPEST = 8  # doublings of a trajectory


def _misfit_of_records(target: CampaignTarget, own: Array) -> Callable[[Array, Array], Array]:
    """Half of the squares of residuals and nuisances, of parameters and nuisances that `own` whitens."""
    records, plan = target.records, target.plan
    base = jnp.broadcast_to(plan.base, (plan.stack.time.shape[0], plan.base.shape[0]))

    def linearise(shift, z):
        at = evaluate(target.space, records.nuisances, records.channels, shift, z, plan.stack, base, plan.directions,
                      plan.low, plan.high)
        slopes = jnp.einsum("grk,gr->k", at.shared, at.residual), jnp.einsum("grk,gr->gk", at.own, at.residual)
        return 0.5 * jnp.sum(at.residual**2), slopes

    half = jax.custom_vjp(lambda shift, z: linearise(shift, z)[0])
    half.defvjp(linearise, lambda slopes, bar: (bar * slopes[0], bar * slopes[1]))

    def misfit(x, v):
        shift = x - plan.centre
        noise = v.reshape(own.shape[:2])
        z = plan.own + jnp.einsum("gkp,p->gk", plan.slope, shift) + jnp.einsum("gkl,gl->gk", own, noise)
        return cast(Array, half(shift, z)) + 0.5 * jnp.sum(z**2)

    return misfit


def _misfit_of_curve(target: CurveTarget, x: Array, v: Array) -> Array:
    value = 0.5 * jnp.sum(target.rows(x, target.data) ** 2)
    return jnp.where(jnp.isfinite(value), value, 1e10)  # a wall, with a finite gradient


def _pose(target: AbstractTarget) -> tuple[Callable[[Array], tuple[Array, Array]], Callable[[Array], Array], int]:
    """How a target is sampled: coordinates of the parameters from whitened ones, with the logarithm of the volume's
    change; the potential of whitened parameters and then nuisances; the number of these nuisances.
    """
    sd = np.sqrt(np.diag(target.covariance))
    below, above = np.abs(target.centre - target.low), np.abs(target.centre - target.high)
    lower = (below < REACH * sd) & (below <= above)
    walled = lower | (above < REACH * sd)
    side = np.where(lower | ~walled, 1.0, -1.0)
    wall = np.where(walled, np.where(lower, target.low, target.high), 0.0)
    # The place before the softplus that leads to the fit, or to the nearest place off the wall.
    gap = np.maximum(np.where(walled, side * (target.centre - wall), sd) / sd, NEAREST)
    start = np.where(walled, wall + side * sd * np.log(np.expm1(gap)), target.centre)
    factor = jnp.asarray(np.linalg.cholesky(target.covariance + 1e-12 * np.diag(sd**2)))
    mean, weight = np.zeros(len(sd)), np.zeros(len(sd))
    for name, (centre, spread) in target.priors.items():
        mean[target.names.index(name)], weight[target.names.index(name)] = centre, 1.0 / spread
    if isinstance(target, CampaignTarget):
        precision = target.integrate(target.centre[None]).factor[0]
        own = np.linalg.inv(np.swapaxes(precision, -1, -2))
        misfit, nuisances = _misfit_of_records(target, jnp.asarray(own)), own.shape[0] * own.shape[1]
    else:
        assert isinstance(target, CurveTarget)
        misfit, nuisances = partial(_misfit_of_curve, target), 0

    def place(y: Array) -> tuple[Array, Array]:
        x = start + factor @ y
        far = side * (x - wall) / sd
        volume = jnp.sum(jnp.where(walled, jax.nn.log_sigmoid(far), 0.0))
        return jnp.where(walled, wall + side * sd * jax.nn.softplus(far), x), volume

    def potential(v: Array) -> Array:
        x, volume = place(v[: len(sd)])
        return misfit(x, v[len(sd):]) + 0.5 * jnp.sum(((x - mean) * weight) ** 2) - volume

    return place, potential, nuisances


@final
class Nuts(AbstractSampler):
    """Several chains of NUTS, whose warm-up is the burn-in."""

    name = "nuts"

    def __init__(self, target: AbstractTarget, settings: Settings):
        try:
            from numpyro.infer import NUTS
        except ImportError:
            raise InputError('NUTS needs numpyro; install it with: pip install "ddetumble[nuts]"') from None
        plain = isinstance(target, CampaignTarget)  # and whitened by its fit; others learn their mass matrix
        place, potential, nuisances = _pose(target)
        if nuisances:
            target = dc.replace(target, notes=("every record's nuisances were sampled along with the parameters",))
        super().__init__(target, settings)
        free = len(target.names)
        kernel = NUTS(potential_fn=potential, target_accept_prob=ACCEPT[plain], max_tree_depth=DEEPEST,
                      dense_mass=not plain)
        *keys, last = jax.random.split(jax.random.PRNGKey(settings.seed), settings.ensembles + 1)
        starts = 0.5 * jax.random.normal(last, (settings.ensembles, free + nuisances))
        self.states = [kernel.init(key, settings.burn, start, (), {}) for key, start in zip(keys, starts, strict=True)]
        if not all(bool(jnp.isfinite(s.potential_energy)) for s in self.states):
            raise ComputationError(TOO_UNCERTAIN)

        @partial(jax.jit, static_argnums=1)
        def run(state, steps):
            def one(state, _):
                state = kernel.sample(state, (), {})
                return state, {"x": place(state.z[:free])[0][None], "log_density": -state.potential_energy[None],
                               "leapfrogs": state.num_steps, "diverging": state.diverging, "accept": state.accept_prob}

            return jax.lax.scan(one, state, None, length=steps)

        self._run = run

    @staticmethod
    def count_walkers(settings: Settings, free: int) -> int:
        """As the base class has it."""
        return 1

    def advance(self, steps: int) -> Block:
        """As the base class has it."""
        results = map_threads(lambda s: jax.block_until_ready(self._run(s, steps)), self.states)
        self.states = [state for state, _ in results]
        leaves = zip(*map(jax.tree.leaves, self.states), strict=True)
        return {**{name: np.stack([np.asarray(own[name]) for _, own in results]) for name in results[0][1]},
                **{f"state_{j}": np.stack([np.asarray(leaf) for leaf in own]) for j, own in enumerate(leaves)}}

    def resume(self, block: Block) -> None:
        """As the base class has it."""
        form = jax.tree.structure(self.states[0])
        leaves = [block[f"state_{j}"] for j in range(form.num_leaves)]
        self.states = [jax.tree.unflatten(form, [jnp.asarray(leaf[k]) for leaf in leaves])
                       for k in range(self.settings.ensembles)]

    def refine(self, draws: np.ndarray) -> None:
        """Nothing: nuisances are sampled, not integrated out."""

    def adapt(self, draws: np.ndarray) -> None:
        """Nothing: the kernel has adapted itself while it warmed up."""

    def count(self, blocks: list[Block], late: list[Block]) -> dict[str, Any]:
        """As the base class has it."""
        return {"accepted": float(np.mean(np.concatenate([block["accept"] for block in late], axis=1))),
                "divergences": int(sum(block["diverging"].sum() for block in late)),
                "leapfrogs": int(sum(block["leapfrogs"].sum() for block in blocks))}
