"""Recognise an orbit that was met before: the same up to a shift in time, or the mirror image of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from continuation.branches.branch import Branch
from continuation.branches.newton import Node
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit

_SAMPLES = 64  # per excitation period
_ORDERS = 12  # harmonics compared, per excitation period
_SAME = 1e-5  # relative difference of harmonics that is none

Likeness = Literal["same", "mirror image"]


@dataclass(frozen=True, slots=True)
class Match:
    """The branch (its place in a list) that an orbit lies on, and whether it is its mirror image."""

    branch: int
    likeness: Likeness


def wave(problem: Any, u: np.ndarray, p: float) -> np.ndarray:
    """Return the states (S, n) at equidistant phases of a point (u, p), S even and 64 or more per excitation period."""
    segments = getattr(getattr(problem, "inner", problem), "segments", None) or 1
    unit = 2 * segments
    samples: np.ndarray = problem.waveform(u, p, unit * -(-_SAMPLES * problem.period_multiple // unit))
    return samples


def harmonics(samples: np.ndarray, period_multiple: int) -> np.ndarray:
    """Return the first harmonics (K, n), 12 per excitation period, of equidistant samples of one period."""
    return np.asarray(np.fft.rfft(samples, axis=0, norm="forward")[: _ORDERS * period_multiple])


def low(orbit: Orbit) -> np.ndarray:
    """Return the first harmonics (K, n) of an Orbit, 12 per excitation period."""
    count = _ORDERS * orbit.period_multiple
    out = np.zeros((count, orbit.coefficients.shape[1]), dtype=complex)
    few = orbit.coefficients[:count]
    out[: len(few)] = few
    return out


def difference(a: np.ndarray, b: np.ndarray, period_multiple: int, autonomous: bool) -> float:
    """Return the least distance of harmonics (K, n) over shifts in time, relative to the size of b.

    Shifts by whole excitation periods, any shift where there is no excitation.
    """
    scale = _scale(b)
    order = np.arange(len(a))[:, None]

    def off(shift: float) -> float:
        return float(np.sqrt(np.sum((np.abs(a * np.exp(1j * order * shift) - b) / scale) ** 2)))

    if not autonomous:
        return min(off(2 * np.pi * j / period_multiple) for j in range(period_multiple))
    best = min(np.linspace(0, 2 * np.pi, 16 * len(a), endpoint=False), key=off)
    reach = 2 * np.pi / (16 * len(a))
    for _ in range(40):  # golden section would do as well; the distance is smooth and this is cheap
        best = min((best - reach, best, best + reach), key=off)
        reach /= 2
    return off(best)


def _scale(c: np.ndarray) -> np.ndarray:
    """Return the size (n,) of every state, so that none counts for its unit."""
    size = np.sqrt(np.sum(np.abs(c) ** 2, axis=0))
    total = float(np.sqrt(np.sum(size**2)))
    return np.maximum(size, 1e-6 * total) * np.sqrt(len(size)) if total > 0 else np.ones(len(size))


class Library:
    """Branches known so far; tells whether an orbit lies on one of them or on the mirror image of one.

    Mirror images are the orbits ``x_i -> +- x_i``, shifted by any part of the period, that a symmetric System has:
    orbits all of whose harmonics have the same modulus.
    """

    def __init__(self, autonomous: bool) -> None:
        self.autonomous = autonomous
        self.branches: list[Branch] = []
        self._harmonics: list[np.ndarray] = []  # (N, K, n) of every branch

    def add(self, branch: Branch) -> int:
        """Remember a branch and return its number."""
        self.branches.append(branch)
        self._harmonics.append(np.array([low(o) for o in branch.orbits]))
        return len(self.branches) - 1

    def find(self, problem: Any, node: Node, among: Sequence[int] | None = None) -> Match | None:
        """Return the branch that a corrected point lies on, or None.

        A branch is looked at where it passes the same parameter with harmonics of about the same modulus; its orbit at
        exactly that parameter is then computed and compared.
        """
        n = problem.period_multiple
        numbers = range(len(self.branches)) if among is None else among
        mine = None
        for number in numbers:
            branch = self.branches[number]
            if branch.period_multiple != n:
                continue
            if mine is None:
                mine = harmonics(wave(problem, node.u, node.p), n)
            for guess, reach in self._passes(number, node.p, mine):
                likeness = self._compare(problem, guess, reach, node, mine)
                if likeness is not None:
                    return Match(number, likeness)
        return None

    def _passes(self, number: int, p: float, mine: np.ndarray) -> list[tuple[Orbit, float]]:
        """Return interpolated orbits of a branch at p that resemble harmonics, each with what it may be off by."""
        branch, c = self.branches[number], self._harmonics[number]
        at, scale = branch.parameter, _scale(mine)
        out = []
        for i in np.flatnonzero((at[:-1] - p) * (at[1:] - p) <= 0):
            t = (p - at[i]) / (at[i + 1] - at[i]) if at[i + 1] != at[i] else 0.5
            sizes = np.abs(c[i : i + 2])
            reach = float(np.sqrt(np.sum(((sizes[1] - sizes[0]) / scale) ** 2)))
            off = float(np.sqrt(np.sum((((1 - t) * sizes[0] + t * sizes[1] - np.abs(mine)) / scale) ** 2)))
            if off <= reach + 100 * _SAME:
                out.append((between(branch.orbits[i], branch.orbits[i + 1], t), reach + 100 * _SAME))
        return out

    def _compare(self, problem: Any, guess: Orbit, reach: float, node: Node, mine: np.ndarray) -> Likeness | None:
        try:
            theirs = low(problem.solve(guess, node.p))
        except ContinuationError:
            return None
        scale = _scale(mine)
        moved = float(np.sqrt(np.sum(((np.abs(theirs) - np.abs(low(guess))) / scale) ** 2)))
        if moved > 3 * reach:  # the correction went to another solution, perhaps to the one in question
            return None
        if difference(mine, theirs, problem.period_multiple, self.autonomous) < _SAME:
            return "same"
        off = float(np.sqrt(np.sum(((np.abs(theirs) - np.abs(mine)) / scale) ** 2)))
        return "mirror image" if off < _SAME else None


def between(a: Orbit, b: Orbit, t: float) -> Orbit:
    """Return the linear interpolation of two neighbouring orbits of a branch, as a guess."""
    count = max(len(a.coefficients), len(b.coefficients))

    def full(o: Orbit) -> np.ndarray:
        return np.pad(o.coefficients, ((0, count - len(o.coefficients)), (0, 0)))

    return replace(a, coefficients=(1 - t) * full(a) + t * full(b), period=(1 - t) * a.period + t * b.period)
