"""Look for branches that no continuation from the known ones reaches: isolas and detached resonances."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from continuation.branches.analysis import analyse
from continuation.branches.arclength import Limits, Progress, check_span, start_node, walk
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.deflation import deflated
from continuation.branches.extended import extended, solve_point
from continuation.branches.newton import Metric, Node, size_of
from continuation.branches.recognition import Library, between
from continuation.branches.tracking import track
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit

_SAME = 1e-6  # of the span, distance of two folds that may be one
_FACTORS = (0.03, 30.0)  # by which harmonics of known orbits are scaled for a start
_TRUST = 0.3  # relative waveform error above which a solution is an artefact of the discretisation


@dataclass(frozen=True, slots=True, eq=False)
class IsolaSearch:
    """What a search for further branches found, and how hard it looked.

    Attributes
    ----------
    branches : tuple of Branch
        Branches found that are none of the given ones nor mirror images of them: closed curves (isolas), or such as
        leave the span.
    isolas : tuple of Branch
        The closed curves among them.
    extrema : tuple of (float, float)
        Parameters (p, q) at which a tracked fold curve turns back in the second parameter: there an isola is born, or
        merges with another branch.
    slices : tuple of float
        Parameter values at which scattered starts were made, all of them.
    starts : int
        Number of starts in all.
    notes : tuple of str
        What could not be done, and why.
    """

    branches: tuple[Branch, ...]
    extrema: tuple[tuple[float, float], ...]
    slices: tuple[float, ...]
    starts: int
    notes: tuple[str, ...]

    @property
    def isolas(self) -> tuple[Branch, ...]:
        """Return the closed curves among the branches found."""
        return tuple(b for b in self.branches if b.stop.startswith("closed"))

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary."""
        return {
            "schema": 1,
            "branches": [b.to_dict() | {"closed": b.stop.startswith("closed")} for b in self.branches],
            "extrema": [list(e) for e in self.extrema],
            "slices": list(self.slices),
            "starts": self.starts,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        found = len(self.branches)
        head = (
            f"{len(self.isolas)} isolas and {found - len(self.isolas)} other branches found" if found else "none found"
        )
        lines = [f"Search for isolas: {head}, {self.starts} starts at {len(self.slices)} parameter values"]
        lines += [line for b in self.branches for line in str(b).split("\n")]
        lines += [
            f"  a fold curve turns back at ({p:.8g}, {q:.8g}): an isola is born or merges there"
            for p, q in self.extrema
        ]
        if not found:
            lines.append("  this search proves nothing about what it did not meet")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])


def find_isolas(
    problem: Any,
    branches: Sequence[Branch],
    span: tuple[float, float],
    *,
    slices: int | Sequence[float] = 5,
    starts: int = 8,
    second: Mapping[str, tuple[float, float]] | None = None,
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 2000,
    seed: int = 0,
    progress: Progress | None = None,
) -> IsolaSearch:
    """Look for branches detached from the known ones.

    Two ways. At parameter slices, Newton's method with all known orbits deflated is started from known orbits whose
    harmonics are scaled at random, 0.03 to 30 times. And folds of the known branches are followed in a second
    parameter, through its extremum, back to its value here: the fold met there lies on another branch.

    Parameters
    ----------
    problem : Problem
        What the branches were traced with.
    branches : sequence of Branch
        The known branches of the problem's period.
    span : (float, float)
        Parameter range of slices and branches.
    slices : int or sequence of float
        Number of equidistant values inside the span, to which those of the largest amplitude of every branch are added;
        or the values. An isola that no value meets is not found by a start.
    starts : int
        Starts per slice and known orbit.
    second : mapping, optional
        Range of one further parameter, e.g. ``{"g": (0.1, 0.4)}``, which contains its value: folds are followed there.
    step, max_step, max_points
        As for :func:`~continuation.trace`.
    seed : int
        Of the random scaling; the same seed gives the same result.

    Returns
    -------
    IsolaSearch
        None found does not prove that none exists.

    Raises
    ------
    ValueError
        For no branches, or a span, slices or starts out of range.

    Notes
    -----
    Habib, Cirillo and Kerschen, Nonlinear Dynamics 92 (2018) 1-16, on detached resonances and the singularity that
    fold curves have where they are born.
    """
    if not branches:
        raise ValueError("find_isolas: give at least one branch, e.g. that of trace(problem, problem.guess(), span)")
    if starts < 0:
        raise ValueError(f"starts: expected a whole number >= 0, got {starts}")
    low, high = sorted(float(v) for v in span)
    values = _slices(branches, low, high, slices) if isinstance(slices, int) else np.asarray(slices, dtype=float)
    for value in values:
        check_span((low, high), float(value))
    search = _Search(problem, branches, (low, high), step, max_step, max_points)
    done: list[float] = []
    try:
        if second is not None:
            search.folds(second, progress)
        for i, value in enumerate(values):
            if progress is not None:
                progress(i / len(values), f"isolas: {problem.parameter} = {value:.4g}")
            search.slice(float(value), starts, np.random.default_rng([seed, i]))
            done.append(float(value))
    except KeyboardInterrupt:
        search.notes.append("interrupted; what was found up to there is kept")
    found = tuple(search.library.branches[len(branches) :])
    return IsolaSearch(found, tuple(search.extrema), tuple(done), search.starts, tuple(dict.fromkeys(search.notes)))


class _Search:
    """Branches known so far and what is tried to find more."""

    def __init__(
        self,
        problem: Any,
        branches: Sequence[Branch],
        span: tuple[float, float],
        step: float | None,
        max_step: float | None,
        max_points: int,
    ) -> None:
        self.problem, self.limits = problem, Limits.of(span, step, max_step, max_points)
        self.library = Library(problem.system.autonomous)
        for branch in branches:
            self.library.add(branch)
        self.known = tuple(branches)
        self.extrema: list[tuple[float, float]] = []
        self.notes: list[str] = []
        self.starts = 0

    # ---------------------------------------------------------------- folds
    def folds(self, second: Mapping[str, tuple[float, float]], progress: Progress | None) -> None:
        """Follow the folds of the known branches in a second parameter, back to its value here."""
        passed: list[tuple[np.ndarray, float]] = []
        for fold in [q for b in self.known for q in b.special_points if q.kind == "fold"]:
            if any(self._is(fold, u, p) for u, p in passed):
                continue  # on a curve followed already
            try:
                passed += self._fold(fold, second, progress)
            except (ContinuationError, ValueError) as reason:
                self.notes.append(f"fold at {fold.parameter:.8g} was not followed: {reason}")

    def _is(self, fold: SpecialPoint, u: np.ndarray, p: float) -> bool:
        """Tell whether a located fold and a corrected one are the same."""
        if abs(fold.parameter - p) > _SAME * (self.limits.span[1] - self.limits.span[0]) + 2 * fold.error:
            return False
        known = self.problem.lengthen(self.problem.unknown(fold.orbit), u)
        return float(np.linalg.norm(known - u)) < np.sqrt(_SAME) * size_of(u)

    def _fold(
        self, fold: SpecialPoint, second: Mapping[str, tuple[float, float]], progress: Progress | None
    ) -> list[tuple[np.ndarray, float]]:
        """Follow one fold; return the folds (u, p) met at the present value of the second parameter."""
        problem, name = self.problem, next(iter(second))
        curve = track(fold, parameters=(problem.parameter, name), span=second, progress=progress)
        q = curve.values[:, 1]
        self.extrema += [e for e in (s.parameters for s in curve.points if s.kind == "extremum") if not self._has(e)]
        here, met = problem.values[name], []
        for i in np.flatnonzero((q[:-1] - here) * (q[1:] - here) < 0):
            t = float((here - q[i]) / (q[i + 1] - q[i]))
            p = float((1 - t) * curve.values[i, 0] + t * curve.values[i + 1, 0])
            u = problem.unknown(between(curve.orbits[i], curve.orbits[i + 1], t))
            system = extended(problem, "fold", u, p)
            u, p, _ = system.split(solve_point(system, system.join(u, p)).u)
            met.append((u, p))
            known = [s for b in self.library.branches for s in b.special_points if s.kind == "fold"]
            if not any(self._is(s, u, p) for s in known):
                self.try_start(u, p)
        return met

    def _has(self, extremum: tuple[float, float]) -> bool:
        return any(np.allclose(extremum, e, rtol=1e-3) for e in self.extrema)

    # ---------------------------------------------------------------- slices
    def slice(self, p: float, starts: int, rng: np.random.Generator) -> None:
        """Look for further orbits at one parameter value."""
        problem = self.problem
        orbits = [o for b in self.library.branches for o in self._at(b, p)]
        if not orbits:
            self.notes.append(f"no known orbit at {problem.parameter} = {p:.6g}: no starts there")
            return
        count = starts * len(orbits)
        poles = [problem.unknown(o) for o in orbits]
        for k in range(count):
            self.starts += 1
            guess = _scattered(orbits[k % len(orbits)], rng)
            try:
                u = deflated(problem, problem.unknown(guess), p, poles)
            except (ContinuationError, ValueError):
                continue  # most starts lead nowhere
            if self.try_start(u, p):
                orbits = [o for b in self.library.branches for o in self._at(b, p)]
                poles = [problem.unknown(o) for o in orbits]
            else:
                poles.append(u)

    def _at(self, branch: Branch, p: float) -> list[Orbit]:
        """Return the orbits of a branch at a parameter value."""
        at, out = branch.parameter, []
        for i in np.flatnonzero((at[:-1] - p) * (at[1:] - p) <= 0):
            near = branch.orbits[i if abs(at[i] - p) < abs(at[i + 1] - p) else i + 1]
            try:
                out.append(self.problem.solve(near, p))
            except ContinuationError as reason:
                self.notes.append(f"the known orbit near {p:.6g} could not be computed: {reason}")
        return out

    def try_start(self, u: np.ndarray, p: float) -> bool:
        """Trace the branch through an orbit unless it is known; tell whether it was new."""
        problem, began = self.problem, time.perf_counter()
        metric = Metric(size_of(u), self.limits.span[1] - self.limits.span[0])
        own = getattr(problem, "ended", None)
        met: list[str] = []

        def ended(before: Node, new: Node) -> str | None:
            if self.library.find(problem, new) is not None:  # at a fold itself it may not be recognised, but soon after
                met.append("known")
                return met[-1]
            return own(before, new) if own is not None else None

        try:
            first = start_node(problem, u, p, metric)
            start, end = self.limits.span
            if not (first.error < _TRUST * size_of(first.u) and start < first.p < end) or ended(first, first):
                return False
            nodes, stop = walk(problem, first, (start, end), self.limits, metric, None, ended)
            if met:
                return False
            branch = analyse(problem, nodes, metric, stop, began, None)
        except ContinuationError as reason:
            self.notes.append(f"an orbit near {problem.parameter} = {p:.6g} could not be followed: {reason}")
            return False
        self.library.add(branch)
        if "interrupted" in branch.stop:  # Ctrl-C while it was followed ends the search, too
            raise KeyboardInterrupt
        return True


def _slices(branches: Sequence[Branch], low: float, high: float, count: int) -> np.ndarray:
    """Return equidistant values, and where branches have their largest amplitude, in order."""
    values = list(np.linspace(low, high, count + 2)[1:-1])
    for branch in branches:
        size = [float(np.sum(np.abs(o.coefficients[1:]) ** 2)) for o in branch.orbits]
        values.append(float(branch.parameter[int(np.argmax(size))]))
    apart = (high - low) / (20 * (count + 1))
    out: list[float] = []
    for value in sorted(values):
        if low < value < high and (not out or value - out[-1] > apart):
            out.append(float(value))
    return np.array(out)


def _scattered(orbit: Orbit, rng: np.random.Generator) -> Orbit:
    """Return a start: the moving part of an orbit scaled and shifted as a whole, so that rates fit displacements."""
    low, high = np.log(_FACTORS)
    factor = np.exp(rng.uniform(low, high) + 1j * rng.uniform(0, 2 * np.pi))
    c = np.array(orbit.coefficients)
    order = np.arange(len(c))[:, None]
    c[1:] = c[1:] * np.abs(factor) * np.exp(1j * np.angle(factor) * order[1:])
    keep = rng.integers(1, max(len(c), 2)) if len(c) > 2 else 1
    c[keep + 1 :] = 0  # a smoother wave, sometimes
    return replace(orbit, coefficients=c)
