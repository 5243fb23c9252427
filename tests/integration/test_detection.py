"""Pairs of special points inside one step, next to the places where they meet, and zeros of user functions.

Period-doublings are tested on the tongue tips of the gear example (tests/literature/test_gear_example.py). Here are two
analogues: folds of the Duffing oscillator next to its cusp, and torus points of a parametric combination resonance next
to the tip of its tongue, where two multipliers just reach the unit circle.
"""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Branch, Collocation, HarmonicBalance, Shooting, System, trace

METHODS = [HarmonicBalance(), Shooting(), Collocation()]
FINE_AND_COARSE = pytest.mark.parametrize(
    ("method", "step"),
    [(HarmonicBalance(), 0.03), *((method, 0.4) for method in METHODS)],
    ids=["fine", *(type(method).__name__ for method in METHODS)],
)
CUSP = 0.05393  # forcing at which the two folds of the Duffing oscillator meet
TIP = 0.0487205832  # least modulation at which the two modes below resonate; from the largest multiplier, by bisection


def combination(modulation):
    """Two damped modes, coupled by a modulated stiffness: unstable near omega = 1 + sqrt(2.2), by a complex pair."""
    x, v, y, w, theta, omega, e = rs.symbols("x", "v", "y", "w", "theta", "omega", "e")
    shake = ca.cos(theta)
    return System(
        name="combination",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v,
            "v": -0.02 * v - x - e * shake * y - 0.1 * x**3 + 0.3 * shake,
            "y": w,
            "w": -0.02 * w - 2.2 * y - e * shake * x,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 2.4), "e": (e, modulation)},
    )


def follow(method, system, span, step, **values):
    problem = method.discretise(system, "omega", **values)
    return trace(problem, problem.guess(omega=span[0]), span, step=step, max_step=step)


# ------------------------------------------------------------------------------------------------ pairs in one step
@FINE_AND_COARSE
@pytest.mark.parametrize(("g", "gap"), [(0.0716, 9.904e-3), (0.05773, 9.988e-4), (0.05475, 1.0011e-4)])
def test_two_folds_next_to_a_cusp(method, step, g, gap):
    branch = follow(method, rs.duffing(), (0.9, 1.3), step, g=g)
    assert [q.kind for q in branch.special_points] == ["fold", "fold"]
    upper, lower = (q.parameter for q in branch.special_points)
    assert upper - lower == pytest.approx(gap, rel=1e-3)
    assert branch.unresolved == ()


@pytest.mark.parametrize("step", [0.02, 0.4])
@pytest.mark.parametrize("g", [CUSP - 1e-5, CUSP - 1e-3])
def test_no_fold_below_the_cusp(step, g):
    branch = follow(HarmonicBalance(), rs.duffing(), (0.9, 1.3), step, g=g)
    assert branch.special_points == ()
    assert branch.unresolved == ()
    assert set(branch.stability) == {"stable"}


@FINE_AND_COARSE
@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
def test_two_torus_points_at_the_tip_of_a_tongue(method, step, gap):
    """The width of the tongue grows as the root of the distance from its tip, 0.0565 at 1."""
    above = (gap / 0.0565) ** 2
    branch = follow(method, combination(TIP * (1 + above)), (2.3, 2.7), step)
    assert [q.kind for q in branch.special_points] == ["neimark-sacker", "neimark-sacker"]
    low, high = (q.parameter for q in branch.special_points)
    assert high - low == pytest.approx(gap, rel=0.02)
    assert (low + high) / 2 == pytest.approx(2.48337, abs=1e-4)
    assert branch.unresolved == ()
    for q in branch.special_points:
        assert np.sort(np.abs(np.abs(q.multipliers) - 1))[1] < 1e-8


@FINE_AND_COARSE
def test_no_torus_point_below_the_tip(method, step):
    branch = follow(method, combination(TIP * (1 - 1e-5)), (2.3, 2.7), step)
    assert branch.special_points == ()
    assert branch.unresolved == ()
    assert set(branch.stability) == {"stable"}


# ------------------------------------------------------------------------------------------------ user functions
def linear_root(rms):
    """Frequencies at which the linear oscillator of reference_systems, force 0.4, damping 0.03, has an RMS."""
    square = (0.4 / rms) ** 2 / 2  # (1 - w^2)^2 + (0.06 w)^2
    b = 2 - 0.06**2
    return np.sqrt(np.sort(np.roots([1, -b, 1 - square]).real))


PEAK = 0.4 / np.sqrt(2) / (0.06 * np.sqrt(1 - 0.03**2))  # the largest RMS


@pytest.mark.parametrize("step", [0.05, 0.5])
@pytest.mark.parametrize("rms", [1.0, 0.99 * PEAK, 0.9999 * PEAK])
def test_zeros_of_a_function_two_in_one_step_included(step, rms):
    """At the peak of the resonance the two frequencies are 8e-3 and 8e-4 apart."""
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    level = {f"rms {rms:.3f}": lambda orbit: orbit.rms("x") - rms}
    branch = trace(problem, problem.guess(omega=0.5), (0.5, 1.5), step=step, max_step=step, functions=level)
    assert [q.kind for q in branch.special_points] == ["user", "user"]
    assert [q.parameter for q in branch.special_points] == pytest.approx(linear_root(rms), abs=1e-9)
    for q in branch.special_points:
        assert q.note == f"rms {rms:.3f}"
        assert q.error < 1e-8
        assert q.status == "located"
        assert abs(q.orbit.rms("x") - rms) < 1e-7
        assert (
            min(branch.parameter[[q.index, q.index + 1]])
            <= q.parameter
            <= max(branch.parameter[[q.index, q.index + 1]])
        )
    assert branch.unresolved == ()


@pytest.mark.parametrize("step", [0.05, 0.5])
def test_a_function_that_nearly_vanishes_has_no_zero(step):
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    level = {"peak": lambda orbit: orbit.rms("x") - 1.0001 * PEAK}
    branch = trace(problem, problem.guess(omega=0.5), (0.5, 1.5), step=step, max_step=step, functions=level)
    assert branch.special_points == ()
    assert branch.unresolved == ()


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_functions_beside_folds_in_every_method(method):
    """The branch keeps its folds where it was, and its orbits are in order when points are inserted."""
    problem = method.discretise(rs.duffing(), "omega")
    functions = {"amplitude 2": lambda o: o.extremes("x")[1] - 2.0, "rms 1.5": lambda o: o.rms("x") - 1.5}
    branch = trace(problem, problem.guess(omega=1.0), (1.0, 1.4), step=0.1, max_step=0.1, functions=functions)
    folds = [q.parameter for q in branch.special_points if q.kind == "fold"]
    assert folds == pytest.approx(rs.DUFFING_FOLDS, abs=1e-8)
    user = [q for q in branch.special_points if q.kind == "user"]
    assert sorted(q.note for q in user) == ["amplitude 2"] * 2 + ["rms 1.5"] * 2
    for q in user:
        value = functions[q.note](q.orbit)
        assert abs(value) < 1e-6
    crossed = [np.sign(functions[q.note](branch.orbits[i])) for q in user for i in (q.index, q.index + 1)]
    assert [a * b for a, b in zip(crossed[::2], crossed[1::2], strict=True)] == [-1.0] * 4
    assert branch.unresolved == ()


def test_a_function_without_value_is_reported():
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    partly = {"partly": lambda o: np.nan if 1.0 < o.value < 1.2 else o.rms("x") - 1.0}
    branch = trace(problem, problem.guess(omega=0.5), (0.5, 1.5), max_step=0.1, functions=partly)
    low, _ = linear_root(1.0)
    assert [q.parameter for q in branch.special_points] == pytest.approx([low], abs=1e-9)
    assert branch.unresolved
    assert all("the function 'partly' is not a number everywhere" in note for note in branch.unresolved)


def test_a_jump_is_no_zero():
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    jump = {"jump": lambda o: 1.0 if o.value > 0.987 else -1.0}
    branch = trace(problem, problem.guess(omega=0.5), (0.5, 1.5), max_step=0.1, functions=jump)
    assert branch.special_points == ()
    assert any("'jump'" in note for note in branch.unresolved)


@pytest.mark.parametrize("value", [None, "no", 1j, np.zeros(2)])
def test_a_function_must_return_a_number(value):
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    start = problem.guess(omega=0.5)
    with pytest.raises(ValueError, match="'wrong' must return one real number"):
        trace(problem, start, (0.5, 1.5), functions={"wrong": lambda o: value})


def test_user_points_are_saved(tmp_path):
    problem = HarmonicBalance().discretise(rs.linear_oscillator(), "omega")
    level = {"rms 1": lambda orbit: orbit.rms("x") - 1.0}
    branch = trace(problem, problem.guess(omega=0.5), (0.5, 1.5), max_step=0.1, functions=level)
    branch.save(tmp_path / "b.nc")
    again = Branch.load(tmp_path / "b.nc")
    assert [(q.kind, q.note, q.parameter) for q in again.special_points] == [
        (q.kind, q.note, q.parameter) for q in branch.special_points
    ]
    assert "user at omega" in str(again)
