"""Locate special points on the true branch: Newton's method on extended systems at rising resolution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from continuation.branches.branch import Kind
from continuation.branches.branch_points import Crossing, along, solve_crossing
from continuation.branches.curve import Segment
from continuation.branches.extended import SHIFT, ExtendedProblem, extended, solve_point
from continuation.branches.located import GOAL, REACH, ROOT, Located, extrapolated, is_fixed, result, scale_of
from continuation.branches.newton import Node, size_of
from continuation.branches.root_search import crossing_search, rising, test_function
from continuation.branches.screening import Suspect
from continuation.errors import IntegrationFailed, NoConvergence, UnsupportedModel

__all__ = ["Located", "locate", "rising"]

_BROKEN = 1e-11  # unfolding, relative to the equations, that is more than rounding: the branches do not cross
_SLACK = 0.02  # of a segment, how far outside it a branch point may lie: its ends have another resolution
_ALONG = 0.9  # cosine between a tangent at a branch point and the interpolated branch, at least


def locate(suspect: Suspect) -> Located | str:
    """Return the located point, a note (str) on why it can't be located, or "" where there is none.

    Newton's method on the minimally extended system goes first, where the method of the orbits offers its derivatives;
    a root search on the test function second, inside the sign change where the first one left it.
    """
    segment, kind = suspect.segment, _kind(suspect)
    if kind == "branch-point":
        return _branch_point(suspect)
    nu = SHIFT.get(kind, 0.0)
    if kind == "neimark-sacker":
        (u, p) = segment.at(np.array([suspect.x]))[0]
        nu = _rotation(segment.problem, u, p)
        if not np.isfinite(nu):
            return ""  # two real multipliers with product 1, a neutral saddle, are no torus point
    search = partial(rising, segment, kind, test_function(segment.problem, kind))
    return _either(suspect, kind, lambda: _extended(segment, kind, suspect.x, nu), search)


def _branch_point(suspect: Suspect) -> Located | str:
    """Locate a branch point, or a fold that was taken for one; note what is wrong."""
    segment, x = suspect.segment, suspect.x
    if segment.a.tp * segment.b.tp > 0:
        search = partial(crossing_search, segment, test_function(segment.problem, "branch-point"))
        return _either(suspect, "branch-point", lambda: _crossing(segment, x), search)
    try:
        found = _crossing(segment, x)
        if isinstance(found, Located):
            return found
    except (UnsupportedModel, NoConvergence, IntegrationFailed):
        pass
    search = partial(rising, segment, "fold", test_function(segment.problem, "fold"))
    found = _either(suspect, "fold", lambda: _extended(segment, "fold", x, 0.0), search)
    words = "perhaps a branch point at which the branch is born: the determinant changes its sign"
    return replace(found, note=_joined(words, found.note)) if isinstance(found, Located) else found


def _either(
    suspect: Suspect, kind: Kind, newton: Callable[[], Located | str], search: Callable[[float], Located]
) -> Located | str:
    """Return what Newton's method finds, what a root search does where there are no derivatives or it fails."""
    reason = ""
    try:
        return newton()
    except UnsupportedModel:
        pass  # the method has no second derivatives
    except (NoConvergence, IntegrationFailed) as failure:
        reason = str(failure)
    found = _tried(suspect.segment, kind, suspect.x, search)
    if isinstance(found, Located) and reason:
        words = f"by a root search on its test function: the extended system failed ({reason})"
        return replace(found, note=_joined(words, found.note))
    return found


def _joined(*notes: str) -> str:
    return "; ".join(note for note in notes if note)


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
    problem, scale = segment.problem, scale_of(segment)
    u, p = segment.at(np.array([x]))[0]
    system = extended(problem, kind, u, p)
    node = solve_point(system, system.join(u, p, nu))
    x = _place(segment, system, node)
    steps = _Steps(lambda U: solve_point(system, U).u, lambda U: system.refined(U, 0.0), lambda U: system.split(U)[1])
    solutions, error = _raised(problem, steps, node.u, scale)
    U = solutions[0] if is_fixed(problem) else solutions[-1]
    if U is not solutions[-1]:
        U = solve_point(system, U).u  # its linearisation is the one at hand again
    u, p, nu = system.split(U)
    du, dp = segment.direction(x)
    tangent = system.tangent((problem.lengthen(du, u), dp), segment.metric)
    point = Node(u, p, *tangent, 1.0, node.iterations)
    if error is None:
        error = problem.point_error(point, kind) + ROOT * scale
    pairs = tuple((system, U) for U in solutions[:2])
    return replace(result(kind, point, error, segment, x), nu=nu, solutions=pairs)


def _crossing(segment: Segment, x: float) -> Located | str:
    """Solve the bordered system of a branch point at rising resolution, or say that the branches do not cross."""
    problem, scale = segment.problem, scale_of(segment)
    u, p = segment.at(np.array([x]))[0]
    first = solve_crossing(problem, u, p)
    x = segment.coordinate(first.u, first.p)
    if not -_SLACK <= x <= 1 + _SLACK:
        raise NoConvergence("it led to another point")
    steps = _Steps(lambda c: solve_crossing(problem, c.u, c.p), lambda c: _longer(segment, c), lambda c: float(c.p))
    found, error = _raised(problem, steps, first, scale)
    last = found[0] if is_fixed(problem) else found[-1]
    betas = [abs(c.beta) for c in found]  # its sign is that of the borders, which is arbitrary
    open_ = abs(betas[-1] - betas[-2]) if len(found) > 1 else _inexact(segment)
    if betas[-1] > _BROKEN + 3 * open_:
        return (
            f"{segment}: no branch point, though the determinant changes its sign: the equations are "
            f"{betas[-1]:.1e} of their size away from one (broken symmetry), two branches pass each other, and "
            "the continuation jumped from one to the other; take smaller steps"
        )
    du, dp = segment.direction(x)
    tangent, _, cosine = along(last, (problem.lengthen(du, last.u), dp), segment.metric)
    if not cosine > _ALONG:
        raise NoConvergence("two branches cross there, but not this one")
    point = Node(last.u, last.p, *tangent, 1.0, len(first.history))
    if error is None:
        error = problem.point_error(point, "branch-point") + ROOT * scale
    return result("branch-point", point, error, segment, x)


def _longer(segment: Segment, c: Crossing) -> Crossing | None:
    """Return a crossing at twice the resolution, None at the limit.

    Its estimated correction would mislead where beta is not 0: it is no orbit.
    """
    problem, orbit = segment.problem, segment.a
    like = problem.refined(problem.lengthen(orbit.u, c.u), orbit.p)
    return None if like is None else replace(c, u=problem.lengthen(c.u, like))


def _inexact(segment: Segment) -> float:
    """Return how far equations whose resolution can't be raised may be from the true ones, relative to the orbit."""
    problem, orbit = segment.problem, segment.a
    integration = getattr(problem, "integration", None)
    if integration is not None:
        return 10 * float(integration.rtol)
    return float(problem.error(orbit.u, orbit.p)) / size_of(orbit.u)


@dataclass(frozen=True, slots=True)
class _Steps:
    """What a point is solved with: solve, bring to a finer resolution (None at the limit), its parameter."""

    solve: Callable[[Any], Any]
    refine: Callable[[Any], Any]
    parameter: Callable[[Any], float]


def _raised(problem: Any, steps: _Steps, first: Any, scale: float) -> tuple[list[Any], float | None]:
    """Return solutions of rising resolution from the first one, and the parameter error; None of a single one.

    At a resolution that was asked for there is one finer solution, which tells the error of the first.
    """
    found, changes = [first], list[float]()
    error: float | None = None
    while error is None or error > GOAL * scale:
        finer = steps.refine(found[-1])
        if finer is None:
            break
        found.append(steps.solve(finer))
        changes.append(abs(steps.parameter(found[-1]) - steps.parameter(found[-2])))
        error = extrapolated(changes) + ROOT * scale
        if is_fixed(problem):
            break
    return found, error


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
    test = test_function(segment.problem, system.kind)
    if not -REACH <= x <= 1 + REACH or test(segment.a) * test(segment.b) < 0:
        raise NoConvergence("it led to another point")
    return x


def _kind(suspect: Suspect) -> Kind:
    """Return the kind of point that a sign change tells of.

    Where branches cross, the determinant of the equations bordered by the tangent changes its sign, at a fold it does
    not; but a branch that is born at a pitchfork turns there, too.
    """
    if suspect.test == 1:
        return "period-doubling"
    if suspect.test == 2:
        return "neimark-sacker"
    return "branch-point" if suspect.segment.a.sign != suspect.segment.b.sign else "fold"
