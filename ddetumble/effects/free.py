r"""The missing force as a flexible term of the equation of motion, and simple laws that may draw it.

Where no catalogued effect removes a misfit, the force itself is asked for. `FreeForce` (impacts), `FreeFriction` (slip
records) and `FreeTorque` (tumbling records) add

$$f = \sum_k c_k\, B((x_k - t_k)/h_k)\, d_k$$

with cubic B-splines $B$ of a variable $x_k$ (depression, rate, time, slip, ...), centres $t_k$ and spacings $h_k$, and
directions $d_k$ (a force, a share of the elastic force or of the friction, loading or unloading only, an axis). Only
the coefficients $c_k$ are parameters. Variables, centres and directions come with the records (`place_terms`), so that
one compiled program serves every variable and every number of knots. `SimpleForce` and its like add up to two laws of
one variable in closed form (`FORMS`), chosen in the same way.

None of them is of the catalogue, and no verdict rests on them: they draw what a user may then write as an effect.
"""

import dataclasses as dc
from collections.abc import Mapping
from functools import partial
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._numerics import safe_power
from ..contact.effect import (
    AbstractEffect,
    AbstractElasticEffect,
    AbstractStiffnessEffect,
    Contact,
    family_of,
    parameter,
)
from ..contact.function_effect import declare_effect
from ..contact.sliding import AbstractFrictionForce, AbstractLoadEffect, Slide
from ..contact.torque import AbstractTorque, Spin


COUNT = 48  # splines that one program holds: the finest term needs 45 and some for its degree
LAWS = 2  # simple laws that one program holds: laws are tried alone and in pairs
HARMONICS = 6  # of a sawtooth: fewer round its edge, more ripple within a sample's spacing
TURN = 0.02  # m/s, rate over which loading turns into unloading: far below approach speeds, yet smooth to integrate
FORMS = ("power", "signed power", "sine", "sawtooth", "decay", "saturation")
PLAN = "free-term"  # prefix of the arrays that come with the records


@final
@dc.dataclass(frozen=True)
class Ground:
    """What a missing force of one family may depend on, and where it may act."""

    variables: Mapping[str, str]  # of the state, in the order in which terms see them, each with its SI unit
    # in which a term may act, each with the SI unit of its coefficient where it is given as itself
    directions: tuple[str, ...]
    unit: str
    shares: tuple[str, ...]  # of these directions, those given as a share of another force
    # pairs of directions that are one direction in two phases, by the direction that both make up
    gates: Mapping[str, tuple[str, ...]]
    splines: type[AbstractEffect]  # the effects that hold flexible terms, and simple laws
    laws: type[AbstractEffect]
    base: str  # what such a share is one of: a force, in words, or the name of the rate of the state
    # of the gates, the directions in which a term may depend on a condition of the records
    conditional: tuple[str, ...] = ()
    reach: float = 1.0  # by which factor terms reach beyond the largest state that the model visits
    note: str = ""  # on how the force acts; empty where there is nothing to say


def evaluate_spline(z: Array) -> Array:
    """Cubic B-spline on even knots at distance `z` from its centre, in spacings, any shape; 2/3 at 0, 0 beyond 2."""
    a = jnp.abs(z)
    near, far = 2.0 / 3.0 - a**2 + 0.5 * a**3, jnp.where(a < 2.0, 2.0 - a, 0.0) ** 3 / 6.0
    return jnp.where(a < 1.0, near, far)


def evaluate_form(form: Array, x: Array, onset: Array, length: Array, power: Array, scale: Array
                  ) -> tuple[Array, Array]:
    r"""Every form of `FORMS` at one place, the one picked by one-hot `form`; and the cosine that belongs to a sine.

    In units of `scale` s: $((x - d)_+/s)^n$; $\mathrm{sign}(x)|x/s|^n$; $\sin 2\pi x/\ell$; the sawtooth
    $2\,\mathrm{frac}(x/\ell) - 1$ by its first harmonics; $e^{-x/\ell}$; $\tanh(x/\ell)$. All are scalars.
    """
    phase = 2.0 * jnp.pi * x / length
    size = safe_power(jnp.abs(x) / scale, power)
    values = [
        safe_power((x - onset) / scale, power), jnp.sign(x) * size, jnp.sin(phase),
        -2.0 / jnp.pi * sum(jnp.sin(k * phase) / k for k in range(1, HARMONICS + 1)),
        jnp.exp(-jnp.clip(x / length, -50.0, 700.0)), jnp.tanh(x / length)]
    return _add(form, values), form[FORMS.index("sine")] * (jnp.cos(phase) - 1.0)


def _add(weights: Array, values: Any) -> Array:
    """Sum of a few weighted terms, written out: compiled for many samples, that is several times faster than a product.
    """
    total = weights[0] * values[0]
    for k in range(1, len(weights)):
        total = total + weights[k] * values[k]
    return total


def evaluate_slope(z: Array) -> Array:
    """Derivative of `evaluate_spline`, same shape."""
    a = jnp.abs(z)
    far = -0.5 * jnp.where(a < 2.0, 2.0 - a, 0.0) ** 2
    return jnp.sign(z) * jnp.where(a < 1.0, 1.5 * a**2 - 2.0 * a, far)


@jax.custom_jvp
def blend_splines(coefficients: Array, variables: Array, which: Array, centre: Array, width: Array, direction: Array,
                  turn: Array) -> Array:
    """How much of each direction all splines together give, shape (directions,).

    The rule of its derivative is written out because it is linear in the coefficients: their many derivatives cost one
    product each with splines that are evaluated once.

    Args:
        coefficients: shape (COUNT,).
        variables: of the state, shape (variables,).
        which: variable of each spline, one-hot, shape (COUNT, variables); none for one over a condition, which does not
            change within a record: its value stands in `direction` already.
        centre, width: shapes (COUNT,).
        direction: shape (COUNT, directions).
        turn: coefficients of the splines by the parameters, shape (COUNT, COUNT): a prior that is the same for all
            parameters is one of smoothness for the splines.
    """
    return ((turn @ coefficients) * _splines(variables, which, centre, width)) @ direction


def _splines(variables: Array, which: Array, centre: Array, width: Array) -> Array:
    spline = evaluate_spline((which @ variables - centre) / width)
    return jnp.where(jnp.sum(which, axis=1) > 0, spline, 1.0)


@blend_splines.defjvp
def _blend_splines_jvp(primals, tangents):
    coefficients, variables, which, centre, width, direction, turn = primals
    by_coefficient, by_variable = tangents[:2]
    own = _splines(variables, which, centre, width)[:, None] * direction
    slope = (turn @ coefficients) * evaluate_slope((which @ variables - centre) / width) / width
    return ((turn @ coefficients) @ own,
            (turn @ by_coefficient) @ own + _add((direction.T @ (slope[:, None] * which)).T, by_variable[:, None]))


def add_splines(coefficients: Array, plan: Mapping[str, Array], variables: Array, directions: Array) -> Array:
    """Sum of all splines, shape of one direction.

    Coefficients (COUNT,), the plan of `place_terms` of one record, variables (variables,), directions (directions,
    ...).
    """
    shares = blend_splines(coefficients, variables,
                           *(plan[f"{PLAN}-{name}"] for name in ("variable", "centre", "width", "direction", "turn")))
    return _add(shares, directions)


def add_laws(effect: Any, plan: Mapping[str, Array], variables: Array, directions: Array) -> Array:
    """Sum of the simple laws, shape of one direction; `plan` as of `add_splines`."""
    total = jnp.zeros_like(directions[0])
    for m in range(LAWS):
        first, second, onset, length, power = (getattr(effect, f"{name}_{m + 1}") for name in "abxln")
        which, form, scale, way = (plan[f"{PLAN}-{name}"][m] for name in
                                   ("law-variable", "law-form", "law-scale", "law-direction"))
        value, other = evaluate_form(form, _add(which, variables), onset * scale, length * scale, power, scale)
        total = total + (first * value + second * other) * _add(way, directions)
    return total


def _halve(variables: list[Array], first: Array, share: bool) -> tuple[Array, Array]:
    """Variables, and directions of two phases: of what is a share of a force, or of what adds to it."""
    two, none = jnp.stack([first, 1.0 - first]), jnp.zeros(2)
    return jnp.stack(variables), jnp.concatenate([none, two] if share else [two, none])


def see_contact(contact: Contact, share: bool) -> tuple[Array, Array]:
    """Variables and directions of an impact, loading and unloading."""
    return _halve([contact.depression, contact.depression_rate, contact.time],
                  0.5 * (1.0 + jnp.tanh(contact.depression_rate / TURN)), share)


def see_slide(slide: Slide, share: bool) -> tuple[Array, Array]:
    """Variables and directions of sliding, forward and backward."""
    return _halve([slide.slip, jnp.broadcast_to(slide.time, slide.slip.shape)], 0.5 * (1.0 + slide.direction), share)


def see_spin(spin: Spin) -> tuple[Array, Array]:
    """Variables and directions of tumbling; the phase is that of the transverse rate about body z."""
    x, y, z = spin.angular_velocity
    speed = jnp.sqrt(x * x + y * y + z * z + 1e-300)
    across = jnp.maximum(x * x + y * y, 1e-300)
    phase = jnp.arctan2(jnp.where(across > 1e-290, y, 0.0), jnp.where(across > 1e-290, x, 1.0))
    zero = jnp.zeros_like(x)
    drags = jnp.stack([jnp.stack([-x, -y, zero]), jnp.stack([zero, zero, -z])])
    return jnp.stack([spin.time, speed, z, phase]), jnp.concatenate([jnp.eye(3), drags])


def act_on(see: Any, null: float = 0.0) -> tuple[Any, Any]:
    """The methods of a spline term and of simple laws, which return `null` where they are absent.

    `see` gives variables (variables,) and directions (directions, ...) of a state, in the order of `Ground`.
    """
    def splines(self, state):
        coefficients = jnp.stack([getattr(self, f"c_{k}") for k in range(COUNT)])
        value = add_splines(coefficients, state.conditions, *see(state))
        return value + null if null else value

    def laws(self, state):
        value = add_laws(self, state.conditions, *see(state))
        return value + null if null else value

    return splines, laws


def make_terms(bases: tuple[type, ...], name: str, unit: str, typical: float, **methods: tuple[Any, Any]
          ) -> tuple[type[AbstractEffect], type[AbstractEffect]]:
    """Flexible term and simple laws of a family; `methods` holds the two functions of each method by its name."""
    coefficients = {f"c_{k}": parameter(unit, 0.0, typical=typical, free=False) for k in range(COUNT)}
    shapes = {}
    for m in range(1, LAWS + 1):
        shapes |= {
            f"a_{m}": parameter(unit, 0.0, typical=typical, free=False),
            f"b_{m}": parameter(unit, 0.0, typical=typical, free=False),
            f"x_{m}": parameter("", 0.0, kind="shape", typical=0.1, bounds=(-10.0, 10.0), free=False),
            f"l_{m}": parameter("", 0.3, kind="shape", typical=0.03, coordinate="log", bounds=(1e-5, 1e3), free=False),
            f"n_{m}": parameter("", 1.0, kind="shape", typical=0.2, coordinate="log", bounds=(0.3, 6.0), free=False)}

    def declare(k: int, kind: str, what: str, numbers: Mapping[str, Any]) -> type[AbstractEffect]:
        law = f"a {name.lower()} as {what}"
        return declare_effect(
            bases, numbers, {method: pair[k] for method, pair in methods.items()}, kind + name, __name__, law,
            id=f"{kind.lower()}-{family_of(bases[0])}", law=law, reference="de Boor 1978, A Practical Guide to Splines")

    return (declare(0, "Free", "a sum of splines", coefficients), declare(1, "Simple", "simple laws", shapes))


# In the stage of the elastic force, so that the damping multiplies it, as it does what a wall or a stop would add.
FreeForce, SimpleForce = make_terms(
    (AbstractElasticEffect, AbstractStiffnessEffect), "Force", "N", 1.0,
    force=act_on(partial(see_contact, share=False)), factor=act_on(partial(see_contact, share=True), 1.0))
FreeFriction, SimpleFriction = make_terms(
    (AbstractFrictionForce, AbstractLoadEffect), "Friction", "N", 0.1,
    force=act_on(partial(see_slide, share=False)), factor=act_on(partial(see_slide, share=True), 1.0))
FreeTorque, SimpleTorque = make_terms((AbstractTorque,), "Torque", "1/s**2", 1e-6, torque=act_on(see_spin))
IMPACT_GROUND = Ground(
    {"depression": "m", "depression_rate": "m/s", "time": "s"},
    ("force loading", "force unloading", "share loading", "share unloading"), "N",
    ("share loading", "share unloading"),
    {"force": ("force loading", "force unloading"), "share": ("share loading", "share unloading")},
    FreeForce, SimpleForce, "elastic force", ("share",), 1.02,
    "The force adds to the elastic force, and the damping multiplies it too.",
)  # fmt: skip
SLIP_GROUND = Ground(
    {"slip": "m", "time": "s"},
    ("force forward", "force backward", "share forward", "share backward"), "N", ("share forward", "share backward"),
    {"force": ("force forward", "force backward"), "share": ("share forward", "share backward")},
    FreeFriction, SimpleFriction, "friction", ("force", "share"), 1.001,
)  # fmt: skip
TUMBLE_GROUND = Ground(
    {"time": "s", "angular_speed": "rad/s", "angular_velocity_z": "rad/s", "phase": "rad"},
    ("x", "y", "z", "drag across", "drag axial"), "1/s**2", ("drag across", "drag axial"),
    {"torque": ("x", "y", "z"), "drag": ("drag across", "drag axial")},
    FreeTorque, SimpleTorque, "angular_speed",
)  # fmt: skip


def blank_plan(ground: Ground, records: int) -> dict[str, np.ndarray]:
    """A plan without terms: the arrays that `add_splines` and `add_laws` read, one row a record."""
    many, ways = len(ground.variables), len(ground.directions)
    shapes = {"variable": (COUNT, many), "centre": (COUNT,), "width": (COUNT,), "direction": (COUNT, ways),
              "turn": (COUNT, COUNT),
              "law-variable": (LAWS, many), "law-form": (LAWS, len(FORMS)), "law-scale": (LAWS,),
              "law-direction": (LAWS, ways)}
    plan = {f"{PLAN}-{name}": np.zeros((records, *shape)) for name, shape in shapes.items()}
    plan[f"{PLAN}-width"][:] = plan[f"{PLAN}-law-scale"][:] = 1.0
    return plan
