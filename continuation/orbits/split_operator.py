"""The harmonic-balance operator of many harmonics, solved through its low ones by Fourier transforms, no matrix made.

The receptance falls with the order, so that above some harmonic K the operator ``Y_k - T_k (slope Y + S Y)_k`` is its
diagonal plus something small. One sweep solves the low harmonics, with all borders, by a dense factorisation, and the
high ones by their diagonal; the residual of the whole operator, a product by Fourier transforms, says what is left. A
sweep takes off two digits or more, against the cube of the number of harmonics of a dense factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from continuation.errors import NoConvergence
from continuation.orbits.dense_factors import DenseFactors, lu_of
from continuation.orbits.spectrum import operator, product

LEAST = 100  # harmonics from which the dense operator costs more
_SMALL = 0.5  # bound of what couples the high harmonics to others; it is far from sharp
_LOWEST = 32
_SWEEPS = 40
_ROUNDING = 1e-13  # residual, relative to right-hand side and solution, that sweeps need not go below

Array = np.ndarray


class BalanceOperator:
    """``Y -> Y_k - T_k ((slope Y)_k + S_k Y_k)`` on packed harmonics, and its transpose.

    Parameters
    ----------
    transfer : complex array (K, k, m)
        Receptance at the harmonics 0..K-1, or 1/2, 3/2, .. when ``half``.
    slope : complex array (2L+1, m, k)
        Two-sided Fourier coefficients of the port slope, L at least the largest sum of orders.
    shift : complex array (K, m, k)
    half : bool
        Half-integer orders: the operator of multiplier -1.
    low : int
        Number of harmonics (K of them or fewer) that are solved for densely.
    """

    def __init__(self, transfer: Array, slope: Array, shift: Array, half: bool, low: int) -> None:
        self.transfer, self.slope, self.shift, self.half, self.low = transfer, slope, shift, half, low
        K, k, _ = transfer.shape
        self.size = (2 * K - (not half)) * k
        self.low_size = (2 * low - (not half)) * k
        first = np.arange((low - (not half)) * k)  # of the real parts, without those of the mean
        lead = 0 if half else k
        self.kept = np.concatenate([np.arange(lead), lead + first, (lead + self.size) // 2 + first])
        self._grid = 1 << (4 * K - 1).bit_length()
        L = len(slope) // 2
        reach = min(L, 2 * K)
        two_sided = np.zeros((self._grid, *slope.shape[1:]), dtype=complex)
        two_sided[: reach + 1], two_sided[-reach:] = slope[L : L + reach + 1], slope[L - reach : L]
        self._values = np.fft.ifft(two_sided, axis=0).real * self._grid  # (M, m, k)
        if half:
            self._turn = np.exp(0.5j * (2 * np.pi / self._grid) * np.arange(self._grid))[:, None, None]
        own = np.eye(k) - transfer[low:] @ (slope[L] + shift[low:])
        self._inverse = np.linalg.inv(own) if k > 1 else 1 / own
        self._back, self._shift_back = transfer.conj().transpose(0, 2, 1), shift.conj().transpose(0, 2, 1)

    # ---------------------------------------------------------------- products
    def unpack(self, x: Array) -> Array:
        """Return complex harmonics (K, k, c) of packed columns (N, c), without the factor sqrt 2 of the packing."""
        k, c = self.transfer.shape[1], x.shape[1]
        if self.half:
            half = len(x) // 2
            return (x[:half] + 1j * x[half:]).reshape(half // k, k, c)
        H = (len(x) // k - 1) // 2
        Y = np.empty((H + 1, k, c), dtype=complex)
        Y[0] = x[:k] * np.sqrt(2.0)
        Y[1:] = (x[k : k + H * k] + 1j * x[k + H * k :]).reshape(H, k, c)
        return Y

    def pack(self, Y: Array) -> Array:
        """Return packed columns of complex harmonics; the inverse of :meth:`unpack`."""
        K, k, c = Y.shape
        if self.half:
            flat = Y.reshape(K * k, c)
            return np.concatenate([flat.real, flat.imag])
        flat = Y[1:].reshape((K - 1) * k, c)
        return np.concatenate([Y[0].real / np.sqrt(2.0), flat.real, flat.imag])

    def _samples(self, Y: Array) -> Array:
        """Return the values (M, k, c) of waveforms on the grid, up to a factor that :meth:`_spectrum` takes off."""
        if self.half:
            return np.asarray((np.fft.ifft(Y, self._grid, axis=0) * self._turn).real)
        return np.fft.irfft(Y, self._grid, axis=0)

    def _spectrum(self, values: Array) -> Array:
        K = len(self.transfer)
        if self.half:
            return np.fft.fft(2 * values / self._turn, axis=0)[:K]
        return np.fft.rfft(values, axis=0)[:K]

    def applied(self, Y: Array, transposed: bool = False) -> Array:
        """Return the operator or its transpose applied to harmonics (K, k, c); cost two Fourier transforms."""
        if transposed:
            V = product(self._back, Y)
            load = self._spectrum(product(self._values.transpose(0, 2, 1), self._samples(V)))
            return np.asarray(Y - load - product(self._shift_back, V))
        load = self._spectrum(product(self._values, self._samples(Y)))
        return np.asarray(Y - product(self.transfer, load + product(self.shift, Y)))

    def high(self, Y: Array, transposed: bool) -> Array:
        """Return the harmonics from ``low`` on, solved by their diagonal, (K - low, k, c)."""
        inverse = self._inverse.conj().transpose(0, 2, 1) if transposed else self._inverse
        return product(inverse, Y[self.low :])

    def weighted(self, Y: Array) -> Array:
        """Return harmonics (K, k, c) as rows (c, K k) whose real product with others is that of packed vectors."""
        W = Y.conj()
        if not self.half:
            W[0] /= 2.0
        return W.reshape(Y.shape[0] * Y.shape[1], Y.shape[2]).T

    @cached_property
    def block(self) -> Array:
        """The dense operator on the low harmonics."""
        return operator(self.transfer[: self.low], self.slope, self.shift[: self.low], self.low, self.half)

    def dense(self) -> Array:
        """Return the whole operator as a matrix (N, N)."""
        return operator(self.transfer, self.slope, self.shift, len(self.transfer), self.half)


@dataclass(frozen=True, eq=False)
class SplitMatrix:
    """A balance operator with borders, ``[[A, columns], [rows, corner]]``; an array where one is asked for."""

    inner: BalanceOperator
    columns: Array
    rows: Array
    corner: Array
    ndim: int = field(default=2, init=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, the borders included."""
        n = self.inner.size + len(self.corner)
        return n, n

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        dense = np.block([[self.inner.dense(), self.columns], [self.rows, self.corner]])
        return dense if dtype is None else dense.astype(dtype)

    def __mul__(self, factor: float) -> Array:
        return np.asarray(self) * factor

    def bordered(self, columns: Array, rows: Array, corner: Array) -> SplitMatrix:
        """Return the matrix with further columns (n, b), rows (b, n) and a corner (b, b)."""
        n = self.inner.size
        return SplitMatrix(
            self.inner,
            np.hstack([self.columns, columns[:n]]),
            np.vstack([self.rows, rows[:, :n]]),
            np.block([[self.corner, columns[n:]], [rows[:, n:], corner]]),
        )

    def factors(self) -> SplitFactors | DenseFactors | None:
        """Return the factors, dense ones where the low harmonics alone are singular; None if the whole is."""
        kept = self.inner.kept
        block = np.block([[self.inner.block, self.columns[kept]], [self.rows[:, kept], self.corner]])
        low = lu_of(np.asfortranarray(block))
        return lu_of(np.asfortranarray(self)) if low is None else SplitFactors(self, low)

    def times(self, x: Array, transposed: bool = False) -> Array:
        """Return the product with columns (n, c)."""
        n, inner = self.inner.size, self.inner
        right, low = (self.rows.T, self.columns.T) if transposed else (self.columns, self.rows)
        corner = self.corner.T if transposed else self.corner
        inside = inner.pack(inner.applied(inner.unpack(x[:n]), transposed))
        return np.concatenate([inside + right @ x[n:], low @ x[:n] + corner @ x[n:]])


class SplitFactors:
    """Dense factors of the low harmonics and borders of a SplitMatrix, by which the whole is solved in sweeps."""

    def __init__(self, matrix: SplitMatrix, low: DenseFactors) -> None:
        self.matrix, self._low = matrix, low

    @property
    def sign(self) -> float:
        """Sign of the determinant of the low block: that of the whole, but within truncation of a zero."""
        return self._low.sign

    def solve(self, right: Array, transposed: bool = False, accuracy: float = 1e-13) -> Array:
        """Return the solution (n, c) for right-hand sides (n, c) or (n,), its residual below an accuracy.

        That is relative to the right-hand side, of the harmonics and of every border on its own; where it is 0, to the
        largest that the solution makes there. Should the sweeps not converge, the whole matrix is factorised.
        """
        if right.ndim == 1:
            return self.solve(right[:, None], transposed, accuracy)[:, 0]
        found = self._swept(right, transposed, accuracy)
        if found is None:
            dense = lu_of(np.asfortranarray(self.matrix))
            if dense is None:
                raise NoConvergence("the bordered balance is singular: give the orbit a load, a spring or damping")
            found = dense.solve(right, transposed)
        return found

    def _swept(self, right: Array, transposed: bool, accuracy: float) -> Array | None:
        matrix, inner = self.matrix, self.matrix.inner
        n, low, kept = inner.size, inner.low, inner.low_size
        sides = [inner.unpack(side) for side in (matrix.columns, matrix.rows.T)]
        column, row = sides[:: -1 if transposed else 1]
        weights, corner = inner.weighted(row), matrix.corner.T if transposed else matrix.corner
        left, rest = inner.unpack(right[:n]), right[n:].copy()  # what is left of the right-hand side
        Y, x = np.zeros_like(left), np.zeros_like(rest)
        given = _norm(left), np.abs(rest)
        steep = _norm(column), _norm(row)
        before = np.inf
        for _ in range(_SWEEPS):
            # harmonics and every border have units of their own, as a frequency of 1e6 has at waves of 1e-9
            most = _norm(Y), np.abs(x)
            own = most[0] + steep[0] @ most[1], np.multiply.outer(steep[1], most[0]) + np.abs(corner) @ most[1]
            size = _relative(left, rest, [np.where(g > 0, g, o) for g, o in zip(given, own, strict=True)])
            if size < accuracy:
                return np.concatenate([inner.pack(Y), x])
            if not size < before / 2:  # rounding, where the solution is large, or no convergence
                size = _relative(left, rest, [g + o for g, o in zip(given, own, strict=True)])
                return np.concatenate([inner.pack(Y), x]) if size < _ROUNDING else None
            before = size
            packed = np.concatenate([inner.pack(left[:low]), rest])
            found = self._low.solve(packed, transposed)
            step = np.zeros_like(left)
            step[:low] = inner.unpack(found[:kept])
            flat = step.reshape(-1, step.shape[2])
            left = left - inner.applied(step, transposed) - column @ found[kept:]
            rest -= (weights @ flat).real + corner @ found[kept:]
            high = np.zeros_like(left)
            high[low:] = inner.high(left, transposed)
            left -= inner.applied(high, transposed)
            rest -= (weights @ high.reshape(flat.shape)).real
            Y += step + high
            x += found[kept:]
        return None


def _norm(Y: Array) -> Array:
    """Return the norms (c,) of harmonics (K, k, c)."""
    return np.sqrt((Y.real**2 + Y.imag**2).sum(axis=(0, 1)))


def _relative(left: Array, rest: Array, scales: list[Array]) -> float:
    """Return the largest of residuals (K, k, c) and (b, c) relative to scales (c,) and (b, c); one of 0 has none."""
    pairs = zip((_norm(left), np.abs(rest)), scales, strict=True)
    found = [np.divide(v, s, out=np.zeros_like(v), where=s != 0).max(initial=0.0) for v, s in pairs]
    return float(np.max(found))


def split(transfer: Array, slope: Array, shift: Array, half: bool) -> SplitMatrix | None:
    """Return the operator for solution through its low harmonics, None where a dense one is no worse."""
    K = len(transfer)
    if K < LEAST:
        return None
    steepest = float(np.linalg.norm(slope, axis=(1, 2)).sum())  # bounds the slope
    k = transfer.shape[1]
    own = np.eye(k) - transfer @ (slope[len(slope) // 2] + shift)
    least = np.abs(own[:, 0, 0]) if k == 1 else np.linalg.svd(own, compute_uv=False)[:, -1]
    # below the bound the high harmonics alone have a positive determinant, so that the low ones tell its sign
    strong = np.flatnonzero(np.linalg.norm(transfer, axis=(1, 2)) * steepest > _SMALL * np.minimum(least, 1.0))
    low = max(_LOWEST, int(strong[-1]) + 1 if strong.size else 0)
    if low > K // 2:
        return None
    inner = BalanceOperator(transfer, slope, shift, half, low)
    none = np.zeros((inner.size, 0))
    return SplitMatrix(inner, none, none.T, np.zeros((0, 0)))
