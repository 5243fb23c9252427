"""A first cycle of an autonomous System: integrate until it attracts, then find the time of its return."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from continuation.errors import NoConvergence, nearest
from continuation.orbits.orbit import Orbit
from continuation.timedomain.runge_kutta import Kernel

_RTOL = 1e-6  # of the integration that settles; the orbit itself is integrated a thousand times finer
_STARTS = 3
_STRETCHES = (20.0, 60.0, 200.0, 800.0)  # integration time until the next look, first in 1, then in cycles
_RETURNS = (4, 32)  # cycles looked at for a return, first and second look
_CLOSE = 1e-3  # distance after a period over the size of the orbit that counts as a return
_STILL = 1e-5  # movement over the largest state seen below which the flow has come to rest
_SAMPLES = 512
_TAIL = 1e-6


def find_cycle(problem: Any, values: dict[str, float]) -> Orbit:
    """Return a crude attracting cycle, without verdict, to be corrected by a method.

    Parameters
    ----------
    problem : Problem of an autonomous System
    values : mapping
        The continuation parameter's value, and states to start the integration from; other states start at seeded
        random numbers of size 1.

    Raises
    ------
    NoConvergence
        If the integration runs away, settles on an equilibrium or does not return within a few tens of cycles.
    ValueError
        For an unknown name, or a parameter that is fixed along the branch.
    """
    system = problem.system
    p, begin = _read(problem, values)
    vector = np.array([problem.values[k] for k in system.parameter_names])
    vector[system.parameter_names.index(problem.parameter)] = p
    f = Kernel(ca.Function("f", [system.x, system.p], [ca.substitute(system.closed(), system.theta, 0.0)]))
    rng, reason = np.random.default_rng(0), ""
    for _ in range(_STARTS):
        x = rng.standard_normal(len(system.state_names))
        for name, value in begin.items():
            x[system.state_names.index(name)] = value
        found, reason = _settle(lambda t, y: f(y, vector)[0], x)
        if found is not None:
            return _orbit(problem, p, vector, *found)
    raise NoConvergence(
        f"no cycle of {system.name!r} found at {problem.parameter} = {p:g}: {reason}; give states to start from, e.g. "
        f"guess({problem.parameter}={p:g}, {system.state_names[0]}=1.0), or another parameter value",
        parameter=p,
    )


def _read(problem: Any, values: dict[str, float]) -> tuple[float, dict[str, float]]:
    system = problem.system
    begin = {k: float(v) for k, v in values.items() if k in system.state_names}
    for name in values:
        if name in begin or name == problem.parameter:
            continue
        if name not in system.parameter_names:
            known = [problem.parameter, *system.state_names]
            raise ValueError(f"guess: no parameter or state {name!r}; {nearest(name, known)}")
        if values[name] != problem.values[name]:
            raise ValueError(
                f"parameter {name!r} is fixed in this problem; give it to discretise(..., {name}=...) instead"
            )
    return float(values.get(problem.parameter, problem.values[problem.parameter])), begin


def _settle(f: Any, x: np.ndarray) -> tuple[tuple[np.ndarray, float] | None, str]:
    """Return (samples over one cycle (N, n), period), or None with the reason."""
    reason, unit, largest = "", 1.0, 0.0
    for k, stretch in enumerate((*_STRETCHES, _STRETCHES[-1], _STRETCHES[-1])):
        run = solve_ivp(f, (0.0, stretch * unit), x, method="DOP853", rtol=_RTOL, atol=1e-9)
        if not run.success or not np.all(np.isfinite(run.y)) or np.abs(run.y).max() > 1e12:
            return None, "the integration runs away"
        x = run.y[:, -1]
        late = run.y[:, run.y.shape[1] // 2 :]
        spread = np.ptp(late, axis=1)
        largest = max(largest, float(np.abs(run.y).max()))
        if spread.max() < _STILL * largest and k > 0:
            return None, "the integration settles on an equilibrium"
        unit = _cycle_time(run, unit)
        if k == 0:
            continue
        for cycles in _RETURNS:
            found = _return(f, x, unit, float(spread.max()), cycles)
            if found is not None:
                return found, ""
        reason = f"no return within {_RETURNS[-1]} cycles"
    return None, reason


def _cycle_time(run: Any, unit: float) -> float:
    """Return the mean time between upward crossings of the mean in the second half, of the state that moves most."""
    half = run.t >= run.t[-1] / 2
    t, y = run.t[half], run.y[:, half]
    row = y[int(np.argmax(np.ptp(y, axis=1) / (np.abs(y).max(axis=1) + 1e-300)))]
    level = row.mean()
    ups = t[1:][(row[:-1] < level) & (row[1:] >= level)]
    return float(np.diff(ups).mean()) if len(ups) > 2 else unit


def _return(f: Any, x: np.ndarray, unit: float, size: float, cycles: int) -> tuple[np.ndarray, float] | None:
    """Return the orbit through x if the flow comes back to it within some cycles."""
    normal = f(0.0, x)
    run = solve_ivp(f, (0.0, cycles * unit), x, method="DOP853", rtol=_RTOL / 1e3, atol=1e-9, dense_output=True)
    if not run.success:
        return None
    t = np.linspace(0.0, run.t[-1], 64 * cycles)
    height = normal @ (run.sol(t) - x[:, None])
    ups = np.flatnonzero((height[:-1] < 0) & (height[1:] >= 0))
    for i in ups:
        period = float(brentq(lambda s: normal @ (run.sol(s) - x), t[i], t[i + 1], xtol=1e-12))
        if np.abs(run.sol(period) - x).max() < _CLOSE * size:
            times = period * np.arange(_SAMPLES) / _SAMPLES
            return run.sol(times).T, period
    return None


def _orbit(problem: Any, p: float, vector: np.ndarray, wave: np.ndarray, period: float) -> Orbit:
    n = wave.shape[1]
    spectrum = np.fft.rfft(wave, axis=0)[: _SAMPLES // 3] / _SAMPLES
    size = np.abs(spectrum).max(axis=1)
    last = int(np.flatnonzero(size > _TAIL * size[1:].max())[-1])  # the method adds what it needs
    return Orbit(
        system=problem.system.name,
        state_names=problem.system.state_names,
        parameter=problem.parameter,
        parameters=dict(zip(problem.system.parameter_names, vector.tolist(), strict=True)),
        period=period,
        period_multiple=problem.period_multiple,
        coefficients=spectrum[: last + 1],
        multipliers=np.full(n, np.nan),
        multiplier_error=np.full(n, np.inf),
        stability="undecided",
        error=float("inf"),
    )
