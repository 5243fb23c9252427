"""Where the period-1 response has no doubling: extent of the doubling curves over the quantity, refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from continuation import ContinuationError, HarmonicBalance, Orbit, trace
from sbg_casadi.map_curves import MapCurve
from sbg_casadi.map_parameters import Varied
from sbg_casadi.response import PARAMETER

DOUBLING = "period-doubling"
EndKind = Literal["extremum", "band", "limit", "stop"]

_POINTS = 9  # of a curve through which its extremum is interpolated


@dataclass(frozen=True, slots=True)
class End:
    """Where the doublings in the band end, over the quantity.

    Attributes
    ----------
    value : float
        As shown.
    error : float
        Estimated error of the value.
    frequency_ratio : float
        Where the last doubling is.
    kind : {"extremum", "band", "limit", "stop"}
        Two doublings meet; the doubling leaves the band; the range of the quantity ends; the curve ends for a reason
        given in ``note``.
    curve : int
    note : str
    """

    value: float
    error: float
    frequency_ratio: float
    kind: EndKind
    curve: int
    note: str = ""


@dataclass(frozen=True, slots=True)
class Extent:
    """An interval of the quantity in which the period-1 response has a doubling in the band."""

    low: End
    high: End


def extents(
    varied: Varied, curves: Sequence[MapCurve], band: tuple[float, float], span: tuple[float, float]
) -> list[Extent]:
    """Return the intervals with a doubling of the period-1 response in the band, increasing, none touching another.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    pieces = [
        extent
        for number, curve in enumerate(curves)
        if (curve.kind, curve.period_multiple) == (DOUBLING, 1)
        for extent in _pieces(varied, curve, number, sorted(band), span)
    ]
    merged: list[Extent] = []
    for piece in sorted(pieces, key=lambda e: e.low.value):
        last = merged[-1] if merged else None
        if last is None or piece.low.value - piece.low.error > last.high.value + last.high.error:
            merged.append(piece)
        elif piece.high.value > last.high.value:
            merged[-1] = Extent(last.low, piece.high)
    return merged


def _pieces(
    varied: Varied, curve: MapCurve, number: int, band: Sequence[float], span: tuple[float, float]
) -> list[Extent]:
    """Return the extent of every part of a curve that lies inside the band."""
    p = curve.points[:, 0]
    inside = (p >= band[0]) & (p <= band[1])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    return [
        _extent(varied, curve, number, band, span, int(a), int(b) - 1)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ] + _slipped(varied, curve, number, band, inside)


def _slipped(varied: Varied, curve: MapCurve, number: int, band: Sequence[float], inside: np.ndarray) -> list[Extent]:
    """Return the parts that cross the whole band between two neighbouring points."""
    p, out = curve.points[:, 0], []
    for i in range(len(p) - 1):
        if not inside[i] and not inside[i + 1] and (p[i] < band[0]) != (p[i + 1] < band[0]):
            ends = sorted((_crossing(varied, curve, number, i, edge) for edge in band), key=lambda e: e.value)
            out.append(Extent(*ends))
    return out


def _extent(
    varied: Varied,
    curve: MapCurve,
    number: int,
    band: Sequence[float],
    span: tuple[float, float],
    first: int,
    last: int,
) -> Extent:
    """Return the extent of points ``first`` to ``last``, which lie inside the band."""
    ends: list[End] = []
    for i, step in ((first, -1), (last, 1)):
        if 0 <= i + step < len(curve.points):
            at = min(i, i + step)
            p = curve.points[at : at + 2, 0]
            edge = next(e for e in band if min(p) <= e <= max(p))
            ends.append(_crossing(varied, curve, number, at, edge))
        else:
            ends.append(_ended(varied, curve, number, i, band, span))
    turns = [
        End(c.parameters[1], c.error[1], c.parameters[0], "extremum", number)
        for c in curve.special_points
        if c.kind == "extremum" and first - 1 <= c.index <= last and band[0] <= c.parameters[0] <= band[1]
    ]
    q = curve.points[first : last + 1, 1]
    found = {}
    for sign, name in ((-1, "low"), (1, "high")):
        i = first + int(np.argmax(sign * q))
        outer = max([*ends, *turns], key=lambda e: sign * e.value)
        if sign * curve.points[i, 1] > sign * outer.value and first < i < last:
            outer = _turning_end(curve, number, i)
        found[name] = outer
    return Extent(**found)


def _ended(
    varied: Varied, curve: MapCurve, number: int, i: int, band: Sequence[float], span: tuple[float, float]
) -> End:
    """Return what the end i of a curve is, whose last point lies inside the band."""
    p, q = curve.points[i]
    near = min(span, key=lambda v: abs(v - q))
    if abs(near - q) <= 1e-9 * abs(span[1] - span[0]):
        return End(near, 0.0, float(p), "limit", number)
    if "left its span" in curve.stop and len(curve.points) > 1:  # its last step went out of the band at once
        inner = curve.points[1 if i == 0 else i - 1]
        edge = band[1] if p > inner[0] else band[0]
        value = q + (edge - p) * (q - inner[1]) / (p - inner[0]) if p != inner[0] else q
        if min(span) <= value <= max(span):
            return _at_edge(varied, curve.orbits[i], number, edge, (float(value), float(abs(value - q))))
    return End(float(q), float("nan"), float(p), "stop", number, curve.stop)


# -------------------------------------------------------------------------------------------- where a curve leaves
def _crossing(varied: Varied, curve: MapCurve, number: int, i: int, edge: float) -> End:
    """Return where a curve crosses an edge of the band between points i and i + 1, located at that frequency."""
    a, b = curve.points[i], curve.points[i + 1]
    t = (edge - a[0]) / (b[0] - a[0]) if b[0] != a[0] else 0.5
    value, reach = float((1 - t) * a[1] + t * b[1]), float(abs(b[1] - a[1]))
    return _at_edge(varied, curve.orbits[i if t < 0.5 else i + 1], number, edge, (value, reach))


def _at_edge(varied: Varied, orbit: Orbit, number: int, edge: float, near: tuple[float, float]) -> End:
    """Return the doubling at a frequency ratio, over the quantity, near a value and within a reach."""
    value, reach = near
    inner = varied.inner(value)
    fixed: dict[str, Any] = {PARAMETER: edge}
    problem = HarmonicBalance().discretise(varied.system, varied.parameter, **fixed)
    width = varied.inner(max(reach, 1e-4 * (abs(value) or 1.0)))
    try:
        start = problem.solve(_as_in(orbit, varied, edge, inner), inner)
        found = trace(problem, start, (inner - width, inner + width)).special_points
    except ContinuationError:
        found = ()
    doublings = [q for q in found if q.kind == DOUBLING]
    if doublings:
        best = min(doublings, key=lambda s: abs(s.parameter - inner))
        return End(best.parameter * varied.factor, best.error * varied.factor, edge, "band", number)
    return End(value, reach, edge, "band", number, "interpolated")


def _as_in(orbit: Orbit, varied: Varied, frequency: float, inner: float) -> Orbit:
    """Return an orbit as a guess for the problem in the quantity at a fixed frequency."""
    values = {**orbit.parameters, PARAMETER: frequency, varied.parameter: inner}
    return replace(orbit, parameter=varied.parameter, parameters=values)


# -------------------------------------------------------------------------------------------- where two meet
def _turning_end(curve: MapCurve, number: int, i: int) -> End:
    """Return the extremum next to point i, which the tracking saw and could not locate."""
    p, q, error = turning(curve.points, i)
    return End(q, error, p, "extremum", number, "interpolated")


def turning(points: np.ndarray, i: int) -> tuple[float, float, float]:
    """Return frequency, value and error of the extremum of a curve (N, 2) near its point i.

    The value as a polynomial of the frequency through the nearest points; the error is the difference between one of
    degree 4 and one of degree 3 through fewer of them, and rounding.

    Examples
    --------
    >>> x = np.linspace(0.0, 0.2, 21)
    >>> p, q, error = turning(np.column_stack([x, 0.5 + (x - 0.103) ** 2]), 10)
    >>> round(p, 9), round(q, 9), bool(error < 1e-10)
    (0.103, 0.5, True)
    """
    half = _POINTS // 2
    found = []
    for reach, degree in ((half, 4), (half - 1, 3)):
        near = points[max(i - reach, 0) : i + reach + 1]
        x, y = near[:, 0] - points[i, 0], near[:, 1] - points[i, 1]
        size = float(np.abs(x).max()) or 1.0
        fit = np.polynomial.Polynomial.fit(x / size, y, min(degree, len(near) - 1), domain=[-1, 1])
        slope, bend, best = fit.deriv(), fit.deriv(2), 0.0
        for _ in range(8):  # Newton's method; the extremum is within the points
            best = float(np.clip(best - slope(best) / (bend(best) or 1.0), -1.0, 1.0))
        found.append((points[i, 0] + best * size, points[i, 1] + float(fit(best))))
    (p, q), (_, other) = found
    return float(p), float(q), abs(q - other) + 1e-12 * abs(q)


def free(found: Sequence[Extent], span: tuple[float, float]) -> list[tuple[End | None, End | None]]:
    """Return the intervals of the quantity without a doubling; None is an end of the range."""
    out: list[tuple[End | None, End | None]] = []
    before: End | None = None
    for extent in found:
        if extent.low.kind != "limit":
            out.append((before, extent.low))
        before = extent.high
    if before is None or before.kind != "limit":
        out.append((before, None))
    return out


def as_plain(end: End | None) -> dict[str, Any] | None:
    """Return an end ready for JSON."""
    if end is None:
        return None
    error = end.error if np.isfinite(end.error) else None
    return {
        "value": end.value,
        "error": error,
        "frequency_ratio": end.frequency_ratio,
        "kind": end.kind,
        "curve": end.curve,
        "note": end.note,
    }
