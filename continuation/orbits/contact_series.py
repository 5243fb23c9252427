"""Closed-form Fourier coefficients of a piecewise-linear contact force along a trigonometric polynomial.

Between two contact changes the force is slope * argument + intercept, so that the Fourier coefficients of slope and
intercept along the orbit are elementary functions of the contact phases. Nothing is sampled; the force is continuous,
hence the derivative of its coefficients needs no boundary terms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation.model.contact import Contact

_ROUNDING = 1e-15  # of an argument, relative to the sum of its amplitudes and its level
_NONE = np.zeros(0)
_MANY = 2000  # exponentials from which products are cheaper
_CLOSE = 1e-3  # distance between roots that are looked at for rounding between them, rad


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


def turns(phases: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Return ``exp(i order phase)``, shape (N, K), for phases (N,) and consecutive orders (K,).

    Many of them are products of few exponentials, of every 64th order and of the 64 between.

    >>> bool(np.abs(turns(np.ones(40), np.arange(-99.5, 100)) - np.exp(1j * np.arange(-99.5, 100))).max() < 1e-13)
    True
    """
    if phases.size * orders.size < _MANY:
        return np.asarray(np.exp(1j * np.multiply.outer(phases, orders)))
    coarse = np.exp(1j * np.multiply.outer(phases, orders[::64]))
    fine = np.exp(1j * np.multiply.outer(phases, np.arange(64)))
    return (coarse[:, :, None] * fine[:, None]).reshape(len(phases), -1)[:, : len(orders)]


def find_pattern(argument: np.ndarray, contact: Contact) -> ContactPattern:
    """Find every contact change of a trigonometric polynomial (half spectrum (H+1,)); see :func:`find_patterns`."""
    return find_patterns(argument[None], contact)[0]


def find_patterns(arguments: np.ndarray, contact: Contact) -> list[ContactPattern]:
    """Find every contact change of several trigonometric polynomials (N, H+1), short contacts included.

    Each is sampled at 8 to 16 points per shortest wave. A bound of the second derivative tells the intervals that can't
    hold a root, or not more than one; the others are halved until it does, so that no contact is missed unless it is
    shallower than rounding. Cost grows where the argument comes close to a breakpoint without crossing it.
    """
    count = 8 << max(arguments.shape[1] - 1, 2).bit_length()
    values = np.empty((len(arguments), count + 1))
    values[:, :count] = np.fft.irfft(arguments, count, axis=1, norm="forward")
    values[:, count] = values[:, 0]
    brackets = _brackets(arguments, values, np.array(contact.breakpoints))
    if brackets is None:
        return [ContactPattern(_NONE, mode[None]) for mode in contact.mode(values[:, 0])]
    owner, phases, _, _, right, level = brackets
    phases = _polish(arguments, *brackets)
    kept = _deeper_than_rounding(arguments, owner, phases, level)
    owner, phases, right, level = owner[kept], phases[kept], right[kept], level[kept]
    after = np.searchsorted(contact.breakpoints, level) + (right > 0)  # a root that rises leads to the upper mode
    return _patterns(values[:, 0], owner, phases, after, contact)


def _brackets(arguments: np.ndarray, values: np.ndarray, levels: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """Return owner, ends, values less the level there, and level of intervals that hold one root each; None if none."""
    width = 2 * np.pi / (values.shape[1] - 1)
    size = np.abs(arguments)
    bend = 2 * size @ np.arange(arguments.shape[1]) ** 2.0  # largest second derivative
    near = bend * width**2 / 8
    low, high = values.min(axis=1) - near, values.max(axis=1) + near
    found: list[tuple[np.ndarray, ...]] = []
    for level in levels:
        if not ((low <= level) & (level <= high)).any():
            continue
        f = values - level
        above, close = f > 0, np.abs(f) <= near[:, None]
        i, j = np.nonzero((above[:, 1:] != above[:, :-1]) | close[:, 1:] | close[:, :-1])
        if i.size:
            found.append((i, j * width, (j + 1) * width, f[i, j], f[i, j + 1], np.full(i.size, level)))
    if not found:
        return None
    cells = tuple(np.concatenate(column) for column in zip(*found, strict=True))
    rounding = _ROUNDING * (2 * size.sum(axis=1) + np.abs(levels).max())
    sure: list[tuple[np.ndarray, ...]] = []
    while True:
        owner, low, high, left, right, level = cells
        wave = bend[owner] * (high - low) ** 2
        crosses, unsure = _judge(left, right, wave)
        unsure &= wave > rounding[owner]
        sure.append(tuple(c[crosses & ~unsure] for c in cells))
        if not unsure.any():
            break
        owner, low, high, left, right, level = (c[unsure] for c in cells)
        middle = (low + high) / 2
        f = _at(arguments, owner, middle, 0) - level
        ends = np.append(low, middle), np.append(middle, high), np.append(left, f), np.append(f, right)
        cells = np.append(owner, owner), *ends, np.append(level, level)
    kept = sure[0] if len(sure) == 1 else tuple(np.concatenate(column) for column in zip(*sure, strict=True))
    return kept if kept[0].size else None


def _judge(left: np.ndarray, right: np.ndarray, wave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tell intervals whose ends lie on different sides, and those that may hold more roots than that.

    ``wave`` is the bound of the second derivative times the width squared: an eighth of it is the largest distance
    from the chord, and with half of it less than the rise the function is monotone.
    """
    crosses = (left > 0) != (right > 0)
    near = np.minimum(np.abs(left), np.abs(right)) <= wave / 8
    return crosses, np.where(crosses, np.abs(right - left) <= wave / 2, near)


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


def _deeper_than_rounding(
    arguments: np.ndarray, owner: np.ndarray, phases: np.ndarray, level: np.ndarray
) -> np.ndarray:
    """Return the indices of roots that are left when the argument must pass its level by more than rounding.

    Of a run of roots with nothing but rounding between them an even number is none, and an odd number one.
    """
    order = np.lexsort((phases, level, owner))
    i, t, b = owner[order], phases[order], level[order]
    close = (i[1:] == i[:-1]) & (b[1:] == b[:-1]) & (np.diff(t) < _CLOSE)
    if not close.any():
        return order
    size = 2 * np.abs(arguments[i]).sum(axis=1) + np.abs(b)
    depth = np.abs(_at(arguments, i[1:], (t[1:] + t[:-1]) / 2, 0) - b[1:])
    starts = np.flatnonzero(np.append(True, ~(close & (depth <= _ROUNDING * size[1:]))))
    counts = np.diff(np.append(starts, len(order)))
    odd = counts % 2 == 1
    return np.asarray(order[starts[odd] + 2 * (counts[odd] // 4)])  # one that goes the way of the first


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
    """Return two-sided Fourier coefficients of the function that is values[mode] in each mode, orders -last..last.

    Parameters
    ----------
    values : array (modes,) or (modes, c)

    Returns
    -------
    complex array (2 last + 1,) or (2 last + 1, c)
    """
    level, phases = values[pattern.modes], pattern.phases
    out = np.zeros((2 * last + 1, *values.shape[1:]), dtype=complex)
    out[last] = level[-1]
    if phases.size:
        jump = level[1:] - level[:-1]
        k = np.arange(1, last + 1)
        positive = (turns(-phases, k).T @ jump).T / (2j * np.pi * k)
        out[last] -= phases @ jump / (2 * np.pi)
        out[last + 1 :], out[:last] = positive.T, positive.T[::-1].conj()
    return out


def modulate(two_sided: np.ndarray, gain: np.ndarray, multiple: int) -> np.ndarray:
    """Multiply by a periodic gain (half spectrum (J+1,), its harmonic j sits at order j*multiple); trims both ends.

    Returns the two-sided coefficients of orders -(last - J*multiple)..(last - J*multiple).
    """
    reach = (len(gain) - 1) * multiple
    kernel = np.zeros(2 * reach + 1, dtype=complex)
    kernel[reach::multiple] = gain
    kernel[reach::-multiple] = gain.conj()
    return np.convolve(two_sided, kernel, mode="valid")
