"""How visible an effect is: what a refitted reference model leaves of it, over the noise."""

import numpy as np
from scipy.optimize import brentq

from .impact import Impact, simulate


def place_times(base, conditions, interval=1e-3, before=0.0, factor=1.45):
    """Return sampling times (s): from `before` the touch to `factor` guessed contact times, every `interval`."""
    end = factor * Impact(base, {}, conditions).guess_contact_time()
    first = -round(before / interval)
    return np.arange(first, int(end / interval) + 1) * interval


def measure_misfit(base, effects, conditions, deviations, uncertainties, channels=("normal_force",), steps=5):
    """Return the rms over noise that the reference model leaves on noise-free records after a refit.

    Gauss-Newton with finite differences over effective_mass and restitution (shared) and each record's relative
    pressure and speed errors and time shift, which carry their stated uncertainty as a prior. deviations: noise
    of each channel; uncertainties: initial_pressure and approach_speed relative, time in s. Each record's three
    nuisances are eliminated on the spot, so the shared system is 2 x 2.
    """
    scale = np.asarray(deviations, dtype=float)
    prior = np.array([uncertainties["initial_pressure"], uncertainties["approach_speed"], uncertainties["time"]])
    times = [place_times(base, c) for c in conditions]
    truth = [simulate(base, effects, c, t, channels) / scale for c, t in zip(conditions, times, strict=True)]
    shared = np.array([np.log(base["effective_mass"]), base["restitution"]])
    own = np.zeros((len(conditions), 3))  # in units of their prior

    def predict(c, t, common, nuisance):
        model = dict(base, effective_mass=np.exp(common[0]), restitution=common[1])
        pressure, speed, _ = 1.0 + prior * nuisance
        moved = dict(c, initial_pressure=c["initial_pressure"] * pressure, approach_speed=c["approach_speed"] * speed)
        return (simulate(model, {}, moved, t + prior[2] * nuisance[2], channels, rtol=1e-9) / scale).ravel()

    for step in range(steps + 1):
        square, pull, misfit, size, kept = np.zeros((2, 2)), np.zeros(2), 0.0, 0, []
        for i, (c, t, y) in enumerate(zip(conditions, times, truth, strict=True)):
            here = predict(c, t, shared, own[i])
            left = y.ravel() - here
            misfit, size = misfit + left @ left, size + left.size
            if step == steps:
                continue
            h = np.array([1e-4, 1e-4, 0.1, 0.1, 0.1])
            columns = [predict(c, t, shared + d[:2], own[i] + d[2:]) - here for d in np.diag(h)]
            slope = np.column_stack(columns) / h
            a, b = slope[:, :2], slope[:, 2:]
            inner = b.T @ b + np.eye(3)
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


def scale_amplitude(build, wanted, bracket, *arguments, **options):
    """Return the amplitude a for which the effects `build(a)` leave a misfit of `wanted`, within 1 %.

    arguments and options are those of `measure_misfit` after the effects, the first being the base parameters.
    """
    base, *rest = arguments

    def exceed(amplitude):
        return measure_misfit(base, build(amplitude), *rest, **options) - wanted

    return brentq(exceed, *bracket, rtol=1e-2, xtol=abs(bracket[1] - bracket[0]) * 1e-4)
