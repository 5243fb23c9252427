"""Two masses with a cubic absorber against AUTO-07p: quasi-periodic oscillations start at two torus points."""

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, trace


@pytest.fixture(scope="module")
def branch():
    problem = HarmonicBalance().discretise(rs.absorber(), "omega")
    return trace(problem, problem.guess(omega=1.0), (1.0, 1.3))


def test_special_points(branch):
    assert [q.kind for q in branch.special_points] == ["neimark-sacker", "neimark-sacker", "fold", "fold"]
    found = [q.parameter for q in branch.special_points]
    assert found == pytest.approx([1.1127112391, 1.1957366691, 1.2146262252, 1.2062194574], abs=2e-10)
    assert all(q.error < 1e-8 and q.status == "located" for q in branch.special_points)
    assert branch.unresolved == ()


def test_torus_points_have_a_complex_pair_on_the_unit_circle(branch):
    for q in branch.special_points[:2]:
        pair = q.multipliers[:2]
        assert np.abs(pair) == pytest.approx([1.0, 1.0], abs=1e-8)
        assert abs(pair[0].imag) > 0.01


def test_orbits_between_the_torus_points_are_unstable(branch):
    first, second = branch.special_points[:2]
    assert set(branch.stability[first.index + 1 : second.index + 1]) == {"unstable"}
    assert set(branch.stability[: first.index + 1]) == {"stable"}


def test_determinant_of_the_monodromy(branch):
    """The trace of the damping matrix over the masses: 0.002 + 0.013 + 0.013 / 0.05."""
    product = np.prod(branch.multipliers, axis=1).real
    assert product == pytest.approx(np.exp(-(0.015 + 0.26) * 2 * np.pi / branch.parameter), rel=1e-8)
