"""Accepted steps of an event-exact integration."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from continuation.timedomain.dormand_prince import dense_weights


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Hold the accepted steps of an integration; every step lies in one contact mode.

    Attributes
    ----------
    phases : ndarray (k + 1,)
        Phases in radians at the ends of the steps.
    states : ndarray (k + 1, n)
        States there.
    modes : ndarray of int (k, m)
        Index of the linear piece of every contact during each step.
    changes : tuple of (phase, contact index, direction)
        Contact changes; direction +1 when the argument increases.
    places : tuple of int
        Number of steps before each change.
    following : float
        Length proposed for a next step.
    """

    phases: np.ndarray
    states: np.ndarray
    modes: np.ndarray
    changes: tuple[tuple[float, int, int], ...]
    places: tuple[int, ...]
    following: float

    @property
    def end(self) -> np.ndarray:
        """Return the last state, shape (n,)."""
        return self.states[-1]


@dataclass(slots=True)
class Run:
    """Collect steps; blocks of phases and states are joined at the end."""

    theta: float
    x: np.ndarray
    pieces: list[int]
    phases: list[np.ndarray] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)
    modes: list[tuple[int, ...]] = field(default_factory=list)
    changes: list[tuple[float, int, int]] = field(default_factory=list)
    places: list[int] = field(default_factory=list)

    def add(self, phases: np.ndarray, states: np.ndarray) -> None:
        """Record steps that end at phases (k,) with states (k, n)."""
        if len(phases):
            self.phases.append(phases)
            self.states.append(states)
            self.modes += [tuple(self.pieces)] * len(phases)
            self.theta, self.x = float(phases[-1]), states[-1]

    def done(self, start: float, x: np.ndarray, following: float) -> Trajectory:
        """Return the trajectory from a state x (n,) at the phase ``start``."""
        modes = np.array(self.modes, dtype=int).reshape(len(self.modes), len(self.pieces))
        phases, states = np.concatenate([[start], *self.phases]), np.concatenate([x[None], *self.states])
        return Trajectory(phases, states, modes, tuple(self.changes), tuple(self.places), following)


def interpolate(run: Trajectory, coefficients: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Evaluate the interpolants of :meth:`ExactIntegrator.interpolant` at phases (N,) inside the trajectory, (N, n)."""
    at = np.clip(np.searchsorted(run.phases, phases, side="right") - 1, 0, len(run.modes) - 1)
    weights = dense_weights((phases - run.phases[at]) / np.diff(run.phases)[at])
    return run.states[at] + np.einsum("ki,kin->kn", weights, coefficients[at])
