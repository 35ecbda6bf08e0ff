"""A sampled posterior: draws, what they say of every parameter, and files that ArviZ reads."""

import dataclasses as dc
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._display import AbstractPrinted, Progress, align_table, stay_silent
from ..contact.transform import TRANSFORMS
from ..inference.files import check_folder, list_fields, list_versions, make_plain, write_json, write_whole
from .diagnostics import Convergence
from .loo import Scores, score_conditions
from .predictive_check import DRAWS, Checks, check_posterior
from .prior_check import PriorCheck, check_priors
from .target import AbstractTarget, CampaignTarget


if TYPE_CHECKING:
    import xarray as xr

FILE, SUMMARY = "posterior.nc", "posterior.json"
SCHEMA = "ddetumble.posterior/1"
MOST_DRAWS = 4000  # on disk: for quantiles, more than autocorrelation leaves of most chains
# Draws at which records' likelihoods are kept: nuisances integrated analytically, or sampled, which costs more.
SCORED = (1000, 300)
FAILING = 0.01  # share of the places tried beyond which it is said that the model could not be computed there
CUT = 0.1  # share of the draws within half a deviation of a limit from which on the limit cuts the posterior off
STATISTICS = {"accepted": "{:.0%} of the moves accepted", "evaluations": "{} evaluations of the density",
              "resumed": "{} steps continued from an earlier run", "divergences": "{} divergences",
              "leapfrogs": "{} leapfrog steps"}


@dc.dataclass(frozen=True)
class Estimate:
    """One parameter, in its public unit: mean, deviation and quantiles of the draws."""

    mean: float
    sd: float
    q025: float
    q50: float
    q975: float
    mcse: float  # Monte Carlo error of the mean
    effective: float  # independent draws
    rhat: float  # agreement of the ensembles or chains
    fit: float  # value and standard deviation of the fit beside it
    fit_sd: float
    unit: str


@dc.dataclass(frozen=True)
class Spread:
    """One quantity that follows from the parameters: mean, deviation and quantiles over the draws."""

    mean: float
    sd: float
    q025: float
    q50: float
    q975: float
    unit: str


@dc.dataclass(frozen=True, eq=False, repr=False)
class Posterior(AbstractPrinted):
    r"""Draws from a posterior $p(\theta \mid y)$, with their summary and diagnostics.

    Attributes:
        target: what was sampled.
        sampler: `emcee` or `nuts`.
        settings: of the sampler.
        x: coordinates after the burn-in, shape (ensembles, steps, walkers, free); one walker each with NUTS.
        log_density: shape (ensembles, steps, walkers).
        convergence: how good the chains are.
        statistics: share of accepted moves, evaluations, failures, and so on.
        parameters: summaries by name.
        state: a sentence.
        notes: further sentences.
        derived: what the model tells beside its parameters (the polynomials of Eq. 10, say), by name.
        log_likelihood: of every part at some draws (`score`), shape (ensembles, draws, parts); where it was examined.
        predictive: posterior predictive checks; of campaigns only, where it was examined.
        left_out: scores of left-out conditions, where it was examined.
        prior: what the priors do, where it has any and was examined.
    """

    target: AbstractTarget
    sampler: str
    settings: Mapping[str, Any]
    x: np.ndarray
    log_density: np.ndarray
    convergence: Convergence
    statistics: Mapping[str, Any]
    parameters: Mapping[str, Estimate]
    state: str
    notes: tuple[str, ...]
    derived: Mapping[str, Spread] = dc.field(default_factory=dict)
    log_likelihood: np.ndarray | None = None
    predictive: Checks | None = None
    left_out: Scores | None = None
    prior: PriorCheck | None = None

    def __repr__(self) -> str:
        return f"<Posterior of {', '.join(self.target.names)}: {self.state}>"

    @property
    def converged(self) -> bool:
        """Whether there are as many independent draws as wanted, and the ensembles agree."""
        return self.convergence.enough

    @property
    def title(self) -> str:
        """What was sampled, in words."""
        return self.target.title

    def draw(self, count: int, seed: int = 0) -> np.ndarray:
        """So many draws of the coordinates, shape (count, free), each once as long as there are enough."""
        flat = self.x.reshape(-1, self.x.shape[-1])
        rng = np.random.default_rng(seed)
        return flat[rng.choice(len(flat), size=count, replace=count > len(flat))]

    def thinned(self) -> tuple[np.ndarray, np.ndarray]:
        """Every so many steps: x, shape (ensembles, draws, free), and log density, shape (ensembles, draws).

        An ensemble is one chain here, its walkers' ways one behind another, as only ensembles are independent.
        """
        every = max(1, -(-self.log_density.size // MOST_DRAWS))
        x, value = (np.moveaxis(own[:, ::every], 2, 1) for own in (self.x, self.log_density))
        return x.reshape(len(x), -1, x.shape[-1]), value.reshape(len(x), -1)

    def score(self) -> tuple[np.ndarray, np.ndarray]:
        """Some of the thinned draws, shape (draws, free), and the logarithm of every part's likelihood at them, shape
        (ensembles, draws, parts).
        """
        x, _ = self.thinned()
        x = x[:, :: max(1, -(-x.shape[0] * x.shape[1] // SCORED[self.target.costly]))]
        flat = x.reshape(-1, x.shape[-1])
        found = self.log_likelihood
        return flat, self.target.likelihoods(flat).reshape(*x.shape[:2], -1) if found is None else found

    def examine(self, report: Progress = stay_silent) -> "Posterior":
        """The same with a check of its priors, posterior predictive checks and scores of left-out conditions.

        The last two where it has several parts.
        """
        target, kept = self.target, self.thinned()[0]
        kept = kept.reshape(-1, kept.shape[-1])
        prior = check_priors(target, kept, min(1.0, self.convergence.effective / len(kept)))
        if len(target.parts) == 1 and not isinstance(target, CampaignTarget):
            return dc.replace(self, prior=prior)
        report("likelihoods of the records", 0.0)
        (x, likelihoods), checks = self.score(), None
        if isinstance(target, CampaignTarget):
            checks = check_posterior(target, self.draw(DRAWS), report=lambda t, s: report(t, 0.3 + 0.3 * s))
        share = max(0.05, min(1.0, self.convergence.effective / max(len(x), 1)))
        scores = score_conditions(target, x, likelihoods.reshape(len(x), -1), independent=share,
                                  report=lambda t, s: report(t, 0.6 + 0.4 * s))
        return dc.replace(self, log_likelihood=likelihoods, predictive=checks, left_out=scores, prior=prior)

    def __str__(self) -> str:
        """The report."""
        told = ", ".join(text.format(self.statistics[key]) for key, text in STATISTICS.items() if key in self.statistics
                         and (self.statistics[key] or key not in ("resumed", "divergences"))).replace("%", " %")
        lines = [f"[[Posterior]]\n    {self.title}", "[[Sampling]]", f"    {self.sampler}: {self.state}",
                 f"    {self.log_density.size} draws kept; {told}", "[[Parameters]]"]
        rows = [("", "mean", "sd", "2.5 %", "97.5 %", "indep.", "R-hat", "fit")]
        for name, p in self.parameters.items():
            rows.append((f"{name} [{p.unit}]" if p.unit else name, f"{p.mean:.6g}", f"{p.sd:.3g}", f"{p.q025:.6g}",
                         f"{p.q975:.6g}", f"{p.effective:.0f}", f"{p.rhat:.3f}", f"{p.fit:.6g} +/- {p.fit_sd:.3g}"))
        lines += [f"    {line}" for line in align_table(rows)]
        if self.derived:
            rows = [("", "mean", "sd", "2.5 %", "97.5 %")]
            rows += [(f"{name} [{d.unit}]" if d.unit else name, f"{d.mean:.6g}", f"{d.sd:.3g}", f"{d.q025:.6g}",
                      f"{d.q975:.6g}") for name, d in self.derived.items()]
            lines += ["[[Derived]]", *(f"    {line}" for line in align_table(rows))]
        if self.prior is not None:
            lines += ["[[Priors]]", f"    {self.prior.sentence}"]
        if self.predictive is not None:
            lines += ["[[Predictive check]]", f"    {self.predictive.sentence}"]
        if self.left_out is not None:
            lines += ["[[Left-out conditions]]", f"    expected log predictive density {self.left_out.elpd:.1f} +/- "
                      f"{self.left_out.standard_error:.1f}", f"    {self.left_out.text}"]
        if self.notes:
            lines += ["[[Notes]]", *(f"    {note}" for note in self.notes)]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the draws, as plain data."""
        c = self.convergence
        return make_plain({
            "schema": SCHEMA, "title": self.title, "sampler": self.sampler, "settings": self.settings,
            "target": self.target.identity, "parameters": self.parameters, "derived": self.derived,
            "converged": self.converged, "state": self.state, "steps": c.steps, "effective": c.effective,
            "rhat": c.rhat, "autocorrelation_time": dict(zip(self.target.names, c.times, strict=True)),
            "statistics": self.statistics,
            "correlations": np.atleast_2d(np.corrcoef(self.x.reshape(-1, self.x.shape[-1]).T)), "notes": self.notes,
            "left_out": self.left_out, "versions": list_versions(),
            "predictive": self.predictive and list_fields(self.predictive, "replicates"),
            "prior": self.prior and list_fields(self.prior, "replicates"),
        })  # fmt: skip

    def to_datatree(self) -> "xr.DataTree":
        """Draws, densities and likelihoods of the records as ArviZ has them; every ensemble is a chain.

        Likelihoods are those at some draws. Of an examined posterior there are replicated records, as one chain of a
        few draws, beside the measured ones.
        """
        import arviz_base

        x, value = self.thinned()
        public = self.target.publish(x)
        groups: dict[str, Any] = {
            "posterior": {name: public[..., k] for k, name in enumerate(self.target.names)},
            "sample_stats": {"lp": value}, "log_likelihood": {"record": self.score()[1]},
        }  # fmt: skip
        coordinates, dims = {"part": list(self.target.parts)}, {"record": ["part"]}
        if self.predictive is not None:
            own = self.predictive.replicates
            coordinates["measured_record"] = [one.record for one in self.predictive.records]
            dims |= dict.fromkeys((*own.channels, "time"), ["measured_record", "reading"])
            groups["posterior_predictive"] = {name: own.values[None, :, :, k].astype(np.float32)
                                              for k, name in enumerate(own.channels)}
            groups["observed_data"] = {name: own.measured[:, k] for k, name in enumerate(own.channels)}
            groups["constant_data"] = {"time": own.time}
        tree = arviz_base.from_dict(groups, coords=coordinates, dims=dims)
        for name, p in self.parameters.items():
            tree["posterior"][name].attrs["units"] = p.unit
        plain = self.to_dict() | {"priors": make_plain(self.target.priors)}
        tree.attrs.update({key: json.dumps(plain[key]) for key in ("schema", "title", "sampler", "settings", "target",
                                                                   "statistics", "versions", "state", "notes",
                                                                   "priors")})
        return tree

    def save(self, folder) -> Path:
        """Write `posterior.nc` and `posterior.json` (and the fit's files) into a folder, which is returned."""
        folder = check_folder(folder, "posterior")
        if isinstance(self.target, CampaignTarget):
            self.target.fit.save(folder)
        tree = self.to_datatree()
        write_whole(folder / FILE, lambda draft: tree.to_netcdf(draft, engine="h5netcdf"))
        write_json(folder / SUMMARY, self.to_dict())
        return folder


def summarise_posterior(target: AbstractTarget, sampler: str, settings: Mapping[str, Any], x: np.ndarray,
                        log_density: np.ndarray, convergence: Convergence, statistics: Mapping[str, Any]) -> Posterior:
    """Turn draws into what people read; arguments as in `Posterior`."""
    public, centre = target.publish(x), target.publish(target.centre)
    spread = [TRANSFORMS[kind].slope(float(value)) * sd for kind, value, sd in zip(
        target.coordinates, centre, np.sqrt(np.diag(target.covariance)), strict=True)]
    state = (f"converged after {convergence.steps} steps" if convergence.enough else
             f"not converged after {convergence.steps} steps: {convergence.lacking}; the same command with more steps "
             "continues from here")
    parameters, notes = {}, [*target.caveats, *target.notes]
    failures, evaluations = statistics.get("failures", 0), max(statistics.get("evaluations", 1), 1)
    if failures > FAILING * evaluations:
        notes.append(f"the model could not be computed at {failures} of the {evaluations} points tried; their "
                     "density was taken as zero")
    for k, name in enumerate(target.names):
        values, size = public[..., k].ravel(), float(convergence.sizes[k])
        mean, sd, low, middle, high = _summarise_draws(values)
        parameters[name] = Estimate(
            mean, sd, low, middle, high, sd / float(np.sqrt(max(size, 1.0))), size, float(convergence.rhats[k]),
            float(centre[k]), float(spread[k]), target.units[k])
        # Where a limit cuts the posterior off, the fit's interval does not hold, the draws' does.
        for limit, end, bound, q in ((target.low[k], "lower", "below", 0.95), (target.high[k], "upper", "above", 0.05)):
            if np.isfinite(limit) and np.mean(np.abs(x[..., k] - limit) < 0.5 * x[..., k].std()) > CUT:
                notes.append(f"the posterior of {name} is truncated at its {end} limit: with 95 % probability it is "
                             f"{bound} {float(np.quantile(values, q)):.4g}")
                break
    found = Posterior(target, sampler, dict(settings), x, log_density, convergence, dict(statistics), parameters, state,
                      tuple(notes))
    derived = target.derive(found.thinned()[0].reshape(-1, x.shape[-1]))
    return dc.replace(found, derived={name: Spread(*_summarise_draws(own), unit)
                                      for name, (own, unit) in derived.items()})


def _summarise_draws(values: np.ndarray) -> tuple[float, float, float, float, float]:
    """Mean, standard deviation, and the quantiles 2.5, 50 and 97.5 % of draws."""
    low, middle, high = map(float, np.quantile(values, [0.025, 0.5, 0.975]))
    return float(values.mean()), float(values.std()), low, middle, high
