"""Integration in the time domain: CVODES, event-exact steps, and the recognition of what a map settles on."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from continuation import Contact, ContinuationError, System
from continuation.errors import UnsupportedModel
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.settling import Settling
from continuation.timedomain.variational import tangents

DEAD_ZONE = {"breakpoints": (-1.0, 1.0), "slopes": (1.0, 0.0, 1.0)}


def oscillator(acceleration, contacts=(), omega=0.7, **parameters):
    """Build x'' = acceleration(x, v, theta, contact forces) on fresh symbols."""
    x, v, theta, frequency = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    laws = [Contact(argument=c.pop("of", lambda x, theta: x)(x, theta), **c) for c in map(dict, contacts)]
    return System(
        name="oscillator",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta, *(c.force for c in laws))},
        contacts=laws,
        phase=theta,
        frequency="omega",
        parameters={"omega": (frequency, omega)},
    )


def backlash(amplitude=0.5, load=0.2):
    return oscillator(lambda x, v, theta, f: load + amplitude * ca.cos(theta) - 0.1 * v - f, [DEAD_ZONE])


REFERENCE_END = (-0.05952591, 1.95723279)  # x'' + .1x' + f(x) = .2 + .5cos(.7t), one period from (.5, .2)


@pytest.mark.parametrize("stiff", [False, True])
def test_cvodes_crosses_corners(stiff):
    path = CVODES(stiff=stiff).compile(backlash()).integrate([0.5, 0.2])
    assert path.shape == (65, 2)
    assert abs(path[-1] - REFERENCE_END).max() < 5e-7


def test_event_exact_crosses_corners():
    system = backlash()
    run = ExactIntegrator(system).integrate([0.5, 0.2], system.parameter_vector())
    assert abs(run.end - REFERENCE_END).max() < 6e-9
    assert [(i, d) for _, i, d in run.changes] == [(0, 1), (0, -1), (0, -1), (0, 1)]
    ends = run.states[list(run.places), 0]
    assert run.phases[list(run.places)].tolist() == [phase for phase, _, _ in run.changes]
    assert abs(abs(ends) - 1).max() < 1e-13


@pytest.mark.parametrize(("settings", "bound"), [(FixedStep(512), 1.5e-8), (FixedStep(256, 8), 6e-9)], ids=str)
def test_fixed_steps_cross_corners(settings, bound):
    system = backlash()
    run = settings.compile(system).run([0.5, 0.2], system.parameter_vector(), changes=True)
    assert abs(run.end - REFERENCE_END).max() < bound
    assert run.changes[:, 1:].tolist() == [[0, 1], [0, -1], [0, -1], [0, 1]]


def test_one_cvodes_integrator_serves_every_frequency():
    system = backlash()
    integrator, exact = CVODES().compile(system), ExactIntegrator(system)
    for omega in (0.3, 0.9, 2.0):
        path = integrator.integrate([0.5, 0.2], periods=2, omega=omega)
        run = exact.integrate([0.5, 0.2], system.parameter_vector({"omega": omega}), periods=2)
        phases = 2 * np.pi * np.arange(128) / 64
        assert abs(path[:-1] - exact.sample(run, system.parameter_vector({"omega": omega}), phases)).max() < 1e-6


def test_period_map_of_cvodes_depends_on_the_state_alone():
    integrator, p = CVODES().compile(backlash()), np.array([0.7])
    first = integrator.period(np.array([0.5, 0.2]), p)
    integrator.period(np.array([2.0, -1.0]), np.array([1.9]))
    assert np.array_equal(first, integrator.period(np.array([0.5, 0.2]), p))


def test_failed_integration_names_time_parameter_and_remedy():
    runaway = CVODES().compile(oscillator(lambda x, v, theta: 1 + x**2, omega=2.0))
    with pytest.raises(ContinuationError, match=r"(?s)omega = 2.*try stiff.*period 1 which begins at time 0") as caught:
        runaway.integrate([1.0, 0.0])
    assert "core/function.cpp" not in str(caught.value)


def test_event_exact_failure_names_phase_and_parameter():
    system = oscillator(lambda x, v, theta: x**2, omega=2.0)
    with pytest.raises(ContinuationError, match=r"stopped at phase .*omega = 2"):
        ExactIntegrator(system).integrate([10.0, 0.0], system.parameter_vector())


def test_misuse_is_refused():
    with pytest.raises(ValueError, match="rtol must be more than 0"):
        CVODES(rtol=0.0)
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        CVODES().compile(backlash()).integrate([0.0, 0.0], omgea=1.0)
    with pytest.raises(ContinuationError, match="must be positive"):
        CVODES().compile(backlash()).integrate([0.0, 0.0], omega=-1.0)
    x = ca.SX.sym("x")
    with pytest.raises(UnsupportedModel, match="autonomous"):
        CVODES().compile(System(name="decay", states={"x": x}, derivatives={"x": -x}, parameters={}))


def test_event_exact_error_follows_the_tolerance():
    system = backlash()
    p = system.parameter_vector()
    ends = {r: ExactIntegrator(system, rtol=r, atol=r / 100).integrate([0.5, 0.2], p, 3).end for r in
            (1e-6, 1e-8, 1e-10, 1e-13)}  # fmt: skip
    errors = [abs(ends[r] - ends[1e-13]).max() for r in (1e-6, 1e-8, 1e-10)]
    assert all(e < 30 * r for e, r in zip(errors, (1e-6, 1e-8, 1e-10), strict=True))
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-6, -1e-6])
def test_contact_shorter_than_a_step_is_seen(depth):
    """x(t) = cos t rides below a stop at 1 - depth that it meets for a short while around t = 2*pi."""
    stop = {"breakpoints": (1.0 - depth,), "slopes": (0.0, 1.0)}
    system = oscillator(lambda x, v, theta, f: -x - f, [stop], omega=0.5)
    p = system.parameter_vector()
    start = np.array([np.cos(2.0), -np.sin(2.0)])
    run = ExactIntegrator(system).integrate(start, p)
    duration = [b - a for (a, _, _), (b, _, _) in zip(run.changes[::2], run.changes[1::2], strict=True)]
    if depth < 0:
        assert duration == []
    else:
        expected = solve_ivp(
            lambda t, y: [y[1], -y[0] - max(y[0] - 1 + depth, 0)], (0, 4 * np.pi), start, method="DOP853",
            rtol=1e-13, atol=1e-14, max_step=1e-2
        ).y[:, -1]  # fmt: skip
        assert abs(run.end - expected).max() < 1e-9
        assert duration[0] == pytest.approx(0.5 * 2 * np.sqrt(2 * depth), rel=0.05)


def test_simultaneous_contact_changes():
    """Two equal contacts act as one of twice the slope."""
    load = {"omega": 0.7}
    twin = oscillator(lambda x, v, t, f, g: 0.3 + 0.5 * ca.cos(t) - 0.1 * v - f - g, [DEAD_ZONE, DEAD_ZONE])
    once = oscillator(
        lambda x, v, t, f: 0.3 + 0.5 * ca.cos(t) - 0.1 * v - f,
        [{"breakpoints": (-1.0, 1.0), "slopes": (2.0, 0.0, 2.0)}],
    )
    runs = [ExactIntegrator(s).integrate([0.5, 0.2], s.parameter_vector(load), 3) for s in (twin, once)]
    assert abs(runs[0].end - runs[1].end).max() < 1e-10
    assert len(runs[0].changes) == 2 * len(runs[1].changes)


def test_moving_contact_and_start_on_the_corner():
    """A stop whose position depends on the phase, started exactly on it."""
    moving = {"of": lambda x, theta: x - 0.3 * ca.sin(theta), "breakpoints": (0.5,), "slopes": (0.0, 4.0)}
    system = oscillator(lambda x, v, theta, f: 0.4 - 0.2 * v - f, [moving], omega=1.1)
    p = system.parameter_vector()
    run = ExactIntegrator(system).integrate([0.5, 1.0], p, 2)

    def rate(theta, y):
        return np.array([y[1], 0.4 - 0.2 * y[1] - 4 * max(y[0] - 0.3 * np.sin(theta) - 0.5, 0)]) / 1.1

    expected = solve_ivp(rate, (0, 4 * np.pi), [0.5, 1.0], method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.01).y
    assert run.changes
    assert abs(run.end - expected[:, -1]).max() < 1e-8


def test_fast_free_modes_keep_the_derivatives_accurate():
    """The state is at rest, so that its steps are long; the derivatives oscillate 60 times in the period."""
    system = oscillator(lambda x, v, theta: -3600 * x, omega=1.0)
    integrator, p = ExactIntegrator(system), system.parameter_vector()
    found = tangents(integrator, [integrator.integrate([0.0, 0.0], p)], p)
    assert abs(found.whole(0) - np.eye(2)).max() < 1e-6
    assert found.traces.sum() == 0.0
    assert len(found.h) > len(set(found.place))


def settle(step, start=(0.3,), samples=8, **settings):
    """Settle on a map given directly; its waveform is constant over each period."""
    options = {"tolerance": 1e-7, "floor": 0.01, "transient": 48, "limit": 400, "recorded": 64} | settings

    def advance(x):
        return np.vstack([np.tile(x, (samples, 1)), np.atleast_1d(step(x))])

    return Settling(advance, **options).run(np.array(start))


def logistic(r):
    return lambda x: r * x * (1 - x)


@pytest.mark.parametrize(("r", "period"), [(2.8, 1), (3.2, 2), (3.5, 4), (3.55, 8), (3.564, 8), (3.567, 16), (3.83, 3)])
def test_cascade_of_the_logistic_map(r, period):
    settled = settle(logistic(r))
    assert settled.period == period
    x = settled.state[0]
    for _ in range(period):
        x = logistic(r)(x)
    assert abs(x - settled.state[0]) < 1e-6
    assert len(settled.waveform) == 8 * period


@pytest.mark.parametrize("r", [3.7, 3.9])
def test_irregular_response_is_not_recognised(r):
    settled = settle(logistic(r))
    assert settled.period == 0
    assert settled.periods_used == 400
    assert len(settled.waveform) == 8 * 64


def test_quasi_periodic_response_is_not_recognised():
    c, s = np.cos(0.7), np.sin(0.7)
    assert settle(lambda x: (1.1 - 0.1 * (x @ x)) * (np.array([[c, -s], [s, c]]) @ x), (0.3, 0.2)).period == 0


@pytest.mark.parametrize("split", [0.1, 1e-2, 1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("start", [0.3, 1e-3])
def test_small_period_two_split_is_never_called_period_one(split, start):
    """x -> -(1 + split^2) x + x^3 has the period-2 response +-split and an unstable period-1 response 0."""
    settled = settle(lambda x: -(1 + split**2) * x + x**3, (start,), limit=2000)
    assert settled.period != 1
    if split >= 0.1:
        assert settled.period == 2


@pytest.mark.parametrize("multiplier", [0.999, -0.999, 1.0])
def test_slow_convergence_is_not_called_settled(multiplier):
    assert settle(lambda x: multiplier * x - 1e-3 * x**3).period == 0


@pytest.mark.parametrize("multiplier", [0.98, -0.98])
def test_slow_convergence_within_reach_is_summed(multiplier):
    settled = settle(lambda x: 1.0 + multiplier * (x - 1.0) + 0.01 * (x - 1.0) ** 2)
    assert settled.period == 1
    assert abs(settled.state[0] - 1.0) < 1e-6
    assert settled.periods_used < 300


def test_a_lost_trial_state_says_nothing_of_the_response():
    """The derivative is taken by differences; where they are lost, plain iteration goes on and decides."""
    known = {0.3}

    def fragile(x):
        if float(x[0]) not in known:
            raise ContinuationError("this state is not on the way")
        known.add(float(x[0] + 0.1 * (1.0 - x[0])))
        return x + 0.1 * (1.0 - x)

    settled = settle(fragile)
    assert settled.period == 1
    assert settled.state[0] == pytest.approx(1.0, abs=1e-6)


def test_saddle_passed_on_the_way_is_left():
    """From the stable side of a saddle, 1e-9 beside its stable line, to the attractor at x = 1."""
    settled = settle(lambda y: np.array([y[0] + 0.2 * y[0] * (1 - y[0]), 0.5 * y[1]]), (1e-9, 1.0))
    assert settled.period == 1
    assert abs(settled.state - [1.0, 0.0]).max() < 1e-6
