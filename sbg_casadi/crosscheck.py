"""Brute-force sweeps against the stable branch: the same root mean square by two independent ways."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from continuation.branches.branch import Branch
from continuation.errors import ContinuationError
from continuation.orbits.orbit import Orbit
from continuation.plotting import sweep_direction
from continuation.timedomain.sweep import FAILED, Sweep
from sbg_casadi.documents import STATE

SAME = 1e-3
"""Difference in RMS (half backlashes) up to which a period-1 attractor counts as the orbit of the branch."""


def cross_check(problem: Any, branch: Branch, sweeps: Sequence[Sweep]) -> dict[str, Any]:
    """Compare sweeps with the stable orbits of a branch at exactly the frequencies swept.

    Parameters
    ----------
    problem : Problem
        What the branch was traced with; solves for the orbits at the swept frequencies (no interpolation).
    branch : Branch
        Period-1 branch over the same frequency ratio.
    sweeps : sequence of Sweep
        Sweeps of ``lambda``, up and down.

    Returns
    -------
    dict
        ``sweeps``: for each the direction and its points (frequency ratio, RMS in half backlashes, period, attractor
        in words, RMS of the nearest stable orbit and the difference, None where there is none); ``compared``,
        ``largest_difference``, ``at``, ``direction``: over the period-1 attractors that lie on the branch;
        ``elsewhere``: frequency, direction and attractor of all others.

    Notes
    -----
    About 10 ms per crossing of the branch and frequency.
    """
    crossings: dict[float, list[Orbit]] = {}
    documents, elsewhere, compared = [], [], []
    for sweep in sweeps:
        direction, points = sweep_direction(sweep), []
        for i, value in enumerate(sweep.values.tolist()):
            if value not in crossings:
                crossings[value] = stable_orbits(problem, branch, value)
            point = _compare(sweep, i, crossings[value])
            points.append(point)
            where = {"frequency_ratio": value, "direction": direction}
            if point["attractor"] == "on the stable branch":
                compared.append(where | {"difference": point["difference"]})
            else:
                elsewhere.append(where | {"attractor": point["attractor"]})
        documents.append({"direction": direction, "method": sweep.method, "points": points})
    worst = max(compared, key=lambda c: c["difference"], default=None)
    return {
        "sweeps": documents,
        "compared": len(compared),
        "largest_difference": None if worst is None else worst["difference"],
        "at": None if worst is None else worst["frequency_ratio"],
        "direction": None if worst is None else worst["direction"],
        "elsewhere": elsewhere,
    }


def stable_orbits(problem: Any, branch: Branch, value: float) -> list[Orbit]:
    """Return the stable orbits of a branch at a parameter value, one for each time the branch passes it."""
    gap = branch.parameter - value
    passes = np.flatnonzero(gap[:-1] * gap[1:] <= 0)
    found: list[Orbit] = []
    for i in passes:
        near = branch.orbits[i if abs(gap[i]) <= abs(gap[i + 1]) else i + 1]
        try:
            orbit = problem.solve(near, value)
        except ContinuationError:  # beside a fold the other sheet may win; its own pass finds it
            continue
        if orbit.stability == "stable":
            found.append(orbit)
    return found


def _compare(sweep: Sweep, i: int, orbits: Sequence[Orbit]) -> dict[str, Any]:
    """Return one point of a sweep with the stable orbit nearest in root mean square."""
    value, rms, period = float(sweep.values[i]), float(sweep.rms[i]), int(sweep.period[i])
    point: dict[str, Any] = {
        "frequency_ratio": value,
        "rms": rms if np.isfinite(rms) else None,
        "period": period,
        "periods_used": int(sweep.periods_used[i]),
        "attractor": _attractor(period, sweep.failures[i]),
        "branch_rms": None,
        "difference": None,
    }
    if period == 1:
        nearest = min((o.rms(STATE) for o in orbits), key=lambda r: abs(r - rms), default=None)
        if nearest is not None and abs(nearest - rms) <= SAME:
            point |= {"attractor": "on the stable branch", "branch_rms": nearest, "difference": abs(nearest - rms)}
        else:
            point["attractor"] = "period 1, on no stable part of this branch"
    return point


def _attractor(period: int, failure: str) -> str:
    if period == FAILED:
        return f"integration failed: {failure}"
    return f"period {period}" if period else "no period recognised"
