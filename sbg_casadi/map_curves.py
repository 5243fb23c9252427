"""The curves of a map: special points of the response at several values of a quantity, tracked over it, each once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from continuation import Branch, ContinuationError, HarmonicBalance, Orbit, SpecialPoint, trace, track
from continuation.branches.codimension_two import CurvePoint
from continuation.branches.explore import explore
from sbg_casadi.documents import STATE, is_complete
from sbg_casadi.map_parameters import Varied
from sbg_casadi.response import PARAMETER

Report = Callable[[float, str], None]

TRACKED = (("fold", 1), ("period-doubling", 1), ("period-doubling", 2), ("neimark-sacker", 1))
"""Kinds and period multiples of the points that become curves."""

_OFF = 0.35  # of the distance of neighbouring points of a curve, up to which a located point lies on it
_SLACK = 1e-6  # the same, absolute
_STEPS = 15  # steps of the largest length over the range of the quantity
_BEYOND = 0.2  # of the band on both sides of it, up to which curves are followed
_MOST = {1: 400, 2: 80}  # points of a curve, by period multiple; those of period 2 cost several times as much


@dataclass(frozen=True, slots=True, eq=False)
class MapCurve:
    """One curve of special points.

    Attributes
    ----------
    kind : str
    period_multiple : int
        Of the orbits at which the point is: 2 for the doubling from 2 to 4.
    points : ndarray (N, 2)
        Frequency ratio and value shown along the curve.
    orbits : tuple of Orbit
    origin : str
        Where it was found.
    stop : str
        Why it ends, a sentence.
    special_points : tuple of CurvePoint
        Extrema of the quantity along the curve and points of codimension two, their second parameter as shown.
    notes : tuple of str
        What was not looked for along it.
    """

    kind: str
    period_multiple: int
    points: np.ndarray
    orbits: tuple[Orbit, ...]
    origin: str
    stop: str
    special_points: tuple[CurvePoint, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def signature(self) -> np.ndarray:
        """What tells curves apart at the same value: frequency ratio, RMS and mean of lambda, shape (N, 3)."""
        i = self.orbits[0].index(STATE)
        rows = [(o.rms(STATE), float(o.coefficients[0, i].real)) for o in self.orbits]
        return np.column_stack([self.points[:, 0], rows])

    def at(self, value: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return where it passes a value: interpolated signature, and how far it may be off."""
        q, y = self.points[:, 1], self.signature
        out = []
        for i in np.flatnonzero((q[:-1] - value) * (q[1:] - value) <= 0):
            t = (value - q[i]) / (q[i + 1] - q[i]) if q[i + 1] != q[i] else 0.5
            around = y[max(i - 1, 0) : i + 3]
            out.append(((1 - t) * y[i] + t * y[i + 1], _OFF * np.ptp(around, axis=0) + _SLACK))
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Slice:
    """The response at one value of the quantity.

    Attributes
    ----------
    value : float
        As shown.
    branches : tuple of Branch
        Period 1 first.
    points : tuple of SpecialPoint
        Those that become curves.
    curves : list of int or None
        For each point the number of the curve it lies on.
    notes : list of str
        What was not followed, or ended early.
    """

    value: float
    branches: tuple[Branch, ...]
    points: tuple[SpecialPoint, ...]
    notes: list[str]
    curves: list[int | None] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class Curves:
    """Curves and slices found so far.

    Attributes
    ----------
    curves : list of MapCurve
    slices : list of Slice
    failures : list of str
        What could not be followed, a sentence each.
    """

    curves: list[MapCurve]
    slices: list[Slice]
    failures: list[str]


def slice_values(varied: Varied, span: tuple[float, float], checks: int) -> tuple[list[float], list[float]]:
    """Return the values at which curves start (ends of the range and the given states) and those between.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> from sbg_casadi.map_parameters import vary
    >>> slice_values(vary(load_pair("iso-f2"), "modification", None, frozenset()), (0.0, 1.5), 2)
    ([0.0, 1.0, 1.5], [0.25, 0.5])
    """
    low, high = span
    given = (0.0, 1.0) if varied.name == "modification" else (1.0,) if varied.name == "fluctuation" else ()
    starts = sorted({low, high, *(g for g in given if low < g < high)})
    between: list[float] = []
    while len(between) < checks:  # halve the widest gap
        gaps = list(pairwise(sorted([*starts, *between])))
        a, b = max(gaps, key=lambda gap: gap[1] - gap[0])
        between.append((a + b) / 2)
    return starts, sorted(between)


def find_curves(
    varied: Varied,
    band: tuple[float, float],
    span: tuple[float, float],
    *,
    checks: int = 4,
    report: Report,
    tracked: Sequence[tuple[str, int]] = TRACKED,
) -> Curves:
    """Trace the response at several values and track every special point over the quantity, each curve once.

    Parameters
    ----------
    varied : Varied
    band : (float, float)
        First and last frequency ratio.
    span : (float, float)
        Least and largest value shown.
    checks : int
        Values between those at which curves start; a point there that lies on no curve yet starts one, too.
    report : callable
    tracked : sequence of (str, int)
        Kinds and period multiples to track; without a multiple of 2, branches of period 2 are not followed at all.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    ContinuationError
        If no slice can be traced.
    """
    found = Curves([], [], [])
    starts, between = slice_values(varied, span, checks)
    for number, value in enumerate([*starts, *between]):
        done = number / (len(starts) + len(between))
        report(done, f"{varied.name} {value:g}: tracing")
        try:
            doubled = value in starts and any(n == 2 for _, n in tracked)
            one = trace_slice(varied, value, band, doubled=doubled, tracked=tracked)
        except ContinuationError as error:
            found.failures.append(f"{varied.name} {value:.6g}: no response could be traced: {error}")
            continue
        found.slices.append(one)
        found.failures += one.notes
        one.curves.extend(assign(found.curves, one))
        for i, point in enumerate(one.points):
            if one.curves[i] is None:
                report(done, f"{varied.name} {value:g}: {point.kind} at {point.parameter:.4f}")
                _follow(found, varied, one, i, band, span)
    if not found.slices:
        raise ContinuationError("; ".join(found.failures))
    return found


def problem_at(varied: Varied, value: float) -> Any:
    """Return the harmonic-balance problem in the frequency ratio at a value shown."""
    values: dict[str, Any] = {varied.parameter: varied.inner(value)}
    return HarmonicBalance().discretise(varied.system, PARAMETER, **values)


def trace_slice(
    varied: Varied,
    value: float,
    band: tuple[float, float],
    *,
    doubled: bool,
    tracked: Sequence[tuple[str, int]] = TRACKED,
) -> Slice:
    """Trace the response at one value, and the branches of twice the period that leave it where wanted.

    Raises
    ------
    ContinuationError
        If there is no first orbit at either end of the band.
    KeyboardInterrupt
        On Ctrl-C.
    """
    problem, notes = problem_at(varied, value), []
    try:
        start, ends = problem.guess(**{PARAMETER: band[0]}), band
    except ContinuationError:
        start, ends = problem.guess(**{PARAMETER: band[1]}), band[::-1]
    if doubled:
        tree = explore(problem, ends, start=start, depth=1, max_period=2)
        branches = tree.branches
        notes += [f"{varied.name} {value:.6g}: {note}" for note in tree.notes]
    else:
        branches = (trace(problem, start, ends),)
    for branch in branches:
        if "interrupted" in branch.stop:
            raise KeyboardInterrupt(branch.stop)
    where = f"{varied.name} {value:.6g}"
    notes += [f"{where}: the response ended early: {b.stop}" for b in branches[:1] if not is_complete(b, ends[1])]
    notes += [f"{where}: unresolved: {text}" for b in branches[:1] for text in b.unresolved]
    points = [q for b in branches for q in b.special_points if (q.kind, b.period_multiple) in tracked]
    return Slice(value, branches, tuple(points), notes)


def assign(curves: Sequence[MapCurve], one: Slice) -> list[int | None]:
    """Return for each point of a slice the curve it lies on; every passage of a curve takes one point at most."""
    passages = [(number, at, off) for number, curve in enumerate(curves) for at, off in curve.at(one.value)]
    pairs = []
    for i, point in enumerate(one.points):
        mine = signature(point.orbit, point.parameter)
        for j, (number, at, off) in enumerate(passages):
            curve = curves[number]
            if (curve.kind, curve.period_multiple) == (point.kind, point.orbit.period_multiple):
                far = float(np.max(np.abs(mine - at) / off))
                if far <= 1:
                    pairs.append((far, i, j))
    out: list[int | None] = [None] * len(one.points)
    taken: set[int] = set()
    for _, i, j in sorted(pairs):
        if out[i] is None and j not in taken:
            out[i] = passages[j][0]
            taken.add(j)
    return out


def signature(orbit: Orbit, frequency: float) -> np.ndarray:
    """Return frequency ratio, RMS and mean of lambda."""
    return np.array([frequency, orbit.rms(STATE), float(orbit.coefficients[0, orbit.index(STATE)].real)])


def _follow(
    found: Curves, varied: Varied, one: Slice, i: int, band: tuple[float, float], span: tuple[float, float]
) -> None:
    """Track a point of a slice and give all points of it that lie on the curve its number."""
    point = one.points[i]
    where = f"{point.kind} at {point.parameter:.6f}, {varied.name} {one.value:.6g}"
    if point.orbit.period_multiple > 1:
        where += f", period {point.orbit.period_multiple}"
    low, high = sorted(varied.inner(v) for v in span)
    first, last = sorted(band)
    room = _BEYOND * (last - first)
    try:
        curve = track(
            point,
            parameters=(PARAMETER, varied.parameter),
            span={PARAMETER: (max(first - room, first / 2), last + room), varied.parameter: (low, high)},
            max_step=(high - low) / _STEPS,
            max_points=_MOST[point.orbit.period_multiple],
        )
    except (ContinuationError, ValueError) as error:
        found.failures.append(f"{where}: could not be tracked: {error}")
        return
    if "interrupted" in curve.stop:
        raise KeyboardInterrupt(curve.stop)
    shown = curve.values * [1.0, varied.factor]
    shown[:, 1] = np.clip(shown[:, 1], *span) + 0.0  # the last point is there up to rounding
    scale = abs(varied.factor)
    special = tuple(
        replace(
            c, parameters=(c.parameters[0], c.parameters[1] * varied.factor), error=(c.error[0], c.error[1] * scale)
        )
        for c in curve.points
    )
    new = MapCurve(
        point.kind, point.orbit.period_multiple, shown, curve.orbits, where, curve.stop, special, curve.notes
    )
    number = _same(found.curves, new)
    if number is None:
        found.curves.append(new)
        number = len(found.curves) - 1
    elif np.ptp(new.points[:, 1]) > np.ptp(found.curves[number].points[:, 1]):
        found.curves[number] = replace(new, origin=found.curves[number].origin)
    one.curves[i] = number
    again = assign(found.curves, one)
    for j, known in enumerate(one.curves):
        if known is None:
            one.curves[j] = again[j]


def _same(curves: Sequence[MapCurve], new: MapCurve) -> int | None:
    """Return the number of the curve that a new one is met again on, at most of five places along it."""
    places = np.unique(np.linspace(0, len(new.points) - 1, 7).astype(int)[1:-1])
    y = new.signature
    for number, curve in enumerate(curves):
        if (curve.kind, curve.period_multiple) != (new.kind, new.period_multiple):
            continue
        hits = 0
        for i in places:
            hits += any(np.all(np.abs(y[i] - at) <= off) for at, off in curve.at(new.points[i, 1]))
        if 2 * hits > len(places):
            return number
    return None
