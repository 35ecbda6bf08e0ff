"""`check_effect`: proves by trial records that an effect keeps the rules on which fits and `discover` rely.

    print(check_effect(WallStiffness))
    check_effect(MyEffect).require()

The trials are simulated by the family's own model of a record (`simulate`, `slide`, `strike`, `spin`). What has to hold
to the last bit is evaluated along the simulated motion operation by operation, because a compiler may round otherwise.
"""

import dataclasses as dc
import functools
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._errors import InputError
from .._numerics import stop
from .._rotation import rotate_back
from ..contact.effect import AbstractEffect, AbstractModel, family_of, parameters_of
from ..contact.function_effect import STAGES
from ..contact.gripping import Patch, StrikeLaw, Striker, find_height
from ..contact.law import Ball, ContactLaw
from ..contact.signal import Signal
from ..contact.sliding import CoulombFriction, FrictionLaw, RubberFriction, Slide
from ..contact.torque import RigidBody, Spin, TumbleLaw
from ..dynamics.impact import Course, follow, read_motion
from ..dynamics.slide import slide
from ..dynamics.spinning import START, spin
from ..dynamics.strike import NODES as COURSE_NODES
from ..dynamics.strike import grip


TOLERANCE = 1e-10  # compiled against eager, batch against loop, of the largest value: rounding stays far below
ALIVE = 1e-9  # smallest response to a typical change of a parameter, of the largest reading: rounding stays below
MOST = 12  # combinations of starts that are tried, so that an effect with many shapes takes no longer than a minute
SPAN = 16.0  # s in which a trial impact has to end: a ball of a ton on a soft spring takes a few seconds
NODES = 49  # states at which a law is evaluated, a few in every part of a motion; an odd number

Readings = Mapping[str, Array]
Finding = tuple[bool, str]  # whether a clause holds, and what was found


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


def simulate_impact(law: ContactLaw, conditions: Readings) -> tuple[Readings, Readings]:
    """An impact and as long again: what the channels read; the integrator's own steps, states of effects among them."""
    course = follow(law, conditions, jnp.asarray(SPAN), dfx.ForwardMode())
    impact, _ = read_motion(law, conditions, stop(course.end) * np.linspace(0.0, 2.0, 2 * NODES), course, True)
    steps = jnp.sum(jnp.isfinite(course.path.time)) - 1
    nodes = jnp.round(jnp.linspace(0.0, 1.0, NODES) * steps).astype(int)
    return (_spoil(impact.failed, {name: getattr(impact, name) for name in ("normal_force", "depression", "pressure")}),
            {"time": course.path.time[nodes], "state": course.path.state[nodes]})


def evaluate_contact(law: ContactLaw, conditions: Readings, motion: Readings) -> Readings:
    """Forces and pressure over an impact, and what the gauge makes of such a force."""
    diameter, damping = law.start(conditions)

    def at(time, state):
        return law.forces(law.contact(conditions, diameter, time, state[0], state[1], state[2:]), damping, state[2:])

    forces = jax.vmap(at)(motion["time"], motion["state"])
    force = forces.normal
    duration = jnp.full(NODES // 2, 2.0 / NODES) * motion["time"][-1]
    reading = law.reading(Signal(duration, force[:-1:2], force[1::2], force[2::2]))
    return {"force": force, "drive": forces.drive, "pressure": forces.pressure, "reading": reading.end}


def simulate_oblique(law: StrikeLaw, conditions: Readings) -> tuple[Readings, Mapping[str, Course]]:
    """An oblique impact: the force along the plate and the slip; the normal motion, which the patch sees."""
    motion = follow(law.normal, conditions, jnp.asarray(SPAN), dfx.ForwardMode())
    impact, course = read_motion(law.normal, conditions, stop(motion.end)[None], motion, True,
                            np.linspace(0.0, 1.0, COURSE_NODES))
    assert course is not None
    found = grip(law, conditions, motion.diameter, course)
    return _spoil(impact.failed, {"tangential_force": found.force, "slip": found.slip}), {"course": course}


def _spoil(failed: Array, readings: Readings) -> Readings:
    """NaN in place of the zeros that a simulation gives where it fails."""
    return {name: jnp.where(failed, jnp.nan, value) for name, value in readings.items()}


def evaluate_patch(law: StrikeLaw, conditions: Readings, motion: Mapping[str, Course]) -> Readings:
    """What effects on the patch change: its compliance, and the brake of rolling."""
    diameter = law.reference.ball.diameter()

    def at(here):
        patch = Patch(here.time, here.depression, here.contact_radius, find_height(diameter, here.depression),
                      here.pressure, here.normal_force, conditions)
        return {"compliance": law.compliance(patch), "brake": law.brake(patch)}

    return jax.vmap(at)(motion["course"])


_SLIP = np.tile(np.linspace(0.0, 0.012, NODES), 2)  # a stroke forward and one back
_WAY, _TIME = np.repeat([1.0, -1.0], NODES), np.linspace(0.0, 0.24, 2 * NODES)


def simulate_strokes(law: FrictionLaw, conditions: Readings) -> tuple[Readings, Readings]:
    """Two strokes: the friction force; the friction work."""
    found = slide(law, conditions, jnp.asarray(_SLIP), jnp.asarray(_WAY), jnp.asarray(_TIME))
    return {"tangential_force": found.tangential_force}, {"work": found.work}


def evaluate_friction(law: FrictionLaw, conditions: Readings, motion: Readings) -> Readings:
    """The friction force over two strokes."""
    speed, pressure = (conditions.get(name, jnp.zeros(())) for name in ("slip_speed", "internal_pressure"))

    def at(slip, work, time, way):
        return law.force(Slide(slip, speed, conditions["normal_load"], pressure, work, time, way, conditions))

    return {"friction force": jax.vmap(at)(_SLIP, motion["work"], _TIME, _WAY)}


_MESH = np.linspace(0.0, 200.0, NODES)  # s; 4 s a step, 0.5 rad at the fastest of the usual rates


def simulate_rotation(law: TumbleLaw, conditions: Readings) -> tuple[Readings, Readings]:
    """Tumbling: rates as the gyroscopes read them, and attitude; the true motion, inner bodies included."""
    found = spin(law, conditions, jnp.asarray(_MESH), jnp.asarray(_MESH))
    return ({"angular_velocity": found.angular_velocity, "attitude": found.attitude},
            {"rates": found.body, "attitude": found.attitude, "inner": found.inner})


def evaluate_rotation(law: TumbleLaw, conditions: Readings, motion: Readings) -> Readings:
    """Angular accelerations, and readings of the gyroscopes."""
    moments, rate = law.moments(), law.reference.orbit_rate

    def at(time, omega, attitude, inner):
        vertical = rotate_back(attitude, jnp.stack([jnp.cos(rate * time), jnp.sin(rate * time), 0.0 * time]))
        seen = Spin(time, omega, attitude, vertical, moments, rate, conditions, jnp.zeros(3))
        return law.accelerate(seen, inner)[0]

    return {"acceleration": jax.vmap(at)(_MESH, motion["rates"], motion["attitude"], motion["inner"]),
            "reading": law.read(motion["rates"], jnp.asarray(_MESH))}


@dc.dataclass(frozen=True)
class TrialRecords:
    """How a family's records are tried.

    Attributes:
        model: makes the usual reference model.
        conditions: of three records, SI, where none are given.
        simulate: function of law and conditions of one record that gives what is measured, and the motion.
        evaluate: function of law, conditions and motion that gives everything that an effect of the family changes.
    """

    model: Callable[[], AbstractModel]
    conditions: Mapping[str, tuple[float, ...]]
    simulate: Callable[[Any, Readings], tuple[Readings, Mapping[str, Any]]]
    evaluate: Callable[[Any, Readings, Any], Readings]


_SERIES = {"sequence": (1.0, 4.0, 9.0)}
_IMPACTS = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34), **_SERIES}
TRIALS: dict[str, TrialRecords] = {
    "impact": TrialRecords(Ball, _IMPACTS, simulate_impact, evaluate_contact),
    "slip": TrialRecords(
        RubberFriction, {"normal_load": (6.0, 14.0, 27.0), "internal_pressure": (0.6e6, 1.1e6, 2.3e6),
                         "slip_speed": (0.02, 0.1, 0.4), **_SERIES}, simulate_strokes, evaluate_friction),
    "oblique": TrialRecords(
        lambda: Striker(Ball(), CoulombFriction()), {**_IMPACTS, "tangential_speed": (0.1, 0.3, 0.6)},
        simulate_oblique, evaluate_patch),
    "tumble": TrialRecords(
        RigidBody, {START[0]: (0.05, 0.02, -0.07), START[1]: (0.03, -0.06, 0.04), START[2]: (0.08, 0.05, -0.09),
                    "orbit_rate": (1e-3, 1e-3, 1e-3), **_SERIES}, simulate_rotation, evaluate_rotation),
}  # fmt: skip


@final
class EffectRig:
    """An effect test rig: an effect on its reference model, and trials of a few records.

    Attributes:
        kind: class of the effect; `parameters` are its.
        reference: the model that it extends.
        conditions: of the records by name, SI, each shape (records,).
        evaluate: what the law gives along a motion, as `TrialRecords` has it; compiled by `run_law`.
        traces: how often `run_law` has been traced.
    """

    def __init__(self, kind: Any, reference: Any = None, conditions: Mapping[str, Sequence[float]] | None = None):
        if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
            raise TypeError("an effect is a class derived from one of the stages in ddetumble.contact.effect.")
        kind()  # pyright: ignore[reportCallIssue]  # raises where a method or a default is missing
        trials = TRIALS[family_of(kind)]
        self.kind, self.parameters, self.evaluate, self.traces = kind, parameters_of(kind), trials.evaluate, 0
        self.reference: Any = trials.model() if reference is None else reference
        if isinstance(self.reference, RigidBody) and not float(self.reference.orbit_rate):
            self.reference = dc.replace(self.reference, orbit_rate=jnp.asarray(1e-3))  # rad/s, a low orbit of the Earth
        if conditions is None:
            # What only a model can provide is no condition of a record.
            provided = {"gas", "geometry", "damping", "rubber", *self.reference.provides, *trials.conditions}
            conditions = {**trials.conditions, **{n: (1.0, 2.0, 3.0) for n in kind.requires if n not in provided}}
        self.conditions = {key: jnp.asarray(value, dtype=float) for key, value in conditions.items()}
        self.records = len(next(iter(self.conditions.values())))
        self.null = np.array([p.default for p in self.parameters])
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        self.starts = [np.array(values) for values in itertools.islice(itertools.product(*several), MOST)]

        def run_all(values):
            def run(v):
                readings, motion = jax.vmap(trials.simulate, (None, 0))(self.build(v), self.conditions)
                return readings, (readings, motion)

            def push(direction):
                return jax.jvp(run, (values,), (direction,), has_aux=True)[1:]

            slopes, found = jax.vmap(push)(jnp.eye(len(self.parameters)))
            return *jax.tree.map(lambda x: x[0], found), slopes

        def run_law(law, conditions, motion):
            self.traces += 1
            return trials.evaluate(law, conditions, motion)

        self._run_all, self.run_law = eqx.filter_jit(run_all), eqx.filter_jit(run_law)
        self._seen: dict[tuple[float, ...], Any] = {}

    def build(self, values: Any) -> Any:
        """The law with the effect at these field values."""
        return self.reference.extend((self.kind(**{p.field: values[k] for k, p in enumerate(self.parameters)}),))

    def simulate(self, values: Any) -> tuple[Readings, Any, Readings]:
        """Readings, shape (records, ...), motions, and derivatives of the readings, (parameters, records, ...)."""
        key = tuple(float(v) for v in values)
        if key not in self._seen:
            self._seen[key] = self._run_all(jnp.asarray(key))
        return self._seen[key]

    def case(self, values: Any, k: int) -> tuple[Any, Readings, Any]:
        """Law, conditions and motion of one record, as `evaluate` takes them."""
        return (self.build(values), {name: value[k] for name, value in self.conditions.items()},
                jax.tree.map(lambda x: x[k], self.simulate(values)[1]))

    def describe(self, values: Any) -> str:
        """Values of the parameters in words."""
        return ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.parameters, values, strict=True))


def check_effect(
    effect_class: type[AbstractEffect], reference: AbstractModel | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
) -> EffectReport:
    """Prove by trial records that an effect keeps the contract on which fits and discovery rely.

    The clauses: it is complete (one stage, id, law, reference, nothing missing on the model); its parameters have units
    that `pint` reads, and limits, where they state any, with a reason, around null and starts; its values survive
    flattening; new values do not compile anew; it is finite at its starts;
    compiled code gives what eager code gives; a batch gives what a loop gives; at its null it is absent to the last
    bit; every amplitude moves the readings at its null, every shape parameter (and every parameter whose null is
    singular: `coordinate="inverse"`, `singular=True`) somewhere over its starts.

    Args:
        effect_class: the class, with defaults for all parameters.
        reference: the reference model that it extends; the paper's ball, or its friction, by default.
        conditions: conditions of a few records by name, SI, each shape (records,), as the family's simulation takes
            them; by default three records that differ in pressure, speed (load, rates) and place in a series, and in
            every further condition that the effect requires.

    Returns:
        An `EffectReport`; nothing is raised (see `EffectReport.require`).
    """
    name = str(getattr(effect_class, "id", "") or getattr(effect_class, "__name__", effect_class))
    try:
        rig = EffectRig(effect_class, reference, conditions)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    clauses: list[tuple[str, Callable[[EffectRig], Finding]]] = [
        ("complete", check_completeness), ("units", check_units), ("limits", check_limits), ("flattens", check_pytree),
        ("compiled = eager", check_compiled), ("compiles once", check_compilations),
        ("finite at its starts", check_finite), ("batch = loop", check_batch), ("absent at its null", check_null),
        *((f"{one.name} alive", functools.partial(check_response, k=k)) for k, one in enumerate(rig.parameters)),
    ]
    return EffectReport(name, tuple(judge(clause, check, rig) for clause, check in clauses))


def judge(name: str, check: Callable[[EffectRig], Finding], rig: EffectRig) -> Check:
    """Try one clause; an exception breaks it."""
    try:
        ok, sentence = check(rig)
    except Exception as error:
        return Check(name, False, explain_error(error))
    return Check(name, bool(ok), sentence)


def explain_error(error: Exception) -> str:
    """One line about an exception, with the remedy for the commonest two."""
    text = (str(error).strip().splitlines() or [""])[0]
    if isinstance(error, jax.errors.TracerBoolConversionError):
        return "Python's `if` or `and` meets a value known only when the program runs; write `jnp.where(...)` instead."
    if isinstance(error, KeyError):
        return f"it asks for {text}, which no record has; name the condition in `requires`."
    return f"{type(error).__name__}: {text}"


def check_completeness(rig: EffectRig) -> Finding:
    """One stage, texts, and a reference model and records that have what the effect requires."""
    kind = rig.kind
    stages = [name for name, base in STAGES.items() if issubclass(kind, base)] or [kind.stage] * bool(kind.stage)
    if len(stages) != 1:
        return False, f"it has {len(stages)} stages ({', '.join(stages) or 'none'}); derive it from exactly one."
    for field in ("id", "law", "reference"):
        if not str(getattr(kind, field, "")).strip():
            return False, f"`{field}` is empty."
    for need in kind.requires:
        if need not in rig.reference.provides and need not in rig.conditions:
            model = type(rig.reference).__name__
            return False, f"it requires {need!r}, which {model} and the conditions do not provide."
    return True, f"acts on {stages[0]}; {kind.law} ({kind.reference})."


def check_pytree(rig: EffectRig) -> Finding:
    """Its leaves are its parameters, and a round trip keeps them."""
    effect = rig.kind(**{p.field: v for p, v in zip(rig.parameters, rig.starts[0], strict=True)})
    leaves, structure = jax.tree.flatten(effect)
    if len(leaves) != len(rig.parameters):
        return False, f"it has {len(leaves)} leaves and {len(rig.parameters)} parameters."
    jax.tree.unflatten(structure, [object()] * len(leaves))  # JAX does this too
    same = bool(eqx.tree_equal(effect, jax.tree.unflatten(structure, leaves)))
    return same, f"flatten and unflatten {'keep' if same else 'change'} it."


def check_compiled(rig: EffectRig) -> Finding:
    """The law along a simulated motion, compiled and operation by operation."""
    case = rig.case(rig.starts[0], 1 % rig.records)
    return compare_readings(rig.run_law(*case), rig.evaluate(*case))


def check_batch(rig: EffectRig) -> Finding:
    """The law along the motions of all records at once, and one after the other."""
    law, readings = rig.build(rig.starts[0]), rig.simulate(rig.starts[0])
    batch = eqx.filter_jit(jax.vmap(rig.evaluate, (None, 0, 0)))(law, rig.conditions, readings[1])
    loop = [rig.run_law(*rig.case(rig.starts[0], k)) for k in range(rig.records)]
    return compare_readings(batch, jax.tree.map(lambda *one: jnp.stack(one), *loop))


def compare_readings(found: Readings, expected: Readings) -> Finding:
    """Whether two ways give the same but for rounding, relative to the largest value; what is not a number differs."""
    worst = 0.0
    for name, value in expected.items():
        a, b = np.asarray(found[name]), np.asarray(value)
        one = float(np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-300))
        worst = max(worst, one if np.isfinite(one) else np.inf)
    return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."


def check_compilations(rig: EffectRig) -> Finding:
    """New values, Python numbers among them, meet the program that is there already."""
    _, conditions, motion = rig.case(rig.null, 0)
    rig.run_law(rig.build(rig.null), conditions, motion)
    before = rig.traces
    for values in ([int(v) if float(v).is_integer() else float(v) for v in rig.null], rig.starts[-1]):
        rig.run_law(rig.build(values), conditions, motion)
    if rig.traces > before:
        return False, "a new value compiles the program anew; `parameter(...)` makes a field an array, which does not."
    return True, "new values meet the program that is there already."


def check_finite(rig: EffectRig) -> Finding:
    """Readings and derivatives at every start."""
    for values in rig.starts:
        readings, _, slopes = rig.simulate(values)
        for what, found in (("reading", readings), ("derivative", slopes)):
            if not all(np.isfinite(value).all() for value in found.values()):
                return False, f"a {what} is not finite, or cannot be simulated, at {rig.describe(values)}."
    return True, f"readings and derivatives are finite at {len(rig.starts)} starts."


def check_null(rig: EffectRig) -> Finding:
    """What the law gives with and without the effect, whatever its shapes, to the last bit."""
    shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in rig.parameters]
    bare: Readings = {}
    for values in itertools.islice(itertools.product(*shapes), MOST):
        for k in range(rig.records):
            law, conditions, motion = rig.case(values, k)
            extended = rig.evaluate(law, conditions, motion)
            bare = rig.evaluate(rig.reference.extend(()), conditions, motion)
            for name, value in bare.items():
                a, b = np.asarray(extended[name]), np.asarray(value)
                if not np.array_equal(a, b):
                    change = np.abs(a - b).max()
                    return False, f"the {name} changes by up to {change:.3g} [SI] at {rig.describe(values)}."
    return True, f"{', '.join(bare)}: as without it, to the last bit."


def check_response(rig: EffectRig, k: int) -> Finding:
    """Derivative of the readings by one parameter: at the null, or over the starts."""
    one = rig.parameters[k]
    scanned = one.kind == "shape" or one.coordinate == "inverse" or one.singular
    points = rig.starts if scanned else [rig.null]
    if one.kind == "shape":
        points = [np.where(np.arange(len(rig.parameters)) == k, v, p)
                  for p in rig.starts for v in (one.starts or (one.default,))]
    bare, best = rig.simulate(rig.null)[0], 0.0
    for values in points:
        for name, slopes in rig.simulate(values)[2].items():
            slope, largest = np.asarray(slopes[k]), float(np.abs(bare[name]).max())
            if not np.isfinite(slope).all():
                return False, f"the derivative of {name} is not finite{'' if scanned else ' at the null'}."
            best = max(best, float(np.abs(slope).max() * one.typical / max(largest, 1e-300)))
    place = "over its starts" if scanned else "at its null"
    if best <= ALIVE:
        remedy = "nothing reads it" if scanned else "let the law start linearly in its amplitude"
        return False, f"no reading moves with it {place}: {remedy}."
    change = f"{one.typical:g} {one.unit}".rstrip()
    return True, f"a typical change ({change}) moves a reading by {best:.1e} of its largest value {place}."


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()


def check_units(rig: EffectRig) -> Finding:
    """Every number of an effect is a declared parameter whose unit `pint` reads.

    A power in a unit may be another parameter's name (`N/m^q`).
    """
    parameters, declared = rig.parameters, {p.field for p in rig.parameters}
    for field in dc.fields(rig.kind):
        if field.name not in declared and not field.metadata.get("static"):
            return False, (f"`{field.name}` has no unit: declare it by `parameter(unit, ...)` or "
                           "`eqx.field(static=True)`.")
    if not parameters:
        return False, "it has no parameter: declare its amplitude by `parameter(unit, ...)`."
    for one in parameters:
        if not isinstance(one.unit, str):
            return False, f"the unit of {one.name} is missing: give it as text, '' for a pure number."
        text = one.unit
        for other in parameters:
            text = re.sub(rf"(\^|\*\*){re.escape(other.name)}\b", rf"\g<1>({other.default!r})", text)
        try:
            _registry().parse_units(text)
        except Exception:  # pint raises many kinds
            return False, f"pint cannot read the unit {one.unit!r} of {one.name}; write it like N/m, N*s/m or 1/s."
    return True, ", ".join(f"{p.name} [{p.unit or '1'}]" for p in parameters) + "."


def check_limits(rig: EffectRig) -> Finding:
    """What physics allows is a range with a reason that holds the null and all starts of every parameter."""
    stated = []
    for one in rig.parameters:
        low, high = one.limits
        if not low < high:
            return False, f"limits of {one.name} begin at {low:g} and end at {high:g}: give the lower first."
        if (low, high) == (-np.inf, np.inf):
            continue
        if not one.limits_reason.strip():
            return False, f"limits of {one.name} have no reason: say why in `limits_reason`."
        values = [one.default, *one.starts]
        if one.coordinate == "inverse":
            values = [1.0 / value if value else np.inf for value in values]
        outside = [value for value in values if not low <= value <= high]
        if outside:
            return False, f"limits of {one.name} leave out {outside[0]:g}, its null or a start of its fits."
        stated.append(f"{one.name} {low:g} to {high:g}")
    return True, (", ".join(stated) or "none stated") + "."
