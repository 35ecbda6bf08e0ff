"""The missing force itself: flexible terms inside the equation of motion, fitted by differentiating through the solve.

Every variable is tried alone, its force a sum of splines whose number and size are those that predict left-out
conditions best. All are compared at the linearised model first (`ridge`); those that come near the best are fitted to
the end. What the best of them leave together with a second and a third is the ceiling: no force of these variables
predicts left-out conditions better.
"""

import dataclasses as dc
from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import block_diag

from ..._errors import ComputationError, InputError
from ..._numerics import map_threads
from ...effects.free import COUNT, Ground
from ...families import Family, list_families
from ...inference.parameters import ParameterSpace
from ...inference.problem import Problem, Solution
from ..cross_validation import compare_losses
from ..problem import Fitted, SelectionProblem
from .splines import (
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
STEPS = 12
SECOND = (9, 6)  # intervals of a further term


@dc.dataclass(frozen=True)
class Drawn:
    """Flexible terms fitted beside a model.

    Attributes:
        wanted: terms with their numbers of intervals.
        deviations: of their priors, in units of the coefficients' scale.
        solution: of the fit; its names end with the coefficients.
        losses: held out, by condition, in noise variances.
        base: how many columns are the model's own.
    """

    wanted: tuple[tuple[Term, int], ...]
    deviations: tuple[float, ...]
    solution: Solution
    losses: np.ndarray
    base: int

    @property
    def loss(self) -> float:
        """Held-out loss of all conditions together."""
        return float(self.losses.sum())


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
        family = selection.family
        self.selection, self.model, self.family, self.ground = selection, model, family, find_ground(family)
        self.free, self.simple = self.ground.splines, self.ground.laws
        names = list(model.solution.names)
        owners = dict.fromkeys(name.split(".")[0] for name in names if "." in name)
        self.classes = tuple(selection.find_effect(e) for e in owners)
        self.space, self.start = self._assemble()
        self.records = selection.records
        self.names, self.z = names, model.solution.z
        self.coefficients = [f"{self.free.id}.c_{k}" for k in range(COUNT)]
        self.scale = float(self.space.scales()[self.space.index[self.coefficients[0]]])
        self.groups = selection.groups
        self.rows = float((np.asarray(self.records.stack.weights) > 0).sum())
        self.terms = self._list_terms()
        self.before = hold_out(gather_normal(model.solution, None, self.groups), np.zeros(len(names)))

    def _assemble(self) -> tuple[ParameterSpace, np.ndarray]:
        """Parameters of the model, the splines and the simple laws, and where the model's fit ended."""
        old = self.selection.space
        space = ParameterSpace(self.selection.reference, (*self.classes, self.free, self.simple), old.commons)
        return space, np.array([
            self.model.solution.u[old.index[s.name]] if s.name in old.index
            else s.parameter.transform.from_field(s.parameter.default) for s in space.slots])

    def _list_terms(self) -> list[Term]:
        """Terms that this campaign could show, over the ranges that the model visits."""
        solution, records = self.model.solution, self.selection.records
        valid = (np.asarray(records.stack.weights)[: records.count] > 0).any(axis=1)
        state, rate = solution.state[valid], solution.state_rate[valid]
        time = np.asarray(records.stack.time)[: records.count][valid]
        family, ground = self.family, self.ground
        ranges = {family.state: (0.0, ground.reach * float(state.max())),
                  family.rate: (float(rate.min()), float(rate.max())), "phase": (-np.pi, np.pi),
                  "time": (0.0, float(max(np.max(solution.end), 0.0) if family.has_contact else time.max()))}
        for name in (n for n in ground.variables if n not in ranges):
            own = solution.channels[:, records.channels.index(name)][valid]
            ranges[name] = float(own.min()), float(own.max())
        backward = family.has_contact or bool((rate < 0).any())
        known = set(family.starts)
        conditions = {name: np.asarray(x)[: records.count] for name, x in records.stack.conditions.items()
                      if name not in known and name in self.selection.campaign.records}
        share = float(rate.max() if ground.base == family.rate else np.max(np.abs(solution.channels[:, 0])))
        return list_terms(ground, conditions, ranges, backward, share)

    def problem(self, wanted: Sequence[tuple[Term, int]], priors: dict[str, tuple[float, float]] | None = None
                ) -> Problem:
        """The compiled model with these terms."""
        return Problem(self.space, with_plan(self.records, place_terms(self.ground, self.records, wanted)), priors)

    def look(self, wanted: Sequence[tuple[Term, int]], count: int, u: np.ndarray | None = None,
             z: np.ndarray | None = None) -> Solution:
        """Residual and columns of the model's own parameters and of the first `count` coefficients, without moving."""
        problem = self.problem(wanted)
        kept = len(self.names) + count
        names = [*self.names, *self.coefficients]  # all, so that one program serves; the rest have no effect
        found = problem.solve(names, self.start if u is None else u, self.z if z is None else z, moving=False)
        return dc.replace(found, names=found.names[:kept], shared=found.shared[:, :, :kept])

    def scan(self, held: Drawn | None = None) -> dict[str, Normal]:
        """Normal equations of every term at its finest, by name, beside the model (and the terms already drawn)."""
        wanted = () if held is None else held.wanted
        used = sum(term.size(m) for term, m in wanted)
        u, z = (self.start, self.z) if held is None else (held.solution.u, held.solution.z)
        finest = {t.name: t.finest if held is None else _fit_finest(t, COUNT - used) for t in self.terms}
        strands: dict[tuple, tuple[Term, int]] = {}
        for term in sorted(self.terms, key=lambda t: -len(t.parts)):
            for direction in term.directions:
                single = dc.replace(term, parts=("",), directions=direction[None])
                m = finest[term.name]
                if m and not _find_sum(strands, term.variable, direction, m):
                    strands[term.variable, direction.tobytes(), m] = (single, m)
        packs: list[list[tuple]] = [[]]
        for key, (term, m) in strands.items():
            if used + sum(strands[k][0].size(strands[k][1]) for k in packs[-1]) + term.size(m) > COUNT:
                packs.append([])
            packs[-1].append(key)

        def one(pack):
            here = [strands[key] for key in pack]
            size = sum(term.size(m) for term, m in here)
            found = self.look((*wanted, *here), used + size, u, z)
            splits = np.cumsum([term.size(m) for term, m in here])[:-1]
            parts = np.split(found.shared[:, :, len(self.names) + used:], splits, axis=2)
            return found, dict(zip(pack, parts, strict=True))

        columns: dict[tuple, np.ndarray] = {}
        base = None
        for found, parts in map(one, [pack for pack in packs if pack]):
            columns |= parts
            base = dc.replace(found, shared=found.shared[:, :, : len(self.names) + used])
        normals = {}
        for term in self.terms:
            m = finest[term.name]
            if m and base is not None:
                own = np.concatenate([sum(columns[key] for key in _find_sum(strands, term.variable, d, m))
                                      for d in term.directions], axis=2)  # by the parameters, still to be turned back
                normals[term.name] = gather_normal(base, own, self.groups, self._offset(held))
        return normals

    def _offset(self, held: Drawn | None) -> np.ndarray:
        """Present values of the coefficients drawn, in their scale, behind zeros for the model's own parameters."""
        if held is None:
            return np.zeros(len(self.names))
        own = held.solution.u[[self.space.index[n] for n in held.solution.names[held.base:]]] / self.scale
        return np.concatenate([np.zeros(held.base), own])

    def screen(self, normals: dict[str, Normal], held: Drawn | None = None) -> list[Screened]:
        """Number of intervals and prior of every term that predict left-out conditions best; best term first."""
        base = len(self.names) + (0 if held is None else sum(t.size(m) for t, m in held.wanted))
        fixed = np.zeros(base)
        if held is not None:
            fixed[len(self.names):] = self._weights(held)
        found = []
        for term in self.terms:
            if term.name not in normals:
                continue
            best = None
            finest = (len(normals[term.name].sides[0]) - base) // len(term.parts) - 3
            for m in [m for m in range(3, finest + 1) if finest % m == 0]:
                block = np.kron(np.eye(len(term.parts)),
                                np.linalg.solve(smooth(finest), coarsen(finest, m) @ smooth(m)))
                turn = np.zeros((base + block.shape[0], base + block.shape[1]))
                turn[:base, :base], turn[base:, base:] = np.eye(base), block
                normal = normals[term.name].turn(turn)
                deviation, losses = _choose(normal, base, fixed)
                if best is None or losses.sum() < best.losses.sum():
                    weight = np.concatenate([fixed, np.full(block.shape[1], 1.0 / deviation)])
                    best = Screened(term, m, deviation, losses, solve_ridge(normal, weight))
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda s: float(s.losses.sum()))

    def _weights(self, drawn: Drawn) -> np.ndarray:
        """1/deviation of the prior of every coefficient drawn."""
        return np.concatenate([np.full(term.size(m), 1.0 / d)
                               for (term, m), d in zip(drawn.wanted, drawn.deviations, strict=True)])

    def draw(self, wanted: Sequence[tuple[Term, int]], deviations: Sequence[float], start: np.ndarray | None = None,
             held: Drawn | None = None) -> Drawn | None:
        """Fit terms to the end; their priors are chosen again where the fit ended. None where the fit failed.

        Args:
            wanted: terms with their numbers of intervals.
            deviations: of their priors, to begin with.
            start: step of the model's own parameters and coefficients from `held`, or from the model.
            held: a fit with the first of the terms.
        """
        count, base = sum(term.size(m) for term, m in wanted), len(self.names)
        names = [*self.names, *self.coefficients[:count]]
        u, z = (self.start, self.z) if held is None else (held.solution.u, held.solution.z)
        u = u.copy()
        index = [self.space.index[n] for n in names]
        if start is not None:
            own = np.zeros(len(names))
            own[base:] = start[base:] * self.scale
            u[index[base:]] = own[base:]
        for trial in range(2):
            sd = np.concatenate([np.full(t.size(m), d) for (t, m), d in zip(wanted, deviations, strict=True)])
            priors = {n: (0.0, float(s * self.scale)) for n, s in zip(names[base:], sd, strict=True)}
            try:
                idle = self.coefficients[count: count + self.padding(count)]
                solution = cut(self.problem(wanted, priors).solve([*names, *idle], u, z, tolerance=0.1,
                                                                  max_steps=STEPS), len(names))
            except ComputationError:
                return None
            if solution.failed or not np.isfinite(solution.chi2):
                return None
            drawn = Drawn(tuple(wanted), tuple(deviations), solution, np.zeros(0), base)
            normal = gather_normal(solution, None, self.groups, self._offset(drawn))
            weight = np.concatenate([np.zeros(base), 1.0 / sd])
            options = {f: hold_out(normal, weight / f) for f in (0.1, 0.3, 1.0, 3.0, 10.0)}
            best = min(options, key=lambda f: float(options[f].sum()))
            drawn = dc.replace(drawn, losses=options[1.0])
            least = options[1.0].sum() - self.selection.settings.significant
            if trial or 0.3 <= best <= 3.0 or options[best].sum() > least:
                return drawn
            deviations = [d * best for d in deviations]
            u, z = solution.u, solution.z
        return None

    def padding(self, count: int) -> int:
        """How many idle coefficients make a fit of `count` parameters one of the program that is compiled already."""
        slots = self.selection.family.slots
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


def _find_sum(strands: dict[tuple, tuple[Term, int]], variable: str, direction: np.ndarray, intervals: int
              ) -> list[tuple]:
    """Which strands are, or make up, this direction: both phases together are a force at all times."""
    own = {key: term.directions[0] for key, (term, m) in strands.items() if key[0] == variable and m == intervals}
    same = [key for key, d in own.items() if np.array_equal(d, direction)]
    if same:
        return same
    parts = [key for key, d in own.items() if np.array_equal(d * (direction != 0), d) and np.allclose(
        d[d != 0], direction[d != 0])]
    return parts if parts and np.allclose(sum(own[key] for key in parts), direction) else []


def _fit_finest(term: Term, room: int) -> int:
    """Intervals of a further term in the room that is left; 0 where it does not fit."""
    return next((m for m in SECOND if term.size(m) <= room and term.finest % m == 0), 0)


def _choose(normal: Normal, base: int, fixed: np.ndarray) -> tuple[float, np.ndarray]:
    """Prior of the columns behind `base`, those before having their own."""
    if not fixed.any():
        return choose_ridge(normal, base)
    root = np.diag(fixed**2 / len(normal.squares))
    blocks = normal.blocks.copy()
    blocks[:, :base, :base] += root  # close enough: a prior shared out among the conditions
    return choose_ridge(dc.replace(normal, blocks=blocks), base)


def draw_forces(bench: FreeBench, normals: dict[str, Normal],
                report: Callable[[str, float], object] = lambda text, share: None) -> tuple[list[Drawn], Drawn | None]:
    """The missing force over every variable alone, best first, and the ceiling: the best sum of a few.

    `normals` are of `FreeBench.scan`.
    Nothing is drawn where no term predicts left-out conditions better than the model alone.
    """
    screened = bench.screen(normals)
    hopeful = [s for s in screened if bench.helps(bench.before, s.losses)][:FINALISTS]
    report("fitting the missing force", 0.4)
    fits = map_threads(
        lambda s: bench.draw([(s.term, s.intervals)], [s.deviation], s.start), hopeful)
    drawn = sorted((d for d in fits if d is not None and bench.helps(bench.before, d.losses)), key=lambda d: d.loss)
    if not drawn:
        return [], None
    ceiling = drawn[0]
    while len(ceiling.wanted) < MOST_TERMS:
        report("looking for more than one variable", 0.6)
        more = [s for s in bench.screen(bench.scan(ceiling), ceiling)
                if s.term not in [t for t, _ in ceiling.wanted]]
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
    normal = gather_normal(drawn.solution, None, bench.groups, bench._offset(drawn))
    weight = np.concatenate([np.zeros(drawn.base), bench._weights(drawn)])
    covariance = spread_ridge(normal, weight)[drawn.base:, drawn.base:]
    own = drawn.solution.u[[bench.space.index[n] for n in drawn.solution.names[drawn.base:]]]
    turn = _turn(drawn)
    return turn @ own, turn @ covariance @ turn.T * bench.scale**2


def measure_visible(bench: FreeBench, drawn: Drawn, curve: np.ndarray | None = None) -> float:
    """Share of a force's own signature that is left when the model's parameters and the settings may imitate it.

    Args:
        bench, drawn: of `draw_forces`.
        curve: coefficients of the splines of another force of the same terms, SI; those drawn where not given.
    """
    normal = gather_normal(drawn.solution, None, bench.groups, bench._offset(drawn))
    blocks, base = normal.blocks.sum(axis=0), drawn.base
    own = bench._offset(drawn)[base:]
    if curve is not None:
        own = np.linalg.solve(_turn(drawn), curve)
    size = float(own @ blocks[base:, base:] @ own)
    cross = blocks[:base, base:] @ own
    taken = float(cross @ np.linalg.lstsq(blocks[:base, :base], cross, rcond=1e-12)[0]) if base else 0.0
    return 1.0 - taken / size if size > 0 else 0.0


def _turn(drawn: Drawn) -> np.ndarray:
    """Coefficients of the splines by the parameters."""
    return np.asarray(block_diag(*(smooth(m) for term, m in drawn.wanted for _ in term.parts)))
