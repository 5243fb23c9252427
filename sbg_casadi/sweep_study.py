"""Brute force over the frequency: bifurcation diagram and RMS up and down, with the traced response where wanted."""

from __future__ import annotations

import hashlib
import shutil
import time
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from continuation import Branch, ContinuationError, Sweep, Waterfall, up_and_down
from continuation.model.machine_code import find_compiler
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import SCHEMA, STATE, branch_document, is_complete, to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.model import gear_system, static_state
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress, Report, silent
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.response import DONE, IN_PART, PARAMETER, frequency_span, tell_files, trace_response
from sbg_casadi.results import ResultsFolder
from sbg_casadi.sweep_spectra import spectra, spectra_document

if TYPE_CHECKING:
    from rich.console import Console

FILES = (
    "sweep.png", "waterfall.png", "summary.txt", "sweep.json", "sweep-up.nc", "sweep-down.nc", "waterfall-up.nc",
    "waterfall-down.nc",
)  # fmt: skip
RESPONSE = "period-1.nc"
LOAD = "mesh_force"
INTERRUPTED = 130


@dataclass(frozen=True, slots=True, eq=False)
class SweepSettings:
    """Hold what the user chose of a sweep.

    Attributes
    ----------
    points : int
        Frequencies from the first to the last ratio in equal steps.
    transient, limit, recorded : int
        Mesh periods per frequency: see :func:`continuation.sweep`.
    """

    points: int = 201
    transient: int = 32
    limit: int = 400
    recorded: int = 100

    def check(self) -> None:
        """Raise UserError unless all numbers make sense."""
        if self.points < 2:
            raise UserError(f"--points = {self.points}; expected 2 frequencies or more")
        for option, value in (("--transient", self.transient), ("--limit", self.limit), ("--recorded", self.recorded)):
            if value < 1:
                raise UserError(f"{option} = {value}; expected a positive number of mesh periods")


def run_sweep(
    pair_name: str,
    *,
    start: float | None,
    stop: float | None,
    settings: SweepSettings,
    with_response: bool,
    state: str | None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
) -> int:
    """Sweep a pair up and down; print the outcome and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    start, stop : float or None
        Ends of the range of the frequency ratio, default 0.3 and 2.6.
    settings : SweepSettings
    with_response : bool
        Trace the period-1 response as well and draw it over the sweeps.
    state : str or None
        State of the pair, the first one when None.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-sweep-NAME``; only its own earlier results are
        replaced.
    json_file : Path or None
        Further place for the JSON document.
    console : rich Console
        Where to print.
    reading : frozenset of int
        Rows of the ledger taken as printed.

    Returns
    -------
    int
        0; 3 when a frequency could not be integrated or the response ended early; 130 when interrupted: finished
        frequencies are then kept beside the folder, and the same command goes on there.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    span = frequency_span(start, stop)
    settings.check()
    d = as_read(pair, state, reading)
    path = out or Path(f"sbg-sweep-{pair.name}")
    folder = ResultsFolder.claim(path, f"sbg sweep {pair.name}", (*FILES, RESPONSE), json_file)
    unfinished = _unfinished(path, d, span, settings, reading)
    try:
        with Progress() as progress:
            report = progress.task(f"{pair.name}: sweeps")
            sweeps = sweep_pair(d, span, settings, reading=reading, report=report, resume=unfinished)
            found = spectra(d, sweeps, reading, progress.task(f"{pair.name}: spectra"))
            branch = _response(d, span, reading, progress) if with_response else None
    except KeyboardInterrupt:
        if not unfinished.exists():
            raise
        console.print(
            f"interrupted; finished frequencies are kept in {unfinished}, and the same command goes on there",
            markup=False, soft_wrap=True,
        )  # fmt: skip
        return INTERRUPTED
    document = sweep_document(pair, d, span, sweeps, found, branch, reading, settings)
    folder.fill(lambda place: _write(place, document, sweeps, found, branch, folder.extra))
    shutil.rmtree(unfinished, ignore_errors=True)
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, branch is not None, time.perf_counter() - began)
    return IN_PART if document["failures"] else DONE


def sweep_pair(
    dimensionless: Dimensionless,
    span: tuple[float, float],
    settings: SweepSettings,
    *,
    reading: Reading = CONSISTENT,
    report: Report = silent,
    resume: Path | None = None,
) -> tuple[Sweep, Sweep]:
    """Sweep the frequency ratio up and down from the static state, side by side, with fixed steps.

    Raises
    ------
    ContinuationError
        If the model is too stiff for explicit steps at every frequency.
    """
    return up_and_down(
        gear_system(dimensionless, reading),
        PARAMETER,
        np.linspace(*span, settings.points),
        quantity=STATE,
        load=LOAD,
        start=static_state(dimensionless),
        transient=settings.transient,
        limit=settings.limit,
        recorded=settings.recorded,
        resume="" if resume is None else resume,
        progress=lambda done, total: report(done / total, f"{done} of {total} frequencies"),
    )


def _unfinished(path: Path, *settings: object) -> Path:
    """Return where finished frequencies of just these settings are kept until all are done."""
    key = hashlib.sha256(repr(settings).encode()).hexdigest()[:12]
    target = path.resolve()
    return target.with_name(f".{target.name}.{key}.unfinished")


def _response(
    d: Dimensionless, span: tuple[float, float], reading: Reading, progress: Progress
) -> Branch | ContinuationError:
    try:
        return trace_response(d, span, reading=reading, report=progress.task(f"{d.name}: tracing"))[1]
    except ContinuationError as error:  # the sweeps are worth having without it; the document says so
        return error


# -------------------------------------------------------------------------------------------- document
def sweep_document(
    pair: Pair,
    dimensionless: Dimensionless,
    span: tuple[float, float],
    sweeps: tuple[Sweep, Sweep],
    found: tuple[Waterfall, Waterfall],
    branch: Branch | ContinuationError | None,
    reading: Reading,
    settings: SweepSettings,
) -> dict[str, Any]:
    """Return the JSON-ready document of a sweep; text and figure show its numbers."""
    rpm = None if pair.derived is None else pair.derived.unit_ratio_rpm
    failures = [
        f"sweep {name} at {value:.10g}: {reason}"
        for name, s in zip(("up", "down"), sweeps, strict=True)
        for value, reason in zip(s.values.tolist(), s.failures, strict=True)
        if reason
    ]
    response = None
    if isinstance(branch, Branch):
        response = branch_document(branch, rpm, span[1])
        if not is_complete(branch, span[1]):
            failures.append(f"the response ended early: {branch.stop}")
    elif branch is not None:
        failures.append(f"no response: {branch}")
    return {
        "schema": SCHEMA,
        "command": f"sbg sweep {pair.name}",
        "pair": pair.name,
        "state": dimensionless.state,
        "range": list(span),
        "reading": reading_name(reading),
        "settings": {
            "points": settings.points,
            "transient": settings.transient,
            "limit": settings.limit,
            "recorded": settings.recorded,
        },
        "unit_ratio_rpm": rpm,
        "compiler": find_compiler() or "",
        "sweeps": [direction_document(s, name) for name, s in zip(("up", "down"), sweeps, strict=True)],
        "differences": _differences(*sweeps),
        "spectra": spectra_document(found),
        "response": response,
        "failures": failures,
    }


def direction_document(sweep: Sweep, direction: str) -> dict[str, Any]:
    """Return one sweep of a document: its points, and stretches of neighbouring frequencies with one verdict."""
    data = sweep.to_dict()
    names = {
        "frequency_ratio": "values", "rms": "rms", "mean": "mean", "least": "minimum", "largest": "maximum",
        "dynamic_factor": "dynamic_factor", "period": "period", "verdict": "verdicts", "evidence": "evidence",
        "exponent": "exponent", "exponent_error": "exponent_error", "rotation": "rotation",
        "rotation_error": "rotation_error", "step_error": "step_error", "periods_used": "periods_used",
    }  # fmt: skip
    points = [{k: data[v][i] for k, v in names.items()} for i in range(len(sweep.values))]
    column = sweep.state_names.index(STATE)
    for i, point in enumerate(points):
        table = sweep.points[i, :, column]
        point["poincare"] = table[np.isfinite(table)].tolist()
        point["harmonics"] = data["harmonics"][i]
    stretches = []
    for verdict, group in groupby(points, key=lambda p: p["verdict"]):
        inside = list(group)
        ends = sorted((inside[0]["frequency_ratio"], inside[-1]["frequency_ratio"]))
        stretches.append({"verdict": verdict, "from": ends[0], "to": ends[1], "frequencies": len(inside)})
    return {"direction": direction, "method": sweep.method, "points": points, "stretches": stretches}


def _differences(up: Sweep, down: Sweep) -> list[dict[str, float]]:
    """Return the ranges of neighbouring frequencies at which the sweeps keep to different responses."""
    back = {v: i for i, v in enumerate(down.values.tolist())}
    rows = []
    for i, v in enumerate(up.values.tolist()):
        j = back[v]
        apart = bool(abs(up.rms[i] - down.rms[j]) > 1e-3 * max(up.rms[i], down.rms[j], 1e-3))
        rows.append((v, apart and up.period[i] > 0 and down.period[j] > 0))
    found = []
    for apart, group in groupby(rows, key=lambda r: r[1]):
        values = [v for v, _ in group]
        if apart:
            found.append({"from": values[0], "to": values[-1]})
    return found


# -------------------------------------------------------------------------------------------- output
def _write(
    place: Path,
    document: dict[str, Any],
    sweeps: tuple[Sweep, Sweep],
    found: tuple[Waterfall, Waterfall],
    branch: Branch | ContinuationError | None,
    extra: str | None,
) -> None:
    from sbg_casadi.report import as_text
    from sbg_casadi.sweep_report import sweep_report
    from sbg_casadi.timedomain_figure import save, sweep_figure, waterfall_figure

    traced = branch if isinstance(branch, Branch) else None
    save(sweep_figure(document, sweeps, traced), place / "sweep.png")
    save(waterfall_figure(document, found), place / "waterfall.png")
    (place / "summary.txt").write_text(as_text(sweep_report(document)), encoding="utf-8")
    for name in {"sweep.json", extra or "sweep.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    for name, swept in zip(("up", "down"), sweeps, strict=True):
        swept.save(place / f"sweep-{name}.nc")
    for name, table in zip(("up", "down"), found, strict=True):
        table.save(place / f"waterfall-{name}.nc")
    if traced is not None:
        traced.save(place / RESPONSE)


def _tell(console: Console, document: dict[str, Any], folder: Path, traced: bool, seconds: float) -> None:
    from sbg_casadi.report import print_all
    from sbg_casadi.sweep_report import sweep_report

    print_all(console, sweep_report(document))
    files = (*FILES, RESPONSE) if traced and document["response"] is not None else FILES
    tell_files(console, folder, files)
    console.print(f"{seconds:.1f} s", markup=False)
