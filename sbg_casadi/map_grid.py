"""The shading of a map: attractors over a grid, by sweeps of the frequency ratio up and down at every value."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from continuation.timedomain.parallel import run_all
from continuation.timedomain.sweep import SweepTask, task
from continuation.timedomain.sweep_result import Sweep
from sbg_casadi.documents import STATE
from sbg_casadi.map_parameters import Varied
from sbg_casadi.model import static_state
from sbg_casadi.response import PARAMETER

DIRECTIONS = ("up", "down")
VERDICTS = ("periodic", "quasi-periodic", "chaotic", "not recognised", "failed", "not computed")
"""What an attractor is; a periodic one has its number of mesh periods beside it."""

_FORMAT, _SCHEMA = "sbg-map", 1
_TRANSIENT, _LIMIT, _RECORDED, _TOLERANCE = 32, 600, 64, 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Attractors over a grid; arrays have the axes direction (up, down), value, frequency.

    Attributes
    ----------
    frequencies : ndarray (k,)
        Frequency ratios, increasing.
    values : ndarray (m,)
        Of the chosen quantity as it is shown.
    verdict : ndarray of int8 (2, m, k)
        Index into :data:`VERDICTS`.
    period : ndarray of int (2, m, k)
        Mesh periods after which the response repeats, 0 when it does not.
    rms : ndarray (2, m, k)
        Of lambda about its mean, half backlashes; NaN where there is none.
    exponent : ndarray (2, m, k)
        Largest Lyapunov exponent per unit of time; NaN for periodic responses.
    """

    frequencies: np.ndarray
    values: np.ndarray
    verdict: np.ndarray
    period: np.ndarray
    rms: np.ndarray
    exponent: np.ndarray

    @classmethod
    def empty(cls, frequencies: np.ndarray, values: np.ndarray) -> Grid:
        """Return a grid of which nothing is computed."""
        shape = 2, len(values), len(frequencies)
        verdict = np.full(shape, VERDICTS.index("not computed"), dtype=np.int8)
        return cls(
            np.sort(frequencies),
            values,
            verdict,
            np.zeros(shape, dtype=int),
            np.full(shape, np.nan),
            np.full(shape, np.nan),
        )

    @property
    def missing(self) -> list[tuple[int, int]]:
        """Rows (direction, value) that are not computed, in the order in which they will be."""
        todo = (self.verdict == VERDICTS.index("not computed")).any(axis=2)
        return [(d, m) for m in range(len(self.values)) for d in (0, 1) if todo[d, m]]

    def put(self, direction: int, row: int, swept: Sweep) -> None:
        """Enter one sweep."""
        order, at = swept.order(), (direction, row)
        self.verdict[at] = [_code(swept.verdicts[i]) for i in order]
        self.period[at] = np.maximum(swept.period[order], 0)
        self.rms[at], self.exponent[at] = swept.rms[order], swept.exponent[order]

    def dataset(self, settings: str) -> Any:
        """Return the grid as an xarray Dataset; ``settings`` is text that says what it was computed with."""
        import xarray as xr

        from continuation.netcdf import about, flags

        axes = ("direction", "value", "frequency")
        data = {
            "verdict": (
                axes,
                self.verdict,
                {"long_name": "attractor"} | flags([v.replace(" ", "_") for v in VERDICTS]),
            ),
            "period": (axes, self.period, about("mesh periods after which the response repeats", "1")),
            "rms": (axes, self.rms, about("root mean square of lambda about its mean", "half backlash")),
            "exponent": (axes, self.exponent, about("largest Lyapunov exponent", "omega_n")),
        }
        coordinates = {
            "direction": np.array(DIRECTIONS, dtype=object),
            "value": self.values,
            "frequency": self.frequencies,
        }
        return xr.Dataset(data, coordinates, {"format": _FORMAT, "schema": _SCHEMA, "settings": settings})

    @classmethod
    def load(cls, path: Path) -> tuple[Grid, str]:
        """Return a grid and its settings from a file; OSError or ValueError if it can't be read."""
        from continuation.netcdf import read_dataset

        data = read_dataset(path, _FORMAT, _SCHEMA)
        names = ("frequency", "value", "verdict", "period", "rms", "exponent")
        return cls(*(data[name].values.copy() for name in names)), str(data.attrs["settings"])

    def counts(self) -> dict[str, int]:
        """Return how many attractors there are of every kind, the most frequent first."""
        words = [word(VERDICTS[v], int(n)) for v, n in zip(self.verdict.ravel(), self.period.ravel(), strict=True)]
        return dict(sorted(((w, words.count(w)) for w in set(words)), key=lambda item: (-item[1], item[0])))

    def to_dict(self) -> dict[str, Any]:
        """Return the grid ready for JSON; numbers that do not exist are None."""
        return {
            "frequency_ratio": self.frequencies.tolist(),
            "value": self.values.tolist(),
            "directions": list(DIRECTIONS),
            "attractor": [[[VERDICTS[v] for v in row] for row in rows] for rows in self.verdict.tolist()],
            "period": self.period.tolist(),
            "rms": _plain(self.rms),
            "exponent": _plain(self.exponent),
            "counts": self.counts(),
        }


def word(verdict: str, period: int) -> str:
    """Return what an attractor is called.

    >>> word("periodic", 2), word("chaotic", 0)
    ('period 2', 'chaotic')
    """
    return f"period {period}" if verdict == "periodic" else verdict


def _code(verdict: str) -> int:
    return VERDICTS.index("periodic" if verdict.startswith("period-") else verdict)


def _plain(values: np.ndarray) -> list[Any]:
    out = values.astype(object)
    out[~np.isfinite(values)] = None
    return out.tolist()


def fill(
    grid: Grid,
    varied: Varied,
    *,
    keep: Callable[[], None],
    progress: Callable[[float, str], None],
    workers: int | None = None,
) -> None:
    """Compute what is missing of a grid, in place.

    Parameters
    ----------
    grid : Grid
    varied : Varied
    keep : callable
        Called whenever some rows have been added.
    progress : callable
    workers : int, optional
        Sweeps side by side, as many as there are processors when absent.
    """
    count = (os.cpu_count() or 1) if workers is None else workers
    total, width = grid.verdict.size, len(grid.frequencies)
    while rows := grid.missing[:count]:
        before = total - width * len(grid.missing)

        def tell(done: int, _: int, before: int = before) -> None:
            progress((before + done) / total, f"{before + done} of {total} attractors")

        tasks = [_row(varied, grid, *at) for at in rows]
        for at, swept in zip(rows, run_all(tasks, count, tell), strict=True):
            grid.put(*at, swept)
        keep()


def _row(varied: Varied, grid: Grid, direction: int, row: int) -> SweepTask:
    """Return the sweep of one value in one direction, from the static state there."""
    shown = float(grid.values[row])
    order = grid.frequencies if direction == 0 else grid.frequencies[::-1]
    return settled(varied, shown, order, static_state(varied.at(shown)))


def settled(varied: Varied, shown: float, frequencies: np.ndarray, start: np.ndarray, limit: int = _LIMIT) -> SweepTask:
    """Return the sweep over some frequency ratios at a value of the quantity, from a state at phase 0."""
    plain = task(
        varied.system, PARAMETER, frequencies, STATE, "", None, start, _TRANSIENT, limit, _RECORDED, _TOLERANCE
    )
    values = {**dict(plain.model.parameters), varied.parameter: varied.inner(shown)}
    return replace(plain, model=replace(plain.model, parameters=tuple(values.items())))
