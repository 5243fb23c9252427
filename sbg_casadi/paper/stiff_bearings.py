"""Figure 2: very stiff bearings leave the oscillator with one degree of freedom, at the rate 1/K."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from continuation import Contact, ContinuationError, HarmonicBalance, Orbit, System, trace
from continuation.branches.newton import Metric, correct, size_of
from continuation.orbits.spectrum import unpack
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import STATE
from sbg_casadi.model import gear_system, harmonic_sum
from sbg_casadi.paper.plan import Plan, Subject
from sbg_casadi.progress import Report
from sbg_casadi.response import PARAMETER

FACTORS = (1e4, 1e6, 1e8)
"""Of every bearing stiffness."""

_ORBITS = 24
_METHOD = HarmonicBalance(harmonics=31)  # one truncation on both sides, so that it drops out of the difference


def one_degree_of_freedom(d: Dimensionless) -> System:
    """Build ``lambda'' = a3 T - a3^2 G``, equation (23) with bearings that don't move and e = 0.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> one_degree_of_freedom(load_pair("case1").dimensionless()).state_names
    ('lambda', 'dlambda')
    """
    lam, dlam, theta, ratio = (ca.SX.sym(n) for n in (STATE, f"d{STATE}", "theta", PARAMETER))
    slopes = (d.coast_stiffness_ratio, 0.0, 1.0)
    mesh = Contact(argument=lam, breakpoints=(-1.0, 1.0), slopes=slopes, name="mesh")
    k = 1 + harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta)
    force = k * mesh.force + 2 * d.mesh_damping_ratio * dlam
    a3 = d.tangential_cosine
    return System(
        name="one degree of freedom",
        states={STATE: lam, f"d{STATE}": dlam},
        derivatives={STATE: dlam, f"d{STATE}": a3 * d.torque - a3**2 * force},
        phase=theta,
        frequency=PARAMETER,
        parameters={PARAMETER: (ratio, 1.0)},
        contacts=[mesh],
    )


def stiffened(d: Dimensionless, factor: float) -> Dimensionless:
    """Multiply every bearing stiffness and keep the damping ratio of the bearings, C_i = zeta sqrt(K_i)."""
    return replace(
        d,
        bearing_stiffness=tuple(factor * k for k in d.bearing_stiffness),
        bearing_damping=tuple(np.sqrt(factor) * c for c in d.bearing_damping),
        error_cosine=(),
        error_sine=(),
    )


def stiff_bearings_part(subject: Subject, plan: Plan, report: Report) -> dict[str, Any]:
    """Return the RMS of both models over the frequency ratio and how their difference falls, JSON-ready.

    The stiff model is solved from orbits of the simple one: followed by integration it would need very small steps.
    Next to a fold it may have no orbit at the same frequency ratio; that is listed in ``skipped``.

    Raises
    ------
    ContinuationError
        If the oscillator can't be traced, or many stiff orbits can't be found.
    """
    d = subject.pair.dimensionless("before")
    problem = _METHOD.discretise(one_degree_of_freedom(d), PARAMETER)
    low, high = plan.span
    report(0.0, "one degree of freedom")
    branch = trace(problem, problem.guess(**{PARAMETER: high}), (high, low))
    if "interrupted" in branch.stop:
        raise KeyboardInterrupt(branch.stop)
    orbits = [branch.orbits[i] for i in np.unique(np.linspace(0, len(branch) - 1, _ORBITS).astype(int))]
    ratios = [o.value for o in orbits]
    simple = [_rms(problem, o) for o in orbits]
    curves: list[dict[str, Any]] = []
    skipped: list[str] = []
    for n, factor in enumerate(FACTORS):
        report((1 + n) / (1 + len(FACTORS)), f"bearings {factor:g} times as stiff")
        system = gear_system(stiffened(d, factor))
        stiff = _METHOD.discretise(system, PARAMETER)
        rms: list[float | None] = []
        for orbit in orbits:
            try:
                rms.append(_rms(stiff, _at_rest(orbit, system)))
            except ContinuationError as error:
                rms.append(None)
                skipped.append(f"bearings {factor:g} times as stiff, ratio {orbit.value:.4f}: {error}")
        off = [abs(a - b) for a, b in zip(rms, simple, strict=True) if a is not None]
        median = float(np.median(off)) if off else None
        curves.append(
            {"factor": factor, "rms": rms, "median_difference": median, "largest_difference": max(off, default=None)}
        )
    if len(skipped) > len(orbits) // 2:
        raise ContinuationError("; ".join(skipped))
    return {
        "pair": subject.file,
        "frequency_ratio": ratios,
        "simple": simple,
        "curve": {"frequency_ratio": [o.value for o in branch.orbits], "rms": branch.rms(STATE).tolist()},
        "stiff": curves,
        "rates": _rates(simple, [c["rms"] for c in curves]),
        "skipped": skipped,
    }


def _rates(simple: list[float], stiff: list[list[float | None]]) -> list[float | None]:
    """Return by how much the difference falls from factor to factor, the median over the frequency ratios.

    Next to a fold a difference at one frequency is no measure: the fold itself moves by as much.
    """
    table = np.array(stiff, dtype=float) - simple
    with np.errstate(divide="ignore", invalid="ignore"):
        falls = np.abs(table[:-1] / table[1:])
    return [float(np.median(row[np.isfinite(row)])) if np.isfinite(row).any() else None for row in falls]


def _rms(problem: Any, guess: Orbit) -> float:
    """Return the RMS of lambda about its mean, corrected at its ratio; multipliers would need very small steps."""
    u = problem.unknown(guess)
    node = correct(problem, (u, guess.value), (np.zeros_like(u), 1.0), Metric(size_of(u), 1.0))
    return float(np.sqrt(2 * np.sum(np.abs(unpack(node.u, 1)[1:]) ** 2)))


def _at_rest(orbit: Orbit, system: System) -> Orbit:
    """Return an orbit of the oscillator as a guess for all fourteen states, the bearings at rest."""
    coefficients = np.zeros((len(orbit.coefficients), len(system.state_names)), dtype=complex)
    for name in orbit.state_names:
        coefficients[:, system.state_names.index(name)] = orbit.coefficients[:, orbit.index(name)]
    return replace(orbit, system=system.name, state_names=system.state_names, coefficients=coefficients)
