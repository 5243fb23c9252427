"""Sweeps with every integrator against published orbits; resuming, executors, failures, starts of their own."""

import dataclasses
import json
import tracemalloc
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import casadi as ca
import numpy as np
import pytest
import xarray as xr
from reference_systems import backlash, duffing, gear, symbols

from continuation import CVODES, EventExact, FixedStep, Sweep, System, sweep, up_and_down, waterfall
from continuation.model import machine_code
from continuation.plotting_timedomain import plot_waterfall
from continuation.timedomain.fixed_step import SuitableSteps
from continuation.timedomain.plain_system import PlainSystem
from continuation.timedomain.sweep import SweepTask

INTEGRATORS = (None, FixedStep(512), EventExact(), CVODES(rtol=1e-10, atol=1e-12))
HIGH = [0.8338430125, 0.1640787518]


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_published_orbits_of_the_backlash_oscillator(integrator):
    """Orbit at 0.6, high and low ones at 0.75 and the one at 1: states at phase 0, rms, dynamic factor."""
    low = (1.1624504362, 0.0080293418)
    values, states = [0.6, 0.75, 1.0, 0.75], [(1.1278799613, 0.0015682478), HIGH, (0.9059653748, 0.0557744441), low]
    found = sweep(backlash(), "omega", values, quantity="x", load="contact force", start=states, integrator=integrator)
    assert found.period.tolist() == [1, 1, 1, 1]
    sampled = integrator is not None and not isinstance(integrator, FixedStep)
    assert abs(found.states - states).max() < 3e-8
    assert abs(found.rms[:3] - [0.01980055, 0.22472379, 0.13308283]).max() < (1e-6 if sampled else 3e-8)
    assert found.dynamic_factor[2] == pytest.approx(2.69255, abs=2e-3 if sampled else 1e-5)
    assert np.array_equal(found.points[:, 0], found.states) or abs(found.points[:, 0] - found.states).max() < 1e-8


def test_harmonics_and_poincare_points():
    linear = oscillator(lambda x, v, t, omega: 0.4 + ca.cos(t) - x - 0.2 * v, omega=1.0)
    found = sweep(linear, "omega", [0.5, 2.0], quantity="x")
    exact = 1 / (1 - found.values**2 + 0.2j * found.values)
    assert abs(found.harmonics[:, 0] - 0.4).max() < 1e-8
    assert abs(found.harmonics[:, 1] - exact).max() < 1e-7
    assert abs(found.harmonics[:, 2:]).max() < 1e-8
    assert found.points.shape == (2, 1, 2)
    assert np.all(found.step_error < 1e-7)
    assert found.verdicts == ("period-1", "period-1")


def oscillator(acceleration, **parameters):
    x, v, theta = symbols("x", "v", "theta")
    p = {k: ca.SX.sym(k) for k in parameters}
    return System(
        name="oscillator", states={"x": x, "v": v}, derivatives={"x": v, "v": acceleration(x, v, theta, **p)},
        phase=theta, frequency="omega", parameters={k: (p[k], value) for k, value in parameters.items()},
    )  # fmt: skip


def test_a_long_cycle_is_recognised():
    """A period-3 window of the double well, and its period number read off the Poincare points."""
    wells = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) - 0.3 * v + x - x**3, omega=1.2, g=0.2)
    found = sweep(wells, "g", [0.2915, 0.2919], quantity="x", limit=1000)
    assert found.period.tolist() == [8, 8]
    points = found.points[0]
    assert np.isfinite(points).all(axis=1).sum() == 8
    assert min(abs(points[i] - points[j]).max() for i in range(8) for j in range(i)) > 1e-4


def test_fixed_numbers_of_periods():
    found = sweep(duffing(), "omega", [0.5, 0.8], quantity="x", transient=300, limit=400, recorded=100)
    assert found.period.tolist() == [1, 1]
    assert np.all(found.periods_used >= 300)
    assert np.all(found.periods_used < 330)


def test_values_with_starts_of_their_own_run_in_parts():
    values = np.linspace(1.13, 1.26, 20)
    starts = np.tile([[2.8, 0.0], [0.0, 0.0]], (10, 1))
    alone = sweep(duffing(), "omega", values, quantity="x", start=starts)
    with ThreadPoolExecutor(2) as pool:
        shared = sweep(duffing(), "omega", values, quantity="x", start=starts, executor=pool)
    assert alone.to_dict() == shared.to_dict()
    assert len(set(np.round(alone.rms, 1))) > 2
    down = sweep(duffing(), "omega", values, quantity="x", start=starts, direction="down")
    assert np.array_equal(down.rms[::-1], alone.rms)


def test_threads_processes_and_any_executor_give_the_same():
    settings = {"quantity": "x", "limit": 100, "recorded": 16}
    alone = up_and_down(duffing(), "omega", [0.8, 1.2], workers=1, **settings)
    threads = up_and_down(duffing(), "omega", [0.8, 1.2], **settings)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        seen = []
        others = up_and_down(
            duffing(), "omega", [0.8, 1.2], executor=pool, progress=lambda *a: seen.append(a), **settings
        )
    assert [s.to_dict() for s in alone] == [s.to_dict() for s in threads] == [s.to_dict() for s in others]
    assert seen == [(2, 4), (4, 4)]


class Interrupted(Exception):
    pass


class Inline(Executor):
    """The least that an executor can be; interrupted after so many good tasks."""

    def __init__(self, good=1000):
        self.good = good

    def submit(self, fn, /, *args, **kwargs):
        future, self.good = Future(), self.good - 1
        if self.good < 0:
            future.set_exception(Interrupted())
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_an_interrupted_sweep_goes_on_where_it_was(tmp_path):
    values, file = [0.7, 0.9, 1.1, 1.2], tmp_path / "part.nc"
    settings = {"quantity": "x", "load": "", "limit": 200}

    def stop(done, total):
        if done == 2:
            raise Interrupted

    with pytest.raises(Interrupted):
        sweep(duffing(), "omega", values, resume=file, progress=stop, **settings)
    assert Sweep.load(file).values.tolist() == [0.7, 0.9]
    seen = []
    found = sweep(duffing(), "omega", values, resume=file, progress=lambda d, t: seen.append(d), **settings)
    assert seen == [3, 4]
    assert found.to_dict() == sweep(duffing(), "omega", values, **settings).to_dict()
    again = sweep(duffing(), "omega", values, resume=file, progress=lambda d, t: seen.append(d), **settings)
    assert again.to_dict() == found.to_dict()
    assert seen == [3, 4]
    with pytest.raises(ValueError, match="another computation"):
        sweep(duffing(), "omega", [0.7, 0.95], resume=file, **settings)
    with pytest.raises(ValueError, match="no folder"):
        sweep(duffing(), "omega", values, resume=tmp_path / "none" / "part.nc", **settings)


def test_parts_of_an_executor_are_kept_as_well(tmp_path):
    values, file = np.linspace(1.13, 1.26, 40), tmp_path / "parts.nc"
    settings = {"quantity": "x", "start": np.tile([[2.8, 0.0], [0.0, 0.0]], (20, 1)), "limit": 60, "recorded": 8}

    with pytest.raises(Interrupted):
        sweep(duffing(), "omega", values, executor=Inline(good=2), resume=file, **settings)
    assert len(Sweep.load(file).values) == 32
    seen = []
    more = {"resume": file, "progress": lambda *a: seen.append(a), **settings}
    with ThreadPoolExecutor(2) as pool:
        found = sweep(duffing(), "omega", values, executor=pool, **more)
        again = sweep(duffing(), "omega", values, executor=pool, **more)
    assert seen == [(40, 40)]
    assert found.to_dict() == again.to_dict() == sweep(duffing(), "omega", values, **settings).to_dict()


def test_interrupted_threads_keep_both_directions(tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        up_and_down(duffing(), "omega", np.linspace(0.5, 0.9, 40), quantity="x", resume=tmp_path / "p", progress=stop)
    kept = [len(Sweep.load(tmp_path / "p" / f"{name}.nc").values) for name in ("up", "down")]
    assert min(kept) > 0
    assert max(kept) < 40


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_overflow_and_nan_are_named_and_the_rest_goes_on(integrator):
    """The state leaves a one-sided well, or comes to x < -2, where the square root has no value."""
    well = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) - 0.2 * v - x - x**2, omega=0.8, g=0.0)
    root = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) - 0.2 * v - x - 1e-3 * ca.sqrt(x + 2), omega=0.8, g=0.0)
    for system, bad in ((well, 0.5), (root, 5.0)):
        found = sweep(system, "g", [0.02, bad, 0.03], quantity="x", integrator=integrator, limit=100, recorded=16)
        assert found.period.tolist() == [1, -1, 1]
        assert found.verdicts[1] == "failed"
        assert f"g = {bad:g}" in found.failures[1]
        assert "x = " in found.failures[1]
        assert "time" in found.failures[1]
        assert "periods later" in found.failures[1]
        assert np.isnan(found.rms[1])
        assert np.isfinite(found.rms[[0, 2]]).all()


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_slow_growth_to_the_end_of_the_numbers(integrator):
    """Negative damping: exp(0.3 t) passes 1e308 after 377 periods; the time is that since the value began."""
    system = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) + 0.6 * v - x, omega=1.0, g=0.1)
    fast = CVODES(rtol=1e-6, atol=1e-6) if isinstance(integrator, CVODES) else integrator
    found = sweep(system, "g", [0.1], quantity="x", limit=400, recorded=8, integrator=fast)
    assert found.verdicts == ("failed",)
    assert "+30" in found.failures[0]  # the state
    begin = float(found.failures[0].rpartition("at time ")[2])
    assert 2 * np.pi * 350 < begin < 2 * np.pi * 380


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_a_quantity_that_is_no_number_is_named(integrator):
    """The response is fine, but the square root of x has no value on half of it."""
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    system = System(name="root", states={"x": x, "v": v}, derivatives={"x": v, "v": g * ca.cos(theta) - 0.5 * v - x},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.2), "g": (g, 0.1)},
                    outputs={"root": ca.sqrt(x + 0.2)})  # fmt: skip
    for names in ({"quantity": "root"}, {"quantity": "x", "load": "root"}):
        found = sweep(system, "g", [0.05, 0.3, 0.06], limit=60, recorded=8, integrator=integrator, **names)
        assert found.verdicts == ("period-1", "failed", "period-1")
        assert "'root' of 'root' is no finite number" in found.failures[1]
        assert "x = " in found.failures[1]


@pytest.mark.parametrize("integrator", [CVODES(rtol=1e-5, atol=1e-5), None], ids=str)
def test_threads_do_not_disturb_each_other(integrator):
    values = np.linspace(0.5, 1.5, 18)
    settings = {"quantity": "x", "start": np.tile([1.0, 0.2], (18, 1)), "limit": 33, "recorded": 4}
    alone = sweep(backlash(), "omega", values, integrator=integrator, **settings)
    with ThreadPoolExecutor(4) as pool:
        shared = sweep(backlash(), "omega", values, integrator=integrator, executor=pool, **settings)
    assert alone.to_dict() == shared.to_dict()


def test_memory_does_not_grow_with_the_periods():
    """The samples of 3000 more periods of 2 states would take 3 MB."""
    held = []
    for more in ({}, {"transient": 3400}, {"recorded": 3400}):
        settings = {"transient": 400, "recorded": 400} | more
        tracemalloc.start()
        sweep(backlash(), "omega", [0.75], quantity="x", start=HIGH, limit=sum(settings.values()), **settings)
        held.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert max(held) < held[0] + 1e6


def test_any_executor_will_do():
    settings = {"quantity": "x", "limit": 60, "recorded": 8}
    alone = up_and_down(duffing(), "omega", [0.8, 1.2], workers=1, **settings)
    inline = up_and_down(duffing(), "omega", [0.8, 1.2], executor=Inline(), **settings)
    assert [s.to_dict() for s in inline] == [s.to_dict() for s in alone]


def test_without_a_compiler_the_numbers_are_the_same(monkeypatch):
    fast = sweep(backlash(), "omega", [0.75], quantity="x", start=HIGH, limit=80, recorded=16)
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    slow = sweep(backlash(), "omega", [0.75], quantity="x", start=HIGH, limit=80, recorded=16)
    assert slow.rms[0] == pytest.approx(fast.rms[0], abs=1e-11)


def test_a_system_survives_the_way_through_text():
    for system in (gear(), backlash(), duffing()):
        plain = PlainSystem.of(system)
        other = plain.system()
        x = 1.5 + 0.1 * np.arange(len(system.state_names))
        assert np.array_equal(other.rhs(x, 0.3), system.rhs(x, 0.3))
        assert PlainSystem.of(system) == plain
        assert (other.output_names, other.parameter_names) == (system.output_names, system.parameter_names)


def test_more_steps_for_a_faster_motion():
    slow, fast = (oscillator(lambda x, v, t, omega, w=w: -(w**2) * x - 0.1 * v, omega=1.0) for w in (1.0, 30.0))
    assert SuitableSteps(slow)(np.array([1.0])) == 256
    assert SuitableSteps(fast)(np.array([1.0])) == 2048
    stiff = oscillator(lambda x, v, t, omega: -1e8 * x - 0.1 * v, omega=1.0)
    found = sweep(stiff, "omega", [1.0], quantity="x")
    assert "CVODES(stiff=True)" in found.failures[0]


def test_every_setting_changes_the_fingerprint():
    from continuation.timedomain.sweep import task

    base = task(duffing(), "omega", [1.0], "x", "", None, None, 32, 400, 64, 1e-7)
    other = {"values": (1.1,), "limit": 300, "integrator": FixedStep(512), "quantity": "v", "starts": ((1.0, 0.0),)}
    prints = {dataclasses.replace(base, **{k: v}).fingerprint for k, v in other.items()}
    assert len(prints | {base.fingerprint}) == 1 + len(other)
    assert dataclasses.replace(base, resume="file").fingerprint == base.fingerprint
    assert isinstance(base, SweepTask)


def test_a_waterfall_follows_the_orders():
    """A period-2 response has lines at odd multiples of one half, a period-1 response has none."""
    wells = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) - 0.3 * v + x - x**3, omega=1.2, g=0.2)
    found = sweep(wells, "g", [0.25, 0.28], quantity="x")
    tracked = waterfall(wells, found, periods=16, highest=4.0)
    half = tracked.amplitudes[:, tracked.orders == 0.5].ravel()
    assert half[0] < 1e-7
    assert half[1] > 0.01
    assert tracked.amplitudes[:, tracked.orders == 1.0].ravel() == pytest.approx(abs(found.harmonics[:, 1]), rel=1e-6)
    assert tracked.failures == ("", "")


def test_a_waterfall_says_what_is_missing(tmp_path):
    """Weak forcing stays inside a one-sided well, strong forcing escapes."""
    well = oscillator(lambda x, v, t, omega, g: g * ca.cos(t) - 0.2 * v - x - x**2, omega=0.8, g=0.0)
    found = sweep(well, "g", [0.5, 0.02], quantity="x")
    tracked = waterfall(well, found, periods=4)
    assert tracked.failures == ("no state to start from", "")
    assert np.isnan(tracked.amplitudes[0]).all()
    assert np.isfinite(tracked.amplitudes[1]).all()
    lost = dataclasses.replace(found, states=np.array([[-3.0, 0.0], found.states[1]]))
    assert "failed at time" in waterfall(well, lost, periods=4).failures[0]
    tracked.save(tmp_path / "waterfall.nc")
    with xr.open_dataset(tmp_path / "waterfall.nc", engine="h5netcdf") as stored:
        assert np.array_equal(stored.amplitudes, tracked.amplitudes, equal_nan=True)
        assert stored.attrs["quantity"] == "x"
    none = dataclasses.replace(tracked, amplitudes=np.full_like(tracked.amplitudes, np.nan))
    with pytest.raises(ValueError, match="at least one spectrum"):
        plot_waterfall(none)


def test_misuse_is_refused():
    for arguments, message in (
        ({"method": CVODES(), "integrator": CVODES()}, "two names of one argument"),
        ({"integrator": FixedStep(), "march": "x.so"}, "march goes with"),
        ({"load": "force"}, "unknown name 'force'"),
        ({"direction": "sideways"}, "direction must be"),
        ({"start": np.zeros((3, 2))}, "1 or 2 states"),
    ):
        with pytest.raises(ValueError, match=message):
            sweep(duffing(), "omega", [1.0, 1.1], **({"quantity": "x"} | arguments))
    json.dumps(sweep(duffing(), "omega", [1.0], quantity="x").to_dict(), allow_nan=False)
