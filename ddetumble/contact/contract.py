"""The contract of an effect, proved by trial: absent at its null, alive in its amplitudes, compiled = eager.

    print(check_effect(WallStiffness))
    check_effect(MyEffect).require()

The motion of a trial is prescribed, and its steps are even: quick to compile, for checks of a law that need no
accuracy.
"""

import dataclasses as dc
import functools
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from .effect import AbstractEffect, AbstractModel, family_of, list_stages, parameters_of
from .gripping import Patch, StrikeLaw, Striker, find_height
from .law import Ball, ContactLaw
from .signal import Signal
from .sliding import CoulombFriction, FrictionLaw, RubberFriction, Slide
from .torque import RigidBody, Spin, TumbleLaw


# Compiled against eager, batch against loop, relative to the largest value: rounding, in another order of sums.
TOLERANCE = 1e-10
MOST = 12  # combinations of starts that are tried: more find nothing new, and each integrates an impact
STEPS = 128  # of a trial impact, even: coarse, as the checks compare like with like
# Smallest change of a reading by a typical change of a parameter, relative to the largest reading: above rounding,
# below any gauge.
ALIVE = 1e-9
_MODELS = ("gas", "geometry", "damping", "rubber")  # what only a reference model can provide

Readings = dict[str, Array]
Found = str | tuple[bool, str]  # what is wrong, or whether a clause holds and what was found


@final
@dc.dataclass(frozen=True)
class Check:
    """One clause of the contract: its name, whether it holds, and what was found (or, broken, what to do)."""

    name: str
    ok: bool
    sentence: str


@final
@dc.dataclass(frozen=True)
class EffectReport:
    """What `check_effect` found: id of the effect (or name of its class), and all clauses in the order of trial."""

    effect: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every clause holds."""
        return not self.failures

    @property
    def failures(self) -> tuple[Check, ...]:
        """The clauses that do not hold."""
        return tuple(check for check in self.checks if not check.ok)

    def require(self) -> "EffectReport":
        """Raise `InputError` with every broken clause, or return the report itself."""
        if not self.ok:
            broken = "; ".join(f"{check.name}: {check.sentence}" for check in self.failures)
            raise InputError(f"effect {self.effect} breaks its contract: {broken}")
        return self

    def __str__(self) -> str:
        width = max(len(check.name) for check in self.checks)
        lines = [f"{'ok    ' if c.ok else 'BROKEN'}  {c.name:<{width}}  {c.sentence}" for c in self.checks]
        verdict = "keeps its contract" if self.ok else f"breaks its contract (checks failed: {len(self.failures)})"
        return "\n".join([f"{self.effect} {verdict}", *lines])


# ---- trials, one a family: readings of one record from law and conditions ------------------------------------------


def read_impact(law: ContactLaw, conditions: Mapping[str, Array]) -> Readings:
    """Forces [N], pressure [Pa] and the gauge's reading [N] in an impact along half a sine; states by Heun's method.

    The sine is as deep as the reference model's elastic force alone lets the ball come.
    """
    bare, depths = law.reference.extend(()), jnp.geomspace(1e-6, 1.0, 256)
    force = jax.vmap(lambda depth: bare.press(conditions, law.reference.diameter(), depth).elastic_force)(depths)
    work = jnp.cumsum(0.5 * (force[1:] + force[:-1]) * jnp.diff(depths))
    speed = conditions["approach_speed"]
    deepest = jnp.interp(0.5 * law.reference.inertia() * speed**2, work, depths[1:])
    phase = jnp.linspace(0.0, jnp.pi, STEPS + 1)
    course = deepest / speed * phase, deepest * jnp.sin(phase), speed * jnp.cos(phase)
    step = course[0][1]
    diameter, damping = law.start(conditions)

    def change(states, place):
        time, depression, rate = place
        return law.rates(law.contact(conditions, diameter, time, depression, rate, states), states)

    def advance(states, places):
        here, there = places
        first = change(states, here)
        return states + 0.5 * step * (first + change(states + step * first, there)), states

    ends = tuple(x[:-1] for x in course), tuple(x[1:] for x in course)
    last, states = jax.lax.scan(advance, law.begin_states(), ends)

    def push(states, time, depression, rate):
        contact = law.contact(conditions, diameter, time, depression, rate, states)
        return law.forces(contact, damping, states), contact.pressure

    found, pressure = jax.vmap(push)(jnp.concatenate([states, last[None]]), *course)
    reading = found.normal
    if law.has_sensor():  # a parabola for every two steps
        gauge = law.reading(Signal(jnp.full((STEPS // 2,), 2.0 * step), reading[:-1:2], reading[1::2], reading[2::2]))
        reading = jnp.concatenate([gauge.start[:1], jnp.stack([gauge.middle, gauge.end], axis=1).reshape(-1)])
    return {"force": found.normal - found.drive, "pressure": pressure, "reading": reading}


def read_stroke(law: FrictionLaw, conditions: Mapping[str, Array]) -> Readings:
    """Force of a forward and a backward stroke [N]; the work is what 5 N would have done."""
    nothing = jnp.zeros(())
    speed, pressure = conditions.get("slip_speed", nothing), conditions.get("internal_pressure", nothing)

    def force(slip, direction):
        return law.force(Slide(slip, speed, conditions["normal_load"], pressure, 5.0 * slip, slip / 0.1, direction,
                               conditions))

    slips = jnp.linspace(0.0, 0.012, 49)
    return {"reading": jnp.concatenate([jax.vmap(force, (0, None))(slips, jnp.asarray(way)) for way in (1.0, -1.0)])}


def read_patch(law: StrikeLaw, conditions: Mapping[str, Array]) -> Readings:
    """How far a patch gives way before it slides [m], and what the gauge reads of load and friction less what brakes
    rolling [N].

    Under half a sine of load (60 N, 30 ms) and of depression (5 mm), while the speed falls and 2 J/m of work add up.
    """
    diameter = law.reference.ball.diameter()
    pressure = conditions.get("initial_pressure", jnp.zeros(()))

    def read(share):
        wave, speed, path = jnp.sin(jnp.pi * share), conditions["tangential_speed"] * (1.0 - share), 0.01 * share
        patch = Patch(0.03 * share, 0.005 * wave, 0.004 * wave, find_height(diameter, 0.005 * wave), pressure,
                      60.0 * wave, conditions)
        limit = law.limit(patch, speed, path, 2.0 * path)
        normal, tangential = law.read_axes(patch.normal_force, limit - law.brake(patch))
        return {"slip": path + law.compliance(patch) * limit, "load": normal, "friction": tangential}

    return jax.vmap(read)(jnp.linspace(0.0, 1.0, 25))


def read_turning(law: TumbleLaw, conditions: Mapping[str, Array]) -> Readings:
    """Rates as the gyroscopes read them along a prescribed motion [rad/s], and angular accelerations times 100 s."""
    start, moments = jnp.stack([conditions[axis] for axis in "xyz"]), law.moments()
    times = jnp.linspace(0.0, 500.0, 25)

    def push(time):
        turn = 0.03 * time
        across = jnp.stack([jnp.cos(turn) * start[0] - jnp.sin(turn) * start[1],
                            jnp.sin(turn) * start[0] + jnp.cos(turn) * start[1], start[2]])
        attitude = jnp.stack([jnp.cos(turn), 0.0 * turn, jnp.sin(turn), 0.0 * turn])
        up = jnp.stack([jnp.cos(turn), jnp.sin(turn) * 0.6, jnp.sin(turn) * 0.8])
        seen = Spin(time, across, attitude, up, moments, law.reference.orbit_rate, conditions, jnp.zeros(3))
        inner = 0.9 * law.start(start)
        # An inner body is seen after it has been pushed: only through it does the body feel the inner inertia.
        inner = inner + 100.0 * law.accelerate(seen, inner)[1]
        return across, 100.0 * law.accelerate(seen, inner)[0]

    rates, changes = jax.vmap(push)(times)
    return {"reading": jnp.concatenate([law.read(rates, times), changes])}


class Rig(NamedTuple):
    """How effects of one family are tried, where no model and no conditions are given."""

    usual: Callable[[], AbstractModel]  # reference model
    conditions: Mapping[str, Sequence[float]]  # of three records, SI
    read: Callable[[Any, Mapping[str, Array]], Readings]


_SERIES = {"sequence": (1.0, 4.0, 9.0)}
_STRIKE = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34), **_SERIES}
RIGS = {
    Striker.family: Rig(lambda: Striker(Ball(), CoulombFriction()),
                        {**_STRIKE, "tangential_speed": (0.1, 0.3, 0.6)}, read_patch),
    Ball.family: Rig(Ball, _STRIKE, read_impact),
    RubberFriction.family: Rig(
        RubberFriction, {"normal_load": (6.0, 14.0, 27.0), "internal_pressure": (0.6e6, 1.1e6, 2.3e6),
                         "slip_speed": (0.02, 0.1, 0.4), **_SERIES}, read_stroke),
    RigidBody.family: Rig(
        RigidBody, {"x": (0.05, 0.02, -0.07), "y": (0.03, -0.06, 0.04), "z": (0.08, 0.05, -0.09), **_SERIES},
        read_turning),
}  # fmt: skip


@final
class Bench:
    """An effect on its rig, with a reference model and the records on which it is tried; arguments as `check_effect`.
    """

    def __init__(self, kind: Any, reference: AbstractModel | None, conditions: Mapping[str, Sequence[float]] | None):
        if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
            raise TypeError("an effect is a class derived from one of the stages in ddetumble.contact.effect.")
        if family_of(kind) not in RIGS:
            raise TypeError(f"there are trial records of {', '.join(RIGS)}, and none of {family_of(kind)}: compare "
                            "what your law gives at the effect's null with what it gives without the effect.")
        rig = RIGS[family_of(kind)]
        self.kind, self.parameters, self.read = kind, parameters_of(kind), rig.read
        kind()  # pyright: ignore[reportCallIssue]  # raises where a method or a default is missing
        reference = rig.usual() if reference is None else reference
        self.provides = set(reference.provides)
        if isinstance(reference, RigidBody):  # put in orbit where it is in none
            self.provides |= {"orbit_rate"}
            if not float(reference.orbit_rate):
                reference = dc.replace(reference, orbit_rate=jnp.asarray(1e-3))
        self.reference, self.bare = reference, reference.extend(())
        if conditions is None:
            provided = {*_MODELS, *self.provides, *rig.conditions}
            conditions = {**rig.conditions, **{x: (1.0, 2.0, 3.0) for x in kind.requires if x not in provided}}
        self.conditions = {key: jnp.asarray(value, dtype=float) for key, value in conditions.items()}
        self.records = [{name: value[k] for name, value in self.conditions.items()}
                        for k in range(len(next(iter(self.conditions.values()))))]
        self.null = np.array([p.default for p in self.parameters])
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        self.starts = [np.array(values) for values in itertools.islice(itertools.product(*several), MOST)]
        self.traces = 0
        self._seen: dict[tuple[float, ...], tuple[Readings, Readings]] = {}

        @eqx.filter_jit
        def run(law, record):
            self.traces += 1
            return self.read(law, record)

        @eqx.filter_jit
        def run_slopes(values):
            found, push = jax.linearize(lambda v: self.run_batch(self.build(v)), values)
            return found, jax.vmap(push)(jnp.eye(len(self.parameters)))

        self._run, self._run_slopes = run, run_slopes

    def build(self, values: Any) -> Any:
        """The law with the effect at these field values."""
        return self.reference.extend((self.kind(**{p.field: values[k] for k, p in enumerate(self.parameters)}),))

    def run_batch(self, law: Any) -> Readings:
        """Readings of all records under a law."""
        return jax.vmap(self.read, in_axes=(None, 0))(law, self.conditions)

    def run_one(self, values: Any, k: int) -> Readings:
        """Readings of one record, compiled; `traces` counts how often."""
        return self._run(self.build(values), self.records[k])

    def run_all(self, values: Any) -> tuple[Readings, Readings]:
        """Readings of all records and their derivatives by the parameters, once for all clauses."""
        key = tuple(float(v) for v in values)
        if key not in self._seen:
            self._seen[key] = self._run_slopes(jnp.asarray(key))
        return self._seen[key]


# ---- the clauses ---------------------------------------------------------------------------------------------------


def _find_gap(bench: Bench) -> Found:
    """It has one stage, an id, a law, a reference, and all that it requires of model and records."""
    kind = bench.kind
    stages = list_stages(kind)
    if len(stages) != 1:
        return f"it has {len(stages)} stages ({', '.join(stages) or 'none'}); derive it from exactly one."
    for field in ("id", "law", "reference"):
        if not str(getattr(kind, field, "")).strip():
            return f"`{field}` is empty."
    for need in kind.requires:
        if need not in {*bench.provides, *bench.conditions}:
            return f"it requires {need!r}, which {type(bench.reference).__name__} and the conditions do not provide."
    return True, f"acts on {stages[0]}; {kind.law} ({kind.reference})."


def _check_units(bench: Bench) -> Found:
    """Every number is a declared parameter whose unit `pint` reads; a power may be another parameter (`N/m^q`)."""
    declared = {p.field for p in bench.parameters}
    for field in dc.fields(bench.kind):
        if field.name not in declared and not field.metadata.get("static"):
            return f"`{field.name}` has no unit: declare it by `parameter(unit, ...)` or `eqx.field(static=True)`."
    if not bench.parameters:
        return "it has no parameter: declare its amplitude by `parameter(unit, ...)`."
    for one in bench.parameters:
        if not isinstance(one.unit, str):
            return f"the unit of {one.name} is missing: give it as text, '' for a pure number."
        text = one.unit
        for other in bench.parameters:
            text = re.sub(rf"(\^|\*\*){re.escape(other.name)}\b", rf"\g<1>({other.default!r})", text)
        try:
            _make_registry().parse_units(text)
        except Exception:  # pint raises many kinds
            return f"pint cannot read the unit {one.unit!r} of {one.name}; write it like N/m, N*s/m or 1/s."
    return True, ", ".join(f"{p.name} [{p.unit or '1'}]" for p in bench.parameters) + "."


@functools.cache
def _make_registry():
    import pint

    return pint.UnitRegistry()


def _check_limits(bench: Bench) -> Found:
    """Limits, where stated, have a reason and hold the null and all starts."""
    stated = []
    for one in bench.parameters:
        low, high = one.limits
        if not low < high:
            return f"the limits of {one.name} begin at {low:g} and end at {high:g}: give the lower first."
        if (low, high) == (-np.inf, np.inf):
            continue
        if not one.limits_reason.strip():
            return f"the limits of {one.name} have no reason: give it in `limits_reason`."
        for value in map(one.transform.publish, (one.default, *one.starts)):
            if not low <= value <= high:
                return f"the limits of {one.name} exclude {value:g}, its null or a start of its fits."
        stated.append(f"{one.name} {low:g} to {high:g}")
    return True, (", ".join(stated) or "no limits are stated") + "."


def _check_flattening(bench: Bench) -> Found:
    """Its leaves are its parameters, and a round trip keeps them."""
    effect = bench.kind(**{p.field: v for p, v in zip(bench.parameters, bench.starts[0], strict=True)})
    leaves, structure = jax.tree.flatten(effect)
    if len(leaves) != len(bench.parameters):
        return f"it has {len(leaves)} leaves but {len(bench.parameters)} parameters."
    jax.tree.unflatten(structure, [object()] * len(leaves))  # JAX does this too
    same = bool(eqx.tree_equal(effect, jax.tree.unflatten(structure, leaves)))
    return same, "it survives flattening and unflattening." if same else "flattening and unflattening change it."


def _compare_eager(bench: Bench) -> Found:
    """Compiled readings are those of the law evaluated operation by operation."""
    k = 1 % len(bench.records)
    eager = bench.read(bench.build([float(v) for v in bench.starts[0]]), bench.records[k])
    return _compare(eager, bench.run_one(bench.starts[0], k))


def _count_traces(bench: Bench) -> Found:
    """New values, Python numbers among them, meet the program that is there."""
    bench.run_one(bench.null, 0)
    before = bench.traces
    bench.run_one([int(v) if float(v).is_integer() else float(v) for v in bench.null], 0)
    bench.run_one(bench.starts[-1], -1)
    if bench.traces > before:
        return "a new value recompiles the program; declare the field by `parameter(...)`, which makes it an array."
    return True, "new values reuse the compiled program."


def _find_infinite(bench: Bench) -> Found:
    """Readings and derivatives are finite at every start."""
    for values in bench.starts:
        where = dict(zip([p.name for p in bench.parameters], values.tolist(), strict=True))
        for what, found in zip(("reading", "derivative"), bench.run_all(values), strict=True):
            if not all(np.isfinite(value).all() for value in found.values()):
                return f"a {what} is not finite at {where}."
    return True, f"readings and derivatives are finite at {len(bench.starts)} starts."


def _compare_loop(bench: Bench) -> Found:
    """All records at once give what one after the other gives."""
    loop = [bench.run_one(bench.starts[0], k) for k in range(len(bench.records))]
    batch = bench.run_all(bench.starts[0])[0]
    return _compare({name: np.stack([one[name] for one in loop]) for name in batch}, batch)


def _compare_null(bench: Bench) -> Found:
    """At its null, whatever its shapes, readings are to the last bit those without it."""
    shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in bench.parameters]
    nulls = list(itertools.islice(itertools.product(*shapes), MOST))
    for record in bench.records:
        bare = bench.read(bench.bare, record)
        for values in nulls:
            extended = bench.read(bench.build(values), record)
            for name in bare:
                if not np.array_equal(extended[name], bare[name]):
                    where = ", ".join(f"{p.name} = {v:g}" for p, v in zip(bench.parameters, values, strict=True))
                    change = np.abs(extended[name] - bare[name]).max()
                    return f"the {name} changes by up to {change:.3g} [SI] at {where}."
    return True, "every reading equals that without the effect, to the last bit."


def _find_slope(bench: Bench, k: int) -> Found:
    """An amplitude moves a reading at its null; a shape, or one that is singular there, over its starts."""
    one = bench.parameters[k]
    scanned = one.kind == "shape" or one.transform.reciprocal or one.singular
    points = bench.starts if scanned else [bench.null]
    if one.kind == "shape":
        points = [np.where(np.arange(len(bench.parameters)) == k, v, p)
                  for p in bench.starts for v in (one.starts or (one.default,))]
    bare, best = bench.run_batch(bench.bare), 0.0
    for values in points:
        for name, slopes in bench.run_all(values)[1].items():
            slope, largest = np.asarray(slopes[k]), float(np.abs(bare[name]).max())
            if not np.isfinite(slope).all():
                return f"the derivative of the {name} is not finite{'' if scanned else ' at the null'}."
            best = max(best, float(np.abs(slope).max() * one.typical / max(largest, 1e-300)))
    place = "over its starts" if scanned else "at its null"
    if best <= ALIVE:
        remedy = "let the law use it" if scanned else "let the law start linearly in its amplitude"
        return f"no reading depends on it {place}: {remedy}."
    change = f"{one.typical:g} {one.unit}".rstrip()
    return True, f"a typical change ({change}) changes a reading by {best:.1e} of its largest value {place}."


def _compare(one: Mapping[str, Any], other: Mapping[str, Any]) -> Found:
    """Whether readings differ by rounding alone."""
    worst = np.max([np.abs(np.asarray(one[name]) - value).max() / max(float(np.abs(value).max()), 1e-300)
                    for name, value in other.items()])
    worst = worst if np.isfinite(worst) else np.inf
    return bool(worst <= TOLERANCE), f"they differ by {worst:.1e} of the largest value."


CLAUSES: dict[str, Callable[[Bench], Found]] = {
    "complete": _find_gap, "units": _check_units, "limits": _check_limits, "flattens": _check_flattening,
    "compiled = eager": _compare_eager, "compiles once": _count_traces, "finite at its starts": _find_infinite,
    "batch = loop": _compare_loop, "absent at its null": _compare_null,
}  # after these a clause `... alive` for every parameter


def check_effect(
    effect_class: type[AbstractEffect], reference: AbstractModel | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
) -> EffectReport:
    """Check by trial impacts, strokes or tumbling that an effect keeps the contract on which fits and discovery rely.

    The clauses are those of `CLAUSES`, and that every amplitude moves the readings at its null, every shape parameter
    (and every parameter whose null is singular: `coordinate="inverse"`, `singular=True`) somewhere over its starts.

    Args:
        effect_class: the class, with defaults for all parameters.
        reference: the reference model that it extends; by default the paper's ball, or its friction, or a rigid body
            (in an orbit of 1e-3 rad/s where it is in none).
        conditions: conditions of a few records by name, SI, each shape (records,); by default three records that
            differ in pressure, speed (load) and place in a series, and in every further condition that the effect
            requires. Of tumbling they hold the rates at t = 0 as `x`, `y` and `z` [rad/s].

    Returns:
        An `EffectReport`; nothing is raised (see `EffectReport.require`).
    """
    name = str(getattr(effect_class, "id", "") or getattr(effect_class, "__name__", effect_class))
    try:
        bench = Bench(effect_class, reference, conditions)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, _explain(error)),))
    clauses = CLAUSES | {f"{p.name} alive": functools.partial(_find_slope, k=k) for k, p in enumerate(bench.parameters)}
    checks = []
    for title, clause in clauses.items():
        try:
            found = clause(bench)
        except Exception as error:  # whatever a law raises breaks the clause
            found = _explain(error)
        checks.append(Check(title, *(found if isinstance(found, tuple) else (False, found))))
    return EffectReport(name, tuple(checks))


def _explain(error: Exception) -> str:
    """One line about an exception, with the remedy for the commonest two."""
    text = (str(error).strip().splitlines() or [""])[0]
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return "Python's `if` or `and` is used on a traced value, unknown at compilation; write `jnp.where(...)`."
    if isinstance(error, KeyError):
        return f"it reads {text}, which no record has; name the condition in `requires`."
    return f"{type(error).__name__}: {text}"
