"""Isolas: found where they exist, none claimed where they do not."""

from __future__ import annotations

import numpy as np
import pytest
import reference_systems as rs
from scipy.integrate import solve_ivp

from continuation import Collocation, HarmonicBalance, Shooting, find_isolas, trace
from continuation.branches.isolas import _Search

METHOD = HarmonicBalance()
SPAN = (0.95, 1.05)


def main_branch(force, method=METHOD):
    problem = method.discretise(rs.detached_resonance(force), "omega")
    return problem, trace(problem, problem.guess(omega=SPAN[0]), SPAN)


@pytest.fixture(scope="module")
def detached():
    """Problem, main branch and isola at a force where the resonance is detached."""
    problem, main = main_branch(0.015)
    (isola,) = find_isolas(problem, [main], SPAN, slices=[1.0]).isolas
    return problem, main, isola


def damping(V):
    d1, d3, d5 = rs.DETACHING
    return d1 * V - 0.75 * d3 * V**3 + 0.625 * d5 * V**5


def limits_of_detachment():
    """Return minimum and maximum of D(V), by one harmonic, where D'(V) = 0, a quadratic in V^2."""
    d1, d3, d5 = rs.DETACHING
    V = np.sqrt(np.roots([3.125 * d5, -2.25 * d3, d1]))
    return tuple(sorted(damping(V)))


def test_one_harmonic_has_the_isola_of_the_formula():
    """Its folds are the extremes of omega on (1/omega - omega)^2 = (f^2 - D(V)^2) / V^2."""
    low, high = limits_of_detachment()
    force = (low + high) / 2
    problem, main = main_branch(force, HarmonicBalance(harmonics=1))
    (isola,) = find_isolas(problem, [main], SPAN).isolas
    V = np.linspace(0.4, 2.0, 400001)
    square = (force**2 - damping(V) ** 2) / V**2
    s = np.sqrt(square.max())
    wanted = [-s / 2 + np.sqrt(1 + s**2 / 4), s / 2 + np.sqrt(1 + s**2 / 4)]
    folds = sorted(q.parameter for q in isola.special_points if q.kind == "fold")
    assert folds == pytest.approx(wanted, abs=1e-8)


@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting(), Collocation()], ids=lambda m: type(m).__name__)
def test_detached_resonance_is_found_by_every_method(method):
    problem, main = main_branch(0.015, method)
    assert main.special_points == ()
    search = find_isolas(problem, [main], SPAN, slices=[1.0])
    (isola,) = search.branches
    assert search.isolas == (isola,)
    folds = sorted(q.parameter for q in isola.special_points if q.kind == "fold")
    assert folds == pytest.approx([0.9915120853, 1.008126703], abs=1e-8)
    assert isola.unresolved == ()


def test_the_isola_attracts_in_time_beside_the_main_branch(detached):
    """SciPy settles on either, from a state on it or at rest."""
    problem, main, isola = detached
    stable = max((o for o in isola.orbits if o.stability == "stable"), key=lambda o: o.rms("x"))
    near = min(main.orbits, key=lambda o: abs(o.value - stable.value))
    rest = problem.solve(near, stable.value)
    d1, d3, d5 = rs.DETACHING

    def rate(t, z):
        x, v = z
        return v, -x - d1 * v + d3 * v**3 - d5 * v**5 + 0.015 * np.cos(stable.value * t)

    for orbit, start in ((stable, 0.9 * stable.evaluate(0.0)[0]), (rest, np.zeros(2))):
        time = 60 * 2 * np.pi / stable.value
        state = solve_ivp(rate, (0.0, time), start, method="DOP853", rtol=1e-9, atol=1e-12).y[:, -1]
        assert state == pytest.approx(orbit.evaluate(0.0)[0], abs=1e-4)
    assert stable.rms("x") > 3 * rest.rms("x")


@pytest.mark.parametrize("force", [0.005, 0.03])
def test_none_is_claimed_outside_the_limits(force):
    """Below the least force of the formula there is none; above the largest it is part of the main branch."""
    low, high = limits_of_detachment()
    assert not low < force < high
    problem, main = main_branch(force)
    search = find_isolas(problem, [main], SPAN, slices=3)
    assert search.branches == ()
    assert "none found" in str(search)
    assert "proves nothing" in str(search)


def test_none_is_claimed_for_duffing_or_backlash():
    for system, span in ((rs.duffing(), (0.9, 1.4)), (rs.backlash(), (0.7, 0.9))):
        problem = HarmonicBalance().discretise(system, "omega")
        branch = trace(problem, problem.guess(omega=span[0]), span)
        assert find_isolas(problem, [branch], span, slices=2, starts=4).branches == ()


def test_the_other_well_is_a_mirror_image_and_no_isola():
    problem = HarmonicBalance().discretise(rs.double_well(), "g")
    branch = trace(problem, problem.guess(g=0.1), (0.1, 0.2))
    for found in find_isolas(problem, [branch], (0.1, 0.2), slices=2, starts=10).branches:
        assert not found.stop.startswith("closed")
        at = float(found.parameter[len(found) // 2])
        other = min(found.orbits, key=lambda o: abs(o.value - at))
        assert abs(abs(other.mean("x")) - abs(problem.solve(branch.orbits[0], 0.15).mean("x"))) > 1e-3


def test_folds_tracked_in_the_force_turn_back_where_the_isola_merges():
    problem, main = main_branch(0.027, HarmonicBalance(harmonics=1))
    search = find_isolas(problem, [main], SPAN, slices=[], second={"g": (0.024, 0.028)})
    ((omega, force),) = search.extrema
    assert force == pytest.approx(limits_of_detachment()[1], rel=2e-3)
    assert omega == pytest.approx(1.0, abs=2e-3)
    assert search.branches == ()


def test_an_isola_can_be_started_at_its_fold(detached):
    """Where a fold curve comes back to the present value of the second parameter."""
    problem, main, isola = detached
    fold = next(q for q in isola.special_points if q.kind == "fold")
    search = _Search(problem, [main], SPAN, None, None, 2000)
    assert search.try_start(problem.unknown(fold.orbit), fold.parameter)
    again = search.library.branches[-1]
    assert again.stop.startswith("closed")
    wanted = sorted(q.parameter for q in isola.special_points)
    assert sorted(q.parameter for q in again.special_points) == pytest.approx(wanted, abs=1e-8)
    assert not search.try_start(problem.unknown(fold.orbit), fold.parameter)  # known now


def test_misuse_is_refused():
    problem, main = main_branch(0.005, HarmonicBalance(harmonics=1))
    with pytest.raises(ValueError, match="at least one branch"):
        find_isolas(problem, [], SPAN)
    with pytest.raises(ValueError, match="does not contain"):
        find_isolas(problem, [main], SPAN, slices=[1.3])
    with pytest.raises(ValueError, match="starts"):
        find_isolas(problem, [main], SPAN, starts=-1)
