"""Models that broke earlier versions: isolated high harmonics, units, heavy damping, symmetry, few states."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, HarmonicBalance, Shooting, System, trace


def duffing(scale=1.0, rate=1.0, zeta=0.025, g=0.18, alpha=0.1) -> System:
    """The AUTO-07p demo in other units of length and time, damping and forcing."""
    x, v, theta, omega, force = rs.symbols("x", "v", "theta", "omega", "g")
    spring = rate**2 * x + alpha * rate**2 / scale**2 * x**3
    return System(
        name="duffing",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -2 * zeta * rate * v - spring + force * scale * rate**2 * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, rate), "g": (force, g)},
    )


def located(system: System, parameter: str, span: tuple[float, float]) -> list[tuple[str, float]]:
    problem = HarmonicBalance().discretise(system, parameter)
    branch = trace(problem, problem.guess(**{parameter: span[0]}), span)
    assert branch.unresolved == ()
    assert all(point.status == "located" for point in branch.special_points)
    return [(point.kind, point.parameter) for point in branch.special_points]


@pytest.mark.parametrize("order", [20, 39, 45, 64, 100])
def test_isolated_high_harmonic_of_the_forcing_is_not_aliased(order):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    force = 0.01 * ca.cos(theta) + 0.1 * ca.cos(order * theta)
    system = System(
        name="shaft phase",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.06 * v - x - 0.1 * x**3 + force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5 / order)},
    )
    orbit = HarmonicBalance().discretise(system, "omega").guess(omega=0.5 / order)
    assert orbit.rms("x") == pytest.approx(0.094302, abs=1e-6)  # SciPy's solve_ivp gives 0.0943 for each of them


def test_small_offset_beside_a_large_gain_is_not_aliased():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    gap, stiffness, rate = 6e-5, 1e8, 1e4
    offset = 1e-6 * (ca.cos(theta) + ca.cos(40 * theta))
    contact = Contact(argument=x - offset, breakpoints=(-gap, gap), slopes=(1.0, 0.0, 1.0))
    force = stiffness * ((1 + 0.2 * ca.cos(theta)) * contact.force - 0.1 * gap)
    system = System(
        name="metres",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.1 * rate * v - force},
        contacts=[contact],
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, rate)},
    )
    balanced = HarmonicBalance().discretise(system, "omega").guess(omega=0.3 * rate)
    shot = Shooting().discretise(system, "omega").guess(omega=0.3 * rate)
    assert balanced.rms("x") == pytest.approx(shot.rms("x"), rel=1e-6)


@pytest.mark.parametrize(("scale", "rate"), [(1e-3, 1.0), (1e-6, 1e4), (1e3, 1e-2)])
def test_units_do_not_matter(scale, rate):
    found = located(duffing(scale, rate), "omega", (0.5 * rate, 2 * rate))
    assert [kind for kind, _ in found] == ["fold", "fold"]
    np.testing.assert_allclose([p / rate for _, p in found], [1.2696019555, 1.1157002518], rtol=1e-9)


def test_ports_in_very_different_units_are_not_a_rigid_body():
    x, v, y, w, theta, omega = rs.symbols("x", "v", "y", "w", "theta", "omega")

    def rms(unit: float) -> float:
        system = System(
            name="two units",
            states={"x": x, "v": v, "y": y, "w": w},
            derivatives={
                "x": v,
                "v": -0.1 * v - x - 0.1 * x**3 + 0.1 * y / unit + 0.2 * ca.cos(theta),
                "y": w,
                "w": -0.1 * w - y - 0.1 / unit**2 * y**3 + 0.1 * unit * x,
            },
            phase=theta,
            frequency="omega",
            parameters={"omega": (omega, 1.0)},
        )
        return HarmonicBalance().discretise(system, "omega").guess(omega=0.5).rms("x")

    assert rms(1e8) == pytest.approx(rms(1.0), rel=1e-10)


def test_heavy_damping_is_stable_not_undecided():
    problem = HarmonicBalance().discretise(duffing(zeta=5.0), "omega")
    branch = trace(problem, problem.guess(omega=0.1), (0.05, 0.2))
    assert branch.stable.all()
    assert np.isfinite([o.multiplier_error for o in branch.orbits]).all()


def test_torus_points_of_two_states():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(
        name="van der pol",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.2 * (1 - x**2) * v - x + 0.6 * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    problem = HarmonicBalance().discretise(system, "omega")
    branch = trace(problem, problem.guess(omega=1.0), (0.5, 1.8))
    assert [p.kind for p in branch.special_points] == ["neimark-sacker"] * 2
    for point in branch.special_points:
        assert abs(np.abs(point.multipliers[0]) - 1) < 1e-8
    assert branch.unresolved == ()


def test_symmetric_system_has_branch_points_and_an_asymmetric_one_has_none():
    symmetric = located(duffing(zeta=0.1, g=20.0, alpha=1.0), "omega", (2.5, 0.9))
    assert ("branch-point", pytest.approx(2.043695323, abs=1e-8)) in symmetric
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    broken = System(
        name="broken symmetry",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.2 * v - x - x**3 + 20 * ca.cos(theta) + 0.5},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    assert "branch-point" not in [kind for kind, _ in located(broken, "omega", (2.5, 1.9))]


def test_limit_of_harmonics_is_said_not_raised():
    problem = HarmonicBalance(max_harmonics=15).discretise(rs.backlash(), "omega")
    branch = trace(problem, problem.guess(omega=1.5), (0.6, 1.5))
    folds = [p for p in branch.special_points if p.kind == "fold"]
    assert [p.status for p in folds] == ["guessed", "guessed"]
    for point, exact in zip(sorted(folds, key=lambda p: p.parameter), (0.70803162, 0.82846398), strict=True):
        assert abs(point.parameter - exact) <= 3 * point.error


def test_small_parameter_is_no_different_from_a_large_one():
    def forced(unit: float) -> System:
        """Length and forcing in the same unit, traced in the forcing."""
        x, v, theta, omega, g = rs.symbols("x", "v", "theta", "omega", "g")
        return System(
            name="forced",
            states={"x": x, "v": v},
            derivatives={"x": v, "v": -0.05 * v - x - 0.1 * x**3 / unit**2 + g * ca.cos(theta)},
            phase=theta,
            frequency="omega",
            parameters={"omega": (omega, 1.2), "g": (g, 0.05 * unit)},
        )

    large, small = (located(forced(u), "g", (0.05 * u, 0.5 * u)) for u in (1.0, 1e-6))
    assert [kind for kind, _ in large] == [kind for kind, _ in small] == ["fold", "fold"]
    np.testing.assert_allclose([p * 1e6 for _, p in small], [p for _, p in large], rtol=1e-9)
