"""Keys that a TOML file does not have: the message lists those that it may have there, the nearest one first."""

import pickle
import subprocess
import sys
from typing import get_args, get_origin

import numpy as np
import pydantic
import pytest
from typer.testing import CliRunner

import ddetumble as dd
from ddetumble.cli import app
from ddetumble.dynamics.bodies import Box, Cylinder, Sphere
from ddetumble.dynamics.surfaces import make_debris
from ddetumble.inference.specification import Specification
from ddetumble.planning.scenario_file import FACES, Scenario, validate_scenario


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


@pytest.mark.parametrize(("text", "key"), [
    ('angular_velocity = "20 deg/s"', "debris.angular_velocity"), ("angular_velocity = 0.3", "debris.angular_velocity"),
    ("angular_velocity = [0.1, 0.2]", "debris.angular_velocity"),
    ("angular_velocity = [0.1, 0.2, 0.3, 0.4]", "debris.angular_velocity")])
def test_a_vector_of_another_length_is_told_by_its_key(tmp_path, text, key):
    """In words of a file, not in those of Python."""
    path = tmp_path / "scenario.toml"
    path.write_text(f'schema = "ddetumble.plan/1"\n[debris]\n{text}\n')
    done = CliRunner().invoke(app, ["plan", str(path), "-o", str(tmp_path / "plan")])
    assert isinstance(done.exception, dd.InputError) and done.exception.key == key
    assert "tuple" not in str(done.exception).lower()


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


def list_places(table: type[pydantic.BaseModel], place: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], str]]:
    """Every table and key that a file of this content may have, tables under a name of the user's own as `x`."""
    found = []
    for name, field in table.model_fields.items():
        found.append((place, field.alias or name))
        kinds = (field.annotation, *get_args(field.annotation))
        own = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel)), None)
        if own is not None:
            found += list_places(own, (*place, name, *(("x",) if field.annotation is not own and dict in
                                                       {get_origin(field.annotation)} else ())))
    return found


@pytest.mark.parametrize(("content", "read"), [(Scenario, dd.plan), (Specification, dd.fit)], ids=["scenario", "fit"])
def test_every_key_that_is_misspelt_is_told_the_right_one(tmp_path, content, read):
    """The last letter twice; a table that is misspelt, too."""
    path, places = tmp_path / "case.toml", list_places(content)
    assert len(places) > 10
    (schema,) = get_args(content.model_fields["schema_"].annotation)
    for place, key in places:
        if key == "schema":
            continue
        table = f"[{'.'.join(place)}]\n" if place else ""
        if place[:1] == ("priors",):  # by one of its keys it is known that this is one
            table += "sd = 1\n" if key == "mean" else "mean = 1\n"
        path.write_text(f'schema = "{schema}"\n{table}{key}{key[-1]} = 1\n')
        with pytest.raises(dd.InputError, match=f"did you mean {key}\\?") as found:
            read(path)
        assert found.value.key == ".".join((*place, key + key[-1])) and found.value.file == str(path)


@pytest.mark.parametrize(("name", "meant"), [("effective_mas", "effective_mass"), ("tau_a", "adhesion.tau_a")])
def test_a_misspelt_parameter_of_a_fit(tmp_path, name, meant):
    """An effect's parameter by its own name, too."""
    path = tmp_path / "fit.toml"
    path.write_text('schema = "ddetumble.fit/1"\ncampaign = "impact-b"\neffects = ["adhesion"]\n'
                    f"[fixed]\n{name} = 1.0\n")
    with pytest.raises(dd.InputError, match=f"did you mean {meant}\\?"):
        dd.fit(path)


def test_a_model_beside_the_working_folder_and_not_the_scenario(tmp_path, monkeypatch):
    (tmp_path / "fitted").mkdir()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "case.toml").write_text(SCENARIO + '[ball]\nmodel = "fitted"\n')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(dd.InputError, match="from the folder of the scenario on, sub"):
        dd.planning.read_scenario("sub/case.toml")


@pytest.mark.parametrize(("text", "key"), [
    ("mas = 5.0\n", "debris.mas"), ('[ball]\nmodel = "nowhere"\n', "ball.model"),
    ('[goal]\nfunction = "own.py:f"\n', "goal.function"), ('[uncertainty]\nfit = "nowhere"\n', "uncertainty.fit"),
    ("[arm]\nchaser = [0.0, 0.0, 0.0]\n", "arm.chaser"), ("[debris.", "not a TOML"),
    ('[limits]\nfaces = ["top"]\n', "limits.faces"),
])  # fmt: skip
def test_a_mistake_in_a_scenario_is_told_before_jax_is_imported(tmp_path, text, key):
    """Importing and compiling takes seconds; what the file itself shows needs neither."""
    path = tmp_path / "scenario.toml"
    path.write_text(SCENARIO + text)
    program = ("import sys; from ddetumble.cli import main; code = main(['plan', sys.argv[1]]); "
               "sys.exit(code if 'jax' not in sys.modules else 9)")
    done = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and key in done.stderr and list(tmp_path.iterdir()) == [path]


def test_faces_are_those_of_the_surfaces():
    bodies = {"cylinder": Cylinder(1.0, 1.0, 2.0), "box": Box(1.0, np.ones(3)), "sphere": Sphere(1.0, 1.0)}
    assert {name: make_debris(body).surface.face_names() for name, body in bodies.items()} == FACES


@pytest.mark.parametrize(("update", "key"), [
    ({"fit": "nowhere"}, "uncertainty.fit"), ({"draws": "many"}, "uncertainty.draws"),
    ({"tail": 2.0}, "uncertainty.tail")])  # fmt: skip
def test_a_scenario_in_hand_is_checked_as_its_file_is(update, key):
    """pydantic's `model_copy` takes whatever it is given; a folder as text is one folder, as in the file."""
    whole = dd.planning.read_scenario(dd.find_data() / "scenarios" / "uncertain-ball.toml")
    assert whole.uncertainty is not None
    other = whole.model_copy(update={"uncertainty": whole.uncertainty.model_copy(update=update)})
    with pytest.raises(dd.InputError) as caught:
        dd.plan(other)
    assert caught.value.key == key and ("nowhere" in str(caught.value)) == (key == "uncertainty.fit")


def test_scenarios_in_hand_are_those_of_their_files():
    for path in sorted((dd.find_data() / "scenarios").glob("*.toml")):
        scenario = dd.planning.read_scenario(path)
        assert validate_scenario(scenario) == scenario
