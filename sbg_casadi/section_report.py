"""Text of a look at one response, and of its basins, made from the same documents that are written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from sbg_casadi.report import amplitude, plain_table, reading_words, small

if TYPE_CHECKING:
    from rich.console import RenderableType

Document = Mapping[str, Any]
_LINES = 8  # of the spectrum


def section_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a section document."""
    head = f"{document['pair']}, state {document['state']}: response at frequency ratio "
    head += f"{document['frequency_ratio']:.10g}, exact backlash law{reading_words(document)}"
    parts: list[RenderableType] = [Text(head, style="bold")]
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    came = "from the static state" if document["from"] is None else f"by a sweep from {document['from']:g}"
    lines = [f"{document['verdict']}, reached {came}: {document['evidence']}"]
    lines.append(
        f"RMS {amplitude(document['rms'])}, mean {amplitude(document['mean'])}, from {amplitude(document['least'])} "
        f"to {amplitude(document['largest'])}; dynamic factor {amplitude(document['dynamic_factor'])}"
    )
    shares = ", ".join(f"{name} {100 * share:.2f} %" for name, share in document["contact"].items())
    lines.append(f"contact over the record: {shares}")
    lines.append(f"{len(document['strobe'])} points at phase 0, {len(document['onset'])} at the onset of drive contact")
    parts += [Text(line) for line in lines]
    parts += [Text("\nlargest lines of the spectrum", style="bold"), _spectrum(document["spectrum"])]
    if document["exponents"]:
        parts += [Text("\nLyapunov exponents", style="bold"), _exponents(document)]
        total = document["exponent_sum"]
        parts.append(
            Text(
                f"sum {total['sum']:.8f} +- {small(total['error'])}, mean trace {total['trace']:.8f} (equal but for "
                f"errors), over {total['periods']} mesh periods"
            )
        )
    parts += _series(document)
    closing = f"\n{document['method']}. RMS is that of lambda about its mean, in half backlashes; tau = omega_n t."
    return [*parts, Text(closing)]


def _spectrum(spectrum: Document) -> Table:
    table = plain_table(">order", ">amplitude")
    orders, amplitudes = spectrum["orders"], spectrum["amplitudes"]
    peaks = [
        i for i in range(1, len(orders) - 1) if amplitudes[i] >= amplitudes[i - 1] and amplitudes[i] > amplitudes[i + 1]
    ]
    for i in sorted(peaks, key=lambda k: -amplitudes[k])[:_LINES]:
        table.add_row(f"{orders[i]:.4f}", amplitude(amplitudes[i]))
    return table


def _exponents(document: Document) -> Table:
    seconds = document["mesh_period_seconds"] is not None
    table = plain_table(">per unit of tau", ">error", ">per mesh period", *([">per second"] if seconds else []))
    for row in document["exponents"]:
        more = [f"{row['per_second']:.4g}"] if seconds else []
        table.add_row(f"{row['per_tau']:.6f}", small(row["error"]), f"{row['per_mesh_period']:.6f}", *more)
    return table


def _series(document: Document) -> list[RenderableType]:
    """Return what the series alone says of the largest exponent; units as above."""
    series = document["series_exponents"]
    parts: list[RenderableType] = []
    if series["rows"]:
        head = f"\nlargest exponent from {series['mesh_periods']} values of lambda alone, one per mesh period"
        seconds = document["mesh_period_seconds"] is not None
        units = ("per unit of tau", "error", "per mesh period", *(["per second"] if seconds else []), "straight over")
        table = plain_table("method", *(f">{unit}" for unit in units))
        for row in series["rows"]:
            more = [f"{row['per_second']:.4g}"] if seconds else []
            first, last = row["fit_mesh_periods"]
            numbers = (f"{row['per_tau']:.6f}", small(row["error"]), f"{row['per_mesh_period']:.6f}")
            table.add_row(row["method"], *numbers, *more, f"{first:g} to {last:g} periods")
        parts = [Text(head, style="bold"), table]
    if series["note"]:
        parts.append(Text(f"no exponent from the series of lambda alone: {series['note']}"))
    return parts


def basins_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a basins document."""
    head = f"{document['pair']}, state {document['state']}: basins at frequency ratio "
    head += f"{document['frequency_ratio']:.10g}, exact backlash law{reading_words(document)}"
    found = document["basins"]
    axes = ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in found["axes"].items())
    kind = f"random, seed {document['seed']}" if found["grid"] is None else " x ".join(map(str, found["grid"]))
    parts: list[RenderableType] = [Text(head, style="bold")]
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    parts.append(Text(f"{found['states']} states ({kind}): {axes}; the other coordinates at rest under the mean load"))
    table = plain_table("attractor", ">share", ">error", ">RMS of lambda", ">mean", "evidence")
    for k, a in enumerate(found["attractors"], 1):
        numbers = (f"{a['fraction']:.4f}", small(a["fraction_error"]))
        row = (*numbers, amplitude(a["rms"]["lambda"]), amplitude(a["mean"]["lambda"]))
        table.add_row(f"{k}: {a['verdict']}", *row, Text(a["evidence"]))
    parts.append(table)
    for key, words in (("not_recognised", "not recognised within the limit"), ("lost", "could not be integrated")):
        if found[key]:
            parts.append(Text(f"{words}: {found[key]:.4f} of the states"))
    return [*parts, Text("RMS is that of lambda about its mean, in half backlashes; shares are of the states drawn.")]
