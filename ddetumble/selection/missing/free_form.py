"""The missing force itself: flexible terms inside the equation of motion, fitted by differentiating through the solve.

Every variable is tried alone, its force a sum of splines whose number and size are those that predict left-out
conditions best. All are compared at the linearised model first (ridge); those that come near the best are fitted to
the end. What the best of them leave together with a second and a third is the ceiling: no force of these variables
predicts left-out conditions better.
"""

import dataclasses as dc
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag

from ..._display import Progress
from ..._errors import ComputationError, InputError
from ..._numerics import map_threads
from ...effects.free import COUNT, FORMS, PLAN, Ground, blank_plan
from ...families import Family, list_families
from ...inference.parameters import ParameterSpace
from ...inference.problem import Problem, Solution
from ...inference.stack import Records
from ..cross_validation import compare_losses
from ..problem import Fitted, SelectionProblem


FINEST = {"depression": 18, "depression_rate": 12, "time": 18, "slip": 45, "angular_speed": 12,
          "angular_velocity_z": 12, "phase": 18}
USUAL = 18  # intervals of a variable of the user's own: as of depression and time
FEW = 4  # intervals over a condition, which has few levels, so that more are not determined
DEGREE = 3  # of the splines: cubic, smooth to the second derivative
FLAT = 1e-4  # what is left of the roughness penalty for a straight line, so that it is determined
APART = 0.02  # levels of a condition that differ by less are one: a rig's scatter
FINALISTS = 4  # terms that are fitted to the end: of the rest none comes near in the screening
MOST_TERMS = 3  # of the ceiling: a fourth gains little and is not understood
STEPS = 12  # of their fits: what they gain after it changes no share
SECOND = (9, 6)  # intervals of a further term: coarser, as it describes what the first left


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
    """The arrays that tell `add_splines` which splines there are: terms with their numbers of intervals, part by
    part."""
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
    """Normal equations by condition of a fit's own columns, then of `more`, shape (records, rows, columns).

    `offset` holds present values of the fit's columns, which then count from zero, shape (own columns,); the others are
    steps from where they are.
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


@dc.dataclass(frozen=True)
class Drawn:
    """Flexible terms fitted beside a model."""

    wanted: tuple[tuple[Term, int], ...]  # terms with their numbers of intervals
    deviations: tuple[float, ...]  # of their priors, in units of the coefficients' scale
    solution: Solution  # its names end with the coefficients
    losses: np.ndarray  # held out, by condition, in noise variances
    base: int  # how many columns are the model's own

    @property
    def loss(self) -> float:
        """Held-out loss of all conditions together."""
        return float(self.losses.sum())

    @property
    def weight(self) -> np.ndarray:
        """1/deviation of the prior of every column; 0 for the model's own."""
        own = [np.full(term.size(m), 1.0 / d) for (term, m), d in zip(self.wanted, self.deviations, strict=True)]
        return np.concatenate([np.zeros(self.base), *own])

    @property
    def turn(self) -> np.ndarray:
        """Coefficients of the splines by the parameters."""
        return np.asarray(block_diag(*(smooth(m) for term, m in self.wanted for _ in term.parts)))


@dc.dataclass(frozen=True)
class Screened:
    """One term beside a model, as the linearised model has it."""

    term: Term
    intervals: int
    deviation: float
    losses: np.ndarray
    start: np.ndarray


def find_ground(family: Family) -> Ground:
    """What a missing force of a family may depend on; an InputError where it has no flexible terms."""
    if family.ground is None:
        there = ", ".join(other.name for other in list_families() if other.ground is not None)
        raise InputError(f"the missing force is drawn for {there} records so far, not for {family.name} ones")
    return family.ground


class FreeBench:
    """Fits of flexible terms and simple laws beside one model of a campaign, whose parameters are fitted along.

    Raises:
        InputError: the family has no flexible terms yet.
    """

    def __init__(self, selection: SelectionProblem, model: Fitted):
        self.selection, self.model, self.family = selection, model, selection.family
        self.ground = find_ground(self.family)
        self.records, self.groups, old = selection.records, selection.groups, selection.space
        self.names, u, self.z = list(model.solution.names), model.solution.u, model.solution.z
        owners = dict.fromkeys(name.split(".")[0] for name in self.names if "." in name)
        free, self.simple = self.ground.splines, self.ground.laws
        effects = (*(selection.find_effect(e) for e in owners), free, self.simple)
        self.space = ParameterSpace(old.reference, effects, old.commons)
        self.start = np.array([u[old.index[s.name]] if s.name in old.index
                               else s.parameter.transform.from_field(s.parameter.default) for s in self.space.slots])
        self.coefficients = [f"{free.id}.c_{k}" for k in range(COUNT)]
        self.scale = float(self.space.scales()[self.space.index[self.coefficients[0]]])
        self.rows = selection.samples
        self.terms = self._list_terms()
        self.before = hold_out(gather_normal(model.solution, None, self.groups), np.zeros(len(self.names)))

    def _list_terms(self) -> list[Term]:
        """Terms that this campaign could show, over the ranges that the model and the records' conditions visit."""
        solution, records, family, ground = self.model.solution, self.records, self.family, self.ground
        valid = records.used.any(axis=1)
        state, rate = solution.state[valid], solution.state_rate[valid]
        time = np.asarray(records.stack.time)[: records.count][valid]
        ranges = {family.state: (0.0, ground.reach * float(state.max())),
                  family.rate: (float(rate.min()), float(rate.max())), "phase": (-np.pi, np.pi),
                  "time": (0.0, float(max(np.max(solution.end), 0.0) if family.has_contact else time.max()))}
        for name in (n for n in ground.variables if n not in ranges):
            own = solution.channels[:, records.channels.index(name)][valid]
            ranges[name] = float(own.min()), float(own.max())
        # A share's coefficient is in units of the force of which it is one, at its largest.
        force = float(rate.max() if ground.base == family.rate else np.max(np.abs(solution.channels[:, 0])))
        unit = {name: np.eye(len(ground.directions))[k] / (force if name in ground.shares else 1.0)
                for k, name in enumerate(ground.directions)}
        ways: list[tuple[str, tuple[str, ...], np.ndarray]] = []  # name, parts, directions of the parts
        for way, gates in ground.gates.items():
            own = np.stack([unit[gate] for gate in gates])
            whole = (way, ("",), own.sum(axis=0, keepdims=True))
            apart = (way, tuple(gate.split()[-1] for gate in gates), own)
            if ground.unit == "N":
                both = family.has_contact or (rate < 0).any()
                ways += [whole, apart] if both else [whole]
            else:
                ways += [apart, whole] if way == "drag" else [apart]
                ways += [(f"{way} about {gate}" if way == "torque" else gate, ("",), unit[gate][None])
                         for gate in gates]
        found = []
        for variable in ground.variables:
            (low, high), finest = ranges[variable], FINEST.get(variable, USUAL)
            for way, parts, directions in ways if high > low else []:
                fits = [m for m in range(3, finest + 1) if finest % m == 0 and len(parts) * (m + DEGREE) <= COUNT]
                phased = set(parts) & {"loading", "unloading"}
                if fits and not (variable in ("depression_rate", "time") and phased):  # these tell the phases apart
                    found.append(Term(variable, way, parts, directions, low, high, max(fits), False))
        for name in (n for n in records.stack.conditions if n in self.selection.campaign.records):
            values = np.asarray(records.stack.conditions[name])[: records.count]
            low, high = float(values.min()), float(values.max())
            if name not in family.starts and high - low > APART * max(abs(high), abs(low)):
                found += [Term(name, way, parts, directions, low, high, FEW, True) for way, parts, directions in ways
                          if len(parts) == 1 and way in ground.conditional]
        return found

    def build(self, plan: Mapping[str, np.ndarray], priors: dict[str, tuple[float, float]] | None = None) -> Problem:
        """The compiled model with the terms of a plan, which the records carry among their conditions."""
        stack = self.records.stack
        conditions: dict[str, Any] = {**stack.conditions, **{k: jnp.asarray(v) for k, v in plan.items()}}
        return Problem(self.space, dc.replace(self.records, stack=dc.replace(stack, conditions=conditions)), priors)

    def fit(self, plan: Mapping[str, np.ndarray], names: Sequence[str], priors: dict[str, tuple[float, float]],
            u: np.ndarray, z: np.ndarray, steps: int, padded: bool = True) -> Solution | None:
        """Fit parameters of a plan's terms along with the model's; None where that fails.

        Where it is `padded`, idle coefficients make it a fit of the program that is compiled already.
        """
        free, idle = [*self.names, *names], [name for name in self.coefficients if name not in names]
        wanted = next(s for s in self.family.slots if len(self.names) + COUNT <= s)
        smaller = max((s for s in self.family.slots if s < wanted), default=0)
        idle = idle[: max(smaller + 1 - len(free), 0)] if padded else []
        try:
            found = self.build(plan, priors).solve([*free, *idle], u, z, tolerance=0.1, max_steps=steps)
        except ComputationError:
            return None
        return None if found.failed or not np.isfinite(found.chi2) else cut(found, len(free))

    def place_law(self, plan: dict[str, np.ndarray], slot: int, term: Term, form: str, direction: np.ndarray) -> None:
        """Put a simple law of a term's variable into a slot of a plan, from 1."""
        plan[f"{PLAN}-law-variable"][:, slot - 1, list(self.ground.variables).index(term.variable)] = 1.0
        plan[f"{PLAN}-law-form"][:, slot - 1, FORMS.index(form)] = 1.0
        plan[f"{PLAN}-law-scale"][:, slot - 1] = term.scale
        plan[f"{PLAN}-law-direction"][:, slot - 1] = direction

    def scan(self, held: Drawn | None = None) -> dict[str, Normal]:
        """Normal equations of every term at its finest, by name, beside the model (and the terms already drawn)."""
        wanted, u, z = ((), self.start, self.z) if held is None else (held.wanted, held.solution.u, held.solution.z)
        used, room = sum(term.size(m) for term, m in wanted), 0
        packs: list[list[tuple[Term, int]]] = []
        for term in self.terms:
            fits = (m for m in SECOND if term.size(m) <= COUNT - used and term.finest % m == 0)
            m = term.finest if held is None else next(fits, 0)
            if m and term.size(m) > room:
                packs.append([])
                room = COUNT - used
            if m:
                packs[-1].append((term, m))
                room -= term.size(m)
        own, normals = len(self.names) + used, {}
        for pack in packs:
            # All coefficients, so that one program serves; the rest have no effect.
            plan = place_terms(self.ground, self.records, (*wanted, *pack))
            found = self.build(plan).solve([*self.names, *self.coefficients], u, z, moving=False)
            ends = own + np.cumsum([term.size(m) for term, m in pack])
            columns = np.split(found.shared[:, :, : ends[-1]], [own, *ends[:-1]], axis=2)[1:]
            for (term, _), more in zip(pack, columns, strict=True):
                normals[term.name] = gather_normal(cut(found, own), more, self.groups, self._offset(held))
        return normals

    def _offset(self, drawn: Drawn | None) -> np.ndarray:
        """Present values of the coefficients drawn, in their scale, behind zeros for the model's own parameters."""
        if drawn is None:
            return np.zeros(len(self.names))
        own = drawn.solution.u[[self.space.index[n] for n in drawn.solution.names[drawn.base:]]] / self.scale
        return np.concatenate([np.zeros(drawn.base), own])

    def gather(self, drawn: Drawn) -> Normal:
        """Normal equations of a fit, its coefficients counted from zero."""
        return gather_normal(drawn.solution, None, self.groups, self._offset(drawn))

    def screen(self, normals: dict[str, Normal], held: Drawn | None = None) -> list[Screened]:
        """Number of intervals and prior of every term that predict left-out conditions best; best term first."""
        fixed = np.zeros(len(self.names)) if held is None else held.weight
        found, base = [], len(fixed)
        for term in (term for term in self.terms if term.name in normals):
            own, best = normals[term.name], None
            finest = (len(own.sides[0]) - base) // len(term.parts) - DEGREE
            for m in [m for m in range(3, finest + 1) if finest % m == 0]:
                block = np.kron(np.eye(len(term.parts)),
                                np.linalg.solve(smooth(finest), coarsen(finest, m) @ smooth(m)))
                normal = own.turn(np.asarray(block_diag(np.eye(base), block)))
                # Close enough: the prior of the terms already drawn is shared out among the conditions.
                shared = normal.blocks.copy()
                shared[:, :base, :base] += np.diag(fixed**2 / len(normal.squares))
                deviation, losses = choose_ridge(dc.replace(normal, blocks=shared), base)
                if best is None or losses.sum() < best.losses.sum():
                    weight = np.concatenate([fixed, np.full(block.shape[1], 1.0 / deviation)])
                    best = Screened(term, m, deviation, losses, solve_ridge(normal, weight))
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda s: float(s.losses.sum()))

    def draw(self, wanted: Sequence[tuple[Term, int]], deviations: Sequence[float], start: np.ndarray,
             held: Drawn | None = None) -> Drawn | None:
        """Fit terms to the end; their priors are chosen again where the fit ended. None where the fit failed.

        `deviations` are those of the priors to begin with, `start` is as of `screen`, `held` a fit with the first of
        the terms.
        """
        count, base = sum(term.size(m) for term, m in wanted), len(self.names)
        names = self.coefficients[:count]
        u, z = (self.start.copy(), self.z) if held is None else (held.solution.u.copy(), held.solution.z)
        u[[self.space.index[n] for n in names]] = start[base:] * self.scale
        plan = place_terms(self.ground, self.records, wanted)
        for trial in range(2):
            drawn = Drawn(tuple(wanted), tuple(deviations), self.model.solution, np.zeros(0), base)
            weight = drawn.weight
            priors = {n: (0.0, float(self.scale / w)) for n, w in zip(names, weight[base:], strict=True)}
            solution = self.fit(plan, names, priors, u, z, STEPS)
            if solution is None:
                return None
            drawn = dc.replace(drawn, solution=solution)
            normal = self.gather(drawn)
            options = {f: hold_out(normal, weight / f) for f in (0.1, 0.3, 1.0, 3.0, 10.0)}
            best = min(options, key=lambda f: float(options[f].sum()))
            least = options[1.0].sum() - self.selection.settings.significant
            if trial or 0.3 <= best <= 3.0 or options[best].sum() > least:
                return dc.replace(drawn, losses=options[1.0])
            deviations, u, z = [d * best for d in deviations], solution.u, solution.z
        return None

    def helps(self, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether the second predicts left-out conditions better, beyond chance."""
        return self.selection.settings.is_beaten(*compare_losses(one, other))


def cut(solution: Solution, count: int) -> Solution:
    """A fit's first `count` parameters; those behind had no effect."""
    return dc.replace(solution, names=solution.names[:count], scales=solution.scales[:count],
                      shared=solution.shared[:, :, :count], prior_residual=solution.prior_residual[:count],
                      prior_weight=solution.prior_weight[:count])


def draw_forces(bench: FreeBench, normals: dict[str, Normal], report: Progress) -> tuple[list[Drawn], Drawn | None]:
    """The missing force over every variable alone, best first, and the ceiling: the best sum of a few.

    `normals` are of `FreeBench.scan`. Nothing is drawn where no term predicts left-out conditions better than the model
    alone.
    """
    hopeful = [s for s in bench.screen(normals) if bench.helps(bench.before, s.losses)][:FINALISTS]
    report("fitting the missing force", 0.4)
    fits = map_threads(lambda s: bench.draw([(s.term, s.intervals)], [s.deviation], s.start), hopeful)
    drawn = sorted((d for d in fits if d is not None and bench.helps(bench.before, d.losses)), key=lambda d: d.loss)
    if not drawn:
        return [], None
    ceiling = drawn[0]
    while len(ceiling.wanted) < MOST_TERMS:
        report("looking for more than one variable", 0.6)
        more = [s for s in bench.screen(bench.scan(ceiling), ceiling) if s.term not in [t for t, _ in ceiling.wanted]]
        if not more or not bench.helps(ceiling.losses, more[0].losses):
            break
        best = more[0]
        wider = bench.draw([*ceiling.wanted, (best.term, best.intervals)], [*ceiling.deviations, best.deviation],
                           best.start, ceiling)
        if wider is None or not bench.helps(ceiling.losses, wider.losses):
            break
        ceiling = wider
    return drawn, ceiling


def spread_drawn(bench: FreeBench, drawn: Drawn) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the splines of a fit, SI, and their posterior covariance."""
    covariance = spread_ridge(bench.gather(drawn), drawn.weight)[drawn.base:, drawn.base:]
    own = drawn.solution.u[[bench.space.index[n] for n in drawn.solution.names[drawn.base:]]]
    return drawn.turn @ own, drawn.turn @ covariance @ drawn.turn.T * bench.scale**2


def measure_visible(bench: FreeBench, drawn: Drawn, curve: np.ndarray | None = None) -> float:
    """Share of a force's own signature (or of a `curve` of the same terms, coefficients of its splines) that is left
    when the model's parameters and the settings may imitate it."""
    blocks, base = bench.gather(drawn).blocks.sum(axis=0), drawn.base
    own = bench._offset(drawn)[base:] if curve is None else np.linalg.solve(drawn.turn, curve)
    size = float(own @ blocks[base:, base:] @ own)
    cross = blocks[:base, base:] @ own
    taken = float(cross @ np.linalg.lstsq(blocks[:base, :base], cross, rcond=1e-12)[0]) if base else 0.0
    return 1.0 - taken / size if size > 0 else 0.0
