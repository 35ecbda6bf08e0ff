"""Posteriors: integrals over nuisances against quadrature, samplers against closed forms and one another."""

import dataclasses as dc
import json

import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from ddetumble import fit, sample
from ddetumble._errors import InputError
from ddetumble.cli import main
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.figures.posterior import _push_ellipses, _push_marginal
from ddetumble.inference.problem import simulate_records
from ddetumble.measurement.package import read_campaign
from ddetumble.posterior import pose_curve, pose_fit
from ddetumble.posterior.chain import Settings, run_chains
from ddetumble.posterior.diagnostics import compare_ensembles, judge_chains, measure_sizes
from ddetumble.posterior.ensemble import Ensembles, mix_moves
from ddetumble.posterior.proposal import Mixture
from ddetumble.posterior.target import judge_linearity


BASE = {"adhesion_constant": 0.9, "loss_factor": 0.16, "slip_scale": 1.0}
PLAN = dict(loads=[8.0, 18.0], pressures=[4e5, 2e6], speeds=[0.02], length=6e-3, interval=2e-4, noise=0.2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("sampling") / "offset"
    write_package(place, make_slip_campaign("offset", 5, {"adhesive-offset": {"f_a": 0.3}}, BASE, **PLAN))
    return place


@pytest.fixture(scope="module")
def fitted(folder):
    return fit(read_campaign(folder), effects=["adhesive-offset"])


@pytest.fixture(scope="module")
def target(fitted):
    return pose_fit(fitted)


@pytest.fixture(scope="module")
def posterior(target):
    return sample(target, seed=3)


def line(x, data):
    """Whitened residual of a straight line."""
    t, y = data
    return (x[0] + x[1] * t - y) / 0.1


def plain(x, data):
    """Whitened residual of a Gaussian with a given factor of its precision."""
    factor, mean = data
    return factor @ (x - mean)


def pose_line(**more):
    t = np.linspace(0.0, 1.0, 12)
    y = 0.3 + 0.7 * t + 0.1 * np.random.default_rng(2).standard_normal(12)
    design = np.stack([np.ones(12), t], axis=1) / 0.1
    covariance = np.linalg.inv(design.T @ design)
    mean = covariance @ design.T @ (y / 0.1)
    made = pose_curve(line, (jnp.asarray(t), jnp.asarray(y)), ["offset", "slope"], mean, covariance, **more)
    return made, mean, covariance


@pytest.mark.slow
def test_the_integral_is_that_of_quadrature(target):
    """One record's nuisances (load and pressure) by Gauss-Hermite quadrature of the model as it is."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(16)
    x = target.draw_inside(np.random.default_rng(1), 1)
    plan, records = target.plan, target.records
    moving = np.flatnonzero(np.asarray(plan.stack.condition_sd)[0] > 0)
    assert len(moving) == 2
    found = target.integrate(x)

    @jax.jit
    def simulate(z, base):
        return simulate_records(target.space, records.nuisances, records.channels, z, plan.stack, base, plan.low,
                                plan.high)

    base = jnp.broadcast_to(plan.base + (x[0] - plan.centre) @ plan.directions, (records.count, len(target.space)))
    terms = []
    # Nodes are placed by the found Gaussian and weighed by the true integrand.
    for a, wa in zip(nodes, weights, strict=True):
        for b, wb in zip(nodes, weights, strict=True):
            e = np.zeros((records.count, len(records.nuisances)))
            e[:, moving] = (a, b)
            z = found.mean[0] + np.stack([np.linalg.solve(f.T, v) for f, v in zip(found.factor[0], e, strict=True)])
            r, _, _ = simulate(z, base)
            terms.append(np.log(wa * wb / (2 * np.pi)) + 0.5 * (a * a + b * b)
                         - 0.5 * (np.sum(np.asarray(r) ** 2, axis=1) + np.sum(z[:, moving] ** 2, axis=1)))
    volume = -np.sum(np.log(np.diagonal(found.factor[0], axis1=1, axis2=2)), axis=1)
    want = logsumexp(np.array(terms), axis=0) + volume + np.asarray(plan.constant)
    np.testing.assert_allclose(found.value[0], want, atol=2e-3)


def test_sampled_integral_agrees_with_the_linear_one(target):
    assert target.curved < 0.05 and "analytically" in target.notes[0]
    x = target.draw_inside(np.random.default_rng(4), 5)
    nodes = stats.norm.ppf(stats.qmc.Sobol(target.plan.own.shape[1], rng=np.random.default_rng(0)).random(32))
    plan = dc.replace(target.plan, nodes=jnp.asarray(np.concatenate([nodes, -nodes])))
    found = dc.replace(target, plan=plan).likelihoods(x)
    np.testing.assert_allclose(found.sum(axis=1), target.likelihoods(x).sum(axis=1), atol=0.05)


@pytest.fixture(scope="module")
def loose(target):
    """The same with settings a hundred times as uncertain, in which the model is far from linear."""
    stack = eqx.tree_at(lambda s: s.condition_sd, target.plan.stack, 100.0 * target.plan.stack.condition_sd)
    return dc.replace(target, plan=eqx.tree_at(lambda p: p.stack, target.plan, stack),
                      records=dc.replace(target.records, stack=stack))


def test_a_linear_integral_that_is_off_at_its_own_draws_is_refined(target, loose):
    draws = target.draw_inside(np.random.default_rng(3), 200)
    assert not target.refine(draws).costly and not target.costly
    found = loose.refine(draws)
    assert found.costly and found.curved > 0.05
    assert found.refine(draws) is found


def test_integrals_are_compared_closer_to_a_fit_whose_gaussian_is_far_too_wide(target):
    wide = dc.replace(target, covariance=1e4 * target.covariance, curved=0.0)
    assert wide.compare_integrals(wide.draw_inside(np.random.default_rng(0), 24)) is None
    found = judge_linearity(wide)
    assert not found.costly and 0.0 < found.curved < 0.05


def test_a_chain_that_was_stopped_goes_on_with_the_refined_density(loose, tmp_path):
    how = dict(seed=1, walkers=10, ensembles=2, burn=20, block=10)
    whole = run_chains(Ensembles, loose, Settings(most=30, **how))
    assert whole.target.costly
    run_chains(Ensembles, loose, Settings(most=10, **how), tmp_path)
    found = run_chains(Ensembles, loose, Settings(most=30, **how), tmp_path)
    assert found.statistics["resumed"] == 30 and found.target.costly
    np.testing.assert_array_equal(found.x, whole.x)
    # The last density is the refined one.
    np.testing.assert_allclose(found.target.log_density(found.x[0, -1]), found.log_density[0, -1])


@pytest.fixture(scope="module")
def bent():
    """Eq. 10 from three loads, which hardly determine it."""
    return pose_fit(fit("slip-c", "eq10"))


@pytest.mark.slow
def test_what_follows_from_draws_is_eq_10_in_the_load_itself(bent):
    """Polynomials in N and the coordinates of the fit, in (F - 15 N)/10 N, are the same b + d and b - d."""
    x = bent.draw_inside(np.random.default_rng(1), 60)
    found, values = bent.derive(x), dict(zip(bent.names, bent.publish(x).T, strict=True))
    load = 22.0
    for kind, sign in (("sum", 1.0), ("difference", -1.0)):
        own = sum(values[f"{kind}_{k}"] * ((load - 15.0) / 10.0) ** k for k in range(3))
        b, d = (sum(found[f"{name}{k}"][0] * load**k for k in range(3)) for name in "bd")
        np.testing.assert_allclose(b + sign * d, own, rtol=1e-9)
    assert found["b1"][1] == "1/(mm*N)"


@pytest.mark.slow
def test_integrals_are_compared_where_the_posterior_is(bent):
    """The Gaussian of a fit whose valley is bent reaches where Eq. 10 diverges, and the posterior does not."""
    assert not bent.costly
    x = bent.draw_inside(np.random.default_rng(1), 60)
    nodes = stats.norm.ppf(stats.qmc.Sobol(bent.plan.own.shape[1], rng=np.random.default_rng(0)).random(32))
    plan = dc.replace(bent.plan, nodes=jnp.asarray(np.concatenate([nodes, -nodes])))
    linear, sampled = bent.log_density(x), dc.replace(bent, plan=plan).log_density(x)
    within = linear > bent.log_density(bent.centre[None]) - 10.0
    assert 4 < within.sum() < 50
    np.testing.assert_allclose(sampled[within], linear[within], atol=0.1)


def test_the_density_near_the_fit_is_the_fits_gaussian(target, fitted):
    x = target.draw_inside(np.random.default_rng(0), 40)
    shift = x - target.centre
    quadratic = -0.5 * np.einsum("ij,jk,ik->i", shift, np.linalg.inv(target.covariance), shift)
    assert np.std(target.log_density(x) - quadratic) < 0.5
    assert target.names == tuple(fitted.parameters)
    np.testing.assert_allclose(target.publish(target.centre), [p.estimate for p in fitted.parameters.values()])


def test_emcee_finds_the_closed_form_of_a_line():
    made, mean, covariance = pose_line()
    found = sample(made, effective=4000)
    assert found.converged
    for k, p in enumerate(found.parameters.values()):
        assert abs(p.mean - mean[k]) < 5 * p.mcse
        assert p.sd == pytest.approx(np.sqrt(covariance[k, k]), rel=0.06)
    flat = found.x.reshape(-1, 2)
    correlation = covariance[0, 1] / np.sqrt(np.prod(np.diag(covariance)))
    assert np.corrcoef(flat.T)[0, 1] == pytest.approx(correlation, abs=0.04)


@pytest.mark.slow
def test_nuts_finds_the_closed_form_of_a_line():
    made, mean, covariance = pose_line()
    found = sample(made, sampler="nuts", burn=100, block=200, effective=2000)
    for k, p in enumerate(found.parameters.values()):
        assert abs(p.mean - mean[k]) < 5 * p.mcse
        assert p.sd == pytest.approx(np.sqrt(covariance[k, k]), rel=0.08)
    assert found.statistics["divergences"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["emcee", "nuts"])
def test_a_limit_cuts_the_posterior_off(sampler):
    """A normal with mean at -1 cut off at 0, of known mean and quantile; with a prior on the other one."""
    factor, mean = jnp.eye(2), jnp.array([-1.0, 2.0])
    made = pose_curve(plain, (factor, mean), ["a", "b"], [0.05, 2.0], np.diag([1.0, 1.0]), bounds={"a": (0.0, np.inf)},
                      priors={"b": (0.0, 0.5)})
    found = sample(made, sampler=sampler, burn=200, block=200, effective=3000)
    cut = stats.truncnorm(1.0, np.inf, loc=-1.0)
    p = found.parameters["a"]
    assert found.x[..., 0].min() >= 0.0
    assert abs(p.mean - cut.mean()) < 6 * p.mcse and p.sd == pytest.approx(cut.std(), rel=0.08)
    assert p.q975 == pytest.approx(cut.ppf(0.975), rel=0.1)
    assert abs(found.parameters["b"].mean - 2.0 / 5.0) < 6 * found.parameters["b"].mcse  # precisions 1 and 4
    assert any("lower limit" in note for note in found.notes)


@pytest.mark.study
def test_twenty_parameters():
    """A strongly correlated Gaussian in twenty dimensions, started from a covariance that is wrong by a factor."""
    rng = np.random.default_rng(8)
    basis = np.linalg.qr(rng.standard_normal((20, 20)))[0]
    sd = np.geomspace(0.01, 10.0, 20)
    covariance = basis @ np.diag(sd**2) @ basis.T
    factor = jnp.asarray(np.diag(1 / sd) @ basis.T)
    mean = rng.standard_normal(20)
    made = pose_curve(plain, (factor, jnp.asarray(mean)), [f"p{k}" for k in range(20)], mean, 1.7 * covariance)
    found = sample(made, effective=2000)
    assert found.converged
    z = [(p.mean - mean[k]) / p.mcse for k, p in enumerate(found.parameters.values())]
    assert np.max(np.abs(z)) < 5.0
    ratio = [p.sd / np.sqrt(covariance[k, k]) for k, p in enumerate(found.parameters.values())]
    np.testing.assert_allclose(ratio, 1.0, atol=0.12)


def test_two_separate_hills_are_both_visited():
    """The proposal of the fit knows one hill only; walkers that differ say so or reach both in the right shares."""
    def hills(x, data):
        top = jnp.logaddexp(-0.5 * jnp.sum(x**2), -0.5 * jnp.sum((x - 3.0) ** 2))
        return jnp.sqrt(jnp.maximum(-2.0 * top + 2.0, 0.0))[None]

    made = pose_curve(hills, (), ["x"], [0.0], [[4.0]])
    found = sample(made, effective=4000)
    assert found.converged and abs(np.mean(found.x > 1.5) - 0.5) < 0.06


@pytest.mark.slow
def test_a_bent_valley_is_sampled_to_its_ends():
    """Gaussian along, and a parabola of it plus a Gaussian across (Haario et al. 1999): moments in closed form."""
    long, bend = 3.0, 0.25

    def valley(x, data):
        return jnp.array([x[0] / long, x[1] + bend * (x[0] ** 2 - long**2), x[2] - 0.5 * x[1]])

    made = pose_curve(valley, (), ["a", "b", "c"], np.zeros(3), np.diag([1.0, 4.0, 4.0]))  # half as long as it is
    found = sample(made, effective=4000)
    assert found.converged
    b = np.sqrt(1.0 + 2.0 * bend**2 * long**4)
    for p, sd in zip(found.parameters.values(), (long, b, np.hypot(1.0, 0.5 * b)), strict=True):
        assert abs(p.mean) < 5 * p.mcse and p.sd == pytest.approx(sd, rel=0.06)
    ends = found.x[..., 0]
    assert np.mean(np.abs(ends) > 2 * long) == pytest.approx(2 * stats.norm.sf(2.0), rel=0.12)


def test_a_mixture_draws_what_its_density_says_within_its_limits():
    """Shares of a grid's cells among many draws against the density's integral over them."""
    low, high = np.array([-1.0, -np.inf]), np.array([2.0, 0.5])
    made = Mixture([(np.zeros(2), np.array([[1.0, 0.5], [0.5, 0.6]])), (np.array([1.5, -1.0]), 0.2 * np.eye(2))], low,
                   high, np.array([0.3, 0.7]))
    x = made.draw(200_000, np.random.RandomState(2))
    assert np.all((x >= low) & (x <= high))
    a, b = (np.linspace(m, n, 601) for m, n in ((-1.0, 2.0), (-8.0, 0.5)))
    grid = np.stack(np.meshgrid(0.5 * (a[1:] + a[:-1]), 0.5 * (b[1:] + b[:-1]), indexing="ij"), axis=-1)
    cells = np.exp(made.log_density(grid.reshape(-1, 2))).reshape(600, 600)
    expected = cells.reshape(6, 100, 6, 100).sum(axis=(1, 3)) / cells.sum()
    counted, _, _ = np.histogram2d(*x.T, bins=[a[::100], b[::100]])
    np.testing.assert_allclose(counted / len(x), expected, atol=5 * np.sqrt(0.25 / len(x)))


@pytest.mark.parametrize("even", [False, True])
def test_the_proposal_draws_what_its_density_says(even):
    """Importance weights of its draws, random or evenly spread, give the moments of another distribution."""
    made = Mixture([(np.array([0.2, -0.1]), np.array([[1.0, 0.6], [0.6, 1.0]]))], np.full(2, -np.inf),
                   np.full(2, np.inf))
    x = made.spread(2**17, np.random.RandomState(1)) if even else made.draw(200_000, np.random.RandomState(1))
    logs = stats.multivariate_normal([0.5, 0.0], [[0.8, 0.1], [0.1, 0.5]]).logpdf(x) - made.log_density(x)
    w = np.exp(logs - logs.max())
    w /= w.sum()
    np.testing.assert_allclose(w @ x, [0.5, 0.0], atol=0.02)
    np.testing.assert_allclose(w @ x[:, 0] ** 2 - 0.25, 0.8, atol=0.03)


@pytest.mark.parametrize("which", range(3))
def test_every_move_leaves_the_density_as_it_is(which):
    """In five dimensions, where a wrong power of the jump's length in a move's weight changes every variance."""
    size, walkers, free = 5, 200, np.full(5, np.inf)
    sd = np.geomspace(1.0, 3.0, size)
    parts = [(np.zeros(size), 1.5 * np.diag(sd**2)), (np.ones(size), 3.0 * np.diag(sd**2))]
    move, _ = mix_moves(Mixture(parts, -free, free, np.array([0.6, 0.4])), 0.5)[which]
    chain = emcee.EnsembleSampler(walkers, size, lambda x: -0.5 * np.sum((x / sd) ** 2, axis=1), moves=move,
                                  vectorize=True)
    chain._random = random = np.random.RandomState(3)
    chain.run_mcmc(sd * random.standard_normal((walkers, size)), 1500, skip_initial_state_check=True)
    assert np.mean((chain.get_chain(discard=200) / sd) ** 2) == pytest.approx(1.0, abs=0.02)


def test_the_moves_are_all_tested():
    """The test above counts them."""
    free = np.full(5, np.inf)
    assert len(mix_moves(Mixture([(np.zeros(5), np.eye(5))], -free, free), 0.5)) == 3


@pytest.mark.slow
def test_samplers_agree_on_a_campaign(posterior, target):
    """Nuisances integrated out (emcee) and sampled along (NUTS): same means and deviations within Monte Carlo error."""
    assert posterior.converged
    nuts = sample(target, sampler="nuts", burn=150, block=150, effective=1000)
    assert nuts.converged and nuts.statistics["divergences"] == 0
    for name, p in posterior.parameters.items():
        q = nuts.parameters[name]
        assert abs(p.mean - q.mean) < 4 * np.hypot(p.mcse, q.mcse)
        error = np.sqrt(0.5 / p.effective + 0.5 / q.effective)
        assert abs(np.log(p.sd / q.sd)) < 4 * error


def test_truth_lies_in_the_posterior(posterior):
    truth = {**BASE, "adhesive-offset.f_a": 0.3}
    for name, p in posterior.parameters.items():
        assert abs(p.mean - truth[name]) < 4 * p.sd


def test_autocorrelation_time_of_a_known_process():
    """AR(1) with coefficient 0.8 has tau = (1 + 0.8)/(1 - 0.8) = 9."""
    rng = np.random.default_rng(5)
    x = np.zeros((2, 10_000, 8, 1))
    for t in range(1, x.shape[1]):
        x[:, t] = 0.8 * x[:, t - 1] + rng.standard_normal((2, 8, 1))
    (size,), (length,) = measure_sizes(x)
    assert size == pytest.approx(160_000 / 9.0, rel=0.15) and length == pytest.approx(20_000 / 9.0, rel=0.15)
    assert judge_chains(x, 100).times[0] == pytest.approx(9.0, rel=0.15)


def test_walkers_that_move_together_are_one():
    """A slow motion that all walkers share, and one of their common spread: more walkers are no more draws."""
    rng = np.random.default_rng(5)
    slow = np.zeros((1, 20_000, 1, 1))
    for t in range(1, slow.shape[1]):
        slow[:, t] = 0.9 * slow[:, t - 1] + rng.standard_normal((1, 1))
    together = slow + 1e-3 * rng.standard_normal((1, 20_000, 16, 1))
    assert measure_sizes(together)[0][0] == pytest.approx(20_000 / 19.0, rel=0.25)
    widening = np.exp(0.3 * slow) * rng.standard_normal((1, 20_000, 16, 1))
    apart = rng.standard_normal((1, 20_000, 16, 1))
    assert 20 * measure_sizes(widening)[0] < measure_sizes(apart)[0]


def test_ensembles_that_stay_apart_are_few_draws():
    """Where every ensemble stays at a place of its own, all of their steps are worth hardly more than one draw each."""
    rng = np.random.default_rng(7)
    x = rng.standard_normal((4, 500, 16, 1)) + np.array([-1.0, 0.0, 1.0, 2.0])[:, None, None, None]
    sizes, lengths = measure_sizes(x)
    assert lengths < 20
    assert measure_sizes(x[:1])[1] > 200
    told = judge_chains(x, 100)
    assert not told.enough


def test_a_chain_that_does_not_move_is_no_draw():
    sizes, _ = measure_sizes(np.ones((2, 100, 8, 1)))
    assert sizes == 0.0 and not judge_chains(np.ones((2, 100, 8, 1)), 1).enough


def test_ensembles_that_differ_are_seen():
    rng = np.random.default_rng(6)
    x = rng.standard_normal((4, 200, 16, 2))
    assert compare_ensembles(x).max() < 1.01
    x[0, ..., 1] += 0.8
    assert compare_ensembles(x)[0] < 1.01 and compare_ensembles(x)[1] > 1.02
    x = rng.standard_normal((4, 200, 16, 1))
    x[0] *= 2.0  # same mean, another spread
    assert compare_ensembles(x)[0] > 1.01
    told = judge_chains(x, 100)
    assert not told.enough and "differ" in told.lacking
    assert "too few steps" in judge_chains(x[:, :4], 100).lacking


def test_what_cannot_be_sampled_is_said():
    made, mean, _ = pose_line()
    with pytest.raises(InputError, match="do not determine"):
        pose_curve(line, made.data, ["a", "b"], mean, [[np.inf, 0], [0, 1]])
    for wrong, word in (({"walkers": 7}, "even"), ({"walkers": 2}, "even"), ({"effective": 0}, "effective"),
                        ({"sampler": "guess"}, "no sampler")):
        with pytest.raises(InputError, match=word):
            sample(made, **wrong)


def test_a_parameter_without_data_has_no_posterior(folder):
    loose = fit(read_campaign(folder), effects=["stribeck"])
    with pytest.raises(InputError, match="contain no information on stribeck"):
        pose_fit(loose)


def test_failures_count_as_impossible():
    def broken(x, data):
        return jnp.where(x[0] > 0.5, jnp.nan, x)

    found = sample(pose_curve(broken, (), ["x"], [0.0], [[1.0]]), effective=500)
    assert found.x.max() <= 0.5 and found.statistics["failures"] > 0
    still = dc.replace(found, statistics={"accepted": 0.0, "evaluations": 3, "resumed": 0})
    assert "draws kept; 0 % of the moves accepted, 3 evaluations of the density\n" in str(still)
    assert any("could not be computed" in note for note in found.notes)


@pytest.mark.slow
def test_the_command_writes_what_arviz_reads(folder, tmp_path, capsys):
    import xarray as xr

    place = tmp_path / "posterior"
    assert main(["sample", str(folder), "--effect", "adhesive-offset", "-o", str(place), "--effective", "300"]) == 0
    assert "[[Parameters]]" in capsys.readouterr().out
    tree = xr.open_datatree(place / "posterior.nc", engine="h5netcdf")
    told = json.loads((place / "posterior.json").read_text())
    assert tree["posterior"].sizes["chain"] == 4 and tree["posterior"]["adhesive-offset.f_a"].attrs["units"] == "N"
    assert float(tree["posterior"]["adhesive-offset.f_a"].mean()) == pytest.approx(
        told["parameters"]["adhesive-offset.f_a"]["mean"], rel=0.05)
    assert list(tree["log_likelihood"]["part"].values) == ["r01", "r02", "r03", "r04"]
    assert json.loads(tree.attrs["target"])["sha256"] == read_campaign(folder).sha256
    assert {"versions", "settings", "priors", "state"} <= set(tree.attrs) and (place / "model.json").is_file()
    tree.close()
    assert main(["sample", str(folder), "--effect", "adhesive-offset", "-o", str(place), "--effective", "300"]) == 0
    assert "continued" in capsys.readouterr().out
    assert main(["sample", str(folder), "--effect", "adhesive-offset", "-o", str(place), "--seed", "9"]) == 2
    assert "something else: seed is 0 there and 9 now" in capsys.readouterr().err


@pytest.mark.slow
def test_settings_of_a_specification(folder, tmp_path, capsys):
    (tmp_path / "fit.toml").write_text(
        f'schema = "ddetumble.fit/1"\ncampaign = "{folder}"\neffects = ["adhesive-offset"]\nseed = 4\n'
        '[priors]\n"adhesive-offset.f_a" = {mean = 0.2, sd = 0.1}\n[sampler]\nwalkers = 20\neffective = 200\n')
    assert main(["sample", str(tmp_path / "fit.toml")]) == 0
    told = json.loads((tmp_path / "posterior.json").read_text())
    assert told["settings"]["walkers"] == 20 and told["settings"]["seed"] == 4
    assert told["target"]["priors"]["adhesive-offset.f_a"] == [0.2, 0.1]


@pytest.mark.slow
def test_every_run_of_a_seed_is_the_same():
    made, _, _ = pose_line()
    one, two = (run_chains(Ensembles, made, Settings(seed=5, effective=300)) for _ in range(2))
    np.testing.assert_array_equal(one.x, two.x)
    other = run_chains(Ensembles, made, Settings(seed=6, effective=300))
    assert not np.array_equal(one.x, other.x[:, : one.x.shape[1]])


def test_the_fits_gaussian_is_drawn_in_public_units():
    """The curve of a parameter has the deviation of the fit, and ellipses of two have its covariance."""
    covariance = np.array([[1.0, 0.3, 0.0], [0.3, 0.5, 0.1], [0.0, 0.1, 2.0]])
    made = pose_curve(plain, (jnp.eye(3), jnp.zeros(3)), ["a", "b", "c"], [0.2, 0.1, -0.3], covariance)
    for k in range(3):
        value, density = _push_marginal(made, k).T
        mean = np.trapezoid(value * density, value)
        assert np.trapezoid((value - mean) ** 2 * density, value) == pytest.approx(covariance[k, k], rel=2e-3)
    inner, outer = _push_ellipses(made, 0, 1)
    own = inner - inner[:-1].mean(axis=0)
    square = np.einsum("ni,ij,nj->n", own, np.linalg.inv(covariance[:2, :2]), own)
    np.testing.assert_allclose(square, -2 * np.log(1 - 0.6827), rtol=1e-3)
    assert np.ptp(outer[:, 0]) > np.ptp(inner[:, 0])
