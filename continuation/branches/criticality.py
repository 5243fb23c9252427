"""What is known of a bifurcation beyond its place: critical eigenvector, direction, rotation number."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Criticality = Literal["", "supercritical", "subcritical", "undetermined"]
STRONG = {"1:1": 0.0, "1:2": 0.5, "1:3": 1 / 3, "1:4": 0.25}


@dataclass(frozen=True, slots=True, eq=False)
class NormalForm:
    """Normal form of the map over one period of the orbit, at a fold, period-doubling or Neimark-Sacker point.

    Attributes
    ----------
    coefficient : float
        a of ``xi + a xi^2`` at a fold (its sign depends on that of the eigenvector), c of ``-xi + c xi^3`` at a
        period-doubling, Re d of ``exp(2 pi i nu) xi (1 + d |xi|^2)`` at a Neimark-Sacker point, for an eigenvector of
        length 1. NaN where it is not computed.
    error : float
        Estimated error of it.
    criticality : str
        "supercritical" (the new orbits are stable where the old one is not), "subcritical", or "undetermined"; empty
        for folds.
    reason : str
        Why it is undetermined.
    null_vector : array (n,)
        Critical eigenvector v of the monodromy matrix at phase 0, of length 1; complex at a Neimark-Sacker point.
    rotation_number : float
        Angle of the critical multiplier over 2 pi, in (0, 1/2); NaN but at Neimark-Sacker points.
    left_vector : array (n,)
        Left eigenvector w, ``w* M = mu w*``, of length 1, turned so that ``w* v`` is positive: what a push in a state
        does to the critical motion is proportional to its entry. Empty at folds of autonomous Systems.
    """

    coefficient: float = np.nan
    error: float = np.nan
    criticality: Criticality = ""
    reason: str = ""
    null_vector: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)
    rotation_number: float = np.nan
    left_vector: np.ndarray = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def resonance(self) -> tuple[str, float]:
        """Nearest strong resonance of a torus, "1:1" to "1:4", and the distance of the rotation number from it."""
        return nearest_resonance(self.rotation_number)

    def __str__(self) -> str:
        words = [f"{self.criticality} ({self.reason})" if self.reason and self.criticality else self.criticality]
        if np.isfinite(self.rotation_number):
            name, distance = self.resonance
            words.append(f"rotation {self.rotation_number:.6f} ({name} at {distance:.2g})")
        return ", ".join(w for w in words if w)


def nearest_resonance(nu: float) -> tuple[str, float]:
    """Return the strong resonance nearest to a rotation number in [0, 1/2] and its distance.

    >>> nearest_resonance(0.26)
    ('1:4', 0.01)
    """
    name = min(STRONG, key=lambda k: abs(STRONG[k] - nu))
    return name, round(abs(STRONG[name] - nu), 15)
