"""The period-doubling cascade from one doubling on: 2, 4, 8, ... and where it accumulates, the onset of chaos."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, cast

import numpy as np

from continuation.branches.arclength import Progress
from continuation.branches.branch import CRITICAL, Branch, SpecialPoint
from continuation.branches.switching import span_of, switch
from continuation.errors import ContinuationError

FEIGENBAUM = 4.669201609102990  # limit of the ratios of a cascade of a quadratic maximum (Feigenbaum 1978)
_NEXT = 0.6  # of the last distance between doublings, half width of the span in which the next one is sought first
_FINE = 20.0  # distance between doublings over their errors below which they are not told apart
_PLAUSIBLE = 0.25  # relative distance of the last ratio from its limit up to which the sequence is extrapolated
_COARSE = 0.15  # the same of a first ratio that was not measured

Ending = Literal[
    "limit",
    "resolution",
    "neimark-sacker",
    "fold",
    "branch-point",
    "grazing",
    "no doubling",
    "not reached",
    "interrupted",
]


@dataclass(frozen=True, slots=True, eq=False)
class Cascade:
    """A sequence of period-doublings.

    Attributes
    ----------
    doublings : tuple of SpecialPoint
        The point given and those found after it.
    branches : tuple of Branch
        ``branches[i]`` is born at ``doublings[i]``, followed as far as the next one needs.
    accumulation, accumulation_error : float or None
        Where the doublings accumulate, with its error; None with less than three of them, or where their distances do
        not shrink as those of such a sequence.
    ended : str
        "limit" of the period, or "resolution"; else what ended the stable orbits instead: "neimark-sacker", "fold",
        "branch-point", "grazing", "no doubling" within the span; "not reached" where a branch could not be followed, or
        "interrupted".
    reason : str
        The same as a sentence with its parameter.
    """

    doublings: tuple[SpecialPoint, ...]
    branches: tuple[Branch, ...]
    accumulation: float | None
    accumulation_error: float | None
    ended: Ending
    reason: str

    @property
    def parameter(self) -> np.ndarray:
        """Parameters (N,) of the doublings."""
        return np.array([q.parameter for q in self.doublings])

    @property
    def error(self) -> np.ndarray:
        """Stated errors (N,) of the parameters."""
        return np.array([q.error for q in self.doublings])

    @property
    def periods(self) -> tuple[int, ...]:
        """Excitation periods of the orbits that double, e.g. (1, 2, 4)."""
        return tuple(q.orbit.period_multiple for q in self.doublings)

    @property
    def ratios(self) -> np.ndarray:
        """Ratios (N - 2,) of neighbouring distances, which tend to 4.6692."""
        d = np.diff(self.parameter)
        return np.asarray(d[:-1] / d[1:]) if len(d) > 1 else np.zeros(0)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary."""
        return {
            "schema": 1,
            "parameter": self.doublings[0].orbit.parameter,
            "doublings": [
                {"period_multiple": n, "parameter": q.parameter, "error": q.error, "status": q.status}
                for n, q in zip(self.periods, self.doublings, strict=True)
            ],
            "ratios": self.ratios.tolist(),
            "accumulation": self.accumulation,
            "accumulation_error": self.accumulation_error,
            "ended": self.ended,
            "reason": self.reason,
        }

    def __str__(self) -> str:
        name, ratios = self.doublings[0].orbit.parameter, self.ratios
        lines = [f"Cascade of {self.doublings[0].orbit.system!r}: {len(self.doublings)} period-doublings"]
        for i, (n, q) in enumerate(zip(self.periods, self.doublings, strict=True)):
            ratio = f", ratio {ratios[i - 2]:.5f}" if i > 1 else ""
            lines.append(f"  {n} -> {2 * n} at {name} = {q.parameter:.10g} +- {q.error:.1e}{ratio}")
        if self.accumulation is not None:
            lines.append(f"  accumulates at {name} = {self.accumulation:.10g} +- {self.accumulation_error:.1e}")
        return "\n".join([*lines, f"  ended: {self.reason}"])


def cascade(
    point: SpecialPoint,
    span: tuple[float, float] | None = None,
    *,
    max_period: int = 64,
    step: float | None = None,
    max_step: float | None = None,
    progress: Progress | None = None,
) -> Cascade:
    """Follow period-doublings of stable orbits from one on, and extrapolate where they accumulate.

    Parameters
    ----------
    point : SpecialPoint
        A period-doubling of a branch traced by any method.
    span : (float, float), optional
        Parameter range that must contain the point; orbits are not followed out of it. Default that of the branch the
        point was found on.
    max_period : int
        Orbits of more excitation periods are not followed.
    step, max_step : float, optional
        Of the first doubled branch, as for :func:`~continuation.switch`; later ones scale with the distance of the
        doublings before.

    Returns
    -------
    Cascade

    Raises
    ------
    ValueError
        If the point is no period-doubling, was loaded from a file, or lies outside the span.

    Notes
    -----
    The next doubling is the end of the first stretch of stable orbits of the doubled branch, seen from its birth; on a
    branch without stable orbits, its first doubling. The accumulation point is extrapolated with the last measured
    ratio (Aitken); its error is the larger of the difference that Feigenbaum's ratio makes and a ratio's part of the
    change by the last doubling.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import Shooting, System, trace
    >>> x, v, theta, omega, g = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega", "g"))
    >>> wells = System(name="two wells", states={"x": x, "v": v},
    ...                derivatives={"x": v, "v": -0.3 * v + x - x**3 + g * ca.cos(theta)},
    ...                phase=theta, frequency="omega", parameters={"g": (g, 0.2), "omega": (omega, 1.2)})
    >>> problem = Shooting().discretise(wells, "g")
    >>> parent = trace(problem, problem.guess(g=0.262), (0.262, 0.268))
    >>> onset = cascade(parent.special_points[0], (0.26, 0.3), max_period=4)
    >>> onset.periods, onset.ratios.round(3).tolist(), onset.ended
    ((1, 2, 4), [4.802], 'limit')
    """
    if point.kind != "period-doubling":
        raise ValueError(f"cascade: expected a period-doubling, got a {point.kind}")
    low, high = span_of(point, span)
    doublings, branches = [point], []
    ended: Ending = "limit"
    reason = ""
    while True:
        last = doublings[-1]
        doubled = 2 * last.orbit.period_multiple
        if doubled > max_period:
            reason = f"orbits of more than {max_period} periods are not followed"
            break
        try:
            branch, verdict, following, reason = _next(doublings, (low, high), step, max_step, progress)
        except ContinuationError as failure:
            ended, reason = "not reached", f"the branch of period {doubled} could not be followed: {failure}"
            break
        branches.append(branch)
        if following is None:
            ended = verdict
            break
        gap = abs(following.parameter - last.parameter)
        if gap < _FINE * (following.error + last.error):
            ended = "resolution"
            reason = f"doublings {gap:.1e} apart are below the resolution {following.error + last.error:.1e}"
            break
        doublings.append(following)
    value, error = _accumulation(doublings) if ended in ("limit", "resolution") else (None, None)
    return Cascade(tuple(doublings), tuple(branches), value, error, ended, reason)


def _next(
    doublings: list[SpecialPoint],
    span: tuple[float, float],
    step: float | None,
    max_step: float | None,
    progress: Progress | None,
) -> tuple[Branch, Ending, SpecialPoint | None, str]:
    """Return the next doubled branch, what ends its stable orbits, the doubling if it is one, and a sentence."""
    last = doublings[-1]
    if len(doublings) > 1:  # where a cascade goes on, at a quarter of the last distance or so
        reach = _NEXT * abs(last.parameter - doublings[-2].parameter)
        narrow = max(span[0], last.parameter - reach), min(span[1], last.parameter + reach)
        try:
            branch = switch(last, narrow, progress=progress)
        except (ValueError, ContinuationError):
            branch = None  # a narrow span may be left at once; the whole one decides
        if branch is not None and (found := _ending(branch))[1] is not None:
            return branch, *found
    branch = switch(last, span, step=step, max_step=max_step, progress=progress)
    return branch, *_ending(branch)


def _ending(branch: Branch) -> tuple[Ending, SpecialPoint | None, str]:
    """Return what ends the first stretch of stable orbits, the doubling if it is one, and a sentence."""
    points, verdicts = _stretches(branch)
    stable = next((i for i, v in enumerate(verdicts) if v == "stable"), None)
    if "interrupted" in branch.stop:
        return "interrupted", None, branch.stop
    name, n = branch.parameter_name, branch.period_multiple
    if stable is None:
        first = next((q for q in points if q.kind == "period-doubling"), None)
        reason = f"no stable orbit of period {n}, and no doubling of it; {branch.stop}"
        return ("no doubling", None, reason) if first is None else ("limit", first, "")
    # the stretch lies between points[stable - 1] and points[stable]
    before = points[stable - 1] if stable > 0 else None
    after = points[stable] if stable < len(points) else None
    for q in (before, after):
        if q is not None and q.kind == "period-doubling":
            return "limit", q, ""
    q = after or (before if before is not None and before.kind != "fold" else None)
    if q is None or q.kind in ("user", "period-doubling"):
        return "no doubling", None, f"stable orbits of period {n} do not double: {branch.stop}"
    where = f"{q.kind} at {name} = {q.parameter:.10g} +- {q.error:.1e}"
    return cast(Ending, q.kind), None, f"orbits of period {n} lose their stability at a {where}"


def _stretches(branch: Branch) -> tuple[list[SpecialPoint], list[str]]:
    """Return the special points at which stability changes, and the verdicts before, between and after them.

    Grazing counts only where orbits are stable on one side and unstable on the other.
    """
    every = list(branch.special_points)
    sides = list(pairwise(_verdicts(branch, every)))
    silent = [q.kind == "user" or set(side) != {"stable", "unstable"} for q, side in zip(every, sides, strict=True)]
    points = [q for q, quiet in zip(every, silent, strict=True) if CRITICAL[q.kind] or not quiet]
    return points, _verdicts(branch, points)


def _verdicts(branch: Branch, points: list[SpecialPoint]) -> list[str]:
    """Return the verdict of the orbits before, between and after points, undecided where none is sure."""
    ends = [0, *(q.index + 1 for q in points), len(branch)]
    out = []
    for a, b in pairwise(ends):
        sure = [v for v in branch.stability[a:b].tolist() if v != "undecided"]
        out.append("undecided" if not sure else max(("stable", "unstable"), key=sure.count))
    return out


def _accumulation(doublings: list[SpecialPoint]) -> tuple[float | None, float | None]:
    """Extrapolate the doublings (Aitken), with an error."""
    at = np.array([q.parameter for q in doublings])
    d = np.diff(at)
    if len(d) < 2:
        return None, None
    ratio = d[-2] / d[-1]
    if abs(ratio / FEIGENBAUM - 1) > _PLAUSIBLE:
        return None, None
    value = at[-1] + d[-1] / (ratio - 1)
    other = at[-1] + d[-1] / (FEIGENBAUM - 1)
    if len(d) > 2:
        earlier_ratio = d[-3] / d[-2]
        before = at[-2] + d[-2] / (earlier_ratio - 1)
    else:
        before = at[-2] + d[-2] / (FEIGENBAUM * (1 + _COARSE) - 1)
    located = doublings[-1].error + doublings[-2].error
    return float(value), float(max(abs(value - other), abs(value - before) / FEIGENBAUM) + located)
