"""Global search: a low-discrepancy start, then differential evolution; the same seed gives the same search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import qmc

from sbg_casadi.identification.scoring import Score

Progress = Callable[[float, str], None]
Evaluate = Callable[[np.ndarray, float], Score]

_LEADERS = 0.2  # of the population, towards one of which a trial is drawn


@dataclass(slots=True)
class Archive:
    """Keep all candidates that were scored, in order.

    Attributes
    ----------
    coordinates : list of ndarray (n,)
    scores : list of Score
    """

    coordinates: list[np.ndarray] = field(default_factory=list)
    scores: list[Score] = field(default_factory=list)

    def add(self, t: np.ndarray, found: Score) -> float:
        """Add a candidate and return its cost."""
        self.coordinates.append(t.copy())
        self.scores.append(found)
        return found.cost

    def __len__(self) -> int:
        return len(self.scores)

    def order(self) -> np.ndarray:
        """Return the indices from the best candidate on; equal ones in the order in which they came."""
        return np.argsort([s.cost for s in self.scores], kind="stable")

    def best(self, count: int, apart: float = 0.05) -> list[int]:
        """Return indices of the best candidates that differ by ``apart`` in a coordinate from each other."""
        chosen: list[int] = []
        for i in self.order().tolist() if count > 0 else ():
            if all(np.abs(self.coordinates[i] - self.coordinates[j]).max() > apart for j in chosen):
                chosen.append(i)
            if len(chosen) == count:
                break
        return chosen


def search(
    evaluate: Evaluate,
    dimension: int,
    *,
    evaluations: int,
    seed: int,
    start: Sequence[np.ndarray] = (),
    near: float | None = None,
    enough: float = 0.0,
    progress: Progress | None = None,
    archive: Archive | None = None,
) -> Archive:
    """Look for the least cost in the unit cube.

    Parameters
    ----------
    evaluate : callable
        Coordinates (n,) and a cost from which the rest need not be computed -> Score.
    dimension : int
        n.
    evaluations : int
        Number of candidates.
    seed : int
        Of the Sobol points and of the evolution.
    start : sequence of ndarray (n,)
        Candidates that come first.
    near : float, optional
        Begin with points within this distance of the first start in every coordinate, not with the whole cube.
    enough : float
        Cost at which the search ends early.
    progress : callable, optional
        Told the fraction done and a line of text.
    archive : Archive, optional
        Filled as the search goes on, so that an interrupted one leaves what it has.

    Notes
    -----
    A fifth of the candidates are Sobol points (Joe and Kuo directions, scrambled by the seed). The best of them are the
    population of differential evolution (current-to-pbest/1/bin; Zhang and Sanderson, IEEE Transactions on Evolutionary
    Computation 13 (2009) 945-958), with a random scale and crossover rate for every trial. A coordinate that leaves
    the cube comes half-way between the bound and where it was.

    Examples
    --------
    >>> from sbg_casadi.identification.scoring import Score
    >>> def bowl(t, limit): return Score(t - 0.3, float(((t - 0.3) ** 2).sum()), ())
    >>> found = search(bowl, 2, evaluations=400, seed=1)
    >>> bool(np.abs(found.coordinates[found.best(1)[0]] - 0.3).max() < 0.01)
    True
    """
    found = Archive() if archive is None else archive
    first = max(8, evaluations // 5)
    points = qmc.Sobol(dimension, seed=np.random.default_rng(seed)).random(1 << (first - 1).bit_length())[:first]
    if near is not None and len(start):
        points = np.clip(start[0] + near * (2 * points - 1), 0.0, 1.0)
    rng = np.random.default_rng((seed, 1))

    def tell() -> None:
        if progress and len(found):
            best = min(s.cost for s in found.scores)
            progress(len(found) / evaluations, f"{len(found)} of {evaluations} candidates, least cost {best:.3g}")

    size = max(12, min(2 * dimension, 24))
    for t in [*(np.clip(s, 0.0, 1.0) for s in start), *points]:
        known = sorted(s.cost for s in found.scores)
        limit = known[size - 1] if len(known) >= size else np.inf
        if len(found) >= evaluations or (found.add(t, evaluate(t, limit)) <= enough):
            return found
        tell()
    size = min(len(found), size)
    order = found.order()[:size]
    population = np.array([found.coordinates[i] for i in order])
    costs = np.array([found.scores[i].cost for i in order])
    while True:
        for i in range(size):
            if len(found) >= evaluations:
                return found
            trial = _trial(rng, population, costs, i)
            value = found.add(trial, evaluate(trial, float(costs[i])))
            tell()
            if value <= costs[i]:
                population[i], costs[i] = trial, value
            if value <= enough:
                return found


def _trial(rng: np.random.Generator, population: np.ndarray, costs: np.ndarray, i: int) -> np.ndarray:
    size, n = population.shape
    leaders = np.argsort(costs, kind="stable")[: max(2, int(_LEADERS * size))]
    a, b = rng.choice(size, 2, replace=False)
    scale, rate = rng.uniform(0.3, 0.9), rng.uniform(0.5, 1.0)
    own = population[i]
    moved = own + scale * (population[rng.choice(leaders)] - own) + scale * (population[a] - population[b])
    taken = np.asarray(rng.random(n) < rate)
    taken[rng.integers(n)] = True
    out = np.where(taken, moved, own)
    return np.where(out < 0, own / 2, np.where(out > 1, (1 + own) / 2, out))
