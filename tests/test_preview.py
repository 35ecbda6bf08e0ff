"""Sliders: the preview against the exact model, its chi-square against a refit, and the page in a browser."""

import re
import shutil
import subprocess

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.effects import parameters_of
from ddetumble.selection.preview import preview_effects


pytestmark = pytest.mark.slow
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="module")
def found():
    return dd.discover(dd.find_data() / "slip-c")


@pytest.fixture(scope="module")
def preview(found):
    made = preview_effects(found.fits[0], found.candidates)
    assert made is not None
    return made


def move(preview, name, position):
    positions = np.zeros(len(preview.levers))
    positions[[one.name for one in preview.levers].index(name)] = position
    return positions


def test_at_rest_it_is_the_fit(found, preview):
    assert preview.total(np.zeros(len(preview.levers))) == pytest.approx(found.fits[0].bounded.solution.chi2, rel=1e-9)
    for fitted, measured, change in zip(preview.fitted, preview.measured, preview.changes, strict=True):
        assert fitted.shape == measured.shape == change.shape[1:]


def test_at_the_end_of_a_slider_it_is_the_model_with_that_value(found, preview):
    """Chi-square is that of the exact model with its settings fitted again, for effects of one parameter."""
    fit, checked = found.fits[0], 0
    problem, solution = fit.problem, fit.bounded.solution
    simple = {effect.id for effect in problem.space.effects if len(parameters_of(effect)) == 1}
    for one in preview.levers:
        if one.effect not in simple or one.error > 0.02:
            continue
        u = solution.u.copy()
        k = problem.space.index[one.name]
        u[k] = problem.space.parameter(one.name).transform.to_unconstrained(one.values[-1])
        # Settings refitted by the exact model, from where they are.
        exact = problem.solve([], u, solution.z)
        told = preview.total(move(preview, one.name, 1.0))
        assert told - solution.chi2 == pytest.approx(exact.chi2 - solution.chi2, rel=0.05, abs=2.0)
        checked += 1
    assert checked >= 2


def test_values_are_told_from_end_to_end(found, preview):
    """A slider begins at the null of an effect, or the same way beyond it, and passes the fit's own values at rest."""
    for one in preview.levers:
        assert one.low in (-1.0, 0.0) and len(one.values) > 2
        rest = one.values[0] if one.low == 0.0 else one.values[len(one.values) // 2]
        if not one.effect:
            assert rest == pytest.approx(found.fits[0].parameters[one.name].estimate, rel=1e-6)
        else:
            default = found.fits[0].problem.space.parameter(one.name)
            assert rest == pytest.approx(default.transform.from_unconstrained(default.default), rel=1e-9, abs=1e-12)


def test_initial_rates_follow():
    """Without a prior they move far in their own deviations; what is drawn is the exact model with them refitted."""
    fit = dd.fit("tumble-a")
    preview = preview_effects(fit, ())
    assert preview is not None and preview.has_starts and not preview.has_settings
    lever, = preview.levers
    assert 0.0 < lever.error <= 1.0
    problem, solution = fit.problem, fit.bounded.solution
    u = solution.u.copy()
    u[problem.space.index[lever.name]] = problem.space.parameter(lever.name).transform.to_unconstrained(
        lever.values[-1])
    exact = problem.solve([], u, solution.z)
    assert exact.chi2 > 2.0 * solution.chi2
    assert preview.total([1.0]) == pytest.approx(exact.chi2, rel=0.1)
    noise = fit.noise[preview.channel].sd
    for r, change in enumerate(preview.changes):
        keep = np.searchsorted(np.asarray(problem.records.stack.time)[r], preview.places[r])
        moved = (exact.channels - solution.channels)[r, 0][keep]
        assert np.sqrt(np.mean((change[0] - moved) ** 2)) < 4.0 * noise  # four times what it is off half way


def test_values_without_time_have_no_sliders():
    assert preview_effects(dd.fit("paper/table-3"), ()) is None


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here to open the page with")
def test_the_page_says_the_same(found, preview, tmp_path):
    """Moved in the browser by the address: chi-square is the preview's, and the command names the effect."""
    page = dd.report(found, tmp_path / "out")
    lever = next(one for one in preview.levers if one.effect)
    name, low = lever.name, lever.low
    place = low + 0.75 * (1.0 - low)
    value = float(np.interp(place, np.linspace(low, 1.0, len(lever.values)), lever.values))
    for text, positions in (("", np.zeros(len(preview.levers))),
                            (f"#try:{name}={value!r}", move(preview, name, place)),  # in the parameter's unit
                            (f"#try:{name}={1e6 * lever.values[-1]!r}", move(preview, name, 1.0))):  # no further
        done = subprocess.run(
            [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'browser'}",
             "--virtual-time-budget=4000", "--dump-dom", f"file://{page.resolve()}{text}"],
            capture_output=True, text=True, timeout=120, check=True)
        total = re.search(r'data-total="([-\d.e+]+)"', done.stdout)
        assert total is not None
        assert float(total[1]) == pytest.approx(preview.total(positions), rel=1e-5)
        command = re.search(r'data-part="command">([^<]*)<', done.stdout)
        assert command is not None and command[1].startswith("ddetumble fit slip-c --model paper")
        assert (f"--effect {name.split('.')[0]}" in command[1]) == bool(text)
