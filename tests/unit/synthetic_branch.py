"""Branches made by hand, for tests of what is done with results."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from continuation.branches.branch import Branch, Kind, SpecialPoint
from continuation.orbits.orbit import Orbit, Stability


def make_orbit(
    value: float,
    amplitude: float = 1.0,
    *,
    harmonics: int = 3,
    stability: Stability = "stable",
    multipliers: Sequence[complex] = (0.5, 0.1),
) -> Orbit:
    """Return an orbit with x = 0.2 + amplitude cos(phi) + small higher harmonics and v = dx/dphi."""
    orders = np.arange(harmonics + 1)
    x = amplitude / 2 / np.maximum(orders, 1.0) ** 4 * np.exp(-0.3j * (orders > 1))
    x[0] = 0.2
    return Orbit(
        system="synthetic",
        state_names=("x", "v"),
        parameter="omega",
        parameters={"omega": value, "g": 0.1},
        period=2 * np.pi / value,
        period_multiple=1,
        coefficients=np.column_stack([x, 1j * orders * x]),
        multipliers=np.array(multipliers, dtype=complex),
        multiplier_error=np.full(len(multipliers), 1e-9),
        stability=stability,
        error=1e-7 * value,
    )


def make_point(kind: Kind, orbit: Orbit, index: int, *, note: str = "") -> SpecialPoint:
    """Return a located special point between branch points ``index`` and ``index + 1``."""
    return SpecialPoint(
        kind=kind,
        parameter=orbit.value,
        error=3e-11,
        orbit=orbit,
        bracket=(orbit.value - 0.1, orbit.value + 0.1),
        index=index,
        note=note,
        problem=object(),
    )


def folded_branch() -> Branch:
    """Return a branch that is stable up to a fold at omega 1.3, then unstable, of 2 to 5 harmonics."""
    orbits = (
        make_orbit(1.0, 0.5, harmonics=2),
        make_orbit(1.2, 0.8, harmonics=5),
        make_orbit(1.25, 1.2, harmonics=3, stability="unstable", multipliers=(1.7, 0.1)),
        make_orbit(1.1, 1.3, harmonics=3, stability="unstable", multipliers=(2.1, 0.1)),
    )
    fold = make_point("fold", make_orbit(1.3, 1.0, stability="undecided", multipliers=(1.0, 0.1)), 1, note="tight ±")
    return Branch(
        orbits=orbits,
        special_points=(fold,),
        stop="reached omega = 1.1",
        work={"newton_steps": 12, "seconds": 0.1},
        provenance={"method": "by hand", "versions": "none"},
        unresolved=("omega 1.25 to 1.1: nobody looked",),
    )
