"""Numbers of the linear part of a System, dense for few states and sparse for many, and the algebra its ports need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from continuation.errors import UnsupportedModel

RANK = 1e-10  # relative singular value below which a direction does not count
DENSE_STATES = 400  # number of states up to which matrices are dense and receptances modal
_UNITS = 1e16  # ratio of balancing factors up to which they count as units: nanometres and megahertz are 1e15 apart
_POWER = 32  # of the matrix whose norm tells the spectral radius
_FILLED = 0.1  # share of nonzeros above which a large matrix is treated as a dense one, too

Matrix = Any  # numpy array, or scipy.sparse.csc_array above DENSE_STATES


@dataclass(frozen=True, slots=True)
class LinearPart:
    """Numbers of the linear part at one parameter vector: A (n, n), B (n, m), C (k, n), d (contacts, k), S (m, k).

    A is a dense array up to ``DENSE_STATES`` states and a ``csc_array`` above, unless it is filled. S is a reference
    stiffness of the ports (contacts closed): ``A - B S C`` is what receptances are taken of, so that an open gap or a
    rigid body does not make them singular; the ports carry ``w + S y``, which changes nothing.
    """

    A: Matrix
    B: np.ndarray
    C: np.ndarray
    d: np.ndarray
    S: np.ndarray

    @property
    def sparse(self) -> bool:
        """Whether A is a sparse matrix."""
        return bool(sp.issparse(self.A))

    def shifted(self, factor: complex = 1.0) -> Matrix:
        """Return ``A - factor B S C``, dense or sparse as A is."""
        return add_ports(self.A, self.B, -factor * self.S, self.C)

    def same(self, other: LinearPart) -> bool:
        """Whether all numbers are equal."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("B", "C", "d", "S")]
        return _equal(self.A, other.A) and all(np.array_equal(a, b) for a, b in pairs)


def add_ports(A: Matrix, B: np.ndarray, S: np.ndarray, C: np.ndarray) -> Matrix:
    """Return ``A + B S C``, sparse when A is."""
    if not sp.issparse(A):
        return A + B @ S @ C
    return sp.csc_array(A + sp.csc_array(B) @ sp.csc_array(S) @ sp.csc_array(C))


def large(n: int, nonzeros: int) -> bool:
    """Tell whether a matrix (n, n) is kept sparse."""
    return n > DENSE_STATES and nonzeros <= _FILLED * n**2


def as_matrix(values: Any) -> Matrix:
    """Return a CasADi matrix of numbers as a numpy array, or as a csc_array when it is large and sparse."""
    n = values.shape[0]
    if not large(n, values.nnz()):
        return np.array(values.full()).reshape(n, -1)
    matrix = sp.csc_array(values.sparse())
    matrix.eliminate_zeros()
    return matrix


def largest(matrix: Matrix) -> float:
    """Return the largest modulus of the entries."""
    if sp.issparse(matrix):
        return float(np.abs(matrix.data).max(initial=0.0))
    return float(np.abs(matrix).max(initial=0.0))


def pivots(stack: np.ndarray) -> np.ndarray:
    """Return indices of rows of the stack that span its row space, the best conditioned first."""
    norms = np.linalg.norm(stack, axis=1, keepdims=True)
    scaled = stack / np.where(norms > 0, norms, 1.0)
    if not scaled.any():
        return np.zeros(0, dtype=int)
    _, r, order = sl.qr(scaled.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.sort(order[: int(np.sum(size > RANK * size[0]))])


def interpolate(stack: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return X with ``stack = X stack[chosen]``, X[chosen] the identity.

    Raises
    ------
    UnsupportedModel
        If the chosen rows do not span the others.
    """
    result = stack @ np.linalg.pinv(stack[chosen], rcond=RANK) if len(chosen) else np.zeros((len(stack), 0))
    defect = np.abs(result @ stack[chosen] - stack).max(initial=0.0)
    if defect > 1e-8 * max(np.abs(stack).max(initial=0.0), 1e-300):
        raise UnsupportedModel(
            "the ports of the System change their number with the parameters; build it with default parameter values "
            "at which every nonlinear term is present"
        )
    result[np.abs(result) < 1e-14] = 0.0
    result[chosen] = np.eye(len(chosen))
    return result


def conditioning(matrix: Matrix) -> float:
    """Return the smallest over the largest singular value after balancing, so that units do not count.

    Of a sparse matrix it is the reciprocal of the estimated condition number in the 1-norm after equilibration
    (Higham and Tisseur, SIAM J. Matrix Anal. Appl. 21, 2000), at most sqrt(n) smaller; -1 where numbers are missing.

    >>> conditioning(np.diag([1.0, 4.0])), conditioning(sp.csc_array(np.diag([1.0, 0.0])))
    (0.25, 0.0)
    """
    if sp.issparse(matrix):
        return _sparse_conditioning(matrix)
    if not np.all(np.isfinite(matrix)):
        return -1.0
    values = np.linalg.svd(sl.matrix_balance(matrix, permute=False)[0], compute_uv=False)
    return float(values[-1] / max(values[0], 1e-300))


def units_of(matrix: np.ndarray) -> np.ndarray:
    """Return factors d (n,) by which balancing scales the states of a real matrix: ``A_ij d_j / d_i`` is balanced.

    Ones where the factors are so wide apart that they are no matter of units.

    >>> units_of(np.array([[0.0, 1.0], [-1e12, -1e5]])).tolist()
    [9.5367431640625e-07, 1.0]
    """
    d = np.asarray(sl.lapack.dgebal(matrix, scale=1, permute=0)[3])
    return d if np.all(np.isfinite(d)) and d.min() > 0 and d.max() < _UNITS * d.min() else np.ones(len(matrix))


def spectral_radius(matrix: Matrix) -> float:
    """Return the largest modulus of the eigenvalues; of a sparse matrix an upper estimate, ``||A^32||^(1/32)``.

    >>> spectral_radius(np.diag([1.0, -3.0])), round(spectral_radius(sp.csc_array(np.diag([1.0, -3.0]))), 9)
    (3.0, 3.0)
    """
    if not sp.issparse(matrix):
        return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    size = float(sla.norm(matrix, 1)) or 1.0
    power = sla.aslinearoperator(matrix / size) ** _POWER
    return float(size * sla.onenormest(power) ** (1 / _POWER))


def _sparse_conditioning(matrix: Matrix) -> float:
    if not np.all(np.isfinite(matrix.data)):
        return -1.0
    rows = _largest_along(matrix, 1)
    scaled = sp.csc_array(sp.diags_array(rows) @ matrix)
    scaled = sp.csc_array(scaled @ sp.diags_array(_largest_along(scaled, 0)))
    try:
        lu = sla.splu(scaled)
    except RuntimeError:  # exactly singular
        return 0.0
    inverse = sla.LinearOperator(
        scaled.shape, matvec=lu.solve, rmatvec=lambda b: lu.solve(b, "T"), matmat=lu.solve,
        rmatmat=lambda b: lu.solve(b, "T"), dtype=float,
    )  # fmt: skip
    return float(1.0 / max(sla.onenormest(inverse) * sla.norm(scaled, 1), 1e-300))


def _largest_along(matrix: Matrix, axis: int) -> np.ndarray:
    size = np.asarray(abs(matrix).max(axis=axis).toarray()).ravel()
    return 1.0 / np.where(size > 0, size, 1.0)


def _equal(a: Matrix, b: Matrix) -> bool:
    if sp.issparse(a) and sp.issparse(b):
        return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in ("data", "indices", "indptr"))
    return not (sp.issparse(a) or sp.issparse(b)) and np.array_equal(a, b)
