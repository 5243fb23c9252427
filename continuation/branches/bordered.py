"""Factors of a matrix with one border, dense or split into low and high harmonics; sparse: ``sparse_bordered``."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from continuation.orbits.dense_factors import lu_of
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
        return J.bordered(column[:, None], row[None, :n], row[None, n:]).factors()
    matrix = np.empty((n + 1, n + 1), dtype=np.result_type(J, column, row), order="F")
    matrix[:n, :n], matrix[:n, n], matrix[n] = J, column, row
    return lu_of(matrix)
