"""Arguments and options that the commands share, and the checks of their values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from sbg_casadi.errors import UserError

DEFAULT_RANGE = (0.3, 2.6)  # omega_m / omega_n that response and study cover when not told otherwise

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
StateOption = Annotated[
    str | None, typer.Option("--state", metavar="NAME", help="State of the pair; default: the first.")
]
ToOption = Annotated[float | None, typer.Option("--to", metavar="RATIO", help="Last frequency ratio omega_m/omega_n.")]


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
