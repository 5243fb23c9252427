"""Derivatives of the critical operators are exact, contact changes included: against Richardson differences."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Collocation, Contact, HarmonicBalance, Shooting, System


def everywhere() -> System:
    """Parameters act on gain, forcing, linear part, contact argument and smooth law at once."""
    a, b, k, theta, om, al, x, v, y, w = rs.symbols("a", "b", "k", "theta", "om", "al", "x", "v", "y", "w")
    mesh = Contact(argument=al * x - y / al + 0.1 * k * ca.cos(theta), breakpoints=(-1, 1), slopes=(1, 0, 1.2))
    gain = 1 + a * ca.cos(theta)
    push = -0.1 * k * v - k * x - al * gain * mesh.force + b * ca.cos(theta) + 1.5 - 0.1 * om * x**3 * k
    return System(
        name="everywhere",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "y": w, "v": push, "w": -0.2 * w - 2 * k * y + gain * mesh.force / al},
        contacts=[mesh],
        phase=theta,
        frequency="om",
        parameters={"a": (a, 0.2), "b": (b, 0.5), "k": (k, 1.1), "al": (al, 1.3), "om": (om, 0.8)},
    )


def nonlinear_contact() -> System:
    """A contact whose force is squared and whose gain depends on the state."""
    x, v, theta, om, c = rs.symbols("x", "v", "theta", "om", "c")
    stop = Contact(argument=x + 0.2 * c * x**2, breakpoints=(0.3,), slopes=(0.0, 1.5))
    push = -0.2 * v - x - c * stop.force * (1 + x) - stop.force**2 + 0.8 * ca.cos(theta)
    return System(
        name="squared",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": push},
        contacts=[stop],
        phase=theta,
        frequency="om",
        parameters={"om": (om, 0.7), "c": (c, 1.2)},
    )


CASES = {
    "everywhere": (everywhere, "k", 1.1),
    "squared": (nonlinear_contact, "om", 0.7),
    "duffing": (rs.duffing, "omega", 0.6),
    "coupled": (rs.coupled_van_der_pol, "omega", 1.3),
    "gear": (rs.gear, "frequency_ratio", 1.2),
}


def richardson(function, base, h):
    """Central differences of two steps; error h^4."""
    first, second = ((function(base + d) - function(base - d)) / (2 * d) for d in (h, h / 2))
    return (4 * second - first) / 3


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("nu", [0.0, 0.5, 0.31])
def test_exact_in_orbit_parameters_and_shift(name, nu):
    make, parameter, p = CASES[name]
    problem = HarmonicBalance(harmonics=15).discretise(make(), parameter)
    rng = np.random.default_rng(0)
    u = problem.unknown(problem.guess(**{parameter: p}))
    u = u + 1e-4 * rng.standard_normal(len(u))
    N = len(problem.critical_operator(u, p, nu))
    v, w = rng.standard_normal((2, N)) / np.arange(1, N + 1)
    if nu not in (0.0, 0.5):
        v, w = v + 1j * rng.standard_normal(N), w - 1j * rng.standard_normal(N)

    def form(u=u, p=p, nu=nu):
        return w.conj() @ problem.critical_operator(u, p, nu) @ v

    found = problem.critical_form(u, p, nu, v, w)
    size = np.linalg.norm(found.state)
    direction = rng.standard_normal(len(u)) / np.arange(1, len(u) + 1)
    moved = richardson(lambda t: form(u=u + t * direction), 0.0, 2e-4)
    assert found.state @ direction == pytest.approx(moved, abs=1e-7 * size)
    for other in problem.system.parameter_names:
        base = float(problem.vector(p)[problem.system.parameter_names.index(other)])

        def at(value, other=other, base=base):
            if other == parameter:
                return form(p=value)
            problem.set_value(other, value)
            result = form()
            problem.set_value(other, base)
            return result

        moved = richardson(at, base, 1e-4 * max(abs(base), 0.1))
        assert found.parameter(other) == pytest.approx(moved, abs=3e-8 * max(abs(moved), size)), other
    if nu not in (0.0, 0.5):
        moved = richardson(lambda t: form(nu=t), nu, 1e-4)
        assert found.shift == pytest.approx(moved, abs=1e-8 * max(abs(moved), size))


@pytest.mark.parametrize("method", [Shooting(segments=2, rtol=1e-12, atol=1e-14), Collocation(intervals=20)])
@pytest.mark.parametrize(("make", "parameter", "p"), [(rs.duffing, "omega", 0.6), (rs.enzyme, "rho", 3.7)])
@pytest.mark.parametrize("nu", [0.0, 0.5, 0.31])
def test_exact_where_the_monodromy_matrix_is_known(method, make, parameter, p, nu):
    problem = method.discretise(make(), parameter)
    rng = np.random.default_rng(0)
    orbit = problem.guess(**{parameter: p})
    u = problem.unknown(orbit)
    N = len(problem.critical_operator(u, p, nu))
    v, w = rng.standard_normal((2, N))
    if nu == 0.31:
        v, w = v + 1j * rng.standard_normal(N), w - 1j * rng.standard_normal(N)

    def form(u=u, p=p, nu=nu):
        return w.conj() @ problem.critical_operator(u, p, nu) @ v

    found = problem.critical_form(u, p, nu, v, w)
    size = np.linalg.norm(found.state) + abs(form())
    direction = rng.standard_normal(len(u)) * np.linalg.norm(u) / len(u)
    moved = richardson(lambda t: form(u=u + t * direction), 0.0, 2e-3)
    assert found.state @ direction == pytest.approx(moved, abs=1e-6 * size)
    moved = richardson(lambda t: form(p=t), p, 1e-3)
    assert found.parameter(parameter) == pytest.approx(moved, abs=1e-6 * max(abs(moved), size))
    if nu == 0.31:
        assert found.shift == pytest.approx(richardson(lambda t: form(nu=t), nu, 1e-3), abs=1e-8 * size)
