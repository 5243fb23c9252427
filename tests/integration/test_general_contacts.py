"""Harmonic balance of contacts that do not enter linearly, orbits that rest on a corner, graze it, or are not found."""

import casadi as ca
import general_contacts as general
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, HarmonicBalance, NoConvergence, Shooting, System, trace
from continuation.branches.newton import Metric, correct
from continuation.errors import RestingContact
from continuation.orbits.spectrum import pack

THETA = np.linspace(0, 2 * np.pi, 777)


def oscillator(acceleration, law, **values):
    x, v, theta, omega, g = rs.symbols("x", "v", "theta", "omega", "g")
    contact = Contact(argument=x, breakpoints=law[0], slopes=law[1], name="stop")
    return System(name="stopped", states={"x": x, "v": v}, phase=theta, frequency="omega", contacts=[contact],
                  derivatives={"x": v, "v": acceleration(x, v, theta, contact.force, g)},
                  parameters={"omega": (omega, values.get("omega", 0.8)), "g": (g, values.get("g", 0.0))})  # fmt: skip


# ------------------------------------------------------------------------------------------------ against other methods
@pytest.mark.parametrize(
    ("name", "build"),
    [
        ("hertz", general.hertz),
        ("hunt", general.hunt_crossley),
        ("squared", general.squared_backlash),
        ("bent", general.bent_argument),
        ("radial gap", general.radial_gap),
    ],
)
def test_orbit_against_event_exact_shooting(name, build):
    system = build()
    omega, shown = system.defaults["omega"], [n for n in system.state_names if n in "xy"]
    orbit = HarmonicBalance(tolerance=1e-6).discretise(system, "omega").guess(omega=omega)
    exact = Shooting().discretise(system, "omega").from_orbit(orbit)
    place = [system.state_names.index(n) for n in shown]
    off = np.abs(orbit.evaluate(THETA) - exact.evaluate(THETA))[:, place].max()
    assert off < 3 * orbit.error
    assert off < 2e-6
    assert orbit.stability == exact.stability
    bars = orbit.multiplier_error.max() + exact.multiplier_error.max()
    assert rs.multiplier_distance(orbit.multipliers, exact.multipliers) < bars
    assert bars < 5e-6


def test_hertzian_contact_by_quadrature_and_by_fine_sampling():
    """The 3/2 power has a continuous slope: with very many uniform samples the other path gives the same orbit."""
    method = HarmonicBalance(harmonics=31)
    orbit = method.discretise(general.hertz(), "omega").guess(omega=0.8)
    sampled = method.discretise(general.hertz_in_the_open(), "omega").guess(omega=0.8)
    assert orbit.evaluate(THETA) == pytest.approx(sampled.evaluate(THETA), abs=1e-8)
    assert rs.multiplier_distance(orbit.multipliers, sampled.multipliers) < 1e-7
    assert orbit.contacts["stop"][1].tolist() in ([1, 0, 1], [0, 1, 0])


def test_closed_form_and_quadrature_are_one_method():
    """Orbit, error estimate and multipliers agree to rounding."""
    problems = [HarmonicBalance(harmonics=31).discretise(general.backlash(inside), "omega") for inside in (False, True)]
    closed, inside = (problem.guess(omega=0.9) for problem in problems)
    assert closed.contacts["mesh"][0].size == 2
    assert inside.evaluate(THETA) == pytest.approx(closed.evaluate(THETA), abs=1e-11)
    assert inside.error == pytest.approx(closed.error, rel=1e-6)
    assert rs.multiplier_distance(inside.multipliers, closed.multipliers) < 1e-10


@pytest.mark.parametrize("name", general.GENERAL)
@pytest.mark.parametrize("multiple", [1, 2])
def test_jacobian_and_parameter_derivatives(name, multiple):
    system = general.GENERAL[name]()
    problem = HarmonicBalance(harmonics=6).discretise(system, "omega", period_multiple=multiple)
    k, rng = problem.ports.outputs, np.random.default_rng(4)
    Y = 0.9 * (rng.standard_normal((7, k)) + 1j * rng.standard_normal((7, k))) / (1 + np.arange(7))[:, None] ** 2
    if name == "radial gap":
        Y = 0.1 * Y
        Y[1] += [0.5, -0.6j]
    u, p, h = pack(Y), 0.9, 1e-4
    _, J, _ = problem.linearise(u, p)
    for d in rng.standard_normal((3, u.size)) / u.size:

        def along(h, d=d):
            return (problem.residual(u + h * d, p) - problem.residual(u - h * d, p)) / (2 * h)

        assert (4 * along(h) - along(2 * h)) / 3 == pytest.approx(J @ d, abs=1e-7)
    for parameter, value in system.defaults.items():
        moved = HarmonicBalance(harmonics=6).discretise(system, parameter, period_multiple=multiple, **{"omega": p})
        value = p if parameter == "omega" else value
        exact = moved.parameter_derivative(u, value, parameter)

        def by(h, moved=moved, value=value):
            return (moved.residual(u, value + h) - moved.residual(u, value - h)) / (2 * h)

        assert (4 * by(h) - by(2 * h)) / 3 == pytest.approx(exact, abs=1e-8)


def test_branch_in_a_parameter_of_the_contact():
    """Stiffness of a Hertzian stop as the continuation parameter; a problem in frequency meets the same orbit."""
    method = HarmonicBalance(harmonics=31)
    problem = method.discretise(general.hertz(), "k")
    branch = trace(problem, problem.guess(k=2.0), span=(2.0, 3.0))
    last = branch.orbits[-1]
    assert last.value == pytest.approx(3.0, abs=1e-12)
    other = method.discretise(general.hertz(), "omega", k=3.0).from_orbit(last)
    assert other.parameter == "omega"
    assert other.evaluate(THETA) == pytest.approx(last.evaluate(THETA), abs=1e-9)


def test_orbit_on_twice_its_period():
    single = HarmonicBalance(tolerance=1e-5).discretise(general.squared_backlash(), "omega").guess(omega=0.8)
    problem = HarmonicBalance(tolerance=1e-5).discretise(general.squared_backlash(), "omega", period_multiple=2)
    doubled = problem.from_orbit(single)
    assert doubled.evaluate(THETA) == pytest.approx(single.evaluate(THETA), abs=1e-5)
    assert rs.multiplier_distance(single.multipliers**2, doubled.multipliers) < 1e-5


# ------------------------------------------------------------------------------------------------ grazing
def grazing(inside, depth):
    """Linear resonance of amplitude 1 whose stop lies ``depth`` below the crest, by closed form or by quadrature."""
    g = 0.1 * 0.8  # |1 - 0.8^2 + 0.08i| is the force of amplitude 1, set below
    x, v, theta, omega, e = rs.symbols("x", "v", "theta", "omega", "e")
    stop = Contact(argument=x, breakpoints=(1.0 - depth,), slopes=(0.0, 1.0))
    load = abs(1 - 0.8**2 + 1j * g)
    push = (1 + e * x if inside else 1) * 5.0 * stop.force
    system = System(name="grazing", states={"x": x, "v": v}, phase=theta, frequency="omega", contacts=[stop],
                    derivatives={"x": v, "v": load * ca.cos(theta) - 0.1 * v - x - push},
                    parameters={"omega": (omega, 0.8), "e": (e, 0.0)})  # fmt: skip
    problem = HarmonicBalance(harmonics=255).discretise(system, "omega")
    Y = np.zeros((256, 1), dtype=complex)
    Y[1] = 0.5
    node = correct(problem, (pack(Y), 0.8), (np.zeros(511), 1.0), Metric(1.0, 1.0))
    return problem.orbits([(node.u, node.p, problem.error(node.u, node.p))])[0]


@pytest.mark.parametrize("inside", [False, True])
def test_grazing_from_both_sides(inside):
    """Off the stop the orbit is linear to rounding; on it penetration and multipliers start as known powers."""
    free = np.exp(np.roots([1, 0.1, 1]) * 2 * np.pi / 0.8)
    for depth in (-1e-3, -1e-9):
        orbit = grazing(inside, depth)
        assert 2 * abs(orbit.harmonics("x")[1]) == pytest.approx(1.0, abs=1e-13)
        assert rs.multiplier_distance(orbit.multipliers, free) < 1e-10
    orbits = {depth: grazing(inside, depth) for depth in (1e-5, 1e-7)}
    mean = {depth: abs(orbit.mean("x")) for depth, orbit in orbits.items()}
    assert mean[1e-5] / mean[1e-7] == pytest.approx(1000, rel=0.05)  # depth^1.5
    turned = {d: np.abs(np.trace(np.diag(o.multipliers)) - free.sum()) for d, o in orbits.items()}
    assert turned[1e-5] / turned[1e-7] == pytest.approx(10, rel=0.05)  # the duration, depth^0.5
    touch = grazing(inside, 0.0)
    assert 2 * abs(touch.harmonics("x")[1]) == pytest.approx(1.0, abs=1e-13)
    assert rs.multiplier_distance(touch.multipliers, free) < 1e-6  # a touch is known to the root of rounding


# ------------------------------------------------------------------------------------------------ when there is none
@pytest.mark.parametrize("load", [0.0, 1e-10])
@pytest.mark.parametrize("level", [0.0, 1.0])
def test_orbit_that_rests_on_a_breakpoint_is_named(load, level):
    """Held exactly at the stop by a spring: two stiffnesses, two sets of multipliers, no verdict."""
    system = oscillator(lambda x, v, t, f, g: g * ca.cos(t) - 0.1 * v - (x - level) - 3 * f, ((level,), (0.0, 1.0)))
    problem = HarmonicBalance().discretise(system, "omega", g=load * level)
    with pytest.raises(RestingContact, match=rf"'stop' .* rests on its breakpoint {level:g} \(omega = 0\.8.*smoothed"):
        problem.guess(omega=0.8)


def test_an_orbit_that_nothing_holds_is_named():
    """Free between two stops, with the load that would decide its place left out."""
    system = oscillator(lambda x, v, t, f, g: 0.05 * ca.cos(t) - 0.1 * v - f, ((-1.0, 1.0), (1.0, 0.0, 1.0)))
    with pytest.raises(NoConvergence, match=r"not determined.*open contacts.*give it a load") as failure:
        HarmonicBalance().discretise(system, "omega").guess(omega=0.8)
    assert failure.value.parameter == 0.8
    assert len(failure.value.history) > 0


def stiff_inside(outside, load):
    """A spring of stiffness 1 that softens beyond +-1 so much that Newton's method jumps from side to side."""
    return oscillator(lambda x, v, t, f, g: g - 0.1 * v - f, ((-1.0, 1.0), (outside, 1.0, outside)), g=load)


def start(problem, mean):
    Y = np.zeros((8, 1), dtype=complex)
    Y[0] = mean
    return pack(Y), 0.8


@pytest.mark.parametrize("mean", [1.1, 2.5, 7.0])
def test_cycle_of_contact_patterns_is_left(mean):
    """f(x) = 1 + (x - 1) s beyond 1: with s < 1/2 plain Newton goes from x to 1 - 1/s, to 1/s - 1 and back for ever."""
    s = 0.3
    assert 1 / s - 1 > 1  # the two iterates of the cycle, +-(1/s - 1), lie in the soft modes
    problem = HarmonicBalance(harmonics=7).discretise(stiff_inside(s, 0.0), "omega")
    u, p = start(problem, mean)
    node = correct(problem, (u, p), (np.zeros_like(u), 1.0), Metric(1.0, 1.0))
    assert np.abs(node.u).max() < 1e-12
    assert len(problem.ports.closed) == 1


def test_cycle_without_an_orbit_is_named():
    """A load that no place carries: f = |x| is never -0.1."""
    system = oscillator(lambda x, v, t, f, g: -0.1 - 0.1 * v - f, ((0.0,), (-1.0, 1.0)))
    problem = HarmonicBalance(harmonics=7).discretise(system, "omega")
    u, p = start(problem, 2.5)
    with pytest.raises(NoConvergence, match=r"goes round between 2 contact patterns.*smaller steps") as failure:
        correct(problem, (u, p), (np.zeros_like(u), 1.0), Metric(1.0, 1.0))
    assert failure.value.parameter == 0.8
    assert len(failure.value.history) > 4
