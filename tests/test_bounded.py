"""Fits with bounds on a toy that NumPy solves: the active set beside SciPy's own, limits, and what a model removes."""

import dataclasses as dc

import numpy as np
import pytest
from helpers_statistics import SD, fit_toy, make_selection
from scipy.optimize import least_squares

from ddetumble.inference import bounded


NAMES = ("stiffness", "gas", "loss")


@pytest.fixture(scope="module")
def toy():
    """The choice, its problem, and where a fit without bounds ends."""
    selection, fitted = fit_toy(make_selection(3))
    return selection, selection.problem, fitted.solution


def solve_by_scipy(problem, start, bounds):
    """Free coordinates at the least squares within bounds, settings of the records fitted along."""
    places = [problem.space.index[name] for name in NAMES]
    shape = (problem.records.count, len(problem.records.nuisances))
    low, high = (np.array([bounds.get(name, (-np.inf, np.inf))[side] for name in NAMES]) for side in (0, 1))

    def residual(x):
        u = start.copy()
        u[places] = x[:3]
        z = x[3:].reshape(shape)
        return np.concatenate([problem.whitened(problem.model(u, z) - problem.values).ravel(), z.ravel()])

    first = np.concatenate([np.clip(start[places], low + 1e-3, high - 1e-3), np.zeros(shape[0] * shape[1])])
    free = np.full(shape[0] * shape[1], np.inf)
    found = least_squares(residual, first, bounds=(np.append(low, -free), np.append(high, free)), x_scale="jac",
                          xtol=1e-12, ftol=1e-12, gtol=1e-10)
    return found.x[:3], 2.0 * found.cost


@pytest.mark.parametrize(("shifts", "held"), [
    ({}, {}),
    ({"stiffness": (-1.0, -0.05)}, {"stiffness": 1}),
    ({"gas": (0.5, 4.0)}, {"gas": -1}),
    ({"stiffness": (0.02, 1.0), "loss": (-3.0, -0.3)}, {"stiffness": -1, "loss": 1}),
    ({"stiffness": (-1.0, 1.0), "gas": (-9.0, 9.0)}, {}),
])  # fmt: skip
def test_bounds_beside_scipy(toy, shifts, held):
    """Bounds stated from where a free fit ends: those that cut it off hold, and the others find their best."""
    _, problem, free = toy
    ends = {n: tuple(free.u[problem.space.index[n]] + s for s in shift) for n, shift in shifts.items()}
    found = bounded.solve_bounded(problem, NAMES, free.u.copy(), None, ends)
    expected, chi2 = solve_by_scipy(problem, free.u, ends)
    assert dict(found.held) == held and found.names == NAMES and dict(found.bounds) == ends
    assert found.solution.chi2 == pytest.approx(chi2, rel=1e-4)
    scales = np.array([problem.scales[problem.space.index[n]] for n in NAMES])
    got = np.array([found.solution.u[problem.space.index[n]] for n in NAMES])
    np.testing.assert_allclose(got / scales, expected / scales, atol=2e-3)
    assert set(found.solution.names) == set(NAMES) - set(held) and found.solution.converged
    for name, (low, high) in ends.items():
        assert low <= found.solution.u[problem.space.index[name]] <= high


def test_a_start_at_a_bound_is_let_go(toy):
    """Where every start lies at a bound that the best fit does not touch, none is held in the end."""
    _, problem, free = toy
    ends = {n: (free.u[problem.space.index[n]] - w, free.u[problem.space.index[n]] + w)
            for n, w in zip(NAMES, (0.3, 1.0, 0.5), strict=True)}
    for side in (0, 1):
        start = free.u.copy()
        for name in NAMES:
            start[problem.space.index[name]] = ends[name][side]
        found = bounded.solve_bounded(problem, NAMES, start, None, ends)
        assert not found.held and found.solution.chi2 == pytest.approx(free.chi2, rel=1e-6)


def test_one_bound_pulls_another_parameter_off_its_own(toy):
    """A parameter that is held on the way, as another has not moved yet, is let go at the end."""
    _, problem, free = toy
    index = problem.space.index
    ends = {"stiffness": (free.u[index["stiffness"]] - 0.6, free.u[index["stiffness"]] + 0.5),
            "gas": (free.u[index["gas"]] - 0.02, free.u[index["gas"]] + 8.0)}
    start = free.u.copy()
    start[index["stiffness"]] = ends["stiffness"][1]  # far too stiff: the gas would go below its bound at first
    found = bounded.solve_bounded(problem, NAMES, start, None, ends)
    expected, chi2 = solve_by_scipy(problem, free.u, ends)
    assert found.solution.chi2 == pytest.approx(chi2, rel=1e-6)


def test_room_is_the_narrower_of_bounds_and_limits(toy):
    _, problem, free = toy
    k = problem.space.index["stiffness"]
    low, high = problem.limits[0][k], problem.limits[1][k]
    cases = [(None, (low, high)), ((low - 1.0, high + 1.0), (low, high)),
             ((low + 1.0, high - 2.0), (low + 1.0, high - 2.0)), ((low + 1.0, np.inf), (low + 1.0, high))]
    for ends, expected in cases:
        found = bounded.Bounded(free, NAMES, {}, {} if ends is None else {"stiffness": ends})
        assert found.room(problem, "stiffness") == pytest.approx(expected)
    assert found.room(problem, "gas") == tuple(edges[problem.space.index["gas"]] for edges in problem.limits)


def test_limits_are_listed_by_side(toy):
    """Within 0.002 of its scale a parameter counts as being at a limit, no further away."""
    _, problem, free = toy
    k = problem.space.index["stiffness"]
    for edge, side in ((problem.limits[0][k], -1), (problem.limits[1][k], 1)):
        for distance, expected in ((0.0, {"stiffness": side}), (1e-3, {"stiffness": side}), (4e-3, {})):
            u = free.u.copy()
            u[k] = edge - side * distance * problem.scales[k]
            assert bounded.list_limits(problem, dc.replace(free, u=u)) == expected


def test_share_that_a_model_removes(toy):
    """1 less residual over measured sum of squares in noise variances, by plain sums."""
    _, problem, free = toy
    measured = problem.values[:, 0] / SD["normal_force"]
    for factor in (1.0, 0.5, 0.0, -1.0):
        model = factor * free.channels
        left = np.sum((model[:, 0] / SD["normal_force"] - measured) ** 2)
        share = bounded.explain_share(problem, dc.replace(free, channels=model))
        assert share == pytest.approx(1.0 - left / np.sum(measured**2), abs=1e-12)


def test_what_meets_the_data(toy):
    """A model that has the pulse meets it; one that has nothing does where the record is as quiet as its noise."""
    _, problem, free = toy
    assert bounded.meets_data(problem, free)
    assert not bounded.meets_data(problem, dc.replace(free, channels=0.0 * free.channels))
    total = np.sum((problem.values / SD["normal_force"]) ** 2)
    for share, expected in ((0.05, False), (0.15, True)):  # a tenth of the signal's sum of squares has to go
        part = 1.0 - np.sqrt(1.0 - share)
        model = part * problem.values
        assert np.sum((model / SD["normal_force"]) ** 2) < total
        assert bounded.meets_data(problem, dc.replace(free, channels=model)) == expected
    for size, expected in ((1.9, True), (2.1, False)):  # four noise variances a sample
        model = problem.values + size * SD["normal_force"]
        quiet = dc.replace(free, channels=model)
        loud = bounded.explain_share(problem, quiet) > 0.1
        assert loud or bounded.meets_data(problem, quiet) == expected


class Halting:
    """A problem whose solver comes to its end only at the call of this number."""

    def __init__(self, problem, solution, last, fall=1.0):
        self.problem, self.solution, self.last, self.fall, self.calls = problem, solution, last, fall, 0
        self.space, self.scales, self.limits = problem.space, problem.scales, problem.limits

    def solve(self, names, u, z, *, tolerance):
        """Each call falls by the same and takes seven steps."""
        self.calls += 1
        return dc.replace(self.solution, converged=self.calls >= self.last, steps=7,
                          chi2=self.solution.chi2 + self.fall * (10 - self.calls))


@pytest.mark.parametrize(("tolerance", "last", "fall", "calls", "converged"), [
    (1e-7, 1, 1.0, 1, True), (1e-7, 3, 1.0, 3, True), (1e-7, 4, 1.0, 4, True), (1e-7, 9, 1.0, 4, False),
    (1e-7, 9, 0.0, 2, True), (1e-2, 9, 1.0, 1, False), (1e-3, 9, 1.0, 1, False), (9e-4, 2, 1.0, 2, True),
])  # fmt: skip
def test_patience(toy, tolerance, last, fall, calls, converged):
    """A final fit goes on three times at most, or until it falls no further; a scout not at all."""
    _, problem, free = toy
    halting = Halting(problem, free, last, fall)
    found = bounded.solve_bounded(halting, NAMES, free.u.copy(), None, {}, tolerance=tolerance)
    assert halting.calls == calls and found.solution.steps == 7 * calls
    assert found.solution.converged == converged
