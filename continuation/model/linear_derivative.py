"""How the linear part of a System (A, B, C of its port structure) changes with one parameter, exactly."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

_SAMPLES = 4


class LinearDerivative:
    """Derivatives (dA, dB, dC) of a linear part with respect to one parameter; dA is sparse.

    B and C interpolate samples K of the varying Jacobian from their pivot rows P, ``K = B K[P]``, so that
    ``dB = (dK - B dK[P]) K[P]^+``.
    """

    def __init__(self, ports: Any, index: int) -> None:
        self._ports = ports
        s, constant = ports.system, ca.SX(ports.constant)
        nonzeros: list[Any] = constant.nonzeros()
        entries = ca.vertcat(*nonzeros) if nonzeros else ca.SX.zeros(0, 1)
        self._entries = ca.Function("entries", [s.p], [ca.densify(ca.jacobian(entries, s.p[index]))])
        self._pattern = constant.sparsity()
        parts = ports.sampled_parts()
        changes = [ca.densify(ca.reshape(ca.jacobian(ca.vec(e), s.p[index]), *e.shape)) for e in parts]
        self._still = all(c.is_zero() for c in changes)
        self._changes = ca.Function("changes", [s.x, s.phi, s.theta, s.p], changes)

    def __call__(self, p: np.ndarray) -> tuple[sp.csc_matrix, np.ndarray, np.ndarray]:
        """Return dA (n, n) sparse, dB (n, m), dC (k, n) at the parameters p (q,)."""
        ports = self._ports
        n = len(ports.system.state_names)
        values = np.array(self._entries(p)).ravel()
        dA = sp.csc_matrix((values, self._pattern.row(), self._pattern.colind()), shape=(n, n))
        if self._still:
            return dA, np.zeros((n, ports.inputs)), np.zeros((ports.outputs, n))
        columns, rows = ports.stacks(p, _SAMPLES)
        d_columns, d_rows = ports.stacks(p, _SAMPLES, self._changes)
        chosen = ports.pivots
        dB, dC = _interpolated(columns, d_columns, chosen[0]), _interpolated(rows.T, d_rows.T, chosen[1]).T
        return dA, *ports.port_matrices(dB, dC)


def _interpolated(stack: np.ndarray, change: np.ndarray, pivots: np.ndarray) -> np.ndarray:
    inverse = np.linalg.pinv(stack[pivots], rcond=1e-10)
    return np.asarray((change - stack @ inverse @ change[pivots]) @ inverse)
