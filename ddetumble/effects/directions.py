"""Test directions of the lack-of-fit test: forces that no catalogue lists, each a dependence on one variable.

A direction is an effect whose only purpose is to show in which variable a misfit sits. It is never part of a verdict's
model; where a direction does better than every effect of the catalogue, the missing physics is not in the catalogue.
Each is one row: id, stage, the variable in which its misfit sits, law in one line, and the law as a function of the
stage's state and the parameters. `onset` and `line` name the parameter that is an onset in the family's state, or the
frequency of something periodic; `channel` is where the misfit is looked for, where that is not the main channel.

Amplitudes count in units of what is usual on the bench (a depression of 1 mm, a speed of 0.4 m/s, a contact of 20 ms),
so that one `typical` size, 5 % of the force, serves most of them.
"""

import dataclasses as dc
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from .._numerics import safe_power
from .._rotation import rotate_back
from ..contact.effect import AbstractEffect, parameter
from ..contact.function_effect import declare_function


Directions = tuple[type[AbstractEffect], ...]

# S in which the amplitudes of what grows on tumbling records count: of the order of a record's length, so that they are
# sizes at its end.
SPAN = 1000.0
SHARE = parameter("", typical=0.05, starts=(0.05,))
FORCE = parameter("N", typical=1.0, starts=(0.5,))
WAVE = parameter("", typical=0.02, starts=(0.01,))
TORQUE = parameter("1/s**2", typical=1e-7, starts=(3e-8,))
DRAG = parameter("1/s", typical=1e-6, starts=(1e-6,))
DRIFT = parameter("rad/s", typical=1e-4, starts=(3e-5,))


def _row(id: str, stage: str, variable: str, law: str, text: str, function: Callable[..., Any], **more: Any
         ) -> type[AbstractEffect]:
    """One test direction; `text` says what it is, `more` are its parameters and the attributes named above."""
    parameters = {key: value for key, value in more.items() if isinstance(value, dc.Field)}
    attributes = {key: f"{id}.{value}" if key in ("onset", "line") else value
                  for key, value in more.items() if key not in parameters}
    name = "".join(word.capitalize() for word in id.split("-"))
    return declare_function(function, stage, parameters, name, __name__, text, id=id, law=law, reference="probe",
                            variable=variable, **attributes)


def _depth(high: float) -> Any:
    """An onset [m], up to `high`."""
    return parameter("m", 4e-3, kind="shape", typical=1e-3, coordinate="log", bounds=(1e-5, high))


def _power(value: float, least: float) -> Any:
    """Power with which something sets in, from `least` on."""
    return parameter("", value, kind="shape", typical=0.5, coordinate="log", bounds=(least, 4.0), free=False)


def _frequency(unit: str, value: float, low: float, high: float) -> Any:
    """Frequency of something periodic."""
    return parameter(unit, value, kind="shape", typical=0.1 * value, coordinate="log", bounds=(low, high))


def _over_1_MPa(pressure, s):
    """(p / 1 MPa)^s; 1 without pressure."""
    return jnp.where(pressure > 0, safe_power(pressure / 1e6, s), 1.0)


def _ring(contact, a, b, frequency):
    phase = 2.0 * jnp.pi * frequency * contact.time
    return a * jnp.sin(phase) + b * (jnp.cos(phase) - 1.0)


def _wave(slide, a, b, frequency):
    phase = 2.0 * jnp.pi * frequency * slide.slip
    return 1.0 + a * jnp.sin(phase) + b * (jnp.cos(phase) - 1.0)


IMPACT_DIRECTIONS: Directions = (
    _row("probe-depth", "elastic", "depression", "F_k gains k ((delta - depth)_+ / 1 mm)^power",
         "A stiffening that sets in at a depression.",
         lambda contact, k, depth, power: k * safe_power((contact.depression - depth) / 1e-3, power), onset="depth",
         k=parameter("N", typical=5.0, starts=(5.0,)), depth=_depth(0.05), power=_power(1.5, 0.7)),
    _row("probe-phase", "stiffness", "depression_rate", "F_k times 1 + h tanh(w / 20 mm/s)",
         "A spring that is stiffer while loading than while unloading, or the reverse.",
         lambda contact, h: 1.0 + h * jnp.tanh(contact.depression_rate / 0.02), h=SHARE),
    _row("probe-rate", "stiffness", "depression_rate", "F_k times 1 + h (w / 0.4 m/s)^2",
         "A spring that stiffens with the square of the rate.",
         lambda contact, h: 1.0 + h * (contact.depression_rate / 0.4) ** 2, h=SHARE),
    _row("probe-pressure", "stiffness", "initial_pressure", "F_k times (P0 / 1 MPa)^s",
         "A spring whose stiffness is not proportional to the pressure.",
         lambda contact, s: _over_1_MPa(contact.initial_pressure, s), s=SHARE, requires=("gas",)),
    _row("probe-speed", "stiffness", "approach_speed", "F_k times (v1 / 0.4 m/s)^s",
         "A spring whose stiffness depends on the approach speed.",
         lambda contact, s: jnp.exp(s * jnp.log(contact.approach_speed / 0.4)), s=SHARE),
    _row("probe-time", "stiffness", "time", "F_k times 1 + s t / 20 ms",
         "A spring that changes with the time in contact.",
         lambda contact, s: 1.0 + s * contact.time / 0.02, s=SHARE),
    _row("probe-sequence", "stiffness", "sequence", "F_k times 1 + s (j - 1) / 10",
         "A spring that changes steadily over the series.",
         lambda contact, s: 1.0 + s * (contact.conditions["sequence"] - 1.0) / 10.0, s=SHARE, requires=("sequence",)),
    _row("probe-ringing", "contact", "time", "F_n gains a sin(2 pi f t) + b cos(2 pi f t)",
         "A force that oscillates from first touch on.", _ring, line="frequency",
         a=FORCE, b=FORCE, frequency=_frequency("Hz", 70.0, 5.0, 5e3)),
)

SLIP_DIRECTIONS: Directions = (
    _row("probe-onset", "load", "slip", "mu F_n times 1 + k ((s - depth)_+ / 1 mm)^power",
         "Friction that changes beyond a slip.",
         lambda slide, k, depth, power: 1.0 + k * safe_power((slide.slip - depth) / 1e-3, power), onset="depth",
         k=parameter("", typical=0.02, starts=(0.02,)), depth=_depth(1.0), power=_power(1.0, 0.5)),
    _row("probe-trend", "rubber", "slip", "the Eq. 8 part times 1 + h s / 10 mm",
         "An Eq. 8 part that changes steadily with slip.",
         lambda slide, h: 1.0 + h * slide.slip / 0.01, h=SHARE, requires=("rubber",)),
    _row("probe-pressure", "rubber", "internal_pressure", "the Eq. 8 part times (p / 1 MPa)^s",
         "An Eq. 8 part with another dependence on the pressure.",
         lambda slide, s: _over_1_MPa(slide.internal_pressure, s), s=SHARE, requires=("rubber", "internal_pressure")),
    _row("probe-speed", "load", "slip_speed", "mu F_n times (u / 0.1 m/s)^s",
         "Friction that depends on the speed by a power.",
         lambda slide, s: jnp.where(slide.slip_speed > 0, safe_power(slide.slip_speed / 0.1, s), 1.0),
         requires=("slip_speed",), s=SHARE),
    _row("probe-direction", "load", "direction", "mu F_n times 1 - h while the stroke is reversed",
         "Friction that is larger one way than the other.",
         lambda slide, h: 1.0 + h * 0.5 * (slide.direction - jnp.abs(slide.direction)), h=SHARE),
    _row("probe-sequence", "load", "sequence", "mu F_n times 1 + s (j - 1) / 10",
         "Friction that changes steadily over the series.",
         lambda slide, s: 1.0 + s * (slide.conditions["sequence"] - 1.0) / 10.0, s=SHARE, requires=("sequence",)),
    _row("probe-wave", "load", "slip", "mu F_n times 1 + a sin(2 pi k s) + b (cos(2 pi k s) - 1)",
         "Friction that repeats along the slip.", _wave, line="frequency",
         a=WAVE, b=WAVE, frequency=_frequency("1/m", 500.0, 1.0, 1e6)),
)


def _friction(id: str, variable: str, x: str, text: str, measure: Callable[[Any], Any], **more: Any
              ) -> type[AbstractEffect]:
    """Friction times 1 + h x, with x = `measure(slide)` a variable of the slide in units of what is usual for it."""
    return _row(id, "load", variable, f"mu F_n times 1 + h {x}", text,
                lambda slide, h: 1.0 + h * measure(slide), channel="tangential_force", h=SHARE, **more)


OBLIQUE_DIRECTIONS: Directions = (
    _friction("probe-friction-slip", "slip", "s / 10 mm", "Friction that changes steadily with the distance slid.",
              lambda slide: slide.slip / 0.01),
    _friction("probe-friction-load", "normal_force", "F_n / 50 N", "Friction that is not proportional to the load.",
              lambda slide: slide.normal_load / 50.0),
    _row("probe-friction-pressure", "load", "initial_pressure", "mu F_n times (p / 1 MPa)^s",
         "Friction with another dependence on the pressure.",
         lambda slide, s: _over_1_MPa(slide.internal_pressure, s), s=SHARE, requires=("gas",),
         channel="tangential_force"),
    _friction("probe-friction-speed", "slip_speed", "u / 0.2 m/s", "Friction that depends on the slip speed.",
              lambda slide: slide.slip_speed / 0.2),
    _friction("probe-friction-time", "time", "t / 20 ms", "Friction that changes with the time in contact.",
              lambda slide: slide.time / 0.02),
    _friction("probe-friction-sequence", "sequence", "(j - 1) / 10", "Friction that changes steadily over the series.",
              lambda slide: (slide.conditions["sequence"] - 1.0) / 10.0, requires=("sequence",)),
    _row("probe-friction-constant", "friction", "normal_force", "f gains a constant", "Friction without load.",
         lambda slide, f: f * jnp.ones_like(slide.normal_load), channel="tangential_force",
         f=parameter("N", typical=0.3, starts=(0.2,))),
    _row("probe-rolling", "reaction", "time", "a moment proportional to the normal force against rolling",
         "A moment against rolling that the offset of the normal force by its contact radius does not make.",
         lambda patch, share: share * 0.005 * jnp.ones_like(patch.normal_force), channel="tangential_force",
         share=parameter("", typical=0.1, starts=(0.1,))),
)


def _repeat(spin, x, y, z, u, v, w, frequency):
    phase = 2.0 * jnp.pi * frequency * spin.time
    return jnp.stack([x, y, z]) * jnp.sin(phase) + jnp.stack([u, v, w]) * jnp.cos(phase)


def _tilt(rate, time, angle):
    x, y, z = rate[..., 0], rate[..., 1], rate[..., 2]
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([x, c * y + s * z, c * z - s * y], axis=-1)


TUMBLE_DIRECTIONS: Directions = (
    _row("probe-drag", "torque", "angular_speed", "torque -k |omega| omega",
         "A drag that grows with the square of the speed.",
         lambda spin, k: -k * jnp.sqrt(jnp.sum(spin.angular_velocity**2) + 1e-300) * spin.angular_velocity,
         k=parameter("", typical=1e-5, starts=(1e-5,))),
    _row("probe-axial", "torque", "angular_velocity_z", "torque -k omega_z about body z",
         "A drag on the axial rate alone.",
         lambda spin, k: -k * spin.angular_velocity * jnp.array([0.0, 0.0, 1.0]), k=DRAG),
    _row("probe-growth", "torque", "time", "torque (x, y, z) t / 1000 s",
         "A torque in the body frame that grows with time.",
         lambda spin, x, y, z: jnp.stack([x, y, z]) * spin.time / SPAN, x=TORQUE, y=TORQUE, z=TORQUE),
    _row("probe-fade", "torque", "time", "torque -k omega t / 1000 s", "A drag that changes with time.",
         lambda spin, k: -k * spin.angular_velocity * spin.time / SPAN, k=DRAG),
    _row("probe-inertial", "torque", "attitude", "torque (x, y, z) in the inertial frame",
         "A torque that is constant in the inertial frame.",
         lambda spin, x, y, z: rotate_back(spin.attitude, jnp.stack([x, y, z])), x=TORQUE, y=TORQUE, z=TORQUE),
    _row("probe-wave", "torque", "time", "torque (x, y, z) sin(2 pi f t) + (u, v, w) cos(2 pi f t)",
         "A torque in the body frame that repeats in time.", _repeat, line="frequency",
         **dict.fromkeys("xyzuvw", TORQUE), frequency=_frequency("Hz", 0.01, 1e-6, 1e3)),
    _row("probe-drift", "gyroscope", "time", "measured rates gain (x, y, z) t / 1000 s",
         "Gyroscopes whose bias drifts.",
         lambda rate, time, x, y, z: rate + jnp.stack([x, y, z]) * time[:, None] / SPAN, order=4,
         x=DRIFT, y=DRIFT, z=DRIFT),
    _row("probe-tilt", "gyroscope", "angular_velocity_y", "components in a frame turned by angle about body x",
         "Gyroscopes turned about body x, which axis-misalignment does not hold.", _tilt, order=0,
         angle=parameter("rad", typical=0.01, starts=(0.003,), bounds=(-1.5, 1.5))),
)
