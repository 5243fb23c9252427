"""Collocation against closed forms, harmonic balance, shooting and AUTO-07p."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from scipy.optimize import brentq

from continuation import Collocation, HarmonicBalance, Shooting, System, trace
from continuation.branches.arclength import start_node
from continuation.branches.newton import Metric, correct, size_of
from continuation.orbits.start import correct_at

PHASES = np.linspace(0, 2 * np.pi, 2001)


def linear_response(theta, omega, zeta=0.03, force=0.4):
    """States (N, 2) of rs.linear_oscillator in closed form."""
    a = force / (1 - omega**2 + 2j * zeta * omega) * np.exp(1j * np.asarray(theta))
    return np.stack([a.real, (1j * omega * a).real], axis=1)


def forced_van_der_pol(mu, force):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    return System(
        name="van der Pol",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": mu * (1 - x**2) * v - x + force * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.7)},
    )


def corrected(problem, start, value):
    """Solve at a value from a near orbit; return the mesh, node values and u."""
    u = problem.unknown(problem.solve(start, value))
    u = correct(problem, (u, value), (np.zeros_like(u), 1.0), Metric(size_of(u), 1.0)).u
    return problem.mesh(u), problem.mesh(u).values(u), u


@pytest.fixture(scope="module")
def duffing_orbit():
    """An orbit near resonance, good to about 1e-13."""
    return Collocation(degree=9, tolerance=1e-13).discretise(rs.duffing(), "omega").guess(omega=0.9)


# ------------------------------------------------------------------------------------------------ order and error
@pytest.mark.parametrize("m", [2, 3, 4])
@pytest.mark.parametrize("model", ["linear", "duffing"])
def test_design_order(m, model, duffing_orbit):
    """2m at the ends of the intervals, m + 1 in between; the estimate is the true error within a factor of 1.3."""
    system, omega = (rs.linear_oscillator(), 0.5) if model == "linear" else (rs.duffing(), 0.9)

    def exact(phases):
        return linear_response(phases, omega) if model == "linear" else duffing_orbit.evaluate(phases)

    start = Collocation().discretise(system, "omega").guess(omega=omega)
    counts, ends, between = np.array([12, 16, 24]), [], []
    for count in counts:
        problem = Collocation(intervals=int(count), degree=m).discretise(system, "omega")
        mesh, values, u = corrected(problem, start, omega)
        ends.append(np.abs(values[mesh.index[:, 0]] - exact(2 * np.pi * mesh.ends[:-1])).max())
        between.append(np.abs(mesh.evaluate(values, PHASES / (2 * np.pi)) - exact(PHASES)).max())
        assert problem.error(u, omega) == pytest.approx(between[-1], rel=0.3)
    steps = np.log(counts[1:] / counts[:-1])
    assert np.log(np.divide(ends[:-1], ends[1:])) / steps == pytest.approx([2 * m] * 2, abs=0.35)
    assert np.log(np.divide(between[:-1], between[1:])) / steps == pytest.approx([m + 1] * 2, abs=0.35)


@pytest.mark.parametrize(("degree", "tolerance"), [(2, 1e-4), (2, 1e-7), (3, 1e-9), (4, 1e-5), (4, 1e-10), (7, 1e-11)])
def test_tolerance_is_kept_and_the_error_is_truthful(degree, tolerance, duffing_orbit):
    problem = Collocation(degree=degree, tolerance=tolerance).discretise(rs.duffing(), "omega")
    mesh, values, u = corrected(problem, duffing_orbit, 0.9)
    true = np.abs(mesh.evaluate(values, PHASES / (2 * np.pi)) - duffing_orbit.evaluate(PHASES)).max()
    estimate = problem.error(u, 0.9)
    assert estimate <= tolerance * np.linalg.norm(u)
    assert estimate / 3 < true < 3 * estimate


def test_orbit_is_as_good_as_its_error():
    orbit = Collocation(tolerance=1e-6).discretise(rs.linear_oscillator(), "omega").guess(omega=0.5)
    assert np.abs(orbit.evaluate(PHASES) - linear_response(PHASES, 0.5)).max() < orbit.error < 1e-6
    a = 0.4 / (1 - 0.25 + 0.03j)
    assert orbit.harmonics("x")[1] == pytest.approx(a / 2, abs=1e-7)


# ------------------------------------------------------------------------------------------------ layers
@pytest.mark.parametrize(("mu", "force", "omega"), [(5.0, 5.0, 0.7), (8.0, 2.0, 0.38), (10.0, 8.0, 0.5)])
def test_adapted_mesh_resolves_relaxation(mu, force, omega):
    """A thousand times better than equal intervals of the same number, and its error is still truthful."""
    system = forced_van_der_pol(mu, force)
    orbit = Collocation().discretise(system, "omega").guess(omega=omega)
    fine = Collocation(degree=7, tolerance=1e-12).discretise(system, "omega").from_orbit(orbit)
    true = np.abs(orbit.evaluate(PHASES) - fine.evaluate(PHASES)).max()
    assert orbit.error < 1e-8
    assert true < 3 * orbit.error
    problem = Collocation(intervals=300).discretise(system, "omega")
    adapted = Collocation(max_intervals=300).discretise(system, "omega").from_orbit(orbit)
    assert adapted.error < problem.from_orbit(orbit).error / 1000
    assert np.all(np.abs(orbit.multipliers - fine.multipliers) < orbit.multiplier_error)


def test_an_orbit_that_no_integration_returns_to():
    """x'' = 25 x + cos(theta): one multiplier 4e13, one 2e-14; collocation does not mind, and says what it lost."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(name="hill", states={"x": x, "v": v}, derivatives={"x": v, "v": 25 * x + ca.cos(theta)},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
    problem = Collocation(tolerance=1e-10).discretise(system, "omega")
    u = problem.from_waveform(np.zeros((64, 2)))
    orbit = correct_at(problem, u, 1.0)
    assert np.abs(orbit.evaluate(PHASES)[:, 0] + np.cos(PHASES) / 26).max() < 1e-11
    wanted = np.exp([10 * np.pi, -10 * np.pi])
    assert orbit.multipliers[0].real == pytest.approx(wanted[0], rel=1e-6)
    assert np.all(np.abs(orbit.multipliers - wanted) < orbit.multiplier_error)
    assert orbit.stability == "unstable"


# ------------------------------------------------------------------------------------------------ multipliers
@pytest.mark.parametrize(
    ("build", "omega"),
    [
        (rs.duffing, 0.9),
        (rs.absorber, 1.1),
        (rs.coupled_van_der_pol, 0.93),
        (lambda: rs.backlash().smoothed(0.1), 0.6),
        (lambda: rs.parametric_backlash().smoothed(0.2), 0.93),
    ],
    ids=["duffing", "absorber", "van der Pol", "backlash", "parametric"],
)
def test_error_bars_hold_the_true_multipliers(build, omega):
    """On coarse meshes, where the bars are from 1e-10 to 1; and they are no more than some ten times too long."""
    system = build()
    exact = Collocation(degree=7, tolerance=1e-12).discretise(system, "omega").guess(omega=omega)
    shares = []
    for degree in (2, 3, 4, 6):
        for intervals in (8, 13, 24, 60):
            orbit = Collocation(intervals=intervals, degree=degree).discretise(system, "omega").from_orbit(exact)
            off = rs.multiplier_distance(orbit.multipliers, exact.multipliers)
            assert off < orbit.multiplier_error.max()
            shares += [off / orbit.multiplier_error.max()] if off > 1e-9 else []
    assert np.median(shares) > 0.1


@pytest.mark.parametrize("model", ["duffing", "absorber", "coupled van der Pol"])
def test_same_orbits_and_multipliers_as_harmonic_balance(model):
    system = {"duffing": rs.duffing, "absorber": rs.absorber, "coupled van der Pol": rs.coupled_van_der_pol}[model]()
    methods = HarmonicBalance(tolerance=1e-11), Collocation(tolerance=1e-10)
    balance, problem = (method.discretise(system, "omega") for method in methods)
    for omega in (0.6, 1.0, 1.35):
        one = balance.guess(omega=omega)
        other = problem.from_orbit(one)
        assert np.abs(one.evaluate(PHASES) - other.evaluate(PHASES)).max() < 1e-9
        assert rs.multiplier_distance(one.multipliers, other.multipliers) < 1e-9
        assert other.stability == one.stability
        back = balance.solve(other, omega)
        assert np.abs(one.evaluate(PHASES) - back.evaluate(PHASES)).max() < 1e-9


def test_verdicts_do_not_depend_on_mesh_and_degree():
    """Stable, unstable or undecided, never the wrong one of the first two; fine meshes decide."""
    reference = Collocation().discretise(rs.duffing(), "omega")
    branch = trace(reference, reference.guess(omega=1.0), (1.0, 1.35), step=0.02, max_step=0.03)
    chosen = branch.orbits[::6]
    assert {o.stability for o in chosen} == {"stable", "unstable"}
    for intervals, degree in ((10, 3), (16, 2), (25, 4), (40, 5)):
        problem = Collocation(intervals=intervals, degree=degree).discretise(rs.duffing(), "omega")
        for orbit in chosen:
            found = problem.from_orbit(orbit)
            assert found.stability in (orbit.stability, "undecided")
            if intervals >= 25:
                assert found.stability == orbit.stability


@pytest.mark.parametrize("q", rs.MATHIEU_EDGES)
def test_edges_of_mathieu_from_the_trace_of_the_monodromy(q):
    problem = Collocation(intervals=60, degree=6).discretise(rs.mathieu(q), "a")
    rest = problem.from_waveform(np.zeros((64, 2)))
    for edge, level in zip(rs.MATHIEU_EDGES[q], (2, -2, -2, 2, 2), strict=True):

        def excess(a, level=level):
            return np.trace(problem.monodromies([(rest, a)])[0]) - level

        assert brentq(excess, edge - 3e-3, edge + 3e-3, xtol=1e-13) == pytest.approx(edge, abs=1.1e-9)


# ------------------------------------------------------------------------------------------------ branches
@pytest.fixture(scope="module")
def duffing_branch():
    problem = Collocation().discretise(rs.duffing(), "omega")
    return trace(problem, problem.guess(omega=1.0), (1.0, 1.4))


def test_folds_of_duffing(duffing_branch):
    assert [q.kind for q in duffing_branch.special_points] == ["fold", "fold"]
    assert [q.parameter for q in duffing_branch.special_points] == pytest.approx(rs.DUFFING_FOLDS, abs=2e-10)
    assert all(q.error < 1e-9 and q.status == "located" for q in duffing_branch.special_points)
    assert duffing_branch.unresolved == ()
    assert duffing_branch.error.max() < 2e-8  # five times the tolerance at most, times the size
    product = np.prod(duffing_branch.multipliers, axis=1)
    assert product == pytest.approx(np.exp(-0.05 * 2 * np.pi / duffing_branch.parameter), rel=1e-9)


def test_folds_of_three_methods_agree(duffing_branch):
    balance = HarmonicBalance().discretise(rs.duffing(), "omega")
    other = trace(balance, balance.guess(omega=1.0), (1.0, 1.4))
    found = [q.parameter for q in duffing_branch.special_points]
    assert found == pytest.approx([q.parameter for q in other.special_points], abs=1e-9)
    shooting = Shooting().discretise(rs.duffing(), "omega")
    for fold, end in zip(duffing_branch.special_points, (1.3, 1.05), strict=True):
        near = duffing_branch.orbits[fold.index - 2]
        piece = trace(shooting, shooting.solve(near, near.value), (near.value, end))
        assert [q.parameter for q in piece.special_points] == pytest.approx([fold.parameter], abs=1e-9)


def test_fold_at_fixed_intervals_carries_its_error():
    """12 intervals of degree 3: the fold is off, and the stated error tells by how much."""
    problem = Collocation(intervals=12, degree=3).discretise(rs.duffing(), "omega")
    fold = trace(problem, problem.guess(omega=1.0), (1.0, 1.4)).special_points[0]
    off = abs(fold.parameter - rs.DUFFING_FOLDS[0])
    assert 1e-8 < off < 1.5 * fold.error < 1e-2


def test_first_doubling_of_the_double_well():
    problem = Collocation().discretise(rs.double_well(), "g")
    branch = trace(problem, problem.guess(g=0.264), (0.264, 0.267))
    (doubling,) = branch.special_points
    assert doubling.kind == "period-doubling"
    assert doubling.parameter == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS[0], abs=1e-11)
    assert np.abs(doubling.multipliers + 1).min() < 1e-9


def test_doubled_orbit():
    """Past the doubling an orbit of two periods, and the one of period 1 is found again from it as no such orbit."""
    problem = Collocation().discretise(rs.double_well(), "g", period_multiple=2)
    orbit = problem.guess(g=0.28)
    assert orbit.stability == "stable"
    x = orbit.evaluate(np.array([0.0, 2 * np.pi, 4 * np.pi]))
    assert x[2] == pytest.approx(x[0], abs=1e-9)
    assert np.abs(x[1] - x[0]).max() > 0.01
    system = rs.double_well()
    state, M = rs.ExactFlow(system, g=0.28).orbit(x[0], turns=2)
    assert x[0] == pytest.approx(state, abs=1e-9)
    assert rs.multiplier_distance(orbit.multipliers, np.linalg.eigvals(M)) < 1e-8


def test_torus_points_of_the_absorber():
    problem = Collocation(tolerance=1e-7).discretise(rs.absorber(), "omega")
    branch = trace(problem, problem.guess(omega=1.08), (1.08, 1.24))
    assert [q.kind for q in branch.special_points] == ["neimark-sacker", "neimark-sacker", "fold", "fold"]
    found = [q.parameter for q in branch.special_points]
    assert found == pytest.approx([1.1127112391, 1.1957366691, 1.2146262252, 1.2062194574], abs=2e-10)
    assert all(q.error < 1e-8 and q.status == "located" for q in branch.special_points)
    assert branch.unresolved == ()
    first, second = branch.special_points[:2]
    assert set(branch.stability[first.index + 1 : second.index + 1]) == {"unstable"}


def test_trace_can_start_at_a_fold(duffing_branch):
    """The start is corrected across the branch where the Jacobian is singular."""
    fold = duffing_branch.special_points[0]
    problem = fold.problem
    node = start_node(problem, problem.unknown(fold.orbit), fold.parameter + 1e-7, Metric(1.0, 0.2))
    assert node.p == pytest.approx(fold.parameter, abs=1e-9)
    assert abs(node.tp) < 1e-3 * np.linalg.norm(node.tu)


def test_cycle_of_an_autonomous_system():
    """x''' + alpha x'' + x' + x = x^2 at its first period-doubling (AUTO-07p): period and all three multipliers."""
    x, v, a, alpha = rs.symbols("x", "v", "a", "alpha")
    system = System(name="jerk", states={"x": x, "v": v, "a": a}, parameters={"alpha": (alpha, 0.9)},
                    derivatives={"x": v, "v": a, "a": x**2 - x - v - alpha * a})  # fmt: skip
    problem = Collocation().discretise(system, "alpha")
    orbit = problem.guess(alpha=0.75)
    for value in (0.7, 0.66, 0.6303020062):
        orbit = problem.solve(orbit, value)
    assert orbit.period == pytest.approx(6.364071339, abs=2e-9)
    assert rs.multiplier_distance(orbit.multipliers, np.array([-1.0, 1.0, -0.01811007])) < 2e-8
