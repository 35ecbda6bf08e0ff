"""The noise of a campaign, measured from what a model of it leaves above the frequencies of the contact."""

import dataclasses as dc
from collections.abc import Mapping

import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from ..families import Span, find_family
from ..measurement.campaign import Campaign
from .noise import Noise, estimate_from_pairs, estimate_noise
from .problem import Solution
from .stack import Records, default_noise


LARGE = 1_000_000  # numbers of a spline basis beyond which its zeros are left out
SHORTEST = 24  # samples without a gap that tell something about the noise


def list_spans(records: Records, row: int, end: float) -> list[Span]:
    """Stretches of a record over which a missing force is smooth."""
    n = records.lengths[row]
    strokes = records.strokes[row] if records.strokes else np.zeros(n, dtype=int)
    return find_family(records.family).lay_spans(np.asarray(records.stack.time)[row, :n],
                                                 np.asarray(records.stack.values)[row, :, :n], strokes, end)


def spline_columns(time: np.ndarray, spans: list[Span]) -> sparse.csr_matrix:
    """Cubic B-splines over each span, shape (samples, columns); four of a span are not zero at a time."""
    found = [sparse.csr_matrix((len(time), 0))]
    for low, high, number in spans:
        inside = np.flatnonzero((time > low) & (time <= high))
        number = min(number, len(inside) // 4)
        if number < 4:
            continue
        knots = np.concatenate([[low] * 3, np.linspace(low, high, number - 2), [high] * 3])
        own = BSpline.design_matrix(time[inside], knots, 3).tocoo()
        found.append(sparse.csr_matrix((own.data, (inside[own.row], own.col)), shape=(len(time), number)))
    return sparse.csr_matrix(sparse.hstack(found))


def measure_noise(campaign: Campaign, records: Records, solution: Solution) -> dict[str, Noise]:
    """Noise of every channel from the residuals of a fit, less what is smooth over a contact."""
    found, family = {}, find_family(records.family)
    contact = family.has_contact
    values, time = np.asarray(records.stack.values), np.asarray(records.stack.time)
    for c, channel in enumerate(records.channels):
        traces, steps, pairs = [], [], []
        for r, n in enumerate(records.lengths):
            difference = np.diff(time[r, :n])
            # Where a slip record turns round its force is not known: its strokes are traces of their own, and so are
            # the parts of a tumbling record between its gaps.
            used = np.ones(n, dtype=bool) if contact else np.asarray(records.stack.weights)[r, c, :n] > 0
            if contact and not records.complete[r, c]:
                used = np.asarray(records.stack.weights)[r, c, :n] > 0
            if used.sum() < SHORTEST:
                continue
            trace = (values[r, c] - solution.channels[r, c])[:n]
            smooth = spline_columns(time[r, :n], list_spans(records, r, float(solution.end[r])))
            # What is smooth over a contact may be missing physics: it tells nothing about the noise.
            trace = trace - smooth @ _fit_splines(smooth[used], trace[used])
            pairs.append((time[r, :n][used], trace[used], float(np.median(difference))))
            if not np.allclose(difference, difference[0], rtol=2e-3):
                continue
            for run in np.split(np.arange(n), np.flatnonzero(np.diff(used)) + 1):
                if used[run[0]] and (len(run) >= SHORTEST or len(run) == n):
                    traces.append(trace[run])
                    steps.append(difference[0])
        stated = default_noise(campaign, channel, time[0, : records.lengths[0]])
        if sum(map(len, traces)) < 0.5 * sum(len(pair[0]) for pair in pairs):
            found[channel] = estimate_from_pairs([pair[:2] for pair in pairs], float(np.median([p[2] for p in pairs])),
                                                 stated.stated_sd)
            continue
        if not traces:
            found[channel] = dc.replace(stated, log_level_sd=0.1,
                                        text="too few samples: taken as white, of the stated size")
            continue
        # Strokes at two speeds have two sampling intervals: one of them, not the mean.
        interval = float(np.median(steps) if contact else np.sort(steps)[len(steps) // 2])
        same = [r for r in range(records.count)
                if contact or abs(float(time[r, 1] - time[r, 0]) / interval - 1) < 2e-3]
        lengths = [high - low for r in same
                   for low, high, _ in list_spans(records, r, float(solution.end[r]))[: 1 if contact else None]]
        lowest = 10.0 / float(np.median(lengths))
        if family.free_running:
            spans = [list_spans(records, r, 0.0)[0] for r in same]
            numbers = [min(number, records.lengths[r] // 4) / (b - a) for r, (a, b, number) in zip(same, spans,
                                                                                                  strict=True)]
            lowest = 0.6 * float(np.max(numbers))
        found[channel] = estimate_noise([t for t, s in zip(traces, steps, strict=True)
                                         if abs(s / interval - 1) < 2e-3], interval, lowest, stated.stated_sd,
                                        _quiet_deviation(records, c))
    return found


def _fit_splines(columns: sparse.csr_matrix, values: np.ndarray) -> np.ndarray:
    """Coefficients of least squares; those of long records by the normal equations, which splines leave banded."""
    if np.prod(np.shape(columns)) < LARGE:
        return np.linalg.lstsq(columns.toarray(), values, rcond=None)[0]
    square = (columns.T @ columns).toarray()
    square[np.diag_indices_from(square)] += 1e-9 * np.trace(square) / len(square)
    return np.linalg.solve(square, columns.T @ values)


def _quiet_deviation(records: Records, channel: int) -> tuple[float, int, int] | None:
    """Standard deviation of the samples before first touch, each record about its own mean; how many there are of all
    records, and of one; None where there are none.
    """
    if not find_family(records.family).has_contact:
        return None
    values, time = np.asarray(records.stack.values), np.asarray(records.stack.time)
    squares, count, lengths = 0.0, 0, []
    for r, n in enumerate(records.lengths):
        before = values[r, channel, :n][time[r, :n] < -1e-4]
        if len(before) > 3 and records.complete[r, channel]:
            squares += float(np.sum((before - before.mean()) ** 2))
            count += len(before) - 1
            lengths.append(len(before))
    return (float(np.sqrt(squares / count)), count, int(np.median(lengths))) if count and squares > 0 else None


def changed(before: Mapping[str, Noise], after: dict[str, Noise]) -> bool:
    """Whether a second measurement of the noise differs enough from the first to fit again."""
    return any(abs(np.log(after[c].sd / before[c].sd)) > 0.03
               or abs(after[c].correlation - before[c].correlation) > 0.05
               or abs(after[c].white_share - before[c].white_share) > 0.15 for c in after)


def differs_from_stated(noise: dict[str, Noise]) -> bool:
    """Whether any channel's noise is correlated, or of another size than the campaign states by more than a tenth."""
    return any(n.correlation > 0 or abs(n.sd / n.stated_sd - 1) > 0.1 for n in noise.values() if n.stated_sd)
