"""The smallest effect that a campaign would have shown: what a refit finds, or not said at all."""

import dataclasses as dc

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.exam.simulators.campaigns import draw_records, write_package
from ddetumble.exam.simulators.tumbling_campaigns import describe_tumbling


NOISE = 0.005  # rad/s, of a phone's gyroscope
TIMES = np.round(np.arange(1001) * 0.01, 9)
BASE = {"inertia_ratio": 1.6}


def write_phone(folder, starts, effects=None, noise=NOISE):
    """A phone thrown or spun by hand: three records of 10 s at 100 Hz."""
    generator = np.random.default_rng(1)
    phone = describe_tumbling("phone", 1, effects or {}, BASE, TIMES, noise=noise, orbit_rate=0.0)
    campaign = draw_records(phone, generator, [{"w0": start} for start in starts])
    write_package(folder, dc.replace(campaign, noise=dict.fromkeys(campaign.noise, NOISE)))
    return folder


@pytest.mark.study
def test_smallest_detectable_is_what_a_refit_finds(tmp_path):
    """With an effect of that size and no noise, the refitted model is off by what the test finds with 95 % power."""
    starts = [[4.0, 1.0, 6.0], [1.0, 5.0, -3.0], [2.0, -3.0, 8.0]]
    found = dd.discover(write_phone(tmp_path / "null", starts))
    assert found.verdict == "nothing-missing"
    sizes = {name: x for c in found.candidates for name, x in c.smallest_detectable.items()}
    # Of some 30 directions at 0.5 % together the largest score is below 3.7; 1.645 more are 95 % power.
    length = dd.map_effects(tmp_path / "null").length
    assert 5.0 < length < 6.0
    for name, parameter in (("eddy-current", "k_e"), ("inertia-asymmetry", "epsilon"), ("axis-misalignment", "angle")):
        size = sizes[f"{name}.{parameter}"]
        fit = dd.fit(write_phone(tmp_path / name, starts, {name: {parameter: size}}, 0.0), noise="stated")
        assert np.sqrt(fit.chi2) == pytest.approx(length, rel=0.05)
    # The scale factor of gyroscopes is the ratio of the moments: no size of it would be seen.
    assert "gyro-scale.g" not in sizes


@pytest.mark.study
def test_nothing_is_said_of_what_depends_on_what_is_not_known(tmp_path):
    """Spun about one axis, records do not fix the ratio of the moments, and with it no torque."""
    campaign = write_phone(tmp_path, [[0.0, 0.0, 5.0], [0.0, 0.0, -3.0], [0.0, 0.0, 7.0]])
    found = dd.discover(campaign)
    assert not any(c.smallest_detectable for c in found.candidates)
    # A ratio at which a record's noise seems to precess is not known, however sharp the minimum there.
    assert found.steps[0].parameters["inertia_ratio"].sd > 1.0
    assert not dd.fit(campaign).parameters["inertia_ratio"].determined
