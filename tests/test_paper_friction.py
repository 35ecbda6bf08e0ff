"""The paper's friction beside the toolkit: numbers against ones found by hand or by plain NumPy and SciPy."""

import itertools
import json

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq, nnls

import ddetumble as dd
from ddetumble.measurement.campaign import Campaign, Column
from ddetumble.measurement.units import Uncertainty, si_unit
from ddetumble.paper.contradictions import err_scaled, list_friction_points
from ddetumble.paper.friction import (
    CONSTANT,
    RELEASED,
    SCALED,
    compare_band,
    find_band,
    find_ratio,
    find_scale,
    judge_friction,
    release_tangent,
)
from ddetumble.paper.rivals import compare_rows


LOAD = np.array([39.8, 41.3, 42.1, 44.8, 48.2, 50.3, 53.5, 57.9, 62.6, 66.2, 70.8])
PRESSURE = np.linspace(0.0, 2.5e6, 11)
MEASURED = np.array([9.18, 9.2, 9.25, 9.58, 10.7, 11.1, 11.4, 12.1, 13.1, 14.3, 15.5])
CORRECTED = np.array([8.91, 9.18, 9.42, 9.67, 9.97, 10.4, 10.8, 11.6, 12.6, 13.8, 15.2])
PRINTED_ERROR = np.array([2.9, 0.2, 1.8, 0.1, 6.9, 6.3, 5.2, 4.1, 3.8, 3.4, 3.1])
HYSTERESIS = np.pi / 10 * (3 * PRESSURE / (7.8e6 / (1 - 0.47**2))) ** (2 / 3)
TABLE = {"load": LOAD, "pressure": PRESSURE, "measured": MEASURED, "printed": CORRECTED,
         "printed_error": PRINTED_ERROR}


def slip_term(s, load, e=None):
    """Eqs. 9 and 10 once more, s in mm."""
    a = 0.74769 - 0.01684 * load
    b = -0.13056 - 0.01728 * load + 5.35714e-4 * load**2
    c = -1.04239 + 0.00583 * load - 4.07238e-4 * load**2
    d = 0.010619 + 0.01829 * load - 7.75e-4 * load**2
    e = 2.69364 - 0.05815 * load + 0.00712e-4 * load**2 if e is None else e
    return a + a * np.exp(b * s) * (c * np.sinh(d * s) - e * np.cosh(d * s))


@pytest.fixture(scope="module")
def judged():
    return judge_friction()


@pytest.fixture(scope="module")
def points():
    return {point.row: point for point in list_friction_points(TABLE)}


def leave_out(columns):
    """Errors of relative least squares with each row left out, by plain refits."""
    errors = np.empty(len(MEASURED))
    for k in range(len(MEASURED)):
        rest = np.arange(len(MEASURED)) != k
        beta = np.linalg.lstsq(columns[rest] / MEASURED[rest, None], np.ones(rest.sum()), rcond=None)[0]
        errors[k] = columns[k] @ beta / MEASURED[k] - 1
    return errors


def find_size(values):
    return np.sqrt(np.mean(np.square(values)))


def test_friction_over_load(judged):
    ratio = MEASURED / LOAD
    assert find_ratio(judged) == pytest.approx((ratio.mean(), ratio.std(ddof=1)), rel=1e-12)
    assert find_ratio(judged) == pytest.approx((0.218, 0.006), abs=5e-4)
    np.testing.assert_array_equal(judged.x, LOAD)


def test_constant_left_out_in_closed_form(judged):
    # Relative least squares: the coefficient is sum(x) / sum(x^2) with x = load over measured friction.
    x = LOAD / MEASURED
    c = (x.sum() - x) / (np.sum(x**2) - x**2)
    row = judged.find(CONSTANT)
    np.testing.assert_allclose(row.out, np.abs(c * LOAD - MEASURED) / find_size(MEASURED), atol=2e-3)
    assert row.heldout == pytest.approx(find_size(c * LOAD - MEASURED) / find_size(MEASURED), rel=0.01)
    found = judged.compared[1].parameters["friction_coefficient"]
    assert found.estimate == pytest.approx(x.sum() / np.sum(x**2), rel=1e-3)


def test_linear_rivals_left_out(judged):
    cases = {"printed theory × one factor": CORRECTED[:, None], RELEASED: np.c_[LOAD, LOAD * HYSTERESIS],
             SCALED: (LOAD * (np.pi / 4 * 0.4 + HYSTERESIS))[:, None],
             "straight line in load": np.vander(LOAD, 2), "parabola in load": np.vander(LOAD, 3)}
    for label, columns in cases.items():
        error = find_size(leave_out(columns) * MEASURED) / find_size(MEASURED)
        assert judged.find(label).heldout == pytest.approx(error, rel=1e-6)
    row = judged.rows[0]
    assert row.free == 0 and np.max(np.abs(row.fitted / MEASURED - 1.0)) == pytest.approx(0.0682, abs=5e-5)


def test_loss_factor_of_either_sign(judged):
    weights = np.c_[LOAD, LOAD * HYSTERESIS] / MEASURED[:, None]
    assert nnls(weights, np.ones(11))[0][1] == 0
    free = np.linalg.lstsq(weights, np.ones(11), rcond=None)[0]
    tangent, error = release_tangent(judged)
    assert tangent == pytest.approx(free[1], rel=1e-9) and free[1] < 0
    left = weights @ free - 1.0
    assert error == pytest.approx(np.sqrt(left @ left / 9 * np.linalg.inv(weights.T @ weights)[1, 1]), rel=1e-6)


def test_nothing_beats_a_constant(judged):
    plain = judged.find(CONSTANT)
    for row in judged.rows:
        gap = compare_rows(row, plain)
        assert gap.mean == pytest.approx(np.mean(row.out - plain.out), abs=1e-12)
        assert gap.mean > -2 * gap.error or row is plain
    assert judged.found.verdict == "undecided" and judged.found.effects == ()
    json.dumps(judged.to_dict(), allow_nan=False)
    assert len(judged.tabulate(plain)) == len(judged.rows)


def test_range_of_equation_10(points):
    values = points[6].values
    assert values["sign_load"] == pytest.approx(0.74769 / 0.01684, rel=1e-9)

    def rate(load):
        return -0.13056 - 0.01728 * load + 5.35714e-4 * load**2 + abs(0.010619 + 0.01829 * load - 7.75e-4 * load**2)

    assert values["diverges_load"] == pytest.approx(brentq(rate, 27, 40), rel=1e-9)
    assert values["diverges_load"] == pytest.approx(30.65, abs=0.005)
    assert values["diverging"] == 11 and values["negative"] == np.sum(LOAD > values["sign_load"]) == 8
    assert values["term_low"] == pytest.approx(slip_term(1.0, LOAD, 1.0).min(), rel=1e-9)
    assert values["term_high"] == pytest.approx(slip_term(1.0, LOAD, 1.0).max(), rel=1e-9)


def test_no_slip_makes_the_corrected_column(points):
    weights = np.c_[LOAD, LOAD * HYSTERESIS] / CORRECTED[:, None]
    slips = np.r_[0, np.geomspace(1e-4, 5, 400)]
    errors = [nnls(weights, 1 - slip_term(s, LOAD, 1.0) * LOAD / CORRECTED)[1] / np.sqrt(11) for s in slips]
    values = points[6].values
    assert slips[np.argmin(errors)] < 0.005 and 1e3 * values["best_slip"] < 0.005
    assert values["best_error"] == pytest.approx(min(errors), rel=1e-3)
    given = [nnls(weights, 1 - slip_term(s, LOAD) * LOAD / CORRECTED)[1] / np.sqrt(11) for s in slips]
    assert values["best_error_printed"] == pytest.approx(min(given), rel=1e-3) and min(given) > 0.9


def test_friction_without_slip(points):
    values = points[5].values
    rest = brentq(lambda load: slip_term(0.0, load), 20, 35)
    assert values["rest_load"] == pytest.approx(rest, rel=1e-9) and rest == pytest.approx(29, abs=0.2)
    assert values["no_load"] == pytest.approx(-1.27, abs=0.005)
    assert brentq(lambda load: slip_term(0.0, load), 40, 50) == pytest.approx(values["sign_load"], rel=1e-9)
    slopes = [slip_term(1e-6, load, 1.0) / 1e-6 for load in np.linspace(0, rest, 200)]
    assert values["slope_low"] == pytest.approx(min(slopes), rel=1e-3)
    assert values["slope_high"] == pytest.approx(max(slopes), rel=1e-3)
    assert (values["slope_low"], values["slope_high"]) == pytest.approx((0.076, 0.089), abs=5e-4)


def test_errors_of_table_4(points):
    error = 100 * np.abs(MEASURED - CORRECTED) / MEASURED
    values = points[13].values
    assert (values["fourth_percent"], values["eleventh_percent"]) == pytest.approx((error[3], error[10]))
    assert (values["fourth_percent"], values["eleventh_percent"]) == pytest.approx((0.9, 1.9), abs=0.05)
    assert values["others_points"] < 0.11


def test_band(judged):
    inside = find_band(PRESSURE)
    assert list(inside) == [6, 7]
    row = judged.find(CONSTANT)
    error = row.out
    found = compare_band(row, inside)
    pairs = [error[list(pair)].sum() for pair in itertools.combinations(range(11), 2)]
    assert len(pairs) == 55
    assert found["p_value"] == pytest.approx(np.mean(np.array(pairs) >= error[6] + error[7] - 1e-12))
    assert found["p_adjacent"] == pytest.approx(np.mean(error[:-1] + error[1:] >= error[6] + error[7] - 1e-12))
    assert found["p_value"] > 0.1
    bends = np.diff(MEASURED, 2)
    assert set(np.argsort(-np.abs(bends))[:2] + 1) == {3, 4}  # 0.75 and 1 MPa


def test_stated_error_of_equation_8(judged):
    at = find_scale(judged)
    x = LOAD * (np.pi / 4 * at + HYSTERESIS) / MEASURED
    assert np.max(np.abs(x * x.sum() / np.sum(x**2) - 1)) == pytest.approx(0.226, abs=1e-6)
    constant = np.max(np.abs(judged.find(CONSTANT).fitted / MEASURED - 1))
    assert err_scaled(LOAD, PRESSURE, MEASURED, np.inf) == pytest.approx(constant, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [0.0, 1 / 3])
def test_forces_that_are_made(exponent):
    """Forces of a known law with a stated deviation: nothing is missing, or the effect that made them is found."""
    load = np.linspace(5.0, 30.0, 12)
    noise = np.array([0.3, -1.1, 0.6, 0.2, 1.2, -0.7, -0.9, 0.2, 0.5, -0.4, 0.8, -0.6])
    force = 0.25 * load * (load / 10) ** -exponent * (1 + 0.01 * noise)
    index = pd.Index([f"r{k:02d}" for k in range(12)], name="record", dtype=object)
    name, conditions = "peak_friction_force", {"normal_load": load, "internal_pressure": np.full(12, 1e6)}
    campaign = Campaign(
        name="values", title="Values", family="slip", path=None, known={"friction_coefficient": None},
        records=pd.DataFrame(conditions, index=index), peaks=pd.DataFrame({name: force}, index=index),
        conditions={one: Column(one, si_unit(one)) for one in conditions},
        peak_columns={name: Column(name, "N", Uncertainty(relative=0.01))})
    found = dd.discover(campaign, "coulomb")
    if exponent:
        assert found.verdict == "explained" and found.effects == ("load-exponent",)
        assert found.steps[-1].parameters["load-exponent.m"].estimate == pytest.approx(1 / 3, abs=0.02)
    else:
        assert not found.effects and not found.steps[0].lack_of_fit.rejected
        assert found.steps[0].parameters["friction_coefficient"].estimate == pytest.approx(0.25, rel=0.01)
