"""Orbits of one branch at one frequency, and the special points around each of them along the branch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from continuation.branches.branch import CRITICAL, Branch, SpecialPoint
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit, Stability

_SLACK = 1e-3  # of a piece of the branch, by which a solved orbit may lie outside it

Node = Orbit | SpecialPoint


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """An orbit at the wanted frequency.

    Attributes
    ----------
    orbit : Orbit
    place : int
        It lies between the nodes ``place`` and ``place + 1`` of :func:`branch_nodes`.
    """

    orbit: Orbit
    place: int


@dataclass(frozen=True, slots=True)
class Change:
    """What comes next along a branch: a special point, or a change of stability that none explains.

    Attributes
    ----------
    kind : str
        Kind of the special point, or ``"unexplained change"``.
    parameter, error : float
        Where, and how well that is known.
    beyond : "stable", "unstable" or "undecided"
        Stability of the branch behind it.
    status : "located" or "guessed"
    note : str
    around_fold : bool
        Whether a fold lies between, so that no change of frequency alone leads there.
    """

    kind: str
    parameter: float
    error: float
    beyond: Stability
    status: str
    note: str
    around_fold: bool


def branch_nodes(branch: Branch) -> list[Node]:
    """Return orbits and special points in order along a branch; the parameter is monotone between two of them."""
    nodes: list[Node] = []
    for i, orbit in enumerate(branch.orbits):
        nodes += [orbit, *(p for p in branch.special_points if p.index == i)]
    return nodes


def crossings(problem: Any, branch: Branch, value: float) -> tuple[list[Crossing], list[str]]:
    """Solve for every orbit at which a branch passes a parameter value.

    Parameters
    ----------
    problem : Problem
        What the branch was traced with.
    branch : Branch
    value : float
        Continuation parameter.

    Returns
    -------
    list of Crossing
        In order along the branch.
    list of str
        A sentence for every pass at which no orbit could be solved, as happens within rounding of a fold.

    Notes
    -----
    About 10 ms for each pass of a gear pair.
    """
    nodes = branch_nodes(branch)
    found: list[Crossing] = []
    missing: list[str] = []
    for place in _passes([_parameter(n) for n in nodes], value):
        pair = nodes[place], nodes[place + 1]
        orbit = _solve(problem, *pair, value, [c.orbit for c in found])
        if isinstance(orbit, str):
            a, b = sorted(_parameter(n) for n in pair)
            missing.append(f"the orbit of the piece {a:.10g} to {b:.10g} was not found at {value:.10g}: {orbit}")
        else:
            found.append(Crossing(orbit, place))
    return found, missing


def _passes(values: Sequence[float], wanted: float) -> list[int]:
    """Return the pieces in which a sequence passes a value, one for every pass.

    >>> _passes([1.0, 2.0, 3.0, 2.0, 1.0], 2.0), _passes([1.0, 2.0], 2.0), _passes([2.0, 1.0], 2.0)
    ([1, 3], [0], [0])
    """
    gaps = np.asarray(values) - wanted
    a, b = gaps[:-1], gaps[1:]
    found = np.flatnonzero(((a <= 0) & (b > 0)) | ((a >= 0) & (b < 0))).tolist()
    return [*found, len(a) - 1] if gaps[-1] == 0 else found


def _solve(problem: Any, a: Node, b: Node, value: float, known: Sequence[Orbit]) -> Orbit | str:
    """Return the orbit at a value between two nodes, or a reason; the other sheet of a fold is not taken for it."""
    left, right = _orbit(a), _orbit(b)
    reason = "only orbits of other pieces were found; move away from the fold"
    for start in (_between(a, b, value), left, right):
        try:
            orbit = problem.solve(start, value)
        except ContinuationError as error:
            reason = str(error)
            continue
        if _lies_between(orbit, left, right) and all(_difference(orbit, k) > 0 for k in known):
            return orbit
    return reason


def _between(a: Node, b: Node, value: float) -> Orbit:
    """Return an estimate of the orbit at a value, linear between two nodes, a square root from a fold."""
    left, right, p, q = _orbit(a), _orbit(b), _parameter(a), _parameter(b)
    part = (value - p) / (q - p) if q != p else 0.0
    if _is_fold(a) and not _is_fold(b):
        part = np.sqrt(part)
    elif _is_fold(b) and not _is_fold(a):
        part = 1 - np.sqrt(1 - part)
    x, y = _same_length(left, right)
    return replace(left, coefficients=x + part * (y - x))


def _lies_between(orbit: Orbit, left: Orbit, right: Orbit) -> bool:
    x, a, b = _same_length(orbit, left, right)
    length = float(np.linalg.norm(b - a)) ** 2
    ahead = float(np.vdot(b - a, x - a).real)
    return -_SLACK * length <= ahead <= (1 + _SLACK) * length


def _difference(orbit: Orbit, other: Orbit) -> float:
    """Return the distance of two orbits where it exceeds what their errors explain, else 0."""
    x, y = _same_length(orbit, other)
    distance = float(np.linalg.norm(x - y))
    return distance if distance > orbit.error + other.error else 0.0


def _same_length(*orbits: Orbit) -> list[np.ndarray]:
    most = max(len(o.coefficients) for o in orbits)
    return [np.pad(o.coefficients, ((0, most - len(o.coefficients)), (0, 0))) for o in orbits]


def _orbit(node: Node) -> Orbit:
    return node.orbit if isinstance(node, SpecialPoint) else node


def _parameter(node: Node) -> float:
    return node.parameter if isinstance(node, SpecialPoint) else node.value


def _is_fold(node: Node) -> bool:
    return isinstance(node, SpecialPoint) and node.kind == "fold"


# -------------------------------------------------------------------------------------------- along the branch
def surroundings(branch: Branch, crossing: Crossing) -> dict[str, list[Change]]:
    """Return what lies around an orbit on its branch.

    Parameters
    ----------
    branch : Branch
    crossing : Crossing
        One of :func:`crossings` of this branch.

    Returns
    -------
    dict
        ``"lower"`` and ``"higher"``: the changes met in turn when the branch is followed to lower and to higher
        parameters, up to the first that changes the verdict (stable or not stable); empty where there is none. A
        piece on which the verdict is unknown is never taken for stable.
    """
    nodes, i = branch_nodes(branch), crossing.place
    ways = [nodes[i + 1 :], nodes[i::-1]]
    rising = _parameter(nodes[i + 1]) > _parameter(nodes[i])
    forward, backward = (_until_changed(crossing.orbit, way) for way in ways)
    return {"lower": backward, "higher": forward} if rising else {"lower": forward, "higher": backward}


def _until_changed(orbit: Orbit, way: Sequence[Node]) -> list[Change]:
    found: list[Change] = []
    for change in _changes(orbit, way):
        found.append(change)
        if orbit.stability == "undecided" or (change.beyond == "stable") != (orbit.stability == "stable"):
            break
    return found


def _changes(orbit: Orbit, way: Sequence[Node]) -> Iterator[Change]:
    """Yield the changes along a way from an orbit; the number of unstable multipliers is counted along it."""
    count, last, around = _unstable(orbit), orbit.value, False
    explained = False  # whether a special point was met since the last decided orbit
    way = [n for n in way if not isinstance(n, SpecialPoint) or CRITICAL[n.kind]]  # no stability changes at grazing
    for node, following in pairwise([*way, None]):
        if isinstance(node, SpecialPoint):
            after = _unstable(following) if isinstance(following, Orbit) else None
            count = _count_behind(node, count) if after is None else after
            yield Change(node.kind, node.parameter, node.error, _verdict(count), node.status, node.note, around)
            around, explained = around or node.kind == "fold", True
        elif node is not None and (own := _unstable(node)) is not None:
            if count is not None and own != count and not explained:
                note = "a change of stability that no located point explains"
                gap = abs(node.value - last)
                yield Change("unexplained change", node.value, gap, _verdict(own), "guessed", note, around)
            count, last, explained = own, node.value, False


def _count_behind(point: SpecialPoint, count: int | None) -> int | None:
    """Return the unstable multipliers behind a special point: with ``n`` others outside, n on one side, n + c beyond.

    None when the count before is unknown or is none of the two.
    """
    critical = CRITICAL[point.kind]
    size = np.abs(point.multipliers)
    others = int(np.sum(np.delete(size, np.argsort(np.abs(size - 1))[:critical]) > 1))
    return {others: others + critical, others + critical: others}.get(count) if count is not None else None


def _unstable(orbit: Orbit) -> int | None:
    """Return the number of multipliers outside the unit circle, None when that is undecided for one of them."""
    outside = np.abs(orbit.multipliers) - 1
    decided = np.all(np.abs(outside) > orbit.multiplier_error)  # not where one is NaN
    return int(np.sum(outside > 0)) if decided else None


def _verdict(count: int | None) -> Stability:
    return "undecided" if count is None else "unstable" if count else "stable"
