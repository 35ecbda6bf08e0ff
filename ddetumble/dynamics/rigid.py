"""Rigid body about its centre of mass: Euler's equations, their integration, energy, angular momentum, a motion."""

from collections.abc import Callable
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._errors import ComputationError, InputError
from .._numerics import is_known, stop
from .._rotation import normalise, rotate, turn


@final
class Tumble(eqx.Module):
    r"""Attitude motion $q(t), \omega(t)$ at the wanted times.

    Attributes:
        time: shape (times,) [s].
        attitude: unit quaternions, scalar first, body to inertial, shape (times, 4) [-].
        angular_velocity: body components, shape (times, 3) [rad/s].
        failed: whether the motion could not be computed (too many steps, or not finite).
        steps: integration steps taken; 0 for a closed form.
    """

    time: Float[Array, " times"]
    attitude: Float[Array, "times 4"]
    angular_velocity: Float[Array, "times 3"]
    failed: Bool[Array, ""]
    steps: Array


def accelerate(inertia: Array, angular_velocity: Array, torque: Array, inverse: Array) -> Array:
    r"""Euler's equations, $\dot\omega = I^{-1} (\tau - \omega \times I \omega)$, body components, (3,) [rad/s²].

    `inverse` is that of the inertia (3, 3), torque [N m].
    """
    return inverse @ (torque - jnp.cross(angular_velocity, inertia @ angular_velocity))


def measure_energy(inertia: Array, angular_velocity: Array) -> Array:
    r"""Energy of rotation $E = \frac{1}{2} \omega \cdot I \omega$, shapes (3, 3), (..., 3) to (...) [J]."""
    inertia = to_tensor(inertia)
    return 0.5 * jnp.sum(angular_velocity * (angular_velocity @ inertia), axis=-1)


def measure_momentum(inertia: Array, attitude: Array, angular_velocity: Array) -> Array:
    r"""Angular momentum in the inertial frame, $L = q \otimes I\omega \otimes q^*$, shape (..., 3) [N m s].

    Inertia (3, 3) or three principal moments [kg m²], attitude (..., 4), angular velocity, body components, (..., 3)
    [rad/s].
    """
    return rotate(attitude, angular_velocity @ to_tensor(inertia))


def trace_point(attitude: Array, point: Array) -> Array:
    """Path of a point of the body in the inertial frame, (times, 3) [m], such as A of an end face (Figures 16 and 17).

    The centre of mass lies at the origin. Attitude (times, 4); the point from there, body components, (3,) [m].
    """
    return rotate(attitude, jnp.broadcast_to(jnp.asarray(point, dtype=float), (*attitude.shape[:-1], 3)))


def to_tensor(inertia: Any) -> Array:
    """Inertia tensor of a tensor or of three principal moments along the body axes, shape (3, 3) [kg m²]."""
    inertia = jnp.asarray(inertia, dtype=float)
    return jnp.diag(inertia) if inertia.ndim == 1 else 0.5 * (inertia + inertia.T)


def read_start(inertia: Any, attitude: Any, angular_velocity: Any, times: Any) -> tuple[Array, Array, Array, Array]:
    """Inertia tensor, unit quaternion, angular velocity and times that a motion starts from, checked where known: a
    wrong shape, a number that is not finite, an inertia tensor that no body has, a quaternion that is zero, and times
    that do not ascend are refused.
    """
    given = {"inertia": (inertia, ((3,), (3, 3))), "attitude": (attitude, ((4,),)),
             "angular_velocity": (angular_velocity, ((3,),))}
    for name, (value, shapes) in given.items():
        if np.shape(value) not in shapes:
            wanted = " or ".join(str(shape) for shape in shapes)
            raise InputError(f"{name} must have the shape {wanted}; got {np.shape(value)}")
        if is_known(value) and not np.all(np.isfinite(np.asarray(value, dtype=float))):
            raise InputError(f"{name} must be finite; got {np.asarray(value).tolist()}")
    if is_known(inertia):
        check_inertia(np.asarray(inertia, dtype=float))
    if is_known(attitude) and not np.any(np.asarray(attitude)):
        raise InputError("attitude must be a non-zero quaternion; (1, 0, 0, 0) is no rotation")
    if np.ndim(times) != 1 or not np.size(times):
        raise InputError(f"times must be a row of at least one time; got the shape {np.shape(times)}")
    if is_known(times):
        known = np.asarray(times, dtype=float)
        if not np.all(np.isfinite(known)) or np.any(np.diff(known) < 0):
            raise InputError("times must be finite and ascending [s]")
    quaternion = jnp.asarray(attitude, dtype=float)
    return (to_tensor(inertia), quaternion / jnp.linalg.norm(quaternion),
            jnp.asarray(angular_velocity, dtype=float), jnp.asarray(times, dtype=float))


def check_inertia(inertia: np.ndarray) -> None:
    """Raise `InputError` for an inertia tensor (3, 3), or three principal moments, that no rigid body has.

    That is one not symmetric, not positive definite, or of one principal moment above the sum of the other two by more
    than rounding.
    """
    if inertia.ndim == 2:
        if not np.allclose(inertia, inertia.T, rtol=0.0, atol=1e-9 * np.max(np.abs(inertia))):
            raise InputError(f"inertia must be symmetric; got {inertia.tolist()} kg m²")
        moments = np.linalg.eigvalsh(0.5 * (inertia + inertia.T))
    else:
        moments = np.sort(inertia)
    told = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] <= 0:
        raise InputError(f"inertia must be positive definite; its principal moments are {told} kg m²")
    if moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
        raise InputError(f"inertia must satisfy the triangle inequality, no principal moment above the sum of the "
                         f"other two; they are {told} kg m²")


RTOL, ATOL = 1e-14, 1e-14  # near rounding: the integrator is the reference that the closed form is compared with
MAX_STEPS = 1_000_000  # large, so that it ends only what would not end

Torque = Callable[[Array, Array, Array], Array]


def simulate_tumbling(inertia: Any, attitude: Any, angular_velocity: Any, times: Any, torque: Torque | None = None, *,
           start: Any = 0.0, adjoint: dfx.AbstractAdjoint | None = None, rtol: float = RTOL, atol: float = ATOL,
           max_steps: int = MAX_STEPS) -> Tumble:
    r"""Integrate the attitude and Euler's equations, $\dot q = \frac12 q \otimes \omega$,
    $I \dot\omega = \tau - \omega \times I \omega$.

    Dormand and Prince's method of order 8 with steps that end at the wanted times, so that nothing is interpolated. The
    default tolerance keeps energy and angular momentum to about 1e-12 over 10,000 s. Batch with `jax.vmap`.
    Without torque, `coast` gives the same in closed form, whatever the time.

    Args:
        inertia: about the centre of mass, body components, shape (3, 3), or three principal moments [kg m²].
        attitude: at the start, quaternion, scalar first, body to inertial, shape (4,) [-].
        angular_velocity: at the start, body components, shape (3,) [rad/s].
        times: ascending from `start` on, shape (times,) [s].
        torque: function of time [s], attitude (4,) and angular velocity (3,) that gives the torque in body components,
            shape (3,) [N m]; an equinox module keeps its numbers differentiable and is not compiled again for new ones.
        start: time at the start [s].
        adjoint: of diffrax; the default carries reverse mode, `diffrax.ForwardMode()` forward mode.
        rtol, atol: tolerances, in units of the starting rate (1 rad/s where that is zero).
        max_steps: steps after which the integration counts as failed.

    Returns:
        A `Tumble`; look at `failed` under `jax.jit` or `jax.vmap`.

    Raises:
        InputError: as `read_start` says.
        ComputationError: where the integration fails and its outcome can be looked at.
    """
    tensor, quaternion, rate, known = read_start(inertia, attitude, angular_velocity, times)
    if is_known((start, known)) and float(known[0]) < float(start):
        raise InputError(f"times must not lie before start = {float(start):.6g} s; got {float(known[0]):.6g} s")
    adjoint = dfx.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    result = _integrate(tensor, quaternion, rate, known, torque, jnp.asarray(start, dtype=float), adjoint,
                        (jnp.asarray(rtol), jnp.asarray(atol)), max_steps)
    if is_known(result.failed) and result.failed.ndim == 0 and bool(result.failed):
        raise ComputationError(f"the attitude could not be integrated: {int(result.steps)} steps of {max_steps} were "
                               "taken; torque and rates must stay finite, and a longer time needs a larger max_steps")
    return result


@eqx.filter_jit
def _integrate(inertia: Array, attitude: Array, rate: Array, times: Array, torque: Torque | None, start: Array,
               adjoint: dfx.AbstractAdjoint, tolerances: tuple[Array, Array], max_steps: int) -> Tumble:
    """Integrate in units of the starting rate, so that the tolerances mean the same at any speed."""
    size = stop(jnp.sqrt(jnp.sum(rate**2)))
    unit = jnp.where(size > 0, size, 1.0)
    inverse = jnp.linalg.inv(inertia)

    def field(t, y, args):
        unit, inertia, inverse, torque = args
        q, w = y[:4], y[4:] * unit
        moment = jnp.zeros(3) if torque is None else torque(t, q, w)
        return jnp.concatenate([turn(q, w), accelerate(inertia, w, moment, inverse) / unit])

    rtol, atol = tolerances
    # From the first to the last time in steps that end at the wanted ones.
    controller = dfx.ClipStepSizeController(dfx.PIDController(rtol=rtol, atol=atol), step_ts=stop(times))
    solution = dfx.diffeqsolve(
        dfx.ODETerm(field), dfx.Dopri8(), t0=start, t1=times[-1], dt0=None,
        y0=jnp.concatenate([attitude, rate / unit]), args=(unit, inertia, inverse, torque),
        saveat=dfx.SaveAt(ts=times), stepsize_controller=controller, max_steps=max_steps, adjoint=adjoint, throw=False)
    assert solution.ys is not None
    quaternions, rates = normalise(solution.ys[:, :4]), solution.ys[:, 4:] * unit
    failed = (solution.result != dfx.RESULTS.successful) | ~jnp.all(jnp.isfinite(solution.ys))
    return Tumble(times, quaternions, rates, failed, solution.stats["num_steps"])
