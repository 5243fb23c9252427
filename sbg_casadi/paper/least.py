"""The least modification that would have sufficed, by the curves of ``sbg map PAIR --over modification``."""

from __future__ import annotations

from typing import Any

import numpy as np

from sbg_casadi.map_curves import Curves, find_curves
from sbg_casadi.map_grid import Grid
from sbg_casadi.map_parameters import vary
from sbg_casadi.map_study import curves_document
from sbg_casadi.map_verdict import least_document
from sbg_casadi.paper.plan import Plan, Subject
from sbg_casadi.progress import Report
from sbg_casadi.reading import CONSISTENT

AMOUNTS = (0.0, 1.0)
"""Amounts of modification: before, after."""

_CHECKS = 1
_TRACKED = (("fold", 1), ("period-doubling", 1))  # torus points are many, and tracking them takes longest
_MANY = 10


def least_part(subject: Subject, plan: Plan, report: Report, special: int = 0) -> dict[str, Any]:
    """Return curves of special points over the amount of modification and what follows from them, JSON-ready.

    Parameters
    ----------
    subject : Subject
    plan : Plan
    report : callable
    special : int
        Folds and doublings of both states together; with more than 10 the doublings alone are tracked, to save time.

    Returns
    -------
    dict
        ``least``: the sentence and value beyond which the period-1 response has no doubling; ``moves``: each special
        point before with the one after on the same curve, or where the curve turns back; ``failures``.

    Raises
    ------
    ContinuationError
        If no response can be traced.
    """
    varied = vary(subject.pair, "modification", None, CONSISTENT)
    tracked = _TRACKED if special <= _MANY else _TRACKED[1:]
    found = find_curves(
        varied, plan.span, AMOUNTS, checks=_CHECKS, report=lambda f, t: report(0.7 * f, t), tracked=tracked
    )
    grid = Grid.empty(np.array(plan.span), np.array(AMOUNTS))  # attractors are in the sweeps
    least = least_document(varied, found, grid, plan.span, AMOUNTS, lambda f, t: report(0.7 + 0.3 * f, t))
    del least["attractors_beyond"]
    document = curves_document(found)
    return {
        "tracked": [kind for kind, _ in tracked],
        "least": least,
        "moves": _moves(found, document),
        "curves": [
            {k: c[k] for k in ("kind", "period_multiple", "frequency_ratio", "value")} for c in document["curves"]
        ],
        "failures": document["failures"],
    }


def _moves(found: Curves, document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return where every special point of period 1 goes, from the numbers of the curves at both ends."""
    first, last = ({s.value: s for s in found.slices}.get(v) for v in AMOUNTS)
    if first is None or last is None:
        return []
    rows: list[dict[str, Any]] = []
    numbers = dict.fromkeys(n for s in (first, last) for n in s.curves if n is not None)
    for number in numbers:
        curve = found.curves[number]
        before, after = (
            sorted(q.parameter for q, n in zip(s.points, s.curves, strict=True) if n == number) for s in (first, last)
        )
        end = None
        if len(before) != len(after):
            top = curve.points[:, 1].argmax() if before else curve.points[:, 1].argmin()
            end = {"frequency_ratio": float(curve.points[top, 0]), "value": float(curve.points[top, 1])}
        rows.append(
            {
                "kind": curve.kind,
                "period_multiple": curve.period_multiple,
                "before": before,
                "after": after,
                "turns": end,
            }
        )
    for name, s in (("before", first), ("after", last)):
        for q, n in zip(s.points, s.curves, strict=True):
            if n is None:
                row: dict[str, Any] = {
                    "kind": q.kind,
                    "period_multiple": q.orbit.period_multiple,
                    "before": [],
                    "after": [],
                }
                rows.append(row | {name: [q.parameter], "turns": None})
    return sorted(rows, key=lambda r: (r["kind"], r["before"] or r["after"]))
