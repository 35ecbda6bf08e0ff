"""Which effects stay beside the best: by held-out conditions, and where fit and prediction contradict each other."""

from types import SimpleNamespace

import numpy as np
import pytest

from ddetumble.discrepancy.search import Tried, find_alternatives
from ddetumble.discrepancy.workbench import Fitted


GROUPS = np.array([0, 0, 1, 1, 2, 2])


def fitted(effect: str, chi2: float, heldout: float, parameters: int = 1) -> Fitted:
    """A fit with held-out losses that are alike in all conditions."""
    names = tuple(f"p{k}" for k in range(parameters))
    loss = np.full(6, heldout / 6)
    return Fitted((effect,) if effect else (), SimpleNamespace(chi2=chi2, names=names), loss, loss)


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
    tried = Tried({}, {"best": best, "other": other}, before, ("best", "other"))
    found = find_alternatives(SimpleNamespace(groups=GROUPS), tried, before)
    assert [name for name, _, _ in found] == (["other"] if rival else [])
    assert all(difference == pytest.approx(heldout - 1100.0) for _, difference, _ in found)
