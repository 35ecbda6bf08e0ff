"""Intervals that allow for how well the noise is known: closed forms, and coverage where its level was measured."""

import dataclasses as dc

import numpy as np
import pytest
from scipy import stats

import ddetumble as dd
from ddetumble.exam import Exam
from ddetumble.exam.cases import sample_case, write_case
from ddetumble.inference.interval_width import share_variance, widen_by_doubt, widen_by_level
from ddetumble.inference.noise import Noise


def make_noise(doubt):
    return Noise(1.0, 0.0, 0.0, 1e-3, 1.0, doubt, "white")


@pytest.mark.parametrize("degrees", [4, 10, 40, 400])
def test_a_measured_power_widens_intervals_as_students_t_does(degrees):
    """The logarithm of a power measured with so many degrees of freedom has the variance of that of chi-square."""
    variance = float(np.var(np.log(stats.chi2.ppf((np.arange(100_000) + 0.5) / 100_000, degrees))))
    assert widen_by_doubt(variance) == pytest.approx(stats.t.ppf(0.975, degrees) / 1.959964, rel=0.02)
    assert widen_by_doubt(0.0) == 1.0


@pytest.mark.parametrize("doubt", [0.2, 0.5, 0.7])
def test_means_under_noise_of_a_doubtful_level_are_held_at_the_nominal_rate(doubt):
    """Levels drawn about the true one: without the factor fewer intervals hold the truth."""
    generator = np.random.default_rng(5)
    degrees = (1.0 + np.sqrt(1.0 + 2.0 * doubt**2)) / doubt**2
    taken = np.sqrt(generator.chisquare(degrees, 20_000) / degrees)
    far = np.abs(generator.standard_normal(20_000)) / taken / 1.959964
    assert np.mean(far < widen_by_doubt(doubt**2)) == pytest.approx(0.95, abs=0.01)
    assert np.mean(far < 1.0) < 0.95


@pytest.fixture(scope="module")
def oblique(tmp_path_factory):
    """A fit to two channels, of one of which the noise is known well."""
    exam = Exam("oblique", 5, ("nothing",), bench="stated", fault="none", noise="white")
    place = tmp_path_factory.mktemp("oblique") / "case"
    write_case(exam, sample_case(exam, 0), place)
    return dd.fit(place)


def test_shares_of_channels_and_priors_make_the_whole_variance(oblique):
    """Between nothing and everything; what the channels leave over, priors of the settings make."""
    share = share_variance(oblique.solution, 2)
    assert share.min() > -1e-9 and share.sum(axis=0).max() < 1.0 + 1e-9
    own = dc.replace(oblique.solution, own=1e-9 * oblique.solution.own)  # settings that change nothing
    assert share_variance(own, 2).sum(axis=0) == pytest.approx(1.0, abs=1e-6)


def test_doubt_counts_in_the_channel_that_tells_of_a_parameter(oblique):
    """The tangential gauge tells of the tangential mass, and hardly of the restitution."""
    found = widen_by_level(oblique.problem, oblique.solution,
                           {"normal_force": make_noise(0.0), "tangential_force": make_noise(0.6)})
    assert found["tangential_mass"] - 1.0 > 5.0 * (found["restitution"] - 1.0)
    assert 1.05 < found["tangential_mass"] < widen_by_doubt(0.6**2)
    assert set(widen_by_level(oblique.problem, oblique.solution, dict.fromkeys(oblique.noise, make_noise(0.0))
                              ).values()) == {1.0}
