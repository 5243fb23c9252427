"""Meshes of collocation: piecewise polynomials on [0, 1], the period, and where their intervals should end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import comb, factorial

import numpy as np
from numpy.polynomial import legendre

_FLOOR = 0.05  # of the mean density of intervals, kept everywhere
_DENSE = 24  # points of an interval at which the largest value of a polynomial is looked for


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Numbers of one polynomial degree m on the unit interval.

    Attributes
    ----------
    nodes, weights : arrays (m+1,)
        Gauss-Lobatto points and weights; a polynomial is known by its values there.
    gauss, gauss_weights : arrays (m,)
        Gauss points and weights, where the differential equation is met.
    value, slope : arrays (m, m+1)
        Values and derivatives at the Gauss points from values at the nodes.
    node_slope : array (m+1, m+1)
        Derivatives at the nodes.
    to_legendre : array (m+1, m+1)
        Legendre coefficients from values at the nodes.
    shape : float
        Largest value of ``P_m - P_{m-2}``, the shape of the error that degree m - 1 leaves between its Gauss points;
        times the last Legendre coefficient of degree m it is that error.
    """

    nodes: np.ndarray
    weights: np.ndarray
    gauss: np.ndarray
    gauss_weights: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    node_slope: np.ndarray
    to_legendre: np.ndarray
    shape: float


@lru_cache(maxsize=16)
def table(degree: int) -> Table:
    """Return the table of a polynomial degree m >= 1.

    >>> table(2).nodes.tolist(), (6 * table(2).weights).round(12).tolist()
    ([0.0, 0.5, 1.0], [1.0, 4.0, 1.0])
    """
    m = degree
    inner = legendre.legroots(legendre.legder(np.eye(m + 1)[m])) if m > 1 else np.zeros(0)
    x = np.concatenate([[-1.0], (inner - inner[::-1]) / 2, [1.0]])
    g, w = legendre.leggauss(m)
    inverse = np.linalg.inv(legendre.legvander(x, m))
    derivative = legendre.legder(np.eye(m + 1))  # row j: coefficients of one degree less, column: polynomial
    dense = legendre.legvander(np.linspace(-1, 1, 1001), m)
    lower = dense[:, m - 2] if m > 1 else 0.0
    return Table(
        nodes=(x + 1) / 2,
        weights=1 / (m * (m + 1) * legendre.legval(x, np.eye(m + 1)[m]) ** 2),
        gauss=(g + 1) / 2,
        gauss_weights=w / 2,
        value=legendre.legvander(g, m) @ inverse,
        slope=2 * legendre.legvander(g, m - 1) @ derivative @ inverse,
        node_slope=2 * legendre.legvander(x, m - 1) @ derivative @ inverse,
        to_legendre=inverse,
        shape=float(np.abs(dense[:, m] - lower).max()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Intervals of the period, with ends 0 = s_0 < ... < s_N = 1, and polynomials of one degree on each.

    Neighbouring intervals share the node at their common end, the last one that of the first: N m nodes in all.

    Attributes
    ----------
    ends : array (N+1,)
    degree : int
    index : int array (N, m+1)
        Node numbers of every interval.
    positions : array (N*m,)
        Positions of the nodes in [0, 1).
    root : array (N*m,)
        Square roots of the Lobatto weights, whose squares add up to 1: an unknown is ``root * value``, so that its
        plain norm is the root mean square over time.
    """

    ends: np.ndarray
    degree: int
    index: np.ndarray
    positions: np.ndarray
    root: np.ndarray

    @classmethod
    def of(cls, ends: np.ndarray, degree: int) -> Mesh:
        """Return the mesh of given ends (N+1,), N >= 2."""
        t, h, count = table(degree), np.diff(ends), len(ends) - 1
        index = (np.arange(count)[:, None] * degree + np.arange(degree + 1)) % (count * degree)
        weights = np.bincount(index.ravel(), (h[:, None] * t.weights).ravel())
        positions = (ends[:-1, None] + h[:, None] * t.nodes[:-1]).ravel()
        return cls(ends, degree, index, positions, np.sqrt(weights))

    @classmethod
    def uniform(cls, count: int, degree: int) -> Mesh:
        """Return a mesh of equal intervals."""
        return cls.of(np.linspace(0.0, 1.0, count + 1), degree)

    @property
    def count(self) -> int:
        """Number of intervals N."""
        return len(self.ends) - 1

    @property
    def lengths(self) -> np.ndarray:
        """Lengths (N,) of the intervals."""
        return np.diff(self.ends)

    def elevated(self) -> Mesh:
        """Return the same intervals with polynomials of one degree more."""
        return Mesh.of(self.ends, self.degree + 1)

    def points(self) -> np.ndarray:
        """Return the positions (N, m) of the collocation points."""
        return self.ends[:-1, None] + self.lengths[:, None] * table(self.degree).gauss

    def values(self, u: np.ndarray) -> np.ndarray:
        """Return the node values (N*m, n) of an unknown (N*m*n,)."""
        return u.reshape(len(self.root), -1) / self.root[:, None]

    def unknown(self, values: np.ndarray) -> np.ndarray:
        """Return the unknown (N*m*n,) of node values (N*m, n)."""
        return (values * self.root[:, None]).ravel()

    def evaluate(self, values: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return the piecewise polynomial of node values (N*m, n) at positions (P,) in [0, 1], shape (P, n)."""
        i = np.clip(np.searchsorted(self.ends, s, side="right") - 1, 0, self.count - 1)
        local = (s - self.ends[i]) / self.lengths[i]
        weights = legendre.legvander(2 * local - 1, self.degree) @ table(self.degree).to_legendre
        return np.einsum("pa,pan->pn", weights, values[self.index[i]])

    def largest(self, values: np.ndarray) -> float:
        """Return the largest absolute value of the piecewise polynomial of node values (N*m, n)."""
        dense = legendre.legvander(np.linspace(-1, 1, _DENSE), self.degree) @ table(self.degree).to_legendre
        return float(np.abs(np.einsum("qa,ian->iqn", dense, values[self.index])).max())

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Return derivatives (N*m, n) by the position at the nodes, averaged where two intervals meet."""
        t = table(self.degree)
        each = np.einsum("ba,ian->ibn", t.node_slope, values[self.index])  # h times the derivative
        out = np.zeros_like(values)
        np.add.at(out, self.index, each * t.weights[:, None])
        return out / self.root[:, None] ** 2


@dataclass(frozen=True, slots=True, eq=False)
class Monitor:
    """Where intervals are needed: a cell in which ``total`` rises by r has the local error r^(m+1).

    Attributes
    ----------
    degree : int
    ends, total : arrays (K+1,)
        Positions 0..1 and the monitor function's integral up to there.
    """

    degree: int
    ends: np.ndarray
    total: np.ndarray

    @classmethod
    def of(cls, ends: np.ndarray, last: np.ndarray, degree: int) -> Monitor:
        """Return the monitor of polynomials of degree m + 1 with the size (K,) of their last Legendre coefficient.

        De Boor's equidistribution (Ascher, Mattheij and Russell, Numerical Solution of Boundary Value Problems,
        section 9.1): the density of intervals follows the (m+1)th root of the (m+1)th derivative.
        """
        h = np.diff(ends)
        density = (table(degree + 1).shape * last) ** (1 / (degree + 1)) / h
        density = (np.roll(density, 1) + 2 * density + np.roll(density, -1)) / 4
        mean = float(density @ h) or 1e-300
        total = np.concatenate([[0.0], np.cumsum(np.maximum(density, _FLOOR * mean) * h)])
        return cls(degree, ends, total)

    @classmethod
    def of_samples(cls, samples: np.ndarray, degree: int) -> Monitor:
        """Return the monitor of equidistant samples (P, n) of one period, by divided differences of order m + 1."""
        step = degree + 1
        cells = len(samples) // step
        closed = np.concatenate([samples, samples[:1]])
        at = np.arange(cells)[:, None] * step + np.arange(step + 1)
        differences = np.diff(closed[at], n=step, axis=1)[:, 0]  # h^(m+1) derivative / (m+1)^(m+1)
        last = np.abs(differences).max(axis=1) * step**step / factorial(step) / comb(2 * step, step)
        ends = at[:, 0] / len(samples)
        return cls.of(np.append(ends, 1.0), last, degree)

    def count(self, goal: float) -> int:
        """Return how many intervals have local errors below a goal."""
        return int(min(np.ceil(self.total[-1] / goal ** (1 / (self.degree + 1))), 1e9))

    def worst(self, mesh: Mesh) -> float:
        """Return the largest local error on a mesh."""
        rise = np.diff(np.interp(mesh.ends, self.ends, self.total))
        return float(rise.max() ** (self.degree + 1))

    def mesh(self, count: int) -> Mesh:
        """Return the mesh of a number of intervals whose local errors are equal."""
        ends = np.interp(np.linspace(0, self.total[-1], count + 1), self.total, self.ends)
        ends[0], ends[-1] = 0.0, 1.0
        return Mesh.of(ends, self.degree)


class Meshes:
    """The meshes of one problem, named by their number of intervals, so that a vector's length names its mesh."""

    def __init__(self, degree: int, states: int, most: int) -> None:
        self.degree, self.states, self.most = degree, states, most
        self._by_count: dict[int, Mesh] = {}
        self._halved: dict[int, Mesh] = {}

    def __iter__(self) -> Iterator[Mesh]:
        return iter([self._by_count[k] for k in sorted(self._by_count)])

    def of(self, u: np.ndarray) -> Mesh:
        """Return the mesh of an unknown or a tangent; a length that no mesh of the problem has raises ValueError."""
        count, rest = divmod(len(u), self.degree * self.states)
        if rest or count not in self._by_count:
            known = [len(m.root) * self.states for m in self]
            raise ValueError(f"no mesh of this problem has unknowns of length {len(u)}; expected one of {known}")
        return self._by_count[count]

    def uniform(self, count: int) -> Mesh:
        """Return the first mesh of a number of intervals: equal ones unless there is one."""
        return self._by_count.setdefault(count, Mesh.uniform(count, self.degree))

    def adopted(self, mesh: Mesh) -> Mesh:
        """Return a mesh as the first one of its number of intervals."""
        return self._by_count.setdefault(mesh.count, mesh)

    def equidistributed(self, monitor: Monitor, wanted: int) -> Mesh | None:
        """Return a new mesh of the wanted number of intervals or the next free one; None at the limit."""
        count = self._free(wanted)
        if count is None:
            return None
        self._by_count[count] = monitor.mesh(count)
        return self._by_count[count]

    def halved(self, mesh: Mesh) -> Mesh | None:
        """Return the mesh of halved intervals (a few more where that number is taken); None at the limit."""
        if mesh.count not in self._halved:
            count = self._free(2 * mesh.count)
            if count is None:
                return None
            ends = np.interp(np.linspace(0, mesh.count, count + 1), np.arange(mesh.count + 1), mesh.ends)
            self._by_count[count] = self._halved[mesh.count] = Mesh.of(ends, self.degree)
        return self._halved[mesh.count]

    def _free(self, wanted: int) -> int | None:
        return next((k for k in range(max(wanted, 2), self.most + 1) if k not in self._by_count), None)
