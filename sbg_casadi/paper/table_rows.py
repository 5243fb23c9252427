"""Rows for the tables and for sentences that the tables, or other sentences, decide."""

from __future__ import annotations

import math

from sbg_casadi.paper.printed import (
    AMPLITUDES,
    CAPTIONS,
    CASES,
    CLAIMED_AMPLITUDES,
    CLAIMED_REDUCTIONS,
    EXPONENTS,
    IMPROVES_MOTION,
    METHOD,
    MOTION_AS_TOLD,
    PAIRS,
    REFERENCES,
    REGIMES,
    YEARS,
    digits_unit,
)
from sbg_casadi.paper.row import Row, compared, number, stated

MEMBERS = ("pinion", "gear")


def table_rows() -> list[Row]:
    """Return the rows of Tables 1 to 7 and of the sentences about them.

    Examples
    --------
    >>> [r.verdict for r in table_rows() if r.key in ("reduction-case3", "claim-Abstract-case3")]
    ['reproduced', 'contradicted']
    """
    return [
        *_methods(),
        *(row for case in CASES for row in _radii(case)),
        *(_reduction(case) for case in CASES),
        *(_claimed(*claim) for claim in CLAIMED_REDUCTIONS),
        *(_amplitude(*claim) for claim in CLAIMED_AMPLITUDES),
        _difference(),
        *_ordering(),
        *_exponents(),
        *_chaos(),
        *(_reference(*one) for one in REFERENCES),
    ]


def _methods() -> list[Row]:
    rows = [
        stated(
            f"year-{case}", "Table 1; section 1", "table", f"year of the source of {case}", str(table), str(text),
            table == text, difference=float(text - table), tolerance=0.0, agrees="both places have the same year.",
            differs="the two places have different years.",
        )
        for case, (table, text) in YEARS.items()
    ]  # fmt: skip
    for kind in ("topology", "flank"):
        said = {place: table[kind] for place, table in IMPROVES_MOTION.items() if kind in table}
        words = "; ".join(f"{place}: {'yes' if better else 'no'}" for place, better in said.items())
        rows.append(
            stated(
                f"improves-{kind}", "Discussion; Conclusions", "sentence",
                f"{kind} modifications improve the qualitative motion", words,
                "yes and no" if len(set(said.values())) > 1 else words.partition(": ")[2][:3].strip("; "),
                len(set(said.values())) == 1, agrees="all sentences say the same.",
                differs="the sentences say both; the one before the list has topology and flank exchanged.",
            )
        )  # fmt: skip
    return rows


def _radii(case: str) -> list[Row]:
    table = PAIRS[case]
    place, rows = f"Table {table.number}", []
    cosine = math.cos(math.radians(float(table.pressure_angle)))
    for member, teeth, printed in zip(MEMBERS, table.teeth, table.base_radius, strict=True):
        pitch = float(table.module) * teeth / 2
        rows.append(
            compared(
                f"radius-{case}-{member}", place, "table", f"base circle radius of the {member}, m z cos(alpha) / 2",
                printed, pitch * cosine, digits_unit(printed), unit="mm", agrees="it follows from module, teeth and "
                "pressure angle of the same table.", differs=_other_radius(float(printed), pitch, cosine),
            )
        )  # fmt: skip
    ratio = float(table.base_radius[1]) / float(table.base_radius[0])
    teeth_ratio = table.teeth[1] / table.teeth[0]
    near = sum(digits_unit(r) / float(r) for r in table.base_radius) * teeth_ratio
    rows.append(
        stated(
            f"ratio-{case}", place, "table", "the base radii have the ratio of the teeth", number(ratio),
            number(teeth_ratio), abs(ratio - teeth_ratio) <= near, difference=round(teeth_ratio - ratio, 9),
            tolerance=near, agrees="they do.", differs="a gear and a pinion that mesh have radii in that ratio.",
        )
    )  # fmt: skip
    return rows


def _other_radius(printed: float, pitch: float, cosine: float) -> str:
    """Return what a wrong base radius is, if it is something known."""
    known = {
        "the base diameter": 2 * pitch * cosine, "the pitch radius": pitch, "the pitch diameter": 2 * pitch,
    }  # fmt: skip
    for name, value in known.items():
        if abs(value / printed - 1) < 1e-4:
            return f"the printed number is {name}."
    return "it does not follow from module, teeth and pressure angle of the same table."


def _reduction(case: str) -> Row:
    before, after, printed = AMPLITUDES[case]
    ours = 100 * (1 - float(after) / float(before))
    return compared(
        f"reduction-{case}", "Table 7", "table", f"reduction of the largest amplitude of {case}", printed, ours,
        digits_unit(printed), unit="%", agrees="it follows from the two amplitudes beside it.",
        differs="it does not follow from the two amplitudes beside it.",
    )  # fmt: skip


def _claimed(place: str, case: str, printed: str) -> Row:
    before, after, _ = AMPLITUDES[case]
    ours = 100 * (1 - float(after) / float(before))
    return compared(
        f"claim-{place}-{case}", place, "sentence", f"reduction of the vibration level of {case}", printed, ours,
        digits_unit(printed), unit="%", agrees="Table 7 gives it, rounded or cut off.",
        differs=f"Table 7 gives {ours:.2f} % and no other case is nearer.",
    )  # fmt: skip


def _amplitude(place: str, case: str, state: str, printed: str) -> Row:
    entry = AMPLITUDES[case][0 if state == "before" else 1]
    return compared(
        f"amplitude-{case}-{state}", place, "sentence", f"largest RMS of {case}, {state}", printed, float(entry),
        digits_unit(printed), agrees="Table 7 has the same.", differs="Table 7 has another number.",
    )  # fmt: skip


def _difference() -> Row:
    before, after, _ = AMPLITUDES["case2"]
    return compared(
        "amplitude-change-case2", "text of Figure 9", "sentence", "drop of the largest RMS of case2", "0.01",
        float(before) - float(after), 0.005, agrees="Table 7 gives it.", differs="Table 7 gives another drop.",
    )  # fmt: skip


def _ordering() -> list[Row]:
    reductions = {case: 100 * (1 - float(after) / float(before)) for case, (before, after, _) in AMPLITUDES.items()}
    flank = min(r for case, r in reductions.items() if METHOD[case] == "flank")
    topology = max(r for case, r in reductions.items() if METHOD[case] == "topology")
    least = min(reductions.values())
    return [
        stated(
            "all-decrease", "Conclusions", "sentence", "vibration levels decrease with every modification",
            "> 0 % in all four cases", f"{number(least)} % or more", least > 0, difference=least, tolerance=0.0,
            agrees="all four reductions of Table 7 are positive.", differs="one reduction of Table 7 is not.",
        ),
        stated(
            "flank-more", "Discussion", "sentence",
            "cases 3 and 4 (flank) improve more than cases 1 and 2 (topology), in amplitude", "3 and 4 above 1 and 2",
            f"{number(flank)} % against {number(topology)} %", flank > topology,
            difference=round(flank - topology, 9), tolerance=0.0, agrees="Table 7 has that order.",
            differs="by Table 7 the amplitude of case 4 (flank) drops less than that of case 1 (topology).",
        ),
    ]  # fmt: skip


def _exponents() -> list[Row]:
    odd = [heading for _, heading, _, _ in EXPONENTS if not heading.replace(".", "").isdigit()]
    rows = [
        stated(
            "table-6-head", "Table 6", "table", "its headings are excitation frequencies of case 3", "8 frequencies",
            f"{len(EXPONENTS) - len(odd)} frequencies, and {', '.join(odd)}", not odd, difference=float(-len(odd)),
            tolerance=0.0, agrees="they are.",
            differs="three headings name cases; by the text of Figure 13 they stand for 1.11, 1.7 and 2.30.",
        )
    ]  # fmt: skip
    told = {(r.state, r.low): r.motion for r in REGIMES if r.case == "case3" and r.low == r.high}
    wrong = []
    for state, _, ratio, value in EXPONENTS:
        if (float(value) > 0) != (told[state, ratio] == "chaotic"):
            wrong.append(ratio)
    rows.append(
        stated(
            "signs", "Table 6; Figures 13, 15", "table",
            "exponents are positive where the motion is called chaotic, negative where periodic", "8 of 8",
            f"{len(EXPONENTS) - len(wrong)} of {len(EXPONENTS)}", not wrong, difference=float(-len(wrong)),
            tolerance=0.0, agrees="signs and words agree.", differs="signs and words differ at " + ", ".join(wrong),
        )
    )  # fmt: skip
    return rows


def chaos_removed() -> list[str]:
    """Return the cases that, by the paper's own text, are chaotic somewhere before and nowhere after.

    >>> chaos_removed()
    ['case4']
    """
    return [c for c, (before, after) in MOTION_AS_TOLD.items() if "chaotic" in before and "chaotic" not in after]


def _chaos() -> list[Row]:
    removed = chaos_removed()
    before, after = (states.count("chaotic") for states in MOTION_AS_TOLD["case3"])
    text = "cases 1 and 2 are periodic before and after, case 3 stays chaotic at three frequencies of Table 6; only "
    rows = [
        stated(
            f"three-{n}", place, "sentence", "three modifications prevent chaotic behaviour", "3 of 4",
            f"{len(removed)} of 4", len(removed) == 3, difference=float(len(removed) - 3), tolerance=0.0,
            agrees="three cases turn from chaotic to periodic.",
            differs=text + f"{' and '.join(removed)} turns periodic.",
        )
        for n, place in enumerate(("Abstract", "Section 1, last paragraph"), 1)
    ]  # fmt: skip
    rows.append(
        stated(
            "three-regions", "Discussion; Figure 13", "sentence", "case 3 is chaotic in three regions before", "3",
            str(before), before == 3, difference=float(before - 3), tolerance=0.0,
            agrees="Figure 13 and Table 6 say the same.", differs="Figure 13 and Table 6 say otherwise.",
        )
    )  # fmt: skip
    before_table = sum(state == "before" and float(v) > 0 for state, _, _, v in EXPONENTS)
    at_2 = [r.motion for r in REGIMES if (r.case, r.state, r.low) == ("case3", "after", "1.10")]
    rows.append(
        stated(
            "one-suppressed", "Discussion; Figure 15; Table 6", "sentence",
            "chaos of case 3 is suppressed in at least one of the three regions", f"1 of {before_table}",
            f"{at_2.count('period-2')} of {before_table}", at_2.count("period-2") >= 1, difference=0.0, tolerance=0.0,
            agrees=f"the region near 1.1 turns to period 2, and {after} frequencies of Table 6 stay chaotic.",
            differs="no region is told to turn periodic.",
        )
    )  # fmt: skip
    return rows


def _reference(kind: str, case: str, figure: int) -> Row:
    found_kind, found_case = CAPTIONS[figure]
    return stated(
        f"reference-{figure}-{kind.lower()}-{case}", f"text on Figure {figure}", "sentence",
        f"Figure {figure} is the {kind} diagram of {case}", f"{kind}, {case}", f"{found_kind}, {found_case}",
        (kind, case) == (found_kind, found_case), agrees="its caption says the same.",
        differs="its caption says that it shows something else; the text counts the figures one too low.",
    )  # fmt: skip
