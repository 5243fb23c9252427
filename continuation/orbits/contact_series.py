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
    """Find every contact change of a trigonometric polynomial (half spectrum (H+1,)); see :func:`find_patterns`."""
    return find_patterns(argument[None], contact)[0]


def find_patterns(arguments: np.ndarray, contact: Contact) -> list[ContactPattern]:
    """Find every contact change of several trigonometric polynomials (N, H+1), short contacts included.

    Each is sampled at 8 to 16 points per shortest wave; extrema between samples that may reach a breakpoint are
    searched by Newton's method, so that a contact shorter than a sample is not missed.
    """
    count = 8 << max(arguments.shape[1] - 1, 2).bit_length()
    values = np.empty((len(arguments), count + 2))  # two samples more than a period, to look across its end
    values[:, :count] = np.fft.irfft(arguments, count, axis=1, norm="forward")
    values[:, count:] = values[:, :2]
    step = 2 * np.pi / count
    brackets = _brackets(values, contact.breakpoints, step)
    extrema = _extrema(arguments, values, step, np.array(contact.breakpoints))
    if extrema:
        brackets = _with_extrema(arguments, extrema, values, np.array(contact.breakpoints), brackets, step)
    owner, left, _, _, f_right, level = brackets
    phases = _polish(arguments, *brackets) if owner.size else left
    after = np.searchsorted(contact.breakpoints, level) + (f_right > 0)  # a root that rises leads to the upper mode
    return _patterns(values[:, 0], owner, phases, after, contact)


def _brackets(values: np.ndarray, levels: tuple[float, ...], step: float) -> tuple[np.ndarray, ...]:
    """Return owner, phases and values (less the level) at both ends, and level of every sample interval with a root."""
    wide = values.shape[1] - 2
    found = []
    for level in levels:
        above = values[:, : wide + 1] > level
        flat = np.flatnonzero(above[:, 1:] != above[:, :-1])
        i, j = np.divmod(flat, wide)
        found.append((i, j * step, (j + 1) * step, values[i, j] - level, values[i, j + 1] - level))
    sizes = [len(f[0]) for f in found]
    return *(np.concatenate(column) for column in zip(*found, strict=True)), np.repeat(np.array(levels), sizes)


def _extrema(
    arguments: np.ndarray, values: np.ndarray, step: float, levels: np.ndarray
) -> list[tuple[int, int, float]]:
    """Return (owner, sample before, phase) of extrema that may reach past a breakpoint between two samples."""
    rise = np.diff(values, axis=1)
    flat = np.flatnonzero(rise[:, 1:] * rise[:, :-1] <= 0)
    i, j = np.divmod(flat, rise.shape[1] - 1)
    j += 1
    bend = np.abs(rise[i, j] - rise[i, j - 1])
    near = (np.abs(values[i, j, None] - levels) <= bend[:, None]).any(axis=1)
    i, j = i[near], j[near]
    if not i.size:
        return []
    phase = j * step
    for _ in range(4):
        first, second = _at(arguments, i, phase, 1), _at(arguments, i, phase, 2)
        move = np.divide(-first, second, out=np.zeros_like(first), where=second != 0)
        phase = phase + np.clip(move, -step, step)
    return [(int(a), int(np.floor(b / step)), float(b)) for a, b in zip(i, phase, strict=True)]


def _with_extrema(  # type: ignore[no-untyped-def]
    arguments, extrema, values, levels, brackets, step
) -> tuple[np.ndarray, ...]:
    """Replace every sample interval that holds an extremum by its two parts."""
    i, left, right, f_left, f_right, level = brackets
    columns = [list(c) for c in (i, left, right, f_left, f_right, level)]
    count = values.shape[1] - 2
    cells: dict[tuple[int, int], list[float]] = {}
    for owner, cell, phase in extrema:
        cells.setdefault((owner, cell % count), []).append(float(np.mod(phase, 2 * np.pi)))
    taken = {(int(a), round(b / step)) for a, b in zip(i, left, strict=True)} & set(cells)
    keep = [n for n, (a, b) in enumerate(zip(i, left, strict=True)) if (int(a), round(b / step)) not in taken]
    columns = [[c[n] for n in keep] for c in columns]
    for (owner, cell), inner in cells.items():
        inside = sorted({p for p in inner if cell * step < p < (cell + 1) * step})
        grid = np.array([cell * step, *inside, (cell + 1) * step])
        f = np.array([values[owner, cell], *_at(arguments, np.full(len(inside), owner), grid[1:-1], 0),
                      values[owner, cell + 1]])  # fmt: skip
        for b in levels:
            for n in np.flatnonzero((f[1:] > b) != (f[:-1] > b)):
                for c, v in zip(columns, (owner, grid[n], grid[n + 1], f[n] - b, f[n + 1] - b, b), strict=True):
                    c.append(v)
    return np.array(columns[0], dtype=int), *(np.array(c, dtype=float) for c in columns[1:])


def _at(arguments: np.ndarray, owner: np.ndarray, phases: np.ndarray, derivative: int) -> np.ndarray:
    """Evaluate the polynomial of each owner at its phase (R,)."""
    k = np.arange(arguments.shape[1])
    weights = np.where(k == 0, 1.0, 2.0) * (1j * k) ** derivative
    return (np.exp(1j * np.multiply.outer(phases, k)) * arguments[owner] @ weights).real


def _polish(
    arguments: np.ndarray,
    owner: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    level: np.ndarray,
) -> np.ndarray:
    """Newton's method inside shrinking brackets, all roots at once."""
    k = np.arange(arguments.shape[1])
    own = arguments[owner]
    weights = np.stack([np.where(k == 0, 1.0, 2.0), 2j * k], axis=1)
    phase = low - left * (high - low) / (right - left)
    for _ in range(60):  # near grazing Newton only halves the error
        value, slope = ((np.exp(1j * np.multiply.outer(phase, k)) * own) @ weights).real.T
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


def _patterns(
    start: np.ndarray, owner: np.ndarray, phases: np.ndarray, after: np.ndarray, contact: Contact
) -> list[ContactPattern]:
    """Sort roots by owner; ``after`` (R,) is the mode behind each root, ``start`` (N,) the argument at phase 0."""
    order = np.lexsort((phases, owner))
    phases, after = phases[order], after[order]
    ends = np.cumsum(np.bincount(owner, minlength=len(start)))
    out, begin = [], 0
    for end, value in zip(ends.tolist(), start, strict=True):
        if end > begin:
            out.append(ContactPattern(phases[begin:end], np.append(after[end - 1], after[begin:end])))
        else:
            out.append(ContactPattern(phases[:0], np.array([contact.mode(value)])))
        begin = end
    return out


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
