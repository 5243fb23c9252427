"""Rational approximation of functions of frequency from exact values, with an error measured at fresh frequencies.

Barycentric form with nodes x_j, values f_j and weights w_j,

    r(x) = sum_j w_j f_j / (x - x_j)  /  sum_j w_j / (x - x_j),

weights from the least-squares problem of the AAA algorithm, nodes added where the misfit is largest (Nakatsukasa, Sete,
Trefethen, SIAM J. Sci. Comput. 40, 2018; Driscoll, Nakatsukasa, Trefethen, SIAM J. Sci. Comput. 46, 2024, for test
points that move with the nodes).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

_TESTS = np.array([0.25, 0.5, 0.75])  # places between neighbouring nodes that the weights are fitted to
_FRESH = 0.381966011250105  # place that decides, not fitted to
_FIRST = 17
_FLOOR = 1e-4  # of the norm of all entries: below it an entry is held to this share of the norm
_NEAR = 1e-8  # of the gap between nodes: a derivative this close to a node is the one at the node
_TINY = 1e-30  # instead of a diagonal entry 0
SAFETY = 10.0  # between the largest misfit that was seen and the stated error

Values = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, slots=True)
class Rational:
    """Rational functions of a real variable with common poles.

    Attributes
    ----------
    nodes : array (r,)
    values : complex array (r, e), of the e functions
    weights : complex array (r,)
    low, high : float
        Range of the variable that it holds for.
    error : float
        Stated error, relative to :func:`scale`: ``SAFETY`` times the largest misfit at the test frequencies.
    """

    nodes: np.ndarray
    values: np.ndarray
    weights: np.ndarray
    low: float
    high: float
    error: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the functions (K, e) at x (K,); cost O(K r)."""
        return _barycentric(x, self.nodes, self.values, self.weights)[0]

    def terms(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the functions (K, e) at x (K,), the terms w_j / (x - x_j) (K, r) and their sums (K,)."""
        return _barycentric(x, self.nodes, self.values, self.weights)

    def derivative(self, x: np.ndarray, terms: tuple[np.ndarray, ...] | None = None) -> np.ndarray:
        """Return their derivatives (K, e) at x (K,) (Schneider and Werner, Math. Comp. 47, 1986).

        ``terms`` are those at the same x where they are known; they save half of the work.
        """
        if terms is not None:
            value, cauchy, below = terms
            off = x[:, None] - self.nodes
            if np.abs(off).min(initial=np.inf) > _NEAR * np.diff(self.nodes).max(initial=0.0):
                steeper = cauchy / off
                slope = value * steeper.sum(axis=1)[:, None] - steeper @ self.values
                return np.asarray(slope / below[:, None])
        off = x[:, None] - self.nodes
        nearest = np.abs(off).argmin(axis=1)
        gaps = np.diff(self.nodes)
        gap = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))[nearest]
        rows = np.flatnonzero(np.abs(off[np.arange(len(x)), nearest]) < _NEAR * gap)
        off[rows] = self.nodes[nearest[rows], None] - self.nodes  # there the derivative at the node is taken
        off[rows, nearest[rows]] = 1.0
        cauchy = self.weights / off
        cauchy[rows, nearest[rows]] = 0.0
        value, below = cauchy @ self.values, cauchy.sum(axis=1)
        below[rows] = -self.weights[nearest[rows]]
        value /= below[:, None]
        value[rows] = self.values[nearest[rows]]
        steeper = cauchy / off
        steeper[rows] = cauchy[rows]
        return (value * steeper.sum(axis=1)[:, None] - steeper @ self.values) / below[:, None]


def scale(values: np.ndarray) -> np.ndarray:
    """Return what errors of functions (K, e) are relative to, entry by entry."""
    size = np.abs(values)
    return np.maximum(size, _FLOOR * np.linalg.norm(size, axis=1, keepdims=True))


def fit(exact: Values, low: float, high: float, goal: float, most: int) -> Rational:
    """Return a rational approximation on [low, high], of at most about ``most`` nodes, whatever its error is then.

    Parameters
    ----------
    exact : callable
        Values (K, e) at x (K,); the cost is about 5 of them per node.
    goal : float
        Wanted relative misfit.

    Examples
    --------
    >>> r = fit(lambda x: 1 / (1 + 0.1j * x[:, None] - x[:, None] ** 2), 0.1, 10.0, 1e-12, 50)
    >>> len(r.nodes) < 20, r.error < 1e-10, abs(complex(r(np.array([1.0]))[0, 0]) + 10j) < 1e-9
    (True, True, True)
    """
    found: dict[float, np.ndarray] = {}

    def values(x: np.ndarray) -> np.ndarray:
        missing = np.array([a for a in x.tolist() if a not in found])
        if missing.size:
            found.update(zip(missing.tolist(), exact(missing), strict=True))
        return np.array([found[a] for a in x.tolist()])

    nodes = np.geomspace(low, high, _FIRST)
    while True:
        gaps = np.diff(nodes)
        tests = nodes[:-1, None] + gaps[:, None] * _TESTS
        fresh = nodes[:-1] + gaps * _FRESH
        f, wanted = values(nodes), values(tests.ravel())
        weights = _weights(nodes, f, tests.ravel(), wanted)
        misfit = _misfit(nodes, f, weights, tests.ravel(), wanted).reshape(tests.shape)
        worst = float(misfit.max())
        if worst <= goal or len(nodes) >= most:
            unseen = _misfit(nodes, f, weights, fresh, values(fresh))
            worst = max(worst, float(unseen.max()))
            if worst <= goal or len(nodes) >= most:
                return Rational(nodes, f, weights, low, high, SAFETY * worst)
            tests, misfit = np.column_stack([tests, fresh]), np.column_stack([misfit, unseen])
        largest = misfit.max(axis=1)
        chosen = np.flatnonzero(largest > 0.3 * goal)
        chosen = chosen[np.argsort(-largest[chosen])][: max(most - len(nodes), 1)]
        nodes = np.sort(np.append(nodes, tests[chosen, misfit[chosen].argmax(axis=1)]))


def _barycentric(
    x: np.ndarray, nodes: np.ndarray, values: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return values (K, e), the terms w_j / (x - x_j) (K, r) and their sums (K,); at a node its value is taken."""
    off = x[:, None] - nodes
    rows, hits = np.nonzero(off == 0)
    off[rows, hits] = 1.0
    cauchy = weights / off
    below = cauchy.sum(axis=1)
    out = (cauchy @ values) / below[:, None]
    out[rows] = values[hits]
    return out, cauchy, below


def _misfit(nodes: np.ndarray, f: np.ndarray, weights: np.ndarray, x: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the largest relative error (K,) of the entries at x (K,)."""
    return np.asarray((np.abs(_barycentric(x, nodes, f, weights)[0] - wanted) / scale(wanted)).max(axis=1))


def _weights(nodes: np.ndarray, f: np.ndarray, x: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the unit vector that the Loewner matrix of relative divided differences shrinks most."""
    differences = (wanted[:, :, None] - f.T) / scale(wanted)[:, :, None] / (x[:, None] - nodes)[:, None, :]
    differences = differences.reshape(-1, len(nodes))
    unit = np.linalg.norm(differences, axis=0)
    differences /= unit
    upper = sl.qr(differences, mode="r", overwrite_a=True, check_finite=False)[0][: len(nodes)]
    diagonal = np.diag(upper)
    upper[np.diag_indices(len(nodes))] = np.where(np.abs(diagonal) < _TINY, _TINY, diagonal)
    w = np.ones(len(nodes), dtype=complex)
    for _ in range(3):  # inverse iteration
        w = sl.solve_triangular(upper, sl.solve_triangular(upper, w, trans="C", check_finite=False), check_finite=False)
        w /= np.linalg.norm(w)
    return w / unit
