"""Locate special points on the true branch: Newton on the extended system, or a secant, at rising resolution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from continuation.branches.branch import Kind
from continuation.branches.curve import Segment
from continuation.branches.extended import SHIFT, ExtendedProblem, extended, solve_point
from continuation.branches.newton import Node
from continuation.branches.screening import Suspect
from continuation.errors import IntegrationFailed, NoConvergence, UnsupportedModel

_GOAL = 1e-9  # wanted error, relative to the size of the parameter
_ROOT = 2e-11  # where the secant stops, relative likewise
_CLOSER = (0.1, 0.02, 0.004)  # of the segment, distances of true points from a branch point
_REACH = 0.5  # how far outside its segment a root may lie (multipliers and operator are discretised differently)


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


def locate(suspect: Suspect) -> Located | str:
    """Return the located point, a note (str) on why it can't be located, or "" where there is none.

    Newton's method on the minimally extended system goes first, where the method of the orbits offers its derivatives;
    the secant on the test function second, inside the sign change where the first one left it.
    """
    segment = suspect.segment
    kind = _kind(suspect)
    if kind == "branch-point":
        return _tried(segment, kind, suspect.x, partial(_branch_point, segment, _tests(segment.problem, kind)))
    nu = SHIFT.get(kind, 0.0)
    if kind == "neimark-sacker":
        (u, p) = segment.at(np.array([suspect.x]))[0]
        nu = _rotation(segment.problem, u, p)
        if not np.isfinite(nu):
            return ""  # two real multipliers with product 1, a neutral saddle, are no torus point
    reason = ""
    try:
        return _extended(segment, kind, suspect.x, nu)
    except UnsupportedModel:
        pass  # the method has no second derivatives
    except (NoConvergence, IntegrationFailed) as failure:
        reason = str(failure)
    found = _tried(segment, kind, suspect.x, partial(rising, segment, kind, _tests(segment.problem, kind)))
    if isinstance(found, Located) and reason:
        words = f"by the secant on its test function: the extended system failed ({reason})"
        return replace(found, note=f"{words}; {found.note}" if found.note else words)
    return found


def _tried(segment: Segment, kind: Kind, x: float, method: Callable[[float], Located]) -> Located | str:
    """Return what a method finds from several starts, or a note."""
    reason = ""
    for x0 in (x, 0.5, 0.0, 1.0):
        try:
            return method(x0)
        except NoConvergence as failure:
            reason = str(failure)
    a, b = sorted((segment.a.p, segment.b.p))
    return f"{segment.problem.parameter} in [{a:.10g}, {b:.10g}]: {kind} seen but not located ({reason})"


def _rotation(problem: Any, u: np.ndarray, p: float) -> float:
    """Return the rotation number in (0, 1/2) of the complex pair nearest to the unit circle, NaN without one."""
    mu = np.linalg.eigvals(problem.monodromies([(u, p)])[0])
    pairs = mu[mu.imag > 1e-9]
    if not pairs.size:
        return np.nan
    return float(np.angle(pairs[np.argmin(np.abs(np.abs(pairs) - 1))]) / (2 * np.pi))


def _extended(segment: Segment, kind: Kind, x: float, nu: float) -> Located:
    """Solve the extended system at rising resolution until the change of the parameter says it is good enough."""
    problem, scale = segment.problem, _scale(segment)
    u, p = segment.at(np.array([x]))[0]
    system = extended(problem, kind, u, p)
    node = solve_point(system, system.join(u, p, nu))
    x = _place(segment, system, node)
    changes: list[float] = []
    solutions = [node.u]
    error = np.inf
    while error > _GOAL * scale:
        longer = system.refined(node.u, 0.0)
        if longer is None:
            break
        finer = solve_point(system, longer)
        changes.append(abs(system.split(finer.u)[1] - system.split(node.u)[1]))
        solutions.append(finer.u)
        error = _extrapolated(changes) + _ROOT * scale
        if _fixed(problem):  # the point of the resolution that was asked for
            error = changes[-1] + _ROOT * scale
            node = solve_point(system, node.u)  # its linearisation is the one at hand again
            break
        node = finer
    u, p, nu = system.split(node.u)
    du, dp = segment.direction(x)
    tangent = system.tangent((problem.lengthen(du, u), dp), segment.metric)
    point = Node(u, p, *tangent, 1.0, node.iterations)
    if not changes:
        error = problem.point_error(point, kind) + _ROOT * scale
    pairs = tuple((system, U) for U in solutions[:2])
    return replace(_result(kind, point, error, segment, x), nu=nu, solutions=pairs)


def _fixed(problem: Any) -> bool:
    return any(getattr(problem.method, name, None) is not None for name in ("harmonics", "intervals"))


def _place(segment: Segment, system: ExtendedProblem, node: Node) -> float:
    """Return the coordinate of a solution on the segment that it was looked for on.

    Raises
    ------
    NoConvergence
        If it is another point: off the segment, or beyond an end although the test function changes sign inside.
    """
    u, p, nu = system.split(node.u)
    if system.kind == "neimark-sacker" and not 1e-6 < nu < 0.5 - 1e-6:
        raise NoConvergence("its multipliers are not a complex pair")
    x = segment.coordinate(u, p)
    if 0 <= x <= 1:
        return x
    test = _tests(segment.problem, system.kind)
    if not -_REACH <= x <= 1 + _REACH or test(segment.a) * test(segment.b) < 0:
        raise NoConvergence("it led to another point")
    return x


def _kind(suspect: Suspect) -> Kind:
    if suspect.test == 1:
        return "period-doubling"
    if suspect.test == 2:
        return "neimark-sacker"
    a, b = suspect.segment.a, suspect.segment.b
    return "branch-point" if a.sign != b.sign and a.tp * b.tp > 0 else "fold"


def _tests(problem: Any, kind: Kind) -> Callable[[Node], float]:
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
    scale = _scale(segment)
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
        if _fixed(problem):
            return _result(kind, found, changes[-1] + _ROOT * scale, segment, x)
        x, found = at, node
        error = _extrapolated(changes) + _ROOT * scale
        if error <= _GOAL * scale:
            break
    if not changes:
        error = problem.point_error(node, kind)
    return _result(kind, found, error, segment, x)


def _scale(segment: Segment) -> float:
    """Return the size of the parameter on a segment, 1 where it is 0."""
    a, b = segment.a.p, segment.b.p
    return max(abs(a), abs(b)) or 1.0


def _branch_point(segment: Segment, test: Callable[[Node], float], x: float) -> Located:
    """Locate a branch point at rising resolution, like the other kinds (see :func:`_between`)."""
    problem, scale = segment.problem, _scale(segment)
    like = segment.a.u if len(segment.a.u) >= len(segment.b.u) else segment.b.u
    x, node, spread = _between(segment, test, x, like)
    changes: list[float] = []
    error = spread + problem.point_error(node, "branch-point")
    while error > _GOAL * scale and (longer := problem.refined(node.u, node.p)) is not None:
        x, finer, spread = _between(segment, test, x, longer)
        changes.append(abs(finer.p - node.p))
        node, error = finer, _extrapolated(changes) + spread
    return _result("branch-point", node, error + _ROOT * scale, segment, x)


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
        ends = [segment.node(float(np.clip(x + side * reach, -_REACH, 1 + _REACH)), like) for side in (-1, 1)]
        inner = Segment(segment.problem, segment.metric, *ends)

        def at(y: float, inner: Segment = inner) -> Node:
            return _interpolated(inner, y)

        if test(at(0.0)) * test(at(1.0)) > 0:
            raise NoConvergence("no sign change between true points on both sides")
        y = float(brentq(lambda y, at=at: test(at(y)), 0.0, 1.0, xtol=1e-13))
        found.append(at(y))
        x += reach * (2 * y - 1)
    return x, found[-1], abs(found[-1].p - found[-2].p)


def _result(kind: Kind, node: Node, error: float, segment: Segment, x: float) -> Located:
    bound = 3 * _GOAL * _scale(segment)
    good = error <= bound
    note = "" if good else f"more harmonics are needed for an error below {bound:.0e}"
    return Located(kind, node, error, segment, x, "located" if good else "guessed", note)


def _extrapolated(changes: list[float]) -> float:
    """Error left after changes under doubling: twice the geometric remainder, its ratio kept in 1/20 .. 1/2."""
    if len(changes) == 1:
        return changes[0]
    ratio = min(0.5, max(changes[-1] / max(changes[-2], 1e-300), 0.05))
    return 2 * changes[-1] * ratio / (1 - ratio)


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
        if not -_REACH <= target <= 1 + _REACH or (count > 25 and low is None):
            break
        new = segment.node(target, like, (x, node))
        move, moved, new_value = target - x, abs(new.p - node.p), test(new)
        if new_value != value and move != 0:
            slope = (new_value - value) / move
        x, node, value = target, new, new_value
        left = abs(value / slope) if slope else np.inf
        if left * reach <= _ROOT * scale or (moved <= _ROOT * scale and left < 1e-5) or abs(move) < 1e-14:
            return x, node, slope
    raise NoConvergence("the test function has no root nearby")
