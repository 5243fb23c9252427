"""Text of a response and of a study, made from the same document that is written as JSON."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.console import RenderableType

Document = Mapping[str, Any]
WIDTH = 120


def ratio(value: float) -> str:
    """Return a frequency ratio as text, 10 decimals.

    Examples
    --------
    >>> ratio(1.5210287084)
    '1.5210287084'
    """
    return f"{value:.10f}"


def amplitude(value: float | None) -> str:
    """Return a root mean square in half backlashes as text; a dash for none."""
    return "-" if value is None else f"{value:.6f}"


def small(value: float | None) -> str:
    """Return an error or difference as text; a dash for none."""
    return "-" if value is None else f"{value:.1e}"


def speed(value: float | None) -> str:
    """Return a speed in rev/min as text; a dash for none."""
    return "-" if value is None else f"{value:.0f}"


def response_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a response document."""
    law = f"smoothed backlash law, width {document['smoothing']:g}" if document["smoothing"] else "exact backlash law"
    first, last = document["range"]
    head = f"{document['pair']}, state {document['state']}: period-1 response, ratio {first:g} to {last:g}, {law}"
    head += reading_words(document)
    parts: list[RenderableType] = [Text(head, style="bold")]
    for number, branch in enumerate(document["branches"]):
        if number:
            parts.append(Text(_leaving(number, branch), style="bold"))
        parts += branch_report(branch)
    parts += [Text(_link(link)) for link in document.get("links", ())]
    parts += [Text(f"NOT FOLLOWED: {note}", style="bold red") for note in document.get("notes", ())]
    return parts


def _leaving(number: int, branch: Document) -> str:
    at = branch["leaves_at"]
    return (
        f"\nbranch {number}: period {branch['period_multiple']}, leaves branch {branch['parent']} at the {at['kind']} "
        f"{ratio(at['frequency_ratio'])}"
    )


def _link(link: Document) -> str:
    what = "the mirror image of branch" if link["likeness"] == "mirror image" else "branch"
    return (
        f"{link['kind']} {ratio(link['frequency_ratio'])} of branch {link['branch']} leads to {what} {link['target']}"
    )


def reading_words(document: Document) -> str:
    """Return what a heading says about the reading of a document, nothing for the consistent one."""
    reading = document["reading"]
    return "" if reading == "consistent" else f", equations in the reading {reading}"


def branch_report(branch: Document) -> list[RenderableType]:
    """Return the printable report of one branch: its special points, counts and the reason why it ended."""
    parts: list[RenderableType] = [_special_points(branch)] if branch["special_points"] else []
    points = branch["points"]
    counts = Counter(p["stability"] for p in points)
    kinds = ", ".join(f"{counts[k]} {k}" for k in ("stable", "unstable", "undecided") if counts[k])
    errors = [p["waveform_error"] for p in points if p["waveform_error"] is not None]
    lines = [f"{len(points)} orbits: {kinds}; largest waveform error {small(max(errors, default=None))}"]
    if branch["resonances"]:
        lines.append(
            "resonances (peaks of the RMS among these orbits): " + ", ".join(_peak(p) for p in branch["resonances"])
        )
    largest = max(points, key=lambda p: p["rms"])
    lines.append(
        f"largest RMS {amplitude(largest['rms'])} at {largest['frequency_ratio']:.4f} ({largest['stability']})"
    )
    steady = [p for p in points if p["stability"] == "stable"]
    if steady:
        top = max(steady, key=lambda p: p["rms"])
        lines.append(f"largest stable RMS {amplitude(top['rms'])} at {top['frequency_ratio']:.4f}")
    lines += [f"unresolved: {text}" for text in branch["unresolved"]]
    lines.append(f"{'complete' if branch['complete'] else 'ENDED EARLY'}: {branch['stop']}")
    return [*parts, *(Text(line) for line in lines)]


def _peak(peak: Document) -> str:
    return f"{peak['rms']:.4f} at {peak['frequency_ratio']:.4f}{_at_speed(peak['pinion_rpm'])}"


def _special_points(branch: Document) -> Table:
    rpm = any(p["pinion_rpm"] is not None for p in branch["special_points"])
    table = plain_table(
        "special point", ">frequency ratio", ">error", *([">pinion rpm"] if rpm else []), ">RMS", "status"
    )
    for p in branch["special_points"]:
        status = p["status"] + (f": {p['note']}" if p["note"] else "")
        speeds = [speed(p["pinion_rpm"])] if rpm else []
        table.add_row(
            p["kind"], ratio(p["frequency_ratio"]), small(p["error"]), *speeds, amplitude(p["rms"]), Text(status)
        )
    return table


def study_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a study document."""
    first, last = document["range"]
    names = " and ".join(s["state"] for s in document["states"])
    head = f"{document['pair']}: {names}, frequency ratio {first:g} to {last:g}, exact backlash law"
    head += reading_words(document)
    parts: list[RenderableType] = [Text(head, style="bold"), _quantities(document["quantities"])]
    parts += [Text(f"Warning: {text}", style="yellow") for text in document["warnings"]]
    if document["assumed"]:
        parts.append(assumed_table(document["assumed"]))
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    for state in document["states"]:
        title = f"{state['state']} ({_percent(state['stiffness_peak_to_peak'])} peak-to-peak stiffness fluctuation)"
        parts += [Text(f"\n{title}", style="bold"), *branch_report(state["branches"][0]), *_jumps(state)]
        parts += check_report(state["cross_check"])
    parts += [Text("\nbefore against after", style="bold"), _comparison(document["comparison"])]
    parts.append(
        Text("\nRMS is that of lambda about its mean, in half backlashes; frequency ratio is omega_m/omega_n.")
    )
    parts.append(Text(document["computation"]))
    return parts


def _percent(part: float) -> str:
    return f"{100 * part:.4g} %"


def _quantities(rows: Iterable[Document]) -> Table:
    table = plain_table("quantity", ">value", "unit", "note")
    for row in rows:
        table.add_row(row["name"], row["text"], Text(row["unit"]), Text(row["note"]))
    return table


def assumed_table(rows: Sequence[Document]) -> Table:
    """Return the table of the assumed values of a pair."""
    table = plain_table("assumed value", "value", "unit", "note")
    for row in rows:
        key = f"[{row['section']}] {row['key']}" if row["section"] else row["key"]
        table.add_row(Text(key), Text(row["value"]), Text(row["unit"]), Text(row["note"]))
    return table


def _jumps(state: Document) -> list[Text]:
    folds = [p for p in state["branches"][0]["special_points"] if p["kind"] == "fold"]
    if not folds:
        return [Text("no jumps: the branch has no fold")]
    where = [f"{p['frequency_ratio']:.6f}" + _at_speed(p["pinion_rpm"]) for p in folds]
    return [Text(f"jump frequencies (folds): {', '.join(where)}")]


def _at_speed(rpm: float | None) -> str:
    return "" if rpm is None else f" ({speed(rpm)} rpm)"


def check_report(check: Document) -> list[Text]:
    """Return the lines that compare sweeps with the stable branch."""
    total = sum(len(s["points"]) for s in check["sweeps"])
    ratios = {p["frequency_ratio"] for s in check["sweeps"] for p in s["points"]}
    head = f"sweeps with CVODES: {len(ratios)} frequencies up and down; "
    head += f"{check['compared']} of {total} responses on the stable branch"
    lines = [head]
    if check["largest_difference"] is not None:
        worst = f"  largest difference in RMS {small(check['largest_difference'])}"
        lines.append(f"{worst} at {check['at']:.4f}, sweep {check['direction']}")
    kinds: dict[str, dict[str, list[float]]] = {}
    for e in check["elsewhere"]:
        kinds.setdefault(e["attractor"], {}).setdefault(e["direction"], []).append(e["frequency_ratio"])
    for attractor, directions in kinds.items():
        listed = (f"{d} at {', '.join(f'{r:.4f}' for r in sorted(rs))}" for d, rs in directions.items())
        lines.append(f"  {attractor}: {'; '.join(listed)}")
    return [Text(line) for line in lines]


def _comparison(comparison: Document) -> Table:
    names = list(comparison["states"])
    table = plain_table("", *(f">{n}" for n in names), ">change")
    for key, words in (
        ("largest_rms", "largest RMS of the traced orbits"),
        ("largest_stable_rms", "largest RMS of stable ones"),
        ("largest_sweep_rms", "largest RMS of the sweeps"),
    ):
        values = [comparison["states"][n][key] for n in names]
        change = comparison["change"][key]
        table.add_row(words, *(amplitude(v) for v in values), "-" if change is None else f"{100 * change:+.1f} %")
    for kind, words in (
        ("fold", "folds"),
        ("period-doubling", "period-doublings"),
        ("neimark-sacker", "neimark-sacker points"),
        ("grazing", "grazing points (contact intervals come or go)"),
    ):
        table.add_row(words, *(str(comparison["states"][n]["special_points"].get(kind, 0)) for n in names), "")
    return table


def plain_table(*columns: str) -> Table:
    """Return a plain table; a column whose heading begins with > is aligned to the right."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in columns:
        right = heading.startswith(">")
        table.add_column(heading.removeprefix(">"), justify="right" if right else "left", overflow="fold")
    return table


def print_all(console: Console, parts: Iterable[RenderableType]) -> None:
    """Print the parts of a report."""
    for part in parts:
        console.print(part)


def as_text(parts: Iterable[RenderableType]) -> str:
    """Return a report as plain text, lines of at most 120 characters.

    Examples
    --------
    >>> as_text([Text("done", style="bold")])
    'done\\n'
    """
    stream = io.StringIO()
    print_all(Console(file=stream, width=WIDTH, color_system=None, highlight=False, legacy_windows=False), parts)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"
