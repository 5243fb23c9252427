"""LU factors of a dense matrix, real or complex, with the sign of its determinant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl


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
