"""Single shooting: periodic orbits as fixed points of the flow over the excitation period, exact at contact changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.errors import ContinuationError, NoConvergence, UnsupportedModel
from continuation.model.system import System
from continuation.orbits.orbit import Orbit
from continuation.orbits.sampled import sampled_orbit
from continuation.timedomain.exact import ExactIntegrator, Trajectory, describe

_SETTLING_PERIODS = (50, 100, 200)  # integrated before each attempt of Newton's method at a first orbit
_NEWTON_STEPS = 12


@dataclass(frozen=True, slots=True)
class Shooting:
    """Choose single shooting with event-exact integration.

    Parameters
    ----------
    rtol, atol : float
        Tolerances of the local integration error, relative and absolute in the unit of the states.
    steps : int
        Largest number of steps per excitation period.

    Raises
    ------
    ValueError
        If a tolerance or the number of steps is not positive.

    Notes
    -----
    Nayfeh and Balachandran, Applied Nonlinear Dynamics, section 6.5. Suits orbits whose multipliers are not large; an
    orbit that is very unstable within one period asks for collocation.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> orbit = Shooting().discretise(linear, "omega").guess(omega=2.0)
    >>> [round(float(value), 8) for value in orbit.evaluate(0.0)[0]]          # response 1/(1 - 4 + 0.4i)
    [-0.32751092, 0.08733624]
    """

    rtol: float = 1e-10
    atol: float = 1e-12
    steps: int = 2000

    def __post_init__(self) -> None:
        for name in ("rtol", "atol", "steps"):
            if not getattr(self, name) > 0:
                raise ValueError(f"Shooting: {name} must be positive, got {getattr(self, name)}")

    def discretise(
        self, system: System, parameter: str, period_multiple: int = 1, **parameters: float
    ) -> ShootingProblem:
        """Make the problem of orbits whose period is a multiple of the excitation period.

        Parameters
        ----------
        system : System
            Driven model.
        parameter : str
            Name of the continuation parameter.
        period_multiple : int
            Orbit period over the excitation period.
        **parameters : float
            Other parameters, fixed along the branch; defaults of the System where absent.

        Raises
        ------
        UnsupportedModel
            If the System is autonomous: its unknown period is not treated yet.
        ValueError
            If a parameter is unknown or the period multiple is not a positive integer.
        """
        if system.autonomous:
            raise UnsupportedModel(
                f"system {system.name!r} is autonomous; shooting for an unknown period is not available yet, "
                "only models with an excitation phase are treated"
            )
        if period_multiple < 1 or period_multiple != int(period_multiple):
            raise ValueError(f"period_multiple: expected an integer >= 1, got {period_multiple}")
        return ShootingProblem(self, system, parameter, int(period_multiple), parameters)


class ShootingProblem:
    """State the periodicity F = x(T) - x(0) of one System in one parameter.

    Attributes
    ----------
    system : System
    parameter : str
        Name of the continuation parameter.
    period_multiple : int
    values : dict of str to float
        Every other parameter.
    method : Shooting
    """

    def __init__(
        self, method: Shooting, system: System, parameter: str, period_multiple: int, values: dict[str, float]
    ) -> None:
        system.check_parameter(parameter)
        self.method, self.system, self.parameter, self.period_multiple = method, system, parameter, period_multiple
        self._p = system.parameter_vector(values)
        self._index = system.parameter_names.index(parameter)
        self.values = {k: float(v) for k, v in zip(system.parameter_names, self._p, strict=True) if k != parameter}
        self._integrator = ExactIntegrator(system, parameter, rtol=method.rtol, atol=method.atol, steps=method.steps)
        self._last: tuple[bytes, Trajectory] | None = None
        self.evaluations = self.factorisations = 0

    def _parameters(self, p: float) -> np.ndarray:
        full = self._p.copy()
        full[self._index] = p
        omega = full[self.system.parameter_names.index(str(self.system.frequency))]
        if not omega > 0:
            raise ContinuationError(f"frequency {self.system.frequency!r} must stay positive, got {omega:g}")
        return full

    def trajectory(self, u: np.ndarray, p: float) -> Trajectory:
        """Integrate over the orbit's period from the state u (n,) at phase 0; the last result is kept."""
        key = np.append(u, p).tobytes()
        if self._last is None or self._last[0] != key:
            run = self._integrator.integrate(u, self._parameters(p), self.period_multiple)
            self._last = (key, run)
        return self._last[1]

    def residual(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return x(T) - u, shape (n,)."""
        return self.trajectory(u, p).end - u

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the residual (n,), its Jacobian M - I (n, n) and its derivative (n,) in the parameter.

        Exact derivatives from the variational equation, also for the frequency, because the integration variable is the
        phase. Cost: about five times that of the residual.
        """
        self.evaluations += 1
        run = self.trajectory(u, p)
        monodromy, sensitivity, _ = self._integrator.transition(run, self._parameters(p))
        return run.end - u, monodromy - np.eye(len(u)), sensitivity

    def monodromy(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return the derivative (n, n) of the state after the orbit's period with respect to the state at phase 0."""
        return self._integrator.transition(self.trajectory(u, p), self._parameters(p))[0]

    def liouville_defect(self, u: np.ndarray, p: float) -> float:
        """Return the difference of log(det M) from the integrated trace of the Jacobian.

        Checks the integration of the variational equation only; wrong contact instants may leave it small.
        """
        monodromy, _, trace = self._integrator.transition(self.trajectory(u, p), self._parameters(p))
        sign, logarithm = np.linalg.slogdet(monodromy)
        return abs(float(logarithm) - trace) if sign > 0 else float("inf")

    def waveform(self, u: np.ndarray, p: float, samples: int) -> np.ndarray:
        """Return the states (samples, n) at equidistant phases 2*pi*period_multiple*k/samples."""
        phases = 2 * np.pi * self.period_multiple * np.arange(samples) / samples
        return self._integrator.sample(self.trajectory(u, p), self._parameters(p), phases)

    def error(self, u: np.ndarray, p: float) -> float:
        """Estimate the distance of (u, p) from the exact branch, largest component.

        The residual is computed once more with a tolerance a hundred times tighter (at least 1e-13); the estimate is
        the shortest change of state and parameter that removes it. Orthogonal to the branch, it stays finite at folds.
        """
        residual = self._tight().integrate(u, self._parameters(p), self.period_multiple).end - u
        _, jacobian, derivative = self.linearise(u, p)
        change = np.linalg.lstsq(np.column_stack([jacobian, derivative]), residual, rcond=None)[0]
        return float(abs(change).max())

    def _tight(self) -> ExactIntegrator:
        rtol, atol = max(self.method.rtol / 100, 1e-13), max(self.method.atol / 100, 1e-15)
        return self._integrator.with_tolerance(rtol, atol)

    def adapt(self, u: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return the state as it is and its error estimate: the integration keeps its tolerance along the branch."""
        return u, self.error(u, p)

    def lengthen(self, u: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Return the state as it is: all have the same length (n,)."""
        return u

    # ---------------------------------------------------------------- what the continuation loop needs
    def frequency(self, p: float) -> float:
        """Return the base angular frequency of the orbit (excitation frequency over the period multiple)."""
        return float(self._parameters(p)[self.system.parameter_names.index(str(self.system.frequency))]) / (
            self.period_multiple
        )

    def vector(self, p: float) -> np.ndarray:
        """Return the full parameter vector with the continuation parameter at p."""
        return self._parameters(p)

    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices (N, n, n) of points (u, p)."""
        return np.array([self.monodromy(u, p) for u, p in points])

    def flip(self, u: np.ndarray, p: float) -> float:
        """Return det(I + M), which vanishes at a multiplier -1."""
        return float(np.linalg.det(np.eye(len(u)) + self.monodromy(u, p)))

    def refined(self, u: np.ndarray, p: float) -> None:
        """Return None: there is no finer discretisation than the integrator's tolerance."""
        return

    def point_error(self, node: Any, kind: str) -> float:
        """Return the parameter error of a special point: that of the shortest way from it to the exact branch."""
        return self.error(node.u, node.p)

    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return the state (n,) at phase 0 of an orbit of this System, whatever method it came from."""
        if orbit.state_names != self.system.state_names:
            raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {self.system.name!r}")
        return orbit.evaluate(np.zeros(1))[0]

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits with multipliers and their error bars for corrected points (u, p, error)."""
        return [sampled_orbit(self, u, p, error) for u, p, error in points]

    def tight_monodromy(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return the monodromy matrix (n, n) at a tolerance a hundred times tighter."""
        tight = self._tight()
        full = self._parameters(p)
        return tight.transition(tight.integrate(u, full, self.period_multiple), full)[0]

    def guess(self, **parameters: float) -> Orbit:
        """Find a first orbit; see :meth:`first_state` for arguments and errors."""
        u, p = self.first_state(**parameters)
        return sampled_orbit(self, u, p, self.error(u, p))

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter (raises NoConvergence)."""
        u, history = self._newton(self.unknown(orbit), value)
        if history[-1] > self._tolerance(u):
            raise NoConvergence(
                f"no orbit at {describe({self.parameter: value})} near the one given; take a smaller step",
                history,
                value,
            )
        return sampled_orbit(self, u, value, self.error(u, value))

    def first_state(self, **parameters: float) -> tuple[np.ndarray, float]:
        """Find a first orbit: integrate from rest, then Newton's method.

        With a period multiple above 1 this may be an orbit that repeats earlier, where such a one attracts.

        Parameters
        ----------
        **parameters : float
            Value of the continuation parameter; the System's default when absent.

        Returns
        -------
        u : ndarray (n,)
            State at phase 0.
        p : float
            The parameter's value.

        Raises
        ------
        NoConvergence
            With the history of residual norms, if Newton's method failed from every start.
        ValueError
            If a parameter other than the continuation parameter is given.
        """
        for name in parameters:
            if self.system.check_parameter(name) != self.parameter:
                raise ValueError(
                    f"guess: parameter {name!r} is fixed along this branch; give it to discretise, "
                    f"expected only {self.parameter!r} here"
                )
        p = float(parameters.get(self.parameter, self._p[self._index]))
        u, history = np.zeros(len(self.system.state_names)), [np.inf]
        for periods in _SETTLING_PERIODS:
            u = self._integrator.integrate(u, self._parameters(p), periods).end
            v, history = self._newton(u, p)
            if history[-1] <= self._tolerance(v):
                return v, p
        raise NoConvergence(
            f"shooting for {self.system.name!r} found no orbit of {self.period_multiple} excitation period(s) at "
            f"{describe({self.parameter: p})}: the residual stayed at {history[-1]:.3g}; the response may be of "
            "another period or irregular there, so try another parameter value or period_multiple",
            history,
            p,
        )

    def _tolerance(self, u: np.ndarray) -> float:
        return 10 * (max(self.method.rtol, 1e-13) * float(abs(u).max()) + self.method.atol)

    def _newton(self, u: np.ndarray, p: float) -> tuple[np.ndarray, list[float]]:
        """Iterate with step halving; return the best state and the residual norms (maximum)."""
        f, jacobian, _ = self.linearise(u, p)
        history = [float(abs(f).max())]
        for _ in range(_NEWTON_STEPS):
            if history[-1] <= self._tolerance(u):
                break
            step = np.linalg.lstsq(jacobian, -f, rcond=None)[0]
            for damping in 0.5 ** np.arange(6):
                trial = u + damping * step
                size = self._residual_size(trial, p)
                if size < history[-1]:
                    break
            else:
                break
            u = trial
            f, jacobian, _ = self.linearise(u, p)
            history.append(size)
        return u, history

    def _residual_size(self, u: np.ndarray, p: float) -> float:
        try:
            return float(abs(self.residual(u, p)).max())
        except ContinuationError:  # a trial step too far: the flow runs away, and Newton's method halves the step
            return np.inf
