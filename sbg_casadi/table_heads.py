"""Titles of the columns of a measured table: quantity, member, torque and unit."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

from sbg_casadi.errors import PairError
from sbg_casadi.units import QuantityError, factor, parse_quantity

Quantity = Literal["loaded TE", "unloaded TE", "stiffness"]
Member = Literal["pinion", "gear", "normal"]

EXAMPLE = "phase [1], loaded TE gear 300 N m [urad], unloaded TE gear [urad]"

_MEMBERS: dict[str, Member] = {"pinion": "pinion", "gear": "gear", "normal": "normal"}
_FIRST = re.compile(r"(phase|pinion (?:roll )?angle|gear (?:roll )?angle)\s*\[\s*(.*?)\s*\]", re.I)
_FURTHER = re.compile(
    r"(?:(?P<error>(?:un)?loaded TE)\s+(?P<member>pinion|gear|normal)|(?P<stiffness>stiffness))"
    r"(?:\s+(?P<torque>[\d.+-][^\[]*?))?\s*\[\s*(?P<unit>.*?)\s*\]",
    re.I,
)


class Head(NamedTuple):
    """What the title of a further column says; ``scale`` takes its numbers into SI units."""

    quantity: Quantity
    member: Member
    angular: bool
    torque: float | None
    scale: float


def read_first(title: str, where: str) -> tuple[Literal["phase", "pinion", "gear"], float]:
    """Return what the first column is, and the factor that takes it into cycles or radians.

    Raises
    ------
    PairError
        If the title or its unit is not one of those allowed.

    Examples
    --------
    >>> read_first("phase [1]", "line 1")
    ('phase', 1.0)
    """
    match = _FIRST.fullmatch(title)
    if match is None:
        raise PairError(
            f"{where}: the first column is {title[:60]!r}; expected phase [1], pinion angle [deg] or gear angle [deg]"
        )
    name, unit = match[1].lower().split()[0], match[2]
    abscissa: Literal["phase", "pinion", "gear"] = "phase"
    if name == "phase":
        if unit != "1":
            raise PairError(f"{where}: phase has the unit {unit!r}; expected phase [1], where one mesh cycle is 1")
        return abscissa, 1.0
    abscissa = "pinion" if name == "pinion" else "gear"
    return abscissa, _factor(unit, ("rad",), title, where)[0]


def read_further(title: str, where: str) -> Head:
    """Read the title of a further column.

    Raises
    ------
    PairError
        If the title can't be read, or its unit or torque doesn't fit.

    Examples
    --------
    >>> read_further("loaded TE gear 300 N m [urad]", "line 1")
    Head(quantity='loaded TE', member='gear', angular=True, torque=300.0, scale=1e-06)
    """
    match = _FURTHER.fullmatch(title)
    if match is None:
        raise PairError(
            f"{where}: can't read the column {title[:60]!r}; expected loaded TE, unloaded TE (of pinion, gear or "
            f"normal) or stiffness with a unit in brackets, such as '{EXAMPLE}'"
        )
    torque = None
    if match["torque"] is not None:
        try:
            torque = parse_quantity(match["torque"], "N m")[0]
        except QuantityError as fault:
            raise PairError(f"{where}: torque {match['torque']!r} {fault}; expected such as 300 N m") from None
        if not torque > 0:
            raise PairError(f"{where}: torque {match['torque']!r} is not positive; expected such as 300 N m")
    if match["stiffness"]:
        return Head("stiffness", "normal", False, torque, _factor(match["unit"], ("N/m",), title, where)[0])
    quantity: Quantity = "loaded TE" if match["error"].lower() == "loaded te" else "unloaded TE"
    if quantity == "unloaded TE" and torque is not None:
        raise PairError(f"{where}: the column {title[:60]!r} has a torque; expected none for an unloaded TE")
    member = _MEMBERS[match["member"].lower()]
    scale, target = _factor(match["unit"], ("m",) if member == "normal" else ("rad", "m"), title, where)
    return Head(quantity, member, target == "rad", torque, scale)


def _factor(unit: str, targets: tuple[str, ...], title: str, where: str) -> tuple[float, str]:
    """Return the factor of a unit and which of the SI targets it leads to."""
    fault = ""
    for target in targets:
        try:
            return factor(unit, target), target
        except QuantityError as error:
            fault = str(error)
    wanted = {"rad": "deg, urad, arcsec", "m": "um", "N/m": "N/um, N/m"}
    raise PairError(f"{where}: {title[:60]!r} {fault}; expected {' or '.join(wanted[t] for t in targets)}") from None
