"""What of a misfit repeats over the records: chance under any noise, certain where physics is missing."""

import dataclasses as dc

import numpy as np
import pytest
from helpers_statistics import CLOCK, PRESSURES, SPEEDS, TIME, fit_toy, make_selection

from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.measurement.campaign import Uncertainty


CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2
TOUCHING = (TIME > 0) & (TIME < 1)


def measure(seed, spoil=None, **options):
    """The p-value under the reference model, of noise taken as white and of the stated size."""
    selection, fitted = fit_toy(make_selection(seed, spoil=spoil, **{"conditions": CONDITIONS} | options))
    return selection.measure_repeats(fitted.solution)


def muddle(seed):
    """More noise in some records than in others, correlated from sample to sample, and more where the force is."""
    def spoil(measured, stated):
        generator = np.random.default_rng([61, seed])
        for values in measured[:, 0]:
            size = 0.05 * np.exp(0.7 * generator.standard_normal())
            values += (1.0 + np.abs(values) / 5.0) * draw_noise(generator, len(values), size, 0.8)
    return spoil


@pytest.mark.slow
def test_noise_does_not_repeat():
    """Uneven, correlated noise taken for white: of 120 campaigns at most 12 are below 5 % (four in a thousand, of true
    p-values, have 13 or more), at most 5 below 1 %, and the median is no smaller than chance has it."""
    found = np.array([measure(seed, muddle(seed)) for seed in range(120)])
    assert np.sum(found < 0.05) <= 12 and np.sum(found < 0.01) <= 5
    assert np.median(found) > 0.5 - 4.0 * 0.5 / np.sqrt(120)


@pytest.mark.parametrize("pattern", [
    lambda v, p: 0.8 * np.sin(3 * np.pi * TIME),  # alike in all
    lambda v, p: 2.4 * np.log(v / 1.5) * np.sin(3 * np.pi * TIME),  # of either sign, as the speed goes
    lambda v, p: 2.4 * np.log(p / 1.26e5) * np.sin(5 * np.pi * TIME),  # as the pressure goes
    lambda v, p: 0.8 * np.sin(40 * np.pi * TIME)])  # too fast for a few splines
def test_what_is_missing_repeats(pattern):
    """A pattern larger than the noise of most records, alike in all or growing with a condition, though the noise is
    uneven: its p-value is below 1 in 300 in all of 5 campaigns."""
    for seed in range(5):
        def spoil(measured, stated, seed=seed):
            muddle(seed)(measured, stated)
            for r, (v, p) in enumerate(CONDITIONS):
                measured[r, 0] += pattern(v, p) * TOUCHING
        assert measure(seed, spoil) < 1 / 300


def test_onsets_may_go_with_the_conditions_within_their_common_error():
    """Found in the force, they are off by the shape of its rise, which goes with the speed."""
    def spoil(measured, stated):
        for r, (v, _) in enumerate(CONDITIONS):
            late = 12.0 * CLOCK * np.log(v / 1.5)
            measured[r, 0] = np.interp(TIME - late, TIME, measured[r, 0])
    selection, fitted = fit_toy(make_selection(3, spoil=spoil, conditions=CONDITIONS))
    clock = dc.replace(selection.campaign.independent, common=Uncertainty(6.0 * CLOCK))
    found = dc.replace(selection, campaign=dc.replace(selection.campaign, independent=clock))
    slight = dc.replace(clock, common=Uncertainty(0.1 * CLOCK))
    other = dc.replace(selection, campaign=dc.replace(selection.campaign, independent=slight))
    assert selection.measure_repeats(fitted.solution) < 1 / 300 > other.measure_repeats(fitted.solution)
    assert found.measure_repeats(fitted.solution) > 0.01


def test_few_records_and_free_running_ones_tell_nothing():
    """None below eight records, and where records share no phase."""
    assert measure(1, conditions=CONDITIONS[:7]) is None
    assert measure(1, conditions=CONDITIONS[:8]) is not None
    selection, fitted = fit_toy(make_selection(1, conditions=CONDITIONS))
    assert dc.replace(selection, records=dc.replace(selection.records, family="tumble")).measure_repeats(
        fitted.solution) is None


def test_the_same_records_give_the_same_chance():
    """Signs are drawn alike every time."""
    assert measure(2, muddle(2)) == measure(2, muddle(2))
