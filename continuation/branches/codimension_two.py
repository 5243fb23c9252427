"""Points of codimension two on tracked curves: cusps, generalised doublings, fold-flips and strong resonances.

Test functions (module ``curve_tests``) are bounded away from zero between the points of a curve, or more of its points
are looked at (module ``curve_search``); a sign change is located by a root search on true points of the curve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from continuation.branches.criticality import STRONG
from continuation.branches.curve import Segment
from continuation.branches.curve_search import Change, Sample, at_nodes, changes, chosen, search_curve
from continuation.branches.curve_tests import KINDS, PointKind, Tests
from continuation.branches.extended import ExtendedProblem
from continuation.branches.newton import Metric, Node
from continuation.errors import ContinuationError, IntegrationFailed, NoConvergence, UnsupportedModel

_RESONANCE: dict[str, PointKind] = {"fold": "1:1", "period-doubling": "1:2"}
_NEUTRAL = 1e-8  # largest value of chi' along a curve that is rounding: multipliers mu and 1/mu, no damping
_XTOL = 1e-10  # of a step of the curve
_JUMP = 1e-3  # of its values at the ends, what a test function may be at its root
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


def find_points(system: ExtendedProblem, nodes: list[Node], metric: Metric) -> tuple[list[CurvePoint], list[str]]:
    """Return the points of codimension two between the nodes of a curve, in order, and notes on what is not known."""
    tests, kinds = Tests(system, metric), KINDS[system.kind]
    notes: list[str] = []
    try:
        samples = at_nodes(tests, nodes, kinds)
        if system.kind in _RESONANCE and _undamped(samples, kinds.index(_RESONANCE[system.kind])):
            samples, kinds = chosen(samples, kinds, ("extremum", "fold-flip"))
            notes.append("the model has no damping: multipliers are double all along; resonances are not looked for")
        samples, open_ = search_curve(tests, samples, kinds)
    except (ContinuationError, np.linalg.LinAlgError) as reason:
        return [], [f"points of codimension two are not looked for: {reason}"]
    notes += [tests.missing] if tests.missing else []
    seen, touching = changes(tests, samples, kinds)
    notes += open_ + touching
    cusps = {id(c.a) for c in seen if c.kind == "cusp"}
    found: list[CurvePoint] = []
    for change in seen:
        if change.kind == "extremum" and id(change.a) in cusps:
            continue  # both parameters turn back there
        try:
            found.append(_located(system, metric, change))
        except (NoConvergence, IntegrationFailed) as reason:
            q = sorted((change.a.node.p, change.b.node.p))
            where = f"{system.parameter} in [{q[0]:.8g}, {q[1]:.8g}]"
            notes.append(f"{change.kind} seen at {where}, not located ({reason})")
    return found, notes


def _undamped(samples: list[Sample], column: int) -> bool:
    return max(abs(s.values[column]) for s in samples) < _NEUTRAL


def _located(system: ExtendedProblem, metric: Metric, change: Change) -> CurvePoint:
    """Locate a sign change on true points of the curve, at the resolution of its ends and at a finer one."""
    ends, kind = (change.a.node, change.b.node), change.kind
    segment = Segment(system, metric, *ends)

    def at(x: float, like: np.ndarray | None) -> Node:
        return ends[round(x)] if like is None and x in (0.0, 1.0) else segment.node(x, like)

    def root(like: np.ndarray | None, low: float, high: float) -> tuple[float, Node]:
        tests, known = Tests(system, metric), {}
        tests.along = change.a.along

        def value(x: float) -> float:
            if x not in known:
                node = at(x, like)
                known[x] = float(tests(node, (kind,))[0]), node
            return known[x][0]

        if value(low) * value(high) > 0:
            raise NoConvergence("no sign change at this resolution")
        x = float(brentq(value, low, high, xtol=_XTOL))
        if abs(value(x)) > _JUMP * max(abs(value(low)), abs(value(high))):
            raise NoConvergence("its test function jumps there, as where a contact grazes")
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

    return _point(system, kind, change.a.index, node, again)


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
