"""Result of a brute-force response: one row per parameter value; prints, saves and loads itself."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

_FORMAT, _SCHEMA = "sweep", 1

FAILED = -1
"""Period number of a value at which the integrator failed."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Hold a brute-force response; arrays have one row per parameter value, in the order swept.

    Attributes
    ----------
    system : str
        Name of the System.
    parameter, quantity : str
        Swept parameter and the state that the statistics describe.
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

    def __post_init__(self) -> None:
        for f in fields(self):
            if isinstance(array := getattr(self, f.name), np.ndarray):
                array.flags.writeable = False

    def __str__(self) -> str:
        first, last = self.values[0], self.values[-1]
        counts = [(int(n), int((self.period == n).sum())) for n in np.unique(self.period)]
        words = {0: "not recognised", FAILED: "failed"}
        kinds = ", ".join(f"{c} {words.get(n, f'period-{n}')}" for n, c in sorted(counts, reverse=True))
        largest = f"{np.nanmax(self.rms):.6g}" if np.any(np.isfinite(self.rms)) else "unknown"
        over = f"{self.parameter} = {first:g} to {last:g}: {len(self.values)} values ({kinds})"
        work = f"{self.periods_used.sum()} periods by {self.method}"
        return f"Sweep of {self.system!r} over {over}, largest rms of {self.quantity} {largest}, {work}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists, numbers and text, ready for JSON; numbers that do not exist are None."""
        out: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = [_plain(v) for v in value.tolist()]
            out[f.name] = list(value) if isinstance(value, tuple) else value
        return out

    def save(self, path: str | Path) -> None:
        """Write a netCDF file, as a whole or not at all."""
        import xarray as xr  # slow to import, needed here alone

        from continuation.netcdf import write_dataset

        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        data = {k: (("value", "state") if v.ndim == 2 else ("value",), v) for k, v in arrays.items() if _is_array(v)}
        data["failures"] = (("value",), np.array(self.failures, dtype=object))
        text = {k: arrays[k] for k in ("system", "parameter", "quantity", "method")}
        attributes = {"format": _FORMAT, "schema": _SCHEMA, **text, "fixed": json.dumps(self.fixed)}
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
        from continuation.netcdf import read_dataset

        data = read_dataset(path, _FORMAT, _SCHEMA)
        entries: dict[str, Any] = {str(k): data[k].values.copy() for k in data.data_vars if k != "failures"}
        entries |= {k: str(data.attrs[k]) for k in ("system", "parameter", "quantity", "method")}
        names, failures = (tuple(str(v) for v in data[k].values) for k in ("state", "failures"))
        return cls(**entries, fixed=json.loads(data.attrs["fixed"]), state_names=names, failures=failures)


def describe_waveform(waveform: np.ndarray, periodic: bool) -> tuple[float, float, float, float]:
    """Return rms about the mean, mean, minimum and maximum of equidistant samples (k,).

    Extremes lie between samples: they are sought on the quartic through the extreme sample and two more on each side.

    Examples
    --------
    >>> theta = 2 * np.pi * np.arange(64) / 64
    >>> [round(v, 6) for v in describe_waveform(2 + np.cos(theta - 0.04), True)]
    [0.707107, 2.0, 1.0, 3.0]
    """
    mean = float(waveform.mean())
    rms = float(np.sqrt(((waveform - mean) ** 2).mean()))
    return rms, mean, _extreme(waveform, periodic, -1), _extreme(waveform, periodic, 1)


_OFFSETS = np.arange(-2, 3)
_FINE = np.vander(np.linspace(-1, 1, 201), 5) @ np.linalg.inv(np.vander(_OFFSETS.astype(float), 5))


def _extreme(waveform: np.ndarray, periodic: bool, sign: int) -> float:
    k = int((sign * waveform).argmax())
    if not periodic and not 2 <= k < len(waveform) - 2:
        return float(waveform[k])
    return float(sign * (sign * (_FINE @ waveform[(k + _OFFSETS) % len(waveform)])).max())


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray)
