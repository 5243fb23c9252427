"""Floquet reports made by hand: the walk along a branch, the numbers, and one set of numbers in text and figure."""

from __future__ import annotations

import dataclasses
import math
import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from synthetic_branch import folded_branch, make_orbit, make_point

from continuation import Certificate
from continuation.branches.branch import Branch
from continuation.orbits.orbit import Orbit, Stability
from sbg_casadi.agreement import contact_difference, decide
from sbg_casadi.coexisting import Change, Crossing, branch_nodes, surroundings
from sbg_casadi.report import as_text, ratio
from sbg_casadi.stability_figure import (
    contact_intervals,
    multiplier_marks,
    phase_plane,
    plot_multipliers,
    plot_phase_plane,
    plot_waveform,
    stability_figure,
)
from sbg_casadi.stability_numbers import contact_rows, contact_shares, multiplier_rows, unstable_types
from sbg_casadi.stability_report import stability_report

UNSTABLE = (1.7, 0.1)


# -------------------------------------------------------------------------------------------- along a branch
def branch_of(*orbits: Orbit, points: tuple = ()) -> Branch:
    return dataclasses.replace(folded_branch(), orbits=orbits, special_points=points)


def told(changes: list[Change]) -> list[tuple[str, float, str]]:
    return [(c.kind, c.parameter, c.beyond) for c in changes]


def test_a_fold_bounds_both_of_its_sheets() -> None:
    branch = folded_branch()
    assert [n.value if isinstance(n, Orbit) else n.kind for n in branch_nodes(branch)] == [1.0, 1.2, "fold", 1.25, 1.1]
    lower_sheet = surroundings(branch, Crossing(make_orbit(1.22), 1))
    assert told(lower_sheet["higher"]) == [("fold", 1.3, "unstable")]
    assert lower_sheet["lower"] == []
    unstable = make_orbit(1.2, stability="unstable", multipliers=UNSTABLE)
    upper_sheet = surroundings(branch, Crossing(unstable, 3))
    assert told(upper_sheet["higher"]) == [("fold", 1.3, "stable")]
    assert upper_sheet["lower"] == []


def test_two_doublings_inside_one_step_are_counted_one_after_the_other() -> None:
    def at(value: float) -> Orbit:
        return make_orbit(value, stability="undecided", multipliers=(-1.0, 0.1))

    points = (make_point("period-doubling", at(1.03), 0), make_point("period-doubling", at(1.07), 0))
    branch = branch_of(make_orbit(1.0), make_orbit(1.1), points=points)
    stable = surroundings(branch, Crossing(make_orbit(1.02), 0))
    assert told(stable["higher"]) == [("period-doubling", 1.03, "unstable")]  # the nearer one, and what is behind it
    between = make_orbit(1.05, stability="unstable", multipliers=(-1.2, 0.1))
    both = surroundings(branch, Crossing(between, 1))
    assert told(both["lower"]) == [("period-doubling", 1.03, "stable")]
    assert told(both["higher"]) == [("period-doubling", 1.07, "stable")]


def test_an_unstable_orbit_is_followed_through_further_points_to_where_stability_is_regained() -> None:
    twice = make_orbit(1.2, stability="unstable", multipliers=(1.7, -1.3))
    points = (
        make_point("period-doubling", make_orbit(1.15, stability="undecided", multipliers=(1.6, -1.0)), 0),
        make_point("fold", make_orbit(1.3, stability="undecided", multipliers=(1.0, -1.4)), 1),
        make_point("period-doubling", make_orbit(1.1, stability="undecided", multipliers=(-1.0, 0.1)), 2),
    )
    once = make_orbit(1.2, stability="unstable", multipliers=(0.1, -1.3))
    ends = make_orbit(1.0, stability="unstable", multipliers=UNSTABLE), make_orbit(1.0)
    branch = branch_of(ends[0], twice, once, ends[1], points=points)
    found = surroundings(branch, Crossing(make_orbit(1.25, stability="unstable", multipliers=(1.6, -1.2)), 2))
    assert told(found["higher"]) == [("fold", 1.3, "unstable"), ("period-doubling", 1.1, "stable")]
    assert [c.around_fold for c in found["higher"]] == [False, True]
    assert told(found["lower"]) == [("period-doubling", 1.15, "unstable")]


def test_a_change_that_no_point_explains_is_reported_and_never_passed_over() -> None:
    orbits = make_orbit(1.0), make_orbit(1.1), make_orbit(1.2, stability="unstable", multipliers=UNSTABLE)
    (change,) = surroundings(branch_of(*orbits), Crossing(make_orbit(1.05), 0))["higher"]
    assert told([change]) == [("unexplained change", 1.2, "unstable")]
    assert (change.status, change.error) == ("guessed", pytest.approx(0.1))
    assert "no located point explains" in change.note


def test_undecided_orbits_carry_no_information_and_give_no_false_verdict() -> None:
    doubtful = make_orbit(1.1, stability="undecided", multipliers=(1.0, 0.1))
    orbits = make_orbit(1.0), doubtful, make_orbit(1.2)
    assert surroundings(branch_of(*orbits), Crossing(make_orbit(1.05), 0)) == {"lower": [], "higher": []}
    point = make_point("period-doubling", make_orbit(1.05, stability="undecided", multipliers=(-1.0, 0.1)), 0)
    (change,) = surroundings(branch_of(make_orbit(1.0), doubtful, points=(point,)), Crossing(make_orbit(1.02), 0))[
        "higher"
    ]
    assert change.beyond == "unstable"  # by counting: one of two multipliers crosses
    (change,) = surroundings(branch_of(make_orbit(1.0), doubtful, points=(point,)), Crossing(doubtful, 0))["higher"]
    assert change.beyond == "undecided"


# -------------------------------------------------------------------------------------------- verdict
def certificate(stability: Stability, reason: str) -> Certificate:
    orbit = make_orbit(1.0)
    return Certificate(orbit, orbit.multipliers, orbit.multiplier_error, {}, {}, {}, 0.0, 0.0, stability, reason)


@pytest.mark.parametrize("stability", ["stable", "unstable", "undecided"])
def test_the_verdict_is_that_of_the_certificate(stability: Stability) -> None:
    judged = certificate(stability, f"{stability}: because of this")
    assert decide(1.0, judged, {"lower": [], "higher": []}) == (stability, "because of this")


def test_a_frequency_within_the_error_of_a_point_is_undecided() -> None:
    judged = certificate("stable", "stable: far inside")
    near = Change("fold", 1.0 + 1e-11, 2e-11, "unstable", "located", "", False)
    result, reason = decide(1.0, judged, {"lower": [], "higher": [near]})
    assert (result, "within the error of the fold" in reason) == ("undecided", True)
    far = dataclasses.replace(near, parameter=1.0 + 3e-11)
    assert decide(1.0, judged, {"lower": [], "higher": [far]}) == ("stable", "far inside")


def test_contact_phases_are_compared_around_the_cycle() -> None:
    def touching(phases: list[float], modes: list[int]) -> Orbit:
        return dataclasses.replace(make_orbit(1.0), contacts={"mesh": (np.array(phases), np.array(modes))})

    one = touching([1e-6, 2.0], [2, 1, 2])
    same = touching([2.0, 2 * np.pi - 1e-6], [1, 2, 1])
    assert contact_difference(one, same) == pytest.approx(np.degrees(2e-6), rel=1e-6)
    assert contact_difference(one, touching([], [2])) is None
    assert contact_difference(touching([], [2]), touching([], [1])) is None
    swapped = touching([1e-6, 2.0], [1, 2, 1])  # free where the other drives: the same sequence, far apart
    assert contact_difference(one, swapped) == pytest.approx(np.degrees(2.0), rel=1e-5)


# -------------------------------------------------------------------------------------------- numbers
def test_time_constants_are_those_of_powers_of_the_multiplier() -> None:
    mu = np.array([-1.5, 0.6 + 0.6j, 0.6 - 0.6j, 0.0])
    growing, pair, dead = multiplier_rows(mu, np.array([1e-4, 1e-5, 2e-5, 1e-6]), 0.25)
    assert 1.5 ** growing["mesh_periods"] == pytest.approx(math.e)
    assert abs(0.6 + 0.6j) ** pair["mesh_periods"] == pytest.approx(1 / math.e)
    assert (growing["grows"], pair["grows"], dead["grows"]) == (True, False, False)
    assert np.exp(complex(*growing["exponent"])) == pytest.approx(-1.5)
    assert np.exp(0.25 * complex(*pair["exponent_per_second"])) == pytest.approx(0.6 + 0.6j)
    assert (pair["error"], pair["pair"]) == (2e-5, True)  # the larger bar of the two
    assert dead["exponent"] is None
    assert (dead["mesh_periods"], dead["exponent_error"]) == (0.0, None)


@pytest.mark.parametrize("size", [0.3, 0.99, 1.2])
def test_errors_of_exponent_and_time_bound_every_multiplier_within_its_bar(size: float) -> None:
    bar = 5e-3
    (row,) = multiplier_rows(np.array([size + 0j]), np.array([bar]), None)
    for other in np.linspace(size - bar, size + bar, 21).tolist():
        (moved,) = multiplier_rows(np.array([other + 0j]), np.zeros(1), None)
        assert abs(moved["exponent"][0] - row["exponent"][0]) <= row["exponent_error"] * (1 + 1e-9)
        assert abs(moved["mesh_periods"] - row["mesh_periods"]) <= row["mesh_periods_error"] * (1 + 1e-9)


def test_a_bar_over_the_unit_circle_leaves_the_time_unbounded() -> None:
    for size in (0.999, 1.0, 1.001):
        (row,) = multiplier_rows(np.array([size + 0j]), np.array([2e-3]), None)
        assert row["mesh_periods_error"] is None
        assert unstable_types([row]) == []


def test_types_of_instability() -> None:
    mu = np.array([1.3, -1.2, 0.9 + 0.9j, 0.9 - 0.9j, 0.5])
    found = unstable_types(multiplier_rows(mu, np.full(5, 1e-6), None))
    assert sorted((f["type"], f["through"]) for f in found) == [
        ("fold", "+1"),
        ("neimark-sacker", "a complex pair"),
        ("period-doubling", "-1"),
    ]


def test_contact_intervals_cover_the_cycle_once() -> None:
    rows = contact_rows(np.array([0.5, 1.5, 4.0, 4.5]), np.array([1, 2, 1, 0, 1]))
    assert [r["flank"] for r in rows] == ["drive", "free", "coast", "free"]
    assert sum(r["share"] for r in rows) == pytest.approx(1.0, abs=1e-15)
    assert contact_shares(rows)["coast"] == pytest.approx(0.5 / (2 * np.pi))
    assert rows[-1]["to_deg"] == rows[0]["from_deg"] + 360
    assert contact_rows(np.array([]), np.array([2])) == [
        {"flank": "drive", "from_deg": 0.0, "to_deg": 360.0, "share": 1.0}
    ]


# -------------------------------------------------------------------------------------------- text and figure
def document(**more: Any) -> dict[str, Any]:
    """Return a stability document of a physical pair whose orbit touches both flanks."""
    phase = np.linspace(0.0, 360.0, 721)
    wave = 1.5 * np.cos(np.radians(phase))
    change = {
        "kind": "fold", "frequency_ratio": 0.61, "error": 1e-10, "distance": 0.06, "pinion_rpm": 6100.0,
        "distance_rpm": 600.0, "beyond": "unstable", "status": "located", "note": "", "around_fold": False,
    }  # fmt: skip
    edge = math.degrees(math.acos(1 / 1.5))
    rows = contact_rows(np.radians([edge, 180 - edge, 180 + edge, 360 - edge]), np.array([2, 1, 0, 1, 2]))
    lengths = {"rms": 1.06066, "mean": 0.0, "least": -1.5, "largest": 1.5, "peak_to_peak": 3.0}
    mu = np.array([0.8 + 0.4j, 0.8 - 0.4j, -0.3])
    return {
        "schema": 1, "pair": "hand", "state": "before", "reading": "printed", "frequency_ratio": 0.55,
        "pinion_rpm": 5500.0, "mesh_period_seconds": 1e-3, "mesh_frequency_hertz": 1000.0, "range": [0.3, 2.6],
        "orbits": [
            {"branch": k, "rms": 0.1 * k, "least": -1.0, "largest": 1.0, "stability": s, "leading_multiplier": [m, 0.0]}
            for k, s, m in ((1, "stable", 0.8), (2, "unstable", 1.7))
        ],
        "branch": 1, "stability": "stable", "reason": "every multiplier lies inside", "instabilities": [],
        "multipliers": multiplier_rows(mu, np.array([0.05, 0.05, 1e-6]), 1e-3),
        "around": {"lower": [], "higher": [change]}, "nearest": change | {"direction": "higher"},
        "lambda": lengths, "micrometres": {k: 50 * v for k, v in lengths.items()},
        "deflection": {"least": -1.5, "largest": 1.5}, "harmonics_kept": 15, "waveform_error": 2e-8,
        "contact": rows, "contact_shares": contact_shares(rows),
        "harmonics": [{"order": 1, "amplitude": 1.5, "phase_deg": 0.25}],
        "dynamic_factor": 3.25, "mesh_force": {"mean": 0.2, "largest": 0.65, "least": -0.1},
        "mesh_force_newton": {"mean": 200.0, "largest": 650.0, "least": -100.0},
        "agreement": {
            "multipliers": {"Hill, strip": 7e-9, "shooting": None}, "waveform": 4e-9, "expected": 5e-9,
            "contact_deg": 6e-9, "missing": {"Hill, symmetric": "too many rows"}, "liouville": 1e-12,
            "contact_defect_deg": 2e-13,
        },
        "waveform": {"phase_deg": phase.tolist(), "lambda": wave.tolist(), "deflection": wave.tolist(),
                     "rate": (-1.5 * np.sin(np.radians(phase))).tolist()},
        "assumed": [], "unresolved": [], "failures": [],
    } | more  # fmt: skip


def unwrapped(text: str) -> str:
    """Return a text without line breaks."""
    return " ".join(text.split())


def test_the_text_shows_the_numbers_of_the_document() -> None:
    d = document(unresolved=["between 1 and 2"], failures=["shooting failed"])
    text = as_text(stability_report(d))
    for words in (
        "equations in the reading printed", "FINISHED IN PART: shooting failed", "--branch 1 to 2 chooses",
        "nearest instability: fold (jump) at 0.6100000000 +- 1.0e-10", "+0.0600000000 in frequency ratio, +600 rpm",
        "dynamic factor 3.250000", "largest 650.0, mean 200.0, least -100.0 N", "Mesh frequency 1000.0 Hz",
        "unresolved on the branch: between 1 and 2", "peak to peak 150.0000 um", "contact phases 6.0e-09 deg",
        "none in the traced range",
        "Hill, strip: largest difference of a multiplier 7.0e-09", "shooting: largest difference of a multiplier -",
        "Hill, symmetric: not available, too many rows", "waveform of lambda 4.0e-09 (stated errors together 5.0e-09)",
        "Liouville's determinant 1.0e-12 in the logarithm, contact phases of the integration 2.0e-13 deg",
    ):  # fmt: skip
        assert words in unwrapped(text), words
    for row in d["multipliers"]:
        line = next(s for s in text.splitlines() if f"{row['multiplier'][0]:.8f}" in s and f"{row['modulus']:.8f}" in s)
        assert f"{row['mesh_periods']:.6g}" in line
    for row in d["contact"]:
        pattern = rf"{row['flank']} +{row['from_deg']:.4f} +{row['to_deg']:.4f} +{100 * row['share']:.4f}"
        assert re.search(pattern, text)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"nearest": None, "around": {"lower": [], "higher": []}}, "no change of stability on the branch between 0.3"),
        ({"stability": "unstable"}, "nearest point where stability is regained: fold"),
        ({"stability": "undecided"}, "nearest special point: fold"),
        (
            {"mesh_frequency_hertz": None, "mesh_period_seconds": None, "pinion_rpm": None},
            "frequency ratio 0.55, exact",
        ),
    ],
)
def test_the_text_says_what_is_not_there(more: dict[str, Any], words: str) -> None:
    assert words in unwrapped(as_text(stability_report(document(**more))))


def test_guessed_points_and_ways_around_a_fold_are_named() -> None:
    d = document()
    d["nearest"] |= {"status": "guessed", "note": "more harmonics are needed", "around_fold": True}
    text = unwrapped(as_text(stability_report(d)))
    assert "guessed, not located: more harmonics are needed; reached only around a fold" in text
    assert ratio(0.61) in text


def lines(ax: Axes, gid: str) -> list[Line2D]:
    return [line for line in ax.get_lines() if line.get_gid() == gid]


def test_the_unit_circle_shows_every_multiplier_and_the_bars_that_can_be_seen() -> None:
    d = document(
        multipliers=multiplier_rows(np.array([1.4, 0.8 + 0.4j, 0.8 - 0.4j]), np.array([1e-6, 0.05, 0.05]), None)
    )
    values, bars = multiplier_marks(d)
    assert values.tolist() == [1.4, 0.8 + 0.4j, 0.8 - 0.4j]
    assert bars.tolist() == [1e-6, 0.05, 0.05]
    ax = plot_multipliers(d)
    (inside,), (outside,) = lines(ax, "inside"), lines(ax, "outside")
    assert inside.get_ydata().tolist() == [0.4, -0.4]
    assert outside.get_xdata().tolist() == [1.4]
    assert outside.get_markerfacecolor() == "white"
    circles = [p for p in ax.patches if p.get_gid() == "error bar"]
    assert [c.get_radius() for c in circles] == [0.05, 0.05]
    assert [p.get_radius() for p in ax.patches if p.get_gid() == "unit circle"] == [1.0]


def test_the_phase_plane_is_cut_at_the_contact_limits() -> None:
    d = document()
    pieces = phase_plane(d)
    assert [flank for flank, _, _ in pieces] == ["drive", "free", "coast", "free", "drive"]
    for (_, x, v), (_, y, w) in pairwise(pieces):
        assert x[-1] == y[0]
        assert abs(x[-1]) == 1.0
        assert v[-1] == w[0] == pytest.approx(math.copysign(math.sqrt(1.25), v[-1]), abs=1e-4)
    ax = plot_phase_plane(d)
    assert len(lines(ax, "free")) == 2
    assert [line.get_xdata()[0] for line in lines(ax, "contact limit")] == [-1.0, 1.0]
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["drive", "free", "coast"]


def test_the_waveform_is_shaded_where_there_is_no_drive_contact() -> None:
    d = document()
    ax = plot_waveform(d)
    (wave,) = lines(ax, "lambda")
    np.testing.assert_array_equal(wave.get_ydata(), d["waveform"]["lambda"])
    shaded = {g: [p.get_x() for p in ax.patches if p.get_gid() == g] for g in ("free", "coast", "drive")}
    starts = {g: [start for flank, start, _ in contact_intervals(d) if flank == g] for g in ("free", "coast")}
    assert shaded == starts | {"drive": []}
    assert sum(end - start for _, start, end in contact_intervals(d)) == pytest.approx(360.0, abs=1e-9)


def test_the_figure_has_the_three_plots() -> None:
    figure = stability_figure(document())
    assert len(figure.axes) == 3
    assert figure.get_suptitle() == "hand, before: orbit 1 of 2 at frequency ratio 0.55, stable"
