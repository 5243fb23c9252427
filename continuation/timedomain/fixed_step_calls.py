"""CasADi functions that the virtual march calls; points are columns of state, its derivative, arguments and rates."""

from __future__ import annotations

import casadi as ca

from continuation.timedomain.fixed_step_functions import StepFunctions


def _forces(functions: StepFunctions, theta: ca.SX, span: ca.SX, p: ca.SX) -> ca.SX:
    return ca.horzcat(*(functions.forcing(theta + f * span, p) for f in functions.fractions))


def grid(functions: StepFunctions) -> ca.Function:
    """Return ``theta, span, p -> E`` at every stage of a step of that phase."""
    theta, span, p = ca.SX.sym("theta"), ca.SX.sym("span"), ca.SX.sym("p", functions.forcing.numel_in(1))
    return ca.Function("grid", [theta, span, p], [_forces(functions, theta, span, p)])


def attempt(functions: StepFunctions) -> ca.Function:
    """Return ``(x, k), theta, h, turn, p, s, c -> point`` after a step from any phase."""
    step = functions.step
    n, m = step.numel_in(0), step.numel_in(4)
    xk, s, c, theta, h, turn, p = _symbols(functions, 2 * n, m)
    results = step(xk[:n], xk[n:], h, _forces(functions, theta, h * turn, p), s, c)
    return ca.Function("attempt", [xk, theta, h, turn, p, s, c], [ca.cse(ca.vertcat(*results))])


def restart(functions: StepFunctions) -> ca.Function:
    """Return ``x, theta, h, turn, p, s, c -> point, point`` at any phase and after a step from there."""
    step, n, m = functions.step, functions.step.numel_in(0), functions.step.numel_in(4)
    x, s, c, theta, h, turn, p = _symbols(functions, n, m)
    here = functions.begin(x, functions.forcing(theta, p), s, c)
    there = step(x, here[0], h, _forces(functions, theta, h * turn, p), s, c)
    points = ca.cse([ca.vertcat(x, *here), ca.vertcat(*there)])
    return ca.Function("restart", [x, theta, h, turn, p, s, c], points)


def _symbols(functions: StepFunctions, n: int, m: int) -> tuple[ca.SX, ...]:
    x, s, c = (ca.SX.sym(name, size) for name, size in (("x", n), ("s", m), ("c", m)))
    theta, h, turn = (ca.SX.sym(name) for name in ("theta", "h", "turn"))
    return x, s, c, theta, h, turn, ca.SX.sym("p", functions.forcing.numel_in(1))


def repeated(step: ca.Function, count: int) -> ca.Function:
    """Return ``(x, k), h, E side by side, s, c -> `` the points after each of the steps, side by side."""
    n, m = step.numel_in(0), step.numel_in(4)
    xk, h = ca.MX.sym("xk", 2 * n), ca.MX.sym("h")
    E = ca.MX.sym("E", step.size1_in(3), step.size2_in(3) * count)
    s, c = ca.MX.sym("s", m), ca.MX.sym("c", m)
    many = step.mapaccum("steps", count, 2)
    repeated = [ca.repmat(v, 1, count) for v in (h, s, c)]
    results = many(xk[:n], xk[n:], repeated[0], E, *repeated[1:])
    return ca.Function("steps", [xk, h, E, s, c], [ca.vertcat(*results)])


def side_by_side(observe: ca.Function, count: int) -> ca.Function:
    """Return ``x, k, theta, p, s, c -> y, dy/dt`` at many points as columns."""
    n, q, m = observe.numel_in(0), observe.numel_in(3), observe.numel_in(4)
    x, k, theta, p = ca.MX.sym("x", n, count), ca.MX.sym("k", n, count), ca.MX.sym("t", 1, count), ca.MX.sym("p", q)
    s, c = ca.MX.sym("s", m, count), ca.MX.sym("c", m, count)
    results = observe.map(count)(x, k, theta, ca.repmat(p, 1, count), s, c)
    return ca.Function("observed", [x, k, theta, p, s, c], list(results))
