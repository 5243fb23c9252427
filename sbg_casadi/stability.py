"""The Floquet report of one periodic orbit of a pair: what there is at a frequency, and how stable it is."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from continuation import Branch, ContinuationError, Orbit
from continuation.branches.branch import leading
from sbg_casadi.agreement import compare_methods, decide
from sbg_casadi.coexisting import Change, Crossing, crossings, surroundings
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import SCHEMA, STATE, is_complete, to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.response import DONE, IN_PART, PARAMETER, frequency_span, tell_files, trace_response
from sbg_casadi.results import ResultsFolder
from sbg_casadi.stability_numbers import multiplier_rows, orbit_numbers, unstable_types

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("stability.png", "summary.txt", "stability.json", "orbit.nc")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The orbits at one frequency and the one that the report is about.

    Attributes
    ----------
    branch : Branch
        Period-1 response on which they lie.
    crossings : list of Crossing
        All orbits at the frequency, in order along the branch.
    chosen : int
        Position of the one reported, from 0.
    failures : list of str
        What could not be found out, a sentence each.
    """

    branch: Branch
    crossings: list[Crossing]
    chosen: int
    failures: list[str]

    @property
    def crossing(self) -> Crossing:
        """The orbit reported."""
        return self.crossings[self.chosen]


def run_stability(
    pair_name: str,
    *,
    at: float,
    branch: int | None,
    start: float | None,
    stop: float | None,
    state: str | None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
) -> int:
    """Report the stability of one periodic orbit; print the outcome and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    at : float
        Frequency ratio omega_m / omega_n.
    branch : int or None
        Which of the orbits there, from 1 in order along the traced response; None takes the first stable one, or the
        first when none is.
    start, stop : float or None
        First and last frequency ratio of the response traced, default 0.3 and 2.6; ``at`` lies between.
    state : str or None
        State of the pair, the first one when None.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-stability-NAME``; only its own earlier results are
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
        0, or 3 when the response ended early, an orbit at this frequency was not found, or a second method failed.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places.
    ContinuationError
        If no orbit is found at this frequency.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    span = frequency_span(start, stop)
    check_place(at, branch, span)
    d = as_read(pair, state, reading)
    folder = ResultsFolder.claim(
        out or Path(f"sbg-stability-{pair.name}"), f"sbg stability {pair.name}", FILES, json_file
    )
    with Progress() as progress:
        problem, traced = trace_response(d, span, reading=reading, report=progress.task(f"{pair.name}: tracing"))
        found = find_orbits(problem, traced, at, branch, span[1])
        report = progress.task("comparing methods")
        report(0.0, "")
        document = stability_document(pair, d, found, problem, reading) | {"range": list(span)}
    folder.fill(lambda place: _write(place, document, found, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return IN_PART if document["failures"] else DONE


def check_place(at: float, branch: int | None, span: tuple[float, float]) -> None:
    """Raise UserError unless a frequency ratio lies in the range to be traced and a branch number is positive.

    Examples
    --------
    >>> check_place(3.0, None, (0.3, 2.6))
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --at = 3 lies outside the range that is traced, 0.3 to 2.6; expected a ratio inside, \
or a wider range by --from and --to
    """
    if not (math.isfinite(at) and at > 0):
        raise UserError(f"--at = {at:g}; expected a positive frequency ratio such as 0.55")
    if not min(span) <= at <= max(span):
        raise UserError(
            f"--at = {at:.10g} lies outside the range that is traced, {span[0]:g} to {span[1]:g}; expected a ratio "
            "inside, or a wider range by --from and --to"
        )
    if branch is not None and branch < 1:
        raise UserError(f"--branch = {branch}; expected a number from 1")


def find_orbits(problem: Any, traced: Branch, at: float, number: int | None, stop: float) -> Found:
    """Solve for all orbits of a traced response at a frequency ratio and choose one.

    Raises
    ------
    UserError
        If there is no orbit of that number.
    ContinuationError
        If no orbit is found at all, or the multipliers of the one wanted overflow.
    """
    orbits, failures = crossings(problem, traced, at)
    failures += [
        f"the fold at {p.parameter:.10g} +- {p.error:.1e} may lie on either side of {at:.10g}, so that its two orbits "
        "may or may not exist there"
        for p in traced.special_points
        if p.kind == "fold" and abs(p.parameter - at) <= p.error
    ]
    if not is_complete(traced, stop):
        failures.append(f"the response ended early, so that further orbits may exist at {at:.10g}: {traced.stop}")
    if not orbits:
        raise ContinuationError("; ".join(failures))
    if number is not None and number > len(orbits):
        listed = ", ".join(f"{i} (RMS {c.orbit.rms(STATE):.6f}, {c.orbit.stability})" for i, c in enumerate(orbits, 1))
        raise UserError(f"--branch = {number}: expected one of the orbits at {at:.10g}, which are {listed}")
    stable = [i for i, c in enumerate(orbits) if c.orbit.stability == "stable"]
    chosen = (stable or [0])[0] if number is None else number - 1
    if not np.isfinite(orbits[chosen].orbit.multipliers).all():
        raise ContinuationError(
            f"the monodromy matrix of the orbit at {at:.10g} overflows: it is unstable beyond measure"
        )
    return Found(traced, orbits, chosen, failures)


def stability_document(
    pair: Pair, dimensionless: Dimensionless, found: Found, problem: Any, reading: Reading = CONSISTENT
) -> dict[str, Any]:
    """Return the JSON-ready document of one orbit; every number that is printed or drawn comes from it."""
    orbit, derived = found.crossing.orbit, pair.derived
    agreement, certificate = compare_methods(problem, orbit)
    unconfirmed = [
        f"shooting did not confirm the orbit: {why}" for why in [agreement["missing"].get("shooting")] if why
    ]
    around = surroundings(found.branch, found.crossing)
    seconds = None if derived is None else orbit.period / derived.natural_frequency
    rows = multiplier_rows(certificate.multipliers, certificate.error, seconds)
    stability, reason = decide(orbit.value, certificate, around)
    length = None if derived is None else derived.half_backlash
    newton = None if derived is None else derived.mesh_stiffness * derived.half_backlash
    rpm = None if derived is None else derived.unit_ratio_rpm
    orbits = [_brief(number, c.orbit) for number, c in enumerate(found.crossings, 1)]
    orbits[found.chosen]["stability"] = stability
    return {
        "schema": SCHEMA,
        "command": f"sbg stability {pair.name}",
        "pair": pair.name,
        "state": dimensionless.state,
        "reading": reading_name(reading),
        "frequency_ratio": orbit.value,
        "pinion_rpm": None if rpm is None else orbit.value * rpm,
        "mesh_period": orbit.period,
        "mesh_period_seconds": seconds,
        "mesh_frequency_hertz": None if seconds is None else 1 / seconds,
        "orbits": orbits,
        "branch": found.chosen + 1,
        "stability": stability,
        "reason": reason,
        "instabilities": unstable_types(rows),
        "multipliers": rows,
        **_changes(orbit.value, around, rpm, stability),
        **orbit_numbers(orbit, dimensionless, reading, length, newton),
        "waveform_error": max(orbit.error, agreement["waveform"] or 0.0),
        "agreement": agreement,
        "assumed": _assumed(pair, dimensionless.state),
        "unresolved": list(found.branch.unresolved),
        "failures": [*found.failures, *unconfirmed],
        "provenance": dict(found.branch.provenance),
    }


def _assumed(pair: Pair, state: str) -> list[dict[str, Any]]:
    """Return the assumed values of a pair that bear on one state."""
    rows = (row for row in pair.rows() if row.source == "assumed")
    return [row._asdict() for row in rows if row.section == f"states.{state}" or not row.section.startswith("states.")]


def _brief(number: int, orbit: Orbit) -> dict[str, Any]:
    low, high = orbit.extremes(STATE)
    return {
        "branch": number,
        "rms": orbit.rms(STATE),
        "least": low,
        "largest": high,
        "stability": orbit.stability,
        "leading_multiplier": leading(orbit.multipliers),
    }


# -------------------------------------------------------------------------------------------- along the branch
def _changes(at: float, around: dict[str, list[Change]], rpm: float | None, stability: str) -> dict[str, Any]:
    """Return the changes in both directions and the nearest one at which the verdict on the orbit ends."""
    ways = {way: [_change(at, c, rpm) for c in changes] for way, changes in around.items()}
    ends = [
        entry | {"direction": way}
        for way, entries in ways.items()
        for entry in entries
        if stability == "undecided" or (entry["beyond"] == "stable") != (stability == "stable")
    ]
    return {"around": ways, "nearest": min(ends, key=lambda e: abs(e["distance"]), default=None)}


def _change(at: float, change: Change, rpm: float | None) -> dict[str, Any]:
    distance_ = change.parameter - at
    return {
        "kind": change.kind,
        "frequency_ratio": change.parameter,
        "error": change.error if math.isfinite(change.error) else None,
        "distance": distance_,
        "pinion_rpm": None if rpm is None else change.parameter * rpm,
        "distance_rpm": None if rpm is None else distance_ * rpm,
        "beyond": change.beyond,
        "status": change.status,
        "note": change.note,
        "around_fold": change.around_fold,
    }


# -------------------------------------------------------------------------------------------- output
def _write(place: Path, document: dict[str, Any], found: Found, extra: str | None) -> None:
    from sbg_casadi.report import as_text
    from sbg_casadi.stability_figure import save_stability_figure
    from sbg_casadi.stability_report import stability_report

    save_stability_figure(document, place / "stability.png")
    (place / "summary.txt").write_text(as_text(stability_report(document)), encoding="utf-8")
    for name in {"stability.json", extra or "stability.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    orbit = found.crossing.orbit
    stop = f"one orbit, at {PARAMETER} = {orbit.value:.10g}"
    Branch((orbit,), (), stop, {}, found.branch.provenance).save(place / "orbit.nc")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    from sbg_casadi.report import print_all
    from sbg_casadi.stability_report import stability_report

    print_all(console, stability_report(document))
    tell_files(console, folder, FILES)
    console.print(f"{seconds:.1f} s", markup=False)
