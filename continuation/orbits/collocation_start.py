"""A first orbit for collocation: integration over many periods, then Newton's method from its waveform."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.errors import ContinuationError, NoConvergence
from continuation.orbits.orbit import Orbit
from continuation.orbits.start import begin_at, correct_at, starting_values
from continuation.timedomain.cvodes import CVODES, PeriodIntegrator

_PERIODS = (30, 200, 1000)  # of the orbit, integrated before each attempt
_AVERAGED = 16  # last orbits whose mean is a second guess, for slowly decaying swings about a periodic response
_SAMPLES = 128


def find_orbit(problem: Any, values: dict[str, float]) -> Orbit:
    """Return an orbit at the given parameter values; see ``CollocationProblem.guess``."""
    p, given = starting_values(problem, values)
    names = problem.system.parameter_names
    parameters = dict(zip(names, problem.vector(p).tolist(), strict=True))
    integrators = [CVODES(rtol=1e-8, atol=1e-11, samples=_SAMPLES, stiff=stiff) for stiff in (False, True)]
    compiled = [c.compile(problem.system) for c in integrators]
    state, reason = begin_at(problem, np.zeros(len(problem.system.state_names)), given), ""
    for periods in _PERIODS:
        try:
            waves = _integrate(problem, compiled, parameters, state, periods)
        except ContinuationError as failure:
            reason = reason or str(failure)
            break
        state = waves[-1][-1]
        for wave in (waves[-1], np.mean(waves, axis=0)):
            try:
                return correct_at(problem, problem.from_waveform(_closed(wave)), p)
            except NoConvergence as failure:
                reason = str(failure)
    raise NoConvergence(
        f"no periodic orbit of period {problem.period_multiple} found at {problem.parameter} = {p:g} "
        f"(last attempt: {reason}); start at another parameter value, away from resonance, or with more damping",
        parameter=p,
    )


def _closed(wave: np.ndarray) -> np.ndarray:
    """Return samples (P, n) of a waveform (P+1, n), its drift over the period taken out so that no jump is resolved."""
    return wave[:-1] - np.linspace(0, 1, len(wave))[:-1, None] * (wave[-1] - wave[0])


def _integrate(
    problem: Any, integrators: list[PeriodIntegrator], parameters: dict[str, float], state: np.ndarray, periods: int
) -> list[np.ndarray]:
    """Return the last orbits' waveforms (samples + 1, n), explicit where that goes, else with the stiff method."""
    waves: list[np.ndarray] = []
    for _ in range(max(1, periods // problem.period_multiple)):
        try:
            wave = integrators[0].integrate(state, problem.period_multiple, **parameters)
        except ContinuationError:
            wave = integrators[1].integrate(state, problem.period_multiple, **parameters)
        waves, state = [*waves[1 - _AVERAGED :], wave], wave[-1]
    return waves
