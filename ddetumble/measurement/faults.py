"""Faults of the samples themselves, found without any model: clipped, held, spiked, copied, missing, unevenly taken,
cut off before the contact ends.

Noise decides: two neighbouring readings with noise of deviation s, written to a resolution q, are equal with a chance
of about q/(2 sqrt(pi) s), so that a gauge at its limit, or one that stands still, gives itself away by a run of equal
readings. Spikes are in `spikes`.
"""

import dataclasses as dc

import numpy as np

from .campaign import Campaign
from .grouping import group_conditions
from .kinds import find_kind
from .quantities import join_words
from .spikes import SCREENING, ScreeningSettings, find_spikes, leave_common_spikes, leave_cubic
from .units import choose_time_unit


STAYING = ("missing", "uneven", "truncated")  # kinds that are reported and change nothing


@dc.dataclass(frozen=True)
class Fault:
    """One fault of the data, in words.

    Attributes:
        kind: `clipped`, `held`, `spike`, `missing`, `uneven`, `truncated`, `copied`, `unit`, `setting`, `clock`,
            `zero`, `gain`, `outlier` or `doubtful`.
        records: keys of the records that have it.
        channel: or condition that has it; empty where it is the record as a whole.
        seen: what is seen, a sentence.
        done: what was done about it, a sentence.
        remedy: what to do, a sentence.
        left_out: whether the records as a whole are left out.
    """

    kind: str
    records: tuple[str, ...]
    channel: str
    seen: str
    done: str
    remedy: str
    left_out: bool = False

    def __str__(self) -> str:
        return f"{self.seen} {self.done} {self.remedy}"


def screen_samples(campaign: Campaign, settings: ScreeningSettings = SCREENING) -> tuple[Campaign, tuple[Fault, ...]]:
    """Find what is wrong with the samples of a campaign, and leave it out.

    Args:
        campaign: as read.
        settings: thresholds.

    Returns:
        The campaign with faulty samples missing and copied records left out, and what was found. Samples that are
        missing, or unevenly taken, and records that end too early are reported and stay as they are.
    """
    if campaign.samples is None or campaign.independent is None:
        return campaign, ()
    samples, abscissa, found = campaign.samples.copy(), campaign.independent.name, []
    rows = {str(key): part for key, part in samples.groupby("record", sort=False).indices.items()}
    time = {key: samples[abscissa].to_numpy(dtype=float)[part] for key, part in rows.items()}
    turns = _list_turns(campaign, samples, rows)
    groups = dict(zip(campaign.record_keys, group_conditions(campaign.records), strict=True))
    for channel in list_screened(campaign):
        values = samples[channel].to_numpy(dtype=float).copy()
        parts = {key: values[part] for key, part in rows.items()}
        found += _report_missing(channel, parts, turns)
        uncertainty = campaign.channels[channel].uncertainty
        if uncertainty is None:
            continue
        sd = float(uncertainty.sd(np.nanmedian(np.abs(values))))
        if not sd > 0:
            continue
        masks = {"clipped": {}, "held": {}, "spike": {}}
        limits: dict[str, list[float]] = {}
        chance, tolerance = _measure_equality(parts, sd)
        for key, x in parts.items():
            clipped, held, limit = find_runs(x, sd, chance, len(values), tolerance, settings)
            limits[key] = limit
            masks["clipped"][key], masks["held"][key] = clipped, held
            parts[key] = np.where(clipped | held, np.nan, x)
        _tell_saturated(parts, rows, values, masks, limits)
        level = max(sd, _measure_roughness(time, parts))
        for key, x in parts.items():
            own = _measure_roughness(time, {key: x})  # of a record in another unit
            masks["spike"][key] = find_spikes(time[key], x, max(level, own), settings)
        masks["spike"] = leave_common_spikes(time, masks["spike"], groups, settings)
        for key, x in parts.items():
            parts[key] = np.where(masks["spike"][key], np.nan, x)
        unit = campaign.channels[channel].unit
        found += _report_samples(channel, unit, masks, limits, settings)
        for key, part in rows.items():
            values[part] = parts[key]
        samples[channel] = values
    found += _report_uneven(abscissa, campaign.independent.unit, time, settings)
    found += find_truncated(campaign, settings)
    cleaned = dc.replace(campaign, samples=samples)
    copied = find_copies(campaign, settings)
    if copied:
        out = {key for one in copied for key in one.records if one.left_out}
        cleaned = cleaned.select([key for key in cleaned.record_keys if key not in out])
    return cleaned, (*found, *copied)


def list_screened(campaign: Campaign) -> list[str]:
    """Channels whose readings carry noise of their own: all but the path of slip records and attitudes."""
    path = find_kind(campaign.family).path
    return [c for c in campaign.channels if not c.startswith("attitude_") and c != path]


def find_runs(x: np.ndarray, sd: float, chance: float, count: int, tolerance: float,
              settings: ScreeningSettings = SCREENING) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Readings at a limit, and readings that stand still.

    Args:
        x: readings of one record, shape (samples,), NaN where missing.
        sd: standard deviation of the noise.
        chance: that two neighbours are equal.
        count: readings of all records, for how often chance may do it.
        tolerance: below which a difference is none.
        settings: thresholds.

    Returns:
        Which samples are clipped (with those around them that may be), which are held, both of shape (samples,); the
        limits.
    """
    clipped, held, limits = np.zeros(len(x), dtype=bool), np.zeros(len(x), dtype=bool), []
    there = np.flatnonzero(np.isfinite(x))
    y = x[there]
    if len(y) < 5:
        return clipped, held, limits
    if np.ptp(y) <= tolerance:  # throughout
        if y[0] != 0.0 and count * chance ** (len(y) - 1) <= settings.chance:
            held[there] = True
        return clipped, held, limits
    breaks = np.flatnonzero(np.abs(np.diff(y)) > tolerance) + 1
    middle = _median_filter(y)
    for run in np.split(np.arange(len(y)), breaks):
        k, value = len(run), y[run[0]]
        if k < 3 or count * chance ** (k - 1) > settings.chance:
            continue
        for side in (1.0, -1.0):
            if side * value >= np.max(side * y) - tolerance:
                at = np.abs(y - value) <= tolerance
                near = at | (side * middle > side * value - settings.near * sd)
                clipped[there[_components(near, at)]] = True
                if value not in limits:
                    limits.append(float(value))
                break
        else:
            if value == 0.0 and _is_calm(y, run, sd):
                continue  # a file that holds zeros where nothing acts
            held[there[run]] = True
    return clipped, held & ~clipped, limits


def find_blind(campaign: Campaign) -> tuple[Fault, ...]:
    """Tumbling records that have nothing left of a rate: what they start from cannot be known.

    Args:
        campaign: without the faulty samples, as `screen_samples` leaves it.
    """
    assert campaign.samples is not None
    found, out = [], set()
    for channel in (c for c in campaign.channels if c in find_kind(campaign.family).rates):
        there = {str(key) for key in campaign.samples.loc[campaign.samples[channel].notna(), "record"]}
        keys = tuple(key for key in campaign.record_keys if key not in there and key not in out)
        if keys:
            out |= set(keys)
            it, them = ("It is", "it") if len(keys) == 1 else ("They are", "them")
            found.append(Fault("missing", keys, channel, f"Nothing is left of {channel} in {_count(keys)}.",
                               f"{it} left out.", f"Repeat {them} with a wider range.", left_out=True))
    return tuple(found)


def find_copies(campaign: Campaign, settings: ScreeningSettings = SCREENING) -> tuple[Fault, ...]:
    """Records whose samples are another's: noise does not repeat itself."""
    assert campaign.samples is not None
    groups = dict(zip(campaign.record_keys, group_conditions(campaign.records), strict=True))
    alike: dict[tuple, list[str]] = {}
    channels = list_screened(campaign)
    for key, part in campaign.samples.groupby("record", sort=False):
        x = part[channels].to_numpy(dtype=float)
        x = x[np.isfinite(x).all(axis=1)]
        if len(x) < 20 or np.mean(np.any(np.diff(x, axis=0) != 0, axis=1)) < settings.copied:
            continue
        alike.setdefault(tuple(np.round(x[2:14].ravel(), 12)), []).append(str(key))
    found = []
    for keys in alike.values():
        if len(keys) < 2:
            continue
        same = len({groups[key] for key in keys}) == 1 or not len(campaign.records.columns)
        out = tuple(keys[1:] if same else keys)
        done = f"{keys[0]} is kept, {join_words(out)} left out." if same else (
            "Which is the original cannot be told, and all of them are left out.")
        found.append(Fault("copied", out, "", f"Records {join_words(keys)} hold the same samples, noise included.",
                           done, "Export them again.", left_out=True))
    return tuple(found)


def find_truncated(campaign: Campaign, settings: ScreeningSettings = SCREENING) -> tuple[Fault, ...]:
    """Find impacts whose record ends while the force is still well above noise.

    The mean of the last readings is held against the level before first touch, where the record shows one, the noise
    (as stated, or that of the readings' second differences) and the peak; below half of the peak it has to be falling
    still, by a tenth over as many readings, as a zero that has moved does not.
    """
    channel = "normal_force"
    if campaign.samples is None or campaign.independent is None or channel not in campaign.channels:
        return ()
    uncertainty, keys, shares = campaign.channels[channel].uncertainty, [], []
    for key in campaign.record_keys:
        trace = campaign.trace(key)[[campaign.independent.name, channel]].dropna().to_numpy(dtype=float)
        if len(trace) < 4 * settings.last:
            continue
        time, force = trace.T
        before = force[time < 0]
        level = float(np.median(before)) if len(before) >= settings.last else 0.0
        peak, last = float(force.max()) - level, float(force[-settings.last:].mean()) - level
        sd = uncertainty.sd(peak) if uncertainty is not None else np.median(np.abs(np.diff(force, 2))) / 0.6745 / 6**0.5
        noise = settings.ended * float(sd) / settings.last**0.5
        fall = float(force[-2 * settings.last: -settings.last].mean()) - level - last
        falling = fall > max(0.1 * last, 0.5 * noise)
        if last > max(settings.pressed * peak, noise) and (falling or last > 0.5 * peak):
            keys.append(key)
            shares.append(last / peak)
    if not keys:
        return ()
    one = len(keys) == 1
    end = (f"{100 * shares[0]:.2g} %" if one else f"{100 * min(shares):.2g} to {100 * max(shares):.2g} %")
    ends = "ends" if one else "end"
    return (Fault("truncated", tuple(keys), channel,
                  f"{_count(keys)[0].upper()}{_count(keys)[1:]} {ends} in mid-contact: the {channel.replace('_', ' ')} "
                  f"there is still {end} of its peak.",
                  "The model is compared with what there is; the restitution, which the unloading tells, and whatever "
                  "acts late in the contact are the less certain, and duration and impulse are not measured.",
                  "Record until the force is back at nought, or look for what cut the file off."),)


def _list_turns(campaign: Campaign, samples, rows) -> dict[str, np.ndarray]:
    """Samples at which a slip record turns round, where its force is not known and may well be empty."""
    path = find_kind(campaign.family).path
    if path not in campaign.channels:
        return {}
    found = {}
    for key, part in rows.items():
        step = np.sign(np.diff(samples[path].to_numpy(dtype=float)[part]))
        turn = np.zeros(len(part), dtype=bool)
        turn[1:-1] = step[1:] * step[:-1] <= 0
        found[key] = turn
    return found


def _tell_saturated(parts, rows, values: np.ndarray, masks, limits) -> None:
    """A record that stands still throughout at the largest reading of all is clipped, not held."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    for key, part in rows.items():
        x = values[part]
        x = x[np.isfinite(x)]
        if len(x) and masks["held"][key].any() and not np.isfinite(parts[key]).any() and (
                abs(abs(x[0]) - largest) <= 1e-9 * largest):
            masks["clipped"][key], masks["held"][key] = masks["held"][key], masks["clipped"][key]
            limits[key] = [float(x[0])]


def _measure_equality(parts: dict[str, np.ndarray], sd: float) -> tuple[float, float]:
    """Chance that two neighbours are equal, and the difference that counts as none."""
    values = np.concatenate(list(parts.values()))
    values = values[np.isfinite(values)]
    tolerance = 1e-9 * float(np.max(np.abs(values), initial=0.0))
    shares, finest = [], []
    for x in parts.values():  # each on its own: a zero taken off every record shifts its steps
        x = x[np.isfinite(x)]
        if len(x) < 5:
            continue
        steps = np.diff(np.unique(x))
        finest.append(_guess_resolution(x, steps[steps > tolerance], tolerance))
        inner = (x[1:] < x.max() - tolerance) & (x[1:] > x.min() + tolerance) & (x[1:] != 0.0)
        if inner.sum() > 4:
            shares.append(float(np.mean(np.abs(np.diff(x))[inner] <= tolerance)))
    usual = float(np.quantile(shares, 0.25)) if shares else 0.0
    finest = [q for q in finest if np.isfinite(q)]
    resolution = float(np.quantile(finest, 0.25)) if finest else 0.0
    return min(max(resolution / (2.0 * np.sqrt(np.pi) * sd), usual, 1e-9), 0.99), tolerance


def _guess_resolution(x: np.ndarray, steps: np.ndarray, tolerance: float) -> float:
    """Finest step of a record's readings, or less where readings so coarse would have met more often.

    Of n readings spread over R in steps of q about n^2 q / (2 R) pairs are equal; what turns in step with the sampling
    has no close readings either.
    """
    inner = np.sort(x[(x < x.max() - tolerance) & (x > x.min() + tolerance) & (x != 0.0)])
    finest = float(np.min(steps, initial=np.inf))
    if len(inner) < 5:
        return finest
    met = float(np.sum(np.diff(inner) <= tolerance))
    return min(finest, 2.0 * float(np.ptp(inner)) * (met + 3.0) / len(inner) ** 2)


def _measure_roughness(time: dict[str, np.ndarray], parts: dict[str, np.ndarray]) -> float:
    """Deviation of the noise as samples stand off the cubic through their neighbours, robustly over all records."""
    off = []
    for key, x in parts.items():
        there = np.isfinite(x)
        if there.sum() > 8:
            off.append(leave_cubic(time[key][there], x[there]))
    return float(np.median(np.abs(np.concatenate(off)))) / 0.6745 if off else 0.0


def _median_filter(y: np.ndarray) -> np.ndarray:
    """Median of five neighbours, shape (samples,)."""
    wide = np.pad(y, 2, mode="edge")
    return np.median(np.stack([wide[k:k + len(y)] for k in range(5)]), axis=0)


def _components(near: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """The stretches of `near` that hold a seed."""
    found = np.zeros(len(near), dtype=bool)
    for run in np.split(np.arange(len(near)), np.flatnonzero(np.diff(near)) + 1):
        if near[run[0]] and seeds[run].any():
            found[run] = True
    return found


def _is_calm(y: np.ndarray, run: np.ndarray, sd: float) -> bool:
    """Whether the readings on both sides of a run of zeros are near zero too."""
    before, after = y[max(run[0] - 1, 0)], y[min(run[-1] + 1, len(y) - 1)]
    return bool(max(abs(before), abs(after)) < 6.0 * sd)


def _report_missing(channel: str, parts: dict[str, np.ndarray], turns: dict[str, np.ndarray]) -> list[Fault]:
    lost = {key: int(np.sum(~np.isfinite(x) & ~turns.get(key, np.zeros(len(x), dtype=bool))))
            for key, x in parts.items()}
    keys = tuple(key for key, n in lost.items() if n)
    if not keys:
        return []
    share = sum(lost.values()) / max(sum(len(x) for x in parts.values()), 1)
    return [Fault("missing", keys, channel,
                  f"{100 * share:.2g} % of all samples of {channel} are missing, in {_count(keys)}.",
                  "The fit does without them; nothing is filled in.", "Nothing to do, unless they should be there.")]


def _report_samples(channel: str, unit: str, masks, limits, settings: ScreeningSettings) -> list[Fault]:
    found = []
    for kind, by_record in masks.items():
        keys = tuple(key for key, mask in by_record.items() if mask.any())
        number = sum(int(mask.sum()) for mask in by_record.values())
        if not keys:
            continue
        them = f"{number} samples are left out" if number > 1 else "It is left out"
        if kind == "clipped":
            at = sorted({f"{value:.4g}" for key in keys for value in limits[key]})
            where = f"at {join_words(at)} {unit}" if len(at) <= 3 else "each at its largest or smallest reading"
            found.append(Fault(kind, keys, channel, f"{channel} is cut off {where} in {_count(keys)}: equal readings "
                               "follow one another there, and none lies beyond.",
                               f"{them}: those at the limit, and those beside them that may have been cut.",
                               "Choose a wider range of the gauge or the amplifier."))
        elif kind == "held":
            found.append(Fault(kind, keys, channel, f"{channel} stands still for a while in {_count(keys)}, which "
                               "noise does not allow.", f"{them}.", "Look at the gauge, its cable and the logger."))
        else:
            seen = f"{number} single samples of {channel} in {_count(keys)} stand" if number > 1 else (
                f"A single sample of {channel} in record {keys[0]} stands")
            found.append(Fault(kind, keys, channel,
                               f"{seen} more than {settings.spike:g} deviations off the neighbours.",
                               f"{them}.", "Look for interference or a loose contact."))
    return found


def _report_uneven(abscissa: str, unit: str, time: dict[str, np.ndarray], settings: ScreeningSettings) -> list[Fault]:
    keys, low, high = [], np.inf, 0.0
    for key, t in time.items():
        steps = np.diff(t)
        usual = float(np.median(steps))
        if np.mean(np.abs(steps / usual - 1.0) > settings.uneven) > settings.often:
            keys.append(key)
            low, high = min(low, float(steps.min())), max(high, float(steps.max()))
    if not keys:
        return []
    shown, factor = ("mm", 1e3) if unit == "m" and high < 1.0 else (unit, 1.0)
    if unit == "s":
        shown, factor = choose_time_unit(high)
    return [Fault("uneven", tuple(keys), abscissa, f"The sampling of {_count(keys)} is uneven: {factor * low:.3g} to "
                  f"{factor * high:.3g} {shown} from one to the next.",
                  "Every sample is taken where it stands, and the noise's correlation from pairs of samples.",
                  "Nothing to do, unless samples should be there.")]


def _count(keys) -> str:
    return f"record {keys[0]}" if len(keys) == 1 else (
        f"records {join_words(keys)}" if len(keys) <= 4 else f"{len(keys)} records ({keys[0]} among them)")
