"""What a Jacobian determines, beside closed forms of two and three columns."""

import numpy as np
import pytest

from ddetumble.inference.identifiability import Blend, analyse_jacobian, list_words, measure_spread


FAR = np.array([1e3, 1e3])


def make_columns(cosine: float, norms=(1.0, 1.0)) -> np.ndarray:
    """Two columns with this cosine between them, shape (3, 2)."""
    return np.array([[1.0, cosine], [0.0, np.sqrt(1.0 - cosine**2)], [0.0, 0.0]]) * norms


def test_covariance_is_the_inverse_of_the_normal_equations():
    columns = np.random.default_rng(1).normal(size=(9, 3)) * [2.0, 0.1, 30.0]
    scales = np.array([0.5, 3.0, 1.0])
    found = analyse_jacobian("abc", columns, scales, np.full(3, 1e4))
    expected = np.linalg.inv(columns.T @ columns) * np.outer(scales, scales)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-9)
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.correlations, expected / np.outer(sd, sd), rtol=1e-9)
    assert found.blends == found.silent == found.undetermined == ()
    unit = columns / np.linalg.norm(columns, axis=0)
    np.testing.assert_allclose(found.singular, np.linalg.svd(unit)[1], rtol=1e-12)


@pytest.mark.parametrize("cosine", [0.94, 0.96, 0.999])
def test_two_columns_at_an_angle(cosine):
    """Singular values are sqrt(1 +- cosine), the correlation is -cosine; beyond 0.95 the pair is a combination."""
    norms, scales = np.array([4.0, 0.5]), np.array([2.0, 3.0])
    found = analyse_jacobian("ab", make_columns(cosine, norms), scales, FAR)
    np.testing.assert_allclose(found.singular, np.sqrt([1 + cosine, 1 - cosine]), rtol=1e-9)
    assert found.correlations[0, 1] == pytest.approx(-cosine)
    assert len(found.blends) == (cosine > 0.95) and found.undetermined == ()
    for blend in found.blends:
        sign = np.sign(blend.direction[0])
        np.testing.assert_allclose(sign * blend.direction, [0.5**0.5, -(0.5**0.5)], rtol=1e-9)
        np.testing.assert_allclose(sign * blend.step, np.array([1, -1]) * scales / norms / np.sqrt(2 - 2 * cosine),
                                   rtol=1e-6)
        assert set(blend.names) == {"a", "b"} and not blend.singular


def test_the_same_column_twice_is_singular():
    columns = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    found = analyse_jacobian("abc", columns, np.ones(3), np.full(3, 1e3))
    (blend,) = found.blends
    assert blend.singular and set(blend.names) == {"a", "b"} and set(found.undetermined) == {"a", "b"}
    assert found.silent == () and found.covariance[2, 2] == pytest.approx(1.0)
    assert np.isfinite(found.covariance).all() and found.covariance[0, 0] > 1e6


def test_members_stand_by_their_part():
    """A third column hardly takes part: it is not named, and the largest comes first."""
    base = np.random.default_rng(2).normal(size=(20, 2))
    sum_of_both = base @ [1.0, 0.4] + 1e-4 * np.random.default_rng(3).normal(size=20)
    columns = np.column_stack([base, sum_of_both, np.random.default_rng(4).normal(size=20)])
    (blend,) = analyse_jacobian("abcd", columns, np.ones(4), np.full(4, 1e6)).blends
    parts = dict(zip("abcd", np.abs(blend.direction), strict=True))
    assert set(blend.names) == {"a", "b", "c"}
    assert [parts[n] for n in blend.names] == sorted((parts[n] for n in blend.names), reverse=True)


def test_silent_and_undetermined():
    """A column that is zero is silent; one so weak that its deviation exceeds the bound is undetermined."""
    columns = np.diag([1.0, 0.0, 1.5e-3, 1.0 / 3.0])
    found = analyse_jacobian("abcd", columns, np.ones(4), np.array([10.0, 1e3, 1e3, 2.9]))
    assert found.silent == ("b", "d") and found.undetermined == ("b", "d") and found.blends == ()
    pair = np.concatenate([make_columns(0.9), np.zeros((1, 2))])
    sd = 1.0 / np.sqrt(1.0 - 0.81)
    for bound, lost in ((0.99 * sd, ("a",)), (1.01 * sd, ())):
        assert analyse_jacobian("ab", pair, np.ones(2), np.array([bound, 1e3])).undetermined == lost


def test_spread_along_a_combination():
    """1/s of the smallest singular value; as many rows again shorten it by sqrt 2, a row across it by what it adds."""
    columns = make_columns(0.99, (3.0, 0.2))
    (blend,) = analyse_jacobian("ab", columns, np.ones(2), FAR).blends
    now = measure_spread(columns, columns, blend)
    assert now == pytest.approx(1.0 / np.sqrt(0.01))
    assert measure_spread(np.concatenate([columns, columns]), columns, blend) == pytest.approx(now / np.sqrt(2.0))
    across = blend.direction[None] * [3.0, 0.2]
    assert measure_spread(np.concatenate([columns, across]), columns, blend) == pytest.approx(1 / np.sqrt(1.01))
    along = Blend(("a",), np.array([1.0, 0.0]), np.zeros(2), False)
    assert measure_spread(columns, columns, along) == pytest.approx(1.0 / np.sqrt(1.0 - 0.99**2))


def test_words():
    assert [list_words("abc"[:n]) for n in (1, 2, 3)] == ["a", "a and b", "a, b and c"]
