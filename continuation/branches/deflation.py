"""Deflated Newton's method: solutions of F(u, p) = 0 at one p other than the known ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.newton import size_of
from continuation.branches.sparse_bordered import factorised
from continuation.errors import IntegrationFailed, NoConvergence, UnsupportedModel

_CLOSE = 1e-8  # relative step that is the last
_NEAR = 1e-4  # relative distance from a known solution at which a result is that solution
_LONGEST = 0.5  # of the size of the iterate, longest step


def deflated(problem: Any, u: np.ndarray, p: float, known: Sequence[np.ndarray], *, iterations: int = 40) -> np.ndarray:
    """Solve F(u, p) = 0 at fixed p for a solution that is none of the known ones.

    Newton's method on ``m(u) F(u)`` with ``m = prod_i (1 + |u_i|^2 / |u - u_i|^2)`` over the known solutions u_i, which
    are poles and no longer attract. Its step is Newton's own, times ``1 / (1 - grad(log m) . step)``: one factorisation
    of the Jacobian as it is, whatever the number of known solutions.

    Parameters
    ----------
    problem : Problem
    u : array (N,)
        Start; it may lie as near to a known solution as is liked, but not on it.
    known : sequence of arrays
        Unknowns of the same problem, of any resolution.

    Returns
    -------
    array (N,)
        Of the resolution of ``u``.

    Raises
    ------
    NoConvergence
        When no other solution is reached.

    Notes
    -----
    P. E. Farrell, A. Birkisson and S. W. Funke, SIAM J. Sci. Comput. 37 (2015) A2026-A2045. A solution that is not
    found may exist all the same.

    Examples
    --------
    >>> class Parabola:
    ...     def linearise(self, u, p):
    ...         return u**2 - p, np.diag(2 * u), -np.ones(1)
    ...     def lengthen(self, u, like):
    ...         return u
    >>> deflated(Parabola(), np.array([-1.0]), 4.0, [np.array([2.0])]).round(8).tolist()
    [-2.0]
    """
    poles = [problem.lengthen(k, u) for k in known]
    anchor = getattr(problem, "anchor", None)
    if anchor is not None:
        anchor(u, p)
    history: list[float] = []
    for _ in range(iterations):
        try:
            F, J, _ = problem.linearise(u, p)
        except (ValueError, np.linalg.LinAlgError, UnsupportedModel, IntegrationFailed) as reason:
            raise NoConvergence(f"deflated Newton's method left the model's range: {reason}", history, p) from reason
        history.append(float(np.linalg.norm(F)))
        step = _newton_step(J, F)
        if step is None or not np.all(np.isfinite(step)):
            raise NoConvergence("the Jacobian is singular in deflated Newton's method", history, p)
        size = float(np.linalg.norm(step))
        if size < _CLOSE * size_of(u):
            u = u + step
            if any(np.linalg.norm(u - k) < _NEAR * size_of(k) for k in poles):
                raise NoConvergence("deflated Newton's method came back to a known solution", history, p)
            return u
        turn = 1.0 - float(_log_gradient(u, poles) @ step)
        step = step / (turn if abs(turn) > 1e-12 else 1e-12)
        longest = _LONGEST * size_of(u)
        u = u + step * min(1.0, longest / max(float(np.linalg.norm(step)), 1e-300))
    raise NoConvergence(f"deflated Newton's method found nothing in {iterations} steps", history, p)


def _newton_step(J: Any, F: np.ndarray) -> np.ndarray | None:
    if sp.issparse(J):
        lu = factorised(sp.csc_array(J))
        return None if lu is None else np.asarray(lu.solve(-F))
    try:
        return np.linalg.solve(J, -F)
    except np.linalg.LinAlgError:
        return None


def _log_gradient(u: np.ndarray, poles: Sequence[np.ndarray]) -> np.ndarray:
    """Return the gradient (N,) of log m, of every factor 1 + r^2 / |d|^2: -2 r^2 d / (|d|^2 (|d|^2 + r^2))."""
    total = np.zeros_like(u)
    for pole in poles:
        d, r2 = u - pole, size_of(pole) ** 2
        d2 = max(float(d @ d), 1e-300)
        total -= 2 * r2 * d / (d2 * (d2 + r2))
    return total
