"""What the digits of a gauge do to the mean of its readings, beside draws; and a gauge that shows nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ddetumble.exam.cases import Exam
from ddetumble.exam.examination import run_case
from ddetumble.exam.scoring import is_alarm
from ddetumble.measurement.digits import bound_rounding, find_digit


@given(digit=st.floats(1e-6, 1e3), origin=st.floats(-100.0, 100.0), span=st.floats(2.0, 500.0),
       seed=st.integers(0, 2**32 - 1))
def test_digits_are_found(digit, origin, span, seed):
    """Multiples of a digit, from any origin and written with three more figures, give it back."""
    counts = np.round(span * np.random.default_rng(seed).uniform(-1.0, 1.0, 400))
    counts[:2] = 0.0, 1.0
    found = find_digit(np.round(digit * (origin + counts) / digit, 12) * digit)
    assert found == pytest.approx(digit, rel=1e-6)
    written = digit * np.round((origin + counts) * 1e3) / 1e3
    assert find_digit(written) == pytest.approx(digit, rel=1e-3)


def test_readings_without_digits():
    """Noise lies on no multiples; readings that never change, or are few, tell nothing."""
    noise = np.random.default_rng(1).standard_normal(500)
    assert find_digit(noise) == 0.0
    assert np.isnan(find_digit(np.full(500, 0.3))) and np.isnan(find_digit(np.arange(5.0)))


@pytest.mark.parametrize("share", [0.15, 0.25, 0.35, 0.5])
def test_the_bound_is_the_largest_error_of_the_mean(share):
    """Over all places between two digits, of noise of so many digits."""
    noise = share * np.random.default_rng(2).standard_normal(200_000)
    noise -= noise.mean()
    errors, deviations = [], []
    for place in np.linspace(0.0, 1.0, 21):
        readings = np.round(place + noise)
        errors.append(abs(readings.mean() - place))
        deviations.append(readings.std())
    bound = bound_rounding(1.0, float(np.sqrt(share**2 + 1.0 / 12.0)))
    assert max(errors) == pytest.approx(bound, rel=0.2, abs=2e-3)
    assert bound_rounding(0.0, 1.0) == 0.0 and bound_rounding(1.0, 0.0) <= 0.5 and bound_rounding(1.0, 5.0) < 1e-30


@pytest.mark.slow
def test_a_coarse_gyroscope_has_no_bias():
    """Nothing is hidden, and one axis of the gyroscope reads two or three different values: no bias is named."""
    row = run_case(Exam("tumble", 95, ("nothing",), bench="drawn"), 5)
    assert row["bench"] == ("coarse",) and not is_alarm(row)
