"""Harmonic balance against exact answers, SciPy's integrators, and itself at four times the resolution."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import (
    Contact,
    ContinuationError,
    HarmonicBalance,
    NoConvergence,
    SingularLinearPart,
    System,
    trace,
)
from sbg_casadi import gear_system, static_state

METHOD = HarmonicBalance()


def oscillator(acceleration, contact=None, **parameters):
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    contacts = [contact(x)] if contact else []
    return System(
        name="oscillator",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta, *(c.force for c in contacts))},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=contacts,
    )


def compare_with_scipy(system, value, state=2e-6, multiplier=5e-5, turns=1):
    """Return the orbit found without a guess after comparing it, and its multipliers, with shooting by SciPy."""
    orbit = METHOD.discretise(system, system.frequency, period_multiple=turns).guess(**{system.frequency: value})
    x, M = rs.ExactFlow(system, **{system.frequency: value}).orbit(orbit.evaluate(0.0)[0], turns)
    assert orbit.evaluate(0.0)[0] == pytest.approx(x, abs=state)
    assert rs.multiplier_distance(np.linalg.eigvals(M), orbit.multipliers) < multiplier
    assert orbit.period == pytest.approx(2 * np.pi * turns / value, rel=1e-14)
    return orbit


# ------------------------------------------------------------------------------------------------ linear systems
@pytest.mark.parametrize("omega", [0.2, 0.9, 1.0, 2.7])
def test_linear_oscillator_is_its_receptance(omega):
    orbit = METHOD.discretise(rs.linear_oscillator(zeta=0.03, force=0.4), "omega").guess(omega=omega)
    exact = 0.4 / (1 - omega**2 + 2j * 0.03 * omega)
    assert 2 * orbit.harmonics("x")[1] == pytest.approx(exact, abs=1e-13)
    assert orbit.rms("v") == pytest.approx(omega * abs(exact) / np.sqrt(2), rel=1e-12)
    poles = np.roots([1, 0.06, 1])
    assert rs.multiplier_distance(np.exp(poles * orbit.period), orbit.multipliers) < 1e-10
    assert orbit.stability == "stable"
    assert orbit.error < 1e-13


@pytest.mark.parametrize("damping", [0.05, 0.0])
@pytest.mark.parametrize("omega", [0.3, 1.1, 4.0])
def test_linear_chain_is_its_receptance(omega, damping):
    """Three masses with a dead load; undamped off resonance too, where no orbit is decidedly stable."""
    orbit = METHOD.discretise(rs.linear_chain(damping), "omega").guess(omega=omega)
    dynamic = rs.CHAIN_STIFFNESS * (1 + 1j * omega * damping) - omega**2 * rs.CHAIN_MASS
    exact = np.linalg.solve(dynamic, rs.CHAIN_LOAD)
    assert 2 * orbit.coefficients[1, :3] == pytest.approx(exact, abs=1e-12)
    assert 2 * orbit.coefficients[1, 3:] == pytest.approx(1j * omega * exact, abs=1e-12)
    static = np.linalg.solve(rs.CHAIN_STIFFNESS, [0.1, 0.0, 0.0])
    assert orbit.coefficients[0, :3].real == pytest.approx(static, abs=1e-13)
    assert orbit.stability == ("stable" if damping else "undecided")


def test_linear_oscillator_at_its_undamped_resonance_has_no_orbit():
    with pytest.raises(ContinuationError):
        METHOD.discretise(rs.linear_oscillator(zeta=0.0), "omega").guess(omega=1.0)


def test_linear_branch_has_no_special_point():
    problem = METHOD.discretise(rs.linear_oscillator(), "omega")
    branch = trace(problem, problem.guess(omega=0.5), span=(0.5, 1.5))
    assert branch.special_points == ()
    exact = 0.4 / np.abs(1 - branch.parameter**2 + 2j * 0.03 * branch.parameter) / np.sqrt(2)
    assert branch.rms("x") == pytest.approx(exact, rel=1e-11)


def test_gear_pair_without_stiffness_variation_does_not_vibrate():
    orbit = METHOD.discretise(rs.gear(scale=0.0), "frequency_ratio").guess(frequency_ratio=0.9)
    assert orbit.evaluate([0.0, 1.0, 2.0]) == pytest.approx(np.tile(static_state(rs.GEAR), (3, 1)), abs=1e-13)
    assert max(orbit.rms(name) for name in orbit.state_names) < 1e-13


@pytest.mark.parametrize("ratio", [0.55, 1.0, 1.6])
def test_mean_mesh_force_is_the_load(ratio):
    """T / a3 whatever the vibration; the force is evaluated in the time domain, with its corners."""
    system = rs.gear()
    orbit = METHOD.discretise(system, "frequency_ratio").guess(frequency_ratio=ratio)
    theta = np.linspace(0, 2 * np.pi, 20001)[:-1]
    x = orbit.evaluate(theta)
    lam, dlam = x[:, orbit.index("lambda")], x[:, orbit.index("dlambda")]
    dead = np.sign(lam) * np.maximum(np.abs(lam) - 1, 0)
    force = (1 + 0.3 * np.cos(theta) + 0.1 * np.cos(2 * theta)) * dead + 0.04 * dlam
    assert force.mean() == pytest.approx(0.14 / 0.77, abs=1e-7)


# ------------------------------------------------------------------------------------------------ singular linear parts
@pytest.mark.parametrize("omega", [0.5, 1.0])
def test_mass_held_by_the_contact_alone(omega):
    """A rigid body as soon as the gap is open: the linear part has the poles 0 and -0.1."""
    system = oscillator(lambda x, v, theta, f: 0.1 + 0.05 * ca.cos(theta) - 0.1 * v - f, rs.dead_zone)
    assert compare_with_scipy(system, omega).stability == "stable"


def test_no_damping_at_all_and_a_contact():
    orbit = compare_with_scipy(oscillator(lambda x, v, theta, f: 0.1 + 0.5 * ca.cos(theta) - f, rs.dead_zone), 2.7)
    assert np.abs(orbit.multipliers) == pytest.approx([1.0, 1.0], abs=1e-9)


@pytest.mark.parametrize(("omega", "sort"), [(1.0, "unstable"), (2.0, "unstable")])
def test_gap_that_opens(omega, sort):
    """One-sided stop, free flight otherwise: multipliers beyond -1, found from rest all the same."""
    stop = lambda x: Contact(argument=x, breakpoints=(1.0,), slopes=(0.0, 2.0))  # noqa: E731
    system = oscillator(lambda x, v, theta, f: 0.05 + 0.3 * ca.cos(theta) - 0.1 * v - f, stop)
    assert compare_with_scipy(system, omega).stability == sort


@pytest.mark.parametrize("omega", [1.0, 1 / 3, 0.5])
def test_undamped_oscillator_on_a_resonance_of_its_linear_part(omega):
    """1 - k^2 omega^2 = 0 at k = 1, 3, 2; the cubic port carries the load."""
    system = oscillator(lambda x, v, theta: -x - 0.3 * x**3 + 0.2 * ca.cos(theta))
    orbit = compare_with_scipy(system, omega, state=1e-8, multiplier=1e-8)
    assert np.abs(orbit.multipliers) == pytest.approx([1.0, 1.0], abs=1e-9)


@pytest.mark.parametrize("omega", [0.7, 1.0])
def test_spring_without_linear_part(omega):
    compare_with_scipy(oscillator(lambda x, v, theta: -(x**3) + 0.2 * ca.cos(theta) - 0.1 * v), omega, 1e-7, 1e-7)


def test_parametric_spring_of_zero_mean():
    """y'' = 2 q cos(2t) y + load - c y': no mean stiffness anywhere, yet the port reaches the mass."""
    system = oscillator(lambda x, v, theta: (0.4 * ca.cos(theta)) * x + 0.1 * ca.cos(2 * theta) - 0.05 * v)
    compare_with_scipy(system, 2.0, 1e-8, 1e-8)


def test_rigid_mode_out_of_reach_is_refused():
    x, v, y, w, theta, omega = rs.symbols("x", "v", "y", "w", "theta", "omega")
    system = System(
        name="loose",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "v": -x - 0.1 * v - x**3 + ca.cos(theta), "y": w, "w": ca.cos(theta) - 0.1 * w},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    with pytest.raises(SingularLinearPart, match="ground the mode"):
        METHOD.discretise(system, "omega").guess(omega=1.0)


def test_absolute_rotations_of_a_free_pair_are_refused():
    """Both bodies may turn together: the relative coordinate is needed."""
    x, v, y, w, theta, omega = rs.symbols("x", "v", "y", "w", "theta", "omega")
    mesh = rs.dead_zone(x - y)
    push = mesh.force + 0.1 * (v - w) - 0.2
    system = System(
        name="free pair",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "v": -push + 0.1 * ca.cos(theta), "y": w, "w": push},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[mesh],
    )
    with pytest.raises(SingularLinearPart, match="relative coordinate"):
        METHOD.discretise(system, "omega").guess(omega=1.0)


# ------------------------------------------------------------------------------------------------ several ports
def test_model_without_port_structure_is_solved_in_full():
    system = rs.coupled_van_der_pol()
    assert METHOD.discretise(system, "omega").ports.inputs == 4
    for omega in (1.3, 2.0):
        compare_with_scipy(system, omega, state=1e-7, multiplier=1e-7)


def test_two_contacts_and_a_modulated_gain():
    compare_with_scipy(rs.stops(damping=0.1, gain=0.3, force=0.5, width=0.4, stops=2), 0.8)


def test_two_periods():
    compare_with_scipy(rs.double_well().with_parameters(g=0.28), 1.2, 1e-5, 1e-5, turns=2)


def test_smoothed_orbit_against_scipy():
    compare_with_scipy(rs.gear().smoothed(0.01), 1.0, 2e-6, 1e-5)


def test_transmission_error_moves_the_contact_argument():
    """Error harmonics of a gear pair: the argument and the damping force carry the phase and the frequency."""
    pair = replace(rs.GEAR, error_cosine=(0.2, 0.05), error_sine=(0.1, 0.0))
    compare_with_scipy(gear_system(pair), 0.9, 3e-6, 1e-5)


def test_parameter_that_is_no_frequency():
    """Same orbit whether reached with the load or with the frequency as the continuation parameter."""
    system = rs.duffing()
    one = METHOD.discretise(system, "g", omega=0.8).guess(g=0.3)
    other = METHOD.discretise(system, "omega", g=0.3).guess(omega=0.8)
    assert one.parameters == other.parameters
    assert one.rms("x") == pytest.approx(other.rms("x"), rel=1e-10)
    assert (one.value, other.value) == (0.3, 0.8)


# ------------------------------------------------------------------------------------------------ derivatives
@pytest.mark.parametrize("name", ["backlash", "parametric backlash", "absorber", "two contacts", "gear", "full form"])
@pytest.mark.parametrize("multiple", [1, 2])
def test_jacobian_and_parameter_derivative(name, multiple):
    builders = {
        "backlash": rs.backlash,
        "parametric backlash": rs.parametric_backlash,
        "absorber": rs.absorber,
        "two contacts": lambda: rs.stops(damping=0.1, gain=0.3, force=0.5, width=0.4, stops=2),
        "gear": rs.gear,
        "full form": rs.coupled_van_der_pol,
    }
    system = builders[name]()
    problem = HarmonicBalance(harmonics=6).discretise(system, system.frequency, period_multiple=multiple)
    rng, p = np.random.default_rng(4), 0.9
    u = rng.standard_normal(13 * problem.ports.outputs) * 0.5
    _, J, Fp = problem.linearise(u, p)
    h = 1e-6
    assert (problem.residual(u, p + h) - problem.residual(u, p - h)) / (2 * h) == pytest.approx(Fp, abs=2e-8)
    for d in rng.standard_normal((3, u.size)):
        difference = (problem.residual(u + h * d, p) - problem.residual(u - h * d, p)) / (2 * h)
        assert difference == pytest.approx(J @ d, abs=3e-7)


# ------------------------------------------------------------------------------------------------ error estimate
def test_error_estimate_is_truthful():
    """Against four times the harmonics on random oscillators with one and two contacts, coarse to fine."""
    rng, ratios = np.random.default_rng(11), []
    theta = np.linspace(0, 2 * np.pi, 1500)
    for i in range(24):
        system = rs.stops(damping=rng.uniform(0.03, 0.3), gain=rng.uniform(0, 0.4), force=rng.uniform(0.3, 1.0),
                          width=rng.uniform(0.2, 0.8), stops=1 + i % 2)  # fmt: skip
        omega, H = rng.uniform(0.5, 2.0), (7, 15, 31)[i % 3]
        fine = HarmonicBalance(harmonics=4 * H + 3).discretise(system, "omega")
        try:
            coarse = HarmonicBalance(harmonics=H).discretise(system, "omega").guess(omega=omega)
            true = fine.solve(coarse, omega)
        except NoConvergence:
            continue
        C = fine.ports.linear(fine.vector(omega)).C
        off = np.abs((coarse.evaluate(theta) - true.evaluate(theta)) @ C.T).max()
        if coarse.error > 1e-12:
            ratios.append(off / coarse.error)
    assert len(ratios) > 18
    assert np.mean(np.array(ratios) < 3.0) >= 0.95
    assert np.median(ratios) > 0.1  # nor is it hopelessly pessimistic


def test_error_falls_with_the_fourth_power_of_the_harmonics():
    """The waveform of an oscillator whose force has corners has Fourier coefficients of order k^-4, error H^-3."""
    orbit, errors = None, []
    for H in (15, 31, 63, 127):
        problem = HarmonicBalance(harmonics=H).discretise(rs.backlash(), "omega")
        orbit = problem.solve(orbit, 1.0) if orbit else problem.guess(omega=1.0)
        errors.append(np.abs(orbit.evaluate(0.0)[0] - (0.9059653748, 0.0557744441)).max())
    assert errors[-1] < 1e-7
    rate = np.log2(errors[0] / errors[-1]) / 3
    assert 2.0 < rate < 5.0


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_harmonics_are_chosen_by_the_error(tolerance):
    problem = HarmonicBalance(tolerance=tolerance, max_harmonics=1023).discretise(rs.parametric_backlash(), "omega")
    orbit = problem.guess(omega=0.9)
    assert orbit.error < tolerance * np.sqrt(orbit.rms("x") ** 2 + orbit.mean("x") ** 2) * 1.01
    coarser = HarmonicBalance(harmonics=max(7, (orbit.harmonic_count - 1) // 4)).discretise(problem.system, "omega")
    assert coarser.solve(orbit, 0.9).error > tolerance / 10  # not far more harmonics than were needed


def test_limit_of_harmonics_is_kept_and_told():
    problem = HarmonicBalance(max_harmonics=15, tolerance=1e-9).discretise(rs.parametric_backlash(), "omega")
    orbit = problem.guess(omega=0.9)
    assert orbit.harmonic_count == 15
    assert orbit.error > 1e-9


# ------------------------------------------------------------------------------------------------ misuse
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"harmonics": 0}, "harmonics: expected a whole number"),
        ({"harmonics": 1.5}, "harmonics: expected a whole number"),
        ({"tolerance": 0.0}, "tolerance: expected a number between 0 and 1"),
        ({"tolerance": float("nan")}, "tolerance: expected a number between 0 and 1"),
        ({"max_harmonics": 0}, "max_harmonics"),
    ],
)
def test_settings_are_checked(settings, words):
    with pytest.raises(ValueError, match=words):
        HarmonicBalance(**settings)


def test_unknown_names_list_the_nearest():
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        METHOD.discretise(rs.duffing(), "omgea")
    with pytest.raises(ValueError, match="no parameter 'gg'; did you mean 'g'"):
        METHOD.discretise(rs.duffing(), "omega", gg=1.0)
    with pytest.raises(ValueError, match="no parameter 'amplitude'; known: 'omega', 'g'"):
        METHOD.discretise(rs.duffing(), "omega").guess(amplitude=1.0)
    orbit = METHOD.discretise(rs.gear(), "frequency_ratio").guess(frequency_ratio=2.0)
    with pytest.raises(ValueError, match="did you mean 'lambda'"):
        orbit.rms("lamda")


def test_other_misuse():
    x, k = ca.SX.sym("x"), ca.SX.sym("k")
    decay = System(name="decay", states={"x": x}, derivatives={"x": -k * x}, parameters={"k": (k, 1.0)})
    with pytest.raises(ValueError, match="has no parameter 'x'"):
        METHOD.discretise(decay, "x")
    with pytest.raises(NoConvergence, match="settles on an equilibrium"):
        METHOD.discretise(decay, "k").guess(k=1.0)
    problem = METHOD.discretise(rs.duffing(), "omega")
    for value in (0.0, -1.0):
        with pytest.raises(ValueError, match="expected a positive number"):
            problem.guess(omega=value)
    with pytest.raises(ValueError, match=r"fixed at 0\.18 in this problem; give it to discretise"):
        problem.guess(omega=0.5, g=0.3)
    with pytest.raises(ValueError, match="period_multiple"):
        METHOD.discretise(rs.duffing(), "omega", period_multiple=0)
    with pytest.raises(ValueError, match="is of system 'duffing', the problem of 'chain'"):
        METHOD.discretise(rs.linear_chain(0.1), "omega").solve(problem.guess(omega=0.5), 0.6)


def test_doubled_orbit_does_not_fit_a_single_period():
    doubled = METHOD.discretise(rs.duffing(), "omega", period_multiple=2).guess(omega=0.5)
    with pytest.raises(ValueError, match="has no period 1"):
        METHOD.discretise(rs.duffing(), "omega").solve(doubled, 0.5)


def test_single_orbit_on_twice_its_period():
    """The same orbit, its multipliers squared."""
    single = METHOD.discretise(rs.backlash(), "omega").guess(omega=1.0)
    doubled = METHOD.discretise(rs.backlash(), "omega", period_multiple=2).solve(single, 1.0)
    assert doubled.rms("x") == pytest.approx(single.rms("x"), rel=1e-6)
    assert rs.multiplier_distance(single.multipliers**2, doubled.multipliers) < 1e-5
    theta = np.array([0.3, 2.0])
    assert doubled.evaluate(theta + 2 * np.pi) == pytest.approx(doubled.evaluate(theta), abs=1e-9)


def test_no_orbit_is_told_with_what_to_try():
    drift = oscillator(lambda x, v, theta: 1.0 + ca.cos(theta) - 0.2 * v + 1e-3 * ca.exp(x) * v**2)
    with pytest.raises(NoConvergence, match=r"no periodic orbit.*start at another parameter value"):
        METHOD.discretise(drift, "omega").guess(omega=1.0)


def test_orbit_is_immutable_and_speaks():
    orbit = METHOD.discretise(rs.duffing(), "omega").guess(omega=0.5)
    with pytest.raises(AttributeError):
        orbit.error = 0.0
    assert orbit.harmonics("x")[0] == orbit.coefficients[0, 0]
    low, high = orbit.extremes("x")
    x = orbit.evaluate(np.linspace(0, 2 * np.pi, 5001))[:, 0]
    assert (low, high) == pytest.approx((x.min(), x.max()), abs=1e-6)
    assert orbit.rms("x") == pytest.approx(x[:-1].std(), rel=1e-9)
    assert "duffing" in repr(orbit)
    with pytest.raises(ValueError, match="read-only"):
        orbit.coefficients[0, 0] = 1.0
