"""Text of a sweep, made from the same document that is written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from sbg_casadi.report import amplitude, branch_report, plain_table, reading_words, small

if TYPE_CHECKING:
    from rich.console import RenderableType

Document = Mapping[str, Any]


def sweep_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a sweep document."""
    first, last = document["range"]
    head = f"{document['pair']}, state {document['state']}: sweeps up and down, ratio {first:g} to {last:g}, "
    head += f"{document['settings']['points']} frequencies, exact backlash law"
    parts: list[RenderableType] = [Text(head + reading_words(document), style="bold")]
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    for sweep in document["sweeps"]:
        parts += [Text(f"\nsweep {sweep['direction']}", style="bold"), _stretches(sweep), *_numbers(sweep)]
    parts += [Text(line) for line in (*_differences(document), _between(document))]
    if document["response"] is not None:
        parts += [Text("\ntraced response", style="bold"), *branch_report(document["response"])]
    compiled = f"compiled with {document['compiler']}" if document["compiler"] else "without a C compiler"
    parts.append(Text(f"\n{document['sweeps'][0]['method']}, {compiled}."))
    parts.append(
        Text(
            "RMS is that of lambda about its mean, in half backlashes; exponents are per unit of tau = omega_n t. "
            "Chaotic and quasi-periodic rest on the evidence shown; 'not recognised' says no more than that."
        )
    )
    return parts


def _stretches(sweep: Document) -> Table:
    table = plain_table("response", ">from", ">to", ">frequencies", ">RMS from", ">to", "evidence at the first")
    for s in sweep["stretches"]:
        inside = [p for p in sweep["points"] if s["from"] <= p["frequency_ratio"] <= s["to"]]
        rms = [p["rms"] for p in inside if p["rms"] is not None]
        words = "" if s["verdict"].startswith("period-") else inside[0]["evidence"]
        table.add_row(
            s["verdict"], f"{s['from']:.4f}", f"{s['to']:.4f}", str(s["frequencies"]),
            amplitude(min(rms, default=None)), amplitude(max(rms, default=None)), Text(words),
        )  # fmt: skip
    return table


def _numbers(sweep: Document) -> list[Text]:
    points = [p for p in sweep["points"] if p["rms"] is not None]
    if not points:
        return [Text("no frequency could be integrated")]
    top = max(points, key=lambda p: p["rms"])
    lines = [f"largest RMS {amplitude(top['rms'])} at {top['frequency_ratio']:.4f} ({top['verdict']})"]
    factors = [p for p in points if p["dynamic_factor"] is not None]
    if factors:
        high = max(factors, key=lambda p: p["dynamic_factor"])
        lines.append(f"largest dynamic factor {high['dynamic_factor']:.4f} at {high['frequency_ratio']:.4f}")
    errors = [p["step_error"] for p in points if p["step_error"] is not None]
    worst = small(max(errors, default=None))
    lines.append(f"largest error of the steps {worst} of the largest state, over one period of a recognised response")
    used = sum(p["periods_used"] for p in sweep["points"])
    return [Text(line) for line in [*lines, f"{used} mesh periods integrated"]]


def _between(document: Document) -> str:
    """Return the largest line between whole orders of the mesh frequency, which a period-1 response has not."""
    found = [
        (line["amplitude"], line["order"], point["frequency_ratio"], d["direction"])
        for d in document["spectra"]["directions"]
        for point in d["points"]
        if (line := point["largest_between"]) is not None
    ]
    if not found:
        return "no spectra"
    height, order, ratio, direction = max(found)
    return (
        f"largest line between whole orders of the mesh frequency: {height:.3g} at order {order:.4f}, "
        f"sweep {direction} at {ratio:.4f}"
    )


def _differences(document: Document) -> list[str]:
    if not document["differences"]:
        return ["\nno two periodic responses at one frequency: up and down agree"]
    ranges = ", ".join(
        f"{d['from']:.4f}" + (f" to {d['to']:.4f}" if d["to"] != d["from"] else "") for d in document["differences"]
    )
    return [f"\ntwo different periodic responses, up and down, at {ranges}"]
