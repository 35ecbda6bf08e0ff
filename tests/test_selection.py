"""Forward selection: it finds what is missing and nothing else, and every rule and threshold of it takes effect."""

import dataclasses as dc
import math
from types import SimpleNamespace

import numpy as np
import pytest
from helpers_statistics import (
    EFFECTS,
    SD,
    TIME,
    Bump,
    Echo,
    Ripple,
    Settling,
    assert_rate,
    fit_toy,
    make_selection,
    white,
)
from jaxtyping import Array
from scipy import stats

from ddetumble.contact.effect import parameter
from ddetumble.contact.law import Ball
from ddetumble.contact.sliding import RubberFriction
from ddetumble.effects import SensorLag, SensorResonance
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.inference.assembly import default_starts
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.smooth import smooth_bases
from ddetumble.inference.stack import Records
from ddetumble.measurement.package import read_campaign
from ddetumble.selection import forward_selection
from ddetumble.selection.cross_validation import compare_losses, forecast, leave_out
from ddetumble.selection.explanations import settle_rivals
from ddetumble.selection.forward_selection import (
    CandidateFits,
    FittedStep,
    Path,
    could_have_shown,
    find_alternatives,
    fit_with_shapes,
    has_physical_sign,
    is_beyond,
    list_starts,
    list_unphysical,
    predicts_better,
    prune,
    select_effects,
    try_effects,
)
from ddetumble.selection.lack_of_fit import Score, hold_settings, is_moved, judge_fit, measure_shifts
from ddetumble.selection.problem import PredictionError, fit_reference, pose_selection
from ddetumble.selection.settings import SelectionSettings


def search(seed=1, truth=(), report=lambda text, share: None, **options):
    selection, fitted = fit_toy(make_selection(seed, truth, **options))
    return select_effects(selection, fitted, report)


def effects_of(path):
    return path.steps[-1].fitted.effects


def test_a_complete_model_is_rejected_at_the_stated_level():
    """At a level of 5 % and the stated one, of 200 campaigns; the three statistics share it (Bonferroni)."""
    p_values, three = [], []
    for seed in range(200):
        selection, fitted = fit_toy(make_selection(seed))
        lack, _ = selection.test_lack_of_fit(fitted)
        p_values.append(lack.p_value)
        three.append((lack.smooth_p_value, lack.score_p_value, lack.settings_p_value))
        assert lack.rejected == (lack.p_value < 0.01) and lack.level == 0.01
        assert lack.p_value == pytest.approx(min(3.0 * min(three[-1]), 1.0))
    p_values, three = np.array(p_values), np.array(three)
    for level in (0.01, 0.05, 0.2):
        allowed = 200 * level + 3.0 * np.sqrt(200 * level * (1.0 - level)) + 1.0
        assert np.sum(p_values < level) <= allowed
    for level in (0.1, 0.5):  # each of its own
        assert_rate(int(np.sum(three[:, 0] < level)), 200, level)
        assert np.sum(three[:, 1] < level) <= 200 * level + 4.0 * np.sqrt(200 * level)
        assert_rate(int(np.sum(three[:, 1] < level)), 200, 0.7 * level)  # two of the four look alike


def test_nothing_is_added_to_a_complete_model():
    for seed in range(25):
        path = search(seed)
        assert effects_of(path) == () and path.is_explained() and path.visible


@pytest.mark.parametrize(("truth", "expected"), [
    ({"ripple.a": 0.5}, {"ripple"}), ({"bump.a": -0.5}, {"bump"}), ({"settling.a": 0.4}, {"settling"}),
    ({"echo.a": -0.5}, {"echo"}), ({"ripple.a": 0.5, "bump.a": 0.5}, {"ripple", "bump"}),
    ({"settling.a": -0.4, "bump.a": 0.5}, {"settling", "bump"}),
    ({"ripple.a": 0.5, "settling.a": 0.3}, {"ripple", "settling"})])
def test_what_is_missing_is_found(truth, expected):
    """With its amplitude within four standard deviations, and a cross-validated error that falls at every step."""
    path = search(1, truth)
    last = path.steps[-1]
    assert set(last.fitted.effects) == expected and not last.lack.rejected and path.is_explained()
    solution = last.fitted.solution
    sd = np.sqrt(np.diag(solution.covariance()))
    for name, value in truth.items():
        k = solution.names.index(name)
        assert abs(solution.u[path.selection.space.index[name]] - value) < 4.0 * sd[k]
    errors = [path.selection.cross_validate(step.fitted) for step in path.steps]
    assert all(after <= before for before, after in zip(errors, errors[1:], strict=False)) and len(errors) > 1
    assert all(step.lack.rejected for step in path.steps[:-1])
    assert path.steps[0].fitted.effects == () and path.steps[0].tried is None
    assert path.tried.order and set(path.tried.screened) == {e.id for e in EFFECTS}


def test_no_step_raises_the_cross_validated_error():
    """Whatever else speaks for an addition; by a hundredth it may where its loss falls beyond chance: by at least nine
    noise variances, and by two standard errors over the conditions."""
    losses = {"far": np.full(8, 90.0), "little": np.full(8, 99.0), "one": np.r_[np.full(7, 100.0), 50.0],
              "before": np.full(8, 100.0)}

    def judge(error, loss, holds_out=True, unit=1.0):
        answers = {"before": PredictionError(np.full(8, 1.0 / 8), 0.95, losses["before"]),
                   "after": PredictionError(np.full(8, error**2 / 8), 0.95, losses[loss])}
        return predicts_better(SimpleNamespace(
            holds_out=holds_out, predict=lambda model, adjust: answers[model], groups=np.arange(8),
            settings=SelectionSettings(), disperse=lambda fitted: unit), "before", "after")

    assert judge(0.9, "before") and judge(1.0, "before") and judge(1.1, "before", holds_out=False)
    assert not judge(1.1, "far") and not judge(1.011, "far") and not judge(math.nan, "far")
    assert judge(1.009, "far") and not judge(1.009, "little") and not judge(1.009, "one")
    assert not judge(1.009, "far", unit=9.0) and not judge(1.009, "before")
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 0.5}))

    class Never(type(selection)):
        def predict(self, fitted, adjust=False):
            return PredictionError(np.full(1, 1.0 + len(fitted.effects)), 0.95)

    never = Never(**{f.name: getattr(selection, f.name) for f in dc.fields(selection)})
    path = select_effects(never, fitted)
    assert len(path.steps) == 1 and path.tried.order[0] == "ripple"


def test_progress_goes_on():
    """The share done never falls, and leaves room for what follows the selection."""
    shares = []
    search(1, {"ripple.a": 0.5, "bump.a": 0.5}, lambda text, share: shares.append(share))
    assert shares == sorted(shares) and 0.0 < shares[0] < shares[-1] <= 0.85 and len(set(shares)) > 5


@pytest.mark.parametrize("settings", [{"level": 0.0}, {"effects_before_rivals": 0}, {"significant": 1e6},
                                      {"significant": 1e6, "decisive": 1e9}])
def test_thresholds_that_keep_the_reference_model(settings):
    assert len(search(1, {"ripple.a": 0.5}).steps) == 2
    assert len(search(1, {"ripple.a": 0.5}, settings=SelectionSettings(**settings)).steps) == 1


def test_as_many_effects_as_are_allowed():
    truth = {"ripple.a": 0.5, "bump.a": 0.5}
    assert len(search(1, truth, settings=SelectionSettings(effects_before_rivals=1)).steps) == 2
    assert len(search(1, truth, settings=SelectionSettings(effects_before_rivals=2)).steps) == 3


def test_what_no_effect_explains_stays():
    def spoil(values, conditions):
        values[:, 0] += 0.3 * np.sin(29.0 * TIME) * ((TIME > 0) & (TIME < 1)) * np.resize([1.0, -1.0], 8)[:, None]
    path = search(1, spoil=spoil)
    assert effects_of(path) == () and path.steps[0].lack.rejected and not path.is_explained()


def test_of_look_alikes_both_are_named():
    """A weak ripple is told from its echo neither by fits nor by left-out conditions, from a bump it is."""
    path = search(3, {"ripple.a": 0.08})
    names = {effects_of(path)[0], *(name for name, *_ in path.steps[-1].alternatives)}
    assert names == {"ripple", "echo"}
    for name, difference, error in path.steps[-1].alternatives:
        assert not path.selection.settings.is_beaten(difference, error)
        last = path.steps[-1].tried
        losses = [last.refined[effect].loss for effect in (name, last.order[0])]
        assert (difference, error) == compare_losses(*losses, path.selection.groups)
    strong = search(3, {"ripple.a": 1.0})
    assert effects_of(strong) == ("ripple",) and strong.steps[-1].alternatives == ()
    easy = SelectionSettings(significant=2.0, decisive=2.0)
    loose = search(3, {"ripple.a": 0.2}, settings=SelectionSettings(significant=9.0, decisive=1e9))
    assert len(loose.steps[-1].alternatives) >= len(search(3, {"ripple.a": 0.2}, settings=easy).steps[-1].alternatives)


def test_amplitudes_and_their_starts():
    """A side that physics leaves open follows the score; of several scores that of the largest."""
    selection, _ = fit_toy(make_selection(1))
    assert selection.list_amplitudes("bump") == ["bump.a"]
    start, = list_starts(selection, "bump", [])
    assert start == pytest.approx({"bump.a": 0.15})

    def one(name, z):
        return Score(name.split(".")[0], name, {}, z, z, 1.0, 1.0, np.ones(1), 0)

    assert list_starts(selection, "bump", [one("bump.a", -1.0)])[0]["bump.a"] == pytest.approx(-0.15)
    largest = [one("bump.a", -3.0), one("bump.a", 2.0)]
    assert list_starts(selection, "bump", largest)[0]["bump.a"] == pytest.approx(-0.15)
    assert list_starts(selection, "bump", [one("bump.a", 0.0)])[0]["bump.a"] == pytest.approx(0.15)
    assert list_starts(selection, "bump", [one("echo.a", -3.0)])[0]["bump.a"] == pytest.approx(0.15)
    assert list_starts(selection, "ripple", [one("ripple.a", -3.0)])[0]["ripple.a"] == pytest.approx(0.15)


def test_starts_at_a_line_of_the_residuals():
    """An effect that names a frequency starts there, where there is one; others do not look at the line."""
    selection, _ = fit_toy(make_selection(1))

    class Campaign:
        space = ParameterSpace(Ball(), (SensorResonance, SensorLag))
        find_effect = staticmethod({e.id: e for e in (SensorResonance, SensorLag)}.get)
        list_amplitudes = staticmethod(lambda effect: [])

    own, line = list_starts(Campaign, "sensor-resonance", []), list_starts(Campaign, "sensor-resonance", [], 250.0)
    assert len({s["sensor-resonance.f_0"] for s in own}) == len(own)
    assert [s["sensor-resonance.f_0"] for s in line] == [pytest.approx(1.0 / 250.0)]
    assert line[0]["sensor-resonance.zeta"] == own[0]["sensor-resonance.zeta"]
    assert list_starts(Campaign, "sensor-lag", [], 250.0) == list_starts(Campaign, "sensor-lag", [])
    assert list_starts(selection, "bump", [], 250.0) == list_starts(selection, "bump", [])


def fit_with(selection, fitted, **values):
    """A fit with effects whose parameters start at given values."""
    start = {f"{name}.a": x for name, x in values.items()}
    return selection.fit(tuple(values), [start], fitted.solution.u, fitted.solution.z)


def test_a_wrong_sign_counts_as_absent():
    """A ripple below nought is not physical: it stays at the reference model's fit."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": -0.5}))
    wrong = fit_with(selection, fitted, ripple=-0.1)
    assert not has_physical_sign(selection, wrong, "ripple") and has_physical_sign(selection, fitted, "ripple")
    echo = fit_with(selection, fitted, echo=-0.1)
    assert has_physical_sign(selection, echo, "echo") and echo.solution.chi2 < fitted.solution.chi2 - 100.0
    scores = selection.test_lack_of_fit(fitted)[1]
    tried = try_effects(selection, fitted, scores)
    assert tried.screened["ripple"].solution is fitted.solution and tried.screened["ripple"].effects == ("ripple",)
    assert tried.order[0] == "echo" and sorted(tried.order) == sorted(e.id for e in EFFECTS)
    assert tried.before is fitted and "ripple" not in tried.refined
    right = fit_with(*fit_toy(make_selection(1, {"ripple.a": 0.5})), ripple=0.1)
    assert has_physical_sign(selection, right, "ripple")


def test_values_beyond_physics():
    """A ripple of 3 N, where at most 2 N are allowed: the step is taken back, and said to lie beyond."""
    path = search(1, {"ripple.a": 3.0}, effects=(Ripple, Settling))
    assert effects_of(path) == ("ripple",)
    steps, beyond = path.keep_physical()
    assert len(steps) == 1 and len(beyond) == 1 and not path.is_explained()
    one = beyond[0]
    assert (one.name, one.limits, one.reason, one.unit) == ("ripple.a", (0.0, 2.0), "so much is known", "N")
    assert one.low < one.estimate < one.high and 2.0 < one.low and one.estimate == pytest.approx(3.0, abs=0.1)
    half = (one.high - one.low) / 2.0
    sd = path.steps[-1].fitted.solution.covariance()[-1, -1] ** 0.5
    assert half == pytest.approx(1.96 * sd, rel=1e-3)
    fitted = path.steps[-1].fitted
    assert is_beyond(path.selection, path.steps[0].fitted, fitted) and not is_beyond(path.selection, fitted, fitted)
    inside = search(1, {"ripple.a": 1.9}, effects=(Ripple, Settling))
    assert inside.keep_physical() == (inside.steps, ()) and inside.is_explained()
    assert list_unphysical(inside.selection, inside.steps[-1].fitted.solution) == ()
    # An echo may do what a ripple may not: what helps within its limits goes first.
    assert effects_of(search(1, {"ripple.a": 3.0}))[0] == "echo"


def test_fewer_effects_are_enough_under_another_noise(monkeypatch):
    """A ripple and a faint settling in a noise three times as large as stated, which is only seen beside both: the
    ripple is enough. Where it is not seen then either, both stay."""
    size = [1.0]

    def measure(campaign, records, solution, settings, before):
        both = len(solution.names) == 5
        return {c: dc.replace(n, sd=SD[c] * (size[0] if both else 1.0)) for c, n in before.items()}

    monkeypatch.setattr(forward_selection, "measure_noise", measure)
    for size[0], expected in ((1.0, 2), (3.0, 1)):
        path = search(1, {"ripple.a": 1.0, "settling.a": 0.03}, effects=(Ripple, Settling), noise=3.0)
        assert effects_of(path)[0] == "ripple" and len(effects_of(path)) == expected
    assert path.is_explained()


class Bounded(Ripple):
    """A ripple whose fit ends at 3 N."""

    id = "ripple"
    a: Array = parameter("N", typical=0.5, bounds=(-1.0, 3.0), limits=(0.0, 2.0), limits_reason="so much is known")


@pytest.mark.parametrize(("value", "width", "beyond"), [
    (3.0, 1e-3, True), (3.0, 1e3, True), (2.5, 1e-3, True), (2.5, 1e3, False), (1.0, 1e3, False), (-1.0, 1e3, True)])
def test_a_value_that_is_stuck_beyond_physics_is_beyond(value, width, beyond):
    """At the end of what a fit may reach and beyond limits, however wide its interval; elsewhere the interval says."""
    selection, fitted = fit_toy(make_selection(1, effects=(Bounded,)))
    solution = fit_with(selection, fitted, ripple=0.5).solution
    u = solution.u.copy()
    u[selection.space.index["ripple.a"]] = value
    sd = float(np.sqrt(solution.covariance()[-1, -1]))
    scaled = solution.shared * np.where(np.arange(len(solution.names)) == len(solution.names) - 1, sd / width, 1.0)
    found = list_unphysical(selection, dc.replace(solution, u=u, shared=scaled))
    assert bool(found) is beyond and all(one.name == "ripple.a" for one in found)


def test_a_held_shape_is_freed_where_that_predicts_better():
    """The power of a bump: held at 1, which is right, or freed where it is 3; and then free in every further fit."""
    held, freed = search(1, {"bump.a": 1.0}), search(1, {"bump.a": 1.0, "bump.q": 3.0})
    assert "bump.q" not in held.steps[-1].fitted.solution.names and held.selection.freed == ()
    solution = freed.steps[-1].fitted.solution
    assert "bump.q" in solution.names and freed.selection.freed == ("bump.q",)
    assert solution.u[freed.selection.space.index["bump.q"]] == pytest.approx(3.0, abs=0.3)
    selection, fitted = fit_toy(make_selection(1, {"bump.a": 1.0, "bump.q": 3.0}))
    rough = fit_with(selection, fitted, bump=0.5)
    assert "bump.q" in fit_with_shapes(selection, rough, fitted, "bump").solution.names
    held = selection.free(["bump.q"]).hold("bump.q")
    assert "bump.q" not in fit_with_shapes(held, rough, fitted, "ripple").solution.names
    dear = dc.replace(selection, settings=SelectionSettings(significant=1e6))
    assert "bump.q" not in fit_with_shapes(dear, fit_with(dear, fitted, bump=0.5), fitted, "bump").solution.names


def make_step(selection, fitted):
    lack, scores = selection.test_lack_of_fit(fitted)
    return FittedStep(fitted, lack, scores)


def test_what_has_become_needless_is_taken_back():
    """An effect beside the true one goes, a true one stays; so does a shape."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 0.5}))
    both = fit_with(selection, fitted, settling=0.1, ripple=0.3)
    _, step = prune(selection, make_step(selection, both))
    assert step.fitted.effects == ("ripple",) and not step.lack.rejected
    assert not any(s.effect == "ripple" for s in step.scores) and any(s.effect == "settling" for s in step.scores)
    last = fit_with(selection, fitted, ripple=0.3, settling=0.1)
    assert prune(selection, make_step(selection, last))[1].fitted.effects == ("ripple",)
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 0.5, "settling.a": 0.4}))
    step = make_step(selection, fit_with(selection, fitted, settling=0.1, ripple=0.3))
    same, kept = prune(selection, step)
    assert kept is step and same is selection
    selection, fitted = fit_toy(make_selection(1, {"bump.a": 1.0, "ripple.a": 0.5}))
    wide = selection.free(["bump.q"])
    step = make_step(wide, fit_with(wide, fitted, bump=0.5, ripple=0.3))
    assert "bump.q" in step.fitted.solution.names
    narrow, kept = prune(wide, step)
    assert narrow.freed == () and kept.fitted.effects == ("bump", "ripple")
    assert "bump.q" not in kept.fitted.solution.names
    selection, fitted = fit_toy(make_selection(1, {"bump.a": 1.0, "bump.q": 3.0, "ripple.a": 0.5}))
    wide = selection.free(["bump.q"])
    step = make_step(wide, fit_with(wide, fitted, bump=0.5, ripple=0.3))
    assert prune(wide, step)[0].freed == ("bump.q",)


def test_finalists():
    """Those within `decisive` of the best, at most so many."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 0.5}))
    scores = selection.test_lack_of_fit(fitted)[1]

    def finalists(**settings):
        changed = dc.replace(selection, settings=SelectionSettings(**settings))
        return set(try_effects(changed, fitted, scores).refined)

    assert finalists(decisive=1e9) >= {"ripple", "echo", "settling"}
    assert finalists(decisive=1e9, finalists=1) == {"ripple", "bump"}  # of a bump a shape is still to be freed
    assert "settling" not in finalists() and "ripple" in finalists()


def test_whether_an_effect_could_have_shown():
    """Three times the noise over all samples, by what refits leave of its signature, against 4.5 standard errors."""
    selection, _ = fit_toy(make_selection(1))
    samples = 8 * len(TIME)
    limit = 4.5**2 / 9.0 / samples

    def one(effect, visible):
        return Score(effect, f"{effect}.a", {}, 0.0, 0.0, 1.0, visible, np.ones(1), 0)

    assert could_have_shown(selection, [one("ripple", 1.01 * limit)])
    assert not could_have_shown(selection, [one("ripple", 0.99 * limit), one("probe", 1.0)])
    assert not could_have_shown(selection, [])


def test_shifts_of_settings():
    """In stated deviations, with the record that moved furthest; what has none stated does not count."""
    selection, fitted = fit_toy(make_selection(1))
    shifts = measure_shifts(selection.records, fitted.solution)
    assert [s.name for s in shifts] == ["approach_speed", "initial_pressure", "time"]
    for k, shift in enumerate(shifts):
        z = fitted.solution.z[:, k]
        worst = int(np.argmax(np.abs(z)))
        assert (shift.largest, shift.record) == (pytest.approx(z[worst]), f"r{worst}")
        assert shift.rms == pytest.approx(np.sqrt(np.mean(z**2))) and not is_moved([shift])
        assert shift.p_value == pytest.approx(min(1.0, 2.0 * min(
            stats.chi2.sf(np.sum(z**2), 8), 16.0 * stats.norm.sf(np.abs(z[worst])))), rel=1e-6)
    deviations = np.array(selection.records.stack.condition_sd)
    deviations[:, 0], deviations[2:, 1] = 0.0, 0.0
    records = dc.replace(selection.records, stack=dc.replace(selection.records.stack, condition_sd=deviations))
    some = measure_shifts(records, fitted.solution)
    assert [s.name for s in some] == ["initial_pressure", "time"]
    assert some[0].rms == pytest.approx(np.sqrt(np.mean(fitted.solution.z[:2, 1] ** 2)))
    assert some[0].stated == pytest.approx(np.median(deviations[:2, 1]))
    named = dc.replace(selection.records, nuisances=("zero:normal_force", "drift:normal_force", "time"))
    assert [s.name for s in measure_shifts(named, fitted.solution)] == ["time"]
    assert [s.name for s in measure_shifts(dc.replace(selection.records, starts=("time",)), fitted.solution)] == [
        "approach_speed", "initial_pressure"]


def test_shifts_of_settings_that_are_let_scatter():
    """In stated deviations, not in those that the fit lets them have; their chance is that of the larger ones."""
    selection, fitted = fit_toy(make_selection(1))
    plain = measure_shifts(selection.records, fitted.solution)
    loose = selection.loosen({"approach_speed": 3.0})
    shifts = measure_shifts(loose.records, fitted.solution, {"approach_speed": 3.0})
    one, other = plain[0], shifts[0]
    assert other.stated == pytest.approx(one.stated) and other.p_value == pytest.approx(one.p_value)
    for part in ("rms", "largest"):
        assert getattr(other, part) == pytest.approx(3.0 * getattr(one, part))
    np.testing.assert_allclose(other.shifts, 3.0 * one.shifts)
    assert other.record == one.record and [s.rms for s in shifts[1:]] == [s.rms for s in plain[1:]]


def test_held_settings_leave_hum_and_the_time_to_move():
    """Readings' own parts are no settings."""
    selection, fitted = fit_toy(make_selection(1))
    humming = selection.restack({"normal_force": dc.replace(white(0.05), hum=((7.0, 0.1),))})
    solution = humming.repeat(fitted).solution
    held = hold_settings(humming.problem, solution)
    assert humming.records.nuisances[:3] == ("approach_speed", "initial_pressure", "time")
    assert not held.z[:, :2].any() and np.all(np.any(held.z[:, 2:] != 0.0, axis=0)) and held.z.shape[1] == 5


def test_settings_that_swallow_a_misfit_are_moved():
    def spoil(values, conditions):
        conditions["approach_speed"] *= np.resize([1.06, 0.94], 8)
    selection, fitted = fit_toy(make_selection(1, spoil=spoil))
    lack, _ = selection.test_lack_of_fit(fitted)
    assert lack.rejected and lack.settings_p_value < 1e-3
    assert is_moved(measure_shifts(selection.records, fitted.solution))
    assert not is_moved(measure_shifts(selection.records, fitted.solution), 0.0)
    held = hold_settings(selection.problem, fitted.solution)
    assert np.all(held.z[:, :2] == 0.0) and np.any(held.z[:, 2] != 0.0) and held.chi2 > fitted.solution.chi2 + 50.0


def test_lack_of_fit_counts_an_uncertain_level_of_the_noise():
    selection, fitted = fit_toy(make_selection(1))

    def judge(vagueness, p_value=1.0, **settings):
        noise = {"a": white(level=0.0), "b": white(level=vagueness)}
        return judge_fit(selection.problem, fitted.solution, selection.bases, noise, p_value,
                         SelectionSettings(**settings))

    sharp, vague = judge(0.0), judge(0.5)
    n, ratio = sharp.degrees, sharp.statistic
    for found, level in ((sharp, 0.0), (vague, 0.5)):
        assert found.smooth_p_value == pytest.approx(stats.norm.sf(
            (np.log(ratio) + 1.0 / n) / np.sqrt(2.0 / n + level**2)), rel=1e-9)
    assert judge(0.0, 0.003).rejected and not judge(0.0, 0.0034).rejected
    assert not judge(0.0, 0.003, level=0.001).rejected
    assert judge(0.0, 0.003).p_value == pytest.approx(0.009) and judge(0.0, 0.003).score_p_value == 0.003


def test_splines_lie_over_the_contact_and_after_it():
    """Whitened as the residuals are; zero before first touch."""
    selection, fitted = fit_toy(make_selection(1, channels=("normal_force", "depression")))
    bases = smooth_bases(selection.problem, fitted.solution.end)
    assert len(bases) == 8
    block = bases[0].toarray()
    assert block.shape[0] == 2 * len(TIME) and block.shape[1] % 2 == 0
    half = block.shape[1] // 2
    assert not block[: len(TIME), half:].any() and not block[len(TIME):, :half].any()
    rows = block[: len(TIME), :half].sum(axis=1)  # B-splines add up to one
    inside = (TIME > 0) & (TIME <= 1)
    assert rows[inside] == pytest.approx(1.0 / 0.05) and not rows[TIME < 0].any()
    assert block[len(TIME):, half:].sum(axis=1)[inside] == pytest.approx(1.0 / 2e-4)


def test_records_that_run_on_are_forecast():
    """A quarter of a left-out record gives its nuisances; the loss of the rest counts for the whole record."""
    generator = np.random.default_rng(0)
    count, rows, own = 4, 40, 2
    time = np.tile(np.linspace(2.0, 4.0, rows), (count, 1))
    selection, fitted = fit_toy(make_selection(1))
    shared, nuisances = generator.standard_normal((count, rows, 1)), generator.standard_normal((count, rows, own))
    nuisances[0, 30:] = shared[0, 30:] = 0.0  # samples that are not there
    residual = generator.standard_normal((count, rows)) * np.any(nuisances != 0, axis=2)
    solution = dc.replace(fitted.solution, names=("p",), u=np.zeros(1), z=np.zeros((count, own)), scales=np.ones(1),
                          residual=residual, shared=shared, own=nuisances, prior_residual=np.zeros(1),
                          prior_weight=np.zeros(1))
    records = Records(tuple("abcd"), ("x",), ("u", "v"), np.full(count, rows), np.ones((count, 1), bool),
                      SimpleNamespace(time=time), "impact")
    for share in (0.25, 0.5):
        found = forecast(records, solution, np.arange(count), share)
        columns, side = solution.projected()
        for r in range(count):
            kept = np.arange(count) != r
            a, b = columns[kept].reshape(-1), side[kept].ravel()
            # The full fit counts as stationary, which this one is not: the step is that of taking the record out.
            step = columns[r, :, 0] @ side[r] / (a @ a)
            assert b.size == a.size
            moved = residual[r] + shared[r, :, 0] * step
            early = time[r] <= 2.0 + share * 2.0
            matrix = np.concatenate([nuisances[r][early], np.eye(own)])
            z = np.linalg.lstsq(matrix, -np.append(moved[early], np.zeros(own)), rcond=None)[0]
            used = np.any(nuisances[r] != 0, axis=1)
            rest = (moved + nuisances[r] @ z)[~early & used]
            assert found[r] == pytest.approx(np.mean(rest**2) * used.sum(), rel=1e-9)



def test_alternatives_within_physics_alone():
    """An alternative that needs values beyond physics, or does nothing, is none."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 3.0}, effects=(Ripple, Echo, Bump)))
    echo, ripple = fit_with(selection, fitted, echo=1.0), fit_with(selection, fitted, ripple=1.0)
    bump = dc.replace(fitted, effects=("bump",))
    near = dc.replace(ripple, loss=echo.loss + 0.1)
    tried = SimpleNamespace(order=("echo", "ripple", "bump"), screened={}, refined={
        "echo": echo, "ripple": near, "bump": bump})
    assert find_alternatives(selection, tried, fitted) == ()
    tried.refined["ripple"] = dc.replace(echo, loss=echo.loss + 0.1)
    (name, difference, error), = find_alternatives(selection, tried, fitted)
    assert name == "ripple" and difference == pytest.approx(0.8) and error == pytest.approx(0.0, abs=1e-9)
    tried.refined["ripple"] = dc.replace(echo, loss=echo.loss + 10.0)
    assert find_alternatives(dc.replace(selection, bases=()), tried, fitted) == ()
    # The best itself leaves a misfit, in which such a difference is no large one.
    assert selection.disperse(echo) > 2.0 and len(find_alternatives(selection, tried, fitted)) == 1


def test_the_last_physical_step_is_kept():
    """Of a path whose second effect lies beyond physics, the first; of one whose first does, the reference model."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 3.0, "settling.a": 0.4}))
    steps = tuple(make_step(selection, f) for f in (
        fitted, fit_with(selection, fitted, settling=0.3), fit_with(selection, fitted, settling=0.3, ripple=1.0)))
    kept, beyond = Path(selection, steps, None, True).keep_physical()
    assert kept == steps[:2] and [x.name for x in beyond] == ["ripple.a"]


def test_a_loss_that_one_step_puts_far_off_is_that_of_a_fit(tmp_path):
    """Five strokes of which one alone tells two effects of the speed apart: a Gauss-Newton step without it ends where
    the friction is another, the fit without it predicts it to the noise."""
    base = {"adhesion_constant": 0.8, "loss_factor": 0.15, "slip_scale": 1.0}
    made = make_slip_campaign("few", 4, {"stribeck": {"A": 0.3, "u_s": 0.05}}, base, [5.0, 12.0, 20.0, 28.0],
                              [0.8e6, 1.9e6], [0.02, 0.1], length=8e-3)
    write_package(tmp_path, made)
    whole = read_campaign(tmp_path)
    tests = whole.records[["normal_load", "internal_pressure", "slip_speed"]].to_numpy() / [1.0, 1e6, 1.0]
    wanted = [(5.0, 0.8, 0.02), (12.0, 1.9, 0.02), (20.0, 0.8, 0.1), (28.0, 1.9, 0.1), (12.0, 0.8, 0.1)]
    kept = [whole.record_keys[int(np.argmin(np.sum((tests / one - 1.0) ** 2, axis=1)))] for one in wanted]
    few = whole.select([key for key in whole.record_keys if key in kept])
    selection, reference = fit_reference(pose_selection(few, RubberFriction()))
    both = ("stribeck", "viscous-friction")
    start = {k: v for effect in both for k, v in default_starts(selection.find_effect(effect))[0].items()}
    fitted = selection.fit(both, [start], reference.solution.u, reference.solution.z)
    linear, count = leave_out(fitted.solution, selection.groups), selection.records.used.sum() / 5.0
    far = linear > 1e3 * count
    assert far.sum() == 1 and np.all(fitted.loss < 2.0 * count)
    np.testing.assert_array_equal(fitted.loss[~far], linear[~far])
    loose = selection.fit(both, [start], reference.solution.u, reference.solution.z, screening=True)
    np.testing.assert_array_equal(loose.loss, leave_out(loose.solution, selection.groups))
    assert selection.refit_far_off(loose).score < 0.1 * max(loose.score, 20.0 * count)


@pytest.mark.parametrize(("size", "told_apart"), [(0.03, False), (0.6, True)])
def test_rivals_of_an_earlier_step_have_what_was_added_since(size, told_apart):
    """An echo in place of the ripple, beside the settling that came after both, where what was left out does nothing:
    a rival while the ripple is small, none any more where left-out conditions speak against it by then.
    """
    truth = {"ripple.a": size, "settling.a": 0.5}
    selection, reference = fit_toy(make_selection(1, truth, effects=(Ripple, Echo, Settling)))
    ripple, echo = (selection.extend(reference, (effect,)) for effect in ("ripple", "echo"))
    both = selection.extend(ripple, ("ripple", "settling"))
    tried = CandidateFits({}, {"ripple": ripple, "echo": echo}, reference, ("ripple", "echo"))
    later = CandidateFits({}, {"settling": both}, ripple, ("settling",))
    steps = [FittedStep(reference, None, []), FittedStep(ripple, None, [], tried, (("echo", 0.0, 1.0),)),
             FittedStep(both, None, [], later)]
    kept, rivals = settle_rivals(selection, steps)
    alone = selection.extend(reference, ("echo", "settling"))  # the fit of these two from nothing
    worse, error = compare_losses(alone.loss, both.loss, selection.groups)
    assert (worse > selection.settings.significant and worse > 2.0 * error) == told_apart
    assert [[effect for effect, _, _ in step.alternatives] for step in kept] == [[], [] if told_apart else ["echo"], []]
    assert len(rivals) == (not told_apart)
    for rival in rivals:
        assert rival.effects == ("echo", "settling")
        ripples = [slot.owner == "ripple" for slot in selection.space.slots]
        assert rival.solution.u[ripples] == selection.start[ripples]
        assert rival.solution.chi2 == pytest.approx(alone.solution.chi2, rel=1e-6)
    assert settle_rivals(selection, steps[:2]) == (steps[:2], [echo])
    # What was exchanged since is none of the last model's, whatever was said of it.
    gone = selection.extend(reference, ("settling",))
    assert settle_rivals(selection, [*steps[:2], FittedStep(gone, None, [], later)])[1] == []
