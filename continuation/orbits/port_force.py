"""Fourier coefficients of the port forces along a waveform: contacts in closed form, smooth laws by fine sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation.errors import UnsupportedModel
from continuation.model.ports import Ports
from continuation.orbits import contact_series as series

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

    def __call__(self, Y: np.ndarray, vector: np.ndarray, last: int, reach: int) -> PortForce:
        """Return port force harmonics 0..last and slope orders -reach..reach along the waveform Y (H+1, k)."""
        k, m = self.ports.outputs, self.ports.inputs
        W = np.zeros((last + 1, m), dtype=complex)
        slope = np.zeros((2 * reach + 1, m, k), dtype=complex)
        for i in range(len(self.ports.system.contacts)):
            self._add_contact(i, Y, vector, W, slope)
        if self.ports.smooth:
            self._add_smooth(Y, vector, W, slope)
        return PortForce(W, slope)

    def argument(self, i: int, Y: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Return the half spectrum of the argument of contact i."""
        offset = self.ports.forcing(vector).offset[i]
        n = self.period_multiple
        a = np.zeros(max(len(Y), (len(offset) - 1) * n + 1), dtype=complex)
        a[: len(Y)] = Y @ self.ports.linear(vector).d[i]
        a[: (len(offset) - 1) * n + 1 : n] += offset
        return a

    def _add_contact(self, i: int, Y: np.ndarray, vector: np.ndarray, W: np.ndarray, slope: np.ndarray) -> None:
        contact, n = self.ports.system.contacts[i], self.period_multiple
        gain, d = self.ports.forcing(vector).gain[i], self.ports.linear(vector).d[i]
        a = _trim(self.argument(i, Y, vector))
        two_sided = np.concatenate([a[:0:-1].conj(), a])
        pattern = series.find_pattern(a, contact)
        last, reach, edge = len(W) - 1, len(slope) // 2, (gain.shape[-1] - 1) * n
        most = max(last + len(a) - 1, reach) + edge
        rigid = series.piecewise_spectrum(pattern, np.array(contact.slopes), most)
        shift = series.piecewise_spectrum(pattern, contact.intercepts, last + edge)
        for row in range(W.shape[1]):
            g = series.modulate(rigid, gain[row], n)
            middle = len(g) // 2
            near = g[middle - last - len(a) + 1 : middle + last + len(a)]
            force = np.convolve(near, two_sided, mode="valid") + series.modulate(shift, gain[row], n)
            W[:, row] += force[last:]
            slope[:, row, :] += g[middle - reach : middle + reach + 1, None] * d

    def _add_smooth(self, Y: np.ndarray, vector: np.ndarray, W: np.ndarray, slope: np.ndarray) -> None:
        """Sample a smooth law until its spectrum has decayed to 1e-9 at Nyquist; aliasing is then about its square."""
        last, reach = len(W) - 1, len(slope) // 2
        explicit = self.ports.law_order * self.period_multiple
        least = 2 * (max(last, reach, len(Y)) + explicit) + 2
        count = max(64, 1 << int(np.ceil(np.log2(least))), self._samples // 2)
        while True:
            phases = np.arange(count) * (2 * np.pi * self.period_multiple / count)
            y = np.fft.irfft(Y, count, axis=0).T * count
            force, tangent = self.ports.law(y, phases, vector)
            spectrum = np.fft.rfft(force, axis=1) / count
            size = np.abs(spectrum)
            tail, top = size[:, -(count // 16) :].max(), max(size.max(), 1e-300)
            if tail <= 1e-9 * top or count >= _FINEST or not np.isfinite(top):
                break
            count *= 2
        if tail > 1e-8 * top:
            raise UnsupportedModel(
                f"system {self.ports.system.name!r}: the right-hand side is not smooth at {_FINEST} samples per period "
                f"(spectrum tail {tail / top:.1e}); declare corners as a Contact, or use a larger smoothing width"
            )
        self._samples = count
        W += spectrum.T[: last + 1]
        g = np.fft.rfft(tangent, axis=2)[:, :, : reach + 1].transpose(2, 0, 1) / count
        slope += np.concatenate([g[:0:-1].conj(), g])


def _trim(a: np.ndarray) -> np.ndarray:
    """Drop trailing harmonics that are exactly zero."""
    if a[-1] != 0:
        return a
    used = np.flatnonzero(a)
    return a[: (used[-1] + 1 if used.size else 1)]
