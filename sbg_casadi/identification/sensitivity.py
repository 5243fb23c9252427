"""Exact sensitivities of orbits, peaks and folds in the numbers of a pair, by the implicit function theorem.

An orbit solves ``F(u, omega, q) = 0``, so ``du/dq = -(dF/du)^-1 dF/dq``; the RMS needs one adjoint solution for all
numbers q. A smooth peak has ``d rms/d omega = 0``: its height changes as the RMS at fixed frequency does, its position
by the derivative of that equation, in which exact first derivatives beside the peak are differenced. A fold is a
regular solution of the bordered system of ``continuation.track``, to which the same theorem applies. The derivatives in
q are CasADi's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation import NoConvergence
from continuation.branches.extended import ExtendedProblem, extended, solve_point
from continuation.branches.newton import Metric, correct, size_of

_NEAR = 3e-6  # of the ratio: distance over which exact first derivatives, good to 1e-11, are differenced
_LEVELS = 6  # changes of the number of harmonics at most


@dataclass(frozen=True, slots=True, eq=False)
class Sensitive:
    """Hold quantities of a solution with their derivatives.

    Attributes
    ----------
    u : ndarray
        Unknown of harmonic balance.
    ratio : float
        Frequency ratio.
    rms : float
        Of lambda about its mean, half backlashes.
    ratio_gradient, rms_gradient : ndarray (q,)
        Derivatives in the numbers asked for; the ratio of an orbit at a given ratio has none, all 0.
    """

    u: np.ndarray
    ratio: float
    rms: float
    ratio_gradient: np.ndarray
    rms_gradient: np.ndarray


def set_values(problem: Any, values: dict[str, float]) -> None:
    """Give a Problem the numbers of a pair."""
    for name, value in values.items():
        problem.set_value(name, value)


def solve_orbit(problem: Any, u: np.ndarray, ratio: float) -> np.ndarray:
    """Return the orbit at a ratio near a guess, with the harmonics that its error asks for (raises NoConvergence)."""
    for _ in range(_LEVELS):
        u = correct(problem, (u, ratio), (np.zeros_like(u), 1.0), Metric(size_of(u), ratio), iterations=20).u
        longer, _ = problem.adapt(u, ratio)
        if len(longer) <= len(u):
            break
        u = longer
    return u


def orbit_rms(problem: Any, u: np.ndarray) -> float:
    """Return the RMS of lambda about its mean; the packing makes it a norm."""
    return float(np.linalg.norm(u[problem.ports.outputs :]))


def rms_gradient(problem: Any, u: np.ndarray, ratio: float, names: Sequence[str]) -> tuple[np.ndarray, float]:
    """Return d(rms)/dq (q,) of an orbit at a fixed ratio, and d(rms)/d(ratio).

    Cost: one adjoint solution, and one evaluation of dF/dq for each name.
    """
    _, J, Fp = problem.linearise(u, ratio)
    direction = u.copy()
    direction[: problem.ports.outputs] = 0.0
    adjoint = np.linalg.solve(J.T, direction / max(orbit_rms(problem, u), 1e-300))
    slopes = [-float(adjoint @ problem.parameter_derivative(u, ratio, name)) for name in names]
    return np.array(slopes), -float(adjoint @ Fp)


def orbit_at(problem: Any, u: np.ndarray, ratio: float, names: Sequence[str]) -> Sensitive:
    """Solve the orbit at a ratio near a guess; its RMS with the gradient (raises NoConvergence)."""
    u = solve_orbit(problem, u, ratio)
    gradient, _ = rms_gradient(problem, u, ratio, names)
    return Sensitive(u, ratio, orbit_rms(problem, u), np.zeros(len(names)), gradient)


def peak_at(problem: Any, u: np.ndarray, ratio: float, names: Sequence[str], span: tuple[float, float]) -> Sensitive:
    """Solve the smooth maximum of the RMS over the ratio near a guess, with both gradients.

    Raises
    ------
    NoConvergence
        If there is none inside the span.
    """
    low, high = span
    known = [False, False]  # whether the slope is positive at low and negative at high
    for _ in range(60):
        u = solve_orbit(problem, u, ratio)
        slope, bend = _slope_and_bend(problem, u, ratio)
        low, high = (ratio, high) if slope > 0 else (low, ratio)
        known[0 if slope > 0 else 1] = True
        target = ratio - slope / bend if bend < 0 else np.nan
        if not low <= target <= high or abs(target - ratio) > (span[1] - span[0]) / 8:
            target = (low + high) / 2 if all(known) else ratio + np.sign(slope) * (span[1] - span[0]) / 16
        if not span[0] < target < span[1]:
            raise NoConvergence(f"the RMS has no smooth maximum between {span[0]:.4g} and {span[1]:.4g}")
        step, ratio = abs(target - ratio), float(target)
        if bend < 0 and step < 1e-10 * ratio:
            break
    else:
        raise NoConvergence(f"the maximum of the RMS near {ratio:.6g} was not found")
    u = solve_orbit(problem, u, ratio)
    gradient, _ = rms_gradient(problem, u, ratio, names)
    (before, _), (behind, _) = (_near(problem, u, ratio, side, names) for side in (-1, 1))
    _, bend = _slope_and_bend(problem, u, ratio)
    mixed = (behind - before) / (2 * _NEAR * ratio)
    return Sensitive(u, ratio, orbit_rms(problem, u), -mixed / bend, gradient)


def _near(problem: Any, u: np.ndarray, ratio: float, side: int, names: Sequence[str]) -> tuple[np.ndarray, float]:
    """Return the gradients beside a ratio, with the same number of harmonics."""
    at = ratio * (1 + side * _NEAR)
    moved = correct(problem, (u, at), (np.zeros_like(u), 1.0), Metric(size_of(u), ratio), iterations=20).u
    return rms_gradient(problem, moved, at, names)


def _slope_and_bend(problem: Any, u: np.ndarray, ratio: float) -> tuple[float, float]:
    _, slope = rms_gradient(problem, u, ratio, ())
    (_, low), (_, high) = (_near(problem, u, ratio, side, ()) for side in (-1, 1))
    return slope, (high - low) / (2 * _NEAR * ratio)


def fold_at(problem: Any, u: np.ndarray, ratio: float, names: Sequence[str]) -> Sensitive:
    """Solve the fold near a guess, with the gradients of its ratio and of the RMS there (raises NoConvergence)."""
    system = extended(problem, "fold", u, ratio)
    U = system.join(u, ratio)
    for _ in range(_LEVELS):
        U = solve_point(system, U).u
        longer, _ = system.adapt(U, 0.0)
        if len(longer) <= len(U):
            break
        U = longer
    u, ratio, _ = system.split(U)
    height, outputs = orbit_rms(problem, u), problem.ports.outputs
    ratios, heights = [], []
    for name in names:
        along = ExtendedProblem(problem, "fold", size_of(u), problem.parameter_scale(ratio), name)
        joined = along.join(u, ratio)
        _, matrix, change = along.linearise(joined, problem.values[name])
        du, dp, _ = along.split(-np.linalg.solve(matrix, change))
        ratios.append(dp)
        heights.append(float(u[outputs:] @ du[outputs:]) / height)
    return Sensitive(u, ratio, height, np.array(ratios), np.array(heights))
