"""Switching at period-doublings and branch points by every method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, HarmonicBalance, NoConvergence, Shooting, switch, trace
from continuation.branches import switching
from continuation.branches.deflation import deflated
from continuation.branches.newton import Metric, correct, size_of

METHOD = HarmonicBalance()
METHODS = [HarmonicBalance(), Shooting(), Shooting(segments=1), Collocation()]


def follow(system, parameter, span, method=METHOD, **options):
    problem = method.discretise(system, parameter)
    return trace(problem, problem.guess(**{parameter: span[0]}), span, **options)


def only(branch, kind):
    (point,) = [q for q in branch.special_points if q.kind == kind]
    return point


@pytest.fixture(scope="module")
def parent():
    return follow(rs.double_well(), "g", (0.264, 0.267))


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_every_method_reaches_the_doubled_branch(method):
    doubling = only(follow(rs.double_well(), "g", (0.264, 0.267), method), "period-doubling")
    assert doubling.parameter == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS[0], abs=1e-10)
    branch = switch(doubling, (doubling.parameter, 0.288))
    assert branch.period_multiple == 2
    assert only(branch, "period-doubling").parameter == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS[1], abs=1e-10)
    assert branch.unresolved == ()


def test_amplitude_of_the_doubled_orbits_grows_like_a_square_root(parent):
    """Of half the difference of an orbit from itself one excitation period later; slope within the next order."""
    doubling = only(parent, "period-doubling")
    branch = switch(doubling, (doubling.parameter, doubling.parameter + 1e-4), max_step=5e-6)
    distance = branch.parameter - doubling.parameter
    size = np.array([abs(o.evaluate(0.0) - o.evaluate(2 * np.pi)).max() for o in branch.orbits])
    assert distance.min() > 0
    slope = np.polyfit(np.log(distance[3:]), np.log(size[3:]), 1)[0]
    assert slope == pytest.approx(0.5, abs=0.01)


def test_span_is_that_of_the_parent_unless_given(parent):
    branch = switch(only(parent, "period-doubling"))
    assert branch.stop == "reached g = 0.267"


@pytest.mark.parametrize("step", [1e-5, 1e-3])
def test_never_back_on_the_parent(parent, step):
    """Newton's method at a fixed parameter beside the point falls back from the first orbits of the new branch."""
    doubling = only(parent, "period-doubling")
    branch = switch(doubling, (0.262, 0.268), step=step)
    assert all(abs(o.evaluate(0.0) - o.evaluate(2 * np.pi)).max() > 1e-5 for o in branch.orbits)

    problem, u = doubling.problem.doubled(doubling.node.u)
    leaving = switching.departure(doubling, switching.Limits.of((0.262, 0.268), None, None, 100))
    p, fixed = doubling.parameter + 2e-4, (np.zeros_like(u), 1.0)
    metric = Metric(size_of(u), 1.0)
    beside = correct(problem, (u, p), fixed, metric).u
    start = beside + 1e-3 * leaving.direction[0]
    plain = correct(problem, (start, p), fixed, metric).u
    assert abs(plain - beside).max() < 1e-9  # the parent again
    other = problem.waveform(deflated(problem, start, p, [beside]), p, 64)
    assert abs(other[:32] - other[32:]).max() > 1e-2


@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting(), Collocation()], ids=repr)
def test_deflation_alone_starts_the_branch(method, monkeypatch):
    """As when every attempt beside the point went astray."""
    doubling = only(follow(rs.double_well(), "g", (0.264, 0.267), method), "period-doubling")
    monkeypatch.setattr(switching, "_FIRST", ())
    branch = switch(doubling, (0.265, 0.2670))
    assert all(abs(o.evaluate(0.0) - o.evaluate(2 * np.pi)).max() > 1e-4 for o in branch.orbits)
    assert branch.parameter[-1] == pytest.approx(0.267, abs=1e-12)


def test_deflation_finds_all_three_orbits_of_a_duffing_resonance():
    problem = HarmonicBalance(harmonics=15).discretise(rs.duffing(), "omega")
    known = [problem.unknown(problem.guess(omega=1.2))]
    rng = np.random.default_rng(1)
    for _ in range(30):
        try:
            known.append(deflated(problem, known[0] * rng.uniform(0.1, 6.0), 1.2, known))
        except NoConvergence:
            continue
    assert len(known) == 3
    branch = follow(rs.duffing(), "omega", (0.9, 1.4))
    near = [problem.solve(o, 1.2) for o in branch.orbits if abs(o.value - 1.2) < 0.04]
    wanted = sorted({round(o.rms("x"), 6) for o in near})
    assert len(wanted) == 3
    found = [problem.orbits([(u, 1.2, 0.0)])[0].rms("x") for u in known]
    assert sorted(found) == pytest.approx(wanted, abs=2e-6)


# ------------------------------------------------------------------------------------------------ branch points
@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting(), Collocation()], ids=repr)
def test_symmetric_system_has_a_branch_point(method):
    parent = follow(rs.cubic(), "g", (2.3, 3.0), method)
    point = only(parent, "branch-point")
    assert point.parameter == pytest.approx(2.608168614, abs=2e-9)
    branch = switch(point, (2.3, 3.0))
    assert branch.period_multiple == 1
    # both halves leave, and are mirror images of each other: x -> -x half a period later
    left, right = branch.orbits[0], branch.orbits[-1]
    assert left.value == right.value == pytest.approx(3.0, abs=1e-12)
    assert left.mean("x") == pytest.approx(-right.mean("x"), rel=1e-6)
    assert abs(left.mean("x")) > 0.1
    phases = np.linspace(0, 2 * np.pi, 7)
    assert left.evaluate(phases) == pytest.approx(-right.evaluate(phases + np.pi), abs=1e-6)
    assert {q.kind for q in branch.special_points} == set()
    # and the means vanish like a square root towards the point
    means = np.array([o.mean("x") for o in branch.orbits])
    close = np.abs(branch.parameter - point.parameter) < 0.05
    ratio = means[close] ** 2 / (branch.parameter[close] - point.parameter)
    assert np.ptp(ratio) < 0.15 * ratio.mean()


def test_broken_symmetry_has_none():
    branch = follow(rs.cubic(0.02), "g", (2.3, 3.0))
    assert branch.special_points == ()
    assert branch.unresolved == ()


# ------------------------------------------------------------------------------------------------ contact
def test_doubled_branch_of_the_gear_pair_joins_two_doublings():
    """It rises vertically, neutral while contact is kept, at both its ends; no fold is claimed there."""
    parent = follow(rs.gear(), "frequency_ratio", (1.5, 1.2))
    first, second = [q for q in parent.special_points if q.kind == "period-doubling"]
    there = switch(first, (0.9, 1.6))
    back = switch(second, (0.9, 1.6))
    wanted = [1.1469848870, 1.0355410930, 1.0356147570]
    for branch, other in ((there, second), (back, first)):
        found = [q.parameter for q in branch.special_points if q.kind != "grazing"]
        assert sorted(found) == pytest.approx(sorted(wanted), abs=1e-8)
        assert [q.kind for q in branch.special_points].count("fold") == 1
        assert branch.parameter[-1] == pytest.approx(other.parameter, abs=1e-6)
        assert "met the branch of period 1" in branch.stop
        assert all("neutral" in note for note in branch.unresolved)
        moving = np.abs(branch.parameter - first.parameter) > 1e-6
        assert "undecided" not in branch.stability[moving & (np.abs(branch.parameter - second.parameter) > 1e-6)]


# ------------------------------------------------------------------------------------------------ misuse
def test_misuse_is_refused(parent):
    doubling = only(parent, "period-doubling")
    fold = follow(rs.duffing(), "omega", (1.1, 1.4)).special_points[0]
    with pytest.raises(ValueError, match="expected a period-doubling or a branch point, got a fold"):
        switch(fold, (1.1, 1.4))
    with pytest.raises(ValueError, match="loaded from a file"):
        switch(replace(doubling, problem=None, node=None), (0.26, 0.27))
    with pytest.raises(ValueError, match="does not contain"):
        switch(doubling, (0.27, 0.28))
    with pytest.raises(ValueError, match="leaves the span"):
        switch(doubling, (0.26, doubling.parameter))
