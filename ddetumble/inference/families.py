"""What differs between families of records: channels, conditions, catalogue, and how one record is computed."""

import dataclasses as dc
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import diffrax as dfx
import jax.numpy as jnp
from jaxtyping import Array

from .._errors import InputError
from ..contact.effect import AbstractEffect
from ..dynamics.impact import simulate
from ..dynamics.slide import slide
from ..dynamics.spinning import START, spin
from ..dynamics.strike import strike
from ..effects import IMPACT, OBLIQUE, SLIP, TUMBLE
from ..effects.oblique_probes import OBLIQUE_PROBES
from ..effects.probes import PROBES
from ..effects.slip_probes import SLIP_PROBES
from ..effects.tumble_probes import TUMBLE_PROBES
from ..measurement.campaign import Campaign


class Observation(NamedTuple):
    """One record as the model has it.

    Attributes:
        channels: shape (channels, samples), SI.
        state, state_rate: what a misfit is located in, shape (samples,).
        end: of the contact or record, in the independent variable.
        failed: whether it could not be computed.
    """

    channels: Array
    state: Array
    state_rate: Array
    end: Array
    failed: Array


@dc.dataclass(frozen=True)
class Family:
    """A family of records.

    Attributes:
        name: as campaigns give it; `oblique` for impacts with a tangential speed and force.
        channels: that the models predict, the main one first.
        needs: conditions without which nothing can be computed.
        sizes: to which the number of samples is padded, so that compiled programs are shared.
        accepts: families of the effects that may act on its records.
        catalogue, probes: effects.
        state, rate: names of what a misfit is located in, and of its rate; `phases` of a positive and a negative rate.
        observe: computes one record from a law, its conditions, sample times, its row of the stack, and channels.
        remedies: what else to measure, in words.
        rows: to which the number of records is padded.
        starts: what a record starts from: nuisances without a prior, free in every record.
        slots: to which the number of free parameters is padded.
    """

    name: str
    channels: tuple[str, ...]
    needs: tuple[str, ...]
    sizes: tuple[int, ...]
    accepts: tuple[str, ...]
    catalogue: tuple[type[AbstractEffect], ...]
    probes: tuple[type[AbstractEffect], ...]
    state: str
    rate: str
    phases: tuple[str, str]
    observe: Callable[[Any, Mapping[str, Array], Array, Any, tuple[str, ...]], Observation]
    remedies: str
    rows: tuple[int, ...] = (24, 48, 96, 192, 384, 768)
    starts: tuple[str, ...] = ()
    slots: tuple[int, ...] = (5, 8, 12, 16, 24, 32, 48, 64, 96)

    @property
    def main(self) -> tuple[str, ...]:
        """Channels without which nothing can be fitted: the first, or as many as a record has starts."""
        return self.channels[: max(len(self.starts), 1)]

    @property
    def free_running(self) -> bool:
        """Whether a record runs on from where it starts, so that a wrong model falls out of step with it."""
        return bool(self.starts)


def observe_contact(run: Callable[..., Any], law: Any, conditions: Mapping[str, Array], time: Array, row: Any,
                    channels: tuple[str, ...]) -> Observation:
    """An impact, straight (`simulate`) or oblique (`strike`), in forward mode; the force is read off the motion."""
    found = run(law, conditions, time, span=row.span, adjoint=dfx.ForwardMode(), rtol=row.rtol, atol=0.01 * row.rtol,
                from_motion=True)
    model = jnp.stack([getattr(found, channel) for channel in channels])
    return Observation(model, found.depression, found.depression_rate, found.separation, found.failed)


def observe_slip(law: Any, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
                 ) -> Observation:
    """A slip record over its own slip; `time` is the slip itself where the record has no other path."""
    path, way = row.inputs.get("slip", time), row.inputs.get("direction", jnp.ones_like(time))
    clock = time if "slip" in row.inputs else None
    found = slide(law, conditions, path, way, clock)
    speed = conditions.get("slip_speed", jnp.ones(()))
    return Observation(jnp.stack([found.tangential_force for _ in channels]), path, way * speed, time[-1],
                       found.failed)


def observe_tumble(law: Any, conditions: Mapping[str, Array], time: Array, row: Any, channels: tuple[str, ...]
                   ) -> Observation:
    """A tumbling record on its own mesh: rates as the gyroscopes read them, attitude."""
    found = spin(law, conditions, time, row.inputs["mesh"])
    named = {f"angular_velocity_{a}": found.angular_velocity[:, k] for k, a in enumerate("xyz")}
    named |= {name: found.attitude[:, k % 4] for k, name in enumerate(ATTITUDES)}
    speed = jnp.sqrt(jnp.sum(found.body**2, axis=-1) + 1e-300)
    return Observation(jnp.stack([named[channel] for channel in channels]), time, speed, time[-1], found.failed)


RATES = ("angular_velocity_x", "angular_velocity_y", "angular_velocity_z")
ATTITUDES = ("attitude_w", "attitude_x", "attitude_y", "attitude_z", *(f"attitude_{k}" for k in range(4)))
IMPACT_SIZES = (768, 1536, 2048, 4096, 8192, 16384, 32768)
FAMILIES: dict[str, Family] = {
    "impact": Family(
        "impact", ("normal_force", "depression", "pressure"), ("approach_speed",),
        IMPACT_SIZES, ("impact",), IMPACT, PROBES, "depression", "depression_rate",
        ("loading", "unloading"), partial(observe_contact, simulate),
        "measure at other pressures and speeds, or add the depression and pressure channels"),
    "slip": Family(
        "slip", ("tangential_force",), ("normal_load",), (256, 1024, 4096, 8192, 16384, 32768), ("slip",), SLIP,
        SLIP_PROBES, "slip", "direction", ("forward", "backward"), observe_slip,
        "measure at other loads, pressures and slip speeds"),
    "oblique": Family(
        "oblique", ("normal_force", "tangential_force", "slip", "depression", "pressure"),
        ("approach_speed", "tangential_speed"), (384, *IMPACT_SIZES), ("impact", "slip", "oblique"),
        (*IMPACT, *SLIP, *OBLIQUE),
        (*PROBES, *OBLIQUE_PROBES), "depression", "depression_rate", ("loading", "unloading"),
        partial(observe_contact, strike),
        "measure at other pressures, speeds and angles, or add the slip and depression channels"),
    "tumble": Family(
        "tumble", (*RATES, *ATTITUDES), (), (320, 640, 1024, 1536, 2560, 5120, 10240, 20480), ("tumble",), TUMBLE,
        TUMBLE_PROBES, "time", "angular_speed", ("both", "both"), observe_tumble,
        "measure longer, from other initial rates, or add the attitude", (4, 8, 16, 24, 48, 96, 192, 384), START,
        (4, 8, 16, 32, 48, 64, 96)),
}  # fmt: skip


def name_family(campaign: Campaign) -> str:
    """Family of a campaign's records: impacts that measure a tangential force at a tangential speed are `oblique`."""
    oblique = "tangential_speed" in campaign.records and "tangential_force" in campaign.channels
    return "oblique" if campaign.family == "impact" and oblique else campaign.family


def find_family(name: str, verb: str = "this") -> Family:
    """The family of that name.

    Raises:
        InputError: `verb` cannot read such records yet.
    """
    if name not in FAMILIES:
        raise InputError(f"the campaign is of family {name!r}; {verb} reads {' and '.join(FAMILIES)} so far")
    return FAMILIES[name]
