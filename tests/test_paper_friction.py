"""The paper's friction beside the toolkit: numbers against ones found by hand or by plain NumPy and SciPy."""

import dataclasses as dc
import itertools
import json

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar, nnls

from ddetumble import InputError, find_data
from ddetumble.contact.sliding import CoulombFriction
from ddetumble.measurement.package import read_campaign
from ddetumble.paper import judge_campaign, judge_friction
from ddetumble.paper.contradictions import err_scaled, list_friction_points
from ddetumble.paper.friction import RELEASED, SCALED
from ddetumble.paper.friction_page import compare_band, find_band, find_scale


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
    return judge_campaign(read_campaign(find_data() / "paper" / "table-4"))


@pytest.fixture(scope="module")
def points():
    return {point.number: point for point in list_friction_points(TABLE)}


def test_the_model_that_is_named_is_judged(judged):
    """A constant coefficient named as the model is the reference, and no slip term is spoken of."""
    campaign = read_campaign(find_data() / "paper" / "table-4")
    constant = judge_campaign(campaign, model="coulomb")
    assert constant.reference.heldout == pytest.approx(judged.constant.heldout, rel=1e-6)
    assert "misses" in constant.sentence and "Eq. 8" not in constant.sentence and not constant.separation
    assert any("'coulomb' is taken at zero slip" in note for note in constant.notes)
    assert any("Eq. 8 alone is judged" in note for note in judged.notes)
    with pytest.raises(InputError, match="for impact records, .* of the family 'slip'"):
        judge_campaign(campaign, model="matunaga")


def test_a_judgement_takes_options(judged):
    """Candidates, level and the reference model itself; a further condition of a stroke tells no repeats apart."""
    campaign = read_campaign(find_data() / "paper" / "table-4")
    extra = dc.replace(campaign, records=campaign.records.assign(sequence=np.arange(1.0, 12.0)), conditions={
        **campaign.conditions, "sequence": campaign.conditions["normal_load"]})
    found = judge_campaign(extra, reference=CoulombFriction(), effects=(), level=0.01, assumed=("normal_load",))
    assert found.level == 0.01 and not [row for row in found.rows if row.kind == "effect"]
    assert "sequence" not in found.forces.conditions and found.separation == ()
    assert any("The loads of these rows are assumed" in note for note in found.notes)
    assert {row.kind for row in judged.rows} >= {"effect"}


def find_row(judged, label):
    return next(row for row in judged.rows if row.label == label)


def leave_out(columns):
    """Errors of relative least squares with each row left out, by plain refits."""
    errors = np.empty(len(MEASURED))
    for k in range(len(MEASURED)):
        rest = np.arange(len(MEASURED)) != k
        beta = np.linalg.lstsq(columns[rest] / MEASURED[rest, None], np.ones(rest.sum()), rcond=None)[0]
        errors[k] = columns[k] @ beta / MEASURED[k] - 1
    return errors


def test_friction_over_load(judged):
    ratio = MEASURED / LOAD
    assert judged.ratio == pytest.approx((ratio.mean(), ratio.std(ddof=1)), rel=1e-12)
    assert judged.ratio[0] == pytest.approx(0.218, abs=5e-4) and judged.ratio[1] == pytest.approx(0.006, abs=5e-4)
    np.testing.assert_array_equal(judged.forces.x, LOAD)


def test_constant_left_out_in_closed_form(judged):
    # Relative least squares: the coefficient is sum(x) / sum(x^2) with x = load over measured friction.
    x = LOAD / MEASURED
    c = (x.sum() - x) / (np.sum(x**2) - x**2)
    row = find_row(judged, "constant coefficient")
    np.testing.assert_allclose(row.held, c * LOAD, rtol=1e-7)
    assert row.heldout == pytest.approx(np.sqrt(np.mean((c * x - 1) ** 2)), rel=1e-6)
    found = row.estimates["friction_coefficient"]
    assert found["estimate"] == pytest.approx(x.sum() / np.sum(x**2), rel=1e-7)
    left = x.sum() / np.sum(x**2) * x - 1
    assert found["sd"] == pytest.approx(np.sqrt(np.sum(left**2) / 10 / np.sum(x**2)), rel=1e-6)


def test_linear_rivals_left_out(judged):
    cases = {"printed column × one factor": CORRECTED[:, None], RELEASED: np.c_[LOAD, LOAD * HYSTERESIS],
             SCALED: (LOAD * (np.pi / 4 * 0.4 + HYSTERESIS))[:, None],
             "straight line in load": np.vander(LOAD, 2), "parabola in load": np.vander(LOAD, 3)}
    for label, columns in cases.items():
        assert find_row(judged, label).heldout == pytest.approx(np.sqrt(np.mean(leave_out(columns) ** 2)), rel=1e-6)
    row = find_row(judged, "printed column as it stands")
    assert row.free == 0 and row.worst == pytest.approx(0.0682, abs=5e-5)


def test_loss_factor_goes_to_zero(judged):
    weights = np.c_[LOAD * np.pi / 4 * 0.5, LOAD * HYSTERESIS] / MEASURED[:, None]
    best, _ = nnls(weights, np.ones(11))
    assert best[1] == 0
    assert judged.reference.estimates["adhesion"]["estimate"] == pytest.approx(best[0], rel=1e-4)
    assert "loss_factor" not in judged.reference.estimates and "tan δ" in judged.reference.remark
    free = np.linalg.lstsq(weights, np.ones(11), rcond=None)[0]
    released = find_row(judged, RELEASED)
    assert not released.physical
    assert released.estimates["loss_factor"]["estimate"] == pytest.approx(free[1], rel=1e-9) and free[1] < 0


def test_separation_of_the_two_constants(judged):
    adhesion = LOAD * np.pi / 4 * 0.5 * 0.8 * 0.15 / MEASURED
    columns = np.c_[adhesion, adhesion + 0.15 * LOAD * HYSTERESIS / MEASURED]  # by ln K, by ln tan(delta)
    covariance = np.linalg.inv(columns.T @ columns)
    expected = (*np.linalg.svd(columns)[1], covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    np.testing.assert_allclose(judged.separation, expected, rtol=1e-8)
    same = judge_friction({"normal_load": LOAD, "internal_pressure": np.full(11, 1e6)}, MEASURED)
    assert same.separation[1] < 1e-10 * same.separation[0]
    assert any("only their product" in note for note in same.notes)


def test_effects_on_forces(judged):
    """The adhesive offset is a straight line in load; the load exponent against a search over m."""
    line = find_row(judged, "straight line in load")
    offset = next(row for row in judged.rows if row.effects == ("adhesive-offset",))
    assert offset.heldout == pytest.approx(line.heldout, rel=1e-4)
    assert offset.estimates["adhesive-offset.f_a"]["estimate"] == pytest.approx(1.034, abs=0.002)

    def cost(m):
        x = LOAD * (LOAD / 10) ** -m / MEASURED
        return np.sum((x * x.sum() / np.sum(x**2) - 1) ** 2)

    best = minimize_scalar(cost, bounds=(-0.5, 0.5), method="bounded", options={"xatol": 1e-10}).x
    power = next(row for row in judged.rows if row.effects == ("load-exponent",))
    assert power.estimates["load-exponent.m"]["estimate"] == pytest.approx(best, abs=1e-4)
    assert set(judged.left_out) == {"stribeck", "viscous-friction", "presliding", "frictional-heating"}


def test_nothing_beats_a_constant(judged):
    plain = np.abs(find_row(judged, "constant coefficient").held / MEASURED - 1)
    for pair in judged.pairs:
        gap = np.abs(find_row(judged, pair.first).held / MEASURED - 1) - plain
        assert pair.difference == pytest.approx(gap.mean(), abs=1e-6)
        assert pair.difference > -2 * pair.standard_error or pair.standard_error < 1e-5
    assert "No model is better than the constant" in " ".join(judged.notes)
    assert judged.verdict == "unexplained" and judged.effects == ()
    json.dumps(judged.to_dict(), allow_nan=False)
    assert len(judged.table()) == len(judged.rows)
    assert any("assumed" in note for note in judged.notes)


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
    row = find_row(judged, "constant coefficient")
    error = np.abs(row.held / MEASURED - 1)
    found = compare_band(row, inside)
    pairs = [error[list(pair)].sum() for pair in itertools.combinations(range(11), 2)]
    assert len(pairs) == 55
    assert found["p_value"] == pytest.approx(np.mean(np.array(pairs) >= error[6] + error[7] - 1e-12))
    assert found["p_adjacent"] == pytest.approx(np.mean(error[:-1] + error[1:] >= error[6] + error[7] - 1e-12))
    assert found["p_value"] > 0.2
    bends = np.diff(MEASURED, 2)
    assert set(np.argsort(-np.abs(bends))[:2] + 1) == {3, 4}  # 0.75 and 1 MPa


def test_stated_error_of_equation_8(judged):
    at = find_scale(judged)
    x = LOAD * (np.pi / 4 * at + HYSTERESIS) / MEASURED
    assert np.max(np.abs(x * x.sum() / np.sum(x**2) - 1)) == pytest.approx(0.226, abs=1e-6)
    constant = np.max(np.abs(find_row(judged, "constant coefficient").fitted / MEASURED - 1))
    assert err_scaled(LOAD, PRESSURE, MEASURED, np.inf) == pytest.approx(constant, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [0.0, 1 / 3])
def test_forces_that_are_made(exponent):
    """Forces of a known law with a stated deviation: nothing is missing, or the effect that made them is found."""
    load = np.linspace(5.0, 30.0, 12)
    noise = np.array([0.3, -1.1, 0.6, 0.2, 1.2, -0.7, -0.9, 0.2, 0.5, -0.4, 0.8, -0.6])
    truth = 0.25 * load * (load / 10) ** -exponent
    conditions = {"normal_load": load, "internal_pressure": np.full(12, 1e6)}
    found = judge_friction(conditions, truth * (1 + 0.01 * noise), sd=0.01 * truth)
    if exponent:
        assert found.verdict == "explained" and found.effects == ("load-exponent",)
        assert found.steps[-1].estimates["load-exponent.m"]["estimate"] == pytest.approx(1 / 3, abs=0.02)
    else:
        assert found.verdict == "nothing-missing"
        assert found.constant.estimates["friction_coefficient"]["estimate"] == pytest.approx(0.25, rel=0.01)


def test_judges_a_constant_as_reference():
    found = judge_friction({"normal_load": LOAD}, MEASURED, reference=CoulombFriction())
    assert found.separation == () and found.reference.held == pytest.approx(found.constant.held, rel=1e-6)
    few = judge_friction({"normal_load": LOAD[:3], "internal_pressure": PRESSURE[:3]}, MEASURED[:3])
    assert few.verdict == "undecided"
