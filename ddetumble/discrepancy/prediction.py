"""A fitted model at new conditions, with the uncertainty of its mean and of a new measurement."""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from .._errors import ComputationError, InputError
from ..contact.friction import describe_range
from ..contact.sliding import RubberFriction
from ..inference.archive import SavedModel, load_model
from ..inference.families import find_family
from ..inference.problem import evaluate
from ..inference.stack import Stack, pad_shape
from ..inference.starts import lay_mesh
from ..measurement.tables import Table, convert_column, read_table
from ..measurement.units import si_unit
from ..sampling.weights import FILE as WEIGHTS


CHUNK = 48  # records a call of the compiled program
DIRECTIONS = 8  # slots of free parameters, a multiple of this
PATH = 256  # points at which the path from zero slip to the last wanted one is followed
POSITIVE = ("approach_speed", "normal_load", "slip_speed")
NOT_NEGATIVE = ("initial_pressure", "internal_pressure", "temperature", "slip")


def predict(model: str | Path | SavedModel, conditions: str | Path | pd.DataFrame) -> pd.DataFrame:
    """Predict records at new conditions.

    Args:
        model: folder that `fit`, `discover` or `weigh` wrote; with weights, predictions are averaged over the rivals.
        conditions: CSV file in long form, or a table like it: `record`, the conditions, `time` (of slip records
            `slip`, since the stroke began); one row a wanted sample, SI. Of tumbling records the body's true rates at
            t = 0 are conditions: `angular_velocity_x0`, `angular_velocity_y0`, `angular_velocity_z0`.

    Returns:
        `record`, `time` or `slip`, and for every channel of the campaign its mean, `<channel>_sd` (of the mean, from
        what the fit leaves uncertain) and `<channel>_sd_new` (of a new measurement: its conditions, time origin and
        noise scatter too), in the order of the rows given. `attrs["notes"]` holds sentences on what is extrapolated or
        left out.

    Raises:
        InputError: a column is missing or holds no numbers, conditions that no test can have.
        ComputationError: the model could not be integrated there.
    """
    if not isinstance(model, SavedModel) and (Path(model) / WEIGHTS).is_file():
        from .averaging import predict_average

        return predict_average(Path(model), conditions)
    return predict_model(model, conditions)


def predict_model(model: str | Path | SavedModel, conditions: str | Path | pd.DataFrame) -> pd.DataFrame:
    """As `predict`, for a single model."""
    saved = model if isinstance(model, SavedModel) else load_model(model)
    family = find_family(saved.family, "predict")
    abscissa = "slip" if saved.family == "slip" else "time"
    table, file = (_from_frame(conditions), None) if isinstance(conditions, pd.DataFrame) else (
        read_table(conditions), str(conditions))
    names = (*saved.ranges, *family.starts)
    keys, values, notes = _read(table, names, saved, file)
    found_rows = pd.Series(np.arange(len(keys))).groupby(pd.Series(keys), sort=False).indices
    groups = [(str(key), rows) for key, rows in found_rows.items()]
    settings = {name: np.array([values[name][rows[0]] for _, rows in groups]) for name in names}
    notes += _find_extrapolation(saved, [key for key, _ in groups], settings)
    channels = tuple(c for c in family.channels if c in saved.channels)
    size = len(keys)
    found = {c: np.zeros((3, size)) for c in channels}
    order = sorted(range(len(groups)), key=lambda g: len(groups[g][1]))
    for first in range(0, len(order), CHUNK):
        part = order[first: first + CHUNK]
        rows = [groups[g][1][np.argsort(values[abscissa][groups[g][1]], kind="stable")] for g in part]
        times = [values[abscissa][r] for r in rows]
        places = [np.arange(len(t)) for t in times]
        if saved.family == "slip":  # friction work is integrated from the start of the stroke on
            paths = [np.union1d(t, np.linspace(0.0, max(float(t[-1]), 0.0), PATH)) for t in times]
            places = [np.searchsorted(path, t) for path, t in zip(paths, times, strict=True)]
            times = paths
        mean, sd, new = _predict_some(saved, channels, times, {n: settings[n][part] for n in names},
                                      [groups[g][0] for g in part])
        for i, (r, k) in enumerate(zip(rows, places, strict=True)):
            for c, channel in enumerate(channels):
                found[channel][:, r] = mean[i, c, k], sd[i, c, k], new[i, c, k]
    columns = {"record": keys, abscissa: values[abscissa]}
    for channel in channels:
        for k, ending in enumerate(("", "_sd", "_sd_new")):
            columns[channel + ending] = found[channel][k]
    result = pd.DataFrame(columns)
    result.attrs["notes"] = tuple(dict.fromkeys([*saved.notes, *notes]))
    return result


def _from_frame(frame: pd.DataFrame) -> Table:
    """A data frame as a table of text, so that it meets the same checks as a file."""
    if not len(frame):
        raise InputError("the table of conditions has no rows")
    cells = {str(n): ["" if pd.isna(x) else repr(float(x)) if isinstance(x, (float, np.floating)) else str(x)
                      for x in frame[n]] for n in frame.columns}
    return Table("conditions", cells, np.arange(2, len(frame) + 2))


def _read(table: Table, names: tuple[str, ...], saved: SavedModel, file: str | None
          ) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Keys and numbers of all rows; the same conditions in all rows of a record."""
    place, lines = file or table.file, table.lines
    notes, values = [], {}
    asked = {name for e in saved.space.effects for name in e.requires}
    if "record" not in table.columns:
        raise InputError(f"there is no column 'record'; the file has {', '.join(table.columns)}", file=place)
    keys = np.array([cell.strip() for cell in table.columns["record"]], dtype=object)
    for i, key in enumerate(keys):
        if not key:
            raise InputError("the cell is empty; every row needs the key of its record", file=place, column="record",
                             row=lines[i])
    abscissa = "slip" if saved.family == "slip" else "time"
    for name in (*names, abscissa):
        if name == "sequence" and name not in table.columns and name not in asked:
            values[name] = np.ones(len(keys))
            continue
        if name not in table.columns:
            unit = {"time": "s", "slip": "m"}.get(name) or saved.units.get(name) or si_unit(name)
            raise InputError(f"there is no column {name!r} [{unit}], which the model needs; the file has "
                             + ", ".join(table.columns), file=place)
        values[name] = convert_column(table, name)
        _check_sign(name, values[name], place, lines)
    if abscissa == "slip":
        _refuse_reversal(keys, values["slip"], place, lines)
    if saved.family == "tumble" and np.any(values["time"] < 0):
        raise InputError("a tumbling record begins at t = 0, with the rates given for it; times cannot be negative",
                         file=place, column="time", row=lines[int(np.argmax(values["time"] < 0))])
    extra = [name for name in table.columns if name not in (*names, "record", abscissa)]
    if extra:
        notes.append(f"The model does not read {', '.join(extra)}: left out.")
    first: dict[str, int] = {}
    for i, key in enumerate(keys):
        k = first.setdefault(key, i)
        for name in names:
            if values[name][i] != values[name][k]:
                raise InputError(f"record {key!r} has {values[name][i]:g} here and {values[name][k]:g} on line "
                                 f"{lines[k]}; a record has one value of each condition", file=place, column=name,
                                 row=lines[i])
    return keys, values, notes


def _refuse_reversal(keys: np.ndarray, slip: np.ndarray, place: str, lines: np.ndarray):
    """Slip counts from the start of a stroke: within a record it does not fall."""
    last: dict[str, float] = {}
    for i, key in enumerate(keys):
        if slip[i] < last.get(key, 0.0):
            raise InputError(f"slip falls within record {key!r}; it counts from the start of a stroke: give each "
                             "stroke a record of its own, in the order of its slip", file=place, column="slip",
                             row=lines[i])
        last[key] = float(slip[i])


def _check_sign(name: str, values: np.ndarray, place: str, lines: np.ndarray):
    bad = values <= 0 if name in POSITIVE else values < 0 if name in NOT_NEGATIVE else np.zeros(len(values), dtype=bool)
    if bad.any():
        i = int(np.argmax(bad))
        rule = "has to be positive" if name in POSITIVE else "cannot be negative"
        remedy = "; pressures are absolute, in Pa" if name == "initial_pressure" else ""
        raise InputError(f"{values[i]:g} {rule}{remedy}", file=place, column=name, row=lines[i])


def _find_extrapolation(saved: SavedModel, keys: list[str], settings: dict[str, np.ndarray]) -> list[str]:
    """Sentences on conditions beyond those of the campaign."""
    found: dict[str, list[str]] = {}
    for i, key in enumerate(keys):
        for phrase in saved.outside({name: float(v[i]) for name, v in settings.items()}, slack=0.02):
            found.setdefault(phrase, []).append(key)
    notes = []
    for phrase, records in list(found.items())[:6]:
        more = f" and {len(records) - 3} more" if len(records) > 3 else ""
        notes.append(f"Extrapolated: {phrase} (record {', '.join(records[:3])}{more}).")
    if len(found) > 6:
        notes.append(f"Extrapolated in {len(found) - 6} further settings.")
    pressure = settings.get("initial_pressure")
    loads = settings.get("normal_load")
    if loads is not None and isinstance(saved.space.reference, RubberFriction):
        notes += [f"Outside the range of Eq. 10: {phrase}." for phrase in dict.fromkeys(map(describe_range, loads))
                  if phrase]
    if pressure is not None and np.any(pressure == 0) and "gas" in saved.space.reference.provides:
        notes.append("Without gas (initial_pressure = 0) this model's ball has no gas force.")
    return notes


@partial(jax.jit, static_argnums=(0, 1, 2))
def _linearise(space, names, channels, stack, base, directions, low, high):
    """Channels, derivatives along `directions` and by the nuisances in their deviations, end of contact, failures."""
    theta, z = jnp.zeros(directions.shape[0]), jnp.zeros((stack.time.shape[0], len(names)))
    at = evaluate(space, names, channels, theta, z, stack, base, directions, low, high)
    return at.channels, at.shared, at.own, at.end, at.failed


def _predict_some(saved: SavedModel, channels: tuple[str, ...], times: list[np.ndarray],
                  settings: dict[str, np.ndarray], keys: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean and standard deviations of a few records, each shape (records, channels, samples)."""
    count, longest = len(times), max(len(t) for t in times)
    rows, samples = pad_shape(count, longest, saved.space.family)
    time = np.zeros((rows, samples))
    for i, t in enumerate(times):
        time[i, :len(t)], time[i, len(t):] = t, t[-1]
    time[count:] = time[0]
    padded = {n: np.concatenate([v, np.full(rows - count, v[0])]) for n, v in settings.items()}
    if saved.family not in ("slip", "tumble"):
        padded.setdefault("initial_pressure", np.zeros(rows))
    padded.setdefault("sequence", np.ones(rows))
    nuisances = (*(n for n in settings if n in saved.uncertainties and n != "sequence"), "time")
    deviations = np.stack([np.full(rows, saved.time_sd) if n == "time" else saved.uncertainties[n].sd(padded[n])
                           for n in nuisances], axis=1)
    shape = (rows, len(channels), samples)
    last = time.max(axis=1)
    span = np.where(last > 0, last, 1e-3) * 1.005
    slots = max(-(-len(saved.free) // DIRECTIONS), 1) * DIRECTIONS
    directions = np.zeros((slots, len(saved.space)))
    # The variance is the sum of the squares of the columns.
    spread = saved.spread()
    directions[:len(spread)] = spread
    base = jnp.asarray(np.broadcast_to(saved.u, (rows, len(saved.u))))
    limits = [jnp.asarray(b) for b in saved.space.bounds()]
    conditions = {n: jnp.asarray(v) for n, v in padded.items()}
    inputs = {}
    if saved.family == "tumble":
        rates = np.stack([padded[name] for name in saved.space.family.starts], axis=1)
        inputs["mesh"] = jnp.asarray(lay_mesh(list(time), np.sqrt(np.sum(rates**2, axis=1))))
    # A time after separation that is long against the contact would leave the integrator coarse steps there.
    for _ in range(3):
        stack = Stack(jnp.asarray(time), jnp.asarray(span), jnp.zeros(shape), jnp.ones(shape), jnp.zeros((*shape, 1)),
                      conditions, jnp.asarray(deviations), jnp.ones(rows), inputs)
        found = _linearise(saved.space, nuisances, channels, stack, base, jnp.asarray(directions), *limits)
        mean, shared, own, end, failed = (np.asarray(x) for x in found)
        long = ~failed & (end < 0.3 * span) & (saved.family not in ("slip", "tumble"))
        if not long.any():
            break
        span = np.where(long, 2.0 * end, span)
    if failed[:count].any():
        i = int(np.argmax(failed[:count]))
        where = ", ".join(f"{n} = {v[i]:g}" for n, v in settings.items())
        raise ComputationError(f"the model could not be integrated for record {keys[i]!r} ({where}); check its "
                               "conditions and their units")
    variance = np.sum(shared.reshape(*shape, -1) ** 2, axis=-1)
    scatter = np.sum(own.reshape(*shape, -1) ** 2, axis=-1)
    noise = np.array([saved.noise[c].sd for c in channels])[None, :, None] ** 2
    return mean[:count], np.sqrt(variance)[:count], np.sqrt(variance + scatter + noise)[:count]
