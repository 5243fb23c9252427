"""Lyapunov exponents from the model and from one measured quantity, against known values."""

import numpy as np
import pytest
from reference_systems import backlash, gear, symbols

from continuation import ContinuationError, System
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.lyapunov import lyapunov_spectrum
from continuation.timedomain.series_exponent import Kantz, Rosenstein, series_exponent
from continuation.timedomain.simulate import EventExact, simulate

HIGH = np.array([0.8338430125, 0.1640787518])
GEAR_START = np.array([1.2, *[0.0] * 13])


def lorenz():
    x, y, z = symbols("x", "y", "z")
    rates = {"x": 10 * (y - x), "y": x * (28 - z) - y, "z": x * y - 8 / 3 * z}
    return System(name="lorenz", states={"x": x, "y": y, "z": z}, derivatives=rates, parameters={})


def test_lorenz_spectrum():
    """Exponents 0.906, 0, -14.57; their sum is the divergence -41/3."""
    found = lyapunov_spectrum(lorenz(), [1.0, 1.0, 20.0], periods=3000, transient=50, integrator=FixedStep(100))
    assert abs(found.exponents - [0.906, 0.0, -14.572]).max() < 0.015
    assert np.all(abs(found.exponents - [0.9056, 0.0, -14.5723]) < 4 * found.errors)
    assert np.all(found.errors < [0.006, 0.003, 0.006])
    assert found.trace == pytest.approx(-41 / 3, abs=1e-12)
    assert found.total == pytest.approx(-41 / 3, abs=2e-4)
    assert abs(found.total - found.trace) <= found.total_error
    assert found.verdict == "chaotic"
    assert found.period == 1.0


@pytest.mark.parametrize("integrator", [FixedStep(), EventExact(rtol=1e-9, atol=1e-11)], ids=["fixed", "exact"])
def test_complex_multipliers_mean_the_damping(integrator):
    """Multipliers 0.4385 +- 0.4903i of a contact-loss orbit: both exponents are exactly -zeta."""
    found = lyapunov_spectrum(backlash(), HIGH, periods=128, transient=20, integrator=integrator, omega=0.75)
    assert np.all(abs(found.exponents + 0.05) < 3 * found.errors)
    assert found.errors.max() < 0.01
    assert found.total == pytest.approx(-0.1, abs=1e-7)
    assert found.trace == pytest.approx(-0.1, abs=1e-9)
    assert found.per_period == pytest.approx(found.exponents * 2 * np.pi / 0.75)
    assert found.verdict == "not chaotic"


@pytest.mark.parametrize(
    ("omega", "state"), [(0.6, (1.1278799613, 0.0015682478)), (0.75, (1.1624504362, 0.0080293418))], ids=["0.6", "low"]
)
def test_without_contact_loss_the_exponents_are_the_damping(omega, state):
    found = lyapunov_spectrum(backlash(), state, periods=128, transient=0, omega=omega)
    assert np.all(abs(found.exponents + 0.05) < 3 * found.errors)
    assert found.errors.max() < 0.01
    assert found.total == pytest.approx(-0.1, abs=1e-7)


def test_fewer_exponents_are_the_largest_ones():
    all_, one = (lyapunov_spectrum(lorenz(), [1.0, 1.0, 20.0], periods=300, count=k) for k in (3, 1))
    assert one.exponents.shape == (1,)
    assert one.exponents[0] == pytest.approx(all_.exponents[0], abs=0.05)


def test_a_chaotic_and_a_quasi_periodic_gear_response_are_told_apart():
    """Between its torus points at 2.29 and 2.16 the gear is quasi-periodic; with twice the variation it is chaotic."""
    settings = {"periods": 320, "transient": 300, "count": 1, "integrator": FixedStep(128)}
    torus = lyapunov_spectrum(gear(), GEAR_START, frequency_ratio=2.22, **settings)
    chaos = lyapunov_spectrum(gear(2.0), GEAR_START, frequency_ratio=1.625, **settings)
    assert abs(torus.exponents[0]) < 3 * torus.errors[0] < 0.02
    assert torus.verdict == "undecided"
    assert chaos.exponents[0] > 5 * chaos.errors[0]
    assert chaos.exponents[0] > 0.04
    assert chaos.verdict == "chaotic"


def test_factors_that_rounding_hides_are_refused():
    x, v = symbols("x", "v")
    stiff = System(name="stiff", states={"x": x, "v": v}, derivatives={"x": x + v, "v": -40 * v}, parameters={})
    with pytest.raises(ContinuationError, match="use EventExact"):
        lyapunov_spectrum(stiff, [0.0, 0.0], periods=64, transient=0)
    found = lyapunov_spectrum(stiff, [0.0, 0.0], periods=64, transient=0, integrator=EventExact(rtol=1e-8))
    assert found.exponents == pytest.approx([1.0, -40.0], abs=1e-4)


@pytest.fixture(scope="module")
def lorenz_series():
    run = simulate(lorenz(), [1.0, 1.0, 20.0], 220, integrator=FixedStep(128), phases=np.arange(32) / 32)
    return run.states[640:, 0]


@pytest.mark.parametrize("method", [Rosenstein(), Kantz()], ids=["Rosenstein", "Kantz"])
@pytest.mark.parametrize(("dimension", "delay"), [(5, 2), (5, 3)])
def test_exponent_of_a_lorenz_series(lorenz_series, method, dimension, delay):
    found = series_exponent(
        lorenz_series, 1 / 32, dimension=dimension, delay=delay, window=40, horizon=160, method=method
    )
    assert abs(found.value - 0.906) < 3 * found.error
    assert found.error < 0.2
    assert found.divergence.shape == found.times.shape == (161,)


def test_exponent_of_the_logistic_map_is_that_of_one_bit():
    x = [0.3]
    for _ in range(4000):
        x.append(4 * x[-1] * (1 - x[-1]))
    for method in (Rosenstein(), Kantz(0.002)):
        found = series_exponent(x, 1.0, dimension=1, delay=1, window=1, horizon=9, fit=(0, 4), method=method)
        assert abs(found.value - np.log(2)) < 3 * found.error < 0.3


def test_exponent_of_a_quasi_periodic_series_is_zero():
    t = 0.1 * np.arange(6000)
    found = series_exponent(
        np.cos(t) + 0.7 * np.cos(np.sqrt(2) * t + 1), 0.1, dimension=5, delay=7, window=63, horizon=200
    )
    assert abs(found.value) < max(3 * found.error, 0.03)
    assert found.error < 0.05


def test_misuse_is_refused():
    wave = np.sin(np.arange(2000.0))
    settings = {"dimension": 2, "delay": 2, "window": 6, "horizon": 20}
    for series, change, message in (
        (wave[:100], {}, "100 samples leave 78 delay vectors"),
        (0 * wave, {}, "not constant"),
        (np.append(wave, np.nan), {}, "finite"),
        (wave, {"delay": 0}, "must be positive"),
        (wave, {"fit": (0.0, 1.0)}, "fit needs 4 or more samples"),
        (wave, {"method": Kantz(1e-9)}, "larger radius"),
    ):
        with pytest.raises(ValueError, match=message):
            series_exponent(series, 1.0, **{**settings, **change})
    with pytest.raises(ValueError, match="radius and neighbours"):
        Kantz(0.0)
    with pytest.raises(ValueError, match="1 to 3 exponents"):
        lyapunov_spectrum(lorenz(), [1.0, 1.0, 20.0], count=4)
    with pytest.raises(ValueError, match="64 or more periods"):
        lyapunov_spectrum(lorenz(), [1.0, 1.0, 20.0], periods=10)
