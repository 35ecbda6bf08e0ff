"""Data errors that would make a record fit: a unit, a setting, the clock, a gain, a baseline, a few samples."""

import dataclasses as dc

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import ComputationError
from ..dynamics.spinning import RATES
from ..families import find_family, name_family
from ..families.starts import fill_gaps, integrate_couple
from ..inference.stack import DRIFT, Stack
from ..measurement.campaign import Campaign
from ..measurement.faults import Fault
from ..measurement.units import format_time, si_unit
from .leave_record_out import Aside, Misfit, measure_record, replace_stack, settle, whiten_columns
from .problem import SelectionProblem
from .settings import DEFAULT, OutlierSettings


RATIOS = {
    "1000": 1e3, "100": 100.0, "10": 10.0, "1e6": 1e6, "9.80665 (kgf and N)": 9.80665, "4.448 (lbf and N)": 4.4482216,
    "57.3 (degrees and radians)": 57.29578, "9.549 (turns a minute and rad/s)": 9.5492966,
    "60 (minutes and seconds)": 60.0, "25.4 (inches and mm)": 25.4, "6.895 (psi and kPa)": 6.894757,
    "14.5 (psi and bar)": 14.503774, "145 (psi and MPa)": 145.03774, "3.6 (km/h and m/s)": 3.6,
    "3.281 (feet and metres)": 3.2808399,
}
DECIMAL = ("1000", "100", "10", "1e6")
USUAL = {"N": ("9.", "4."), "rad/s": ("57", "9.5", "60"), "Pa": ("6.", "14"), "m": ("25",), "m/s": ("60", "3.")}
AMBIENT = 101_325.0


@dc.dataclass(frozen=True)
class Diagnosis:
    """What would make a record fit.

    Attributes:
        kind, channel: as in `Fault`.
        text: a sentence on it; `remedy`: on what to do.
        samples: those without which the record fits, shape (channels, samples); None where it takes something else.
    """

    kind: str
    channel: str
    text: str
    remedy: str
    samples: np.ndarray | None = None


def diagnose(selection: SelectionProblem, aside: Aside) -> Diagnosis:
    """Try what goes wrong in a laboratory, the plainest first, until the record fits."""
    for find in (_try_samples, _try_channel_units, _try_condition_units, _try_columns, _try_conditions):
        found = find(selection, aside)
        if found is not None:
            return found
    return Diagnosis("outlier", "", "No other unit, setting, clock, gain or zero makes it fit.",
                     "Look up what was noted on that test, and repeat it.")


def _fits(selection: SelectionProblem, misfit: Misfit, aside: Aside) -> bool:
    """Whether a change has made the record as good as the others."""
    others = max(max(m.excess for m in aside.others.values()), 0.0)
    limits = selection.settings.outliers
    return misfit.p_value > limits.fits or misfit.excess < min(max(limits.small, others), 0.02 * aside.own.excess)


def _hold(selection: SelectionProblem, aside: Aside, stack: Stack) -> Misfit | None:
    """Misfit of the record with other numbers."""
    problem = replace_stack(selection.problem, stack)
    try:
        at = settle(problem, aside.solution.names, aside.solution.u, aside.stated.z.copy())
    except ComputationError:
        return None
    if selection.records.keys[aside.record] in at.failed:
        return None
    return measure_record(selection, problem, at, aside.record, aside.spread)


def _try_samples(selection: SelectionProblem, aside: Aside) -> Diagnosis | None:
    """A few samples that are off by themselves, such as two spikes side by side."""
    r, stack = aside.record, selection.records.stack
    values, model = np.asarray(stack.values).copy(), aside.solution.channels[r]
    sd = np.array([selection.noise[c].sd for c in selection.records.channels])[:, None]
    far = (np.abs(values[r] - model) > selection.settings.outliers.wide * sd) & (np.asarray(stack.weights)[r] > 0)
    if not 0 < far.sum() <= selection.settings.outliers.few * selection.records.lengths[r]:
        return None
    values[r] = np.where(far, model, values[r])
    misfit = _hold(selection, aside, eqx.tree_at(lambda s: s.values, stack, jnp.asarray(values)))
    if misfit is None or not _fits(selection, misfit, aside):
        return None
    channel = selection.records.channels[int(np.argmax(far.sum(axis=1)))]
    number = int(far.sum())
    return Diagnosis("spike", channel, f"It fits without {number} of its samples, which stand far off."
                     if number > 1 else "It fits without one of its samples, which stands far off.",
                     "Look for interference or a loose contact.", far[:, : selection.records.lengths[r]])


def _try_channel_units(selection: SelectionProblem, aside: Aside) -> Diagnosis | None:
    """A channel, or all that share a unit, in another unit."""
    r, records = aside.record, selection.records
    stack, campaign = records.stack, selection.campaign
    values = np.asarray(stack.values)
    units = [campaign.channels[c].unit for c in records.channels]
    sets = [[c] for c in range(len(units))]
    together = [c for c, unit in enumerate(units) if unit == units[0]]
    if selection.family.free_running and len(together) > 1:
        sets.insert(0, together)
    best: tuple[float, Diagnosis] | None = None
    for chosen in sets:
        guess = _guess_gain(selection, aside, chosen)
        for label, ratio in _list_ratios(units[chosen[0]]).items():
            for factor in (ratio, 1.0 / ratio):
                if not guess or abs(np.log(guess / factor)) > selection.settings.outliers.close:
                    continue
                new = values.copy()
                new[r, chosen] /= factor  # with its noise, which then is as stated
                conditions = dict(stack.conditions)
                for k in chosen:
                    if k < len(records.starts) and selection.family.free_running:
                        name = records.starts[k]
                        conditions[name] = conditions[name].at[r].divide(factor)
                changed = eqx.tree_at(lambda s: (s.values, s.conditions), stack, (jnp.asarray(new), conditions))
                misfit = _hold(selection, aside, changed)
                if misfit is not None and _fits(selection, misfit, aside) and (best is None or misfit.total < best[0]):
                    what = "its " + " and ".join(records.channels[c] for c in chosen)
                    best = misfit.total, Diagnosis(
                        "unit", records.channels[chosen[0]],
                        f"It fits once {what} {'is' if len(chosen) == 1 else 'are'} "
                        f"{'divided' if factor > 1 else 'multiplied'} by {label}: a mistaken unit.",
                        "Correct the unit of that record.")
    return None if best is None else best[1]


def _list_ratios(unit: str) -> dict[str, float]:
    """Ratios of the units in which such a quantity is written, by their names."""
    wanted = USUAL.get(unit, ())
    return {name: x for name, x in RATIOS.items() if name in DECIMAL or name.startswith(wanted)} if wanted else {
        name: RATIOS[name] for name in DECIMAL}


def _guess_gain(selection: SelectionProblem, aside: Aside, chosen: list[int]) -> float:
    """How many times as large a record's channels are as its model; 0 where that says nothing."""
    r, n = aside.record, selection.records.lengths[aside.record]
    stack = selection.records.stack
    used = np.asarray(stack.weights)[r, chosen, :n] > 0
    measured = np.where(used, np.asarray(stack.values)[r, chosen, :n], 0.0)
    if selection.family.free_running:
        # Its starts follow the readings, so that its own model says nothing: the usual size of the others does.
        size = [float(np.sqrt(np.mean(np.asarray(stack.values)[k, chosen, : selection.records.lengths[k]] ** 2)))
                for k in aside.others]
        return float(np.sqrt(np.mean(measured**2))) / max(float(np.median(size)), 1e-300) if size else 0.0
    model = np.where(used, aside.stated.channels[r, chosen, :n], 0.0)
    top = np.sqrt(np.sum(model**2))
    return float(np.sqrt(np.sum(measured**2)) / top) if top > 0 else 0.0


def _try_condition_units(selection: SelectionProblem, aside: Aside) -> Diagnosis | None:
    """A condition in another unit, or a gauge pressure taken for an absolute one."""
    r, stack, campaign = aside.record, selection.records.stack, selection.campaign
    best: tuple[float, Diagnosis] | None = None
    for name in (str(c) for c in campaign.records.columns if c != "sequence"):
        own = campaign.records[name].to_numpy(dtype=float)
        others = own[list(aside.others)]
        trials = [(f"is {'divided' if factor > 1 else 'multiplied'} by {label}: a mistaken unit", own[r] / factor)
                  for label, ratio in _list_ratios(campaign.conditions[name].unit).items()
                  for factor in (ratio, 1.0 / ratio)]
        if name.endswith("pressure"):
            trials += [("counts from the vacuum, not from the ambient", own[r] + AMBIENT),
                       ("counts from the ambient, not from the vacuum", own[r] - AMBIENT)]
        for words, value in trials:
            if not 0.5 * others.min() <= value <= 2.0 * others.max():
                continue
            conditions = {**stack.conditions, name: stack.conditions[name].at[r].set(value)}
            changed = eqx.tree_at(lambda s: s.conditions, stack, conditions)
            place = selection.records.nuisances.index(name) if name in selection.records.nuisances else None
            if place is not None:
                sd = np.asarray(stack.condition_sd).copy()
                sd[r, place] *= abs(value / own[r])
                changed = eqx.tree_at(lambda s: s.condition_sd, changed, jnp.asarray(sd))
            misfit = _hold(selection, aside, changed)
            if misfit is not None and _fits(selection, misfit, aside) and (best is None or misfit.total < best[0]):
                best = misfit.total, Diagnosis("unit", name, f"It fits once its {name} {words}.",
                                               f"Correct the {name} of that record.")
    return None if best is None else best[1]


def _try_columns(selection: SelectionProblem, aside: Aside) -> Diagnosis | None:
    """A zero that moves, or a gain that is off: the record is linear in both."""
    r, records = aside.record, selection.records
    n, best = records.lengths[r], None
    t = np.asarray(records.stack.time)[r, :n]
    ramp = (t - t[0]) / (t[-1] - t[0])
    for c, channel in enumerate(records.channels):
        if f"{DRIFT}:{channel}" in records.nuisances:
            continue
        zero = whiten_columns(selection.problem, r, c, np.stack([np.ones(n), ramp], axis=1))
        gain = whiten_columns(selection.problem, r, c, aside.stated.channels[r, c, :n, None])
        for kind, columns in (("zero", zero), ("gain", gain)):
            if kind == "gain" and selection.family.free_running and not c < len(records.starts):
                continue
            misfit = measure_record(selection, selection.problem, aside.stated, r, aside.spread, columns)
            move = _solve_columns(aside, columns)
            if kind == "gain" and move[0] > 0.0 and not _fits(selection, misfit, aside):
                # An amplifier multiplies the noise, too.
                values = np.asarray(records.stack.values).copy()
                values[r, c] /= 1.0 + move[0]
                misfit = _hold(selection, aside, eqx.tree_at(lambda s: s.values, records.stack, jnp.asarray(values)))
            if misfit is not None and _fits(selection, misfit, aside) and (best is None or misfit.total < best[0]):
                best = misfit.total, kind, c, move
    if best is None:
        return None
    _, kind, c, move = best
    channel, unit = records.channels[c], selection.campaign.channels[records.channels[c]].unit
    if kind == "zero":
        return Diagnosis("zero", channel, f"It fits with a zero of its {channel} that is off by {move[0]:.3g} {unit} "
                         f"at the start and {move[0] + move[1]:.3g} {unit} at the end.",
                         "Let the gauge warm up, and take its zero before each test.")
    return Diagnosis("gain", channel, f"It fits if its {channel} reads {1.0 + move[0]:.4g} times what it is.",
                     "Look at range and calibration of the gauge in that test, and repeat it.")


def _solve_columns(aside: Aside, columns: np.ndarray) -> np.ndarray:
    """How much of every further column the record takes, its own nuisances moving along."""
    own = aside.stated.own[aside.record]
    rows = np.block([[columns, own], [np.zeros((own.shape[1], columns.shape[1])), np.eye(own.shape[1])]])
    right = np.concatenate([aside.stated.residual[aside.record], aside.stated.z[aside.record]])
    return np.linalg.lstsq(rows, -right, rcond=None)[0][: columns.shape[1]]


def _try_conditions(selection: SelectionProblem, aside: Aside) -> Diagnosis | None:
    """A condition, or the clock, that is not what is written down."""
    r, records, stack = aside.record, selection.records, selection.records.stack
    found = []
    for k, name in enumerate(records.nuisances):
        if name in records.starts or ":" in name or (name == "time" and selection.family.free_running):
            continue
        sd = np.asarray(stack.condition_sd).copy()
        if name == "time":
            n = records.lengths[r]
            size = 0.1 * float(np.ptp(np.asarray(stack.time)[r, :n]))
        else:
            size = 0.3 * abs(float(np.asarray(stack.conditions[name])[r]))
        sd[r, k] = size
        changed = eqx.tree_at(lambda s: s.condition_sd, stack, jnp.asarray(sd))
        problem = replace_stack(selection.problem, changed)
        start = aside.stated.z.copy()
        try:
            at = settle(problem, aside.solution.names, aside.solution.u, start)
        except ComputationError:
            continue
        if records.keys[r] in at.failed:
            continue
        misfit = measure_record(selection, problem, at, r, aside.spread)
        if _fits(selection, misfit, aside):
            found.append((misfit.total, name, float(at.z[r, k] * size)))
    if not found:
        return None
    _, name, change = min(found)
    if name == "time":
        independent = selection.campaign.independent
        shown = "clock" if independent is None or independent.name == "time" else independent.name
        last = float(np.max(np.asarray(stack.time)[r, : records.lengths[r]]))
        off = format_time(change, last) if shown == "clock" else f"{1e3 * change:.3g} mm"
        return Diagnosis("clock", name, f"It fits if its {shown} is off by {off}.",
                         "Look at the trigger, or find the onset of that record again.")
    value = float(selection.campaign.records[name].iloc[r])
    return Diagnosis("setting", name, f"It fits if its {name} was {value + change:.4g} {si_unit(name)}, not "
                     f"{value:.4g}.", "Look up what was set in that test.")


RATE_RATIOS = {"57.3 (degrees and radians)": 57.29578, "9.549 (turns a minute and rad/s)": 9.5492966,
               "60 (minutes and seconds)": 60.0, "1000": 1e3}
FEWEST = 3  # other records
SHORTEST = 16  # samples


def find_rate_units(campaign: Campaign, settings: OutlierSettings = DEFAULT.outliers) -> tuple[Fault, ...]:
    """Records whose rates are plainly in another unit than those of all others."""
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
    return tuple(fault for key in slopes for fault in _compare(key, slopes, settings))


def _compare(key: str, slopes: dict[str, float], settings: OutlierSettings) -> list[Fault]:
    """Hold the difference of the moments that a record shows against that of the others."""
    others = np.array([slope for other, slope in slopes.items() if other != key])
    if len(others) < FEWEST or not np.all(others):
        return []
    middle = float(np.median(others))
    if np.median(np.abs(others / middle - 1.0)) > settings.kinematic_spread:
        return []
    for label, ratio in RATE_RATIOS.items():
        for factor in (ratio, 1.0 / ratio):
            if abs(slopes[key] * factor / middle - 1.0) < settings.kinematic_slack:
                seen = (f"The rates of record {key} obey Euler's equations with the moments that all others show only "
                        f"once they are {'divided' if factor > 1 else 'multiplied'} by {label}: a mistaken unit.")
                return [Fault("unit", (key,), RATES[0], seen, "It is left out.", "Correct the unit of that record.",
                              left_out=True)]
    return []
