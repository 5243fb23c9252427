"""Event-exact steps: order in a mode and across contact changes, derivatives of both orders, failures with names."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import Contact, ContinuationError, System
from continuation.errors import Chattering, GrazingContact, IntegrationFailed, RestingContact, Runaway, TooManySteps
from continuation.model.compiled import find_compiler
from continuation.timedomain.contact_changes import first_change
from continuation.timedomain.dormand_prince import NODES
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.runge_kutta import StepFunctions, step_functions
from continuation.timedomain.second_derivatives import form_gradients
from continuation.timedomain.trajectory import interpolate
from continuation.timedomain.variational import sensitivities, tangents

TIGHT = {"rtol": 1e-13, "atol": 1e-15}


def moving_stop() -> System:
    """A stop of gap ``gap`` that moves with ``swing`` sin(theta): its argument depends on phase and parameters."""
    x, v, theta, omega, gap, swing, k = rs.symbols("x", "v", "theta", "omega", "gap", "swing", "k")
    stop = Contact(argument=x - swing * ca.sin(theta) - gap, breakpoints=(0.0,), slopes=(0.0, 1.0), name="stop")
    push = k * stop.force * (1 + 0.2 * x)
    return System(
        name="moving stop",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": ca.cos(theta) - 0.1 * v - x - 0.1 * x**3 - push},
        contacts=[stop],
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.9), "gap": (gap, 0.3), "swing": (swing, 0.2), "k": (k, 2.0)},
    )


def two_stops() -> System:
    return rs.stops(damping=0.1, gain=0.2, force=0.6, width=0.3, stops=2)


CASES = [  # system, state at phase 0, frequency; all but the first meet contact changes
    (rs.duffing, (0.5, -0.2), 1.1),
    (rs.backlash, (0.85, 0.15), 0.75),
    (rs.parametric_backlash, (0.3, -0.7), 0.72),
    (moving_stop, (0.2, 0.1), 0.9),
    (two_stops, (0.5, 0.1, 0.2, -0.1), 0.8),
]


def whole(integrator: ExactIntegrator, x, p, periods=1) -> tuple[np.ndarray, np.ndarray]:
    """Return the state after some periods and its derivative by the first one."""
    run = integrator.integrate(x, p, periods)
    return run.end, tangents(integrator, [run], p).whole(0)


# ------------------------------------------------------------------------------------------------ orders
def test_order_of_the_step_and_of_its_matrix_in_a_mode():
    """Halving the step divides the error of state and derivative by 2^8."""
    system = rs.duffing()
    functions, p = step_functions(system), system.parameter_vector({"omega": 0.7})
    x0 = np.array([1.5, 0.4])
    exact = whole(ExactIntegrator(system, **TIGHT), x0, p)

    def fixed(count: int) -> tuple[float, float]:
        x, M, h = x0, np.eye(2), 2 * np.pi / count
        for k in range(count):
            matrix = functions.transition(x[None], np.array([k * h]), np.array([h]), p[None], *np.zeros((2, 1, 0)))[0]
            x, M = functions.step(x, k * h, h, p, [], [])[0], matrix[0].T @ M
        return abs(x - exact[0]).max(), abs(M - exact[1]).max()

    coarse, fine = fixed(20), fixed(40)
    assert all(2**7 < a / b < 2**10 for a, b in zip(coarse, fine, strict=True))


@pytest.mark.parametrize("case", CASES[1:], ids=lambda c: c[0].__name__)
def test_order_across_contact_changes(case):
    """Over steps N chosen by the tolerance the errors of state and matrix fall like N^-8 through the changes."""
    make, x0, omega = case
    system = make()
    p = system.parameter_vector({"omega": omega})
    periods = 4
    exact = whole(ExactIntegrator(system, **TIGHT), x0, p, periods)
    counts, errors = [], []
    for rtol in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10):
        integrator = ExactIntegrator(system, rtol=rtol, atol=rtol / 100)
        run = integrator.integrate(x0, p, periods)
        found = run.end, tangents(integrator, [run], p).whole(0)
        assert len(run.changes) >= 4
        counts.append(len(run.modes) - len(run.changes))
        errors.append([abs(a - b).max() for a, b in zip(found, exact, strict=True)])
    slopes = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert np.all(slopes < -6.5)
    assert np.all(np.array(errors)[-1] < 1e-7)


def test_interpolant_is_as_accurate_as_the_steps():
    system = rs.backlash()
    integrator, p = ExactIntegrator(system), system.parameter_vector({"omega": 0.75})
    run = integrator.integrate([0.8338430125, 0.1640787518], p)
    phases = np.linspace(0, 2 * np.pi, 997)
    off = interpolate(run, integrator.interpolant(run, p), phases) - integrator.sample(run, p, phases)
    assert abs(off).max() < 1e-9


# ------------------------------------------------------------------------------------------------ derivatives
def differences(f, h=2e-3):
    """Return the derivative of a smooth function of one number at 0, sixth order."""
    one, two, three = ((f(k) - f(-k)) / (2 * k) for k in (h, h / 2, h / 4))
    return (16 * (4 * three - two) / 3 - (4 * two - one) / 3) / 15


@pytest.mark.parametrize("case", CASES, ids=lambda c: c[0].__name__)
def test_first_derivatives_by_states_and_every_parameter(case):
    make, x0, omega = case
    system, x0 = make(), np.array(x0)
    p, integrator = system.parameter_vector({"omega": omega}), ExactIntegrator(system, **TIGHT)
    run = integrator.integrate(x0, p)
    found = tangents(integrator, [run], p)
    for i, unit in enumerate(np.eye(len(x0))):
        expected = differences(lambda h, d=unit: integrator.integrate(x0 + h * d, p).end)
        assert found.whole(0)[:, i] == pytest.approx(expected, abs=1e-7)
    for unit in np.eye(len(p)):
        expected = differences(lambda h, d=unit: integrator.integrate(x0, p + h * d).end)
        assert sensitivities(integrator, found, 1, p, unit)[0] == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("case", CASES, ids=lambda c: c[0].__name__)
def test_second_derivatives_across_contact_changes(case):
    """The gradient of w . M v against differences of the transition matrix, whose slope jumps at no change."""
    make, x0, omega = case
    system, x0 = make(), np.array(x0)
    p, integrator = system.parameter_vector({"omega": omega}), ExactIntegrator(system, **TIGHT)
    v, w = np.random.default_rng(1).normal(size=(2, len(x0)))
    run = integrator.integrate(x0, p, 2)
    assert (len(run.changes) > 2) == bool(system.contacts)
    by_state, by_parameters = form_gradients(integrator, run, tangents(integrator, [run], p), 0, p, v, w)

    def form(x, q):
        return w @ whole(integrator, x, q, 2)[1] @ v

    scale = abs(by_state).max()
    for value, unit in zip(by_state, np.eye(len(x0)), strict=True):
        assert value == pytest.approx(differences(lambda h, d=unit: form(x0 + h * d, p)), abs=1e-7 * scale)
    for value, unit in zip(by_parameters, np.eye(len(p)), strict=True):
        assert value == pytest.approx(differences(lambda h, d=unit: form(x0, p + h * d)), abs=1e-7 * scale)


def test_second_derivatives_without_the_jumps_would_be_wrong():
    """With contacts the smooth part alone misses most of the gradient: the law is linear in every mode."""
    system = rs.backlash()
    p, integrator = system.parameter_vector({"omega": 0.75}), ExactIntegrator(system)
    run = integrator.integrate([0.85, 0.15], p)
    found = tangents(integrator, [run], p)
    with_jumps = form_gradients(integrator, run, found, 0, p, np.ones(2), np.ones(2))[0]
    object.__setattr__(run, "changes", ())
    object.__setattr__(run, "places", ())
    without = form_gradients(integrator, run, found, 0, p, np.ones(2), np.ones(2))[0]
    assert abs(without).max() < 1e-12 < 0.1 < abs(with_jumps).max()


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("case", CASES[2:4], ids=lambda c: c[0].__name__)
def test_machine_code_gives_the_same(case):
    make, x0, omega = case
    system, results = make(), []
    p = system.parameter_vector({"omega": omega})
    for machine_code in (False, True):
        integrator = ExactIntegrator(system, machine_code=machine_code)
        run = integrator.integrate(x0, p)
        found = tangents(integrator, [run], p)
        push = sensitivities(integrator, found, 1, p, np.ones(len(p)))
        results.append([run.end, found.whole(0), push, found.traces, integrator.interpolant(run, p)])
        assert ("compiled" in integrator.functions.note) == machine_code
    assert all(abs(a - b).max() < 1e-11 for a, b in zip(*results, strict=True))


def test_machine_code_is_made_when_it_pays(monkeypatch):
    system = rs.duffing()
    functions = StepFunctions(system, None)
    functions.count(int(functions._worth))
    assert not functions._compile
    functions.count(2)
    assert functions._compile


# ------------------------------------------------------------------------------------------------ contact changes
@pytest.mark.parametrize("argument", [lambda r: 2 * r - 0.8, lambda r: np.exp(r) - 1.4, lambda r: (r - 0.3) ** 3 + r])
def test_change_of_a_monotonic_argument(argument):
    fractions = (np.polynomial.chebyshev.chebpts2(NODES) + 1) / 2
    _, (place, _, direction) = first_change(argument(fractions)[None], [np.array([0.1])], [0])
    assert argument(place) == pytest.approx(0.1, abs=1e-9)
    assert direction == 1
    assert first_change(argument(fractions)[None], [np.array([0.1])], [1]) == (True, None)  # not downwards


def test_argument_just_past_its_breakpoint_changes_at_once():
    fractions = (np.polynomial.chebyshev.chebpts2(NODES) + 1) / 2
    assert first_change((1 + 1e-15 + fractions)[None], [np.array([1.0])], [0]) == (True, (0.0, 0, 1))


# ------------------------------------------------------------------------------------------------ failures
def single(acceleration, contact=None, omega=1.0) -> System:
    x, v, theta, frequency = rs.symbols("x", "v", "theta", "omega")
    laws = [contact(x, theta)] if contact else []
    return System(
        name="single",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta, *(c.force for c in laws))},
        contacts=laws,
        phase=theta,
        frequency="omega",
        parameters={"omega": (frequency, omega)},
    )


def test_resting_contact_is_refused():
    """Without load the mass stays at the edge of the gap, where the law has two slopes."""
    system = single(lambda x, v, theta, f: -0.1 * v - f, lambda x, theta: rs.dead_zone(x))
    integrator, p = ExactIntegrator(system), system.parameter_vector()
    run = integrator.integrate([1.0, 0.0], p)
    assert run.end.tolist() == [1.0, 0.0]
    assert run.changes == ()
    with pytest.raises(RestingContact, match=r"'mesh' .* rests on its breakpoint 1 .*omega = 1.*smoothed") as caught:
        tangents(integrator, [run], p)
    assert caught.value.parameters == {"omega": 1.0}
    beside = integrator.integrate([0.99, 0.0], p)  # inside the gap nothing is undecided
    assert np.all(np.isfinite(tangents(integrator, [beside], p).whole(0)))


def test_grazing_contact_has_no_second_derivative():
    stop = lambda x, theta: Contact(argument=x, breakpoints=(1.0 - 1e-10,), slopes=(0.0, 1.0))  # noqa: E731
    system = single(lambda x, v, theta, f: -x - f, stop, omega=0.5)
    integrator, p = ExactIntegrator(system), system.parameter_vector()
    run = integrator.integrate([np.cos(2.0), -np.sin(2.0)], p)
    found = tangents(integrator, [run], p)
    with pytest.raises(GrazingContact, match=r"grazes at phase .*omega = 0.5.*step over"):
        form_gradients(integrator, run, found, 0, p, np.ones(2), np.ones(2))


def test_failures_are_told_apart():
    runaway = single(lambda x, v, theta: x**2, omega=2.0)
    stiff = single(lambda x, v, theta: -1e9 * (x - ca.cos(theta)) - 1e6 * v)
    shaking = single(
        lambda x, v, theta, f: -v - f,
        lambda x, theta: Contact(argument=x + 1e-3 * ca.sin(500 * theta), breakpoints=(0.0,), slopes=(0.0, 1.0)),
    )
    cases = [(runaway, Runaway, "runs away"), (stiff, TooManySteps, "stiff=True"), (shaking, Chattering, "chatter")]
    for system, kind, text in cases:
        integrator = ExactIntegrator(system, steps=400)
        with pytest.raises(kind, match=rf"stopped at phase .*omega = .*{text}") as caught:
            integrator.integrate([10.0, 0.0] if kind is Runaway else [0.0, 0.0], system.parameter_vector())
        assert isinstance(caught.value, IntegrationFailed)
        assert isinstance(caught.value, ContinuationError)
        assert 0 <= caught.value.phase < 2 * np.pi
        assert list(caught.value.parameters) == ["omega"]
