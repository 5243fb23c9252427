"""One step of the Dormand-Prince 8(5,3) method inside a contact mode, as CasADi functions of the excitation phase."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev
from scipy.integrate import DOP853

from continuation.model.system import System

NODES = 13
"""Chebyshev points inside a step at which the contact arguments are sampled."""

_EXPAND_UP_TO = 4
"""States up to which the variational step is unrolled to scalar operations; beyond, matrix operations are kept."""


class Kernel:
    """Call a CasADi function through fixed NumPy buffers: a few microseconds instead of tens for small functions.

    Examples
    --------
    >>> x = ca.SX.sym("x", 2)
    >>> Kernel(ca.Function("f", [x], [2 * x, x[0] * x.T]))([1.0, 3.0])
    (array([2., 6.]), array([[1., 3.]]))
    """

    def __init__(self, function: ca.Function) -> None:
        symbols = function.mx_in()
        dense = ca.Function(function.name(), symbols, [ca.densify(e) for e in function.call(symbols)])
        same = all(function.sparsity_out(i).is_dense() for i in range(function.n_out()))
        buffer: Any
        buffer, self._evaluate = (function if same else dense).buffer()
        self._buffer = buffer  # kept: it owns the memory that the evaluation reads
        self._inputs = [np.zeros(_shape(function.size_in(i)), order="F") for i in range(function.n_in())]
        self._outputs = [np.zeros(_shape(function.size_out(i)), order="F") for i in range(function.n_out())]
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, array.reshape(-1, order="F").data)
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, array.reshape(-1, order="F").data)

    def __call__(self, *values: np.ndarray | list[float] | float) -> tuple[np.ndarray, ...]:
        """Return new arrays; column vectors are flat, scalars have shape (1,)."""
        for array, value in zip(self._inputs, values, strict=True):
            array[...] = value
        self._evaluate()
        return tuple(a.copy() for a in self._outputs)


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    return size if size[1] != 1 else size[:1]


@dataclass(frozen=True, slots=True)
class StepFunctions:
    """Hold the CasADi functions of one System; force = slope * argument + intercept in the current contact mode.

    Every function takes ``x (n,), theta, p (q,), slopes (m,), intercepts (m,)``; a step takes its length in phase too.

    Attributes
    ----------
    step : Kernel
        State after the step (n,), its 5th and 3rd order error estimates (n, 2), contact arguments (m, NODES) at the
        Chebyshev points of the step.
    transition : Kernel
        Takes in addition S (n, n + 1), the derivatives of the state with respect to the initial state and the
        continuation parameter; returns S after the step, the squared norms of its 5th and 3rd order error estimates
        (2, n + 1) column by column, and the integral of the trace of the Jacobian over the step.
    guard : Kernel
        Contact arguments (m,) and their rates along the flow (m,).
    """

    step: Kernel
    transition: Kernel
    guard: Kernel


def step_functions(system: System, parameter: str) -> StepFunctions:
    """Build the functions of a driven System; the variational step differentiates exactly what the step computes.

    Parameters
    ----------
    system : System
        Driven model; its frequency turns time into phase, so that the interval does not depend on it.
    parameter : str
        Parameter of the last column of S.

    Raises
    ------
    ValueError
        If the parameter is unknown.

    Notes
    -----
    Tableau of Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.10. Within a
    mode the law is linear, so that no derivative is ever taken across a contact change.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, theta, omega = (ca.SX.sym(k) for k in ("x", "theta", "omega"))
    >>> decay = System(name="decay", states={"x": x}, derivatives={"x": -x}, phase=theta, frequency="omega",
    ...                parameters={"omega": (omega, 1.0)})
    >>> x1, *_ = step_functions(decay, "omega").step([1.0], 0.0, 0.1, [1.0], [], [])
    >>> bool(abs(x1[0] - 2.718281828459045**-0.1) < 1e-14)
    True
    """
    system.check_parameter(parameter)
    m = len(system.contacts)
    slopes, intercepts = ca.SX.sym("slopes", m), ca.SX.sym("intercepts", m)
    force = slopes * system.arguments + intercepts if m else ca.SX(0, 1)
    omega = system.p[system.parameter_names.index(str(system.frequency))]
    rate = (ca.substitute(system.derivative, system.phi, force) if m else system.derivative) / omega
    p_c = system.p[system.parameter_names.index(parameter)]
    point = [system.x, system.theta, system.p, slopes, intercepts]
    field = ca.Function("field", point, [rate])
    jacobian = ca.jacobian(rate, system.x)
    linear = ca.Function("linear", point, [jacobian, ca.jacobian(rate, p_c), ca.trace(jacobian)])
    arguments = ca.Function("arguments", [system.x, system.theta, system.p], [system.arguments])
    along = ca.jtimes(system.arguments, system.x, rate) + ca.jacobian(system.arguments, system.theta)
    guard = ca.Function("guard", point, [system.arguments, along])
    return StepFunctions(Kernel(_step(field, arguments, m)), Kernel(_transition(field, linear, m)), Kernel(guard))


def _symbols(field: ca.Function, m: int, kind: Any) -> tuple:
    n, q = field.numel_in(0), field.numel_in(2)
    return kind.sym("x", n), kind.sym("theta"), kind.sym("h"), kind.sym("p", q), kind.sym("s", m), kind.sym("c", m)


def _step(field: ca.Function, arguments: ca.Function, m: int) -> ca.Function:
    x, theta, h, p, s, c = given = _symbols(field, m, ca.SX)
    k: list[ca.SX] = []
    for a, fraction in zip(DOP853.A, DOP853.C, strict=True):
        k.append(field(x + h * _combine(a, k), theta + fraction * h, p, s, c))
    x1 = x + h * _combine(DOP853.B, k)
    k.append(field(x1, theta + h, p, s, c))
    error = ca.horzcat(h * _combine(DOP853.E5, k), h * _combine(DOP853.E3, k))
    sampled = ca.SX(0, NODES)
    if m:
        interpolant = _interpolant(field, given, x1, k)
        at = [arguments(x + interpolant @ w, theta + r * h, p) for r, w in zip(*_dense_weights(), strict=True)]
        sampled = ca.horzcat(*at)
    return ca.Function("step", list(given), [x1, error, sampled])


def _interpolant(field: ca.Function, given: tuple, x1: ca.SX, k: list[ca.SX]) -> ca.SX:
    """Return the coefficients (n, 7) of the 7th order interpolant, from three more stages."""
    x, theta, h, p, s, c = given
    stages = list(k)
    for a, fraction in zip(DOP853.A_EXTRA, DOP853.C_EXTRA, strict=True):
        stages.append(field(x + h * _combine(a, stages), theta + fraction * h, p, s, c))
    first = x1 - x
    low = [first, h * k[0] - first, 2 * first - h * (k[-1] + k[0])]
    return ca.horzcat(*low, *(h * _combine(d, stages) for d in DOP853.D))


def _dense_weights() -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the Chebyshev points in [0, 1] and at each the weights (7,) of the interpolant's coefficients."""
    fractions = (chebyshev.chebpts2(NODES) + 1) / 2
    weights = [np.cumprod([r if i % 2 == 0 else 1 - r for i in range(7)]) for r in fractions]
    return fractions, weights


def _transition(field: ca.Function, linear: ca.Function, m: int) -> ca.Function:
    given = _symbols(field, m, ca.MX)
    x, theta, h, p, s, c = given
    n = x.numel()
    before = ca.MX.sym("S", n, n + 1)
    k: list[ca.MX] = []
    dk: list[ca.MX] = []

    def stage(weights: np.ndarray, fraction: float) -> ca.MX:
        state, at = x + h * _combine(weights, k), theta + fraction * h
        jacobian, forcing, divergence = linear(state, at, p, s, c)
        dk.append(jacobian @ (before + h * _combine(weights, dk)) + ca.horzcat(ca.MX(n, n), forcing))
        k.append(field(state, at, p, s, c))
        return divergence

    divergences = [stage(a, fraction) for a, fraction in zip(DOP853.A, DOP853.C, strict=True)]
    trace = h * _combine(DOP853.B, divergences)
    after = before + h * _combine(DOP853.B, dk)
    stage(DOP853.B, 1.0)
    squares = ca.vertcat(*(ca.sum1((h * _combine(e, dk)) ** 2) for e in (DOP853.E5, DOP853.E3)))
    function = ca.Function("transition", [*given, before], [after, squares, trace])
    return function.expand() if n <= _EXPAND_UP_TO else function


def _combine(weights: np.ndarray, stages: list) -> ca.SX | ca.MX | float:
    """Return the weighted sum of the stages so far; weights beyond them belong to later stages and are zero."""
    total: ca.SX | ca.MX | float = 0.0
    for w, stage in zip(weights, stages, strict=False):
        if w != 0.0:
            total = total + float(w) * stage
    return total
