"""Collocation at Gauss points with piecewise polynomials on an adaptive mesh, for smooth systems."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.newton import size_of
from continuation.model.system import System
from continuation.orbits import collocation_orbit
from continuation.orbits.collocation_equations import Equations
from continuation.orbits.collocation_estimate import Estimate, estimate_error
from continuation.orbits.collocation_form import SecondField, form_gradients
from continuation.orbits.collocation_mesh import Mesh, Meshes, Monitor
from continuation.orbits.contact_series import evaluate
from continuation.orbits.monodromy_form import critical_form, critical_matrix
from continuation.orbits.orbit import Orbit
from continuation.orbits.shifted import CriticalForm

if TYPE_CHECKING:
    from continuation.orbits.free_period import FreePeriodProblem

_REMEMBERED = 1024  # error estimates kept
_HARMONICS = 1024  # of an orbit from elsewhere, enough for a start
_FEWEST = 8  # intervals per excitation period
_FIRST_GOAL = 1e-5  # of the size: local error of the mesh on which a waveform from elsewhere is first corrected
_AIM = 0.25  # of the tolerance, error aimed at when a mesh is chosen
_FAR_BELOW = 0.01  # of the tolerance, error below which fewer intervals may do
_FEWER = 0.7  # share of the intervals that makes it worth
_MORE = 1.3  # times the intervals needed, in a mesh of old that is taken instead of a new one
_GROWTH = 2.0  # largest ratio of intervals in one step: an error estimate far from convergence is rough


@dataclass(frozen=True, slots=True)
class Collocation:
    """Settings of collocation.

    Parameters
    ----------
    intervals : int, optional
        Fixed number of equal intervals. None (the default) chooses number and lengths along the branch by the error
        estimate.
    degree : int
        Degree m of the polynomials, 1 to 10: the waveform errs by the power m + 1 of the lengths, the states at the
        ends of the intervals and the multipliers by the power 2m.
    tolerance : float
        Wanted error of the waveform of all states, relative to their root mean square, when intervals is None.
    max_intervals : int
        Largest number that the choice may reach; an orbit reports its own error whatever it is.

    Raises
    ------
    ValueError
        For settings out of range.

    Notes
    -----
    De Boor and Swartz; Ascher, Mattheij and Russell, Numerical Solution of Boundary Value Problems, sections 5.4, 5.6
    and 9. Resolves orbits with layers, and orbits so unstable that no integration returns to them.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> orbit = Collocation().discretise(linear, "omega").guess(omega=2.0)
    >>> [round(float(value), 8) for value in orbit.evaluate(0.0)[0]]          # response 1/(1 - 4 + 0.4i)
    [-0.32751092, 0.08733624]
    """

    intervals: int | None = None
    degree: int = 4
    tolerance: float = 1e-9
    max_intervals: int = 1000

    def __post_init__(self) -> None:
        if self.intervals is not None and (self.intervals < 2 or self.intervals != int(self.intervals)):
            raise ValueError(f"intervals: expected a whole number >= 2 or None, got {self.intervals}")
        if self.degree not in range(1, 11):
            raise ValueError(f"degree: expected a whole number from 1 to 10, got {self.degree}")
        if not 0 < self.tolerance < 1:
            raise ValueError(f"tolerance: expected a number between 0 and 1, got {self.tolerance}")
        if self.max_intervals < 2 or self.max_intervals != int(self.max_intervals):
            raise ValueError(f"max_intervals: expected a whole number >= 2, got {self.max_intervals}")

    def discretise(
        self, system: System, parameter: str, *, period_multiple: int = 1, **values: float
    ) -> CollocationProblem | FreePeriodProblem:
        """Make a Problem in one continuation parameter; other parameters take the given values or their defaults.

        Raises
        ------
        ValueError
            For an unknown parameter name or a period multiple below 1.
        UnsupportedModel
            For a System with contacts, or whose right-hand side is not smooth.
        """
        if system.autonomous:  # the period is unknown: the general wrapper of driven methods
            from continuation.orbits.free_period import free_period

            return free_period(self, system, parameter, period_multiple, values)
        return CollocationProblem(self, system, parameter, period_multiple, values)


class CollocationProblem:
    """Collocation equations of one System in one parameter; see :class:`Collocation`.

    The unknown u holds the states at the Gauss-Lobatto nodes of every interval, each node times the root of its weight
    (``Mesh.root``), node by node: its plain norm is the root mean square over time of all states whatever the mesh. Its
    length names the mesh.

    One Newton step costs about 1 ms for 2 states and 40 intervals, 12 ms for 14 states and 50 intervals; an orbit with
    its error, multipliers and error bars about five times as much.
    """

    def __init__(
        self, method: Collocation, system: System, parameter: str, period_multiple: int, values: dict[str, float]
    ) -> None:
        if period_multiple < 1 or period_multiple != int(period_multiple):
            raise ValueError(f"period_multiple: expected a whole number >= 1, got {period_multiple}")
        self.method, self.system, self.parameter = method, system, system.check_parameter(parameter)
        self.period_multiple = int(period_multiple)
        self.values = dict(zip(system.parameter_names, system.parameter_vector(values).tolist(), strict=True))
        self._index = system.parameter_names.index(parameter)
        self._frequency = system.parameter_names.index(str(system.frequency))
        self._vector: tuple[float, np.ndarray] | None = None
        self.equations = Equations(system, parameter, self.period_multiple)
        self._meshes = Meshes(method.degree, len(system.state_names), method.max_intervals)
        self._elevated: dict[int, Mesh] = {}
        self._second: SecondField | None = None
        self._estimates: OrderedDict[bytes, Estimate] = OrderedDict()
        self.evaluations = self.factorisations = 0
        self.free: str | None = None  # the frequency, where it is an unknown (an autonomous System)

    # ---------------------------------------------------------------- parameters and meshes
    def vector(self, p: float) -> np.ndarray:
        """Return the full parameter vector with the continuation parameter at p (read-only)."""
        if self._vector is None or self._vector[0] != p:
            vector = np.fromiter(self.values.values(), dtype=float)
            vector[self._index] = p
            vector.flags.writeable = False
            self._vector = (p, vector)
        return self._vector[1]

    def set_value(self, name: str, value: float) -> None:
        """Change the value of a parameter that is fixed along the branch."""
        self.values[self.system.check_parameter(name)], self._vector = float(value), None

    def frequency(self, p: float) -> float:
        """Return the base angular frequency of the orbit (excitation frequency over the period multiple)."""
        omega = self.vector(p)[self._frequency] / self.period_multiple
        if not omega > 0:
            raise ValueError(f"frequency {self.system.frequency!r}: expected a positive number, got {omega}")
        return float(omega)

    def parameter_scale(self, p: float) -> float:
        """Return the size of the continuation parameter: its value or its default, whichever is larger; 1 for 0."""
        return max(abs(p), abs(self.values[self.parameter])) or 1.0

    def mesh(self, u: np.ndarray) -> Mesh:
        """Return the mesh that the length of an unknown names; a length never seen raises ValueError."""
        return self._meshes.of(u)

    def elevated(self, u: np.ndarray) -> Mesh:
        """Return the same mesh with polynomials of one degree more."""
        mesh = self.mesh(u)
        return self._elevated.setdefault(mesh.count, mesh.elevated())

    def lengthen(self, v: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Bring an unknown or a tangent to the mesh of another, by evaluating its polynomials at the nodes."""
        if len(v) == len(like):
            return v
        mesh, other = self.mesh(v), self.mesh(like)
        return other.unknown(mesh.evaluate(mesh.values(v), other.positions))

    # ---------------------------------------------------------------- residual and derivatives
    def residual(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return F(u, p), same shape as u."""
        self.frequency(p)
        return self.equations.residual(self.mesh(u), u, self.vector(p))

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, sp.csc_array, np.ndarray]:
        """Return F (N,), J = dF/du (N, N), sparse, and dF/dp (N,), all exact."""
        self.evaluations += 1
        self.frequency(p)
        return self.equations.linearise(self.mesh(u), u, self.vector(p))

    def parameter_derivative(self, u: np.ndarray, p: float, name: str) -> np.ndarray:
        """Return the exact derivative (N,) of F in any parameter, at fixed u."""
        return self.equations.derivative(self.mesh(u), u, self.vector(p), name)

    def phase_direction(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return d/dphase of the orbit as a change of the unknown (N,): derivatives of the polynomials at the nodes."""
        mesh = self.mesh(u)
        return mesh.unknown(mesh.slopes(mesh.values(u))) / (2 * np.pi * self.period_multiple)

    def flow(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return dx/dphase (n,) at phase 0."""
        first = self.mesh(u).values(u)[:1]
        return self.equations.field(first, np.zeros(1), self.vector(p))[0][0]

    # ---------------------------------------------------------------- error and resolution
    def estimate(self, u: np.ndarray, p: float) -> Estimate:
        """Return the error estimate of (u, p), remembered for the points of one branch; cost about 1.5 Newton steps."""
        key = u.tobytes() + self.vector(p).tobytes()
        if key not in self._estimates:
            if len(self._estimates) >= _REMEMBERED:
                self._estimates.popitem(last=False)
            self._estimates[key] = estimate_error(self, u, p)
        return self._estimates[key]

    def error(self, u: np.ndarray, p: float) -> float:
        """Return the estimated largest error of the waveform of all states."""
        return self.estimate(u, p).error

    def adapt(self, u: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return u on the mesh its error asks for, and the error estimate on the old one.

        A new mesh is taken only where the error exceeds the tolerance, or is so far below it that much fewer intervals
        do. The new vector carries the estimated correction, so that Newton has little left to do.
        """
        estimate = self.estimate(u, p)
        if self.method.intervals is not None or not np.isfinite(estimate.error):
            return u, estimate.error
        mesh, goal = self.mesh(u), self.method.tolerance * size_of(u)
        better = None
        if estimate.error > goal:
            better = self._finer(estimate, mesh, _AIM * goal)
        elif estimate.error < _FAR_BELOW * goal:
            better = self._coarser(estimate, mesh, _AIM * goal)
        return (u if better is None else self._moved(estimate, better)), estimate.error

    def _finer(self, estimate: Estimate, mesh: Mesh, aim: float) -> Mesh | None:
        """Return a mesh with more intervals: one of old that suits, or a new one; None at the limit."""
        across = mesh.count * (estimate.ends / aim) ** (0.5 / mesh.degree)  # errors carried round the period
        wanted = max(estimate.monitor.count(aim), int(np.ceil(across)), mesh.count + 1)
        wanted = min(wanted, int(_GROWTH * mesh.count) + 1, self.method.max_intervals)
        if wanted <= mesh.count:
            return None
        old = self._suitable(estimate.monitor, aim, (max(mesh.count + 1, int(across)), int(_MORE * wanted)))
        return old or self._meshes.equidistributed(estimate.monitor, wanted)

    def _coarser(self, estimate: Estimate, mesh: Mesh, aim: float) -> Mesh | None:
        """Return a mesh with much fewer intervals, or None."""
        wanted = max(estimate.monitor.count(aim), _FEWEST * self.period_multiple)
        if wanted > _FEWER * mesh.count:
            return None
        most = int(_FEWER * mesh.count)
        new = self._suitable(estimate.monitor, aim, (wanted, most)) or self._meshes.equidistributed(
            estimate.monitor, wanted
        )
        return new if new is not None and new.count < mesh.count else None

    def _suitable(self, monitor: Monitor, aim: float, counts: tuple[int, int]) -> Mesh | None:
        """Return the smallest mesh seen before whose local errors would be about as aimed at."""
        fitting = (m for m in self._meshes if counts[0] <= m.count <= counts[1] and monitor.worst(m) < 2 * aim)
        return next(fitting, None)

    def _moved(self, estimate: Estimate, mesh: Mesh) -> np.ndarray:
        """Return the better orbit of an estimate as an unknown on a mesh."""
        return mesh.unknown(estimate.mesh.evaluate(estimate.mesh.values(estimate.better), mesh.positions))

    def refined(self, u: np.ndarray, p: float) -> np.ndarray | None:
        """Return u with its estimated correction on the mesh with every interval halved, or None at the limit."""
        finer = self._meshes.halved(self.mesh(u))
        return None if finer is None else self._moved(self.estimate(u, p), finer)

    def point_error(self, node: Any, kind: str) -> float:
        """Return the parameter error of a special point whose intervals can't be halved any more."""
        estimate = self.estimate(node.u, node.p)
        steepness = abs(node.tp) / max(float(np.linalg.norm(node.tu)), 1e-300)
        return 2 * (abs(estimate.dp) + steepness * estimate.shortest)

    # ---------------------------------------------------------------- stability
    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices (N, n, n) of points (u, p), condensed from the collocation equations."""
        return collocation_orbit.monodromies(self, points)[0]

    def critical_operator(self, u: np.ndarray, p: float, nu: float) -> np.ndarray:
        """Return ``M - exp(2 pi i nu) I``, M the monodromy matrix (n, n); real for nu = 0 and 1/2."""
        return critical_matrix(self.monodromies([(u, p)])[0], nu)

    def critical_form(self, u: np.ndarray, p: float, nu: float, v: np.ndarray, w: np.ndarray) -> CriticalForm:
        """Return the derivatives of ``conj(w) . M v`` in the orbit, nu and any parameter, exact."""
        if self._second is None:
            self._second = SecondField(self.system)
        second, mesh, vector = self._second, self.mesh(u), self.vector(p)

        def form(right: np.ndarray, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return form_gradients(self.equations, mesh, second, u, vector, right, left)

        return critical_form(form, self.system.parameter_names, nu, v, w)

    def start(self, u: np.ndarray) -> np.ndarray:
        """Return the state (n,) at phase 0."""
        return np.asarray(self.mesh(u).values(u)[0])

    def start_gradient(self, u: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Return a gradient (n,) by the state at phase 0 as one by the unknown (N,)."""
        out = np.zeros_like(u)
        out[: len(gradient)] = gradient / self.mesh(u).root[0]
        return out

    def liouville_defect(self, u: np.ndarray, p: float) -> float:
        """Return the difference of log|det M| from the integrated trace of the Jacobian."""
        return float(collocation_orbit.monodromies(self, [(u, p)])[2][0])

    def flip(self, u: np.ndarray, p: float) -> float:
        """Return det(I + M), which vanishes at a multiplier -1."""
        M = self.monodromies([(u, p)])[0]
        return float(np.linalg.det(np.eye(len(M)) + M))

    # ---------------------------------------------------------------- orbits
    def waveform(self, u: np.ndarray, p: float, samples: int) -> np.ndarray:
        """Return the states (samples, n) at equidistant phases 2*pi*period_multiple*k/samples."""
        mesh = self.mesh(u)
        return mesh.evaluate(mesh.values(u), np.arange(samples) / samples)

    def doubled(self, u: np.ndarray) -> tuple[CollocationProblem, np.ndarray]:
        """Return the problem of twice the period, and the same orbit as an unknown of it, on the mesh taken twice."""
        problem = CollocationProblem(self.method, self.system, self.parameter, 2 * self.period_multiple, self.values)
        problem.free = self.free
        mesh = self.mesh(u)
        twice = problem._meshes.adopted(Mesh.of(np.append(mesh.ends[:-1] / 2, (1 + mesh.ends) / 2), mesh.degree))
        return problem, twice.unknown(np.tile(mesh.values(u), (2, 1)))

    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return the unknown vector of an orbit of this System, whatever method it came from."""
        if orbit.state_names != self.system.state_names:
            raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {self.system.name!r}")
        if self.period_multiple % orbit.period_multiple:
            raise ValueError(f"an orbit of period {orbit.period_multiple} has no period {self.period_multiple}")
        ratio = self.period_multiple // orbit.period_multiple
        few = orbit.coefficients[: _HARMONICS // ratio + 1]
        half = np.zeros(((len(few) - 1) * ratio + 1, few.shape[1]), dtype=complex)
        half[::ratio] = few
        return self._from_spectrum(half)

    def from_waveform(self, samples: np.ndarray) -> np.ndarray:
        """Return the unknown of equidistant samples (P, n) of one period of an orbit."""
        return self._from_spectrum(np.fft.rfft(samples, axis=0, norm="forward")[: (len(samples) + 1) // 2])

    def _from_spectrum(self, half: np.ndarray) -> np.ndarray:
        """Return the unknown of a half spectrum (K+1, n) of the states, on a mesh that suits it."""
        samples = np.fft.irfft(half, 8 * max(len(half), 16), axis=0, norm="forward")
        mesh = self._first_mesh(samples)
        return mesh.unknown(evaluate(half, 2 * np.pi * mesh.positions))

    def _first_mesh(self, samples: np.ndarray) -> Mesh:
        """Return a mesh for equidistant samples (P, n) of one period, rather too coarse: adapting refines it."""
        if self.method.intervals is not None:
            return self._meshes.uniform(self.method.intervals)
        monitor = Monitor.of_samples(samples, self.method.degree)
        size = float(np.sqrt((samples**2).sum(axis=1).mean())) or 1.0
        old = self._suitable(monitor, _AIM * self.method.tolerance * size, (2, self.method.max_intervals))
        wanted = max(monitor.count(_FIRST_GOAL * size), _FEWEST * self.period_multiple)
        new = old or self._meshes.equidistributed(monitor, min(wanted, self.method.max_intervals))
        return new or self._meshes.uniform(self.method.max_intervals)

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits with multipliers and their error bars for corrected points (u, p, waveform error)."""
        return collocation_orbit.make_orbits(self, points)

    def guess(self, **values: float) -> Orbit:
        """Find a first orbit without a guess: integrate from rest, then Newton's method.

        Parameters
        ----------
        **values : float
            Parameter values, the continuation parameter among them (its default otherwise).

        Raises
        ------
        NoConvergence
            With what to try, when no attempt converges.
        ValueError
            For an unknown name, or another value of a parameter that is fixed in this problem.
        """
        from continuation.orbits.collocation_start import find_orbit

        return find_orbit(self, values)

    def from_orbit(self, orbit: Orbit) -> Orbit:
        """Bring an orbit of this System that any method found into this one (raises NoConvergence, ValueError)."""
        from continuation.orbits.start import taken_over

        return taken_over(self, orbit)

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter (raises NoConvergence)."""
        from continuation.orbits.start import solve_from

        return solve_from(self, orbit, value)
