"""Numbers that describe a sampled waveform."""

from __future__ import annotations

import numpy as np


def describe_waveform(waveform: np.ndarray, periodic: bool) -> tuple[float, float, float, float]:
    """Return rms about the mean, mean, minimum and maximum of equidistant samples (k,).

    Extremes lie between samples: they are sought on the quartic through the extreme sample and two more on each side.

    Examples
    --------
    >>> theta = 2 * np.pi * np.arange(64) / 64
    >>> [round(v, 6) for v in describe_waveform(2 + np.cos(theta - 0.04), True)]
    [0.707107, 2.0, 1.0, 3.0]
    """
    mean = float(waveform.mean())
    rms = float(np.sqrt(((waveform - mean) ** 2).mean()))
    return rms, mean, _extreme(waveform, periodic, -1), _extreme(waveform, periodic, 1)


_OFFSETS = np.arange(-2, 3)
_FINE = np.vander(np.linspace(-1, 1, 201), 5) @ np.linalg.inv(np.vander(_OFFSETS.astype(float), 5))


def _extreme(waveform: np.ndarray, periodic: bool, sign: int) -> float:
    k = int((sign * waveform).argmax())
    if not periodic and not 2 <= k < len(waveform) - 2:
        return float(waveform[k])
    return float(sign * (sign * (_FINE @ waveform[(k + _OFFSETS) % len(waveform)])).max())


def harmonics(waveform: np.ndarray, periods: int, count: int) -> np.ndarray:
    """Return the complex amplitudes c_k of ``Re sum_k c_k exp(i k theta)``, k = 0 to count, over whole periods.

    Parameters
    ----------
    waveform : ndarray (periods * samples,)
        Equidistant samples; harmonics alias with the k-th power of their decay, so that ``count`` should stay well
        below samples / 2.

    Examples
    --------
    >>> theta = 2 * np.pi * np.arange(128) / 64
    >>> harmonics(0.5 + np.cos(theta - 0.3) + np.sin(theta / 2), 2, 2).round(6).tolist()      # exp(-0.3i) at k = 1
    [(0.5+0j), (0.955336-0.29552j), 0j]
    """
    c = np.fft.rfft(waveform)[: periods * count + 1 : periods] / len(waveform)
    c[1:] *= 2
    return c + 0.0


def order_spectrum(waveform: np.ndarray, periods: int, highest: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    """Return orders (multiples of the excitation frequency) and amplitudes with a Hann window, the mean taken off.

    Parameters
    ----------
    waveform : ndarray (periods * samples,)
        Equidistant samples over whole excitation periods; the resolution is 1/periods of the excitation frequency.

    Returns
    -------
    orders, amplitudes : ndarray (k,)
        A harmonic of amplitude a shows a, and a/2 at both neighbours.

    Examples
    --------
    >>> theta = 2 * np.pi * np.arange(16 * 64) / 64
    >>> orders, amplitudes = order_spectrum(3 + 0.7 * np.cos(1.5 * theta), 16)
    >>> float(orders[amplitudes.argmax()]), round(float(amplitudes.max()), 9)
    (1.5, 0.7)
    """
    window = 1 - np.cos(2 * np.pi * np.arange(len(waveform)) / len(waveform))
    amplitudes = 2 * abs(np.fft.rfft(window * (waveform - waveform.mean()))) / len(waveform)
    orders = np.arange(len(amplitudes)) / periods
    keep = orders <= highest
    return orders[keep], amplitudes[keep]
