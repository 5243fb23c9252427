"""What every command does with the terminal: errors as one sentence and an exit code, printing, the JSON file."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from sbg_casadi.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console


@contextmanager
def guarded() -> Iterator[None]:
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


def new_console() -> Console:
    """Return where a command prints, 160 columns wide where there is no terminal that has a width of its own."""
    from rich.console import Console

    console = Console(highlight=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = 160  # a pipe or a file has no edge; notes stay on their line
    return console


def check_json_file(json_file: Path | None) -> None:
    """Refuse a JSON file that can't be written before any work is done."""
    if json_file is not None:
        from sbg_casadi.files import check_writable

        check_writable(json_file)


def write_json(json_file: Path | None, document: dict[str, Any]) -> None:
    """Write a document to the JSON file, where one is wanted."""
    if json_file is not None:
        from sbg_casadi.files import write_text_atomic

        write_text_atomic(json_file, json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
