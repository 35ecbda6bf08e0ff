"""The peers beside which `discover` is timed do the same physics; nothing here is timed."""

import numpy as np
import pytest

from benchmarks import slip_peer
from ddetumble import find_data


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"A": 0.3, "u_s": 0.06, "c_t": 0.7},
        {"m": 0.05, "s_0": 2e-4, "f_a": 0.3},
        {"kappa": 3.0, "s_0": 2e-4},
    ],
)  # fmt: skip
def test_the_peer_of_friction_has_the_toolkits_law(values):
    from ddetumble.contact.sliding import FrictionLaw, RubberFriction
    from ddetumble.dynamics.slide import simulate_sliding
    from ddetumble.effects.slip import SLIP

    c = slip_peer.Campaign(find_data() / "slip-d")
    p = slip_peer.NULLS | slip_peer.REFERENCE | values
    found = slip_peer.predict(p, c, c.load, c.pressure)
    effects = tuple(
        effect(**{name: p[name] for name in names})
        for effect, names in zip(SLIP, [("A", "u_s"), ("c_t",), ("m",), ("s_0",), ("kappa",), ("f_a",)], strict=True)
    )
    law = FrictionLaw(RubberFriction(), effects)
    for r in (0, 5):
        conditions = {"normal_load": c.load[r], "internal_pressure": c.pressure[r], "slip_speed": c.speed[r]}
        want = np.asarray(simulate_sliding(law, conditions, c.slip[r], c.way[r]).tangential_force)
        used = c.weight[r] > 0
        np.testing.assert_allclose(found[r][used], want[used], atol=2e-3 if "kappa" in values else 1e-9)


@pytest.mark.parametrize("one_step", [False, True])
def test_the_peer_of_friction_finds_what_is_missing(one_step):
    c = slip_peer.Campaign(find_data() / "slip-d")
    c.weight = c.weight * (np.arange(c.weight.shape[1]) % 4 == 0)
    rows, added, left = slip_peer.discover(c, one_step)
    assert added == ["presliding"] == [rows[0][1]] and left < 1.2
