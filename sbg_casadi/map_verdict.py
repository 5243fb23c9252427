"""The sentence of a map: beyond which value the period-1 response has no doubling, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from sbg_casadi.map_check import check_by_continuation, check_in_time, other_attractors
from sbg_casadi.map_curves import Curves
from sbg_casadi.map_grid import Grid
from sbg_casadi.map_least import DOUBLING, End, Extent, as_plain, extents, free
from sbg_casadi.map_parameters import Varied


def least_document(
    varied: Varied,
    found: Curves,
    grid: Grid,
    band: tuple[float, float],
    span: tuple[float, float],
    report: Callable[[float, str], None],
) -> dict[str, Any]:
    """Return where the period-1 response has no doubling, with checks, ready for JSON.

    Returns
    -------
    dict
        ``sentence``; ``value``, ``error`` and ``frequency_ratio`` of the value beyond which there is none (None where
        there is no such value); ``case`` (``extremum``, ``band``, ``never`` doubles, ``persists``, ``undecided``);
        ``intervals`` with doublings, each with its ends; ``below``: the same downwards, for a quantity whose low end
        is free; ``checks``.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    report(0.0, "extent of the doublings")
    regions = extents(varied, found.curves, band, span)
    doubtful = _doubtful(found)
    document: dict[str, Any] = {
        "intervals": [[as_plain(r.low), as_plain(r.high)] for r in regions],
        "value": None,
        "error": None,
        "frequency_ratio": None,
        "checks": {},
        "attractors_beyond": {},
        "traced_at": sorted(s.value for s in found.slices),
    }
    case, end = _case(regions, doubtful, span)
    if end is not None and case in ("extremum", "band"):
        report(0.3, "checks on both sides")
        continuation = check_by_continuation(varied, end, band, span, 1)
        report(0.6, "checks in the time domain")
        document["checks"] = {
            "continuation": continuation,
            "time_domain": check_in_time(varied, found.curves[end.curve], end, band, span, 1),
        }
        document["attractors_beyond"] = other_attractors(grid, end, 1)
        if continuation["agrees"] is False:
            case, doubtful = "undecided", ["the response traced next to the value does not confirm it"]
        else:
            document |= {"value": end.value, "error": end.error, "frequency_ratio": end.frequency_ratio}
    return document | {"case": case, "sentence": sentence(varied, case, end, regions, band, span, doubtful)}


def _doubtful(found: Curves) -> list[str]:
    """Return why the set of doublings may not be complete: points on no curve, slices in part."""
    out = []
    for one in found.slices:
        lost = [
            q.parameter
            for q, number in zip(one.points, one.curves, strict=True)
            if number is None and q.kind == DOUBLING and q.orbit.period_multiple == 1
        ]
        out += [f"the doubling at {p:.6f}, value {one.value:.6g}, lies on no tracked curve" for p in lost]
        out += [note for note in one.notes if "ended early" in note]
    return out


def _case(regions: Sequence[Extent], doubtful: Sequence[str], span: tuple[float, float]) -> tuple[str, End | None]:
    if doubtful:
        return "undecided", regions[-1].high if regions else None
    if not regions:
        return "never", None
    end = regions[-1].high
    if end.kind == "limit":
        return "persists", end
    return ("undecided" if end.kind == "stop" else end.kind), end


def sentence(
    varied: Varied,
    case: str,
    end: End | None,
    regions: Sequence[Extent],
    band: tuple[float, float],
    span: tuple[float, float],
    doubtful: Sequence[str],
) -> str:
    """Return the sentence the engineer needs."""
    name, unit = varied.name, f" {varied.unit}" if varied.unit else ""
    low, high = sorted(band)
    where = f"between frequency ratio {low:g} and {high:g}"
    response = "the period-1 response"
    if case == "never":
        return f"From {name} {span[0]:g} to {span[1]:g}{unit} {response} has no doubling {where}."
    if case == "undecided":
        reasons = (
            list(doubtful) or [f"its curve of doublings ends at {end.value:.6g}{unit}: {end.note}"] if end else doubtful
        )
        return f"Undecided beyond which {name} {response} has no doubling {where}, because " + "; ".join(reasons) + "."
    assert end is not None
    if case == "persists":
        text = f"Up to the largest {name} {span[1]:g}{unit} {response} doubles {where}"
        text += f" (there at {end.frequency_ratio:.6f})."
    else:
        how = "its last two doublings meet" if case == "extremum" else "its last doubling leaves the band"
        text = f"Beyond {name} {end.value:.7g}{unit} (error {end.error:.1e}) {response} has no doubling {where}: "
        text += f"{how} at frequency ratio {end.frequency_ratio:.6f}."
    gaps = [g for g in free(regions, span) if g[1] is not None]
    return text + "".join(_gap(varied, g, span) for g in gaps)


def _gap(varied: Varied, gap: tuple[End | None, End | None], span: tuple[float, float]) -> str:
    """Return a further sentence about an interval without doublings below the last one with some."""
    unit = f" {varied.unit}" if varied.unit else ""
    low, high = gap
    assert high is not None
    if low is None:
        return f" Below {varied.name} {high.value:.7g}{unit} it has none, either."
    return f" Between {varied.name} {low.value:.7g} and {high.value:.7g}{unit} it has none, either."
