"""The document of a run: everything that page, Markdown and JSON show, from one set of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sbg_casadi.documents import SCHEMA
from sbg_casadi.paper.learned import learned
from sbg_casadi.paper.numbers import case_numbers
from sbg_casadi.paper.plan import STATES, Plan
from sbg_casadi.paper.printed import AMPLITUDES, EXPONENTS, REGIMES
from sbg_casadi.paper.row import MEANING, counts
from sbg_casadi.paper.scoreboard import scoreboard

Document = dict[str, Any]


def paper_document(
    command: str, plan: Plan, cases: Mapping[str, Any], stiff: Mapping[str, Any] | None, failures: list[str]
) -> Document:
    """Return the JSON-ready document of a run.

    Parameters
    ----------
    command : str
    plan : Plan
    cases : mapping
        Parts by case.
    stiff : mapping or None
        The stiff-bearing part.
    failures : list of str
        What could not be computed, a sentence each.
    """
    found = {name: case_numbers(parts) for name, parts in cases.items()}
    rows = scoreboard({"cases": found, "stiff": stiff})
    return {
        "schema": SCHEMA,
        "command": command,
        "settings": {"cases": list(plan.cases), "points": plan.points, "range": list(plan.span)},
        "pairs": {name: {"pair": parts["pair"], "basis": parts["basis"]} for name, parts in cases.items()},
        "verdicts": dict(MEANING),
        "counts": counts(rows),
        "scoreboard": [asdict(row) for row in rows],
        "learned": {name: learned(name, one) for name, one in found.items()},
        "table_6": _table_6(found),
        "remarks": _remarks(_table_6(found)),
        "table_7": _table_7(found),
        "numbers": {name: {k: v for k, v in one.items() if k != "failures"} for name, one in found.items()},
        "stiff_bearings": stiff,
        "failures": failures,
    }


def _table_6(numbers: Mapping[str, Any]) -> list[Document]:
    """Return the rows of Table 6: paper, variational exponent, exponent of the time series, per unit of tau."""
    rows = []
    for state, heading, ratio, printed in EXPONENTS:
        found = numbers.get("case3", {}).get("states", {}).get(state, {}).get("motions", {})
        told = next(r.motion for r in REGIMES if (r.case, r.state, r.low) == ("case3", state, ratio))
        for motion in found.get(f"{float(ratio):g}", []):
            rows.append(
                {
                    "state": state,
                    "frequency_ratio": ratio,
                    "heading": heading,
                    "paper": printed,
                    "told": told,
                    "motion": motion["verdict"],
                    "reached": ", ".join(motion["reached"]),
                    "variational": motion["variational"],
                    "series": motion["series"],
                }
            )
    return rows


def _remarks(table: list[Document]) -> list[str]:
    """Return what Table 6 shows about the method of the paper, in numbers."""
    periodic = [r for r in table if r["motion"].startswith("period-") and r["series"]["value"] is not None]
    if not periodic:
        return []
    wrong = [r for r in periodic if r["series"]["value"] > 0]
    return [
        f"Of {len(periodic)} periodic motions in this table, the time series alone gives {len(wrong)} a positive "
        "exponent: neighbours in a series that repeats differ by rounding, and their divergence says nothing. The "
        "variational exponent of a stable orbit is negative."
    ]


def _table_7(numbers: Mapping[str, Any]) -> list[Document]:
    """Return the rows of Table 7: the paper's amplitudes and reduction beside ours."""
    rows = []
    for case, found in numbers.items():
        peaks = [found["states"][state]["peak"] for state in STATES]
        both = all(p is not None for p in peaks)
        rows.append(
            {
                "case": case,
                "paper": dict(zip(("before", "after", "reduction"), AMPLITUDES[case], strict=True)),
                "before": peaks[0],
                "after": peaks[1],
                "reduction": 100 * (1 - peaks[1]["rms"] / peaks[0]["rms"]) if both else None,
                "basis": found["basis"],
            }
        )
    return rows
