"""Eigenvalues of products of matrices, against products made of known ones."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from continuation.orbits.products import product_eigenvalues

DECADE = np.log(10)


def product_of(rng, count, logarithms, angles):
    """Factors whose product has the given eigenvalues: A_k = X_(k+1) D X_k^-1 with X_0 = X_count, well conditioned."""
    n = len(logarithms)
    bases = [np.linalg.qr(rng.standard_normal((n, n)))[0] + 0.1 * rng.standard_normal((n, n)) / n for _ in range(count)]
    D, j = np.zeros((n, n)), 0
    while j < n:
        size, turn = np.exp(logarithms[j] / count), angles[j] / count
        if j + 1 < n and angles[j + 1] == -angles[j] != 0:
            D[j : j + 2, j : j + 2] = size * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            j += 2
        else:
            D[j, j] = size
            j += 1
    factors = [bases[(k + 1) % count] @ D @ np.linalg.inv(bases[k]) for k in range(count)]
    flips = np.where(np.abs(angles) == np.pi, -1.0, 1.0)
    factors[0] = bases[1 % count] @ (D * flips[:, None]) @ np.linalg.inv(bases[0])
    return np.array(factors)


def spread(rng, n, low, high, pairs):
    """Logarithms and angles of n eigenvalues over decades low..high, largest first, some of them complex pairs."""
    logarithms, angles = np.sort(rng.uniform(low, high, n))[::-1] * DECADE, np.zeros(n)
    for j in range(0, 2 * pairs, 2):
        logarithms[j + 1] = logarithms[j]
        angles[j], angles[j + 1] = (turn := rng.uniform(0.1, 3.0)), -turn
    angles[2 * pairs :] = rng.choice([0.0, np.pi], n - 2 * pairs)
    return logarithms, angles


def apart(found, wanted):
    """Relative distance of the found eigenvalues from the wanted ones, and of the stated errors."""
    logarithms, angles, errors = found
    order = np.lexsort((-wanted[1], -wanted[0].round(9)))
    ratio = np.exp(logarithms - wanted[0][order] + 1j * (angles - wanted[1][order]))
    return np.abs(ratio - 1), errors


@pytest.mark.parametrize(
    ("count", "n", "low", "high", "pairs"),
    [(20, 6, -30, 5, 2), (40, 14, -30, 5, 5), (60, 14, -200, 5, 7), (30, 14, -2, 1, 7), (100, 8, -600, 0, 0)],
)
def test_known_eigenvalues_over_many_decades(count, n, low, high, pairs):
    rng = np.random.default_rng(n + count)
    for _ in range(3):
        wanted = spread(rng, n, low, high, pairs)
        off, errors = apart(product_eigenvalues(product_of(rng, count, *wanted)), wanted)
        assert off.max() < 1e-10
        assert np.all(off <= errors)
        assert errors.max() < 1e-6


def test_the_product_itself_loses_them():
    """What the module is for: the dense eigenvalues of the same product are noise below rounding of the largest."""
    rng = np.random.default_rng(1)
    wanted = spread(rng, 6, -30, 5, 2)
    factors = product_of(rng, 20, *wanted)
    dense = np.sort(np.abs(np.linalg.eigvals(np.linalg.multi_dot(factors[::-1]))))
    assert abs(np.log(dense[0]) - wanted[0].min()) > DECADE


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 8))
@settings(max_examples=40)
def test_of_any_matrices_the_determinant_and_the_stated_errors_hold(seed, n, count):
    factors = np.random.default_rng(seed).standard_normal((count, n, n))
    logarithms, angles, errors = product_eigenvalues(factors)
    sign, log = (v.prod() if i == 0 else v.sum() for i, v in enumerate(np.linalg.slogdet(factors)))
    assert abs(logarithms.sum() - log) <= errors.sum() + 1e-12
    assert np.cos(angles.sum()) == pytest.approx(sign, abs=1e-6 + errors.sum())
    dense = np.linalg.eigvals(np.linalg.multi_dot(factors[::-1]) if count > 1 else factors[0])
    values = np.exp(logarithms + 1j * angles)
    reach = errors * np.abs(values) + 1e-9 * np.abs(dense).max()
    assert np.all(np.abs(values[:, None] - dense[None, :]).min(axis=1) <= reach + 1e-7 * np.abs(values))


def test_edge_cases():
    logarithms, angles, errors = product_eigenvalues(np.zeros((3, 2, 2)))
    assert np.all(logarithms == -np.inf)
    assert not angles.any()
    assert not errors.any()
    assert product_eigenvalues(np.zeros((0, 2, 2)))[0].tolist() == [0.0, 0.0]
    one = product_eigenvalues(np.full((400, 1, 1), -1e-3))
    assert one[0][0] == pytest.approx(-1200 * DECADE)
    with pytest.raises(ValueError, match="expected finite matrices"):
        product_eigenvalues(np.full((2, 2, 2), np.nan))
    with pytest.raises(ValueError, match=r"got shape \(2, 2\)"):
        product_eigenvalues(np.eye(2))
