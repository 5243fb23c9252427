"""The scoreboard of the paper: rows that follow from what is printed, and the rules that every row obeys."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

import sbg_casadi.paper.table_rows as tables
from sbg_casadi.pair import case_names
from sbg_casadi.paper.learned import learned
from sbg_casadi.paper.model_rows import model_rows
from sbg_casadi.paper.numbers import state_numbers
from sbg_casadi.paper.plan import Plan, paper_frequencies, subject
from sbg_casadi.paper.printed import AMPLITUDES, CASES, PAIRS, digits_unit
from sbg_casadi.paper.row import VERDICTS, Row, compared, counts, modelled
from sbg_casadi.paper.scoreboard import scoreboard

ROWS = {row.key: row for row in scoreboard()}


# ---------------------------------------------------------------------------------------- printed data alone
@pytest.mark.parametrize(("case", "total"), [("case1", 0.92808), ("case2", 0.92781), ("case3", 0.93416)])
def test_direction_cosines_do_not_sum_to_one(case: str, total: float) -> None:
    """By hand at 20 and 35 deg: sums of squares of (9)-(11) as printed."""
    row = ROWS[f"cosines-{case}"]
    z_1, z_2 = PAIRS[case].teeth
    sa, ca, sb = math.sin(math.radians(20)), math.cos(math.radians(20)), math.sin(math.radians(35))
    sd, cd = z_1 / math.hypot(z_1, z_2), z_2 / math.hypot(z_1, z_2)
    by_hand = (sa * sd + sa * sb * cd) ** 2 + (sa * cd + ca * sb * sd) ** 2 + ca**2 * (1 - sb**2)
    assert by_hand == pytest.approx(total, abs=1e-5)
    assert row.difference == pytest.approx(by_hand - 1, abs=1e-6)
    assert row.verdict == "contradicted"


RADII = {
    ("case1", "pinion"): (20.42, "contradicted"),
    ("case1", "gear"): (59.81, "contradicted"),
    ("case2", "pinion"): (40.88, "contradicted"),
    ("case2", "gear"): (119.90, "reproduced"),
    ("case3", "pinion"): (42.14, "reproduced"),
    ("case3", "gear"): (119.11, "reproduced"),
    ("case4", "pinion"): (75.65, "reproduced"),
    ("case4", "gear"): (213.78, "reproduced"),
}


@pytest.mark.parametrize(("case", "member"), RADII)
def test_base_radii(case: str, member: str) -> None:
    value, verdict = RADII[case, member]
    row = ROWS[f"radius-{case}-{member}"]
    assert float(row.ours.split()[0]) == pytest.approx(value, abs=0.006)
    assert row.verdict == verdict
    known = {("case1", "gear"): "diameter", ("case2", "pinion"): "pitch radius"}
    assert known.get((case, member), "") in row.reason


@pytest.mark.parametrize("case", CASES)
def test_the_ratio_of_the_radii(case: str) -> None:
    assert ROWS[f"ratio-{case}"].verdict == ("reproduced" if case in ("case3", "case4") else "contradicted")


@pytest.mark.parametrize(("case", "percent"), [("case1", 20.0), ("case2", 8.33), ("case3", 69.12), ("case4", 17.65)])
def test_percentages_of_table_7(case: str, percent: float) -> None:
    before, after, _ = AMPLITUDES[case]
    row = ROWS[f"reduction-{case}"]
    assert 100 * (float(before) - float(after)) / float(before) == pytest.approx(percent, abs=0.005)
    assert float(row.ours.split()[0]) == pytest.approx(percent, abs=0.005)
    assert row.verdict == "reproduced"


def test_percentages_of_the_sentences() -> None:
    found = {key: row.verdict for key, row in ROWS.items() if key.startswith("claim-")}
    assert {key for key, verdict in found.items() if verdict == "contradicted"} == {"claim-Abstract-case3"}
    assert len(found) == 8


def test_the_factor_2_is_missing_in_25_alone() -> None:
    verdicts = {n: ROWS[f"motion-{n}"].verdict for n in range(24, 30)}
    assert verdicts == {n: "contradicted" if n == 25 else "reproduced" for n in range(24, 30)}
    assert (ROWS["motion-25"].printed, ROWS["motion-25"].ours) == ("1", "2")


def test_all_eight_forces_are_virtual_work() -> None:
    assert {ROWS[f"force-{n}"].verdict for n in range(1, 9)} == {"reproduced"}


@pytest.mark.parametrize(
    "key",
    [
        "three-1",  # three modifications prevent chaos
        "three-2",
        "improves-topology",  # topology and flank exchanged
        "flank-more",
        "harmonics",
        "table-6-head",
        "radius-and-a3",
        "error-series",
        "natural-frequency",
        "damping-unit",
        "reference-8-rms-case2",
        "reference-11-rms-case3",
        "reference-12-bifurcation-case3",
    ],
)
def test_sentences_that_contradict_each_other(key: str) -> None:
    assert ROWS[key].verdict == "contradicted"


@pytest.mark.parametrize("key", ["all-decrease", "signs", "three-regions", "one-suppressed", "improves-flank"])
def test_sentences_that_agree(key: str) -> None:
    assert ROWS[key].verdict == "reproduced"


def test_verdicts_follow_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Change what is printed and the verdict changes: none is typed in."""
    monkeypatch.setitem(tables.AMPLITUDES, "case3", ("0.68", "0.40", "69.12"))
    table = replace(PAIRS["case1"], base_radius=("20.42", "59.81"))
    monkeypatch.setitem(tables.PAIRS, "case1", table)
    rows = {row.key: row for row in tables.table_rows()}
    assert rows["reduction-case3"].verdict == "contradicted"
    assert rows["reduction-case3"].difference == pytest.approx(100 * (1 - 0.40 / 0.68) - 69.12, abs=1e-9)
    for key in ("radius-case1-pinion", "radius-case1-gear", "ratio-case1"):
        assert rows[key].verdict == "reproduced"


# ---------------------------------------------------------------------------------------- rules of every row
def test_every_row_has_one_verdict_and_one_sentence() -> None:
    rows = scoreboard()
    assert sum(counts(rows).values()) == len(rows) == len(ROWS)
    for row in rows:
        assert row.verdict in VERDICTS
        assert row.reason.endswith(".")
        assert row.statement
        assert row.printed
        assert row.ours
        assert (row.verdict in ("reproduced", "contradicted")) == (row.basis == "printed")


def test_nothing_calibrated_or_assumed_is_reproduced_or_contradicted() -> None:
    for basis in ("calibrated", "assumed", "none"):
        for verdict in ("reproduced", "contradicted"):
            with pytest.raises(ValueError, match="can't rest on"):
                replace(ROWS["reduction-case1"], basis=basis, verdict=verdict)
    with pytest.raises(ValueError, match="can't rest on printed"):
        replace(ROWS["reduction-case1"], verdict="matched after calibration")


@pytest.mark.parametrize(
    ("basis", "holds", "verdict"),
    [
        ("calibrated", True, "matched after calibration"),
        ("calibrated", False, "not checkable"),
        ("calibrated", None, "not checkable"),
        ("assumed", True, "not checkable"),
        ("assumed", False, "not checkable"),
    ],
)
def test_verdicts_of_the_model(basis: Any, holds: bool | None, verdict: str) -> None:
    assert modelled("k", "Table 7", "table", "s", "0.1", "0.1", basis, holds).verdict == verdict


def test_tolerance_is_one_unit_of_the_last_digit() -> None:
    def row(ours: float) -> Row:
        return compared("k", "p", "table", "s", "42.14", ours, digits_unit("42.14"), agrees="a.", differs="d.")

    assert row(42.1499).verdict == row(42.1301).verdict == "reproduced"
    assert row(42.151).verdict == row(42.129).verdict == "contradicted"


# ---------------------------------------------------------------------------------------- rows of the model
def part(verdicts: dict[float, str], rms: float, stability: str = "stable") -> dict[str, Any]:
    points = [{"frequency_ratio": f, "verdict": v, "rms": rms, "dynamic_factor": 1.5} for f, v in verdicts.items()]
    orbit = {"frequency_ratio": 1.5, "rms": 2 * rms, "stability": stability}
    branch = {"period_multiple": 1, "points": [orbit], "special_points": [], "resonances": []}
    return {
        "stiffness": {"peak_to_peak": 0.2},
        "response": {"branches": [branch], "forces": None},
        "sweeps": {"sweeps": [{"points": points}]},
        "motions": {"frequencies": []},
    }


def case(before: dict[str, Any], after: dict[str, Any], basis: str) -> dict[str, Any]:
    states = {"before": state_numbers(before), "after": state_numbers(after)}
    return {"pair": "p", "basis": basis, "failures": [], "conflicts": {}, "states": states, "least": None, "moves": []}


def test_peaks_are_compared_with_table_7() -> None:
    """Unstable orbits do not count; 0.102 rounds to 0.10, 0.11 after does not to 0.08."""
    quiet = {0.5: "period-1", 1.5: "period-1"}
    found = case(part(quiet, 0.102, "unstable"), part(quiet, 0.055), "calibrated")
    rows = {r.key: r for r in model_rows({"cases": {"case1": found}, "stiff": None})}
    assert rows["peak-case1-before"].verdict == "matched after calibration"
    assert rows["peak-case1-after"].verdict == "not checkable"
    assert rows["peak-case1-after"].difference == pytest.approx(0.03)
    found["conflicts"] = {"after: peak, height": "met by 3 of 286", "before: peak, height": "met by all"}
    rows = {r.key: r for r in model_rows({"cases": {"case1": found}, "stiff": None})}
    assert rows["peak-case1-after"].reason.endswith("; met by 3 of 286.")
    assert "met by all" not in rows["peak-case1-before"].reason
    assert rows["periodic-case1-before"].verdict == "matched after calibration"
    found["basis"] = "assumed"
    rows = {r.key: r for r in model_rows({"cases": {"case1": found}, "stiff": None})}
    assert {r.verdict for r in rows.values()} == {"not checkable"}


def test_motions_are_compared_with_the_text() -> None:
    before = part({0.3: "period-1", 0.35: "period-2", 0.45: "chaotic"}, 0.3)
    after = part({0.3: "period-1", 0.35: "chaotic", 0.45: "period-5"}, 0.2)
    rows = {r.key: r for r in model_rows({"cases": {"case4": case(before, after, "calibrated")}, "stiff": None})}
    assert rows["motion-case4-before-0.3"].verdict == "matched after calibration"
    assert rows["motion-case4-before-0.45"].verdict == "matched after calibration"
    assert rows["motion-case4-after-0.3"].verdict == "not checkable"
    assert rows["motion-case4-after-0.45"].verdict == "not checkable"


def test_what_could_not_be_computed_is_said() -> None:
    nothing = state_numbers({"stiffness": None})
    found = case(part({0.45: "chaotic"}, 0.3), part({0.45: "period-10"}, 0.2), "calibrated")
    found["states"]["after"] = nothing
    found["failures"] = ["case4, after sweeps: too stiff"]
    rows = {r.key: r for r in model_rows({"cases": {"case4": found}, "stiff": None})}
    assert rows["peak-case4-after"].verdict == "not checkable"
    assert "gave no value" in rows["peak-case4-after"].reason
    assert learned("case4", found)[-1] == "Not computed: case4, after sweeps: too stiff."


@pytest.mark.parametrize(("rates", "verdict"), [([100.2, 99.8], "reproduced"), ([100.2, 12.0], "contradicted")])
def test_the_stiff_bearing_limit_needs_its_rate(rates: list[float], verdict: str) -> None:
    stiff = {"rates": rates, "stiff": [{"median_difference": 1e-8}], "pair": "p"}
    assert [r.verdict for r in model_rows({"cases": {}, "stiff": stiff})] == [verdict]


def test_the_stiff_bearing_limit_that_failed_is_no_verdict() -> None:
    (row,) = model_rows({"cases": {}, "stiff": None})
    assert (row.key, row.verdict) == ("stiff-bearings", "not checkable")


def test_frequencies_of_the_paper_are_in_the_sweeps() -> None:
    for name in CASES:
        for state in ("before", "after"):
            grid = Plan(points=5).frequencies(name, state)
            assert set(paper_frequencies(name, state)) <= set(grid.tolist())
    assert paper_frequencies("case3", "after") == (0.6, 1.1, 1.95, 2.1, 2.3)


@pytest.mark.parametrize("name", CASES)
def test_a_case_stands_for_the_calibrated_file_where_there_is_one(name: str) -> None:
    found = subject(name)
    assert found.basis == ("calibrated" if f"{name}-calibrated" in case_names() else "assumed")
    assert found.file == name + ("-calibrated" if found.basis == "calibrated" else "")
    assert set(found.pair.states) >= {"before", "after"}


def test_the_paragraph_is_made_from_the_numbers() -> None:
    before = part({0.5: "period-1", 1.0: "chaotic", 1.1: "chaotic"}, 0.3)
    found = case(before, part({0.5: "period-1", 1.0: "period-2", 1.1: "period-1"}, 0.2), "assumed")
    found["moves"] = [
        {"kind": "fold", "period_multiple": 1, "before": [0.91, 1.02], "after": [], "turns": {"value": 0.4, "frequency_ratio": 0.98}},  # noqa: E501
        {"kind": "period-doubling", "period_multiple": 1, "before": [2.2], "after": [2.1], "turns": None},
    ]  # fmt: skip
    found["least"] = {
        "value": 0.25, "sentence": "Beyond modification 0.25 nothing doubles.",
        "checks": {"continuation": {"agrees": True}, "time_domain": {"agrees": None}},
    }  # fmt: skip
    text = " ".join(learned("case3", found))
    for words in (
        "from 0.6000 at 1.500 to 0.4000 at 1.500 (-33.3 %)",
        "chaos at 1.000 to 1.100",
        "period-2 at 1.000",
        "the jumps at 0.9100, 1.0200 vanish (their curve turns at amount 0.400, ratio 0.980)",
        "the doubling at 2.2000 moves to 2.1000",
        "25.0 % of the modification would have sufficed against doublings (confirmed on both sides by continuation)",
    ):
        assert words in text
