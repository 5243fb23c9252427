"""Equilibria of autonomous Systems, as far as cycles are born there: the Hopf point at the end of a branch."""

from __future__ import annotations

import casadi as ca
import numpy as np

from continuation.errors import NoConvergence
from continuation.model.system import System

_ITERATIONS = 50


def hopf(system: System, parameter: str, p: np.ndarray, x: np.ndarray, omega: float) -> tuple[float, float]:
    """Return the parameter of the Hopf point near an equilibrium, and its error.

    Parameters
    ----------
    parameter : str
        Name of the parameter that is solved for.
    p : array (q,)
        All parameters near the point.
    x : array (n,)
        Guess of the equilibrium.
    omega : float
        Guess of the imaginary part of the critical eigenvalues.

    Raises
    ------
    NoConvergence
        If Newton's method on ``f = 0``, ``(A - i omega) v = 0``, ``c' v = 1`` does not converge.

    Notes
    -----
    Kuznetsov, Elements of Applied Bifurcation Theory, section 10.2.2. The error is that of the last Newton step.
    """
    n, i = len(x), system.parameter_names.index(parameter)
    v, w, c = ca.SX.sym("v", n), ca.SX.sym("omega"), ca.SX.sym("c", 2 * n)
    u = ca.SX.sym("u", n)  # v + i u is the eigenvector
    f = ca.substitute(system.closed(), system.theta, 0.0)
    A = ca.jacobian(f, system.x)
    conditions = [ca.dot(c[:n], v) + ca.dot(c[n:], u) - 1, ca.dot(c[:n], u) - ca.dot(c[n:], v)]
    residual = ca.vertcat(f, A @ v + w * u, A @ u - w * v, *conditions)
    unknown = ca.vertcat(system.x, v, u, system.p[i], w)
    F = ca.Function("hopf", [system.x, v, u, system.p, w, c], [residual, ca.jacobian(residual, unknown)])
    jacobian = ca.Function("jacobian", [system.x, system.p], [A])
    vector = np.array(p, dtype=float)
    values, modes = np.linalg.eig(np.array(jacobian(x, vector)))
    mode = modes[:, int(np.argmin(np.abs(values - 1j * omega)))]
    mode = mode / np.linalg.norm(mode)
    border = np.concatenate([mode.real, mode.imag])
    state = np.concatenate([x, mode.real, mode.imag, [vector[i], omega]])
    size = np.inf
    for _ in range(_ITERATIONS):
        vector[i] = state[-2]
        value, slope = F(state[:n], state[n : 2 * n], state[2 * n : 3 * n], vector, state[-1], border)
        try:
            step = np.linalg.solve(np.array(slope), -np.array(value).ravel())
        except np.linalg.LinAlgError:
            break
        state, before, size = state + step, size, float(np.abs(step).max())
        if not np.isfinite(size) or size < 1e-13 * (1 + np.abs(state).max()) or (size < 1e-9 and size >= before):
            break
    if not size < 1e-6 * (1 + np.abs(state).max()):
        raise NoConvergence(f"no Hopf point found near {parameter} = {vector[i]:g}", parameter=float(vector[i]))
    return float(state[-2]), max(size, 1e-14 * abs(float(state[-2])))
