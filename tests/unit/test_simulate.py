"""One interface to all integrators: the same trajectory, contact changes and outputs, driven or autonomous."""

import casadi as ca
import numpy as np
import pytest
from general_contacts import hertz
from reference_systems import backlash, duffing, symbols
from scipy.integrate import solve_ivp

from continuation import CVODES, Contact, ContinuationError, System
from continuation.errors import IntegrationFailed
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.simulate import EventExact, simulate

HIGH = np.array([0.8338430125, 0.1640787518])
INTEGRATORS = (CVODES(rtol=1e-11, atol=1e-13), EventExact(), FixedStep(256, 8))


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
@pytest.mark.parametrize("span", [2, 2.3])
def test_the_high_orbit_of_the_backlash_oscillator(integrator, span):
    run = simulate(backlash(), HIGH, span, integrator=integrator, omega=0.75)
    assert run.phases[-1] == pytest.approx(2 * np.pi * span)
    assert run.time[-1] == pytest.approx(2 * np.pi * span / 0.75)
    assert abs(run.states[64] - HIGH).max() < 2e-8  # after one period
    assert abs(run.states[:40] - run.states[64:104]).max() < 2e-8
    force = run.outputs["contact force"]
    assert abs(force - np.maximum(run.states[:, 0] - 1, 0)).max() < 1e-15
    rows = run.intervals()
    open_ = (rows[:, 1] - rows[:, 0])[rows[:, 2] == 1]
    assert open_[1] / (2 * np.pi) == pytest.approx(0.54175, abs=3e-6)
    assert rows[1:, 0] == pytest.approx(rows[:-1, 1])
    assert len(run.changes) == (4 if span == 2 else 5)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
@pytest.mark.parametrize("phases", [[], [0.0], [3.0], np.pi * np.arange(300) / 150 + 1e-9])
def test_contact_changes_do_not_depend_on_the_phases_asked_for(integrator, phases):
    few, many = (simulate(backlash(), HIGH, 2.3, integrator=integrator, omega=0.75, phases=p) for p in (phases, None))
    assert few.phases[:-1] == pytest.approx(np.array([p + 2 * np.pi * k for k in range(3) for p in phases
                                                      if p + 2 * np.pi * k < 2 * np.pi * 2.3]))  # fmt: skip
    assert few.end == pytest.approx(many.end, abs=1e-8)
    assert np.array_equal(few.changes[:, 1:], many.changes[:, 1:])
    assert abs(few.changes[:, 0] - many.changes[:, 0]).max() < 1e-6
    assert len(few.intervals()) == 6


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_chosen_phases(integrator):
    every = simulate(duffing(), [1.0, 0.5], 1.6, integrator=INTEGRATORS[1], omega=1.1)
    run = simulate(
        duffing(), [1.0, 0.5], 1.6, integrator=integrator, omega=1.1, phases=2 * np.pi * np.array([0.25, 0.75])
    )
    assert run.phases / (2 * np.pi) == pytest.approx([0.25, 0.75, 1.25, 1.6])
    assert abs(run.states - every.states[[16, 48, 80, -1]]).max() < 1e-8
    assert run.outputs == {}
    assert run.changes.shape == (0, 3)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_autonomous_systems(integrator):
    """A mass thrown at a spring stop: half a free flight, then half an oscillation, then back."""
    x, v = symbols("x", "v")
    stop = Contact(argument=x, breakpoints=(1.0,), slopes=(0.0, 4.0))
    system = System(name="bounce", states={"x": x, "v": v}, derivatives={"x": v, "v": -stop.force}, parameters={},
                    contacts=[stop], outputs={"energy": v**2 / 2})  # fmt: skip
    run = simulate(system, [0.0, 1.0], 3.5, integrator=integrator)
    assert run.time == pytest.approx(run.phases)
    assert run.changes[:, 0] == pytest.approx([1.0, 1.0 + np.pi / 2], abs=1e-6)
    assert run.intervals()[:, 2].tolist() == [0, 1, 0]
    assert run.end == pytest.approx([1 - (3.5 - 1 - np.pi / 2), -1.0], abs=1e-8)
    assert run.outputs["energy"][-1] == pytest.approx(0.5, abs=1e-8)
    assert "2 contact changes" in str(run)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_failures_are_named(integrator):
    x, theta, omega = symbols("x", "theta", "omega")
    system = System(name="tangent", states={"x": x}, derivatives={"x": 1 + x**2}, phase=theta, frequency="omega",
                    parameters={"omega": (omega, 4.0)})  # fmt: skip
    with pytest.raises(IntegrationFailed, match="omega = 4"):
        simulate(system, [0.0], 3, integrator=integrator)


def test_derivatives_over_contact_changes():
    """The monodromy matrix of the high orbit: multipliers 0.43845790 +- 0.49034086i, determinant exp(-2 zeta T)."""
    run = simulate(backlash(), HIGH, 1, derivatives=True, omega=0.75)
    multipliers = np.linalg.eigvals(run.tangent)
    assert sorted(multipliers, key=np.imag)[1] == pytest.approx(0.43845790 + 0.49034086j, abs=2e-7)
    assert np.linalg.det(run.tangent) == pytest.approx(np.exp(-0.1 * 2 * np.pi / 0.75), abs=1e-10)
    assert set(run.sensitivities) == set(run.parameters)
    step = 1e-5
    for name, found in run.sensitivities.items():
        ends = [simulate(backlash(), HIGH, 1, **{**run.parameters, name: run.parameters[name] + d}).end
                for d in (-step, step)]  # fmt: skip
        assert found == pytest.approx((ends[1] - ends[0]) / 2 / step, abs=2e-6)
    assert simulate(backlash(), HIGH, 1, omega=0.75).tangent.shape == (0, 0)


def test_derivatives_of_an_autonomous_system():
    """Decay x' = -a x to time 1.5: dx/dx0 = exp(-1.5 a), dx/da = -1.5 x."""
    x, a = symbols("x", "a")
    decay = System(name="decay", states={"x": x}, derivatives={"x": -a * x}, parameters={"a": (a, 0.4)})
    run = simulate(decay, [2.0], 1.5, derivatives=True)
    assert run.tangent[0, 0] == pytest.approx(np.exp(-0.6), abs=1e-9)
    assert run.sensitivities["a"] == pytest.approx([-1.5 * 2 * np.exp(-0.6)], abs=1e-8)


def test_misuse_is_refused():
    with pytest.raises(ValueError, match="derivatives come with EventExact"):
        simulate(duffing(), [1.0, 0.0], 1, integrator=FixedStep(), derivatives=True)
    for arguments, message in (
        (([1.0], 1), "2 finite states"),
        (([np.nan, 0.0], 1), "2 finite states"),
        (([1.0, 0.0], 0), "span must be positive"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate(duffing(), *arguments)
    with pytest.raises(ValueError, match="increasing numbers"):
        simulate(duffing(), [1.0, 0.0], 1, phases=[7.0])
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        simulate(duffing(), [1.0, 0.0], 1, omgea=1.0)
    with pytest.raises(ValueError, match="must be positive"):
        simulate(duffing(), [1.0, 0.0], 1, omega=-1.0)
    with pytest.raises(ValueError, match="rtol must be positive"):
        EventExact(rtol=0.0)
    assert issubclass(IntegrationFailed, ContinuationError)


@pytest.mark.parametrize("integrator", [EventExact(), FixedStep(512)], ids=lambda i: type(i).__name__)
def test_a_power_of_a_contact_force_is_integrated_through_the_end_of_contact(integrator):
    """Beyond the end of contact the 3/2 power has no value, but a step looks there before it lands."""
    system = hertz()
    begin, periods = np.zeros(len(system.state_names)), 5.3
    run = simulate(system, begin, periods, integrator=integrator)
    f = ca.Function("f", [system.x, system.theta, system.p], [system.closed()])
    p, omega = system.parameter_vector(), system.defaults["omega"]
    end = 2 * np.pi * periods / omega
    exact = solve_ivp(lambda t, z: f(z, omega * t, p).full().ravel(), (0, end), begin, "DOP853", rtol=1e-11, atol=1e-12)
    assert len(run.changes) > 4
    assert run.end == pytest.approx(exact.y[:, -1], abs=1e-6)
