"""The command line ``sbg``; everything heavy is imported inside the commands, so that ``sbg --help`` is quick."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from sbg_casadi.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from sbg_casadi.pair import Pair

DEFAULT_RANGE = (0.3, 2.6)  # omega_m / omega_n that response and study cover when not told otherwise

app = typer.Typer(
    name="sbg",
    help="Nonlinear dynamics of spiral bevel gears: where a pair resonates, jumps, and doubles its period.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

PairArgument = Annotated[str, typer.Argument(metavar="PAIR", help="A built-in case (see 'sbg cases') or a pair file.")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Also write the numbers as JSON to this file.")
]
OutOption = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder for the results.")]
FromOption = Annotated[
    float | None, typer.Option("--from", metavar="RATIO", help="First frequency ratio omega_m/omega_n.")
]
ReadingOption = Annotated[
    str,
    typer.Option(
        "--reading",
        metavar="NAME|ROWS",
        help="Equations as 'consistent', as 'printed', or rows of 'sbg ledger' taken as printed, such as 1,12.",
    ),
]
ToOption = Annotated[float | None, typer.Option("--to", metavar="RATIO", help="Last frequency ratio omega_m/omega_n.")]


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"sbg {version('sbg-casadi')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Take the options that come before a command."""


@app.command()
def cases(json_file: JsonOption = None) -> None:
    """List the built-in cases."""
    with _guarded():
        _writable(json_file)
        from rich.table import Table

        from sbg_casadi.pair import case_names, load_pair

        found = [load_pair(name) for name in case_names()]
        table = Table("case", "form", "states", box=None, pad_edge=False)
        for pair in found:
            table.add_row(pair.name, pair.form, ", ".join(pair.states))
        _console().print(table)
        _write_json(
            json_file,
            {"schema": 1, "cases": [{"name": p.name, "form": p.form, "states": list(p.states)} for p in found]},
        )


@app.command()
def show(pair: PairArgument, json_file: JsonOption = None) -> None:
    """Print a pair: every value with its unit and source, and what follows from them."""
    with _guarded():
        _writable(json_file)
        from sbg_casadi.pair import load_pair

        loaded = load_pair(pair)
        _print_pair(loaded, _console())
        _write_json(json_file, _pair_document(loaded))


@app.command()
def response(
    pair: PairArgument,
    start: FromOption = None,
    stop: ToOption = None,
    smoothing: Annotated[
        float, typer.Option(metavar="WIDTH", help="Width of the smoothed backlash law in half backlashes; 0 is exact.")
    ] = 0.0,
    state: Annotated[str | None, typer.Option(metavar="NAME", help="State of the pair; default: the first.")] = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Trace the period-1 response with its stability, folds and period-doublings, default range 0.3 to 2.6."""
    with _guarded():
        check_range(start, stop)
        check_smoothing(smoothing)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.study import run_response

        code = run_response(
            pair,
            start=start,
            stop=stop,
            smoothing=smoothing,
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=_console(),
        )
        raise typer.Exit(code)


@app.command()
def study(
    pair: PairArgument,
    out: OutOption = None,
    start: FromOption = None,
    stop: ToOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
) -> None:
    """Compare the states before and after a modification: responses, stability, sweeps, figure and summary."""
    with _guarded():
        check_range(start, stop)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.study import run_study

        code = run_study(pair, out=out, start=start, stop=stop, reading=rows, json_file=json_file, console=_console())
        raise typer.Exit(code)


@app.command()
def ledger(json_file: JsonOption = None) -> None:
    """Print the misprints and gaps of the source, what is used instead, and what each changes."""
    with _guarded():
        _writable(json_file)
        from sbg_casadi.ledger import ledger_document, ledger_table

        _console().print(ledger_table())
        _write_json(json_file, ledger_document())


@app.command()
def stiffness(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="CSV tables of transmission error or stiffness.")
    ],
    pair: Annotated[str, typer.Option("--pair", metavar="PAIR", help="A built-in case or a pair file.")],
    harmonics: Annotated[int, typer.Option(metavar="N", help="Number of harmonics, at most (samples - 1)/2.")] = 7,
    tolerance: Annotated[
        float, typer.Option(metavar="SHARE", help="Share of the peak-to-peak by which mesh cycles may differ.")
    ] = 0.02,
    out: OutOption = None,
    json_file: JsonOption = None,
) -> None:
    """Turn measured tables (such as before and after a modification) into mesh stiffness and its harmonics."""
    with _guarded():
        from sbg_casadi.stiffness_report import run_stiffness

        code = run_stiffness(
            files, pair, harmonics=harmonics, tolerance=tolerance, out=out, json_file=json_file, console=_console()
        )
        raise typer.Exit(code)


def check_range(start: float | None, stop: float | None) -> None:
    """Raise UserError unless both ends of a frequency range are finite, positive and different.

    Examples
    --------
    >>> check_range(0.3, -1.0)
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --to = -1; expected a positive frequency ratio such as 2.6
    """
    for option, value, example in (("--from", start, "0.3"), ("--to", stop, "2.6")):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise UserError(f"{option} = {value:g}; expected a positive frequency ratio such as {example}")
    first = DEFAULT_RANGE[0] if start is None else start
    last = DEFAULT_RANGE[1] if stop is None else stop
    if first == last:
        raise UserError(f"--from = {first:g} and --to = {last:g} is an empty range; expected two different ratios")


def check_smoothing(width: float) -> None:
    """Raise UserError unless a smoothing width is finite and not negative."""
    if not (math.isfinite(width) and width >= 0):
        raise UserError(f"--smoothing = {width:g}; expected a width of zero or more, such as 0.01")


@contextmanager
def _guarded() -> Iterator[None]:
    """Turn what a user can mend into one sentence and an exit code; errors of the program keep their traceback."""
    try:
        yield
    except typer.Exit:
        raise
    except KeyboardInterrupt:
        _fail("interrupted; nothing new was written and earlier results are kept", 130)
    except BrokenPipeError:  # the reader of a pipe has gone, as in "sbg show iso-f2 | head -1"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(1) from None
    except UserError as error:
        _fail(str(error), 2)
    except OSError as error:
        named = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
        _fail(named, 2)
    except Exception as error:
        # Imported here: naming the class at the top would load the engine for every call.
        from continuation.errors import ContinuationError

        if not isinstance(error, ContinuationError):
            raise
        _fail(str(error), 3)


def _fail(message: str, code: int) -> NoReturn:
    sentence = " ".join(message.split())
    typer.echo(f"sbg: {sentence}", err=True)
    raise typer.Exit(code) from None


def _console() -> Console:
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = 160  # a pipe or a file has no edge; notes stay on their line
    return console


def _writable(json_file: Path | None) -> None:
    """Refuse a JSON file that can't be written before any work is done."""
    if json_file is not None:
        from sbg_casadi.files import check_writable

        check_writable(json_file)


def _write_json(json_file: Path | None, document: dict[str, Any]) -> None:
    if json_file is not None:
        from sbg_casadi.files import write_text_atomic

        write_text_atomic(json_file, json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def _pair_document(pair: Pair) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "schema": 1,
        "name": pair.name,
        "form": pair.form,
        "states": list(pair.states),
        "rows": [row._asdict() for row in pair.rows()],
        "derived": None if pair.derived is None else asdict(pair.derived),
        "published": pair.published,
        "dimensionless": {state: pair.dimensionless(state).to_dict() for state in pair.states},
    }


def _print_pair(pair: Pair, console: Console) -> None:
    from itertools import groupby

    from rich.markup import escape
    from rich.table import Table

    table = Table("key", "value", "unit", "source", "note", box=None, pad_edge=False)
    for column in table.columns:
        column.overflow = "fold"  # long words break instead of losing their end
    for section, rows in groupby(pair.rows(), key=lambda row: row.section):
        if section:
            table.add_row()
            table.add_row(f"[bold]{escape(f'[{section}]')}[/bold]")
        for row in rows:
            table.add_row(*(escape(text) for text in row[1:]))
    console.print(table)


def main() -> None:
    """Run ``sbg``; the exit code is 0 done, 2 bad input, 3 finished in part, 130 interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal that lacks a character shows "?" instead of failing
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(threads, "1")  # the matrices are small: threads would only wait for each other
    app(prog_name="sbg")
