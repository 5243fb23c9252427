"""Switch from a period-doubling point to the branch of doubled period."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from continuation.branches.analysis import analyse
from continuation.branches.arclength import Limits, Progress, check_span, walk
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.newton import Metric, Node, size_of
from continuation.errors import UnsupportedModel
from continuation.orbits.spectrum import pack, unpack


def switch(
    point: SpecialPoint,
    span: tuple[float, float],
    *,
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 2000,
    progress: Progress | None = None,
) -> Branch:
    """Trace the branch of doubled period that is born at a period-doubling point.

    Parameters
    ----------
    point : SpecialPoint
        A period-doubling of a branch traced with harmonic balance, not loaded from a file.
    span : (float, float)
        Parameter range, which must contain the point.
    step, max_step : float, optional
        First and largest arclength step in units of the parameter, default 1/500 and 1/40 of the span.

    Returns
    -------
    Branch
        Of twice the period multiple, from the point (left out) to where it leaves the span, meets the parent branch
        again, or stops for the reason given. The two half-branches at the point are one orbit shifted in time, so one
        direction is all there is.

    Raises
    ------
    ValueError
        If the point is no period-doubling, was loaded from a file, or lies outside the span.
    UnsupportedModel
        For a point of another method than harmonic balance.
    """
    began = time.perf_counter()
    problem = _doubling_problem(point)
    low, high = check_span(span, point.parameter)
    width = high - low
    limits = Limits.of((low, high), step, max_step, max_points, parts=500.0)
    u, null = null_vector(point)
    doubled = problem.method.discretise(
        problem.system, problem.parameter, period_multiple=2 * problem.period_multiple, **problem.values
    )
    metric = Metric(size_of(u), width)
    tu = null / metric.length(null, 0.0)
    first = Node(u, point.parameter, tu, 0.0, 1.0, 0)
    far = high if high - point.parameter >= point.parameter - low else low

    def met_parent(before: Node, new: Node) -> str | None:
        k = doubled.ports.outputs
        odd = unpack(new.u, k)[1::2], unpack(doubled.lengthen(before.u, new.u), k)[1::2]
        if before is first or np.vdot(*odd).real > 0:
            return None
        return f"met the branch of period {problem.period_multiple} again near {problem.parameter} = {new.p:.6g}"

    nodes, stop = walk(doubled, first, (first.p, far), limits, metric, progress, met_parent)
    if len(nodes) < 2:
        raise ValueError(f"the doubled branch at {problem.parameter} = {point.parameter:.6g} can't be started: {stop}")
    return analyse(doubled, nodes[1:], metric, stop, began, progress)


def null_vector(point: SpecialPoint) -> tuple[np.ndarray, np.ndarray]:
    """Return the orbit and the null vector of multiplier -1 as unknowns of twice the period."""
    problem = point.problem
    k = problem.ports.outputs
    u = problem.unknown(point.orbit)
    matrix = problem.half_operator(u, point.parameter)
    v = np.linalg.svd(matrix)[2][-1]
    K = len(v) // (2 * k)
    half = (v[: K * k] + 1j * v[K * k :]).reshape(K, k)
    Y = unpack(u, k)
    base, odd = np.zeros((2 * K + 1, k), dtype=complex), np.zeros((2 * K + 1, k), dtype=complex)
    base[: 2 * len(Y) - 1 : 2] = Y[: K + 1]
    odd[1::2] = half
    return pack(base), pack(odd)


def _doubling_problem(point: SpecialPoint) -> Any:
    if point.kind != "period-doubling":
        raise ValueError(f"switch: expected a period-doubling point, got a {point.kind}")
    if point.problem is None:
        raise ValueError("switch: the point was loaded from a file and has no problem; trace its branch again")
    if not hasattr(point.problem, "half_operator"):
        raise UnsupportedModel("switch: only points found by harmonic balance can be switched at; trace with it first")
    return point.problem
