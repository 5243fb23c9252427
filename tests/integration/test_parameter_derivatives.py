"""dF/dp of harmonic balance is exact for every parameter, wherever it acts: against Richardson differences."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, HarmonicBalance, System


def everywhere() -> System:
    """Return a model whose parameters act on gain, forcing, linear part, contact argument and smooth law at once."""
    a, b, k, theta, om, al, x, v, y, w = (
        ca.SX.sym(n) for n in ("a", "b", "k", "theta", "om", "al", "x", "v", "y", "w")
    )
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


SYSTEMS = {
    "everywhere": (everywhere, "k", 1.1),
    "duffing": (rs.duffing, "omega", 0.6),
    "gear": (rs.gear, "frequency_ratio", 1.2),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_exact_in_every_parameter(name):
    make, parameter, p = SYSTEMS[name]
    system = make()
    problem = HarmonicBalance(harmonics=31).discretise(system, parameter)
    rng = np.random.default_rng(0)
    u = problem.unknown(problem.guess(**{parameter: p}))
    u = u + 1e-4 * rng.standard_normal(len(u))  # off the solution, where Newton's method needs it
    for other in system.parameter_names:
        base = float(problem.vector(p)[system.parameter_names.index(other)])

        def residual(value, other=other, base=base):
            if other == parameter:
                return problem.residual(u, value)
            problem.set_value(other, value)
            result = problem.residual(u, p)
            problem.set_value(other, base)
            return result

        h = 1e-4 * max(abs(base), 0.1)
        first, second = ((residual(base + d) - residual(base - d)) / (2 * d) for d in (h, h / 2))
        richardson = (4 * second - first) / 3
        exact = problem.parameter_derivative(u, p, other)
        assert np.abs(exact - richardson).max() < 1e-9 * max(np.abs(richardson).max(), 0.1), other


def test_linearise_uses_it():
    problem = HarmonicBalance(harmonics=31).discretise(everywhere(), "al")
    orbit = problem.guess(al=1.3)
    u = problem.unknown(orbit)
    assert np.array_equal(problem.linearise(u, 1.3)[2], problem.parameter_derivative(u, 1.3, "al"))
