"""Many harmonics solved through the low ones: the same numbers as from the dense matrix."""

import numpy as np
import pytest
import reference_systems as rs
from test_monodromy import CASES, random_wave

from continuation import HarmonicBalance, trace
from continuation.branches.bordered import bordered_factors
from continuation.branches.extended import bordered, nearest_null
from continuation.orbits import split_operator
from continuation.orbits.spectrum import pack, resize
from continuation.orbits.split_operator import SplitMatrix

HARMONICS = 127


def operators(system, p, harmonics=HARMONICS):
    """The problem, the operators of shift 0 and 1/2 along a waveform that is no orbit, and dF/dp."""
    problem = HarmonicBalance(harmonics=harmonics).discretise(system, system.frequency)
    k = problem.ports.outputs
    u = resize(pack(random_wave(3, 4, k)), k, harmonics)
    _, J, Fp = problem.linearise(u, p)
    return problem, u, (J, problem.half_operator(u, p)), Fp


def falling(rng, split):
    """A border that falls with the square of the harmonic, as real ones do; entries of further borders are 1."""
    operator = split.inner
    K, k, _ = operator.transfer.shape
    size = np.ones((K, k, 1)) / (1 + np.arange(K))[:, None, None] ** 2
    return rng.standard_normal(len(split)) * np.append(operator.pack(size * (1 + 1j)), np.ones(len(split.corner)))


@pytest.mark.parametrize("which", [0, 1], ids=["shift 0", "shift 1/2"])
@pytest.mark.parametrize("model", [rs.gear, rs.parametric_backlash, CASES["two contacts"]], ids=["gear", "one", "two"])
def test_products_and_solutions_are_those_of_the_dense_matrix(model, which):
    _, _, found, _ = operators(model(), 0.8)
    split = found[which]
    assert isinstance(split, SplitMatrix)
    dense, rng = np.asarray(split), np.random.default_rng(0)
    x = rng.standard_normal((len(split), 2))
    scale = np.abs(dense).max()
    assert np.abs(split.times(x) - dense @ x).max() < 1e-13 * scale
    assert np.abs(split.times(x, transposed=True) - dense.T @ x).max() < 1e-13 * scale
    n = len(split)
    column, row = falling(rng, split), np.append(falling(rng, split), 0.3)
    factors = bordered_factors(split, column, row)
    whole = np.block([[dense, column[:, None]], [row[None]]])
    right = rng.standard_normal((n + 1, 3))
    for transposed in (False, True):
        exact = np.linalg.solve(whole.T if transposed else whole, right)
        assert np.abs(factors.solve(right, transposed) - exact).max() < 1e-11 * np.abs(exact).max()
    assert factors.sign == np.linalg.slogdet(whole)[0]


def test_two_borders_one_after_the_other():
    _, _, (split, _), _ = operators(rs.gear(), 0.8)
    rng, n = np.random.default_rng(1), len(split)
    first = split.bordered(falling(rng, split)[:, None], falling(rng, split)[None], np.array([[0.2]]))
    column, row = falling(rng, first), np.append(falling(rng, first), 0.4)
    factors = bordered_factors(first, column, row)
    whole = np.block([[np.asarray(first), column[:, None]], [row[None]]])
    right = rng.standard_normal(n + 2)
    assert factors.solve(right) == pytest.approx(np.linalg.solve(whole, right), rel=1e-10, abs=1e-11)


def test_null_vectors_of_a_nearly_singular_operator():
    """At the doubling of the gear example: the scalar of the bordered system and both vectors."""
    problem = HarmonicBalance(harmonics=HARMONICS).discretise(rs.gear(), "frequency_ratio")
    branch = trace(problem, problem.guess(frequency_ratio=0.6), (0.585, 0.6))
    (point,) = [q for q in branch.special_points if q.kind == "period-doubling"]
    split = problem.half_operator(problem.unknown(point.orbit), point.parameter)
    assert isinstance(split, SplitMatrix)
    v, w = nearest_null(split)
    null, dense = bordered(split, w, v), bordered(np.asarray(split), w, v)
    assert abs(null.g) < 1e-6
    assert null.g == pytest.approx(dense.g, abs=1e-12)
    assert np.abs(null.v - dense.v).max() < 1e-11 * np.abs(dense.v).max()
    assert np.abs(null.w - dense.w).max() < 1e-8 * np.abs(dense.w).max()  # asked for to 1e-9


def test_sweeps_that_do_not_converge_are_replaced_by_the_dense_matrix():
    """A border as large at high harmonics as at low ones couples them strongly."""
    _, _, (split, _), _ = operators(rs.gear(), 0.8)
    rng, n = np.random.default_rng(2), len(split)
    column, row = 30 * rng.standard_normal(n), np.append(30 * rng.standard_normal(n), 0.0)
    factors = bordered_factors(split, column, row)
    whole = np.block([[np.asarray(split), column[:, None]], [row[None]]])
    right = rng.standard_normal((n + 1, 2))
    exact = np.linalg.solve(whole, right)
    assert np.abs(factors.solve(right) - exact).max() < 1e-9 * np.abs(exact).max()


def test_orbits_and_points_do_not_depend_on_how_the_equations_are_solved(monkeypatch):
    found = []
    for least in (split_operator.LEAST, 10_000):
        monkeypatch.setattr(split_operator, "LEAST", least)
        problem = HarmonicBalance(harmonics=HARMONICS).discretise(rs.gear(), "frequency_ratio")
        branch = trace(problem, problem.guess(frequency_ratio=0.6), (0.585, 0.6))
        (point,) = [q for q in branch.special_points if q.kind == "period-doubling"]
        found.append((branch.orbits[-1], point))
    (orbit, point), (dense_orbit, dense_point) = found
    assert np.abs(orbit.coefficients - dense_orbit.coefficients).max() < 1e-10
    assert orbit.multipliers == pytest.approx(dense_orbit.multipliers, abs=1e-9)
    assert point.parameter == pytest.approx(dense_point.parameter, abs=1e-11)
    assert point.form.coefficient == pytest.approx(dense_point.form.coefficient, rel=1e-7)


def test_solutions_do_not_depend_on_the_units_of_the_borders():
    """A parameter in rad/s at waves in nm: every unknown, and the residual of every border, has a size of its own."""
    _, _, (split, _), _ = operators(rs.gear(), 0.8)
    rng, n = np.random.default_rng(3), len(split)
    wave, parameter = 1e-9, 1e6
    column, row = falling(rng, split) * wave / parameter, np.append(np.zeros(n), 0.3 / parameter)
    row[split.inner.kept] = falling(rng, split)[split.inner.kept] / wave  # an orbit of few harmonics
    factors = bordered_factors(split, column, row)
    whole = np.block([[np.asarray(split), column[:, None]], [row[None]]])
    right = np.zeros((n + 1, 2))
    right[:n, 0], right[n, 1] = wave * falling(rng, split), 1.0
    own = np.append(np.full(n, wave), parameter)[:, None]
    exact = np.linalg.solve(whole, right) / own
    assert np.abs(factors.solve(right) / own - exact).max() < 1e-11 * np.abs(exact).max()
    tangent = factors.solve(right[:, 1:], accuracy=1e-10) / own
    assert np.abs(tangent - exact[:, 1:]).max() < 1e-8 * np.abs(exact[:, 1]).max()
