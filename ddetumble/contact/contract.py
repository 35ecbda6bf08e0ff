"""The contract of an effect, proved by trial: absent at its null, alive in its amplitudes, compiled = eager.

    print(check_effect(WallStiffness))
    check_effect(MyEffect).require()
"""

import functools
from collections.abc import Mapping, Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .bench import AbstractProof, Readings, prove, set_up
from .clauses import TOLERANCE, EffectReport, measure_difference
from .effect import STAGE_OF, AbstractEffect, AbstractModel, family_of
from .law import Ball, ContactLaw
from .tangential_contract import check_oblique_effect, check_slip_effect
from .torque_contract import check_tumble_effect
from .trial import STEPS, Trial, evaluate_path, read_gauge, try_impact


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
    that `pint` reads, and limits, where they state any, with a reason, around null and starts; its values survive
    flattening; new values do not compile anew; it is finite at its starts;
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
    model = Ball() if reference is None else reference
    return prove(name, lambda: ImpactProof(set_up(effect_class, model, _CONDITIONS, conditions)))


@final
class ImpactProof(AbstractProof):
    """Trial impacts in fixed steps, long enough for the reference model to separate."""

    def __init__(self, bench):
        super().__init__(bench)

        def values_of(values, conditions, spans) -> Trial:
            return jax.vmap(try_impact, in_axes=(None, 0, 0))(bench.build(values), conditions, spans)

        def slopes_of(values, conditions, spans):
            trial, push = jax.linearize(lambda v: values_of(v, conditions, spans), values)
            return trial, jax.vmap(push)(jnp.eye(len(bench.parameters)))

        def one_of(law, conditions, span) -> Trial:
            self.traces += 1
            return try_impact(law, conditions, span)

        self.run_slopes, self.run_one = eqx.filter_jit(slopes_of), eqx.filter_jit(one_of)

    @functools.cached_property
    def spans(self) -> Array:
        """Durations in which the reference model separates, shape (records,) [s], with half as much again to spare."""
        spans = np.full(self.bench.records, 1e-3)
        for _ in range(14):
            trial = _try_references(self.bench.reference, self.bench.conditions, jnp.asarray(spans))
            touching = np.asarray(trial.touching)
            if not touching.any():
                break
            spans = np.where(touching, 2.0 * spans, spans)
        return jnp.asarray(1.5 * spans)

    @functools.cached_property
    def bare(self) -> Readings:
        """The reference model alone, all records."""
        return vars(_try_references(self.bench.reference, self.bench.conditions, self.spans))

    def follow(self, values, k: int) -> Trial:
        """One record, compiled."""
        return self.run_one(self.bench.build(values), self.bench.record(k), self.spans[k])

    def try_one(self, values, k: int) -> Readings:
        """All that a trial holds, by name."""
        return vars(self.follow(values, k))

    def try_all(self, values: Array) -> tuple[Readings, Readings]:
        """All that the trials hold, and the derivatives of what is measured."""
        trial, slopes = self.run_slopes(values, self.bench.conditions, self.spans)
        return vars(trial), {name: getattr(slopes, name) for name in _READINGS}

    def try_bare(self) -> Readings:
        """As `try_all`, without the effect."""
        return self.bare

    def find_gaps(self):
        """As for every effect, and one stage: an effect on impacts may be derived from several."""
        stages = [name for base, name in STAGE_OF if issubclass(self.bench.kind, base)]
        if len(stages) != 1:
            return f"it has {len(stages)} stages ({', '.join(stages) or 'none'}); derive it from exactly one."
        return super().find_gaps()

    def compare_eager(self):
        """Forces of the compiled trial against the law evaluated operation by operation."""
        values, k = [float(v) for v in self.bench.starts[0]], 1 % self.bench.records
        law, trial = self.bench.build(values), self.follow(values, k)
        forces = evaluate_path(law, self.bench.record(k), trial)
        inside = np.asarray((trial.depression > 0) | (trial.time == 0))
        reading = read_gauge(law, trial.true_force, self.spans[k] / STEPS)
        worst = max(measure_difference(np.where(inside, forces.normal, 0.0), trial.true_force),
                    measure_difference(forces.pressure, trial.pressure),
                    measure_difference(reading, trial.normal_force))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def compare_null(self):
        """Force, pressure and reading with and without the effect, operation by operation, to the last bit."""
        for values, k, where in self.bench.nulls():
            law, conditions, trial = self.bench.build(values), self.bench.record(k), self.follow(values, k)
            alone = eqx.tree_at(lambda t: t.states, trial, trial.states[:, :0])
            extended = evaluate_path(law, conditions, trial)
            bare = evaluate_path(ContactLaw(self.bench.reference), conditions, alone)
            read = read_gauge(law, trial.true_force, self.spans[k] / STEPS)
            pairs = {"force": (extended.normal, bare.normal), "drive": (extended.drive, bare.drive),
                     "pressure": (extended.pressure, bare.pressure), "reading": (read, trial.true_force)}
            for name, (a, b) in pairs.items():
                if not np.array_equal(np.asarray(a), np.asarray(b)):
                    return f"the {name} changes by up to {np.abs(a - b).max():.3g} [SI] at {where}."
        return True, "force, motion, pressure and reading are those without it, to the last bit."
