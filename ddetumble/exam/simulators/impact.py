"""Impact records of an inflated ball, integrated with SciPy from the written physics.

Sources: "the paper" is *Impact Force Identification of the Variable Pressure Flexible Impact End-Effector
in Space Debris Active Detumbling* (2020), Eqs. 2-6; nineteen further effects follow the project's catalogue.
SI units throughout. Nothing of the package under test is imported.

The order of the stages, which matters as soon as two effects meet:

1. gas: P' = P0 m (V0/V')^n, with m = exp(-lambda t) in contact;
2. spring: F_k = ((P' - p_a) pi b^2 + k_w delta^q + k (delta - depth)_+^exponent) x softening x other factors;
3. sum: F_k (1 + c_n w) + viscoelastic + dashpot, clamped at zero;
4. adhesion subtracted after the clamp, so that tension is possible;
5. gauge: its resonance, high-pass, then lag, then gain, on ``normal_force`` only.
"""

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


OUTER_DIAMETER = 0.060  # m, Table 2
ELASTIC_MODULUS = 7.8e6  # Pa, Table 2
ADHESION_RATE = 5e-3  # m/s, rate over which adhesion switches on while unloading
REFERENCE_SPEED = 0.4  # m/s, of `speed-dependent-restitution`
REFERENCE_PRESSURE = 1e6  # Pa, of `pressure-dependent-restitution` and `x-pressure-power`
TIGHT: Any = 1e-14  # relative tolerance of roots
CHANNELS = ("normal_force", "depression", "pressure")

NULLS = {
    "polytropic-gas": {"n": 1.0}, "ambient-pressure": {"p_a": 0.0}, "wall-stiffness": {"k_w": 0.0, "q": 1.0},
    "membrane-area": {"alpha": 0.0}, "inflation-growth": {"beta": 0.0}, "gas-leak": {"lambda": 0.0},
    "viscoelastic-wall": {"k_v": 0.0, "tau": math.inf}, "viscous-dashpot": {"c_v": 0.0}, "adhesion": {"tau_a": 0.0},
    "arm-servo": {"k_s": 0.0}, "speed-dependent-restitution": {"p": 0.0}, "pressure-dependent-restitution": {"p": 0.0},
    "stress-softening": {"sigma_m": 0.0, "j_0": 1.0}, "sensor-highpass": {"tau_s": math.inf}, "sensor-lag": {"T": 0.0},
    "sensor-filter": {"f_c": math.inf}, "sensor-gain": {"g": 1.0},
    "sensor-resonance": {"f_0": math.inf, "zeta": 0.05}, "sensor-hysteresis": {"h": 0.0, "w": 20.0},
    # outside the catalogue
    "x-end-stop": {"k": 0.0, "depth": math.inf, "exponent": 1.5}, "x-ringing": {"A": 0.0, "f": 70.0, "decay": 0.0},
    "x-arm-vibration": {"force": 0.0, "f": 70.0}, "x-pressure-power": {"s": 0.0},
    "x-rate-hardening": {"h": 0.0, "w_0": 0.1},
}  # fmt: skip


def complete_effects(effects, nulls=NULLS):
    """Return the parameters of every known effect, those not named at their null.

    Raises ValueError for an id or a parameter that does not exist.
    """
    for name, values in effects.items():
        if name not in nulls or not set(values) <= set(nulls[name]):
            raise ValueError(f"there is no effect {name!r} with parameters {', '.join(values)}")
    return {name: null | {symbol: float(x) for symbol, x in effects.get(name, {}).items()}
            for name, null in nulls.items()}  # fmt: skip


def solve_damping(restitution, approach_speed):
    """Return c_n (s/m) for which Hunt-Crossley damping realises the restitution exactly.

    Solves kappa - ln(1 + kappa) = -kappa e - ln(1 - kappa e) with kappa = c_n v_1, which holds for any
    spring law. The unknown is u = -ln(1 - kappa e), so that no logarithm meets its singularity.
    """
    e = float(restitution)
    if not 0.0 < e <= 1.0:
        raise ValueError(f"restitution {e} lies outside (0, 1]")
    if e == 1.0:
        return 0.0

    def unbalance(u):
        kappa = -math.expm1(-u) / e
        return (kappa * (1.0 + e) - math.log1p(kappa) - u) / kappa**2

    small = 1.5 * (1.0 - e**2) / (1.0 + e**3)  # leading order of the root
    u: Any = brentq(unbalance, -math.log1p(-min(0.2 * small * e, 0.1)), 1.0 / e + 2.0, xtol=1e-15, rtol=TIGHT)
    return -math.expm1(-u) / e / approach_speed


def measure_disc(depression, diameter, alpha=0.0, coefficient=0.25):
    """Return the radius b (m) of the flat contact disc.

    b = (1 - alpha) pi coefficient delta + alpha b_area; the perimeter of the section is kept for
    coefficient 1/4 (text before Eq. 2), b_area solves 2 b^2 + pi b d + d^2 = D^2, d = D - delta.
    """
    height = diameter - depression
    spare = diameter**2 - height**2
    by_area = 2.0 * spare / (math.pi * height + math.sqrt((math.pi * height) ** 2 + 8.0 * spare))
    return (1.0 - alpha) * math.pi * coefficient * depression + alpha * by_area


def measure_volume(radius, height):
    """Return V' (m3) of the racetrack's solid of revolution: 2 pi (b^2 r + pi b r^2/2 + 2 r^3/3), r = d/2."""
    r = 0.5 * height
    return 2.0 * math.pi * (radius**2 * r + 0.5 * math.pi * radius * r**2 + 2.0 * r**3 / 3.0)


class Impact:
    """One impact's constants, gathered from base parameters, effects and conditions.

    base: effective_mass (kg), restitution (-), optionally outer_diameter (m), contact_coefficient (-), doubled_core (1
    where the cylinder under the disc counts twice in the volume, as Eq. 2 prints it).
    conditions: initial_pressure (Pa, absolute), approach_speed (m/s), sequence (1 for the first).
    """

    def __init__(self, base, effects, conditions):
        self.effects = x = complete_effects(effects)
        self.mass = float(base["effective_mass"])
        self.pressure = float(conditions["initial_pressure"])
        self.speed = float(conditions["approach_speed"])
        self.sequence = float(conditions.get("sequence", 1))
        self.coefficient = float(base.get("contact_coefficient", 0.25))
        self.core = float(base.get("doubled_core", 0.0))
        growth = 1.0 + x["inflation-growth"]["beta"] * self.pressure / ELASTIC_MODULUS
        self.diameter = float(base.get("outer_diameter", OUTER_DIAMETER)) * growth
        self.volume = math.pi * self.diameter**3 / 6.0
        restitution = float(base["restitution"])
        restitution *= (self.speed / REFERENCE_SPEED) ** -x["speed-dependent-restitution"]["p"]
        restitution *= (self.pressure / REFERENCE_PRESSURE) ** -x["pressure-dependent-restitution"]["p"]
        self.damping = solve_damping(restitution, self.speed)
        soft = x["stress-softening"]
        self.factor = 1.0 - soft["sigma_m"] * -math.expm1(-(self.sequence - 1.0) / soft["j_0"])
        self.factor *= (self.pressure / REFERENCE_PRESSURE) ** x["x-pressure-power"]["s"]
        self.hold_back: Any = None  # friction in the gauge (N) as a function of time in contact, once that is known

    def measure_disc(self, depression):
        """Return the radius (m) of the flat contact disc."""
        return measure_disc(depression, self.diameter, self.effects["membrane-area"]["alpha"], self.coefficient)

    def find_gas_pressure(self, time, depression):
        """Return P' (Pa) in contact: P0 m (V0/V')^n, m = exp(-lambda t)."""
        b, height = self.measure_disc(depression), self.diameter - depression
        ratio = self.volume / (measure_volume(b, height) + self.core * math.pi * b**2 * height)
        fraction = math.exp(-self.effects["gas-leak"]["lambda"] * time)
        return self.pressure * fraction * ratio ** self.effects["polytropic-gas"]["n"]

    def find_spring_force(self, time, depression, rate):
        """Return F_k (N) of Eq. 4 with everything that Hunt-Crossley damping multiplies."""
        x = self.effects
        pressure = self.find_gas_pressure(time, depression)
        force = (pressure - x["ambient-pressure"]["p_a"]) * math.pi * self.measure_disc(depression) ** 2
        if x["wall-stiffness"]["k_w"]:
            force += x["wall-stiffness"]["k_w"] * depression ** x["wall-stiffness"]["q"]
        stop, hardening = x["x-end-stop"], x["x-rate-hardening"]
        force += stop["k"] * max(depression - stop["depth"], 0.0) ** stop["exponent"]
        return force * self.factor * (1.0 + hardening["h"] * math.tanh(rate / hardening["w_0"]))

    def find_contact_force(self, time, depression, rate, branch):
        """Return F_n (N) in contact: clamp of the pushing terms, then adhesion."""
        x, depression = self.effects, max(depression, 0.0)
        push = self.find_spring_force(time, depression, rate) * (1.0 + self.damping * rate)
        push += branch + x["viscous-dashpot"]["c_v"] * rate
        force = max(push, 0.0)
        if x["adhesion"]["tau_a"]:
            share = 0.5 * (1.0 - math.tanh(rate / ADHESION_RATE))
            force -= x["adhesion"]["tau_a"] * math.pi * self.measure_disc(depression) ** 2 * share
        return force

    def ring(self, time, force):
        """Return F (1 + A exp(-decay t) sin(2 pi f t)), by the gauge's mount, less the friction in the gauge."""
        x = self.effects["x-ringing"]
        swung = force * (1.0 + x["A"] * math.exp(-x["decay"] * time) * math.sin(2.0 * math.pi * x["f"] * time))
        return swung - (self.hold_back(time) if self.hold_back else 0.0)

    def list_second_order(self):
        """Return (frequency, damping ratio) of what follows the force as a mass on a damped spring does."""
        ringing, filtering = self.effects["sensor-resonance"], self.effects["sensor-filter"]
        pairs = (ringing["f_0"], ringing["zeta"]), (filtering["f_c"], math.sqrt(0.5))
        return [pair for pair in pairs if math.isfinite(pair[0])]

    def sense(self, force, leaked, lagged, swing=()):
        """Return rates of the gauge's states, and its reading, for the force that acts on it.

        swing: of a gauge that rings, F_r of F_r'' / w_0^2 + 2 zeta F_r' / w_0 + F_r = F, w_0 = 2 pi f_0, and
        F_r' / w_0, then the same of a filter of second order, which sees F_r; F_r is F without; leaked: y of
        dy/dt = (F_r - y)/tau_s; lagged: F_m of T dF_m/dt = (F_r - y) - F_m; reading g F_m.
        """
        x, rates = self.effects, []
        for frequency, damping in self.list_second_order():
            swung, speed, *swing = swing
            turn = 2.0 * math.pi * frequency
            rates += [turn * speed, turn * (force - swung - 2.0 * damping * speed)]
            force = swung
        passed, lag = force - leaked, x["sensor-lag"]["T"]
        lag_rate, reading = ((passed - lagged) / lag, lagged) if lag else (0.0, passed)
        return [passed / x["sensor-highpass"]["tau_s"], lag_rate, *rates], x["sensor-gain"]["g"] * reading

    def advance(self, time, state):
        """Return the rates of (delta, w, q, y, F_m) and `sense`'s swing in contact: m_eff dw/dt = -F_n + arm."""
        depression, rate, branch, leaked, lagged, *swing = state
        shake, wall = self.effects["x-arm-vibration"], self.effects["viscoelastic-wall"]
        force = self.find_contact_force(time, depression, rate, branch)
        arm = self.effects["arm-servo"]["k_s"] * (self.speed * time - depression)
        arm += shake["force"] * math.sin(2.0 * math.pi * shake["f"] * time)
        rates, _ = self.sense(self.ring(time, force), leaked, lagged, swing)
        return [rate, (arm - force) / self.mass, wall["k_v"] * rate - branch / wall["tau"], *rates]

    def guess_contact_time(self):
        """Return 4 (1.5 m v^2/(1.94 P0))^(1/3) / v (s), the time of an impact on F = 1.94 P0 delta^2."""
        return 4.0 * (1.5 * self.mass * self.speed**2 / (1.94 * self.pressure)) ** (1.0 / 3.0) / self.speed


def follow_friction(impact, end, solution):
    """Return friction in the gauge (N) as a function of time (s) in a contact of known motion, up to `end`.

    Dahl's law, dz/dF = (sgn(dF/dt) - z) sgn(dF/dt)/w, from one of 4001 instants to the next; a force that is there at
    once is a first step.
    """
    x = impact.effects["sensor-hysteresis"]
    times = 0.5 * end * (1.0 - np.cos(np.pi * np.arange(4001) / 4000))
    force = [impact.ring(time, impact.find_contact_force(time, *state[:3]))
             for time, state in zip(times, solution(times).T, strict=True)]
    state, found = 0.0, []
    for step in np.diff(force, prepend=0.0):
        way = math.copysign(1.0, step)
        state = way - (way - state) * math.exp(-abs(step) / x["w"])
        found.append(x["h"] * x["w"] * state)
    return lambda time: np.interp(time, times, found)


def integrate_contact(impact, end, rtol=1e-11, atol=1e-13, parts=60):
    """Return (dense solution, separation time or None) of one contact from first touch to separation or `end`.

    delta(0) = 0, w(0) = v1, everything else zero; separation is the return of delta to zero. A step is at most the
    guessed contact time over `parts`.
    """

    def separate(_, state):
        return state[0]

    separate.terminal, separate.direction = True, -1.0
    swing = [0.0, 0.0] * len(impact.list_second_order())
    scale = np.array([1.0, 1.0, 1e3, 1e3, 1e3] + [1e3 for _ in swing])
    solution = solve_ivp(impact.advance, (0.0, end), [0.0, impact.speed, 0.0, 0.0, 0.0, *swing], method="DOP853",
                         dense_output=True, events=separate, rtol=rtol, atol=atol * scale,
                         max_step=impact.guess_contact_time() / parts)
    if not solution.success:
        raise RuntimeError(solution.message)
    separation = solution.t_events[0][0] if solution.t_events[0].size else None
    if impact.effects["sensor-hysteresis"]["h"] and impact.hold_back is None:
        # The motion does not know of the gauge: only the states of filters behind it are others now.
        impact.hold_back = follow_friction(impact, end if separation is None else separation, solution.sol)
        return integrate_contact(impact, end, rtol, atol, parts)
    return solution.sol, separation


def simulate(base, effects, conditions, times, channels=("normal_force",), rtol=1e-11, parts=60):
    """Return the noise-free record, an array (len(times), len(channels)).

    base, conditions: see `Impact`; effects: catalogue id -> {symbol: value}; times: s, increasing, first touch
    at 0; channels out of normal_force (N), depression (m), pressure (Pa); parts: see `integrate_contact`.
    """
    impact, times = Impact(base, effects, conditions), np.asarray(times, dtype=float)
    columns = {"normal_force": np.zeros(times.size), "depression": np.zeros(times.size),
               "pressure": np.full(times.size, impact.pressure)}  # fmt: skip
    if times.size and times[-1] > 0.0:
        solution, separation = integrate_contact(impact, times[-1], rtol, parts=parts)
        end = math.inf if separation is None else separation
        at, gone = np.flatnonzero((times > 0.0) & (times < end)), np.flatnonzero(times >= end)
        for i, (depression, rate, branch, leaked, lagged, *swing) in zip(at, solution(times[at]).T, strict=True):
            force = impact.ring(times[i], impact.find_contact_force(times[i], depression, rate, branch))
            columns["normal_force"][i] = impact.sense(force, leaked, lagged, swing)[1]
            columns["depression"][i] = depression
            columns["pressure"][i] = impact.find_gas_pressure(times[i], max(depression, 0.0))
        if gone.size:  # no force acts on the gauge any more but its own friction, and none on the gas
            columns["pressure"][gone] = impact.pressure * math.exp(-impact.effects["gas-leak"]["lambda"] * end)

            def sense_nothing(gauge):
                leaked, lagged, *swing = gauge
                return impact.sense(impact.ring(end, 0.0), leaked, lagged, swing)

            tail = solve_ivp(lambda _, gauge: sense_nothing(gauge)[0], (0.0, times[-1] - end), solution(end)[3:],
                             method="DOP853", t_eval=times[gone] - end, rtol=rtol, atol=1e-11)
            columns["normal_force"][gone] = [sense_nothing(gauge)[1] for gauge in tail.y.T]
    return np.column_stack([columns[name] for name in channels])
