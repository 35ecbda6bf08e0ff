"""Attitude motion of debris by integration, with any torque."""

from collections.abc import Callable
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from .._errors import ComputationError, InputError
from .._numerics import is_known, stop
from .._rotation import normalise, turn
from .rigid import Tumble, accelerate, read_start


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
