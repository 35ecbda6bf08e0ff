"""An independent simulator of tumbling records: NumPy and SciPy, nothing of the package.

Euler's equations in a form of its own: angular momentum and attitude matrix in the inertial frame, not rates and
quaternion in the body frame. Moments and torques are per unit transverse inertia. At t = 0 the body frame coincides
with an inertial frame whose x axis is the local vertical and whose z axis is the orbit normal.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation


RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
ATTITUDES = ("attitude_w", "attitude_x", "attitude_y", "attitude_z")


def sum_torques(effects, time, rates, matrix, moments, orbit_rate):
    """Torque on the body without that of the inner sphere, body components; `matrix` turns body into inertial ones."""
    total = np.zeros(3)
    for name, p in effects.items():
        if name == "eddy-current":
            total -= p["k_e"] * (np.array([1.0, 1.0, p.get("axial", 1.0)]) * rates)
        elif name == "quadratic-drag":
            total -= p["k"] * np.linalg.norm(rates) * np.array([1.0, 1.0, p.get("axial", 1.0)]) * rates
        elif name == "constant-torque":
            total += np.asarray(p["torque"])
        elif name == "gravity-gradient":
            up = matrix.T @ np.array([np.cos(orbit_rate * time), np.sin(orbit_rate * time), 0.0])
            total += 3.0 * p["scale"] * orbit_rate**2 * np.cross(up, moments * up)
        elif name == "x-quadratic-drag":
            total -= p["k"] * np.linalg.norm(rates) * rates
        elif name == "x-thruster":
            total += np.asarray(p["torque"]) * np.sign(np.sin(2.0 * np.pi * time / p["period"]))
        elif name == "x-sine-torque":
            total += np.asarray(p["torque"]) * np.sin(2.0 * np.pi * time / p["period"])
        elif name == "x-growing-torque":
            total += np.asarray(p["slope"]) * time
        elif name == "x-solar-torque":  # fixed in the inertial frame
            total += matrix.T @ np.asarray(p["torque"])
    return total


def simulate_tumbling(base, effects, rates, times, orbit_rate=0.00106, tolerance=1e-12):
    """Return what the gyroscopes read, shape (samples, 3) [rad/s], and the attitude, shape (samples, 4).

    base: inertia_ratio. effects: by id, with parameters. rates: true, at t = 0 [rad/s]. times: ascending from 0 [s].
    """
    epsilon = effects.get("inertia-asymmetry", {}).get("epsilon", 0.0)
    moments = np.array([1.0 + epsilon, 1.0 - epsilon, base["inertia_ratio"]])  # of the body, over the transverse one
    damper = effects.get("internal-damper", {"c": 0.0, "I_d": 1.0})
    times = np.asarray(times, dtype=float)
    start = np.asarray(rates, dtype=float)

    def differ(time, state):
        matrix, momentum, inner = state[:9].reshape(3, 3), state[9:12], state[12:]
        body = (matrix.T @ momentum) / moments
        drag = damper["c"] * (matrix @ body - inner)  # inertial components: what the sphere gains, the body loses
        torque = matrix @ sum_torques(effects, time, body, matrix, moments, orbit_rate) - drag
        skew = np.array([[0.0, -body[2], body[1]], [body[2], 0.0, -body[0]], [-body[1], body[0], 0.0]])
        return np.concatenate([(matrix @ skew).ravel(), torque, drag / damper["I_d"]])

    first = np.concatenate([np.eye(3).ravel(), moments * start, start])
    scale = np.concatenate([np.ones(9), np.full(6, np.linalg.norm(start))])
    half = 0.5 * effects.get("x-thruster", {"period": np.inf})["period"]
    jumps = np.arange(half, times[-1], half) if half < times[-1] else []  # of the torque
    edges = [0.0, *jumps, max(float(times[-1]), 1e-9)]
    states, state = np.zeros((times.size, 15)), first
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        here = (times >= a) & (times <= b)
        inside = (a + 1e-9, b - 1e-9) if len(jumps) else (a, b)  # the torque is that of this side of a jump
        found = solve_ivp(lambda t, y, low, high: differ(min(max(t, low), high), y), (a, b), state, "DOP853",
                          t_eval=np.unique(np.append(times[here], b)), rtol=tolerance, atol=tolerance * scale,
                          args=inside)  # fmt: skip
        states[here] = found.y.T[: here.sum()]
        state = found.y[:, -1]
    matrices = states[:, :9].reshape(-1, 3, 3)
    body = np.einsum("tij,ti->tj", matrices, states[:, 9:12]) / moments
    if "x-flexible-panel" in effects:  # it rings after release, and turns the body about its x axis
        panel = effects["x-flexible-panel"]
        wave = panel["ratio"] * np.linalg.norm(body[0]) * np.exp(-panel["zeta"] * panel["omega"] * times)
        body = body + (wave * np.sin(panel["omega"] * times))[:, None] * np.array([1.0, 0.0, 0.0])
    quaternions = Rotation.from_matrix(matrices).as_quat()[:, [3, 0, 1, 2]]
    return read_gyroscopes(effects, times, body), np.where(quaternions[:, :1] < 0, -quaternions, quaternions)


def read_gyroscopes(effects, times, body):
    """Misalignment, scale and bias, in that order."""
    tilt = {"angle_x": 0.0, "angle": 0.0, "angle_z": 0.0} | effects.get("axis-misalignment", {})
    angle = tilt["angle"]
    turned = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    if tilt["angle_x"] or tilt["angle_z"]:  # about all three axes at once
        turned = expm(np.cross(np.eye(3), [tilt["angle_x"], angle, tilt["angle_z"]]))
    seen = body @ turned  # R^T on every row
    seen = seen * (1.0 + effects.get("gyro-scale", {}).get("g", 0.0))
    seen = seen + np.asarray(effects.get("gyro-bias", {}).get("bias", [0.0, 0.0, 0.0]))
    return seen + np.outer(times, effects["x-bias-walk"]["slope"]) if "x-bias-walk" in effects else seen
