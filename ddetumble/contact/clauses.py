"""Clauses of the contract of an effect: what each found, and the report of all."""

import dataclasses as dc
import functools
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from .._errors import InputError
from .effect import Parameter


TOLERANCE = 1e-10  # compiled against eager, batch against loop, relative to the largest value


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


def judge_clause(name: str, clause: Callable[[], str | tuple[bool, str]]) -> Check:
    """Try one clause: a text is what is wrong, a pair says itself whether it holds; an exception breaks it."""
    try:
        found = clause()
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


@functools.cache
def _registry():
    import pint

    return pint.UnitRegistry()


def check_unit_text(one: Parameter, parameters: Sequence[Parameter]) -> str:
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


def check_limits(parameters: Sequence[Parameter]) -> str | tuple[bool, str]:
    """Whether what physics allows is a range with a reason that holds the null and all starts of every parameter."""
    stated = []
    for one in parameters:
        low, high = one.limits
        if not low < high:
            return f"limits of {one.name} begin at {low:g} and end at {high:g}: give the lower first."
        if (low, high) == (-np.inf, np.inf):
            continue
        if not one.limits_reason.strip():
            return f"limits of {one.name} have no reason: say why in `limits_reason`."
        values = [one.default, *one.starts]
        if one.coordinate == "inverse":
            values = [1.0 / value if value else np.inf for value in values]
        outside = [value for value in values if not low <= value <= high]
        if outside:
            return f"limits of {one.name} leave out {outside[0]:g}, its null or a start of its fits."
        stated.append(f"{one.name} {low:g} to {high:g}")
    return True, (", ".join(stated) or "none stated") + "."


def find_gap(kind: type, reference: Any, conditions: Any) -> str:
    """What is missing of an effect: a text, or what it requires of the reference model; empty where nothing is."""
    for field in ("id", "law", "reference"):
        if not str(getattr(kind, field, "")).strip():
            return f"`{field}` is empty."
    for need in getattr(kind, "requires", ()):
        if need not in reference.provides and need not in conditions:
            return f"it requires {need!r}, which {type(reference).__name__} and the conditions do not provide."
    return ""


def read_units(kind: type, parameters: Sequence[Parameter]) -> str | tuple[bool, str]:
    """Whether every number of an effect is a declared parameter whose unit `pint` reads."""
    declared = {p.field for p in parameters}
    fields = dc.fields(kind)
    undeclared = [f.name for f in fields if f.name not in declared and not f.metadata.get("static")]
    if undeclared:
        return f"`{undeclared[0]}` has no unit: declare it by `parameter(unit, ...)` or `eqx.field(static=True)`."
    if not parameters:
        return "it has no parameter: declare its amplitude by `parameter(unit, ...)`."
    problems = [text for one in parameters if (text := check_unit_text(one, parameters))]
    return problems[0] if problems else (True, ", ".join(f"{p.name} [{p.unit or '1'}]" for p in parameters) + ".")
