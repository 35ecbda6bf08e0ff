"""How the noise below a contact's own frequencies is told from what lies above them."""

import dataclasses as dc

import numpy as np
import pytest

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference import noise_estimation
from ddetumble.inference.noise import TAPS, Noise, scale_whitening, whiten, whitening, whitening_matrix
from ddetumble.inference.noise_estimation import BELOW, changed, differs_from_stated, estimate_noise, spline_columns


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


def make_noise(sd=2.0, rho=0.6, white=0.0, interval=0.1, stated=2.0):
    return Noise(sd, rho, white, interval, stated, 0.0, "")


@pytest.mark.parametrize(("rho", "white"), [(0.6, 0.0), (0.6, 0.3), (0.0, 0.0)])
def test_autocovariance(rho, white):
    lag = np.array([0.0, 0.1, -0.2, 0.05])
    expected = 4.0 * (1.0 - white) * np.array([1.0, rho, rho**2, rho**0.5]) * (rho > 0)
    expected[0] = 4.0
    np.testing.assert_allclose(make_noise(rho=rho, white=white).covariance(lag), expected, atol=1e-12)


def test_filter_of_autoregressive_noise():
    """The first tap is the correlation, and what it cannot predict has the variance sd² (1 - rho²); rho² over a gap."""
    time, valid = 0.1 * np.arange(40), np.ones(40, bool)
    valid[20] = False
    weights, taps = whitening(make_noise(), time, valid)
    assert weights[0] == 0.5 and not taps[0].any() and weights[20] == 0.0 and not taps[20].any()
    np.testing.assert_allclose(weights[[1, 19, 22]], 0.5 / np.sqrt(1.0 - 0.36), rtol=1e-6)
    assert weights[21] == pytest.approx(0.5 / np.sqrt(1.0 - 0.6**4), rel=1e-6)
    np.testing.assert_allclose(taps[[1, 19, 22], 0], 0.6, rtol=1e-6)
    assert taps[21, 1] == pytest.approx(0.36, rel=1e-6) and taps[21, 0] == 0.0
    np.testing.assert_allclose(taps[5, 1:], 0.0, atol=1e-6)
    white, none = whitening(make_noise(rho=0.0), time, valid)
    np.testing.assert_array_equal(white, np.where(valid, 0.5, 0.0))
    assert not none.any()


@pytest.mark.parametrize("uneven", [False, True])
def test_filter_is_the_factor_of_the_covariance(uneven):
    """Of no more samples than taps: rows of the inverse of its Cholesky factor."""
    time = 0.1 * np.arange(9) + (0.02 * np.sin(np.arange(9)) if uneven else 0.0)
    noise = make_noise(white=0.3)
    weights, taps = whitening(noise, time, np.ones(9, bool))
    matrix = whitening_matrix(weights, taps).toarray()
    factor = np.linalg.cholesky(noise.covariance(time[:, None] - time[None, :]))
    np.testing.assert_allclose(matrix, np.linalg.inv(factor), atol=1e-8)
    x = np.random.default_rng(0).normal(size=(9, 2))
    np.testing.assert_allclose(whiten(weights, taps, x), matrix @ x, atol=1e-12)


def test_spectrum_and_stray_are_those_of_the_autocovariance():
    noise, lag = make_noise(1.0, 0.7, 0.25, 1.0), np.arange(-400, 401)
    for f in (0.01, 0.2, 0.45):
        power = np.sum(noise.covariance(lag) * np.cos(2 * np.pi * f * lag))
        assert noise_estimation._spectrum(f, 1.0, 0.7, 0.25) == pytest.approx(power)
        assert noise_estimation._spectrum(f / 0.1, 0.1, 0.7, 0.25) == pytest.approx(power)
    covariance = noise.covariance(np.arange(12)[:, None] - np.arange(12)[None, :])
    about = np.trace(covariance @ (np.eye(12) - 1.0 / 12.0)) / 11.0
    assert noise_estimation._stray(0.7, 0.25, 12) == pytest.approx(about)


@pytest.mark.parametrize("expected", [None, 1.3])
def test_size_of_every_node_is_the_likeliest(expected):
    """Beside a fine grid: the loss, where it is least, and its curvature."""
    generator = np.random.default_rng(4)
    shape, counts = generator.uniform(0.5, 2.0, (3, 40)), generator.integers(1, 5, 40) * 0.5
    means = generator.exponential(2.0, 40)
    loss, log_sd, error = noise_estimation._profile(shape, counts, means, expected, 0.01)
    grid = np.linspace(-1.0, 1.5, 500_001)
    for k in range(3):
        total, ratio = counts.sum(), np.sum(counts * means / shape[k])
        tried = np.sum(counts * np.log(shape[k])) + 2.0 * total * grid + ratio * np.exp(-2.0 * grid)
        if expected is not None:
            tried = tried + 0.5 * ((grid - np.log(expected)) / 0.01) ** 2
        best = int(np.argmin(tried))
        assert log_sd[k] == pytest.approx(grid[best], abs=1e-5) and loss[k] == pytest.approx(tried[best], abs=1e-6)
        curvature = (tried[best + 2000] - 2 * tried[best] + tried[best - 2000]) / (grid[2000] - grid[0]) ** 2
        assert error[k] == pytest.approx(1.0 / np.sqrt(curvature), rel=2e-3)


def test_splines_add_to_one():
    """Inside each span, four at a time; nothing outside, nor where a span has too few samples."""
    time = np.linspace(0.0, 2.0, 201)
    found = spline_columns(time, [(0.2, 0.7, 8), (1.0, 1.5, 6), (1.9, 1.95, 9)]).toarray()
    assert found.shape == (201, 14)
    inside = ((time > 0.2) & (time <= 0.7)) | ((time > 1.0) & (time <= 1.5))
    np.testing.assert_allclose(found.sum(axis=1), inside, atol=1e-12)
    assert (found > 1e-12).sum(axis=1).max() == 4 and not found[:60, 8:].any()


def test_when_noise_counts_as_changed():
    one = {"x": make_noise(1.0, 0.5, 0.2, stated=1.0)}
    for sd, rho, white, is_changed in ((1.02, 0.5, 0.2, False), (1.05, 0.5, 0.2, True), (0.95, 0.5, 0.2, True),
                                       (1.0, 0.56, 0.2, True), (1.0, 0.46, 0.2, False), (1.0, 0.5, 0.36, True),
                                       (1.0, 0.5, 0.06, False)):
        assert changed(one, {"x": make_noise(sd, rho, white)}) is is_changed
    for sd, rho, stated, differs in ((1.0, 0.0, 1.0, False), (1.11, 0.0, 1.0, True), (0.91, 0.0, 1.0, False),
                                     (1.0, 0.1, 1.0, True), (3.0, 0.5, None, False)):
        assert differs_from_stated({"x": make_noise(sd, rho, 0.0, stated=stated)}) is differs


SLOW = dc.replace(make_noise(1.5, 0.4, 0.2), slow_sd=3.0, slow_time=0.7)


def test_autocovariance_with_a_baseline_that_wanders():
    """That of the noise and, independent of it, one that decays with time."""
    lag = np.array([0.0, 0.1, -0.2, 5.0])
    expected = make_noise(1.5, 0.4, 0.2).covariance(lag) + 9.0 * np.exp(-np.abs(lag) / 0.7)
    np.testing.assert_allclose(SLOW.covariance(lag), expected, rtol=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.4])
@pytest.mark.parametrize("uneven", [False, True])
def test_filter_with_a_baseline_that_wanders(rho, uneven):
    """Of no more samples than the taps and one: the inverse of the Cholesky factor of their covariance."""
    noise = dc.replace(SLOW, correlation=rho)
    for n in (2, 5, TAPS + 1):
        time = 0.1 * np.arange(n) + (0.03 * np.sin(np.arange(n)) if uneven else 0.0)
        matrix = whitening_matrix(*whitening(noise, time, np.ones(n, bool))).toarray()
        factor = np.linalg.cholesky(noise.covariance(time[:, None] - time))
        np.testing.assert_allclose(matrix, np.linalg.inv(factor), atol=1e-8)


def test_which_noise_is_white():
    """Neither correlated nor beside a baseline that wanders."""
    assert make_noise(rho=0.0).is_white and not make_noise(rho=0.3).is_white and not SLOW.is_white
    assert not dc.replace(SLOW, correlation=0.0).is_white
    assert dc.replace(SLOW, correlation=0.0, slow_sd=0.0).is_white


@pytest.mark.parametrize("noise", [make_noise(rho=0.0), make_noise(white=0.3), SLOW])
def test_filter_of_noise_of_other_sizes(noise):
    """It gives what the filter makes of every sample over its size, also beside missing samples."""
    generator, n = np.random.default_rng(9), 60
    valid, sizes = generator.random(n) > 0.1, np.exp(generator.normal(size=n))
    weights, taps = whitening(noise, 0.1 * np.arange(n), valid)
    x = generator.normal(size=(n, 3))
    found = whiten(*scale_whitening(weights, taps, sizes), x)
    np.testing.assert_allclose(found, whiten(weights, taps, x / sizes[:, None]), rtol=1e-12, atol=1e-12)


def test_filter_of_other_sizes_is_the_factor_of_their_covariance():
    """Of no more samples than the taps and one, noise of covariance s_i C_ij s_j becomes white."""
    generator, n = np.random.default_rng(10), TAPS + 1
    time, sizes = 0.1 * np.arange(n), np.exp(generator.normal(size=n))
    matrix = whitening_matrix(*scale_whitening(*whitening(SLOW, time, np.ones(n, bool)), sizes)).toarray()
    covariance = sizes[:, None] * SLOW.covariance(time[:, None] - time) * sizes
    np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(n), atol=1e-7)


def test_deviation_of_a_reading():
    """Floor, shares of the reading and of its change, and baseline add in squares; one size where none is known."""
    reading = np.array([[0.0, 2.0, 4.0, 6.0], [5.0, 5.0, 5.0, 5.0]])
    noise = dc.replace(make_noise(), floor=0.3, share=0.1, rate_share=0.5, slow_sd=0.4)
    rate = np.array([[2.0] * 4, [0.0] * 4])
    expected = np.sqrt(0.09 + 0.01 * reading**2 + 0.25 * rate**2 + 0.16)
    np.testing.assert_allclose(noise.deviations(reading), expected, rtol=1e-12)
    np.testing.assert_allclose(noise.deviations(reading[0]), expected[0], rtol=1e-12)
    np.testing.assert_allclose(noise.deviations(np.array([7.0])), [np.sqrt(0.09 + 0.49 + 0.16)], rtol=1e-12)
    np.testing.assert_allclose(SLOW.deviations(reading), np.full((2, 4), np.hypot(1.5, 3.0)), rtol=1e-12)


def test_when_sizes_of_samples_count_as_changed():
    """By a tenth, rms over all samples of both; noise whose size varied before and does not any more has changed."""
    plain, ones = make_noise(), np.ones(50)
    uneven = dc.replace(plain, sizes={"a": ones, "b": 1.5 * ones})
    for sizes, is_changed in (({"a": ones, "b": 1.5 * ones}, False), ({"a": 1.08 * ones, "b": 1.62 * ones}, False),
                              ({"a": 1.2 * ones, "b": 1.5 * ones}, True), ({"a": ones, "b": 1.7 * ones}, False),
                              ({"a": ones, "b": 1.8 * ones}, True), ({}, True), ({"b": 1.5 * ones}, False)):
        assert changed({"x": uneven}, {"x": dc.replace(plain, sizes=sizes)}) is is_changed
        assert changed({"x": dc.replace(plain, sizes=sizes)}, {"x": uneven}) is is_changed
    assert not changed({"x": plain}, {"x": plain})
    assert differs_from_stated({"x": dc.replace(uneven, correlation=0.0)})
    assert not differs_from_stated({"x": dc.replace(plain, correlation=0.0)})
