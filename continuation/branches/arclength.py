"""The one continuation loop: pseudo-arclength steps from a start orbit along its branch."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from continuation.branches.analysis import analyse
from continuation.branches.branch import Branch
from continuation.branches.functions import Functions, check_functions
from continuation.branches.newton import UNUSABLE, Metric, Node, correct, size_of
from continuation.branches.sparse_bordered import null_direction
from continuation.errors import NoConvergence
from continuation.orbits.orbit import Orbit

Progress = Callable[[float, str], None]
Ended = Callable[[Node, Node], str | None]
_ACCURACY = 1e-9  # of points along the branch; special points are corrected further
_STRAY = 0.1  # of a step, correction of its prediction beyond what a turn explains that makes it be taken again
_TURN = 0.35  # rad between tangents of neighbouring points that makes a step be taken again, halved


@dataclass(frozen=True, slots=True)
class Limits:
    """Parameter range, first, largest and smallest step in units of the parameter, and the most points."""

    span: tuple[float, float]
    first: float
    largest: float
    smallest: float
    points: int

    @classmethod
    def of(
        cls, span: tuple[float, float], step: float | None, max_step: float | None, points: int, parts: float = 200.0
    ) -> Limits:
        """Fill in default steps, 1/parts and 1/40 of the span, and check the ones given (ValueError)."""
        for name, value in (("step", step), ("max_step", max_step)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name}: expected a positive number or None, got {value}")
        if points < 2:
            raise ValueError(f"max_points: expected a whole number >= 2, got {points}")
        width = span[1] - span[0]
        largest = width / 40 if max_step is None else max_step
        return cls(span, min(width / parts if step is None else step, largest), largest, width * 1e-7, points)


def trace(
    problem: Any,
    start: Orbit,
    span: tuple[float, float],
    *,
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 5000,
    progress: Progress | None = None,
    functions: Functions | None = None,
    special_points: bool = True,
) -> Branch:
    """Trace the branch of periodic orbits through ``start`` and locate its special points.

    Parameters
    ----------
    problem : Problem
        What a method made of a System, e.g. ``HarmonicBalance().discretise(system, parameter="omega")``.
    start : Orbit
        An orbit of the branch, e.g. ``problem.guess(omega=0.5)``.
    span : (float, float)
        Parameter range. The branch runs from the start towards ``span[1]`` when the start lies at ``span[0]``, else
        both ways, and ends where it leaves the range.
    step, max_step : float, optional
        First and largest arclength step in units of the parameter (a branch at constant amplitude moves by as much);
        default 1/200 and 1/40 of the span.
    max_points : int
        Limit on accepted points.
    progress : callable, optional
        Called with the fraction done (0 to 1, by the parameter) and a line of text.
    functions : mapping of str to callable, optional
        Functions of an Orbit whose zeros are special points of kind "user", e.g.
        ``{"rms 0.3": lambda orbit: orbit.rms("x") - 0.3}``. They are evaluated on interpolated orbits, too, should be
        smooth along the branch, and may return NaN where they have no value.
    special_points : bool
        False leaves them out: the response with its verdicts alone, in about 60 % of the time.

    Returns
    -------
    Branch
        Whatever was reached, with the reason why it ended in ``stop``; Ctrl-C ends it early too.

    Raises
    ------
    ValueError
        For a span that is empty, not finite, or does not contain the start, for a function that returns no number, and
        for functions without special points.
    NoConvergence
        If not even the start can be corrected.
    """
    began = time.perf_counter()
    low, high = check_span(span, start.value)
    width = high - low
    limits = Limits.of((low, high), step, max_step, max_points)
    if functions and not special_points:
        raise ValueError("functions: their zeros are special points; expected none with special_points=False")
    check_functions(functions or {}, start)
    u, p = problem.unknown(start), start.value
    metric = Metric(size_of(u), width)
    first = start_node(problem, u, p, metric)
    nodes, stop = walk(problem, first, span, limits, metric, progress, getattr(problem, "ended", None))
    return analyse(problem, nodes, metric, stop, began, progress, functions, special_points)


def walk(
    problem: Any,
    first: Node,
    span: tuple[float, float],
    limits: Limits,
    metric: Metric,
    progress: Progress | None = None,
    ended: Ended | None = None,
) -> tuple[list[Node], str]:
    """Return the nodes from ``first`` towards ``span[1]``, or both ways when it lies inside, and why they end.

    ``ended(before, new)`` may end the walk by returning the reason; the new node is then left out.
    """
    width = limits.span[1] - limits.span[0]
    ends = [float(e) for e in (span[1], span[0]) if abs(first.p - e) > 1e-12 * width]
    sides, stops = [], []
    for end in ends:
        nodes, stop = _walk(problem, first, end, limits, metric, progress, ended)
        sides.append(nodes)
        stops.append(stop)
        if stop.startswith(("interrupted", "closed")):
            break
    nodes = sides[0]
    if len(sides) == 2:
        nodes = [replace(n, tu=-n.tu, tp=-n.tp, sign=-n.sign) for n in reversed(sides[1][1:])] + nodes
    return nodes, "; ".join(dict.fromkeys(stops))


def check_span(span: tuple[float, float], value: float) -> tuple[float, float]:
    low, high = sorted(float(v) for v in span)
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise ValueError(f"span: expected two different finite numbers, got {span}")
    slack = 1e-9 * (high - low)
    if not low - slack <= value <= high + slack:
        raise ValueError(f"span {span} does not contain the start at {value}; widen it or start inside")
    return low, high


def start_node(problem: Any, u: np.ndarray, p: float, metric: Metric) -> Node:
    """Correct the start at fixed parameter, or across the branch where that is singular, at the resolution it needs."""
    node = _corrected(problem, u, p, metric)
    for _ in range(12):
        longer, error = problem.adapt(node.u, node.p)
        if len(longer) <= len(node.u):
            break
        node = _corrected(problem, longer, node.p, metric)
    return replace(node, error=error)


def _corrected(problem: Any, u: np.ndarray, p: float, metric: Metric) -> Node:
    try:
        return correct(problem, (u, p), (np.zeros_like(u), 1.0), metric, iterations=30)
    except NoConvergence as failure:
        _, J, Fp = problem.linearise(u, p)
        null = null_direction(J * metric.size, Fp * metric.span)
        node = correct(problem, (u, p), (null[:-1] * metric.size, null[-1] * metric.span), metric, iterations=30)
        if abs(node.p - p) > 1e-3 * metric.span:
            raise failure
        return node


def _walk(
    problem: Any,
    first: Node,
    end: float,
    limits: Limits,
    metric: Metric,
    progress: Progress | None,
    ended: Ended | None,
) -> tuple[list[Node], str]:
    forward = np.sign(end - first.p) or 1.0
    node = first if first.tp * forward >= 0 else replace(first, tu=-first.tu, tp=-first.tp, sign=-first.sign)
    nodes, ds = [node], limits.first / metric.span
    name = problem.parameter
    try:
        while len(nodes) < limits.points:
            new, ds, reason = _step(problem, nodes, ds, limits, metric)
            if new is None:
                return (
                    nodes,
                    f"could not go on at {name} = {node.p:.6g}: {reason}; try a smaller step or more harmonics",
                )
            if not limits.span[0] <= new.p <= limits.span[1]:
                landed = _land(problem, node, new, limits, metric)
                if landed is not None:
                    nodes.append(landed)
                return nodes, f"reached {name} = {nodes[-1].p:.6g}"
            if ended is not None and (why := ended(node, new)):
                return nodes, why
            nodes.append(new)
            node = new
            if _closed(nodes, metric, problem):
                return _meeting(nodes, metric, problem), "closed curve: came back to its start"
            if progress is not None:
                done = abs(node.p - first.p) / max(abs(end - first.p), 1e-300)
                progress(min(done, 1.0), f"{name} = {node.p:.4g}, {len(nodes)} orbits")
    except KeyboardInterrupt:
        return nodes, f"interrupted at {name} = {node.p:.6g}; the orbits up to there are kept"
    return nodes, f"limit of {limits.points} points reached at {name} = {node.p:.6g}"


def _step(problem: Any, nodes: list[Node], ds: float, limits: Limits, metric: Metric) -> tuple[Node | None, float, str]:
    """Take one accepted step; return it with the next step length, or None with the reason.

    The step is shortened while Newton fails, the tangent turns by more than ``_TURN`` or the point lies far from where
    it was predicted; the next one aims at half of that turn. The largest step grows with the amplitude, so that high
    peaks take no more points than low ones.
    """
    node = nodes[-1]
    reach = max(1.0, float(np.linalg.norm(node.u)) / metric.size)
    largest, smallest = reach * limits.largest / metric.span, limits.smallest / metric.span
    reason = ""
    ds = min(ds, largest)
    while ds >= smallest:
        try:
            guess = _predict(problem, nodes, ds, metric)
            new = correct(problem, guess, (node.tu, node.tp), metric, iterations=8, accuracy=_ACCURACY)
        except NoConvergence as failure:
            reason, ds = str(failure), ds / 2
            continue
        turn = metric.dot((node.tu, node.tp), (new.tu, new.tp))
        angle = float(np.arccos(np.clip(turn, -1.0, 1.0)))
        if angle > _TURN:
            reason, ds = "the branch turns too sharply", ds / 2
            continue
        if metric.length(new.u - guess[0], new.p - guess[1]) > (_STRAY + 2 * angle) * ds:
            reason, ds = "the correction leads away from the prediction, perhaps to another branch", ds / 2
            continue
        try:
            new = resolve(problem, new, (node.tu, node.tp), metric)
        except UNUSABLE as failure:  # the corrected point lies just beyond where the model ends
            reason, ds = str(failure), ds / 2
            continue
        growth = min(2.0, max(0.5, 0.5 * _TURN / max(angle, 1e-6)), 2.0 ** (4 - new.iterations))
        return new, min(ds * growth, largest), ""
    return None, ds, reason


def _predict(problem: Any, nodes: list[Node], ds: float, metric: Metric) -> tuple[np.ndarray, float]:
    """Continue the cubic through the last two points and their tangents; a tangent alone where that reaches too far."""
    node = nodes[-1]
    guess = node.u + ds * node.tu, node.p + ds * node.tp
    if len(nodes) < 2:
        return guess
    before, fit = nodes[-2], problem.lengthen
    du, dp = node.u - fit(before.u, node.u), node.p - before.p
    last = metric.length(du, dp)
    if ds > 3 * last:
        return guess
    # Hermite cubic on [-last, 0], its curvature and third derivative at 0
    bend_u = (4 * node.tu + 2 * fit(before.tu, node.u) - 6 * du / last) / last
    bend_p = (4 * node.tp + 2 * before.tp - 6 * dp / last) / last
    jerk_u = 6 * (node.tu + fit(before.tu, node.u) - 2 * du / last) / last**2
    jerk_p = 6 * (node.tp + before.tp - 2 * dp / last) / last**2
    return (
        guess[0] + ds**2 / 2 * bend_u + ds**3 / 6 * jerk_u,
        guess[1] + ds**2 / 2 * bend_p + ds**3 / 6 * jerk_p,
    )


def resolve(problem: Any, node: Node, direction: tuple[np.ndarray, float], metric: Metric) -> Node:
    """Change the resolution where the error asks for it; keep the node if that does not converge."""
    error = float("nan")
    raised = False
    for _ in range(8):
        u, error = problem.adapt(node.u, node.p)
        shorter = len(u) < len(node.u)
        if len(u) == len(node.u) or (shorter and raised):
            break
        raised = not shorter
        across = problem.lengthen(direction[0], u), direction[1]
        try:
            node = correct(problem, (u, node.p), across, metric, iterations=8, accuracy=_ACCURACY)
        except NoConvergence:
            break  # the error estimate of the orbit tells that the wanted resolution was not reached
        if shorter:
            _, error = problem.adapt(node.u, node.p)
            break
    return replace(node, error=error)


def _land(problem: Any, node: Node, beyond: Node, limits: Limits, metric: Metric) -> Node | None:
    """Return the point exactly at the end of the span, between two nodes."""
    end = limits.span[0] if beyond.p < limits.span[0] else limits.span[1]
    if abs(node.p - end) < 1e-12 * metric.span:
        return None
    u = problem.lengthen(node.u, beyond.u)
    part = (end - node.p) / (beyond.p - node.p)
    guess = u + part * (beyond.u - u)
    try:
        new = correct(problem, (guess, end), (np.zeros_like(guess), 1.0), metric)
    except NoConvergence:
        return None
    if metric.dot((beyond.tu, beyond.tp), (new.tu, new.tp)) < 0:
        new = replace(new, tu=-new.tu, tp=-new.tp, sign=-new.sign)
    return replace(new, error=problem.adapt(new.u, new.p)[1])


def _closed(nodes: list[Node], metric: Metric, problem: Any) -> bool:
    if len(nodes) < 8:
        return False
    first, last, before = nodes[0], nodes[-1], nodes[-2]

    def distance(node: Node) -> float:
        return metric.length(problem.lengthen(first.u, node.u) - node.u, first.p - node.p)

    step = metric.length(problem.lengthen(before.u, last.u) - last.u, before.p - last.p)
    same = metric.dot((problem.lengthen(first.tu, last.u), first.tp), (last.tu, last.tp)) > 0.9
    return same and distance(last) < 0.75 * step and distance(before) < 1.5 * step


def _meeting(nodes: list[Node], metric: Metric, problem: Any) -> list[Node]:
    """Return the nodes of a closed curve with the first one once more at the end, so that no piece is left out."""
    first, last = nodes[0], nodes[-1]
    u = problem.lengthen(first.u, last.u)
    ahead = metric.dot((u - last.u, first.p - last.p), (last.tu, last.tp)) > 0
    return [*(nodes if ahead else nodes[:-1]), replace(first)]
