"""Orbits of methods that know a state at phase 0 and an integrator: Fourier coefficients from samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.orbits.floquet import FLOOR, build_orbit, distance
from continuation.orbits.monodromy import multipliers
from continuation.orbits.orbit import Orbit

_SAMPLES = 512  # per excitation period


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
    bar = distance(mu, tight) + distance(mu, other) + FLOOR
    return build_orbit(problem, p, spectrum, mu, bar, error)
