"""Benches of the exam: what each kind does to a campaign, that nothing else changes, and how answers on them count."""

import dataclasses as dc
import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from ddetumble import InputError, read_campaign
from ddetumble.exam import scoring
from ddetumble.exam.cases import GENERATORS, Case, Exam, sample_case, start_random, write_case
from ddetumble.exam.examination import examine
from ddetumble.exam.scorecard import write_scorecard
from ddetumble.exam.simulators.benches import BENCHES, find_times, perturb, ring
from ddetumble.exam.simulators.campaigns import write_package
from tests.helpers_exam import finish, make_row


EXAMS = Path(__file__).resolve().parent.parent / "fits" / "exam"
KINDS = tuple(BENCHES)
FLOOR = 0.4  # of proportional noise, over what is stated


def disturb(family, kind, number=0):
    """A campaign with nothing hidden and white noise, the same on a bench of a kind, and what was drawn."""
    exam = Exam(family, 21, ("nothing",), "white", "none", bench=kind)
    case = sample_case(exam, number)
    stated = exam.generator.make("case", case.seed, case.effects, **case.setting, **case.noise)
    campaign, done = perturb(stated, {kind: start_random(exam, 5, number, KINDS.index(kind))})
    return stated, campaign, done[kind]


def list_changes(stated, campaign, of="values"):
    """Record by record, what the bench added to the readings (or to `clean` ones), over the stated noise."""
    scale = np.array(list(stated.noise.values()))
    return [((getattr(b, of) - getattr(a, of))[:, : scale.size]) / scale
            for a, b in zip(stated.records, campaign.records, strict=True)]


def list_noise(campaign):
    """Record by record, the noise over its stated size."""
    scale = np.array(list(campaign.noise.values()))
    return [((one.values - one.clean)[:, : scale.size]) / scale for one in campaign.records]


# ---- what stays ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["impact-nulls-ar1", "slip-nulls-white", "tumble-nulls-ar1"])
def test_committed_cases_are_drawn_as_before(name):
    """Cases of the committed exam are those that its own file asks for, on the bench that it states by silence."""
    asked = json.loads((EXAMS / name / "exam.json").read_text(encoding="utf-8"))["exam"]
    exam = Exam(**asked)
    assert exam.bench == "stated" and json.loads(json.dumps(exam.to_dict())) == asked
    lines = (EXAMS / name / "cases.jsonl").read_text(encoding="utf-8").splitlines()
    for line in lines[3:40:9]:
        row = json.loads(line)
        case = json.loads(json.dumps(dc.asdict(sample_case(exam, row["index"]))))
        assert case.pop("bench") == [] and case == {name: row[name] for name in case}


@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_a_bench_as_stated_changes_nothing(family, tmp_path):
    """The folder is that of the generator's own campaign, to the last byte."""
    exam = Exam(family, 8, ("nothing",), fault="none")
    case = sample_case(exam, 3)
    kept = write_case(exam, case, tmp_path / "exam")
    write_package(tmp_path / "own", exam.generator.make("case-0003", case.seed, {}, **case.setting, **case.noise))
    assert kept == {"fault_details": None, "bench_details": {}, "told": []}
    for name in ("datapackage.json", "records.csv", "samples.csv"):
        assert (tmp_path / "exam" / name).read_bytes() == (tmp_path / "own" / name).read_bytes()


@pytest.mark.parametrize("family", GENERATORS)
def test_benches_are_drawn_beside_the_case(family):
    """On any bench a case is else the same; drawn ones are of every kind that the family can show, a quarter of two."""
    plain, suited = Exam(family, 5, ("nothing",)), GENERATORS[family].benches
    for kind in ("drawn", suited[0]):
        exam = dc.replace(plain, bench=kind)
        for index in range(4):
            assert dc.replace(sample_case(exam, index), bench=()) == sample_case(plain, index)
    drawn = [sample_case(dc.replace(plain, bench="drawn"), index).bench for index in range(200)]
    assert {kind for bench in drawn for kind in bench} == set(suited)
    assert all(len(set(bench)) == len(bench) in (1, 2) for bench in drawn)
    assert 0.15 < np.mean([len(bench) == 2 for bench in drawn]) < 0.35
    for kind in set(BENCHES) - set(suited):
        with pytest.raises(InputError, match="is none of"):
            Exam(family, bench=kind)


@pytest.mark.parametrize("family", GENERATORS)
def test_a_plan_of_few_tests(family):
    """3 to 8 tests out of those of the full plan, now and then at one value of a condition; all else is the same."""
    alone = False
    for index in range(12):
        few, full = (sample_case(Exam(family, 5, ("nothing",), tests=tests), index) for tests in ("few", "full"))
        lists = [name for name, value in full.setting.items() if isinstance(value, list)]
        counts = [len(few.setting[name]) for name in lists] + [few.setting.get("repeats", 1)]
        assert not lists or 3 <= np.prod(counts) <= 8
        assert all(set(few.setting[name]) <= set(full.setting[name]) for name in lists)
        alone |= 1 in counts[:-1]
        same = [{k: v for k, v in case.setting.items() if k not in (*lists, "repeats")} for case in (few, full)]
        assert same[0] == same[1] and dc.replace(few, setting=full.setting) == full
    assert alone == (family != "tumble")


@pytest.mark.parametrize("kind", GENERATORS["slip"].benches)
def test_the_campaign_says_nothing_of_its_bench(kind, tmp_path):
    """Title, columns and uncertainties are those of the stated bench; only numbers in the tables differ."""
    exams = [Exam("slip", 9, ("nothing",), "white", "none", bench=bench) for bench in ("stated", kind)]
    for exam in exams:
        write_case(exam, sample_case(exam, 1), tmp_path / exam.bench)
    texts = [(tmp_path / exam.bench / "datapackage.json").read_text(encoding="utf-8") for exam in exams]
    assert texts[0] == texts[1]
    tables = [[(tmp_path / exam.bench / name).read_bytes() for name in ("records.csv", "samples.csv")]
              for exam in exams]
    assert tables[0] != tables[1]


@pytest.mark.parametrize("family", ["impact", "slip", "tumble"])
def test_files_keep_the_noise(family, tmp_path):
    """What rounding in the files adds is small beside the floor of proportional noise, the quietest there is."""
    stated, campaign, _ = disturb(family, "proportional")
    write_package(tmp_path / "case", campaign)
    read = read_campaign(tmp_path / "case").samples
    channels = list(campaign.noise)
    kept = read[channels].to_numpy()
    made = np.concatenate([one.values[:, : len(channels)] for one in campaign.records])
    lost = np.sqrt(np.mean((kept - made) ** 2, axis=0)) / np.array(list(campaign.noise.values()))
    assert (lost < 0.05 * FLOOR).all()


# ---- what each kind does -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_proportional_noise(family):
    """Noise over sqrt(floor^2 + (share x reading)^2) is white of size one; at the largest reading it is as drawn."""
    stated, campaign, done = disturb(family, "proportional")
    scale = np.array(list(stated.noise.values()))
    readings = [np.abs(one.clean[:, : scale.size]) for one in campaign.records]
    sizes = [np.hypot(FLOOR, np.array(done["share"]) * own / scale) for own in readings]
    assert np.max(np.concatenate(sizes), axis=0) == pytest.approx(FLOOR * done["ratio"]) and 3 < done["ratio"] < 10
    for size, noise, before in zip(sizes, list_noise(campaign), list_noise(stated), strict=True):
        assert noise == pytest.approx(size * before, abs=1e-8)
    whole = np.concatenate([noise / size for noise, size in zip(list_noise(campaign), sizes, strict=True)])
    assert np.std(whole) == pytest.approx(1.0, abs=5 / np.sqrt(2 * whole.size))


def test_bursts_are_loud_in_one_part():
    """By one factor in one run of samples of each record, and nowhere else."""
    stated, campaign, done = disturb("slip", "bursts")
    assert 2.0 < done["factor"] < 4.0 and len(set(done["first"])) > 1
    for noise, before, first in zip(list_noise(campaign), list_noise(stated), done["first"], strict=True):
        length = round(done["part"] * len(noise))
        factor = np.ones_like(noise)
        factor[first : first + length] = done["factor"]
        assert 0.1 * len(noise) - 1 < length < 0.4 * len(noise) + 1 and first + length <= len(noise)
        assert noise == pytest.approx(factor * before, abs=1e-8)


def test_records_are_unevenly_loud():
    """One factor a record; their logarithms have the spread of log 2."""
    factors = []
    for number in range(8):
        stated, campaign, done = disturb("slip", "uneven-records", number)
        for noise, before, factor in zip(list_noise(campaign), list_noise(stated), done["factors"], strict=True):
            assert noise == pytest.approx(factor * before, abs=1e-8)
        factors += done["factors"]
    low, high = (np.sqrt(stats.chi2.ppf(q, len(factors) - 1) / (len(factors) - 1)) for q in (1e-4, 1 - 1e-4))
    assert low < np.std(np.log2(factors), ddof=1) < high


def test_tails_are_those_of_student():
    """Of a campaign's noise, over the stated size, times sqrt 3: Student's t of three degrees of freedom."""
    noise = np.concatenate(list_noise(disturb("slip", "tails")[1])).ravel()
    assert stats.kstest(np.sqrt(3.0) * noise, stats.t(3).cdf).pvalue > 1e-3
    assert stats.kstest(noise, stats.norm.cdf).pvalue < 1e-3


def test_a_coarse_gauge_shows_whole_digits():
    """Readings are multiples of a step of 2 to 4 deviations, none further than half a step from the fine ones."""
    stated, campaign, done = disturb("slip", "coarse")
    step = done["steps"][0] / next(iter(stated.noise.values()))
    assert 2.0 < step < 4.0
    for one, change in zip(campaign.records, list_changes(stated, campaign), strict=True):
        digits = one.values / done["steps"]
        assert digits == pytest.approx(np.round(digits), abs=1e-9) and np.abs(change).max() <= 0.5 * step + 1e-9


@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_baselines_walk_at_random(family):
    """Increments are white, and of a variance for which the walk's mean square over a record is as drawn."""
    stated, campaign, done = disturb(family, "wander")
    assert 1.0 < done["rms"] < 3.0
    for change in list_changes(stated, campaign):
        shocks = np.diff(change, axis=0, prepend=0.0)
        expected = done["rms"] * np.sqrt(2.0 / (len(change) + 1))
        assert np.sqrt(np.mean(shocks**2)) == pytest.approx(expected, rel=5 / np.sqrt(2 * shocks.size))
        assert abs(np.mean(shocks[1:] * shocks[:-1])) < 5 * expected**2 / np.sqrt(shocks.size)


@pytest.mark.parametrize("family", ["slip", "tumble"])
def test_hum_is_one_sine(family):
    """A sine and cosine of the frequency drawn take up the whole change, with the amplitude drawn; phases differ."""
    stated, campaign, done = disturb(family, "hum")
    assert 1.0 < done["amplitude"] < 3.0 and (done["frequency"] in (50.0, 60.0)) == (family == "slip")
    phases = []
    for one, change in zip(campaign.records, list_changes(stated, campaign), strict=True):
        times = find_times(one)
        assert done["frequency"] * np.diff(times).max() < 0.5
        turns = 2 * np.pi * done["frequency"] * times
        waves = np.column_stack([np.sin(turns), np.cos(turns)])
        found = np.linalg.lstsq(waves, change, rcond=None)[0]
        assert waves @ found == pytest.approx(change, abs=1e-6)
        assert np.hypot(*found) == pytest.approx(done["amplitude"], rel=1e-6)
        phases += list(np.arctan2(found[1], found[0]))
    assert np.ptp(phases) > 0.5


@pytest.mark.parametrize("frequency, damping", [(80.0, 0.2), (130.0, 0.06), (300.0, 0.03)])
def test_a_gauge_rings_as_a_mass_on_a_spring(frequency, damping):
    """After a jump the overshoot and the damped frequency, under a sine the gain, are those of the textbook."""
    times = np.arange(20001) * 2e-5
    w = 2 * np.pi * frequency
    jump = np.ones((times.size, 1))
    jump[0] = 0.0
    reading = ring(times, jump, frequency, damping)[:, 0]
    root = np.sqrt(1 - damping**2)
    assert reading.max() == pytest.approx(1 + np.exp(-np.pi * damping / root), rel=2e-3)
    assert times[reading.argmax()] == pytest.approx(np.pi / (w * root), abs=3e-5)
    ratio = 0.4
    forced = ring(times, np.sin(ratio * w * times)[:, None], frequency, damping)[:, 0]
    late = times > times[-1] - 2 * np.pi / (ratio * w)
    gain = 1 / np.hypot(1 - ratio**2, 2 * damping * ratio)
    assert np.abs(forced[late]).max() == pytest.approx(gain, rel=5e-3)


def test_a_ringing_gauge_keeps_the_momentum():
    """In impacts: noise as before, readings changed, and the integral of the force over time is kept."""
    stated, campaign, done = disturb("impact", "ringing")
    assert 80 < done["frequency"] < 300 and 0.03 < done["damping"] < 0.2
    for a, b in zip(stated.records, campaign.records, strict=True):
        assert b.values - b.clean == pytest.approx(a.values - a.clean, abs=1e-9)
        assert np.abs(b.clean - a.clean).max() > stated.noise["normal_force"]
        weights = np.gradient(a.along["time"])
        left = np.abs(b.clean[-20:, 0] - a.clean[-20:, 0]).max() / (2 * np.pi * done["frequency"])  # still swinging
        assert weights @ b.clean[:, 0] == pytest.approx(weights @ a.clean[:, 0], rel=2e-3, abs=2 * left)


@pytest.mark.parametrize("family", ["impact", "slip"])
def test_loose_settings_scatter_more(family):
    """Every setting is written so many times as far from the truth; truth and readings are as before."""
    stated, campaign, done = disturb(family, "loose-settings")
    assert 3.0 < done["factor"] < 6.0
    for a, b in zip(stated.records, campaign.records, strict=True):
        assert b.true == a.true and np.array_equal(b.values, a.values)
        for name in a.true:
            off = [one.written[name] / one.true[name] - 1.0 for one in (a, b)]
            assert off[1] == pytest.approx(done["factor"] * off[0], abs=1e-12)
            assert (off[1] != 0) == (name in stated.uncertainties)


def test_a_trigger_jitters():
    """Clocks lag so many times as much, and the readings are those of such a clock."""
    stated, campaign, done = disturb("impact", "jitter")
    assert 4.0 < done["factor"] < 10.0
    for a, b in zip(stated.records[:3], campaign.records[:3], strict=True):
        assert b.shift == pytest.approx(done["factor"] * a.shift)
        assert b.clean == pytest.approx(stated.read(a.true, a.along["time"] - b.shift), abs=1e-12)
        assert b.values - b.clean == pytest.approx(a.values - a.clean, abs=1e-9)


@pytest.mark.parametrize("family", ["impact", "slip"])
def test_one_setting_is_biased_throughout(family):
    """By the same 1 to 4 % in all records, the others not at all; of several cases either sign and every setting."""
    seen = set()
    for number in range(1 if family == "impact" else 12):
        stated, campaign, done = disturb(family, "biased-setting", number)
        assert 0.01 < abs(done["factor"] - 1.0) < 0.04
        seen.add((done["of"], done["factor"] > 1))
        for a, b in zip(stated.records, campaign.records, strict=True):
            assert np.array_equal(a.values, b.values)
            for name in a.written:
                factor = done["factor"] if name == done["of"] else 1.0
                assert b.written[name] == pytest.approx(factor * a.written[name], rel=1e-12)
    assert family == "impact" or len({name for name, _ in seen}) == len({sign for _, sign in seen}) == 2


def test_one_gauge_is_biased_throughout():
    """Of friction, or of the load as it is written: by 1 to 3 %, noise as before."""
    seen = set()
    for number in range(12):
        stated, campaign, done = disturb("slip", "biased-gauge", number)
        assert 0.01 < abs(done["factor"] - 1.0) < 0.03
        seen.add(done["of"])
        for a, b in zip(stated.records, campaign.records, strict=True):
            force, load = (done["factor"] if done["of"] == name else 1.0 for name in (*stated.noise, "normal_load"))
            assert b.clean == pytest.approx(force * a.clean)
            assert b.values - b.clean == pytest.approx(a.values - a.clean, abs=1e-9)
            assert b.written["normal_load"] == pytest.approx(load * a.written["normal_load"], rel=1e-12)
    assert seen == {"tangential_force", "normal_load"}


@pytest.mark.parametrize("family", ["impact", "tumble"])
def test_sampling_instants_jitter(family):
    """Readings lie off by slope times jitter, whose size is that drawn; it is never more than the noise four times."""
    stated, campaign, done = disturb(family, "time-stamps")
    assert 0.0 < done["share"] < 0.15
    changes = np.concatenate(list_changes(stated, campaign, "clean"))
    assert 0.0 < np.sqrt(np.mean(changes**2, axis=0)).max() < 4.5
    scale = np.array(list(stated.noise.values()))
    stray = []
    for a, change in zip(stated.records, list_changes(stated, campaign, "clean"), strict=True):
        slope = np.gradient(a.clean[:, : scale.size] / scale, axis=0)[:, 0]
        steep = np.abs(slope) > 0.5 * np.abs(slope).max()
        stray.append(change[steep, 0] / slope[steep])
    stray = np.concatenate(stray)
    assert np.std(stray) == pytest.approx(done["share"], rel=0.2) and np.abs(stray).max() < 0.4


# ---- marks ---------------------------------------------------------------------------------------------------------


GAUGE = {"bench": ["biased-gauge"], "told": ["gain"]}
ANSWERS = [
    (make_row(0, **GAUGE), True, False),
    (make_row(1, verdict="explained", found=["gain"], **GAUGE), True, False),
    (make_row(2, verdict="explained", found=["a"], others=["gain"], **GAUGE), True, False),
    (make_row(3, verdict="improved", found=["gain"], **GAUGE), False, True),
    (make_row(4, verdict="explained", found=["gain", "a"], **GAUGE), False, True),
    (make_row(5, verdict="explained", found=["a"], **GAUGE), False, True),
    (make_row(6, verdict="explained", found=["gain"], bench=["tails"]), False, True),
    (make_row(7, verdict="undecided", bench=["tails"]), False, False),
    (make_row(8, "one", "explained", ["a"], ["a", "gain"], **GAUGE), True, False),
    (make_row(9, "one", "explained", ["a"], ["a", "b"], **GAUGE), False, False),
    (make_row(10, "one", "explained", ["a"], ["gain"], **GAUGE), False, False),
    (make_row(11, "one", "explained", ["gain"], ["gain", "a"], **GAUGE), False, False),
    (make_row(12, verdict="unexplained", bench=["tails", "hum"]), False, True),
    (make_row(13, verdict="unexplained"), False, True),
    (make_row(14, verdict="explained", found=["gain", "ring"], bench=["ringing", "biased-gauge"],
              told=["gain", "ring"]), True, False),
]


def test_answers_on_benches_are_marked():
    """What says the same as the bench is right, where nothing is hidden and beside an effect; nothing else is."""
    for row, right, alarm in ANSWERS:
        assert (scoring.is_right(row), scoring.is_false_alarm(row)) == (right, alarm), row
        assert bool(scoring.describe_failure(row)) == (not right)


def test_benches_are_counted(tmp_path):
    """By kind, two together by themselves; in JSON and in the page, which says nothing of benches as stated."""
    exam = Exam("impact", 3, bench="drawn")
    card = write_scorecard(exam, [row for row, *_ in ANSWERS], tmp_path)
    counts = {name: {key: (share.count, share.total) for key, share in one.items()}
              for name, one in card["by_bench"].items()}  # fmt: skip
    assert {name: one["false_alarms"] for name, one in counts.items()} == {
        "biased-gauge": (3, 6), "tails": (1, 2), "two together": (1, 2), "stated": (1, 1)}
    assert counts["biased-gauge"]["singles_right"] == (1, 4) and counts["tails"]["undecided"] == (1, 2)
    assert card["command"].endswith("--bench drawn --cases 15 -o DIR") and card["exam"]["bench"] == "drawn"
    kept = json.loads((tmp_path / "scorecard.json").read_text(encoding="utf-8"))
    assert kept["by_bench"]["tails"]["false_alarms"]["upper"] == pytest.approx(scoring.count_share([1, 0]).upper)
    assert next(one for one in kept["failures"] if one["case"] == 12)["bench"] == ["tails", "hum"]
    readme = (tmp_path / "README.md").read_text(encoding="utf-8")
    assert "## Benches" in readme and "tails and hum" in readme
    write_scorecard(Exam("impact", 3), [make_row(0)], tmp_path)
    assert "## Benches" not in (tmp_path / "README.md").read_text(encoding="utf-8")


def test_a_folder_holds_one_bench(tmp_path):
    """An exam of a stated bench goes on in a folder of before benches; another bench is refused there."""
    examine(Exam("slip", 1), [0], tmp_path, workers=1, work=finish)
    assert "bench" not in json.loads((tmp_path / "exam.json").read_text(encoding="utf-8"))["exam"]
    assert len(examine(Exam("slip", 1), [0, 1], tmp_path, workers=1, work=finish)) == 2
    with pytest.raises(InputError, match="bench is None there and 'tails' now"):
        examine(Exam("slip", 1, bench="tails"), [2], tmp_path, workers=1, work=finish)


def test_a_row_keeps_what_the_bench_did(tmp_path):
    """Two kinds together: each as it would be alone; the row makes the same case again."""
    exam = Exam("impact", 4, ("nothing",), "white", "none")
    case = dc.replace(sample_case(exam, 0), bench=("biased-gauge", "tails"))
    kept = json.loads(json.dumps(dc.asdict(case) | write_case(exam, case, tmp_path / "one")))
    assert set(kept["bench_details"]) == {"biased-gauge", "tails"} and kept["told"] == ["sensor-gain"]
    again = Case(**{field.name: kept[field.name] for field in dc.fields(Case)})
    write_case(exam, again, tmp_path / "two")
    alone = write_case(exam, dc.replace(case, bench=("biased-gauge",)), tmp_path / "three")
    assert alone["bench_details"]["biased-gauge"] == kept["bench_details"]["biased-gauge"]
    for name in ("records.csv", "samples.csv"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
