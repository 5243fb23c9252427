"""Contact changes inside a step, found on the Chebyshev interpolant of each contact argument."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import chebyshev

from continuation.timedomain.dormand_prince import NODES, TO_CHEBYSHEV

_SLACK = 1e-9  # of a step: a contact change that rounding puts just before the start still counts
_POINTS, _ORDERS = chebyshev.chebpts2(NODES), np.arange(NODES)
_TO_VALUES = chebyshev.chebvander(_POINTS, NODES - 1)
_DERIVE = np.vstack([chebyshev.chebder(np.eye(NODES)), np.zeros(NODES)])


def first_change(
    sampled: np.ndarray, breakpoints: Sequence[np.ndarray], modes: Sequence[int], negligible: float = 0.0
) -> tuple[bool, tuple[float, int, int] | None]:
    """Return the earliest instant at which a contact argument leaves the linear piece it is in.

    All crossings on the step are looked at, so that an argument that leaves its piece and comes back is seen.

    Parameters
    ----------
    sampled : ndarray (m, NODES)
        Contact arguments at the Chebyshev points of the step.
    breakpoints : sequence of ndarray
        Of every contact.
    modes : sequence of int
        Index of the linear piece of every contact during the step.
    negligible : float
        An argument that stays this close to a breakpoint during the whole step does not change its piece.

    Returns
    -------
    resolved : bool
        Whether the interpolants are accurate; when not, the step is too long.
    change : (fraction of the step, contact index, direction) or None

    Examples
    --------
    >>> from continuation.timedomain.dormand_prince import NODES
    >>> fractions = (chebyshev.chebpts2(NODES) + 1) / 2
    >>> resolved, change = first_change(0.9 + 0.8 * (fractions - fractions**2)[None], [np.array([1.0])], [0])
    >>> resolved, round(change[0], 6), change[1:]            # 0.8 s (1 - s) = 0.1
    (True, 0.146447, (0, 1))
    """
    found = []
    for i, (values, j) in enumerate(zip(sampled, modes, strict=True)):
        series = TO_CHEBYSHEV @ values
        spread = abs(series[1:]).sum()
        for direction, k in ((1, j), (-1, j - 1)):
            if not 0 <= k < len(breakpoints[i]) or direction * (breakpoints[i][k] - series[0]) > spread:
                continue  # the interpolant is bounded by the sum of its coefficients and stays inside
            if abs(values - breakpoints[i][k]).max() <= negligible:
                continue
            if abs(series[-2:]).max() > 1e-6 * (1 + abs(series[0])):
                return False, None
            crossings = _crossings(series, breakpoints[i][k], direction)
            if not crossings and np.all(direction * (values - breakpoints[i][k]) > 0):
                crossings = [0.0]  # it only touched the piece that it was taken for: outside all along the step
            found += [(r, i, direction) for r in crossings]
    return True, min(found) if found else None


def _crossings(series: np.ndarray, level: float, direction: int) -> list[float]:
    """Return where in [0, 1] a Chebyshev series on the step passes the level in the given direction."""
    shifted = series.copy()
    shifted[0] -= level
    slope = _DERIVE @ shifted
    if abs(slope[0]) > abs(slope[1:]).sum():  # monotonic
        return _one_crossing(shifted, slope) if slope[0] * direction > 0 else []
    shifted = chebyshev.chebtrim(shifted, 1e-16 * abs(shifted).max())
    if len(shifted) < 2:
        return []
    roots = chebyshev.chebroots(shifted)
    real = roots.real[(abs(roots.imag) < 1e-10) & (abs(roots.real) <= 1 + 2 * _SLACK)]
    slopes = chebyshev.chebval(real, chebyshev.chebder(shifted))
    return [float(r + 1) / 2 for r, s in zip(real, slopes, strict=True) if s * direction > 0 and r <= 1]


def _one_crossing(shifted: np.ndarray, slope: np.ndarray) -> list[float]:
    """Return the root in [0, 1] of a monotonic series, by Newton's method kept between the neighbouring points."""
    values = _TO_VALUES @ shifted
    sign = np.sign(slope[0])
    if sign * values[-1] < 0:
        return []
    if sign * values[0] >= 0:  # rounding put it just before the start
        return [0.0]
    i = int(np.argmax(sign * values >= 0))
    low, high = _POINTS[i - 1], _POINTS[i]
    r = low + (high - low) * values[i - 1] / (values[i - 1] - values[i])
    for _ in range(6):
        waves = np.cos(_ORDERS * np.arccos(r))
        step = float(shifted @ waves) / float(slope @ waves)
        r = min(max(r - step, low), high)
        if abs(step) < 1e-12:
            break
    return [float(r + 1) / 2]
