"""Autonomous Systems: the period is an unknown and the phase is fixed, on top of any method for driven ones.

The System becomes a driven one whose right-hand side does not depend on the phase (``System.clocked``). The unknown is
``U = [u, s log(omega / omega_0)]`` and one equation is added, the phase condition of the guess: the correction
``u - a`` of a guess a is orthogonal to da/dphase, so that of all its shifts in time the orbit nearest to the guess is
taken
(Seydel, Practical Bifurcation and Stability Analysis, section 7.1). One Floquet multiplier is 1, that of the flow
direction; stability and test functions are those of the other n - 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from continuation.branches.newton import Node, size_of
from continuation.errors import NoConvergence, UnsupportedModel
from continuation.model.system import System
from continuation.orbits.equilibrium import hopf
from continuation.orbits.floquet import distance, verdict
from continuation.orbits.orbit import Orbit
from continuation.orbits.shifted import CriticalForm
from continuation.orbits.split_operator import SplitMatrix

_SMALL = 0.03  # of the largest amplitude of a branch, below which its end at an equilibrium is looked for
_FALLEN = 1e-6  # of the movement of the guess, below which a corrected orbit is an equilibrium


def free_period(
    method: Any, system: System, parameter: str, period_multiple: int, values: dict[str, float]
) -> FreePeriodProblem:
    """Return the Problem of an autonomous System for a method that treats driven ones."""
    name = next(n for n in ("frequency", "orbit_frequency", "_orbit_frequency") if n not in system.parameter_names)
    inner = method.discretise(system.clocked(name, 1.0), parameter, period_multiple=period_multiple, **values)
    inner.free = name
    return FreePeriodProblem(inner, system)


class FreePeriodProblem:
    """Periodicity with unknown period; see the module. ``inner`` is the driven Problem at a given frequency.

    ``period_multiple`` counts cycles of the orbit that a period-doubled one came from; 1 for any other.
    """

    def __init__(self, inner: Any, system: System) -> None:
        self.inner, self.system, self._name = inner, system, inner.free
        self._unit, self._reference = 1.0, 1.0  # of the last entry of U: s and omega_0
        self._anchor: tuple[np.ndarray, np.ndarray] | None = None
        self._amplitude = 0.0
        self._gradient: ca.Function | None = None

    @property
    def method(self) -> Any:
        """Settings of the method."""
        return self.inner.method

    @property
    def parameter(self) -> str:
        """Name of the continuation parameter."""
        return str(self.inner.parameter)

    @property
    def period_multiple(self) -> int:
        """Cycles per period."""
        return int(self.inner.period_multiple)

    @property
    def evaluations(self) -> int:
        """Number of linearisations so far."""
        return int(self.inner.evaluations)

    @property
    def factorisations(self) -> int:
        """Number of factorisations beside those of Newton's steps."""
        return int(self.inner.factorisations)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters of the System."""
        return {k: v for k, v in self.inner.values.items() if k != self._name}

    # ---------------------------------------------------------------- the unknown
    def split(self, U: np.ndarray) -> np.ndarray:
        """Return u of U, with the inner problem set to the frequency of U."""
        self.inner.set_value(self._name, self._reference * float(np.exp(U[-1] / self._unit)))
        return U[:-1]

    def _join(self, u: np.ndarray, omega: float) -> np.ndarray:
        return np.append(u, self._unit * np.log(omega / self._reference))

    def frequency_of(self, U: np.ndarray) -> float:
        """Return the angular frequency of the cycle (of one of ``period_multiple`` cycles)."""
        return self._reference * float(np.exp(U[-1] / self._unit))

    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return U of an orbit of this System, whatever method it came from."""
        omega = 2 * np.pi * orbit.period_multiple / orbit.period
        self.inner.set_value(self._name, omega)
        clocked = replace(orbit, parameters={**orbit.parameters, self._name: omega})
        u = self.inner.unknown(clocked)
        if self._anchor is None:
            self._unit, self._reference = size_of(u), omega
        return self._join(u, omega)

    def doubled(self, U: np.ndarray) -> tuple[FreePeriodProblem, np.ndarray]:
        """Return the problem of twice the period, and the same orbit as an unknown of it."""
        inner, u = self.inner.doubled(self.split(U))
        problem = FreePeriodProblem(inner, self.system)
        problem._unit, problem._reference = self._unit, self._reference
        return problem, np.append(u, U[-1])

    def waveform(self, U: np.ndarray, p: float, samples: int) -> np.ndarray:
        """Return the states (samples, n) at equidistant times of the period."""
        wave: np.ndarray = self.inner.waveform(self.split(U), p, samples)
        return wave

    def anchor(self, U: np.ndarray, p: float) -> None:
        """Fix the phase of what is corrected next to that of a guess."""
        u = self.split(U)
        direction = self.inner.phase_direction(u, p)
        self._anchor = u.copy(), direction / size_of(direction)

    # ---------------------------------------------------------------- equations
    def linearise(self, U: np.ndarray, p: float) -> tuple[np.ndarray, Any, np.ndarray]:
        """Return F (N+1,), its Jacobian and its derivative in the parameter; the last row is the phase condition."""
        u = self.split(U)
        if self._anchor is None:
            self.anchor(U, p)
        assert self._anchor is not None
        a, direction = (self.inner.lengthen(v, u) for v in self._anchor)
        F, J, Fp = self.inner.linearise(u, p)
        column = self.inner.parameter_derivative(u, p, self._name) * self.frequency_of(U) / self._unit
        if sp.issparse(J):
            matrix: Any = sp.bmat([[J, column[:, None]], [direction[None], None]], format="csc")
        elif isinstance(J, SplitMatrix):
            matrix = J.bordered(column[:, None], direction[None], np.zeros((1, 1)))
        else:
            n = len(u)
            matrix = np.zeros((n + 1, n + 1))
            matrix[:n, :n], matrix[:n, n], matrix[n, :n] = J, column, direction
        return np.append(F, direction @ (u - a)), matrix, np.append(Fp, 0.0)

    def residual(self, U: np.ndarray, p: float) -> np.ndarray:
        """Return F (N+1,)."""
        u = self.split(U)
        F = self.inner.residual(u, p)
        if self._anchor is None:
            return np.append(F, 0.0)
        a, direction = (self.inner.lengthen(v, u) for v in self._anchor)
        return np.append(F, direction @ (u - a))

    def parameter_derivative(self, U: np.ndarray, p: float, name: str) -> np.ndarray:
        """Return the derivative of F in any parameter."""
        return np.append(self.inner.parameter_derivative(self.split(U), p, name), 0.0)

    def set_value(self, name: str, value: float) -> None:
        """Change a parameter that is fixed along the branch."""
        self.inner.set_value(self.system.check_parameter(name), value)

    def vector(self, p: float) -> np.ndarray:
        """Return the parameters of the System with the continuation parameter at p."""
        return self.inner.vector(p)[:-1]

    def parameter_scale(self, p: float) -> float:
        """Return the size of the continuation parameter."""
        return max(abs(p), abs(self.inner.values[self.parameter])) or 1.0

    # ---------------------------------------------------------------- resolution
    def lengthen(self, U: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Bring an unknown or a tangent to the resolution of another."""
        return np.append(self.inner.lengthen(U[:-1], like[:-1]), U[-1])

    def adapt(self, U: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return U at the resolution its error asks for, and the error."""
        u, error = self.inner.adapt(self.split(U), p)
        return np.append(u, U[-1]), error

    def refined(self, U: np.ndarray, p: float) -> np.ndarray | None:
        """Return U at twice the resolution, or None at the limit."""
        u = self.inner.refined(self.split(U), p)
        return None if u is None else np.append(u, U[-1])

    def error(self, U: np.ndarray, p: float) -> float:
        """Return the estimated waveform error."""
        return float(self.inner.error(self.split(U), p))

    def point_error(self, node: Node, kind: str) -> float:
        """Return the parameter error of a special point at the limit of resolution."""
        u = self.split(node.u)
        return float(self.inner.point_error(replace(node, u=u, tu=node.tu[:-1]), kind))

    def ended(self, before: Node, new: Node) -> str | None:
        """Return why a branch ends where its cycle shrinks to an equilibrium, or None."""
        was, now = (self._moving(n.u, n.p) for n in (before, new))
        self._amplitude = max(self._amplitude, was, now)
        if not now < min(_SMALL * self._amplitude, was):
            return None
        start = self.inner.orbits([(self.split(new.u), new.p, new.error)])[0].coefficients[0].real
        try:
            value, error = hopf(self.system, self.parameter, self.vector(new.p), start, self.frequency_of(new.u))
        except NoConvergence:
            return None
        return f"the cycle shrinks to an equilibrium: Hopf point at {self.parameter} = {value:.10g} +- {error:.1e}"

    def _moving(self, U: np.ndarray, p: float) -> float:
        """Return the size of what moves on an orbit."""
        return float(np.linalg.norm(self.inner.phase_direction(self.split(U), p)))

    # ---------------------------------------------------------------- stability
    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices across the flow (N, n-1, n-1): their eigenvalues are the nontrivial multipliers."""
        return np.array([self._across(self.split(U), p)[0] for U, p in points])

    def _across(self, u: np.ndarray, p: float) -> tuple[np.ndarray, complex]:
        """Return the matrix on the complement of the flow direction, and the multiplier of the flow direction."""
        M = self.inner.monodromies([(u, p)])[0]
        f = self.inner.flow(u, p)
        basis = np.linalg.qr(f[:, None], mode="complete")[0]
        turned = basis.T @ M @ basis  # [[1, *], [0, M_across]], because M f = f
        return turned[1:, 1:], complex(turned[0, 0])

    def flip(self, U: np.ndarray, p: float) -> float:
        """Return a smooth function that vanishes at a multiplier -1."""
        return float(self.inner.flip(self.split(U), p))

    def critical_operator(self, U: np.ndarray, p: float, nu: float) -> Any:
        """Return the operator that is singular at a nontrivial multiplier exp(2 pi i nu); see the inner method.

        For nu = 0 it is ``[[M - I, f], [f, 0]]`` with the flow direction f: M has the multiplier 1 twice where it is
        singular.

        Raises
        ------
        UnsupportedModel
            For nu = 0 by harmonic balance.
        """
        u = self.split(U)
        if nu != 0.0:
            return self.inner.critical_operator(u, p, nu)
        if not hasattr(self.inner, "start_gradient"):
            raise UnsupportedModel(
                "folds of autonomous systems: their second derivatives are not offered by harmonic balance; use "
                "Collocation or Shooting"
            )
        f = self.inner.flow(u, p)
        return np.block([[self.inner.critical_operator(u, p, 0.0), f[:, None]], [f[None], np.zeros((1, 1))]])

    def critical_form(self, U: np.ndarray, p: float, nu: float, v: np.ndarray, w: np.ndarray) -> CriticalForm:
        """Return the derivatives of ``conj(w) . M v``, M the critical operator, in the orbit, nu and any parameter."""
        u, omega = self.split(U), self.frequency_of(U)
        if nu != 0.0:
            inner = self.inner.critical_form(u, p, nu, v, w)
            last = inner.parameter(self._name) * omega / self._unit
            return CriticalForm(np.append(inner.state, last), inner.shift, inner.parameter)
        inner = self.inner.critical_form(u, p, nu, v[:-1], w[:-1])
        weights = v[-1] * w[:-1] + w[-1] * v[:-1]
        by_x, by_p = self._flow_gradient(u, p, weights)
        names = self.inner.system.parameter_names

        def parameter(name: str) -> complex:
            return complex(inner.parameter(name) + by_p[names.index(name)])

        state = inner.state + self.inner.start_gradient(u, by_x)
        return CriticalForm(np.append(state, parameter(self._name).real * omega / self._unit), inner.shift, parameter)

    def _flow_gradient(self, u: np.ndarray, p: float, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients of ``weights . f`` at phase 0 by the state (n,) and all parameters (q,)."""
        s = self.inner.system
        if self._gradient is None:
            a = ca.SX.sym("a", len(s.state_names))
            form = ca.dot(a, s.closed()) / s.p[s.parameter_names.index(self._name)]
            results = [ca.densify(ca.gradient(form, z)) for z in (s.x, s.p)]
            self._gradient = ca.Function("flow_gradient", [s.x, s.theta, s.p, a], results)
        found: Any = self._gradient(self.inner.start(u), 0.0, self.inner.vector(p), weights)
        return np.array(found[0]).ravel(), np.array(found[1]).ravel()

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits whose verdict leaves out the multiplier of the flow direction."""
        return [self._orbit(self.split(U), p, error) for U, p, error in points]

    def _orbit(self, u: np.ndarray, p: float, error: float) -> Orbit:
        orbit = self.inner.orbits([(u, p, error)])[0]
        across, trivial = self._across(u, p)
        other = np.linalg.eigvals(across).astype(complex)
        mu = np.append(other, trivial)
        # bars of the inner method, each with the multiplier it belongs to; a wrong period moves a multiplier, too
        table = np.abs(mu[:, None] - orbit.multipliers[None, :])
        bar = distance(mu, orbit.multipliers) + orbit.multiplier_error[np.argmin(table, axis=1)]
        estimate = getattr(self.inner, "estimate", None)
        turn = abs(estimate(u, p).dfrequency) if estimate is not None else 0.0
        size = np.maximum(np.abs(mu), 1e-300)
        bar = bar + 2 * turn * size * np.abs(np.log(mu + (mu == 0) * 1e-300))
        order = np.argsort(-np.abs(mu) - 1e-12 * (mu.imag > 0), kind="stable")
        return replace(
            orbit,
            system=self.system.name,
            parameters={k: v for k, v in orbit.parameters.items() if k != self._name},
            multipliers=mu[order],
            multiplier_error=bar[order],
            second_opinion=orbit.second_opinion[np.argmin(table, axis=1)][order],
            stability=verdict(other, bar[:-1]),
        )

    # ---------------------------------------------------------------- first orbits
    def guess(self, **values: float) -> Orbit:
        """Find an attracting orbit by integration; see :func:`continuation.orbits.start_autonomous.find_cycle`."""
        from continuation.orbits.start_autonomous import find_cycle

        return self.from_orbit(find_cycle(self, values))

    def from_orbit(self, orbit: Orbit) -> Orbit:
        """Bring an orbit of this System that any method found into this one (raises NoConvergence, ValueError)."""
        from continuation.orbits.start import taken_over

        return taken_over(self, orbit)

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter (raises NoConvergence)."""
        from continuation.orbits.start import solve_from

        before = self._moving(self.unknown(orbit), value)
        found = solve_from(self, orbit, value)
        if not self._moving(self.unknown(found), value) > _FALLEN * before:
            raise NoConvergence(
                f"the correction at {self.parameter} = {value:g} fell back on an equilibrium; start nearer",
                parameter=value,
                orbit=orbit,
            )
        return found
