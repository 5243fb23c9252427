"""One response in the time domain: Poincare points, phase portrait, spectrum and Lyapunov exponents at a frequency."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from continuation import (
    ContactChange,
    ContinuationError,
    Simulation,
    Sweep,
    System,
    lyapunov_spectrum,
    poincare_section,
    simulate,
    sweep,
)
from continuation.timedomain.fixed_step import FixedStep, SuitableSteps
from continuation.timedomain.waveform import order_spectrum
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import SCHEMA, STATE, to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.model import gear_system, static_state
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress, Report, silent
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.response import DONE, IN_PART, PARAMETER, tell_files
from sbg_casadi.results import ResultsFolder
from sbg_casadi.section_series import no_series, series_document
from sbg_casadi.sweep_study import LOAD

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("section.png", "summary.txt", "section.json", "section.nc")
RATE = f"d{STATE}"

_APPROACH = 25  # frequencies of the sweep that leads to the one wanted
_POINTS = 512  # stroboscopic points of a response that does not repeat
_ONSET = 256
_RECORD = 128  # mesh periods of the spectrum
_DRAWN = 16  # mesh periods of the phase portrait
_AVERAGED = 400  # mesh periods of the exponents


def run_section(
    pair_name: str,
    *,
    at: float,
    start: float | None,
    state: str | None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
) -> int:
    """Look at one response of a pair in the time domain; print what it is and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    at : float
        Frequency ratio omega_m / omega_n.
    start : float or None
        Frequency ratio from which the response is followed to ``at`` by a sweep; None begins at ``at`` itself, from
        the static state.
    state : str or None
        State of the pair, the first one when None.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-section-NAME``; only its own earlier results are
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
        0, or 3 when the exponents could not be computed.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    ContinuationError
        If the response can't be integrated.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    for option, value in (("--at", at), ("--from", start)):
        check_ratio(option, value)
    d = as_read(pair, state, reading)
    path = out or Path(f"sbg-section-{pair.name}")
    folder = ResultsFolder.claim(path, f"sbg section {pair.name}", FILES, json_file)
    with Progress() as progress:
        document, found = section_document(pair, d, at, start, reading, progress.task(f"{pair.name}: integrating"))
    folder.fill(lambda place: _write(place, document, found, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return IN_PART if document["failures"] else DONE


def check_ratio(option: str, value: float | None) -> None:
    """Raise UserError unless a frequency ratio, where given, is finite and positive.

    Examples
    --------
    >>> check_ratio("--at", -1.0)
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --at = -1; expected a positive frequency ratio such as 0.55
    """
    if value is not None and not (math.isfinite(value) and value > 0):
        raise UserError(f"{option} = {value:g}; expected a positive frequency ratio such as 0.55")


def section_document(
    pair: Pair,
    dimensionless: Dimensionless,
    at: float,
    start: float | None,
    reading: Reading = CONSISTENT,
    report: Report = silent,
) -> tuple[dict[str, Any], Sweep]:
    """Return the JSON-ready document of one response, and the sweep of one value that found it.

    Raises
    ------
    ContinuationError
        If the response can't be integrated.
    """
    system = gear_system(dimensionless, reading)
    found = _settle(system, dimensionless, at, start, report)
    x, fixed = found.states[-1], FixedStep(SuitableSteps(system)(system.parameter_vector({PARAMETER: at})))
    period = int(found.period[-1])
    report(0.5, "section and spectrum")
    record = simulate(system, x, _RECORD, integrator=fixed, frequency_ratio=at)
    onset = poincare_section(
        system, x, ContactChange(direction=1), count=_ONSET, transient=0, limit=_POINTS, integrator=fixed,
        frequency_ratio=at,
    )  # fmt: skip
    report(0.7, "exponents")
    exponents, failures = _exponents(system, x, at, fixed)
    seconds = None if pair.derived is None else 2 * math.pi / (at * pair.derived.natural_frequency)
    if period:
        series = no_series("the response repeats, so that neighbours do not part")
    else:
        report(0.9, "exponents of the series")
        series = series_document(system, x, fixed, {PARAMETER: at}, seconds)
    columns = [system.state_names.index(STATE), system.state_names.index(RATE)]
    strobe = found.points[-1][np.isfinite(found.points[-1]).all(axis=1)]
    waveform = record.states[:-1, columns[0]]
    orders, amplitudes = order_spectrum(waveform, _RECORD)
    drawn = (period if 0 < period <= _DRAWN else _DRAWN) * 64 + 1
    document = {
        "schema": SCHEMA,
        "command": f"sbg section {pair.name}",
        "pair": pair.name,
        "state": dimensionless.state,
        "reading": reading_name(reading),
        "frequency_ratio": at,
        "from": start,
        "mesh_period_seconds": seconds,
        "method": repr(fixed),
        "verdict": found.verdicts[-1],
        "evidence": found.evidence[-1],
        "period": period,
        "rotation": _finite(found.rotation[-1]),
        "rotation_error": _finite(found.rotation_error[-1]),
        **{k: _finite(getattr(found, v)[-1]) for k, v in
           {"rms": "rms", "mean": "mean", "least": "minimum", "largest": "maximum", "dynamic_factor": "dynamic_factor",
            "step_error": "step_error"}.items()},
        "contact": _shares(record),
        "harmonics": [[c.real, c.imag] for c in found.harmonics[-1].tolist()],
        "strobe": strobe[:, columns].tolist(),
        "onset": onset.points[:, columns].tolist(),
        "onset_phase": np.mod(onset.phases, 2 * np.pi).tolist(),
        "portrait": record.states[:drawn, columns].tolist(),
        "spectrum": {"orders": orders.tolist(), "amplitudes": amplitudes.tolist(), "periods": _RECORD},
        "exponents": _rows(exponents, at, seconds),
        "exponent_sum": None if exponents is None else {"sum": exponents.total, "error": exponents.total_error,
                                                        "trace": exponents.trace, "periods": exponents.periods},
        "series_exponents": series,
        "failures": failures,
    }  # fmt: skip
    return document, found


def _settle(system: System, d: Dimensionless, at: float, start: float | None, report: Report) -> Sweep:
    """Return the sweep of one value at the frequency, after one that leads there where wanted."""
    x = static_state(d)
    if start is not None and start != at:
        values = np.linspace(start, at, _APPROACH)[:-1]
        way = sweep(
            system, PARAMETER, values, quantity=STATE, start=x, limit=164, recorded=64,
            progress=lambda done, total: report(0.3 * done / total, f"sweep to {at:g}"),
        )  # fmt: skip
        good = np.flatnonzero(way.period >= 0)
        x = x if not len(good) else way.states[good[-1]]
    found = sweep(system, PARAMETER, [at], quantity=STATE, load=LOAD, start=x, limit=1000, recorded=_POINTS)
    if found.failures[0]:
        raise ContinuationError(found.failures[0])
    return found


def _exponents(system: System, x: np.ndarray, at: float, fixed: FixedStep) -> tuple[Any, list[str]]:
    try:
        return lyapunov_spectrum(system, x, periods=_AVERAGED, transient=0, integrator=fixed, frequency_ratio=at), []
    except ContinuationError as error:
        return None, [f"no exponents: {error}"]


def _rows(exponents: Any, at: float, seconds: float | None) -> list[dict[str, float | None]]:
    if exponents is None:
        return []
    turn = 2 * math.pi / at
    return [
        {
            "per_tau": value,
            "error": error,
            "per_mesh_period": value * turn,
            "per_mesh_period_error": error * turn,
            "per_second": None if seconds is None else value * turn / seconds,
        }
        for value, error in zip(exponents.exponents.tolist(), exponents.errors.tolist(), strict=True)
    ]


def _shares(record: Simulation) -> dict[str, float]:
    """Return the shares of time with drive contact, without contact, and with back contact."""
    rows = record.intervals()
    lengths, whole = rows[:, 1] - rows[:, 0], record.phases[-1]
    return {
        name: float(lengths[rows[:, 2] == k].sum() / whole) for name, k in (("drive", 2), ("free", 1), ("coast", 0))
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# -------------------------------------------------------------------------------------------- output
def _write(place: Path, document: dict[str, Any], found: Sweep, extra: str | None) -> None:
    from sbg_casadi.report import as_text
    from sbg_casadi.section_report import section_report
    from sbg_casadi.timedomain_figure import save, section_figure

    save(section_figure(document), place / "section.png")
    (place / "summary.txt").write_text(as_text(section_report(document)), encoding="utf-8")
    for name in {"section.json", extra or "section.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    found.save(place / "section.nc")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    from sbg_casadi.report import print_all
    from sbg_casadi.section_report import section_report

    print_all(console, section_report(document))
    tell_files(console, folder, FILES)
    console.print(f"{seconds:.1f} s", markup=False)
