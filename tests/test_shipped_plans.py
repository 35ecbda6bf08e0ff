"""The committed plans of the shipped scenarios, blow by blow, by an integration that shares no code with them."""

import json
import tomllib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ddetumble import find_data
from tests.conftest import ROOT
from tests.independent.two_bodies import coast, integrate_pair


PLANS = {path.stem: path for path in sorted((find_data() / "scenarios").glob("*.toml"))}


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_comes_to_what_it_says(name):
    """Momentum left, duration, depression and force of every blow, and the drift, from attitude and rates at time 0."""
    scenario = tomllib.loads(PLANS[name].read_text(encoding="utf-8"))
    told = json.loads((ROOT / "fits" / "plans" / f"{name}.json").read_text(encoding="utf-8"))
    body, arm, ball = scenario["debris"], scenario["arm"], scenario["ball"]
    mass, radius, length = body["mass"], body["radius"], body["length"]
    assert radius == 1.0  # as `integrate_pair` has it
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    inertia = np.diag([across, across, 0.5 * mass * radius**2])
    frame = Rotation.from_quat(np.roll(body["attitude"], -1)).as_matrix()
    rates = np.array(body["angular_velocity"]) if "angular_velocity" in body else (
        np.linalg.solve(inertia, frame.T @ body["angular_momentum"]))
    fitted = {one["text"]: one["value"] for one in told["contact"]["parameters"]}
    restitution = ball.get("restitution", fitted["coefficient of restitution"])
    leak = fitted.get("lambda (rate at which gas is lost in contact)", 0.0)
    first, drift = np.linalg.norm(inertia @ rates), np.zeros(3)
    for number, blow in enumerate(told["impacts"]):
        # The ball keeps clear after the blow before and before this one.
        assert number == 0 or blow["wait"] >= 2.0 * arm.get("clearance_time", 0.5) - 1e-9
        frame, rates = coast(inertia, frame, rates, blow["wait"])
        end = {"upper end": 0.5 * length, "lower end": -0.5 * length, "side": 0.0}[blow["face"]]
        found = integrate_pair(arm["mass"], ball["friction"], rates, np.array(blow["point"]),
                               np.array(blow["arm_velocity"]), inertia, mass, blow["initial_pressure"], restitution,
                               frame=frame, end=end, leak=leak)
        frame, rates, drift = found.frame, found.rates, drift + found.body
        for key, value in {"duration": found.duration, "peak_depression": found.depths.max(),
                           "peak_normal_force": found.loads.max()}.items():
            assert blow[key] == pytest.approx(value, rel=1e-3), key
        assert blow["share_left"] == pytest.approx(np.linalg.norm(found.momentum) / first, abs=1e-3)
    assert told["share_left"] == pytest.approx(np.linalg.norm(inertia @ rates) / first, abs=1e-3)
    assert told["drift"] == pytest.approx(np.linalg.norm(drift), rel=1e-3, abs=1e-6)
