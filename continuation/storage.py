"""Branches as netCDF files that xarray, MATLAB and Julia read; no pickle, written as a whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr

from continuation.branches.branch import SCHEMA, Branch, Kind, SpecialPoint
from continuation.form_storage import form_variables, load_form
from continuation.netcdf import about, flags, pairs, read_dataset, unpaired, write_dataset
from continuation.orbits.orbit import Orbit, Stability

FORMAT = "continuation branch"
_STABILITY = get_args(Stability)
_KINDS = get_args(Kind)
_STATUS: tuple[Literal["located", "guessed"], ...] = ("located", "guessed")

# Per orbit: dimensions after the point, unit, long name. Special points carry the same under the prefix "special_".
_ORBIT_VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "parameters": (("parameter_name",), "units of the system", "all parameter values of the orbit"),
    "period": ((), "time unit of the system", "period of the orbit"),
    "period_multiple": ((), "1", "excitation periods per period of the orbit"),
    "harmonic_count": ((), "1", "number of harmonics kept; coefficients beyond it are padding"),
    "coefficients": (
        ("harmonic", "state", "complex"),
        "units of the states",
        "half spectrum of the states: x = c_0 + 2 Re sum_k c_k exp(i k phase / period_multiple)",
    ),
    "multipliers": (("multiplier", "complex"), "1", "Floquet multipliers over the orbit's period, largest first"),
    "multiplier_error": (("multiplier",), "1", "error bar of each Floquet multiplier"),
    "stability": ((), "1", "verdict of the Floquet multipliers"),
    "waveform_error": ((), "units of the states", "estimated largest error of the waveform"),
    "rms": (("state",), "units of the states", "root mean square about the mean"),
}
# Absent from files of earlier versions, which still load.
_LATER_VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "second_opinion": (("multiplier",), "1", "difference of each multiplier from a second method; NaN: not asked"),
    "contact_count": (("contact",), "1", "number of contact changes over the orbit's period; what follows is padding"),
    "contact_phases": (("contact", "change"), "rad", "excitation phases at which a contact changes its linear piece"),
    "contact_modes": (("contact", "interval"), "1", "linear piece before the first change and after each"),
}


def save_branch(branch: Branch, path: str | Path) -> None:
    """Write a branch to a netCDF file; a temporary file in the same folder takes its place, or nothing changes.

    Parameters
    ----------
    branch : Branch
        Every number of it is kept exactly; the ``problem`` of special points is not.
    path : str or Path
        File to write, by custom with the ending ``.nc``.

    Raises
    ------
    OSError
        If the file can't be written; an earlier file of that name is then untouched.
    ValueError
        If the branch is empty or its orbits belong to different systems.

    Notes
    -----
    Dimensions are ``point``, ``special_point``, ``state``, ``harmonic``, ``multiplier``, ``parameter_name`` and
    ``complex`` (real, imaginary); with contacts also ``contact``, ``change`` and ``interval``. Orbits of fewer
    harmonics are padded with zeros, ``harmonic_count`` tells; those of fewer contact changes with NaN and -1.
    Texts and counts of the branch are attributes of the file, nested ones as JSON.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from continuation.branches.branch import Branch
    >>> from continuation.orbits.orbit import Orbit
    >>> orbit = Orbit(system="s", state_names=("x",), parameter="g", parameters={"g": 1.0}, period=1.0,
    ...               period_multiple=1, coefficients=np.array([[0j], [0.5]]), multipliers=np.array([0.5 + 0j]),
    ...               multiplier_error=np.zeros(1), stability="stable", error=0.0)
    >>> branch = Branch((orbit,), (), "reached g = 1", {"newton_steps": 3}, {"method": "none"})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_branch(branch, f"{folder}/branch.nc")
    ...     load_branch(f"{folder}/branch.nc").rms("x").tolist() == branch.rms("x").tolist()
    True
    """
    write_dataset(branch_dataset(branch), path)


def load_branch(path: str | Path) -> Branch:
    """Read a branch that :func:`save_branch` wrote; the ``problem`` of its special points is None.

    Raises
    ------
    OSError
        If there is no such file or it can't be read.
    ValueError
        If the file is not a branch, is damaged, or comes from a newer version.
    """
    data = read_dataset(path, FORMAT, SCHEMA)
    try:
        orbits = branch_orbits(data)
        at_points = _orbits(data, "special_", "special_point")
        points = [_special_point(data, i, orbit) for i, orbit in enumerate(at_points)]
        return Branch(
            orbits=tuple(orbits),
            special_points=tuple(points),
            stop=str(data.attrs["stop"]),
            work=json.loads(data.attrs["work"]),
            provenance=json.loads(data.attrs["provenance"]),
            unresolved=tuple(json.loads(data.attrs["unresolved"])),
        )
    except (KeyError, IndexError, ValueError) as error:
        raise ValueError(f"{path} is damaged: its {FORMAT} can't be read ({error}); write it again") from None


# -------------------------------------------------------------------------------------------- writing
def branch_dataset(branch: Branch) -> xr.Dataset:
    """Return a branch as a dataset; raises ValueError if it is empty or of several systems."""
    if not branch.orbits:
        raise ValueError("branch without orbits: expected at least one orbit to save")
    first, points = branch.orbits[0], branch.special_points
    at_points = [p.orbit for p in points]
    for orbit in (*branch.orbits, *at_points):
        if _kind(orbit) != _kind(first):
            raise ValueError(f"branch of several systems: {first.system!r} and {orbit.system!r} don't go into one file")
    most = max(o.harmonic_count for o in (*branch.orbits, *at_points))
    longest = max((len(t) for o in (*branch.orbits, *at_points) for t, _ in o.contacts.values()), default=0)
    variables = {
        **_orbit_variables(branch.orbits, "", "point", most, first),
        **_orbit_variables(at_points, "special_", "special_point", most, first),
        **_contact_variables(branch.orbits, "", "point", longest, first),
        **_contact_variables(at_points, "special_", "special_point", longest, first),
        **_point_variables(points),
        **form_variables(points, len(first.state_names)),
        "parameter": ("point", branch.parameter, about(first.parameter, "units of the system")),
    }
    coordinates = {
        "state": ("state", list(first.state_names), {"long_name": "state variable"}),
        "parameter_name": ("parameter_name", list(first.parameters), {"long_name": "parameter of the system"}),
        "harmonic": ("harmonic", np.arange(most + 1), about("harmonic order over the orbit's period", "1")),
        "complex": ("complex", ["real", "imaginary"], {"long_name": "part of a complex number"}),
    }
    if first.contacts:
        coordinates["contact"] = ("contact", list(first.contacts), {"long_name": "contact of the system"})
    attributes = {
        "title": f"branch of periodic orbits of {first.system}",
        "format": FORMAT,
        "schema": SCHEMA,
        "system": first.system,
        "continuation_parameter": first.parameter,
        "stop": branch.stop,
        "work": _json(branch.work),
        "provenance": _json(branch.provenance),
        "unresolved": json.dumps(list(branch.unresolved)),
    }
    return xr.Dataset(variables, coordinates, attributes)


def _kind(orbit: Orbit) -> tuple:
    return orbit.system, orbit.state_names, orbit.parameter, tuple(orbit.parameters), tuple(orbit.contacts)


def _orbit_variables(orbits: Sequence[Orbit], prefix: str, dimension: str, most: int, like: Orbit) -> dict[str, Any]:
    """Return the variables of a list of orbits, which may be empty; ``like`` then gives the shapes."""
    n, wide = len(like.state_names), len(like.multipliers)
    columns: dict[str, tuple[tuple[int, ...], list]] = {
        "parameters": ((len(like.parameters),), [list(o.parameters.values()) for o in orbits]),
        "period": ((), [o.period for o in orbits]),
        "period_multiple": ((), [o.period_multiple for o in orbits]),
        "harmonic_count": ((), [o.harmonic_count for o in orbits]),
        "coefficients": ((most + 1, n, 2), [_padded(o.coefficients, most) for o in orbits]),
        "multipliers": ((wide, 2), [pairs(o.multipliers) for o in orbits]),
        "multiplier_error": ((wide,), [o.multiplier_error for o in orbits]),
        "stability": ((), [_STABILITY.index(o.stability) for o in orbits]),
        "waveform_error": ((), [o.error for o in orbits]),
        "rms": ((n,), [[o.rms(s) for s in o.state_names] for o in orbits]),
        "second_opinion": ((wide,), [o.second_opinion for o in orbits]),
    }
    whole = {"period_multiple": np.int64, "harmonic_count": np.int64, "stability": np.int8}
    variables = {}
    for name, (shape, rows) in columns.items():
        values = np.array(rows, dtype=whole.get(name, np.float64)).reshape(len(orbits), *shape)
        dimensions, unit, text = (_ORBIT_VARIABLES | _LATER_VARIABLES)[name]
        extra = flags(_STABILITY) if name == "stability" else {}
        variables[prefix + name] = ((dimension, *dimensions), values, about(text, unit) | extra)
    return variables


def _contact_variables(
    orbits: Sequence[Orbit], prefix: str, dimension: str, longest: int, like: Orbit
) -> dict[str, Any]:
    """Return the contact patterns as tables padded with NaN and -1, nothing for a system without contacts."""
    if not like.contacts:
        return {}
    count = np.zeros((len(orbits), len(like.contacts)), dtype=np.int64)
    phases = np.full((*count.shape, longest), np.nan)
    modes = np.full((*count.shape, longest + 1), -1, dtype=np.int64)
    for i, orbit in enumerate(orbits):
        for j, (changes, pieces) in enumerate(orbit.contacts.values()):
            count[i, j] = len(changes)
            phases[i, j, : len(changes)], modes[i, j, : len(pieces)] = changes, pieces
    variables = {}
    for name, values in (("contact_count", count), ("contact_phases", phases), ("contact_modes", modes)):
        dimensions, unit, text = _LATER_VARIABLES[name]
        variables[prefix + name] = ((dimension, *dimensions), values, about(text, unit))
    return variables


def _point_variables(points: Sequence[SpecialPoint]) -> dict[str, Any]:
    row, unit = "special_point", "units of the system"
    bracket = np.array([p.bracket for p in points], dtype=float).reshape(len(points), 2)
    kinds = np.array([_KINDS.index(p.kind) for p in points], dtype=np.int8)
    status = np.array([_STATUS.index(p.status) for p in points], dtype=np.int8)
    return {
        "special_kind": (row, kinds, about("kind of the special point", "1") | flags(_KINDS)),
        "special_parameter": (row, [float(p.parameter) for p in points], about("parameter at the point", unit)),
        "special_error": (row, [float(p.error) for p in points], about("stated error of the parameter", unit)),
        "special_bracket": ((row, "end"), bracket, about("parameters of the neighbouring points", unit)),
        "special_index": (row, np.array([p.index for p in points], dtype=np.int64), about("point before it", "1")),
        "special_status": (row, status, about("whether the location converged", "1") | flags(_STATUS)),
        "special_note": (row, np.array([p.note for p in points], dtype=object), {"long_name": "note"}),
    }


def _padded(coefficients: np.ndarray, most: int) -> np.ndarray:
    full = np.zeros((most + 1, coefficients.shape[1]), dtype=complex)
    full[: len(coefficients)] = coefficients
    return pairs(full)


def _json(values: Mapping[str, Any]) -> str:
    return json.dumps(dict(values), default=lambda scalar: scalar.item())  # numpy scalars become plain numbers


# -------------------------------------------------------------------------------------------- reading
def branch_orbits(data: xr.Dataset) -> list[Orbit]:
    """Return the orbits of a dataset that :func:`branch_dataset` made."""
    return _orbits(data, "", "point")


def _orbits(data: xr.Dataset, prefix: str, dimension: str) -> list[Orbit]:
    names = tuple(str(s) for s in data["state"].values)
    keys = [str(k) for k in data["parameter_name"].values]
    column = {name: data[prefix + name].values for name in _ORBIT_VARIABLES}
    opinion = data.get(prefix + "second_opinion")
    return [
        Orbit(
            system=str(data.attrs["system"]),
            state_names=names,
            parameter=str(data.attrs["continuation_parameter"]),
            parameters=dict(zip(keys, column["parameters"][i].tolist(), strict=True)),
            period=float(column["period"][i]),
            period_multiple=int(column["period_multiple"][i]),
            coefficients=unpaired(column["coefficients"][i, : int(column["harmonic_count"][i]) + 1]),
            multipliers=unpaired(column["multipliers"][i]),
            multiplier_error=column["multiplier_error"][i].copy(),
            stability=_STABILITY[int(column["stability"][i])],
            error=float(column["waveform_error"][i]),
            contacts=_contacts(data, prefix, i),
            second_opinion=np.nan if opinion is None else opinion.values[i],  # type: ignore[arg-type]
        )
        for i in range(data.sizes.get(dimension, 0))
    ]


def _contacts(data: xr.Dataset, prefix: str, i: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    if prefix + "contact_count" not in data:  # a system without contacts, or a file of an earlier version
        return {}
    count, phases, modes = (data[f"{prefix}contact_{k}"].values[i] for k in ("count", "phases", "modes"))
    names = [str(name) for name in data["contact"].values]
    return {name: (phases[j, : count[j]], modes[j, : count[j] + 1]) for j, name in enumerate(names)}


def _special_point(data: xr.Dataset, i: int, orbit: Orbit) -> SpecialPoint:
    low, high = data["special_bracket"].values[i].tolist()
    return SpecialPoint(
        kind=_KINDS[int(data["special_kind"].values[i])],
        parameter=float(data["special_parameter"].values[i]),
        error=float(data["special_error"].values[i]),
        orbit=orbit,
        bracket=(low, high),
        index=int(data["special_index"].values[i]),
        status=_STATUS[int(data["special_status"].values[i])],
        note=str(data["special_note"].values[i]),
        form=load_form(data, i),
    )
