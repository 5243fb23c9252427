"""Physical pair files in the time domain: forces by every integrator, balances over a period, sections, speeds."""

from __future__ import annotations

import numpy as np
import pytest

from continuation import (
    CVODES,
    ContactChange,
    Crossing,
    EventExact,
    FixedStep,
    Stroboscopic,
    poincare_section,
    simulate,
)
from sbg_casadi import gear_system, load_pair
from sbg_casadi.dimensionless import COORDINATES
from sbg_casadi.model import static_state

INTEGRATORS = (CVODES(rtol=1e-11, atol=1e-13), EventExact(), FixedStep(512), FixedStep(256, 8))
PHASES = 2 * np.pi * (np.arange(256) + 0.5) / 256
RATIO = 1.1  # of the ISO 23509 pair before its modification: loses contact in every period


@pytest.fixture(scope="module")
def pair():
    d = load_pair("iso-f2").dimensionless("before")
    system = gear_system(d)
    p = system.parameter_vector({"frequency_ratio": RATIO})
    return d, system, FixedStep(256, 8).compile(system).run(static_state(d), p, 1200).end


@pytest.fixture(scope="module")
def reference(pair):
    _, system, x = pair
    return simulate(system, x, 2, integrator=EventExact(rtol=1e-12, atol=1e-13), phases=PHASES, frequency_ratio=RATIO)


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=str)
def test_forces_at_chosen_phases(pair, reference, integrator):
    _, system, x = pair
    run = simulate(system, x, 2, integrator=integrator, phases=PHASES, frequency_ratio=RATIO)
    assert run.phases[:-1] == pytest.approx(np.concatenate([PHASES, PHASES + 2 * np.pi]))
    assert set(run.outputs) == {"mesh_force", "deflection", *(f"bearing_{name}" for name in COORDINATES)}
    for name, values in run.outputs.items():
        assert abs(values - reference.outputs[name]).max() < 2e-7
    assert len(run.changes) == len(reference.changes) == 4
    assert run.changes[:, 1:].tolist() == reference.changes[:, 1:].tolist()
    assert abs(run.changes[:, 0] - reference.changes[:, 0]).max() < 1e-5
    share = sum(b - a for a, b, piece in run.intervals() if piece == 1) / run.phases[-1]
    assert 0.05 < share < 0.95


def test_bearings_carry_the_mesh_force(pair, reference):
    """Over a period of a periodic response every mean acceleration vanishes: s_i G + B_i = 0, and G carries T."""
    d = pair[0]
    one = slice(0, len(PHASES))
    assert abs(reference.states[256] - reference.states[0]).max() < 1e-6
    force = reference.outputs["mesh_force"][one].mean()
    assert force == pytest.approx(d.torque / d.tangential_cosine, abs=2e-4)  # means of samples of a force with corners
    for name, s in zip(COORDINATES, d.directions, strict=True):
        assert reference.outputs[f"bearing_{name}"][one].mean() == pytest.approx(-s * force, abs=2e-4)


@pytest.mark.parametrize("integrator", [FixedStep(512), EventExact()], ids=["fixed", "exact"])
def test_sections_of_a_pair(pair, integrator):
    d, system, x = pair
    settings = {"count": 4, "transient": 0, "limit": 20, "integrator": integrator, "frequency_ratio": RATIO}
    strobe = poincare_section(system, x, Stroboscopic(), **settings)
    assert abs(strobe.points - x).max() < 1e-6
    onset = poincare_section(system, x, ContactChange(direction=1), **settings)
    flank = poincare_section(system, x, Crossing("deflection", 1.0), **settings)
    assert abs(onset.points - flank.points).max() < 1e-8
    assert np.all(onset.column("dlambda") > 0)
    assert np.diff(onset.phases) == pytest.approx(2 * np.pi, abs=1e-5)
    rest = dict(zip(system.state_names, static_state(d), strict=True))
    force = d.bearing_stiffness[1] / d.mass_ratios[1] * rest["y_p"]  # of the bearing under the mean load
    for name, level in (("y_p", rest["y_p"]), ("bearing_y_p", force)):
        met = poincare_section(system, x, Crossing(name, level), **settings)
        assert len(met.points) == 4
        assert np.all(met.column("dy_p") > 0)
        if name == "y_p":
            assert abs(met.column("y_p") - level).max() < 1e-10
