"""Damped semismooth Newton on ``F(u, p) = 0`` with one bordering row, the step of every continuation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from continuation.branches.bordered import Factors, bordered_factors
from continuation.branches.sparse_bordered import solve_bordered
from continuation.errors import IntegrationFailed, NoConvergence, UnsupportedModel

_STEP = 1e-8  # a step below this (relative) is the last: convergence is quadratic
_LINEAR = 1e-8  # accuracy of the linear equations where they are solved by iteration: that of a step and a tangent
_HALVINGS = 6
_NEAR = 1e6  # times the accuracy: largest first step that a chord step may follow
_RATE = 0.02  # largest ratio of both
_LONGEST_CYCLE = 4  # iterates that are looked at for a return to an earlier one
_ESCAPES = 3  # cycles that are left by their mean before Newton's method gives up
_SINGULAR = (
    "the bordered Jacobian is singular: the orbit is not determined (a body between open contacts, an undamped mode in "
    "resonance); give it a load, a spring or damping"
)


class Problem(Protocol):
    """What a method makes of a System; what the continuation loop needs of it."""

    parameter: str

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F (N,), dF/du (N, N), dF/dp (N,)."""
        ...

    def adapt(self, u: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return u at the resolution its error asks for, and the error estimate."""
        ...

    def lengthen(self, u: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Bring u to the length of another vector."""
        ...


def size_of(u: np.ndarray) -> float:
    """Return the norm of an unknown, or 1 for an orbit at rest."""
    size = float(np.linalg.norm(u))
    return size if size > 1e-12 else 1.0


UNUSABLE = (ValueError, np.linalg.LinAlgError, UnsupportedModel, IntegrationFailed)
"""What a model raises where it has no value."""


@dataclass(frozen=True, slots=True)
class Metric:
    """Arclength ds^2 = |du|^2 / size^2 + dp^2 / span^2."""

    size: float
    span: float

    def length(self, du: np.ndarray, dp: float) -> float:
        """Return the length of a displacement."""
        with np.errstate(over="ignore"):  # a step that is too long to be measured is infinite
            return float(np.sqrt(du @ du / self.size**2 + (dp / self.span) ** 2))

    def dot(self, a: tuple[np.ndarray, float], b: tuple[np.ndarray, float]) -> float:
        """Return the inner product of two displacements of equal length."""
        return float(a[0] @ b[0] / self.size**2 + a[1] * b[1] / self.span**2)


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A corrected point: unknown u, parameter p, unit tangent (tu, tp), sign of the bordered determinant, work."""

    u: np.ndarray
    p: float
    tu: np.ndarray
    tp: float
    sign: float
    iterations: int
    error: float = float("nan")


def correct(
    problem: Problem,
    guess: tuple[np.ndarray, float],
    direction: tuple[np.ndarray, float],
    metric: Metric,
    *,
    iterations: int = 12,
    accuracy: float = 1e-11,
) -> Node:
    """Solve F = 0 on the hyperplane through ``guess`` normal to ``direction``.

    Parameters
    ----------
    guess, direction : (u, p)
        Start and normal; a direction ``(0, 1)`` keeps the parameter fixed.
    iterations : int
        Most Newton steps.
    accuracy : float
        A step is the last when the one after it, predicted from the rate so far, is below this, relative to the size.

    Returns
    -------
    Node
        With a unit tangent oriented along ``direction``.

    Raises
    ------
    NoConvergence
        With the residual history, when damped Newton does not converge.
    """
    u, p = guess
    anchor = getattr(problem, "anchor", None)
    if anchor is not None:  # an autonomous System: of all its shifts in time the orbit nearest to the guess is taken
        anchor(u, p)
    border = np.append(direction[0] / metric.size**2, direction[1] / metric.span**2)
    history: list[float] = []
    best = last = np.inf
    before: list[tuple[np.ndarray, float]] = []
    escapes = 0
    F, J, Fp = _linearise(problem, u, p, history)
    for count in range(1, iterations + 1):
        history.append(float(np.linalg.norm(F)))
        step, tangent, sign, factors = _solve(J, Fp, F, border, history, p)
        du, dp = step[:-1], float(step[-1])
        size = metric.length(du, dp)
        if not np.isfinite(size):
            raise NoConvergence("Newton's step is not finite", history, p)
        scale = max(1.0, float(np.linalg.norm(u)) / metric.size)
        if size < _STEP * scale or (
            size < 1e-4 * scale and np.isfinite(last) and 10 * (size / last) ** 2 * size < accuracy * scale
        ):
            tu, tp = tangent[:-1], float(tangent[-1])
            norm = metric.length(tu, tp)
            keep = getattr(problem, "keep_factors", None)
            if keep is not None and factors is not None:  # the error estimate of the point solves with the same matrix
                keep(factors)
            return Node(u + du, p + dp, tu / norm, tp / norm, sign, count)
        if count == 1 and factors is not None:
            node = _finished(problem, (u + du, p + dp), factors, tangent, metric, size, accuracy * scale)
            if node is not None:
                return node
        before.append((u, p))
        u, p, F, J, Fp = _damped(problem, (u, p), (du, dp), history)
        if cycle := _cycle(before, (u, p), metric, size):
            escapes = _escape(escapes, cycle, history, p)
            u, p = (np.mean(values, axis=0) for values in zip(*before[-cycle:], strict=True))
            F, J, Fp = _linearise(problem, u, p, history)
            before.clear()
        best, last = min(best, size), size
        if count > 6 and size > 10 * best:
            break
    raise NoConvergence(f"Newton's method did not converge in {len(history)} steps", history, p)


def _finished(
    problem: Problem,
    at: tuple[np.ndarray, float],
    factors: Factors,
    tangent: np.ndarray,
    metric: Metric,
    size: float,
    accuracy: float,
) -> Node | None:
    """Return the node that one chord step with the factors of the first step reaches, None where that is not enough.

    The rate of chord steps is about twice that of the sizes of both steps, from which what is left is estimated.
    """
    finish = getattr(problem, "finish", None)
    if finish is None or size > _NEAR * accuracy:
        return None
    try:
        found = finish(*at, factors, tangent)
    except UNUSABLE:  # the model ends here: damping is called for
        return None
    if found is None:
        return None
    step, t, keep = found
    chord = metric.length(step[:-1], float(step[-1]))
    rest = chord**2 / size
    if not (chord < _RATE * size and 10 * rest < accuracy):
        return None
    keep(2 * rest * metric.size)
    norm = metric.length(t[:-1], float(t[-1]))
    return Node(at[0] + step[:-1], at[1] + float(step[-1]), t[:-1] / norm, float(t[-1]) / norm, factors.sign, 2)


def _linearise(problem: Problem, u: np.ndarray, p: float, history: list[float]) -> Any:
    try:
        return problem.linearise(u, p)
    except UNUSABLE as reason:  # a step too far, mostly
        raise NoConvergence(str(reason), history, p) from reason


def _damped(
    problem: Problem, at: tuple[np.ndarray, float], step: tuple[np.ndarray, float], history: list[float]
) -> Any:
    """Take the step, halved while the residual grows; the last halving is taken as it is (contact patterns change)."""
    scale = 1.0
    for halving in range(_HALVINGS + 1):
        u, p = at[0] + scale * step[0], at[1] + scale * step[1]
        F, J, Fp = _linearise(problem, u, p, history)
        if np.linalg.norm(F) <= max(2.0 * history[-1], 1e-12) or halving == _HALVINGS:
            break
        scale /= 2
    return u, p, F, J, Fp


def _cycle(before: list[tuple[np.ndarray, float]], at: tuple[np.ndarray, float], metric: Metric, step: float) -> int:
    """Return the number of steps, 2 or more, after which Newton's method came back to an earlier iterate, else 0.

    The derivative of a contact force jumps, so that the method may go back and forth between contact patterns for ever.
    """
    for back in range(2, min(len(before), _LONGEST_CYCLE) + 1):
        u, p = before[-back]
        if metric.length(at[0] - u, at[1] - p) < 1e-3 * step:
            return back
    return 0


def _escape(escapes: int, cycle: int, history: list[float], p: float) -> int:
    """Count the cycles met; the mean of one is a new start, often with another contact pattern."""
    if escapes >= _ESCAPES:
        raise NoConvergence(
            f"Newton's method goes round between {cycle} contact patterns without an orbit; take smaller steps, start "
            "on system.smoothed(width), or look for the end of the branch",
            history,
            p,
        )
    return escapes + 1


def _solve(
    J: np.ndarray, Fp: np.ndarray, F: np.ndarray, border: np.ndarray, history: list[float], p: float
) -> tuple[np.ndarray, np.ndarray, float, Factors | None]:
    """Newton step and tangent from one factorisation of the bordered matrix, the sign of its determinant, and it."""
    n = len(F)
    if sp.issparse(J):
        return *_solve_sparse(J, Fp, F, border, history, p), None
    right = np.zeros((n + 1, 2), order="F")
    right[:n, 0], right[n, 1] = -F, 1.0
    factors = bordered_factors(J, Fp, border)
    if factors is None:
        raise NoConvergence(_SINGULAR, history, p)
    solution = factors.solve(right, accuracy=_LINEAR)
    return solution[:, 0], solution[:, 1], factors.sign, factors


def _solve_sparse(
    J: Any, Fp: np.ndarray, F: np.ndarray, border: np.ndarray, history: list[float], p: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Do the same with a sparse Jacobian."""
    if not (np.all(np.isfinite(F)) and np.all(np.isfinite(J.data)) and np.all(np.isfinite(Fp))):
        raise NoConvergence(f"the right-hand side of the model is not finite near parameter value {p:.10g}", history, p)
    right = np.zeros((len(F) + 1, 2))
    right[:-1, 0], right[-1, 1] = -F, 1.0
    found = solve_bordered(J, Fp, border, right)
    if found is None:
        raise NoConvergence(_SINGULAR, history, p)
    (step, tangent), sign = found[0].T, found[1]
    return step, tangent, sign
