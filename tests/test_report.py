"""Figures and reports: every verdict gives a page that says so first, stands alone, and escapes what data files say."""

import base64
import contextlib
import dataclasses as dc
import gc
import math
import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from ddetumble import figures
from ddetumble._errors import InputError
from ddetumble.figures.traces import (
    are_values,
    bin_residuals,
    choose_records,
    find_phase,
    find_strokes,
    group_values,
    share_span,
    sort_traces,
)
from ddetumble.measurement.quantities import (
    describe_conditions,
    describe_quantity,
    format_number,
    format_p,
    format_value,
)
from ddetumble.reports import Picture, Section, Table, report, write_page, write_report
from ddetumble.reports.findings import _show_judgement, _show_next, _show_ranking, show_errors, show_failures, show_fits
from ddetumble.selection.result import Place, Trace
from ddetumble.selection.text import align, choose_view, describe_place, say_places
from tests.helpers_report import (
    STROKES,
    make_candidates,
    make_discovery,
    make_friction_peaks,
    make_peaks,
    make_slip_discovery,
)


LONGEST = 240  # characters of a headline that still reads as one or two short sentences
VERDICTS = ("nothing-missing", "explained", "improved", "unexplained", "undecided")
VOID = {"meta", "img", "br", "hr", "link", "input", "source"}


class Page(HTMLParser):
    """Reads a page: its visible text, its images, its links; fails where tags do not close."""

    def __init__(self, html):
        super().__init__()
        self.open, self.text, self.images, self.links, self.tags = [], [], [], [], []
        self.headline = ""
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        attributes = dict(attrs)
        self.links += [attributes[key] for key in ("href", "src", "srcset", "action") if key in attributes]
        if tag == "img":
            self.images.append(attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "body" in self.open and data.strip():
            self.text.append(" ".join(data.split()))
            if self.open[-1] == "h1":
                self.headline = self.text[-1]


def draw_steps(discovery):
    """The error by step of a discovery."""
    return figures.draw_error_by_step(discovery)


def read_image(data):
    """Pixels of a PNG file."""
    import io

    import matplotlib.image

    return matplotlib.image.imread(io.BytesIO(data), format="png")


def check_sentence(page, sentence):
    """The sentence comes first: its beginning as a short headline, the rest, if any, below."""
    assert len(page.headline) <= LONGEST and page.text[0] == page.headline
    said = sentence.split()
    shown = " ".join(page.text[: 1 + (len(page.headline) < len(sentence) - 1)]).split()
    assert [word.strip(".:;").lower() for word in said] == [word.strip(".:;").lower() for word in shown]


def check_page(path, sentence):
    html = path.read_text(encoding="utf-8")
    page = Page(html)
    check_sentence(page, sentence)
    assert len(html.encode()) < 3_000_000
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in page.links)
    bare = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)  # chance writes any four letters into a megabyte of pixels
    assert "http" not in bare and "//" not in bare and "@import" not in bare
    pictures = sorted((path.parent / "figures").iterdir())
    assert len(page.images) == len(pictures) > 0
    assert all(len(image["alt"]) > 20 for image in page.images)
    for picture in pictures:
        pixels = read_image(picture.read_bytes())
        assert pixels.shape[1] > 800 and pixels[..., :3].std() > 0.02, picture.name
    for image in page.images:
        assert read_image(base64.b64decode(image["src"].partition("base64,")[2])).shape[1] > 300
    assert not [item for item in path.parent.rglob("*") if item.name.startswith(".")]
    return page


@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_of_every_verdict(verdict, tmp_path):
    """One of them of a campaign with three channels."""
    discovery = make_discovery(verdict, "impact-e" if verdict == "explained" else None)
    first, *others = discovery.candidates
    units = {name: "N/m" for name in first.smallest_detectable}
    discovery = dc.replace(discovery, candidates=(dc.replace(first, units=units), *others))
    path = write_report(discovery, tmp_path / "out")
    assert path == tmp_path / "out" / "report.html"
    page = check_page(path, discovery.sentence)
    text = " ".join(page.text)
    for word in (discovery.campaign, discovery.sha256, *discovery.effects, *discovery.notes, "effective_mass",
                 "k 12.5 N/m"):
        assert word in text
    names = {item.stem for item in (tmp_path / "out" / "figures").iterdir()}
    assert names >= {f"fit-{trace.channel}" for trace in discovery.steps[0].traces}
    for step in discovery.steps:
        for item in step.alternatives:
            assert item["effect"] in text and "Confusion sets" in text
    lines = str(discovery).splitlines()
    assert " ".join(str(discovery).split()).startswith(discovery.sentence)
    assert max(map(len, lines)) <= 100
    assert any("effective_mass" in line and "+-" in line and line.rstrip().endswith("kg") for line in lines)


def test_candidates_that_are_not_shown_are_counted():
    """The terminal lists what explains something, and says how many more there are."""
    discovery = make_discovery("explained")
    lines = str(discovery).splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("  candidate")) + 2
    shown = [one for i, one in enumerate(discovery.candidates) if i < 5 or one.explains >= 0.05]
    assert [line.split()[line.startswith("* ")] for line in lines[start : start + len(shown)]] == [
        one.effect for one in shown]  # fmt: skip
    rest = len(discovery.candidates) - len(shown)
    assert rest and lines[start + len(shown)].startswith(f"  and {rest} more that explain ")
    few = dc.replace(discovery, candidates=discovery.candidates[:5])
    assert "more that explain" not in str(few)
    one_more = str(dc.replace(discovery, candidates=discovery.candidates[: len(shown) + 1]))
    assert "more that explain" not in one_more and discovery.candidates[len(shown)].effect in one_more
    idle = tuple(dc.replace(one, explains=0.0) for one in discovery.candidates)
    assert "that explain nothing: " in str(dc.replace(discovery, candidates=idle))


def test_a_search_that_was_cut_short_goes_on():
    """What comes first is the search with twice as many rounds, ten at least; no other verdict names rounds."""
    def list_advice(found):
        return _show_next(found).points

    counts = make_discovery("undecided").counts
    for rounds, more in ((1, 10), (12, 24)):
        found = make_discovery("undecided", reason="effort", unsearched=("a search",), model="none",
                               counts={**counts, "rounds": rounds})
        assert found.more_effort == more and f"-m none --effort {more} " in list_advice(found)[0]
        assert any("ddetumble design" in one for one in list_advice(found)[1:])
    for verdict in ("undecided", "explained", "improved"):
        other = make_discovery(verdict)
        assert other.more_effort is None and not any("--effort" in one for one in list_advice(other))


def test_peaks_only(tmp_path):
    discovery = make_peaks()
    assert are_values(discovery.steps[0].traces)
    path = write_report(discovery, tmp_path)
    check_page(path, discovery.sentence)
    bare = dc.replace(discovery.steps[0], traces=())
    page = check_page(write_report(dc.replace(discovery, steps=(bare,)), tmp_path / "bare"), discovery.sentence)
    assert "ranked" in " ".join(page.text)


@pytest.mark.slow
def test_text_from_data_files_is_escaped(tmp_path):
    evil = "<script>alert('x')</script>$\\frac{1}$ & \x1b[31m\u4e2d"
    discovery = make_discovery("explained")
    renamed = {}

    def rename(trace):
        renamed.setdefault(trace.record, f"{evil}{trace.record}")
        conditions = trace.conditions | {"<b>pad</b> $x$": float(len(renamed))}
        return dc.replace(trace, record=renamed[trace.record], conditions=conditions)

    steps = tuple(dc.replace(step, traces=tuple(map(rename, step.traces))) for step in discovery.steps)
    discovery = dc.replace(
        discovery, campaign=evil, title=evil, model=evil, sentence=f"Missing: {evil}", notes=(evil,), steps=steps,
        counts={evil: {evil: evil}}, noise={"normal_force": {"sd": 0.25, "text": evil}},
    )  # fmt: skip
    html = write_report(discovery, tmp_path).read_text(encoding="utf-8")
    page = Page(html)
    assert "script" not in page.tags and "b" not in page.tags
    assert "<script" not in html and "&lt;script&gt;" in html
    assert "\x1b" not in str(discovery)


@pytest.mark.slow
def test_figures_without_numbers(tmp_path):
    nan = math.nan
    discovery = make_discovery("unexplained")
    traces = tuple(
        dc.replace(trace, measured=np.full_like(trace.measured, nan), conditions={"pad_thickness": 0.002})
        for trace in discovery.steps[0].traces[:3]
    )  # fmt: skip
    fit = dc.replace(discovery.steps[0].lack_of_fit, statistic=nan, p_value=nan, score_p_value=nan)
    step = dc.replace(discovery.steps[0], traces=traces, nrmse=nan, heldout_nrmse=nan, chi2_reduced=nan, parameters={},
                      correlations=(), lack_of_fit=fit, converged=False)
    empty = dc.replace(discovery, steps=(step, dc.replace(step, added="gas-leak")), candidates=(), noise={}, where=(),
                       noise_nrmse=nan)
    check_page(write_report(empty, tmp_path / "nan"), discovery.sentence)
    nothing = dc.replace(empty, steps=())
    page = Page(write_report(nothing, tmp_path / "nothing").read_text(encoding="utf-8"))
    check_sentence(page, discovery.sentence)
    assert str(nothing)


@pytest.mark.slow
def test_many_and_few_records():
    own = make_discovery("explained").steps[0].traces
    many = [dc.replace(trace, record=f"{trace.record}-{i}") for i in range(4) for trace in own]
    for traces in (many, own[:1], own[:5]):
        for draw in (figures.draw_fit, figures.draw_residual_map, figures.draw_dependence, figures.draw_missing_force,
                     figures.draw_record_errors):
            assert len(figures.render_png(draw({"model": traces}), 60)) > 3000


def test_ledger_on_a_long_scale():
    discovery = dc.replace(make_discovery("explained"), noise_nrmse=1e-4)
    axes = draw_steps(discovery).axes[0]
    assert axes.get_xscale() == "log"


def test_ranking_greys_what_cannot_be_seen():
    axes = figures.draw_ranking(make_candidates(("adhesion",)), ("adhesion",)).axes[0]
    labels = {label.get_text(): label for label in axes.get_yticklabels()}
    assert labels["adhesion"].get_fontweight() == "bold"
    assert labels["sensor-lag"].get_color() != labels["gas-leak"].get_color()
    assert sum(text.get_text() == "undetectable" for text in axes.texts) == 2


def test_settings_of_the_user_stay():
    import matplotlib

    before = dict(matplotlib.rcParams)
    figures.render_png(draw_steps(make_discovery("explained")))
    assert dict(matplotlib.rcParams) == before


def test_same_input_same_bytes():
    discovery = make_discovery("nothing-missing")
    for draw in (draw_steps, lambda one: figures.draw_residual_map({"model": one.steps[0].traces})):
        one, other = (figures.render_png(draw(discovery)) for _ in "ab")
        assert one == other


@figures.styled
def draw_line(end=0.0):
    figure = figures.new_figure(2.0, 4.0)
    figure.add_subplot().plot([0, 1], [1, end])
    return figure


def test_generic_page(tmp_path):
    table = pd.DataFrame({"claim": ["a <b>", "c"], "paper": [1.5, np.nan]})
    sections = [
        Section("One", ["Text & more."], [("line", "A falling line, drawn twice.", draw_line())], [table]),
        Section("Two", [], [Picture("other", "Caption", draw_line(), "A line that falls from one to zero.")],
                [[("x", "y"), (1, 2.0)], Table(("x",), [], "empty")], ["a point"]),
    ]  # fmt: skip
    path = write_page("Title", "It falls.", sections, tmp_path, "paper.html", facts=[("a", "1", "")])
    page = Page(path.read_text(encoding="utf-8"))
    assert path.name == "paper.html" and page.text[0] == "It falls."
    assert {"a <b>", "–", "1.5", "A point"} <= set(page.text) and page.images[1]["alt"].startswith("A line that")
    # Two figures of one name are each in the page; a row may lack its last cells, and a table be any rows.
    same = [Picture("one", "A falling line.", draw_line()), Picture("one", "Half of it.", draw_line(0.5))]
    table = (("x", "y"), (1, 2.5), (3,))
    page = Page(write_page("t", "s", [Section("x", figures=same, tables=[table])], tmp_path).read_text())
    assert page.images[0]["src"] != page.images[1]["src"] and {"2.5", "3"} <= set(page.text)
    with pytest.raises(ValueError, match="no name for a file"):
        write_page("t", "s", [Section("x", figures=[("../up", "c", draw_line())])], tmp_path)


def test_garbage_is_collected_after_a_page(tmp_path):
    for name, fails in (("line", False), ("../up", True)):
        with pytest.raises(ValueError) if fails else contextlib.nullcontext():
            write_page("t", "s", [Section("x", figures=[(name, "c", draw_line())])], tmp_path)
        assert gc.isenabled()
    gc.disable()
    try:
        write_page("t", "s", [Section("x")], tmp_path)
        assert not gc.isenabled()  # by the user
    finally:
        gc.enable()


def write_traces(traces, folder):
    """A page of one model without a verdict, as fits and comparisons have it."""
    sections = [show_fits({"paper": traces}), show_failures({"paper": traces})]
    return write_page("Model", "The model misses.", sections, folder, status=["campaign impact-f"])


@pytest.mark.slow
def test_comparison(tmp_path):
    step = make_discovery("unexplained").steps[0]
    check_page(write_traces(step.traces, tmp_path), "The model misses.")


def test_commands_are_code_and_html_passes(tmp_path):
    import markupsafe

    texts = ["`ddetumble fit -o <DIR>` fits -1.5 N; k_e is the name of a parameter.", "k_e = 2",
             markupsafe.Markup("<p><i>x</i></p>"), "one ` alone <b>", "each of 3 samples",
             "F_n = F_k over I_t, file F_n.csv, A_b_c and `F_n`"]
    html = write_page("t", "s", [Section("x", texts)], tmp_path).read_text(encoding="utf-8")
    shown = [html.partition("<section")[2].split("<p>")[i].partition("</p>")[0] for i in range(1, 7)]
    assert shown[0].startswith("<code>ddetumble fit -o &lt;DIR&gt;</code> fits −1.5\u00a0N")
    assert shown[1:] == ["k_e = 2", "<i>x</i>", "One ` alone &lt;b&gt;", "Each of 3 samples",
                         "F<sub>n</sub> = F<sub>k</sub> over I<sub>t</sub>, file F_n.csv, A_b_c and <code>F_n</code>"]


def test_columns_have_the_width_of_their_words(tmp_path):
    rows = [("a", "0.123, 0.456, 0.789", "a sentence that would make a row high", "x" * 64, "1.5", 30.8),
            ("b", "none", "short", "y", "2.2 % (step 2)", 4.25)]  # fmt: skip
    html = write_page("t", "s", [Section("x", tables=[Table(tuple("uvwxyz"), rows, "Caption.")])], tmp_path).read_text()
    kinds = re.findall(r'<th scope="col" class="([a-z ]+)"', html)
    assert kinds == ["brief", "phrase", "prose", "prose wild", "right", "right"]
    assert ">30.80<" in html and 'aria-labelledby="table-1-1"' in html


def test_pages_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = write_page("t", "First.", [], tmp_path)
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(InputError, match="No space left"):
        write_page("t", "Second.", [], tmp_path)
    assert "First." in path.read_text() and [item.name for item in tmp_path.iterdir() if item.is_file()] == [path.name]
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_page("t", "s", [], tmp_path / "file")


def test_budget_shrinks_large_pages(tmp_path, monkeypatch):
    monkeypatch.setattr("ddetumble.reports.page.BUDGET", 20_000)
    path = write_page("t", "s", [Section("x", figures=[(n, "caption", draw_line()) for n in "ab"])], tmp_path)
    whole = sum(item.stat().st_size for item in (tmp_path / "figures").iterdir()) * 4 / 3
    assert len(path.read_text()) < whole + 15_000


@pytest.mark.parametrize("value, sd, text", [
    (86000.0, 1032.0, "86000"), (1.118, 0.00336, "1.1180"), (0.0, 0.1, "0.00"), (1163.0, 9.0, "1163.0"),
    (-2e-4, 0.02, "0.000"),
    (2.5e8, 1e6, "2.500e+08"), (1.5, math.nan, "1.500"), (math.nan, 1.0, "–"),
])  # fmt: skip
def test_values_have_the_digits_that_count(value, sd, text):
    assert format_value(value, sd) == text


def test_small_words():
    assert [format_number(x) for x in (0.0, 12.345, 1e-9, None, math.inf)] == ["0", "12.3", "1.00e-09", "–", "–"]
    assert [format_p(x) for x in (1e-9, 0.0312, 0.4, math.nan)] == ["< 0.001", "0.031", "0.40", "–"]
    conditions = {"initial_pressure": 1.109e6, "approach_speed": 0.1398, "pad_thickness": 0.002}
    assert describe_conditions(conditions, conditions) == "1.11 MPa · 0.14 m/s · pad thickness 0.002"
    assert align(("a", "b"), [("x", "1")], "lr") == "a  b\n----\nx  1"
    rows = [("+ " + "long-name-of-an-effect, " * 4, *["1234567"] * 7, "last: the misfit"), ("b", *"12345678")]
    lines = align([f"head {k}" for k in range(9)], rows, "l" + "r" * 7 + "l").splitlines()
    assert max(map(len, lines)) <= 100  # a wide table loses nothing: its names go on in further lines
    assert "".join("".join(lines).split()).count("long-name-of-an-effect"[:8]) == 4 and "head 8" in lines[0]
    assert sum(line.endswith(("last: the", "misfit", "last: the misfit")) for line in lines) >= 1


def test_a_place_that_is_the_whole_record_is_no_finding():
    view = dc.replace(choose_view(family="tumble"), longest=600.0)
    whole = Place("angular_velocity_x", "time", (0.0, 550.0), "both", 0.9954)
    assert say_places([whole], view) == []
    others = [dc.replace(whole, share=0.8), dc.replace(whole, range=(0.0, 300.0)), dc.replace(whole, period=20.0),
              dc.replace(whole, removes=0.7)]
    assert len(say_places([whole, *others], view)) == 4


def test_records_without_settings_have_no_words_for_them():
    """Predictions that are the cross-validated errors stand nowhere twice, nor a p-value of shifts that are not."""
    found = make_slip_discovery()
    traces = tuple(dc.replace(trace, conditions={}) for trace in found.steps[0].traces)
    for same in (True, False):
        def predict(one, same=same):
            return dc.replace(one, prediction_nrmse=one.heldout_nrmse * (1.0 if same else 1.2))

        own = dc.replace(found, steps=tuple(dc.replace(predict(step), traces=traces) for step in found.steps),
                         candidates=tuple(map(predict, found.candidates)))
        assert ("predicted" in str(own)) == (not same)
        for section in (show_errors([("a",), ("b",)], own.steps, [0.01] * 2, ("a", "b")), _show_ranking(own)):
            assert any("prediction" in table.header for table in section.tables) == (not same)
        header = _show_judgement(own).tables[0].header
        assert len(header) == 8 and len(header) == len(_show_judgement(own).tables[0].rows[0])


def test_settings_are_grouped_and_spread():
    assert group_values([0.50, 0.505, 1.11, math.nan, 1.10])[:3] == pytest.approx([0.5025, 0.5025, 1.105])
    assert len(set(group_values([293.15, 300.0, 293.2]))) == 2
    assert group_values([-1.0, -1.01, 2.0]) == pytest.approx([-1.005, -1.005, 2.0])
    traces = make_discovery("explained").steps[0].traces
    chosen = choose_records(traces, 8)
    cells = {(round(t.conditions["initial_pressure"], -5), round(t.conditions["approach_speed"], 1)) for t in chosen}
    assert len(chosen) == len(cells) == 8
    pressures = [trace.conditions["initial_pressure"] for trace in sort_traces(traces)]
    assert np.all(np.diff(pressures) > -0.05 * np.array(pressures[1:]))


def test_bands_hold_noise():
    generator = np.random.default_rng(3)
    size, rho = 400, 0.6
    traces = []
    for i in range(60):
        noise = np.zeros(size)
        for k in range(1, size):
            noise[k] = rho * noise[k - 1] + math.sqrt(1 - rho**2) * generator.normal()
        time = np.arange(size) * 1e-3
        traces.append(Trace(f"r{i}", "normal_force", "N", {}, time, noise, 0 * time, 1.0, np.ones(size), np.ones(size)))
    noise = {"correlation": rho, "white_share": 0.0}
    bins = bin_residuals(traces, [trace.time for trace in traces], np.linspace(0, 0.4, 11), noise)
    assert np.mean(np.abs(bins.mean) < 2 * bins.floor) >= 0.8
    assert np.median(bins.error / bins.floor) == pytest.approx(1, abs=0.25)


def list_models(discovery):
    """The models of a discovery by name, as a report draws them."""
    return {"before": discovery.steps[0].traces, "after": discovery.steps[-1].traces}


def list_labels(figure):
    """Labels of the axes below and beside them, in their order."""
    labels = ([getattr(axes, f"get_{side}label")() for axes in figure.axes] for side in "xy")
    return tuple([label for label in own if label] for own in labels)


@pytest.mark.slow
@pytest.mark.parametrize("strokes", [None, STROKES], ids=["over-slip", "strokes"])
def test_page_of_slip_records(strokes, tmp_path):
    discovery = make_slip_discovery(strokes)
    page = check_page(write_report(discovery, tmp_path), discovery.sentence)
    text = " ".join((*page.text, *(image["alt"] for image in page.images), str(discovery)))
    for word in ("depression", "loading", "restitution", "mass", "contact", "touch", "normal force"):
        assert word not in text, word
    assert "left when adhesion constant, loss factor, slip term and the records' settings are free" in text
    assert "1/J" in page.text and "it repeats every 1.80 mm" in text
    assert ("on strokes" in text) == ("strokes forward and backward apart" in text) == bool(strokes)
    names = {item.stem for item in (tmp_path / "figures").iterdir()}
    assert names >= {"fit-tangential_force", "residual-map", "dependence-tangential_force", "missing-force"}


def test_axes_of_slip_records():
    models = list_models(make_slip_discovery())
    across, up = list_labels(figures.draw_fit(models))
    assert set(across) == {"slip [mm]"} and set(up) == {"friction force [N]", "residual\n/ noise"}
    titles = [axes.get_title("left") for axes in figures.draw_fit(models).axes if axes.get_title("left")]
    assert "6.00 N · 0.80 MPa · 0.02 m/s" in titles and len(titles) == 8
    dependence = figures.draw_dependence(models)
    assert list_labels(dependence)[0] == ["slip [mm]", "load [N]", "internal pressure [MPa]", "slip speed [m/s]"]
    assert not any("open" in text.get_text() for text in dependence.legends[0].get_texts())
    missing = figures.draw_missing_force(models)
    assert list_labels(missing) == (["slip [mm]"] * 2, ["measured − model [N]"])
    assert missing.legends[0].get_texts()[0].get_text() == "slip speed 0.02 m/s"  # a Stribeck effect is missing
    ticks = figures.draw_residual_map(models).axes[0].get_xticklabels()
    assert [tick.get_text() for tick in ticks] == ["start", "¼", "½", "¾", "end"]
    errors = figures.draw_record_errors(models).axes[0]
    assert errors.get_xlabel() == "load [N]" and errors.get_ylabel() == "internal pressure [MPa] ·\nslip speed [m/s]"
    assert errors.collections[0].get_array().shape == (4, 3)
    assert [label.get_text() for label in errors.get_yticklabels()][:2] == ["0.80 · 0.02", "0.80 · 0.1"]


def test_axes_of_strokes():
    models = list_models(make_slip_discovery(STROKES))
    assert set(list_labels(figures.draw_fit(models))[0]) == {"time [ms]"}
    slow = [dc.replace(trace, time=10 * trace.time) for trace in models["after"]]
    assert set(list_labels(figures.draw_fit({"model": slow}))[0]) == {"time [s]"}
    dependence = figures.draw_dependence(models)
    assert list_labels(dependence)[0][:3] == ["slip [mm]", "direction of the stroke", "share of the record"]
    assert [text.get_text() for text in dependence.legends[0].get_texts()][2] == "open: backward"
    titles = [axes.get_title("left") for axes in figures.draw_missing_force(models).axes]
    assert titles == ["before: forward", "before: backward", "after: forward", "after: backward"]


def test_parts_of_a_slip_record():
    single, series = (make_slip_discovery(strokes).steps[0].traces[0] for strokes in (None, STROKES))
    assert choose_view([single]).phases == () and choose_view([series]).phases == ("forward", "backward")
    place = describe_place(Place("", "sequence", (1, 9), "", 0.5), choose_view([single]))
    assert (place["variable"], place["span"]) == ("number of the test of the series", "1 to 9")
    assert describe_place(Place("", "sequence", (4, 4), "", 0.5), choose_view([single]))["span"] == "4"
    assert describe_place(Place("", "direction", (-1, 1), "", 0.5), choose_view([series]))["direction"]
    assert choose_view().force == "normal_force" and choose_view(family="slip").force == "tangential_force"
    assert find_phase(single).all() and share_span(single)[[0, -1]] == pytest.approx([0, 1])
    assert [part.stop - part.start for part in find_strokes(series)] == [61, 60, 40, 40]
    forward, backward = (find_phase(series, phase) for phase in ("forward", "backward"))
    assert np.all(forward ^ backward) and forward.sum() == 101
    ahead = dc.replace(series, state_rate=np.abs(series.state_rate))  # every stroke forward
    assert len(find_strokes(ahead)) == 4 and choose_view([ahead]).along == "time"
    assert find_strokes(make_discovery("explained").steps[0].traces[0]) == [slice(None)]


@pytest.mark.slow
def test_friction_peaks(tmp_path):
    discovery = make_friction_peaks()
    check_page(write_report(discovery, tmp_path), discovery.sentence)
    upper, lower = figures.draw_values(list_models(discovery)).axes
    assert upper.get_ylabel() == "peak friction force [N]" and lower.get_xlabel() == "internal pressure [MPa]"
    lines = [line for line in upper.lines if line.get_marker() in "sD"]
    assert len(lines) == 6 and all(np.all(np.diff(line.get_xdata()) > 0) for line in lines)  # one a load and model


def test_comparison_of_slip_records(tmp_path):
    names = ("time", "measured", "model", "state", "state_rate")
    own = make_slip_discovery().steps[0].traces[::4]
    few = [dc.replace(trace, **{name: getattr(trace, name)[::20] for name in names}) for trace in own]
    check_page(write_traces(few, tmp_path / "few"), "The model misses.")
    bare = [dc.replace(trace, conditions={"normal_load": 6.0}, measured=np.nan * trace.measured) for trace in few]
    check_page(write_traces(bare, tmp_path / "bare"), "The model misses.")


@pytest.mark.slow
def test_text_from_slip_data_is_escaped(tmp_path):
    evil, discovery = "<script>x</script>$\\frac{1}$", make_slip_discovery(STROKES)
    steps = [dc.replace(step, traces=tuple(dc.replace(trace, record=evil + trace.record) for trace in step.traces))
             for step in discovery.steps]  # fmt: skip
    discovery = dc.replace(discovery, steps=tuple(steps), model=evil, campaign=evil, notes=(evil,), sentence=evil)
    html = write_report(discovery, tmp_path).read_text(encoding="utf-8")
    assert "script" not in Page(html).tags and "&lt;script&gt;" in html


@pytest.mark.parametrize("name, value, text", [
    ("normal_load", 6.0, "6.00 N"), ("normal_load", 104.4, "104 N"), ("internal_pressure", 8e5, "0.80 MPa"),
    ("internal_pressure", 1e5, "100 kPa"), ("slip_speed", 0.002, "0.002 m/s"), ("time", 0.3, "300 ms"),
    ("time", 3.0, "3 s"), ("slip", 0.0018, "1.8 mm"), ("tangential_force", 2.5, "2.5 N"),
])  # fmt: skip
def test_quantities_in_friendly_units(name, value, text):
    shown = describe_quantity(name, [value])
    assert f"{shown.format(value)} {shown.unit}" == text


def test_a_report_is_a_folder(tmp_path):
    """The name of a file is refused before anything is written, and so is a file that is there."""
    (tmp_path / "there").write_text("")
    for name in ("x.csv", "page.html", "there"):
        with pytest.raises(InputError) as refused:
            report(make_discovery("explained"), tmp_path / name)
        assert refused.value.file is not None
    assert [one.name for one in tmp_path.iterdir()] == ["there"]
    assert report(make_discovery("explained"), tmp_path / "run.1").is_file()
