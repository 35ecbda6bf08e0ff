"""Oblique impacts of an inflated ball, integrated with SciPy from the written physics.

The normal motion is `impact`'s. Along the plate, with v the speed of the ball's centre, y that of its rolling at the
plate, F_n the normal force and f friction against the motion:

    m_t dv/dt = -f + arm,   m_r dy/dt = f - (share b/height) F_n y / sqrt(y^2 + u_c^2),   height = (D - delta)/2
    v - y = C df/dt + u_s,  f = F u_s / sqrt(u_s^2 + u_c^2)

F is friction while sliding: tan delta [(pi/4) K sigma_0/p_r + (pi/10) (3 P'/E*)^(2/3)] x stribeck x presliding x
heating, times F_n (F_n/10 N)^-m, plus c_t u + f_a; slip effects see the speed u = v - y, the slider's path and its
work. SI units throughout. Nothing of the package under test is imported.
"""

import math
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from .impact import NULLS, TIGHT, Impact, complete_effects, integrate_contact, simulate
from .slip import REFERENCE_LOAD, SLIP_NULLS, measure_rubber_parts


CREEP = 0.01  # m/s
ROLLING = 0.5  # kg
OBLIQUE_NULLS = {
    "tangential-compliance": {"compliance": 0.0},
    "off-centre-reaction": {"share": 0.0},
    "sensor-crosstalk": {"c_tn": 0.0, "c_nt": 0.0},
    # outside the catalogue
    "x-arm-push": {"force": 0.0},
    "x-tack": {"A": 0.0, "t_0": 1.0},
}
CHANNELS = ("normal_force", "tangential_force", "slip", "depression", "pressure")
FORCES = ("normal_force", "tangential_force")  # axes of the gauge


class Slider:
    """Friction of the sliding patch, and what moves along the plate.

    base: `tangential_mass` (kg), `adhesion_constant` K, `loss_factor` tan delta or else `friction_coefficient`,
    optionally `rolling_mass` (kg) and `creep_speed` (m/s); conditions: `tangential_speed` (m/s) besides `Impact`'s.
    """

    def __init__(self, base, effects, conditions):
        self.effects = complete_effects(effects, NULLS | SLIP_NULLS | OBLIQUE_NULLS)
        self.impact = Impact(base, {k: v for k, v in effects.items() if k in NULLS}, conditions)
        self.base, self.mass = base, float(base["tangential_mass"])
        self.rolling = float(base.get("rolling_mass", ROLLING))
        self.creep = float(base.get("creep_speed", CREEP))
        self.speed = float(conditions["tangential_speed"])
        self.compliance = self.effects["tangential-compliance"]["compliance"]

    def find_limit(self, time, load, pressure, speed, path, work):
        """Return F (N), friction while sliding at that speed u (m/s) after that path (m) and work (J)."""
        x = self.effects
        if "friction_coefficient" in self.base:
            rubber = self.base["friction_coefficient"]
        else:
            adhesive, hysteretic = measure_rubber_parts(self.base, pressure)
            rubber = self.base["loss_factor"] * (self.base["adhesion_constant"] * adhesive + hysteretic)
        rubber *= 1.0 + x["stribeck"]["A"] * math.exp(-((speed / x["stribeck"]["u_s"]) ** 2))
        if x["presliding"]["s_0"]:
            rubber *= -math.expm1(-path / x["presliding"]["s_0"])
        rubber *= math.exp(-x["frictional-heating"]["kappa"] * work)
        rubber *= 1.0 + x["x-tack"]["A"] * math.exp(-time / x["x-tack"]["t_0"])
        load = max(load, 1e-9)
        friction = rubber * load * (load / REFERENCE_LOAD) ** -x["load-exponent"]["m"]
        return friction + x["viscous-friction"]["c_t"] * abs(speed) + x["adhesive-offset"]["f_a"]


def sample_contact(slider, times):
    """Return load (N), gas pressure (Pa) and largest braking force (N) at the times (s) of a contact, as lists."""
    impact, share = slider.impact, slider.effects["off-centre-reaction"]["share"]
    solution, _ = integrate_contact(impact, times[-1] * (1.0 - 1e-12), 1e-11)
    found = []
    for time, (depression, rate, branch, *_) in zip(times, solution(times).T, strict=True):
        depression = max(depression, 0.0)
        load = max(impact.find_contact_force(time, depression, rate, branch), 0.0)
        brake = share * impact.measure_disc(depression) / (0.5 * (impact.diameter - depression)) * load
        found.append((load, impact.find_gas_pressure(time, depression), brake))
    return found


def carry_force(slider, angle, step, state, here):
    """Return friction (N), the slider's speed u_c sinh(angle) (m/s) and the braking force (N) at the end of a step (s).

    state: path (m), work (J), v and y (m/s) before the step; here: time (s), load (N), gas pressure (Pa), largest
    braking force (N), push of the arm (N). The step's own speeds and work are in its friction: four sweeps.
    """
    path, work, along, rolling = state
    time, load, pressure, most, push = here
    sliding = slider.creep * math.sinh(angle)
    relative, heated, turning = along - rolling, work, rolling
    for _ in range(4):
        force = slider.find_limit(time, load, pressure, relative, path + step * abs(sliding), heated) * math.tanh(angle)
        brake = most * turning / math.hypot(turning, slider.creep)
        turning = rolling + step * (force - brake) / slider.rolling
        relative = along + step * (push - force) / slider.mass - turning
        heated = work + step * force * sliding
    return force, sliding, brake


def find_gap(angle, slider, spring, step, state, here):
    """Return the deflection of the patch's spring (m) by its law, less that by the motion from `spring` on."""
    _, _, along, rolling = state
    force, sliding, brake = carry_force(slider, angle, step, state, here)
    after = along + step * (here[-1] - force) / slider.mass - rolling - step * (force - brake) / slider.rolling
    return slider.compliance * force - spring - step * (after - sliding)


def step_slider(slider, times, contact):
    """Return rows (v, y, slip, work, f) at the times (s), by the backward Euler method."""
    speed, push = slider.speed, slider.effects["x-arm-push"]["force"]
    rolling = spring = slip = path = work = force = 0.0
    if not slider.compliance:
        load, pressure, _ = contact[0]
        share = speed / math.hypot(speed, slider.creep)
        force = slider.find_limit(0.0, load, pressure, speed, 0.0, 0.0) * share
    rows = [(speed, rolling, slip, work, force)]
    for before, time, (load, pressure, most) in zip(times[:-1], times[1:], contact[1:], strict=True):
        h = time - before
        arguments = (h, (path, work, speed, rolling), (time, load, pressure, most, push))
        fastest = abs(spring) / h + abs(speed) + abs(rolling) + h * most / slider.rolling
        reach = math.asinh(fastest / slider.creep) + 1.0
        angle: Any = brentq(find_gap, -reach, reach, args=(slider, spring, *arguments), xtol=1e-13, rtol=TIGHT)
        force, sliding, brake = carry_force(slider, angle, *arguments)
        speed += h * (push - force) / slider.mass
        rolling += h * (force - brake) / slider.rolling
        spring = slider.compliance * force
        slip, path, work = slip + h * sliding, path + h * abs(sliding), work + h * force * sliding
        rows.append((speed, rolling, slip, work, force))
    return np.array(rows)


def integrate_strike(base, effects, conditions, times, steps=400):
    """Return columns (dict by channel, each (len(times),)) and the end state of one oblique impact.

    Backward Euler with `steps`, twice and four times as many, extrapolated twice to a step of zero.
    """
    slider = Slider(base, effects, conditions)
    _, separation = integrate_contact(slider.impact, max(times[-1], 1e-3), 1e-11)
    end = times[-1] if separation is None else separation
    fine = np.linspace(0.0, end, 4 * steps + 1)
    contact = sample_contact(slider, fine)
    coarse, middle, best = (step_slider(slider, fine[::k], contact[::k])[:: 4 // k] for k in (4, 2, 1))
    first, second = 2.0 * middle - coarse, 2.0 * best - middle
    rows = (4.0 * second - first) / 3.0
    along = CubicSpline(fine[::4], rows)(np.clip(times, 0.0, end))
    touching = (times > 0.0) & (times < end)
    columns = {"tangential_force": np.where(touching, along[:, 4], 0.0), "slip": np.where(times > 0, along[:, 2], 0.0)}
    speed, rolling, _, work, _ = rows[-1]
    return columns, {"speed": speed, "rolling": rolling, "work": work, "separation": end}


def simulate_strike(base, effects, conditions, times, channels=CHANNELS, steps=400):
    """Return the noise-free record, an array (len(times), len(channels)); see `Slider`, `integrate_strike`."""
    times = np.asarray(times, dtype=float)
    readings, _ = integrate_strike(base, effects, conditions, times, steps)
    normal = {k: v for k, v in effects.items() if k in NULLS}
    mixed = effects.get("sensor-crosstalk", {})
    wanted = [c for c in (*(FORCES if mixed else ()), *channels) if c not in readings]
    if wanted:
        readings |= dict(zip(wanted, simulate(base, normal, conditions, times, wanted).T, strict=True))
    if mixed:  # each axis reads a share of what the other reads by itself
        both = [[1.0, mixed.get("c_nt", 0.0)], [mixed.get("c_tn", 0.0), 1.0]]
        readings |= dict(zip(FORCES, both @ np.array([readings[c] for c in FORCES]), strict=True))
    return np.column_stack([readings[c] for c in channels])
