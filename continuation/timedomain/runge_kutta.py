"""The functions of a step of one System, ready to be called: in CasADi's virtual machine or as machine code."""

from __future__ import annotations

from functools import cached_property
from weakref import WeakKeyDictionary

import casadi as ca

from continuation.model.compiled import compiled_function
from continuation.model.extension import extended
from continuation.model.machine_code import NoMachineCode
from continuation.model.system import System
from continuation.timedomain import dormand_prince as dp
from continuation.timedomain.kernels import Batch, Kernel
from continuation.timedomain.machine_batch import MachineBatch, MachineTransition

__all__ = ["Kernel", "StepFunctions", "step_functions"]

_COMPILING = 1.0, 1e-3  # seconds that compiling takes, and per operation of a step
_STEPPING = 1.5e-8  # seconds per operation that a step with its derivatives takes in the virtual machine


class StepFunctions:
    """Hold the CasADi functions of one System; force = slope * argument + intercept in the current contact mode.

    Every function takes ``x (n,), theta, h, p (q,), slopes (m,), intercepts (m,)``, h the length in phase. They are
    built when first used. With machine code None they are compiled as soon as so many steps were taken that it pays.

    Attributes
    ----------
    machine_code : bool or None
    note : str
        What was compiled, or why nothing was.
    """

    def __init__(self, system: System, machine_code: bool | None) -> None:
        self.machine_code, self.note = machine_code, "in CasADi's virtual machine"
        self._steps, self._compile = 0, machine_code is True
        m = self._contacts = len(system.contacts)
        slopes, intercepts = ca.SX.sym("slopes", m), ca.SX.sym("intercepts", m)
        force = slopes * system.arguments + intercepts if m else ca.SX(0, 1)
        omega = system.p[system.parameter_names.index(str(system.frequency))]
        rate, gains = system.derivative / omega, ca.jacobian(system.derivative, system.phi) / omega
        if m:
            rate, gains = ca.substitute([rate, gains], [system.phi], [extended(system, force)])
        self._point = [system.x, system.theta, system.p, slopes, intercepts]
        self._rate, self._gains, self._met = rate, gains, system.arguments
        self._field = ca.Function("field", self._point, [rate])
        self._arguments = ca.Function("arguments", self._point[:3], [system.arguments])

    def count(self, steps: int) -> None:
        """Count steps taken, and go over to machine code where that is left open and has begun to pay."""
        self._steps += steps
        if self.machine_code is None and not self._compile and self._steps > self._worth:
            self._compile = True
            for name in ("step", "march", "transition", "forcing", "advance", "dense"):
                self.__dict__.pop(name, None)

    @cached_property
    def _worth(self) -> float:
        """Number of steps that take as long in the virtual machine as compiling."""
        operations = dp.step(self._field, self._arguments, self._contacts).n_nodes()
        return (_COMPILING[0] + _COMPILING[1] * operations) / (_STEPPING * operations)

    def _made(self, function: ca.Function) -> ca.Function:
        if self._compile:
            function, self.note = compiled_function(function)
        return function

    def _batch(self, function: ca.Function) -> Batch | MachineBatch:
        if self._compile:
            try:
                return MachineBatch(function)
            except NoMachineCode as reason:
                self.note = str(reason)
        return Batch(function)

    @cached_property
    def rate(self) -> Kernel:
        """(x, theta, p, slopes, intercepts) -> dx/dphase (n,)."""
        return Kernel(self._field)

    @cached_property
    def step(self) -> Kernel:
        """State after the step (n,), 5th and 3rd order error estimates (n, 2), contact arguments (m, 13)."""
        return Kernel(self._made(dp.step(self._field, self._arguments, self._contacts)))

    @cached_property
    def march(self) -> Kernel:
        """Several steps with error control: see :func:`~continuation.timedomain.dormand_prince.march`."""
        return Kernel(self._made(dp.march(dp.step(self._field, self._arguments, self._contacts), self._contacts)))

    @cached_property
    def guard(self) -> Kernel:
        """(x, theta, p, slopes, intercepts) -> contact arguments (m,) and their rates along the flow (m,)."""
        return Kernel(ca.Function("guard", self._point, [self._met, self._along()]))

    def _along(self) -> ca.SX:
        """Return the rates of the contact arguments along the flow, per phase."""
        return ca.jtimes(self._met, self._point[0], self._rate) + ca.jacobian(self._met, self._point[1])

    @cached_property
    def transition(self) -> Batch | MachineBatch:
        """Derivative (n, n) of the state after a step by that before it, with what tells its accuracy.

        Also the squared norms (2, n) of the 5th and 3rd order error estimates of its columns, the integral of the trace
        of the Jacobian, and the contact arguments at the 12 stages (m, 12).
        """
        jacobian = ca.Function("jacobian", self._point, [ca.jacobian(self._rate, self._point[0])])
        stages = dp.jacobians(self._field, jacobian, self._arguments, self._contacts)
        if self._compile:
            try:
                return MachineTransition(stages)
            except NoMachineCode as reason:
                self.note = str(reason)
        return Batch(dp.transition(stages, self._field, self._contacts))

    @cached_property
    def forcing(self) -> Batch | MachineBatch:
        """Derivative (n,) of the state after a step in a direction d (q,) of the parameters, given as last argument."""
        _, _, _, p, _, _ = given = dp.symbols(self._field, self._contacts, ca.SX)
        d = ca.SX.sym("d", p.numel())
        return self._batch(ca.Function("forcing", [*given, d], [ca.jtimes(dp.stages(self._field, given)[1], p, d)]))

    @cached_property
    def advance(self) -> Batch | MachineBatch:
        """State after a step (n,)."""
        given = dp.symbols(self._field, self._contacts, ca.SX)
        return self._batch(ca.Function("advance", list(given), [dp.stages(self._field, given)[1]]))

    @cached_property
    def dense(self) -> Batch | MachineBatch:
        """Coefficients (n, 8) of the interpolant of a step; the last removes its error in the middle."""
        return self._batch(dp.dense(self._field, self._contacts))

    @cached_property
    def second(self) -> Kernel:
        """Takes xi, a, b (n,) in addition: gradients of ``a . x1 + b . (dx1/dx xi)`` in x (n,), xi (n,) and p (q,)."""
        return Kernel(dp.second(self._field, self._contacts))

    @cached_property
    def jump(self) -> Kernel:
        """(x, theta, p, slopes, intercepts, xi, b) -> what the second derivative needs at contact changes.

        Of every contact: ``b . gain * (da/dx . xi)`` (m,), rate of the argument a (m,), da/dx (m, n), da/dp (m, q).
        """
        x, _, p = self._point[:3]
        xi, b = ca.SX.sym("xi", x.numel()), ca.SX.sym("b", x.numel())
        strength = (self._gains.T @ b) * ca.jtimes(self._met, x, xi)
        slopes = [ca.jacobian(self._met, v) for v in (x, p)]
        return Kernel(ca.Function("jump", [*self._point, xi, b], [strength, self._along(), *slopes]))


_kept: WeakKeyDictionary[System, dict[bool | None, StepFunctions]] = WeakKeyDictionary()


def step_functions(system: System, machine_code: bool | None = None) -> StepFunctions:
    """Return the functions of a driven System, the same ones whenever it is asked for again.

    Parameters
    ----------
    system : System
        Driven model; its frequency turns time into phase, so that the interval does not depend on it.
    machine_code : bool, optional
        Compile at once (True), never (False), or when it pays (None).

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, theta, omega = (ca.SX.sym(k) for k in ("x", "theta", "omega"))
    >>> decay = System(name="decay", states={"x": x}, derivatives={"x": -x}, phase=theta, frequency="omega",
    ...                parameters={"omega": (omega, 1.0)})
    >>> x1, *_ = step_functions(decay).step([1.0], 0.0, 0.1, [1.0], [], [])
    >>> bool(abs(x1[0] - 2.718281828459045**-0.1) < 1e-14)
    True
    """
    known = _kept.setdefault(system, {})
    if machine_code not in known:
        known[machine_code] = StepFunctions(system, machine_code)
    return known[machine_code]
