"""Largest Lyapunov exponent from a scalar time series, by the methods of Rosenstein and of Kantz."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

_PARTS = 8  # of the series, for the standard error
_LEAST = 200  # delay vectors
_SATURATION = 0.7  # of the rise of the curve, at most, belongs to the straight part
_BUNCH = 4096  # reference points handled at once, to bound the memory


@dataclass(frozen=True, slots=True)
class Rosenstein:
    """Follow the nearest neighbour of every point (Rosenstein, Collins, De Luca, Physica D 65 (1993) 117-134)."""


@dataclass(frozen=True, slots=True)
class Kantz:
    """Follow all neighbours within a radius (Kantz, Physics Letters A 185 (1994) 77-87).

    Parameters
    ----------
    radius : float
        Distance of delay vectors (maximum norm) over the standard deviation of the series. The mean distance favours
        neighbours that part fast: with large radii the exponent comes out too large by more than its error.
    neighbours : int
        Points with fewer neighbours are left out.

    Raises
    ------
    ValueError
        If one of them is not positive.
    """

    radius: float = 0.02
    neighbours: int = 1

    def __post_init__(self) -> None:
        if not (self.radius > 0 and self.neighbours >= 1):
            raise ValueError(f"Kantz: radius and neighbours must be positive, got {self.radius} and {self.neighbours}")


@dataclass(frozen=True, slots=True, eq=False)
class SeriesExponent:
    """Hold an exponent fitted to the mean logarithmic divergence of neighbours.

    Attributes
    ----------
    value : float
        Slope of the straight part, per unit of time.
    error : float
        Standard error from parts of the series, with half the range of the slopes in windows of half the fit: a curve
        that is not straight has a large one.
    times : ndarray (k,)
        Times after which the distance was measured.
    divergence : ndarray (k,)
        Mean logarithm of the distance there.
    fit : tuple of float
        Times between which the slope was taken.
    """

    value: float
    error: float
    times: np.ndarray
    divergence: np.ndarray
    fit: tuple[float, float]


def series_exponent(
    series: Sequence[float] | np.ndarray,
    interval: float,
    *,
    dimension: int,
    delay: int,
    window: int,
    horizon: int,
    method: Rosenstein | Kantz | None = None,
    fit: tuple[float, float] | None = None,
) -> SeriesExponent:
    """Estimate the largest Lyapunov exponent from one measured quantity.

    Parameters
    ----------
    series : array (N,)
        Equidistant samples.
    interval : float
        Time between samples; the unit of the result is one over its unit.
    dimension, delay : int
        Number of components of a delay vector, and samples between them.
    window : int
        Neighbours closer in time than so many samples are not counted (Theiler); about one mean period.
    horizon : int
        Samples over which neighbours are followed.
    method : Rosenstein or Kantz, optional
        ``Rosenstein()`` when absent.
    fit : (float, float), optional
        Times between which the curve is straight. When absent: from the length of the delay vector, within which the
        neighbours turn into the most unstable direction, to where 0.7 of the rise to saturation is reached. Look at
        the curve: a number exists for any series, a straight part only for some.

    Raises
    ------
    ValueError
        If the series is too short, constant or not finite, or a number is out of range.

    Notes
    -----
    The spectrum of :func:`~continuation.timedomain.lyapunov.lyapunov_spectrum` needs the model and is far more
    accurate; this is for measured data and for comparison with published values obtained so.

    Examples
    --------
    >>> x = [0.3]
    >>> for _ in range(3000):
    ...     x.append(4 * x[-1] * (1 - x[-1]))                                    # exponent ln 2
    >>> found = series_exponent(x, 1.0, dimension=1, delay=1, window=1, horizon=8, fit=(0, 5))
    >>> bool(abs(found.value - np.log(2)) < 3 * found.error < 0.3)
    True
    """
    x = np.array(series, dtype=float).ravel()
    count = len(x) - (dimension - 1) * delay - horizon
    _check(x, count, interval, dimension, delay, window, horizon)
    vectors = np.column_stack([x[i * delay : i * delay + count] for i in range(dimension)])
    chosen = Rosenstein() if method is None else method
    follow = _rosenstein if isinstance(chosen, Rosenstein) else _kantz
    curves, weights = follow(x, vectors, (dimension - 1) * delay, window, horizon, chosen)
    if weights.sum() < _LEAST:
        raise ValueError(
            f"series_exponent: only {int(weights.sum())} points have neighbours; expected {_LEAST}: a longer series, "
            "a smaller window or a larger radius is needed"
        )
    divergence = np.average(curves, axis=0, weights=weights)
    times = interval * np.arange(horizon + 1)
    low, high = _straight(divergence, (dimension - 1) * delay) if fit is None else _between(times, fit)
    value = _slope(times, divergence, low, high)
    parts = [_slope(times, c, low, high) for c, w in zip(curves, weights, strict=True) if w > 0]
    half = (high - low + 1) // 2
    pieces = [_slope(times, divergence, j, j + half) for j in range(low, high - half + 1)]
    error = float(np.hypot(np.std(parts, ddof=1) / np.sqrt(len(parts)), np.ptp(pieces) / 2))
    return SeriesExponent(value, error, times, divergence, (float(times[low]), float(times[high])))


def _check(x: np.ndarray, count: int, interval: float, dimension: int, delay: int, window: int, horizon: int) -> None:
    if min(dimension, delay, window, horizon - 3) < 1 or not interval > 0:
        raise ValueError("series_exponent: dimension, delay, window and interval must be positive, horizon 4 or more")
    if not np.all(np.isfinite(x)) or len(x) == 0 or np.ptp(x) == 0:
        raise ValueError("series_exponent: the series must be finite and not constant")
    if count < max(_LEAST, 4 * window):
        raise ValueError(
            f"series_exponent: {len(x)} samples leave {max(count, 0)} delay vectors; expected {max(_LEAST, 4 * window)}"
        )


def _rosenstein(
    x: np.ndarray, vectors: np.ndarray, last: int, window: int, horizon: int, method: Rosenstein | Kantz
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean log distances (parts, horizon + 1) of nearest neighbours, and how many pairs each part has."""
    count, tree = len(vectors), cKDTree(vectors)
    neighbour, wanted = np.full(count, -1), 2
    while (left := np.flatnonzero(neighbour < 0)).size and wanted < 2 * count:
        wanted = min(2 * wanted, count)  # until one is far enough in time
        _, found = tree.query(vectors[left], k=wanted)
        far = abs(found - left[:, None]) > window
        hit = far.any(axis=1)
        neighbour[left[hit]] = found[hit, far[hit].argmax(axis=1)]
        if wanted == count:
            break
    i = np.flatnonzero(neighbour >= 0)
    steps = np.arange(horizon + 1)
    distance = abs(vectors_after(x, i, last, steps) - vectors_after(x, neighbour[i], last, steps))
    return _in_parts(np.log(np.where(distance > 0, distance, np.nan)), i, count)


def vectors_after(x: np.ndarray, at: np.ndarray, last: int, steps: np.ndarray) -> np.ndarray:
    """Return the newest component of delay vectors after so many steps, shape (len(at), len(steps)).

    >>> vectors_after(np.arange(10.0), np.array([0, 3]), 2, np.array([0, 1])).tolist()
    [[2.0, 3.0], [5.0, 6.0]]
    """
    return x[at[:, None] + last + steps]


def _kantz(
    x: np.ndarray, vectors: np.ndarray, last: int, window: int, horizon: int, method: Rosenstein | Kantz
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean log of mean distances of all neighbours, and how many points each part has."""
    assert isinstance(method, Kantz)
    tree, steps = cKDTree(vectors), np.arange(horizon + 1)
    rows, at = [], []
    for first in range(0, len(vectors), _BUNCH):
        bunch = range(first, min(first + _BUNCH, len(vectors)))
        found = tree.query_ball_point(vectors[first : bunch.stop], method.radius * x.std(), p=np.inf)
        for i, candidates in zip(bunch, found, strict=True):
            near = np.array(candidates)
            near = near[abs(near - i) > window]
            if len(near) >= method.neighbours:
                here = vectors_after(x, np.array([i]), last, steps)
                rows.append(abs(vectors_after(x, near, last, steps) - here).mean(axis=0))
                at.append(i)
    distance = np.array(rows).reshape(-1, horizon + 1)
    logarithms = np.log(np.where(distance > 0, distance, np.nan))
    return _in_parts(logarithms, np.array(at, dtype=int), len(vectors))


def _in_parts(logarithms: np.ndarray, at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of every eighth of the series; identical points, whose logarithm is missing, are left out."""
    part = at * _PARTS // count
    means = np.zeros((_PARTS, logarithms.shape[1]))
    weights = np.zeros(_PARTS)
    for j in range(_PARTS):
        rows = logarithms[part == j]
        if len(rows) and np.isfinite(rows).any(axis=0).all():
            means[j], weights[j] = np.nanmean(rows, axis=0), len(rows)
    return means, weights


def _straight(divergence: np.ndarray, last: int) -> tuple[int, int]:
    """Return first and last index of the straight part: after the transient, before saturation."""
    low = min(max(last, 1), len(divergence) - 4)
    level = divergence[-max(len(divergence) // 4, 1) :].mean()
    limit = divergence[low] + _SATURATION * (level - divergence[low])
    above = np.flatnonzero(divergence[low:] > limit) if level > divergence[low] else np.empty(0)
    high = low + int(above[0]) if len(above) else len(divergence) - 1
    return low, max(high, low + 3)


def _between(times: np.ndarray, fit: tuple[float, float]) -> tuple[int, int]:
    low, high = (int(np.abs(times - t).argmin()) for t in fit)
    if high < low + 3:
        raise ValueError(
            f"series_exponent: fit needs 4 or more samples, got {fit} with {times[1] - times[0]:g} between"
        )
    return low, high


def _slope(times: np.ndarray, curve: np.ndarray, low: int, high: int) -> float:
    return float(np.polynomial.polynomial.polyfit(times[low : high + 1], curve[low : high + 1], 1)[1])
