"""Where a gap closes during a step, from the cubic through its values and rates at both ends."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

MOST = 64
"""Contact changes in one interval of the grid beyond which a march gives up."""

_NEWTON = 3


def may_close(g: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return whether the gap may close in each of several steps, by a bound of the cubic from below.

    Parameters
    ----------
    g, d : ndarray (k + 1,)
        Gap and its rate times the step at the ends of k steps.

    Examples
    --------
    >>> may_close(np.array([1.0, 0.5, -0.1]), np.array([0.0, -0.5, -0.6])).tolist()
    [False, True]
    """
    lowest = np.minimum(g[:-1], g[1:]) - 4 / 27 * (np.maximum(-d[:-1], 0) + np.maximum(d[1:], 0))
    return ~(lowest > 0)


def closing(g0: float, d0: float, g1: float, d1: float) -> float:
    """Return the first instant in [0, 1] at which a gap that begins open, or at 0, closes; 2 when it stays open.

    Parameters
    ----------
    g0, g1 : float
        Gap at the beginning and at the end of the step.
    d0, d1 : float
        Its rates there times the step.

    Examples
    --------
    >>> closing(1.0, -2.0, -1.0, -2.0)
    0.5
    >>> round(closing(0.1, -1.0, 0.1, 1.0), 6)           # closes and opens again within the step: 0.1 - t + t^2
    0.112702
    >>> closing(0.0, 1.0, 1.0, 1.0)
    2.0
    """
    if min(g0, g1) - 4 / 27 * (max(-d0, 0.0) + max(d1, 0.0)) > 0:
        return 2.0
    times = [0.0, *_extrema(g0, d0, g1, d1), 1.0]
    values = [g0, *(_hermite(g0, d0, g1, d1, t) for t in times[1:-1]), g1]
    for i, (left, right) in enumerate(pairwise(values)):
        if right < 0:
            return times[i] if not left > 0 else _root(g0, d0, g1, d1, times[i], times[i + 1])
    return 2.0


def _root(g0: float, d0: float, g1: float, d1: float, low: float, high: float) -> float:
    """Return where a falling piece of the cubic meets zero, by Newton's method inside a bracket."""
    q, s, t = 3 * (g1 - g0) - 2 * d0 - d1, 2 * (g0 - g1) + d0 + d1, (low + high) / 2
    for _ in range(60):
        value, slope = _hermite(g0, d0, g1, d1, t), d0 + t * (2 * q + 3 * s * t)
        if value > 0:
            low = t
        else:
            high = t
        before, t = t, t - value / slope if slope < 0 else low
        if not low <= t <= high:
            t = (low + high) / 2
        if abs(t - before) < 1e-15:
            break
    return t


def _hermite(g0: float, d0: float, g1: float, d1: float, t: float) -> float:
    return g0 + t * (d0 + t * (3 * (g1 - g0) - 2 * d0 - d1 + t * (2 * (g0 - g1) + d0 + d1)))


def _extrema(g0: float, d0: float, g1: float, d1: float) -> list[float]:
    q, s = 3 * (g1 - g0) - 2 * d0 - d1, 3 * (2 * (g0 - g1) + d0 + d1)
    root = q * q - s * d0
    if not root > 0:
        return []
    w = -q + math.sqrt(root) if q < 0 else -q - math.sqrt(root)
    instants = ([w / s] if s else []) + ([d0 / w] if w else [])
    return sorted(t for t in instants if 0 < t < 1)


def newton_shift(miss: float, rate: float, direction: int, length: float, left: float, h: float, trial: int) -> float:
    """Return by how much to shorten the step that is to end on a corner; 0 when it is good or can't be improved.

    At a grazing contact the rate vanishes; an instant missed by d then costs d times the miss, which is nothing.

    Parameters
    ----------
    miss, rate : float
        Contact argument minus breakpoint at the end of the step, and its rate.
    direction : int
        +1 when the argument is to increase through the breakpoint, else -1.
    length, left, h : float
        The step, what is left of the interval of the grid, and that interval.
    trial : int
        Steps taken so far.
    """
    if trial == _NEWTON or not rate * direction > 0:
        return 0.0
    shift = miss / rate
    bad = not abs(shift) > 1e-12 * h or abs(shift) > 0.1 * left or not length - shift > 0
    return 0.0 if bad else shift
