"""Isolate the zeros of functions along a branch between corrected points, pairs inside one step included.

Signs at the ends of a step cancel when two zeros lie inside it, so functions are sampled on the interpolated branch and
bisected until each is bounded away from zero or its sign changes are apart; true points are then inserted wherever
interpolation alone saw a sign change or a near-contact, and everything is looked at again between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.curve import Segment
from continuation.branches.newton import Metric, Node
from continuation.errors import NoConvergence

_LEVELS = 14
_SAFETY = 1.5  # |value| must exceed this times the distance between chord and cubic
_ROUNDS = 40
_TINY = 1e-9  # length of a segment that is not split any more

Points = list[tuple[np.ndarray, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A sign change of function number ``test`` between two true neighbouring points, at about x."""

    test: int
    segment: Segment
    x: float


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Values (N, k) of functions at increasing coordinates x (N,) of a segment, ends included; NaN where unknown."""

    segment: Segment
    x: np.ndarray
    value: np.ndarray

    def joined(self, x: np.ndarray, value: np.ndarray) -> Samples:
        """Return the same with further samples."""
        x, value = np.append(self.x, x), np.vstack([self.value, value])
        order = np.argsort(x)
        return Samples(self.segment, x[order], value[order])

    def gap(self) -> np.ndarray:
        """Return the distance between chord and local cubic in every interval (N-1, k), from second differences."""
        x, f = self.x, self.value
        h = np.diff(x)[:, None]
        slope = np.diff(f, axis=0) / h
        bend = np.full_like(f, np.nan)
        bend[1:-1] = np.abs(2 * np.diff(slope, axis=0) / (h[1:] + h[:-1]))
        size = np.fmax(bend[1:], bend[:-1])  # of those that are known
        return size * h**2 / 8

    def changes(self, test: int) -> np.ndarray:
        """Return the intervals in which a function changes its sign."""
        f = self.value[:, test]
        known = np.isfinite(f[1:]) & np.isfinite(f[:-1])
        return np.flatnonzero(known & ((f[1:] > 0) != (f[:-1] > 0)))

    def doubtful(self) -> list[float]:
        """Return midpoints of intervals without sign change in which some function is not bounded away from zero."""
        f = self.value
        same = (f[1:] > 0) == (f[:-1] > 0)
        low = np.minimum(np.abs(f[1:]), np.abs(f[:-1]))
        doubt = (same & (low < _SAFETY * self.gap())).any(axis=1)  # False where a value is not known
        return [float((self.x[i] + self.x[i + 1]) / 2) for i in np.flatnonzero(doubt)]

    def cuts(self) -> list[float]:
        """Return where true points are needed: between sign changes of one function, and at contacts left in doubt."""
        cuts = set(self.doubtful())
        for test in range(self.value.shape[1]):
            f, changes = self.value[:, test], self.changes(test)
            for a, b in pairwise(changes):
                inside = np.arange(a + 1, b + 1)
                if np.all(np.isfinite(f[inside])):
                    cuts.add(float(self.x[inside[np.argmax(np.abs(f[inside]))]]))
            if changes.size and len(changes) % 2 == 0 and (f[0] > 0) != (f[-1] > 0) and np.all(np.isfinite(f)):
                cuts.add(0.5)
        return sorted(c for c in cuts if 0.0 < c < 1.0)

    def suspects(self) -> list[Suspect]:
        """Return one suspect for every function whose signs at both ends differ."""
        out = []
        for test in range(self.value.shape[1]):
            f, changes = self.value[:, test], self.changes(test)
            unknown = not np.all(np.isfinite(f))
            if not changes.size or (not unknown and (f[0] > 0) == (f[-1] > 0)):
                continue
            i = int(changes[0])
            x = self.x[i] + (self.x[i + 1] - self.x[i]) * f[i] / (f[i] - f[i + 1])
            out.append(Suspect(test, self.segment, float(x)))
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What is searched, and how.

    Attributes
    ----------
    problem : Problem
    metric : Metric
    evaluate : callable
        Points ``[(u, p)]`` -> values (N, k), NaN where there is none.
    first : array
        Coordinates in [0, 1] at which every segment is sampled first.
    mask : callable
        Corrects the samples of a segment before they are used.
    unresolved, missing : callable
        Segment -> sentence, where a function can't be bounded away from zero, and where it has no value.
    """

    problem: Any
    metric: Metric
    evaluate: Callable[[Points], np.ndarray]
    first: np.ndarray
    unresolved: Callable[[Segment], str]
    missing: Callable[[Samples], list[str]]
    mask: Callable[[Samples], Samples] = lambda samples: samples


def isolate(
    search: Search, nodes: list[Node], values: np.ndarray, skip: Callable[[Segment], bool]
) -> tuple[list[Node], list[Suspect], list[str]]:
    """Return the nodes with inserted ones, the isolated sign changes in order, and notes on what stayed unresolved.

    Parameters
    ----------
    nodes : list of Node
    values : array (N, k)
        Of the functions at the nodes.
    skip : callable
        Whether a segment is left out.
    """
    problem, metric = search.problem, search.metric
    notes: list[str] = []
    known = {id(n): v for n, v in zip(nodes, values, strict=True)}
    pending = [Segment(problem, metric, a, b) for a, b in pairwise(nodes)]
    suspects: list[Suspect] = []
    final: list[Segment] = []
    for round_number in range(_ROUNDS):
        final += [s for s in pending if skip(s)]
        pending = [s for s in pending if not skip(s)]
        if not pending:
            break
        sampled = _sample(search, pending, known)
        pending = []
        for s in sampled:
            cuts = s.cuts()
            pieces = None
            if cuts and round_number < _ROUNDS - 1 and not _tiny(s.segment):
                pieces = _split(search, s.segment, cuts, known)
            if pieces is not None:
                pending += pieces
                continue
            if cuts:
                notes.append(search.unresolved(s.segment))
            notes += search.missing(s)
            suspects += s.suspects()
            final.append(s.segment)
    chain = _chain(nodes, final)
    place = {id(n): i for i, n in enumerate(chain)}
    return chain, sorted(suspects, key=lambda s: (place[id(s.segment.a)], s.x)), notes


def _sample(search: Search, segments: list[Segment], known: dict[int, np.ndarray]) -> list[Samples]:
    """Sample all segments on the interpolated branch, bisecting where a function may reach zero."""
    inner = search.first[1:-1]
    points = [pt for s in segments for pt in s.at(inner)]
    values = search.evaluate(points).reshape(len(segments), len(inner), -1)
    out = [
        search.mask(Samples(s, search.first, np.vstack([known[id(s.a)], v, known[id(s.b)]])))
        for s, v in zip(segments, values, strict=True)
    ]
    active = list(range(len(out)))
    for _ in range(_LEVELS):
        wanted = [(i, x) for i in active for x in out[i].doubtful()]
        if not wanted:
            break
        values = search.evaluate([out[i].segment.at(np.array([x]))[0] for i, x in wanted])
        active = sorted({i for i, _ in wanted})
        for i in active:
            mine = [j for j, (k, _) in enumerate(wanted) if k == i]
            out[i] = search.mask(out[i].joined(np.array([wanted[j][1] for j in mine]), values[mine]))
    return out


def _split(search: Search, segment: Segment, cuts: list[float], known: dict[int, np.ndarray]) -> list[Segment] | None:
    """Insert true points at the cuts (all of them, or none when one does not converge)."""
    try:
        inserted = [segment.node(x) for x in cuts]
    except NoConvergence:
        return None
    for node, value in zip(inserted, search.evaluate([(n.u, n.p) for n in inserted]), strict=True):
        known[id(node)] = value
    chain = [segment.a, *inserted, segment.b]
    return [Segment(segment.problem, segment.metric, a, b) for a, b in pairwise(chain)]


def _tiny(segment: Segment) -> bool:
    a, b = segment.a, segment.b
    du = segment.problem.lengthen(b.u, a.u) - a.u
    return segment.metric.length(du, b.p - a.p) < _TINY


def _chain(nodes: list[Node], segments: list[Segment]) -> list[Node]:
    following = {id(s.a): s.b for s in segments}
    chain = [nodes[0]]
    while id(chain[-1]) in following:
        chain.append(following[id(chain[-1])])
    return chain
