"""The command ``sbg identify``: find, print, and write pair file, report and JSON."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sbg_casadi.documents import to_json
from sbg_casadi.files import write_text_atomic
from sbg_casadi.identification.documents import identification_document, identification_report
from sbg_casadi.identification.outcome import Settings
from sbg_casadi.identification.procedure import identify
from sbg_casadi.identification.targets_file import load_targets, selected
from sbg_casadi.pair import load_pair
from sbg_casadi.progress import Progress, Report
from sbg_casadi.report import as_text, print_all
from sbg_casadi.response import DONE, IN_PART, tell_files
from sbg_casadi.results import ResultsFolder

if TYPE_CHECKING:
    from rich.console import Console

FILES = ("pair.toml", "summary.txt", "identify.json")


def run_identify(
    pair_name: str,
    targets_name: str,
    *,
    settings: Settings,
    state: str | None = None,
    unknowns: str | None = None,
    out: Path | None,
    json_file: Path | None,
    console: Console,
) -> int:
    """Find the unknowns of a targets file for a pair; print the outcome and write it into a folder.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    targets_name : str
        Path of a targets file, or the name of a built-in one.
    settings : Settings
    state, unknowns : str or None
        What the search is restricted to, see :func:`~sbg_casadi.identification.identify`.
    out : Path or None
        Folder for the pair file, summary and JSON, default ``sbg-identify-NAME``.
    json_file : Path or None
        Further place for the JSON document.
    console : rich Console
        Where to print.

    Returns
    -------
    int
        0, or 3 after an interrupt; the best values found until then have been written then.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    """
    began = time.perf_counter()
    pair = load_pair(pair_name)
    targets = load_targets(targets_name, pair)
    path = out or Path(f"sbg-identify-{pair.name}")
    folder = ResultsFolder.claim(path, f"sbg identify {pair.name} {targets.name}", FILES, json_file)
    selected(targets, state, unknowns)  # refuses what fits nothing before any work
    part = "".join(f" --{k} {v}" for k, v in (("state", state), ("unknowns", unknowns)) if v is not None)
    spent = f"--seed {settings.seed} --evaluations {settings.evaluations} --refined {settings.refined}"
    if settings.near is not None:
        spent += f" --near {settings.near:g}"
    command = f"sbg identify {pair.name} {targets.name}{part} {spent}"
    with Progress() as progress:
        found = identify(
            pair_name,
            targets_name,
            state=state,
            unknowns=unknowns,
            settings=settings,
            command=command,
            tell=_teller(progress),
        )
    document = identification_document(found, targets, command, settings)
    text = found.pair.to_toml()
    folder.fill(lambda place: _write(place, document, text, folder.extra))
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    print_all(console, identification_report(document))
    tell_files(console, folder.path, FILES)
    console.print(f"{time.perf_counter() - began:.1f} s", markup=False)
    return DONE if found.complete else IN_PART


def _teller(progress: Progress) -> Any:
    """Return the callable that draws one bar per stage."""
    bars: dict[str, Report] = {}

    def tell(stage: str, part: float, text: str) -> None:
        if stage not in bars:
            bars[stage] = progress.task(stage)
        bars[stage](part, text)

    return tell


def _write(place: Path, document: dict[str, Any], text: str, extra: str | None) -> None:
    (place / "pair.toml").write_text(text, encoding="utf-8")
    (place / "summary.txt").write_text(as_text(identification_report(document)), encoding="utf-8")
    for name in {"identify.json", extra or "identify.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
