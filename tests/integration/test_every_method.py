"""Swapping the method is a one-word change: every reference system through every method that applies to it."""

from __future__ import annotations

import numpy as np
import pytest
import reference_systems as rs

from continuation import CVODES, Collocation, HarmonicBalance, Shooting, UnsupportedModel, trace

METHODS = {
    "harmonic balance": HarmonicBalance(tolerance=1e-9),
    "shooting": Shooting(segments=1),
    "multiple shooting": Shooting(segments=4),
    "CVODES": Shooting(segments=1, integrator=CVODES(rtol=1e-11, atol=1e-13)),
    "collocation": Collocation(tolerance=1e-10),
}
# special points are located to their own error, whatever the tolerance of the branch
TRACED = METHODS | {"harmonic balance": HarmonicBalance(), "collocation": Collocation()}
# system, parameter, value, further arguments of the first guess, smooth
SYSTEMS = {
    "linear": (rs.linear_oscillator, "omega", 0.8, {}, True),
    "chain": (lambda: rs.linear_chain(0.1), "omega", 0.7, {}, True),
    "duffing": (rs.duffing, "omega", 0.9, {}, True),
    "absorber": (rs.absorber, "omega", 1.0, {}, True),
    "double well": (rs.double_well, "g", 0.25, {}, True),
    "van der Pol pair": (rs.coupled_van_der_pol, "omega", 1.3, {}, True),
    "lorenz": (rs.lorenz, "r", 240.0, {}, True),
    "third order": (rs.third_order, "alpha", 0.9, {"x": 0.1, "y": 0.0, "z": 0.0}, True),
    "enzyme": (rs.enzyme, "rho", 4.6, {"S": 30.0, "A": 250.0}, True),
    "smoothed backlash": (lambda: rs.backlash().smoothed(0.1), "omega", 0.75, {}, True),
    "backlash": (rs.backlash, "omega", 0.6, {}, False),
    "parametric backlash": (rs.parametric_backlash, "omega", 1.5, {}, False),
    "stops": (lambda: rs.stops(damping=0.1, gain=0.2, force=0.3, width=1.0, stops=2), "omega", 0.8, {}, False),
    "gear": (rs.gear, "frequency_ratio", 0.55, {}, False),
}
SMOOTH_ONLY = ("CVODES", "collocation")
_first: dict = {}


def balance(system, parameter, smooth):
    """Return harmonic balance as accurate as the comparison asks for: harmonics fall like k^-4 with backlash."""
    return HarmonicBalance(tolerance=1e-9 if smooth else 1e-7).discretise(system, parameter)


def first_orbit(name):
    """Return the harmonic-balance orbit of a system, the start of every other method (found once)."""
    if name not in _first:
        build, parameter, value, begin, smooth = SYSTEMS[name]
        system = build()
        problem = balance(system, parameter, smooth)
        _first[name] = system, problem.guess(**{parameter: value}, **begin)
    return _first[name]


def difference(a, b):
    """Return a - b at 41 phases, without the shift in time that an autonomous orbit is free in."""
    phases = np.linspace(0, 2 * np.pi, 42)[:-1]
    gap = a.evaluate(phases) - b.evaluate(phases)
    if a.system in ("lorenz", "third-order", "enzyme"):
        h = 1e-4
        flow = (b.evaluate(phases + h) - b.evaluate(phases - h)) / (2 * h)
        gap -= flow * np.sum(flow * gap) / np.sum(flow**2)
    return gap


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("method", [m for m in METHODS if m != "harmonic balance"])
def test_same_orbit_same_multipliers_same_verdict(name, method):
    system, orbit = first_orbit(name)
    _, parameter, _, _, smooth = SYSTEMS[name]
    if method in SMOOTH_ONLY and not smooth:
        with pytest.raises(UnsupportedModel, match="smoothed"):
            METHODS[method].discretise(system, parameter)
        return
    other = METHODS[method].discretise(system, parameter).from_orbit(orbit)
    size = np.abs(orbit.coefficients).sum()
    scale = 1e-8 if smooth else 1e-6
    assert np.abs(difference(other, orbit)).max() < scale * size
    assert abs(other.period / orbit.period - 1) < 1e-9
    distance = rs.multiplier_distance(orbit.multipliers, other.multipliers)
    bars = orbit.multiplier_error.max() + other.multiplier_error.max()
    assert distance < bars + 1e-9 * np.abs(orbit.multipliers).max()
    assert orbit.stability == other.stability != "undecided"  # none of them is close to the unit circle
    # and back: the first method takes an orbit of any other
    again = balance(system, parameter, smooth).from_orbit(other)
    assert np.abs(difference(again, orbit)).max() < scale * size


@pytest.mark.parametrize("method", METHODS)
def test_same_folds_of_duffing(method):
    problem = TRACED[method].discretise(rs.duffing(), "omega")
    branch = trace(problem, problem.guess(omega=1.0), (1.0, 1.4))
    found = [(p.kind, p.parameter) for p in branch.special_points]
    assert [k for k, _ in found] == ["fold", "fold"]
    assert np.allclose([p for _, p in found], [1.2696019555, 1.1157002518], atol=2e-9, rtol=0)


@pytest.mark.parametrize("method", ["harmonic balance", "shooting", "multiple shooting"])
def test_same_folds_of_the_backlash_oscillator(method):
    problem = TRACED[method].discretise(rs.backlash(), "omega")
    branch = trace(problem, problem.guess(omega=0.65), (0.65, 0.9))
    points = sorted((p.kind, p.parameter) for p in branch.special_points)
    assert [kind for kind, _ in points] == ["fold", "fold", "grazing"]
    assert np.allclose([at for _, at in points], [0.70803162, 0.82846398, 0.8206310877], atol=1e-8, rtol=0)


@pytest.mark.parametrize("method", METHODS)
def test_same_doubling_of_an_autonomous_system(method):
    problem = TRACED[method].discretise(rs.third_order(), "alpha")
    branch = trace(problem, problem.guess(alpha=0.65, x=0.1, y=0.0, z=0.0), (0.6, 0.66))
    (point,) = branch.special_points
    assert point.kind == "period-doubling"
    assert abs(point.parameter - 0.6303020062) < 1e-9
    assert abs(point.orbit.period - 6.364071339) < 1e-8
