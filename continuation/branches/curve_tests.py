"""Test functions of points of codimension two on tracked curves.

With the monodromy matrix M of a point, with chi(z) = det(z I - M), and of the normal form:

    on a fold curve        1:1  chi'(1),    fold-flip  chi(-1),   cusp                 a chi'(1)
    on a doubling curve    1:2  chi'(-1),   fold-flip  chi(1),    generalised-doubling c chi'(-1)
    on a torus curve       1:3, 1:4  rotation number; 1:1 and 1:2 are the ends of the curve
    on all                 extremum  dq/ds of the second parameter along the curve

The factors chi' take off the poles that the coefficients a and c have at the resonances (Kuznetsov, Elements of Applied
Bifurcation Theory, chapter 9).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from continuation.branches.criticality import STRONG
from continuation.branches.extended import ExtendedProblem
from continuation.branches.newton import Metric, Node
from continuation.branches.reduction import coefficient
from continuation.errors import UnsupportedModel

PointKind = Literal["extremum", "cusp", "generalised-doubling", "fold-flip", "1:1", "1:2", "1:3", "1:4"]


KINDS: dict[str, tuple[PointKind, ...]] = {
    "fold": ("cusp", "extremum", "1:1", "fold-flip"),
    "period-doubling": ("extremum", "1:2", "fold-flip", "generalised-doubling"),
    "neimark-sacker": ("extremum", "1:3", "1:4"),
    "grazing": ("extremum",),
}
"""What is looked for on a curve of each kind."""


class Tests:
    """Test functions at nodes of one curve.

    ``along`` is the null vector of the last fold, whose sign is carried from node to node; ``missing`` says why a
    function is not known.
    """

    def __init__(self, system: ExtendedProblem, metric: Metric) -> None:
        self.system, self.metric = system, metric
        self.missing = ""
        self.along: np.ndarray | None = None

    def __call__(self, node: Node, kinds: tuple[PointKind, ...]) -> np.ndarray:
        """Return the functions (k,) of the kinds asked for at a node; NaN where one can't be had.

        Cost: a monodromy matrix for the resonances, about two Newton steps more for a coefficient.
        """
        known: dict[PointKind, float] = {"extremum": node.tp}
        if self.system.kind == "neimark-sacker":
            nu = self.system.split(node.u)[2]
            known |= {"1:3": nu - STRONG["1:3"], "1:4": nu - STRONG["1:4"]}
        elif set(kinds) - set(known):
            known |= self._of_multipliers(node, kinds)
        return np.array([known[kind] for kind in kinds])

    def _of_multipliers(self, node: Node, kinds: tuple[PointKind, ...]) -> dict[PointKind, float]:
        fold = self.system.kind == "fold"
        u, p, _ = self.system.split(node.u)
        mu = np.linalg.eigvals(self.system.at(node.p).monodromies([(u, p)])[0])
        size = float(np.prod(1 + np.abs(mu)))
        here = 1.0 if fold else -1.0
        slope = float(sum(np.prod(np.delete(here - mu, i)) for i in range(len(mu))).real / size)
        out: dict[PointKind, float] = {"fold-flip": float(np.prod(-here - mu).real) / size}
        out["1:1" if fold else "1:2"] = slope
        if "cusp" in kinds:
            out["cusp"] = self._bend(node) * slope
        if "generalised-doubling" in kinds:
            out["generalised-doubling"] = self._cubic(node) * slope
        return out

    def _bend(self, node: Node) -> float:
        """Return the quadratic coefficient of a fold up to a positive factor, the sign of the null vector kept."""
        system = self.system
        u, p, nu = system.split(node.u)
        system.linearise(node.u, node.p)
        null = system.null(node.u, node.p)
        form = system.inner.critical_form(u, p, nu, null.v, null.w)
        before = self.along
        guess = np.ones_like(u) if before is None else system.inner.lengthen(before, u)
        du, _ = system.tangent((guess, 0.0), self.metric)
        self.along = du
        return float((form.state @ du).real / form.shift.imag)

    def _cubic(self, node: Node) -> float:
        try:
            return coefficient(self.system, node.u, node.p)
        except UnsupportedModel as reason:
            self.missing = f"generalised doublings are not looked for: {reason}"
            return np.nan
