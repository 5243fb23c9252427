"""Factors of a matrix with one border, dense or split into low and high harmonics; sparse: ``sparse_bordered``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.linalg as sl

from continuation.orbits.split_operator import SplitMatrix


class Factors(Protocol):
    """What a bordered matrix (N+1, N+1) was factorised to."""

    @property
    def sign(self) -> float:
        """Sign of its determinant; 0 for a complex one."""
        ...

    def solve(self, right: np.ndarray, transposed: bool = False, accuracy: float = 1e-13) -> np.ndarray:
        """Return the solution for right-hand sides (N+1, r), with the conjugate transpose where asked.

        Its residual, relative to them, is below ``accuracy`` or rounding.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DenseFactors:
    """LU factors with pivots of LAPACK."""

    lu: np.ndarray
    pivots: np.ndarray

    @property
    def sign(self) -> float:
        """Sign of the determinant; 0 for a complex matrix."""
        if np.iscomplexobj(self.lu):
            return 0.0
        swaps = int(np.count_nonzero(self.pivots != np.arange(len(self.pivots))))
        return float(np.prod(np.sign(np.diag(self.lu)))) * (-1.0) ** swaps

    def solve(self, right: np.ndarray, transposed: bool = False, accuracy: float = 0.0) -> np.ndarray:
        """Return the solution (N+1, r), to rounding."""
        if np.iscomplexobj(self.lu):
            return np.asarray(sl.lapack.zgetrs(self.lu, self.pivots, right, trans=2 * int(transposed))[0])
        return np.asarray(sl.lapack.dgetrs(self.lu, self.pivots, right, trans=int(transposed))[0])


def lu_of(matrix: np.ndarray) -> DenseFactors | None:
    """Return the factors of a dense matrix, which is overwritten where it is in Fortran's order; None if singular."""
    factorise = sl.lapack.zgetrf if np.iscomplexobj(matrix) else sl.lapack.dgetrf
    lu, pivots, info = factorise(matrix, overwrite_a=True)
    return DenseFactors(lu, pivots) if info == 0 else None


def bordered_factors(J: Any, column: np.ndarray, row: np.ndarray) -> Factors | None:
    """Return the factors of ``[[J, column], [row]]``, None where it is exactly singular.

    Parameters
    ----------
    J : array (N, N) or SplitMatrix
    column : array (N,)
    row : array (N+1,)
        The corner included.

    Examples
    --------
    >>> factors = bordered_factors(np.array([[0.0, 2.0], [1.0, 0.0]]), np.zeros(2), np.array([0.0, 0.0, 1.0]))
    >>> factors.solve(np.ones((3, 1))).ravel().tolist(), factors.sign
    ([1.0, 0.5, 1.0], -1.0)
    """
    n = len(column)
    if isinstance(J, SplitMatrix):
        split = J.bordered(column[:, None], row[None, :n], row[None, n:])
        factors = split.factors()  # None where the low harmonics alone are singular, which the whole need not be
        return lu_of(np.asfortranarray(split)) if factors is None else factors
    matrix = np.empty((n + 1, n + 1), dtype=np.result_type(J, column, row), order="F")
    matrix[:n, :n], matrix[:n, n], matrix[n] = J, column, row
    return lu_of(matrix)
