"""One model of the loop as a plain record: errors, parameters, correlations, traces."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..inference.identifiability import limit_knowledge
from ..inference.parameters import to_coordinate
from ..inference.problem import Solution
from .records import Estimate, Step
from .search import Grown
from .shifts import hold_settings, is_moved, measure_shifts
from .traces import make_traces, measure_error, noise_nrmse, nrmse
from .workbench import Workbench


NEXT, LIKELY = 0.03, 4.0  # of the distance to a null; and how much worse in chi-square what lies there may fit
WIDEST = 10.0  # standard deviations that are told, in those beyond which nothing is known


def list_loose(workbench: Workbench, solution: Solution) -> tuple[str, ...]:
    """Names of free parameters that the records do not fix."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance()), 0.0))
    return tuple(name for name, width in zip(solution.names, sd, strict=True)
                 if width > limit_knowledge(workbench.space, name))


def public_estimates(workbench: Workbench, solution: Solution, owners: Sequence[str | None] | None = None
                     ) -> dict[str, Estimate]:
    """Estimates of the free parameters in their public units."""
    covariance = solution.covariance()
    found = {}
    for k, name in enumerate(solution.names):
        slot = workbench.space.slots[workbench.space.index[name]]
        if owners is not None and slot.owner not in owners:
            continue
        widest = WIDEST * limit_knowledge(workbench.space, name)
        sd = min(float(np.sqrt(max(covariance[k, k], 0.0))), widest)
        if slot.parameter.singular:
            sd = max(sd, _reach_null(workbench, solution, name))
        values = workbench.space.public(name, solution.u, sd)
        found[name] = Estimate(**values, text=slot.parameter.text)
    return found


def _reach_null(workbench: Workbench, solution: Solution, name: str) -> float:
    """Half the distance to a null at which an amplitude has no slope, where values next to it fit as well; else 0.

    The curvature at the estimate knows nothing of it.
    """
    k, weights = workbench.space.index[name], workbench.records.stack.weights
    parameter, u = workbench.space.slots[k].parameter, solution.u.copy()
    null = to_coordinate(parameter.coordinate, parameter.default)
    distance = float(u[k]) - null
    if distance == 0.0 or solution.residual.shape[1] != weights.shape[1] * weights.shape[2]:
        return 0.0  # of thinned records
    u[k] = null + NEXT * distance
    others = [other for other in solution.names if other != name]
    near = workbench.problem.solve(others, u, solution.z, tolerance=1e-2)
    return 0.5 * abs(distance) if near.chi2 - solution.chi2 < LIKELY else 0.0


def strongest_correlations(solution: Solution, least: float = 0.1) -> tuple[tuple[str, str, float], ...]:
    """Correlations of the free parameters by size."""
    covariance = solution.covariance()
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    pairs = [(a, b, float(covariance[i, j] / (sd[i] * sd[j])))
             for i, a in enumerate(solution.names) for j, b in enumerate(solution.names) if i < j]
    return tuple(sorted((p for p in pairs if abs(p[2]) >= least), key=lambda p: -abs(p[2])))


def describe_step(workbench: Workbench, grown: Grown, before: Grown | None) -> Step:
    """The record of one step."""
    fitted, solution = grown.fitted, grown.fitted.solution
    traces = make_traces(workbench.campaign, workbench.records, solution, workbench.noise)
    rows = float((np.asarray(workbench.records.stack.weights) > 0).sum())
    shifts = measure_shifts(workbench.records, solution)
    held = None
    if is_moved(shifts):
        there = hold_settings(workbench.problem, solution)
        held = measure_error(workbench.records, there.channels)
    added = None
    if before is not None:
        added = next((e for e in fitted.effects if e not in before.fitted.effects), fitted.effects[-1])
    alternatives = tuple({"effect": e, "heldout_difference": d, "standard_error": s}
                         for e, d, s in grown.alternatives)
    return Step(
        added=added, effects=fitted.effects, chi2_reduced=solution.chi2 / max(rows - len(solution.names), 1.0),
        nrmse=nrmse(traces), heldout_nrmse=workbench.measure_left_out(fitted), alternatives=alternatives,
        lack_of_fit=grown.lack, parameters=public_estimates(workbench, solution),
        correlations=strongest_correlations(solution), traces=traces, converged=solution.converged,
        shifts=shifts, held_nrmse=held)


def noise_over_signal(traces) -> float:
    """rms noise over rms signal."""
    return noise_nrmse(traces)


def describe_noise(workbench: Workbench) -> dict[str, dict[str, Any]]:
    """What is known about the noise of every channel."""
    return {channel: {"stated_sd": n.stated_sd, "sd": n.sd, "correlation": n.correlation,
                      "white_share": n.white_share, "text": n.text} for channel, n in workbench.noise.items()}
