"""Build the tree of branches without help: switch at every point that leads on, keep every branch once."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from continuation.branches.arclength import Limits, Progress, check_span, trace
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.newton import Node
from continuation.branches.recognition import Library, Likeness
from continuation.branches.switching import departure, follow
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit

_LEADING = ("period-doubling", "branch-point")
SCHEMA = 1


@dataclass(frozen=True, slots=True, eq=False)
class Limb:
    """One branch of a tree.

    Attributes
    ----------
    branch : Branch
    parent : int or None
        Number of the branch it leaves; None for the first.
    point : SpecialPoint or None
        The point of the parent where it leaves.
    depth : int
        Switches from the first branch.
    """

    branch: Branch
    parent: int | None
    point: SpecialPoint | None
    depth: int


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A special point of one branch (``number``) that leads to a known branch (``target``), or its mirror image."""

    number: int
    point: SpecialPoint
    target: int
    likeness: Likeness


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """Branches found by :func:`explore`, each once.

    Attributes
    ----------
    limbs : tuple of Limb
        In the order found, parents before children.
    links : tuple of Link
    notes : tuple of str
        Points that were not followed, and why; empty when everything asked for was done.
    """

    limbs: tuple[Limb, ...]
    links: tuple[Link, ...]
    notes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.limbs)

    @property
    def branches(self) -> tuple[Branch, ...]:
        """Return the branches alone, numbered as in ``limbs``."""
        return tuple(limb.branch for limb in self.limbs)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary."""
        return {
            "schema": SCHEMA,
            "branches": [
                {"parent": m.parent, "depth": m.depth, "leaves_at": _where(m.point)} | m.branch.to_dict()
                for m in self.limbs
            ],
            "links": [
                {"branch": k.number, "at": _where(k.point), "target": k.target, "likeness": k.likeness}
                for k in self.links
            ],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        lines = [f"Tree of {len(self)} branches"]
        for number, m in enumerate(self.limbs):
            head, *rest = str(m.branch).split("\n")
            origin = f"from branch {m.parent}, {m.point.kind} at {m.point.parameter:.10g}: " if m.point else ""
            lines += ["  " * m.depth + f"{number}: {origin}{head}", *("  " * m.depth + line for line in rest)]
        for k in self.links:
            what = "the mirror image of branch" if k.likeness == "mirror image" else "branch"
            lines.append(
                f"  {k.point.kind} at {k.point.parameter:.10g} of branch {k.number} leads to {what} {k.target}"
            )
        return "\n".join([*lines, *(f"  not followed: {note}" for note in self.notes)])


def explore(
    problem: Any,
    span: tuple[float, float],
    *,
    start: Orbit | None = None,
    depth: int = 2,
    max_period: int = 16,
    step: float | None = None,
    max_step: float | None = None,
    max_points: int = 2000,
    progress: Progress | None = None,
) -> Tree:
    """Trace a branch and all that leave it at period-doublings and branch points, and so on to a depth.

    Parameters
    ----------
    problem : Problem
    span : (float, float)
        Parameter range; the first branch starts at ``span[0]`` unless a start is given.
    start : Orbit, optional
        An orbit of the first branch; ``problem.guess`` at ``span[0]`` finds one otherwise.
    depth : int
        Most switches from the first branch; 0 traces that one alone.
    max_period : int
        Doublings to more excitation periods than this are not followed (a note says so).
    step, max_step, max_points, progress
        As for :func:`~continuation.trace`, for every branch.

    Returns
    -------
    Tree
        Every branch once: one met again, from its other end or as the mirror image of another in a symmetric System,
        becomes a link. Ctrl-C keeps the branches found.

    Raises
    ------
    ValueError
        For a span, start or limits out of range.
    NoConvergence
        If no first orbit is found.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import HarmonicBalance, System
    >>> x, v, theta, omega, g = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega", "g"))
    >>> wells = System(name="two wells", states={"x": x, "v": v},
    ...                derivatives={"x": v, "v": -0.3 * v + x - x**3 + g * ca.cos(theta)},
    ...                phase=theta, frequency="omega", parameters={"g": (g, 0.2), "omega": (omega, 1.2)})
    >>> tree = explore(HarmonicBalance().discretise(wells, "g"), (0.262, 0.29), depth=1)
    >>> [(limb.parent, limb.branch.period_multiple) for limb in tree.limbs]
    [(None, 1), (0, 2)]
    """
    if depth < 0 or max_period < 1:
        raise ValueError(f"explore: expected depth >= 0 and max_period >= 1, got {depth} and {max_period}")
    low, high = sorted(float(v) for v in span)
    if start is None:
        start = problem.guess(**{problem.parameter: float(span[0])})
    first = trace(
        problem, start, span, step=step, max_step=max_step, max_points=max_points, progress=_stage(progress, "branch 0")
    )
    limits = Limits.of(check_span((low, high), start.value), step, max_step, max_points, parts=500.0)
    growth = _Growth(Library(problem.system.autonomous), limits, max_period, progress)
    growth.add(Limb(first, None, None, 0))
    try:
        growth.run(depth)
    except KeyboardInterrupt:
        growth.notes.append("interrupted; the branches found up to there are kept")
    return Tree(tuple(growth.limbs), tuple(growth.links), tuple(dict.fromkeys(growth.notes)))


class _Growth:
    """The tree while it grows: branches, links and notes so far."""

    def __init__(self, library: Library, limits: Limits, max_period: int, progress: Progress | None) -> None:
        self.library, self.limits, self.max_period, self.progress = library, limits, max_period, progress
        self.limbs: list[Limb] = []
        self.links: list[Link] = []
        self.notes: list[str] = []

    def add(self, limb: Limb) -> None:
        self.library.add(limb.branch)
        self.limbs.append(limb)

    def run(self, depth: int) -> None:
        """Follow every leading point of every branch, breadth first."""
        number = 0
        while number < len(self.limbs):
            limb = self.limbs[number]
            if "interrupted" in limb.branch.stop:
                self.notes.append(f"what leaves branch {number} after it was interrupted")
                return
            for point in limb.branch.special_points:
                if point.kind in _LEADING and limb.depth < depth:
                    self.visit(number, point)
            number += 1

    def visit(self, number: int, point: SpecialPoint) -> None:
        """Follow one point, unless its branch is known."""
        what = f"{point.kind} at {point.parameter:.10g} of branch {number}"
        doubled = 2 * point.orbit.period_multiple
        if point.kind == "period-doubling" and doubled > self.max_period:
            self.notes.append(f"{what}: period {doubled} is above the limit {self.max_period}")
            return
        found: list[Link] = []

        def known(problem: Any, node: Node) -> str | None:
            match = self.library.find(problem, node)
            if match is None:
                return None
            found.append(Link(number, point, match.branch, match.likeness))
            return f"branch {match.branch} again"

        try:
            leaving = departure(point, self.limits)
            stage = _stage(self.progress, f"branch {len(self.limbs)}")
            branch = follow(leaving, stage, time.perf_counter(), known)
        except (ContinuationError, ValueError) as reason:
            self.notes.append(f"{what}: {reason}")
            return
        self.links += found
        if branch is not None:
            self.add(Limb(branch, number, point, self.limbs[number].depth + 1))


def _stage(progress: Progress | None, name: str) -> Callable[[float, str], None] | None:
    if progress is None:
        return None
    return lambda done, text: progress(done, f"{name}: {text}")


def _where(point: SpecialPoint | None) -> dict[str, Any] | None:
    return None if point is None else {"kind": point.kind, "parameter": point.parameter}
