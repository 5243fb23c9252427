"""Single-mass backlash oscillators against an event-exact reference, printed to eight to ten digits."""

import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, trace

METHOD = HarmonicBalance(tolerance=1e-9, max_harmonics=1023)


@pytest.fixture(scope="module")
def problem():
    return METHOD.discretise(rs.backlash(), "omega")


@pytest.fixture(scope="module")
def branch():
    coarse = HarmonicBalance().discretise(rs.backlash(), "omega")
    return trace(coarse, coarse.guess(omega=0.5), (0.5, 1.6))


@pytest.fixture(scope="module")
def orbits(problem, branch):
    """Fine orbits at 0.6, 0.75 (low and high) and 1.0, from the nearest point of the traced branch."""

    def fine(omega, high):
        near = [o for o in branch.orbits if (o.rms("x") > 0.1) == high and o.stability == "stable"]
        return problem.solve(min(near, key=lambda o: abs(o.value - omega)), omega)

    return {"0.6": fine(0.6, False), "low": fine(0.75, False), "high": fine(0.75, True), "1.0": fine(1.0, True)}


def test_folds(branch):
    folds = [q.parameter for q in branch.special_points if q.kind == "fold"]
    assert folds == pytest.approx([0.82846398, 0.70803162], abs=1e-8)


def test_contact_is_lost_at_grazing_points(branch):
    """No contact loss outside, on the low branch: event-exact, and closed form as the oscillation is linear there."""
    found = [q for q in branch.special_points if q.kind == "grazing"]
    assert [q.parameter for q in found] == pytest.approx([0.8206310877, 1.4070884660], abs=1e-10)
    for q, words in zip(found, ("gained", "lost"), strict=True):
        assert q.note.startswith("minimum of mesh at 1, phase ")
        assert q.note.endswith(f"2 contact changes {words}")
        assert q.error < 1e-9
        assert q.status == "located"
        w = q.parameter
        assert 0.05 * w**2 / abs(1 - w**2 + 2j * rs.ZETA * w) == pytest.approx(0.1, abs=1e-10)


@pytest.mark.parametrize(
    ("name", "state"),
    [
        ("0.6", (1.1278799613, 0.0015682478)),
        ("low", (1.1624504362, 0.0080293418)),
        ("high", (0.8338430125, 0.1640787518)),
        ("1.0", (0.9059653748, 0.0557744441)),
    ],
)
def test_state_at_phase_zero(orbits, name, state):
    assert orbits[name].evaluate(0.0)[0] == pytest.approx(state, abs=1e-8)
    assert orbits[name].stability == "stable"


@pytest.mark.parametrize(
    ("name", "multiplier"), [("0.6", -0.30288645 + 0.50909685j), ("high", 0.43845790 + 0.49034086j)]
)
def test_multipliers(orbits, name, multiplier):
    mu = orbits[name].multipliers
    assert rs.multiplier_distance(mu, np.array([multiplier, multiplier.conjugate()])) < 2e-7
    assert orbits[name].multiplier_error.max() < 1e-6


@pytest.mark.parametrize(("name", "rms"), [("0.6", 0.01980055), ("high", 0.22472379), ("1.0", 0.13308283)])
def test_root_mean_square(orbits, name, rms):
    assert orbits[name].rms("x") == pytest.approx(rms, abs=1.1e-8)


def test_fraction_of_time_separated(orbits):
    x = np.fft.irfft(orbits["high"].harmonics("x"), 1 << 18)
    assert np.mean(x * (1 << 18) < 1) == pytest.approx(0.54175, abs=1e-5)


def test_dynamic_factor(orbits):
    """Largest contact force over the mean load 0.1; f(x) is the largest x less half the gap."""
    assert (orbits["1.0"].extremes("x")[1] - 1) / 0.1 == pytest.approx(2.69255, abs=1.1e-5)


def test_determinant_and_largest_exponent(branch):
    """det M = exp(-2 zeta T) always; complex multipliers mean a largest exponent of exactly -zeta."""
    period = 2 * np.pi / branch.parameter
    assert np.prod(branch.multipliers, axis=1).real == pytest.approx(np.exp(-2 * rs.ZETA * period), rel=1e-9)
    complex_ = np.abs(branch.multipliers[:, 0].imag) > 1e-6
    exponent = np.log(np.abs(branch.multipliers[:, 0])) / period
    assert np.count_nonzero(complex_) > 20
    assert exponent[complex_] == pytest.approx(-rs.ZETA, abs=1e-9)


def test_contact_is_lost_between_the_two_grazing_frequencies(branch):
    """On the low branch the gap opens above 0.8206310877, and closes for good above 1.4070884660."""
    below = [o for o in branch.orbits if o.value < 0.8206 and o.rms("x") < 0.0672]
    above = [o for o in branch.orbits if o.value > 1.4071]
    assert len(below) > 5
    assert all(
        o.extremes("x")[0] > 1 for o in above + [o for o in below if o.stability == "stable" and o.value < 0.708]
    )
    inside = [o for o in branch.orbits if 0.83 < o.value < 1.407]
    assert all(o.extremes("x")[0] < 1 for o in inside)


@pytest.mark.parametrize(("edge", "sign"), [(0.8206310877, 1), (1.4070884660, -1)])
def test_grazing_frequency(problem, edge, sign):
    """At the edge of contact loss the linear oscillation just touches: 1 + 0.1 - amplitude = 1."""
    linear = problem.guess(omega=0.6 if sign > 0 else 1.5)
    just_outside = problem.solve(linear, edge - sign * 1e-9)
    assert just_outside.extremes("x")[0] == pytest.approx(1.0, abs=1e-8)


def test_parametric_backlash_folds():
    problem = HarmonicBalance().discretise(rs.parametric_backlash(), "omega")
    branch = trace(problem, problem.guess(omega=1.0), (1.0, 0.65))
    folds = [q for q in branch.special_points if q.kind == "fold"]
    assert [q.parameter for q in folds] == pytest.approx([0.7056974892, 0.8445641420], abs=1e-9)
    # The state at a fold moves with the root of the parameter's distance: 1e-10 shows as 1e-5.
    assert folds[0].orbit.evaluate(0.0)[0] == pytest.approx((0.19907848, -0.76947462), abs=2e-5)
