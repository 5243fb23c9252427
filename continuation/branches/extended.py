"""Minimally extended systems: the equations of an orbit and one bordered scalar that vanishes where it bifurcates.

With M_nu the operator that is singular at a multiplier exp(2 pi i nu), the scalar g of

    [[M, b], [c*, 0]] [v; g] = [0; 1],     [w*, g] [[M, b], [c*, 0]] = [0, 1],

vanishes where M is singular, and its derivative in anything is ``-w* M' v`` (Govaerts, Numerical Methods for
Bifurcations of Dynamical Equilibria, chapters 3 and 4; Kuznetsov, Elements of Applied Bifurcation Theory, 10.2).
nu = 0 is a fold, 1/2 a period-doubling; at a Neimark-Sacker point nu is an unknown and g complex.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from continuation.branches.bordered import bordered_factors
from continuation.branches.branch import Kind
from continuation.branches.newton import Metric, Node, correct, size_of
from continuation.branches.sparse_bordered import solve_bordered
from continuation.errors import NoConvergence, UnsupportedModel
from continuation.orbits.split_operator import SplitMatrix

SHIFT: dict[Kind, float] = {"fold": 0.0, "period-doubling": 0.5}


@dataclass(frozen=True, slots=True, eq=False)
class Null:
    """Bordered scalar g and the right and left vectors v, w of an operator; v and w span its null spaces at g = 0."""

    g: complex
    v: np.ndarray
    w: np.ndarray


def nearest_null(M: np.ndarray, steps: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors near the right and left null vectors of a nearly singular matrix, by inverse iteration.

    >>> [abs(x).round(6).tolist() for x in nearest_null(np.array([[1.0, 0.0], [1.0, 1e-9]]))]
    [[0.0, 1.0], [0.707107, 0.707107]]
    """
    N = len(M)
    if isinstance(M, SplitMatrix):  # that of the low harmonics is near enough
        low = nearest_null(M.inner.block, steps)
        v, w = np.zeros((2, N))
        v[M.inner.kept], w[M.inner.kept] = low
        return v, w
    scale = float(np.abs(M).max()) or 1.0
    lu, pivots, info = (sl.lapack.zgetrf if np.iscomplexobj(M) else sl.lapack.dgetrf)(M)
    if info < 0 or not np.isfinite(lu).all():
        raise NoConvergence("the linearised equations are not finite")
    diagonal = np.abs(np.diag(lu))
    tiny = diagonal < 1e-15 * scale
    lu[np.flatnonzero(tiny), np.flatnonzero(tiny)] = 1e-15 * scale
    solve = sl.lapack.zgetrs if np.iscomplexobj(M) else sl.lapack.dgetrs
    start = np.random.default_rng(0).standard_normal(N)
    v, w = start / np.linalg.norm(start), start / np.linalg.norm(start)
    for _ in range(steps):
        v, w = solve(lu, pivots, v)[0], solve(lu, pivots, w, trans=2 if np.iscomplexobj(M) else 1)[0]
        v, w = v / np.linalg.norm(v), w / np.linalg.norm(w)
    return v, w


def bordered(M: np.ndarray, b: np.ndarray, c: np.ndarray) -> Null:
    """Solve both bordered systems of a matrix (N, N) with column b and row conj(c).

    Raises
    ------
    NoConvergence
        If the bordered matrix is singular: the null space has more than one dimension.
    """
    N = len(M)
    factors = bordered_factors(M, b, np.append(c.conj(), 0.0))
    if factors is None:
        raise NoConvergence("more than one multiplier is critical here")
    unit = np.zeros(N + 1, dtype=np.result_type(b, c))
    unit[N] = 1.0
    right = factors.solve(unit, accuracy=1e-12)  # its last entry is the test function
    left = factors.solve(unit, transposed=True, accuracy=1e-9)  # derivatives are taken with it
    return Null(right[N].item(), right[:N], left[:N])


class ExtendedProblem:
    """The equations ``F(u, p) = 0, g(u, p, nu) = 0`` in the unknown [u, p, nu], and a second parameter q.

    Parameters and nu are scaled in the unknown to the size of u, so that one norm weighs all of them. nu is part of it
    at Neimark-Sacker points only. Without a second parameter it is the system of the isolated point.

    Parameters
    ----------
    problem : Problem
        With ``critical_operator`` and ``critical_form``; its fixed parameters are changed by :meth:`at`.
    kind : str
    size, unit : float
        Norm of u, and size of the parameter p, which the unknown is scaled with.
    second : str, optional
        Name of the second parameter.

    Raises
    ------
    UnsupportedModel
        For other kinds, and for a method without exact second derivatives.
    """

    kind: Kind

    def __init__(self, problem: Any, kind: Kind, size: float, unit: float, second: str | None = None) -> None:
        if kind not in ("fold", "period-doubling", "neimark-sacker"):
            raise UnsupportedModel(f"no extended system for a {kind}")
        if not hasattr(problem, "critical_operator"):
            raise UnsupportedModel(
                f"{type(problem.method).__name__} does not offer second derivatives; use HarmonicBalance, Shooting or "
                "Collocation"
            )
        self.inner, self.kind, self.second = problem, kind, second
        self.parameter = second if second is not None else "nothing"
        self._scale, self._size = size / unit, size
        self.extra = 2 if kind == "neimark-sacker" else 1
        self._borders: tuple[np.ndarray, np.ndarray] | None = None
        self._last: tuple[np.ndarray, float, Null] | None = None
        self._linear: tuple[Any, np.ndarray] | None = None

    # ---------------------------------------------------------------- the unknown
    def join(self, u: np.ndarray, p: float, nu: float = 0.0) -> np.ndarray:
        """Return the unknown of an orbit, its parameter and the rotation number."""
        extra = [p * self._scale, nu * self._size][: self.extra]
        return np.concatenate([u, extra])

    def split(self, U: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Return orbit, parameter and nu of an unknown."""
        nu = float(U[-1]) / self._size if self.extra == 2 else SHIFT[self.kind]
        return U[: -self.extra], float(U[-self.extra]) / self._scale, nu

    def at(self, q: float) -> Any:
        """Return the inner problem with the second parameter at q."""
        if self.second is not None:
            self.inner.set_value(self.second, q)
        return self.inner

    def anchor(self, U: np.ndarray, q: float) -> None:
        """Fix the phase of an autonomous orbit next to that of a guess."""
        u, p, _ = self.split(U)
        anchor = getattr(self.at(q), "anchor", None)
        if anchor is not None:
            anchor(u, p)

    # ---------------------------------------------------------------- equations
    def linearise(self, U: np.ndarray, q: float) -> tuple[np.ndarray, Any, np.ndarray]:
        """Return the extended residual, its Jacobian in the unknown and its derivative in q, all exact."""
        u, p, nu = self.split(U)
        inner = self.at(q)
        F, J, Fp = inner.linearise(u, p)
        null = self._null(u, p, nu)
        self._last, self._linear = (U, q, null), (J, Fp)
        form = inner.critical_form(u, p, nu, null.v, null.w)
        columns = [-form.parameter(inner.parameter) / self._scale]
        if self.extra == 2:
            columns.append(-form.shift / self._size)
        g, gradient, columns = self._real(null.g), self._real(-form.state), [self._real(c) for c in columns]
        Fq = np.zeros(len(U))
        if self.second is not None:
            Fq = np.append(inner.parameter_derivative(u, p, self.second), self._real(-form.parameter(self.second)))
        right = np.zeros((len(u), self.extra))
        right[:, 0] = Fp / self._scale
        corner = np.array(columns).reshape(self.extra, self.extra).T
        if sp.issparse(J):
            matrix: Any = sp.csc_array(sp.block_array([[J, right], [gradient, corner]]))
        elif isinstance(J, SplitMatrix):
            matrix = J.bordered(right, gradient, corner)
        else:
            matrix = np.block([[J, right], [gradient, corner]])
        return np.append(F, g), matrix, Fq

    def _real(self, value: Any) -> np.ndarray:
        """Return the real equations (extra, ...) of a complex one, or the one real equation."""
        value = np.asarray(value)
        parts = [value.real, value.imag] if self.extra == 2 else [value.real]
        return np.array(parts)

    def null(self, U: np.ndarray, q: float) -> Null:
        """Return g and the null vectors at an unknown; the borders follow them."""
        if self._last is not None and self._last[0] is U and self._last[1] == q:
            return self._last[2]
        self.at(q)
        null = self._null(*self.split(U))
        self._last = U, q, null
        return null

    def _null(self, u: np.ndarray, p: float, nu: float) -> Null:
        M = self.inner.critical_operator(u, p, nu)
        if self._borders is None:
            v, w = nearest_null(M)
            self._borders = w, v
        elif len(self._borders[0]) != len(M):
            b, c = (self._fitted(x, u, len(M)) for x in self._borders)
            self._borders = b / np.linalg.norm(b), c / np.linalg.norm(c)
        null = bordered(M, *self._borders)
        self._borders = null.w / np.linalg.norm(null.w), null.v / np.linalg.norm(null.v)
        return null

    def tangent(self, along: tuple[np.ndarray, float], metric: Metric) -> tuple[np.ndarray, float]:
        """Return the unit tangent (du, dp) of the branch at the last solution, on the side of a direction ``along``."""
        if self._linear is None:
            raise ValueError("tangent: solve the system first")
        (J, Fp), n = self._linear, len(along[0])
        row = np.append(along[0] / metric.size**2, along[1] / metric.span**2)
        unit = np.zeros((n + 1, 1))
        unit[n] = 1.0
        if sp.issparse(J):
            found = solve_bordered(J, Fp, row, unit)
            t = None if found is None else found[0][:, 0]
        else:
            factors = bordered_factors(J, Fp, row)
            t = None if factors is None else factors.solve(unit)[:, 0]
        if t is None:
            raise NoConvergence("the Jacobian is singular in orbit and parameter together")
        size = metric.length(t[:-1], float(t[-1]))
        return t[:-1] / size, float(t[-1]) / size

    def _fitted(self, v: np.ndarray, u: np.ndarray, N: int) -> np.ndarray:
        """Return a null vector of another number of harmonics padded or cut to length N."""
        if self.kind == "fold":
            return np.asarray(self.inner.lengthen(v, u))
        if self.kind == "period-doubling":  # real parts, then imaginary parts
            halves, out = v.reshape(2, -1), np.zeros((2, N // 2))
            keep = min(len(v), N) // 2
            out[:, :keep] = halves[:, :keep]
            return out.ravel()
        cut = (len(v) - N) // 2  # orders -H..H
        return v[cut : cut + N] if cut > 0 else np.pad(v, -cut)

    # ---------------------------------------------------------------- resolution
    def adapt(self, U: np.ndarray, q: float) -> tuple[np.ndarray, float]:
        """Choose the resolution of the orbit part, at a fold by its distance from the branch."""
        u, p, _ = self.split(U)
        inner = self.at(q)
        at_fold = self.kind == "fold" and hasattr(inner, "half_operator")
        better, error = inner.adapt(u, p, across=True) if at_fold else inner.adapt(u, p)
        return (U if better is u else np.append(better, U[-self.extra :])), error

    def lengthen(self, U: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Bring the orbit part to the length of that of another unknown."""
        u = self.inner.lengthen(U[: -self.extra], like[: -self.extra])
        return np.append(u, U[-self.extra :])

    def refined(self, U: np.ndarray, q: float) -> np.ndarray | None:
        """Return the unknown at twice the resolution, or None at the limit."""
        u, p, _ = self.split(U)
        finer = self.at(q).refined(u, p)
        return None if finer is None else np.append(finer, U[-self.extra :])


def extended(problem: Any, kind: Kind, u: np.ndarray, p: float, second: str | None = None) -> ExtendedProblem:
    """Return the extended system of a point (u, p), scaled to it."""
    return ExtendedProblem(problem, kind, size_of(u), problem.parameter_scale(p), second)


def solve_point(problem: ExtendedProblem, U: np.ndarray, q: float = 0.0, iterations: int = 12) -> Node:
    """Correct the unknown of an extended system at fixed q (raises NoConvergence)."""
    u, _, _ = problem.split(U)
    metric = Metric(size_of(u), abs(q) or 1.0)
    return correct(problem, (U, q), (np.zeros_like(U), 1.0), metric, iterations=iterations)
