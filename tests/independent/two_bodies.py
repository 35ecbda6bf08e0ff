"""A ball of the paper's against a tumbling cylinder by SciPy: rotation matrices, Newton's and Euler's equations.

Nothing of the package is used. The ball is that of 60 mm of Eqs. 2 to 4 with Hunt-Crossley damping whose constant gives
the restitution, on an arm of one apparent mass; friction is Coulomb's with a creep speed, and gas may leak.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


REST = np.zeros(3)
DIAMETER, CREEP = 0.06, 0.01  # [m], [m/s]


class Contact(NamedTuple):
    """One contact, and both bodies at separation."""

    duration: float  # [s]
    rates: np.ndarray  # of the debris, body components [rad/s]
    body: np.ndarray  # velocity of its centre of mass [m/s]
    tip: np.ndarray  # velocity of the ball [m/s]
    momentum: np.ndarray  # angular, of the debris about its centre of mass, inertial [N m s]
    place: np.ndarray  # of contact, body components [m]
    frame: np.ndarray  # rotation matrix, body to inertial
    depths: np.ndarray  # depression at 4001 instants [m]
    loads: np.ndarray  # normal force there [N]


def solve_damping(restitution, speed):
    """c_n of the closed form [s/m]."""
    def gap(k):
        return k - np.log1p(k) + k * restitution + np.log1p(-k * restitution)
    return brentq(gap, 1e-6, (1 - 1e-13) / restitution) / speed


def cross_matrix(w):
    """w x as a matrix."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def coast(inertia, frame, rates, wait):
    """Rotation matrix and body rates after free motion of so many seconds."""
    def move(t, y):
        w = y[9:]
        return np.concatenate([(y[:9].reshape(3, 3) @ cross_matrix(w)).ravel(),
                               np.linalg.solve(inertia, -np.cross(w, inertia @ w))])

    y = solve_ivp(move, (0.0, wait), np.concatenate([np.ravel(frame), rates]), method="DOP853", rtol=1e-11,
                  atol=1e-13).y[:, -1]
    left, _, right = np.linalg.svd(y[:9].reshape(3, 3))
    return left @ right, y[9:]


def integrate_pair(mass, friction, omega, point, velocity, inertia, debris_mass, pressure, restitution=0.7, span=1.0,
                   frame=None, end=0.0, leak=0.0):
    """One contact until the ball first leaves.

    The surface is the side of a cylinder of 1 m, or its end face at `end` [m] along its axis; `point` on it in body
    components, `velocity` of the ball where the centre of mass rests.
    """
    frame = np.eye(3) if frame is None else frame
    facing = np.array([*point[:2], 0.0]) / np.hypot(*point[:2]) if not end else np.array([0.0, 0.0, np.sign(end)])
    start = frame @ (point + 0.5 * DIAMETER * facing)
    speed = -(frame @ facing) @ (velocity - frame @ np.cross(omega, point))
    damping = solve_damping(restitution, speed)

    def look(y):
        turned = y[:9].reshape(3, 3)
        seen = turned.T @ (y[15:18] - y[12:15])
        across = np.hypot(*seen[:2])
        normal = facing if end else np.array([seen[0] / across, seen[1] / across, 0.0])
        away = abs(seen[2]) - abs(end) if end else across - 1.0
        n = turned @ normal
        return turned, y[9:12], n, 0.5 * DIAMETER - away, y[15:18] - away * n

    def press(t, y):
        turned, w, n, depth, contact = look(y)
        r = contact - y[12:15]
        relative = y[21:24] - y[18:21] - np.cross(turned @ w, r)
        rate = -n @ relative
        d = max(depth, 0.0)
        b, h = np.pi / 4 * d, (DIAMETER - d) / 2
        volume = 2 * np.pi * (b**2 * h + np.pi * b * h**2 / 2 + 2 * h**3 / 3)
        gas = pressure * np.exp(-leak * t) * np.pi * DIAMETER**3 / 6 / volume
        return turned, w, n, r, relative + rate * n, max(gas * np.pi * b**2 * (1 + damping * rate), 0.0)

    def move(t, y):
        turned, w, n, r, slip, load = press(t, y)
        force = friction * load * slip / np.hypot(np.linalg.norm(slip), CREEP) - load * n
        change = np.linalg.solve(inertia, turned.T @ np.cross(r, force) - np.cross(w, inertia @ w))
        return np.concatenate([(turned @ cross_matrix(w)).ravel(), change, y[18:24], force / debris_mass,
                               -force / mass])

    def leave(t, y):
        return look(y)[3] + (1e-9 if t < 1e-6 else 0.0)

    leave.terminal, leave.direction = True, -1
    first = np.concatenate([frame.ravel(), omega, REST, start, REST, velocity])
    found = solve_ivp(move, (0, span), first, method="DOP853", rtol=1e-11, atol=1e-13, events=leave, dense_output=True)
    last = found.y[:, -1]
    turned, w, _, _, contact = look(last)
    path = [(t, found.sol(t)) for t in np.linspace(0.0, found.t[-1], 4001)]
    return Contact(found.t[-1], w, last[18:21], last[21:24], turned @ inertia @ w, turned.T @ (contact - last[12:15]),
                   turned, np.array([look(y)[3] for _, y in path]), np.array([press(t, y)[-1] for t, y in path]))
