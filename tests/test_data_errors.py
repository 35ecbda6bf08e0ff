"""Data errors: each kind is recognised by what makes the record fit, and a record without any is called none."""

import dataclasses as dc

import numpy as np
import pandas as pd
import pytest
from helpers_statistics import PRESSURES, SPEEDS, TIME, fit_toy, make_selection

from ddetumble.measurement.campaign import Campaign, Column
from ddetumble.measurement.units import Uncertainty
from ddetumble.selection.data_errors import diagnose, find_rate_units
from ddetumble.selection.leave_record_out import set_aside
from ddetumble.selection.settings import OutlierSettings, SelectionSettings


BOTH = ("normal_force", "depression")


def diagnose_toy(spoil, record=3, **options):
    selection, fitted = fit_toy(make_selection(options.pop("seed", 1), spoil=spoil, **options))
    return diagnose(selection, set_aside(selection, fitted.solution, record))


def scale(factor, channel=0, record=3):
    def spoil(values, conditions):
        values[record, channel] *= factor
    return spoil


def state(name, change, record=3):
    def spoil(values, conditions):
        conditions[name][record] = change(conditions[name][record])
    return spoil


@pytest.mark.parametrize("factor", [1e3, 1e-3, 100.0, 10.0, 0.1, 9.80665, 1 / 9.80665, 4.4482216, 1 / 4.4482216])
def test_a_channel_in_another_unit(factor):
    found = diagnose_toy(scale(factor))
    assert (found.kind, found.channel, found.samples) == ("unit", "normal_force", None)


@pytest.mark.parametrize("factor", [9.80665, 1 / 4.4482216])
def test_noise_that_was_measured_in_another_unit(factor):
    """A record in pounds has the noise of the others in pounds: where each record's own was measured, it is quieter."""
    selection = make_selection(1, spoil=scale(factor))
    sizes = {selection.records.keys[3]: np.full(len(TIME), factor)}
    noise = {channel: dc.replace(one, sizes=sizes) for channel, one in selection.noise.items()}
    selection, fitted = fit_toy(dc.replace(selection.restack(noise), noise=noise))
    found = diagnose(selection, set_aside(selection, fitted.solution, 3))
    assert (found.kind, found.channel) == ("unit", "normal_force")


@pytest.mark.parametrize("factor", [1e3, 1 / 25.4])
def test_which_of_two_channels_is_in_another_unit(factor):
    found = diagnose_toy(scale(factor, 1), channels=BOTH)
    assert (found.kind, found.channel) == ("unit", "depression")


@pytest.mark.parametrize("factor", [57.29578, 25.4, 6.894757])
def test_a_ratio_in_which_no_force_is_written_is_a_gain(factor):
    found = diagnose_toy(scale(factor))
    assert (found.kind, found.channel) == ("gain", "normal_force")


@pytest.mark.parametrize("factor", [1.2, 0.7, 3.0, 12.5])
def test_a_gain(factor):
    found = diagnose_toy(scale(factor, 1), channels=BOTH)
    assert (found.kind, found.channel) == ("gain", "depression")


@pytest.mark.parametrize(("name", "change"), [
    ("initial_pressure", lambda x: x / 6.894757), ("initial_pressure", lambda x: x * 14.503774),
    ("initial_pressure", lambda x: x / 1e3), ("initial_pressure", lambda x: x * 10.0),
    ("initial_pressure", lambda x: x - 101_325.0), ("initial_pressure", lambda x: x + 101_325.0),
    ("approach_speed", lambda x: x * 3.6), ("approach_speed", lambda x: x / 3.6),
    ("approach_speed", lambda x: x * 1000.0), ("approach_speed", lambda x: 60.0 * x)])
def test_a_condition_in_another_unit(name, change):
    found = diagnose_toy(state(name, change))
    assert (found.kind, found.channel) == ("unit", name)


@pytest.mark.parametrize("factor", [1.25, 0.8])
def test_a_condition_that_was_set_otherwise(factor):
    found = diagnose_toy(state("approach_speed", lambda x: factor * x))
    assert (found.kind, found.channel) == ("setting", "approach_speed")


@pytest.mark.parametrize("late", [0.05, -0.03])
def test_a_clock_that_is_off(late):
    def spoil(values, conditions):
        for c in range(2):
            values[3, c] = np.interp(TIME - late, TIME, values[3, c])
    found = diagnose_toy(spoil, channels=BOTH)
    assert (found.kind, found.channel) == ("clock", "time")


@pytest.mark.parametrize(("offset", "drift"), [(0.5, 0.0), (0.0, 2.0), (0.3, -1.0)])
@pytest.mark.parametrize("channel", [0, 1])
def test_a_zero_that_is_off(offset, drift, channel):
    size = (1.0, 0.004)[channel]

    def spoil(values, conditions):
        values[3, channel] += size * (offset + drift * (TIME - TIME[0]) / (TIME[-1] - TIME[0]))
    found = diagnose_toy(spoil, channels=BOTH)
    assert (found.kind, found.channel) == ("zero", BOTH[channel])


@pytest.mark.parametrize("places", [(30,), (20, 51)])
def test_a_few_samples_that_are_off(places):
    def spoil(values, conditions):
        values[3, 0, list(places)] -= 3.0
    found = diagnose_toy(spoil)
    assert (found.kind, found.channel) == ("spike", "normal_force")
    assert found.samples is not None and found.samples.shape == (1, len(TIME))
    assert tuple(np.flatnonzero(found.samples[0])) == places
    few = SelectionSettings(outliers=OutlierSettings(few=0.5 * len(places) / len(TIME)))
    assert diagnose_toy(spoil, settings=few).kind != "spike"
    wide = SelectionSettings(outliers=OutlierSettings(wide=1e3))
    assert diagnose_toy(spoil, settings=wide).kind != "spike"


def test_spikes_of_the_second_channel():
    def spoil(values, conditions):
        values[3, 1, [20, 40]] += 0.01
    found = diagnose_toy(spoil, channels=BOTH)
    assert (found.kind, found.channel) == ("spike", "depression")


def rumble(values, conditions):
    values[3, 0] += 2.0 * np.sin(17.0 * TIME)


@pytest.mark.parametrize("spoil", [rumble, lambda values, conditions: None])
def test_what_is_no_data_error(spoil):
    """Neither a wave that nothing explains, nor, in a record that fits as it is, anything but the first hypothesis."""
    found = diagnose_toy(spoil)
    assert found.kind == "outlier" if spoil is rumble else found.kind != "spike"
    assert found.samples is None


def test_units_are_told_from_gains_within_their_closeness():
    """With no room for the guess of a ratio nothing is called a unit."""
    narrow = SelectionSettings(outliers=OutlierSettings(close=1e-9))
    assert diagnose_toy(scale(1000.0), settings=narrow).kind == "gain"


def test_a_change_has_to_make_the_record_fit():
    """A gain and a wave: with the gain corrected the wave is left, but for whoever is content with little."""
    def spoil(values, conditions):
        values[3, 0] *= 1.6
        values[3, 0] += 0.15 * np.sin(29.0 * TIME)
    assert diagnose_toy(spoil).kind == "outlier"
    assert diagnose_toy(spoil, settings=SelectionSettings(outliers=OutlierSettings(small=1e3))).kind == "gain"
    assert diagnose_toy(spoil, settings=SelectionSettings(outliers=OutlierSettings(fits=-1.0))).kind != "outlier"


def test_an_amplifier_multiplies_its_noise():
    """Noise ten times the stated size is no misfit where the signal is ten times too large as well."""
    for seed in range(5):
        assert diagnose_toy(scale(12.5), seed=seed, conditions=[(v, p) for v in SPEEDS for p in PRESSURES]
                            ).kind == "gain"


RATIO, SPINS = 0.7, (0.6, 0.8, 1.0, 1.2)


def make_rates(factors, seed=0, ratios=None, spins=SPINS, samples=200):
    """Torque-free bodies with two equal moments: the transverse rate turns at (1 - r) times the axial one."""
    generator = np.random.default_rng(seed)
    names = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
    parts = []
    for k, factor in enumerate(factors):
        t, spin = np.linspace(0.0, 20.0, samples), spins[k % len(spins)]
        turn = (1.0 - (RATIO if ratios is None else ratios[k])) * spin * t
        rates = np.stack([0.3 * np.cos(turn), -0.3 * np.sin(turn), np.full_like(t, spin)], axis=1)
        rates = factor * (rates + 1e-3 * generator.standard_normal(rates.shape))
        parts.append(pd.DataFrame({"record": f"t{k}", "time": t} | dict(zip(names, rates.T, strict=True))))
    table = pd.DataFrame(index=pd.Index([f"t{k}" for k in range(len(factors))], name="record"))
    return Campaign("spin", "Spin", "tumble", None, {}, table, {}, Column("time", "s"),
                    {n: Column(n, "rad/s", Uncertainty(1e-3)) for n in names}, pd.concat(parts, ignore_index=True))


@pytest.mark.parametrize("factor", [57.29578, 1 / 57.29578, 9.5492966, 60.0, 1 / 1000.0])
def test_rates_in_another_unit(factor):
    """Euler's equations are not linear in the rates: only in rad/s do all records show the same moments."""
    fault, = find_rate_units(make_rates([1.0, 1.0, factor, 1.0, 1.0]))
    assert fault.kind == "unit" and fault.records == ("t2",) and fault.left_out


def test_rates_in_the_right_unit():
    assert find_rate_units(make_rates([1.0] * 5)) == ()
    assert find_rate_units(make_rates([1.0, 1.0, 1.3, 1.0, 1.0])) == ()  # no known ratio
    assert find_rate_units(make_rates([1.0, 1.0, 57.29578])) == ()  # too few others
    assert len(find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0]))) == 1
    assert find_rate_units(make_selection(0).campaign) == ()
    campaign = make_rates([1.0, 1.0, 57.29578, 1.0, 1.0])
    assert find_rate_units(dc.replace(campaign, samples=None)) == ()
    assert find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0], samples=15)) == ()
    assert len(find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0], samples=16))) == 1


def test_rates_of_bodies_that_differ_say_nothing():
    ratios = [0.7, 0.5, 0.7, 0.3, 0.9]
    assert find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0], ratios=ratios)) == ()
    wide = OutlierSettings(kinematic_spread=10.0, kinematic_slack=0.6)
    assert len(find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0], ratios=ratios), wide)) == 1
    tight = OutlierSettings(kinematic_slack=1e-9)
    assert find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0]), tight) == ()
    still = OutlierSettings(kinematic_noise=0.0)
    assert find_rate_units(make_rates([1.0, 1.0, 57.29578, 1.0, 1.0]), still) == ()
