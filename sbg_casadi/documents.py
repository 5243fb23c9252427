"""Responses as JSON-ready documents; every number that is printed comes from them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from scipy.signal import find_peaks

from continuation.branches.branch import Branch, SpecialPoint, leading
from continuation.branches.explore import Tree
from sbg_casadi.pair import Pair

SCHEMA = 1
STATE = "lambda"
"""The coordinate whose root mean square about the mean is "the response"."""


def is_complete(branch: Branch, stop: float) -> bool:
    """Return whether the branch ends at the wanted frequency ratio."""
    return math.isclose(branch.orbits[-1].value, stop, rel_tol=1e-9)


def response_document(branch: Branch, pair: Pair, state: str, smoothing: float, stop: float) -> dict[str, Any]:
    """Return the JSON-ready document of a response; every number that is printed or drawn comes from it."""
    return {
        "schema": SCHEMA,
        "pair": pair.name,
        "state": state,
        "smoothing": smoothing,
        "branches": [branch_document(branch, None if pair.derived is None else pair.derived.unit_ratio_rpm, stop)],
    }


def tree_document(tree: Tree, pair: Pair, state: str, smoothing: float, span: tuple[float, float]) -> dict[str, Any]:
    """Return the JSON-ready document of a response with the branches that leave it.

    Every branch has ``number``, ``parent`` (None for the first) and ``leaves_at``, the special point of the parent;
    ``links`` lists special points that lead to a branch known already, ``notes`` what was not followed.
    """
    rpm = None if pair.derived is None else pair.derived.unit_ratio_rpm
    branches = []
    for number, limb in enumerate(tree.limbs):
        document = branch_document(limb.branch, rpm, span[1])
        if number:  # such a branch may end anywhere at either end of the range, at its parent, or in itself
            document["complete"] = all(
                part.startswith(("reached", "met the branch", "closed")) for part in limb.branch.stop.split("; ")
            )
        leaves = None if limb.point is None else {"kind": limb.point.kind, "frequency_ratio": limb.point.parameter}
        branches.append({"number": number, "parent": limb.parent, "leaves_at": leaves} | document)
    return {
        "schema": SCHEMA,
        "pair": pair.name,
        "state": state,
        "smoothing": smoothing,
        "branches": branches,
        "links": [
            {
                "branch": k.number,
                "kind": k.point.kind,
                "frequency_ratio": k.point.parameter,
                "target": k.target,
                "likeness": k.likeness,
            }
            for k in tree.links
        ],
        "notes": list(tree.notes),
    }


def branch_document(branch: Branch, unit_ratio_rpm: float | None, stop: float) -> dict[str, Any]:
    """Return one branch of a response document.

    Parameters
    ----------
    branch : Branch
    unit_ratio_rpm : float or None
        Pinion speed in rev/min at frequency ratio 1; None for a dimensionless pair.
    stop : float
        Frequency ratio that the branch was to reach.
    """
    return {
        "period_multiple": branch.period_multiple,
        "stop": branch.stop,
        "complete": is_complete(branch, stop),
        "points": [
            {
                "frequency_ratio": o.value,
                "rms": o.rms(STATE),
                "stability": o.stability,
                "leading_multiplier": [_finite(part) for part in leading(o.multipliers)],
                "waveform_error": _finite(o.error),
            }
            for o in branch.orbits
        ],
        "special_points": [_point(p, unit_ratio_rpm) for p in branch.special_points],
        "resonances": _resonances(branch, unit_ratio_rpm),
        "unresolved": list(branch.unresolved),
        "work": {k: _finite(v) for k, v in branch.work.items()},
        "provenance": dict(branch.provenance),
    }


def _resonances(branch: Branch, unit_ratio_rpm: float | None) -> list[dict[str, Any]]:
    """Return the orbits at which the RMS has a peak along the branch, one that stands out by 5 % of the largest."""
    rms = branch.rms(STATE)
    peaks, _ = find_peaks(rms, prominence=0.05 * rms.max())
    return [
        {
            "frequency_ratio": branch.orbits[i].value,
            "rms": float(rms[i]),
            "stability": branch.orbits[i].stability,
            "pinion_rpm": None if unit_ratio_rpm is None else branch.orbits[i].value * unit_ratio_rpm,
        }
        for i in peaks.tolist()
    ]


def _point(point: SpecialPoint, unit_ratio_rpm: float | None) -> dict[str, Any]:
    return {
        "kind": point.kind,
        "frequency_ratio": point.parameter,
        "rms": point.orbit.rms(STATE),
        "error": _finite(point.error),
        "multipliers": [[_finite(m.real), _finite(m.imag)] for m in point.multipliers.tolist()],
        "pinion_rpm": None if unit_ratio_rpm is None else point.parameter * unit_ratio_rpm,
        "status": point.status,
        "note": point.note,
    }


def _finite(value: float) -> float | None:
    """Return a number that JSON can hold; what is not finite becomes null."""
    number = value.item() if hasattr(value, "item") else value
    return number if math.isfinite(number) else None


def to_json(document: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
