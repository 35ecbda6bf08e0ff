"""The contract of an effect, proved by trial: absent at its null, alive in its amplitudes, compiled = eager.

    print(check_effect(WallStiffness))
    check_effect(MyEffect).require()
"""

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .clauses import (
    TOLERANCE,
    Check,
    EffectReport,
    explain_error,
    find_gap,
    judge_clause,
    measure_difference,
    read_units,
)
from .effect import STAGE_OF, AbstractEffect, AbstractModel, family_of, parameters_of
from .law import Ball, ContactLaw
from .tangential_contract import check_oblique_effect, check_slip_effect
from .torque_contract import check_tumble_effect
from .trial import STEPS, Trial, evaluate_path, read_gauge, try_impact


_ALIVE = 1e-9  # smallest change of a reading by a typical change of a parameter, relative to the largest reading
_CONDITIONS = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34),
               "sequence": (1.0, 4.0, 9.0)}  # fmt: skip
_READINGS = ("normal_force", "depression", "pressure")


@eqx.filter_jit
def _try_references(reference, conditions, spans) -> Trial:
    return jax.vmap(try_impact, in_axes=(None, 0, 0))(ContactLaw(reference), conditions, spans)


def check_effect(
    effect_class: type[AbstractEffect], reference: AbstractModel | None = None,
    conditions: Mapping[str, Sequence[float]] | None = None,
) -> EffectReport:
    """Prove by trial impacts, strokes or tumbling that an effect keeps the contract on which fits and discovery rely.

    The clauses: it is complete (one stage, id, law, reference, nothing missing on the model); its parameters have units
    that `pint` reads; its values survive flattening; new values do not compile anew; it is finite at its starts;
    compiled code gives what eager code gives; a batch gives what a loop gives; at its null it is absent to the last
    bit; every amplitude moves the readings at its null, every shape parameter (and every parameter whose null is
    singular: `coordinate="inverse"`, `singular=True`) somewhere over its starts.

    Args:
        effect_class: the class, with defaults for all parameters.
        reference: the reference model that it extends; the paper's ball, or its friction, by default.
        conditions: conditions of a few records by name, SI, each shape (records,); by default three records that
            differ in pressure, speed (load) and place in a series, and in every further condition that the effect
            requires.

    Returns:
        An `EffectReport`; nothing is raised (see `EffectReport.require`).
    """
    name = str(getattr(effect_class, "id", "") or getattr(effect_class, "__name__", effect_class))
    if family_of(effect_class) != "impact":
        checks = {"slip": check_slip_effect, "tumble": check_tumble_effect}
        return checks.get(family_of(effect_class), check_oblique_effect)(effect_class, name, reference, conditions)
    try:
        bench = _Bench(effect_class, Ball() if reference is None else reference, conditions)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    clauses: list[tuple[str, Callable[[], str | tuple[bool, str]]]] = [
        ("complete", bench.find_gaps), ("units", bench.read_units), ("flattens", bench.flatten),
        ("compiled = eager", bench.compare_eager), ("compiles once", bench.count_traces),
        ("finite at its starts", bench.find_infinite), ("batch = loop", bench.compare_loop),
        ("absent at its null", bench.compare_null),
    ]
    for k, one in enumerate(bench.parameters):
        clauses.append((f"{one.name} alive", functools.partial(bench.find_slope, k)))
    checks = [judge_clause(*clause) for clause in clauses]
    return EffectReport(name, tuple(checks))


class _Bench:
    """An effect, a reference model and records to try them on; programs are compiled when they are first needed."""

    def __init__(self, effect_class, reference, conditions):
        self.kind, self.reference = effect_class, reference
        if not (isinstance(effect_class, type) and issubclass(effect_class, AbstractEffect)):
            raise TypeError("an effect is a class derived from one of the stages in ddetumble.contact.effect.")
        self.parameters = parameters_of(effect_class)
        effect_class()  # pyright: ignore[reportCallIssue]  # raises where a method or a default is missing
        found = dict(_CONDITIONS)
        found |= {name: (1.0, 2.0, 3.0) for name in effect_class.requires if name not in ("gas", "geometry", "damping")
                  and name not in found}  # fmt: skip
        given = found if conditions is None else conditions
        self.conditions = {key: jnp.asarray(value, dtype=float) for key, value in given.items()}
        self.records = len(self.conditions["approach_speed"])
        self.null = np.array([p.default for p in self.parameters])
        self.traces = 0
        self.seen: dict[tuple[float, ...], tuple[Trial, Trial]] = {}

        def values_of(values, conditions, spans) -> Trial:
            return jax.vmap(try_impact, in_axes=(None, 0, 0))(self.build(values), conditions, spans)

        def slopes_of(values, conditions, spans):
            trial, push = jax.linearize(lambda v: values_of(v, conditions, spans), values)
            return trial, jax.vmap(push)(jnp.eye(len(self.parameters)))

        def one_of(law, conditions, span) -> Trial:
            self.traces += 1
            return try_impact(law, conditions, span)

        self.run_slopes, self.run_one = eqx.filter_jit(slopes_of), eqx.filter_jit(one_of)

    def build(self, values) -> ContactLaw:
        """The law with the effect at these field values."""
        fields = {p.field: values[k] for k, p in enumerate(self.parameters)}
        return ContactLaw(self.reference, (self.kind(**fields),))

    def record(self, k: int) -> dict[str, Array]:
        """Conditions of one record."""
        return {name: value[k] for name, value in self.conditions.items()}

    @functools.cached_property
    def spans(self) -> Array:
        """Durations in which the reference model separates, shape (records,) [s], with half as much again to spare."""
        spans = np.full(self.records, 1e-3)
        for _ in range(14):
            touching = np.asarray(_try_references(self.reference, self.conditions, jnp.asarray(spans)).touching)
            if not touching.any():
                break
            spans = np.where(touching, 2.0 * spans, spans)
        return jnp.asarray(1.5 * spans)

    @functools.cached_property
    def bare(self) -> Trial:
        """The reference model alone, all records."""
        return _try_references(self.reference, self.conditions, self.spans)

    @functools.cached_property
    def starts(self) -> list[np.ndarray]:
        """All combinations of the parameters' starts, at most a dozen."""
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        return [np.array(values) for values in itertools.islice(itertools.product(*several), 12)]

    def at(self, values: Sequence[float] | np.ndarray) -> tuple[Trial, Trial]:
        """Trials of all records at field values, and their derivatives, shape (parameters, records, ...)."""
        key = tuple(float(v) for v in values)
        if key not in self.seen:
            self.seen[key] = self.run_slopes(jnp.asarray(key), self.conditions, self.spans)
        return self.seen[key]

    def find_gaps(self):
        """One stage, texts, and a reference model that has what the effect needs."""
        stages = [name for base, name in STAGE_OF if issubclass(self.kind, base)]
        if len(stages) != 1:
            return f"it has {len(stages)} stages ({', '.join(stages) or 'none'}); derive it from exactly one."
        gap = find_gap(self.kind, self.reference, self.conditions)
        return gap or (True, f"acts on {stages[0]}; {self.kind.law} ({self.kind.reference}).")

    def read_units(self):
        """Every number is a declared parameter whose unit `pint` reads."""
        return read_units(self.kind, self.parameters)

    def flatten(self):
        """Its leaves are its parameters, and a round trip keeps them."""
        effect = self.kind(**{p.field: v for p, v in zip(self.parameters, self.starts[0], strict=True)})
        leaves, structure = jax.tree.flatten(effect)
        if len(leaves) != len(self.parameters):
            return f"it has {len(leaves)} leaves and {len(self.parameters)} parameters."
        again = jax.tree.unflatten(structure, leaves)
        jax.tree.unflatten(structure, [object()] * len(leaves))  # JAX does this too
        same = eqx.tree_equal(effect, again)
        return bool(same), "flatten and unflatten keep it." if same else "flatten and unflatten change it."

    def compare_eager(self):
        """Forces of the compiled trial against the law evaluated operation by operation."""
        law, k = self.build([float(v) for v in self.starts[0]]), 1 % self.records
        conditions, span = self.record(k), self.spans[k]
        trial = self.run_one(law, conditions, span)
        forces = evaluate_path(law, conditions, trial)
        inside = np.asarray((trial.depression > 0) | (trial.time == 0))
        reading = read_gauge(law, trial.true_force, span / STEPS)
        worst = max(measure_difference(np.where(inside, forces.normal, 0.0), trial.true_force),
                    measure_difference(forces.pressure, trial.pressure),
                    measure_difference(reading, trial.normal_force))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def count_traces(self):
        """New values, Python numbers among them, meet the program that is there already."""
        self.run_one(self.build(self.null), self.record(0), self.spans[0])
        before = self.traces
        whole = [int(v) if float(v).is_integer() else float(v) for v in self.null]
        self.run_one(self.build(whole), self.record(0), self.spans[0])
        self.run_one(self.build(np.array(self.starts[-1])), self.record(self.records - 1), self.spans[-1])
        if self.traces > before:
            return "a new value compiles the program anew; `parameter(...)` makes a field an array, which does not."
        return True, "new values meet the program that is there already."

    def find_infinite(self):
        """Readings and derivatives at every start."""
        for values in self.starts:
            trial, slopes = self.at(values)
            where = dict(zip([p.name for p in self.parameters], (float(v) for v in values), strict=True))
            if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(trial)):
                return f"a reading is not finite at {where}."
            if not all(np.isfinite(getattr(slopes, name)).all() for name in _READINGS):
                return f"a derivative is not finite at {where}."
        return True, f"readings and derivatives are finite at {len(self.starts)} starts."

    def compare_loop(self):
        """All records at once against one after the other."""
        values = self.starts[0]
        batch, _ = self.at(values)
        worst = 0.0
        for k in range(self.records):
            one = self.run_one(self.build(values), self.record(k), self.spans[k])
            worst = max(worst, *(measure_difference(getattr(one, n), getattr(batch, n)[k]) for n in _READINGS))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def compare_null(self):
        """Force, pressure and reading with and without the effect, operation by operation, to the last bit."""
        shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in self.parameters]
        for values in itertools.islice(itertools.product(*shapes), 12):
            law = self.build(values)
            for k in range(self.records):
                conditions = self.record(k)
                trial = self.run_one(law, conditions, self.spans[k])
                alone = eqx.tree_at(lambda t: t.states, trial, trial.states[:, :0])
                extended = evaluate_path(law, conditions, trial)
                bare = evaluate_path(ContactLaw(self.reference), conditions, alone)
                read = read_gauge(law, trial.true_force, self.spans[k] / STEPS)
                pairs = {"force": (extended.normal, bare.normal), "drive": (extended.drive, bare.drive),
                         "pressure": (extended.pressure, bare.pressure), "reading": (read, trial.true_force)}
                for name, (a, b) in pairs.items():
                    if not np.array_equal(np.asarray(a), np.asarray(b)):
                        where = ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.parameters, values, strict=True))
                        return f"the {name} changes by up to {np.abs(a - b).max():.3g} [SI] at {where}."
        return True, "force, motion, pressure and reading are those without it, to the last bit."

    def find_slope(self, k: int):
        """Derivative of the readings by one parameter: at the null, or over the starts."""
        one = self.parameters[k]
        scanned = one.kind == "shape" or one.coordinate == "inverse" or one.singular
        points = self.starts if scanned else [self.null]
        if one.kind == "shape":
            points = [np.where(np.arange(len(self.parameters)) == k, v, p)
                      for p in self.starts for v in (one.starts or (one.default,))]
        best = 0.0
        for values in points:
            trial, slopes = self.at(values)
            for name in _READINGS:
                slope, largest = np.asarray(getattr(slopes, name)[k]), np.abs(getattr(self.bare, name)).max()
                if not np.isfinite(slope).all():
                    return f"the derivative of {name} is not finite{'' if scanned else ' at the null'}."
                best = max(best, float(np.abs(slope).max() * one.typical / max(float(largest), 1e-300)))
        place = "over its starts" if scanned else "at its null"
        if best <= _ALIVE:
            remedy = "nothing reads it" if scanned else "let the law start linearly in its amplitude"
            return f"no reading moves with it {place}: {remedy}."
        change = f"{one.typical:g} {one.unit}".rstrip()
        return True, f"a typical change ({change}) moves a reading by {best:.1e} of its largest value {place}."
