"""Receptance of the linear part of a System, seen from its ports, at many complex frequencies at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from continuation.errors import SingularLinearPart
from continuation.model.ports import LinearPart

# Harmonics k >= 1 carry the reference stiffness S (1 + 0.5 i): with this hysteretic part, which the ports take off
# again, no undamped resonance of a mode that the ports reach can meet a harmonic.
_HYSTERESIS = 0.5
_RESONANCE = 1e-13  # relative distance of a harmonic from a pole that counts as resonance
_MODAL_LIMIT = 1e6  # condition number of the modal matrix above which matrices are solved directly


@dataclass(frozen=True, slots=True)
class Receptance:
    """The operator ``M_k = i k omega - A + B S_k C`` of one linear part; build with :func:`receptance`.

    Attributes
    ----------
    part : LinearPart
    poles : complex array (n,), or None where the modal form is ill-conditioned
    modes, modes_inverse : complex arrays (n, n)
    left, right : complex arrays (k, n) and (n, m), C modes and modes^-1 B
    static : array (n, n), the inverse of M_0
    """

    part: LinearPart
    shifted: np.ndarray
    static: np.ndarray
    poles: np.ndarray | None
    modes: np.ndarray
    modes_inverse: np.ndarray
    left: np.ndarray
    right: np.ndarray

    def stiffness(self, k: np.ndarray) -> np.ndarray:
        """Return S_k, shape (K, m, k), for harmonic orders k >= 0."""
        factor = np.where(k == 0, 1.0, 1.0 + 1j * _HYSTERESIS)
        return factor[:, None, None] * self.part.S

    def solve(self, s: np.ndarray, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M(s)^-power b`` for s (K,), all nonzero, and b (K, n, c) or (n, c); shape (K, n, c)."""
        if self.poles is not None:
            gain = 1.0 / (s[:, None] - self.poles) ** power
            return self.modes @ (gain[..., None] * (self.modes_inverse @ b))
        matrix = s[:, None, None] * np.eye(len(self.shifted)) - self.shifted
        x = np.broadcast_to(b, (len(s), *b.shape[-2:]))
        for _ in range(power):
            x = np.linalg.solve(matrix, x)
        return x

    def ports(self, s: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power B`` for s (K,), all nonzero; shape (K, k, m). Cost O(K n k m) in modal form."""
        part = self.part
        if self.poles is None:
            return part.C @ self.solve(s, part.B, power)
        left, right = self.left, self.right
        gap = s[:, None] - self.poles
        if np.any(np.abs(gap) <= _RESONANCE * np.abs(s[:, None])):
            raise SingularLinearPart(
                f"an undamped mode that no nonlinear port reaches resonates at {np.abs(s).min():.6g} rad per unit time "
                "or a harmonic of it, so no periodic orbit exists; add damping or move the frequency"
            )
        gain = 1.0 / gap
        if power != 1:
            gain **= power
        if left.shape[0] == 1 and right.shape[1] == 1:
            return (gain @ (left[0] * right[:, 0]))[:, None, None]
        return (left * gain[:, None, :]) @ right


def receptance(part: LinearPart) -> Receptance:
    """Build the receptance of a linear part.

    Raises
    ------
    SingularLinearPart
        If a rigid-body mode is out of reach of every port, so that no static equilibrium exists.
    """
    A, B, C, S = part.A, part.B, part.C, part.S
    at_rest = -A + B @ S @ C
    balanced = sl.matrix_balance(at_rest, permute=False)[0]  # units must not look like a rigid body
    values = np.linalg.svd(balanced, compute_uv=False)
    if not values[-1] > 1e-13 * values[0]:
        raise SingularLinearPart(
            "the linear part has a rigid-body mode that no nonlinear port reaches, so no unique periodic orbit exists; "
            "use a relative coordinate or ground the mode with a stiffness"
        )
    shifted = A - (1.0 + 1j * _HYSTERESIS) * (B @ S @ C)
    poles, modes = np.linalg.eig(shifted)
    inverse = modes
    modal = np.linalg.cond(modes) < _MODAL_LIMIT
    if modal:
        inverse = np.linalg.inv(modes)
    static = np.linalg.inv(at_rest)
    return Receptance(part, shifted, static, poles if modal else None, modes, inverse, C @ modes, inverse @ B)
