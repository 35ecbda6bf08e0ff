"""How visible an effect is: what a refitted reference model leaves of it, over the noise."""

import numpy as np
from scipy.optimize import brentq

from .impact import Impact, simulate


STEPS = (1e-4, 0.1)  # of finite differences: shared parameters, and nuisances in their prior deviations


def place_times(base, conditions, interval=1e-3, before=0.0, factor=1.45):
    """Return sampling times (s): from `before` the touch to `factor` guessed contact times, every `interval`."""
    end = factor * Impact(base, {}, conditions).guess_contact_time()
    first = -round(before / interval)
    return np.arange(first, int(end / interval) + 1) * interval


def differentiate(predict, i, shared, own):
    """Return the readings of record i and their derivatives by the shared parameters and by its own nuisances."""
    here = predict(i, shared, own)
    move = np.diag(np.concatenate([np.full(shared.size, STEPS[0]), np.full(own.size, STEPS[1])]))
    columns = [(predict(i, shared + d[: shared.size], own + d[shared.size :]) - here) / d.max() for d in move]
    slope = np.column_stack(columns)
    return here, slope[:, : shared.size], slope[:, shared.size :]


def refit(predict, truth, shared, nuisances, steps=5, slopes=None):
    """Return the rms that a refit leaves of the readings `truth` (a list of arrays over noise, one a record).

    Gauss-Newton over parameters that all records share and each record's own `nuisances`, which have a standard
    normal prior and are eliminated on the spot. predict(i, shared, own): readings of record i over noise. slopes: of
    each record its two derivatives where they are held fixed; finite differences at every step otherwise.
    """
    shared = np.array(shared, dtype=float)
    own = np.zeros((len(truth), nuisances))
    misfit, size = 0.0, 0
    for step in range(steps + 1):
        square, pull, misfit, size, kept = np.zeros((shared.size,) * 2), np.zeros(shared.size), 0.0, 0, []
        for i, y in enumerate(truth):
            if slopes is not None or step == steps:
                here = predict(i, shared, own[i])
                a, b = (np.zeros(0), np.zeros(0)) if slopes is None else slopes[i]
            else:
                here, a, b = differentiate(predict, i, shared, own[i])
            left = y - here
            misfit, size = misfit + left @ left, size + left.size
            if step == steps:
                continue
            inner = b.T @ b + np.eye(nuisances)
            target = b.T @ left - own[i]
            cross = np.linalg.solve(inner, b.T @ a)
            square += a.T @ a - (b.T @ a).T @ cross
            pull += a.T @ left - cross.T @ target
            kept.append((inner, target, b.T @ a))
        if step < steps:
            change = np.linalg.solve(square, pull)
            shared = shared + change
            own += [np.linalg.solve(inner, target - mixed @ change) for inner, target, mixed in kept]
    return float(np.sqrt(misfit / size))


def hold_slopes(base, names, read, records, nuisances, steps):
    """Return the function effects -> rms that a refit leaves, the reference model's derivatives being found once.

    names: of the base parameters that all records share, by their logarithms. read(i, base, effects, own): readings
    of record i over noise at nuisances `own`, shape (nuisances,), in units of their prior deviations.
    """
    start, still = np.zeros(len(names)), np.zeros(nuisances)

    def predict(i, shared, own):
        return read(i, base | {n: base[n] * np.exp(x) for n, x in zip(names, shared, strict=True)}, {}, own)

    slopes = [differentiate(predict, i, start, still)[1:] for i in range(records)]

    def measure(effects):
        truth = [read(i, base, effects, still) for i in range(records)]
        return refit(predict, truth, start, nuisances, steps, slopes)

    return measure


def measure_misfit(base, effects, conditions, deviations, uncertainties, channels=("normal_force",), steps=5,
                   slopes=None, **options):
    """Return the rms over noise that the reference model leaves on noise-free records after a refit.

    Over effective_mass and restitution (shared) and each record's relative pressure and speed errors and time shift,
    which carry their stated uncertainty as a prior. deviations: noise of each channel; uncertainties:
    initial_pressure and approach_speed relative, time in s; slopes: of `find_slopes`; options: of `simulate`.
    """
    predict = predict_reference(base, conditions, deviations, uncertainties, channels, **options)
    scale = np.asarray(deviations, dtype=float)
    truth = [(simulate(base, effects, c, place_times(base, c), channels, **options) / scale).ravel()
             for c in conditions]  # fmt: skip
    return refit(predict, truth, [np.log(base["effective_mass"]), base["restitution"]], 3, steps, slopes)


def find_slopes(base, conditions, deviations, uncertainties, channels=("normal_force",), **options):
    """Return the reference model's derivatives at the truth, for `measure_misfit` to hold them there."""
    predict = predict_reference(base, conditions, deviations, uncertainties, channels, **options)
    shared = np.array([np.log(base["effective_mass"]), base["restitution"]])
    return [differentiate(predict, i, shared, np.zeros(3))[1:] for i in range(len(conditions))]


def predict_reference(base, conditions, deviations, uncertainties, channels, rtol=1e-9, parts=60):
    """Return the function that `refit` wants: the reference model's readings over noise."""
    scale = np.asarray(deviations, dtype=float)
    prior = np.array([uncertainties["initial_pressure"], uncertainties["approach_speed"], uncertainties["time"]])
    times = [place_times(base, c) for c in conditions]

    def predict(i, shared, own):
        model = dict(base, effective_mass=np.exp(shared[0]), restitution=shared[1])
        pressure, speed, _ = 1.0 + prior * own
        c = conditions[i]
        moved = dict(c, initial_pressure=c["initial_pressure"] * pressure, approach_speed=c["approach_speed"] * speed)
        return (simulate(model, {}, moved, times[i] + prior[2] * own[2], channels, rtol, parts) / scale).ravel()

    return predict


def scale_amplitude(build, wanted, bracket, *arguments, **options):
    """Return the amplitude a for which the effects `build(a)` leave a misfit of `wanted`, within 1 %.

    arguments and options are those of `measure_misfit` after the effects, the first being the base parameters.
    """
    base, *rest = arguments

    def exceed(amplitude):
        return measure_misfit(base, build(amplitude), *rest, **options) - wanted

    return brentq(exceed, *bracket, rtol=np.float64(1e-2), xtol=abs(bracket[1] - bracket[0]) * 1e-4)


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
