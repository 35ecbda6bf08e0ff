"""How much of a misfit is left beyond chance: what makes differences between models count less."""

import dataclasses as dc

import pytest
from helpers_statistics import PRESSURES, SPEEDS, fit_toy, make_selection, white


CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2


def disperse(seed, **options):
    selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, **options))
    return selection.disperse(fitted)


def test_a_complete_model_leaves_no_dispersion():
    """Two standard errors above one happen in one campaign of forty: of 40 at most 5 say so."""
    assert sum(disperse(seed) > 1.0 for seed in range(40)) <= 5


@pytest.mark.parametrize("noise", [1.5, 2.0, 3.0])
def test_noise_above_what_is_stated_disperses_by_its_square(noise):
    """The noise's variance over the stated one, within 20 %, settings being as stated."""
    found = [disperse(seed, noise=noise) for seed in range(4)]
    assert sum(found) / 4 == pytest.approx(noise**2, rel=0.2)


def test_what_is_missing_disperses():
    assert disperse(1, truth={"ripple.a": 0.1}) > 3.0


def test_no_dispersion_is_told_where_it_cannot_be():
    """Of fits to thinned records, without splines, and where the level of the noise is hardly known."""
    selection, fitted = fit_toy(make_selection(1, conditions=CONDITIONS, noise=2.0))
    assert selection.disperse(fitted) > 2.0
    assert selection.disperse(dc.replace(fitted, thinned=True)) == 1.0
    assert dc.replace(selection, bases=()).disperse(fitted) == 1.0
    vague = dc.replace(selection, noise={"normal_force": white(0.05, 1.0)})
    assert vague.disperse(fitted) == 1.0
