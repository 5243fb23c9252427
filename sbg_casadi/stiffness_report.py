"""The command ``sbg stiffness``: measured tables to harmonics, printed, drawn and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table
from rich.text import Text

from sbg_casadi.conversion import Conversion, convert
from sbg_casadi.documents import SCHEMA, to_json
from sbg_casadi.errors import PairError, UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.fourier import PERIODIC
from sbg_casadi.mesh import fourier_series, peak_to_peak
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.report import as_text, print_all
from sbg_casadi.response import DONE, tell_files
from sbg_casadi.results import ResultsFolder
from sbg_casadi.series_kinds import MOST_HARMONICS
from sbg_casadi.stiffness_figure import save_stiffness_figure
from sbg_casadi.tables import read_table

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

HARMONICS = 7
"""Default number of harmonics: the sum in (21) goes to 7."""

_FILES = ("stiffness.png", "summary.txt", "stiffness.json")
_LISTS = ("stiffness_cosine", "stiffness_sine", "error_cosine", "error_sine")
_ROWS = 24  # samples printed for each table; the JSON file has all


def run_stiffness(
    files: Sequence[Path],
    pair_name: str,
    *,
    harmonics: int,
    tolerance: float,
    out: Path | None,
    json_file: Path | None,
    console: Console,
) -> int:
    """Convert measured tables to mesh stiffness; print the outcome and write it into a folder.

    Parameters
    ----------
    files : sequence of Path
        One or more CSV tables, such as before and after a modification, drawn together.
    pair_name : str
        Built-in case or path of a pair file in the physical form.
    harmonics : int
        Number of harmonics.
    tolerance : float
        Share of the peak-to-peak by which a mesh cycle may differ from the next.
    out : Path or None
        Folder for figure, summary and JSON, default ``sbg-stiffness-NAME``; only its own earlier results are replaced.
    json_file : Path or None
        Further place for the JSON document.
    console : rich Console
        Where to print.

    Returns
    -------
    int
        0; everything that can go wrong is an error.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places.
    """
    if not 1 <= harmonics <= MOST_HARMONICS:
        raise UserError(f"--harmonics = {harmonics}; expected a whole number from 1 to {MOST_HARMONICS}")
    if not 0 <= tolerance <= 1:
        raise UserError(f"--tolerance = {tolerance:g}; expected a share of the peak-to-peak from 0 to 1, such as 0.02")
    pair = load_pair(pair_name)
    folder = ResultsFolder.claim(
        out or Path(f"sbg-stiffness-{pair.name}"), f"sbg stiffness {pair.name}", _FILES, json_file
    )
    document = stiffness_document(files, pair, harmonics, tolerance)
    folder.fill(lambda place: _write(place, document, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    print_all(console, stiffness_report(document))
    tell_files(console, folder.path, _FILES)
    return DONE


def stiffness_document(
    files: Sequence[Path], pair: Pair, harmonics: int, tolerance: float = PERIODIC
) -> dict[str, Any]:
    """Return the JSON-ready document of converted tables; every number that is printed or drawn comes from it.

    Raises
    ------
    PairError
        If a table can't be used, or the pair has no geometry.
    """
    mesh = pair.mesh_geometry()
    if mesh is None or pair.derived is None:
        raise PairError(
            f"pair {pair.name!r} is dimensionless, and a table needs teeth, radii and torque; expected a pair with "
            "[geometry] and [load]"
        )
    derived = pair.derived
    names = [path.stem for path in files]
    labels = names if len(set(names)) == len(names) else [str(path) for path in files]
    found = [
        (label, convert(read_table(path), mesh, harmonics, tolerance))
        for label, path in zip(labels, files, strict=True)
    ]
    return {
        "schema": SCHEMA,
        "pair": pair.name,
        "torque": mesh.torque,
        "member": mesh.member,
        "normal_force": mesh.normal_force(mesh.torque),
        "pair_stiffness": derived.mesh_stiffness,
        "half_backlash": derived.half_backlash,
        "tables": [_entry(label, one, harmonics, derived.half_backlash) for label, one in found],
    }


def _entry(name: str, one: Conversion, harmonics: int, half_backlash: float) -> dict[str, Any]:
    """Return one table of the document; stiffness in N/m, harmonics over the mean, errors in half backlashes."""
    cosine, sine = one.relative()
    result: dict[str, Any] = {
        "name": name,
        "harmonics": harmonics,
        "cycles": one.sampling.count,
        "phase": one.sampling.phase.tolist(),
        "samples": one.samples.tolist(),
        "mean": one.stiffness.mean,
        "peak_to_peak_samples": float(np.ptp(one.samples)) / one.stiffness.mean,
        "peak_to_peak_series": peak_to_peak(cosine, sine),
        "truncation_error": one.stiffness.deviation / one.stiffness.mean,
        "stiffness_cosine": list(cosine),
        "stiffness_sine": list(sine),
        "error_cosine": [],
        "error_sine": [],
    }
    if one.error is not None:
        result["error_cosine"] = [c / half_backlash for c in one.error.cosine]
        result["error_sine"] = [s / half_backlash for s in one.error.sine]
    return result


def stiffness_report(document: dict[str, Any]) -> list[RenderableType]:
    """Return the printable report of a stiffness document."""
    head = (
        f"{document['pair']}: mesh stiffness at {document['torque']:g} N m on the {document['member']}, "
        f"F_n = {document['normal_force']:.1f} N"
    )
    parts: list[RenderableType] = [Text(head, style="bold")]
    for table in document["tables"]:
        against = table["mean"] / document["pair_stiffness"]
        parts += [
            Text(),
            Text(
                f"{table['name']}: {len(table['samples'])} samples over {table['cycles']} mesh cycle(s)", style="bold"
            ),
            Text(f"mean {table['mean']:.5g} N/m, {against:.4g} times k_0 of the pair"),
            Text(
                f"peak to peak over mean: table {table['peak_to_peak_samples']:.4g}, series of {table['harmonics']} "
                f"harmonics {table['peak_to_peak_series']:.4g}; truncation error up to {table['truncation_error']:.2g}"
            ),
            _samples(table),
            _spectrum(table),
            Text("for [states.NAME] of a pair file:"),
            *(Text(f"{key} = {_rounded(table[key])}") for key in _LISTS if table[key]),
        ]
    return parts


def _rounded(values: Sequence[float]) -> list[float]:
    """Return values to paste: 8 decimals are finer than any measurement, and zeros read as zeros."""
    return [round(value, 8) + 0.0 for value in values]


def _samples(table: dict[str, Any]) -> Table:
    """Return the samples beside the series, at most 24 of them."""
    shown = Table("mesh phase", "table / (N/um)", "series / (N/um)", box=None, pad_edge=False)
    phase, samples = np.asarray(table["phase"]), np.asarray(table["samples"])
    wave = fourier_series(table["stiffness_cosine"], table["stiffness_sine"], 2 * np.pi * phase)
    series = table["mean"] * (1 + wave)
    for i in np.unique(np.linspace(0, phase.size - 1, min(_ROWS, phase.size)).round().astype(int)):
        shown.add_row(f"{phase[i]:.4f}", f"{samples[i] / 1e6:.3f}", f"{series[i] / 1e6:.3f}")
    return shown


def _spectrum(table: dict[str, Any]) -> Table:
    shown = Table("harmonic", "cosine / mean", "sine / mean", "amplitude / mean", box=None, pad_edge=False)
    for j, (c, s) in enumerate(zip(table["stiffness_cosine"], table["stiffness_sine"], strict=True), 1):
        shown.add_row(str(j), *(f"{round(value, 6) + 0.0:.6f}" for value in (c, s, np.hypot(c, s))))
    return shown


def _write(place: Path, document: dict[str, Any], extra: str | None) -> None:
    title = f"{document['pair']}, {document['torque']:g} N m on the {document['member']}"
    save_stiffness_figure(title, document["tables"], place / "stiffness.png")
    (place / "summary.txt").write_text(as_text(stiffness_report(document)), encoding="utf-8")
    for name in {"stiffness.json", extra or "stiffness.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
