"""Basins of attraction: which attractor the states of a grid or of a random sample go to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from continuation.errors import ContinuationError, nearest
from continuation.model.system import System
from continuation.timedomain.basins_result import Attractor, Basins
from continuation.timedomain.lyapunov import standard_error
from continuation.timedomain.period_map import Integrator, PeriodMap, period_map
from continuation.timedomain.plain_system import PlainSystem
from continuation.timedomain.recognition import UNKNOWN as UNRECOGNISED
from continuation.timedomain.recognition import Witness
from continuation.timedomain.settling import Settling
from continuation.timedomain.sweep import Progress
from continuation.timedomain.sweep_result import period_verdict

_FIRST = 48  # states that look for attractors before the rest is matched against those
_BLOCK = 64  # states that go to a worker together
_STRETCH = 48  # periods between two looks
_NEAR = 1e-3  # distance from a cycle, over the scale, at which a state that still comes closer belongs to it
_SAME_CYCLE = 1e-3
_SAME_MEANS = 0.1  # of the deviation, with 4 standard errors: features of an attractor that does not repeat
_FEATURES = 256  # periods that features are taken from

UNKNOWN, LOST = -1, -2
"""Labels of states whose attractor was not found within the limit, and of states that leave the finite numbers."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Take the centres of the cells of a grid.

    Parameters
    ----------
    counts : tuple of int
        Cells along each chosen coordinate.
    """

    counts: tuple[int, ...]

    def states(self, limits: np.ndarray) -> np.ndarray:
        """Return points (k, axes), the last coordinate running fastest."""
        if len(self.counts) != len(limits) or min(self.counts) < 1:
            raise ValueError(f"Grid: expected {len(limits)} positive counts, got {self.counts}")
        lines = [
            low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(limits, self.counts, strict=True)
        ]
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(limits))


@dataclass(frozen=True, slots=True)
class Random:
    """Take uniformly distributed random states.

    Parameters
    ----------
    count : int
    seed : int
        The same seed gives the same states.
    """

    count: int
    seed: int = 0

    def states(self, limits: np.ndarray) -> np.ndarray:
        """Return points (k, axes)."""
        if self.count < 1:
            raise ValueError(f"Random: count must be positive, got {self.count}")
        return np.random.default_rng(self.seed).uniform(limits[:, 0], limits[:, 1], (self.count, len(limits)))


def basins(
    system: System,
    axes: Mapping[str, tuple[float, float]],
    states: Grid | Random,
    *,
    start: Sequence[float] | np.ndarray | None = None,
    integrator: Integrator | None = None,
    transient: int = 32,
    limit: int = 1000,
    workers: int = 2,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **parameters: float,
) -> Basins:
    """Find the attractors at one parameter set and the share of states that go to each.

    Parameters
    ----------
    axes : mapping of str to (float, float)
        Coordinates that vary, and their limits.
    states : Grid or Random
        Which states at phase 0 to start from.
    start : array (n,), optional
        The other coordinates; zeros when absent.
    integrator : FixedStep, CVODES or EventExact, optional
        When absent, fixed steps of order 4, as many as the System needs.
    transient, limit : int
        Excitation periods per state at least before a verdict of its own, and about at most.
    workers : int
        Threads; fixed steps in machine code run side by side in them.
    executor : concurrent.futures.Executor, optional
        Instead of the threads. The result depends on neither.
    progress : callable, optional
        Called with the number of states done and of all states.
    **parameters : float
        Values of parameters; the others keep the System's defaults.

    Returns
    -------
    Basins

    Raises
    ------
    ValueError
        If a name is unknown, or limits or counts do not fit.
    UnsupportedModel
        If the System is autonomous.

    Notes
    -----
    The first 48 states in an order drawn at random (always the same) settle on their own and make the list of
    attractors; the others are followed until they are within 1e-3 of a cycle on that list and still come closer, and
    settle on their own where that does not happen. Attractors that do not repeat are matched by mean and mean square of
    all coordinates over 256 periods, within a tenth of the deviation and four standard errors. Where a state wanders
    long before it settles, boundaries are fractal: the label of a single state then changes with the integrator and
    its tolerance, and only the shares mean something.
    An attractor with a share below 1 in 48 may be found late, but is not missed when a
    state of the sample goes to it. Cost: 48 to 150 periods per state.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> wells = System(name="wells", states={"x": x, "v": v}, derivatives={"x": v, "v": x - x**3 - 0.5*v}, phase=theta,
    ...                frequency="omega", parameters={"omega": (omega, 1.0)})
    >>> found = basins(wells, {"x": (-1.5, 1.5), "v": (-0.1, 0.1)}, Grid((10, 2)))
    >>> found.fractions.tolist(), sorted(round(float(a.points[0, 0]), 6) for a in found.attractors)
    ([0.5, 0.5], [-1.0, 1.0])
    """
    plain = PlainSystem.of(system)
    limits = _limits(system, axes)
    base = np.zeros(len(system.state_names)) if start is None else np.array(start, dtype=float)
    if base.shape != (len(system.state_names),) or workers < 1:
        raise ValueError(f"basins: expected {len(system.state_names)} states to start from and 1 or more workers")
    points = states.states(limits)
    columns = [system.state_names.index(name) for name in axes]
    begin = np.tile(base, (len(points), 1))
    begin[:, columns] = points
    p = tuple(system.parameter_vector(parameters).tolist())
    follower = _Follower(plain, p, integrator, transient, limit)
    order = np.random.default_rng(len(points)).permutation(len(points))
    labels = np.full(len(points), UNKNOWN)
    attractors: list[Attractor] = []
    done = 0
    for i in order[:_FIRST]:
        labels[i] = follower.add(begin[i], attractors)
        done += 1
        if progress:
            progress(done, len(points))
    rest = order[_FIRST:]
    job = _Job(plain, p, integrator, transient, limit, tuple(attractors))
    for block, found in _match(job, begin, rest, workers, executor):
        labels[block] = found
        done += len(block)
        if progress:
            progress(done, len(points))
    for i in rest[labels[rest] == _OPEN]:  # in order: the list grows, whatever ran side by side before
        labels[i] = follower.add(begin[i], attractors)
    counts = states.counts if isinstance(states, Grid) else None
    return Basins.of(
        system, dict(zip(system.parameter_names, p, strict=True)), axes, points, counts, labels, attractors
    )


_OPEN = -3  # near none of the known attractors


def _limits(system: System, axes: Mapping[str, tuple[float, float]]) -> np.ndarray:
    for name, (low, high) in axes.items():
        if name not in system.state_names:
            raise ValueError(f"basins: unknown state {name!r}; {nearest(name, system.state_names)}")
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise ValueError(f"basins: limits of {name!r} must be finite and increase, got {low} and {high}")
    if not axes:
        raise ValueError("basins: expected at least one coordinate that varies")
    return np.array(list(axes.values()), dtype=float)


@dataclass(frozen=True, slots=True)
class _Job:
    """Carry what a worker needs, as plain data."""

    model: PlainSystem
    p: tuple[float, ...]
    integrator: Integrator | None
    transient: int
    limit: int
    attractors: tuple[Attractor, ...]

    def match(self, states: np.ndarray) -> np.ndarray:
        """Return the labels of states (k, n), _OPEN where no known attractor is met."""
        follower = _Follower(self.model, self.p, self.integrator, self.transient, self.limit)
        return np.array([follower.follow(x, self.attractors) for x in states])


def _run(job: _Job, states: np.ndarray) -> np.ndarray:
    return job.match(states)


def _match(
    job: _Job, begin: np.ndarray, rest: np.ndarray, workers: int, executor: Executor | None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield positions of states and their labels, block by block."""
    blocks = [rest[k : k + _BLOCK] for k in range(0, len(rest), _BLOCK)]
    if executor is not None:
        yield from zip(blocks, executor.map(_run, [job] * len(blocks), [begin[b] for b in blocks]), strict=True)
    elif workers == 1:
        yield from ((b, job.match(begin[b])) for b in blocks)
    else:
        with ThreadPoolExecutor(workers) as pool:
            yield from zip(blocks, pool.map(job.match, [begin[b] for b in blocks]), strict=True)


class _Follower:
    """Follow states to their attractors; built once per worker, for the map can't be shared."""

    def __init__(
        self, model: PlainSystem, p: tuple[float, ...], integrator: Integrator | None, transient: int, limit: int
    ) -> None:
        self.system, self.p = model.system(), np.array(p)
        self.map: PeriodMap = period_map(self.system, integrator, self.system.state_names)
        self.map.set(self.p)
        self.transient, self.limit = transient, limit
        self._witness: Witness | None = None

    def follow(self, x: np.ndarray, attractors: Sequence[Attractor]) -> int:
        """Return the attractor that a state comes close to within the limit, _OPEN for none, LOST where it fails."""
        cycles = [(k, a) for k, a in enumerate(attractors) if a.period]
        others = [(k, a) for k, a in enumerate(attractors) if not a.period]
        distances = np.full(len(cycles), np.inf)
        for _ in range(0, self.limit if cycles else 4 * self.transient, _STRETCH):
            try:
                strobe = self.map.strobe(x, _STRETCH)
            except ContinuationError:
                return LOST
            x = strobe[-1]
            now = np.array([a.distance(x) for _, a in cycles])
            hits = np.flatnonzero((now < _NEAR) & (now < distances))
            if len(hits):
                return cycles[int(hits[now[hits].argmin()])][0]
            distances = np.where(now < _NEAR, now, np.inf)
        try:
            found = self._describe(x, _FEATURES, 0, "", "") if others else None
        except ContinuationError:
            return LOST
        return next((k for k, a in others if found is not None and alike(found, a)), _OPEN)

    def add(self, x: np.ndarray, attractors: list[Attractor]) -> int:
        """Let a state settle on its own; return its attractor, which joins the list if it is new."""
        try:
            found = self._settle(x, attractors)
        except ContinuationError:
            return LOST
        if found is None:
            return UNKNOWN
        for k, known in enumerate(attractors):
            if found is known or same(found, known):
                return k
        attractors.append(found)
        return len(attractors) - 1

    def _settle(self, x: np.ndarray, known: Sequence[Attractor], *, again: bool = True) -> Attractor | None:
        settled = Settling(
            lambda state: self.map.ahead(state, 1)[0],
            tolerance=1e-7,
            floor=self.map.floor,
            transient=self.transient,
            limit=self.limit,
            recorded=1,
            ahead=self.map.ahead,
        ).run(x)
        if settled.period:
            return self._describe(settled.state, settled.period, settled.period, period_verdict(settled.period), "")
        candidate = self._describe(settled.state, _FEATURES, 0, "", "")
        for attractor in known:
            if not attractor.period and alike(candidate, attractor):
                return attractor
        if self._witness is None:
            self._witness = Witness(self.system)
        found, end = self._witness.look(settled.state, self.p)
        if found.verdict == UNRECOGNISED:
            return self._settle(end, known, again=False) if found.settles and again else None
        return replace(candidate, verdict=found.verdict, evidence=found.reason)

    def _describe(self, x: np.ndarray, count: int, period: int, verdict: str, evidence: str) -> Attractor:
        waves = self.map.ahead(x, count)
        numbers, strobe = self.map.describe(x, count, waves, bool(period))
        spread = np.zeros((waves.shape[2], 2))
        if not period:
            values = waves[:, :-1]
            for k, table in enumerate((values.mean(axis=1), (values**2).mean(axis=1))):
                spread[:, k] = [standard_error(column) for column in table.T]
        scale = abs(waves).max(axis=(0, 1)) + self.map.floor
        return Attractor(verdict, evidence, period, strobe[:count].copy(), scale, numbers, spread)


def same(a: Attractor, b: Attractor) -> bool:
    """Return whether two responses are one attractor: cycles point by point, others by verdict and features."""
    if a.period or b.period:
        return a.period == b.period and b.distance(a.points[0]) < _SAME_CYCLE
    return a.verdict == b.verdict and alike(a, b)


def alike(a: Attractor, b: Attractor) -> bool:
    """Return whether means and mean squares of two responses that do not repeat agree."""
    bounds = 4 * np.hypot(a.spread, b.spread)
    deviation = np.maximum(np.maximum(a.numbers[:, 0], b.numbers[:, 0]), 1e-3 * b.scale)
    means = abs(a.numbers[:, 1] - b.numbers[:, 1]) < _SAME_MEANS * deviation + bounds[:, 0]
    squares = abs((a.numbers[:, :2] ** 2 - b.numbers[:, :2] ** 2).sum(axis=1))
    return bool(np.all(means & (squares < 2 * _SAME_MEANS * deviation**2 + bounds[:, 1])))
