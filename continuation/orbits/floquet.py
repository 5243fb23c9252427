"""Stability verdicts: multipliers with error bars, and the Orbit that carries them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from continuation.orbits.monodromy import monodromy, multipliers
from continuation.orbits.orbit import Orbit, Stability
from continuation.orbits.spectrum import resize

FLOOR = 1e-10  # error of the transition integrator and of the eigenvalues of a well-conditioned matrix


def make_orbits(problem: Any, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
    """Return the Orbits of corrected harmonic-balance points (u, p, waveform error).

    The error bar of a multiplier is twice its change when the waveform is moved by its estimated error, plus the
    defect of Liouville's determinant. An orbit with a multiplier within its error bar of the unit circle is undecided.
    """
    k = problem.ports.outputs
    flow = monodromy(problem, [(u, p) for u, p, _ in points])
    moved = []
    for u, p, _ in points:
        estimate = problem.estimate(u, p)
        step = estimate.step
        longer = resize(u, k, (len(step) // k - 1) // 2)
        moved.append((longer + step, p + estimate.dp))
    other = monodromy(problem, moved)
    mu, shifted = multipliers(flow.matrices), multipliers(other.matrices)
    orbits = []
    for i, (u, p, error) in enumerate(points):
        bar = 2 * distance(mu[i], shifted[i]) + np.abs(mu[i]) * abs(flow.liouville[i]) + FLOOR
        orbits.append(build_orbit(problem, p, problem.state_spectrum(u, p), mu[i], bar, error))
    return orbits


def build_orbit(
    problem: Any, p: float, coefficients: np.ndarray, mu: np.ndarray, bar: np.ndarray, error: float
) -> Orbit:
    """Return the Orbit of a problem at p from state harmonics, multipliers, their error bars and the waveform error."""
    return Orbit(
        system=problem.system.name,
        state_names=problem.system.state_names,
        parameter=problem.parameter,
        parameters=dict(zip(problem.system.parameter_names, problem.vector(p).tolist(), strict=True)),
        period=2 * np.pi / problem.frequency(p),
        period_multiple=problem.period_multiple,
        coefficients=coefficients,
        multipliers=mu,
        multiplier_error=bar,
        stability=verdict(mu, bar),
        error=error,
    )


def distance(mu: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return |mu - its partner| (n,) under the best pairing of two sets of multipliers."""
    table = np.abs(mu[:, None] - other[None, :])
    rows, columns = linear_sum_assignment(table)
    return table[rows, columns]


def verdict(mu: np.ndarray, bar: np.ndarray) -> Stability:
    """Return the stability of multipliers (n,) with error bars (n,).

    >>> verdict(np.array([0.5, 0.2]), np.array([1e-6, 1e-6]))
    'stable'
    >>> verdict(np.array([1.0000001, 0.2]), np.array([1e-6, 1e-6]))
    'undecided'
    """
    outside = np.abs(mu) - 1
    if np.any(outside > bar):
        return "unstable"
    return "stable" if np.all(outside < -bar) else "undecided"
