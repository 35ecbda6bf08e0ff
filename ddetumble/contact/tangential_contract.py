"""The contract of an effect on slip records or on the patch of oblique impacts, proved by trial (see `contract`)."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

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
from .effect import AbstractEffect, AbstractModel, parameters_of, stage_of
from .gripping import Striker
from .law import Ball
from .sliding import CoulombFriction, RubberFriction
from .tangential_trial import stroke, try_patch


_CONDITIONS = {"normal_load": (6.0, 14.0, 27.0), "internal_pressure": (0.6e6, 1.1e6, 2.3e6),
               "slip_speed": (0.02, 0.1, 0.4), "sequence": (1.0, 4.0, 9.0)}  # fmt: skip
_OBLIQUE = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34),
            "tangential_speed": (0.1, 0.3, 0.6), "sequence": (1.0, 4.0, 9.0)}  # fmt: skip
_ALIVE = 1e-9


def check_slip_effect(effect_class: type[AbstractEffect], name: str, reference: AbstractModel | None,
                      conditions: Mapping[str, Sequence[float]] | None) -> EffectReport:
    """The clauses of `contract.check_effect` for an effect on slip records."""
    try:
        found = dict(_CONDITIONS) if conditions is None else conditions
        bench = Bench(effect_class, RubberFriction() if reference is None else reference, found, stroke,
                       conditions is None)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    return bench.report(name)


def check_oblique_effect(effect_class: type[AbstractEffect], name: str, reference: AbstractModel | None,
                         conditions: Mapping[str, Sequence[float]] | None) -> EffectReport:
    """The same for an effect on the contact patch of oblique impacts."""
    try:
        model = Striker(Ball(), CoulombFriction()) if reference is None else reference
        found = dict(_OBLIQUE) if conditions is None else conditions
        bench = Bench(effect_class, model, found, try_patch, conditions is None)
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    return bench.report(name)


class Bench:
    """An effect, a reference model, and a trial of a few records on which the effect is proved."""

    def __init__(self, effect_class, reference, conditions, trial, complete):
        self.kind, self.reference, self.parameters = effect_class, reference, parameters_of(effect_class)
        self.trial = trial
        effect_class()  # raises where a method or a default is missing
        if complete:
            conditions |= {need: (1.0, 2.0, 3.0) for need in effect_class.requires
                           if need not in reference.provides and need not in conditions}  # fmt: skip
        self.conditions = {key: jnp.asarray(value, dtype=float) for key, value in conditions.items()}
        self.records = len(next(iter(self.conditions.values())))
        self.null = np.array([p.default for p in self.parameters])
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        self.starts = [np.array(values) for values in itertools.islice(itertools.product(*several), 12)]
        self.traces = 0

        def run(law, conditions) -> Array:
            self.traces += 1
            return self.trial(law, conditions)

        self.run = eqx.filter_jit(run)
        self.run_all = eqx.filter_jit(jax.vmap(self.trial, in_axes=(None, 0)))
        self.run_slopes = eqx.filter_jit(jax.jacfwd(lambda v: jax.vmap(self.trial, (None, 0))(self.build(v),
                                                                                         self.conditions)))

    def report(self, name: str) -> EffectReport:
        """Every clause tried."""
        clauses: list[tuple[str, Callable]] = [
            ("complete", self.find_gaps), ("units", self.read_units), ("compiled = eager", self.compare_eager),
            ("compiles once", self.count_traces), ("finite at its starts", self.find_infinite),
            ("batch = loop", self.compare_loop), ("absent at its null", self.compare_null),
        ]
        clauses += [(f"{one.name} alive", lambda k=k: self.find_slope(k)) for k, one in enumerate(self.parameters)]
        return EffectReport(name, tuple(judge_clause(*clause) for clause in clauses))

    def build(self, values) -> Any:
        """The law with the effect at these field values."""
        return self.reference.extend((self.kind(**{p.field: values[k] for k, p in enumerate(self.parameters)}),))

    def record(self, k: int) -> dict[str, Array]:
        """Conditions of one record."""
        return {name: value[k] for name, value in self.conditions.items()}

    def find_gaps(self):
        """One stage, texts, and a reference model that has what the effect needs."""
        gap = find_gap(self.kind, self.reference, self.conditions)
        return gap or (True, f"acts on {stage_of(self.kind)}; {self.kind.law} ({self.kind.reference}).")

    def read_units(self):
        """Every number is a declared parameter whose unit `pint` reads."""
        return read_units(self.kind, self.parameters)

    def compare_eager(self):
        """The compiled force against the law evaluated operation by operation."""
        law, conditions = self.build([float(v) for v in self.starts[0]]), self.record(1 % self.records)
        worst = measure_difference(self.trial(law, conditions), self.run(law, conditions))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def count_traces(self):
        """New values, Python numbers among them, meet the program that is there already."""
        self.run(self.build(self.null), self.record(0))
        before = self.traces
        whole = [int(v) if float(v).is_integer() else float(v) for v in self.null]
        self.run(self.build(whole), self.record(0))
        self.run(self.build(np.array(self.starts[-1])), self.record(self.records - 1))
        if self.traces > before:
            return "a new value compiles the program anew; `parameter(...)` makes a field an array, which does not."
        return True, "new values meet the program that is there already."

    def find_infinite(self):
        """Forces and derivatives at every start."""
        for values in self.starts:
            where = dict(zip([p.name for p in self.parameters], (float(v) for v in values), strict=True))
            if not np.isfinite(self.run_all(self.build(values), self.conditions)).all():
                return f"what is measured is not finite at {where}."
            if not np.isfinite(self.run_slopes(jnp.asarray(values))).all():
                return f"a derivative is not finite at {where}."
        return True, f"readings and derivatives are finite at {len(self.starts)} starts."

    def compare_loop(self):
        """All records at once against one after the other."""
        law = self.build(self.starts[0])
        batch = self.run_all(law, self.conditions)
        worst = max(measure_difference(self.run(law, self.record(k)), batch[k]) for k in range(self.records))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def compare_null(self):
        """Force with and without the effect, operation by operation, to the last bit."""
        shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in self.parameters]
        for values in itertools.islice(itertools.product(*shapes), 12):
            for k in range(self.records):
                extended = np.asarray(self.trial(self.build(values), self.record(k)))
                bare = np.asarray(self.trial(self.reference.extend(()), self.record(k)))
                if not np.array_equal(extended, bare):
                    where = ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.parameters, values, strict=True))
                    return f"what is measured changes by up to {np.abs(extended - bare).max():.3g} [SI] at {where}."
        return True, "what is measured is that without it, to the last bit."

    def find_slope(self, k: int):
        """Derivative of the force by one parameter: at the null, or over the starts."""
        one = self.parameters[k]
        scanned = one.kind == "shape" or one.singular or one.coordinate == "inverse"
        points = self.starts if scanned else [self.null]
        if one.kind == "shape":
            points = [np.where(np.arange(len(self.parameters)) == k, v, p)
                      for p in self.starts for v in (one.starts or (one.default,))]
        largest = float(np.abs(self.run_all(self.reference.extend(()), self.conditions)).max())
        best, place = 0.0, "over its starts" if scanned else "at its null"
        for values in points:
            slope = np.asarray(self.run_slopes(jnp.asarray(values)))[..., k]
            if not np.isfinite(slope).all():
                return f"a derivative is not finite {place}."
            best = max(best, float(np.abs(slope).max()) * one.typical / max(largest, 1e-300))
        if best <= _ALIVE:
            remedy = "nothing reads it" if scanned else "let the law start linearly in its amplitude"
            return f"what is measured does not move with it {place}: {remedy}."
        return True, (f"a typical change ({one.typical:g} {one.unit}".rstrip()
                      + f") moves what is measured by {best:.1e} of its largest value {place}.")
