"""How the noise below a contact's own frequencies is told from what lies above them."""

import numpy as np
import pytest

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference.noise import whiten, whitening
from ddetumble.inference.noise_estimation import BELOW, estimate_noise


REPEATS = 60


def find_level(sd: float, rho: float, white: float, lowest: float) -> float:
    """Logarithm of the power below `lowest` [cycles a sample], from the autocovariances themselves."""
    lag = np.arange(1, 4000)
    tail = (1.0 - white) * rho**lag
    power = [1.0 + 2.0 * np.sum(tail * np.cos(2.0 * np.pi * f * lag)) for f in lowest * BELOW]
    return 2.0 * np.log(sd) + float(np.mean(np.log(power)))


@pytest.mark.parametrize("lowest", [0.02, 0.1, 0.25])
@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.5, 0.0), (0.85, 0.0), (0.4, 0.4), (0.6, 0.4), (0.85, 0.4)])
def test_the_error_of_the_level_is_as_stated(rho, white, lowest):
    """White, correlated, and both: of 60 campaigns of four records at most 6 find it 1.6 errors too low."""
    z = []
    for seed in range(REPEATS):
        generator = np.random.default_rng([7, seed])
        traces = [draw_noise(generator, 300, 2.0, rho, white) for _ in range(4)]
        found = estimate_noise(traces, 1.0, lowest, 2.0)
        z.append((find_level(found.sd, found.correlation, found.white_share, lowest)
                  - find_level(2.0, rho, white, lowest)) / found.log_level_sd)
    assert sum(x < -1.6 for x in z) <= 6 and np.sqrt(np.mean(np.square(z))) < 1.5


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.7, 0.0), (0.9, 0.3)])
def test_many_samples_fix_every_parameter(rho, white):
    """A grid of nodes does not limit how well: a million samples give the truth to a percent."""
    generator = np.random.default_rng(3)
    found = estimate_noise([draw_noise(generator, 10000, 0.5, rho, white) for _ in range(100)], 0.1, 0.01, 0.5)
    assert (found.sd, found.correlation) == pytest.approx((0.5, rho), rel=0.01)
    assert found.white_share == pytest.approx(white, abs=0.01)


def test_whitened_noise_is_white():
    generator = np.random.default_rng(5)
    traces = [draw_noise(generator, 400, 3.0, 0.8, 0.4) for _ in range(200)]
    found = estimate_noise(traces, 0.1, 0.05, 3.0)
    weights, taps = whitening(found, 0.1 * np.arange(400), np.ones(400, bool))
    white = whiten(weights, taps, np.array(traces).T)
    power = np.mean(np.abs(np.fft.rfft(white, axis=0)) ** 2, axis=1)[1:-1] / 400
    slow, fast = power[:40].mean(), power[-40:].mean()
    assert np.var(white) == pytest.approx(1.0, rel=0.02) and slow == pytest.approx(fast, rel=0.06)
