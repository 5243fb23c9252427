"""Switch from a period-doubling or branch point to the branch that leaves there."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from continuation.branches.analysis import analyse
from continuation.branches.arclength import Ended, Limits, Progress, check_span, resolve, walk
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.branch_points import other_tangent
from continuation.branches.deflation import deflated
from continuation.branches.newton import Metric, Node, correct, size_of
from continuation.branches.recognition import wave
from continuation.branches.sparse_bordered import factorised
from continuation.errors import NoConvergence

Known = Callable[[Any, Node], str | None]
_FIRST = (1.0, 0.25, 4.0, 0.06, 0.015, 16.0)  # of the first step, distances from the point that are tried
_STRAY = 4.0  # times that distance: a result farther away is another solution, the parent perhaps
_GONE = 1e-7  # relative size of what distinguishes a doubled orbit below which it is the parent


@dataclass(frozen=True, slots=True, eq=False)
class Departure:
    """Where a branch leaves its parent: the orbit (u, p) as the new branch's Problem has it, the direction, the metric.

    ``direction`` is a unit vector across the parent branch, or the tangent of the new one where that is known; both
    signs of it lead to the new branch.
    """

    point: SpecialPoint
    problem: Any
    u: np.ndarray
    direction: tuple[np.ndarray, float]
    metric: Metric
    limits: Limits


def span_of(point: SpecialPoint, span: tuple[float, float] | None) -> tuple[float, float]:
    """Return the checked span in which a branch is followed from a point, by default that of the point's own branch."""
    span = span or point.span
    if span is None:
        raise ValueError("a special point loaded from a file has no problem to go on with; trace its branch again")
    return check_span(span, point.parameter)


def switch(
    point: SpecialPoint,
    span: tuple[float, float] | None = None,
    *,
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 2000,
    progress: Progress | None = None,
) -> Branch:
    """Trace the branch that is born at a period-doubling or crosses at a branch point.

    Parameters
    ----------
    point : SpecialPoint
        A period-doubling or branch point of a branch traced by any method, not loaded from a file.
    span : (float, float), optional
        Parameter range, which must contain the point; default that of the branch the point was found on.
    step, max_step : float, optional
        First and largest arclength step in units of the parameter, default 1/500 and 1/40 of the span.

    Returns
    -------
    Branch
        At a period-doubling, of twice the period multiple, from the point (left out) to where it leaves the span, meets
        the parent branch again, or stops for the reason given; the two half-branches are one orbit shifted in time, so
        one direction is all there is. At a branch point, of the same period, through the point (left out) both ways.

    Raises
    ------
    ValueError
        If the point is of another kind, was loaded from a file, or lies outside the span.
    NoConvergence
        If no orbit of the new branch is found near the point.

    Notes
    -----
    The first orbit is sought on a hyperplane beside the point which the parent branch does not meet nearby (Seydel,
    Practical Bifurcation and Stability Analysis, section 5.6); where that fails, by Newton's method with the parent
    deflated. Whatever is found is checked not to be the parent.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import HarmonicBalance, System, trace
    >>> x, v, theta, omega, g = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega", "g"))
    >>> wells = System(name="two wells", states={"x": x, "v": v},
    ...                derivatives={"x": v, "v": -0.3 * v + x - x**3 + g * ca.cos(theta)},
    ...                phase=theta, frequency="omega", parameters={"g": (g, 0.2), "omega": (omega, 1.2)})
    >>> problem = HarmonicBalance().discretise(wells, "g")
    >>> parent = trace(problem, problem.guess(g=0.262), (0.262, 0.268))
    >>> doubled = switch(parent.special_points[0], (0.262, 0.288))
    >>> doubled.period_multiple, [(q.kind, round(q.parameter, 8)) for q in doubled.special_points]
    (2, [('period-doubling', 0.28669316)])
    """
    began = time.perf_counter()
    limits = Limits.of(span_of(point, span), step, max_step, max_points, parts=500.0)
    branch = follow(departure(point, limits), progress, began)
    assert branch is not None  # nothing is known that it could be
    return branch


def departure(point: SpecialPoint, limits: Limits) -> Departure:
    """Return where the new branch leaves (ValueError as for :func:`switch`)."""
    if point.kind not in ("period-doubling", "branch-point"):
        raise ValueError(f"switch: expected a period-doubling or a branch point, got a {point.kind}")
    if point.problem is None or point.node is None:
        raise ValueError("switch: the point was loaded from a file and has no problem; trace its branch again")
    node = point.node
    if point.kind == "period-doubling":
        problem, u = point.problem.doubled(node.u)
        parent = np.zeros_like(u), 1.0
    else:
        problem, u = point.problem, node.u
        parent = node.tu, node.tp
    metric = Metric(size_of(u), limits.span[1] - limits.span[0])
    direction = other_tangent(problem, (u, node.p), parent, metric) if point.kind == "branch-point" else None
    return Departure(point, problem, u, direction or across(problem, (u, node.p), parent, metric), metric, limits)


def across(
    problem: Any, at: tuple[np.ndarray, float], parent: tuple[np.ndarray, float], metric: Metric
) -> tuple[np.ndarray, float]:
    """Return the unit direction v with ``[dF/du, dF/dp] v = 0`` and normal to the tangent ``parent``.

    At the point itself this matrix with the normal as its last row is singular; the direction is its null vector, by
    inverse iteration.
    """
    anchor = getattr(problem, "anchor", None)
    if anchor is not None:
        anchor(*at)
    _, J, Fp = problem.linearise(*at)
    n = len(Fp)
    row = np.append(parent[0] / metric.size, parent[1] / metric.span)
    row /= np.linalg.norm(row)
    solve = _solver(J * metric.size, Fp * metric.span, row)
    v = np.random.default_rng(0).standard_normal(n + 1)
    for _ in range(4):
        for transposed in (True, False):
            v = solve(v, transposed)
            v /= np.linalg.norm(v)
    return v[:n] * metric.size, float(v[n]) * metric.span


def _solver(J: Any, Fp: np.ndarray, row: np.ndarray) -> Callable[[np.ndarray, bool], np.ndarray]:
    """Return ``(b, transposed) -> A^-1 b`` for A = [J, Fp; row], by factors that stay finite where A is singular."""
    n = len(Fp)
    if sp.issparse(J):
        A = sp.csc_array(sp.bmat([[J, Fp[:, None]], [row[None, :n], row[None, n:]]], format="csc"))
        lu = factorised(A)
        if lu is None:
            lu = factorised(sp.csc_array(A + 1e-14 * abs(A).max() * sp.eye_array(n + 1)))
        if lu is None:
            raise NoConvergence("the Jacobian at the point has no null vector of its own")
        return lambda b, transposed: lu.solve(b, "T" if transposed else "N")
    dense = np.empty((n + 1, n + 1))
    dense[:n, :n], dense[:n, n], dense[n] = J, Fp, row
    factors, pivots, _ = sl.lapack.dgetrf(dense)
    diagonal = factors.reshape(-1)[:: n + 2] if factors.flags.c_contiguous else factors.T.reshape(-1)[:: n + 2]
    tiny = np.abs(diagonal) < 1e-16 * np.abs(diagonal).max()
    factors[np.flatnonzero(tiny), np.flatnonzero(tiny)] = 1e-16 * np.abs(diagonal).max()
    return lambda b, transposed: sl.lapack.dgetrs(factors, pivots, b, trans=int(transposed))[0]


def first_node(leaving: Departure, side: float) -> Node:
    """Return a corrected point of the new branch on one side of the parent, its tangent pointing away from it.

    Raises
    ------
    NoConvergence
        If every attempt fails or ends on the parent.
    """
    problem, metric = leaving.problem, leaving.metric
    du, dp = side * leaving.direction[0], side * leaving.direction[1]
    u, p = leaving.u, leaving.point.parameter
    reason = ""
    for part in _FIRST:
        e = part * leaving.limits.first / metric.span
        try:
            node = correct(problem, (u + e * du, p + e * dp), (du, dp), metric, accuracy=1e-9)
        except NoConvergence as failure:
            reason = str(failure)
            continue
        if metric.length(node.u - u, node.p - p) < _STRAY * e:
            return resolve(problem, node, (du, dp), metric)
        reason = "the correction went astray, perhaps to the parent branch"
    try:
        return _deflated_node(leaving, side)
    except NoConvergence as failure:
        raise NoConvergence(
            f"the branch at {problem.parameter} = {p:.6g} can't be started: {reason}; with the parent deflated: "
            f"{failure}; try another step",
            parameter=p,
        ) from failure


def _deflated_node(leaving: Departure, side: float) -> Node:
    """Look for the new branch at parameters beside the point by Newton's method with the parent deflated."""
    problem, metric, u = leaving.problem, leaving.metric, leaving.u
    du = side * leaving.direction[0]
    e = leaving.limits.first / metric.span
    failure = NoConvergence("no parameter of the span is near")
    for shift in (e, -e, 4 * e, -4 * e, e / 16, -e / 16):
        p = leaving.point.parameter + shift * metric.span
        if not leaving.limits.span[0] <= p <= leaving.limits.span[1]:
            continue
        fixed = np.zeros_like(u), 1.0
        try:
            parent = correct(problem, (u, p), fixed, metric, iterations=20).u
            found = deflated(problem, parent + np.sqrt(abs(shift)) * du, p, [parent])
            node = correct(problem, (found, p), fixed, metric)
        except NoConvergence as reason:
            failure = reason
            continue
        away = np.sign(metric.dot((node.u - u, 0.0), (node.tu, node.tp))) or 1.0
        node = replace(node, tu=away * node.tu, tp=away * node.tp, sign=away * node.sign)
        return resolve(problem, node, (node.tu, node.tp), metric)
    raise failure


def follow(leaving: Departure, progress: Progress | None, began: float, known: Known | None = None) -> Branch | None:
    """Return the new branch; None where ``known`` says that it is one already known.

    ``known(problem, node)`` returns the reason why the walk need not go on, or None.
    """
    problem, point = leaving.problem, leaving.point
    low, high = leaving.limits.span
    doubling = point.kind == "period-doubling"
    pieces: list[Branch] = []
    outside: list[float] = []
    for side in (1.0,) if doubling else (1.0, -1.0):
        first = first_node(leaving, side)
        end = high if first.tp >= 0 else low
        if not low <= first.p <= high or first.p == end:
            outside.append(side)
            continue
        met: list[str] = []
        ended = _ended(problem, doubling, known, met)
        if ended(first, first) and met:
            continue
        nodes, stop = walk(problem, first, (first.p, end), leaving.limits, leaving.metric, progress, ended)
        if met:
            continue
        pieces.append(analyse(problem, nodes, leaving.metric, stop, began, progress))
        if "interrupted" in stop or stop.startswith("closed"):
            break
    if not pieces and outside:
        raise ValueError(f"the new branch leaves the span {low, high} at once; widen it")
    if not pieces:
        return None
    return pieces[0] if len(pieces) == 1 else _joined(*reversed(pieces))


def _ended(problem: Any, doubling: bool, known: Known | None, met: list[str]) -> Ended:
    """Return what ends the walk: the Problem's own reasons, the parent met again, a branch known already."""
    own = getattr(problem, "ended", None)
    odd: list[np.ndarray] = []

    def ended(before: Node, new: Node) -> str | None:
        if known is not None and (why := known(problem, new)):
            met.append(why)
            return why
        if before is not new and own is not None and (why := own(before, new)):
            return str(why)
        if doubling:
            odd.append(_odd(problem, new))
            if len(odd) > 1 and (np.vdot(odd[-1], odd.pop(0)) <= 0 or not odd[-1].any()):
                n = problem.period_multiple // 2
                return f"met the branch of period {n} again near {problem.parameter} = {new.p:.6g}"
        return None

    return ended


def _odd(problem: Any, node: Node) -> np.ndarray:
    """Return half the difference of an orbit from itself half its period later, 0 where that is rounding."""
    x = wave(problem, node.u, node.p)
    half = (x[: len(x) // 2] - x[len(x) // 2 :]) / 2
    return half * (float(np.abs(half).max()) > _GONE * float(np.abs(x).max()))


def _joined(back: Branch, ahead: Branch) -> Branch:
    """Return one branch from the far end of ``back`` to that of ``ahead``, which leave one point opposite ways."""
    count = len(back)
    points = [replace(q, index=max(count - 2 - q.index, 0)) for q in reversed(back.special_points)]
    points += [replace(q, index=q.index + count) for q in ahead.special_points]
    work = {k: max(v, ahead.work[k]) for k, v in back.work.items()} | {"points": count + len(ahead)}
    stop = "; ".join(dict.fromkeys((back.stop, ahead.stop)))
    unresolved = tuple(dict.fromkeys(back.unresolved + ahead.unresolved))
    orbits = tuple(reversed(back.orbits)) + ahead.orbits
    return Branch(orbits, tuple(points), stop, work, ahead.provenance, unresolved)
