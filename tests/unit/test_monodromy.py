"""Monodromy matrices along any waveform, orbit or not, against SciPy integrating between contact changes."""

import itertools

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from continuation import Contact, HarmonicBalance, System
from continuation.orbits.contact_series import evaluate
from continuation.orbits.floquet import distance, verdict
from continuation.orbits.monodromy import monodromy, multipliers, transition_matrices
from continuation.orbits.spectrum import pack, unpack
from continuation.orbits.waves import _series


def by_scipy(problem, Y, p, edges):
    """Transition matrix of the linearised equations along a waveform of the port arguments, from edge to edge."""
    system, vector, omega = problem.system, problem.vector(p), problem.frequency(p)
    part, n, multiple = problem.ports.linear(vector), len(problem.system.state_names), problem.period_multiple
    phi = ca.SX.sym("m", len(system.contacts))
    slope = ca.jacobian(system.arguments, system.x)
    J = ca.jacobian(system.derivative, system.x) + ca.jacobian(system.derivative, system.phi) @ ca.diag(phi) @ slope
    jacobian = ca.Function("J", [system.x, system.phi, system.theta, system.p, phi], [J])
    lift = np.linalg.pinv(part.C)  # any state with these port arguments: nothing else matters to the Jacobian
    Z = np.eye(n)
    for a, b in itertools.pairwise(edges):
        middle = evaluate(Y, np.array([(a + b) / 2]))[0]
        arguments = part.d @ middle + offsets(problem, (a + b) / 2 * multiple, vector)
        slopes = [c.slopes[c.mode(v)] for c, v in zip(system.contacts, arguments, strict=True)]

        def rhs(phase, z, slopes=slopes):
            x = lift @ evaluate(Y, np.array([phase]))[0]
            J = jacobian(x, np.zeros(len(slopes)), phase * multiple, vector, slopes).full()
            return (J @ z.reshape(n, n)).ravel() / omega

        sol = solve_ivp(rhs, (a, b), Z.ravel(), method="DOP853", rtol=1e-12, atol=1e-13)
        Z = sol.y[:, -1].reshape(n, n)
    return Z


def offsets(problem, theta, vector):
    offset = problem.ports.forcing(vector).offset
    return (2 * offset @ np.exp(1j * theta * np.arange(offset.shape[1]))).real - offset[:, 0].real


def contact_edges(problem, Y, vector):
    """Phases of all contact changes by dense sampling and bisection."""
    phases = np.linspace(0, 2 * np.pi, 20001)
    part, edges = problem.ports.linear(vector), [0.0, 2 * np.pi]

    def gap(i, level, t):
        t = np.atleast_1d(t)
        shift = np.array([offsets(problem, s * problem.period_multiple, vector)[i] for s in t])
        return evaluate(Y, t) @ part.d[i] + shift - level

    for i, contact in enumerate(problem.system.contacts):
        for level in contact.breakpoints:
            values = gap(i, level, phases)
            for j in np.flatnonzero(values[1:] * values[:-1] < 0):
                a, b, left = phases[j], phases[j + 1], values[j]
                for _ in range(50):
                    c = (a + b) / 2
                    a, b = (c, b) if gap(i, level, c)[0] * left > 0 else (a, c)
                edges.append((a + b) / 2)
    return sorted(edges)


def random_wave(seed, H, k, mean=0.8, size=1.0):
    rng = np.random.default_rng(seed)
    Y = (
        size
        * (rng.standard_normal((H + 1, k)) + 1j * rng.standard_normal((H + 1, k)))
        / (1 + np.arange(H + 1))[:, None]
    )
    Y[0] = mean * rng.standard_normal(k)
    return Y


def shifted_contact():
    """A contact whose argument moves with the phase (a transmission error), and a modulated gain."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x - 0.2 * ca.cos(theta) + 0.1 * ca.sin(2 * theta))
    return System(
        name="error",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.2 - 0.1 * v - (1 + 0.3 * ca.sin(theta)) * mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.9)},
        contacts=[mesh],
    )


def contact_and_cubic():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(0.4,), slopes=(0.0, 3.0))
    return System(
        name="both",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.1 * v - x - (0.5 + 0.2 * ca.cos(theta)) * x**3 - stop.force + ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.9)},
        contacts=[stop],
    )


CASES = {
    "duffing": rs.duffing,
    "absorber": rs.absorber,
    "mathieu": lambda: rs.mathieu(1.0),
    "backlash": rs.backlash,
    "parametric backlash": rs.parametric_backlash,
    "transmission error": shifted_contact,
    "contact and cubic": contact_and_cubic,
    "two contacts": lambda: rs.stops(damping=0.1, gain=0.3, force=0.5, width=0.4, stops=2),
    "full form": rs.coupled_van_der_pol,
}


@pytest.mark.parametrize("multiple", [1, 2])
@pytest.mark.parametrize("name", CASES)
def test_any_waveform_against_scipy(name, multiple):
    system = CASES[name]()
    problem = HarmonicBalance().discretise(system, system.frequency, period_multiple=multiple)
    p = system.defaults[system.frequency]
    for seed in (0, 1):
        Y = random_wave(seed, 4, problem.ports.outputs, size=0.5 if name == "full form" else 1.0)
        edges = contact_edges(problem, Y, problem.vector(p))
        if system.contacts and seed == 0:
            assert len(edges) > 2
        wanted = by_scipy(problem, Y, p, edges)
        flow = monodromy(problem, [(pack(Y), p)])
        scale = max(1.0, np.abs(wanted).max())
        assert np.abs(flow.matrices[0] - wanted).max() < 2e-10 * scale
        assert abs(flow.liouville[0]) < 1e-11 * scale


def test_gear_pair_against_scipy():
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    Y = random_wave(3, 4, 1)
    wanted = by_scipy(problem, Y, 0.8, contact_edges(problem, Y, problem.vector(0.8)))
    assert np.abs(problem.monodromies([(pack(Y), 0.8)])[0] - wanted).max() < 1e-10 * max(1.0, np.abs(wanted).max())


@given(st.integers(0, 10**6), st.floats(0.2, 3.0))
@settings(max_examples=30)
def test_liouville_of_constant_damping(seed, omega):
    problem = HarmonicBalance().discretise(rs.backlash(), "omega")
    M = problem.monodromies([(pack(random_wave(seed, 5, 1)), omega)])[0]
    assert np.linalg.slogdet(M)[1] == pytest.approx(-2 * rs.ZETA * 2 * np.pi / omega, abs=1e-10)


def test_batch_is_the_same_as_one_by_one():
    problem = HarmonicBalance().discretise(rs.backlash(), "omega")
    points = [(pack(random_wave(s, 3 + s % 4, 1)), 0.5 + 0.1 * s) for s in range(9)]
    single = np.concatenate([problem.monodromies([pt]) for pt in points])
    assert problem.monodromies(points) == pytest.approx(single, abs=1e-12)


def test_defective_linear_part():
    """A free mass has a Jordan block: no modal form; exp(A t) is [[1, t], [0, 1]]."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(10.0,), slopes=(0.0, 1.0))
    system = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -stop.force}, phase=theta,
                    frequency="omega", parameters={"omega": (omega, 2.0)}, contacts=[stop])  # fmt: skip
    problem = HarmonicBalance().discretise(system, "omega")
    M = problem.monodromies([(pack(np.array([[0.0], [0.5]], dtype=complex)), 2.0)])[0]
    assert pytest.approx(np.array([[1.0, np.pi], [0.0, 1.0]]), abs=1e-12) == M


@pytest.mark.parametrize("name", ["backlash", "two contacts", "duffing", "full form"])
def test_pieces_multiply_to_the_matrix_and_end_at_the_contact_changes(name):
    problem = HarmonicBalance().discretise(CASES[name](), "omega")
    u = pack(random_wave(4, 5, problem.ports.outputs, size=0.5))
    flow = monodromy(problem, [(u, 0.7)])
    pieces = transition_matrices(problem, u, 0.7)
    product = np.linalg.multi_dot(pieces[::-1]) if len(pieces) > 1 else pieces[0]
    mu = multipliers(flow.matrices)[0]
    assert distance(mu, multipliers(product[None])[0]).max() < 1e-12 * max(1.0, np.abs(mu[0]))
    assert len(flow.patterns[0]) == len(problem.system.contacts)
    changes = np.sort(np.concatenate([p.phases for p in flow.patterns[0]] + [[0.0, 2 * np.pi]]))
    edges = contact_edges(problem, unpack(u, problem.ports.outputs), problem.vector(0.7))
    assert changes == pytest.approx(np.array(edges), abs=1e-9)


def test_multipliers_are_sorted_by_modulus():
    mu = multipliers(np.array([np.diag([0.1, -2.0, 0.5]), [[0.0, 1, 0], [-1, 0, 0], [0, 0, 3.0]]]))
    assert mu[0] == pytest.approx([-2.0, 0.5, 0.1])
    assert mu[1] == pytest.approx([3.0, 1j, -1j])


def test_pairing_of_multipliers_ignores_their_order():
    mu = np.array([0.9 + 0.1j, 0.9 - 0.1j, 0.3])
    assert distance(mu, mu[[2, 0, 1]]) == pytest.approx(np.zeros(3), abs=1e-16)


@pytest.mark.parametrize(
    ("mu", "bar", "wanted"),
    [
        ([0.5], [0.1], "stable"),
        ([1.2, 0.1], [0.1, 0.1], "unstable"),
        ([0.95], [0.1], "undecided"),
        ([1.05, 0.1], [0.1, 0.1], "undecided"),
        ([1.05, 1.3], [0.1, 0.1], "unstable"),
        ([-1.0], [1e-10], "undecided"),
        ([0.6 + 0.8j, 0.6 - 0.8j], [1e-9, 1e-9], "undecided"),
    ],
)
def test_verdict(mu, bar, wanted):
    assert verdict(np.array(mu), np.array(bar)) == wanted


@pytest.mark.parametrize("harmonics", [5, 9, 63, 511])
def test_series_on_rows_of_any_length_are_those_summed_one_by_one(harmonics):
    """Rows of one length, of nearly one length, and each of its own, of three orbits, two numbers at a time."""
    rng = np.random.default_rng(0)
    lengths = np.concatenate([np.full(20, 0.4), 0.3 * (1 + 1e-14 * np.arange(12)), rng.uniform(0.01, 0.5, 150)])
    phases = rng.uniform(0, 6, (len(lengths), 1)) + lengths[:, None] * np.linspace(0.02, 0.98, 14)
    owner = rng.integers(0, 3, len(lengths))
    spectra = np.array([random_wave(seed, harmonics, 2) for seed in range(3)], dtype=complex)
    exact = np.array([evaluate(spectra[i], row) for i, row in zip(owner, phases, strict=True)])
    assert np.abs(_series(spectra, owner, phases) - exact).max() < 3e-12 * np.abs(exact).max()
