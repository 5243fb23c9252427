"""The dimensionless spiral bevel gear pair at the exact backlash law: every special point from 2.6 to 0.4.

Two independent codes with 127 and 255 harmonics agree on folds and period-doublings to 1e-10.
"""

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, trace

METHOD = HarmonicBalance()
PAIRS = {  # scale of the stiffness variation: two period-doublings closer than a step
    0.236576 * 1.05: (1.353789126, 1.342997016),
    0.236576 * 1.0002: (1.349203667, 1.347597908),
    0.23635: (1.34843003, 1.348371893),
}


def follow(system, span, **options):
    problem = METHOD.discretise(system, "frequency_ratio")
    return trace(problem, problem.guess(frequency_ratio=span[0]), span, **options)


def by_kind(branch, kind):
    return [q.parameter for q in branch.special_points if q.kind == kind]


@pytest.fixture(scope="module")
def branch():
    return follow(rs.gear(), (2.6, 0.4))


def test_folds(branch):
    assert sorted(by_kind(branch, "fold")) == pytest.approx(sorted(rs.GEAR_FOLDS), abs=1e-9)


def test_period_doublings(branch):
    assert sorted(by_kind(branch, "period-doubling")) == pytest.approx(sorted(rs.GEAR_DOUBLINGS), abs=1e-9)


def test_torus_points(branch):
    found = by_kind(branch, "neimark-sacker")
    assert found == pytest.approx([2.293417236, 2.167106229, 1.73116567, 1.695154464], abs=1e-8)
    for q in branch.special_points:
        if q.kind == "neimark-sacker":
            assert np.abs(np.abs(q.multipliers[:2]) - 1).max() < 1e-8
            assert abs(q.multipliers[0].imag) > 1e-3


def test_everything_is_explained_and_stated(branch):
    assert len(branch.special_points) == 16
    assert branch.unresolved == ()
    assert all(q.error < 1e-8 and q.status == "located" for q in branch.special_points)
    assert branch.parameter[-1] == pytest.approx(0.4, abs=1e-12)


@pytest.mark.parametrize("step", [0.005, 0.03, 0.1])
def test_points_do_not_depend_on_the_step(step):
    """Both close folds near 1.52 and both doublings, from the same start with other steps."""
    branch = follow(rs.gear(), (1.65, 1.2), step=step, max_step=step)
    assert sorted(by_kind(branch, "fold")) == pytest.approx(sorted(rs.GEAR_FOLDS[:2]), abs=1e-9)
    assert sorted(by_kind(branch, "period-doubling")) == pytest.approx(sorted(rs.GEAR_DOUBLINGS[:2]), abs=1e-9)


def test_lower_resonance_with_large_steps():
    branch = follow(rs.gear(), (0.7, 0.4), step=0.1, max_step=0.1)
    assert sorted(by_kind(branch, "fold")) == pytest.approx(sorted(rs.GEAR_FOLDS[2:]), abs=1e-9)
    assert sorted(by_kind(branch, "period-doubling")) == pytest.approx(sorted(rs.GEAR_DOUBLINGS[2:]), abs=1e-9)


@pytest.mark.parametrize("step", [0.005, 0.05, 0.1])
@pytest.mark.parametrize("scale", PAIRS)
def test_two_doublings_inside_one_step(scale, step):
    """They enter and leave between two points, whose signs and counts are the same: 0.0001 apart at the least."""
    branch = follow(rs.gear(scale), (1.5, 1.25), step=step, max_step=step)
    assert by_kind(branch, "period-doubling") == pytest.approx(PAIRS[scale], abs=1e-8)
    assert {q.kind for q in branch.special_points} <= {"period-doubling", "grazing"}
    assert branch.unresolved == ()


@pytest.mark.parametrize("step", [0.005, 0.1])
def test_no_doubling_below_the_scale_at_which_they_meet(step):
    branch = follow(rs.gear(0.2363), (1.5, 1.25), step=step, max_step=step)
    assert {q.kind for q in branch.special_points} <= {"grazing"}
    assert branch.unresolved == ()
    assert set(branch.stability) == {"stable"}


def test_no_torus_point_near_0_72():
    """A complex pair comes near the unit circle, to 0.98629, and turns back; SciPy says the same."""
    branch = follow(rs.gear(), (0.8, 0.65))
    assert {q.kind for q in branch.special_points} == {"grazing"}
    modulus = np.abs(branch.multipliers).max(axis=1)
    problem = METHOD.discretise(rs.gear(), "frequency_ratio")
    near = min(branch.orbits, key=lambda o: abs(o.value - 0.71795))
    orbit = problem.solve(near, 0.71795)
    x, M = rs.ExactFlow(rs.gear(), frequency_ratio=0.71795).orbit(orbit.evaluate(0.0)[0])
    assert orbit.evaluate(0.0)[0] == pytest.approx(x, abs=3e-6)
    assert np.abs(np.linalg.eigvals(M)).max() == pytest.approx(0.98629, abs=1.1e-5)
    assert np.abs(orbit.multipliers).max() == pytest.approx(0.98629, abs=2e-5)
    assert modulus.max() < 0.9870


@pytest.mark.parametrize("ratio", [2.23, 0.56])
def test_multipliers_against_scipy(branch, ratio):
    """On an orbit with contact loss, integrated from contact change to contact change."""
    orbit = METHOD.discretise(rs.gear(), "frequency_ratio").solve(
        min(branch.orbits, key=lambda o: abs(o.value - ratio)), ratio
    )
    x, M = rs.ExactFlow(rs.gear(), frequency_ratio=ratio).orbit(orbit.evaluate(0.0)[0])
    assert orbit.evaluate(0.0)[0] == pytest.approx(x, abs=3e-6)
    off = rs.multiplier_distance(np.linalg.eigvals(M), orbit.multipliers)
    assert off < 1e-4
    assert off < 5 * orbit.multiplier_error.max()


def test_determinant_of_the_monodromy(branch):
    """The damping of all coordinates: xi / (effective mass) and the bearings, exp(-trace T)."""
    d = rs.GEAR
    mesh = 2 * d.mesh_damping_ratio * (d.tangential_cosine**2 + np.dot(np.square(d.directions), d.mass_ratios))
    total = mesh + 2 * sum(d.bearing_damping)
    logarithm = np.log(np.abs(branch.multipliers)).sum(axis=1)
    assert logarithm == pytest.approx(-total * 2 * np.pi / branch.parameter, abs=1e-8)


def test_torque_balance_of_the_mean(branch):
    """The mean bearing deflections carry the mean mesh force T / a3, whatever the vibration."""
    d = rs.GEAR
    wanted = -np.array(d.directions) * d.mass_ratios * d.torque / d.tangential_cosine / np.array(d.bearing_stiffness)
    for orbit in branch.orbits[::15]:
        assert orbit.coefficients[0, 1:7].real == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(("width", "shift"), [(1e-2, 1.6e-3), (3e-3, 2.1e-4), (1e-3, 3e-5)])
def test_smoothing_moves_a_fold(branch, width, shift):
    """The bias of the smoothed law, with nearly the square of its width; the branch is met just behind the fold."""
    problem = METHOD.discretise(rs.gear().smoothed(width), "frequency_ratio")
    last = [q for q in branch.special_points if q.kind == "fold"][-1]
    exact = next(o for o in branch.orbits[last.index + 1 :] if o.value < 0.6)
    smooth = trace(problem, problem.solve(exact, exact.value), (exact.value, 0.61))
    assert max(by_kind(smooth, "fold")) - last.parameter == pytest.approx(-shift, rel=0.35)
