"""The missing force in words: the ceiling, its shape over the variables, its spectrum, and laws that would draw it."""

import dataclasses as dc
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..._display import Progress, stay_silent
from ..._errors import InputError
from ..._sentences import Sentence, join_sentences, say
from ...contact.effect import AbstractEffect
from ...families import find_family, name_family, open_campaign
from ...inference.archive import Model, resolve_model
from ...inference.assembly import default_starts, require_samples
from ...measurement.campaign import Campaign
from ...measurement.quantities import describe_quantity, format_quantity
from ..cross_validation import compare_losses
from ..forward_selection import try_effects
from ..outliers import begin_cleaning, clean_records
from ..problem import Fitted, SelectionProblem, fit_reference, pose_selection
from ..result import Law, MissingForce, Shape
from ..settings import DEFAULT, SelectionSettings
from .free_form import Drawn, FreeBench, Term, draw_forces, evaluate_basis, find_ground, measure_visible, spread_drawn
from .symbolic import find_laws, find_rivals


PLACES = 121  # at which a curve is drawn: a figure shows no finer
# Standard deviations by which a force is told from zero: with so many places two would often be passed by chance.
CLEAR = 3.0
# Share of its signature below which what the parameters imitate leaves too little of a shape to draw it absolutely.
ABSORBED = 0.2
LONE = 0.9  # share of the misfit in one condition, above which the others cannot confirm what it is
# Share of the misfit that a force has to remove for a law of it to be looked for: of less, the law would be a guess.
WORTH = 0.2
WHOLE = 0.9  # share that it removes where nothing but noise and details are left


def draw_missing_force(campaign: Campaign | str | Path, model: Model = "paper", *,
                       effects: Sequence[type[AbstractEffect]] = (), catalogue: bool = True, keep_all: bool = False,
                       settings: SelectionSettings = DEFAULT, progress: Progress | None = None) -> MissingForce:
    """Estimate the force that a model lacks by splines inside the equation of motion.

    Args:
        campaign: a campaign with samples, or its folder.
        model: reference model, see `ddetumble.inference.models`; one that has effects keeps them.
        effects: effects that are fitted with the model, of the catalogue or your own.
        catalogue: whether to fit every effect of the catalogue too, so that the best of them stands beside the force.
        keep_all: leave out no record and no sample, whatever is wrong with them.
        settings: thresholds, as of `discover`; the result keeps them.
        progress: called with a sentence and the share done.

    Returns:
        A `MissingForce`: ceiling, shapes, spectrum, simple laws, and a sentence.

    Raises:
        InputError: the campaign cannot be used (wrong family, values without a curve, nothing to fit).
        ComputationError: the reference model could not be integrated.
    """
    report = progress or stay_silent
    campaign = open_campaign(campaign)
    family = find_family(name_family(campaign), "missing")
    find_ground(family)
    resolved = resolve_model(model, family.name)
    report("fitting the reference model", 0.02)
    own = tuple(e for e in dict.fromkeys(effects) if e not in family.catalogue)
    require_samples(campaign)
    state = begin_cleaning(campaign, keep_all, settings)
    for turn in range(settings.rounds):
        selection, reference = fit_reference(pose_selection(state.campaign, resolved.reference, own, resolved.effects,
                                                            state.zeros, settings))
        if turn == settings.rounds - 1:
            break
        state, changed = clean_records(state, selection, reference)
        if not changed:
            break
    beside, best = reference, None
    if effects:
        report("fitting the effects", 0.1)
        inside: dict[str, float] = {}  # of all effects together
        for effect in effects:
            inside |= default_starts(selection.find_effect(effect.id))[0]
        ids = [e.id for e in effects]
        beside = selection.fit(ids, [{}, inside], reference.solution.u, reference.solution.z)
        if beside is None:
            raise InputError(f"the effects {', '.join(ids)} could not be fitted to campaign {campaign.name!r}; leave "
                             "one out")
    if catalogue:
        _, scores = selection.test_lack_of_fit(reference)
        tried = try_effects(selection, reference, scores, lambda text, share: report(text, 0.1 + 0.4 * share))
        best = tried.order[0], tried.refined[tried.order[0]].score
    lack, _ = selection.test_lack_of_fit(beside)
    if lack.rejected:
        found = describe_missing(selection, reference, beside, best, report)
    else:
        noise = float(np.sqrt(beside.score / selection.samples))
        found = MissingForce(
            selection.family.name, beside.effects, reference.score, beside.score, best, None, selection.samples, (), (),
            (), say("missing.nothing_to_draw", noise=noise, p=lack.p_value), settings=settings)
    return dc.replace(found, notes=(*state.notes, *map(str, state.faults), *found.notes))


def describe_missing(selection: SelectionProblem, reference: Fitted, beside: Fitted, best: tuple[str, float] | None,
                     report: Progress) -> MissingForce:
    """Draw the force missing beside a model of a selection; `best` is the effect of the catalogue that does best, with
    its held-out loss."""
    report("drawing the missing force", 0.6)
    bench = FreeBench(selection, beside)
    normals = bench.scan()
    drawn, ceiling = draw_forces(bench, normals, lambda text, share: report(text, 0.6 + 0.2 * share))
    beaten = [selection.settings.is_beaten(*compare_losses(d.losses, drawn[0].losses)) for d in drawn]
    alike = [d.wanted[0][0] for d, worse in zip(drawn[1:], beaten[1:], strict=True) if not worse]
    laws: list[Law] = []
    lone, top = find_lone(bench.before, selection), None
    if ceiling is not None:
        least = min(d.loss for d in (*drawn, ceiling))
        if reference.score - least > WORTH * (reference.score - bench.rows):
            report("looking for simple laws", 0.85)
            laws = find_laws(bench, normals, [drawn[0].wanted[0][0], *alike], least, bool(lone))
        # A simple law is a force too: where it predicts better than splines, the ceiling is no lower.
        top = tuple(dict.fromkeys(_name(t) for t, _ in ceiling.wanted)), min([least, *(law.loss for law in laws)])
    found = MissingForce(
        bench.family.name, beside.effects, reference.score, beside.score, best, top, bench.rows,
        tuple(_describe_shape(bench, one, drawn[0]) for one in drawn), tuple(map(_name, alike)), tuple(laws), lone=lone,
        settings=selection.settings)
    sentence, notes = explain_missing(found, bench)
    return dc.replace(found, sentence=sentence, notes=notes)


def find_lone(losses: np.ndarray, selection: SelectionProblem) -> tuple[str, ...]:
    """Records of the one condition in which nearly all the misfit lies; none where several show it.

    `losses` are held out, of every condition, in noise variances.
    """
    rows = selection.records.used.sum(axis=(1, 2))
    excess = np.array([loss - rows[selection.groups == g].sum() for g, loss in enumerate(losses)])
    first = int(np.argmax(excess))
    if len(excess) < 2 or excess[first] < LONE * np.maximum(excess, 0.0).sum():
        return ()
    return tuple(selection.records.keys[r] for r in np.flatnonzero(selection.groups == first))


def _name(term: Term) -> str:
    parts = f", {' and '.join(term.parts)} apart" if term.parts[0] and "x" not in term.parts else ""
    return f"{term.way} over {describe_quantity(term.variable).name}{parts}"


def _describe_shape(bench: FreeBench, drawn: Drawn, best: Drawn) -> Shape:
    """One force over its variable, with its posterior deviation, where it was visited, and its spectrum."""
    (term, intervals), = drawn.wanted
    own, covariance = spread_drawn(bench, drawn)
    x = np.linspace(term.low, term.high, PLACES)
    basis = evaluate_basis(term, intervals, x)
    size = basis.shape[1]
    share = term.way == "share" or "drag" in term.way
    factor = np.abs(term.directions[term.directions != 0]).max() if share else 1.0
    visited, middle = _visit(bench, drawn, term, x), np.zeros(size)
    centred = measure_visible(bench, drawn, np.ones_like(own)) < ABSORBED
    visible = measure_visible(bench, drawn)
    if centred:
        # The model's parameters make up for a constant: the curve is known up to it, and drawn about its mean.
        middle = visited @ basis / max(float(visited.sum()), 1e-300)
        visible = measure_visible(bench, drawn, own - np.repeat(own.reshape(-1, size) @ middle, size))
    values, deviations, spectra = [], [], []
    for part in range(len(term.parts)):
        here = slice(part * size, (part + 1) * size)
        f, turn = basis @ own[here], basis - middle
        if centred and term.way == "share":
            # A share s of F, F (1 + s), is known but for the size of F: (1 + s)/(1 + mean) - 1.
            mean = 1.0 + factor * (middle @ own[here])
            turn = (basis - (1.0 + factor * f)[:, None] / mean * middle) / mean
            values.append((f - middle @ own[here]) / mean)
        else:
            values.append(turn @ own[here])
        deviations.append(np.sqrt(np.einsum("ij,jk,ik->i", turn, covariance[here, here], turn)))
        spectra.append(_measure_spectrum(x, values[-1], turn @ covariance[here, here] @ turn.T, intervals))
    f, sd = np.array(values), np.array(deviations)
    # Where one of the curves is told from zero up to the end, and not all over.
    clear = (np.abs(f) > CLEAR * sd) & (np.abs(f) > 0.02 * np.abs(f).max())
    begins = min((float(x[np.flatnonzero(~curve)[-1] + 1]) for curve in clear if curve[-1] and not curve.all()),
                 default=None)
    strongest = int(np.argmax([s[1].max(initial=0.0) for s in spectra]))
    difference, error = compare_losses(drawn.losses, best.losses)
    unit = ("1" if term.way == "share" else "1/s") if share else bench.ground.unit
    return Shape(term.variable, term.way, term.parts, x, factor * f, factor * sd, visited, unit,
                 intervals, visible, drawn.loss, difference, error if drawn is not best else 0.0,
                 None if centred else begins, centred, np.zeros((3, 0)) if term.condition else
                 spectra[strongest] * np.array([[1.0], [factor], [factor]]))


def _visit(bench: FreeBench, drawn: Drawn, term: Term, x: np.ndarray) -> np.ndarray:
    """Share of the samples whose variable lies nearer to each place than half a spacing of the places."""
    solution, records = drawn.solution, bench.records
    valid = records.used.any(axis=1)
    time = np.asarray(records.stack.time)[: records.count]
    if term.condition:
        values = np.broadcast_to(np.asarray(records.stack.conditions[term.variable])[: records.count, None], time.shape)
    elif term.variable == "time":
        values = time
    elif term.variable == bench.family.state:
        values, valid = solution.state, valid & ((solution.state > 0) | (not bench.family.has_contact))
    elif term.variable == bench.family.rate:
        values, valid = solution.state_rate, valid & (solution.state > 0)
    else:
        rates = [solution.channels[:, records.channels.index(f"angular_velocity_{a}")] for a in "xyz"]
        values = rates[2] if term.variable == "angular_velocity_z" else np.arctan2(rates[1], rates[0])
    edges = np.concatenate([x - 0.5 * (x[1] - x[0]), [x[-1] + 0.5 * (x[1] - x[0])]])
    count, _ = np.histogram(values[valid], edges)
    return count / max(count.sum(), 1)


def _measure_spectrum(x: np.ndarray, f: np.ndarray, covariance: np.ndarray, intervals: int) -> np.ndarray:
    """Amplitudes of the waves in a curve from which its straight line is taken, with their deviations, (3, lines)."""
    numbers = np.arange(1.0, 0.5 * intervals + 1e-9, 0.125) / (x[-1] - x[0])
    if not len(numbers):
        return np.zeros((3, 0))
    line = np.stack([np.ones_like(x), x], axis=1)
    window = np.hanning(len(x) + 2)[1:-1]
    straight = np.eye(len(x)) - line @ np.linalg.pinv(line)
    waves = 2.0 / window.sum() * (window * np.exp(-2j * np.pi * numbers[:, None] * x)) @ straight
    spread = np.real(np.einsum("ij,jk,ik->i", waves, covariance, waves.conj()))
    return np.stack([numbers, np.abs(waves @ f), np.sqrt(np.maximum(spread, 0.0))])


def explain_missing(found: MissingForce, bench: FreeBench) -> tuple[Sentence, tuple[Sentence | str, ...]]:
    """The sentence of a missing force, and notes on what it does not say."""
    folds, time = bench.family.folds, np.asarray(bench.records.stack.time)
    longest = max(float(time[r, :n].max()) for r, n in enumerate(bench.records.lengths))
    catalogue = None if found.catalogue is None else (found.catalogue[0], found.share(found.catalogue[1]))
    context = say("missing.context", noise=float(np.sqrt(found.reference / found.floor)), folds=folds,
                  catalogue=catalogue, effects=list(found.effects), beside=found.share(found.model))
    if found.ceiling is None or not found.shapes:
        tried = [describe_quantity(v).name for v in dict.fromkeys(t.variable for t in bench.terms)]
        return say("missing.no_force", context=context, tried=tried), ()
    best, share = found.shapes[0], found.share(found.ceiling[1])
    begins = None if best.begins is None else format_quantity(best.variable, best.begins, longest)
    parts = [say("missing.little" if share < WORTH else "missing.found", share=share, context=context,
                 terms=list(found.ceiling[0]), shape=_say_shape(best), begins=begins)]
    notes: list[Sentence | str] = []
    if found.lone:
        parts.append(say("missing.lone", records=list(found.lone)))
    if found.laws:
        law, decisive = found.laws[0], bench.selection.settings.decisive
        parts.append(say("missing.law", text=law.text, values=list(law.parameters.items()),
                         share=None if found.lone else found.share(law.loss),
                         rivals=[r.text for r in find_rivals(found.laws, found.settings)[:3]]))
        better = min((r for r in found.laws if r.chi2 > law.chi2 + decisive), key=lambda r: r.loss, default=law)
        if better.loss < law.loss - decisive and not found.lone:
            notes.append(say("missing.better", text=better.text, share=found.share(better.loss), folds=folds,
                             worse=better.chi2 - law.chi2))
    seen = best.x[best.visited >= 0.02 / PLACES]
    last = float(seen.max() if len(seen) else best.x[0])
    reached = last >= best.x[-2] or best.variable.startswith("initial")
    told = ((bool(found.alike), "alike", {"folds": folds, "others": list(found.alike)}),
            (best.centred, "centred", {}), (best.visible < ABSORBED, "absorbed", {"visible": best.visible}),
            (not reached, "unvisited", {"last": format_quantity(best.variable, last, longest)}),
            (share < WORTH, "too_little", {}), (share < WHOLE, "elsewhere", {"share": 1.0 - share}))
    notes += [say(f"missing.{name}", **facts) for needed, name, facts in told if needed]
    return join_sentences(*parts), (*notes, *filter(None, [bench.ground.note]), say("missing.bands"))


def summarise_missing(found: MissingForce) -> Sentence:
    """One or two sentences for a verdict."""
    if found.ceiling is None or not found.shapes:
        return say("missing.nothing")
    law = found.laws[0] if found.laws else None
    text = say("missing.summary", share=found.share(found.ceiling[1]), shape=_say_shape(found.shapes[0]),
               law=law and law.text, values=list(law.parameters.items()) if law else [])
    return join_sentences(text, say("missing.lone", records=list(found.lone))) if found.lone else text


def _say_shape(shape: Shape) -> str:
    """`a force that depends on the depression, loading and unloading separately`."""
    way = {"force": "a force", "share": "a fraction of the elastic force", "torque": "a torque",
           "drag": "a drag"}.get(shape.way, f"a {shape.way}")
    if shape.way == "share" and shape.variable not in ("depression", "depression_rate", "time", "initial_pressure",
                                                        "approach_speed", "sequence"):
        way = "a fraction of the friction"
    phases = [p for p in shape.parts if p in ("loading", "unloading", "forward", "backward")]
    return say("missing.shape", one={"way": way, "variable": describe_quantity(shape.variable).name, "phases": phases})
