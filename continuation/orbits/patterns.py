"""When a periodic orbit is in which linear piece of each contact, from its Fourier coefficients."""

from __future__ import annotations

from collections import Counter
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from continuation.model.system import System
from continuation.orbits import contact_series as series

Contacts = dict[str, tuple[np.ndarray, np.ndarray]]


@lru_cache(maxsize=16)
def contact_names(system: System) -> tuple[str, ...]:
    """Return the names of the contacts of a System, numbered from 1 where several have the same.

    >>> import casadi as ca
    >>> from continuation import Contact, System
    >>> x, v = ca.SX.sym("x"), ca.SX.sym("v")
    >>> stops = [Contact(argument=s * x, breakpoints=(1.0,), slopes=(0.0, 9.0), name="stop") for s in (1, -1)]
    >>> contact_names(System(name="s", states={"x": x, "v": v}, parameters={}, contacts=stops,
    ...                      derivatives={"x": v, "v": stops[1].force - stops[0].force - x}))
    ('stop 1', 'stop 2')
    """
    names = [c.name for c in system.contacts]
    several = {name for name, count in Counter(names).items() if count > 1}
    numbered = (f"{name} {names[: i + 1].count(name)}" if name in several else name for i, name in enumerate(names))
    return tuple(numbered)


def contact_patterns(problem: Any, coefficients: np.ndarray, p: float) -> Contacts:
    """Return phases and modes of every contact along an orbit, as in :attr:`Orbit.contacts`.

    Works for any method and any argument, also one that is not linear in the states; cost a Fourier transform of the
    arguments.

    Parameters
    ----------
    problem : Problem
    coefficients : complex array (K+1, n)
        Half spectrum of the states over the orbit's period.
    p : float
        Value of the continuation parameter.
    """
    system, multiple = problem.system, problem.period_multiple
    if not system.contacts:
        return {}
    count = 8 << max(len(coefficients) - 1, 32 * multiple).bit_length()
    states = np.fft.irfft(coefficients, count, axis=0, norm="forward").T
    theta = np.arange(count) * (2 * np.pi * multiple / count)
    values = np.array(_arguments(system)(states, theta.reshape(1, -1), problem.vector(p)))
    spectra = np.fft.rfft(values.reshape(len(system.contacts), count), axis=1)[:, : count // 4] / count
    found = [series.find_pattern(a, c) for a, c in zip(spectra, system.contacts, strict=True)]
    return named(system, found, multiple)


def named(system: System, patterns: list[series.ContactPattern], multiple: int) -> Contacts:
    """Return one pattern per contact, over the phase of the orbit, as named phases of the excitation and modes."""
    return {
        name: (found.phases * multiple, found.modes)
        for name, found in zip(contact_names(system), patterns, strict=True)
    }


@lru_cache(maxsize=16)
def _arguments(system: System) -> ca.Function:
    return ca.Function("arguments", [system.x, system.theta, system.p], [ca.densify(system.arguments)])
