"""Right-hand sides beyond a contact change, where a step of an integrator looks before it lands on the change."""

from __future__ import annotations

import casadi as ca
import numpy as np

from continuation.model.system import System

_BESIDE = 1e-3  # size of the contact forces at which a right-hand side is tried
_TRIALS = 3


def extended(system: System, force: ca.SX) -> ca.SX:
    """Return the contact forces (m,) of the current modes so that the right-hand side has a value beyond a change.

    Inside its mode nothing changes. A force that enters by a power, such as ``force**1.5`` of Hertz's contact, is
    negative beyond the end of contact, where the power has no value: where a right-hand side is finite on one side of
    zero only, the absolute value is put in.

    >>> from continuation import Contact
    >>> x, v, g = (ca.SX.sym(n) for n in ("x", "v", "g"))
    >>> ball = Contact(argument=x, breakpoints=(0.0,), slopes=(0.0, 1.0))
    >>> s = System(name="ball", states={"x": x, "v": v}, derivatives={"x": v, "v": g - ball.force**1.5},
    ...            parameters={"g": (g, 1.0)}, contacts=[ball])
    >>> str(extended(s, s.arguments))
    'fabs(x_0)'
    """
    if force.shape[0] == 0:
        return force
    f = ca.Function("f", [system.x, system.phi, system.theta, system.p], [system.derivative])
    out = ca.vertsplit(force)
    for i in range(len(out)):
        below, above = _finite(f, system, i, -_BESIDE), _finite(f, system, i, _BESIDE)
        if below != above:
            out[i] = ca.fabs(out[i]) if above else -ca.fabs(out[i])
    return ca.vertcat(*out)


def _finite(f: ca.Function, system: System, index: int, value: float) -> bool:
    """Tell whether the right-hand side is finite at some state, all contact forces 0 but one."""
    phi = np.zeros(system.phi.shape[0])
    phi[index] = value
    rng = np.random.default_rng(0)
    states = rng.standard_normal((_TRIALS, len(system.state_names)))
    vector = system.parameter_vector()
    return any(bool(np.all(np.isfinite(f(x, phi, 0.3, vector).full()))) for x in states)
