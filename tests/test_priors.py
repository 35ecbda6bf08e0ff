"""What priors do to a posterior, against the closed forms of a straight line with Gaussian errors."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import ddetumble as dd
from ddetumble.posterior.prior_check import check_priors, draw_priors
from ddetumble.posterior.target import pose_curve, pose_fit


SD = 0.3
TIME = np.repeat(np.arange(6.0), 4)
DESIGN = np.stack([np.ones(24), TIME], axis=1)
PRIORS = {"a": (1.2, 0.1), "b": (0.4, 0.2)}


def rows_of_line(x, data):
    """Whitened residual of a straight line, shape (readings,)."""
    return (data - x[0] - x[1] * jnp.asarray(TIME)) / SD


def solve(y, priors):
    """Mean and covariance of the posterior of a line."""
    weights = np.array([1.0 / priors[name][1] ** 2 if name in priors else 0.0 for name in "ab"])
    means = np.array([priors[name][0] if name in priors else 0.0 for name in "ab"])
    covariance = np.linalg.inv(DESIGN.T @ DESIGN / SD**2 + np.diag(weights))
    return covariance @ (DESIGN.T @ y / SD**2 + weights * means), covariance


def check_line(y, priors, count=40_000):
    mean, covariance = solve(y, priors)
    target = pose_curve(rows_of_line, jnp.asarray(y), ("a", "b"), mean, covariance, priors=priors)
    return check_priors(target, np.random.default_rng(3).multivariate_normal(mean, covariance, count))


@pytest.mark.parametrize("names", ["ab", "a"])
def test_shares_and_wider_priors(names):
    """Share of the precision, and mean and deviation with the priors twice as wide, by the normal equations."""
    y = 1.0 + 0.5 * TIME + SD * np.random.default_rng(1).standard_normal(24)
    priors = {name: PRIORS[name] for name in names}
    found, (mean, covariance) = check_line(y, priors), solve(y, priors)
    wide_mean, wide = solve(y, {name: (m, 2.0 * sd) for name, (m, sd) in priors.items()})
    for k, name in enumerate("ab"):
        one, sd = found.parameters[name], np.sqrt(covariance[k, k])
        assert one.moved == pytest.approx((wide_mean[k] - mean[k]) / sd, abs=0.03)
        assert one.widened == pytest.approx(np.sqrt(wide[k, k]) / sd, rel=0.03)
        if name in priors:
            assert one.share == pytest.approx(covariance[k, k] / priors[name][1] ** 2, rel=0.05)
            m, deviation = priors[name]
            assert one.prior == pytest.approx(tuple(stats.norm.ppf([0.5, 0.025, 0.975], m, deviation)))
        else:
            assert one.prior is None and one.share == 0.0
    assert found.trusted and found.flat == tuple(n for n in "ab" if n not in priors)


@pytest.mark.parametrize("names", ["ab", "a"])
def test_p_values_are_uniform_where_the_priors_are_true(names):
    """Of lines drawn from their priors (b from anywhere where it has none): binomial bounds over 400 of them."""
    generator, priors = np.random.default_rng(8), {name: PRIORS[name] for name in names}
    found = []
    for _ in range(400):
        a, b = (generator.normal(*PRIORS[name]) for name in "ab")
        y = a + b * TIME + SD * generator.standard_normal(24)
        found.append(check_line(y, priors, 1500).p_value)
    for level in (0.05, 0.2, 0.5, 0.8):
        low, high = stats.binom.interval(0.999, 400, level)
        assert low <= np.sum(np.array(found) < level) <= high


def test_a_wrong_prior_is_told():
    """By the distance that the closed form has; a prior about which the records say nothing is in no conflict."""
    y = 1.0 + 0.5 * TIME + SD * np.random.default_rng(1).standard_normal(24)
    priors = {"a": (3.0, 0.2)}
    found, (mean, covariance) = check_line(y, priors), solve(y, priors)
    distance = (mean[0] - 3.0) / np.sqrt(0.2**2 - covariance[0, 0])
    assert found.rejected and found.parameters["a"].distance == pytest.approx(distance, rel=0.05)
    assert found.p_value == pytest.approx(2.0 * stats.norm.sf(abs(distance)), rel=0.5)
    tight = check_line(y, {"a": (1.3, 1e-4)})
    assert tight.p_value == 1.0 and not tight.rejected and tight.parameters["a"].share > 0.97
    assert check_line(y, {}) is None


def test_draws_from_priors_keep_to_their_limits():
    target = pose_curve(rows_of_line, jnp.asarray(DESIGN[:, 0]), ("a", "b"), [1.0, 0.5], np.eye(2),
                        bounds={"a": (1.2, np.inf), "b": (0.0, 1.0)}, priors={"a": PRIORS["a"]})
    x = draw_priors(target, np.random.default_rng(2), 4000)
    assert x.shape == (4000, 2) and x[:, 0].min() >= 1.2 and 0.0 <= x[:, 1].min() and x[:, 1].max() <= 1.0
    assert stats.kstest(x[:, 0], stats.halfnorm(1.2, 0.1).cdf).pvalue > 1e-3
    assert stats.kstest(x[:, 1], stats.uniform().cdf).pvalue > 1e-3


@pytest.mark.study
def test_records_that_the_priors_expect(tmp_path):
    """Priors about the truth hold the readings of a campaign in their band, whose width grows with theirs; what has no
    prior is named instead. All of it is in the files."""
    campaign, widths = dd.read_campaign("impact-b"), []
    made = dd.fit(campaign, effects=["adhesion"])
    known = {name: made.parameters[name].estimate for name in made.parameters}
    for share in (0.02, 0.1):
        fitted = dd.fit(campaign, effects=["adhesion"], priors={n: (v, share * v) for n, v in known.items()})
        target = pose_fit(fitted)
        found = check_priors(target, target.draw_inside(np.random.default_rng(0), 1000))
        assert found.inside > 0.9 and found.flat == () and not found.rejected and found.failed == 0.0
        assert found.replicates.values.shape[1:] == found.replicates.measured.shape
        widths.append(found.width)
    assert widths[1] > 2.0 * widths[0] > 0.0
    # Friction is sampled faster than impacts.
    known = {name: p.estimate for name, p in dd.fit("slip-c").parameters.items()}
    fitted = dd.fit("slip-c", priors={name: (value, 0.1 * abs(value)) for name, value in known.items()})
    posterior = dd.sample(fitted, effective=100, most=400).examine()
    posterior.save(tmp_path)
    told = json.loads((tmp_path / "posterior.json").read_text(encoding="utf-8"))["prior"]
    assert told["inside"] == posterior.prior.inside and set(told["parameters"]) == set(known)
    assert (dd.report(posterior, tmp_path / "page").parent / "figures" / "prior-predictive.png").exists()
