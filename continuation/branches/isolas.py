"""Look for branches that no continuation from the known ones reaches: isolas and detached resonances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from continuation.branches.arclength import Progress, check_span, start_node, trace
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.deflation import deflated
from continuation.branches.newton import Metric, Node, size_of
from continuation.branches.recognition import Library
from continuation.branches.tracking import Curve, track
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit

_FACTORS = (0.03, 30.0)  # by which harmonics of known orbits are scaled for a start
_TRUST = 0.3  # relative waveform error above which a solution is an artefact of the discretisation


@dataclass(frozen=True, slots=True, eq=False)
class IsolaSearch:
    """What a search for further branches found, and how hard it looked.

    Attributes
    ----------
    branches : tuple of Branch
        Branches found that are none of the given ones: closed curves (isolas), or such as leave the span.
    isolas : tuple of Branch
        The closed curves among them.
    extrema : tuple of (float, float)
        Parameters (p, q) at which a tracked fold curve turns back in the second parameter: there an isola is born, or
        merges with another branch.
    slices : tuple of float
        Parameter values at which scattered starts were made.
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
        head = f"{len(self.isolas)} isolas and {found - len(self.isolas)} other branches found" if found else "none found"
        lines = [f"Search for isolas: {head}, {self.starts} starts at {len(self.slices)} parameter values"]
        lines += [line for b in self.branches for line in str(b).split("\n")]
        lines += [f"  a fold curve turns back at ({p:.8g}, {q:.8g}): an isola is born or merges" for p, q in self.extrema]
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
    step, max_step : float, optional
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
    search = _Search(problem, branches, (low, high), step, max_step)
    try:
        if second is not None:
            search.folds(second, progress)
        for i, value in enumerate(values):
            if progress is not None:
                progress(i / len(values), f"isolas: {problem.parameter} = {value:.4g}")
            search.slice(float(value), starts, np.random.default_rng([seed, i]))
    except KeyboardInterrupt:
        search.notes.append("interrupted; what was found up to there is kept")
    found = tuple(search.library.branches[len(branches) :])
    done = tuple(float(v) for v in values)
    return IsolaSearch(found, tuple(search.extrema), done, search.starts, tuple(dict.fromkeys(search.notes)))


class _Search:
    """Branches known so far and what is tried to find more."""

    def __init__(
        self,
        problem: Any,
        branches: Sequence[Branch],
        span: tuple[float, float],
        step: float | None,
        max_step: float | None,
    ) -> None:
        self.problem, self.span, self.step, self.max_step = problem, span, step, max_step
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
        for fold in [q for b in self.known for q in b.special_points if q.kind == "fold"]:
            try:
                self._fold(fold, second, progress)
            except (ContinuationError, ValueError) as reason:
                self.notes.append(f"fold at {fold.parameter:.8g} was not followed: {reason}")

    def _fold(self, fold: SpecialPoint, second: Mapping[str, tuple[float, float]], progress: Progress | None) -> None:
        name = next(iter(second))
        curve = track(fold, parameters=(self.problem.parameter, name), span=second, progress=progress)
        q = curve.values[:, 1]
        for i in range(1, len(q) - 1):
            if (q[i] - q[i - 1]) * (q[i + 1] - q[i]) < 0:
                self._extremum(curve, i)
        here = self.problem.values[name]
        for i in np.flatnonzero((q[:-1] - here) * (q[1:] - here) < 0):
            orbit = curve.orbits[i if abs(q[i] - here) < abs(q[i + 1] - here) else i + 1]
            if self.span[0] <= orbit.parameters[self.problem.parameter] <= self.span[1]:
                self.try_start(self.problem.unknown(orbit), orbit.parameters[self.problem.parameter])

    def _extremum(self, curve: Curve, i: int) -> None:
        """Remember the extremum of the second parameter near a point of a fold curve, by a parabola, once."""
        values = curve.values[i - 1 : i + 2]
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(values, axis=0) / np.ptp(curve.values, axis=0), axis=1))])
        fit = np.polyfit(s, values, 2)
        top = -fit[1, 1] / (2 * fit[0, 1])
        p, q = (float(np.polyval(fit[:, k], top)) for k in (0, 1))
        scale = np.ptp(curve.values, axis=0)
        if all(abs(p - a) > 0.02 * scale[0] or abs(q - b) > 0.02 * scale[1] for a, b in self.extrema):
            self.extrema.append((p, q))

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
        problem = self.problem
        metric = Metric(size_of(u), self.span[1] - self.span[0])
        try:
            node = start_node(problem, u, p, metric)
            if not node.error < _TRUST * size_of(node.u) or self.library.find(problem, _inside(node, self.span)):
                return False
            orbit = problem.orbits([(node.u, node.p, node.error)])[0]
            branch = trace(problem, orbit, self.span, step=self.step, max_step=self.max_step)
        except ContinuationError as reason:
            self.notes.append(f"an orbit near {problem.parameter} = {p:.6g} could not be followed: {reason}")
            return False
        self.library.add(branch)
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


def _inside(node: Node, span: tuple[float, float]) -> Node:
    return replace(node, p=float(np.clip(node.p, *span)))


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
