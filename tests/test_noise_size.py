"""Size of the noise sample by sample: found where it varies, to what it is, and hardly ever where it does not."""

import dataclasses as dc

import numpy as np
import pytest

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference.noise_size import Run, look_random, measure_sizes


RECORDS, SAMPLES = 6, 120
MEAN = np.sqrt(np.pi / 2.0 / 1.5)  # standard deviation of white normal noise over its mean absolute second difference
NULLS = {"white": lambda g, n: g.standard_normal(n), "correlated": lambda g, n: draw_noise(g, n, 1.0, 0.8),
         "both": lambda g, n: draw_noise(g, n, 1.0, 0.8, 0.4), "heavy tails": lambda g, n: g.standard_t(4, n)}


def draw_runs(seed, size, draw=NULLS["white"], records=RECORDS, samples=SAMPLES, more=0.3):
    """Whole records of noise; `size` gives its standard deviation of a reading and the number of the record,
    every one of which reads `more` higher than the last."""
    generator, t = np.random.default_rng([31, seed]), np.linspace(0.0, 1.0, samples)
    found = []
    for r in range(records):
        reading = 10.0 * (1.0 + more * r) * np.sin(np.pi * t)
        found.append(Run(r, np.arange(samples), size(reading, r) * draw(generator, samples), reading))
    return found


def measure(runs):
    """Sizes of runs that are whole records."""
    return measure_sizes(runs, [len(run.reading) for run in runs])


def grow(reading, record):
    """A tenth beside one percent of the reading."""
    return np.sqrt(0.1**2 + (0.01 * reading) ** 2)


def hurry(reading, record):
    """A tenth beside half the change from sample to sample."""
    return np.sqrt(0.1**2 + (0.5 * np.gradient(reading)) ** 2)


def burst(reading, record):
    """Three times as much over a third of a trace, in every record another one."""
    return np.where(find_place(len(reading), record) < 0.17, 3.0, 1.0)


def find_place(samples, record):
    """How far every sample lies from the middle of its record's burst, round the trace."""
    off = np.linspace(0.0, 1.0, samples) - 0.17 - 0.25 * record
    return abs((off + 0.5) % 1.0 - 0.5)


FACTORS = np.array([1.0, 3.0, 0.5, 1.0, 1.5, 0.8, 2.0, 10.0])


@pytest.mark.parametrize("kind", NULLS)
def test_noise_of_one_size_is_left_alone(kind):
    """At most 3 of 60 campaigns adopt a size that varies: a rate of one in a hundred gives more in 1 of 300."""
    adopted = sum(measure(draw_runs(seed, lambda reading, r: 1.0, NULLS[kind])) is not None for seed in range(60))
    assert adopted <= 3


def test_a_spike_is_no_size():
    """One sample that is off by fifty deviations changes nothing, nor does a kink of the model."""
    adopted = 0
    for seed in range(20):
        runs = draw_runs(seed, lambda reading, r: 1.0)
        runs[2].residual[40] += 50.0
        runs[3].residual[60:] += 20.0
        adopted += measure(runs) is not None
    assert adopted <= 1


def test_noise_in_proportion_to_the_reading():
    """sqrt(0.1² + (0.01 y)²): over 20 campaigns the share over the floor comes out within 6 %, both themselves, up to
    what a mean absolute difference of normal noise is of a deviation, within 5 %, and every sample within 12 % rms."""
    found = [measure(draw_runs(seed, grow, samples=240)) for seed in range(20)]
    assert all(one is not None and one.rate_share == 0.0 for one in found)
    share, floor = np.mean([one.share for one in found]), np.mean([one.floor for one in found])
    assert share / floor == pytest.approx(0.1, rel=0.06)
    assert (MEAN * share, MEAN * floor) == pytest.approx((0.01, 0.1), rel=0.05)
    truth = np.concatenate([grow(run.reading, run.record) for run in draw_runs(0, grow, samples=240)])
    off = [np.log(MEAN * np.concatenate(one.relative) / truth) for one in found]
    assert np.sqrt(np.mean(np.square(off))) < 0.12


def test_noise_that_grows_with_the_rate():
    """A floor and half of every change of the reading, each within 6 %; no share of the reading itself."""
    found = [measure(draw_runs(seed, hurry)) for seed in range(20)]
    assert sum(one is None or one.share > 0 for one in found) <= 1
    rate = [one for one in found if one is not None and one.share == 0]
    assert MEAN * np.mean([one.rate_share for one in rate]) == pytest.approx(0.5, rel=0.06)
    assert MEAN * np.mean([one.floor for one in rate]) == pytest.approx(0.1, rel=0.06)


def test_bursts_are_found():
    """Parts of a trace with three times the noise: between them and the rest lies a ratio of 2.4 to 3.1 on average, as
    parts of forty samples are drawn a little towards the others."""
    place = np.array([find_place(480, r) for r in range(RECORDS)])
    ratios = []
    for seed in range(12):
        found = measure(draw_runs(seed, burst, samples=480))
        assert found.along and found.share == found.rate_share == 0.0
        logarithms = np.log(found.relative)
        ratios.append(logarithms[place < 0.1].mean() - logarithms[place > 0.25].mean())  # no edge lies there
    assert 2.4 < np.exp(np.mean(ratios)) < 3.1


def test_every_record_has_its_own_size():
    """Records of other gains, up to twenty times another: the mean of (true/found)² is the same for all within 10 %."""
    squares = []
    for seed in range(20):
        found = measure(draw_runs(seed, lambda reading, r: FACTORS[r], records=8, more=0.0))
        assert np.ptp(found.records) > 0 and found.share == found.rate_share == 0.0
        squares.append([np.mean((f / (MEAN * own)) ** 2) for f, own in zip(FACTORS, found.relative, strict=True)])
    level = np.mean(squares)
    np.testing.assert_allclose(np.mean(squares, axis=0) / level, 1.0, atol=0.1)


@pytest.mark.parametrize("size", [lambda reading, r: 0.05, grow])
def test_steps_of_the_gauge_are_no_size(size):
    """Readings rounded to more than their noise tell nothing: refused."""
    runs = []
    for run in draw_runs(1, size, samples=400):
        read = 1.0 * np.round((run.reading + run.residual) / 1.0)
        runs.append(dc.replace(run, residual=read - run.reading))
    assert measure(runs) is None


def test_too_few_samples_tell_no_size():
    """None of fewer than sixty differences, of none, and of residuals that are all zero."""
    assert measure_sizes([], [0, 0]) is None
    assert measure([dc.replace(run, residual=np.zeros(SAMPLES)) for run in draw_runs(0, grow)]) is None
    short = [Run(run.record, np.arange(10), 1e3**run.record * run.residual[:10], run.reading[:10])
             for run in draw_runs(0, grow, records=4)]
    assert measure(short) is None


def test_samples_that_no_run_holds_have_the_size_of_their_neighbours():
    """A line between them inside, the nearest at the ends; a record without any run has that of no reading."""
    runs = []
    for run in draw_runs(3, grow):
        for part in (slice(10, 50), slice(70, 110)):
            runs.append(Run(run.record, run.samples[part], run.residual[part], run.reading[part]))
    found = measure_sizes(runs, [SAMPLES] * (RECORDS + 1))
    assert not found.along and np.ptp(found.records) == 0
    for run, own in zip(draw_runs(3, grow), found.relative, strict=False):
        t = np.r_[49, 70]
        np.testing.assert_allclose(own[49:71], np.interp(np.arange(49, 71), t, own[t]), rtol=1e-12)
        np.testing.assert_allclose(own[:10], own[10], rtol=1e-12)
        np.testing.assert_allclose(own[110:], own[109], rtol=1e-12)
        expected = np.sqrt(found.floor**2 + (found.share * run.reading) ** 2)
        np.testing.assert_allclose(own[10:50], expected[10:50], rtol=1e-12)
    np.testing.assert_array_equal(found.relative[RECORDS], np.full(SAMPLES, found.floor))


@pytest.mark.parametrize("factor", [1e-6, 4.0, 1e5])
def test_sizes_follow_the_unit(factor):
    """In another unit the floor is another number, and the share is the same; noise alone so many times as large
    scales both, and no size over another changes."""
    plain = measure(draw_runs(5, grow))
    unit = measure([dc.replace(run, residual=factor * run.residual, reading=factor * run.reading)
                    for run in draw_runs(5, grow)])
    alone = measure([dc.replace(run, residual=factor * run.residual) for run in draw_runs(5, grow)])
    assert unit.floor == pytest.approx(factor * plain.floor, rel=1e-3)
    assert unit.share == pytest.approx(plain.share, rel=1e-3)
    assert (alone.floor, alone.share) == pytest.approx((factor * plain.floor, factor * plain.share), rel=1e-3)
    for one in (unit, alone):
        for own, other in zip(one.relative, plain.relative, strict=True):
            np.testing.assert_allclose(own, factor * other, rtol=1e-3)


def test_the_order_of_the_records_is_none():
    """Records in another order have their sizes in that order, within what a chance estimate of a scatter differs."""
    order = np.array([3, 0, 5, 1, 7, 4, 2, 6])
    runs = draw_runs(6, lambda reading, r: FACTORS[r] * grow(reading, r), records=8, more=0.0)
    plain = measure(runs)
    moved = measure([dc.replace(runs[old], record=new) for new, old in enumerate(order)])
    assert (moved.floor, moved.share) == pytest.approx((plain.floor, plain.share), rel=1e-3)
    np.testing.assert_allclose(moved.records, plain.records[order], rtol=0.01)
    assert moved.along == plain.along
    for new, old in enumerate(order):
        np.testing.assert_allclose(moved.relative[new], plain.relative[old], rtol=0.02)


@pytest.mark.parametrize(("share", "random"), [(0.0, True), (0.3, True), (1.5, False)])
@pytest.mark.parametrize(("correlation", "white_share"), [(0.0, 0.0), (0.5, 0.0), (0.9, 0.0), (0.8, 0.4)])
def test_what_is_smoother_than_noise_does_not_look_random(share, random, correlation, white_share):
    """Noise whose size varies, white and correlated, beside a line of seven samples a turn that a flexible part might
    make; the line is in proportion to what the noise changes from sample to sample."""
    steps = np.sqrt(1.0 - (1.0 - white_share) * correlation)
    for seed in range(5):
        generator, runs = np.random.default_rng([71, seed]), []
        for record in range(4):
            size = 1.0 + 3.0 * np.linspace(0.0, 1.0, 300) ** 2
            line = share * steps * np.sin(2.0 * np.pi * np.arange(300) / 7.0 + record)
            noise = draw_noise(generator, 300, 1.0, correlation, white_share)
            runs.append(Run(record, np.arange(300), size * (noise + 2.0 * line), np.zeros(300)))
        assert look_random(runs) == random


def test_a_smooth_misfit_does_not_look_random():
    """What is left of a missing force, slow over twenty samples and thirty times the noise; nor do too few samples."""
    generator = np.random.default_rng(72)
    runs = [Run(r, np.arange(400), generator.standard_normal(400) + 30.0 * np.sin(np.arange(400) / 3.2 + r),
                np.zeros(400)) for r in range(4)]
    assert not look_random(runs)
    assert not look_random([Run(0, np.arange(30), generator.random(30), np.zeros(30))])
