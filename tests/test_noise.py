"""How the noise below a contact's own frequencies is told from what lies above them."""

import dataclasses as dc

import numpy as np
import pytest
from helpers_statistics import TIME, fit_toy, make_selection

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.families import Span
from ddetumble.inference import noise as noise_module
from ddetumble.inference import noise_estimation
from ddetumble.inference.noise import TAPS, Noise, scale_whitening, whitening, whitening_matrix
from ddetumble.inference.noise_estimation import (
    BELOW,
    Deviation,
    changed,
    differs_from_stated,
    estimate_from_pairs,
    estimate_noise,
    has_more_hum,
    measure_deviation,
    spline_columns,
)
from ddetumble.inference.noise_size import Sizes


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


@pytest.mark.parametrize(("rho", "white"), [(0.6, 0.0), (0.8, 0.4)])
def test_what_splines_took_of_the_noise_is_made_up_for(rho, white):
    """Twenty splines over half a record, without a stated size: else the level comes out too low, and certain."""
    z, without = [], []
    time = np.arange(400.0)
    smooth = spline_columns(time, [Span(-1.0, 200.0, 20)])
    taken = np.linalg.qr(smooth.toarray())[0]
    lowest = 0.05  # ten periods over the part with splines
    for seed in range(30):
        generator = np.random.default_rng([8, seed])
        traces = [draw_noise(generator, 400, 2.0, rho, white) for _ in range(16)]
        traces = [x - taken @ (taken.T @ x) for x in traces]
        for kept, columns in ((z, [taken] * 16), (without, None)):
            found = estimate_noise(traces, 1.0, lowest, None, taken=columns)
            kept.append((find_level(found.sd, found.correlation, found.white_share, lowest)
                         - find_level(2.0, rho, white, lowest)) / found.log_level_sd)
    assert abs(np.mean(z)) < 0.5 and np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.mean(without) < np.mean(z) - 0.5


@pytest.mark.parametrize("rho", [0.45, 0.63, 0.8])
def test_rounding_adds_to_noise_that_is_stated_without_it(rho):
    """Above a fifth of the sampling rate noise of 2, rounded to 6, looks as white noise of about 2 does, and below it
    there is more. Noise stated with its rounding is white; where more strays than both make, it may be a misfit.
    """
    for seed in range(5):
        generator = np.random.default_rng([10, seed])
        time = np.arange(300.0)
        swing = 300.0 * np.sin(0.07 * time)  # what a body does, of which no reading stands still
        noisy = [draw_noise(generator, 300, 2.0, rho, 0.0) for _ in range(6)]
        traces = [6.0 * np.round((swing + x) / 6.0) - swing for x in noisy]
        found = estimate_noise(traces, 1.0, 0.1, 2.0, whole=measure_deviation(traces), digit=6.0)
        assert found.sd == pytest.approx(np.sqrt(4.0 + 3.0), rel=0.03) and found.stated_sd == 2.0
        assert abs(find_level(found.sd, found.correlation, found.white_share, 0.1)
                   - find_level(np.sqrt(7.0), rho, 3.0 / 7.0, 0.1)) < 3.0 * found.log_level_sd
        more = [x + 3.0 * np.cos(0.1 * time) for x in traces]  # a misfit of as much again
        assert (estimate_noise(more, 1.0, 0.1, 2.0, whole=measure_deviation(more), digit=6.0)
                == estimate_noise(more, 1.0, 0.1, 2.0, whole=measure_deviation(more)))
        white = [6.0 * np.round((swing + draw_noise(generator, 300, 1.0, 0.0, 0.0)) / 6.0) - swing for _ in range(6)]
        told = estimate_noise(white, 1.0, 0.1, 2.0, whole=measure_deviation(white), digit=6.0)
        assert told.sd == pytest.approx(2.0, rel=0.03) and told.correlation < 0.2


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
    white = whitening_matrix(weights, taps) @ np.array(traces).T
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


def test_spectrum_and_deviation_are_those_of_the_autocovariance():
    noise, lag = make_noise(1.0, 0.7, 0.25, 1.0), np.arange(-400, 401)
    for f in (0.01, 0.2, 0.45):
        power = np.sum(noise.covariance(lag) * np.cos(2 * np.pi * f * lag))
        assert noise_estimation._spectrum(f, 1.0, 0.7, 0.25) == pytest.approx(power)
        assert noise_estimation._spectrum(f / 0.1, 0.1, 0.7, 0.25) == pytest.approx(power)
    covariance = noise.covariance(np.arange(12)[:, None] - np.arange(12)[None, :])
    about = np.trace(covariance @ (np.eye(12) - 1.0 / 12.0)) / 11.0
    same = Deviation(np.sqrt(about), 500, 12)
    assert same.lose(1.0, 0.7, 0.25) == pytest.approx(0.0, abs=1e-12)
    less = same.lose(1.2, 0.7, 0.25, beyond=True)
    assert less == same.lose(1.2, 0.7, 0.25) > 0.5  # noise of that size would stray further
    assert same.lose(0.8, 0.7, 0.25, beyond=True) == 0.0 < same.lose(0.8, 0.7, 0.25)


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.8, 0.0), (0.9, 0.5)])
def test_loss_of_a_deviation_is_chi_square(rho, white):
    """Under the noise that made the samples, twice the loss is a chi-square of one degree of freedom."""
    twice = []
    for seed in range(200):
        generator = np.random.default_rng([17, seed])
        found = measure_deviation([draw_noise(generator, 200, 2.0, rho, white) for _ in range(12)])
        twice.append(2.0 * float(found.lose(2.0, rho, white)))
    assert 0.75 < np.mean(twice) < 1.35 and np.mean(np.array(twice) > 3.84) < 0.11


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.6, 0.0), (0.8, 0.4)])
@pytest.mark.parametrize("factor", [0.2, 0.5, 2.0, 5.0])
def test_a_wrong_statement_is_given_up(rho, white, factor):
    """Noise several times as loud or as quiet as stated is found as if nothing were stated."""
    generator = np.random.default_rng(23)
    traces = [draw_noise(generator, 300, 2.0, rho, white) for _ in range(16)]
    found = estimate_noise(traces, 1.0, 0.05, 2.0 * factor, whole=measure_deviation(traces))
    assert abs(np.log(found.sd / 2.0)) < 0.12
    assert abs(find_level(found.sd, found.correlation, found.white_share, 0.05)
               - find_level(2.0, rho, white, 0.05)) < max(3.0 * found.log_level_sd, 0.1)


@pytest.mark.parametrize(("factor", "noise"), [(3.0, True), (20.0, False)])
def test_readings_without_contact_bound_the_noise(factor, noise):
    """What a fit leaves may be three times as loud as before first touch, and as stated; twenty times is no noise."""
    generator = np.random.default_rng(24)
    traces = [draw_noise(generator, 300, 2.0 * factor, 0.95, 0.0) for _ in range(5)]
    found = estimate_noise(traces, 1.0, 0.05, 2.0, quiet=Deviation(2.0, 200, 5), whole=measure_deviation(traces))
    assert bool(abs(np.log(found.sd / (2.0 * factor))) < 0.3) is noise and (noise or found.sd < 12.0)


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.6, 0.0), (0.9, 0.4)])
@pytest.mark.parametrize("misfit", [0.0, 6.0])
def test_a_right_statement_stands(rho, white, misfit):
    """Whatever slow misfit the residuals hold, and though a fit has taken some of what is slow in the noise."""
    time = np.linspace(-1.0, 1.0, 300)
    slow = np.polynomial.polynomial.polyvander(time, 3)
    for seed in range(5):
        generator = np.random.default_rng([29, seed])
        noise = [draw_noise(generator, 300, 2.0, rho, white) for _ in range(16)]
        left = [x - slow[:, :3] @ np.linalg.lstsq(slow[:, :3], x, rcond=None)[0] for x in noise]
        whole = measure_deviation([x + misfit * np.cos(np.pi * time) for x in left])
        fast = [x - slow @ np.linalg.lstsq(slow, x, rcond=None)[0] for x in noise]
        assert estimate_noise(fast, 1.0, 0.05, 2.0, whole=whole) == estimate_noise(fast, 1.0, 0.05, 2.0)


@pytest.mark.parametrize("wavelength", [20.0, 33.3])
@pytest.mark.parametrize("rho", [0.0, 0.4])
def test_a_stick_slip_is_no_loud_noise(rho, wavelength):
    """Saw teeth of several times the stated noise, in step in all records: the size taken stays far below theirs."""
    place = np.arange(240)
    for seed, factor in enumerate((4.0, 6.0, 9.0)):
        generator = np.random.default_rng([31, seed])
        teeth = factor * 2.0 * np.sqrt(3.0) * (2.0 * (place / wavelength % 1.0) - 1.0)
        traces = [draw_noise(generator, 240, 2.0, rho, 0.0) + generator.uniform(0.7, 1.3) * teeth for _ in range(16)]
        found = estimate_noise(traces, 1.0, 0.04, 2.0, whole=measure_deviation(traces))
        assert found.sd < 0.6 * factor * 2.0


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


def make_pairs(generator, n=300, records=4, rho=0.5, white=0.0):
    """Traces with a third of their samples missing, as times and values."""
    found = []
    for _ in range(records):
        kept = generator.random(n) > 0.33
        found.append((1e-3 * np.flatnonzero(kept), draw_noise(generator, n, 2.0, rho, white)[kept]))
    return found


@pytest.mark.parametrize(("rho", "white"), [(0.0, 0.0), (0.7, 0.0), (0.6, 0.4)])
def test_the_error_of_the_level_from_pairs(rho, white):
    """Of 30 campaigns the level is off by one stated error, rms, within a factor."""
    lowest, z = noise_estimation.SLOW[0] / BELOW.mean(), []
    for seed in range(30):
        found = estimate_from_pairs(make_pairs(np.random.default_rng([8, seed]), rho=rho, white=white), 1e-3, 2.0)
        z.append((find_level(found.sd, found.correlation, found.white_share, lowest)
                  - find_level(2.0, rho, white, lowest)) / found.log_level_sd)
    assert 0.25 < np.sqrt(np.mean(np.square(z))) < 1.2


@pytest.mark.parametrize("stated", [None, 2.0])
def test_noise_in_other_units(stated):
    """Of seconds and of newtons: correlation, shares and relative errors are the same, the size goes along."""
    generator = np.random.default_rng(11)
    traces, pairs = [draw_noise(generator, 199, 2.0, 0.6, 0.2) for _ in range(3)], make_pairs(generator)
    scaled = None if stated is None else 1e3 * stated
    for one, other in (
            (estimate_noise(traces, 0.1, 0.3, stated), estimate_noise([1e3 * x for x in traces], 10.0, 0.003, scaled)),
            (estimate_from_pairs(pairs, 0.99e-3, stated),
             estimate_from_pairs([(60.0 * t, 1e3 * x) for t, x in pairs], 0.0594, scaled))):
        assert (other.sd, other.correlation) == (pytest.approx(1e3 * one.sd), pytest.approx(one.correlation))
        assert other.white_share == pytest.approx(one.white_share, abs=1e-9)
        assert other.log_level_sd == pytest.approx(one.log_level_sd, rel=1e-6)
        assert (one.stated_sd, other.stated_sd) == (stated, scaled)


@pytest.mark.parametrize("stated", [None, 2.0])
def test_too_few_samples_count_as_white(stated):
    """Of the stated size, or their own: rms of neighbours' differences over sqrt 2 where some are missing."""
    x = np.random.default_rng(12).normal(size=20)
    found = estimate_noise([x], 0.1, 0.5, stated)
    assert found.is_white and found.white_share == 0.0 and found.sd == (stated or pytest.approx(np.std(x)))
    assert found.stated_sd == stated and found.interval == 0.1 and found.log_level_sd == 0.2
    time = np.arange(20) + 0.3 * (np.arange(20) % 2)
    pairs = [(x[k:] - x[:-k]) ** 2 for k in range(1, noise_estimation.PAIRS + 1)]
    found = estimate_from_pairs([(time, x)], 1.0, stated)
    assert found.is_white and found.sd == (stated or pytest.approx(np.sqrt(np.mean(np.concatenate(pairs)) / 2.0)))
    gap = np.concatenate([time[:10], time[10:] + 1e3])  # pairs across a gap are none
    own = [np.concatenate([part[k:] - part[:-k] for part in (x[:10], x[10:])]) ** 2 for k in range(1, 7)]
    expected = stated or pytest.approx(np.sqrt(np.mean(np.concatenate(own)) / 2.0))
    assert estimate_from_pairs([(gap, x)], 1.0, stated).sd == expected


def test_values_that_are_taken_together():
    """Means of those at one place; with more places than are kept apart, of neighbours, none of which is lost."""
    x, values = np.array([3.0, 1.0, 3.0, 2.0, 1.0]), np.array([1.0, 2.0, 5.0, 7.0, 4.0])
    places, counts, means = noise_estimation._gather(x, values)
    assert places == pytest.approx([1.0, 2.0, 3.0]) and counts.tolist() == [2, 1, 2]
    assert means == pytest.approx([3.0, 7.0, 3.0])
    many, values = np.arange(5000.0), np.random.default_rng(0).random(5000)
    places, counts, means = noise_estimation._gather(many, values)
    assert len(places) == noise_estimation.MOST and counts.sum() == 5000 and set(counts) == {2, 3}
    assert counts @ means == pytest.approx(values.sum()) and counts @ places == pytest.approx(many.sum())
    assert np.all(np.diff(places) > 0)


def test_splines_of_long_records_by_their_normal_equations(monkeypatch):
    """The same least squares, to a millionth."""
    time = np.linspace(0.0, 1.0, 300)
    columns, values = spline_columns(time, [(-0.1, 1.0, 20)]), np.sin(9.0 * time)
    whole = noise_estimation._fit_splines(columns, values)
    monkeypatch.setattr(noise_estimation, "LARGE", 0)
    np.testing.assert_allclose(columns @ noise_estimation._fit_splines(columns, values), columns @ whole, atol=1e-6)
    assert np.max(np.abs(columns @ whole - values)) < 1e-3


@pytest.fixture(scope="module")
def campaigns():
    """Impacts with noise of a correlation, as toys, with the fit of the right model."""
    return {rho: [fit_toy(make_selection(seed, rho=rho)) for seed in range(6)] for rho in (0.0, 0.6)}


def test_samples_before_first_touch(campaigns):
    """Their deviation about the mean of each record, of those complete with more than three."""
    selection, _ = campaigns[0.0][0]
    values = np.asarray(selection.records.stack.values)[:, 0]
    before = values[:, TIME < -1e-4]
    count = before.shape[1]
    found = noise_estimation._measure_quiet(selection.records, 0)
    expected = np.sqrt(np.sum(np.var(before, axis=1, ddof=1)) / 8.0)
    assert dc.astuple(found) == (pytest.approx(expected), 8 * (count - 1), count)
    some = np.ones((8, 1), bool)
    some[2:] = False
    part = noise_estimation._measure_quiet(dc.replace(selection.records, complete=some), 0)
    assert dc.astuple(part) == (pytest.approx(np.sqrt(np.mean(np.var(before[:2], axis=1, ddof=1)))),
                                2 * (count - 1), count)
    for number, told in ((4, True), (3, False)):
        late = dc.replace(selection.records.stack, time=np.tile(TIME - TIME[number] + 1e-6, (8, 1)))
        few = noise_estimation._measure_quiet(dc.replace(selection.records, stack=late), 0)
        assert (few is not None) == told and (few is None or (few.count, few.length) == (8 * (number - 1), number))
    # Where a fit took first touch to be earlier than a clock says, what follows it is contact.
    touch = np.where(np.arange(8) < 4, TIME[5] + 1e-4 + 1e-6, 1.0)
    early = noise_estimation._measure_quiet(selection.records, 0, touch)
    assert early is not None and early.count == 4 * 5 + 4 * (count - 1)


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_noise_of_a_campaign(campaigns, rho):
    """Size and correlation are found from what is left of a fit, whatever smooth force is missing."""
    for wave in (0.0, 1.0):
        sizes, correlations = [], []
        for selection, fitted in campaigns[rho]:
            solution = fitted.solution
            missing = wave * np.sin(np.pi * np.clip(TIME, 0.0, 1.0))
            found = noise_estimation.measure_noise(
                selection.campaign, selection.records, dc.replace(solution, channels=solution.channels + missing))
            assert list(found) == ["normal_force"] and found["normal_force"].stated_sd == 0.05
            assert found["normal_force"].interval == pytest.approx(TIME[1] - TIME[0])
            sizes.append(found["normal_force"].sd)
            correlations.append(found["normal_force"].correlation * (1.0 - found["normal_force"].white_share))
        assert np.mean(sizes) == pytest.approx(0.05, rel=0.02) and np.mean(correlations) == pytest.approx(rho, abs=0.12)


def test_noise_of_a_campaign_with_gaps(campaigns):
    """From pairs of samples where some are missing; too few count as white, of the stated size."""
    selection, fitted = campaigns[0.6][0]
    stack, complete = selection.records.stack, np.zeros((8, 1), bool)
    weights = np.array(stack.weights)
    weights[:, :, ::4] = 0.0
    gaps = dc.replace(selection.records, complete=complete, stack=dc.replace(stack, weights=weights))
    found = noise_estimation.measure_noise(selection.campaign, gaps, fitted.solution)["normal_force"]
    assert found.sd == pytest.approx(0.05, rel=0.05) and found.correlation > 0.3
    assert found.interval == pytest.approx(TIME[1] - TIME[0])
    weights[:, :, 20:] = 0.0
    few = dc.replace(gaps, stack=dc.replace(stack, weights=weights))
    found = noise_estimation.measure_noise(selection.campaign, few, fitted.solution)["normal_force"]
    assert found.is_white and (found.sd, found.log_level_sd) == (0.05, 0.1)


def test_slow_parts_that_a_fit_took_stay(campaigns):
    selection, fitted = campaigns[0.0][0]
    before = {"normal_force": dc.replace(make_noise(0.05), slow_sd=0.2, slow_time=3.0)}
    found = noise_estimation.measure_noise(selection.campaign, selection.records, fitted.solution, before=before)
    assert (found["normal_force"].slow_sd, found["normal_force"].slow_time) == (0.2, 3.0)


def test_noise_of_records_of_other_sizes():
    """Half of them with noise four times as large: in the ratio of four, and as large over all as it is."""
    def spoil(values, conditions):
        values[::2] += 0.05 * np.sqrt(15.0) * np.random.default_rng(1).standard_normal(values[::2].shape)

    selection, fitted = fit_toy(make_selection(3, spoil=spoil))
    found = noise_estimation.measure_noise(selection.campaign, selection.records, fitted.solution)["normal_force"]
    sizes = np.array([found.sizes[key] for key in selection.records.keys])
    assert np.mean(sizes[::2]) / np.mean(sizes[1::2]) == pytest.approx(4.0, rel=0.2)
    assert np.sqrt(np.mean(sizes**2)) == pytest.approx(1.0) and found.stated_sd == 0.05
    assert found.sd == pytest.approx(0.05 * np.sqrt(8.5), rel=0.15)


def test_sizes_of_a_noise_that_varies(campaigns):
    """What is measured of residuals over their sizes comes back to their own: rms 1 over all, parts in its unit."""
    records = dc.replace(campaigns[0.0][0][0].records, keys=("a", "b"))
    relative = [np.array([1.0, 3.0]), np.array([2.0, 2.0, 5.0])]
    rms = np.sqrt(np.mean(np.concatenate(relative) ** 2))
    for share, rate_share in ((0.1, 0.0), (0.0, 0.2), (1e-3, 1e-3), (0.0, 0.0)):
        sizes = Sizes(0.5, share, rate_share, np.ones(2), False, relative)
        found = noise_estimation._describe_sizes(make_noise(sd=3.0), sizes, records, 1.7)
        assert found.sd == pytest.approx(3.0 * rms) and (found.stated_sd, found.correlation) == (1.7, 0.6)
        assert [found.sizes[key] * rms for key in "ab"] == [pytest.approx(one) for one in relative]
        assert (found.share, found.rate_share) == pytest.approx((3.0 * share, 3.0 * rate_share))
        assert found.floor == (pytest.approx(1.5) if share or rate_share else None)


def listen_to(monkeypatch, selection, fitted, records):
    """Which estimators are asked, and with what."""
    asked = []
    for kind, name in (("whole", "estimate_noise"), ("pairs", "estimate_from_pairs")):
        monkeypatch.setattr(noise_estimation, name,
                            lambda *given, kind=kind: asked.append((kind, *given)) or make_noise(0.05))
    monkeypatch.setattr(noise_estimation, "measure_sizes", lambda *given: None)
    monkeypatch.setattr(noise_estimation, "look_random", lambda *given: False)
    noise_estimation.measure_noise(selection.campaign, records, fitted.solution)
    (one,) = asked
    return one


@pytest.mark.parametrize(("gaps", "expected"), [(0, "whole"), (3, "whole"), (5, "pairs"), (8, "pairs")])
def test_spectra_where_most_records_are_whole(monkeypatch, campaigns, gaps, expected):
    """Else pairs of samples, of all records; a record with gaps keeps its stretches of 24 samples."""
    selection, fitted = campaigns[0.0][0]
    stack = selection.records.stack
    weights, complete = np.array(stack.weights), np.ones((8, 1), bool)
    weights[:gaps, :, 5::10], complete[:gaps] = 0.0, False
    records = dc.replace(selection.records, complete=complete, stack=dc.replace(stack, weights=weights))
    kind, traces, *_ = listen_to(monkeypatch, selection, fitted, records)
    assert kind == expected and len(traces) == (8 - gaps if kind == "whole" else 8)


def test_traces_of_one_sampling_interval(monkeypatch, campaigns):
    """Of records taken at two intervals those at the one that most have; frequencies are above those of a contact."""
    selection, fitted = campaigns[0.0][0]
    stack = selection.records.stack
    time = np.array(stack.time)
    time[:3] *= 2.0
    records = dc.replace(selection.records, stack=dc.replace(stack, time=time))
    kind, traces, interval, lowest, stated, quiet, *_ = listen_to(monkeypatch, selection, fitted, records)
    assert kind == "whole" and len(traces) == 5 and interval == pytest.approx(TIME[1] - TIME[0])
    spans = [noise_estimation.list_spans(records, r, 1.0)[0] for r in range(8)]
    assert lowest == pytest.approx(10.0 / np.median([span.high - span.low for span in spans]))
    assert stated == 0.05 and quiet is not None


def test_frequencies_of_records_that_run_on(monkeypatch, campaigns):
    """Above six tenths of what the splines take out, by those of the interval that most have."""
    selection, fitted = campaigns[0.0][0]
    stack = selection.records.stack
    time = np.array(stack.time)
    time[5:] *= 0.5  # twice the splines a second
    records = dc.replace(selection.records, family="tumble", stack=dc.replace(stack, time=time))
    kind, traces, interval, lowest, _, quiet, *_ = listen_to(monkeypatch, selection, fitted, records)
    (span,) = noise_estimation.list_spans(records, 0, 1.0)
    assert kind == "whole" and len(traces) == 5 and interval == pytest.approx(TIME[1] - TIME[0]) and quiet is None
    number = min(span.splines, len(TIME) // 4)
    assert lowest == pytest.approx(0.6 * number / (TIME[-1] - TIME[0]), rel=1e-6)


def test_whether_hum_is_new():
    plain, hum = make_noise(), dc.replace(make_noise(), hum=((50.0, 0.3),))
    other = dc.replace(hum, hum=((50.0, 0.4),))
    for before, after, more in (({}, hum, True), ({"x": plain}, hum, True), ({"x": hum}, hum, False),
                                ({"x": hum}, other, True), ({}, plain, False), ({"x": hum}, plain, False)):
        assert has_more_hum(before, {"x": after}) is more
    assert changed({"x": plain}, {"x": hum}) and not changed({"x": hum}, {"x": hum})
    assert differs_from_stated({"x": dc.replace(hum, correlation=0.0)})


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


def test_one_sample_and_none_that_is_valid():
    """What stands alone is over its own deviation."""
    for valid in (np.array([True]), np.array([False])):
        weights, taps = whitening(SLOW, np.zeros(1), valid)
        assert weights == pytest.approx(valid / np.hypot(1.5, 3.0)) and not taps.any() and taps.shape == (1, TAPS)


@pytest.mark.parametrize("uneven", [0.0, 0.02])
def test_every_sample_is_predicted_from_those_before_it(uneven):
    """The last row of the inverse of the covariance of a sample and the eight before it is 1/sd² of what is left, times
    one and the taps with the other sign, also where samples are missing."""
    n = 60
    time = 0.1 * np.arange(n) + uneven * np.sin(np.arange(n))
    valid = np.random.default_rng(2).random(n) > 0.15
    valid[0] = False
    noise = dc.replace(SLOW, correlation=0.7)
    weights, taps = whitening(noise, time, valid)
    for t in np.flatnonzero(valid):
        near = [k for k in range(max(t - TAPS, 0), t) if valid[k]]
        own = time[[*near, t]]
        last = np.linalg.inv(noise.covariance(own[:, None] - own))[-1]
        assert weights[t] == pytest.approx(np.sqrt(last[-1]), rel=1e-6)
        expected = np.zeros(TAPS)
        expected[[t - 1 - k for k in near]] = -last[:-1] / last[-1]
        np.testing.assert_allclose(taps[t], expected, atol=1e-6)
    assert not weights[~valid].any() and not taps[~valid].any()
    small = dc.replace(noise, sd=1e-6 * noise.sd, slow_sd=1e-6 * noise.slow_sd)  # in another unit
    for one, other, factor in zip(whitening(small, time, valid), (weights, taps), (1e6, 1.0), strict=True):
        np.testing.assert_allclose(one, factor * other, rtol=1e-6, atol=1e-6)


def test_many_samples_are_looked_at_in_parts(monkeypatch):
    """However many predictors are computed at once, they are the same."""
    time, valid = np.cumsum(np.random.default_rng(3).uniform(0.05, 0.15, 50)), np.arange(50) % 7 > 0
    whole = whitening(SLOW, time, valid)
    monkeypatch.setattr(noise_module, "BATCH", 7)
    for one, other in zip(whole, whitening(SLOW, time, valid), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_slow_parts_of_another_noise():
    """Baseline and hum come to one's own: variances and covariances add."""
    plain = dc.replace(make_noise(), hum=((50.0, 0.3),))
    other = dc.replace(make_noise(7.0, 0.1), slow_sd=3.0, slow_time=0.7, hum=((60.0, 0.4),))
    both, lag = plain.with_slow_parts(other), np.array([0.0, 0.1, 2.0])
    assert both.hum == ((50.0, 0.3), (60.0, 0.4)) and (both.sd, both.correlation) == (plain.sd, plain.correlation)
    np.testing.assert_allclose(both.covariance(lag), plain.covariance(lag) + 9.0 * np.exp(-lag / 0.7), rtol=1e-12)
    assert both.deviations(np.zeros(3)) == pytest.approx(np.sqrt(4.0 + 9.0 + 0.09 + 0.16))
    assert plain.with_hum(()).hum == plain.hum
    assert dc.replace(plain, sizes={"a": np.ones(2)}).without_sizes().sizes == {}


def test_which_noise_is_white():
    """Neither correlated nor beside a baseline that wanders."""
    assert make_noise(rho=0.0).is_white and not make_noise(rho=0.3).is_white and not SLOW.is_white
    assert not dc.replace(SLOW, correlation=0.0).is_white
    assert dc.replace(SLOW, correlation=0.0, slow_sd=0.0).is_white
    assert not dc.replace(SLOW, correlation=0.0, slow_sd=0.5).is_white


@pytest.mark.parametrize("noise", [make_noise(rho=0.0), make_noise(white=0.3), SLOW])
def test_filter_of_noise_of_other_sizes(noise):
    """It gives what the filter makes of every sample over its size, also beside missing samples."""
    generator, n = np.random.default_rng(9), 60
    valid, sizes = generator.random(n) > 0.1, np.exp(generator.normal(size=n))
    weights, taps = whitening(noise, 0.1 * np.arange(n), valid)
    x = generator.normal(size=(n, 3))
    found = whitening_matrix(*scale_whitening(weights, taps, sizes)) @ x
    np.testing.assert_allclose(found, whitening_matrix(weights, taps) @ (x / sizes[:, None]), rtol=1e-12, atol=1e-12)


def test_filter_of_other_sizes_is_the_factor_of_their_covariance():
    """Of no more samples than the taps and one, noise of covariance s_i C_ij s_j becomes white."""
    generator, n = np.random.default_rng(10), TAPS + 1
    time, sizes = 0.1 * np.arange(n), np.exp(generator.normal(size=n))
    matrix = whitening_matrix(*scale_whitening(*whitening(SLOW, time, np.ones(n, bool)), sizes)).toarray()
    covariance = sizes[:, None] * SLOW.covariance(time[:, None] - time) * sizes
    np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(n), atol=1e-7)


def test_deviation_of_a_reading():
    """Floor, shares of the reading and of its change, and baseline add in squares; one size where none is known."""
    reading = np.array([[0.0, 3.0, 6.0, 9.0], [5.0, 5.0, 5.0, 5.0]])
    noise = dc.replace(make_noise(), floor=0.3, share=0.1, rate_share=0.5, slow_sd=0.4)
    rate = np.array([[3.0] * 4, [0.0] * 4])
    expected = np.sqrt(0.09 + 0.01 * reading**2 + 0.25 * rate**2 + 0.16)
    np.testing.assert_allclose(noise.deviations(reading), expected, rtol=1e-12)
    np.testing.assert_allclose(noise.deviations(reading[0]), expected[0], rtol=1e-12)
    two = np.sqrt(0.09 + 0.01 * np.array([1.0, 16.0]) + 0.25 * 9.0 + 0.16)
    np.testing.assert_allclose(noise.deviations(np.array([1.0, 4.0])), two, rtol=1e-12)
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
