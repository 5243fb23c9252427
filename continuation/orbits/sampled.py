"""Orbits of shooting points: Fourier coefficients of the waveform, and multipliers with error bars."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.orbits.floquet import FLOOR, build_orbit, conditioned, distance
from continuation.orbits.near_fold import side_unknown
from continuation.orbits.orbit import Orbit
from continuation.orbits.patterns import contact_names
from continuation.orbits.products import product_eigenvalues

_FEWEST, _MOST = 16, 512  # harmonics kept, per excitation period
_SMALL = 1e-10  # tail that is left out, over the largest state
_WIDE = 1e8  # spread of the singular values of the monodromy matrix beyond which its small eigenvalues are noise
_ROUNDING = 1e-12  # relative rounding error of the monodromy matrix, which ill-conditioned multipliers magnify


def sampled_orbit(problem: Any, u: np.ndarray, p: float, error: float) -> Orbit:
    """Return the Orbit of a shooting point with the estimated distance ``error`` from the exact branch.

    The point is moved by its estimated distance from the exact branch and integrated again, a hundred times tighter.
    Multipliers are those of this better orbit, twice their change from the orbit as it is are their error bars: errors
    of what is coarser than what is reported. Likewise ``error`` of the Orbit is twice the change of the waveform.

    Harmonics are added until what is left out is below 1e-10 of the largest state, at most 512 per excitation period.
    With contacts that limit binds: accelerations have corners there, coefficients of velocities fall like k^-3 and
    those of displacements like k^-4. The largest of what is left out at the samples, half as much again between them,
    is part of ``error``; four samples per harmonic put the aliasing far below it.
    """
    at = problem.estimate(u, p)
    rough, best = problem.path(u, p), problem.path(u + at.step, p + at.dp, tight=True, turn=at.dfrequency)
    mu, rounding = _multipliers(best)
    bar = 2 * distance(mu, _multipliers(rough)[0]) + rounding
    if at.at_fold:
        bar = side_unknown(mu, bar, problem.free is not None)
    spectrum, left, off = _spectrum(problem, rough, best)
    contacts = dict(zip(contact_names(problem.system), rough.contacts(), strict=True))
    return build_orbit(problem, p, spectrum, mu, bar, max(error, 2 * off) + 1.5 * left, contacts)


def _multipliers(path: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues (n,) of the product of the matrices of a path, largest first, and their rounding errors.

    Where they spread widely they are taken from the matrices of the steps, whose product is not formed.
    """
    matrix = np.eye(path.matrices.shape[1])
    for part in path.matrices:
        matrix = part @ matrix
    sizes = np.linalg.svd(matrix, compute_uv=False)
    if sizes[0] > _WIDE * sizes[-1]:
        logarithms, angles, errors = product_eigenvalues(path.factors)
        mu = np.exp(np.clip(logarithms, None, 700.0) + 1j * angles)
        return mu, (FLOOR + errors) * np.abs(mu)
    values, condition, size = conditioned(matrix[None])
    reach = condition * size[:, None]
    order = np.argsort(-np.abs(values[0]) - 1e-12 * (values[0].imag > 0), kind="stable")
    return values[0, order], FLOOR * np.abs(values[0, order]) + _ROUNDING * reach[0, order]


def _spectrum(problem: Any, rough: Any, best: Any) -> tuple[np.ndarray, float, float]:
    """Return the half spectrum (K+1, n), what it leaves out at the samples, and the change to the better orbit."""
    m, harmonics = len(rough.ends), _FEWEST * problem.period_multiple
    while True:
        count = m * -(-4 * harmonics // m)
        wave = rough.waveform(count)
        full = np.fft.rfft(wave, axis=0) / count
        kept = full.copy()
        kept[harmonics + 1 :] = 0
        left = float(abs(np.fft.irfft(kept * count, count, axis=0) - wave).max())
        if left <= _SMALL * float(abs(wave).max()) or harmonics >= _MOST * problem.period_multiple:
            return full[: harmonics + 1], left, float(abs(best.waveform(count) - wave).max())
        harmonics *= 2
