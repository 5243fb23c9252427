"""The periodicity of the segments of an orbit as equations, with exact derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.model.system import System
from continuation.orbits.monodromy_form import critical_form, critical_matrix
from continuation.orbits.orbit import Orbit
from continuation.orbits.sampled import sampled_orbit
from continuation.orbits.shifted import CriticalForm
from continuation.orbits.shooting_estimate import Estimate, crossing_error, estimate
from continuation.orbits.start import check_determined, check_value

_REMEMBERED = 1024  # error estimates kept
_KEPT = 4  # paths kept, the normal and the tight one of the last points among them


class ShootingProblem:
    """State the periodicity of one System in one parameter, segment by segment.

    The unknown is ``u = [x_0, ..., x_(m-1)] / sqrt(m)`` (m n,) with the states x_i at the equidistant phases where
    segments begin, so that the size of u does not depend on their number m, which its length tells. The equations are
    ``F_i = (end of segment i from x_i - x_(i+1)) / sqrt(m)``, cyclic.

    Attributes
    ----------
    system : System
    parameter : str
        Name of the continuation parameter.
    period_multiple : int
    values : dict of str to float
        Every parameter; the continuation parameter at its default.
    method : Shooting
    integration : ExactFlow or SmoothFlow
    segments : int or None
        Number of segments of new orbits; None until it is chosen.
    free : str or None
        Name of a frequency that is an unknown, too (autonomous Systems).
    """

    def __init__(
        self,
        method: Any,
        system: System,
        parameter: str,
        period_multiple: int,
        values: dict[str, float],
        integration: Any,
    ) -> None:
        self.method, self.system, self.parameter = method, system, system.check_parameter(parameter)
        self.period_multiple, self.integration = period_multiple, integration
        self.values = dict(zip(system.parameter_names, system.parameter_vector(values).tolist(), strict=True))
        self.segments: int | None = method.segments
        self.free: str | None = None
        self._index = system.parameter_names.index(parameter)
        self._frequency = system.parameter_names.index(str(system.frequency))
        self._paths: dict[tuple[bytes, bytes, float], Any] = {}
        self._tight = integration.tight()
        self._estimates: dict[tuple[bytes, bytes], Estimate] = {}
        self.evaluations = self.factorisations = 0

    # ---------------------------------------------------------------- parameters
    def vector(self, p: float) -> np.ndarray:
        """Return the full parameter vector with the continuation parameter at p."""
        full = np.fromiter(self.values.values(), dtype=float)
        full[self._index] = p
        if not full[self._frequency] > 0:
            name = self.system.frequency
            raise ValueError(f"frequency {name!r}: expected a positive number, got {full[self._frequency]:g}")
        return full

    def set_value(self, name: str, value: float) -> None:
        """Change the value of a parameter that is fixed along the branch."""
        self.values[self.system.check_parameter(name)] = float(value)

    def frequency(self, p: float) -> float:
        """Return the base angular frequency of the orbit (excitation frequency over the period multiple)."""
        return float(self.vector(p)[self._frequency]) / self.period_multiple

    def parameter_scale(self, p: float) -> float:
        """Return the size of the continuation parameter: its value or its default, whichever is larger; 1 for 0."""
        return max(abs(p), abs(self.values[self.parameter])) or 1.0

    def direction(self, name: str) -> np.ndarray:
        """Return the unit vector (q,) of a parameter."""
        unit = np.zeros(len(self.values))
        unit[self.system.parameter_names.index(self.system.check_parameter(name))] = 1.0
        return unit

    # ---------------------------------------------------------------- segments
    def count(self, u: np.ndarray) -> int:
        """Return the number of segments of an unknown."""
        return len(u) // len(self.system.state_names)

    def states(self, u: np.ndarray) -> np.ndarray:
        """Return the states (m, n) at which segments begin."""
        m = self.count(u)
        return u.reshape(m, -1) * np.sqrt(m)

    def joined(self, states: np.ndarray) -> np.ndarray:
        """Return the unknown (m n,) of states (m, n) at which segments begin."""
        return states.ravel() / np.sqrt(len(states))

    def phases(self, m: int) -> np.ndarray:
        """Return the phases (m + 1,) at which m segments begin and end."""
        return 2 * np.pi * self.period_multiple * np.arange(m + 1) / m

    def path(self, u: np.ndarray, p: float, tight: bool = False, turn: float = 0.0) -> Any:
        """Integrate all segments, at a tolerance a hundred times tighter if asked; the last few results are kept.

        The frequency is changed by ``turn``, relative to its value.
        """
        vector, flow = self.vector(p), self._tight if tight else self.integration
        vector[self._frequency] *= 1 + turn
        key = (u.tobytes(), vector.tobytes(), flow.rtol)
        if key not in self._paths:
            path = flow.path(self.states(u), vector, self.phases(self.count(u)))
            while len(self._paths) >= _KEPT:
                self._paths.pop(next(iter(self._paths)))
            self._paths[key] = path
        return self._paths[key]

    def segment_matrices(self, u: np.ndarray, p: float, tight: bool = False) -> np.ndarray:
        """Return the derivatives (m, n, n) of the ends of the segments by their starts."""
        return np.asarray(self.path(u, p, tight).matrices)

    # ---------------------------------------------------------------- equations
    def residual(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return F (m n,)."""
        states = self.states(u)
        return self.joined(self.path(u, p).ends - np.roll(states, -1, axis=0))

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F (N,), its Jacobian (N, N) and its derivative (N,) in the continuation parameter.

        Exact derivatives from the variational equation, also for the frequency, because the integration variable is the
        phase. Cost: two to four times that of the residual.
        """
        self.evaluations += 1
        derivative = self.parameter_derivative(u, p, self.parameter)
        return self.residual(u, p), self.cyclic(self.segment_matrices(u, p), -1.0), derivative

    def cyclic(self, matrices: np.ndarray, closing: float) -> np.ndarray:
        """Return the block matrix (N, N) of segments (m, n, n), minus the unit shift, its last block times -closing.

        With closing -1 it is the Jacobian of F, with +1 it is singular exactly at a multiplier -1.
        """
        m, n, _ = matrices.shape
        J, unit = np.zeros((m, n, m, n)), np.eye(n)
        for i in range(m):
            J[i, :, i] += matrices[i]
            J[i, :, (i + 1) % m] += closing * unit if i == m - 1 else -unit
        return J.reshape(m * n, m * n)

    def parameter_derivative(self, u: np.ndarray, p: float, name: str) -> np.ndarray:
        """Return the derivative (N,) of F in any parameter of the System, at fixed u."""
        return self.joined(self.path(u, p).sensitivities(self.direction(name)))

    def monodromy(self, u: np.ndarray, p: float, tight: bool = False) -> np.ndarray:
        """Return the derivative (n, n) of the state after the orbit's period by that at phase 0."""
        product = np.eye(len(self.system.state_names))
        for matrix in self.segment_matrices(u, p, tight):
            product = matrix @ product
        return product

    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices (N, n, n) of points (u, p)."""
        return np.array([self.monodromy(u, p) for u, p in points])

    def flip(self, u: np.ndarray, p: float) -> float:
        """Return a smooth function that vanishes at a multiplier -1: det(I + M), up to its sign."""
        return float(np.linalg.det(self.cyclic(self.segment_matrices(u, p), 1.0)))

    def form_gradient(self, u: np.ndarray, p: float, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Return the gradient (N,) of ``w . M(u, p) v`` in u, M the monodromy matrix, v and w (n,).

        Exact second derivatives of the flow, the shift of contact changes included; raises GrazingContact where they
        are infinite. Cost about that of one linearisation.
        """
        return self.form_gradients(u, p, v, w)[0]

    def form_gradients(
        self, u: np.ndarray, p: float, v: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, dict[str, float]]:
        """Return the gradient (N,) of ``w . M(u, p) v`` in u, and its derivative in every parameter by name."""
        matrices = self.segment_matrices(u, p)
        m = len(matrices)
        right, left = [np.asarray(v, dtype=float)], [np.asarray(w, dtype=float)]
        for i in range(m - 1):
            right.append(matrices[i] @ right[-1])
            left.append(matrices[m - 1 - i].T @ left[-1])
        by_state, by_parameters = self.path(u, p).form_gradients(np.array(right), np.array(left[::-1]))
        total = dict(zip(self.system.parameter_names, by_parameters.sum(axis=0).tolist(), strict=True))
        return by_state.ravel() * np.sqrt(m), total

    def critical_operator(self, u: np.ndarray, p: float, nu: float) -> np.ndarray:
        """Return ``M - exp(2 pi i nu) I``, M the monodromy matrix (n, n); real for nu = 0 and 1/2."""
        return critical_matrix(self.monodromy(u, p), nu)

    def critical_form(self, u: np.ndarray, p: float, nu: float, v: np.ndarray, w: np.ndarray) -> CriticalForm:
        """Return the derivatives of ``conj(w) . M v`` in the orbit, nu and any parameter, exact."""

        def form(right: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            by_state, by_parameter = self.form_gradients(u, p, right, left)
            return by_state, np.array(list(by_parameter.values()))

        return critical_form(form, self.system.parameter_names, nu, v, w)

    def start(self, u: np.ndarray) -> np.ndarray:
        """Return the state (n,) at phase 0."""
        return np.asarray(self.states(u)[0])

    def start_gradient(self, u: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return a gradient (n,) by the state at phase 0 as one by the unknown (N,)."""
        out = np.zeros_like(u)
        out[: len(gradient)] = gradient * np.sqrt(self.count(u))
        return out

    def flow(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return dx/dphase (n,) at phase 0."""
        return np.asarray(self.integration.rate(self.states(u)[0], 0.0, self.vector(p)))

    def phase_direction(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return the direction (N,) in which a shift of the phase moves the start of the first segment."""
        out = np.zeros_like(u)
        rate = self.flow(u, p)
        out[: len(rate)] = rate / np.sqrt(self.count(u))
        return out

    def liouville_defect(self, u: np.ndarray, p: float) -> float:
        """Return the difference of log(det M) from the integrated trace of the Jacobian.

        Checks the integration of the variational equation only; wrong contact instants may leave it small.
        """
        path = self.path(u, p)
        signs, logarithms = np.linalg.slogdet(path.factors)
        return abs(float(logarithms.sum() - path.traces.sum())) if np.prod(signs) > 0 else float("inf")

    def waveform(self, u: np.ndarray, p: float, samples: int) -> np.ndarray:
        """Return the states (samples, n) at equidistant phases of the period; samples is a multiple of m."""
        if samples % self.count(u):
            raise ValueError(f"samples: expected a multiple of the {self.count(u)} segments, got {samples}")
        return np.asarray(self.path(u, p).waveform(samples))

    def doubled(self, u: np.ndarray) -> tuple[ShootingProblem, np.ndarray]:
        """Return the problem of twice the period, and the same orbit as an unknown of it, with twice the segments."""
        problem = ShootingProblem(
            self.method, self.system, self.parameter, 2 * self.period_multiple, self.values, self.integration
        )
        problem.free, problem.segments = self.free, 2 * self.count(u)
        return problem, problem.joined(np.tile(self.states(u), (2, 1)))

    # ---------------------------------------------------------------- errors
    def estimate(self, u: np.ndarray, p: float) -> Estimate:
        """Return the way from (u, p) to the exact branch; see :mod:`continuation.orbits.shooting_estimate`."""
        key = u.tobytes(), self.vector(p).tobytes()
        if key not in self._estimates:
            if len(self._estimates) >= _REMEMBERED:
                self._estimates.clear()
            self._estimates[key] = estimate(self, u, p)
        return self._estimates[key]

    def error(self, u: np.ndarray, p: float) -> float:
        """Return the estimated distance of (u, p) from the exact branch, largest component of the states."""
        return self.estimate(u, p).error

    def point_error(self, node: Any, kind: str) -> float:
        """Return the parameter error of a special point."""
        return crossing_error(self, node, kind)

    def adapt(self, u: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return u as it is and its error estimate: the integration keeps its tolerance along the branch."""
        return u, self.error(u, p)

    def lengthen(self, u: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Return u as it is: the number of segments does not change along a branch."""
        if len(u) != len(like):
            raise ValueError(f"expected {self.count(like)} segments, got {self.count(u)}")
        return u

    def refined(self, u: np.ndarray, p: float) -> None:
        """Return None: there is no finer discretisation than the integrator's tolerance."""
        return

    # ---------------------------------------------------------------- orbits
    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return the unknown of an orbit of this System, whatever method it came from.

        Raises
        ------
        ValueError
            If it is of another System, or its period does not fit.
        """
        from continuation.orbits.shooting_start import choose_segments

        self._check_fit(orbit)
        if self.segments is None:
            self.segments = choose_segments(self, orbit.evaluate(self.phases(8)[:-1]), orbit.parameters[self.parameter])
        return self.joined(orbit.evaluate(self.phases(self.segments)[:-1]))

    def _check_fit(self, orbit: Orbit) -> None:
        if orbit.state_names != self.system.state_names:
            raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {self.system.name!r}")
        if self.period_multiple % orbit.period_multiple:
            raise ValueError(f"an orbit of period {orbit.period_multiple} has no period {self.period_multiple}")

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits with multipliers and their error bars for corrected points (u, p, error)."""
        return [sampled_orbit(self, u, p, error) for u, p, error in points]

    def guess(self, **values: float) -> Orbit:
        """Find a first orbit; see :func:`~continuation.orbits.shooting_start.first_state`."""
        u, p = self.first_state(**values)
        error = self.error(u, p)
        check_determined(self, p, error, float(np.abs(self.states(u)).max()))
        return self.orbits([(u, p, error)])[0]

    def first_state(self, **values: float) -> tuple[np.ndarray, float]:
        """Return unknown and parameter of a first orbit; see :mod:`continuation.orbits.shooting_start`."""
        from continuation.orbits.shooting_start import first_state

        return first_state(self, values)

    def from_orbit(self, orbit: Orbit) -> Orbit:
        """Bring an orbit of this System that any method found into this one.

        Raises
        ------
        ValueError
            If it is of other values of the parameters that are fixed here.
        NoConvergence
            With the history of residuals and the orbit given.
        """
        from continuation.orbits.start import taken_over

        self._check_fit(orbit)
        return taken_over(self, orbit)

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter.

        Raises
        ------
        NoConvergence
            With the history of residuals and the orbit given.
        """
        from continuation.orbits.shooting_start import corrected

        check_value(self, value)
        u = corrected(self, orbit, value)
        error = self.error(u, value)
        check_determined(self, value, error, float(np.abs(self.states(u)).max()))
        return self.orbits([(u, value, error)])[0]
