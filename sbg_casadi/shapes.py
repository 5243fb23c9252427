"""Mesh stiffness as a rounded trapezoid, for pairs whose stiffness nobody has measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sbg_casadi.errors import PairError
from sbg_casadi.mesh import peak_to_peak


@dataclass(frozen=True, slots=True)
class StiffnessShape:
    """Describe one mesh cycle of K(theta): a plateau while one more pair of teeth carries, a valley otherwise.

    Parameters
    ----------
    contact_ratio : float
        Total contact ratio, above 1 and not whole; its fractional part is the share of the cycle on the plateau.
    peak_to_peak : float
        Maximum minus minimum of the truncated series over the mean, before a modification.
    modification : float
        Factor on the fluctuation that a tooth modification leaves, 1 for none.
    rounding : float
        Width of the rise and of the fall as a share of the mesh cycle, above 0, up to 1; both have continuous slopes.

    Notes
    -----
    A rectangle convolved twice with a box of half the rounding: its harmonics are known in closed form,
    ``a_j ~ sin(pi j d) / j * sinc(j rounding / 2)^2`` with d the share of the plateau, so nothing is sampled.
    The middle of the plateau is at mesh phase 0, which leaves no sine terms.

    Examples
    --------
    >>> cosine, sine = StiffnessShape(contact_ratio=2.4, peak_to_peak=0.2).coefficients(4)
    >>> [round(c, 4) for c in cosine], sine
    ([0.1106, 0.0309, -0.0174, -0.0164], (0.0, 0.0, 0.0, 0.0))
    """

    contact_ratio: float
    peak_to_peak: float
    modification: float = 1.0
    rounding: float = 0.2

    def coefficients(self, harmonics: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the harmonics 1 to ``harmonics`` of the stiffness over its mean, cosines and sines.

        The series as truncated spans ``peak_to_peak * modification``, whatever the number of harmonics.

        Raises
        ------
        PairError
            If the shape has no fluctuation in these harmonics, because the contact ratio is whole.
        """
        share = self.contact_ratio - math.floor(self.contact_ratio)
        j = np.arange(1, harmonics + 1)
        cosine = np.sin(math.pi * j * share) / j * np.sinc(j * self.rounding / 2) ** 2
        largest = float(np.max(np.abs(cosine)))
        if largest < 1e-9:
            raise PairError(
                f"contact_ratio = {self.contact_ratio:g} leaves no fluctuation, the number of carrying pairs of teeth "
                "never changes; expected a contact ratio that is not whole, such as 2.4"
            )
        cosine = np.where(np.abs(cosine) < 1e-14 * largest, 0.0, cosine / largest)  # sin(pi) is not quite zero
        zeros = (0.0,) * harmonics
        cosine *= self.peak_to_peak * self.modification / peak_to_peak(tuple(cosine.tolist()), zeros)
        return tuple(cosine.tolist()), zeros
