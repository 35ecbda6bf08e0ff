"""Contact onset of raw force traces: when each force starts to rise, and how well that is known.

A threshold always comes late, as the force at the onset is nought with a horizontal tangent: a ball that touches with a
finite speed is met by a force that grows as the square of the time since touch (F = P' π b², b proportional to the
depression). The rise up to half of the peak, which hardly depends on anything else, is therefore fitted with the curve
that the contact law gives there. A stiff wall makes a force start as a straight line, a dashpot with a jump, and a
gauge that rings (a second-order sensor) bends the rise; which it is, all traces of a campaign tell together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, NoReturn

import numpy as np

from .._errors import InputError


SHORTEST = 1e-12  # s, of a trace: far below any impact, and far above where squares of times vanish
FEWEST_BEFORE = 5  # samples before contact, for a median and a deviation
REACH = 0.5  # of the peak: up to there, speed and gas pressure have changed too little for the damping to matter
# F/F(1) = (u² + b₃u³ + b₅u⁵) / (1 + b₃ + b₅), with u the time since touch over that of the rise to REACH. Fitted to
# the reference model at 0.3 to 3 MPa, 0.1 to 0.9 m/s, 0.3 to 3 kg and restitutions of 0.4 to 0.98, b₃ (growing volume,
# damping) is -0.058 ± 0.021, b₅ (falling speed) -0.087 ± 0.008, and the curve is met within 1e-4 of the peak.
ORDERS, BEND, BEND_SD = (3, 5), np.array([-0.058, -0.087]), np.array([0.03, 0.015])
SHAPE_ERROR = 2e-4  # of the peak, that the curve itself may miss: twice what it did in the cases above


@dataclass(frozen=True)
class OnsetSettings:
    """What decides how a force is taken to begin, and how well its onset is known."""

    # Fractions of the force at half of the peak that a linear spring may carry; a wall that carries half of it is no
    # inflated ball's.
    slopes: tuple[float, ...] = (0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
    slope_sd: float = 0.15  # of a half-normal prior of that fraction, beside as much weight on 0
    # By which that fraction differs between the records of a campaign (0.2 over pressures and speeds).
    slope_spread: float = 0.25
    sloped: float = 9.0  # fall of chi-square from which a force begins with a slope: three standard deviations
    # The same of a jump or a gauge that rings, which have more to choose from: four standard deviations.
    decisive: float = 16.0
    # Where these are as likely as not: seldom to begin with (a tenth), and one of some ten told apart.
    even: float = 9.0
    own_step: float = 4.0  # fall of chi-square a trace that chance lets a jump of its own reach, found by a scan
    # Fall of chi-square below which a frequency is not looked for more closely: chance does as much.
    promising: float = 6.0
    few: int = 8  # traces with the least noise, on which the frequency of a gauge is looked for
    # Sampling intervals by which an anti-aliasing filter delays: a Butterworth of order 8 at 0.4 of the rate.
    delay: float = 2.0


@dataclass(frozen=True)
class Onsets:
    """Where contact begins in the traces of a campaign."""

    time: np.ndarray  # time of first touch of every trace on its own axis, shape (traces,) [s]
    sd: np.ndarray  # its standard error, of that trace alone [s]
    # Standard error that all onsets share [s]: of the shape of the rise, which is one for the campaign, and of the
    # delay of the measuring chain, which no trace shows.
    common_sd: float
    start: str  # `curved` as in the reference model, `sloped` or `stepped`
    ringing: tuple[float, float] | None  # natural frequency [Hz] and damping ratio of a gauge that rings, or None


def find_onsets(times: Sequence, forces: Sequence, labels: Sequence[str] = (),
                settings: OnsetSettings = OnsetSettings()) -> Onsets:
    """Find the contact onsets of a campaign's impacts.

    Every rise is fitted with the reference model's curve; its onset, offset and height are its own. The errors of this
    fit are each trace's own. All traces together tell whether the force starts with a slope or a jump instead, or
    whether the gauge rings: each of these is taken only where chi-square falls decisively. What remains open is an
    error that all traces share, and so is the delay of the measuring chain.

    Args:
        times: Sampling times of each trace, increasing, shape (samples,) each [s].
        forces: Normal force of each, positive while pressing [N]; NaN is left out.
        labels: What messages about each trace begin with.
        settings: Thresholds.

    Raises:
        InputError: A trace without force above the noise, or with fewer than five samples before contact or three on
            the rise.
    """
    labels = labels or [""] * len(times)
    rises = _Rises([_cut_rise(*trace) for trace in zip(times, forces, labels, strict=True)])
    plain = rises.scan(_Start())
    sloped = [rises.refine(_Start(slope), plain.time) for slope in settings.slopes]
    known = min(float(found.chi2.sum()) for found in (plain, *sloped))
    others = (rises.scan(_Start(stepped=True)), _find_ringing(rises, plain, settings))
    drops = known - np.array([found.chi2.sum() for found in others])
    gains = drops / max(known / rises.degrees, 1.0) - [settings.own_step * len(rises.step), 0.0]
    base = others[int(np.argmax(gains))] if gains.max() > settings.decisive else plain
    if base is not plain:
        sloped = [rises.refine(replace(base.start, slope=slope), base.time) for slope in settings.slopes]
    scores = np.array([one.chi2.sum() for one in (base, *sloped)])
    misfit = max(float(scores.min() / rises.degrees), 1.0)
    # Prior weights of no slope, one half, and of slopes, a half-normal density over the intervals about them.
    slopes = np.array(settings.slopes)
    edges = np.concatenate([[0.0], np.sqrt(slopes[:-1] * slopes[1:]), [1.2]])
    density = np.exp(-0.5 * (slopes / settings.slope_sd) ** 2) * np.diff(edges)
    weights = np.concatenate([[0.5], 0.5 * density / density.sum()]) * np.exp(-0.5 * (scores - scores.min()) / misfit)
    weights /= weights.sum()
    table = np.stack([one.time for one in (base, *sloped)])
    decided = scores[0] - scores.min() > settings.sloped * misfit
    time = weights @ table if decided else base.time
    if base is plain:  # a jump or a gauge that rings may still be there
        table = np.concatenate([table, [one.time for one in others]])
        weights = np.concatenate([weights, np.exp(0.5 * (gains - settings.even))])
        weights /= weights.sum()
    open_ = table - time
    common = np.mean(open_, axis=1)
    apart = weights @ ((open_ - common[:, None]) ** 2 + (settings.slope_spread * (table - base.time)) ** 2)
    own = np.sqrt(misfit * (base.noise_sd**2 + base.shape_sd**2) + apart)
    rises.check(time, own)
    delay = settings.delay * float(np.median(rises.step))
    common_sd = float(np.sqrt(weights @ common**2 + misfit * np.mean(base.shape_sd) ** 2 + delay**2))
    kind = "stepped" if base.start.stepped else "sloped" if decided else "curved"
    return Onsets(time, own, common_sd, kind, base.start.ringing)


class _Rise(NamedTuple):
    """The beginning of a trace, up to `REACH` of its peak."""

    label: str
    time: np.ndarray  # from well before contact on, shape (samples,)
    force: np.ndarray
    half: tuple[float, float]  # when the force reaches `REACH` of its peak, and its standard error [s]
    foot: float  # first guess of the onset [s]
    height: float  # force at `half` above the offset [N]
    noise: float  # standard deviation of a sample before contact [N]
    correlation: float  # of neighbouring samples there, NaN where there are too few
    step: float  # sampling interval [s]
    earlier: int  # samples of the trace before these


def _refuse(label: str, problem: str) -> NoReturn:
    remedy = "give the contact onset yourself with --onset (a time such as '12.5 ms', or the name of a column)"
    raise InputError(f"{label}{problem}; {remedy}")


def _cut_rise(time, force, label: str) -> _Rise:
    time, force = np.asarray(time, float), np.asarray(force, float)
    there = np.isfinite(time) & np.isfinite(force)
    time, force = time[there], force[there]
    if len(time) < 2 * FEWEST_BEFORE:
        _refuse(label, f"there are only {len(time)} samples, too few to find the contact onset")
    if time[-1] - time[0] < SHORTEST:
        _refuse(label, f"the samples span {time[-1] - time[0]:.3g} s, in which there is no contact")
    last = int(np.argmax(force))
    if last < FEWEST_BEFORE:
        _refuse(label, f"the force peaks within the first {FEWEST_BEFORE} samples, so the record does not begin "
                       f"before contact")

    def climb(level: float) -> int:  # the sample from which on the force is above a level until the peak
        return int(np.max(np.flatnonzero(force[:last] < level), initial=-1)) + 1

    offset, spread = float(np.median(force[:FEWEST_BEFORE])), 0.0
    for share in (0.5, 0.25, 0.1):  # the quiet part is what lies well before the rise reaches a share of the peak
        first = climb(offset + share * (force[last] - offset))
        calm = force[: max(first - max(3, (last - first) // 2), FEWEST_BEFORE)]
        offset = float(np.median(calm))
        spread = float(1.4826 * np.median(np.abs(calm - offset))) or float(calm.std())
    peak = force[last] - offset
    if peak < max(8 * spread, 1e-12):
        _refuse(label, f"no force exceeds the noise ({spread:.3g} N) by enough to find the contact")
    first = climb(offset + max(5 * spread, 1e-3 * peak))
    if first < FEWEST_BEFORE:
        _refuse(label, f"there are only {first} samples before contact, too few to determine the onset")
    if last - first < 3:
        _refuse(label, f"there are only {last - first + 1} samples on the rise, too few to determine the onset")
    noise = float(np.hypot(spread, SHAPE_ERROR * peak))
    half = _cross(time, force - offset - REACH * peak, first, last, noise)
    # The foot of the parabola through the points where the force reaches a tenth and four tenths of its peak.
    low, high = (time[first:][np.argmax(force[first : last + 1] - offset >= share * peak)] for share in (0.1, 0.4))
    foot = float(2 * low - high)
    start = int(np.searchsorted(time, foot - 1.5 * (half[0] - foot)))  # what is long before says nothing about the rise
    rise = slice(start, int(np.searchsorted(time, half[0], side="right")))
    if rise.start >= rise.stop:
        _refuse(label, "the force does not rise as in a contact; look for single samples that are far too large")
    calm = force[: max(first - (last - first) // 2, FEWEST_BEFORE)]
    calm = calm - calm.mean()
    correlation = float(calm[1:] @ calm[:-1] / (calm @ calm)) if len(calm) >= 20 and calm @ calm > 0 else np.nan
    return _Rise(label, time[rise], force[rise], half, foot, REACH * peak, noise, correlation,
                 float(np.median(np.diff(time))), start)


def _cross(time, above, first: int, last: int, noise: float) -> tuple[float, float]:
    """When a rising force passes nought, by a parabola through the samples about it, and its standard error."""
    i = first + int(np.argmax(above[first : last + 1] >= 0))
    width = max(2, (i - first) // 4)
    part = slice(max(first, i - width), min(last, i + width) + 1)
    x = time[part] - time[i]
    values = np.polynomial.Polynomial.fit(x, above[part], 1 if len(x) < 5 else 2)
    roots = np.real(values.roots()[np.isreal(values.roots())])
    root = float(roots[np.argmin(np.abs(roots))]) if len(roots) else 0.0
    steepness = max(float(values.deriv()(root)), 1e-300)
    # Where the parabola does not rise there, nothing is known but that it lies in the trace.
    return float(time[i]) + root, min(noise / steepness / np.sqrt(len(x) / 2.0), float(time[-1] - time[0]))


@dataclass(frozen=True)
class _Start:
    """How a force begins, and what the gauge makes of it: one hypothesis about a campaign."""

    slope: float = 0.0
    stepped: bool = False
    ringing: tuple[float, float] | None = None


class _Located(NamedTuple):
    """Onsets under one hypothesis: times, their errors by noise and by shape, and misfits, shape (traces,) each."""

    start: _Start
    time: np.ndarray
    noise_sd: np.ndarray
    shape_sd: np.ndarray
    chi2: np.ndarray


class _Rises:
    """Rises of a campaign side by side, padded to one length, and their fits."""

    def __init__(self, rises: Sequence[_Rise]):
        self.rises = rises
        self.time, self.force, self.there = np.zeros((3, len(rises), max(len(rise.time) for rise in rises)))
        for i, rise in enumerate(rises):
            n = len(rise.time)
            self.time[i] = rise.time[-1]
            self.time[i, :n], self.force[i, :n], self.there[i, :n] = rise.time, rise.force, 1.0
        self.half, self.half_sd = np.array([rise.half for rise in rises]).T
        self.foot, self.height, self.step, noise, correlation = np.array(
            [(rise.foot, rise.height, rise.step, rise.noise, rise.correlation) for rise in rises]).T
        self.length = self.half - self.foot
        known = correlation[np.isfinite(correlation)]
        r = float(np.clip(np.mean(known), 0.0, 0.95)) if known.size else 0.0
        # White noise that would blur a slow rise as much as the correlated noise does.
        self.weight = self.there / noise[:, None] * np.sqrt((1 - r) / (1 + r))
        self.degrees = max(float(self.there.sum()) - 3.0 * len(rises), 1.0)

    def check(self, time: np.ndarray, sd: np.ndarray) -> None:
        """Refuse onsets that the rises do not tell."""
        for i, rise in enumerate(self.rises):
            if not sd[i] < 0.3 * (self.half[i] - time[i]):
                _refuse(rise.label, "the force rises too little above its noise to determine the onset")
            before = rise.earlier + int(np.sum(rise.time < time[i]))
            if before < FEWEST_BEFORE:
                _refuse(rise.label, f"the force seems to rise after {before} samples, too few to determine the onset")

    def scan(self, start: _Start) -> _Located:
        """Onsets by a search around the foot."""
        trials = self.limit(self.foot + np.linspace(-0.7, 0.7, 29)[:, None] * self.length)
        scores = np.stack([self.solve(start, trial)[0] for trial in trials])
        return self.refine(start, trials[np.argmin(scores, axis=0), np.arange(len(self.foot))])

    def refine(self, start: _Start, time: np.ndarray, most: int = 12) -> _Located:
        """Onsets by Gauss-Newton from a guess, shape (traces,)."""
        found = self.solve(start, time)
        for _ in range(most):
            trial = self.limit(time + np.clip(found[1], -0.1 * self.length, 0.1 * self.length))
            tried = self.solve(start, trial)
            better = tried[0] < found[0] - 1e-6
            if not better.any():
                break
            time, found = np.where(better, trial, time), np.where(better, tried, found)
        chi2, _, noise_sd, shape_sd = found
        if start.stepped:  # a jump lies anywhere between two samples
            noise_sd = np.hypot(noise_sd, self.step / np.sqrt(12.0))
        return _Located(start, time, noise_sd, shape_sd, chi2)

    def limit(self, time: np.ndarray) -> np.ndarray:
        """Onsets not before the first sample nor too near to where the rise ends."""
        return np.clip(time, self.time[:, 0], self.half - 0.15 * self.length)

    def solve(self, start: _Start, onset: np.ndarray) -> np.ndarray:
        """Linear least squares at fixed onsets: chi-square, step towards better ones, errors by noise and by shape.

        Offset and height are free; what bends the curve, a jump, and the error of `half` have priors.

        Returns:
            Shape (4, traces).
        """
        curve, bends, jump = self.bend(start, onset, self.half)
        little = 1e-3 * (self.half - onset)
        late, early = (self.bend(start, onset + sign * little, self.half)[0] for sign in (1.0, -1.0))
        longer = self.bend(start, onset, self.half + little)[0]
        height, scale = self.height[:, None], little[:, None]
        columns = [np.ones_like(curve), curve, *bends, height * (longer - curve) / scale]
        priors = [*(self.height * sd for sd in BEND_SD), self.half_sd]
        if start.stepped:
            columns, priors = [*columns, jump], [*priors, self.height]
        columns.append(0.5 * height * (late - early) / scale)
        matrix = np.stack(columns, axis=2) * self.weight[..., None]
        size = np.maximum(np.sqrt(np.einsum("gnk,gnk->gk", matrix, matrix)), 1e-100)
        matrix = matrix / size[:, None, :]
        right = self.force * self.weight
        data = np.swapaxes(matrix, 1, 2) @ matrix
        prior = np.zeros_like(size)
        prior[:, 2:-1] = 1.0 / np.stack(priors, axis=1) ** 2
        whole = data + (prior / size**2 + 1e-13)[:, None, :] * np.eye(len(columns))
        gradient = np.einsum("gnk,gn->gk", matrix, right)
        # The onset's own column comes last: its coefficient is the step, and without it the misfit here remains.
        values = np.linalg.solve(whole[:, :-1, :-1], gradient[:, :-1, None])[..., 0]
        residual = right - np.einsum("gnk,gk->gn", matrix[..., :-1], values)
        chi2 = np.sum(residual**2, axis=1) + np.sum(prior[:, :-1] * (values / size[:, :-1]) ** 2, axis=1)
        covariance = np.linalg.inv(whole)
        step = np.linalg.solve(whole, gradient[..., None])[:, -1, 0] / size[:, -1]
        noise = (covariance @ data @ covariance)[:, -1, -1]
        shape = np.maximum(covariance[:, -1, -1] - noise, 0.0)
        return np.stack([chi2, step, *(np.sqrt(x) / size[:, -1] for x in (noise, shape))])

    def bend(self, start: _Start, onset: np.ndarray, half: np.ndarray
             ) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
        """The rises, 1 at `half` for a gauge that does not ring, what bends them, and a jump at the onset."""
        length = (half - onset)[:, None]
        u = np.maximum((self.time - onset[:, None]) / length, 0.0)
        gauge = None if start.ringing is None else (2.0 * np.pi * start.ringing[0] * length, start.ringing[1])
        straight, square, *bends = _respond((1, 2, *ORDERS), u, gauge)
        curved = (square + sum(b * x for b, x in zip(BEND, bends, strict=True))) / (1.0 + BEND.sum())
        return (1.0 - start.slope) * curved + start.slope * straight, bends, (u > 0).astype(float)


def _respond(orders: Sequence[int], u: np.ndarray, gauge: tuple[np.ndarray, float] | None) -> list[np.ndarray]:
    """Readings of a second-order sensor, y'' + 2ζωy' + ω²y = ω²uⁿ from rest at u = 0, for each n; uⁿ without one."""
    powers = [u**n for n in range(max(orders) + 1)]
    if gauge is None:
        return [powers[n] for n in orders]
    w, damping = gauge
    swing = w * np.sqrt(1.0 - damping**2)
    decay = np.exp(-damping * w * u)
    cosine, sine = decay * np.cos(swing * u), decay * np.sin(swing * u)
    readings = []
    for n in orders:
        c: list = [0.0] * (n + 3)  # of the polynomial that solves the equation, from its highest power down
        for j in range(n, -1, -1):
            c[j] = float(j == n) - 2.0 * damping / w * (j + 1) * c[j + 1] - (j + 2) * (j + 1) / w**2 * c[j + 2]
        free = c[0] * cosine + (c[1] + damping * w * c[0]) / swing * sine
        readings.append(sum(c[j] * powers[j] for j in range(n + 1)) - free)
    return readings


def _find_ringing(rises: _Rises, plain: _Located, settings: OnsetSettings) -> _Located:
    """Onsets for a gauge that rings so as to leave least: natural frequency and damping ratio in turns."""
    few = np.argsort(-rises.height * rises.weight.max(axis=1))[:settings.few]
    some, guess = _Rises([rises.rises[i] for i in few]), plain.time[few]
    # From half a period in the rise, below which it looks like another contact, to what the sampling can follow.
    lowest, highest = 0.5 / float(np.median(rises.length)), 0.2 / float(np.median(rises.step))
    frequencies = np.geomspace(lowest, max(highest, 2.0 * lowest), 16)
    tried = [some.refine(_Start(ringing=(float(f), d)), guess, 4) for f in frequencies for d in (0.05, 0.2)]
    best = min(tried, key=lambda found: found.chi2.sum())
    if plain.chi2[few].sum() - best.chi2.sum() < settings.promising:
        return rises.refine(best.start, plain.time)
    best = _narrow(some, best, np.array([np.log(frequencies[1] / frequencies[0]) / 2.0, 0.7]), 6)
    return _narrow(rises, rises.refine(best.start, plain.time), np.array([0.02, 0.2]), 3)


def _narrow(rises: _Rises, best: _Located, steps: np.ndarray, turns: int) -> _Located:
    """A gauge that leaves less: steps in the logarithms of frequency and damping, each turn smaller ones."""
    for _ in range(turns):
        for move in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
            frequency, damping = np.array(best.start.ringing) * np.exp(np.array(move) * steps)
            gauge = _Start(ringing=(float(frequency), min(float(damping), 0.9)))
            best = min((best, rises.refine(gauge, best.time, 4)), key=lambda found: found.chi2.sum())
        steps = 0.6 * steps
    return best
