"""The equations of a pair with every dimensionless number as a parameter, so that one System serves all candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import casadi as ca
import numpy as np

from continuation import System
from sbg_casadi.dimensionless import COORDINATES, Dimensionless
from sbg_casadi.model import pair_system
from sbg_casadi.reading import CONSISTENT

SCALARS = ("torque", "mesh_damping_ratio", "tangential_cosine")
SIXES = ("directions", "mass_ratios", "bearing_stiffness", "bearing_damping")
SERIES = ("stiffness_cosine", "stiffness_sine", "error_cosine", "error_sine")


@dataclass(frozen=True, slots=True)
class _Symbols:
    """Stand for a :class:`Dimensionless` whose numbers are symbols, in :func:`~sbg_casadi.model.pair_system`."""

    name: str
    state: str
    coast_stiffness_ratio: float
    tangential_cosine: ca.SX
    directions: tuple[ca.SX, ...]
    mass_ratios: tuple[ca.SX, ...]
    bearing_stiffness: tuple[ca.SX, ...]
    bearing_damping: tuple[ca.SX, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Parametric:
    """Hold the System of a pair with all of its numbers as parameters.

    Attributes
    ----------
    system : System
        States and equations of :func:`~sbg_casadi.model.gear_system`; its parameters are ``frequency_ratio`` and
        ``names``.
    names : tuple of str
        Parameters that follow from a :class:`Dimensionless`, in the order of :meth:`numbers`.
    harmonics : tuple of int
        Number of harmonics of stiffness and of error.
    coast : float
        Stiffness of the coast flank, which is a slope of the contact law and no parameter.
    """

    system: System
    names: tuple[str, ...]
    harmonics: tuple[int, int]
    coast: float

    def numbers(self, d: Dimensionless) -> np.ndarray:
        """Return the values (len(names),) of a pair.

        Raises
        ------
        ValueError
            If it has more harmonics, or another stiffness of the coast flank, than the System.
        """
        if d.coast_stiffness_ratio != self.coast:
            raise ValueError(f"coast_stiffness_ratio: expected {self.coast:g}, got {d.coast_stiffness_ratio:g}")
        values: list[float] = [getattr(d, name) for name in SCALARS]
        for name in SIXES:
            values += getattr(d, name)
        for name in SERIES:
            given, wanted = getattr(d, name), self.harmonics[0 if name.startswith("stiffness") else 1]
            if len(given) > wanted:
                raise ValueError(f"{name}: expected at most {wanted} harmonics, got {len(given)}")
            values += [*given, *[0.0] * (wanted - len(given))]
        return np.array(values, dtype=float)

    def vector(self, d: Dimensionless, ratio: float) -> np.ndarray:
        """Return all parameters of the System in order, at a frequency ratio."""
        return np.concatenate([[ratio], self.numbers(d)])

    def values(self, d: Dimensionless) -> dict[str, float]:
        """Return the parameters of a pair by name, without the frequency ratio."""
        return dict(zip(self.names, self.numbers(d).tolist(), strict=True))


def parametric(base: Dimensionless, stiffness_harmonics: int, error_harmonics: int = 0) -> Parametric:
    """Build the equations of a pair with all of its numbers as parameters.

    Parameters
    ----------
    base : Dimensionless
        Default values, names and the stiffness of the coast flank.
    stiffness_harmonics, error_harmonics : int
        Number of harmonics that the parameters hold, at least those of ``base``.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> found = parametric(load_pair("example").dimensionless(), 2)
    >>> len(found.names), found.names[:2], found.names[-4:]
    (31, ('torque', 'mesh_damping_ratio'), ('stiffness_cosine_1', 'stiffness_cosine_2', 'stiffness_sine_1', \
'stiffness_sine_2'))
    """
    names: list[str] = [*SCALARS]
    for group in SIXES:
        names += [f"{group}_{q}" for q in COORDINATES]
    for group in SERIES:
        count = stiffness_harmonics if group.startswith("stiffness") else error_harmonics
        names += [f"{group}_{j}" for j in range(1, count + 1)]
    symbols = {name: ca.SX.sym(name) for name in names}
    blank = Parametric(
        cast(Any, None), tuple(names), (stiffness_harmonics, error_harmonics), base.coast_stiffness_ratio
    )
    defaults = blank.values(base)
    parameters = {"frequency_ratio": (ca.SX.sym("frequency_ratio"), 1.0)}
    parameters |= {name: (symbols[name], defaults[name]) for name in names}
    sixes = {group: tuple(symbols[f"{group}_{q}"] for q in COORDINATES) for group in SIXES}
    stand_in = _Symbols(
        base.name, base.state, base.coast_stiffness_ratio, symbols["tangential_cosine"], **cast(Any, sixes)
    )
    theta = ca.SX.sym("theta")
    stiffness = 1 + _series(symbols, "stiffness", stiffness_harmonics, theta)
    error = _series(symbols, "error", error_harmonics, theta)
    system = pair_system(cast(Dimensionless, stand_in), CONSISTENT, theta, stiffness, error, parameters)
    return Parametric(system, blank.names, blank.harmonics, blank.coast)


def _series(symbols: dict[str, ca.SX], kind: str, count: int, theta: ca.SX) -> ca.SX:
    total = ca.SX(0)
    for j in range(1, count + 1):
        total += symbols[f"{kind}_cosine_{j}"] * ca.cos(j * theta) + symbols[f"{kind}_sine_{j}"] * ca.sin(j * theta)
    return total
