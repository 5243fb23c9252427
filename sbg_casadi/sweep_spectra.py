"""Spectra along the sweeps of a pair, tracked by order of the mesh frequency: the waterfall."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation import Sweep, Waterfall, waterfall
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import STATE
from sbg_casadi.model import gear_system
from sbg_casadi.progress import Report, silent
from sbg_casadi.reading import CONSISTENT, Reading

RECORD = 64
"""Mesh periods of a spectrum; orders are resolved to their inverse."""

HIGHEST = 8.0
"""Largest order."""

_WHOLE = 2 / RECORD  # a line so close to a whole order belongs to it: a Hann window has three lines


def spectra(
    dimensionless: Dimensionless, sweeps: tuple[Sweep, Sweep], reading: Reading = CONSISTENT, report: Report = silent
) -> tuple[Waterfall, Waterfall]:
    """Return the spectra of lambda along both sweeps, from the states where they ended at every frequency."""
    system, found = gear_system(dimensionless, reading), []
    for k, (name, swept) in enumerate(zip(("up", "down"), sweeps, strict=True)):
        report(k / len(sweeps), f"spectra, {name}")
        found.append(waterfall(system, swept, quantity=STATE, periods=RECORD, highest=HIGHEST))
    return found[0], found[1]


def spectra_document(found: tuple[Waterfall, Waterfall]) -> dict[str, Any]:
    """Return what the spectra show, JSON-ready: at every frequency the largest line that is no whole order.

    The amplitudes themselves, some hundred for every frequency, are in the netCDF files.
    """
    directions = []
    for name, table in zip(("up", "down"), found, strict=True):
        between = abs(table.orders - np.round(table.orders)) >= _WHOLE
        lines = np.where(between, table.amplitudes, -1.0)
        rows = []
        for k, value in enumerate(table.values.tolist()):
            known = bool(np.all(np.isfinite(table.amplitudes[k])))
            j = int(lines[k].argmax()) if known else 0
            largest = {"order": float(table.orders[j]), "amplitude": float(table.amplitudes[k, j])} if known else None
            rows.append({"frequency_ratio": value, "largest_between": largest, "failure": table.failures[k]})
        directions.append({"direction": name, "points": rows})
    return {"periods": RECORD, "highest_order": HIGHEST, "directions": directions}
