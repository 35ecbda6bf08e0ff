"""Which single physical change would turn the printed theory into the measured peaks, if peaks can tell at all."""

from typing import Any

import numpy as np

from .bench import ATMOSPHERE
from .peaks import PeakProgram
from .rivals import make_row
from .rows import Noise, PairedDifference, PeakRow, compare_rows


# Parameter, range that is scanned, words.
CHANGES = (
    ("sensor-gain.g", (0.85, 1.05), "a sensor that reads low"),
    ("gas-leak.lambda", (0.0, 14.0), "gas that leaks during contact"),
    ("contact_radius_coefficient", (0.62, 0.82), "a smaller contact disc (b over depression)"),
    ("effective_mass", (0.75, 1.15), "a smaller effective mass (share of the fitted one)"),
    ("initial_pressure", (0.7, 1.1), "gas lost before the impact (share that is left)"),
)


def correct_printed(program: PeakProgram, mass: float, pressures: np.ndarray, speeds: np.ndarray, printed: np.ndarray,
                    peaks: np.ndarray, noise: Noise) -> tuple[list[PeakRow], list[PairedDifference], dict]:
    r"""Multiply the printed column by what one physical change does to our model, $F_{printed} F(\theta)/F(\theta_0)$.

    Pressures are read as gauge here (the atmosphere is added), so that every row has gas for a change to act on.

    Args:
        program: peaks of our model with the effects.
        mass: effective mass of our model [kg].
        pressures, speeds: of the records, shape (records,) [Pa, m/s].
        printed, peaks: the printed theory and what was measured, shape (records,) [N].
        noise: of single peaks.

    Returns:
        One row a change, their paired differences, and the fitted ratio of each, shape (records,), by label.
    """
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    conditions = {"initial_pressure": pressures + ATMOSPHERE, "approach_speed": speeds}
    rows, ratios = [], {}
    none = np.full((13, 4), -1)
    start, _ = program.evaluate(program.place({"effective_mass": mass})[None], none[:1], conditions)
    for name, (low, high), words in CHANGES:
        grid = np.linspace(low, high, 13)
        scale = mass if name == "effective_mass" else 1.0
        if name == "initial_pressure":
            x = program.place({"effective_mass": mass})[None]
            values = np.array([program.evaluate(x, none[:1], {**conditions, name: value * conditions[name]})[0][0]
                               for value in grid])
        else:
            x = np.array([program.place({"effective_mass": mass, name: scale * value}) for value in grid])
            values, _ = program.evaluate(x, none, conditions)
        curve = CubicSpline(grid, np.log(values / start[0]), axis=0)

        def fit(keep, curve=curve, low=low, high=high):
            found: Any = minimize_scalar(
                lambda t: np.sum((printed * np.exp(curve(t)) / peaks - 1.0)[keep] ** 2), bounds=(low, high),
                method="bounded", options={"xatol": 1e-7})
            return float(found.x)

        every = np.arange(len(peaks))
        best = fit(every)
        left = [fit(every != k) for k in every]
        held = np.array([printed[k] * np.exp(curve(left[k])[k]) for k in every])
        spread = float(np.sqrt((len(peaks) - 1) / len(peaks) * np.sum((np.array(left) - np.mean(left)) ** 2)))
        ratios[words] = np.exp(curve(best))
        value = {"estimate": best, "sd": spread, "q025": best - 1.96 * spread, "q975": best + 1.96 * spread,
                 "unit": "1/s" if name == "gas-leak.lambda" else ""}
        rows.append(make_row(words, "correction", (), 1, printed * ratios[words], held, peaks, pressures, noise,
                             {name: value}, remark="at its limit" if min(best - low, high - best) < 1e-4 else ""))
    pairs = [compare_rows(a, b, peaks) for k, a in enumerate(rows) for b in rows[k + 1:]]
    return rows, pairs, ratios
