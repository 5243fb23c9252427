"""How far a shooting point is from the exact branch, from one integration at a tighter tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl

from continuation.branches.newton import size_of
from continuation.orbits.near_fold import measures_error

_DEPENDENT = 1e-12  # relative size below which directions count as dependent
_ALONG = 1e-6  # of the size of a point: distance along the branch over which multipliers are compared


@dataclass(frozen=True, slots=True)
class Estimate:
    """A change of a point (u, p) that removes its residual at a tolerance a hundred times tighter.

    That at the same parameter, or the shortest change of state and parameter next to a fold, where the first is no
    measure.

    Attributes
    ----------
    step : ndarray (N,)
        Change of u.
    dp, dfrequency : float
        Change of the parameter, and the relative one of the frequency of an autonomous System; else 0.
    error : float
        Twice the largest change of a state.
    at_fold : bool
        Whether a fold is so near that only the shortest change is known.
    """

    step: np.ndarray
    dp: float
    dfrequency: float
    error: float
    at_fold: bool


def estimate(problem: Any, u: np.ndarray, p: float, across: bool = False) -> Estimate:
    """Return the estimate of a point (u, p) of a ShootingProblem; cost about two integrations.

    Parameter and frequency count by their relative change. With ``across`` the shortest change is always taken.
    """
    ends = problem.path(u, p, tight=True).ends
    residual = problem.joined(ends - np.roll(problem.states(u), -1, axis=0))
    matrix = problem.cyclic(problem.segment_matrices(u, p), -1.0)
    n, size, unit = len(u), size_of(u), problem.parameter_scale(p)
    if problem.free is not None:
        relative = problem.values[problem.free] / size
        matrix = np.column_stack([matrix, relative * problem.parameter_derivative(u, p, problem.free)])
    push = unit / size * problem.parameter_derivative(u, p, problem.parameter)
    problem.factorisations += 2
    change = shortest(np.column_stack([matrix, push]), -residual)
    at_fold = False
    if not across:
        fixed = np.append(shortest(matrix, -residual), 0.0)
        at_fold = not measures_error(float(np.linalg.norm(fixed)), float(np.linalg.norm(change)), size)
        change = change if at_fold else fixed
    turn = float(change[n]) / size if problem.free is not None else 0.0
    error = 2 * float(abs(problem.states(change[:n])).max())
    return Estimate(change[:n], float(change[-1]) * unit / size, turn, error, at_fold)


def shortest(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the shortest solution (K,) of a matrix (N, K), K >= N, also where its rows are dependent.

    >>> shortest(np.array([[1.0, 1.0]]), np.array([1.0])).round(12).tolist()
    [0.5, 0.5]
    """
    q, r = sl.qr(matrix.T, mode="economic", check_finite=False)
    diagonal = np.abs(np.diag(r))
    if diagonal.min() > _DEPENDENT * diagonal.max():
        return np.asarray(q @ sl.solve_triangular(r, right, trans="T", check_finite=False))
    return np.asarray(sl.lstsq(matrix, right, cond=_DEPENDENT, lapack_driver="gelsy", check_finite=False)[0])


def crossing_error(problem: Any, node: Any, kind: str) -> float:
    """Return the parameter error of a special point of a shooting branch.

    The way to the exact branch, seen in the parameter; at a doubling or torus point in addition the change of the
    multiplier there between normal and tight tolerance, over its speed along the branch.
    """
    at = estimate(problem, node.u, node.p, across=True)
    steepness = abs(node.tp) / max(float(np.linalg.norm(node.tu)), 1e-300)
    error = 2 * (abs(at.dp) + steepness * float(np.linalg.norm(at.step)))
    if kind not in ("period-doubling", "neimark-sacker"):
        return error
    reach = _ALONG * size_of(node.u) / max(float(np.linalg.norm(node.tu)), 1e-300)
    here = _modulus(problem.monodromy(node.u, node.p), kind)
    exact = _modulus(problem.monodromy(node.u + at.step, node.p + at.dp, tight=True), kind)
    beyond = _modulus(problem.monodromy(node.u + reach * node.tu, node.p + reach * node.tp), kind)
    speed = abs(beyond - here) / max(abs(reach * node.tp), 1e-300)
    return error + (2 * abs(exact - here) / speed if speed > 0 else 0.0)


def _modulus(matrix: np.ndarray, kind: str) -> float:
    """Return the modulus of the multiplier nearest to -1, or of the complex one nearest to the unit circle."""
    mu = np.linalg.eigvals(matrix)
    if kind == "period-doubling":
        return float(abs(mu[np.argmin(abs(mu + 1))]))
    pairs = mu[mu.imag > 0] if np.any(mu.imag > 0) else mu
    return float(abs(pairs[np.argmin(abs(abs(pairs) - 1))]))
