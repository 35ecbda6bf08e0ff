"""Looking after every record: increments by a dense refit, false alarms of many sessions, and power."""

import numpy as np
import pytest
from helpers_statistics import PRESSURES, SPEEDS, fit_toy, make_selection
from scipy import stats

from ddetumble.selection.sequential import accumulate, follow_records, list_parts, weigh_increments


RECORDS, ROWS, FREE = 20, 12, 3
NONE = np.zeros((0, FREE)), np.zeros(0)


def draw_session(generator, misfit=0.0):
    """Records of a linear model with unit noise; `misfit` is added to one smooth row of every record."""
    theta = generator.standard_normal(FREE)
    parts = []
    for _ in range(RECORDS):
        columns = generator.standard_normal((ROWS, FREE))
        right = columns @ theta + generator.standard_normal(ROWS)
        right[0] += misfit
        parts.append((columns, right))
    return parts


def test_increments_are_those_of_dense_refits():
    """Of the least sum of squares of all records up to each, by `lstsq`; the first record pays for the parameters."""
    parts = draw_session(np.random.default_rng(1))
    found, before = weigh_increments(parts, *NONE), 0.0
    for k in range(RECORDS):
        columns, right = (np.concatenate(x) for x in zip(*parts[: k + 1], strict=True))
        left = float(np.sum((right - columns @ np.linalg.lstsq(columns, right, rcond=None)[0]) ** 2))
        freedom = ROWS - (FREE if k == 0 else 0)
        assert found[k] == pytest.approx(stats.chi2.sf(left - before, freedom), rel=1e-6)
        before = left


def test_a_parameter_that_comes_into_sight_late_is_no_misfit():
    """One column is empty in the first ten records: the eleventh pays a degree of freedom for it."""
    parts = [(columns * np.array([1.0, 1.0, float(k >= 10)]), right) for k, (columns, right) in enumerate(
        draw_session(np.random.default_rng(2)))]
    moved = [(columns, right + 100.0 * columns[:, 2]) for columns, right in parts]
    assert weigh_increments(moved, *NONE) == pytest.approx(weigh_increments(parts, *NONE), rel=1e-6)


def test_of_a_thousand_null_sessions_few_ever_alarm():
    """Looked at after every record: at most one in twenty passes 20 at any time (Ville)."""
    generator = np.random.default_rng(3)
    alarms = sum(accumulate(weigh_increments(draw_session(generator), *NONE)).max() >= 20.0 for _ in range(1000))
    assert alarms <= 50


def test_evidence_has_a_mean_of_one():
    """Over uniform p-values, within four standard errors of 20,000 draws, after one record and after three."""
    p = np.random.default_rng(4).random((20_000, 3))
    found = np.array([accumulate(one) for one in p])
    for k in (0, 2):
        error = found[:, k].std() / np.sqrt(len(p))
        assert abs(found[:, k].mean() - 1.0) < max(4.0 * error, 0.1)


def test_a_misfit_alarms_before_long():
    """Of two deviations in one of twelve rows: nine sessions in ten alarm, and half of them after half the records."""
    generator = np.random.default_rng(5)
    sessions = [accumulate(weigh_increments(draw_session(generator, 3.0), *NONE)) for _ in range(100)]
    assert sum(one.max() >= 20.0 for one in sessions) >= 90
    assert sum(one[: RECORDS // 2].max() >= 20.0 for one in sessions) >= 50


def test_of_a_fit():
    """A complete model raises no alarm, one that lacks a ripple does; noise that may be louder is no evidence."""
    conditions = [(v, p) for v in SPEEDS for p in PRESSURES] * 2
    for truth, low, high in (({}, 0.0, 20.0), ({"ripple.a": 0.3}, 1e6, np.inf)):
        selection, fitted = fit_toy(make_selection(6, truth, conditions=conditions))
        found = follow_records(selection.problem, fitted.solution, selection.bases, selection.noise)
        assert low <= found.e_values[-1] < high and (found.find_alarm() is None) == (not truth)
        assert found.records == selection.records.keys and len(found.p_values) == len(conditions)


def test_parts_of_a_record_are_smooth_projections():
    """Their lengths and products are those of dense projections, without what the settings can do."""
    selection, fitted = fit_toy(make_selection(7, conditions=[(v, p) for v in SPEEDS for p in PRESSURES]))
    solution, own = fitted.solution, fitted.solution.own.shape[2]
    for r, (columns, right) in enumerate(list_parts(solution, selection.bases)):
        settings = np.linalg.qr(np.concatenate([solution.own[r], np.eye(own)]))[0]
        rows = np.concatenate([selection.bases[r].toarray(), np.zeros((own, selection.bases[r].shape[1]))])
        shared = np.concatenate([solution.shared[r], np.zeros((own, solution.shared.shape[2]))])
        both = np.concatenate([rows, shared], axis=1)
        u, s, _ = np.linalg.svd(both - settings @ (settings.T @ both), full_matrices=False)
        u = u[:, s > 1e-7 * s[0]]
        whole = u.T @ np.concatenate([shared, np.concatenate([solution.residual[r], solution.z[r]])[:, None]], axis=1)
        mine = np.concatenate([columns, right[:, None]], axis=1)
        assert mine.shape == whole.shape
        assert mine.T @ mine == pytest.approx(whole.T @ whole, rel=1e-6, abs=1e-6 * np.abs(whole).max() ** 2)
