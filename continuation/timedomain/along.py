"""Contact changes, contact arguments and outputs along states that an integrator left."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from continuation.model.system import System


def crossings(system: System, states: np.ndarray, grid: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the contact changes on the cubic Hermite interpolants of the contact arguments."""
    found = []
    values, _, rates = arguments(system, states, grid, p)
    for i, contact in enumerate(system.contacts):
        for b in contact.breakpoints:
            below = values[:, i] - b < 0
            curve = CubicHermiteSpline(grid, values[:, i] - b, rates[:, i])
            for j in np.flatnonzero(below[:-1] != below[1:]):
                roots = CubicHermiteSpline(grid[j : j + 2], curve(grid[j : j + 2]), curve(grid[j : j + 2], 1)).roots()
                inside = roots[(roots >= grid[j]) & (roots <= grid[j + 1])]
                found += [(float(inside[0]) if len(inside) else grid[j], i, 1 if below[j] else -1)]
    return np.array(sorted(found), dtype=float).reshape(-1, 3)


def arguments(
    system: System, states: np.ndarray, phases: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return contact arguments (k, m), pieces of the first state (m,), and rates of the arguments by phase (k, m)."""
    omega = ca.SX(1) if system.frequency is None else system.p[system.parameter_names.index(system.frequency)]
    along = ca.jtimes(system.arguments, system.x, system.closed() / omega)
    rate = along + (0 if system.frequency is None else ca.jacobian(system.arguments, system.theta))
    f = ca.Function("arguments", [system.x, system.theta, system.p], [system.arguments, rate])
    values, rates = (r.full().T for r in f(states.T, phases[None], p))
    pieces = [int(c.mode(a)) for c, a in zip(system.contacts, values[0], strict=True)]
    return values, np.array(pieces, dtype=int), rates


def outputs(system: System, states: np.ndarray, phases: np.ndarray, p: np.ndarray) -> dict[str, np.ndarray]:
    """Return the outputs (k,) of the System with the exact contact laws."""
    if not system.output_names:
        return {}
    law = ca.substitute(system.outputs, system.phi, system.forces()) if system.contacts else system.outputs
    f = ca.Function("outputs", [system.x, system.theta, system.p], [law])
    return dict(zip(system.output_names, f(states.T, phases[None], p).full(), strict=True))
