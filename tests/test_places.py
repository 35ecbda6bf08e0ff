"""Where a misfit sits: one measure of it for all places, and every place once."""

import pytest

import ddetumble as dd
from ddetumble.measurement.quantities import format_estimate


@pytest.mark.study
@pytest.mark.parametrize("name", ["impact-f", "tumble-d"])
def test_places_share_one_measure(name):
    """What lies in a range lies in any wider one, too; a force that removes the misfit is said apart from that."""
    where = dd.discover(dd.find_data() / name).where
    for wide in where:
        for other in where:
            same = (wide.channel, wide.variable) == (other.channel, other.variable)
            inside = wide.range[0] <= other.range[0] and other.range[1] <= 1.001 * wide.range[1]
            if same and inside and wide.phase in ("both", other.phase):
                assert wide.share > other.share - 0.02
    assert 0.0 < where[0].share <= 1.0 and where[0].removes is not None and 0.5 < where[0].removes <= 1.0


@pytest.mark.parametrize(("estimate", "sd", "digits"), [
    (168690.3, 12155.2, ("169000", "12000")), (1175.31, 10.2, ("1175", "10")), (2.0, 20.0, ("2", "20")),
    (-361.24, 3.01, ("-361.2", "3.0")), (1.61e-5, 2e-7, ("1.610e-05", "2.0e-07")),
])  # fmt: skip
def test_values_have_the_digits_that_are_known(estimate, sd, digits):
    words = format_estimate(estimate, sd, "N").split()
    assert (words[0], words[2]) == digits


def test_a_value_without_uncertainty_claims_none():
    assert "±" not in format_estimate(1.0, float("inf"), "N")
