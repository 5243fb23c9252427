"""The main job: one pair before and after a modification, traced, cross-checked in the time domain and written."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from continuation.branches.branch import Branch
from continuation.errors import ContinuationError
from continuation.model.compiled import compiled_march
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.parallel import up_and_down
from continuation.timedomain.sweep import Sweep
from sbg_casadi.crosscheck import cross_check
from sbg_casadi.documents import SCHEMA, STATE, response_document, to_json
from sbg_casadi.errors import PairError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.mesh import peak_to_peak
from sbg_casadi.model import gear_system, static_state
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress
from sbg_casadi.quantities import quantities, speed_warnings
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.response import (
    DONE,
    IN_PART,
    PARAMETER,
    frequency_span,
    run_response,
    tell_files,
    trace_response,
)
from sbg_casadi.results import ResultsFolder

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["COMPARED", "SWEEP_POINTS", "run_response", "run_study"]

COMPARED = ("before", "after")
SWEEP_POINTS = 47
"""Frequencies of each sweep: every 0.05 of the default range."""

_FILES = ("response.png", "summary.txt", "study.json")
_KINDS = ("period-1", "sweep-up", "sweep-down")


@dataclass(frozen=True, slots=True, eq=False)
class StateResult:
    """What a study finds for one state.

    Attributes
    ----------
    state : str
    branch : Branch
        Period-1 response.
    sweeps : tuple of Sweep
        Up and down.
    document : dict
        The numbers of both, JSON-ready.
    """

    state: str
    branch: Branch
    sweeps: tuple[Sweep, Sweep]
    document: dict[str, Any]


def run_study(
    pair_name: str,
    *,
    out: Path | None,
    start: float | None,
    stop: float | None,
    json_file: Path | None,
    console: Console,
    sweep_points: int = SWEEP_POINTS,
    reading: Reading = CONSISTENT,
) -> int:
    """Compare a pair before and after a modification; print the outcome and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file with the states ``before`` and ``after``.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-study-NAME``; its earlier results are replaced as
        a whole, and nothing else is ever replaced.
    start, stop : float or None
        First and last frequency ratio, default 0.3 and 2.6.
    json_file : Path or None
        Further place for the JSON document.
    console : rich Console
        Where to print.
    sweep_points : int
        Frequencies of each sweep, from ``start`` to ``stop`` in equal steps.
    reading : frozenset of int
        Rows of the ledger taken as printed, for both states.

    Returns
    -------
    int
        0 when both branches reach ``stop``, 3 when one ends before; what there is has been written then, too.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    KeyboardInterrupt
        On Ctrl-C, after a line about what was finished; nothing is written.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    missing = [s for s in COMPARED if s not in pair.states]
    if missing:
        raise PairError(
            f"pair {pair.name!r} has no state {missing[0]!r} (it has {', '.join(pair.states)}); expected the states "
            "'before' and 'after' to compare, as tables [states.before] and [states.after]"
        )
    span = frequency_span(start, stop)
    as_read(pair, None, reading)  # refuses a reading that the pair can't have before anything is written
    files = (*_FILES, *(f"{s}-{kind}.nc" for s in COMPARED for kind in _KINDS))
    folder = ResultsFolder.claim(out or Path(f"sbg-study-{pair.name}"), f"sbg study {pair.name}", files, json_file)
    results, failures = _compute(pair, span, sweep_points, reading, console)
    document = study_document(pair, span, results, reading) | {"failures": failures}
    folder.fill(lambda place: _write(place, document, results, pair, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return DONE if not failures and all(r.document["branches"][0]["complete"] for r in results) else IN_PART


def _compute(
    pair: Pair, span: tuple[float, float], sweep_points: int, reading: Reading, console: Console
) -> tuple[list[StateResult], list[str]]:
    """Return the results of the states and a sentence for each that failed; if all did, raise the last error."""
    results: list[StateResult] = []
    failures: list[str] = []
    try:
        with Progress() as progress:
            for state in COMPARED:
                try:
                    results.append(study_state(pair, state, span, sweep_points, progress, reading))
                except ContinuationError as error:
                    failures.append(f"state {state!r}: {error}")
                    if len(failures) == len(COMPARED):
                        raise
    except KeyboardInterrupt:
        finished = " and ".join(r.state for r in results) or "nothing"
        console.print(f"finished before the interrupt: {finished}", markup=False)
        raise
    return results, failures


def study_state(
    pair: Pair,
    state: str,
    span: tuple[float, float],
    sweep_points: int,
    progress: Progress,
    reading: Reading = CONSISTENT,
) -> StateResult:
    """Trace one state, sweep it up and down, and compare the two.

    Raises
    ------
    ContinuationError
        If there is no orbit at the first frequency ratio.
    """
    d = as_read(pair, state, reading)
    problem, branch = trace_response(d, span, reading=reading, report=progress.task(f"{state}: tracing"))
    report = progress.task(f"{state}: sweeps")
    system = gear_system(d, reading)
    march, note = compiled_march(system, min(span))
    sweeps = up_and_down(
        system,
        PARAMETER,
        np.linspace(*span, sweep_points),
        quantity=STATE,
        start=static_state(d),
        integrator=CVODES(),  # another way than the branch, and than sbg sweep
        march=march,
        progress=lambda done, total: report(done / total, f"{done} of {total} frequencies"),
    )
    document = response_document(branch, pair, state, 0.0, span[1]) | {
        "stiffness_peak_to_peak": peak_to_peak(d.stiffness_cosine, d.stiffness_sine),
        "cross_check": cross_check(problem, branch, sweeps),
        "compiler": {"used": bool(march), "note": note},
    }
    return StateResult(state, branch, sweeps, document)


def study_document(
    pair: Pair, span: tuple[float, float], results: list[StateResult], reading: Reading = CONSISTENT
) -> dict[str, Any]:
    """Return the JSON-ready document of a study; text and figure show its numbers."""
    return {
        "schema": SCHEMA,
        "command": f"sbg study {pair.name}",
        "pair": pair.name,
        "range": list(span),
        "reading": reading_name(reading),
        "quantities": quantities(pair, COMPARED[0], reading),
        "warnings": speed_warnings(pair, span),
        "assumed": [row._asdict() for row in pair.rows() if row.source == "assumed"],
        "states": [r.document for r in results],
        "comparison": comparison([r.document for r in results]),
        "computation": _computation([r.document["compiler"] for r in results]),
    }


def comparison(documents: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the largest RMS (half backlashes) and the numbers of special points of each state, and their changes."""
    states = {d["state"]: _summary(d) for d in documents}
    first, last = (states[d["state"]] for d in (documents[0], documents[-1]))
    keys = ("largest_rms", "largest_stable_rms", "largest_sweep_rms")
    change = {k: last[k] / first[k] - 1 if first[k] and last[k] is not None else None for k in keys}
    return {"states": states, "change": change}


def _summary(document: dict[str, Any]) -> dict[str, Any]:
    branch = document["branches"][0]
    swept = [p["rms"] for s in document["cross_check"]["sweeps"] for p in s["points"] if p["rms"] is not None]
    stable = [p["rms"] for p in branch["points"] if p["stability"] == "stable"]
    return {
        "largest_rms": max(p["rms"] for p in branch["points"]),
        "largest_stable_rms": max(stable, default=None),
        "largest_sweep_rms": max(swept, default=None),
        "special_points": dict(Counter(p["kind"] for p in branch["special_points"])),
    }


def _computation(compilers: list[dict[str, Any]]) -> str:
    """Say what ran and what part a C compiler had in it."""
    notes = "; ".join(dict.fromkeys(c["note"] for c in compilers))
    if all(c["used"] for c in compilers):
        return f"Sweeps: transients {notes}, then CVODES of SUNDIALS through CasADi."
    alone = f"Sweeps ran with CVODES of SUNDIALS through CasADi alone ({notes})"
    return f"{alone}; a C compiler would shorten the transients."


def _write(place: Path, document: dict[str, Any], results: list[StateResult], pair: Pair, extra: str | None) -> None:
    from sbg_casadi.figure import response_figure, save_figure
    from sbg_casadi.report import as_text, study_report

    branches, sweeps = {r.state: r.branch for r in results}, {r.state: r.sweeps for r in results}
    rpm = None if pair.derived is None else pair.derived.unit_ratio_rpm
    save_figure(response_figure(f"{pair.name}: before and after", branches, sweeps, rpm), place)
    (place / "summary.txt").write_text(as_text(study_report(document)), encoding="utf-8")
    for name in {"study.json", extra or "study.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    for r in results:
        for kind, save in zip(_KINDS, (r.branch.save, r.sweeps[0].save, r.sweeps[1].save), strict=True):
            save(place / f"{r.state}-{kind}.nc")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    from sbg_casadi.report import print_all, study_report

    print_all(console, study_report(document))
    files = [*_FILES, *(f"{s['state']}-{kind}.nc" for s in document["states"] for kind in _KINDS)]
    tell_files(console, folder, files)
    console.print(f"{seconds:.1f} s", markup=False)
