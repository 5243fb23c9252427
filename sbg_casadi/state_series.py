"""The four coefficient lists of a state, from harmonics, a measured table or a shape, whichever its file gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sbg_casadi.conversion import Conversion, MeshGeometry, convert
from sbg_casadi.derived import Derived
from sbg_casadi.errors import PairError
from sbg_casadi.schema import Harmonics, PhysicalFile
from sbg_casadi.tables import read_table

Lists = dict[str, Any]  # tuples of float; Any lets them be passed on as keywords

_GROUPS = {
    "stiffness": ("stiffness_cosine", "stiffness_sine", "stiffness_table", "stiffness_shape"),
    "error": ("error_cosine", "error_sine"),
}


@dataclass(frozen=True, slots=True)
class StateSeries:
    """Hold the harmonics of one state, and notes on those that a table or a shape led to.

    Attributes
    ----------
    lists : dict of str to tuple of float
        ``stiffness_cosine`` and ``stiffness_sine`` over the mean, ``error_cosine`` and ``error_sine`` over half the
        backlash.
    notes : dict of str to str
        For each list that the file doesn't give itself: where it comes from.
    """

    lists: Lists
    notes: dict[str, str] = field(default_factory=dict)


def mesh_geometry(pair: PhysicalFile, derived: Derived) -> MeshGeometry:
    """Return what turns a measured table of a pair into stiffness."""
    return MeshGeometry(
        teeth=pair.geometry.teeth.value,
        pinion_radius=derived.pinion_mean_radius,
        gear_radius=derived.gear_mean_radius,
        tangential_cosine=derived.a3,
        member="pinion" if pair.load.member.value == "pinion" else "gear",
        torque=pair.load.torque.value,
    )


def table_conversions(pair: PhysicalFile, derived: Derived, folder: Path | None) -> dict[str, Conversion]:
    """Return the converted table of each state that has one, by the state.

    Parameters
    ----------
    pair : PhysicalFile
    derived : Derived
        Its mean radii, a3 and torque are used.
    folder : Path or None
        Folder of the pair file, which paths are relative to; None for the current one.

    Raises
    ------
    PairError
        If a table can't be read or converted, or its state doesn't say how many harmonics it wants.
    """
    mesh = mesh_geometry(pair, derived)
    result = {}
    for state, harmonics in pair.states.items():
        if harmonics.stiffness_table is not None:
            place = f"states.{state}"
            count = _count(harmonics, place)
            path = (folder or Path()) / harmonics.stiffness_table.value
            try:
                result[state] = convert(read_table(path), mesh, count)
            except PairError as error:
                raise PairError(f"{place}.stiffness_table: {error}") from None
    return result


def _count(harmonics: Harmonics, place: str) -> int:
    if harmonics.stiffness_harmonics is None:
        raise PairError(f"{place}.stiffness_harmonics is missing; expected a whole number of harmonics, such as 7")
    return int(harmonics.stiffness_harmonics.value)


def check_groups(harmonics: Harmonics, place: str) -> None:
    """Raise PairError if a state gives its stiffness in more than one way, or a number of harmonics for none."""
    given = [key for key in _GROUPS["stiffness"] if getattr(harmonics, key) is not None]
    ways = {key if key in ("stiffness_table", "stiffness_shape") else "harmonics" for key in given}
    if len(ways) > 1:
        raise PairError(f"{place} has {given[0]} and {given[-1]}; expected the stiffness in one way")
    if harmonics.stiffness_harmonics is not None and ways <= {"harmonics"}:
        raise PairError(
            f"{place}.stiffness_harmonics stands without stiffness_table and stiffness_shape; expected one of them"
        )


def state_series(
    harmonics: Harmonics,
    place: str,
    *,
    base: Harmonics | None = None,
    conversion: Conversion | None = None,
    half_backlash: float | None = None,
) -> StateSeries:
    """Return the coefficient lists of a state.

    Parameters
    ----------
    harmonics : Harmonics
        Table of the state.
    place : str
        Its name in the file, such as ``"states.before"``.
    base : Harmonics, optional
        What holds where the state says nothing, stiffness and error each as a whole.
    conversion : Conversion, optional
        Of the table that the state names.
    half_backlash : float, optional
        b in m, with a conversion.

    Raises
    ------
    PairError
        If the state gives something twice, or a table without being able to use it.
    """
    check_groups(harmonics, place)
    lists: Lists = {}
    notes: dict[str, str] = {}
    for kind, keys in _GROUPS.items():
        own = any(getattr(harmonics, key) is not None for key in keys)
        table = harmonics if own or base is None else base
        lists |= _given(table, kind)
    own = any(getattr(harmonics, key) is not None for key in _GROUPS["stiffness"])
    source = harmonics if own or base is None else base
    if source.stiffness_shape is not None:
        cosine, sine = _shape(source, place)
        lists |= {"stiffness_cosine": cosine, "stiffness_sine": sine}
        notes |= dict.fromkeys(("stiffness_cosine", "stiffness_sine"), "from stiffness_shape")
    if source.stiffness_table is not None:
        if conversion is None or half_backlash is None:
            raise PairError(
                f"{place}.stiffness_table needs the geometry of the pair; expected [geometry], [load], ... instead of "
                "[dimensionless]"
            )
        more, about = _table(conversion, half_backlash)
        doubled = [key for key in _GROUPS["error"] if key in more and getattr(harmonics, key) is not None]
        if doubled:
            raise PairError(
                f"{place}.{doubled[0]} stands beside the unloaded TE of stiffness_table; expected one of them"
            )
        lists |= more
        notes |= about
    return StateSeries(lists, notes)


def _given(table: Harmonics, kind: str) -> Lists:
    """Return the two lists of a kind as a file gives them; an absent or empty partner is all zeros."""
    keys = (f"{kind}_cosine", f"{kind}_sine")
    lists = [entry.value if (entry := getattr(table, key)) is not None else () for key in keys]
    length = max(len(values) for values in lists)
    return {key: values or (0.0,) * length for key, values in zip(keys, lists, strict=True)}


def _shape(harmonics: Harmonics, place: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    assert harmonics.stiffness_shape is not None  # the caller has looked
    count = _count(harmonics, place)
    try:
        return harmonics.stiffness_shape.value.coefficients(count)
    except PairError as error:
        raise PairError(f"{place}.stiffness_shape: {error}") from None


def _table(conversion: Conversion, half_backlash: float) -> tuple[Lists, dict[str, str]]:
    """Return the lists that a table leads to, and a note on each."""
    stiffness, error = conversion.stiffness, conversion.error
    cosine, sine = conversion.relative()
    lists = {"stiffness_cosine": cosine, "stiffness_sine": sine}
    note = (
        f"from stiffness_table, mean {stiffness.mean:.5g} N/m, "
        f"truncation error up to {100 * stiffness.deviation / stiffness.mean:.3g} % of it"
    )
    notes = dict.fromkeys(lists, note)
    if error is not None:
        scaled = {
            "error_cosine": tuple(c / half_backlash for c in error.cosine),
            "error_sine": tuple(s / half_backlash for s in error.sine),
        }
        lists |= scaled
        notes |= dict.fromkeys(
            scaled, f"from the unloaded TE, truncation error up to {error.deviation / half_backlash:.3g} half backlash"
        )
    return lists, notes
