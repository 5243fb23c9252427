"""Zeros of a user's functions of the orbit along a branch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from continuation.branches.bracketing import Points, Samples, Search, Suspect, isolate
from continuation.branches.curve import Segment
from continuation.branches.locate import Located, rising
from continuation.branches.newton import Metric, Node
from continuation.errors import ContinuationError, NoConvergence
from continuation.orbits.orbit import Orbit

Functions = Mapping[str, Callable[[Orbit], float]]
_FIRST = np.array([0.0, 0.5, 1.0])
_JUMP = 1e-6  # part of the values at the ends of a step that is left at a zero, and not where the function jumps


def check_functions(functions: Functions, start: Orbit) -> None:
    """Evaluate every function on the start orbit, so that a mistake shows before a branch is traced.

    Raises
    ------
    ValueError
        If a function does not return a number.
    """
    for name, function in functions.items():
        value = function(start)
        if np.ndim(value) != 0 or not np.isrealobj(np.asarray(value)) or np.asarray(value).dtype.kind not in "fiub":
            raise ValueError(f"functions: {name!r} must return one real number for an orbit, got {value!r}")


def search_functions(
    problem: Any, nodes: list[Node], metric: Metric, functions: Functions
) -> tuple[list[Node], list[Located], list[str]]:
    """Return the nodes with inserted ones, the zeros of all functions in order, and notes on what stayed open.

    Every step is sampled at its ends and its middle, on the interpolated branch, and where a function is not bounded
    away from zero in between. Cost: an orbit with its multipliers for every sample.
    """
    names = list(functions)

    def evaluate(points: Points) -> np.ndarray:
        return np.array([[_number(f, orbit) for f in functions.values()] for orbit in _orbits(problem, points)])

    def missing(s: Samples) -> list[str]:
        return [
            f"{s.segment}: the function {name!r} is not a number everywhere, zeros may be missing"
            for name, known in zip(names, np.isfinite(s.value).all(axis=0), strict=True)
            if not known
        ]

    search = Search(problem, metric, evaluate, _FIRST, _unresolved, missing)
    values = evaluate([(n.u, n.p) for n in nodes])
    nodes, suspects, notes = isolate(search, nodes, values, lambda _: False)
    located: list[Located] = []
    for suspect in suspects:
        found = _locate(suspect, names[suspect.test], functions[names[suspect.test]])
        if isinstance(found, Located):
            located.append(found)
        else:
            notes.append(found)
    return nodes, located, notes


def _orbits(problem: Any, points: Points) -> list[Orbit | None]:
    """Return the orbits of points, None where an interpolated one is none."""
    try:
        return list(problem.orbits([(u, p, problem.adapt(u, p)[1]) for u, p in points]))
    except ContinuationError:
        if len(points) == 1:
            return [None]
    return [_orbits(problem, [point])[0] for point in points]


def _number(function: Callable[[Orbit], float], orbit: Orbit | None) -> float:
    value = np.nan if orbit is None else float(function(orbit))
    return value if np.isfinite(value) else np.nan


def _locate(suspect: Suspect, name: str, function: Callable[[Orbit], float]) -> Located | str:
    """Return the zero, or a note on why it can't be located."""
    segment = suspect.segment

    def test(node: Node) -> float:
        return _number(function, _orbits(segment.problem, [(node.u, node.p)])[0])

    try:
        found = rising(segment, "user", test, suspect.x)
    except NoConvergence as failure:
        return f"{segment}: the function {name!r} changes its sign, but no zero was located ({failure})"
    ends = [test(segment.a), test(segment.b)]
    if not abs(test(found.node)) <= _JUMP * max(map(abs, ends)):
        return f"{segment}: the function {name!r} jumps from {ends[0]:.6g} to {ends[1]:.6g}, it has no zero"
    note = f"{name}; {found.note}" if found.note else name
    return Located("user", found.node, found.error, segment, found.x, found.status, note)


def _unresolved(segment: Segment) -> str:
    return f"{segment}: a user function comes closer to zero than could be decided"
