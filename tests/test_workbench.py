"""The workbench: its logic as values, its Python lines run as they stand, and its page in a browser."""

import dataclasses as dc
import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.workbench import bench as wb


ROOT = Path(__file__).resolve().parent.parent
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
HOSTILE = "<img src=x onerror=document.body.dataset.taken=1>"


def run(code):
    """Run lines as they stand; returns what they defined."""
    names = {}
    exec(compile(code, "lines", "exec"), names)
    return names


def control(name="wall-stiffness.k_w", value=0.0, fitted=True, usual=True, **about):
    declared = dd.effects.Parameter(name, name, "N/m", 0.0, **about)
    return wb.Control(name, declared, value, 0.0, 1.0, fitted, usual, value)


def test_controls_say_what_was_moved():
    """What stands where the step left it, exactly or as it is shown, was not moved."""
    one, other = control(value=1.23456789), control("restitution", 0.7, kind="reference")
    assert one.slides and not other.slides
    asked = wb.choose([one, other], ["a"], {one.name: one.shown, other.name: 0.6}, {other.name: False})
    assert asked == wb.Choice(("a",), {"restitution": 0.6}, frozenset({"restitution"}))
    assert wb.choose([one, other], [], {one.name: None}, {}) == wb.Choice()


@pytest.mark.parametrize(("high", "step"), [(171000.0, 500.0), (1.0, 0.005), (3.7e-5, 1e-7), (0.0, 1.0)])
def test_a_value_shown_is_the_value_used(high, step):
    """Positions are told apart by what is shown, and what is taken of each reads as it is shown."""
    one = dc.replace(control(value=0.5 * high), high=high)
    assert one.step == pytest.approx(step, rel=1e-12)
    positions = [k * one.step for k in range(201)]
    assert len({one.tell(place) for place in positions}) == 201
    for place in (*positions, 1234.56789, 85850.4321):
        told = one.tell(place)
        taken = wb.choose([one], [], {one.name: place}, {}).moved.get(one.name, one.shown)
        assert told == f"{one.name} = {np.format_float_positional(taken, trim='-')} N/m"
        assert float(told.split()[2]) == taken


@pytest.mark.parametrize("family", ["impact", "slip", "oblique", "tumble"])
def test_sliders_reach_from_nothing_to_plain_to_see(family):
    """The ends hold the null and every start that physics allows, and no side that it does not; an estimate, too."""
    for effect in dd.effects.catalogue(family):
        for one in dd.effects.parameters_of(effect):
            if one.kind != "amplitude":
                continue
            low, high = wb._find_range(one, one.default)
            assert low <= one.default <= high and low < high
            assert one.sign == 0 or (low if one.sign > 0 else high) == one.default
            assert all(low <= start <= high for start in one.starts)
            far = one.default + 10 * (high - one.default)
            assert wb._find_range(one, far)[1] >= float(f"{far:.6g}")  # where it is shown


def test_parts_are_replaced_by_the_expression_that_is_told():
    """Values of a model and of its parts, to the last digit."""
    law = dd.contact.Striker(dd.Ball(), dd.CoulombFriction())
    values = {"ball.effective_mass": 1.0 / 3.0, "rolling_mass": 0.4}
    made, told = wb._replace(law, "law", values)
    again = run(f"import dataclasses\nimport ddetumble as dd\n"
                f"law = dd.contact.Striker(dd.Ball(), dd.CoulombFriction())\nmade = {told}")["made"]
    assert float(made.ball.effective_mass) == float(again.ball.effective_mass) == 1.0 / 3.0
    assert float(made.rolling_mass) == float(again.rolling_mass) == 0.4
    assert wb._replace(law, "law", {}) == (law, "law")
    assert run(f"x = {wb._write_number(float('inf'))}")["x"] == float("inf")


def test_there_is_no_step_before_the_first():
    empty = wb.Bench("slip-a", dd.read_campaign("slip-a"))
    for number in (0, 1):
        with pytest.raises(dd.InputError, match="no step"):
            empty.go_back(number)


@pytest.mark.parametrize("arguments", [["no-such-campaign"], ["slip-a", "-m", "no-such-model"]])
def test_command_refuses(arguments, capsys, monkeypatch):
    """An unknown campaign or model is one sentence, before any page is opened."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    assert main(["workbench", *arguments, "--no-browser"]) == 2
    told = capsys.readouterr()
    assert "no-such" in told.err and "Traceback" not in told.err and not told.out


def test_command_refuses_a_taken_port(capsys, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["workbench", "slip-a", "--port", str(taken.getsockname()[1])]) == 2
    assert "--port" in capsys.readouterr().err


def test_command_names_the_extra(capsys, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["workbench", "slip-a"]) == 2
    assert "ddetumble[workbench]" in capsys.readouterr().err


@pytest.fixture(scope="module")
def opened():
    return wb.open_bench("slip-a")


@pytest.fixture(scope="module")
def grown(opened):
    """After a fit with one parameter held and one freed, and a discovery from the first step."""
    controls = wb.list_controls(opened, ["stribeck"])
    asked = wb.choose(controls, ["stribeck"], {"loss_factor": 0.2}, {"loss_factor": False, "poisson_ratio": True})
    return wb.discover(wb.fit(opened, asked).go_back(1))


@pytest.mark.slow
def test_at_rest_there_is_nothing_to_compute(opened):
    assert wb.simulate(opened, wb.choose(wb.list_controls(opened, []), [], {}, {})) is None
    controls = wb.list_controls(opened, ["stribeck"])  # stands at its null, where it does nothing
    assert wb.simulate(opened, wb.choose(controls, ["stribeck"], {}, {})) is None


@pytest.mark.slow
def test_a_slider_moved_is_the_exact_model(opened, grown):
    """The error is that of the model with these values, from a step without effects and from one with an effect."""
    for bench, effects, values in (
            (opened, ["viscous-friction"], {"viscous-friction.c_t": 1.5, "loss_factor": 0.16}),
            (grown.go_back(2), ["stribeck", "viscous-friction"], {"stribeck.A": 0.1, "viscous-friction.c_t": 0.5})):
        controls = wb.list_controls(bench, effects)
        done = wb.simulate(bench, wb.choose(controls, effects, values, {}))
        assert done is not None and done.result.nrmse != pytest.approx(bench.step.errors.nrmse, rel=1e-3)
        names = run(done.code)
        assert names["trial"].nrmse == pytest.approx(done.result.nrmse, rel=1e-9)
        law = names["law"]
        assert [effect.id for effect in law.effects] == effects
        assert float(law.effects[-1].c_t) == values["viscous-friction.c_t"]
        # Without the effect of the step, what is left is the reference model where its fit left it.
        kept = float(bench.step.law.reference.loss_factor)
        assert float(law.reference.loss_factor) == values.get("loss_factor", kept)


@pytest.mark.slow
def test_what_is_held_is_held_and_what_is_freed_is_fitted(opened, grown):
    step = grown.steps[1]
    assert step.fit.fixed["loss_factor"] == 0.2 and "poisson_ratio" in step.fit.parameters
    assert step.effects == ("stribeck",) and "stribeck.A" in step.fit.parameters
    again = {one.name: one for one in wb.list_controls(grown.go_back(2), ["stribeck"])}
    assert not again["loss_factor"].fitted and again["loss_factor"].value == pytest.approx(0.2)
    assert again["stribeck.A"].shown == pytest.approx(step.fit.parameters["stribeck.A"].estimate, rel=1e-5)
    dropped = {one.name for one in wb.list_controls(grown.go_back(2), [])}
    assert not any(name.startswith("stribeck") for name in dropped)
    with pytest.raises(dd.InputError, match="nothing is left"):
        wb.fit(opened, wb.Choice(held=frozenset(one.name for one in wb.list_controls(opened, []))))


@pytest.mark.study
def test_the_ledger_grows_and_its_lines_make_it_again(grown):
    """Every step keeps its errors; the script gives the same ones."""
    assert grown.current == 3 and grown.step.found is not None
    assert grown.go_back(1).step is grown.steps[0] and len(grown.go_back(1).steps) == 3
    rows = wb.list_errors(grown)
    assert [row["step"] for row in rows] == [1, 2, 3]
    assert rows[0]["misfit left"] == "yes" and rows[2]["fitted [%]"] < rows[0]["fitted [%]"]
    names = run(wb.write_script(grown))
    for step in grown.steps:
        again = dd.compare(names["campaign"], names[f"step_{step.number}"])
        assert again.nrmse == pytest.approx(step.errors.nrmse, rel=1e-6)
        assert again.heldout_nrmse == pytest.approx(step.errors.heldout_nrmse, rel=1e-6)
        assert dict(again.parameters).keys() == dict(step.errors.parameters).keys()
    assert names["found_3"].effects == grown.step.found.effects == grown.step.effects
    assert run(wb.write_step(grown.go_back(2)))["step_2"].chi2 == pytest.approx(grown.steps[1].fit.chi2, rel=1e-9)


@pytest.mark.slow
def test_results_are_saved_whole_or_not_at_all(grown, tmp_path, monkeypatch):
    folder = tmp_path / "new" / "results"
    done = wb.save(grown, str(folder))
    assert done.result == folder and [path.name for path in folder.parent.iterdir()] == ["results"]
    held = {path.name for path in folder.iterdir()}
    assert {"model.json", "result.json", "report.html", "compare.json", "comparison.html", "steps.py"} <= held
    assert tuple(dd.load(folder).effects) == grown.step.effects
    rows = json.loads((folder / "compare.json").read_text(encoding="utf-8"))["models"]
    assert [row["nrmse"] for row in rows] == pytest.approx([step.errors.nrmse for step in grown.steps], rel=1e-6)
    with pytest.raises(dd.InputError, match="taken"):
        wb.save(grown, str(folder))
    monkeypatch.setattr(dd, "report", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(dd.InputError, match="no space"):
        wb.save(grown.go_back(1), str(tmp_path / "full"))
    assert not (tmp_path / "full").exists() and [path.name for path in tmp_path.iterdir()] == ["new"]


@pytest.mark.study
def test_what_comes_next_is_told_with_its_lines(grown):
    """The next test apart from an earlier step, and the force that is still missing."""
    done = wb.design(grown, 1)
    assert run(done.code)["test"].rivals == done.result.rivals and len(done.result.rivals) == 2
    found = wb.draw_missing(grown)
    assert run(found.code)["missing"].reference == pytest.approx(found.result.reference, rel=1e-6)


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of a campaign whose texts are HTML, in a browser."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    pytest.importorskip("marimo", reason="marimo is not installed")
    if BROWSER is None:
        pytest.skip("no Chromium here to open the page with")
    folder = tmp_path_factory.mktemp("workbench")
    shutil.copytree(dd.find_data() / "slip-a", folder / "rubbed")
    descriptor = folder / "rubbed" / "datapackage.json"
    content = json.loads(descriptor.read_text(encoding="utf-8"))
    descriptor.write_text(json.dumps(content | {"title": HOSTILE}), encoding="utf-8")
    for path in (folder / "rubbed").glob("*.csv"):
        path.write_text(path.read_text(encoding="utf-8").replace("r01", HOSTILE), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    server = subprocess.Popen(
        [sys.executable, "-m", "ddetumble", "workbench", "rubbed", "--no-browser"], cwd=folder, env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True)
    try:
        lines = []
        for line in server.stdout:
            lines.append(line)
            if address := re.search(r"http://\S+access_token=\S+", line):
                break
        else:
            pytest.fail("".join(lines))
        with api.sync_playwright() as play:
            browser = play.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
            tab = browser.new_page(viewport={"width": 1280, "height": 2400})
            tab.set_default_timeout(120_000)
            tab.goto(address[0])
            yield tab, folder
            browser.close()
    finally:
        os.killpg(server.pid, signal.SIGINT)
        server.communicate(timeout=60)


@pytest.mark.slow
def test_the_page_does_what_its_lines_say(page, monkeypatch):
    """A slider moved, a fit run, the ledger one row longer; the lines shown give the numbers shown."""
    tab, folder = page
    monkeypatch.chdir(folder)
    tab.get_by_role("heading", name="Go on from this step").wait_for()
    assert tab.locator("p", has_text=HOSTILE).count() >= 1
    assert tab.get_by_label("Record").input_value() == HOSTILE
    tab.get_by_text("Select...").first.click()
    tab.get_by_role("option", name="stribeck").click()
    tab.keyboard.press("Escape")
    slider = tab.get_by_role("slider").first
    slider.focus()
    slider.press("PageUp")
    moved = tab.locator("pre", has_text="trial = ")
    moved.wait_for()
    told = tab.get_by_text("Where the controls stand: error")
    told.wait_for()
    shown = float(re.search(r"error ([\d.]+) %", told.inner_text())[1])
    trial = run(moved.inner_text())["trial"]
    assert 100 * trial.nrmse == pytest.approx(shown, abs=0.006) and trial.effects == ("stribeck",)
    tab.get_by_role("button", name="Fit", exact=True).click()
    fitted = tab.locator("pre", has_text="print(dd.compare(campaign, step_2))")
    fitted.wait_for()
    tab.locator("marimo-table").get_by_text("fitted paper + stribeck").wait_for()
    step = run(fitted.inner_text())["step_2"]
    shown = float(re.search(r"This step: error ([\d.]+) %", tab.get_by_text("This step: error").inner_text())[1])
    assert 100 * dd.compare(dd.read_campaign("rubbed"), step).nrmse == pytest.approx(shown, abs=0.006)
    # Back to the first step, and nothing of the campaign's texts was taken for HTML meanwhile.
    tab.get_by_label("Look at, and go on from, step").select_option(index=0)
    tab.locator("pre", has_text="print(dd.compare(campaign, step_1))").wait_for()
    assert tab.evaluate("document.body.dataset.taken") is None
    # On a telephone nothing sticks out, and of each pair of pictures the narrow one has the room.
    for width in (1280, 400):
        tab.set_viewport_size({"width": width, "height": 2400})
        pair = tab.get_by_alt_text("Error by step")
        shown = [box["width"] for box in (one.bounding_box() for one in pair.all()) if box]
        assert sorted(size > 300 for size in shown) == [False, True] and (shown[1] > 300) == (width == 400)
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
