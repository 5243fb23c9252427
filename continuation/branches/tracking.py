"""Track a fold, a period-doubling, a torus or a grazing point in two parameters, on a minimally extended system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from continuation.branches.arclength import Limits, Progress, check_span, walk
from continuation.branches.branch import SpecialPoint
from continuation.branches.codimension_two import CurvePoint, PointKind, end_point, find_points, passed_resonance
from continuation.branches.extended import ExtendedProblem, extended, solve_point
from continuation.branches.grazing_system import GrazingProblem, touching
from continuation.branches.newton import Metric, Node, correct, size_of
from continuation.branches.tracked import Curve
from continuation.errors import ContinuationError, NoConvergence, UnsupportedModel

__all__ = ["Curve", "track"]

_GOAL = 3e-9  # wanted error of both parameters, relative to their sizes
_LEVELS = 2  # doublings of the resolution at most, beyond that of the orbits


def track(
    point: SpecialPoint,
    *,
    parameters: tuple[str, str],
    span: Mapping[str, tuple[float, float]],
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 2000,
    progress: Progress | None = None,
) -> Curve:
    """Follow a fold, a period-doubling, a Neimark-Sacker or a grazing point in the plane of two parameters.

    Parameters
    ----------
    point : SpecialPoint
        Of a traced branch, not loaded from a file.
    parameters : (str, str)
        Any two parameters of the System; the others keep the values of the point.
    span : mapping
        Range of the second parameter, e.g. ``{"g": (0.1, 0.4)}``; it must contain the present value. The curve runs
        to both ends, through turning points. A range of the first one may be given, too: the curve ends where it leaves
        it.
    step, max_step : float, optional
        First and largest arclength step in units of the second parameter, default 1/200 and 1/40 of its span.

    Returns
    -------
    Curve
        With its cusps, generalised doublings, fold-flips, strong resonances and extrema in ``points``.

    Raises
    ------
    ValueError
        For names that are not two different parameters, a span that does not contain the point, or a point loaded from
        a file.
    UnsupportedModel
        For other kinds of points, and for folds of autonomous Systems by harmonic balance.
    NoConvergence
        If the extended system can't be solved at the start.

    Notes
    -----
    Pseudo-arclength continuation of the minimally extended system (module ``extended``) with exact derivatives,
    those at contact changes included. They are infinite where a contact grazes: a curve may end there, and says so.
    Points of codimension two are looked for also where signs at both ends of a step agree: test functions that are not
    bounded away from zero by second differences over neighbouring points are looked at closer (module
    ``curve_search``), so that pairs inside one step are found.
    """
    first, second = _check(point, parameters, span)
    problem, orbit = _problem(point, first)
    value = point.orbit.parameters[second]
    low, high = check_span(span[second], value)
    limits = Limits.of((low, high), step, max_step, max_points)
    u, p = problem.unknown(orbit), point.orbit.parameters[first]
    if point.kind == "grazing":
        system: ExtendedProblem = GrazingProblem.of(problem, touching(problem, u, p), u, p, second)
    else:
        system = extended(problem, point.kind, u, p, second)
    metric = Metric(size_of(u), high - low)
    node = _start(system, system.join(u, p, _rotation(point)), value, metric)
    ends: list[tuple[Node, Node, PointKind]] = []

    def ended(before: Node, new: Node) -> str | None:
        kind = passed_resonance(system, new)
        if kind is not None:
            ends.append((before, new, kind))
            return f"ends in a {kind} resonance near {second} = {new.p:.6g}"
        return _left(system.split(new.u)[1], first, span)

    nodes, stop = walk(system, node, (float(span[second][0]), float(span[second][1])), limits, metric, progress, ended)
    points, notes = find_points(system, nodes, metric)
    for end in ends:
        try:
            points.append(_at_end(system, metric, nodes, end))
        except ContinuationError as reason:
            notes.append(f"its end in a {end[2]} resonance was not located: {reason}")
    return _curve(system, point, (first, second), nodes, metric, (stop, points, notes))


def _check(point: SpecialPoint, parameters: tuple[str, str], span: Mapping[str, Any]) -> tuple[str, str]:
    if point.problem is None:
        raise ValueError("track: the point was loaded from a file and has no problem; trace its branch again")
    problem = point.problem
    if point.kind not in ("fold", "period-doubling", "neimark-sacker", "grazing"):
        raise UnsupportedModel(
            "track: folds, period-doublings, Neimark-Sacker and grazing points can be tracked, "
            f"not a {point.kind} point"
        )
    names = [problem.system.check_parameter(n) for n in parameters]
    if len(names) != 2 or names[0] == names[1]:
        raise ValueError(f"track: parameters must be two different ones, got {tuple(parameters)}")
    if problem.parameter in names:
        first, second = problem.parameter, names[1] if names[0] == problem.parameter else names[0]
    else:
        first, second = names
    if second not in span or not set(span) <= {first, second}:
        raise ValueError(
            f"track: span must give the range of {second!r}, and may give that of {first!r}, got {sorted(span)}"
        )
    if _left(point.orbit.parameters[first], first, span):
        raise ValueError(
            f"track: the span of {first!r} does not contain the point at {point.orbit.parameters[first]:g}"
        )
    return first, second


def _problem(point: SpecialPoint, first: str) -> tuple[Any, Any]:
    """Return a problem of its own in the first parameter, and the orbit as one of it."""
    given = point.problem
    values = {name: point.orbit.parameters[name] for name in given.values if name != first}
    problem = given.method.discretise(given.system, first, period_multiple=given.period_multiple, **values)
    return problem, replace(point.orbit, parameter=first)


def _rotation(point: SpecialPoint) -> float:
    """Return the rotation number of a Neimark-Sacker point."""
    if point.kind != "neimark-sacker":
        return 0.0
    if point.form is not None and np.isfinite(point.form.rotation_number):
        return point.form.rotation_number
    mu = point.multipliers[point.multipliers.imag > 0]
    return float(np.angle(mu[np.argmin(np.abs(np.abs(mu) - 1))]) / (2 * np.pi)) if mu.size else 0.25


def _left(p: float, first: str, span: Mapping[str, tuple[float, float]]) -> str | None:
    if first not in span:
        return None
    low, high = sorted(span[first])
    if low <= p <= high:
        return None
    return f"{first} left its span at {low if p < low else high:.6g}"


def _start(system: ExtendedProblem, U: np.ndarray, q: float, metric: Metric) -> Node:
    node = correct(system, (U, q), (np.zeros_like(U), 1.0), metric, iterations=20)
    for _ in range(8):
        longer, _ = system.adapt(node.u, node.p)
        if len(longer) <= len(node.u):
            break
        node = correct(system, (longer, q), (np.zeros_like(longer), 1.0), metric, iterations=20)
    return node


def _at_end(
    system: ExtendedProblem, metric: Metric, nodes: list[Node], end: tuple[Node, Node, PointKind]
) -> CurvePoint:
    """Return the resonance that a torus curve ends in, behind its last point or before its first one."""
    before, new, kind = end
    found = end_point(system, metric, before, new, kind)
    return replace(found, index=-1 if before.p == nodes[0].p and len(nodes) > 1 else len(nodes) - 1)


def _curve(
    system: ExtendedProblem,
    point: SpecialPoint,
    names: tuple[str, str],
    nodes: list[Node],
    metric: Metric,
    rest: tuple[str, list[CurvePoint], list[str]],
) -> Curve:
    stop, points, notes = rest
    sharp = [_sharpened(system, n, metric, i in (0, len(nodes) - 1)) for i, n in enumerate(nodes)]
    orbits, rotation = [], []
    for coarse, (n, _) in zip(nodes, sharp, strict=True):
        inner = system.at(n.p)
        u, p, nu = system.split(system.lengthen(n.u, coarse.u))  # with the resolution that the orbit needs
        error = coarse.error if np.isfinite(coarse.error) else inner.error(u, p)
        orbits += inner.orbits([(u, p, error)])
        rotation.append(nu if point.kind == "neimark-sacker" else np.nan)
    values = np.array([[system.split(n.u)[1], n.p] for n, _ in sharp])
    error = np.array([e for _, e in sharp])
    points = sorted(points, key=lambda p: p.index)
    return Curve(point.kind, names, values, error, np.array(rotation), tuple(orbits), tuple(points), stop, tuple(notes))


def _sharpened(system: ExtendedProblem, node: Node, metric: Metric, end: bool) -> tuple[Node, tuple[float, float]]:
    """Return a point of the curve at rising resolution, and the error of both values.

    It lies on the plane across the curve; at an end, at the same second parameter.
    """
    sizes = np.array([max(abs(v), 1e-3) for v in (system.split(node.u)[1], node.p)])
    last = np.full(2, np.inf)
    for level in range(_LEVELS):
        longer = system.refined(node.u, node.p)
        if longer is None:
            break
        across = (np.zeros_like(longer), 1.0) if end else (system.lengthen(node.tu, longer), node.tp)
        try:
            finer = correct(system, (longer, node.p), across, metric)
        except NoConvergence:
            break  # the error says what was reached
        moved = np.abs([system.split(finer.u)[1] - system.split(node.u)[1], finer.p - node.p])
        # geometric: what is left is at most the last change, and the ratio of the last two of it where they are known
        ratio = 1.0 if level == 0 else float(np.clip(np.max(moved / np.maximum(last, 1e-300)), 0.05, 0.5))
        last, node = moved, finer
        if np.all(ratio * moved <= _GOAL * sizes):
            return node, _pair(2 * ratio * moved + 1e-11 * sizes)
    if np.isfinite(last).all():
        return node, _pair(last + 1e-11 * sizes)
    return node, _pair(_stated(system, node, metric) + 1e-11 * sizes)


def _stated(system: ExtendedProblem, node: Node, metric: Metric) -> np.ndarray:
    """Return the error of the first parameter that the method states, where its resolution can't be raised."""
    u, p, _ = system.split(node.u)
    try:
        solved = solve_point(system, node.u, node.p)
        du, dp = system.tangent((np.ones_like(u), 1.0), metric)
    except ContinuationError:
        return np.array([np.inf, np.inf])
    inner = system.at(node.p)
    own = Node(system.split(solved.u)[0], p, du, dp, 1.0, 0)
    return np.array([inner.point_error(own, system.kind), 0.0])


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
