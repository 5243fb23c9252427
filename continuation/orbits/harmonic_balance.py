"""Harmonic balance, condensed exactly onto the nonlinear ports of a System; contact in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from continuation.branches.bordered import Factors
from continuation.branches.newton import size_of
from continuation.model.ports import LinearPart, Ports
from continuation.model.recent import Recent
from continuation.model.system import System
from continuation.orbits.curvature import critical_form
from continuation.orbits.estimate import Estimate, estimate_error, finish, waveform_size
from continuation.orbits.orbit import Orbit
from continuation.orbits.port_force import PortForces
from continuation.orbits.receptance import Receptance, receptance
from continuation.orbits.shifted import CriticalForm, ShiftedOperator
from continuation.orbits.spectrum import operator, pack, product, resize, unpack
from continuation.orbits.split_operator import split

_REMEMBERED = 1024  # error estimates kept
_NEGLIGIBLE = 0.02  # of the error estimate: what Newton's method may leave without being estimated, too
_ROUNDING = 1e-15  # of an orbit's size


@dataclass(frozen=True, slots=True)
class HarmonicBalance:
    """Settings of harmonic balance.

    Parameters
    ----------
    harmonics : int, optional
        Fixed number of harmonics H. None (the default) chooses it along the branch by the error estimate.
    tolerance : float
        Wanted error of the waveform of the port arguments, relative to their size, when harmonics is None.
    max_harmonics : int
        Largest number that the choice may reach; an orbit reports its own error whatever it is.

    Examples
    --------
    >>> HarmonicBalance(harmonics=1)
    HarmonicBalance(harmonics=1, tolerance=1e-06, max_harmonics=511)
    """

    harmonics: int | None = None
    tolerance: float = 1e-6
    max_harmonics: int = 511

    def __post_init__(self) -> None:
        if self.harmonics is not None and (self.harmonics < 1 or self.harmonics != int(self.harmonics)):
            raise ValueError(f"harmonics: expected a whole number >= 1 or None, got {self.harmonics}")
        if not 0 < self.tolerance < 1:
            raise ValueError(f"tolerance: expected a number between 0 and 1, got {self.tolerance}")
        if self.max_harmonics < 1:
            raise ValueError(f"max_harmonics: expected a whole number >= 1, got {self.max_harmonics}")

    def discretise(self, system: System, parameter: str, *, period_multiple: int = 1, **values: float) -> Any:
        """Make a Problem in one continuation parameter; other parameters take the given values or their defaults.

        The Problem of an autonomous System has the period as a further unknown.

        Raises
        ------
        ValueError
            For an unknown parameter name or a period multiple below 1.
        UnsupportedModel
            For a right-hand side that jumps other than through a contact.
        """
        if system.autonomous:
            from continuation.orbits.free_period import free_period

            return free_period(self, system, parameter, period_multiple, values)
        return HarmonicBalanceProblem(self, system, parameter, period_multiple, values)


class Balance(NamedTuple):
    """Residual harmonics (H+1, k), receptance (H+1, k, m) and reference slope (H+1, m, k) of the ports.

    ``load`` (H+1, m) is that of the ports V = W + S Y, ``driven`` the forcing of the states at the forced orders.
    """

    residual: np.ndarray
    transfer: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    driven: np.ndarray

    def first(self, count: int) -> Balance:
        """Return the same with fewer harmonics."""
        return Balance(*(part[:count] for part in self))


class HarmonicBalanceProblem:
    """Condensed harmonic-balance equations of one System in one parameter; see :class:`HarmonicBalance`.

    The unknown u is the packed spectrum of the port arguments (module ``spectrum``); its length tells the number of
    harmonics, so orbits of different resolution live in one branch.
    """

    def __init__(
        self, method: HarmonicBalance, system: System, parameter: str, period_multiple: int, values: dict[str, float]
    ) -> None:
        if period_multiple < 1 or period_multiple != int(period_multiple):
            raise ValueError(f"period_multiple: expected a whole number >= 1, got {period_multiple}")
        self.method, self.system, self.parameter = method, system, system.check_parameter(parameter)
        self.period_multiple = int(period_multiple)
        self.values = dict(zip(system.parameter_names, system.parameter_vector(values).tolist(), strict=True))
        self.ports = Ports(system)
        self._index = system.parameter_names.index(parameter)
        self._frequency = system.parameter_names.index(system.frequency)
        most = self.ports.parts_kept
        self._receptances: Recent[tuple[LinearPart, Receptance]] = Recent(most)  # by id: a part that is kept is alive
        self._derived: Recent[tuple[LinearPart, Any]] = Recent(most)
        self._vector: tuple[float, np.ndarray] | None = None
        self._driven: tuple[np.ndarray, np.ndarray] | None = None
        self._last: tuple[np.ndarray, np.ndarray, Any, np.ndarray] | None = None
        self._factors: Factors | None = None
        self.forces = PortForces(self.ports, self.period_multiple)
        self._corrections: dict[bytes, Estimate] = {}
        self._slope: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self.evaluations = self.factorisations = 0
        self.free: str | None = None  # the frequency, where it is an unknown (an autonomous System)

    # ---------------------------------------------------------------- parameters and linear part
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
        if self.values[self.system.check_parameter(name)] != value:
            self.values[name], self._vector = float(value), None

    def frequency(self, p: float) -> float:
        """Return the base angular frequency of the orbit (excitation frequency over the period multiple)."""
        omega = self.vector(p)[self._frequency] / self.period_multiple
        if not omega > 0:
            raise ValueError(f"frequency {self.system.frequency!r}: expected a positive number, got {omega}")
        return float(omega)

    def receptance(self, p: float) -> Receptance:
        """Return the receptance at p, rebuilt only when the linear part changes."""
        part = self.ports.linear(self.vector(p))
        return self._receptances.get(id(part), lambda: (part, self._make_receptance(part, p)))[1]

    def _make_receptance(self, part: LinearPart, p: float) -> Receptance:
        forcing, reduce = self.ports.forcing(self.vector(p)).u, not self.ports.linear_moves(self._index)
        return receptance(part, forcing, reduce)

    @property
    def large(self) -> bool:
        """Whether the System has so many states that its linear part is sparse and multipliers are not computed."""
        return self.ports.large

    def share(self, other: HarmonicBalanceProblem, p: float) -> None:
        """Use the receptance of a problem of the same linear part at p, with its reference slope; cheap."""
        part = other.ports.linear(other.vector(p))
        self.ports.hold(part.S)
        own = self.ports.linear(self.vector(p))
        if own.same(part):
            self._receptances.put(id(own), (own, other.receptance(p)))

    def remember(self, part: LinearPart, make: Callable[[LinearPart], Any]) -> Any:
        """Return what was made of a linear part before, or make it; one such thing is kept per part."""
        return self._derived.get(id(part), lambda: (part, make(part)))[1]

    def transfer(self, p: float, orders: np.ndarray) -> np.ndarray:
        """Return the port receptance (K, k, m) at harmonic orders (0 first, if there)."""
        r, s = self.receptance(p), 1j * orders * self.frequency(p)
        if orders[0] != 0:
            return r.ports(s)
        return np.concatenate([r.rest_ports[None].astype(complex), r.ports(s[1:])])

    def states(self, p: float, load: np.ndarray, power: int = 1) -> np.ndarray:
        """Return state harmonics ``M_k^-power load_k`` for load (K, n) at orders 0..K-1."""
        r = self.receptance(p)
        s = 1j * np.arange(1, len(load)) * self.frequency(p)
        return np.concatenate([r.at_rest(load[0], power)[None], r.solve(s, load[1:, :, None], power)[..., 0]])

    def seen(self, p: float, load: np.ndarray) -> np.ndarray:
        """Return the port arguments' share ``C M_k^-1 load_k`` (K, k) for load (K, n) at orders 0..K-1."""
        r = self.receptance(p)
        s = 1j * np.arange(1, len(load)) * self.frequency(p)
        return np.concatenate([(r.rest_outputs @ load[0])[None], r.seen(s, load[1:])])

    # ---------------------------------------------------------------- residual and derivatives
    def residual(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return F(u, p), same shape as u; cost one closed-form force, about 0.15 ms at H = 63."""
        Y = unpack(u, self.ports.outputs)
        return pack(self.balance(Y, self.forces(Y, self.vector(p), len(Y) - 1, 0).W, p).residual)

    def balance(self, Y: np.ndarray, W: np.ndarray, p: float) -> Balance:
        """Return residual harmonics and what they are made of, for port arguments Y (H+1, k) and port forces W."""
        orders = np.arange(len(Y))
        transfer, stiffness = self.transfer(p, orders), self.receptance(p).stiffness(orders)
        V = W + product(stiffness, Y[..., None])[..., 0]
        driven = self.driven(p, len(Y) - 1)
        R = Y - product(transfer, V[..., None])[..., 0]
        R[: len(driven)] -= self.seen(p, driven)
        return Balance(R, transfer, stiffness, V, driven)

    def driven(self, p: float, harmonics: int) -> np.ndarray:
        """Return the forcing of the states (K, n) at the orders 0..K-1 <= harmonics that are forced."""
        u, n = self.ports.forcing(self.vector(p)).u, self.period_multiple
        keep = min(len(u), harmonics // n + 1)
        if self._driven is None or self._driven[0] is not u:
            out = np.zeros(((len(u) - 1) * n + 1, u.shape[1]), dtype=complex)
            out[::n] = u
            self._driven = (u, out)
        return self._driven[1][: (keep - 1) * n + 1]

    def _recover(self, p: float, V: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Return the state harmonics (H+1, n) of port load V and forcing."""
        load = V @ self.receptance(p).part.B.T
        load[: len(driven)] += driven[: len(load)]
        return self.states(p, load)

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, Any, np.ndarray]:
        """Return F (N,), J = dF/du (N, N) and dF/dp (N,) at once; J is exact, also with contacts."""
        self.evaluations += 1
        Y = unpack(u, self.ports.outputs)
        H = len(Y) - 1
        force = self.forces(Y, self.vector(p), H, 2 * H)
        balance = self.balance(Y, force.W, p)
        J = _operator(balance.transfer, force.slope, balance.stiffness, half=False)
        Fp = pack(self.derivative(Y, p, balance))
        self._last = (u, self.vector(p), J, Fp)
        self._factors = None
        self._slope = (u, self.vector(p), force.slope)
        return pack(balance.residual), J, Fp

    def parameter_derivative(self, u: np.ndarray, p: float, name: str) -> np.ndarray:
        """Return dF/d(name), same shape as u, exact for every parameter of the System."""
        Y = unpack(u, self.ports.outputs)
        force = self.forces(Y, self.vector(p), len(Y) - 1, 0)
        balance = self.balance(Y, force.W, p)
        index = self.system.parameter_names.index(self.system.check_parameter(name))
        return pack(self.derivative(Y, p, balance, index))

    def derivative(self, Y: np.ndarray, p: float, balance: Balance, index: int | None = None) -> np.ndarray:
        """Return dF/dp (H+1, k) of one parameter: what it does to phase speed, port forces, forcing and linear part.

        Without an index it is that of the continuation parameter.
        """
        index = self._index if index is None else index
        transfer, V, driven = balance.transfer, balance.load, balance.driven
        out = np.zeros_like(Y)
        if index == self._frequency:
            out += self._phase_derivative(p, driven, V)
            if not self.ports.frequency_explicit:
                return out
        vector, n = self.vector(p), self.period_multiple
        out -= product(transfer, self.force_derivative(Y, p, index)[..., None])[..., 0]
        change = self.forces.parameters.forcing(vector, index).u[: (len(Y) - 1) // n + 1]
        if change.any():
            load = np.zeros(((len(change) - 1) * n + 1, change.shape[1]), dtype=complex)
            load[::n] = change
            out[: len(load)] -= self.seen(p, load)
        moved = self.ports.linear_derivative(vector, index)
        if moved is not None:
            out -= self._linear_change(Y, p, V, driven, moved)
        return out

    def force_derivative(self, Y: np.ndarray, p: float, index: int | None = None) -> np.ndarray:
        """Return d(port force)/dp (H+1, m) of a parameter, the continuation parameter by default, at fixed Y."""
        index = self._index if index is None else index
        if index == self._frequency and not self.ports.frequency_explicit:
            return np.zeros((len(Y), self.ports.inputs), dtype=complex)
        return self.forces.parameter_derivative(Y, self.vector(p), len(Y) - 1, index)

    def _linear_change(self, Y: np.ndarray, p: float, V: np.ndarray, driven: np.ndarray, moved: Any) -> np.ndarray:
        """Return d(C x) where A, B and C change, the port load held fixed; S stays what it is."""
        r, (dA, dB, dC) = self.receptance(p), moved
        X = self._recover(p, V, driven)
        S = r.stiffness(np.arange(len(Y)))
        own = V - product(S, (X @ r.part.C.T)[..., None])[..., 0]
        load = (dA @ X.T).T + own @ dB.T - product(S, (X @ dC.T)[..., None])[..., 0] @ r.part.B.T
        return self.seen(p, load) + X @ dC.T

    def _phase_derivative(self, p: float, driven: np.ndarray, V: np.ndarray) -> np.ndarray:
        """Return i k / n C M_k^-2 (B V_k + u_k), the derivative of the balance in the frequency."""
        r, few = self.receptance(p), len(driven)
        orders = np.arange(len(V))
        out = np.zeros((len(V), r.part.C.shape[0]), dtype=complex)
        out[1:] = (r.ports(1j * orders[1:] * self.frequency(p), 2) @ V[1:, :, None])[..., 0]
        out[1:few] += r.seen(1j * orders[1:few] * self.frequency(p), driven[1:], 2)
        return (1j * orders / self.period_multiple)[:, None] * out

    def port_slope(self, u: np.ndarray, p: float, reach: int) -> np.ndarray:
        """Return the Fourier coefficients (2 reach + 1, m, k) of the port slope along the orbit; the last is kept."""
        if self._slope is None or self._slope[0] is not u or self._slope[1] is not self.vector(p):
            self._slope = None
        if self._slope is None or len(self._slope[2]) < 2 * reach + 1:
            slope = self.forces(unpack(u, self.ports.outputs), self.vector(p), 0, reach).slope
            self._slope = (u, self.vector(p), slope)
        extra = len(self._slope[2]) // 2 - reach
        return self._slope[2][extra : len(self._slope[2]) - extra]

    def half_operator(self, u: np.ndarray, p: float) -> Any:
        """Return the operator on half-integer harmonics, singular exactly at a multiplier -1; shape (2 K k, 2 K k)."""
        Y = unpack(u, self.ports.outputs)
        K = max(len(Y) - 1, 2)
        orders = np.arange(K) + 0.5
        slope = self.port_slope(u, p, 2 * K)
        return _operator(self.transfer(p, orders), slope, self.receptance(p).stiffness(orders), half=True)

    def critical_operator(self, u: np.ndarray, p: float, nu: float) -> Any:
        """Return the operator that is singular exactly at a multiplier exp(2 pi i nu); real for nu = 0 and 1/2."""
        if nu == 0.0:
            last = self._last
            known = last is not None and last[0] is u and last[1] is self.vector(p)
            return last[2] if known and last is not None else self.linearise(u, p)[1]
        return self.half_operator(u, p) if nu == 0.5 else ShiftedOperator(self, u, p, nu).matrix()

    def critical_form(self, u: np.ndarray, p: float, nu: float, v: np.ndarray, w: np.ndarray) -> CriticalForm:
        """Return the derivatives of ``w . M v``, M the critical operator, in the orbit, nu and any parameter."""
        return critical_form(self, u, p, nu, v, w)

    # ---------------------------------------------------------------- error and resolution
    def estimate(self, u: np.ndarray, p: float) -> Estimate:
        """Return the error estimate of (u, p), remembered for the points of one branch; cost about a Newton step."""
        key = u.tobytes() + self.vector(p).tobytes()
        return self._corrections.get(key) or self._remember(u, p, estimate_error(self, u, p))

    def _remember(self, u: np.ndarray, p: float, estimate: Estimate) -> Estimate:
        if len(self._corrections) >= _REMEMBERED:
            self._corrections.clear()
        return self._corrections.setdefault(u.tobytes() + self.vector(p).tobytes(), estimate)

    def linearised(self, u: np.ndarray, p: float) -> tuple[Any, np.ndarray]:
        """Return dF/du and dF/dp, the ones of the last Newton step where that was close by."""
        last = self._last
        if last is not None and self._close_by(last, u, p):
            return last[2], last[3]
        return self.linearise(u, p)[1:]

    def _close_by(self, last: tuple[Any, ...], u: np.ndarray, p: float) -> bool:
        """Tell whether the last linearisation was made so near (u, p) that it serves there, too."""
        if len(last[0]) != len(u):
            return False
        moved = float(np.linalg.norm(last[0] - u)) / size_of(u)
        return moved + float(np.abs(last[1] - self.vector(p)).max()) / self.parameter_scale(p) < 1e-4

    def keep_factors(self, factors: Factors) -> None:
        """Keep the factors of the matrix of the last linearisation, until the next one."""
        self._factors = None if self.free else factors

    def factors(self, u: np.ndarray, p: float) -> Factors | None:
        """Return the factors of the matrix of the last Newton step where that was close by, else None."""
        last = self._last
        return self._factors if last is not None and self._factors is not None and self._close_by(last, u, p) else None

    def finish(
        self, u: np.ndarray, p: float, factors: Factors, tangent: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Callable[[float], None]] | None:
        """Return a chord step from (u, p), the tangent there, and what keeps the error estimate behind that step.

        It is told what the step leaves, in the norm of u, and keeps an estimate only where that and rounding do not
        count. None with a free frequency. See :func:`continuation.orbits.estimate.finish`.
        """
        if self.free:
            return None
        step, turned, estimate = finish(self, u, p, factors, tangent)

        def keep(rest: float) -> None:
            if rest + _ROUNDING * size_of(u) < _NEGLIGIBLE * estimate.shortest:
                self._remember(u + step[:-1], p + float(step[-1]), estimate)
            else:  # it will be made from the residual there
                self.keep_factors(factors)

        return step, turned, keep

    def error(self, u: np.ndarray, p: float) -> float:
        """Return the estimated largest error of the waveform of the port arguments."""
        return self.estimate(u, p).error

    def adapt(self, u: np.ndarray, p: float, across: bool = False) -> tuple[np.ndarray, float]:
        """Return u at the number of harmonics its error asks for, and the error estimate at the old number.

        A longer vector already carries the estimated correction, so that Newton has little left to do. With ``across``
        the error is the distance from the branch: next to a fold that at the same parameter is large for any number.
        """
        estimate, k, method = self.estimate(u, p), self.ports.outputs, self.method
        error = 2 * estimate.shortest if across else estimate.error
        if method.harmonics is not None:
            return u, error
        H = (len(u) // k - 1) // 2
        goal = method.tolerance * size_of(u)
        if error > goal and method.max_harmonics > H:
            return resize(resize(u, k, 2 * H + 1) + estimate.step, k, min(2 * H + 1, method.max_harmonics)), error
        shorter = self._shortened(u, p)
        return (u if shorter is None else shorter), error

    def _shortened(self, u: np.ndarray, p: float) -> np.ndarray | None:
        """Return u with half the harmonics, or None where those left out are not far below the tolerance."""
        k = self.ports.outputs
        H = (len(u) // k - 1) // 2
        half = (H - 1) // 2
        if half < max(7, self.forced(p)):
            return None
        shorter = resize(u, k, half)
        lost = waveform_size(u - resize(shorter, k, H), k)
        return shorter if lost < self.method.tolerance * size_of(u) / 10 else None

    def lengthen(self, u: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Pad or truncate u to the length of another vector."""
        k = self.ports.outputs
        return resize(u, k, (len(like) // k - 1) // 2)

    def forced(self, p: float) -> int:
        """Return the highest harmonic of the orbit that is forced directly."""
        return self.ports.forced_order(self.vector(p)) * self.period_multiple

    def least_harmonics(self, p: float) -> int:
        """Return the least number of harmonics that holds all that is forced directly, of the form 2^j - 1."""
        return ladder(self.forced(p))

    def parameter_scale(self, p: float) -> float:
        """Return the size of the continuation parameter: its value or its default, whichever is larger; 1 for 0."""
        return max(abs(p), abs(self.values[self.parameter])) or 1.0

    def point_error(self, node: Any, kind: str) -> float:
        """Return the parameter error of a special point whose harmonics can't be doubled any more."""
        estimate = self.estimate(node.u, node.p)
        steepness = abs(node.tp) / max(float(np.linalg.norm(node.tu)), 1e-300)
        return 2 * (abs(estimate.dp) + steepness * estimate.shortest)

    def refined(self, u: np.ndarray, p: float) -> np.ndarray | None:
        """Return u with twice the harmonics and its estimated correction, or None at the limit."""
        k = self.ports.outputs
        H = (len(u) // k - 1) // 2
        if self.method.max_harmonics <= H:
            return None
        return resize(resize(u, k, 2 * H + 1) + self.estimate(u, p).step, k, 2 * H + 1)

    # ---------------------------------------------------------------- orbits
    def state_spectrum(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return the half spectrum (H+1, n) of all states, recovered exactly from the port forces."""
        known, Y = self._corrections.get(u.tobytes() + self.vector(p).tobytes()), unpack(u, self.ports.outputs)
        W = self.forces(Y, self.vector(p), len(Y) - 1, 0).W if known is None else known.port_force
        V = W + product(self.receptance(p).stiffness(np.arange(len(Y))), Y[..., None])[..., 0]
        return self._recover(p, V, self.driven(p, len(Y) - 1))

    def waveform(self, u: np.ndarray, p: float, samples: int) -> np.ndarray:
        """Return the states (samples, n) at equidistant phases of the period, of as many harmonics as they resolve."""
        X = self.state_spectrum(u, p)[: samples // 2]
        return np.fft.irfft(X, samples, axis=0, norm="forward")

    def doubled(self, u: np.ndarray) -> tuple[HarmonicBalanceProblem, np.ndarray]:
        """Return the problem of twice the period, and the same orbit as an unknown of it."""
        problem = HarmonicBalanceProblem(
            self.method, self.system, self.parameter, 2 * self.period_multiple, self.values
        )
        problem.free = self.free
        Y = unpack(u, self.ports.outputs)
        wide = np.zeros((2 * len(Y) - 1, Y.shape[1]), dtype=complex)
        wide[::2] = Y
        return problem, pack(wide)

    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return the unknown vector of an orbit of this System, whatever method it came from."""
        if orbit.state_names != self.system.state_names:
            raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {self.system.name!r}")
        ratio, rest = divmod(self.period_multiple, orbit.period_multiple)
        if rest:
            raise ValueError(f"an orbit of period {orbit.period_multiple} has no period {self.period_multiple}")
        value = orbit.parameters[self.parameter]
        C = self.ports.linear(self.vector(value)).C
        Y = np.zeros((orbit.harmonic_count * ratio + 1, self.ports.outputs), dtype=complex)
        Y[::ratio] = orbit.coefficients @ C.T
        Y[0] = Y[0].real
        u, k = pack(Y), self.ports.outputs
        if self.method.harmonics is not None:
            return resize(u, k, self.method.harmonics)
        u = resize(u, k, max(7, ladder(max(orbit.harmonic_count * ratio, self.forced(value)))))
        while (shorter := self._shortened(u, value)) is not None:  # other methods keep more harmonics than are needed
            u = shorter
        return u

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits with certified multipliers for corrected points (u, p, waveform error), in one batch."""
        from continuation.orbits.floquet import make_orbits
        from continuation.orbits.many_states import make_large_orbits

        if self.large:
            return make_large_orbits(self, points)
        return make_orbits(self, points)

    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices (N, n, n) of points (u, p)."""
        from continuation.orbits.many_states import refuse
        from continuation.orbits.monodromy import monodromy

        if self.large:
            refuse(self)
        return monodromy(self, points).matrices

    def flip(self, u: np.ndarray, p: float) -> float:
        """Return a smooth function that vanishes at a multiplier -1: the determinant of :meth:`half_operator`."""
        self.factorisations += 1
        sign, log = np.linalg.slogdet(np.asarray(self.half_operator(u, p)))
        return float(sign * np.exp(log))

    def guess(self, **values: float) -> Orbit:
        """Find a first orbit without a guess: short integration, Fourier coefficients, smoothed law, width to 0.

        Parameters
        ----------
        **values : float
            Parameter values, the continuation parameter among them (its default otherwise).

        Raises
        ------
        NoConvergence
            With what to try, when no attempt converges.
        """
        from continuation.orbits.start import find_orbit

        return find_orbit(self, values)

    def phase_direction(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return du/dphase, the direction in the unknown that shifts the orbit in time."""
        Y = unpack(u, self.ports.outputs)
        return pack(1j * np.arange(len(Y))[:, None] * Y)

    def flow(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return d(states)/dphase (n,) at phase 0."""
        X = self.state_spectrum(u, p)
        return np.asarray((2j * np.arange(len(X))[:, None] * X).sum(axis=0).real)

    def from_orbit(self, orbit: Orbit) -> Orbit:
        """Bring an orbit of this System that any method found into this one (raises NoConvergence, ValueError)."""
        from continuation.orbits.start import taken_over

        return taken_over(self, orbit)

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter (raises NoConvergence)."""
        from continuation.orbits.start import solve_from

        return solve_from(self, orbit, value)


def _operator(transfer: np.ndarray, slope: np.ndarray, shift: np.ndarray, half: bool) -> Any:
    """Return the operator of the balance as a matrix, with many harmonics as a SplitMatrix."""
    found = split(transfer, slope, shift, half)
    return operator(transfer, slope, shift, len(transfer), half) if found is None else found


def ladder(harmonics: int) -> int:
    """Return the least 2^j - 1 that is not below a number of harmonics."""
    return (1 << harmonics.bit_length()) - 1
