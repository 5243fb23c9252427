"""Mesh and bearing forces, separation and accelerations of an orbit: balances that must hold, and units."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from continuation import HarmonicBalance, Orbit, trace
from sbg_casadi import UserError, gear_system, load_pair
from sbg_casadi.outputs import below_level, dimensionless_outputs, si_outputs
from sbg_casadi.physical import Physical
from sbg_casadi.reading import PRESETS, Reading, as_read

PAIR = load_pair("iso-f2")
D = PAIR.dimensionless("before")


def orbit_at(ratio: float, reading: Reading = frozenset(), state: str = "before") -> Orbit:
    problem = HarmonicBalance().discretise(
        gear_system(as_read(PAIR, state, reading), reading), parameter="frequency_ratio"
    )
    branch = trace(problem, problem.guess(frequency_ratio=1.2), (1.2, 1.0))
    return problem.solve(min(branch.orbits, key=lambda o: abs(o.value - ratio)), ratio)


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    """An orbit beside the resonance that loses contact."""
    return orbit_at(1.05)


@pytest.fixture(scope="module")
def si(orbit: Orbit) -> xr.Dataset:
    return si_outputs(orbit, PAIR, "before")


def test_mean_mesh_force_carries_the_torque(orbit: Orbit) -> None:
    result = dimensionless_outputs(orbit, D)
    assert float(result.separation) > 0.05
    assert float(result.mean_mesh_force) == pytest.approx(D.torque / D.tangential_cosine, rel=2e-6)


def test_mean_mesh_force_carries_the_torque_in_the_printed_reading() -> None:
    reading = PRESETS["printed"]
    result = dimensionless_outputs(orbit_at(1.05, reading), as_read(PAIR, "before", reading), reading)
    assert float(result.mean_mesh_force) == pytest.approx(D.mean_force, rel=1e-5)


def test_mean_bearing_forces_carry_the_mean_mesh_force(orbit: Orbit) -> None:
    result = dimensionless_outputs(orbit, D)
    expected = -np.array(D.directions) * D.mean_force
    assert result.bearing_force.mean("phase").values == pytest.approx(expected, abs=1e-9)


def test_virtual_work_balances_at_every_instant(si: xr.Dataset) -> None:
    """Inertia and bearing forces on any virtual displacement equal -F_n d(lambda) plus the torques, in SI units."""
    p = Physical.of(PAIR, "before")
    a1, a2, a3 = p.cosines
    gradient = np.array([-a1, a2, a3, a1, -a2, -a3, p.pinion_radius * a3, -p.gear_radius * a3])
    linear = np.array(p.masses)[:, None] * si.acceleration.values + si.bearing_force.values
    turning = np.array(
        [
            p.pinion_inertia * si.pinion_angular_acceleration.values - p.pinion_torque,
            p.gear_inertia * si.gear_angular_acceleration.values + p.gear_torque,
        ]
    )
    displacement = np.random.default_rng(0).normal(size=8) * [1, 1, 1, 1, 1, 1, 30, 10]
    left = displacement @ np.vstack([linear, turning])
    right = -(displacement @ gradient) * si.mesh_force.values
    assert left == pytest.approx(right, rel=1e-9, abs=1e-9 * np.abs(right).max())


def test_acceleration_of_lambda_is_that_of_its_parts(si: xr.Dataset) -> None:
    p = Physical.of(PAIR, "before")
    s = np.array(D.directions)
    turning = p.pinion_radius * si.pinion_angular_acceleration - p.gear_radius * si.gear_angular_acceleration
    expected = s @ si.acceleration.values + p.cosines[2] * turning.values
    scale = np.abs(expected).max()
    assert si.lambda_acceleration.values == pytest.approx(expected, abs=1e-10 * scale)


def test_bearing_forces_are_stiffness_and_damping_in_si_units(orbit: Orbit, si: xr.Dataset) -> None:
    p = Physical.of(PAIR, "before")
    velocity = orbit.evaluate(si.phase.values)[:, 8:].T * p.half_backlash * p.natural_frequency
    stiffness, damping = np.array(p.bearing_stiffness)[:, None], np.array(p.bearing_damping)[:, None]
    expected = stiffness * si.displacement.values + damping * velocity
    assert si.bearing_force.values == pytest.approx(expected, rel=1e-11, abs=1e-11 * np.abs(expected).max())


def test_accelerations_are_second_derivatives_in_time(si: xr.Dataset) -> None:
    """Central differences of the waveform, whose kinks in the third derivative cost little."""
    t, step = si.time.values, float(si.time[1] - si.time[0])
    assert t[-1] + step == pytest.approx(2 * np.pi / (1.05 * PAIR.derived.natural_frequency))  # type: ignore[union-attr]
    for values, expected in [
        (si["lambda"].values, si.lambda_acceleration.values),
        (si.displacement.values[2], si.acceleration.values[2]),
    ]:
        found = (np.roll(values, -8) - 2 * values + np.roll(values, 8)) / (8 * step) ** 2
        assert found == pytest.approx(expected, abs=1e-2 * np.abs(expected).max())


def test_separation_is_where_the_force_is_damping_alone(orbit: Orbit) -> None:
    coarse, fine = (dimensionless_outputs(orbit, D, samples=n) for n in (512, 8192))
    assert float(coarse.separation) == pytest.approx(float(fine.separation), abs=1e-4)
    apart = np.abs(fine.deflection.values) < 1
    assert apart.mean() == pytest.approx(float(fine.separation), abs=2e-4)
    rate = orbit.evaluate(fine.phase.values)[:, 7]
    assert fine.mesh_force.values[apart] == pytest.approx(2 * D.mesh_damping_ratio * rate[apart], abs=1e-12)
    assert float(fine.back_contact) == 0.0


def test_without_contact_loss_there_is_no_separation() -> None:
    problem = HarmonicBalance().discretise(gear_system(D), parameter="frequency_ratio")
    result = dimensionless_outputs(problem.solve(problem.guess(frequency_ratio=2.0), 2.0), D)
    assert float(result.separation) == 0.0
    assert 1 < float(result.dynamic_factor) < 2


@pytest.mark.parametrize("form", ["dimensionless", "si"])
def test_every_variable_has_a_unit_and_a_name(orbit: Orbit, si: xr.Dataset, form: str) -> None:
    result = dimensionless_outputs(orbit, D) if form == "dimensionless" else si
    for name, variable in result.data_vars.items():
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert all("units" in coordinate.attrs for coordinate in result.coords.values())
    assert {v.attrs["units"] for v in result.data_vars.values()} == (
        {"1"} if form == "dimensionless" else {"1", "m", "N", "m/s^2", "rad/s^2"}
    )


def test_forces_in_newton(si: xr.Dataset) -> None:
    assert float(si.mean_mesh_force) == pytest.approx(14193.3, abs=0.2)
    assert float(si.dynamic_factor) == pytest.approx(float(si.mesh_force.max() / si.mesh_force.mean()))


def test_below_level_of_a_cosine() -> None:
    """The time a cosine is below one half is two thirds of its period."""
    x = np.cos(2 * np.pi * np.arange(4096) / 4096)
    assert below_level(x, 0.5) == pytest.approx(2 / 3, abs=1e-6)
    assert (below_level(x, 2.0), below_level(x, -2.0)) == (1.0, 0.0)
    assert (below_level(np.zeros(4), 1.0), below_level(np.zeros(4), -1.0)) == (1.0, 0.0)


def test_wrong_orbits_and_too_few_samples_are_refused(orbit: Orbit) -> None:
    with pytest.raises(UserError, match="at least 16"):
        dimensionless_outputs(orbit, D, samples=8)
    with pytest.raises(UserError, match="masses, radii and backlash are unknown"):
        si_outputs(orbit, load_pair("example"))
    problem = HarmonicBalance().discretise(gear_system(D).with_parameters(torque=0.2), parameter="torque")
    assert float(dimensionless_outputs(problem.solve(problem.guess(torque=0.3), 0.3), D).mean_mesh_force) == (
        pytest.approx(0.3 / D.tangential_cosine, rel=1e-5)
    )
