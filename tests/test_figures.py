"""Figures and pages have room for what files bring: long names of records and effects, records of an hour."""

import base64
import dataclasses as dc
import itertools
import struct

import numpy as np
import pytest

import ddetumble as dd
from ddetumble import figures
from ddetumble.figures import planning
from ddetumble.figures.style import SpacedLocator, apply_style, new_axes
from ddetumble.figures.traces import find_stretch, measure_error
from ddetumble.measurement.quantities import describe_quantity, format_small_share, shorten_names, typeset
from ddetumble.measurement.units import format_time
from ddetumble.reports import Picture, Section, Table, write_page
from ddetumble.reports.findings import _list_facts
from ddetumble.reports.page import HEADLINE, SHORTEST, begin_sentence, split_sentence
from ddetumble.selection.result import Place, Trace
from ddetumble.selection.series import make_traces
from ddetumble.selection.text import choose_view, describe_place
from tests.helpers_report import make_candidates, make_slip_discovery
from tests.helpers_statistics import fit_toy, make_selection


LONG = "with pressure-dependent-restitution, speed-dependent-restitution, viscoelastic-wall and inflation-growth"
SLACK = 1.5  # px by which a glyph may stand over its box


def test_traces_of_a_comparison_are_no_chains():
    """What draws them is named; and so is the form in which it takes them."""
    for draw in (figures.draw_traces, figures.draw_fit):
        with pytest.raises(TypeError, match="{name: comparison.traces}"):
            draw(make_pulses(2))


@pytest.mark.slow
def test_several_comparisons_are_drawn_as_they_are():
    """Steps and signatures take what `compare` of several models returned: its names, its records, its noise."""
    loop = dd.compare("slip-a", "paper", dd.RubberFriction() + dd.effects.AdhesiveOffset())
    steps = figures.draw_error_by_step(loop)
    assert [one.get_text() for one in steps.axes[0].get_yticklabels()] == list(loop.names)
    assert "noise floor" in str([one.get_text() for one in steps.legends[0].get_texts()])
    by_hand = figures.draw_error_by_step(loop.models, loop.names, min(one.noise_nrmse for one in loop))
    assert figures.render_png(steps) == figures.render_png(by_hand)
    signatures = [figures.draw_signatures(models, "tangential_force", 2) for models in (loop, loop.traces)]
    assert figures.render_png(signatures[0]) == figures.render_png(signatures[1])


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


@pytest.mark.parametrize("narrow", [False, True])
def test_forest_of_long_names(narrow):
    own = {f"the campaign of ball number {k} and its arm": (1.0 + k, 0.5 + k, 1.5 + k) for k in range(9)}
    check_layout(figures.draw_forest({
        "viscoelastic-wall.k_v [N/m]": own | {"joint": (4.0, 3.9, 4.1)}, LONG: {"one": (1.0, -np.inf, np.inf)},
        "restitution": {"one": (0.7, 0.69, 0.71), "joint": (0.7, 0.699, 0.701)}, "n": {"one": (1.0, 0.9, 1.1)}},
        narrow))


@pytest.mark.parametrize("make", [make_pulses, make_hour], ids=["impact", "hour"])
def test_long_names_have_room(make):
    traces = make()
    models = {"reference model": traces, LONG: traces}
    channel = traces[0].channel
    place = Place(channel, choose_view(traces).state, tuple(np.quantile(traces[0].state, [0.6, 0.9])), "", 0.63, 1e-3)
    check_layout(figures.draw_fit(models, channel))
    check_layout(figures.draw_fit(models, channel, count=2, narrow=True))
    for narrow in (False, True):
        check_layout(figures.draw_record_errors(models, narrow=narrow))
        check_layout(figures.draw_residual_map(models, narrow=narrow))
        check_layout(figures.draw_dependence(models, channel, None, (place,), narrow=narrow))
        if make is make_pulses:
            check_layout(figures.draw_missing_force(models, channel, narrow=narrow))


@pytest.mark.parametrize("cycles, first", [(30, 0.0), (300, 1400.0), (0, 0.0)])
def test_records_that_turn_often_are_drawn_at_their_end(cycles, first):
    time = np.linspace(0.0, 1500.0, 15001)
    model = 0.05 * np.sin(2.0 * np.pi * cycles * time / 1500.0) + 1e-18 * np.cos(time)
    trace = Trace("r", "angular_velocity_x", "rad/s", {}, time, model, model, 2e-5, time, model, "tumble")
    start, end = find_stretch(trace)
    assert end == 1500.0 and abs(start - first) < 5.0


def test_numbers_with_many_digits_have_room():
    time, generator = np.arange(0, 602, 2.0), np.random.default_rng(1)
    traces = []
    for i, rate in enumerate((0.02211, 0.117222, 0.10368, 0.061845)):
        model, noise = np.full(time.size, rate), 2e-5 * generator.normal(size=time.size)
        traces.append(Trace(f"r{i}", "angular_velocity_z", "rad/s", {}, time, model + noise, model, 2e-5, time, model,
                            "tumble"))  # fmt: skip
    check_layout(figures.draw_fit({"reference model": traces}, "angular_velocity_z", 4))


def test_records_without_conditions_have_cells():
    """A row of one has a height, a column of one a width: their numbers stand on colour."""
    for traces in (make_hour(4), make_hour(1)):
        axes = figures.draw_record_errors({"reference model": traces}).axes[0]
        (_, bottom), (_, top) = axes.collections[0].get_datalim(axes.transData).get_points()
        assert top - bottom == pytest.approx(1.0)
        assert np.ptp(axes.collections[0].get_datalim(axes.transData).get_points()[:, 0]) == pytest.approx(
            len(traces) / 3)


def test_error_bars_end_within_the_axes():
    traces = [dc.replace(one, measured=one.model + (-1.0) ** k) for k, one in enumerate(make_pulses(6))]
    for figure in (figures.draw_missing_force({"reference model": traces}),
                   figures.draw_dependence({"reference model": traces})):
        for axes in figure.axes:
            low, high = axes.get_ylim()
            ends = np.concatenate([np.ravel([path[:, 1] for path in bars.get_segments()])
                                   for container in axes.containers for bars in container.lines[2]])
            assert low <= ends.min() and ends.max() <= high


def test_numbers_stand_beyond_their_bars():
    """A correlation on the bar's own side; a p-value beside an effect that explains nothing, as in the table."""
    step = make_slip_discovery().steps[-1]
    step = dc.replace(step, correlations=(("a", "b", 0.24), ("a", "c", -0.7)))
    axes = next(axes for axes in figures.draw_parameters({"model": step}).axes if len(axes.patches) == 2)
    for bar, text in zip(axes.patches, axes.texts, strict=True):
        assert text.get_position()[0] / bar.get_width() > 1.0
    idle = dc.replace(make_candidates()[0], explains=0.0, p_value=1.0, visible=0.5)
    axes = figures.draw_ranking([idle]).axes[0]
    assert any("1.00" in text.get_text() for text in axes.texts)


def test_names_of_channels_have_room_beside_their_panels():
    """Each stays beside its own panel, in the records of an import."""
    figure = figures.draw_records(dd.read_campaign("tumble-a"))
    with apply_style():
        figure.canvas.draw()
    boxes = [axes.yaxis.label.get_window_extent() for axes in figure.axes]
    assert len(boxes) >= 3
    assert all(upper.y0 > lower.y1 for upper, lower in itertools.pairwise(boxes))
    assert figure.bbox.y1 > boxes[0].y1 and boxes[-1].y0 > 0


def test_many_records_without_conditions_have_room():
    check_layout(figures.draw_record_errors({"reference model": make_hour(60), LONG: make_hour(60)}))


@pytest.mark.parametrize(("low", "high"), [(0.1700346, 0.1700353), (-0.064034, -0.064031), (1.0, 1.0 + 3e-9),
                                           (0.7, 0.75)])
@pytest.mark.parametrize("width", [1.5, 3.0, 6.0])
def test_numbers_of_a_narrow_range_have_room(low, high, width):
    """However long they are: none touches the next, and at least one is there."""
    with apply_style():
        figure, axes = new_axes(1.0, width, xlim=(low, high))
        axes.xaxis.set_major_locator(SpacedLocator())
        figures.render_png(figure)
        spans = [one.get_window_extent() for one in axes.get_xticklabels()
                 if low <= one.get_position()[0] <= high and one.get_text()]
    assert spans and all(one.x1 < other.x0 for one, other in itertools.pairwise(spans))


def test_predictions_from_settings_as_written_are_drawn():
    """Where a model fits only with settings moved, the error that falls is that of predictions from those as written:
    it is drawn, the axis reaches it, and it leads the numbers of the page; elsewhere nothing of it is drawn."""
    found = make_slip_discovery()
    first, last = found.steps
    plain = figures.draw_error_by_step(found)
    same = dc.replace(found, steps=(dc.replace(first, prediction_nrmse=1.05 * first.heldout_nrmse), last))
    assert figures.render_png(figures.draw_error_by_step(same)) == figures.render_png(plain)
    assert _list_facts(same)[0][0] == _list_facts(found)[0][0]
    steps = [dc.replace(step, prediction_nrmse=error) for step, error in ((first, 0.5), (last, 0.0108))]
    moved = dc.replace(found, steps=tuple(steps))
    axes, before = figures.draw_error_by_step(moved).axes[0], plain.axes[0]
    assert len(axes.collections) == len(before.collections) + 2 and axes.get_xlim()[1] > 50 > before.get_xlim()[1]
    what, value, _ = _list_facts(moved)[0]
    assert "prediction" in what and value == "50.0 % → 1.08 %"


def test_small_shares_are_no_zero():
    """A visible share of 0.4 % is told as such; whole per cents where a digit more says nothing."""
    shares = (0.0, 0.0004, 0.004, 0.0098, 0.0099, 0.014, 0.72)
    assert [format_small_share(x) for x in shares] == ["0 %", "0 %", "0.4 %", "1.0 %", "1.0 %", "1 %", "72 %"]


@pytest.mark.parametrize("narrow", [False, True])
def test_findings_have_room(narrow):
    found = make_slip_discovery()
    last = dc.replace(found.steps[-1], added="x", effects=("pressure-dependent-restitution", "viscoelastic-wall", "x"))
    found = dc.replace(found, steps=(found.steps[0], last))
    check_layout(figures.draw_error_by_step(found, narrow=narrow))
    check_layout(figures.draw_ranking(make_candidates(("adhesion",)), ("adhesion",), narrow=narrow))
    check_layout(figures.draw_parameters({"reference model": found.steps[0], LONG: last}, narrow=narrow))


@pytest.mark.parametrize("narrow", [False, True])
def test_plans_have_room(narrow):
    time = np.linspace(0.0, 130.0, 400)
    momentum = np.stack([250.0 - time, np.sin(time), 200.0 - time], axis=1)
    check_layout(planning.draw_motion(time, momentum, np.full(time.size, 0.9), [28.0, 59.0, 97.0], narrow=narrow))
    pulse = 1500.0 * np.sin(np.linspace(0.0, np.pi, 50))
    check_layout(planning.draw_contacts([np.linspace(0.0, 0.05, 50)] * 3, [pulse] * 3, [0.2 * pulse] * 3,
                                    ["impact 1", "impact 3", "impact 5"], narrow=narrow))
    draws = {"gas-leak": np.linspace(0.343, 0.347, 32), "pressure-dependent-restitution": np.linspace(0.341, 0.345, 32)}
    check_layout(planning.draw_outlook(draws, 0.345, 0.347, narrow=narrow))
    assert planning.draw_motion(100.0 * time, momentum, time, [28.0]).axes[1].get_xlabel() == "time [h]"


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
        assert describe_place(early, choose_view(traces))["span"].endswith(f" {unit}")


@pytest.mark.parametrize("time, longest, text", [
    (0.0053, None, "5.3 ms"), (53.0, None, "53 s"), (7200.0, None, "7200 s"), (14400.0, None, "4 h"),
    (-0.4, 60.0, "-0.4 s"), (0.4, 0.9, "400 ms"), (3600.0, 36000.0, "1 h"),
    (1e-11, 0.02, "0 ms"), (0.01, 60.0, "0.01 s"),
])  # fmt: skip
def test_times_have_the_unit_of_their_record(time, longest, text):
    assert format_time(time, longest) == text


@pytest.mark.parametrize("text, shown", [
    ("k_e = 1.990e-08 ± 1.3e-10 1/s", "k_e = (1.990 ± 0.013) × 10⁻⁸ 1/s"), ("-6.05e-08 1/s**2", "−6.05 × 10⁻⁸ 1/s²"),
    ("p < 1e-6", "p < 10⁻⁶"), ("2.1e+02 N", "210 N"), ("95% of 3", "95 % of 3"), ("N/m**1.51", "N/m^1.51"),
    ("k (depression - d)+^n", "k (depression − d)₊ⁿ"), ("r-1 of 2026-01-02, 0.1-0.2", "r-1 of 2026-01-02, 0.1-0.2"),
    ("8e99aba67be65fbee1d48", "8e99aba67be65fbee1d48"), ("--first 3", "--first 3"), ("f(x)+g(x)", "f(x)+g(x)"),
])  # fmt: skip
def test_text_is_set_as_in_print(text, shown):
    assert typeset(text).replace("\u00a0", " ") == shown


def test_numbers_stay_with_their_units():
    assert typeset("misses by 3.1 % at 0.4 m/s") == "misses by 3.1\u00a0% at 0.4\u00a0m/s"


SENTENCES = (
    "Missing was wall-stiffness (k_w = 2. N/m; q = 1.5). Without it the model fails: " + "it leaves more, " * 20,
    "Something is missing that the catalogue does not hold: the model (it leaves 3.2: more) fails, "
    + "and so on, " * 30,
    "5 impacts leave 48.30 % of the angular momentum. The last of them comes at 97.37 s. No plan does with fewer.",
    "Short.", "word " * 100,
)  # fmt: skip


@pytest.mark.parametrize("sentence", SENTENCES)
def test_headline_is_short(sentence):
    head, rest = split_sentence(sentence.strip())
    assert len(f"{head} {rest}".split()) == len(sentence.split())
    if len(sentence) < 100:
        assert (head, rest) == (sentence, "")
    elif ". " in sentence or ": " in sentence:
        assert SHORTEST <= len(head) <= HEADLINE and head.endswith(".")
        assert rest[0].isupper() and head.count("(") == head.count(")")


def test_names_keep_their_letters_at_the_beginning_of_a_sentence():
    head, rest = split_sentence("The fit of Table 3 gives these numbers: k_v = 3, " + "and so on, " * 20 + "and more.")
    assert (head, rest[:7]) == ("The fit of Table 3 gives these numbers.", "k_v = 3")
    assert begin_sentence("stress-softening cannot be seen") == "Stress-softening cannot be seen"
    assert begin_sentence("p = 0.1") == "p = 0.1" and begin_sentence("a.csv is empty") == "a.csv is empty"


def test_page_shows_the_narrow_figure_on_telephones(tmp_path):
    wide, narrow = figures.new_figure(3.0), figures.new_figure(3.0, 4.2)
    sections = [Section("One", figures=[Picture("a", "Caption", wide, "", narrow), Picture("b", "Caption", wide)],
                        tables=[Table(("x",), [(1,)])])]  # fmt: skip
    html = write_page("t", "It falls.", sections, tmp_path).read_text(encoding="utf-8")
    source = html.partition("<source")[2].partition(">")[0]
    image = base64.b64decode(source.partition("base64,")[2].partition('"')[0])
    assert "max-width" in source and struct.unpack(">II", image[16:24])[0] < 900
    assert html.count('class="zoom"') == 1  # the other is enlarged by a tap


def test_the_noise_of_a_channel_with_a_clock_of_its_own_is_measured_from_its_samples():
    """Sampled at every second instant of the force, beside a channel that has no sample at all."""
    generator, traces = np.random.default_rng(4), []
    for one in make_pulses(6):
        missing = np.arange(one.time.size) % 2 == 1
        pressure = np.full(one.time.size, 1e6)
        noisy = np.where(missing, np.nan, pressure + 2e3 * generator.normal(size=one.time.size))
        traces += [one, dc.replace(one, channel="pressure", unit="Pa", measured=noisy, model=pressure),
                   dc.replace(one, channel="depression", unit="m", measured=np.full(one.time.size, np.nan))]
    axes = dict(zip(("force", "pressure", "depression"), figures.draw_noise_sizes(traces, {}).axes, strict=True))
    sizes = axes["pressure"].lines[0].get_ydata()
    assert len(sizes) and sizes == pytest.approx(2e-3, rel=0.3)  # MPa
    assert len(axes["force"].lines[0].get_ydata()) and not len(axes["depression"].lines[0].get_ydata())


def test_residuals_are_drawn_over_the_noise_of_their_own_samples():
    """Noise of a fiftieth of the reading: a complete model leaves as much of it in a hard blow as in a soft one."""
    selection, fitted = fit_toy(make_selection(2))
    solution, noise = fitted.solution, selection.noise["normal_force"]
    sizes = {key: 0.1 + np.abs(solution.channels[r, 0, :n]) / np.abs(solution.channels).max()
             for r, (key, n) in enumerate(zip(selection.records.keys, selection.records.lengths, strict=True))}
    traces = make_traces(selection.campaign, selection.records, solution,
                         {"normal_force": dc.replace(noise, sizes=sizes)})
    generator = np.random.default_rng(6)
    noisy = [dc.replace(one, measured=one.model + one.sd * sizes[one.record] * generator.normal(size=one.time.size))
             for one in traces]
    assert [measure_error(one) for one in noisy] == pytest.approx([1.0] * len(noisy), abs=0.35)
