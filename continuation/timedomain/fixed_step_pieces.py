"""What the virtual march keeps of a period: samples, times in contact modes, and statistics."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from continuation.timedomain.fixed_step_driver import SLACK
from continuation.timedomain.fixed_step_machine import March
from continuation.timedomain.kernels import Kernel

WIDE = 64
"""Points observed in one call."""

Law = Callable[[tuple[int, ...]], tuple[np.ndarray, np.ndarray]]
"""Slopes and intercepts (m,) of the contacts in a mode."""


class Piece(NamedTuple):
    """Hold consecutive accepted steps of equal length in one mode.

    Attributes
    ----------
    phase, length : float
        Where they begin, and the length of a step in time.
    first, after : ndarray (R,), (k, R)
        Points at which the first begins, and after each: state, its derivative, contact arguments and their rates.
    mode : tuple of int
    """

    phase: float
    length: float
    first: np.ndarray
    after: np.ndarray
    mode: tuple[int, ...]

    def phases(self, turn: float) -> np.ndarray:
        """Return the phases at which the steps begin, (k,)."""
        return self.phase + self.length * turn * np.arange(len(self.after))


Attempt = Callable[[March, np.ndarray, float, float, tuple[int, ...]], np.ndarray]
"""March, point, phase, length, mode to the point after that step."""


def keep_samples(m: March, period: int, pieces: list[Piece], attempt: Attempt) -> None:
    """Fill in the states at the chosen phases of a period, by shorter steps where they are no points of the grid."""
    assert m.samples is not None
    n, slack = m.samples.shape[2], SLACK * m.h * m.turn
    starts = np.concatenate([piece.phases(m.turn) for piece in pieces])
    points = np.concatenate([np.concatenate([piece.first[None], piece.after[:-1]]) for piece in pieces])
    modes = np.repeat(np.arange(len(pieces)), [len(piece.after) for piece in pieces])
    at = np.searchsorted(starts, m.phases + slack, side="right") - 1
    ahead = m.phases - starts[at]
    m.samples[period] = points[at, :n]
    for row in np.flatnonzero(ahead > slack).tolist():
        j = int(at[row])
        mode = pieces[modes[j]].mode
        m.samples[period, row] = attempt(m, points[j], float(starts[j]), float(ahead[row]) / m.turn, mode)[:n]


def keep_times(m: March, pieces: list[Piece], first: np.ndarray) -> None:
    """Add the times spent in every linear piece of the contacts, which begin at the places ``first``."""
    assert m.dwell is not None
    times = dict[tuple[int, ...], float]()
    for piece in pieces:
        times[piece.mode] = times.get(piece.mode, 0.0) + piece.length * len(piece.after)
    for mode, time in times.items():
        m.dwell[first + mode] += time


def keep_statistics(m: March, period: int, pieces: list[Piece], law: Law, observe: Kernel) -> None:
    """Integrate by the trapezoidal rule with end correction, of 4th order; seek extremes between steps."""
    assert m.statistics is not None
    n = m.strobe.shape[1]
    laws = [np.repeat(np.array(law(piece.mode))[:, :, None], len(piece.after), axis=2) for piece in pieces]
    slopes, intercepts = np.concatenate(laws, axis=2)
    h = np.concatenate([np.full(len(piece.after), piece.length) for piece in pieces])
    begin = np.concatenate([piece.phases(m.turn) for piece in pieces])
    before = np.concatenate([np.concatenate([piece.first[None], piece.after[:-1]]) for piece in pieces])
    after = np.concatenate([piece.after for piece in pieces])
    sides = [
        _observed(observe, points[:, :n].T, points[:, n : 2 * n].T, phases, m.p, slopes, intercepts)
        for points, phases in ((before, begin), (after, begin + h * m.turn))
    ]
    (a, da), (b, db) = ((y - m.centre[:, None], dy) for y, dy in sides)
    out = m.statistics[period]
    out[:, 0] = (h / 2 * (a + b + h / 6 * (da - db))).sum(axis=1)
    out[:, 1] = (h / 2 * (a * a + b * b + h / 3 * (a * da - b * db))).sum(axis=1)
    extremes = _between(a, h * da, b, h * db)
    out[:, 2] = np.fmin(np.fmin.reduce(extremes, axis=(0, 2)), b.min(axis=1))  # there may be no extremum in a step
    out[:, 3] = np.fmax(np.fmax.reduce(extremes, axis=(0, 2)), b.max(axis=1))


def _observed(
    observe: Kernel, x: np.ndarray, k: np.ndarray, phases: np.ndarray, p: np.ndarray, s: np.ndarray, c: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    count, results = x.shape[1], []
    for j in range(0, count, WIDE):
        take = np.minimum(np.arange(j, j + WIDE), count - 1)
        results.append(observe(x[:, take], k[:, take], phases[None, take], p, s[:, take], c[:, take]))
    y, dy = (np.hstack([r[i] for r in results])[:, :count] for i in range(2))
    return y, dy


def _between(a: np.ndarray, da: np.ndarray, b: np.ndarray, db: np.ndarray) -> np.ndarray:
    """Return the values at the extrema of the cubics inside their steps, (2, o, k), NaN where there are none."""
    q, s = 3 * (b - a) - 2 * da - db, 3 * (2 * (a - b) + da + db)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(da * db < 0, q * q - s * da, np.nan))
        w = np.where(q < 0, -q + root, -q - root)
        t = np.stack([w / s, da / w])
        t = np.where((t > 0) & (t < 1), t, np.nan)
    return a + t * (da + t * (q + t * s / 3))
