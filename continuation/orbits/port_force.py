"""Fourier coefficients of the port forces along a waveform.

Contacts that enter linearly are treated in closed form, smooth laws by fine sampling, and laws with contacts that enter
in any other way by Gauss quadrature between the contact changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from continuation.errors import RestingContact, UnsupportedModel
from continuation.model.linear_part import LinearPart
from continuation.model.port_parameters import PortParameters
from continuation.model.ports import Ports
from continuation.model.recent import Recent
from continuation.orbits import contact_series as series
from continuation.orbits.quadrature import Harmonics, sample

_Values = Callable[[np.ndarray, np.ndarray, np.ndarray | None], np.ndarray]
_REST = 1e-7  # largest way from a breakpoint, relative to the size of the orbit, that Newton's method does not resolve
_KEPT = 16  # contact patterns that are remembered
_FINEST = 2**17  # samples per period at most, for smooth laws


@dataclass(frozen=True, slots=True)
class PortForce:
    """Port force at one waveform: W (K, m) half spectrum, slope (2L+1, m, k) two-sided."""

    W: np.ndarray
    slope: np.ndarray


class PortForces:
    """Port forces of one System over ``period_multiple`` excitation periods."""

    def __init__(self, ports: Ports, period_multiple: int) -> None:
        self.ports, self.period_multiple = ports, period_multiple
        self._samples = 64
        self._linear: tuple[LinearPart, float] | None = None
        self._patterns: Recent[series.ContactPattern] = Recent(_KEPT)

    def __call__(self, Y: np.ndarray, vector: np.ndarray, last: int, reach: int) -> PortForce:
        """Return port force harmonics 0..last and slope orders -reach..reach along the waveform Y (H+1, k)."""
        k, m = self.ports.outputs, self.ports.inputs
        W = np.zeros((last + 1, m), dtype=complex)
        slope = np.zeros((2 * reach + 1, m, k), dtype=complex)
        for i in self.ports.closed:
            self._add_contact(i, Y, vector, W, slope)
        if self.ports.smooth:
            self._add_law(Y, vector, W, slope)
        return PortForce(W, slope)

    def parameter_derivative(self, Y: np.ndarray, vector: np.ndarray, last: int, index: int) -> np.ndarray:
        """Return harmonics 0..last (last+1, m) of d(port force)/d(parameter), the waveform Y (H+1, k) held fixed.

        Parameters
        ----------
        index : int
            Position of the parameter in ``system.parameter_names``.

        Notes
        -----
        A contact force is continuous, hence no boundary terms at contact changes: with gain g and argument a the
        derivative is ``g' force(a) + g slope(a) a'``, in closed form like the force. That of the law is integrated
        between contact changes like the law.
        """
        W = np.zeros((last + 1, self.ports.inputs), dtype=complex)
        if self.ports.system.contacts:
            change, d = self.parameters.forcing(vector, index), self.parameters.argument_slopes(vector, index)
            for i in self.ports.closed:
                moved = self._wave(change.offset[i], None if d is None else d[i], Y)
                self._add_contact_change(i, Y, vector, W, change.gain[i], trimmed(moved))
        law = self.ports.law
        if law.depends(index):
            W += self.integrated(Y, vector, last, lambda y, theta, modes: law.change(y, theta, vector, index, modes).T)
        return W

    @cached_property
    def parameters(self) -> PortParameters:
        """Derivatives of the port structure with respect to parameters."""
        return PortParameters(self.ports)

    def argument(self, i: int, Y: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Return the half spectrum of the argument of contact i, to rounding where it is not linear in the states.

        Raises
        ------
        UnsupportedModel
            If the argument has a corner of its own along the waveform.
        """
        if self.ports.straight(i):
            return self._wave(self.ports.forcing(vector).offset[i], self.ports.linear(vector).d[i], Y)
        place = self.ports.general.index(i)
        count = max(64, 1 << (4 * len(Y)).bit_length())
        while True:
            y, theta = self._grid(Y, count)
            spectrum = np.fft.rfft(self.ports.law.arguments(y, theta, vector)[place]) / count
            size = np.abs(spectrum)
            tail, top = size[-(count // 16) :].max(), max(size.max(), 1e-300)
            if tail <= 1e-13 * top or count >= _FINEST or not np.isfinite(top):
                break
            count *= 2
        if not tail <= 1e-9 * top:
            name = self.ports.system.contacts[i].name
            raise UnsupportedModel(
                f"contact {name!r} of system {self.ports.system.name!r}: its argument is not smooth along the orbit "
                f"({count} samples leave {tail / top:.1e}), as a radius is that passes through 0; "
                "declare its corners as Contacts, or round them"
            )
        used = np.flatnonzero(size > 1e-15 * top)
        spectrum[0] = spectrum[0].real
        return spectrum[: used[-1] + 1] if used.size else spectrum[:1]

    def arguments(self, i: int, spectra: np.ndarray, vectors: list[np.ndarray]) -> np.ndarray:
        """Return :meth:`argument` (N, K') of several orbits (N, K, k), padded to one length."""
        if not self.ports.straight(i):
            found = [self.argument(i, Y, v) for Y, v in zip(spectra, vectors, strict=True)]
            out = np.zeros((len(found), max(map(len, found))), dtype=complex)
            for row, a in zip(out, found, strict=True):
                row[: len(a)] = a
            return out
        n, (N, K, _) = self.period_multiple, spectra.shape
        offsets = [self.ports.forcing(v).offset[i] for v in vectors]
        out = np.zeros((N, max(K, *((len(offset) - 1) * n + 1 for offset in offsets))), dtype=complex)
        out[:, :K] = (spectra @ np.array([self.ports.linear(v).d[i] for v in vectors])[..., None])[..., 0]
        for row, offset in zip(out, offsets, strict=True):
            row[: (len(offset) - 1) * n + 1 : n] += offset
        return out

    def pattern(self, i: int, argument: np.ndarray) -> series.ContactPattern:
        """Return the changes of contact i along its argument (half spectrum); the last ones are remembered."""
        contact = self.ports.system.contacts[i]
        return self._patterns.get((i, argument.tobytes()), lambda: series.find_pattern(argument, contact))

    def check_rests(self, i: int, arguments: np.ndarray, spectra: np.ndarray, vectors: list[np.ndarray]) -> None:
        """Do :meth:`check_rest` for several orbits (N, K, k) with arguments (N, K')."""
        levels = np.array(self.ports.system.contacts[i].breakpoints)
        way = 2 * np.abs(arguments[:, 1:]).sum(axis=1) + np.abs(arguments[:, :1].real - levels).min(axis=1)
        size = np.abs(spectra).max(axis=(1, 2))
        for j in np.flatnonzero(way <= _REST * np.maximum(size, np.abs(levels).max())):
            self.check_rest(i, arguments[j], spectra[j], vectors[j])

    def check_rest(self, i: int, argument: np.ndarray, Y: np.ndarray, vector: np.ndarray) -> None:
        """Raise RestingContact if the argument of contact i (half spectrum) stays on a breakpoint all along Y."""
        system, contact = self.ports.system, self.ports.system.contacts[i]
        swing, size = 2 * np.abs(argument[1:]).sum(), np.abs(Y).max()
        for level in contact.breakpoints:
            if swing + abs(argument[0].real - level) > _REST * max(size, abs(level)):
                continue
            values = dict(zip(system.parameter_names, vector.tolist(), strict=True))
            given = ", ".join(f"{k} = {v:.10g}" for k, v in values.items())
            raise RestingContact(
                f"contact {contact.name!r} of {system.name!r} rests on its breakpoint {level:g} ({given}): the law has "
                "a corner there, so that multipliers do not exist; give the load another value (zero load leaves the "
                "contact undecided), or use system.smoothed(width)",
                0.0,
                values,
            )

    def _wave(self, offset: np.ndarray, d: np.ndarray | None, Y: np.ndarray) -> np.ndarray:
        """Return the half spectrum of ``offset + d . y``."""
        n = self.period_multiple
        a = np.zeros(max(len(Y), (len(offset) - 1) * n + 1), dtype=complex)
        if d is not None:
            a[: len(Y)] = Y @ d
        a[: (len(offset) - 1) * n + 1 : n] += offset
        return a

    def _add_contact(self, i: int, Y: np.ndarray, vector: np.ndarray, W: np.ndarray, slope: np.ndarray) -> None:
        contact, n = self.ports.system.contacts[i], self.period_multiple
        gain, d = self.ports.forcing(vector).gain[i], self.ports.linear(vector).d[i]
        a = trimmed(self.argument(i, Y, vector))
        pattern = self.pattern(i, a)
        last, reach, edge = len(W) - 1, len(slope) // 2, (gain.shape[-1] - 1) * n
        law, most = np.array([contact.slopes, contact.intercepts]).T, max(last + len(a) - 1, reach) + edge
        rigid, shift = series.piecewise_spectrum(pattern, law, most).T
        shift = shift[most - last - edge : most + last + edge + 1]
        for row in range(W.shape[1]):
            g = series.modulate(rigid, gain[row], n)
            W[:, row] += _times(g, a, last) + series.modulate(shift, gain[row], n)[last:]
            middle = len(g) // 2
            slope[:, row, :] += g[middle - reach : middle + reach + 1, None] * d

    def _add_contact_change(
        self, i: int, Y: np.ndarray, vector: np.ndarray, W: np.ndarray, gain_change: np.ndarray, moved: np.ndarray
    ) -> None:
        """Add what a changing gain and a changing argument (half spectrum ``moved``) of contact i do to the force."""
        if not (gain_change.any() or moved.any()):
            return
        contact, n, last = self.ports.system.contacts[i], self.period_multiple, len(W) - 1
        gain = self.ports.forcing(vector).gain[i]
        a = trimmed(self.argument(i, Y, vector))
        pattern = self.pattern(i, a)
        edge = (max(gain.shape[-1], gain_change.shape[-1]) - 1) * n
        longest = last + max(len(a), len(moved)) - 1 + edge
        rigid = series.piecewise_spectrum(pattern, np.array(contact.slopes), longest)
        shift = series.piecewise_spectrum(pattern, contact.intercepts, last + edge)
        for row in range(W.shape[1]):
            g = series.modulate(shift, gain_change[row], n)
            W[:, row] += g[len(g) // 2 :][: last + 1] + _times(series.modulate(rigid, gain_change[row], n), a, last)
            W[:, row] += _times(series.modulate(rigid, gain[row], n), moved, last)

    def _add_law(self, Y: np.ndarray, vector: np.ndarray, W: np.ndarray, slope: np.ndarray) -> None:
        last, reach = len(W) - 1, len(slope) // 2
        law, m = self.ports.law, self.ports.inputs

        def values(y: np.ndarray, theta: np.ndarray, modes: np.ndarray | None) -> np.ndarray:
            force, tangent = law(y, theta, vector, modes)
            return np.vstack([force, tangent.reshape(-1, theta.size)]).T

        found = self.integrated(Y, vector, max(last, reach), values, m)
        W += found[: last + 1, :m]
        g = found[: reach + 1, m:].reshape(reach + 1, m, -1)
        slope += np.concatenate([g[:0:-1].conj(), g])

    def integrated(
        self,
        Y: np.ndarray,
        vector: np.ndarray,
        last: int,
        values: Callable[..., np.ndarray],
        leading: int | None = None,
    ) -> np.ndarray:
        """Return Fourier coefficients 0..last (last+1, c) of a function of (y, theta, modes) -> (N, c) along Y.

        Smooth laws are sampled until the spectra of their ``leading`` first values have decayed.
        """
        corners, table = self.segments(Y, vector)
        if not corners.size:
            return self._sampled(
                Y, vector, last, lambda y, theta: values(y, theta, _spread(table, theta.size)), leading
            )
        order, multiple = max(last, len(Y) - 1), self.period_multiple

        def along(phases: np.ndarray, segments: np.ndarray, harmonics: Harmonics) -> np.ndarray:
            return values(harmonics.evaluate(Y).T, phases * multiple, table[:, segments])

        samples, found = sample(corners, order, along, self.noise(Y, vector), leading)
        return samples.coefficients(found, last)

    def segments(self, Y: np.ndarray, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the contact changes (r,) of the contacts inside the law, and their modes (g, r) behind each change.

        Without any change the modes have shape (g, 1).
        """
        patterns = [self.pattern(i, self.argument(i, Y, vector)) for i in self.ports.general]
        corners = np.unique(np.concatenate([np.zeros(0), *(p.phases for p in patterns)]))
        if not corners.size:
            return corners, np.array([p.modes[:1] for p in patterns], dtype=int)
        middles = (corners + np.append(corners[1:], corners[0] + 2 * np.pi)) / 2 % (2 * np.pi)
        return corners, np.array([p.modes[np.searchsorted(p.phases, middles)] for p in patterns])

    def noise(self, Y: np.ndarray, vector: np.ndarray) -> float:
        """Return the rounding error of the law, which is the right-hand side less forcing and linear part."""
        part = self.ports.linear(vector)
        if self._linear is None or self._linear[0] is not part:
            self._linear = part, float(np.abs(part.A[self.ports.rows][:, self.ports.cols]).max())
        load = np.abs(self.ports.forcing(vector).u[:, self.ports.rows]).max() + self._linear[1] * np.abs(Y).sum()
        return float(1e-15 * load)

    def _grid(self, Y: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return waveform (k, count) and excitation phases on a regular grid."""
        return np.fft.irfft(Y, count, axis=0).T * count, np.arange(count) * (2 * np.pi * self.period_multiple / count)

    def _sampled(
        self,
        Y: np.ndarray,
        vector: np.ndarray,
        last: int,
        values: Callable[[np.ndarray, np.ndarray], np.ndarray],
        leading: int | None,
    ) -> np.ndarray:
        """Sample a smooth law until its spectrum has decayed to 1e-9 at Nyquist; aliasing is then about its square."""
        explicit = self.ports.law_order * self.period_multiple
        least = 2 * (max(last, len(Y)) + explicit) + 2
        count = max(64, 1 << int(np.ceil(np.log2(least))), self._samples // 2)
        while True:
            found = values(*self._grid(Y, count))
            spectrum = np.fft.rfft(found, axis=0) / count
            size = np.abs(spectrum[:, :leading])
            tail, top = size[-(count // 16) :].max(), max(size.max(), 1e-300)
            if tail <= 1e-9 * top or tail <= self.noise(Y, vector) or count >= _FINEST or not np.isfinite(top):
                break
            count *= 2
        if tail > max(1e-8 * top, self.noise(Y, vector)):
            raise UnsupportedModel(
                f"system {self.ports.system.name!r}: the right-hand side is not smooth at {_FINEST} samples per period "
                f"(spectrum tail {tail / top:.1e}); declare corners as a Contact, or use a larger smoothing width"
            )
        self._samples = count
        return spectrum[: last + 1]


def _spread(modes: np.ndarray, count: int) -> np.ndarray | None:
    """Return modes (g, 1) for every sample, None without contacts."""
    return np.repeat(modes, count, axis=1) if modes.size else None


def _times(two_sided: np.ndarray, wave: np.ndarray, last: int) -> np.ndarray:
    """Multiply two-sided coefficients by a waveform (half spectrum); returns orders 0..last of the product."""
    middle, reach = len(two_sided) // 2, len(wave) - 1
    both = np.concatenate([wave[:0:-1].conj(), wave])
    return np.convolve(two_sided[middle - reach : middle + last + reach + 1], both, mode="valid")


def trimmed(a: np.ndarray) -> np.ndarray:
    """Drop trailing harmonics that are exactly zero."""
    if a[-1] != 0:
        return a
    used = np.flatnonzero(a)
    return a[: (used[-1] + 1 if used.size else 1)]
