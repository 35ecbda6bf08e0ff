"""Where a misfit sits: in which variable, over which range of it, loading or unloading."""

import dataclasses as dc
from collections.abc import Sequence

import numpy as np

from .._numerics import map_threads
from ..contact.effect import parameters_of
from .cross_validation import compare_losses
from .lack_of_fit import Score, score_directions
from .problem import Fitted, SelectionProblem
from .result import Place


COARSE = 12  # bins of the state, of which several hold a misfit
FINE = 24  # the same, in which an onset lies anywhere
SCANNED = 160  # frequencies that are tried one by one, half a cycle of the longest record apart
LINES = 4096  # frequencies that are tried, a quarter of a cycle apart: records of 2,500 samples hold no more
AT_ONCE = 2_000_000  # values of them at samples that are computed at once


def fit_directions(selection: SelectionProblem, base: Fitted, scores: Sequence[Score]) -> dict[str, Fitted]:
    """Refit a model with each direction added, best first; ringing at the strongest line of the residuals."""
    jobs = []
    for direction in selection.directions:
        own = sorted((s for s in scores if s.effect == direction.id), key=lambda s: -abs(s.z))
        line = getattr(direction, "line", None)
        if line is not None:
            sizes = {f"{direction.id}.{p.name}": 0.3 * p.typical for p in parameters_of(direction) if p.kind != "shape"}
            frequency = (scan_line(selection, base, [(direction.id, name, line) for name in sizes])
                         if selection.family.free_running else find_line(selection, base))
            if frequency:
                jobs.append((direction.id, {line: float(np.log(frequency)), **sizes}))
            continue
        for s in own[: 3 if hasattr(direction, "onset") else 1]:
            jobs.append((direction.id, {**s.shapes, s.name: selection.start[selection.space.index[s.name]] + s.step}))

    fits = map_threads(lambda job: selection.fit((*base.effects, job[0]), [job[1]], base.solution.u, base.solution.z),
                       jobs)
    # Of every direction the last one, which fits best.
    best = {fitted.effects[-1]: fitted for fitted in sorted(filter(None, fits), key=lambda one: -one.solution.chi2)}
    return dict(sorted(best.items(), key=lambda item: item[1].score))


def find_line(selection: SelectionProblem, fitted: Fitted) -> float | None:
    """Frequency of the strongest line in the force residuals of all records; None if weak.

    Of impacts over the time in contact [Hz], of slip records over the slip of each stroke [1/m].
    """
    if selection.records.are_values:
        return None
    stack, lengths, solution = selection.records.stack, selection.records.lengths, fitted.solution
    time, values, weights = (np.asarray(x) for x in (stack.time, stack.values, stack.weights))
    strokes = selection.family.has_strokes
    over = [(solution.state if strokes else time)[r, :n] for r, n in enumerate(lengths)]
    last = np.array([1.001 * x.max() for x in over]) if strokes else solution.end
    step = float(np.median(np.abs(np.diff(over[0]))))
    grid = np.arange(1.5 / float(np.min(last)), 0.4 / step, 0.25 / float(np.max(last)))[:LINES]
    if len(grid) < 8:
        return None
    power = np.zeros(len(grid))
    for r, n in enumerate(lengths):
        inside = (over[r] > 0) & (over[r] < last[r]) & (weights[r, 0, :n] > 0)
        sign = np.sign(solution.state_rate[r, :n]) if strokes else np.ones(n)
        t, x = over[r][inside], (sign * (values[r, 0] - solution.channels[r, 0])[:n])[inside]
        if len(t) < 12:
            continue
        window = np.hanning(len(t) + 2)[1:-1]
        x = (x - np.polyval(np.polyfit(t, x, 3), t)) * window
        parts = np.array_split(grid, -(-len(grid) * len(t) // AT_ONCE))
        line = np.concatenate([np.exp(-2j * np.pi * part[:, None] * t[None, :]) @ x for part in parts])
        power += np.abs(line) ** 2 / np.sum(window**2)
    k = int(np.argmax(power))
    return float(grid[k]) if power[k] > 3.0 * np.median(power) else None


def scan_line(selection: SelectionProblem, fitted: Fitted, amplitudes: Sequence[tuple[str, str, str]]) -> float | None:
    """Frequency at which a torque that repeats in time would take most of the misfit of tumbling records [Hz].

    The motion turns a line into several, so that every frequency is tried: the efficient scores of all `amplitudes`
    together, each an effect, its name and that of its frequency.
    """
    problem = selection.problem if selection.thin is None else selection.thin
    time = np.asarray(problem.records.stack.time)[: problem.records.count]
    longest, interval = float(np.max(np.ptp(time, axis=1))), float(np.median(np.diff(time[0, : 64])))
    grid = np.arange(1.0, min(2.0 * longest * 0.4 / interval, SCANNED)) * 0.5 / longest
    solution = problem.solve(fitted.solution.names, fitted.solution.u, fitted.solution.z, moving=False)
    wanted = [(effect, name, {line: float(np.log(f))}) for f in grid for effect, name, line in amplitudes]
    scores = score_directions(problem, solution, wanted)
    power = np.zeros(len(grid))
    for k in range(len(grid)):
        own = [s for s in scores[k * len(amplitudes): (k + 1) * len(amplitudes)] if s.information > 0]
        among, z = np.array([s.cosines[[t.place for t in own]] for s in own]), np.array([s.z for s in own])
        power[k] = float(z @ np.linalg.pinv(among, rcond=1e-6) @ z) if own else 0.0
    k = int(np.argmax(power))
    return float(grid[k]) if power[k] > 40.0 else None


def locate(selection: SelectionProblem, base: Fitted, directions: dict[str, Fitted]) -> list[Place]:
    """Places of a model's misfit: what its best direction says, then where the residuals themselves stand out.

    `share` is everywhere the share of its channel's misfit that lies in the range, as the residuals have it.
    """
    found = residual_places(selection, base)
    if not directions or selection.records.are_values:
        return found
    name, best = next(iter(directions.items()))
    if not selection.settings.is_beaten(*compare_losses(base.loss, best.loss, selection.groups)):
        return found
    excess = max(base.solution.chi2 - (selection.samples - base.solution.shared.shape[2]), 1.0)
    place = _place(selection, name, best)
    (low, high), whole = place.range, place.range[0] <= 0.0 or place.variable != selection.family.state
    share = 1.0 if whole else share_of_range(selection, base, place.channel, place.range)
    removes = float(np.clip((base.solution.chi2 - best.solution.chi2) / excess, 0.0, 1.0))
    # What lies inside the range of the same variable, with nearly all of the channel's misfit, says nothing more.
    return [dc.replace(place, share=share, removes=removes), *(
        other for other in found if not (
            (other.channel, other.variable) == (place.channel, place.variable) and low <= other.range[0]
            and other.range[1] <= 1.001 * high and abs(1.0 - other.share) < 0.1))]


def _place(selection: SelectionProblem, direction: str, fitted: Fitted) -> Place:
    """The place that a direction stands for, its share still to be measured."""
    effect, solution, family = selection.find_effect(direction), fitted.solution, selection.family
    variable = effect.variable  # pyright: ignore[reportAttributeAccessIssue] # every direction has one
    channels, table = selection.records.channels, selection.campaign.records
    onset, line = (getattr(effect, name, None) for name in ("onset", "line"))
    low, period = 0.0, None
    if variable == family.rate:
        values = np.sign(solution.state_rate) if variable == "direction" else solution.state_rate
    elif variable in table:
        values = table[variable].to_numpy(dtype=float)
    elif variable in channels and family.free_running:
        values = solution.channels[:, channels.index(variable)]
    else:
        if variable == "normal_force" and variable != family.state:
            high = solution.channels[:, 0].max()
        elif variable in ("slip", "slip_speed") and variable != family.state:  # the largest of an oblique impact
            speeds = table["tangential_speed"].to_numpy(dtype=float)
            high = np.max(speeds if variable == "slip_speed" else speeds * solution.end)
        else:
            variable = variable if variable == family.state else "time"  # an attitude has no range
            high = (solution.state if variable == family.state else solution.end).max()
            low = float(np.exp(solution.u[selection.space.index[onset]])) if onset is not None else 0.0
            period = float(np.exp(-solution.u[selection.space.index[line]])) if onset is None and line else np.inf
            period = period if period <= high - low else None  # a wave longer than a record does not repeat in it
        values = np.array([low, high])
    return Place(getattr(effect, "channel", channels[0]), variable, (float(values.min()), float(values.max())), "both",
                 1.0, period)


def residual_places(selection: SelectionProblem, fitted: Fitted) -> list[Place]:
    """For every channel the range of the state (depression, slip) and the phase that hold most of the misfit; of
    values, of which a test gives one each, the range of a condition."""
    if selection.records.are_values:
        return _place_values(selection, fitted)
    edges, excess, samples = _bin_excess(selection, fitted, COARSE)
    places = []
    for channel, own in excess.items():
        whole = own.sum()
        if whole < 3.0 * np.sqrt(2.0 * samples):
            continue
        phase = int(np.argmax(own.sum(axis=1)))
        order = np.argsort(-own[phase])
        count = int(np.searchsorted(np.cumsum(own[phase][order]), 0.7 * own[phase].sum())) + 1
        chosen = slice(order[:count].min(), order[:count].max() + 1)
        places.append(Place(channel, selection.family.state, (float(edges[chosen.start]), float(edges[chosen.stop])),
                            selection.family.phases[phase], float(own[phase][chosen].sum() / whole)))
    return places


def _place_values(selection: SelectionProblem, fitted: Fitted) -> list[Place]:
    r"""For every channel of values the range of that condition over which they stray most alike.

    Of all ranges of neighbouring levels of all conditions it is the one with the largest $(\sum_i r_i)^2/n$, of the n
    residuals over the noise in it: chi-square of their mean.
    """
    records, table = selection.records, selection.campaign.records
    residual = fitted.solution.residual.reshape(records.count, len(records.channels), -1)[..., 0]
    valid = records.used[..., 0]
    places = []
    for c, channel in enumerate(records.channels):
        r = residual[valid[:, c], c]
        excess = np.maximum(r**2 - 1.0, 0.0)
        if np.sum(r**2 - 1.0) < 3.0 * np.sqrt(2.0 * r.size):
            continue
        best, where = 0.0, None
        for name in map(str, table.columns):
            values = table[name].to_numpy(dtype=float)[valid[:, c]]
            levels, own = np.unique(values, return_inverse=True)
            if len(levels) < 2:
                continue
            count, total, held = (np.concatenate([[0.0], np.cumsum(np.bincount(np.ravel(own), weights, len(levels)))])
                                  for weights in (None, r, excess))
            first, last = np.triu_indices(len(levels))
            gain = (total[last + 1] - total[first]) ** 2 / (count[last + 1] - count[first])
            k = int(np.argmax(gain))
            if gain[k] > (1.0 + 1e-9) * best:  # of two conditions that say the same, the first
                best, low, high = float(gain[k]), first[k], last[k]
                where = Place(channel, name, (float(levels[low]), float(levels[high])), "both",
                              float((held[high + 1] - held[low]) / excess.sum()))
        if where is not None:
            places.append(where)
    return places


def share_of_range(selection: SelectionProblem, fitted: Fitted, channel: str, span: tuple[float, float]) -> float:
    """Share of a channel's misfit that lies in a range of the state, in both phases."""
    edges, excess, _ = _bin_excess(selection, fitted, FINE)
    own = excess.get(channel, np.zeros((2, 1))).sum(axis=0)
    inside = np.clip((np.minimum(edges[1:], span[1]) - np.maximum(edges[:-1], span[0])) / np.diff(edges), 0.0, 1.0)
    return float(own @ inside / own.sum()) if own.sum() > 0 else 0.0


def _bin_excess(selection: SelectionProblem, fitted: Fitted, bins: int
                ) -> tuple[np.ndarray, dict[str, np.ndarray], int]:
    """Misfit beyond noise in bins of the state: edges, by channel its phases apart, shape (2, bins), and how many."""
    solution, records = fitted.solution, selection.records
    samples = np.asarray(records.stack.time).shape[1]
    residual, valid = solution.residual.reshape(records.count, len(records.channels), samples), records.used
    top = float(solution.state.max())
    if top <= 0:
        return np.linspace(0.0, 1.0, bins + 1), {}, 0
    edges, found = np.linspace(0.0, top, bins + 1), {}
    for c, channel in enumerate(records.channels):
        excess = np.zeros((2, bins))
        for r in range(records.count):
            depth, rate = solution.state[r], solution.state_rate[r]
            for phase, moving in enumerate((rate > 0, rate < 0)):
                here = valid[r, c] & (depth > 0) & moving
                k = np.clip(np.digitize(depth[here], edges) - 1, 0, bins - 1)
                n = np.bincount(k, minlength=bins)
                total = np.bincount(k, residual[r, c][here], minlength=bins)
                excess[phase] += np.where(n > 0, total**2 / np.maximum(n, 1) - 1.0, 0.0)
        found[channel] = np.maximum(excess, 0.0)
    return edges, found, 2 * bins * records.count
