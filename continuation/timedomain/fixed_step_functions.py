"""One explicit Runge-Kutta step inside a contact mode, as CasADi functions of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853, RK45

from continuation.model.extension import extended
from continuation.model.system import System

TABLEAUS: dict[int, tuple[Any, Any, Any]] = {
    2: ([[], [0.5]], [0.0, 1.0], [0.0, 0.5]),
    4: ([[], [0.5], [0.0, 0.5], [0.0, 0.0, 1.0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6], [0.0, 0.5, 0.5, 1.0]),
    5: (RK45.A, RK45.B, RK45.C),
    8: (DOP853.A, DOP853.B, DOP853.C),
}
"""A, b, c by order: midpoint, classical Runge-Kutta, Dormand-Prince 5 and 8 (Hairer, Norsett, Wanner, II.1 to II.5)."""


@dataclass(frozen=True, slots=True, eq=False)
class ModeModel:
    """Hold a model whose contact forces are slope * argument + intercept, as expressions of its own symbols.

    Attributes
    ----------
    x, theta, p, slopes, intercepts : SX (n,), (1,), (q,), (m,), (m,)
    rate : SX (n,)
        dx/dt.
    frequency : SX
        dtheta/dt.
    arguments : SX (m,)
        Contact arguments.
    observed : SX (o,)
        Quantities of which statistics are kept.
    laws : tuple of (breakpoints, slopes, intercepts)
        Numbers of every contact.
    """

    x: ca.SX
    theta: ca.SX
    p: ca.SX
    slopes: ca.SX
    intercepts: ca.SX
    rate: ca.SX
    frequency: ca.SX
    arguments: ca.SX
    observed: ca.SX
    laws: tuple[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]], ...]


def mode_model(system: System, quantities: tuple[str, ...] = (), *, land: bool = True) -> ModeModel:
    """Return the model of a System in its contact modes.

    Parameters
    ----------
    quantities : tuple of str
        States or outputs to observe.
    land : bool
        False: no modes, the exact laws are part of the right-hand side and steps go over their corners.
    """
    count = len(system.contacts) if land else 0
    s, c = ca.SX.sym("s", count), ca.SX.sym("c", count)
    force = extended(system, s * system.arguments + c) if land else system.forces()
    known = dict(zip(system.state_names, ca.vertsplit(system.x), strict=True))
    known |= dict(zip(system.output_names, ca.vertsplit(system.outputs), strict=True)) if system.output_names else {}
    observed = ca.vertcat(*(known[name] for name in quantities))
    rate, observed = ca.substitute([system.derivative, ca.SX(observed)], [system.phi], [force])
    omega = ca.SX(1) if system.frequency is None else system.p[system.parameter_names.index(system.frequency)]
    arguments = system.arguments if land else ca.SX(0, 1)
    laws = tuple((k.breakpoints, k.slopes, tuple(k.intercepts.tolist())) for k in system.contacts[:count])
    return ModeModel(system.x, system.theta, system.p, s, c, rate, omega, arguments, observed, laws)


@dataclass(frozen=True, slots=True, eq=False)
class StepFunctions:
    """Hold the CasADi functions of a fixed-step march; e is all that depends on parameters and phase alone.

    Attributes
    ----------
    forcing : Function
        ``theta, p -> e``.
    begin : Function
        ``x, e, s, c -> k, a, r``: dx/dt, contact arguments and their rates.
    step : Function
        ``x, k, h, E, s, c -> x, k, a, r`` after a step of length h in time, E being e at every one of
        :attr:`fractions` of the step, side by side.
    observe : Function
        ``x, k, theta, p, s, c -> y, dy/dt``.
    fractions : tuple of float
        Distinct instants of the stages in the step, ending with 1.
    order : int
    """

    forcing: ca.Function
    begin: ca.Function
    step: ca.Function
    observe: ca.Function
    fractions: tuple[float, ...]
    order: int


def step_functions(model: ModeModel, order: int) -> StepFunctions:
    """Build the functions of a model.

    What depends on parameters and phase alone is computed once per point of the grid: a step then contains no sines.
    """
    k = ca.SX.sym("k", model.x.numel())
    along = ca.jtimes(model.arguments, model.x, k) + model.frequency * ca.jacobian(model.arguments, model.theta)
    parts = [model.rate, model.arguments, along]
    parts, e, e_of = _extract(parts, ca.vertcat(model.theta, model.p))
    modes = [model.slopes, model.intercepts]
    field = ca.Function("field", [model.x, e, *modes], [parts[0]])
    guard = ca.Function("guard", [model.x, k, e, *modes], parts[1:])
    rate = field(model.x, e, *modes)
    dy = ca.jtimes(model.observed, model.x, k) + model.frequency * ca.jacobian(model.observed, model.theta)
    step, fractions = _step(field, guard, order)
    return StepFunctions(
        forcing=ca.Function("forcing", [model.theta, model.p], [e_of]),
        begin=ca.Function("begin", [model.x, e, *modes], ca.cse([rate, *guard(model.x, rate, e, *modes)])),
        step=step,
        observe=ca.Function("observe", [model.x, k, model.theta, model.p, *modes], ca.cse([model.observed, dy])),
        fractions=fractions,
        order=order,
    )


def _extract(parts: list[ca.SX], known: ca.SX) -> tuple[list[ca.SX], ca.SX, ca.SX]:
    """Return the expressions with all that depends on known symbols alone replaced, the new symbols, what they are."""
    flat = ca.cse(ca.vertcat(*(ca.densify(part) for part in parts)))
    left, symbols, meaning = ca.extract_parametric(flat, known, {"extract_trivial": True})
    pieces = ca.vertsplit(left, np.cumsum([0, *(part.numel() for part in parts)]).tolist())
    return pieces, ca.SX(ca.vertcat(*symbols)), ca.SX(ca.vertcat(*meaning))


def _step(field: ca.Function, guard: ca.Function, order: int) -> tuple[ca.Function, tuple[float, ...]]:
    A, b, c = TABLEAUS[order]
    fractions = (*sorted({float(v) for v in c if v not in (0.0, 1.0)}), 1.0)
    n, m = field.numel_in(0), field.numel_in(2)
    x, k, h = ca.SX.sym("x", n), ca.SX.sym("k", n), ca.SX.sym("h")
    E = ca.SX.sym("E", field.numel_in(1), len(fractions))
    modes = [ca.SX.sym("s", m), ca.SX.sym("c", m)]
    stages = [k]
    for row, fraction in zip(A[1:], c[1:], strict=True):
        state = _add(x, h, row, stages)
        stages.append(field(state, E[:, fractions.index(float(fraction))], *modes))
    x1 = _add(x, h, b, stages)
    k1 = field(x1, E[:, -1], *modes)
    results = [x1, k1, *guard(x1, k1, E[:, -1], *modes)]
    return ca.Function("step", [x, k, h, E, *modes], ca.cse(results)), fractions


def _add(x: ca.SX, h: ca.SX, weights: Any, stages: list[ca.SX]) -> ca.SX:
    for weight, stage in zip(weights, stages, strict=False):
        if weight != 0.0:
            x = x + (h * float(weight)) * stage
    return x
