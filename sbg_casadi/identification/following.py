"""Targets that an orbit, a smooth peak or a fold answers: found once from a run in time, then followed by Newton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation import ContinuationError, HarmonicBalance, NoConvergence, trace
from continuation.branches.branch import Branch
from continuation.orbits.spectrum import pack
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.identification.parametric import Parametric
from sbg_casadi.identification.runs import Runs
from sbg_casadi.identification.scoring import grid
from sbg_casadi.identification.sensitivity import (
    Sensitive,
    fold_at,
    orbit_at,
    orbit_rms,
    peak_at,
    set_values,
    solve_orbit,
)
from sbg_casadi.identification.targets import Target
from sbg_casadi.response import PARAMETER

LONGEST = 4
"""Mesh periods of the longest response that is followed."""

_SAMPLES = 128  # per mesh period of the run that an orbit starts from
_SAME = 0.05  # difference of the RMS, relative, up to which run and orbit are one response
_BEYOND = 1.1  # of the band of a jump, how far the response is traced
_TOLERANCE = 1e-6


@dataclass(slots=True, eq=False)
class Follower:
    """Follow the solution that answers one target, from candidate to candidate.

    Attributes
    ----------
    target : Target
    place : int
        Index of its first residual.
    kind : {"orbit", "peak", "fold"}
    problem : Problem
    u : ndarray
        Last solution.
    ratio : float
    span : (float, float)
        Where a smooth peak is looked for.
    """

    target: Target
    place: int
    kind: str
    problem: Any
    u: np.ndarray
    ratio: float
    span: tuple[float, float]

    def solve(self, values: dict[str, float], names: Sequence[str]) -> Sensitive:
        """Solve at the numbers of a candidate, with the gradients in some of them (raises NoConvergence)."""
        set_values(self.problem, values)
        if self.kind == "orbit":
            found = orbit_at(self.problem, self.u, self.ratio, names)
        elif self.kind == "peak":
            found = peak_at(self.problem, self.u, self.ratio, names, self.span)
        else:
            found = fold_at(self.problem, self.u, self.ratio, names)
        return found

    def keep(self, found: Sensitive) -> None:
        """Begin the next solution at this one."""
        self.u, self.ratio = found.u, found.ratio

    def values(self, found: Sensitive) -> tuple[float, ...]:
        """Return what the target asks for."""
        return tuple(found.ratio if q == "position" else found.rms for q, _, _ in self.target.wanted)

    def residuals(self, found: Sensitive) -> np.ndarray:
        """Return the residuals in tolerances."""
        pairs = zip(self.values(found), self.target.wanted, strict=True)
        return np.array([(v - wanted) / tolerance for v, (_, wanted, tolerance) in pairs])

    def gradient(self, found: Sensitive) -> np.ndarray:
        """Return the derivatives (residuals, names) of the residuals."""
        rows = [
            (found.ratio_gradient if q == "position" else found.rms_gradient) / tolerance
            for q, _, tolerance in self.target.wanted
        ]
        return np.array(rows)


def follow(equations: Parametric, runs: Runs, target: Target, place: int, d: Dimensionless) -> Follower | str:
    """Return the follower of a target at a candidate, or the reason why there is none.

    A regime or an exponent has none; neither has a target whose response repeats after more than four mesh periods or
    not at all.
    """
    if target.kind in ("regime", "exponent"):
        return f"a {target.kind} has no gradient that is used; it is checked in the time domain"
    try:
        if target.kind == "rms":
            return _orbit(equations, runs, target, place, d)
        if target.kind == "peak":
            return _peak(equations, runs, target, place, d)
        return _jump(equations, target, place, d)
    except (ContinuationError, ValueError, np.linalg.LinAlgError) as error:
        return f"its orbit could not be followed: {error}"


def _problem(equations: Parametric, d: Dimensionless, period: int) -> Any:
    problem = HarmonicBalance(tolerance=_TOLERANCE).discretise(equations.system, PARAMETER, period_multiple=period)
    set_values(problem, equations.values(d))
    return problem


def _first(
    equations: Parametric, runs: Runs, d: Dimensionless, ratio: float, start: np.ndarray | None
) -> tuple[Any, np.ndarray]:
    """Return problem and orbit of the response that a run leads to; ContinuationError says why there is none."""
    response = runs.response(d, ratio, start)
    if not 1 <= response.period <= LONGEST:
        what = f"period {response.period}" if response.period else "no period that was seen"
        raise NoConvergence(f"the response at {ratio:.4g} has {what}; up to period {LONGEST} are followed")
    problem = _problem(equations, d, response.period)
    wave = runs.waveform(d, ratio, response.state, response.period, _SAMPLES)
    spectrum = np.fft.rfft(wave, norm="forward")[: 32 * response.period]
    u = solve_orbit(problem, pack(spectrum[:, None]), ratio)
    if abs(orbit_rms(problem, u) - response.rms) > _SAME * response.rms:
        raise NoConvergence(f"harmonic balance leads to another orbit than the run at {ratio:.4g}")
    return problem, u


def _orbit(equations: Parametric, runs: Runs, target: Target, place: int, d: Dimensionless) -> Follower:
    problem, u = _first(equations, runs, d, target.at, None)
    return Follower(target, place, "orbit", problem, u, target.at, target.band)


def _peak(equations: Parametric, runs: Runs, target: Target, place: int, d: Dimensionless) -> Follower:
    """Follow a smooth maximum next to the largest response of a sweep, or the fold that it ends in."""
    ratios = grid(target.band)
    swept = runs.sweep(d, ratios)
    row, i = np.unravel_index(int(np.argmax(swept.rms)), swept.rms.shape)
    at, width = float(ratios[i]), float(ratios[1] - ratios[0])
    problem, u = _first(equations, runs, d, at, swept.states[row, i])
    span = max(at - 2 * width, target.band[0]), min(at + 2 * width, target.band[1])
    highest = float(swept.rms.max())
    try:
        found = peak_at(problem, u, at, (), span)
        if found.rms >= (1 - _SAME) * highest:
            return Follower(target, place, "peak", problem, found.u, found.ratio, span)
    except NoConvergence:
        pass  # no smooth maximum: look for a fold
    orbit = problem.orbits([(u, at, problem.error(u, at))])[0]
    for stop in (span[1] + width, span[0] - width):
        branch = trace(problem, orbit, span=(at, stop))
        folds = [q for q in branch.special_points if q.kind == "fold" and q.orbit.rms("lambda") > (1 - _SAME) * highest]
        if folds:
            return _fold(target, place, problem, folds[0], span)
    raise NoConvergence(f"the peak near {at:.4g} is neither a smooth maximum nor a fold")


def _jump(equations: Parametric, target: Target, place: int, d: Dimensionless) -> Follower:
    """Follow the fold of the period-1 response that is nearest to the target."""
    problem = _problem(equations, d, 1)
    wanted = target.wanted[0][1]
    low, high = target.band[0] / _BEYOND, target.band[1] * _BEYOND  # the partner of a fold may lie outside
    branch: Branch = trace(problem, problem.guess(frequency_ratio=high), span=(high, low))
    inside = (q for q in branch.special_points if target.band[0] <= q.parameter <= target.band[1])
    folds = [q for q in inside if q.kind == "fold"]
    if not folds:
        raise NoConvergence(f"the period-1 response has no fold from {target.band[0]:g} to {target.band[1]:g}")
    return _fold(target, place, problem, min(folds, key=lambda q: abs(q.parameter - wanted)), target.band)


def _fold(target: Target, place: int, problem: Any, point: Any, span: tuple[float, float]) -> Follower:
    u = problem.unknown(point.orbit)
    return Follower(target, place, "fold", problem, u, point.parameter, span)
