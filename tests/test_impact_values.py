"""Tests that give one value each: rebound speeds, contact times, impulses, peaks; fitted, compared and searched."""

import dataclasses as dc

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp

import ddetumble as dd
from ddetumble._errors import InputError
from ddetumble._settings import find_data
from ddetumble.cli import main
from ddetumble.dynamics.impact import follow
from ddetumble.families import open_campaign
from ddetumble.families.impact import read_values
from ddetumble.families.values import measure_scatter
from ddetumble.figures import draw_predictive
from ddetumble.inference.noise import widen_by_student
from ddetumble.measurement.campaign import Campaign, Column
from ddetumble.measurement.package import read_campaign, write_campaign
from ddetumble.measurement.units import Uncertainty, si_unit
from ddetumble.posterior.predictive_check import check_posterior
from ddetumble.posterior.target import pose_fit
from tests.test_paper import integrate_peak, solve_kappa


RESTITUTION, MASS = 0.72, 1.4
SPEEDS, PRESSURES = np.tile([0.3, 0.5, 0.8, 1.2], 3), np.repeat([1.0e6, 1.5e6, 2.0e6], 4)


def make_campaign(values, uncertainty=None, speeds=SPEEDS, pressures=PRESSURES, **known):
    """A campaign of values by name, each of the same relative uncertainty, or of none that is stated."""
    index = pd.Index([f"r{k:02d}" for k in range(len(speeds))], name="record", dtype=object)
    names = {"initial_pressure": pressures, "approach_speed": speeds}
    return Campaign(
        name="values", title="Values", family="impact", path=None,
        known={"outer_diameter": 0.06, "effective_mass": None, "restitution": None, **known},
        records=pd.DataFrame(names, index=index), conditions={name: Column(name, si_unit(name)) for name in names},
        peaks=pd.DataFrame(values, index=index), peak_columns={
            name: Column(name, si_unit(name), uncertainty and Uncertainty(relative=uncertainty)) for name in values})


def draw_rebounds(seed, share=0.01):
    """Rebound speeds of an impact that leaves at a share of its speed, with noise in proportion."""
    return RESTITUTION * SPEEDS * (1.0 + share * np.random.default_rng(seed).normal(size=len(SPEEDS)))


def integrate_values(mass, e, pressure, speed):
    """Values of an impact of the paper's ball by SciPy, independent of the package."""
    c = solve_kappa(e) / speed

    def force(depth, rate):
        b, r = np.pi / 4 * depth, (0.06 - depth) / 2
        volume = 2 * np.pi * (b**2 * r + np.pi * b * r**2 / 2 + 2 * r**3 / 3)
        return max(pressure * (np.pi * 0.06**3 / 6 / volume) * np.pi * b**2 * (1 + c * rate), 0.0)

    def leave(t, y):
        return y[0] + (1e-9 if t < 1e-6 else 0.0)

    leave.terminal, leave.direction = True, -1
    found = solve_ivp(lambda t, y: [y[1], -force(y[0], y[1]) / mass, force(y[0], y[1])], (0, 0.27), [0, speed, 0],
                      rtol=1e-10, atol=1e-12, events=leave, dense_output=True)
    depth = found.sol(np.linspace(0.0, found.t[-1], 20001))[0]
    return {"rebound_speed": -found.y[1, -1], "contact_time": found.t[-1], "impulse": found.y[2, -1],
            "peak_depression": depth.max(), "peak_normal_force": integrate_peak(mass, e, pressure, speed=speed)[0]}


def tabulate(mass=MASS, e=RESTITUTION):
    """Values without noise at all conditions, by name."""
    rows = [integrate_values(mass, e, p, v) for p, v in zip(PRESSURES, SPEEDS, strict=True)]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.fixture(scope="module")
def exact():
    return tabulate()


@pytest.mark.slow
def test_rebound_speeds_alone_give_the_restitution():
    """v2/v1 is Gaussian about e: the standard error is that of its mean, and the mass stays unknown."""
    campaign = make_campaign({"rebound_speed": draw_rebounds(0)}, 0.01)
    found = dd.fit(campaign)
    own = found.parameters["restitution"]
    ratio = campaign.peaks["rebound_speed"].to_numpy() / SPEEDS
    assert own.sd == pytest.approx(0.01 * RESTITUTION / np.sqrt(len(SPEEDS)), rel=0.02)
    # Deviations in proportion to what was measured weigh a small reading more.
    assert own.estimate == pytest.approx(np.sum(1.0 / ratio) / np.sum(1.0 / ratio**2), rel=1e-4)
    mass = found.parameters["effective_mass"]
    assert mass.q975 > 2.0 * mass.q025
    assert any("effective_mass" in note for note in found.notes)


@pytest.mark.parametrize("e", [0.002, 0.003, 0.005, 0.02, 0.5])
def test_peaks_of_impacts_from_which_hardly_anything_rebounds(e):
    """The force peaks in the first thousandth of a contact whose end is ever slower; SciPy finds it by itself."""
    law = dd.Ball(effective_mass=0.3, restitution=e).extend(())
    conditions = {"initial_pressure": jnp.array(1.5e6), "approach_speed": jnp.array(0.4)}
    values, failed = read_values(law, conditions, follow(law, conditions, jnp.array(1.0), 5e-8, 5e-10))
    assert not failed
    c = solve_kappa(e) / 0.4

    def force(depth, rate):
        b, r = np.pi / 4 * depth, (0.06 - depth) / 2
        volume = 2 * np.pi * (b**2 * r + np.pi * b * r**2 / 2 + 2 * r**3 / 3)
        return 1.5e6 * (np.pi * 0.06**3 / 6 / volume) * np.pi * b**2 * (1 + c * rate)

    path = solve_ivp(lambda t, y: [y[1], -force(*y) / 0.3], (0, 0.02), [0, 0.4], rtol=1e-10, atol=1e-13,
                     dense_output=True)
    want = max(force(*path.sol(t)) for t in np.geomspace(1e-7, 0.02, 20_001))
    assert float(values["peak_normal_force"]) == pytest.approx(want, rel=5e-5)


def test_peaks_are_smooth_in_the_restitution():
    """Another sample becomes the largest as the restitution grows: the peaks that are read do not jump."""
    conditions = {"initial_pressure": jnp.array(1.5e6), "approach_speed": jnp.array(0.4)}

    def read(e):
        law = dd.Ball(effective_mass=0.8, restitution=e).extend(())
        values, _ = read_values(law, conditions, follow(law, conditions, jnp.array(1.0), 5e-8, 5e-10))
        return jnp.stack([values["peak_normal_force"], values["peak_depression"]])

    share = np.linspace(-1.0, 1.0, 201)
    found = np.asarray(jax.lax.map(read, jnp.asarray(0.1 * (1.0 + 0.1 * share))))
    for values in found.T:
        rest = values - np.polyval(np.polyfit(share, values, 5), share)
        assert np.abs(np.diff(rest)).max() < 2e-7 * values.max()


@pytest.mark.slow
def test_a_single_value_is_held_against_its_replicates(tmp_path):
    """Of one value the largest residual says what chi-square does, and has no neighbour."""
    found = dd.fit(make_campaign({"rebound_speed": draw_rebounds(1)}, 0.01), fixed={"effective_mass": MASS})
    target = pose_fit(found)
    x = np.random.default_rng(1).multivariate_normal(target.centre, target.covariance, 200)
    checks = check_posterior(target, x)
    assert checks.replicates.are_values and not checks.rejected
    for one in checks.records:
        assert set(one.p_values) == {"chi_square", "largest"}
        assert one.p_values["largest"] == pytest.approx(one.p_values["chi_square"], rel=1e-6)
    assert checks.comparisons == 2 * len(SPEEDS) + 1
    draw_predictive(checks).savefig(tmp_path / "values.png")


@pytest.mark.slow
@pytest.mark.parametrize("uncertainty", [0.01, None])
def test_intervals_of_the_restitution_cover(uncertainty):
    """95 % intervals hold the truth in 95 % of campaigns, whether the noise is stated or its scatter estimated."""
    fits = [dd.fit(make_campaign({"rebound_speed": draw_rebounds(100 + k)}, uncertainty)) for k in range(60)]
    inside = sum(one.parameters["restitution"].q025 <= RESTITUTION <= one.parameters["restitution"].q975
                 for one in fits)
    assert inside >= 52  # of 60 at 95 % fewer come once in a thousand


@pytest.mark.slow
def test_values_against_scipy(exact):
    """All values at once, without noise: the fit finds the truth, and leaves no more than the integrator's error."""
    found = dd.fit(make_campaign(exact, 1e-3))
    assert found.parameters["effective_mass"].estimate == pytest.approx(MASS, rel=1e-4)
    assert found.parameters["restitution"].estimate == pytest.approx(RESTITUTION, rel=1e-4)
    assert found.chi2 < 0.1 * 5 * len(SPEEDS)


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "restitution"), [(0.5, 0.84), (0.55, 0.65), (3.0, 0.45)])
def test_peaks_of_light_and_heavy_balls_are_no_misfit(mass, restitution):
    """Peaks, which hardly feel the restitution, far from where a fit starts: it gets there, and nothing is missing."""
    pressures = np.linspace(0.25e6, 2.5e6, 11)
    peaks = np.array([integrate_peak(mass, restitution, p, speed=0.4)[0] for p in pressures])
    peaks *= 1.0 + 0.01 * np.random.default_rng(3).normal(size=len(peaks))
    campaign = make_campaign({"peak_normal_force": peaks}, None, speeds=np.full(11, 0.4), pressures=pressures)
    own = dd.fit(campaign).parameters["effective_mass"]
    assert own.q025 < mass < own.q975
    found = dd.compare(campaign)
    assert not found.lack_of_fit.rejected and found.lack_of_fit.tested
    assert found.parameters["effective_mass"].estimate == pytest.approx(mass, rel=0.1)


@pytest.mark.slow
def test_a_prior_that_the_values_disagree_with_is_no_misfit():
    """Table 4, nearly one share of the load: the model makes it only with an adhesion constant that no rubber has."""
    campaign = read_campaign(find_data() / "paper" / "table-4")
    found, fit = dd.compare(campaign), dd.fit(campaign)
    assert found.lack_of_fit.tested and not found.lack_of_fit.rejected and not fit.goodness.misfit
    assert fit.parameters["adhesion_constant"].estimate > 5.0 and fit.goodness.disputed == ("adhesion_constant",)
    assert fit.chi2_reduced < 1.5 < fit.chi2 / fit.degrees  # which counts what the priors add
    assert "adhesion_constant" in str(fit.goodness) and "adhesion_constant" in found.sentence
    for notes in (found.notes, fit.notes):  # what takes the place of a measurement, and that it does not suit
        assert sum("adhesion_constant" in note for note in notes) == 2
    bounded = dd.fit(campaign, bounds={"slip_scale": (1.05, 2.0)})  # held there, where its prior pulls it
    assert bounded.parameters["slip_scale"].estimate == pytest.approx(1.05)


@pytest.mark.slow
def test_a_long_valley_is_followed_to_its_end():
    """Table 3, which hardly tells mass and restitution apart: fit and comparison end at one minimum, and say so."""
    campaign = read_campaign(find_data() / "paper" / "table-3")
    fit, found = dd.fit(campaign), dd.compare(campaign)
    assert fit.converged and found.converged
    for name, own in fit.parameters.items():
        assert found.parameters[name].estimate == pytest.approx(own.estimate, abs=0.02 * own.sd)


@pytest.mark.study
def test_values_that_leave_nothing_to_test_with_are_told():
    """A model with as many parameters as the curve whose scatter is the noise."""
    assert not dd.compare(read_campaign(find_data() / "paper" / "figure-8"), "power-law").lack_of_fit.tested


@pytest.mark.slow
def test_missing_values_and_packages(exact, tmp_path):
    """A record may lack a value; what was written is read, and fitted alike."""
    table = pd.DataFrame(exact)
    table.loc[3, "impulse"] = np.nan
    campaign = make_campaign({name: table[name].to_numpy() for name in table}, 0.01)
    written = write_campaign(tmp_path / "campaign", campaign)
    one, other = dd.fit(campaign), dd.fit(tmp_path / "campaign")
    assert one.chi2 == pytest.approx(other.chi2, abs=1e-9) and other.sha256 == written.sha256
    assert one.samples == 5 * len(SPEEDS) - 1
    assert other.parameters["effective_mass"].estimate == pytest.approx(MASS, rel=1e-3)


def test_scatter_is_that_of_repeats_or_of_what_is_not_smooth():
    random = np.random.default_rng(3)
    repeats = pd.DataFrame({"approach_speed": np.repeat([0.3, 0.5, 0.8], 40)})
    values = 0.7 * repeats["approach_speed"].to_numpy() * (1.0 + 0.02 * random.normal(size=120))
    found = measure_scatter(repeats, values)
    assert found.degrees == 117 and found.share == pytest.approx(0.02, rel=0.2)
    line = pd.DataFrame({"approach_speed": np.linspace(0.3, 1.2, 60), "initial_pressure": random.uniform(1, 2, 60)})
    curve = line["approach_speed"].to_numpy() * (1.0 + 0.1 * line["initial_pressure"].to_numpy())
    found = measure_scatter(line, curve * (1.0 + 0.02 * random.normal(size=60)))
    assert 50 <= found.degrees < 60 and found.share == pytest.approx(0.02, rel=0.25)
    with pytest.raises(InputError, match="uncertainty"):
        open_campaign(make_campaign({"rebound_speed": np.array([0.2])}, speeds=np.array([0.3]),
                                    pressures=np.array([1e6])))


def test_noise_of_few_degrees_is_students():
    assert widen_by_student(1e7) == pytest.approx(1.0, abs=1e-6)
    assert 1.959964 * widen_by_student(8) == pytest.approx(2.306, abs=1e-3)


def test_other_campaigns_are_opened_as_they_are():
    campaign = read_campaign(find_data() / "impact-a")
    assert open_campaign(campaign) is campaign


@pytest.mark.study
def test_a_restitution_that_falls_with_the_pressure_is_seen(exact):
    """Rebound speeds with an effect of the catalogue in them are no longer a complete model's; without it they are."""
    plain = dd.discover(make_campaign({"rebound_speed": draw_rebounds(5, 0.004)}, 0.004))
    assert plain.verdict == "nothing-missing" and not plain.effects
    falling = draw_rebounds(5, 0.004) * (1.0 - 0.25 * (PRESSURES - 1.5e6) / 1e6)
    found = dd.discover(make_campaign({"rebound_speed": falling}, 0.004))
    assert found.effects == ("pressure-dependent-restitution",) and found.steps[0].lack_of_fit.rejected


@pytest.mark.study
def test_the_papers_peaks_through_the_verbs(tmp_path):
    """Figure 8 through every verb: four peaks give a mass, and leave open what is missing."""
    campaign = read_campaign(find_data() / "paper" / "figure-8")
    found = dd.fit(campaign)
    mass = found.parameters["effective_mass"]
    assert mass.q025 < 1.3 < mass.q975
    assert dd.compare(campaign).lack_of_fit.rejected is False
    judged = dd.discover(campaign)
    assert judged.verdict == "undecided" and judged.confidence is None
    assert dd.report(judged, tmp_path / "page").is_file()
    posterior = dd.sample(campaign, effective=200, seed=1)
    assert "effective_mass" in posterior.target.names
    assert dc.is_dataclass(found.fitted_model())
    with pytest.raises(InputError, match="sampled records"):
        dd.draw_missing_force(campaign)


@pytest.mark.study
def test_eleven_numbers_name_no_pair_of_effects():
    """Table 3: without gas the reference model gives no force, and some pair of effects fits any eleven numbers."""
    found = dd.discover(read_campaign(find_data() / "paper" / "table-3"))
    assert found.verdict in ("improved", "unexplained") and len(found.effects) <= 1
    assert found.missing is None and found.steps[0].lack_of_fit.rejected


def test_where_no_missing_force_can_be_drawn_another_verb_is_named(capsys):
    assert main(["missing", str(find_data() / "paper" / "table-3")]) == 2
    told = capsys.readouterr().err
    assert "table-3" in told and "ddetumble compare" in told
