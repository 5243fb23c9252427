"""One trajectory by any integrator: states at chosen phases, contact changes and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from continuation.errors import ContinuationError, IntegrationFailed
from continuation.model.system import System
from continuation.timedomain.along import arguments, crossings, outputs
from continuation.timedomain.cvodes import CVODES, DrivenModel, PeriodIntegrator
from continuation.timedomain.exact import ExactIntegrator, describe
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.variational import sensitivities, tangents

_CLOCK = "turns of the clock"
_BETWEEN = 256  # phases of a period between which CVODES may miss a contact
_FEW = 256  # periods of fixed steps in one call: room for contact changes is made beforehand


@dataclass(frozen=True, slots=True)
class EventExact:
    """Choose the variable-step method of order 8 that lands on every contact change.

    Parameters
    ----------
    rtol, atol : float
        Tolerances of the local error, relative and absolute in the unit of the states.
    steps : int
        Largest number of steps per excitation period, or per unit of time.

    Raises
    ------
    ValueError
        If one of them is not positive.

    Examples
    --------
    >>> EventExact(rtol=1e-8)
    EventExact(rtol=1e-08, atol=1e-12, steps=2000)
    """

    rtol: float = 1e-10
    atol: float = 1e-12
    steps: int = 2000

    def __post_init__(self) -> None:
        for name in ("rtol", "atol", "steps"):
            if not getattr(self, name) > 0:
                raise ValueError(f"EventExact: {name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """Hold one trajectory.

    Attributes
    ----------
    system : str
    integrator : str
    parameters : dict of str to float
    state_names : tuple of str, length n
    phases : ndarray (k,)
        Phase from the start in rad, increasing; the time when the System is autonomous.
    time : ndarray (k,)
    states : ndarray (k, n)
    outputs : dict of str to ndarray (k,)
        Outputs of the System, with the exact contact laws.
    changes : ndarray (c, 3)
        Phase, contact, direction (+1 when the argument increases) of every contact change.
    pieces : ndarray of int (m,)
        Linear piece of every contact at the start.
    tangent : ndarray (n, n)
        Derivative of the last state with respect to the first, at fixed phases (times, when the System is autonomous);
        over a period of a periodic response this is the monodromy matrix. Empty unless asked for.
    sensitivities : dict of str to ndarray (n,)
        Derivative of the last state with respect to every parameter, likewise; empty unless asked for.
    """

    system: str
    integrator: str
    parameters: dict[str, float]
    state_names: tuple[str, ...]
    phases: np.ndarray
    time: np.ndarray
    states: np.ndarray
    outputs: dict[str, np.ndarray]
    changes: np.ndarray
    pieces: np.ndarray
    tangent: np.ndarray
    sensitivities: dict[str, np.ndarray]

    @property
    def end(self) -> np.ndarray:
        """Return the last state, shape (n,)."""
        return self.states[-1]

    def intervals(self, contact: int = 0) -> np.ndarray:
        """Return where a contact is in which linear piece, rows (from phase, to phase, piece), shape (c + 1, 3)."""
        rows = self.changes[self.changes[:, 1] == contact]
        edges = np.concatenate([self.phases[:1], rows[:, 0], self.phases[-1:]])
        return np.column_stack([edges[:-1], edges[1:], self.pieces[contact] + np.cumsum([0, *rows[:, 2]])])

    def __str__(self) -> str:
        changes = f", {len(self.changes)} contact changes" if len(self.pieces) else ""
        return f"Simulation of {self.system!r} to time {self.time[-1]:.6g} by {self.integrator}{changes}"


def simulate(
    system: System,
    start: Sequence[float] | np.ndarray,
    span: float,
    *,
    integrator: CVODES | EventExact | FixedStep | None = None,
    phases: Sequence[float] | np.ndarray | None = None,
    derivatives: bool = False,
    **parameters: float,
) -> Simulation:
    """Integrate from phase 0 with the exact contact laws.

    Parameters
    ----------
    start : array (n,)
        State at phase 0.
    span : float
        Number of excitation periods, whole or not; units of time when the System is autonomous.
    integrator : CVODES, EventExact or FixedStep, optional
        ``EventExact()`` when absent.
    phases : array (k,), optional
        Increasing phases in [0, 2*pi), or times in [0, 1) when the System is autonomous, at which states are wanted in
        every period; 64 equidistant ones when absent. The last instant is added.
    derivatives : bool
        Also integrate the variational equations: derivatives of the end by the start and by every parameter. With
        ``EventExact`` alone: a contact change contributes nothing there but is not stepped over.
    **parameters : float
        Values of parameters; the others keep the System's defaults.

    Returns
    -------
    Simulation
        With CVODES contact changes are found between 256 phases of every period, to the 4th power of their distance,
        and contacts that last shorter are not seen; the other two land on every change.

    Raises
    ------
    ValueError
        If a name is unknown or a number is out of range.
    IntegrationFailed
        If the state leaves the finite numbers or a step can't be made; it names phase or time, state and parameters.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> free = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, phase=theta,
    ...               frequency="omega", parameters={"omega": (omega, 1.0)})
    >>> for integrator in (CVODES(), EventExact(), FixedStep(512)):
    ...     run = simulate(free, [1.0, 0.0], 2.25, integrator=integrator, phases=[0.0, 1.0], omega=2.0)
    ...     print(run.phases.round(3).tolist(), run.end.round(6).tolist())           # cos(9 pi / 4), -sin(9 pi / 4)
    [0.0, 1.0, 6.283, 7.283, 12.566, 13.566, 14.137] [0.707107, -0.707107]
    [0.0, 1.0, 6.283, 7.283, 12.566, 13.566, 14.137] [0.707107, -0.707107]
    [0.0, 1.0, 6.283, 7.283, 12.566, 13.566, 14.137] [0.707107, -0.707107]
    """
    method = EventExact() if integrator is None else integrator
    x, p = np.array(start, dtype=float).ravel(), system.parameter_vector(parameters)
    _check(system, x, p, span)
    if derivatives and not isinstance(method, EventExact):
        raise ValueError(f"simulate {system.name!r}: derivatives come with EventExact(...), got {method!r}")
    length = 1.0 if system.frequency is None else 2 * np.pi
    wanted, tangent = _in_period(phases, length), np.empty((0, 0))
    by: dict[str, np.ndarray] = {}
    grid = _grid(wanted, length, span)
    if isinstance(method, FixedStep):
        states, changes = _fixed(system, method, x, p, span, wanted, grid)
    elif isinstance(method, CVODES):
        fine = _finer(wanted, length) if system.contacts else wanted
        dense = _grid(fine, length, span)
        states = _cvodes(system, method, x, p, span, fine, dense)
        changes = crossings(system, states, dense, p)
        states = states[np.searchsorted(dense, grid)]
    else:
        states, changes, tangent, by = _exact(system, method, x, p, grid, derivatives)
    turn = 1.0 if system.frequency is None else p[system.parameter_names.index(system.frequency)]
    return Simulation(
        system=system.name,
        integrator=repr(method),
        parameters=dict(zip(system.parameter_names, p.tolist(), strict=True)),
        state_names=system.state_names,
        phases=grid,
        time=grid / turn,
        states=states,
        outputs=outputs(system, states, grid, p),
        changes=changes,
        pieces=arguments(system, x[None], np.zeros(1), p)[1],
        tangent=tangent,
        sensitivities=by,
    )


def _check(system: System, x: np.ndarray, p: np.ndarray, span: float) -> None:
    if x.shape != (len(system.state_names),) or not np.all(np.isfinite(x)):
        raise ValueError(f"simulate {system.name!r}: start needs {len(system.state_names)} finite states, got {x}")
    if not 0 < span < np.inf:
        raise ValueError(f"simulate {system.name!r}: span must be positive and finite, got {span}")
    if system.frequency is not None and not p[system.parameter_names.index(system.frequency)] > 0:
        raise ValueError(f"simulate {system.name!r}: frequency {system.frequency!r} must be positive")


def _in_period(phases: Sequence[float] | np.ndarray | None, length: float) -> np.ndarray:
    if phases is None:
        return length * np.arange(64) / 64
    wanted = np.array(phases, dtype=float).ravel()
    if len(wanted) and not (wanted[0] >= 0 and np.all(np.diff(wanted) > 0) and wanted[-1] < length):
        raise ValueError(f"phases: expected increasing numbers in [0, {length:.6g}), got {wanted}")
    return wanted


def _grid(wanted: np.ndarray, length: float, span: float) -> np.ndarray:
    """Return the phases wanted in every period, and the end."""
    grid = (length * np.arange(int(np.ceil(span)))[:, None] + wanted).ravel()
    return np.append(grid[grid < length * span * (1 - 1e-14)], length * span)


def _fixed(
    system: System, method: FixedStep, x: np.ndarray, p: np.ndarray, span: float, wanted: np.ndarray, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    integrator, whole = method.compile(system), int(span)
    states, changes, length = [np.empty((0, len(x)))], [np.empty((0, 3))], grid[-1] / span
    for done in range(0, whole, _FEW):
        run = integrator.run(x, p, min(_FEW, whole - done), phases=wanted, changes=True)
        states.append(run.samples.reshape(-1, len(x)))
        changes.append(run.changes + np.array([done * length, 0.0, 0.0]))
        x = run.end
    rest = grid[-1] - whole * length
    if rest <= 1e-14 * grid[-1]:
        return np.vstack([*states, x]), np.vstack(changes)
    ahead = np.append(wanted[wanted < rest * (1 - 1e-14)], rest)
    last = integrator.run(x, p, 1, phases=ahead, changes=True)
    late = last.changes[last.changes[:, 0] <= rest] + [whole * length, 0, 0]
    return np.vstack([*states, *last.samples]), np.vstack([*changes, late])


def _clocked(system: System, p: np.ndarray) -> tuple[System, np.ndarray, float]:
    """Return a driven System, its parameters and its phase per unit of the phases asked for."""
    if system.frequency is not None:
        return system, p, 1.0
    return system.clocked(_CLOCK, 2 * np.pi), np.append(p, 2 * np.pi), 2 * np.pi


def _exact(
    system: System, method: EventExact, x: np.ndarray, p: np.ndarray, grid: np.ndarray, derivatives: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    driven, p, turn = _clocked(system, p)
    integrator = ExactIntegrator(driven, rtol=method.rtol, atol=method.atol, steps=method.steps)
    run = integrator.between(x, p, 0.0, turn * grid[-1])
    changes = np.array(run.changes, dtype=float).reshape(-1, 3) / [turn, 1, 1]
    states = integrator.sample(run, p, turn * grid)
    if not derivatives:
        return states, changes, np.empty((0, 0)), {}
    known = tangents(integrator, [run], p)
    by = {
        name: sensitivities(integrator, known, 1, p, unit)[0]
        for name, unit in zip(system.parameter_names, np.eye(len(p)), strict=False)  # the last one may be the clock's
    }
    return states, changes, known.whole(0), by


def _finer(wanted: np.ndarray, length: float) -> np.ndarray:
    """Return the phases wanted with others between them, at most 1/256 of a period apart."""
    others = length * np.arange(_BETWEEN) / _BETWEEN
    near = abs(others[:, None] - wanted).min(axis=1, initial=length) < length / 8 / _BETWEEN
    return np.sort(np.concatenate([wanted, others[~near]]))


def _cvodes(
    system: System, method: CVODES, x: np.ndarray, p: np.ndarray, span: float, wanted: np.ndarray, grid: np.ndarray
) -> np.ndarray:
    driven, q, turn = _clocked(system, p)
    model, length = DrivenModel.of(driven), grid[-1] / span
    inside = wanted[wanted > 0]
    integrator = PeriodIntegrator(method, model, turn * np.append(inside, length))
    rows, at = [], x
    for k in range(int(np.ceil(span - 1e-14))):
        ahead = inside
        if (rest := grid[-1] - k * length) < length * (1 - 1e-14):
            ahead = inside[inside < rest]
            integrator = PeriodIntegrator(method, model, turn * np.append(ahead, rest))
        try:
            path = integrator.period(at, q)
        except ContinuationError as error:
            names = dict(zip(system.parameter_names, p.tolist(), strict=True))
            state = describe(dict(zip(system.state_names, at, strict=True)))
            time = k * length if system.frequency is None else 2 * np.pi * k / names[system.frequency]
            where = f"in the period that begins at time {time:.6g} with state {state}"
            raise IntegrationFailed(f"{error}, {where}", k * length, names) from error
        rows += [*(path[:-1] if len(inside) < len(wanted) else path[1:-1])]
        at = path[-1]
    return np.array([*rows, at])
