"""An identification as a JSON-ready document, and the text that shows its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.text import Text

from sbg_casadi.identification.determinacy import RANGE_ERROR, direction_words
from sbg_casadi.identification.outcome import Identification, Settings
from sbg_casadi.identification.targets_file import TargetsFile
from sbg_casadi.report import plain_table

if TYPE_CHECKING:
    from rich.console import RenderableType

SCHEMA = 1
_AT_BOUND = 1e-3  # of the range
_METHODS = {
    "orbit": "orbit by harmonic balance",
    "peak": "smooth maximum of the orbits",
    "fold": "fold of the orbits",
}


def identification_document(
    found: Identification, targets: TargetsFile, command: str, settings: Settings
) -> dict[str, Any]:
    """Return an identification ready for JSON."""
    return {
        "schema": SCHEMA,
        "complete": found.complete,
        "command": command,
        "pair": found.pair.name,
        "title": targets.title,
        "seed": settings.seed,
        "candidates": len(found.archive),
        "cost": found.cost,
        "unknowns": _unknowns(found),
        "targets": _targets(found),
        "sensitivity": _sensitivity(found),
        "conflicts": [
            {"target": c.target, "others": list(c.others), "evidence": c.evidence, "text": c.text}
            for c in found.conflicts
        ],
        "notes": list(found.notes),
    }


def _unknowns(found: Identification) -> list[dict[str, Any]]:
    """Return the rows of the unknowns; ``determined`` is None for a choice, and where no target has a gradient."""
    judged, rows = found.determinacy, []
    for i, (u, t) in enumerate(zip(found.unknowns, found.coordinates.tolist(), strict=True)):
        sure = None if judged is None or u.choices else bool(judged.determined[i])
        error = float(judged.errors[i] * abs(u.slope(t))) if judged is not None and sure else None
        rows.append(
            {
                "name": u.name,
                "keys": list(u.keys),
                "value": u.value(t),
                "unit": u.unit,
                "bounds": list(u.choices) if u.choices else [u.low, u.high],
                "scale": "choice" if u.choices else u.scale,
                "standard_error": error,
                "determined": sure,
                "at_bound": not u.choices and min(t, 1 - t) < _AT_BOUND,
            }
        )
    return rows


def _targets(found: Identification) -> list[dict[str, Any]]:
    rows, place = [], 0
    for target, values, words in zip(found.targets, found.values, found.words, strict=True):
        method = _METHODS.get(found.followed.get(target.name, ""), "time domain")
        common = {"target": target.name, "state": target.state, "kind": target.kind, "at": _plain(target.at)}
        if target.kind == "regime":
            r = float(found.residuals[place])
            rows.append(
                common
                | {"quantity": "regime", "wanted": target.regime, "tolerance": None, "found": words, "residual": r}
                | {"met": r < 1, "method": method}
            )
            place += 1
            continue
        for (quantity, wanted, tolerance), value in zip(target.wanted, values, strict=True):
            r = float(found.residuals[place])
            rows.append(
                common
                | {"quantity": quantity, "wanted": wanted, "tolerance": tolerance, "found": _plain(value)}
                | {"residual": r, "met": abs(r) <= 1 + 1e-9, "method": method}
            )
            place += 1
    return rows


def _sensitivity(found: Identification) -> dict[str, Any]:
    names = [u.name for u in found.unknowns]
    judged = found.determinacy
    if judged is None:
        return {"singular_values": [], "directions": [], "not_followed": found.reasons}
    rows = zip(judged.singular_values.tolist(), judged.directions, strict=True)
    return {
        "singular_values": judged.singular_values.tolist(),
        "directions": [
            {
                "singular_value": s,
                "unknowns": dict(zip(names, v.tolist(), strict=True)),
                "words": direction_words(v, names),
            }
            for s, v in rows
        ],
        "not_followed": found.reasons,
    }


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# -------------------------------------------------------------------------------------------------- text
def identification_report(document: Mapping[str, Any]) -> list[RenderableType]:
    """Return the printable report of an identification document."""
    head = f"{document['pair']}: {document['title']}; {document['candidates']} candidates, seed {document['seed']}"
    parts: list[RenderableType] = [Text(head, style="bold")]
    parts += [
        Text(f"FINISHED IN PART: {note}" if not document["complete"] else f"note: {note}") for note in document["notes"]
    ]
    parts += [Text("\ntargets", style="bold"), _target_table(document["targets"])]
    met = sum(row["met"] for row in document["targets"])
    parts.append(Text(f"{met} of {len(document['targets'])} met"))
    parts += [Text("\nvalues found", style="bold"), _unknown_table(document["unknowns"])]
    undetermined = [row["name"] for row in document["unknowns"] if row["determined"] is False]
    if undetermined:
        parts.append(Text(f"not determined by the targets that have a gradient: {', '.join(undetermined)}"))
    parts += _directions(document["sensitivity"])
    if document["conflicts"]:
        parts.append(Text("\nconflicts", style="bold"))
        parts += [Text(c["text"]) for c in document["conflicts"]]
    words = "RMS in half backlashes, frequency ratio omega_m/omega_n, exponents per 1/omega_n; residuals in tolerances."
    parts.append(Text(f"\n{words}"))
    return parts


def _target_table(rows: Any) -> RenderableType:
    table = plain_table("target", "quantity", ">wanted", ">tolerance", ">found", ">residual", "", "by")
    for row in rows:
        wanted, got = (
            v if isinstance(v, str) else "-" if v is None else f"{v:.6g}" for v in (row["wanted"], row["found"])
        )
        tolerance = "-" if row["tolerance"] is None else f"{row['tolerance']:g}"
        table.add_row(
            Text(row["target"]), row["quantity"], wanted, tolerance, got, f"{row['residual']:+.2f}",
            "met" if row["met"] else "MISSED", row["method"],
        )  # fmt: skip
    return table


def _unknown_table(rows: Any) -> RenderableType:
    table = plain_table("unknown", ">value", "unit", ">standard error", "range", "")
    for row in rows:
        value = row["value"] if isinstance(row["value"], str) else f"{row['value']:.6g}"
        error = "-" if row["standard_error"] is None else f"{row['standard_error']:.2g}"
        limits = (v if isinstance(v, str) else f"{v:g}" for v in row["bounds"])
        remark = "at its bound" if row["at_bound"] else ""
        sure = "not determined" if row["determined"] is False else ""
        table.add_row(
            Text(row["name"]), value, Text(row["unit"]), error, " or ".join(limits) if row["scale"] == "choice" else
            " to ".join(limits), ", ".join(w for w in (sure, remark) if w),
        )  # fmt: skip
    return table


def _directions(sensitivity: Mapping[str, Any]) -> list[RenderableType]:
    if not sensitivity["directions"]:
        return [Text("no target has a gradient here: what they determine can't be told")]
    parts: list[RenderableType] = [
        Text("\ndirections in the ranges of the unknowns, and how many tolerances they move the targets", style="bold")
    ]
    table = plain_table(">singular value", "direction")
    for row in sensitivity["directions"]:
        table.add_row(f"{row['singular_value']:.3g}", Text(row["words"]))
    parts.append(table)
    limit = 1 / RANGE_ERROR
    parts.append(Text(f"below {limit:.2g} a direction is known no better than by its range"))
    return parts
