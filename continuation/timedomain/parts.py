"""Finished values of a long computation, kept in a file so that a rerun goes on where an interrupted one ended."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from continuation.timedomain.sweep_result import Sweep

_EVERY = 5.0  # seconds between writings
_KEY = "fingerprint"


class Keeper:
    """Keep a growing Sweep in a netCDF file, written as a whole each time.

    Parameters
    ----------
    path : Path
        File; its folder must exist.
    fingerprint : str
        Text that names what is computed; a file with another one is refused, never replaced.
    """

    def __init__(self, path: Path, fingerprint: str) -> None:
        self.path, self.fingerprint = path, fingerprint
        self._written = time.monotonic()

    def load(self) -> Sweep | None:
        """Return what is known, or None.

        Raises
        ------
        ValueError
            If the file belongs to another computation, or is no sweep.
        """
        if not self.path.exists():
            if not self.path.parent.is_dir():
                raise ValueError(f"resume: there is no folder {self.path.parent}")
            return None
        from continuation.netcdf import read_dataset

        made = read_dataset(self.path, "sweep", 2).attrs.get(_KEY)
        if made != self.fingerprint:
            raise ValueError(
                f"resume: {self.path} holds values of another computation; expected a new file name, or the same "
                "system, values and settings"
            )
        return Sweep.load(self.path)

    def keep(self, table: Callable[[], Sweep], *, now: bool = False) -> None:
        """Write what there is, at most every 5 seconds unless told."""
        if now or time.monotonic() - self._written > _EVERY:
            table().save(self.path, {_KEY: self.fingerprint})
            self._written = time.monotonic()
