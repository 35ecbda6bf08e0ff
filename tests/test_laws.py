"""Simple laws of a missing force: none that the samples cannot tell from a simpler one, none drawn where it is not."""

import dataclasses as dc
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import ddetumble as dd
from ddetumble.contact.effect import AbstractElasticEffect, parameter
from ddetumble.figures import draw_missing_shape
from ddetumble.measurement.campaign import Column, Uncertainty
from ddetumble.measurement.quantities import typeset
from ddetumble.selection.result import Estimate, Law, MissingForce, Shape


INTERVAL, SPEEDS, NOISE = 2e-3, (0.5, 0.7, 0.9, 1.1), 0.25  # s, m/s, N


class Push(AbstractElasticEffect):
    """The elastic force gains k, however deep."""

    k: float = parameter("N", 0.0, typical=1.0, starts=(1.0,))
    id: ClassVar[str] = "push"
    law: ClassVar[str] = "F_k gains k"
    reference: ClassVar[str] = "this test"

    def force(self, contact):
        return self.k * jnp.where(contact.depression > 0, 1.0, 0.0)


def make_pushed(push):
    """Impacts of a soft body with a constant force more, sampled every 2 ms: 1 to 2 mm apart at touch."""
    generator = np.random.default_rng(1)
    law = dd.PowerLaw(effective_mass=1.2, restitution=0.75, stiffness_force=100.0).extend((Push(k=push),))
    rows, frames = [], []
    for k, speed in enumerate(SPEEDS * 3):
        time = np.arange(-0.01, 0.08, INTERVAL) + 0.0007
        true = {"approach_speed": jnp.asarray(speed * (1 + 0.002 * generator.standard_normal()))}
        force = np.asarray(dd.dynamics.simulate_impact(law, true, jnp.asarray(time)).normal_force)
        frames.append(pd.DataFrame({"record": f"r{k}", "time": time,
                                    "normal_force": force + NOISE * generator.standard_normal(len(time))}))
        rows.append({"record": f"r{k}", "approach_speed": speed})
    return dd.Campaign(
        name="pushed", title="", family="impact", path=None, records=pd.DataFrame(rows).set_index("record"),
        known=dict.fromkeys(("effective_mass", "restitution", "stiffness_force", "exponent")),
        conditions={"approach_speed": Column("approach_speed", "m/s", Uncertainty(relative=0.002))},
        independent=Column("time", "s", Uncertainty(absolute=1e-4)),
        channels={"normal_force": Column("normal_force", "N", Uncertainty(absolute=NOISE))},
        samples=pd.concat(frames, ignore_index=True))


@pytest.mark.study
def test_what_saturates_within_a_sample_is_a_constant():
    """8 N are found as such, and no length or onset is given that lies between two samples."""
    found = dd.draw_missing_force(make_pushed(8.0), "power-law", catalogue=False)
    first = found.laws[0].parameters["k"]
    assert set(found.laws[0].parameters) == {"k"} and found.laws[0].variables != ("time",)
    assert first.unit == "N" and abs(first.estimate - 8.0) < 4 * first.sd and first.sd < 0.2
    for law in found.laws:
        shortest = INTERVAL if "time" in law.variables else 0.3 * INTERVAL * min(SPEEDS)
        assert all(e.estimate > shortest for name, e in law.parameters.items() if name[0] in "ld")


def make_drawn(amount, sd=0.02):
    """A missing share of the elastic force, a third at most, and a law that is a constant share of it."""
    x = np.linspace(0.0, 0.05, 121)
    law = Law("(k (constant)) times the elastic force", ("time",), ("share",), ("",), ("constant",),
              {"k": Estimate(amount, 0.01, amount - 0.02, amount + 0.02, "")}, 1050.0, np.array([500.0, 550.0]), 1000.0,
              1, True, 0.0, 0.0)
    shape = Shape("time", "share", ("",), x, np.full((1, 121), 0.3), np.full((1, 121), sd), np.full(121, 1 / 121), "1",
                  18, 0.9, 1020.0, 0.0, 0.0, None, False, np.zeros((3, 0)))
    return MissingForce("impact", (), 3000.0, 3000.0, None, (("share over time",), 1010.0), 1000.0, (shape,), (),
                        (law,))


@pytest.mark.parametrize(("amount", "drawn"), [(0.3, True), (0.33, True), (-3.61, False)])
def test_a_law_is_drawn_only_beside_its_curve(amount, drawn):
    """A law that holds beside other values of the model's parameters is none of the picture's."""
    missing = make_drawn(amount)
    figure = draw_missing_shape(missing)
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert (typeset(missing.laws[0].text) in labels) == drawn
    lowest = min(np.min(line.get_ydata()) for line in figure.axes[0].get_lines())
    assert lowest > -1.0
    # Known up to a constant, a share is what it is of the mean: -2.61 times a force is that force.
    centred = dc.replace(missing, shapes=(dc.replace(missing.shapes[0], values=np.zeros((1, 121)), centred=True),))
    labels = [text.get_text() for legend in draw_missing_shape(centred).legends for text in legend.get_texts()]
    assert typeset(missing.laws[0].text) in labels
