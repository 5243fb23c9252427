"""What location returns, and how its errors are stated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.branches.branch import Kind
from continuation.branches.curve import Segment
from continuation.branches.extended import ExtendedProblem
from continuation.branches.newton import Node

GOAL = 1e-9  # wanted error, relative to the size of the parameter
ROOT = 2e-11  # where a root search stops, relative likewise
REACH = 0.5  # how far outside its segment a root may lie (multipliers and operator are discretised differently)


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """A located point: kind, node, parameter error, the segment it was found on and its coordinate x there.

    Where it was located on an extended system, ``nu`` is the angle of the critical multiplier over 2 pi and
    ``solutions`` are the first ones, of rising resolution.
    """

    kind: Kind
    node: Node
    error: float
    segment: Segment
    x: float
    status: str
    note: str = ""
    nu: float = float("nan")
    solutions: tuple[tuple[ExtendedProblem, np.ndarray], ...] = ()


def result(kind: Kind, node: Node, error: float, segment: Segment, x: float) -> Located:
    bound = 3 * GOAL * scale_of(segment)
    good = error <= bound
    note = "" if good else f"more harmonics are needed for an error below {bound:.0e}"
    return Located(kind, node, error, segment, x, "located" if good else "guessed", note)


def extrapolated(changes: list[float]) -> float:
    """Error left after changes under doubling: twice the geometric remainder, its ratio kept in 1/20 .. 1/2."""
    if len(changes) == 1:
        return changes[0]
    ratio = min(0.5, max(changes[-1] / max(changes[-2], 1e-300), 0.05))
    return 2 * changes[-1] * ratio / (1 - ratio)


def scale_of(segment: Segment) -> float:
    """Return the size of the parameter on a segment, 1 where it is 0."""
    a, b = segment.a.p, segment.b.p
    return max(abs(a), abs(b)) or 1.0


def is_fixed(problem: Any) -> bool:
    return any(getattr(problem.method, name, None) is not None for name in ("harmonics", "intervals"))
