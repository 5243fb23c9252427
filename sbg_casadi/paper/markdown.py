"""The document of a run as Markdown, with the figures as files beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from sbg_casadi.paper.gallery import Picture
from sbg_casadi.paper.tables import TextTable, text_tables, verdict_table

TITLE = "The paper redone: every figure, table and claim with a verdict"


def introduction(document: Mapping[str, Any]) -> list[str]:
    """Return the paragraphs above the scoreboard."""
    pairs = ", ".join(f"{case} by {p['pair']} ({p['basis']})" for case, p in document["pairs"].items())
    low, high = document["settings"]["range"]
    return [
        "The paper is 'Chaos Suppression in Spiral Bevel Gears Through Profile Modifications', Vibration 2025, 8(3), "
        "38. Its parameters are mostly not printed. Every row below says what our value rests on, and nothing that is "
        "calibrated or assumed is called reproduced.",
        f"Cases stand for {pairs}; frequency ratio {low:g} to {high:g}, {document['settings']['points']} frequencies "
        f"in each sweep and those of the paper. RMS is that of lambda about its mean, in half backlashes.",
    ]


def markdown(document: Mapping[str, Any], pictures: Sequence[Picture]) -> str:
    """Return the text of the Markdown file."""
    first, *rest = text_tables(document)
    parts = [f"# {TITLE}", *introduction(document), *_failed(document), "## Verdicts", _table(verdict_table(document))]
    parts += [f"## {first.title}", _table(first)]
    for one in rest:
        parts += [f"## {one.title}", _table(one), *one.remarks]
    parts.append("## What the engineer learns")
    for case, sentences in document["learned"].items():
        parts += [f"### {case}", escaped(" ".join(sentences))]
        parts += _images(p for p in pictures if p.case == case and p.name.endswith("overview.png"))
    parts += ["## Figures", *_images(p for p in pictures if not p.name.endswith("overview.png"))]
    return "\n\n".join(parts) + "\n"


def _failed(document: Mapping[str, Any]) -> list[str]:
    return [f"**Not computed:** {escaped(text)}" for text in document["failures"]]


def _images(pictures: Iterable[Picture]) -> list[str]:
    return [f"![{escaped(p.heading)}]({p.name})\n\n{escaped(p.heading)}" for p in pictures]


def _table(table: TextTable) -> str:
    lines = ["| " + " | ".join(table.heads) + " |", "|" + "---|" * len(table.heads)]
    lines += ["| " + " | ".join(escaped(cell) for cell in row) + " |" for row in table.rows]
    return "\n".join(lines)


def escaped(text: str) -> str:
    """Return text that a Markdown table takes as it is.

    >>> escaped("a_1 | *b*")
    'a\\\\_1 \\\\| \\\\*b\\\\*'
    """
    for mark in ("\\", "|", "*", "_", "<", "`"):
        text = text.replace(mark, "\\" + mark)
    return " ".join(text.split())
