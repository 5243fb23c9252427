"""Receptance of the linear part of a System, seen from its ports, at many complex frequencies at once.

Few states: one eigendecomposition, then every frequency costs a sum over the modes. Many states (a sparse linear part):
module ``receptance_sparse``. Both answer the same calls.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np

from continuation.errors import SingularLinearPart
from continuation.model.linear_part import LinearPart, conditioning
from continuation.model.recent import Recent
from continuation.orbits.receptance_sparse import HYSTERESIS, RIGID, RIGID_BODY, SparseReceptance

_RESONANCE = 1e-13  # relative distance of a harmonic from a pole that counts as resonance
_MODAL_LIMIT = 1e6  # condition number of the modal matrix above which matrices are solved directly


class Receptance(Protocol):
    """The operator ``M_k = i k omega - A + B S_k C`` of one linear part; build with :func:`receptance`."""

    @property
    def part(self) -> LinearPart:
        """The linear part it is of."""
        ...

    @property
    def rest_ports(self) -> np.ndarray:
        """``C M_0^-1 B`` (k, m)."""
        ...

    @property
    def rest_outputs(self) -> np.ndarray:
        """``C M_0^-1`` (k, n)."""
        ...

    @property
    def error(self) -> float:
        """Stated error of :meth:`ports` and :meth:`seen` relative to their values; 0 where it is rounding."""
        ...

    def stiffness(self, k: np.ndarray) -> np.ndarray:
        """Return S_k, shape (K, m, k), for harmonic orders k >= 0."""
        ...

    def ports(self, s: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power B`` for s (K,), all nonzero; shape (K, k, m)."""
        ...

    def seen(self, s: np.ndarray, load: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power load`` for s (K,), all nonzero, and load (K, n); shape (K, k)."""
        ...

    def solve(self, s: np.ndarray, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M(s)^-power b`` for s (K,), all nonzero, and b (K, n, c) or (n, c); shape (K, n, c)."""
        ...

    def at_rest(self, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M_0^-power b`` for b (n,)."""
        ...

    def doubt(self, s: np.ndarray, port_load: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return the stated error (K, k) of ``C M(s)^-1 (B port_load + load)``, loads (K, m) and (K, n)."""
        ...


@dataclass(frozen=True, slots=True)
class ModalReceptance:
    """Receptance of a dense linear part in modal form.

    Attributes
    ----------
    part : LinearPart
    poles : complex array (n,), or None where the modal form is ill-conditioned
    modes, modes_inverse : complex arrays (n, n)
    left, right : complex arrays (k, n) and (n, m), C modes and modes^-1 B
    static : array (n, n), the inverse of M_0
    rest_ports, rest_outputs : arrays (k, m) and (k, n), C M_0^-1 B and C M_0^-1
    least_damping : float, smallest distance of a pole from the imaginary axis
    error : float, 0: nothing but rounding
    """

    part: LinearPart
    shifted: np.ndarray
    static: np.ndarray
    poles: np.ndarray | None
    modes: np.ndarray
    modes_inverse: np.ndarray
    left: np.ndarray
    right: np.ndarray
    rest_ports: np.ndarray
    rest_outputs: np.ndarray
    least_damping: float
    _gains: Recent[np.ndarray] = field(default_factory=lambda: Recent(2), repr=False)
    error: ClassVar[float] = 0.0

    def stiffness(self, k: np.ndarray) -> np.ndarray:
        """Return S_k, shape (K, m, k), for harmonic orders k >= 0."""
        factor = np.where(k == 0, 1.0, 1.0 + 1j * HYSTERESIS)
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

    def seen(self, s: np.ndarray, load: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power load`` for s (K,), all nonzero, and load (K, n); shape (K, k)."""
        if self.poles is None:
            return self.solve(s, load[..., None], power)[..., 0] @ self.part.C.T
        return ((load @ self.modes_inverse.T) / (s[:, None] - self.poles) ** power) @ self.left.T

    def at_rest(self, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M_0^-power b`` for b (n,)."""
        for _ in range(power):
            b = self.static @ b
        return b

    def doubt(self, s: np.ndarray, port_load: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return zeros (K, k): nothing is approximated."""
        return np.zeros((len(s), len(self.part.C)))

    def ports(self, s: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power B`` for s (K,), all nonzero; shape (K, k, m). Cost O(K n k m) in modal form."""
        part = self.part
        if self.poles is None:
            return part.C @ self.solve(s, part.B, power)
        left, right = self.left, self.right
        gain = self._gains.get(s.tobytes(), lambda: self._gain(s))  # power 2 is asked for after power 1
        if power != 1:
            gain = gain**power
        if left.shape[0] == 1 and right.shape[1] == 1:
            return (gain @ (left[0] * right[:, 0]))[:, None, None]
        return (left * gain[:, None, :]) @ right

    def _gain(self, s: np.ndarray) -> np.ndarray:
        """Return 1 / (s - poles), shape (K, n)."""
        gap = s[:, None] - self.poles
        if self.least_damping <= _RESONANCE * np.abs(s[-1]) and np.any(np.abs(gap) <= _RESONANCE * np.abs(s[:, None])):
            raise SingularLinearPart(
                f"an undamped mode that no nonlinear port reaches resonates at {np.abs(s).min():.6g} rad per unit time "
                "or a harmonic of it, so no periodic orbit exists; add damping or move the frequency"
            )
        return 1.0 / gap


def receptance(part: LinearPart, forcing: np.ndarray | None = None, reduce: bool = True) -> Receptance:
    """Build the receptance of a linear part.

    Parameters
    ----------
    forcing : complex array (J+1, n), optional
        Fourier coefficients of what drives the states, whose response at the ports is asked for often.
    reduce : bool
        Whether a sparse linear part may be replaced, at its ports, by a rational approximation with a stated error;
        worth it only where many frequencies are asked of the same linear part.

    Raises
    ------
    SingularLinearPart
        If a rigid-body mode is out of reach of every port, so that no static equilibrium exists.
    """
    if part.sparse:
        return SparseReceptance(part, forcing, reduce)
    B, C = part.B, part.C
    at_rest = -part.shifted()
    if not conditioning(at_rest) > RIGID:  # balanced: units must not look like a rigid body
        raise SingularLinearPart(RIGID_BODY)
    shifted = part.shifted(1.0 + 1j * HYSTERESIS)
    poles, modes = np.linalg.eig(shifted)
    inverse = modes
    modal = np.linalg.cond(modes) < _MODAL_LIMIT
    if modal:
        inverse = np.linalg.inv(modes)
    static = np.linalg.inv(at_rest)
    return ModalReceptance(
        part, shifted, static, poles if modal else None, modes, inverse, C @ modes, inverse @ B,
        C @ static @ B, C @ static, float(np.abs(poles.real).min()),
    )  # fmt: skip
