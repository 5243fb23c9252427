"""Event-exact integration: high-order steps inside contact modes that end on every contact change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from continuation.errors import ContinuationError
from continuation.model.system import System
from continuation.timedomain.contact_changes import first_change
from continuation.timedomain.runge_kutta import step_functions

_LARGEST_STEP = np.pi / 4  # in phase: a stiffness harmonic must not slip through a step that meets a zero of the force
_HALVINGS = 8  # of a step of the state, where its derivatives vary faster


@dataclass(slots=True)
class Trajectory:
    """Record accepted steps; every step lies in one contact mode.

    Attributes
    ----------
    phases : list of float, length k + 1
        Phases in radians at the ends of the steps.
    states : list of ndarray (n,), length k + 1
        States there.
    modes : list of tuple of int, length k
        Index of the linear piece of every contact during each step.
    changes : list of (phase, contact index, direction)
        Contact changes; direction +1 when the argument increases.
    """

    phases: list[float]
    states: list[np.ndarray]
    modes: list[tuple[int, ...]] = field(default_factory=list)
    changes: list[tuple[float, int, int]] = field(default_factory=list)

    @property
    def end(self) -> np.ndarray:
        """Return the last state, shape (n,)."""
        return self.states[-1]


class ExactIntegrator:
    """Integrate a driven System in the excitation phase with its exact contact laws.

    Parameters
    ----------
    system : System
        Driven model, with or without contacts.
    parameter : str
        Parameter for which :meth:`transition` returns derivatives.
    rtol, atol : float
        Tolerances of the local error, relative and absolute in the unit of the states.
    steps : int
        Largest number of steps, rejected ones included, per excitation period.

    Notes
    -----
    Dormand-Prince 8(5,3) in the linear piece of every contact. All roots of a contact argument at a breakpoint inside a
    step are sought on its Chebyshev interpolant, also pairs of them, so that a contact shorter than a step is seen.
    The step is then repeated up to the first root, which Newton's method polishes on the step itself. The force is
    continuous, so the state and its derivatives carry over a change as they are (the saltation matrix is the identity;
    Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, chapter 7).
    A step of a 14-state gear costs about 40 microseconds, carrying the derivatives over it about 150.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> free = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, phase=theta,
    ...               frequency="omega", parameters={"omega": (omega, 1.0)})
    >>> run = ExactIntegrator(free, "omega").integrate([1.0, 0.0], free.parameter_vector())
    >>> bool(abs(run.end - [1.0, 0.0]).max() < 1e-9)
    True
    """

    def __init__(
        self, system: System, parameter: str, *, rtol: float = 1e-10, atol: float = 1e-12, steps: int = 2000
    ) -> None:
        self.system, self.parameter = system, parameter
        self.rtol, self.atol, self.steps = rtol, atol, steps
        self.functions = step_functions(system, parameter)
        self._laws = [(np.array(c.slopes), c.intercepts, np.array(c.breakpoints)) for c in system.contacts]

    def with_tolerance(self, rtol: float, atol: float) -> ExactIntegrator:
        """Return the same integrator with other tolerances; functions are shared."""
        new = object.__new__(ExactIntegrator)
        new.__dict__.update(self.__dict__)
        new.rtol, new.atol = rtol, atol
        return new

    def integrate(self, x: np.ndarray | list[float], p: np.ndarray, periods: int = 1) -> Trajectory:
        """Integrate from phase 0 over excitation periods.

        Parameters
        ----------
        x : array (n,)
            State at phase 0.
        p : array (q,)
            All parameters of the System in order.
        periods : int
            Number of excitation periods.

        Raises
        ------
        ContinuationError
            If the state leaves the finite numbers, or the steps do not suffice; it names phase and parameters.
        """
        x = np.array(x, dtype=float)
        run = Trajectory([0.0], [x])
        arguments = self.functions.guard(x, 0.0, p, 0.0, 0.0)[0]  # they do not depend on the mode
        modes = [int(c.mode(a)) for c, a in zip(self.system.contacts, arguments, strict=True)]
        end, h = 2 * np.pi * periods, _LARGEST_STEP / 8
        for _ in range(self.steps * periods):
            left = end - run.phases[-1]
            if left <= 1e-13 * end:
                run.phases[-1] = end
                return run
            h = self._advance(run, modes, min(h, left), p)
            if not h > 1e-13 * end:
                break
        raise self._failure(run, p)

    def _advance(self, run: Trajectory, modes: list[int], h: float, p: np.ndarray) -> float:
        """Try one step; record it when it is accurate, up to the first contact change; return the next length."""
        x, theta = run.states[-1], run.phases[-1]
        law = self._mode_law(modes)
        x1, error, sampled = self.functions.step(x, theta, h, p, *law)
        with np.errstate(all="ignore"):  # a state that runs away is rejected below
            size = _error_norm(error / (self.atol + self.rtol * np.maximum(abs(x), abs(x1)))[:, None])
        if not size < 1.0:  # also when it is not a number
            return h * (max(0.9 * size**-0.125, 0.2) if np.isfinite(size) else 0.1)
        proposed = min(h * min(5.0, 0.9 * size**-0.125 if size > 0 else 5.0), _LARGEST_STEP)
        resolved, change = first_change(sampled, [b for _, _, b in self._laws], modes)
        if not resolved:
            return h / 2
        if change is None:
            _record(run, theta + h, x1, modes)
            return proposed
        return self._land(run, modes, h, change, p, proposed)

    def _land(
        self,
        run: Trajectory,
        modes: list[int],
        h: float,
        change: tuple[float, int, int],
        p: np.ndarray,
        proposed: float,
    ) -> float:
        """Repeat the step up to the contact change and switch the mode there."""
        fraction, i, direction = change
        x, theta, law = run.states[-1], run.phases[-1], self._mode_law(modes)
        target = self._laws[i][2][modes[i] if direction > 0 else modes[i] - 1]
        length = max(fraction, 0.0) * h
        if length > 0:
            for _ in range(4):
                x1 = self.functions.step(x, theta, length, p, *law)[0]
                value, rate = self.functions.guard(x1, theta + length, p, *law)
                miss = value[i] - target
                correction = miss / rate[i] if rate[i] * direction > 0 else np.inf
                # Grazing: the rate vanishes, and an instant missed by d costs d times the miss, which is negligible.
                if abs(miss) <= 1e-14 * (1 + abs(target)) or abs(correction) > 1e-3 * h:
                    break
                length -= correction
            if abs(miss) > 1e-7 * (1 + abs(target)):
                return h / 2
            _record(run, theta + length, x1, modes)
        run.changes.append((run.phases[-1], i, direction))
        modes[i] += direction
        return proposed

    def _mode_law(self, modes: list[int] | tuple[int, ...]) -> tuple[list[float], list[float]]:
        pieces = [(s[j], c[j]) for (s, c, _), j in zip(self._laws, modes, strict=True)]
        return [s for s, _ in pieces], [c for _, c in pieces]

    def transition(self, run: Trajectory, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Differentiate a trajectory along its own steps.

        Returns
        -------
        monodromy : ndarray (n, n)
            Derivative of the last state with respect to the first.
        sensitivity : ndarray (n,)
            Derivative of the last state with respect to the parameter.
        trace : float
            Integral of the trace of the Jacobian, the logarithm of the determinant by Liouville's formula.
        """
        n = len(run.end)
        s, total = np.eye(n, n + 1), 0.0
        for k, modes in enumerate(run.modes):
            h = run.phases[k + 1] - run.phases[k]
            s, trace = self._differentiate(run.states[k], run.phases[k], h, p, self._mode_law(modes), s)
            total += trace
        return s[:, :n], s[:, n], total

    def _differentiate(
        self, x: np.ndarray, theta: float, h: float, p: np.ndarray, law: tuple, s: np.ndarray, depth: int = 0
    ) -> tuple[np.ndarray, float]:
        """Carry the derivatives over a step, in halves where they vary faster than the state that sized the step."""
        after, (fifth, third), trace = self.functions.transition(x, theta, h, p, *law, s)
        error = np.divide(fifth, np.sqrt(fifth + 0.01 * third), out=np.zeros_like(fifth), where=fifth > 0)
        scale = np.sqrt(np.maximum((s**2).sum(axis=0), (after**2).sum(axis=0)))
        if depth == _HALVINGS or not np.any(error > self.rtol * scale):
            return after, float(trace[0])
        middle = self.functions.step(x, theta, h / 2, p, *law)[0]
        s, first = self._differentiate(x, theta, h / 2, p, law, s, depth + 1)
        s, second = self._differentiate(middle, theta + h / 2, h / 2, p, law, s, depth + 1)
        return s, first + second

    def sample(self, run: Trajectory, p: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """Evaluate a trajectory at increasing phases inside it, shape (len(phases), n), as accurately as its steps."""
        at = np.clip(np.searchsorted(run.phases, phases, side="right") - 1, 0, len(run.modes) - 1)
        rows = []
        for k, phase in zip(at, phases, strict=True):
            law = self._mode_law(run.modes[k])
            rows.append(self.functions.step(run.states[k], run.phases[k], phase - run.phases[k], p, *law)[0])
        return np.array(rows)

    def _failure(self, run: Trajectory, p: np.ndarray) -> ContinuationError:
        values = describe(dict(zip(self.system.parameter_names, p, strict=True)))
        return ContinuationError(
            f"event-exact integration of {self.system.name!r} stopped at phase {run.phases[-1]:.6g} after "
            f"{len(run.modes)} accepted steps ({values}): the state runs away, the model is too stiff for an explicit "
            f"method, or contacts chatter; check the model there, loosen rtol = {self.rtol:g}, or allow more than "
            f"{self.steps} steps a period"
        )


def describe(values: Mapping[str, float]) -> str:
    """Return ``name = value`` pairs for messages.

    >>> describe({"omega": 0.75, "zeta": 0.05})
    'omega = 0.75, zeta = 0.05'
    """
    return ", ".join(f"{k} = {v:.10g}" for k, v in values.items())


def _record(run: Trajectory, phase: float, x: np.ndarray, modes: list[int]) -> None:
    run.phases.append(float(phase))
    run.states.append(x)
    run.modes.append(tuple(modes))


def _error_norm(scaled: np.ndarray) -> float:
    """Combine the 5th and 3rd order estimates as in the code DOP853 of Hairer and Wanner."""
    fifth, third = (scaled**2).sum(axis=0)
    return 0.0 if fifth == 0 else float(fifth / np.sqrt((fifth + 0.01 * third) * len(scaled)))
