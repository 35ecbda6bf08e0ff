r"""The paper's rocket stage in free rotation (Section 5, Figures 16 and 17): what its printed momentum decides.

Tables 5 and 6 print the angular momentum, Section 5 mass and size. Neither the attitude nor the angular velocity is
printed. Here the body frame coincides with the base frame $OXYZ$ at t = 0, so that the rates are $\omega_0 = I^{-1} L$.
"""

import dataclasses as dc

import jax.numpy as jnp
import numpy as np

from .._rotation import measure_turn
from ..dynamics.angles import measure_motion, measure_precession
from ..dynamics.bodies import Cylinder
from ..dynamics.elliptic import quarter_period
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import Tumble, trace_point
from ..dynamics.tumbling import simulate_tumbling
from .shipped import find_data


DURATION, STEP = 2000.0, 0.2  # s, section 5: 10,000 steps
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])


@dc.dataclass(frozen=True)
class Momentum:
    """One of Tables 5 and 6, base-frame components.

    Attributes:
        before, after: the impact, shape (3,) [N m s].
    """

    before: np.ndarray
    after: np.ndarray

    @property
    def share(self) -> float:
        """|L| after the impact over |L| before [-]."""
        return float(np.linalg.norm(self.after) / np.linalg.norm(self.before))

    @property
    def turn(self) -> float:
        """Angle between the two [rad]."""
        return measure_angle(self.before, self.after)


@dc.dataclass(frozen=True)
class Course:
    """Free motion of the stage.

    Attributes:
        motion: times, attitudes, rates.
        angles: precession, nutation and spin about the momentum, without jumps, shape (times, 3) [rad].
        precession_rate: shape (times,) [rad/s].
        path: of the end-face centre A in the base frame, shape (times, 3) [m].
        tilt: angle between the stage's axis and the base frame's Z, shape (times,) [rad].
    """

    motion: Tumble
    angles: np.ndarray
    precession_rate: np.ndarray
    path: np.ndarray
    tilt: np.ndarray


def read_momentum(name: str) -> Momentum:
    """Angular momentum of `table-5` or `table-6`."""
    import pandas as pd

    rows = pd.read_csv(find_data(f"paper/{name}") / "angular-momentum.csv").set_index("axis").loc[["x", "y", "z"]]
    before, after = (1e-3 * rows[f"angular_momentum_{when}"].to_numpy(float) for when in ("before", "after"))
    return Momentum(before, after)


def measure_angle(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two vectors, 0 to pi, with all digits also where it is small [rad]."""
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def vary_moments(asymmetry: float) -> np.ndarray:
    r"""Principal moments $(I_t (1 + \epsilon), I_t (1 - \epsilon), I_a)$ of the stage, shape (3,) [kg m²]."""
    return np.diag(np.asarray(Cylinder().inertia())) * [1.0 + asymmetry, 1.0 - asymmetry, 1.0]


def follow_stage(momentum: np.ndarray, moments: np.ndarray, times: np.ndarray) -> Course:
    """Free motion in closed form from the assumed attitude.

    Args:
        momentum: in the base frame, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²].
        times: from 0 on, shape (times,) [s].
    """
    motion = propagate_torque_free(moments, UNTURNED, momentum / moments, times)
    inertia = jnp.asarray(moments)
    path = np.asarray(trace_point(motion.attitude, Cylinder().end_face()))
    angles = np.asarray(measure_motion(inertia, motion.attitude, motion.angular_velocity))
    rate = np.asarray(measure_precession(inertia, motion.angular_velocity))
    tilt = np.arctan2(np.hypot(path[:, 0], path[:, 1]), path[:, 2])
    return Course(motion, np.unwrap(angles, axis=0), rate, path, tilt)


def integrate_stage(momentum: np.ndarray, moments: np.ndarray, times: np.ndarray) -> Tumble:
    """The same motion by the integrator; arguments as of `follow_stage`."""
    return simulate_tumbling(moments, UNTURNED, momentum / moments, times)


def compare_motions(first: Tumble, second: Tumble) -> tuple[float, float]:
    """Largest angle between the attitudes [rad] and largest difference of a rate [rad/s] at the same times."""
    apart = measure_turn(first.attitude, second.attitude)
    return float(jnp.max(apart)), float(jnp.max(jnp.abs(first.angular_velocity - second.angular_velocity)))


def limit_nutation(momentum: np.ndarray, moments: np.ndarray) -> tuple[float, float]:
    r"""Smallest and largest nutation angle of a stage whose axial moment is the least.

    The momentum crosses the planes $L_x = 0$ and $L_y = 0$ of the body, where $|L|$ and $2E$ leave
    $L_z^2 = (2E - L^2/I_i)/(1/I_z - 1/I_i)$ with $i = y$ and $i = x$.

    Args:
        momentum: body components at any time, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²]; the momentum must circle body z.

    Returns:
        Two angles, 0 to pi/2 [rad].
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    along = (double - square / moments[:2]) / (1.0 / moments[2] - 1.0 / moments[:2])
    angles = np.arccos(np.sqrt(along / square))
    return float(angles.min()), float(angles.max())


def time_nutation(momentum: np.ndarray, moments: np.ndarray) -> float:
    r"""Period of the nutation angle, $2 K(m)/p$ [s]; its limit for equal transverse moments is $\pi I_t/((I_t - I_a)
    |\omega_z|)$.

    With $I_1 \ge I_2 > I_3$: $p^2 = (2E I_1 - L^2)(I_2 - I_3)/(I_1 I_2 I_3)$,
    $m = (I_1 - I_2)(L^2 - 2E I_3)/((I_2 - I_3)(2E I_1 - L^2))$ (Landau and Lifshitz, Mechanics, section 37).

    Args:
        momentum: body components at any time, shape (3,) [N m s].
        moments: principal ones, shape (3,) [kg m²]; the momentum must circle the axis of the least.
    """
    square, double = momentum @ momentum, momentum @ (momentum / moments)
    small, middle, large = np.sort(moments)
    excess = double * large - square
    pace = np.sqrt(excess * (middle - small) / (small * middle * large))
    parameter = (large - middle) * (square - double * small) / ((middle - small) * excess)
    return float(2.0 * quarter_period(jnp.asarray(1.0 - parameter)) / pace)
