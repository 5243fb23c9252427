"""Mesh stiffness and transmission error over the mesh phase as Fourier series, equations (16) and (17)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

_MARGIN = 1e-12  # accuracy of a minimum over the largest coefficient; a stiffness this close to zero counts as zero


def fourier_series(cosine: ArrayLike, sine: ArrayLike, theta: ArrayLike, derivative: int = 0) -> np.ndarray:
    """Evaluate ``sum_j c_j cos(j theta) + s_j sin(j theta)`` or a derivative of it, without a constant term.

    Parameters
    ----------
    cosine, sine : array_like, shape (N,)
        Coefficients of the harmonics 1 to N.
    theta : array_like
        Mesh phase in radians, any shape.
    derivative : int
        Order of the derivative with respect to theta.

    Returns
    -------
    numpy.ndarray
        Values in the unit of the coefficients, shape of theta.

    Examples
    --------
    >>> fourier_series([0.3, 0.1], [0.0, 0.0], [0.0]).tolist()
    [0.4]
    """
    angle = np.asarray(theta, dtype=float)
    c, s = np.asarray(cosine, dtype=float), np.asarray(sine, dtype=float)
    j = np.arange(1, c.size + 1)
    # The n-th derivative turns each harmonic by n quarter periods and multiplies it with j^n.
    amplitude = (c - 1j * s) * (1j * j) ** derivative
    return np.real(np.exp(1j * angle[..., None] * j) @ amplitude)


def stiffness_minimum(cosine: Sequence[float], sine: Sequence[float]) -> tuple[float, float]:
    """Return the smallest value of ``K = 1 + sum a_j cos(j theta) + b_j sin(j theta)`` and the phase it occurs at.

    Parameters
    ----------
    cosine, sine : sequence of float, equal lengths N
        a_j and b_j over k_0.

    Returns
    -------
    tuple of (float, float)
        Minimum (dimensionless) and its phase in radians, 0 <= phase < 2 pi.

    Notes
    -----
    Branch and bound from 16 intervals per harmonic: on an interval of half-width w about a point,
    ``K >= K_c - |K_c'| w - B w^2/2`` with ``B = sum j^2 |c_j|``, so that no dip between grid points is missed.
    The minimum is good to 1e-12 of the largest coefficient; a series so flat that this would take more than two
    million evaluations returns the bound reached by then, which lies below the minimum.

    Examples
    --------
    >>> low, phase = stiffness_minimum([0.125, 0.03125], [0.0, 0.0])
    >>> round(low, 9), round(phase, 3)
    (0.90625, 3.142)
    """
    a, b = np.asarray(cosine, dtype=float), np.asarray(sine, dtype=float)
    scale = float(np.max(np.abs([a, b]), initial=0.0))
    if scale == 0.0:
        return 1.0, 0.0
    a, b = a / scale, b / scale
    bound = float(np.sum(np.arange(1, a.size + 1) ** 2 * np.hypot(a, b)))
    count = max(64, 16 * a.size)
    width = np.pi / count
    centres = 2 * width * np.arange(count)
    best, phase = np.inf, 0.0
    while True:
        values = fourier_series(a, b, centres)
        slopes = fourier_series(a, b, centres, derivative=1)
        i = int(np.argmin(values))
        if values[i] < best:
            best, phase = float(values[i]), float(centres[i])
        lower = values - np.abs(slopes) * width - bound * width**2 / 2
        keep = lower < best - _MARGIN
        if keep.any() and 2 * int(keep.sum()) * a.size > 2_000_000:
            best, keep = float(lower.min()), np.zeros_like(keep)
        if not keep.any():
            return 1.0 + scale * best, phase % (2 * np.pi)
        width /= 2
        centres = np.concatenate([centres[keep] - width, centres[keep] + width])


def stiffness_fault(cosine: Sequence[float], sine: Sequence[float]) -> str | None:
    """Return the sentence fragment that says where K reaches zero or below, or None when it stays positive.

    Examples
    --------
    >>> stiffness_fault([1.25], [0.0])
    'makes the mesh stiffness reach -0.25 of its mean at mesh phase 3.1416 rad'
    >>> stiffness_fault([0.25], [0.0]) is None
    True
    """
    low, phase = stiffness_minimum(cosine, sine)
    if low > _MARGIN * (1.0 + float(np.max(np.abs([cosine, sine]), initial=0.0))):
        return None
    return f"makes the mesh stiffness reach {low:.4g} of its mean at mesh phase {phase:.4f} rad"


def peak_to_peak(cosine: Sequence[float], sine: Sequence[float]) -> float:
    """Return maximum minus minimum of a Fourier series, in the unit of its coefficients.

    Examples
    --------
    >>> round(peak_to_peak([0.125, 0.03125], [0.0, 0.0]), 12)
    0.25
    """
    low, _ = stiffness_minimum(cosine, sine)
    high, _ = stiffness_minimum([-c for c in cosine], [-s for s in sine])
    return (1.0 - high) + (1.0 - low)
