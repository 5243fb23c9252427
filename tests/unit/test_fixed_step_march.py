"""Fixed steps: the order survives contact changes, compiled and virtual marches agree, nothing is missed."""

from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from reference_systems import backlash, duffing, gear, linear_oscillator, stops, symbols

from continuation import Contact, ContinuationError, System
from continuation.errors import Runaway
from continuation.model import machine_code
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.fixed_step_functions import TABLEAUS
from continuation.timedomain.fixed_step_virtual import VirtualMarch

needs_compiler = pytest.mark.skipif(machine_code.find_compiler() is None, reason="no C compiler here")
HIGH = np.array([0.8338430125, 0.1640787518])  # REFERENCE: backlash oscillator at omega 0.75, separated 0.54175


def always_closed():
    """The backlash oscillator with its flanks glued together, shaken until it moves as much as the high orbit does."""
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    shake = 0.22472379 * np.sqrt(2) * abs(1 - 0.75**2 + 0.1j * 0.75)
    return System(
        name="glued",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.1 + shake * ca.cos(theta) - 0.1 * v - (x - 1)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.75)},
    )


def drift():
    """Two quantities that rise for ever, one by a linear and one by a nonlinear equation."""
    x, y, theta, omega = symbols("x", "y", "theta", "omega")
    rates = {"x": 0.02 * x + 0.01 * ca.cos(theta), "y": 0.05 + 0.001 * y**2}
    return System(name="drift", states={"x": x, "y": y}, derivatives=rates, phase=theta, frequency="omega",
                  parameters={"omega": (omega, 1.0)})  # fmt: skip


def exact_end(system, x, p, periods):
    return ExactIntegrator(system, rtol=1e-12, atol=1e-13).integrate(x, p, periods).end


def error(system, x, p, periods, settings):
    return abs(settings.compile(system).run(x, p, periods).end - exact_end(system, x, p, periods)).max()


@pytest.mark.parametrize(("order", "steps"), [(2, 128), (4, 64), (5, 64), (8, 8)])
@pytest.mark.parametrize("build", [duffing, backlash])
def test_order_survives_corners(build, order, steps):
    system = build()
    p = system.parameter_vector({"omega": 0.75})
    errors = [error(system, HIGH + 0.01, p, 3, FixedStep(steps * k, order)) for k in (1, 2, 4)]
    rates = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert rates.max() > order - 0.4
    assert errors[0] / errors[2] > 4 ** (order - 0.7)


@pytest.mark.parametrize("steps", [256, 512, 1024])
def test_corners_cost_no_accuracy(steps):
    """100 periods on an attracting orbit with contact loss, against the same step on a smooth problem as stiff."""
    smooth, kinked = always_closed(), backlash()
    p = kinked.parameter_vector({"omega": 0.75})
    plain = error(smooth, HIGH, p, 100, FixedStep(steps))
    landed, over = (error(kinked, HIGH, p, 100, FixedStep(steps, land=land)) for land in (True, False))
    assert landed < 3 * plain
    assert over > 10 * plain


@needs_compiler
@pytest.mark.parametrize(
    ("system", "values", "start", "settings", "quantities"),
    [
        (backlash(), {"omega": 0.75}, HIGH, FixedStep(256), ("x", "contact force")),
        (backlash(), {"omega": 0.75}, HIGH, FixedStep(100, 8), ("v",)),
        (
            stops(damping=0.1, gain=0.3, force=0.8, width=0.5, stops=2),
            {},
            np.full(4, 0.3),
            FixedStep(90, 5),
            ("x", "w"),
        ),
        (duffing(), {}, np.ones(2), FixedStep(37, 2), ("x",)),
        (drift(), {}, np.array([1.0, 2.0]), FixedStep(64), ("x", "y")),  # no extremum in any period
    ],
)
def test_without_a_compiler_the_same_numbers(monkeypatch, system, values, start, settings, quantities):
    p = system.parameter_vector(values)
    compiled = settings.compile(system, quantities)
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    virtual = settings.compile(system, quantities)
    assert "compiled with" in compiled.note
    assert virtual.note == "without machine code: no C compiler was found"
    assert isinstance(virtual._engine, VirtualMarch)
    a, b = (f.run(start, p, 5, statistics=True, phases=[0.0, 0.1, 2.0, 6.2], changes=True) for f in (compiled, virtual))
    for name in ("strobe", "mean", "variance", "minimum", "maximum", "samples", "changes", "change_states"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-13, err_msg=name)
    assert all(np.allclose(u, v, rtol=0, atol=1e-13) for u, v in zip(a.shares, b.shares, strict=True))


@pytest.mark.parametrize(("steps", "order"), [(256, 4), (37, 8), (16, 4), (100, 5), (65, 2)])
def test_products_of_step_matrices_are_the_steps(monkeypatch, steps, order):
    """A model that is linear in its contact modes goes by tabulated products; the virtual machine gives the same."""
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    system = stops(damping=0.1, gain=0.3, force=0.8, width=0.5, stops=2)
    settings, start, p = FixedStep(steps, order), np.full(4, 0.3), system.parameter_vector()
    products, plain = (settings.compile(system, ("x", "w")) for _ in range(2))
    assert products._engine._products.fits(steps)
    monkeypatch.setattr(plain._engine._products, "linear", False)
    for q in (p, 1.1 * p, p):  # tables belong to parameters
        a, b = (f.run(start, q, 4, statistics=True, phases=[0.0, 1.0], changes=True) for f in (products, plain))
        for name in ("strobe", "mean", "variance", "minimum", "maximum", "samples", "changes", "change_states"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-12, err_msg=name)
        assert len(a.changes) > 2


def test_products_are_for_linear_modes_and_tables_of_reasonable_size(monkeypatch):
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    for system, steps, fits in ((duffing(), 256, False), (backlash(), 256, True), (gear(), 256, True),
                                (gear(), 16384, False)):  # fmt: skip
        assert FixedStep().compile(system)._engine._products.fits(steps) is fits


@pytest.mark.parametrize("compiler", [True, False])
def test_samples_at_points_of_the_grid_are_those_points(monkeypatch, compiler):
    """Phases that differ from the grid by rounding alone cost no step of their own, and none is left out."""
    if not compiler:
        monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    system = backlash()
    p = system.parameter_vector({"omega": 0.7531})
    grid = 2 * np.pi * np.arange(64) / 64
    shifted = np.nextafter(grid, np.where(np.arange(64) % 2, 0.0, 9.0))
    runs = [FixedStep(256).compile(system).run(HIGH, p, 2, phases=phases) for phases in (grid, shifted, grid + 1e-7)]
    assert np.array_equal(runs[0].samples, runs[1].samples)
    assert np.array_equal(runs[0].samples[:, 0], runs[0].strobe[:-1])
    later = runs[2].samples - runs[0].samples
    assert 1e-9 < abs(later).max() < 1e-6


def test_statistics_of_a_contact_loss_orbit():
    system = backlash()
    run = (
        FixedStep(256)
        .compile(system, ["x", "contact force"])
        .run(HIGH, system.parameter_vector({"omega": 0.75}), 3, statistics=True, changes=True)
    )
    assert np.sqrt(run.variance[:, 0]) == pytest.approx(0.22472379, abs=2e-8)
    assert run.shares[0][1] == pytest.approx(0.54175, abs=3e-6)
    assert run.mean[:, 1] == pytest.approx(0.1, abs=1e-7)  # the mean force carries the load
    assert run.maximum[:, 1] == pytest.approx(run.maximum[:, 0] - 1, abs=1e-12)
    assert run.minimum[:, 1] == pytest.approx(0.0, abs=1e-15)
    assert len(run.changes) == 6
    assert abs(run.change_states[:, 0] - 1).max() < 1e-12


def test_statistics_of_a_sinusoid_far_from_zero():
    """x = 1e6 + A cos: the variance keeps its digits, extremes lie between steps."""
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    system = System(
        name="far",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -(omega**2) * (x - 1e6)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.3)},
    )
    run = FixedStep(200).compile(system, ["x"]).run([1e6 + 0.3, 0.4 * 1.3], np.array([1.3]), 2, statistics=True)
    assert run.variance == pytest.approx(0.125, rel=1e-6)
    assert run.maximum == pytest.approx(1e6 + 0.5, abs=3e-8)
    assert run.minimum == pytest.approx(1e6 - 0.5, abs=3e-8)


def test_samples_and_changes_are_those_of_event_exact_integration():
    system = backlash()
    p = system.parameter_vector({"omega": 0.75})
    phases = np.array([0.0, 0.7, 3.0, 6.28])
    run = FixedStep(512, 8).compile(system).run(HIGH + 0.05, p, 4, phases=phases, changes=True)
    exact = ExactIntegrator(system, rtol=1e-12, atol=1e-13)
    path = exact.integrate(HIGH + 0.05, p, 4)
    wanted = exact.sample(path, p, (phases + 2 * np.pi * np.arange(4)[:, None]).ravel())
    assert abs(run.samples.reshape(-1, 2) - wanted).max() < 1e-9
    np.testing.assert_allclose(run.changes, np.array(path.changes), rtol=0, atol=1e-9)


@pytest.mark.parametrize("depth", [1e-2, 1e-4, 1e-5, -1e-5])
def test_contact_shorter_than_a_step_is_seen(depth):
    """x = cos t touches a stop at 1 - depth for 0.0045 to 0.14 of phase; a step is 0.1."""
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(1.0 - depth,), slopes=(0.0, 1.0))
    system = System(
        name="stop",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -x - stop.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5)},
        contacts=[stop],
    )
    run = FixedStep(64, 8).compile(system).run([np.cos(2.02), -np.sin(2.02)], np.array([0.5]), changes=True)
    if depth < 0:
        assert len(run.changes) == 0
    else:
        assert np.diff(run.changes[:2, 0]) == pytest.approx(np.sqrt(2 * depth), rel=0.05)


def test_start_on_a_moving_corner_and_several_contacts():
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    moving = Contact(argument=x - 0.3 * ca.sin(theta), breakpoints=(0.5, 0.8), slopes=(0.0, 4.0, 1.0))
    fixed = Contact(argument=x, breakpoints=(-0.2,), slopes=(2.0, 0.0), name="floor")
    system = System(
        name="moving",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.1 + 0.9 * ca.cos(2 * theta) - 0.2 * v - moving.force - fixed.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.6)},
        contacts=[moving, fixed],
    )
    p = system.parameter_vector()
    run = FixedStep(128, 8).compile(system).run([0.5, 1.0], p, 4, changes=True)
    assert abs(run.end - exact_end(system, [0.5, 1.0], p, 4)).max() < 1e-9
    assert {int(i) for i in run.changes[:, 1]} == {0, 1}


def test_autonomous_systems_march_in_time():
    x, v = symbols("x", "v")
    spring = System(name="spring", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, parameters={})
    run = FixedStep(64, 8).compile(spring, ["x"]).run([1.0, 0.0], np.empty(0), 3, phases=[0.0, 0.25], statistics=True)
    assert run.period == 1.0
    assert run.strobe[:, 0] == pytest.approx(np.cos(np.arange(4)), abs=1e-13)
    assert run.samples[:, 1, 0] == pytest.approx(np.cos(np.arange(3) + 0.25), abs=1e-13)
    assert run.mean[:, 0] == pytest.approx(np.diff(np.sin(np.arange(4))), abs=1e-9)


def test_a_march_is_a_function_of_the_state_and_threads_do_not_meet():
    system = gear()
    integrator = FixedStep(128).compile(system)
    start = np.array([1.3, *[0.0] * 13])
    ps = [system.parameter_vector({"frequency_ratio": r}) for r in (0.6, 0.62, 1.4, 0.6)]
    alone = [integrator.run(start, p, 40).end for p in ps]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda p: integrator.run(start, p, 40).end, ps))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))
    x = start
    for _ in range(40):
        x = integrator.run(x, ps[0], 1).end
    assert abs(x - alone[0]).max() < 1e-11


@pytest.mark.parametrize("compiler", [True, False])
def test_a_state_that_runs_away_is_named_with_its_time(monkeypatch, compiler):
    if not compiler:
        monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    x, theta, omega = symbols("x", "theta", "omega")
    system = System(
        name="tangent",
        states={"x": x},
        derivatives={"x": 1 + x**2},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 4.0)},
    )
    integrator = FixedStep(64).compile(system)  # x = tan t, infinite at pi/2, which ends the first period
    with pytest.raises(Runaway, match=r"failed at time 1\.\d+ \(omega = 4\).*State at time 1\.5708.*x = ") as caught:
        integrator.run([0.0], system.parameter_vector(), 3)
    assert np.pi / 2 <= caught.value.phase / 4 < np.pi / 2 + 0.2
    with pytest.raises(Runaway, match="time 0 "):
        integrator.run([np.nan], system.parameter_vector(), 1)


def test_misuse_is_refused():
    with pytest.raises(ValueError, match=r"order must be one of \[2, 4, 5, 8\], got 3"):
        FixedStep(order=3)
    with pytest.raises(ValueError, match="8 or more"):
        FixedStep(4)
    with pytest.raises(ValueError, match="no state or output 'contact'"):
        FixedStep().compile(backlash(), ["contact"])
    integrator = FixedStep().compile(linear_oscillator())
    p = linear_oscillator().parameter_vector()
    with pytest.raises(ValueError, match="expected 2 values of state"):
        integrator.run([1.0], p)
    with pytest.raises(ValueError, match="0 or more periods"):
        integrator.run([1.0, 0.0], p, -1)
    with pytest.raises(ValueError, match="increasing numbers"):
        integrator.run([1.0, 0.0], p, phases=[1.0, 0.5])
    with pytest.raises(ContinuationError, match="must be positive"):
        integrator.run([1.0, 0.0], p * [-1, 1])


@pytest.mark.parametrize("order", sorted(TABLEAUS))
def test_tableaus_satisfy_the_first_order_conditions(order):
    A, b, c = TABLEAUS[order]
    assert sum(b) == pytest.approx(1, abs=1e-14)
    assert [sum(row) for row in A] == pytest.approx(list(c), abs=1e-14)
    assert np.dot(b, c) == pytest.approx(0.5, abs=1e-14)
