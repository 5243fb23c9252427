"""The curve between two corrected points: cubic Hermite interpolation, and true points on it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from continuation.branches.newton import Metric, Node, correct

_VERTICAL = 1e-7  # parameter component of a tangent that counts as none


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Piece of a branch between nodes a and b, with coordinate x in [0, 1]."""

    problem: Any
    metric: Metric
    a: Node
    b: Node
    _known: list[tuple[np.ndarray, ...]] = field(default_factory=list, init=False, repr=False)

    def __str__(self) -> str:
        a, b = sorted((self.a.p, self.b.p))
        return f"{self.problem.parameter} in [{a:.10g}, {b:.10g}]"

    @property
    def vertical(self) -> bool:
        """Whether its orbits are all of one parameter value, a neutral family; a model linear along them has such."""
        a, b, level = self.a, self.b, max(abs(self.a.p), 1e-3)
        return min(abs(a.tp), abs(b.tp)) < _VERTICAL * level and abs(a.p - b.p) < 1e-9 * level

    def _ends(self) -> tuple[np.ndarray, ...]:
        """Return both ends and both tangents times the length, all of one resolution."""
        if not self._known:
            self._known.append(self._made())
        return self._known[0]

    def _made(self) -> tuple[np.ndarray, ...]:
        like = self.a.u if len(self.a.u) >= len(self.b.u) else self.b.u
        fit = self.problem.lengthen
        a = np.append(fit(self.a.u, like), self.a.p)
        b = np.append(fit(self.b.u, like), self.b.p)
        ta, tb = np.append(fit(self.a.tu, like), self.a.tp), np.append(fit(self.b.tu, like), self.b.tp)
        h = self.metric.length(b[:-1] - a[:-1], b[-1] - a[-1])
        return a, b, h * ta, h * tb

    def at(self, x: np.ndarray) -> list[tuple[np.ndarray, float]]:
        """Return interpolated points (u, p) at x (N,); error O(length^4)."""
        a, b, ta, tb = self._ends()
        x = np.atleast_1d(x)[:, None]
        y = a + x * (b - a) + x * (1 - x) * ((1 - x) * (ta - (b - a)) - x * (tb - (b - a)))
        return [(row[:-1], float(row[-1])) for row in y]

    def direction(self, x: float) -> tuple[np.ndarray, float]:
        """Return d(u, p)/dx at x."""
        a, b, ta, tb = self._ends()
        d = (b - a) + (1 - 4 * x + 3 * x * x) * (ta - (b - a)) - (2 * x - 3 * x * x) * (tb - (b - a))
        return d[:-1], float(d[-1])

    def node(self, x: float, like: np.ndarray | None = None, near: tuple[float, Node] | None = None) -> Node:
        """Return the true point of the branch on the hyperplane through x (raises NoConvergence).

        ``like`` gives the resolution, ``near`` a true point known at another x, whose distance from the interpolation
        is taken over as a better guess.
        """
        (u, p), (du, dp) = self.at(np.array([x]))[0], self.direction(x)
        if like is not None:
            u, du = self.problem.lengthen(u, like), self.problem.lengthen(du, like)
        if near is not None:
            u_near, p_near = self.at(np.array([near[0]]))[0]
            u, p = u + near[1].u - self.problem.lengthen(u_near, near[1].u), p + near[1].p - p_near
        size = self.metric.length(du, dp)
        return correct(self.problem, (u, p), (du / size, dp / size), self.metric)

    def coordinate(self, u: np.ndarray, p: float) -> float:
        """Return the x whose hyperplane, normal to the interpolation, holds a point of the same resolution."""
        x = 0.5
        for _ in range(20):
            (v, q), (dv, dq) = self.at(np.array([x]))[0], self.direction(x)
            square = self.metric.dot((dv, dq), (dv, dq))
            step = self.metric.dot((u - v, p - q), (dv, dq)) / (square or 1.0)
            x = float(np.clip(x + step, -2.0, 3.0))
            if abs(step) < 1e-10:
                break
        return x
