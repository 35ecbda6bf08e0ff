"""Confidence in a verdict: its closed form, and that what is shipped is what the committed exams show."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate

from ddetumble.selection.confidence import PRIOR, find_confidence, list_allowances, read_track_record
from ddetumble.selection.discovery import Discovery
from docs.track_record import count_verdicts, predict_exams, read_exams


FITS = Path(__file__).parents[1] / "fits"
VERDICTS = ("nothing-missing", "explained", "improved", "unexplained")


def make_table(**counts):
    """Counts by family of one verdict that took everything as stated."""
    return [{"family": family, "verdict": "explained", "allowed": False, "right": right, "judged": judged}
            for family, (right, judged) in counts.items()]


def test_rate_is_drawn_to_that_of_the_other_families():
    """The posterior's mean by quadrature of likelihood times prior, and limits that hold 95 % of it."""
    found = find_confidence("slip", "explained", False, make_table(slip=(17, 20), impact=(90, 100)))
    assert found is not None and (found.right, found.judged) == (17, 20)
    rate = 90.5 / 101.0
    a, b = PRIOR * rate, PRIOR * (1.0 - rate)

    def density(p):
        return p ** (17 + a - 1.0) * (1.0 - p) ** (3 + b - 1.0)

    whole = integrate.quad(density, 0.0, 1.0)[0]
    assert found.probability == pytest.approx(integrate.quad(lambda p: p * density(p), 0.0, 1.0)[0] / whole, rel=1e-6)
    assert integrate.quad(density, found.low, found.high)[0] / whole == pytest.approx(0.95, abs=1e-6)


def test_nothing_is_said_where_nothing_is_known():
    """An open verdict, too few examined, another kind of test, or benches that were not examined."""
    table = make_table(slip=(9, 9), impact=(90, 100))
    assert find_confidence("slip", "explained", False, table) is None
    assert find_confidence("oblique", "explained", False, table) is None
    assert find_confidence("impact", "explained", True, table) is None
    assert find_confidence("impact", "undecided", False, table) is None
    assert find_confidence("impact", "explained", False, table) is not None


def test_rates_come_back():
    """Of 400 tables drawn at rates of their own, 95 % limits hold the rate as often or more, within four deviations."""
    generator, inside = np.random.default_rng(4), 0
    for _ in range(400):
        p = generator.beta(18.0, 2.0)
        found = find_confidence("slip", "explained", False, make_table(slip=(generator.binomial(40, p), 40),
                                                                      impact=(generator.binomial(60, p), 60)))
        assert found is not None
        inside += found.low <= p <= found.high
    assert inside > 380 - 4.0 * np.sqrt(400 * 0.95 * 0.05)


def test_what_is_shipped_is_what_the_committed_exams_show():
    exams = read_exams([FITS / "exam", *(path for path in [FITS / "exam-benches"] if path.exists())])
    counts = count_verdicts([row for rows in exams.values() for row in rows])
    assert counts == list(read_track_record())
    stated, right = predict_exams(exams)
    assert abs(stated.mean() - right.mean()) < 0.02 and len(stated) > 1000


def test_what_was_allowed_for():
    noise = {"normal_force": {"varies": False, "slow_sd": 0.0, "hum": []}, "pressure": {"hum": [{"frequency": 50.0}]}}
    assert list_allowances(noise, spread=(), irregular=False) == ("hum",)
    assert list_allowances({}, spread=("load",), irregular=True) == ("spread", "irregular")


@pytest.mark.parametrize(("family", "records", "samples", "stated"), [
    ("slip", 16, 1600, True), ("slip", 5, 500, False), ("slip", 16, 16, False), ("tumble", 4, 4000, True),
])
def test_no_probability_of_campaigns_that_the_exam_does_not_know(family, records, samples, stated):
    """The exam hides nothing in so few tests, but for long ones of tumbling bodies, and has no single values."""
    found = SimpleNamespace(family=family, verdict="nothing-missing", allowances=(),
                            counts={"records": records, "samples": samples})
    assert (Discovery.confidence.fget(found) is not None) is stated
