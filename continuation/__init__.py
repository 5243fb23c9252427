"""Periodic orbits, continuation and stability of CasADi models, smooth or with exact piecewise-linear contact."""

from continuation.branches.arclength import trace
from continuation.branches.branch import Branch, SpecialPoint
from continuation.branches.cascade import Cascade, cascade
from continuation.branches.explore import Tree, explore
from continuation.branches.isolas import IsolaSearch, find_isolas
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
from continuation.timedomain.basins import Grid, Random, basins
from continuation.timedomain.basins_result import Basins
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.lyapunov import LyapunovSpectrum, lyapunov_spectrum
from continuation.timedomain.parallel import up_and_down
from continuation.timedomain.sections import ContactChange, Crossing, Section, Stroboscopic, poincare_section
from continuation.timedomain.series_exponent import Kantz, Rosenstein, SeriesExponent, series_exponent
from continuation.timedomain.simulate import EventExact, Simulation, simulate
from continuation.timedomain.sweep import sweep
from continuation.timedomain.sweep_result import Sweep
from continuation.timedomain.waterfall import Waterfall, waterfall

__all__ = [
    "CVODES",
    "Basins",
    "Branch",
    "Cascade",
    "Certificate",
    "Collocation",
    "Contact",
    "ContactChange",
    "ContinuationError",
    "Crossing",
    "Curve",
    "EventExact",
    "FixedStep",
    "Grid",
    "HarmonicBalance",
    "IsolaSearch",
    "Kantz",
    "LyapunovSpectrum",
    "NoConvergence",
    "Orbit",
    "Random",
    "Rosenstein",
    "Section",
    "SeriesExponent",
    "Shooting",
    "Simulation",
    "SingularLinearPart",
    "SpecialPoint",
    "Stroboscopic",
    "Sweep",
    "System",
    "Tree",
    "UnsupportedModel",
    "Waterfall",
    "basins",
    "cascade",
    "certify",
    "explore",
    "find_isolas",
    "lyapunov_spectrum",
    "poincare_section",
    "series_exponent",
    "simulate",
    "sweep",
    "switch",
    "trace",
    "track",
    "up_and_down",
    "waterfall",
]
