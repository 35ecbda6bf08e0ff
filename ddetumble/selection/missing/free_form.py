"""The missing force itself: flexible terms inside the equation of motion, fitted by differentiating through the solve.

Every variable is tried alone, its force a sum of splines whose number and size are those that predict left-out
conditions best. All are compared at the linearised model first (`ridge`); those that come near the best are fitted to
the end. What the best of them leave together with a second and a third is the ceiling: no force of these variables
predicts left-out conditions better.
"""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from ..._display import Progress
from ..._errors import ComputationError, InputError
from ..._numerics import map_threads
from ...effects.free import COUNT, Ground
from ...families import Family, list_families
from ...inference.parameters import ParameterSpace
from ...inference.problem import Problem, Solution
from ..cross_validation import compare_losses
from ..problem import Fitted, SelectionProblem
from .splines import (
    DEGREE,
    Normal,
    Term,
    choose_ridge,
    coarsen,
    gather_normal,
    hold_out,
    list_terms,
    place_terms,
    smooth,
    solve_ridge,
    spread_ridge,
    with_plan,
)


FINALISTS = 4  # terms that are fitted to the end
MOST_TERMS = 3  # of the ceiling
STEPS = 12  # of their fits
SECOND = (9, 6)  # intervals of a further term


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
    """What a missing force of a family may depend on.

    Raises:
        InputError: the family has no flexible terms.
    """
    if family.ground is None:
        there = ", ".join(other.name for other in list_families() if other.ground is not None)
        raise InputError(f"the missing force is drawn for {there} records so far, not for {family.name} ones")
    return family.ground


class FreeBench:
    """Fits of flexible terms and simple laws beside one model of a campaign.

    Args:
        selection: of the campaign.
        model: beside which the force is drawn; its parameters are fitted along.

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
        self.space = ParameterSpace(selection.reference, effects, old.commons)
        self.start = np.array([u[old.index[s.name]] if s.name in old.index
                               else s.parameter.transform.from_field(s.parameter.default) for s in self.space.slots])
        self.coefficients = [f"{free.id}.c_{k}" for k in range(COUNT)]
        self.scale = float(self.space.scales()[self.space.index[self.coefficients[0]]])
        self.rows = float((np.asarray(self.records.stack.weights) > 0).sum())
        self.terms = self._list_terms()
        self.before = hold_out(gather_normal(model.solution, None, self.groups), np.zeros(len(self.names)))

    def _list_terms(self) -> list[Term]:
        """Terms that this campaign could show, over the ranges that the model visits."""
        solution, records, family, ground = self.model.solution, self.records, self.family, self.ground
        valid = (np.asarray(records.stack.weights)[: records.count] > 0).any(axis=1)
        state, rate = solution.state[valid], solution.state_rate[valid]
        time = np.asarray(records.stack.time)[: records.count][valid]
        ranges = {family.state: (0.0, ground.reach * float(state.max())),
                  family.rate: (float(rate.min()), float(rate.max())), "phase": (-np.pi, np.pi),
                  "time": (0.0, float(max(np.max(solution.end), 0.0) if family.has_contact else time.max()))}
        for name in (n for n in ground.variables if n not in ranges):
            own = solution.channels[:, records.channels.index(name)][valid]
            ranges[name] = float(own.min()), float(own.max())
        conditions = {name: np.asarray(x)[: records.count] for name, x in records.stack.conditions.items()
                      if name not in family.starts and name in self.selection.campaign.records}
        share = float(rate.max() if ground.base == family.rate else np.max(np.abs(solution.channels[:, 0])))
        return list_terms(ground, conditions, ranges, family.has_contact or bool((rate < 0).any()), share)

    def build(self, wanted: Sequence[tuple[Term, int]], priors: dict[str, tuple[float, float]] | None = None
              ) -> Problem:
        """The compiled model with these terms."""
        return Problem(self.space, with_plan(self.records, place_terms(self.ground, self.records, wanted)), priors)

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
            found = self.build((*wanted, *pack)).solve([*self.names, *self.coefficients], u, z, moving=False)
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
                normal = own.turn(block_diag(np.eye(base), block))
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

        Args:
            wanted: terms with their numbers of intervals.
            deviations: of their priors, to begin with.
            start: the model's own parameters and the coefficients, as of `screen`.
            held: a fit with the first of the terms.
        """
        count, base = sum(term.size(m) for term, m in wanted), len(self.names)
        names, idle = [*self.names, *self.coefficients[:count]], self.coefficients[count: count + self.padding(count)]
        u, z = (self.start.copy(), self.z) if held is None else (held.solution.u.copy(), held.solution.z)
        u[[self.space.index[n] for n in names[base:]]] = start[base:] * self.scale
        for trial in range(2):
            drawn = Drawn(tuple(wanted), tuple(deviations), self.model.solution, np.zeros(0), base)
            weight = drawn.weight
            priors = {n: (0.0, float(self.scale / w)) for n, w in zip(names[base:], weight[base:], strict=True)}
            try:
                solution = cut(self.build(wanted, priors).solve([*names, *idle], u, z, tolerance=0.1, max_steps=STEPS),
                               len(names))
            except ComputationError:
                return None
            if solution.failed or not np.isfinite(solution.chi2):
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

    def padding(self, count: int) -> int:
        """How many idle coefficients make a fit of `count` parameters one of the program that is compiled already."""
        slots = self.family.slots
        wanted = next(s for s in slots if len(self.names) + COUNT <= s)
        smaller = max((s for s in slots if s < wanted), default=0)
        return max(smaller + 1 - len(self.names) - count, 0)

    def compare(self, one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
        """By how much `other` predicts left-out conditions better than `one`, and the standard error."""
        return compare_losses(one, other, np.arange(len(one)))

    def helps(self, one: np.ndarray, other: np.ndarray) -> bool:
        """Whether the second predicts left-out conditions better, beyond chance."""
        return self.selection.settings.is_beaten(*self.compare(one, other))


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
    """Share of a force's own signature that is left when the model's parameters and the settings may imitate it.

    Args:
        bench, drawn: of `draw_forces`.
        curve: coefficients of the splines of another force of the same terms, SI; those drawn where not given.
    """
    blocks, base = bench.gather(drawn).blocks.sum(axis=0), drawn.base
    own = bench._offset(drawn)[base:] if curve is None else np.linalg.solve(drawn.turn, curve)
    size = float(own @ blocks[base:, base:] @ own)
    cross = blocks[:base, base:] @ own
    taken = float(cross @ np.linalg.lstsq(blocks[:base, :base], cross, rcond=1e-12)[0]) if base else 0.0
    return 1.0 - taken / size if size > 0 else 0.0
