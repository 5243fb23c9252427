"""Closed-form Fourier coefficients of a piecewise-linear contact force along a trigonometric polynomial.

Between two contact changes the force is slope * argument + intercept, so that the Fourier coefficients of slope and
intercept along the orbit are elementary functions of the contact phases. Nothing is sampled; the force is continuous,
hence the derivative of its coefficients needs no boundary terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation.model.contact import Contact


@dataclass(frozen=True, slots=True)
class ContactPattern:
    """Contact changes along one period 2*pi: phases (r,) increasing; modes (r + 1,), before, between and after them."""

    phases: np.ndarray
    modes: np.ndarray


def evaluate(coefficients: np.ndarray, phases: np.ndarray, derivative: int = 0) -> np.ndarray:
    """Evaluate real trigonometric polynomials at phases.

    Parameters
    ----------
    coefficients : complex array (H+1, ...)
        Half spectrum: value = c_0 + 2 Re sum_k c_k exp(i k phase).
    phases : array (N,)
    derivative : int
        Order of the derivative with respect to the phase.

    Returns
    -------
    array (N, ...)

    Examples
    --------
    >>> evaluate(np.array([1.0, 0.5]), np.array([0.0, np.pi])).tolist()
    [2.0, 0.0]
    """
    k = np.arange(coefficients.shape[0])
    weights = np.where(k == 0, 1.0, 2.0) * (1j * k) ** derivative
    scaled = coefficients * weights.reshape(-1, *([1] * (coefficients.ndim - 1)))
    return np.tensordot(np.exp(1j * np.outer(phases, k)), scaled, axes=1).real


def find_pattern(argument: np.ndarray, contact: Contact) -> ContactPattern:
    """Find every contact change of a trigonometric polynomial (half spectrum (H+1,)), short contacts included.

    The argument is sampled at 8 to 16 points per shortest wave; extrema between samples that may reach a breakpoint
    are searched by Newton's method, so that a contact shorter than a sample is not missed.
    """
    count = 8 << (len(argument) + 1).bit_length()
    values = np.fft.irfft(argument, count, norm="forward")
    step = 2 * np.pi / count
    grid = np.arange(count + 1) * step
    values = np.append(values, values[0])
    extrema = _extrema(argument, values, step, contact)
    if extrema.size:
        grid, values = np.concatenate([grid, extrema]), np.concatenate([values, evaluate(argument, extrema)])
        order = np.argsort(grid, kind="stable")
        grid, values = grid[order], values[order]
    levels = np.array(contact.breakpoints)
    above = values[:, None] > levels
    i, j = np.nonzero(above[1:] != above[:-1])
    order = np.argsort(i, kind="stable")
    phases = np.sort(_polish(argument, grid, values, i[order], levels[j[order]])) if i.size else np.zeros(0)
    return ContactPattern(phases, _modes(argument, phases, values[0], contact))


def _extrema(argument: np.ndarray, values: np.ndarray, step: float, contact: Contact) -> np.ndarray:
    """Return phases of extrema between samples that lie close to a breakpoint, inside [0, 2*pi]."""
    rise = np.diff(values)
    turn = np.flatnonzero(rise * np.append(rise[1:], rise[0]) <= 0) + 1
    bend = np.abs(rise[turn - 1]) + np.abs(rise[turn % len(rise)])
    near = np.abs(values[turn, None] - np.array(contact.breakpoints)) <= bend[:, None]
    phases = turn[near.any(axis=1)] * step
    for _ in range(4 if phases.size else 0):
        first, second = evaluate(argument, phases, 1), evaluate(argument, phases, 2)
        move = np.divide(-first, second, out=np.zeros_like(first), where=second != 0)
        phases = phases + np.clip(move, -step, step)
    return np.mod(phases, 2 * np.pi)


def _polish(argument: np.ndarray, grid: np.ndarray, values: np.ndarray, i: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Newton's method inside a shrinking bracket, all roots at once; bracket i is grid[i], grid[i+1]."""
    low, high, left, right = grid[i], grid[i + 1], values[i] - level, values[i + 1] - level
    k = np.arange(len(argument))
    both = np.stack([argument, 1j * k * argument], axis=1)
    both[1:] *= 2
    phase = low - left * (high - low) / (right - left)
    for _ in range(12):
        value, slope = (np.exp(1j * np.multiply.outer(phase, k)) @ both).real.T
        value = value - level
        same = (value > 0) == (left > 0)
        low, high = np.where(same, phase, low), np.where(same, high, phase)
        new = phase - np.divide(value, slope, out=np.full_like(value, np.inf), where=slope != 0)
        new = np.where((new >= low) & (new <= high), new, (low + high) / 2)
        moved = np.abs(new - phase).max()
        phase = new
        if moved < 1e-9:  # quadratic: the next step would be below rounding
            break
    return phase


def _modes(argument: np.ndarray, phases: np.ndarray, start: float, contact: Contact) -> np.ndarray:
    if not phases.size:
        return np.array([contact.mode(start)])
    edges = np.concatenate([[phases[-1] - 2 * np.pi], phases])
    middle = evaluate(argument, (edges[1:] + edges[:-1]) / 2)
    modes = contact.mode(middle)
    return np.append(modes, modes[0])


def piecewise_spectrum(pattern: ContactPattern, values: np.ndarray, last: int) -> np.ndarray:
    """Return two-sided Fourier coefficients, orders -last..last, of the function that is values[mode] in each mode."""
    level = values[pattern.modes]
    jump, phases = np.diff(level), pattern.phases
    k = np.arange(1, last + 1)
    positive = (np.exp(-1j * np.outer(k, phases)) @ jump) / (2j * np.pi * k)
    mean = level[-1] - jump @ phases / (2 * np.pi) if phases.size else level[0]
    return np.concatenate([positive[::-1].conj(), [mean], positive])


def modulate(two_sided: np.ndarray, gain: np.ndarray, multiple: int) -> np.ndarray:
    """Multiply by a periodic gain (half spectrum (J+1,), its harmonic j sits at order j*multiple); trims both ends.

    Returns the two-sided coefficients of orders -(last - J*multiple)..(last - J*multiple).
    """
    reach = (len(gain) - 1) * multiple
    kernel = np.zeros(2 * reach + 1, dtype=complex)
    kernel[reach::multiple] = gain
    kernel[reach::-multiple] = gain.conj()
    return np.convolve(two_sided, kernel, mode="valid")
