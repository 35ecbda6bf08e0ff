"""What decides a verdict, each against theory: linear models, where refits are exact, and draws under the null."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, sparse, stats
from scipy.interpolate import BSpline
from scipy.linalg import block_diag

from ddetumble._errors import ComputationError
from ddetumble.inference import distributions, smooth
from ddetumble.inference.goodness import combine_p_values, judge_goodness, judge_values, weigh_shifts
from ddetumble.inference.identifiability import (
    list_disputed,
    measure_values,
    release_priors,
    weigh_priors,
)
from ddetumble.inference.noise import Noise
from ddetumble.inference.problem import Solution
from ddetumble.inference.smooth import measure_smooth
from ddetumble.selection import cross_validation
from ddetumble.selection.cross_validation import (
    compare_losses,
    leave_out,
    predict_left_out,
)
from ddetumble.selection.forward_selection import fits_better, helps
from ddetumble.selection.lack_of_fit import (
    Score,
    bootstrap_p_value,
    correct_for_many,
    family_p_value,
    judge_fit,
    score_directions,
)
from ddetumble.selection.problem import Fitted
from ddetumble.selection.result import SettingShift
from ddetumble.selection.settings import SelectionSettings
from ddetumble.selection.verdict_facts import describe_level, list_choices
from tests.helpers_report import make_discovery


RECORDS, ROWS, SHARED, OWN = 6, 40, 3, 2
GROUPS = np.array([0, 0, 1, 2, 3, 3])
NAMES = tuple(f"p{k}" for k in range(SHARED))
SHARP = Noise(1.0, 0.0, 1.0, 1.0, None, 0.0, "white")


class Linear:
    """Residuals e + J theta + N z of linear records, with standard normal priors of z and normal ones of theta."""

    def __init__(self, seed, noise=1.0, shared=SHARED, weight=0.0):
        generator = np.random.default_rng(seed)
        self.jacobian = generator.standard_normal((RECORDS, ROWS, shared))
        self.nuisances = generator.standard_normal((RECORDS, ROWS, OWN))
        theta, z = generator.standard_normal(shared), generator.standard_normal((RECORDS, OWN))
        self.error = (noise * generator.standard_normal((RECORDS, ROWS)) - self.jacobian @ theta
                      - np.einsum("rgk,rk->rg", self.nuisances, z))
        self.weight = np.full(shared, weight)
        self.generator = generator

    def fit(self, kept=range(RECORDS), extra=None):
        """Parameters, nuisances of the kept records, and chi-square, by one dense least-squares problem."""
        kept = list(kept)
        columns = self.jacobian if extra is None else np.concatenate([self.jacobian, extra[..., None]], axis=2)
        count, weights = columns.shape[2], np.append(self.weight, np.zeros(columns.shape[2] - len(self.weight)))
        rows, right = [], []
        for place, r in enumerate(kept):
            own = np.zeros((ROWS, OWN * len(kept)))
            own[:, OWN * place: OWN * (place + 1)] = self.nuisances[r]
            rows.append(np.concatenate([columns[r], own], axis=1))
            right.append(self.error[r])
        prior = np.diag(np.concatenate([weights, np.ones(OWN * len(kept))]))
        matrix, side = np.concatenate([*rows, prior]), np.concatenate([*right, np.zeros(len(prior))])
        x = np.linalg.lstsq(matrix, -side, rcond=None)[0]
        covariance = np.linalg.pinv(matrix.T @ matrix)[:count, :count]
        return x[:count], x[count:].reshape(len(kept), OWN), float(np.sum((side + matrix @ x) ** 2)), covariance

    def hold_out(self, record, theta, rows=slice(None)):
        """Nuisances of a record that suit its rows best at given parameters, and the chi-square there."""
        moved = self.error[record] + self.jacobian[record] @ theta
        matrix = np.concatenate([self.nuisances[record][rows], np.eye(OWN)])
        side = np.concatenate([moved[rows], np.zeros(OWN)])
        z = np.linalg.lstsq(matrix, -side, rcond=None)[0]
        return z, float(np.sum((side + matrix @ z) ** 2))

    def solve(self):
        """The fit as the package has it."""
        theta, z, chi2, _ = self.fit()
        residual = self.error + self.jacobian @ theta + np.einsum("rgk,rk->rg", self.nuisances, z)
        count = len(theta)
        empty = np.zeros((RECORDS, 1, ROWS))
        return Solution(tuple(f"p{k}" for k in range(count)), theta, z, np.ones(count), residual, self.jacobian,
                        self.nuisances, empty, empty[:, 0], empty[:, 0], np.zeros(RECORDS), theta * self.weight,
                        self.weight, chi2, True, 1, ())


@pytest.mark.parametrize("weight", [0.0, 2.0])
@pytest.mark.parametrize("seed", range(5))
def test_downdate_is_a_refit(seed, weight):
    """The loss of a condition that is left out is that of a plain refit without it, nuisances under their priors."""
    linear = Linear(seed, weight=weight)
    loss = leave_out(linear.solve(), GROUPS)
    for group in np.unique(GROUPS):
        theta = linear.fit(np.flatnonzero(GROUPS != group))[0]
        for r in np.flatnonzero(GROUPS == group):
            assert loss[r] == pytest.approx(linear.hold_out(r, theta)[1], rel=1e-9)


@pytest.mark.parametrize("free_running", [False, True])
def test_left_out_conditions_are_predicted_by_a_refit(free_running):
    """Parameters of a refit without the condition, and nuisances that suit all of a record, or its first quarter."""
    linear, seen = Linear(11), {}
    time = np.tile(np.linspace(0.0, 1.0, ROWS), (RECORDS, 1))

    def solve(names, u, z, moving):
        seen.update(u=u, z=z)
        return SimpleNamespace(channels=np.zeros((RECORDS, 1, ROWS)), residual=np.zeros((RECORDS, ROWS)), failed=())

    records = SimpleNamespace(count=RECORDS, keys=list("abcdef"), channels=("force",), stack=SimpleNamespace(time=time))
    space = SimpleNamespace(index={name: k for k, name in enumerate(NAMES)},
                            family=SimpleNamespace(free_running=free_running))
    problem = SimpleNamespace(records=records, space=space, solve=solve)
    used = predict_left_out(problem, linear.solve(), GROUPS, 0.25).used
    assert used.all() if not free_running else (used == (time > 0.25)).all()
    for r in range(RECORDS):
        theta = linear.fit(np.flatnonzero(GROUPS != GROUPS[r]))[0]
        z, _ = linear.hold_out(r, theta, time[r] <= 0.25 if free_running else slice(None))
        assert seen["u"][r] == pytest.approx(theta, abs=1e-9) and seen["z"][r] == pytest.approx(z, abs=1e-9)


def predict_linear(linear, adjust, fails=()):
    """What is predicted of linear records, and the parameters and nuisances that it is predicted with.

    Records whose keys are in `fails` cannot be computed; nothing can where it is None.
    """
    seen = {}

    def solve(names, u, z, moving):
        seen.update(u=u, z=z)
        if fails is None:
            raise ComputationError("no")
        return SimpleNamespace(channels=np.zeros((RECORDS, 1, ROWS)), residual=np.zeros((RECORDS, ROWS)), failed=fails)

    time = np.tile(np.linspace(0.0, 1.0, ROWS), (RECORDS, 1))
    records = SimpleNamespace(count=RECORDS, keys=list("abcdef"), channels=("force",), stack=SimpleNamespace(time=time))
    space = SimpleNamespace(index={name: k for k, name in enumerate(NAMES)},
                            family=SimpleNamespace(free_running=False))
    problem = SimpleNamespace(records=records, space=space, solve=solve)
    return predict_left_out(problem, linear.solve(), GROUPS, adjust=adjust), seen


def test_predictions_take_settings_as_they_are_written_down():
    """Without adjustment the parameters are those of a refit without the condition, and no nuisance has moved."""
    linear = Linear(12)
    _, seen = predict_linear(linear, False)
    assert seen["z"] == pytest.approx(0.0, abs=1e-12)
    for r in range(RECORDS):
        assert seen["u"][r] == pytest.approx(linear.fit(np.flatnonzero(GROUPS != GROUPS[r]))[0], abs=1e-9)


@pytest.mark.parametrize("adjust", [False, True])
def test_coverage_is_that_of_refits(adjust):
    """Share of the samples within 1.96 deviations of noise, parameters of the refit and settings."""
    linear = Linear(13, noise=1.5)
    for part in (linear.error, linear.jacobian, linear.nuisances):
        part[0, 30:] = 0.0  # samples that are not there
    inside, counted = 0, 0
    for r in range(RECORDS):
        theta, _, _, covariance = linear.fit(np.flatnonzero(GROUPS != GROUPS[r]))
        z = linear.hold_out(r, theta)[0] if adjust else np.zeros(OWN)
        own, shared = linear.nuisances[r], linear.jacobian[r]
        known = np.linalg.inv(own.T @ own + np.eye(OWN)) if adjust else np.eye(OWN)
        variance = 1.0 + np.diag(own @ known @ own.T) + np.diag(shared @ covariance @ shared.T)
        there = np.any(own != 0, axis=1)
        moved = (linear.error[r] + shared @ theta + own @ z)[there]
        inside += int(np.sum(np.abs(moved) <= 1.959964 * np.sqrt(variance[there])))
        counted += int(there.sum())
    assert counted == RECORDS * ROWS - 10 and 0.5 * counted < inside < 0.95 * counted
    assert predict_linear(linear, adjust)[0].coverage == pytest.approx(inside / counted, rel=1e-12)


def test_a_model_without_parameters_predicts_what_it_predicted():
    """Nothing is learnt from other conditions: the loss of a left-out one is that under its settings' priors."""
    linear = Linear(14, shared=0)
    loss, (_, seen) = leave_out(linear.solve(), GROUPS), predict_linear(linear, True)
    for r in range(RECORDS):
        z, chi2 = linear.hold_out(r, np.zeros(0))
        assert loss[r] == pytest.approx(chi2, rel=1e-9) and seen["z"][r] == pytest.approx(z, abs=1e-9)


@pytest.mark.parametrize(("adjust", "noise", "low", "high"), [
    (False, 1.0, 0.93, 0.97), (False, 3.0, 0.4, 0.93), (False, 0.3, 0.97, 1.0), (True, 0.3, 0.97, 1.0)])
def test_coverage_of_predictions(adjust, noise, low, high):
    """A right model covers 95 % of new samples (1.96 deviations: within 2 % of 9,600 draws, which come in groups of
    40), one with more noise than stated fewer, with less noise more; nuisances are drawn from their priors."""
    found = [predict_linear(Linear(seed, noise), adjust)[0].coverage for seed in range(40)]
    assert low <= np.mean(found) <= high


def test_a_parameter_that_nothing_else_fixes_is_left_where_it_is():
    """One condition alone shows a parameter: without it the others are fitted, and that one stays."""
    linear = Linear(3)
    linear.jacobian[GROUPS != 3, :, 2] = 0.0
    solution = linear.solve()
    loss, theta = leave_out(solution, GROUPS), linear.fit(np.flatnonzero(GROUPS != 3))[0]
    for r in np.flatnonzero(GROUPS == 3):
        assert loss[r] == pytest.approx(linear.hold_out(r, np.append(theta[:2], solution.u[2]))[1], rel=1e-9)


@pytest.mark.parametrize(("length", "told"), [(0.09, False), (0.11, True)])
def test_what_all_conditions_hardly_tell_is_left_where_it_is(length, told):
    """A parameter whose deviation exceeds ten typical changes stays; below that it moves as in a refit."""
    linear = Linear(3)
    linear.jacobian[..., 2] *= length / linear.fit()[3][2, 2] ** -0.5  # its deviation is about 1/length
    solution = linear.solve()
    columns, _ = solution.projected()
    assert np.linalg.norm(columns[..., 2]) == pytest.approx(length, rel=0.02)
    loss = leave_out(solution, GROUPS)
    for group in range(4):
        kept = np.flatnonzero(GROUPS != group)
        theta = linear.fit(kept)[0]
        if not told:  # a refit of the others, with what that one does already
            rest = Linear(3, shared=2)
            rest.jacobian, rest.nuisances = linear.jacobian[..., :2], linear.nuisances
            rest.error = linear.error + linear.jacobian[..., 2] * solution.u[2]
            theta = np.append(rest.fit(kept)[0], solution.u[2])
        for r in np.flatnonzero(GROUPS == group):
            assert loss[r] == pytest.approx(linear.hold_out(r, theta)[1], rel=1e-9)


def test_losses_do_not_depend_on_the_units_of_parameters():
    """A column a billion times as long as another, with the parameter so many times as small."""
    linear, scaled = Linear(16), Linear(16)
    scaled.jacobian *= np.array([1e7, 1.0, 0.01])
    assert leave_out(scaled.solve(), GROUPS) == pytest.approx(leave_out(linear.solve(), GROUPS), rel=1e-6)


def test_steps_without_a_condition_come_with_their_covariance():
    """That of a refit without it; what nothing tells of counts as known to one typical change, by itself."""
    linear = Linear(15, weight=0.5)
    solution = linear.solve()
    for out, step, covariance in cross_validation._step_aside(solution, GROUPS, *solution.projected()):
        theta, _, _, expected = linear.fit(np.flatnonzero(~out))
        assert step == pytest.approx(theta - solution.u, rel=1e-9)
        assert covariance == pytest.approx(expected, rel=1e-9)
    silent = Linear(15)
    silent.jacobian[..., 1] = 0.0
    solution = silent.solve()
    for out, step, covariance in cross_validation._step_aside(solution, GROUPS, *solution.projected()):
        theta, _, _, expected = silent.fit(np.flatnonzero(~out))
        assert step[[0, 2]] == pytest.approx((theta - solution.u)[[0, 2]], rel=1e-9) and abs(step[1]) < 1e-12
        assert covariance[1] == pytest.approx([0.0, 1.0, 0.0])
        assert covariance[np.ix_([0, 2], [0, 2])] == pytest.approx(expected[np.ix_([0, 2], [0, 2])], rel=1e-9)


def test_a_loss_past_any_meaning_is_finite():
    """One condition alone shows a parameter, and a little beyond rounding: without it the fit goes anywhere."""
    linear = Linear(3, noise=0.0)
    linear.error[:] = 0.0
    linear.error[GROUPS == 1] = 1e9
    loss = leave_out(linear.solve(), GROUPS)
    assert (loss[GROUPS == 1] == 1e12).all() and np.isfinite(loss).all()


def test_early_rows_of_every_channel():
    """The first part of the time of each record, which need not begin at 0, once a channel."""
    time = np.array([[2.0, 3.0, 4.0, 6.0], [0.0, 1.0, 1.5, 1.5]])
    records = SimpleNamespace(count=2, stack=SimpleNamespace(time=np.concatenate([time, time[:1]])))
    found = cross_validation._find_early(records, SimpleNamespace(residual=np.zeros((2, 8))), 0.5)
    assert found.tolist() == [[True, True, True, False] * 2, [True, False, False, False] * 2]


def test_records_that_cannot_be_predicted():
    """Those that fail are not numbers, and all are where the model breaks down; coverage is said all the same."""
    linear = Linear(12)
    whole, _ = predict_linear(linear, True)
    some, _ = predict_linear(linear, True, fails=("b", "e"))
    assert np.isnan(some.channels[[1, 4]]).all() and np.isfinite(some.channels[[0, 2, 3, 5]]).all()
    none, _ = predict_linear(linear, True, fails=None)
    assert none.channels.shape == whole.channels.shape and np.isnan(none.channels).all()
    assert none.used.shape == whole.used.shape and none.used.all()
    assert whole.coverage == some.coverage == none.coverage
    empty = Linear(12)
    for part in (empty.error, empty.jacobian, empty.nuisances):
        part[:] = 0.0
    assert np.isnan(predict_linear(empty, True)[0].coverage)


def test_samples_that_no_setting_moves_are_covered_too():
    """Only where neither the residual nor any setting says anything is there no sample."""
    linear = Linear(13)
    linear.nuisances[:, :20] = 0.0
    for part in (linear.error, linear.jacobian, linear.nuisances):
        part[1, 35:] = 0.0
    inside, theta = 0.0, {g: linear.fit(np.flatnonzero(GROUPS != g)) for g in range(4)}
    for r in range(RECORDS):
        step, _, _, covariance = theta[GROUPS[r]]
        own, shared = linear.nuisances[r], linear.jacobian[r]
        z = linear.hold_out(r, step)[0]
        known = np.linalg.inv(own.T @ own + np.eye(OWN))
        sd = np.sqrt(1.0 + np.diag(own @ known @ own.T) + np.diag(shared @ covariance @ shared.T))
        moved = (linear.error[r] + shared @ step + own @ z)[: 35 if r == 1 else ROWS]
        inside += np.sum(np.abs(moved) <= 1.959964 * sd[: len(moved)])
    assert predict_linear(linear, True)[0].coverage == pytest.approx(inside / (RECORDS * ROWS - 5), rel=1e-12)


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_covariance_is_the_inverse_of_the_normal_equations(weight):
    linear = Linear(4, weight=weight)
    assert linear.solve().covariance() == pytest.approx(linear.fit()[3], rel=1e-9)


def score(linear, columns, scales=None):
    """Scores of directions with the given columns, shape (directions, records, rows), by coordinates over `scales`."""
    solution, names = linear.solve(), [f"e{k}" for k in range(len(columns))]
    wide = np.concatenate([columns, np.zeros((*columns.shape[:2], OWN))], axis=2)
    problem = SimpleNamespace(
        space=SimpleNamespace(index={n: k for k, n in enumerate((*solution.names, *names))}),
        scales=np.append(np.ones(len(solution.names)), np.ones(len(names)) if scales is None else scales),
        columns=lambda points, z, own: np.concatenate([wide[[names.index(n) for n in group]] for group, _ in points]))
    return score_directions(problem, solution, [(name, name, {}) for name in names])


@pytest.mark.parametrize("seed", range(5))
def test_score_is_what_a_refit_gains(seed):
    """z² is the drop of chi-square with the direction free, its step the amplitude there, and visible what refits leave
    of its squared length.
    """
    linear = Linear(seed)
    columns = linear.generator.standard_normal((4, RECORDS, ROWS))
    columns[3] = columns[2] + 0.1 * columns[3]  # two that look alike
    before = linear.fit()[2]
    found = score(linear, columns)
    for one, column in zip(found, columns, strict=True):
        theta, _, chi2, covariance = linear.fit(extra=column)
        assert one.z**2 == pytest.approx(before - chi2, rel=1e-7)
        assert one.step == pytest.approx(theta[-1], rel=1e-7) and np.sign(one.z) == np.sign(theta[-1])
        assert one.information == pytest.approx(1.0 / covariance[-1, -1], rel=1e-7)
        assert one.visible == pytest.approx(1.0 / covariance[-1, -1] / np.sum(column**2), rel=1e-7)
    assert abs(found[2].cosines[3]) > 0.98 and abs(found[0].cosines[1]) < 0.5


@pytest.mark.parametrize("shared", [0, 2])
def test_a_score_in_the_units_of_its_coordinate(shared):
    """A step is that of a refit by the coordinate itself, whose information is in the same unit; so it is of a column
    as faint as 1e-7, of one that parameters imitate but for a millionth, and beside no parameter at all.
    """
    linear, scales = Linear(8, shared=shared), np.array([0.02, 5.0, 3.0])
    columns = linear.generator.standard_normal((3, RECORDS, ROWS))
    columns[1] *= 1e-7
    if shared:
        columns[2] = 1e-6 * columns[2] + linear.jacobian[..., 0]
    before = linear.fit()[2]
    for one, column, scale in zip(score(linear, columns, scales), columns, scales, strict=True):
        size = np.linalg.norm(column - (linear.jacobian[..., 0] if shared and one.name == "e2" else 0.0))
        left = column if one.name != "e2" else columns[2] - (linear.jacobian[..., 0] if shared else 0.0)
        theta, _, chi2, covariance = linear.fit(extra=left / size)
        assert one.z**2 == pytest.approx(before - chi2, rel=1e-4)
        assert one.step == pytest.approx(theta[-1] / size * scale, rel=1e-4)
        assert one.information == pytest.approx((size / scale) ** 2 / covariance[-1, -1], rel=1e-4)


def test_directions_with_shapes_are_those_at_their_shapes():
    """An effect at two shapes has two directions, each at its own; effects in any order keep theirs, and their cosines.

    The columns of one effect at one shape are asked for together, those of others may be so.
    """
    linear = Linear(9)
    solution, asked = linear.solve(), []
    index = {n: k for k, n in enumerate((*NAMES, "a.x", "a.y", "a.w", "b.x"))}
    solution = dc.replace(solution, u=np.append(solution.u, np.zeros(4)))
    phase = linear.generator.standard_normal((len(index), RECORDS, ROWS))

    def column(name, w):
        return np.cos(phase[index[name]] + (w if name[0] == "a" else 0.0))

    def columns(points, z, own):
        asked.extend(group for group, _ in points)
        return np.stack([np.concatenate([column(name, u[index["a.w"]]), np.zeros((RECORDS, OWN))], axis=1)
                         for group, u in points for name in group])

    problem = SimpleNamespace(space=SimpleNamespace(index=index), scales=np.ones(len(index)), columns=columns)
    wanted = [("a", "a.x", {"a.w": 0.5}), ("b", "b.x", {}), ("a", "a.x", {"a.w": 1.5}), ("a", "a.y", {"a.w": 0.5}),
              ("a", "a.y", {"a.w": 1.5})]
    found, before = score_directions(problem, solution, wanted), linear.fit()[2]
    assert [(s.effect, s.name, s.shapes) for s in found] == wanted and [s.place for s in found] == [0, 1, 2, 3, 4]
    assert sorted(map(sorted, asked)) == sorted([["a.x", "a.y", "b.x"], ["a.x", "a.y"]])
    for k, (one, (_, name, shapes)) in enumerate(zip(found, wanted, strict=True)):
        drop = before - linear.fit(extra=column(name, shapes.get("a.w", 0.0)))[2]
        assert one.z**2 == pytest.approx(drop, rel=1e-7)
        assert one.cosines[k] == pytest.approx(1.0) and one.cosines[0] == pytest.approx(found[0].cosines[k])


def test_a_direction_that_parameters_imitate_scores_nothing():
    linear = Linear(7)
    columns = np.stack([linear.jacobian[..., 0] - 2.0 * linear.jacobian[..., 1], np.zeros((RECORDS, ROWS))])
    assert all(one.z == 0.0 and one.step == 0.0 and one.information == 0.0 for one in score(linear, columns))


def test_what_is_nothing_scores_nothing():
    """A column of a length of 1e-10 is rounding, whatever its direction."""
    linear = Linear(7)
    column = linear.generator.standard_normal((RECORDS, ROWS))
    one, other = score(linear, np.stack([1e-11 * column, 1e-9 * column]))
    assert (one.z, one.step, one.information, one.visible) == (0.0, 0.0, 0.0, 0.0) and other.z != 0.0


def test_no_direction_scores_nothing():
    assert score_directions(None, Linear(7).solve(), []) == []


def assert_uniform(p_values, levels=(0.01, 0.05, 0.1, 0.3, 0.7)):
    """At every level as many p-values lie below as chance has it, within four standard deviations."""
    n = len(p_values)
    for level in levels:
        spread = np.sqrt(n * level * (1.0 - level))
        assert abs(np.sum(np.asarray(p_values) < level) - n * level) < 4.0 * spread + 1.0, level


def make_scores(z, cosines):
    return [Score("e", f"n{k}", {}, x, x, 1.0, 1.0, row, k)
            for k, (x, row) in enumerate(zip(z, cosines, strict=True))]


def test_p_value_of_a_family_is_uniform():
    """Of the largest of twelve independent scores."""
    generator = np.random.default_rng(1)
    draws = generator.standard_normal((4000, 12))
    assert_uniform([family_p_value(make_scores(z, np.eye(12)), {"force": SHARP}) for z in draws])


@pytest.mark.parametrize("likeness", [0.0, 0.6, 0.99])
def test_bootstrap_p_value_is_uniform(likeness):
    """Of scores that look alike, which count once."""
    generator = np.random.default_rng(2)
    cosines = np.full((8, 8), likeness) + (1.0 - likeness) * np.eye(8)
    draws = generator.multivariate_normal(np.zeros(8), cosines, size=500)
    assert_uniform([bootstrap_p_value(make_scores(z, cosines), {"force": SHARP}, 1000) for z in draws])


def test_p_values_of_a_large_score():
    """Never zero by bootstrap, where zero was drawn; by the formula that of one score times their number."""
    scores = make_scores([9.0, 0.0, 0.0, 0.0], np.eye(4))
    assert bootstrap_p_value(scores, {"force": SHARP}, 99) == pytest.approx(0.01)
    assert family_p_value(scores, {"force": SHARP}) == pytest.approx(4 * stats.chi2.sf(81.0, 1), rel=1e-6)
    assert family_p_value([], {"force": SHARP}) == bootstrap_p_value([], {"force": SHARP}) == 1.0


def test_an_uncertain_noise_level_widens_the_family():
    scores, vague = make_scores([4.0], np.eye(1)), Noise(1.0, 0.0, 1.0, 1.0, None, 0.25, "white")
    assert family_p_value(scores, {"force": vague}) == pytest.approx(stats.chi2.sf(16.0 / 1.5, 1), rel=1e-9)


def test_scores_under_a_noise_that_few_values_tell():
    """Student's t: of one score under noise that is taken larger for its degrees of freedom, two-sided."""
    for degrees in (3, 12):
        noise = {"force": dc.replace(SHARP, degrees=degrees), "depression": dc.replace(SHARP, degrees=20)}
        wider = stats.t.ppf(0.975, degrees) / stats.norm.ppf(0.975)
        for z in (0.5, 2.0, 4.0):
            expected = 2.0 * stats.t.sf(z * wider, degrees)
            assert family_p_value(make_scores([z], np.eye(1)), noise) == pytest.approx(expected, rel=1e-9)


def test_misfit_of_values_beyond_their_own_scatter():
    """Uniform where repeats tell the noise and their scatter is part of what is left; 1 where nothing else is."""
    generator, known, rest, p_values = np.random.default_rng(23), 6, 5, []
    wider = stats.t.ppf(0.975, known) / stats.norm.ppf(0.975)
    for _ in range(2000):
        scatter, misfit = generator.chisquare(known), generator.chisquare(rest)
        # In units of the variance that the repeats show, taken larger as it is.
        total = (scatter + misfit) / (scatter / known) / wider**2
        p_values.append(judge_values(total, known + rest, {"force": dc.replace(SHARP, degrees=known)}))
    assert_uniform(p_values)
    for degrees in (known, 0):
        assert judge_values(50.0, degrees, {"force": dc.replace(SHARP, degrees=known)}) == 1.0


def test_smallest_of_many():
    """One in two of two coins lands so: 1 - (1 - p)^n, and one tiny p-value counts n times."""
    assert correct_for_many(0.5, 2) == pytest.approx(0.75) and correct_for_many(0.1, 1) == pytest.approx(0.1)
    assert correct_for_many(1e-20, 7) == pytest.approx(7e-20) and correct_for_many(1.0, 3) == pytest.approx(1.0)


def test_bootstrap_with_a_noise_level_that_is_uncertain():
    """Of one direction beside one that nothing tells of: chance averaged over the level, a log-normal one, by
    quadrature; the least certain of two channels counts."""
    sharp, vague = SHARP, dc.replace(SHARP, log_level_sd=0.6)
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    idle = Score("e", "n0", {}, 0.0, 0.0, 0.0, 0.0, np.array([0.0, 0.0]), 0)
    for z in (1.0, 2.5):
        one = Score("e", "n1", {}, z, z, 1.0, 1.0, np.array([0.0, 1.0]), 1)
        expected = weights @ stats.chi2.sf(z**2 * np.exp(-0.6 * nodes), 1) / weights.sum()
        found = bootstrap_p_value([idle, one], {"a": sharp, "b": vague}, 20_000)
        assert found == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 20_000))
    assert family_p_value([one], {"a": sharp, "b": vague}) == pytest.approx(stats.chi2.sf(2.5**2 / 2.2, 1))


def test_of_two_directions_the_larger_score_counts_once():
    """Independent ones: 1 - (1 - p)²; the same twice: p."""
    for cosine in (0.0, 1.0):
        cosines = np.array([[1.0, cosine], [cosine, 1.0]])
        p = stats.chi2.sf(4.0, 1)
        expected = p if cosine else 1.0 - (1.0 - p) ** 2
        found = bootstrap_p_value(make_scores([2.0, -1.0], cosines), {"force": SHARP}, 20_000)
        assert found == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 20_000))


def make_splines(rows=ROWS):
    """Splines over a record, shape (rows, splines)."""
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, 9), [1.0] * 3])
    return sparse.csr_matrix(BSpline.design_matrix(np.linspace(0.0, 1.0, rows), knots, 3))


def pose(free_running):
    """A problem of which no more is known than whether its records run on."""
    return SimpleNamespace(space=SimpleNamespace(family=SimpleNamespace(free_running=free_running)),
                           records=SimpleNamespace(are_values=False))


@pytest.mark.parametrize("free_running", [False, True])
@pytest.mark.parametrize("shared", [0, 3])
def test_smooth_misfit_is_what_splines_would_gain(shared, free_running):
    """Of every record fitted by itself with splines and parameters free; what has no sample counts for nothing."""
    linear, basis = Linear(6, shared=shared), make_splines().toarray()
    basis = np.concatenate([basis, np.zeros((ROWS, 1))], axis=1)
    total, degrees = measure_smooth(pose(free_running), linear.solve(), [sparse.csr_matrix(basis)] * RECORDS)
    before = linear.fit()[2]
    after = 0.0
    for r in range(RECORDS):
        columns = np.concatenate([linear.nuisances[r], linear.jacobian[r], basis], axis=1)
        rows = np.concatenate([columns, np.eye(OWN, columns.shape[1])])
        side = np.append(linear.error[r], np.zeros(OWN))
        after += np.sum((side - rows @ np.linalg.lstsq(rows, side, rcond=1e-10)[0]) ** 2)
    assert total == pytest.approx(before - after, rel=1e-9)
    assert degrees == RECORDS * (basis.shape[1] - 1) + (RECORDS - 1) * shared


@pytest.mark.parametrize("weight", [0.0, 3.0, 30.0, 1e4])
def test_degrees_of_freedom_of_values_with_priors(weight):
    """A prior takes its parameter's part of the hat matrix: of all rows but those of the priors, less the nuisances."""
    linear = Linear(7, weight=weight)
    records = SimpleNamespace(count=RECORDS, used=np.ones((RECORDS, 1, ROWS), dtype=bool))
    solution = linear.solve()
    held = dc.replace(solution, prior_residual=np.zeros(SHARED))  # priors that agree
    total, degrees = measure_values(SimpleNamespace(records=records), held)
    rows = np.concatenate([np.concatenate([linear.jacobian.reshape(-1, SHARED), block_diag(*linear.nuisances)], axis=1),
                           np.eye(RECORDS * OWN, SHARED + RECORDS * OWN, SHARED)])
    normal = rows.T @ rows + np.diag([weight**2] * SHARED + [0.0] * RECORDS * OWN)
    shared = np.trace(np.linalg.solve(normal, rows.T @ rows)) - RECORDS * OWN
    assert degrees == pytest.approx(RECORDS * ROWS - shared, rel=1e-9)
    assert shared == pytest.approx({0.0: SHARED, 1e4: 0.0}.get(weight, shared), abs=1e-3)


def test_values_of_a_model_that_was_given():
    """Without free parameters all that is left counts, with as many degrees of freedom as there are values."""
    linear = Linear(10, shared=0)
    records = SimpleNamespace(count=RECORDS, used=np.ones((RECORDS, 1, ROWS), dtype=bool))
    total, degrees = measure_values(SimpleNamespace(records=records), linear.solve())
    assert total == pytest.approx(linear.fit()[2], rel=1e-9) and degrees == RECORDS * ROWS
    assert weigh_priors(linear.solve()).shape == (0,)


@pytest.mark.parametrize("weight", [0.3, 3.0, 100.0])
def test_distance_of_a_prior_from_what_the_rest_says(weight):
    """The estimate without it less its mean, over the root of both variances, however narrow it is."""
    linear = Linear(9, weight=weight)
    solution, alone = linear.solve(), Linear(9, weight=weight)
    alone.weight[0] = 0.0
    theta, _, _, covariance = alone.fit()
    expected = theta[0] / np.sqrt(1.0 / weight**2 + covariance[0, 0])
    assert weigh_priors(solution)[0] == pytest.approx(expected, rel=1e-6)
    assert not weigh_priors(Linear(9).solve()).any()


class Posed:
    """A problem whose fit `solve` returns, given which of its parameters have a prior."""

    space = SimpleNamespace(commons=())

    def __init__(self, names, counted, solve):
        self.priors = {name: (0.0, 1.0) for name in names}
        self.records = SimpleNamespace(count=len(counted), used=counted > 0)
        self._solve = solve

    def solve(self, names, u, z):
        return self._solve(np.array([name in self.priors for name in names]))


def test_a_prior_that_values_disagree_with_is_let_go():
    """Far from its prior a parameter leaves what it leaves without one; near it, what the fit leaves."""
    linear, free = Linear(8, weight=1.0), Linear(8)

    def solve(held):
        linear.weight = 1.0 * held
        return linear.solve()

    problem, near = Posed(NAMES, np.ones((RECORDS, 1, ROWS)), solve), linear.solve()
    assert np.all(np.abs(near.prior_residual) < 3.0)
    left = float(np.sum(near.residual**2) + np.sum(near.z**2))
    assert measure_values(problem, near)[0] == pytest.approx(left, rel=1e-9)
    for one in (linear, free):  # the truth at ten of these deviations
        one.error -= one.jacobian @ np.full(SHARED, 10.0)
    far = solve(np.ones(SHARED))
    total, degrees = measure_values(problem, far)
    assert total == pytest.approx(free.fit()[2], rel=1e-9)
    assert degrees == pytest.approx(RECORDS * ROWS - SHARED, rel=1e-12)
    assert release_priors(problem, far)[0] == pytest.approx(weigh_priors(far), rel=1e-6)  # a linear model's refit


@pytest.mark.parametrize(("height", "disputed"), [(1.0, False), (5.0, True)])
def test_a_prior_in_a_valley_that_levels_off(height, disputed):
    """One value, 48 deviations from a model that can make up for less than `height` of them, far from its prior.

    The slope at the fit promises that all of it can go; a refit says how little does.
    """
    def fit(held):
        def left(x):
            return np.append(48.0 - height * np.tanh(x), held * x)

        x = optimize.least_squares(left, [1.0], bounds=([0.0], [12.0]), xtol=1e-14, gtol=1e-14, ftol=1e-14).x
        residual, slope, none = left(x), -height / np.cosh(x) ** 2, np.zeros((1, 1, 1))
        return Solution(("p0",), x, np.zeros((1, 0)), np.ones(1), residual[None, :1], slope[None, None],
                        np.zeros((1, 1, 0)), none, none[0], none[0], np.zeros(1), residual[1:], 1.0 * held,
                        float(np.sum(residual**2)), True, 1, ())

    problem, solution = Posed(("p0",), np.ones((1, 1, 1)), fit), fit(np.ones(1))
    assert abs(weigh_priors(solution)[0]) > 40.0
    apart = release_priors(problem, solution)[0][0]
    assert abs(apart) == pytest.approx(np.sqrt(solution.chi2 - fit(np.zeros(1)).chi2), rel=1e-6)
    assert list_disputed(problem, solution) == (("p0",) if disputed else ())
    total, _ = measure_values(problem, solution)
    assert total == pytest.approx((48.0 - height) ** 2 if disputed else solution.residual[0, 0] ** 2, rel=1e-6)


@pytest.mark.parametrize(("free_running", "alike", "apart"), [(False, 2e-7, 1e-6), (True, 3e-6, 1e-4)])
def test_columns_that_are_alike_to_rounding_count_once(free_running, alike, apart):
    """Twelve splines that differ by so little are one; by more they are twelve."""
    linear = Linear(6, shared=0)
    one, others = linear.generator.standard_normal((ROWS, 1)), np.linalg.qr(
        linear.generator.standard_normal((ROWS, 12)))[0]
    for difference, count in ((alike, 1), (apart, 12)):
        basis = sparse.csr_matrix(one / np.linalg.norm(one) + difference * others)
        assert measure_smooth(pose(free_running), linear.solve(), [basis] * RECORDS)[1] == RECORDS * count


def test_triangular_factor_of_many_rows(monkeypatch):
    """Part by part it has the normal equations of the whole, whichever rows are looked at together."""
    generator = np.random.default_rng(0)
    left, right = sparse.csr_matrix(generator.standard_normal((57, 3))), generator.standard_normal((57, 2))
    whole = np.concatenate([left.toarray(), right], axis=1)
    for rows in (1, 13, 57, 100):
        monkeypatch.setattr(smooth, "ROWS", rows)
        factor = smooth._triangulate(left, right)
        assert factor.shape == (5, 5) and factor.T @ factor == pytest.approx(whole.T @ whole, rel=1e-12)


def judge(linear, bases, score_p_value=1.0, repeats_p_value=None, nuisances=("speed", "time"), level=0.0):
    """Lack of fit of linear records."""
    stack = SimpleNamespace(condition_sd=np.ones((RECORDS, len(nuisances))))
    records = SimpleNamespace(stack=stack, count=RECORDS, nuisances=nuisances, starts=(), keys=list("abcdef"),
                              are_values=False)
    problem = SimpleNamespace(records=records, space=pose(False).space)
    return judge_fit(problem, linear.solve(), bases, {"force": dc.replace(SHARP, log_level_sd=level)}, score_p_value,
                     repeats_p_value=repeats_p_value)


@pytest.mark.parametrize("nuisances", [("speed", "time"), ("zero:force", "drift:force")])
def test_statistics_share_the_level(nuisances):
    """The smallest p-value counts three times, and four where repeats are looked at; what is no setting is not."""
    linear, bases = Linear(21), [make_splines()] * RECORDS
    linear.error[0] += 9.0 * linear.nuisances[0, :, 0]  # the first nuisance is moved by many deviations
    for repeats in (None, 0.5, 1e-4):
        for score_p_value in (1.0, 1e-3):
            found = judge(linear, bases, score_p_value, repeats, nuisances)
            used = [found.smooth_p_value, score_p_value, found.settings_p_value, repeats]
            used = [p for p in used if p is not None]
            assert found.p_value == pytest.approx(min(1.0, len(used) * min(used)))
            assert found.rejected == (found.p_value < 0.01) and found.repeats_p_value == repeats
            assert found.score_p_value == score_p_value
            assert found.settings_p_value == 1.0 if ":" in nuisances[0] else found.settings_p_value < 1e-4


def test_lack_of_fit_of_one_degree_of_freedom():
    """One column in one record, no parameters: its statistic is what a refit with it gains."""
    linear = Linear(22, shared=0)
    column = np.zeros((RECORDS, ROWS))
    column[2] = np.sin(np.linspace(0.0, 3.0, ROWS))
    bases = [sparse.csr_matrix(column[r][:, None]) for r in range(RECORDS)]
    found = judge(linear, bases)
    gain = linear.fit()[2] - linear.fit(extra=column)[2]
    assert found.degrees == 1 and found.statistic == pytest.approx(gain, rel=1e-9)
    assert found.smooth_p_value == pytest.approx(stats.norm.sf((np.log(gain) + 1.0) / np.sqrt(2.0)), rel=1e-9)


@pytest.mark.parametrize("free_running", [False, True])
def test_smooth_misfit_is_chi_square(free_running):
    """Of complete linear models: as many degrees of freedom as splines, less parameters, and uniform p-values."""
    basis, problem, p_values = make_splines(), pose(free_running), []
    for seed in range(300):
        total, degrees = measure_smooth(problem, Linear(seed).solve(), [basis] * RECORDS)
        # Splines, parameters and nuisances of each record, less what was fitted.
        assert degrees == RECORDS * basis.shape[1] + (RECORDS - 1) * SHARED
        p_values.append(stats.chi2.sf(total, degrees))
    assert_uniform(p_values)


@pytest.mark.parametrize("free_running", [False, True])
def test_smooth_misfit_sees_what_is_smooth(free_running):
    """A smooth wave adds its whole square; one of the other sign from sample to sample adds next to nothing.

    Without noise, what is left is the part of settings that their priors hold back, and nothing of a right model.
    """
    x, basis, problem = np.linspace(0.0, 1.0, ROWS), make_splines(), pose(free_running)
    exact = Linear(5, noise=0.0)
    exact.error = -np.einsum("rgk,k->rg", exact.jacobian, np.ones(SHARED))
    assert measure_smooth(problem, exact.solve(), [basis] * RECORDS)[0] == pytest.approx(0.0, abs=1e-12)
    found = []
    for wave in (np.sin(np.pi * x), (-1.0) ** np.arange(ROWS)):
        linear = Linear(5, noise=0.0)
        linear.error = linear.error + 3.0 * wave
        found.append(measure_smooth(problem, linear.solve(), [basis] * RECORDS)[0] / linear.fit()[2])
    assert found[0] > 0.99 and found[1] < 0.6


def test_smallest_p_value_counts_for_all():
    assert combine_p_values((0.2, 0.01, 0.5)) == pytest.approx(0.03) and combine_p_values((0.9, 0.8)) == 1.0
    assert combine_p_values(()) == 1.0
    generator = np.random.default_rng(3)
    below = np.mean([combine_p_values(p) < 0.05 for p in generator.random((4000, 3)).tolist()])
    assert below < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / 4000)


def test_paired_difference_over_conditions():
    """Sum over conditions; its standard error that of a sum of so many, from their scatter."""
    generator = np.random.default_rng(6)
    loss, best = generator.random(RECORDS), generator.random(RECORDS)
    sums = [np.sum((loss - best)[GROUPS == g]) for g in range(4)]
    difference, error = compare_losses(loss, best, GROUPS)
    assert difference == pytest.approx(np.sum(sums)) and error == pytest.approx(np.sqrt(4) * np.std(sums, ddof=1))
    two = np.array([0, 0, 0, 1, 1, 1])
    halves = [np.sum((loss - best)[two == g]) for g in range(2)]
    assert compare_losses(loss, best, two) == (pytest.approx(np.sum(halves)), pytest.approx(abs(np.subtract(*halves))))
    assert compare_losses(loss, best, np.zeros(RECORDS)) == (pytest.approx(np.sum(loss - best)), np.inf)


@pytest.mark.parametrize(("difference", "error", "significant", "beaten"), [
    (8.99, 0.0, False, False), (9.0, 4.5, True, True), (9.0, 4.51, False, False), (49.99, 30.0, False, False),
    (50.0, 1e3, False, True), (-60.0, 0.0, False, False)])
def test_rules_of_a_difference(difference, error, significant, beaten):
    settings = SelectionSettings()
    assert settings.is_significant(difference, error) is significant
    assert settings.is_beaten(difference, error) is beaten


def test_rules_follow_their_settings():
    settings = SelectionSettings(significant=20.0, decisive=100.0, level=0.03)
    assert not settings.is_significant(19.0, 0.0) and settings.is_significant(20.0, 10.0)
    assert not settings.is_beaten(99.0, 60.0) and settings.is_beaten(100.0, 60.0)
    assert settings.level_each == pytest.approx(0.01)


def fitted(loss, chi2=None, names=("a",), forecast=None):
    """A model of which no more is known than its losses."""
    loss = np.asarray(loss, dtype=float)
    solution = SimpleNamespace(names=names, chi2=float(loss.sum()) if chi2 is None else chi2)
    return Fitted((), solution, loss, loss if forecast is None else np.asarray(forecast, dtype=float))


def test_merit_prices_parameters():
    assert fitted([10.0, 20.0], names=("a", "b")).merit == 48.0 and fitted([10.0, 20.0]).score == 30.0


@pytest.mark.parametrize(("gains", "expected"), [
    ([3.0, 3.0, 3.0, 3.0], True),  # certain, in all
    ([2.0, 2.0, 2.0, 2.0], False),  # 8 noise variances are chance
    ([30.0, -5.0, -5.0, -5.0], False),  # one condition against three
    ([80.0, -5.0, -5.0, -5.0], True),  # decisive, whoever shows it
    ([30.0, 1.0, 1.0, -5.0], True),  # most of them
    ([-3.0, -3.0, -3.0, -3.0], False),
])
def test_when_an_addition_helps(gains, expected):
    selection = SimpleNamespace(settings=SelectionSettings(), groups=np.arange(4), disperse=lambda grown: 1.0,
                                family=SimpleNamespace(free_running=False))
    assert helps(selection, fitted([100.0] * 4), fitted(100.0 - np.array(gains))) is expected


@pytest.mark.parametrize(("gains", "unit", "expected"), [
    ([5.0, 5.0, 5.0, 5.0], 2.0, True),  # 20 > 9 x 2
    ([5.0, 5.0, 5.0, 5.0], 2.3, False),  # 20 < 9 x 2.3
    ([150.0, -20.0, -20.0, -20.0], 1.5, True),  # one condition alone, 90 > 50 x 1.5
    ([150.0, -20.0, -20.0, -20.0], 1.9, False),  # 90 < 50 x 1.9
    ([100.0, 100.0, 100.0, 100.0], 40.0, True),
    ([2.0, 2.0, 2.0, 2.0], 0.5, False)])  # below what is chance without dispersion
def test_a_misfit_that_is_left_makes_gains_count_less(gains, unit, expected):
    """What noise and settings leave makes differences of losses so many times as large: so are their thresholds."""
    selection = SimpleNamespace(settings=SelectionSettings(), groups=np.arange(4), disperse=lambda grown: unit,
                                family=SimpleNamespace(free_running=False))
    assert helps(selection, fitted([1000.0] * 4), fitted(1000.0 - np.array(gains))) is expected


def test_an_addition_that_forecasts_worse_does_not_help():
    """Of records that run on from where they start."""
    selection = SimpleNamespace(settings=SelectionSettings(), groups=np.arange(4), disperse=lambda grown: 1.0,
                                family=SimpleNamespace(free_running=True))
    before = fitted([100.0] * 4)
    assert helps(selection, before, fitted([90.0] * 4, forecast=[95.0] * 4))
    assert helps(selection, before, fitted([90.0] * 4, forecast=[110.0, 111.0, 109.0, 110.0])) is False
    assert helps(selection, before, before) is False


def test_when_another_fits_far_better():
    """By 50 noise variances, and by a quarter of what the best removes, parameters counted."""
    before, best = fitted([0.0], chi2=1000.0), fitted([0.0], chi2=600.0)
    assert not fits_better(fitted([0.0], chi2=505.0), best, before)
    assert fits_better(fitted([0.0], chi2=495.0), best, before)
    assert not fits_better(fitted([0.0], chi2=495.0, names=("a", "b")), best, before)
    near, low = fitted([0.0], chi2=960.0), fitted([0.0], chi2=915.0)
    assert not fits_better(low, near, before) and fits_better(fitted([0.0], chi2=905.0), near, before)


@pytest.mark.parametrize(("shifts", "share", "alike"), [
    ([-41.0, -43.0, -39.0], -0.12, True), ([-41.0, 43.0, -39.0], -0.04, False), ([5.0, 4.0, 6.0, 1.0], 0.01, False),
    ([-41.0, -43.0], -0.12, False), ([3.0, 3.0, 3.0], None, False)])
def test_shifts_that_all_records_share(shifts, share, alike):
    """As of one gauge that reads wrong: the same in three records or more, but for a scatter of a third."""
    shifts = np.array(shifts)
    worst = int(np.argmax(np.abs(shifts)))
    one = SettingShift("initial_pressure", 3e3, float(np.sqrt(np.mean(shifts**2))), shifts[worst], f"r{worst}", 1e-9,
                       shifts, share)
    assert one.is_alike is alike
    assert describe_level(1.0, [one], 4.0)["moved"]["alike"] == (share if alike else None)


def test_shifts_are_weighed_together_and_alone():
    for shifts in (np.array([0.5, -1.0, 2.0]), np.array([0.1, -6.0]), np.array([3.0] * 9)):
        together = stats.chi2.sf(np.sum(shifts**2), len(shifts))
        alone = min(1.0, len(shifts) * 2.0 * stats.norm.sf(np.max(np.abs(shifts))))
        assert weigh_shifts(shifts) == pytest.approx(min(1.0, 2.0 * min(together, alone)), rel=1e-9)
    draws = np.random.default_rng(5).standard_normal((2000, 6))
    below = np.mean([weigh_shifts(x) < 0.05 for x in draws])
    assert 0.02 < below < 0.05 + 4.0 * np.sqrt(0.05 * 0.95 / 2000)


def test_goodness_of_fit():
    good = judge_goodness(100.0, 100, {"speed": {"a": 1.0, "b": -1.5}, "time": {"a": 0.5}, "none": {}})
    assert (good.setting, good.record, good.shift) == ("speed", "b", -1.5) and not good.misfit and not good.moved
    assert good.chi2_reduced == 1.0 and good.p_value == pytest.approx(stats.chi2.sf(100.0, 100))
    assert good.shift_p_value == pytest.approx(min(1.0, 2.0 * min(weigh_shifts(np.array([1.0, -1.5])),
                                                                  weigh_shifts(np.array([0.5])))))
    moved = judge_goodness(100.0, 100, {"speed": {"a": 6.0}})
    assert moved.moved and not moved.misfit and moved.shift == 6.0
    assert judge_goodness(200.0, 100, {}).misfit and not judge_goodness(149.0, 100, {}).misfit
    assert not judge_goodness(1.6, 1, {}).misfit  # chance
    empty = judge_goodness(0.0, 0, {})
    assert (empty.p_value, empty.shift_p_value, empty.setting, empty.shift) == (1.0, 1.0, "", 0.0)
    assert judge_goodness(3.0, 1, {}).p_value < 1.0 and judge_goodness(3.0, 0, {}).chi2_reduced == 3.0
    texts = {str(x) for x in (good, moved, judge_goodness(200.0, 100, {}),
                              judge_goodness(200.0, 100, {"speed": {"a": 6.0}}))}
    assert len(texts) == 4 and str(good) == "" and not str(judge_goodness(149.0, 100, {}))


@pytest.mark.parametrize(("law", "method", "shapes"), [
    ("chi2", "sf", (7,)), ("chi2", "isf", (7,)), ("chi2", "ppf", (2.5,)), ("f", "sf", (3, 40.5)),
    ("f", "isf", (3, 40.5)), ("gamma", "sf", (3.5,)), ("norm", "cdf", ()), ("norm", "sf", ()), ("norm", "ppf", ()),
    ("t", "ppf", (6.5,)), ("beta", "sf", (2.0, 3.0)),
])  # fmt: skip
def test_distributions_are_those_of_scipy(law, method, shapes):
    at = np.linspace(1e-9, 1.0, 99)[:-1] if method in ("ppf", "isf") else np.array([-2.0, 0.0, 1e-12, 0.3, 5.0, 700.0])
    own, theirs = (getattr(getattr(module, law), method)(at, *shapes) for module in (distributions, stats))
    np.testing.assert_array_equal(own, theirs)


def test_a_verdict_names_the_effects_of_its_model_and_none_that_was_exchanged():
    """Wall and dashpot came in for the viscoelastic wall, which was added first."""
    found = make_discovery()
    first, second, *_ = found.steps
    doubt = {"heldout_difference": 1e-4, "standard_error": 3e-4}
    steps = (first, dc.replace(second, added="viscoelastic-wall", effects=("viscoelastic-wall",), alternatives=()),
             dc.replace(second, added="wall-stiffness", effects=("wall-stiffness", "viscous-dashpot"),
                        alternatives=({"effect": "membrane-area", **doubt}, {"effect": "viscous-dashpot", **doubt})))
    exchanged = dc.replace(found, steps=steps, effects=steps[-1].effects)
    assert list_choices(exchanged) == [("wall-stiffness", ["membrane-area"]), ("viscous-dashpot", [])]
