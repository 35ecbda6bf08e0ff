"""What a missing force may depend on in a campaign: variables with the range visited, directions, knots."""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline

from ...effects.free import COUNT, FORMS, PLAN, Ground, blank_plan
from ...inference.problem import Solution
from ...inference.stack import Records


FINEST = {"depression": 18, "depression_rate": 12, "time": 18, "slip": 45, "angular_speed": 12,
          "angular_velocity_z": 12, "phase": 18}
USUAL = 18  # of a variable of the user's own
FEW = 4  # intervals over a condition, which has few levels
DEGREE = 3
FLAT = 1e-4  # what is left of the roughness penalty for a straight line
APART = 0.02  # levels of a condition that differ by less are one


@dc.dataclass(frozen=True)
class Term:
    """A missing force of one variable."""

    variable: str  # of the state, or a condition
    way: str  # name of the direction: `force`, `share`, `x`, `torque`, ...
    parts: tuple[str, ...]  # one name a function of the variable: `` where one holds for all, else the phases or axes
    directions: np.ndarray  # of every part, shape (parts, directions)
    low: float  # range over which the variable was visited, SI
    high: float
    finest: int  # intervals at most, all parts together fitting into one program
    condition: bool  # whether it is a condition

    @property
    def scale(self) -> float:
        """Largest size of the variable, SI: positive, whatever its sign."""
        return max(abs(self.low), abs(self.high))

    @property
    def name(self) -> str:
        """Unique among the terms of a campaign."""
        return f"{self.way} over {self.variable}" + (f" ({' and '.join(self.parts)} apart)" if self.parts[0] else "")

    def size(self, intervals: int) -> int:
        """How many splines it takes."""
        return len(self.parts) * (intervals + DEGREE)


def list_terms(ground: Ground, conditions: Mapping[str, np.ndarray], ranges: Mapping[str, tuple[float, float]],
               backward: bool, reference: float) -> list[Term]:
    """Terms that a campaign could show.

    Args:
        ground: of their family.
        conditions: of the records, by name, shape (records,).
        ranges: of the variables of the state.
        backward: whether both phases were visited (strokes of slip records).
        reference: of the forces of which a direction is a share: at it a share's coefficient is in units of the force.
    """
    unit = {name: np.eye(len(ground.directions))[k] / (reference if name in ground.shares else 1.0)
            for k, name in enumerate(ground.directions)}
    ways: list[tuple[str, tuple[str, ...], np.ndarray]] = []  # name, parts, directions of the parts
    for way, gates in ground.gates.items():
        own = np.stack([unit[gate] for gate in gates])
        whole = (way, ("",), own.sum(axis=0, keepdims=True))
        apart = (way, tuple(gate.split()[-1] for gate in gates), own)
        if ground.unit == "N":
            ways += [whole, apart] if backward else [whole]
        else:
            ways += [apart, whole] if way == "drag" else [apart]
            ways += [(f"{way} about {gate}" if way == "torque" else gate, ("",), unit[gate][None]) for gate in gates]
    found = []
    for variable in ground.variables:
        (low, high), finest = ranges[variable], FINEST.get(variable, USUAL)
        for way, parts, directions in ways if high > low else []:
            fits = [m for m in range(3, finest + 1) if finest % m == 0 and len(parts) * (m + DEGREE) <= COUNT]
            phased = set(parts) & {"loading", "unloading"}
            if fits and not (variable in ("depression_rate", "time") and phased):  # these tell the phases apart
                found.append(Term(variable, way, parts, directions, low, high, max(fits), False))
    for name, values in conditions.items():
        low, high = float(values.min()), float(values.max())
        if high - low > APART * max(abs(high), abs(low)):
            found += [Term(name, way, parts, directions, low, high, FEW, True) for way, parts, directions in ways
                      if len(parts) == 1 and way in ground.conditional]
    return found


def place_centres(term: Term, intervals: int) -> tuple[np.ndarray, float]:
    """Centres of the splines of one part and their spacing, SI."""
    step = (term.high - term.low) / intervals
    return term.low + step * np.arange(-1, intervals + 2), step


def evaluate_basis(term: Term, intervals: int, x: np.ndarray) -> np.ndarray:
    """Splines of one part at places of its variable, shape (places, intervals + 3)."""
    centres, step = place_centres(term, intervals)
    knots = np.concatenate([centres[0] - step * np.array([2.0, 1.0]), centres, centres[-1] + step * np.array([1, 2.0])])
    spline = BSpline(knots, np.eye(len(centres)), DEGREE)
    return np.nan_to_num(spline(np.clip(x, term.low - step, term.high + step)))


@lru_cache(maxsize=256)
def coarsen(fine: int, coarse: int) -> np.ndarray:
    """Matrix that gives the fine coefficients of coarse splines, shape (fine + 3, coarse + 3)."""
    plain = Term("", "", ("",), np.zeros((1, 1)), 0.0, 1.0, fine, False)
    x = np.linspace(0.0, 1.0, 8 * fine + 1)
    return np.linalg.lstsq(evaluate_basis(plain, fine, x), evaluate_basis(plain, coarse, x), rcond=None)[0]


@lru_cache(maxsize=256)
def smooth(intervals: int) -> np.ndarray:
    r"""Coefficients of the splines by parameters with one prior, $c = A\theta$, shape (intervals + 3, intervals + 3).

    $A A^T = (D^T D + \epsilon)^{-1}$ with second differences D: a line is next to free, and where nothing was seen the
    force goes on straight.
    """
    second = np.diff(np.eye(intervals + DEGREE), 2, axis=0)
    sizes, vectors = np.linalg.eigh(second.T @ second)
    return vectors / np.sqrt(np.maximum(sizes, 0.0) + FLAT)


def place_terms(ground: Ground, records: Records, wanted: Sequence[tuple[Term, int]]) -> dict[str, np.ndarray]:
    """The arrays that tell `add_splines` which splines there are: terms with their numbers of intervals, part by part.

    Raises:
        ValueError: they are more splines than one program holds.
    """
    plan, first, names = blank_plan(ground, records.stack.time.shape[0]), 0, list(ground.variables)
    for term, intervals in wanted:
        centres, step = place_centres(term, intervals)
        for direction in term.directions:
            here = slice(first, first + len(centres))
            if here.stop > COUNT:
                raise ValueError(f"one program holds {COUNT} splines, and more are wanted")
            if term.condition:
                weights = evaluate_basis(term, intervals, np.asarray(records.stack.conditions[term.variable]))
                plan[f"{PLAN}-direction"][:, here] = weights[:, :, None] * direction
            else:
                plan[f"{PLAN}-variable"][:, here, names.index(term.variable)] = 1.0
                plan[f"{PLAN}-centre"][:, here], plan[f"{PLAN}-width"][:, here] = centres, step
                plan[f"{PLAN}-direction"][:, here] = direction
            plan[f"{PLAN}-turn"][:, here, here] = smooth(intervals)
            first = here.stop
    return plan


def place_law(plan: dict[str, np.ndarray], ground: Ground, slot: int, variable: str, form: str, direction: np.ndarray,
              scale: float) -> None:
    """Put a simple law into a slot of a plan."""
    plan[f"{PLAN}-law-variable"][:, slot, list(ground.variables).index(variable)] = 1.0
    plan[f"{PLAN}-law-form"][:, slot, FORMS.index(form)] = 1.0
    plan[f"{PLAN}-law-scale"][:, slot] = scale
    plan[f"{PLAN}-law-direction"][:, slot] = direction


def with_plan(records: Records, plan: Mapping[str, np.ndarray]) -> Records:
    """Records that carry a plan among their conditions."""
    conditions: dict[str, Any] = {**records.stack.conditions, **{k: jnp.asarray(v) for k, v in plan.items()}}
    return dc.replace(records, stack=eqx.tree_at(lambda s: s.conditions, records.stack, conditions))


@dc.dataclass(frozen=True)
class Normal:
    """Normal equations of every condition."""

    blocks: np.ndarray  # shape (conditions, columns, columns)
    sides: np.ndarray  # shape (conditions, columns)
    squares: np.ndarray  # shape (conditions,)

    def turn(self, matrix: np.ndarray) -> "Normal":
        """The same in other coordinates, old = matrix new."""
        return Normal(np.einsum("ki,gkl,lj->gij", matrix, self.blocks, matrix, optimize=True), self.sides @ matrix,
                      self.squares)


def gather_normal(solution: Solution, more: np.ndarray | None, groups: np.ndarray,
                  offset: np.ndarray | None = None) -> Normal:
    """Normal equations of a fit's own columns, then of `more`.

    Args:
        solution: of which residual, columns and nuisances are taken.
        more: further columns, shape (records, rows, columns).
        groups: condition of every record.
        offset: where the columns of the solution are zero: their present values, shape (own columns,); zero for those
            that are not given, as steps from where they are.
    """
    shared = solution.shared if more is None else np.concatenate([solution.shared, more], axis=2)
    residual = solution.residual if offset is None else solution.residual - solution.shared @ offset
    columns, right = solution.projected(shared, np.concatenate([residual, solution.z], axis=1))
    both = np.concatenate([columns, right[..., None]], axis=2)
    square = np.einsum("grk,grl->gkl", both, both, optimize=True)
    total = np.zeros((int(groups.max()) + 1, *square.shape[1:]))
    np.add.at(total, groups, square)
    return Normal(total[:, :-1, :-1], total[:, :-1, -1], total[:, -1, -1])


def solve_ridge(normal: Normal, weight: np.ndarray, out: int | None = None) -> np.ndarray:
    """Coefficients at the least loss, without condition `out`; `weight` is 1/deviation of each prior, 0 for none."""
    blocks, sides = normal.blocks.sum(axis=0) + np.diag(weight**2), normal.sides.sum(axis=0)
    if out is not None:
        blocks, sides = blocks - normal.blocks[out], sides - normal.sides[out]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(blocks), 1e-300))
    scaled = blocks * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return -scale * np.linalg.solve(scaled, scale * sides)


def measure_ridge(normal: Normal, weight: np.ndarray) -> float:
    """Least loss of all conditions together, in noise variances, without what the prior adds; `weight` as above."""
    theta = solve_ridge(normal, weight)
    blocks, sides = normal.blocks.sum(axis=0), normal.sides.sum(axis=0)
    return float(normal.squares.sum() + 2.0 * theta @ sides + theta @ blocks @ theta)


def hold_out(normal: Normal, weight: np.ndarray) -> np.ndarray:
    """Loss of every condition under the fit without it, shape (conditions,), in noise variances."""
    losses = np.zeros(len(normal.squares))
    for g in range(len(losses)):
        theta = solve_ridge(normal, weight, g)
        losses[g] = normal.squares[g] + 2.0 * theta @ normal.sides[g] + theta @ normal.blocks[g] @ theta
    return losses


def spread_ridge(normal: Normal, weight: np.ndarray) -> np.ndarray:
    """Posterior covariance of the coefficients, shape (columns, columns)."""
    blocks = normal.blocks.sum(axis=0) + np.diag(weight**2)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(blocks), 1e-300))
    inverse = np.linalg.inv(blocks * np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    with np.errstate(over="ignore"):  # a direction of which nothing is known
        return inverse * np.outer(scale, scale)


def choose_ridge(normal: Normal, base: int) -> tuple[float, np.ndarray]:
    """Deviation of the prior that predicts left-out conditions best, and their losses; the first `base` have none.

    From what changes a typical column by a noise variance to 1e4 times that.
    """
    norms = np.sqrt(np.diag(normal.blocks.sum(axis=0))[base:])
    typical = float(np.median(norms[norms > 1e-9 * norms.max()])) if norms.size and norms.max() > 0 else 1.0
    free = np.arange(len(normal.sides[0])) >= base
    tried = [(float(d), hold_out(normal, free / d)) for d in 10.0 ** np.arange(-0.5, 4.01, 0.5) / typical]
    return min(tried, key=lambda one: float(np.nan_to_num(one[1].sum(), nan=np.inf)))
