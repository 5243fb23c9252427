"""Kinds of value that describe the mesh stiffness of a state: a table's path, a shape, a number of harmonics."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from continuation.errors import nearest
from sbg_casadi.entries import Entry, Kind, plain_number, shown
from sbg_casadi.shapes import StiffnessShape
from sbg_casadi.units import QuantityError

MOST_HARMONICS = 200


@dataclass(frozen=True, slots=True)
class Whole(Kind):
    """A whole number from 1 on."""

    most: int = MOST_HARMONICS

    def read(self, raw: Any) -> tuple[int, str, str]:
        """Return (value, text, no unit)."""
        if isinstance(raw, bool) or not isinstance(raw, int):
            raise QuantityError("is not a whole number")
        if not 1 <= raw <= self.most:
            raise QuantityError(f"is not between 1 and {self.most}")
        return raw, str(raw), ""


@dataclass(frozen=True, slots=True)
class TablePath(Kind):
    """The path of a CSV file, relative to the folder of the pair file."""

    def read(self, raw: Any) -> tuple[str, str, str]:
        """Return (path, path, no unit)."""
        if not isinstance(raw, str):
            raise QuantityError("is not text")
        if not raw.strip() or not raw.isprintable():
            raise QuantityError("is empty or holds a character that can't be part of a path")
        return raw, raw, ""


_LIMITS = {  # key of a shape: above, up to
    "contact_ratio": (1.0, 10.0),
    "peak_to_peak": (0.0, 2.0),
    "modification": (0.0, 10.0),
    "rounding": (0.0, 1.0),
}


@dataclass(frozen=True, slots=True)
class Shape(Kind):
    """A table of plain numbers that makes a :class:`StiffnessShape`."""

    def __call__(self, raw: Any) -> Entry:
        """Return the entry; a table without ``value``, ``source`` and ``note`` is the shape itself."""
        if isinstance(raw, dict) and not {"value", "source", "note"} & raw.keys():
            raw = {"value": raw}
        return Kind.__call__(self, raw)

    def read(self, raw: Any) -> tuple[StiffnessShape, str, str]:
        """Return (shape, text, no unit)."""
        if not isinstance(raw, dict):
            raise QuantityError("is not a table")
        names = [item.name for item in fields(StiffnessShape)]
        for key in raw:
            if key not in names:
                raise QuantityError(f"holds the unknown key {key!r} ({nearest(key, names)})")
        for key in ("contact_ratio", "peak_to_peak"):
            if key not in raw:
                raise QuantityError(f"has no {key}")
        for key, value in raw.items():
            above, most = _LIMITS[key]
            try:
                number = plain_number(value)
            except QuantityError as fault:
                raise QuantityError(f"holds {key} = {shown(value)}, which {fault}") from None
            if not above < number <= most:
                raise QuantityError(f"holds {key} = {shown(value)}, which is not above {above:g} and up to {most:g}")
        shape = StiffnessShape(**{key: float(value) for key, value in raw.items()})
        return shape, ", ".join(f"{name} {getattr(shape, name):g}" for name in names), ""
