"""Find the points of a branch at which a contact interval appears or vanishes, pairs inside one step included.

There an extremum of the contact argument a(phase) passes a breakpoint b: ``a = b`` and ``da/dphase = 0``. Between two
points of the branch the waveform is a quadratic of the arclength through those of the ends and of the interpolated
middle; its error is measured at the quarters, that of the interpolation at a true point in the middle of the piece
before. Both functions are bounded on cells of arclength and phase, cells are halved where neither is bounded away from
zero, and Newton's method starts from those that are left. Where it fails, or its solutions are not certain or do not
explain the numbers of contact changes at the ends, a true point is inserted and both halves are looked at. Extrema may
come and go.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.curve import Segment
from continuation.branches.grazing_roots import crossings, roots, suspicious
from continuation.branches.newton import Metric, Node
from continuation.errors import IntegrationFailed, NoConvergence
from continuation.model.system import System
from continuation.orbits.contact_wave import waves
from continuation.orbits.patterns import contact_names

_BLOCK = 32  # segments that are bounded at once
_DEPTH = 24  # halvings of a segment
_MOST = 100  # pieces that one segment is cut into
_MEASURED = 1.5  # times the error of the quadratic at the quarters, bound of it everywhere
_NEXT = 1 / 8  # of the error of the interpolation, half of it after a halving: it falls with the fourth power

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
    """A segment, the one between two nodes that it is part of, and the waveforms of all contacts on it.

    ``doubt`` bounds the error of the interpolation in each of them; None where it is not known yet.
    """

    segment: Segment
    origin: Segment
    start: Wave | None
    end: Wave | None
    middle: Wave | None = None
    doubt: np.ndarray | None = None

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
    cut: dict[int, int] = {}
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
        for piece in pending:
            cut[id(piece.origin)] = cut.get(id(piece.origin), 0) + 1
        halves = [_halved(p) if depth < _DEPTH and cut[id(p.origin)] < _MOST else [] for p in pending]
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
    true = _waves(s.problem, node.u, node.p)
    doubt = None
    if true is not None and piece.middle is not None:
        doubt = _NEXT * np.array([_distance(a, b) for a, b in zip(true, piece.middle, strict=True)])
    first, second = Segment(s.problem, s.metric, s.a, node), Segment(s.problem, s.metric, node, s.b)
    return [
        _Piece(first, piece.origin, piece.start, true, None, doubt),
        _Piece(second, piece.origin, true, piece.end, None, doubt),
    ]


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference of two waveforms (half spectra)."""
    wide = max(len(a), len(b))
    difference = np.pad(a, (0, wide - len(a))) - np.pad(b, (0, wide - len(b)))
    return float(np.abs(np.fft.irfft(difference, 4 * wide, norm="forward")).max())


def _doubt(piece: _Piece, contact: int) -> float | None:
    """Return a bound of the error of the quadratic through the waveforms of a contact, None where it is not known."""
    if piece.doubt is None:
        return None
    s = piece.segment
    start, middle, end = piece.at(contact)
    worst = 0.0
    for x, (u, p) in zip((0.25, 0.75), s.at(np.array([0.25, 0.75])), strict=True):
        there = _waves(s.problem, u, p)
        if there is None:
            return None
        quadratic = (1 - x) * (1 - 2 * x) * start + 4 * x * (1 - x) * middle + x * (2 * x - 1) * end
        worst = max(worst, _distance(there[contact], quadratic))
    return _MEASURED * worst + float(piece.doubt[contact])


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
            for i, k, cells in suspicious(spectra, contact.breakpoints):
                level, before = contact.breakpoints[k], found[i]
                doubt = None if before is None else _doubt(block[i], c)
                found_here = None if doubt is None else roots(stacks[i], level, cells, doubt)
                change = crossings(stacks[i][2], contact, k) - crossings(stacks[i][0], contact, k)
                if before is None or found_here is None or sum(r[3] for r in found_here) != change:
                    found[i] = None
                    continue
                piece = block[i]
                found[i] = before + [
                    Touch(c, names[c], level, piece.segment, piece.origin, x, phase, side, change)
                    for x, phase, side, change in found_here
                ]
        yield from zip(block, found, strict=True)
