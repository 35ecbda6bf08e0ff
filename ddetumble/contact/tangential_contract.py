"""The contract of an effect on slip records or on the patch of oblique impacts, proved by trial (see `contract`)."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .bench import AbstractProof, Bench, Readings, prove, set_up
from .clauses import TOLERANCE, EffectReport, measure_difference
from .effect import AbstractEffect, AbstractModel
from .gripping import Striker
from .law import Ball
from .sliding import CoulombFriction, RubberFriction
from .tangential_trial import stroke, try_patch


_CONDITIONS = {"normal_load": (6.0, 14.0, 27.0), "internal_pressure": (0.6e6, 1.1e6, 2.3e6),
               "slip_speed": (0.02, 0.1, 0.4), "sequence": (1.0, 4.0, 9.0)}  # fmt: skip
_OBLIQUE = {"initial_pressure": (0.6e6, 1.1e6, 2.3e6), "approach_speed": (0.25, 0.5, 0.34),
            "tangential_speed": (0.1, 0.3, 0.6), "sequence": (1.0, 4.0, 9.0)}  # fmt: skip
_READING = "what is measured"


def check_slip_effect(effect_class: type[AbstractEffect], name: str, reference: AbstractModel | None,
                      conditions: Mapping[str, Sequence[float]] | None) -> EffectReport:
    """The clauses of `contract.check_effect` for an effect on slip records."""
    model = RubberFriction() if reference is None else reference
    return prove(name, lambda: CourseProof(set_up(effect_class, model, _CONDITIONS, conditions), stroke))


def check_oblique_effect(effect_class: type[AbstractEffect], name: str, reference: AbstractModel | None,
                         conditions: Mapping[str, Sequence[float]] | None) -> EffectReport:
    """The same for an effect on the contact patch of oblique impacts."""
    def make():
        model = Striker(Ball(), CoulombFriction()) if reference is None else reference
        return CourseProof(set_up(effect_class, model, _OBLIQUE, conditions), try_patch)

    return prove(name, make)


@final
class CourseProof(AbstractProof):
    """Trials on a prescribed course, from which one row of readings comes.

    Attributes:
        trial: function of law and conditions of one record that gives the readings.
    """

    def __init__(self, bench: Bench, trial: Callable[[Any, Mapping[str, Array]], Array]):
        super().__init__(bench)
        self.trial = trial

        def one_of(law, conditions) -> Array:
            self.traces += 1
            return trial(law, conditions)

        def all_of(law) -> Array:
            return jax.vmap(trial, in_axes=(None, 0))(law, bench.conditions)

        def slopes_of(values):
            readings, push = jax.linearize(lambda v: all_of(bench.build(v)), values)
            return readings, jax.vmap(push)(jnp.eye(len(bench.parameters)))

        self.run_one, self.run_all = eqx.filter_jit(one_of), eqx.filter_jit(all_of)
        self.run_slopes = eqx.filter_jit(slopes_of)

    def try_one(self, values, k: int) -> Readings:
        """One record, compiled."""
        return {_READING: self.run_one(self.bench.build(values), self.bench.record(k))}

    def try_all(self, values: Array) -> tuple[Readings, Readings]:
        """All records and their derivatives."""
        readings, slopes = self.run_slopes(values)
        return {_READING: readings}, {_READING: slopes}

    def try_bare(self) -> Readings:
        """All records without the effect."""
        return {_READING: self.run_all(self.bench.reference.extend(()))}

    def compare_eager(self):
        """The compiled readings against the law evaluated operation by operation."""
        values, k = [float(v) for v in self.bench.starts[0]], 1 % self.bench.records
        eager = self.trial(self.bench.build(values), self.bench.record(k))
        worst = measure_difference(eager, self.try_one(values, k)[_READING])
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def compare_null(self):
        """Readings with and without the effect, operation by operation, to the last bit."""
        for values, k, where in self.bench.nulls():
            extended = np.asarray(self.trial(self.bench.build(values), self.bench.record(k)))
            bare = np.asarray(self.trial(self.bench.reference.extend(()), self.bench.record(k)))
            if not np.array_equal(extended, bare):
                return f"what is measured changes by up to {np.abs(extended - bare).max():.3g} [SI] at {where}."
        return True, "what is measured is that without it, to the last bit."
