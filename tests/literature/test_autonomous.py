"""Autonomous systems against published numbers: period, folds of cycles, period-doublings, Hopf points."""

import re

import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, HarmonicBalance, NoConvergence, trace


def hopf_points(stop: str) -> list[float]:
    """Return the parameters of the Hopf points that a stop reason names."""
    return [float(v) for v in re.findall(r"Hopf point at \w+ = ([-\d.]+)", stop)]


def test_lorenz_period_doubling():
    problem = HarmonicBalance().discretise(rs.lorenz(), "r")
    branch = trace(problem, problem.guess(r=231.0), (231.0, 228.0))
    (point,) = branch.special_points
    assert point.kind == "period-doubling"
    assert abs(point.parameter - 229.4067086) < 1e-7 + point.error
    assert abs(point.orbit.period - 0.480866820) < 2e-9
    assert np.allclose(sorted(point.multipliers.real), [-1, -0.00139921, 1], atol=2e-8)
    assert branch.unresolved == ()
    low, high = branch.parameter < 229.4, branch.parameter > 229.41
    assert set(branch.stability[high]) == {"stable"}
    assert set(branch.stability[low]) == {"unstable"}
    # one multiplier is 1; the sum of the exponents is the constant divergence -(sigma + 1 + b)
    for orbit in branch.orbits:
        assert abs(np.abs(orbit.multipliers - 1).min()) < 1e-6
        log = np.log(np.abs(orbit.multipliers)).sum()
        assert abs(log + (10 + 1 + 8 / 3) * orbit.period) < 1e-4


def test_third_order_from_hopf_point_to_doubling():
    problem = HarmonicBalance().discretise(rs.third_order(), "alpha")
    branch = trace(problem, problem.guess(alpha=0.9, x=0.1, y=0.0, z=0.0), (0.6, 1.1))
    (point,) = branch.special_points
    assert point.kind == "period-doubling"
    assert abs(point.parameter - 0.6303020062) < 2e-10
    assert abs(point.orbit.period - 6.364071339) < 2e-9
    assert np.allclose(sorted(point.multipliers.real), [-1, -0.01811007, 1], atol=2e-8)
    (hopf,) = hopf_points(branch.stop)
    assert abs(hopf - 1.0) < 1e-10


def test_folds_of_cycles_between_two_hopf_points():
    problem = Collocation(tolerance=1e-7).discretise(rs.enzyme(), "rho")
    branch = trace(problem, problem.guess(rho=4.0, S=30.0, A=250.0), (2.0, 6.0))
    low, high = sorted(branch.special_points, key=lambda q: q.parameter)
    assert {low.kind, high.kind} == {"fold"}
    assert [low.parameter, high.parameter] == pytest.approx([2.75969, 5.00784], abs=1e-5)
    assert [low.orbit.period, high.orbit.period] == pytest.approx([10.0064, 5.67658], abs=5e-5)
    assert np.allclose(sorted(hopf_points(branch.stop)), [3.49995, 4.65046], atol=5e-6)
    assert branch.unresolved == ()
    inside = (branch.parameter > low.parameter) & (branch.parameter < high.parameter)
    assert {"stable", "unstable"} <= set(branch.stability[inside])


def test_an_equilibrium_is_told_from_a_cycle():
    problem = HarmonicBalance().discretise(rs.third_order(), "alpha")
    with pytest.raises(NoConvergence, match="equilibrium"):
        problem.guess(alpha=1.2, x=0.05, y=0.0, z=0.0)
    with pytest.raises(ValueError, match="no parameter or state 'alfa'; did you mean 'alpha'"):
        problem.guess(alfa=1.2)
