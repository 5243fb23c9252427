"""Orbits of Systems with many states: solved and checked exactly, their stability left open.

A monodromy matrix of thousands of states neither fits nor pays, and a part of its multipliers proves nothing about the
others. Such orbits carry NaN multipliers and are "undecided"; :func:`refuse` says so where multipliers are asked for.
"""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from continuation.errors import UnsupportedModel
from continuation.model.linear_part import DENSE_STATES
from continuation.orbits.contact_series import find_pattern
from continuation.orbits.estimate import through_balance, waveform_size
from continuation.orbits.floquet import build_orbit
from continuation.orbits.orbit import Orbit
from continuation.orbits.patterns import named
from continuation.orbits.spectrum import pack, unpack


def make_large_orbits(problem: Any, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
    """Return the Orbits of corrected harmonic-balance points (u, p, waveform error) of a System with many states.

    The states are solved for exactly at every harmonic, whatever receptance Newton's method used; by how much the port
    arguments they give miss those of the point is what a fitted receptance did to the orbit, and is added to its error.
    Cost one sparse factorisation per harmonic: 1.5 s for 10000 coordinates and 63 harmonics.
    """
    orbits = []
    none = np.full(len(problem.system.state_names), np.nan)
    for u, p, error in points:
        states = problem.state_spectrum(u, p)
        k = problem.ports.outputs
        missed = unpack(u, k) - states @ problem.ports.linear(problem.vector(p)).C.T
        moved = through_balance(problem, u, p, pack(missed))[: len(u), 0]
        total = error + 2 * waveform_size(moved, k)
        orbits.append(build_orbit(problem, p, states, none.astype(complex), none, total, _contacts(problem, u, p)))
    return orbits


def _contacts(problem: Any, u: np.ndarray, p: float) -> Any:
    """Return the contact changes, from the arguments at the ports instead of those of all states."""
    Y, vector = unpack(u, problem.ports.outputs), problem.vector(p)
    contacts = problem.system.contacts
    found = [find_pattern(problem.forces.argument(i, Y, vector), contact) for i, contact in enumerate(contacts)]
    return named(problem.system, found, problem.period_multiple)


def refuse(problem: Any) -> NoReturn:
    """Raise UnsupportedModel: multipliers of so many states are not computed."""
    n = len(problem.system.state_names)
    raise UnsupportedModel(
        f"system {problem.system.name!r} has {n} states: Floquet multipliers, and with them special points and "
        f"stability, are computed up to {DENSE_STATES} states; solve single orbits with guess(...) and "
        "solve(orbit, value), or leave out linear coordinates"
    )
