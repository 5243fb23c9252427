"""netCDF files written as a whole or not at all, without pickle; complex numbers with a last axis of length 2."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

_ENGINE: Any = "h5netcdf"
_PACK = {"zlib": True, "complevel": 1, "shuffle": True}


def write_dataset(data: xr.Dataset, path: str | Path) -> None:
    """Write a dataset atomically as netCDF; floats are packed without loss and NaN stays NaN."""
    path = Path(path).resolve()
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".tmp")
    os.close(handle)
    encoding: dict[str, dict[str, Any]] = {}
    for name, variable in data.variables.items():
        numbers = variable.dtype.kind in "fiu"
        encoding[str(name)] = {"_FillValue": None} if numbers else {}
        if numbers and variable.size > 1000:
            encoding[str(name)] |= _PACK
    try:
        data.to_netcdf(temporary, engine=_ENGINE, encoding=encoding)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:  # also on an interrupt: no leftovers
        Path(temporary).unlink(missing_ok=True)
        raise


def read_dataset(path: str | Path, kind: str, schema: int) -> xr.Dataset:
    """Read a dataset whose attributes ``format`` and ``schema`` are as wanted, wholly into memory.

    Raises
    ------
    OSError
        If there is no such file or it can't be read.
    ValueError
        If it is not a netCDF file of that format, or comes from a newer version.
    """
    with open(path, "rb"):  # missing, a folder, not readable: the operating system's own words
        pass
    try:
        with xr.open_dataset(path, engine=_ENGINE, decode_timedelta=False) as stored:
            data = stored.load()
    except Exception as error:  # damaged HDF5 answers with many kinds of error, from OSError to KeyError
        raise ValueError(f"{path} is not a readable netCDF file; expected a {kind} file") from error
    if data.attrs.get("format") != kind:
        raise ValueError(f"{path} is a netCDF file without a {kind}; expected one that this package wrote")
    if int(data.attrs.get("schema", 0)) != schema:
        raise ValueError(f"{path} has the schema {data.attrs.get('schema')}; this version reads schema {schema}")
    return data


def _umask() -> int:
    """Return the process's file mode mask, which can only be read by setting it."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def pairs(values: np.ndarray) -> np.ndarray:
    """Return complex numbers with a last axis (real, imaginary)."""
    values = np.asarray(values, dtype=complex)
    return np.stack([values.real, values.imag], axis=-1)


def unpaired(pairs: np.ndarray) -> np.ndarray:
    """Return complex numbers bit for bit: adding 1j * imaginary would turn a real part of -0.0 into 0.0."""
    whole = np.empty(pairs.shape[:-1], dtype=complex)
    whole.real, whole.imag = pairs[..., 0], pairs[..., 1]
    return whole


def about(text: str, unit: str) -> dict[str, Any]:
    return {"long_name": text, "units": unit}


def flags(meanings: Sequence[str]) -> dict[str, Any]:
    """Return the attributes that say what the numbers of a variable mean (CF conventions, section 3.5)."""
    return {"flag_values": np.arange(len(meanings), dtype=np.int8), "flag_meanings": " ".join(meanings)}
