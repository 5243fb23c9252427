"""Trees of branches: every branch once, links where one is met again, notes on what was not followed."""

from __future__ import annotations

import json

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, Shooting, explore, find_isolas, trace
from continuation.branches.arclength import start_node
from continuation.branches.newton import Metric
from continuation.branches.recognition import Library, Match

GEAR_SPAN = (1.5, 1.0)


@pytest.fixture(scope="module")
def symmetric():
    problem = HarmonicBalance().discretise(rs.cubic(), "g")
    return explore(problem, (2.0, 7.0), depth=2)


def test_symmetric_system_breaks_symmetry_then_doubles(symmetric):
    """Two mirror images double at one parameter value; the branch of the second is the mirror image of the first's."""
    assert [(m.parent, m.depth, m.branch.period_multiple) for m in symmetric.limbs] == [
        (None, 0, 1),
        (0, 1, 1),
        (1, 2, 2),
    ]
    assert [m.point and m.point.kind for m in symmetric.limbs] == [None, "branch-point", "period-doubling"]
    first, second = (q.parameter for q in symmetric.branches[1].special_points)
    assert first == pytest.approx(second, abs=1e-8)
    (link,) = symmetric.links
    assert (link.number, link.target, link.likeness) == (1, 2, "mirror image")
    assert symmetric.notes == ()


def test_broken_symmetry_has_doublings_only():
    tree = explore(HarmonicBalance().discretise(rs.cubic(0.02), "g"), (2.0, 7.0), depth=1)
    assert [m.point and m.point.kind for m in tree.limbs] == [None, "period-doubling"]
    assert tree.links == ()


def test_summaries(symmetric):
    text = str(symmetric)
    assert text.startswith("Tree of 3 branches")
    assert "leads to the mirror image of branch 2" in text
    table = json.loads(json.dumps(symmetric.to_dict()))
    assert [b["parent"] for b in table["branches"]] == [None, 0, 1]
    assert table["links"][0]["target"] == 2


@pytest.mark.parametrize("start", [None, 1.25])
def test_gear_pair_one_branch_joins_two_doublings(start):
    """Met from its other end, the doubled branch is a link, not a second branch."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    tree = explore(problem, GEAR_SPAN, start=start and problem.guess(frequency_ratio=start), depth=1)
    assert [m.branch.period_multiple for m in tree.limbs] == [1, 2]
    (link,) = tree.links
    assert (link.target, link.likeness) == (1, "same")
    ends = {tree.limbs[1].point.parameter, link.point.parameter}
    assert sorted(ends) == pytest.approx(sorted(rs.GEAR_DOUBLINGS[:2]), abs=1e-9)


def test_depth_and_period_limit():
    problem = Shooting().discretise(rs.double_well(), "g")
    assert len(explore(problem, (0.262, 0.29), depth=0)) == 1
    tree = explore(problem, (0.262, 0.29), depth=3, max_period=2)
    assert [b.period_multiple for b in tree.branches] == [1, 2]
    (note,) = tree.notes
    assert "period 4 is above the limit 2" in note
    with pytest.raises(ValueError, match="depth"):
        explore(problem, (0.262, 0.29), depth=-1)


@pytest.mark.parametrize("stage", ["branch 0", "branch 1"])
def test_interrupted_tree_keeps_what_is_finished(stage):
    def interrupt(done: float, text: str) -> None:
        if text.startswith(stage) and "10 orbits" in text:
            raise KeyboardInterrupt

    tree = explore(HarmonicBalance().discretise(rs.double_well(), "g"), (0.262, 0.29), depth=2, progress=interrupt)
    assert len(tree) == (1 if stage == "branch 0" else 2)
    assert "interrupted" in tree.branches[-1].stop
    assert any("interrupted" in note for note in tree.notes)


# ------------------------------------------------------------------------------------------------ recognition
def test_points_of_a_branch_are_recognised_and_others_are_not():
    """All three orbits at one frequency, and shifted by half a period, which a driven system does not allow."""
    problem = HarmonicBalance().discretise(rs.duffing(), "omega")
    branch = trace(problem, problem.guess(omega=0.9), (0.9, 1.4))
    low = trace(problem, problem.guess(omega=0.9), (0.9, 1.1))
    library = Library(autonomous=False)
    library.add(branch)
    only_low = Library(autonomous=False)
    only_low.add(low)
    for orbit in branch.orbits[::9]:
        node = start_node(problem, problem.unknown(orbit), orbit.value, Metric(1.0, 0.5))
        assert library.find(problem, node) == Match(0, "same")
        if orbit.value > 1.1:
            assert only_low.find(problem, node) is None


def test_a_closed_curve_is_walked_once_and_recognised():
    problem = HarmonicBalance().discretise(rs.detached_resonance(0.015), "omega")
    main = trace(problem, problem.guess(omega=0.9), (0.9, 1.1))
    (isola,) = find_isolas(problem, [main], (0.9, 1.1), slices=[1.0], starts=12).isolas
    turns = [q for q in isola.special_points if q.kind == "fold"]
    assert len(turns) == 2
    # its ends are one orbit, and the way round visits every frequency twice
    assert isola.orbits[0].value == pytest.approx(isola.orbits[-1].value, abs=1e-12)
    assert isola.orbits[0].evaluate(0.3) == pytest.approx(isola.orbits[-1].evaluate(0.3), abs=1e-9)
    p = isola.parameter
    for value in np.linspace(turns[0].parameter, turns[1].parameter, 7)[1:-1]:
        assert np.count_nonzero((p[:-1] - value) * (p[1:] - value) < 0) == 2
    # started elsewhere on it, the tree is that one curve again
    tree = explore(problem, (0.9, 1.1), start=isola.orbits[len(isola) // 3], depth=1)
    assert len(tree) == 1
    assert tree.branches[0].stop.startswith("closed")
    again = sorted(q.parameter for q in tree.branches[0].special_points)
    assert again == pytest.approx(sorted(q.parameter for q in isola.special_points), abs=1e-8)
