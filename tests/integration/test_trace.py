"""The continuation loop: reversal, step sizes, ends, interruption, and what a Branch tells."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Branch, HarmonicBalance, System, trace

METHOD = HarmonicBalance()


def follow(system, span, start=None, method=METHOD, **options):
    problem = method.discretise(system, system.frequency)
    first = problem.guess(**{system.frequency: span[0] if start is None else start})
    return trace(problem, first, span, **options)


def points(branch, kind=None):
    return [q.parameter for q in branch.special_points if kind in (None, q.kind)]


@pytest.fixture(scope="module")
def backlash():
    return follow(rs.backlash(), (0.5, 1.6))


# ------------------------------------------------------------------------------------------------ what must not matter
@pytest.mark.parametrize("build", [rs.duffing, rs.backlash])
def test_traced_back_it_gives_the_same_points(build):
    problem = METHOD.discretise(build(), "omega")
    forth = trace(problem, problem.guess(omega=0.55), (0.55, 1.4))
    back = trace(problem, forth.orbits[-1], (1.4, 0.55))
    assert back.parameter[-1] == pytest.approx(0.55, abs=1e-12)
    assert back.orbits[-1].rms("x") == pytest.approx(forth.orbits[0].rms("x"), rel=1e-6)
    assert [q.kind for q in back.special_points] == [q.kind for q in forth.special_points][::-1]
    assert points(back) == pytest.approx(points(forth)[::-1], abs=1e-9)


@pytest.mark.parametrize("step", [0.005, 0.02, 0.1])
def test_step_size_does_not_change_the_points(backlash, step):
    branch = follow(rs.backlash(), (0.65, 0.9), step=step, max_step=step)
    assert points(branch) == pytest.approx(points(backlash)[:3], abs=1e-9)
    assert [q.kind for q in branch.special_points] == ["grazing", "fold", "fold"]


def test_start_inside_the_span_runs_both_ways(backlash):
    branch = follow(rs.backlash(), (0.5, 1.6), start=1.2)
    assert points(branch, "fold") == pytest.approx(points(backlash, "fold"), abs=1e-9)
    assert sorted(branch.parameter[[0, -1]]) == pytest.approx([0.5, 1.6], abs=1e-12)
    steps = np.hypot(np.diff(branch.parameter), np.diff(branch.rms("x")))
    assert steps.max() < 0.2  # in order along the branch, not two halves from the middle


@pytest.mark.parametrize("harmonics", [63, 127])
def test_fixed_harmonics_agree_with_chosen_ones(backlash, harmonics):
    branch = follow(rs.backlash(), (0.5, 1.6), method=HarmonicBalance(harmonics=harmonics))
    assert {o.harmonic_count for o in branch.orbits} == {harmonics}
    for point, fine in zip(branch.special_points, backlash.special_points, strict=True):
        assert abs(point.parameter - fine.parameter) < 1e-5
        assert abs(point.parameter - fine.parameter) < 3 * (point.error + fine.error)


def test_stated_errors_hold(backlash):
    """Against the event-exact folds, printed to 8 digits."""
    folds = [q for q in backlash.special_points if q.kind == "fold"]
    for point, exact in zip(folds, (0.82846398, 0.70803162), strict=True):
        assert point.error < 1e-8
        assert abs(point.parameter - exact) < 5e-9 + point.error
        assert point.status == "located"


# ------------------------------------------------------------------------------------------------ ends
def test_end_is_met_exactly(backlash):
    assert backlash.parameter[[0, -1]] == pytest.approx([0.5, 1.6], abs=1e-13)
    assert backlash.stop == "reached omega = 1.6"


def test_start_at_a_fold_and_beyond():
    """A start exactly at a special point is as good as any; the point itself is found as well."""
    problem = METHOD.discretise(rs.duffing(), "omega")
    branch = trace(problem, problem.guess(omega=1.0), (1.0, 1.5))
    again = trace(problem, branch.special_points[0].orbit, (1.0, 1.5))
    assert sorted(points(again)) == pytest.approx(sorted(rs.DUFFING_FOLDS), abs=1e-9)


@pytest.mark.parametrize(
    ("span", "words"),
    [
        ((0.5, 0.5), "two different finite numbers"),
        ((0.5, float("nan")), "two different finite numbers"),
        ((0.5, float("inf")), "two different finite numbers"),
        ((0.6, 1.0), "does not contain the start at 0.5"),
    ],
)
def test_span_is_checked(span, words):
    problem = METHOD.discretise(rs.duffing(), "omega")
    with pytest.raises(ValueError, match=words):
        trace(problem, problem.guess(omega=0.5), span)


@pytest.mark.parametrize("options", [{"step": -0.1}, {"step": 0.0}, {"max_step": -1.0}, {"max_points": 0},
                                     {"step": float("nan")}])  # fmt: skip
def test_steps_are_checked(options):
    problem = METHOD.discretise(rs.duffing(), "omega")
    with pytest.raises(ValueError, match=next(iter(options))):
        trace(problem, problem.guess(omega=0.5), (0.5, 0.6), **options)


def test_limit_of_points():
    branch = follow(rs.duffing(), (0.5, 2.0), max_points=7)
    assert len(branch) == 7
    assert branch.stop.startswith("limit of 7 points reached at omega")


def test_interruption_keeps_what_is_finished():
    def stop_in_time(done, text):
        assert 0.0 <= done <= 1.0
        if 0.5 < done < 1.0:
            raise KeyboardInterrupt

    branch = follow(rs.backlash(), (0.5, 1.6), progress=stop_in_time)
    assert branch.stop.startswith("interrupted at omega = 1.0")
    assert branch.stop.endswith("are kept")
    assert 1.0 < branch.parameter[-1] < 1.2
    assert points(branch, "fold") == pytest.approx([0.82846398, 0.70803162], abs=1e-8)


def test_interruption_of_the_search_keeps_the_orbits():
    """Ctrl-C after the last step, while special points are located."""

    def stop_in_search(done, text):
        if "special points" in text:
            raise KeyboardInterrupt

    try:
        branch = follow(rs.duffing(), (0.5, 0.6), progress=stop_in_search)
    except KeyboardInterrupt:  # would end the whole test run
        pytest.fail("an interruption of the search loses the branch")
    assert branch.parameter[-1] == pytest.approx(0.6)
    assert "interrupted" in branch.stop


def test_interruption_on_the_way_back_keeps_both_sides():
    """The start lies inside; the second side is cut short."""
    seen = []

    def stop_in_time(done, text):
        seen.append(float(text.split("=")[1].split(",")[0]) if "=" in text else np.nan)
        if seen[-1] < 1.15:
            raise KeyboardInterrupt

    branch = follow(rs.backlash(), (0.5, 1.6), start=1.3, progress=stop_in_time)
    assert "interrupted" in branch.stop
    assert branch.parameter.max() == pytest.approx(1.6)
    assert 1.0 < branch.parameter.min() < 1.15


def test_progress_reports_the_way_done():
    calls = []
    follow(rs.duffing(), (0.5, 0.7), progress=lambda done, text: calls.append((done, text)))
    done = [d for d, _ in calls]
    assert done == sorted(done)
    assert done[-1] == 1.0
    assert all(isinstance(t, str) for _, t in calls)


def test_branch_that_cannot_go_on_says_why():
    """A model that ends at omega = 0.4, below which its stiffness is no longer real."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(
        name="ends",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -x - 0.2 * v - ca.sqrt(omega - 0.4) * x**3 + 0.3 * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    branch = follow(system, (0.5, 0.3))
    assert branch.stop.startswith("could not go on at omega = 0.4")
    assert "try a smaller step or more harmonics" in branch.stop
    assert branch.parameter[-1] == pytest.approx(0.4, abs=1e-3)
    assert len(branch) > 5


def test_closed_branch_is_noticed():
    """Equilibria on the circle (x - 2)^2 + p^2 = 1, shaken a little."""
    x, v, theta, omega, p = rs.symbols("x", "v", "theta", "omega", "p")
    system = System(
        name="isola",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -((x - 2) ** 2 + p**2 - 1) * (x + 1) - 3 * v + 1e-3 * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"p": (p, 0.0), "omega": (omega, 1.0)},
    )
    problem = METHOD.discretise(system, "p")
    rest = problem.guess(p=0.0)
    coefficients = np.zeros_like(rest.coefficients)
    coefficients[0, 0] = 3.0
    branch = trace(problem, problem.solve(replace(rest, coefficients=coefficients), 0.0), (-2.0, 2.0))
    assert branch.stop == "closed curve: came back to its start"
    assert sorted(points(branch, "fold")) == pytest.approx([-1.0, 1.0], abs=1e-4)
    means = [o.mean("x") for o in branch.orbits]
    assert (min(means), max(means)) == pytest.approx((1.0, 3.0), abs=0.02)


# ------------------------------------------------------------------------------------------------ the result
def test_branch_arrays(backlash):
    n = len(backlash)
    assert backlash.parameter.shape == backlash.rms("x").shape == backlash.stable.shape == backlash.error.shape == (n,)
    assert backlash.multipliers.shape == (n, 2)
    assert np.all(np.diff(np.abs(backlash.multipliers), axis=1) <= 1e-12)
    assert set(backlash.stability) == {"stable", "unstable"}
    assert (backlash.parameter_name, backlash.period_multiple) == ("omega", 1)
    assert backlash.unresolved == ()
    assert backlash.work["points"] == n
    assert backlash.work["factorisations"] >= backlash.work["newton_steps"] > n
    for key in ("method", "system", "casadi", "numpy"):
        assert backlash.provenance[key]


def test_unstable_orbits_lie_between_the_folds(backlash):
    """Along the branch the number of unstable multipliers changes at the two folds and nowhere else."""
    unstable = backlash.stability == "unstable"
    assert np.count_nonzero(np.diff(unstable.astype(int))) == 2
    changes = [(q.kind, bool(unstable[q.index]) ^ bool(unstable[q.index + 1])) for q in backlash.special_points]
    assert changes == [("grazing", False), ("fold", True), ("fold", True), ("grazing", False)]


def test_branch_prints_a_summary(backlash):
    text = str(backlash)
    assert text.splitlines()[0].startswith("Branch of 'backlash', period 1: ")
    assert "fold at omega = 0.82846398" in text
    assert "stopped: reached omega = 1.6" in text
    assert "unresolved" not in text


def test_branch_is_ready_for_json(backlash):
    document = json.loads(json.dumps(backlash.to_dict()))
    assert document["schema"] == 1
    assert len(document["points"]) == len(backlash)
    assert [q["kind"] for q in document["special_points"]] == ["grazing", "fold", "fold", "grazing"]
    assert document["special_points"][0]["parameter"] == backlash.special_points[0].parameter


def test_branch_is_immutable(backlash):
    with pytest.raises(AttributeError):
        backlash.stop = "no"
    with pytest.raises(AttributeError):
        backlash.special_points[0].parameter = 1.0
    assert isinstance(backlash.orbits, tuple)
    before = backlash.parameter
    before[0] = 99.0
    assert backlash.parameter[0] == pytest.approx(0.5)
    with pytest.raises(TypeError):
        backlash.work["points"] = 0


def test_branch_survives_its_file(backlash, tmp_path):
    backlash.save(tmp_path / "branch.nc")
    again = Branch.load(tmp_path / "branch.nc")
    assert np.array_equal(again.parameter, backlash.parameter)
    assert np.array_equal(again.multipliers, backlash.multipliers)
    assert str(again) == str(backlash)


# ------------------------------------------------------------------------------------------------ what must hold on it
def test_turns_are_folds(backlash):
    """Wherever the parameter turns back, a fold was located, and it is the extreme value there."""
    signs = np.sign(np.diff(backlash.parameter))
    turns = np.flatnonzero(signs[1:] != signs[:-1]) + 1
    assert len(turns) == 2
    folds = points(backlash, "fold")
    assert folds[0] >= backlash.parameter[: turns[1]].max()
    assert folds[1] <= backlash.parameter[turns[0] :].min()


def test_orbit_at_a_fold_has_a_useful_error(backlash):
    """Its waveform is as good as its neighbours', although the Jacobian at fixed parameter is singular there."""
    for q in backlash.special_points:
        assert q.orbit.error < 1e-5


def test_multiplier_at_a_point_is_the_critical_one(backlash):
    for q in backlash.special_points:
        assert (np.abs(q.multipliers - 1).min() < 1e-4) == (q.kind == "fold")


def test_a_branch_without_its_special_points_is_the_same_branch_and_says_so():
    problem = HarmonicBalance(harmonics=7).discretise(rs.duffing(), "omega")
    start = problem.guess(omega=0.5)
    whole, bare = (trace(problem, start, (0.5, 2.0), special_points=wanted) for wanted in (True, False))
    assert whole.special_points
    assert not bare.special_points
    assert "special points were not looked for" in bare.unresolved
    for orbit in bare.orbits:
        other = min(whole.orbits, key=lambda o: abs(o.value - orbit.value) + abs(o.rms("x") - orbit.rms("x")))
        assert orbit.value == pytest.approx(other.value, abs=1e-9)
        assert orbit.stability == other.stability
        assert orbit.multipliers == pytest.approx(other.multipliers, abs=1e-6)
    with pytest.raises(ValueError, match="functions: their zeros are special points"):
        trace(problem, start, (0.5, 2.0), functions={"f": lambda orbit: 1.0}, special_points=False)
