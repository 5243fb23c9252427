"""Poincare sections: stroboscopic, at a contact change, or where a quantity crosses a level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from continuation.errors import nearest
from continuation.model.contact import Contact
from continuation.model.system import System
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep, FixedStepIntegrator
from continuation.timedomain.simulate import EventExact

_ROUND = 50  # periods integrated at a time


@dataclass(frozen=True, slots=True)
class Stroboscopic:
    """Take the state at one phase of every excitation period.

    Parameters
    ----------
    phase : float
        In rad, 0 to 2*pi.
    """

    phase: float = 0.0


@dataclass(frozen=True, slots=True)
class ContactChange:
    """Take the state whenever a contact passes a breakpoint.

    Parameters
    ----------
    contact : int
        Index of the contact.
    breakpoint : int
        Index of its breakpoint; -1 is the last, where the driving flanks of a gear meet.
    direction : int
        +1: when its argument increases (onset of contact at the last breakpoint), -1: when it decreases, 0: both.
    """

    contact: int = 0
    breakpoint: int = -1
    direction: int = 1


@dataclass(frozen=True, slots=True)
class Crossing:
    """Take the state whenever a state or a smooth output passes a level.

    Parameters
    ----------
    quantity : str
        Name of the state or output; an output must not contain a contact force.
    level : float
        In the unit of the quantity.
    direction : int
        +1: when it increases, -1: when it decreases, 0: both.
    """

    quantity: str
    level: float = 0.0
    direction: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Hold the points of a Poincare section.

    Attributes
    ----------
    state_names : tuple of str, length n
    points : ndarray (k, n)
        States on the section, in the order in which they are visited.
    phases : ndarray (k,)
        Excitation phase from the start in rad; the time when the System is autonomous.
    """

    state_names: tuple[str, ...]
    points: np.ndarray
    phases: np.ndarray

    def column(self, name: str) -> np.ndarray:
        """Return one state at all points, shape (k,)."""
        if name not in self.state_names:
            raise ValueError(f"section: unknown state {name!r}; {nearest(name, self.state_names)}")
        return self.points[:, self.state_names.index(name)]


def poincare_section(
    system: System,
    start: Sequence[float] | np.ndarray,
    section: Stroboscopic | ContactChange | Crossing,
    *,
    count: int = 200,
    transient: int = 200,
    limit: int = 10_000,
    integrator: FixedStep | EventExact | None = None,
    **parameters: float,
) -> Section:
    """Follow a trajectory until it has met a section so many times.

    Parameters
    ----------
    start : array (n,)
        State at phase 0.
    count : int
        Number of points.
    transient, limit : int
        Periods before the first point, and at most after it; units of time when the System is autonomous.
    integrator : FixedStep or EventExact, optional
        ``FixedStep()`` when absent. Either lands on the section as on a contact change: points lie on it to rounding.

    Returns
    -------
    Section
        With fewer points than asked for where the limit of periods came first.

    Raises
    ------
    ValueError
        If a name is unknown, a number is out of range, or the section does not fit the System.
    ContinuationError
        If the integration fails.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v = ca.SX.sym("x"), ca.SX.sym("v")
    >>> spring = System(name="spring", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, parameters={})
    >>> met = poincare_section(spring, [1.0, 0.0], Crossing("x", 0.5), count=3, transient=0)
    >>> met.points.round(6).tolist()[0], (met.phases / np.pi).round(6).tolist()                     # 5/3, 11/3, ...
    ([0.5, 0.866025], [1.666667, 3.666667, 5.666667])
    """
    x, p = np.array(start, dtype=float).ravel(), system.parameter_vector(parameters)
    if min(count, limit) < 1 or transient < 0 or x.shape != (len(system.state_names),):
        raise ValueError("poincare_section: count and limit must be positive, transient not negative, start complete")
    marked, index, breakpoint = _marked(system, section)
    march = _March(marked, FixedStep() if integrator is None else integrator, p)
    for _ in range(transient // _ROUND):
        x = march(x, _ROUND, None)[0]
    x = march(x, transient % _ROUND, None)[0]
    points, phases, length = [], [], march.length
    for done in range(0, limit, _ROUND):
        periods = min(_ROUND, limit - done)
        strobe = section.phase if isinstance(section, Stroboscopic) else None
        x, states, changes = march(x, periods, strobe)
        if isinstance(section, Stroboscopic):
            at, hit = section.phase + length * np.arange(periods), np.ones(periods, dtype=bool)
        else:
            at, hit = changes[:, 0], _hits(marked, changes, states, index, breakpoint, section.direction, p)
        points += [*states[hit]]
        phases += [*(at[hit] + done * length)]
        if len(points) >= count:
            break
    return Section(system.state_names, np.array(points[:count]).reshape(-1, len(x)), np.array(phases[:count]))


def _marked(system: System, section: Stroboscopic | ContactChange | Crossing) -> tuple[System, int, float]:
    """Return a System with a contact at the section, the index of that contact, and its breakpoint."""
    if isinstance(section, Stroboscopic):
        if system.frequency is None or not 0 <= section.phase < 2 * np.pi:
            raise ValueError("Stroboscopic: needs a System with a phase, and a phase in [0, 2*pi)")
        return system, -1, 0.0
    if section.direction not in (-1, 0, 1):
        raise ValueError(f"section: direction must be -1, 0 or 1, got {section.direction}")
    if isinstance(section, ContactChange):
        if not 0 <= section.contact < len(system.contacts):
            raise ValueError(f"ContactChange: system {system.name!r} has {len(system.contacts)} contacts")
        breakpoints = system.contacts[section.contact].breakpoints
        if not -len(breakpoints) <= section.breakpoint < len(breakpoints):
            raise ValueError(f"ContactChange: the contact has {len(breakpoints)} breakpoints, got {section.breakpoint}")
        return system, section.contact, breakpoints[section.breakpoint]
    names = (*system.state_names, *system.output_names)
    if section.quantity not in names:
        raise ValueError(f"Crossing: unknown quantity {section.quantity!r}; {nearest(section.quantity, names)}")
    quantity = ca.vertcat(system.x, system.outputs)[names.index(section.quantity)]
    if system.contacts and ca.depends_on(quantity, system.phi):
        raise ValueError(f"Crossing: output {section.quantity!r} contains a contact force, which has corners")
    return _with_mark(system, quantity, section.level), len(system.contacts), section.level


def _with_mark(system: System, quantity: ca.SX, level: float) -> System:
    """Return the same System with a contact without force, so that integrators land where a quantity passes a level."""
    arguments = ca.vertsplit(system.arguments) if system.contacts else []
    contacts = [
        Contact(argument=a, breakpoints=c.breakpoints, slopes=c.slopes, name=c.name)
        for a, c in zip(arguments, system.contacts, strict=True)
    ]
    expressions = [system.derivative, ca.SX(system.outputs)]
    if contacts:
        expressions = ca.substitute(expressions, [system.phi], [ca.vertcat(*(c.force for c in contacts))])
    derivative, outputs = (ca.vertsplit(e) if e.numel() else [] for e in expressions)
    return System(
        name=system.name,
        states=dict(zip(system.state_names, ca.vertsplit(system.x), strict=True)),
        derivatives=dict(zip(system.state_names, derivative, strict=True)),
        parameters={
            name: (symbol, system.defaults[name])
            for name, symbol in zip(
                system.parameter_names, ca.vertsplit(system.p) if system.defaults else [], strict=True
            )
        },
        phase=None if system.frequency is None else system.theta,
        frequency=system.frequency,
        contacts=[*contacts, Contact(argument=quantity, breakpoints=(level,), slopes=(0.0, 0.0), name="section")],
        outputs=dict(zip(system.output_names, outputs, strict=True)),
    )


class _March:
    """March a System over periods and return states at a phase or at contact changes, with either integrator."""

    def __init__(self, system: System, method: FixedStep | EventExact, p: np.ndarray) -> None:
        self.length = 1.0 if system.frequency is None else 2 * np.pi
        self._turn = 1.0
        self._fixed: FixedStepIntegrator | None = None
        if isinstance(method, FixedStep):
            if not method.land:
                raise ValueError("poincare_section: FixedStep(land=False) steps over contact changes and sections")
            self._fixed, self._p = method.compile(system), p
            return
        if system.frequency is None:
            system, p, self._turn = system.clocked("turns", 2 * np.pi), np.append(p, 2 * np.pi), 2 * np.pi
        self._exact = ExactIntegrator(system, rtol=method.rtol, atol=method.atol, steps=method.steps)
        self._p = p

    def __call__(self, x: np.ndarray, periods: int, phase: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the last state, the states at the phase or else at contact changes, and the changes (k, 3)."""
        if periods == 0:
            return x, np.empty((0, len(x))), np.empty((0, 3))
        if self._fixed is not None:
            run = self._fixed.run(x, self._p, periods, phases=() if phase is None else [phase], changes=phase is None)
            return run.end, run.change_states if phase is None else run.samples[:, 0], run.changes
        exact = self._exact.integrate(x, self._p, periods)
        changes = np.array(exact.changes, dtype=float).reshape(-1, 3)
        if phase is None:
            at = np.searchsorted(exact.phases, changes[:, 0])
            return exact.end, np.array(exact.states)[at], changes / [self._turn, 1, 1]
        phases = phase + 2 * np.pi * np.arange(periods)
        return exact.end, self._exact.sample(exact, self._p, phases), changes


def _hits(
    system: System, changes: np.ndarray, states: np.ndarray, index: int, level: float, direction: int, p: np.ndarray
) -> np.ndarray:
    """Return which contact changes are those of the section."""
    arguments = ca.Function("arguments", [system.x, system.theta, system.p], [system.arguments])
    if not len(changes):
        return np.zeros(0, dtype=bool)
    values = arguments(states.T, changes[None, :, 0], p).full()[index]
    levels = np.array(system.contacts[index].breakpoints)
    here = levels[abs(values[:, None] - levels).argmin(axis=1)] == level
    wanted = here & (changes[:, 1] == index)
    return wanted if direction == 0 else wanted & (changes[:, 2] == direction)
