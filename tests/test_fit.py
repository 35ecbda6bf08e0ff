"""Fits of campaigns made by the independent simulator: truth in the intervals, bounds, priors, what is confounded."""

import dataclasses as dc
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import ddetumble as dd
from ddetumble._errors import InputError
from ddetumble.cli import main
from ddetumble.cli.options import read_source
from ddetumble.exam.cases import Exam, sample_case, write_case
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.inference.bounded import truncate_normal
from ddetumble.inference.estimation import fit
from ddetumble.inference.goodness import judge_goodness
from ddetumble.inference.problem import Problem
from ddetumble.inference.specification import read_specification
from ddetumble.inference.stack import hold_conditions, stack_records
from ddetumble.measurement.faults import screen_samples
from ddetumble.measurement.package import read_campaign
from ddetumble.measurement.units import Uncertainty
from ddetumble.selection.problem import pose_selection


ROOT = Path(__file__).resolve().parent.parent
BASE = {"effective_mass": 1.3, "restitution": 0.7}
PLAN = dict(pressures=[6e5, 1.6e6], speeds=[0.3, 0.55], repeats=2, interval=8e-4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("fit") / "wall"
    made = make_campaign("wall", 11, {"wall-stiffness": {"k_w": 1500.0}}, BASE, **PLAN)
    write_package(place, made)
    return place


@pytest.fixture(scope="module")
def campaign(folder):
    return read_campaign(folder)


@pytest.fixture(scope="module")
def fitted(campaign):
    return fit(campaign, effects=["wall-stiffness"])


def test_settings_that_made_up_for_an_effect_do_not_hold_its_fit(tmp_path):
    """The reference model makes up for a strong dashpot by time origins far from where they were."""
    base = {"effective_mass": 1.5, "restitution": 0.67}
    plan = dict(pressures=[6e5, 1.6e6], speeds=[0.2, 0.5], interval=4e-4)
    write_package(tmp_path / "c", make_campaign("c", 1, {"viscous-dashpot": {"c_v": 47.0}}, base, **plan))
    found = fit(tmp_path / "c", effects=["viscous-dashpot"])
    assert found.chi2_reduced < 1.2
    for name, value in {**base, "viscous-dashpot.c_v": 47.0}.items():
        assert abs(found.parameters[name].estimate - value) < 4.0 * found.parameters[name].sd


@pytest.mark.slow
def test_what_is_known_of_an_effect_is_held_where_the_model_has_it(tmp_path):
    """An amplifier's filter of stated corner: in a fit, in a selection beside other effects, and not without it."""
    made = make_campaign("filtered", 3, {"sensor-filter": {"f_c": 200.0}}, BASE, **PLAN)
    write_package(tmp_path, dc.replace(made, known={**made.known, "sensor-filter.f_c": "200 Hz"}))
    filtered, model = read_campaign(tmp_path), dd.Ball() + dd.effects.SensorFilter(1.0 / 350.0)
    found = fit(filtered, model)
    assert found.fixed["sensor-filter.f_c"] == pytest.approx(200.0)
    assert set(found.parameters) == {"effective_mass", "restitution"} and found.chi2_reduced < 1.2
    freed = fit(filtered, model, free=["sensor-filter.f_c"]).parameters["sensor-filter.f_c"]
    assert freed.q025 - 10.0 < 200.0 < freed.q975 + 10.0
    posed = pose_selection(filtered, model.reference, (), model.effects)
    place = posed.space.index["sensor-filter.f_c"]
    assert posed.start[place] == pytest.approx(1.0 / 200.0) and "sensor-filter.f_c" not in posed.base
    assert dd.effects.SensorFilter not in posed.catalogue
    plain = pose_selection(filtered, model.reference)
    assert plain.start[place] == 0.0 and dd.effects.SensorFilter in plain.catalogue


@pytest.mark.slow
def test_intervals_hold_the_truth(fitted, tmp_path):
    truth = BASE | {"wall-stiffness.k_w": 1500.0}
    inside = total = 0
    for seed in (12, 13):
        place = tmp_path / str(seed)
        write_package(place, make_campaign("c", seed, {"wall-stiffness": {"k_w": 1500.0}}, BASE, **PLAN))
        result = fit(place, effects=["wall-stiffness"])
        for found in (result, fitted) if seed == 12 else (result,):
            assert found.converged and 0.8 < found.chi2_reduced < 1.25
            for name, value in truth.items():
                p = found.parameters[name]
                total += 1
                inside += p.q025 <= value <= p.q975
                assert abs(p.estimate - value) < 4 * p.sd
    assert inside >= total - 1


def test_report_reads_like_lmfit(fitted):
    text = str(fitted)
    for part in ("[[Fit Statistics]]", "# fitting method     = Levenberg-Marquardt", "reduced chi-square",
                 "[[Variables]]", "+/-", "(init = ", "[[Correlations]] (unreported correlations are < 0.100)",
                 "outer_diameter:"):
        assert part in text
    assert fitted.parameters["effective_mass"].unit == "kg"
    assert json.loads(json.dumps(fitted.to_dict()))["parameters"]["effective_mass"]["q025"] > 1


def test_a_model_that_lacks_something_is_said_not_to_fit(campaign, fitted):
    """Without the wall that is there the settings make up for it, or more than noise is left; with it neither."""
    assert not fitted.goodness.misfit and not fitted.goodness.moved and not str(fitted.goodness)
    bare = fit(campaign)
    assert bare.goodness.moved and bare.nuisances[bare.goodness.record][bare.goodness.setting]["pull"] == max(
        (one["pull"] for own in bare.nuisances.values() for one in own.values()), key=abs)
    held = fit(campaign, nuisances=False)
    assert held.goodness.misfit and not held.goodness.moved and held.goodness.setting == ""
    for found in (bare, held):
        assert str(found.goodness) in str(found)
        stored = json.loads(json.dumps(found.to_dict()))["goodness"]
        assert (stored["misfit"], stored["moved"]) == (found.goodness.misfit, found.goodness.moved)


@pytest.mark.parametrize(("chi2", "size", "misfit", "moved"), [
    (1000.0, 1.0, False, False), (1100.0, 1.0, False, False), (9000.0, 1.0, True, False), (1000.0, 4.0, False, True),
    (9000.0, 4.0, True, True),
])  # fmt: skip
def test_chance_and_more_than_chance(chi2, size, misfit, moved):
    generator = np.random.default_rng(3)
    shifts = {name: dict(zip("abcdefgh", size * generator.standard_normal(8), strict=True)) for name in ("p", "v")}
    found = judge_goodness(chi2, 1000, shifts)
    assert (found.misfit, found.moved) == (misfit, moved)
    assert abs(found.shift) == max(abs(x) for own in shifts.values() for x in own.values())
    assert found.shift == shifts[found.setting][found.record]


def test_few_degrees_of_freedom_prove_little():
    assert not judge_goodness(6.0, 3, {}).misfit and judge_goodness(40.0, 3, {}).misfit


def test_lmfit_finds_the_same(campaign):
    import lmfit
    found = fit(campaign, effects=["wall-stiffness"], noise="stated", nuisances=False)
    problem = Problem(found.space, hold_conditions(stack_records(campaign)))
    names = list(found.parameters)
    places = [found.space.index[n] for n in names]

    def residual(parameters):
        u = found.solution.u.copy()
        u[places] = [math.log(parameters["m"].value), math.log(parameters["e"] / (1 - parameters["e"])),
                     parameters["k"].value]
        return problem.solve(names, u, found.solution.z, moving=False).residual.ravel()

    parameters = lmfit.Parameters()
    parameters.add("m", 1.31, min=0.5, max=3.0)
    parameters.add("e", 0.705, min=0.2, max=0.95)
    parameters.add("k", 1450.0)
    theirs = lmfit.minimize(residual, parameters, scale_covar=False, xtol=1e-10, ftol=1e-10, epsfcn=1e-8)
    for mine, key in zip(names, "mek", strict=True):
        assert theirs.params[key].value == pytest.approx(found.parameters[mine].estimate,
                                                         abs=0.02 * found.parameters[mine].sd)
        assert theirs.params[key].stderr == pytest.approx(found.parameters[mine].sd, rel=0.02)
    assert theirs.chisqr == pytest.approx(found.chi2, rel=1e-6)
    assert theirs.params["m"].correl["e"] == pytest.approx(found.correlations[0, 1], abs=0.02)


def test_fixed_values_stay_and_priors_pull(campaign, fitted):
    fixed = fit(campaign, effects=["wall-stiffness"], fixed={"effective_mass": 1.35})
    assert fixed.fixed["effective_mass"] == pytest.approx(1.35)
    assert "effective_mass" not in fixed.parameters and fixed.chi2 > fitted.chi2 + 10
    pulled = fit(campaign, effects=["wall-stiffness"], priors={"wall-stiffness.k_w": (1000.0, 1.0)})
    assert pulled.parameters["wall-stiffness.k_w"].estimate == pytest.approx(1000.0, abs=20)
    assert pulled.parameters["wall-stiffness.k_w"].sd == pytest.approx(1.0, rel=0.05)
    assert pulled.goodness.disputed == ("wall-stiffness.k_w",)
    weak = fit(campaign, effects=["wall-stiffness"], priors={"effective_mass": (1.0, 1e3)})
    assert weak.parameters["effective_mass"].estimate == pytest.approx(fitted.parameters["effective_mass"].estimate,
                                                                       rel=1e-6)
    assert weak.goodness.disputed == ()


def test_bounds_hold_and_are_said(campaign, fitted):
    stopped = fit(campaign, effects=["wall-stiffness"], bounds={"wall-stiffness.k_w": (0.0, 1200.0)})
    p = stopped.parameters["wall-stiffness.k_w"]
    assert p.at_bound == "upper" and p.estimate == pytest.approx(1200.0)
    assert p.q975 <= 1200.0 and p.q025 < p.q975 and p.sd < 100
    wide = fit(campaign, effects=["wall-stiffness"], bounds={"wall-stiffness.k_w": (0.0, 5000.0)})
    assert wide.parameters["wall-stiffness.k_w"].at_bound == ""
    assert wide.parameters["wall-stiffness.k_w"].estimate == pytest.approx(
        fitted.parameters["wall-stiffness.k_w"].estimate, rel=1e-5)


def test_a_cut_off_normal():
    sd, low, high = truncate_normal(-2.0, 1.0, 0.0, np.inf)
    draw = np.random.default_rng(1).normal(-2.0, 1.0, 2_000_000)
    draw = draw[draw > 0]
    assert sd == pytest.approx(draw.std(), rel=0.02)
    assert low == 0.0 and high == pytest.approx(np.quantile(draw, 0.95), rel=0.02)
    sd, low, high = truncate_normal(-50.0, 1.0, 0.0, np.inf)
    assert sd == pytest.approx(1 / 50) and low == 0.0 and high == pytest.approx(-np.log(0.05) / 50)
    assert truncate_normal(0.3, 1e9, 0.0, 2.0) == pytest.approx((2 / 12**0.5, 0.05, 1.95))
    # Well inside, the plain interval; in between, the shortest one that holds the share.
    assert truncate_normal(9.0, 1.0, 0.0, np.inf, 0.9)[1:] == pytest.approx((9 - 1.644854, 9 + 1.644854))
    for mean, level in ((1.2, 0.5), (0.4, 0.9), (2.2, 0.95)):
        _, low, high = truncate_normal(mean, 1.0, 0.0, np.inf, level)
        cut = stats.truncnorm(-mean, np.inf, loc=mean)
        assert cut.cdf(high) - cut.cdf(low) == pytest.approx(level)
        for shift in (1e-3, -1e-3):
            start = min(max(low + shift, 0.0), high)
            assert cut.ppf(min(cut.cdf(start) + level, 1.0)) - start >= high - low - 1e-9


def test_intervals_at_other_levels(fitted):
    p = fitted.parameters["wall-stiffness.k_w"]
    assert fitted.interval("wall-stiffness.k_w") == pytest.approx((p.q025, p.q975))
    low, high = fitted.interval("wall-stiffness.k_w", 0.5)
    assert (high - low) / (p.q975 - p.q025) == pytest.approx(stats.norm.ppf(0.75) / stats.norm.ppf(0.975), rel=1e-6)
    for name, level in (("nothing", 0.9), ("wall-stiffness.k_w", 1.0)):
        with pytest.raises(InputError):
            fitted.interval(name, level)


@pytest.mark.slow
def test_confounded_parameters_are_said_in_words(campaign):
    found = fit(campaign, "power-law", ["sensor-gain"], fixed={"condition_exponent": 1.0})
    trio = {"effective_mass", "stiffness_force", "sensor-gain.g"}
    assert not any(found.parameters[name].determined for name in trio)
    assert all(math.isinf(found.parameters[name].sd) for name in trio)
    assert found.parameters["restitution"].determined and found.parameters["exponent"].sd < 0.05
    assert all(name in found.cannot_tell_apart[0] for name in trio)
    plain = found.to_dict()["parameters"]["sensor-gain.g"]
    assert plain["sd"] is None and plain["determined"] is False


def test_nearly_confounded_parameters_name_a_test(campaign):
    found = fit(campaign, effects=["sensor-gain"], free=["contact_radius_coefficient"])
    assert found.parameters["sensor-gain.g"].determined
    assert found.cannot_tell_apart, str(found)
    assert "hard to distinguish" in found.cannot_tell_apart[0] and "sensor-gain.g" in found.cannot_tell_apart[0]
    assert any(word in found.cannot_tell_apart[0] for word in ("by a factor of", "and fix"))


def test_a_fit_goes_on_from_a_saved_one(campaign, fitted, tmp_path):
    fitted.save(tmp_path / "one")
    again = fit(campaign, tmp_path / "one")
    assert again.model == "paper" and again.effects == ("wall-stiffness",)
    assert again.chi2 == pytest.approx(fitted.chi2, rel=1e-6)
    assert again.parameters["wall-stiffness.k_w"].initial == pytest.approx(
        fitted.parameters["wall-stiffness.k_w"].estimate)


@pytest.mark.parametrize(("arguments", "part"), [
    (dict(effects=["wall-stifness"]), "did you mean wall-stiffness"),
    (dict(effects=["wall-stiffness"], free=["no_such"]), "no parameter 'no_such'"),
    (dict(free=["sensor-gain.g"]), "no parameter 'sensor-gain.g'"),
    (dict(free=["outer_diameter"], fixed={"outer_diameter": 0.06}), "both free and fixed"),
    (dict(fixed={"effective_mass": -1.0}), "positive"),
    (dict(fixed={"adhesion.tau_a": 1e4}), "adhesion"),  # of an effect that the model does not have
    (dict(fixed={"restitution": 1.5}), "between 0 and 1"),
    (dict(fixed={"effective_mass": 1.0, "restitution": 0.7}), "nothing is left to fit"),
    (dict(priors={"outer_diameter": (0.06, 0.001)}), "not fitted"),
    (dict(bounds={"effective_mass": (2.0, 1.0)}), "lower bound"),
    (dict(model="papper"), "did you mean paper"),
    (dict(model="power-law", effects=["polytropic-gas"]), "needs gas"),
])  # fmt: skip
def test_nonsense_is_refused_in_one_sentence(campaign, arguments, part):
    with pytest.raises(InputError) as caught:
        fit(campaign, **arguments)
    assert part in str(caught.value) and "\n" not in str(caught.value)


GOOD = 'schema = "ddetumble.fit/1"\ncampaign = "../wall"\n'


@pytest.mark.parametrize(("text", "parts"), [
    ("", ["schema"]),
    ('schema = "ddetumble.fit/9"\n', ["schema", "ddetumble.fit/9"]),
    ('schema = "ddetumble.fit/1"\n', ["campaign: is missing"]),
    ("schema = ", ["not a TOML"]),
    (GOOD.replace("../wall", "../nowhere"), ["campaign", "nowhere"]),
    (GOOD + "colour = 1\n", ["colour", "not a key", "campaign", "nuisances"]),
    (GOOD + 'effects = "adhesion"\n', ["effects"]),
    (GOOD + 'nuisances = "yes"\n', ["nuisances"]),
    (GOOD + "seed = -1\n", ["seed"]),
    (GOOD + '[fixed]\nrestitution = "0.7"\n', ["fixed.restitution", "number"]),
    (GOOD + "[priors]\nrestitution = { mean = 0.7 }\n", ["priors.restitution"]),
    (GOOD + "[priors]\nrestitution = { mean = 0.7, sd = -1.0 }\n", ["priors.restitution"]),
    (GOOD + "[bounds]\neffective_mass = [1.0]\n", ["bounds.effective_mass"]),
    (GOOD + '[sampler]\nname = "guess"\nwalkers = -1\n', ["sampler.name", "sampler.walkers"]),
    (GOOD + "[fixed]\nrestitution = nan\n", ["fixed.restitution"]),
])  # fmt: skip
def test_a_damaged_specification_is_one_sentence(folder, text, parts):
    path = folder.parent / "spec" / "fit.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_specification(path)
    message = str(caught.value)
    assert "fit.toml" in message and "\n" not in message
    assert all(part in message for part in parts), message


def test_a_specification_says_everything(folder, fitted, capsys):
    path = folder.parent / "named" / "fit.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(GOOD + 'effects = ["wall-stiffness"]\n[free]\nrestitution = 0.65\n[fixed]\n'
                    'wall-stiffness.q = 1.0\n[bounds]\n"effective_mass" = [0.5, 3]\n')
    assert main(["fit", str(path)]) == 0
    assert "[[Variables]]" in capsys.readouterr().out
    content = json.loads((path.parent / "fit.json").read_text())
    assert content["sha256"] == fitted.sha256 and content["settings"]["sha256"]
    assert content["parameters"]["restitution"]["initial"] == pytest.approx(0.65)
    for name, p in fitted.parameters.items():
        assert content["parameters"][name]["estimate"] == pytest.approx(p.estimate, abs=0.01 * p.sd)
    assert (path.parent / "model.json").is_file()
    path.write_text(GOOD + '[fixed]\nrestituton = 0.7\n')
    assert main(["fit", str(path), "--overwrite"]) == 2
    assert "fit.toml" in capsys.readouterr().err


def test_the_committed_fit_belongs_to_its_data():
    for path in sorted((ROOT / "fits").glob("*/fit.toml")):
        specification, digest = read_specification(path)
        content = json.loads((path.parent / "fit.json").read_text())
        assert content["settings"]["sha256"] == digest, f"run ddetumble fit {path.parent.name}/fit.toml again"
        assert content["sha256"] == read_campaign(specification.campaign).sha256
        assert content["converged"] and not (set(content["effects"]) ^ set(specification.effects))
    truth = json.loads((ROOT / "data" / "truth.json").read_text())["impact-b"]
    content = json.loads((ROOT / "fits" / "impact-b" / "fit.json").read_text())
    for name, value in (truth["base"] | {"adhesion.tau_a": truth["effects"]["adhesion"]["tau_a"]}).items():
        assert content["parameters"][name]["q025"] < value < content["parameters"][name]["q975"]


@pytest.fixture(scope="module")
def curved(tmp_path_factory):
    """A wall whose force grows as the power 1.5 of the depression."""
    place = tmp_path_factory.mktemp("curved") / "wall"
    write_package(place, make_campaign("wall", 21, {"wall-stiffness": {"k_w": 1.5e4, "q": 1.5}}, BASE, **PLAN))
    return place


def fit_by_command(folder, place, *words):
    """Content of `fit.json` of `ddetumble fit FOLDER --effect wall-stiffness WORDS`."""
    assert main(["fit", str(folder), "-e", "wall-stiffness", *words, "-o", str(place)]) == 0
    return json.loads((place / "fit.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_shapes_are_freed_and_held_on_the_command_line(curved, tmp_path):
    plain = fit_by_command(curved, tmp_path / "a")
    freed = fit_by_command(curved, tmp_path / "b", "--free", "wall-stiffness.q")
    q = freed["parameters"]["wall-stiffness.q"]
    assert freed["chi2"] < plain["chi2"] - 50 and abs(q["estimate"] - 1.5) < 4 * q["sd"] < 1.0
    assert freed["chi2_reduced"] < 1.25 and "wall-stiffness.q" not in plain["parameters"]
    assert "--free wall-stiffness.q" in freed["settings"]["command"]
    held = fit_by_command(curved, tmp_path / "c", "--fix", "wall-stiffness.q=1.5", "--fix", "effective_mass = 1300 g")
    assert held["fixed"]["wall-stiffness.q"] == pytest.approx(1.5)
    assert '--fix "effective_mass=1.3 kg"' in held["settings"]["command"]
    assert held["fixed"]["effective_mass"] == pytest.approx(1.3) and held["chi2"] < freed["chi2"] + 20
    pulled = fit_by_command(curved, tmp_path / "d", "--free", "wall-stiffness.q=1.4", "--prior",
                            "wall-stiffness.q=1.2+-0.001", "--prior", "effective_mass=1300+-400 g")
    assert pulled["parameters"]["wall-stiffness.q"]["estimate"] == pytest.approx(1.2, abs=0.02)
    assert pulled["parameters"]["wall-stiffness.q"]["initial"] == pytest.approx(1.4)


def test_a_number_of_its_own_unit_is_held_as_written():
    """Coefficients of Eq. 10 are in 1/mm, wherever SI inside has 1/m."""
    read = read_source("slip-a", None, "fit", None, model="eq10", effects=(), free=None,
                       priors=["sum_1=2+-0.5 1/m"], fixed=["sum_0=0.25 1/mm", "adhesion_constant=0.8"])
    assert read.chosen["fixed"] == {"sum_0": 0.25, "adhesion_constant": 0.8}
    assert read.chosen["priors"]["sum_1"] == pytest.approx((2e-3, 0.5e-3))
    zero = read_source("slip-a", None, "fit", None, model="eq10", effects=(), free=None, priors=None,
                       fixed=["sum_1=0", "difference_1=0.0"])
    assert zero.chosen["fixed"] == {"sum_1": 0.0, "difference_1": 0.0}  # as commands of results say it


WARM = """
from ddetumble.contact.effect import AbstractElasticEffect, parameter


class WarmWall(AbstractElasticEffect):
    k: float = parameter("N/m", typical=2000.0, sign=1, starts=(5000.0,))
    theta: float = parameter("K", 293.0, kind="shape", typical=10.0, free=False)
    id = "warm-wall"
    law = "F_k gains k delta theta/293 K"
    reference = "a test"

    def force(self, contact):
        return self.k * contact.depression * self.theta / 293.0
"""


def test_a_prior_of_a_temperature_may_be_in_degrees(tmp_path):
    """Its deviation is a difference."""
    (tmp_path / "own.py").write_text(WARM, encoding="utf-8")
    read = read_source("impact-b", None, "fit", tmp_path / "own.py", model="paper", effects=["warm-wall"], free=None,
                       priors=["warm-wall.theta=20+-2 degC"], fixed=None)
    assert read.chosen["priors"]["warm-wall.theta"] == pytest.approx((293.15, 2.0))


def test_bounds_are_read_in_their_unit():
    read = read_source("slip-a", None, "fit", None, model="eq10", effects=(), free=None, fixed=None, priors=None,
                       bounds=["sum_1=-1..2.5 1/m", "adhesion_constant=.5..1.", "loss_factor = 0..1"])
    assert read.chosen["bounds"]["sum_1"] == pytest.approx((-1e-3, 2.5e-3))
    assert read.chosen["bounds"]["adhesion_constant"] == (0.5, 1.0) and read.chosen["bounds"]["loss_factor"] == (0, 1)


@pytest.mark.slow
def test_a_bound_holds_on_the_command_line(curved, tmp_path):
    """The mass, which would be 1.3 kg, stays at its bound; the command that is written down says so."""
    found = fit_by_command(curved, tmp_path / "a", "--bound", "effective_mass=1000..1250 g")
    assert found["parameters"]["effective_mass"]["estimate"] == pytest.approx(1.25, rel=1e-6)
    assert '--bound "effective_mass=1..1.25 kg"' in found["settings"]["command"]


@pytest.mark.study
def test_a_fit_by_hand_is_as_good_as_that_of_discover(curved, tmp_path):
    found = dd.discover(curved)
    assert found.effects == ("wall-stiffness",)
    freed = fit_by_command(curved, tmp_path / "b", "--free", "wall-stiffness.q")
    assert freed["chi2_reduced"] < 1.01 * found.steps[-1].chi2_reduced


@pytest.mark.parametrize(("words", "says"), [
    (["--free", "wall-stiffnes.q"], "wall-stiffness.q"), (["--fix", "effective_mass"], "--fix"),
    (["--fix", "outer_diameter=61"], "mm"), (["--prior", "effective_mass=1.3+-0.1"], "kg"),
    (["--free", "effective_mass=1.3"], "kg"), (["--fix", "wall-stiffness.k_w=15000"], "N/m^q"),
    (["--fix", "wall-stiffness.k_w=15 kN/m"], "N/m^q"), (["--fix", "outer_diameter=-60 mm"], "positive"),
    (["--fix", "effective_mass=1 s"], "kg"), (["--fix", "effective_mass=much"], "--fix"),
    (["--free", "adhesion.tau_a"], "--effect adhesion"), (["--fix", "tau_a=8e4 Pa"], "adhesion.tau_a"),
    (["--prior", "adhesion.tau=8e4+-1e3 Pa"], "adhesion.tau_a"), (["--free", "p"], "--effect ID"),
    (["--bound", "viscoelastic-wall.tau=1..2 ms"], "--effect viscoelastic-wall"),
    (["--prior", "restitution=0.7"], "--prior"),
    (["--prior", "restitution=0.7+-0"], "positive"), (["--prior", "restitution=1.2+-0.1"], "at most 1"),
    (["--prior", "effective_mass=-1+-0.1 kg"], "positive"),
    (["--free", "wall-stiffness.q", "--prior", "wall-stiffness.q=-50+-0.1"], "wall-stiffness.q"),
    (["--prior", "wall-stiffness.q=1+-0.1"], "not fitted"),
    (["--bound", "effective_mass=1..1.5"], "kg"), (["--bound", "restitution=0.7"], "--bound restitution"),
    (["--bound", "restitution=0.9..0.5"], "--bound restitution"), (["--bound", "restitutio=0.5..1"], "--bound"),
    (["--bound", "wall-stiffness.q=1..2"], "wall-stiffness.q"), (["--bound", "effective_mass=1..2 s"], "kg"),
    (["--fix", "wall-stiffness.q=1", "--free", "wall-stiffness.q"], "both free and fixed")], ids=str)
def test_faulty_choices_are_refused(folder, words, says, tmp_path, capsys):
    assert main(["fit", str(folder), "-e", "wall-stiffness", *words, "-o", str(tmp_path / "fit")]) == 2
    told = capsys.readouterr().err
    assert says in told and told.count("\n") == 1 and not (tmp_path / "fit").exists()


@pytest.mark.parametrize("choice", [{"free": ["adhesion.tau_a"]}, {"priors": {"adhesion.tau_a": (8e4, 1e3)}},
                                    {"bounds": {"adhesion.tau_a": (1e4, 1e5)}}], ids=lambda one: next(iter(one)))
def test_a_parameter_of_an_effect_that_the_model_lacks(folder, choice):
    with pytest.raises(dd.InputError) as caught:
        dd.fit(folder, **choice)
    assert caught.value.key == next(iter(choice)) and "effects = ['adhesion']" in caught.value.problem


def test_choices_do_not_go_with_a_specification(tmp_path, capsys):
    (tmp_path / "fit.toml").write_text(GOOD, encoding="utf-8")
    assert main(["fit", str(tmp_path / "fit.toml"), "--free", "restitution=0.6"]) == 2
    assert "--free" in capsys.readouterr().err


def test_the_example_of_the_guide_is_a_specification(tmp_path):
    text = (ROOT / "docs" / "guide" / "by-hand.md").read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    (tmp_path / "fit.toml").write_text(next(one for one in blocks if "ddetumble.fit/1" in one), encoding="utf-8")
    found, _ = read_specification(tmp_path / "fit.toml")
    assert found.free and found.priors


def test_an_effect_that_makes_a_fit_worse_is_told():
    """Friction that builds up over any slip at all is nought at first touch, where these records have some: its null is
    a jump away. What helps brings no such note."""
    stated = [dd.fit("slip-a", effects=[name], noise="stated").notes for name in ("presliding", "load-exponent")]
    assert [sum("presliding" in note for note in notes) for notes in stated] == [1, 0]
    assert len(stated[0]) == len(stated[1]) + 1


@pytest.mark.slow
def test_what_is_read_before_a_clock_says_touch_is_no_noise(tmp_path):
    """A dashpot and clocks that jitter by two samples, from the second simulator: what a record reads of the contact
    before its clock says so passed for noise of six times its size."""
    exam = Exam("impact", 905, ("one",), bench="drawn", edition=3)
    write_case(exam, sample_case(exam, 5), tmp_path)
    campaign, _ = screen_samples(read_campaign(tmp_path))
    found = fit(campaign, effects=["viscous-dashpot"])
    assert found.noise["normal_force"].sd == pytest.approx(0.25, rel=0.05)
    assert campaign.independent is not None
    loose = dc.replace(campaign.independent, uncertainty=Uncertainty(absolute=4e-4))  # as far as they do jitter
    found = fit(dc.replace(campaign, independent=loose), effects=["viscous-dashpot"])
    noise = found.noise["normal_force"]
    assert noise.sd == pytest.approx(0.25, rel=0.05) and noise.correlation == pytest.approx(0.55, abs=0.05)
    assert found.parameters["viscous-dashpot.c_v"].estimate == pytest.approx(23.36, rel=0.02)
    assert 0.9 < found.chi2 / found.degrees < 1.1
