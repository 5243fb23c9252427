"""Addresses of numbers in a pair file, such as ``bearings.pinion_y`` or ``states.before.stiffness_cosine.1``."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from pydantic.fields import FieldInfo

from continuation.errors import nearest
from sbg_casadi.dimensionless import COORDINATES, ONLY_STATE
from sbg_casadi.entries import Choice, Kind, Number, Numbers, Quantities, Quantity
from sbg_casadi.errors import UserError
from sbg_casadi.pair import Pair
from sbg_casadi.schema import DimensionlessFile, Harmonics, PhysicalFile, SevenCoordinates
from sbg_casadi.series_kinds import Shape
from sbg_casadi.shapes import StiffnessShape

MOST_HARMONICS = 20
_SERIES = ("stiffness_cosine", "stiffness_sine", "error_cosine", "error_sine")
_CONTACT = "coast_stiffness_ratio"  # a slope of the contact law and no parameter of the equations


def known_addresses(pair: Pair) -> tuple[str, ...]:
    """Return the addresses of all numbers and choices that can be looked for in a pair, each series with index 1.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> known_addresses(load_pair("example"))[-4:]
    ('dimensionless.stiffness_cosine.1', 'dimensionless.stiffness_sine.1', 'dimensionless.error_cosine.1', \
'dimensionless.error_sine.1')
    """
    found: list[str] = []
    if pair.derived is None:
        own = [k for k in SevenCoordinates.model_fields if k not in Harmonics.model_fields and k != _CONTACT]
        for key in own:
            six = isinstance(_kind(SevenCoordinates.model_fields[key]), Numbers)
            found += [f"dimensionless.{key}.{q}" for q in COORDINATES] if six else [f"dimensionless.{key}"]
        form: Any = DimensionlessFile
    else:
        form = PhysicalFile
        for section in ("geometry", "load", "inertia", "bearings", "mesh"):
            for key, info in form.model_fields[section].annotation.model_fields.items():
                if isinstance(_kind(info), Quantity | Quantities | Number | Choice) and key not in ("speed", _CONTACT):
                    found.append(f"{section}.{key}")
    for state in pair.states:
        place = "dimensionless" if state == ONLY_STATE and pair.derived is None else f"states.{state}"
        found += [f"{place}.{key}.1" for key in _SERIES]
        if pair.derived is not None:
            found += [f"{place}.stiffness_shape.{item.name}" for item in fields(StiffnessShape)]
    return tuple(found)


def check_address(pair: Pair, key: str, place: str) -> Kind:
    """Return the kind of value at an address of a pair.

    Raises
    ------
    UserError
        If there is nothing of that name; the message has the nearest one.
    """
    known = known_addresses(pair)
    path, index = _split(key)
    if path is not None and not 1 <= index <= MOST_HARMONICS:
        raise UserError(f"{place} = {key!r}: harmonic {index}; expected one from 1 to {MOST_HARMONICS}")
    if (key if path is None else f"{path}.1") not in known:
        if key.endswith(_CONTACT):
            raise UserError(f"{place} = {key!r} is a slope of the contact law, no parameter; expected another key")
        raise UserError(f"{place} = {key!r}: no such number in pair {pair.name!r}; {nearest(key, known)}")
    parts = key.split(".")
    if parts[0] == "states":
        return _kind(Harmonics.model_fields[parts[2]])
    form: Any = DimensionlessFile if pair.derived is None else PhysicalFile
    return _kind(form.model_fields[parts[0]].annotation.model_fields[parts[1]])


def unit_of(kind: Kind) -> str:
    """Return the SI unit of a kind of value, empty for plain numbers."""
    return kind.unit if isinstance(kind, Quantity | Quantities) else ""


def current(pair: Pair, raw: dict[str, Any], key: str) -> Any:
    """Return the value at an address as the file gives it, None where the file leaves it out."""
    path, index = _split(key)
    parts = (key if path is None else path).split(".")
    if path is not None:
        state = parts[1] if parts[0] == "states" else ONLY_STATE
        series = getattr(pair.dimensionless(state), parts[-1])
        return series[index - 1] if index <= len(series) else 0.0
    entry: Any = raw
    for part in parts[:2] if parts[0] != "states" else parts[:3]:
        entry = entry.get(part) if isinstance(entry, dict) else None
    value = entry["value"] if isinstance(entry, dict) and "value" in entry else entry
    if parts[-1] in COORDINATES and isinstance(value, list):
        return value[COORDINATES.index(parts[-1])]
    return value.get(parts[-1]) if isinstance(value, dict) else value


def put(pair: Pair, raw: dict[str, Any], key: str, value: Any, note: str) -> None:
    """Write a value into the parsed pair file in place, with the source ``calibrated``.

    Parameters
    ----------
    pair : Pair
        The pair that ``raw`` is the file of, as it was before any change.
    raw : dict
        Changed in place.
    key : str
        A checked address.
    value : float, str or int
        In SI units; a choice as it is.
    note : str
        Says which command found it.
    """
    kind = check_address(pair, key, "key")
    parts = key.split(".")
    if _split(key)[0] is not None:
        _put_harmonic(pair, raw, parts, float(value), note)
        return
    if isinstance(kind, Shape):
        entry = _table(raw, parts[:2]).get("stiffness_shape")
        if entry is None:
            raise UserError(f"{key}: state {parts[1]!r} of pair {pair.name!r} has no stiffness_shape; expected one")
        shape = dict(entry.get("value", entry)) | {parts[3]: float(value)}
        _table(raw, parts[:2])["stiffness_shape"] = _entry(shape, note)
        return
    table, name = raw.setdefault(parts[0], {}), parts[1]
    if isinstance(kind, Numbers):
        known = table[name]["value"] if isinstance(table[name], dict) else table[name]
        numbers = list(known)
        numbers[COORDINATES.index(parts[2])] = float(value)
        table[name] = _entry(numbers, note)
    elif isinstance(kind, Quantities):
        known = table[name]["value"] if isinstance(table[name], dict) else table[name]
        table[name] = _entry([f"{float(value)!r} {kind.unit}"] * len(known), note)
    elif isinstance(kind, Quantity):
        table[name] = _entry(f"{float(value)!r} {kind.unit}", note)
    else:
        table[name] = _entry(value, note)


def _put_harmonic(pair: Pair, raw: dict[str, Any], parts: Sequence[str], value: float, note: str) -> None:
    """Write one harmonic; a shape or table gives way to the harmonics that it leads to, which keep its source."""
    only = parts[0] == "dimensionless"
    table, series, index = _table(raw, parts[:1] if only else parts[:2]), parts[-2], int(parts[-1])
    group = series.split("_")[0]
    d = pair.dimensionless(ONLY_STATE if only else parts[1])
    origin = _origin(table) if group == "stiffness" else {}
    names = (f"{group}_cosine", f"{group}_sine")
    for name in names:
        known = table.get(name)
        entry = known if isinstance(known, dict) else {"value": known} if known is not None else None
        table[name] = {**origin, "value": list(getattr(d, name))} if entry is None else dict(entry)
    count = max(index, *(len(table[name]["value"]) for name in names))
    for name in names:
        table[name]["value"] = [*table[name]["value"], *[0.0] * (count - len(table[name]["value"]))]
    table[series]["value"][index - 1] = value
    table[series] |= {"source": "calibrated", "note": _harmonic_note(table[series], index, note)}


def _origin(table: dict[str, Any]) -> dict[str, str]:
    """Take shape or table out of a state; return the source and note of the harmonics that it leads to."""
    found: dict[str, str] = {}
    for name in ("stiffness_shape", "stiffness_table"):
        entry = table.pop(name, None)
        if entry is not None:
            told = entry if isinstance(entry, dict) and "value" in entry else {}
            said = f"{name}: {told['note']}" if told.get("note") else name
            found = {"source": told.get("source", "user"), "note": f"from a {said}"}
            table.pop("stiffness_harmonics", None)
    return found


def _harmonic_note(entry: dict[str, Any], index: int, note: str) -> str:
    """Return the note of a list, which says which of its harmonics were found."""
    before = re.fullmatch(rf"harmonics? ([\d, ]+) {re.escape(note)}(.*)", entry.get("note", ""), re.S)
    if before is None:
        rest = f"; the others: {entry['note']}" if entry.get("note") else ""
        return f"harmonic {index} {note}{rest}"
    numbers = sorted({*map(int, before[1].split(", ")), index})
    return f"harmonic{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))} {note}{before[2]}"


def without_change(raw: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a parsed file that can be changed."""
    return copy.deepcopy(raw)


def _table(raw: dict[str, Any], parts: Sequence[str]) -> dict[str, Any]:
    table = raw
    for part in parts:
        table = table.setdefault(part, {})
    return table


def _entry(value: Any, note: str) -> dict[str, Any]:
    return {"value": value, "source": "calibrated", "note": note}


def _split(key: str) -> tuple[str | None, int]:
    """Return path and index of the address of a harmonic, None for any other."""
    found = re.fullmatch(rf"(.*\.(?:{'|'.join(_SERIES)}))\.(\d+)", key)
    return (found[1], int(found[2])) if found else (None, 0)


def _kind(info: FieldInfo) -> Kind:
    return next(item for item in info.metadata if isinstance(item, Kind))
