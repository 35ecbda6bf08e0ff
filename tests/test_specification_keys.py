"""Keys that a TOML file does not have: the message lists those that it may have there."""

import pickle

import pytest
from typer.testing import CliRunner

import ddetumble as dd
from ddetumble.cli import app


SCENARIO = 'schema = "ddetumble.plan/1"\n[debris]\nangular_velocity = [0.1, 0.2, 0.0]\n'


@pytest.mark.parametrize(("text", "key", "known"), [
    ("[arm]\nmas = 5.0\n", "arm.mas", "tangential_mass"), ("colour = 1\n", "colour", "debris"),
    ("[uncertainty.parameters.restitution]\nsigma = 0.1\n", "uncertainty.parameters.restitution.sigma", "sd"),
])  # fmt: skip
def test_an_unknown_key_of_a_scenario(tmp_path, text, key, known):
    path = tmp_path / "scenario.toml"
    path.write_text(text + SCENARIO if key == "colour" else SCENARIO + text)
    done = CliRunner().invoke(app, ["plan", str(path), "-o", str(tmp_path / "plan")])
    assert isinstance(done.exception, dd.InputError)
    assert done.exception.key == key and done.exception.column is None and known in str(done.exception)


def test_a_fault_that_the_model_finds_names_the_file_and_its_key(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO + "[arm]\nchaser = [0.0, 0.0, 0.0]\n")
    done = CliRunner().invoke(app, ["plan", str(path), "-o", str(tmp_path / "plan")])
    assert isinstance(done.exception, dd.InputError)
    assert (done.exception.file, done.exception.key, done.exception.column) == (str(path), "arm.chaser", None)


def test_a_fault_of_a_fit_names_the_file_and_its_key(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text('schema = "ddetumble.fit/1"\ncampaign = "impact-b"\n[priors]\n"no-such" = { mean = 1, sd = 1 }\n')
    with pytest.raises(dd.InputError) as found:
        dd.fit(path)
    assert (found.value.file, found.value.key, found.value.column) == (str(path), "priors", None)


def test_an_error_keeps_its_place_between_processes():
    sent = dd.InputError("is none", file="a.toml", key="arm.mass", row=3)
    got = pickle.loads(pickle.dumps(sent))
    assert (got.problem, got.file, got.key, got.row, got.column) == ("is none", "a.toml", "arm.mass", 3, None)
