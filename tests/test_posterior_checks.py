"""Checks of a posterior: replicates, left-out conditions, weights of rivals, predictions averaged over them."""

import dataclasses as dc
import json
import re
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from scipy import stats

from ddetumble._errors import InputError
from ddetumble.cli import main
from ddetumble.inference.estimation import fit
from ddetumble.measurement.package import read_campaign
from ddetumble.posterior.loo import score_conditions, smooth_weights
from ddetumble.posterior.predictive_check import check_posterior
from ddetumble.posterior.sampling import sample
from ddetumble.posterior.stacking import (
    ModelWeights,
    average,
    compare_rivals,
    draw_about,
    read_weights,
    stack_weights,
)
from ddetumble.posterior.target import pose_curve, pose_fit
from ddetumble.selection.predict import average_predictions, predict
from tests.helpers_tumble import make_long


SD = 0.3


def rows_of_line(x, data):
    """Whitened residual of a straight line, shape (readings,)."""
    t, y = data
    return (y - x[0] - x[1] * t) / SD


def make_line(seed=0, outlier=0.0, priors=None):
    """A straight line with four readings at each of six places: design, readings, labels, target."""
    rng = np.random.default_rng(seed)
    labels = np.repeat(np.arange(6), 4)
    t = labels * 1.0
    y = 1.0 + 0.5 * t + SD * rng.standard_normal(24)
    y[labels == 5] += outlier
    design = np.stack([np.ones(24), t], axis=1)
    information = design.T @ design / SD**2 + (np.diag([1 / sd**2 for _, sd in priors.values()]) if priors else 0.0)
    side = design.T @ y / SD**2 + (np.array([m / sd**2 for m, sd in priors.values()]) if priors else 0.0)
    covariance = np.linalg.inv(information)
    target = pose_curve(rows_of_line, (jnp.asarray(t), jnp.asarray(y)), ("a", "b"), covariance @ side, covariance,
                        priors=priors, parts=list(labels))
    return design, y, labels, target


def left_out_exactly(design, y, labels, priors=None):
    """Predictive density of every place in closed form, up to the whitening's constant."""
    found = []
    for k in np.unique(labels):
        keep = labels != k
        information = design[keep].T @ design[keep] / SD**2
        side = design[keep].T @ y[keep] / SD**2
        if priors:
            information = information + np.diag([1 / sd**2 for _, sd in priors.values()])
            side = side + np.array([m / sd**2 for m, sd in priors.values()])
        covariance = np.linalg.inv(information)
        own = design[~keep]
        spread = own @ covariance @ own.T + SD**2 * np.eye(len(own))
        value = stats.multivariate_normal(own @ covariance @ side, spread).logpdf(y[~keep])
        found.append(value + len(own) * np.log(SD))
    return np.array(found)


def draw_posterior(target, count=4000, seed=1):
    rng = np.random.default_rng(seed)
    return rng.multivariate_normal(target.centre, target.covariance, count)


@pytest.mark.slow
@pytest.mark.parametrize("priors", [None, {"a": (0.5, 0.4), "b": (0.7, 0.3)}])
def test_left_out_density_is_exact(priors):
    """Reweighted draws and refits give the predictive density of a linear model in closed form."""
    design, y, labels, target = make_line(priors=priors)
    x = draw_posterior(target)
    found = score_conditions(target, x, target.likelihoods(x))
    exact = left_out_exactly(design, y, labels, priors)
    assert np.abs(found.values - exact).max() < 0.1
    assert all(s.trusted for s in found.scores)
    assert found.elpd == pytest.approx(exact.sum(), abs=0.2)


def test_influential_condition_is_refitted():
    """Where draws cannot be reweighted, the refit without the condition is used, says so, and is right."""
    design, y, labels, target = make_line(outlier=4.0)
    x = draw_posterior(target, 1000)
    found = score_conditions(target, x, target.likelihoods(x))
    exact = left_out_exactly(design, y, labels)
    last = found.scores[-1]
    assert last.way == "refit" and last.trusted
    assert np.abs(found.values - exact).max() < 0.15
    assert f"{sum(s.way == 'refit' for s in found.scores)} by a refit" in found.text


def test_refit_is_least_squares():
    design, y, labels, target = make_line()
    mean, covariance = target.fit_without(np.arange(6) == 2)
    keep = labels != 2
    exact = np.linalg.lstsq(design[keep], y[keep], rcond=None)[0]
    assert np.allclose(mean, exact, atol=1e-6)
    assert np.allclose(covariance, SD**2 * np.linalg.inv(design[keep].T @ design[keep]), rtol=1e-6)


def test_weights_from_other_density():
    """Draws that are not from the posterior are corrected by their weights."""
    design, y, labels, target = make_line()
    rng = np.random.default_rng(5)
    wide = 2.5 * target.covariance
    x = rng.multivariate_normal(target.centre, wide, 4000)
    likelihoods = target.likelihoods(x)
    base = likelihoods.sum(axis=1) - stats.multivariate_normal(target.centre, wide).logpdf(x)
    found = score_conditions(target, x, likelihoods, base)
    assert np.abs(found.values - left_out_exactly(design, y, labels)).max() < 0.1


def test_tail_of_weights():
    """The shape of a heavy tail is found, light tails are not called heavy, equal weights are equal."""
    rng = np.random.default_rng(0)
    for k in (0.2, 1.0):
        weights = stats.genpareto(k).rvs(4000, random_state=rng) + 1e-3
        assert smooth_weights(np.log(weights))[1] == pytest.approx(k, abs=0.2)
    same, k = smooth_weights(np.zeros(50))
    assert k == 0.0 and np.allclose(np.exp(same), 1 / 50)
    none, k = smooth_weights(np.full(50, -np.inf))
    assert np.isinf(k) and not np.any(np.isfinite(none))


def test_stacking_finds_the_right_model():
    rng = np.random.default_rng(0)
    good = rng.normal(-10, 2, 12)
    elpd = np.stack([good, good - 5 - rng.random(12), good - 30], axis=1)
    assert np.allclose(stack_weights(elpd), [1, 0, 0], atol=1e-6)
    compared = compare_rivals(elpd, np.array([1.0, 0.0, 0.0]))
    assert compared[2][0] == pytest.approx(-360) and compared[2][1] == pytest.approx(0, abs=1e-9)


def test_stacking_mixes_models():
    """Models that are right at half of the conditions each share the weight; the maximum is one."""
    elpd = np.where(np.arange(10)[:, None] % 2 == np.arange(2), -1.0, -9.0)
    assert np.allclose(stack_weights(elpd), [0.5, 0.5], atol=1e-6)
    rng = np.random.default_rng(3)
    elpd = rng.normal(0, 1.5, (15, 3))
    w = stack_weights(elpd)
    assert w.sum() == pytest.approx(1)

    def gain(v):
        return np.log(np.exp(elpd) @ v).sum()

    for other in rng.dirichlet(np.ones(3), 2000):
        assert gain(other) <= gain(w) + 1e-9


def test_equal_models_share_the_weight():
    elpd = np.repeat(np.random.default_rng(1).normal(0, 2, (12, 1)), 2, axis=1)
    assert np.allclose(stack_weights(elpd), 0.5)
    assert stack_weights(elpd[:, :1]) == [1.0]


@pytest.mark.parametrize(
    "gains, weight, outcome",
    [
        # What the best gains over the other at every condition; its weight; what is said of it.
        (np.full(12, 2.0), 1.0, "preferred"),
        (np.full(12, 0.2), 1.0, "favoured"),  # always ahead, by 2.4 in all: certain, and small
        (np.array([0.3] * 11 + [9.0]), 1.0, "favoured"),  # 12.3 in all, most of it from one condition
        (np.array([9.0, -8.0] * 6), 0.5, "indistinguishable"),
        (np.zeros(12), 0.5, "indistinguishable"),
    ],
)
def test_outcome_of_a_comparison(gains, weight, outcome):
    """A model with all the weight is never called indistinguishable, and preferred only by a large, sure difference."""
    elpd = np.stack([gains, np.zeros(len(gains))], axis=1)
    weights = stack_weights(elpd)
    assert weights[0] == pytest.approx(weight, abs=0.01)
    assert [one[2] for one in compare_rivals(elpd, weights)] == ["best", outcome]


def test_outcomes_of_three_rivals():
    """Every rival is judged against the best, wherever the best stands."""
    elpd = np.stack([np.zeros(4), np.full(4, -9.0), np.array([0.4, 0.6, 0.5, 0.5])], axis=1)
    weights = stack_weights(elpd)
    assert weights[2] > 0.99
    assert [one[2] for one in compare_rivals(elpd, weights)] == ["favoured", "preferred", "best"]


def test_average_by_hand():
    """Mean, and deviations by the law of total variance; equal models change nothing."""
    a = pd.DataFrame({"record": ["r"], "time": [0.0], "f": [1.0], "f_sd": [0.3], "f_sd_new": [0.5]})
    b = pd.DataFrame({"record": ["r"], "time": [0.0], "f": [3.0], "f_sd": [0.1], "f_sd_new": [0.7]})
    found = average_predictions([a, b], [0.25, 0.75])
    assert found["f"][0] == pytest.approx(2.5)
    spread = 0.25 * 1.5**2 + 0.75 * 0.5**2
    assert found["f_sd"][0] == pytest.approx(np.sqrt(0.25 * 0.09 + 0.75 * 0.01 + spread))
    assert found["f_sd_new"][0] == pytest.approx(np.sqrt(0.25 * 0.25 + 0.75 * 0.49 + spread))
    same = average_predictions([a, a], [0.4, 0.6])
    assert np.allclose(same[["f", "f_sd", "f_sd_new"]], a[["f", "f_sd", "f_sd_new"]])


def write_weights(folder, **changes):
    content = {"schema": "ddetumble.weights/2", "campaign": "c", "sentence": "s", "rivals": [
        {"name": "a", "folder": "a", "weight": 0.5, "outcome": "indistinguishable"},
        {"name": "b", "folder": "b", "weight": 0.5, "outcome": "indistinguishable"}], **changes}
    folder.mkdir(exist_ok=True)
    (folder / "weights.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "changes, says",
    [
        ({"schema": "other"}, "schema"),
        ({"rivals": []}, "damaged"),
        ({"rivals": [{"name": "a", "folder": "a", "weight": 0.4, "outcome": "indistinguishable"}]}, "sum to 1"),
        ({"rivals": [{"name": "a", "folder": "../x", "weight": 1.0, "outcome": "indistinguishable"}]}, "damaged"),
        ({"rivals": [{"name": "a", "folder": "..", "weight": 1.0, "outcome": "indistinguishable"}]}, "damaged"),
        ({"rivals": [{"name": "a", "folder": "a", "weight": -1.0, "outcome": "indistinguishable"}]}, "damaged"),
        ({}, "the fit of a is not there"),
    ],
)
def test_malformed_weights(tmp_path, changes, says, capsys):
    """A folder with faulty weights is refused in one sentence, by Python and by the command."""
    folder = write_weights(tmp_path / "w", **changes)
    with pytest.raises(InputError, match=says):
        read_weights(folder)
    conditions = tmp_path / "conditions.csv"
    conditions.write_text("record,slip\na,0.1\n", encoding="utf-8")
    assert main(["predict", str(folder), str(conditions)]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


def test_weights_are_written_into_folders(tmp_path):
    """What is no folder of its own is not written through, nor over."""
    rival = SimpleNamespace(folder="a", fit=SimpleNamespace(save=lambda place: pytest.fail(f"wrote {place}")))
    found = ModelWeights("c", "", "paper", (rival,), "s", ())
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "w").mkdir()
    (tmp_path / "w" / "a").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    with pytest.raises(InputError, match="is in the way"):
        found.save(tmp_path / "w")


def test_weights_that_are_no_json(tmp_path):
    (tmp_path / "weights.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="not a JSON file"):
        read_weights(tmp_path)


@pytest.mark.parametrize("content", ["[]", "{}", '{"campaign": "x", "model": "paper", "sha256": "", "steps": []}', "{"])
def test_damaged_discovery(tmp_path, content):
    (tmp_path / "result.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match="not a result of discover"):
        average(tmp_path)
    assert main(["average", str(tmp_path)]) == 2


def test_weigh_refuses(capsys):
    """What cannot be weighed is said before anything is fitted."""
    assert main(["average", "slip-a", "--effect", "viscous-friction"]) == 2
    told = capsys.readouterr().err
    assert "at least two models" in told and "--effect" in told and "slip-a" in told
    with pytest.raises(InputError, match="names no model"):
        average("data/slip-a", ["viscous-friction,", "none"])
    assert main(["average", "slip-a", "--campaign", "slip-b", "--effect", "a", "--effect", "none"]) == 2


@pytest.mark.slow
def test_what_is_said_of_an_effect_is_for_the_rivals_that_have_it():
    """A prior of an effect's parameter is that of the models with the effect; of no rival's it is refused."""
    campaign = read_campaign("data/slip-a")
    priors = {"adhesive-offset.f_a": (0.27, 0.001), "loss_factor": (0.1, 5.0)}
    found = average(campaign, ["adhesive-offset", "none"], priors=priors)
    fits = {one.name: one.fit for one in found.rivals}
    assert set(fits["adhesive-offset"].problem.priors) == {*priors}
    assert set(fits["reference"].problem.priors) == {"loss_factor"}
    with pytest.raises(InputError) as refused:
        average(campaign, ["adhesive-offset", "none"], priors={"viscous-friction.c": (1.0, 1.0)})
    assert refused.value.key == "priors"


@pytest.fixture(scope="module")
def fits():
    """A shipped campaign of friction with its right model, and without the effect."""
    campaign = read_campaign("data/slip-a")
    return {name: fit(campaign, "paper", effects) for name, effects in (("right", ["adhesive-offset"]), ("wrong", []))}


@pytest.mark.study
def test_checks_tell_right_from_wrong(fits):
    """A model that lacks an effect is flagged, the right one is not."""
    for name, wanted in (("right", False), ("wrong", True)):
        target = pose_fit(fits[name])
        found = check_posterior(target, target.draw_inside(np.random.default_rng(0), 48))
        assert found.rejected == wanted, found.sentence
        assert bool(found.outstanding) == wanted
        assert len(found.records) == 24 and found.comparisons == 74
        shape = found.replicates.values.shape
        assert shape[1:] == found.replicates.measured.shape
        # Replicates scatter about the model as the noise says.
        measured = np.isfinite(found.replicates.measured)
        scatter = found.replicates.values[:, measured].std(axis=0).mean()
        if name == "right":
            assert scatter == pytest.approx(fits[name].noise["tangential_force"].sd, rel=0.25)


@pytest.mark.slow
def test_checks_are_calibrated(fits):
    """Records that the model itself makes give p-values near uniform, and are flagged no more than they should be."""
    right = fits["right"]
    target = pose_fit(right)
    x = target.draw_inside(np.random.default_rng(1), 48)
    made = check_posterior(target, x).replicates.values[:8, :, :, :]
    p, rejected = [], 0
    for values in made:
        stack = target.records.stack
        fresh = jnp.asarray(np.where(np.isfinite(values), values, 0.0))
        plan = dc.replace(target.plan, stack=dc.replace(stack, values=fresh))
        other = dc.replace(target, plan=plan, records=dc.replace(target.records, stack=plan.stack))
        found = check_posterior(other, x)
        rejected += found.rejected
        p += [one.p_values["chi_square"] for one in found.records]
    assert rejected <= 1
    assert stats.kstest(p, "uniform").statistic < 0.2
    assert np.mean(np.array(p) < 0.1) < 0.2


@pytest.mark.slow
def test_left_out_equals_refits(fits):
    """Scores by reweighting agree with refits without each condition."""
    target = pose_fit(fits["right"])
    x, likelihoods, base = draw_about(target)
    found = score_conditions(target, x, likelihoods, base)
    assert all(s.trusted and s.way == "draws" for s in found.scores)
    for k in (0, 12):
        out = np.arange(24) == k
        mean, covariance = target.fit_without(out)
        y = np.random.default_rng(k).multivariate_normal(mean, covariance, 480)
        own = target.likelihoods(y)[:, out].sum(axis=1)
        direct = np.log(np.mean(np.exp(own - own.max()))) + own.max()
        own = next(s for s in found.scores if s.records == (target.parts[k],))
        assert own.elpd == pytest.approx(direct, abs=0.2)


@pytest.mark.slow
def test_weigh_and_predict(tmp_path, capsys):
    """The effect that is there gets the weight; `predict` on the folder averages over the rivals."""
    folder = tmp_path / "weights"
    words = ["average", "data/slip-a", "--effect", "adhesive-offset", "--effect", "none", "-o", str(folder)]
    assert main(words) == 0
    assert "adhesive-offset" in capsys.readouterr().out
    content = json.loads((folder / "weights.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in content["rivals"]] == ["adhesive-offset", "reference"]
    assert content["rivals"][0]["weight"] > 0.99 and content["rivals"][1]["outcome"] == "preferred"
    content["rivals"][0]["weight"], content["rivals"][1]["weight"] = 0.7, 0.3
    (folder / "weights.json").write_text(json.dumps(content), encoding="utf-8")
    conditions = pd.DataFrame({"record": "a", "normal_load": 20.0, "internal_pressure": 1e6, "slip_speed": 0.02,
                               "slip": [0.01, 0.02]})
    found = predict(folder, conditions)
    parts = [predict(folder / name, conditions) for name in ("adhesive-offset", "reference")]
    mean = 0.7 * parts[0]["tangential_force"] + 0.3 * parts[1]["tangential_force"]
    assert np.allclose(found["tangential_force"], mean)
    spread = 0.7 * 0.3 * (parts[0]["tangential_force"] - parts[1]["tangential_force"]) ** 2
    for ending in ("_sd", "_sd_new"):
        own = 0.7 * parts[0]["tangential_force" + ending] ** 2 + 0.3 * parts[1]["tangential_force" + ending] ** 2
        assert np.allclose(found["tangential_force" + ending] ** 2, own + spread)
    assert {"0.70", "0.30"} <= set(found.attrs["notes"][0].replace(")", " ").replace(",", " ").split())


@pytest.mark.study
def test_weights_of_models_that_are_all_wrong():
    """Records that no rival describes, at some of which scores are unreliable: both are told, beside the weights that
    the others alone give."""
    found = average("paper/table-3", ["wall-stiffness", "none"])
    scores = [one.scores for one in found.rivals]
    kept = np.all([[s.trusted for s in one.scores] for one in scores], axis=0)
    assert found.misfit and found.rivals[0].name == "wall-stiffness" and 0 < kept.sum() < len(kept)
    alone = stack_weights(np.stack([one.values for one in scores], axis=1)[kept])
    assert [one.trusted_weight for one in found.rivals] == pytest.approx(list(alone), abs=1e-3)
    lowest = min(one.fit.chi2_reduced for one in found.rivals)
    assert f"{lowest:.3g}" in found.sentence and found.to_dict()["misfit"] is True
    assert any(all(f"{one.name} {one.trusted_weight:.2f}" in note for one in found.rivals) for note in found.notes)


@pytest.mark.slow
def test_report_of_a_posterior(fits, tmp_path):
    """An examined posterior goes into files, and into a page whose first sentence is the answer."""
    import arviz_base  # noqa: F401
    import xarray as xr

    from ddetumble.reports import write_posterior

    found = sample(fits["right"], most=50, burn=50, ensembles=2, effective=200).examine()
    assert found.predictive is not None and not found.predictive.rejected
    folder = found.save(tmp_path / "posterior")
    content = json.loads((folder / "posterior.json").read_text(encoding="utf-8"))
    assert len(content["predictive"]["records"]) == 24 and len(content["left_out"]["scores"]) == 24
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        assert tree["posterior_predictive"]["tangential_force"].shape[2:] == tree["observed_data"][
            "tangential_force"].shape
    html = write_posterior(found, folder).read_text(encoding="utf-8")
    first = html[html.index("<h1"): html.index("</h1>")]
    assert "95\u00a0% intervals" in first or "not converged" in first
    bare = re.sub(r"base64,[A-Za-z0-9+/=]+", "", html)  # chance writes any four letters into a megabyte of pixels
    assert "http" not in bare.split("<body", 1)[1].replace("http-equiv", "")
    for name in ("corner", "trace", "ranks", "predictive", "left-out"):
        assert (folder / "figures" / f"{name}.png").stat().st_size > 5000


@pytest.mark.study
def test_checks_of_tumbling_records():
    """Sparse records, whose mesh is longer than they are, keep it whole; free starts count on neither side."""
    interval = 10.0
    found = fit(make_long(4, 600.0, interval, 0.3))
    mesh, samples = found.problem.records.stack.inputs["mesh"].shape[1], int(600 / interval) + 1
    target = pose_fit(found)
    trimmed = target.records.stack.inputs["mesh"]
    assert mesh > 64 > samples and trimmed.shape == (4, mesh)
    assert float(trimmed.max()) == 600.0
    checks = check_posterior(target, target.draw_inside(np.random.default_rng(0), 48))
    assert not checks.rejected
    # Three channels and no nuisance with a prior: chi-square over 3 n degrees is 1 within a few of its deviations.
    ratio = np.mean([one.chi_square for one in checks.records])
    assert abs(ratio - 1.0) < 4.0 * np.sqrt(2.0 / (4 * 3 * samples))
    assert all(one.samples == 3 * samples for one in checks.records)
