"""The 14-state gear as one would write it by hand for speed, without CasADi: for numba, and for NumPy."""

import numpy as np
import pytest
from reference_systems import GEAR, gear

OMEGA = 0.62  # loses contact once in every period
STATE = np.array([1.3, *(-0.04 * s for s in GEAR.directions), *[0.0] * 7])

_S, _M = np.array(GEAR.directions), np.array(GEAR.mass_ratios)
_K, _C = np.array(GEAR.bearing_stiffness), np.array(GEAR.bearing_damping)


def compiled_rate():
    """Return ``rate(theta, z, out)`` compiled by numba; the state is lambda, six bearing coordinates, their rates."""
    numba = pytest.importorskip("numba", reason="numba is not installed: pip install '.[benchmark]'")
    s, m, k, c, xi, a3 = _S, _M, _K, _C, GEAR.mesh_damping_ratio, GEAR.tangential_cosine
    (c1, c2), load = GEAR.stiffness_cosine, GEAR.tangential_cosine * GEAR.torque
    assert gear().defaults["torque"] == GEAR.torque

    @numba.njit
    def rate(theta, z, out):
        lam = z[0]
        f = lam - 1.0 if lam > 1.0 else (lam + 1.0 if lam < -1.0 else 0.0)
        force = (1 + c1 * np.cos(theta) + c2 * np.cos(2 * theta)) * f + 2 * xi * z[7]
        total = load - a3 * a3 * force
        for i in range(6):
            acceleration = -m[i] * s[i] * force - 2 * c[i] * z[8 + i] - k[i] * z[1 + i]
            total += s[i] * acceleration
            out[1 + i] = z[8 + i]
            out[8 + i] = acceleration
        out[0] = z[7]
        out[7] = total

    return rate


def compiled_in_time():
    """Return ``rate(t, z, out)`` at the frequency ratio OMEGA, compiled by numba."""
    rate = compiled_rate()
    numba = pytest.importorskip("numba")
    omega = OMEGA

    @numba.njit
    def in_time(t, z, out):
        rate(omega * t, z, out)

    return in_time


def compiled_march():
    """Return ``march(x, periods, steps, omega)``, classical Runge-Kutta over the corners, compiled by numba."""
    rate = compiled_rate()
    numba = pytest.importorskip("numba")

    @numba.njit
    def march(x, periods, steps, omega):
        z = x.copy()
        k1, k2, k3, k4 = np.empty(14), np.empty(14), np.empty(14), np.empty(14)
        y = np.empty(14)
        h, d = 2 * np.pi / omega / steps, 2 * np.pi / steps
        for _ in range(periods):
            for j in range(steps):
                theta = j * d
                rate(theta, z, k1)
                for i in range(14):
                    y[i] = z[i] + h / 2 * k1[i]
                rate(theta + d / 2, y, k2)
                for i in range(14):
                    y[i] = z[i] + h / 2 * k2[i]
                rate(theta + d / 2, y, k3)
                for i in range(14):
                    y[i] = z[i] + h * k3[i]
                rate(theta + d, y, k4)
                for i in range(14):
                    z[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
        return z

    return march


def numpy_rate():
    """Return the right-hand side in time at the frequency ratio OMEGA, in NumPy, as one would write it for SciPy."""
    s, m, k, c, a3 = _S, _M, _K, _C, GEAR.tangential_cosine
    c1, c2 = GEAR.stiffness_cosine

    def rate(t, z):
        theta, lam = OMEGA * t, z[0]
        f = lam - 1 if lam > 1 else (lam + 1 if lam < -1 else 0.0)
        force = (1 + c1 * np.cos(theta) + c2 * np.cos(2 * theta)) * f + 2 * GEAR.mesh_damping_ratio * z[7]
        acceleration = -m * s * force - 2 * c * z[8:] - k * z[1:7]
        total = a3 * GEAR.torque - a3 * a3 * force + s @ acceleration
        return np.concatenate([z[7:8], z[8:], [total], acceleration])

    return rate
