"""Find the points of a branch at which a contact interval appears or vanishes, pairs inside one step included.

There an extremum of the contact argument a(phase) passes a breakpoint b: ``a = b`` and ``da/dphase = 0``. Between two
points of the branch the waveform is a quadratic of the arclength through those of the ends and of the interpolated
middle. Both functions are bounded on cells of arclength and phase, cells are halved where neither is bounded away from
zero, and Newton's method starts from those that are left. Where it fails, or where its solutions do not explain the
numbers of contact changes at the ends, a true point is inserted and both halves are looked at. Extrema may come and go.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.curve import Segment
from continuation.branches.newton import Metric, Node
from continuation.errors import IntegrationFailed, NoConvergence
from continuation.model.system import System
from continuation.orbits.contact_series import evaluate, find_pattern
from continuation.orbits.contact_wave import waves
from continuation.orbits.patterns import contact_names

_BLOCK = 32  # segments that are bounded at once
_SAFETY = 1.5  # of the bounds from second differences
_DOUBT = 0.05  # part of the second difference along the branch that the interpolation may err by
_HALVINGS = 6  # of cells
_DEPTH = 24  # halvings of a segment
_CROWD = 400  # cells left that are no isolated points
_STILL = 1e-9  # amplitude of a waveform, relative to the breakpoint, that counts as rest

Wave = list[np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A place on the interpolated branch at which an extremum of a contact argument passes a breakpoint.

    Attributes
    ----------
    contact : int
    name : str
        Of the contact.
    level : float
        The breakpoint.
    segment : Segment
    origin : Segment
        The piece between two nodes of the branch that the segment is or is part of.
    x, phase : float
        Coordinate on the segment, and phase over the period of the orbit.
    side : int
        1 where a maximum touches, -1 where a minimum does.
    change : int
        2 where two contact changes appear in the direction of the branch, -2 where they vanish.
    """

    contact: int
    name: str
    level: float
    segment: Segment
    origin: Segment
    x: float
    phase: float
    side: int
    change: int


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A segment, the one between two nodes that it is part of, and the waveforms of all contacts on it."""

    segment: Segment
    origin: Segment
    start: Wave | None
    end: Wave | None
    middle: Wave | None = None

    def at(self, contact: int) -> np.ndarray:
        """Return the three half spectra (3, H+1) of one contact at start, middle and end, padded to one length."""
        parts = [wave[contact] for wave in (self.start, self.middle, self.end) if wave is not None]
        out = np.zeros((3, max(map(len, parts))), dtype=complex)
        for row, part in zip(out, parts, strict=True):
            row[: len(part)] = part
        return out


def search(problem: Any, nodes: list[Node], metric: Metric) -> tuple[list[Touch], list[str]]:
    """Return all touches of contact arguments and breakpoints along a branch, and notes on what stayed unresolved.

    Cost: the waveforms of the arguments at twice as many points as there are nodes, by harmonic balance 0.1 ms each.
    """
    if not problem.system.contacts:
        return [], []
    touches: list[Touch] = []
    notes: list[str] = []
    known = [_waves(problem, n.u, n.p) for n in nodes]
    pending = []
    for (a, b), (start, end) in zip(pairwise(nodes), pairwise(known), strict=True):
        segment = Segment(problem, metric, a, b)
        pending.append(_Piece(segment, segment, start, end))
    for depth in range(_DEPTH + 1):
        sampled = [replace(piece, middle=_waves(problem, *piece.segment.at(np.array([0.5]))[0])) for piece in pending]
        whole = [p for p in sampled if p.start is not None and p.end is not None and p.middle is not None]
        pending = [p for p in sampled if p.start is not None and p.end is not None and p.middle is None]
        notes += [
            f"{p.segment}: the orbit can't be integrated, grazing points may be missing"
            for p in sampled
            if p.start is None or p.end is None
        ]
        for piece, found in _contained(problem.system, whole):
            if found is None:
                pending.append(piece)
            else:
                touches += found
        halves = [_halved(piece) if depth < _DEPTH else [] for piece in pending]
        notes += [
            f"{piece.segment}: a contact argument touches a breakpoint closer than could be decided"
            for piece, parts in zip(pending, halves, strict=True)
            if not parts
        ]
        pending = [part for parts in halves for part in parts]
        if not pending:
            break
    return touches, notes


def _waves(problem: Any, u: np.ndarray, p: float) -> Wave | None:
    try:
        return waves(problem, u, p)
    except (IntegrationFailed, NoConvergence):
        return None


def _halved(piece: _Piece) -> list[_Piece]:
    """Return both halves of a piece at a true point, or nothing where there is none."""
    s = piece.segment
    try:
        node = s.node(0.5)
    except NoConvergence:
        return []
    middle = _waves(s.problem, node.u, node.p)
    first, second = Segment(s.problem, s.metric, s.a, node), Segment(s.problem, s.metric, node, s.b)
    return [_Piece(first, piece.origin, piece.start, middle), _Piece(second, piece.origin, middle, piece.end)]


# -------------------------------------------------------------------------------- bounds on a grid
def _contained(system: System, pieces: list[_Piece]) -> Iterator[tuple[_Piece, list[Touch] | None]]:
    """Yield every piece with its touches, or with None where it must be halved."""
    names = contact_names(system)
    order = sorted(pieces, key=lambda piece: max(map(len, piece.middle or ())))
    for begin in range(0, len(order), _BLOCK):
        block = order[begin : begin + _BLOCK]
        found: list[list[Touch] | None] = [[] for _ in block]
        for c, contact in enumerate(system.contacts):
            stacks = [piece.at(c) for piece in block]
            wide = max(s.shape[1] for s in stacks)
            spectra = np.array([np.pad(s, ((0, 0), (0, wide - s.shape[1]))) for s in stacks])
            for i, k, cells in _suspicious(spectra, contact.breakpoints):
                level, before = contact.breakpoints[k], found[i]
                roots = None if before is None else _roots(stacks[i], level, cells)
                change = _crossings(stacks[i][2], contact, k) - _crossings(stacks[i][0], contact, k)
                if before is None or roots is None or sum(r[3] for r in roots) != change:
                    found[i] = None
                    continue
                piece = block[i]
                found[i] = before + [
                    Touch(c, names[c], level, piece.segment, piece.origin, x, phase, side, change)
                    for x, phase, side, change in roots
                ]
        yield from zip(block, found, strict=True)


def _suspicious(spectra: np.ndarray, levels: tuple[float, ...]) -> Iterator[tuple[int, int, np.ndarray]]:
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


def _crossings(wave: np.ndarray, contact: Any, k: int) -> int:
    """Return how often an argument passes breakpoint k in one period."""
    modes = find_pattern(wave, contact).modes
    return int(np.sum((np.minimum(modes[1:], modes[:-1]) <= k) & (np.maximum(modes[1:], modes[:-1]) > k)))


# -------------------------------------------------------------------------------- roots on one piece
class _Surface:
    """Height of the argument above a breakpoint and its derivatives as functions of coordinate x and phase."""

    def __init__(self, spectra: np.ndarray, level: float) -> None:
        start, middle, end = spectra
        self.parts = np.array([start, 4 * middle - 3 * start - end, 2 * (start - 2 * middle + end)])
        self.level = level
        k = np.arange(spectra.shape[1])
        self.k, self.weights = k, np.where(k == 0, 1.0, 2.0)

    def __call__(self, x: np.ndarray, phase: np.ndarray, orders: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Return derivatives by the phase of some orders (n, N), and the same of the derivative by x."""
        waves = np.exp(1j * np.multiply.outer(phase, self.k)) * self.weights
        table = np.array([(waves * (1j * self.k) ** n @ self.parts.T).real for n in orders])  # (n, N, 3)
        value = table[..., 0] + x * (table[..., 1] + x * table[..., 2])
        value[[n == 0 for n in orders]] -= self.level
        return value, table[..., 1] + 2 * x * table[..., 2]


def _roots(spectra: np.ndarray, level: float, cells: np.ndarray) -> list[tuple[float, float, int, int]] | None:
    """Return (x, phase, side, change) of all common zeros on a piece, or None where they are not isolated."""
    surface = _Surface(spectra, level)
    doubt = _DOUBT * np.abs(evaluate((spectra[0] - 2 * spectra[1] + spectra[2]), cells[:, 1]))
    for _ in range(_HALVINGS):
        cells, doubt = _smaller(surface, cells, doubt)
        if not len(cells):
            return []
        if len(cells) > _CROWD:
            return None
    found: list[tuple[float, float, int, int]] = []
    for x, phase, dx, dphase in cells:
        root = _newton(surface, x + dx / 2, phase + dphase / 2)
        if root is None:
            return None
        if 0 <= root[0] <= 1 and all(_apart(root, other) for other in found):
            found.append(root)
    return found


def _smaller(surface: _Surface, cells: np.ndarray, doubt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the quarters of cells on which neither the height nor its slope is bounded away from zero."""
    x, phase, dx, dphase = cells.T
    grid = [(x + a * dx / 2, phase + b * dphase / 2) for a in range(3) for b in range(3)]
    at = [np.concatenate(column) for column in zip(*grid, strict=True)]
    value = surface(at[0], at[1], (0, 1))[0].reshape(2, 3, 3, -1)
    bend = np.abs(value[:, 0] - 2 * value[:, 1] + value[:, 2]).max(axis=1)
    bend += np.abs(value[:, :, 0] - 2 * value[:, :, 1] + value[:, :, 2]).max(axis=1)
    margin = _SAFETY / 8 * bend
    margin[0] += doubt
    kept, doubts = [], []
    for a in range(2):
        for b in range(2):
            corners = value[:, a : a + 2, b : b + 2].reshape(2, 4, -1)
            near = ((corners.min(axis=1) <= margin) & (corners.max(axis=1) >= -margin)).all(axis=0)
            part = np.stack([x + a * dx / 2, phase + b * dphase / 2, dx / 2, dphase / 2], axis=1)
            kept.append(part[near])
            doubts.append(doubt[near])
    return np.concatenate(kept), np.concatenate(doubts)


def _newton(surface: _Surface, x: float, phase: float) -> tuple[float, float, int, int] | None:
    """Return (x, phase, side, change) of the common zero next to a place, None where Newton's method finds none."""
    for _ in range(12):
        (g, slope, bend), (gx, slope_x, _) = (
            part[:, 0] for part in surface(np.array([x]), np.array([phase]), (0, 1, 2))
        )
        determinant = slope * slope_x - gx * bend
        if determinant == 0:
            return None
        dx, dphase = (g * bend - slope * slope) / determinant, (gx * slope - g * slope_x) / determinant
        x, phase = x + dx, phase + dphase
        if not (-0.5 <= x <= 1.5):
            return None
        if abs(dx) < 1e-9 and abs(dphase) < 1e-9:
            side = 1 if bend < 0 else -1
            return float(x), float(phase % (2 * np.pi)), side, int(2 * np.sign(gx) * side)
    return None


def _apart(a: tuple[float, float, int, int], b: tuple[float, float, int, int]) -> bool:
    turn = abs((a[1] - b[1] + np.pi) % (2 * np.pi) - np.pi)
    return abs(a[0] - b[0]) > 1e-7 or turn > 1e-7
