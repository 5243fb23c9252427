"""Progress bars on a terminal's standard error; nothing at all anywhere else."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import TracebackType
from typing import Any

Report = Callable[[float, str], None]


def silent(fraction: float, text: str) -> None:
    """Report to nobody."""


class Progress:
    """Draw one bar per task while the block runs, on standard error, and only if that is a terminal.

    Examples
    --------
    >>> with Progress() as progress:
    ...     progress.task("tracing")(0.5, "half way")
    """

    def __init__(self) -> None:
        self._bars: Any = None
        if sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bars

            bar = BarColumn(bar_width=12)  # leaves room for the text on 80 columns
            columns = (TextColumn("{task.description}"), bar, TaskProgressColumn(), TimeElapsedColumn())
            detail = TextColumn("{task.fields[detail]}", markup=False)
            self._bars = Bars(*columns, detail, console=Console(stderr=True), transient=True)

    def __enter__(self) -> Progress:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def task(self, description: str) -> Report:
        """Begin a task and return the callable that takes the fraction done (0 to 1) and a line of text."""
        if self._bars is None:
            return silent
        from rich.markup import escape

        bars = self._bars
        name = bars.add_task(escape(description), total=1.0, detail="")

        def report(fraction: float, text: str) -> None:
            bars.update(name, completed=fraction, detail=text)

        return report
