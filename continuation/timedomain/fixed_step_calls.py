"""CasADi functions that the virtual march calls: many steps, or steps from any phase."""

from __future__ import annotations

import casadi as ca

from continuation.timedomain.fixed_step_functions import StepFunctions


def _forces(functions: StepFunctions, theta: ca.SX, span: ca.SX, p: ca.SX) -> ca.SX:
    return ca.horzcat(*(functions.forcing(theta + f * span, p) for f in functions.fractions))


def grid(functions: StepFunctions) -> ca.Function:
    """Return ``theta, span, p -> E`` at every stage of a step of that phase."""
    theta, span, p = ca.SX.sym("theta"), ca.SX.sym("span"), ca.SX.sym("p", functions.forcing.numel_in(1))
    return ca.Function("grid", [theta, span, p], [_forces(functions, theta, span, p)])


def begin(functions: StepFunctions) -> ca.Function:
    """Return ``x, theta, p, s, c -> k, a, r`` at any phase."""
    one = functions.begin
    x, s, c = (ca.SX.sym(name, one.numel_in(i)) for name, i in (("x", 0), ("s", 2), ("c", 3)))
    theta, p = ca.SX.sym("theta"), ca.SX.sym("p", functions.forcing.numel_in(1))
    return ca.Function("begin", [x, theta, p, s, c], list(one(x, functions.forcing(theta, p), s, c)))


def attempt(functions: StepFunctions) -> ca.Function:
    """Return ``x, k, phase, h, turn, p, s, c -> x, k, a, r`` after a step from any phase."""
    step = functions.step
    x, k, s, c = (ca.SX.sym(name, step.numel_in(i)) for name, i in (("x", 0), ("k", 1), ("s", 4), ("c", 5)))
    theta, h, turn, p = ca.SX.sym("t"), ca.SX.sym("h"), ca.SX.sym("turn"), ca.SX.sym("p", functions.forcing.numel_in(1))
    results = step(x, k, h, _forces(functions, theta, h * turn, p), s, c)
    return ca.Function("attempt", [x, k, theta, h, turn, p, s, c], list(results))


def repeated(step: ca.Function, count: int) -> ca.Function:
    """Return ``x, k, h, E side by side, s, c -> `` the points after each of the steps, side by side."""
    n, m = step.numel_in(0), step.numel_in(4)
    x, k, h = ca.MX.sym("x", n), ca.MX.sym("k", n), ca.MX.sym("h")
    E = ca.MX.sym("E", step.size1_in(3), step.size2_in(3) * count)
    s, c = ca.MX.sym("s", m), ca.MX.sym("c", m)
    many = step.mapaccum("steps", count, 2)
    repeated = [ca.repmat(v, 1, count) for v in (h, s, c)]
    results = many(x, k, repeated[0], E, *repeated[1:])
    return ca.Function("steps", [x, k, h, E, s, c], list(results))


def side_by_side(observe: ca.Function, count: int) -> ca.Function:
    """Return ``x, k, theta, p, s, c -> y, dy/dt`` at many points as columns."""
    n, q, m = observe.numel_in(0), observe.numel_in(3), observe.numel_in(4)
    x, k, theta, p = ca.MX.sym("x", n, count), ca.MX.sym("k", n, count), ca.MX.sym("t", 1, count), ca.MX.sym("p", q)
    s, c = ca.MX.sym("s", m, count), ca.MX.sym("c", m, count)
    results = observe.map(count)(x, k, theta, ca.repmat(p, 1, count), s, c)
    return ca.Function("observed", [x, k, theta, p, s, c], list(results))
