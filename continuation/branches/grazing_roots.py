"""Common zeros of a contact argument's height above a breakpoint and of its slope, on one piece of a branch.

The waveform is a quadratic of the arclength through those of both ends and the middle, with a bound of its error. Both
functions are bounded on cells of arclength and phase; cells on which neither is bounded away from zero are halved,
those on which the one extremum stays clear of the breakpoint are left out, and Newton's method starts from the others.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from continuation.model.contact import Contact
from continuation.orbits.contact_series import evaluate, find_pattern

_SAFETY = 1.5  # of the bounds from second differences
_HALVINGS = 6  # of cells
_ROUNDING = 1e-15  # of a waveform, relative to its size
_APART = 4.0  # error bounds by which two roots of one extremum must be separated in height
_CROWD = 400  # cells left that are no isolated points
_STILL = 1e-9  # amplitude of a waveform, relative to the breakpoint, that counts as rest

Root = tuple[float, float, int, int]
"""Coordinate x, phase, side (1 a maximum, -1 a minimum) and change of the number of contact changes."""


def suspicious(spectra: np.ndarray, levels: tuple[float, ...]) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield (piece, level number, cells) of what the bounds on a grid leave of half spectra (S, 3, H+1).

    A cell is (x, phase, width of x, width of phase); the grid has 2 x (8 to 16 per shortest wave) of them.
    """
    count = 8 << max(spectra.shape[2] - 1, 2).bit_length()
    step = 2 * np.pi / count
    slopes = spectra * (1j * step * np.arange(spectra.shape[2]))
    g, d = (np.fft.irfft(a, count, axis=2, norm="forward") for a in (spectra, slopes))
    g, d = (np.concatenate([a, a[..., :2]], axis=2) for a in (g, d))
    # distance of both functions from their values at the corners of a cell: along the branch, over the phase
    bent = [np.abs(a[:, 0] - 2 * a[:, 1] + a[:, 2]) for a in (g, d)]
    turn = np.abs(np.diff(d, axis=2))
    turns = np.maximum(turn[..., 1:], turn[..., :-1]).max(axis=1), np.abs(np.diff(d, n=2, axis=2)).max(axis=1)
    margin = [
        _SAFETY / 8 * (np.maximum(b[:, :count], b[:, 1 : count + 1]) + t) for b, t in zip(bent, turns, strict=True)
    ]
    low, high = [], []
    for a, m in zip((g, d), margin, strict=True):
        sides = [a[:, :2, :count], a[:, :2, 1 : count + 1], a[:, 1:, :count], a[:, 1:, 1 : count + 1]]
        low.append(np.minimum.reduce(sides) - m[:, None])
        high.append(np.maximum.reduce(sides) + m[:, None])
    flat = (low[1] <= 0) & (high[1] >= 0)
    swing = 2 * np.abs(spectra[:, :, 1:]).sum(axis=2).max(axis=1)
    for k, level in enumerate(levels):
        near = flat & (low[0] <= level) & (high[0] >= level)
        near[swing <= _STILL * max(abs(level), 1e-3)] = False
        for i in np.unique(np.nonzero(near)[0]):
            row, column = np.nonzero(near[i])
            size = np.ones(len(row))
            yield int(i), k, np.stack([row / 2, column * step, size / 2, size * step], axis=1)


def crossings(wave: np.ndarray, contact: Contact, k: int) -> int:
    """Return how often an argument passes breakpoint k in one period."""
    modes = find_pattern(wave, contact).modes
    return int(np.sum((np.minimum(modes[1:], modes[:-1]) <= k) & (np.maximum(modes[1:], modes[:-1]) > k)))


# -------------------------------------------------------------------------------- roots on one piece
class _Surface:
    """Height of the argument above a breakpoint and its derivatives as functions of coordinate x and phase."""

    def __init__(self, spectra: np.ndarray, level: float) -> None:
        start, middle, end = spectra
        self.parts = np.array([start, 4 * middle - 3 * start - end, 2 * (start - 2 * middle + end)])
        self.level, self.size = level, abs(level) + float(np.abs(start).sum())
        k = np.arange(spectra.shape[1])
        self.k, self.weights = k, np.where(k == 0, 1.0, 2.0)

    def __call__(self, x: np.ndarray, phase: np.ndarray, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return derivatives by the phase of some orders (n, N), and the same of the derivative by x."""
        waves = np.exp(1j * np.multiply.outer(phase, self.k)) * self.weights
        table = np.array([(waves * (1j * self.k) ** n @ self.parts.T).real for n in orders])  # (n, N, 3)
        value = table[..., 0] + x * (table[..., 1] + x * table[..., 2])
        value[[n == 0 for n in orders]] -= self.level
        return value, table[..., 1] + 2 * x * table[..., 2]

    def curved(self, phase: np.ndarray) -> np.ndarray:
        """Return the second derivative (N,) by x."""
        return 2 * evaluate(self.parts[2], phase)


def roots(spectra: np.ndarray, level: float, cells: np.ndarray, doubt: float) -> list[Root] | None:
    """Return (x, phase, side, change) of all common zeros on a piece, or None where that is not certain.

    ``doubt`` bounds the distance of the argument from its quadratic through half spectra (3, H+1).
    """
    surface = _Surface(spectra, level)
    for _ in range(_HALVINGS):
        cells = _smaller(surface, cells, doubt)
        if len(cells) > _CROWD:
            return None
        cells = cells[~_clear(surface, cells, doubt)]
        if not len(cells):
            return []
    found: list[Root] = []
    for x, phase, dx, dphase in cells:
        root = _newton(surface, x + dx / 2, phase + dphase / 2, dphase, doubt)
        if root is None:
            return None
        if 0 <= root[0] <= 1 and all(_apart(root, other) for other in found):
            found.append(root)
    return found


def _clear(surface: _Surface, cells: np.ndarray, doubt: float) -> np.ndarray:
    """Tell on which cells the height of the one extremum stays away from zero, (N,) of bool."""
    x, phase, dx, dphase = cells.T
    x, start = x + dx / 2, phase + dphase / 2
    phase = start
    for _ in range(3):
        (slope, bend), _ = surface(x, phase, (1, 2))
        phase = np.clip(phase - slope / np.where(bend == 0, np.inf, bend), start - 2 * dphase, start + 2 * dphase)
    (height, slope, bend, third), (along, turn, change, _) = surface(x, phase, (0, 1, 2, 3))
    single = np.abs(bend) > 4 * np.abs(third) * dphase + np.abs(change) * dx  # the only extremum nearby, all over it
    bend = np.where(single, bend, np.inf)
    still = np.abs(slope) < 1e-3 * np.abs(bend) * dphase
    curved = np.abs(surface.curved(phase)) + turn**2 / np.abs(bend)
    reach = _SAFETY * (np.abs(along) * dx / 2 + curved * dx**2 / 8 + slope**2 / np.abs(bend)) + doubt
    return np.asarray(single & still & (np.abs(height) > reach))


def _smaller(surface: _Surface, cells: np.ndarray, doubt: float) -> np.ndarray:
    """Return the quarters of cells on which neither the height nor its slope is bounded away from zero."""
    x, phase, dx, dphase = cells.T
    grid = [(x + a * dx / 2, phase + b * dphase / 2) for a in range(3) for b in range(3)]
    at = [np.concatenate(column) for column in zip(*grid, strict=True)]
    value = surface(at[0], at[1], (0, 1))[0].reshape(2, 3, 3, -1)
    bend = np.abs(value[:, 0] - 2 * value[:, 1] + value[:, 2]).max(axis=1)
    bend += np.abs(value[:, :, 0] - 2 * value[:, :, 1] + value[:, :, 2]).max(axis=1)
    margin = _SAFETY / 8 * bend
    margin[0] += doubt
    kept = []
    for a in range(2):
        for b in range(2):
            corners = value[:, a : a + 2, b : b + 2].reshape(2, 4, -1)
            near = ((corners.min(axis=1) <= margin) & (corners.max(axis=1) >= -margin)).all(axis=0)
            part = np.stack([x + a * dx / 2, phase + b * dphase / 2, dx / 2, dphase / 2], axis=1)
            kept.append(part[near])
    return np.concatenate(kept)


def _newton(surface: _Surface, x: float, phase: float, reach: float, doubt: float) -> Root | None:
    """Return (x, phase, side, change) of the common zero next to a place, None where there is none for certain."""
    for count in range(16):
        (g, slope, bend), (gx, slope_x, _) = (
            part[:, 0] for part in surface(np.array([x]), np.array([phase]), (0, 1, 2))
        )
        determinant = slope * slope_x - gx * bend
        if determinant == 0 or bend == 0:
            return None
        if count < 3:  # on the extremum first: beside it the height depends on the phase more than on x
            phase -= float(np.clip(slope / bend, -reach, reach))
            continue
        dx, dphase = (g * bend - slope * slope) / determinant, (gx * slope - g * slope_x) / determinant
        x, phase = x + dx, phase + dphase
        if not (-0.5 <= x <= 1.5):
            return None
        rounding = _ROUNDING * surface.size / max(abs(gx), 1e-300)  # of x
        if abs(dx) < 1e-9 + rounding and abs(dphase) < 1e-9 + rounding * abs(slope_x / bend) and rounding < 0.01:
            curved = abs(surface.curved(np.array([phase]))[0] - slope_x**2 / bend)
            if gx**2 < 2 * _APART * doubt * curved:  # height of the parabola between this root and the next
                return None
            side = 1 if bend < 0 else -1
            return float(x), float(phase % (2 * np.pi)), side, int(2 * np.sign(gx) * side)
    return None


def _apart(a: Root, b: Root) -> bool:
    turn = abs((a[1] - b[1] + np.pi) % (2 * np.pi) - np.pi)
    return abs(a[0] - b[0]) > 1e-7 or turn > 1e-7
