"""The command ``sbg paper``: compute what is missing, keep every part, write page, Markdown, JSON and figures."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from continuation import ContinuationError
from sbg_casadi.documents import to_json
from sbg_casadi.errors import UserError
from sbg_casadi.files import write_text_atomic
from sbg_casadi.paper.least import least_part
from sbg_casadi.paper.parts import motions_part, response_part, stiffness_part, sweeps_part
from sbg_casadi.paper.plan import STATES, Plan, Subject, check_points, chosen_cases, conflicts, key, subject
from sbg_casadi.paper.printed import State
from sbg_casadi.paper.stiff_bearings import stiff_bearings_part
from sbg_casadi.progress import Progress, Report
from sbg_casadi.response import DONE, IN_PART
from sbg_casadi.results import ResultsFolder
from sbg_casadi.sweep_study import INTERRUPTED

if TYPE_CHECKING:
    from rich.console import Console

MAIN = ("index.html", "paper.md", "paper.json")


def run_paper(
    *,
    case: int | None,
    out: Path,
    points: int,
    json_file: Path | None,
    console: Console,
) -> int:
    """Redo the paper, or one case of it, and write the results into a folder.

    Parameters
    ----------
    case : int or None
        1 to 4, all when None.
    out : Path
        Folder for ``index.html``, ``paper.md``, ``paper.json``, the parts as JSON and the figures; only its own earlier
        results are replaced.
    points : int
        Frequencies of every sweep.
    json_file : Path or None
        Further place for ``paper.json``.
    console : rich Console
        Where to print.

    Returns
    -------
    int
        0; 3 when something could not be computed, which the page says; 130 when interrupted: finished parts are then
        kept beside the folder, and the same command goes on there.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    """
    began = time.perf_counter()
    check_points(points)
    plan = Plan(chosen_cases(case), points)
    subjects = [subject(name) for name in plan.cases]
    command = "sbg paper" if case is None else f"sbg paper --case {case}"
    folder = ResultsFolder.claim(out, command, MAIN, json_file)
    work = _Work(plan, subjects, out.resolve().with_name(f".{out.resolve().name}.unfinished"))
    try:
        with Progress() as progress:
            cases, stiff = work.run(progress)
    except KeyboardInterrupt:
        console.print(
            f"interrupted; finished parts are kept in {work.place}, and the same command goes on there",
            markup=False, soft_wrap=True,
        )  # fmt: skip
        return INTERRUPTED
    from sbg_casadi.paper.document import paper_document

    document = paper_document(command, plan, cases, stiff, work.failures)
    folder.fill(lambda place: _write(place, document, cases, stiff, folder.extra))
    shutil.rmtree(work.place, ignore_errors=True)
    if json_file is not None and folder.extra is None:
        write_text_atomic(json_file, to_json(document))
    _tell(console, document, folder.path, time.perf_counter() - began)
    return IN_PART if work.failures else DONE


class _Work:
    """Compute parts one after the other; each is kept as soon as it is there."""

    def __init__(self, plan: Plan, subjects: list[Subject], place: Path) -> None:
        self.plan, self.subjects, self.place = plan, subjects, place
        self.failures: list[str] = []

    def run(self, progress: Progress) -> tuple[dict[str, Any], dict[str, Any] | None]:
        """Return the parts of every case, and the stiff-bearing part."""
        self.place.mkdir(exist_ok=True)
        cases: dict[str, Any] = {}
        for one in self.subjects:
            cases[one.case] = self._case(one, progress)
        first = self.subjects[0]
        stiff = self._kept(
            first,
            "stiff",
            lambda: stiff_bearings_part(first, self.plan, progress.task(f"{first.case}: stiff bearings")),
        )
        return cases, stiff

    def _case(self, one: Subject, progress: Progress) -> dict[str, Any]:
        before = len(self.failures)
        found: dict[str, Any] = {"pair": one.file, "basis": one.basis, "conflicts": conflicts(one)}
        for state in STATES:
            found[state] = self._state(one, state, progress)
        report = progress.task(f"{one.case}: modification")
        found["least"] = self._kept(one, "least", lambda: least_part(one, self.plan, report, _special(found)))
        return found | {"failures": self.failures[before:]}

    def _state(self, one: Subject, state: State, progress: Progress) -> dict[str, Any]:
        plan, folder = self.plan, self.place / f"{one.case}-{state}-{key(one, self.plan)}-sweeps"

        def task(text: str) -> Report:
            return progress.task(f"{one.case}: {state}, {text}")

        parts: dict[str, Any] = {"stiffness": stiffness_part(one, state)}
        parts["sweeps"] = sweeps = self._kept(
            one, f"{state}-sweeps", lambda: sweeps_part(one, state, plan, folder, task("sweeps"))
        )
        shutil.rmtree(folder, ignore_errors=True)
        parts["response"] = self._kept(
            one, f"{state}-response", lambda: response_part(one, state, plan, task("tracing"))
        )
        if sweeps is not None:
            parts["motions"] = self._kept(
                one, f"{state}-motions", lambda: motions_part(one, state, sweeps, task("motions"))
            )
        return parts

    def _kept(self, one: Subject, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
        """Return a part from its file, or compute and keep it; None with a failure noted when it can't be."""
        path = self.place / f"{one.case}-{name}-{key(one, self.plan)}.json"
        if path.exists():
            stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            return stored
        try:
            made = make()
        except (ContinuationError, UserError) as error:
            self.failures.append(f"{one.case}, {name.replace('-', ' ')}: {' '.join(str(error).split())}")
            return None
        write_text_atomic(path, to_json(made))
        return json.loads(to_json(made))  # what a rerun would read


def _special(found: dict[str, Any]) -> int:
    """Count the folds and doublings of period 1 in both states."""
    branches = [found[s]["response"]["branches"][0] for s in STATES if found[s]["response"] is not None]
    return sum(p["kind"] in ("fold", "period-doubling") for b in branches for p in b["special_points"])


def _write(
    place: Path, document: dict[str, Any], cases: dict[str, Any], stiff: dict[str, Any] | None, extra: str | None
) -> None:
    from sbg_casadi.paper.gallery import gallery
    from sbg_casadi.paper.markdown import markdown
    from sbg_casadi.paper.page import page

    pictures = gallery(cases, stiff)
    for picture in pictures:
        (place / picture.name).write_bytes(picture.data)
    (place / "index.html").write_text(page(document, pictures), encoding="utf-8")
    (place / "paper.md").write_text(markdown(document, pictures), encoding="utf-8")
    for name in {"paper.json", extra or "paper.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    for case, parts in cases.items():
        (place / f"{case}.json").write_text(to_json(parts), encoding="utf-8")


def _tell(console: Console, document: dict[str, Any], folder: Path, seconds: float) -> None:
    for verdict, count in document["counts"].items():
        console.print(f"{count:4d} {verdict}", markup=False)
    for text in document["failures"]:
        console.print(f"NOT COMPUTED: {text}", markup=False, style="bold red")
    pairs = ", ".join(f"{case}: {p['pair']} ({p['basis']})" for case, p in document["pairs"].items())
    console.print(pairs, markup=False)
    console.print(
        f"results in {folder}: index.html, paper.md, paper.json and the figures", markup=False, soft_wrap=True
    )
    console.print(f"{seconds:.1f} s", markup=False)
