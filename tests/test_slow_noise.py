"""A baseline that wanders: its likelihood, that one is found, and that none is found where there is none."""

import numpy as np
import pytest
from helpers_statistics import PRESSURES, SD, SPEEDS, fit_toy, make_selection

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference import variance_components
from ddetumble.inference.noise import Noise
from ddetumble.inference.variance_components import add_slow_noise


CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2
WORTH = 6.0


def wander(seed, size, slow):
    """Adds such a baseline to every record."""
    def spoil(measured, stated):
        generator = np.random.default_rng([51, seed])
        for values in measured[:, 0]:
            values += draw_noise(generator, len(values), size, np.exp(-0.02 / slow))
    return spoil


def look(seed, spoil=None, **options):
    """The noise of the force after a look for a baseline under the reference model."""
    selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, spoil=spoil, **options))
    return add_slow_noise(selection.records, fitted.solution, selection.noise, WORTH)["normal_force"]


@pytest.mark.parametrize("count", [0, 2])
def test_restricted_likelihood_is_that_of_the_dense_normal_density(count):
    """log|V| + log|S'V⁻¹S| + r'Pr of all records at once, with and without free parameters."""
    generator, parts = np.random.default_rng(1), []
    for n in (4, 6, 5):
        time, root = np.sort(generator.random(n)), generator.standard_normal((n, n))
        parts.append((time, root @ root.T + np.eye(n), generator.standard_normal((n, count + 1))))
    for logarithm, slow in ((-np.inf, 1.0), (-0.3, 0.2), (1.6, 3.0)):
        covariance, place, size = np.zeros((15, 15)), 0, np.exp(logarithm)
        for time, own, _ in parts:
            rows = slice(place, place + len(time))
            covariance[rows, rows] = own + size**2 * np.exp(-abs(time[:, None] - time) / slow)
            place += len(time)
        columns = np.concatenate([part[2] for part in parts])
        free, right, inverse = columns[:, :-1], columns[:, -1], np.linalg.inv(covariance)
        square = free.T @ inverse @ free
        projector = inverse - inverse @ free @ np.linalg.solve(square, free.T @ inverse)
        expected = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(square)[1] + right @ projector @ right
        assert variance_components._lose(logarithm, slow, parts) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(("size", "slow"), [(0.05, 0.3), (0.1, 0.15), (0.2, 0.6)])
def test_a_baseline_is_found(size, slow):
    """Of one to four times the noise: its size within a third, and the nearest times that are tried to its own."""
    for seed in range(4):
        found = look(seed, wander(seed, size, slow))
        assert found.slow_sd == pytest.approx(size, rel=1 / 3) and slow / 3.0 < found.slow_time < 3.0 * slow
        assert found.sd == SD["normal_force"] and not found.is_white


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_no_baseline_is_found_in_noise(rho):
    """White or correlated as it is known to be: none of 15 campaigns has one."""
    for seed in range(15):
        selection = make_selection(seed, conditions=CONDITIONS, rho=rho)
        known = {"normal_force": make_known(rho)}
        selection, fitted = fit_toy(selection.restack(known))
        assert add_slow_noise(selection.records, fitted.solution, known, WORTH) == known


def make_known(rho):
    return Noise(SD["normal_force"], rho, 0.0, 0.02, SD["normal_force"], 0.0, "")


def test_settings_off_within_their_uncertainty_are_no_baseline():
    """A clock and settings that are as uncertain as stated, and parameters anywhere, take no baseline to explain."""
    assert look(3, truth={"stiffness": 14.0, "gas": 1.0, "loss": 2.0}).slow_sd == 0.0
