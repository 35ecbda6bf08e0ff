"""Contact onset of a raw force trace: when the force starts to rise, and how well that is known.

A ball that touches with a finite speed is met by a force that grows as the square of the time since touch
(F = P' π b² with b proportional to the depression), so the force at the onset is nought with a horizontal tangent:
a threshold always comes late. The rise is therefore extrapolated back to its foot.
"""

from dataclasses import dataclass

import numpy as np

from .._errors import InputError


FEWEST_BEFORE = 5
_REMEDY = "give the contact onset yourself with --onset (a time such as '12.5 ms', or the name of a column)"


@dataclass(frozen=True)
class Onset:
    """Where contact begins in a trace.

    Args:
        time: Time of first touch on the trace's own axis [s].
        sd: Its standard error [s].
        noise: Standard deviation of the force before contact [N].
        offset: Mean force before contact [N].
        threshold: Force that counts as certain contact [N].
        before: Number of samples before contact.
    """

    time: float
    sd: float
    noise: float
    offset: float
    threshold: float
    before: int


def find_onset(time, force, *, noise: float | None = None, reach: float = 0.5) -> Onset:
    """Find the contact onset of one impact.

    The samples before contact give offset and noise. The rise up to `reach` of the peak is fitted, together with them,
    with F = offset + a τ² (1 + b τ + c τ²), τ = t - t₀ > 0 (the further terms hold what damping and the falling speed
    do to the parabola). A wall or a dashpot makes the force start as a straight line instead, and which of the two it
    is is for the campaign to find out: half of the distance to the onset of a rise with a linear term is therefore part
    of the standard error, beside that of the fit. Where the samples clearly want the linear term, its onset
    is the one returned.

    Args:
        time: Sampling times, increasing, shape (samples,) [s].
        force: Normal force, positive while pressing, shape (samples,) [N]; NaN is left out.
        noise: Standard deviation of a sample [N], if known; otherwise taken from the samples before contact.
        reach: Share of the peak up to which the rise is used.

    Raises:
        InputError: No force above the noise, fewer than five samples before contact, or no rise to fit.
    """
    time, force = np.asarray(time, float), np.asarray(force, float)
    keep = np.isfinite(time) & np.isfinite(force)
    time, force = time[keep], force[keep]
    if len(time) < 2 * FEWEST_BEFORE:
        raise InputError(f"only {len(time)} samples: too few to find the contact onset; {_REMEDY}")
    first, last, offset, spread = _bracket(time, force, noise)
    height = force[last] - offset
    stop = first + int(np.argmax(force[first : last + 1] - offset >= reach * height)) + 1
    stop = min(max(stop, first + 3), last + 1)
    start = max(0, first - 4 * (stop - first) - 40)  # a long quiet time before says nothing about the rise
    t, f = time[start:stop], force[start:stop]
    step = float(np.median(np.diff(t)))
    foot = _foot(time, force, first, last, offset)
    low = max(t[0], foot - max(12 * step, 1.5 * (t[-1] - foot)))
    candidates = np.linspace(low, t[-2], 60)
    straight, straight_misfit, _ = _locate(t, f, candidates, (1, 2, 3))
    for terms in range(max(1, min(3, (stop - first) // 3)), 0, -1):  # fewer where the noise does not bear them all
        onset, misfit, gain = _locate(t, f, candidates, (2, 3, 4)[:terms])
        level = max(noise or spread, float(np.sqrt(misfit / max(len(t) - terms - 2, 1))), 1e-9 * height)
        statistical = level / np.sqrt(gain) if gain > 0 else np.inf
        error = float(np.sqrt(statistical**2 + 0.25 * (straight - onset) ** 2 + (0.02 * step) ** 2))
        if error < 0.3 * (time[last] - onset):
            break
    else:
        raise InputError(f"the force rises too little above its noise to tell the onset; {_REMEDY}")
    if misfit - straight_misfit > 16 * max(noise or spread, 1e-4 * height) ** 2:
        onset = straight  # the samples themselves say that the rise begins with a slope
    before = int(np.sum(time < onset))
    if before < FEWEST_BEFORE:
        raise InputError(f"only {before} samples before contact: too few to tell the onset; {_REMEDY}")
    calm = force[:before]
    offset, measured = float(calm.mean()), float(calm.std(ddof=1))
    return Onset(onset, error, measured, offset, offset + 5 * spread, before)


def _locate(t, f, candidates, orders):
    """Onset of least misfit among refined candidates, its misfit, and the information on it (1/s² per noise²)."""
    for _ in range(3):
        fits = [_fit(t, f, t0, orders) for t0 in candidates]
        best = int(np.argmin([fit[0] for fit in fits]))
        onset = float(candidates[best])
        candidates = np.linspace(candidates[max(best - 1, 0)], candidates[min(best + 1, len(candidates) - 1)], 15)
    return onset, fits[best][0], _information(t, onset, fits[best][1], orders)


def _bracket(time, force, noise):
    """First sample of certain contact, the peak, and offset and spread of what lies before."""
    last = int(np.argmax(force))
    if last < FEWEST_BEFORE:
        raise InputError(f"the force peaks within the first {FEWEST_BEFORE} samples: no time before contact; {_REMEDY}")
    offset, spread = float(np.median(force[:FEWEST_BEFORE])), noise or 0.0
    first = last
    for share in (0.5, 0.25, 0.1):  # the quiet part is what lies well before the rise reaches a share of the peak
        below = np.flatnonzero(force[:last] - offset < share * (force[last] - offset))
        first = int(below[-1]) + 1 if below.size else 0
        calm = force[: max(first - max(3, (last - first) // 2), FEWEST_BEFORE)]
        offset = float(np.median(calm))
        spread = noise or float(1.4826 * np.median(np.abs(calm - offset))) or float(calm.std())
    if force[last] - offset < max(8 * spread, 1e-12):
        raise InputError(f"no force stands out of the noise ({spread:.3g} N) enough to find contact; {_REMEDY}")
    level = offset + max(5 * spread, 1e-3 * (force[last] - offset))
    below = np.flatnonzero(force[:last] < level)
    first = int(below[-1]) + 1 if below.size else 0
    if first < FEWEST_BEFORE:
        raise InputError(f"only {first} samples before contact: too few to tell the onset; {_REMEDY}")
    if last - first < 3:
        raise InputError(f"only {last - first + 1} samples on the rise: too few to tell the onset; {_REMEDY}")
    return first, last, offset, spread


def _foot(time, force, first, last, offset) -> float:
    """Foot of the parabola through the points where the force reaches a tenth and four tenths of its peak."""
    height = force[last] - offset
    rise = slice(first, last + 1)
    low, high = (time[rise][np.argmax(force[rise] - offset >= share * height)] for share in (0.1, 0.4))
    return float(2 * low - high)


def _basis(t, onset, orders):
    """Columns 1, τⁿ … of the rise, with τ = t - onset scaled to its largest value."""
    tau = np.maximum(t - onset, 0.0)
    scale = max(tau[-1], 1e-300)
    return np.stack([np.ones_like(t), *((tau / scale) ** n for n in orders)], axis=1), tau / scale, scale


def _fit(t, f, onset, orders):
    """Linear least squares at a fixed onset: misfit (infinite for a rise that falls) and coefficients."""
    basis, tau, _ = _basis(t, onset, orders)
    values, *_ = np.linalg.lstsq(basis, f, rcond=None)
    residual = f - basis @ values
    falls = np.any(_steepness(tau, values, orders) < 0)
    return np.inf if falls else float(residual @ residual), values


def _steepness(tau, values, orders):
    """Change of the force per scaled time, nought before the onset."""
    return sum(n * c * tau ** (n - 1) * (tau > 0) for n, c in zip(orders, values[1:], strict=True))


def _information(t, onset, values, orders) -> float:
    """Squared change of the force with the onset that the other coefficients cannot take up."""
    basis, tau, scale = _basis(t, onset, orders)
    slope = -_steepness(tau, values, orders) / scale
    others, *_ = np.linalg.lstsq(basis, slope, rcond=None)
    return float(np.sum((slope - basis @ others) ** 2))
