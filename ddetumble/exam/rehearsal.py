"""A rehearsal: a campaign of one's own, measured again and again by the model, with what it hides drawn each time.

The sealed exam draws its plans, and simulates them with another program. Here conditions, times, noise and
uncertainties are those of one campaign, so that one knows before the tests what `discover` would see in them; the
records are the model's own, and say nothing of how right its physics is.
"""

import dataclasses as dc
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.sparse.linalg import spsolve_triangular

from .._errors import ComputationError, InputError
from ..contact.effect import AbstractEffect, parameters_of
from ..families import name_family, open_campaign
from ..inference.archive import resolve_model
from ..inference.assembly import default_starts
from ..inference.models import list_effects
from ..inference.noise import whitening_matrix
from ..inference.problem import Solution
from ..measurement.campaign import Campaign
from ..measurement.package import write_campaign
from ..measurement.quantities import describe_quantity, format_plain
from ..planning.detectability import read_plan, tell_records
from ..selection.detectability import find_size
from ..selection.discover import discover
from ..selection.problem import SelectionProblem, fit_reference, pose_selection, require_computed
from .cases import COUNTS, STRONGEST, find_kind, mark_discovery


HIDDEN = ("nothing", "one", "two")  # unless a rehearsal says what
FAINTEST = 0.1  # strength: many samples show effects far below the noise of one
EDITION = 1  # of the drawing: another one asks other questions under the same seed


@dc.dataclass(frozen=True)
class Rehearsal:
    """What is rehearsed; two rehearsals that are equal ask the same.

    Attributes:
        plan: folder of a campaign, measured or not, or a table of planned tests.
        model: reference model by name, or folder of a fit.
        seed: of everything drawn.
        truths: kinds of what is hidden, out of COUNTS but `outside`.
        effects_from: file with effects of one's own, hidden and looked for beside the catalogue.
        channels, uncertainties, values, length, interval: of a table, see `ddetumble.planning.detectability.read_plan`.
    """

    plan: str
    model: str = "paper"
    seed: int = 0
    truths: tuple[str, ...] = HIDDEN
    effects_from: str | None = None
    channels: tuple[str, ...] = ()
    uncertainties: tuple[str, ...] = ()
    values: tuple[str, ...] = ()
    length: str | None = None
    interval: str | None = None

    def __post_init__(self):
        for kind in self.truths:
            if kind not in COUNTS or kind == "outside":
                why = "a rehearsal hides effects of the catalogue only; " if kind in COUNTS else ""
                raise InputError(f"{why}{kind!r} is none of {', '.join(COUNTS)}".removesuffix(", outside"),
                                 option="--truth")
        if self.seed < 0:
            raise InputError("the seed is a whole number from 0 on", option="--seed")

    @property
    def title(self) -> str:
        """What it is a rehearsal of."""
        return f"Rehearsal of {Path(self.plan).stem}"

    @property
    def setting(self) -> str:
        """How its cases are drawn."""
        return (f"The records are those of {Path(self.plan).name}, as the model {Path(self.model).name!r} has them: "
                f"its conditions within their uncertainties, its times and its noise. Drawn from seed {self.seed}: "
                f"hidden {', '.join(self.truths)}. Strength is the rms over the noise that a refitted reference model "
                "leaves, settings that it moves counted by their uncertainties. The simulator is the model's own: what "
                "is wrong with the physics itself shows in measured records only.")

    @property
    def options(self) -> str:
        """The command line's options that mean it."""
        text = f"--plan {self.plan} --seed {self.seed}"
        text += "".join(f" --truth {kind}" for kind in self.truths if self.truths != HIDDEN)
        for option, values in (("model", () if self.model == "paper" else (self.model,)), ("channel", self.channels),
                               ("uncertainty", self.uncertainties), ("value", self.values),
                               ("length", (self.length,)), ("interval", (self.interval,)),
                               ("effects-from", (self.effects_from,))):
            text += "".join(f" --{option} {value!r}" for value in values if value is not None)
        return text

    def list_tests(self) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[str, ...]]] | None:
        """What is said of the plan, and a table of its tests, header and rows, equal ones in one; None where it is not
        there any more."""
        try:
            campaign = prepare_plan(self).selection.campaign
        except InputError:
            return None
        names = [str(name) for name in campaign.records.columns]
        shown = [describe_quantity(name, campaign.records[name].to_numpy(dtype=float),
                                   unit=campaign.conditions[name].unit) for name in names]
        rows = Counter(
            tuple(format_plain(float(f"{value * one.scale:.4g}")) for value, one in zip(row, shown, strict=True))
            for row in campaign.records.to_numpy(dtype=float))
        header = (*(f"{one.name} [{one.unit}]" if one.unit else one.name for one in shown), "records")
        return (tell_records(campaign),), header, [(*row, str(count)) for row, count in rows.items()]

    def draw(self, index: int) -> tuple[dict[str, Any], Callable[[Path], Iterator[dict[str, Any]]]]:
        """Fields of the row of a case, to which the others do not matter, and what answers it in a folder."""
        bench = prepare_plan(self)
        random, (kind, _) = np.random.default_rng([EDITION, self.seed, index]), find_kind(self, index)
        hidden, space = hide_effects(bench, COUNTS[kind], random), bench.selection.space
        u = bench.solution.u.copy()
        for at, _, _ in hidden.values():
            for name, value in at.items():
                u[space.index[name]] = value

        def publish(names) -> dict[str, float]:
            return {name: float(space.public(name, u, 0.0)["estimate"]) for name in names}

        row: dict[str, Any] = {
            "index": index, "kind": kind, "effects": {
                effect: {name.split(".", 1)[1]: value for name, value in publish(at).items()}
                for effect, (at, _, _) in hidden.items()},
            "asked": {effect: strength for effect, (_, strength, _) in hidden.items()},
            "strengths": {effect: reached for effect, (_, _, reached) in hidden.items()},
            "noise": {"rho": max((n.correlation for n in bench.selection.noise.values()), default=0.0)}, "fault": None}
        truth = publish([*bench.selection.base, *(name for at, _, _ in hidden.values() for name in at)])
        return row, partial(answer_case, self, u, truth, random)

    def to_dict(self) -> dict[str, Any]:
        """Its fields as files keep them."""
        return dc.asdict(self)


class Prepared(NamedTuple):
    """A plan that is ready to be measured."""

    selection: SelectionProblem  # its conditions, times and noise
    solution: Solution  # the reference model, as fitted, or at the values given
    own: tuple[type[AbstractEffect], ...]  # effects of the user


@lru_cache(maxsize=1)
def prepare_plan(asked: Rehearsal) -> Prepared:
    """Read the plan once a process.

    Raises:
        InputError: plan or option make no sense.
        ComputationError: the reference model cannot be computed there.
    """
    own = tuple(list_effects(Path(asked.effects_from))) if asked.effects_from else ()
    if Path(asked.plan).is_file():
        campaign, resolved = read_plan(asked.plan, asked.model, channels=asked.channels or None,
                                       uncertainties=asked.uncertainties, values=asked.values, length=asked.length,
                                       interval=asked.interval)
        selection = pose_selection(campaign, resolved.reference, own, resolved.effects)
        solution = selection.problem.solve(selection.base, selection.start, moving=False)
        return Prepared(selection, require_computed(selection, solution), own)
    campaign = open_campaign(asked.plan)
    resolved = resolve_model(asked.model, name_family(campaign))
    selection, fitted = fit_reference(pose_selection(campaign, resolved.reference, own, resolved.effects))
    return Prepared(selection, fitted.solution, own)


def hide_effect(bench: Prepared, effect: type[AbstractEffect], random: np.random.Generator
                ) -> tuple[dict[str, float], float, float] | None:
    """Coordinates of an effect's parameters, the strength drawn for it and the one reached; None where it has none.

    One of its amplitudes departs from the null, at one of the shapes from which fits begin.
    """
    selection, solution = bench.selection, bench.solution
    name = str(random.choice(selection.list_amplitudes(effect.id)))
    starts = default_starts(effect)
    start = starts[int(random.integers(len(starts)))]
    strength = float(np.exp(random.uniform(np.log(FAINTEST), np.log(STRONGEST))))
    origin, at = solution.u.copy(), {}
    for p in parameters_of(effect):
        own = f"{effect.id}.{p.name}"
        shape = p.kind == "shape"
        at[own] = start.get(own, p.transform.from_field(p.default)) if shape else p.transform.from_field(p.default)
        origin[selection.space.index[own]] = at[own]
    found = find_size(selection.problem, solution, origin, name, strength * np.sqrt(selection.samples), jumps=True)
    if found is None or not np.isfinite(found.size):
        return None
    at[name] = found.size
    return at, strength, float(found.length / np.sqrt(selection.samples))


def hide_effects(bench: Prepared, count: int, random: np.random.Generator
                 ) -> dict[str, tuple[dict[str, float], float, float]]:
    """So many effects of the catalogue, by their ids, in a random order; what the plan cannot show is passed by."""
    catalogue, found = bench.selection.catalogue, {}
    for k in random.permutation(len(catalogue)):
        if len(found) == count:
            break
        one = hide_effect(bench, catalogue[int(k)], random)
        if one is not None:
            found[catalogue[int(k)].id] = one
    return found


def measure_plan(bench: Prepared, u: np.ndarray, random: np.random.Generator) -> Campaign:
    """The campaign as it would be measured once: settings as wrong as stated, readings as noisy as they are.

    `u` are coordinates of all parameters, shape (parameters,). What a tumbling body starts from stays as it is.

    Raises:
        ComputationError: the model cannot be computed there.
    """
    selection, records = bench.selection, bench.selection.records
    u, z = u.copy(), random.standard_normal(bench.solution.z.shape)
    z[:, : len(records.starts)] = bench.solution.z[:, : len(records.starts)]
    for name, (_, sd) in selection.problem.priors.items():
        if name in {common.slot.name for common in selection.space.commons}:
            u[selection.space.index[name]] = sd * random.standard_normal()
    clean = selection.problem.solve([], u, z, moving=False)
    if clean.failed:
        raise ComputationError(f"the model could not be integrated for record {clean.failed[0]!r}")
    stack, samples = records.stack, []
    for r, key in enumerate(records.keys):
        frame, n = selection.campaign.trace(key).copy(), int(records.lengths[r])
        for c, channel in enumerate(records.channels):
            weights, taps = np.asarray(stack.weights[r, c, :n]), np.asarray(stack.taps[r, c, :n])
            used, shocks = weights > 0, random.standard_normal(n)
            noise = shocks * np.median(1.0 / weights[used]) if used.any() else np.zeros(n)
            noise[used] = spsolve_triangular(whitening_matrix(weights, taps)[used][:, used].tocsr(), shocks[used])
            there = np.isfinite(frame[channel].to_numpy(dtype=float))
            frame[channel] = np.where(there, clean.channels[r, c, :n] + noise, np.nan)
        samples.append(frame.assign(record=key))
    return dc.replace(selection.campaign, samples=pd.concat(samples, ignore_index=True))


def answer_case(asked: Rehearsal, u: np.ndarray, truth: Mapping[str, float], random: np.random.Generator, folder: Path
                ) -> Iterator[dict[str, Any]]:
    """Further fields of a row: what `discover` says of the plan measured once, beside the true parameters.

    `u` are coordinates of all parameters, shape (parameters,).
    """
    bench = prepare_plan(asked)
    campaign = measure_plan(bench, u, random)
    found = discover(campaign, asked.model, effects=bench.own)
    write_campaign(folder / "campaign", campaign, overwrite=True)
    found.save(folder / "discovery")
    yield mark_discovery(found, truth)
