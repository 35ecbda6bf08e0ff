"""Friction of a rubber ball that slides under constant load, pressure and speed, from the written physics.

Sources: "the paper" is *Impact Force Identification of the Variable Pressure Flexible Impact End-Effector
in Space Debris Active Detumbling* (2020), Eqs. 8-11 with e = 1; six further effects follow the project's catalogue.
SI units throughout. Nothing of the package under test is imported.

The order of the stages, which matters as soon as two effects meet (s: slip since the last reversal):

1. rubber: mu_r = tan delta [(pi/4) K sigma_0/p_r + (pi/10) (3 p_c/E*)^(2/3)] x stribeck x presliding x heating
   x other factors;
2. load: (mu_r + slip_scale mu_slip(s)) F_n (F_n/10 N)^-m;
3. sum: + c_t u + f_a;
4. x-stick-slip multiplies the sum;
5. the force's sign is that of the motion which it opposes: it changes with every reversal.

Heat W = int |f| ds runs over the whole path, all strokes together.
"""

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from .impact import ELASTIC_MODULUS, complete_effects


POISSON_RATIO = 0.47  # Table 2
COMPOSITE_MODULUS = ELASTIC_MODULUS / (1.0 - POISSON_RATIO**2)  # Pa, E* of Eq. 8
TENSILE_STRENGTH = 10e6  # Pa, sigma_0
REAL_PRESSURE = 20e6  # Pa, p_r
REFERENCE_LOAD = 10.0  # N, of `load-exponent`
TURNING = 1e-9  # m, how close to a reversal a point belongs to the stroke that ends there

SLIP_NULLS = {
    "stribeck": {"A": 0.0, "u_s": 1.0},
    "viscous-friction": {"c_t": 0.0},
    "load-exponent": {"m": 0.0},
    "presliding": {"s_0": 0.0},
    "frictional-heating": {"kappa": 0.0},
    "adhesive-offset": {"f_a": 0.0},
    # outside the catalogue
    "x-stick-slip": {"ratio": 0.0, "wavelength": 1.0},
    "x-wear": {"w": 0.0, "j_0": 1.0},
    "x-creep": {"A": 0.0, "t_0": 1.0},
}


def find_coefficients(load):
    """Return a (-), b (1/mm), c (-), d (1/mm) of Eq. 10 at the load (N)."""
    a = 0.74769 - 0.01684 * load
    b = -0.13056 - 0.01728 * load + 5.35714e-4 * load**2
    c = -1.04239 + 0.00583 * load - 4.07238e-4 * load**2
    d = 0.010619 + 0.01829 * load - 7.75e-4 * load**2
    return a, b, c, d


def measure_slip_coefficient(slip, load):
    """Return mu_slip = a + a exp(b s) (c sinh(d s) - cosh(d s)), s in mm, for slip (m) and load (N)."""
    a, b, c, d = find_coefficients(load)
    s = 1e3 * np.asarray(slip, dtype=float)
    return a + a * np.exp(b * s) * (c * np.sinh(d * s) - np.cosh(d * s))


def measure_rubber_parts(base, pressure):
    """Return the adhesive and the hysteretic part of Eq. 8 without K and tan delta.

    (pi/4) sigma_0/p_r and (pi/10) (3 p_c/E*)^(2/3), where p_c is the internal pressure (Pa).
    """
    ratio = base.get("tensile_strength", TENSILE_STRENGTH) / base.get("real_contact_pressure", REAL_PRESSURE)
    return 0.25 * math.pi * ratio, 0.1 * math.pi * (3.0 * np.asarray(pressure) / COMPOSITE_MODULUS) ** (2.0 / 3.0)


def follow_strokes(path, strokes=None):
    """Return stroke index, slip (m), slip since the last reversal (m) and direction (+-1) along the path.

    path: distance rubbed since the start (m), not negative; strokes: lengths (m) of strokes back and forth, the
    first one forth; None is one stroke without an end. A point of reversal belongs to the stroke that ends there.
    """
    path = np.asarray(path, dtype=float)
    ends = np.cumsum([math.inf] if strokes is None else strokes)
    if path.size and (path.min() < 0.0 or path.max() > ends[-1] + TURNING):
        raise ValueError("the path leaves the strokes")
    index = np.searchsorted(ends + TURNING, path)
    starts = np.concatenate([[0.0], ends[:-1]])
    directions = 1.0 - 2.0 * (np.arange(ends.size) % 2)
    turned = np.concatenate([[0.0], np.cumsum(np.diff(starts) * directions[:-1])])
    since = path - starts[index]
    return index, turned[index] + directions[index] * since, since, directions[index]


class Rub:
    """One slip test's constants, gathered from base parameters, effects and conditions.

    base: adhesion_constant K (-), loss_factor tan delta (-), slip_scale (-), optionally tensile_strength and
    real_contact_pressure (Pa). conditions: normal_load (N), internal_pressure (Pa, absolute), slip_speed (m/s),
    sequence (1 for the first).
    """

    def __init__(self, base, effects, conditions):
        self.effects = x = complete_effects(effects, SLIP_NULLS)
        self.load = float(conditions["normal_load"])
        self.speed = float(conditions["slip_speed"])
        self.scale = float(base.get("slip_scale", 1.0))
        adhesive, hysteretic = measure_rubber_parts(base, float(conditions["internal_pressure"]))
        self.rubber = float(base["loss_factor"] * (base["adhesion_constant"] * adhesive + hysteretic))
        self.rubber *= 1.0 + x["stribeck"]["A"] * math.exp(-((self.speed / x["stribeck"]["u_s"]) ** 2))
        wear, earlier = x["x-wear"], float(conditions.get("sequence", 1)) - 1.0
        self.rubber *= 1.0 - wear["w"] * -math.expm1(-earlier / wear["j_0"])
        self.pressed = self.load * (self.load / REFERENCE_LOAD) ** -x["load-exponent"]["m"]

    def measure_force(self, since, work=0.0):
        """Return f (N) against the motion at slip since reversal (m) after the work (J) has heated the rubber.

        mu_r has the factors exp(-kappa W), 1 - exp(-s/s_0) and, from t = s/u since reversal, 1 + A ln(1 + t/t_0);
        x-stick-slip multiplies the sum by 1 + ratio (2 frac(s/wavelength) - 1).
        """
        x = self.effects
        friction = self.rubber * np.exp(-x["frictional-heating"]["kappa"] * np.asarray(work, dtype=float))
        if x["presliding"]["s_0"]:
            friction = friction * -np.expm1(-since / x["presliding"]["s_0"])
        friction = friction * (1.0 + x["x-creep"]["A"] * np.log1p(since / self.speed / x["x-creep"]["t_0"]))
        friction = friction + self.scale * measure_slip_coefficient(since, self.load)
        force = friction * self.pressed + x["viscous-friction"]["c_t"] * self.speed + x["adhesive-offset"]["f_a"]
        phase = since / x["x-stick-slip"]["wavelength"]
        return force * (1.0 + x["x-stick-slip"]["ratio"] * (2.0 * (phase - np.floor(phase)) - 1.0))


def accumulate_work(rub, path, strokes=None, rtol=1e-11):
    """Return W (J) of dW/ds = |f(s, W)| at the points of the path (m), in any order; each stroke starts anew in s."""
    index, _, since, _ = follow_strokes(path, strokes)
    work, before = np.zeros(since.size), 0.0
    step = rub.effects["x-stick-slip"]["wavelength"] / 20.0 if rub.effects["x-stick-slip"]["ratio"] else math.inf
    for k in range(index.max() + 1 if index.size else 0):
        here = index == k
        end = since[here].max() if strokes is None or k == index.max() else strokes[k]
        if end == 0.0:  # nothing but the start
            continue
        solution = solve_ivp(lambda s, w: np.abs(rub.measure_force(s, w)), (0.0, end), [before], method="DOP853",
                             dense_output=True, rtol=rtol, atol=1e-14, max_step=min(step, end / 8.0))
        if not solution.success:
            raise RuntimeError(solution.message)
        work[here], before = solution.sol(since[here])[0], solution.y[0, -1]
    return work


def simulate_slip(base, effects, conditions, path, strokes=None, rtol=1e-11):
    """Return the noise-free record, an array (len(path), 1) of tangential_force (N).

    base, conditions: see `Rub`; effects: catalogue id -> {symbol: value}; path, strokes: see `follow_strokes`. At
    constant speed u the path at time t is u t. The force is positive where it opposes motion forth.
    """
    rub = Rub(base, effects, conditions)
    path = np.asarray(path, dtype=float)
    _, _, since, direction = follow_strokes(path, strokes)
    work: Any = accumulate_work(rub, path, strokes, rtol) if rub.effects["frictional-heating"]["kappa"] else 0.0
    return (direction * rub.measure_force(since, work))[:, None]
