"""`fit_curve` on NIST's certified problems, on curves whose answer is known in closed form, and on input of no use."""

import json
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from ddetumble import InputError
from ddetumble.inference import curve_fit, fit_curve
from docs.nist_study import MODELS, attempt, count_reached, read_problems, tell_story


ROOT = Path(__file__).resolve().parent.parent
PROBLEMS = read_problems()
FAST = ("Misra1a", "BoxBOD", "Lanczos1", "Lanczos3", "Nelson", "MGH09", "MGH10", "MGH17", "Rat43", "Bennett5")
X = np.linspace(0.0, 2.0, 9)


def draw_line(p, x):
    return p[0] + p[1] * x


def draw_lost(p, x):
    return p[0] * p[1] + p[2] * x


def draw_decay(p, x):
    return p[0] * jnp.exp(-p[1] * x)


def slow_unless_fast(names):
    return [pytest.param(name, marks=[] if name in FAST else pytest.mark.slow) for name in names]


@pytest.mark.parametrize("name", slow_unless_fast(PROBLEMS))
def test_certified(name):
    """Values and standard errors from both starts, and the same answer from each."""
    first, second = (attempt(PROBLEMS[name], start) for start in (1, 2))
    for found in (first, second):
        assert found.fit.converged and found.fit.names == PROBLEMS[name].names
        assert found.values >= 8
        if name == "Lanczos1":  # scatter of 1e-13: 64 bits hold no more of it
            assert found.errors >= 2 and "times the rounding of the readings" in found.fit.message
        else:
            assert found.errors >= 8 and found.squares >= 8 and "rounding" not in found.fit.message
            assert found.fit.residual_sd == pytest.approx(PROBLEMS[name].residual_sd, rel=1e-8)
    np.testing.assert_allclose(first.fit.values, second.fit.values, rtol=1e-8)


@pytest.mark.parametrize("name, solves", [("MGH17", 0), ("MGH10", 1)])
def test_one_damping_is_not_enough(name, solves):
    """From start 1 one of the two dampings ends elsewhere; each of them does so somewhere."""
    problem = PROBLEMS[name]
    begin = problem.starts[0]
    units = jnp.stack([jnp.ones(len(begin)), jnp.abs(begin)])
    weights = jnp.full(len(problem.y), 1.0 / np.sqrt(np.mean(problem.y**2)))
    data = (jnp.asarray(problem.x), jnp.asarray(problem.y), weights)
    squares = np.asarray(curve_fit._descend(MODELS[name], jnp.asarray(begin), units, *data)[1])
    assert int(np.nanargmin(squares)) == solves and squares[1 - solves] > 2 * squares[solves]


@pytest.mark.slow
def test_data_agree_with_themselves():
    """27 problems; deviation and sum of squares go with readings less parameters; every value has 11 digits."""
    assert set(MODELS) == set(PROBLEMS) and len(PROBLEMS) == 27
    for problem in PROBLEMS.values():
        degrees = len(problem.y) - len(problem.certified)
        assert problem.residual_sd == pytest.approx(math.sqrt(problem.sum_of_squares / degrees), rel=2e-10)
        residual = np.asarray(MODELS[problem.name](jnp.asarray(problem.certified), jnp.asarray(problem.x))) - problem.y
        if problem.name not in ("Lanczos1", "Lanczos2"):  # whose last printed digit counts
            assert residual @ residual == pytest.approx(problem.sum_of_squares, rel=1e-5)
    texts = pd.read_csv(ROOT / "data" / "nist-strd" / "parameters.csv", dtype=str)
    assert all(len(text.lstrip("-").split("E")[0]) == 12 for text in texts["certified"])


def test_line():
    """A straight line has its textbook answer, with stated and with estimated scatter."""
    y = 1.0 + 2.0 * X + 0.1 * np.sin(37.0 * np.arange(9))
    design = np.stack([np.ones(9), X], axis=1)
    best, squares = np.linalg.lstsq(design, y)[:2]
    inverse = np.linalg.inv(design.T @ design)
    free, stated = fit_curve(draw_line, X, y, [0.0, 1.0]), fit_curve(draw_line, X, y, {"a": 5.0, "b": -3.0}, sd=0.2)
    for found in (free, stated):
        assert found.converged and found.degrees == 7
        np.testing.assert_allclose(found.values, best, rtol=1e-13)
    np.testing.assert_allclose(free.covariance, inverse * squares[0] / 7, rtol=1e-12)
    np.testing.assert_allclose(stated.covariance, inverse * 0.04, rtol=1e-12)
    np.testing.assert_allclose(stated.errors, np.sqrt(np.diag(stated.covariance)))
    assert stated.sum_of_squares == pytest.approx(squares[0] / 0.04) and free.names == ("p1", "p2")
    assert stated.names == ("a", "b") and "  b " in str(stated) and stated.message in str(stated)
    assert json.loads(json.dumps(stated.to_dict()))["values"] == stated.values.tolist()


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_unit_of_readings(unit):
    """Any unit of the readings gives the same curve."""
    y = np.exp(-1.3 * X) + 0.01 * np.cos(29.0 * np.arange(9))
    one, other = fit_curve(draw_decay, X, y, [0.5, 0.5]), fit_curve(draw_decay, X, y * unit, [0.5 * unit, 0.5])
    np.testing.assert_allclose(other.values, one.values * [unit, 1.0], rtol=1e-12)
    np.testing.assert_allclose(other.errors, one.errors * [unit, 1.0], rtol=1e-9)
    assert other.converged


def test_not_determined():
    """What the readings leave open has an infinite error, and is named; the rest is known."""
    found = fit_curve(draw_lost, X, 1.0 + 2.0 * X, {"k": 1.0, "g": 3.0, "slope": 1.0}, sd=0.1)
    assert not found.converged and "the readings do not determine k, g" in found.message
    assert np.isinf(found.errors[:2]).all() and np.isnan(found.covariance[0, 2])
    assert found.values[2] == pytest.approx(2.0, rel=1e-9) and np.isfinite(found.errors[2])
    unused = fit_curve(draw_line, X, 1.0 + 2.0 * X, [0.0, 0.0, 7.0], sd=0.1)
    assert "do not determine p3" in unused.message and unused.values[2] == 7.0 and np.isfinite(unused.errors[:2]).all()


def test_exact():
    """A curve through all readings: its values are exact, and what its errors are worth is said; so with no freedom."""
    found = fit_curve(draw_decay, X, 3.0 * np.exp(-0.7 * X), [1.0, 1.0])
    np.testing.assert_allclose(found.values, [3.0, 0.7], rtol=1e-13)
    assert found.converged and "times the rounding of the readings" in found.message
    tight = fit_curve(draw_decay, X[:2], [3.0, 2.0], [1.0, 1.0], sd=[0.1, 0.2])
    assert tight.converged and tight.degrees == 0 and math.isnan(tight.residual_sd) and np.isfinite(tight.errors).all()
    assert fit_curve(draw_line, X, np.zeros(9), [1.0, 1.0], sd=1.0).values == pytest.approx([0.0, 0.0], abs=1e-12)


def test_stopped_early(monkeypatch):
    """A fit that ran out of steps says so."""
    monkeypatch.setattr(curve_fit, "MOST_STEPS", 2)
    monkeypatch.setattr(curve_fit, "MOST_POLISH", 0)
    found = fit_curve(lambda p, x: p[0] * jnp.exp(-p[1] * x), X, 3.0 * np.exp(-0.7 * X), [9.0, 9.0])
    assert not found.converged and found.message.startswith("Not converged after 2 steps: one more step would change")


GOOD = {"model": draw_line, "x": X, "y": 1.0 + X, "start": [1.0, 1.0], "sd": None}
HOLED = np.where(X == 0.5, np.nan, X)


@pytest.mark.parametrize(
    "change, says",
    [
        ({"y": HOLED}, "y number 3 is not a number"),
        ({"x": HOLED}, "x number 3 is not a number"),
        ({"x": np.stack([X, HOLED])}, "x number 3 is not a number"),
        ({"y": ["high"] * 9}, "y must be numbers"),
        ({"y": X[:-1]}, "x and y must have the same length; they are 9 and 8 long"),
        ({"x": np.ones((9, 2))}, "they are 2 and 9 long; several predictors take one row each"),
        ({"y": np.ones((3, 3))}, "y must be a list of numbers"),
        ({"start": []}, "start must be a list of numbers"),
        ({"start": 3.0}, r"start must be a list of numbers; its shape is \(\)"),
        ({"start": [1.0, math.inf]}, "start of p2 is not a number"),
        ({"start": {"a": math.nan, "b": 1.0}}, "start of a is not a number"),
        ({"start": {"a": "one", "b": 1.0}}, "start must be numbers"),
        ({"sd": 0.0}, "sd must be positive; number 1 is 0"),
        ({"sd": np.where(X > 1, -1.0, 1.0)}, "sd must be positive; number 6 is -1"),
        ({"sd": HOLED + 1}, "sd number 3 is not a number"),
        ({"sd": [1.0, 1.0]}, r"sd must be one number or as many as y, which are 9; its shape is \(2,\)"),
        ({"x": X[:2], "y": X[:2]}, "too few readings: 2, but 2 parameters need at least 3; standard errors from"),
        ({"x": X[:1], "y": X[:1], "sd": 1.0}, "too few readings: 1, but 2 parameters need at least 2$"),
        ({"model": lambda p, x: p}, r"one number per reading, shape \(9,\); it returns \(2,\)"),
        ({"model": lambda p, x: (x, x)}, r"one number per reading, shape \(9,\); it returns tuple"),
        ({"model": lambda p, x: jnp.log(x) * p[0]}, "the model at the start is not a number for reading number 1"),
    ],
)
def test_bad_input(change, says):
    """What is no use is refused in one sentence that says where it is."""
    with pytest.raises(InputError, match=says) as caught:
        fit_curve(**{**GOOD, **change})
    assert "\n" not in str(caught.value)


def test_committed_study():
    """What stands under fits/ reaches what was asked for, and says so."""
    found = json.loads((ROOT / "fits" / "nist-strd" / "result.json").read_text(encoding="utf-8"))
    reached = found["reached"]
    assert len(found["fits"]) == 54 == reached["values_to_6"] and reached["values_to_8"] >= 48
    assert reached["errors_to_6"] >= 52


def test_page():
    """The page counts the fits that it is given, and names the standard errors that fall short."""
    attempts = [attempt(PROBLEMS["Lanczos1"], start) for start in (1, 2)]
    assert count_reached(attempts)["values_to_8"] == 2 and count_reached(attempts)["errors_to_6"] == 0
    page = tell_story(attempts)
    assert "to 6 digits in 2 of 2 fits" in " ".join(page.split()) and "Lanczos1 from start 1 has" in page
