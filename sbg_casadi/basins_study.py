"""The attractors of a pair at one frequency, and the states that go to each."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from continuation import Basins, Grid, Random, basins
from continuation.errors import nearest
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import SCHEMA, STATE, to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.model import gear_system, static_state
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress, Report, silent
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.response import DONE, IN_PART, tell_files
from sbg_casadi.results import ResultsFolder
from sbg_casadi.section_study import RATE, check_ratio

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("basins.png", "summary.txt", "basins.json", "basins.nc")
AXES = {STATE: (-3.0, 3.0), RATE: (-2.0, 2.0)}
"""Coordinates that vary when not told otherwise, in half backlashes and those per unit of tau."""


@dataclass(frozen=True, slots=True)
class BasinsSettings:
    """Hold what the user chose of a study of basins.

    Attributes
    ----------
    grid : int
        Cells along each coordinate; used unless a number of random states is given.
    random : int or None
        Number of random states instead of a grid.
    seed : int
        Of the random states.
    axes : tuple of str
        ``NAME=LOW:HIGH``; lambda and its rate when empty.
    """

    grid: int = 50
    random: int | None = None
    seed: int = 0
    axes: tuple[str, ...] = ()

    def limits(self, names: tuple[str, ...]) -> dict[str, tuple[float, float]]:
        """Return the coordinates that vary and their limits.

        Raises
        ------
        UserError
            If a number makes no sense or a name is unknown.
        """
        if self.grid < 1 or (self.random is not None and self.random < 1) or self.seed < 0:
            raise UserError("--grid and --random need positive numbers of states, --seed a number from 0")
        found = dict(parse_axis(text, names) for text in self.axes) or dict(AXES)
        if len(found) != 2:
            raise UserError(f"--axis: expected two different coordinates, got {len(found)}")
        return found


def parse_axis(text: str, names: tuple[str, ...]) -> tuple[str, tuple[float, float]]:
    """Return coordinate and limits from their text.

    Examples
    --------
    >>> parse_axis("lambda=-3:3", ("lambda", "dlambda"))
    ('lambda', (-3.0, 3.0))
    """
    name, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    if name not in names:
        raise UserError(f"--axis {text}: unknown coordinate {name!r}; {nearest(name, names)}")
    try:
        ends = float(low), float(high)
    except ValueError:
        ends = 0.0, 0.0
    if not -1e9 < ends[0] < ends[1] < 1e9:
        raise UserError(f"--axis {text}: expected NAME=LOW:HIGH such as {STATE}=-3:3")
    return name, ends


def run_basins(
    pair_name: str,
    *,
    at: float,
    settings: BasinsSettings,
    state: str | None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
) -> int:
    """Find the attractors of a pair at one frequency and their basins; print and write them into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    at : float
        Frequency ratio omega_m / omega_n.
    settings : BasinsSettings
    state : str or None
        State of the pair, the first one when None.
    out : Path or None
        Folder for figure, summary, JSON and netCDF, default ``sbg-basins-NAME``; only its own earlier results are
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
        0, or 3 when the attractor of a state was not found.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    ContinuationError
        If the model is too stiff for explicit steps.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    check_ratio("--at", at)
    d = as_read(pair, state, reading)
    settings.limits(gear_system(d, reading).state_names)
    path = out or Path(f"sbg-basins-{pair.name}")
    folder = ResultsFolder.claim(path, f"sbg basins {pair.name}", FILES, json_file)
    with Progress() as progress:
        report = progress.task(f"{pair.name}: basins")
        document, found = basins_document(pair, d, at, settings, reading, report)
    folder.fill(lambda place: _write(place, document, found, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return IN_PART if document["failures"] else DONE


def basins_document(
    pair: Pair,
    dimensionless: Dimensionless,
    at: float,
    settings: BasinsSettings,
    reading: Reading = CONSISTENT,
    report: Report = silent,
) -> tuple[dict[str, Any], Basins]:
    """Return the JSON-ready document of the basins, and the basins themselves."""
    system = gear_system(dimensionless, reading)
    drawn = Grid((settings.grid,) * 2) if settings.random is None else Random(settings.random, settings.seed)
    found = basins(
        system,
        settings.limits(system.state_names),
        drawn,
        start=static_state(dimensionless),
        progress=lambda done, total: report(done / total, f"{done} of {total} states"),
        frequency_ratio=at,
    )
    failures = [
        f"{int((found.labels == label).sum())} states {words}"
        for label, words in ((-1, "go to no attractor that was recognised"), (-2, "could not be integrated"))
        if (found.labels == label).any()
    ]
    document = {
        "schema": SCHEMA,
        "command": f"sbg basins {pair.name}",
        "pair": pair.name,
        "state": dimensionless.state,
        "reading": reading_name(reading),
        "frequency_ratio": at,
        "seed": settings.seed,
        "basins": found.to_dict(),
        "failures": failures,
    }
    return document, found


# -------------------------------------------------------------------------------------------- output
def _write(place: Path, document: dict[str, Any], found: Basins, extra: str | None) -> None:
    from sbg_casadi.report import as_text
    from sbg_casadi.section_report import basins_report
    from sbg_casadi.timedomain_figure import basins_figure, save

    save(basins_figure(document, found), place / "basins.png")
    (place / "summary.txt").write_text(as_text(basins_report(document)), encoding="utf-8")
    for name in {"basins.json", extra or "basins.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    found.save(place / "basins.nc")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    from sbg_casadi.report import print_all
    from sbg_casadi.section_report import basins_report

    print_all(console, basins_report(document))
    tell_files(console, folder, FILES)
    console.print(f"{seconds:.1f} s", markup=False)
