"""The map of a pair: where its response folds, doubles and turns into tori over frequency and a quantity."""

from __future__ import annotations

import hashlib
import json
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from continuation.model.machine_code import find_compiler
from sbg_casadi.documents import SCHEMA, to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.map_curves import Curves, find_curves
from sbg_casadi.map_grid import Grid, fill
from sbg_casadi.map_parameters import Varied, vary
from sbg_casadi.map_verdict import least_document
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress
from sbg_casadi.reading import CONSISTENT, Reading, reading_name
from sbg_casadi.response import DONE, IN_PART, frequency_span, tell_files
from sbg_casadi.results import ResultsFolder

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("map.png", "summary.txt", "map.json", "map.nc")
SHAPE = (60, 20)
"""Frequencies and values of the grid."""

CHECKS = 4
"""Values between the first ones at which the response is traced to look for curves not met yet."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What a map is computed with; a rerun with an equal plan goes on where the one before ended.

    Attributes
    ----------
    over : str
        Quantity.
    band, span : (float, float)
        First and last frequency ratio, least and largest value shown.
    shape : (int, int)
        Frequencies and values of the grid.
    checks : int
        See :data:`CHECKS`.
    key : str
        Text that differs when pair or reading do.
    """

    over: str
    band: tuple[float, float]
    span: tuple[float, float]
    shape: tuple[int, int]
    checks: int
    key: str

    def text(self) -> str:
        """Return the plan as text."""
        return json.dumps(
            {name: getattr(self, name) for name in ("over", "band", "span", "shape", "checks", "key")}, sort_keys=True
        )

    def grid(self) -> Grid:
        """Return the grid with nothing computed."""
        low, high = sorted(self.band)
        return Grid.empty(np.linspace(low, high, self.shape[0]), np.linspace(*self.span, self.shape[1]))


def run_map(
    pair_name: str,
    *,
    over: str,
    start: float | None,
    stop: float | None,
    least: float | None,
    most: float | None,
    shape: tuple[int, int] = SHAPE,
    state: str | None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
    checks: int = CHECKS,
    workers: int | None = None,
) -> int:
    """Draw the map of a pair; print the outcome and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    over : str
        Quantity, one of :data:`~sbg_casadi.map_parameters.QUANTITIES`.
    start, stop : float or None
        First and last frequency ratio, default 0.3 and 2.6.
    least, most : float or None
        Range of the quantity as it is shown; default depends on it.
    shape : (int, int)
        Frequencies and values of the grid of attractors.
    state : str or None
        State of the pair for quantities other than the modification, the first one when None.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-map-NAME-QUANTITY``. An interrupted map is kept there
        and a rerun with the same settings goes on with it.
    json_file : Path or None
        Further place for the JSON document.
    console : rich Console
        Where to print.
    reading : frozenset of int
        Rows of the ledger taken as printed.
    checks : int
        Further values at which the response is traced to look for curves.
    workers : int, optional
        Sweeps side by side; as many as there are processors when absent.

    Returns
    -------
    int
        0, or 3 when it was interrupted or something could not be followed; what there is has been written then.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    ContinuationError
        If no response can be traced at all.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    band = frequency_span(start, stop)
    varied = vary(pair, over, state, reading)
    span = value_span(varied, least, most)
    check_shape(shape)
    plan = Plan(over, band, span, shape, checks, _key(varied, reading))
    target = out or Path(f"sbg-map-{pair.name}-{over}")
    folder = ResultsFolder.claim(target, f"sbg map {pair.name} --over {over}", FILES, json_file)
    work = _Work(pair, varied, plan, reading, folder)
    console.print(work.resume(), markup=False, end="")
    try:
        with Progress() as progress:
            work.run(progress, workers)
    except KeyboardInterrupt:
        work.keep()
        console.print(f"interrupted: {work.so_far()}; the same command goes on from there", markup=False)
        console.print(f"kept in {folder.path}", markup=False, soft_wrap=True)
        return IN_PART
    document = work.document()
    folder.fill(lambda place: _write(place, document, work.grid, plan, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return IN_PART if document["failures"] else DONE


def value_span(varied: Varied, least: float | None, most: float | None) -> tuple[float, float]:
    """Return the range of the quantity; raises UserError for one that is empty or that the pair can't have.

    Examples
    --------
    >>> value_span(vary(load_pair("iso-f2"), "modification", None, CONSISTENT), None, 1.0)
    (0.0, 1.0)
    """
    low = varied.span[0] if least is None else least
    high = varied.span[1] if most is None else most
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UserError(f"--least = {low:g} and --most = {high:g}; expected two finite numbers, the first one smaller")
    for value in (low, high):
        varied.at(value)  # raises PairError; all between are possible then, too
    return float(low), float(high)


def check_shape(shape: tuple[int, int]) -> None:
    """Raise UserError unless a grid has at least two frequencies and values, and not too many."""
    if not all(2 <= n <= 1000 for n in shape):
        raise UserError(f"--grid {shape[0]} {shape[1]}; expected numbers of frequencies and values from 2 to 1000")


def _key(varied: Varied, reading: Reading) -> str:
    """Return text that differs when the equations do."""
    numbers = [sorted(varied.at(v).to_dict().items()) for v in varied.span]
    return hashlib.sha256(f"{numbers!r}{reading_name(reading)}".encode()).hexdigest()


class _Work:
    """The stages of a map and what is done of them."""

    def __init__(self, pair: Pair, varied: Varied, plan: Plan, reading: Reading, folder: ResultsFolder) -> None:
        self.pair, self.varied, self.plan, self.reading, self.folder = pair, varied, plan, reading, folder
        self.grid = plan.grid()
        self.curves: dict[str, Any] | None = None
        self.resumed = False

    def resume(self) -> str:
        """Take over what an interrupted run left; return what to tell, empty or a line."""
        place = self.folder.path
        if not (place / "map.nc").exists():
            return ""
        try:
            grid, settings = Grid.load(place / "map.nc")
            stored = json.loads((place / "map.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return f"{place}: the earlier map can't be read; starting anew\n"
        if settings != self.plan.text():
            return f"{place} holds a map with other settings; starting anew, it is replaced by the first results\n"
        if stored.get("complete", True):
            return ""
        self.grid, self.curves, self.resumed = grid, stored["curves"], True
        return f"going on with the map in {place}: {self.so_far()}\n"

    def so_far(self) -> str:
        """Return what is done in words."""
        rows = self.grid.verdict.size // len(self.grid.frequencies)
        curves = "curves done" if self.curves is not None else "no curves yet"
        return f"{rows - len(self.grid.missing)} of {rows} sweeps, {curves}"

    def keep(self) -> None:
        """Write what there is as the results so far."""
        partial = {"schema": SCHEMA, "complete": False, "settings": json.loads(self.plan.text()), "curves": self.curves}

        def write(place: Path) -> None:
            from continuation.netcdf import write_dataset

            write_dataset(self.grid.dataset(self.plan.text()), place / "map.nc")
            (place / "map.json").write_text(to_json(partial), encoding="utf-8")

        self.folder.fill(write)

    def run(self, progress: Progress, workers: int | None) -> None:
        """Do what is left."""
        plan = self.plan
        if self.grid.missing:
            fill(self.grid, self.varied, keep=self.keep, progress=progress.task("attractors"), workers=workers)
        if self.curves is None:
            report = progress.task("curves")
            found = find_curves(self.varied, plan.band, plan.span, checks=plan.checks, report=report)
            report = progress.task("checks")
            least = least_document(self.varied, found, self.grid, plan.band, plan.span, report)
            self.curves = curves_document(found) | {"least": least}
            self.keep()

    def document(self) -> dict[str, Any]:
        """Return the JSON-ready document; text and figure show its numbers."""
        assert self.curves is not None
        varied, compiler = self.varied, find_compiler()
        with_what = "compiled with " + str(compiler) if compiler else "in CasADi's virtual machine, without a compiler"
        return {
            "schema": SCHEMA,
            "complete": True,
            "command": self.folder.command,
            "pair": self.pair.name,
            "state": varied.dimensionless.state if varied.name != "modification" else None,
            "reading": reading_name(self.reading),
            "over": {"name": varied.name, "label": varied.label, "unit": varied.unit},
            "range": list(self.plan.band),
            "span": list(self.plan.span),
            "settings": json.loads(self.plan.text()),
            **self.curves,
            "grid": self.grid.to_dict(),
            "assumed": [row._asdict() for row in self.pair.rows() if row.source == "assumed"],
            "computation": f"Sweeps with fixed steps that land on contact changes, {with_what}"
            + ("." if compiler else "; a C compiler would make them many times faster."),
        }


def curves_document(found: Curves) -> dict[str, Any]:
    """Return curves and slices ready for JSON."""
    return {
        "curves": [
            {
                "kind": c.kind,
                "period_multiple": c.period_multiple,
                "frequency_ratio": c.points[:, 0].tolist(),
                "value": c.points[:, 1].tolist(),
                "origin": c.origin,
                "stop": c.stop,
                "notes": list(c.notes),
                "special_points": [
                    {
                        "kind": s.kind,
                        "frequency_ratio": s.parameters[0],
                        "value": s.parameters[1],
                        "error": [e if math.isfinite(e) else None for e in s.error],
                    }
                    for s in c.special_points
                ],
            }
            for c in found.curves
        ],
        "slices": [
            {
                "value": s.value,
                "points": [
                    {
                        "kind": q.kind,
                        "period_multiple": q.orbit.period_multiple,
                        "frequency_ratio": q.parameter,
                        "error": q.error if math.isfinite(q.error) else None,
                        "curve": number,
                    }
                    for q, number in zip(s.points, s.curves, strict=True)
                ],
            }
            for s in sorted(found.slices, key=lambda s: s.value)
        ],
        "failures": list(dict.fromkeys(found.failures)),
    }


def _write(place: Path, document: dict[str, Any], grid: Grid, plan: Plan, extra: str | None) -> None:
    from continuation.netcdf import write_dataset
    from sbg_casadi.map_figure import save_map_figure
    from sbg_casadi.map_report import map_report, with_curves
    from sbg_casadi.report import as_text

    save_map_figure(document, place / "map.png")
    (place / "summary.txt").write_text(as_text(map_report(document)), encoding="utf-8")
    for name in {"map.json", extra or "map.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    write_dataset(with_curves(grid.dataset(plan.text()), document), place / "map.nc")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    from sbg_casadi.map_report import map_report
    from sbg_casadi.report import print_all

    print_all(console, map_report(document))
    tell_files(console, folder, FILES)
    console.print(f"{seconds:.1f} s", markup=False)
