"""Fits of the friction law to friction forces alone: bounded least squares, each record left out in turn."""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..contact.effect import AbstractEffect, parameters_of
from ..contact.sliding import AbstractFriction, FrictionLaw, RubberFriction, Slide


LEAST = 1e-6  # the smallest tan(delta) that is tried: K is a quotient by it


@dc.dataclass(frozen=True)
class ForceFit:
    """A friction law fitted to forces.

    Attributes:
        names: of what was fitted; of the paper's law `adhesion` is the product K tan(delta).
        values: fitted values, shape (names,).
        sd: standard errors from the residuals, shape (names,); nan where a value sits at its limit.
        fitted: shape (records,) [N].
        held: each record by a fit without it, shape (records,) [N].
        bound: names of what sits at its limit.
    """

    names: tuple[str, ...]
    values: np.ndarray
    sd: np.ndarray
    fitted: np.ndarray
    held: np.ndarray
    bound: tuple[str, ...]


class FrictionProgram:
    r"""Friction forces of a reference model with effects, and their derivatives.

    The slip term of Eqs. 9 and 10 is off: these forces have no slip. Of the paper's law the products
    $K \tan\delta_L$ (`adhesion`) and $\tan\delta_L$ (`loss_factor`) are the coordinates, in which it is linear.

    Args:
        reference: template of the reference model.
        effects: classes of effects that may be switched on.
        conditions: arrays of shape (records,), SI: `normal_load`, and `internal_pressure` and `slip_speed` where known.
    """

    def __init__(self, reference: AbstractFriction, effects: Sequence[type[AbstractEffect]],
                 conditions: Mapping[str, np.ndarray]):
        if isinstance(reference, RubberFriction):
            reference = eqx.tree_at(lambda r: r.slip_scale, reference, jnp.zeros(()))
        self.reference, self.effects = reference, tuple(effects)
        loads = jnp.asarray(conditions["normal_load"], float)
        zero = jnp.zeros_like(loads)
        self.slides = Slide(
            slip=zero, slip_speed=jnp.asarray(conditions.get("slip_speed", zero), float), normal_load=loads,
            internal_pressure=jnp.asarray(conditions.get("internal_pressure", zero), float), work=zero, time=zero,
            direction=jnp.ones_like(loads), conditions={n: jnp.asarray(v, float) for n, v in conditions.items()})
        own = [(p, p.name) for p in parameters_of(reference)]
        more = [(p, f"{effect.id}.{p.name}") for effect in self.effects for p in parameters_of(effect)]
        self.parameters = tuple(p for p, _ in own + more)
        self.names = tuple("adhesion" if name == "adhesion_constant" else name for _, name in own + more)
        self.units = {name: p.unit for p, name in zip(self.parameters, self.names, strict=True)}
        self.start = np.array([float(getattr(reference, p.field)) for p, _ in own] + [p.default for p, _ in more])
        self.low = np.array([max(p.bounds[0], p.default) if p.sign > 0 else p.bounds[0] for p in self.parameters])
        self.high = np.array([min(p.bounds[1], p.default) if p.sign < 0 else p.bounds[1] for p in self.parameters])
        self.rubber = isinstance(reference, RubberFriction)
        if self.rubber:
            self.low[self.names.index("loss_factor")] = LEAST
            self.start[self.names.index("adhesion")] *= self.start[self.names.index("loss_factor")]
        self._predict = jax.jit(self._force)
        self._slopes = jax.jit(jax.jacfwd(self._force))

    def free_reference(self) -> tuple[str, ...]:
        """Names of the reference model's own free parameters, without the slip term's factor."""
        count = len(parameters_of(self.reference))
        return tuple(name for p, name in zip(self.parameters[:count], self.names[:count], strict=True)
                     if p.free and name != "slip_scale")

    def build(self, x: Array) -> FrictionLaw:
        """The law at values `x`, shape (parameters,)."""
        fields, count = parameters_of(self.reference), len(parameters_of(self.reference))
        values = [x[k] for k in range(count)]
        if self.rubber:
            values[self.names.index("adhesion")] = values[0] / values[self.names.index("loss_factor")]
        reference = eqx.tree_at(lambda r: [getattr(r, p.field) for p in fields], self.reference, values)
        effects = []
        for effect in self.effects:
            own = parameters_of(effect)
            values = {p.field: x[count + k] for k, p in enumerate(own)}
            effects.append(effect(**values))  # pyright: ignore[reportArgumentType]  # its fields, not its texts
            count += len(own)
        return FrictionLaw(reference, tuple(effects))

    def predict(self, x: np.ndarray) -> np.ndarray:
        """Forces at values `x`, shape (records,) [N]."""
        return np.asarray(self._predict(x))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the forces by the values, shape (records, parameters)."""
        return np.asarray(self._slopes(x))

    def _force(self, x: Array) -> Array:
        law = self.build(x)
        return jax.vmap(law.force)(self.slides)

    def fit(self, free: Sequence[str], peaks: np.ndarray, weights: np.ndarray,
            start: Mapping[str, float] | None = None) -> ForceFit:
        """Weighted least squares within every parameter's limits, on all records and without each in turn.

        Args:
            free: names of what is fitted; all else keeps its default, or the value that `start` gives it.
            peaks: measured forces, shape (records,) [N].
            weights: shape (records,) [1/N].
            start: values by name.
        """
        x = self.start.copy()
        for name, value in (start or {}).items():
            x[self.names.index(name)] = value
        where = [self.names.index(name) for name in free]
        every = self._solve(x, where, peaks, weights)
        fitted = self.predict(every)
        held = np.empty(len(peaks))
        for k in range(len(peaks)):
            rest = np.where(np.arange(len(peaks)) == k, 0.0, weights)
            held[k] = self.predict(self._solve(every, where, peaks, rest))[k]
        values = every[where]
        reach = 1e-4 * np.maximum(np.abs(values), 1.0)
        stuck = (values - self.low[where] < reach) & np.isfinite(self.low[where]) & (self.low[where] >= 0.0)
        sd = np.full(len(where), np.nan)
        sd[~stuck] = self._errors(every, [i for i, s in zip(where, stuck, strict=True) if not s], fitted, peaks,
                                  weights)
        bound = tuple(name for name, s in zip(free, stuck, strict=True) if s)
        return ForceFit(tuple(free), values, sd, fitted, held, bound)

    def _solve(self, x: np.ndarray, where: list[int], peaks: np.ndarray, weights: np.ndarray) -> np.ndarray:
        from scipy.optimize import least_squares

        low, high = self.low[where], self.high[where]

        def put(values):
            full = x.copy()
            full[where] = values
            return full

        first = np.clip(x[where], low + 1e-3 * np.maximum(1.0, np.abs(np.nan_to_num(low, neginf=0.0))), high)
        found = least_squares(
            lambda v: weights * (self.predict(put(v)) - peaks), first, bounds=(low, high), xtol=1e-13,
            ftol=1e-13, gtol=1e-13,
            jac=lambda v: weights[:, None] * self.slopes(put(v))[:, where])  # pyright: ignore[reportArgumentType]
        return put(found.x)

    def _errors(self, x: np.ndarray, where: list[int], fitted: np.ndarray, peaks: np.ndarray,
                weights: np.ndarray) -> np.ndarray:
        """Standard errors of what moves freely, the size of the errors taken from the residuals."""
        columns = weights[:, None] * self.slopes(x)[:, where]
        size = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(size > 0, size, 1.0)
        left = max(len(peaks) - len(where), 1)
        variance = np.sum((weights * (fitted - peaks)) ** 2) / left
        return np.sqrt(variance * np.diag(np.linalg.pinv(unit.T @ unit))) / np.where(size > 0, size, np.nan)

    def separate(self, first: str, second: str, weights: np.ndarray) -> tuple[np.ndarray, float]:
        """Singular values and correlation of two parameters of the reference model as they are declared, at defaults.

        Args:
            first, second: field names of the reference model.
            weights: shape (records,) [1/N].

        Returns:
            Singular values, shape (2,), of the derivatives of the weighted forces by the logarithms of the two, and the
            correlation of their estimates [-].
        """
        def force(logs):
            law = FrictionLaw(eqx.tree_at(lambda r: [getattr(r, first), getattr(r, second)], self.reference,
                                          [jnp.exp(logs[0]), jnp.exp(logs[1])]))
            return jax.vmap(law.force)(self.slides)

        start = jnp.log(jnp.stack([getattr(self.reference, first), getattr(self.reference, second)]))
        columns = weights[:, None] * np.asarray(jax.jacfwd(force)(start))
        # cov = (J'J)^-1, so that the correlation is minus the cosine between the columns.
        cosine = columns[:, 0] @ columns[:, 1] / np.prod(np.linalg.norm(columns, axis=0))
        return np.linalg.svd(columns, compute_uv=False), -float(cosine)
