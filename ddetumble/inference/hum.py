"""Hum: sines of one frequency in all records (the mains, a vibration), in a phase of each record's own."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import optimize

from ..families import find_family
from ..measurement.campaign import Campaign, group_conditions
from . import distributions as stats
from .noise import Noise, whitening_matrix
from .problem import Added, Solution
from .stack import COSINE, SINE, Records, list_paces
from .variance_components import follow_conditions


PADDED = 4  # times the length of a record, to which it is filled up before its spectrum: peaks are seen between bins
APART = 1.5  # bins between two peaks that are looked at
NEAR, FINE = 0.75, 0.01  # bins about a peak in which its frequency is looked for, and how closely
MAINS = (50.0, 60.0)  # Hz; a multiple of these is taken where it removes as much but for chance,
TIE = 4.0  # which is two standard deviations of the frequency


@dc.dataclass(frozen=True)
class HumSettings:
    """When a sine counts as hum, which no physics of a contact and no free motion makes."""

    # phases, free_phases: of all records, and of every channel of these where they run freely: of fewer, those that are
    # random are not told from those that physics gives. Three records of three axes are what many have.
    phases: int = 10
    free_phases: int = 9
    # harmonics, fast_phases: times as often as a body turns, beyond which its motion makes no line without larger ones
    # below, as torques follow its attitude or its square; and how many phases are enough there, of lines as steady as
    # below: what swings by itself, as a panel does, starts by another amount in every record.
    harmonics: float = 5.0
    fast_phases: int = 6
    # turns, free_turns: of the sine in a record at least, the second where records run freely: slower ones are drifts,
    # or a motion, which a missing force looks like.
    turns: float = 1.5
    free_turns: float = 10.0
    # Bins by which it would lie elsewhere, if it went with the body's rates as all does that its motion makes: in more
    # of the freely running records than may show nothing of it, or in fewer, where these show it and `steady` holds.
    stays: float = 1.5
    fastest: float = 0.45  # frequency in cycles a sample, at most
    worth_a_look: float = 0.01  # p-value of the highest peak of the spectrum, above which no sine is fitted
    p_value: float = 1e-6  # of what the sine removes, over all frequencies, below which it is there
    seen: float = 0.7  # share of the records in which it has to be seen by itself (at 1 %)
    alike: float = 0.5  # relative scatter of its amplitude over the records, at most: hum does not know the conditions
    # random, free_random, fast_random: p-value of phases that are alike, or follow the conditions, below which they are
    # no hum's; of three axes that begin alike in three records it is 0.012, and 0.12 in two.
    random: float = 0.01
    free_random: float = 0.03
    fast_random: float = 0.15
    # steady, differ, steady_random: relative scatter of the amplitude, below which no force of a contact makes it where
    # one of the conditions differs by that factor at least, and the p-value that counts then: of campaigns whose phases
    # are random one in fifty is below the other one. No motion makes so steady a line at other rates, either.
    steady: float = 0.15
    differ: float = 1.5
    steady_random: float = 0.001
    peaks: int = 3  # highest peaks of the spectrum that are looked at
    most: int = 3  # sines of a channel, at most
    off: float = 3.0  # standard errors by which a frequency that was found beside a poorer model is off before it moves


def find_hum(campaign: Campaign, records: Records, solution: Solution, noise: Mapping[str, Noise],
             settings: HumSettings = HumSettings()) -> dict[str, Noise]:
    """The noise of every channel with the hum that the residuals of a fit show beside what the fit allows for.

    The highest peaks of the residuals' mean spectrum are fitted as sines with an amplitude and a phase of every
    record's own, along with parameters and settings, to first order: those of one channel, or of all axes of a
    gyroscope together where records run freely.
    """
    found, paces, free = dict(noise), list_paces(campaign), find_family(records.family).free_running
    channels = [c for c, channel in enumerate(records.channels) if not channel.startswith("attitude_")]
    # What shakes a gyroscope shakes all its axes; a gauge of force has one.
    for group in [channels] if free and channels else [[c] for c in channels]:
        if len(group) * records.count < (settings.fast_phases if free else settings.phases):
            continue
        lines: list[tuple[float, dict[int, float]]] = []
        known = np.zeros((records.count, solution.residual.shape[1], 0))
        taken = max(len(noise[records.channels[c]].hum) for c in group)
        while taken + len(lines) < settings.most:
            line = _find_line(campaign, records, solution, group, paces, known, settings)
            if line is None:
                break
            lines.append(line)
            known = np.concatenate([known, _whiten_sines(records, group, line[0], paces)], axis=2)
        for c in group:
            channel = records.channels[c]
            found[channel] = noise[channel].with_hum(tuple((f, sizes[c]) for f, sizes in lines if c in sizes))
    return found


def tune_hum(campaign: Campaign, records: Records, solution: Solution, noise: Mapping[str, Noise],
             settings: HumSettings = HumSettings()) -> dict[str, Noise]:
    """The noise with the hum that a fit took at the frequencies that its residuals show.

    Beside a poorer model a frequency may have been off. Each one goes a Gauss-Newton step on, along with parameters,
    settings and the sines' amplitudes, where that is beyond chance; the mains are taken where they are as near.
    """
    found, paces, k = dict(noise), list_paces(campaign), 0
    bin_ = 1.0 / np.median(paces * np.ptp(np.asarray(records.stack.time)[: records.count], axis=1))
    for channel in (channel for channel in noise if channel in records.channels):
        lines = []
        for frequency, sd in noise[channel].hum:
            places = [records.nuisances.index(f"{kind}-{k}:{channel}") for kind in (SINE, COSINE)]
            sines, turned = (_whiten_sines(records, [records.channels.index(channel)], frequency, paces, slopes)
                             for slopes in (False, True))
            # What a nuisance of one deviation adds to the residual is so many times its sine.
            size = np.sum(solution.own[:, :, places] * sines, axis=1) / np.maximum(np.sum(sines**2, axis=1), 1e-300)
            column = np.einsum("rsk,rk->rs", turned, solution.z[:, places] * size)
            step, error = (float(x[-1]) for x in solution.widen("frequency", column).step())
            if settings.off * error < abs(step) < NEAR * bin_:
                frequency += step
                mains = min((one * max(round(frequency / one), 1) for one in MAINS), key=lambda f: abs(f - frequency))  # noqa: B023
                frequency = mains if abs(mains - frequency) < settings.off * error else frequency
            lines.append((frequency, sd))
            k += 1
        found[channel] = dc.replace(noise[channel], hum=tuple(lines))
    return found


def _find_line(campaign: Campaign, records: Records, solution: Solution, group: Sequence[int], paces: np.ndarray,
               known: np.ndarray, settings: HumSettings) -> tuple[float, dict[int, float]] | None:
    """Frequency [Hz] of the sine that removes most of the misfit of a group of channels, if it is hum, and its rms [SI]
    in each that shows it."""
    grid, power, bin_ = _average_spectrum(records, solution, group, paces, settings)
    draws = records.count * len(group)
    # Of white noise of the known size every place of the spectrum is a gamma variate.
    if not len(grid) or stats.gamma.sf(power.max(), draws) * len(grid) > settings.worth_a_look:
        return None

    def fit(frequency: float) -> Added:
        return solution.fit_more(np.concatenate([known, _whiten_sines(records, group, frequency, paces)], axis=2))

    peaks = []
    for _ in range(settings.peaks):
        if np.isfinite(power).any():
            peak = float(grid[int(np.argmax(power))])
            power = np.where(np.abs(grid - peak) < APART * bin_, -np.inf, power)
            peaks.append((fit(peak).gain, peak))
    gain, peak = max(peaks)
    before = solution.fit_more(known).gain if known.shape[2] else 0.0
    chance = stats.chi2.sf(gain - before, 2 * draws) * len(grid)
    fast, elsewhere = _would_move(records, group, peak, bin_, settings)
    if chance > settings.p_value or not _list_seen(campaign, records, fit(peak), len(group), fast, elsewhere,
                                                   settings):
        return None
    near: Any = optimize.minimize_scalar(lambda f: -fit(f).gain, bounds=(peak - NEAR * bin_, peak + NEAR * bin_),
                                         method="bounded", options={"xatol": FINE * bin_})
    frequency, one = float(near.x), fit(float(near.x))
    for mains in MAINS:
        multiple = mains * max(round(frequency / mains), 1)
        if abs(multiple - frequency) < NEAR * bin_ and (other := fit(multiple)).gain > one.gain - TIE:
            frequency, one = multiple, other
    seen = _list_seen(campaign, records, one, len(group), fast, elsewhere, settings)
    sines = _take_sines(one.found, len(group))
    return (frequency, {group[k]: float(np.sqrt(np.mean(sines[:, k] ** 2))) for k in seen}) if seen else None


def _take_sines(columns: np.ndarray, channels: int) -> np.ndarray:
    """The last sine and cosine of every channel, shape (records, channels, 2)."""
    return columns[:, -2 * channels:].reshape(len(columns), channels, 2)


def _list_seen(campaign: Campaign, records: Records, one: Added, channels: int, fast: bool, elsewhere: np.ndarray,
               settings: HumSettings) -> list[int]:
    """Places of the channels whose sines are as large in each record and of which the phases share nothing, if they
    are hum; else none. `fast` and `elsewhere` are those of `_would_move`."""
    sines, errors = _take_sines(one.found, channels), _take_sines(one.error, channels)
    sizes = np.hypot(sines[..., 0], sines[..., 1])
    shown = np.sum((sines / errors) ** 2, axis=2) > stats.chi2.isf(0.01, 2)
    enough, alike = np.mean(shown, axis=0) >= settings.seen, settings.alike
    if np.mean(elsewhere) <= 1.0 - settings.seen:  # so few might show nothing of a line that moves
        enough, alike = enough & elsewhere.any() & np.all(shown[elsewhere], axis=0), settings.steady
    free = find_family(records.family).free_running
    few = free and channels * records.count < settings.free_phases
    alike = settings.steady if few else alike
    places = [int(k) for k in np.flatnonzero(enough & (np.std(sizes, axis=0) <= alike * np.mean(sizes, axis=0)))]
    fewest = (settings.fast_phases if fast and few else settings.free_phases) if free else settings.phases
    if len(places) * records.count < fewest:
        return []
    # Nothing alike (Rayleigh's test), nor alike but for the sign, in all channels together.
    phase = np.arctan2(sines[..., 1], sines[..., 0])[:, places]
    chances = [float(stats.gamma.sf(np.sum(np.abs(np.mean(np.exp(1j * k * phase), axis=0)) ** 2) * records.count,
                                    len(places))) for k in (1, 2)]
    if free:
        return places if 2.0 * min(chances) > (settings.fast_random if few else settings.free_random) else []
    # Nor moving with the conditions: free motion has none.
    groups, conditions = group_conditions(campaign.records), campaign.records.to_numpy(dtype=float)
    chances += [follow_conditions(sines[:, k, part], groups, conditions) for k in places for part in range(2)]
    settled = np.abs(campaign.records.drop(columns="sequence", errors="ignore").to_numpy(dtype=float))
    steady = (np.std(sizes, axis=0) <= settings.steady * np.mean(sizes, axis=0))[places].all() and np.any(
        settled.max(axis=0) > settings.differ * settled.min(axis=0))
    return places if 2.0 * min(chances) > (settings.steady_random if steady else settings.random) else []


def _would_move(records: Records, group: Sequence[int], frequency: float, bin_: float, settings: HumSettings
                ) -> tuple[bool, np.ndarray]:
    """Whether a line of that frequency is faster than any that the motion of a free body makes, and in which records it
    would lie at another one if it went with the body's rates; in all of them where it is so fast, or none moves freely.
    """
    everywhere = np.ones(records.count, dtype=bool)
    if not find_family(records.family).free_running:
        return False, everywhere
    values, weights = (np.asarray(x)[: records.count][:, list(group)] for x in
                       (records.stack.values, records.stack.weights))
    rates = np.sqrt(np.sum(values**2 * (weights > 0), axis=(1, 2)) / np.maximum(np.sum(weights > 0, axis=(1, 2)), 1))
    rates *= np.sqrt(len(group))  # of the vector, where no sample is missing
    if frequency > settings.harmonics * rates.max() / (2.0 * np.pi):
        return True, everywhere
    return False, np.abs(rates / np.median(rates) - 1.0) * frequency > settings.stays * bin_


def _average_spectrum(records: Records, solution: Solution, group: Sequence[int], paces: np.ndarray,
                      settings: HumSettings) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies [Hz], the power of a group's whitened residuals at these over all records, one over the median
    length."""
    time, weights = (np.asarray(x) for x in (records.stack.time, records.stack.weights))
    size, spectra = time.shape[1], []
    for r, n in enumerate(records.lengths):
        used = weights[r, list(group), :n] > 0
        t = time[r, :n] * paces[r]
        step = np.diff(t)
        if np.sum(used, axis=1).min() < 16 or not np.allclose(step, step[0], rtol=1e-2):
            continue
        power = 0.0
        for c, known in zip(group, used, strict=True):
            x = solution.residual[r, c * size: c * size + n]
            x = np.where(known, x - x[known].mean(), 0.0)
            power = power + np.abs(np.fft.rfft(x, PADDED * n)) ** 2 / known.sum()
        spectra.append((np.fft.rfftfreq(PADDED * n, step[0]), power, float(np.ptp(t)), float(step[0])))
    if len(spectra) < 0.5 * records.count:
        return np.zeros(0), np.zeros(0), 1.0
    length = float(np.median([one[2] for one in spectra]))
    fastest = settings.fastest / max(one[3] for one in spectra)
    turns = settings.free_turns if find_family(records.family).free_running else settings.turns
    grid = np.arange(turns / min(one[2] for one in spectra), fastest, 1.0 / (PADDED * length))
    return grid, sum((np.interp(grid, f, p) for f, p, *_ in spectra), np.zeros(len(grid))), 1.0 / length


def _whiten_sines(records: Records, group: Sequence[int], frequency: float, paces: np.ndarray, slopes: bool = False
                  ) -> np.ndarray:
    """Sine and cosine of every channel of a group as columns of the whitened residual, or their `slopes` by the
    frequency, shape (records, rows, 2 channels)."""
    time, weights, taps = (np.asarray(x) for x in (records.stack.time, records.stack.weights, records.stack.taps))
    size = time.shape[1]
    found = np.zeros((records.count, weights.shape[1] * size, 2 * len(group)))
    for r, n in enumerate(records.lengths):
        seconds = paces[r] * time[r, :n]
        sine, cosine = np.sin(2.0 * np.pi * frequency * seconds), np.cos(2.0 * np.pi * frequency * seconds)
        late = 2.0 * np.pi * seconds
        columns = np.stack([late * cosine, -late * sine] if slopes else [sine, cosine], axis=1)
        for k, c in enumerate(group):
            whiten = whitening_matrix(weights[r, c, :n], taps[r, c, :n])
            found[r, c * size: c * size + n, 2 * k: 2 * k + 2] = whiten @ columns
    return found
