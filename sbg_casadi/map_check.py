"""Checks on both sides of the value beyond which the period-1 response has no doubling."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation import Branch, ContinuationError, Orbit
from sbg_casadi.map_curves import MapCurve, problem_at, trace_slice
from sbg_casadi.map_grid import VERDICTS, Grid, settled, word
from sbg_casadi.map_least import DOUBLING, End
from sbg_casadi.map_parameters import Varied

_NEAR, _FAR = 1e-3, 5e-2  # of the range: distances from the value for checks by continuation and in the time domain
_PUSH = 1e-3  # half backlashes by which the time-domain check starts beside the periodic orbit
_LIMIT = 20000  # mesh periods for an attractor to be recognised: next to a doubling a response departs slowly


def check_by_continuation(
    varied: Varied, end: End, band: tuple[float, float], span: tuple[float, float], above: int
) -> dict[str, Any]:
    """Trace the response close to the value on both sides and count its doublings in the band.

    Parameters
    ----------
    varied : Varied
    end : End
        Where the doublings end.
    band, span : (float, float)
        Frequency ratios, values.
    above : int
        +1 when there is no doubling above the value, -1 when there is none below.

    Returns
    -------
    dict
        ``with`` and ``without``: value and doublings found on the side where some, none are expected; ``agrees``;
        ``why`` it could not be made, else empty.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    near = _NEAR * abs(span[1] - span[0])
    sides: dict[str, Any] = {}
    try:
        for name, side in (("with", -above), ("without", above)):
            value = _inside(end.value + side * near, span)
            one = trace_slice(varied, value, band, doubled=False)
            found = [q.parameter for q in one.points if q.kind == DOUBLING]
            sides[name] = {"value": value, "frequency_ratios": found, "notes": one.notes}
    except ContinuationError as error:
        return {"agrees": None, "why": str(error), "with": None, "without": None}
    complete = not any(side["notes"] for side in sides.values())
    agrees = bool(sides["with"]["frequency_ratios"]) and not sides["without"]["frequency_ratios"]
    return {"agrees": agrees if complete or not agrees else None, "why": "", **sides}


def check_in_time(
    varied: Varied, curve: MapCurve, end: End, band: tuple[float, float], span: tuple[float, float], above: int
) -> dict[str, Any]:
    """Integrate from close to the period-1 orbit on both sides of the value and name the attractor reached.

    Returns
    -------
    dict
        ``with`` and ``without``: value, frequency ratio, stability of the period-1 orbit by its multipliers, and the
        attractor; ``agrees`` when the response stays with period 1 on the side without doublings and leaves it on
        the other one; ``why`` a check could not be made, else empty.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C.
    """
    far = _FAR * abs(span[1] - span[0])
    sides: dict[str, Any] = {}
    try:
        for name, side in (("with", -above), ("without", above)):
            value = _inside(end.value + side * far, span)
            frequency = _between(curve, value, end, band) if name == "with" else end.frequency_ratio
            sides[name] = _settle(varied, value, frequency, band)
    except ContinuationError as error:
        return {"agrees": None, "why": str(error), "with": None, "without": None}
    words = [sides[name]["attractor"] for name in ("with", "without")]
    sure = all(w.startswith(("period", "quasi", "chaotic")) for w in words)
    agrees = words[0] != "period 1" and words[1] == "period 1"
    return {"agrees": agrees if sure else None, "why": "" if sure else "an attractor was not recognised", **sides}


def _between(curve: MapCurve, value: float, end: End, band: tuple[float, float]) -> float:
    """Return the frequency ratio half way between the two doublings of a curve next to an end, inside the band."""
    at = sorted((float(y[0]) for y, _ in curve.at(value)), key=lambda p: abs(p - end.frequency_ratio))
    at = [p for p in at if min(band) <= p <= max(band)]
    if end.kind == "extremum" and len(at) > 1:
        return (at[0] + at[1]) / 2
    if not at:
        raise ContinuationError(f"the curve of doublings does not pass {value:.6g} in the band")
    return (at[0] + end.frequency_ratio) / 2


def _settle(varied: Varied, value: float, frequency: float, band: tuple[float, float]) -> dict[str, Any]:
    """Return what is reached from close to the period-1 orbit at a value and a frequency ratio."""
    one = trace_slice(varied, value, band, doubled=False)
    problem = problem_at(varied, value)
    orbit = problem.solve(_nearest(one.branches[0], frequency), frequency)
    start = orbit.evaluate(np.zeros(1))[0] + _PUSH
    sweep = settled(varied, value, np.array([frequency]), start, _LIMIT).run()
    verdict = sweep.verdicts[0]
    return {
        "value": value,
        "frequency_ratio": frequency,
        "stability": orbit.stability,
        "attractor": verdict.replace("period-", "period "),
    }


def _nearest(branch: Branch, frequency: float) -> Orbit:
    """Return the orbit of a branch nearest to a frequency ratio."""
    return min(branch.orbits, key=lambda o: abs(o.value - frequency))


def _inside(value: float, span: tuple[float, float]) -> float:
    return float(np.clip(value, min(span), max(span)))


def other_attractors(grid: Grid, end: End, above: int) -> dict[str, int]:
    """Return how many attractors of a grid on the side without doublings are of which kind.

    Other ones than period 1 there belong to branches that are not born at a doubling of the period-1 response.
    """
    rows = (grid.values - end.value) * above > 0
    verdicts, periods = grid.verdict[:, rows].ravel(), grid.period[:, rows].ravel()
    words = [word(VERDICTS[v], int(n)) for v, n in zip(verdicts, periods, strict=True)]
    return dict(sorted(((w, words.count(w)) for w in set(words)), key=lambda item: (-item[1], item[0])))
