"""The paper beside the toolkit: every number against one found by hand or by plain NumPy and SciPy."""

import json
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from ddetumble._errors import InputError
from ddetumble._sentences import tell
from ddetumble._settings import find_data
from ddetumble.contact.law import Ball
from ddetumble.dynamics.curves import normal_force
from ddetumble.effects.impact import ViscousDashpot
from ddetumble.families.impact import refine_peak
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.paper import write_paper
from ddetumble.paper.peaks import compute_peaks, fit_exponent
from ddetumble.paper.section import write_section
from ddetumble.reference_models import MODELS, SLIP_MODELS
from ddetumble.selection.discover import discover


pytestmark = pytest.mark.slow


PRESSURE = np.linspace(0.0, 2.5e6, 11)
MEASURED = np.array([39.8, 41.3, 42.1, 44.8, 48.2, 50.3, 53.5, 57.9, 62.6, 66.2, 70.8])
PRINTED = np.array([42.1, 43.3, 44.9, 47.1, 49.7, 52.9, 56.5, 60.7, 65.3, 70.4, 75.9])
FIGURE_PRESSURE = np.array([1.0, 1.5, 2.0, 2.5]) * 1e6
FIGURE = np.array([48.519, 54.669, 62.857, 69.183])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page, written once, with what it told."""
    folder, told = tmp_path_factory.mktemp("paper"), []
    page = write_paper(folder, echo=told.append)
    return page, told, json.loads((folder / "paper.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def points(written):
    return {point["row"]: point for point in written[2]["contradictions"]}


def find_row(judged, start):
    return next(row for row in judged["models"] if row["model"].startswith(start))


def find_size(values):
    return np.sqrt(np.mean(np.square(values)))


def solve_kappa(e):
    """Damping number by the closed form, solved independently."""
    def place(x):  # of the logarithm of what is missing from 1 in k e, which is far below rounding for small e
        return -np.expm1(x) / e

    return place(brentq(lambda x: x + place(x) * (1.0 + e) - np.log1p(place(x)), -2.0 / e, -1e-12))


def integrate_peak(mass, e, pressure, dashpot=0.0, speed=0.4):
    """Peak force and contact time of the paper's ball by SciPy."""
    c = solve_kappa(e) / speed

    def force(depth, rate):
        b, r = np.pi / 4 * depth, (0.06 - depth) / 2
        volume = 2 * np.pi * (b**2 * r + np.pi * b * r**2 / 2 + 2 * r**3 / 3)
        elastic = pressure * (np.pi * 0.06**3 / 6 / volume) * np.pi * b**2
        return max(elastic * (1 + c * rate) + dashpot * rate, 0.0)

    def leave(t, y):
        return y[0] + (1e-9 if t < 1e-6 else 0.0)

    leave.terminal, leave.direction = True, -1
    found = solve_ivp(lambda t, y: [y[1], -force(*y) / mass], (0, 0.27), [0, speed], rtol=1e-10, atol=1e-12,
                      dense_output=True, events=leave)
    # Around the largest of the integrator's own steps, and at first touch, where a dashpot jumps.
    own = [force(max(a, 0.0), b) for a, b in found.y.T]
    k = int(np.clip(np.argmax(own), 1, len(own) - 2))
    fine = np.linspace(found.t[k - 1], found.t[k + 1], 301)
    return max(own[0], *(force(max(a, 0.0), b) for a, b in found.sol(fine).T)), found.t[-1]


@pytest.mark.study
def test_contradictions_are_all_there(points):
    assert sorted(points) == list(range(1, 17))
    for point in points.values():
        assert point["sentence"] and point["used"]
        assert re.search(r"\d", point["printed"]) and re.search(r"\d", point["found"])  # a number on either side


@pytest.mark.study
@pytest.mark.parametrize(("row", "name", "value", "within"), [
    (1, "area", 4.6, 0.05), (1, "quarter", 5.7, 0.05), (1, "printed", 45.0, 0.05), (1, "ours", 46.0, 0.05),
    (3, "ratio_perimeter", 0.94, 0.005), (3, "ratio_quarter", 1.21, 0.005), (3, "volume_slope", 0.70, 0.005),
    (4, "delivered_0.8", 0.847, 5e-4), (4, "delivered_0.5", 0.725, 5e-4), (6, "sign_load", 44.4, 0.005),
    (7, "largest_percent", 7.2, 0.05), (7, "largest_by_theory_percent", 6.7, 0.05), (7, "eighth_percent", 4.6, 0.05),
    (7, "mean_percent", 5.4, 0.05), (8, "0-2.5", 2.4, 0.07), (8, "0.1-2.5", 3.1, 0.07), (8, "0-2.6", 3.5, 0.07),
    (8, "0.1-2.6", 4.5, 0.07), (8, "0.2-2.7", 6.8, 0.07), (13, "fourth_percent", 0.9, 0.05),
    (13, "eleventh_percent", 1.9, 0.05), (14, "earlier", 863.9, 0.05), (14, "printed", 45.0, 0.05),
    (15, "constant", 42.061, 5e-4), (15, "slope", 0.9444, 5e-5), (15, "bend", 0.2444, 5e-5), (16, "cavity", 33.5, 0.05),
    (16, "outside", 113.1, 0.05), (16, "limit", 1.28, 0.005)])
def test_numbers_of_the_points(points, row, name, value, within):
    """Numbers worked out beforehand by hand; 2.4 % was found for the first range, which is 2.34 %."""
    assert points[row]["values"][name] == pytest.approx(value, abs=within)


def test_all_of_the_paper_is_accounted_for():
    """A row for every equation, table and figure that the paper numbers, each with where it is or why it is not."""
    table = next(one for one in write_section("paper.coverage", {}).tables)
    named = [row[0] for row in table[1:]]
    assert named == [f"{kind} {k}" for kind, last in (("Eq.", 11), ("Table", 6), ("Figure", 24))
                     for k in range(1, last + 1)]
    assert all(len(row) == 3 and all(row) for row in table)
    models = {model for row in table[1:] for model in re.findall(r"`([\w-]+)`", row[2])}
    assert models <= {*MODELS, *SLIP_MODELS}


def test_the_core_counted_twice_takes_from_the_force():
    """The point says so of its own numbers: fewer newtons as printed are less, more are more."""
    told = [tell("paper.point_2", v={"share_percent": share}, force={"printed": 46.0 - share, "ours": 46.0})[-1]
            for share in (1.0, -1.0)]
    assert [one.split()[-1] for one in told] == ["less.", "more."]


@pytest.mark.study
def test_pressures_and_ranges_of_the_points(points):
    assert points[3]["values"]["ratio_area"] > 1.0
    misses = points[8]["values"]
    assert all(misses[span] >= 10 for span in ("0.5-2.5", "1-2", "1-3", "0-2"))
    assert min(misses, key=misses.get) == "0-2.5"


@pytest.mark.study
def test_duration_of_an_impact(points, written):
    values = points[9]["values"]
    assert 0.03 <= values["shortest"] < values["longest"] <= 0.0425
    assert 0.065 <= values["quarter_shortest"] < values["quarter_longest"] <= 0.155
    mass = find_mass(written)
    assert integrate_peak(mass, 0.7, 1.0e6)[1] == pytest.approx(values["longest"], rel=1e-3)


@pytest.mark.study
def test_sign_of_equation_5(points):
    # Run backwards, the impact comes with R v1 and leaves with v1.
    kappa = solve_kappa(0.7)
    ratio = points[12]["values"]["rebound_ratio"]
    assert points[12]["values"]["kappa"] == pytest.approx(kappa, rel=1e-8)
    assert solve_kappa(1 / ratio) == pytest.approx(kappa * ratio, rel=1e-6)
    assert ratio > 1


def find_mass(written, restitution=0.7):
    return next(one["mass"] for one in written[2]["figure-8"]["by_restitution"] if one["restitution"] == restitution)


@pytest.mark.study
@pytest.mark.parametrize("e", [0.5, 0.7, 0.99])
def test_four_peaks_with_one_mass(written, e):
    mass = find_mass(written, e)
    peaks = np.array([integrate_peak(mass, e, p)[0] for p in FIGURE_PRESSURE])
    assert np.max(np.abs(peaks / FIGURE - 1)) < 0.035
    # No other mass does better in least squares.
    def cost(m):
        return sum((integrate_peak(m, e, p)[0] / y - 1) ** 2 for p, y in zip(FIGURE_PRESSURE, FIGURE, strict=True))

    assert cost(mass) <= min(cost(0.99 * mass), cost(1.01 * mass))


def test_growth_with_pressure():
    exponent, error = fit_exponent(FIGURE_PRESSURE, FIGURE)
    assert exponent == pytest.approx(0.39, abs=0.005)
    assert exponent == pytest.approx(np.polyfit(np.log(FIGURE_PRESSURE), np.log(FIGURE), 1)[0], rel=1e-9)
    assert 0 < error < 0.1


@pytest.mark.study
def test_left_out_errors_by_plain_loops(written):
    judged = written[2]["table-3"]
    factor, curves = np.empty(11), {degree: np.empty(11) for degree in (1, 2, 3)}
    for k in range(11):
        rest = np.arange(11) != k
        a, y = PRINTED[rest] / MEASURED[rest], np.ones(10)
        factor[k] = PRINTED[k] * (a @ y) / (a @ a) - MEASURED[k]
        for degree, errors in curves.items():
            beta = np.polyfit(PRESSURE[rest] / 1e6, MEASURED[rest], degree, w=1 / MEASURED[rest])
            errors[k] = np.polyval(beta, PRESSURE[k] / 1e6) - MEASURED[k]
    size = find_size(MEASURED)
    row = find_row(judged, "printed theory × one factor")
    assert row["heldout_nrmse"] == pytest.approx(find_size(factor) / size, rel=1e-9)
    assert row["heldout_worst"] == pytest.approx(np.max(np.abs(factor)) / size, rel=1e-9)
    for degree, label in ((1, "straight line"), (2, "parabola"), (3, "cubic")):
        assert find_row(judged, label)["heldout_nrmse"] == pytest.approx(find_size(curves[degree]) / size, rel=1e-6)


@pytest.mark.study
def test_errors_of_our_model(written):
    """The fits of Figure 8 and of Table 3, whose row without gas has no force, against SciPy's impacts."""
    figure, table = written[2]["figure-8"], written[2]["table-3"]
    own = {name: figure["parameters"][name]["estimate"] for name in ("effective_mass", "restitution")}
    peaks = np.array([integrate_peak(own["effective_mass"], own["restitution"], p)[0] for p in FIGURE_PRESSURE])
    assert figure["steps"][0]["nrmse"] == pytest.approx(find_size(peaks - FIGURE) / find_size(FIGURE), rel=1e-3)
    row = find_row(table, "model paper")
    assert row["heldout_worst"] == pytest.approx(MEASURED[0] / find_size(MEASURED), rel=1e-6)


@pytest.mark.study
def test_verdicts_are_those_of_discover(written):
    for name, verdicts in (("figure-8", {"undecided"}), ("table-3", {"improved", "unexplained"}),
                           ("table-4", {"undecided"})):
        found, told = discover(find_data() / "paper" / name), written[2][name]
        assert told["verdict"] == found.verdict and found.verdict in verdicts
        assert told["effects"] == list(found.effects) and told["sentence"] == found.sentence
        final = told["models"][-1] if name == "table-3" else find_row(told, "model paper")
        assert final["heldout_nrmse"] == pytest.approx(found.steps[-1].heldout_nrmse, rel=1e-4)
    table = written[2]["table-3"]
    low = find_row(table, "low polynomial")["heldout_nrmse"]
    singles = [one for one in table["candidates"] if not one["beyond"]]
    assert len(singles) >= 10 and all(one["heldout_nrmse"] > 1.5 * low for one in singles)


@pytest.mark.study
def test_page_and_figures(written):
    page, told, _ = written
    text = page.read_text(encoding="utf-8")
    assert page.name == "report.html" and "http://" not in text.replace("http://www.w3.org", "")
    pictures = list((page.parent / "figures").glob("*.png"))
    assert len(pictures) == 37 and all(picture.stat().st_size > 5000 for picture in pictures)
    assert any("Table 3:" in line for line in told) and any("Table 4:" in line for line in told)
    assert {"figure-11", "figure-12", "figure-14", "figure-16", "figure-17"} <= {picture.stem for picture in pictures}
    assert "is not printed" in text and "is an assumption" in text
    assert "no force at all" in text and "39.8" in text and "Read as gauge pressures" in text


@pytest.mark.study
def test_friction_in_the_page(written):
    table = written[2]["table-4"]
    assert table["family"] == "slip" and table["friction_over_load"]["mean"] == pytest.approx(0.218, abs=5e-4)
    assert table["band"]["rows"] == [7, 8] and table["band"]["constant"]["p_value"] > 0.05


def test_peaks_against_scipy():
    space = ParameterSpace(Ball(), (ViscousDashpot,))
    places = np.array([space.coordinates({"effective_mass": m, "viscous-dashpot.c_v": c})
                       for m, c in ((1.3, 0.0), (2.0, 60.0)) for _ in range(2)])
    conditions = {"initial_pressure": np.tile([0.25e6, 2.5e6], 2), "approach_speed": np.full(4, 0.4)}
    expected = [integrate_peak(m, 0.7, p, c)[0] for m, c in ((1.3, 0.0), (2.0, 60.0)) for p in (0.25e6, 2.5e6)]
    np.testing.assert_allclose(compute_peaks(space, places, conditions), expected, rtol=2e-4)


def test_peak_is_refined():
    times = np.linspace(0, 1, 64) ** 2
    np.testing.assert_allclose(refine_peak(times, np.sin(np.pi * times)), 1.0, rtol=1e-5)
    assert float(refine_peak(times, 1.0 - times)) == 1.0


def test_models_by_name(tmp_path):
    at = {name: float(normal_force(resolve_model(name).reference, 5e-3, initial_pressure=1e6))
          for name in MODELS if name != "power-law"}
    assert at["paper"] == at["paper-eq6"] == at["paper-eq5-sign"] == pytest.approx(46.0, abs=0.05)
    assert at["paper-doubled-core"] == pytest.approx(45.0, abs=0.05)
    assert at["paper-printed"] == pytest.approx(4.6, abs=0.05)
    assert at["paper-quarter"] == pytest.approx(5.7, abs=0.05)
    # Eq. 1: P pi (2 R delta - delta^2).
    assert at["matunaga"] == pytest.approx(1e6 * np.pi * (0.06 * 5e-3 - 25e-6), rel=1e-9)
    file = tmp_path / "mine.py"
    file.write_text("from ddetumble.contact.law import Ball, ContactLaw\nfrom ddetumble.effects import IMPACT\n"
                    "mine = Ball(outer_diameter=0.05)\nlaw = ContactLaw(Ball(), (IMPACT[0](),))\nother = 3\n")
    assert isinstance(resolve_model(f"{file}:mine").reference, Ball)
    assert resolve_model(f"{file}:Ball").text
    assert len(resolve_model(f"{file}:law").effects) == 1
    for bad, words in (("papr", "did you mean"), (f"{file}", "NAME"), (f"{file}:none", "no 'none'"),
                       (f"{file}:other", "not a reference model"), (f"{tmp_path}/absent.py:x", "cannot be read")):
        with pytest.raises(InputError, match=words):
            resolve_model(bad)
    file.write_text("this is no Python")
    with pytest.raises(InputError, match="cannot be run"):
        resolve_model(f"{file}:mine")
