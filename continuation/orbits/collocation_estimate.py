"""Error of a collocation point from one Newton step with polynomials of one degree more on the same intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.branches.newton import size_of
from continuation.branches.sparse_bordered import factorised, solve_bordered
from continuation.orbits.collocation_mesh import Mesh, Monitor, table
from continuation.orbits.near_fold import measures_error

_ROUNDING = 1e-14  # of the size, times the number of intervals


@dataclass(frozen=True, slots=True)
class Estimate:
    """First-order error of a point (u, p).

    ``better`` is the unknown of one degree more on ``mesh``, at the same parameter, or ``shift`` away next to a fold,
    where the change at fixed parameter is no measure: there it is the nearest point of the better branch.
    ``dfrequency`` is the relative change of the frequency that goes with it for an autonomous System. ``error`` is the
    largest distance from u to it; ``ends`` the part of that at the ends of the intervals, which falls with the power
    2m of their lengths, not m + 1. ``shortest`` and ``dp`` are distance and parameter change to the nearest point.
    ``at_fold`` tells that only that is known. ``monitor`` tells where intervals are needed.
    """

    mesh: Mesh
    better: np.ndarray
    shift: float
    dfrequency: float
    error: float
    dp: float
    shortest: float
    ends: float
    at_fold: bool
    monitor: Monitor


def estimate_error(problem: Any, u: np.ndarray, p: float) -> Estimate:
    """Return the estimate of a point (u, p) of a CollocationProblem; cost about 1.5 Newton steps.

    Where the linearised equations are exactly singular or not finite the error is infinite.
    """
    mesh, finer = problem.mesh(u), problem.elevated(u)
    start = finer.unknown(mesh.evaluate(mesh.values(u), finer.positions))
    unit, size = problem.parameter_scale(p), size_of(u)
    x, y, turn = _newton_step(problem, finer, start, p, unit)
    # shortest change of (u, p) instead of the one at fixed p, so that it stays finite at folds
    nearest = float(x @ y) / (float(y @ y) + size**2)
    shortest, fixed = (finer.largest(finer.values(v)) for v in (x - nearest * y, x))
    finite = bool(np.isfinite(fixed + shortest))
    at_fold = finite and not measures_error(fixed, shortest, size)
    d = nearest if at_fold else 0.0
    step = x - d * y if finite else np.zeros_like(x)
    rounding = _ROUNDING * size * mesh.count
    last = table(finer.degree).to_legendre[-1] @ finer.values(start + step)[finer.index]  # (N, n)
    return Estimate(
        mesh=finer,
        better=start + step,
        shift=d * unit if finite else 0.0,
        dfrequency=float(turn[0] - d * turn[1]) if finite else 0.0,
        error=(shortest if at_fold else fixed) + rounding if finite else np.inf,
        dp=nearest * unit if finite else 0.0,
        shortest=shortest + rounding if finite else np.inf,
        ends=float(np.abs(finer.values(step)[finer.index[:, 0]]).max(initial=0.0)),
        at_fold=at_fold,
        monitor=Monitor.of(mesh.ends, np.abs(last).max(axis=1), mesh.degree),
    )


def _newton_step(
    problem: Any, mesh: Mesh, u: np.ndarray, p: float, unit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the Newton step x (N,) at fixed parameter, y (N,) such that ``x - d y`` is the one with dp = d unit.

    With a free frequency the matrix has its column and the row that keeps the phase; ``turn`` (2,) is then the relative
    change of the frequency that goes with x and y.
    """
    vector = problem.vector(p)
    F, J, Fp = problem.equations.linearise(mesh, u, vector)
    right = np.stack([-F, Fp * unit], axis=1)
    problem.factorisations += 1
    nothing = np.full_like(F, np.nan), np.zeros_like(F), np.zeros(2)
    if not (np.all(np.isfinite(right)) and np.all(np.isfinite(J.data))):
        return nothing
    if not problem.free:
        lu = factorised(J)
        if lu is None:
            return nothing
        x, y = lu.solve(right).T
        return x, y, np.zeros(2)
    column = problem.equations.derivative(mesh, u, vector, problem.free) * problem.values[problem.free]
    direction = mesh.unknown(mesh.slopes(mesh.values(u)))
    row = np.append(direction / size_of(direction), 0.0)
    found = solve_bordered(J, column, row, np.vstack([right, np.zeros(2)]))
    return nothing if found is None else (found[0][:-1, 0], found[0][:-1, 1], found[0][-1])
