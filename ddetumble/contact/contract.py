"""The contract of an effect, proved by trial: absent at its null, alive in its amplitudes, compiled = eager.

    print(check_effect(WallStiffness))
    check_effect(MyEffect).require()

Trials are short and in fixed steps: quick to compile, for checks of a law that need no accuracy.
"""

import dataclasses as dc
import functools
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import InputError
from .effect import STAGE_OF, AbstractEffect, AbstractModel, Parameter, family_of, parameters_of
from .gripping import Patch, StrikeLaw, Striker, find_height, share_friction, solve_slider
from .law import Ball, ContactLaw
from .signal import Signal
from .sliding import CoulombFriction, FrictionLaw, RubberFriction, Slide
from .torque import RigidBody, Spin, TumbleLaw


TOLERANCE = 1e-10  # compiled against eager, batch against loop, relative to the largest value
MOST = 12  # combinations of starts that are tried
IMPACT_STEPS = 192  # of a trial impact, even
PATCH_STEPS = 48
_ALIVE = 1e-9  # smallest change of a reading by a typical change of a parameter, relative to the largest reading
_MODELS = ("gas", "geometry", "damping", "rubber")  # what only a reference model can provide

Readings = dict[str, Array]
Found = str | tuple[bool, str]  # what is wrong, or whether a clause holds and what was found


# ---- the report ----------------------------------------------------------------------------------------------------


@dc.dataclass(frozen=True)
class Check:
    """One clause of the contract.

    Attributes:
        name: what was checked.
        ok: whether it holds.
        sentence: what was found and, where it does not hold, what to do.
    """

    name: str
    ok: bool
    sentence: str


@dc.dataclass(frozen=True)
class EffectReport:
    """What `check_effect` found.

    Attributes:
        effect: id of the effect, or the name of its class.
        checks: all clauses, in the order in which they were tried.
    """

    effect: str
    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """Whether every clause holds."""
        return all(check.ok for check in self.checks)

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
        verdict = "keeps its contract" if self.ok else f"breaks its contract in {len(self.failures)} clauses"
        return "\n".join([f"{self.effect} {verdict}", *lines])


# ---- trials, one a family ------------------------------------------------------------------------------------------


class Path(eqx.Module):
    """How the ball moved in a trial impact: time [s], depression [m], rate [m/s], states, each (nodes, ...)."""

    time: Float[Array, " nodes"]
    depression: Float[Array, " nodes"]
    rate: Float[Array, " nodes"]
    states: Float[Array, "nodes states"]
    touching: Array  # at the end


def follow_impact(law: ContactLaw, conditions: Mapping[str, Array], span: Array) -> tuple[Readings, Path]:
    """One impact by Heun's method in `IMPACT_STEPS` equal steps: what `read_impact` gives, and the path."""
    diameter, damping = law.start(conditions)
    step = span / IMPACT_STEPS

    def field(time, y):
        contact = law.contact(conditions, diameter, time, y[0], y[1], y[2:])
        forces = law.forces(contact, damping, y[2:])
        push = jnp.stack([y[1], (forces.drive - forces.normal) / law.reference.inertia()])
        return jnp.concatenate([push, law.rates(contact, y[2:])]), forces

    def advance(carry, time):
        y, touching = carry
        first, forces = field(time, y)
        second, _ = field(time + step, y + step * first)
        after = y + 0.5 * step * (first + second)
        left = touching & (after[0] > 0.0)
        return (jnp.where(left, after, y.at[:2].set(0.0)), left), (y, forces)

    effects = [jnp.asarray(effect.initial()) for effect in law.stateful()]
    start = jnp.stack([jnp.zeros(()), conditions["approach_speed"], *effects])
    time = step * jnp.arange(IMPACT_STEPS + 1)
    (_, touching), (y, forces) = jax.lax.scan(advance, (start, jnp.asarray(True)), time)
    path = Path(time, y[:, 0], y[:, 1], y[:, 2:], touching)
    return _gauge_impact(law, forces, path), path


def read_impact(law: ContactLaw, conditions: Mapping[str, Array], path: Path) -> Readings:
    """Forces [N], pressure [Pa] and the gauge's reading [N] along a path, the states being those of the law's effects.
    """
    diameter, damping = law.start(conditions)

    def at(time, depression, rate, states):
        contact = law.contact(conditions, diameter, time, depression, rate, states)
        return law.forces(contact, damping, states)

    states = path.states[:, : len(law.stateful())]
    return _gauge_impact(law, jax.vmap(at)(path.time, path.depression, path.rate, states), path)


def _gauge_impact(law: ContactLaw, forces: Any, path: Path) -> Readings:
    """Readings of an impact: the gauge sees the force in contact, a parabola for every two steps."""
    read = {"force": forces.normal, "drive": forces.drive, "pressure": forces.pressure, "depression": path.depression}
    force = jnp.where((path.depression > 0.0) | (path.time == 0.0), forces.normal, 0.0)
    if not law.has_sensor():
        return read | {"reading": force}
    widths = jnp.full(((len(force) - 1) // 2,), 2.0) * path.time[1]
    reading = law.reading(Signal(widths, force[:-1:2], force[1::2], force[2::2]))
    inner = jnp.stack([reading.middle, reading.end], axis=1).reshape(-1)
    return read | {"reading": jnp.concatenate([reading.start[:1], inner])}


def read_stroke(law: FrictionLaw, conditions: Mapping[str, Array], _: None) -> Readings:
    """Force of a forward and a backward stroke [N]; the work is what 5 N would have done."""
    nothing = jnp.zeros(())
    speed, pressure = conditions.get("slip_speed", nothing), conditions.get("internal_pressure", nothing)

    def force(slip, direction):
        return law.force(Slide(slip, speed, conditions["normal_load"], pressure, 5.0 * slip, slip / 0.1, direction,
                               conditions))

    slips = jnp.linspace(0.0, 0.012, 49)
    return {"reading": jnp.concatenate([jax.vmap(force, (0, None))(slips, jnp.asarray(way)) for way in (1.0, -1.0)])}


def read_patch(law: StrikeLaw, conditions: Mapping[str, Array], _: None) -> Readings:
    """Friction of a patch under half a sine of load (60 N, 30 ms), by backward Euler, shape (steps,) [N]."""
    reference = law.reference
    mobility = 1.0 / reference.tangential_mass + 1.0 / reference.rolling_mass
    step = jnp.asarray(0.03 / PATCH_STEPS)
    diameter = reference.ball.diameter()

    def advance(state, share):
        relative, rolling, spring, path, work = state
        wave = jnp.sin(jnp.pi * share)
        depression = 0.005 * wave
        pressure = conditions.get("initial_pressure", jnp.zeros(()))
        patch = Patch(0.03 * share, depression, jnp.pi / 4 * depression, find_height(diameter, depression), pressure,
                      60.0 * wave, conditions)
        limit = law.limit(patch, relative, path, work)
        brake = law.brake(patch) * share_friction(rolling, reference.creep_speed) / reference.rolling_mass
        braked = relative + step * brake
        speed = solve_slider((law.compliance(patch) + step**2 * mobility) * limit, step, spring + step * braked,
                             reference.creep_speed)
        force = limit * share_friction(speed, reference.creep_speed)
        after = braked - step * mobility * force
        spring, path = spring + step * (after - speed), path + step * jnp.abs(speed)
        rolling = rolling + step * (force / reference.rolling_mass - brake)
        return (after, rolling, spring, path, work + step * force * speed), force

    start = (conditions["tangential_speed"], *[jnp.zeros(())] * 4)
    return {"reading": jax.lax.scan(advance, start, (jnp.arange(PATCH_STEPS) + 1.0) / PATCH_STEPS)[1]}


def read_turning(law: TumbleLaw, conditions: Mapping[str, Array], _: None) -> Readings:
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


def _put_in_orbit(model: AbstractModel) -> AbstractModel:
    """The body, in an orbit of 1e-3 rad/s where it is in none."""
    if isinstance(model, RigidBody) and not float(model.orbit_rate):
        return dc.replace(model, orbit_rate=jnp.asarray(1e-3))
    return model


@dc.dataclass(frozen=True, eq=False)
class Rig:
    """How effects of one family are tried.

    Attributes:
        usual: makes the reference model that is extended where none is given.
        conditions: of three records, where none are given, SI.
        read: readings of one record from law, conditions and path.
        follow: readings and path from law, conditions and duration [s]; the course is prescribed where it is None.
        measured: readings that are differentiated.
        prepare: completes a reference model.
        provides: what the rig has beside the reference model.
    """

    usual: Callable[[], AbstractModel]
    conditions: Mapping[str, Sequence[float]]
    read: Callable[[Any, Mapping[str, Array], Any], Readings]
    follow: Callable[[Any, Mapping[str, Array], Array], tuple[Readings, Any]] | None = None
    measured: tuple[str, ...] = ("reading",)
    prepare: Callable[[AbstractModel], AbstractModel] = lambda model: model
    provides: tuple[str, ...] = ()

    def run(self, law: Any, conditions: Mapping[str, Array], span: Array) -> tuple[Readings, Any]:
        """Readings and path of one record."""
        return (self.read(law, conditions, None), None) if self.follow is None else self.follow(law, conditions, span)


_SERIES = {"sequence": (1.0, 4.0, 9.0)}
_STRIKE = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34), **_SERIES}
_OBLIQUE = Rig(lambda: Striker(Ball(), CoulombFriction()), {**_STRIKE, "tangential_speed": (0.1, 0.3, 0.6)}, read_patch)
RIGS = {
    Ball.family: Rig(Ball, _STRIKE, read_impact, follow_impact, ("reading", "depression", "pressure")),
    RubberFriction.family: Rig(
        RubberFriction, {"normal_load": (6.0, 14.0, 27.0), "internal_pressure": (0.6e6, 1.1e6, 2.3e6),
                         "slip_speed": (0.02, 0.1, 0.4), **_SERIES}, read_stroke),
    RigidBody.family: Rig(
        RigidBody, {"x": (0.05, 0.02, -0.07), "y": (0.03, -0.06, 0.04), "z": (0.08, 0.05, -0.09), **_SERIES},
        read_turning, prepare=_put_in_orbit, provides=("orbit_rate",)),
}  # fmt: skip


@eqx.filter_jit
def _run_all(rig: Rig, law: Any, conditions: Mapping[str, Array], spans: Array) -> tuple[Readings, Any]:
    return jax.vmap(rig.run, in_axes=(None, 0, 0))(law, conditions, spans)


# ---- the effect on its rig -----------------------------------------------------------------------------------------


class Bench:
    """An effect, a reference model and the records on which it is tried; compiles when it is first asked.

    Args:
        rig: of the effect's family.
        kind: class of the effect.
        reference: the model that it extends; the rig's usual one if None.
        conditions: of a few records, each shape (records,); the rig's, and whatever else the effect requires of a
            record, if None.
    """

    def __init__(self, rig: Rig, kind: Any, reference: AbstractModel | None,
                 conditions: Mapping[str, Sequence[float]] | None):
        if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
            raise TypeError("an effect is a class derived from one of the stages in ddetumble.contact.effect.")
        self.rig, self.kind, self.parameters = rig, kind, parameters_of(kind)
        self.reference = rig.prepare(rig.usual() if reference is None else reference)
        kind()  # pyright: ignore[reportCallIssue]  # raises where a method or a default is missing
        self.provides = {*self.reference.provides, *rig.provides}
        if conditions is None:
            provided = {*_MODELS, *self.provides, *rig.conditions}
            conditions = {**rig.conditions, **{x: (1.0, 2.0, 3.0) for x in kind.requires if x not in provided}}
        self.conditions = {key: jnp.asarray(value, dtype=float) for key, value in conditions.items()}
        self.records = len(next(iter(self.conditions.values())))
        self.null = np.array([p.default for p in self.parameters])
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        self.starts = [np.array(values) for values in itertools.islice(itertools.product(*several), MOST)]
        self.traces = 0
        self._seen: dict[tuple[float, ...], tuple[Any, Readings]] = {}

        def run_one(law, record, span):
            self.traces += 1
            return rig.run(law, record, span)

        def run_slopes(values):
            def measure(v):
                found = jax.vmap(rig.run, in_axes=(None, 0, 0))(self.build(v), self.conditions, self.spans)
                return {name: found[0][name] for name in rig.measured}, found

            _, push, found = jax.linearize(measure, values, has_aux=True)
            return found, jax.vmap(push)(jnp.eye(len(self.parameters)))

        self._run_one, self._run_slopes = eqx.filter_jit(run_one), eqx.filter_jit(run_slopes)

    @functools.cached_property
    def spans(self) -> Array:
        """Durations in which the reference model separates, shape (records,) [s], with half as much again to spare."""
        spans = np.full(self.records, 1e-3)
        for _ in range(14 if self.rig.follow else 0):
            touching = np.asarray(_run_all(self.rig, self.bare, self.conditions, jnp.asarray(spans))[1].touching)
            if not touching.any():
                break
            spans = np.where(touching, 2.0 * spans, spans)
        return jnp.asarray(1.5 * spans)

    @functools.cached_property
    def bare(self) -> Any:
        """The law without the effect."""
        return self.reference.extend(())

    def build(self, values: Any) -> Any:
        """The law with the effect at these field values."""
        return self.reference.extend((self.kind(**{p.field: values[k] for k, p in enumerate(self.parameters)}),))

    def record(self, k: int) -> dict[str, Array]:
        """Conditions of one record."""
        return {name: value[k] for name, value in self.conditions.items()}

    def run_one(self, values: Any, k: int) -> tuple[Readings, Any]:
        """Readings and path of one record, compiled; `traces` counts how often."""
        return self._run_one(self.build(values), self.record(k), self.spans[k])

    def run_all(self, values: Any) -> tuple[Any, Readings]:
        """Readings and paths of all records, and derivatives of what is measured, once for all clauses."""
        key = tuple(float(v) for v in values)
        if key not in self._seen:
            _ = self.spans  # not to be found while a program is traced
            self._seen[key] = self._run_slopes(jnp.asarray(key))
        return self._seen[key]

    def list_nulls(self) -> Iterator[tuple[tuple[float, ...], int, str]]:
        """Values at which the effect is absent, whatever its shape parameters, a record, and the values in words."""
        shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in self.parameters]
        for values in itertools.islice(itertools.product(*shapes), MOST):
            where = ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.parameters, values, strict=True))
            for k in range(self.records):
                yield values, k, where


# ---- the clauses ---------------------------------------------------------------------------------------------------


def _find_gap(bench: Bench) -> Found:
    kind, provided = bench.kind, {*bench.provides, *bench.conditions}
    stages = [name for base, name in STAGE_OF if issubclass(kind, base)] or [kind.stage] * bool(kind.stage)
    if len(stages) != 1:
        return f"it has {len(stages)} stages ({', '.join(stages) or 'none'}); derive it from exactly one."
    for field in ("id", "law", "reference"):
        if not str(getattr(kind, field, "")).strip():
            return f"`{field}` is empty."
    for need in kind.requires:
        if need not in provided:
            return f"it requires {need!r}, which {type(bench.reference).__name__} and the conditions do not provide."
    return True, f"acts on {stages[0]}; {kind.law} ({kind.reference})."


def _check_units(bench: Bench) -> Found:
    declared = {p.field for p in bench.parameters}
    for field in dc.fields(bench.kind):
        if field.name not in declared and not field.metadata.get("static"):
            return f"`{field.name}` has no unit: declare it by `parameter(unit, ...)` or `eqx.field(static=True)`."
    if not bench.parameters:
        return "it has no parameter: declare its amplitude by `parameter(unit, ...)`."
    problems = [text for one in bench.parameters if (text := _check_unit(one, bench.parameters))]
    return problems[0] if problems else (True, ", ".join(f"{p.name} [{p.unit or '1'}]" for p in bench.parameters) + ".")


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()


def _check_unit(one: Parameter, parameters: Sequence[Parameter]) -> str:
    """What is wrong with a parameter's unit; a power may be another parameter's name (`N/m^q`)."""
    if not isinstance(one.unit, str):
        return f"the unit of {one.name} is missing: give it as text, '' for a pure number."
    text = one.unit
    for other in parameters:
        text = re.sub(rf"(\^|\*\*){re.escape(other.name)}\b", rf"\g<1>({other.default!r})", text)
    try:
        _registry().parse_units(text)
    except Exception:  # pint raises many kinds
        return f"pint cannot read the unit {one.unit!r} of {one.name}; write it like N/m, N*s/m or 1/s."
    return ""


def _check_limits(bench: Bench) -> Found:
    stated = []
    for one in bench.parameters:
        low, high = one.limits
        if not low < high:
            return f"limits of {one.name} begin at {low:g} and end at {high:g}: give the lower first."
        if (low, high) == (-np.inf, np.inf):
            continue
        if not one.limits_reason.strip():
            return f"limits of {one.name} have no reason: say why in `limits_reason`."
        outside = [value for value in map(one.transform.publish, (one.default, *one.starts))
                   if not low <= value <= high]
        if outside:
            return f"limits of {one.name} leave out {outside[0]:g}, its null or a start of its fits."
        stated.append(f"{one.name} {low:g} to {high:g}")
    return True, (", ".join(stated) or "none stated") + "."


def _check_flattening(bench: Bench) -> Found:
    effect = bench.kind(**{p.field: v for p, v in zip(bench.parameters, bench.starts[0], strict=True)})
    leaves, structure = jax.tree.flatten(effect)
    if len(leaves) != len(bench.parameters):
        return f"it has {len(leaves)} leaves and {len(bench.parameters)} parameters."
    again = jax.tree.unflatten(structure, leaves)
    jax.tree.unflatten(structure, [object()] * len(leaves))  # JAX does this too
    same = eqx.tree_equal(effect, again)
    return bool(same), "flatten and unflatten keep it." if same else "flatten and unflatten change it."


def _compare_eager(bench: Bench) -> Found:
    values, k = [float(v) for v in bench.starts[0]], 1 % bench.records
    readings, path = bench.run_one(values, k)
    eager = bench.rig.read(bench.build(values), bench.record(k), path)
    worst = max(measure_difference(eager[name], readings[name]) for name in readings)
    return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."


def _count_traces(bench: Bench) -> Found:
    bench.run_one(bench.null, 0)
    before = bench.traces
    bench.run_one([int(v) if float(v).is_integer() else float(v) for v in bench.null], 0)
    bench.run_one(bench.starts[-1], bench.records - 1)
    if bench.traces > before:
        return "a new value compiles the program anew; `parameter(...)` makes a field an array, which does not."
    return True, "new values meet the program that is there already."


def _find_infinite(bench: Bench) -> Found:
    for values in bench.starts:
        where = dict(zip([p.name for p in bench.parameters], (float(v) for v in values), strict=True))
        for what, found in zip(("reading", "derivative"), bench.run_all(values), strict=True):
            if not all(np.isfinite(value).all() for value in jax.tree.leaves(found)):
                return f"a {what} is not finite at {where}."
    return True, f"readings and derivatives are finite at {len(bench.starts)} starts."


def _compare_loop(bench: Bench) -> Found:
    batch, worst = bench.run_all(bench.starts[0])[0][0], 0.0
    for k in range(bench.records):
        one = bench.run_one(bench.starts[0], k)[0]
        worst = max(worst, *(measure_difference(one[name], batch[name][k]) for name in bench.rig.measured))
    return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."


def _compare_null(bench: Bench) -> Found:
    for values, k, where in bench.list_nulls():
        record = bench.record(k)
        path = bench.run_one(values, k)[1] if bench.rig.follow else None
        extended, bare = (bench.rig.read(law, record, path) for law in (bench.build(values), bench.bare))
        for name in bare:
            a, b = np.asarray(extended[name]), np.asarray(bare[name])
            if not np.array_equal(a, b):
                return f"the {name} changes by up to {np.abs(a - b).max():.3g} [SI] at {where}."
    return True, "every reading is that without it, to the last bit."


def _find_slope(bench: Bench, k: int) -> Found:
    one = bench.parameters[k]
    scanned = one.kind == "shape" or one.transform.reciprocal or one.singular
    points = bench.starts if scanned else [bench.null]
    if one.kind == "shape":
        points = [np.where(np.arange(len(bench.parameters)) == k, v, p)
                  for p in bench.starts for v in (one.starts or (one.default,))]
    bare, best = _run_all(bench.rig, bench.bare, bench.conditions, bench.spans)[0], 0.0
    for values in points:
        for name, slopes in bench.run_all(values)[1].items():
            slope, largest = np.asarray(slopes[k]), float(np.abs(bare[name]).max())
            if not np.isfinite(slope).all():
                return f"the derivative of the {name} is not finite{'' if scanned else ' at the null'}."
            best = max(best, float(np.abs(slope).max() * one.typical / max(largest, 1e-300)))
    place = "over its starts" if scanned else "at its null"
    if best <= _ALIVE:
        remedy = "nothing reads it" if scanned else "let the law start linearly in its amplitude"
        return f"no reading moves with it {place}: {remedy}."
    change = f"{one.typical:g} {one.unit}".rstrip()
    return True, f"a typical change ({change}) moves a reading by {best:.1e} of its largest value {place}."


CLAUSES: tuple[tuple[str, str, Callable[[Bench], Found]], ...] = (
    ("complete", "It has one stage, an id, a law, a reference, and all that it requires of model and records.",
     _find_gap),
    ("units", "Every number is a declared parameter whose unit `pint` reads.", _check_units),
    ("limits", "Limits, where stated, have a reason and hold the null and all starts.", _check_limits),
    ("flattens", "Its leaves are its parameters, and a round trip keeps them.", _check_flattening),
    ("compiled = eager", "Compiled readings are those of the law evaluated operation by operation.", _compare_eager),
    ("compiles once", "New values, Python numbers among them, meet the program that is there.", _count_traces),
    ("finite at its starts", "Readings and derivatives are finite at every start.", _find_infinite),
    ("batch = loop", "All records at once give what one after the other gives.", _compare_loop),
    ("absent at its null", "At its null, whatever its shapes, readings are to the last bit those without it.",
     _compare_null),
)  # after these a clause `... alive` for every parameter: it moves a reading at its null, or over its starts


def check_effect(
    effect_class: type[AbstractEffect], reference: AbstractModel | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
) -> EffectReport:
    """Prove by trial impacts, strokes or tumbling that an effect keeps the contract on which fits and discovery rely.

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
        bench = Bench(RIGS.get(family_of(effect_class), _OBLIQUE), effect_class, reference, conditions)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    clauses = [(title, clause) for title, _, clause in CLAUSES]
    clauses += [(f"{one.name} alive", functools.partial(_find_slope, k=k)) for k, one in enumerate(bench.parameters)]
    return EffectReport(name, tuple(_judge(title, clause, bench) for title, clause in clauses))


def _judge(name: str, clause: Callable[[Bench], Found], bench: Bench) -> Check:
    """Try one clause; an exception breaks it."""
    try:
        found = clause(bench)
    except Exception as error:
        return Check(name, False, explain_error(error))
    ok, sentence = found if isinstance(found, tuple) else (False, found)
    return Check(name, bool(ok), sentence)


def explain_error(error: Exception) -> str:
    """One line about an exception, with the remedy for the commonest two."""
    text = (str(error).strip().splitlines() or [""])[0]
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return "Python's `if` or `and` meets a value known only when the program runs; write `jnp.where(...)` instead."
    if isinstance(error, KeyError):
        return f"it asks for {text}, which no record has; name the condition in `requires`."
    return f"{type(error).__name__}: {text}"


def measure_difference(a: Any, b: Any) -> float:
    """Largest difference relative to the largest value; infinite where either is not a number."""
    a, b = np.asarray(a), np.asarray(b)
    difference = float(np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-300))
    return difference if np.isfinite(difference) else float("inf")
