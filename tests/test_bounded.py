"""Fits with bounds on a toy that NumPy solves: the active set beside SciPy's own, limits, and what a model removes."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest
from helpers_statistics import SD, fit_toy, make_selection
from scipy.optimize import least_squares, lsq_linear

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


@pytest.mark.parametrize("sd", [0.05, 3.0])
def test_a_silent_record_is_met_by_silence(toy, sd):
    """Where a model of nothing leaves less than four noise variances a sample; padded records do not count, nor do
    samples that are not there, nor other channels than the family's main one."""
    _, problem, free = toy
    stack, count = problem.records.stack, problem.records.count
    shape = (count + 1, 2, problem.values.shape[2])
    weights = np.full(shape, 1.0 / sd)
    weights[:, 0, ::3] = 0.0
    for size, expected in ((1.9, True), (2.1, False)):
        values = np.full(shape, size * sd)
        values[:, 1], values[count] = 1e3, 1e3
        main = problem.space.family.main
        assert len(main) == 1
        records = dc.replace(problem.records, stack=dc.replace(stack, weights=weights, values=values))
        silent = SimpleNamespace(records=records, space=problem.space)
        still = dc.replace(free, channels=np.zeros((count, 2, shape[2])))
        assert bounded.explain_share(silent, still) == 0.0 and bounded.meets_data(silent, still) == expected


def test_share_does_not_depend_on_the_size_of_the_signal(toy):
    """A signal a million times as small, and one of which nothing is left, leave the same share."""
    _, problem, free = toy
    share = bounded.explain_share(problem, free)
    stack = dc.replace(problem.records.stack, values=1e-6 * problem.values)
    small = SimpleNamespace(records=dc.replace(problem.records, stack=stack), space=problem.space)
    assert bounded.explain_share(small, dc.replace(free, channels=1e-6 * free.channels)) == pytest.approx(share)


class Quadratic:
    """Least squares |A (u - best)/scales|² of any coordinates, solved exactly; a fit stops `short` of the limits.

    Its starts are kept.
    """

    def __init__(self, matrix, best, scales, limits, short=0.0):
        self.matrix, self.best, self.scales, self.limits, self.short = matrix, best, scales, limits, short
        self.space, self.starts = SimpleNamespace(index={f"p{k}": k for k in range(len(best))}), []

    def solve(self, names, u, z, *, tolerance=0.0, moving=True):
        """The others stay where they are."""
        self.starts.append(u.copy())
        places, u = [self.space.index[name] for name in names], u.copy()
        if moving:
            right = self.matrix @ ((u - self.best) / self.scales)
            free = self.matrix[:, places]
            bounds = [(edge - u)[places] / self.scales[places] + side * self.short
                      for side, edge in zip((1, -1), self.limits, strict=True)]
            bounds = [np.minimum(bounds[0], -1e-12), np.maximum(bounds[1], 1e-12)]
            u[places] += self.scales[places] * lsq_linear(free, -right, bounds, tol=1e-14).x
        residual = self.matrix @ ((u - self.best) / self.scales)
        return SimpleNamespace(names=tuple(names), u=u, z=z, chi2=float(residual @ residual), converged=True, steps=1,
                               failed=(), flattened=lambda: (self.matrix[:, places], residual))


def make_quadratic(seed, count=4, scales=None, limit=1e3):
    """Columns that look alike, so that bounds of one move the others."""
    generator = np.random.default_rng(seed)
    matrix = generator.standard_normal((9, count)) + 1.5 * generator.standard_normal((9, 1))
    scales = np.exp(generator.normal(size=count)) if scales is None else np.asarray(scales)
    best = scales * generator.standard_normal(count)
    return Quadratic(matrix, best, scales, (np.full(count, -limit), np.full(count, limit)))


@pytest.mark.parametrize("seed", range(12))
def test_one_bound_beside_bounded_least_squares(seed):
    """Of parameters that look alike one has bounds: held or not, the others find their best beside it."""
    problem, names = make_quadratic(seed), [f"p{k}" for k in range(4)]
    low, high = np.full(4, -np.inf), np.full(4, np.inf)
    low[seed % 4] = problem.scales[seed % 4] * np.random.default_rng([1, seed]).uniform(-1.0, 1.0)
    high[seed % 4] = low[seed % 4] + 0.5 * problem.scales[seed % 4]
    found = bounded.solve_bounded(problem, names, np.zeros(4), None, {f"p{seed % 4}": (low[seed % 4], high[seed % 4])})
    expected = lsq_linear(problem.matrix / problem.scales, problem.matrix @ (problem.best / problem.scales),
                          (low, high), tol=1e-14)
    np.testing.assert_allclose(found.solution.u / problem.scales, expected.x / problem.scales, atol=1e-5)
    edges = {f"p{k}": side for k, side in enumerate(expected.active_mask) if side}
    assert dict(found.held) == edges and set(found.solution.names) == {*names} - {*edges}


@pytest.mark.parametrize("seed", range(12))
def test_bounds_of_parameters_that_do_not_feel_each_other(seed):
    """Each is where it is best, or at its nearer bound."""
    problem = make_quadratic(seed)
    problem.matrix = np.linalg.qr(problem.matrix)[0]
    low = problem.scales * np.random.default_rng([1, seed]).uniform(-1.0, 0.3, 4)
    high = low + 0.7 * problem.scales
    ends = {f"p{k}": (low[k], high[k]) for k in range(4)}
    found = bounded.solve_bounded(problem, list(ends), np.zeros(4), None, ends)
    np.testing.assert_allclose(found.solution.u, np.clip(problem.best, low, high), rtol=1e-9)
    sides = (problem.best > high).astype(int) - (problem.best < low)
    assert dict(found.held) == {f"p{k}": side for k, side in enumerate(sides) if side}


@pytest.mark.parametrize("bounded_ones", [2, 3, 4])
def test_several_bounds_beside_bounded_least_squares(bounded_ones):
    """Of parameters that look alike several have bounds: the optimum of the whole is found in every draw."""
    for seed in range(60):
        problem, generator = make_quadratic(seed), np.random.default_rng([2, seed])
        low, high = np.full(4, -np.inf), np.full(4, np.inf)
        for k in range(bounded_ones):
            low[k] = problem.scales[k] * generator.uniform(-1.0, 1.0)
            high[k] = low[k] + 0.5 * problem.scales[k]
        ends = {f"p{k}": (low[k], high[k]) for k in range(bounded_ones)}
        found = bounded.solve_bounded(problem, [f"p{k}" for k in range(4)], np.zeros(4), None, ends)
        expected = lsq_linear(problem.matrix / problem.scales, problem.matrix @ (problem.best / problem.scales),
                              (low, high), tol=1e-14)
        np.testing.assert_allclose(found.solution.u / problem.scales, expected.x / problem.scales, atol=1e-5)


@pytest.mark.parametrize("far", [-9.0, 9.0])
def test_what_overshot_its_bound_is_let_go(far):
    """A fit that ended far off at first: held there, a parameter is let go as its best lies within its bounds."""
    problem, names = make_quadratic(4), ["p0", "p1", "p2", "p3"]
    solve = problem.solve

    def stray(names, u, z, **options):
        found = solve(names, u, z, **options)
        if len(problem.starts) == 1:
            found.u[1:3] += far * problem.scales[1:3]
        return found

    problem.solve = stray
    ends = {name: (best - scale, best + scale)
            for name, best, scale in zip(names, problem.best, problem.scales, strict=True)}
    found = bounded.solve_bounded(problem, names, np.zeros(4), None, ends)
    assert dict(found.held) == {} and found.solution.names == tuple(names)
    np.testing.assert_allclose(found.solution.u, problem.best, rtol=1e-6)


@pytest.mark.parametrize(("low", "high"), [(-1.0, 1.0), (0.3, 0.31), (-50.0, 50.0)])
def test_fits_start_inside_their_bounds(low, high):
    """By a thousandth of the typical change, or of the room where that is narrower."""
    problem = make_quadratic(0, scales=[5.0, 0.2, 1.0, 1.0])
    for start in (-100.0, 100.0):
        problem.starts.clear()
        ends = dict.fromkeys(("p0", "p1"), (low, high))
        bounded.solve_bounded(problem, ["p0", "p1", "p2"], np.full(4, start), None, ends)
        for k, scale in ((0, 5.0), (1, 0.2)):
            inside = 1e-3 * min(scale, high - low)
            assert problem.starts[0][k] == pytest.approx(high - inside if start > 0 else low + inside, abs=1e-12)
        assert problem.starts[0][2] == start


@pytest.mark.parametrize("scale", [0.2, 5.0])
@pytest.mark.parametrize(("short", "held"), [(0.0, True), (1e-3, True), (3e-3, False)])
@pytest.mark.parametrize("side", [-1, 1])
def test_what_comes_near_a_limit_of_the_model_is_held(scale, short, held, side):
    """Within 0.002 of its typical change; it is held a millionth of it inside, and the others go on."""
    problem = make_quadratic(3, scales=[scale, 1.0, 1.0, 1.0])
    problem.best[0], problem.short = side * 12.0, short
    problem.limits[0][0], problem.limits[1][0] = -10.0, 10.0
    found = bounded.solve_bounded(problem, ["p0", "p1"], problem.best * [0.0, 0.0, 1.0, 1.0], None, {})
    assert dict(found.held) == ({"p0": side} if held else {})
    end = side * (10.0 - (1e-6 if held else short) * scale)
    assert found.solution.u[0] == pytest.approx(end, abs=1e-9 * scale)
    assert found.solution.names == (("p1",) if held else ("p0", "p1"))


def test_a_fit_that_fails_is_given_back():
    """Nothing is held of it, and no other is tried."""
    problem = make_quadratic(3)
    solve = problem.solve

    def fail(*given, **options):
        found = solve(*given, **options)
        found.failed = ("r0",)
        return found

    problem.solve = fail
    found = bounded.solve_bounded(problem, ["p0", "p1"], np.zeros(4), None, {"p0": (5.0, 6.0)})
    assert found.solution.failed == ("r0",) and dict(found.held) == {} and len(problem.starts) == 1


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
    (1e-7, 9, 0.0, 2, True), (1e-7, 9, 1.2e-3, 2, True), (1e-7, 9, 3e-3, 4, False),
    (1e-2, 9, 1.0, 1, False), (1e-3, 9, 1.0, 1, False), (9e-4, 2, 1.0, 2, True),
])  # fmt: skip
def test_patience(toy, tolerance, last, fall, calls, converged):
    """A final fit goes on three times at most, or until it falls no further; a scout not at all."""
    _, problem, free = toy
    halting = Halting(problem, free, last, fall)
    found = bounded.solve_bounded(halting, NAMES, free.u.copy(), None, {}, tolerance=tolerance)
    assert halting.calls == calls and found.solution.steps == 7 * calls
    assert found.solution.converged == converged
