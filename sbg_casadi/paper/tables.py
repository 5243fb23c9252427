"""The tables of a run as text, the same cells for the page and for Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Document = Mapping[str, Any]
NONE = "-"


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of text.

    Attributes
    ----------
    name : str
        Short name, for an anchor.
    title : str
    heads : tuple of str
    rows : tuple of tuple of str
    remarks : tuple of str
        Sentences below it.
    """

    name: str
    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...] = ()


def text_tables(document: Document) -> list[TextTable]:
    """Return the tables of a document of :func:`~sbg_casadi.paper.document.paper_document`, scoreboard first."""
    found = [_scoreboard(document)]
    if document["table_7"]:
        found.append(_table_7(document))
    if document["table_6"]:
        found.append(_table_6(document))
    if document["stiff_bearings"]:
        found.append(_stiff(document["stiff_bearings"]))
    return found


def verdict_table(document: Document) -> TextTable:
    """Return how many rows have which verdict, and what it means."""
    rows = tuple((v, str(n), document["verdicts"][v]) for v, n in document["counts"].items())
    return TextTable("verdicts", "Verdicts", ("verdict", "rows", "meaning"), rows)


def _scoreboard(document: Document) -> TextTable:
    heads = ("place", "kind", "statement", "paper", "ours", "difference", "tolerance", "rests on", "verdict", "reason")
    rows = tuple(
        (
            r["place"], r["kind"], r["statement"], r["printed"], r["ours"], signed(r["difference"]),
            short(r["tolerance"]), r["basis"], r["verdict"], r["reason"],
        )
        for r in document["scoreboard"]
    )  # fmt: skip
    return TextTable("scoreboard", "Scoreboard", heads, rows)


def _table_7(document: Document) -> TextTable:
    heads = ("case", "paper before", "ours before", "at", "paper after", "ours after", "at", "paper reduction / %",
             "ours / %", "ours is")  # fmt: skip
    rows = []
    for r in document["table_7"]:
        cells = [r["case"]]
        for state in ("before", "after"):
            peak = r[state]
            cells += [r["paper"][state]]
            cells += [NONE, NONE] if peak is None else [f"{peak['rms']:.4f}", f"{peak['frequency_ratio']:.4f}"]
        share = NONE if r["reduction"] is None else f"{r['reduction']:.2f}"
        rows.append((*cells, r["paper"]["reduction"], share, r["basis"]))
    return TextTable("table-7", "Table 7: largest RMS and reductions", heads, tuple(rows))


def _table_6(document: Document) -> TextTable:
    heads = ("state", "frequency ratio", "heading in the paper", "paper", "told", "our motion", "reached",
             "variational", "error", "time series", "error")  # fmt: skip
    rows = tuple(
        (
            r["state"], r["frequency_ratio"], r["heading"], r["paper"], r["told"], r["motion"], r["reached"],
            *(short(r[name][key]) for name in ("variational", "series") for key in ("value", "error")),
        )
        for r in document["table_6"]
    )  # fmt: skip
    title = "Table 6: largest Lyapunov exponent of case 3, per unit of tau = omega_n t"
    return TextTable("table-6", title, heads, rows, tuple(document["remarks"]))


def _stiff(part: Document) -> TextTable:
    rates = [NONE, *(short(r) for r in part["rates"])]
    rows = tuple(
        (f"{c['factor']:g}", short(c["median_difference"]), rate, short(c["largest_difference"]))
        for c, rate in zip(part["stiff"], rates, strict=True)
    )
    skipped = tuple(f"Not compared, next to a fold perhaps: {text}." for text in part["skipped"])
    heads = ("bearing stiffness times", "median difference of RMS", "median fall since the row above",
             "largest difference (next to a fold)")  # fmt: skip
    return TextTable("stiff-bearings", "Figure 2: the limit of stiff bearings", heads, rows, skipped)


def signed(value: float | None) -> str:
    """Return a difference as text, a dash for none.

    >>> signed(0.03), signed(-59.806), signed(None), signed(0.0)
    ('+0.03', '-59.81', '-', '0')
    """
    return NONE if value is None else "0" if value == 0 else f"{value:+.4g}"


def short(value: float | None) -> str:
    """Return a number as text, a dash for none.

    >>> short(0.0123456), short(None)
    ('0.01235', '-')
    """
    return NONE if value is None else f"{value:.4g}"
