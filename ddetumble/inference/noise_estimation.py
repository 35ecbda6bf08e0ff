"""Noise estimation: the noise of a campaign from what a model of it leaves above the frequencies of the contact.

The size comes from what the campaign states, the correlation from frequencies above those of any contact, never from
the low-frequency residuals of a model under suspicion. Above the contact's frequencies white noise, autoregressive
noise and their sum often look alike; below, where a missing force would act, they differ. So none is chosen before the
level there is known: it is averaged over all, and its error holds their differences.
"""

import dataclasses as dc
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import sparse, special
from scipy.interpolate import BSpline

from ..families import Span, find_family
from ..measurement.campaign import Campaign
from ..measurement.digits import measure_digit
from . import distributions as stats
from .hum import HumSettings, find_hum, tune_hum
from .noise import Noise
from .noise_size import Run, Sizes, SizeSettings, look_random, measure_sizes
from .problem import Solution, shift_clocks
from .stack import Records, default_noise


PAIRS = 6  # samples apart, at most
MOST = 2000  # frequencies kept apart
BELOW = np.array([0.05, 0.15, 0.35, 0.6, 0.9])  # of the lowest frequency used: where the contact's own are
SLOW = np.array([0.02])  # the same in cycles a sample, where differences of samples are all that is looked at
SHORTEST = 0.3  # correlation time [samples]
NODES = (48, 24)  # in correlation time and in the share that is white
ROUNDS = 8
FAR = 12.0  # below the best in the logarithm of the likelihood: no longer looked at
FAINT = 1e-10  # squared length, over the longest, of combinations of splines that no sample sees
LARGE = 1_000_000  # numbers of a spline basis beyond which its zeros are left out
Shapes = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dc.dataclass(frozen=True)
class NoiseSettings:
    """What decides how the noise of a campaign is taken."""

    fewest: int = 24  # samples without a gap that tell something about the noise
    stated: float = 0.01  # relative standard deviation of a size that a campaign states: near enough certain
    # The same of one that varies, over the logarithm of its range: the stated size lies somewhere within.
    between: float = 0.5
    # Correlation times over the period of the lowest frequency used: what is slower is a drift, no noise.
    slowest: float = 3.0
    # Share of the power of white noise that splines leave at a frequency, below which it is not used: what they leave
    # of steeper noise is not the same.
    left: float = 0.5
    # Logarithm of the likelihood that a further parameter of the noise has to bring (Akaike asks for 1; the spectrum is
    # looked at in many places), and up to which the scatter of readings may lie off stated noise and its rounding.
    worth: float = 4.0
    quiet: int = 30  # samples before contact from which on they may contradict the stated size
    doubt: float = 0.15  # logarithm of the ratio of their size to the stated one that does
    doubt_errors: float = 10.0  # the same in its standard errors, which is asked beside
    # Logarithm of the likelihood by which residuals must contradict a stated size before it is given up: what the fit
    # took of slow noise makes up to 7 of it. The same where rounding is to be added to it.
    refuted: float = 12.0
    # Times the size of readings without contact, or the stated one, beyond which what a model leaves is no noise: a
    # reading's share makes 5 of it, a stiff ball that a soft model was fitted to 70.
    loudest: float = 6.0
    # p-value of the strongest line in the spectrum under the noise that would take the stated one's place, below which
    # it is none: a stick-slip of seven times the noise passed for noise as loud, whose spectrum its lines lie about.
    lines: float = 0.005
    # Relative difference from the stated size from which on a model is fitted again under the measured one, and from
    # which on what rounding adds is looked at.
    differs: float = 0.1
    # level_change, correlation_change, white_change: changes of the logarithm of the size, of the correlation and of
    # the share that is white, under a better model, from which on all steps are fitted again.
    level_change: float = 0.03
    correlation_change: float = 0.05
    white_change: float = 0.15
    size_change: float = 0.1  # the same of the logarithm of the sizes of single samples, rms over them
    size: SizeSettings = SizeSettings()  # what makes the size count as varying
    hum: HumSettings = HumSettings()  # what makes a sine count as hum
    # Measurements of the noise beside one model, at most, each after a fit with the hum that the last one saw.
    looks: int = 3


NOISE = NoiseSettings()


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


def measure_noise(campaign: Campaign, records: Records, solution: Solution, settings: NoiseSettings = NOISE,
                  before: Mapping[str, Noise] | None = None) -> dict[str, Noise]:
    """Noise of every channel from the residuals of a fit, less what is smooth over a contact.

    Baseline and hum that the fit took (`before`) stay beside it, the hum at the frequencies that its residuals show;
    hum that is seen for the first time comes to them. Either calls for another fit and another look (`has_more_hum`).
    """
    found, family = {}, find_family(records.family)
    contact, stack = family.has_contact, records.stack
    if records.are_values:  # a single sample tells nothing about its noise
        return {channel: default_noise(campaign, channel, np.zeros(1)) for channel in records.channels}
    values, time, weights = (np.asarray(x) for x in (stack.values, stack.time, stack.weights))
    spans = [list_spans(records, r, float(solution.end[r])) for r in range(records.count)]
    for c, channel in enumerate(records.channels):
        parts, medians, even, whole = [], [], [], []
        for r, n in enumerate(records.lengths):
            # Where a slip record turns round its force is not known: its strokes are traces of their own, and so are
            # the parts of a tumbling record between its gaps.
            used = np.ones(n, dtype=bool) if contact and records.complete[r, c] else weights[r, c, :n] > 0
            if used.sum() < settings.fewest:
                continue
            t, trace = time[r, :n], (values[r, c] - solution.channels[r, c])[:n]
            smooth, difference = spline_columns(t, spans[r]), np.diff(t)
            whole.append((r, np.flatnonzero(used), trace[used]))
            # What is smooth over a contact may be missing physics: it tells nothing about the noise.
            trace = trace - smooth @ _fit_splines(smooth[used], trace[used])
            taken = _orthonormalise(smooth, used)
            medians.append(float(np.median(difference)))
            even += [r] if np.allclose(difference, difference[0], rtol=2e-3) else []
            parts += [Run(r, run, trace[run], (values[r, c, :n] - trace)[run], None if taken is None else taken[run])
                      for run in np.split(np.arange(n), np.flatnonzero(np.diff(used)) + 1) if used[run[0]]]
        # Few records do not show what repeats, and those that run freely share no phase: nothing would tell a force
        # that is missing from noise of its size but that it is smoother. Else the stated size counts.
        told = look_random(parts, settings.size) if family.free_running else records.count >= settings.size.records
        sizes = measure_sizes(parts, list(map(int, records.lengths)), settings.size) if told else None
        if sizes is not None:
            parts = [dc.replace(run, residual=run.residual / sizes.relative[run.record][run.samples]) for run in parts]
        kept = [run for run in parts if run.record in even
                and (len(run.samples) >= settings.fewest or len(run.samples) == records.lengths[run.record])]
        traces = [run.residual for run in kept]
        steps = [float(time[run.record, 1] - time[run.record, 0]) for run in kept]
        stated = default_noise(campaign, channel, time[0, : records.lengths[0]])
        expected, own = stated.stated_sd, settings
        if sizes is not None:
            # A size that varies is the stated one at some reading or in some record: their mean lies as near to it as
            # the sizes lie to one another. Without that a slow misfit would pass for noise of any size.
            every = np.concatenate(sizes.relative)
            low, high = np.quantile(every, [0.05, 0.95])
            expected = None if expected is None else expected / float(np.sqrt(np.mean(every**2)))
            own = dc.replace(settings, stated=max(settings.stated, settings.between * float(np.log(high / low))))

        def finish(noise, sizes=sizes, stated=stated):
            return noise if sizes is None else _describe_sizes(noise, sizes, records, stated.stated_sd)

        if sum(map(len, traces)) < 0.5 * sum(len(run.samples) for run in parts):
            pairs: list[Any] = [tuple(np.concatenate(x) for x in zip(*((time[r, run.samples], run.residual)
                                                           for run in parts if run.record == r), strict=True))
                     for r in dict.fromkeys(run.record for run in parts)]
            found[channel] = finish(estimate_from_pairs(pairs, float(np.median(medians)), expected, own))
            continue
        if not traces:
            found[channel] = dc.replace(stated, log_level_sd=0.1,
                                        text="too few samples: taken as white, of the stated size")
            continue
        # Strokes at two speeds have two sampling intervals: one of them, not the mean.
        interval = float(np.median(steps) if contact else np.sort(steps)[len(steps) // 2])
        same = [r for r in range(records.count) if contact or abs(float(time[r, 1] - time[r, 0]) / interval - 1) < 2e-3]
        lengths = [span.high - span.low for r in same for span in spans[r][: 1 if contact else None]]
        lowest = 10.0 / float(np.median(lengths))
        if family.free_running:
            lowest = 0.6 * float(max(min(spans[r][0].splines, records.lengths[r] // 4)
                                     / (spans[r][0].high - spans[r][0].low) for r in same))
        alike = [run for run, s in zip(kept, steps, strict=True) if abs(s / interval - 1) < 2e-3]
        found[channel] = finish(estimate_noise(
            [run.residual for run in alike], interval, lowest, expected,
            None if sizes is not None else _measure_quiet(records, c, shift_clocks(records, solution)),
            measure_deviation([x if sizes is None else x / sizes.relative[r][used] for r, used, x in whole])
            if look_random(parts, settings.size) else None, own, [run.taken for run in alike],
            measure_digit(values[r, c, :n][weights[r, c, :n] > 0] for r, n in enumerate(records.lengths))
            if sizes is None else 0.0))
    if before and any(level.hum for level in before.values()):
        before = tune_hum(campaign, records, solution, before, settings.hum)
    found = {channel: level.with_slow_parts(before[channel]) if before else level for channel, level in found.items()}
    return find_hum(campaign, records, solution, found, settings.hum)


def has_more_hum(before: Mapping[str, Noise], after: Mapping[str, Noise]) -> bool:
    """Whether hum was found that was not known, or is of another frequency than was taken."""
    return any(level.hum and (c not in before or before[c].hum != level.hum) for c, level in after.items())


def _describe_sizes(noise: Noise, sizes: Sizes, records: Records, stated: float | None) -> Noise:
    """A noise whose size varies from the noise of the residuals over their `sizes`."""
    every = np.concatenate(sizes.relative)
    unit = float(np.sqrt(np.mean(every**2)))
    varies = sizes.share > 0 or sizes.rate_share > 0
    low, high = (noise.sd * x for x in np.quantile(every, [0.05, 0.95]))
    with_reading = f", {100 * noise.sd * sizes.share:.2g} % of the reading beside" if sizes.share > 0 else ""
    with_rate = ", and more where it changes fast" if sizes.rate_share > 0 else ""
    parts = [f"its size varies from {low:.2g} to {high:.2g} (SI){with_reading}{with_rate}",
             *(["from record to record"] if np.ptp(sizes.records) > 0 else []),
             *(["along the traces"] if sizes.along else [])]
    return dc.replace(
        noise, sd=noise.sd * unit, stated_sd=stated,
        text=f"{_describe_correlation(noise.correlation, noise.white_share)}; {' and '.join(parts)}",
        floor=noise.sd * sizes.floor if varies else None, share=noise.sd * sizes.share,
        rate_share=noise.sd * sizes.rate_share,
        sizes={key: relative / unit for key, relative in zip(records.keys, sizes.relative, strict=True)})


def _describe_correlation(correlation: float, white: float) -> str:
    if correlation <= 0:
        return "white"
    if white:
        return f"correlated along the trace ({correlation:.2f}), {100 * white:.0f} % of its power white"
    return f"correlated along the trace ({correlation:.2f} from sample to sample)"


def _fit_splines(columns: sparse.csr_matrix, values: np.ndarray) -> np.ndarray:
    """Coefficients of least squares; those of long records by the normal equations, which splines leave banded."""
    if np.prod(np.shape(columns)) < LARGE:
        return np.linalg.lstsq(columns.toarray(), values, rcond=None)[0]
    square = (columns.T @ columns).toarray()
    square[np.diag_indices_from(square)] += 1e-9 * np.trace(square) / len(square)
    return np.linalg.solve(square, columns.T @ values)


def _orthonormalise(columns: sparse.csr_matrix, used: np.ndarray) -> np.ndarray | None:
    """Orthonormal columns over the samples used, zero elsewhere, that span those of splines; None of long records, of
    which splines take little but what lies below the frequencies used."""
    if not 0 < np.prod(np.shape(columns)) < LARGE:
        return None
    own = columns.toarray() * used[:, None]
    values, vectors = np.linalg.eigh(own.T @ own)
    told = values > FAINT * values[-1]
    return own @ (vectors[:, told] / np.sqrt(values[told]))


@dc.dataclass(frozen=True)
class Deviation:
    """How far samples stray about the mean of their stretch."""

    sd: float  # standard deviation, SI
    count: int  # samples, less one a stretch
    length: int  # of a stretch

    def lose(self, sd: Any, correlation: Any, white_share: Any, beyond: bool = False) -> Any:
        """Negative log-likelihood of this scatter less its least, under noise of that kind (numbers or arrays).

        With `beyond` only of noise that strays further.
        """
        n, rho = self.length, correlation
        # Covariances of n neighbours, summed: what their mean takes of the variance.
        shared = rho * (n * (1.0 - rho) - (1.0 - rho**n)) / (1.0 - rho) ** 2
        variance = sd**2 * (1.0 - 2.0 * (1.0 - white_share) * shared / (n * (n - 1.0)))
        free = self.count / (1.0 + 2.0 * ((1.0 - white_share) * rho) ** 2 / (1.0 - rho**2))
        ratio = self.sd**2 / variance
        return np.where(beyond & (ratio > 1.0), 0.0, 0.5 * free * (ratio - 1.0 - np.log(ratio)))


def measure_deviation(stretches: list[np.ndarray]) -> Deviation | None:
    """Scatter of samples about the mean of their stretch; None without samples that differ."""
    long = [x for x in stretches if len(x) > 3]
    squares, count = sum(float(np.sum((x - x.mean()) ** 2)) for x in long), sum(len(x) - 1 for x in long)
    if not squares:
        return None
    return Deviation(float(np.sqrt(squares / count)), count, int(np.median([len(x) for x in long])))


def _measure_quiet(records: Records, channel: int, touch: np.ndarray | None = None) -> Deviation | None:
    """Scatter of the samples before first touch, whose instant by each record's clock is `touch`, shape (records,), s
    (where not given, or later: 0)."""
    if not find_family(records.family).has_contact:
        return None
    values, time = np.asarray(records.stack.values), np.asarray(records.stack.time)
    until = np.minimum(np.zeros(records.count) if touch is None else touch, 0.0) - 1e-4
    return measure_deviation([values[r, channel, :n][time[r, :n] < until[r]] for r, n in enumerate(records.lengths)
                     if records.complete[r, channel]])


def changed(before: Mapping[str, Noise], after: dict[str, Noise], settings: NoiseSettings = NOISE) -> bool:
    """Whether a second measurement of the noise differs enough from the first to fit again."""
    return any(after[c].hum != before[c].hum or abs(np.log(after[c].sd / before[c].sd)) > settings.level_change
               or abs(after[c].correlation - before[c].correlation) > settings.correlation_change
               or abs(after[c].white_share - before[c].white_share) > settings.white_change
               or _compare_sizes(before[c], after[c]) > settings.size_change for c in after)


def _compare_sizes(before: Noise, after: Noise) -> float:
    """Difference of the logarithms of the sizes of single samples, rms."""
    keys = {*before.sizes, *after.sizes}
    if not keys:
        return 0.0
    ratios = [np.log(np.asarray(before.sizes.get(k, 1.0)) / np.asarray(after.sizes.get(k, 1.0))) for k in keys]
    return float(np.sqrt(np.mean(np.concatenate(ratios) ** 2)))


def differs_from_stated(noise: Mapping[str, Noise], settings: NoiseSettings = NOISE) -> bool:
    """Whether any channel's noise is correlated, or of another size than the campaign states."""
    return any(bool(n.sizes or n.hum) or n.correlation > 0 or abs(n.sd / n.stated_sd - 1) > settings.differs
               for n in noise.values() if n.stated_sd)


def _spectrum(frequency: np.ndarray, interval: float, correlation: float | np.ndarray,
              white: float | np.ndarray) -> np.ndarray:
    """Power per sample at unit variance."""
    phase = np.cos(2 * np.pi * frequency * interval)
    coloured = (1 - correlation**2) / (1 - 2 * correlation * phase + correlation**2)
    return (1 - white) * coloured + white


def estimate_noise(traces: Sequence[np.ndarray], interval: float, lowest: float, stated_sd: float | None,
                   quiet: Deviation | None = None, whole: Deviation | None = None, settings: NoiseSettings = NOISE,
                   taken: Sequence[np.ndarray | None] | None = None, digit: float = 0.0) -> Noise:
    """Whittle likelihood of the residuals' spectrum above the frequencies of the contact.

    Args:
        traces: residuals of each record (no gaps), SI.
        interval: sampling interval [s].
        lowest: lowest frequency that is used [Hz].
        stated_sd: standard deviation that the campaign states, or None.
        quiet: of samples without contact; it replaces what is stated where the two disagree beyond doubt, unless noise
            of the stated size would stray as little over so short a while.
        whole: of the residuals with all that is slow in them. Missing physics adds to it, so noise that would stray
            further is none; where noise of the stated size does not agree with that, it is given up, unless the
            spectrum then has lines, as no noise has. None where the residuals are not those of noise from sample to
            sample.
        taken: of each record orthonormal columns over its samples, shape (samples, columns), whose share was taken out
            of it (None: nothing, or nothing to speak of): they took power of the noise, too, most of it below `lowest`.
        settings: thresholds.
        digit: to whose multiples the readings are rounded, which adds a twelfth of its square to a variance that is
            stated without it. So much noise is there where the `whole` says so beyond doubt, and not more.
    """
    power, frequency = [], []
    for trace, columns in zip(traces, taken or [None] * len(traces), strict=True):
        if len(trace) < settings.fewest:
            continue
        n = len(trace)
        window = np.hanning(n + 2)[1:-1]
        window = window / np.sqrt(np.mean(window**2))
        x = np.fft.rfft((trace - np.mean(trace)) * window)
        f = np.fft.rfftfreq(n, interval)
        keep = (f >= lowest) & (f < 0.49 / interval)
        left = np.ones(len(f))
        if columns is not None:  # of white noise
            left -= np.sum(np.abs(np.fft.rfft(window[:, None] * columns, axis=0)) ** 2, axis=1) / n
        keep &= left > settings.left
        power.append(np.abs(x[keep]) ** 2 / (n * left[keep]))
        frequency.append(f[keep])
    if sum(map(len, power)) < settings.fewest:
        return _assume_white(float(np.std(np.concatenate(traces))), interval, stated_sd)
    power, frequency = np.concatenate(power), np.concatenate(frequency)
    frequencies, counts, means = _gather(frequency, power)
    weight = 0.5  # a Hann window makes neighbouring ordinates correlated: about half of them are independent

    def choose(expected, most=None):
        return _weigh_kinds(
            lambda rho, white: _spectrum(frequencies, interval, rho[:, None], white[:, None]),
            lambda rho, white: np.log(_spectrum(lowest * BELOW, interval, rho[:, None], white[:, None])).mean(axis=1),
            weight * counts, means, expected, settings.slowest / (lowest * interval), interval, stated_sd, settings,
            most)

    def judge(noise):
        s = noise.sd**2 * _spectrum(frequency, interval, noise.correlation, noise.white_share)
        return (weight * np.sum(np.log(s) + power / s)
                + settings.worth * ((noise.correlation > 0) + (noise.white_share > 0)))

    def doubt(sd, error=0.0):
        return abs(np.log(sd / stated_sd)) > max(settings.doubt, settings.doubt_errors * error)

    found = choose(stated_sd)
    if stated_sd is None:
        return found
    if quiet is not None and quiet.count >= settings.quiet and doubt(quiet.sd, 1.0 / np.sqrt(2.0 * quiet.count)):
        # A slow drift beside white noise of another size would say the same: the simpler account is believed.
        found = min(found, choose(quiet.sd), key=lambda noise: judge(noise) + quiet.lose(
            noise.sd, noise.correlation, noise.white_share))
    with_digits = float(np.hypot(stated_sd, digit / np.sqrt(12.0)))
    if whole is not None and np.log(with_digits / stated_sd) > settings.differs:
        rounded = choose(with_digits)
        losses = [judge(noise) + whole.lose(noise.sd, noise.correlation, noise.white_share)
                  for noise in (found, rounded)]
        if losses[0] - losses[1] > settings.refuted and settings.worth > whole.lose(
                rounded.sd, rounded.correlation, rounded.white_share):
            found = dc.replace(rounded, text=f"{rounded.text}: readings are multiples of {digit:.3g}")
    if whole is not None:
        own = choose(None, whole)
        gain = [judge(noise) + whole.lose(noise.sd, noise.correlation, noise.white_share, beyond=True)
                for noise in (found, own)]
        ratio = means / (own.sd**2 * _spectrum(frequencies, interval, own.correlation, own.white_share))
        lines = stats.gamma.sf(weight * counts * ratio, weight * counts).min() * len(ratio)
        credible = (quiet is None or quiet.count < settings.quiet
                    or own.sd < settings.loudest * max(quiet.sd, stated_sd))
        if doubt(own.sd) and gain[0] - gain[1] > settings.refuted and lines > settings.lines and credible:
            return own
    return found


def _assume_white(sd: float, interval: float, stated_sd: float | None) -> Noise:
    return Noise(sd if stated_sd is None else stated_sd, 0.0, 0.0, interval, stated_sd, 0.2,
                 "too few samples to measure its correlation: taken as white")


def estimate_from_pairs(traces: list[tuple[np.ndarray, np.ndarray]], interval: float, stated_sd: float | None,
                        settings: NoiseSettings = NOISE) -> Noise:
    """The same where samples are missing or unevenly taken: likelihood of the differences of near samples.

    Differences over a few intervals hardly feel what is slow, such as a missing force. `traces` holds times [s] and
    residuals [SI] of each record's samples; the correlation is given for `interval` [s].
    """
    lags, squares = [], []
    for time, x in traces:
        for k in range(1, PAIRS + 1):
            lag = time[k:] - time[:-k]
            near = lag < 2.0 * PAIRS * interval
            lags.append(lag[near])
            squares.append((x[k:] - x[:-k])[near] ** 2)
    lag, square = np.concatenate(lags), np.concatenate(squares)
    if len(lag) < settings.fewest * PAIRS:
        return _assume_white(float(np.sqrt(np.mean(square) / 2.0)), interval, stated_sd)
    weight = 0.5 / PAIRS  # every sample is in so many pairs

    lags, counts, squares = _gather(lag / interval, square)
    found = _weigh_kinds(
        lambda rho, white: 2.0 * (1.0 - (1.0 - white[:, None]) * rho[:, None] ** lags),
        lambda rho, white: np.log(_spectrum(SLOW / interval, interval, rho[:, None], white[:, None])).mean(axis=1),
        weight * counts, squares, stated_sd, settings.slowest / SLOW[0], interval, stated_sd, settings)
    return dc.replace(found, text=found.text + "; from pairs of samples, as some are missing or unevenly taken")


def _gather(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean `values` of every `x` that occurs, with neighbours taken together where there are many; how many each is."""
    unique, place = np.unique(np.round(x / max(x.max(), 1e-300), 6), return_inverse=True)
    place = place * min(MOST, len(unique)) // len(unique)
    counts = np.bincount(place)
    return np.bincount(place, x) / counts, counts, np.bincount(place, values) / counts


def _weigh_kinds(shape: Shapes, log_level: Shapes, counts: np.ndarray, means: np.ndarray,
                expected: float | None, longest: float, interval: float, stated_sd: float | None,
                 settings: NoiseSettings, most: Deviation | None = None) -> Noise:
    r"""Average over white noise, AR(1) noise and their sum, each as likely as the others beforehand.

    The logarithm of the likelihood is $-\sum_k n_k(\log s_k + p_k/s_k)$ with $s_k = \sigma^2 S_k(\rho, w)$; `shape` is
    $S$ of correlations and shares, `counts` $n_k$, `means` $p_k$, and `log_level` the logarithm of the power where it
    has to be known. The size $\sigma$ is profiled; correlation times, up to `longest`, are as likely in every decade.
    What would stray further than `most` counts less.
    """
    def look(correlation, white_share, volume):
        """Nodes: correlation, share, loss, logarithm of the size and its error, part of the prior; a column each."""
        loss, log_sd, error = _profile(shape(correlation, white_share), counts, means, expected, settings.stated)
        if most is not None:
            loss = loss + most.lose(np.exp(log_sd), correlation, white_share, beyond=True)
        return np.array([correlation, white_share, loss, log_sd, error, np.full(len(correlation), volume)])

    kinds = [look(np.zeros(1), np.zeros(1), 1.0), *(_search(look, longest, mixed) for mixed in (False, True))]
    kind = np.repeat(np.arange(len(kinds)), [nodes.shape[1] for nodes in kinds])
    correlation, white_share, loss, log_sd, error, volume = np.concatenate(kinds, axis=1)
    weight = special.softmax(np.log(volume) - loss)
    level = 2.0 * log_sd + log_level(correlation, white_share)
    mean = float(weight @ level)
    variance = float(weight @ ((2.0 * error) ** 2 + (level - mean) ** 2))
    # It stands for all: near their mean level, of a likely kind, and likely within it.
    least = np.array([nodes[2].min() for nodes in kinds])
    unlikely = loss - (least + np.log(np.maximum(np.bincount(kind, weight), 1e-300)))[kind]
    best = int(np.argmin((level - mean) ** 2 / variance + 2.0 * unlikely))
    sd, rho, white = float(np.exp(log_sd[best])), float(correlation[best]), float(white_share[best])
    text = _describe_correlation(rho, white)
    if stated_sd is not None and abs(np.log(sd / stated_sd)) > settings.differs:
        text += f"; its size {sd:.3g} is not the stated {stated_sd:.3g}"
    return Noise(sd, rho, white, interval, stated_sd, float(np.sqrt(variance + (level[best] - mean) ** 2)), text)


def _search(look, longest: float, mixed: bool) -> np.ndarray:
    """Nodes over the part of the prior that the samples leave, found by looking ever closer."""
    box = np.array([[np.log(SHORTEST), np.log(longest)], [0.0, 1.0]])
    whole = box[0, 1] - box[0, 0]
    for turn in range(ROUNDS):
        size = (box[:, 1] - box[:, 0]) / NODES
        axes = [low + step * (np.arange(count) + 0.5) for low, step, count in zip(box[:, 0], size, NODES, strict=True)]
        time, share = np.meshgrid(axes[0], axes[1] if mixed else np.zeros(1), indexing="ij")
        volume = size[0] / whole * (size[1] if mixed else 1.0)
        found = look(np.exp(-np.exp(-time.ravel())), share.ravel(), volume)
        near = (found[2] < found[2].min() + FAR).reshape(time.shape)
        inside = [np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))][: 1 + mixed]
        if turn == ROUNDS - 1 or all(i[-1] - i[0] > 0.5 * n for i, n in zip(inside, NODES, strict=False)):
            break
        for k, i in enumerate(inside):
            low, high = box[k]
            box[k] = max(low, axes[k][i[0]] - 2.0 * size[k]), min(high, axes[k][i[-1]] + 2.0 * size[k])
    return found


def _profile(shape: np.ndarray, counts: np.ndarray, means: np.ndarray,
             expected: float | None, stated: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loss at the best size of every node, the logarithm of that size and its error, shape (nodes,) each."""
    total = counts.sum()
    loss = np.log(shape) @ counts
    ratio = (1.0 / shape) @ (counts * means)
    log_sd = 0.5 * np.log(ratio / total)
    if expected is not None:  # it weighs 1 / stated²; where the slope of the loss vanishes Wright's omega function says
        least = np.log(expected) - 2.0 * total * stated**2
        log_sd = least + 0.5 * special.wrightomega(np.log(4.0 * ratio * stated**2) - 2.0 * least)
        loss = loss + 0.5 * ((log_sd - np.log(expected)) / stated) ** 2
    part = ratio * np.exp(-2.0 * log_sd)
    loss = loss + 2.0 * total * log_sd + part
    return loss, log_sd, 1.0 / np.sqrt(4.0 * part + (stated**-2 if expected is not None else 0.0))
