"""The bordered Newton step on equations with known solutions."""

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, NoConvergence
from continuation.branches.newton import Metric, correct, size_of
from continuation.orbits.estimate import waveform_size


class Circle:
    """u^2 + p^2 = 1, a curve with folds at p = -1, 1."""

    parameter = "p"

    def linearise(self, u, p):
        return np.array([u[0] ** 2 + p**2 - 1]), np.array([[2 * u[0]]]), np.array([2 * p])


class Corner:
    """u + max(u - 1, 0) * 9 = p: semismooth."""

    parameter = "p"

    def linearise(self, u, p):
        return u + 9 * np.maximum(u - 1, 0) - p, np.diag(np.where(u > 1, 10.0, 1.0)), np.array([-1.0])


class NoRoot:
    parameter = "p"

    def linearise(self, u, p):
        return np.array([u[0] ** 2 + 1.0]), np.array([[2 * u[0]]]), np.array([0.0])


UNIT = Metric(1.0, 1.0)
FIXED = (np.zeros(1), 1.0)


@pytest.mark.parametrize("angle", [0.1, 1.0, 1.5, 1.6, 3.0, 4.7, 6.0])
def test_correction_meets_the_curve_and_its_tangent(angle):
    on = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-on[1], on[0]])
    guess = on + 0.1 * along
    node = correct(Circle(), (guess[:1], guess[1]), (along[:1], along[1]), UNIT)
    assert node.u[0] ** 2 + node.p**2 == pytest.approx(1.0, abs=1e-14)
    assert (np.array([node.u[0], node.p]) - guess) @ along == pytest.approx(0.0, abs=1e-14)
    assert np.array([node.tu[0], node.tp]) == pytest.approx([-node.p, node.u[0]], abs=1e-8)
    assert node.iterations <= 5


def test_sign_of_the_bordered_determinant_is_kept_round_the_folds():
    signs = set()
    for angle in np.linspace(0, 2 * np.pi, 23):
        on, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        signs.add(correct(Circle(), (on[:1], on[1]), (along[:1], along[1]), UNIT).sign)
    assert len(signs) == 1


def test_parameter_stays_fixed_when_asked():
    node = correct(Circle(), (np.array([0.5]), 0.6), FIXED, UNIT)
    assert (node.u[0], node.p) == pytest.approx((0.8, 0.6), abs=1e-14)


@pytest.mark.parametrize(("start", "p", "wanted"), [(-5.0, 2.0, 1.1), (50.0, 0.5, 0.5), (0.99, 3.0, 1.2)])
def test_semismooth_corner(start, p, wanted):
    assert correct(Corner(), (np.array([start]), p), FIXED, UNIT).u[0] == pytest.approx(wanted, abs=1e-13)


def test_history_is_kept_when_it_fails():
    with pytest.raises(NoConvergence, match="did not converge") as caught:
        correct(NoRoot(), (np.array([0.3]), 0.0), FIXED, UNIT, iterations=9)
    assert len(caught.value.history) >= 1
    assert caught.value.history[0] == pytest.approx(1.09)


def test_singular_matrix_is_named():
    with pytest.raises(NoConvergence, match="singular"):
        correct(NoRoot(), (np.array([0.0]), 0.0), FIXED, UNIT)


def test_metric():
    metric = Metric(size=2.0, span=0.5)
    assert metric.length(np.array([2.0, 0.0]), 0.5) == pytest.approx(np.sqrt(2))
    assert metric.dot((np.array([2.0, 0.0]), 0.5), (np.array([4.0, 1.0]), -0.5)) == pytest.approx(2.0 - 1.0)


@pytest.mark.parametrize("moved", [1e-3, 1e-4])
def test_what_newton_leaves_is_part_of_the_error_estimate(moved):
    """Many harmonics too many leave out nothing, so that the error is all that the last step leaves."""
    problem = HarmonicBalance(harmonics=31).discretise(rs.duffing(), "omega")
    u = problem.unknown(problem.guess(omega=1.2))
    node = correct(problem, ((1 + moved) * u, 1.2), (np.zeros_like(u), 1.0), Metric(size_of(u), 1.0), accuracy=1e-7)
    error = problem.estimate(node.u, node.p).error
    F, J, _ = problem.linearise(node.u, node.p)
    left = waveform_size(np.linalg.solve(J, F), problem.ports.outputs)
    assert left > 0.0
    assert error == pytest.approx(2 * left, rel=0.1, abs=1e-15)
