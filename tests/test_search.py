"""The rules of the search on hand-made fits: what is fitted again, exchanged, passed over or taken back; its end."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest
from helpers_statistics import EFFECTS, TIME, Ripple, Settling, fit_toy, make_selection

from ddetumble.selection import forward_selection
from ddetumble.selection.effort import count_round, limit_effort, may_search
from ddetumble.selection.forward_selection import (
    CandidateFits,
    FittedStep,
    Path,
    add_effect,
    allow_scatter,
    allow_wander,
    exchange_effects,
    extend_path,
    free_held,
    list_unphysical,
    pass_over,
    prune,
    refine,
    select_effects,
    skip_worse,
    try_effects,
)
from ddetumble.selection.lack_of_fit import Score
from ddetumble.selection.problem import Fitted
from ddetumble.selection.settings import SelectionSettings


NAMES = tuple(e.id for e in EFFECTS)


def fake(chi2, score=None, effects=("a",), names=("p", "q"), converged=True):
    """A model of which no more is known than its misfit, its loss and whether its fit came to an end."""
    loss = np.full(4, (chi2 if score is None else score) / 4.0)
    solution = SimpleNamespace(chi2=chi2, converged=converged, names=names, failed=(), u=np.zeros(3))
    return Fitted(effects, solution, loss, loss)


class Bench:
    """A choice of models whose fits are looked up: `ends` by the effects of a model, the fit that it ends in."""

    def __init__(self, ends=None, held=None, **settings):
        self.ends, self.held, self.settings = ends or {}, held or {}, SelectionSettings(**settings)
        self.groups, self.thin, self.asked = np.arange(4), None, []
        self.family = SimpleNamespace(free_running=False)

    def extend(self, fitted, effects, u=None, **options):
        """The fit that is looked up."""
        self.asked.append((tuple(effects), options))
        key = (*effects, *options.get("extra", ()))
        return self.ends.get(key, self.ends.get(tuple(effects)) if not options.get("extra") else None)

    def list_held(self, effect):
        """Shapes that are held."""
        return self.held.get(effect, [])

    def disperse(self, fitted):
        """No misfit is left."""
        return 1.0


def finish(screened, before, **settings):
    """Which candidates are fitted to the end."""
    bench = Bench({one.effects: one for one in screened.values()}, **settings)
    order = sorted(screened, key=lambda e: screened[e].merit)
    return bench, refine(bench, fake(1000.0), screened, before, order)


def test_who_is_fitted_to_the_end():
    """Those within `decisive` of the best; within a quarter of its gain where a fit is still on its way; who fits far
    better, or has come far and is not at the end, although it predicts worse; who fits as well; nobody that does
    nothing."""
    before = fake(1000.0)
    screened = {
        "best": fake(500.0, 500.0, ("best",)), "near": fake(560.0, 549.0, ("near",)),
        "far": fake(560.0, 551.0, ("far",)), "going": fake(620.0, 624.0, ("going",), converged=False),
        "lost": fake(640.0, 626.0, ("lost",), converged=False), "better": fake(300.0, 800.0, ("better",)),
        "little": fake(440.0, 900.0, ("little",)), "runner": fake(440.0, 910.0, ("runner",), converged=False),
        "walker": fake(460.0, 920.0, ("walker",), converged=False), "worse": fake(509.5, 910.0, ("worse",)),
        "nothing": dc.replace(before, effects=("nothing",), loss=np.full(4, 125.0))}
    _, found = finish(screened, before)
    assert set(found) == {"best", "near", "going", "better", "runner", "little", "walker"}
    assert all(found[name] is screened[name] for name in found)
    assert set(finish(screened, before, further_finalists=1)[1]) == {"best", "near", "going", "better", "little"}
    assert set(finish(screened, before, finalists=1)[1]) == {"best", "better", "runner", "little", "walker"}
    alike = {"best": screened["best"], "worse": screened["worse"], "like": fake(508.5, 910.0, ("like",))}
    assert set(finish(alike, before)[1]) == {"best", "like"}
    assert set(finish(screened, before, finalists=0, further_finalists=0)[1]) == {"best"}
    small = {"best": fake(960.0, 960.0, ("best",)), "going": fake(990.0, 1005.0, ("going",), converged=False)}
    assert set(finish(small, before)[1]) == {"best", "going"}  # `decisive` is more than a quarter of little


def test_a_candidate_without_a_fit_counts_as_absent():
    """One whose fit broke down or ended above the model without it stands at that model; of all, shapes are tried."""
    before, current = fake(1000.0), fake(1000.0)
    rough = {name: fake(500.0 + k, effects=(name,)) for k, name in enumerate("abc")}
    for name in "de":
        rough[name] = fake(900.0, effects=(name,))
    rough["f"] = dc.replace(before, effects=("f",))
    bench = Bench({("a",): fake(400.0, effects=("a",)), ("b",): fake(1001.0, effects=("b",)), ("d",): fake(800.0)},
                  held={"d": ["d.q"], "f": ["f.q"]})
    found = refine(bench, current, rough, before, list("abcdef"))
    assert set(found) == {"a", "b", "c", "d"} and found["a"].solution.chi2 == 400.0
    assert found["b"].solution is current.solution is found["c"].solution and found["b"].effects == ("a", "b")
    nothing = {name: dc.replace(before, effects=(name,)) for name in "ab"}
    bench = Bench()
    only = refine(bench, current, nothing, before, ["a", "b"])
    assert list(only) == ["a"] and only["a"].solution is current.solution and not bench.asked


def test_held_shapes_are_freed_one_after_another():
    """The best first, each only where it brings more than its own price and `significant`; what breaks down is not."""
    start = fake(100.0, effects=("a",), names=("a.x",))
    one = fake(70.0, effects=("a",), names=("a.x", "a.q"))
    other = fake(60.0, effects=("a",), names=("a.x", "a.r"))
    both = fake(30.0, effects=("a",), names=("a.x", "a.r", "a.q"))
    ends = {("a", "a.q"): one, ("a", "a.r"): other, ("a", "a.r", "a.q"): both}
    bench = Bench(ends, {"a": ["a.q", "a.r", "a.s"]})
    assert free_held(bench, start, "a") is both
    # A parameter costs 9, and has to bring 9 more.
    for gain, freed in ((17.0, False), (19.0, True)):
        less = fake(60.0 - gain, effects=("a",), names=("a.x", "a.r", "a.q"))
        assert free_held(Bench({**ends, ("a", "a.r", "a.q"): less}, bench.held), start, "a") is (
            less if freed else other)
    assert free_held(Bench({("a", "a.q"): fake(83.0, names=("a.x", "a.q"))}, bench.held), start, "a") is None
    assert free_held(Bench(ends), start, "a") is None and free_held(Bench({}, bench.held), start, "a") is None


class Scripted:
    """A toy whose fits of one added effect are looked up: `script` by effect, a list of ends in the order asked for."""

    def __init__(self, script, scores=()):
        selection, self.fitted = fit_toy(make_selection(1))
        self.asked, self.further = [], []
        outer = self

        class Toy(type(selection)):
            def fit(self, effects, starts, base, z, **options):
                own = sum(e == effects[-1] for e, _ in outer.asked)
                outer.asked.append((effects[-1], starts[0]))
                return outer.make(script.get(effects[-1], ["end"] * 9)[own], effects)

            def extend(self, fitted, effects, u=None, **options):
                outer.further.append((effects[-1] if effects else None, options))
                if effects and options.get("thinned"):
                    return outer.make(script[f"{effects[-1]} further"][0], effects)
                return fitted

        self.selection = Toy(**{f.name: getattr(selection, f.name) for f in dc.fields(selection)})
        self.scores = [Score(n.split(".")[0], n, shapes, z, step, 1.0, 1.0, np.ones(1), 0)
                       for n, shapes, z, step in scores]

    def make(self, what, effects):
        """A fit: None, or how far chi-square is from that of the model without the effect, and whether it converged."""
        if what is None:
            return None
        change, converged = (-100.0, True) if what == "end" else what
        solution = dc.replace(self.fitted.solution, chi2=self.fitted.solution.chi2 + change, converged=converged)
        loss = self.fitted.loss + change / len(self.fitted.loss)
        return Fitted(tuple(effects), solution, loss, loss)

    def run(self, effects=NAMES, **changes):
        """All candidates tried."""
        catalogue = tuple(effect for effect in EFFECTS if effect.id in effects)
        return try_effects(dc.replace(self.selection, catalogue=catalogue, **changes), self.fitted, self.scores)


def test_a_second_start_where_the_first_led_astray():
    """One step from the null of the direction that scores most, at its shapes; where a sign is left to physics, only on
    that side, and never where the first fit is no worse than without the effect."""
    scores = [("ripple.a", {}, 3.0, -0.2), ("echo.a", {}, 2.0, 0.5), ("echo.a", {}, -4.0, -0.7),
              ("bump.a", {"bump.q": 2.0}, 4.0, 0.3), ("settling.a", {}, 5.0, 0.4)]
    bench = Scripted({"ripple": [None], "echo": [(1.5, True), "end"], "bump": [None, "end"], "settling": [(0.5, True)]},
                     scores)
    shares, told = [], []

    def report(text, share):
        shares.append(share)
        told.append(text)

    found = try_effects(bench.selection, bench.fitted, bench.scores, report)
    assert "ripple" in told[0] and "1 of 4" in told[0] and "4 of 4" in told[3]
    assert shares == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0, 1.0, 1.0])
    bump = {"bump.q": 2.0, "bump.a": pytest.approx(0.3)}
    assert bench.asked[4:] == [("echo", {"echo.a": pytest.approx(-0.7)}), ("bump", bump)]
    lower = bench.fitted.solution.chi2
    assert found.screened["echo"].solution.chi2 == pytest.approx(lower - 100.0)
    assert found.screened["ripple"].solution is bench.fitted.solution  # absent
    assert found.screened["settling"].solution is bench.fitted.solution  # above it, and absent, too
    assert found.screened["settling"].effects == ("settling",)
    up = Scripted({"ripple": [None, "end"]}, [("ripple.a", {}, 3.0, 0.2)])
    assert up.run(["ripple"]).order == ("ripple",) and up.asked[1] == ("ripple", {"ripple.a": pytest.approx(0.2)})
    none = Scripted({"ripple": [None]})
    assert none.run(["ripple"]).screened["ripple"].solution is none.fitted.solution


def test_a_fit_on_its_way_from_far_off_goes_on():
    """Where no start of the effect has come below the model without it, and this one had not ended."""
    bench = Scripted({"ripple": [(50.0, False)], "ripple further": [(-30.0, True)], "echo": [(50.0, True)],
                      "bump": [(0.0, False)], "settling": [(-1.0, False)]})
    found = bench.run()
    assert [e for e, options in bench.further if options.get("thinned")] == ["ripple"]
    assert found.screened["ripple"].solution.chi2 == pytest.approx(bench.fitted.solution.chi2 - 30.0)
    assert found.screened["echo"].solution is bench.fitted.solution


def test_candidates_stand_in_the_order_of_their_merit():
    """Those fitted to the end first; ones that do nothing last, however they stand in the catalogue."""
    gains = {"ripple": -20.0, "echo": -60.0, "bump": None, "settling": -90.0}
    bench = Scripted({name: [None if g is None else (g, True)] * 3 for name, g in gains.items()})
    found = bench.run()
    assert found.order[:3] == ("settling", "echo", "ripple") and found.order[3] == "bump"
    assert found.before is bench.fitted and set(found.screened) == set(NAMES)


def test_candidates_are_compared_with_what_they_were_screened_beside():
    """On thinned records the model without the effect is fitted to these, too."""
    bench = Scripted({})
    found = bench.run(["ripple"], thin=bench.selection.problem)
    assert bench.further[0] == (None, {"screening": True}) and found.before is bench.fitted
    shares = []
    try_effects(bench.selection, bench.fitted, (), lambda text, share: shares.append(share))
    assert shares == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0])


def test_the_best_is_passed_over():
    """The next of those fitted to the end, what is beyond physics last; then of those screened; at last nobody."""
    selection, fitted = fit_toy(make_selection(1))
    fits = {name: dc.replace(fitted, effects=(name,), loss=fitted.loss + k, solution=dc.replace(fitted.solution))
            for k, name in enumerate("abcd")}
    fits["d"] = dc.replace(fitted, effects=("d",))
    tried = CandidateFits(fits, {n: fits[n] for n in "acb"}, fitted, ("a", "c", "b", "d"))
    after = pass_over(selection, fitted, tried)
    assert after.order == ("b", "c") and set(after.refined) == {"b", "c"} and after.screened is fits
    last = pass_over(selection, fitted, dc.replace(after, order=("b",)))
    assert last is None
    assert pass_over(selection, fitted, dc.replace(tried, order=("a", "d"))) is None


def test_what_predicts_worse_by_itself_is_skipped(monkeypatch):
    """Up to the next that predicts better, or to one that helps no more, with which the search ends."""
    selection, fitted = fit_toy(make_selection(1))
    fits = {name: dc.replace(fitted, effects=(name,), loss=fitted.loss + k, solution=dc.replace(fitted.solution))
            for k, name in enumerate("abcd")}
    tried, asked = CandidateFits(fits, fits, fitted, tuple("abcd")), []
    monkeypatch.setattr(forward_selection, "helps", lambda s, current, grown: grown.effects != ("d",))
    for better, first, looked in (("b", "b", "b"), ("c", "c", "bc"), ("", "d", "bc"), ("ad", "d", "bc")):
        asked.clear()
        monkeypatch.setattr(forward_selection, "predicts_better", lambda s, current, grown, better=better: (
            asked.append(grown.effects[0]) or grown.effects[0] in better))
        rest = skip_worse(selection, fitted, tried)
        assert rest.order[0] == first and "".join(asked) == looked
    monkeypatch.setattr(forward_selection, "helps", lambda s, current, grown: True)
    monkeypatch.setattr(forward_selection, "predicts_better", lambda s, current, grown: False)
    assert skip_worse(selection, fitted, tried) is None


def test_a_search_ends_with_its_rounds(monkeypatch):
    """A first round is always done; what would take another is left out by name, once, and nothing is of a search
    that comes to its end in time."""
    additions = [("a", 500.0, True), ("ab", 300.0, True), ("abc", 200.0, False)]
    for limit, expected in ((1, ["", "a"]), (2, ["", "a", "ab"]), (3, ["", "a", "ab", "abc"])):
        steps = Steps(monkeypatch, additions)
        counted = forward_selection.try_effects
        monkeypatch.setattr(forward_selection, "try_effects", lambda *given, counted=counted: (
            count_round(), counted(*given))[1])
        with limit_effort(limit) as effort:
            count_round()  # beside the reference model
            assert effects_of(steps.run()) == expected
            assert not may_search("x") if limit == effort.done else may_search("x")
        assert effort.done == limit and len(effort.left_out) == (2 if limit < 3 else 1)
    assert may_search("anything outside")


class Steps:
    """A search whose additions are told beforehand, and what it does with each."""

    def __init__(self, monkeypatch, additions, worse=(), noise=(), **settings):
        self.additions, self.asked, self.passed = list(additions), [], []
        monkeypatch.setattr(forward_selection, "add_effect", self.add)
        monkeypatch.setattr(forward_selection, "try_effects", lambda s, current, scores, report: tuple(
            e.id for e in s.catalogue if e.id not in current.effects))
        monkeypatch.setattr(forward_selection, "predicts_better", lambda s, current, grown: (
            grown.effects not in worse and (grown.effects, s.name) not in worse))
        monkeypatch.setattr(forward_selection, "skip_worse", lambda s, current, tried: tried[1:] or None)
        levels = iter(noise)
        monkeypatch.setattr(forward_selection, "measure_noise", lambda *given: next(levels, given[-1]))
        monkeypatch.setattr(forward_selection, "changed", lambda before, after, settings: before != after)
        monkeypatch.setattr(forward_selection, "has_more_hum", lambda before, after: after == "hum")
        self.selection = self.pose("first", "white", SelectionSettings(**settings))

    def pose(self, name, noise, settings):
        """The problem under a noise, which its fits are told by."""
        @dc.dataclass(frozen=True)
        class Posed:
            name: str
            noise: str
            settings: SelectionSettings
            catalogue: tuple = tuple(SimpleNamespace(id=n) for n in "abcd")
            campaign: object = None
            records: object = dc.field(default_factory=lambda: SimpleNamespace(are_values=False))

            def restack(self, noise):
                return dc.replace(self, name=f"{self.name} {noise}")

            def repeat(self, fitted):
                return dc.replace(fitted, solution=SimpleNamespace(chi2=fitted.solution.chi2, under=self.name))

            def span(self, solution):
                return self

            def test_lack_of_fit(self, fitted):
                return SimpleNamespace(rejected=True), []
        return Posed(name, noise, settings)

    def add(self, selection, current, tried, report=None):
        """The next addition."""
        self.asked.append((current.fitted.effects, tried))
        effects, score, rejected = self.additions.pop(0) if self.additions else (None, 0.0, False)
        if effects is None:
            return selection, None
        return selection, FittedStep(fake(score, effects=tuple(effects)), SimpleNamespace(rejected=rejected), [])

    def run(self, most=3, rejected=True):
        """The search from a reference model."""
        start = FittedStep(fake(1000.0, effects=()), SimpleNamespace(rejected=rejected), [])
        return extend_path(Path(self.selection, (start,), ("d", "a", "b", "c"), True), most)


def effects_of(path):
    return ["".join(step.fitted.effects) for step in path.steps]


def test_additions_follow_each_other_until_no_misfit_is_left(monkeypatch):
    """The first among those tried already, the next among what is not yet in the model; none of a complete model."""
    steps = Steps(monkeypatch, [("a", 500.0, True), ("ab", 300.0, False), ("abc", 200.0, False)])
    path = steps.run()
    assert effects_of(path) == ["", "a", "ab"]
    assert steps.asked == [((), ("d", "a", "b", "c")), (("a",), ("b", "c", "d"))]
    assert effects_of(Steps(monkeypatch, [("a", 500.0, True), ("ab", 300.0, True)]).run(1)) == ["", "a"]


def test_the_search_ends_with_the_catalogue(monkeypatch):
    """Where every effect is in and a misfit is left, there is nothing more to try."""
    all_in = [("a", 500.0, True), ("ab", 400.0, True), ("abc", 300.0, True), ("abcd", 200.0, True)]
    assert effects_of(Steps(monkeypatch, all_in).run(6)) == ["", "a", "ab", "abc", "abcd"]
    assert effects_of(Steps(monkeypatch, [("a", 500.0, True)]).run(rejected=False)) == [""]
    assert effects_of(Steps(monkeypatch, []).run()) == [""]


@pytest.mark.parametrize(("score", "expected"), [(992.0, ["992"]), (990.0, ["990", "a"])])
def test_a_reference_model_that_went_on_replaces_itself(monkeypatch, score, expected):
    """An addition that was taken back again left a better fit of the same model: by nine, and the search goes on."""
    steps = Steps(monkeypatch, [((), score, True), ("a", 500.0, False)])
    path = steps.run()
    assert [f"{s.fitted.solution.chi2:.0f}" if not s.fitted.effects else "a" for s in path.steps] == expected
    assert len(steps.asked) == len(expected) and (len(expected) == 1 or steps.asked[1][1] == tuple("abcd"))


def test_what_predicts_worse_is_passed_over(monkeypatch):
    """The next candidate takes its place, until there is none."""
    steps = Steps(monkeypatch, [("d", 500.0, True), ("a", 600.0, False)], worse={("d",)})
    assert effects_of(steps.run()) == ["", "a"]
    assert [tried for _, tried in steps.asked] == [("d", "a", "b", "c"), ("a", "b", "c")]
    steps = Steps(monkeypatch, [(name, 500.0, True) for name in "dabc"], worse={(n,) for n in "abcd"})
    assert effects_of(steps.run()) == [""] and len(steps.asked) == 4


@pytest.mark.parametrize(("noise", "under", "left"), [
    ((), "first", 0), (("red",), "first red", 0), (("red", "blue"), "first red", 1),
    (("hum", "red", "blue"), "first hum red", 1), (("hum", "hum", "hum"), "first hum", 2)])
def test_another_noise_under_the_better_model(monkeypatch, noise, under, left):
    """Every step is fitted and judged again under it; a further look only where hum was seen for the first time."""
    path = Steps(monkeypatch, [("a", 500.0, False)], noise=noise).run()
    assert path.selection.name == under and effects_of(path) == ["", "a"]
    if noise:
        assert {step.fitted.solution.under for step in path.steps} == {under}
        assert all(step.lack.rejected for step in path.steps)
        assert path.selection.noise == noise[len(noise) - 1 - left]


def test_values_bear_fewer_effects(monkeypatch):
    """Records of one value a channel, however many are asked for: as many as the settings have it."""
    for allowed, expected in ((1, ["", "a"]), (2, ["", "a", "ab"])):
        steps = Steps(monkeypatch, [("a", 500.0, True), ("ab", 300.0, True), ("abc", 200.0, True)],
                      effects_of_values=allowed)
        steps.selection.records.are_values = True
        assert effects_of(steps.run(3)) == expected


def test_a_step_that_predicts_worse_under_another_noise_goes(monkeypatch):
    path = Steps(monkeypatch, [("a", 500.0, True), ("ab", 300.0, True)], noise=("red",),
                 worse={(("a",), "first red")}).run()
    assert effects_of(path) == [""] and path.selection.name == "first red"


def fit_with(selection, fitted, **values):
    """A fit with effects whose parameters start at given values."""
    return selection.fit(tuple(values), [{f"{n}.a": x for n, x in values.items()}], fitted.solution.u,
                         fitted.solution.z)


def judged(selection, fitted):
    """A step with its judgement."""
    lack, scores = selection.test_lack_of_fit(fitted)
    return FittedStep(fitted, lack, scores)


def test_an_earlier_choice_is_exchanged_for_the_better_pair():
    """Of ripple and settling, with a bump in the place of the first: the true pair is found from there, and kept where
    it is chosen already."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 0.5, "settling.a": 0.4}))
    base = fit_with(selection, fitted, bump=0.1)
    wrong, right = (fit_with(selection, fitted, **{n: 0.1, "settling": 0.3}) for n in ("bump", "ripple"))
    tried = SimpleNamespace(order=("settling",))
    _, chosen, candidates, start = exchange_effects(selection, wrong, tried, base)
    assert set(chosen.effects) == {"ripple", "settling"} and chosen.merit == pytest.approx(right.merit, abs=0.1)
    assert start.effects == ("settling",) and candidates.order[0] == "ripple"
    assert exchange_effects(selection, right, tried, base)[1:] == (right, tried, base)


def test_an_effect_that_helps_is_added_and_one_that_does_not_is_none():
    """With the alternatives to it, fitted to the end; a shape that is needed comes free."""
    bump = {"bump.a": 1.0, "bump.q": 3.0}
    for truth, expected in (({}, None), ({"settling.a": 0.4}, ("settling",)), (bump, ("bump",))):
        selection, fitted = fit_toy(make_selection(1, truth))
        step = judged(selection, fitted)
        tried = try_effects(selection, fitted, step.scores)
        wider, more = add_effect(selection, step, tried)
        if expected is None:
            assert more is None and wider is selection
            continue
        assert more.fitted.effects == expected and more.tried is tried and not more.lack.rejected
        assert wider.freed == (("bump.q",) if "bump.q" in truth else ())
        assert more.fitted.solution.chi2 <= tried.refined[expected[0]].solution.chi2 + 1e-6


@pytest.mark.parametrize(("change", "failed", "kept", "again"), [
    (-0.5, (), "new", False), (-2.0, (), "new", True), (5e-4, (), "new", False), (0.1, (), "old", False),
    (-2.0, ("r0",), "old", False)])
def test_the_last_refit_of_a_step(change, failed, kept, again):
    """It takes the place of the fit, unless it broke down; by a noise variance or more, the step is judged again."""
    selection, fitted = fit_toy(make_selection(1, {"settling.a": 0.4}))
    judgements = []

    class Toy(type(selection)):
        def repeat(self, fitted, tolerance=1e-4):
            return dc.replace(fitted, solution=dc.replace(fitted.solution, chi2=fitted.solution.chi2 + change,
                                                          failed=failed))

        def test_lack_of_fit(self, fitted):
            judgements.append(fitted.solution.chi2)
            return super().test_lack_of_fit(fitted)

    toy = Toy(**{f.name: getattr(selection, f.name) for f in dc.fields(selection)})
    step = judged(selection, fitted)
    tried = try_effects(selection, fitted, step.scores)
    same, more = add_effect(toy, step, tried)
    old = tried.refined["settling"].solution.chi2
    assert same.freed == () and more.fitted.effects == ("settling",)
    assert more.fitted.solution.chi2 == pytest.approx(old + (change if kept == "new" else 0.0), abs=1e-9)
    assert judgements == [old, old + change] if again else judgements == [old]


def test_lines_are_looked_for_where_an_effect_has_one(monkeypatch):
    """Only then, and what is found goes into its starts."""
    bench, asked = Scripted({}), []
    monkeypatch.setattr(forward_selection, "find_line", lambda *given: asked.append("line") or 7.0)
    monkeypatch.setattr(forward_selection, "list_starts", lambda s, e, scores, line: asked.append(line) or [{}])
    bench.run(["ripple"])
    assert asked == [None]
    monkeypatch.setattr(Settling, "line", "settling.a")
    bench.run(["ripple", "settling"])
    assert asked[1:] == ["line", 7.0, 7.0]


def test_what_a_fit_went_on_to_find_stays_although_its_effect_goes():
    """The last effect is taken back where the model without it, from there on, is no worse by nine noise variances."""
    selection, fitted = fit_toy(make_selection(2, {"settling.a": 0.4}))
    both = fit_with(selection, fitted, settling=0.3, bump=0.05)
    _, step = prune(selection, judged(selection, both))
    assert step.fitted.effects == ("settling",)
    three = fit_with(selection, fitted, bump=0.05, ripple=0.05, settling=0.3)
    assert prune(selection, judged(selection, three))[1].fitted.effects == ("settling",)
    alone = judged(selection, fit_with(selection, fitted, settling=0.3))
    assert prune(selection, alone)[1] is alone


def test_values_beyond_physics_are_listed_by_their_interval():
    """Only what lies beyond with all of its 95 % interval; both ends of it in the parameter's unit."""
    selection, fitted = fit_toy(make_selection(1, {"ripple.a": 2.02}))
    near = fit_with(selection, fitted, ripple=1.0)
    k = selection.space.index["ripple.a"]
    sd = np.sqrt(near.solution.covariance()[-1, -1])
    for distance, beyond in ((1.9, False), (2.1, True), (0.0, False)):
        u = near.solution.u.copy()
        u[k] = 2.0 + distance * sd
        found = list_unphysical(selection, dc.replace(near.solution, u=u))
        assert len(found) == beyond
        assert not found or (found[0].low, found[0].high) == (pytest.approx(u[k] - 1.96 * sd, rel=1e-4),
                                                              pytest.approx(u[k] + 1.96 * sd, rel=1e-4))


def scatter(size, order=None):
    """Speeds that differ from what is written down by so much, at random or in the order of the speeds."""
    def spoil(values, conditions):
        errors = size * np.random.default_rng(5).standard_normal(len(conditions["approach_speed"]))
        conditions["approach_speed"] *= np.exp(np.sort(errors) if order else errors)
    return spoil


def search(seed=1, truth=(), **options):
    """The path of a toy."""
    selection, fitted = fit_toy(make_selection(seed, truth, **options))
    return select_effects(selection, fitted)


TWICE = {"conditions": [(v, p) for v in (1.0, 1.4, 1.8, 2.2) for p in (1e5, 1.6e5)] * 2, "effects": (Ripple, Settling)}


def test_settings_that_scatter_more_than_stated_explain_a_misfit():
    """By the factor that they do, and no effect is needed; without a misfit the path stays as it is."""
    path = search(spoil=scatter(0.06), **TWICE)
    assert path.steps[0].lack.rejected
    found = allow_scatter(path)
    assert found is not path and effects_of(found) == [""] and not found.steps[-1].lack.rejected
    assert list(found.selection.spread) == ["approach_speed"]
    assert found.selection.spread["approach_speed"] == pytest.approx(6.0, rel=0.5)
    quiet = search(**TWICE)
    assert allow_scatter(quiet) is quiet


def test_settings_that_go_as_the_conditions_do_are_no_scatter():
    """Physics moves them alike at like conditions: the path stays."""
    path = search(spoil=scatter(0.06, "sorted"), effects=(Ripple, Settling), conditions=sorted(TWICE["conditions"]))
    assert path.steps[-1].lack.rejected and allow_scatter(path) is path


@dc.dataclass(frozen=True)
class Loose:
    """A choice of models whose settings are said to scatter so much, one estimate after another."""

    estimates: list
    random: bool = True
    spread: dict = dc.field(default_factory=dict)
    settings: SelectionSettings = SelectionSettings()

    def estimate_spread(self, fitted):
        """The next."""
        return self.estimates.pop(0)

    def loosen(self, spread):
        """With settings that scatter so much."""
        return dc.replace(self, spread=dict(spread))

    def is_scatter(self, fitted):
        """Whether at random."""
        return self.random

    def repeat(self, fitted):
        """The same fit."""
        return fitted

    def span(self, solution):
        """The same."""
        return self


@pytest.mark.parametrize(("estimates", "options", "spread"), [
    ([{"v": 3.0}, {"v": 3.5}], {}, 3.0),  # less than by 1.3 from what it was
    ([{"v": 3.0}, {"v": 4.5}, {"v": 4.6}], {}, 4.5),
    ([{"v": 2.0}, {"v": 4.0}, {"v": 8.0}, {"v": 16.0}], {}, 8.0),  # three searches
    ([{"v": 4.0}, {}, {}], {}, None),  # it stood for an effect that was found then
    ([{}], {}, None), ([{"v": 1.2}], {}, None),
    ([{"v": 3.0}, {"v": 3.0}], {"random": False}, None), ([{"v": 3.0}, {"v": 3.0}], {"left": True}, None),
    ([{"v": 3.0}], {"would": False}, None), ([], {"rejected": False}, None)])
def test_the_search_under_another_scatter_of_settings(monkeypatch, estimates, options, spread):
    """Repeated while the estimate beside the effects found still changes; kept if at random and nothing is left."""
    def step(rejected):
        return FittedStep(fake(100.0), SimpleNamespace(rejected=rejected), [])

    path = Path(Loose(list(estimates), options.get("random", True)), (step(options.get("rejected", True)),), None, True)
    monkeypatch.setattr(forward_selection, "_would_do", lambda selection, fitted: options.get("would", True))
    monkeypatch.setattr(forward_selection, "select_effects", lambda selection, reference, report: Path(
        selection, (step(True), step(options.get("left", False))), None, True))
    found = allow_scatter(path)
    assert (found is path) == (spread is None)
    assert found.selection.spread == ({} if spread is None else {"v": spread})


@pytest.mark.parametrize(("rejected", "estimates", "expected"), [
    ([False], [], True), ([True], [{}], False), ([True], [{"v": 1.5}], False), ([True, False], [{"v": 2.0}], True),
    ([True, True], [{"v": 2.0}], False)])
def test_whether_another_scatter_would_do(rejected, estimates, expected):
    """As it is, or with the scatter that is estimated then, where that is another."""
    verdicts = list(rejected)

    class Judge(Loose):
        def repeat(self, fitted, tolerance):
            return fitted

        def test_lack_of_fit(self, fitted):
            return SimpleNamespace(rejected=verdicts.pop(0)), []

    assert forward_selection._would_do(Judge(list(estimates), spread={"v": 1.5}), fake(100.0)) is expected
    assert not verdicts


def wander(values, conditions):
    """Baselines that wander by 0.3 N over a second."""
    generator, step = np.random.default_rng(6), TIME[1] - TIME[0]
    for record in values[:, 0]:
        x = 0.3 * generator.standard_normal()
        for k in range(len(TIME)):
            record[k] += x
            x = x * np.exp(-step) + 0.3 * np.sqrt(1.0 - np.exp(-2.0 * step)) * generator.standard_normal()


def test_baselines_that_wander_explain_a_misfit():
    """Of the size that they have, and no effect is needed; without a misfit, or in one that repeats, the path stays."""
    path = search(spoil=wander, **TWICE)
    assert path.steps[-1].lack.rejected
    found = allow_wander(path)
    noise = found.selection.noise["normal_force"]
    assert found is not path and effects_of(found) == [""] and not found.steps[-1].lack.rejected
    assert noise.slow_sd == pytest.approx(0.3, rel=0.4)
    quiet = search(**TWICE)
    assert allow_wander(quiet) is quiet

    def wave(values, conditions):
        values[:, 0] += 0.3 * np.sin(29.0 * TIME) * ((TIME > 0) & (TIME < 1))

    path = search(spoil=wave, **TWICE)
    assert path.steps[-1].lack.rejected and allow_wander(path) is path
    few = search(spoil=wander, effects=(Ripple, Settling), conditions=TWICE["conditions"][:7])  # too few to see repeats
    assert few.steps[-1].lack.rejected and allow_wander(few) is few
