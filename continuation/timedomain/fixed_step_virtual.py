"""The fixed-step march without a compiler: many steps at a time in CasADi's virtual machine, contact changes in Python.

The same method as the C of :mod:`~continuation.timedomain.fixed_step_driver`, with results equal but for rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np

from continuation.timedomain import fixed_step_calls as calls
from continuation.timedomain import fixed_step_driver as driver
from continuation.timedomain.fixed_step_corners import MOST, closing, may_close, newton_shift
from continuation.timedomain.fixed_step_functions import ModeModel, StepFunctions
from continuation.timedomain.fixed_step_machine import March
from continuation.timedomain.kernels import Kernel

_CHUNKS = (256, 192, 128, 96, 64, 48, 32, 24, 16, 8, 4, 2, 1)  # steps taken in one call
_LATER = 3  # intervals by which a contact change may come later than in the period before and still be in its call
_WIDE = 64  # points observed in one call


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """Hold state, its derivative, contact arguments and their rates at one instant, or at several as columns."""

    x: np.ndarray
    k: np.ndarray
    a: np.ndarray
    r: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Hold consecutive accepted steps of equal length in one mode: where they begin, and the points after each."""

    phase: float
    length: float
    first: _Point
    after: _Point
    mode: tuple[int, ...]

    @property
    def count(self) -> int:
        return self.after.x.shape[1]

    def begin(self, j: int) -> _Point:
        """Return the point at which one of the steps begins."""
        return self.first if j == 0 else _columns(self.after, j - 1)


class VirtualMarch:
    """March in CasADi's virtual machine; arguments and results as those of MachineMarch."""

    def __init__(self, model: ModeModel, functions: StepFunctions) -> None:
        self._laws = model.laws
        self._points = len(functions.fractions)
        self._grid = calls.grid(functions)
        self._begin, self._step = Kernel(calls.begin(functions)), Kernel(calls.attempt(functions))
        self._one, self._steps = functions.step, dict[int, Kernel]()
        self._observe = Kernel(calls.side_by_side(functions.observe, _WIDE))
        self._lock = Lock()  # the buffers of the kernels are shared

    def tabulate(self, p: np.ndarray, width: float, steps: int) -> np.ndarray:
        """Return all that depends on parameters and phase alone, at the stages of every step of a period."""
        values = self._grid(width * np.arange(steps)[None], width, p).full()
        count = len(values)
        return values.reshape(count, steps, self._points).transpose(1, 2, 0).reshape(steps, count * self._points)

    def march(self, m: March, table: np.ndarray) -> int:
        """March; returns one of the codes of the driver. Threads wait for each other."""
        with self._lock:
            return self._march(m, np.ascontiguousarray(table.reshape(m.steps * self._points, -1).T))

    def _march(self, m: March, columns: np.ndarray) -> int:
        mode, changes = m.mode.tolist(), list[tuple[float, ...]]()
        point, expected = self._start(m.x, 0.0, m.p, mode), np.empty(0)
        for period in range(m.periods):
            pieces: list[_Piece] = []
            m.failed_period, known = period, len(changes)
            flag, point = self._one_period(m, point, mode, columns, pieces, changes, expected)
            if flag != driver.OK:
                return flag
            expected = np.array([row[1] for row in changes[known:]]) // (m.h * m.turn)
            self._keep(m, period, pieces)
            m.x, m.count = point.x, len(changes)
            m.mode[:] = mode
            if m.changes is not None and m.count > len(m.changes):
                return driver.FULL
        if m.changes is not None and changes:
            m.changes[: m.count] = changes
        return driver.OK

    def _one_period(
        self,
        m: March,
        point: _Point,
        mode: list[int],
        columns: np.ndarray,
        pieces: list[_Piece],
        changes: list,
        expected: np.ndarray,
    ) -> tuple[int, _Point]:
        """March over one period; steps behind a contact change are for nothing, so calls end where one is expected."""
        j, width = 0, m.h * m.turn
        while j < m.steps:
            after = self._ahead(m, point, mode, columns, j, next((e for e in expected if e >= j), m.steps) - j + _LATER)
            good, count = self._until_change(m, point, after, mode), after.a.shape[1]
            if good:
                piece = _Piece(j * width, m.h, point, _columns(after, slice(good)), tuple(mode))
                pieces.append(piece)
                point = _columns(after, good - 1)
                if not np.all(np.isfinite(point.x)):
                    m.failed_phase = (j + int(np.all(np.isfinite(piece.after.x), axis=0).argmin())) * width
                    return driver.NOT_FINITE, point
                j += good
            if good < count:
                m.failed_phase = j * width
                flag, point = self._cross(m, point, mode, j * width, (j + 1) * width, pieces, changes)
                if flag != driver.OK:
                    return flag, point
                j += 1
        return driver.OK, point

    def _ahead(self, m: March, point: _Point, mode: list[int], columns: np.ndarray, j: int, wanted: float) -> _Point:
        """Return the points after steps in the present mode, about as many as wanted, as columns."""
        possible = [c for c in _CHUNKS if c <= m.steps - j]
        count = min((c for c in possible if c >= wanted), default=possible[0])
        if count not in self._steps:
            self._steps[count] = Kernel(calls.repeated(self._one, count))
        forces = columns[:, j * self._points : (j + count) * self._points]
        results = self._steps[count](point.x, point.k, m.h, forces, *self._law(mode))
        return _Point(*(v.reshape(len(u), count) for u, v in zip(_rows(point), results, strict=True)))

    def _until_change(self, m: March, point: _Point, after: _Point, mode: list[int]) -> int:
        """Return the number of steps before the first in which a contact leaves its piece."""
        first = after.a.shape[1]
        for i, (breakpoints, _, _) in enumerate(self._laws):
            a = np.concatenate([point.a[i : i + 1], after.a[i]])
            r = m.h * np.concatenate([point.r[i : i + 1], after.r[i]])
            for side, b in self._borders(breakpoints, mode[i]):
                g, d = side * (b - a), -side * r
                for q in np.flatnonzero(may_close(g, d)[:first]):
                    if closing(*(float(v) for v in (g[q], d[q], g[q + 1], d[q + 1]))) <= 1:
                        first = int(q)
                        break
        return first

    def _borders(self, breakpoints: tuple[float, ...], j: int) -> list[tuple[int, float]]:
        below = [(-1, breakpoints[j - 1])] if j > 0 else []
        return below + ([(1, breakpoints[j])] if j < len(breakpoints) else [])

    def _cross(
        self, m: March, u: _Point, mode: list[int], phase: float, end: float, pieces: list[_Piece], changes: list
    ) -> tuple[int, _Point]:
        """Cross one interval of the grid, in pieces where contacts change."""
        left = m.h
        for _ in range(MOST):
            v = self._attempt(m, u, phase, left, mode)
            t, which, side = self._leaving(u, v, left, mode)
            if t > 1:
                pieces.append(_piece(phase, left, u, v, mode))
                return (driver.OK if np.all(np.isfinite(v.x)) else driver.NOT_FINITE), v
            if t > 0:
                length, v = self._land(m, u, phase, t * left, left, which, side, mode)
                pieces.append(_piece(phase, length, u, v, mode))
                u, left, phase = v, left - length, phase + length * m.turn
            changes.append((m.failed_period, phase, which, side, *u.x))
            mode[which] += side
            u = self._start(u.x, phase, m.p, mode)
            if not left > 0:
                return driver.OK, u
        return driver.CHATTER, u

    def _leaving(self, u: _Point, v: _Point, h: float, mode: list[int]) -> tuple[float, int, int]:
        found = [
            (closing(side * (b - u.a[i]), -side * h * u.r[i], side * (b - v.a[i]), -side * h * v.r[i]), i, side)
            for i, (breakpoints, _, _) in enumerate(self._laws)
            for side, b in self._borders(breakpoints, mode[i])
        ]
        return min(found, key=lambda row: row[0])

    def _land(
        self, m: March, u: _Point, phase: float, length: float, left: float, i: int, side: int, mode: list[int]
    ) -> tuple[float, _Point]:
        target = self._laws[i][0][mode[i] if side > 0 else mode[i] - 1]
        for trial in range(MOST):
            v = self._attempt(m, u, phase, length, mode)
            shift = newton_shift(v.a[i] - target, v.r[i], side, length, left, m.h, trial)
            if shift == 0.0:
                break
            length = min(length - shift, left)
        return length, v

    def _law(self, mode: list[int] | tuple[int, ...]) -> tuple[list[float], list[float]]:
        slopes = [s[j] for (_, s, _), j in zip(self._laws, mode, strict=True)]
        return slopes, [c[j] for (_, _, c), j in zip(self._laws, mode, strict=True)]

    def _start(self, x: np.ndarray, phase: float, p: np.ndarray, mode: list[int]) -> _Point:
        return _Point(x, *self._begin(x, phase, p, *self._law(mode)))

    def _attempt(self, m: March, u: _Point, phase: float, h: float, mode: list[int] | tuple[int, ...]) -> _Point:
        return _Point(*self._step(u.x, u.k, phase, h, m.turn, m.p, *self._law(mode)))

    def _keep(self, m: March, period: int, pieces: list[_Piece]) -> None:
        """Fill the arrays of one period."""
        m.strobe[period] = pieces[-1].after.x[:, -1]
        if m.samples is not None:
            self._sample(m, period, pieces)
        if m.dwell is not None:
            first = np.cumsum([0, *(len(s) for _, s, _ in self._laws)])
            for piece in pieces:
                m.dwell[first[:-1] + piece.mode] += piece.length * piece.count
        if m.statistics is not None:
            self._account(m, period, pieces)

    def _sample(self, m: March, period: int, pieces: list[_Piece]) -> None:
        assert m.samples is not None
        starts = np.concatenate([_phases(piece, m.turn) for piece in pieces])
        sizes = np.cumsum([0, *(piece.count for piece in pieces)])
        for row, phase in zip(m.samples[period], m.phases, strict=True):
            at = int(np.searchsorted(starts, phase, side="right")) - 1
            which = int(np.searchsorted(sizes, at, side="right")) - 1
            u, ahead = pieces[which].begin(at - int(sizes[which])), phase - starts[at]
            row[:] = self._attempt(m, u, starts[at], ahead / m.turn, pieces[which].mode).x if ahead > 0 else u.x

    def _account(self, m: March, period: int, pieces: list[_Piece]) -> None:
        """Integrate by the trapezoidal rule with end correction, of 4th order; seek extremes between steps."""
        assert m.statistics is not None
        laws = [np.repeat(np.array(self._law(piece.mode))[:, :, None], piece.count, axis=2) for piece in pieces]
        slopes, intercepts = np.concatenate(laws, axis=2)
        h = np.concatenate([np.full(piece.count, piece.length) for piece in pieces])
        begin = np.concatenate([_phases(piece, m.turn) for piece in pieces])
        joined = [_joined(piece) for piece in pieces]
        sides = []
        for points, phases in (([u for u, _ in joined], begin), ([v for _, v in joined], begin + h * m.turn)):
            x, k = np.column_stack([u.x for u in points]), np.column_stack([u.k for u in points])
            sides.append(self._observed(x, k, phases, m.p, slopes, intercepts))
        (a, da), (b, db) = ((y - m.centre[:, None], dy) for y, dy in sides)
        out = m.statistics[period]
        out[:, 0] = (h / 2 * (a + b + h / 6 * (da - db))).sum(axis=1)
        out[:, 1] = (h / 2 * (a * a + b * b + h / 3 * (a * da - b * db))).sum(axis=1)
        extremes = _between(a, h * da, b, h * db)
        out[:, 2] = np.minimum(np.fmin.reduce(extremes, axis=(0, 2)), b.min(axis=1))
        out[:, 3] = np.maximum(np.fmax.reduce(extremes, axis=(0, 2)), b.max(axis=1))

    def _observed(
        self, x: np.ndarray, k: np.ndarray, phases: np.ndarray, p: np.ndarray, s: np.ndarray, c: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        wide, count = _WIDE, x.shape[1]
        results = []
        for j in range(0, count, wide):
            take = np.minimum(np.arange(j, j + wide), count - 1)
            results.append(self._observe(x[:, take], k[:, take], phases[None, take], p, s[:, take], c[:, take]))
        y, dy = (np.hstack([r[i] for r in results])[:, :count] for i in range(2))
        return y, dy


def _rows(point: _Point) -> tuple[np.ndarray, ...]:
    return point.x, point.k, point.a, point.r


def _columns(point: _Point, take: slice | int) -> _Point:
    return _Point(*(v[:, take] for v in _rows(point)))


def _joined(piece: _Piece) -> tuple[_Point, _Point]:
    """Return the beginnings and the ends of the steps of a piece as columns."""
    pairs = zip(_rows(piece.first), _rows(piece.after), strict=True)
    return _Point(*(np.column_stack([u, v[:, :-1]]) for u, v in pairs)), piece.after


def _phases(piece: _Piece, turn: float) -> np.ndarray:
    return piece.phase + piece.length * turn * np.arange(piece.count)


def _piece(phase: float, length: float, u: _Point, v: _Point, mode: list[int]) -> _Piece:
    return _Piece(phase, length, u, _Point(*(w[:, None] for w in _rows(v))), tuple(mode))


def _between(a: np.ndarray, da: np.ndarray, b: np.ndarray, db: np.ndarray) -> np.ndarray:
    """Return the values at the extrema of the cubics inside their steps, (2, o, k), NaN where there are none."""
    q, s = 3 * (b - a) - 2 * da - db, 3 * (2 * (a - b) + da + db)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(da * db < 0, q * q - s * da, np.nan))
        w = np.where(q < 0, -q + root, -q - root)
        t = np.stack([w / s, da / w])
        t = np.where((t > 0) & (t < 1), t, np.nan)
    return a + t * (da + t * (q + t * s / 3))
