"""Very stiff bearings leave one degree of freedom, lambda'' = a3 T - a3^2 G: the paper's Figure 2, with its rate.

What the bearings give is the mesh force over their stiffness, so every difference to that oscillator goes like 1/K_i.
"""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from continuation import Contact, HarmonicBalance, System
from sbg_casadi import gear_system, load_pair, static_state
from sbg_casadi.model import harmonic_sum

PAIR = load_pair("iso-f2").dimensionless("before")
METHOD = HarmonicBalance(harmonics=63)  # the same truncation on both sides
PHASES = np.linspace(0, 2 * np.pi, 512, endpoint=False)
FACTORS = (1e4, 1e6, 1e8)


def stiffened(dimensionless, factor):
    """Multiply every K_i and keep the bearing damping ratio, C_i = zeta sqrt(K_i)."""
    return replace(
        dimensionless,
        bearing_stiffness=tuple(factor * k for k in dimensionless.bearing_stiffness),
        bearing_damping=tuple(np.sqrt(factor) * c for c in dimensionless.bearing_damping),
    )


def rigid_bearings():
    lam, dlam, theta, ratio = (ca.SX.sym(n) for n in ("lambda", "dlambda", "theta", "frequency_ratio"))
    mesh = Contact(argument=lam, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0), name="mesh")
    k = 1 + harmonic_sum(PAIR.stiffness_cosine, PAIR.stiffness_sine, theta)
    force = k * mesh.force + 2 * PAIR.mesh_damping_ratio * dlam
    a3 = PAIR.tangential_cosine
    return System(
        name="rigid bearings",
        states={"lambda": lam, "dlambda": dlam},
        derivatives={"lambda": dlam, "dlambda": a3 * PAIR.torque - a3**2 * force},
        phase=theta,
        frequency="frequency_ratio",
        parameters={"frequency_ratio": (ratio, 1.0)},
        contacts=[mesh],
    )


def with_bearings_at_rest(orbit, system):
    """Return the orbit of one degree of freedom as a start for all fourteen states."""
    coefficients = np.zeros((len(orbit.coefficients), len(system.state_names)), dtype=complex)
    for name in orbit.state_names:
        coefficients[:, system.state_names.index(name)] = orbit.coefficients[:, orbit.index(name)]
    return replace(orbit, system=system.name, state_names=system.state_names, coefficients=coefficients)


@pytest.mark.parametrize(("ratio", "contact_loss"), [(2.2, False), (1.0, False), (0.75, True)])
def test_difference_to_one_degree_of_freedom_goes_like_one_over_stiffness(ratio, contact_loss):
    rigid = METHOD.discretise(rigid_bearings(), "frequency_ratio").guess(frequency_ratio=ratio)
    wave = rigid.evaluate(PHASES)[:, 0]
    assert (wave.min() < 1) == contact_loss
    waveform, rms = [], []
    for factor in FACTORS:
        # The starting integration follows the bearings, 20 s at 1e8 times; Newton from the rigid orbit does not.
        system = gear_system(stiffened(PAIR, factor))
        orbit = METHOD.discretise(system, "frequency_ratio").solve(with_bearings_at_rest(rigid, system), ratio)
        waveform.append(np.abs(orbit.evaluate(PHASES)[:, 0] - wave).max())
        rms.append(abs(orbit.rms("lambda") - rigid.rms("lambda")))
    for difference in (waveform, rms):
        assert difference[0] < 1e-3
        assert np.divide(difference[:-1], difference[1:]) == pytest.approx(100, rel=0.05)


def test_natural_frequency_tends_to_the_tangential_cosine():
    """In contact, with constant stiffness; the rounding of the eigenvalues grows with K, so factors are smaller."""
    constant = replace(PAIR, stiffness_cosine=(), stiffness_sine=())
    distance = []
    for factor in (1e2, 1e4, 1e6):
        numbers = stiffened(constant, factor)
        system = gear_system(numbers)
        jacobian = ca.Function("A", [system.x, system.theta, system.p], [ca.jacobian(system.closed(), system.x)])
        matrix = jacobian(static_state(numbers), 0.0, system.parameter_vector()).full()
        distance.append(abs(np.abs(np.linalg.eigvals(matrix)).min() - PAIR.tangential_cosine))
    assert np.divide(distance[:-1], distance[1:]) == pytest.approx(100, rel=0.05)
