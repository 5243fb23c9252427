"""Several segments, other integrators and other methods: the same orbits, verdicts and special points."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import CVODES, ContinuationError, HarmonicBalance, NoConvergence, Shooting, System, trace
from continuation.errors import RestingContact
from continuation.orbits.floquet import distance
from continuation.orbits.orbit import Orbit
from continuation.orbits.shooting_start import newton

BRANCHES = [  # system, parameter, start, far end of the span, kind and published place of the special point, its digits
    (rs.duffing, "omega", {"omega": 1.13}, 1.11, ("fold", 1.1157002518, 2e-10)),
    (rs.backlash, "omega", {"omega": 0.72, "x": 0.83, "v": 0.16}, 0.7, ("fold", 0.70803162, 6e-9)),
    (rs.parametric_backlash, "omega", {"omega": 0.72, "x": 0.2, "v": -0.77}, 0.7, ("fold", 0.7056974892, 1e-10)),
    (rs.double_well, "g", {"g": 0.264}, 0.267, ("period-doubling", 0.2655817860556, 5e-11)),
    (rs.absorber, "omega", {"omega": 1.11}, 1.115, ("neimark-sacker", 1.1127112391, 2e-10)),
]


@pytest.mark.parametrize(
    ("case", "segments"),
    [(case, m) for case in BRANCHES for m in (1, 2, 5, 16) if m in (1, 5) or case[0] is not rs.parametric_backlash],
    ids=lambda v: v[0].__name__ if isinstance(v, tuple) else str(v),
)
def test_the_number_of_segments_changes_no_verdict(case, segments):
    make, parameter, start, end, (kind, value, digits) = case
    system = make()
    problem = Shooting(segments=segments).discretise(system, parameter)
    orbit = problem.guess(**start)
    assert orbit.stability == "stable"
    assert len(problem.unknown(orbit)) == segments * len(system.state_names)
    width = abs(end - orbit.value)
    branch = trace(problem, orbit, (orbit.value, end), step=width / 8, max_step=width / 4)
    assert branch.unresolved == ()
    (point,) = branch.special_points
    assert (point.kind, point.status) == (kind, "located")
    assert abs(point.parameter - value) < digits + point.error
    assert point.error < 1e-9
    assert np.count_nonzero(branch.stability[1:] != branch.stability[:-1]) == 1
    assert set(branch.stability) == {"stable", "unstable"}


@pytest.mark.parametrize("segments", [2, 5, 16])
def test_orbits_and_multipliers_of_the_gear(segments):
    system = rs.gear()
    single = Shooting(segments=1).discretise(system, "frequency_ratio")
    orbit = single.guess(frequency_ratio=0.7)
    assert len(orbit.contacts["mesh"][0]) == 2
    other = Shooting(segments=segments).discretise(system, "frequency_ratio").from_orbit(orbit)
    assert distance(other.multipliers, orbit.multipliers).max() < 2e-9
    assert np.all(distance(other.multipliers, orbit.multipliers) < other.multiplier_error + orbit.multiplier_error)
    assert other.contacts["mesh"][0] == pytest.approx(orbit.contacts["mesh"][0], abs=1e-8)
    phases = np.linspace(0, 2 * np.pi, 200)
    assert abs(other.evaluate(phases) - orbit.evaluate(phases)).max() < 2e-8
    assert other.stability == orbit.stability == "stable"


@pytest.mark.parametrize(("segments", "period_multiple"), [(3, 1), (4, 2)])
def test_derivatives_against_differences(segments, period_multiple):
    system = rs.backlash()
    method = Shooting(segments=segments, rtol=1e-13, atol=1e-15)
    problem = method.discretise(system, "omega", period_multiple)
    one = Shooting(segments=1, rtol=1e-13, atol=1e-15).discretise(system, "omega", period_multiple)
    p = 0.75
    u = problem.joined(one.waveform(np.array([0.85, 0.15]), p, segments)) + 1e-3
    F, J, Fp = problem.linearise(u, p)
    assert F.shape == (2 * segments,)
    v, w = np.random.default_rng(0).normal(size=(2, 2))

    def slope(f, h=1e-3):
        return (8 * (f(h) - f(-h)) - f(2 * h) + f(-2 * h)) / (12 * h)

    gradient, by_parameter = problem.form_gradients(u, p, v, w)
    for i, unit in enumerate(np.eye(len(u))):
        assert slope(lambda h, d=unit: problem.residual(u + h * d, p)) == pytest.approx(J[:, i], abs=1e-7)
        form = slope(lambda h, d=unit: w @ problem.monodromy(u + h * d, p) @ v)
        assert form == pytest.approx(gradient[i], abs=1e-6)
    assert np.array_equal(gradient, problem.form_gradient(u, p, v, w))
    assert slope(lambda h: problem.residual(u, p + h)) == pytest.approx(Fp, abs=1e-7)
    form = slope(lambda h: w @ problem.monodromy(u, p + h) @ v)
    assert form == pytest.approx(by_parameter["omega"], abs=1e-5)


def test_any_parameter_by_name_and_by_setting_its_value():
    problem = Shooting(segments=3, rtol=1e-12, atol=1e-14).discretise(rs.duffing(), "omega")
    orbit = problem.guess(omega=0.8)
    u = problem.unknown(orbit)
    exact = problem.parameter_derivative(u, 0.8, "g")
    sides = []
    for g in (0.18 + 1e-4, 0.18 - 1e-4):
        problem.set_value("g", g)
        assert problem.vector(0.8).tolist() == [0.8, g]
        sides.append(problem.residual(u, 0.8))
    assert (sides[0] - sides[1]) / 2e-4 == pytest.approx(exact, abs=1e-8)
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        problem.parameter_derivative(u, 0.8, "omgea")
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        problem.set_value("omgea", 1.0)


@pytest.mark.parametrize("segments", [1, 4])
@pytest.mark.parametrize("integrator", [None, CVODES(rtol=1e-11, atol=1e-13)])
def test_flow_and_phase_direction(segments, integrator):
    problem = Shooting(segments=segments, integrator=integrator).discretise(rs.duffing(), "omega")
    u = problem.unknown(problem.guess(omega=0.8))
    wave = problem.waveform(u, 0.8, 360)
    slope = (8 * (wave[1] - wave[-1]) - (wave[2] - wave[-2])) / (12 * 2 * np.pi / 360)
    assert problem.flow(u, 0.8) == pytest.approx(slope, abs=1e-6)
    direction = problem.states(problem.phase_direction(u, 0.8))
    assert direction[0] == pytest.approx(problem.flow(u, 0.8), abs=1e-12)
    assert not direction[1:].any()


# ------------------------------------------------------------------------------------------------ unstable orbits
def inverted(k: float) -> tuple[System, Orbit]:
    """x'' = k^2 x + cos(theta): x = -cos / (k^2 + omega^2), multipliers exp(+-k T); the orbit with 1 % error."""
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    system = System(name="inverted", states={"x": x, "v": v}, derivatives={"x": v, "v": k**2 * x + ca.cos(theta)},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
    amplitude = -1.01 / (k**2 + 1)
    coefficients = np.array([[0.0, 0.0], [amplitude / 2, 0.5j * amplitude]])
    orbit = Orbit(system="inverted", state_names=("x", "v"), parameter="omega", parameters={"omega": 1.0},
                  period=2 * np.pi, period_multiple=1, coefficients=coefficients, multipliers=np.full(2, np.nan),
                  multiplier_error=np.full(2, np.inf), stability="undecided", error=1.0)  # fmt: skip
    return system, orbit


@pytest.mark.parametrize("k", [1.0, 4.0, 9.0])
def test_segments_are_chosen_by_the_growth(k):
    system, crude = inverted(k)
    problem = Shooting().discretise(system, "omega")
    orbit = problem.from_orbit(crude)
    growth = 2 * np.pi * k
    assert problem.segments == pytest.approx(growth / np.log(1e3), abs=1)
    assert orbit.evaluate(0.0)[0] == pytest.approx([-1 / (k**2 + 1), 0.0], abs=1e-9)
    assert np.log(abs(orbit.multipliers)) == pytest.approx([growth, -growth], abs=1e-6)
    error = abs(orbit.multipliers - np.exp([growth, -growth]))
    assert np.all(error <= orbit.multiplier_error)
    assert orbit.stability == "unstable"


def test_one_segment_says_that_it_cannot():
    system, crude = inverted(9.0)
    with pytest.raises(NoConvergence, match="more segments") as caught:
        Shooting(segments=1).discretise(system, "omega").from_orbit(crude)
    assert caught.value.orbit is crude
    assert len(caught.value.history) >= 1
    assert caught.value.parameter == 1.0


# ------------------------------------------------------------------------------------------------ other methods
def test_orbits_go_from_method_to_method():
    system = rs.duffing()
    harmonic = HarmonicBalance(tolerance=1e-10).discretise(system, "omega")
    orbit = harmonic.guess(omega=0.8)
    methods = [Shooting(), Shooting(segments=4), Shooting(integrator=CVODES(rtol=1e-11, atol=1e-13))]
    phases = np.linspace(0, 2 * np.pi, 100)
    for method in methods:
        shot = method.discretise(system, "omega").from_orbit(orbit)
        assert abs(shot.evaluate(phases) - orbit.evaluate(phases)).max() < 1e-8
        assert distance(shot.multipliers, orbit.multipliers).max() < 1e-8
        back = harmonic.solve(shot, 0.8)
        assert abs(back.evaluate(phases) - orbit.evaluate(phases)).max() < 1e-8


def test_orbits_that_do_not_fit_are_refused():
    orbit = Shooting().discretise(rs.duffing(), "omega").guess(omega=0.8)
    with pytest.raises(ValueError, match="the orbit is of system 'duffing'"):
        Shooting().discretise(rs.absorber(), "omega").from_orbit(orbit)
    with pytest.raises(ValueError, match=r"g = 0.18, the problem of g = 0.2; give g=0.18"):
        Shooting().discretise(rs.duffing(), "omega", g=0.2).from_orbit(orbit)
    twice = Shooting().discretise(rs.duffing(), "omega", 2).from_orbit(orbit)
    with pytest.raises(ValueError, match="has no period 1"):
        Shooting().discretise(rs.duffing(), "omega").from_orbit(twice)
    with pytest.raises(ValueError, match="segments must be a whole number"):
        Shooting(segments=0)
    in_force = Shooting().discretise(rs.duffing(), "g", omega=0.8).from_orbit(orbit)  # another parameter, same orbit
    assert in_force.value == 0.18
    assert in_force.evaluate(0.0) == pytest.approx(orbit.evaluate(0.0), abs=1e-9)


def test_cvodes_traces_the_same_branch():
    method = Shooting(integrator=CVODES(rtol=1e-11, atol=1e-13))
    problem = method.discretise(rs.double_well(), "g")
    branch = trace(problem, problem.guess(g=0.265), (0.265, 0.266), step=5e-4, max_step=1e-3)
    (point,) = branch.special_points
    assert point.kind == "period-doubling"
    assert abs(point.parameter - 0.2655817860556) < point.error < 1e-9


@pytest.mark.parametrize("segments", [1, 5])
def test_cycle_of_an_autonomous_system(segments):
    """Van der Pol: the period at mu = 1 is 6.66328685932313 (Krogdahl's series and every later computation)."""
    x, v, mu = rs.symbols("x", "v", "mu")
    system = System(name="van der Pol", states={"x": x, "v": v}, derivatives={"x": v, "v": mu * (1 - x**2) * v - x},
                    parameters={"mu": (mu, 1.0)})  # fmt: skip
    crude = Orbit(system="van der Pol", state_names=("x", "v"), parameter="mu", parameters={"mu": 1.0}, period=6.6,
                  period_multiple=1, coefficients=np.array([[0.0, 0.0], [1.0, 1.0j]]), multipliers=np.full(2, np.nan),
                  multiplier_error=np.full(2, np.inf), stability="undecided", error=1.0)  # fmt: skip
    orbit = Shooting(segments=segments).discretise(system, "mu").from_orbit(crude)
    assert orbit.period == pytest.approx(6.66328685932313, abs=1e-9)
    assert abs(orbit.multipliers - 1).min() < 1e-8
    assert orbit.stability == "stable"


# ------------------------------------------------------------------------------------------------ contact, errors
def test_contact_phases_and_separation():
    """REFERENCE of the backlash oscillator at 0.75, high orbit: separated 0.54175 of the time."""
    orbits = []
    for segments in (1, 5):
        problem = Shooting(segments=segments).discretise(rs.backlash(), "omega")
        orbits.append(problem.guess(omega=0.75, x=0.834, v=0.164))
        assert orbits[-1].rms("x") == pytest.approx(0.22472379, abs=2e-8)
        (close, open_), pieces = orbits[-1].contacts["mesh"]
        assert pieces.tolist() == [1, 2, 1]
        assert 1 - (open_ - close) / (2 * np.pi) == pytest.approx(0.54175, abs=5e-6)
    for a, b in zip(*(o.contacts["mesh"][0] for o in orbits), strict=True):
        assert a == pytest.approx(b, abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_errors_are_what_they_claim(seed):
    """Random orbits at loose tolerances: waveform and multipliers against a tolerance of 1e-12."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 0:
        system = rs.backlash()
    elif seed % 3 == 1:
        system = rs.duffing()
    else:
        system = rs.stops(damping=rng.uniform(0.1, 0.3), gain=rng.uniform(-0.4, 0.4), force=rng.uniform(0.2, 1.0),
                          width=rng.uniform(0.1, 1.0), stops=1 + seed % 2)  # fmt: skip
    omega, rtol, segments = rng.uniform(0.6, 1.6), 10.0 ** -rng.integers(5, 10), int(rng.choice([1, 3]))
    exact = Shooting(segments=1, rtol=1e-12, atol=1e-14).discretise(system, "omega")
    try:
        reference = exact.guess(omega=omega)
    except ContinuationError:
        reference = exact.guess(omega=1.9)
    omega = reference.value
    u, _ = newton(exact, exact.unknown(reference), omega)
    orbit = Shooting(segments=segments, rtol=rtol, atol=rtol / 100).discretise(system, "omega").solve(reference, omega)
    wave = exact.waveform(u, omega, 999)
    assert abs(orbit.evaluate(2 * np.pi * np.arange(999) / 999) - wave).max() < orbit.error
    assert np.all(distance(orbit.multipliers, reference.multipliers) < orbit.multiplier_error)


def test_an_orbit_that_rests_on_a_breakpoint_is_named():
    x, v, theta, omega, load = rs.symbols("x", "v", "theta", "omega", "load")
    mesh = rs.dead_zone(x)
    system = System(name="idle", states={"x": x, "v": v}, derivatives={"x": v, "v": load - 0.1 * v - mesh.force},
                    contacts=[mesh], phase=theta, frequency="omega",
                    parameters={"omega": (omega, 1.0), "load": (load, 0.0)})  # fmt: skip
    problem = Shooting().discretise(system, "load")
    with pytest.raises(RestingContact, match=r"load = 0.*give the load another value"):
        problem.guess(x=1.0)
    assert problem.guess(load=0.1).stability == "stable"
