"""What of a System depends on the phase and parameters alone: forcing, contact gains and contact offsets."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import casadi as ca
import numpy as np

from continuation.errors import UnsupportedModel

PROBES = np.mod(np.arange(1, 9) * 2.3999632297286533, 2 * np.pi)  # phases that no regular grid meets
_FIRST, _FINEST = 64, 8192  # samples per period
_KEPT = 64  # parameter vectors whose coefficients are kept


class Forcing:
    """Fourier coefficients over one excitation period, each evaluated when it is asked for.

    Attributes
    ----------
    u : (J+1, n)
        Forcing of the states, harmonics 0..J.
    gain : (contacts, m, I+1), offset : (contacts, I+1)
        Gains and offsets of the contacts.
    """

    def __init__(self, drive: Callable[[], np.ndarray], contacts: Callable[[], tuple[np.ndarray, np.ndarray]]) -> None:
        self._drive, self._contacts = drive, contacts

    @cached_property
    def u(self) -> np.ndarray:
        """Forcing of the states."""
        return self._drive()

    @cached_property
    def _both(self) -> tuple[np.ndarray, np.ndarray]:
        return self._contacts()

    @property
    def gain(self) -> np.ndarray:
        """Gains of the contacts."""
        return self._both[0]

    @property
    def offset(self) -> np.ndarray:
        """Offsets of the contact arguments."""
        return self._both[1]

    @cached_property
    def order(self) -> int:
        """Highest harmonic that carries more than 1e-8 of the largest of its row."""
        return max(_order(rows) for rows in (self.u.T, self.gain.reshape(-1, self.gain.shape[-1]), self.offset))


class Excitation:
    """Forcing of a System as a function of its parameters, and its derivatives; remembers some parameter vectors.

    Parameters
    ----------
    system : str
        Name used in messages.
    theta, p : SX
        Phase and parameters (q,).
    drive : SX (f,), states : array of int (f,), n : int
        Forcing of those of the n states that are forced.
    gains : SX (m, contacts), offset : SX (contacts,)

    Examples
    --------
    >>> theta, p = ca.SX.sym("theta"), ca.SX.sym("p")
    >>> both = Excitation("s", theta, p, p**2 * ca.cos(theta), np.array([1]), 2, ca.SX(1, 0), ca.SX(0, 1))
    >>> both(np.array([2.0])).u.real.tolist(), both.derivative(np.array([2.0]), 0).u.real.tolist()
    ([[0.0, 0.0], [0.0, 2.0]], [[0.0, 0.0], [0.0, 2.0]])
    """

    def __init__(
        self,
        system: str,
        theta: ca.SX,
        p: ca.SX,
        drive: ca.SX,
        states: np.ndarray,
        n: int,
        gains: ca.SX,
        offset: ca.SX,
    ) -> None:
        self._name, self._states, self._n, self._shape = system, states, n, gains.shape
        self._symbols = theta, p
        self._drive = _Periodic(system, theta, p, drive)
        self._contacts = _Periodic(system, theta, p, ca.vertcat(ca.vec(gains), offset))
        self._changes: dict[int, tuple[_Periodic, _Periodic]] = {}
        self._last: tuple[np.ndarray, bytes, Forcing] | None = None

    def __call__(self, p: np.ndarray) -> Forcing:
        """Return the coefficients at the parameters p (q,), which must not be changed afterwards."""
        if self._last is not None and self._last[0] is p:  # the same array object is the common case
            return self._last[2]
        tag = self._drive.tag(p) + self._contacts.tag(p)
        same = self._last is not None and self._last[1] == tag
        forcing = self._last[2] if same and self._last is not None else self._forcing(self._drive, self._contacts, p)
        self._last = p, tag, forcing
        return forcing

    def at(self, theta: float, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate forcing (n,), gains (contacts, m) and offsets (contacts,) at one phase."""
        u = np.zeros(self._n)
        phase = np.array([theta])
        u[self._states] = self._drive.values(phase, p)[:, 0]
        rows, (m, c) = self._contacts.values(phase, p)[:, 0], self._shape
        return u, rows[: m * c].reshape(c, m), rows[m * c :]

    def derivative(self, p: np.ndarray, index: int) -> Forcing:
        """Return the derivative of the coefficients with respect to parameter ``index``.

        Raises
        ------
        UnsupportedModel
            If it is not a smooth function of the phase.
        """
        if index not in self._changes:
            theta, symbols = self._symbols
            self._changes[index] = tuple(  # type: ignore[assignment]
                _Periodic(self._name, theta, symbols, ca.jacobian(part.rows, symbols[index]))
                for part in (self._drive, self._contacts)
            )
        return self._forcing(*self._changes[index], p)

    def _forcing(self, drive: _Periodic, contacts: _Periodic, p: np.ndarray) -> Forcing:
        m, c = self._shape

        def forced() -> np.ndarray:
            rows = drive(p)
            u = np.zeros((rows.shape[1], self._n), dtype=complex)
            u[:, self._states] = rows.T
            return u

        def gain_and_offset() -> tuple[np.ndarray, np.ndarray]:
            rows = contacts(p)
            return rows[: m * c].reshape(c, m, rows.shape[1]), rows[m * c :]

        return Forcing(forced, gain_and_offset)


class _Periodic:
    """Half spectra of expressions of phase and parameters, kept per values of the parameters they depend on."""

    def __init__(self, name: str, theta: ca.SX, p: ca.SX, rows: ca.SX) -> None:
        self.rows, self._name = ca.densify(rows), name
        self._function = ca.Function("rows", [theta, p], [self.rows])
        self._depends = dependence(self.rows, p)
        self._zero = bool(self.rows.is_zero())
        self._known: dict[bytes, np.ndarray] = {}

    def __call__(self, p: np.ndarray) -> np.ndarray:
        tag = self.tag(p)
        if tag not in self._known:
            if len(self._known) >= _KEPT:
                self._known.pop(next(iter(self._known)))
            zero = np.zeros((self.rows.numel(), 1), dtype=complex)
            self._known[tag] = zero if self._zero else fourier(lambda theta: self.values(theta, p), self._name)
        return self._known[tag]

    def tag(self, p: np.ndarray) -> bytes:
        """Return what tells parameters apart that the expressions depend on."""
        return p[self._depends].tobytes()

    def values(self, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Evaluate the rows (r, N) at phases (N,)."""
        return np.array(self._function(theta.reshape(1, -1), p)).reshape(-1, theta.size)


def fourier(evaluate: Callable[[np.ndarray], np.ndarray], name: str) -> np.ndarray:
    """Return the half spectra (rows, J+1) of smooth functions of the phase, (N,) -> (rows, N), to rounding.

    Raises
    ------
    UnsupportedModel
        If they have corners or jumps.

    Examples
    --------
    >>> fourier(lambda theta: 1 + np.cos(2 * theta)[None], "s").real.round(12).tolist()
    [[1.0, 0.0, 0.5]]
    """
    count = _FIRST
    while True:
        grid = 2 * np.pi * np.arange(count) / count
        values = evaluate(np.append(grid, PROBES))
        spectrum = np.fft.rfft(values[:, :count], axis=1) / count
        size = np.abs(values[:, :count]).max(axis=1, initial=0.0, keepdims=True)
        spectrum[np.abs(spectrum) < 1e-15 * size] = 0.0
        miss = np.abs(_series(spectrum[:, : count // 2], PROBES) - values[:, count:])
        worst = float(np.max(miss / np.where(size > 0, size, 1.0), initial=0.0))  # each row against its own size
        if worst <= 1e-12 or count >= _FINEST:
            break
        count *= 2
    if worst > 1e-9:
        raise UnsupportedModel(
            f"system {name!r}: forcing or contact gain is not a smooth function of the phase "
            f"({count // 2} harmonics still miss it by {worst:.1e}); write it as a Fourier series"
        )
    used = np.flatnonzero(np.abs(spectrum).max(axis=0, initial=0.0))
    return spectrum[:, : (int(used[-1]) if used.size else 0) + 1]


def _series(spectrum: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Evaluate half spectra (rows, J+1) at phases (N,); returns (rows, N)."""
    k = np.arange(spectrum.shape[1])
    waves = np.where(k == 0, 1.0, 2.0)[:, None] * np.exp(1j * np.multiply.outer(k, phases))
    return np.asarray((spectrum @ waves).real)


def _order(rows: np.ndarray) -> int:
    size = np.abs(rows)
    used = np.flatnonzero((size > 1e-8 * size.max(axis=1, initial=0.0, keepdims=True)).any(axis=0))
    return int(used[-1]) if used.size else 0


def dependence(expression: ca.SX, p: ca.SX) -> np.ndarray:
    """Return which elements of p an expression depends on, boolean (q,)."""
    return np.array([bool(ca.depends_on(expression, p[i])) for i in range(p.numel())], dtype=bool)
