"""A sampled posterior: draws, what they say of every parameter, and files that ArviZ reads."""

import dataclasses as dc
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._display import AbstractPrinted
from ..inference.files import check_folder, list_versions, make_plain, write_json, write_whole
from .diagnostics import Convergence
from .loo import Scores, score_conditions
from .predictive_check import DRAWS, Checks, check_posterior
from .target import AbstractTarget, CampaignTarget, CurveTarget


if TYPE_CHECKING:
    import xarray as xr

FILE, SUMMARY = "posterior.nc", "posterior.json"
SCHEMA = "ddetumble.posterior/1"
MOST_DRAWS = 4000  # on disk
SCORED = (1000, 300)  # draws at which records' likelihoods are kept: nuisances integrated analytically, or sampled


@dc.dataclass(frozen=True)
class Estimate:
    """One parameter, in its public unit.

    Attributes:
        mean, sd, q025, q50, q975: of the draws.
        mcse: Monte Carlo error of the mean.
        effective: independent draws; rhat: agreement of the ensembles or chains.
        fit, fit_sd: value and standard deviation of the fit beside it.
        unit: of all of them.
    """

    mean: float
    sd: float
    q025: float
    q50: float
    q975: float
    mcse: float
    effective: float
    rhat: float
    fit: float
    fit_sd: float
    unit: str


@dc.dataclass(frozen=True, eq=False, repr=False)
class Posterior(AbstractPrinted):
    """Draws from a posterior.

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
        log_likelihood: of every part at some draws (`scored`), shape (ensembles, draws, parts); where it was examined.
        predictive: posterior predictive checks; of campaigns only, where it was examined.
        left_out: scores of left-out conditions, where it was examined.
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
    log_likelihood: np.ndarray | None = None
    predictive: Checks | None = None
    left_out: Scores | None = None

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

    def thinned(self, most: int = MOST_DRAWS) -> tuple[np.ndarray, np.ndarray]:
        """Every so many steps: x, shape (ensembles, draws, free), and log density, shape (ensembles, draws).

        An ensemble is one chain here, its walkers' ways one behind another, as only ensembles are independent.
        """
        ensembles, _, _, free = self.x.shape
        every = max(1, -(-self.log_density.size // most))
        x, value = self.x[:, ::every], self.log_density[:, ::every]
        return np.moveaxis(x, 2, 1).reshape(ensembles, -1, free), np.moveaxis(value, 2, 1).reshape(ensembles, -1)

    def scored(self) -> np.ndarray:
        """Draws at which likelihoods of the records are kept, shape (ensembles, draws, free): some of `thinned`."""
        x, _ = self.thinned()
        every = max(1, -(-x.shape[0] * x.shape[1] // SCORED[self.target.costly]))
        return x[:, ::every]

    def _score(self) -> np.ndarray:
        """Logarithm of every part's likelihood at these draws, shape (ensembles, draws, parts)."""
        if self.log_likelihood is not None:
            return self.log_likelihood
        x = self.scored()
        return self.target.likelihoods(x.reshape(-1, x.shape[-1])).reshape(*x.shape[:2], -1)

    def examine(self, report: Callable[[str, float], object] = lambda text, share: None) -> "Posterior":
        """The same with posterior predictive checks and scores of left-out conditions, where it has several parts."""
        target = self.target
        if isinstance(target, CurveTarget) and target.labels is None:
            return self
        report("likelihoods of the records", 0.0)
        flat, likelihoods, checks = self.scored().reshape(-1, len(target.names)), self._score(), None
        if isinstance(target, CampaignTarget):
            checks = check_posterior(target, self.draw(DRAWS), report=lambda t, s: report(t, 0.3 + 0.3 * s))
        share = min(1.0, self.convergence.effective / max(len(flat), 1))
        scores = score_conditions(target, flat, likelihoods.reshape(len(flat), -1), independent=max(share, 0.05),
                                  report=lambda t, s: report(t, 0.6 + 0.4 * s))
        return dc.replace(self, log_likelihood=likelihoods, predictive=checks, left_out=scores)

    def __str__(self) -> str:
        """The report."""
        count = self.log_density.size
        lines = [f"[[Posterior]]\n    {self.title}", "[[Sampling]]", f"    {self.sampler}: {self.state}",
                 f"    {count} draws kept; {_describe_statistics(self.statistics)}", "[[Parameters]]"]
        rows = [("", "mean", "sd", "2.5 %", "97.5 %", "indep.", "R-hat", "fit")]
        for name, p in self.parameters.items():
            unit = f" [{p.unit}]" if p.unit else ""
            rows.append((f"{name}{unit}", f"{p.mean:.6g}", f"{p.sd:.3g}", f"{p.q025:.6g}", f"{p.q975:.6g}",
                         f"{p.effective:.0f}", f"{p.rhat:.3f}", f"{p.fit:.6g} +/- {p.fit_sd:.3g}"))
        lines += [f"    {line}" for line in align_table(rows)]
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
            "target": self.target.identity, "parameters": self.parameters, "converged": self.converged,
            "state": self.state, "steps": c.steps, "effective": c.effective, "rhat": c.rhat,
            "autocorrelation_time": dict(zip(self.target.names, c.times, strict=True)),
            "statistics": self.statistics, "correlations": _correlate(self.x), "notes": self.notes,
            "predictive": None if self.predictive is None else self.predictive.to_dict(), "left_out": self.left_out,
            "versions": list_versions(),
        })  # fmt: skip

    def to_datatree(self) -> "xr.DataTree":
        """Draws, densities and likelihoods of the records as ArviZ has them; every ensemble is a chain.

        Likelihoods are those at some draws (`scored`). Of an examined posterior there are replicated records, as one
        chain of a few draws, beside the measured ones.
        """
        import arviz_base

        x, value = self.thinned()
        public = self.target.publish(x)
        groups: dict[str, Any] = {
            "posterior": {name: public[..., k] for k, name in enumerate(self.target.names)},
            "sample_stats": {"lp": value},
        }
        groups["log_likelihood"] = {"record": self._score()}
        coordinates: dict[str, Any] = {"part": list(self.target.parts)}
        dims = {"record": ["part"]}
        if self.predictive is not None:
            own = self.predictive.replicates
            coordinates |= {"measured_record": list(own.keys)}
            for k, name in enumerate(own.channels):
                groups.setdefault("posterior_predictive", {})[name] = own.values[None, :, :, k].astype(np.float32)
                groups.setdefault("observed_data", {})[name] = own.measured[:, k]
                dims[name] = ["measured_record", "reading"]
            groups["constant_data"] = {"time": own.time}
            dims["time"] = ["measured_record", "reading"]
        tree = arviz_base.from_dict(groups, coords=coordinates, dims=dims)
        plain = self.to_dict()
        for name, p in self.parameters.items():
            tree["posterior"][name].attrs["units"] = p.unit
        tree.attrs.update({key: json.dumps(plain[key]) for key in ("schema", "title", "sampler", "settings", "target",
                                                                   "statistics", "versions", "state", "notes")})
        tree.attrs["priors"] = json.dumps(make_plain(self.target.priors))
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
    public = target.publish(x)
    centre = target.publish(target.centre)
    slope = target.slope()
    spread = np.sqrt(np.diag(slope @ target.covariance @ slope.T))
    parameters = {}
    for k, name in enumerate(target.names):
        values = public[..., k].ravel()
        sd = float(values.std())
        low, middle, high = (float(q) for q in np.quantile(values, [0.025, 0.5, 0.975]))
        parameters[name] = Estimate(
            float(values.mean()), sd, low, middle, high, sd / float(np.sqrt(max(convergence.sizes[k], 1.0))),
            float(convergence.sizes[k]), float(convergence.rhats[k]), float(centre[k]),
            float(spread[k]), target.units[k])
    state = (f"converged after {convergence.steps} steps" if convergence.enough else
             f"not converged after {convergence.steps} steps: {convergence.lacking}; the same command with more steps "
             "goes on from here")
    notes = [*target.notes]
    failures, evaluations = statistics.get("failures", 0), max(statistics.get("evaluations", 1), 1)
    if failures > 0.01 * evaluations:
        notes.append(f"the model could not be computed at {failures} of {evaluations} places that were tried; they "
                     "count as impossible")
    for k, name in enumerate(target.names):
        notes += _describe_limits(name, public[..., k].ravel(), x[..., k], target.low[k], target.high[k])
    return Posterior(target, sampler, dict(settings), x, log_density, convergence, dict(statistics), parameters, state,
                     tuple(notes))


def _describe_limits(name: str, values: np.ndarray, x: np.ndarray, low: float, high: float) -> list[str]:
    """A sentence where a limit cuts the posterior off: then the fit's interval does not hold, the draws' does."""
    sd = float(x.std())
    for limit, end in ((low, "lower"), (high, "upper")):
        near = float(np.mean(np.abs(x - limit) < 0.5 * sd)) if np.isfinite(limit) else 0.0
        if near > 0.1:
            side = 0.95 if end == "lower" else 0.05
            bound = "below" if end == "lower" else "above"
            return [f"{name} is cut off by its {end} limit: with 95 % probability it is {bound} "
                    f"{float(np.quantile(values, side)):.4g}"]
    return []


def _describe_statistics(statistics: Mapping[str, Any]) -> str:
    words = {"accepted": "{} of the moves accepted", "evaluations": "{} evaluations of the density",
             "resumed": "{} steps taken over from an earlier run", "divergences": "{} divergences",
             "leapfrogs": "{} leapfrog steps"}
    shown = {**statistics, "accepted": f"{100 * statistics.get('accepted', 0.0):.0f} %"}
    return ", ".join(text.format(shown[key]) for key, text in words.items()
                     if key in statistics and (statistics[key] or key not in ("resumed", "divergences")))


def _correlate(x: np.ndarray) -> np.ndarray:
    flat = x.reshape(-1, x.shape[-1])
    return np.atleast_2d(np.corrcoef(flat.T)) if flat.shape[1] > 1 else np.ones((1, 1))


def align_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first column to the left, all others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows]
