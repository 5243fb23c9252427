"""Quasi-periodic, chaotic or not known: verdicts on sequences whose nature is known beforehand."""

import numpy as np
import pytest
from reference_systems import gear

from continuation import sweep
from continuation.timedomain.recognition import CHAOTIC, QUASI_PERIODIC, UNKNOWN, judge, rotation_number
from continuation.timedomain.waveform import order_spectrum

K = np.arange(512)
STILL = np.zeros(64)
GEAR_START = [1.2] + [0.0] * 13


def circle(turns):
    """Return points of a bent closed curve visited with a rotation number."""
    phase = 2 * np.pi * turns * K
    return np.column_stack([np.cos(phase) + 0.3 * np.cos(2 * phase + 1), np.sin(phase + 0.2), np.full(len(K), 3.0)])


def henon(count):
    """Return points of the Henon map and the growth of a tangent vector: exponent 0.4192 per step."""
    x, y, v, points, growth = 0.1, 0.3, np.array([1.0, 0.0]), [], []
    for k in range(100 + 8 * count):
        v = np.array([-2.8 * x * v[0] + v[1], 0.3 * v[0]])
        x, y = 1 - 1.4 * x * x + y, 0.3 * x
        size = np.linalg.norm(v)
        v = v / size
        if k >= 100:
            points.append((x, y))
            growth.append(np.log(size))
    return np.array(points), np.array(growth).reshape(-1, 8).mean(axis=1)


@pytest.mark.parametrize("turns", [(np.sqrt(5) - 1) / 2, np.sqrt(2) / 5, np.pi / 10])
def test_a_torus_is_recognised_and_its_rotation_number(turns):
    found = judge(circle(turns), STILL, 1.0)
    assert found.verdict == QUASI_PERIODIC
    assert found.rotation == pytest.approx(min(turns % 1, 1 - turns % 1), abs=1e-7)
    assert found.averages < 1e-5


@pytest.mark.parametrize("fraction", [2 / 7, 13 / 44, 21 / 64, 1 / 3])
def test_a_locked_response_is_not_called_quasi_periodic(fraction):
    assert judge(circle(fraction), STILL, 1.0).verdict == UNKNOWN


def test_the_henon_map_is_chaotic():
    points, growth = henon(64)
    found = judge(points, growth, 1.0)
    assert found.verdict == CHAOTIC
    assert abs(found.exponent - 0.4192) < 4 * found.exponent_error < 0.15


def test_what_still_settles_is_neither():
    spiral = circle(np.sqrt(2) / 5) * np.exp(-1e-3 * K)[:, None]
    assert judge(spiral, STILL - 1e-3, 1.0).verdict == UNKNOWN
    found = judge(spiral, STILL - 0.05, 1.0)
    assert found.verdict == UNKNOWN
    assert found.settles


def test_a_positive_exponent_alone_is_not_chaos():
    """Averages of a torus agree; a tangent vector may grow along it, algebraically."""
    assert judge(circle(np.sqrt(2) / 5), STILL + 0.05, 1.0).verdict == UNKNOWN


def test_noise_without_growth_is_not_recognised():
    noise = np.random.default_rng(0).normal(size=(512, 3))
    assert judge(noise, STILL, 1.0).verdict == UNKNOWN


def test_the_error_of_the_rotation_number_is_never_below_its_precision():
    assert rotation_number(circle(0.25)[:, :2])[1] >= 1e-7


def test_gear_responses_are_told_apart():
    """A torus between the points 2.2934 and 2.1671, a locked one at 2.15, chaos with twice the stiffness variation."""
    settings = {"quantity": "lambda", "load": "mesh_force", "start": GEAR_START}
    torus = sweep(gear(), "frequency_ratio", [2.25, 2.15], **settings)
    assert torus.verdicts[0] == QUASI_PERIODIC
    assert abs(torus.exponent[0]) < 3 * torus.exponent_error[0] < 0.01
    assert 0.29 < torus.rotation[0] < 0.31
    assert torus.verdicts[1] != QUASI_PERIODIC
    chaos = sweep(gear(2.0), "frequency_ratio", [1.625], **settings)
    assert chaos.verdicts == (CHAOTIC,)
    assert chaos.exponent[0] > 3 * chaos.exponent_error[0]
    assert chaos.period[0] == 0
    assert "1 chaotic" in str(chaos)


def test_orders_between_the_lines_of_the_spectrum():
    theta = 2 * np.pi * np.arange(64 * 64) / 64
    orders, amplitudes = order_spectrum(1 + np.cos(theta) + 0.1 * np.cos(theta / 3), 64)
    assert orders[1] == 1 / 64
    assert amplitudes[orders == 1.0] == pytest.approx(1.0, abs=1e-4)
    assert 0.08 < amplitudes[np.flatnonzero(abs(orders - 1 / 3) < 0.02)].max() < 0.1
    assert amplitudes[orders > 2].max() < 1e-4
