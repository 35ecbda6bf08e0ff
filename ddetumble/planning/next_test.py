"""The next test: conditions, or a channel to add, that best tell apart what a campaign could not."""

import dataclasses as dc
import json
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import minimize
from scipy.stats import qmc

from .._display import Progress
from .._errors import ComputationError, InputError, error_place
from .._sentences import say, tell
from ..contact.effect import MEASURING
from ..dynamics.impact import compare_energy
from ..families import find_family, list_families
from ..inference.archive import AbstractFitted, FittedModel, load, take_fitted
from ..inference.files import AbstractWritten, list_fields, list_versions, make_plain
from ..measurement.quantities import describe_quantity, format_plain, format_value, join_words
from ..measurement.units import parse_quantity
from ..posterior.stacking import list_numbered, read_discovery
from ..selection.discovery import Discovery
from ..selection.predict import SQUEEZED, UNSTATED, find_squeezes, take_ball
from ..selection.result import EXPLANATIONS, OPEN, RESULT
from ..selection.settings import DEFAULT
from .distinguishability import (
    Distances,
    Preview,
    contrast,
    count_repeats,
    part_rivals,
    preview_test,
    profile_nuisances,
    separate,
    value_information,
    value_separation,
)
from .setting_ranges import Extra, Limit, Range, list_extras, set_limits


MOST = 30  # repeats beyond which a test is no proposal: nobody makes more
STEPS = 15  # of the refit that checks a separation: more end a difficult refit, at the price of time
LITTLE = 0.1  # of a standard deviation, by which the best test has to narrow one to be called worth making
SLACK = 0.02  # of its value, by which a condition may leave the measured range before this is told, as in predictions
EDGE = 5e-3  # fraction of its range within which a condition stands at a limit: what an optimiser leaves of it
# Tests that climb together, and those looked at before the climb: more find a better one more often, at their price.
STARTS, SCAN = 8, 32
CLIMB = 20  # iterations: more refine the optimum, at the price of time
CLOSE = 0.9  # of the depression up to which the contact geometry holds, from which the search is said to stop there
# Of a test in which the ball is pressed farther than its geometry holds: so high that the climb ends at the border, and
# the share of the energy [1] by which it stays inside of it, so that rounded conditions do so too.
PENALTY, INSIDE = 1e3, 0.03
ROUNDS, SHRINK = 4, 0.45  # of the search without a gradient: in them its step shrinks to 4 % of the first

Fitted = AbstractFitted | FittedModel
Excess = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # values and slopes of tests, of `_measure_excess`


@dc.dataclass(frozen=True)
class Pair:
    """Two rivals at a proposed test."""

    first: str  # name
    second: str
    # What one such test leaves between them after either is refitted, the smaller of both ways [standard deviations of
    # the noise].
    distance: float
    repeats: int | None  # of the test until they are told apart; None where no number that can be measured is enough


@dc.dataclass(frozen=True)
class Narrowing:
    """How a proposed test narrows one parameter: standard deviation before and after it, in its public unit."""

    name: str
    unit: str
    before: float
    after: float

    @property
    def gained(self) -> float:
        """By which fraction the standard deviation falls."""
        return 1.0 - self.after / self.before

    def __str__(self) -> str:
        before, after = (format_value(sd, sd) for sd in (self.before, self.after))
        return f"{self.name} from ± {before} to ± {after} {self.unit}".rstrip()


@dc.dataclass(frozen=True)
class Proposal:
    """One test."""

    conditions: Mapping[str, float]  # SI, by name
    measured: Mapping[str, tuple[float, float]]  # ranges of the campaign, SI, of those conditions that lie outside them
    extra: Extra | None  # channel to add, or None
    pairs: tuple[Pair, ...]  # of rivals, the worst first; empty where there is one model only
    repeats: int | None  # after which every pair that can be told apart is; None where no pair can
    at_limit: tuple[str, ...]  # conditions that stand at a limit
    narrowings: tuple[Narrowing, ...]  # of the parameters, where there is one model only, the most narrowed first
    time: np.ndarray = dc.field(repr=False)  # samples of the test [s or m], shape (samples,)
    channels: tuple[str, ...]  # names
    # Predicted channels by rival, each shape (channels, samples), SI.
    curves: Mapping[str, np.ndarray] = dc.field(repr=False)
    noise: Mapping[str, float]  # standard deviation of one sample by channel, SI

    @property
    def split(self) -> int:
        """How many pairs it tells apart."""
        return sum(pair.repeats is not None for pair in self.pairs)


@dc.dataclass(frozen=True)
class Calibration:
    """What a calibration of the gauge of one setting would decide."""

    setting: str  # name of the condition
    bias: float  # share by which it reads too high where the rival with this error is true, and its deviation
    sd: float
    needed: float  # standard deviation of the calibration, as a share, that tells this from no error by `decisive`


@dc.dataclass(frozen=True)
class Question:
    """What the next test is to decide.

    Attributes:
        rivals: models to tell apart; a single one where its parameters are to be narrowed.
        names: of these.
        verdict: of the discovery, `fit` where there is none.
        calibrations: of the settings whose error one of the rivals is.
        reason: why an undecided verdict is so, as `result.json` has it.
        records: that are to be repeated first.
    """

    rivals: tuple[FittedModel, ...]
    names: tuple[str, ...]
    verdict: str
    calibrations: tuple[Calibration, ...] = ()
    reason: str = ""
    records: tuple[str, ...] = ()


@dc.dataclass(frozen=True)
class Design(AbstractWritten):
    """What to measure next; `to_dict()` is `design.json`."""

    file: ClassVar[str] = "design.json"
    campaign: str  # of the discovery or fit, as the next two
    family: str
    verdict: str
    rivals: tuple[str, ...]  # names of the models that cannot be told apart; one where nothing is confounded
    limits: tuple[Limit, ...]  # within which the test was chosen
    proposals: tuple[Proposal, ...]  # the one to take first
    target: float  # noise variances between two rivals from which they count as told apart
    sentence: str  # what to do, in plain words
    calibrations: tuple[Calibration, ...] = ()  # that decide as well, where an error of a setting is among the rivals
    reason: str = ""  # why an undecided verdict is so, where no two models are left between which it is
    notes: tuple[str, ...] = ()  # further sentences

    def __str__(self) -> str:
        """The outcome for a terminal."""
        return "\n".join((self.sentence, *(f"- {note}" for note in self.notes)))

    def to_dict(self) -> dict[str, Any]:
        """Everything but the curves, as JSON can hold it."""
        proposals = [list_fields(one, "time", "channels", "curves") for one in self.proposals]
        return make_plain({**list_fields(self), "proposals": proposals, "versions": list_versions()})


def design(models: str | Path | Fitted | Sequence[str | Path | Fitted], *,
           limits: Mapping[str, Range] | Sequence[str] | None = None,
           channels: Mapping[str, str] | Sequence[str] | None = None, length: str | float | None = None,
           progress: Progress | None = None) -> Design:
    """Find the test that best distinguishes the models that a discovery could not.

    Of each pair of rivals it is asked how far their predictions of the test stay apart when either is refitted, with
    the old campaign as prior and the test's own conditions and time origin free within their uncertainty. The mean of
    ln(1 + squared distance) over the pairs is climbed by its gradient through both models. Two rivals count as told
    apart from 50 noise variances on: then `discover` drops the worse one. Where a verdict leaves open whether an effect
    is missing or a setting is wrong alike in all records, these are the rivals, and the calibration that decides is
    told beside the test. Where nothing is confounded, the test that narrows the parameters most is sought.

    Args:
        models: what `discover` or `fit` returned, or a folder that they wrote; or several of these, of one campaign.
        limits: `NAME=LOW..HIGH UNIT` or `NAME=VALUE UNIT`, or by condition `"0.2..2 m/s"`, `("0.2 m/s", "2 m/s")` or
            (low, high) in SI; the campaign's range, extended, elsewhere.
        channels: `NAME: NOISE UNIT` of channels that could be added; the usual ones where not given.
        length: of the test's record in its independent variable, `"30 ms"` or in SI; as in the campaign where not
            given.
        progress: called with a sentence and the share done.

    Raises:
        InputError: there is no fitted model, or an option makes no sense.
        ComputationError: a rival could not be integrated anywhere within the limits.
    """
    question = list_confused(models)
    rivals, names = question.rivals, question.names
    single = len(question.rivals) == 1
    if isinstance(length, str):
        with error_place(option="length"):
            length = parse_quantity(length, rivals[0].space.family.independent)
    if length is not None and not length > 0:
        raise InputError(f"the length of a record must be positive, not {length:g}")
    chosen, extras = set_limits(rivals[0], limits), list_extras(rivals[0], channels)
    # A further record scatters as those of a single model do: it is judged by what the noise alone tells.
    plain = (rivals[0].without_scatter(),) if single else rivals
    preview = preview_test(plain, chosen, extras, length=length)
    excess = _measure_excess(preview, rivals[0])
    proposals: list[Proposal] = []
    for k, extra in enumerate((None, *extras)):
        if extra is not None and channels is None and proposals[0].split == len(proposals[0].pairs) > 0:
            break  # no further channel is needed, and none was asked for
        if progress is not None:
            what = "the test" if extra is None else f"a test with {extra.name}"
            progress(f"looking for {what}", 0.1 + 0.85 * k / (1 + len(extras)))
        mask = np.array([c in rivals[0].channels or (extra is not None and c in extra.channels)
                         for c in preview.channels], dtype=float)
        x, worth = search_conditions(preview, mask, excess)
        if worth <= 0.0 and part_rivals(preview, x[None], mask, 0).failed.any():
            raise ComputationError("the models could not be integrated within these limits: check them")
        proposals.append(_propose(preview, mask, x, extra, names, rivals[0]))
    # The campaign's own channels first among those that tell as many pairs apart by as few repeats.
    ranked = sorted(proposals, key=lambda one: (-one.split, one.repeats or 0, one.extra is not None))
    found = Design(rivals[0].campaign, rivals[0].family, question.verdict, names, chosen, tuple(ranked),
                   DEFAULT.decisive, "", question.calibrations, question.reason if single else "")
    return _explain(found, question)


def list_confused(models: str | Path | Fitted | Sequence[str | Path | Fitted]) -> Question:
    """What is to be told apart: the models between which a verdict leaves open, else the best model and its rivals,
    else those that were given. Refused where there is no fitted model, the rivals were not written, or they are of
    several campaigns.
    """
    if isinstance(models, (str, Path)) and (Path(models) / RESULT).is_file():
        return _read_question(Path(models))
    if isinstance(models, Discovery):
        rivals = [one.fitted_model() for one in models.explanation_fits] or [
            models.fitted_model(), *(one.fitted_model() for one in models.rivals)]
        return _ask(rivals, models.verdict, [one.setting for one in models.explanations], models.reason,
                    [fault.records for fault in models.faults if fault.kind == "doubtful"])
    found = [take_fitted(one) for one in (
        models if isinstance(models, Sequence) and not isinstance(models, str) else [models])]
    twice = [str(one.folder) for k, one in enumerate(found)
             if one.folder and any(one.folder == other.folder for other in found[:k])]
    if twice:
        raise InputError(f"{twice[0]} is given twice; nothing parts a model from itself")
    if len({(one.sha256, type(one.space.reference)) for one in found}) != 1:
        raise InputError("the models must be fits to one campaign that extend one reference model")
    return _ask(found, "fit" if len(found) == 1 else "undecided")


def _read_question(folder: Path) -> Question:
    """The same of a folder that `discover` wrote."""
    rivals, verdict = read_discovery(folder)
    content = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    places, expected = list_numbered(folder, EXPLANATIONS), content.get("explanations", ())
    if len(places) < len(expected):
        raise InputError("the models between which the verdict leaves open are not in this folder; run discover again",
                         file=folder)
    rivals = [*map(load, places[: len(expected)])] or rivals
    doubtful = [one["records"] for one in content.get("faults", ()) if one["kind"] == "doubtful"]
    return _ask(rivals, verdict, [one["setting"] for one in expected], content.get("reason", ""), doubtful)


def _ask(rivals: Sequence[FittedModel], verdict: str, settings: Sequence[str | None] = (), reason: str = "",
         doubtful: Sequence[Sequence[str]] = ()) -> Question:
    """The question that models put, with their names and the calibrations that would answer it; `settings` are those
    whose error is a parameter of each model that explains an open verdict."""
    names, calibrations = [], []
    for one, setting in zip_longest(rivals, settings):
        parts = list(one.effects)
        if setting is not None:
            parts.append(f"an error of the {describe_quantity(setting).name}")
            name = f"{setting}_shift"
            k = one.free.index(name)
            bias, sd = -float(one.u[one.space.index[name]]), float(np.sqrt(max(one.covariance[k, k], 0.0)))
            needed = abs(bias) / float(np.sqrt(DEFAULT.decisive))
            calibrations.append(Calibration(setting, bias, sd, needed))
        names.append(" + ".join(parts) or one.model)
    # Two fits of one model in different folders are told apart by these.
    names = [f"{name} ({k + 1})" if names.count(name) > 1 else name for k, name in enumerate(names)]
    return Question(tuple(rivals), tuple(names), verdict, tuple(calibrations), reason,
                    tuple(record for records in doubtful for record in records))


def _measure_excess(preview: Preview, saved: FittedModel) -> Excess | None:
    """Of tests at fractions of the free limits, shape (tests, free): the logarithm of the energy over that which
    presses the ball as far as its geometry holds, and its slopes; None where there is no ball.
    """
    law = take_ball(saved)
    if law is None or "approach_speed" not in preview.names:
        return None

    def measure(x: Array) -> Array:
        values = preview.place(x)
        conditions = {name: jnp.asarray(value) for name, value in UNSTATED.items()}
        conditions |= {name: values[k] for k, name in enumerate(preview.names)}
        return jnp.log(compare_energy(law, conditions, SQUEEZED)) + INSIDE

    compiled = jax.jit(jax.vmap(jax.value_and_grad(measure)))

    def excess(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = compiled(jnp.asarray(x))
        return np.maximum(np.asarray(value), 0.0), np.where(np.asarray(value)[:, None] > 0, np.asarray(slope), 0.0)

    return excess


def search_conditions(preview: Preview, mask: np.ndarray, excess: Excess | None = None) -> tuple[np.ndarray, float]:
    """The conditions that are worth most, as fractions of the free limits, and the worth there (0 where nothing could
    be computed); `mask` is 1 for channels that count. Of each test `PENALTY` times the square of its `excess` is taken,
    if given.

    Of rivals: L-BFGS-B on the separation, from the best conditions of a scan. All starts climb together: their sum is
    one objective whose gradient falls apart into theirs, so that one compiled program serves every step. Of one model:
    the gain of information, whose gradient would need second derivatives, by a scan that closes in on its best.
    """
    free, alone = len(preview.free), preview.base.shape[0] == 1

    def value(x: np.ndarray) -> np.ndarray:
        worth = value_information(preview, x, mask) if alone else value_separation(part_rivals(preview, x, mask))[0]
        return worth if excess is None else worth - PENALTY * excess(x)[0] ** 2

    if free == 0:
        return np.zeros(0), float(value(np.zeros((1, 0)))[0])
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * free)).reshape(free, -1).T
    places = np.concatenate([corners, qmc.Sobol(free, scramble=False).random(SCAN)])[:SCAN]
    values = value(places)
    if alone:
        return _close_in(value, places, values)
    starts = places[np.argsort(-values, kind="stable")[:STARTS]]

    def loss(flat):
        x = flat.reshape(starts.shape)
        worth, slope = value_separation(part_rivals(preview, x, mask))
        if excess is not None:
            over, change = excess(x)
            worth, slope = worth - PENALTY * over**2, slope - 2.0 * PENALTY * over[:, None] * change
        return -float(worth.sum()), -slope.ravel()

    found = minimize(loss, np.clip(starts, 1e-3, 1.0 - 1e-3).ravel(), jac=True, method="L-BFGS-B",
                     bounds=[(0.0, 1.0)] * starts.size, options={"maxiter": CLIMB})
    ends = np.concatenate([found.x.reshape(starts.shape), starts])
    worth = value(ends)
    best = int(np.argmax(worth))
    return ends[best], float(worth[best])


def _close_in(value: Callable[[np.ndarray], np.ndarray], places: np.ndarray, values: np.ndarray
              ) -> tuple[np.ndarray, float]:
    """A scan repeated in ever smaller boxes about its best."""
    pattern, best = qmc.Sobol(places.shape[1], scramble=False).random(2 * STARTS) - 0.5, int(np.argmax(values))
    x, worth = places[best], float(values[best])
    for turn in range(1, ROUNDS + 1):
        near = np.clip(x + SHRINK**turn * pattern, 0.0, 1.0)
        found = value(near)
        if found.max() > worth:
            x, worth = near[int(np.argmax(found))], float(found.max())
    return x, worth


def _propose(preview: Preview, mask: np.ndarray, x: np.ndarray, extra: Extra | None, names: tuple[str, ...],
             saved: FittedModel) -> Proposal:
    """One proposal at fractions `x` of the free limits, conditions rounded to what one would set."""
    x = _round_fractions(preview, x)
    values = np.asarray(preview.place(jnp.asarray(x)))
    found = part_rivals(preview, x[None], mask, STEPS)
    pairs = [_compare(found, i, j, names) for i in range(len(names)) for j in range(i)]
    pairs.sort(key=lambda pair: pair.distance)
    edge = tuple(preview.names[k] for k, one in zip(preview.free, x, strict=True) if one < EDGE or one > 1 - EDGE)
    kept = [c for c, used in enumerate(mask) if used > 0]
    channels = tuple(preview.channels[c] for c in kept)
    noise = {} if extra is None else dict.fromkeys(extra.channels, extra.sd)
    conditions = {name: float(v) for name, v in zip(preview.names, values, strict=True)}
    return Proposal(
        conditions, saved.exceeded(conditions, SLACK), extra, tuple(pairs),
        max((pair.repeats for pair in pairs if pair.repeats is not None), default=None), edge,
        _narrow(saved, found) if len(names) == 1 else (), np.asarray(preview.time), channels,
        {name: found.at.channels[k][kept] for k, name in enumerate(names)},
        {c: noise[c] if c in noise else saved.noise[c].sd for c in channels})


def _round_fractions(preview: Preview, x: np.ndarray) -> np.ndarray:
    """Fractions of the limits at which conditions have three digits, within the limits."""
    values, found = np.asarray(preview.place(jnp.asarray(x))), np.array(x, dtype=float)
    for k, place in enumerate(preview.free):
        low, high = float(preview.low[place]), float(preview.high[place])
        value = float(np.clip(float(f"{values[place]:.3g}"), low, high))
        if bool(preview.logarithmic[place]):
            low, high, value = np.log(low), np.log(high), np.log(value)
        found[k] = np.clip((value - low) / (high - low), 0.0, 1.0)
    return found


def _compare(found: Distances, i: int, j: int, names: tuple[str, ...]) -> Pair:
    """How far two rivals stay apart, and after how many repeats they are told apart, whichever is true."""
    distances, repeats = [], []
    keep = found.rows[0]
    for true, fitted in ((i, j), (j, i)):
        difference = (found.at.reading[true] - found.at.reading[fitted]) * keep
        linear = contrast(difference, found.at.shared[fitted] * keep[:, None], found.at.own[fitted] * keep[:, None])
        one, real = float(separate(linear)), float(found.squares[found.pairs.index((true, fitted)), 0])
        # What a refit leaves that bends as the model really does, for any number of repeats.
        left = min(max(real / one, 0.0), 1.0) if one > 0 else 1.0
        distances.append(one * left)
        repeats.append(count_repeats(linear, DEFAULT.decisive / left, MOST) if left > 0 else None)
    known = [r for r in repeats if r is not None]
    return Pair(names[j], names[i], float(np.sqrt(max(min(distances), 0.0))), max(known) if len(known) == 2 else None)


def _narrow(saved: FittedModel, found: Distances) -> tuple[Narrowing, ...]:
    """What one test makes of the standard deviations of a single model's parameters, which scatter widens alike before
    and after."""
    keep, spread = found.rows[0][:, None], saved.without_scatter().spread()
    moved = np.asarray(profile_nuisances(found.at.shared[0] * keep, found.at.own[0] * keep))[:, : len(spread)]
    covariance = spread.T @ np.linalg.solve(np.eye(len(spread)) + moved.T @ moved, spread)
    narrowed = []
    for name in saved.free:
        k = saved.space.index[name]
        wider = saved.widened.get(name, 1.0)
        before, after = wider * float(np.linalg.norm(spread[:, k])), wider * float(np.sqrt(max(covariance[k, k], 0.0)))
        if before > 0:
            old, new = (saved.space.public(name, saved.u, sd) for sd in (before, after))
            narrowed.append(Narrowing(name, str(old["unit"]), float(old["sd"]), float(new["sd"])))
    return tuple(sorted(narrowed, key=lambda n: n.after / max(n.before, 1e-300)))


def _explain(found: Design, question: Question) -> Design:
    """With its sentence, and notes on what was assumed and what else there is."""
    best, *others = found.proposals
    gauges = [{e.id for e in one.space.effects if e.stage in MEASURING} for one in question.rivals]
    sensors = sorted(set.union(*gauges) - set.intersection(*gauges))  # what is in all of them parts none
    sentence = say("plan.next_test", rivals=found.rivals, verdict=found.verdict, best=best,
                   test=describe_test(best, found.limits), more=find_family(found.family).plan.added, most=MOST,
                   decisive=DEFAULT.decisive, little=LITTLE, reason=found.reason, few=question.reason == "conditions",
                   records=question.records,
                   lacking=found.verdict in OPEN or (found.verdict == "fit" and question.rivals[0].misfit is not None),
                   sensors=sensors if len(found.rivals) > 1 else [],
                   calibrations=[(describe_quantity(one.setting).name, one.bias > 0, abs(one.bias), one.needed)
                                 for one in found.calibrations],
                   distinguished=group_pairs([pair for pair in best.pairs if pair.repeats is not None]),
                   left=group_pairs([pair for pair in best.pairs if pair.repeats is None]))
    pressure, stated = find_family(found.family).kind.pressure, question.rivals[0].ambient_pressure
    ambient = say_value(pressure, stated, "Pa") if stated and pressure in best.conditions else ""
    notes = tell(
        "plan.next_test_notes", best=best, ambient=ambient, decisive=DEFAULT.decisive,
        others=[(one, describe_test(one, found.limits)) for one in others],
        alone=len(found.rivals) == 1, most=MOST,
        apart=bool(found.calibrations) and any(one.extra is not None for one in found.proposals),
        ranges=[_describe_limit(one) for one in found.limits if one.free],
        held=[_describe_limit(one) for one in found.limits if not one.free], at_limit=best.at_limit,
        assumed=[f"{one.extra.name} {one.extra.sd:g} {one.extra.unit}".removesuffix(" 1") for one in found.proposals
                 if one.extra is not None and one.extra.assumed])
    if any(one.misfit is None for one in question.rivals):  # the campaign itself tells them apart
        notes += [f"{name} leaves {one.misfit:.3g} times the noise on their campaign, which speaks against it already."
                  for name, one in zip(question.names, question.rivals, strict=True) if one.misfit is not None]
    conditions = {name: np.array([value]) for name, value in best.conditions.items()}
    squeezes = find_squeezes(question.rivals[0], ["next"], conditions)
    notes += [f"The contact geometry is valid up to {SQUEEZED:.0%} of the diameter, but {squeeze} in this test, which "
              "the model does not describe: raise the lowest pressure, or lower the highest speed (`--limit`)."
              for squeeze in squeezes]
    if not squeezes and find_squeezes(question.rivals[0], ["next"], conditions, CLOSE * SQUEEZED):
        notes.append("At a lower pressure or a higher speed the ball would be pressed together by more than "
                     f"{SQUEEZED:.0%} of its diameter, where its contact geometry does not hold: the search kept away.")
    return dc.replace(found, sentence=str(sentence), notes=tuple(notes))


def group_pairs(pairs: Sequence[Pair]) -> list[tuple[str, tuple[str, ...], int]]:
    """Pairs in groups, each pair once: the name in most pairs, those on the other side of these, and after how many
    tests the last of them is distinguished (0 where none is); then the same of the pairs that are left. Of names in
    equally many pairs the one whose last pair needs fewer tests is taken. Groups are sorted by that number, the lowest
    first.
    """
    groups, rest = [], list(pairs)
    while rest:
        names = [name for pair in rest for name in (pair.first, pair.second)]
        worst = {name: max(pair.repeats or 0 for pair in rest if name in (pair.first, pair.second)) for name in names}
        chosen = max(dict.fromkeys(names), key=lambda name: (names.count(name), -worst[name]))
        own = [pair for pair in rest if chosen in (pair.first, pair.second)]
        groups.append((chosen, tuple(pair.second if pair.first == chosen else pair.first for pair in own),
                       worst[chosen]))
        rest = [pair for pair in rest if pair not in own]
    return sorted(groups, key=lambda group: group[2])


def describe_test(proposal: Proposal, limits: Sequence[Limit], *, ranges: bool = True) -> str:
    """`at pressure 0.6 MPa and approach speed 0.9 m/s (outside the measured 0.2 to 0.5 m/s), with the channel pressure
    added`; without the measured `ranges` where they are not wanted.
    """
    named = {limit.name: limit for limit in limits}
    chosen = {name for one in list_families() for name in one.plan.chosen}
    beyond = {n: f" (outside the measured {_say_range(n, *ends, named[n].unit)})"
              for n, ends in proposal.measured.items() if ranges}
    at = join_words([f"{describe_quantity(n).name} {say_value(n, value, named[n].unit)}{beyond.get(n, '')}"
                     for n, value in proposal.conditions.items()
                     if n != "sequence" and (named[n].free or n in chosen)])
    extra = proposal.extra
    added = "" if extra is None else (
        f", with the channel {extra.name} (noise {format_plain(extra.sd)} {extra.unit}) added".replace(" 1)", ")"))
    return (f"at {at}" if at else "once more") + added


def say_value(name: str, value: float, unit: str) -> str:
    """A condition with its unit, in the unit that people use."""
    shown = describe_quantity(name, unit=unit)
    return f"{format_plain(value * shown.scale)} {shown.unit}".rstrip()


def _describe_limit(limit: Limit) -> str:
    return f"{describe_quantity(limit.name).name} {_say_range(limit.name, limit.low, limit.high, limit.unit)}"


def _say_range(name: str, low: float, high: float, unit: str) -> str:
    """A range of a condition, a single value where its ends are one."""
    first, last = (say_value(name, end, unit) for end in (low, high))
    return f"{first.split()[0]} to {last}" if low < high else last
