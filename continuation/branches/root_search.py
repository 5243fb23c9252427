"""Locate special points by a root search on their test functions along the branch, at rising resolution."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq

from continuation.branches.branch import Kind
from continuation.branches.curve import Segment
from continuation.branches.located import GOAL, REACH, ROOT, Located, extrapolated, is_fixed, result, scale_of
from continuation.branches.newton import Node
from continuation.errors import NoConvergence

_CLOSER = (0.1, 0.02, 0.004)  # of the segment, distances of true points from a branch point


def test_function(problem: Any, kind: Kind) -> Callable[[Node], float]:
    """Return the function of a node that changes its sign at special points of a kind."""
    if kind == "fold":
        return lambda node: node.tp
    if kind == "period-doubling":
        return lambda node: problem.flip(node.u, node.p)
    if kind == "branch-point":

        def touch(node: Node) -> float:
            matrix = problem.monodromies([(node.u, node.p)])[0]
            return float(np.prod(1 - np.linalg.eigvals(matrix)).real)

        return touch

    def modulus(node: Node) -> float:  # NaN without a complex pair
        mu = np.linalg.eigvals(problem.monodromies([(node.u, node.p)])[0])
        pairs = mu[mu.imag > 1e-9]
        if not pairs.size:
            return np.nan
        nearest = pairs[np.argmin(np.abs(np.abs(pairs) - 1))]
        return float(np.abs(nearest) - 1)

    return modulus


def rising(segment: Segment, kind: Kind, test: Callable[[Node], float], x: float) -> Located:
    """Repeat the root search with twice the harmonics until the change of the parameter says it is good enough."""
    problem = segment.problem
    scale = scale_of(segment)
    like = segment.a.u if len(segment.a.u) >= len(segment.b.u) else segment.b.u
    x, node, slope = _secant(segment, test, x, like, None, scale)
    found, changes = node, []
    error = np.inf
    while True:
        longer = problem.refined(node.u, node.p)
        if longer is None:
            break
        at, node, slope = _secant(segment, test, x, longer, slope, scale)
        changes.append(abs(node.p - found.p))
        if is_fixed(problem):
            return result(kind, found, changes[-1] + ROOT * scale, segment, x)
        x, found = at, node
        error = extrapolated(changes) + ROOT * scale
        if error <= GOAL * scale:
            break
    if not changes:
        error = problem.point_error(node, kind)
    return result(kind, found, error, segment, x)


def crossing_search(segment: Segment, test: Callable[[Node], float], x: float) -> Located:
    """Locate a branch point at rising resolution, like the other kinds (see :func:`_between`)."""
    problem, scale = segment.problem, scale_of(segment)
    like = segment.a.u if len(segment.a.u) >= len(segment.b.u) else segment.b.u
    x, node, spread = _between(segment, test, x, like)
    changes: list[float] = []
    error = spread + problem.point_error(node, "branch-point")
    while error > GOAL * scale and (longer := problem.refined(node.u, node.p)) is not None:
        x, finer, spread = _between(segment, test, x, longer)
        changes.append(abs(finer.p - node.p))
        node, error = finer, extrapolated(changes) + spread
    return result("branch-point", node, error + ROOT * scale, segment, x)


def _interpolated(segment: Segment, x: float) -> Node:
    """Return the point of the cubic between the ends of a segment, as if it were a true one."""
    (u, p), (du, dp) = segment.at(np.array([x]))[0], segment.direction(x)
    size = segment.metric.length(du, dp)
    return Node(u, p, du / size, dp / size, segment.a.sign, 0)


def _between(segment: Segment, test: Callable[[Node], float], x: float, like: np.ndarray) -> tuple[float, Node, float]:
    """Return coordinate, node and last change of the parameter of a branch point, from true points closer and closer.

    At the point itself the bordered Jacobian is singular and Newton's method fails; but the branch passes smoothly, so
    the cubic through two true points a distance d away misses it by d^4.
    """
    found: list[Node] = []
    for reach in _CLOSER:
        ends = [segment.node(float(np.clip(x + side * reach, -REACH, 1 + REACH)), like) for side in (-1, 1)]
        inner = Segment(segment.problem, segment.metric, *ends)

        def at(y: float, inner: Segment = inner) -> Node:
            return _interpolated(inner, y)

        if test(at(0.0)) * test(at(1.0)) > 0:
            raise NoConvergence("no sign change between true points on both sides")
        y = float(brentq(lambda y, at=at: test(at(y)), 0.0, 1.0, xtol=1e-13))
        found.append(at(y))
        x += reach * (2 * y - 1)
    return x, found[-1], abs(found[-1].p - found[-2].p)


def _secant(
    segment: Segment, test: Callable[[Node], float], x: float, like: np.ndarray, slope: float | None, scale: float
) -> tuple[float, Node, float]:
    """Return coordinate, node and slope of a root of the test near x, at the resolution of ``like``.

    A first search (no slope known) keeps to the bracket between the ends of the segment when the test changes sign
    there, so that neighbouring roots are not mixed up.
    """
    reach = max(abs(segment.b.p - segment.a.p), 1e-3 * scale)
    low = high = None
    if slope is None:
        ends = test(segment.a), test(segment.b)
        if ends[0] * ends[1] < 0:
            low, high = (0.0, ends[0]), (1.0, ends[1])
    node = segment.node(x, like)
    value = test(node)
    if not np.isfinite(value):
        raise NoConvergence("there is no complex pair of multipliers nearby")
    if slope is None:
        step = 1e-3 if x < 0.5 else -1e-3
        slope = (test(segment.node(x + step, like, (x, node))) - value) / step
    for count in range(40):
        if low is not None and high is not None:
            low, high = ((x, value), high) if value * low[1] > 0 else (low, (x, value))
        target = x - value / slope if slope else np.nan
        if low is not None and high is not None and not low[0] <= target <= high[0]:
            target = (low[0] + high[0]) / 2
        elif low is None:
            target = x + float(np.clip(target - x, -0.25, 0.25))
        if not -REACH <= target <= 1 + REACH or (count > 25 and low is None):
            break
        new = segment.node(target, like, (x, node))
        move, moved, new_value = target - x, abs(new.p - node.p), test(new)
        if new_value != value and move != 0:
            slope = (new_value - value) / move
        x, node, value = target, new, new_value
        left = abs(value / slope) if slope else np.inf
        if left * reach <= ROOT * scale or (moved <= ROOT * scale and left < 1e-5) or abs(move) < 1e-14:
            return x, node, slope
    raise NoConvergence("the test function has no root nearby")
