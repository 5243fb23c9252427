"""Curves in two parameters as netCDF files that xarray, MATLAB and Julia read, in the form of branch files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import xarray as xr

from continuation.branches.branch import Branch, Kind
from continuation.branches.codimension_two import CurvePoint, PointKind
from continuation.branches.tracked import CURVE_SCHEMA, Curve
from continuation.netcdf import about, flags, read_dataset, write_dataset
from continuation.storage import branch_dataset, branch_orbits

FORMAT = "continuation curve"
_KINDS = get_args(Kind)
_POINTS = get_args(PointKind)


def save_curve(curve: Curve, path: str | Path) -> None:
    """Write a curve to a netCDF file; a temporary file in the same folder takes its place, or nothing changes.

    Every number is kept exactly. Raises OSError if the file can't be written, ValueError for a curve without points.
    """
    data = branch_dataset(Branch(curve.orbits, (), curve.stop, {}, {}))
    unit = "units of the system"
    place = np.array([p.parameters for p in curve.points], dtype=float).reshape(-1, 2)
    error = np.array([p.error for p in curve.points], dtype=float).reshape(-1, 2)
    kinds = np.array([_POINTS.index(p.kind) for p in curve.points], dtype=np.int8)
    index = np.array([p.index for p in curve.points], dtype=np.int64)
    found: dict[str, Any] = {
        "values": (("point", "axis"), curve.values, about("the two parameters along the curve", unit)),
        "error": (("point", "axis"), curve.error, about("stated error of the two parameters", unit)),
        "rotation_number": ("point", curve.rotation_number, about("angle of the critical multiplier over 2 pi", "1")),
        "degenerate_kind": ("degenerate", kinds, about("kind of the point of codimension two", "1") | flags(_POINTS)),
        "degenerate_values": (("degenerate", "axis"), place, about("the two parameters at the point", unit)),
        "degenerate_error": (("degenerate", "axis"), error, about("stated error of them", unit)),
        "degenerate_index": ("degenerate", index, about("curve point before it", "1")),
    }
    kept = [name for name in data.variables if not str(name).startswith("special_")]
    names = ("axis", list(curve.parameters), {"long_name": "parameter of the curve"})
    whole = data[kept].assign(found).assign_coords(axis=names)
    attributes: dict[str, Any] = {"title": f"curve of {curve.kind}s of {curve.orbits[0].system}", "format": FORMAT}
    attributes |= {"schema": CURVE_SCHEMA, "kind": curve.kind, "notes": json.dumps(list(curve.notes))}
    write_dataset(whole.assign_attrs({**data.attrs, **attributes}), path)


def load_curve(path: str | Path) -> Curve:
    """Read a curve that :func:`save_curve` wrote.

    Raises OSError if it can't be read, ValueError if it is not a curve, is damaged, or comes from a newer version.
    """
    data = read_dataset(path, FORMAT, CURVE_SCHEMA)
    try:
        kind = str(data.attrs["kind"])
        first, second = (str(name) for name in data["axis"].values)
        return Curve(
            kind=_KINDS[_KINDS.index(kind)],
            parameters=(first, second),
            values=data["values"].values,
            error=data["error"].values,
            rotation_number=data["rotation_number"].values,
            orbits=tuple(branch_orbits(data)),
            points=tuple(_point(data, i) for i in range(data.sizes.get("degenerate", 0))),
            stop=str(data.attrs["stop"]),
            notes=tuple(json.loads(data.attrs["notes"])),
        )
    except (KeyError, IndexError, ValueError) as error:
        raise ValueError(f"{path} is damaged: its {FORMAT} can't be read ({error}); write it again") from None


def _point(data: xr.Dataset, i: int) -> CurvePoint:
    p, q = data["degenerate_values"].values[i].tolist()
    dp, dq = data["degenerate_error"].values[i].tolist()
    kind = _POINTS[int(data["degenerate_kind"].values[i])]
    return CurvePoint(kind, (p, q), (dp, dq), int(data["degenerate_index"].values[i]))
