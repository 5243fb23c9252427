"""Targets files: unknowns with bounds and targets with tolerances, read from TOML with one sentence per mistake."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal, cast

from continuation.errors import nearest
from sbg_casadi.entries import Choice, plain_number, shown
from sbg_casadi.errors import UserError
from sbg_casadi.identification.addresses import check_address, unit_of
from sbg_casadi.identification.targets import KINDS, QUANTITIES, Target, regime_period
from sbg_casadi.identification.unknowns import Unknown
from sbg_casadi.options import DEFAULT_RANGE
from sbg_casadi.pair import Pair
from sbg_casadi.units import QuantityError, parse_quantity

_HOME = Path(__file__).parents[1] / "cases" / "targets"
_TOP = ("title", "unknowns", "targets")
_UNKNOWN = ("name", "key", "keys", "factors", "bounds", "scale", "choices")
_LARGEST_PERIOD = 64


@dataclass(frozen=True, slots=True)
class TargetsFile:
    """Hold a checked targets file: its title, unknowns and targets."""

    name: str
    title: str
    unknowns: tuple[Unknown, ...]
    targets: tuple[Target, ...]


def load_targets(name_or_path: str | os.PathLike[str], pair: Pair) -> TargetsFile:
    """Read a targets file for a pair.

    Parameters
    ----------
    name_or_path : str or path
        Path of a TOML file, or the name of one that comes with the package, such as ``case3``.
    pair : Pair
        Whose keys the unknowns are and whose states the targets name.

    Raises
    ------
    UserError
        With one sentence that names the entry, its value and what was expected.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> found = load_targets("case1", load_pair("case1"))
    >>> found.targets[0].kind, found.unknowns[0].scale
    ('peak', 'log')
    """
    name = os.fspath(name_or_path)
    built_in = sorted(path.stem for path in _HOME.glob("*.toml"))
    path = _HOME / f"{name}.toml" if name in built_in else Path(name)
    place = f"targets file {name!r}"
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        hint = f"; the built-in ones are {', '.join(built_in)}" if not name.endswith(".toml") else ""
        raise UserError(
            f"{place} does not exist{hint}; expected a TOML file with [[unknowns]] and [[targets]]"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{place} can't be read ({error}); expected a TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{place} is not valid TOML: {error}") from None
    return _read(raw, place, path.stem, pair)


def read_targets(raw: Mapping[str, Any], pair: Pair, name: str = "targets") -> TargetsFile:
    """Check the parsed content of a targets file; see :func:`load_targets`."""
    return _read(raw, name, name, pair)


def selected(targets: TargetsFile, state: str | None, pattern: str | None) -> TargetsFile:
    """Return the part of a targets file that is about one state, and the unknowns whose keys a pattern names.

    Parameters
    ----------
    targets : TargetsFile
    state : str or None
        Targets of other states are left out, and unknowns that only other states have.
    pattern : str or None
        Such as ``states.after.*``; an unknown stays if all of its keys fit.

    Raises
    ------
    UserError
        If no target or no unknown is left.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> part = selected(load_targets("case3", load_pair("case3")), "after", "states.after.*")
    >>> len(part.targets), [u.name for u in part.unknowns][0]
    (9, 'states.after.stiffness_cosine.1')
    """
    wanted = tuple(t for t in targets.targets if state in (None, t.state))
    unknowns = tuple(u for u in targets.unknowns if state is None or not all(_elsewhere(key, state) for key in u.keys))
    if pattern is not None:
        unknowns = tuple(u for u in unknowns if all(fnmatchcase(key, pattern) for key in u.keys))
    if not wanted:
        known = ", ".join(dict.fromkeys(t.state for t in targets.targets))
        raise UserError(f"--state {state}: no target is of that state; expected one of {known}")
    if not unknowns:
        raise UserError(f"--unknowns {pattern}: fits no key of the targets file; expected a pattern such as mesh.*")
    return replace(targets, unknowns=unknowns, targets=wanted)


def _elsewhere(key: str, state: str) -> bool:
    return key.startswith("states.") and key.split(".")[1] != state


def _read(raw: Mapping[str, Any], place: str, name: str, pair: Pair) -> TargetsFile:
    _only(raw, _TOP, place)
    for key in ("unknowns", "targets"):
        entries = raw.get(key)
        if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
            raise UserError(f"{place}: {key} = {shown(entries)}; expected at least one table [[{key}]]")
    unknowns = tuple(_unknown(e, f"{place}: unknowns[{i}]", pair) for i, e in enumerate(raw["unknowns"], 1))
    keys = [key for u in unknowns for key in u.keys]
    for key in keys:
        if keys.count(key) > 1:
            raise UserError(f"{place}: {key!r} is looked for twice; expected every key once")
    targets = tuple(_target(e, f"{place}: targets[{i}]", pair) for i, e in enumerate(raw["targets"], 1))
    return TargetsFile(name, str(raw.get("title", name)), unknowns, targets)


def _only(table: Mapping[str, Any], known: tuple[str, ...], place: str) -> None:
    for key in table:
        if key not in known:
            raise UserError(f"{place}: unknown key {key!r}; {nearest(key, known)}")


def _unknown(entry: dict[str, Any], place: str, pair: Pair) -> Unknown:
    _only(entry, _UNKNOWN, place)
    keys = entry.get("keys", [entry.get("key")])
    if not isinstance(keys, list) or not keys or not all(isinstance(k, str) for k in keys):
        raise UserError(f'{place}: key = {shown(entry.get("key"))}; expected a key such as "mesh.damping_ratio"')
    kinds = [check_address(pair, key, f"{place}: key") for key in keys]
    name = str(entry.get("name", keys[0]))
    if any(isinstance(kind, Choice) for kind in kinds) or "choices" in entry:
        return _choice(entry, keys, kinds, name, place)
    units = {unit_of(kind) for kind in kinds}
    if len(units) > 1:
        raise UserError(f"{place}: keys of different units ({', '.join(sorted(units))}); expected one unit")
    unit = units.pop()
    bounds = entry.get("bounds")
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise UserError(f"{place} ({name}): bounds = {shown(bounds)}; expected two values, least and largest")
    low, high = (_number(b, unit, f"{place} ({name}): bounds") for b in bounds)
    scale = entry.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise UserError(f'{place} ({name}): scale = {shown(scale)}; expected "linear" or "log"')
    if not low < high or (scale == "log" and not low > 0):
        raise UserError(f"{place} ({name}): bounds {low:g} and {high:g}; expected the first smaller, positive for log")
    factors = entry.get("factors", [1.0] * len(keys))
    if not isinstance(factors, list) or len(factors) != len(keys):
        raise UserError(f"{place} ({name}): factors = {shown(factors)}; expected one number for each key")
    numbers = tuple(_number(f, "", f"{place} ({name}): factors") for f in factors)
    return Unknown(name, tuple(keys), numbers, low, high, unit, cast(Literal["linear", "log"], scale))


def _choice(entry: dict[str, Any], keys: list[str], kinds: list[Any], name: str, place: str) -> Unknown:
    choices = entry.get("choices")
    options = kinds[0].options if isinstance(kinds[0], Choice) else ()
    if len(keys) != 1 or not options:
        raise UserError(f"{place} ({name}): choices go with one key that takes words, such as load.member")
    if not isinstance(choices, list) or not choices or any(c not in options for c in choices):
        expected = ", ".join(map(str, options))
        raise UserError(f"{place} ({name}): choices = {shown(choices)}; expected some of {expected}")
    return Unknown(name, tuple(keys), (1.0,), 0.0, 1.0, "", "linear", tuple(choices))


def _number(raw: Any, unit: str, place: str) -> float:
    try:
        if not unit:
            return plain_number(raw)
        if not isinstance(raw, str):
            raise QuantityError("is not text with a number and a unit")
        return parse_quantity(raw, unit)[0]
    except QuantityError as fault:
        example = f'text such as "1 {unit}"' if unit else "a plain number"
        raise UserError(f"{place} = {shown(raw)} {fault}; expected {example}") from None


_COMMON = ("name", "state", "kind")
_OWN = {
    "rms": ("at", "value", "tolerance"),
    "exponent": ("at", "value", "tolerance"),
    "regime": ("at", "regime"),
    "jump": ("value", "tolerance", "band"),
    "peak": ("height", "height_tolerance", "position", "position_tolerance", "band"),
}


def _target(entry: dict[str, Any], place: str, pair: Pair) -> Target:
    kind = entry.get("kind")
    if kind not in KINDS:
        raise UserError(f"{place}: kind = {shown(kind)}; expected one of {', '.join(KINDS)}")
    _only(entry, (*_COMMON, *_OWN[kind]), f"{place} ({kind})")
    state = entry.get("state", pair.states[0] if len(pair.states) == 1 else None)
    if state not in pair.states:
        raise UserError(f"{place} ({kind}): state = {shown(state)}; expected one of {', '.join(pair.states)}")
    at = math.nan
    if "at" in _OWN[kind]:
        at = _positive(entry, "at", f"{place} ({kind})")
    wanted: list[tuple[str, float, float]] = []
    regime = ""
    if kind == "regime":
        regime = _regime(entry.get("regime"), f"{place} ({kind})")
        words = f"{state}: {regime} at {at:g}"
    elif kind == "peak":
        for quantity in QUANTITIES["peak"]:
            if quantity in entry:
                value = _positive(entry, quantity, f"{place} ({kind})")
                wanted.append((quantity, value, _positive(entry, f"{quantity}_tolerance", f"{place} ({kind})")))
        if not wanted:
            raise UserError(f"{place} (peak): expected height with height_tolerance, position with position_tolerance")
        words = f"{state}: peak"
    else:
        value = _number(entry.get("value"), "", f"{place} ({kind}): value")
        wanted.append((QUANTITIES[kind][0], value, _positive(entry, "tolerance", f"{place} ({kind})")))
        words = f"{state}: {kind}" + ("" if math.isnan(at) else f" at {at:g}")
    return Target(str(entry.get("name", words)), state, kind, at, tuple(wanted), regime, _band(entry, place))


def _positive(entry: dict[str, Any], key: str, place: str) -> float:
    if key not in entry:
        raise UserError(f"{place}: {key} is missing; expected a positive number")
    value = _number(entry[key], "", f"{place}: {key}")
    if not value > 0:
        raise UserError(f"{place}: {key} = {value:g}; expected a positive number")
    return value


def _regime(raw: Any, place: str) -> str:
    names = ("periodic", "quasi-periodic", "chaotic")
    if isinstance(raw, str) and raw in names:
        return raw
    number = raw.removeprefix("period-") if isinstance(raw, str) and raw.startswith("period-") else ""
    if number.isdecimal() and 1 <= int(number) <= _LARGEST_PERIOD and regime_period(str(raw)) > 0:
        return f"period-{int(number)}"
    raise UserError(f"{place}: regime = {shown(raw)}; expected period-1 to period-64, {', '.join(names)}")


def _band(entry: dict[str, Any], place: str) -> tuple[float, float]:
    band = entry.get("band", list(DEFAULT_RANGE))
    if not isinstance(band, list) or len(band) != 2:
        raise UserError(f"{place}: band = {shown(band)}; expected two frequency ratios")
    low, high = (_number(b, "", f"{place}: band") for b in band)
    if not 0 < low < high:
        raise UserError(f"{place}: band = {shown(band)}; expected two positive frequency ratios, the first smaller")
    return low, high
