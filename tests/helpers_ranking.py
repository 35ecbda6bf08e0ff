"""What holds of the ranking of every discovery, whatever was hidden."""

import pytest

from ddetumble.selection.result import LackOfFit


def check_ranking(found):
    """One number a thing: of the table and of the steps, of an effect that does nothing and of the reference model."""
    held_out = [step.heldout_nrmse for step in found.steps]
    assert held_out == sorted(held_out, reverse=True)  # no step raises it
    for step in found.steps:
        fit: LackOfFit = step.lack_of_fit
        assert fit.rejected == (fit.p_value < fit.level)
        smallest = min(fit.smooth_p_value, fit.score_p_value, fit.settings_p_value)
        assert fit.p_value == pytest.approx(min(1.0, 3.0 * smallest))
    first, alone = found.steps[0], {c.effect: c for c in found.candidates}
    for step in found.steps:
        if len(step.effects) == 1:
            told = alone[step.effects[0]]
            assert told.heldout_nrmse == pytest.approx(step.heldout_nrmse, rel=1e-6)
            assert told.p_value < 1e-6
            values = {name: e.estimate for name, e in step.parameters.items() if name.startswith(step.effects[0])}
            assert {name: e.estimate for name, e in told.estimates.items()} == pytest.approx(values)
    for one in found.candidates:
        assert 0.0 <= one.explains <= 1.0
        if one.explains == 0.0 and not one.estimates:
            assert one.heldout_nrmse == pytest.approx(first.heldout_nrmse, rel=1e-6)
    if len(found.effects) == 1 and found.verdict == "explained":
        assert alone[found.effects[0]].explains > 0.9
