"""What is drawn is what the branch holds: segments, markers and styles, read back from the artists."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from synthetic_branch import folded_branch, make_orbit, make_point

from continuation.branches.branch import Branch
from continuation.plotting import (
    LINE_STYLE,
    MARKER,
    branch_markers,
    branch_segments,
    new_axes,
    plot_branch,
    plot_sweep,
    sweep_direction,
)
from continuation.timedomain.sweep import Sweep


def lines(ax: Axes, gid: str) -> list[Line2D]:
    return [line for line in ax.get_lines() if line.get_gid() == gid]


def branch_of(*orbits: object, points: tuple = ()) -> Branch:
    return dataclasses.replace(folded_branch(), orbits=orbits, special_points=points)


def test_a_branch_is_cut_exactly_at_its_fold() -> None:
    branch = folded_branch()
    stable, unstable = branch_segments(branch, "x")
    assert (stable.stability, unstable.stability) == ("stable", "unstable")
    assert stable.x.tolist() == [1.0, 1.2, 1.3]
    assert unstable.x.tolist() == [1.3, 1.25, 1.1]
    tip = branch.special_points[0].orbit.rms("x")
    assert stable.y[-1] == unstable.y[0] == tip
    np.testing.assert_array_equal(stable.y[:-1], branch.rms("x")[:2])


def test_a_quantity_may_be_any_function_of_an_orbit() -> None:
    branch = folded_branch()
    segments = branch_segments(branch, lambda orbit: orbit.extremes("x")[1])
    assert segments[0].y[0] == branch.orbits[0].extremes("x")[1]
    with pytest.raises(ValueError, match="no state 'y'"):
        branch_segments(branch, "y")


def test_a_change_without_a_special_point_is_undecided_and_covers_everything() -> None:
    branch = branch_of(make_orbit(1.0), make_orbit(1.1, stability="undecided"), make_orbit(1.2, stability="unstable"))
    assert [(s.stability, s.x.tolist()) for s in branch_segments(branch, "x")] == [("undecided", [1.0, 1.1, 1.2])]


def test_two_doublings_inside_one_step_leave_an_unstable_piece_between() -> None:
    points = tuple(make_point("period-doubling", make_orbit(w, multipliers=(-1.0, 0.1)), 0) for w in (1.04, 1.06))
    branch = branch_of(make_orbit(1.0), make_orbit(1.1), points=points)
    found = [(s.stability, s.x.tolist()) for s in branch_segments(branch, "x")]
    assert found == [("stable", [1.0, 1.04]), ("unstable", [1.04, 1.06]), ("stable", [1.06, 1.1])]


def test_a_torus_point_then_its_reverse_leave_an_unstable_piece_between() -> None:
    pair = (np.exp(1j), np.exp(-1j), 0.3)
    points = tuple(make_point("neimark-sacker", make_orbit(w, multipliers=pair), 0) for w in (1.04, 1.06))
    ends = (make_orbit(1.0, multipliers=(0.5, 0.4, 0.3)), make_orbit(1.1, multipliers=(0.5, 0.4, 0.3)))
    assert [s.stability for s in branch_segments(branch_of(*ends, points=points), "x")] == [
        "stable",
        "unstable",
        "stable",
    ]


def test_a_grazing_point_changes_nothing_and_a_single_orbit_is_a_segment() -> None:
    graze = make_point("grazing", make_orbit(1.05), 0)
    (segment,) = branch_segments(branch_of(make_orbit(1.0), make_orbit(1.1), points=(graze,)), "x")
    assert segment.x.tolist() == [1.0, 1.05, 1.1]
    (single,) = branch_segments(branch_of(make_orbit(1.0)), "x")
    assert single.x.tolist() == [1.0]


def test_the_artists_carry_the_data_and_the_style_table() -> None:
    branch = folded_branch()
    ax = plot_branch(branch, "x", colour="#d95f02", label="before")
    for segment in branch_segments(branch, "x"):
        (line,) = lines(ax, segment.stability)
        assert line.get_linestyle() == LINE_STYLE[segment.stability]
        np.testing.assert_array_equal(line.get_xydata(), np.column_stack([segment.x, segment.y]))
    (mark,) = lines(ax, "fold")
    assert mark.get_marker() == MARKER["fold"]
    assert mark.get_linestyle() == "None"
    x, y = branch_markers(branch, "x")["fold"]
    np.testing.assert_array_equal(mark.get_xydata(), np.column_stack([x, y]))
    assert {line.get_color() for line in ax.get_lines()} == {"#d95f02"}
    assert ax.get_legend_handles_labels()[1] == ["before"]
    assert ax.get_xlabel() == "omega"
    assert set(branch_markers(branch, "x")) == {"fold"}


def test_kinds_and_verdicts_look_different_without_colour() -> None:
    assert len(set(MARKER.values())) == len(MARKER)
    assert len(set(LINE_STYLE.values())) == len(LINE_STYLE)
    assert (LINE_STYLE["stable"], LINE_STYLE["unstable"], LINE_STYLE["undecided"]) == ("-", "--", ":")


def make_sweep(values: list[float]) -> Sweep:
    k = len(values)
    rms = np.linspace(0.1, 0.2, k)
    rms[-1] = np.nan
    return Sweep(
        system="synthetic",
        parameter="omega",
        quantity="x",
        method="none",
        fixed={},
        state_names=("x", "v"),
        values=np.array(values),
        rms=rms,
        mean=np.zeros(k),
        minimum=np.zeros(k),
        maximum=np.zeros(k),
        period=np.ones(k, dtype=int),
        periods_used=np.ones(k, dtype=int),
        states=np.zeros((k, 2)),
        failures=("",) * k,
    )


def test_sweeps_up_and_down_are_told_apart() -> None:
    ax = new_axes()
    up, down = make_sweep([1.0, 2.0, 3.0]), make_sweep([3.0, 2.0, 1.0])
    assert (sweep_direction(up), sweep_direction(down)) == ("up", "down")
    assert plot_sweep(up, ax=ax) is ax
    plot_sweep(down, ax=ax)
    (one,), (other,) = lines(ax, "sweep up"), lines(ax, "sweep down")
    assert (one.get_marker(), one.get_fillstyle()) != (other.get_marker(), other.get_fillstyle())
    np.testing.assert_array_equal(other.get_xdata(), down.values)
    np.testing.assert_array_equal(one.get_ydata(), up.rms)
    assert one.get_linestyle() == "None"


def test_drawing_needs_no_window_and_no_global_state() -> None:
    ax = plot_branch(folded_branch(), "x")
    ax.figure.canvas.draw()
    assert "matplotlib.pyplot" not in sys.modules or not sys.modules["matplotlib.pyplot"].get_fignums()
