"""Branch points by Newton's method on a bordered system with one unfolding unknown.

Where two branches cross, ``[F_u, F_p]`` loses one rank: F_u has null vectors v and w, and F_p is in its range. With b
and c as borders of ``[[F_u, b], [c, 0]]`` the system

    F(u, p) + beta b = 0,    g(u, p) = 0,    h(u, p) = w . F_p(u, p) = 0

in u, p and beta is regular at a crossing with two different tangents (Govaerts, Numerical Methods for Bifurcations of
Dynamical Equilibria, section 7.6; Moore, SIAM J. Numer. Anal. 17, 1980). beta comes out as 0 there; where it does not,
symmetry is broken and the branches pass each other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.bordered import bordered_factors
from continuation.branches.extended import bordered, nearest_null
from continuation.branches.newton import UNUSABLE, Metric, size_of
from continuation.branches.sparse_bordered import factorised
from continuation.errors import IntegrationFailed, NoConvergence, UnsupportedModel
from continuation.orbits.split_operator import SplitMatrix

_STEP = 1e-8  # relative step that is the last: convergence is quadratic
_FAR = 3.0  # relative step that leads anywhere
_APART = 1e-5  # relative distance of the two points from which w . F'' is taken along one direction
_DOUBLE = 1e-10  # of the larger of its terms, discriminant at which both tangents are one

Direction = tuple[np.ndarray, float]
_Small = tuple[np.ndarray, np.ndarray]  # borders (b, c) of the operator that is singular with F_u
_Linear = Callable[[np.ndarray, float], float]


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """Solution of the bordered system.

    Attributes
    ----------
    u, p : array (N,), float
    beta : float
        What has to be added to the equations, relative to the size of u, for the branches to cross.
    tangents : pair of (array (N,), float)
        Directions of the two branches, not normalised.
    history : tuple of float
        Relative lengths of the steps.
    """

    u: np.ndarray
    p: float
    beta: float
    tangents: tuple[Direction, Direction]
    history: tuple[float, ...]


def along(crossing: Crossing, direction: Direction, metric: Metric) -> tuple[Direction, Direction, float]:
    """Return both tangents as unit vectors, the one nearest to a direction first and on its side, and their cosine."""
    units = []
    for du, dp in crossing.tangents:
        size = metric.length(du, dp)
        cosine = metric.dot((du, dp), direction) / (size * metric.length(*direction))
        side = -1.0 if cosine < 0 else 1.0
        units.append(((side * du / size, side * dp / size), abs(cosine)))
    (first, cosine), (second, _) = sorted(units, key=lambda unit: -unit[1])
    return first, second, cosine


def other_tangent(problem: Any, at: Direction, parent: Direction, metric: Metric) -> Direction | None:
    """Return the unit tangent of the branch that crosses the parent at a point (u, p); None where it is not known."""
    try:
        return along(solve_crossing(problem, *at), parent, metric)[1]
    except (UnsupportedModel, NoConvergence, IntegrationFailed):
        return None


@dataclass(frozen=True, slots=True, eq=False)
class _Borders:
    """Column b (N,) and row c (N,) of the equations."""

    b: np.ndarray
    c: np.ndarray


def solve_crossing(problem: Any, u: np.ndarray, p: float, iterations: int = 12) -> Crossing:
    """Solve the bordered system from a point near a crossing; cost about eight linearisations a step.

    Parameters
    ----------
    problem : Problem
        With ``critical_operator`` and ``critical_form``, of a driven System.
    u, p : array (N,), float

    Raises
    ------
    UnsupportedModel
        For a method without second derivatives, and for autonomous Systems.
    NoConvergence
        If Newton's method fails, or both tangents are one or complex.

    Notes
    -----
    The step is a combination of v, of the response z to the parameter and of the response to the residual, so that
    second derivatives are needed along these three directions only. They are exact but for that along (z, 1) twice,
    which contains F_pp: a central difference of the exact F' z. It enters the matrix of Newton's method, not the
    equations. For methods of many segments or intervals the forms hold for directions that solve the linearised
    equations in between, as v and (z, 1) do: there the orbit is corrected once before every step.
    """
    if not hasattr(problem, "critical_operator") or hasattr(problem, "inner"):
        raise UnsupportedModel("branch points by a bordered system: only driven Systems, by a method with derivatives")
    size, scale = size_of(u), problem.parameter_scale(p)
    small, beta, history = None, 0.0, list[float]()
    for _ in range(iterations):
        try:
            if small is None:
                small = nearest_null(problem.critical_operator(u, p, 0.0))[::-1]
            here = _Local.settled(problem, u, p, beta, small)
            du, dp, dbeta = here.step()
            tangents = here.tangents()
        except UNUSABLE as reason:
            raise NoConvergence(f"branch point: {reason}", history, p) from reason
        before, u, p, beta = u, here.u + du, p + dp, here.beta + dbeta
        history.append(float(np.hypot(np.linalg.norm(u - before) / size, dp / scale)))
        if not history[-1] < _FAR:
            break
        if history[-1] < _STEP:
            if tangents is None:
                raise NoConvergence("branch point: its two tangents are one, or complex", history, p)
            return Crossing(u, p, beta / size, tangents, tuple(history))
    raise NoConvergence(f"branch point: no convergence in {len(history)} steps", history, p)


def _borders(problem: Any, u: np.ndarray, J: Any, small: _Small) -> _Borders:
    """Return the borders (b, c) of the operator that is singular with F_u as ones of F_u, so that g and h are the same.

    Methods with the monodromy matrix have ``M - I`` for the states at phase 0 and equations for every segment or
    collocation point. There b is what a move of the last state by -b does to the equations that end in it.
    """
    b, c = small
    if not hasattr(problem, "start_gradient"):
        return _Borders(b, c)
    n, out, unit = len(b), np.zeros_like(u), np.zeros_like(u)
    unit[0] = 1.0
    moved = b / problem.start(unit)[0]
    if sp.issparse(J):  # the first state is the last one of the last interval, too: the rows of that one
        count = problem.mesh(u).degree * n
        out[-count:] = -(sp.csr_array(J)[-count:, :n] @ moved)
    else:
        out[-n:] = moved
    return _Borders(out, problem.start_gradient(u, c))


def _solver(J: Any, borders: _Borders) -> Callable[[np.ndarray, float], tuple[np.ndarray, float]]:
    """Return the solution with ``[[F_u, b], [c, 0]]``, factorised once."""
    row = np.append(borders.c, 0.0)
    if sp.issparse(J):
        whole = sp.block_array([[J, borders.b[:, None]], [row[None, :-1], None]])
        factors: Any = factorised(sp.csc_array(whole))
    else:
        factors = bordered_factors(J, borders.b, row)
    if factors is None:
        raise NoConvergence("more than one multiplier is 1 here")

    def solve(right: np.ndarray, last: float) -> tuple[np.ndarray, float]:
        answer = factors.solve(np.append(right, last))
        return answer[:-1], float(answer[-1])

    return solve


def _times(J: Any, z: np.ndarray) -> np.ndarray:
    return np.asarray(J.times(z[:, None])[:, 0] if isinstance(J, SplitMatrix) else J @ z)


class _Local:
    """The linearised system at one point, and its second derivatives along a few directions."""

    def __init__(self, problem: Any, u: np.ndarray, p: float, beta: float, small: _Small) -> None:
        F, J, Fp = problem.linearise(u, p)
        M = problem.critical_operator(u, p, 0.0)
        borders = _borders(problem, u, J, small)
        self.problem, self.u, self.p, self.beta = problem, u, p, beta
        self.residual, self.condensed = F + beta * borders.b, len(M) != len(u)
        self._w = bordered(M, *small).w
        self._solve = _solver(J, borders)
        self.v, self.g = self._solve(np.zeros_like(u), 1.0)
        z, minus_h = self._solve(-Fp, 0.0)
        self.z, self.h = z, -minus_h

    @classmethod
    def settled(cls, problem: Any, u: np.ndarray, p: float, beta: float, small: _Small) -> _Local:
        """Return it at a point, or at the corrected one where the method has more unknowns than M."""
        here = cls(problem, u, p, beta, small)
        if not here.condensed:
            return here
        du, dbeta = here._solve(-here.residual, 0.0)
        return cls(problem, u + du, p, beta + dbeta, small)

    def step(self) -> tuple[np.ndarray, float, float]:
        """Return Newton's step in u, p and beta."""
        rest, push = self._solve(-self.residual, 0.0)
        bent = self._form(rest)(self.z, 1.0) if rest.any() else 0.0
        A, B, C = self._second
        right = np.array([self.g - self._along_v(rest, 0.0), -self.h - bent])
        a, dp = np.linalg.solve(np.array([[A, B], [B, C]]), right)
        return rest + a * self.v + dp * self.z, float(dp), float(push + a * self.g - dp * self.h)

    @cached_property
    def _along_v(self) -> _Linear:
        return self._form(self.v)

    @cached_property
    def _second(self) -> tuple[float, float, float]:
        """Second derivatives of w . F along (v, 0) twice, (v, 0) and (z, 1), and (z, 1) twice."""
        return self._along_v(self.v, 0.0), self._along_v(self.z, 1.0), self._along_parameter()

    def tangents(self) -> tuple[Direction, Direction] | None:
        """Return directions ``a (v, 0) + b (z, 1)`` with ``A a^2 + 2 B a b + C b^2 = 0``; None unless two of them."""
        A, B, C = self._second
        discriminant = B**2 - A * C
        if not discriminant > _DOUBLE * max(B**2, abs(A * C)):
            return None
        q = -(B + np.copysign(np.sqrt(discriminant), B))
        first, second = ((a * self.v + b * self.z, float(b)) for a, b in ((q, A), (C, q)))
        return first, second

    def _form(self, direction: np.ndarray) -> _Linear:
        """Return the linear function ``w . F''[(direction, 0), (du, dp)]`` of (du, dp)."""
        start = getattr(self.problem, "start", None)
        inner = direction if start is None else start(direction)
        form = self.problem.critical_form(self.u, self.p, 0.0, inner, self._w)
        name = self.problem.parameter
        by_parameter = float(np.real(form.parameter(name)))

        def value(du: np.ndarray, dp: float) -> float:
            return float((form.state @ du).real + by_parameter * dp)

        return value

    def _along_parameter(self) -> float:
        """Return ``w . F''[(z, 1), (z, 1)]``."""
        metric = Metric(size_of(self.u), self.problem.parameter_scale(self.p))
        e = _APART / metric.length(self.z, 1.0)
        sides = []
        for side in (e, -e):
            _, J, Fp = self.problem.linearise(self.u + side * self.z, self.p + side)
            sides.append(_times(J, self.z) + Fp)
        return self._solve((sides[0] - sides[1]) / (2 * e), 0.0)[1]
