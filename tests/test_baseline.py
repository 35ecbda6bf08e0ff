"""Baselines: zeros that are another in every record are found, and what may be physics is left to it."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers_statistics import SPEEDS, TIME, assert_rate, fit_toy, make_selection

from ddetumble.measurement.units import Uncertainty
from ddetumble.selection import data_errors
from ddetumble.selection.data_errors import find_moving_zeros, tell_zero
from ddetumble.selection.settings import BaselineSettings, SelectionSettings


RAMP = (TIME - TIME[0]) / (TIME[-1] - TIME[0])


def move(offsets, drifts, channel=0):
    def spoil(values, conditions):
        values[:, channel] += np.asarray(offsets)[:, None] + np.asarray(drifts)[:, None] * RAMP
    return spoil


def scatter(size=1.0, seed=0):
    generator = np.random.default_rng(seed)
    return size * generator.standard_normal(8), size * generator.standard_normal(8)


def find(spoil, final=True, settings=None, contact=True, **options):
    settings = SelectionSettings(baseline=BaselineSettings(**settings)) if settings else None
    selection, fitted = fit_toy(make_selection(options.pop("seed", 1), spoil=spoil, settings=settings, **options))
    if not contact:
        family = dc.replace(selection.family, kind=dc.replace(selection.family.kind, has_contact=False))
        object.__setattr__(selection, "space", _WithFamily(selection.space, family))
    return find_moving_zeros(selection, fitted.solution, final)


class _WithFamily:
    """A space of another family."""

    def __init__(self, space, family):
        self.space, self.family = space, family

    def __getattr__(self, name):
        return getattr(self.space, name)


@pytest.mark.parametrize("final", [False, True])
def test_zeros_that_move_are_found(final):
    """With the largest and the rms offset and drift; the model's own misfit is theirs."""
    offsets, drifts = scatter()
    found = find(move(offsets, drifts), final)
    assert found is not None and found.channel == "normal_force" and 0.95 < found.share <= 1.0
    assert found.offset == pytest.approx(np.abs(offsets).max(), abs=0.1)
    assert found.drift == pytest.approx(np.abs(drifts).max(), abs=0.15)
    assert found.spread == pytest.approx((np.sqrt(np.mean(offsets**2)), np.sqrt(np.mean(drifts**2))), abs=0.1)


def test_no_zero_moves_in_right_campaigns():
    assert not any(find(None, seed=seed) for seed in range(60))


def test_chance_of_free_zeros_is_as_stated():
    """Two for each record: with every other threshold open, those that remove more than chance has it are as many as
    that, of campaigns that have some misfit at all."""
    open_ = {"p_value": 0.1, "removed_unseen": -1e9, "significant": 0.0, "common": 1e9, "explained": 2.0}
    count = sum(find(None, contact=False, seed=seed, settings=open_) is not None for seed in range(40))
    assert count <= 40 * 0.1 + 3.0 * np.sqrt(40 * 0.1 * 0.9)


def test_a_small_misfit_is_what_exceeds_the_noise():
    """The share that zeros remove is that of the misfit beyond one noise variance a sample."""
    offsets, drifts = scatter(0.08)
    found = find(move(offsets, drifts))
    assert found is not None and 0.8 < found.share <= 1.0


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_chance_of_readings_before_first_touch(rho):
    """Of noise as it is taken, also where neighbours are alike: as often as stated."""
    count = 0
    settings = SelectionSettings(baseline=BaselineSettings(p_value=0.2))
    for seed in range(120):
        selection = make_selection(seed, rho=rho, settings=settings)
        level = dc.replace(selection.noise["normal_force"], correlation=rho)
        count += data_errors._moves_before_touch(dc.replace(selection, noise={"normal_force": level}), 0)
    assert_rate(count, 120, 0.2)


def test_readings_that_may_be_after_first_touch_say_nothing():
    """Closer to it than three errors of the clock, of each record or of all; nor does a pressure, which moves early."""
    spoil = move(*scatter())
    selection = make_selection(1, spoil=spoil)
    assert data_errors._moves_before_touch(selection, 0)
    for error, moves in ((0.01, True), (0.1, False)):
        clock = dc.replace(selection.campaign.independent, common=Uncertainty(error))
        campaign = dc.replace(selection.campaign, independent=clock)
        assert data_errors._moves_before_touch(dc.replace(selection, campaign=campaign), 0) is moves
        deviations = np.array(selection.records.stack.condition_sd)
        deviations[:, 2] = error
        records = dc.replace(selection.records, stack=dc.replace(selection.records.stack, condition_sd=deviations))
        assert data_errors._moves_before_touch(dc.replace(selection, records=records), 0) is moves
    pressure = dc.replace(selection.records, channels=("pressure",))
    named = dc.replace(selection, records=pressure, noise={"pressure": selection.noise["normal_force"]})
    assert data_errors._moves_before_touch(named, 0) is False


def explain(x, free_running=False, rate=None, axial=None, **conditions):
    """Share of a scatter that conditions explain."""
    count = len(x)
    table = pd.DataFrame(conditions, index=range(count))
    rate, axial = (np.ones(count) if one is None else one for one in (rate, axial))
    solution = SimpleNamespace(state_rate=np.stack([0.0 * rate, rate], axis=1),
                               channels=np.stack([np.zeros((count, 2))] * 2 + [np.stack([axial] * 2, axis=1)], axis=1))
    selection = SimpleNamespace(campaign=SimpleNamespace(records=table),
                                family=SimpleNamespace(free_running=free_running))
    return data_errors._explained(selection, solution, x)


def test_what_conditions_explain_of_a_scatter():
    """By a plane of their logarithms, or a quadratic where there are records enough; all where there are too few."""
    generator = np.random.default_rng(0)
    v, p = np.exp(generator.normal(size=(2, 12)))
    for x in (np.log(v) - 2.0 * np.log(p), np.log(v) * np.log(p), np.log(v) ** 2 + np.log(p)):
        assert explain(x, v=v, p=p) == pytest.approx(1.0)
    assert explain(np.log(v), v=v, p=np.full(12, 3.0)) == pytest.approx(1.0)
    for count, known in ((10, True), (9, False)):  # six columns and four to spare
        assert (explain((np.log(v) * np.log(p))[:count], v=v[:count], p=p[:count]) > 1.0 - 1e-9) == known
    assert explain(generator.normal(size=5), v=v[:5], p=p[:5]) != 1.0 == explain(
        generator.normal(size=4), v=v[:4], p=p[:4])
    shifted = v - 2.0  # not all positive: as they are
    assert explain(shifted**2, v=shifted) == pytest.approx(1.0)
    assert explain(np.log(v), free_running=True, rate=v, axial=p) == pytest.approx(1.0)
    assert explain(np.log(p), free_running=True, rate=v, axial=p) == pytest.approx(1.0)
    assert explain(np.log(v), rate=v, axial=p, w=p) < 0.9


@pytest.mark.parametrize("count", [8, 14])
def test_conditions_explain_nothing_of_noise(count):
    """On average, adjusted for what is fitted."""
    generator = np.random.default_rng(1)
    found = []
    for _ in range(400):
        v, p = np.exp(generator.normal(size=(2, count)))
        found.append(explain(generator.normal(size=count), v=v, p=p))
    assert abs(np.mean(found)) < 4.0 * np.std(found) / 20.0


def test_the_channel_whose_zeros_move():
    found = find(move(*scatter(0.004), channel=1), channels=("normal_force", "depression"))
    assert found is not None and found.channel == "depression"
    both = np.array([1.0, 0.004])

    def spoil(values, conditions):
        generator = np.random.default_rng(0)
        values += both[:, None] * generator.standard_normal((8, 1, 1)) * np.array([1.0, 0.1])[:, None]
    found = find(spoil, channels=("normal_force", "depression"), settings={"removed": 0.001})
    assert found is not None and found.channel == "normal_force"


def test_what_is_the_same_in_all_may_be_physics():
    assert find(move([0.5] * 8, [0.0] * 8)) is None and find(move([0.0] * 8, [0.5] * 8)) is None
    assert find(move([0.5] * 8, [0.0] * 8), settings={"common": 1e3}) is not None


def test_a_few_records_are_looked_at_one_by_one():
    offsets, drifts = scatter()
    few = np.arange(8) < 3
    assert find(move(offsets * few, drifts * few)) is None
    assert find(move(offsets * (np.arange(8) < 5), drifts * (np.arange(8) < 5))) is not None


@pytest.mark.parametrize("settings", [{"p_value": 0.0}, {"removed": 1.01}, {"significant": 1e3}, {"fewest": 9},
                                      {"samples": 13}, {"common": 0.0}])
def test_thresholds_of_baselines_take_effect(settings):
    spoil = move(*scatter(0.5))
    assert find(spoil) is not None and find(spoil, settings=settings) is None


def test_thresholds_at_their_edges():
    spoil = move(*scatter(0.5))
    assert find(spoil, settings={"fewest": 8}) is not None and find(spoil, settings={"samples": 11}) is not None


def test_another_misfit_is_not_a_zero():
    """What comes and goes with the contact, and nothing before first touch."""
    def spoil(values, conditions):
        generator = np.random.default_rng(0)
        values[:, 0] += generator.standard_normal((8, 1)) * ((TIME > 0) & (TIME < 1))
    assert find(spoil) is None

    def both(values, conditions):
        spoil(values, conditions)
        values[:, 0] += 3.0 * np.sin(29.0 * TIME) * (TIME > 0)
        values[:, 0] += 0.3 * np.random.default_rng(1).standard_normal((8, 1))
    assert find(both) is None and find(both, settings={"removed": 0.001, "common": 1e9}) is not None


def test_without_a_contact_zeros_are_a_last_resort():
    """Only once the catalogue was tried, only where they remove nearly all, and not where conditions explain them."""
    offsets, drifts = scatter()
    spoil = move(offsets, drifts)
    assert find(spoil, final=False, contact=False) is None and find(spoil, contact=False) is not None
    assert find(spoil, contact=False, settings={"removed_unseen": 1.01}) is None
    speeds = np.repeat(SPEEDS, 2)
    follows = move(3.0 * (np.log(speeds) - np.log(speeds).mean()), 0.0 * speeds)
    assert find(follows, contact=False) is None and find(follows) is not None
    assert find(follows, contact=False, settings={"explained": 2.0}) is not None


def test_zeros_that_are_fitted_already_are_not_looked_for():
    selection, fitted = fit_toy(make_selection(1, spoil=move(*scatter())))
    records = dc.replace(selection.records, nuisances=(*selection.records.nuisances, "drift:normal_force"))
    assert find_moving_zeros(dc.replace(selection, records=records), fitted.solution, True) is None


def test_what_is_said_of_a_zero():
    selection, fitted = fit_toy(make_selection(1, spoil=move(*scatter())))
    found = find_moving_zeros(selection, fitted.solution, True)
    assert found is not None
    told = tell_zero(selection, found, False)
    assert (told.kind, told.channel, told.records) == ("zero", "normal_force", selection.records.keys)
    assert not told.left_out
