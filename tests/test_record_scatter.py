"""Intervals by the scatter of records: the closed form of a mean, no bias under the null, coverage on rough benches."""

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.exam import Exam
from ddetumble.exam.cases import sample_case, write_case
from ddetumble.inference.problem import Solution
from ddetumble.inference.record_scatter import measure_scatter


RECORDS, ROWS = 9, 30
EDITIONS = {"impact": 3}  # of the exam: a later one draws other campaigns from the same seed


def solve(columns, error, own, weight=None):
    """The least squares of linear records, with standard normal priors of the nuisances."""
    records, rows, free = columns.shape
    weight, count = np.zeros(free) if weight is None else weight, own.shape[2]
    blocks = np.zeros((records, rows, records, count))
    blocks[np.arange(records), :, np.arange(records)] = own
    matrix = np.block([[columns.reshape(-1, free), blocks.reshape(records * rows, records * count)],
                       [np.zeros((records * count, free)), np.eye(records * count)],
                       [np.diag(weight), np.zeros((free, records * count))]])
    side = np.concatenate([error.ravel(), np.zeros(records * count + free)])
    x = np.linalg.lstsq(matrix, -side, rcond=None)[0]
    theta, z = x[:free], x[free:].reshape(records, count)
    residual = error + columns @ theta + np.einsum("rgk,rk->rg", own, z)
    empty = np.zeros((records, 1, rows))
    return Solution(tuple(f"p{k}" for k in range(free)), theta, z, np.ones(free), residual, columns, own, empty,
                    empty[:, 0], empty[:, 0], np.zeros(records), theta * weight, weight,
                    float(np.sum((side + matrix @ x) ** 2)), True, 1, ())


def test_a_mean_has_the_scatter_of_the_means_of_records():
    """Whatever the noise within records is: s^2/R of the R means, over the 1/(R n) of unit noise."""
    generator = np.random.default_rng(1)
    error = generator.standard_normal((RECORDS, ROWS)) + 3.0 * generator.standard_normal((RECORDS, 1))
    found = measure_scatter(solve(np.ones((RECORDS, ROWS, 1)), error, np.zeros((RECORDS, ROWS, 0))))
    expected = error.mean(axis=1).var(ddof=1) / RECORDS * (RECORDS * ROWS)
    assert found == pytest.approx([expected], rel=1e-9)


def test_under_the_noise_of_the_fit_it_is_that_of_the_fit():
    """Without bias, with nuisances and records that tell differently much: the mean over draws is one."""
    generator = np.random.default_rng(2)
    columns = generator.standard_normal((RECORDS, ROWS, 3)) * np.linspace(0.3, 1.5, RECORDS)[:, None, None]
    own = generator.standard_normal((RECORDS, ROWS, 2))
    found = []
    for _ in range(1500):
        error = generator.standard_normal((RECORDS, ROWS)) - np.einsum(
            "rgk,rk->rg", own, generator.standard_normal((RECORDS, 2)))
        found.append(measure_scatter(solve(columns, error, own)))
    found = np.array(found)
    assert np.all(np.abs(found.mean(axis=0) - 1.0) < 4.0 * found.std(axis=0) / np.sqrt(len(found)))


def test_units_of_parameters_do_not_matter():
    generator = np.random.default_rng(3)
    columns, error = generator.standard_normal((RECORDS, ROWS, 3)), generator.standard_normal((RECORDS, ROWS))
    own, units = generator.standard_normal((RECORDS, ROWS, 2)), np.array([1e-6, 1.0, 1e5])
    assert measure_scatter(solve(columns * units, error, own)) == pytest.approx(
        measure_scatter(solve(columns, error, own)), rel=1e-6)


def test_what_a_prior_determines_has_the_deviation_of_the_prior():
    generator = np.random.default_rng(4)
    columns = generator.standard_normal((RECORDS, ROWS, 2))
    error = 5.0 * generator.standard_normal((RECORDS, ROWS))
    found = measure_scatter(solve(columns, error, np.zeros((RECORDS, ROWS, 0)), np.array([1e4, 0.0])))
    assert found[0] == pytest.approx(1.0, abs=1e-3) and found[1] > 5.0


def list_fits(tmp_path, family, bench, count, seed):
    """Fits to campaigns in which nothing is missing, and what their parameters were."""
    exam = Exam(family, seed, ("nothing",), bench=bench, fault="none", edition=EDITIONS.get(family, 0))
    for k in range(count):
        case = sample_case(exam, k)
        write_case(exam, case, tmp_path / f"{family}-{k}")
        yield dd.fit(tmp_path / f"{family}-{k}"), case.setting["base"]


@pytest.mark.study
def test_intervals_hold_the_truth_where_a_gauge_is_coarse(tmp_path):
    """Intervals of the noise, which does not know all that rounding adds, hold the truth in less than nine of ten."""
    held, narrow, widened = [], [], 0
    for fit, truth in list_fits(tmp_path, "impact", "coarse", 40, 921):
        widened += bool(fit.widened)
        for name, one in fit.parameters.items():
            sd = one.sd / fit.widened.get(name, 1.0)
            held.append(one.q025 <= truth[name] <= one.q975)
            narrow.append(abs(one.estimate - truth[name]) < 1.96 * sd)
    assert widened > 10 and np.mean(narrow) < 0.9 < np.mean(held) < 0.99


@pytest.mark.study
def test_ordinary_campaigns_keep_the_errors_of_their_noise(tmp_path):
    """Beyond chance one in a hundred is widened; the covariance is that of the least squares elsewhere."""
    fits = [fit for family in ("impact", "slip") for fit, _ in list_fits(tmp_path, family, "stated", 15, 7)]
    assert sum(bool(fit.widened) for fit in fits) <= 3
    for fit in fits:
        if not fit.widened:
            np.testing.assert_allclose(fit.covariance, fit.solution.covariance(), rtol=1e-6)


@pytest.mark.slow
def test_ends_by_refitting_are_those_of_the_wider_interval(tmp_path):
    """Where the valley is straight, profile likelihood and the interval agree, widened as well."""
    fit = next(fit for fit, _ in list_fits(tmp_path, "impact", "coarse", 40, 921)
               if fit.widened and max(fit.widened.values()) > 1.3)
    name = max(fit.widened, key=lambda one: fit.widened[one])
    low, high = fit.interval(name)
    assert fit.profile(name) == pytest.approx((low, high), abs=0.05 * (high - low))
    assert fit.bends[name] == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("bench", "seed"), [("loose-settings", 454), ("coarse", 921)])
def test_a_discovery_and_its_fits_have_the_same_intervals(bench, seed, tmp_path):
    """To the last digit; where settings scatter by what the records tell, they have Student's t at least."""
    exam = Exam("impact", seed, ("nothing",), bench=bench, fault="none", edition=EDITIONS["impact"])
    write_case(exam, sample_case(exam, 1), tmp_path / "case")
    found = dd.discover(tmp_path / "case")
    assert bool(found.spread) == bool(found.best.widened) == (bench == "loose-settings")
    for name, one in found.steps[-1].parameters.items():
        other = found.best.parameters[name]
        assert (one.estimate, one.sd, one.q025, one.q975) == (other.estimate, other.sd, other.q025, other.q975)
