"""One value of a pair file, with where it comes from, and the kinds of value a key can ask for."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic_core import core_schema

from continuation.errors import nearest
from sbg_casadi.units import QuantityError, parse_quantity

T = TypeVar("T")

SOURCES = ("paper", "standard", "derived", "assumed", "calibrated", "user")


@dataclass(frozen=True, slots=True)
class Entry(Generic[T]):
    """Hold one value in SI units together with its text, unit, source and note as the file gives them."""

    value: T
    text: str
    unit: str = ""
    source: str = "user"
    note: str = ""


class Fault(ValueError):
    """A value does not fit; the message completes the sentence that begins with the key."""


def shown(raw: Any) -> str:
    """Return a value as a TOML file would show it, cut to 60 characters."""
    if isinstance(raw, float):
        return repr(raw)  # nan and inf as TOML spells them
    try:
        text = json.dumps(raw, ensure_ascii=False, default=str)
    except ValueError:  # an integer of thousands of digits has no text
        text = "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


@dataclass(frozen=True, slots=True)
class Kind:
    """Turn one raw TOML value into an :class:`Entry`; subclasses say how through ``read``.

    Parameters
    ----------
    expected : str
        What a good value is, in words and with an example; completes "expected ...".
    """

    expected: str

    def read(self, raw: Any) -> tuple[Any, str, str]:
        """Return (value, text, unit) of a value without its table; raise QuantityError with the cause."""
        raise NotImplementedError

    def __call__(self, raw: Any) -> Entry:
        """Return the entry; raise Fault with the cause and what was expected."""
        value, source, note = _unwrap(raw)
        try:
            return Entry(*self.read(value), source, note)
        except QuantityError as fault:
            raise Fault(f"= {shown(value)} {fault}; expected {self.expected}") from None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self)


def _unwrap(raw: Any) -> tuple[Any, str, str]:
    """Split ``{value, source, note}`` into its parts; a plain value has the source ``user``."""
    if not isinstance(raw, dict):
        return raw, "user", ""
    for key in raw:
        if key not in ("value", "source", "note"):
            raise Fault(f"holds the unknown key {key!r}; {nearest(key, ('value', 'source', 'note'))}")
    if "value" not in raw:
        raise Fault("is a table without value; expected {value = ..., source = ..., note = ...}")
    source, note = raw.get("source", "user"), raw.get("note", "")
    if source not in SOURCES:
        raise Fault(f"has source = {shown(source)}; expected one of {', '.join(SOURCES)}")
    if not isinstance(note, str):
        raise Fault(f"has note = {shown(note)}; expected text")
    return raw["value"], source, note


def _within(value: float, above: float | None, least: float | None, below: float | None) -> None:
    if above is not None and not value > above:
        raise QuantityError("is not positive" if above == 0 else f"is not above {above:g}")
    if least is not None and not value >= least:
        raise QuantityError("is negative" if least == 0 else f"is less than {least:g}")
    if below is not None and not value < below:
        raise QuantityError("is too large")


def plain_number(raw: Any) -> float:
    """Return a TOML number as a float; booleans, text and values that are not finite are refused."""
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        raise QuantityError("is not a plain number")
    try:
        value = float(raw)
    except OverflowError:
        raise QuantityError("is too large for a number") from None
    if not math.isfinite(value):
        raise QuantityError("is not finite")
    return value


@dataclass(frozen=True, slots=True)
class Quantity(Kind):
    """A number with a unit as text; ``unit`` is the SI unit it is read into, the limits are in that unit."""

    unit: str = ""
    above: float | None = 0.0
    least: float | None = None
    below: float | None = None

    def read(self, raw: Any) -> tuple[float, str, str]:
        """Return (SI value, number as written, unit as written)."""
        if isinstance(raw, int | float) and not isinstance(raw, bool):
            plain_number(raw)
            raise QuantityError("has no unit")
        if not isinstance(raw, str):
            raise QuantityError("is not text with a number and a unit")
        value, text, unit = parse_quantity(raw, self.unit)
        _within(value, self.above, self.least, self.below)
        return value, text, unit


@dataclass(frozen=True, slots=True)
class Quantities(Kind):
    """A list of one or more positive numbers with units, for example one stiffness for each shaft end."""

    unit: str = ""

    def read(self, raw: Any) -> tuple[tuple[float, ...], str, str]:
        """Return (SI values, numbers as written, common unit or nothing when the entries differ)."""
        if not isinstance(raw, list) or not raw:
            raise QuantityError("is not a list with at least one entry")
        one = Quantity(self.expected, unit=self.unit)
        parts = []
        for item in raw:
            try:
                parts.append(one.read(item))
            except QuantityError as fault:
                raise QuantityError(f"holds {shown(item)}, which {fault}") from None
        units = {unit for _, _, unit in parts}
        values = tuple(value for value, _, _ in parts)
        if len(units) == 1:
            return values, ", ".join(text for _, text, _ in parts), units.pop()
        return values, ", ".join(f"{text} {unit}" for _, text, unit in parts), ""


@dataclass(frozen=True, slots=True)
class Number(Kind):
    """A plain number without unit."""

    above: float | None = None
    least: float | None = None

    def read(self, raw: Any) -> tuple[float, str, str]:
        """Return (value, text, no unit)."""
        value = plain_number(raw)
        _within(value, self.above, self.least, None)
        return value, f"{value:.12g}", ""


@dataclass(frozen=True, slots=True)
class Numbers(Kind):
    """A list of plain numbers of a given length, or of any length up to ``most``."""

    length: int | None = None
    most: int = 200
    above: float | None = None
    least: float | None = None

    def read(self, raw: Any) -> tuple[tuple[float, ...], str, str]:
        """Return (values, text, no unit)."""
        if not isinstance(raw, list):
            raise QuantityError("is not a list")
        if self.length is not None and len(raw) != self.length:
            raise QuantityError(f"has {len(raw)} entries")
        if len(raw) > self.most:
            raise QuantityError(f"has {len(raw)} entries, more than {self.most}")
        values = []
        for item in raw:
            try:
                values.append(plain_number(item))
                _within(values[-1], self.above, self.least, None)
            except QuantityError as fault:
                raise QuantityError(f"holds {shown(item)}, which {fault}") from None
        return tuple(values), ", ".join(f"{v:.12g}" for v in values) or "none", ""


@dataclass(frozen=True, slots=True)
class Teeth(Kind):
    """The two numbers of teeth, pinion first."""

    def read(self, raw: Any) -> tuple[tuple[int, int], str, str]:
        """Return ((pinion, gear), text, no unit)."""
        if not isinstance(raw, list) or len(raw) != 2:
            raise QuantityError("is not a list of two")
        for item in raw:
            if isinstance(item, bool) or not isinstance(item, int):
                raise QuantityError(f"holds {shown(item)}, which is not a whole number")
            if not 3 <= item <= 10_000:
                raise QuantityError(f"holds {shown(item)}, which is no number of teeth")
        if raw[0] > raw[1]:
            raise QuantityError("has more teeth on the pinion than on the gear")
        return (raw[0], raw[1]), f"{raw[0]}, {raw[1]}", ""


@dataclass(frozen=True, slots=True)
class Choice(Kind):
    """One of a few allowed values."""

    options: tuple[Any, ...] = ()

    def read(self, raw: Any) -> tuple[Any, str, str]:
        """Return (value, text, no unit); text that is nearly an option is answered with it."""
        if isinstance(raw, bool | list | dict) or raw not in self.options:
            hint = ""
            if isinstance(raw, str) and all(isinstance(o, str) for o in self.options):
                hint = " (" + nearest(raw, self.options) + ")"
            raise QuantityError(f"is not allowed{hint}")
        value = self.options[self.options.index(raw)]
        return value, str(value), ""


def name_fault(name: Any) -> str | None:
    """Return why a name can't be used in file names, or None: it must be printable, short and free of separators."""
    if not isinstance(name, str):
        return "is not text"
    if not name or name != name.strip() or len(name) > 80:
        return "is empty, longer than 80 characters or begins or ends with a blank"
    if not name.isprintable() or name[0] in ".-" or any(c in '/\\:*?"<>|' for c in name):
        return "holds a character that can't be part of a file name"
    return None


@dataclass(frozen=True, slots=True)
class Name(Kind):
    """A name that can also be part of a file name."""

    def read(self, raw: Any) -> tuple[str, str, str]:
        """Return (name, name, no unit)."""
        fault = name_fault(raw)
        if fault:
            raise QuantityError(fault)
        return raw, raw, ""
