"""The missing force: splines and ridges by theory, and forces that the independent simulator hid, drawn blind."""

import dataclasses as dc
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pint
import pytest
from scipy.interpolate import BSpline

from ddetumble import Ball, InputError, draw_missing_force, find_data
from ddetumble.cli import main
from ddetumble.contact.sliding import AdhesionHysteresis
from ddetumble.dynamics import simulate_impact
from ddetumble.dynamics.slide import simulate_sliding
from ddetumble.effects.free import (
    COUNT,
    IMPACT_GROUND,
    PLAN,
    SLIP_GROUND,
    TUMBLE_GROUND,
    blank_plan,
    blend_splines,
    evaluate_form,
    evaluate_slope,
    evaluate_spline,
)
from ddetumble.effects.free import FORMS as KINDS
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.figures import draw_missing_shape
from ddetumble.reports import write_missing
from ddetumble.selection.cross_validation import compare_losses
from ddetumble.selection.missing.free_form import (
    Normal,
    Term,
    coarsen,
    evaluate_basis,
    hold_out,
    measure_ridge,
    smooth,
    solve_ridge,
    spread_ridge,
)
from ddetumble.selection.missing.missing_force import find_lone, summarise_missing
from ddetumble.selection.missing.symbolic import FORMS, amplitude_unit, evaluate, find_rivals, order_laws, sketch_law
from ddetumble.selection.result import Estimate, Law, MissingForce, Shape


TERM = Term("depression", "force", ("",), np.array([[1.0, 1.0, 0.0, 0.0]]), 0.0, 8e-3, 12, False)
CONDITIONS = {"initial_pressure": 0.9e6, "approach_speed": 0.4}


# Splines


def test_splines_are_scipys():
    z = np.linspace(-3, 3, 121)
    spline = BSpline.basis_element(np.arange(-2, 3), extrapolate=False)
    np.testing.assert_allclose(evaluate_spline(jnp.asarray(z)), np.nan_to_num(spline(z)), atol=1e-14)
    np.testing.assert_allclose(evaluate_slope(jnp.asarray(z)), np.nan_to_num(spline.derivative()(z)), atol=1e-13)


@pytest.mark.parametrize(("fine", "coarse"), [(12, 4), (18, 9), (45, 15)])
def test_coarse_splines_are_sums_of_fine_ones(fine, coarse):
    x = np.linspace(TERM.low, TERM.high, 301)
    np.testing.assert_allclose(evaluate_basis(TERM, fine, x) @ coarsen(fine, coarse), evaluate_basis(TERM, coarse, x),
                               atol=1e-12)


def test_prior_is_next_to_free_for_lines_and_punishes_bends():
    centres = np.arange(15.0)
    cost = [float(np.sum(np.linalg.solve(smooth(12), c) ** 2)) for c in (centres - 7.0, np.cos(centres * 2.0))]
    # theta^T theta = c^T (D^T D + 1e-4) c in closed form.
    np.testing.assert_allclose(cost[0], 1e-4 * np.sum((centres - 7.0) ** 2), rtol=1e-6)
    assert cost[1] > 100 * cost[0]


# Derivatives


def plan_of(ground, slots):
    """A plan of one record in which the first splines stand over the first variable in the first direction."""
    plan = {name: array[0] for name, array in blank_plan(ground, 1).items()}
    for k, (centre, width) in enumerate(slots):
        plan[f"{PLAN}-variable"][k, 0] = 1.0
        plan[f"{PLAN}-centre"][k], plan[f"{PLAN}-width"][k] = centre, width
        plan[f"{PLAN}-direction"][k, :2] = 1.0
        plan[f"{PLAN}-turn"][k, k] = 1.0
    return {name: jnp.asarray(array) for name, array in plan.items()}


def differences(f, x, h):
    """Central differences by every coordinate."""
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(len(x))], axis=-1)


@pytest.mark.slow
def test_blend_has_the_derivatives_of_its_sum():
    """The rule that is written out, forward and reverse, against differences; by the variables too."""
    rng = np.random.default_rng(3)
    turn = jnp.asarray(rng.normal(size=(COUNT, COUNT)))
    which = jnp.asarray(np.eye(3)[rng.integers(0, 3, COUNT)]).at[-1].set(0.0)
    rest = (which, jnp.asarray(rng.uniform(0, 1, COUNT)), jnp.full(COUNT, 0.2),
            jnp.asarray(rng.normal(size=(COUNT, 4))), turn)
    start = np.concatenate([rng.normal(size=COUNT), [0.3, 0.52, 0.81]])

    def f(x):
        return blend_splines(x[:COUNT], x[COUNT:], *rest)

    expected = differences(lambda x: np.asarray(f(jnp.asarray(x))), start, 1e-6)
    np.testing.assert_allclose(jax.jacfwd(f)(jnp.asarray(start)), expected, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(jax.jacrev(f)(jnp.asarray(start)), expected, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
def test_derivatives_through_the_solve():
    """Force of an impact by the coefficients: forward, reverse and differences agree; at their null they are absent."""
    free = IMPACT_GROUND.splines
    conditions = {name: jnp.asarray(x) for name, x in CONDITIONS.items()}
    conditions |= plan_of(IMPACT_GROUND, [(2e-3, 2e-3), (4e-3, 2e-3), (6e-3, 2e-3)])
    times = jnp.linspace(2e-3, 0.02, 9)

    def f(c):
        law = Ball().extend((free(c_0=c[0], c_1=c[1], c_2=c[2]),))
        return simulate_impact(law, conditions, times).normal_force

    bare = simulate_impact(Ball().extend(()), conditions, times).normal_force
    np.testing.assert_allclose(f(jnp.zeros(3)), bare, rtol=1e-9)
    start = np.array([1.5, -2.0, 4.0])
    expected = differences(lambda c: np.asarray(jax.jit(f)(jnp.asarray(c))), start, 1e-3)
    forward = jax.jit(jax.jacfwd(f))(jnp.asarray(start))
    np.testing.assert_allclose(forward, expected, rtol=1e-4, atol=1e-4)
    weight = np.linspace(-1, 1, 9)
    reverse = jax.jit(jax.grad(lambda c: jnp.sum(weight * f(c))))(jnp.asarray(start))
    np.testing.assert_allclose(reverse, weight @ np.asarray(forward), rtol=1e-6)


@pytest.mark.slow
def test_slip_force_adds_what_its_splines_say():
    """Friction with a free force less friction without is the sum of splines, in closed form."""
    free = SLIP_GROUND.splines
    conditions = {"normal_load": jnp.asarray(12.0), "internal_pressure": jnp.asarray(1e6),
                  "slip_speed": jnp.asarray(0.1), **plan_of(SLIP_GROUND, [(3e-3, 1e-3), (5e-3, 1e-3)])}
    s = jnp.linspace(0.0, 8e-3, 81)
    bare = simulate_sliding(AdhesionHysteresis().extend(()), conditions, s).tangential_force
    law = AdhesionHysteresis().extend((free(c_0=0.4, c_1=-0.2),))
    added = 0.4 * evaluate_spline((s - 3e-3) / 1e-3) - 0.2 * evaluate_spline((s - 5e-3) / 1e-3)
    np.testing.assert_allclose(simulate_sliding(law, conditions, s).tangential_force - bare, added, atol=1e-12)
    # The same splines as a share of the friction.
    name = f"{PLAN}-direction"
    shared = conditions | {name: conditions[name][:, jnp.array([2, 3, 0, 1])]}
    np.testing.assert_allclose(simulate_sliding(law, shared, s).tangential_force, bare * (1.0 + added), rtol=1e-12)


# Laws


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_forms_are_one_law_in_both_places(form):
    """What screening evaluates is what the equation of motion holds (a sawtooth: its first harmonics)."""
    shape = {"x": 0.3, "l": 0.41, "n": form.power}
    x, scale = np.linspace(0.05, 2.0, 40) * 1e-3, 2e-3
    one = jnp.asarray(np.eye(len(KINDS))[KINDS.index(form.kind)])
    first, second = jax.vmap(lambda at: evaluate_form(
        one, at, 0.3 * scale, 0.41 * scale, jnp.asarray(form.power), scale))(jnp.asarray(x))
    wanted = evaluate(form, x, shape, scale)
    if form.kind == "sawtooth":
        # A Fourier series of a sawtooth is within 0.35 of it away from the jump, in the mean square much nearer.
        assert np.sqrt(np.mean((np.asarray(first) - wanted[0]) ** 2)) < 0.3
        return
    np.testing.assert_allclose(first, wanted[0], atol=1e-12)
    if len(wanted) > 1:
        np.testing.assert_allclose(second, wanted[1], atol=1e-12)


@pytest.mark.parametrize("ground", (IMPACT_GROUND, SLIP_GROUND, TUMBLE_GROUND), ids=("impact", "slip", "tumble"))
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_units_of_a_law_make_a_force(ground, form):
    """Amplitude times what its form does to the variable has the dimension of the force."""
    units = pint.UnitRegistry()
    for variable in ground.variables.values():
        x = units.Quantity(2.0, variable)
        power = 1.5 if "n" in form.shapes else form.power
        amplitude = units.Quantity(3.0, amplitude_unit(form, ground.unit, variable, power))
        made = amplitude * x**power if form.kind in ("power", "signed power") else amplitude * (x / x)
        assert made.check(units.Quantity(1.0, ground.unit).dimensionality)


# Ridge


def test_holding_out_is_solving_again_without():
    """Losses and covariance of a linear problem against the same by hand."""
    rng = np.random.default_rng(5)
    rows, right = rng.normal(size=(4, 30, 6)), rng.normal(size=(4, 30))
    weight = np.array([0.0, 0.0, 2.0, 2.0, 2.0, 2.0])
    normal = Normal(np.einsum("grk,grl->gkl", rows, rows), np.einsum("grk,gr->gk", rows, right),
                    np.sum(right**2, axis=1))
    losses = hold_out(normal, weight)
    for out in range(4):
        kept = [g for g in range(4) if g != out]
        stacked = np.concatenate([*rows[kept], np.diag(weight)])
        theta = np.linalg.lstsq(stacked, -np.concatenate([*right[kept], np.zeros(6)]), rcond=None)[0]
        assert losses[out] == pytest.approx(np.sum((rows[out] @ theta + right[out]) ** 2), rel=1e-8)
    whole = np.concatenate([*rows, np.diag(weight)])
    np.testing.assert_allclose(spread_ridge(normal, weight), np.linalg.inv(whole.T @ whole), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(
        solve_ridge(normal, weight), np.linalg.lstsq(whole, -np.concatenate([*right, np.zeros(6)]), rcond=None)[0],
        rtol=1e-8)
    least = np.concatenate(rows) @ solve_ridge(normal, weight) + np.concatenate(right)
    assert measure_ridge(normal, weight) == pytest.approx(np.sum(least**2), rel=1e-10)


# Forces that the independent simulator hid

IMPACT = ([0.6e6, 1.1e6, 2.0e6], [0.2, 0.4, 0.6])
BASE = {"effective_mass": 1.3, "restitution": 0.72}
SLIP_BASE = {"adhesion_constant": 0.92, "loss_factor": 0.17, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
             "slip_scale": 1.0}  # fmt: skip


@pytest.mark.study
def test_end_stop_is_drawn_where_it_is(tmp_path):
    """An end stop at another depth, stiffness and power than any shipped: ceiling, shape, place and law."""
    truth = {"k": 2.0e6, "depth": 4.6e-3, "exponent": 1.5}
    write_package(tmp_path, make_campaign("stop", 7, {"x-end-stop": truth}, BASE, *IMPACT))
    found = draw_missing_force(tmp_path, catalogue=False)
    assert found.ceiling is not None
    assert found.share(found.ceiling[1]) > 0.9
    best = found.shapes[0]
    assert best.variable == "depression"
    force = truth["k"] * np.maximum(best.x - truth["depth"], 0.0) ** 1.5
    seen = (best.visited > 0) & (best.x < 0.9 * best.x[-1])
    drawn = best.values[0]
    if best.way == "force" and len(best.parts) == 1:
        assert np.sqrt(np.mean((drawn - force)[seen] ** 2)) < 0.1 * force[seen].max()
    law = found.laws[0]
    assert law.forms[0].startswith("onset")
    assert law.parameters["d"].estimate == pytest.approx(truth["depth"], rel=0.05)


@pytest.mark.study
def test_end_stop_that_one_condition_reaches(tmp_path):
    """Left-out conditions cannot tell laws apart there; the place and the power are drawn all the same."""
    truth = {"k": 2.0e5, "depth": 6.4e-3, "exponent": 1.5}
    write_package(tmp_path, make_campaign("stop", 5, {"x-end-stop": truth}, BASE, *IMPACT))
    found = draw_missing_force(tmp_path, catalogue=False)
    law = found.laws[0]
    assert found.lone and law.forms[0].startswith("onset")
    onset = law.parameters["d" if "d" in law.parameters else "d 1"]
    assert abs(onset.estimate - truth["depth"]) < 3 * onset.sd


@pytest.mark.slow
def test_nothing_hidden_nothing_drawn(tmp_path):
    write_package(tmp_path, make_campaign("null", 8, {}, BASE, *IMPACT))
    found = draw_missing_force(tmp_path, catalogue=False)
    assert found.ceiling is None and not found.shapes


@pytest.mark.slow
@pytest.mark.parametrize("wavelength", [pytest.param(2.6e-3, marks=pytest.mark.study), 1.3e-3])
def test_stick_slip_is_drawn_with_its_wavelength(tmp_path, wavelength):
    """A sawtooth in the slip at other wavelengths than the practice's: spectrum, law, and its form among rivals."""
    made = make_slip_campaign("stick", 9, {"x-stick-slip": {"ratio": 0.05, "wavelength": wavelength}}, SLIP_BASE,
                              [6.0, 13.0, 26.0], [0.8e6, 2.1e6], [0.03, 0.12, 0.4], 1)
    write_package(tmp_path, made)
    found = draw_missing_force(tmp_path, catalogue=False)
    best = found.shapes[0]
    assert best.variable == "slip" and best.way == "share"
    number, amplitude, sd = best.spectrum
    k = int(np.argmax(amplitude))
    assert 1.0 / number[k] == pytest.approx(wavelength, rel=0.1)
    assert amplitude[k] > 20 * sd[k]
    assert found.laws[0].forms == ("sawtooth",)
    assert found.laws[0].parameters["l"].estimate == pytest.approx(wavelength, rel=0.01)
    assert found.share(found.ceiling[1]) > 0.8


# Pictures and page


def invent(way="force", notes=()):
    """A missing force by hand: 100 N/mm beyond 5 mm, drawn without error."""
    x = np.linspace(0.0, 8e-3, 121)
    law = Law("k (depression - d)+", ("depression",), ("force",), ("",), ("onset",),
              {"k": Estimate(1e5, 1e3, 9.8e4, 1.02e5, "N/m"), "d": Estimate(5e-3, 1e-5, 4.98e-3, 5.02e-3, "m")},
              1050.0, np.array([500.0, 550.0]), 1000.0, 2, True, 0.0, 0.0)
    shape = Shape("depression", way, ("",), x, 1e5 * np.maximum(x - 5e-3, 0.0)[None], np.full((1, 121), 2.0),
                  np.full(121, 1 / 121), "N", 18, 0.9, 1020.0, 0.0, 0.0, 5.1e-3, False, np.zeros((3, 0)))
    return MissingForce("impact", (), 3000.0, 3000.0, ("wall-stiffness", 2500.0), (("force over depression",), 1010.0),
                        1000.0, (shape,), (), (law,), "A sentence with <b>.", notes)


def test_law_is_drawn_on_its_shape():
    missing = invent()
    shape = missing.shapes[0]
    np.testing.assert_allclose(sketch_law(missing.laws[0], shape, 0), shape.values[0], atol=1e-9)
    assert sketch_law(missing.laws[0], invent("share").shapes[0], 0) is None
    assert missing.share(2500.0) == pytest.approx(0.25)
    assert missing.share(5000.0) == 0.0


@pytest.mark.parametrize(("excess", "lone"), [
    ([0.0, 500.0, 0.0], ("r2", "r3")), ([30.0, 500.0, 20.0], ("r2", "r3")), ([30.0, 500.0, 30.0], ()),
    ([500.0, -5.0, 40.0], ("r0", "r1")), ([0.0, 0.0, 500.0], ("r4",))])
def test_one_condition_alone_shows_it(excess, lone):
    records = SimpleNamespace(used=np.ones((5, 1, 10), dtype=bool), count=5, keys=("r0", "r1", "r2", "r3", "r4"))
    problem = SimpleNamespace(records=records, groups=np.array([0, 0, 1, 1, 2]))
    assert find_lone(np.array([20.0, 20.0, 10.0]) + excess, problem) == lone
    text = summarise_missing(dc.replace(invent(), lone=lone))
    without = summarise_missing(dc.replace(invent(), lone=()))
    assert (text != without) == bool(lone) and all(key in text for key in lone)


@pytest.mark.parametrize(("plain", "bent", "first", "rivals"), [
    # One condition decides what is left out: chance, so that the fit does, at 9 noise variances a parameter.
    ([(10, 10, 10, 5000), 300.0], [(10, 10, 10, 8000), 166.0], "bent", []),
    ([(10, 10, 10, 5000), 190.0], [(10, 10, 10, 8000), 166.0], "bent", ["plain"]),
    ([(10, 10, 10, 5000), 170.0], [(10, 10, 10, 8000), 166.0], "plain", ["bent"]),
    ([(10, 10, 10, 8000), 170.0], [(10, 10, 10, 5000), 166.0], "plain", ["bent"]),  # a bend that nothing asks for
    # All conditions say the same: then no fit is good enough.
    ([(30, 30, 31, 31), 300.0], [(60, 61, 62, 60), 166.0], "plain", []),
    ([(60, 61, 62, 60), 166.0], [(30, 30, 31, 31), 300.0], "bent", []),
])
def test_which_law_comes_first(plain, bent, first, rivals):
    laws = [dc.replace(invent().laws[0], text=text, losses=np.array(losses, float), loss=float(sum(losses)), chi2=chi2,
                       count=count) for text, (losses, chi2), count in (("plain", plain, 2), ("bent", bent, 3))]
    ranked = order_laws(laws)
    assert ranked[0].text == first and len(ranked) == 2
    compared = [ranked[0], *(dc.replace(law, difference=d, standard_error=e) for law in ranked[1:]
                             for d, e in [compare_losses(law.losses, ranked[0].losses, np.arange(4))])]
    assert [law.text for law in find_rivals(compared)] == rivals
    longer = dc.replace(ranked[0], text=f"{first} + more", count=ranked[0].count + 1)
    assert [law.text for law in find_rivals([*compared, longer])] == rivals
    assert order_laws([]) == []


def test_page_is_written_and_escaped(tmp_path):
    page = write_missing(invent(notes=("<script>alert(1)</script>",)), tmp_path, title="a & b").read_text()
    assert "A sentence with &lt;b&gt;." in page and "<script>alert" not in page
    assert (tmp_path / "figures" / "missing-shape.png").stat().st_size > 10_000
    json.dumps(invent().to_dict(), allow_nan=False)
    assert "losses" not in invent().to_dict()["laws"][0]


def test_figure_marks_place_and_shares():
    figure = draw_missing_shape(invent())
    curve, bars = figure.axes[:2]
    assert curve.get_xlabel() == "depression [mm]"
    assert [round(bar.get_width()) for bar in bars.patches] == [25, 98, 99, 100]
    alone = draw_missing_shape(dc.replace(invent(), lone=("r1",))).axes[1]  # where no other condition can judge a law
    assert [round(bar.get_width()) for bar in alone.patches] == [25, 99, 100]


# Bad input


def test_what_cannot_be_drawn_is_said(tmp_path, capsys):
    with pytest.raises(InputError, match="not for oblique ones"):
        draw_missing_force(find_data() / "oblique-a", catalogue=False)
    assert main(["missing", str(tmp_path / "nowhere")]) == 2
    assert "no such campaign folder" in capsys.readouterr().err
    assert main(["missing", "impact-a", "--effect", "adhesoin", "-o", str(tmp_path / "new")]) == 2
    assert "did you mean adhesion?" in capsys.readouterr().err
