"""Cascades of period-doublings: by every method, how they end, and on a gear pair."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, HarmonicBalance, Shooting, cascade, trace

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


def test_both_ends_of_the_doubled_branch_of_the_gear_pair_double_at_one_frequency():
    """From 1.416 its stable part is met first, from 1.2775 the unstable one and a fold; the former's end counts."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    parent = trace(problem, problem.guess(frequency_ratio=1.5), (1.5, 1.2))
    doublings = [q for q in parent.special_points if q.kind == "period-doubling"]
    found = [cascade(q, (0.9, 1.6), max_period=2) for q in doublings]
    for start, c in zip(rs.GEAR_DOUBLINGS, found, strict=False):
        assert c.parameter == pytest.approx([start, 1.1469848870], abs=1e-8)
    # in the time domain: two periods above, four below, from the doubled orbit itself
    shooting = Shooting().discretise(rs.gear(), "frequency_ratio", period_multiple=2)
    doubled = problem.method.discretise(rs.gear(), "frequency_ratio", period_multiple=2)
    branch = found[0].branches[0]
    last = next(q for q in branch.special_points if q.kind == "period-doubling")
    for shift, periods in ((0.006, 2), (-0.006, 4)):
        value = found[0].parameter[1] + shift
        orbit = min(branch.orbits[: last.index + 3], key=lambda o, value=value: abs(o.value - value))
        x = doubled.solve(orbit, value).evaluate(0.0)[0] * (1 + 1e-4)
        x = shooting.integration.settle(x, shooting.vector(value), 300)
        returns = [x]
        for _ in range(4):
            returns.append(shooting.integration.settle(returns[-1], shooting.vector(value), 1))
        distance = [float(np.abs(r - x).max()) for r in returns]
        assert distance[periods] < 1e-4
        assert min(distance[1:periods]) > 1e-3


def test_summaries():
    found = cascade(first_doubling(rs.double_well(), "g", (0.264, 0.267), Shooting()), (0.26, 0.3), max_period=4)
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
