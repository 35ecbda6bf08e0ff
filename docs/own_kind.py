"""A kind of test of one's own, in one file: an inflated ball falls on a plate, and an accelerometer inside it is read.

    ddetumble import drops/*.csv --family own_kind.py:DROP --conditions drops.csv --known "mass=0.43 kg" \\
        --known "diameter=0.22 m" --uncertainty "acceleration=5 m/s^2" -o tests
    ddetumble discover tests -o discovery

What the toolkit asks of a kind of test stands on one object, the `Family` at the end of this file. Before it come its
parts: the state that effects see, the reference model, the effects that it may be missing, and the function that
computes one record. A campaign holds `own_kind.py:DROP`, from its own folder on, so that every other command finds this
file by itself.
"""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ddetumble.contact.effect import AbstractEffect, AbstractLaw, AbstractModel, Scalar, parameter
from ddetumble.effects.free import act_on, make_terms
from ddetumble.families import BuiltinModel, Family, Ground, Observation, PlannedTests, RecordKind, Span, View


GRAVITY, AMBIENT = 9.81, 101325.0  # m/s^2, Pa
STEPS = 6  # of the integrator from sample to sample: some 200 while the ball touches, with errors far below the noise
TURN = 0.02  # m/s, rate over which loading turns into unloading


# 1. What an effect sees.
class Touch(eqx.Module):
    """State of the ball at one instant; every entry is a scalar (the caller batches by `vmap`).

    Attributes:
        time: since first touch [s].
        depression: how far the ball is flattened, delta >= 0 [m].
        depression_rate: w, > 0 while loading [m/s].
        gauge_pressure: of the gas [Pa].
        conditions: every condition of the record by name, SI.
    """

    time: Scalar
    depression: Scalar
    depression_rate: Scalar
    gauge_pressure: Scalar
    conditions: Mapping[str, Array]


# 2. Where an effect acts: here there is but one stage. `family` is the name of the `Family` below.
class AbstractDropForce(AbstractEffect):
    """Adds to the force between ball and plate."""

    stage: ClassVar[str] = "force"
    family: ClassVar[str] = "drop"

    @abc.abstractmethod
    def force(self, touch: Touch) -> Scalar:
        """Increment of the force [N]; 0 at the null."""


# 3. The reference model, and the law that it and its effects make up.
@final
class DroppedBall(AbstractModel):
    r"""A membrane without stiffness of its own: $F = p\,c\,\pi D\delta\,(1 + d\,w)$, p the gauge pressure.

    A sphere cut off by the plate has the area $\pi D \delta$ (c = 1).
    """

    area_coefficient: Scalar = parameter(
        "", 1.0, kind="reference", typical=0.2, coordinate="log", bounds=(0.0, jnp.inf), text="c, area over pi D delta",
        limits=(0.1, 3.0), limits_reason="a ball that bulges out to one that is dented")
    damping: Scalar = parameter(
        "s/m", 0.1, kind="reference", typical=0.05, coordinate="log", bounds=(0.0, jnp.inf), text="d",
        limits=(0.0, 5.0), limits_reason="a passive ball does not drive itself")
    mass: Scalar = parameter("kg", 0.4, kind="reference", coordinate="log", bounds=(0.0, jnp.inf), free=False,
                             text="of the ball", limits=(1e-3, 100.0), limits_reason="it was weighed")
    diameter: Scalar = parameter("m", 0.2, kind="reference", coordinate="log", bounds=(0.0, jnp.inf), free=False,
                                 text="of the ball", limits=(1e-2, 5.0), limits_reason="it was measured")
    family: ClassVar[str] = "drop"

    def extend(self, effects: tuple[AbstractEffect, ...]) -> "DropLaw":
        """This ball with effects."""
        return DropLaw(self, effects)


class DropLaw(AbstractLaw):
    """A ball and the effects that extend it: their forces add.

    Attributes:
        reference: the ball.
        effects: any number of effects, at their null or not.
    """

    reference: DroppedBall
    effects: tuple[AbstractEffect, ...] = ()

    def force(self, touch: Touch) -> Array:
        """Force on the ball [N]: none before first touch and after separation, and never a pull."""
        ball = self.reference
        area = ball.area_coefficient * jnp.pi * ball.diameter * touch.depression
        force = touch.gauge_pressure * area * (1.0 + ball.damping * touch.depression_rate)
        for effect in self.effects:
            force = force + effect.force(touch)  # pyright: ignore[reportAttributeAccessIssue]
        return jnp.where(touch.depression > 0.0, jnp.maximum(force, 0.0), 0.0)


# 4. Effects that the model may be missing.
@final
class WallSpring(AbstractDropForce):
    """The wall itself is stiff, whatever the pressure."""

    k: Scalar = parameter("N/m", 0.0, typical=5e3, sign=1, starts=(2e3,), text="stiffness of the wall",
                          limits=(0.0, 1e6), limits_reason="a wall resists; a solid ball has some 1e6 N/m")
    id: ClassVar[str] = "wall-spring"
    law: ClassVar[str] = "F gains k delta"
    reference: ClassVar[str] = "Hooke 1678"

    def force(self, touch: Touch) -> Scalar:
        """Spring force, k delta [N]."""
        return self.k * touch.depression


@final
class Dashpot(AbstractDropForce):
    """The wall is viscous, however far the ball is flattened."""

    b: Scalar = parameter("N s/m", 0.0, typical=10.0, sign=1, starts=(5.0,), text="viscosity of the wall",
                          limits=(0.0, 1e4), limits_reason="a wall takes energy and gives none")
    id: ClassVar[str] = "wall-dashpot"
    law: ClassVar[str] = "F gains b w"
    reference: ClassVar[str] = "Kelvin 1865"

    def force(self, touch: Touch) -> Scalar:
        """Viscous force, b w [N]."""
        return self.b * touch.depression_rate


# 5. How a record is computed.
def observe(law: DropLaw, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
            ) -> Observation:
    r"""Fall and rebound: $m\,dw/dt = m g - F$, $\delta(0) = 0$, $w(0) = \sqrt{2 g h}$; the sensor reads F/m.

    Args:
        law: ball and effects.
        conditions: `drop_height` h [m], `initial_pressure` (absolute) [Pa], and whatever effects read, scalars.
        time: of the samples since first touch, shape (samples,) [s].
        row: further arrays of the record (`row.inputs`) and the tolerance that is asked for; not needed here.
        channels: that are measured: the acceleration alone.
    """
    pressure, mass = conditions["initial_pressure"] - AMBIENT, law.reference.mass

    def force(t, depression, rate):
        return law.force(Touch(t, jnp.maximum(depression, 0.0), rate, pressure, conditions))

    def slope(t, state):
        return jnp.stack([state[1], GRAVITY - force(t, state[0], state[1]) / mass])

    def step(size, now, state):  # of the classical Runge-Kutta method
        a = slope(now, state)
        b = slope(now + 0.5 * size, state + 0.5 * size * a)
        c = slope(now + 0.5 * size, state + 0.5 * size * b)
        d = slope(now + size, state + size * c)
        return state + size / 6.0 * (a + 2.0 * b + 2.0 * c + d)

    def go_on(before, t):  # from one sample to the next
        now, state = before
        size = (t - now) / STEPS
        state, _ = jax.lax.scan(lambda s, k: (step(size, now + k * size, s), None), state, jnp.arange(STEPS))
        return (t, state), state

    start = jnp.zeros(()), jnp.stack([jnp.zeros(()), jnp.sqrt(2.0 * GRAVITY * conditions["drop_height"])])
    _, states = jax.lax.scan(go_on, start, jnp.maximum(time, 0.0))  # what lies before first touch stands still there
    reading = jax.vmap(force)(time, states[:, 0], states[:, 1]) / mass
    return Observation(channels=jnp.stack([reading for _ in channels]), state=jnp.maximum(states[:, 0], 0.0),
                       state_rate=states[:, 1], end=time[-1], failed=~jnp.all(jnp.isfinite(states)))


def lay_spans(time: np.ndarray, values: np.ndarray, strokes: np.ndarray, end: float) -> list[Span]:
    """All of the record is one stretch, over which a force that is missing changes smoothly: 24 splines follow it."""
    return [Span(float(time[0]) - 1e-9, float(time[-1]), 24)]


# 6. What a missing force may depend on, and in which halves it may differ: what `missing` draws.
def see(touch: Touch) -> tuple[Array, Array]:
    """Variables and directions of the state, in the order of `GROUND`."""
    loading = 0.5 * (1.0 + jnp.tanh(touch.depression_rate / TURN))
    return (jnp.stack([touch.depression, touch.depression_rate, touch.time]), jnp.stack([loading, 1.0 - loading]))


FreeDrop, SimpleDrop = make_terms((AbstractDropForce,), "Drop", "N", 1.0, force=act_on(see))
GROUND = Ground(
    variables={"depression": "m", "depression_rate": "m/s", "time": "s"},
    directions=("force loading", "force unloading"), unit="N", shares=(),
    gates={"force": ("force loading", "force unloading")}, splines=FreeDrop, laws=SimpleDrop, base="force of the gas",
)  # fmt: skip


# 7. How its records are kept and imported: columns, what laboratories call them, what has to be known.
KIND = RecordKind(
    name="drop",
    channels=("acceleration",),
    series=("acceleration",),
    main="acceleration",
    independents=("time",),
    conditions=("drop_height", "initial_pressure", "sequence", "temperature"),
    needs=("drop_height", "initial_pressure"),
    pressure="initial_pressure",  # what --pressure means
    words={
        "acceleration": "a az acc acceleration accelerometer",
        "drop_height": "h height dropheight fallheight",
        "initial_pressure": "p0 initialpressure fillpressure",
    },
    unknown=("area_coefficient", "damping"),
    ranges={"drop_height": (0.01, 20.0)},  # a table to a tower: beyond it, the unit is asked about
)

# 8. The object that all commands ask.
DROP = Family(
    name="drop",
    kind=KIND,
    independent="time",
    channels=("acceleration",),
    needs=KIND.needs,
    sizes=(128, 256, 512, 1024, 2048, 4096, 8192),
    models={"membrane": BuiltinModel(
        "an inflated ball whose wall has no stiffness, with damping in proportion to the force.",
        "F = (P0 - Pa) c pi D delta (1 + d w)", "Hunt & Crossley 1975, J. Appl. Mech. 42, 440", DroppedBall)},
    accepts=("drop",),
    catalogue=(WallSpring, Dashpot),
    directions=(),
    state="depression",
    rate="depression_rate",
    phases=("loading", "unloading"),
    observe=observe,
    lay_spans=lay_spans,
    view=View(
        force="acceleration", state="depression", rate="depression_rate", phases=("loading", "unloading"),
        variables=("depression", "depression_rate", "time"), series="drop of the series", apart="loading and unloading",
        free="area coefficient, damping",
    ),
    plan=PlannedTests(
        chosen=("drop_height", "initial_pressure"), added={}, noise={"acceleration": "5 m/s^2"},
        uncertainties={"drop_height": "2 mm", "initial_pressure": "0.5 %", "time": "0.02 ms"}, interval="0.25 ms",
        length="20 ms",
    ),
    ground=GROUND,
    remedies="drop it from other heights and at other pressures",
)  # fmt: skip
