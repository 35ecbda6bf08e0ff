"""What a campaign could see before any test of it: how small an effect, and which pairs would look alike.

Every effect is taken at the size that `selection.detectability` finds; two of them look alike where the cosine
between what can be seen of them is near one.
"""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._display import AbstractPrinted, Progress
from .._errors import ComputationError
from .._numerics import map_threads
from ..contact.effect import AbstractEffect, parameters_of
from ..families import name_family
from ..inference.archive import Model, resolve_model
from ..inference.assembly import default_starts
from ..inference.files import list_versions, make_plain, write_json
from ..inference.problem import Solution
from ..measurement.campaign import Campaign
from ..measurement.package import read_campaign
from ..selection.detectability import detectable_length, find_size, reach_limit
from ..selection.problem import SelectionProblem, pose_selection
from ..selection.settings import DEFAULT
from .plans import read_plan


FILE = "map.json"
SAME = 0.9995  # |cos| from which no size tells two effects apart


@dc.dataclass(frozen=True)
class Visible:
    """One effect of the catalogue.

    Attributes:
        effect: id; `parameter` its amplitude, `unit` that of `size`.
        size: public value of the amplitude that would be found with 95 % power, at the shape that shows most; None
            where no size that physics allows would be.
        shapes: values of its shape parameters there, public.
        visible: share of its own signature (squared length) that refits leave.
        closest: effect whose signature is most like it, `cosine` of the two.
        told: multiple of the departure of `size` from the null from which it is told from `closest`; None where no
            value that physics allows is.
        sizes: of each component of a vector, by public name.
    """

    effect: str
    parameter: str
    unit: str
    size: float | None
    shapes: dict[str, float]
    visible: float
    closest: str | None
    cosine: float
    told: float | None
    sizes: dict[str, float]


@dc.dataclass(frozen=True)
class Visibility(AbstractPrinted):
    """The map; `to_dict()` is `map.json`.

    Attributes:
        campaign, family, model: names.
        records, samples: of the campaign.
        effects: of the catalogue, in its order.
        names: rows and columns of `cosines`: effects that can be seen.
        cosines: |cos| between what can be seen of two effects, the largest over their shapes, shape (names, names).
        length: of a signature that is found with 95 % power [standard deviations of the noise].
        alike: pairs that cannot be told apart.
        sentence, notes: in plain words.
    """

    campaign: str
    family: str
    model: str
    records: int
    samples: int
    effects: tuple[Visible, ...]
    names: tuple[str, ...]
    cosines: np.ndarray
    length: float
    alike: tuple[tuple[str, str], ...]
    sentence: str
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The map for a terminal."""
        width = max(len(e.effect) for e in self.effects)
        rows = [f"{'effect':<{width}}  {'found from':<28}  most like"]
        for e in self.effects:
            size = f"{e.parameter} = {e.size:.3g} {e.unit}".rstrip().removesuffix(" 1") if e.size is not None else (
                "cannot be seen")
            near = "" if e.closest is None else f"{e.closest} ({e.cosine:.2f}), " + (
                "never told from it" if e.told is None else f"told from it at {e.told:.2g} times that")
            rows.append(f"{e.effect:<{width}}  {size:<28}  {near}")
        return "\n".join([self.sentence, "", *rows, "", *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return make_plain({**{f.name: getattr(self, f.name) for f in dc.fields(self)}, "versions": list_versions()})

    def save(self, folder: Path | str) -> Path:
        """Write `map.json` into a folder (made if it is not there); returns its path."""
        path = Path(folder) / FILE
        write_json(path, self.to_dict())
        return path


@dc.dataclass(frozen=True)
class _Signature:
    """What can be seen of one amplitude at one shape: direction of unit length, and the size that is found."""

    effect: str
    name: str
    size: float
    shapes: dict[str, float]
    visible: float
    column: np.ndarray


def map_effects(plan: Campaign | str | Path, model: Model = "paper", *, effects: Sequence[type[AbstractEffect]] = (),
                channels: Sequence[str] | None = None,
                uncertainties: Sequence[str] | None = None, values: Sequence[str] | None = None,
                length: str | None = None, interval: str | None = None, progress: Progress | None = None
                ) -> Visibility:
    """Say what a campaign could see, and what it could not tell apart, before any test of it.

    Args:
        plan: a campaign or its folder, of which conditions, times, noise and uncertainties count; or a table of planned
            tests (`read_plan`, which says what the other arguments are).
        model: reference model, see `ddetumble.inference.models`; a fitted folder brings its values.
        effects: of one's own, mapped beside the catalogue.
        channels, uncertainties, values, length, interval: of a table.
        progress: called with a sentence and the share done.

    Raises:
        InputError: plan or option make no sense.
        ComputationError: the reference model cannot be computed there.
    """
    report = progress or (lambda text, share: None)
    if not isinstance(plan, Campaign) and Path(plan).is_file():
        campaign, resolved = read_plan(plan, lambda family: resolve_model(model, family), channels=channels,
                                       uncertainties=uncertainties, values=values, length=length, interval=interval)
        planned = True
    else:
        campaign = plan if isinstance(plan, Campaign) else read_campaign(plan)
        resolved, planned = resolve_model(model, name_family(campaign)), False
    report("computing the reference model", 0.05)
    bench = pose_selection(campaign, resolved.reference, tuple(effects), resolved.effects)
    solution = _stand(bench, planned)
    count = len(bench.list_directions((), depth=float(solution.state.max())))
    goal = detectable_length(count)
    jobs = [(effect, f"{effect.id}.{p.name}", start) for effect in bench.catalogue for p in parameters_of(effect)
            if p.kind != "shape" for start in default_starts(effect)]
    done: list[int] = []

    def one(job):
        effect, name, start = job
        found = _find_size(bench, solution, effect, name, start, goal)
        done.append(1)
        report(f"looking for {effect.id}", 0.1 + 0.85 * len(done) / len(jobs))
        return found

    signatures = [s for s in map_threads(one, jobs) if s is not None]
    return _describe(bench, resolved.name, signatures, goal)


def _stand(bench: SelectionProblem, planned: bool) -> Solution:
    """The reference model at the values given, or at those guessed from samples that are there."""
    from ..inference.assembly import guess_start

    u = bench.start if planned else guess_start(bench.campaign, bench.space, bench.start, bench.base)
    solution = bench.problem.solve(bench.base, u, moving=False)
    if solution.failed:
        raise ComputationError(f"the reference model could not be integrated for record {solution.failed[0]!r}; check "
                               "its conditions and units")
    return solution


def _find_size(bench: SelectionProblem, solution: Solution, effect, name: str, start: dict[str, float], goal: float
               ) -> _Signature | None:
    """The size of one amplitude at which its signature has the wanted length."""
    origin = solution.u.copy()
    for n, v in start.items():
        if n.split(".", 1)[0] == effect.id and n != name:
            other = bench.space.slots[bench.space.index[n]].parameter
            origin[bench.space.index[n]] = v if other.kind == "shape" else other.default
    shapes = {n: float(origin[bench.space.index[n]]) for n in start
              if n != name and bench.space.slots[bench.space.index[n]].parameter.kind == "shape"}
    found = find_size(bench.problem, solution, origin, name, goal)
    return None if found is None else _Signature(effect.id, name, found.size, shapes, found.visible, found.column)


def _imitate(one: _Signature, others: Sequence[_Signature]) -> float:
    """Largest share (as a cosine) of a signature that another effect can take over, at any one of its shapes."""
    best = 0.0
    for shape in {tuple(sorted(o.shapes.items())) for o in others}:
        columns = np.stack([o.column for o in others if tuple(sorted(o.shapes.items())) == shape], axis=1)
        q, _ = np.linalg.qr(columns)
        best = max(best, float(np.linalg.norm(q.T @ one.column)))
    return min(best, 1.0)


def _describe(bench: SelectionProblem, model: str, signatures: Sequence[_Signature], goal: float) -> Visibility:
    """Plain records of what was found."""
    seen = [s for s in signatures if np.isfinite(s.size)]
    groups = {e.id: [s for s in seen if s.effect == e.id] for e in bench.catalogue}
    names = tuple(e for e, own in groups.items() if own)
    cosines = np.eye(len(names))
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            if i < j:
                both = [_imitate(s, groups[b]) for s in groups[a]] + [_imitate(s, groups[a]) for s in groups[b]]
                cosines[i, j] = cosines[j, i] = max(both)
    effects = []
    for effect in bench.catalogue:
        own = groups[effect.id]
        first = next(p for p in parameters_of(effect) if p.kind != "shape")
        if not own:
            unit = bench.space.unit(f"{effect.id}.{first.name}", bench.start)
            effects.append(Visible(effect.id, first.name, unit, None, {}, 0.0, None, 0.0, None, {}))
            continue
        sizes: dict[str, _Signature] = {}
        for s in own:
            if s.name not in sizes or _deviation(bench, s) < _deviation(bench, sizes[s.name]):
                sizes[s.name] = s
        best = min(sizes.values(), key=lambda s: _deviation(bench, s))
        k, p = names.index(effect.id), bench.space.slots[bench.space.index[best.name]].parameter
        row = np.where(np.arange(len(names)) == k, -1.0, cosines[k])
        near = int(np.argmax(row)) if len(names) > 1 else None
        cosine = 0.0 if near is None else float(row[near])
        told = max(float(np.sqrt(DEFAULT.decisive / (1.0 - cosine**2)) / goal), 1.0) if cosine < SAME else None
        if told is not None and told * abs(best.size - p.default) > reach_limit(p):
            told = None
        effects.append(Visible(
            effect.id, p.name, bench.space.unit(best.name, bench.start), p.transform.from_unconstrained(best.size),
            _publish(bench, best.shapes), best.visible, None if near is None else names[near], cosine, told,
            _publish(bench, {n: s.size for n, s in sizes.items()})))
    alike = tuple((names[i], names[j]) for i in range(len(names)) for j in range(i + 1, len(names))
                  if cosines[i, j] >= DEFAULT.collinear)
    sentence, notes = _explain(bench, effects, alike)
    return Visibility(bench.campaign.name, bench.family.name, model, bench.records.count,
                      int(bench.records.lengths.sum()), tuple(effects), names, cosines, goal, alike, sentence, notes)


def _deviation(bench: SelectionProblem, s: _Signature) -> float:
    """Size in typical changes of its parameter."""
    p = bench.space.slots[bench.space.index[s.name]].parameter
    return abs(s.size - p.default) / p.typical


def _publish(bench: SelectionProblem, shapes: dict[str, float]) -> dict[str, float]:
    return {n: bench.space.parameter(n).transform.from_unconstrained(v) for n, v in shapes.items()}


def _explain(bench: SelectionProblem, effects: Sequence[Visible], alike: Sequence[tuple[str, str]]
             ) -> tuple[str, tuple[str, ...]]:
    """The sentence of a map, and notes."""
    unseen = [e.effect for e in effects if e.size is None]
    seen = len(effects) - len(unseen)
    sentence = f"These {bench.records.count} records would show {seen} of {len(effects)} effects of the catalogue"
    sentence += f"; they cannot see {', '.join(unseen)}" if unseen else ""
    sentence += (f". They could not tell apart: {'; '.join(f'{a} and {b}' for a, b in alike)}: {bench.family.remedies}."
                 if alike else ". No two of these would look alike.")
    values = ", ".join(f"{n} {v['estimate']:.3g} {v['unit']}".rstrip().removesuffix(" 1") for n in bench.base
                       for v in [bench.space.public(n, bench.start, 0.0)])
    return sentence, (
        f"Found with 95 % power by the family-wise test of discover (level {DEFAULT.level_each:g}); noise white and "
        "as stated, nuisances as stated.",
        f"Two effects look alike from |cos| {DEFAULT.collinear:g} on; told apart from {DEFAULT.decisive:.0f} noise "
        "variances on.",
        *([f"The reference model stands at {values}, or where samples that are there put it."] if values else []),
        *bench.warnings)
