"""The quantities a map can be drawn over, as a System with that quantity as a parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import zip_longest
from typing import Any

import casadi as ca

from continuation import System
from continuation.errors import nearest
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.errors import PairError, UserError
from sbg_casadi.model import error_sum, gear_parameters, harmonic_sum, pair_system
from sbg_casadi.pair import Pair
from sbg_casadi.reading import Reading, as_read

COMPARED = ("before", "after")
_HARMONICS = ("stiffness_cosine", "stiffness_sine", "error_cosine", "error_sine")


@dataclass(frozen=True, slots=True)
class Varied:
    """A pair with one more quantity that may change, besides the frequency ratio.

    Attributes
    ----------
    name : str
        What the user calls it, one of :data:`QUANTITIES`.
    system : System
        The equations; ``parameter`` is one of its parameters.
    parameter : str
    label : str
        What an axis says.
    factor : float
        A value shown is the parameter of the System times this (N m, mm); 1 where both are the same.
    unit : str
        Unit of what is shown, empty for a plain number.
    span : (float, float)
        Default range of the values shown.
    dimensionless : Dimensionless
        Of the pair as given (for a modification: before it).
    at : callable
        Value shown -> the plain numbers of the pair there; raises PairError where there is no such pair.
    """

    name: str
    system: System
    parameter: str
    label: str
    factor: float
    unit: str
    span: tuple[float, float]
    dimensionless: Dimensionless
    at: Callable[[float], Dimensionless]

    def inner(self, shown: float) -> float:
        """Return the parameter of the System for a value shown."""
        return shown / self.factor


def vary(pair: Pair, name: str, state: str | None, reading: Reading) -> Varied:
    """Return a pair as a System with a quantity as parameter.

    Parameters
    ----------
    pair : Pair
    name : str
        One of :data:`QUANTITIES`.
    state : str or None
        State that the other quantities are varied in, the first when None; a modification goes from ``before`` to
        ``after``.
    reading : frozenset of int
        Rows of the ledger taken as printed.

    Raises
    ------
    UserError
        For an unknown name, a state with ``modification``, or a pair without the states that it needs.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> varied = vary(load_pair("iso-f2"), "modification", None, frozenset())
    >>> varied.parameter, varied.span, varied.system.parameter_names
    ('modification', (0.0, 1.5), ('frequency_ratio', 'torque', 'mesh_damping_ratio', 'modification'))
    >>> vary(load_pair("example"), "tork", None, frozenset())
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --over tork: expected modification, torque, damping, backlash or fluctuation; did you \
mean 'torque'?
    """
    if name not in QUANTITIES:
        listed = ", ".join(QUANTITIES[:-1]) + f" or {QUANTITIES[-1]}"
        close = nearest(name, QUANTITIES)
        raise UserError(f"--over {name}: expected {listed}" + (f"; {close}" if close.startswith("did") else ""))
    if name == "modification":
        return _modification(pair, state, reading)
    return _OF_ONE_STATE[name](pair, as_read(pair, state, reading), reading)


def _modification(pair: Pair, state: str | None, reading: Reading) -> Varied:
    """Interpolate the harmonics of stiffness and error: ``before`` at 0, ``after`` at 1."""
    missing = [s for s in COMPARED if s not in pair.states]
    if missing:
        raise PairError(
            f"pair {pair.name!r} has no state {missing[0]!r} (it has {', '.join(pair.states)}); expected the states "
            "'before' and 'after', between which --over modification interpolates"
        )
    if state is not None:
        raise UserError(f"--state {state}: --over modification goes from state before to after; expected no --state")
    before, after = (as_read(pair, s, reading) for s in COMPARED)
    for item in fields(before):
        if item.name not in (*_HARMONICS, "state") and getattr(before, item.name) != getattr(after, item.name):
            raise PairError(
                f"pair {pair.name!r}: {item.name} differs between before and after; --over modification interpolates "
                "harmonics of stiffness and error alone"
            )
    t, theta = ca.SX.sym("modification"), ca.SX.sym("theta")
    k = 1 + _blend(t, *(harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta) for d in (before, after)))
    e = _blend(t, *(error_sum(d, reading, theta) for d in (before, after)))
    system = pair_system(before, reading, theta, k, e, {**gear_parameters(before), "modification": (t, 0.0)})
    label = "amount of modification (0 before, 1 after)"

    def at(amount: float) -> Dimensionless:
        series: dict[str, Any] = {
            name: _mixed(amount, getattr(before, name), getattr(after, name)) for name in _HARMONICS
        }
        return replace(before, state=f"modification {amount:g}", **series)

    return Varied("modification", system, "modification", label, 1.0, "", (0.0, 1.5), before, at)


def _blend(t: ca.SX, before: ca.SX, after: ca.SX) -> ca.SX:
    return (1 - t) * before + t * after


def _mixed(t: float, before: tuple[float, ...], after: tuple[float, ...]) -> tuple[float, ...]:
    return tuple((1 - t) * b + t * a for b, a in zip_longest(before, after, fillvalue=0.0))


def _scaled(factor: float, series: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(factor * v for v in series)


def _torque(pair: Pair, d: Dimensionless, reading: Reading) -> Varied:
    derived = pair.derived
    factor, unit, label = 1.0, "", "torque T"
    if derived is not None:
        factor, unit, label = derived.pinion_torque / d.torque, "N m", "pinion torque"
    given, scale = d.torque * factor, factor

    def at(shown: float) -> Dimensionless:
        return replace(d, torque=shown / scale)

    return Varied("torque", _system(d, reading), "torque", label, factor, unit, (given / 4, 4 * given), d, at)


def _damping(pair: Pair, d: Dimensionless, reading: Reading) -> Varied:
    span = (d.mesh_damping_ratio / 4, 4 * d.mesh_damping_ratio) if d.mesh_damping_ratio else (0.0, 0.1)
    return Varied(
        "damping",
        _system(d, reading),
        "mesh_damping_ratio",
        "mesh damping ratio",
        1.0,
        "",
        span,
        d,
        lambda shown: replace(d, mesh_damping_ratio=shown),
    )


def _backlash(pair: Pair, d: Dimensionless, reading: Reading) -> Varied:
    """Scale T and e(theta), which are over half the backlash; lengths stay over half the backlash as it is then."""
    r, theta = ca.SX.sym("backlash"), ca.SX.sym("theta")
    parameters = {**gear_parameters(d), "backlash": (r, 1.0)}
    k = 1 + harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta)
    e = error_sum(d, reading, theta) / r
    system = pair_system(d, reading, theta, k, e, parameters, parameters["torque"][0] / r)
    full, unit, label = 1.0, "", "backlash over the given one"
    if pair.derived is not None:
        full, unit, label = 2e3 * pair.derived.half_backlash, "mm", "backlash, mean normal"

    def at(shown: float) -> Dimensionless:
        if not shown > 0:
            raise PairError(f"pair {d.name!r}: backlash {shown:g}; expected a positive backlash")
        series: dict[str, Any] = {
            name: _scaled(full / shown, getattr(d, name)) for name in ("error_cosine", "error_sine")
        }
        return replace(d, torque=d.torque * full / shown, **series)

    return Varied("backlash", system, "backlash", label, full, unit, (full / 4, 4 * full), d, at)


def _fluctuation(pair: Pair, d: Dimensionless, reading: Reading) -> Varied:
    """Scale the harmonics of the mesh stiffness."""
    c, theta = ca.SX.sym("fluctuation"), ca.SX.sym("theta")
    k = 1 + c * harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta)
    parameters = {**gear_parameters(d), "fluctuation": (c, 1.0)}
    system = pair_system(d, reading, theta, k, error_sum(d, reading, theta), parameters)
    label = "fluctuation of the mesh stiffness over the given one"

    def at(shown: float) -> Dimensionless:
        series: dict[str, Any] = {
            name: _scaled(shown, getattr(d, name)) for name in ("stiffness_cosine", "stiffness_sine")
        }
        return replace(d, **series)

    return Varied("fluctuation", system, "fluctuation", label, 1.0, "", (0.0, 1.25), d, at)


def _system(d: Dimensionless, reading: Reading) -> System:
    theta = ca.SX.sym("theta")
    k = 1 + harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta)
    return pair_system(d, reading, theta, k, error_sum(d, reading, theta), gear_parameters(d))


_OF_ONE_STATE: dict[str, Callable[[Pair, Dimensionless, Reading], Varied]] = {
    "torque": _torque,
    "damping": _damping,
    "backlash": _backlash,
    "fluctuation": _fluctuation,
}
QUANTITIES = ("modification", *_OF_ONE_STATE)
"""What ``--over`` takes."""
