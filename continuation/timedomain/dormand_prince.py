"""One step of the Dormand-Prince 8(5,3) method inside a contact mode, as CasADi functions of the excitation phase.

Tableau of Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., section II.10. Within a mode
every contact force is ``slope * argument + intercept``, so that no derivative is ever taken across a contact change.
The functions take ``x (n,), theta, h, p (q,), slopes (m,), intercepts (m,)``, h the length in phase.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev
from scipy.integrate import DOP853

NODES = 13
"""Chebyshev points inside a step at which the contact arguments are sampled."""

MARCHED = 16
"""Steps tried in one call of a march."""

LARGEST_STEP = np.pi / 4
"""Longest step in phase: a stiffness harmonic must not slip through a step that meets a zero of the force."""

TO_CHEBYSHEV = np.linalg.inv(chebyshev.chebvander(chebyshev.chebpts2(NODES), NODES - 1))
"""Values at the Chebyshev points to coefficients."""

GOING, ENDED, CONTACT, STUCK = range(4)
"""Why a march stopped: not yet, end of the interval, a contact may change in the next step, step length underflow."""

_UNROLLED = 8  # states up to which step matrices are made by scalar operations


def symbols(field: ca.Function, m: int, kind: Any) -> tuple:
    """Return symbols of the arguments of a step, SX or MX."""
    n, q = field.numel_in(0), field.numel_in(2)
    return kind.sym("x", n), kind.sym("theta"), kind.sym("h"), kind.sym("p", q), kind.sym("s", m), kind.sym("c", m)


def stages(field: ca.Function, given: tuple) -> tuple[list[ca.SX], ca.SX]:
    """Return the 12 stages and the state after the step."""
    x, theta, h, p, s, c = given
    k: list[ca.SX] = []
    for a, fraction in zip(DOP853.A, DOP853.C, strict=True):
        k.append(field(x + h * _combine(a, k), theta + fraction * h, p, s, c))
    return k, x + h * _combine(DOP853.B, k)


def step(field: ca.Function, arguments: ca.Function, m: int) -> ca.Function:
    """Return the step: state after it, error estimates (n, 2), contact arguments (m, NODES) at Chebyshev points."""
    x, theta, h, p, _, _ = given = symbols(field, m, ca.SX)
    k, x1 = stages(field, given)
    error = ca.horzcat(h * _combine(DOP853.E5, k), h * _combine(DOP853.E3, k))
    sampled = ca.SX(0, NODES)
    if m:
        interpolant = _interpolant(field, given, x1, k)
        at = [arguments(x + interpolant @ w, theta + r * h, p) for r, w in zip(*_dense_weights(), strict=True)]
        sampled = ca.horzcat(*at)
    return ca.Function("step", list(given), [x1, error, sampled])


def _interpolant(field: ca.Function, given: tuple, x1: ca.SX, k: list[ca.SX]) -> ca.SX:
    """Return the coefficients (n, 7) of the 7th order interpolant, from four more stages."""
    x, theta, h, p, s, c = given
    stages = [*k, field(x1, theta + h, p, s, c)]
    for a, fraction in zip(DOP853.A_EXTRA, DOP853.C_EXTRA, strict=True):
        stages.append(field(x + h * _combine(a, stages), theta + fraction * h, p, s, c))
    first = x1 - x
    low = [first, h * k[0] - first, 2 * first - h * (stages[12] + k[0])]
    return ca.horzcat(*low, *(h * _combine(d, stages) for d in DOP853.D))


def dense_weights(fractions: np.ndarray) -> np.ndarray:
    """Return the weights (N, 8) of the coefficients of :attr:`StepFunctions.dense` at fractions (N,) of a step."""
    factors = np.stack([fractions if i % 2 == 0 else 1 - fractions for i in range(7)], axis=-1)
    middle = (4 * fractions * (1 - fractions)) ** 4
    return np.concatenate([np.cumprod(factors, axis=-1), middle[..., None]], axis=-1)


def _dense_weights() -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the Chebyshev points in [0, 1] and at each the weights (7,) of the interpolant's coefficients."""
    fractions = (chebyshev.chebpts2(NODES) + 1) / 2
    return fractions, list(dense_weights(fractions)[:, :7])


def dense(field: ca.Function, m: int) -> ca.Function:
    """Return the coefficients (n, 8) of the interpolant, the last from half a step, which is more accurate."""
    x, theta, h, p, s, c = given = symbols(field, m, ca.SX)
    k, x1 = stages(field, given)
    interpolant = _interpolant(field, given, x1, k)
    middle = stages(field, (x, theta, h / 2, p, s, c))[1]
    off = middle - x - interpolant @ dense_weights(np.array([0.5]))[0, :7]
    return ca.Function("dense", list(given), [ca.horzcat(interpolant, off)])


def march(step: ca.Function, m: int) -> ca.Function:
    """Return the function (y, k) -> Y (n + 3, MARCHED) of so many steps tried one after another.

    ``y = [x, theta, h, state]`` with the next step length h and GOING, ENDED, CONTACT or STUCK; what follows a stop
    repeats it. ``k = [p, slopes, intercepts, low (m), high (m), end, longest, rtol, atol]`` with the breakpoints on
    both sides of each contact argument. A step is taken only when no argument can reach one: its interpolant
    is bounded by the sum of its Chebyshev coefficients.
    """
    n, q = step.numel_in(0), step.numel_in(3)
    y, k = ca.SX.sym("y", n + 3), ca.SX.sym("k", q + 4 * m + 4)
    p, s, c, low, high, rest = ca.vertsplit(k, np.cumsum([0, q, m, m, m, m, 4]).tolist())
    end, longest, rtol, atol = ca.vertsplit(rest)
    x, theta, left = y[:n], y[n], end - y[n]
    h = ca.fmin(ca.fmin(y[n + 1], longest), left)
    x1, error, sampled = step(x, theta, h, p, s, c)
    scaled = (error / ca.repmat(atol + rtol * ca.fmax(ca.fabs(x), ca.fabs(x1)), 1, 2)) ** 2
    fifth, third = ca.sum1(scaled[:, 0]), ca.sum1(scaled[:, 1])
    size = ca.if_else(fifth == 0, 0, fifth / ca.sqrt((fifth + 0.01 * third) * n))
    accurate = size < 1
    grown = ca.fmin(h * ca.fmin(5, 0.9 * ca.fmax(size, 1e-30) ** -0.125), longest)
    shrunk = h * ca.fmax(0.2, 0.9 * size**-0.125)
    near = ca.SX(0)
    for i in range(m):
        series = ca.DM(TO_CHEBYSHEV) @ sampled[i, :].T
        spread = ca.sum1(ca.fabs(series[1:]))
        near = ca.fmax(near, ca.fmax(high[i] - series[0] <= spread, series[0] - low[i] <= spread))
    met = ca.logic_and(accurate, near)
    taken = ca.logic_and(accurate, ca.logic_not(near))
    last = ca.logic_and(taken, left - h <= 1e-13 * ca.fmax(ca.fabs(end), 1))
    following = ca.if_else(met, h, ca.if_else(accurate, grown, shrunk))
    stuck = ca.logic_not(following > 1e-14 * ca.fmax(ca.fabs(end), 1))
    state = ca.if_else(last, ENDED, ca.if_else(met, CONTACT, ca.if_else(stuck, STUCK, GOING)))
    after = ca.if_else(last, end, ca.if_else(taken, theta + h, theta))
    y1 = ca.vertcat(*(ca.if_else(taken, x1[i], x[i]) for i in range(n)), after, following, state)
    tried = ca.Function("tried", [y, k], [y1])
    return _repeated(tried, n)


def _repeated(tried: ca.Function, n: int) -> ca.Function:
    """Return the columns of repeated tries; once stopped, nothing is evaluated any more."""
    y, k = ca.MX.sym("y", n + 3), ca.MX.sym("k", tried.numel_in(1))
    idle = ca.Function("idle", [y, k], [y])
    attempt = ca.Function.if_else("attempt", tried, idle)
    columns = [y]
    for _ in range(MARCHED):
        columns.append(attempt(columns[-1][n + 2] == GOING, columns[-1], k))
    return ca.Function("march", [y, k], [ca.horzcat(*columns[1:])])


def jacobians(field: ca.Function, jacobian: ca.Function, arguments: ca.Function, m: int) -> ca.Function:
    """Return the function of a step -> integrated trace, contact arguments (m, 12), 12 Jacobians at the stages."""
    x, theta, h, p, s, c = given = symbols(field, m, ca.SX)
    k = stages(field, given)[0]
    states = [(x + h * _combine(a, k), theta + f * h) for a, f in zip(DOP853.A, DOP853.C, strict=True)]
    slopes = [jacobian(state, phase, p, s, c) for state, phase in states]
    trace = h * _combine(DOP853.B, [ca.trace(a) for a in slopes])
    met = ca.horzcat(*(arguments(state, phase, p) for state, phase in states))
    return ca.Function("stages", list(given), [trace, met, *slopes])


def transition(stages: ca.Function, field: ca.Function, m: int) -> ca.Function:
    """Return the step matrix (n, n), squared column norms (2, n) of its error estimates, trace, contact arguments."""
    given = symbols(field, m, ca.MX)  # matrices stay matrices: unrolled, 14 states make 40,000 operations
    n, h, unit = given[0].numel(), given[2], ca.MX.eye(given[0].numel())
    trace, met, *slopes = stages(*given)
    rates = [ca.densify(slopes[0])]
    for slope, weights in zip(slopes[1:], DOP853.A[1:], strict=True):
        rates.append(slope @ (unit + h * _combine(weights, rates)))
    squares = [ca.sum1((h * _combine(e, rates)) ** 2) for e in (DOP853.E5, DOP853.E3)]
    results = [unit + h * _combine(DOP853.B, rates), ca.vertcat(*squares), trace, met]
    function = ca.Function("transition", list(given), results)
    return function.expand() if n <= _UNROLLED else function


def second(field: ca.Function, m: int) -> ca.Function:
    """Return the gradients of ``a . x1 + b . (dx1/dx xi)``; see :attr:`StepFunctions.second`."""
    x, _, _, p, _, _ = given = symbols(field, m, ca.SX)
    n = x.numel()
    xi, a, b = (ca.SX.sym(name, n) for name in ("xi", "a", "b"))
    x1 = stages(field, given)[1]
    form = ca.dot(a, x1) + ca.dot(b, ca.jtimes(x1, x, xi))
    return ca.Function("second", [*given, xi, a, b], [ca.gradient(form, v) for v in (x, xi, p)])


def _combine(weights: np.ndarray, stages: list) -> ca.SX | float:
    """Return the weighted sum of the stages so far; weights beyond them belong to later stages and are zero."""
    total: ca.SX | float = 0.0
    for w, stage in zip(weights, stages, strict=False):
        if w != 0.0:
            total = total + float(w) * stage
    return total
