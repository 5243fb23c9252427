"""One periodic solution, immutable, whatever method found it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from continuation.errors import nearest
from continuation.orbits.contact_series import evaluate

Stability = Literal["stable", "unstable", "undecided"]


@dataclass(frozen=True, slots=True, eq=False)
class Orbit:
    """A periodic orbit as Fourier coefficients of its states.

    Attributes
    ----------
    system : str
        Name of the System.
    state_names : tuple of str, length n
    parameter : str
        Name of the continuation parameter.
    parameters : mapping of str to float
        All parameter values, the continuation parameter included.
    period : float
        Period in the System's unit of time.
    period_multiple : int
        Excitation periods per period of the orbit.
    coefficients : complex array (K+1, n)
        Half spectrum over the orbit's period: x = c_0 + 2 Re sum_k c_k exp(i k phi), phi = phase / period_multiple.
    multipliers : complex array (n,)
        Floquet multipliers over the orbit's period, largest modulus first.
    multiplier_error : array (n,)
        Error bar of each multiplier.
    stability : "stable", "unstable" or "undecided"
    error : float
        Estimated largest error of the waveform: of the port arguments by harmonic balance (for a gear, lambda; rates
        of change err more), of all states by shooting.
    contacts : mapping of str to (array (r,), integer array (r + 1,))
        Of every Contact the excitation phases in rad, 0 .. 2*pi*period_multiple, at which it changes its linear piece,
        and the index of the piece before the first change and after each.
    second_opinion : array (n,)
        Difference of each multiplier from a second method, NaN where none was asked (see
        :func:`continuation.certify`).

    Examples
    --------
    >>> orbit = Orbit(system="s", state_names=("x",), parameter="g", parameters={"g": 1.0}, period=2.0,
    ...               period_multiple=1, coefficients=np.array([[0j], [0.5]]), multipliers=np.array([0.5 + 0j]),
    ...               multiplier_error=np.zeros(1), stability="stable", error=0.0)
    >>> orbit.extremes("x"), orbit.exponents.round(6).tolist(), orbit.decay_times.round(6).tolist()
    ((-1.0, 1.0), [(-0.346574+0j)], [2.88539])
    """

    system: str
    state_names: tuple[str, ...]
    parameter: str
    parameters: Mapping[str, float]
    period: float
    period_multiple: int
    coefficients: np.ndarray = field(repr=False)
    multipliers: np.ndarray = field(repr=False)
    multiplier_error: np.ndarray = field(repr=False)
    stability: Stability
    error: float
    contacts: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)
    second_opinion: np.ndarray = field(default=np.nan, repr=False)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        opinion = np.broadcast_to(np.asarray(self.second_opinion, dtype=float), np.shape(self.multipliers))
        object.__setattr__(self, "second_opinion", opinion)
        for name in ("coefficients", "multipliers", "multiplier_error", "second_opinion"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        contacts = {k: (_frozen(phases), _frozen(modes)) for k, (phases, modes) in self.contacts.items()}
        object.__setattr__(self, "contacts", MappingProxyType(contacts))
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))

    @property
    def value(self) -> float:
        """Continuation parameter."""
        return self.parameters[self.parameter]

    @property
    def harmonic_count(self) -> int:
        """Number of harmonics kept."""
        return len(self.coefficients) - 1

    @property
    def exponents(self) -> np.ndarray:
        """Floquet exponents ``log(multiplier) / period``, complex (n,), per unit of time.

        Imaginary parts lie within half the orbit's frequency; the real part of a multiplier 0 is minus infinity.
        """
        size = np.abs(self.multipliers)
        growth = np.log(size, out=np.full(size.shape, -np.inf), where=size > 0)
        growth[np.isnan(size)] = np.nan
        out = np.empty(size.shape, dtype=complex)
        out.real, out.imag = growth / self.period, np.angle(self.multipliers) / self.period
        return out

    @property
    def decay_times(self) -> np.ndarray:
        """Time (n,) in which each mode falls to 1/e: negative where it grows, infinite at |mu| = 1."""
        rate = -self.exponents.real
        return np.divide(1.0, rate, out=np.full(rate.shape, np.inf), where=rate != 0)

    def index(self, state: str) -> int:
        """Return the column of a state; an unknown name raises ValueError that lists the nearest."""
        if state not in self.state_names:
            raise ValueError(f"no state {state!r} in system {self.system!r}; {nearest(state, self.state_names)}")
        return self.state_names.index(state)

    def evaluate(self, phases: np.ndarray) -> np.ndarray:
        """Return the states (N, n) at excitation phases (N,) in rad, 0 .. 2*pi*period_multiple for one period."""
        return evaluate(self.coefficients, np.atleast_1d(np.asarray(phases, dtype=float)) / self.period_multiple)

    def harmonics(self, state: str) -> np.ndarray:
        """Return the complex half spectrum (K+1,) of one state."""
        return self.coefficients[:, self.index(state)]

    def mean(self, state: str) -> float:
        """Return the mean of one state."""
        return float(self.harmonics(state)[0].real)

    def rms(self, state: str) -> float:
        """Return the root mean square of one state about its mean."""
        return float(np.sqrt(2 * np.sum(np.abs(self.harmonics(state)[1:]) ** 2)))

    def extremes(self, state: str) -> tuple[float, float]:
        """Return minimum and maximum of one state, parabolic between 32 samples per shortest wave."""
        count = 32 << max(self.harmonic_count, 4).bit_length()
        x = np.fft.irfft(self.harmonics(state), count, norm="forward")
        return -_peak(-x), _peak(x)


def _frozen(values: np.ndarray) -> np.ndarray:
    array = np.array(values)
    array.flags.writeable = False
    return array


def _peak(x: np.ndarray) -> float:
    i = int(np.argmax(x))
    left, middle, right = x[i - 1], x[i], x[(i + 1) % len(x)]
    bend = left - 2 * middle + right
    return float(middle - (right - left) ** 2 / (8 * bend)) if bend < 0 else float(middle)
