"""What CasADi's CVODES gets wrong when asked naively, and that shooting with CVODES does not ask it so."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import CVODES, Shooting, System
from continuation.errors import IntegrationFailed, Runaway, UnsupportedModel
from continuation.timedomain.cvodes_variational import VariationalIntegrator
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.variational import sensitivities, tangents


def reverse_jacobian(**options) -> np.ndarray:
    """Return d x(1) / d(a, b, c) of x' = a (1 - t) + b t + c t by CasADi's reverse mode; each is exactly 0.5."""
    x, t, p = ca.MX.sym("x"), ca.MX.sym("t"), ca.MX.sym("p", 3)
    dae = {"x": x, "t": t, "p": p, "ode": p[0] * (1 - t) + p[1] * t + p[2] * t}
    end = ca.integrator("f", "cvodes", dae, 0.0, 1.0, options)
    flow = ca.Function("flow", [x, p], [end(x0=x, p=p)["xf"]])
    return np.array(ca.Function("J", [x, p], [ca.jacobian(flow(x, p), p)])(0.0, [1.0, 2.0, 3.0])).ravel()


def ramp() -> System:
    """The same as a driven System: t is the phase over 2 pi."""
    x, theta, omega, a, b, c = rs.symbols("x", "theta", "omega", "a", "b", "c")
    t = theta / (2 * np.pi)
    return System(
        name="ramp",
        states={"x": x},
        derivatives={"x": a * (1 - t) + b * t + c * t},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 2 * np.pi), "a": (a, 1.0), "b": (b, 2.0), "c": (c, 3.0)},
    )


def test_reverse_mode_is_wrong_by_default_and_right_with_quadratures_under_control():
    assert abs(reverse_jacobian() - 0.5).max() > 0.01
    assert abs(reverse_jacobian(quad_err_con=True, reltol=1e-10, abstol=1e-12) - 0.5).max() < 1e-8


@pytest.mark.parametrize("stiff", [False, True])
def test_forward_variations_are_right(stiff):
    system = ramp()
    run = VariationalIntegrator(system, CVODES(rtol=1e-10, atol=1e-12, stiff=stiff))
    p = system.parameter_vector()
    for name in "abc":
        unit = np.eye(4)[system.parameter_names.index(name)]
        M, push, trace = run.derivatives(np.zeros(1), p, 0.0, 2 * np.pi, unit)
        assert push == pytest.approx([0.5], abs=1e-9)
        assert (M.tolist(), trace) == ([[1.0]], 0.0)


def smooth_gear() -> System:
    return rs.gear().smoothed(0.05)


@pytest.mark.parametrize(
    ("make", "stiff"),
    [
        (rs.duffing, False),
        (rs.duffing, True),
        (rs.absorber, False),
        (rs.absorber, True),
        (rs.coupled_van_der_pol, True),
        (smooth_gear, False),
    ],
)
def test_jacobians_against_the_one_step_method(make, stiff):
    """Two integrators that share nothing but the model: states, matrices, every parameter."""
    system = make()
    n, p = len(system.state_names), system.parameter_vector()
    x = 0.3 * np.cos(np.arange(n)) + (1.0 if n > 4 else 0.0)
    run = VariationalIntegrator(system, CVODES(rtol=1e-10, atol=1e-12, stiff=stiff))
    exact = ExactIntegrator(system, rtol=1e-12, atol=1e-14)
    path = exact.between(x, p, 1.0, 5.0)
    found = tangents(exact, [path], p)
    assert run.end(x, p, 1.0, 5.0) == pytest.approx(path.end, abs=2e-7)
    for unit in np.eye(len(p)):
        M, push, trace = run.derivatives(x, p, 1.0, 5.0, unit)
        assert abs(M - found.whole(0)).max() < 2e-6
        assert abs(push - sensitivities(exact, found, 1, p, unit)[0]).max() < 2e-6
        assert trace == pytest.approx(found.traces.sum(), abs=2e-6)


def test_linear_jacobian_against_the_matrix_exponential():
    """x'' + 2 zeta x' + x = g cos(theta): the transition over a period has a closed form."""
    system, zeta = rs.linear_oscillator(zeta=0.03), 0.03
    problem = Shooting(integrator=CVODES(rtol=1e-11, atol=1e-13)).discretise(system, "omega")
    omega = 0.7
    T, w = 2 * np.pi / omega, np.sqrt(1 - zeta**2)
    c, s = np.cos(w * T), np.sin(w * T) / w
    exact = np.exp(-zeta * T) * np.array([[c + zeta * s, s], [-s, c - zeta * s]])
    assert abs(problem.monodromy(np.array([0.2, 0.1]), omega) - exact).max() < 1e-8
    assert problem.liouville_defect(np.array([0.2, 0.1]), omega) < 1e-8


def test_contacts_are_refused_with_what_to_use():
    method = Shooting(integrator=CVODES())
    with pytest.raises(UnsupportedModel, match=r"without integrator, which is event-exact, or .*smoothed\(width\)"):
        method.discretise(rs.backlash(), "omega")
    smooth = method.discretise(rs.backlash().smoothed(0.05), "omega").guess(omega=0.6)
    assert smooth.stability == "stable"
    with pytest.raises(ValueError, match=r"rtol belongs to the event-exact"):
        Shooting(rtol=1e-6, integrator=CVODES())
    with pytest.raises(ValueError, match=r"must be CVODES"):
        Shooting(integrator="cvodes")


def test_failures_are_the_engines_own():
    x, theta, omega = rs.symbols("x", "theta", "omega")

    def model(rate):
        return System(name="m", states={"x": x}, derivatives={"x": rate}, phase=theta, frequency="omega",
                      parameters={"omega": (omega, 1.0)})  # fmt: skip

    run = VariationalIntegrator(model(x**2), CVODES())
    with pytest.raises(IntegrationFailed, match=r"omega = 1.*CVODES|finite numbers") as caught:
        run.end(np.array([10.0]), np.array([1.0]), 0.0, 1.0)
    assert "core/" not in str(caught.value)
    assert issubclass(Runaway, IntegrationFailed)


def test_stiff_system_by_shooting():
    """x' = -1e5 (x - cos theta): far too stiff for the explicit default, a matter of milliseconds for BDF."""
    x, theta, omega = rs.symbols("x", "theta", "omega")
    system = System(name="stiff", states={"x": x}, derivatives={"x": -1e5 * (x - ca.cos(theta))}, phase=theta,
                    frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
    orbit = Shooting(integrator=CVODES(rtol=1e-8, atol=1e-10, stiff=True)).discretise(system, "omega").guess()
    assert orbit.harmonics("x")[1] == pytest.approx(0.5 * 1e5 / (1e5 + 1j), abs=1e-6)
    assert orbit.stability == "stable"
