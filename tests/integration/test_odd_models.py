"""Models at the edge of what a method takes for granted: powers and roots, resonance, units, very low frequencies."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, ContinuationError, HarmonicBalance, Shooting, System, certify

METHODS = [HarmonicBalance(), Shooting(), Collocation()]


def oscillator(acceleration, name="odd", omega=1.0):
    x, v, theta, w = rs.symbols("x", "v", "theta", "omega")
    return System(
        name=name,
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (w, omega)},
    )


@pytest.mark.parametrize("law", [lambda x: x**1.5, ca.sqrt, lambda x: x**3], ids=["power", "root", "cube"])
def test_laws_without_a_slope_at_rest(law):
    """The slope at 0 is zero or infinite and there is none below: the load keeps every orbit above."""
    system = oscillator(lambda x, v, th: 2 + 0.2 * ca.cos(th) - 0.1 * v - law(x))
    orbits = [m.discretise(system, "omega").guess(omega=1.0, x=1.5) for m in METHODS]
    phases = np.linspace(0, 2 * np.pi, 20)
    for orbit in orbits[1:]:
        assert orbit.evaluate(phases) == pytest.approx(orbits[0].evaluate(phases), abs=2e-8)
        assert rs.multiplier_distance(orbit.multipliers, orbits[0].multipliers) < 1e-9
    again = HarmonicBalance().discretise(system, "omega").from_orbit(orbits[1])
    assert again.stability == orbits[1].stability == "stable"


@pytest.mark.parametrize("method", [*METHODS[:2], Shooting(segments=5), Collocation()], ids=repr)
def test_no_orbit_is_claimed_at_an_undamped_resonance(method):
    problem = method.discretise(oscillator(lambda x, v, th: ca.cos(th) - x), "omega")
    with pytest.raises(ContinuationError, match=r"resona|damping"):
        problem.guess(omega=1.0)


@pytest.mark.parametrize(("length", "rate"), [(1e-3, 1e3), (1e-9, 1e6), (1e3, 1e-3)])
def test_bars_do_not_depend_on_units(length, rate):
    def acceleration(x, v, th):
        return rate**2 * (length * 0.12 * ca.cos(th) - x - 0.1 / length**2 * x**3) - 0.02 * rate * v

    problem = HarmonicBalance().discretise(oscillator(acceleration, omega=rate), "omega")
    orbit = problem.guess(omega=1.05 * rate)
    assert abs(orbit.multipliers) == pytest.approx(np.exp(-0.02 * np.pi / 1.05), abs=1e-10)
    assert orbit.multiplier_error.max() < 2e-10
    assert orbit.stability == "stable"
    assert not [name for name in certify(problem, orbit).missing if name.startswith("Hill")]


@pytest.mark.parametrize("omega", [0.02, 0.015])
def test_a_certificate_at_a_very_low_frequency_says_what_is_missing(omega):
    """The multipliers are so small that Hill's matrix would need hundreds of harmonics to have their exponents."""
    pendulum = oscillator(lambda x, v, th: 0.1 * ca.cos(th) - 0.1 * v - (1 + 0.6 * ca.cos(th)) * ca.sin(x))
    problem = HarmonicBalance().discretise(pendulum, "omega")
    found = certify(problem, problem.guess(omega=omega))
    assert found.stability == "stable"
    assert "too few harmonics for so low a frequency" in found.missing["Hill, strip"]
    assert abs(np.prod(found.multipliers)) == pytest.approx(np.exp(-0.1 * 2 * np.pi / omega), rel=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_values_that_are_none_are_named_alike(method):
    problem = method.discretise(rs.duffing(), "omega")
    for value in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="expected a positive number"):
            problem.guess(omega=value)
    with pytest.raises(ValueError, match="omega: expected a number, got 'a'"):
        problem.guess(omega="a")
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        problem.guess(omgea=1.0)
    orbit = problem.guess(omega=0.5)
    with pytest.raises(ValueError, match="expected a finite value"):
        problem.solve(orbit, float("nan"))
    with pytest.raises(ValueError, match="expected a positive number"):
        problem.solve(orbit, 0.0)
