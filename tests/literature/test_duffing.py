"""Duffing's oscillator, single and double well, against AUTO-07p; printed tables hold to 2e-6."""

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, Shooting, switch, trace, track


def follow(method, system, parameter, span, **options):
    problem = method.discretise(system, parameter)
    return trace(problem, problem.guess(**{parameter: span[0]}), span, **options)


@pytest.fixture(scope="module")
def branch():
    return follow(HarmonicBalance(), rs.duffing(), "omega", (0.5, 2.0))


def test_folds(branch):
    assert [q.kind for q in branch.special_points] == ["fold", "fold"]
    upper, lower = branch.special_points
    assert upper.parameter == pytest.approx(rs.DUFFING_FOLDS[0], abs=2e-10)
    assert lower.parameter == pytest.approx(rs.DUFFING_FOLDS[1], abs=2e-10)
    assert all(q.error < 1e-8 for q in branch.special_points)


def test_amplitudes_at_the_folds(branch):
    """Twice the first harmonic, and the largest value of x, at the upper fold; twice the first one at the lower."""
    upper, lower = (q.orbit for q in branch.special_points)
    assert 2 * abs(upper.harmonics("x")[1]) == pytest.approx(2.82501671, rel=2e-6)
    assert upper.extremes("x")[1] == pytest.approx(2.87156713, rel=4e-6)  # printed is the largest of the mesh points
    x = upper.evaluate(np.linspace(0, 2 * np.pi, 20001))[:, 0]
    assert upper.extremes("x")[1] == pytest.approx(x.max(), abs=1e-7)
    assert 2 * abs(lower.harmonics("x")[1]) == pytest.approx(1.08187032, rel=2e-6)


def test_one_harmonic():
    """The textbook approximation: its folds are those of a cubic in the squared amplitude, good to ten digits."""
    coarse = follow(HarmonicBalance(harmonics=1), rs.duffing(), "omega", (0.5, 2.0))
    folds = [q.parameter for q in coarse.special_points if q.kind == "fold"]
    assert folds == pytest.approx(rs.DUFFING_FOLDS_ONE_HARMONIC, abs=2e-10)


def test_amplitude_of_one_harmonic_is_its_cubic():
    orbit = HarmonicBalance(harmonics=1).discretise(rs.duffing(), "omega").guess(omega=0.9)
    a = 2 * abs(orbit.harmonics("x")[1])
    residual = ((1 - 0.81 + 0.075 * a**2) ** 2 + (0.05 * 0.9) ** 2) * a**2 - 0.18**2
    assert residual == pytest.approx(0.0, abs=1e-12)


def test_stability_changes_at_the_folds(branch):
    upper, lower = branch.special_points
    middle = slice(upper.index + 1, lower.index + 1)
    assert set(branch.stability[middle]) == {"unstable"}
    assert set(branch.stability[: upper.index]) | set(branch.stability[lower.index + 1 :]) == {"stable"}


def test_determinant_of_the_monodromy(branch):
    """exp(-0.05 T) at every orbit."""
    product = np.prod(branch.multipliers, axis=1)
    assert product.imag == pytest.approx(0.0, abs=1e-10)
    assert product.real == pytest.approx(np.exp(-0.05 * 2 * np.pi / branch.parameter), rel=1e-9)


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_points_do_not_depend_on_the_step(step):
    other = follow(HarmonicBalance(), rs.duffing(), "omega", (1.05, 1.4), step=step, max_step=step)
    assert [q.parameter for q in other.special_points] == pytest.approx(rs.DUFFING_FOLDS, abs=2e-10)


def test_shooting_gives_the_same_folds(branch):
    problem = Shooting().discretise(rs.duffing(), "omega")
    for fold, wanted, end in zip(branch.special_points, rs.DUFFING_FOLDS, (1.3, 1.05), strict=True):
        near = branch.orbits[fold.index - 4]
        piece = trace(problem, problem.solve(near, near.value), (near.value, end))
        assert [q.parameter for q in piece.special_points] == pytest.approx([wanted], abs=1e-9)


def test_fold_in_two_parameters(branch):
    """The tracked fold passes through folds found by separate branches."""
    curve = track(branch.special_points[0], parameters=("omega", "g"), span={"g": (0.17, 0.2)})
    omega, g = (np.array([o.parameters[name] for o in curve.orbits]) for name in ("omega", "g"))
    i = int(np.argmin(np.abs(g - 0.195)))
    system = rs.duffing().with_parameters(g=float(g[i]))
    alone = follow(HarmonicBalance(), system, "omega", (1.1, 1.4))
    assert alone.special_points[0].parameter == pytest.approx(omega[i], abs=1e-8)


def test_double_well_cascade():
    """Period-doublings of periods 1, 2 and 4, each reached by a switch at the one before."""
    branch = follow(HarmonicBalance(), rs.double_well(), "g", (0.262, 0.268))
    found = []
    for end in (0.288, 0.2912):
        doubling = next(q for q in branch.special_points if q.kind == "period-doubling")
        found.append(doubling.parameter)
        branch = switch(doubling, span=(doubling.parameter, end))
    found.append(next(q for q in branch.special_points if q.kind == "period-doubling").parameter)
    assert found == pytest.approx(rs.DOUBLE_WELL_DOUBLINGS[:3], abs=1e-9)
    assert branch.period_multiple == 4
