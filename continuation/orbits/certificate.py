"""All that is known about the stability of one orbit: every available method, their differences, and a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from continuation.errors import ContinuationError
from continuation.model.recent import Recent
from continuation.orbits.contact_residual import contact_defect
from continuation.orbits.floquet import distance, paired, verdict
from continuation.orbits.harmonic_balance import HarmonicBalance
from continuation.orbits.hill import CondensedHill, hill_exponents
from continuation.orbits.monodromy import monodromy
from continuation.orbits.orbit import Orbit, Stability
from continuation.orbits.shooting import Shooting

INTEGRATION, STRIP, SYMMETRIC, SHOOTING = "integration", "Hill, strip", "Hill, symmetric", "shooting"
_ROWS = 450  # of Hill's matrix in full: 0.6 s
_MOST, _FEWEST = 31, 4  # harmonics of it, per excitation period of the orbit
_COARSE = 63  # harmonics of the condensed equations, likewise, that bring an exponent near


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """Floquet multipliers of one orbit by several methods; build with :func:`certify`.

    Attributes
    ----------
    orbit : Orbit
        The orbit as harmonic balance has it (as given, where that can't represent it).
    multipliers : complex array (n,)
        By integration between the contact changes, largest modulus first; the other methods are paired with them.
    error : array (n,)
        Error bar: the larger of the integrator's estimate and the largest difference between the methods.
    methods : mapping of str to complex array (n,)
        Multipliers by each method: ``integration``, ``Hill, strip``, ``Hill, symmetric``, ``shooting``, and the method
        that the orbit came from.
    differences : mapping of str to array (n,)
        Distance of each from ``multipliers``.
    missing : mapping of str to str
        Why a method is not among them.
    liouville : float
        Logarithm of the determinant less the integrated trace of the Jacobian: checks the integration alone.
    contact_defect : float
        Error in rad of the contact phases used, against the orbit's own arguments; 0 without contacts.
    stability : "stable", "unstable" or "undecided"
    reason : str
        The verdict in one sentence.
    """

    orbit: Orbit
    multipliers: np.ndarray = field(repr=False)
    error: np.ndarray = field(repr=False)
    methods: Mapping[str, np.ndarray] = field(repr=False)
    differences: Mapping[str, np.ndarray] = field(repr=False)
    missing: Mapping[str, str]
    liouville: float
    contact_defect: float
    stability: Stability
    reason: str

    def __post_init__(self) -> None:
        for name in ("methods", "differences", "missing"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))


def certify(problem: Any, orbit: Orbit) -> Certificate:
    """Judge one orbit by every method that can.

    Parameters
    ----------
    problem : Problem
        That the orbit came from, whatever its method.
    orbit : Orbit

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        If the orbit is of another System.

    Notes
    -----
    Hill's matrix is set up in full with as many harmonics as fit into 450 rows, its exponents are chosen by two rules
    and then improved on the condensed equations with the harmonics of the orbit; no multiplier of another method
    enters. Shooting solves for the orbit anew. Cost 0.5 to 1 s for 14 states.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import HarmonicBalance, System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> duffing = System(name="duffing", states={"x": x, "v": v}, phase=theta, frequency="omega",
    ...                  derivatives={"x": v, "v": ca.cos(theta) - x - x**3 - 0.2 * v},
    ...                  parameters={"omega": (omega, 0.8)})
    >>> problem = HarmonicBalance().discretise(duffing, "omega")
    >>> result = certify(problem, problem.guess(omega=0.8))
    >>> print(result.reason)
    stable: the largest multiplier has modulus 0.455938, 0.54 inside the unit circle, more than its error bar
    >>> sorted(result.methods), bool(max(d.max() for d in result.differences.values()) < 1e-6)
    (['Hill, strip', 'Hill, symmetric', 'integration', 'shooting'], True)
    """
    if orbit.state_names != problem.system.state_names:
        raise ValueError(f"the orbit is of system {orbit.system!r}, the problem of {problem.system.name!r}")
    missing: dict[str, str] = {}
    methods: dict[str, np.ndarray] = {}
    reference, liouville, defect = _integrated(problem, orbit, methods, missing)
    own = type(problem.method).__name__
    if own == "Shooting":
        methods[SHOOTING] = orbit.multipliers
    else:
        if own != "HarmonicBalance":
            methods[own.lower()] = orbit.multipliers
        try:
            methods[SHOOTING] = _problem(Shooting(), problem, orbit).from_orbit(orbit).multipliers
        except ContinuationError as failure:
            missing[SHOOTING] = str(failure)
    return _judged(reference, methods, missing, liouville, defect, problem.system.autonomous)


def _integrated(
    problem: Any, orbit: Orbit, methods: dict[str, np.ndarray], missing: dict[str, str]
) -> tuple[Orbit, float, float]:
    """Enter integration and Hill's method on the harmonic-balance orbit; return it, Liouville's and contact defect."""
    try:
        balance, reference = _by_balance(problem, orbit)
    except ContinuationError as failure:
        missing[INTEGRATION] = missing[STRIP] = missing[SYMMETRIC] = f"no harmonic balance: {failure}"
        return orbit, np.nan, np.nan
    methods[INTEGRATION], p = reference.multipliers, reference.value
    U = balance.unknown(reference)
    inner, u = (balance.inner, balance.split(U)) if problem.system.autonomous else (balance, U)
    flow = monodromy(inner, [(u, p)])
    try:
        methods[STRIP], methods[SYMMETRIC] = _by_hill(inner, u, p)
    except ValueError as failure:
        missing[STRIP] = missing[SYMMETRIC] = str(failure)
    return reference, float(flow.liouville[0]), contact_defect(inner, u, p, flow.patterns[0])[0]


def _problem(method: Any, problem: Any, orbit: Orbit) -> Any:
    """Return the same problem by another method, at the parameters of an orbit."""
    values = {k: v for k, v in orbit.parameters.items() if k != orbit.parameter}
    return method.discretise(problem.system, orbit.parameter, period_multiple=orbit.period_multiple, **values)


def _by_balance(problem: Any, orbit: Orbit) -> tuple[Any, Orbit]:
    """Return harmonic balance and the orbit in it: the one given where it came from there, else solved for."""
    if isinstance(problem.method, HarmonicBalance):
        fixed = HarmonicBalance(harmonics=orbit.harmonic_count)
        return _problem(fixed, problem, orbit), orbit
    balance = _problem(HarmonicBalance(), problem, orbit)
    found = balance.from_orbit(orbit)
    return _problem(HarmonicBalance(harmonics=found.harmonic_count), problem, found), found


def _by_hill(problem: Any, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """Return multipliers by both rules, improved with the harmonics of the orbit; ValueError where there are none."""
    n, multiple = len(problem.system.state_names), problem.period_multiple
    harmonics = min(_MOST * multiple, (_ROWS // n - 1) // 2)
    if harmonics < _FEWEST * multiple:
        raise ValueError(f"Hill's matrix of {n} states and {_FEWEST * multiple} harmonics has more than {_ROWS} rows")
    own = max(len(u) // problem.ports.outputs // 2, _FEWEST * multiple)
    coarse = CondensedHill(problem, u, p, min(own, _COARSE * multiple))
    fine = CondensedHill(problem, u, p, own) if own > _COARSE * multiple else None
    frequency = problem.frequency(p)
    known: Recent[complex] = Recent(4 * n)  # both rules find the same exponents mostly

    def improved(exponent: complex) -> complex:
        s = coarse.correct(exponent, 8)
        if fine is None or not np.isfinite(s):
            return s
        return known.get(complex(np.round(s / frequency, 8)), lambda: fine.correct(s, 2))

    strip, symmetric = (np.array([improved(s) for s in found]) for found in hill_exponents(problem, u, p, harmonics))
    return np.exp(strip * 2 * np.pi / frequency), np.exp(symmetric * 2 * np.pi / frequency)


def _judged(
    reference: Orbit,
    methods: dict[str, np.ndarray],
    missing: dict[str, str],
    liouville: float,
    defect: float,
    autonomous: bool,
) -> Certificate:
    mu = reference.multipliers
    together = {name: paired(mu, values) for name, values in methods.items()}
    differences = {name: distance(mu, values) for name, values in methods.items()}
    error = np.max([reference.multiplier_error, *differences.values()], axis=0)
    deciding = np.arange(len(mu))
    if autonomous and np.isfinite(mu).all():
        deciding = np.delete(deciding, np.argmin(np.abs(mu - 1)))  # the flow direction
    stability = verdict(mu[deciding], error[deciding])
    reason = _reason(stability, mu[deciding], error[deciding], missing)
    return Certificate(
        orbit=reference,
        multipliers=mu,
        error=error,
        methods=together,
        differences=differences,
        missing=missing,
        liouville=liouville,
        contact_defect=defect,
        stability=stability,
        reason=reason,
    )


def _reason(stability: Stability, mu: np.ndarray, error: np.ndarray, missing: dict[str, str]) -> str:
    if not (np.isfinite(mu).all() and len(mu)):
        return "undecided: there are no multipliers"
    away = np.abs(mu) - 1
    if stability == "unstable":
        outside = int(np.sum(away > error))
        what = "one multiplier lies" if outside == 1 else f"{outside} multipliers lie"
        return f"unstable: {what} outside the unit circle by more than the error bar, the largest modulus is " + (
            f"{np.abs(mu).max():.6g}"
        )
    if stability == "stable":
        i = int(np.argmax(away))
        return (
            f"stable: the largest multiplier has modulus {abs(mu[i]):.6g}, {-away[i]:.2g} inside the unit circle, more "
            "than its error bar"
        )
    i = int(np.argmin(np.abs(away) - error))
    return (
        f"undecided: a multiplier of modulus {abs(mu[i]):.9g} lies within its error bar of {error[i]:.1e} of the unit "
        "circle" + (f"; not available: {', '.join(missing)}" if missing else "")
    )
