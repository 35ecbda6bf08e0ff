"""Peak force, duration and impulse of predicted impacts, with their uncertainty."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from .._errors import InputError
from ..inference.archive import AbstractFitted, FittedModel, load
from ..measurement.units import format_time
from ..posterior.stacking import ModelWeights
from .predict import (
    CHUNK,
    Request,
    ask_model,
    average_predictions,
    evaluate_rows,
    find_ends,
    is_average,
    list_channels,
    name_conditions,
    name_scatter,
    read_rivals,
)


FORCES = {"normal_force": ("peak_normal_force", "normal_impulse"),
          "tangential_force": ("peak_tangential_force", "tangential_impulse")}
DURATION = "contact_duration"
UNITS = {"peak_normal_force": "N", DURATION: "s", "normal_impulse": "N s", "peak_tangential_force": "N",
         "tangential_impulse": "N s"}
FINE = 700  # samples of a pulse: its peak is met to 1e-5, and the model pads records to 768 anyway
AFTER = 1.1  # contact times that the samples reach, so that pulses that last longer by a few deviations end too


def predict_pulses(model: str | Path | FittedModel | AbstractFitted | ModelWeights,
                   conditions: str | Path | pd.DataFrame | Request) -> pd.DataFrame:
    r"""Peak force $\max F$, contact duration and impulse $\int F dt$ of impacts at new conditions.

    F is what the gauge reads. Deviations are propagated by differences of one standard deviation along the principal
    directions of the fit's covariance, and of every condition that scatters.

    Args:
        model: what `fit`, `discover` or `average` returned, or a folder that they wrote; with weights, values are
            averaged over the rivals.
        conditions: as of `predict`; times are not read.

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
        tables = [predict_pulses(one, conditions) for one in models]
        result = average_predictions(tables, weights)
        result.attrs["notes"] = tuple(dict.fromkeys(note for table in tables for note in table.attrs["notes"]))
        return result
    saved, request = ask_model(model, conditions)
    if not saved.space.family.has_contact:
        raise InputError(f"the model is of {saved.family} records; peaks, durations and impulses are those of impacts")
    if saved.sampling is None:
        raise InputError("the model does not say how long its records are; fit it again")
    groups = request.groups()
    keys, settings = [key for key, _ in groups], request.settings(name_conditions(saved))
    values, deviations = _follow_pulses(saved, settings, keys)
    notes = [f"Record {key} is still in contact {format_time(values['last'][k])} after first touch: it has no duration "
             "and no impulse." for k, key in enumerate(keys) if not np.isfinite(values[DURATION][k])]
    columns: dict[str, object] = {"record": keys}
    for name in UNITS:
        if name in values:
            own, new = deviations[name]
            columns |= {name: values[name], f"{name}_sd": own, f"{name}_sd_new": new}
    result = pd.DataFrame(columns)
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
            new = new + (saved.noise[channel].sd ** 2 if name == peak else 0.0)
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
    shown = {"record": list(table["record"])}
    for name in UNITS:
        if name in table:
            shown[f"{name} [{UNITS[name]}]"] = [
                f"{v:.4g} ± {a:.2g} ({b:.2g})" if np.isfinite(v) else "–"
                for v, a, b in zip(table[name], table[f"{name}_sd"], table[f"{name}_sd_new"], strict=True)]
    return pd.DataFrame(shown).to_string(index=False)
