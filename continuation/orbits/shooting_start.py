"""First orbits by shooting: integration until the response settles, Newton's method, the number of segments."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.errors import ContinuationError, NoConvergence, RestingContact
from continuation.orbits.orbit import Orbit
from continuation.orbits.shooting_estimate import shortest
from continuation.orbits.start import begin_at, starting_values
from continuation.timedomain.exact import describe

_SETTLING_PERIODS = (50, 100, 200)  # integrated before each attempt of Newton's method
_NEWTON_STEPS = 12
_HALVINGS = 6
_GROWTH = 1e3  # largest magnification wanted over one segment
_MOST_SEGMENTS = 64


def first_state(problem: Any, values: dict[str, float]) -> tuple[np.ndarray, float]:
    """Find a first orbit: integrate from rest or a given state, then Newton's method.

    With a period multiple above 1 this may be an orbit that repeats earlier, where such a one attracts.

    Parameters
    ----------
    problem : ShootingProblem
    values : mapping
        Value of the continuation parameter, its default when absent, and states to start from, 0 when absent.

    Returns
    -------
    u : ndarray (N,)
    p : float

    Raises
    ------
    NoConvergence
        With the history of residual norms, if Newton's method failed from every start.
    IntegrationFailed
        If the state runs away, or an orbit rests on a contact's breakpoint.
    ValueError
        For an unknown name, or a parameter that is fixed along the branch.
    """
    p, given = starting_values(problem, values)
    x = begin_at(problem, np.zeros(len(problem.system.state_names)), given)
    history = [np.inf]
    for periods in _SETTLING_PERIODS:
        x = problem.integration.settle(x, problem.vector(p), periods)
        u, history = newton(problem, x, p)
        if history[-1] <= tolerance(problem, u):
            return _cut(problem, u, p), p
    raise NoConvergence(
        f"shooting for {problem.system.name!r} found no orbit of {problem.period_multiple} excitation period(s) at "
        f"{describe({problem.parameter: p})}: the residual stayed at {history[-1]:.3g}; the response may be of "
        "another period or irregular there, so try another parameter value or period_multiple",
        history,
        p,
    )


def corrected(problem: Any, orbit: Orbit, value: float) -> np.ndarray:
    """Return the unknown of the orbit at a parameter value, corrected from a neighbouring one."""
    u, history = newton(problem, problem.unknown(orbit), value)
    if history[-1] > tolerance(problem, u):
        raise NoConvergence(
            f"no orbit at {describe({problem.parameter: value})} near the one given, residuals "
            f"{', '.join(f'{r:.1e}' for r in history)}; take a smaller step, or more segments",
            history,
            value,
            orbit,
        )
    return u


def tolerance(problem: Any, u: np.ndarray) -> float:
    """Return the size of a residual that counts as zero."""
    flow = problem.integration
    return 10 * flow.noise * (max(flow.rtol, 1e-13) * float(abs(u).max()) + flow.atol)


def newton(problem: Any, u: np.ndarray, p: float) -> tuple[np.ndarray, list[float]]:
    """Iterate with step halving; return the best unknown and the residual norms (maximum)."""
    f, jacobian, _ = problem.linearise(u, p)
    history = [float(abs(f).max())]
    for _ in range(_NEWTON_STEPS):
        if history[-1] <= tolerance(problem, u) and len(history) > 1:
            break
        step = shortest(jacobian, -f)
        for damping in 0.5 ** np.arange(_HALVINGS):
            trial = u + damping * step
            size = _residual_size(problem, trial, p)
            if size < history[-1]:
                break
        else:
            break
        u = trial
        f, jacobian, _ = problem.linearise(u, p)
        history.append(size)
    return u, history


def _residual_size(problem: Any, u: np.ndarray, p: float) -> float:
    try:
        return float(abs(problem.residual(u, p)).max())
    except RestingContact:
        raise
    except ContinuationError:  # a trial step too far: the flow runs away, and Newton's method halves the step
        return np.inf


def _cut(problem: Any, x: np.ndarray, p: float) -> np.ndarray:
    """Return the unknown of an orbit through x at phase 0 with the wanted number of segments, corrected."""
    if problem.segments is None:
        problem.segments = choose_segments(problem, x[None], p)
    if problem.segments == 1:
        return x
    wave = problem.waveform(x, p, problem.segments)
    u, history = newton(problem, problem.joined(wave), p)
    return u if history[-1] <= tolerance(problem, u) else problem.joined(wave)


def choose_segments(problem: Any, states: np.ndarray, p: float) -> int:
    """Return the number of segments that keeps the growth over each below a thousand, from states (m, n) of an orbit.

    Growth is that of deviations measured in the largest value of every state along the orbit.
    """
    u = problem.joined(states)
    wave = problem.waveform(u, p, 64 * len(states))
    scale = abs(wave).max(axis=0)
    scale = np.where(scale > 0, scale, scale.max() or 1.0)
    product, growth, lost = np.eye(len(scale)), 0.0, 0.0
    for matrix in problem.path(u, p).factors:
        product = matrix @ product
        size = max(float(np.linalg.norm(product * scale / scale[:, None], 2)), 1e-300)
        product, lost = product / size, lost + np.log(size)
        growth = max(growth, lost)
    return min(_MOST_SEGMENTS, max(1, int(np.ceil(growth / np.log(_GROWTH)))))
