"""The command line ``sbg``; everything heavy is imported inside the commands, so that ``sbg --help`` is quick."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sbg_casadi.options import (
    FromOption,
    JsonOption,
    OutOption,
    PairArgument,
    ReadingOption,
    StateOption,
    ToOption,
    check_range,
    check_smoothing,
)
from sbg_casadi.terminal import check_json_file, guarded, new_console, write_json

if TYPE_CHECKING:
    from rich.console import Console

    from sbg_casadi.pair import Pair

app = typer.Typer(
    name="sbg",
    help="Nonlinear dynamics of spiral bevel gears: where a pair resonates, jumps, and doubles its period.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


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
    with guarded():
        check_json_file(json_file)
        from rich.table import Table

        from sbg_casadi.pair import case_names, load_pair

        found = [load_pair(name) for name in case_names()]
        table = Table("case", "form", "states", box=None, pad_edge=False)
        for pair in found:
            table.add_row(pair.name, pair.form, ", ".join(pair.states))
        new_console().print(table)
        write_json(
            json_file,
            {"schema": 1, "cases": [{"name": p.name, "form": p.form, "states": list(p.states)} for p in found]},
        )


@app.command()
def show(pair: PairArgument, json_file: JsonOption = None) -> None:
    """Print a pair: every value with its unit and source, and what follows from them."""
    with guarded():
        check_json_file(json_file)
        from sbg_casadi.pair import load_pair

        loaded = load_pair(pair)
        _print_pair(loaded, new_console())
        write_json(json_file, _pair_document(loaded))


@app.command()
def response(
    pair: PairArgument,
    start: FromOption = None,
    stop: ToOption = None,
    smoothing: Annotated[
        float, typer.Option(metavar="WIDTH", help="Width of the smoothed backlash law in half backlashes; 0 is exact.")
    ] = 0.0,
    state: StateOption = None,
    tree: Annotated[
        int,
        typer.Option(metavar="DEPTH", help="Also branches that leave: 1 adds period 2, 2 period 4, and so on."),
    ] = 0,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Trace the period-1 response with its stability, folds and period-doublings, default range 0.3 to 2.6."""
    with guarded():
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
            console=new_console(),
            tree=tree,
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
    with guarded():
        check_range(start, stop)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.study import run_study

        code = run_study(
            pair, out=out, start=start, stop=stop, reading=rows, json_file=json_file, console=new_console()
        )
        raise typer.Exit(code)


@app.command()
def stability(
    pair: PairArgument,
    at: Annotated[float, typer.Option("--at", metavar="RATIO", help="Frequency ratio omega_m/omega_n of the orbit.")],
    branch: Annotated[
        int | None,
        typer.Option("--branch", metavar="K", help="Which of several orbits there; default: the first stable one."),
    ] = None,
    start: FromOption = None,
    stop: ToOption = None,
    state: StateOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Report one periodic orbit: multipliers with errors, nearest instability, contact pattern, waveform, figure."""
    with guarded():
        check_range(start, stop)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.stability import run_stability

        code = run_stability(
            pair,
            at=at,
            branch=branch,
            start=start,
            stop=stop,
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command()
def sweep(
    pair: PairArgument,
    points: Annotated[int, typer.Option(metavar="N", help="Number of frequencies.")] = 201,
    start: FromOption = None,
    stop: ToOption = None,
    with_response: Annotated[
        bool, typer.Option("--with-response", help="Also trace the period-1 response and draw it over the sweeps.")
    ] = False,
    transient: Annotated[int, typer.Option(metavar="N", help="Mesh periods per frequency at least.")] = 32,
    limit: Annotated[int, typer.Option(metavar="N", help="Mesh periods per frequency at most.")] = 400,
    recorded: Annotated[int, typer.Option(metavar="N", help="Mesh periods recorded where nothing repeats.")] = 100,
    state: StateOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Sweep the frequency up and down in the time domain: bifurcation diagram, RMS, what does not repeat."""
    with guarded():
        check_range(start, stop)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.sweep_study import SweepSettings, run_sweep

        code = run_sweep(
            pair,
            start=start,
            stop=stop,
            settings=SweepSettings(points, transient, limit, recorded),
            with_response=with_response,
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command()
def section(
    pair: PairArgument,
    at: Annotated[float, typer.Option("--at", metavar="RATIO", help="Frequency ratio omega_m/omega_n.")],
    start: Annotated[
        float | None,
        typer.Option("--from", metavar="RATIO", help="Follow the response from this ratio; default: static state."),
    ] = None,
    state: StateOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Look at one response in the time domain: Poincare map, phase portrait, spectrum, Lyapunov exponents."""
    with guarded():
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.section_study import run_section

        code = run_section(
            pair,
            at=at,
            start=start,
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command()
def basins(
    pair: PairArgument,
    at: Annotated[float, typer.Option("--at", metavar="RATIO", help="Frequency ratio omega_m/omega_n.")],
    grid: Annotated[int, typer.Option(metavar="N", help="Cells along each of the two coordinates.")] = 50,
    random: Annotated[
        int | None, typer.Option("--random", metavar="N", help="Number of random states instead of a grid.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the random states.")] = 0,
    axis: Annotated[
        list[str] | None,
        typer.Option("--axis", metavar="NAME=LOW:HIGH", help="A coordinate that varies; give two."),
    ] = None,
    state: StateOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Find the attractors at one frequency and the share of states that go to each."""
    with guarded():
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.basins_study import BasinsSettings, run_basins

        code = run_basins(
            pair,
            at=at,
            settings=BasinsSettings(grid, random, seed, tuple(axis or ())),
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command(name="map")
def map_(
    pair: PairArgument,
    over: Annotated[
        str,
        typer.Option(metavar="QUANTITY", help="modification, torque, damping, backlash or fluctuation."),
    ],
    start: FromOption = None,
    stop: ToOption = None,
    least: Annotated[
        float | None, typer.Option(metavar="VALUE", help="Least value of the quantity; default depends on it.")
    ] = None,
    most: Annotated[float | None, typer.Option(metavar="VALUE", help="Largest value of the quantity.")] = None,
    grid: Annotated[
        tuple[int, int], typer.Option(metavar="K M", help="Frequencies and values of the grid of attractors.")
    ] = (60, 20),
    state: StateOption = None,
    reading: ReadingOption = "consistent",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Map folds, doublings, torus points and attractors; beyond which modification nothing doubles. Resumes."""
    with guarded():
        check_range(start, stop)
        from sbg_casadi.reading import parse_reading

        rows = parse_reading(reading)
        from sbg_casadi.map_study import run_map

        code = run_map(
            pair,
            over=over,
            start=start,
            stop=stop,
            least=least,
            most=most,
            shape=grid,
            state=state,
            reading=rows,
            json_file=json_file,
            out=out,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command()
def identify(
    pair: PairArgument,
    targets: Annotated[
        str, typer.Argument(metavar="TARGETS", help="A TOML file of unknowns and targets, or case1 to case4.")
    ],
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the search; the same one gives the same values.")] = 0,
    evaluations: Annotated[int, typer.Option(metavar="N", help="Candidates of the global search.")] = 1000,
    refined: Annotated[int, typer.Option(metavar="N", help="Best candidates that are refined by gradients.")] = 2,
    state: Annotated[str | None, typer.Option("--state", metavar="NAME", help="Targets of one state alone.")] = None,
    unknowns: Annotated[
        str | None, typer.Option(metavar="PATTERN", help="Unknowns alone whose keys fit, such as 'states.after.*'.")
    ] = None,
    near: Annotated[
        float | None, typer.Option(metavar="SHARE", help="Begin the search near the values that the pair has.")
    ] = None,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Find unknown stiffness, damping, angles ... of a pair from measured responses; writes a pair file."""
    with guarded():
        from sbg_casadi.identification.outcome import Settings
        from sbg_casadi.identification.run import run_identify

        settings = Settings(seed, evaluations, refined, near=near)
        code = run_identify(
            pair,
            targets,
            settings=settings,
            state=state,
            unknowns=unknowns,
            out=out,
            json_file=json_file,
            console=new_console(),
        )
        raise typer.Exit(code)


@app.command()
def paper(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")],
    case: Annotated[
        int | None, typer.Option("--case", metavar="N", help="One case of the paper, 1 to 4; default: all four.")
    ] = None,
    points: Annotated[int, typer.Option(metavar="N", help="Frequencies of every sweep.")] = 116,
    json_file: JsonOption = None,
) -> None:
    """Redo the paper: every figure, table and sentence with a verdict, on one page. Resumes."""
    with guarded():
        from sbg_casadi.paper.command import run_paper

        raise typer.Exit(run_paper(case=case, out=out, points=points, json_file=json_file, console=new_console()))


@app.command()
def ledger(json_file: JsonOption = None) -> None:
    """Print the misprints and gaps of the source, what is used instead, and what each changes."""
    with guarded():
        check_json_file(json_file)
        from sbg_casadi.ledger import ledger_document, ledger_table

        new_console().print(ledger_table())
        write_json(json_file, ledger_document())


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
    with guarded():
        from sbg_casadi.stiffness_report import run_stiffness

        code = run_stiffness(
            files, pair, harmonics=harmonics, tolerance=tolerance, out=out, json_file=json_file, console=new_console()
        )
        raise typer.Exit(code)


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
