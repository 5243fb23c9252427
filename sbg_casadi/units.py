"""Quantities written as text with a unit, read into SI numbers."""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import Any

# The number is taken apart from the unit here, so that pint never evaluates arithmetic of a file ("10**10**10 N").
_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?i:nan|inf(?:inity)?)(?![a-z]))\s*(.*)", re.S
)
_UNIT = re.compile(r"[\w\s·*/^().°-]{1,60}")


class QuantityError(ValueError):
    """A text is not a quantity of the wanted dimension; the message completes "torque = '3 kg' ..."."""


@lru_cache(maxsize=1)
def registry() -> Any:
    """Return the one pint registry; ``Nm`` and ``rev`` are added because data sheets write them."""
    import pint

    ureg = pint.UnitRegistry()
    ureg.define("newton_meter = newton * meter = Nm")
    ureg.define("@alias turn = rev")
    return ureg


@lru_cache(maxsize=256)
def factor(unit: str, target: str) -> float:
    """Return the factor that takes a number from one unit to another of exactly the same base units.

    Base units are compared with radians kept apart from plain numbers, so that ``Hz`` is not mistaken for ``rad/s``
    nor ``percent`` for an angle.

    Raises
    ------
    QuantityError
        If the unit is unknown or of another dimension.

    Examples
    --------
    >>> factor("mm", "m"), factor("rpm", "rad/s") * 30
    (0.001, 3.141592653589793)
    """
    ureg = registry()
    try:
        if not _UNIT.fullmatch(unit):
            raise ValueError(unit)
        scale, base = ureg.get_base_units(ureg.parse_units(unit))
    except Exception as error:  # pint answers bad text with many kinds of error, from its tokenizer to plain assertions
        raise QuantityError(f"has the unknown unit {unit!r}") from error
    target_scale, target_base = ureg.get_base_units(ureg.parse_units(target))
    if base != target_base:
        raise QuantityError(f"has the wrong unit {unit!r}")
    return float(scale / target_scale)


def parse_quantity(text: str, target: str) -> tuple[float, str, str]:
    """Read text such as ``"25.4 mm"``.

    Parameters
    ----------
    text : str
        Number, then unit.
    target : str
        Unit of the answer, for example ``"m"``.

    Returns
    -------
    tuple of (float, str, str)
        Value in the target unit, the number as written, the unit as written.

    Raises
    ------
    QuantityError
        If there is no number, no unit, an unknown or wrong unit, or the value is not finite.

    Examples
    --------
    >>> parse_quantity("25.4 mm", "m")
    (0.0254, '25.4', 'mm')
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise QuantityError("does not begin with a number")
    number, unit = match[1], match[2].strip()
    if not math.isfinite(float(number)):
        raise QuantityError("is not finite")
    if not unit:
        raise QuantityError("has no unit")
    value = float(number) * factor(unit, target)
    if not math.isfinite(value):
        raise QuantityError("is not finite in SI units")
    return value, number, unit
