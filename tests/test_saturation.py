"""A gauge at its limit whose noise comes after it: found by the level that records share, and left out."""

import dataclasses as dc

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.contact.sliding import RubberFriction
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import NOISE, make_campaign
from ddetumble.exam.simulators.slip_campaigns import SLIP_NOISE, make_slip_campaign
from ddetumble.measurement.package import read_campaign
from ddetumble.selection.discover import discover
from ddetumble.selection.outliers import begin_cleaning, clean_records
from ddetumble.selection.problem import fit_reference, pose_selection
from ddetumble.selection.saturation import find_saturation


RUBBER = {"adhesion_constant": 0.8, "loss_factor": 0.15, "slip_scale": 1.0}
BALL = {"effective_mass": 1.3, "restitution": 0.7}
LOADS, PRESSURES, SPEEDS = [5.0, 12.0, 20.0, 28.0], [0.8e6, 1.9e6], [0.02, 0.1]


def saturate(folder, level, make, *arguments):
    """A campaign whose readings are cut off at a level before their noise is added."""
    made, clear = (make("limited", 7, *arguments, share) for share in (1.0, 1e-9))
    for noisy, plain in zip(made.records, clear.records, strict=True):
        noisy.values[:, 0] += np.minimum(plain.values[:, 0], level) - plain.values[:, 0]
    write_package(folder, made)
    return read_campaign(folder)


def rub(folder, level, effects=()):
    def make(name, seed, effects, share):
        return make_slip_campaign(name, seed, effects, RUBBER, LOADS, PRESSURES, SPEEDS, length=8e-3, numbered=True,
                                  noise=share * SLIP_NOISE)

    return saturate(folder, level, make, dict(effects))


def strike(folder, level, effects=()):
    def make(name, seed, effects, share):
        return make_campaign(name, seed, effects, BALL, [0.6e6, 1.2e6, 2e6], [0.2, 0.4, 0.6],
                             noise={"normal_force": share * NOISE["normal_force"]})

    return saturate(folder, level, make, dict(effects))


def look(campaign):
    selection, fitted = fit_reference(pose_selection(campaign, RubberFriction()))
    return selection, fitted, find_saturation(selection, fitted)


@pytest.mark.slow
def test_a_level_that_records_share_is_found_behind_the_noise(tmp_path):
    """At 8 N of up to 9.4 N: in the strokes at 28 N alone, where the model of the others goes on."""
    campaign = rub(tmp_path, 8.0)
    selection, fitted, found = look(campaign)
    loads = campaign.records["normal_load"].to_numpy(dtype=float)
    assert found.channel == "tangential_force" and found.level == pytest.approx(8.0, abs=0.25 * SLIP_NOISE)
    assert {key for key, load in zip(campaign.record_keys, loads, strict=True) if load > 25.0} <= set(found.samples)
    assert set(found.samples) <= {key for key, load in zip(campaign.record_keys, loads, strict=True) if load > 15.0}
    assert 0.8 < found.excess < 2.0 and find_saturation(selection, fitted, {"tangential_force"}) is None
    state = begin_cleaning(campaign)
    assert not state.faults  # no reading equals another
    cleaned, changed = clean_records(state, selection, fitted)
    (fault,) = cleaned.faults
    assert changed and fault.kind == "clipped" and set(fault.records) == set(found.samples) and not fault.left_out
    assert cleaned.campaign.record_keys == campaign.record_keys
    lost = cleaned.campaign.samples["tangential_force"].isna().sum()
    assert lost == sum(mask.sum() for mask in found.samples.values())
    kept, changed = clean_records(dc.replace(state, keep_all=True), selection, fitted)
    assert not changed and [f.kind for f in kept.faults][0] == "clipped" and kept.campaign is state.campaign
    compared = dd.compare(campaign)  # tells the limit, and takes the samples as they are
    assert [(f.kind, f.records, f.seen) for f in compared.faults] == [("clipped", fault.records, fault.seen)]
    assert str(compared.faults[0]) in compared.notes


@pytest.mark.parametrize("effects", [
    {}, {"x-wear": {"w": 0.15}}, {"load-exponent": {"m": 0.1}}, {"presliding": {"s_0": 4e-4}},
    {"adhesive-offset": {"f_a": 0.3}}, {"stribeck": {"A": 0.3, "u_s": 0.05}}])
def test_what_bends_the_largest_forces_is_no_limit(tmp_path, effects):
    assert look(rub(tmp_path, np.inf, effects))[2] is None


@pytest.mark.study
def test_the_rest_is_judged_without_what_is_cut_off(tmp_path):
    """Impacts cut off at 50 N: complete without an effect, and with a wall that is there the wall with its size."""
    found = discover(strike(tmp_path / "none", 50.0))
    assert found.verdict == "nothing-missing" and [f.kind for f in found.faults] == ["clipped"]
    found = discover(strike(tmp_path / "wall", 50.0, {"wall-stiffness": {"k_w": 1000.0, "q": 1.0}}))
    assert found.verdict == "explained" and found.effects == ("wall-stiffness",)
    wall = found.steps[-1].parameters["wall-stiffness.k_w"]
    assert wall.q025 - 40.0 < 1000.0 < wall.q975 + 40.0
