"""A backlash oscillator at the end of a chain of linear coordinates: System, matrix, and an exact check of orbits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import scipy.sparse as sp
from scipy.optimize import brentq

from continuation import Contact, Orbit, System

GROUND, COUPLING = 0.1, 1.0  # stiffness of every coordinate to the ground and to its neighbour; all masses are 1
MEAN, AMPLITUDE, VARIATION = 0.3, 0.2, 0.2  # load of the first coordinate, harmonic of its mesh stiffness


def laplacian(n: int) -> sp.csc_array:
    """Return the matrix (n, n) of unit springs between neighbours."""
    diagonal = np.full(n, 2.0)
    diagonal[0] -= 1.0
    diagonal[-1] -= 1.0
    return sp.csc_array(sp.diags_array([diagonal, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1], shape=(n, n)))


def chain(n: int, damping: float = 0.02) -> System:
    """Coordinates 0..n-1; the first has ``(1 + 0.2 cos theta)`` times a dead zone and the load ``0.3 + g cos theta``.

    A mode of frequency w has the damping ratio ``damping (w / 2 + GROUND / (2 w))``, about one to two times
    ``damping / 2`` in the band 0.32 to 2.02; ``stiffness`` scales the coupling.
    """
    theta, omega, g, k = (ca.SX.sym(s) for s in ("theta", "omega", "g", "stiffness"))
    x, v = ca.SX.sym("x", n), ca.SX.sym("v", n)
    mesh = Contact(argument=x[0], breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))
    coupling = ca.DM(sp.csc_matrix(laplacian(n))) if n > 1 else ca.DM(1, 1)
    rate = -GROUND * (x + 2 * damping * v) - k * COUPLING * (coupling @ (x + damping * v))
    rate[0] += MEAN + g * ca.cos(theta) - (1 + VARIATION * ca.cos(theta)) * mesh.force
    names = [f"x{i}" for i in range(n)], [f"v{i}" for i in range(n)]
    return System(
        name=f"chain of {n}",
        states=dict(zip(names[0], ca.vertsplit(x), strict=True)) | dict(zip(names[1], ca.vertsplit(v), strict=True)),
        derivatives=dict(zip(names[0], ca.vertsplit(v), strict=True))
        | dict(zip(names[1], ca.vertsplit(rate), strict=True)),
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.7), "g": (g, AMPLITUDE), "stiffness": (k, 1.0)},
        contacts=[mesh],
    )


def matrix(n: int, damping: float = 0.02) -> sp.csc_array:
    """Return the matrix (2n, 2n) of the chain without its contact, states x0.., v0..; written independently."""
    stiff = GROUND * sp.eye_array(n) + COUPLING * laplacian(n)
    damp = damping * (2 * GROUND * sp.eye_array(n) + COUPLING * laplacian(n))
    return sp.csc_array(sp.block_array([[None, sp.eye_array(n)], [-stiff, -damp]]))


def defect(orbit: Orbit, damping: float = 0.02) -> float:
    """Return by how much the state harmonics of an orbit miss the equations of motion, relative to the largest term.

    The contact force is integrated by Gauss quadrature between the roots of its argument: nothing of the engine.
    """
    X, omega = np.asarray(orbit.coefficients), 2 * np.pi / orbit.period
    n, orders = X.shape[1] // 2, np.arange(len(X))
    A = matrix(n, damping)

    def argument(t: np.ndarray) -> np.ndarray:
        return np.asarray((np.exp(1j * np.multiply.outer(t, orders)) @ (X[:, 0] * np.where(orders == 0, 1, 2))).real)

    grid = np.linspace(0, 2 * np.pi, 8193)
    corners = [0.0, 2 * np.pi]
    for level in (-1.0, 1.0):
        side = argument(grid) - level
        for i in np.flatnonzero(side[1:] * side[:-1] < 0):
            corners.append(brentq(lambda t, c=level: argument(np.array([t]))[0] - c, grid[i], grid[i + 1], xtol=1e-15))
    edges = np.unique(np.concatenate([corners, np.linspace(0, 2 * np.pi, 129)]))
    nodes, weights = np.polynomial.legendre.leggauss(12)
    t = (edges[:-1, None] + np.diff(edges)[:, None] * (nodes + 1) / 2).ravel()
    w = (np.diff(edges)[:, None] * weights / 2).ravel() / (2 * np.pi)
    y = argument(t)
    load = MEAN + AMPLITUDE * np.cos(t) - (1 + VARIATION * np.cos(t)) * (y - np.clip(y, -1.0, 1.0))
    force = np.zeros_like(X)
    force[:, n] = np.exp(-1j * np.multiply.outer(orders, t)) @ (w * load)
    rate = 1j * omega * orders[:, None] * X
    return float(np.abs(rate - (A @ X.T).T - force).max() / np.abs(force).max())
