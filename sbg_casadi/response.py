"""The period-1 response of one pair in one state: traced, put into numbers, printed and written."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from continuation import HarmonicBalance, trace
from continuation.branches.branch import Branch
from continuation.branches.explore import Limb, Tree, explore
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import response_document, to_json, tree_document
from sbg_casadi.errors import UserError
from sbg_casadi.files import check_writable, write_text_atomic
from sbg_casadi.model import gear_system
from sbg_casadi.options import DEFAULT_RANGE, check_range, check_smoothing
from sbg_casadi.pair import Pair, load_pair
from sbg_casadi.progress import Progress, Report, silent
from sbg_casadi.reading import CONSISTENT, Reading, as_read, reading_name
from sbg_casadi.results import ResultsFolder

if TYPE_CHECKING:
    from rich.console import Console

PARAMETER = "frequency_ratio"
DONE, IN_PART = 0, 3

_FILES = ("response.png", "summary.txt", "response.json")
_DEEPEST = 6  # period 64


def frequency_span(start: float | None, stop: float | None) -> tuple[float, float]:
    """Return first and last frequency ratio, the default range where not told otherwise.

    Raises
    ------
    UserError
        If an end is not finite and positive, or both are the same.

    Examples
    --------
    >>> frequency_span(None, None), frequency_span(2.6, 0.4)
    ((0.3, 2.6), (2.6, 0.4))
    """
    check_range(start, stop)
    return DEFAULT_RANGE[0] if start is None else start, DEFAULT_RANGE[1] if stop is None else stop


def trace_response(
    dimensionless: Dimensionless,
    span: tuple[float, float],
    *,
    smoothing: float = 0.0,
    reading: Reading = CONSISTENT,
    report: Report = silent,
) -> tuple[Any, Branch]:
    """Trace the period-1 branch over the frequency ratio by condensed harmonic balance.

    Parameters
    ----------
    dimensionless : Dimensionless
        Numbers of one pair in one state.
    span : (float, float)
        First and last frequency ratio.
    smoothing : float
        Width of the smoothed backlash law in half backlashes; 0 is the exact law.
    reading : frozenset of int
        Rows of the ledger taken as printed in the equations.
    report : callable
        Told the fraction done and a line of text.

    Returns
    -------
    tuple of (Problem, Branch)
        The problem solves for further orbits of the branch.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, which ends the tracing early.
    ContinuationError
        If there is no orbit at the first ratio.
    """
    system = gear_system(dimensionless, reading).smoothed(smoothing)
    problem = HarmonicBalance().discretise(system, parameter=PARAMETER)
    branch = trace(problem, problem.guess(frequency_ratio=span[0]), span=span, progress=report)
    if branch.stop.startswith("interrupted"):
        raise KeyboardInterrupt(branch.stop)
    return problem, branch


def trace_tree(
    dimensionless: Dimensionless,
    span: tuple[float, float],
    depth: int,
    *,
    smoothing: float = 0.0,
    reading: Reading = CONSISTENT,
    report: Report = silent,
) -> Tree:
    """Trace the period-1 branch and all branches that leave it at doublings and branch points, to a depth.

    Parameters
    ----------
    depth : int
        Most switches from the period-1 branch; with 1 the branches of period 2 are followed, with 2 those of period 4.

    The other arguments and the errors are those of :func:`trace_response`.

    Returns
    -------
    Tree
        Every branch once, the period-1 branch first.
    """
    system = gear_system(dimensionless, reading).smoothed(smoothing)
    problem = HarmonicBalance().discretise(system, parameter=PARAMETER)
    tree = explore(problem, span, depth=depth, max_period=2**depth, progress=report)
    stopped = [text for text in (*tree.notes, *(b.stop for b in tree.branches)) if "interrupted" in text]
    if stopped:
        raise KeyboardInterrupt(stopped[0])
    return tree


def check_depth(depth: int) -> None:
    """Raise UserError unless the depth of a tree is a small number.

    Examples
    --------
    >>> check_depth(-1)
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --tree = -1; expected a number of switches from 0 to 6, such as 1 for \
branches of period 2
    """
    if not 0 <= depth <= _DEEPEST:
        raise UserError(
            f"--tree = {depth}; expected a number of switches from 0 to {_DEEPEST}, such as 1 for branches of period 2"
        )


def run_response(
    pair_name: str,
    *,
    start: float | None,
    stop: float | None,
    smoothing: float,
    state: str | None,
    json_file: Path | None,
    out: Path | None,
    console: Console,
    reading: Reading = CONSISTENT,
    tree: int = 0,
) -> int:
    """Trace a response, print it, and write it where asked.

    Parameters
    ----------
    pair_name : str
        Built-in case or path of a pair file.
    start, stop : float or None
        First and last frequency ratio, default 0.3 and 2.6.
    smoothing : float
        Width of the smoothed backlash law in half backlashes, 0 for the exact one.
    state : str or None
        State of the pair, the first one when None.
    json_file : Path or None
        JSON file to write.
    out : Path or None
        Folder for figure, summary, JSON and netCDF; its earlier results of the same command are replaced as a whole.
    console : rich Console
        Where to print.
    reading : frozenset of int
        Rows of the ledger taken as printed.
    tree : int
        Depth to which doubled and switched branches are added, 0 for none.

    Returns
    -------
    int
        0 when the branch reaches ``stop``, 3 when it ends before, or a branch that leaves it could not be followed.

    Raises
    ------
    UserError, OSError
        For bad input and unwritable places, before any work.
    """
    from sbg_casadi.report import print_all, response_report

    began = time.perf_counter()
    pair = load_pair(pair_name)
    span = frequency_span(start, stop)
    check_smoothing(smoothing)
    check_depth(tree)
    d = as_read(pair, state, reading)
    files = (*_FILES, "period-1.nc")
    folder = None
    if out is not None:
        folder = ResultsFolder.claim(out, f"sbg response {pair.name}", files, json_file)
    elif json_file is not None:
        check_writable(json_file)
    with Progress() as progress:
        report = progress.task(f"{pair.name}: tracing")
        if tree:
            found = trace_tree(d, span, tree, smoothing=smoothing, reading=reading, report=report)
            document = tree_document(found, pair, d.state, smoothing, span)
        else:
            _, branch = trace_response(d, span, smoothing=smoothing, reading=reading, report=report)
            found = Tree((Limb(branch, None, None, 0),), (), ())
            document = response_document(branch, pair, d.state, smoothing, span[1])
    document |= {"range": list(span), "reading": reading_name(reading)}
    names = branch_files(found)
    if folder is not None:
        folder.fill(lambda place: _write(place, document, found, pair, folder.extra))
    if json_file is not None and (folder is None or folder.extra is None):
        write_text_atomic(json_file, to_json(document))
    print_all(console, response_report(document))
    if folder is not None:
        tell_files(console, folder.path, (*_FILES, *names))
    console.print(f"{time.perf_counter() - began:.1f} s", markup=False)
    return DONE if all(b["complete"] for b in document["branches"]) and not document.get("notes") else IN_PART


def tell_files(console: Console, folder: Path, files: Iterable[str]) -> None:
    """Print where the results are, on one line that is never broken."""
    console.print(f"results in {folder}: {', '.join(files)}", markup=False, soft_wrap=True)


def branch_files(tree: Tree) -> tuple[str, ...]:
    """Return the name of the netCDF file of every branch."""
    later = (f"branch-{number}-period-{b.period_multiple}.nc" for number, b in enumerate(tree.branches[1:], 1))
    return ("period-1.nc", *later)


def _write(place: Path, document: dict[str, Any], tree: Tree, pair: Pair, extra: str | None) -> None:
    from sbg_casadi.figure import response_figure, save_figure
    from sbg_casadi.report import as_text, response_report

    rpm = None if pair.derived is None else pair.derived.unit_ratio_rpm
    labels = [document["state"], *(f"{n}: period {b.period_multiple}" for n, b in enumerate(tree.branches[1:], 1))]
    branches = dict(zip(labels, tree.branches, strict=True))
    save_figure(response_figure(f"{pair.name}, {document['state']}", branches, {}, rpm), place)
    (place / "summary.txt").write_text(as_text(response_report(document)), encoding="utf-8")
    for name in {"response.json", extra or "response.json"}:
        (place / name).write_text(to_json(document), encoding="utf-8")
    for name, branch in zip(branch_files(tree), tree.branches, strict=True):
        branch.save(place / name)
