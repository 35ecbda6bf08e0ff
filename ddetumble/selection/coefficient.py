r"""Coefficient of friction $\mu(s) = F_t / F_n$ along a stroke, and the band that a fit or a posterior leaves of it."""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from ..inference.archive import FittedModel
from ..inference.findings import Fit
from ..measurement.campaign import Campaign
from ..posterior.result import Posterior
from ..posterior.target import CampaignTarget
from .predict import PATH, evaluate_rows, name_conditions


DRAWS = 200  # of a posterior: the ends of a band of 95 % are then known to a tenth of its width
BAND = (0.025, 0.975)
WIDE = 1.96  # standard deviations from the middle of a Gaussian to the ends of that band


@dc.dataclass(frozen=True)
class CoefficientCurve:
    """The coefficient of one record over its independent variable."""

    record: str
    conditions: Mapping[str, float]  # as stated, SI
    along: np.ndarray  # independent variable, SI, shape (samples,)
    mean: np.ndarray  # of the model at the conditions as they are stated, shape (samples,)
    low: np.ndarray  # ends of the band of 95 % of that, shape (samples,)
    high: np.ndarray
    measured_along: np.ndarray  # where it was measured, shape (measured,); none where strokes turn round
    measured: np.ndarray  # shape (measured,)


@dc.dataclass(frozen=True)
class Coefficients:
    """A coefficient of a few records."""

    name: str  # in words
    channel: str  # what is measured by the condition `load`
    load: str
    along: str  # name of the independent variable
    curves: tuple[CoefficientCurve, ...]


def trace_coefficients(found: Fit | Posterior) -> Coefficients | None:
    """Coefficient of records at the lowest, a middle and the highest load, from a fit or from draws of its posterior.

    A fit leaves the band of its covariance, to first order; a posterior that of its draws. How far settings scatter
    from test to test is in neither.

    Returns:
        None where the records have no such coefficient, or where each is a single value.

    Raises:
        ComputationError: The model could not be integrated.
    """
    draws = None
    if isinstance(found, Posterior):
        if not isinstance(found.target, CampaignTarget):
            return None
        fit, plan = found.target.fit, found.target.plan
        draws = np.asarray(plan.base) + (found.draw(DRAWS) - np.asarray(plan.centre)) @ np.asarray(plan.directions)
    else:
        fit = found
    saved = fit.fitted_model()
    family = saved.space.family
    if family.ratio is None or saved.are_values or saved.sampling is None:
        return None
    name, channel, load = family.ratio
    curves = tuple(_trace_record(saved, fit.source, key, draws) for key in _choose_records(fit.source.records[load]))
    return Coefficients(name, channel, load, family.independent, curves)


def _trace_record(saved: FittedModel, campaign: Campaign, key: str, draws: np.ndarray | None) -> CoefficientCurve:
    """The coefficient of one record, with the band of the covariance, or of `draws` of all coordinates, shape (draws,
    parameters)."""
    family = saved.space.family
    assert family.ratio is not None and saved.sampling is not None
    _, channel, load = family.ratio
    stated = {str(name): float(value) for name, value in campaign.records.loc[key].items()}
    there, values = np.empty(0), np.empty(0)
    last = saved.sampling.largest.get(family.independent, saved.sampling.last)
    if campaign.independent is not None and campaign.independent.name == family.independent:
        trace = campaign.trace(key)
        there, values = trace[family.independent].to_numpy(dtype=float), trace[channel].to_numpy(dtype=float)
        last = float(there[-1])
    along, count = np.linspace(0.0, last, PATH), 1 if draws is None else len(draws)
    settings = {name: np.full(count, stated.get(name, 1.0)) for name in name_conditions(saved)}
    found, shared, *_ = evaluate_rows(saved, (channel,), [along] * count, settings, [key] * count, draws)
    if draws is None:
        columns = shared.reshape(*found.shape, -1)[0, 0, :PATH]  # derivatives by one standard deviation each
        middle, half = found[0, 0, :PATH], WIDE * np.sqrt(np.sum(columns**2, axis=-1))
        low, high = middle - half, middle + half
    else:
        rows = found[:, 0, :PATH]
        middle, (low, high) = rows.mean(axis=0), np.quantile(rows, BAND, axis=0)
    push = stated[load]
    return CoefficientCurve(key, stated, along, middle / push, low / push, high / push, there, values / push)


def _choose_records(loads) -> list[str]:
    """Keys of the records with the lowest, a middle and the highest load: less where they are the same."""
    ordered = loads.sort_values(kind="stable")
    places = dict.fromkeys((0, (len(ordered) - 1) // 2, len(ordered) - 1))
    return [str(ordered.index[k]) for k in places]
