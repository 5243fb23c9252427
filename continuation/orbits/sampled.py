"""Orbits of methods that know a state at phase 0 and an integrator: Fourier coefficients from samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.orbits.floquet import distance, verdict
from continuation.orbits.monodromy import multipliers
from continuation.orbits.orbit import Orbit

_SAMPLES = 512  # per excitation period
_FLOOR = 1e-10


def sampled_orbit(problem: Any, u: np.ndarray, p: float, error: float) -> Orbit:
    """Return the Orbit of a shooting point.

    The error bar of a multiplier is its change at a tighter tolerance of the integrator plus its change when the
    state is moved by its error estimate.
    """
    count = _SAMPLES * problem.period_multiple
    spectrum = np.fft.rfft(problem.waveform(u, p, count), axis=0)[: count // 4] / count
    moved = u + error / np.sqrt(len(u))
    matrices = np.array([problem.monodromy(u, p), problem.tight_monodromy(u, p), problem.monodromy(moved, p)])
    mu, tight, other = multipliers(matrices)
    bar = distance(mu, tight) + distance(mu, other) + _FLOOR
    return Orbit(
        system=problem.system.name,
        state_names=problem.system.state_names,
        parameter=problem.parameter,
        parameters=dict(zip(problem.system.parameter_names, problem.vector(p).tolist(), strict=True)),
        period=2 * np.pi / problem.frequency(p),
        period_multiple=problem.period_multiple,
        coefficients=spectrum,
        multipliers=mu,
        multiplier_error=bar,
        stability=verdict(mu, bar),
        error=error,
    )
