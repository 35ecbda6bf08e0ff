r"""Coefficient of friction $\mu(s) = F_t / F_n$ along a stroke, and the band that a fit or a posterior leaves of it."""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np

from ..inference.findings import Fit
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
    if isinstance(found, Posterior):
        if not isinstance(found.target, CampaignTarget):
            return None
        fit, plan = found.target.fit, found.target.plan
        draws = np.asarray(plan.base) + (found.draw(DRAWS) - np.asarray(plan.centre)) @ np.asarray(plan.directions)
    else:
        fit, draws = found, None
    saved, campaign = fit.fitted_model(), fit.source
    family = saved.space.family
    if family.ratio is None or saved.are_values or saved.sampling is None:
        return None
    name, channel, load = family.ratio
    curves = []
    last = saved.sampling.largest.get(family.independent, saved.sampling.last)
    along = np.linspace(0.0, last, PATH)
    for key in _choose_records(campaign.records[load]):
        stated = {str(each): float(value) for each, value in campaign.records.loc[key].items()}
        settings = {each: np.array([stated.get(each, 1.0)]) for each in name_conditions(saved)}
        mean, shared, *_ = evaluate_rows(saved, (channel,), [along], settings, [key])
        middle = mean[0, 0, :PATH] / stated[load]
        if draws is None:
            columns = shared.reshape(*mean.shape, -1)[0, 0, :PATH]  # derivatives by one standard deviation each
            half = WIDE * np.sqrt(np.sum(columns**2, axis=-1)) / stated[load]
            low, high = middle - half, middle + half
        else:
            many = {each: np.repeat(value, DRAWS) for each, value in settings.items()}
            rows, *_ = evaluate_rows(saved, (channel,), [along] * DRAWS, many, [key] * DRAWS, draws)
            rows = rows[:, 0, :PATH] / stated[load]
            middle, (low, high) = rows.mean(axis=0), np.quantile(rows, BAND, axis=0)
        there, values = np.empty(0), np.empty(0)
        if campaign.independent is not None and campaign.independent.name == family.independent:
            trace = campaign.trace(key)
            there = trace[family.independent].to_numpy(dtype=float)
            values = trace[channel].to_numpy(dtype=float) / stated[load]
        curves.append(CoefficientCurve(key, stated, along, middle, low, high, there, values))
    return Coefficients(name, channel, load, family.independent, tuple(curves))


def _choose_records(loads) -> list[str]:
    """Keys of the records with the lowest, a middle and the highest load: less where they are the same."""
    ordered = loads.sort_values(kind="stable")
    places = dict.fromkeys((0, (len(ordered) - 1) // 2, len(ordered) - 1))
    return [str(ordered.index[k]) for k in places]
