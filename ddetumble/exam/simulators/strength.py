"""How visible an effect is: what a refitted reference model leaves of it, over the noise."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


STEPS = (1e-4, 0.1)  # of finite differences: shared parameters, and nuisances in their prior deviations


class Reference(NamedTuple):
    """A reference model on some tests, as a refit sees it."""

    base: Mapping[str, float]  # its true parameters
    start: np.ndarray  # coordinates of the parameters that all records share, at the truth
    move: Callable[[np.ndarray], Mapping[str, float]]  # parameters at such coordinates
    # Readings of record i over noise, from i, parameters, effects, and its own nuisances in their prior deviations.
    read: Callable[[int, Mapping[str, float], Mapping[str, Any], np.ndarray], np.ndarray]
    records: int  # how many there are
    nuisances: int  # of each


def share_logarithms(base: Mapping[str, float], names: Sequence[str]
                     ) -> tuple[np.ndarray, Callable[[np.ndarray], dict[str, float]]]:
    """`start` and `move` of a `Reference` whose coordinates are the logarithms of some parameters over the truth."""

    def move(shared):
        return {**base, **{n: base[n] * np.exp(x) for n, x in zip(names, shared, strict=True)}}

    return np.zeros(len(names)), move


def refer_tests(base, shared, tests, places, uncertainties, read):
    """Return the `Reference` of tests at some conditions.

    Each record's own are relative errors of its conditions and its time shift (s), which have their stated uncertainty
    as a prior. shared: `start` and `move`; places: where each record is read; read: readings over noise from
    parameters, effects, conditions and such places.
    """
    prior, (start, move) = np.array(list(uncertainties.values())), shared

    def read_moved(i, model, effects, own):
        errors = dict(zip(uncertainties, prior * own, strict=True))
        shift = errors.pop("time", 0.0)
        moved = {c: tests[i][c] * (1.0 + x) for c, x in errors.items()}
        return read(model, effects, tests[i] | moved, places[i] + shift).ravel()

    return Reference(base, start, move, read_moved, len(tests), len(prior))


def differentiate(reference, i, shared, own):
    """Return the derivatives of record i's readings by the shared parameters and by its own nuisances."""
    here = reference.read(i, reference.move(shared), {}, own)
    columns = []
    for d in np.diag(np.concatenate([np.full(shared.size, STEPS[0]), np.full(own.size, STEPS[1])])):
        moved = reference.read(i, reference.move(shared + d[: shared.size]), {}, own + d[shared.size :])
        columns.append((moved - here) / d.max())
    slope = np.column_stack(columns)
    return slope[:, : shared.size], slope[:, shared.size :]


def measure_misfit(reference, effects, steps=5, slopes=None):
    """Return the rms over noise that the reference model leaves on noise-free records with effects after a refit.

    Gauss-Newton over parameters that all records share and each record's own nuisances, which have a standard normal
    prior and are eliminated on the spot. slopes: each record's derivatives; found anew at every step if not given.
    """
    shared, own = reference.start, np.zeros((reference.records, reference.nuisances))
    truth = [reference.read(i, reference.base, effects, still) for i, still in enumerate(own)]
    for step in range(steps + 1):
        left = [y - reference.read(i, reference.move(shared), {}, own[i]) for i, y in enumerate(truth)]
        if step == steps:
            break
        square, pull, kept = np.zeros((shared.size,) * 2), np.zeros(shared.size), []
        for i, residual in enumerate(left):
            a, b = differentiate(reference, i, shared, own[i]) if slopes is None else slopes[i]
            inner = b.T @ b + np.eye(reference.nuisances)
            target = b.T @ residual - own[i]
            cross = np.linalg.solve(inner, b.T @ a)
            square += a.T @ a - (b.T @ a).T @ cross
            pull += a.T @ residual - cross.T @ target
            kept.append((inner, target, b.T @ a))
        change = np.linalg.solve(square, pull)
        shared = shared + change
        own += [np.linalg.solve(inner, target - mixed @ change) for inner, target, mixed in kept]
    return float(np.sqrt(sum(r @ r for r in left) / sum(r.size for r in left)))


def hold_slopes(reference, steps):
    """Return the function effects -> misfit, the reference model's derivatives being found once, at the truth."""
    still = np.zeros(reference.nuisances)
    slopes = [differentiate(reference, i, reference.start, still) for i in range(reference.records)]
    return lambda effects: measure_misfit(reference, effects, steps, slopes)


def reach_strength(measure, wanted, most, first=1.0, tolerance=0.02, evaluations=10):
    """Return the amplitude for which `measure` is `wanted`, within the tolerance, and what it then is.

    measure: misfit by amplitude, growing from 0 and about in proportion at first. Where it stays below `wanted` up to
    the amplitude `most`, that one is returned; where it stays above however small the amplitude, a small one. Secant
    steps in logarithms, inside a bracket that shrinks.
    """
    low, high, amplitude, slope = 0.0, most, min(first, most), 1.0
    before: tuple[float, float] | None = None
    best = (np.inf, amplitude, 0.0)
    for _ in range(evaluations):
        misfit = measure(amplitude)
        best = min(best, (abs(np.log(max(misfit, 1e-12) / wanted)), amplitude, misfit))
        flat = before is not None and misfit > wanted and abs(misfit / before[1] - 1.0) < 1e-3
        if best[0] < tolerance or (amplitude == most and misfit < wanted) or flat:
            break
        if misfit < wanted:
            low = amplitude
        else:
            high = amplitude
        if before is not None and misfit > 0 and before[0] != amplitude and before[1] != misfit:
            slope = np.clip(np.log(misfit / before[1]) / np.log(amplitude / before[0]), 0.2, 3.0)
        before = (amplitude, max(misfit, 1e-12))
        target = amplitude * (wanted / max(misfit, 1e-12)) ** (1.0 / slope)
        inside = low < target < high or target >= most == high
        amplitude = min(target, most) if inside else np.sqrt(max(low, 1e-3 * high) * high)
    return best[1], best[2]
