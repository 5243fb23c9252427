"""Pair files: built-in cases and users' TOML files, read into a validated :class:`Pair`."""

from __future__ import annotations

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from continuation.errors import nearest
from sbg_casadi.conversion import MeshGeometry
from sbg_casadi.derived import Derived
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.entries import name_fault, shown
from sbg_casadi.errors import PairError
from sbg_casadi.normalise import derive, given_series, given_states, physical_series, physical_states
from sbg_casadi.rows import Row, given_rows, physical_rows
from sbg_casadi.schema import DimensionlessFile, PhysicalFile, read_file
from sbg_casadi.state_series import mesh_geometry
from sbg_casadi.writing import to_toml

_CASES = Path(__file__).with_name("cases")
_LARGEST = 1_000_000  # bytes; a pair file has a few thousand


@dataclass(frozen=True, slots=True)
class Pair:
    """Hold one gear pair with its states, validated as a whole.

    Attributes
    ----------
    name : str
        Name the file gives.
    form : {"physical", "dimensionless"}
        Which of the two forms the file has.
    derived : Derived or None
        Derived quantities in SI units; None for the dimensionless form.
    published : dict of str to float
        Published results in SI units to compare with, by the name they have in ``derived``; often empty.

    Examples
    --------
    >>> pair = load_pair("iso-f2")
    >>> pair
    Pair('iso-f2': physical, states before, after)
    >>> round(pair.derived.normal_force, 1)
    14193.3
    >>> pair.dimensionless("after").stiffness_cosine
    (0.08125, 0.0203125)
    >>> sorted({row.source for row in pair.rows()})
    ['assumed', 'derived', 'standard']
    """

    name: str
    form: Literal["physical", "dimensionless"]
    derived: Derived | None
    published: dict[str, float]
    _states: tuple[Dimensionless, ...]
    _rows: tuple[Row, ...]
    _tables: PhysicalFile | DimensionlessFile

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states in the order of the file; ``("only",)`` for harmonics inside [dimensionless]."""
        return tuple(state.state for state in self._states)

    def dimensionless(self, state: str | None = None) -> Dimensionless:
        """Return the numbers of the dimensionless equations in one state; None is the first state.

        Raises
        ------
        PairError
            If there is no such state; the message names the nearest.
        """
        if state is None:
            return self._states[0]
        for one in self._states:
            if one.state == state:
                return one
        raise PairError(f"pair {self.name!r} has no state {state!r}; {nearest(state, self.states)}")

    def rows(self) -> list[Row]:
        """Return every value as (section, key, value, unit, source, note), given ones first, then derived ones."""
        return list(self._rows)

    def mesh_geometry(self) -> MeshGeometry | None:
        """Return what turns a measured table into stiffness; None for the dimensionless form."""
        if self.derived is None or not isinstance(self._tables, PhysicalFile):
            return None
        return mesh_geometry(self._tables, self.derived)

    def to_toml(self) -> str:
        """Return the pair as the text of a pair file, from which :func:`load_pair` makes an equal pair.

        What a file leaves out stays out, and the path of a ``stiffness_table`` stays as it is, relative to the folder
        of the file.

        Examples
        --------
        >>> load_pair("iso-f2").to_toml().splitlines()[0]
        'name = {value = "iso-f2", source = "standard", note = "ISO 23509:2016 Annex F.2"}'
        """
        return to_toml(self._tables)

    def __repr__(self) -> str:
        return f"Pair({self.name!r}: {self.form}, states {', '.join(self.states)})"


def case_names() -> tuple[str, ...]:
    """Return the names of the built-in cases, sorted.

    Examples
    --------
    >>> case_names()[:3], case_names()[-2:]
    (('case1', 'case1-calibrated', 'case2'), ('example', 'iso-f2'))
    """
    return tuple(sorted(path.stem for path in _CASES.glob("*.toml")))


def load_pair(name_or_path: str | os.PathLike[str]) -> Pair:
    """Load a built-in case by its name, or a pair file by its path.

    Parameters
    ----------
    name_or_path : str or path
        A name of :func:`case_names`, which goes before a file of that name, or the path of a TOML file.

    Raises
    ------
    PairError
        With one sentence that names the key, its value and what was expected.
    """
    name = os.fspath(name_or_path)
    if name in case_names():
        place, path = f"built-in case {name!r}", _CASES / f"{name}.toml"
        return build_pair(_parse(path.read_bytes(), place), place, _CASES)
    place, data = f"pair file {name!r}", _read(name)
    return build_pair(_parse(data, place), place, Path(name).parent)


def _read(name: str) -> bytes:
    """Return the bytes of a pair file, or say why there are none."""
    try:
        if name and Path(name).is_dir():
            raise PairError(f"pair file {name!r} is a folder; expected a TOML file")
        with open(name, "rb") as stream:
            data = stream.read(_LARGEST + 1)
    except FileNotFoundError:
        if name.endswith(".toml") or os.path.dirname(name):
            raise PairError(f"pair file {name!r} does not exist; expected a TOML file or a built-in case") from None
        known = nearest(name, case_names())
        raise PairError(f"no built-in case and no file is called {name!r}; {known}") from None
    except PairError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = (isinstance(error, OSError) and error.strerror) or str(error)
        place = name if len(name) <= 100 else name[:97] + "..."
        raise PairError(f"pair file {place!r} can't be read: {reason}; expected a readable TOML file") from None
    if len(data) > _LARGEST:
        raise PairError(f"pair file {name!r} is larger than {_LARGEST} bytes; expected a TOML pair file")
    return data


def _parse(data: bytes, place: str) -> dict[str, Any]:
    try:
        text = data.decode("utf-8-sig")  # editors on Windows write a byte order mark
    except UnicodeDecodeError as error:
        raise PairError(f"{place} is not UTF-8 text (byte {error.start}); expected a TOML file in UTF-8") from None
    if not text.strip():
        raise PairError(f"{place} is empty; expected a pair with name and [geometry] or [dimensionless]")
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PairError(f"{place} is not valid TOML: {error}") from None
    except (ValueError, RecursionError):  # integers of thousands of digits; brackets nested thousands deep
        raise PairError(f"{place} is not valid TOML: a number or a nesting is too long to read") from None
    if not raw:
        raise PairError(f"{place} holds no key; expected a pair with name and [geometry] or [dimensionless]")
    return raw


def folder_of(name_or_path: str | os.PathLike[str]) -> Path:
    """Return the folder that the paths inside a built-in case or pair file are relative to."""
    name = os.fspath(name_or_path)
    return _CASES if name in case_names() else Path(name).parent


def build_pair(raw: dict[str, Any], place: str, folder: Path) -> Pair:
    """Return the pair of a parsed pair file.

    Parameters
    ----------
    raw : dict
        What ``tomllib`` makes of the file.
    place : str
        Beginning of every message, names the file.
    folder : Path
        What paths in it are relative to.

    Raises
    ------
    PairError
        With one sentence that names the key, its value and what was expected.
    """
    tables = read_file(raw, place)
    for state in tables.states:
        if fault := name_fault(state):
            raise PairError(f"{place}: the state name {shown(state)} {fault}; expected a name such as before")
    try:
        return _assemble(tables, folder)
    except PairError as error:
        raise PairError(f"{place}: {error}") from None


def _assemble(tables: PhysicalFile | DimensionlessFile, folder: Path) -> Pair:
    """Compute what follows from validated tables; ``folder`` is that of the file."""
    name = tables.name.value
    if isinstance(tables, DimensionlessFile):
        series = given_series(tables)
        states = given_states(tables, series)
        return Pair(name, "dimensionless", None, {}, states, given_rows(tables, states, series), tables)
    if not tables.states:
        raise PairError("states is empty; expected at least one table [states.NAME]")
    derived = derive(tables, folder)
    series = physical_series(tables, derived, folder)
    states = physical_states(tables, derived, series)
    entries = {key: getattr(tables.published, key) for key in type(tables.published).model_fields}
    published = {key: entry.value for key, entry in entries.items() if entry is not None}
    rows = physical_rows(tables, derived, states, series)
    return Pair(name, "physical", derived, published, states, rows, tables)
