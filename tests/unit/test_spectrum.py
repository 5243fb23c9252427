"""Packed spectra and the operator on them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from continuation.orbits.spectrum import operator, pack, resize, unpack


def random_spectrum(rng, H, k):
    Y = rng.standard_normal((H + 1, k)) + 1j * rng.standard_normal((H + 1, k))
    Y[0] = Y[0].real
    return Y


@given(st.integers(1, 9), st.integers(1, 3), st.integers(0, 999))
def test_pack_and_unpack_are_inverse_and_keep_the_root_mean_square(H, k, seed):
    Y = random_spectrum(np.random.default_rng(seed), H, k)
    u = pack(Y)
    assert np.array_equal(u.shape, ((2 * H + 1) * k,))
    assert unpack(u, k) == pytest.approx(Y, abs=1e-15)
    wave = np.fft.irfft(Y, 64, axis=0, norm="forward")
    assert u @ u == pytest.approx((wave**2).sum(axis=1).mean(), rel=1e-12)


@given(st.integers(1, 9), st.integers(0, 9), st.integers(1, 3))
def test_longer_and_back_is_the_same(H, more, k):
    u = pack(random_spectrum(np.random.default_rng(H), H, k))
    longer = resize(u, k, H + more)
    assert np.linalg.norm(longer) == pytest.approx(np.linalg.norm(u))
    assert resize(longer, k, H) == pytest.approx(u, abs=0)


@pytest.mark.parametrize(("k", "m"), [(1, 1), (2, 3), (3, 2)])
def test_operator_is_convolution_then_receptance(k, m):
    """Against the product of waveforms in the time domain."""
    rng, H = np.random.default_rng(1), 4
    Y = random_spectrum(rng, H, k)
    slope = random_spectrum(rng, 2 * H, m * k)
    two_sided = np.concatenate([slope[:0:-1].conj(), slope]).reshape(-1, m, k)
    transfer = rng.standard_normal((H + 1, k, m)) + 1j * rng.standard_normal((H + 1, k, m))
    shift = rng.standard_normal((H + 1, m, k)) + 1j * rng.standard_normal((H + 1, m, k))
    transfer[0], shift[0] = transfer[0].real, shift[0].real
    y = np.fft.irfft(Y, 64, axis=0, norm="forward")
    s = np.fft.irfft(slope, 64, axis=0, norm="forward").reshape(64, m, k)
    W = np.fft.rfft((s @ y[..., None])[..., 0], axis=0)[: H + 1] / 64
    expected = Y - (transfer @ (W + (shift @ Y[..., None])[..., 0])[..., None])[..., 0]
    matrix = operator(transfer, two_sided, shift, H + 1)
    assert matrix.shape == ((2 * H + 1) * k, (2 * H + 1) * k)
    assert matrix @ pack(Y) == pytest.approx(pack(expected), abs=1e-12)


def test_operator_on_half_integer_harmonics():
    """Twice the period: a waveform of odd harmonics only, times a slope of the single period."""
    rng, K = np.random.default_rng(2), 4
    half = rng.standard_normal(K) + 1j * rng.standard_normal(K)
    slope = random_spectrum(rng, 2 * K, 1)
    transfer = (rng.standard_normal(K) + 1j * rng.standard_normal(K))[:, None, None]
    Y, S = np.zeros(2 * K + 1, dtype=complex), np.zeros(4 * K + 1, dtype=complex)
    Y[1::2], S[::2] = half, slope[:, 0]
    y, s = (np.fft.irfft(c, 256, norm="forward") for c in (Y, S))
    W = (np.fft.rfft(s * y) / 256)[1 : 2 * K + 1 : 2]
    expected = half - transfer[:, 0, 0] * W
    two_sided = np.concatenate([slope[:0:-1].conj(), slope])[..., None]
    matrix = operator(transfer, two_sided, np.zeros((K, 1, 1)), K, half=True)
    assert matrix @ np.r_[half.real, half.imag] == pytest.approx(np.r_[expected.real, expected.imag], abs=1e-12)
