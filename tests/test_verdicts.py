"""What a verdict may claim: nothing held out where nothing can be, settings that swallow a misfit, one number each."""

import dataclasses as dc
import json
import math
from html import escape
from types import SimpleNamespace

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.exam import Exam
from ddetumble.exam.cases import sample_case, write_case
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.families import find_family
from ddetumble.inference.goodness import combine_p_values
from ddetumble.measurement.faults import Fault
from ddetumble.selection.discover import Conclusion, _conclude, _doubt_record, _is_unrepeated, list_exact
from ddetumble.selection.lack_of_fit import is_moved, measure_shifts
from ddetumble.selection.result import MissingForce
from ddetumble.selection.settings import DEFAULT
from tests.helpers_ranking import check_ranking


BASE = {"effective_mass": 1.2, "restitution": 0.85}
PRESSURES, SPEEDS = [0.5e6, 1.0e6, 1.6e6, 2.4e6], [0.2, 0.4, 0.6]


def write(folder, effects, seed, pressures=PRESSURES, speeds=SPEEDS, repeats=2, base=BASE, **options):
    """A campaign of the independent simulator as a folder."""
    write_package(folder, make_campaign("tests", seed, effects, base, pressures, speeds, repeats, **options))
    return folder


def list_held_out(found):
    """Every held-out error of a discovery."""
    return [one.heldout_nrmse for one in (*found.steps, *found.candidates)]


@pytest.mark.slow
@pytest.mark.parametrize(("effects", "verdict"), [
    ({}, "nothing-missing"),
    ({"sensor-lag": {"T": 4e-4}}, "undecided"),
    ({"sensor-gain": {"g": 1.05}, "sensor-lag": {"T": 8e-4}}, "undecided"),
])
def test_one_record_holds_nothing_out(tmp_path, effects, verdict):
    found = dd.discover(write(tmp_path / "one", effects, 3, [0.6e6], [0.6], 1))
    assert found.verdict == verdict and found.effects == ()
    assert all(map(math.isnan, list_held_out(found)))
    assert found.missing is None
    result = json.loads(found.save(tmp_path / "found").read_text())
    assert result["steps"][0]["heldout_nrmse"] is None and result["candidates"][0]["heldout_nrmse"] is None
    dd.report(found, tmp_path / "found")


@pytest.mark.slow
def test_evidence_within_one_condition(tmp_path):
    """Six records of one condition show a lag that no other effect comes near; no held-out number is given for it."""
    found = dd.discover(write(tmp_path / "six", {"sensor-lag": {"T": 1.2e-3}}, 5, [0.6e6], [0.6], 6))
    assert found.verdict == "explained" and found.effects == ("sensor-lag",)
    assert found.counts["conditions"] == 1 and all(map(math.isnan, list_held_out(found)))
    # The page says where the law of what it names comes from, and of that alone.
    page = dd.report(found, tmp_path / "found").read_text(encoding="utf-8")
    sources = {one.id: escape(one.reference) for one in found.best.problem.space.effects}
    assert [name for name, source in sources.items() if source in page] == list(found.effects)


@pytest.mark.slow
def test_settings_that_swallow_a_misfit(tmp_path):
    """A force that depends on pressure in another way, and pressures that move by many stated deviations for it."""
    folder = write(tmp_path / "swallow", {"x-pressure-power": {"s": -0.08}}, 7, repeats=1)
    found = dd.compare(folder)
    pressure = next(s for s in found.shifts if s.name == "initial_pressure")
    assert abs(pressure.largest) > 8.0 and pressure.rms > 4.0 and pressure.p_value < 1e-12
    assert found.lack_of_fit.rejected and found.lack_of_fit.settings_p_value < 1e-12
    # With the pressures as they are written down the model fails by far.
    assert found.nrmse < 1.1 * found.noise_nrmse and found.held_nrmse > 1.5 * found.noise_nrmse
    discovery = dd.discover(folder)
    assert discovery.verdict in ("improved", "unexplained")
    check_ranking(discovery)
    result = json.loads(discovery.save(tmp_path / "found").read_text())
    told = result["steps"][0]["nuisances"]["initial_pressure"]
    assert abs(told["largest_shift"]) > 8.0 and told["record"] in discovery.steps[0].traces[0].record + told["record"]
    # What goes on from it, a plan say, reads that from the file.
    assert dd.load(tmp_path / "found").misfit == pytest.approx(discovery.steps[-1].nrmse / discovery.noise_nrmse)
    dd.report(discovery, tmp_path / "found")
    assert (tmp_path / "found" / "figures" / "settings.png").exists()


@pytest.mark.slow
def test_settings_as_stated_raise_no_alarm(tmp_path):
    found = dd.compare(write(tmp_path / "null", {}, 8))
    assert not found.lack_of_fit.rejected and found.held_nrmse is None
    assert all(s.p_value > DEFAULT.level_each for s in found.shifts) and len(found.shifts) == 3


class Bench:
    """Records with stated deviations, for the shifts alone."""

    def __init__(self, count):
        self.count, self.keys = count, tuple(f"r{k}" for k in range(count))
        self.nuisances, self.starts = ("initial_pressure", "approach_speed", "time", "zero:normal_force"), ()
        self.stack = type("Stack", (), {"condition_sd": np.tile([5e3, 1e-3, 5e-5, 0.1], (count, 1))})


@pytest.mark.parametrize("count", [2, 8, 24])
def test_shifts_are_chance_as_often_as_stated(count):
    """Errors as stated: at most one set of records in 300 is said to have moved (binomial bound over 3,000 sets)."""
    generator, bench = np.random.default_rng(4), Bench(count)
    alarms = sum(is_moved(measure_shifts(bench, type("Fit", (), {"z": generator.standard_normal((count, 4))})))
                 for _ in range(3000))
    assert alarms <= 3000 * DEFAULT.level_each + 3.0 * math.sqrt(3000 * DEFAULT.level_each)


@pytest.mark.parametrize(("shifts", "moved"), [
    (np.full(24, 0.9), False), (np.full(24, 1.8), True), (np.where(np.arange(24) == 7, 25.0, 0.0), True),
    (np.where(np.arange(24) == 7, 3.0, 0.0), False),
])  # fmt: skip
def test_shifts_of_all_records_or_of_one_are_seen(shifts, moved):
    z = np.zeros((24, 4))
    z[:, 0] = shifts
    z[:, 3] = 50.0  # of a zero that moves: no setting
    found = measure_shifts(Bench(24), type("Fit", (), {"z": z}))
    assert is_moved(found) == moved and [s.name for s in found] == ["initial_pressure", "approach_speed", "time"]
    assert found[0].largest == shifts[np.argmax(np.abs(shifts))] and found[0].record == f"r{np.argmax(np.abs(shifts))}"


@pytest.mark.parametrize("values", [(0.2,), (0.004, 0.9, 0.9), (1e-9, 1.0)])
def test_smallest_of_several_p_values(values):
    assert combine_p_values(values) == pytest.approx(min(len(values) * min(values), 1.0))


@pytest.mark.parametrize(("verdict", "before", "times", "judged", "expected"), [
    ("unexplained", 0.9, 0.9, True, ("nothing-missing", True)), ("unexplained", 1.1, 1.1, True, ("undecided", True)),
    ("unexplained", 0.9, 0.9, False, ("undecided", True)), ("improved", 9.0, 0.9, True, ("explained", True)),
    ("improved", 1.0, 0.9, True, ("undecided", True)), ("improved", 9.0, 1.1, True, ("improved", False)),
    ("improved", 9.0, 0.9, False, ("improved", False)),
])
def test_noise_is_no_account_of_what_is_far_larger(monkeypatch, verdict, before, times, judged, expected):
    """What no force removes and nothing repeats is noise or settings, if it is not `far` above the noise; an effect
    that removes less than that may be noise, too."""
    steps = [SimpleNamespace(fitted=SimpleNamespace(solution=level * DEFAULT.far, effects=("drag",), merit=0.0))
             for level in ((before, times) if verdict == "improved" else (before,))]
    selection = SimpleNamespace(settings=DEFAULT, holds_out=True, reduce_chi2=lambda solution: solution,
                                find_effects=lambda effects: ())
    for name, answer in {"_decide": (verdict, [], steps, None), "_draw_force": object.__new__(MissingForce),
                         "is_unrelated": (True, judged), "find_rounding": None, "stand_in": ([], []),
                         "matches_effects": False, "_is_unrepeated": False}.items():
        monkeypatch.setattr(f"ddetumble.selection.discover.{name}", lambda *_, answer=answer: answer)
    path = SimpleNamespace(selection=selection, keep_physical=lambda: (steps, ()), steps=steps, visible=True,
                           ambiguous=False)
    end = _conclude(path, False, lambda *_: None)
    assert (end.verdict, end.irregular) == expected
    assert bool(end.dropped) == (verdict == "improved" and end.verdict == "undecided")


@pytest.mark.parametrize(("verdict", "times", "smooth", "loose", "few", "expected"), [
    ("unexplained", 0.9, 1e-9, (), True, True), ("improved", 0.9, 1e-9, (), True, True),
    ("unexplained", 0.9, 1e-9, (), False, False), ("unexplained", 1.1, 1e-9, (), True, False),
    ("explained", 0.9, 1e-9, (), True, False), ("explained", 0.9, 0.1, (), True, True),
    ("explained", 0.9, 1e-9, ("drag.k",), True, True), ("explained", 0.9, 1e-9, ("mass",), True, False),
    ("explained", 1.1, 0.1, ("drag.k",), True, False), ("explained", 0.9, 0.1, (), False, False),
    ("nothing-missing", 0.9, 0.1, (), True, False),
])
def test_few_records_do_not_tell_physics_from_the_bench(monkeypatch, verdict, times, smooth, loose, few, expected):
    """A misfit no larger than a bench makes stays open where nothing shows whether it repeats: if any is left, if only
    the settings showed it, or if the records do not fix the effect that removes it."""
    selection = SimpleNamespace(settings=DEFAULT, family=SimpleNamespace(free_running=False),
                                records=SimpleNamespace(are_values=False), reduce_chi2=lambda solution: solution,
                                measure_repeats=lambda solution: None if few else 0.5)
    steps = [SimpleNamespace(fitted=SimpleNamespace(solution=times * DEFAULT.far, effects=effects),
                             lack=SimpleNamespace(smooth_p_value=smooth)) for effects in ((), ("drag",))]
    monkeypatch.setattr("ddetumble.selection.discover.list_loose", lambda *_: loose)
    assert _is_unrepeated(selection, steps, verdict) is expected


@pytest.mark.parametrize(("verdict", "kind", "wander", "expected"), [
    ("unexplained", "doubtful", False, "undecided"), ("improved", "doubtful", True, "undecided"),
    ("explained", "doubtful", True, "explained"), ("nothing-missing", "doubtful", False, "nothing-missing"),
    ("nothing-missing", "doubtful", True, "undecided"), ("nothing-missing", "gain", True, "nothing-missing"),
    ("unexplained", "gain", False, "unexplained"),
])
def test_no_open_verdict_rests_on_one_record(verdict, kind, wander, expected):
    """Where one record that nothing repeats may be faulty, a misfit that nothing explains, or that only baselines that
    wander do, is undecided."""
    fault = Fault(kind, ("r3",), "", "", "", "", left_out=False)
    end = Conclusion(verdict, ["reference", "one"], ["somewhere"], "a force", None)
    found = _doubt_record(end, SimpleNamespace(faults=(fault,)), wander)
    assert found.verdict == expected
    assert (found.steps, found.where, found.missing) == (
        (["reference"], [], None) if expected == "undecided" else (end.steps, end.where, end.missing))


@pytest.mark.study
def test_a_gain_beyond_a_calibration_is_no_explanation(tmp_path):
    """A gauge that reads four tenths is a wrong range: the effect that would fit is not named."""
    campaign = dd.read_campaign(write(tmp_path / "null", {}, 21, repeats=1))
    force = campaign.samples["normal_force"] * 0.4
    found = dd.discover(dc.replace(campaign, samples=campaign.samples.assign(normal_force=force)))
    gain = next(c for c in found.candidates if c.effect == "sensor-gain")
    assert found.steps[0].lack_of_fit.rejected and "sensor-gain" not in found.effects
    assert gain.estimates["sensor-gain.g"].q975 < 0.5 and gain.text
    assert found.verdict != "explained" and any("sensor-gain.g" in doubt for doubt in found.doubts)
    assert json.loads(found.save(tmp_path / "found").read_text())["doubts"] == list(found.doubts)


@pytest.mark.study
def test_a_wrong_unit_is_asked_about_before_physics_is_named(tmp_path):
    wall = {"wall-stiffness": {"k_w": 1500.0}}
    campaign = dd.read_campaign(write(tmp_path / "wall", wall, 22, [0.5e6, 1.6e6], [0.2, 0.6], 1))
    pressure = campaign.records["initial_pressure"] * 10
    found = dd.discover(dc.replace(campaign, records=campaign.records.assign(initial_pressure=pressure)))
    assert found.verdict == "undecided" and found.effects == ()
    assert "initial_pressure in bar" in found.doubts[0] and found.doubts[0] in found.sentence


@pytest.mark.study
def test_another_reference_model_before_three_effects(tmp_path):
    """The paper's printed volume with a wall: the other reading of Eq. 2 and one effect, and no gas that nobody has."""
    wall = {"wall-stiffness": {"k_w": 30000.0, "q": 1.5}}
    found = dd.discover(write(tmp_path / "printed", wall, 31, base={**BASE, "doubled_core": True}))
    assert found.verdict == "explained" and found.effects == ("wall-stiffness",)
    assert found.model == "paper-doubled-core" and len(found.references) > 1


def test_settings_without_a_stated_uncertainty_are_named():
    """What counts as exact though it was measured is told apart from what is stated, and from the order of tests."""
    campaign = dd.read_campaign(dd.find_data() / "impact-b")
    assert list_exact(campaign) == []
    bare = {n: dc.replace(c, uncertainty=None) for n, c in campaign.conditions.items()}
    assert set(list_exact(dc.replace(campaign, conditions=bare))) == {"initial_pressure", "approach_speed"}


@pytest.mark.parametrize(("family", "there", "named", "not_named"), [
    ("impact", ["normal_force"], ["depression", "pressure"], []),
    ("impact", ["normal_force", "depression"], ["pressure"], ["depression"]),
    ("impact", ["normal_force", "depression", "pressure"], ["speeds"], ["channel"]),
    ("oblique", ["normal_force", "tangential_force", "slip"], ["depression"], ["slip"]),
    ("tumble", ["angular_velocity_x", "attitude_w"], ["longer"], ["attitude"]), ("slip", [], ["loads"], ["channel"])])
def test_no_channel_that_a_campaign_has_is_suggested(family, there, named, not_named):
    told = find_family(family).suggest(there)
    assert all(name in told for name in named) and not any(name in told for name in not_named)


@pytest.mark.study
def test_wandering_baselines_beside_a_biased_pressure_are_no_filter(tmp_path):
    """Nothing hidden: a high-pass filter removes a little of it, and noise of no kind that is modelled stays."""
    exam = Exam("impact", 507, truths=("nothing",), bench="drawn")
    write_case(exam, sample_case(exam, 5), tmp_path)
    found = dd.discover(tmp_path)
    assert found.verdict == "undecided" and found.irregular and found.reason == "noise" and not found.effects
    assert [effect for effect, _ in found.dropped] == ["sensor-highpass"]
