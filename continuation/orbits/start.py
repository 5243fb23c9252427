"""A first orbit without a guess: short integration, Fourier coefficients, smoothed law, width to 0."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from continuation.branches.newton import Metric, Node, correct, size_of
from continuation.errors import ContinuationError, NoConvergence, UnsupportedModel
from continuation.model.linear_part import spectral_radius
from continuation.orbits.orbit import Orbit
from continuation.orbits.spectrum import pack, resize

_PERIODS = (30, 200, 1000)
_WIDTHS = ((0.01,), (0.1, 0.03, 0.01, 0.003), (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.003, 0.001))
_SAMPLES = 256
_FEW_SAMPLES = 64  # with many states
_AT_ONCE = 64  # steps in one call; divides the steps per period
_HARMONICS = 15


def find_orbit(problem: Any, values: dict[str, float]) -> Orbit:
    """Return an orbit at the given parameter values; see ``HarmonicBalanceProblem.guess``."""
    p, given = starting_values(problem, values)
    state = begin_at(problem, problem.ports.rest, given)
    failures: list[NoConvergence] = []
    for periods, widths in zip(_PERIODS, _WIDTHS, strict=True):
        waves, state = _integrate(problem, p, state, periods)
        for wave in waves:
            try:
                return _from_waveform(problem, wave, p, widths)
            except NoConvergence as failure:
                if isinstance(failure.__cause__, UnsupportedModel):  # no other start makes a corner smooth
                    raise failure.__cause__ from None
                failures.append(failure)
    raise NoConvergence(
        f"no periodic orbit of period {problem.period_multiple} found at {problem.parameter} = {p:g} "
        f"(last attempt: {failures[-1] if failures else 'the integration diverged'}); "
        "start at another parameter value, away from resonance, or with more damping",
        failures[-1].history if failures else (),
        p,
    )


def starting_values(problem: Any, values: dict[str, float]) -> tuple[float, dict[str, float]]:
    """Return the value of the continuation parameter and the states given; other parameters must be the problem's.

    Raises
    ------
    ValueError
        For an unknown name, what is no number, or another value of a parameter that is fixed in this problem.
    """
    numbers: dict[str, float] = {}
    for name, value in values.items():
        try:
            numbers[name] = float(value)
        except (TypeError, ValueError):
            raise ValueError(f"guess: {name}: expected a number, got {value!r}") from None
    given = {k: v for k, v in numbers.items() if k in problem.system.state_names}
    for name, value in numbers.items():
        if name in given or problem.system.check_parameter(name) == problem.parameter:
            continue
        if value != problem.values[name]:
            raise ValueError(
                f"parameter {name!r} is fixed at {problem.values[name]} in this problem; "
                f"give it to discretise(..., {name}={value}) instead"
            )
    p = numbers.get(problem.parameter, problem.values[problem.parameter])
    problem.frequency(p)  # must be positive
    return p, given


def begin_at(problem: Any, state: np.ndarray, given: dict[str, float]) -> np.ndarray:
    """Return the state with the given ones put in."""
    state = np.array(state, dtype=float)
    for name, value in given.items():
        state[problem.system.state_names.index(name)] = value
    return state


def check_value(problem: Any, value: float) -> None:
    """Raise ValueError for a value of the continuation parameter that no orbit can have."""
    if not np.isfinite(value):
        raise ValueError(f"expected a finite value of {problem.parameter!r}, got {value}")
    if problem.parameter == problem.system.frequency:
        problem.frequency(value)  # must be positive


def check_determined(problem: Any, p: float, error: float, size: float) -> None:
    """Raise NoConvergence for an orbit whose error is larger than itself: the equations do not determine one."""
    if error > max(size, 1e-6):
        raise NoConvergence(
            f"no periodic orbit is determined at {problem.parameter} = {p:g}: the equations are singular to rounding "
            f"there, and what solves them is uncertain by {error:.1e}; at a resonance without damping there is none, "
            "in a family of orbits of one period any will do: add damping or go to another parameter value",
            parameter=p,
        )


def correct_at(problem: Any, u: np.ndarray, p: float) -> Orbit:
    """Correct the unknown at fixed parameter, at the resolution it asks for, and return the Orbit."""
    node, error = _settle(problem, u, p)
    return problem.orbits([(node.u, node.p, error)])[0]


def taken_over(problem: Any, orbit: Orbit) -> Orbit:
    """Bring an orbit of the same System, by whatever method, into a problem.

    Raises
    ------
    ValueError
        If it is of another System, or of other values of the parameters that are fixed in the problem.
    NoConvergence
        With the residual history and the orbit given.
    """
    if orbit.state_names != problem.system.state_names:
        raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {problem.system.name!r}")
    for name, value in problem.values.items():
        given = orbit.parameters.get(name, value)
        if name != problem.parameter and abs(given - value) > 1e-9 * max(abs(given), abs(value)):
            raise ValueError(
                f"the orbit is of {name} = {given:g}, the problem of {name} = {value:g}; "
                f"give {name}={given:g} to discretise"
            )
    return problem.solve(orbit, orbit.parameters[problem.parameter])


def solve_from(problem: Any, orbit: Orbit, value: float) -> Orbit:
    """Correct a neighbouring orbit at a value of the continuation parameter.

    Raises
    ------
    NoConvergence
        With the parameter value, the residual history and the orbit it started from.
    """
    check_value(problem, value)
    try:
        return correct_at(problem, problem.unknown(orbit), value)
    except NoConvergence as failure:
        raise NoConvergence(
            f"no orbit at {problem.parameter} = {value:g} found from the one at "
            f"{orbit.parameters[problem.parameter]:g}: {failure}; take a smaller step, or trace the branch",
            failure.history,
            value,
            orbit,
        ) from failure


def _settle(problem: Any, u: np.ndarray, p: float) -> tuple[Node, float]:
    error = np.inf
    for _ in range(12):
        metric = Metric(size_of(u), problem.parameter_scale(p))
        node = correct(problem, (u, p), (np.zeros_like(u), 1.0), metric, iterations=40)
        u, error = problem.adapt(node.u, node.p)
        if len(u) <= len(node.u):
            return node, error
    return node, error


def _from_waveform(problem: Any, wave: np.ndarray, p: float, widths: tuple[float, ...]) -> Orbit:
    """Newton on smoothed laws of decreasing width, then on the exact one, from samples (N, k) at the ports."""
    k = problem.ports.outputs
    Y = np.fft.rfft(wave, axis=0)[: len(wave) // 3] / len(wave)
    Y[0] = Y[0].real
    H = problem.method.harmonics or max(_HARMONICS, problem.least_harmonics(p))
    u = resize(pack(Y), k, H)
    if problem.system.contacts:
        scale = min(float(np.ptp(c.breakpoints)) or 1.0 for c in problem.system.contacts) / 2
        for width in widths:
            soft = type(problem)(
                problem.method, problem.system.smoothed(width * scale), problem.parameter, problem.period_multiple,
                problem.values,
            )  # fmt: skip
            metric = Metric(size_of(u), problem.parameter_scale(p))
            if problem.large:
                soft.share(problem, p)
            try:
                C = soft.ports.linear(soft.vector(p)).C
                if not np.array_equal(C, problem.ports.linear(problem.vector(p)).C):
                    break  # the smoothed law has other ports: go on with the exact one
                u = correct(soft, (u, p), (np.zeros_like(u), 1.0), metric, iterations=40).u
            except NoConvergence:
                continue  # the next, smaller width or the exact law may still converge from here
    return correct_at(problem, u, p)


def _integrate(problem: Any, p: float, state: np.ndarray, periods: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Integrate with classical Runge-Kutta; return the port arguments (last, averaged) over one orbit, and the end."""
    system, n = problem.system, problem.period_multiple
    steps = _steps(problem, p)
    vector, omega = problem.vector(p), problem.frequency(p) * n
    x, theta = system.x, ca.SX.sym("theta")
    f = ca.Function("f", [x, theta], [ca.substitute(system.closed(), ca.vertcat(system.theta, system.p),
                                                    ca.vertcat(theta, ca.DM(vector))) / omega])  # fmt: skip
    h = 2 * np.pi / steps
    k1 = f(x, theta)
    k2 = f(x + h / 2 * k1, theta + h / 2)
    k3 = f(x + h / 2 * k2, theta + h / 2)
    k4 = f(x + h * k3, theta + h)
    step = ca.Function("step", [x, theta], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    march = _march(step, problem.ports.linear(vector).C, _AT_ONCE)
    phases = (np.arange(steps * n) * h).reshape(-1, 1, _AT_ONCE)
    waves: list[np.ndarray] = []
    for _ in range(max(1, periods // n)):
        pieces, end = [], state
        for at in phases:
            y, end = march(end, at)
            pieces.append(np.array(y))
        end = np.array(end).ravel()
        if not np.all(np.isfinite(end)) or np.abs(end).max() > 1e12:
            if not waves:
                return [], np.zeros_like(state)
            break
        waves = [*waves[-15:], np.hstack(pieces).T]
        state = end
    stride = max(1, steps * n // (_SAMPLES * n))
    last, mean = waves[-1][::stride], np.mean(waves, axis=0)[::stride]
    return [last, mean], state


def _march(step: ca.Function, C: np.ndarray, count: int) -> ca.Function:
    """Return ``(x, phases (1, count)) -> C x at these phases (k, count), x after the last``: states in between go."""
    x, phases = ca.MX.sym("x", step.size1_in(0)), ca.MX.sym("phases", 1, count)
    seen, end = [], x
    for i in range(count):
        seen.append(ca.DM(sp.csc_matrix(C)) @ end)
        end = step(end, phases[i])
    return ca.Function("march", [x, phases], [ca.horzcat(*seen), end])


def _steps(problem: Any, p: float) -> int:
    """Steps per excitation period, a power of two, that keep Runge-Kutta stable for the linear part."""
    part = problem.ports.linear(problem.vector(p))
    radius = spectral_radius(part.shifted())
    turns = radius * 2 * np.pi / (problem.frequency(p) * problem.period_multiple)
    if not turns < 2e5:
        raise ContinuationError(
            f"the linear part turns {turns:.1e} rad per period, too stiff for the starting integration; "
            "start from an orbit of a softer system"
        )
    return max(_FEW_SAMPLES if problem.large else _SAMPLES, 1 << int(np.ceil(np.log2(max(turns, 1.0)))))
