"""Faults of the samples themselves, found without any model: clipped, held, spiked, copied, missing, unevenly taken,
cut off before the contact ends.

Noise decides: a reading with noise of deviation s, written to a resolution q, is that of its level with a chance of at
most erf(q/(2 sqrt(2) s)), so that a gauge at its limit, or one that stands still, gives itself away by a run of equal
readings. A spike is a single reading off a smooth curve on which all readings around it lie; a jump, a kink and a peak
are none.
"""

import dataclasses as dc
from collections.abc import Hashable, Iterable, Mapping, Sequence
from itertools import combinations
from types import MappingProxyType

import numpy as np
from scipy import ndimage, special

from .campaign import Campaign, group_conditions
from .kinds import find_kind
from .quantities import join_words
from .units import choose_time_unit


STAYING = ("missing", "uneven", "truncated")  # kinds that are reported and change nothing
_TEXTS = {  # what is seen, what was done, what to do
    "missing": ("{share:.2g} % of all samples of {channel} are missing, in {records}.",
                "The fit does without them; nothing is filled in.",
                "Nothing need be done, unless they should be there."),
    "blind": ("Nothing is left of {channel} in {records}.", "{they_are} left out.",
              "Repeat {them} with a wider range."),
    "clipped": ("{channel} is clipped {where} in {records}: equal readings follow one another there, and none lies "
                "beyond.", "{gone}: those at the limit, and neighbours that may have been clipped.",
                "Choose a wider range of the gauge or the amplifier."),
    "held": ("{channel} is constant for a while in {records}, which is impossible with noise.", "{gone}.",
             "Check the gauge, its cable and the logger."),
    "spike": ("{single} of {channel} in {records} {stand} more than {deviations:g} standard deviations from "
              "neighbouring samples.", "{gone}.", "Look for interference or a loose contact."),
    "uneven": ("The sampling of {records} is uneven: {low:.3g} to {high:.3g} {unit} from one sample to the next.",
               "Every sample is used where it lies, and the correlation of the noise comes from pairs of samples.",
               "Nothing need be done, unless samples are missing."),
    "copied": ("Records {same} contain the same samples, noise included.", "{kept}", "Export them again."),
    "truncated": ("The normal force is still {end} % of its peak where the readings end, during contact, in {records}.",
                  "The model is compared with the samples that there are; the restitution, which the unloading "
                  "determines, and whatever acts late in the contact are less certain, and duration and impulse are "
                  "not measured.",
                  "Record until the force has returned to zero, or find out what cut the file off."),
}


@dc.dataclass(frozen=True)
class Fault:
    """One fault in the data, described in words."""

    # `clipped`, `held`, `spike`, `missing`, `uneven`, `truncated`, `copied`, `unit`, `setting`, `clock`, `zero`,
    # `gain`, `outlier` or `doubtful`.
    kind: str
    records: tuple[str, ...]  # keys of the records that have it
    channel: str  # or condition that has it; empty where it is the record as a whole
    seen: str  # what is seen, a sentence
    done: str  # what was done about it, a sentence
    remedy: str  # what to do, a sentence
    left_out: bool = False  # whether the records as a whole are left out

    def __str__(self) -> str:
        return f"{self.seen} {self.done} {self.remedy}"


@dc.dataclass(frozen=True)
class ScreeningSettings:
    """When samples count as faulty, before any model is fitted."""

    # Expected number, by chance, of runs of equal readings that are called clipped or held: one campaign in ten
    # thousand loses good samples.
    chance: float = 1e-4
    near: float = 3.0  # standard deviations below a limit within which a reading may have been cut by it
    # Deviations of noise and rounding by which a parabola through the readings on either side of equal ones at an
    # extreme exceeds them, from which on these are clipped, however coarse the gauge is: of rates and of the force of a
    # contact, which are smooth there.
    beyond: float = 8.0
    # Steps of a gauge that is coarser than its noise, up to which a level is one of rest: a record may be quieter than
    # the others, and stay there for long.
    rest: float = 5.0
    off: float = 6.0  # standard deviations beyond which a reading is no noise about zero
    # Times the largest change from one reading to the next elsewhere in the record, from which on leaps to equal
    # readings and back say that the signal was gone: what a contact does within a sample, it does twice.
    leap: float = 1.5
    # Standard deviations off its neighbours from which a reading is a spike: of a million Gaussian readings none is.
    spike: float = 7.0
    smooth: float = 1.8  # standard deviations of the other samples from a cubic, up to which they lie on it
    common: float = 3.0  # samples around a spike within which one of another record is at the same time
    # Expected number of spikes of others there, by chance, below which a common spike is the experiment's.
    recurs: float = 0.01
    many: float = 0.05  # share of the readings of a record beyond which spikes are no accidents
    uneven: float = 0.02  # share by which intervals of sampling may differ
    often: float = 0.02  # share of the intervals that may differ by more
    # Share of readings that differ from the one before, which a record needs to be held against others: one that stands
    # still is equal to any.
    copied: float = 0.9
    last: int = 5  # readings at the end of a record whose mean tells whether it ends in contact
    pressed: float = 0.05  # share of the peak above which that mean is a contact's: drift or lag of a gauge makes less
    ended: float = 6.0  # standard deviations of that mean above nought


SCREENING = ScreeningSettings()
BESIDE = 4  # readings on either side of equal ones that say where these should lie: a parabola has three unknowns
WINDOW = 9  # samples in which a spike is looked for: a smooth curve is a low polynomial in so few
LOCAL = 61  # samples over which the size of the noise is taken: most of them by far are none of a spike's
LOUDER = 1.5  # times the usual size, from which on it is another: a median of so few scatters by a sixth
NORMAL_MEDIAN = 0.6745  # median of the absolute value of a standard normal variable
_LEFT_OUT = tuple(np.array(list(combinations(range(WINDOW), n)), dtype=int) for n in range(3))


def _tell(kind: str, keys, channel: str, left_out: bool = False, **facts) -> Fault:
    """A fault in the words of `_TEXTS`."""
    keys = tuple(keys)
    records = f"record {keys[0]}" if len(keys) == 1 else (
        f"records {join_words(keys)}" if len(keys) <= 4 else f"{len(keys)} records ({keys[0]} among them)")
    they_are, them = ("It is", "it") if len(keys) == 1 else ("They are", "them")
    facts |= {"records": records, "channel": channel, "they_are": they_are, "them": them}
    seen, done, remedy = (text.format(**facts) for text in _TEXTS[kind])
    return Fault("missing" if kind == "blind" else kind, keys, channel, seen, done, remedy, left_out)


def keep_samples(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Faults that matter to a fit, where it takes all samples as they are."""
    done = "These samples are taken as they are; `ddetumble discover` leaves them out."
    return tuple(fault if fault.kind == "truncated" else dc.replace(fault, done=done, left_out=False)
                 for fault in faults if fault.kind == "truncated" or fault.kind not in STAYING)


def count_lost(time: dict[str, np.ndarray], there: dict[str, np.ndarray]) -> tuple[dict[str, int], dict[str, int]]:
    """How many samples of a channel each record lacks, and how many it would have.

    A channel that was sampled on a clock of its own has no sample at the instants of the others, and one that in every
    record begins late, or ends early, was not meant to be longer: neither is missing.

    Args:
        time: of every record, shape (samples,); those of all channels.
        there: whether the channel has a sample then.
    """
    ends = {key: (int(np.argmax(x)), int(np.argmax(x[::-1]))) for key, x in there.items() if x.any()}
    early, late = (bool(ends) and all(end[k] > 0 for end in ends.values()) for k in (0, 1))
    lost, wanted = {}, {}
    for key, x in there.items():
        steps = np.diff(time[key][x])
        if not x.any() or len(steps) < 2 or not (steps > 0).all():
            lost[key], wanted[key] = int((~x).sum()), len(x)
            continue
        step = float(np.quantile(steps, 0.1))  # most samples may be missing, the usual step is still among the shortest
        own = step > 1.5 * float(np.quantile(np.diff(time[key]), 0.1))
        first, last = ends[key]
        inner = x[first : len(x) - last]
        gaps = int(np.sum(np.maximum(np.round(steps / step), 1) - 1)) if own else int((~inner).sum())
        outer = 0 if early else time[key][first] - time[key][0]
        outer += 0 if late else time[key][-1] - time[key][len(x) - 1 - last]
        lost[key] = gaps + int(outer / step + 0.5 * (not own))
        wanted[key] = int(x.sum()) + lost[key]
    return lost, wanted


def screen_samples(campaign: Campaign, settings: ScreeningSettings = SCREENING) -> tuple[Campaign, tuple[Fault, ...]]:
    """Find what is wrong with the samples of a campaign, and leave it out.

    Faulty samples are then missing, and copied records left out. Samples that are missing, or unevenly taken, and
    records that end too early are reported and stay as they are.
    """
    if campaign.samples is None or campaign.independent is None:
        return campaign, ()
    samples, abscissa, found = campaign.samples.copy(), campaign.independent.name, []
    rows = {str(key): part for key, part in samples.groupby("record", sort=False).indices.items()}
    time = {key: samples[abscissa].to_numpy(dtype=float)[part] for key, part in rows.items()}
    groups = dict(zip(campaign.record_keys, group_conditions(campaign.records), strict=True))
    kind = find_kind(campaign.family)
    turning, path = np.zeros(len(samples), dtype=bool), kind.path
    if path in campaign.channels:  # where a slip record turns round, its force is not known and may well be empty
        for part in rows.values():
            step = np.sign(np.diff(samples[path].to_numpy(dtype=float)[part]))
            turning[part[1:-1]] = step[1:] * step[:-1] <= 0
    # Channels whose readings carry noise of their own: all but the path of slip records and attitudes.
    screened = [c for c in campaign.channels if not c.startswith("attitude_") and c != path]
    for channel in screened:
        values = samples[channel].to_numpy(dtype=float).copy()
        there = ~np.isnan(values) | turning
        lost, wanted = count_lost({key: samples[abscissa].to_numpy(dtype=float)[part] for key, part in rows.items()},
                                  {key: there[part] for key, part in rows.items()})
        if any(lost.values()):
            found.append(_tell("missing", [key for key, number in lost.items() if number], channel,
                               share=100 * sum(lost.values()) / sum(wanted.values())))
        uncertainty = campaign.channels[channel].uncertainty
        sd = 0.0 if uncertainty is None else float(uncertainty.sd(np.nanmedian(np.abs(values))))
        if not sd > 0:
            continue
        chance, tolerance, resolution = _measure_equality([values[part] for part in rows.values()], sd)
        error = float(np.hypot(sd, resolution / np.sqrt(12.0)))
        rest = settings.rest * resolution if resolution > sd else 0.0
        largest, limits = float(np.nanmax(np.abs(values), initial=0.0)), {}
        shared = _count_stays([values[part] for part in rows.values()], tolerance) if resolution > sd else {}
        turns = channel in kind.rates or (kind.has_contact and channel == kind.main)  # smoothly, at its extremes
        clipped, held, spiked = np.zeros((3, len(values)), dtype=bool)
        for key, part in rows.items():
            x = values[part]
            # A contact may hold its force at a level of its own; the gauge's level is the largest of all.
            usable = turns and (channel in kind.rates or np.nanmax(np.abs(x), initial=0.0) >= largest - tolerance)
            cut, still, limits[key] = find_runs(x, sd, chance, len(values), tolerance, settings,
                                                error if usable else np.inf, rest, {} if turns else shared)
            x = x[np.isfinite(x)]
            if still.any() and still.sum() == len(x) and abs(abs(x[0]) - largest) <= 1e-9 * largest:
                # What stands still throughout at the largest reading of all is clipped, not held.
                cut, still, limits[key] = still, cut, [float(x[0])]
            clipped[part], held[part] = cut, still
        values[clipped | held] = np.nan
        parts = {key: values[part] for key, part in rows.items()}
        level = max(error, _measure_roughness(time, parts))
        spikes = {key: find_spikes(time[key], x, max(level, _measure_roughness(time, {key: x})), settings)
                  for key, x in parts.items()}  # the roughness of its own is of a record in another unit
        for key, mask in leave_common_spikes(time, spikes, groups, settings).items():
            spiked[rows[key]] = mask
        values[spiked] = np.nan
        for fault, mask in (("clipped", clipped), ("held", held), ("spike", spiked)):
            keys, number = [key for key, part in rows.items() if mask[part].any()], int(mask.sum())
            if not keys:
                continue
            at, one = sorted({f"{value:.4g}" for key in keys for value in limits[key]}), number == 1
            where = "each at its largest or smallest reading"
            if 0 < len(at) <= 3:
                where = f"at {join_words(at)} {campaign.channels[channel].unit}"
            found.append(_tell(fault, keys, channel, where=where, deviations=settings.spike,
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
              settings: ScreeningSettings = SCREENING, error: float = np.inf, rest: float = 0.0,
              shared: Mapping[float, int] = MappingProxyType({})) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Which readings of a record, shape (samples,), are at a limit (or around one), which stand still, and the limits.

    `sd` is that of the noise, `chance` that of two neighbours being equal, `count` how many readings of all records
    give chance an opportunity, `tolerance` what a difference has to exceed, `error` that of a reading of what is
    smooth, so that readings on either side of equal ones at an extreme tell where these should lie, `rest` below what a
    coarse gauge reads where nothing acts, for as long as that is, and `shared` how many readings of all records repeat
    the one before at a level that is the extreme of several.
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
        if len(run) < 3:
            continue
        if _breaks_off(y, run, sd, settings):
            held[there[run]] = True
            continue
        if abs(value) < rest:
            continue
        side = next((side for side in (1.0, -1.0) if side * value >= np.max(side * y) - tolerance), 0.0)
        equal = next((number for level, number in shared.items() if side and abs(level - value) <= tolerance), 0)
        if (count * chance ** max(len(run) - 1, equal) > settings.chance
                and not _would_pass(y, run, side, error, settings)):
            continue
        if side:
            at = np.abs(y - value) <= tolerance
            near = at | (side * middle > side * value - settings.near * sd)
            clipped[there[np.flatnonzero(ndimage.binary_propagation(at, mask=near))]] = True
            limits += [value] * (value not in limits)
        elif value != 0.0 or np.abs(y[np.clip([run[0] - 1, run[-1] + 1], 0, len(y) - 1)]).max() >= settings.off * sd:
            held[there[run]] = True  # a file may hold zeros where nothing acts
    return clipped, held & ~clipped, limits


def _count_stays(records: Sequence[np.ndarray], tolerance: float) -> dict[float, int]:
    """How many readings repeat the one before at the largest of all records, and at the smallest, in the longest run
    of each; none where a single record stays there."""
    found = {}
    for side in (1.0, -1.0):
        level = side * max((float(np.nanmax(side * x)) for x in records if np.isfinite(x).any()), default=0.0)
        stays = []
        for x in records:
            at = np.abs(x[np.isfinite(x)] - level) <= tolerance
            ends = np.flatnonzero(np.diff(np.r_[False, at, False]))
            stays.append(max((int(last - first) for first, last in zip(ends[::2], ends[1::2], strict=True)), default=0))
        long = [length - 1 for length in stays if length > 2]
        if len(long) > 1:
            found[level] = sum(long)
    return found


def _breaks_off(y: np.ndarray, run: np.ndarray, sd: float, settings: ScreeningSettings) -> bool:
    """Whether readings leap to equal ones and back by more than they change from one to the next anywhere else: the
    signal was gone, however coarse the gauge is."""
    if run[0] == 0 or run[-1] == len(y) - 1:
        return False
    steps = np.abs(np.diff(y))
    ends = [run[0] - 1, run[-1]]
    back = y[run[0] - 1] - y[run[0]], y[run[-1] + 1] - y[run[-1]]
    most = np.max(np.delete(steps, ends), initial=0.0)
    return bool(back[0] * back[1] > 0 and steps[ends].min() > max(settings.leap * most, settings.off * sd))


def _would_pass(y: np.ndarray, run: np.ndarray, side: float, error: float, settings: ScreeningSettings) -> bool:
    """Whether the parabola through the readings on either side of equal ones at an extreme passes them by far."""
    low, high = run[0] - BESIDE, run[-1] + BESIDE
    if low < 0 or high >= len(y) or not side or not np.isfinite(error):
        return False
    middle, size = 0.5 * (run[0] + run[-1]), 0.5 * (high - low)
    powers = np.vander((np.r_[low:run[0], run[-1] + 1:high + 1] - middle) / size, 3)
    weights = np.linalg.pinv(powers).T @ np.vander((run - middle) / size, 3).mean(axis=0)  # of the readings beside
    excess = side * (weights @ np.r_[y[low:run[0]], y[run[-1] + 1:high + 1]] - y[run[0]])
    return bool(excess > settings.beyond * error * np.hypot(1.0, np.linalg.norm(weights)))


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
        kept = f"{keys[0]} is kept, and {join_words(out)} left out." if same else (
            "It is unclear which is the original, so all of them are left out.")
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
        rough = np.median(np.abs(np.diff(force, 2))) / NORMAL_MEDIAN / 6**0.5
        sd = uncertainty.sd(peak) if uncertainty is not None else rough
        noise = settings.ended * float(sd) / settings.last**0.5
        fall = float(force[-2 * settings.last: -settings.last].mean()) - level - last
        falling = fall > max(0.1 * last, 0.5 * noise)
        if last > max(settings.pressed * peak, noise) and (falling or last > 0.5 * peak):
            shares[key] = 100 * last / peak
    if not shares:
        return ()
    ends = dict.fromkeys(f"{share:.2g}" for share in (min(shares.values()), max(shares.values())))
    return (_tell("truncated", shares, channel, end=" to ".join(ends)),)


def _measure_equality(records: list[np.ndarray], sd: float) -> tuple[float, float, float]:
    """Chance that two neighbours are equal, the difference that counts as none, and the resolution.

    The chance is that of a level in the middle of a step, the largest. The resolution is the finest step of a record's
    readings, or less where readings so coarse would have met more often: n readings spread over R in steps of q take
    L (1 - exp(-n/L)) values of the L = R/q that there are; what turns in step with the sampling has no close readings
    either.
    """
    tolerance = 1e-9 * float(np.nanmax(np.abs(np.concatenate(records)), initial=0.0))
    shares, finest = [], []
    for x in records:  # each on its own: a zero taken off every record shifts its steps
        x = x[np.isfinite(x)]
        if len(x) < 5:
            continue
        steps = np.diff(np.unique(x))
        step = float(np.min(steps[steps > tolerance], initial=np.inf))
        finest.append(step)
        inner = (x < x.max() - tolerance) & (x > x.min() + tolerance) & (x != 0.0)
        between = np.sort(x[inner])
        if len(between) >= 5:
            apart = max(float(np.sum(np.diff(between) > tolerance)) - 2.0, 1.0)  # three fewer may be by chance
            full = len(between) / apart
            share = full + float(special.lambertw(-full * np.exp(-full)).real)  # n/L
            finest[-1] = min(finest[-1], float(np.ptp(between)) * share / len(between))
        if inner[1:].sum() > 4:
            moved = np.abs(np.diff(x))[inner[1:]]
            if np.median(moved) <= step + tolerance:  # coarse indeed: at rest, whatever is stated
                moved = moved[moved <= step + tolerance]
            shares.append(float(np.mean(moved <= tolerance)))
    usual = float(np.quantile(shares, 0.25)) if shares else 0.0
    finest = [q for q in finest if np.isfinite(q)]
    resolution = float(np.quantile(finest, 0.25)) if finest else 0.0
    chance = float(special.erf(resolution / (2.0 * np.sqrt(2.0) * sd)))
    return min(max(chance, usual, 1e-9), 0.99), tolerance, resolution


def _measure_roughness(time: dict[str, np.ndarray], parts: dict[str, np.ndarray]) -> float:
    """Deviation of the noise as samples stand off the cubic through their neighbours, robustly over all records."""
    there = {key: np.isfinite(x) for key, x in parts.items()}
    off = [leave_cubic(time[key][there[key]], x[there[key]]) for key, x in parts.items() if there[key].sum() > 8]
    return float(np.median(np.abs(np.concatenate(off)))) / NORMAL_MEDIAN if off else 0.0


def _find_uneven(unit: str, abscissa: str, time: dict[str, np.ndarray], settings: ScreeningSettings) -> list[Fault]:
    uneven = {}
    for key, t in time.items():
        steps = np.diff(t)
        if len(steps) and np.mean(np.abs(steps / np.median(steps) - 1.0) > settings.uneven) > settings.often:
            uneven[key] = steps
    if not uneven:
        return []
    steps = np.concatenate(list(uneven.values()))
    low, high = float(steps.min()), float(steps.max())
    shown, factor = ("mm", 1e3) if unit == "m" and high < 1.0 else (unit, 1.0)
    if unit == "s":
        shown, factor = choose_time_unit(high)
    return [_tell("uneven", uneven, abscissa, low=factor * low, high=factor * high, unit=shown)]


def find_spikes(time: np.ndarray, x: np.ndarray, sd: float, settings: ScreeningSettings = SCREENING) -> np.ndarray:
    """Readings that stand off their neighbours, one or two by themselves, shape (samples,).

    Where a sample is far from the cubic through its neighbours, the nine around it are looked at: they are spikes, the
    fewest of at most two without which the others lie on a cubic within their noise, if they are off it by 7
    deviations, others lie on both sides, and a cubic with a step and a kink does not go through all nine. Where the
    nine are not so simple, a spike is what is outside of its neighbours' range, and off the lines through the two on
    each side (a ramp that ends in a jump goes on along one of them), by as much. Where the noise is louder for a
    while, as that of a force gauge in proportion to its reading, its own size there counts instead of `sd`.
    """
    found = np.zeros(len(x), dtype=bool)
    there = np.flatnonzero(np.isfinite(x))
    if len(there) < WINDOW:
        return found
    t, y = time[there], x[there]
    rough = np.abs(leave_cubic(t, y))
    local = ndimage.median_filter(rough, LOCAL, mode="reflect") / NORMAL_MEDIAN
    local = np.pad(np.where(local > LOUDER * sd, local, sd), 2, mode="edge")
    off = np.pad(rough > 0.5 * settings.spike * local[2:-2], 2)
    near = np.convolve(off, np.ones(5), mode="same") > 0
    outside = _stand_outside(t, y, local, settings)
    for k in np.flatnonzero(near[1:-1]) + 1:
        first = int(np.clip(k - WINDOW // 2, 0, len(y) - WINDOW))
        part = slice(first, first + WINDOW)
        spikes = _leave_window(t[part], y[part], float(local[k]), settings)
        found[there[k]] = outside[k] if spikes is None else k - first in spikes
    return found & (found.mean() <= settings.many)  # more are no accidents


def leave_common_spikes(time: dict[str, np.ndarray], spikes: dict[str, np.ndarray],
                        groups: Mapping[str, Hashable], settings: ScreeningSettings) -> dict[str, np.ndarray]:
    """Spikes without those that come at one time in more records than chance would have it: these are the experiment's.

    All arguments are by record: times, which samples are spikes, and conditions; repeats have the same.
    """
    found, count = {key: own.copy() for key, own in spikes.items()}, sum(map(len, time.values()))
    total = sum(int(own.sum()) for own in spikes.values())
    for key, own in spikes.items():
        for k in np.flatnonzero(own):
            near = settings.common * float(np.median(np.diff(time[key])))
            others = {other: np.abs(t - time[key][k]) <= near for other, t in time.items() if other != key}
            repeats = {other: window for other, window in others.items() if groups[other] == groups[key]}
            for windows in (others, repeats):
                hits = sum(int(spikes[other][window].any()) for other, window in windows.items())
                samples = sum(int(window.sum()) for window in windows.values())
                rate = max(total - hits - 1, 0.5) / count
                if hits and total * special.bdtrc(hits - 1, samples, rate) < settings.recurs:
                    found[key][k] = False
    return found


def _leave_window(time: np.ndarray, y: np.ndarray, sd: float, settings: ScreeningSettings) -> tuple[int, ...] | None:
    """Places within a window that are off a cubic on which all others lie; None where there is no such cubic."""
    t, limit = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0, settings.smooth**2 * sd**2
    basis = np.stack([np.ones_like(t), t, t * t, t**3], axis=1)
    for k in range(2, len(t) - 1):  # a step, and a kink where three samples on either side show it
        edge = 0.5 * (t[k - 1] + t[k])
        broken = [t > edge, np.maximum(t - edge, 0.0)] if 3 <= k <= len(t) - 3 else [t > edge]
        moving = np.concatenate([basis, np.stack(broken, axis=1)], axis=1)
        rest = y - moving @ np.linalg.lstsq(moving, y)[0]
        if rest @ rest <= (len(y) - moving.shape[1]) * limit:
            return ()
    for out in _LEFT_OUT:
        kept = np.ones((len(out), len(y)))
        np.put_along_axis(kept, out, 0.0, axis=1)
        inverse = np.linalg.inv(np.einsum("ck,ki,kj->cij", kept, basis, basis))
        rest = y - np.einsum("ki,cij,cj->ck", basis, inverse, (kept * y) @ basis)
        misfit = np.sum(kept * rest**2, axis=1) / (len(y) - 4.0 - out.shape[1])
        fine = np.flatnonzero(misfit <= limit)
        if not len(fine):
            continue
        # Where several would do, what all of them leave out.
        sure = set(range(1, len(y) - 1)).intersection(*out[fine].tolist())
        best = int(fine[np.argmin(misfit[fine])])
        wide = sd * np.sqrt(1.0 + np.einsum("ki,ij,kj->k", basis, inverse[best], basis))
        return tuple(k for k in sure if abs(rest[best][k]) > settings.spike * wide[k])
    return None


def _stand_outside(time: np.ndarray, y: np.ndarray, sd: np.ndarray, settings: ScreeningSettings) -> np.ndarray:
    """Readings off the cubic, the range and the lines of two neighbours on each side, shape (samples,); see above."""
    off, middle, limit = np.abs(leave_cubic(time, y)), y[2:-2], settings.spike * sd[2:-2]
    around = np.stack([y[:-4], y[1:-3], y[3:-1], y[4:]])
    lines = np.abs([middle - 2.0 * y[1:-3] + y[:-4], middle - 2.0 * y[3:-1] + y[4:]])
    outside = np.min([np.maximum(middle - around.max(axis=0), around.min(axis=0) - middle), *lines], axis=0)
    bad = (off > limit) & (outside > limit)
    # What stands off beside a larger one stands off because of it.
    beside = np.pad(np.where(bad, off, 0.0), 2)
    return np.pad(bad & (beside[2:-2] >= np.max([beside[k:k + len(bad)] for k in (0, 1, 3, 4)], axis=0)), 2)


def leave_cubic(time: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Each sample but two at either end less the cubic through its four neighbours, in deviations of one sample."""
    at, y = (np.stack([z[k:len(z) - 4 + k] for k in (0, 1, 3, 4)]) for z in (time, x))
    t = time[2:-2]
    weights = np.stack([np.prod([(t - at[j]) / (at[i] - at[j]) for j in range(4) if j != i], axis=0) for i in range(4)])
    return (x[2:-2] - np.sum(weights * y, axis=0)) / np.sqrt(1.0 + np.sum(weights**2, axis=0))
