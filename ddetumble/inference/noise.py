"""Noise of a channel: how large, how correlated along a trace, and the filter that whitens it.

The size comes from what the campaign states, the correlation from frequencies above those of any contact, never from
the low-frequency residuals of a model under suspicion.
"""

import dataclasses as dc

import numpy as np
from scipy.optimize import minimize


TAPS = 8
PAIRS = 6  # samples apart, at most
MOST = 0.9999  # correlation from sample to sample
WORTH = 4.0  # in the logarithm of the likelihood, that a further parameter of the noise has to bring


@dc.dataclass(frozen=True)
class Noise:
    """White noise plus first-order autoregressive (Ornstein-Uhlenbeck) noise.

    Attributes:
        sd: standard deviation of one sample, SI.
        correlation: of the autoregressive part over one `interval` [-].
        white_share: share of the variance that is white [-].
        interval: sampling interval at which `correlation` holds [s].
        stated_sd: what the campaign states, or None.
        log_level_sd: standard error of the logarithm of the noise power where the contact's own frequencies are.
        text: how it was found.
    """

    sd: float
    correlation: float
    white_share: float
    interval: float
    stated_sd: float | None
    log_level_sd: float
    text: str

    def covariance(self, lag: np.ndarray) -> np.ndarray:
        """Autocovariance at time lags `lag` [s], any shape."""
        lag = np.abs(lag)
        coloured = np.where(lag == 0, 1.0, np.exp(np.log(max(self.correlation, 1e-12)) * lag / self.interval))
        if self.correlation <= 0:
            coloured = (lag == 0).astype(float)
        return self.sd**2 * ((1 - self.white_share) * coloured + self.white_share * (lag < 1e-9 * self.interval))


def _spectrum(frequency: np.ndarray, interval: float, correlation: float, white: float) -> np.ndarray:
    """Power per sample at unit variance."""
    phase = np.cos(2 * np.pi * frequency * interval)
    coloured = (1 - correlation**2) / (1 - 2 * correlation * phase + correlation**2)
    return (1 - white) * coloured + white


def estimate_noise(traces: list[np.ndarray], interval: float, lowest: float, stated_sd: float | None,
                   quiet_sd: tuple[float, int, int] | None = None) -> Noise:
    """Whittle likelihood of the residuals' spectrum above the frequencies of the contact.

    Args:
        traces: residuals of each record (no gaps), SI.
        interval: sampling interval [s].
        lowest: lowest frequency that is used [Hz].
        stated_sd: standard deviation that the campaign states, or None.
        quiet_sd: standard deviation of samples without contact about the mean of each stretch, how many they are, and
            how long a stretch is; it replaces what is stated where the two disagree beyond doubt, unless noise of the
            stated size would stray as little over so short a while.
    """
    expected, doubtful = stated_sd, False
    if quiet_sd is not None and stated_sd is not None and quiet_sd[1] >= 30:
        doubtful = abs(np.log(quiet_sd[0] / stated_sd)) > max(0.15, 10.0 / np.sqrt(2.0 * quiet_sd[1]))
    power, frequency = [], []
    for trace in traces:
        n = len(trace)
        if n < 24:
            continue
        window = np.hanning(n + 2)[1:-1]
        window = window / np.sqrt(np.mean(window**2))
        x = np.fft.rfft((trace - np.mean(trace)) * window)
        f = np.fft.rfftfreq(n, interval)
        keep = (f >= lowest) & (f < 0.49 / interval)
        power.append(np.abs(x[keep]) ** 2 / n)
        frequency.append(f[keep])
    count = sum(len(p) for p in power)
    if count < 24:
        sd = expected if expected is not None else float(np.std(np.concatenate(traces)))
        return Noise(sd, 0.0, 0.0, interval, stated_sd, 0.2,
                     "too few samples to measure its correlation: taken as white")
    power, frequency = np.concatenate(power), np.concatenate(frequency)
    # A Hann window makes neighbouring ordinates correlated: about half of them are independent.
    weight = 0.5
    raw = np.sqrt(np.mean(power))

    def weigh(sd, rho, white):
        s = sd**2 * _spectrum(frequency, interval, rho, white)
        return weight * np.sum(np.log(s) + power / s)

    def choose(expected):
        def loss(x, coloured=True, mixed=False):
            rho = 1 / (1 + np.exp(-x[1])) if coloured else 0.0
            white = 1 / (1 + np.exp(-x[2])) if mixed else 0.0
            value = weigh(np.exp(x[0]), rho, white)
            return value if expected is None else value + 0.5 * ((x[0] - np.log(expected)) / 0.01) ** 2

        return _choose(loss, raw, expected, interval, stated_sd)

    found = choose(expected)
    if not doubtful or quiet_sd is None:
        return found
    quiet, count, length = quiet_sd

    def judge(noise):
        spread = noise.sd**2 * _stray(noise.correlation, noise.white_share, length)
        free = 0.5 * count * (1.0 - noise.correlation) / (1.0 + noise.correlation)
        return (weigh(noise.sd, noise.correlation, noise.white_share)
                + 0.5 * free * (np.log(spread / quiet**2) + quiet**2 / spread - 1.0)
                + WORTH * ((noise.correlation > 0) + (noise.white_share > 0)))

    # A slow drift beside white noise of another size would say the same: the simpler account is believed.
    other = choose(quiet)
    return other if judge(other) < judge(found) else found


def _stray(correlation: float, white: float, length: int) -> float:
    """Expected variance of so many neighbours about their own mean, at unit variance."""
    lag = np.arange(1, length)
    return 1.0 - 2.0 * (1.0 - white) * float(np.sum((length - lag) * correlation**lag)) / (length * (length - 1.0))


def estimate_from_pairs(traces: list[tuple[np.ndarray, np.ndarray]], interval: float, stated_sd: float | None) -> Noise:
    """The same where samples are missing or unevenly taken: likelihood of the differences of near samples.

    Differences over a few intervals hardly feel what is slow, such as a missing force.

    Args:
        traces: times [s] and residuals [SI] of each record's samples.
        interval: for which the correlation is given [s].
        stated_sd: standard deviation that the campaign states, or None.
    """
    lags, squares = [], []
    for time, x in traces:
        for k in range(1, PAIRS + 1):
            lag = time[k:] - time[:-k]
            near = lag < 2.0 * PAIRS * interval
            lags.append(lag[near])
            squares.append((x[k:] - x[:-k])[near] ** 2)
    lag, square = np.concatenate(lags), np.concatenate(squares)
    if len(lag) < 24 * PAIRS:
        sd = stated_sd if stated_sd is not None else float(np.sqrt(np.mean(square) / 2.0))
        return Noise(sd, 0.0, 0.0, interval, stated_sd, 0.2,
                     "too few samples to measure its correlation: taken as white")
    weight = 0.5 / PAIRS  # every sample is in so many pairs

    def loss(x, coloured=True, mixed=False):
        rho = 1 / (1 + np.exp(-x[1])) if coloured else 0.0
        white = 1 / (1 + np.exp(-x[2])) if mixed else 0.0
        together = (1 - white) * rho ** (lag / interval) if coloured else 0.0
        spread = 2.0 * np.exp(2.0 * x[0]) * (1.0 - together)
        value = weight * np.sum(np.log(spread) + square / spread)
        if stated_sd is not None:
            value += 0.5 * ((x[0] - np.log(stated_sd)) / 0.01) ** 2
        return value

    found = _choose(loss, float(np.sqrt(np.mean(square) / 2.0)), stated_sd, interval, stated_sd)
    return dc.replace(found, text=found.text + "; from pairs of samples, as some are missing or unevenly taken")


def _choose(loss, raw: float, expected: float | None, interval: float, stated_sd: float | None) -> Noise:
    """White, autoregressive, or both: what the likelihood wants, each parameter being worth `WORTH`."""
    start = np.log(raw if expected is None else expected)
    plain = minimize(loss, [np.log(raw)], args=(False,), method="Nelder-Mead", options=dict(xatol=1e-4, fatol=1e-3))
    best, kind = (plain.fun, plain.x, "white"), "white"
    for rho0 in (-0.5, 2.0):
        fit = minimize(loss, [start, rho0], args=(True,), method="Nelder-Mead",
                       options=dict(xatol=1e-3, fatol=1e-3))
        if fit.fun + WORTH * (kind == "white") < best[0]:
            best, kind = (fit.fun, fit.x, "ar"), "ar"
    if kind == "ar":
        fit = minimize(loss, [*best[1], -1.0], args=(True, True), method="Nelder-Mead",
                       options=dict(xatol=1e-3, fatol=1e-3, maxiter=400))
        if fit.fun + WORTH < best[0]:
            best, kind = (fit.fun, fit.x, "mixed"), "mixed"
    x = best[1]
    sd = float(np.exp(x[0]))
    rho = min(float(1 / (1 + np.exp(-x[1]))), MOST) if kind != "white" else 0.0
    white = float(1 / (1 + np.exp(-x[2]))) if kind == "mixed" else 0.0
    level = _level_error(x, kind, loss, interval)
    sentence = {"white": "white", "ar": f"correlated along the trace ({rho:.2f} from sample to sample)",
                "mixed": f"correlated along the trace ({rho:.2f}), {white:.0%} of its power white"}[kind]
    if stated_sd is not None and abs(np.log(sd / stated_sd)) > 0.1:
        sentence += f"; its size {sd:.3g} is not the stated {stated_sd:.3g}"
    return Noise(sd, rho, white, interval, stated_sd, level, sentence)


def _level_error(x, kind, loss, interval) -> float:
    """Standard error of the logarithm of the low-frequency noise power, from the curvature of the likelihood."""
    flags = {"white": (False, False), "ar": (True, False), "mixed": (True, True)}[kind]
    n, h = len(x), 2e-2
    hessian = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                y = np.array(x, dtype=float)
                y[i] += a * h
                y[j] += b * h
                total += a * b * loss(y, *flags)
            hessian[i, j] = total / (4 * h * h)

    def level(y):
        rho = 1 / (1 + np.exp(-y[1])) if flags[0] else 0.0
        white = 1 / (1 + np.exp(-y[2])) if flags[1] else 0.0
        return 2 * y[0] + np.log(_spectrum(np.array(0.02 / interval), interval, rho, white))

    gradient = np.array([(level(x + h * e) - level(x - h * e)) / (2 * h) for e in np.eye(n)])
    values, vectors = np.linalg.eigh(hessian)
    values = np.maximum(values, 1.0)
    return float(np.sqrt(np.sum((vectors.T @ gradient) ** 2 / values)))


def whitening(noise: Noise, time: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best linear prediction of each sample from the `TAPS` before it.

    Args:
        noise: the noise.
        time: of the samples, shape (samples,) [s].
        valid: False for missing samples, shape (samples,).

    Returns:
        Weights, shape (samples,): 1/sd of what cannot be predicted (0 for missing samples); and taps, shape
        (samples, TAPS): the whitened value is weight * (x_t - sum_k taps[t, k] x_{t-1-k}).
    """
    n = len(time)
    weights, taps = np.where(valid, 1.0 / noise.sd, 0.0), np.zeros((n, TAPS))
    if noise.correlation <= 0 or n < 2:
        return weights, taps
    steps = np.diff(time)
    even = bool(np.allclose(steps, steps[0], rtol=1e-3))
    known: dict[tuple[int, ...], tuple[np.ndarray, float]] = {}
    for t in range(n):
        if not valid[t]:
            continue
        back = tuple(k for k in range(1, TAPS + 1) if t - k >= 0 and valid[t - k])
        if not back:
            continue
        if not even or back not in known:
            times = time[[t - k for k in back]]
            among = noise.covariance(times[:, None] - times[None, :]) + 1e-12 * noise.sd**2 * np.eye(len(back))
            to = noise.covariance(times - time[t])
            a = np.linalg.solve(among, to)
            known[back] = a, 1.0 / float(np.sqrt(max(noise.sd**2 - a @ to, 1e-6 * noise.sd**2)))
        taps[t, np.array(back) - 1], weights[t] = known[back]
    return weights, taps


def whiten(weights: np.ndarray, taps: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Apply a whitening filter along axis 0 of `x`, shape (samples, ...)."""
    y = x.copy()
    for k in range(TAPS):
        y[k + 1:] -= taps[k + 1:, k].reshape(-1, *[1] * (x.ndim - 1)) * x[: -k - 1]
    return y * weights.reshape(-1, *[1] * (x.ndim - 1))
