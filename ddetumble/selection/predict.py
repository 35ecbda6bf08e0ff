"""A fitted model at new conditions, with the uncertainty of its mean and of a new measurement: records over time, and
peak force, duration and impulse of impacts."""

import dataclasses as dc
import numbers
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from .._errors import ComputationError, InputError, error_place
from ..contact.friction import describe_range
from ..contact.law import ContactLaw
from ..contact.sliding import RubberFriction
from ..dynamics.impact import bound_depression
from ..inference.archive import AbstractFitted, FittedModel, load, take_fitted
from ..inference.problem import evaluate
from ..inference.stack import Stack, pad_shape
from ..measurement.checks import read_known, refuse_rows
from ..measurement.columns import guess_condition, list_headings, names_gauge
from ..measurement.kinds import RecordKind
from ..measurement.layout import split_heading
from ..measurement.tables import Table, convert_column, read_table
from ..measurement.units import check_unit, format_time, list_usual, parse_unit, si_unit, strip_gauge
from ..posterior.stacking import FILE as WEIGHTS
from ..posterior.stacking import ModelWeights, read_weights
from .result import OPEN


POSITIVE = ("approach_speed", "normal_load", "slip_speed")
NOT_NEGATIVE = ("initial_pressure", "internal_pressure", "temperature", "slip")
CHUNK = 48  # records a call of the compiled program: more take memory, fewer more calls
DIRECTIONS = 8  # slots of free parameters, a multiple of this, so that few programs are compiled
# Points at which the path from zero slip to the last wanted one is followed: states change over many of them.
PATH = 256
SAMPLES = 200  # of a record whose times are chosen, about: a figure shows no more
BEYOND = 1.25  # contact times that such an impact record lasts, so that separation is in it
LONGEST = 12  # doublings of the campaign's record length after which an impact counts as lasting: 4096 times
SLACK = 0.02  # of a condition's value, by which it may lie outside
UNSTATED = {"initial_pressure": 0.0, "sequence": 1.0}  # conditions of a contact that a campaign need not have
FAR_OFF = 10.0  # times beyond the campaign, from which a number without a unit is asked about if another unit fits
SQUEEZED = 0.5  # of the diameter: farther in, the plate would be past the centre of the undeformed ball
SYNONYMS = 5  # of a missing column's name that are told
MOST = 6  # notes on conditions; the rest is counted, as a longer list is not read
FORCES = {"normal_force": ("peak_normal_force", "normal_impulse"),
          "tangential_force": ("peak_tangential_force", "tangential_impulse")}
DURATION = "contact_duration"
UNITS = {"peak_normal_force": "N", DURATION: "s", "normal_impulse": "N s", "peak_tangential_force": "N",
         "tangential_impulse": "N s"}
FINE = 700  # samples of a pulse: its peak is met to 1e-5, and the model pads records to 768 anyway
AFTER = 1.1  # contact times that the samples reach, so that pulses that last longer by a few deviations end too


@dc.dataclass(frozen=True)
class Request:
    """Rows of CONDITIONS.csv, SI."""

    keys: np.ndarray  # record of every row, shape (rows,)
    values: dict[str, np.ndarray]  # conditions and the independent variable by name, each shape (rows,)
    timed: bool  # whether that is given; else every record has one row, and its times are chosen
    notes: tuple[str, ...]  # sentences on what is not read

    def groups(self) -> list[tuple[str, np.ndarray]]:
        """Every record with its rows, in the order in which they come."""
        found = pd.Series(np.arange(len(self.keys))).groupby(pd.Series(self.keys), sort=False).indices
        return [(str(key), rows) for key, rows in found.items()]

    def settings(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Conditions by name, one value a record."""
        first = [rows[0] for _, rows in self.groups()]
        return {name: self.values[name][first] for name in names}

    def at(self, name: str, times: list[np.ndarray]) -> "Request":
        """The same records, each at times of its own."""
        rows = np.repeat([rows[0] for _, rows in self.groups()], [len(t) for t in times])
        values = {n: v[rows] for n, v in self.values.items()} | {name: np.concatenate(times)}
        return Request(self.keys[rows], values, True, self.notes)


def read_request(conditions: str | Path | pd.DataFrame, saved: FittedModel, gauge: bool | None = None,
                 ambient: str | float | None = None) -> Request:
    """Read what is wanted of a fitted model from a CSV file or a table like it; `gauge` and `ambient` as of `predict`.

    Raises:
        InputError: a column is missing or holds no numbers, a unit of another quantity, conditions that no test can
            have, or that change within a record.
    """
    table = _from_frame(conditions) if isinstance(conditions, pd.DataFrame) else read_table(conditions)
    added, told = _find_ambient(saved, gauge, ambient)
    lines, family, abscissa = table.lines, saved.space.family, saved.space.family.independent
    names = name_conditions(saved)
    kind = family.kind
    headings = _name_columns(table, (*names, "record", abscissa), kind)
    timed = abscissa in headings and not saved.are_values
    if timed and "record" not in headings:
        raise InputError(f"there is no column 'record'; the file has {', '.join(table.columns)}", file=table.file)
    keys = np.array([f"r{k + 1:02d}" for k in range(len(table))], dtype=object)
    if "record" in headings:
        keys = np.array([cell.strip() for cell in table.columns[headings["record"][0]]], dtype=object)
    columns = {name: heading for name, (heading, _) in headings.items()}
    refuse_rows(keys == "", table, columns.get("record", ""), "the cell is empty; every row needs the key of its "
                                                              "record")
    asked, values = {name for e in saved.space.effects for name in e.requires}, {}
    for name in (*names, *([abscissa] if timed else [])):
        if name == "sequence" and name not in headings and name not in asked:
            values[name] = np.ones(len(keys))
            continue
        unit = {"time": "s", "slip": "m"}.get(name) or saved.units.get(name) or si_unit(name)
        if name not in headings:
            others = list_headings(name, kind)[:SYNONYMS]
            raise InputError(f"there is no column {name!r} [{unit}]" + f" (or {', '.join(others)})" * bool(others)
                             + ", which the model needs; the file has " + ", ".join(table.columns), file=table.file)
        if name == kind.pressure and names_gauge(split_heading(headings[name][0])[0]) and not gauge:
            raise InputError("this is a gauge pressure; give --gauge", file=table.file, column=headings[name][0])
        plain = bool(gauge) and name == kind.pressure  # the unit of a gauge pressure says so once more, then
        values[name] = own = _convert(table, headings[name], name, unit, plain) + added * (name == kind.pressure)
        if headings[name][1] is None and name in saved.ranges:
            _doubt_unit(table, headings[name][0], name, own, saved.ranges[name])
        remedy = "; pressures are absolute" if name == "initial_pressure" else ""
        if name in POSITIVE:
            refuse_rows(own <= 0, table, headings[name][0], lambda row: f"{own[row]:g} must be positive{remedy}")  # noqa: B023
        if name in NOT_NEGATIVE:
            refuse_rows(own < 0, table, headings[name][0], lambda row: f"{own[row]:g} cannot be negative{remedy}")  # noqa: B023
    records = pd.Series(np.arange(len(keys))).groupby(keys, sort=False)
    first = records.transform("first").to_numpy()
    if timed and family.has_strokes:
        before = pd.Series(values[abscissa]).groupby(keys, sort=False).shift(fill_value=0.0).to_numpy()
        refuse_rows(values[abscissa] < before, table, columns["slip"], lambda row: (
            f"the slip falls within record {keys[row]!r}, but counts from the start of a stroke: give each stroke a "
            "record of its own, in the order of its slip"))
    if timed and family.free_running:
        refuse_rows(values["time"] < 0, table, columns["time"],
                    "a tumbling record begins at t = 0, with the rates given for it; times cannot be negative")
    if not timed:
        refuse_rows(first != np.arange(len(keys)), table, columns.get("record", ""), lambda row: (
            f"record {keys[row]!r} is already on line {lines[first[row]]}; without times there is one row per record"))
    for name in names:
        own = values[name]
        refuse_rows(own != own[first], table, columns.get(name, name), lambda row: (
            f"record {keys[row]!r} has {own[row]:g} here and {own[first[row]]:g} on line "  # noqa: B023
            f"{lines[first[row]]}, but a record has one value of each condition"))
    extra = [name for name in headings if name not in (*names, "record", abscissa)]
    notes = (f"The model does not read {', '.join(extra)}, which was left out.",) if extra else ()
    return Request(keys, values, timed, (*notes, *([told] if told and kind.pressure in names else [])))


def _find_ambient(saved: FittedModel, gauge: bool | None, ambient: str | float | None) -> tuple[float, str]:
    """What makes the pressures of a table absolute [Pa], and the sentence on it; '' where there is nothing to say."""
    stated = saved.ambient_pressure
    if not gauge:
        if ambient is not None:
            raise InputError("the ambient pressure is added to gauge pressures alone; give --gauge, too",
                             option="--ambient")
        return 0.0, "" if stated is None or gauge is not None else (
            f"The pressures were taken as absolute. The campaign states an ambient pressure of {stated:g} Pa: if these "
            "are gauge pressures, give --gauge.")
    if saved.space.family.kind.pressure not in name_conditions(saved):
        raise InputError("the model reads no pressure; leave this out", option="--gauge")
    if ambient is not None:
        plain = isinstance(ambient, numbers.Real) and not isinstance(ambient, bool)
        with error_place(option="--ambient"):
            stated = read_known("ambient_pressure", f"{float(ambient)!r} Pa" if plain else ambient)
    if stated is None:
        raise InputError("gauge pressures need the ambient pressure of the day, and the campaign of the model does not "
                         "state it; give --ambient '101.3 kPa'", option="--gauge")
    return stated, f"The ambient pressure of {stated:g} Pa was added to the pressures."


def _from_frame(frame: pd.DataFrame) -> Table:
    """A data frame as a table of text, so that it meets the same checks as a file."""
    if not len(frame):
        raise InputError("the table of conditions has no rows")
    cells = {str(n): ["" if pd.isna(x) else repr(float(x)) if isinstance(x, (float, np.floating)) else str(x)
                      for x in frame[n]] for n in frame.columns}
    return Table("conditions", cells, np.arange(2, len(frame) + 2))


def _name_columns(table: Table, known: tuple[str, ...], kind: RecordKind) -> dict[str, tuple[str, str | None]]:
    """Heading and unit by name; a column goes by its own name, or by what laboratories call it, as in `import`."""
    found: dict[str, tuple[str, str | None]] = {}
    split = {heading: (heading, None) if heading in known else split_heading(heading) for heading in table.columns}
    named = {name for name, _ in split.values()}
    for heading, (name, unit) in split.items():
        role = None if name in known else guess_condition(name, kind)
        if role in known and role not in named:
            if unit is None and role != "record" and si_unit(role) != "1":
                raise InputError(f"the column of the {role} has no unit; write it into the heading like "
                                 f"'{heading} [{si_unit(role)}]'", file=table.file, column=heading)
            name = role
        if name in found:
            raise InputError(f"there are two columns of {name}: {found[name][0]!r} and {heading!r}; leave one out",
                             file=table.file, column=heading)
        found[name] = heading, unit
    return found


def _doubt_unit(table: Table, heading: str, name: str, values: np.ndarray, measured: tuple[float, float]):
    """Refuse numbers without a unit, SI then, that lie far from all that was measured, and near it in another unit."""
    low, high = measured
    if not (len(values) and low > 0.0 and np.all(values > 0.0)) or not (
            np.all(values < low / FAR_OFF) or np.all(values > high * FAR_OFF)):
        return
    near = [unit for unit in list_usual(name) if np.all(np.abs(
        np.log(parse_unit(unit).convert(values) / np.sqrt(low * high))) < np.log(2.0 * np.sqrt(high / low)))]
    if near:
        raise InputError(f"there is no unit, so that {values[0]:g} counts as {si_unit(name)}, far from the "
                         f"{low:g} to {high:g} {si_unit(name)} of the campaign: is it {' or '.join(near)}? Write it "
                         f"into the heading like '{heading} [{near[0]}]'", file=table.file, column=heading)


def _convert(table: Table, named: tuple[str, str | None], name: str, wanted: str, plain: bool) -> np.ndarray:
    """Numbers of a column in SI; `plain` where a gauge's unit, as barg, is to be read as the plain one."""
    heading, text = named
    if plain and text is not None:
        text = strip_gauge(text) or text
    numbers = convert_column(table, heading)
    if text is None:
        return numbers
    try:
        unit = check_unit(text, name)
        if unit.dimension != parse_unit(wanted).dimension:
            raise InputError(f"{text!r} is not a unit of {name}, which is in {wanted}")
    except InputError as error:
        problem = error.problem
        if "gauge" in problem:
            problem = f"{text!r} is a gauge pressure; give --gauge"
        raise InputError(problem, file=table.file, column=heading) from None
    return np.asarray(unit.convert(numbers), dtype=float)


def predict(model: str | Path | FittedModel | AbstractFitted | ModelWeights, conditions: str | Path | pd.DataFrame, *,
            gauge: bool | None = None, ambient: str | float | None = None) -> pd.DataFrame:
    """Predict records at new conditions: mean, its standard deviation, and that of a new measurement.

    Args:
        model: what `fit`, `discover` or `average` returned, or a folder that they wrote; with weights, predictions are
            averaged over the rivals.
        conditions: CSV file in long form, or a table like it: `record`, the conditions, `time` (of slip records
            `slip`, since the stroke began); one row a wanted sample, SI, or in the unit of its heading
            (`initial_pressure [MPa]`). Without `time` there is one row a record, and the times are chosen: until a
            quarter of the contact time after separation, or those of a record of the campaign; of values, of which
            a test gives one each, there are none. Of tumbling records the
            body's true rates at t = 0 are conditions: `angular_velocity_x0`, `angular_velocity_y0`,
            `angular_velocity_z0`.
        gauge: whether its pressures count from the ambient pressure. Where nothing is said they are taken as absolute,
            and a note says so if the campaign states an ambient pressure.
        ambient: that pressure, as a text with its unit or in Pa; that of the model's campaign where it is not given.

    Returns:
        `record`, `time` or `slip`, and for every channel of the campaign its mean, `<channel>_sd` (of the mean, from
        what the fit leaves uncertain) and `<channel>_sd_new` (of a new measurement: its conditions, time origin and
        noise scatter too), in the order of the rows given, SI. `attrs["notes"]` holds sentences on what is
        extrapolated or left out, `attrs["settings"]` the conditions of every record. `predict_pulses` gives peak,
        duration and impulse.

    Raises:
        InputError: a column is missing or holds no numbers, conditions that no test can have.
        ComputationError: the model could not be integrated there.
    """
    if not (isinstance(model, ModelWeights) or is_average(model)):
        saved = take_fitted(model)
        return _predict_model(saved, lay_times(saved, read_request(conditions, saved, gauge, ambient)))
    names, models, weights = read_rivals(model)
    # Where times are chosen, they are those of the model with the most weight.
    saved = models[int(np.argmax(weights))]
    request = lay_times(saved, read_request(conditions, saved, gauge, ambient))
    result = average_predictions([_predict_model(one, request) for one in models], weights)
    shares = ", ".join(f"{name} {weight:.2f}" for name, weight in zip(names, weights, strict=True))
    first = (f"The prediction is that of {names[0]}, which has all the weight of the rivals." if len(models) == 1 else
             f"The prediction is averaged over {len(models)} models by their weights ({shares}); the spread between "
             "the models is part of the standard deviations.")
    result.attrs["notes"] = (first, *result.attrs["notes"])
    return result


def _predict_model(saved: FittedModel, request: Request) -> pd.DataFrame:
    """As `predict`, for a single model and at times that are given."""
    abscissa, keys, values = saved.space.family.independent, request.keys, request.values
    groups, settings = request.groups(), request.settings(name_conditions(saved))
    notes = [*request.notes, *describe_extrapolation(saved, [key for key, _ in groups], settings)]
    verdict = saved.extra.get("verdict")
    if verdict in (*OPEN, "undecided"):
        notes.insert(0, f"The discovery of this model ended with {verdict!r}: it does not fit its own records within "
                     "the noise, and the standard deviations do not include what it lacks.")
    channels = list_channels(saved)
    found = {c: np.zeros((3, len(keys))) for c in channels}
    order = sorted(range(len(groups)), key=lambda g: len(groups[g][1]))
    for first in range(0, len(order), CHUNK):
        part = order[first: first + CHUNK]
        rows = [groups[g][1][np.argsort(values[abscissa][groups[g][1]], kind="stable")] for g in part]
        times = [values[abscissa][r] for r in rows]
        places = [np.arange(len(t)) for t in times]
        if saved.space.family.has_strokes:  # friction work is integrated from the start of the stroke on
            paths = [np.union1d(t, np.linspace(0.0, max(float(t[-1]), 0.0), PATH)) for t in times]
            places = [np.searchsorted(path, t) for path, t in zip(paths, times, strict=True)]
            times = paths
        mean, shared, own, _ = evaluate_rows(saved, channels, times, {n: v[part] for n, v in settings.items()},
                                             [groups[g][0] for g in part])
        variance, scatter = (np.sum(x.reshape(*mean.shape, -1) ** 2, axis=-1) for x in (shared, own))
        noise = np.stack([saved.noise[c].deviations(mean[:, k]) for k, c in enumerate(channels)], axis=1) ** 2
        sd, new = np.sqrt(variance), np.sqrt(variance + scatter + noise)
        for i, (r, k) in enumerate(zip(rows, places, strict=True)):
            for c, channel in enumerate(channels):
                found[channel][:, r] = mean[i, c, k], sd[i, c, k], new[i, c, k]
    result = pd.DataFrame({"record": keys} if saved.are_values else {"record": keys, abscissa: values[abscissa]})
    for channel in channels:
        result[channel], result[f"{channel}_sd"], result[f"{channel}_sd_new"] = found[channel]
    result.attrs["notes"] = tuple(dict.fromkeys([*saved.notes, *notes]))
    result.attrs["settings"] = {key: {n: float(v[k]) for n, v in settings.items()} for k, (key, _) in enumerate(groups)}
    return result


def name_conditions(saved: FittedModel) -> tuple[str, ...]:
    """Names of what a record needs."""
    return (*saved.ranges, *saved.space.family.starts)


def list_channels(saved: FittedModel) -> tuple[str, ...]:
    """Channels of the campaign that the model predicts."""
    return tuple(c for c in saved.space.family.channels if c in saved.channels)


def lay_times(saved: FittedModel, request: Request) -> Request:
    """What is wanted, with times of its own for every record where none are given.

    Raises:
        InputError: the model's file does not say how long its campaign's records are.
        ComputationError: the model could not be integrated.
    """
    if request.timed:
        return request
    name, groups = saved.space.family.independent, request.groups()
    if saved.sampling is None:
        raise InputError(f"there is no column {name!r}, and the model does not say how long its records are: add the "
                         "column, or fit the model again")
    if saved.are_values:
        return request.at(name, [np.array([saved.sampling.last])] * len(groups))
    if not saved.space.family.has_contact:
        # Of slip records that are time series the slip is a channel, and the independent variable the time.
        last = saved.sampling.largest.get("slip", saved.sampling.last)
        step = _round_step(last / SAMPLES)
        return request.at(name, [step * np.arange(int(last / step * (1 + 1e-9)) + 1)] * len(groups))
    ends, _ = find_ends(saved, request.settings(name_conditions(saved)), [key for key, _ in groups])
    steps = [_round_step(BEYOND * end / SAMPLES) for end in ends]
    return request.at(name, [step * np.arange(int(BEYOND * end / step) + 2)
                             for step, end in zip(steps, ends, strict=True)])


def _round_step(step: float) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * min((x for x in (1.0, 2.0, 5.0, 10.0) if x * power >= step * (1 - 1e-9)), default=10.0))


def find_ends(saved: FittedModel, settings: dict[str, np.ndarray], keys: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Contact times of impacts, shape (records,) [s], and whether each separates at all.

    Where one does not within `LONGEST` doublings of the campaign's records, the time is that of the last look.
    """
    assert saved.sampling is not None
    ends, done = np.zeros(len(keys)), np.zeros(len(keys), dtype=bool)
    last = max(saved.sampling.last, 1e-6)
    for _ in range(LONGEST):
        left = np.flatnonzero(~done)
        for first in range(0, len(left), CHUNK):
            part = left[first: first + CHUNK]
            *_, end = evaluate_rows(saved, list_channels(saved), [np.linspace(0.0, last, 9)] * len(part),
                                    {n: v[part] for n, v in settings.items()}, [keys[k] for k in part])
            ends[part], done[part] = end, end < 0.99 * last
        if done.all():
            break
        last *= 2.0
    return ends, done


@partial(jax.jit, static_argnums=(0, 1, 2))
def _linearise(space, names, channels, stack, base, directions, low, high):
    """Channels, derivatives along `directions` and by the nuisances in their deviations, end of contact, failures."""
    theta, z = jnp.zeros(directions.shape[0]), jnp.zeros((stack.time.shape[0], len(names)))
    at = evaluate(space, names, channels, theta, z, stack, base, directions, low, high)
    return at.channels, at.shared, at.own, at.end, at.failed


def evaluate_rows(saved: FittedModel, channels: tuple[str, ...], times: list[np.ndarray],
                  settings: dict[str, np.ndarray], keys: list[str], u: np.ndarray | None = None
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A fitted model at a few records: at `times` by record, ascending, and `settings`, one value a record.

    Args:
        u: coordinates of the parameters, one row a record; those of the fit where not given.

    Returns:
        Channels, shape (records, channels, samples), padded by repeating the last time; their derivatives along the
        principal directions of the covariance and by the conditions, in standard deviations; the end of the contact.

    Raises:
        ComputationError: A record could not be integrated.
    """
    count, family = len(times), saved.space.family
    rows, samples = pad_shape(count, max(len(t) for t in times), family)
    time = np.zeros((rows, samples))
    for i, t in enumerate(times):
        time[i, :len(t)], time[i, len(t):] = t, t[-1]
    time[count:] = time[0]
    padded = {name: np.full(rows, value) for name, value in {"sequence": 1.0, **family.defaults}.items()}
    padded |= {n: np.concatenate([v, np.full(rows - count, v[0])]) for n, v in settings.items()}
    nuisances = name_scatter(saved, settings)
    deviations = np.stack([np.full(rows, saved.time_sd) if n == "time" else saved.uncertainties[n].sd(padded[n])
                           for n in nuisances], axis=1)
    shape = (rows, len(channels), samples)
    last = time.max(axis=1)
    span = np.where(last > 0, last, 1e-3) * 1.005
    directions = np.zeros((max(-(-len(saved.free) // DIRECTIONS), 1) * DIRECTIONS, len(saved.space)))
    spread = saved.spread()  # the variance is the sum of the squares of the columns
    directions[:len(spread)] = spread
    places = np.broadcast_to(saved.u, (count, len(saved.u))) if u is None else u
    base = jnp.asarray(np.concatenate([places, np.broadcast_to(places[:1], (rows - count, len(saved.u)))]))
    limits = [jnp.asarray(b) for b in saved.space.bounds()]
    conditions = {n: jnp.asarray(v) for n, v in padded.items()}
    inputs = {name: jnp.asarray(x) for name, x in family.lay_inputs(list(time), padded).items()}
    # A time after separation that is long against the contact would leave the integrator coarse steps there.
    for _ in range(3):
        stack = Stack(jnp.asarray(time), jnp.asarray(span), jnp.zeros(shape), jnp.ones(shape), jnp.zeros((*shape, 1)),
                      conditions, jnp.asarray(deviations), jnp.ones(rows), inputs)
        found = _linearise(saved.space, nuisances, channels, stack, base, jnp.asarray(directions), *limits)
        mean, shared, own, end, failed = (np.asarray(x) for x in found)
        long = ~failed & (end < 0.3 * span) & family.has_contact
        if not long.any():
            break
        span = np.where(long, 2.0 * end, span)
    if failed[:count].any():
        i = int(np.argmax(failed[:count]))
        raise ComputationError(describe_failure(saved, keys[i], settings, i))
    return mean[:count], shared[:count], own[:count], end[:count]


def name_scatter(saved: FittedModel, settings: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Conditions that scatter from test to test, and the time origin."""
    return (*(n for n in settings if n in saved.uncertainties and n != "sequence"), "time")


def average_predictions(tables: Sequence[pd.DataFrame], weights: Sequence[float]) -> pd.DataFrame:
    """Mix predictions of the same rows by weights with sum 1: mean, and deviations by the law of total variance.

    Returns:
        A table of the same columns: `<channel>` is the mean of the means, the square of `<channel>_sd` (and of
        `<channel>_sd_new`) the mean of the squares plus the spread of the means; `attrs["notes"]` holds those of all.
    """
    result, w = tables[0].copy(), np.asarray(weights, dtype=float)[:, None]
    for channel in [name.removesuffix("_sd_new") for name in result.columns if name.endswith("_sd_new")]:
        means = np.stack([table[channel].to_numpy(dtype=float) for table in tables])
        mean = (w * means).sum(axis=0)
        spread = (w * (means - mean) ** 2).sum(axis=0)
        result[channel] = mean
        for ending in ("_sd", "_sd_new"):
            own = np.stack([table[channel + ending].to_numpy(dtype=float) for table in tables])
            result[channel + ending] = np.sqrt((w * own**2).sum(axis=0) + spread)
    result.attrs["notes"] = tuple(dict.fromkeys(note for table in tables for note in table.attrs.get("notes", ())))
    return result


def is_average(folder) -> TypeGuard[str | Path]:
    """Whether this is a folder that `average` wrote."""
    return isinstance(folder, (str, Path)) and (Path(folder) / WEIGHTS).is_file()


def read_rivals(average: str | Path | ModelWeights) -> tuple[list[str], list[FittedModel], list[float]]:
    """Names, models and weights, with sum 1, of rivals with a weight."""
    if isinstance(average, ModelWeights):
        kept = [one for one in average.rivals if one.weight > 0]
        return [one.name for one in kept], [one.fit.fitted_model() for one in kept], [one.weight for one in kept]
    rivals = read_weights(Path(average))
    total = sum(weight for *_, weight in rivals)
    return ([name for name, *_ in rivals], [load(place) for _, place, _ in rivals],
            [weight / total for *_, weight in rivals])


def predict_pulses(model: str | Path | FittedModel | AbstractFitted | ModelWeights,
                   conditions: str | Path | pd.DataFrame, *, gauge: bool | None = None,
                   ambient: str | float | None = None) -> pd.DataFrame:
    r"""Peak force $\max F$, contact duration and impulse $\int F dt$ of impacts at new conditions.

    F is what the gauge reads. Deviations are propagated by differences of one standard deviation along the principal
    directions of the fit's covariance, and of every condition that scatters.

    Args:
        model: what `fit`, `discover` or `average` returned, or a folder that they wrote; with weights, values are
            averaged over the rivals.
        conditions, gauge, ambient: as of `predict`; times are not read.

    Returns:
        One row a record: `record`, and of `peak_normal_force` [N], `contact_duration` [s], `normal_impulse` [N s] (of
        oblique impacts of the tangential force too) the value, `<name>_sd` (of the mean) and `<name>_sd_new` (of a new
        test: its conditions scatter too, and the gauge's noise in the peak). A contact that does not end has no
        duration and no impulse: nan, and `attrs["notes"]` says so.

    Raises:
        InputError: The model is of other records, or the conditions are faulty.
        ComputationError: The model could not be integrated there.
    """
    if isinstance(model, ModelWeights) or is_average(model):
        _, models, weights = read_rivals(model)
        return average_predictions([predict_pulses(one, conditions, gauge=gauge, ambient=ambient) for one in models],
                                   weights)
    saved = take_fitted(model)
    request = read_request(conditions, saved, gauge, ambient)
    if not saved.space.family.has_contact:
        raise InputError(f"the model is of {saved.family} records; peaks, durations and impulses are those of impacts")
    if saved.sampling is None:
        raise InputError("the model does not say how long its records are; fit it again")
    groups = request.groups()
    keys, settings = [key for key, _ in groups], request.settings(name_conditions(saved))
    values, deviations = _follow_pulses(saved, settings, keys)
    notes = [f"Record {key} is still in contact {format_time(values['last'][k])} after first touch, so it has no "
             "duration and no impulse." for k, key in enumerate(keys) if not np.isfinite(values[DURATION][k])]
    result = pd.DataFrame({"record": keys})
    for name in (name for name in UNITS if name in values):
        result[name] = values[name]
        result[f"{name}_sd"], result[f"{name}_sd_new"] = deviations[name]
    result.attrs["notes"] = tuple(notes)
    return result


def has_pulses(model: str | Path) -> bool:
    """Whether the model in a folder is of impacts that `predict_pulses` reads."""
    folder = Path(model)
    models = read_rivals(folder)[1] if is_average(folder) else [load(folder)]
    return all(one.space.family.has_contact and one.sampling is not None for one in models)


def _follow_pulses(saved: FittedModel, settings: Mapping[str, np.ndarray], keys: list[str]
                   ) -> tuple[dict[str, np.ndarray], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Values by name, shape (records,), and their deviations: of the mean, and of a new test."""
    settings = dict(settings)
    ends, done = find_ends(saved, settings, keys)
    scatter = [n for n in name_scatter(saved, settings) if n != "time"]
    spread = saved.spread()
    rows: list[tuple[int, np.ndarray, dict[str, float]]] = []  # record, parameters, conditions
    for k in range(len(keys)):
        here = {name: float(v[k]) for name, v in settings.items()}
        rows.append((k, saved.u, here))
        for sign in (1.0, -1.0):
            rows += [(k, saved.u + sign * direction, here) for direction in spread]
            rows += [(k, saved.u, here | {n: here[n] + sign * float(saved.uncertainties[n].sd(np.array([here[n]]))[0])})
                     for n in scatter]
    found = _measure_rows(saved, rows, AFTER * ends, keys)
    count = 1 + 2 * (len(spread) + len(scatter))
    values, deviations = {"last": AFTER * ends}, {}
    for name, column in found.items():
        column = column.reshape(len(keys), count)
        column = np.where(done[:, None] | (name.startswith("peak")), column, np.nan)
        half = 0.5 * (column[:, 1: 1 + count // 2] - column[:, 1 + count // 2:])
        own = np.sum(half[:, : len(spread)] ** 2, axis=1)
        new = own + np.sum(half[:, len(spread):] ** 2, axis=1)
        for channel, (peak, _) in FORCES.items():
            if name == peak:
                new = new + saved.noise[channel].deviations(column[:, :1])[:, 0] ** 2
        values[name], deviations[name] = column[:, 0], (np.sqrt(own), np.sqrt(new))
    return values, deviations


def _measure_rows(saved: FittedModel, rows: list[tuple[int, np.ndarray, dict[str, float]]], lasts: np.ndarray,
                  keys: list[str]) -> dict[str, np.ndarray]:
    """Peak, duration and impulse of many records at parameters of their own, shape (rows,)."""
    channels = list_channels(saved)
    parts: dict[str, list[np.ndarray]] = {}
    for first in range(0, len(rows), CHUNK):
        part = rows[first: first + CHUNK]
        # The first sample stands just behind first touch: a dashpot's force jumps there.
        times = [np.concatenate([[1e-9 * lasts[k]], np.linspace(0.0, lasts[k], FINE)[1:]]) for k, *_ in part]
        settings = {n: np.array([here[n] for *_, here in part]) for n in part[0][2]}
        model, _, _, end = evaluate_rows(saved, channels, times, settings, [keys[k] for k, *_ in part],
                                         np.stack([u for _, u, _ in part]))
        parts.setdefault(DURATION, []).append(end)
        time = np.stack(times)
        for c, channel in enumerate(channels):
            if channel in FORCES:
                force = model[:, c, :FINE]
                peak, impulse = FORCES[channel]
                parts.setdefault(peak, []).append(np.max(force, axis=1))
                parts.setdefault(impulse, []).append(np.trapezoid(force, time, axis=1))
    return {name: np.concatenate(found) for name, found in parts.items()}


def format_pulses(table: pd.DataFrame) -> str:
    """The values for a terminal, each with the deviation of its mean and, in brackets, of a new test."""
    shown = table[["record"]].copy()
    for name in (name for name in UNITS if name in table):
        shown[f"{name} [{UNITS[name]}]"] = [
            f"{v:.4g} ± {a:.2g} ({b:.2g})" if np.isfinite(v) else "–"
            for v, a, b in zip(table[name], table[f"{name}_sd"], table[f"{name}_sd_new"], strict=True)]
    return shown.to_string(index=False)


@dc.dataclass(frozen=True)
class Squeeze:
    """An impact that would press the ball together by more than the contact geometry is made for."""

    record: str
    depression: float  # that it does not exceed, by its kinetic energy [m]; infinite where none takes that up
    diameter: float  # of the ball [m]

    def __str__(self) -> str:
        size = f"its {1e3 * self.diameter:.3g} mm"
        return (f"the ball would be compressed by more than {size}" if self.depression >= self.diameter else
                f"the ball would be compressed by up to {1e3 * self.depression:.3g} of {size}")


def take_ball(saved: FittedModel) -> ContactLaw | None:
    """The normal contact of a fitted model that has a ball with a diameter; None of any other."""
    law = saved.law()
    law = getattr(law, "normal", law)  # of an oblique impact
    return law if isinstance(law, ContactLaw) and float(law.reference.diameter()) > 0 else None


def find_squeezes(saved: FittedModel, keys: Sequence[str], settings: Mapping[str, np.ndarray],
                  share: float = SQUEEZED) -> tuple[Squeeze, ...]:
    """Records whose impact would press the ball together by more than a `share` of its diameter, under `settings`, one
    value a record; of models without a ball there is nothing to find."""
    law = take_ball(saved)
    if law is None:
        return ()
    found = []
    for i, key in enumerate(keys):
        here = UNSTATED | {name: float(v[i]) for name, v in settings.items()}
        bounds = bound_depression(law, {name: jnp.asarray(value) for name, value in here.items()})
        depression, diameter = map(float, bounds)
        if depression > share * diameter:
            found.append(Squeeze(key, depression, diameter))
    return tuple(found)


def describe_extrapolation(saved: FittedModel, keys: list[str], settings: dict[str, np.ndarray]) -> list[str]:
    """Sentences on conditions beyond those of the campaign."""
    found: dict[str, list[str]] = {}
    some = []
    for i, key in enumerate(keys):
        phrases = saved.outside({name: float(v[i]) for name, v in settings.items()}, slack=SLACK)
        some += [i] if phrases else []
        for phrase in phrases:
            found.setdefault(phrase, []).append(key)
    notes = [f"This is an extrapolation: {phrase} (record {_list_some(records)})."
             for phrase, records in list(found.items())[:MOST]]
    if len(found) > MOST:
        notes.append(f"There are {len(found) - MOST} further settings outside the range of the campaign.")
    squeezes = find_squeezes(saved, [keys[i] for i in some], {name: v[some] for name, v in settings.items()})
    if squeezes:
        worst = max(squeezes, key=lambda one: one.depression / one.diameter)
        records = _list_some([worst.record, *(one.record for one in squeezes if one is not worst)])
        notes.append(f"The contact geometry is valid up to {SQUEEZED:.0%} of the diameter, but {worst} (record "
                     f"{records}). The prediction there is meaningless.")
    pressure, loads = settings.get("initial_pressure"), settings.get("normal_load")
    if loads is not None and isinstance(saved.space.reference, RubberFriction):
        notes += [f"Some loads are outside the range of Eq. 10: {phrase}."
                  for phrase in dict.fromkeys(map(describe_range, loads)) if phrase]
    if pressure is not None and np.any(pressure == 0) and "gas" in saved.space.reference.provides:
        notes.append("Without gas (initial_pressure = 0) the ball of this model exerts no gas force.")
    return notes


def describe_failure(saved: FittedModel, key: str, settings: Mapping[str, np.ndarray], place: int) -> str:
    """Why the model can hardly be integrated for a record, at a place among `settings`, and what to do."""
    here = {name: float(v[place]) for name, v in settings.items()}
    reasons = saved.outside(here, slack=SLACK)
    reasons += map(str, find_squeezes(saved, [key], {name: np.array([value]) for name, value in here.items()}))
    given = ", ".join(f"{name} = {value:g}" for name, value in here.items())
    failed = f"the model could not be integrated for record {key!r}"
    if not reasons:
        return f"{failed} ({given}); check its conditions and their units"
    return (f"{failed}: {'; '.join(reasons)}. Check the conditions ({given}) and their units, or choose some closer to "
            "those of the campaign")


def _list_some(records: Sequence[str]) -> str:
    more = f" and {len(records) - 3} more" if len(records) > 3 else ""
    return f"{', '.join(records[:3])}{more}"
