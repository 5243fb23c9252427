"""When it can't: a named error with the parameter value, the residual history, the last good orbit, and what to try."""

import casadi as ca
import pytest
import reference_systems as rs

from continuation import Collocation, ContinuationError, HarmonicBalance, NoConvergence, Shooting, System, trace

METHODS = {"hb": HarmonicBalance(), "shooting": Shooting(), "collocation": Collocation()}


@pytest.mark.parametrize("name", METHODS)
def test_a_step_past_a_fold_names_value_history_and_orbit(name):
    problem = METHODS[name].discretise(rs.duffing(), "omega")
    upper = trace(problem, problem.guess(omega=1.0), (1.0, 1.26)).orbits[-1]
    with pytest.raises(NoConvergence, match="take a smaller step") as caught:
        problem.solve(upper, 1.6)  # the upper branch ends at 1.2696
    assert caught.value.parameter == pytest.approx(1.6)
    assert len(caught.value.history) > 0
    assert caught.value.orbit is upper


@pytest.mark.parametrize("name", METHODS)
def test_an_orbit_of_other_parameters_is_refused(name):
    orbit = HarmonicBalance().discretise(rs.duffing(), "omega", g=0.11).guess(omega=0.5)
    with pytest.raises(ValueError, match=r"the orbit is of g = 0\.11, the problem of g = 0\.18; give g=0\.11"):
        METHODS[name].discretise(rs.duffing(), "omega").from_orbit(orbit)
    with pytest.raises(ValueError, match="the orbit is of system 'duffing'"):
        METHODS[name].discretise(rs.third_order(), "alpha").from_orbit(orbit)


@pytest.mark.parametrize("name", METHODS)
def test_an_orbit_found_in_another_parameter_is_taken_over(name):
    orbit = HarmonicBalance().discretise(rs.duffing(), "g", omega=0.5).guess(g=0.18)
    other = METHODS[name].discretise(rs.duffing(), "omega").from_orbit(orbit)
    assert other.parameter == "omega"
    assert other.value == 0.5
    assert other.rms("x") == pytest.approx(orbit.rms("x"), rel=1e-6)


@pytest.mark.parametrize("name", METHODS)
def test_a_model_that_is_not_finite_is_named(name):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    broken = System(
        name="broken",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -x - 0.1 * v - ca.log(x - 5) + ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5)},
    )
    with pytest.raises(ContinuationError, match=r"omega = 0\.5|parameter value 0\.5|not finite|runs away"):
        METHODS[name].discretise(broken, "omega").guess(omega=0.5)
