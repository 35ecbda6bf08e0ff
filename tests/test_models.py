"""The command `models`: every reference model by family, one in full, and the same names in every help."""

import subprocess
import sys

import pytest

from ddetumble.cli import main
from ddetumble.contact.effect import parameters_of
from ddetumble.families import FAMILIES


def test_all_models_are_listed(capsys):
    assert main(["models"]) == 0
    shown = capsys.readouterr().out
    for family, models in ((name, one.models) for name, one in FAMILIES.items()):
        assert f"{family} records:" in shown
        assert all(f"  {name} " in shown and model.text in shown for name, model in models.items())


@pytest.mark.parametrize(("family", "name"), [(one.name, name) for one in FAMILIES.values() for name in one.models])
def test_one_model_in_full(family, name, capsys):
    """Law, parameters with unit and limits, and source."""
    assert main(["models", name, "--family", family]) == 0
    shown, model = capsys.readouterr().out, FAMILIES[family].models[name]
    assert model.law in shown and model.source in shown and shown.count("\nlaw") <= 1
    for one in parameters_of(model.make()):
        assert f"parameter  {one.name}" in shown and one.limits_reason in shown
        assert not one.unit or f"[{one.unit}]" in shown
    assert ("from 0 to 30 (SI)" in shown) == (family == "slip" and name.startswith(("paper", "eq10")))


def test_unknown_names_are_refused(capsys):
    for words in (["models", "moon"], ["models", "--family", "moon"], ["models", "coulomb", "--family", "impact"]):
        assert main(words) == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("command", ["fit", "discover", "compare", "missing", "sample", "identify", "map", "average"])
def test_help_names_all_models(command, capsys):
    """`--model` is explained by the registry; words may be broken over lines."""
    assert main([command, "--help"]) == 0
    shown = "".join(capsys.readouterr().out.split())
    if "--model" in shown:
        assert all(name in shown for one in FAMILIES.values() for name in one.models)


def test_the_list_needs_no_model():
    """Names are known without the modules that compute."""
    code = "import sys; from ddetumble.reference_models import list_names; list_names(); print('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
