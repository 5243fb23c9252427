"""Find every place where a multiplier may cross the unit circle between accepted points, pairs included.

Three functions of the monodromy matrix, smooth along the branch also where multipliers collide, vanish there:
``det(I - M)`` (fold, branch point), ``det(I + M)`` (period-doubling), ``prod_{i<j} (1 - mu_i mu_j)`` (Neimark-Sacker).
Their zeros are isolated on the interpolated branch, with true points inserted (module ``bracketing``).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.bracketing import Points, Samples, Search, Suspect, isolate
from continuation.branches.curve import Segment
from continuation.branches.newton import Metric, Node
from continuation.errors import IntegrationFailed, NoConvergence

__all__ = ["Suspect", "screen", "tests"]

_FIRST = np.linspace(0.0, 1.0, 5)
_NEUTRAL = 1e-8  # |1 - mu_i mu_j| that is rounding


def tests(matrices: np.ndarray) -> np.ndarray:
    """Return the three test functions (N, 3) of monodromy matrices (N, n, n); NaN where a matrix is not finite."""
    out = np.full((len(matrices), 3), np.nan)
    finite = np.isfinite(matrices).all(axis=(1, 2))
    mu = np.linalg.eigvals(matrices[finite])
    i, j = np.triu_indices(matrices.shape[-1], 1)
    with np.errstate(over="ignore", invalid="ignore"):  # multipliers of 1e150 and more
        torus = np.prod(1 - mu[:, i] * mu[:, j], axis=1).real if i.size else np.ones(len(mu))
        out[finite] = np.stack([np.prod(1 - mu, axis=1).real, np.prod(1 + mu, axis=1).real, torus], axis=1)
    out[~np.isfinite(out)] = np.nan
    return out


def screen(problem: Any, nodes: list[Node], metric: Metric) -> tuple[list[Node], list[Suspect], list[str]]:
    """Return the nodes with inserted ones, the isolated sign changes in order, and notes on what stayed unresolved."""
    notes: list[str] = []
    matrices = _matrices(problem, [(n.u, n.p) for n in nodes])
    neutral = _neutral(matrices)
    if neutral:
        notes.append("the model has no damping: torus points are not looked for, products of multipliers are always 1")

    def evaluate(points: Points) -> np.ndarray:
        return _values(_matrices(problem, points), neutral)

    segments = [Segment(problem, metric, a, b) for a, b in pairwise(nodes)]
    flat = {id(n) for s in segments if s.vertical for n in (s.a, s.b)}  # of one matrix, with a multiplier 1
    search = Search(problem, metric, evaluate, _FIRST, _unresolved, _missing, lambda s: _masked(s, flat))

    def skip(segment: Segment) -> bool:
        if segment.vertical:
            flat.update(id(n) for n in (segment.a, segment.b))
        return segment.vertical

    chain, suspects, found = isolate(search, nodes, _values(matrices, neutral), skip)
    return chain, suspects, notes + found


def _matrices(problem: Any, points: Points) -> np.ndarray:
    """Return monodromy matrices (N, n, n) of points, NaN where the integration fails or an interpolation misleads."""
    try:
        return np.asarray(problem.monodromies(points))
    except (IntegrationFailed, NoConvergence, np.linalg.LinAlgError):
        if len(points) == 1:
            return np.full((1, 1, 1), np.nan)
    parts = [_matrices(problem, [point])[0] for point in points]
    n = max(len(m) for m in parts)
    return np.array([m if len(m) == n else np.full((n, n), np.nan) for m in parts])


def _values(matrices: np.ndarray, neutral: bool) -> np.ndarray:
    values = tests(matrices)
    if neutral:
        values[np.isfinite(values[:, 2]), 2] = 1.0
    return values


def _neutral(matrices: np.ndarray) -> bool:
    """Tell whether multipliers come in pairs mu, 1/mu all along, as without damping."""
    finite = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    mu = np.linalg.eigvals(finite)
    i, j = np.triu_indices(mu.shape[1], 1)
    if not (i.size and len(finite)):
        return False
    return bool(np.median(np.abs(1 - mu[:, i] * mu[:, j]).min(axis=1)) < _NEUTRAL)


def _masked(s: Samples, flat: set[int]) -> Samples:
    """Take det(I - M) from the far end of a segment that leaves a vertical piece, where it is noise about 0.

    The branch has a corner inside, which no interpolation shows; whether it turns back is told by its tangents.
    """
    ends = [id(n) in flat for n in (s.segment.a, s.segment.b)]
    if any(ends):
        s.value[:, 0] = s.value[-1 if ends[0] else 0, 0]
    return s


def _missing(s: Samples) -> list[str]:
    if np.all(np.isfinite(s.value)):
        return []
    return [f"{s.segment}: the monodromy matrix is not finite, special points may be missing"]


def _unresolved(segment: Segment) -> str:
    return f"{segment}: a multiplier touches the unit circle closer than could be decided"
