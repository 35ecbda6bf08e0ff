"""Prediction: exact beside the independent simulator, honest deviations, strict about CONDITIONS.csv."""

import dataclasses as dc

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

from ddetumble import ComputationError, InputError, predict, predict_pulses
from ddetumble.cli import main
from ddetumble.contact.law import Ball
from ddetumble.dynamics import simulate_impact as simulate_impact
from ddetumble.dynamics.impact import bound_depression, compare_energy
from ddetumble.effects.impact import StressSoftening, WallStiffness
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact import simulate
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.inference.archive import load, make_fitted, save_model
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.inference.problem import Problem
from ddetumble.inference.stack import default_noise, stack_records
from ddetumble.measurement.package import read_campaign
from ddetumble.selection import predict as prediction
from ddetumble.selection.predict import find_squeezes, read_request


BASE = {"effective_mass": 1.3, "restitution": 0.72}
ALL = ("normal_force", "depression", "pressure")
PRESSURES, SPEEDS = (5e5, 1e6, 2e6), (0.2, 0.45)


def fit_folder(folder, seed, effects=None, classes=(), channels=("normal_force",)):
    """Simulate a small campaign, fit it, and save the model; returns the folder and the campaign as simulated."""
    made = make_campaign("made", seed, effects or {}, BASE, PRESSURES, SPEEDS, 2, channels=channels, interval=1e-3)
    write_package(folder / f"campaign-{seed}", made)
    campaign = read_campaign(folder / f"campaign-{seed}")
    space = ParameterSpace(Ball(), classes)
    problem = Problem(space, stack_records(campaign))
    solution = problem.solve(space.of([None, *(c.id for c in classes)]), space.coordinates(),
                             tolerance=1e-4)
    assert not solution.failed and 0.8 < solution.chi2 / np.sum(np.asarray(problem.records.stack.weights) > 0) < 1.2
    noise = {c: default_noise(campaign, c, np.arange(9) * 1e-3) for c in channels}
    save_model(folder / f"model-{seed}", make_fitted(
        campaign=campaign, model_name="paper", space=space, solution=solution, noise=noise,
        effects=[c.id for c in classes]))
    return folder / f"model-{seed}", made


def tabulate(settings, times):
    """Rows of CONDITIONS.csv for settings by record, all at the same times."""
    return pd.concat([pd.DataFrame({"record": key, **values, "time": times}) for key, values in settings.items()],
                     ignore_index=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("predict")


@pytest.fixture(scope="module")
def reference(folder):
    return fit_folder(folder, 0)[0]


@pytest.mark.slow
def test_exact(reference):
    """At other conditions and on all channels, the truth put into the model gives what the other simulator gives."""
    effects = {"wall-stiffness": {"k_w": 900.0, "q": 1.0}, "stress-softening": {"sigma_m": 0.1, "j_0": 4.0}}
    plain = load(reference)
    space = ParameterSpace(Ball(), (WallStiffness, StressSoftening))
    truth = {"wall-stiffness.k_w": 900.0, "stress-softening.sigma_m": 0.1, "stress-softening.j_0": 4.0}
    noise = {channel: plain.noise["normal_force"] for channel in ALL}
    saved = dc.replace(plain, space=space, u=space.coordinates(BASE | truth), noise=noise, free=(),
                       covariance=np.zeros((0, 0)))
    times = np.concatenate([np.linspace(-2e-3, 0.09, 150), [0.5, 8.0]])  # long after separation too
    settings = {"a": {"initial_pressure": 7e5, "approach_speed": 0.31, "sequence": 3},
                "b": {"initial_pressure": 1.7e6, "approach_speed": 0.42, "sequence": 14}}
    table = predict(saved, tabulate(settings, times))
    for key, conditions in settings.items():
        exact = simulate(BASE, effects, conditions, times, ALL)
        own = table[table.record == key]
        for channel, values, size in zip(ALL, exact.T, (2e-4, 1e-9, 1.0), strict=True):
            np.testing.assert_allclose(own[channel], values, atol=size, rtol=1e-5)
    short = predict(saved, tabulate({"a": settings["a"]}, times[60:61]))  # one row only
    np.testing.assert_allclose(short["normal_force"], table["normal_force"][60], rtol=1e-5)


@pytest.mark.slow
def test_deviations(folder):
    """The stated deviations hold the truth, and new measurements, as often as they say."""
    generator = np.random.Generator(np.random.PCG64(5))
    errors, inside = [], []
    for seed in range(6):
        path, _ = fit_folder(folder, seed)
        nominal, true, shifts = {}, {}, {}
        for k in range(8):
            setting = {"initial_pressure": generator.uniform(5e5, 2e6), "approach_speed": generator.uniform(0.2, 0.45)}
            a, b, c = generator.standard_normal(3)
            nominal[f"n{k}"], shifts[f"n{k}"] = {**setting, "sequence": 1}, 5e-5 * c
            true[f"n{k}"] = {"initial_pressure": setting["initial_pressure"] * (1 + 0.005 * a),
                             "approach_speed": setting["approach_speed"] * (1 + 0.003 * b)}
        times = np.linspace(1e-3, 0.07, 70)
        table = predict(path, tabulate(nominal, times))
        for key, own in table.groupby("record"):
            mean = simulate(BASE, {}, nominal[key], times, rtol=1e-9)[:, 0]
            new = simulate(BASE, {}, true[key], times - shifts[key], rtol=1e-9)[:, 0]
            new += 0.25 * generator.standard_normal(len(times))
            touch = own["normal_force"].to_numpy() > 1.0
            errors.append(((own["normal_force"] - mean) / own["normal_force_sd"]).to_numpy()[touch])
            inside.append(((own["normal_force"] - new) / own["normal_force_sd_new"]).to_numpy()[touch])
    # Two parameters and six fits: twelve degrees of freedom.
    assert 0.25 < np.mean(np.concatenate(errors) ** 2) < 2.7
    new = np.concatenate(inside)
    assert 0.90 < np.mean(np.abs(new) < 1.96) < 0.985 and 0.8 < np.sqrt(np.mean(new**2)) < 1.25


def test_order(reference, tmp_path):
    """Unsorted times come back in the order in which they were asked for; the file and the table give the same."""
    settings = {"b": {"initial_pressure": 1e6, "approach_speed": 0.3}, "a": {"initial_pressure": 6e5,
                                                                            "approach_speed": 0.4}}
    rows = tabulate(settings, np.linspace(0.0, 0.05, 40))
    mixed = rows.sample(frac=1.0, random_state=1)
    mixed.to_csv(tmp_path / "conditions.csv", index=False)
    plain, found = predict(reference, rows), predict(reference, tmp_path / "conditions.csv")
    assert list(found.columns) == ["record", "time", "normal_force", "normal_force_sd", "normal_force_sd_new"]
    assert list(found["record"]) == list(mixed["record"]) and list(found["time"]) == list(mixed["time"])
    np.testing.assert_allclose(found["normal_force"], plain["normal_force"].to_numpy()[mixed.index], rtol=1e-9)
    assert found.attrs["notes"] == ()
    assert (found["normal_force_sd_new"] >= 0.24).all() and (found["normal_force_sd"] >= 0).all()


def test_extrapolation(reference, tmp_path, capsys):
    """Conditions beyond the campaign's are named, also where it was another unit that was meant."""
    text = "record,initial_pressure,approach_speed,time\nx,9e6,0.3,0.01\n"
    (tmp_path / "far.csv").write_text(text)
    assert main(["predict", str(reference), str(tmp_path / "far.csv"), "-o", str(tmp_path / "out.csv")]) == 0
    assert "initial_pressure = 9e+06 Pa lies outside" in capsys.readouterr().err
    assert len(pd.read_csv(tmp_path / "out.csv")) == 1


@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_the_bound_of_the_depression_is_that_of_an_undamped_ball(speed):
    """Solved in time, a ball without damping comes as far as its energy says, and one with damping less far."""
    conditions = {"initial_pressure": jnp.asarray(1e6), "approach_speed": jnp.asarray(speed)}
    times = jnp.linspace(0.0, 0.03, 2000)
    deepest = {e: float(simulate_impact(Ball(restitution=e), conditions, times).depression.max()) for e in (0.5, 1.0)}
    bound, diameter = bound_depression(Ball(restitution=0.5).extend(()), conditions)
    assert float(bound) == pytest.approx(deepest[1.0], rel=1e-3) and deepest[0.5] < float(bound)
    assert float(diameter) == 0.06
    # The energy over the work up to a share of the diameter is one where the bound reaches it, and goes as v².
    share = float(bound) / 0.06
    law, twice = Ball(restitution=0.5).extend(()), conditions | {"approach_speed": jnp.asarray(2.0 * speed)}
    assert float(compare_energy(law, conditions, share)) == pytest.approx(1.0, rel=1e-4)
    assert float(compare_energy(law, twice, share)) == pytest.approx(4.0, rel=1e-4)


def test_absurd_conditions_are_told_by_what_they_do_to_the_ball(reference):
    """A record that squeezes the ball out of shape is found, whether or not the model can still be integrated there."""
    saved = load(reference)
    settings = {"initial_pressure": np.array([1e6, 1e6, 1e6]), "approach_speed": np.array([0.4, 10.0, 400.0])}
    slow, fast = find_squeezes(saved, ["a", "b", "c"], settings)
    assert (slow.record, fast.record) == ("b", "c")
    assert 0.5 * slow.diameter < slow.depression < slow.diameter <= fast.depression
    rows = pd.DataFrame({"record": ["a", "b"], "initial_pressure": 1e6, "approach_speed": [0.4, 10.0]})
    calm, beyond = (set(predict(saved, rows[rows.record == key]).attrs["notes"]) for key in "ab")
    assert not calm and len(beyond) == 2  # outside what was measured, and what follows for the ball


def test_what_cannot_be_integrated_says_what_is_out_of_the_ordinary(reference, monkeypatch):
    saved = load(reference)
    work = prediction._linearise

    def fail(*given):
        *found, failed = work(*given)
        return *found, np.ones_like(failed)

    monkeypatch.setattr(prediction, "_linearise", fail)
    settings = {"initial_pressure": 1e6, "approach_speed": 40.0}
    (squeeze,) = find_squeezes(saved, ["x"], {name: np.array([value]) for name, value in settings.items()})
    with pytest.raises(ComputationError) as found:
        predict(saved, pd.DataFrame([{"record": "x"} | settings]))
    (outside,) = saved.outside(settings)
    assert outside in str(found.value) and str(squeeze) in str(found.value)


HEAD = "record,initial_pressure,approach_speed,time\n"


@pytest.mark.parametrize(("text", "words"), [
    ("record,initial_pressure,time\nx,1e6,0.01\n", "approach_speed"),
    ("record,initial_pressure,approach_speed\nx,1e6,0.3\nx,1e6,0.3\n", "line 3, column record"),
    ("record,initial_pressure [s],approach_speed\nx,1,0.3\n", "column initial_pressure [s]"),
    ("record,initial_pressure [barg],approach_speed\nx,1,0.3\n", "column initial_pressure [barg]"),
    ("record,initial_pressure [MPa],initial_pressure,approach_speed\nx,1,1e6,0.3\n", "column initial_pressure"),
    ("record,initial_pressure [MPa],approach_speed\nx,-1,0.3\n", "line 2, column initial_pressure [MPa]"),
    ("initial_pressure,approach_speed,time\n1e6,0.3,0.01\n", "record"),
    (HEAD + "x,1e6,fast,0.01\n", "line 2, column approach_speed"),
    (HEAD + "x,1e6,0.3,0.01\nx,1e6,0.3,\n", "line 3, column time"),
    (HEAD + "x,-1e6,0.3,0.01\n", "line 2, column initial_pressure"),
    (HEAD + "x,1e6,0,0.01\n", "line 2, column approach_speed"),
    (HEAD + "x,1e6,0.3,0.01\nx,2e6,0.3,0.02\n", "line 3, column initial_pressure"),
    (HEAD + ",1e6,0.3,0.01\n", "line 2, column record"),
    (HEAD + "x,nan,0.3,0.01\n", "line 2, column initial_pressure"),
    (HEAD + '"x","1,0",0.3,0.01\n', "line 2, column initial_pressure"),
    (HEAD + "x,1e6,0.3\n", "line 2"),
    (HEAD, "no data rows"),
    ("", "empty"),
])  # fmt: skip
def test_malformed(reference, tmp_path, capsys, text, words):
    """One sentence with file, line and column; exit code 2; nothing written."""
    path = tmp_path / "conditions.csv"
    path.write_text(text)
    with pytest.raises(InputError):
        predict(reference, path)
    assert main(["predict", str(reference), str(path), "-o", str(tmp_path / "out.csv")]) == 2
    output = capsys.readouterr()
    assert words in output.err and "conditions.csv" in output.err and output.err.count("\n") == 1, output.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["conditions.csv"]


def test_units_in_headings_and_times_of_its_own(reference, tmp_path):
    """Conditions alone are enough: the records last beyond separation, and are those of the same conditions in SI."""
    path = tmp_path / "conditions.csv"
    path.write_text("initial_pressure [bar],approach_speed [mm/s]\n10,400\n20,300\n", encoding="utf-8")
    table = predict(reference, path)
    assert list(dict.fromkeys(table["record"])) == ["r01", "r02"]
    first = table["record"] == "r01"
    plain = predict(reference, pd.DataFrame({
        "record": table["record"], "time": table["time"], "initial_pressure": np.where(first, 1e6, 2e6),
        "approach_speed": np.where(first, 0.4, 0.3)}))
    np.testing.assert_allclose(table["normal_force"], plain["normal_force"], rtol=1e-6, atol=1e-6)
    durations = predict_pulses(reference, path).set_index("record")["contact_duration"]
    for key, own in table.groupby("record"):
        assert 50 < len(own) < 400 and own["time"].iloc[0] == 0.0
        assert 1.1 < own["time"].iloc[-1] / durations[key] < 1.4 and own["normal_force"].iloc[-1] == 0.0
        assert np.allclose(np.diff(own["time"]), own["time"].iloc[1])


@pytest.mark.parametrize(("values", "meant"), [
    ("10,0.4", "initial_pressure [bar]"), ("1.0,0.4", "initial_pressure [MPa]"), ("1e6,400", "approach_speed [mm/s]"),
    ("1e6,40", ""), ("3e7,0.4", "")])
def test_a_number_without_a_unit_that_another_unit_would_explain(reference, tmp_path, values, meant):
    """It counts as SI; far from what was measured, it is asked whether a usual unit is meant that comes near it."""
    path = tmp_path / "conditions.csv"
    path.write_text(f"initial_pressure,approach_speed\n{values}\n", encoding="utf-8")
    saved = load(reference)
    if meant:
        with pytest.raises(InputError) as caught:
            read_request(path, saved)
        assert meant in str(caught.value)
    else:
        read_request(path, saved)


@pytest.mark.parametrize("delimiter", [";", "\t"], ids=["semicolons", "tabs"])
def test_a_table_of_a_spreadsheet_with_decimal_commas(reference, tmp_path, delimiter):
    """As spreadsheet programs write it where decimals have commas; what may be a thousands separator is refused."""
    path = tmp_path / "conditions.csv"
    lines = ["record,initial_pressure [bar],approach_speed [m/s]", "a,10.5,0.4", "b,20,0.25"]
    path.write_text("\n".join(lines) + "\n")
    plain = predict(reference, path)
    path.write_text("\n".join(line.replace(",", delimiter).replace(".", ",") for line in lines) + "\n")
    pd.testing.assert_frame_equal(predict(reference, path), plain)
    path.write_text("\n".join(line.replace(",", delimiter) for line in lines) + "\n")
    pd.testing.assert_frame_equal(predict(reference, path), plain)
    for cells in (("a", "1,000", "4"), ("a", "10,5", "0.4")):
        path.write_text("\n".join([lines[0].replace(",", delimiter), delimiter.join(cells)]) + "\n")
        with pytest.raises(InputError, match="comma"):
            predict(reference, path)


def test_gauge_pressures_count_from_the_ambient_pressure(reference, tmp_path, capsys):
    """Given, or as the campaign states it; where that is stated and nothing is said, a note asks."""
    path, absolute = tmp_path / "conditions.csv", tmp_path / "absolute.csv"
    path.write_text("p0 [bar],v [m/s]\n10,0.4\n", encoding="utf-8")
    absolute.write_text("p0 [bar],v [m/s]\n11.01,0.4\n", encoding="utf-8")
    saved = load(reference)
    stated = dc.replace(saved, extra={**saved.extra, "ambient_pressure": 1.01e5})
    expected, peak = (function(saved, absolute) for function in (predict, predict_pulses))
    for model, ambient in ((saved, "1.01 bar"), (stated, None), (stated, 1.01e5)):
        np.testing.assert_allclose(predict(model, path, gauge=True, ambient=ambient)["normal_force"],
                                   expected["normal_force"], rtol=1e-9, atol=1e-9)
        assert predict_pulses(model, path, gauge=True, ambient=ambient)["peak_normal_force"][0] == pytest.approx(
            peak["peak_normal_force"][0])
    asked, quiet, none = (predict(model, absolute, gauge=gauge).attrs["notes"]
                          for model, gauge in ((stated, None), (stated, False), (saved, None)))
    assert len(asked) == len(quiet) + 1 and any("--gauge" in note for note in asked) and quiet == none
    for words, option in ((["--gauge"], "--ambient"), (["--ambient", "1 bar"], "--gauge"),
                          (["--gauge", "--ambient", "101.3"], "kPa")):
        assert main(["predict", str(reference), str(path), *words, "-q"]) == 2
        assert option in capsys.readouterr().err
    assert main(["predict", str(reference), str(path), "--gauge", "--ambient", "101 kPa", "-q"]) == 0
    for wrong in (-1.01e5, 0.0, float("nan"), float("inf"), True, "-1 bar", "1"):
        with pytest.raises(InputError, match="ambient_pressure|positive") as caught:
            predict(saved, path, gauge=True, ambient=wrong)
        assert caught.value.option == "--ambient"
    for heading in ("gauge pressure [bar]", "p0 [barg]", "initial_pressure [bar(g)]"):
        path.write_text(f"{heading},v [m/s]\n10,0.4\n", encoding="utf-8")
        np.testing.assert_allclose(predict(stated, path, gauge=True)["normal_force"], expected["normal_force"],
                                   rtol=1e-9, atol=1e-9)
    for heading in ("p0 [barg]", "gauge pressure [bar]"):
        path.write_text(f"{heading},v [m/s]\n10,0.4\n", encoding="utf-8")
        with pytest.raises(InputError, match="--gauge"):
            predict(saved, path)


def test_gauge_pressures_of_a_model_that_reads_none_are_refused(reference, tmp_path):
    path = tmp_path / "conditions.csv"
    path.write_text("v [m/s]\n0.4\n", encoding="utf-8")
    saved = load(reference)
    without = dc.replace(saved, ranges={name: ends for name, ends in saved.ranges.items() if "pressure" not in name})
    with pytest.raises(InputError, match="no pressure") as caught:
        predict(without, path, gauge=True, ambient="1 bar")
    assert caught.value.option == "--gauge"


def test_a_fitted_model_keeps_the_ambient_pressure_of_its_campaign(reference, folder, tmp_path):
    campaign = read_campaign(folder / "campaign-0")
    campaign = dc.replace(campaign, known=campaign.known | {"ambient_pressure": 9.9e4})
    space = ParameterSpace(Ball(), ())
    problem = Problem(space, stack_records(campaign))
    solution = problem.solve(space.of([None]), space.coordinates(), tolerance=1e-2)
    noise = {"normal_force": default_noise(campaign, "normal_force", np.arange(9) * 1e-3)}
    save_model(tmp_path, make_fitted(campaign=campaign, model_name="paper", space=space, solution=solution,
                                     noise=noise, effects=[], extra={"misfit": 2.0}))
    again = load(tmp_path)
    assert again.ambient_pressure == 9.9e4 and again.misfit == 2.0 and load(reference).ambient_pressure is None


def test_headings_are_those_that_import_takes(reference, tmp_path):
    """What a laboratory calls its columns means the same; without a unit it is refused, as in `import`."""
    path, plain = tmp_path / "conditions.csv", tmp_path / "plain.csv"
    plain.write_text("record,initial_pressure,approach_speed,time\na,1e6,0.4,0.01\nb,2e6,0.3,0.01\n", encoding="utf-8")
    expected = predict(reference, plain)
    for heading in ("Versuch,Druck [MPa],Geschwindigkeit [mm/s],t [ms]", "Test,Fülldruck_MPa,v (mm/s),Time/ms"):
        path.write_text(f"{heading}\na,1.0,400,10\nb,2.0,300,10\n", encoding="utf-8")
        found = predict(reference, path)
        assert list(found["record"]) == ["a", "b"]
        np.testing.assert_allclose(found["normal_force"], expected["normal_force"])
    for heading, column in (("Druck,v [m/s]", "Druck"), ("p0 [MPa],v0", "v0")):
        path.write_text(f"{heading}\n1.0,0.4\n", encoding="utf-8")
        with pytest.raises(InputError) as refused:
            predict(reference, path)
        assert refused.value.column == column
    # The name itself comes first: what might also mean it is left out.
    path.write_text("record,initial_pressure,approach_speed,time,v [m/s]\na,1e6,0.4,0.01,7\n", encoding="utf-8")
    np.testing.assert_allclose(predict(reference, path)["normal_force"], expected["normal_force"][:1])


@pytest.mark.slow
def test_pulses_are_those_of_the_other_simulator(reference):
    """Peak, duration and impulse of the truth, and deviations that are those of predictions at draws of the fit."""
    plain = load(reference)
    saved = dc.replace(plain, u=plain.space.coordinates(BASE))
    settings = pd.DataFrame({"record": ["a", "b"], "initial_pressure": [7e5, 1.7e6], "approach_speed": [0.31, 0.42]})
    found = predict_pulses(saved, settings).set_index("record")
    times = np.linspace(0.0, 0.09, 90_001)
    for key, row in settings.set_index("record").iterrows():
        exact = simulate(BASE, {}, dict(row) | {"sequence": 1}, times, ("normal_force",))[:, 0]
        assert found.loc[key, "peak_normal_force"] == pytest.approx(exact.max(), rel=1e-4)
        assert found.loc[key, "normal_impulse"] == pytest.approx(np.trapezoid(exact, times), rel=1e-4)
        assert found.loc[key, "contact_duration"] == pytest.approx(times[exact > 0][-1], abs=2e-6)
    names = ["peak_normal_force", "contact_duration", "normal_impulse"]
    random = np.random.default_rng(2)
    drawn = {False: [], True: []}
    for _ in range(150):
        u = saved.u + random.standard_normal(len(saved.spread())) @ saved.spread()
        other = settings.assign(initial_pressure=settings["initial_pressure"] * (1 + 0.005 * random.standard_normal(2)),
                                approach_speed=settings["approach_speed"] * (1 + 0.003 * random.standard_normal(2)))
        for new in drawn:
            one = predict_pulses(dc.replace(saved, u=u), other if new else settings)
            drawn[new].append(one[names].to_numpy() + (random.normal(scale=saved.noise["normal_force"].sd, size=(2, 1))
                                                       * [1, 0, 0] if new else 0.0))
    for new, ending in ((False, "_sd"), (True, "_sd_new")):
        scatter = np.std(drawn[new], axis=0)
        stated = found[[name + ending for name in names]].to_numpy()
        np.testing.assert_allclose(stated, scatter, rtol=0.25)  # a deviation of 150 draws is known to 6 %


@pytest.mark.slow
def test_the_command_reports_and_draws(reference, tmp_path, capsys):
    path, out = tmp_path / "conditions.csv", tmp_path / "out.csv"
    path.write_text("record,initial_pressure [MPa],approach_speed\na,1,0.4\nb,1.5,0.3\n", encoding="utf-8")
    assert main(["predict", str(reference), str(path), "-o", str(out)]) == 0
    told = capsys.readouterr().out
    pulses = pd.read_csv(tmp_path / "out-pulses.csv")
    assert list(pulses["record"]) == ["a", "b"] and "contact_duration" in told
    assert f"{pulses['peak_normal_force'][0]:.4g}" in told
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert main(["predict", str(reference), str(path), "-o", str(out)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert main(["predict", str(reference), str(path), "-o", str(out), "--overwrite"]) == 0
    assert main(["predict", str(reference), str(path)]) == 0
    output = capsys.readouterr()
    assert output.out.count("record,time,") == 1 and "contact_duration" in output.err


@pytest.mark.slow
def test_no_model(tmp_path):
    with pytest.raises(InputError, match=r"no model.json"):
        predict(tmp_path, pd.DataFrame({"record": ["x"], "time": [0.0]}))
