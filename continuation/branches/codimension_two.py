"""Points of codimension two on tracked curves: cusps, generalised doublings, fold-flips and strong resonances.

Test functions of the monodromy matrix M of a point, with chi(z) = det(z I - M), and of the normal form:

    on a fold curve        1:1  chi'(1),    fold-flip  chi(-1),   cusp                 a chi'(1)
    on a doubling curve    1:2  chi'(-1),   fold-flip  chi(1),    generalised-doubling c chi'(-1)
    on a torus curve       1:3, 1:4  rotation number; 1:1 and 1:2 are the ends of the curve
    on all                 extremum  dq/ds of the second parameter along the curve

The factors chi' take off the poles that the coefficients a and c have at the resonances (Kuznetsov, Elements of Applied
Bifurcation Theory, chapter 9).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from continuation.branches.criticality import STRONG
from continuation.branches.curve import Segment
from continuation.branches.extended import ExtendedProblem
from continuation.branches.newton import Metric, Node
from continuation.branches.reduction import coefficient
from continuation.errors import ContinuationError, IntegrationFailed, NoConvergence, UnsupportedModel

PointKind = Literal["extremum", "cusp", "generalised-doubling", "fold-flip", "1:1", "1:2", "1:3", "1:4"]
_NOISE = 1e-7  # of the largest value along the curve, below which a test function has no sign
_NEUTRAL = 1e-8  # largest value of chi' along a curve that is rounding: multipliers mu and 1/mu, no damping
_XTOL = 1e-10  # of a step of the curve
_AROUND = (1e-4, 1e-2, 0.3)  # of a step: where a point is looked for again at a finer resolution
_CLOSER = (0.3, 0.06, 0.012)  # of a step, distances of true points on both sides of the end of a torus curve
_GONE = 1e-4  # rotation number that counts as that of a resonance


@dataclass(frozen=True, slots=True, eq=False)
class CurvePoint:
    """Point of codimension two on a tracked curve.

    Attributes
    ----------
    kind : str
        "cusp", "generalised-doubling", "fold-flip", "1:1", "1:2", "1:3", "1:4", or "extremum" where the second
        parameter turns back: there two points of a branch meet, and beyond it there are none.
    parameters : (float, float)
        The two parameters, in the order of the curve.
    error : (float, float)
        Stated error of each.
    index : int
        It lies between points ``index`` and ``index + 1`` of the curve; behind its last or before its first one where
        the curve ends in it.
    """

    kind: PointKind
    parameters: tuple[float, float]
    error: tuple[float, float]
    index: int

    def __str__(self) -> str:
        (p, q), (dp, dq) = self.parameters, self.error
        return f"{self.kind} at ({p:.10g}, {q:.10g}) +- ({dp:.1e}, {dq:.1e})"


class Tests:
    """Test functions at nodes of one curve; the sign of the null vector is carried from node to node."""

    def __init__(self, system: ExtendedProblem, metric: Metric) -> None:
        self.system, self.metric = system, metric
        self.missing = ""  # why a test function is not known
        self._along: np.ndarray | None = None

    def __call__(self, node: Node) -> dict[PointKind, float]:
        """Return the test functions of a node; NaN where one can't be had."""
        system = self.system
        u, p, nu = system.split(node.u)
        if system.kind == "grazing":
            return {"extremum": node.tp}
        if system.kind == "neimark-sacker":
            return {"extremum": node.tp, "1:3": nu - STRONG["1:3"], "1:4": nu - STRONG["1:4"]}
        inner = system.at(node.p)
        mu = np.linalg.eigvals(inner.monodromies([(u, p)])[0])
        size = float(np.prod(1 + np.abs(mu)))
        here = 1.0 if system.kind == "fold" else -1.0
        slope = sum(np.prod(np.delete(here - mu, i)) for i in range(len(mu))).real / size
        flip = float(np.prod(-here - mu).real) / size
        if system.kind == "fold":
            bend = self._bend(node) * float(slope)
            return {"cusp": bend, "extremum": node.tp, "1:1": float(slope), "fold-flip": flip}
        cubic = self._cubic(node) * float(slope)
        return {"extremum": node.tp, "1:2": float(slope), "fold-flip": flip, "generalised-doubling": cubic}

    def _bend(self, node: Node) -> float:
        """Return the quadratic coefficient of a fold up to a positive factor, the sign of the null vector kept."""
        system = self.system
        u, p, nu = system.split(node.u)
        system.linearise(node.u, node.p)
        null = system.null(node.u, node.p)
        form = system.inner.critical_form(u, p, nu, null.v, null.w)
        before = self._along
        guess = np.ones_like(u) if before is None else system.inner.lengthen(before, u)
        du, _ = system.tangent((guess, 0.0), self.metric)
        self._along = du
        return float((form.state @ du).real / form.shift.imag)

    def _cubic(self, node: Node) -> float:
        try:
            return coefficient(self.system, node.u, node.p)
        except UnsupportedModel as reason:
            self.missing = f"generalised doublings are not looked for: {reason}"
            return np.nan


def find_points(system: ExtendedProblem, nodes: list[Node], metric: Metric) -> tuple[list[CurvePoint], list[str]]:
    """Return the points of codimension two between the nodes of a curve, and notes on what is not known."""
    tests = Tests(system, metric)
    try:
        values = [tests(n) for n in nodes]
    except (ContinuationError, np.linalg.LinAlgError) as reason:
        return [], [f"points of codimension two are not looked for: {reason}"]
    notes = [tests.missing] if tests.missing else []
    found: list[CurvePoint] = []
    slope: dict[str, PointKind] = {"fold": "1:1", "period-doubling": "1:2"}
    kinds = list(values[0])
    resonance = slope.get(system.kind)
    if resonance is not None and max(abs(v[resonance]) for v in values) < _NEUTRAL:
        kinds = ["extremum", "fold-flip"]
        notes.append("the model has no damping: multipliers are double all along; resonances are not looked for")
    for kind in kinds:
        column = np.array([v[kind] for v in values])
        noise = _NOISE * np.nanmax(np.abs(column), initial=0.0)
        for i in range(len(nodes) - 1):
            a, b = column[i], column[i + 1]
            if not (a * b < 0 and min(abs(a), abs(b)) > noise):
                continue
            if kind == "extremum" and any(point.kind == "cusp" and point.index == i for point in found):
                continue  # both parameters turn back there
            try:
                found.append(_located(system, metric, (nodes[i], nodes[i + 1]), kind, i))
            except (NoConvergence, IntegrationFailed) as reason:
                q = sorted((nodes[i].p, nodes[i + 1].p))
                notes.append(f"{kind} seen at {system.parameter} in [{q[0]:.8g}, {q[1]:.8g}], not located ({reason})")
    return sorted(found, key=lambda point: point.index), notes


def _located(
    system: ExtendedProblem, metric: Metric, ends: tuple[Node, Node], kind: PointKind, index: int
) -> CurvePoint:
    """Locate a sign change on true points of the curve, at the resolution of its ends and at a finer one."""
    segment = Segment(system, metric, *ends)

    def at(x: float, like: np.ndarray | None) -> Node:
        return ends[round(x)] if like is None and x in (0.0, 1.0) else segment.node(x, like)

    def root(like: np.ndarray | None, low: float, high: float) -> tuple[float, Node]:
        tests, known = Tests(system, metric), {}
        tests(ends[0])  # the sign of the null vector

        def value(x: float) -> float:
            if x not in known:
                node = at(x, like)
                known[x] = tests(node)[kind], node
            return known[x][0]

        if value(low) * value(high) > 0:
            raise NoConvergence("no sign change at this resolution")
        x = float(brentq(value, low, high, xtol=_XTOL))
        value(x)
        return x, known[x][1]

    x, node = root(None, 0.0, 1.0)

    def again() -> Node:
        like = _finer(system, node)
        for reach in _AROUND:
            try:
                return root(like, x - reach, x + reach)[1]
            except NoConvergence:
                continue
        raise NoConvergence("no sign change at a finer resolution")

    return _point(system, kind, index, node, again)


def _finer(system: ExtendedProblem, node: Node) -> np.ndarray:
    finer = system.refined(node.u, node.p)
    if finer is None:
        raise UnsupportedModel("there is no finer resolution")
    return finer


def _point(system: ExtendedProblem, kind: PointKind, index: int, node: Node, again: Callable[[], Node]) -> CurvePoint:
    """Return a point whose error is its change at twice the resolution; infinite where that fails."""
    _, p, _ = system.split(node.u)
    floor = np.array([1e-11 * max(abs(p), 1e-3), 1e-11 * max(abs(node.p), 1e-3)])
    try:
        better = again()
    except UnsupportedModel:  # an integrator has one resolution: its tolerance
        return CurvePoint(kind, (p, node.p), (float(1e3 * floor[0]), float(1e3 * floor[1])), index)
    except ContinuationError:
        return CurvePoint(kind, (p, node.p), (np.inf, np.inf), index)
    _, finer, _ = system.split(better.u)
    error = np.abs([finer - p, better.p - node.p]) + floor
    return CurvePoint(kind, (finer, better.p), (float(error[0]), float(error[1])), index)


# -------------------------------------------------------------------------------------------- ends of torus curves
def passed_resonance(system: ExtendedProblem, new: Node) -> PointKind | None:
    """Return the resonance 1:1 or 1:2 that a step on a torus curve went over, where the curve ends, or None."""
    if system.kind != "neimark-sacker":
        return None
    nu = system.split(new.u)[2]
    return "1:1" if nu < _GONE else "1:2" if nu > 0.5 - _GONE else None


def end_point(system: ExtendedProblem, metric: Metric, before: Node, new: Node, kind: PointKind) -> CurvePoint:
    """Return the point where a torus curve ends; raises NoConvergence.

    The extended system is singular there, but its solutions pass smoothly: the rotation number changes sign (or goes
    past 1/2), and with it they come back the same way. So the cubic through true points on both sides gives the point.
    """
    goal = STRONG[kind]

    def at(segment: Segment, x: float) -> Node:
        (u, q), (du, dq) = segment.at(np.array([x]))[0], segment.direction(x)
        return Node(u, q, du, dq, 1.0, 0)

    def miss(node: Node) -> float:
        return system.split(node.u)[2] - goal

    outer = Segment(system, metric, before, new)
    if miss(before) * miss(new) > 0:
        raise NoConvergence("the curve comes near a resonance, and turns into another one there")
    x = float(brentq(lambda x: miss(at(outer, x)), 0.0, 1.0, xtol=_XTOL))
    found: list[Node] = []
    for reach in _CLOSER:
        ends = [outer.node(float(np.clip(x + side * reach, -0.5, 1.5))) for side in (-1, 1)]
        inner = replace(outer, a=ends[0], b=ends[1])
        y = float(brentq(lambda y, s=inner: miss(at(s, y)), 0.0, 1.0, xtol=_XTOL))
        found.append(at(inner, y))
        x += reach * (2 * y - 1)
    values = np.array([[system.split(n.u)[1], n.p] for n in found])
    error = np.abs(np.diff(values, axis=0))[-1] + 1e-11 * np.maximum(np.abs(values[-1]), 1e-3)
    (p, q), (dp, dq) = values[-1].tolist(), error.tolist()
    return CurvePoint(kind, (p, q), (dp, dq), 0)
