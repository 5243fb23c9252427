"""Real vectors of harmonic-balance unknowns and the Toeplitz-plus-Hankel operator on them.

The unknown u stacks the half spectrum Y (H+1, k) of the port arguments as [Y_0, sqrt2 Re Y_1.., sqrt2 Im Y_1..], so
that the Euclidean norm of u is the root mean square of the waveform and does not depend on the number of harmonics.
"""

from __future__ import annotations

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
    if len(u) == (2 * harmonics + 1) * k:
        return u
    Y = unpack(u, k)
    new = np.zeros((harmonics + 1, k), dtype=complex)
    keep = min(len(Y), harmonics + 1)
    new[:keep] = Y[:keep]
    return pack(new)


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply stacks of small matrices (K, k, m) and (K, m, c); elementwise where the first ones are numbers."""
    return a * b if a.shape[-2:] == (1, 1) else a @ b


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
    K, k, m = transfer.shape
    L = len(slope) // 2
    rows, width = (K, columns) if half else (K - 1, columns - 1)
    lead = 0 if half else k
    out = np.empty((lead + 2 * rows * k, lead + 2 * width * k))
    diagonal = np.arange(min(K, columns))
    own = (transfer * shift if k == m == 1 else transfer @ shift)[: len(diagonal)]
    for i, j in np.ndindex(k, k):
        P = Q = np.zeros((K, columns), dtype=complex)
        for port in range(m):
            toeplitz, hankel = _tables(slope[:, port, j], L, K, columns, half)
            gain = -transfer[:, i, port, None]
            P, Q = (gain * toeplitz, gain * hankel) if port == 0 else (P + gain * toeplitz, Q + gain * hankel)
        P[diagonal, diagonal] += float(i == j) - own[:, i, j]
        _place(out, P, Q, (i, j, k), half)
    return out


def _tables(slope: np.ndarray, L: int, K: int, columns: int, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return Toeplitz and Hankel tables of two-sided coefficients as views: orders k - l, and k + l (+ 1 if half)."""
    slope = np.ascontiguousarray(slope)
    stride, shape = slope.itemsize, (K, columns)
    toeplitz = np.ndarray(shape, slope.dtype, slope, L * stride, (stride, -stride))  # reaches back to L - columns + 1
    hankel = np.ndarray(shape, slope.dtype, slope, (L + int(half)) * stride, (stride, stride))
    return toeplitz, hankel


def _place(out: np.ndarray, P: np.ndarray, Q: np.ndarray, at: tuple[int, int, int], half: bool) -> None:
    """Write the real form of the block of components i, j into the operator; factors sqrt2 of the packing for means."""
    i, j, k = at
    if half:
        body, p, q = out, P, Q
    else:
        out[i, j] = P[0, 0].real
        width = (out.shape[1] - k) // 2
        top = _ROOT2 * P[0, 1:]  # row 0: Q is the conjugate of P there
        out[i, k + j : k + width : k], out[i, k + width + j :: k] = top.real, -top.imag
        rows = (out.shape[0] - k) // 2
        side = _ROOT2 * P[1:, 0]
        out[k + i : k + rows : k, j], out[k + rows + i :: k, j] = side.real, side.imag
        body, p, q = out[k:, k:], P[1:, 1:], Q[1:, 1:]
    rows, width = body.shape[0] // 2, body.shape[1] // 2
    plus, minus = p + q, p - q
    body[i:rows:k, j:width:k], body[i:rows:k, width + j :: k] = plus.real, -minus.imag
    body[rows + i :: k, j:width:k], body[rows + i :: k, width + j :: k] = plus.imag, minus.real
