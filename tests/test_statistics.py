"""What decides a verdict, each against theory: linear models, where refits are exact, and draws under the null."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import sparse, stats
from scipy.interpolate import BSpline

from ddetumble.inference.goodness import combine_p_values, judge_goodness, weigh_shifts
from ddetumble.inference.noise import Noise
from ddetumble.inference.problem import Solution
from ddetumble.selection.cross_validation import (
    compare_losses,
    leave_out,
    predict_left_out,
)
from ddetumble.selection.forward_selection import fits_better, helps
from ddetumble.selection.lack_of_fit import (
    Score,
    bootstrap_p_value,
    family_p_value,
    measure_smooth,
    score_directions,
)
from ddetumble.selection.problem import Fitted
from ddetumble.selection.settings import SelectionSettings


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
        return SimpleNamespace(channels=np.zeros((RECORDS, 1, ROWS)), failed=())

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


def predict_linear(linear, adjust):
    """What is predicted of linear records, and the parameters and nuisances that it is predicted with."""
    seen = {}

    def solve(names, u, z, moving):
        seen.update(u=u, z=z)
        return SimpleNamespace(channels=np.zeros((RECORDS, 1, ROWS)), failed=())

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


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_covariance_is_the_inverse_of_the_normal_equations(weight):
    linear = Linear(4, weight=weight)
    assert linear.solve().covariance() == pytest.approx(linear.fit()[3], rel=1e-9)


def score(linear, columns):
    """Scores of directions with the given columns, shape (directions, records, rows)."""
    solution, names = linear.solve(), [f"e{k}" for k in range(len(columns))]
    wide = np.concatenate([columns, np.zeros((*columns.shape[:2], OWN))], axis=2)
    problem = SimpleNamespace(
        space=SimpleNamespace(index={n: k for k, n in enumerate((*NAMES, *names))}),
        scales=np.ones(SHARED + len(names)),
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


def test_a_direction_that_parameters_imitate_scores_nothing():
    linear = Linear(7)
    columns = np.stack([linear.jacobian[..., 0] - 2.0 * linear.jacobian[..., 1], np.zeros((RECORDS, ROWS))])
    assert all(one.z == 0.0 and one.step == 0.0 and one.information == 0.0 for one in score(linear, columns))


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


@pytest.mark.parametrize("free_running", [False, True])
def test_smooth_misfit_is_chi_square(free_running):
    """Of complete linear models: as many degrees of freedom as splines, less parameters, and uniform p-values."""
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, 9), [1.0] * 3])
    basis = sparse.csr_matrix(BSpline.design_matrix(np.linspace(0.0, 1.0, ROWS), knots, 3))
    problem = SimpleNamespace(space=SimpleNamespace(family=SimpleNamespace(free_running=free_running)))
    p_values = []
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
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, 9), [1.0] * 3])
    x = np.linspace(0.0, 1.0, ROWS)
    basis = sparse.csr_matrix(BSpline.design_matrix(x, knots, 3))
    problem = SimpleNamespace(space=SimpleNamespace(family=SimpleNamespace(free_running=free_running)))
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
    assert not helps(selection, before, fitted([90.0] * 4, forecast=[110.0, 111.0, 109.0, 110.0]))
    assert not helps(selection, before, before)


def test_when_another_fits_far_better():
    """By 50 noise variances, and by a quarter of what the best removes, parameters counted."""
    before, best = fitted([0.0], chi2=1000.0), fitted([0.0], chi2=600.0)
    assert not fits_better(fitted([0.0], chi2=505.0), best, before)
    assert fits_better(fitted([0.0], chi2=495.0), best, before)
    assert not fits_better(fitted([0.0], chi2=495.0, names=("a", "b")), best, before)
    near, low = fitted([0.0], chi2=960.0), fitted([0.0], chi2=915.0)
    assert not fits_better(low, near, before) and fits_better(fitted([0.0], chi2=905.0), near, before)


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
