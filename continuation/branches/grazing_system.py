"""Locate a grazing point on the true branch, on the extended system of orbit and touching contact argument.

To the equations of the orbit comes ``g = a(phase*) - b``, the height of an extremum of the contact argument above a
breakpoint. Its derivative in anything is that of the argument at fixed phase, because the one in the phase vanishes; no
second derivatives are needed, and a grazing point is followed in two parameters like any other special point.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.curve import Segment
from continuation.branches.extended import ExtendedProblem, solve_point
from continuation.branches.grazing import Touch
from continuation.branches.locate import Located
from continuation.branches.newton import Node, size_of
from continuation.errors import IntegrationFailed, NoConvergence
from continuation.orbits.contact_wave import Extremum, extrema, extremum, gradient, waves

_GOAL = 1e-9  # wanted error, relative to the size of the parameter
_FLOOR = 2e-11  # of the stated error, relative likewise
_NEAR = 0.3  # rad that the touching instant moves between two evaluations
_OUTSIDE = 0.1  # of its segment, by which a located point may lie beyond its ends


class GrazingProblem(ExtendedProblem):
    """The equations ``F(u, p) = 0, g(u, p) = 0`` of a grazing orbit in the unknown [u, p]; see the module.

    Parameters
    ----------
    problem : Problem
    touching : (int, float, float)
        Contact number, breakpoint and phase over the period of the orbit, about.
    size, unit : float
        Norm of u, and size of the parameter p, which the unknown is scaled with.
    second : str, optional
        Name of the second parameter.
    """

    def __init__(
        self, problem: Any, touching: tuple[int, float, float], size: float, unit: float, second: str | None = None
    ) -> None:
        self.inner, self.kind, self.second = problem, "grazing", second
        self.parameter = second if second is not None else "nothing"
        self._scale, self._size, self.extra = size / unit, size, 1
        self._linear: tuple[Any, np.ndarray] | None = None
        self.contact, self.level, self.phase = touching
        self.side = 0  # of the extremum, once it is known

    @classmethod
    def of(
        cls, problem: Any, touching: tuple[int, float, float], u: np.ndarray, p: float, second: str | None = None
    ) -> GrazingProblem:
        """Return the extended system of a point (u, p), scaled to it."""
        return cls(problem, touching, size_of(u), problem.parameter_scale(p), second)

    def split(self, U: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Return orbit and parameter of an unknown, and 0."""
        return U[:-1], float(U[-1]) / self._scale, 0.0

    def _touching(self, inner: Any, u: np.ndarray, p: float) -> Extremum:
        """Return the extremum next to the last one, or where that is another one the one nearest to the breakpoint."""
        try:
            top = extremum(inner, u, p, self.contact, self.phase)
            if self.side in (0, top.side) and abs(top.phase - self.phase) < _NEAR:
                return top
        except NoConvergence:
            pass
        others = [e for e in extrema(waves(inner, u, p)[self.contact]) if self.side in (0, e.side)]
        if not others:
            raise NoConvergence("the extremum of the contact argument is lost: it merges with another one")
        nearest = min(others, key=lambda e: abs(e.value - self.level))
        return extremum(inner, u, p, self.contact, nearest.phase)

    def linearise(self, U: np.ndarray, q: float) -> tuple[np.ndarray, Any, np.ndarray]:
        """Return the extended residual, its Jacobian in the unknown and its derivative in q, all exact.

        Raises
        ------
        NoConvergence
            If the extremum is lost, where it merges with another one.
        """
        u, p, _ = self.split(U)
        inner = self.at(q)
        F, J, Fp = inner.linearise(u, p)
        self._linear = J, Fp
        top = self._touching(inner, u, p)
        self.phase, self.side = top.phase, top.side
        names = [inner.parameter] + ([self.second] if self.second is not None else [])
        row, by = gradient(inner, u, p, self.contact, top.phase, names)
        Fq = np.zeros(len(U))
        if self.second is not None:
            Fq = np.append(inner.parameter_derivative(u, p, self.second), by[1])
        blocks = [[J, (Fp / self._scale)[:, None]], [row[None], np.array([[by[0] / self._scale]])]]
        matrix: Any = sp.csc_array(sp.block_array(blocks)) if sp.issparse(J) else np.block(blocks)
        return np.append(F, top.value - self.level), matrix, Fq


def locate_touch(touch: Touch) -> Located | str:
    """Return the located grazing point, or a note on why it can't be located.

    The resolution rises until the parameter changes by less than 1e-9; that change is its stated error.
    """
    segment = touch.segment
    try:
        return _located(touch)
    except (NoConvergence, IntegrationFailed) as failure:
        a, b = sorted((segment.a.p, segment.b.p))
        return f"{segment.problem.parameter} in [{a:.10g}, {b:.10g}]: grazing seen but not located ({failure})"


def _located(touch: Touch) -> Located:
    segment, problem = touch.segment, touch.segment.problem
    scale = max(abs(segment.a.p), abs(segment.b.p)) or 1.0
    u, p = segment.at(np.array([touch.x]))[0]
    system = GrazingProblem.of(problem, (touch.contact, touch.level, touch.phase), u, p)
    node = solve_point(system, system.join(u, p))
    u, p, _ = system.split(node.u)
    x = segment.coordinate(_fitted(segment, u), p)
    if not -_OUTSIDE <= x <= 1 + _OUTSIDE:
        raise NoConvergence("it led to another point")
    fixed = any(getattr(problem.method, name, None) is not None for name in ("harmonics", "intervals"))
    point = _with_tangent(system, node, segment, x)
    error, last = np.inf, np.inf
    while error > _GOAL * scale and (longer := system.refined(node.u, 0.0)) is not None:
        finer = solve_point(system, longer)
        change = abs(system.split(finer.u)[1] - system.split(node.u)[1])
        if fixed:  # the point of the resolution that was asked for
            error = change + _FLOOR * scale
            system.linearise(node.u, 0.0)  # the tangent is that of this resolution
            break
        ratio = 0.5 if not np.isfinite(last) else float(np.clip(change / max(last, 1e-300), 0.05, 0.5))
        error, last, node = 2 * change * ratio / (1 - ratio) + _FLOOR * scale, change, finer
        point = _with_tangent(system, node, segment, x)
    if not np.isfinite(error):
        error = problem.point_error(point, "grazing") + _of_height(system, point) + _FLOOR * scale
    good = error <= 3 * _GOAL * scale
    note = _words(touch, system.phase * problem.period_multiple)
    need = "more harmonics are needed" if hasattr(problem, "forces") else "a tighter tolerance is needed"
    note += "" if good else f"; {need} for an error below {3 * _GOAL * scale:.0e}"
    whole = x if touch.origin is segment else touch.origin.coordinate(_fitted(touch.origin, point.u), point.p)
    return Located("grazing", point, error, touch.origin, whole, "located" if good else "guessed", note)


def _with_tangent(system: GrazingProblem, node: Node, segment: Segment, x: float) -> Node:
    """Return the last solution as a node of the branch."""
    u, p, _ = system.split(node.u)
    du, dp = segment.direction(x)
    return Node(u, p, *system.tangent((segment.problem.lengthen(du, u), dp), segment.metric), 1.0, node.iterations)


def _of_height(system: GrazingProblem, point: Node) -> float:
    """Return the parameter error by that of the height of the extremum, large where two touches are near."""
    problem = system.inner
    row, by = gradient(problem, point.u, point.p, system.contact, system.phase, [problem.parameter])
    known = problem.estimate(point.u, point.p) if hasattr(problem, "estimate") else None
    if known is not None and len(known.step) == len(row):  # by shooting the error is known in every state
        height = 2 * abs(float(row @ known.step) + by[0] * known.dp)
    else:
        height = 2 * problem.error(point.u, point.p) * float(np.linalg.norm(row)) / np.sqrt(len(row))
    return float(abs(point.tp) * height / max(abs(row @ point.tu + by[0] * point.tp), 1e-300))


def _fitted(segment: Segment, u: np.ndarray) -> np.ndarray:
    """Return an unknown at the resolution of a segment, that of its finer end."""
    a, b = segment.a.u, segment.b.u
    fitted: np.ndarray = segment.problem.lengthen(u, a if len(a) >= len(b) else b)
    return fitted


def _words(touch: Touch, phase: float) -> str:
    period = 2 * np.pi * touch.segment.problem.period_multiple
    side, ends = "maximum" if touch.side > 0 else "minimum", "gained" if touch.change > 0 else "lost"
    return f"{side} of {touch.name} at {touch.level:g}, phase {phase % period:.6g}: 2 contact changes {ends}"


def touching(problem: Any, u: np.ndarray, p: float) -> tuple[int, float, float]:
    """Return contact number, breakpoint and phase over the orbit's period where a grazing orbit touches.

    Raises
    ------
    NoConvergence
        If no contact argument has an extremum.
    """
    found = [
        (abs(top.value - level), i, level, top.phase)
        for i, (wave, contact) in enumerate(zip(waves(problem, u, p), problem.system.contacts, strict=True))
        for top in extrema(wave)
        for level in contact.breakpoints
    ]
    if not found:
        raise NoConvergence("no contact argument has an extremum")
    return min(found)[1:]
