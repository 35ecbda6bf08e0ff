"""What a Jacobian determines, beside closed forms of two and three columns."""

import dataclasses as dc
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from helpers_statistics import fit_toy, make_selection

from ddetumble.inference import identifiability
from ddetumble.inference.identifiability import Blend, analyse_jacobian, list_unproven, measure_spread
from ddetumble.measurement.quantities import join_words


FAR = np.array([1e3, 1e3])


def make_columns(cosine: float, norms=(1.0, 1.0)) -> np.ndarray:
    """Two columns with this cosine between them, shape (3, 2)."""
    return np.array([[1.0, cosine], [0.0, np.sqrt(1.0 - cosine**2)], [0.0, 0.0]]) * norms


def test_covariance_is_the_inverse_of_the_normal_equations():
    columns = np.random.default_rng(1).normal(size=(9, 3)) * [2.0, 0.1, 30.0]
    scales = np.array([0.5, 3.0, 1.0])
    found = analyse_jacobian("abc", columns, scales, np.full(3, 1e4))
    expected = np.linalg.inv(columns.T @ columns) * np.outer(scales, scales)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-9)
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.correlations, expected / np.outer(sd, sd), rtol=1e-9)
    assert found.blends == found.silent == found.undetermined == ()


@pytest.mark.parametrize("cosine", [0.94, 0.96, 0.999])
def test_two_columns_at_an_angle(cosine):
    """The correlation is -cosine; beyond 0.95 the pair is a combination."""
    norms, scales = np.array([4.0, 0.5]), np.array([2.0, 3.0])
    found = analyse_jacobian("ab", make_columns(cosine, norms), scales, FAR)
    assert found.correlations[0, 1] == pytest.approx(-cosine)
    assert len(found.blends) == (cosine > 0.95) and found.undetermined == ()
    for blend in found.blends:
        sign = np.sign(blend.direction[0])
        np.testing.assert_allclose(sign * blend.direction, [0.5**0.5, -(0.5**0.5)], rtol=1e-9)
        np.testing.assert_allclose(sign * blend.step, np.array([1, -1]) * scales / norms / np.sqrt(2 - 2 * cosine),
                                   rtol=1e-6)
        assert set(blend.names) == {"a", "b"} and not blend.singular


@pytest.mark.parametrize(("apart", "lost"), [(2e-6, ("a", "b")), (2e-4, ())])
def test_columns_alike_to_the_accuracy_of_derivatives_determine_nothing(apart, lost):
    """However loud the records are: by these columns alone the deviations would be small."""
    columns = 1e9 * np.array([[1.0, 1.0], [0.0, apart]])
    found = analyse_jacobian("ab", columns, np.ones(2), np.full(2, 100.0))
    assert found.undetermined == lost and np.all(np.diag(found.covariance) < 1.0)



def test_the_same_column_twice_is_singular():
    columns = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    found = analyse_jacobian("abc", columns, np.ones(3), np.full(3, 1e3))
    (blend,) = found.blends
    assert blend.singular and set(blend.names) == {"a", "b"} and set(found.undetermined) == {"a", "b"}
    assert found.silent == () and found.covariance[2, 2] == pytest.approx(1.0)
    assert np.isfinite(found.covariance).all() and found.covariance[0, 0] > 1e6


def test_members_stand_by_their_part():
    """A third column hardly takes part: it is not named, and the largest comes first."""
    base = np.random.default_rng(2).normal(size=(20, 2))
    sum_of_both = base @ [1.0, 0.4] + 1e-4 * np.random.default_rng(3).normal(size=20)
    columns = np.column_stack([base, sum_of_both, np.random.default_rng(4).normal(size=20)])
    (blend,) = analyse_jacobian("abcd", columns, np.ones(4), np.full(4, 1e6)).blends
    parts = dict(zip("abcd", np.abs(blend.direction), strict=True))
    assert set(blend.names) == {"a", "b", "c"}
    assert [parts[n] for n in blend.names] == sorted((parts[n] for n in blend.names), reverse=True)


def test_silent_and_undetermined():
    """A column that is zero is silent; one so weak that its deviation exceeds the bound is undetermined."""
    columns = np.diag([1.0, 0.0, 1.5e-3, 1.0 / 3.0])
    found = analyse_jacobian("abcd", columns, np.ones(4), np.array([10.0, 1e3, 1e3, 2.9]))
    assert found.silent == ("b", "d") and found.undetermined == ("b", "d") and found.blends == ()
    pair = np.concatenate([make_columns(0.9), np.zeros((1, 2))])
    sd = 1.0 / np.sqrt(1.0 - 0.81)
    for bound, lost in ((0.99 * sd, ("a",)), (1.01 * sd, ())):
        assert analyse_jacobian("ab", pair, np.ones(2), np.array([bound, 1e3])).undetermined == lost


@pytest.mark.parametrize(("vast", "singular"), [(20.0, True), (25.0, False), ((20.0, 25.0), False)])
def test_a_combination_that_could_be_anything_is_singular(vast, singular):
    """One deviation along it moves each of its members by 1/sqrt(2 - 2 cosine) of a unit column's: beyond what counts
    as anything in all of them, or not."""
    scales = np.array([2.0, 0.5])
    (blend,) = analyse_jacobian("ab", make_columns(0.999), scales, scales * vast).blends
    assert blend.singular is singular  # 22.4 of their scales
    np.testing.assert_allclose(np.abs(blend.step) / scales, 22.36, rtol=1e-3)


def test_a_combination_of_one_and_a_silent_one_is_none():
    """What changes no record takes part in no combination, and a single faint one is none; a pair is, beside both."""
    columns = np.zeros((6, 5))
    columns[0, 0] = 1e-9  # silent
    columns[1:4, 1:3] = make_columns(0.99)
    columns[4, 3], columns[5, 4] = 1.0, 0.02
    found = analyse_jacobian("abcde", columns, np.ones(5), np.full(5, 1e3))
    assert found.silent == ("a",) and [set(blend.names) for blend in found.blends] == [{"b", "c"}]
    assert found.undetermined == ("a",) and found.covariance[4, 4] == pytest.approx(2500.0)


def test_knowledge_in_other_units_of_the_coordinates():
    """Covariances go along, also of what changes no record: large, and finite."""
    columns = np.concatenate([make_columns(0.97), np.zeros((3, 1))], axis=1)
    one = analyse_jacobian("abc", columns, np.array([1.0, 2.0, 3.0]), np.full(3, 50.0))
    other = analyse_jacobian("abc", columns, 1e3 * np.array([1.0, 2.0, 3.0]), np.full(3, 5e4))
    np.testing.assert_allclose(other.covariance, 1e6 * one.covariance, rtol=1e-9)
    assert one.covariance[2, 2] >= 2500.0 * (1 - 1e-9) and np.isfinite(one.covariance).all()
    assert one.silent == other.silent == ("c",)


def test_what_a_fit_knows(one_pressure):
    """Its covariance is the fit's own, what nothing fixes is told from what is known by each parameter's own limit."""
    selection, fitted = one_pressure
    space, solution = selection.problem.space, fitted.solution
    known = identifiability.analyse_fit(space, solution)
    np.testing.assert_allclose(known.covariance, solution.covariance(), rtol=1e-6)
    assert known.undetermined == known.silent == ()
    for name in solution.names:
        vast = identifiability.limit_knowledge(space, name)
        p = space.parameter(name)
        assert vast == (1.0 if p.coordinate == "log" else 100.0 * p.transform.scale(p.typical))
    faint = dc.replace(solution, shared=solution.shared * np.array([1.0, 1.0, 1e-9]))
    assert identifiability.analyse_fit(space, faint).silent == ("loss",)
    problem = SimpleNamespace(space=space, records=selection.problem.records)
    assert identifiability.analyse_with_refits(problem, faint).undetermined == ("loss",)


class Valley:
    """A sum of squares |A u|² over coordinates, that rises no further than `top` over how far each is on either side.

    `tops` are by the name of a parameter and the side; refits without these see the parabola with the others at best.
    """

    def __init__(self, tops=(), fails=(), free_running=True, seed=0, rows=4):
        self.matrix = np.random.default_rng(seed).normal(size=(9, 3)) * [2.0, 0.1, 30.0]
        self.tops, self.fails, self.tried = dict(tops), fails, []
        names, owners = ("a", "b", "c.x"), (None, None, "c")
        plain = SimpleNamespace(typical=1.0, transform=SimpleNamespace(unknown=math.inf, scale=lambda typical: 1.0))
        self.space = SimpleNamespace(
            index={n: k for k, n in enumerate(names)}, slots=[SimpleNamespace(owner=o) for o in owners],
            family=SimpleNamespace(free_running=free_running), parameter=lambda name: plain)
        self.is_whole = lambda solution: solution.residual.shape[1] == 2 * rows
        self.limits = np.full(3, -1e3), np.full(3, 1e3)
        self.names, self.sd = names, np.sqrt(np.diag(np.linalg.inv(self.matrix.T @ self.matrix)))
        self.solution = SimpleNamespace(names=names, u=np.array([3.0, -2.0, 1.0]), z=None, chi2=50.0,
                                        residual=np.zeros((2, 8)),
                                        covariance=lambda: np.linalg.inv(self.matrix.T @ self.matrix))

    def solve(self, names, u, z, *, tolerance):
        """Chi-square with one parameter held where it is."""
        (held,) = {*self.names} - {*names}
        k = self.space.index[held]
        change = u[k] - self.solution.u[k]
        others = [j for j in range(3) if j != k]
        assert np.all(u[others] == self.solution.u[others])
        self.tried.append((held, change / self.sd[k]))
        left = np.linalg.lstsq(self.matrix[:, others], -change * self.matrix[:, k], rcond=None)[1][0]
        side = 1 if change > 0 else -1
        return SimpleNamespace(chi2=self.solution.chi2 + min(left, self.tops.get((held, side), np.inf)),
                               failed=("r0",) if (held, side) in self.fails else ())


def test_a_parabola_is_proven():
    """Ten deviations away the sum of squares has risen by a hundred; parameters of effects are not looked at."""
    valley = Valley()
    assert list_unproven(valley, valley.solution) == ()
    assert valley.tried == [("a", pytest.approx(10.0)), ("b", pytest.approx(10.0))]


@pytest.mark.parametrize(("tops", "fails", "expected"), [
    ({("a", 1): 24.0, ("a", -1): 24.0}, (), ("a",)),  # less than a quarter of a hundred
    ({("a", 1): 26.0, ("a", -1): 26.0}, (), ()),
    ({("a", 1): 1.0}, (), ()), ({("a", -1): 1.0}, (), ()),  # known from one side
    ({("a", 1): -30.0, ("a", -1): 1.0, ("b", 1): 1.0, ("b", -1): 2.0}, (), ("a", "b")),
    ({("a", 1): 1.0, ("a", -1): 1.0}, (("a", -1),), ()),  # a fit that fails proves nothing flat
    ({("c.x", 1): 1.0, ("c.x", -1): 1.0}, (), ()),  # an effect's own
])  # fmt: skip
def test_a_dent_in_the_noise_is_not(tops, fails, expected):
    """Where refits ten deviations away are nearly as good on both sides, the curvature told nothing."""
    valley = Valley(tops, fails)
    assert list_unproven(valley, valley.solution) == expected


@pytest.mark.parametrize(("room", "top", "expected"), [
    ((4.0, 4.0), 1.0, ()),  # limits within half of it on both sides leave nothing to see
    ((4.0, 30.0), 1.0, ("a",)), ((30.0, 4.0), 1.0, ("a",)), ((4.0, 30.0), 26.0, ()),
    ((6.0, 6.0), 8.0, ("a",)), ((6.0, 6.0), 10.0, ()),  # a quarter of 36
])  # fmt: skip
def test_limits_of_the_model_are_in_the_way(room, top, expected):
    valley = Valley({("a", 1): top, ("a", -1): top})
    for side, edge, size in zip((-1, 1), valley.limits, room, strict=True):
        edge[0] = valley.solution.u[0] + side * size * valley.sd[0]
    assert list_unproven(valley, valley.solution) == expected


def test_which_fits_are_tried_far_away():
    """Of records that run on, all of their samples; no parameter of which nothing, or everything, is known already."""
    flat = {(name, side): 1.0 for name in "ab" for side in (1, -1)}
    for valley in (Valley(flat, free_running=False), Valley(flat, rows=5)):
        assert list_unproven(valley, valley.solution) == () and not valley.tried
    for size in (0.0, 200.0):  # of what counts as unknown: a hundred typical changes
        valley = Valley(flat)
        covariance = valley.solution.covariance()
        covariance[0, 0] = size**2
        valley.solution.covariance = lambda covariance=covariance: covariance
        assert list_unproven(valley, valley.solution) == ("b",)


def test_spread_along_a_combination():
    """1/s of the smallest singular value; as many rows again shorten it by sqrt 2, a row across it by what it adds."""
    columns = make_columns(0.99, (3.0, 0.2))
    (blend,) = analyse_jacobian("ab", columns, np.ones(2), FAR).blends
    now = measure_spread(columns, columns, blend)
    assert now == pytest.approx(1.0 / np.sqrt(0.01))
    assert measure_spread(np.concatenate([columns, columns]), columns, blend) == pytest.approx(now / np.sqrt(2.0))
    across = blend.direction[None] * [3.0, 0.2]
    assert measure_spread(np.concatenate([columns, across]), columns, blend) == pytest.approx(1 / np.sqrt(1.01))
    along = Blend(("a",), np.array([1.0, 0.0]), np.zeros(2), False)
    assert measure_spread(columns, columns, along) == pytest.approx(1.0 / np.sqrt(1.0 - 0.99**2))


def test_words():
    assert [join_words("abc"[:n]) for n in (1, 2, 3)] == ["a", "a and b", "a, b and c"]


@pytest.fixture(scope="module")
def one_pressure():
    """A toy at one pressure and one speed: stiffness and gas bend nearly the same pulse."""
    return fit_toy(make_selection(5, conditions=[(1.4, 1e5)] * 6))


@pytest.fixture
def toy_problem(monkeypatch):
    """Remedies are tried on the toy's own problem."""
    monkeypatch.setattr(identifiability, "Problem", type(make_selection().problem))


def make_blend(problem, solution, names):
    """The combination of two parameters that one record cannot tell apart, from the fit's own columns."""
    columns, _ = solution.flattened()
    norms = np.linalg.norm(columns, axis=0)
    _, s, rows = np.linalg.svd(columns / norms, full_matrices=False)
    return Blend(tuple(names), rows[-1], rows[-1] / s[-1] * solution.scales / norms, False), columns


def spread_by_inverse(columns, blend, unit):
    """Standard deviation along the combination from the inverse of the normal equations."""
    scaled = columns / np.linalg.norm(unit, axis=0)
    return float(np.sqrt(blend.direction @ np.linalg.inv(scaled.T @ scaled) @ blend.direction))


def hold_pressure(problem):
    """The same with pressures that are known exactly."""
    deviations = np.array(problem.records.stack.condition_sd)
    deviations[:, problem.records.nuisances.index("initial_pressure")] = 0.0
    stack = dc.replace(problem.records.stack, condition_sd=deviations)
    return type(problem)(problem.space, dc.replace(problem.records, stack=stack))


def test_settings_at_which_nothing_can_be_computed_gain_nothing(monkeypatch, one_pressure):
    selection, fitted = one_pressure
    blend, columns = make_blend(selection.problem, fitted.solution, ("stiffness", "gas"))
    failed = SimpleNamespace(solve=lambda *given, **options: dc.replace(fitted.solution, failed=("r0",)))
    monkeypatch.setattr(identifiability, "Problem", lambda *given: failed)
    assert identifiability._try_conditions(selection.problem, fitted.solution, columns, blend, selection.campaign,
                                           "initial_pressure", (2e5,)) == 1.0


@pytest.mark.parametrize(("name", "values"), [
    ("initial_pressure", (2e5,)), ("initial_pressure", (1e5,)), ("approach_speed", (0.7, 2.8)),
])  # fmt: skip
@pytest.mark.parametrize("fixed", [False, True])
def test_gain_of_further_records_is_that_of_the_joint_fit(toy_problem, one_pressure, name, values, fixed):
    """As many records again at other settings, beside a campaign that holds both from the start.

    The further records last as long as their contact, (before/after)^(1/3) of these where it is longer. Settings that
    are `fixed` in the one are so in the other.
    """
    selection, fitted = one_pressure
    problem, solution = (hold_pressure(selection.problem) if fixed else selection.problem), fitted.solution
    blend, columns = make_blend(problem, solution, ("stiffness", "gas"))
    gain = identifiability._try_conditions(problem, solution, columns, blend, selection.campaign, name, values)
    table = selection.campaign.records
    own = [(row.approach_speed, row.initial_pressure) for row in table.itertuples()]
    place = ("approach_speed", "initial_pressure").index(name)
    further = [tuple(values[k % len(values)] if j == place else x for j, x in enumerate(pair))
               for k, pair in enumerate(own)]
    new, _ = fit_toy(make_selection(5, conditions=further))
    time = np.array(new.problem.time)
    for r, pair in enumerate(further):
        time[r] *= max(own[r][place] / pair[place], 1.0) ** (1.0 / 3.0)
    further_problem = hold_pressure(new.problem) if fixed else new.problem
    further_problem.time = time
    more = further_problem.solve(solution.names, solution.u, np.zeros_like(solution.z), moving=False)
    rows, _ = more.projected()
    both = np.concatenate([columns, rows.reshape(-1, columns.shape[1])])
    expected = spread_by_inverse(columns, blend, columns) / spread_by_inverse(both, blend, columns)
    assert gain == pytest.approx(expected, rel=1e-6) and gain > 1.0


class WithState:
    """The toy with a depression that is linear in parameters and settings; one trial in so many fails."""

    def __init__(self, problem, solution, shared, own, fails=()):
        self.problem, self.solution, self.shared, self.own, self.fails = problem, solution, shared, own, fails
        self.space, self.calls = problem.space, 0
        weights = np.full(problem.records.stack.weights.shape, 0.5)
        weights[..., ::3] = 0.0  # samples that are not there
        self.records = dc.replace(problem.records, stack=dc.replace(problem.records.stack, weights=weights))

    def solve(self, names, u, z, *, moving):
        """Depression at these coordinates."""
        assert not moving
        self.calls += 1
        places = [self.space.index[name] for name in names]
        state = 0.01 + np.einsum("grk,k->gr", self.shared, u[places]) + np.einsum("grk,gk->gr", self.own, z)
        return dc.replace(self.solution, state=state, failed=("r0",) if self.calls in self.fails else ())


def test_gain_of_a_depression_channel(one_pressure):
    """Beside the normal equations with the new channel's rows written out, records' settings eliminated by inverses."""
    selection, fitted = one_pressure
    problem, solution = selection.problem, fitted.solution
    blend, columns = make_blend(problem, solution, ("stiffness", "gas"))
    generator = np.random.default_rng(4)
    shape = problem.time.shape
    shared = 3e-5 * generator.normal(size=(*shape, len(solution.names)))
    own = 3e-5 * generator.normal(size=(*shape, 3))
    gain = identifiability._try_depression(WithState(problem, solution, shared, own), solution, blend)
    deviation = identifiability.DEPRESSION_SD
    counted = (np.arange(shape[1]) % 3 > 0)[:, None]
    square = np.zeros((len(solution.names), len(solution.names)))
    for r in range(len(solution.residual)):
        a = np.concatenate([solution.shared[r], counted * shared[r] * solution.scales / deviation])
        b = np.concatenate([solution.own[r], counted * own[r] / deviation])
        square += a.T @ a - a.T @ b @ np.linalg.inv(b.T @ b + np.eye(3)) @ b.T @ a
    norms = np.linalg.norm(columns, axis=0)
    variance = blend.direction @ np.linalg.inv(square / np.outer(norms, norms)) @ blend.direction
    assert gain == pytest.approx(spread_by_inverse(columns, blend, columns) / np.sqrt(variance), rel=1e-6)
    assert gain > 1.05
    for fails in ((1,), (2,), (7,)):
        assert identifiability._try_depression(WithState(problem, solution, shared, own, fails), solution, blend) == 1.0


@pytest.mark.parametrize(("stated", "values", "expected"), [
    ("initial_pressure", (1e6, 2e6), [(2.5e5,), (2.5e6,), (2.5e5, 2.5e6)]),  # 0.25 and 1.25 times
    ("initial_pressure", (6e5, 6e5), [(2e5,), (7.5e5,), (2e5, 7.5e5)]),  # no flatter than 2 bar
    ("initial_pressure", (1e5, 3e5), [(1e5,), (3.8e5,), (1e5, 3.8e5)]),  # unless it was
    ("approach_speed", (0.5, 2.0), [(0.3,), (3.0,), (0.3, 3.0)]),
    ("approach_speed", (0.0, 2.0), []), ("approach_speed", (-1.0, 2.0), []),
])  # fmt: skip
def test_settings_within_reach(one_pressure, stated, values, expected):
    """Beyond the lowest and the highest setting by the factors of `REACH`, in two digits."""
    selection, _ = one_pressure
    table = selection.campaign.records.copy()
    table[stated] = np.resize(values, len(table))
    found = identifiability._list_settings(selection.problem, dc.replace(selection.campaign, records=table), stated)
    assert [list(one) for one in found] == [pytest.approx(list(one)) for one in expected]


@pytest.mark.parametrize(("first", "last", "low", "high"), [(0.42, 2.55, 0.42, 2.5), (0.42, 2.56, 0.42, 2.5),
                                                            (0.0, np.inf, 0.3, 3.0),
                                                            (0.4, 0.404, None, None)])
def test_settings_stay_where_the_model_holds(monkeypatch, one_pressure, first, last, low, high):
    selection, _ = one_pressure
    monkeypatch.setattr(identifiability, "read_validity", lambda reference: {"approach_speed": (first, last)})
    table = selection.campaign.records.copy()
    table["approach_speed"] = np.resize((0.5, 2.0), len(table))
    found = identifiability._list_settings(selection.problem, dc.replace(selection.campaign, records=table),
                                           "approach_speed")
    assert found == ([] if low is None else [(low,), (high,), (low, high)])


@pytest.mark.parametrize(("singular", "gains", "step", "chosen"), [
    (False, (3.0, 2.5, 1.0), 5.0, 0), (False, (2.1, 2.5, 1.0), 5.0, 1), (False, (1.9, 1.5, 1.0), 5.0, None),
    (True, (9.0, 1.0, 1.0), 2.0, 0), (True, (9.0, 1.0, 1.0), 4.0, None), (False, (1.0, 1.2, 2.4), 5.0, 2),
])  # fmt: skip
def test_the_best_remedy_that_is_enough(monkeypatch, one_pressure, singular, gains, step, chosen):
    """By half at least; where nothing was known, until a deviation is below 0.3 of what is typical."""
    selection, fitted = one_pressure
    problem, solution = selection.problem, fitted.solution
    tests = {"approach_speed": gains[0], "initial_pressure": gains[1], "depression": gains[2]}
    monkeypatch.setattr(identifiability, "_list_settings", lambda problem, campaign, name: [(1.0,)])
    monkeypatch.setattr(identifiability, "_try_conditions", lambda *given: tests[given[-2]])
    monkeypatch.setattr(identifiability, "_try_depression", lambda *given: tests["depression"])
    scale = dict(zip(solution.names, (4.0, 0.1, 1.0), strict=True))
    space = SimpleNamespace(family=problem.space.family, parameter=lambda name: SimpleNamespace(
        typical=3.0, transform=SimpleNamespace(scale=lambda typical: typical / 3.0 * scale[name])))
    blend = Blend(("stiffness", "gas"), np.ones(3), step * np.array([4.0, -0.02, 0.1]), singular)
    posed = SimpleNamespace(space=space, records=problem.records)
    found = identifiability._find_remedy(posed, solution, solution.flattened()[0], blend, selection.campaign)
    assert (None if found is None else found.setting) == (None if chosen is None else list(tests)[chosen])
    if found is not None:
        assert found.gain == gains[chosen] and found.names == blend.names


def describe(selection, solution, known):
    """Sentences and remedies about a fit."""
    return identifiability.describe_knowledge(selection.problem, solution, known, selection.campaign)


def test_a_pair_beside_its_correlation(monkeypatch, one_pressure):
    """A combination is said once with its correlation; another pair that correlates has a sentence of its own."""
    selection, fitted = one_pressure
    solution = fitted.solution
    remedy = identifiability.Remedy(("stiffness", "gas"), "approach_speed", (0.3, 3.0), 2.5)
    monkeypatch.setattr(identifiability, "_find_remedy", lambda *given: remedy)
    correlations = np.array([[1.0, -0.97, 0.96], [-0.97, 1.0, 0.2], [0.96, 0.2, 1.0]])
    blend = Blend(("stiffness", "gas"), np.ones(3), np.array([0.1, -0.5, 0.0]), False)
    known = identifiability.Knowledge(np.eye(3), correlations, (), (), (blend,))
    sentences, remedies = describe(selection, solution, known)
    assert remedies == (remedy,) and len(sentences) == 2
    assert "0.970" in sentences[0] and {"stiffness", "gas"} <= set(re.findall(r"\w+", sentences[0]))
    assert "+0.960" in sentences[1] and {"stiffness", "loss"} <= set(re.findall(r"\w+", sentences[1]))
    silent = dc.replace(known, silent=("loss",), undetermined=("loss",))
    assert len(describe(selection, solution, silent)[0]) == 2  # what is silent correlates with nothing
    undetermined = dc.replace(known, undetermined=("loss", "gas"))
    assert len(describe(selection, solution, undetermined)[0]) == 3  # gas stands in the combination already
    third = dc.replace(known, blends=(blend,) * 3)
    assert len(describe(selection, solution, third)[1]) == 2  # remedies are sought for the worst two


def test_changes_have_sizes(one_pressure):
    """One deviation along a combination, in per cent of a logarithmic parameter and in the unit of another."""
    selection, fitted = one_pressure
    space, solution = selection.problem.space, fitted.solution
    blend = Blend(("gas", "stiffness"), np.ones(3), np.array([0.02, -0.5, 0.0]), False)
    text = identifiability._format_change(space, solution, blend)
    assert "raising gas by 0.5 N" in text and "lowering stiffness by 2 %" in text
    mirrored = dc.replace(blend, step=-blend.step)
    assert identifiability._format_change(space, solution, mirrored) == text
    free = dc.replace(blend, names=("stiffness", "gas"), step=np.array([40.0, -80.0, 0.0]), singular=True)
    text = identifiability._format_change(space, solution, free)  # any length does: one per cent is taken
    assert "raising stiffness by 1 %" in text and "lowering gas by 0.02 N" in text
