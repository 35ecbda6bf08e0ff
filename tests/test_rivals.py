"""Which effects stay beside the best: by held-out conditions, and where fit and prediction contradict each other."""

import dataclasses as dc
from types import SimpleNamespace

import numpy as np
import pytest

from ddetumble.contact.law import Ball
from ddetumble.effects import IMPACT
from ddetumble.inference.parameters import ParameterSpace
from ddetumble.selection.forward_selection import CandidateFits, find_alternatives, is_outdone
from ddetumble.selection.problem import Fitted
from ddetumble.selection.settings import SelectionSettings


GROUPS = np.array([0, 0, 1, 1, 2, 2])
SPACE = ParameterSpace(Ball(), IMPACT)
PROBLEM = SimpleNamespace(groups=GROUPS, space=SPACE, settings=SelectionSettings(), disperse=lambda fitted: 1.0,
                          problem=SimpleNamespace(limits=SPACE.bounds(), scales=SPACE.scales()))
NAMES = ("sensor-gain.g", "sensor-lag.T", "adhesion.tau_a", "gas-leak.lambda", "membrane-area.alpha",
         "viscous-dashpot.c_v", "arm-servo.k_s")


def fitted(effect: str, chi2: float, heldout: float, parameters: int = 1, gain: float = 1.05) -> Fitted:
    """A fit with held-out losses that are alike in all conditions, and estimates known to a hundredth."""
    names, loss = NAMES[:parameters], np.full(6, heldout / 6)
    u = np.zeros(len(SPACE))
    u[SPACE.index["sensor-gain.g"]] = gain
    solution = SimpleNamespace(chi2=chi2, names=names, u=u, covariance=lambda: 1e-4 * np.eye(len(names)))
    return Fitted((effect,) if effect else (), solution, loss, loss)


@pytest.mark.parametrize(("chi2", "heldout", "parameters", "rival"), [
    (1000.0, 1105.0, 1, True),  # predicts alike
    (1000.0, 1160.0, 1, False),  # predicts worse, fits as well
    (960.0, 1160.0, 1, False),  # fits better by 40 noise variances only
    (780.0, 1160.0, 1, False),  # by 220 of the 1000 that the best removes
    (700.0, 1160.0, 1, True),  # by 300: the two judgements contradict each other
    (700.0, 1160.0, 7, False),  # of which six further parameters may have removed 54
])
def test_rivals_of_the_best(chi2, heldout, parameters, rival):
    best, other = fitted("best", 1000.0, 1100.0), fitted("other", chi2, heldout, parameters)
    before = fitted("", 2009.0, 2100.0, 0)
    tried = CandidateFits({}, {"best": best, "other": other}, before, ("best", "other"))
    found = find_alternatives(PROBLEM, tried, before)
    assert [name for name, _, _ in found] == (["other"] if rival else [])
    assert all(difference == pytest.approx(heldout - 1100.0) for _, difference, _ in found)


@pytest.mark.parametrize(("worse", "chi2", "rival"), [
    ((0.0, 200.0, 5.0), 1000.0, True),  # one condition alone, which the others may not foretell
    ((0.0, 200.0, 5.0), 1010.0, False),  # one that does not even fit as well is decided against
    ((60.0, 70.0, 75.0), 1000.0, False),  # all conditions agree
])
def test_what_one_condition_alone_speaks_against_is_no_better_than_a_rival(worse, chi2, rival):
    best, before = fitted("best", 1000.0, 1100.0), fitted("", 2009.0, 2100.0, 0)
    other = dc.replace(fitted("other", chi2, 1100.0), loss=best.loss + np.repeat(worse, 2) / 2)
    tried = CandidateFits({}, {"best": best, "other": other}, before, ("best", "other"))
    assert bool(find_alternatives(PROBLEM, tried, before)) == rival


@pytest.mark.parametrize(("gain", "rival"), [(1.05, True), (1.99, True), (2.01, True), (2.03, False), (0.4, False)])
def test_what_lies_wholly_beyond_physics_is_no_rival(gain, rival):
    """A calibration is off by 2 at most; an interval of 0.02 either way that reaches that far still counts."""
    fits = {"best": fitted("best", 1000.0, 1100.0), "other": fitted("other", 1000.0, 1105.0, 1, gain)}
    tried = CandidateFits({}, fits, fitted("", 2009.0, 2100.0, 0), ("best", "other"))
    assert bool(find_alternatives(PROBLEM, tried, tried.before)) == rival


@pytest.mark.parametrize(("gains", "parameters", "outdone"), [
    ((5.0, 5.0, 5.0), 1, True),  # 15, alike in all conditions
    ((3.0, 3.0, 2.9), 1, False),  # less than 9
    ((14.0, 2.0, -1.0), 1, False),  # 15, of which one condition gives nearly all: within chance
    ((5.0, 5.0, 5.0), 2, False),  # a further parameter counts 9
    ((60.0, 2.0, -5.0), 1, True),  # 57 decide whatever their scatter
])
def test_a_force_of_no_catalogue_outdoes_effects_beyond_chance_alone(gains, parameters, outdone):
    best = fitted("best", 1000.0, 1100.0)
    free = dc.replace(fitted("free", 1000.0, 1100.0, parameters), loss=best.loss - np.repeat(gains, 2) / 2)
    assert is_outdone(PROBLEM, best, free) == outdone and not is_outdone(PROBLEM, free, best)
