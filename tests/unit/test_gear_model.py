"""The symbolic equations against equations written by hand, and what must hold for every pair."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from continuation import System
from sbg_casadi import Dimensionless, PairError, gear_system, load_pair, static_state
from sbg_casadi.dimensionless import COORDINATES

STATES = {
    "example": load_pair("example").dimensionless(),
    "before": load_pair("iso-f2").dimensionless("before"),
    "after": load_pair("iso-f2").dimensionless("after"),
}


def random_pair(seed: int, harmonics: int = 3) -> Dimensionless:
    rng = np.random.default_rng(seed)

    def six(low: float, high: float) -> tuple[float, ...]:
        return tuple(rng.uniform(low, high, 6).tolist())

    def some(size: float) -> tuple[float, ...]:
        return tuple(rng.uniform(-size, size, harmonics).tolist())

    return Dimensionless(
        name="random",
        state="only",
        torque=rng.uniform(0.05, 1.0),
        mesh_damping_ratio=rng.uniform(0.0, 0.1),
        tangential_cosine=rng.uniform(0.3, 1.0),
        directions=six(-1, 1),
        mass_ratios=six(0.01, 1),
        bearing_stiffness=six(0.1, 3),
        bearing_damping=six(0, 0.1),
        stiffness_cosine=some(0.1),
        stiffness_sine=some(0.1),
        error_cosine=some(0.3),
        error_sine=some(0.3),
        coast_stiffness_ratio=rng.uniform(0.5, 1.5),
    )


def by_hand(d: Dimensionless, x: np.ndarray, theta: float, ratio: float, torque: float, xi: float) -> np.ndarray:
    """Equations (23)-(29) in plain NumPy, one line for each, without the engine."""
    lam, xp, yp, zp, xg, yg, zg, dlam, dxp, dyp, dzp, dxg, dyg, dzg = x
    j = np.arange(1, len(d.stiffness_cosine) + 1)
    i = np.arange(1, len(d.error_cosine) + 1)
    k = 1 + np.dot(d.stiffness_cosine, np.cos(j * theta)) + np.dot(d.stiffness_sine, np.sin(j * theta))
    e = np.dot(d.error_cosine, np.cos(i * theta)) + np.dot(d.error_sine, np.sin(i * theta))
    de = ratio * (-np.dot(i * d.error_cosine, np.sin(i * theta)) + np.dot(i * d.error_sine, np.cos(i * theta)))
    gap = lam - e
    f = gap - 1 if gap > 1 else d.coast_stiffness_ratio * (gap + 1) if gap < -1 else 0.0
    g = k * f + 2 * xi * (dlam - de)
    s, mu, kb, cb = d.directions, d.mass_ratios, d.bearing_stiffness, d.bearing_damping
    ddxp = -s[0] * mu[0] * g - 2 * cb[0] * dxp - kb[0] * xp
    ddyp = -s[1] * mu[1] * g - 2 * cb[1] * dyp - kb[1] * yp
    ddzp = -s[2] * mu[2] * g - 2 * cb[2] * dzp - kb[2] * zp
    ddxg = -s[3] * mu[3] * g - 2 * cb[3] * dxg - kb[3] * xg
    ddyg = -s[4] * mu[4] * g - 2 * cb[4] * dyg - kb[4] * yg
    ddzg = -s[5] * mu[5] * g - 2 * cb[5] * dzg - kb[5] * zg
    a3 = d.tangential_cosine
    translations = s[0] * ddxp + s[1] * ddyp + s[2] * ddzp + s[3] * ddxg + s[4] * ddyg + s[5] * ddzg
    ddlam = translations + a3 * torque - a3**2 * g
    return np.array([dlam, dxp, dyp, dzp, dxg, dyg, dzg, ddlam, ddxp, ddyp, ddzp, ddxg, ddyg, ddzg])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_right_hand_side_is_the_equations_written_by_hand(seed: int) -> None:
    d = random_pair(seed)
    system = gear_system(d)
    rng = np.random.default_rng(seed + 1)
    x, theta = rng.uniform(-3, 3, 14), rng.uniform(0, 7)
    ratio, torque, xi = rng.uniform(0.2, 3), rng.uniform(0.1, 1), rng.uniform(0, 0.2)
    found = system.rhs(x, theta, frequency_ratio=ratio, torque=torque, mesh_damping_ratio=xi)
    assert found == pytest.approx(by_hand(d, x, theta, ratio, torque, xi), abs=1e-12)
    found = system.rhs(x, theta, frequency_ratio=ratio)
    assert found == pytest.approx(by_hand(d, x, theta, ratio, d.torque, d.mesh_damping_ratio), abs=1e-12)


def test_names_parameters_and_defaults() -> None:
    system = gear_system(STATES["before"])
    assert system.state_names == (
        *("lambda", *COORDINATES),
        *("dlambda", "dx_p", "dy_p", "dz_p", "dx_g", "dy_g", "dz_g"),
    )
    assert system.defaults == {
        "frequency_ratio": 1.0,
        "torque": STATES["before"].torque,
        "mesh_damping_ratio": 0.02,
    }
    bearings = tuple(f"bearing_{name}" for name in COORDINATES)
    assert (system.frequency, system.output_names) == ("frequency_ratio", ("mesh_force", "deflection", *bearings))
    assert [(c.breakpoints, c.slopes) for c in system.contacts] == [((-1.0, 1.0), (1.0, 0.0, 1.0))]


def evaluate(system: System, expression: ca.SX, x: np.ndarray, theta: float) -> np.ndarray:
    f = ca.Function("f", [system.x, system.theta, system.p], [expression])
    return np.array(f(x, theta, system.parameter_vector())).squeeze()


@pytest.mark.parametrize("seed", range(3))
def test_outputs_are_mesh_force_and_deflection(seed: int) -> None:
    d = random_pair(seed)
    system = gear_system(d)
    x, theta = np.random.default_rng(seed).uniform(-2, 2, 14), 0.7
    outputs = ca.substitute(system.outputs, system.phi, system.forces())
    force, deflection, *bearings = evaluate(system, outputs, x, theta)
    balance = np.array(d.directions) * force + np.array(bearings)  # what is left accelerates: (24)-(29)
    assert system.rhs(x, theta)[8:] == pytest.approx(-np.array(d.mass_ratios) * balance)
    assert deflection == pytest.approx(x[0] - float(d.error(theta)))
    contact = max(deflection - 1, 0) + d.coast_stiffness_ratio * min(deflection + 1, 0)
    step = 1e-6
    rate = (float(d.error(theta + step)) - float(d.error(theta - step))) / (2 * step)  # frequency ratio 1
    expected = float(d.stiffness(theta)) * contact + 2 * d.mesh_damping_ratio * (x[7] - rate)
    assert force == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("width", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_trace_is_constant_in_and_out_of_contact(seed: int, width: float) -> None:
    d = random_pair(seed)
    system = gear_system(d)
    trace = ca.trace(ca.jacobian(system.closed(width), system.x))
    s, mu = np.array(d.directions), np.array(d.mass_ratios)
    xi, a3 = d.mesh_damping_ratio, d.tangential_cosine
    expected = -2 * (xi * a3**2 + xi * np.sum(s**2 * mu) + np.sum(d.bearing_damping))
    for gap in (-2.0, 0.3, 2.0):
        x = np.full(14, gap)
        assert float(evaluate(system, trace, x, 1.3)) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_without_harmonics_the_static_state_is_an_equilibrium(seed: int) -> None:
    d = random_pair(seed, harmonics=0)
    rest = static_state(d)
    for theta in (0.0, 2.0):
        assert gear_system(d).rhs(rest, theta) == pytest.approx(np.zeros(14), abs=1e-14)
    outputs = gear_system(d)
    force = evaluate(outputs, ca.substitute(outputs.outputs, outputs.phi, outputs.forces()), rest, 0.0)[0]
    assert force == pytest.approx(d.torque / d.tangential_cosine)


@pytest.mark.parametrize("name", STATES)
def test_mean_mesh_force_balances_the_translations(name: str) -> None:
    """Sum of s_i (q_i'' + damping + stiffness terms) + lambda'' has no other force than a3 T and G: virtual work."""
    d = STATES[name]
    x, theta = np.random.default_rng(5).uniform(-2, 2, 14), 0.4
    rate = gear_system(d).rhs(x, theta)
    s, mu = np.array(d.directions), np.array(d.mass_ratios)
    free = rate[8:] + 2 * np.array(d.bearing_damping) * x[8:] + np.array(d.bearing_stiffness) * x[1:7]
    force = -free / (s * mu)
    assert force == pytest.approx(np.full(6, force[0]), rel=1e-12)
    expected = s @ rate[8:] + d.tangential_cosine * d.torque - d.tangential_cosine**2 * force[0]
    assert rate[7] == pytest.approx(expected, rel=1e-12)


def test_numbers_made_in_python_are_checked_too() -> None:
    good = STATES["example"].to_dict()
    good = {k: tuple(v) if isinstance(v, list) else v for k, v in good.items()}
    assert Dimensionless(**good) == STATES["example"]
    for key, value, word in [
        ("torque", float("nan"), "finite"),
        ("torque", 0.0, "positive"),
        ("coast_stiffness_ratio", 0.0, "positive"),
        ("directions", (1.0,), "six"),
        ("bearing_damping", (-1.0,) * 6, "zero or positive"),
        ("stiffness_sine", (0.0,), "equal numbers"),
        ("stiffness_cosine", (1.2, 0.0), "mesh phase"),
    ]:
        with pytest.raises(PairError, match=word):
            Dimensionless(**{**good, key: value})
