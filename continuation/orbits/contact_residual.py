"""Whether the contact changes that an integration used are those of the orbit's own arguments.

Liouville's determinant does not see contact phases: with constant damping it is right whatever they are. This check
shares no code with the search for contact changes: it evaluates the argument at the phases used and on a grid.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.model.contact import Contact
from continuation.orbits import contact_series as series
from continuation.orbits.spectrum import unpack

_ROUNDING = 1e-12  # of the size of the argument


def contact_defect(
    problem: Any, u: np.ndarray, p: float, patterns: tuple[series.ContactPattern, ...]
) -> tuple[float, float]:
    """Return the largest phase error of contact changes, and a bound of the relative error it makes in the flow.

    Parameters
    ----------
    problem : HarmonicBalanceProblem
    u, p
        Point of a branch.
    patterns : tuple of ContactPattern, one per contact
        Changes over the orbit's phase 0..2*pi that the integration used.

    Returns
    -------
    defect : float
        In rad of the orbit's phase: distance of a change used from the argument's own, or of an instant at which the
        argument lies in another piece from the nearest change used.
    effect : float
        Upper bound of the relative change of the transition matrix, up to its conditioning.
    """
    vector = problem.vector(p)
    Y, part, forcing = unpack(u, problem.ports.outputs), problem.ports.linear(vector), problem.ports.forcing(vector)
    worst = effect = 0.0
    for i, (contact, pattern) in enumerate(zip(problem.system.contacts, patterns, strict=True)):
        errors = _phase_errors(problem.forces.argument(i, Y, vector), contact, pattern)
        worst = max(worst, float(errors.max(initial=0.0)))
        if not errors.any():
            continue
        if i in problem.ports.general:  # its gain depends on the state: all slopes there are
            slope = np.abs(problem.forces(Y, vector, 0, len(Y)).slope).sum(axis=0)
            jump = np.linalg.norm(part.B) * np.linalg.norm(slope) * np.linalg.norm(part.C)
        else:
            gain = np.abs(forcing.gain[i]) @ np.where(np.arange(forcing.gain.shape[-1]) == 0, 1.0, 2.0)
            jump = np.linalg.norm(part.B @ gain) * np.linalg.norm(part.d[i] @ part.C)
            jump *= np.abs(np.diff(contact.slopes)).max()
        effect += float(errors.sum() * jump / problem.frequency(p))
    return worst, effect


def _phase_errors(argument: np.ndarray, contact: Contact, pattern: series.ContactPattern) -> np.ndarray:
    """Return phase errors: one per change used, and one for the worst instant in a wrong piece."""
    wrong = _wrong_piece(argument, contact, pattern)
    if not pattern.phases.size:
        return np.array([wrong])
    before, after = pattern.modes[:-1], pattern.modes[1:]
    level = np.array(contact.breakpoints)[np.minimum(np.minimum(before, after), len(contact.breakpoints) - 1)]
    orders = np.arange(len(argument))
    weights = np.where(orders == 0, 1.0, 2.0) * argument * np.array([orders**0, 1j * orders, -(orders**2)])
    miss, rate, bend = np.abs(
        (np.exp(1j * np.outer(pattern.phases, orders)) @ weights.T).real.T - np.outer([1, 0, 0], level)
    )
    down = rate + np.sqrt(rate**2 + 2 * bend * miss)  # of the quadratic through the change: finite at grazing
    rounding = _ROUNDING * np.abs(argument).sum()
    errors = np.divide(2 * miss, down, out=np.zeros_like(miss), where=miss > rounding)
    return np.append(errors, wrong)


def _wrong_piece(argument: np.ndarray, contact: Contact, pattern: series.ContactPattern) -> float:
    """Return the largest distance of a grid point in another piece than the pattern says from the nearest change."""
    count = 8 << max(len(argument) - 1, 2).bit_length()
    step = 2 * np.pi / count
    orders = np.arange(len(argument))
    values = np.fft.irfft(argument * np.exp(0.37j * step * orders), count, norm="forward")
    grid = (np.arange(count) + 0.37) * step  # off the grid of the search
    used = pattern.modes[np.searchsorted(pattern.phases, grid)]
    wrong = np.flatnonzero(contact.mode(values) != used)
    near = np.abs(values[wrong, None] - np.array(contact.breakpoints)).min(axis=1)
    wrong = wrong[near > _ROUNDING * np.abs(argument).sum()]
    if not wrong.size:
        return 0.0
    ring = np.concatenate([pattern.phases - 2 * np.pi, pattern.phases, pattern.phases + 2 * np.pi, [np.inf]])
    return float(min(np.abs(grid[wrong, None] - ring).min(axis=1).max(), 2 * np.pi))
