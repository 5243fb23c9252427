"""A validated pair as the text of a pair file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from typing import Any

from pydantic.fields import FieldInfo

from sbg_casadi.entries import Entry, Kind, Quantities, Quantity
from sbg_casadi.schema import DimensionlessFile, PhysicalFile, Table
from sbg_casadi.series_kinds import Shape


def to_toml(tables: PhysicalFile | DimensionlessFile) -> str:
    """Return the text of a pair file that reads into equal tables; numbers with units keep the text they had."""
    lines = [f"name = {_entry(tables.name, type(tables).model_fields['name'])}"]
    for section in type(tables).model_fields:
        part = getattr(tables, section)
        if isinstance(part, Table):
            lines += _table(section, part)
        elif isinstance(part, dict):
            for state, table in part.items():
                lines += _table(f"states.{_text(state)}", table, always=True)
    return "\n".join(lines) + "\n"


def _table(section: str, table: Table, always: bool = False) -> list[str]:
    """Return the lines of a table, none if it is empty and its head says nothing."""
    kinds = type(table).model_fields
    lines = [f"{key} = {_entry(entry, kinds[key])}" for key in kinds if (entry := getattr(table, key)) is not None]
    return ["", f"[{section}]", *lines] if lines or always else []


def _entry(entry: Entry, info: FieldInfo) -> str:
    """Return an entry as TOML, plain when it says no more than its value."""
    kind = next(item for item in info.metadata if isinstance(item, Kind))
    value = next((write for known, write in _WRITERS.items() if isinstance(kind, known)), _plain)(entry)
    if entry.source == "user" and not entry.note:
        return value
    note = f", note = {_text(entry.note)}" if entry.note else ""
    return f"{{value = {value}, source = {_text(entry.source)}{note}}}"


def _plain(entry: Entry) -> str:
    return _value(entry.value)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    return repr(value)


def _text(text: str) -> str:
    """Return a TOML basic string; JSON escapes all that TOML forbids but the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def _quantity(entry: Entry) -> str:
    return _text(f"{entry.text} {entry.unit}")


def _quantities(entry: Entry) -> str:
    parts = [f"{part} {entry.unit}".strip() for part in entry.text.split(", ")]
    return f"[{', '.join(map(_text, parts))}]"


def _shape(entry: Entry) -> str:
    return "{" + ", ".join(f"{f.name} = {getattr(entry.value, f.name)!r}" for f in fields(entry.value)) + "}"


_WRITERS: dict[type[Kind], Callable[[Entry], str]] = {Quantity: _quantity, Quantities: _quantities, Shape: _shape}
