"""From the parts of a case to the numbers that rows, paragraphs and tables show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Any

from sbg_casadi.paper.plan import STATES

Document = dict[str, Any]


def case_numbers(case: Mapping[str, Any]) -> Document:
    """Return the numbers of one case.

    Parameters
    ----------
    case : mapping
        ``pair``, ``basis``, ``failures``, ``least`` and for ``before`` and ``after`` the parts that could be computed.

    Returns
    -------
    dict
        ``pair``, ``basis``, ``failures``, ``conflicts`` (of the calibration, by target), ``states`` (see
        :func:`state_numbers`), ``least`` and ``moves``.
    """
    least = case.get("least") or {}
    return {
        "pair": case["pair"],
        "basis": case["basis"],
        "failures": list(case["failures"]),
        "conflicts": dict(case.get("conflicts", {})),
        "states": {state: state_numbers(case[state]) for state in STATES},
        "least": least.get("least"),
        "moves": least.get("moves", []),
        "tracked": least.get("tracked", []),
    }


def state_numbers(parts: Mapping[str, Any]) -> Document:
    """Return the numbers of one state; what could not be computed is None.

    Returns
    -------
    dict
        ``peak_to_peak`` of the stiffness over its mean; ``peak``: largest RMS among stable traced orbits and sweeps,
        with its frequency ratio; ``peaks``: all resonances of the branch; ``special``: frequency ratios of special
        points by kind and period; ``intervals`` of motions that are not period 1; ``periodic``: whether all motions of
        the sweeps are; ``dynamic_factor``, ``bearing_force``, ``bearing_swing``, ``unit``, ``points``, ``motions``.
    """
    response, sweeps, motions = (parts.get(name) for name in ("response", "sweeps", "motions"))
    points = [p for s in sweeps["sweeps"] for p in s["points"]] if sweeps else []
    forces = (response or {}).get("forces") or {}
    factors = [(p["dynamic_factor"], p["frequency_ratio"]) for p in points if p["dynamic_factor"] is not None]
    if "dynamic_factor" in forces:
        factors.append((forces["dynamic_factor"]["value"], forces["dynamic_factor"]["frequency_ratio"]))
    verdicts = [p["verdict"] for p in points]
    return {
        "peak_to_peak": parts["stiffness"]["peak_to_peak"] if parts.get("stiffness") else None,
        "peak": _peak(response, points),
        "peaks": response["branches"][0]["resonances"] if response else [],
        "special": _special(response) if response else None,
        "intervals": intervals(points) if sweeps else None,
        "periodic": all(v.startswith("period-") for v in verdicts) if verdicts else None,
        "verdicts": {v: verdicts.count(v) for v in sorted(set(verdicts))},
        "dynamic_factor": _largest(factors),
        "bearing_force": forces.get("bearing_force"),
        "bearing_swing": forces.get("bearing_swing"),
        "unit": forces.get("unit", ""),
        "points": [{k: p[k] for k in ("frequency_ratio", "verdict", "rms")} for p in points],
        "motions": _motions(motions) if motions else {},
    }


def _peak(response: Document | None, points: list[Document]) -> Document | None:
    """Return the largest RMS of what a test rig could show: stable orbits of the branches, and the sweeps."""
    found = [(p["rms"], p["frequency_ratio"], "sweep") for p in points if p["rms"] is not None]
    for branch in (response or {}).get("branches", ()):
        found += [(p["rms"], p["frequency_ratio"], "branch") for p in branch["points"] if p["stability"] == "stable"]
    if not found:
        return None
    rms, ratio, source = max(found)
    return {"rms": rms, "frequency_ratio": ratio, "source": source}


def _largest(pairs: list[tuple[float, float]]) -> Document | None:
    if not pairs:
        return None
    value, ratio = max(pairs)
    return {"value": value, "frequency_ratio": ratio}


def _special(response: Document) -> dict[str, list[float]]:
    """Return sorted frequency ratios of the located special points of period 1, doublings of period 2 apart."""
    found: dict[str, list[float]] = {"fold": [], "period-doubling": [], "neimark-sacker": [], "period-4": []}
    for branch in response["branches"]:
        for point in branch["special_points"]:
            if branch["period_multiple"] == 1 and point["kind"] in found:
                found[point["kind"]].append(point["frequency_ratio"])
            elif branch["period_multiple"] == 2 and point["kind"] == "period-doubling":
                found["period-4"].append(point["frequency_ratio"])
    return {kind: sorted(values) for kind, values in found.items()}


def intervals(points: Iterable[Mapping[str, Any]]) -> list[Document]:
    """Return ranges of neighbouring frequencies with a motion other than period 1, up and down together.

    Examples
    --------
    >>> rows = [{"frequency_ratio": f, "verdict": v} for f, v in
    ...         [(1.0, "period-1"), (1.1, "chaotic"), (1.2, "chaotic"), (1.1, "period-2"), (1.3, "period-1")]]
    >>> intervals(rows)
    [{'verdict': 'chaotic', 'from': 1.1, 'to': 1.2}, {'verdict': 'period-2', 'from': 1.1, 'to': 1.1}]
    """
    table: dict[float, set[str]] = {}
    for p in points:
        table.setdefault(p["frequency_ratio"], set()).add(p["verdict"])
    out = []
    for verdict in sorted({v for found in table.values() for v in found} - {"period-1"}):
        for there, group in groupby(sorted(table), key=lambda f: verdict in table[f]):
            inside = list(group)
            if there:
                out.append({"verdict": verdict, "from": inside[0], "to": inside[-1]})
    return sorted(out, key=lambda r: (r["verdict"], r["from"]))


def _motions(part: Document) -> dict[str, list[Document]]:
    """Return for each frequency of the paper the motions found, without their points."""
    names = ("verdict", "period", "rms", "reached", "variational", "series")
    return {
        f"{row['frequency_ratio']:g}": [{k: m[k] for k in names} for m in row["motions"]] for row in part["frequencies"]
    }
