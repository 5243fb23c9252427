"""Virtual work against the eight printed equations, and the seven-coordinate form derived from them."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sbg_casadi import UserError, gear_system, load_pair
from sbg_casadi.dimensionless import COORDINATES
from sbg_casadi.equations import (
    EIGHT,
    accelerations,
    eight_coordinate_system,
    relative_system,
    transmission_error,
    virtual_work,
)
from sbg_casadi.physical import Physical

a1, a2, a3, r_p, r_g = GEOMETRY = [ca.SX.sym(n) for n in ("a1", "a2", "a3", "r_p", "r_g")]
F_n, T_m, T_l = LOADS = [ca.SX.sym(n) for n in ("F_n", "T_m", "T_l")]

PRINTED = {  # right-hand sides of (1)-(8), term by term
    "z_p": -F_n * a3,
    "z_g": F_n * a3,
    "y_p": -F_n * a2,
    "y_g": F_n * a2,
    "x_p": F_n * a1,
    "x_g": -F_n * a1,
    "theta_g": r_g * F_n * a3 - T_l,
    "phi_p": -r_p * F_n * a3 + T_m,
}


def symbols(prefix: str = "") -> dict[str, ca.SX]:
    return {name: ca.SX.sym(prefix + name) for name in EIGHT}


def work() -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
    q = symbols()
    return q, virtual_work(q, transmission_error(q, (a1, a2, a3), r_p, r_g), F_n, T_m, T_l)


def vanishes(expression: ca.SX) -> bool:
    """Decide exactly whether a polynomial of degree two or less, with small whole coefficients, is zero."""
    x = ca.vertcat(*ca.symvar(expression))
    if not x.numel():
        return float(ca.evalf(expression)) == 0
    hessian, gradient = ca.hessian(expression, x)
    assert not ca.symvar(ca.simplify(hessian)), "of a higher degree than two"
    at_zero = ca.Function("f", [x], [expression, gradient, hessian])(0)
    return all(not np.any(v.full()) for v in at_zero)


@pytest.mark.parametrize("name", EIGHT)
def test_virtual_work_is_the_printed_right_hand_side_coefficient_by_coefficient(name: str) -> None:
    q, found = work()
    known = ca.vertcat(*LOADS, *q.values())
    derived, printed = (ca.jacobian(expression, known) for expression in (found[name], PRINTED[name]))
    for j in range(known.numel()):
        assert vanishes(derived[j] - printed[j]), known[j]
    # The coefficients hold no load and no coordinate, so that nothing nonlinear can hide in them.
    assert not ca.depends_on(derived, known)
    zero = ca.DM.zeros(known.numel())
    assert vanishes(ca.substitute(found[name], known, zero))
    assert vanishes(ca.substitute(PRINTED[name], known, zero))


def test_the_check_sees_a_wrong_sign_and_a_wrong_factor() -> None:
    assert vanishes(a1 * r_p - r_p * a1)
    assert not vanishes(a1 * r_p - r_p * a2)
    assert not vanishes(2 * a3 - a3)
    assert not vanishes(a3 + 1 - a3)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_left_hand_sides_are_mass_damping_and_stiffness_of_each_coordinate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, rate = symbols(), symbols("d")
    m, k, c = rng.uniform(0.1, 9, (3, 6))
    inertias = rng.uniform(0.1, 9, 2)
    second = accelerations(work()[1], q, rate, m, inertias, k, c)
    state = ca.vertcat(*q.values(), *rate.values())
    expected = np.zeros((8, 16))
    for i in range(6):
        expected[i, i], expected[i, 8 + i] = -k[i] / m[i], -c[i] / m[i]
    found = ca.jacobian(ca.vertcat(*(second[n] for n in EIGHT)), state)
    assert not ca.depends_on(found, ca.vertcat(*GEOMETRY, *LOADS))
    assert ca.evalf(found).full() == pytest.approx(expected, rel=1e-14)
    for n, mass in zip(EIGHT, [*m, *inertias], strict=True):
        at_rest = ca.substitute(second[n], state, ca.DM.zeros(16))
        values = rng.uniform(-2, 2, 8)
        f = ca.Function("f", [ca.vertcat(*GEOMETRY, *LOADS)], [at_rest * mass, PRINTED[n]])
        ours, theirs = (float(v) for v in f(values))
        assert ours == pytest.approx(theirs, rel=1e-13, abs=1e-14)


def random_physical(seed: int, *, error: float = 0.3, damping: float = 1.0, load: float = 1.0) -> Physical:
    """A pair of arbitrary size with every number drawn; lengths near 1e-4 m, omega_n near 1e4 rad/s."""
    rng = np.random.default_rng(seed)
    r, m, i = rng.uniform(0.02, 0.2, 2), rng.uniform(0.5, 5, 2), rng.uniform(1e-3, 1e-2, 2)
    k_0, b = rng.uniform(1e8, 1e9), rng.uniform(2e-5, 2e-4)
    force = load * rng.uniform(0.1, 1) * k_0 * b
    series = rng.uniform(-0.1, 0.1, (4, 3)) * np.array([k_0, k_0, error * b * 10, error * b * 10])[:, None]
    return Physical(
        name="random",
        state="only",
        cosines=(float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1)), float(rng.uniform(0.3, 1))),
        pinion_radius=float(r[0]),
        gear_radius=float(r[1]),
        pinion_mass=float(m[0]),
        gear_mass=float(m[1]),
        pinion_inertia=float(i[0]),
        gear_inertia=float(i[1]),
        bearing_stiffness=tuple(rng.uniform(1e8, 1e9, 6).tolist()),
        bearing_damping=tuple((damping * rng.uniform(1e2, 1e3, 6)).tolist()),
        mesh_stiffness=k_0,
        mesh_damping=damping * float(rng.uniform(1e2, 1e3)),
        half_backlash=b,
        pinion_torque=force * float(r[0]),
        gear_torque=force * float(r[1]),
        stiffness_cosine=tuple(series[0].tolist()),
        stiffness_sine=tuple(series[1].tolist()),
        error_cosine=tuple(series[2].tolist()),
        error_sine=tuple(series[3].tolist()),
        coast_stiffness_ratio=float(rng.uniform(0.5, 1.5)),
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_derived_seven_coordinates_are_the_written_equations(seed: int) -> None:
    physical = random_physical(seed)
    written, derived = gear_system(physical.dimensionless()), relative_system(physical)
    assert derived.state_names == written.state_names
    rng = np.random.default_rng(seed + 1)
    for scale in (0.5, 3.0):
        x, theta, ratio = rng.uniform(-scale, scale, 14), rng.uniform(0, 7), rng.uniform(0.2, 3)
        expected = written.rhs(x, theta, frequency_ratio=ratio)
        found = derived.rhs(x, theta, frequency_ratio=ratio)
        assert found == pytest.approx(expected, rel=1e-11, abs=1e-11 * np.abs(expected).max())


def test_symbolic_work_costs_few_operations() -> None:
    """At most a fifth more than the equations written out by hand with every common factor taken once."""
    d = load_pair("iso-f2").dimensionless("before")
    system = gear_system(d)
    ours = ca.Function("ours", [system.x, system.phi, system.theta, system.p], [system.derivative])
    x, phi, theta, p = (ca.SX.sym(n, k) for n, k in (("x", 14), ("phi", 1), ("theta", 1), ("p", 3)))
    k = 1 + d.stiffness_cosine[0] * ca.cos(theta) + d.stiffness_cosine[1] * ca.cos(2 * theta)
    g = k * phi + 2 * p[2] * x[7]
    total, second = d.tangential_cosine * p[1] - d.tangential_cosine**2 * g, []
    for i in range(6):
        s, mu = d.directions[i], d.mass_ratios[i]
        second.append(-(s * mu) * g - 2 * d.bearing_damping[i] * x[8 + i] - d.bearing_stiffness[i] * x[1 + i])
        total += s * second[-1]
    hand = ca.Function("hand", [x, phi, theta, p], [ca.vertcat(x[7:], total, *second)])
    assert ours.n_nodes() <= 1.2 * hand.n_nodes()
    point = (np.arange(14) / 7, 0.3, 0.4, [1.1, 0.2, 0.02])
    assert ours(*point).full() == pytest.approx(hand(*point).full(), rel=1e-13)


@pytest.mark.parametrize("state", ["before", "after"])
def test_scaling_to_si_and_back_gives_the_numbers_of_the_file(state: str) -> None:
    pair = load_pair("iso-f2")
    expected, found = pair.dimensionless(state).to_dict(), Physical.of(pair, state).dimensionless().to_dict()
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-13))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_rigid_rotation_changes_no_acceleration(seed: int) -> None:
    """Galilean invariance: r_p phi_p and r_g theta_g shifted by the same arc, at rest or moving."""
    physical = random_physical(seed)
    system, rng = eight_coordinate_system(physical), np.random.default_rng(seed)
    x = rng.uniform(-3, 3, 16) * physical.half_backlash
    x[8:] *= physical.natural_frequency
    arc, speed = rng.uniform(-1e-2, 1e-2), rng.uniform(-10, 10)
    moved = x.copy()
    for i, radius in ((6, physical.pinion_radius), (7, physical.gear_radius)):
        moved[i] += arc / radius
        moved[8 + i] += speed / radius
    before, after = system.rhs(x, 0.7)[8:], system.rhs(moved, 0.7)[8:]
    assert after == pytest.approx(before, rel=1e-10, abs=1e-10 * np.abs(before).max())


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_momentum_of_the_rotations_is_kept_by_balanced_torques(seed: int) -> None:
    """I_p phi_p'' / r_p + I_g theta_g'' / r_g = T_m / r_p - T_l / r_g = 0: the mean speed stays."""
    physical = random_physical(seed)
    x = np.random.default_rng(seed).uniform(-3, 3, 16) * physical.half_backlash
    second = eight_coordinate_system(physical).rhs(x, 0.3)[14:]
    terms = second * [
        physical.pinion_inertia / physical.pinion_radius,
        physical.gear_inertia / physical.gear_radius,
    ]
    assert abs(terms.sum()) < 1e-11 * np.abs(terms).max() + 1e-9


def test_unbalanced_torques_say_why_they_are_refused() -> None:
    good = random_physical(3)
    values = {f: getattr(good, f) for f in Physical.__dataclass_fields__}
    with pytest.raises(UserError, match=r"the speed drifts, so the mesh stiffness K\(t\) is not periodic"):
        Physical(**values | {"gear_torque": 1.01 * good.gear_torque})
    with pytest.raises(UserError, match="pinion_mass = 0; expected a positive number"):
        Physical(**values | {"pinion_mass": 0.0})
    with pytest.raises(UserError, match="coast_stiffness_ratio = 0; expected a positive number"):
        Physical(**values | {"coast_stiffness_ratio": 0.0})
    with pytest.raises(UserError, match="expected finite numbers"):
        Physical(**values | {"mesh_damping": float("nan")})


def test_a_dimensionless_pair_has_no_eight_coordinates() -> None:
    with pytest.raises(UserError, match="masses, radii and backlash are unknown"):
        Physical.of(load_pair("example"))


def test_the_six_displacements_come_first() -> None:
    assert EIGHT[:6] == COORDINATES
