"""What a paper says of a result: its facts, and an entry for every reference that it names."""

import re
from importlib import resources

import numpy as np
import pytest

import ddetumble as dd
from ddetumble.cli import main
from ddetumble.planning.plan import PlanSettings


def list_keys(text):
    return re.findall(r"^@\w+\{(\w+),", text, re.MULTILINE)


def check(found):
    """Every key that the paragraph names has one entry, and no entry is there for nothing."""
    named = set(re.findall(r"\[(\w+)\]", found.methods))
    assert named and sorted(list_keys(found.bibtex)) == sorted(named)


def test_the_bibliography_is_whole():
    text = (resources.files("ddetumble.reports") / "references.bib").read_text(encoding="utf-8")
    keys = list_keys(text)
    assert len(keys) == len(set(keys)) == text.count("@")
    for entry in re.split(r"\n(?=@)", text):
        assert entry.count("{") == entry.count("}")
        assert {"title", "author", "year"} <= set(re.findall(r"^  (\w+) = ", entry, re.MULTILINE))


@pytest.mark.slow
def test_a_fit_and_its_posterior():
    fit = dd.fit(dd.find_data() / "slip-c", effects=["adhesive-offset"])
    found = dd.citation(fit)
    check(found)
    for fact in ("slip-c", "adhesive-offset", *fit.parameters):
        assert fact in found.methods
    assert "tsitouras2011" not in found.methods  # a friction force is no motion
    sampled = dd.citation(dd.sample(fit, walkers=16, ensembles=2, burn=10, block=10, most=20))
    check(sampled)
    assert sampled.methods.startswith(found.methods) and "emcee2013" in list_keys(sampled.bibtex)


def test_a_saved_fit_by_command(capsys):
    folder = dd.find_data().parent / "fits" / "impact-b"
    assert main(["cite", str(folder)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "impact-b" in told and "hunt1975" in told and "tsitouras2011" in told
    assert main(["cite", str(folder.parent)]) == 2


@pytest.mark.slow
def test_a_plan():
    from test_plan_choices import pose

    plan = dd.plan(pose([0.05, 0.02, 0.03], 0.2), settings=PlanSettings(starts=1))
    found = dd.citation(plan)
    check(found)
    assert "rockafellar2000" not in found.bibtex and np.isfinite(plan.sequence.left)
