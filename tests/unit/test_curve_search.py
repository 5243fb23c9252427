"""The search for sign changes along a tracked curve, on functions that are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from continuation.branches import curve_search
from continuation.branches.curve_search import at_nodes, changes, search_curve


class Line:
    """Stands in for a piece of a curve that is a straight line: a node is a number."""

    def __init__(self, system, metric, a, b):
        self.ends = a.p, b.p

    def node(self, x):
        return point(self.ends[0] + x * (self.ends[1] - self.ends[0]))


def point(s):
    return SimpleNamespace(u=np.zeros(1), p=s)


class Known:
    """Stands in for the test functions of a curve: known functions of the arclength; counts what was looked at."""

    along, metric = None, SimpleNamespace(length=lambda du, dp: abs(dp))
    system = SimpleNamespace(parameter="q", lengthen=lambda u, like: u)

    def __init__(self, *functions):
        self.functions, self.count = functions, 0

    def __call__(self, node, kinds):
        self.count += 1
        return np.array([f(node.p) for f in self.functions])


@pytest.fixture(autouse=True)
def _straight(monkeypatch):
    monkeypatch.setattr(curve_search, "Segment", Line)


def look(*functions, steps=20, seed=0):
    """Return places of sign changes, notes and the number of points looked at between those of the curve."""
    places = np.cumsum(np.random.default_rng(seed).uniform(0.6, 1.4, steps))
    tests, kinds = Known(*functions), ("cusp", "1:1")[: len(functions)]
    samples, notes = search_curve(tests, at_nodes(tests, [point(s) for s in places], kinds), kinds)
    found, touching = changes(tests, samples, kinds)
    return [(c.kind, c.a.node.p, c.b.node.p) for c in found], notes + touching, tests.count - steps


@pytest.mark.parametrize("half", [0.1, 1e-2, 3e-3])
def test_pairs_inside_a_step_wherever_it_lies(half):
    for seed in range(25):
        middle = np.random.default_rng(seed).uniform(5, 12)

        def dip(s, middle=middle):
            return np.cosh((s - middle) / 3) - np.cosh(half / 3)

        found, notes, extra = look(dip, seed=seed)
        assert not notes
        (_, a, b), (_, c, d) = found
        assert a <= middle - half <= b <= middle <= c <= middle + half <= d
        assert extra < 60

        found, notes, extra = look(lambda s, dip=dip: dip(s) + 2 * (np.cosh(half / 3) - 1), seed=seed)
        assert (found, notes) == ([], [])


def test_a_function_that_stays_away_from_zero_costs_nothing():
    assert look(lambda s: 2 + np.cos(s / 3), lambda s: np.cos(s / 3) + 0.3)[2] == 0


def test_three_zeros_in_one_step():
    """A sign change that hides a pair."""
    found, notes, _ = look(lambda s: (s - 8) * ((s - 8) ** 2 - 0.01))
    assert [round((a + b) / 2, 0) for _, a, b in found] == [8.0] * 3
    assert not notes


def test_a_jump_is_said_not_searched_for_ever():
    found, notes, extra = look(lambda s: 0.05 + (s > 8.1) * 1.0)
    assert found == []
    assert any("not decided" in note for note in notes)
    assert extra < 20


def test_a_touch_within_rounding_is_said():
    found, notes, _ = look(lambda s: (s - 8.123) ** 2)
    assert found == []
    assert any("not decided" in note for note in notes)


def test_zero_all_along_a_piece_is_no_point():
    """As the coefficient of a doubling while contact is kept: the model is linear."""
    found, notes, _ = look(lambda s: max(s - 9.3, 0.0) ** 3)
    assert (found, notes) == ([], [])


def test_a_curve_of_two_points():
    found, notes, extra = look(lambda s: (s - 1.2) * (s - 1.4), steps=2)
    assert len(found) == 2
    assert not notes
    assert extra >= 3
