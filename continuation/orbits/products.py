"""Eigenvalues of a product of matrices that never forms the product, so that small ones keep their digits.

The eigenvalues of ``A_K ... A_1`` computed from the product itself carry an error of rounding times the largest; after
a strongly damped period all small multipliers are then noise. Here an orthogonal basis is carried through the factors,
``A_k Q_(k-1) = Q_k R_k``, pass after pass, which orders the triangular factors by size (the QR iteration behind the
periodic Schur form of Bojanczyk, Golub and Van Dooren, 1992; discrete QR in Dieci and Van Vleck); eigenvalues are taken
from the diagonal blocks of the product of the triangular factors, none of which spreads widely.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

_PASSES = 200
_GROUP = 1e3  # condition number up to which neighbouring factors are multiplied
_RANGE = 1e100  # of the size of what is multiplied
_WIDE = 1e6  # spread up to which a block is given to a dense solver
_SPLIT = 1e-14  # of the basis that turns out of a block in a pass: rounding, at first
_LOOSER = 20  # passes after which ten times as much counts as rounding
_EPS = float(np.finfo(float).eps)


def product_eigenvalues(factors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the eigenvalues of ``factors[K-1] @ ... @ factors[0]`` with their errors.

    Parameters
    ----------
    factors : array (K, n, n)
        Real square matrices, the one applied first in front.

    Returns
    -------
    logarithms : array (n,)
        log|mu|, largest first; minus infinity for an eigenvalue 0. No number under- or overflows.
    angles : array (n,)
        arg mu in (-pi, pi].
    errors : array (n,)
        Estimated relative error of each eigenvalue.

    Raises
    ------
    ValueError
        If the factors are not finite square matrices of one size.

    Notes
    -----
    Cost about K QR factorisations per pass; passes are as many as it takes the eigenvalues to fall apart into blocks
    that spread by less than 1e6 each, mostly 2 to 20.

    Examples
    --------
    >>> squeeze = np.array([[0.1, 0.0], [3.0, 1e-4]])
    >>> logarithms, angles, errors = product_eigenvalues(np.array([squeeze] * 50))
    >>> (logarithms / np.log(10)).round(9).tolist(), bool(errors.max() < 1e-8)
    ([-50.0, -200.0], True)
    """
    factors = np.asarray(factors, dtype=float)
    if factors.ndim != 3 or factors.shape[1] != factors.shape[2] or not np.all(np.isfinite(factors)):
        raise ValueError(f"factors: expected finite matrices (K, n, n), got shape {factors.shape}")
    n = factors.shape[1]
    if not len(factors):
        return np.zeros(n), np.zeros(n), np.zeros(n)
    groups = _grouped(factors)
    basis = np.eye(n)
    for i in range(_PASSES):
        basis, triangles, turn = _sweep(groups, basis)
        blocks = _blocks(turn, _SPLIT * n * 10.0 ** (i // _LOOSER))
        if max(_spread(triangles, a, b) for a, b in blocks) < _WIDE:
            break
    left = max((float(np.abs(turn[b:, :b]).max()) for _, b in blocks[:-1]), default=0.0)
    size = np.linalg.norm(groups, axis=(1, 2))
    parts = [_block(triangles[:, a:b, a:b], turn[a:b, a:b], size, n * left) for a, b in blocks]
    logarithms, angles, errors = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((-angles, -logarithms.round(9)))
    return logarithms[order], angles[order], errors[order]


def _grouped(factors: np.ndarray) -> np.ndarray:
    """Multiply neighbours as long as the product stays so well conditioned that nothing is lost."""
    groups = [factors[0]]
    for factor in factors[1:]:
        together = factor @ groups[-1]
        size = np.linalg.svd(together, compute_uv=False)
        if size[-1] * _GROUP > size[0] and 1 / _RANGE < size[0] < _RANGE:
            groups[-1] = together
        else:
            groups.append(factor)
    return np.array(groups)


def _sweep(groups: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Carry a basis (n, n) once around; return the new basis, the triangular factors, and how the basis turned.

    With ``turn = Q_0^T Q_K`` the product is similar to ``R_K ... R_1 turn``.
    """
    triangles = np.empty_like(groups)
    start = basis
    for k, group in enumerate(groups):
        basis, triangles[k] = np.linalg.qr(group @ basis)
    return basis, triangles, start.T @ basis


def _blocks(turn: np.ndarray, rest: float) -> list[tuple[int, int]]:
    """Return the ranges of diagonal blocks below which the turned basis has nothing left."""
    n = len(turn)
    cuts = [i for i in range(1, n) if np.abs(turn[i:, :i]).max() < rest]
    return list(pairwise([0, *cuts, n]))


def _spread(triangles: np.ndarray, a: int, b: int) -> float:
    """Return the ratio of the largest to the smallest diagonal of the product within a block."""
    if b - a <= 1:
        return 1.0
    diagonal = np.abs(np.diagonal(triangles, axis1=1, axis2=2)[:, a:b])
    with np.errstate(divide="ignore"):
        logs = np.log(diagonal).sum(axis=0)
    finite = logs[np.isfinite(logs)]
    return float(np.exp(min(finite.max() - finite.min(), 700.0))) if finite.size else 1.0


def _block(
    triangles: np.ndarray, turn: np.ndarray, norms: np.ndarray, left: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return logarithms, angles and relative errors of the eigenvalues of one block of the product.

    ``norms`` (K,) of the whole factors tell what their rounding means for the block, ``left`` what the turn of the
    basis still mixes in.
    """
    product, log = np.eye(len(turn)), 0.0
    for triangle in triangles:
        product = triangle @ product
        size = float(np.abs(product).max())
        if size == 0.0:
            return np.full(len(turn), -np.inf), np.zeros(len(turn)), np.zeros(len(turn))
        product, log = product / size, log + np.log(size)
    matrix = product @ turn
    values, modes = np.linalg.eig(matrix)
    moduli = np.abs(values)
    some = moduli > 0
    logarithms = np.log(moduli, out=np.full(moduli.shape, -np.inf), where=some) + log
    try:
        condition = np.linalg.norm(modes, axis=0) * np.linalg.norm(np.linalg.inv(modes), axis=1)
    except np.linalg.LinAlgError:
        condition = np.full(moduli.shape, np.inf)
    least = np.abs(np.diagonal(triangles, axis1=1, axis2=2)).min(axis=1)
    rounding = _EPS * float(np.sum(norms / np.maximum(least, 1e-300)))
    relative = np.divide(np.linalg.norm(matrix), moduli, out=np.full(moduli.shape, np.inf), where=some)
    errors = 4 * condition * (relative * _EPS * len(turn) + rounding + left)
    return logarithms, np.where(some, np.angle(values), 0.0), errors
