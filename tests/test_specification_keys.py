"""Keys that a TOML file does not have: the message lists those that it may have there."""

import pytest
from typer.testing import CliRunner

import ddetumble as dd
from ddetumble.cli import app


SCENARIO = 'schema = "ddetumble.plan/1"\n[debris]\nangular_velocity = [0.1, 0.2, 0.0]\n'


@pytest.mark.parametrize(("text", "column", "known"), [
    ("[arm]\nmas = 5.0\n", "arm.mas", "tangential_mass"), ("colour = 1\n", "colour", "debris"),
    ("[uncertainty.parameters.restitution]\nsigma = 0.1\n", "uncertainty.parameters.restitution.sigma", "sd"),
])  # fmt: skip
def test_an_unknown_key_of_a_scenario(tmp_path, text, column, known):
    path = tmp_path / "scenario.toml"
    path.write_text(text + SCENARIO if column == "colour" else SCENARIO + text)
    done = CliRunner().invoke(app, ["plan", str(path), "-o", str(tmp_path / "plan")])
    assert isinstance(done.exception, dd.InputError)
    assert done.exception.column == column and known in str(done.exception)
