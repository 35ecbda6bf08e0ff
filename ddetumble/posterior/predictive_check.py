r"""Posterior predictive checks: do records that the fitted model would make look like those that were measured?

For draws $\theta_s$ of the parameters and $z_s$ of every record's nuisances, whitened residuals $r_s$ of the measured
record are held against those of a replicate $y_{rep} = m(\theta_s, z_s) + \epsilon$, which are standard normal, for
three statistics: chi-square of samples and nuisances, largest residual, and correlation of neighbouring residuals
(realised discrepancies; Gelman, Meng and Stern 1996). As the replicates' residuals are known to be standard normal,
each draw's probability of a more extreme replicate is computed, not counted, and the p-value is its mean over the
draws: so it can be small enough to survive a correction for the number of records. That the size and correlation of the
noise are themselves uncertain is allowed for.
"""

import dataclasses as dc
from collections.abc import Mapping
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._display import Progress, stay_silent
from .._sentences import say
from ..inference import distributions as stats
from ..inference.problem import simulate_records
from .target import CampaignTarget, Plan, map_blocks


DRAWS = 96  # replicates of each record: fewer leave p-values too coarse for so many comparisons, more cost time
# Nuisances of each draw among which one is chosen where the model is not linear in them: one alone would keep the fit's
# Gaussian.
TRIED = 8
KEPT = 24  # replicated records that are kept: for figures, which show a band of them
BLOCK = 96  # draws computed at once: larger takes memory, smaller more calls
LEVEL = 0.01  # chance, over all comparisons, of calling a right model wrong
STATISTICS = {"chi_square": "chi-square", "largest": "largest residual", "lag": "correlation of neighbours"}  # lag one


@dc.dataclass(frozen=True)
class RecordCheck:
    """One record against its replicates; statistics are means over the draws."""

    record: str  # its key
    conditions: Mapping[str, float]  # SI
    samples: int  # how many were measured
    chi_square: float  # per degree of freedom
    largest: float  # whitened residual
    lag: float  # correlation of neighbouring whitened residuals
    p_values: Mapping[str, float]  # by statistic; single values have no neighbours


@dc.dataclass(frozen=True, eq=False)
class Replicates:
    """Records that the fitted model would make, SI."""

    channels: tuple[str, ...]
    time: np.ndarray  # independent variable, shape (records, samples)
    measured: np.ndarray  # shape (records, channels, samples); nan where nothing was measured
    values: np.ndarray  # shape (draws, records, channels, samples)

    @property
    def are_values(self) -> bool:
        """Whether every record has one value a channel at most, instead of a trace."""
        return bool(np.isfinite(self.measured).sum(axis=2).max() <= 1)


@dc.dataclass(frozen=True, eq=False)
class Checks:
    """Posterior predictive checks of all records."""

    records: tuple[RecordCheck, ...]
    draws: int  # of the parameters
    totals: Mapping[str, float]  # p-values over all records together, by statistic
    smallest: float  # p-value of any comparison
    comparisons: int
    p_value: float  # of all comparisons together, corrected for their number
    rejected: bool  # whether the records do not look like what the model makes
    outstanding: tuple[str, ...]  # records that stand out by themselves after the correction
    sentence: str  # what that means
    replicates: Replicates  # some of the replicated records


@partial(jax.jit, static_argnums=(0, 1, 2))
def _simulate(space, names, channels, x: Array, z: Array, plan: Plan):
    """Whitened residuals, shape (draws, records, rows), failures and channels of records at many points."""
    rows, count = plan.stack.time.shape[0], plan.base.shape[0]

    def one(pair):
        base = jnp.broadcast_to(plan.base + (pair[0] - plan.centre) @ plan.directions, (rows, count))
        return simulate_records(space, names, channels, pair[1], plan.stack, base, plan.low, plan.high)

    return jax.lax.map(one, (x, z))


def draw_nuisances(target: CampaignTarget, x: np.ndarray, rng: np.random.Generator
                   ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nuisances of every record given parameters, and the records that these make.

    From their Gaussian at coordinates x, shape (draws, free); where the model is not linear in them one of a few draws
    is chosen, by its density. Nuisances, shape (draws, records, nuisances); whitened residuals, shape (draws, records,
    rows); channels, shape (draws, records, channels, samples). Draws that the model cannot compute are left out.
    """
    at = target.integrate(x)
    run = partial(_simulate, target.space, target.records.nuisances, target.records.channels, plan=target.plan)
    back = np.linalg.inv(np.swapaxes(at.factor, -1, -2))
    tries = []
    for _ in range(TRIED if target.costly else 1):
        noise = rng.standard_normal(at.mean.shape)
        z = at.mean + np.einsum("srkl,srl->srk", back, noise)
        residual, failed, model = map_blocks(run, BLOCK, x, z)
        value = -0.5 * (np.sum(residual**2, axis=2) + np.sum(z**2, axis=2)) + 0.5 * np.sum(noise**2, axis=2)
        tries.append((np.where(failed | ~np.isfinite(value), -np.inf, value), z, residual, model))
    values, *arrays = (np.stack(each) for each in zip(*tries, strict=True))
    # The largest of the logarithms plus Gumbel numbers is a draw by the weights.
    best = np.argmax(np.where(np.isfinite(values), values + rng.gumbel(size=values.shape), -np.inf), axis=0)
    good = np.all(np.isfinite(values.max(axis=0)), axis=1)
    z, residual, model = (own[best, np.arange(len(x))[:, None], np.arange(best.shape[1])][good] for own in arrays)
    return z, residual, model


def check_posterior(target: CampaignTarget, x: np.ndarray, report: Progress = stay_silent) -> Checks:
    """Hold every record against replicates of it, from draws of the coordinates, shape (draws, free)."""
    report("replicating the records", 0.0)
    rng = np.random.default_rng([0, 7])  # of its own
    z, residual, model = draw_nuisances(target, x, rng)
    stack, draws = target.records.stack, len(residual)
    weights = np.asarray(stack.weights)
    noise = [target.fit.noise[name] for name in target.records.channels]
    level = np.array([one.log_level_sd for one in noise])
    residual = residual.reshape(draws, *weights.shape)
    residual = residual * np.exp(-0.5 * level * rng.standard_normal((draws, len(noise))))[:, None, :, None]
    valid = weights > 0
    # What a tumbling record starts from has no prior worth the name: it is fitted, and counts on neither side.
    settled = np.array([name not in target.records.starts for name in target.records.nuisances])
    moved = (np.asarray(stack.condition_sd) > 0) & settled
    size = valid.sum(axis=(1, 2))
    degrees = size + moved.sum(axis=1)
    energy = np.sum(residual**2 * valid, axis=(2, 3))
    square = energy + np.sum(np.where(moved, z, 0.0) ** 2, axis=2)
    largest = np.max(np.abs(residual) * valid, axis=(2, 3))
    pairs = valid[:, :, 1:] & valid[:, :, :-1]
    product, energy = np.sum(residual[..., 1:] * residual[..., :-1] * pairs, axis=(2, 3)), np.maximum(energy, 1e-300)
    lag, whole = product / energy, product.sum(axis=1) / energy.sum(axis=1)
    # E (sum of products)^2 over E (sum of squares)^2 of standard normal numbers: exact, as the ratio and the sum are
    # independent. What the noise's correlation is off by adds to it.
    couples = pairs.sum(axis=(1, 2))
    off = np.max([0.5 * one.log_level_sd * (1 - one.correlation**2) for one in noise])
    spread, wide = (np.sqrt(c / (n * (n + 2.0)) + off**2) for c, n in ((couples, size), (couples.sum(), size.sum())))
    each = {"chi_square": stats.chi2.sf(square, degrees),
            "largest": -np.expm1(size * np.log1p(-np.minimum(2 * stats.norm.sf(largest), 1 - 1e-16))),
            "lag": 2 * stats.norm.sf(np.abs(lag) / spread)}  # fmt: skip
    totals = {"chi_square": float(stats.chi2.sf(square.sum(axis=1), degrees.sum()).mean()),
              "lag": float(np.mean(2 * stats.norm.sf(np.abs(whole) / wide)))}
    if not pairs.any():  # single values have no neighbours
        del each["lag"], totals["lag"]
    each = {name: own.mean(axis=0) for name, own in each.items()}
    settings = target.fit.source.records.to_dict("records")
    records = tuple(
        RecordCheck(key, {str(k): float(v) for k, v in settings[g].items()}, int(size[g]),
                    float(square[:, g].mean() / degrees[g]), float(largest[:, g].mean()), float(lag[:, g].mean()),
                    {name: float(p[g]) for name, p in each.items()})
        for g, key in enumerate(target.records.keys))
    report("replicating the records", 0.8)
    return _conclude(records, draws, totals, _keep(target, model[:: max(1, draws // KEPT)], rng))


def replicate(target: CampaignTarget, x: np.ndarray, z: np.ndarray, rng: np.random.Generator
              ) -> tuple[Replicates | None, np.ndarray]:
    """Records at coordinates, shape (draws, free), and nuisances, shape (draws, records, nuisances), with noise; and
    at which of the draws they could be computed, shape (draws,). None where at no draw."""
    run = partial(_simulate, target.space, target.records.nuisances, target.records.channels, plan=target.plan)
    residual, failed, model = map_blocks(run, BLOCK, x, z)
    good = np.all(~failed & np.isfinite(residual).all(axis=2), axis=1)
    return (_keep(target, model[good], rng) if good.any() else None), good


def _keep(target: CampaignTarget, model: np.ndarray, rng: np.random.Generator) -> Replicates:
    """Models, shape (draws, records, channels, samples), with noise of the fitted kind beside what was measured."""
    stack = target.records.stack
    weights, taps = np.asarray(stack.weights), np.asarray(stack.taps)
    valid, values = weights > 0, _add_noise(model, weights, taps, rng)
    measured = np.where(valid, np.asarray(stack.values), np.nan)
    return Replicates(target.records.channels, np.asarray(stack.time), measured, np.where(valid, values, np.nan))


def _add_noise(model: np.ndarray, weights: np.ndarray, taps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Models with noise of the fitted kind: the whitening filter run backwards."""
    fresh = rng.standard_normal(model.shape) / np.where(weights > 0, weights, 1.0)
    noise, reach = np.where(weights > 0, fresh, 0.0), taps.shape[-1] if np.any(taps) else 0
    for t in range(model.shape[-1]):
        for k in range(min(t, reach)):
            noise[..., t] += taps[..., t, k] * noise[..., t - 1 - k]
    return model + noise


def _conclude(records: tuple[RecordCheck, ...], draws: int, totals: Mapping[str, float], replicates: Replicates
              ) -> Checks:
    single = np.array([list(one.p_values.values()) for one in records])
    count = single.size + len(totals)
    # Half of the level for all records together, half for them one by one: a misfit is in many records, or in few.
    together = min(1.0, len(totals) * min(totals.values()))
    apart = np.minimum(1.0, single.size * single)
    p_value = min(1.0, 2.0 * min(together, float(apart.min())))
    rejected = p_value < LEVEL
    outstanding = tuple(one.record for one, row in zip(records, apart, strict=True) if 2.0 * row.min() < LEVEL)
    words = [STATISTICS[name] for name, value in totals.items() if 2.0 * len(totals) * value < LEVEL]
    sentence = str(say("posterior.replicated", rejected=rejected, p=p_value, count=count, records=len(records),
                       outstanding=len(outstanding), together=words))
    return Checks(records, draws, dict(totals), min(float(single.min()), *totals.values()), count, p_value, rejected,
                  outstanding, sentence, replicates)
