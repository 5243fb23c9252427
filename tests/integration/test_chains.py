"""Linear coordinates behind a contact: the same orbits dense, sparse, fitted and in full, and what is said of many."""

from __future__ import annotations

import numpy as np
import pytest
from chain_systems import chain, defect

from continuation import HarmonicBalance, NoConvergence, Shooting, UnsupportedModel, trace
from continuation.model import linear_part
from continuation.orbits import receptance_sparse

HEAVY = 0.2  # damping with which waves do not come back from the far end of the chain


def orbit_of(system, omega=0.7, harmonics=63, **values):
    problem = HarmonicBalance(harmonics=harmonics).discretise(system, "omega", **values)
    return problem, problem.guess(omega=omega)


@pytest.fixture
def few_states_are_many(monkeypatch):
    """Treat every linear part of more than 8 states as large."""
    monkeypatch.setattr(linear_part, "DENSE_STATES", 8)
    monkeypatch.setattr(linear_part, "_FILLED", 0.5)


@pytest.mark.parametrize("n", [1, 10, 100])
def test_orbits_satisfy_the_equations_of_all_states(n):
    problem, orbit = orbit_of(chain(n))
    assert not problem.large
    assert orbit.stability == "stable"
    assert orbit.extremes("x0")[0] < 1 < orbit.extremes("x0")[1]
    assert defect(orbit) < 1e-11


@pytest.mark.parametrize("n", [10, 100])
def test_sparse_and_dense_linear_parts_give_the_same_orbit(n, few_states_are_many, monkeypatch):
    problem, fitted = orbit_of(chain(n))
    assert problem.large
    assert problem.receptance(0.7).nodes > 0
    monkeypatch.setattr(receptance_sparse, "_ACCEPTED", 0.0)
    exact = problem.__class__(problem.method, problem.system, "omega", 1, {}).solve(fitted, 0.7)
    monkeypatch.undo()
    problem, dense = orbit_of(chain(n))
    assert not problem.large
    for orbit in (fitted, exact):
        assert np.abs(orbit.coefficients - dense.coefficients).max() < 1e-10
        assert orbit.contacts["contact"][0] == pytest.approx(dense.contacts["contact"][0], abs=1e-9)
        assert orbit.error == pytest.approx(dense.error, rel=1e-3)
        assert orbit.stability == "undecided"
        assert np.isnan(orbit.multipliers).all()


def test_a_thousand_coordinates_satisfy_the_equations_of_all_states():
    problem, orbit = orbit_of(chain(1000, 0.1))
    assert problem.large
    assert 0 < problem.receptance(0.7).error < 1e-9
    assert defect(orbit, 0.1) < 1e-10
    other = problem.solve(orbit, 0.72)
    assert defect(other, 0.1) < 1e-10
    assert other.stability == "undecided"
    assert other.multipliers.shape == (2000,)
    assert np.isnan(other.multipliers).all()


def test_coordinates_that_no_wave_returns_from_change_nothing():
    """With heavy damping the contact can't tell 190 coordinates, dense, from 250, sparse."""
    few, many = (orbit_of(chain(n, HEAVY), harmonics=31)[1] for n in (190, 250))
    for state in ("x0", "v0", "x20"):
        assert few.harmonics(state) == pytest.approx(many.harmonics(state), abs=1e-10)


def test_rigid_coupling_makes_one_mass_of_all():
    """The stiffer the coupling, the more ten coordinates move as one: their differences fall with its inverse."""
    apart = []
    for stiffness in (100.0, 1000.0):
        _, orbit = orbit_of(chain(10), harmonics=31, stiffness=stiffness)
        apart.append(np.abs(orbit.harmonics("x9")[:6] - orbit.harmonics("x0")[:6]).max())
    assert apart[0] < 0.05 * np.abs(orbit.harmonics("x0")[:2]).max()
    assert apart[0] / apart[1] == pytest.approx(10, rel=0.1)


def test_shooting_finds_the_orbit_of_a_chain():
    _, orbit = orbit_of(chain(5), harmonics=127)
    shot = Shooting().discretise(chain(5), "omega").solve(orbit, 0.7)
    assert orbit.evaluate(0.0) == pytest.approx(shot.evaluate(0.0), abs=1e-6)
    assert np.sort(np.abs(orbit.multipliers)) == pytest.approx(np.sort(np.abs(shot.multipliers)), abs=1e-5)


def test_stated_error_covers_harmonics_left_out_and_the_fit():
    problem, coarse = orbit_of(chain(210, HEAVY), harmonics=15)
    fine = HarmonicBalance(harmonics=255).discretise(chain(210, HEAVY), "omega").from_orbit(coarse)
    phases = np.linspace(0, 2 * np.pi, 500)
    off = np.abs(coarse.evaluate(phases)[:, 0] - fine.evaluate(phases)[:, 0]).max()
    assert 0.01 * coarse.error < off < coarse.error
    assert problem.receptance(0.7).error < 1e-9


def test_a_wrong_fit_shows_in_the_error_of_the_orbit(monkeypatch):
    """States are solved for exactly: what a fit of three digits does to the orbit is measured and covered."""
    good = orbit_of(chain(210, HEAVY))[1]
    monkeypatch.setattr(receptance_sparse, "_GOAL", 1e-3)
    monkeypatch.setattr(receptance_sparse, "_ACCEPTED", 1.0)
    problem, bad = orbit_of(chain(210, HEAVY))
    off = np.abs(good.evaluate(np.linspace(0, 6, 200)) - bad.evaluate(np.linspace(0, 6, 200))).max()
    assert 1e-9 < off < bad.error
    assert bad.error > 1.5 * good.error
    assert problem.receptance(0.7).error > 1e-5


def test_parameter_of_the_linear_part_is_solved_exactly(few_states_are_many):
    """A fit would have to be made anew at every value: the linear part is used as it is, and dF/dp stays exact."""
    problem = HarmonicBalance(harmonics=31).discretise(chain(20), "stiffness", omega=0.7)
    orbit = problem.guess(stiffness=1.0)
    assert problem.large
    assert problem.receptance(1.0).nodes == 0
    assert defect(orbit) < 1e-11
    u, h = problem.unknown(orbit), 1e-5
    slope = (problem.residual(u, 1 + h) - problem.residual(u, 1 - h)) / (2 * h)
    assert problem.linearise(u, 1.0)[2] == pytest.approx(slope, abs=1e-7)
    assert problem.parameter_derivative(u, 1.0, "omega") == pytest.approx(
        HarmonicBalance(harmonics=31).discretise(chain(20), "omega").linearise(u, 0.7)[2], abs=1e-8
    )


def test_multipliers_of_many_states_are_refused_with_the_reason():
    problem, orbit = orbit_of(chain(201, HEAVY), harmonics=15)
    with pytest.raises(UnsupportedModel, match=r"has 402 states: Floquet multipliers.*up to 400 states"):
        trace(problem, orbit, span=(0.7, 0.75))


def test_large_model_that_has_no_orbit_there_says_so(few_states_are_many):
    problem = HarmonicBalance(harmonics=7).discretise(chain(10), "omega")
    orbit = problem.guess(omega=0.7)
    with pytest.raises((NoConvergence, ValueError)):
        problem.solve(orbit, -1.0)
