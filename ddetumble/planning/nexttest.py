"""The next test: conditions, or a channel to add, that best tell apart what a campaign could not."""

import dataclasses as dc
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from .._errors import ComputationError, InputError
from ..inference.archive import FILE as MODEL
from ..inference.archive import AbstractFitted, FittedModel, load, take_fitted
from ..selection.discovery import Discovery
from ..selection.result import RESULT, RIVALS
from ..selection.settings import DEFAULT
from .limits import Extra, list_extras, set_limits
from .preview import Layout, Test, place_conditions, prepare
from .proposals import Design, Narrowing, Pair, Proposal
from .refits import Distances, part_rivals
from .search import search_conditions
from .separation import contrast, count_repeats, profile_nuisances, separate
from .wording import explain_design


MOST = 30  # repeats beyond which a test is no proposal
STEPS = 15  # of the refit that checks a separation
EDGE = 5e-3  # share of its range within which a condition stands at a limit

Progress = Callable[[str, float], None]
Fitted = AbstractFitted | FittedModel


def design(models: str | Path | Fitted | Sequence[Fitted], *, limits: Mapping[str, str] | Sequence[str] | None = None,
           channels: Mapping[str, str] | Sequence[str] | None = None, length: float | None = None,
           progress: Progress | None = None) -> Design:
    """Find the test that best tells apart what a discovery could not.

    Of each pair of rivals it is asked how far their predictions of the test stay apart when either is refitted, with
    the old campaign as prior and the test's own conditions and time origin free within their uncertainty. The mean of
    ln(1 + squared distance) over the pairs is climbed by its gradient through both models. Two rivals count as told
    apart from 50 noise variances on: then `discover` drops the worse one. Where nothing is confounded, the test
    that narrows the parameters most is sought.

    Args:
        models: what `discover` or `fit` returned, several fits of one campaign, or a folder that they wrote.
        limits: `NAME=LOW..HIGH UNIT` or `NAME=VALUE UNIT`, by condition; the campaign's range, extended, elsewhere.
        channels: `NAME: NOISE UNIT` of channels that could be added; the usual ones where not given.
        length: of the test's record in its independent variable [s or m]; as in the campaign where not given.
        progress: called with a sentence and the share done.

    Raises:
        InputError: there is no fitted model, or an option makes no sense.
        ComputationError: a rival could not be integrated anywhere within the limits.
    """
    report = progress or (lambda text, share: None)
    rivals, verdict = list_confused(models)
    if length is not None and not length > 0:
        raise InputError(f"the length of a record has to be positive, not {length:g}")
    chosen, extras = set_limits(rivals[0], limits), list_extras(rivals[0], channels)
    layout, test = prepare(rivals, chosen, extras, length=length)
    names = tuple(name_model(m) for m in rivals)
    proposals = []
    for k, extra in enumerate((None, *extras)):
        if extra is not None and channels is None and proposals[0].split == len(proposals[0].pairs) > 0:
            break  # no further channel is needed, and none was asked for
        what = "the test" if extra is None else f"a test with {extra.name}"
        report(f"looking for {what}", 0.1 + 0.85 * k / (1 + len(extras)))
        mask = np.array([c in rivals[0].channels or (extra is not None and c in extra.channels)
                         for c in layout.channels], dtype=float)
        x, worth = search_conditions(layout, test, mask)
        if worth <= 0.0 and part_rivals(layout, test, x[None], mask, 0).failed.any():
            raise ComputationError("the models could not be integrated within these limits: check --limit")
        proposals.append(_propose(layout, test, mask, x, extra, names, rivals[0]))
    ranked = sorted(proposals, key=_rank)
    found = Design(rivals[0].campaign, rivals[0].family, verdict, names, chosen, tuple(ranked), DEFAULT.decisive, "")
    sentence, notes = explain_design(found, rivals[0])
    return dc.replace(found, sentence=sentence, notes=notes)


def list_confused(models: str | Path | Fitted | Sequence[Fitted]) -> tuple[list[FittedModel], str]:
    """The best model and its rivals, and the verdict (`fit` where no discovery gives one).

    Raises:
        InputError: there is no fitted model, the rivals were not written, or they are of several campaigns.
    """
    if isinstance(models, (str, Path)):
        return read_confused(Path(models))
    if isinstance(models, Discovery):
        return [models.fitted_model(), *(one.fitted_model() for one in models.rivals)], models.verdict
    found = [take_fitted(one) for one in ([models] if isinstance(models, (FittedModel, AbstractFitted)) else models)]
    if len({(one.sha256, type(one.space.reference)) for one in found}) != 1:
        raise InputError("the models have to be fits of one campaign that extend one reference model")
    return found, "fit" if len(found) == 1 else "undecided"


def read_confused(folder: Path) -> tuple[list[FittedModel], str]:
    """The best model of a folder and its rivals, and the verdict (`fit` where no discovery stands there).

    Raises:
        InputError: there is no fitted model, or the rivals were not written.
    """
    best = load(folder)
    result = folder / RESULT
    if not result.is_file():
        return [best], "fit"
    try:
        content = json.loads(result.read_text(encoding="utf-8"))
        verdict, expected = str(content["verdict"]), [str(e) for e in content["steps"][-1]["alternatives"]]
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        raise InputError("this is no result of discover, or a damaged one; run discover again", file=result) from None
    rivals = [load(path.parent) for path in sorted((folder / RIVALS).glob(f"*/{MODEL}"))]
    if len(rivals) < len(expected):
        raise InputError(f"the rivals ({', '.join(expected)}) are not in this folder; run discover again", file=folder)
    for one in rivals:
        if one.sha256 != best.sha256 or type(one.space.reference) is not type(best.space.reference):
            raise InputError("the rivals belong to another campaign than the model; run discover again",
                             file=one.folder)
    return [best, *rivals], verdict


def name_model(saved: FittedModel) -> str:
    """A model by its effects."""
    return " + ".join(saved.effects) or saved.model


def _rank(proposal: Proposal) -> tuple:
    """The campaign's own channels first among those that tell as many pairs apart by as few repeats."""
    return -proposal.split, proposal.repeats or 0, proposal.extra is not None


def _propose(layout: Layout, test: Test, mask: np.ndarray, x: np.ndarray, extra: Extra | None, names: tuple[str, ...],
             saved: FittedModel) -> Proposal:
    """One proposal at shares `x` of the free limits, conditions rounded to what one would set."""
    x = round_shares(test, x, layout.free)
    values = np.asarray(place_conditions(test, jnp.asarray(x), layout.free))
    found = part_rivals(layout, test, x[None], mask, STEPS)
    pairs = [_compare(found, i, j, names) for i in range(len(names)) for j in range(i)]
    pairs.sort(key=lambda pair: pair.distance)
    told = [pair.repeats for pair in pairs if pair.repeats is not None]
    edge = tuple(layout.names[k] for k, share in zip(layout.free, x, strict=True) if share < EDGE or share > 1 - EDGE)
    kept = [c for c, used in enumerate(mask) if used > 0]
    noise = {c: saved.noise[c].sd for c in layout.channels if c in saved.noise}
    noise |= {} if extra is None else dict.fromkeys(extra.channels, extra.sd)
    return Proposal(
        {name: float(v) for name, v in zip(layout.names, values, strict=True)}, extra, tuple(pairs),
        max(told) if told else None, edge, _narrow(saved, found) if len(names) == 1 else (),
        np.asarray(test.time), tuple(layout.channels[c] for c in kept),
        {name: found.at.channels[k][kept] for k, name in enumerate(names)},
        {layout.channels[c]: noise[layout.channels[c]] for c in kept})


def round_shares(test: Test, x: np.ndarray, free: tuple[int, ...]) -> np.ndarray:
    """Shares of the limits at which conditions have three digits, within the limits."""
    values = np.asarray(place_conditions(test, jnp.asarray(x), free))
    found = np.array(x, dtype=float)
    for k, place in enumerate(free):
        low, high = float(test.low[place]), float(test.high[place])
        value = float(np.clip(float(f"{values[place]:.3g}"), low, high))
        if bool(test.logarithmic[place]):
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
        share = min(max(real / one, 0.0), 1.0) if one > 0 else 1.0
        distances.append(one * share)
        repeats.append(count_repeats(linear, DEFAULT.decisive / share, MOST) if share > 0 else None)
    known = [r for r in repeats if r is not None]
    return Pair(names[j], names[i], float(np.sqrt(max(min(distances), 0.0))),
                max(known) if len(known) == len(repeats) else None)


def _narrow(saved: FittedModel, found: Distances) -> tuple[Narrowing, ...]:
    """What one test makes of the standard deviations of a single model's parameters."""
    keep = found.rows[0][:, None]
    moved = np.asarray(profile_nuisances(found.at.shared[0] * keep, found.at.own[0] * keep))
    spread = saved.spread()
    information = np.eye(len(spread)) + moved.T[: len(spread)] @ moved[:, : len(spread)]
    covariance = spread.T @ np.linalg.solve(information, spread)
    narrowed = []
    for name in saved.free:
        k = saved.space.index[name]
        before, after = float(np.linalg.norm(spread[:, k])), float(np.sqrt(max(covariance[k, k], 0.0)))
        if before > 0:
            values = [saved.space.public(name, saved.u, sd) for sd in (before, after)]
            narrowed.append(Narrowing(name, str(values[0]["unit"]), float(values[0]["sd"]), float(values[1]["sd"])))
    return tuple(sorted(narrowed, key=lambda n: n.after / max(n.before, 1e-300)))
