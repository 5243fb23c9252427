"""Progress is drawn on a terminal's standard error and nowhere else."""

from __future__ import annotations

import io
import sys

import pytest

from sbg_casadi.progress import Progress, silent


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def run() -> None:
    with Progress() as progress:
        report = progress.task("before: [tracing]")
        report(0.25, "omega = [1.2]")
        report(1.0, "42 orbits")


def test_a_terminal_shows_the_task_its_part_and_its_text(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    run()
    for text in ("before: [tracing]", "100%", "42 orbits"):
        assert text in stream.getvalue()


def test_anything_else_stays_silent(capsys: pytest.CaptureFixture[str]) -> None:
    run()
    with Progress() as progress:
        assert progress.task("x") is silent
    assert capsys.readouterr() == ("", "")
