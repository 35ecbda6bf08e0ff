"""Where a misfit sits: in which variable, over which range of it, loading or unloading."""

import numpy as np

from .holdout import compare_losses
from .records import Place
from .workbench import Fitted, Workbench


def fit_probes(workbench: Workbench, base: Fitted, scores) -> dict[str, Fitted]:
    """Refit a model with each probe added, best first; ringing at the strongest line of the residuals."""
    jobs = []
    for probe in workbench.probes:
        own = [s for s in scores if s.effect == probe.id]
        if probe.id == "probe-ringing":
            frequency = find_line(workbench, base)
            if frequency:
                shape = {"probe-ringing.frequency": float(np.log(frequency))}
                jobs += [(probe.id, {**shape, "probe-ringing.a": 0.3, "probe-ringing.b": 0.3}, ())]
            continue
        if not own:
            continue
        for s in sorted(own, key=lambda s: -abs(s.z))[: 3 if probe.id == "probe-depth" else 1]:
            jobs.append((probe.id, {**s.shapes, s.name: workbench.start[workbench.space.index[s.name]] + s.step}, ()))

    def one(job):
        probe, start, extra = job
        return probe, workbench.fit((*base.effects, probe), [start], base.solution.u, base.solution.z, extra=extra)

    best: dict[str, Fitted] = {}
    for probe, fitted in workbench.map(one, jobs):
        if fitted is not None and (probe not in best or fitted.solution.chi2 < best[probe].solution.chi2):
            best[probe] = fitted
    return dict(sorted(best.items(), key=lambda item: item[1].score))


def find_line(workbench: Workbench, fitted: Fitted) -> float | None:
    """Frequency [Hz] of the strongest line in the contact part of the force residuals of all records; None if weak."""
    time = np.asarray(workbench.records.stack.time)
    values, solution = np.asarray(workbench.records.stack.values), fitted.solution
    channel = workbench.records.channels.index("normal_force")
    shortest = float(np.min(solution.separation))
    step = float(np.median(np.diff(time[0, : workbench.records.lengths[0]])))
    grid = np.arange(1.5 / shortest, 0.4 / step, 0.25 / float(np.max(solution.separation)))
    if len(grid) < 8:
        return None
    power = np.zeros(len(grid))
    for r, n in enumerate(workbench.records.lengths):
        inside = (time[r, :n] > 0) & (time[r, :n] < solution.separation[r])
        t, x = time[r, :n][inside], (values[r, channel] - solution.channels[r, channel])[:n][inside]
        if len(t) < 12:
            continue
        window = np.hanning(len(t) + 2)[1:-1]
        x = (x - np.polyval(np.polyfit(t, x, 3), t)) * window
        power += np.abs(np.exp(-2j * np.pi * grid[:, None] * t[None, :]) @ x) ** 2 / np.sum(window**2)
    k = int(np.argmax(power))
    return float(grid[k]) if power[k] > 3.0 * np.median(power) else None


def locate(workbench: Workbench, base: Fitted, probes: dict[str, Fitted]) -> list[Place]:
    """Places of a model's misfit: what its probes say, then where the residuals themselves stand out."""
    places = []
    if probes:
        name, best = next(iter(probes.items()))
        gain, error = compare_losses(base.loss, best.loss, workbench.groups)
        excess = max(base.solution.chi2 - _rows(workbench, base), 1.0)
        share = float(np.clip((base.solution.chi2 - best.solution.chi2) / excess, 0.0, 1.0))
        if gain > max(9.0, 2 * error) or gain > 50.0:
            places.append(_place(workbench, name, best, share))
    return places + residual_places(workbench, base)


def _rows(workbench: Workbench, fitted: Fitted) -> float:
    return float((np.asarray(workbench.records.stack.weights) > 0).sum()) - fitted.solution.shared.shape[2]


def _place(workbench: Workbench, probe: str, fitted: Fitted, share: float) -> Place:
    """The place that a probe stands for."""
    effect = workbench.whole(probe)
    variable = effect.variable  # pyright: ignore[reportAttributeAccessIssue] # every probe has one
    u = fitted.solution.u
    if probe == "probe-depth":
        onset = float(np.exp(u[workbench.space.index["probe-depth.depth"]]))
        return Place("normal_force", variable, (onset, float(fitted.solution.depression.max())), "both", share)
    if probe == "probe-ringing":
        period = float(np.exp(-u[workbench.space.index["probe-ringing.frequency"]]))
        return Place("normal_force", variable, (0.0, float(fitted.solution.separation.max())), "both", share, period)
    if variable == "time":
        return Place("normal_force", variable, (0.0, float(fitted.solution.separation.max())), "both", share)
    if variable == "depression_rate":
        rate = fitted.solution.depression_rate
        return Place("normal_force", variable, (float(rate.min()), float(rate.max())), "both", share)
    values = workbench.campaign.records[variable].to_numpy(dtype=float)
    return Place("normal_force", variable, (float(values.min()), float(values.max())), "both", share)


def residual_places(workbench: Workbench, fitted: Fitted, bins: int = 12) -> list[Place]:
    """For every channel the range of depression and the phase that hold most of the misfit."""
    solution, places = fitted.solution, []
    records = workbench.records
    samples = np.asarray(records.stack.time).shape[1]
    residual = solution.residual.reshape(records.count, len(records.channels), samples)
    valid = np.asarray(records.stack.weights)[: records.count] > 0
    top = float(solution.depression.max())
    if top <= 0:
        return []
    edges = np.linspace(0.0, top, bins + 1)
    for c, channel in enumerate(records.channels):
        excess = np.zeros((2, bins))
        for r in range(records.count):
            depth, rate = solution.depression[r], solution.depression_rate[r]
            for phase, moving in enumerate((rate > 0, rate < 0)):
                here = valid[r, c] & (depth > 0) & moving
                k = np.clip(np.digitize(depth[here], edges) - 1, 0, bins - 1)
                n = np.bincount(k, minlength=bins)
                total = np.bincount(k, residual[r, c][here], minlength=bins)
                excess[phase] += np.where(n > 0, total**2 / np.maximum(n, 1) - 1.0, 0.0)
        excess = np.maximum(excess, 0.0)
        whole = excess.sum()
        if whole < 3.0 * np.sqrt(2.0 * excess.size * records.count):
            continue
        phase = int(np.argmax(excess.sum(axis=1)))
        order = np.argsort(-excess[phase])
        count = int(np.searchsorted(np.cumsum(excess[phase][order]), 0.7 * excess[phase].sum())) + 1
        chosen = order[:count]
        places.append(Place(channel, "depression", (float(edges[chosen.min()]), float(edges[chosen.max() + 1])),
                            ("loading", "unloading")[phase], float(excess[phase][chosen.min():chosen.max() + 1].sum()
                                                                   / whole)))
    return places
