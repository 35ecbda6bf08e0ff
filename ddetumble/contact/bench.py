"""What all proofs of an effect's contract share: the effect on its reference model, a few records, and the clauses."""

import abc
import dataclasses as dc
import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
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
    check_limits,
    explain_error,
    find_gap,
    judge_clause,
    measure_difference,
    read_units,
)
from .effect import AbstractEffect, Parameter, parameters_of, stage_of


MOST = 12  # combinations of starts that are tried
_ALIVE = 1e-9  # smallest change of a reading by a typical change of a parameter, relative to the largest reading
_MODELS = ("gas", "geometry", "damping", "rubber")  # what only a reference model can provide

Readings = Mapping[str, Array]


@dc.dataclass(frozen=True)
class Bench:
    """An effect, a reference model, and the records on which the effect is tried.

    Attributes:
        kind: class of the effect.
        reference: the model that it extends.
        parameters: of the effect.
        conditions: of the records by name, SI, each shape (records,).
    """

    kind: Any
    reference: Any
    parameters: tuple[Parameter, ...]
    conditions: Mapping[str, Array]

    @property
    def records(self) -> int:
        """How many there are."""
        return len(next(iter(self.conditions.values())))

    @property
    def null(self) -> np.ndarray:
        """The parameters' defaults."""
        return np.array([p.default for p in self.parameters])

    @functools.cached_property
    def starts(self) -> list[np.ndarray]:
        """All combinations of the parameters' starts, at most a dozen."""
        several = [p.starts or (p.default + 0.3 * p.typical,) for p in self.parameters]
        return [np.array(values) for values in itertools.islice(itertools.product(*several), MOST)]

    def build(self, values: Any) -> Any:
        """The law with the effect at these field values."""
        return self.reference.extend((self.kind(**{p.field: values[k] for k, p in enumerate(self.parameters)}),))

    def record(self, k: int) -> dict[str, Array]:
        """Conditions of one record."""
        return {name: value[k] for name, value in self.conditions.items()}

    def nulls(self) -> Iterator[tuple[tuple[float, ...], int, str]]:
        """Values at which the effect is absent, whatever its shape parameters, a record, and the values in words."""
        shapes = [(p.default, *p.starts) if p.kind == "shape" else (p.default,) for p in self.parameters]
        for values in itertools.islice(itertools.product(*shapes), MOST):
            where = ", ".join(f"{p.name} = {v:g}" for p, v in zip(self.parameters, values, strict=True))
            for k in range(self.records):
                yield values, k, where


def set_up(kind: Any, reference: Any, usual: Mapping[str, Sequence[float]],
           conditions: Mapping[str, Sequence[float]] | None) -> Bench:
    """A bench; nothing is compiled.

    Args:
        kind: class of the effect.
        reference: the model that it extends.
        usual: conditions where none are given; whatever else the effect requires of a record is added.
        conditions: of a few records, each shape (records,).
    """
    if not (isinstance(kind, type) and issubclass(kind, AbstractEffect)):
        raise TypeError("an effect is a class derived from one of the stages in ddetumble.contact.effect.")
    parameters = parameters_of(kind)
    kind()  # pyright: ignore[reportCallIssue]  # raises where a method or a default is missing
    if conditions is None:
        provided = {*_MODELS, *reference.provides, *usual}
        conditions = {**usual, **{need: (1.0, 2.0, 3.0) for need in kind.requires if need not in provided}}
    return Bench(kind, reference, parameters,
                 {key: jnp.asarray(value, dtype=float) for key, value in conditions.items()})


class AbstractProof(abc.ABC):
    """Trials on a bench, and the clauses judged by them; programs are compiled when they are first needed.

    Attributes:
        bench: the effect and its records.
        traces: how often the program of one record has been traced; `try_one` counts it.
    """

    def __init__(self, bench: Bench):
        self.bench, self.traces = bench, 0
        self._seen: dict[tuple[float, ...], tuple[Readings, Readings]] = {}

    @abc.abstractmethod
    def try_one(self, values: Any, k: int) -> Readings:
        """Readings of record `k` by the compiled program."""

    @abc.abstractmethod
    def try_all(self, values: Array) -> tuple[Readings, Readings]:
        """Readings of all records, and those among them that are differentiated, shape (parameters, records, ...)."""

    @abc.abstractmethod
    def try_bare(self) -> Readings:
        """Readings of all records by the reference model alone."""

    @abc.abstractmethod
    def compare_eager(self) -> str | tuple[bool, str]:
        """Readings of the compiled program against the law evaluated operation by operation."""

    @abc.abstractmethod
    def compare_null(self) -> str | tuple[bool, str]:
        """Readings with and without the effect, operation by operation, to the last bit."""

    def at(self, values: Any) -> tuple[Readings, Readings]:
        """`try_all`, once for all clauses."""
        key = tuple(float(v) for v in values)
        if key not in self._seen:
            self._seen[key] = self.try_all(jnp.asarray(key))
        return self._seen[key]

    def find_gaps(self):
        """Stage, texts, and a reference model that has what the effect needs."""
        kind = self.bench.kind
        gap = find_gap(kind, self.bench.reference, self.bench.conditions)
        return gap or (True, f"acts on {stage_of(kind)}; {kind.law} ({kind.reference}).")

    def read_units(self):
        """Every number is a declared parameter whose unit `pint` reads."""
        return read_units(self.bench.kind, self.bench.parameters)

    def flatten(self):
        """Its leaves are its parameters, and a round trip keeps them."""
        parameters = self.bench.parameters
        effect = self.bench.kind(**{p.field: v for p, v in zip(parameters, self.bench.starts[0], strict=True)})
        leaves, structure = jax.tree.flatten(effect)
        if len(leaves) != len(parameters):
            return f"it has {len(leaves)} leaves and {len(parameters)} parameters."
        again = jax.tree.unflatten(structure, leaves)
        jax.tree.unflatten(structure, [object()] * len(leaves))  # JAX does this too
        same = eqx.tree_equal(effect, again)
        return bool(same), "flatten and unflatten keep it." if same else "flatten and unflatten change it."

    def count_traces(self):
        """New values, Python numbers among them, meet the program that is there already."""
        bench = self.bench
        self.try_one(bench.null, 0)
        before = self.traces
        self.try_one([int(v) if float(v).is_integer() else float(v) for v in bench.null], 0)
        self.try_one(bench.starts[-1], bench.records - 1)
        if self.traces > before:
            return "a new value compiles the program anew; `parameter(...)` makes a field an array, which does not."
        return True, "new values meet the program that is there already."

    def find_infinite(self):
        """Readings and derivatives at every start."""
        for values in self.bench.starts:
            readings, slopes = self.at(values)
            where = dict(zip([p.name for p in self.bench.parameters], (float(v) for v in values), strict=True))
            if not all(np.isfinite(value).all() for value in readings.values()):
                return f"a reading is not finite at {where}."
            if not all(np.isfinite(value).all() for value in slopes.values()):
                return f"a derivative is not finite at {where}."
        return True, f"readings and derivatives are finite at {len(self.bench.starts)} starts."

    def compare_loop(self):
        """All records at once against one after the other."""
        values = self.bench.starts[0]
        batch, slopes = self.at(values)
        worst = 0.0
        for k in range(self.bench.records):
            one = self.try_one(values, k)
            worst = max(worst, *(measure_difference(one[name], batch[name][k]) for name in slopes))
        return worst <= TOLERANCE, f"they differ by {worst:.1e} of the largest value."

    def find_slope(self, k: int):
        """Derivative of the readings by one parameter: at the null, or over the starts."""
        bench, one = self.bench, self.bench.parameters[k]
        scanned = one.kind == "shape" or one.coordinate == "inverse" or one.singular
        points = bench.starts if scanned else [bench.null]
        if one.kind == "shape":
            points = [np.where(np.arange(len(bench.parameters)) == k, v, p)
                      for p in bench.starts for v in (one.starts or (one.default,))]
        bare, best = self.try_bare(), 0.0
        for values in points:
            for name, slopes in self.at(values)[1].items():
                slope, largest = np.asarray(slopes[k]), float(np.abs(bare[name]).max())
                if not np.isfinite(slope).all():
                    return f"the derivative of {name} is not finite{'' if scanned else ' at the null'}."
                best = max(best, float(np.abs(slope).max() * one.typical / max(largest, 1e-300)))
        place = "over its starts" if scanned else "at its null"
        if best <= _ALIVE:
            remedy = "nothing reads it" if scanned else "let the law start linearly in its amplitude"
            return f"no reading moves with it {place}: {remedy}."
        change = f"{one.typical:g} {one.unit}".rstrip()
        return True, f"a typical change ({change}) moves a reading by {best:.1e} of its largest value {place}."


def prove(name: str, make: Callable[[], AbstractProof]) -> EffectReport:
    """Try every clause of the contract.

    Args:
        name: of the effect, for the report.
        make: sets the proof up; where that fails the effect is not complete.
    """
    try:
        proof = make()
    except Exception as error:
        return EffectReport(name, (Check("complete", False, explain_error(error)),))
    clauses: list[tuple[str, Callable[[], str | tuple[bool, str]]]] = [
        ("complete", proof.find_gaps), ("units", proof.read_units),
        ("limits", lambda: check_limits(proof.bench.parameters)), ("flattens", proof.flatten),
        ("compiled = eager", proof.compare_eager), ("compiles once", proof.count_traces),
        ("finite at its starts", proof.find_infinite), ("batch = loop", proof.compare_loop),
        ("absent at its null", proof.compare_null),
    ]
    clauses += [(f"{one.name} alive", functools.partial(proof.find_slope, k))
                for k, one in enumerate(proof.bench.parameters)]
    return EffectReport(name, tuple(judge_clause(*clause) for clause in clauses))
