"""Result of a brute-force response: one row per parameter value; prints, saves and loads itself."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

_FORMAT, _SCHEMA = "sweep", 2

HARMONICS = 8
"""Harmonics of the excitation frequency that are kept."""

FAILED = -1
"""Period number of a value at which the integrator failed."""

_NONE = np.empty(0)
_LATER = (
    "dynamic_factor", "step_error", "exponent", "exponent_error", "rotation", "rotation_error", "harmonics", "points",
)  # fmt: skip
_TEXTS = ("failures", "verdicts", "evidence")


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Hold a brute-force response; arrays have one row per parameter value, in the order swept.

    Attributes
    ----------
    system : str
        Name of the System.
    parameter, quantity : str
        Swept parameter and the state or output that the statistics describe.
    method : str
        Integrator and its settings.
    fixed : dict of str to float
        Every other parameter.
    state_names : tuple of str, length n
    values : ndarray (k,)
    rms, mean, minimum, maximum : ndarray (k,)
        Of the quantity over the recorded periods; rms is about the mean. NaN where the integrator failed.
    period : ndarray of int (k,)
        Excitation periods after which the response repeats; 0: not recognised; -1: the integrator failed.
    periods_used : ndarray of int (k,)
        Excitation periods integrated.
    states : ndarray (k, n)
        State at phase 0 at the end.
    failures : tuple of str, length k
        Reason of a failure, else empty.
    verdicts, evidence : tuple of str, length k
        ``period-n``, ``quasi-periodic``, ``chaotic``, ``not recognised`` or ``failed``, and what that rests on.
    dynamic_factor : ndarray (k,)
        Largest over mean value of the load; NaN without one, or when its mean is not positive.
    step_error : ndarray (k,)
        Change of the state after one period of a recognised response, over the largest states, when steps are halved;
        NaN for integrators that keep a tolerance.
    exponent, exponent_error : ndarray (k,)
        Largest Lyapunov exponent per unit of time and its standard error, where the response was not recognised.
    rotation, rotation_error : ndarray (k,)
        Rotation number of the Poincare points, where the response was not recognised.
    harmonics : ndarray of complex (k, 9)
        Amplitudes c of ``Re sum c_j exp(i j theta)`` of the quantity at the excitation frequency and its multiples.
    points : ndarray (k, m, n)
        Poincare points: states at phase 0, NaN beyond the last one of each value.
    """

    system: str
    parameter: str
    quantity: str
    method: str
    fixed: dict[str, float]
    state_names: tuple[str, ...]
    values: np.ndarray
    rms: np.ndarray
    mean: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray
    period: np.ndarray
    periods_used: np.ndarray
    states: np.ndarray
    failures: tuple[str, ...]
    verdicts: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ()
    dynamic_factor: np.ndarray = field(default_factory=lambda: _NONE)
    step_error: np.ndarray = field(default_factory=lambda: _NONE)
    exponent: np.ndarray = field(default_factory=lambda: _NONE)
    exponent_error: np.ndarray = field(default_factory=lambda: _NONE)
    rotation: np.ndarray = field(default_factory=lambda: _NONE)
    rotation_error: np.ndarray = field(default_factory=lambda: _NONE)
    harmonics: np.ndarray = field(default_factory=lambda: _NONE)
    points: np.ndarray = field(default_factory=lambda: _NONE)

    def __post_init__(self) -> None:
        count, shapes = len(self.values), {"harmonics": (HARMONICS + 1,), "points": (0, len(self.state_names))}
        if not self.verdicts:
            object.__setattr__(self, "verdicts", tuple(period_verdict(int(n)) for n in self.period))
            object.__setattr__(self, "evidence", ("",) * count)
        for name in _LATER:
            if getattr(self, name) is _NONE:
                kind = complex if name == "harmonics" else float
                object.__setattr__(self, name, np.full((count, *shapes.get(name, ())), np.nan, dtype=kind))
        for f in fields(self):
            if isinstance(array := getattr(self, f.name), np.ndarray):
                array.flags.writeable = False

    def __str__(self) -> str:
        first, last = self.values[0], self.values[-1]
        counts = Counter(self.verdicts)
        order = sorted(counts, key=lambda v: (-int(self.period[self.verdicts.index(v)]), v))
        kinds = ", ".join(f"{counts[v]} {v}" for v in order)
        largest = f"{np.nanmax(self.rms):.6g}" if np.any(np.isfinite(self.rms)) else "unknown"
        over = f"{self.parameter} = {first:g} to {last:g}: {len(self.values)} values ({kinds})"
        work = f"{self.periods_used.sum()} periods by {self.method}"
        return f"Sweep of {self.system!r} over {over}, largest rms of {self.quantity} {largest}, {work}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists, numbers and text, ready for JSON; numbers that do not exist are None."""
        from continuation.netcdf import pairs  # xarray is slow to import

        out: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = pairs(value) if np.iscomplexobj(value) else value
                value = [_plain(v) for v in value.tolist()]
            out[f.name] = list(value) if isinstance(value, tuple) else value
        return out

    def save(self, path: str | Path, more: dict[str, str] | None = None) -> None:
        """Write a netCDF file, as a whole or not at all, with further attributes if given."""
        import xarray as xr  # slow to import, needed here alone

        from continuation.netcdf import pairs, write_dataset

        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        axes = {"states": ("state",), "points": ("point", "state"), "harmonics": ("harmonic", "part")}
        data = {k: (("value", *axes.get(k, ())), v) for k, v in arrays.items() if isinstance(v, np.ndarray)}
        data["harmonics"] = (data["harmonics"][0], pairs(self.harmonics))
        for name in _TEXTS:
            data[name] = (("value",), np.array(arrays[name], dtype=object))
        text = {k: arrays[k] for k in ("system", "parameter", "quantity", "method")}
        attributes = {"format": _FORMAT, "schema": _SCHEMA, **text, "fixed": json.dumps(self.fixed), **(more or {})}
        coordinates = {"state": np.array(self.state_names, dtype=object)}
        write_dataset(xr.Dataset(data, coordinates, attributes), path)

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read a file that :meth:`save` wrote.

        Raises
        ------
        OSError
            If the file can't be read.
        ValueError
            If it holds something else.
        """
        from continuation.netcdf import read_dataset, unpaired

        data = read_dataset(path, _FORMAT, _SCHEMA)
        entries: dict[str, Any] = {str(k): data[k].values.copy() for k in data.data_vars if k not in _TEXTS}
        entries["harmonics"] = unpaired(entries["harmonics"])
        entries |= {k: str(data.attrs[k]) for k in ("system", "parameter", "quantity", "method")}
        entries |= {k: tuple(str(v) for v in data[k].values) for k in _TEXTS}
        names = tuple(str(v) for v in data["state"].values)
        return cls(**entries, fixed=json.loads(data.attrs["fixed"]), state_names=names)

    def order(self) -> np.ndarray:
        """Return the positions of the values in increasing order."""
        return np.argsort(self.values, kind="stable")


def joined(parts: list[Sweep]) -> Sweep:
    """Return parts of one sweep as one, in their order.

    Raises
    ------
    ValueError
        If there is no part.
    """
    if not parts:
        raise ValueError("joined: expected at least one part of a sweep")
    entries: dict[str, Any] = {}
    for f in fields(Sweep):
        pieces = [getattr(part, f.name) for part in parts]
        if isinstance(pieces[0], np.ndarray):
            if f.name == "points":
                longest = max(p.shape[1] for p in pieces)
                pieces = [
                    np.pad(p, ((0, 0), (0, longest - p.shape[1]), (0, 0)), constant_values=np.nan) for p in pieces
                ]
            entries[f.name] = np.concatenate(pieces)
        elif f.name in _TEXTS:
            entries[f.name] = tuple(text for piece in pieces for text in piece)
        else:
            entries[f.name] = pieces[0]
    return Sweep(**entries)


def period_verdict(period: int) -> str:
    """Return the words for a period number.

    >>> period_verdict(2), period_verdict(0), period_verdict(-1)
    ('period-2', 'not recognised', 'failed')
    """
    return {0: "not recognised", FAILED: "failed"}.get(period, f"period-{period}")


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)
