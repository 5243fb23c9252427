"""Explicit Runge-Kutta steps of fixed length that land on contact changes, as machine code where that can be had."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import casadi as ca
import numpy as np

from continuation.errors import ContinuationError, nearest
from continuation.model.machine_code import NoMachineCode, find_compiler
from continuation.model.system import System
from continuation.timedomain import fixed_step_driver as driver
from continuation.timedomain.fixed_step_functions import TABLEAUS, ModeModel, StepFunctions, mode_model, step_functions
from continuation.timedomain.fixed_step_machine import MachineMarch, March
from continuation.timedomain.fixed_step_run import FixedStepRun, collect, failure
from continuation.timedomain.fixed_step_virtual import VirtualMarch
from continuation.timedomain.kernels import Kernel

_PER_TIME_CONSTANT = 8
_MOST_STEPS = 16384


@dataclass(frozen=True, slots=True)
class FixedStep:
    """Choose an explicit Runge-Kutta method with a fixed number of steps.

    Parameters
    ----------
    steps_per_period : int
        Steps per excitation period; per unit of time when the System is autonomous.
    order : int
        2, 4 (classical Runge-Kutta), 5 or 8 (Dormand and Prince).
    land : bool
        End a step on every contact change and begin another there, so that the order survives. False steps over the
        corners of the contact laws, which makes the error 10 to 10,000 times as large; for comparisons.

    Raises
    ------
    ValueError
        If there is no method of that order, or fewer than 8 steps.

    Examples
    --------
    >>> FixedStep(512)
    FixedStep(steps_per_period=512, order=4, land=True)
    """

    steps_per_period: int = 256
    order: int = 4
    land: bool = True

    def __post_init__(self) -> None:
        if self.order not in TABLEAUS:
            raise ValueError(f"FixedStep: order must be one of {sorted(TABLEAUS)}, got {self.order}")
        if not self.steps_per_period >= 8:
            raise ValueError(f"FixedStep: steps_per_period must be 8 or more, got {self.steps_per_period}")

    def compile(self, system: System, quantities: Sequence[str] = ()) -> FixedStepIntegrator:
        """Build the integrator of a System; use it for any parameter values.

        Parameters
        ----------
        quantities : sequence of str
            States or outputs of which statistics are kept.
        """
        names = (*system.state_names, *system.output_names)
        for name in quantities:
            if name not in names:
                raise ValueError(f"system {system.name!r} has no state or output {name!r}; {nearest(name, names)}")
        model = mode_model(system, tuple(quantities), land=self.land)
        return FixedStepIntegrator(self, model, system)


class FixedStepIntegrator:
    """March over whole periods in steps of fixed length; built by :meth:`FixedStep.compile`.

    Notes
    -----
    The step is taken in the linear pieces that the contacts are in. A cubic through the values and rates of each
    contact argument at both ends of the step shows whether the piece is left in between, also when it is entered again
    before the end. The step is then taken again up to that instant, which Newton's method on the step itself makes
    exact, and another one in the new piece ends on the grid. The force is continuous, so the state carries over; the
    error at a change is of the order of the step, and the global order survives. All that depends on parameters and
    phase alone is tabulated once per parameter value. Extremes and integrals are of 4th order whatever the method.

    Measured for the 14-state gear, order 4: see ``tests/benchmarks/test_fixed_step.py``.

    Attributes
    ----------
    note : str
        What was compiled, or why nothing was.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> free = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, phase=theta,
    ...               frequency="omega", parameters={"omega": (omega, 1.0)})
    >>> run = FixedStep(256).compile(free, ["x"]).run([1.0, 0.0], free.parameter_vector(), 3, statistics=True)
    >>> run.strobe.shape, bool(abs(run.end - [1.0, 0.0]).max() < 1e-7), run.variance[0].round(6).tolist()
    ((4, 2), True, [0.5])
    """

    def __init__(self, settings: FixedStep, model: ModeModel, system: System) -> None:
        self.settings, self.system = settings, system
        self._model, self._functions = model, step_functions(model, settings.order)
        self._frequency = None if system.frequency is None else system.parameter_names.index(system.frequency)
        self._engine, self.note = _engine(model, self._functions)
        f = self._functions
        self._kernels = Kernel(f.forcing), Kernel(f.begin), Kernel(f.observe)
        self._table: tuple[bytes, np.ndarray] = (b"", np.empty(0))
        self._lock = Lock()  # threads may march side by side, but share the kernels and the table

    def with_steps(self, steps_per_period: int) -> FixedStepIntegrator:
        """Return the same integrator with another number of steps; nothing is compiled again."""
        new = object.__new__(FixedStepIntegrator)
        new.__dict__.update(self.__dict__)
        new.settings = replace(self.settings, steps_per_period=steps_per_period)
        f = self._functions
        new._kernels = Kernel(f.forcing), Kernel(f.begin), Kernel(f.observe)
        new._table, new._lock = (b"", np.empty(0)), Lock()
        return new

    def run(
        self,
        x: np.ndarray | Sequence[float],
        p: np.ndarray,
        periods: int = 1,
        *,
        statistics: bool = False,
        phases: np.ndarray | Sequence[float] = (),
        changes: bool = False,
    ) -> FixedStepRun:
        """March from phase 0.

        Parameters
        ----------
        x : array (n,)
            State at phase 0.
        p : array (q,)
            All parameters in order.
        periods : int
            Number of excitation periods; of units of time when the System is autonomous.
        statistics : bool
            Keep those of the quantities the integrator was built for.
        phases : array (k,)
            Increasing phases in [0, 2*pi), or times in [0, 1), at which states are kept in every period.
        changes : bool
            Keep every contact change.

        Raises
        ------
        Runaway, Chattering, TooManySteps
            If the state leaves the finite numbers, or contacts change too often; they name time, state and parameters.
        ContinuationError
            If the frequency is not positive.
        ValueError
            If a shape does not fit or phases do not increase inside the period.
        """
        with self._lock:
            m = self._prepare(np.array(x, dtype=float), np.array(p, dtype=float), periods, statistics, phases, changes)
            table = self._tabulate(m)
        start = m.x.copy()
        flag = self._engine.march(m, table)
        if flag != driver.OK:
            raise failure(m, flag, repr(self.settings), self.system)
        return collect(m, start, self._model)

    def _prepare(
        self,
        x: np.ndarray,
        p: np.ndarray,
        periods: int,
        statistics: bool,
        phases: np.ndarray | Sequence[float],
        changes: bool,
    ) -> March:
        steps, model = self.settings.steps_per_period, self._model
        turn, length = 1.0, 1.0
        for name, array, size in (("state", x, model.x.numel()), ("parameters", p, model.p.numel())):
            if array.shape != (size,):
                raise ValueError(f"march of {self.system.name!r}: expected {size} values of {name}, got {array.shape}")
        if periods < 0:
            raise ValueError(f"march of {self.system.name!r}: expected 0 or more periods, got {periods}")
        if self._frequency is not None:
            turn, length = float(p[self._frequency]), 2 * np.pi / p[self._frequency] if p[self._frequency] else np.inf
            if not 0 < turn < np.inf:
                raise ContinuationError(
                    f"march of {self.system.name!r}: frequency {self.system.frequency!r} must be positive, got {turn:g}"
                )
        wanted = np.array(phases, dtype=float).ravel()
        if len(wanted) and not (wanted[0] >= 0 and np.all(np.diff(wanted) > 0) and wanted[-1] < length * turn - 1e-12):
            raise ValueError(f"phases: expected increasing numbers in [0, {length * turn:.6g}), got {wanted}")
        o, k = model.observed.numel(), len(wanted)
        mode, centre = self._begin(x, p, statistics)
        return March(
            x, mode, p, length / steps, turn, periods, steps, centre, wanted, np.empty((periods, len(x))),
            np.tile([0.0, 0.0, np.inf, -np.inf], (periods, o, 1)) if statistics and o else None,
            np.zeros(sum(len(s) for _, s, _ in model.laws)) if model.laws else None,
            np.empty((periods, k, len(x))) if k else None,
            np.empty((2 * periods * steps, 4 + len(x))) if changes and model.laws else None,
        )  # fmt: skip

    def _begin(self, x: np.ndarray, p: np.ndarray, statistics: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the pieces the contacts are in, and the observed quantities where they are wanted, at phase 0."""
        (forcing, begin, observe), laws = self._kernels, self._model.laws
        mode, centre, nothing = list[int](), np.zeros(self._model.observed.numel()), np.zeros(len(laws))
        if laws:
            arguments = begin(x, forcing(0.0, p)[0], nothing, nothing)[1].tolist()
            mode = [bisect_left(b, a) for (b, _, _), a in zip(laws, arguments, strict=True)]
        if statistics:
            pieces = [(s[j], c[j]) for (_, s, c), j in zip(laws, mode, strict=True)]
            slopes, intercepts = np.array(pieces).reshape(-1, 2).T
            centre = observe(x, 0 * x, 0.0, p, slopes, intercepts)[0]
        return np.array(mode, dtype=np.int64), centre

    def _tabulate(self, m: March) -> np.ndarray:
        key, table = self._table
        if key != m.p.tobytes():
            table = self._engine.tabulate(m.p, m.h * m.turn, m.steps)
            self._table = (m.p.tobytes(), table)
        return table


class SuitableSteps:
    """Tell how many steps of the classical method a System needs at parameter values; built once per System.

    Notes
    -----
    A step covers at most 1/8 of the time constant of the fastest eigenvalue with all contacts closed at their steepest
    slope, from the Jacobian at state 0 and eight phases, which puts 2e-6 of relative error on that frequency. The
    number is 256 times a power of two. States far from 0 of a nonlinear model may need more.

    Examples
    --------
    >>> import casadi as ca
    >>> x, theta, omega = (ca.SX.sym(k) for k in ("x", "theta", "omega"))
    >>> fast = System(name="fast", states={"x": x}, derivatives={"x": -20*x}, phase=theta, frequency="omega",
    ...               parameters={"omega": (omega, 1.0)})
    >>> SuitableSteps(fast)(fast.parameter_vector())
    1024
    """

    def __init__(self, system: System) -> None:
        closed = [max(c.slopes, key=abs) * system.arguments[i] for i, c in enumerate(system.contacts)]
        f = ca.substitute(system.derivative, system.phi, ca.vertcat(*closed)) if closed else system.derivative
        jacobian = ca.jacobian(f, system.x)
        self._matrix = Kernel(ca.Function("jacobian", [system.x, system.theta, system.p], [ca.densify(jacobian)]))
        self._size, self._name = len(system.state_names), system.name
        self._frequency = None if system.frequency is None else system.parameter_names.index(system.frequency)

    def __call__(self, p: np.ndarray) -> int:
        """Return the number of steps per excitation period, or per unit of time.

        Raises
        ------
        ContinuationError
            If more than 16384 were needed: the model is too stiff for an explicit method.
        """
        phases = 2 * np.pi * np.arange(8) / 8
        matrices = [self._matrix(np.zeros(self._size), t, p)[0].reshape(self._size, -1) for t in phases]
        if not np.all(np.isfinite(matrices)):
            return 256
        radius = float(np.abs(np.linalg.eigvals(np.array(matrices))).max(initial=0.0))
        length = 1.0 if self._frequency is None else 2 * np.pi / float(p[self._frequency])
        steps = 256
        while steps < _PER_TIME_CONSTANT * radius * length:
            steps *= 2
            if steps > _MOST_STEPS:
                raise ContinuationError(
                    f"system {self._name!r}: explicit steps of fixed length would have to be more than {_MOST_STEPS} a "
                    "period for its fastest motion; use CVODES(stiff=True)"
                )
        return steps


def _engine(model: ModeModel, functions: StepFunctions) -> tuple[MachineMarch | VirtualMarch, str]:
    try:
        return MachineMarch(model, functions), f"compiled with {find_compiler()}"
    except (NoMachineCode, OSError) as reason:
        return VirtualMarch(model, functions), f"without machine code: {reason}"
