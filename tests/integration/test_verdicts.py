"""Multipliers lie within their error bars, and no setting of any method turns a verdict into its opposite."""

import dataclasses
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import (
    Collocation,
    Contact,
    ContinuationError,
    HarmonicBalance,
    Shooting,
    System,
    certify,
    trace,
)
from continuation.branches import analysis
from continuation.orbits import contact_series, waves
from continuation.orbits.contact_residual import contact_defect
from continuation.orbits.floquet import build_orbit, conditioned, distance, verdict
from continuation.orbits.monodromy import Monodromy, monodromy, multipliers


def oscillator(middle):
    """A forced and parametrically excited oscillator whose stiffness between -1 and 1 is ``middle``, 1 outside."""
    x, v, theta, omega, zeta, gain, load, force = rs.symbols(
        "x", "v", "theta", "omega", "zeta", "gain", "load", "force"
    )
    mesh = Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(1.0, middle, 1.0), name="mesh")
    push = load + force * ca.cos(theta) - (1 + gain * ca.cos(theta)) * mesh.force
    return System(
        name="oscillator",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": push - 2 * zeta * v},
        phase=theta,
        frequency="omega",
        parameters={k: (s, 0.1) for k, s in zip(("omega", "zeta", "gain", "load", "force"),
                                                (omega, zeta, gain, load, force), strict=True)},
        contacts=[mesh],
    )  # fmt: skip


def random_orbits(seed, count, methods):
    """Yield orbits with contact loss at random parameters, some off the attracting one, with problem and parameters."""
    rng, found = np.random.default_rng(seed), 0
    systems = [oscillator(middle) for middle in (0.0, 0.3, 3.0)]
    while found < count:
        system = systems[found % 3]
        values = {
            "zeta": 10 ** rng.uniform(-2.3, -0.7),
            "gain": rng.choice([0.0, 0.2, 0.5]),
            "load": rng.uniform(0.05, 1.0),
            "force": rng.uniform(0.1, 1.2),
        }
        problem = methods[rng.integers(len(methods))].discretise(system, "omega", **values)
        omega = rng.uniform(0.4, 2.2)
        try:
            orbit = problem.guess(omega=omega)
            for step in (1.0, 0.99, 0.98, 0.97):
                orbit = problem.solve(orbit, omega * step)
                if orbit.contacts["mesh"][0].size:
                    found += 1
                    yield problem, orbit, values
        except ContinuationError:
            continue


def exact_multipliers(orbit, system, values):
    """Multipliers at the exact orbit next to the one given, by tight event-exact shooting."""
    problem = Shooting(segments=1, rtol=1e-12, atol=1e-14).discretise(system, "omega", **values)
    u = problem.unknown(orbit)
    for _ in range(6):
        F, J, _ = problem.linearise(u, orbit.value)
        step = np.linalg.solve(J, F)
        u = u - step
        if np.abs(step).max() < 1e-10:
            return multipliers(problem.monodromies([(u, orbit.value)]))[0], u
    return None, u


def test_over_random_backlash_orbits_the_error_bars_are_true():
    """Of over a hundred, and not silly: the median true error is more than a thousandth of its bar."""
    ratios = []
    methods = [HarmonicBalance(), HarmonicBalance(), HarmonicBalance(harmonics=15), HarmonicBalance(harmonics=31)]
    for problem, orbit, values in random_orbits(1, 104, methods):
        exact, u = exact_multipliers(orbit, problem.system, values)
        if exact is None or np.abs(u - orbit.evaluate(0.0)[0]).max() > 0.01:
            continue  # another orbit, or none, next to a fold
        ratios.append(np.max(distance(orbit.multipliers, exact) / orbit.multiplier_error))
    ratios = np.array(ratios)
    assert len(ratios) >= 100
    assert np.mean(ratios <= 1) >= 0.95
    assert ratios.max() < 3
    assert np.median(ratios) > 1e-3


def settings():
    return [HarmonicBalance(), *(HarmonicBalance(harmonics=h) for h in (7, 15, 31, 63, 127)), Shooting()]


def verdicts(orbits):
    """The verdicts of one orbit by several settings, less the undecided ones."""
    return {o.stability for o in orbits} - {"undecided"}


def solved(system, parameter, orbit, value, **values):
    """The same orbit by every setting that converges to it."""
    out = []
    for method in settings():
        problem = method.discretise(system, parameter, period_multiple=orbit.period_multiple, **values)
        try:
            found = problem.solve(orbit, value)
        except ContinuationError:
            continue  # too few harmonics, or past a fold in that discretisation
        if np.abs(found.evaluate(0.0) - orbit.evaluate(0.0)).max() < 0.1:
            out.append(found)
    return out


@pytest.mark.parametrize("distance_", [-1e-3, -1e-5, -1e-7, 0.0, 1e-7, 1e-5, 1e-3])
def test_next_to_a_doubling_of_the_gear_pair_no_setting_contradicts(distance_):
    value = rs.GEAR_DOUBLINGS[0] + distance_
    system = rs.gear()
    orbit = HarmonicBalance(harmonics=63).discretise(system, "frequency_ratio").guess(frequency_ratio=1.43)
    orbit = HarmonicBalance(harmonics=63).discretise(system, "frequency_ratio").solve(orbit, value)
    found = solved(system, "frequency_ratio", orbit, value)
    assert len(found) >= 5
    assert len(verdicts(found)) <= 1
    if abs(distance_) >= 1e-3:
        assert verdicts(found) == {"unstable" if distance_ < 0 else "stable"}
        assert found[0].stability != "undecided"


def test_at_random_no_setting_contradicts():
    compared = 0
    for problem, orbit, values in random_orbits(5, 12, [HarmonicBalance()]):
        found = solved(problem.system, "omega", orbit, orbit.value, **values)
        compared += len(found)
        assert len(verdicts(found)) <= 1, (values, orbit.value)
    assert compared > 50


@lru_cache
def duffing_branch():
    """A resonance with two folds and an unstable part between them."""
    problem = HarmonicBalance().discretise(rs.duffing(), "omega")
    return trace(problem, problem.guess(omega=0.9), (0.9, 1.5))


@pytest.mark.parametrize("segments", [1, 2, 5])
def test_segments_and_intervals_change_no_verdict(segments):
    system, branch = rs.duffing(), duffing_branch()
    unstable = next(o for o in branch.orbits if o.stability == "unstable")
    for given in (branch.orbits[0], unstable):
        problems = (Shooting(segments=segments), Collocation(intervals=20 * segments))
        for method in problems:
            found = method.discretise(system, "omega").from_orbit(given)
            assert found.stability == given.stability
            assert distance(found.multipliers, given.multipliers).max() < 1e-5


# ------------------------------------------------------------------------------------------------ wrong contact phases
def shifted(monkeypatch, where, by=0.1):
    """Shift the contact phases that the integration uses, or those that everything uses."""
    if where == "integration":
        table = waves._padded
        monkeypatch.setattr(waves, "_padded", lambda found: (table(found)[0] + by, table(found)[1]))
        return
    search = contact_series.find_patterns

    def late(arguments, contact):
        return [dataclasses.replace(f, phases=f.phases + by) for f in search(arguments, contact)]

    monkeypatch.setattr(contact_series, "find_patterns", late)


@pytest.mark.parametrize("where", ["integration", "search"])
def test_contact_phases_wrong_by_a_tenth_are_caught(monkeypatch, where):
    """Liouville's determinant sees nothing, the trace is constant; the residual at the contacts does.

    The stiffness varies: were it constant, a shift of all changes would be one of the origin and harmless.
    """
    problem = HarmonicBalance(harmonics=63).discretise(rs.parametric_backlash(), "omega")
    orbit = problem.guess(omega=0.8)
    u = problem.unknown(orbit)
    right = monodromy(problem, [(u, 0.8)])
    assert contact_defect(problem, u, 0.8, right.patterns[0])[0] < 1e-9
    shifted(monkeypatch, where)
    wrong = monodromy(problem, [(u, 0.8)])
    assert abs(wrong.liouville[0]) < 1e-11
    moved = np.abs(multipliers(wrong.matrices) - multipliers(right.matrices)).max()
    assert moved > 0.005
    assert contact_defect(problem, u, 0.8, wrong.patterns[0])[0] == pytest.approx(0.1, rel=0.2)
    judged = problem.orbits([(u, 0.8, orbit.error)])[0]
    assert np.all(judged.multiplier_error > distance(judged.multipliers, orbit.multipliers))
    assert judged.stability == "undecided"
    if where == "integration":
        assert np.nanmax(judged.second_opinion) > 0.3 * moved
        assert certify(problem, orbit).contact_defect > 0.05


def test_a_contact_that_was_missed_is_caught():
    problem = HarmonicBalance(harmonics=63).discretise(rs.parametric_backlash(), "omega")
    orbit = problem.guess(omega=0.8)
    (pattern,) = monodromy(problem, [(problem.unknown(orbit), 0.8)]).patterns[0]
    missed = (contact_series.ContactPattern(pattern.phases[2:], pattern.modes[2:]),)
    assert contact_defect(problem, problem.unknown(orbit), 0.8, missed)[0] > 0.1
    none = (contact_series.ContactPattern(np.zeros(0), np.array([2])),)
    defect, effect = contact_defect(problem, problem.unknown(orbit), 0.8, none)
    assert defect == pytest.approx(2 * np.pi)
    assert effect > 1


# ------------------------------------------------------------------------------------------------ small and bad numbers
def damped_stop(damping):
    """An oscillator with a stop and two strongly damped filters, whose multipliers are known."""
    x, v, y, z, theta, omega = rs.symbols("x", "v", "y", "z", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(0.5,), slopes=(0.0, 2.0))
    return System(
        name="filters",
        states={"x": x, "v": v, "y": y, "z": z},
        derivatives={"x": v, "v": ca.cos(theta) - x - 0.2 * v - stop.force, "y": x - damping * y,
                     "z": y - 1.5 * damping * z},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.7)},
        contacts=[stop],
    )  # fmt: skip


@pytest.mark.parametrize("damping", [2.0, 8.0, 20.0, 90.0])
def test_strongly_damped_multipliers_keep_their_digits(damping):
    problem = HarmonicBalance().discretise(damped_stop(damping), "omega")
    orbit = problem.guess(omega=0.7)
    wanted = np.exp(-2 * np.pi / 0.7 * damping * np.array([1.0, 1.5]))
    assert orbit.multipliers[2:].real == pytest.approx(wanted, rel=1e-8, abs=1e-306)
    assert np.all(orbit.multiplier_error[2:] <= 1e-7 * wanted + 1e-300)
    assert orbit.stability == "stable"


def test_exponents_and_decay_times_of_damped_modes():
    orbit = HarmonicBalance().discretise(damped_stop(8.0), "omega").guess(omega=0.7)
    assert orbit.exponents[2:].real == pytest.approx([-8.0, -12.0], rel=1e-8)
    assert orbit.decay_times[2:] == pytest.approx([1 / 8, 1 / 12], rel=1e-8)
    assert orbit.exponents[:2].real.sum() == pytest.approx(-0.2, abs=1e-6)  # Liouville


def test_numbers_that_are_none_are_undecided_and_crash_nothing():
    nan = float("nan")
    assert verdict(np.array([nan]), np.array([0.1])) == "undecided"
    assert verdict(np.array([0.5]), np.array([nan])) == "undecided"
    assert verdict(np.array([nan, 0.1]), np.array([0.1, 0.1])) == "undecided"
    assert verdict(np.array([0.5, 0.1]), np.array([np.inf, 0.1])) == "undecided"
    assert verdict(np.array([np.inf]), np.array([np.inf])) == "undecided"
    assert np.all(np.isinf(distance(np.array([nan, 1.0]), np.array([1.0, 1.0]))))
    broken = np.array([np.eye(2), np.full((2, 2), nan), [[1.0, 1.0], [0.0, 1.0]]])
    values, reach, _ = conditioned(broken)
    assert np.isnan(values[1]).all()
    assert np.isinf(reach[1]).all()
    assert np.all(reach[2] > 1e8)  # a Jordan block
    assert np.isnan(multipliers(broken)[1]).all()


def test_an_orbit_whose_monodromy_matrix_is_not_finite_is_undecided(monkeypatch):
    from continuation.orbits import floquet

    problem = HarmonicBalance().discretise(rs.duffing(), "omega")
    orbit = problem.guess(omega=0.6)

    def overflown(problem, orbits):
        flow = monodromy(problem, orbits)
        return Monodromy(flow.matrices * np.inf, flow.liouville, flow.patterns)

    with monkeypatch.context() as patch, np.errstate(all="ignore"):
        patch.setattr(floquet, "monodromy", overflown)
        assert problem.orbits([(problem.unknown(orbit), 0.6, 0.0)])[0].stability == "undecided"


def test_counts_are_never_inferred_from_undecided_orbits():
    orbit = HarmonicBalance().discretise(rs.duffing(), "omega").guess(omega=0.6)
    sizes = {"in": [0.5, 0.2], "out": [1.5, 0.2], "near": [1.0 + 1e-7, 0.2], "none": [np.nan, np.nan]}

    def path(*names):
        return [
            dataclasses.replace(
                orbit, multipliers=np.array(sizes[n], dtype=complex), multiplier_error=np.full(2, 1e-6)
            )
            for n in names
        ]  # fmt: skip

    assert analysis._unexplained(path("in", "near", "none", "in"), []) == []
    assert analysis._unexplained(path("in", "near", "near"), []) == []
    assert len(analysis._unexplained(path("in", "near", "none", "out"), [])) == 1
    assert analysis._unexplained(path("near", "out"), [], autonomous=True) == []
    assert len(analysis._unexplained(path("in", "out"), [])) == 1


# ------------------------------------------------------------------------------------------------ certificates
def test_certificate_of_the_gear_pair():
    system = rs.gear()
    problem = HarmonicBalance().discretise(system, "frequency_ratio")
    orbit = problem.guess(frequency_ratio=0.75)
    found = certify(problem, orbit)
    assert set(found.methods) == {"integration", "Hill, strip", "Hill, symmetric", "shooting"}
    assert not found.missing
    assert found.stability == orbit.stability == "stable"
    assert found.reason.startswith("stable: the largest multiplier has modulus 0.9")
    assert max(d.max() for d in found.differences.values()) < 5e-6
    assert np.all(found.error >= orbit.multiplier_error)
    assert abs(found.liouville) < 1e-10
    assert found.contact_defect < 1e-9


@pytest.mark.parametrize("method", [Shooting(), Collocation()])
def test_certificate_of_an_orbit_of_another_method(method):
    problem = method.discretise(rs.duffing(), "omega")
    orbit = problem.guess(omega=0.8)
    found = certify(problem, orbit)
    assert type(method).__name__.lower() in found.methods
    assert len(found.methods) == 4 + isinstance(method, Collocation)
    assert max(d.max() for d in found.differences.values()) < 1e-7
    assert found.stability == "stable"


def test_certificate_of_an_autonomous_orbit():
    system = rs.third_order()
    name = next(iter(system.defaults))
    problem = HarmonicBalance().discretise(system, name)
    orbit = problem.guess()
    found = certify(problem, orbit)
    assert np.abs(found.multipliers - 1).min() < 1e-6
    assert found.stability == orbit.stability
    assert len(found.methods) == 4


def test_certificate_that_is_undecided_says_which_multiplier():
    fold = duffing_branch().special_points[0]
    assert fold.kind == "fold"
    found = certify(fold.problem, fold.orbit)
    assert found.stability == "undecided"
    assert "lies within its error bar" in found.reason


def test_certificate_of_the_wrong_system_is_refused():
    orbit = HarmonicBalance().discretise(rs.duffing(), "omega").guess(omega=0.6)
    with pytest.raises(ValueError, match="the orbit is of system 'duffing', the problem of 'absorber'"):
        certify(HarmonicBalance().discretise(rs.absorber(), "omega"), orbit)


def test_multipliers_that_overflow_make_no_certificate():
    problem = HarmonicBalance().discretise(rs.duffing(), "omega")
    orbit = problem.guess(omega=0.6)
    u = problem.unknown(orbit)
    none = np.full(2, np.nan)
    bare = build_orbit(problem, 0.6, problem.state_spectrum(u, 0.6), none.astype(complex), none, 0.0)
    found = certify(problem, bare)
    assert found.stability == "undecided"


def test_the_leading_multiplier_of_every_orbit_has_a_second_opinion():
    problem = HarmonicBalance().discretise(rs.parametric_backlash(), "omega")
    backlash = trace(problem, problem.guess(omega=0.95), (0.95, 0.8))
    assert any(o.contacts["mesh"][0].size for o in backlash.orbits)
    for orbit in (*backlash.orbits, *duffing_branch().orbits):
        assert np.isfinite(orbit.second_opinion[0])
        assert np.all(orbit.multiplier_error >= np.nan_to_num(orbit.second_opinion))
