"""Cascades of period-doublings: by every method, how they end, and on a gear pair."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, HarmonicBalance, Shooting, cascade, sweep, trace

METHOD = HarmonicBalance()


def first_doubling(system, parameter, span, method=METHOD):
    problem = method.discretise(system, parameter)
    branch = trace(problem, problem.guess(**{parameter: span[0]}), span)
    return next(q for q in branch.special_points if q.kind == "period-doubling")


@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting(), Collocation()], ids=repr)
def test_every_method_gives_the_same_cascade(method):
    """Further on in tests/literature."""
    found = cascade(first_doubling(rs.double_well(), "g", (0.264, 0.267), method), (0.26, 0.3), max_period=2)
    assert found.periods == (1, 2)
    assert found.parameter == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS[:2], abs=1e-9)
    assert found.ended == "limit"
    assert np.all(found.error < 1e-9)


def returns(doubled, orbit, value):
    """Distances of a stable orbit's state from itself after 1 to 4 excitation periods, settled in the time domain."""
    shooting = Shooting().discretise(rs.gear(), "frequency_ratio", period_multiple=2)
    x = doubled.solve(orbit, value).evaluate(0.0)[0] * (1 + 1e-4)
    x = shooting.integration.settle(x, shooting.vector(value), 300)
    distance, y = [], x
    for _ in range(4):
        y = shooting.integration.settle(y, shooting.vector(value), 1)
        distance.append(float(np.abs(y - x).max()))
    return distance


def check_sweep(doubled, orbits, window, shift):
    """A sweep by fixed steps repeats after 2 periods where the doubled branch is stable, behind its end after 4.

    The window is that between the doubling of the parent, from which the branch falls, and its own.
    """
    first, last = window
    values = [first - shift, last + shift, last - shift]
    here = [doubled.solve(min(orbits, key=lambda o, v=v: abs(o.value - v)), v) for v in values]
    assert [o.stability for o in here] == ["stable", "stable", "unstable"]
    start = np.array([o.evaluate(0.0)[0] * (1 + 1e-4) for o in here])
    swept = sweep(rs.gear(), "frequency_ratio", values, quantity="lambda", start=start)
    assert swept.period.tolist() == [2, 2, 4]
    assert swept.rms[:2] == pytest.approx([o.rms("lambda") for o in here[:2]], rel=1e-4)


@pytest.mark.parametrize(
    ("parent", "spans", "doublings", "following", "shift"),
    [
        ((1.5, 1.2), ((1.1, 1.5), (0.9, 1.6)), rs.GEAR_DOUBLINGS[:2], (1.1469848870, 1.1469848870), 0.006),
        ((0.6, 0.5), ((0.53, 0.6), (0.51, 0.54)), rs.GEAR_DOUBLINGS[2:], (0.5394806294, 0.5215780104), 0.002),
    ],
    ids=["upper", "lower"],
)
def test_each_of_the_four_doublings_of_the_gear_pair_is_followed(parent, spans, doublings, following, shift):
    """The next doublings, and the verdicts on both sides of the first one in the time domain.

    The branches of each two are one. From 1.416 its stable part is met first, from 1.2775 the unstable one and a fold,
    and the end of the stable part counts; from 0.5226, where it is born unstable, the part behind its fold is first.
    """
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    branch = trace(problem, problem.guess(frequency_ratio=parent[0]), parent)
    points = [q for q in branch.special_points if q.kind == "period-doubling"]
    found = [cascade(q, span, max_period=2) for q, span in zip(points, spans, strict=True)]
    for start, then, c in zip(doublings, following, found, strict=True):
        assert c.parameter == pytest.approx([start, then], abs=1e-8)
    doubled = problem.method.discretise(rs.gear(), "frequency_ratio", period_multiple=2)
    branch = found[0].branches[0]
    last = next(q for q in branch.special_points if q.kind == "period-doubling")
    for side, periods in ((shift, 2), (-shift, 4)):
        value = following[0] + side
        orbit = min(branch.orbits[: last.index + 3], key=lambda o, value=value: abs(o.value - value))
        distance = returns(doubled, orbit, value)
        assert distance[periods - 1] < 1e-4
        assert min(distance[: periods - 1]) > 1e-3
    check_sweep(doubled, branch.orbits[: last.index + 3], (doublings[0], following[0]), shift)


def test_summaries():
    found = cascade(first_doubling(rs.double_well(), "g", (0.264, 0.267)), (0.26, 0.3), max_period=4)
    assert "2 -> 4 at g = 0.28669" in str(found)
    assert "ended: orbits of more than 4 periods are not followed" in str(found)
    table = json.loads(json.dumps(found.to_dict()))
    assert [d["period_multiple"] for d in table["doublings"]] == [1, 2, 4]
    assert table["accumulation"] == found.accumulation


def test_a_cascade_that_leaves_the_span_ends_there():
    found = cascade(first_doubling(rs.double_well(), "g", (0.264, 0.267)), (0.26, 0.28))
    assert (found.periods, found.ended) == ((1,), "no doubling")
    assert "reached g = 0.28" in found.reason
    assert found.accumulation is None


def test_misuse_is_refused():
    doubling = first_doubling(rs.double_well(), "g", (0.264, 0.267))
    with pytest.raises(ValueError, match="expected a period-doubling, got a fold"):
        cascade(replace(doubling, kind="fold"), (0.26, 0.3))
    with pytest.raises(ValueError, match="does not contain"):
        cascade(doubling, (0.28, 0.3))
