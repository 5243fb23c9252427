"""Find every sign change of test functions along a tracked curve, pairs inside one step included.

As on a branch (module ``bracketing``), signs at the ends of a step cancel when two zeros lie inside it. A function that
costs as much as a point of the curve is not sampled inside every step: second differences over neighbouring points
tell how far it may be from its chord, and only where it is not farther from zero is the step halved, with a true
point of the curve. So a pair is found if the function bends inside its step at most 1.5 times as much as the points
around show; steps of a curve turn by less than 0.35 rad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from continuation.branches.bracketing import Samples
from continuation.branches.curve import Segment
from continuation.branches.curve_tests import PointKind, Tests
from continuation.branches.newton import Node
from continuation.errors import ContinuationError

_SAFETY = 1.5  # a function must exceed this times the distance between chord and local cubic
_NOISE = 1e-9  # of the largest value along the curve, below which a function has no sign
_LEVELS = 18  # of halving
_ROUGH = 0.6  # by which the distance from the chord falls at least when a step is halved; 1/4 of a smooth function
_FEW = 5  # points that a curve is looked at with, at least


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Values (k,) of test functions at a true point of the curve, at arclength ``place``.

    ``index`` is the point of the curve it is or comes after, ``along`` the null vector with its sign.
    """

    node: Node
    index: int
    place: float
    values: np.ndarray
    along: np.ndarray | None


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """A sign change of one test function between neighbouring samples."""

    kind: PointKind
    a: Sample
    b: Sample


def at_nodes(tests: Tests, nodes: list[Node], kinds: tuple[PointKind, ...]) -> list[Sample]:
    """Return the samples at the points of a curve."""
    fit, metric, place = tests.system.lengthen, tests.metric, 0.0
    out: list[Sample] = []
    for i, node in enumerate(nodes):
        if i:
            before = nodes[i - 1]
            place += metric.length(fit(before.u, node.u) - node.u, before.p - node.p)
        values = tests(node, kinds)
        out.append(Sample(node, i, place, values, tests.along))
    return out


def chosen(
    samples: list[Sample], kinds: tuple[PointKind, ...], wanted: tuple[PointKind, ...]
) -> tuple[list[Sample], tuple[PointKind, ...]]:
    """Return the samples with some of their functions, and the kinds of these."""
    columns = [kinds.index(kind) for kind in wanted]
    return [replace(s, values=s.values[columns]) for s in samples], wanted


def search_curve(tests: Tests, samples: list[Sample], kinds: tuple[PointKind, ...]) -> tuple[list[Sample], list[str]]:
    """Return samples between which every function has one sign change or none, and notes on what is not certain.

    A function that does not come nearer to its chord when a step is halved jumps or has a corner there, as where a
    contact grazes: nothing is concluded from its differences, and a note says so.
    """
    notes: list[str] = []
    parent = np.full((len(samples) - 1, len(kinds)), np.nan)  # distances from the chord before the last halving
    strikes = np.zeros(parent.shape, dtype=int)
    for level in range(_LEVELS + 1):
        doubt, gap = _doubt(samples)
        strikes = np.where(np.isnan(parent), strikes, np.where(gap > _ROUGH * parent, strikes + 1, 0))
        settled = doubt & (strikes >= 2) if level < _LEVELS else doubt
        rows = np.flatnonzero(settled.any(axis=1))
        notes += [_note(tests, samples[i], samples[i + 1], kinds, settled[i]) for i in rows]
        wanted = (doubt & ~settled).any(axis=1)
        if not wanted.any():
            if len(samples) >= _FEW or len(samples) < 2:
                break
            wanted[:] = True
        samples, halved, open_ = _halved(tests, samples, wanted, kinds)
        notes += open_
        parent = np.repeat(np.where(halved[:, None], gap, np.nan), 1 + halved, axis=0)
        strikes = np.repeat(strikes, 1 + halved, axis=0)
        if not halved.any():
            break
    return samples, list(dict.fromkeys(notes))


def changes(tests: Tests, samples: list[Sample], kinds: tuple[PointKind, ...]) -> tuple[list[Change], list[str]]:
    """Return the sign changes in order along the curve, and notes where a function touches zero within rounding."""
    f = _values(samples)
    found, notes = list[Change](), list[str]()
    for column, noise in enumerate(_NOISE * np.nanmax(np.abs(f), axis=0, initial=0.0)):
        for i, j in pairwise(np.flatnonzero(np.abs(f[:, column]) > noise)):
            if f[i, column] * f[j, column] < 0 and j - i <= 2:
                found.append(Change(kinds[column], samples[i], samples[j]))
            elif np.isfinite(f[i:j, column]).all() and f[i + 1 : j, column].any():  # exact zeros: a linear model
                notes.append(_note(tests, samples[i], samples[j], kinds, np.arange(len(kinds)) == column))
    return sorted(found, key=lambda change: change.a.place), notes


def _values(samples: list[Sample]) -> np.ndarray:
    return np.array([s.values for s in samples])


def _doubt(samples: list[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """Return which functions may vanish more often between neighbours than their signs tell, and distances, (N-1, k).

    Distances are those from the chord, of the cubic through neighbouring samples.
    """
    f, place = _values(samples), np.array([s.place for s in samples])
    gap = Samples(None, place, f).gap()  # type: ignore[arg-type]
    size = np.abs(f)
    noise = _NOISE * np.nanmax(size, axis=0, initial=0.0)
    near = np.minimum(size[1:], size[:-1]) < _SAFETY * gap
    turning = 4 * gap > np.abs(np.diff(f, axis=0))  # the parabola turns inside, so that there may be three
    doubt = np.where(f[1:] * f[:-1] > 0, near, turning) & (np.maximum(size[1:], size[:-1]) > noise)
    return doubt & np.isfinite(gap), gap


def _note(tests: Tests, a: Sample, b: Sample, kinds: tuple[PointKind, ...], which: np.ndarray) -> str:
    low, high = sorted((a.node.p, b.node.p))
    what = ", ".join(kind for kind, yes in zip(kinds, which, strict=True) if yes)
    where = f"{tests.system.parameter} in [{low:.8g}, {high:.8g}]"
    return (
        f"{what}: not decided whether there are two more with {where}, closer than rounding or where a contact grazes"
    )


def _halved(
    tests: Tests, samples: list[Sample], wanted: np.ndarray, kinds: tuple[PointKind, ...]
) -> tuple[list[Sample], np.ndarray, list[str]]:
    """Return the samples with true points in the middle of the wanted steps, which have them, and notes on failures."""
    out, notes, halved = [samples[0]], list[str](), np.zeros(len(wanted), dtype=bool)
    for i, (a, b) in enumerate(pairwise(samples)):
        if wanted[i]:
            tests.along = a.along
            try:
                node = Segment(tests.system, tests.metric, a.node, b.node).node(0.5)
                values = tests(node, kinds)
                out.append(Sample(node, a.index, (a.place + b.place) / 2, values, tests.along))
                halved[i] = True
            except (ContinuationError, np.linalg.LinAlgError):
                notes.append(_note(tests, a, b, kinds, np.ones(len(kinds), dtype=bool)))
        out.append(b)
    return out, halved, notes
