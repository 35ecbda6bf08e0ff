"""Fits to peaks: Levenberg-Marquardt on many models and folds at once, and leave-one-out errors."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np

from .peaks import DIRECTIONS, PeakProgram


@dc.dataclass(frozen=True)
class PeakFit:
    """One model fitted to peaks.

    Attributes:
        names: of the free parameters.
        x: coordinates of all parameters, shape (parameters,).
        model: peaks of the fit, shape (records,) [N].
        slopes: derivatives by the free coordinates, shape (records, free) [N].
        cost: sum of squared weighted residuals.
        converged: whether the steps died out.
        held: prediction of each record by a fit without it, shape (records,) [N]; nan where none was made.
        fold_x, fold_cost: coordinates, shape (records, parameters), and costs, shape (records,), of those fits.
    """

    names: tuple[str, ...]
    x: np.ndarray
    model: np.ndarray
    slopes: np.ndarray
    cost: float
    converged: bool
    held: np.ndarray
    fold_x: np.ndarray | None = None
    fold_cost: np.ndarray | None = None


@dc.dataclass(frozen=True)
class PeakData:
    """Peaks with their conditions and weights.

    Attributes:
        conditions: arrays of shape (records,), SI.
        peaks: measured, shape (records,) [N].
        weights: one over the standard deviation (or scale) of each, shape (records,) [1/N].
    """

    conditions: Mapping[str, np.ndarray]
    peaks: np.ndarray
    weights: np.ndarray


def minimise_batch(program: PeakProgram, data: PeakData, weights: np.ndarray, x: np.ndarray, free: np.ndarray,
                   most: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""Levenberg-Marquardt on a batch: minimise $\sum_i W_i^2 (F_i(x) - y_i)^2$ within each coordinate's limits.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        weights: $W$, shape (batch, records) [1/N]; 0 leaves a record out.
        x: starts, shape (batch, parameters).
        free: numbers of the free coordinates, shape (batch, DIRECTIONS), -1 for none.
        most: steps at most.

    Returns:
        Coordinates, peaks, derivatives, costs and whether each converged.
    """
    x, used, where = np.array(x, dtype=float), free >= 0, np.where(free >= 0, free, 0)
    model, slopes = program.evaluate(x, free, data.conditions)
    cost = _costs(model, data.peaks, weights)
    damping, done = np.full(len(x), 1e-3), np.zeros(len(x), dtype=bool)
    for _ in range(most):
        live = np.flatnonzero(~done)
        if not live.size:
            break
        residual = np.where(weights[live] > 0, weights[live] * (np.nan_to_num(model[live]) - data.peaks), 0.0)
        jacobian = weights[live][:, :, None] * np.nan_to_num(slopes[live]) * program.scale[where[live]][:, None, :]
        here = np.take_along_axis(x[live], where[live], axis=1)
        gradient = np.einsum("bnk,bn->bk", jacobian, residual)
        # A coordinate at its limit that wants to go further stays there.
        stuck = ((here <= program.low[where[live]]) & (gradient > 0)) | (
            (here >= program.high[where[live]]) & (gradient < 0))
        jacobian = np.where((stuck | ~used[live])[:, None, :], 0.0, jacobian)
        gradient = np.einsum("bnk,bn->bk", jacobian, residual)
        normal = np.einsum("bnk,bnl->bkl", jacobian, jacobian)
        size = np.einsum("bkk->bk", normal)
        ridge = damping[live][:, None] * np.maximum(size, 1e-9) + np.where(size > 0, 0.0, 1.0)
        step = -np.linalg.solve(normal + ridge[:, :, None] * np.eye(DIRECTIONS), gradient[..., None])[..., 0]
        step = np.clip(step, -3.0, 3.0)
        trial = x[live].copy()
        for k in range(DIRECTIONS):
            row = np.flatnonzero(used[live][:, k])
            column = free[live][row, k]
            moved = trial[row, column] + program.scale[column] * step[row, k]
            trial[row, column] = np.clip(moved, program.low[column], program.high[column])
        new_model, new_slopes = program.evaluate(trial, free[live], data.conditions)
        new_cost = _costs(new_model, data.peaks, weights[live])
        better, old = new_cost < cost[live], cost[live]
        take = live[better]
        x[take], model[take], slopes[take], cost[take] = (
            trial[better], new_model[better], new_slopes[better], new_cost[better])
        with np.errstate(invalid="ignore"):
            small = better & (old - new_cost < 1e-5 * old)
        done[live] = small | (np.abs(step).max(axis=1) < 1e-6) | (damping[live] > 1e7)
        damping[live] = np.where(better, np.maximum(damping[live] * 0.2, 1e-9), damping[live] * 8.0)
    return x, model, slopes, cost, done & np.isfinite(cost)


def fit_models(program: PeakProgram, data: PeakData,
               models: Sequence[tuple[Sequence[str], Sequence[Mapping[str, float]]]]) -> list[PeakFit]:
    """Fit several models to all records, each from several starts.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        models: for each the names of its free parameters, and its starts as values by name (a value of a parameter
            that is not free fixes it there).

    Returns:
        The best of the starts of each model, nothing held out yet.
    """
    starts, free, owner = [], [], []
    for k, (names, places) in enumerate(models):
        if len(names) > DIRECTIONS:
            raise ValueError(f"`fit_models` frees at most {DIRECTIONS} parameters of one model; got {len(names)}.")
        for place in places:
            starts.append(program.place(place))
            free.append(_number(program, names))
            owner.append(k)
    if not starts:
        return []
    starts, free, owner = np.array(starts), np.array(free), np.array(owner)

    def solve(x, free, most):
        weights = np.broadcast_to(data.weights, (len(x), len(data.weights)))
        return minimise_batch(program, data, weights, x, free, most)

    # A few steps from every start, and then the best start of each model to the end.
    x, _, _, cost, _ = solve(starts, free, 10)
    best = [int(mine[np.argmin(cost[mine])]) for mine in (np.flatnonzero(owner == k) for k in range(len(models)))]
    x, model, slopes, cost, done = solve(x[best], free[best], 50)
    fits = [PeakFit(tuple(names), x[k], model[k], slopes[k][:, : len(names)], float(cost[k]), bool(done[k]),
                    np.full(len(data.peaks), np.nan)) for k, (names, _) in enumerate(models)]
    return fits


def hold_out(program: PeakProgram, data: PeakData, fits: Sequence[PeakFit]) -> list[PeakFit]:
    """Leave every record out in turn, refit each model from its full fit, and predict the record.

    Args:
        program: peaks and derivatives.
        data: measured peaks.
        fits: models fitted to all records.

    Returns:
        The same fits with `held` filled in.
    """
    records = len(data.peaks)
    if not fits:
        return []
    fold = np.tile(data.weights * (1.0 - np.eye(records)), (len(fits), 1))
    x = np.repeat([fit.x for fit in fits], records, axis=0)
    free = np.repeat([_number(program, fit.names) for fit in fits], records, axis=0)
    x, model, _, cost, _ = minimise_batch(program, data, fold, x, free, most=20)
    model = np.where(np.isfinite(cost)[:, None], model, np.nan).reshape(len(fits), records, records)
    x, cost = x.reshape(len(fits), records, -1), cost.reshape(len(fits), records)
    return [dc.replace(fit, held=np.diagonal(model[k]).copy(), fold_x=x[k], fold_cost=cost[k])
            for k, fit in enumerate(fits)]


def _number(program: PeakProgram, names: Sequence[str]) -> list[int]:
    return [program.space.index[name] for name in names] + [-1] * (DIRECTIONS - len(names))


def _costs(model: np.ndarray, peaks: np.ndarray, weights: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        total = np.sum(np.where(weights > 0, (weights * (model - peaks)) ** 2, 0.0), axis=1)
    return np.where(np.isfinite(total), total, np.inf)


def fit_linear(columns: np.ndarray, peaks: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Weighted least squares $y = X \beta$, and the leave-one-out prediction of each record.

    Args:
        columns: $X$, shape (records, terms).
        peaks: $y$, shape (records,) [N].
        weights: shape (records,) [1/N].

    Returns:
        Fitted values and held-out predictions, both of shape (records,) [N]. Held out: $y - r/(1 - h)$ with the
        leverage $h$, which is exact for linear least squares.
    """
    basis, _ = np.linalg.qr(columns * weights[:, None])
    leverage = np.sum(basis**2, axis=1)
    fitted = basis @ (basis.T @ (peaks * weights)) / weights
    free = leverage < 1.0 - 1e-9
    held = peaks - np.where(free, (peaks - fitted) / np.where(free, 1.0 - leverage, 1.0), np.nan)
    return fitted, held


def polynomial(pressures: np.ndarray, degree: int) -> np.ndarray:
    """Columns 1, P, ... P**degree with P scaled to -1..1, shape (records, degree + 1)."""
    middle, half = 0.5 * (pressures.max() + pressures.min()), 0.5 * np.ptp(pressures)
    return np.vander((pressures - middle) / (half if half > 0 else 1.0), degree + 1, increasing=True)


def choose_degree(pressures: np.ndarray, peaks: np.ndarray, weights: np.ndarray, most: int = 3) -> int:
    """Degree (0 to `most`) of the polynomial in pressure with the smallest leave-one-out error."""
    degrees = range(max(1, min(most + 1, len(np.unique(pressures)) - 1)))
    errors = []
    for degree in degrees:
        _, held = fit_linear(polynomial(pressures, degree), peaks, weights)
        error = float(np.sum(((held - peaks) * weights) ** 2))
        errors.append(error if np.isfinite(error) else np.inf)
    return int(np.argmin(errors))


def predict_nested(pressures: np.ndarray, peaks: np.ndarray, weights: np.ndarray, most: int = 3) -> np.ndarray:
    """Leave-one-out predictions of a polynomial whose degree is chosen anew inside every fold, shape (records,) [N]."""
    held = np.empty(len(peaks))
    for k in range(len(peaks)):
        rest = np.arange(len(peaks)) != k
        degree = choose_degree(pressures[rest], peaks[rest], weights[rest], most)
        columns = polynomial(pressures, degree)
        beta = np.linalg.lstsq(columns[rest] * weights[rest, None], peaks[rest] * weights[rest], rcond=None)[0]
        held[k] = columns[k] @ beta
    return held
