"""Track a fold or a period-doubling in two parameters, on a minimally extended system."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.branches.arclength import Limits, Progress, check_span, walk
from continuation.branches.branch import Kind, SpecialPoint
from continuation.branches.newton import Metric, Node, correct, size_of
from continuation.errors import NoConvergence, UnsupportedModel
from continuation.orbits.curvature import critical_form
from continuation.orbits.orbit import Orbit


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A special point tracked in two parameters.

    Attributes
    ----------
    kind : str
    parameters : (str, str)
    values : array (N, 2)
        The two parameters along the curve.
    orbits : tuple of Orbit
    stop : str
        Why it ended, a sentence.
    """

    kind: Kind
    parameters: tuple[str, str]
    values: np.ndarray
    orbits: tuple[Orbit, ...]
    stop: str

    def __len__(self) -> int:
        return len(self.orbits)

    def __str__(self) -> str:
        (p, q), v = self.parameters, self.values
        return (
            f"Curve of {self.kind}s: {len(self)} points, {q} {v[0, 1]:.6g} to {v[-1, 1]:.6g}, "
            f"{p} {v[:, 0].min():.6g} to {v[:, 0].max():.6g}; stopped: {self.stop}"
        )


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
    """Follow a fold or a period-doubling point while a second parameter changes.

    Parameters
    ----------
    point : SpecialPoint
        A fold or period-doubling of a branch traced with harmonic balance, not loaded from a file.
    parameters : (str, str)
        The parameter the point was located in, and the second one.
    span : mapping
        Range of the second parameter, e.g. ``{"g": (0.1, 0.4)}``; it must contain the present value. The curve runs
        to both ends, through turning points.
    step, max_step : float, optional
        First and largest arclength step in units of the second parameter, default 1/200 and 1/40 of its span.

    Returns
    -------
    Curve

    Raises
    ------
    ValueError
        For other names than these, a span that does not contain the point, or a point loaded from a file.
    UnsupportedModel
        For other kinds of points and for points of another method.
    NoConvergence
        If the extended system can't be solved at the start.

    Notes
    -----
    The scalar g of ``[[M, b], [c, 0]] [v; g] = [0; 1]`` vanishes where M, the Jacobian or the operator on half-integer
    harmonics, is singular (Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, chapter 3). Its
    gradient in the orbit is exact, contacts included; the ones in the two parameters are central differences.
    """
    first, second = _check(point, parameters, span)
    value = point.problem.values[second]
    low, high = check_span(span[second], value)
    width = high - low
    limits = Limits.of((low, high), step, max_step, max_points)
    extended = ExtendedProblem(point, second)
    start = np.append(point.problem.unknown(point.orbit), point.parameter)
    metric = Metric(size_of(start), width)
    node = _start(extended, start, value, metric)
    nodes, stop = walk(extended, node, (float(span[second][0]), float(span[second][1])), limits, metric, progress)
    orbits = []
    for n in nodes:
        inner = extended.at(n.p)
        orbits += inner.orbits([(n.u[:-1], float(n.u[-1]), inner.error(n.u[:-1], float(n.u[-1])))])
    values = np.array([[n.u[-1], n.p] for n in nodes])
    return Curve(point.kind, (first, second), values, tuple(orbits), stop)


def _check(point: SpecialPoint, parameters: tuple[str, str], span: Mapping[str, Any]) -> tuple[str, str]:
    if point.problem is None:
        raise ValueError("track: the point was loaded from a file and has no problem; trace its branch again")
    problem = point.problem
    if point.kind not in ("fold", "period-doubling") or not hasattr(problem, "half_operator"):
        raise UnsupportedModel(
            f"track: folds and period-doublings found by harmonic balance can be tracked, not a {point.kind} "
            f"of {type(problem).__name__}"
        )
    names = [problem.system.check_parameter(n) for n in parameters]
    if len(names) != 2 or problem.parameter not in names or names[0] == names[1]:
        raise ValueError(f"track: parameters must be {problem.parameter!r} and another one, got {tuple(parameters)}")
    second = names[1] if names[0] == problem.parameter else names[0]
    if set(span) != {second}:
        raise ValueError(f"track: span must give the range of {second!r} alone, got {sorted(span)}")
    return problem.parameter, second


def _start(extended: ExtendedProblem, u: np.ndarray, q: float, metric: Metric) -> Node:
    fixed = np.zeros_like(u), 1.0
    node = correct(extended, (u, q), fixed, metric, iterations=20)
    for _ in range(8):
        longer, _ = extended.adapt(node.u, node.p)
        if len(longer) <= len(node.u):
            break
        node = correct(extended, (longer, q), (np.zeros_like(longer), 1.0), metric, iterations=20)
    return node


class ExtendedProblem:
    """The equations F(u, p; q) = 0, g(u, p; q) = 0 in the unknown [u, p] and the parameter q."""

    def __init__(self, point: SpecialPoint, second: str) -> None:
        problem = point.problem
        self.kind, self.parameter = point.kind, second
        self._inner = problem.method.discretise(
            problem.system, problem.parameter, period_multiple=problem.period_multiple, **problem.values
        )
        self._borders: tuple[np.ndarray, np.ndarray] | None = None

    def at(self, q: float) -> Any:
        """Return the inner problem with the second parameter at q."""
        self._inner.set_value(self.parameter, q)
        return self._inner

    def _matrix(self, u: np.ndarray, p: float, q: float) -> np.ndarray:
        inner = self.at(q)
        return inner.half_operator(u, p) if self.kind == "period-doubling" else inner.linearise(u, p)[1]

    def linearise(self, U: np.ndarray, q: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the extended residual, its Jacobian in [u, p] and its derivative in q."""
        u, p = U[:-1], float(U[-1])
        F, J, Fp = self.at(q).linearise(u, p)
        M = J if self.kind == "fold" else self._matrix(u, p, q)
        g, v, w = self._null(M)
        hp, hq = 3e-6 * (abs(p) or 1.0), 3e-6 * (abs(q) or 1.0)

        def moved(dp: float, dq: float) -> tuple[np.ndarray, float]:
            inner = self.at(q + dq)
            residual = inner.residual(u, p + dp) if dq else F
            return residual, -float(w @ self._matrix(u, p + dp, q + dq) @ v)

        gp = (moved(hp, 0.0)[1] - moved(-hp, 0.0)[1]) / (2 * hp)
        (Fa, ga), (Fb, gb) = moved(0.0, hq), moved(0.0, -hq)
        inner = self.at(q)
        gu = -critical_form(inner, u, p, 0.5 * (self.kind == "period-doubling"), v, w).state
        n = len(u)
        jacobian = np.empty((n + 1, n + 1))
        jacobian[:n, :n], jacobian[:n, n], jacobian[n, :n], jacobian[n, n] = J, Fp, gu, gp
        return np.append(F, g), jacobian, np.append(Fa - Fb, ga - gb) / (2 * hq)

    def _null(self, M: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Return g and the bordered right and left vectors v, w; the borders follow the null vectors."""
        n = len(M)
        if self._borders is None or len(self._borders[0]) != n:
            left, _, right = np.linalg.svd(M)
            self._borders = left[:, -1], right[-1]
        b, c = self._borders
        bordered = np.zeros((n + 1, n + 1))
        bordered[:n, :n], bordered[:n, n], bordered[n, :n] = M, b, c
        unit = np.zeros(n + 1)
        unit[n] = 1.0
        try:
            right, left = np.linalg.solve(bordered, unit), np.linalg.solve(bordered.T, unit)
        except np.linalg.LinAlgError as reason:
            raise NoConvergence("the null space has more than one dimension here") from reason
        v, w = right[:n], left[:n]
        self._borders = w / np.linalg.norm(w), v / np.linalg.norm(v)
        return float(right[n]), v, w

    def adapt(self, U: np.ndarray, q: float) -> tuple[np.ndarray, float]:
        """Choose the resolution of the orbit part."""
        u, error = self.at(q).adapt(U[:-1], float(U[-1]))
        return np.append(u, U[-1]), error

    def lengthen(self, U: np.ndarray, like: np.ndarray) -> np.ndarray:
        """Bring the orbit part to the length of another vector."""
        return np.append(self._inner.lengthen(U[:-1], like[:-1]), U[-1])
