"""Data errors: what would make a record fit (a unit, a setting, the clock, a gain, a baseline, a few samples), and
baselines that move in every record.

A zero that is the same in all records, or follows their conditions, may be physics (a bias of the gyroscopes, an
adhesive force) and is left to the catalogue. One that is off by another amount in every record is a fault of the gauge.
"""

import dataclasses as dc
from collections.abc import Iterator, Mapping

import numpy as np

from .._errors import ComputationError
from ..dynamics.spinning import RATES
from ..families import find_family, name_family
from ..families.starts import fill_gaps, integrate_couple
from ..inference import distributions as stats
from ..inference.problem import Solution, replace_arrays, settle
from ..inference.stack import DRIFT
from ..measurement.campaign import Campaign
from ..measurement.faults import Fault
from ..measurement.units import format_time, si_unit
from .leave_record_out import Aside, Misfit, measure_record, whiten_baseline
from .problem import SelectionProblem
from .settings import DEFAULT, OutlierSettings


DECIMAL = {"1000": 1e3, "100": 100.0, "10": 10.0, "1e6": 1e6}
# Ratios of the units in which a quantity is written, by its SI unit.
RATIOS = {
    "N": {"9.80665 (kgf and N)": 9.80665, "4.448 (lbf and N)": 4.4482216},
    "rad/s": {"57.3 (degrees and radians)": 57.29578, "9.549 (turns per minute and rad/s)": 9.5492966,
              "60 (minutes and seconds)": 60.0},
    "Pa": {"6.895 (psi and kPa)": 6.894757, "14.5 (psi and bar)": 14.503774, "145 (psi and MPa)": 145.03774},
    "m": {"25.4 (inches and mm)": 25.4},
    "m/s": {"60 (minutes and seconds)": 60.0, "3.6 (km/h and m/s)": 3.6, "3.281 (feet and metres)": 3.2808399},
}
AMBIENT = 101_325.0  # Pa, the standard atmosphere: the day's differs by 3 %, which is less than what is looked for
FEWEST = 3  # other records whose rates show the moments: of two nobody can say which is right
SHORTEST = 16  # samples from which the derivative of rates is known: fewer give their noise
PAIRS = 2_000_000  # of samples whose covariances are computed at once: 16 MB
WARM = "Let the gauge warm up, and zero it before each test."


@dc.dataclass(frozen=True)
class Diagnosis:
    """What would make a record fit; kind and channel are those of `Fault`."""

    kind: str
    channel: str
    text: str  # a sentence on it
    remedy: str  # a sentence on what to do
    samples: np.ndarray | None = None  # without which it fits, shape (channels, samples); None where it takes others
    gain: float = 1.0  # how many times the true value it reads


def diagnose(selection: SelectionProblem, aside: Aside) -> Diagnosis:
    """Try what goes wrong in a laboratory, the plainest first, until the record fits."""
    tried = (_try_samples, _try_channel_units, _try_condition_units, _try_columns, _try_conditions)
    if selection.records.are_values:  # another zero or gain makes any single number fit
        tried = (_try_channel_units, _try_condition_units, _try_conditions)
    for hypotheses in tried:
        fitting = [(misfit.total, told) for misfit, told in hypotheses(selection, aside)
                   if misfit is not None and _fits(selection, misfit, aside)]
        if fitting:
            return min(fitting, key=lambda one: one[0])[1]
    return Diagnosis("outlier", "", "No other unit, setting, clock, gain or zero makes it fit the model.",
                     "Check the notes on that test, and repeat it.")


def _fits(selection: SelectionProblem, misfit: Misfit, aside: Aside) -> bool:
    """Whether a change has made the record as good as the others."""
    others = max(max(m.excess for m in aside.others.values()), 0.0)
    limits = selection.settings.outliers
    return misfit.p_value > limits.fits or misfit.excess < min(max(limits.small, others), 0.02 * aside.own.excess)


def _hold(selection: SelectionProblem, aside: Aside, **arrays) -> tuple[Misfit | None, Solution | None]:
    """Misfit of the record with other arrays in the stack, and the solution there; None where that failed."""
    try:
        at = settle(replace_arrays(selection.problem, **arrays), aside.solution.names, aside.solution.u,
                    aside.stated.z.copy())
    except ComputationError:
        return None, None
    if selection.records.keys[aside.record] in at.failed:
        return None, None
    return measure_record(selection, at, aside.record, aside.spread), at


Hypotheses = Iterator[tuple[Misfit | None, Diagnosis]]


def _try_samples(selection: SelectionProblem, aside: Aside) -> Hypotheses:
    """A few samples that are off by themselves, such as two spikes side by side."""
    r, stack, limits = aside.record, selection.records.stack, selection.settings.outliers
    values, model = np.asarray(stack.values).copy(), aside.solution.channels[r]
    sd = np.array([selection.noise[c].sd for c in selection.records.channels])[:, None]
    far = (np.abs(values[r] - model) > limits.wide * sd) & (np.asarray(stack.weights)[r] > 0)
    number, length = int(far.sum()), selection.records.lengths[r]
    if 0 < number <= limits.few * length:
        values[r] = np.where(far, model, values[r])
        what = f"{number} of its samples, which are" if number > 1 else "one of its samples, which is"
        yield _hold(selection, aside, values=values)[0], Diagnosis(
            "spike", selection.records.channels[int(np.argmax(far.sum(axis=1)))],
            f"It fits without {what} far off the model.",
            "Look for interference or a loose contact.", far[:, :length])


def _list_factors(unit: str, decimal: Mapping[str, float] = DECIMAL) -> Iterator[tuple[str, float]]:
    """Factors by which a quantity in a mistaken unit is off, and what corrects it in words."""
    for label, ratio in (RATIOS.get(unit, {}) | dict(decimal)).items():
        yield f"divided by {label}: a mistaken unit", ratio
        yield f"multiplied by {label}: a mistaken unit", 1.0 / ratio


def _try_channel_units(selection: SelectionProblem, aside: Aside) -> Hypotheses:
    """A channel, or all that share a unit, in another unit."""
    r, records, stack = aside.record, selection.records, selection.records.stack
    free_running = selection.family.free_running
    units = [selection.campaign.channels[c].unit for c in records.channels]
    sets = [[c] for c in range(len(units))]
    together = [c for c, unit in enumerate(units) if unit == units[0]]
    if free_running and len(together) > 1:
        sets.insert(0, together)
    for chosen in sets:
        guess = _guess_gain(selection, aside, chosen)
        for words, factor in _list_factors(units[chosen[0]]):
            if not guess or abs(np.log(guess / factor)) > selection.settings.outliers.close:
                continue
            values, weights, conditions = (*(np.asarray(x).copy() for x in (stack.values, stack.weights)),
                                           dict(stack.conditions))
            values[r, chosen] /= factor  # with its noise, which then is as stated
            for c in chosen:
                if records.keys[r] in selection.noise[records.channels[c]].sizes:  # or was measured in that unit
                    weights[r, c] *= factor
            for name in [records.starts[k] for k in chosen if k < len(records.starts) and free_running]:
                conditions[name] = conditions[name].at[r].divide(factor)
            what = " and ".join(records.channels[c] for c in chosen)
            yield _hold(selection, aside, values=values, weights=weights, conditions=conditions)[0], Diagnosis(
                "unit", records.channels[chosen[0]],
                f"It fits once its {what} {'is' if len(chosen) == 1 else 'are'} {words}.",
                "Correct the unit of that record.")


def _guess_gain(selection: SelectionProblem, aside: Aside, chosen: list[int]) -> float:
    """How many times as large a record's channels are as its model; 0 where that says nothing."""
    r, stack, lengths = aside.record, selection.records.stack, selection.records.lengths
    values, n = np.asarray(stack.values), lengths[r]
    used = np.asarray(stack.weights)[r, chosen, :n] > 0
    measured = np.where(used, values[r, chosen, :n], 0.0)
    if selection.family.free_running:
        # Its starts follow the readings, so that its own model says nothing: the usual size of the others does.
        size = [float(np.sqrt(np.mean(values[k, chosen, : lengths[k]] ** 2))) for k in aside.others]
        return float(np.sqrt(np.mean(measured**2))) / max(float(np.median(size)), 1e-300) if size else 0.0
    model = np.where(used, aside.stated.channels[r, chosen, :n], 0.0)
    top = np.sqrt(np.sum(model**2))
    return float(np.sqrt(np.sum(measured**2)) / top) if top > 0 else 0.0


def _try_condition_units(selection: SelectionProblem, aside: Aside) -> Hypotheses:
    """A condition in another unit, or a gauge pressure taken for an absolute one."""
    r, stack, campaign = aside.record, selection.records.stack, selection.campaign
    for name in (str(c) for c in campaign.records.columns if c != "sequence"):
        own = campaign.records[name].to_numpy(dtype=float)
        others = own[list(aside.others)]
        trials = [(f"is {words}", own[r] / factor) for words, factor in _list_factors(campaign.conditions[name].unit)]
        if name.endswith("pressure"):
            trials += [("is taken as absolute, not as a gauge pressure", own[r] + AMBIENT),
                       ("is taken as a gauge pressure, not as absolute", own[r] - AMBIENT)]
        for words, value in trials:
            if not 0.5 * others.min() <= value <= 2.0 * others.max():
                continue
            sd = np.asarray(stack.condition_sd).copy()
            if name in selection.records.nuisances:
                sd[r, selection.records.nuisances.index(name)] *= abs(value / own[r])
            conditions = {**stack.conditions, name: stack.conditions[name].at[r].set(value)}
            yield _hold(selection, aside, conditions=conditions, condition_sd=sd)[0], Diagnosis(
                "unit", name, f"It fits once its {name} {words}.", f"Correct the {name} of that record.")


def _try_columns(selection: SelectionProblem, aside: Aside) -> Hypotheses:
    """A zero that moves, or a gain that is off: the record is linear in both."""
    r, records, problem = aside.record, selection.records, selection.problem
    for c, channel in enumerate(records.channels):
        if f"{DRIFT}:{channel}" in records.nuisances:
            continue
        columns, unit = whiten_baseline(problem, r, c), selection.campaign.channels[channel].unit
        start, drift = _solve_columns(aside, columns)
        yield measure_record(selection, aside.stated, r, aside.spread, columns), Diagnosis(
            "zero", channel, f"It fits if the zero of its {channel} is off by {start:.3g} {unit} at the start and "
            f"{start + drift:.3g} {unit} at the end.", WARM)
        if selection.family.free_running and c >= len(records.starts):
            continue
        columns = records.whiten(r, c, aside.stated.channels[r, c, : records.lengths[r], None])
        gain, = 1.0 + _solve_columns(aside, columns)
        misfit = measure_record(selection, aside.stated, r, aside.spread, columns)
        if gain > 1.0 and not _fits(selection, misfit, aside):
            # An amplifier multiplies the noise, too.
            values = np.asarray(records.stack.values).copy()
            values[r, c] /= gain
            misfit = _hold(selection, aside, values=values)[0]
        yield misfit, Diagnosis("gain", channel, f"It fits if its {channel} reads {gain:.4g} times the true value.",
                                "Check the range and the calibration of the gauge in that test, and repeat it.",
                                gain=gain)


def _solve_columns(aside: Aside, columns: np.ndarray) -> np.ndarray:
    """How much of every further column the record takes, its own nuisances moving along."""
    own = aside.stated.own[aside.record]
    rows = np.block([[columns, own], [np.zeros((own.shape[1], columns.shape[1])), np.eye(own.shape[1])]])
    right = np.concatenate([aside.stated.residual[aside.record], aside.stated.z[aside.record]])
    return np.linalg.lstsq(rows, -right, rcond=None)[0][: columns.shape[1]]


def _try_conditions(selection: SelectionProblem, aside: Aside) -> Hypotheses:
    """A condition, or the clock, that is not what is written down."""
    r, records, stack = aside.record, selection.records, selection.records.stack
    time = np.asarray(stack.time)[r, : records.lengths[r]]
    for k, name in enumerate(records.nuisances):
        if name in records.starts or ":" in name or (name == "time" and selection.family.free_running):
            continue
        sd = np.asarray(stack.condition_sd).copy()
        sd[r, k] = 0.1 * np.ptp(time) if name == "time" else 0.3 * abs(float(np.asarray(stack.conditions[name])[r]))
        misfit, at = _hold(selection, aside, condition_sd=sd)
        if at is None:
            continue
        change = float(at.z[r, k] * sd[r, k])
        if name == "time":
            independent = selection.campaign.independent
            shown = "clock" if independent is None or independent.name == "time" else independent.name
            off = format_time(change, float(time.max())) if shown == "clock" else f"{1e3 * change:.3g} mm"
            yield misfit, Diagnosis("clock", name, f"It fits if its {shown} is off by {off}.",
                                    "Check the trigger, or determine the onset of that record again.")
        else:
            value = float(selection.campaign.records[name].iloc[r])
            exact = selection.campaign.conditions[name].uncertainty is None
            yield misfit, Diagnosis(
                "setting", name, f"It fits if its {name} was {value + change:.4g} {si_unit(name)}, not {value:.4g}.",
                "Check what was set in that test" + exact * (
                    ", or state how uncertain that is (`ddetumble import --uncertainty`): without it a small error "
                    "counts in full") + ".")


def find_rate_units(campaign: Campaign, settings: OutlierSettings = DEFAULT.outliers) -> tuple[Fault, ...]:
    """Records whose rates obey Euler's equations with the moments that all others show only in another unit."""
    family = find_family(name_family(campaign))
    if not family.free_running or campaign.samples is None or any(r not in campaign.channels for r in RATES):
        return ()
    slopes = {}
    for key, part in campaign.samples.groupby("record", sort=False):
        time, rates = part["time"].to_numpy(dtype=float), part[list(RATES)].to_numpy(dtype=float)
        if len(time) < SHORTEST or not np.isfinite(rates).any(axis=0).all():
            continue
        change, cause = integrate_couple(time, fill_gaps(time, rates))
        below = float(np.sum(cause**2))
        slope = float(np.sum(change * cause)) / below if below > 0 else 0.0
        if np.sum((change - slope * cause) ** 2) < settings.kinematic_noise * np.sum(change**2):
            slopes[str(key)] = slope
    faults = []
    for key in slopes:
        others = np.array([slope for other, slope in slopes.items() if other != key])
        middle = float(np.median(others)) if len(others) else 0.0
        if len(others) < FEWEST or not np.all(others) or (
                np.median(np.abs(others / middle - 1.0)) > settings.kinematic_spread):
            continue
        words = [words for words, factor in _list_factors("rad/s", {"1000": DECIMAL["1000"]})
                 if abs(slopes[key] * factor / middle - 1.0) < settings.kinematic_slack]
        if words:
            faults.append(Fault(
                "unit", (key,), RATES[0], f"The rates of record {key} obey Euler's equations with the moments that "
                f"all others show only if they are {words[0]}.", "It is left out.",
                "Correct the unit of that record.", left_out=True))
    return tuple(faults)


@dc.dataclass(frozen=True)
class MovingZero:
    """A channel whose zero moves."""

    channel: str
    offset: float  # largest over its records, SI; so is the drift
    drift: float
    # Standard deviations of both over the records, SI: their prior in a fit, so that a trend over conditions is left to
    # physics.
    spread: tuple[float, float]
    share: float  # of the model's misfit that is removed


def find_moving_zeros(selection: SelectionProblem, solution: Solution, final: bool) -> MovingZero | None:
    """The channel whose zeros, free in every record, remove most of a model's misfit; None where none does.

    `final` says whether the catalogue has been tried. Before that only zeros are looked for that show before first
    touch: an effect may look like another zero at every condition.
    """
    records, contact = selection.records, selection.family.has_contact
    if records.are_values or records.count < selection.settings.baseline.fewest or not (contact or final):
        return None
    found = [_free_zeros(selection, solution, c) for c, channel in enumerate(records.channels)
             if f"{DRIFT}:{channel}" not in records.nuisances and not channel.startswith("attitude_")
             and (not contact or _moves_before_touch(selection, c))]
    return max((zero for zero in found if zero is not None), key=lambda zero: zero.share, default=None)


def tell_zero(selection: SelectionProblem, zero: MovingZero, keep: bool) -> Fault:
    """A moving zero in words."""
    unit = selection.campaign.channels[zero.channel].unit
    seen = (f"The zero of {zero.channel} differs between records: it is off by up to {zero.offset:.2g} {unit} at the "
            f"start, and drifts by up to {zero.drift:.2g} {unit} more until the end.")
    done = "Nothing is done about it, as asked." if keep else "Zero and drift of each record are fitted too."
    return Fault("zero", selection.records.keys, zero.channel, seen, done, WARM)


def _free_zeros(selection: SelectionProblem, solution: Solution, c: int) -> MovingZero | None:
    """Fit zero and drift of every record along with everything else, to first order."""
    records, count, limits = selection.records, selection.records.count, selection.settings.baseline
    seen = selection.family.has_contact
    gain, found, error = solution.fit_more(np.stack([whiten_baseline(selection.problem, r, c) for r in range(count)]))
    before = float(np.sum(solution.residual**2) + np.sum(solution.z**2))
    excess = before - (selection.samples - solution.shared.shape[2])
    if excess <= 0 or stats.chi2.sf(gain, 2 * count) > limits.p_value or gain < (
            limits.removed if seen else limits.removed_unseen) * excess:
        return None
    if np.mean(np.any(np.abs(found) > limits.significant * error, axis=1)) < 0.5:
        return None  # a few records: they are looked at one by one
    for x, usual in zip(found.T, np.median(error, axis=0), strict=True):
        scatter = float(np.std(x, ddof=1))
        if abs(x.mean()) > limits.common * max(scatter, float(usual)) / np.sqrt(count):
            return None
        if not seen and scatter > limits.significant * usual and _explained(selection, solution, x) > limits.explained:
            return None
    offset, drift = np.abs(found).max(axis=0)
    across, along = np.sqrt(np.mean(found**2, axis=0))
    return MovingZero(records.channels[c], float(offset), float(drift), (float(across), float(along)),
                      min(gain / excess, 1.0))


def _explained(selection: SelectionProblem, solution: Solution, x: np.ndarray) -> float:
    """Share of the scatter that conditions explain (a quadratic of their logarithms, or else a plane; of tumbling
    records a plane over speed and axial rate), adjusted for its freedom; 1 where there are too few records to say."""
    records = selection.campaign.records
    table = [records[c].to_numpy(dtype=float) for c in records.columns]
    if selection.family.free_running:
        table += [solution.state_rate.max(axis=1), solution.channels[:, 2].mean(axis=1)]
    varied = [np.log(v) if v.min() > 0 else v for v in table if np.ptp(v) > 0]
    varied = [(v - v.mean()) / v.std() for v in varied]
    plane = np.stack([np.ones(len(x)), *varied], axis=1)
    products = [a * b for i, a in enumerate(varied) for b in varied[: i + 1]]
    bent = np.column_stack([plane, *products])
    columns = bent if len(x) >= bent.shape[1] + 4 else plane
    if len(x) < columns.shape[1] + 2:
        return 1.0
    left = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
    return 1.0 - np.sum(left**2) / (len(x) - columns.shape[1]) / np.var(x, ddof=1)


def _moves_before_touch(selection: SelectionProblem, c: int) -> bool:
    """Whether a channel of impacts is off before first touch, where nothing acts yet, beyond chance in all records."""
    records, channel, limits = selection.records, selection.records.channels[c], selection.settings.baseline
    if channel == "pressure":
        return False
    noise, stack, total, count = selection.noise[channel], records.stack, 0.0, 0
    time, values, weights = (np.asarray(x) for x in (stack.time, stack.values, stack.weights))
    origin = np.asarray(stack.condition_sd)[:, records.nuisances.index("time")]
    clock = selection.campaign.independent
    if clock is not None and clock.common is not None:
        origin = np.hypot(origin, clock.common.absolute or 0.0)
    for r, n in enumerate(records.lengths):
        calm = (time[r, :n] < -3.0 * origin[r]) & (weights[r, c, :n] > 0)
        if calm.sum() < limits.samples:
            continue
        t = time[r, :n][calm]
        parts = np.array_split(t, -(-len(t) ** 2 // PAIRS))
        variance = sum(float(np.sum(noise.covariance(part[:, None] - t))) for part in parts)
        total += float(np.sum(values[r, c, :n][calm])) ** 2 / variance
        count += 1
    return count >= limits.fewest and bool(stats.chi2.sf(total, count) < limits.p_value)
