"""Gauss quadrature between the corners of a periodic function: Fourier integrals to rounding.

Between two corners the function is smooth, and Gauss-Legendre points converge faster than any power. The period is cut
at the corners and into panels short enough for the highest harmonic; panels on which the function is not resolved are
halved, and points crowd quadratically towards a corner there, which makes square roots of the distance smooth, too
(a Hertzian contact force behaves as its 3/2 power). Source: Davis, Rabinowitz, Methods of Numerical Integration, 2.12.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from continuation.errors import UnsupportedModel

_POINTS = 16
_TURN = 6.5  # half the phase that the highest harmonic turns through in one panel, rad
_RESOLVED = 1e-12  # part of the integral, relative to the largest value, that the last Legendre coefficients make
_DEPTH = 48
_TINY, _JUMP = 1e-7, 1e-3  # what changes by this part of its size within so short a panel (rad) is taken to jump
_SHORTEST = 1e-14  # distance between two corners that is taken for none, rad


class Harmonics:
    """exp(i k phase) at N phases for k = 0..K, as products of about 2 sqrt(K) of them: little memory, few cosines.

    Examples
    --------
    >>> Harmonics(np.array([0.0, np.pi]), 5).evaluate(np.array([[1.0], [0.5], [0.25]])).round(12).tolist()
    [[2.5], [0.5]]
    """

    def __init__(self, phases: np.ndarray, order: int) -> None:
        self._block = int(np.ceil(np.sqrt(order + 1)))
        self._low = _powers(np.exp(1j * phases), self._block)
        self._high = _powers(np.exp(1j * self._block * phases), -(-(order + 1) // self._block))

    def evaluate(self, spectrum: np.ndarray) -> np.ndarray:
        """Return the waveform (N, c) of a half spectrum (H+1, c), H <= K."""
        count, c = spectrum.shape
        blocks = -(-count // self._block)
        twice = np.zeros((blocks * self._block, c), dtype=complex)
        twice[:count] = 2 * spectrum
        twice[0] = spectrum[0]
        inner = self._low @ twice.reshape(blocks, self._block, c).transpose(1, 0, 2).reshape(self._block, -1)
        return np.asarray((inner.reshape(-1, blocks, c) * self._high[:, :blocks, None]).sum(axis=1).real)

    def project(self, values: np.ndarray, last: int) -> np.ndarray:
        """Return sum_n values_n exp(-i k phase_n) for k = 0..last <= K, shape (last+1, c), of real values (N, c)."""
        blocks, c = last // self._block + 1, values.shape[1]
        spread = values[:, None, :] * self._high[:, :blocks, None]
        sums = self._low.T @ spread.reshape(len(values), -1)
        return np.asarray(sums.reshape(self._block, blocks, c).transpose(1, 0, 2).reshape(-1, c)[: last + 1].conj())

    def part(self, keep: np.ndarray) -> Harmonics:
        """Return the same at some of the phases."""
        return self._of(self._low[keep], self._high[keep])

    def joined(self, others: list[Harmonics]) -> Harmonics:
        """Return the same at these phases and those of others of the same order."""
        all_of = [self, *others]
        return self._of(np.concatenate([h._low for h in all_of]), np.concatenate([h._high for h in all_of]))

    def _of(self, low: np.ndarray, high: np.ndarray) -> Harmonics:
        new = object.__new__(Harmonics)
        new._block, new._low, new._high = self._block, low, high
        return new


def _powers(base: np.ndarray, count: int) -> np.ndarray:
    """Return base**k, shape (N, count), by doubling."""
    out = np.empty((base.size, count), dtype=complex)
    out[:, 0] = 1.0
    done, factor = 1, base
    while done < count:
        more = min(done, count - done)
        np.multiply(out[:, :more], factor[:, None], out=out[:, done : done + more])
        done, factor = done + more, factor * factor
    return out


@dataclass(frozen=True, slots=True)
class Samples:
    """Points of a quadrature over one period.

    phases (N,), weights (N,) that sum to 1 over the period, segments (N,): index of the corner before each point,
    and the harmonics there.
    """

    phases: np.ndarray
    weights: np.ndarray
    segments: np.ndarray
    harmonics: Harmonics

    def coefficients(self, values: np.ndarray, last: int) -> np.ndarray:
        """Return Fourier coefficients 0..last (last+1, c) of real values (N, c) at the points."""
        return self.harmonics.project(self.weights[:, None] * values, last)

    def part(self, keep: np.ndarray) -> Samples:
        """Return some of the points."""
        return Samples(self.phases[keep], self.weights[keep], self.segments[keep], self.harmonics.part(keep))


@lru_cache(maxsize=4)
def _rule(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss points and weights on [0, 1], and the rows that give the last two Legendre coefficients of values there."""
    x, w = np.polynomial.legendre.leggauss(points)
    order = np.arange(points)[:, None]
    transform = np.polynomial.legendre.legvander(x, points - 1).T * w * (order + 0.5)
    return (x + 1) / 2, w / 2, transform[-2:]


@dataclass(frozen=True, slots=True)
class _Panels:
    """Panels [start, start + length] of segments; left, right: whether points crowd towards that end."""

    start: np.ndarray
    length: np.ndarray
    segment: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return phases (P, q) and dphase/ds (P, q) at the Gauss points s of [0, 1]."""
        s = _rule(_POINTS)[0]
        left, right, length = self.left[:, None], self.right[:, None], self.length[:, None]
        place = np.where(left, np.where(right, s * s * (3 - 2 * s), s * s), np.where(right, s * (2 - s), s))
        rate = np.where(left, np.where(right, 6 * s * (1 - s), 2 * s), np.where(right, 2 * (1 - s), 1.0))
        return self.start[:, None] + length * place, length * rate

    def halved(self, rough: np.ndarray, corners: np.ndarray) -> _Panels:
        """Return the halves of rough panels; those that touch a corner crowd their points towards it."""
        start, length, segment = self.start[rough], self.length[rough] / 2, self.segment[rough]
        ends = np.append(corners, corners[0] + 2 * np.pi)
        first = start == ends[segment]
        last = np.isclose(start + 2 * length, ends[segment + 1], rtol=0, atol=1e-15)
        no = np.zeros_like(first)
        return _Panels(
            np.concatenate([start, start + length]),
            np.concatenate([length, length]),
            np.concatenate([segment, segment]),
            np.concatenate([first, no]),
            np.concatenate([no, last]),
        )


def sample(
    corners: np.ndarray,
    order: int,
    evaluate: Callable[[np.ndarray, np.ndarray, Harmonics], np.ndarray],
    noise: float = 0.0,
    leading: int | None = None,
) -> tuple[Samples, np.ndarray]:
    """Sample a function of the phase for Fourier coefficients up to an order, exact to about 1e-12 of its size.

    Parameters
    ----------
    corners : array (r,), r >= 1
        Increasing phases within one period at which the function has corners; segment j follows corner j.
    order : int
        Highest harmonic K wanted.
    evaluate : callable
        (phases (N,), segments (N,), their harmonics) -> values (N, c).
    noise : float
        Rounding error of the values.
    leading : int, optional
        How many of the values must be continuous, also between the corners (all of them by default).

    Returns
    -------
    Samples, values (N, c)

    Raises
    ------
    UnsupportedModel
        If the function jumps between the corners, or has more corners there than can be found by halving.

    Examples
    --------
    >>> corners = np.array([np.pi / 2, 3 * np.pi / 2])
    >>> points, values = sample(corners, 4, lambda t, segment, harmonics: np.abs(np.cos(t))[:, None])
    >>> bool(abs(points.coefficients(values, 4)[4, 0] - -2 / (15 * np.pi)) < 1e-13)
    True
    """
    panels = _cut(corners, max(order, 1))
    found: list[tuple[Samples, np.ndarray]] = []
    scale = np.zeros(1)
    _, w, tail = _rule(_POINTS)
    for _ in range(_DEPTH):
        phases, rates = panels.points()
        flat, weights = phases.ravel(), (rates * w).ravel() / (2 * np.pi)
        points = Samples(flat, weights, np.repeat(panels.segment, _POINTS), Harmonics(flat, order))
        values = evaluate(flat, points.segments, points.harmonics)
        scale = np.maximum(scale, np.abs(values).max(axis=0, initial=0.0))
        shaped = values.reshape(len(phases), _POINTS, -1) * rates[..., None]
        left_over = np.abs(np.einsum("tq,pqc->ptc", tail, shaped)).max(axis=1) / (2 * np.pi)
        rough = ~(left_over <= np.maximum(_RESOLVED * scale, noise)).all(axis=1) & np.isfinite(left_over).all(axis=1)
        jumps = left_over[:, :leading] > _JUMP * scale[:leading] * panels.length[:, None] + noise
        at = panels.start[jumps.any(axis=1) & (panels.length < _TINY)]
        if at.size:
            break
        if not rough.any():
            return _joined([*found, (points, values)])
        keep = np.repeat(~rough, _POINTS)
        found.append((points.part(keep), values[keep]))
        panels = panels.halved(rough, corners)
        at = panels.start
    raise UnsupportedModel(
        f"the port force is not smooth between contact changes, near phase {at[0] % (2 * np.pi):.6g} rad of the orbit; "
        "declare every corner as a Contact, and smooth jumps"
    )


def _joined(found: list[tuple[Samples, np.ndarray]]) -> tuple[Samples, np.ndarray]:
    if len(found) == 1:
        return found[0]
    parts = [samples for samples, _ in found]
    phases, weights, segments = (
        np.concatenate([getattr(s, name) for s in parts]) for name in ("phases", "weights", "segments")
    )
    harmonics = parts[0].harmonics.joined([s.harmonics for s in parts[1:]])
    return Samples(phases, weights, segments, harmonics), np.concatenate([values for _, values in found])


def _cut(corners: np.ndarray, order: int) -> _Panels:
    """Cut the period at its corners and into panels in which the highest harmonic turns by at most 2 _TURN."""
    gaps = np.diff(np.append(corners, corners[0] + 2 * np.pi))
    counts = np.where(gaps > _SHORTEST, np.ceil(gaps * order / (2 * _TURN)), 0).astype(int)
    segment = np.repeat(np.arange(len(corners)), counts)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    length = (gaps / np.maximum(counts, 1))[segment]
    no = np.zeros(len(segment), dtype=bool)
    return _Panels(corners[segment] + place * length, length, segment, no, no)
