"""Find every place where a multiplier may cross the unit circle between accepted points, pairs included.

Three functions of the monodromy matrix, smooth along the branch also where multipliers collide, vanish there:
``det(I - M)`` (fold, branch point), ``det(I + M)`` (period-doubling), ``prod_{i<j} (1 - mu_i mu_j)`` (Neimark-Sacker).
Signs at the ends of a step cancel when two points lie inside it, so each function is sampled on the interpolated
branch and bisected until it is bounded away from zero or its sign changes are apart; true points are then inserted
wherever interpolation alone saw a sign change or a near-contact, and everything is looked at again between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.curve import Segment
from continuation.branches.newton import Metric, Node
from continuation.errors import NoConvergence

_FIRST = np.linspace(0.0, 1.0, 5)
_LEVELS = 14
_SAFETY = 1.5  # |value| must exceed this times the distance between chord and cubic
_ROUNDS = 40
_NEUTRAL = 1e-8  # |1 - mu_i mu_j| that is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A sign change of one test function (0 fold, 1 doubling, 2 torus) between two true neighbouring points."""

    test: int
    segment: Segment
    x: float


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    segment: Segment
    x: np.ndarray
    value: np.ndarray  # (N, 3)


def tests(matrices: np.ndarray) -> np.ndarray:
    """Return the three test functions (N, 3) of monodromy matrices (N, n, n)."""
    n = matrices.shape[-1]
    mu = np.linalg.eigvals(matrices)
    i, j = np.triu_indices(n, 1)
    torus = np.prod(1 - mu[:, i] * mu[:, j], axis=1).real if n > 1 else np.ones(len(mu))
    return np.stack([np.prod(1 - mu, axis=1).real, np.prod(1 + mu, axis=1).real, torus], axis=1)


def _neutral(matrices: np.ndarray) -> bool:
    """Tell whether multipliers come in pairs mu, 1/mu all along, as without damping."""
    mu = np.linalg.eigvals(matrices)
    i, j = np.triu_indices(mu.shape[1], 1)
    if not i.size:
        return False
    return bool(np.median(np.abs(1 - mu[:, i] * mu[:, j]).min(axis=1)) < _NEUTRAL)


def screen(problem: Any, nodes: list[Node], metric: Metric) -> tuple[list[Node], list[Suspect], list[str]]:
    """Return the nodes with inserted ones, the isolated sign changes in order, and notes on what stayed unresolved."""
    notes: list[str] = []
    matrices = problem.monodromies([(n.u, n.p) for n in nodes])
    at_nodes = tests(matrices)
    neutral = _neutral(matrices)
    if neutral:
        notes.append("the model has no damping: torus points are not looked for, products of multipliers are always 1")
    pending = [Segment(problem, metric, a, b) for a, b in pairwise(nodes)]
    known = {id(n): v for n, v in zip(nodes, at_nodes, strict=True)}
    suspects: list[Suspect] = []
    final: list[Segment] = []
    flat: set[int] = set()  # nodes of vertical pieces, all of one monodromy matrix with a multiplier 1
    for round_number in range(_ROUNDS):
        vertical = [s for s in pending if s.vertical]
        final += vertical
        flat |= {id(n) for s in vertical for n in (s.a, s.b)}
        pending = [s for s in pending if not s.vertical]
        if not pending:
            break
        sampled = _sample(problem, pending, known, neutral, flat)
        pending = []
        for s in sampled:
            cuts = _cuts(s)
            if not cuts or round_number == _ROUNDS - 1 or _tiny(s.segment):
                if cuts:
                    notes.append(_unresolved(s.segment))
                suspects += _suspects(s)
                final.append(s.segment)
                continue
            pieces = _split(s.segment, cuts, known, problem)
            if pieces is None:
                notes.append(_unresolved(s.segment))
                suspects += _suspects(s)
                final.append(s.segment)
            else:
                pending += pieces
    return _chain(nodes, final), _ordered(suspects, final, nodes), notes


def _sample(
    problem: Any, segments: list[Segment], known: dict[int, np.ndarray], neutral: bool, flat: set[int]
) -> list[_Samples]:
    """Sample all segments on the interpolated branch, bisecting where a test function may reach zero."""

    def evaluate(points: list[tuple[np.ndarray, float]]) -> np.ndarray:
        values = tests(problem.monodromies(points))
        values[:, 2] = 1.0 if neutral else values[:, 2]
        return values

    def end(node: Node) -> np.ndarray:
        return np.append(known[id(node)][:2], 1.0) if neutral else known[id(node)]

    inner = _FIRST[1:-1]
    points = [pt for s in segments for pt in s.at(inner)]
    values = evaluate(points).reshape(len(segments), len(inner), 3)
    out = [_Samples(s, _FIRST, np.vstack([end(s.a), v, end(s.b)])) for s, v in zip(segments, values, strict=True)]
    out = [_masked(s, flat) for s in out]
    active = list(range(len(out)))
    for _ in range(_LEVELS):
        wanted = [(i, x) for i in active for x in _doubtful(out[i])]
        if not wanted:
            break
        points = [out[i].segment.at(np.array([x]))[0] for i, x in wanted]
        values = evaluate(points)
        active = sorted({i for i, _ in wanted})
        for i in active:
            new = [(x, v) for (k, x), v in zip(wanted, values, strict=True) if k == i]
            x = np.append(out[i].x, [a for a, _ in new])
            value = np.vstack([out[i].value, *[v for _, v in new]])
            order = np.argsort(x)
            out[i] = _masked(_Samples(out[i].segment, x[order], value[order]), flat)
    return out


def _masked(s: _Samples, flat: set[int]) -> _Samples:
    """Take det(I - M) from the far end of a segment that leaves a vertical piece, where it is noise about 0.

    The branch has a corner inside, which no interpolation shows; whether it turns back is told by its tangents.
    """
    ends = [id(n) in flat for n in (s.segment.a, s.segment.b)]
    if any(ends):
        s.value[:, 0] = s.value[-1 if ends[0] else 0, 0]
    return s


def _gap(s: _Samples) -> np.ndarray:
    """Distance between chord and local cubic in every interval, (N-1, 3), from second differences."""
    x, f = s.x, s.value
    h = np.diff(x)[:, None]
    slope = np.diff(f, axis=0) / h
    bend = np.zeros_like(f)
    bend[1:-1] = 2 * np.diff(slope, axis=0) / (h[1:] + h[:-1])
    bend[0], bend[-1] = bend[1], bend[-2]
    size = np.maximum(np.abs(bend[1:]), np.abs(bend[:-1]))
    return size * h**2 / 8


def _doubtful(s: _Samples) -> list[float]:
    """Return midpoints of intervals without sign change in which some function is not bounded away from zero."""
    f = s.value
    same = (f[1:] > 0) == (f[:-1] > 0)
    low = np.minimum(np.abs(f[1:]), np.abs(f[:-1]))
    doubtful = (same & (low < _SAFETY * _gap(s))).any(axis=1)
    return [float((s.x[i] + s.x[i + 1]) / 2) for i in np.flatnonzero(doubtful)]


def _cuts(s: _Samples) -> list[float]:
    """Return where true points are needed: between sign changes of one function, and at contacts left in doubt."""
    cuts = set(_doubtful(s))
    for test in range(3):
        f = s.value[:, test]
        changes = np.flatnonzero((f[1:] > 0) != (f[:-1] > 0))
        for a, b in pairwise(changes):
            inside = np.arange(a + 1, b + 1)
            cuts.add(float(s.x[inside[np.argmax(np.abs(f[inside]))]]))
        if not changes.size:
            continue
        ends = (f[0] > 0) != (f[-1] > 0)
        if len(changes) % 2 == 0 and ends:
            cuts.add(0.5)
    return sorted(c for c in cuts if 0.0 < c < 1.0)


def _split(segment: Segment, cuts: list[float], known: dict[int, np.ndarray], problem: Any) -> list[Segment] | None:
    """Insert true points at the cuts (all of them, or none when one does not converge)."""
    try:
        inserted = [segment.node(x) for x in cuts]
    except NoConvergence:
        return None
    for node, value in zip(inserted, tests(problem.monodromies([(n.u, n.p) for n in inserted])), strict=True):
        known[id(node)] = value
    chain = [segment.a, *inserted, segment.b]
    return [Segment(problem, segment.metric, a, b) for a, b in pairwise(chain)]


def _tiny(segment: Segment) -> bool:
    a, b = segment.a, segment.b
    du = segment.problem.lengthen(b.u, a.u) - a.u
    return segment.metric.length(du, b.p - a.p) < 1e-9


def _suspects(s: _Samples) -> list[Suspect]:
    out = []
    for test in range(3):
        f = s.value[:, test]
        if (f[0] > 0) == (f[-1] > 0):
            continue
        i = int(np.flatnonzero((f[1:] > 0) != (f[:-1] > 0))[0])
        x = s.x[i] + (s.x[i + 1] - s.x[i]) * f[i] / (f[i] - f[i + 1])
        out.append(Suspect(test, s.segment, float(x)))
    return out


def _unresolved(segment: Segment) -> str:
    a, b = sorted((segment.a.p, segment.b.p))
    name = segment.problem.parameter
    return f"{name} in [{a:.10g}, {b:.10g}]: a multiplier touches the unit circle closer than could be decided"


def _chain(nodes: list[Node], segments: list[Segment]) -> list[Node]:
    following = {id(s.a): s.b for s in segments}
    chain = [nodes[0]]
    while id(chain[-1]) in following:
        chain.append(following[id(chain[-1])])
    return chain


def _ordered(suspects: list[Suspect], segments: list[Segment], nodes: list[Node]) -> list[Suspect]:
    place = {id(n): i for i, n in enumerate(_chain(nodes, segments))}
    return sorted(suspects, key=lambda s: (place[id(s.segment.a)], s.x))
