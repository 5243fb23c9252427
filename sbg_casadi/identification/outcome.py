"""What an identification is asked for, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sbg_casadi.errors import UserError
from sbg_casadi.identification.determinacy import Conflict, Determinacy
from sbg_casadi.identification.scoring import cost
from sbg_casadi.identification.search import Archive
from sbg_casadi.identification.targets import Target
from sbg_casadi.identification.unknowns import Unknown
from sbg_casadi.pair import Pair


@dataclass(frozen=True, slots=True)
class Settings:
    """Say how much is spent on an identification, and its seed.

    Attributes
    ----------
    seed : int
        The same seed gives the same result on one machine.
    evaluations : int
        Candidates of the global search; 0 starts the refinement from the values that the pair has.
    refined : int
        Best candidates that are refined.
    steps : int
        Candidates of each refinement at most.
    near : float, optional
        Share of the ranges, on both sides of the values that the pair has, in which the search begins; the whole ranges
        when absent.
    """

    seed: int = 0
    evaluations: int = 1000
    refined: int = 2
    steps: int = 30
    near: float | None = None

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("evaluations", 0), ("refined", 0), ("steps", 1)):
            if not least <= getattr(self, name) <= 10_000_000:
                raise UserError(f"--{name} = {getattr(self, name)}; expected a whole number from {least} on")
        if self.near is not None and not 0 < self.near <= 1:
            raise UserError(f"--near = {self.near:g}; expected a share of the ranges above 0 and up to 1, such as 0.1")


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Hold what was found.

    Attributes
    ----------
    pair : Pair
        With the values found, source ``calibrated``.
    unknowns, targets : tuple
    coordinates : ndarray (n,)
        Of the unknowns, 0 at the lower and 1 at the upper bound.
    values : tuple of tuple of float
        For every target the quantities it asks for, empty for a regime.
    words : tuple of str
        For every target what the response is, where that was looked at.
    residuals : ndarray (m,)
        In tolerances; a regime has 0 where it is met and 1 or more where it is not.
    followed : dict of str to str
        For targets answered by an orbit: "orbit", "peak" or "fold", by name.
    reasons : dict of str to str
        Why another one has no gradient.
    determinacy : Determinacy or None
        None when nothing could be followed.
    conflicts : tuple of Conflict
    archive : Archive
    notes : tuple of str
        What went wrong or was cut short.
    complete : bool
        False after an interrupt.
    """

    pair: Pair
    unknowns: tuple[Unknown, ...]
    targets: tuple[Target, ...]
    coordinates: np.ndarray
    values: tuple[tuple[float, ...], ...]
    words: tuple[str, ...]
    residuals: np.ndarray
    followed: dict[str, str]
    reasons: dict[str, str]
    determinacy: Determinacy | None
    conflicts: tuple[Conflict, ...]
    archive: Archive = field(repr=False)
    notes: tuple[str, ...] = ()
    complete: bool = True

    @property
    def found(self) -> dict[str, Any]:
        """Values found by the name of the unknown, in SI units."""
        return {u.name: u.value(t) for u, t in zip(self.unknowns, self.coordinates.tolist(), strict=True)}

    @property
    def cost(self) -> float:
        """Cost of the residuals."""
        return cost(self.residuals)
