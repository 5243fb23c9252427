"""From corrected nodes to a Branch: screening, location, verdicts, and a check that every change is explained."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.branch import CRITICAL, Branch, SpecialPoint
from continuation.branches.curve import Segment
from continuation.branches.functions import Functions, search_functions
from continuation.branches.grazing import search
from continuation.branches.grazing_system import locate_touch
from continuation.branches.locate import Located, locate
from continuation.branches.newton import Metric, Node
from continuation.branches.normal_form import describe
from continuation.branches.screening import Suspect, screen
from continuation.orbits.orbit import Orbit


def analyse(
    problem: Any,
    nodes: list[Node],
    metric: Metric,
    stop: str,
    began: float,
    progress: Callable[[float, str], None] | None,
    functions: Functions | None = None,
    special_points: bool = True,
) -> Branch:
    """Return the Branch of corrected nodes with located special points, zeros of user functions among them."""
    notes: list[str] = [] if special_points else ["special points were not looked for"]
    located: list[Located] = []
    nodes = list(nodes)
    if special_points and len(nodes) > 1:
        try:
            if progress is not None:
                progress(1.0, f"{len(nodes)} orbits; searching special points")
            _search(problem, nodes, metric, functions or {}, located, notes)
        except KeyboardInterrupt:
            stop += "; interrupted while special points were searched: the orbits are kept, points may be missing"
    place = {id(n): i for i, n in enumerate(nodes)}
    nodes = [n if np.isfinite(n.error) else replace(n, error=problem.adapt(n.u, n.p)[1]) for n in nodes]
    located = _once(located, metric)
    everything = [(n.u, n.p, n.error) for n in nodes] + [(s.node.u, s.node.p, _error(problem, s.node)) for s in located]
    orbits = problem.orbits(everything)
    path, ends = orbits[: len(nodes)], orbits[len(nodes) :]
    points = [_point(problem, s, o, nodes, _index(s, nodes, place)) for s, o in zip(located, ends, strict=True)]
    points.sort(key=lambda q: (q.index, _along(problem, metric, nodes, q)))
    seconds = time.perf_counter() - began
    work = {
        "points": len(path),
        "newton_steps": problem.evaluations,
        "factorisations": problem.factorisations + problem.evaluations,
        "seconds": seconds,
    }
    provenance = {
        "method": repr(problem.method),
        "system": repr(problem.system),
        "casadi": version("casadi"),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    if special_points:
        notes += _unexplained(path, points, problem.system.autonomous)
    return Branch(tuple(path), tuple(points), stop, work, provenance, tuple(dict.fromkeys(notes)))


def _search(
    problem: Any, nodes: list[Node], metric: Metric, functions: Functions, located: list[Located], notes: list[str]
) -> None:
    """Insert nodes, and add points found and notes to the lists, so that an interruption keeps them."""
    nodes[:], suspects, unresolved = screen(problem, nodes, metric)
    notes += unresolved + _vertical(problem, nodes, metric)
    for suspect in _with_turns(problem, nodes, metric, suspects):
        _sort(locate(suspect), located, notes)
    if functions:
        nodes[:], zeros, unresolved = search_functions(problem, nodes, metric, functions)
        located += zeros
        notes += unresolved
    touches, unresolved = search(problem, nodes, metric)
    notes += unresolved
    for touch in touches:
        _sort(locate_touch(touch), located, notes)


def _sort(found: Located | str, located: list[Located], notes: list[str]) -> None:
    """Add what was found to the points, or to the notes unless there is nothing to say."""
    if isinstance(found, Located):
        located.append(found)
    elif found:
        notes.append(found)


def _error(problem: Any, node: Node) -> float:
    return float(problem.adapt(node.u, node.p)[1])


def _with_turns(problem: Any, nodes: list[Node], metric: Metric, suspects: list[Suspect]) -> list[Suspect]:
    """Add the intervals in which the branch turns although no multiplier was seen to cross 1 there."""
    seen = {(id(s.segment.a)) for s in suspects if s.test == 0}
    out = [s for s in suspects if s.test != 0 or not s.segment.vertical]
    segments = [Segment(problem, metric, a, b) for a, b in pairwise(nodes)]
    flat = {id(n) for s in segments if s.vertical for n in (s.a, s.b)}
    for s in segments:
        # the slope of a node on a vertical piece is noise: its neighbour's must agree with the way from it
        slopes = [s.b.p - s.a.p if id(n) in flat else n.tp for n in (s.a, s.b)]
        if slopes[0] * slopes[1] < 0 and id(s.a) not in seen and not s.vertical:
            out.append(Suspect(0, s, slopes[0] / (slopes[0] - slopes[1])))
    return out


def _vertical(problem: Any, nodes: list[Node], metric: Metric) -> list[str]:
    """Return a note for every parameter at which the branch is a vertical line of neutral orbits."""
    segments = [Segment(problem, metric, a, b) for a, b in pairwise(nodes)]
    values = sorted(p for s in segments if s.vertical for p in (s.a.p, s.b.p))
    runs: list[list[float]] = []
    for p in values:
        if runs and p - runs[-1][-1] <= 1e-6 * max(abs(p), 1e-3):
            runs[-1].append(p)
        else:
            runs.append([p])
    return [
        f"{problem.parameter} = {_digits(run)}: a family of neutral orbits at one parameter value (the model is linear "
        "along it); folds are not looked for there"
        for run in runs
    ]


def _digits(run: list[float]) -> str:
    """Return the one number of a run to nine digits, or its ends."""
    low, high = f"{run[0]:.9g}", f"{run[-1]:.9g}"
    return low if low == high else f"{low} to {high}"


def _once(located: list[Located], metric: Metric) -> list[Located]:
    """Drop points that were reached from two neighbouring segments."""
    out: list[Located] = []
    for point in located:
        fit = point.segment.problem.lengthen
        same = [
            q
            for q in out
            if q.kind == point.kind
            and (CRITICAL[q.kind] > 0 or q.note == point.note)
            and metric.length(fit(q.node.u, point.node.u) - point.node.u, q.node.p - point.node.p)
            < 1e-6 + 10 * (q.error + point.error) / metric.span
        ]
        if not same:
            out.append(point)
    return out


def _index(s: Located, nodes: list[Node], place: dict[int, int]) -> int:
    """Return the node that a located point comes after; others may have been inserted into its segment since."""
    first, last = place[id(s.segment.a)], place[id(s.segment.b)]
    like = max(s.segment.a.u, s.segment.b.u, key=len)
    passed = [s.segment.coordinate(s.segment.problem.lengthen(n.u, like), n.p) <= s.x for n in nodes[first + 1 : last]]
    return first + sum(passed)


def _point(problem: Any, s: Located, orbit: Orbit, nodes: list[Node], index: int) -> SpecialPoint:
    index += 1 if s.x > 1 and index + 2 < len(nodes) else -1 if s.x < 0 < index else 0
    a, b = nodes[index], nodes[index + 1]
    return SpecialPoint(
        kind=s.kind,
        parameter=s.node.p,
        error=s.error,
        orbit=orbit,
        bracket=(min(a.p, b.p), max(a.p, b.p)),
        index=index,
        status="located" if s.status == "located" else "guessed",
        note=s.note,
        problem=problem,
        node=_as_on_branch(problem, s),
        form=describe(problem, s.kind, orbit, (s.node.u, s.node.p), s.nu, s.solutions),
        span=(min(n.p for n in nodes), max(n.p for n in nodes)),
    )


def _as_on_branch(problem: Any, s: Located) -> Node:
    """Return the located node at the resolution of the branch, which is coarser."""
    u, tu = (problem.lengthen(v, s.segment.a.u) for v in (s.node.u, s.node.tu))
    return replace(s.node, u=u, tu=tu)


def _along(problem: Any, metric: Metric, nodes: list[Node], point: SpecialPoint) -> float:
    """Return the coordinate of a point between its neighbours, which tells the order also where the branch turns."""
    segment = Segment(problem, metric, nodes[point.index], nodes[point.index + 1])
    like = max(segment.a.u, segment.b.u, key=len)
    return segment.coordinate(problem.lengthen(point.node.u, like), point.parameter)


def _unstable(orbit: Orbit, autonomous: bool) -> int | None:
    """Return the number of multipliers certainly outside the unit circle, None where it is undecided.

    Of an autonomous System the multiplier 1 of the flow direction is left out.
    """
    mu, bar = orbit.multipliers, orbit.multiplier_error
    if autonomous and np.isfinite(mu).all():
        trivial = int(np.argmin(np.abs(mu - 1)))
        mu, bar = np.delete(mu, trivial), np.delete(bar, trivial)
    outside = np.abs(mu) - 1
    if not np.all(np.abs(outside) > bar):  # also when one is not a number
        return None
    return int(np.sum(outside > 0))


def _crossing(point: SpecialPoint) -> int:
    """Return the number of multipliers that cross the unit circle at a point.

    None on a branch that is born at a branch point and turns there: one touches it.
    """
    upright = point.kind == "branch-point" and abs(point.node.tp) < 1e-6 * max(abs(point.parameter), 1e-3)
    return 0 if upright else CRITICAL[point.kind]


def _unexplained(path: list[Orbit], points: list[SpecialPoint], autonomous: bool = False) -> list[str]:
    """Return a note for every change of the number of unstable multipliers that the located points do not explain.

    Orbits whose number is undecided are passed over: nothing is concluded from them.
    """
    notes = []
    counts = [(i, c) for i, o in enumerate(path) if (c := _unstable(o, autonomous)) is not None]
    for (i, before), (j, after) in pairwise(counts):
        between = [_crossing(q) for q in points if i <= q.index < j]
        change, most = abs(after - before), sum(between)
        if change > most or (most - change) % 2:
            a, b = sorted((path[i].value, path[j].value))
            notes.append(
                f"{path[0].parameter} in [{a:.10g}, {b:.10g}]: the number of unstable multipliers changes from "
                f"{before} to {after}, which the located points do not explain"
            )
    return notes
