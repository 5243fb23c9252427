"""Harmonic balance, condensed exactly onto the nonlinear ports of a System; contact in closed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.branches.newton import size_of
from continuation.errors import UnsupportedModel
from continuation.model.ports import LinearPart, Ports
from continuation.model.system import System
from continuation.orbits.orbit import Orbit
from continuation.orbits.port_force import PortForces
from continuation.orbits.receptance import Receptance, receptance
from continuation.orbits.spectrum import operator, pack, resize, unpack

_REMEMBERED = 1024  # error estimates kept
_FOLD = 100.0  # ratio of the error at fixed parameter to the shortest way back that tells a fold is close


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

    def discretise(
        self, system: System, parameter: str, *, period_multiple: int = 1, **values: float
    ) -> HarmonicBalanceProblem:
        """Make a Problem in one continuation parameter; other parameters take the given values or their defaults.

        Raises
        ------
        ValueError
            For an unknown parameter name or a period multiple below 1.
        UnsupportedModel
            For an autonomous System, or a contact that enters non-linearly.
        """
        return HarmonicBalanceProblem(self, system, parameter, period_multiple, values)


@dataclass(frozen=True, slots=True)
class _Estimate:
    """First-order error of a point (u, p): what the harmonics left out would add and change.

    ``step`` (twice the harmonics or more) and ``dp`` are the shortest way back to the branch, ``shortest`` its size in
    the waveform; ``error`` is twice the error at fixed parameter, or twice ``shortest`` next to a fold, where the first
    is no measure. ``states`` are the state harmonics of u, whose loads are known here.
    """

    step: np.ndarray
    dp: float
    shortest: float
    error: float
    states: np.ndarray


class HarmonicBalanceProblem:
    """Condensed harmonic-balance equations of one System in one parameter; see :class:`HarmonicBalance`.

    The unknown u is the packed spectrum of the port arguments (module ``spectrum``); its length tells the number of
    harmonics, so orbits of different resolution live in one branch.
    """

    def __init__(
        self, method: HarmonicBalance, system: System, parameter: str, period_multiple: int, values: dict[str, float]
    ) -> None:
        if system.autonomous:
            raise UnsupportedModel(f"system {system.name!r} is autonomous; harmonic balance needs an excitation phase")
        if period_multiple < 1 or period_multiple != int(period_multiple):
            raise ValueError(f"period_multiple: expected a whole number >= 1, got {period_multiple}")
        self.method, self.system, self.parameter = method, system, system.check_parameter(parameter)
        self.period_multiple = int(period_multiple)
        self.values = dict(zip(system.parameter_names, system.parameter_vector(values).tolist(), strict=True))
        self.ports = Ports(system)
        self._index = system.parameter_names.index(parameter)
        self._frequency = system.parameter_names.index(system.frequency)
        self._receptance: tuple[LinearPart, Receptance] | None = None
        self._derived: tuple[LinearPart, Any] | None = None
        self._vector: tuple[float, np.ndarray] | None = None
        self._last: tuple[np.ndarray, float, np.ndarray, np.ndarray] | None = None
        self.forces = PortForces(self.ports, self.period_multiple)
        self._corrections: dict[bytes, _Estimate] = {}
        self.evaluations = self.factorisations = 0

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
            self._corrections.clear()

    def frequency(self, p: float) -> float:
        """Return the base angular frequency of the orbit (excitation frequency over the period multiple)."""
        omega = self.vector(p)[self._frequency] / self.period_multiple
        if not omega > 0:
            raise ValueError(f"frequency {self.system.frequency!r}: expected a positive number, got {omega}")
        return float(omega)

    def receptance(self, p: float) -> Receptance:
        """Return the receptance at p, rebuilt only when the linear part changes."""
        part = self.ports.linear(self.vector(p))
        if self._receptance is None or self._receptance[0] is not part:
            self._receptance = (part, receptance(part))
        return self._receptance[1]

    def remember(self, part: LinearPart, make: Callable[[LinearPart], Any]) -> Any:
        """Return what was made of a linear part before, or make it; one such thing is kept per problem."""
        if self._derived is None or self._derived[0] is not part:
            self._derived = (part, make(part))
        return self._derived[1]

    def transfer(self, p: float, orders: np.ndarray) -> np.ndarray:
        """Return the port receptance (K, k, m) at harmonic orders (0 first, if there)."""
        r, s = self.receptance(p), 1j * orders * self.frequency(p)
        if orders[0] != 0:
            return r.ports(s)
        static = r.part.C @ r.static @ r.part.B
        return np.concatenate([static[None].astype(complex), r.ports(s[1:])])

    def states(self, p: float, load: np.ndarray, power: int = 1) -> np.ndarray:
        """Return state harmonics ``M_k^-power load_k`` for load (K, n) at orders 0..K-1."""
        r = self.receptance(p)
        s = 1j * np.arange(1, len(load)) * self.frequency(p)
        zero = np.linalg.matrix_power(r.static, power) @ load[0]
        return np.concatenate([zero[None], r.solve(s, load[1:, :, None], power)[..., 0]])

    # ---------------------------------------------------------------- residual and derivatives
    def residual(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return F(u, p), same shape as u; cost one closed-form force, about 0.15 ms at H = 63."""
        Y = unpack(u, self.ports.outputs)
        return pack(self._balance(Y, self.forces(Y, self.vector(p), len(Y) - 1, 0).W, p)[0])

    def _balance(self, Y: np.ndarray, W: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return residual harmonics, port receptance, the ports' load V = W + S Y and the forcing of the states."""
        r, orders = self.receptance(p), np.arange(len(Y))
        transfer = self.transfer(p, orders)
        V = W + _product(r.stiffness(orders), Y[..., None])[..., 0]
        u = self.ports.forcing(self.vector(p)).u
        n = self.period_multiple
        keep = min(len(u), (len(Y) - 1) // n + 1)
        few = (keep - 1) * n + 1  # harmonics that are forced
        driven = np.zeros((few, u.shape[1]), dtype=complex)
        driven[::n] = u[:keep]
        R = Y - _product(transfer, V[..., None])[..., 0]
        R[:few] -= self.states(p, driven) @ r.part.C.T
        return R, transfer, V, driven

    def _recover(self, p: float, V: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """Return the state harmonics (H+1, n) of port load V and forcing."""
        load = V @ self.receptance(p).part.B.T
        load[: len(driven)] += driven[: len(load)]
        return self.states(p, load)

    def linearise(self, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return F (N,), J = dF/du (N, N) and dF/dp (N,) at once; J is exact, also with contacts."""
        self.evaluations += 1
        Y = unpack(u, self.ports.outputs)
        H = len(Y) - 1
        force = self.forces(Y, self.vector(p), H, 2 * H)
        R, transfer, V, driven = self._balance(Y, force.W, p)
        J = operator(transfer, force.slope, self.receptance(p).stiffness(np.arange(H + 1)), H + 1)
        Fp = self._parameter_derivative(u, p, driven, V)
        self._last = (u, p, J, Fp)
        return pack(R), J, Fp

    def _parameter_derivative(self, u: np.ndarray, p: float, driven: np.ndarray, V: np.ndarray) -> np.ndarray:
        """Return dF/dp: analytic for a frequency that acts through the phase, else central differences of F."""
        if self._index == self._frequency and not self.ports.frequency_explicit:
            return pack(self._phase_derivative(p, driven, V))
        h = 6e-6 * self.parameter_scale(p)  # relative error about h^2 = 4e-11 and 1e-16 / h = 2e-11
        return (self.residual(u, p + h) - self.residual(u, p - h)) / (2 * h)

    def _phase_derivative(self, p: float, driven: np.ndarray, V: np.ndarray) -> np.ndarray:
        """Return i k / n C M_k^-2 (B V_k + u_k), the derivative of the balance in the frequency."""
        r, few = self.receptance(p), len(driven)
        orders = np.arange(len(V))
        out = np.zeros((len(V), r.part.C.shape[0]), dtype=complex)
        out[1:] = (r.ports(1j * orders[1:] * self.frequency(p), 2) @ V[1:, :, None])[..., 0]
        out[:few] += self.states(p, driven, 2) @ r.part.C.T
        return (1j * orders / self.period_multiple)[:, None] * out

    def half_operator(self, u: np.ndarray, p: float) -> np.ndarray:
        """Return the operator on half-integer harmonics, singular exactly at a multiplier -1; shape (2 K k, 2 K k)."""
        Y = unpack(u, self.ports.outputs)
        K = max(len(Y) - 1, 2)
        orders = np.arange(K) + 0.5
        slope = self.forces(Y, self.vector(p), 0, 2 * K).slope
        return operator(self.transfer(p, orders), slope, self.receptance(p).stiffness(orders), K, half=True)

    # ---------------------------------------------------------------- error and resolution
    def estimate(self, u: np.ndarray, p: float) -> _Estimate:
        """Return the error estimate of (u, p), remembered for the points of one branch; cost about a Newton step."""
        key = _key(u, p)
        if key not in self._corrections:
            if len(self._corrections) >= _REMEMBERED:
                self._corrections.clear()
            self._corrections[key] = self._correction(u, p)
        return self._corrections[key]

    def _correction(self, u: np.ndarray, p: float) -> _Estimate:
        k = self.ports.outputs
        Y = unpack(u, k)
        H = len(Y) - 1
        n = max(2 * len(Y), self._forced(p) + 1)  # forcing beyond twice the harmonics counts as left out, too
        longer = np.zeros((n, k), dtype=complex)
        longer[: H + 1] = Y
        force = self.forces(longer, self.vector(p), n - 1, n + H)
        R, transfer, V, driven = self._balance(longer, force.W, p)
        stiffness = self.receptance(p).stiffness(np.arange(n))
        middle = len(force.slope) // 2
        tail = np.zeros_like(longer)
        own = np.eye(k) - _product(transfer[H + 1 :], force.slope[middle] + stiffness[H + 1 :])
        tail[H + 1 :] = -R[H + 1 :] / own[:, 0] if k == 1 else -np.linalg.solve(own, R[H + 1 :, :, None])[..., 0]
        # what the tail does to the harmonics kept: the port force it adds, through the linearised balance
        minus, plus = middle + _differences(H + 1, n), middle + _sums(H + 1, n)
        added = np.einsum("klab,lb->ka", force.slope[minus], tail[H + 1 :])
        added += np.einsum("klab,lb->ka", force.slope[plus], tail[H + 1 :].conj())
        low = _product(transfer[: H + 1], added[..., None])[..., 0]
        J, Fp = self._linearised(u, p)
        self.factorisations += 1
        across = np.linalg.solve(J, np.stack([pack(low), Fp], axis=1))
        # shortest change of (u, p) instead of the one at fixed p, so that it stays finite at folds
        unit = self.parameter_scale(p)
        x, y = across[:, 0], across[:, 1] * unit
        dp = float(x @ y) / (float(y @ y) + size_of(u) ** 2)
        tail[: H + 1] = unpack(x, k)
        fixed = self._size(pack(tail))
        tail[: H + 1] = unpack(x - dp * y, k)
        step = pack(tail)
        shortest = self._size(step)
        error = fixed if fixed < _FOLD * shortest else shortest
        return _Estimate(step, dp * unit, shortest, 2 * error, self._recover(p, V[: H + 1], driven))

    def _linearised(self, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
        """Return dF/du and dF/dp, the ones of the last Newton step where that was close by."""
        last = self._last
        if last is not None and len(last[0]) == len(u):
            du, dp = float(np.linalg.norm(last[0] - u)), abs(last[1] - p)
            moved = du / size_of(u) + dp / self.parameter_scale(p)
            if moved < 1e-4:
                return last[2], last[3]
        return self.linearise(u, p)[1:]

    def error(self, u: np.ndarray, p: float) -> float:
        """Return the estimated largest error of the waveform of the port arguments."""
        return self.estimate(u, p).error

    def _size(self, u: np.ndarray) -> float:
        Y = np.abs(unpack(u, self.ports.outputs)).sum(axis=1)
        return float(Y[0] + 2 * Y[1:].sum())

    def adapt(self, u: np.ndarray, p: float) -> tuple[np.ndarray, float]:
        """Return u at the number of harmonics its error asks for, and the error estimate at the old number.

        A longer vector already carries the estimated correction, so that Newton has little left to do.
        """
        estimate, k, method = self.estimate(u, p), self.ports.outputs, self.method
        error = estimate.error
        if method.harmonics is not None:
            return u, error
        H = (len(u) // k - 1) // 2
        goal = method.tolerance * size_of(u)
        if error > goal and method.max_harmonics > H:
            return resize(resize(u, k, 2 * H + 1) + estimate.step, k, min(2 * H + 1, method.max_harmonics)), error
        half = (H - 1) // 2
        if half >= max(7, self._forced(p)) and self._size(u - resize(resize(u, k, half), k, H)) < goal / 10:
            return resize(u, k, half), error
        return u, error

    def lengthen(self, u: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Pad or truncate u to the length of another vector."""
        k = self.ports.outputs
        return resize(u, k, (len(like) // k - 1) // 2)

    def _forced(self, p: float) -> int:
        """Return the highest harmonic of the orbit that is forced directly."""
        return self.ports.forced_order(self.vector(p)) * self.period_multiple

    def least_harmonics(self, p: float) -> int:
        """Return the least number of harmonics that holds all that is forced directly, of the form 2^j - 1."""
        return ladder(self._forced(p))

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
        return self.estimate(u, p).states

    def unknown(self, orbit: Orbit) -> np.ndarray:
        """Return the unknown vector of an orbit of this System, whatever method it came from."""
        if orbit.state_names != self.system.state_names:
            raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {self.system.name!r}")
        ratio, rest = divmod(self.period_multiple, orbit.period_multiple)
        if rest:
            raise ValueError(f"an orbit of period {orbit.period_multiple} has no period {self.period_multiple}")
        C = self.ports.linear(self.vector(orbit.value)).C
        Y = np.zeros((orbit.harmonic_count * ratio + 1, self.ports.outputs), dtype=complex)
        Y[::ratio] = orbit.coefficients @ C.T
        Y[0] = Y[0].real
        u, k = pack(Y), self.ports.outputs
        if self.method.harmonics is not None:
            return resize(u, k, self.method.harmonics)
        return resize(u, k, max(7, ladder(max(orbit.harmonic_count * ratio, self._forced(orbit.value)))))

    def orbits(self, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
        """Return Orbits with certified multipliers for corrected points (u, p, waveform error), in one batch."""
        from continuation.orbits.floquet import make_orbits

        return make_orbits(self, points)

    def monodromies(self, points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        """Return monodromy matrices (N, n, n) of points (u, p)."""
        from continuation.orbits.monodromy import monodromy

        return monodromy(self, points).matrices

    def flip(self, u: np.ndarray, p: float) -> float:
        """Return a smooth function that vanishes at a multiplier -1: the determinant of :meth:`half_operator`."""
        self.factorisations += 1
        sign, log = np.linalg.slogdet(self.half_operator(u, p))
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

    def solve(self, orbit: Orbit, value: float) -> Orbit:
        """Correct a neighbouring orbit at a given value of the continuation parameter (raises NoConvergence)."""
        from continuation.orbits.start import correct_at

        return correct_at(self, self.unknown(orbit), value)


def _key(u: np.ndarray, p: float) -> bytes:
    return u.tobytes() + np.float64(p).tobytes()


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply stacks of small matrices; one by one, that is elementwise, for a single port."""
    return a * b if a.shape[-2:] == b.shape[-2:] == (1, 1) else a @ b


def _differences(low: int, high: int) -> np.ndarray:
    """Orders k - l for k < low <= l < high."""
    return np.arange(low)[:, None] - np.arange(low, high)[None, :]


def _sums(low: int, high: int) -> np.ndarray:
    """Orders k + l for k < low <= l < high."""
    return np.arange(low)[:, None] + np.arange(low, high)[None, :]


def ladder(harmonics: int) -> int:
    """Return the least 2^j - 1 that is not below a number of harmonics."""
    return (1 << harmonics.bit_length()) - 1
