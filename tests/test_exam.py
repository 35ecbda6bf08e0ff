"""The sealed exam: what is drawn, how strong it is, what is marked, and that nothing is lost."""

import dataclasses as dc
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ddetumble import InputError, read_campaign
from ddetumble._errors import ComputationError
from ddetumble.cli import main
from ddetumble.effects import TUMBLE
from ddetumble.exam import cases, running, scoring
from ddetumble.exam.cases import (
    COUNTS,
    GENERATORS,
    PATTERN,
    STRONGEST,
    TRUTHS,
    WEAKEST,
    Exam,
    find_kind,
    name_truth,
    sample_case,
    write_case,
)
from ddetumble.exam.examination import examine
from ddetumble.exam.faults import FAULTS
from ddetumble.exam.scorecard import write_scorecard
from ddetumble.exam.simulators.campaigns import order_tests, write_package
from ddetumble.exam.simulators.generator import Hidden
from ddetumble.exam.simulators.impact import NULLS
from ddetumble.exam.simulators.impact_campaigns import CONDITIONS as IMPACT_CONDITIONS
from ddetumble.exam.simulators.impact_campaigns import NOISE, UNCERTAINTIES, refer_impacts
from ddetumble.exam.simulators.slip_campaigns import (
    CONDITIONS,
    SLIP_NOISE,
    SLIP_UNCERTAINTIES,
    place_path,
    refer_slip,
)
from ddetumble.exam.simulators.strength import measure_misfit, reach_strength
from ddetumble.exam.simulators.tumbling_campaigns import draw_rates, measure_tumble_misfit
from tests.helpers_exam import die_always, die_once, finish, make_row


ROOT = Path(__file__).resolve().parent.parent
FAMILIES = tuple(GENERATORS)


def pcg(seed):
    """The generator that campaigns start from."""
    return np.random.Generator(np.random.PCG64(seed))


# ---- what is drawn -------------------------------------------------------------------------------------------------


def test_kinds_come_in_a_fixed_pattern():
    """Every kind as often as the pattern says; of some kinds only, those; ranks count the cases of a kind."""
    exam = Exam("slip", truths=tuple(COUNTS))
    kinds = [find_kind(exam, index) for index in range(3 * len(PATTERN))]
    assert [kind for kind, _ in kinds] == list(PATTERN) * 3
    for kind in COUNTS:
        assert [rank for name, rank in kinds if name == kind] == list(range(3 * PATTERN.count(kind)))
    assert {find_kind(Exam("slip", truths=("nothing",)), index) for index in range(5)} == {
        ("nothing", rank) for rank in range(5)}  # fmt: skip


@pytest.mark.parametrize("family", FAMILIES)
def test_a_case_is_the_same_whichever_others_run(family):
    """The same seed and number give the same case, other numbers and seeds another; null cases cost no simulation."""
    exam = Exam(family, 5, truths=("nothing",))
    cases = [sample_case(exam, index) for index in range(6)]
    assert sample_case(exam, 4) == cases[4] and len({case.seed for case in cases}) == 6
    assert sample_case(Exam(family, 6, truths=("nothing",)), 4).setting != cases[4].setting
    for case in cases:
        assert case.effects == {} and case.fault in (None, *FAULTS)
        assert case.noise["rho"] == 0.0 or 0.3 <= case.noise["rho"] <= 0.9


def test_noise_and_faults_are_those_asked_for():
    """One kind of noise, one fault or none; drawn ones come at about the odds stated."""
    for kind in ("white", "ar1"):
        rows = [sample_case(Exam("slip", 1, ("nothing",), kind, "clipping"), k) for k in range(20)]
        assert {row.noise["rho"] > 0 for row in rows} == {kind == "ar1"} and {row.fault for row in rows} == {"clipping"}
    rows = [sample_case(Exam("slip", 1, ("nothing",)), k) for k in range(400)]
    assert 0.4 < np.mean([row.noise["rho"] > 0 for row in rows]) < 0.6
    assert 0.18 < np.mean([row.fault is not None for row in rows]) < 0.32
    assert {row.fault for row in rows} == {None, *FAULTS}
    assert {sample_case(Exam("slip", 1, ("nothing",), fault="none"), k).fault for k in range(20)} == {None}


@pytest.mark.parametrize("name", FAMILIES)
def test_generators_hide_what_the_simulators_know(name):
    """Nothing but catalogued effects in the catalogue and nothing catalogued outside it; amplitude 1 can be built."""
    family, generator = GENERATORS[name], np.random.default_rng(1)
    assert all(effect.startswith("x-") for effect in family.outside)
    assert not any(effect.startswith("x-") for effect in family.catalogue)
    if name == "impact":
        assert set(family.catalogue) | set(family.outside) == set(NULLS)
    for hidden in {**family.catalogue, **family.outside}.values():
        drawn = hidden.draw(generator)
        assert all(np.isfinite(x).all() for x in hidden.build(1.0, drawn).values()) and hidden.most >= 1.0


def test_hidden_effects_scale_as_stated():
    """Amplitudes from the null on, time constants inversely, vectors by length, shapes not at all."""
    hidden = Hidden({"n": 0.5}, {"n": 1.0}, {"bias": 2.0}, {"tau": 0.8}, {"q": (3.0, 3.0)})
    drawn = hidden.draw(np.random.default_rng(2))
    built = hidden.build(4.0, drawn)
    assert built["n"] == 3.0 and built["tau"] == 0.2 and built["q"] == pytest.approx(3.0)
    assert np.linalg.norm(built["bias"]) == pytest.approx(8.0)


def test_an_earlier_edition_asks_what_it_asked(monkeypatch):
    """What came later to the catalogue changes no case of an exam that was held before: its pool is as it was."""
    catalogue = GENERATORS["impact"].catalogue
    late = {name: hidden for name, hidden in catalogue.items() if hidden.since > 2}
    waiting = {name for name, hidden in late.items() if hidden.since > GENERATORS["impact"].edition}
    # Which effects are hidden is asked, not how strong they are: that takes refits.
    monkeypatch.setitem(GENERATORS, "impact", dc.replace(GENERATORS["impact"], prepare=lambda setting, seed: None))
    monkeypatch.setattr(cases, "hide", lambda name, hidden, measure, random: (hidden.draw(random), 1.0, 1.0))
    pools = {edition: {name for index in range(len(catalogue))
                       for name in sample_case(Exam("impact", 7, ("one",), edition=edition), index).effects}
             for edition in (2, 3, 4)}
    assert not pools[2] & set(late) and pools[3] & set(late) == {"sensor-resonance"}
    assert pools[4] & set(late) == set(late) - waiting and {"sensor-filter"} <= pools[4]
    assert waiting == {"sensor-hysteresis"}


def test_three_effects_at_once():
    """Three different ones of the catalogue, each with its strength."""
    case = sample_case(Exam("slip", 11, truths=("three",)), 0)
    assert len(case.effects) == 3 and set(case.effects) == set(case.strengths) <= set(GENERATORS["slip"].catalogue)


@pytest.mark.parametrize("index", [0, 1, 4, 7])
def test_slip_strengths_are_as_asked(index):
    """A full refit with derivatives found anew at every step finds the strength that a case states."""
    exam = Exam("slip", 11, truths=("one", "two", "outside"))
    case = sample_case(exam, index)
    s = case.setting
    path = place_path(s["length"], s["interval"])[0][::2]
    tests = order_tests(pcg(case.seed), CONDITIONS, (s["loads"], s["pressures"], s["speeds"]))
    assert len(case.effects) == COUNTS[case.kind] and (case.kind == "outside") == any(
        name.startswith("x-") for name in case.effects)  # fmt: skip
    reference = refer_slip(s["base"], tests, path, SLIP_NOISE, SLIP_UNCERTAINTIES)
    for name, values in case.effects.items():
        full = measure_misfit(reference, {name: values})
        assert case.strengths[name] == pytest.approx(full, rel=0.05)
        assert WEAKEST * 0.97 < case.strengths[name] < STRONGEST * 1.03
        if name != "presliding":  # which takes the sample at zero slip however short it is
            assert case.strengths[name] == pytest.approx(case.asked[name], rel=0.03)


@pytest.mark.slow
def test_impact_strengths_are_as_asked():
    """The same for an impact case, with a finer integrator and derivatives found anew at every step."""
    case = sample_case(Exam("impact", 2, truths=("one",)), 4)
    s = case.setting
    tests = order_tests(pcg(case.seed), IMPACT_CONDITIONS, (s["pressures"], s["speeds"]), s["repeats"])[:12]
    reference = refer_impacts(s["base"], tests, [NOISE["normal_force"]], UNCERTAINTIES, rtol=1e-8, parts=10)
    full = measure_misfit(reference, case.effects, steps=3)
    ((asked, reached),) = zip(case.asked.values(), case.strengths.values(), strict=True)
    assert reached == pytest.approx(asked, rel=0.03) and full == pytest.approx(reached, rel=0.05)


def test_tumble_strengths_are_as_asked():
    """The same for a tumbling case, on all samples of its records."""
    case = sample_case(Exam("tumble", 3, truths=("one",)), 0)
    s = case.setting
    times = np.arange(round(s["duration"] / s["interval"]) + 1) * s["interval"]
    starts = draw_rates(pcg(case.seed), s["records"])
    full = measure_tumble_misfit(s["base"], case.effects, starts, times)
    ((asked, reached),) = zip(case.asked.values(), case.strengths.values(), strict=True)
    assert reached == pytest.approx(asked, rel=0.03) and full == pytest.approx(reached, rel=0.03)


@pytest.mark.parametrize("power", [1.0, 0.6, 2.0])
def test_strengths_are_found_and_limits_kept(power):
    """Of a power law the amplitude in closed form; of one out of reach the largest; of a floor the smallest misfit."""
    amplitude, found = reach_strength(lambda a: 3.0 * a**power, 2.0, 50.0)
    assert found == pytest.approx(2.0, rel=0.02) and amplitude == pytest.approx((2 / 3) ** (1 / power), rel=0.04)
    assert reach_strength(lambda a: 3.0 * a**power, 2.0, 0.25) == (0.25, 3.0 * 0.25**power)
    assert reach_strength(lambda a: 5.0 + a, 2.0, 10.0)[1] == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_the_campaign_says_nothing_of_the_truth(family, tmp_path):
    """Folders of all kinds have the same columns and words, and no effect is named in them."""
    words = set()
    for index, truth in enumerate(TRUTHS if family == "slip" else ("nothing", "outside")):
        exam = Exam(family, 4, truths=(truth,), fault="none")
        case = sample_case(exam, index)
        write_case(exam, case, tmp_path / truth)
        text = (tmp_path / truth / "datapackage.json").read_text(encoding="utf-8")
        assert not any(name in text for name in {**exam.generator.catalogue, **exam.generator.outside})
        descriptor = json.loads(text)
        assert descriptor["name"] == f"case-{index:04d}" and read_campaign(tmp_path / truth).family == family
        columns = [field["name"] for table in descriptor["resources"] for field in table["schema"]["fields"]
                   if not field["name"].startswith("attitude")]  # fmt: skip
        words.add((descriptor["title"], str(descriptor["sources"]), str(columns)))
    assert len(words) == 1


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_faults_do_what_they_say(family, fault, tmp_path):
    """The faulty campaign differs from the sound one in the samples that the fault names, and is read all the same."""
    sound, faulty = (Exam(family, 9, ("nothing",), "white", kind) for kind in ("none", fault))
    case = sample_case(faulty, 2)
    made = sound.generator.make("case", case.seed, {}, **case.setting, **case.noise)
    told = write_case(faulty, case, tmp_path / "faulty")["fault_details"]
    write_package(tmp_path / "sound", made)
    campaigns = [read_campaign(tmp_path / name) for name in ("sound", "faulty")]
    channels = list(sound.generator.channels)
    before, after = (c.samples[channels].to_numpy() for c in campaigns if c.samples is not None)
    changed = ~np.isclose(before, after, atol=1e-12, equal_nan=True)
    assert changed.any()
    keys = list(campaigns[0].record_keys)
    records = {keys.index(key) for key in campaigns[0].samples["record"].to_numpy()[changed.any(axis=1)]}
    if fault == "clipping":
        limits = np.array(told["limits"])
        assert len(records) == told["records"] and (np.abs(after) <= limits * (1 + 1e-3)).all()
        assert np.allclose(np.abs(after[changed]), np.broadcast_to(limits, after.shape)[changed], rtol=1e-3)
    else:
        assert records == {told["record"]}
    if fault == "drop-out":
        assert changed.any(axis=1).sum() <= told["samples"]
        assert np.isnan(after[changed]).all() if told["missing"] else (after[changed] == 0).all()
    if fault == "wrong-record":
        large = changed & (np.abs(before) > 0.5 * np.abs(before[changed]).max())
        assert np.median(after[large] / before[large]) == pytest.approx(told["factor"], rel=0.01)


# ---- marks ---------------------------------------------------------------------------------------------------------


def test_shares_have_the_limits_of_clopper_and_pearson():
    """In closed form where none or all are true; Clopper and Pearson's own example of 5 of 10 elsewhere."""
    none, every = scoring.count_share([False] * 200), scoring.count_share([True] * 20)
    assert none.upper == pytest.approx(1 - 0.05 ** (1 / 200)) and none.low == 0.0
    assert none.high == pytest.approx(1 - 0.025 ** (1 / 200)) and every.low == pytest.approx(0.025 ** (1 / 20))
    half = scoring.count_share([True, False] * 5)
    assert (half.low, half.high) == pytest.approx((0.1871, 0.8129), abs=1e-4) and half.share == 0.5
    assert np.isnan(scoring.count_share([]).share)


ANSWERS = [
    (make_row(0), True),
    (make_row(1, verdict="explained", found=["a"]), False),
    (make_row(2, verdict="undecided"), False),
    (make_row(3, "one", "explained", ["a"], ["a"]), True),
    (make_row(4, "one", "explained", ["a"], ["b"], ["a"]), True),
    (make_row(5, "one", "explained", ["a"], ["b"], ["c", "a"]), True),
    (make_row(6, "one", "explained", ["a"], ["a", "b"]), False),
    (make_row(7, "one", "improved", ["a"], ["a"]), False),
    (make_row(8, "one", "nothing-missing", ["a"], strength=0.6), False),
    (make_row(9, "two", "explained", ["a", "b"], ["b", "a"]), True),
    (make_row(10, "two", "explained", ["a", "b"], ["b"], ["a"]), True),
    (make_row(11, "two", "explained", ["a", "b"], ["b", "c"]), False),
    (make_row(16, "three", "explained", ["a", "b", "c"], ["c", "a", "b"]), True),
    (make_row(17, "three", "explained", ["a", "b", "c"], ["c", "a"]), False),
    (make_row(12, "outside", "unexplained", ["x-a"]), True),
    (make_row(13, "outside", "explained", ["x-a"], ["b"]), False),
    (make_row(14, "outside", "nothing-missing", ["x-a"]), False),
    (make_row(15, "one", "failed", ["a"], error="ComputationError: it broke"), False),
]


def test_answers_are_marked():
    """Right and wrong answers of every kind; each wrong one has words, no right one has."""
    for row, right in ANSWERS:
        assert scoring.is_right(row) == right, row
        assert bool(scoring.describe_failure(row)) == (not right), row
    assert [scoring.is_pinned(ANSWERS[k][0]) for k in (3, 4, 5, 6)] == [True, True, False, False]


def test_what_the_catalogue_has_come_to_list_may_be_named():
    """A truth that was outside when the cases were drawn: naming it is no imitation, naming something else is."""
    named = make_row(0, "outside", "explained", ["x-quadratic-drag"], ["quadratic-drag"])
    beside = make_row(1, "outside", "explained", ["x-quadratic-drag"], ["eddy-current"], ["quadratic-drag"])
    other = make_row(2, "outside", "explained", ["x-quadratic-drag"], ["eddy-current"])
    more = make_row(3, "outside", "explained", ["x-quadratic-drag"], ["quadratic-drag", "gyro-bias"])
    refused = make_row(4, "outside", "improved", ["x-quadratic-drag"], ["eddy-current"])
    assert [scoring.is_right(row) for row in (named, beside, other, more, refused)] == [True, True, False, False, True]
    marks = scoring.score([named, beside, other, more, refused])
    assert marks["outside_explained"].count == 2 and marks["outside_explained"].total == 5
    for outside, listed in scoring.LISTED_SINCE.items():
        assert outside in GENERATORS["tumble"].outside and listed in {effect.id for effect in TUMBLE}


def test_scores_add_up():
    """Counts of the made answers, by hand."""
    nothing = scoring.score([])
    assert nothing["cases"] == 0 and nothing["coverage"].total == 0 and nothing["seconds"] is None
    marks = scoring.score([row for row, _ in ANSWERS])
    counts = {key: (marks[key].count, marks[key].total) for key, value in marks.items()
              if isinstance(value, scoring.Share)}  # fmt: skip
    assert counts == {
        "false_alarms": (1, 3), "singles_first": (3, 7), "singles_in_set": (4, 7), "sure_first": (3, 6),
        "sure_in_set": (4, 6), "sure_pinned": (3, 6), "pairs_named": (2, 3), "sure_pairs_named": (2, 3),
        "triples_named": (1, 2),
        "outside_explained": (1, 3), "outside_unseen": (1, 3), "coverage": (7, 7),
        "nulls_undecided": (1, 3), "undecided": (1, 18),
    }  # fmt: skip
    assert marks["cases"] == 18 and marks["failed"] == 1 and marks["set_size"] == pytest.approx((1 + 2 + 3 + 1 + 1) / 5)
    assert marks["heldout_over_noise"] == {"median": 0.25, "q90": 0.25, "largest": 0.25}
    assert marks["seconds"]["median"] == 3.0
    assert marks["processor_seconds"]["largest"] == 4.0 and marks["widths"]["mass"]["width"] == pytest.approx(0.4)
    told = scoring.score([make_row(0, fault="clipping", reported=[{"kind": "clipped"}]), make_row(1, reported=[])])
    assert [told["reports_by_fault"][name].count for name in ("clipping", "none")] == [1, 0]
    assert sum(b["seen"].total for b in marks["power"]) == 7 and marks["power"][0]["seen"].count == 0
    assert marks["by_effect"]["a"]["cases"] == 7 and marks["right"]["two"].count == 2


def test_truth_has_the_names_that_results_use():
    """Components of a vector are numbered."""
    truth = name_truth({"inertia_ratio": 0.5}, {"gyro-bias": {"bias": [1.0, 2.0, 3.0]}, "stribeck": {"A": 0.2}})
    assert truth == {"inertia_ratio": 0.5, "gyro-bias.bias.0": 1.0, "gyro-bias.bias.1": 2.0, "gyro-bias.bias.2": 3.0,
                     "stribeck.A": 0.2}


def test_scorecard_lists_every_failure(tmp_path):
    """JSON, page, README and figure; text from a row cannot break out of them."""
    rows = [row for row, _ in ANSWERS] + [make_row(18, "one", "explained", ["a|<b>"], ["c"])]
    card = write_scorecard(Exam("slip", 3), rows, tmp_path)
    kept = json.loads((tmp_path / "scorecard.json").read_text(encoding="utf-8"))
    assert [one["case"] for one in kept["failures"]] == [1, 2, 6, 7, 8, 11, 17, 13, 14, 15, 18] and kept["cases"] == 19
    assert kept["false_alarms"]["count"] == 1 and kept["false_alarms"]["share"] == pytest.approx(1 / 3)
    assert "ddetumble exam --family slip --seed 3 --cases 19 -o DIR" == card["command"]
    readme, page = (tmp_path / "README.md").read_text(encoding="utf-8"), (tmp_path / "report.html").read_text("utf-8")
    assert "a\\|&lt;b>" in readme and "it broke" in readme and "<b>" not in page and "a|&lt;b&gt;" in page
    assert (tmp_path / "power.png").read_bytes()[:4] == b"\x89PNG" and "](power.png)" in readme
    assert write_scorecard(Exam("slip", 3), [make_row(0)], tmp_path)["failures"] == []


def test_an_exam_of_undecided_cases_says_so_before_it_says_that_there_are_no_false_alarms(tmp_path):
    rows = [make_row(k, "nothing", "undecided") for k in range(3)]
    card = write_scorecard(Exam("slip", 3), rows, tmp_path)
    assert card["undecided"].count == card["undecided"].total == 3
    first, second, *_ = card["sentence"].split(";")
    assert card["false_alarms"].count == 0 and "all 3" in first and "0 of 3" in second
    card = write_scorecard(Exam("slip", 3), [*rows, make_row(3)], tmp_path)
    assert card["undecided"].count == 3 and "all" not in card["sentence"].split(";")[0]


# ---- nothing is lost -----------------------------------------------------------------------------------------------


def test_an_exam_goes_on_where_it_was_killed(tmp_path):
    """A process killed in the middle, and a torn last line: every case is there once in the end, in order."""
    code = ("from ddetumble.exam.cases import Exam; from ddetumble.exam.examination import examine; "
            "from tests.helpers_exam import dawdle; import sys; "
            "examine(Exam('slip', 1), range(30), sys.argv[1], workers=1, work=dawdle)")
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], cwd=ROOT,
                               env={**os.environ, "PYTHONPATH": str(ROOT)})
    answers = tmp_path / "cases.jsonl"
    while not (answers.is_file() and answers.read_bytes().count(b"\n") >= 3):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = answers.read_bytes().count(b"\n")
    with answers.open("ab") as stream:
        stream.write(b'{"index": 29, "ki')
    told = []
    rows = examine(Exam("slip", 1), range(30), tmp_path, workers=1, work=finish, progress=lambda *p: told.append(p))
    assert [row["index"] for row in rows] == list(range(30)) and answers.read_bytes().count(b"\n") == 30
    assert len(told) == 31 - done and told[-1][1] == 1.0
    assert examine(Exam("slip", 1), [3], tmp_path, work=die_always) == rows


def test_a_folder_holds_one_exam(tmp_path):
    """Another seed, or a damaged file, is refused in a sentence; a folder in use too."""
    examine(Exam("slip", 1), [0], tmp_path, workers=1, work=finish)
    with pytest.raises(InputError, match="an exam of something else: seed is 1 there and 2 now"):
        examine(Exam("slip", 2), [0], tmp_path, workers=1, work=finish)

    def nested(index):
        examine(Exam("slip", 1), [index], tmp_path, workers=1, work=finish)

    with pytest.raises(InputError, match="another process is writing"):
        examine(Exam("slip", 1), [1], tmp_path, workers=1, work=nested)
    with (tmp_path / "cases.jsonl").open("a") as stream:
        stream.write("[1, 2]\n")
    with pytest.raises(InputError, match="line 2: the line is no case"):
        examine(Exam("slip", 1), [1], tmp_path, workers=1, work=finish)
    (tmp_path / "exam.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="damaged"):
        examine(Exam("slip", 1), [1], tmp_path, workers=1, work=finish)


def test_a_killed_worker_loses_nothing(tmp_path):
    """What a killed process had in hand is done again; cases that nothing survives end in a sentence."""
    found = sorted(running.run_all(partial(die_once, str(tmp_path)), range(8), workers=2))
    assert [job for job, _ in found] == list(range(8)) and [row["index"] for _, row in found] == list(range(8))
    assert (tmp_path / "died-3").exists()
    with pytest.raises(ComputationError, match="worker processes died 3 times"):
        list(running.run_all(die_always, range(2), workers=2))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore:.*unclosed.*")
def test_a_cluster_loses_nothing(tmp_path):
    """On a local Dask cluster of two workers, one is killed while the exam runs: every case is there, once."""
    from distributed import LocalCluster

    from tests.helpers_exam import dawdle

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        killed = []

        def kill(text, share):
            if share > 0.1 and not killed:
                killed.append(pids[0])
                os.kill(pids[0], signal.SIGKILL)

        rows = examine(Exam("slip", 1), range(24), tmp_path, scheduler=cluster.scheduler_address, work=dawdle,
                       progress=kill)
    assert killed and [row["index"] for row in rows] == list(range(24))


# ---- the command ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--family", "cube"], "'cube' is none of impact, slip, oblique, tumble"),
        (["--truth", "four"], "'four' is none of nothing"),
        (["--noise", "pink"], "'pink' is none of white, ar1, drawn"),
        (["--fault", "lightning"], "'lightning' is none of none, drawn, clipping"),
        (["--bench", "jitter"], "'jitter' is none of stated, drawn, proportional"),
        (["--tests", "none"], "'none' is none of full, few"),
        (["--tests", "few"], "few tests can hide nothing"),
        (["--seed", "-1"], "a whole number from 0"),
        (["--first", "-2"], "from 0 on"),
        (["--cases", "0"], "greater than or equal to 1"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "workers of its own"),
        (["--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers"),
    ],
)
def test_malformed_options(arguments, says, tmp_path, capsys, monkeypatch):
    """One sentence, exit code 2, and no case is begun."""
    monkeypatch.setattr(running, "TIMEOUT", 1)
    usual = {"--family": "slip", "--cases": "2"}
    others = [word for name, value in usual.items() if name not in arguments for word in (name, value)]
    assert main(["exam", "--quiet", "-o", str(tmp_path / "exam"), *others, *arguments]) == 2
    told = capsys.readouterr().err
    assert says in told and told.count("\n") == 1 and not (tmp_path / "exam").exists()


@pytest.mark.study
def test_three_cases_from_end_to_end(tmp_path, capsys):
    """Drawn, judged blind and marked by two processes; case 1 alone is the same case, and its truth is kept."""
    words = ["exam", "--family", "slip", "--seed", "1", "--fault", "none"]
    assert main([*words, "--cases", "3", "--workers", "2", "-o", str(tmp_path / "exam")]) == 0
    assert "3 cases; false alarms 0 of 2" in capsys.readouterr().out
    rows = [json.loads(line) for line in (tmp_path / "exam" / "cases.jsonl").read_text("utf-8").splitlines()]
    assert [row["kind"] for row in rows] == ["nothing", "one", "nothing"] and not any(row["error"] for row in rows)
    assert rows[1]["found"] == list(rows[1]["effects"]) and all(row["heldout_over_noise"] < 0.5 for row in rows)
    assert main([*words, "--cases", "1", "--first", "1", "--keep", "--workers", "1", "-o", str(tmp_path / "one")]) == 0
    kept = json.loads((tmp_path / "one" / "kept" / "case-0001" / "truth.json").read_text(encoding="utf-8"))
    same = ("effects", "strengths", "setting", "seed", "noise", "verdict", "found")
    assert all(kept[name] == rows[1][name] for name in same)
    assert (tmp_path / "one" / "kept" / "case-0001" / "discovery" / "result.json").is_file()
