"""Brute-force response over a parameter: every value starts from the last state of the value before."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np

from continuation.errors import ContinuationError, UnsupportedModel, nearest
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.exact import describe
from continuation.timedomain.parts import Keeper
from continuation.timedomain.period_map import Integrator, PeriodMap, period_map
from continuation.timedomain.plain_system import PlainSystem
from continuation.timedomain.recognition import Evidence, Witness
from continuation.timedomain.settling import Settled, Settling
from continuation.timedomain.sweep_result import FAILED, Sweep
from continuation.timedomain.sweep_rows import Row, collect, failed_row, row_of

__all__ = ["FAILED", "Progress", "Sweep", "SweepTask", "sweep", "task"]

logger = logging.getLogger(__name__)

_APPROACH = 50  # excitation periods in compiled code before CVODES takes over
_FAR = 1e8

Progress = Callable[[int, int], None]
"""Called with the number of values done and of all values."""

Direction = Literal["given", "up", "down"]


@dataclass(frozen=True, slots=True)
class SweepTask:
    """Describe a sweep as plain data; running it gives the same result in any thread or process.

    Attributes are the arguments of :func:`sweep`, checked; ``starts`` has one state per value, or just one.
    """

    model: PlainSystem
    integrator: Integrator | None
    parameter: str
    values: tuple[float, ...]
    quantity: str
    load: str
    starts: tuple[tuple[float, ...], ...]
    transient: int
    limit: int
    recorded: int
    tolerance: float
    march: str = ""
    resume: str = ""

    def __post_init__(self) -> None:
        model, names = self.model, [k for k, _ in self.model.parameters]
        known = (*model.state_names, *model.output_names)
        for name, options in ((self.parameter, names), (self.quantity, known), (self.load or known[0], known)):
            if name not in options:
                raise ValueError(f"sweep of {model.name!r}: unknown name {name!r}; {nearest(name, options)}")
        if not self.values or not np.all(np.isfinite(self.values)):
            raise ValueError(f"sweep: expected at least one value of {self.parameter!r}, all finite, got {self.values}")
        if self.parameter == model.frequency and min(self.values) <= 0:
            raise ValueError(f"sweep: frequency {self.parameter!r} must be positive, got {min(self.values):g}")
        for start in self.starts:
            if len(start) != len(model.state_names) or not np.all(np.isfinite(start)):
                raise ValueError(f"sweep: start needs {len(model.state_names)} states, got {len(start)}, all finite")
        if len(self.starts) not in (1, len(self.values)):
            raise ValueError(f"sweep: expected 1 or {len(self.values)} states to start from, got {len(self.starts)}")
        for name in ("transient", "limit", "recorded", "tolerance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"sweep: {name} must be positive, got {getattr(self, name)}")
        if self.march and not isinstance(self.integrator, CVODES):
            raise ValueError("sweep: march goes with integrator=CVODES(...); fixed steps are compiled without it")

    @property
    def fingerprint(self) -> str:
        """Text that differs when any result could differ."""
        plain = replace(self, resume="", march=self.march and "compiled")
        return hashlib.sha256(repr(plain).encode()).hexdigest()

    def run(self, progress: Progress | None = None) -> Sweep:
        """Go through the values in order; a value that fails is reported and the next begins from the first start.

        With ``resume`` finished values are read from that file first and kept in it as the sweep goes on.
        """
        keeper = Keeper(Path(self.resume), self.fingerprint) if self.resume else None
        before = keeper.load() if keeper else None
        run, rows, known = _Run(self), [], 0 if before is None else len(before.values)
        if before is not None and len(self.starts) == 1 and before.period[-1] != FAILED:
            run.x = before.states[-1].copy()
        try:
            for i in range(known, len(self.values)):
                rows.append(run.value(i))
                if keeper:
                    keeper.keep(lambda: collect(self, rows, before))
                if progress:
                    progress(known + len(rows), len(self.values))
        finally:
            if keeper and rows:
                keeper.keep(lambda: collect(self, rows, before), now=True)
        return collect(self, rows, before)


class _Run:
    """Carry the state of a sweep from value to value."""

    def __init__(self, task: SweepTask) -> None:
        self.task, self.system = task, task.model.system()
        quantities = tuple(dict.fromkeys(q for q in (task.quantity, task.load) if q))
        self.map: PeriodMap = period_map(self.system, task.integrator, quantities)
        self.p = self.system.parameter_vector()
        self.index = self.system.parameter_names.index(task.parameter)
        self.clock = self.system.parameter_names.index(str(self.system.frequency))
        self.march = ca.external("march", task.march) if task.march else None
        self.x = np.array(task.starts[0])
        self._witness: Witness | None = None
        self.used = self.elapsed = 0

    def value(self, i: int) -> Row:
        """Settle at one value and describe what is there."""
        task = self.task
        self.p[self.index] = task.values[i]
        if len(task.starts) > 1:
            self.x = np.array(task.starts[i])
        self.used = self.elapsed = 0
        try:
            self.map.set(self.p)
            settled = self._settle(_approach(self.march, self.x, self.p) if self.march else self.x)
            row = row_of(task, self.map, settled)
            if not settled.period:
                found, end = self._look(row.state)
                self.elapsed += found.periods
                later = self._settle(end) if found.settles else None
                if later is not None and later.period:  # a long transient that has ended meanwhile
                    row = row_of(task, self.map, later)
                    row = replace(row, used=row.used + settled.periods_used + found.periods)
                else:
                    row = replace(row, verdict=found.verdict, evidence=found)
        except ContinuationError as error:
            began = describe(dict(zip(self.system.state_names, self.x.tolist(), strict=True)))
            length = 2 * np.pi / float(self.p[self.clock])
            reason = (
                f"{error}. This value began with state {began}; times above count from {self.elapsed} periods later"
            )
            reason += f", at time {self.elapsed * length:.6g}"
            logger.warning("%s = %g: %s", task.parameter, task.values[i], reason)
            self.x = np.array(task.starts[0])
            return failed_row(task, reason, self.used)
        self.x = row.state
        return row

    def _settle(self, x: np.ndarray) -> Settled:
        task, again = self.task, self.task.recorded if self.map.described_again else 0
        settling = Settling(
            lambda state: self.map.ahead(state, 1)[0],
            tolerance=task.tolerance,
            floor=self.map.floor,
            transient=task.transient,
            limit=max(task.limit - again, 1),
            recorded=1 if again else task.recorded,
            ahead=self.map.ahead,
        )
        before = self.elapsed
        try:
            return settling.run(x)
        finally:
            self.used, self.elapsed = self.used + settling.used, before + settling.elapsed

    def _look(self, x: np.ndarray) -> tuple[Evidence, np.ndarray]:
        if self._witness is None:
            self._witness = Witness(self.system)
        return self._witness.look(x, self.p)


def _approach(march: ca.Function, x: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Bring a state close to its attractor in compiled code; the state given where that leaves the finite numbers."""
    end = x
    for _ in range(_APPROACH):
        end = march(end, p)
    result = np.array(end, dtype=float).ravel()
    return result if np.all(np.isfinite(result)) and np.abs(result).max() < _FAR else x


def sweep(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    *,
    quantity: str,
    load: str = "",
    integrator: Integrator | None = None,
    method: CVODES | None = None,
    start: Sequence[float] | np.ndarray | None = None,
    direction: Direction = "given",
    transient: int = 32,
    limit: int = 400,
    recorded: int = 64,
    tolerance: float = 1e-7,
    march: str = "",
    executor: Executor | None = None,
    resume: str | Path = "",
    progress: Progress | None = None,
) -> Sweep:
    """Compute the brute-force response over parameter values.

    Parameters
    ----------
    system : System
        Driven model; its exact contact laws are integrated.
    parameter : str
        Parameter to sweep; the others keep the System's defaults.
    values : array (k,)
        In the order of the sweep, unless a direction is chosen.
    quantity : str
        State or output that rms, mean, extremes and harmonics describe.
    load : str
        State or output whose largest over mean value is the dynamic factor; none when empty.
    integrator : FixedStep, CVODES or EventExact, optional
        When absent, fixed steps of order 4, as many as the System needs at each value.
    method : CVODES, optional
        Older name of ``integrator``.
    start : array (n,) or (k, n), optional
        State at phase 0 before the first value, and again after a failure; zeros when absent. With one state for each
        value, in the order of ``values``, every value starts from its own: nothing is carried over.
    direction : {"given", "up", "down"}
        Sort the values first.
    transient, limit : int
        Excitation periods per value at least and, when the response is not recognised as periodic, about at most.
        With ``transient=300, recorded=100, limit=400`` every value takes 300 periods and is judged once.
    recorded : int
        Excitation periods the statistics describe when the response is not recognised as periodic.
    tolerance : float
        Distance to the periodic response, over the largest value of each state, at which it counts as settled.
    march : str
        Library of :func:`~continuation.model.compiled.compiled_march` for CVODES: every value then begins with 50
        periods in compiled code, and CVODES, which decides, has less to do. Empty: CVODES alone.
    executor : concurrent.futures.Executor, optional
        Runs parts of 16 values side by side when every value has its own start; results do not depend on it.
    resume : str or Path
        netCDF file that keeps finished values, every 5 seconds and when interrupted; a rerun with the same arguments
        goes on there. With an executor, parts are kept as they are finished.
    progress : callable, optional
        Called with the number of values done and of all values.

    Raises
    ------
    ValueError
        If a name is unknown, a number is out of range, or the file to resume belongs to another sweep.
    UnsupportedModel
        If the System is autonomous.

    Notes
    -----
    A response is called period-n when it repeats after n = 1 to 64 excitation periods (see
    :class:`~continuation.timedomain.settling.Settling`). What does not is looked at more closely
    (:class:`~continuation.timedomain.recognition.Witness`): "quasi-periodic" and "chaotic" carry their evidence, and
    "not recognised" says no more than that. With CVODES and EventExact statistics are means over 64 equidistant samples
    per period, which err with the 4th power of their spacing with contact, else much less. A value at which the
    integration fails is named in ``failures`` with time, state and parameters, and the rest goes on.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> up = sweep(linear, "omega", [0.5, 2.0], quantity="x")
    >>> up.period.tolist(), [round(float(r), 7) for r in up.rms]        # 1/abs(1 - omega^2 + 0.2i omega)/sqrt(2)
    ([1, 1], [0.9345386, 0.2336347])
    """
    chosen = one_integrator(integrator, method)
    given, begin = _ordered(system, values, start, direction)
    settings = (quantity, load, chosen, begin, transient, limit, recorded, tolerance, march, str(resume))
    whole = task(system, parameter, given, *settings)
    if executor is None:
        return whole.run(progress)
    from continuation.timedomain.parallel import run_in_parts

    return run_in_parts(whole, executor, progress)


def one_integrator(integrator: Integrator | None, method: CVODES | None) -> Integrator | None:
    """Return the integrator from its name and its older name; both together raise ValueError."""
    if integrator is not None and method is not None:
        raise ValueError("sweep: integrator and method are two names of one argument; expected one of them")
    return method if integrator is None else integrator


def _ordered(
    system: System, values: Sequence[float] | np.ndarray, start: Sequence[float] | np.ndarray | None, direction: str
) -> tuple[np.ndarray, np.ndarray]:
    given = np.ravel(np.asarray(values, dtype=float))
    begin = np.zeros(len(system.state_names)) if start is None else np.asarray(start, dtype=float)
    if direction not in ("given", "up", "down"):
        raise ValueError(f"sweep: direction must be 'given', 'up' or 'down', got {direction!r}")
    order = np.arange(len(given)) if direction == "given" else np.argsort(given, kind="stable")
    order = order[::-1] if direction == "down" else order
    return given[order], begin[order] if begin.ndim == 2 and len(begin) == len(given) else begin


def task(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    quantity: str,
    load: str,
    integrator: Integrator | None,
    start: Sequence[float] | np.ndarray | None,
    transient: int,
    limit: int,
    recorded: int,
    tolerance: float,
    march: str = "",
    resume: str = "",
) -> SweepTask:
    """Return the plain description of a sweep; arguments as for :func:`sweep`."""
    if system.frequency is None:
        raise UnsupportedModel(
            f"system {system.name!r} is autonomous and has no excitation period to integrate over; "
            "only models with a phase are treated here"
        )
    begin = np.zeros(len(system.state_names)) if start is None else np.asarray(start, dtype=float)
    starts = tuple(tuple(row) for row in np.atleast_2d(begin).tolist())
    plain = tuple(float(v) for v in np.ravel(values))
    if march and integrator is None:
        integrator = CVODES()  # the march is there for it alone
    settings = (quantity, load, starts, transient, limit, recorded, tolerance, march, resume)
    return SweepTask(PlainSystem.of(system), integrator, parameter, plain, *settings)
