"""The eight-coordinate equations in time: the same lambda as seven coordinates, energy, and the constant trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from continuation import CVODES, HarmonicBalance, System
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.variational import tangents
from sbg_casadi import Dimensionless, case_names, gear_system, load_pair, static_state
from sbg_casadi.equations import eight_coordinate_system, relative_state, transmission_error
from sbg_casadi.physical import Physical

PERIODS = 50
CASES = [  # calibrated ones have the equations of their cases, and responses that rounding drives apart
    (name, state)
    for name in case_names()
    if (pair := load_pair(name)).derived is not None and not name.endswith("-calibrated")
    for state in pair.states
]


def released(physical: Physical, load: float) -> np.ndarray:
    """Return the state at rest with the pinion turned until the mesh carries a multiple of the mean force."""
    x = np.zeros(16)
    lam = physical.half_backlash * (1 + load * physical.dimensionless().mean_force)
    x[6] = lam / (physical.pinion_radius * physical.cosines[2])
    return x


def both(physical: Physical, ratio: float, load: float, rtol: float = 1e-10) -> tuple[np.ndarray, np.ndarray]:
    """Integrate both forms from the same state with CVODES; return dimensionless states (N, 14)."""
    start = released(physical, load)
    seven = CVODES(rtol=rtol, atol=rtol).compile(gear_system(physical.dimensionless()))
    # The states are in m and rad of the size of b; the tolerance follows them.
    eight = CVODES(rtol=rtol, atol=rtol * physical.half_backlash).compile(eight_coordinate_system(physical))
    si = eight.integrate(start, PERIODS, mesh_frequency=ratio * physical.natural_frequency)
    return (
        seven.integrate(relative_state(physical, start), PERIODS, frequency_ratio=ratio),
        relative_state(physical, si),
    )


@pytest.mark.parametrize("ratio", [0.6, 2.0])
@pytest.mark.parametrize(("name", "state"), CASES)
def test_both_forms_give_the_same_lambda(name: str, state: str, ratio: float) -> None:
    seven, eight = both(Physical.of(load_pair(name), state), ratio, load=1.5)
    assert np.abs(seven[:, 0] - eight[:, 0]).max() < 1e-7
    assert np.ptp(seven[:, 0]) > 1e-3


def test_both_forms_agree_through_contact_loss_and_transmission_error() -> None:
    """What differs is the error of the integration: it follows the tolerance."""
    physical = Physical.of(load_pair("iso-f2"), "before")
    b = physical.half_backlash
    rough = replace(physical, error_cosine=(0.05 * b, 0.0), error_sine=(0.03 * b, 0.01 * b))
    off = []
    for rtol in (1e-8, 1e-11):
        seven, eight = both(rough, 1.0, load=3.0, rtol=rtol)
        assert seven[:, 0].min() < 1
        off.append(np.abs(seven - eight)[:, :7].max())
    assert off[1] < 1e-7
    assert off[1] < 0.02 * off[0]


def conservative(pair: str) -> Physical:
    physical = Physical.of(load_pair(pair), "before")
    return replace(
        physical,
        bearing_damping=(0.0,) * 6,
        mesh_damping=0.0,
        pinion_torque=0.0,
        gear_torque=0.0,
        stiffness_cosine=(),
        stiffness_sine=(),
        error_cosine=(),
        error_sine=(),
    )


def energy(p: Physical, path: np.ndarray) -> np.ndarray:
    """Return kinetic energy plus that of the bearings and of the tooth contact, J."""
    q, rate = path[:, :8].T, path[:, 8:].T
    lam = transmission_error(
        dict(zip(("x_p", "y_p", "z_p", "x_g", "y_g", "z_g", "phi_p", "theta_g"), q, strict=True)),
        p.cosines,
        p.pinion_radius,
        p.gear_radius,
    )
    contact = np.maximum(np.abs(lam) - p.half_backlash, 0.0)
    inertia = np.array([*p.masses, p.pinion_inertia, p.gear_inertia])
    stored = np.array(p.bearing_stiffness) @ q[:6] ** 2 + p.mesh_stiffness * contact**2
    return (inertia @ rate**2 + stored) / 2


def test_energy_is_conserved_without_damping_torque_and_fluctuation() -> None:
    """From compressed front flanks the teeth part, cross the backlash and meet on the back flanks, again and again."""
    physical = conservative("iso-f2")
    system = eight_coordinate_system(physical)
    start = np.zeros(16)
    start[6] = 1.5 * physical.half_backlash / (physical.pinion_radius * physical.cosines[2])
    path = CVODES(rtol=1e-10, atol=1e-15).compile(system).integrate(start, PERIODS)
    lam = relative_state(physical, path)[:, 0]
    assert lam.max() > 1
    assert lam.min() < -1
    total = energy(physical, path)
    assert total == pytest.approx(np.full(total.shape, total[0]), rel=1e-6)


def test_a_rigid_rotation_does_not_change_the_vibration() -> None:
    """Galilean invariance in time: the same lambda when both pitch circles move faster by the same speed."""
    physical = Physical.of(load_pair("iso-f2"), "before")
    start = released(physical, 1.5)
    turning = start.copy()
    for i, radius in ((6, physical.pinion_radius), (7, physical.gear_radius)):
        turning[i] += 1e-4 / radius
        turning[8 + i] += 0.05 / radius
    integrator = CVODES(rtol=1e-10, atol=1e-15).compile(eight_coordinate_system(physical))
    a, b = (relative_state(physical, integrator.integrate(x, 20)) for x in (start, turning))
    assert np.abs(a - b)[:, :7].max() < 1e-7


def random_gear(seed: int) -> Dimensionless:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=3)
    a1, a2, a3 = a / np.linalg.norm(a) * [1, 1, np.sign(a[2])]
    a3 = max(abs(a3), 0.3)
    return Dimensionless(
        name="random",
        state="only",
        torque=rng.uniform(0.1, 0.4),
        mesh_damping_ratio=rng.uniform(0.01, 0.05),
        tangential_cosine=a3,
        directions=(-a1, a2, a3, a1, -a2, -a3),
        mass_ratios=tuple(rng.uniform(0.02, 0.3, 6).tolist()),
        bearing_stiffness=tuple(rng.uniform(0.5, 3, 6).tolist()),
        bearing_damping=tuple(rng.uniform(0.01, 0.05, 6).tolist()),
        stiffness_cosine=tuple(rng.uniform(-0.15, 0.15, 2).tolist()),
        stiffness_sine=tuple(rng.uniform(-0.15, 0.15, 2).tolist()),
        error_cosine=tuple(rng.uniform(-0.05, 0.05, 2).tolist()),
        error_sine=tuple(rng.uniform(-0.05, 0.05, 2).tolist()),
    )


def logarithm_of_determinant(d: Dimensionless, period: float) -> float:
    s, mu, xi = np.array(d.directions), np.array(d.mass_ratios), d.mesh_damping_ratio
    return -2 * period * (xi * d.tangential_cosine**2 + xi * np.sum(s**2 * mu) + sum(d.bearing_damping))


@pytest.mark.parametrize("seed", range(8))
def test_determinant_of_the_monodromy_of_random_pairs(seed: int) -> None:
    """exp(-2 T (xi a3^2 + xi sum s^2 mu + sum C)) for an orbit, and for a trajectory through contact changes."""
    d, ratio = random_gear(seed), float(np.random.default_rng(seed + 100).uniform(1.2, 2.5))
    system = gear_system(d)
    expected = logarithm_of_determinant(d, 2 * np.pi / ratio)
    problem = HarmonicBalance().discretise(system, "frequency_ratio")
    orbit = problem.solve(problem.guess(frequency_ratio=ratio), ratio)
    assert np.log(np.abs(orbit.multipliers)).sum() == pytest.approx(expected, abs=1e-8)
    assert np.log(np.abs(np.linalg.det(monodromy(system, d, ratio)))) == pytest.approx(expected, abs=1e-7)


def monodromy(system: System, d: Dimensionless, ratio: float) -> np.ndarray:
    """Return the transition matrix over one period from a state that leaves contact."""
    start, p = static_state(d), system.parameter_vector({"frequency_ratio": ratio})
    start[7] = -1.0
    integrator = ExactIntegrator(system)
    run = integrator.integrate(start, p)
    assert run.changes, "no contact change"
    return tangents(integrator, [run], p).whole(0)
