"""Faults of the samples themselves, found without any model: clipped, held, spiked, copied, missing, unevenly taken,
cut off before the contact ends.

Noise decides: two neighbouring readings with noise of deviation s, written to a resolution q, are equal with a chance
of about q/(2 sqrt(pi) s), so that a gauge at its limit, or one that stands still, gives itself away by a run of equal
readings. Spikes are in `spikes`.
"""

import dataclasses as dc

import numpy as np
from scipy import ndimage

from .campaign import Campaign
from .grouping import group_conditions
from .kinds import find_kind
from .quantities import join_words
from .spikes import SCREENING, ScreeningSettings, find_spikes, leave_common_spikes, leave_cubic
from .units import choose_time_unit


STAYING = ("missing", "uneven", "truncated")  # kinds that are reported and change nothing
_TEXTS = {  # what is seen, what was done, what to do
    "missing": ("{share:.2g} % of all samples of {channel} are missing, in {records}.",
                "The fit does without them; nothing is filled in.", "Nothing to do, unless they should be there."),
    "blind": ("Nothing is left of {channel} in {records}.", "{they_are} left out.",
              "Repeat {them} with a wider range."),
    "clipped": ("{channel} is cut off {where} in {records}: equal readings follow one another there, and none lies "
                "beyond.", "{gone}: those at the limit, and those beside them that may have been cut.",
                "Choose a wider range of the gauge or the amplifier."),
    "held": ("{channel} stands still for a while in {records}, which noise does not allow.", "{gone}.",
             "Look at the gauge, its cable and the logger."),
    "spike": ("{single} of {channel} in {records} {stand} more than {deviations:g} deviations off the neighbours.",
              "{gone}.", "Look for interference or a loose contact."),
    "uneven": ("The sampling of {records} is uneven: {low:.3g} to {high:.3g} {unit} from one to the next.",
               "Every sample is taken where it stands, and the noise's correlation from pairs of samples.",
               "Nothing to do, unless samples should be there."),
    "copied": ("Records {same} hold the same samples, noise included.", "{kept}", "Export them again."),
    "truncated": ("The normal force is still {end} % of its peak where the readings end, in mid-contact, in {records}.",
                  "The model is compared with what there is; the restitution, which the unloading tells, and whatever "
                  "acts late in the contact are the less certain, and duration and impulse are not measured.",
                  "Record until the force is back at nought, or look for what cut the file off."),
}


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


def _tell(kind: str, keys, channel: str, left_out: bool = False, **facts) -> Fault:
    """A fault in the words of `_TEXTS`."""
    keys = tuple(keys)
    records = f"record {keys[0]}" if len(keys) == 1 else (
        f"records {join_words(keys)}" if len(keys) <= 4 else f"{len(keys)} records ({keys[0]} among them)")
    they_are, them = ("It is", "it") if len(keys) == 1 else ("They are", "them")
    facts |= {"records": records, "channel": channel, "they_are": they_are, "them": them}
    seen, done, remedy = (text.format(**facts) for text in _TEXTS[kind])
    return Fault("missing" if kind == "blind" else kind, keys, channel, seen, done, remedy, left_out)


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
    groups = dict(zip(campaign.record_keys, group_conditions(campaign.records), strict=True))
    turning, path = np.zeros(len(samples), dtype=bool), find_kind(campaign.family).path
    if path in campaign.channels:  # where a slip record turns round, its force is not known and may well be empty
        for part in rows.values():
            step = np.sign(np.diff(samples[path].to_numpy(dtype=float)[part]))
            turning[part[1:-1]] = step[1:] * step[:-1] <= 0
    # Channels whose readings carry noise of their own: all but the path of slip records and attitudes.
    screened = [c for c in campaign.channels if not c.startswith("attitude_") and c != path]
    for channel in screened:
        values = samples[channel].to_numpy(dtype=float).copy()
        lost = np.isnan(values) & ~turning
        if lost.any():
            keys = (key for key, part in rows.items() if lost[part].any())
            found.append(_tell("missing", keys, channel, share=100 * lost.mean()))
        uncertainty = campaign.channels[channel].uncertainty
        sd = 0.0 if uncertainty is None else float(uncertainty.sd(np.nanmedian(np.abs(values))))
        if not sd > 0:
            continue
        chance, tolerance = _measure_equality([values[part] for part in rows.values()], sd)
        largest, limits = float(np.nanmax(np.abs(values), initial=0.0)), {}
        clipped, held, spiked = np.zeros((3, len(values)), dtype=bool)
        for key, part in rows.items():
            x = values[part]
            cut, still, limits[key] = find_runs(x, sd, chance, len(values), tolerance, settings)
            x = x[np.isfinite(x)]
            if still.any() and still.sum() == len(x) and abs(abs(x[0]) - largest) <= 1e-9 * largest:
                # What stands still throughout at the largest reading of all is clipped, not held.
                cut, still, limits[key] = still, cut, [float(x[0])]
            clipped[part], held[part] = cut, still
        values[clipped | held] = np.nan
        parts = {key: values[part] for key, part in rows.items()}
        level = max(sd, _measure_roughness(time, parts))
        spikes = {key: find_spikes(time[key], x, max(level, _measure_roughness(time, {key: x})), settings)
                  for key, x in parts.items()}  # the roughness of its own is of a record in another unit
        for key, mask in leave_common_spikes(time, spikes, groups, settings).items():
            spiked[rows[key]] = mask
        values[spiked] = np.nan
        for kind, mask in (("clipped", clipped), ("held", held), ("spike", spiked)):
            keys, number = [key for key, part in rows.items() if mask[part].any()], int(mask.sum())
            if not keys:
                continue
            at, one = sorted({f"{value:.4g}" for key in keys for value in limits[key]}), number == 1
            where = "each at its largest or smallest reading"
            if 0 < len(at) <= 3:
                where = f"at {join_words(at)} {campaign.channels[channel].unit}"
            found.append(_tell(kind, keys, channel, where=where, deviations=settings.spike,
                               gone="It is left out" if one else f"{number} samples are left out",
                               single="A single sample" if one else f"{number} single samples",
                               stand="stands" if one else "stand"))
        samples[channel] = values
    found += _find_uneven(campaign.independent.unit, abscissa, time, settings)
    found += find_truncated(campaign, settings)
    copied = _find_copies(campaign, screened, groups, settings)
    cleaned = dc.replace(campaign, samples=samples)
    if copied:
        out = {key for one in copied for key in one.records}
        cleaned = cleaned.select([key for key in cleaned.record_keys if key not in out])
    return cleaned, (*found, *copied)


def find_runs(x: np.ndarray, sd: float, chance: float, count: int, tolerance: float,
              settings: ScreeningSettings = SCREENING) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Which readings of a record, shape (samples,), are at a limit (or around one), which stand still, and the limits.

    Args:
        x: readings, NaN where missing.
        sd: standard deviation of the noise.
        chance: that two neighbours are equal.
        count: readings of all records, for how often chance may do it.
        tolerance: below which a difference is none.
        settings: thresholds.
    """
    clipped, held, limits = np.zeros(len(x), dtype=bool), np.zeros(len(x), dtype=bool), []
    there = np.flatnonzero(np.isfinite(x))
    y = x[there]
    if len(y) < 5:
        return clipped, held, limits
    if np.ptp(y) <= tolerance:  # throughout
        held[there] = y[0] != 0.0 and count * chance ** (len(y) - 1) <= settings.chance
        return clipped, held, limits
    breaks = np.flatnonzero(np.abs(np.diff(y)) > tolerance) + 1
    middle = ndimage.median_filter(y, 5, mode="nearest")
    for run in np.split(np.arange(len(y)), breaks):
        value = float(y[run[0]])
        if len(run) < 3 or count * chance ** (len(run) - 1) > settings.chance:
            continue
        side = next((side for side in (1.0, -1.0) if side * value >= np.max(side * y) - tolerance), 0.0)
        if side:
            at = np.abs(y - value) <= tolerance
            near = at | (side * middle > side * value - settings.near * sd)
            clipped[there[np.flatnonzero(ndimage.binary_propagation(at, mask=near))]] = True
            limits += [value] * (value not in limits)
        elif value != 0.0 or np.abs(y[np.clip([run[0] - 1, run[-1] + 1], 0, len(y) - 1)]).max() >= 6.0 * sd:
            held[there[run]] = True  # a file may hold zeros where nothing acts
    return clipped, held & ~clipped, limits


def find_blind(campaign: Campaign) -> tuple[Fault, ...]:
    """Tumbling records of which `screen_samples` left nothing of a rate: what they start from cannot be known."""
    assert campaign.samples is not None
    found, out = [], set()
    for channel in (c for c in campaign.channels if c in find_kind(campaign.family).rates):
        there = set(campaign.samples.loc[campaign.samples[channel].notna(), "record"]) | out
        keys = [key for key in campaign.record_keys if key not in there]
        if keys:
            out |= set(keys)
            found.append(_tell("blind", keys, channel, left_out=True))
    return tuple(found)


def _find_copies(campaign: Campaign, screened: list[str], groups: dict, settings: ScreeningSettings) -> list[Fault]:
    """Records whose samples are another's: noise does not repeat itself."""
    assert campaign.samples is not None
    alike: dict[tuple, list[str]] = {}
    for key, part in campaign.samples.groupby("record", sort=False):
        x = part[screened].to_numpy(dtype=float)
        x = x[np.isfinite(x).all(axis=1)]
        if len(x) >= 20 and np.mean(np.any(np.diff(x, axis=0) != 0, axis=1)) >= settings.copied:
            alike.setdefault(tuple(np.round(x[2:14].ravel(), 12)), []).append(str(key))
    found = []
    for keys in (keys for keys in alike.values() if len(keys) > 1):
        same = len({groups[key] for key in keys}) == 1 or not len(campaign.records.columns)
        out = keys[1:] if same else keys
        kept = f"{keys[0]} is kept, {join_words(out)} left out." if same else (
            "Which is the original cannot be told, and all of them are left out.")
        found.append(_tell("copied", out, "", left_out=True, same=join_words(keys), kept=kept))
    return found


def find_truncated(campaign: Campaign, settings: ScreeningSettings = SCREENING) -> tuple[Fault, ...]:
    """Find impacts whose record ends while the force is still well above noise.

    The mean of the last readings is held against the level before first touch, where the record shows one, the noise
    (as stated, or that of the readings' second differences) and the peak; below half of the peak it has to be falling
    still, by a tenth over as many readings, as a zero that has moved does not.
    """
    channel = "normal_force"
    if campaign.samples is None or campaign.independent is None or channel not in campaign.channels:
        return ()
    uncertainty, shares = campaign.channels[channel].uncertainty, {}
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
            shares[key] = 100 * last / peak
    if not shares:
        return ()
    ends = dict.fromkeys(f"{share:.2g}" for share in (min(shares.values()), max(shares.values())))
    return (_tell("truncated", shares, channel, end=" to ".join(ends)),)


def _measure_equality(records: list[np.ndarray], sd: float) -> tuple[float, float]:
    """Chance that two neighbours are equal, and the difference that counts as none.

    The resolution is the finest step of a record's readings, or less where readings so coarse would have met more
    often: of n readings spread over R in steps of q about n^2 q / (2 R) pairs are equal; what turns in step with the
    sampling has no close readings either.
    """
    tolerance = 1e-9 * float(np.nanmax(np.abs(np.concatenate(records)), initial=0.0))
    shares, finest = [], []
    for x in records:  # each on its own: a zero taken off every record shifts its steps
        x = x[np.isfinite(x)]
        if len(x) < 5:
            continue
        steps = np.diff(np.unique(x))
        finest.append(float(np.min(steps[steps > tolerance], initial=np.inf)))
        inner = (x < x.max() - tolerance) & (x > x.min() + tolerance) & (x != 0.0)
        between = np.sort(x[inner])
        if len(between) >= 5:
            met = float(np.sum(np.diff(between) <= tolerance))
            finest[-1] = min(finest[-1], 2.0 * float(np.ptp(between)) * (met + 3.0) / len(between) ** 2)
        if inner[1:].sum() > 4:
            shares.append(float(np.mean(np.abs(np.diff(x))[inner[1:]] <= tolerance)))
    usual = float(np.quantile(shares, 0.25)) if shares else 0.0
    finest = [q for q in finest if np.isfinite(q)]
    resolution = float(np.quantile(finest, 0.25)) if finest else 0.0
    return min(max(resolution / (2.0 * np.sqrt(np.pi) * sd), usual, 1e-9), 0.99), tolerance


def _measure_roughness(time: dict[str, np.ndarray], parts: dict[str, np.ndarray]) -> float:
    """Deviation of the noise as samples stand off the cubic through their neighbours, robustly over all records."""
    there = {key: np.isfinite(x) for key, x in parts.items()}
    off = [leave_cubic(time[key][there[key]], x[there[key]]) for key, x in parts.items() if there[key].sum() > 8]
    return float(np.median(np.abs(np.concatenate(off)))) / 0.6745 if off else 0.0


def _find_uneven(unit: str, abscissa: str, time: dict[str, np.ndarray], settings: ScreeningSettings) -> list[Fault]:
    uneven = {}
    for key, t in time.items():
        steps = np.diff(t)
        if np.mean(np.abs(steps / np.median(steps) - 1.0) > settings.uneven) > settings.often:
            uneven[key] = steps
    if not uneven:
        return []
    steps = np.concatenate(list(uneven.values()))
    low, high = float(steps.min()), float(steps.max())
    shown, factor = ("mm", 1e3) if unit == "m" and high < 1.0 else (unit, 1.0)
    if unit == "s":
        shown, factor = choose_time_unit(high)
    return [_tell("uneven", uneven, abscissa, low=factor * low, high=factor * high, unit=shown)]
