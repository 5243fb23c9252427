"""System: names and symbols are checked, the smoothed law and the exact one come from one definition."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, System


def build(**changes):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    given = {
        "name": "linear",
        "states": {"x": x, "v": v},
        "derivatives": {"x": v, "v": -x - 0.1 * v + ca.cos(theta)},
        "phase": theta,
        "frequency": "omega",
        "parameters": {"omega": (omega, 0.5)},
    }
    return System(**(given | changes))


def test_right_hand_side_is_the_written_one():
    x, v, theta = 0.4, -0.7, 1.1
    expected = [v, -0.05 * v - x - 0.1 * x**3 + 0.3 * np.cos(theta)]
    assert rs.duffing().rhs([x, v], theta, g=0.3) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("x", [-3.0, -1.0, 0.2, 1.0, 2.5])
def test_contact_enters_the_right_hand_side(x):
    dead = np.sign(x) * max(abs(x) - 1.0, 0.0)
    acceleration = rs.parametric_backlash().rhs([x, 0.3], 0.7)[1]
    assert acceleration == pytest.approx(0.5 - 0.03 - (1 + 0.3 * np.cos(0.7)) * dead, abs=1e-15)


def test_vectors_of_mx_symbols_are_accepted():
    x, v, theta, omega = (ca.MX.sym(n) for n in ("x", "v", "theta", "omega"))
    system = build(
        states={"x": x, "v": v}, derivatives={"x": v, "v": -x - 0.1 * v + ca.cos(theta)}, phase=theta,
        parameters={"omega": (omega, 0.5)},
    )  # fmt: skip
    assert system.rhs([0.3, 0.2], 0.4) == pytest.approx(build().rhs([0.3, 0.2], 0.4), abs=1e-16)


def test_numbers_may_stand_for_expressions():
    x, v = rs.symbols("x", "v")
    system = System(name="ramp", states={"x": x, "v": v}, derivatives={"x": v, "v": 2.0}, parameters={})
    assert system.autonomous
    assert system.rhs([1.0, 3.0], 0.0).tolist() == [3.0, 2.0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"derivatives": {"x": 0.0}}, "same names; only one has .'v'."),
        ({"states": {}, "derivatives": {}}, "at least one state"),
        ({"phase": None}, "phase and frequency go together"),
        ({"frequency": None}, "phase and frequency go together"),
        ({"frequency": "omgea"}, "did you mean 'omega'"),
        ({"parameters": {"omega": (ca.SX.sym("omega"), float("nan"))}}, "expected a finite number, got nan"),
        ({"derivatives": {"x": 0.0, "v": ca.SX.sym("stray")}}, "symbol 'stray' is neither"),
    ],
)
def test_misuse_names_what_is_wrong(changes, words):
    with pytest.raises(ValueError, match=words):
        build(**changes)


def test_a_contact_must_be_declared():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x)
    with pytest.raises(ValueError, match="symbol 'mesh_force"):
        build(states={"x": x, "v": v}, derivatives={"x": v, "v": -mesh.force}, phase=theta,
              parameters={"omega": (omega, 0.5)})  # fmt: skip


def test_unknown_parameters_name_the_nearest():
    with pytest.raises(ValueError, match="no parameter 'omgea'; did you mean 'omega'"):
        rs.duffing().with_parameters(omgea=1.0)
    with pytest.raises(ValueError, match="no parameter 'force'"):
        rs.duffing().rhs([0.0, 0.0], 0.0, force=1.0)


def test_other_defaults_make_another_system():
    system = rs.duffing()
    other = system.with_parameters(g=0.5)
    assert (system.defaults["g"], other.defaults["g"]) == (0.18, 0.5)
    assert other.rhs([0.0, 0.0], 0.0)[1] == pytest.approx(0.5)


@pytest.mark.parametrize("width", [1e-3, 0.1])
def test_smoothed_law_is_the_textbook_one(width):
    smooth, x = rs.backlash().smoothed(width), 1.03
    corner = x + (np.sqrt((x - 1) ** 2 + width**2) - np.sqrt((x + 1) ** 2 + width**2)) / 2
    assert smooth.contacts == ()
    assert smooth.rhs([x, 0.0], np.pi / 2, omega=1.0)[1] == pytest.approx(0.1 - corner, abs=1e-14)


def test_smoothing_leaves_the_exact_system_alone():
    exact = rs.backlash()
    exact.smoothed(0.1)
    assert exact.smoothed(0.0) is exact
    assert exact.rhs([1.5, 0.0], np.pi / 2)[1] == pytest.approx(-0.4, abs=1e-15)
    assert rs.duffing().smoothed(0.1).contacts == ()


@pytest.mark.parametrize("width", [-0.1, float("nan"), float("inf")])
def test_smoothing_width_is_checked(width):
    with pytest.raises(ValueError, match="smoothing width"):
        rs.backlash().smoothed(width)


def test_system_prints_its_kind():
    assert repr(rs.backlash()) == (
        "System('backlash': 2 states, 1 parameter, phase theta with frequency omega, 1 contact)"
    )
    x = ca.SX.sym("x")
    decay = System(name="decay", states={"x": x}, derivatives={"x": -x}, parameters={})
    assert repr(decay) == "System('decay': 1 state, 0 parameters, autonomous, 0 contacts)"


def test_two_contacts_of_one_name_stay_apart():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    left = Contact(argument=x, breakpoints=(-1.0,), slopes=(2.0, 0.0))
    right = Contact(argument=x, breakpoints=(1.0,), slopes=(0.0, 3.0))
    system = build(states={"x": x, "v": v}, derivatives={"x": v, "v": -left.force - right.force}, phase=theta,
                   parameters={"omega": (omega, 0.5)}, contacts=[left, right])  # fmt: skip
    assert system.rhs([2.0, 0.0], 0.0)[1] == pytest.approx(-3.0)
    assert system.rhs([-2.0, 0.0], 0.0)[1] == pytest.approx(2.0)
