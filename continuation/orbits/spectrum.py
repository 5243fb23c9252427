"""Real vectors of harmonic-balance unknowns and the Toeplitz-plus-Hankel operator on them.

The unknown u stacks the half spectrum Y (H+1, k) of the port arguments as [Y_0, sqrt2 Re Y_1.., sqrt2 Im Y_1..], so
that the Euclidean norm of u is the root mean square of the waveform and does not depend on the number of harmonics.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

_ROOT2 = np.sqrt(2.0)


def pack(Y: np.ndarray) -> np.ndarray:
    """Stack a half spectrum (H+1, k) into a real vector ((2H+1) k,)."""
    return np.concatenate([Y[0].real, _ROOT2 * Y[1:].real.ravel(), _ROOT2 * Y[1:].imag.ravel()])


def unpack(u: np.ndarray, k: int) -> np.ndarray:
    """Return the half spectrum (H+1, k) of a real vector."""
    H = (len(u) // k - 1) // 2
    Y = np.empty((H + 1, k), dtype=complex)
    Y[0] = u[:k]
    Y[1:] = (u[k : k + H * k] + 1j * u[k + H * k :]).reshape(H, k) / _ROOT2
    return Y


def resize(u: np.ndarray, k: int, harmonics: int) -> np.ndarray:
    """Pad with zeros or truncate to another number of harmonics."""
    Y = unpack(u, k)
    if len(Y) == harmonics + 1:
        return u
    new = np.zeros((harmonics + 1, k), dtype=complex)
    keep = min(len(Y), harmonics + 1)
    new[:keep] = Y[:keep]
    return pack(new)


@lru_cache(maxsize=64)
def _indices(rows: int, columns: int, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Orders k - l and k + l for k in rows, l in columns; integer orders from 0, or half-integer ones from 1/2."""
    k, l = np.arange(rows)[:, None], np.arange(columns)[None, :]  # noqa: E741
    return k - l, k + l + int(half)


def operator(
    transfer: np.ndarray, slope: np.ndarray, shift: np.ndarray, columns: int, half: bool = False
) -> np.ndarray:
    """Return the real matrix of ``Y -> Y_k - transfer_k (sum_l slope_(k-l) Y_l + shift_k Y_k)``.

    Parameters
    ----------
    transfer : complex array (K, k, m)
        Receptance at the row harmonics 0..K-1 (or 1/2, 3/2, .. when ``half``).
    slope : complex array (2L+1, m, k)
        Two-sided Fourier coefficients of the port slope, orders -L..L, L >= the largest sum of orders.
    shift : complex array (K, m, k)
    columns : int
        Number of column harmonics (from the same first order).
    half : bool
        Half-integer orders: the operator of multiplier -1.

    Returns
    -------
    array ((2K-1) k, (2 columns-1) k), or (2K k, 2 columns k) when ``half``
    """
    K, k, _ = transfer.shape
    L = len(slope) // 2
    if k == slope.shape[1] == 1:
        return _scalar_operator(transfer[:, 0, 0], slope[:, 0, 0], shift[:, 0, 0], columns, half)
    minus, plus = _indices(K, columns, half)
    P, Q = _times(transfer, slope[L + minus]), _times(transfer, slope[L + plus])
    diagonal = np.arange(min(K, columns))
    P[diagonal, diagonal] += _times(transfer[:, None], shift[:, None])[diagonal, 0]
    P, Q = -P, -Q
    P[diagonal, diagonal] += np.eye(k)
    P, Q = P.transpose(0, 2, 1, 3), Q.transpose(0, 2, 1, 3)
    if half:
        return _real_blocks(P, Q, k)
    return _bordered_blocks(P, Q, k)


def _scalar_operator(
    transfer: np.ndarray, slope: np.ndarray, shift: np.ndarray, columns: int, half: bool
) -> np.ndarray:
    """The same for one port, with the Toeplitz and Hankel tables as views of the coefficients."""
    K, L = len(transfer), len(slope) // 2
    stride = slope.strides[0]
    view = np.lib.stride_tricks.as_strided
    toeplitz = view(slope[L:], (K, columns), (stride, -stride), writeable=False)  # reaches back to L - columns + 1
    hankel = view(slope[L + int(half) :], (K, columns), (stride, stride), writeable=False)
    column = -transfer[:, None]
    P, Q = column * toeplitz, column * hankel
    diagonal = np.arange(min(K, columns))
    P[diagonal, diagonal] += 1.0 - (transfer * shift)[: len(diagonal)]
    P, Q = P[:, None, :, None], Q[:, None, :, None]
    return _real_blocks(P, Q, 1) if half else _bordered_blocks(P, Q, 1)


def _times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if a.ndim == 3:
        a = a[:, None]
    return a * b if a.shape[-2:] == (1, 1) and b.shape[-2:] == (1, 1) else a @ b


def _real_blocks(P: np.ndarray, Q: np.ndarray, k: int) -> np.ndarray:
    rows, columns = P.shape[0] * k, P.shape[2] * k
    plus, minus = (P + Q).reshape(rows, columns), (P - Q).reshape(rows, columns)
    out = np.empty((2 * rows, 2 * columns))
    out[:rows, :columns], out[:rows, columns:] = plus.real, -minus.imag
    out[rows:, :columns], out[rows:, columns:] = plus.imag, minus.real
    return out


def _bordered_blocks(P: np.ndarray, Q: np.ndarray, k: int) -> np.ndarray:
    """Real form with the mean: row 0 and column 0 carry the factors sqrt2 of the packing."""
    inner = _real_blocks(P[1:, :, 1:], Q[1:, :, 1:], k)
    out = np.empty((inner.shape[0] + k, inner.shape[1] + k))
    out[k:, k:] = inner
    out[:k, :k] = P[0, :, 0].real
    top = P[0, :, 1:].reshape(k, -1)  # row 0: Q is the conjugate of P there
    half = top.shape[1]
    out[:k, k : k + half], out[:k, k + half :] = _ROOT2 * top.real, -_ROOT2 * top.imag
    side = P[1:, :, 0].reshape(-1, k)
    rows = side.shape[0]
    out[k : k + rows, :k], out[k + rows :, :k] = _ROOT2 * side.real, _ROOT2 * side.imag
    return out
