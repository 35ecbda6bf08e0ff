"""Errors that all records share: what they do to estimates, to first order; and a fit that allows for them."""

import dataclasses as dc

import numpy as np
import pytest

import ddetumble as dd
from ddetumble._settings import find_data
from ddetumble.inference.systematics import Systematic, tell_systematics
from ddetumble.measurement.package import read_campaign
from ddetumble.measurement.units import Uncertainty
from tests.test_impact_values import MASS, SPEEDS, draw_rebounds, make_campaign


def test_only_what_matters_and_does_not_show_is_told():
    hidden = Systematic("load", 0.01, {"a": 1.0, "b": 0.1}, {"a": -4.0, "b": 0.4}, 0.2)
    assert hidden.hidden and "a" in str(hidden) and "load" in tell_systematics((hidden,))
    seen, harmless = dc.replace(hidden, seen=5.0), dc.replace(hidden, deviations={"a": 0.5, "b": 0.1})
    assert not seen.hidden and not harmless.hidden and tell_systematics((seen, harmless)) == ""


@pytest.mark.slow
def test_a_share_of_rebound_speeds_is_a_share_of_the_restitution():
    """n speeds of a relative deviation of s give the restitution to s/sqrt(n), and show nothing of an error that all of
    them share; stated, that adds to it in quadrature."""
    campaign = make_campaign({"rebound_speed": draw_rebounds(1)}, 0.01)
    found = dd.fit(campaign, fixed={"effective_mass": MASS})
    one, = found.systematics
    e = found.parameters["restitution"]
    assert one.name == "rebound_speed" and one.hidden and one.seen < 1e-3
    assert one.deviations["restitution"] == pytest.approx(np.sqrt(len(SPEEDS)), rel=1e-3)
    assert one.moves["restitution"] == pytest.approx(0.01 * e.estimate, rel=0.02)
    stated = dc.replace(campaign, peak_columns={
        name: dc.replace(column, common=Uncertainty(relative=0.02)) for name, column in campaign.peak_columns.items()})
    allowed = dd.fit(stated, fixed={"effective_mass": MASS})
    assert allowed.parameters["restitution"].sd == pytest.approx(np.hypot(e.sd, 0.02 * e.estimate), rel=1e-3)
    assert not allowed.systematics and allowed.parameters["rebound_speed_shift"].sd == pytest.approx(0.02, rel=1e-3)


@pytest.mark.slow
def test_predicted_moves_are_those_of_a_refit():
    """A gauge and a setting that read 1 % high: estimates of the fit to such records."""
    campaign = read_campaign(find_data() / "impact-b")
    found = dd.fit(campaign, effects=["adhesion"])
    high = {"normal_force": dc.replace(campaign, samples=campaign.samples.assign(
                normal_force=1.01 * campaign.samples["normal_force"])),
            "initial_pressure": dc.replace(campaign, records=campaign.records.assign(
                initial_pressure=1.01 * campaign.records["initial_pressure"]))}  # fmt: skip
    told = {one.name: one for one in found.systematics}
    assert set(told) == {"normal_force", "initial_pressure", "approach_speed"}
    for name, changed in high.items():
        again = dd.fit(changed, found, noise=found.noise)
        for key, p in found.parameters.items():
            moved = again.parameters[key].estimate - p.estimate
            assert told[name].moves[key] == pytest.approx(moved, rel=0.05, abs=0.05 * p.sd)
