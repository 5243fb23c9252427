"""Derivatives of bilinear forms of the monodromy matrix that collocation gives, exact for the discretised equations."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from continuation.orbits.collocation_mesh import Mesh, table


class SecondField:
    """Gradients of ``left . f_x right / omega`` by the states and all parameters, at many points."""

    def __init__(self, system: Any) -> None:
        n = len(system.state_names)
        left, right = ca.SX.sym("left", n), ca.SX.sym("right", n)
        omega = system.p[system.parameter_names.index(str(system.frequency))]
        form = ca.dot(left, ca.jtimes(system.derivative, system.x, right)) / omega
        results = [ca.densify(ca.gradient(form, system.x)), ca.densify(ca.gradient(form, system.p))]
        self._function = ca.Function("second", [system.x, system.theta, system.p, left, right], results)

    def __call__(
        self, x: np.ndarray, theta: np.ndarray, p: np.ndarray, left: np.ndarray, right: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (P, n) and (P, q) at x (P, n), theta (P,), p (q,), left and right (P, n)."""
        found: Any = self._function(x.T, theta.reshape(1, -1), p, left.T, right.T)
        return np.array(found[0]).T, np.array(found[1]).T


def form_gradients(
    equations: Any, mesh: Mesh, second: SecondField, u: np.ndarray, p: np.ndarray, v: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient of ``w . M v`` in the unknown (N m n,) and by all parameters (q,).

    The variation that starts from v is carried through the intervals, and the adjoint of w back; what a change of the
    Jacobian does to the product is the sum over the collocation points of their product with it.
    """
    t, n, (N, m) = table(mesh.degree), equations.states, mesh.points().shape
    x, theta, entries = equations.along(mesh, u, p)
    full = np.zeros((N, m, n, n))
    full[..., equations.field.rows, equations.field.columns] = entries
    blocks = -t.value[:, None, :, None] * full[:, :, :, None, :]  # (N, m, n, m+1, n)
    slope = t.slope / (2 * np.pi * equations.multiple * mesh.lengths)[:, None, None]
    blocks[:, :, np.arange(n), :, np.arange(n)] += slope
    blocks = blocks.reshape(N, m * n, (m + 1) * n)
    inner = np.linalg.solve(blocks[..., n:], -blocks[..., :n])  # (N, m n, n): nodes 1..m of an interval by node 0
    local, left = np.empty((N, m + 1, n)), np.empty((N, m, n))
    start, end = np.asarray(v, dtype=float), np.asarray(w, dtype=float)
    for i in range(N):
        local[i, 0], local[i, 1:] = start, (inner[i] @ start).reshape(m, n)
        start = local[i, -1]
    unit = np.zeros((N, m * n))
    for i in range(N - 1, -1, -1):
        unit[i, -n:] = end
        end = inner[i, -n:].T @ end
    left = np.linalg.solve(blocks[..., n:].transpose(0, 2, 1), unit[..., None])[..., 0].reshape(N, m, n)
    right = t.value @ local
    by_x, by_p = second(x, theta, p, left.reshape(-1, n), right.reshape(-1, n))
    nodes = np.zeros((len(mesh.root), n))
    np.add.at(nodes, mesh.index, np.einsum("ck,icn->ikn", t.value, by_x.reshape(N, m, n)))
    return (nodes / mesh.root[:, None]).ravel(), by_p.sum(axis=0)
