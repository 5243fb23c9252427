"""Periodic orbits, continuation and stability of CasADi models, smooth or with exact piecewise-linear contact."""

from continuation.branches.arclength import trace
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.switching import switch
from continuation.branches.tracking import Curve, track
from continuation.errors import ContinuationError, NoConvergence, SingularLinearPart, UnsupportedModel
from continuation.model.contact import Contact
from continuation.model.system import System
from continuation.orbits.certificate import Certificate, certify
from continuation.orbits.collocation import Collocation
from continuation.orbits.harmonic_balance import HarmonicBalance
from continuation.orbits.orbit import Orbit
from continuation.orbits.shooting import Shooting
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.parallel import up_and_down
from continuation.timedomain.sweep import sweep
from continuation.timedomain.sweep_result import Sweep

__all__ = [
    "CVODES",
    "Branch",
    "Certificate",
    "Collocation",
    "Contact",
    "ContinuationError",
    "Curve",
    "HarmonicBalance",
    "NoConvergence",
    "Orbit",
    "Shooting",
    "SingularLinearPart",
    "SpecialPoint",
    "Sweep",
    "System",
    "UnsupportedModel",
    "certify",
    "sweep",
    "switch",
    "trace",
    "track",
    "up_and_down",
]
