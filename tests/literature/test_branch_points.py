"""Branch points by Newton's method on the bordered system: against Mathieu's values and event-exact integration."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from scipy.optimize import brentq
from scipy.special import mathieu_a

from continuation import Collocation, Contact, HarmonicBalance, Shooting, System, switch, trace
from continuation.branches.branch_points import solve_crossing
from continuation.errors import NoConvergence, UnsupportedModel

METHODS = [HarmonicBalance(), Shooting(), Shooting(segments=3), Collocation()]


def named(method) -> str:
    return type(method).__name__ + str(getattr(method, "segments", None) or "")


def driven(power: int) -> System:
    """A linear oscillator x drives y'' + (1.2 + x) y + y^power = 0: while y rests, Mathieu's equation in theta / 2."""
    x, v, y, w, theta, omega, g = rs.symbols("x", "v", "y", "w", "theta", "omega", "g")
    return System(
        name="driven",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "v": -0.2 * v - 4 * x + g * ca.cos(theta), "y": w, "w": -(1.2 + x) * y - y**power},
        phase=theta,
        frequency="omega",
        parameters={"g": (g, 1.0), "omega": (omega, 1.0)},
    )


def characteristic() -> float:
    """Return the force at which 4 * 1.2 is the characteristic value a2 of ``q = 2 * amplitude of x``."""
    amplitude = 1 / abs(4 - 1 + 0.2j)
    return float(brentq(lambda g: mathieu_a(2, 2 * g * amplitude) - 4.8, 2.0, 3.0, xtol=1e-14))


def stops() -> System:
    """x'' + 0.2 x' + x + 5 (stops at -1 and 1) = 5 cos(theta), symmetric."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(5.0, 0.0, 5.0), name="stop")
    return System(
        name="symmetric stops",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 5 * ca.cos(theta) - 0.2 * v - x - stop.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[stop],
    )


def follow(system, parameter, span, method):
    problem = method.discretise(system, parameter)
    return trace(problem, problem.guess(**{parameter: span[0]}), span, max_step=abs(span[1] - span[0]) / 10)


@pytest.mark.parametrize(("method", "power"), [(METHODS[0], 3), (METHODS[0], 2), (METHODS[1], 3), (METHODS[3], 2)])
def test_characteristic_value_of_mathieu(method, power):
    """Pitchfork (3) and transcritical (2): the orbit at which y rests is known, and the point a scalar equation."""
    exact = characteristic()
    (point,) = follow(driven(power), "g", (exact - 0.1, exact + 0.12), method).special_points
    assert (point.kind, point.status, point.note) == ("branch-point", "located", "")
    assert abs(point.parameter - exact) <= min(point.error, 1e-10)
    assert point.error < 5e-10
    assert np.abs(point.form.null_vector[:2]).max() < 1e-6  # x moves as before
    assert np.linalg.norm(point.form.left_vector) == pytest.approx(1.0)  # of a double multiplier 1


@pytest.mark.parametrize("method", METHODS, ids=named)
def test_quadratic_convergence(method):
    """Every step is a fixed multiple of the square of the one before, down to rounding."""
    problem = method.discretise(rs.cubic(), "g")
    found = solve_crossing(problem, problem.unknown(problem.guess(g=2.45)), 2.45)
    first, second, third, *rest = found.history
    assert 0.01 < first < 0.2
    assert 1e-4 < second < 0.02
    assert third < 3 * second**2
    assert not rest or rest[0] < max(10 * third**2, 1e-10)
    assert abs(found.beta) < 1e-11
    assert found.p == pytest.approx(2.608168614, abs=3e-9)  # at the resolution of the guess


def test_tangents_are_those_of_both_branches():
    """Of a pitchfork: the symmetric branch has no even harmonics, the other one leaves at constant parameter."""
    problem = HarmonicBalance(harmonics=31).discretise(rs.cubic(), "g")
    found = solve_crossing(problem, problem.unknown(problem.guess(g=2.5)), 2.5)
    broken, symmetric = sorted(found.tangents, key=lambda t: abs(t[1]) / np.linalg.norm(t[0]))
    assert abs(broken[1]) < 1e-10 * np.linalg.norm(broken[0])
    assert abs(symmetric[0][0]) < 1e-10 * np.linalg.norm(symmetric[0])
    before, after = (problem.unknown(problem.solve(problem.guess(g=2.5), found.p + d)) for d in (-1e-3, 1e-3))
    slope = (after - before) / 2e-3
    assert symmetric[0] / symmetric[1] == pytest.approx(slope, abs=1e-5 * np.linalg.norm(slope))


@pytest.mark.parametrize("method", METHODS[:2], ids=named)
def test_a_pitchfork_met_from_the_branch_that_is_born_there(method):
    """That branch turns there and goes on as its mirror image; it is no fold, and no multiplier crosses."""
    problem = method.discretise(rs.cubic(), "g")
    biased = HarmonicBalance().discretise(rs.cubic(0.02), "g")
    start = problem.from_orbit(biased.solve(biased.guess(g=2.5), 2.66))
    assert abs(start.mean("x")) > 0.02
    branch = trace(problem, start, (2.66, 2.5), max_step=0.016)
    assert [q.kind for q in branch.special_points] == ["branch-point"]
    assert abs(branch.special_points[0].parameter - 2.608168614) < 2e-9
    assert branch.unresolved == ()
    assert branch.orbits[-1].mean("x") == pytest.approx(-start.mean("x"), rel=1e-6)


def test_branches_cross_transcritically():
    """The second branch, of which y moves in proportion to the distance, is there before and behind the point."""
    exact = characteristic()
    span = exact - 0.1, exact + 0.12
    (point,) = follow(driven(2), "g", span, HarmonicBalance()).special_points
    branch = switch(point, span)
    amplitude = np.array([o.rms("y") for o in branch.orbits])
    assert branch.parameter.min() == pytest.approx(span[0])
    assert branch.parameter.max() == pytest.approx(span[1])
    near = np.abs(branch.parameter - exact) < 0.03
    ratio = amplitude[near] / np.abs(branch.parameter[near] - exact)
    assert np.ptp(ratio) < 0.3 * ratio.mean()  # linear, not a root


@pytest.fixture(scope="module")
def contact():
    return follow(stops(), "omega", (1.106, 1.1025), HarmonicBalance()).special_points


def test_with_contact_against_event_exact_integration(contact):
    """det(M - I) = 0 by an integrator of its own, interpolated over symmetric orbits at three frequencies."""
    (point,) = contact
    assert (point.kind, point.status, point.note) == ("branch-point", "located", "")
    offsets, values = np.array([-1e-3, 1e-4, 1e-3]), []
    for offset in offsets:
        flow, x = rs.ExactFlow(stops(), omega=point.parameter + offset), point.orbit.evaluate(0.0)[0]
        for _ in range(3):
            end, M = flow(x)
            x = x + np.linalg.solve(M - np.eye(2), x - end)
        values.append(np.linalg.det(M - np.eye(2)))
    roots = np.roots(np.polyfit(offsets * 1e3, values, 2)) * 1e-3
    assert np.abs(roots).min() < 1e-8
    assert point.error < 1e-9


def test_with_contact_by_shooting(contact):
    problem = Shooting(segments=2).discretise(stops(), "omega")
    found = solve_crossing(problem, problem.unknown(contact[0].orbit), 1.105)
    assert abs(found.p - contact[0].parameter) < 1e-9
    assert abs(found.beta) < 1e-10


@pytest.mark.parametrize(
    ("method", "bias", "step"),
    [(METHODS[0], 1e-6, 0.04), (METHODS[0], 1e-7, 0.01), (METHODS[2], 1e-6, 0.04), (METHODS[3], 1e-6, 0.04)],
)
def test_broken_symmetry_is_seen_although_the_continuation_jumps(method, bias, step):
    """The two branches pass so close that steps go from one to the other: said, and no point claimed."""
    problem = method.discretise(rs.cubic(bias), "g")
    branch = trace(problem, problem.guess(g=2.5), (2.5, 2.7), max_step=step)
    assert branch.special_points == ()
    assert any("no branch point" in note and "broken symmetry" in note for note in branch.unresolved)


def test_the_unfolding_measures_the_broken_symmetry():
    """beta is proportional to the bias: the first derivative of the equations in it, along the left null vector."""
    betas = []
    for bias in (1e-5, 2e-5):
        problem = HarmonicBalance(harmonics=31).discretise(rs.cubic(bias), "g")
        betas.append(solve_crossing(problem, problem.unknown(problem.guess(g=2.6)), 2.6).beta)
    assert betas[1] / betas[0] == pytest.approx(2.0, rel=1e-4)
    assert abs(betas[0]) > 1e-7


def test_no_crossing_far_away_and_none_of_autonomous_systems():
    problem = HarmonicBalance(harmonics=15).discretise(rs.duffing(), "omega")
    with pytest.raises(NoConvergence, match="branch point"):
        solve_crossing(problem, problem.unknown(problem.guess(omega=0.5)), 0.5)
    cycle = Collocation().discretise(rs.third_order(), "alpha")
    with pytest.raises(UnsupportedModel, match="only driven Systems"):
        solve_crossing(cycle, np.zeros(3), 1.0)
