"""What a march over whole periods leaves, and the error of one that failed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation.errors import Chattering, IntegrationFailed, Runaway, TooManySteps
from continuation.model.system import System
from continuation.timedomain import fixed_step_driver as driver
from continuation.timedomain.exact import describe
from continuation.timedomain.fixed_step_functions import ModeModel
from continuation.timedomain.fixed_step_machine import March


@dataclass(frozen=True, slots=True, eq=False)
class FixedStepRun:
    """Hold what a march over whole periods leaves; nothing of it grows with the number of steps.

    Attributes
    ----------
    period : float
        Length of a period in time; 1 when the System is autonomous.
    strobe : ndarray (periods + 1, n)
        States at phase 0, the first one included.
    mean, variance, minimum, maximum : ndarray (periods, quantities)
        Of every quantity over each period; extremes also between steps. Empty unless asked for.
    samples : ndarray (periods, phases, n)
        States at the chosen phases of each period.
    changes : ndarray (k, 3)
        Phase from the start of the march (time, when autonomous), contact and direction (+1 when the argument
        increases) of every contact change. Empty unless asked for.
    change_states : ndarray (k, n)
        States there.
    shares : tuple of ndarray
        For every contact the share of time in each of its linear pieces.
    """

    period: float
    strobe: np.ndarray
    mean: np.ndarray
    variance: np.ndarray
    minimum: np.ndarray
    maximum: np.ndarray
    samples: np.ndarray
    changes: np.ndarray
    change_states: np.ndarray
    shares: tuple[np.ndarray, ...]

    @property
    def end(self) -> np.ndarray:
        """Return the last state, shape (n,)."""
        return self.strobe[-1]


def collect(m: March, start: np.ndarray, model: ModeModel) -> FixedStepRun:
    """Return what a march from a state left."""
    length = m.h * m.steps
    mean, variance, lowest, highest = (np.empty((0, 0)),) * 4 if m.statistics is None else _statistics(m, length)
    c = np.empty((0, 4 + len(m.x))) if m.changes is None else m.changes[: m.count].copy()
    times = np.empty(0) if m.dwell is None else m.dwell / max(length * m.periods, 1e-300)
    first = np.cumsum([len(law[1]) for law in model.laws])[:-1]
    n = len(m.x)
    return FixedStepRun(
        period=length,
        strobe=np.vstack([start, m.strobe]),
        mean=mean,
        variance=variance,
        minimum=lowest,
        maximum=highest,
        samples=np.empty((m.periods, 0, n)) if m.samples is None else m.samples,
        changes=np.column_stack([c[:, 0] * length * m.turn + c[:, 1], c[:, 2:4]]),
        change_states=c[:, 4:],
        shares=tuple(np.split(times, first)) if model.laws else (),
    )


def _statistics(m: March, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    assert m.statistics is not None
    first, second, lowest, highest = np.moveaxis(m.statistics, 2, 0)
    with np.errstate(over="ignore", invalid="ignore"):  # left to those who asked
        mean = first / length
        variance = np.maximum(second / length - mean**2, 0.0)
    return mean + m.centre, variance, lowest + m.centre, highest + m.centre


def failure(m: March, flag: int, settings: str, system: System) -> IntegrationFailed:
    """Return the error of a march that failed."""
    kind, reason = {
        driver.NOT_FINITE: (
            Runaway,
            "the state left the finite numbers; check the model there, or take more steps",
        ),
        driver.CHATTER: (Chattering, "contacts changed too often in one step; take more steps"),
        driver.FULL: (TooManySteps, "contacts changed more than twice a step on average; take more steps"),
    }[flag]
    parameters = dict(zip(system.parameter_names, m.p.tolist(), strict=True))
    state = describe(dict(zip(system.state_names, m.x, strict=False)))
    begin = m.failed_period * m.h * m.steps
    message = (
        f"{settings} of {system.name!r} failed at time {begin + m.failed_phase / m.turn:.6g} "
        f"({describe(parameters)}): {reason}. State at time {begin:.6g}, where the period began: {state}"
    )
    return kind(message, begin * m.turn + m.failed_phase, parameters)
