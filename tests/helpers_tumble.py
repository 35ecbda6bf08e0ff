"""What the tests of tumbling records share: laws from the names of effects, and their motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from ddetumble.contact.effect import parameters_of
from ddetumble.contact.torque import RigidBody
from ddetumble.dynamics.spinning import START, count_steps, spin
from ddetumble.effects import TUMBLE
from ddetumble.exam.simulators.tumbling import RATES as CHANNELS
from ddetumble.exam.simulators.tumbling_campaigns import draw_rates, roll_freely
from ddetumble.measurement.campaign import Campaign, Column, Uncertainty


NOISE = 2e-5  # rad/s, of long records
RATES = [0.05, 0.04, 0.11]
RUN = jax.jit(spin, static_argnames="reverse")


def make_law(ratio, effects, orbit_rate=0.00106):
    """The law of a body with effects by id, all others of the catalogue at their null."""
    found = []
    for effect in TUMBLE:
        values, own = {}, effects.get(effect.id, {})
        for p in parameters_of(effect):
            name, _, part = p.name.partition(".")
            if name in own:
                values[p.field] = own[name][int(part)] if part else own[name]
        found.append(effect(**values))
    return RigidBody(inertia_ratio=jnp.asarray(ratio), orbit_rate=jnp.asarray(orbit_rate)).extend(tuple(found))


def move(law, times, rates=RATES, reverse=False):
    """The motion from given rates at t = 0; `reverse` as of `spin`."""
    times = np.asarray(times, dtype=float)
    steps = count_steps(times[-1], float(np.linalg.norm(rates)), float(np.median(np.diff(times))))
    start = {name: jnp.asarray(float(w)) for name, w in zip(START, rates, strict=True)}
    return RUN(law, start, jnp.asarray(times), jnp.linspace(0.0, times[-1], steps + 1), reverse=reverse)


def make_long(records, duration, interval, ratio=0.55):
    """A campaign of torque-free records in memory, from the closed form."""
    generator = np.random.default_rng(7)
    times = np.arange(round(duration / interval) + 1) * interval
    frames = []
    for k, start in enumerate(draw_rates(generator, records)):
        rates = roll_freely(ratio, start, times) + NOISE * generator.standard_normal((times.size, 3))
        frames.append(pd.DataFrame({"record": f"r{k}", "time": times, **dict(zip(CHANNELS, rates.T, strict=True))}))
    keys = pd.Index([f"r{k}" for k in range(records)], name="record")
    return Campaign(name="long", title="", family="tumble", path=None, known={"inertia_ratio": None},
                    records=pd.DataFrame(index=keys), conditions={}, independent=Column("time", "s"),
                    channels={rate: Column(rate, "rad/s", Uncertainty(NOISE)) for rate in CHANNELS},
                    samples=pd.concat(frames, ignore_index=True))
