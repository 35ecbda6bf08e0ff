"""Figures and pages have room for what files bring: long names of records and effects, records of an hour."""

import base64
import dataclasses as dc
import itertools
import struct

import numpy as np
import pytest

from ddetumble import figures
from ddetumble.figures.labels import describe_quantity, shorten_names
from ddetumble.figures.style import apply_style
from ddetumble.figures.views import choose_view
from ddetumble.report import Picture, Section, Table, write_page
from ddetumble.report.page import split_sentence
from ddetumble.report.words import say_place
from ddetumble.selection.result import Place, Trace
from tests.helpers_report import make_candidates, make_slip_discovery


LONG = "with pressure-dependent-restitution, speed-dependent-restitution, viscoelastic-wall and inflation-growth"
SLACK = 1.5  # px by which a glyph may stand over its box


def make_pulses(count=24):
    """Force pulses at four pressures and three speeds, records named as a laboratory names its files."""
    traces, generator = [], np.random.default_rng(1)
    settings = itertools.islice(itertools.cycle(itertools.product((4e5, 8e5, 1.4e6, 2e6), (0.15, 0.35, 0.7))), count)
    for i, (pressure, speed) in enumerate(settings, 1):
        time = np.linspace(0, 0.06, 90)
        force = 100 * speed * np.sin(np.pi * np.clip(time / 0.05, 0, 1))
        depression = 1e-2 * speed * np.sin(np.pi * np.clip(time / 0.05, 0, 1))
        traces.append(Trace(
            f"2026-03-14_ball60_run{i:03d}_p{pressure / 1e6:.1f}MPa_v{speed}", "normal_force", "N",
            {"initial_pressure": pressure, "approach_speed": speed}, time, force + generator.normal(size=time.size),
            force, 1.0, depression, np.gradient(depression, time)))  # fmt: skip
    return tuple(traces)


def make_hour(count=5, hours=1.0, last=""):
    """Rates of a tumbling body for hours, without conditions."""
    time, traces = np.arange(0, 3600 * hours, 10.0), []
    for i, axis in itertools.product(range(count), "xyz"):
        rate = 0.05 * np.cos(time / (80 + i))
        traces.append(Trace(f"2026-03-14_satellite_pass{i:02d}_gyro_1Hz{last}", f"angular_velocity_{axis}", "rad/s", {},
                            time, rate + 2e-5 * np.sin(time), rate, 2e-5, time, np.full(time.size, 0.1), "tumble"))
    return tuple(traces)


def check_layout(figure):
    """Nothing stands out of the canvas, and neither numbers along an axis nor titles touch each other."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with apply_style():
        FigureCanvasAgg(figure).draw()
    width, height = figure.canvas.get_width_height()
    boxes = [("legend", legend.get_window_extent()) for legend in figure.legends]
    titles = []
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high
                     and tick.label1.get_visible() and tick.label1.get_text().strip()]
            own = [(label.get_text(), label.get_window_extent()) for label in ticks]
            check_apart(own)
            boxes += own
            if axis.label.get_text().strip():
                boxes.append((axis.label.get_text(), axis.label.get_window_extent()))
        for text in (axes.title, axes._left_title, axes._right_title, *axes.texts):
            if text.get_text().strip() and text.get_visible():
                boxes.append((text.get_text(), text.get_window_extent()))
                titles += boxes[-1:]
    for above in (False, True):  # names stand in a line above the conditions
        check_apart([one for one in titles if one[0].endswith("\n") == above])
    for text, box in boxes:
        assert box.x0 >= -SLACK and box.y0 >= -SLACK, text
        assert box.x1 <= width + SLACK and box.y1 <= height + SLACK, text


def check_apart(boxes):
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        apart = a.x1 <= b.x0 + SLACK or b.x1 <= a.x0 + SLACK or a.y1 <= b.y0 + SLACK or b.y1 <= a.y0 + SLACK
        assert apart, (one, other)


@pytest.mark.parametrize("make", [make_pulses, make_hour], ids=["impact", "hour"])
def test_long_names_have_room(make):
    traces = make()
    models = {"reference model": traces, LONG: traces}
    channel = traces[0].channel
    place = Place(channel, choose_view(traces).state, tuple(np.quantile(traces[0].state, [0.6, 0.9])), "", 0.63, 1e-3)
    for figure in (
        figures.draw_fit(models, channel), figures.draw_fit(models, channel, count=2, narrow=True),
        figures.draw_record_errors(models), figures.draw_residual_map(models),
        figures.draw_dependence(models, channel, None, (place,)),
    ):  # fmt: skip
        check_layout(figure)


def test_numbers_with_many_digits_have_room():
    time, generator = np.arange(0, 602, 2.0), np.random.default_rng(1)
    traces = []
    for i, rate in enumerate((0.02211, 0.117222, 0.10368, 0.061845)):
        model, noise = np.full(time.size, rate), 2e-5 * generator.normal(size=time.size)
        traces.append(Trace(f"r{i}", "angular_velocity_z", "rad/s", {}, time, model + noise, model, 2e-5, time, model,
                            "tumble"))  # fmt: skip
    check_layout(figures.draw_fit({"reference model": traces}, "angular_velocity_z", 4))


def test_many_records_without_conditions_have_room():
    check_layout(figures.draw_record_errors({"reference model": make_hour(60), LONG: make_hour(60)}))


@pytest.mark.parametrize("narrow", [False, True])
def test_findings_have_room(narrow):
    found = make_slip_discovery()
    last = dc.replace(found.steps[-1], added="x", effects=("pressure-dependent-restitution", "viscoelastic-wall", "x"))
    found = dc.replace(found, steps=(found.steps[0], last))
    check_layout(figures.draw_ledger(found, narrow=narrow))
    check_layout(figures.draw_ranking(make_candidates(("adhesion",)), ("adhesion",), narrow=narrow))
    if not narrow:
        check_layout(figures.draw_parameters({"reference model": found.steps[0], LONG: last}))


def test_names_are_short_and_distinct():
    names = [trace.record for trace in make_pulses()]
    short = shorten_names(names, 18)
    assert len(set(short.values())) == len(names) and max(map(len, short.values())) <= 18
    assert all(f"run{i:03d}" in short[name] for i, name in enumerate(names, 1))
    assert shorten_names([*names, "b"], 18) == {**short, "b": "b"}
    alike = [f"{'a' * 40}{i}{'b' * 40}" for i in range(12)]
    assert len(set(shorten_names(alike, 12).values())) == 12 >= max(map(len, shorten_names(alike, 12).values()))
    assert shorten_names(["r1", "r2"], 10) == {"r1": "r1", "r2": "r2"} and shorten_names([], 10) == {}


@pytest.mark.parametrize("hours, unit", [(1e-6, "ms"), (0.1, "s"), (1.0, "s"), (6.0, "h")])
def test_time_is_shown_in_one_unit(hours, unit):
    longest = 3600 * hours
    assert describe_quantity("time", [0.0, longest]).unit == unit
    if hours >= 0.1:
        traces = make_hour(2, hours)
        labels = {axes.get_xlabel().strip() for axes in figures.draw_fit({"m": traces}, traces[0].channel).axes}
        assert f"time [{unit}]" in labels
        early = Place(traces[0].channel, "time", (0.0, 1.0), "", 0.5)  # of a long record, so not in ms
        assert f" {unit}." in say_place(early, choose_view(traces))


SENTENCES = (
    "Missing was wall-stiffness (k_w = 2. N/m; q = 1.5). Without it the model fails: " + "it leaves more, " * 20,
    "Something is missing that the catalogue does not hold: the model (it leaves 3.2: more) fails, "
    + "and so on, " * 30,
    "Short.", "word " * 100,
)  # fmt: skip


@pytest.mark.parametrize("sentence", SENTENCES)
def test_headline_is_short(sentence):
    head, rest = split_sentence(sentence.strip())
    assert len(f"{head} {rest}".split()) == len(sentence.split())
    if len(sentence) < 100:
        assert (head, rest) == (sentence, "")
    elif ". " in sentence or ": " in sentence:
        assert len(head) < 100 and head.endswith(".") and rest[0].isupper() and head.count("(") == head.count(")")


def test_page_shows_the_narrow_figure_on_telephones(tmp_path):
    wide, narrow = figures.new_figure(3.0), figures.new_figure(3.0, 4.2)
    sections = [Section("One", figures=[Picture("a", "Caption", wide, "", narrow), Picture("b", "Caption", wide)],
                        tables=[Table(("x",), [(1,)])])]  # fmt: skip
    html = write_page("t", "It falls.", sections, tmp_path).read_text(encoding="utf-8")
    source = html.partition("<source")[2].partition(">")[0]
    image = base64.b64decode(source.partition("base64,")[2].partition('"')[0])
    assert "max-width" in source and struct.unpack(">II", image[16:24])[0] < 900
    assert html.count('class="wide"') == 1  # the other scrolls in its own box
