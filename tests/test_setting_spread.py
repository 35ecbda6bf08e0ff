"""How far settings scatter beyond what is stated, and whether they follow the conditions."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import optimize, stats

from ddetumble.inference import variance_components
from ddetumble.inference.problem import Solution
from ddetumble.inference.variance_components import SpreadSettings, estimate_spread, follow_conditions, list_settings


ROWS, NAMES = 30, ("speed", "pressure", "time")


class Linear:
    """Records y_r = S_r theta + J_r f z_r + e, and the fit of them under z_r ~ N(0, 1)."""

    def __init__(self, seed, ratios=(1.0, 1.0, 1.0), records=12, shared=2, weight=0.0, rows=ROWS):
        generator = np.random.default_rng([41, seed])
        self.shared = generator.standard_normal((records, rows, shared))
        self.own = generator.standard_normal((records, rows, len(NAMES)))
        z = generator.standard_normal((records, len(NAMES))) * ratios
        self.error = generator.standard_normal((records, rows)) - np.einsum("rgk,rk->rg", self.own, z)
        self.weight = np.full(shared, weight)

    def solve(self, ratios=(1.0, 1.0, 1.0)):
        """The fit where the settings may scatter so many times as much, as the package has it."""
        records, rows, count = self.shared.shape
        own, side = self.own * np.array(ratios), records * len(NAMES)
        wide = np.zeros((records, rows, count + side))
        wide[..., :count] = self.shared
        for r in range(records):
            wide[r, :, count + r * len(NAMES): count + (r + 1) * len(NAMES)] = own[r]
        prior = np.diag(np.concatenate([self.weight, np.ones(side)]))
        matrix = np.concatenate([wide.reshape(-1, count + side), prior])
        right = np.concatenate([self.error.ravel(), np.zeros(count + side)])
        x = np.linalg.lstsq(matrix, -right, rcond=None)[0]
        left = (right + matrix @ x)[: records * rows].reshape(records, rows)
        empty = np.zeros((records, 1, rows))
        return Solution(tuple(f"p{k}" for k in range(count)), x[:count], x[count:].reshape(records, -1),
                        np.ones(count), left, self.shared, own, empty, empty[:, 0], empty[:, 0], np.zeros(records),
                        x[:count] * self.weight, self.weight, 0.0, True, 1, ())

    @property
    def records(self):
        """Names and stated deviations, as far as they are asked for."""
        count = len(self.shared)
        return SimpleNamespace(count=count, nuisances=NAMES, starts=(),
                               stack=SimpleNamespace(condition_sd=np.ones((count, len(NAMES)))))


def test_which_settings_state_an_uncertainty():
    """Not what a record starts from, nor baselines that move, nor what has no deviation."""
    names = ("w0", "speed", "pressure", "zero:force", "drift:force", "time")
    deviations = np.tile([1.0, 0.1, 0.0, 1.0, 1.0, 1e-3], (3, 1))
    deviations[2] = 7.0  # a row that pads the stack
    records = SimpleNamespace(count=2, nuisances=names, starts=("w0",),
                              stack=SimpleNamespace(condition_sd=deviations))
    assert [names[k] for k in list_settings(records)] == ["speed", "time"]


def test_a_scatter_of_four_times_is_found():
    """Of 20 campaigns of twelve records: all find that of the speed and that of no other; the logarithms of the ratios
    scatter as variances of twelve draws do, about the truth drawn a little to 1 by their prior."""
    found = [estimate_spread(one.records, one.solve()) for one in (Linear(k, (4.0, 1.0, 1.0)) for k in range(20))]
    assert all(set(one) == {"speed"} for one in found)
    logarithms, error = np.log([one["speed"] for one in found]), 1.0 / np.sqrt(2 * 12)
    assert np.mean(logarithms) == pytest.approx(np.log(4.0), abs=4.0 * error / np.sqrt(20) + error**2 * np.log(4.0))
    assert 0.5 * error < np.std(logarithms) < 1.6 * error


def test_settings_as_stated_are_left_alone():
    """Of 100 campaigns at most 2 let a setting scatter more: a likelihood e⁶ times as large is 3 in 10,000 for each."""
    assert sum(bool(estimate_spread(one.records, one.solve())) for one in map(Linear, range(100))) <= 2


@pytest.mark.parametrize("ratio", [3.0, 5.0])
def test_a_known_scatter_is_counted_from_what_is_stated(ratio):
    """A fit that allows for some of it gives the same ratios as one that does not."""
    linear = Linear(3, (4.0, 1.0, 3.0))
    plain = estimate_spread(linear.records, linear.solve())
    again = estimate_spread(linear.records, linear.solve((ratio, 1.0, 1.0)), {"speed": ratio})
    assert plain.keys() == {"speed", "time"} and again == pytest.approx(plain, rel=1e-3)


def test_a_linear_fit_may_be_anywhere():
    """What is estimated does not hang on where the parameters and settings were when it was linearised."""
    linear = Linear(4, (4.0, 1.0, 1.0))
    there = linear.solve()
    off = there.shared @ np.array([0.7, -2.0]) + there.own @ np.array([0.1, 0.5, -1.0])
    moved = SimpleNamespace(shared=there.shared, own=there.own, residual=there.residual + off,
                            z=there.z + [0.1, 0.5, -1.0], prior_weight=there.prior_weight,
                            prior_residual=there.prior_residual)
    assert estimate_spread(linear.records, moved) == pytest.approx(estimate_spread(linear.records, there), rel=1e-3)


def test_few_records_and_settings_without_uncertainty_say_nothing():
    few = Linear(5, (20.0, 1.0, 1.0), records=5)
    assert estimate_spread(few.records, few.solve()) == {}
    exact = Linear(5, (20.0, 1.0, 1.0))
    records = exact.records
    records.stack.condition_sd[:] = 0.0
    assert estimate_spread(records, exact.solve()) == {}


@pytest.mark.parametrize("weight", [0.0, 2.0])
def test_restricted_likelihood_is_that_of_the_dense_normal_density(monkeypatch, weight):
    """log|V| + log|S'V⁻¹S| + r'Pr of all rows at once, the prior of the parameters as rows of it, and that of the
    logarithms of the ratios."""
    linear, known, seen = Linear(6, (2.0, 1.0, 1.0), records=6, weight=weight, rows=7), {"pressure": 1.7}, []

    def minimise(function, start, **options):
        seen.append(function)
        return optimize.minimize(function, start, **options)

    monkeypatch.setattr(variance_components, "optimize", SimpleNamespace(minimize=minimise))
    solution = linear.solve((1.0, 1.7, 1.0))
    estimate_spread(linear.records, solution, known, SpreadSettings(prior=0.8))
    records, rows, count = linear.shared.shape
    free = np.concatenate([linear.shared.reshape(-1, count), np.diag(linear.weight)])
    # Residuals as they are without settings, and with the parameters where the fit left them.
    right = linear.error + linear.shared @ solution.u
    right = np.concatenate([right.ravel(), solution.prior_residual])
    for logarithms in (np.zeros(3), np.log([2.0, 1.5, 3.0]), np.array([0.1, 3.0, 0.0])):
        covariance = np.eye(len(right))
        for r in range(records):
            own = linear.own[r] * np.exp(logarithms)
            covariance[r * rows: (r + 1) * rows, r * rows: (r + 1) * rows] += own @ own.T
        inverse = np.linalg.inv(covariance)
        square = free.T @ inverse @ free
        projector = inverse - inverse @ free @ np.linalg.solve(square, free.T @ inverse)
        expected = (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(square)[1] + right @ projector @ right
                    - solution.prior_residual @ solution.prior_residual + np.sum((logarithms / 0.8) ** 2))
        assert seen[0](logarithms) == pytest.approx(expected, rel=1e-8)


GRID = np.array([(v, p) for v in (1.0, 1.5, 2.0, 3.0) for p in (1e5, 2e5)])
REPEATED, ALONE = np.repeat(np.arange(8), 2), np.arange(8)


@pytest.mark.parametrize(("groups", "conditions"), [(REPEATED, np.repeat(GRID, 2, axis=0)), (ALONE, GRID)])
def test_random_shifts_follow_no_condition(groups, conditions):
    """p-values are no smaller than chance has them, whatever the size of the shifts, with repeats and without."""
    generator = np.random.default_rng(7)
    draws = 10.0 ** generator.uniform(-2.0, 2.0, (500, 1)) * generator.standard_normal((500, len(groups)))
    found = np.array([follow_conditions(shifts, groups, conditions) for shifts in draws])
    for level in (0.01, 0.05, 0.2):
        assert np.sum(found < level) <= stats.binom.isf(1e-3, len(found), level)
    assert np.mean(found < 0.2) > 0.05  # the smallest of several counts as often: not many times too large


@pytest.mark.parametrize(("groups", "conditions"), [(REPEATED, np.repeat(GRID, 2, axis=0)), (ALONE, GRID)])
@pytest.mark.parametrize("force", [lambda v, p: 5.0 + 0.0 * v, lambda v, p: 6.0 * np.log(v),
                                   lambda v, p: 10.0 * np.log(p / 1.4e5),
                                   lambda v, p: 12.0 * np.sin(9.0 * v)])
def test_shifts_of_physics_follow_the_conditions(groups, conditions, force):
    """Alike in all records, with a setting, or up and down with one as two effects at once go: of 50 draws all are
    beyond 1 in 20, most beyond 1 in 200."""
    generator = np.random.default_rng(8)
    found = [follow_conditions(force(*conditions.T) + generator.standard_normal(len(groups)), groups, conditions)
             for _ in range(50)]
    assert max(found) < 0.05 and np.median(found) < 5e-3


def test_repeats_tell_what_no_plane_does():
    """Shifts of every condition's own, alike in its repeats."""
    generator = np.random.default_rng(9)
    found = [follow_conditions(5.0 * generator.standard_normal(8)[REPEATED] + generator.standard_normal(16), REPEATED,
                               np.repeat(GRID, 2, axis=0)) for _ in range(50)]
    assert max(found) < 0.01


def test_too_few_records_tell_nothing():
    """Fewer than five records at conditions of their own are taken as following them."""
    for count in (1, 3, 4):
        shifts = np.random.default_rng(count).standard_normal(count)
        assert follow_conditions(shifts, np.arange(count), GRID[:count]) == 0.0
    assert follow_conditions(np.array([1.0, -2.0, 1.0, 2.0, -1.5]), np.arange(5), np.ones((5, 1))) > 0.0
