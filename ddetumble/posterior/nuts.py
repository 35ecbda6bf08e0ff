r"""NUTS, by numpyro, of parameters and every record's nuisances together.

The joint density $-\tfrac12\sum_g |r_g(\theta, z_g)|^2 - \tfrac12\sum_g |z_g|^2$ and its gradient $-J^T r$ come from
the Jacobian that the fit uses, in forward mode. Coordinates are whitened by the fit, $z_g$ about where it follows
$\theta$, so that the posterior is nearly a standard normal. A limit within reach of the fit becomes a softplus. As the
nuisances are sampled here and integrated out for emcee, agreement of the two tests the integral.
"""

import dataclasses as dc
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from ..inference.problem import evaluate
from .chain import AbstractSampler, Block, Settings
from .target import AbstractTarget, CampaignTarget, CurveTarget


REACH = 6.0  # standard deviations within which a limit counts
ACCEPT = {True: 0.85, False: 0.97}  # wanted of moves: of campaigns, nearly Gaussian; of curves, which need not be
DEEPEST = 8  # doublings of a trajectory


class Joint(NamedTuple):
    """Arrays of the joint density.

    Attributes:
        centre: coordinates of the parameters, shape (free,), and their whitening `factor`, shape (free, free).
        walled: whether a limit is within reach, its `wall`, the `side` on which parameters lie (1 above it), and the
            `scale` of the softplus, shapes (free,).
        prior_mean, prior_weight: of the coordinates, weight 0 where there is none, shape (free,).
        own: Cholesky factor of the nuisances' covariance at the fit, shape (records, nuisances, nuisances).
    """

    centre: Array
    factor: Array
    walled: Array
    wall: Array
    side: Array
    scale: Array
    prior_mean: Array
    prior_weight: Array
    own: Array


def _place(y: Array, joint: Joint) -> tuple[Array, Array]:
    """Coordinates of the parameters from whitened ones, shape (free,), and the logarithm of the volume's change."""
    x = joint.centre + joint.factor @ y
    far = joint.side * (x - joint.wall) / joint.scale
    inside = joint.wall + joint.side * joint.scale * jax.nn.softplus(far)
    volume = jnp.sum(jnp.where(joint.walled, jax.nn.log_sigmoid(far), 0.0))
    return jnp.where(joint.walled, inside, x), volume


def _make_misfit(target: CampaignTarget, own: Array) -> Callable[[Array, Array], Array]:
    """Half of the squares of residuals and nuisances, of parameters and whitened nuisances."""
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
    value = value if target.weight is None else value - target.weight(x, target.data)
    return jnp.where(jnp.isfinite(value), value, 1e10)


def _pose(target: AbstractTarget) -> tuple[Joint, Callable[[Array], Array]]:
    """Arrays and potential of a target, of whitened parameters and then nuisances."""
    sd = np.sqrt(np.diag(target.covariance))
    below, above = np.abs(target.centre - target.low), np.abs(target.centre - target.high)
    lower = (below < REACH * sd) & (below <= above)
    walled = lower | (above < REACH * sd)
    side = np.where(lower | ~walled, 1.0, -1.0)
    wall = np.where(walled, np.where(lower, target.low, target.high), 0.0)
    # The place before the softplus that leads to the fit, or to a third of a deviation from the wall.
    gap = np.maximum(np.where(walled, side * (target.centre - wall), sd) / sd, 0.3)
    start = np.where(walled, wall + side * sd * np.log(np.expm1(gap)), target.centre)
    mean, weight = np.zeros(len(sd)), np.zeros(len(sd))
    for name, (centre, spread) in target.priors.items():
        mean[target.names.index(name)], weight[target.names.index(name)] = centre, 1.0 / spread
    factor, own = np.linalg.cholesky(target.covariance + 1e-12 * np.diag(sd**2)), np.zeros((0, 0, 0))
    if isinstance(target, CampaignTarget):
        precision = target.integrate(target.centre[None]).factor[0]
        own = np.linalg.inv(np.swapaxes(precision, -1, -2))
        misfit = _make_misfit(target, jnp.asarray(own))
    else:
        assert isinstance(target, CurveTarget)
        misfit = partial(_misfit_of_curve, target)
    joint = Joint(*(jnp.asarray(a) for a in (start, factor, walled, wall, side, sd, mean, weight, own)))

    def potential(v: Array) -> Array:
        x, volume = _place(v[: len(sd)], joint)
        prior = 0.5 * jnp.sum(((x - joint.prior_mean) * joint.prior_weight) ** 2)
        return misfit(x, v[len(sd):]) + prior - volume

    return joint, potential


@final
class Nuts(AbstractSampler):
    """Several chains of NUTS, whose warm-up is the burn-in."""

    name = "nuts"

    def __init__(self, target: AbstractTarget, settings: Settings):
        try:
            from numpyro.infer import NUTS
        except ImportError:
            raise InputError("NUTS needs numpyro; install it with: pip install 'ddetumble[nuts]'") from None
        super().__init__(target, settings)
        joint, potential = _pose(target)
        size = len(target.names) + joint.own.shape[0] * joint.own.shape[1]
        plain = isinstance(target, CampaignTarget)  # and whitened by its fit; others learn their mass matrix
        kernel = NUTS(potential_fn=potential, target_accept_prob=ACCEPT[plain], max_tree_depth=DEEPEST,
                      dense_mass=not plain)
        keys = jax.random.split(jax.random.PRNGKey(settings.seed), settings.ensembles + 1)
        starts = 0.5 * jax.random.normal(keys[-1], (settings.ensembles, size))
        self.states = [kernel.init(key, settings.burn, start, (), {})
                       for key, start in zip(keys[:-1], starts, strict=True)]
        if not all(bool(jnp.isfinite(s.potential_energy)) for s in self.states):
            raise ComputationError("the model cannot be computed at draws from the fit's Gaussian: the fit is too "
                                   "uncertain to sample from; add priors or bounds, or fix a parameter")
        self.form = jax.tree.structure(self.states[0])
        if joint.own.shape[0]:
            self.target = dc.replace(target, notes=("every record's nuisances were sampled along with the parameters",))

        @partial(jax.jit, static_argnums=1)
        def advance(state, steps):
            def one(state, _):
                state = kernel.sample(state, (), {})
                x = _place(state.z[: len(target.names)], joint)[0]
                return state, (x, -state.potential_energy, state.num_steps, state.diverging, state.accept_prob)

            return jax.lax.scan(one, state, None, length=steps)

        self._steps = advance

    @staticmethod
    def count_walkers(settings: Settings, free: int) -> int:
        """As the base class has it."""
        return 1

    def advance(self, steps: int) -> Block:
        """As the base class has it."""
        results = map_threads(lambda s: jax.block_until_ready(self._steps(s, steps)), self.states)
        self.states = [state for state, _ in results]
        x, value, *more = (np.stack([np.asarray(one[j]) for _, one in results]) for j in range(5))
        leaves = zip(*map(jax.tree.leaves, self.states), strict=True)
        return {"x": x[:, :, None], "log_density": value[..., None],
                **dict(zip(("leapfrogs", "diverging", "accept"), more, strict=True)),
                **{f"state_{j}": np.stack([np.asarray(leaf) for leaf in own]) for j, own in enumerate(leaves)}}

    def resume(self, block: Block) -> None:
        """As the base class has it."""
        leaves = [block[f"state_{j}"] for j in range(self.form.num_leaves)]
        self.states = [jax.tree.unflatten(self.form, [jnp.asarray(leaf[k]) for leaf in leaves])
                       for k in range(self.settings.ensembles)]

    def adapt(self, draws: np.ndarray) -> None:
        """Nothing: the kernel has adapted itself while it warmed up."""

    def count(self, blocks: list[Block], late: list[Block]) -> dict[str, Any]:
        """As the base class has it."""
        return {"accepted": float(np.mean(np.concatenate([block["accept"] for block in late], axis=1))),
                "divergences": int(sum(block["diverging"].sum() for block in late)),
                "leapfrogs": int(sum(block["leapfrogs"].sum() for block in blocks))}
