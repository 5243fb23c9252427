"""Fourier coefficients of the port forces, their slopes and their parameter derivatives, by all three paths."""

import casadi as ca
import general_contacts as general
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, ContinuationError, System, UnsupportedModel
from continuation.model.ports import Ports
from continuation.orbits.port_force import PortForces


def two_meshes() -> System:
    """Two contacts that enter linearly; parameters act on gains, offsets, argument slopes and a smooth part."""
    x, v, y, w, theta, omega, g, c, e = rs.symbols("x", "v", "y", "w", "theta", "omega", "g", "c", "e")
    a = Contact(argument=x - c * y + e * ca.cos(theta) - g * ca.sin(2 * theta) * omega, breakpoints=(-0.5, 0.6),
                slopes=(1, 0, 2))  # fmt: skip
    b = Contact(argument=y + e * x, breakpoints=(0.1,), slopes=(0, 1.0))
    return System(
        name="two meshes",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v,
            "v": -x - 0.1 * v - (1 + g * ca.cos(theta) + c * ca.cos(3 * theta)) * a.force - e * x**3,
            "y": w,
            "w": -y - 0.2 * w + a.force * (1 + c**2) - omega * b.force * (1 + 0.2 * ca.sin(theta) * g)
            + ca.sin(y * g + theta),
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.1), "g": (g, 0.3), "c": (c, 0.4), "e": (e, 0.2)},
        contacts=[a, b],
    )  # fmt: skip


SYSTEMS = general.GENERAL | {"two meshes": two_meshes, "smoothed": lambda: two_meshes().smoothed(0.2)}


def wave(name, ports, H=6):
    """A waveform of the port arguments with many contact changes, none of them grazing; a radius that stays off 0."""
    rng = np.random.default_rng(0)
    shape = (H + 1, ports.outputs)
    Y = 1.5 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / (1 + np.arange(H + 1))[:, None] ** 1.5
    Y[0] = Y[0].real
    if name == "radial gap":
        Y *= 0.1
        Y[1] = [0.5, -0.6j]
    return Y


def on_a_grid(ports, Y, multiple, count=1 << 17):
    """Port force of the law and the contacts, sampled from the right-hand side; trapezoidal coefficients."""
    system, p = ports.system, ports.system.parameter_vector()
    t = 2 * np.pi * (np.arange(count) + 0.5) / count
    k = np.arange(len(Y))
    y = sum(np.where(j == 0, 1, 2) * (Y[j][:, None] * np.exp(1j * j * t)).real for j in k)
    x = np.zeros((len(system.state_names), count))
    x[ports.cols] = y
    rhs = ca.Function("rhs", [system.x, system.theta, system.p], [system.closed()])
    u = ports.forcing(p).u
    forced = sum(np.where(j == 0, 1, 2) * (u[j][:, None] * np.exp(1j * j * multiple * t)).real for j in range(len(u)))
    w = (np.array(rhs(x, (t * multiple)[None], p)) - ports.linear(p).A @ x - forced)[ports.rows]
    return np.array([(w * np.exp(-1j * j * t)).mean(axis=1) for j in range(10)])


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("multiple", [1, 2])
def test_force_against_fine_sampling(name, multiple):
    ports = Ports(SYSTEMS[name]())
    Y = wave(name, ports)
    W = PortForces(ports, multiple)(Y, ports.system.parameter_vector(), 9, 0).W
    assert np.abs(W - on_a_grid(ports, Y, multiple)).max() < 2e-9 * max(1.0, np.abs(W).max())  # about N^-2 of the grid


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("multiple", [1, 2])
def test_slope_is_the_derivative_of_the_force(name, multiple):
    ports = Ports(SYSTEMS[name]())
    p, Y, forces = ports.system.parameter_vector(), wave(name, ports), PortForces(ports, multiple)
    slope = forces(Y, p, 8, 14).slope
    move = wave("", ports)[::-1] * 0.3
    move[0] = move[0].real
    both = np.concatenate([move[:0:-1].conj(), move])
    exact = np.array([sum(slope[14 + k - l] @ both[6 + l] for l in range(-6, 7)) for k in range(9)])  # noqa: E741

    def difference(h):
        return (forces(Y + h * move, p, 8, 0).W - forces(Y - h * move, p, 8, 0).W) / (2 * h)

    assert np.abs((4 * difference(1e-4) - difference(2e-4)) / 3 - exact).max() < 1e-9 * max(1.0, np.abs(exact).max())


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("multiple", [1, 2])
def test_parameter_derivatives(name, multiple):
    ports = Ports(SYSTEMS[name]())
    p, Y, forces = ports.system.parameter_vector(), wave(name, ports), PortForces(ports, multiple)
    for index, unit in enumerate(np.eye(len(p))):

        def difference(h, unit=unit):
            return (forces(Y, p + h * unit, 9, 0).W - forces(Y, p - h * unit, 9, 0).W) / (2 * h)

        exact = forces.parameter_derivative(Y, p, 9, index)
        assert np.abs((4 * difference(1e-4) - difference(2e-4)) / 3 - exact).max() < 1e-8


def test_both_paths_give_the_same_coefficients():
    closed, inside = Ports(general.backlash(general=False)), Ports(general.backlash())
    assert (closed.closed, inside.general) == ((0,), (0,))
    Y, p = wave("", closed, H=20), np.array([0.7, 0.0])
    one, other = (PortForces(ports, 1) for ports in (closed, inside))
    for a, b in zip((one(Y, p, 30, 40).W, one(Y, p, 30, 40).slope), (other(Y, p, 30, 40).W, other(Y, p, 30, 40).slope),
                    strict=True):  # fmt: skip
        assert np.abs(a - b).max() < 1e-13


@pytest.mark.parametrize("depth", [-1e-3, -1e-7, -1e-11, 0.0, 1e-11, 1e-7, 1e-3])
def test_force_next_to_grazing(depth):
    """cos(t - 0.3) over a stop at 1 - depth: the coefficients of a penetration that all but vanishes."""
    x, v, theta, omega, e = rs.symbols("x", "v", "theta", "omega", "e")
    stop = Contact(argument=x, breakpoints=(1.0 - depth,), slopes=(0.0, 1.0))
    for gain in (1.0, 1 + e * x):
        system = System(name="stop", states={"x": x, "v": v}, derivatives={"x": v, "v": -gain * stop.force},
                        phase=theta, frequency="omega", parameters={"omega": (omega, 1.0), "e": (e, 0.0)},
                        contacts=[stop])  # fmt: skip
        ports = Ports(system)
        force = PortForces(ports, 1)(np.array([[0], [0.5 * np.exp(-0.3j)]]), system.parameter_vector(), 3, 3)
        half = np.arccos(1 - depth) if depth > 0 else 0.0
        level = (np.sin(half) - (1 - depth) * half) / np.pi  # mean of the penetration
        assert abs(force.W[0, 0] + level) < 1e-15
        assert abs(force.slope[3, 0, 0] + half / np.pi) < 1e-8  # the phase of a touch is known to the root of rounding
        assert force.W[1, 0] == pytest.approx(force.W[0, 0] * np.exp(-0.3j), abs=max(abs(depth), 0) ** 2 + 1e-15)


def test_a_radius_that_passes_through_zero():
    """The corner of the radius is where the gap is open; the force is that of a dead zone, known in closed form."""
    ports = Ports(general.radial_gap())
    Y, p = np.zeros((2, 2), dtype=complex), ports.system.parameter_vector()
    Y[1, 0] = np.exp(0.2j)  # 2 cos(t + 0.2) along x
    half = np.arccos(0.5)
    exact = -3 * (2 * half + np.sin(2 * half) - 2 * np.sin(half)) / np.pi
    linear = PortForces(ports, 1)(0.4 * Y, p, 1, 1).W[1, 0] / 0.4
    assert (PortForces(ports, 1)(Y, p, 1, 1).W[1, 0] - linear) * np.exp(-0.2j) == pytest.approx(exact, abs=1e-9)


def test_an_argument_that_jumps_is_refused_in_words():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x + 0.1 * ca.sign(x))
    system = System(name="jump", states={"x": x, "v": v}, derivatives={"x": v, "v": -x**3 * mesh.force},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[mesh])  # fmt: skip
    with pytest.raises(UnsupportedModel, match="jumps"):
        Ports(system)
    mesh = rs.dead_zone(x**3 + 0.1 * ca.sign(x))
    system = System(name="jump", states={"x": x, "v": v}, derivatives={"x": v, "v": -mesh.force},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[mesh])  # fmt: skip
    with pytest.raises(UnsupportedModel, match=r"contact 'mesh' .* argument is not smooth along the orbit"):
        PortForces(Ports(system), 1)(np.array([[0.4], [0.75]]), system.parameter_vector(), 5, 5)


def test_a_hidden_corner_between_contact_changes_is_refused():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x)
    push = mesh.force * (1 + 0.1 * ca.sign(x - 1.3))  # a jump inside the contact
    system = System(name="jump", states={"x": x, "v": v}, derivatives={"x": v, "v": -x * mesh.force - push},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[mesh])  # fmt: skip
    with pytest.raises(ContinuationError, match="declare"):
        PortForces(Ports(system), 1)(np.array([[0.4], [0.75]]), system.parameter_vector(), 5, 5)
