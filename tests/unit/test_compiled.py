"""Compiled transients: the same flow as CVODES, and nothing lost without a compiler."""

import casadi as ca
import numpy as np
import pytest
from reference_systems import backlash

from continuation import CVODES, sweep
from continuation.model import compiled, machine_code
from continuation.model.compiled import compiled_march, find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler here")


@needs_compiler
def test_compiled_march_follows_the_flow():
    system = backlash()
    path, note = compiled_march(system, 0.5)
    assert "256 Runge-Kutta steps" in note
    march = ca.external("march", path)
    x, p = np.array([0.9, 0.05]), system.parameter_vector({"omega": 0.7})
    exact = CVODES(rtol=1e-11, atol=1e-13).compile(system).period(x, p)[-1]
    # stepping over a contact change costs a fixed-step method most of its order, hence no tighter bound
    assert np.abs(np.array(march(x, p)).ravel() - exact).max() < 1e-5


@needs_compiler
def test_compiled_transients_do_not_change_a_sweep():
    system = backlash()
    values = np.linspace(0.5, 0.68, 4)
    plain = sweep(system, "omega", values, quantity="x")
    helped = sweep(system, "omega", values, quantity="x", march=compiled_march(system, 0.5)[0])
    np.testing.assert_array_equal(plain.period, helped.period)
    np.testing.assert_allclose(plain.rms, helped.rms, rtol=0, atol=3e-7)
    assert "compiled" in helped.method
    assert "compiled" not in plain.method


def test_without_a_compiler_it_says_so(monkeypatch):
    monkeypatch.setattr(compiled, "find_compiler", lambda: None)
    assert compiled_march(backlash(), 0.5) == ("", "no C compiler was found")


def test_a_compiler_that_fails_is_named():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine_code, "find_compiler", lambda: "/bin/false")
        path, note = compiled_march(backlash(), 0.5)
    assert path == ""
    assert "/bin/false failed" in note


def test_a_stiff_model_is_left_to_cvodes():
    x, v, theta, omega = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega"))
    from continuation import System

    stiff = System(
        name="stiff",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": ca.cos(theta) - 1e10 * x - v},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    path, note = compiled_march(stiff, 1.0)
    if find_compiler() is not None:
        assert path == ""
        assert "too many" in note
