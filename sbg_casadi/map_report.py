"""Text of a map, made from the same document that is written as JSON, and its curves for netCDF."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.text import Text

from sbg_casadi.report import assumed_table, plain_table, reading_words

if TYPE_CHECKING:
    from rich.console import RenderableType

Document = Mapping[str, Any]


def map_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a map document; the sentence comes first."""
    over, (low, high) = document["over"], document["span"]
    unit = f" {over['unit']}" if over["unit"] else ""
    first, last = document["range"]
    head = (
        f"{document['pair']}: map over {over['name']} {low:g} to {high:g}{unit}, frequency ratio {first:g} to {last:g}"
    )
    if document["state"] not in (None, "only"):
        head += f", state {document['state']}"
    parts: list[RenderableType] = [Text(head + reading_words(document), style="bold")]
    parts.append(Text(document["least"]["sentence"], style="bold green"))
    parts += [Text(line) for line in check_lines(document)]
    if document["curves"]:
        parts.append(_curves(document))
    else:
        parts.append(Text("no fold, doubling or torus point of the response in this range"))
    parts += [Text(line) for line in _special(document)]
    parts.append(_attractors(document["grid"]))
    values = ", ".join(f"{v:g}" for v in document["least"]["traced_at"])
    parts.append(
        Text(
            f"The response was traced at {over['name']} {values}{unit}; every special point there lies on a curve "
            "shown, or is named below. A closed curve between two of these values would be missed."
        )
    )
    if document["assumed"]:
        parts.append(assumed_table(document["assumed"]))
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    parts.append(Text(document["computation"]))
    return parts


def check_lines(document: Document) -> list[str]:
    """Return what the checks on both sides of the value say."""
    least, lines = document["least"], []
    checks = least["checks"]
    for name, words in (("continuation", "traced again"), ("time_domain", "in the time domain")):
        check = checks.get(name)
        if check is None:
            continue
        verdict = {True: "confirmed", False: "NOT CONFIRMED", None: "open"}[check["agrees"]]
        sides = [_side(check[s], s) for s in ("with", "without") if check[s] is not None]
        why = f" ({check['why']})" if check["why"] else ""
        lines.append(f"  {words}: {verdict}{why}" + (": " + "; ".join(sides) if sides else ""))
    beyond = least["attractors_beyond"]
    if beyond:
        listed = ", ".join(f"{n} {w}" for w, n in beyond.items())
        text = f"  attractors of the sweeps beyond it: {listed}"
        if set(beyond) - {"period 1"}:
            text += "; those that are not period 1 lie on other branches, not born at a doubling of this response"
        lines.append(text)
    return lines


def _side(side: Document, name: str) -> str:
    if "attractor" in side:
        return (
            f"at {side['value']:.6g}, ratio {side['frequency_ratio']:.6f}: {side['attractor']}, "
            f"period-1 orbit {side['stability']}"
        )
    found = side["frequency_ratios"]
    listed = f"doublings at {', '.join(f'{p:.6f}' for p in found)}" if found else "no doubling"
    return f"at {side['value']:.6g}: {listed}"


def _curves(document: Document) -> RenderableType:
    name = document["over"]["name"]
    table = plain_table("curve", ">points", f">{name} from", ">to", ">ratio from", ">to", "found at", "ends")
    for c in document["curves"]:
        kind = c["kind"] if c["period_multiple"] == 1 else f"{c['kind']} of period {c['period_multiple']}"
        p, q = c["frequency_ratio"], c["value"]
        numbers = (f"{v:.6f}" for v in (min(q), max(q), min(p), max(p)))
        table.add_row(Text(kind), str(len(p)), *numbers, Text(c["origin"]), Text(c["stop"]))
    return table


def _special(document: Document) -> list[str]:
    """Return a line for every point of codimension two and extremum of a curve inside the map."""
    name, (low, high) = document["over"]["name"], sorted(document["range"])
    return [
        f"  {s['kind']} on the curve of {c['kind']}s: {name} {s['value']:.8g} at ratio {s['frequency_ratio']:.8f}"
        for c in document["curves"]
        for s in c["special_points"]
        if low <= s["frequency_ratio"] <= high
    ]


def _attractors(grid: Document) -> RenderableType:
    total = sum(grid["counts"].values())
    table = plain_table(f"attractors ({total})", ">number", ">share")
    for words, count in grid["counts"].items():
        table.add_row(words, str(count), f"{100 * count / total:.1f} %")
    return table


def with_curves(data: Any, document: Document) -> Any:
    """Return the dataset of a grid with the curves added, one after the other along ``curve_point``."""
    from continuation.netcdf import about

    curves = document["curves"]
    number = np.concatenate([np.full(len(c["value"]), i) for i, c in enumerate(curves)] or [np.empty(0)]).astype(int)
    axis = ("curve_point",)
    columns = {key: np.array([v for c in curves for v in c[key]], dtype=float) for key in ("frequency_ratio", "value")}
    return data.assign(
        curve=(axis, number, about("number of the curve that the point belongs to", "1")),
        curve_frequency=(axis, columns["frequency_ratio"], about("frequency ratio", "1")),
        curve_value=(axis, columns["value"], about(document["over"]["label"], document["over"]["unit"] or "1")),
        curve_kind=(("curve_number",), np.array([c["kind"] for c in curves], dtype=object)),
        curve_period=(("curve_number",), np.array([c["period_multiple"] for c in curves], dtype=int)),
    )
