"""The fixed-step march without a compiler: many steps in one call, contact changes in Python.

A model that is linear in its contact modes goes by products of step matrices, any other by CasADi's virtual machine.
The same method as the C of :mod:`~continuation.timedomain.fixed_step_driver`, with results equal but for rounding.
"""

from __future__ import annotations

import math
from threading import Lock

import numpy as np

from continuation.timedomain import fixed_step_calls as calls
from continuation.timedomain import fixed_step_driver as driver
from continuation.timedomain.fixed_step_corners import MOST, closing, may_close, newton_shift
from continuation.timedomain.fixed_step_functions import ModeModel, StepFunctions
from continuation.timedomain.fixed_step_machine import March
from continuation.timedomain.fixed_step_pieces import WIDE, Piece, keep_samples, keep_statistics, keep_times
from continuation.timedomain.fixed_step_products import BLOCK, EVERY, StepProducts, Table
from continuation.timedomain.kernels import Kernel

_CHUNKS = (256, 192, 128, 96, 64, 48, 32, 24, 16, 8, 4, 2, 1)  # steps taken in one call
_LATER = 3  # intervals by which a contact change may come later than in the period before and still be in its call

Mode = tuple[int, ...]


class VirtualMarch:
    """March without machine code; arguments and results as those of MachineMarch.

    A point is an array (R,) of state, its derivative, contact arguments and their rates.
    """

    def __init__(self, model: ModeModel, functions: StepFunctions) -> None:
        self._laws, self._n = model.laws, model.x.numel()
        self._points = len(functions.fractions)
        self._grid = calls.grid(functions)
        self._restart, self._step = Kernel(calls.restart(functions)), Kernel(calls.attempt(functions))
        self._one, self._steps = functions.step, dict[int, Kernel]()
        self._observe = Kernel(calls.side_by_side(functions.observe, WIDE))
        self._products, self._linear = StepProducts(model, functions.order), False
        self._tables: tuple[bytes, dict[tuple[int, ...], Table]] = (b"", {})
        self._first = np.cumsum([0, *(len(s) for _, s, _ in model.laws)])[:-1]
        self._borders = [[_borders(b, j) for j in range(len(s))] for b, s, _ in model.laws]
        self._known_laws: dict[Mode, tuple[np.ndarray, np.ndarray]] = {}
        self._lock = Lock()  # the buffers of the kernels are shared

    def tabulate(self, p: np.ndarray, width: float, steps: int) -> np.ndarray:
        """Return all that depends on parameters and phase alone, at the stages of every step of a period."""
        values = self._grid(width * np.arange(steps)[None], width, p).full()
        count = len(values)
        return values.reshape(count, steps, self._points).transpose(1, 2, 0).reshape(steps, count * self._points)

    def march(self, m: March, table: np.ndarray) -> int:
        """March; returns one of the codes of the driver. Threads wait for each other."""
        with self._lock, np.errstate(over="ignore", invalid="ignore"):  # leaving the finite numbers is reported
            return self._march(m, np.ascontiguousarray(table.reshape(m.steps * self._points, -1).T))

    def _march(self, m: March, columns: np.ndarray) -> int:
        changes = list[tuple[float, ...]]()
        self._linear, known = self._products.fits(m.steps), m.p.tobytes()
        if self._tables[0] != known:
            self._tables = (known, {})
        mode: Mode = tuple(m.mode.tolist())
        point, expected = self._start(m, m.x, 0.0, 0.0, mode)[0], list[int]()
        for period in range(m.periods):
            pieces: list[Piece] = []
            m.failed_period, before = period, len(changes)
            flag, point, mode = self._one_period(m, point, mode, columns, pieces, changes, expected)
            if flag != driver.OK:
                return flag
            expected = [int(row[1] // (m.h * m.turn)) for row in changes[before:]]
            self._keep(m, period, pieces)
            m.x, m.count = point[: self._n], len(changes)
            m.mode[:] = mode
            if m.changes is not None and m.count > len(m.changes):
                return driver.FULL
        if m.changes is not None and changes:
            m.changes[: m.count] = changes
        return driver.OK

    def _one_period(
        self,
        m: March,
        point: np.ndarray,
        mode: Mode,
        columns: np.ndarray,
        pieces: list[Piece],
        changes: list,
        expected: list[int],
    ) -> tuple[int, np.ndarray, Mode]:
        """March over one period; steps behind a contact change are for nothing, so calls end where one is expected."""
        j, width, n = 0, m.h * m.turn, self._n
        while j < m.steps:
            after = self._ahead(m, point, mode, columns, j, next((e for e in expected if e >= j), m.steps) - j + _LATER)
            good, count = self._until_change(m, point, after, mode), len(after)
            if good:
                piece = Piece(j * width, m.h, point, after[:good], mode)
                pieces.append(piece)
                point = after[good - 1]
                if not math.isfinite(sum(point[:n].tolist())):
                    m.failed_phase = (j + int(np.all(np.isfinite(piece.after[:, :n]), axis=1).argmin())) * width
                    return driver.NOT_FINITE, point, mode
                j += good
            if good < count:
                m.failed_phase = j * width
                flag, point, mode = self._cross(m, point, after[good], mode, j * width, pieces, changes)
                if flag != driver.OK:
                    return flag, point, mode
                j += 1
        return driver.OK, point, mode

    def _ahead(self, m: March, point: np.ndarray, mode: Mode, columns: np.ndarray, j: int, wanted: int) -> np.ndarray:
        """Return the points (k, R) after steps in the present mode, about as many as wanted."""
        if self._linear:
            if j % EVERY == 0:
                return self._product(m, point, mode, j)
            count = min(EVERY - j % EVERY, m.steps - j, wanted)
        else:
            possible = [c for c in _CHUNKS if c <= m.steps - j]
            count = min((c for c in possible if c >= wanted), default=possible[0])
        if count not in self._steps:
            self._steps[count] = Kernel(calls.repeated(self._one, count))
        forces = columns[:, j * self._points : (j + count) * self._points]
        return self._steps[count](point[: 2 * self._n], m.h, forces, *self._law(mode))[0].reshape(-1, count).T

    def _product(self, m: March, point: np.ndarray, mode: Mode, j: int) -> np.ndarray:
        """Return the points after up to 32 steps from the table."""
        tables, key = self._tables[1], (m.steps, *mode)
        if key not in tables:
            tables[key] = self._products.table(m.p, m.h, m.turn, m.steps, self._law(mode))
        matrices, constants = tables[key]
        after = matrices[j // EVERY] @ point[: self._n] + constants[j // EVERY]
        return after.reshape(BLOCK, -1)[: m.steps - j]

    def _until_change(self, m: March, point: np.ndarray, after: np.ndarray, mode: Mode) -> int:
        """Return the number of steps before the first in which a contact leaves its piece."""
        first, count = len(after), len(self._laws)
        for i in range(count):
            at = 2 * self._n + i
            a, r = after[:, at].tolist(), after[:, at + count].tolist()
            a.insert(0, float(point[at]))
            r.insert(0, float(point[at + count]))
            reach = 8 / 27 * m.h * max(max(r), -min(r))
            for side, b in self._borders[i][mode[i]]:
                if side * (b - (max(a) if side > 0 else min(a))) > reach:  # the cubics of all steps stay on this side
                    continue
                g, d = side * (b - np.array(a)), -side * m.h * np.array(r)
                for q in np.flatnonzero(may_close(g, d)[:first]):
                    if closing(*(float(v) for v in (g[q], d[q], g[q + 1], d[q + 1]))) <= 1:
                        first = int(q)
                        break
        return first

    def _cross(
        self, m: March, u: np.ndarray, v: np.ndarray, mode: Mode, phase: float, pieces: list[Piece], changes: list
    ) -> tuple[int, np.ndarray, Mode]:
        """Cross one interval of the grid, in pieces where contacts change; v is the point at its end without that."""
        left, n = m.h, self._n
        for _ in range(MOST):
            t, which, side = self._leaving(u, v, left, mode)
            if t > 1:
                pieces.append(Piece(phase, left, u, v[None], mode))
                return (driver.OK if np.all(np.isfinite(v[:n])) else driver.NOT_FINITE), v, mode
            if t > 0:
                length, v = self._land(m, u, phase, t * left, left, which, side, mode)
                pieces.append(Piece(phase, length, u, v[None], mode))
                u, left, phase = v, left - length, phase + length * m.turn
            changes.append((m.failed_period, phase, which, side, *u[:n].tolist()))
            mode = (*mode[:which], mode[which] + side, *mode[which + 1 :])
            u, v = self._start(m, u[:n], phase, left, mode)
            if not left > 0:
                return driver.OK, u, mode
        return driver.CHATTER, u, mode

    def _leaving(self, u: np.ndarray, v: np.ndarray, h: float, mode: Mode) -> tuple[float, int, int]:
        m, begin, end = len(self._laws), u[2 * self._n :].tolist(), v[2 * self._n :].tolist()
        found = [
            (
                closing(side * (b - begin[i]), -side * h * begin[m + i], side * (b - end[i]), -side * h * end[m + i]),
                i,
                side,
            )
            for i in range(m)
            for side, b in self._borders[i][mode[i]]
        ]
        return min(found, key=lambda row: row[0])

    def _land(
        self, m: March, u: np.ndarray, phase: float, length: float, left: float, i: int, side: int, mode: Mode
    ) -> tuple[float, np.ndarray]:
        target, at = self._laws[i][0][mode[i] if side > 0 else mode[i] - 1], 2 * self._n + i
        for trial in range(MOST):
            v = self._attempt(m, u, phase, length, mode)
            miss, rate = float(v[at]) - target, float(v[at + len(mode)])
            shift = newton_shift(miss, rate, side, length, left, m.h, trial)
            if shift == 0.0:
                break
            length = min(length - shift, left)
        return length, v

    def _law(self, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
        if mode not in self._known_laws:
            pieces = [(s[j], c[j]) for (_, s, c), j in zip(self._laws, mode, strict=True)]
            slopes, intercepts = np.array(pieces, dtype=float).reshape(-1, 2).T.copy()
            self._known_laws[mode] = slopes, intercepts
        return self._known_laws[mode]

    def _start(self, m: March, x: np.ndarray, phase: float, h: float, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
        """Return the points at a state and after a step from there."""
        here, there = self._restart(x, phase, h, m.turn, m.p, *self._law(mode))
        return here, there

    def _attempt(self, m: March, u: np.ndarray, phase: float, h: float, mode: Mode) -> np.ndarray:
        return self._step(u[: 2 * self._n], phase, h, m.turn, m.p, *self._law(mode))[0]

    def _keep(self, m: March, period: int, pieces: list[Piece]) -> None:
        """Fill the arrays of one period."""
        m.strobe[period] = pieces[-1].after[-1, : self._n]
        if m.samples is not None:
            keep_samples(m, period, pieces, self._attempt)
        if m.dwell is not None:
            keep_times(m, pieces, self._first)
        if m.statistics is not None:
            keep_statistics(m, period, pieces, self._law, self._observe)


def _borders(breakpoints: tuple[float, ...], j: int) -> list[tuple[int, float]]:
    below = [(-1, breakpoints[j - 1])] if j > 0 else []
    return below + ([(1, breakpoints[j])] if j < len(breakpoints) else [])
