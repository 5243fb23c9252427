"""How cascades end, and where they accumulate, on branches made by hand and on the logistic map."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import fsolve
from synthetic_branch import make_orbit, make_point

from continuation import Branch
from continuation.branches.cascade import FEIGENBAUM, _accumulation, _ending


def branch_of(stability, kinds, stop="reached omega = 2"):
    """Return a branch with ``stability[i]`` for ten orbits before, between and after points of the given kinds."""
    orbits = tuple(
        make_orbit(1 + 0.01 * (10 * i + j), stability=verdict) for i, verdict in enumerate(stability) for j in range(10)
    )
    points = tuple(make_point(kind, make_orbit(1 + 0.1 * (i + 1)), 10 * (i + 1) - 1) for i, kind in enumerate(kinds))
    return Branch(orbits, points, stop, {}, {})


@pytest.mark.parametrize(
    ("stability", "kinds", "wanted", "place"),
    [
        (("stable", "unstable"), ("period-doubling",), "limit", 0),
        (("stable", "unstable"), ("neimark-sacker",), "neimark-sacker", None),
        (("stable", "unstable"), ("fold",), "fold", None),
        (("stable", "unstable"), ("branch-point",), "branch-point", None),
        (("stable", "unstable"), ("grazing",), "grazing", None),
        (("stable",), (), "no doubling", None),
        (("unstable", "stable", "unstable"), ("fold", "period-doubling"), "limit", 1),  # born subcritically
        (("unstable", "stable"), ("fold",), "no doubling", None),
        (("unstable", "unstable", "stable"), ("fold", "period-doubling"), "limit", 1),  # the gear pair from 1.2775
        (("stable", "stable", "unstable"), ("grazing", "period-doubling"), "limit", 1),
        (("undecided", "stable", "unstable"), ("grazing", "period-doubling"), "limit", 1),
        (("unstable", "unstable"), ("period-doubling",), "limit", 0),
        (("unstable", "unstable"), ("neimark-sacker",), "no doubling", None),
    ],
)
def test_what_ends_the_stable_orbits(stability, kinds, wanted, place):
    branch = branch_of(stability, kinds)
    ended, following, _ = _ending(branch)
    assert ended == wanted
    assert following is (None if place is None else branch.special_points[place])


def test_an_interrupted_cascade_says_so():
    ended, following, reason = _ending(branch_of(("stable",), (), "interrupted at omega = 1.1; the orbits are kept"))
    assert (ended, following) == ("interrupted", None)
    assert reason.startswith("interrupted")


def doublings_at(values):
    return [replace(make_point("period-doubling", make_orbit(v), 0), parameter=v, error=1e-14) for v in values]


def logistic_doublings(count):
    """Return the first doublings of x -> r x (1 - x), by Newton's method on the orbit of period 2^k through mu = -1."""
    found = [3.0, 1 + np.sqrt(6)]

    def equations(z, n):
        x, r = z
        y, slope = x, 1.0
        for _ in range(n):
            y, slope = r * y * (1 - y), slope * r * (1 - 2 * y)
        return y - x, slope + 1

    for k in range(2, count):
        r = found[-1] + (found[-1] - found[-2]) / 4.7
        x = 0.5
        for _ in range(20000):
            x = (r - 1e-9) * x * (1 - x)
        n = 2**k
        roots = [fsolve(equations, (y, r), args=(n,), xtol=1e-13)[1] for y in orbit_of(x, r, n)]
        found.append(float(min(roots, key=lambda root: abs(root - r))))
    return found


def orbit_of(x, r, n):
    for _ in range(n):
        yield x
        x = r * x * (1 - x)


def test_extrapolation_of_the_logistic_map_is_within_its_error():
    """Accumulates at 3.569945671870945 (Feigenbaum point of the logistic map)."""
    values = logistic_doublings(6)
    errors = []
    for count in range(3, 7):
        value, error = _accumulation(doublings_at(values[:count]))
        assert abs(value - 3.569945671870945) < error
        errors.append(error)
    assert all(b < a / 3 for a, b in pairwise(errors))


def test_no_extrapolation_of_what_is_no_cascade():
    assert _accumulation(doublings_at([1.0, 2.0])) == (None, None)
    assert _accumulation(doublings_at([1.0, 2.0, 2.5])) == (None, None)
    exact = [3 - FEIGENBAUM**-k for k in range(4)]
    value, error = _accumulation(doublings_at(exact))
    assert value == pytest.approx(3.0, abs=1e-12)
    assert error < 1e-3
