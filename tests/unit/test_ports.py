"""Port structure: how many ports a System has, that the split is exact, and what it refuses."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, HarmonicBalance, System, UnsupportedModel
from continuation.model.ports import Ports


def contact_forces(system, ports, y, theta, p):
    linear, forcing = ports.linear(p), ports.forcing(p)
    total = np.zeros(ports.inputs)
    for i, contact in enumerate(system.contacts):
        wave = np.exp(1j * theta * np.arange(forcing.gain.shape[-1]))
        gain = 2 * (forcing.gain[i] @ wave).real - forcing.gain[i, :, 0].real
        offset = 2 * (forcing.offset[i] @ wave).real - forcing.offset[i, 0].real
        total += gain * contact.value(linear.d[i] @ y + offset)
    return total


SYSTEMS = {
    "duffing": (rs.duffing, 1, 1),
    "linear": (rs.linear_oscillator, 1, 1),
    "absorber": (rs.absorber, 2, 2),
    "mathieu": (lambda: rs.mathieu(1.0), 1, 1),
    "backlash": (rs.backlash, 1, 1),
    "two stops": (lambda: rs.stops(damping=0.1, gain=0.3, force=0.5, width=0.4, stops=2), 2, 2),
    "van der Pol": (rs.coupled_van_der_pol, 4, 4),
    "gear pair": (rs.gear, 1, 1),
    "smoothed gear pair": (lambda: rs.gear().smoothed(0.01), 1, 1),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_split_is_exact_and_as_small_as_it_can_be(name):
    build, inputs, outputs = SYSTEMS[name]
    system = build()
    ports = Ports(system)
    assert (ports.inputs, ports.outputs) == (inputs, outputs)
    rng, p = np.random.default_rng(5), system.parameter_vector()
    part, forcing = ports.linear(p), ports.forcing(p)
    for _ in range(5):
        x, theta = 2 * rng.standard_normal(len(system.state_names)), rng.uniform(0, 2 * np.pi)
        y = part.C @ x
        w = contact_forces(system, ports, y, theta, p)
        if ports.smooth:
            w = w + ports.law(y[:, None], np.array([theta]), p)[0][:, 0]
        wave = np.exp(1j * theta * np.arange(len(forcing.u)))
        u = (2 * wave @ forcing.u).real - forcing.u[0].real
        assert part.A @ x + u + part.B @ w == pytest.approx(system.rhs(x, theta), abs=1e-11)


def test_slope_of_the_law_is_its_derivative():
    ports = Ports(rs.absorber())
    p, y, theta = ports.system.parameter_vector(), np.array([[0.4], [-0.7]]), np.array([0.3])
    slope = ports.law(y, theta, p)[1][..., 0]
    for j, step in enumerate(1e-6 * np.eye(2)):
        change = ports.law(y + step[:, None], theta, p)[0] - ports.law(y - step[:, None], theta, p)[0]
        assert change[:, 0] / 2e-6 == pytest.approx(slope[:, j], abs=1e-8)


def oscillator(acceleration, contact):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    law = contact(x, v, theta)
    return System(name="odd", states={"x": x, "v": v}, derivatives={"x": v, "v": acceleration(x, v, theta, law.force)},
                  phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[law])  # fmt: skip


def test_gain_that_depends_on_states_is_refused():
    system = oscillator(lambda x, v, t, f: -v - (1 + x**2) * f, lambda x, v, t: rs.dead_zone(x))
    with pytest.raises(UnsupportedModel, match=r"contact 'mesh'.*gain of phase and parameters only.*Shooting"):
        HarmonicBalance().discretise(system, "omega")


def test_force_that_enters_squared_is_refused():
    system = oscillator(lambda x, v, t, f: -v - f**2, lambda x, v, t: rs.dead_zone(x))
    with pytest.raises(UnsupportedModel, match="enter linearly"):
        HarmonicBalance().discretise(system, "omega")


@pytest.mark.parametrize("argument", [lambda x, v, t: x**2, lambda x, v, t: x * ca.cos(t)])
def test_argument_that_is_not_linear_with_constants_is_refused(argument):
    def law(x, v, t):
        return Contact(argument=argument(x, v, t), breakpoints=(1.0,), slopes=(0.0, 1.0))

    with pytest.raises(UnsupportedModel, match="argument must be linear in the states"):
        HarmonicBalance().discretise(oscillator(lambda x, v, t, f: -v - x - f, law), "omega")


def test_forcing_with_a_corner_is_refused():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(name="square", states={"x": x, "v": v},
                    derivatives={"x": v, "v": -x - 0.1 * v - x**3 + ca.sign(ca.cos(theta))}, phase=theta,
                    frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
    with pytest.raises(UnsupportedModel, match="not a smooth function of the phase"):
        HarmonicBalance().discretise(system, "omega").guess(omega=0.5)


@pytest.mark.parametrize("jump", [lambda x, v: ca.sign(x), lambda x, v: ca.sign(v), lambda x, v: ca.floor(3 * x)])
@pytest.mark.parametrize("cubic", [0.0, 1.0])
def test_hidden_jump_is_refused(jump, cubic):
    """CasADi differentiates a step to zero, so that nothing in the Jacobian shows it; it must not get lost."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(name="hidden", states={"x": x, "v": v},
                    derivatives={"x": v, "v": -x - 0.1 * v - cubic * x**3 - 0.1 * jump(x, v) + ca.cos(theta)},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 0.5)})  # fmt: skip
    with pytest.raises(UnsupportedModel):
        HarmonicBalance(harmonics=15).discretise(system, "omega").guess(omega=0.5)
