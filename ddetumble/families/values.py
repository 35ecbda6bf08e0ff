"""Values: numbers of which a test gives one each, such as a rebound speed, a contact time or a peak force.

A campaign may hold a table of them instead of samples. Every verb reads such a campaign as one of records that have a
single sample. Where no uncertainty of a value is stated, the scatter of the values takes its place.
"""

import dataclasses as dc
import itertools

import numpy as np
import pandas as pd

from .._errors import InputError
from ..measurement.campaign import Campaign, Column
from ..measurement.units import Uncertainty, si_unit
from .family import Family


MOST = 3  # degree of a polynomial over the conditions: what bends more often is not told from scatter by few values
REPEATS = 3  # degrees of freedom of repeats from which on they give the scatter: fewer know it to a factor of two
# Weight of a record in a fit from which on the fit follows it wherever it lies: it tells nothing of the scatter.
FOLLOWED = 1.0 - 1e-9
ALIKE = 1e-9  # of the largest singular value of a polynomial's columns: below it, two are one but for rounding


@dc.dataclass(frozen=True)
class Scatter:
    """How far values stray from what is smooth over the conditions.

    Attributes:
        share: standard deviation over the value [-]; nan where there are too few values.
        degrees: degrees of freedom from which that is known.
        text: where it comes from, in a phrase.
    """

    share: float
    degrees: int
    text: str


def fit_linear(columns: np.ndarray, values: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Weighted least squares $y = X \beta$, and the leave-one-out prediction of each record.

    Args:
        columns: $X$, shape (records, terms).
        values: $y$, shape (records,), SI.
        weights: shape (records,), over the unit of the values.

    Returns:
        Fitted values and held-out predictions, both of shape (records,), SI. Held out: $y - r/(1 - h)$ with the
        leverage $h$, which is exact for linear least squares; nan where the fit follows a record wherever it lies.
    """
    basis, size, _ = np.linalg.svd(columns * weights[:, None], full_matrices=False)
    basis = basis[:, size > ALIKE * size[0]]
    leverage = np.sum(basis**2, axis=1)
    fitted = basis @ (basis.T @ (values * weights)) / weights
    free = leverage < FOLLOWED
    held = values - np.where(free, (values - fitted) / np.where(free, 1.0 - leverage, 1.0), np.nan)
    return fitted, held


def polynomial(conditions: np.ndarray, degree: int) -> np.ndarray:
    """All products of powers of the conditions up to a degree, each condition scaled to -1..1.

    Args:
        conditions: of the records, shape (records,) or (records, conditions).
        degree: of the products.

    Returns:
        Columns, the constant first, shape (records, terms).
    """
    table = np.reshape(conditions, (len(conditions), -1))
    middle, half = 0.5 * (table.max(axis=0) + table.min(axis=0)), 0.5 * np.ptp(table, axis=0)
    scaled = (table - middle) / np.where(half > 0, half, 1.0)
    products = (factors for order in range(degree + 1)
                for factors in itertools.combinations_with_replacement(range(table.shape[1]), order))
    return np.stack([np.prod(scaled[:, list(factors)], axis=1) for factors in products], axis=1)


def choose_degree(conditions: np.ndarray, values: np.ndarray, weights: np.ndarray) -> int:
    """Degree (0 to `MOST`) of the polynomial over the conditions with the smallest leave-one-out error."""
    table = np.reshape(conditions, (len(conditions), -1))
    # Through as many places as it has terms it goes exactly, and says nothing.
    highest = max(len(np.unique(column)) for column in table.T) - 2 if table.size else 0
    errors = []
    for degree in range(max(min(MOST, highest), 0) + 1):
        columns = polynomial(table, degree)
        if columns.shape[1] >= len(values) and degree:
            break
        _, held = fit_linear(columns, values, weights)
        error = float(np.sum(((held - values) * weights) ** 2))
        errors.append(error if np.isfinite(error) else np.inf)
    return int(np.argmin(errors))


def measure_scatter(records: pd.DataFrame, values: np.ndarray) -> Scatter:
    """Relative scatter of one value a record, without any physical model.

    Args:
        records: conditions of the records that have the value.
        values: shape (records,), SI, positive.

    Returns:
        That of repeats at equal conditions about their means, where there are enough of them; else that about the
        polynomial over the conditions, of a degree chosen by leave-one-out.
    """
    names = [str(name) for name in records.columns if len(set(records[name])) > 1]
    table = records[names].to_numpy(dtype=float)
    groups = np.ravel(np.unique(table, axis=0, return_inverse=True)[1]) if names else np.zeros(len(values), dtype=int)
    repeats = len(values) - len(set(groups.tolist()))
    if repeats >= REPEATS or not names:
        means = np.array([values[groups == group].mean() for group in groups])
        share = float(np.sqrt(np.sum((values / means - 1.0) ** 2) / repeats)) if repeats else float("nan")
        return Scatter(share, repeats, "the scatter of repeats at equal conditions")
    degree = choose_degree(table, values, 1.0 / values)
    columns = polynomial(table, degree)
    left = len(values) - int(np.linalg.matrix_rank(columns))
    fitted, _ = fit_linear(columns, values, 1.0 / values)
    share = float(np.sqrt(np.sum((fitted / values - 1.0) ** 2) / left)) if left > 0 else float("nan")
    over = " and ".join(name.replace("_", " ") for name in names)
    return Scatter(share, left, f"the scatter about a polynomial of degree {degree} in {over}")


def sample_values(campaign: Campaign, family: Family) -> Campaign:
    """A campaign of values as one of records with a single sample; records without a value are left out.

    Where in a record the sample stands says its family. What a source's own model predicted (`printed_...`) and how
    many tests a value is the mean of are no measurements.

    Args:
        campaign: With a table of values.
        family: Of its records.

    Raises:
        InputError: It has none of the values that its kind of tests gives, or no uncertainty is stated of values that
            are too few to show their scatter.
    """
    assert campaign.peaks is not None
    values = {name: column for name, column in campaign.peak_columns.items()
              if name in family.values and bool(campaign.peaks[name].notna().to_numpy().any())}
    if not values:
        raise InputError(f"campaign {campaign.name!r} has none of the values that its kind of tests gives: "
                         f"{', '.join(family.values) or 'there are none'}; it has: {', '.join(campaign.peak_columns)}")
    table = campaign.peaks.loc[campaign.peaks[list(values)].notna().any(axis=1), list(values)]
    keys = [key for key in campaign.record_keys if key in table.index]
    table, records = table.loc[keys], campaign.records.loc[keys]
    channels, notes = {}, []
    for name, column in values.items():
        if column.uncertainty is None:
            there = table[name].notna().to_numpy()
            found = measure_scatter(records[there], table[name].to_numpy(dtype=float)[there])
            if found.degrees < 1 or not found.share > 0:
                file = campaign.path and campaign.path / "datapackage.json"
                raise InputError(f"no uncertainty of {name} is stated, and its {int(there.sum())} values are too few "
                                 "to show their scatter; add one standard deviation to its field, such as "
                                 f'"uncertainty": "1 %"', file=file, column=name)
            column = dc.replace(column, uncertainty=Uncertainty(relative=found.share), degrees=float(found.degrees))
            notes.append(f"No uncertainty of {name} is stated: {found.text}, {100 * found.share:.2g} % of the value "
                         f"with {found.degrees} degrees of freedom, takes its place.")
        channels[name] = column
    abscissa = family.independent
    samples = pd.DataFrame({"record": keys, abscissa: family.place_values(table)}
                           | {name: table[name].to_numpy(float) for name in values})
    return dc.replace(campaign, records=records, independent=Column(abscissa, si_unit(abscissa)), channels=channels,
                      samples=samples, peaks=None, peak_columns={}, notes=(*campaign.notes, *notes))
