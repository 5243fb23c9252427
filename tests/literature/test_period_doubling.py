"""Period-doubling cascades against published numbers, and against the largest Lyapunov exponent."""

from __future__ import annotations

import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, HarmonicBalance, Shooting, cascade, switch, trace
from continuation.timedomain.lyapunov import lyapunov_spectrum

HARMONICS = HarmonicBalance()
SHOOTING = Shooting()


def double_well_cascade(method, max_period):
    problem = method.discretise(rs.double_well(), "g")
    parent = trace(problem, problem.guess(g=0.262), (0.262, 0.268))
    return problem, cascade(parent.special_points[0], (0.26, 0.3), max_period=max_period)


@pytest.mark.parametrize("method", [HARMONICS, SHOOTING], ids=repr)
def test_double_well_to_period_16(method):
    _, found = double_well_cascade(method, 8)
    assert found.periods == (1, 2, 4, 8)  # the last one doubles to 16
    assert found.parameter == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS, abs=1e-9)
    assert found.ratios == pytest.approx([4.80158, 4.67197], abs=1e-5)
    assert np.all(np.abs(found.parameter - rs.DOUBLE_WELL_DOUBLINGS) < found.error + 2e-13)


def test_accumulation_is_where_the_largest_exponent_changes_sign():
    problem, found = double_well_cascade(SHOOTING, 8)
    assert found.accumulation_error < 1e-4 * found.accumulation
    start = problem.guess(g=0.262).evaluate(0.0)[0]
    exponents = []
    for factor in (0.999, 1.001):
        spectrum = lyapunov_spectrum(
            rs.double_well(), start, periods=2000, transient=500, count=1, g=found.accumulation * factor
        )
        exponents.append((spectrum.exponents[0], spectrum.errors[0]))
    assert exponents[0][0] + 3 * exponents[0][1] < 0 < exponents[1][0] - 3 * exponents[1][1]


def test_lorenz_cycles():
    """Each doubled branch leaves the one before, all are followed to r = 200; periods as printed."""
    problem = Collocation(tolerance=1e-6).discretise(rs.lorenz(), "r")
    branch = trace(problem, problem.guess(r=235.0), (235.0, 200.0))
    table = (
        (229.4067086, 5e-8, 0.480866820, 0.516877),
        (218.210, 5e-4, 0.987949, 1.03581),
        (215.966, 5e-4, 1.98675, 2.07002),
    )
    for doubling, digits, period, at_200 in table:
        (point,) = [q for q in branch.special_points if q.kind == "period-doubling"]
        assert point.parameter == pytest.approx(doubling, abs=digits + point.error)
        assert point.orbit.period == pytest.approx(period, rel=2e-6)
        assert branch.orbits[-1].value == pytest.approx(200.0, abs=1e-9)
        assert branch.orbits[-1].period == pytest.approx(at_200, rel=3e-6)
        if at_200 < 2:
            branch = switch(point, (200.0, point.parameter))


def test_two_nearby_cycles_are_not_mixed_up():
    """Near phase 0 the cycle and its symmetric neighbour run side by side; one of them doubles."""
    problem = SHOOTING.discretise(rs.lorenz(), "r")
    branch = trace(problem, problem.guess(r=235.0), (235.0, 229.0))
    assert np.min(np.abs([o.mean("x") for o in branch.orbits])) > 0.5  # that of the symmetric one is 0
    (point,) = branch.special_points
    assert point.parameter == pytest.approx(229.4067086, abs=2e-7)
    assert branch.unresolved == ()
