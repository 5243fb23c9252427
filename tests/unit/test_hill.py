"""Hill's method against the integration of the variational equation, along any waveform, and against closed forms."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from test_monodromy import CASES, random_wave

from continuation import Contact, HarmonicBalance, System
from continuation.orbits import hill
from continuation.orbits.floquet import distance
from continuation.orbits.hill import CondensedHill, hill_exponents, hill_matrix
from continuation.orbits.monodromy import monodromy, multipliers
from continuation.orbits.spectrum import pack

WITH_CONTACT = {"backlash", "parametric backlash", "transmission error", "contact and cubic", "two contacts"}
SYSTEMS = {**CASES, "chain": lambda: rs.linear_chain(0.05)}


def waveform(name, multiple=1):
    """A problem, a waveform of the port arguments that is no orbit, and its multipliers by integration."""
    system = SYSTEMS[name]()
    problem = HarmonicBalance().discretise(system, system.frequency, period_multiple=multiple)
    u = pack(random_wave(1, 4, problem.ports.outputs, size=0.5 if name == "full form" else 1.0))
    return problem, u, multipliers(monodromy(problem, [(u, 1.0)]).matrices)[0]


@pytest.mark.parametrize("multiple", [1, 2])
@pytest.mark.parametrize("name", SYSTEMS)
def test_every_multiplier_is_a_root_of_the_condensed_equations(name, multiple):
    problem, u, mu = waveform(name, multiple)
    hill = CondensedHill(problem, u, 1.0, 31 * multiple)
    off = np.abs([hill.multiplier(m) - m for m in mu]) / max(1.0, np.abs(mu[0]))
    assert off.max() < (3e-6 if name in WITH_CONTACT else 1e-12)


@pytest.mark.parametrize("multiple", [1, 2])
@pytest.mark.parametrize("name", SYSTEMS)
def test_both_rules_select_the_multipliers_from_hills_matrix(name, multiple):
    """No number of the integration enters; the selected exponents are improved on the condensed equations."""
    problem, u, mu = waveform(name, multiple)
    hill, turn = CondensedHill(problem, u, 1.0, 31 * multiple), 2 * np.pi / problem.frequency(1.0)
    for chosen in hill_exponents(problem, u, 1.0, 12 * multiple):
        improved = np.exp(np.array([hill.correct(s, 8) for s in chosen]) * turn)
        assert distance(mu, improved).max() < (3e-6 if name in WITH_CONTACT else 1e-10) * max(1.0, np.abs(mu[0]))


def test_error_falls_with_the_third_power_with_contacts():
    problem, u, mu = waveform("backlash")
    full, condensed = [], []
    for harmonics in (16, 32, 64):
        strip, _ = hill_exponents(problem, u, 1.0, harmonics)
        full.append(distance(mu, np.exp(2 * np.pi * strip)).max())
        condensed.append(abs(CondensedHill(problem, u, 1.0, harmonics).multiplier(mu[0]) - mu[0]))
    for errors in (full, condensed):
        assert errors[0] / errors[2] > 0.4 * 4**3
    assert condensed[0] < 0.05 * full[0]  # what is eliminated approximately is worth a hundredfold


def test_gear_pair():
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    u = pack(random_wave(3, 4, 1))
    mu = multipliers(monodromy(problem, [(u, 0.8)]).matrices)[0]
    hill = CondensedHill(problem, u, 0.8, 31)
    assert max(abs(hill.multiplier(m) - m) for m in mu) < 1e-6
    turn = 2 * np.pi / 0.8
    for chosen in hill_exponents(problem, u, 0.8, 12):
        improved = np.exp(np.array([hill.correct(s, 8) for s in chosen]) * turn)
        assert distance(mu, improved).max() < 1e-6


def test_mathieu_on_its_instability_edges():
    """Multipliers 1 and -1 lie on the edges of the strip of the first rule; there are two exponents for each."""
    for a, wanted in zip(rs.MATHIEU_EDGES[1.0][:3], (1.0, -1.0, -1.0), strict=True):
        problem = HarmonicBalance().discretise(rs.mathieu(1.0), "a")
        u = pack(np.zeros((2, 1), dtype=complex))
        for chosen in hill_exponents(problem, u, a, 10):
            # omega = 2 in theta: the period of the coefficients, pi; the exponents are those of a double multiplier
            assert np.abs(np.exp(chosen * np.pi) - wanted).max() < 2e-4


def test_modes_out_of_reach_of_the_port_and_twins():
    """Twin absorbers have a mode that the port never sees, an own oscillator has one that never sees the port."""
    x, v, y, w, z, r, theta, omega = rs.symbols("x", "v", "y", "w", "z", "r", "theta", "omega")
    stop = Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))
    pull = lambda q, dq: 0.3 * (x - q) + 0.02 * (v - dq)  # noqa: E731
    system = System(
        name="twins",
        states={"x": x, "v": v, "y": y, "w": w, "z": z, "r": r},
        derivatives={
            "x": v,
            "v": ca.cos(theta) - (1 + 0.3 * ca.cos(theta)) * stop.force - 0.1 * v - pull(y, w) - pull(z, r),
            "y": w,
            "w": 2 * pull(y, w),
            "z": r,
            "r": 2 * pull(z, r),
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
        contacts=[stop],
    )
    problem = HarmonicBalance().discretise(system, "omega")
    u = pack(random_wave(2, 5, 1))
    mu = multipliers(monodromy(problem, [(u, 1.0)]).matrices)[0]
    hill = CondensedHill(problem, u, 1.0, 31)
    assert max(abs(hill.multiplier(m) - m) for m in mu) < 1e-5
    twin = np.exp(2 * np.pi * np.roots([1, 0.04, 0.6]))  # y - z moves by itself
    assert np.abs(mu[:, None] - twin).min(axis=0).max() < 1e-10


def test_newton_converges_from_afar_and_says_when_it_does_not():
    problem, u, mu = waveform("duffing")
    hill = CondensedHill(problem, u, 1.0, 31)
    exponent = np.log(mu[0]) / (2 * np.pi)
    assert abs(hill.correct(exponent + 0.01 - 0.02j, 8) - exponent) < 1e-12
    assert np.isnan(hill.correct(complex(np.inf, 0.0)))
    assert np.isnan(hill.multiplier(complex(np.nan, 0.0)))


def test_limits_are_told():
    problem, u, _ = waveform("duffing")
    assert hill_matrix(problem, u, 1.0, 3).shape == (14, 14)
    with pytest.raises(ValueError, match="at most 1200 rows, got 1202"):
        hill_matrix(problem, u, 1.0, 300)
    x, v, y, z, theta, omega = rs.symbols("x", "v", "y", "z", "theta", "omega")
    jordan = System(
        name="jordan",
        states={"x": x, "v": v, "y": y, "z": z},
        derivatives={"x": v, "v": ca.cos(theta) - x - x**3 - 0.1 * v, "y": z - y, "z": -z},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0)},
    )
    problem = HarmonicBalance().discretise(jordan, "omega")
    with pytest.raises(ValueError, match="well-conditioned modes"):
        CondensedHill(problem, u, 1.0)


def test_many_multipliers_at_once_are_those_of_one_by_one(monkeypatch):
    """A few at a time, a tiny one and one that is no multiplier among them."""
    problem, u, mu = waveform("duffing")
    points = [(u * size, 1.0 + 0.01 * i) for i, size in enumerate((1.0, 0.3, 0.9, 1.1))]
    asked = [(i, complex(m)) for i in range(4) for m in (*mu, 1e-200, -0.5)]
    one = np.array([CondensedHill(problem, *points[i]).multiplier(m) for i, m in asked])
    for together in (1, 3, 128):
        monkeypatch.setattr(hill, "_ASKED", together)
        found = hill.corrected(problem, points, [None] * 4, asked)
        assert found == pytest.approx(one, rel=1e-11)
    assert hill.corrected(problem, points, [None] * 4, []).size == 0
