"""Closed-form contact coefficients against quadrature, and contact changes that no sample would show."""

import itertools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial.legendre import leggauss

from continuation import Contact
from continuation.orbits.contact_series import evaluate, find_pattern, modulate, piecewise_spectrum

DEAD_ZONE = Contact(argument=ca.SX.sym("x"), breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))
STEPPED = Contact(argument=ca.SX.sym("x"), breakpoints=(-0.5, 0.3, 1.2), slopes=(2.0, 0.1, -0.4, 1.5))


def force_spectrum(contact, argument, last):
    """Half spectrum of the force from slope and intercept coefficients, as the engine composes it."""
    pattern = find_pattern(argument, contact)
    slope = piecewise_spectrum(pattern, np.array(contact.slopes), last + len(argument) - 1)
    shift = piecewise_spectrum(pattern, contact.intercepts, last)
    both = np.concatenate([argument[:0:-1].conj(), argument])
    return (np.convolve(slope, both, mode="valid") + shift)[last:]


def by_quadrature(contact, argument, last, pieces):
    """Gauss quadrature with 60 points between each two of the given phases."""
    x, w = leggauss(60)
    total = np.zeros(last + 1, dtype=complex)
    for a, b in itertools.pairwise(pieces):
        t = (a + b) / 2 + (b - a) / 2 * x
        force = contact.value(evaluate(argument, t))
        total += np.exp(-1j * np.outer(np.arange(last + 1), t)) @ (force * w) * (b - a) / (4 * np.pi)
    return total


def test_dead_zone_of_a_known_wave():
    """x = 0.4 + 1.5 cos t + 0.3 cos(3 t + 0.4); uniform samples err by 3.2e-4 with 64 and 9.6e-7 with 1024."""
    argument = np.array([0.4, 0.75, 0, 0.15 * np.exp(0.4j)])
    exact = force_spectrum(DEAD_ZONE, argument, 6)

    def sampled(count):
        t = 2 * np.pi * np.arange(count) / count
        return np.fft.rfft(DEAD_ZONE.value(evaluate(argument, t)))[:7] / count

    assert np.abs(sampled(64) - exact)[1:].max() == pytest.approx(3.2e-4, rel=0.05)
    assert np.abs(sampled(1024) - exact)[1:].max() == pytest.approx(9.6e-7, rel=0.05)
    changes = np.concatenate([[0], find_pattern(argument, DEAD_ZONE).phases, [2 * np.pi]])
    assert exact == pytest.approx(by_quadrature(DEAD_ZONE, argument, 6, changes), abs=1e-14)


@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from([DEAD_ZONE, STEPPED]))
def test_any_wave_against_fine_sampling(seed, H, contact):
    rng = np.random.default_rng(seed)
    argument = (rng.standard_normal(H + 1) + 1j * rng.standard_normal(H + 1)) / (1 + np.arange(H + 1))
    argument[0] = argument[0].real
    count = 1 << 14
    t = 2 * np.pi * np.arange(count) / count
    fine = np.fft.rfft(contact.value(evaluate(argument, t)))[:13] / count
    assert np.abs(force_spectrum(contact, argument, 12) - fine).max() < 3e-6  # error of the samples, about N^-2


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-10])
def test_contact_shorter_than_a_sample_is_found(depth):
    """cos(t - 0.1234) touches the breakpoint for 2 acos(1 - depth), between samples."""
    argument = np.array([0.0, (1 + depth) / 2 * np.exp(-0.1234j)])
    pattern = find_pattern(argument, DEAD_ZONE)
    half = np.arccos(1 / (1 + depth))
    wanted = 0.1234 + np.array([-half, half, np.pi - half, np.pi + half])
    assert pattern.phases == pytest.approx(wanted, abs=1e-9)
    assert pattern.modes[[0, -1]].tolist() in ([1, 1], [2, 2])
    assert sorted(set(pattern.modes.tolist())) == [0, 1, 2]


def test_contact_at_phase_zero_closes_the_period():
    pattern = find_pattern(np.array([0.9, 0.5]), DEAD_ZONE)  # 0.9 + cos t, in contact around phase 0
    edge = np.arccos(0.1)
    assert pattern.phases == pytest.approx([edge, 2 * np.pi - edge], abs=1e-12)
    assert pattern.modes.tolist() == [2, 1, 2]


@pytest.mark.parametrize(("mean", "mode"), [(0.0, 1), (3.0, 2), (-3.0, 0)])
def test_no_change(mean, mode):
    pattern = find_pattern(np.array([mean, 0.25]), DEAD_ZONE)
    assert pattern.phases.size == 0
    assert pattern.modes.tolist() == [mode]
    assert piecewise_spectrum(pattern, np.array([1.0, 2.0, 3.0]), 2).real.tolist() == [0, 0, mode + 1.0, 0, 0]


def test_jump_through_the_whole_dead_zone():
    argument = np.array([0.0, 50.0])
    pattern = find_pattern(argument, DEAD_ZONE)
    edge = np.arccos(0.01)
    assert pattern.phases == pytest.approx([edge, np.pi - edge, np.pi + edge, 2 * np.pi - edge], abs=1e-12)
    assert pattern.modes.tolist() == [2, 1, 0, 1, 2]


def test_gain_of_another_period_multiplies():
    rng = np.random.default_rng(0)
    half = rng.standard_normal(8) + 1j * rng.standard_normal(8)
    half[0] = 1.0
    gain = np.array([1.0, 0.2 + 0.1j])
    product = modulate(np.concatenate([half[:0:-1].conj(), half]), gain, 2)
    t = 2 * np.pi * np.arange(64) / 64
    wave = evaluate(half, t) * (1 + 2 * ((0.2 + 0.1j) * np.exp(2j * t)).real)
    assert product[len(product) // 2 :] == pytest.approx((np.fft.rfft(wave) / 64)[:6], abs=1e-13)


def test_derivatives_of_a_polynomial():
    c, t, h = np.array([0.3, 0.5 - 0.2j, 0.1j]), np.array([0.4, 2.0]), 1e-5
    first = (evaluate(c, t + h) - evaluate(c, t - h)) / (2 * h)
    assert evaluate(c, t, 1) == pytest.approx(first, abs=1e-9)
    second = (evaluate(c, t + h, 1) - evaluate(c, t - h, 1)) / (2 * h)
    assert evaluate(c, t, 2) == pytest.approx(second, abs=1e-9)


def wave_of_roots(roots, scale):
    """Half spectrum of scale * prod 2 sin((t - r) / 2) over an even number of roots."""
    factor = np.array([1.0 + 0j])
    for r in roots:  # -i exp(i (t - r) / 2) + i exp(-i (t - r) / 2), a polynomial in exp(i t) but for half an order
        factor = np.convolve(factor, [1j * np.exp(0.5j * r), -1j * np.exp(-0.5j * r)])
    return scale * factor[len(roots) // 2 :]


@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from([0.3, 1e-2, 1e-4, 1e-6]))
def test_every_root_of_a_wave_made_of_its_roots_is_found(seed, pairs, gap):
    """Pairs of contact changes as close as 1e-6 rad: each is found, at the accuracy that so close a pair allows."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(0, 2 * np.pi, pairs))
    distances = np.diff(np.append(at, at[0] + 2 * np.pi))
    if distances.min() < 4 * gap + 0.05:
        return
    roots = np.concatenate([at, at + gap])
    wave = wave_of_roots(roots, 1.0)
    wave /= np.abs(wave).max()
    contact = Contact(argument=ca.SX.sym("x"), breakpoints=(0.0,), slopes=(0.0, 1.0))
    slope = np.abs(evaluate(wave, roots, 1)).min()
    if slope * gap < 5e-13:  # the wave dips below the level by less than rounding
        return
    found = find_pattern(wave, contact)
    wanted = np.sort(np.mod(roots, 2 * np.pi))
    assert found.phases.size == wanted.size
    assert np.abs(found.phases - wanted).max() < 1e-9 + 1e-14 / slope
    middle = (found.phases + np.append(found.phases[1:], found.phases[0] + 2 * np.pi)) / 2
    assert found.modes[1:].tolist() == contact.mode(evaluate(wave, middle)).tolist()
