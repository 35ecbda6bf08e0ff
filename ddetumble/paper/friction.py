"""A verdict on a campaign that holds friction forces only: laws side by side, each force predicted without itself."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._sentences import say, tell
from ..contact.effect import AbstractEffect, parameters_of, read_field
from ..contact.friction import DIVERGES_ABOVE
from ..contact.sliding import AbstractFriction, CoulombFriction, FrictionLaw, RubberFriction, Slide
from ..families import SLIP
from ..inference.files import make_plain
from ..inference.parameters import ParameterSpace
from .forces import (
    LEVEL,
    AbstractJudgement,
    Forces,
    PeakRow,
    compare_rows,
    decide_verdict,
    fit_linear,
    gather_forces,
    has_power,
    judge_rivals,
    make_interval,
    measure_errors,
    measure_visible,
    pick_helping,
    tabulate,
)
from .peaks import choose_effects


LEAST = 1e-6  # the smallest tan(delta) that is tried: K is a quotient by it, and still finite there
SCALED, RELEASED = "Eq. 8 times one scale, K as the toolkit has it", "Eq. 8, weights of either sign"
SYMBOLS = {"loss_factor": "tan δ", "adhesion": "K tan δ"}


class FrictionBench:
    r"""Friction forces of a reference model with effects, fitted; makes rows.

    The slip term of Eqs. 9 and 10 is off: these forces have no slip. Of the paper's law the products
    $K \tan\delta_L$ (`adhesion`) and $\tan\delta_L$ (`loss_factor`) are the coordinates, in which it is linear.

    Args:
        reference: template of the reference model.
        effects: classes of effects that may be switched on.
        forces: measured, with the conditions `normal_load`, and `internal_pressure` and `slip_speed` where known.
    """

    def __init__(self, reference: AbstractFriction, effects: Sequence[type[AbstractEffect]], forces: Forces):
        self.rubber = isinstance(reference, RubberFriction)
        if self.rubber:
            reference = eqx.tree_at(lambda r: r.slip_scale, reference, jnp.zeros(()))
        self.forces = forces
        conditions = {name: jnp.asarray(value) for name, value in forces.conditions.items()}
        zero = jnp.zeros(len(forces))
        self.slides = Slide(
            slip=zero, slip_speed=conditions.get("slip_speed", zero), normal_load=conditions["normal_load"],
            internal_pressure=conditions.get("internal_pressure", zero), work=zero, time=zero,
            direction=zero + 1.0, conditions=conditions)
        space = ParameterSpace(reference, effects)
        parameters = [slot.parameter for slot in space.slots]
        self.names = tuple("adhesion" if s.name == "adhesion_constant" else s.name for s in space.slots)
        self.free = tuple(name for slot, name in zip(space.slots, self.names, strict=True)
                          if slot.owner is None and slot.parameter.free and name != "slip_scale")
        self.units = {name: p.unit for p, name in zip(parameters, self.names, strict=True)}
        self.start = np.array([p.default for p in parameters])
        self.low = np.array([max(p.bounds[0], p.default) if p.sign > 0 else p.bounds[0] for p in parameters])
        self.high = np.array([min(p.bounds[1], p.default) if p.sign < 0 else p.bounds[1] for p in parameters])
        if self.rubber:
            adhesion, loss = self.names.index("adhesion"), self.names.index("loss_factor")
            self.low[loss] = LEAST
            self.start[adhesion] *= self.start[loss]
        law: FrictionLaw = space.build(jnp.asarray(space.coordinates()))

        def force(x: Array) -> Array:
            if self.rubber:
                x = x.at[adhesion].divide(x[loss])
            # `tree_at` hides an empty tuple of effects, so that it is not asked for.
            built = eqx.tree_at(lambda law: [read_field(part, p.field)
                                             for part in (law.reference, *(law.effects if effects else ()))
                                             for p in parameters_of(part)], law, list(x))
            return jax.vmap(built.force)(self.slides)

        self.predict, self.differentiate = jax.jit(force), jax.jit(jax.jacfwd(force))
        self.fits: dict[str, tuple[np.ndarray, list[int]]] = {}

    def solve(self, label: str, kind: str, free: tuple[str, ...], effects: tuple[str, ...] = ()) -> PeakRow:
        """The row of a fit of `free` within their limits; what sits at a limit does not count as fitted."""
        where = [self.names.index(name) for name in free]
        peaks, weights = self.forces.peaks, self.forces.weights
        x = self._minimise(self.start, where, weights)
        fitted, slopes = np.asarray(self.predict(x)), np.asarray(self.differentiate(x))
        held = np.array([self.predict(self._minimise(x, where, np.where(rest, weights, 0.0)))[k]
                         for k, rest in enumerate(~np.eye(len(peaks), dtype=bool))])
        # A limit of 0 counts as reached within a ten-thousandth.
        stuck = [k for k in where if np.isfinite(self.low[k]) and self.low[k] >= 0.0
                 and x[k] - self.low[k] < 1e-4 * max(abs(x[k]), 1.0)]
        loose = [k for k in where if k not in stuck]
        sd = measure_errors(weights[:, None] * slopes[:, loose], weights * (fitted - peaks))
        self.fits[label] = x, loose
        estimates = {self.names[k]: make_interval(x[k], error, self.units[self.names[k]])
                     for k, error in zip(loose, sd, strict=True)}
        remark = "; ".join(f"{_name(self.names[k])} at its limit, 0" for k in stuck)
        return PeakRow(self.forces, label, kind, effects, len(loose), fitted, held, estimates, True, remark)

    def _minimise(self, x: np.ndarray, where: list[int], weights: np.ndarray) -> np.ndarray:
        """Weighted least squares of the values at `where`; the others stay as they are in `x`, shape (parameters,)."""
        from scipy.optimize import least_squares

        low, high = self.low[where], self.high[where]

        def put(values):
            full = x.copy()
            full[where] = values
            return full

        # The search has to begin off its limits.
        first = np.clip(x[where], low + 1e-3 * np.maximum(1.0, np.abs(np.nan_to_num(low, neginf=0.0))), high)
        found = least_squares(
            lambda v: weights * (np.asarray(self.predict(put(v))) - self.forces.peaks), first, bounds=(low, high),
            xtol=1e-13, ftol=1e-13, gtol=1e-13,
            jac=lambda v: weights[:, None] * np.asarray(  # pyright: ignore[reportArgumentType]
                self.differentiate(put(v)))[:, where])
        return put(found.x)

    def weigh(self) -> list[PeakRow]:
        """The paper's law with everything but tan(delta), which scales it, at the toolkit's values; and with its two
        weights free to be negative."""
        peaks, weights, both = self.forces.peaks, self.forces.weights, ("adhesion", "loss_factor")
        where = [self.names.index(name) for name in both]
        slopes, column = np.asarray(self.differentiate(self.start)), np.asarray(self.predict(self.start))[:, None]
        rows = []
        for label, names, columns in ((SCALED, both[1:], column / self.start[where[1]]),
                                      (RELEASED, both, slopes[:, where])):
            fitted, held = fit_linear(columns, peaks, weights)
            weighted = columns * weights[:, None]
            values = np.linalg.lstsq(weighted, peaks * weights, rcond=None)[0]
            sd = measure_errors(weighted, weights * (fitted - peaks))
            below = [_name(name) for name, value in zip(names, values, strict=True) if value < 0]
            rows.append(PeakRow(self.forces, label, "reading", (), len(names), fitted, held,
                                dict(zip(names, map(make_interval, values, sd), strict=True)), not below,
                                f"{' and '.join(below)} below 0" if below else ""))
        return rows

    def separate(self) -> tuple[float, float, float]:
        """Whether K and tan(delta) can be told apart: see `FrictionJudgement.separation`."""
        slopes, loss = np.asarray(self.differentiate(self.start)) * self.start, self.names.index("loss_factor")
        by_adhesion = slopes[:, self.names.index("adhesion")]
        # By ln K, and by ln tan(delta), which scales both parts of Eq. 8.
        columns = np.column_stack([by_adhesion, by_adhesion + slopes[:, loss]]) / self.forces.peaks[:, None]
        # cov = (J'J)^-1, so that the correlation is minus the cosine between the columns.
        cosine = columns[:, 0] @ columns[:, 1] / np.prod(np.linalg.norm(columns, axis=0))
        large, small = np.linalg.svd(columns, compute_uv=False)
        return float(large), float(small), -float(cosine)

    def visible(self, base: PeakRow, effect: type[AbstractEffect]) -> float:
        """Share of an effect's signature at its null that survives what the reference model can do."""
        x, loose = self.fits[base.label]
        slopes = np.asarray(self.differentiate(x)) / self.forces.peaks[:, None]
        return measure_visible(slopes[:, loose], slopes[:, self.names.index(_amplitudes(effect)[0])])[0]


def _name(parameter: str) -> str:
    return SYMBOLS.get(parameter, parameter.rsplit(".", 1)[-1])


def _amplitudes(effect: type[AbstractEffect]) -> tuple[str, ...]:
    return tuple(f"{effect.id}.{p.name}" for p in parameters_of(effect) if p.kind == "amplitude")


@final
@dc.dataclass(frozen=True, kw_only=True)
class FrictionJudgement(AbstractJudgement):
    """What friction forces alone say; `pairs` hold every row against the constant coefficient.

    Attributes:
        constant: row of a constant coefficient.
        separation: of Eq. 8's K and tan(delta) at the toolkit's values: the two singular values of the derivatives by
            their logarithms, and the correlation of their estimates [-]; empty for another reference model.
    """

    family: ClassVar[str] = SLIP.name
    constant: PeakRow
    separation: tuple[float, ...]

    @property
    def ratio(self) -> tuple[float, float]:
        """Mean of friction over load and its standard deviation between records [-]."""
        ratio = self.peaks / self.forces.x
        return float(np.mean(ratio)), float(np.std(ratio, ddof=1)) if len(ratio) > 1 else float("nan")

    def table(self):
        """All rows side by side, a pandas data frame."""
        return tabulate(self.rows, self.constant, "behind a constant coefficient [%]")

    def to_dict(self) -> dict[str, Any]:
        """The fields of `result.json`."""
        found = super().to_dict()
        for line, row in zip(found["rows"], self.rows, strict=True):
            line |= make_plain({"worst": row.worst_fit, "estimates": row.estimates})
        mean, deviation = self.ratio
        return {**found, **make_plain({"friction_over_load": {"mean": mean, "deviation": deviation},
                                       "separation": self.separation})}


def judge_friction(
    conditions: Mapping[str, np.ndarray], peaks: np.ndarray, *, printed: np.ndarray | None = None,
    sd: np.ndarray | None = None, campaign: str = "", model: str = "paper", reference: AbstractFriction | None = None,
    effects: Sequence[type[AbstractEffect]] | None = None, assumed: Sequence[str] = (), level: float = LEVEL,
) -> FrictionJudgement:
    """Compare and judge on friction forces alone, with each record left out in turn.

    Args:
        conditions: arrays of shape (records,), SI: `normal_load`, where known `internal_pressure`, `slip_speed`
            and others.
        peaks: measured friction force, shape (records,) [N].
        printed: what the source's own model predicted [N], if anything.
        sd: standard deviation of each force [N], if stated; else the scatter about a low polynomial is taken.
        campaign: its name.
        model: name of the reference model.
        reference: the reference model (default: Eq. 8; the slip term needs a slip, which forces alone do not have).
        effects: classes of candidate effects (default: the catalogue for slip).
        assumed: names of conditions that are assumptions.
        level: of the tests.

    Returns:
        A `FrictionJudgement`.
    """
    from ..effects.slip import SLIP

    reference = RubberFriction() if reference is None else reference
    forces = gather_forces(conditions, "normal_load", peaks, sd)
    chosen, left_out = choose_effects(SLIP if effects is None else effects, reference, forces.conditions)
    rivals = judge_rivals(forces, printed)
    if printed is not None:
        column = np.asarray(printed, float)
        rivals[0] = dc.replace(rivals[0], label="printed column × one factor")
        rivals.insert(0, PeakRow(forces, "printed column as it stands", "printed", (), 0, column, column))
    bench = FrictionBench(reference, chosen, forces)
    constant = FrictionBench(CoulombFriction(), (), forces).solve(
        "constant coefficient", "constant", ("friction_coefficient",))
    name = "Eq. 8, K and tan δ fitted" if bench.rubber else "our model"
    base = bench.solve(name, "reference", bench.free)
    weights = bench.weigh() if bench.rubber else ()
    singles = [bench.solve(f"{name} + {effect.id}", "effect", (*bench.free, *_amplitudes(effect)), (effect.id,))
               for effect in chosen]
    steps = (base, *(pick_helping(base, singles, level)[:1] if base.p_value < level else ()))
    able = any(has_power(bench.visible(base, effect), base, level) for effect in chosen)
    rows = (*rivals, constant, *weights, base, *singles)
    judged = FrictionJudgement(
        campaign=campaign, model=model, verdict=decide_verdict(steps, able, level), forces=forces, rows=rows,
        steps=steps, reference=base, constant=constant, polynomial=rivals[-1],
        pairs=tuple(compare_rows(row, constant) for row in rows if row is not constant), left_out=left_out,
        separation=bench.separate() if bench.rubber else (), level=level)
    words = {"normal_load": "loads", "internal_pressure": "pressures", "slip_speed": "slip speeds"}
    released = next((row for row in rows if row.label == RELEASED and "loss_factor" not in base.estimates), None)
    notes = tell("peaks.friction_notes", j=judged, assumed=[words.get(one, one) for one in assumed],
                 outside=int(np.sum(forces.x > DIVERGES_ABOVE)), diverges=DIVERGES_ABOVE,
                 released=released and released.estimates["loss_factor"], best=describe_best(judged))
    return dc.replace(judged, sentence=say("peaks.friction", j=judged), notes=tuple(notes))


def describe_best(judged: FrictionJudgement) -> str:
    """Which model is best on left-out forces, and whether that is more than chance."""
    rows = [row for row in judged.rows if row.physical and np.isfinite(row.heldout)]
    best, gaps = min(rows, key=lambda row: row.heldout), {pair.first: pair for pair in judged.pairs}
    return say("peaks.best", plain=judged.constant, best=best, gap=gaps.get(best.label),
               better=[name for name, gap in gaps.items() if gap.told and gap.difference < 0],
               worse=[name for name, gap in gaps.items() if gap.told and gap.difference > 0])
