"""One periodic orbit by several methods, and the verdict that all of them support."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from continuation import Certificate, Orbit, Shooting, certify
from sbg_casadi.coexisting import Change
from sbg_casadi.documents import STATE

_SAMPLES = 2048  # phases at which the waveforms of two methods are compared
_SHOOTING = "shooting"


def compare_methods(problem: Any, orbit: Orbit) -> tuple[dict[str, Any], Certificate]:
    """Judge an orbit of harmonic balance by every method, and find the orbit itself by event-exact shooting.

    Parameters
    ----------
    problem : Problem
        Harmonic balance, that the orbit came from.
    orbit : Orbit

    Returns
    -------
    dict
        ``multipliers``: for every further method its largest difference of a multiplier (None: not finite);
        ``waveform`` (lambda, half backlashes) with ``expected``, the sum of both stated errors, and ``contact_deg``,
        the largest difference of contact phases from shooting (None for another sequence of contacts), all None where
        shooting failed; ``missing``: a reason for every method that gave no answer; ``liouville`` and
        ``contact_defect_deg``, see :class:`continuation.Certificate`.
    Certificate
        With the error bars, which contain these differences.

    Notes
    -----
    1 to 2 s.
    """
    certificate = certify(problem, orbit)
    largest = {name: float(d.max()) for name, d in certificate.differences.items() if name != "integration"}
    document: dict[str, Any] = {
        "multipliers": {name: value if math.isfinite(value) else None for name, value in largest.items()},
        **dict.fromkeys(("waveform", "expected", "contact_deg")),
        "missing": dict(certificate.missing),
        "liouville": certificate.liouville,
        "contact_defect_deg": math.degrees(certificate.contact_defect),
    }
    if _SHOOTING not in certificate.missing:
        other = Shooting().discretise(problem.system, problem.parameter).from_orbit(orbit)
        phases = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
        waves = [o.evaluate(phases)[:, o.index(STATE)] for o in (orbit, other)]
        document["waveform"] = float(np.abs(waves[0] - waves[1]).max())
        document["expected"] = float(orbit.error + other.error)
        document["contact_deg"] = contact_difference(orbit, other)
    return document, certificate


def contact_difference(orbit: Orbit, other: Orbit) -> float | None:
    """Return the largest difference of the contact phases of two orbits in degrees, None for different patterns.

    Phases are compared around the mesh cycle: a change at its very end may be one at its beginning in the other orbit.
    """
    largest = 0.0
    for name, (phases, modes) in orbit.contacts.items():
        theirs, their_modes = other.contacts[name]
        if len(phases) != len(theirs) or (not len(phases) and modes[0] != their_modes[0]):
            return None
        apart = []
        for shift in range(len(phases)):
            if np.array_equal(modes[1:], np.roll(their_modes[1:], shift)):
                turn = phases - np.roll(theirs, shift)
                apart.append(float(np.abs((turn + np.pi) % (2 * np.pi) - np.pi).max()))
        if len(phases) and not apart:
            return None
        largest = max(largest, min(apart, default=0.0))
    return float(np.degrees(largest))


def decide(value: float, certificate: Certificate, around: Mapping[str, Sequence[Change]]) -> tuple[str, str]:
    """Return the verdict on an orbit at a frequency and its reason.

    That of the certificate, but undecided where the frequency is within the error of a special point: which side of it
    the orbit is on is not known there.
    """
    for change in (c for way in around.values() for c in way[:1]):
        if abs(change.parameter - value) <= change.error:
            where = f"{change.kind} at {change.parameter:.10g} +- {change.error:.1e}"
            return "undecided", f"the frequency ratio lies within the error of the {where}"
    return certificate.stability, certificate.reason.removeprefix(f"{certificate.stability}: ")
