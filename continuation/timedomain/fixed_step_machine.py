"""The fixed-step march as machine code, and the arrays that it fills."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from continuation.model.machine_code import library
from continuation.timedomain import fixed_step_driver as driver
from continuation.timedomain.fixed_step_functions import ModeModel, StepFunctions


@dataclass(slots=True)
class March:
    """Carry one march over whole periods from phase 0: what it starts from, and the arrays that it fills.

    Attributes
    ----------
    x : ndarray (n,)
        State; at the end that after the last whole period.
    mode : ndarray of int64 (m,)
        Index of the linear piece of every contact; the same.
    p : ndarray (q,)
    h : float
        Step in time.
    turn : float
        Phase per time; 1 when the model is autonomous, whose phase is the time.
    periods, steps : int
        Number of periods, and of steps in each.
    centre : ndarray (o,)
        Values subtracted from the observed quantities before they are summed.
    phases : ndarray (k,)
        Phases at which states are wanted in every period.
    strobe : ndarray (periods, n)
        State at the end of every period.
    statistics : ndarray (periods, o, 4) or None
        Integral over time of every quantity and of its square, minimum and maximum; begins with 0, 0, inf, -inf.
    dwell : ndarray (pieces,) or None
        Time spent in every piece of every contact.
    samples : ndarray (periods, k, n) or None
    changes : ndarray (capacity, 4 + n) or None
        Period, phase in it, contact, direction and state of every contact change.
    count : int
        Number of contact changes.
    failed_period, failed_phase
        Where a march that failed stopped.
    """

    x: np.ndarray
    mode: np.ndarray
    p: np.ndarray
    h: float
    turn: float
    periods: int
    steps: int
    centre: np.ndarray
    phases: np.ndarray
    strobe: np.ndarray
    statistics: np.ndarray | None = None
    dwell: np.ndarray | None = None
    samples: np.ndarray | None = None
    changes: np.ndarray | None = None
    count: int = 0
    failed_period: int = 0
    failed_phase: float = 0.0


class MachineMarch:
    """March in compiled code; raises NoMachineCode where that can't be had. Threads may march side by side."""

    def __init__(self, model: ModeModel, functions: StepFunctions) -> None:
        self._row = len(functions.fractions) * functions.forcing.numel_out(0)
        loaded = ctypes.CDLL(library(driver.source(model, functions)))
        number, integer, pointer = ctypes.c_double, ctypes.c_int64, ctypes.c_void_p
        self._tabulate, self._march = loaded.tabulate, loaded.march
        self._tabulate.argtypes, self._tabulate.restype = [pointer, number, integer, pointer], None
        self._march.argtypes = (
            [pointer] * 3 + [number] * 2 + [integer] * 2 + [pointer] * 5 + [integer] + [pointer] * 2 + [integer]
            + [pointer] * 2
        )  # fmt: skip
        self._march.restype = ctypes.c_int

    def tabulate(self, p: np.ndarray, width: float, steps: int) -> np.ndarray:
        """Return all that depends on parameters and phase alone, at the stages of every step of a period."""
        table = np.empty((steps, self._row))
        self._tabulate(p.ctypes.data, width, steps, table.ctypes.data)
        return table

    def march(self, m: March, table: np.ndarray) -> int:
        """March; returns one of the codes of the driver."""
        where = np.zeros(3)
        flag = self._march(
            m.x.ctypes.data, m.mode.ctypes.data, m.p.ctypes.data, m.h, m.turn, m.periods, m.steps, table.ctypes.data,
            m.strobe.ctypes.data, _address(m.statistics), _address(m.dwell), m.phases.ctypes.data, len(m.phases),
            _address(m.samples), _address(m.changes), 0 if m.changes is None else len(m.changes),
            m.centre.ctypes.data, where.ctypes.data,
        )  # fmt: skip
        m.failed_period, m.failed_phase, m.count = int(where[0]), float(where[1]), int(where[2])
        return int(flag)


def _address(array: np.ndarray | None) -> int | None:
    return None if array is None else array.ctypes.data
