"""Port structure: how many ports a System has, that the split is exact, and what it refuses."""

import casadi as ca
import general_contacts as general
import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, System, UnsupportedModel
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


@pytest.mark.parametrize(
    ("name", "closed", "inside", "sizes"),
    [
        ("hertz", (), (0,), (1, 1)),
        ("hunt", (), (0,), (1, 2)),
        ("squared", (), (0,), (1, 1)),
        ("bent", (), (0,), (1, 1)),
        ("radial gap", (), (0,), (2, 2)),
        ("three kinds", (1,), (0, 2), (2, 3)),
    ],
)
def test_contacts_that_do_not_enter_linearly_are_part_of_the_law(name, closed, inside, sizes):
    system = general.GENERAL[name]()
    ports = Ports(system)
    assert (ports.closed, ports.general, (ports.inputs, ports.outputs)) == (closed, inside, sizes)
    rng, p = np.random.default_rng(5), system.parameter_vector()
    part, forcing = ports.linear(p), ports.forcing(p)
    for _ in range(20):
        x, theta = 2 * rng.standard_normal(len(system.state_names)), rng.uniform(0, 2 * np.pi)
        y = part.C @ x
        w = contact_forces(system, ports, y, theta, p) + ports.law(y[:, None], np.array([theta]), p)[0][:, 0]
        wave = np.exp(1j * theta * np.arange(len(forcing.u)))
        u = (2 * wave @ forcing.u).real - forcing.u[0].real
        assert part.A @ x + u + part.B @ w == pytest.approx(system.rhs(x, theta), abs=1e-10)


@pytest.mark.parametrize("name", general.GENERAL)
def test_slope_of_a_law_with_contacts_is_its_derivative(name):
    ports = Ports(general.GENERAL[name]())
    rng, p = np.random.default_rng(7), ports.system.parameter_vector()
    y, theta = 1.2 * rng.standard_normal((ports.outputs, 200)), rng.uniform(0, 2 * np.pi, 200)
    modes = ports.law.modes(y, theta, p)
    assert len(np.unique(modes)) > 1
    slope, unit = ports.law(y, theta, p)[1], np.eye(ports.outputs)
    for step in unit:
        ahead, back = (y + sign * 1e-6 * step[:, None] for sign in (1, -1))
        same = np.all(ports.law.modes(ahead, theta, p) == ports.law.modes(back, theta, p), axis=0)
        along = np.repeat(step[:, None], len(theta), axis=1)
        bends = [ports.law.forms.second(y, theta, p, modes, along, np.repeat(e[:, None], len(theta), 1)) for e in unit]
        bend = np.stack(bends, axis=1)
        deep = same & (np.abs(bend).max(axis=(0, 1)) < 30)  # phi**1.5 has no second derivative at 0
        force, steep = (a - b for a, b in zip(ports.law(ahead, theta, p), ports.law(back, theta, p), strict=True))
        assert force[:, deep] / 2e-6 == pytest.approx(np.einsum("mkn,k->mn", slope, step)[:, deep], abs=1e-7)
        assert steep[..., deep] / 2e-6 == pytest.approx(bend[..., deep], abs=1e-6)


def test_force_stays_on_the_side_of_the_corner_that_is_meant():
    """A rounding error before the corner must not make the 3/2 power of a negative number."""
    ports = Ports(general.hertz())
    p, y = ports.system.parameter_vector(), np.array([[0.5 - 1e-13, 0.5 + 1e-13]])
    closed, open_gap = np.ones((1, 2), dtype=int), np.zeros((1, 2), dtype=int)
    force, slope = ports.law(y, np.zeros(2), p, closed)
    assert np.abs(force).max() < 1e-15
    assert np.abs(slope).max() < 1e-5
    assert np.abs(ports.law(y, np.zeros(2), p, open_gap)[1]).max() == 0.0
    one = np.ones((1, 2))
    assert np.isfinite(ports.law.forms.second(y, np.zeros(2), p, open_gap, one, one)).all()


def test_frequency_in_a_contact_argument_counts_as_explicit():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x - omega**2)
    system = System(name="spun", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - v - mesh.force},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[mesh])  # fmt: skip
    assert Ports(system).frequency_explicit
    problem = HarmonicBalance(harmonics=7).discretise(system, "omega")
    u, h = np.random.default_rng(1).standard_normal(15), 1e-5
    fine, coarse = ((problem.residual(u, 1 + s) - problem.residual(u, 1 - s)) / (2 * s) for s in (h, 2 * h))
    assert problem.linearise(u, 1.0)[2] == pytest.approx((4 * fine - coarse) / 3, abs=1e-8)


def test_contact_inside_a_contact_is_refused():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    outer = rs.dead_zone(x, name="outer")
    inner = rs.dead_zone(x - 0.1 * outer.force, name="inner")
    with pytest.raises(UnsupportedModel, match=r"contact 'inner'.*depends on the force of contact 'outer'.*a state"):
        System(name="nested", states={"x": x, "v": v}, derivatives={"x": v, "v": -v - inner.force - outer.force},
               phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[outer, inner])  # fmt: skip


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
