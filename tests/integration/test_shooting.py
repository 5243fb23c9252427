"""Shooting against published orbits, multipliers and stability edges."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from continuation import Contact, NoConvergence, System
from continuation.orbits.shooting import Shooting

ZETA = 0.05
REFERENCE_ORBITS = [  # event-exact values of an independent code: frequency, state at phase 0, one multiplier
    (0.6, (1.1278799613, 0.0015682478), -0.30288645 + 0.50909685j),
    (0.75, (1.1624504362, 0.0080293418), None),
    (0.75, (0.8338430125, 0.1640787518), 0.43845790 + 0.49034086j),
    (1.0, (0.9059653748, 0.0557744441), None),
]


def single_mass(acceleration, contact=False, **parameters):
    """Build x'' = acceleration(x, v, theta, force, parameters...), phase theta, frequency "omega" first."""
    x, v, theta = (ca.SX.sym(k) for k in ("x", "v", "theta"))
    symbols = {k: ca.SX.sym(k) for k in parameters}
    law = [Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))] if contact else []
    force = law[0].force if law else None
    return System(
        name="single mass",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta, force, **symbols)},
        contacts=law,
        phase=theta,
        frequency="omega",
        parameters={k: (symbols[k], value) for k, value in parameters.items()},
    )


def backlash():
    return single_mass(
        lambda x, v, theta, f, omega, load, amplitude: load + amplitude * omega**2 * ca.cos(theta) - 2 * ZETA * v - f,
        contact=True,
        omega=0.6,
        load=0.1,
        amplitude=0.05,
    )


def parametric_backlash():
    return single_mass(
        lambda x, v, theta, f, omega: 0.5 - 0.1 * v - (1 + 0.3 * ca.cos(theta)) * f, contact=True, omega=0.7
    )


def duffing():
    return single_mass(
        lambda x, v, theta, f, omega, g: -0.05 * v - x - 0.1 * x**3 + g * ca.cos(theta), omega=1.0, g=0.18
    )


def newton(problem, u, p, steps=8):
    for _ in range(steps):
        f, jacobian, _ = problem.linearise(u, p)
        u = u - np.linalg.solve(jacobian, f)
    return u


@pytest.mark.parametrize(("omega", "state", "multiplier"), REFERENCE_ORBITS)
def test_backlash_orbits(omega, state, multiplier):
    problem = Shooting().discretise(backlash(), "omega")
    u = newton(problem, np.array(state) + 1e-3, omega)
    assert abs(u - state).max() < 1e-9
    monodromy = problem.monodromy(u, omega)
    if multiplier:
        assert abs(np.linalg.eigvals(monodromy) - multiplier).min() < 1e-8
    assert np.linalg.det(monodromy) == pytest.approx(np.exp(-2 * ZETA * 2 * np.pi / omega), rel=1e-9)
    assert problem.liouville_defect(u, omega) < 1e-9
    assert problem.error(u, omega) < 1e-9


def test_backlash_vibration_and_separation():
    problem = Shooting().discretise(backlash(), "omega")
    x = problem.waveform(np.array([0.8338430125, 0.1640787518]), 0.75, 4096)[:, 0]
    assert x.std() == pytest.approx(0.22472379, abs=2e-8)
    run = problem.path(np.array([0.8338430125, 0.1640787518]), 0.75)
    (contact, _, upward), (separation, _, downward) = run.runs[0].changes
    assert (upward, downward) == (1, -1)
    assert 1 - (separation - contact) / (2 * np.pi) == pytest.approx(0.54175, abs=5e-6)
    resonant = problem.waveform(newton(problem, np.array([0.906, 0.056]), 1.0), 1.0, 4096)[:, 0]
    assert resonant.std() == pytest.approx(0.13308283, abs=2e-8)


def test_fold_of_parametric_backlash():
    """At the fold a multiplier is +1; the bordered estimate stays finite there."""
    problem, omega = Shooting(rtol=1e-12, atol=1e-14).discretise(parametric_backlash(), "omega"), 0.7056974892
    u = np.array([0.19907848, -0.76947462])
    residual, jacobian, derivative = problem.linearise(u, omega)
    assert abs(residual).max() < 3e-8
    u = u - np.linalg.lstsq(np.column_stack([jacobian, derivative]), residual, rcond=None)[0][:2]
    # The multiplier leaves 1 with the root of the distance: 1e-10 in omega, and 1e-8 in the state, show as 1e-5.
    assert abs(np.linalg.eigvals(problem.monodromy(u, omega)) - 1).min() < 2e-5
    assert problem.error(u, omega) < 1e-9


def test_duffing_against_solve_ivp():
    problem = Shooting().discretise(duffing(), "omega", g=0.2)
    u, omega = problem.first_state(omega=0.7)
    assert problem.values == {"omega": 1.0, "g": 0.2}
    run = solve_ivp(
        lambda t, y: [y[1], -0.05 * y[1] - y[0] - 0.1 * y[0] ** 3 + 0.2 * np.cos(omega * t)],
        (0, 2 * np.pi / omega),
        u,
        method="DOP853",
        rtol=1e-13,
        atol=1e-15,
        dense_output=True,
    )
    assert abs(run.y[:, -1] - u).max() < 1e-9
    waveform = problem.waveform(u, omega, 50)
    assert waveform.shape == (50, 2)
    assert abs(waveform - run.sol(np.arange(50) * 2 * np.pi / omega / 50).T).max() < 1e-9


@pytest.mark.parametrize(
    ("system", "parameter", "u", "p"),
    [
        (backlash, "omega", (0.85, 0.15), 0.75),
        (backlash, "amplitude", (0.85, 0.15), 0.05),
        (backlash, "load", (0.85, 0.15), 0.1),
        (duffing, "omega", (0.5, -0.2), 1.1),
        (duffing, "g", (0.5, -0.2), 0.18),
    ],
)
@pytest.mark.parametrize("period_multiple", [1, 2])
def test_derivatives_against_differences(system, parameter, u, p, period_multiple):
    problem = Shooting(rtol=1e-13, atol=1e-15).discretise(system(), parameter, period_multiple, **{"omega": 0.8} if
                                                          parameter != "omega" else {})  # fmt: skip
    u = np.array(u)
    _, jacobian, derivative = problem.linearise(u, p)
    h = 1e-4

    def difference(change):  # fourth order
        return sum(w * change(k * h) for k, w in ((-2, 1), (-1, -8), (1, 8), (2, -1))) / (12 * h)

    assert abs(difference(lambda e: problem.residual(u, p + e)) - derivative).max() < 2e-7 * (1 + abs(derivative).max())
    for i, unit in enumerate(np.eye(2)):
        assert abs(difference(lambda e, d=unit: problem.residual(u + e * d, p)) - jacobian[:, i]).max() < 2e-7


def mathieu():
    """y'' + (a - 2 q cos 2t) y = 0 with theta = 2t, so that the excitation period is pi."""
    return single_mass(lambda x, v, theta, f, omega, a, q: -(a - 2 * q * ca.cos(theta)) * x, omega=2.0, a=1.0, q=1.0)


CHARACTERISTIC = {  # a0, b1, a1, b2, a2; the trace over pi is +2, -2, -2, +2, +2
    1.0: (-0.455138604, -0.110248817, 1.859108073, 3.917024773, 4.371300983),
    5.0: (-5.800046021, -5.790080599, 1.858187542, 2.099460445, 7.449109740),
}


@pytest.mark.parametrize("q", CHARACTERISTIC)
def test_mathieu_stability_edges(q):
    problem = Shooting(rtol=1e-12).discretise(mathieu(), "a", q=q)

    def trace(a):
        return np.trace(problem.monodromy(np.zeros(2), a))

    for value, wanted in zip(CHARACTERISTIC[q], (2, -2, -2, 2, 2), strict=True):
        edge = brentq(lambda a, w=wanted: trace(a) - w, value - 3e-3, value + 3e-3, xtol=1e-12)
        assert edge == pytest.approx(value, abs=1e-9)


def test_guess_of_a_doubled_orbit():
    """Double-well oscillator past its first doubling: the orbit of two periods is found."""
    well = single_mass(lambda x, v, theta, f, omega, g: -0.3 * v + x - x**3 + g * ca.cos(theta), omega=1.2, g=0.28)
    problem = Shooting().discretise(well, "g", period_multiple=2)
    u, g = problem.first_state()
    x = problem.waveform(u, g, 128)[:, 0]
    assert abs(problem.residual(u, g)).max() < 1e-9
    assert abs(x[:64] - x[64:]).max() > 0.01
    assert abs(np.linalg.eigvals(problem.monodromy(u, g))).max() < 1


def test_doubling_has_a_multiplier_minus_one():
    well = single_mass(lambda x, v, theta, f, omega, g: -0.3 * v + x - x**3 + g * ca.cos(theta), omega=1.2, g=0.26)
    problem = Shooting().discretise(well, "g")
    u, _ = problem.first_state()
    for g in np.linspace(0.26, 0.2655817860556, 6):
        u = newton(problem, u, g, 5)
    assert abs(np.linalg.eigvals(problem.monodromy(u, g)) + 1).min() < 1e-7


@pytest.mark.parametrize("rtol", [1e-5, 1e-7])
@pytest.mark.parametrize("omega", [0.6, 1.0])
def test_error_estimate_is_of_the_size_of_the_error(rtol, omega):
    state = {row[0]: row[1] for row in REFERENCE_ORBITS if row[0] != 0.75}[omega]
    loose = Shooting(rtol=rtol, atol=rtol / 100).discretise(backlash(), "omega")
    exact = newton(Shooting(rtol=1e-12, atol=1e-14).discretise(backlash(), "omega"), np.array(state), omega)
    u = newton(loose, np.array(state), omega)
    assert 0.1 * abs(u - exact).max() < loose.error(u, omega) < 10 * abs(u - exact).max()


def test_misuse_is_refused():
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        Shooting().discretise(duffing(), "omgea")
    with pytest.raises(ValueError, match="integer >= 1"):
        Shooting().discretise(duffing(), "omega", period_multiple=0)
    with pytest.raises(ValueError, match="give it to discretise"):
        Shooting().discretise(duffing(), "omega").guess(g=0.1)
    with pytest.raises(ValueError, match="rtol must be positive"):
        Shooting(rtol=0.0)
    with pytest.raises(ValueError, match="expected a positive number"):
        Shooting().discretise(duffing(), "omega").residual(np.zeros(2), -0.1)


def test_no_orbit_is_reported_with_history():
    drift = single_mass(lambda x, v, theta, f, omega: 1.0 + ca.cos(theta) - 0.2 * v, omega=1.0)
    with pytest.raises(NoConvergence, match="no orbit of 1 excitation period") as caught:
        Shooting().discretise(drift, "omega").guess()
    assert caught.value.parameter == 1.0
    assert len(caught.value.history) >= 1
