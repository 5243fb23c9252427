"""Derived quantities of a pair: published numbers, the table of the four gear pairs, and identities."""

from __future__ import annotations

import doctest
import importlib
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sbg_casadi import derived as d
from sbg_casadi import load_pair
from sbg_casadi.mesh import fourier_series, peak_to_peak, stiffness_fault, stiffness_minimum

ISO = load_pair("iso-f2")

# teeth, module mm -> R_e, face width, R_m, d_m1, d_m2 mm; masses kg; inertias kg m^2; k_0 N/m
CASES = [
    ((14, 41, 3.105), (67.26, 20.2, 57.17, 36.95, 108.21), (0.163, 0.476), (2.92e-5, 7.33e-4), 4.04e8),
    ((15, 44, 5.8), (134.81, 40.4, 114.59, 73.95, 216.92), (1.306, 3.830), (9.39e-4, 2.37e-2), 8.09e8),
    ((23, 65, 3.9), (134.45, 40.3, 114.28, 76.24, 215.47), (1.379, 3.897), (1.05e-3, 2.38e-2), 8.07e8),
    ((23, 65, 7.0), (241.32, 72.4, 205.12, 136.85, 386.75), (7.97, 22.5), (1.96e-2, 4.43e-1), 1.45e9),
]


@pytest.mark.parametrize(("gear", "lengths", "masses", "inertias", "stiffness"), CASES)
def test_defaults_of_the_four_published_pairs(
    gear: tuple[int, int, float],
    lengths: tuple[float, ...],
    masses: tuple[float, float],
    inertias: tuple[float, float],
    stiffness: float,
) -> None:
    z1, z2, module = gear
    outer = d.outer_cone_distance(module * 1e-3, z1, z2)
    width = d.default_face_width(outer)
    mean = outer - width / 2
    diameters = [module * 1e-3 * z * mean / outer for z in (z1, z2)]
    assert np.array([outer, width, mean, *diameters]) * 1e3 == pytest.approx(lengths, abs=0.06)
    assert d.default_mesh_stiffness(width) == pytest.approx(stiffness, rel=3e-3)
    angle = d.pitch_cone_angle(z1, z2)
    for z, cone, mass, inertia in zip((z1, z2), (angle, math.pi / 2 - angle), masses, inertias, strict=True):
        radius = module * 1e-3 * z / 2
        found = d.frustum_mass(radius, cone, width, outer)
        assert found == pytest.approx(mass, rel=3e-3)
        assert d.frustum_inertia(found, radius, width, outer) == pytest.approx(inertia, rel=5e-3)


def test_iso_f2_has_the_published_geometry_and_forces() -> None:
    derived = ISO.derived
    assert derived is not None
    assert derived.outer_cone_distance * 1e3 == pytest.approx(93.973, abs=1e-3)
    assert derived.mean_cone_distance * 1e3 == pytest.approx(81.273, abs=1e-3)
    assert math.degrees(derived.pitch_angle) == pytest.approx(19.747, abs=5e-4)
    assert 2e3 * derived.pinion_mean_radius == pytest.approx(54.918, abs=1e-3)
    assert 2e3 * derived.gear_mean_radius == pytest.approx(152.987, abs=1e-3)
    assert derived.normal_force == pytest.approx(14193.3, abs=0.2)
    assert derived.tangential_force == pytest.approx(10925.3, abs=0.2)
    assert 2e3 * derived.half_backlash == pytest.approx(0.1098, abs=5e-5)
    assert ISO.published == {"normal_force": 14193.3, "tangential_force": 10925.3}


def test_iso_f2_speed_load_and_states() -> None:
    derived = ISO.derived
    assert derived is not None
    assert derived.unit_ratio_rpm == pytest.approx(37_000, rel=0.01)
    assert derived.rated_ratio == pytest.approx(1200 / derived.unit_ratio_rpm)
    assert derived.pinion_rpm(2.0) == 2 * derived.unit_ratio_rpm
    assert derived.mesh_stiffness == pytest.approx(5.08e8)
    assert derived.mean_load == pytest.approx(derived.normal_force / (5.08e8 * derived.half_backlash))
    assert derived.pinion_torque == pytest.approx(300)
    assert derived.gear_torque == pytest.approx(300 * 39 / 14)
    before, after = (ISO.dimensionless(state) for state in ("before", "after"))
    assert before.mean_force == pytest.approx(derived.mean_load)
    assert peak_to_peak(before.stiffness_cosine, before.stiffness_sine) == pytest.approx(0.25, abs=1e-12)
    assert before.stiffness_cosine[1] == before.stiffness_cosine[0] / 4
    assert after.stiffness_cosine == pytest.approx(0.65 * np.array(before.stiffness_cosine))
    assert after.bearing_stiffness == before.bearing_stiffness


def test_bearings_add_up_as_in_equation_13() -> None:
    derived, numbers = ISO.derived, ISO.dimensionless()
    assert derived is not None
    ends = np.array([2.1e8, 6e8, 6e8, 6e8, 2.1e8, 6e8])  # axial: one end of the pinion in x and of the gear in y
    masses = np.array([derived.pinion_mass] * 3 + [derived.gear_mass] * 3)
    omega = derived.natural_frequency
    assert numbers.bearing_stiffness == pytest.approx(ends / (masses * omega**2), rel=1e-12)
    damping = 2 * 0.02 * np.sqrt(ends * masses)  # N s/m, damping ratio 0.02
    assert numbers.bearing_damping == pytest.approx(damping / (2 * masses * omega), rel=1e-12)
    assert numbers.mass_ratios == pytest.approx(derived.equivalent_mass / masses, rel=1e-12)
    a1, a2, a3 = derived.a1, derived.a2, derived.a3
    assert numbers.directions == (-a1, a2, a3, a1, -a2, -a3)


ANGLES = st.floats(0.0, math.pi / 2)


@given(ANGLES, ANGLES, ANGLES, st.sampled_from([1, -1]))
def test_direction_cosines_are_a_unit_vector(pressure: float, spiral: float, pitch: float, side: int) -> None:
    cosines = d.direction_cosines(pressure, spiral, pitch, side)
    assert sum(a**2 for a in cosines) == pytest.approx(1.0, abs=1e-14)


@given(st.floats(1e-5, 1e-2), st.floats(0.5, 1.0), st.floats(0.3, 1.0))
def test_the_four_backlash_planes_describe_one_gap(gap: float, reduction: float, a3: float) -> None:
    """A rotation of the gear opens each plane by its own amount; all convert back to the mean normal."""
    arcs = {
        "mean-normal": gap,
        "outer-normal": gap / reduction,
        "mean-transverse": gap / a3,
        "outer-transverse": gap / (a3 * reduction),
    }
    for plane, arc in arcs.items():
        assert d.mean_normal_backlash(arc, plane, reduction, a3) == pytest.approx(gap, rel=1e-13)  # type: ignore[arg-type]


SERIES = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6)


@given(SERIES, SERIES)
def test_smallest_stiffness_lies_below_a_dense_scan_and_is_reached(cosine: list[float], sine: list[float]) -> None:
    n = min(len(cosine), len(sine))
    cosine, sine = cosine[:n], sine[:n]
    low, phase = stiffness_minimum(cosine, sine)
    scan = 1 + fourier_series(cosine, sine, np.linspace(0, 2 * np.pi, 4001))
    assert low <= scan.min() + 1e-11
    assert 1 + float(fourier_series(cosine, sine, phase)) == pytest.approx(low, abs=1e-11)
    assert (stiffness_fault(cosine, sine) is None) == (low > 1e-12 * (1 + max(map(abs, cosine + sine))))


@pytest.mark.parametrize("depth", [1.0, 1.0 + 1e-9, 1e300])
def test_stiffness_that_just_touches_zero_is_found(depth: float) -> None:
    assert stiffness_fault([0.0] * 36 + [depth], [0.0] * 37) is not None
    assert stiffness_fault([0.0] * 36 + [1 - 1e-9], [0.0] * 37) is None


def test_flat_series_of_many_harmonics_stays_cheap_and_safe() -> None:
    """``cos(theta/2)^400`` is flat over most of the circle; the bound must not run away in memory."""
    n = 200
    log = [math.lgamma(2 * n + 1) - math.lgamma(n + j + 1) - math.lgamma(n - j + 1) for j in range(n + 1)]
    c = np.exp(np.array(log) - log[0])
    cosine = (-2 * c[1:]).tolist()
    low, _ = stiffness_minimum(cosine, [0.0] * n)
    assert low <= 1 - 2 * c[1:].sum() + 1e-9


def test_derivative_of_a_series_is_exact() -> None:
    theta = np.linspace(0, 6, 7)
    found = fourier_series([0.3, 0.1], [0.2, -0.4], theta, derivative=1)
    exact = -0.3 * np.sin(theta) - 0.2 * np.sin(2 * theta) + 0.2 * np.cos(theta) - 0.8 * np.cos(2 * theta)
    assert found == pytest.approx(exact, abs=1e-14)


MODULES = [
    *("cli", "conversion", "derived", "dimensionless", "entries", "errors", "files", "mesh", "model", "pair", "shapes"),
    *("table_heads", "tables", "units"),
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings(name: str) -> None:
    result = doctest.testmod(importlib.import_module(f"sbg_casadi.{name}"))
    assert result.failed == 0
