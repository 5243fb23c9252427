"""Rows that need the model: peaks, motions, exponents and figures of the four cases, and the stiff-bearing limit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sbg_casadi.paper.printed import AMPLITUDES, EXPONENTS, METHOD, PEAKS, REGIMES, Regime, digits_unit
from sbg_casadi.paper.row import Row, modelled, number, stated, unchecked

FIGURES = {
    "case1": {"stiffness": "Figure 3", "RMS": "Figure 7", "before": "Figure 8", "after": "Figure 8"},
    "case2": {"stiffness": "Figure 4", "RMS": "Figure 9", "before": "Figure 10", "after": "Figure 11"},
    "case3": {"stiffness": "Figure 5", "RMS": "Figure 12", "before": "Figure 13", "after": "Figure 14"},
    "case4": {"stiffness": "Figure 6", "RMS": "Figure 16", "before": "Figure 17", "after": "Figure 19"},
}
"""Where the paper draws what, by case."""

HEIGHT, HEIGHT_SHARE = 0.005, 0.03
"""Largest difference of an RMS that counts as agreement: half a unit of the printed digit, or that share if more."""

EXPONENT_SHARE = 0.2
"""Share of a printed exponent by which ours may differ, if that is more than three of its errors."""

RATE_SHARE = 0.05
"""Share by which the fall of the stiff-bearing difference may differ from a hundredfold one."""

Numbers = Mapping[str, Any]


def model_rows(numbers: Numbers) -> list[Row]:
    """Return the rows of what was computed; a case that was not asked for has none.

    Parameters
    ----------
    numbers : mapping
        ``cases``: :func:`~sbg_casadi.paper.numbers.case_numbers` by case; ``stiff``: the stiff-bearing part or None.
    """
    rows = _stiff(numbers["stiff"])
    for case, found in numbers["cases"].items():
        rows += [_stiffness(case, found)]
        rows += [_amplitude(case, state, found) for state in ("before", "after")]
        rows += [_lower(case, found), *(_position(case, state, found) for state in PEAKS[case][1])]
        if case in ("case1", "case2"):
            rows += [_all_periodic(case, state, found) for state in ("before", "after")]
        rows += [_motion(r, found) for r in REGIMES if r.case == case]
    if "case3" in numbers["cases"]:
        rows += [_exponent(*entry, numbers["cases"]["case3"]) for entry in EXPONENTS]
    return rows


def _stiff(part: Numbers | None) -> list[Row]:
    statement = "very stiff bearings reduce the model to one degree of freedom"
    if part is None or any(r is None for r in part["rates"]):
        reason = "the comparison could not be computed in this run."
        return [unchecked("stiff-bearings", "Figure 2; section 3", "figure", statement, "agreement", reason)]
    rates, least = part["rates"], part["stiff"][-1]["median_difference"]
    worst = max(rates, key=lambda r: abs(r - 100))
    words = " and ".join(f"{r:.2f}" for r in rates)
    return [
        stated(
            "stiff-bearings", "Figure 2; section 3", "figure",
            statement, "agreement",
            f"median difference of RMS {least:.1e} at 1e8 times the stiffness; it falls by {words} for each factor 100",
            abs(worst / 100 - 1) <= RATE_SHARE, difference=worst - 100, tolerance=100 * RATE_SHARE,
            agrees=f"(23)-(29) have the oscillator as their limit at the rate 1/K whatever the parameters are; shown "
            f"with those of {part['pair']}.", differs="the difference does not fall like 1/K.",
        )
    ]  # fmt: skip


def _stiffness(case: str, found: Numbers) -> Row:
    spans = [found["states"][s]["peak_to_peak"] for s in ("before", "after")]
    ours = " to ".join(f"{100 * v:.1f} %" for v in spans if v is not None)
    return Row(
        f"stiffness-{case}", FIGURES[case]["stiffness"], "figure", f"mesh stiffness of {case} over the cycle, before "
        "and after", "a curve without numbers", f"peak to peak {ours} of the mean", None, None, "none",
        "not checkable", f"the curve is not printed as numbers; ours is {found['basis']}.",
    )  # fmt: skip


def _amplitude(case: str, state: str, found: Numbers) -> Row:
    printed = AMPLITUDES[case][0 if state == "before" else 1]
    peak, tolerance = found["states"][state]["peak"], max(HEIGHT, HEIGHT_SHARE * float(printed))
    place = f"Table 7; {FIGURES[case]['RMS']}"
    off = None if peak is None else peak["rms"] - float(printed)
    return modelled(
        f"peak-{case}-{state}", place, "table", f"largest RMS of {case}, {state}, half backlashes", printed,
        "-" if peak is None else number(peak["rms"]), found["basis"],
        None if off is None else abs(off) <= tolerance, difference=off, tolerance=tolerance,
        detail="" if peak is None else f"ours is at {peak['frequency_ratio']:.3f}",
        conflict=conflict(found, f"{state}: peak, height", f"{state}: peak"),
    )  # fmt: skip


def _lower(case: str, found: Numbers) -> Row:
    before, after = (found["states"][s]["peak"] for s in ("before", "after"))
    off = None if before is None or after is None else 100 * (1 - after["rms"] / before["rms"])
    kind = METHOD[case]
    return modelled(
        f"lower-{case}", f"text of {FIGURES[case]['RMS']}", "figure",
        f"the {kind} modification lowers the largest RMS of {case}", f"by {AMPLITUDES[case][2]} %",
        "-" if off is None else f"by {off:.1f} %", found["basis"],
        None if off is None else abs(off - float(AMPLITUDES[case][2])) <= 5.0,
        difference=None if off is None else off - float(AMPLITUDES[case][2]), tolerance=5.0,
    )  # fmt: skip


def _position(case: str, state: str, found: Numbers) -> Row:
    peak, printed = found["states"][state]["peak"], PEAKS[case][0]
    off = None if peak is None else peak["frequency_ratio"] - float(printed)
    tolerance = digits_unit(printed)
    return modelled(
        f"position-{case}-{state}", f"text of {FIGURES[case]['RMS']}", "figure",
        f"frequency ratio of the largest RMS of {case}, {state}", printed,
        "-" if peak is None else number(peak["frequency_ratio"]), found["basis"],
        None if off is None else abs(off) <= tolerance * (1 + 1e-9), difference=off, tolerance=tolerance,
        conflict=conflict(found, f"{state}: peak, position"),
    )  # fmt: skip


def _all_periodic(case: str, state: str, found: Numbers) -> Row:
    one = found["states"][state]
    words = ", ".join(f"{n} {v}" for v, n in one["verdicts"].items()) or "-"
    return modelled(
        f"periodic-{case}-{state}", FIGURES[case][state], "figure", f"{case} is periodic throughout, {state}",
        "periodic", words, found["basis"], one["periodic"],
        detail="motions of the sweeps up and down",
    )  # fmt: skip


def conflict(found: Numbers, *targets: str) -> str:
    """Return the clause of the calibration about the first of some targets that it has one for, else nothing."""
    return next((found["conflicts"][t] for t in targets if t in found["conflicts"]), "")


def agrees(wanted: str, verdict: str) -> bool:
    """Return whether a motion is what the paper calls it.

    >>> agrees("periodic", "period-10"), agrees("chaotic", "not recognised"), agrees("period-1", "period-2")
    (True, False, False)
    """
    return verdict.startswith("period-") if wanted == "periodic" else verdict == wanted


def _motion(regime: Regime, found: Numbers) -> Row:
    one = found["states"][regime.state]
    if regime.low == regime.high:
        motions = one["motions"].get(f"{float(regime.low):g}", [])
        ours = "; ".join(f"{m['verdict']} ({', '.join(m['reached'])})" for m in motions)
        holds = any(agrees(regime.motion, m["verdict"]) for m in motions) if motions else None
        if not motions:  # a frequency without a section of its own: the sweeps have it
            holds, ours = _in_sweeps(regime, one["points"])
        at = f"at {regime.low}"
    else:
        holds, ours = _in_sweeps(regime, one["points"])
        at = f"from {regime.low} to {regime.high}"
    key = f"motion-{regime.case}-{regime.state}-{regime.low}"
    what = f"motion of {regime.case}, {regime.state}, {at}"
    why = conflict(found, f"{regime.state}: {regime.motion} at {float(regime.low):g}")
    return modelled(key, regime.place, "figure", what, regime.motion, ours, found["basis"], holds, conflict=why)


def _in_sweeps(regime: Regime, points: list[dict[str, Any]]) -> tuple[bool | None, str]:
    """Return whether all motions of the sweeps inside a range are as told, and which there are."""
    low, high = float(regime.low) - 1e-9, float(regime.high) + 1e-9
    inside = [p["verdict"] for p in points if low <= p["frequency_ratio"] <= high]
    words = ", ".join(f"{inside.count(v)} {v}" for v in sorted(set(inside)))
    return (all(agrees(regime.motion, v) for v in inside) if inside else None), words or "-"


def _exponent(state: str, heading: str, ratio: str, printed: str, found: Numbers) -> Row:
    motions = found["states"][state]["motions"].get(f"{float(ratio):g}", [])
    told = next((r.motion for r in REGIMES if (r.case, r.state, r.low) == ("case3", state, ratio)), "")
    motions = sorted(motions, key=lambda m: not agrees(told, m["verdict"]))  # the motion that is meant, if it is there
    best = motions[0] if motions else None
    ours, off, tolerance, holds, detail = "-", None, None, None, ""
    if best is not None and best["variational"]["value"] is not None:
        value, error = (float(best["variational"][k]) for k in ("value", "error"))
        off = value - float(printed)
        tolerance = max(EXPONENT_SHARE * abs(float(printed)), 3 * error)
        holds = abs(off) <= tolerance and (value > 0) == (float(printed) > 0)
        series = best["series"]
        told_series = f"{series['value']:+.4f} +- {series['error']:.4f}" if series["value"] is not None else "none"
        ours = f"{value:+.4f} +- {error:.4f} variational, {told_series} from the series"
        detail = f"the motion is {best['verdict']}; per unit of tau, which the paper does not say"
    return modelled(
        f"exponent-{state}-{ratio}", "Table 6", "table",
        f"largest exponent of case3, {state}, at {ratio}" + ("" if heading == ratio else f" (headed '{heading}')"),
        printed, ours, found["basis"], holds, difference=off, tolerance=tolerance, detail=detail,
        conflict=conflict(found, f"{state}: exponent at {float(ratio):g}"),
    )  # fmt: skip
