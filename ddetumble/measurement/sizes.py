"""Sizes of single records that tell a wrong unit: durations, masses, strokes, rates, and ratios of columns."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd


# Stiffness of a ball over that of its gas: m/(P₀ v T³), T the time above half of the peak, is 0.65 for the reference
# model, and 0.52 to 0.79 on two dozen simulated campaigns with any effects of the catalogue. A thick wall can do more.
GAS_STIFFNESS = 0.65


@dataclass(frozen=True)
class Size:
    """A measured size: its value, its SI unit ("1" for a ratio), and the power with which each column enters."""

    value: float
    unit: str
    powers: Mapping[str, int]


Measure = Callable[[pd.DataFrame, Mapping[str, float]], dict[str, Size]]


def measure_impact(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Duration, moving mass, stiffness over that of the gas, and depression of one impact."""
    if "normal_force" not in trace or "approach_speed" not in settings:
        return {}
    t, f = trace[["time", "normal_force"]].dropna().to_numpy(dtype=float).T
    if len(t) < 8 or not f.max() > 0:
        return {}
    above = t[f > 0.5 * f.max()]
    middle, width = 0.5 * (above[0] + above[-1]), float(above[-1] - above[0])
    contact = np.abs(t - middle) < 1.5 * width  # what lies farther off is drift or a second contact
    speed, pressure = float(settings["approach_speed"]), float(settings.get("initial_pressure", 0.0))
    mass = float(np.trapezoid(f[contact], t[contact])) / (1.7 * speed)  # of a restitution of 0.7
    sizes = {"duration of the impact": Size(2.0 * width, "s", {"time": 1}),
             "moving mass": Size(mass, "kg", {"normal_force": 1, "time": 1, "approach_speed": -1})}
    if pressure > 0 and width > 0:
        ratio = mass / (pressure * speed * width**3) / GAS_STIFFNESS
        sizes["stiffness over that of the gas"] = Size(ratio, "1", {
            "normal_force": 1, "time": -2, "approach_speed": -2, "initial_pressure": -1})
    if "depression" in trace and np.isfinite(trace["depression"].to_numpy(dtype=float)).any():
        depth = float(np.nanmax(trace["depression"].to_numpy(dtype=float)))
        sizes["depression"] = Size(depth, "m", {"depression": 1})
        if width > 0:
            sizes["depression over speed and duration"] = Size(depth / (speed * 2.0 * width), "1", {
                "depression": 1, "approach_speed": -1, "time": -1})
    return sizes


def measure_slip(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Friction, stroke, and path against speed of one friction record."""
    if "tangential_force" not in trace or "slip" not in trace:
        return {}
    force, slip = trace["tangential_force"].to_numpy(dtype=float), trace["slip"].to_numpy(dtype=float)
    force = float(np.nanmedian(np.abs(force)))
    sizes = {"tangential_force": Size(force, "N", {"tangential_force": 1}),
             "stroke": Size(float(np.nanmax(slip) - np.nanmin(slip)), "m", {"slip": 1}),
             "friction coefficient": Size(force / float(settings["normal_load"]), "1", {
                 "tangential_force": 1, "normal_load": -1})}
    speed, there = float(settings.get("slip_speed", 0.0)), np.isfinite(slip)
    if "time" in trace and speed > 0 and there.sum() > 1:
        moving = np.abs(np.diff(slip[there]) / np.diff(trace["time"].to_numpy(dtype=float)[there]))
        fastest = np.sort(moving)[len(moving) // 2:]  # the other half may rest or turn round
        sizes["path over speed and time"] = Size(float(np.median(fastest)) / speed, "1", {
            "slip": 1, "time": -1, "slip_speed": -1})
    return sizes


def measure_tumbling(trace: pd.DataFrame, settings: Mapping[str, float]) -> dict[str, Size]:
    """Largest angular rate of one tumbling record, and the angle that it turns between two samples."""
    rates = trace.filter(like="angular_velocity_").to_numpy(dtype=float)
    if not np.isfinite(rates).any():
        return {}
    largest = float(np.sqrt(np.nanmax(np.nansum(rates**2, axis=1))))
    turn = largest * float(np.median(np.diff(trace["time"].to_numpy(dtype=float))))
    return {"angular rate": Size(largest, "rad/s", {"angular_velocity": 1}),
            "turn between samples": Size(turn, "rad", {"angular_velocity": 1, "time": 1})}
