"""The numbers of the dimensionless equations (23)-(29), for one pair in one state."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from sbg_casadi.entries import shown
from sbg_casadi.errors import PairError
from sbg_casadi.mesh import fourier_series, stiffness_fault

COORDINATES = ("x_p", "y_p", "z_p", "x_g", "y_g", "z_g")
ONLY_STATE = "only"  # name of the one state of a pair that names none

_POSITIVE = ("torque", "tangential_cosine", "mass_ratios", "bearing_stiffness", "coast_stiffness_ratio")
_NOT_NEGATIVE = ("mesh_damping_ratio", "bearing_damping")
_SIX = ("directions", "mass_ratios", "bearing_stiffness", "bearing_damping")


@dataclass(frozen=True, slots=True)
class Dimensionless:
    """Hold the dimensionless parameters of a pair in one state; lengths are over half the backlash, time is omega_n t.

    Parameters
    ----------
    name, state : str
        Names of the pair and of the state.
    torque : float
        T = F_t / (k_0 b) with F_t the tangential force at the mean pitch radius and b half the backlash, equation (22).
    mesh_damping_ratio : float
        xi = C_m / (2 m_eq omega_n), equation (22).
    tangential_cosine : float
        a3 of equation (11).
    directions : tuple of float, length 6
        s_i = d(lambda)/d(q_i) of equation (19) in the order x_p, y_p, z_p, x_g, y_g, z_g.
    mass_ratios : tuple of float, length 6
        mu_i = m_eq / m_i.
    bearing_stiffness, bearing_damping : tuple of float, length 6
        The barred quantities K_i and C_i of equation (13).
    stiffness_cosine, stiffness_sine : tuple of float, equal lengths
        a_j / k_0 and b_j / k_0 of equation (21).
    error_cosine, error_sine : tuple of float, equal lengths
        Harmonics of the unloaded transmission error e(theta), equation (16), over half the backlash.
    coast_stiffness_ratio : float
        Mesh stiffness of the coast flank over that of the drive flank at the same phase; (20) has 1.

    Raises
    ------
    PairError
        If a number is not finite, a length is wrong, a mass ratio, stiffness, torque or a3 is not positive, a damping
        is negative, or the mesh stiffness reaches zero or below at some phase.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> example = load_pair("example").dimensionless()
    >>> round(example.mean_force, 6), round(float(example.stiffness(0.0)), 6)
    (0.181818, 1.4)
    """

    name: str
    state: str
    torque: float
    mesh_damping_ratio: float
    tangential_cosine: float
    directions: tuple[float, ...]
    mass_ratios: tuple[float, ...]
    bearing_stiffness: tuple[float, ...]
    bearing_damping: tuple[float, ...]
    stiffness_cosine: tuple[float, ...] = ()
    stiffness_sine: tuple[float, ...] = ()
    error_cosine: tuple[float, ...] = ()
    error_sine: tuple[float, ...] = ()
    coast_stiffness_ratio: float = 1.0

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name not in ("name", "state"):
                self._check(item.name, getattr(self, item.name))
        for kind in ("stiffness", "error"):
            cosine, sine = getattr(self, f"{kind}_cosine"), getattr(self, f"{kind}_sine")
            if len(cosine) != len(sine):
                raise PairError(
                    f"{self._place}: {kind}_cosine has {len(cosine)} and {kind}_sine {len(sine)} entries; "
                    "expected equal numbers"
                )
        fault = stiffness_fault(self.stiffness_cosine, self.stiffness_sine)
        if fault:
            raise PairError(
                f"{self._place}: stiffness_cosine = {shown(self.stiffness_cosine)} with stiffness_sine = "
                f"{shown(self.stiffness_sine)} {fault}; expected a mesh stiffness that stays positive"
            )

    @property
    def _place(self) -> str:
        return f"pair {self.name!r}, state {self.state!r}"

    def _check(self, key: str, value: Any) -> None:
        numbers = value if isinstance(value, tuple) else (value,)
        if key in _SIX and len(numbers) != 6:
            raise PairError(f"{self._place}: {key} has {len(numbers)} entries; expected six, {', '.join(COORDINATES)}")
        rules: tuple[tuple[bool, Callable[[float], bool], str], ...] = (
            (True, math.isfinite, "finite"),
            (key in _POSITIVE, lambda v: v > 0, "positive"),
            (key in _NOT_NEGATIVE, lambda v: v >= 0, "zero or positive"),
        )
        for applies, holds, wanted in rules:
            if applies and not all(holds(v) for v in numbers):
                raise PairError(f"{self._place}: {key} = {shown(value)}; expected every number to be {wanted}")

    @property
    def mean_force(self) -> float:
        """Mean mesh force T / a3 over k_0 b, exact for every periodic orbit."""
        return self.torque / self.tangential_cosine

    def stiffness(self, theta: Any) -> np.ndarray:
        """Evaluate K(theta) of equation (21) at phases in radians; shape of theta, mean 1."""
        return 1.0 + fourier_series(self.stiffness_cosine, self.stiffness_sine, theta)

    def error(self, theta: Any) -> np.ndarray:
        """Evaluate e(theta) of equation (16) at phases in radians; shape of theta, in half backlashes."""
        return fourier_series(self.error_cosine, self.error_sine, theta)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON."""
        raw = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: list(v) if isinstance(v, tuple) else v for k, v in raw.items()}
