"""Periodic orbits, continuation and stability of CasADi models, smooth or with exact piecewise-linear contact."""

from continuation.branches.arclength import trace
from continuation.branches.branch import Branch, SpecialPoint
from continuation.errors import ContinuationError, NoConvergence, SingularLinearPart, UnsupportedModel
from continuation.model.contact import Contact
from continuation.model.system import System
from continuation.orbits.harmonic_balance import HarmonicBalance
from continuation.orbits.orbit import Orbit

__all__ = [
    "Branch",
    "Contact",
    "ContinuationError",
    "HarmonicBalance",
    "NoConvergence",
    "Orbit",
    "SingularLinearPart",
    "SpecialPoint",
    "System",
    "UnsupportedModel",
    "trace",
]
