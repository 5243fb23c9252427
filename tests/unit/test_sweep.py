"""Brute-force sweeps: regimes, statistics, failures, files, and two processes against one."""

import json
import logging
from concurrent.futures.process import BrokenProcessPool

import casadi as ca
import numpy as np
import pytest

from continuation import Contact, System
from continuation.errors import UnsupportedModel
from continuation.orbits.shooting import Shooting
from continuation.timedomain import parallel
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.parallel import up_and_down
from continuation.timedomain.sweep import sweep
from continuation.timedomain.sweep_result import Sweep

QUICK = CVODES(rtol=1e-8, atol=1e-9)


def single_mass(acceleration, **parameters):
    x, v, theta = (ca.SX.sym(k) for k in ("x", "v", "theta"))
    symbols = {k: ca.SX.sym(k) for k in parameters}
    return System(
        name="single mass",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": acceleration(x, v, theta, **symbols)},
        phase=theta,
        frequency="omega",
        parameters={k: (symbols[k], value) for k, value in parameters.items()},
    )


def duffing():
    return single_mass(lambda x, v, theta, omega, g: g * ca.cos(theta) - 0.05 * v - x - 0.1 * x**3, omega=1.0, g=0.18)


def double_well():
    return single_mass(lambda x, v, theta, omega, g: g * ca.cos(theta) - 0.3 * v + x - x**3, omega=1.2, g=0.2)


def gear():
    """Return the 14-state gear pair of the dimensionless example: mesh coordinate and six bearing coordinates."""
    s, mu = [-0.62, 0.15, 0.77, 0.62, -0.15, -0.77], [0.3] * 3 + [0.06] * 3
    lam, rate, theta, omega = (ca.SX.sym(k) for k in ("lam", "rate", "theta", "omega"))
    q, dq = ca.SX.sym("q", 6), ca.SX.sym("dq", 6)
    q, dq = ca.vertsplit(q), ca.vertsplit(dq)
    mesh = Contact(argument=lam, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))
    force = (1 + 0.3 * ca.cos(theta) + 0.1 * ca.cos(2 * theta)) * mesh.force + 2 * 0.02 * rate
    ddq = [-2 * 0.02 * dq[i] - (2 if i < 3 else 1) * q[i] - s[i] * mu[i] * force for i in range(6)]
    derivatives = {"lam": rate, "rate": sum(a * b for a, b in zip(s, ddq, strict=True)) + 0.77 * 0.14 - 0.77**2 * force}
    states = {"lam": lam, "rate": rate}
    for i in range(6):
        states |= {f"q{i}": q[i], f"dq{i}": dq[i]}
        derivatives |= {f"q{i}": dq[i], f"dq{i}": ddq[i]}
    return System(
        name="gear", states=states, derivatives=derivatives, contacts=[mesh], phase=theta, frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )  # fmt: skip


def test_duffing_jumps_differ_up_and_down():
    """Folds at 1.11570 and 1.26960: between them each direction keeps its own branch."""
    values = np.arange(1.05, 1.35, 0.03)
    up, down = up_and_down(duffing(), "omega", values, quantity="x", workers=1)
    between = (values > 1.1158) & (values < 1.2695)
    assert np.array_equal(up.values, down.values[::-1])
    assert (up.period == 1).all()
    assert (down.period == 1).all()
    same = abs(up.rms - down.rms[::-1]) < 1e-6
    assert np.array_equal(same, ~between)
    assert (up.rms >= down.rms[::-1] - 1e-6).all()


def test_statistics_of_a_linear_response():
    linear = single_mass(lambda x, v, theta, omega: 0.4 + ca.cos(theta) - x - 0.2 * v, omega=1.0)
    result = sweep(linear, "omega", [0.5, 1.0, 2.0], quantity="x")
    amplitude = 1 / abs(1 - result.values**2 + 0.2j * result.values)
    assert abs(result.rms - amplitude / np.sqrt(2)).max() < 1e-7
    assert abs(result.mean - 0.4).max() < 1e-7
    assert abs(result.maximum - 0.4 - amplitude).max() < 1e-5
    assert abs(result.minimum - 0.4 + amplitude).max() < 1e-5


def test_regimes_of_the_double_well():
    """Period-doublings at g = 0.26558, 0.28669, 0.29109; irregular at 0.33."""
    result = sweep(double_well(), "g", [0.25, 0.28, 0.2885, 0.2915, 0.33], quantity="x", limit=600)
    assert result.period.tolist() == [1, 2, 4, 8, 0]
    assert result.periods_used[-1] == 600
    assert "1 period-8, 1 period-4" in str(result)


def test_just_past_a_doubling_is_not_called_period_one():
    result = sweep(double_well(), "g", [0.2656, 0.26562, 0.266, 0.268], quantity="x", limit=600)
    assert 1 not in result.period
    assert result.period[-1] == 2


def test_gear_against_shooting():
    system = gear()
    result = sweep(system, "omega", [0.65384615, 0.8308, 1.2436], quantity="lam", start=[1.2] + [0.0] * 13)
    assert result.period.tolist() == [1, 1, 1]
    problem = Shooting().discretise(system, "omega")
    for omega, state, rms in zip(result.values, result.states, result.rms, strict=True):
        jacobian = problem.linearise(state, omega)[1]
        u = state - np.linalg.solve(jacobian, problem.residual(state, omega))
        u = u - np.linalg.solve(jacobian, problem.residual(u, omega))
        assert abs(problem.residual(u, omega)).max() < 1e-8
        assert rms == pytest.approx(problem.waveform(u, omega, 1024)[:, 0].std(), abs=3e-7)


def test_gear_doublings_by_shooting():
    """From the response of the sweep along the branch to two period-doublings that harmonic balance gives."""
    problem = Shooting(rtol=1e-12, atol=1e-14).discretise(gear(), "omega")
    u = sweep(gear(), "omega", [1.43], quantity="lam", start=[1.2] + [0.0] * 13).states[0]
    for frequencies in (np.linspace(1.43, 1.4160415167, 15), np.linspace(1.4160415167, 1.2774983866, 60)[1:]):
        for omega in frequencies:
            for _ in range(3):
                residual, jacobian, _ = problem.linearise(u, omega)
                u = u - np.linalg.solve(jacobian, residual)
        assert abs(np.linalg.eigvals(problem.monodromy(u, omega)) + 1).min() < 1e-8


def test_value_that_fails_is_reported_and_the_sweep_goes_on():
    """Escape from a one-sided well: only the weak forcings stay inside."""
    well = single_mass(lambda x, v, theta, omega, g: g * ca.cos(theta) - 0.2 * v - x - x**2, omega=0.8, g=0.0)
    result = sweep(well, "g", [0.02, 0.5, 0.03], quantity="x", method=QUICK)
    assert result.period.tolist() == [1, -1, 1]
    assert result.failures[0] == result.failures[2] == ""
    assert "g = 0.5" in result.failures[1]
    assert np.isnan(result.rms[1])
    again = sweep(well, "g", [0.03], quantity="x", method=QUICK)
    assert np.array_equal(again.states[0], result.states[2])
    assert "1 failed" in str(result)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False))["rms"][1] is None


def test_saved_sweep_is_the_same(tmp_path):
    result = sweep(duffing(), "omega", [0.8, 0.9], quantity="x", method=QUICK)
    result.save(tmp_path / "sweep.nc")
    loaded = Sweep.load(tmp_path / "sweep.nc")
    assert loaded.to_dict() == result.to_dict()
    assert str(loaded) == str(result)
    assert loaded.state_names == ("x", "v")
    with pytest.raises(ValueError, match="read-only"):
        loaded.rms[0] = 0.0


def test_two_processes_give_what_one_gives():
    seen = []
    settings = {"quantity": "x", "method": QUICK, "transient": 32}
    both = up_and_down(duffing(), "omega", [0.8, 1.2, 1.0], progress=lambda *a: seen.append(a), **settings)
    alone = up_and_down(duffing(), "omega", [0.8, 1.2, 1.0], workers=1, **settings)
    assert [s.to_dict() for s in both] == [s.to_dict() for s in alone]
    assert both[0].values.tolist() == [0.8, 1.0, 1.2]
    assert seen[-1] == (6, 6)


def test_reason_is_logged_when_processes_cannot_start(monkeypatch, caplog):
    def refuse(*_):
        raise BrokenProcessPool("no more processes")

    seen = []
    monkeypatch.setattr(parallel, "ProcessPoolExecutor", refuse)
    with caplog.at_level(logging.WARNING):
        up, down = up_and_down(
            duffing(), "omega", [0.8, 0.9], quantity="x", method=QUICK, progress=lambda *a: seen.append(a)
        )
    assert "no more processes" in caplog.text
    assert abs(up.rms - down.rms[::-1]).max() < 1e-6
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"parameter": "omgea"}, "did you mean 'omega'"),
        ({"quantity": "y"}, "unknown name 'y'"),
        ({"values": []}, "at least one value"),
        ({"values": [1.0, np.nan]}, "all finite"),
        ({"values": [1.0, -1.0]}, "must be positive"),
        ({"start": [0.0]}, "start needs 2 states"),
        ({"limit": 0}, "limit must be positive"),
    ],
)
def test_misuse_is_refused(arguments, message):
    given = {"parameter": "omega", "values": [1.0], "quantity": "x"} | arguments
    with pytest.raises(ValueError, match=message):
        sweep(duffing(), given.pop("parameter"), given.pop("values"), **given)


def test_autonomous_system_is_refused():
    x = ca.SX.sym("x")
    system = System(name="decay", states={"x": x}, derivatives={"x": -x}, parameters={"a": (ca.SX.sym("a"), 1.0)})
    with pytest.raises(UnsupportedModel, match="no excitation period"):
        sweep(system, "a", [1.0], quantity="x")
