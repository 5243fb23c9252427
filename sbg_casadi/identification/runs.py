"""Cheap responses in the time domain: sweeps and single responses by fixed steps in machine code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation import ContinuationError, FixedStep
from continuation.timedomain.fixed_step import FixedStepIntegrator
from continuation.timedomain.fixed_step_functions import mode_model
from continuation.timedomain.lyapunov import variational_model
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.identification.parametric import Parametric
from sbg_casadi.model import static_state

LARGEST_PERIOD = 32
RETURN = 1e-3
"""Distance over the size of the response below which it counts as repeating in the search."""

_STEP = 0.2  # in units of 1/omega_n; RK4 errs by 2e-4 of a period at 2 omega_n, faster than the modes of most gears
_LEAST_STEPS = 16
_PATIENCE = 8  # records at most before a response counts as one that does not repeat
_GROUP = 8  # periods between two normalisations of the tangent vector


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """Hold a sweep up and one down: frequency ratios (k,), RMS (2, k) and states at phase 0 (2, k, n)."""

    ratios: np.ndarray
    rms: np.ndarray
    states: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Hold one response at a frequency ratio, as far as a short run shows it.

    Attributes
    ----------
    period : int
        Excitation periods after which it repeats, 0 when that was not seen.
    growth, growth_error : float
        Largest Lyapunov exponent times the excitation period, and its standard error.
    returns : ndarray (LARGEST_PERIOD,)
        Distances after 1, 2, ... periods, over the size of the response.
    rms : float
        Of lambda about its mean.
    state : ndarray (n,)
        Last state at phase 0.
    """

    period: int
    growth: float
    growth_error: float
    returns: np.ndarray
    rms: float
    state: np.ndarray


class Runs:
    """March a pair of any numbers; compiled once.

    Parameters
    ----------
    equations : Parametric
    transient : int
        Mesh periods before a single response is looked at.
    recorded : int
        Mesh periods looked at, a multiple of 8 and more than twice 32; up to eight times as many where a response does
        not repeat at once.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> from sbg_casadi.identification.parametric import parametric
    >>> d = load_pair("example").dimensionless()
    >>> Runs(parametric(d, 2)).response(d, 2.5).period
    1
    """

    def __init__(self, equations: Parametric, transient: int = 160, recorded: int = 80) -> None:
        self.equations, self.transient, self.recorded = equations, transient, recorded
        settings = FixedStep(_LEAST_STEPS)
        system = equations.system
        self._plain = settings.compile(system, ("lambda",))
        self._tangent = FixedStepIntegrator(settings, variational_model(mode_model(system), 1), system)
        self._with: dict[tuple[bool, int], FixedStepIntegrator] = {}

    def steps(self, ratio: float) -> int:
        """Return the number of steps per mesh period at a frequency ratio."""
        return max(_LEAST_STEPS, 4 * int(np.ceil(2 * np.pi / ratio / _STEP / 4)))

    def _integrator(self, ratio: float, tangent: bool = False) -> FixedStepIntegrator:
        key = tangent, self.steps(ratio)
        if key not in self._with:
            self._with[key] = (self._tangent if tangent else self._plain).with_steps(key[1])
        return self._with[key]

    def sweep(self, d: Dimensionless, ratios: np.ndarray, transient: int = 16, recorded: int = 8) -> Swept:
        """Sweep frequency ratios (k,), increasing, up and down; each value starts from the last state.

        Raises
        ------
        ContinuationError
            If a state leaves the finite numbers.
        """
        p, n = self.equations.vector(d, 1.0), 14
        rms, states = np.empty((2, len(ratios))), np.empty((2, len(ratios), n))
        x = static_state(d)
        for row, order in enumerate((range(len(ratios)), range(len(ratios) - 1, -1, -1))):
            for i in order:
                p[0] = ratios[i]
                integrator = self._integrator(ratios[i])
                x = integrator.run(x, p, transient).end
                run = integrator.run(x, p, recorded, statistics=True)
                x, rms[row, i], states[row, i] = run.end, _rms(run.mean, run.variance), run.end
        return Swept(ratios, rms, states)

    def response(self, d: Dimensionless, ratio: float, start: np.ndarray | None = None) -> Response:
        """Return the response at a frequency ratio that begins at a state, at rest under the mean load when absent.

        Raises
        ------
        ContinuationError
            If the state leaves the finite numbers.
        """
        p = self.equations.vector(d, ratio)
        x = self._integrator(ratio).run(static_state(d) if start is None else start, p, self.transient).end
        for _ in range(_PATIENCE):
            run = self._integrator(ratio).run(x, p, self.recorded, statistics=True)
            returns, x = _returns(run.strobe), run.end
            if returns.min() < RETURN / 4:
                break
        growth, error, end = self._growth(run.end, p, ratio)
        close = np.flatnonzero(returns < RETURN)
        period = int(close[0]) + 1 if close.size and growth < 0.02 else 0
        return Response(period, growth, error, returns, _rms(run.mean, run.variance), end)

    def _growth(self, x: np.ndarray, p: np.ndarray, ratio: float) -> tuple[float, float, np.ndarray]:
        n, integrator = len(x), self._integrator(ratio, tangent=True)
        z = np.concatenate([x, np.full(n, 1 / np.sqrt(n)), [0.0]])
        rates = []
        for j in range(-2, self.recorded // _GROUP):
            z = integrator.run(z, p, _GROUP).end
            size = float(np.linalg.norm(z[n:-1]))
            if not 0 < size < np.inf:
                raise ContinuationError("the tangent vector left the finite numbers")
            z[n:-1] /= size
            if j >= 0:
                rates.append(np.log(size) / _GROUP)
        blocks = np.array(rates)
        return float(blocks.mean()), float(blocks.std(ddof=1) / np.sqrt(len(blocks))), z[:n]

    def waveform(self, d: Dimensionless, ratio: float, state: np.ndarray, period: int, samples: int) -> np.ndarray:
        """Return lambda (samples * period,) from a state at phase 0 over some mesh periods."""
        phases = 2 * np.pi * np.arange(samples) / samples
        run = self._integrator(ratio).run(state, self.equations.vector(d, ratio), period, phases=phases)
        return np.asarray(run.samples[:, :, 0]).ravel()


def _rms(mean: np.ndarray, variance: np.ndarray) -> float:
    return float(np.sqrt(variance[:, 0].mean() + mean[:, 0].var()))


def _returns(strobe: np.ndarray) -> np.ndarray:
    """Return distances of lambda and its rate after 1 to LARGEST_PERIOD periods, over their range on the whole record.

    The range counts as 0.01 at least, so that a response that hardly moves repeats.
    """
    points = strobe[:, [0, 7]]
    size = max(float(np.abs(points - points.mean(axis=0)).max()), 0.01)
    last = points[-LARGEST_PERIOD:]
    return np.array(
        [np.abs(last - points[-LARGEST_PERIOD - n : -n]).max() / size for n in range(1, LARGEST_PERIOD + 1)]
    )
