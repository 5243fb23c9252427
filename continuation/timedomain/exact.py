"""Event-exact integration: high-order steps inside contact modes that end on every contact change."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from continuation.errors import Chattering, ContinuationError, Runaway, TooManySteps
from continuation.model.system import System
from continuation.timedomain.contact_changes import first_change
from continuation.timedomain.dormand_prince import CONTACT, ENDED, LARGEST_STEP, STUCK
from continuation.timedomain.runge_kutta import step_functions
from continuation.timedomain.trajectory import Run, Trajectory

_FIRST_STEP = LARGEST_STEP / 8
_LOST = 1e100  # size of a state that has run away, however it began
_RUNAWAY = 1e6  # growth of the state over an integration that counts as running away, once the steps are used up


class ExactIntegrator:
    """Integrate a driven System in the excitation phase with its exact contact laws.

    Parameters
    ----------
    system : System
        Driven model, with or without contacts.
    rtol, atol : float
        Tolerances of the local error, relative and absolute in the unit of the states.
    steps : int
        Largest number of steps, rejected ones included, per excitation period.
    machine_code : bool, optional
        Compile at once (True), never (False), or once it pays (None).

    Notes
    -----
    Dormand-Prince 8(5,3) in the linear piece of every contact. All roots of a contact argument at a breakpoint inside a
    step are sought on its Chebyshev interpolant, also pairs of them, so that a contact shorter than a step is seen.
    The step is then repeated up to the first root, which Newton's method polishes on the step itself. The force is
    continuous, so the state and its derivatives carry over a change as they are (the saltation matrix is the identity;
    Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, chapter 7).
    A step of a 14-state gear costs about 20 microseconds, 3 as machine code.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> free = System(name="free", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, phase=theta,
    ...               frequency="omega", parameters={"omega": (omega, 1.0)})
    >>> run = ExactIntegrator(free).integrate([1.0, 0.0], free.parameter_vector())
    >>> bool(abs(run.end - [1.0, 0.0]).max() < 1e-9)
    True
    """

    def __init__(
        self,
        system: System,
        *,
        rtol: float = 1e-10,
        atol: float = 1e-12,
        steps: int = 2000,
        machine_code: bool | None = None,
    ) -> None:
        self.system, self.rtol, self.atol, self.steps, self.longest = system, rtol, atol, steps, LARGEST_STEP
        self.functions = step_functions(system, machine_code)
        self._laws = [(np.array(c.slopes), c.intercepts, np.array(c.breakpoints)) for c in system.contacts]

    def with_tolerance(self, rtol: float, atol: float, longest: float = LARGEST_STEP) -> ExactIntegrator:
        """Return the same integrator with other tolerances and another longest step; functions are shared."""
        new = object.__new__(ExactIntegrator)
        new.__dict__.update(self.__dict__)
        new.rtol, new.atol, new.longest = rtol, atol, longest
        return new

    def integrate(self, x: np.ndarray | list[float], p: np.ndarray, periods: int = 1) -> Trajectory:
        """Integrate from phase 0 over excitation periods; see :meth:`between`."""
        return self.between(x, p, 0.0, 2 * np.pi * periods)

    def between(
        self, x: np.ndarray | list[float], p: np.ndarray, start: float, end: float, first: float = _FIRST_STEP
    ) -> Trajectory:
        """Integrate from one phase to another.

        Parameters
        ----------
        x : array (n,)
            State at the start.
        p : array (q,)
            All parameters of the System in order.
        start, end : float
            Phases in rad.
        first : float
            Length of the first step tried.

        Raises
        ------
        Runaway, Chattering, TooManySteps
            If the state leaves the finite numbers, contacts change again and again without an end, or the steps do
            not suffice; the error names phase and parameters.
        """
        x = np.array(x, dtype=float)
        run, h = Run(start, x, self.modes_at(x, start, p)), first
        left = int(np.ceil(self.steps * max(1.0, (end - start) / (2 * np.pi))))
        self.functions.count(int(8 * (end - start)))
        constants = self._constants(run.pieces, p, end)
        while left > 0:
            table = self.functions.march(np.concatenate([run.x, [run.theta, h, 0.0]]), constants)[0].T
            state = table[-1, -1]
            left -= len(table) if state == 0 else int(np.argmax(table[:, -1] != 0)) + 1
            phases = table[:, -3]
            taken = phases > np.concatenate([[run.theta], phases[:-1]])
            run.add(phases[taken], table[taken, :-3])
            h = float(table[-1, -2])
            if state == ENDED:
                return run.done(start, x, h)
            if state == CONTACT:
                changes = len(run.changes)
                h = self._advance(run, min(h, end - run.theta), p)
                if end - run.theta <= 1e-13 * max(abs(end), 1.0):
                    run.phases[-1][-1] = end
                    return run.done(start, x, h)
                if len(run.changes) > changes:
                    constants = self._constants(run.pieces, p, end)
            if state == STUCK or not h > 1e-14 * max(abs(end), 1.0):
                break
        raise self._failure(run, x, p)

    def modes_at(self, x: np.ndarray, theta: float, p: np.ndarray) -> list[int]:
        """Return the linear piece of every contact at a state."""
        if not self._laws:
            return []
        zeros = np.zeros(len(self._laws))
        arguments = self.functions.guard(x, theta, p, zeros, zeros)[0]  # they do not depend on the mode
        return [int(c.mode(a)) for c, a in zip(self.system.contacts, arguments, strict=True)]

    def law(self, pieces: tuple[int, ...] | list[int] | np.ndarray) -> tuple[list[float], list[float]]:
        """Return slopes (m,) and intercepts (m,) of a contact mode."""
        chosen = [(s[j], c[j]) for (s, c, _), j in zip(self._laws, pieces, strict=True)]
        return [s for s, _ in chosen], [c for _, c in chosen]

    def breakpoints(self) -> list[np.ndarray]:
        """Return the breakpoints of every contact."""
        return [b for _, _, b in self._laws]

    def _constants(self, pieces: list[int], p: np.ndarray, end: float) -> np.ndarray:
        """Return the second argument of the march in a contact mode."""
        slopes, intercepts = self.law(pieces)
        edges = [np.concatenate([[-np.inf], b, [np.inf]]) for _, _, b in self._laws]
        low, high = ([e[j + k] for e, j in zip(edges, pieces, strict=True)] for k in (0, 1))
        return np.concatenate([p, slopes, intercepts, low, high, [end, self.longest, self.rtol, self.atol]])

    def _advance(self, run: Run, h: float, p: np.ndarray) -> float:
        """Try one step near a contact change; record it up to the first change; return the next length."""
        law = self.law(run.pieces)
        x1, error, sampled = self.functions.step(run.x, run.theta, h, p, *law)
        size = _error_norm(error / (self.atol + self.rtol * np.maximum(abs(run.x), abs(x1)))[:, None])
        proposed = min(h * min(5.0, 0.9 * size**-0.125 if size > 0 else 5.0), self.longest)
        negligible = 0.01 * (self.atol + self.rtol)
        resolved, change = first_change(sampled, self.breakpoints(), run.pieces, negligible)
        if not resolved:
            return h / 2
        if change is None:
            run.add(np.array([run.theta + h]), x1[None])
            return proposed
        return self._land(run, h, change, p, proposed)

    def _land(self, run: Run, h: float, change: tuple[float, int, int], p: np.ndarray, proposed: float) -> float:
        """Repeat the step up to the contact change and switch the mode there."""
        fraction, i, direction = change
        law = self.law(run.pieces)
        target = self._laws[i][2][run.pieces[i] if direction > 0 else run.pieces[i] - 1]
        length = max(fraction, 0.0) * h
        if length > 0:
            correction = 0.0
            for _ in range(5):
                length -= correction
                x1 = self.functions.step(run.x, run.theta, length, p, *law)[0]
                value, rate = self.functions.guard(x1, run.theta + length, p, *law)
                miss = value[i] - target
                correction = miss / rate[i] if rate[i] * direction > 0 else np.inf
                # Grazing: the rate vanishes, and an instant missed by d costs d times the miss, which is negligible.
                if abs(miss) <= 1e-14 * (1 + abs(target)) or abs(correction) > 1e-3 * h:
                    break
            if abs(miss) > 1e-7 * (1 + abs(target)):
                return h / 2
            if run.theta + length > run.theta:
                run.add(np.array([run.theta + length]), x1[None])
                if miss * direction < -1e-14 * (1 + abs(target)) and not np.isfinite(correction):
                    return proposed  # the interpolant said it passes, but it turns back just before
        run.changes.append((run.theta, i, direction))
        run.places.append(len(run.modes))
        run.pieces[i] += direction
        return proposed

    def laws_of(self, modes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return slopes (k, m) and intercepts (k, m) of the modes (k, m) of steps."""
        if not self._laws:
            return np.zeros((len(modes), 0)), np.zeros((len(modes), 0))
        columns = [(s[j], c[j]) for (s, c, _), j in zip(self._laws, modes.T, strict=True)]
        return np.stack([s for s, _ in columns], axis=1), np.stack([c for _, c in columns], axis=1)

    def sample(self, run: Trajectory, p: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """Evaluate a trajectory at phases inside it, shape (len(phases), n), as accurately as its steps."""
        at = np.clip(np.searchsorted(run.phases, phases, side="right") - 1, 0, len(run.modes) - 1)
        laws = [law[at] for law in self.laws_of(run.modes)]
        h = np.asarray(phases, dtype=float) - run.phases[at]
        return self.functions.advance(run.states[at], run.phases[at], h, np.tile(p, (len(at), 1)), *laws)[0][:, 0]

    def interpolant(self, run: Trajectory, p: np.ndarray) -> np.ndarray:
        """Return the coefficients (k, 8, n) of the interpolants of the steps of a trajectory."""
        count = len(run.modes)
        h = np.diff(run.phases)
        laws = self.laws_of(run.modes)
        return self.functions.dense(run.states[:-1], run.phases[:-1], h, np.tile(p, (count, 1)), *laws)[0]

    def _failure(self, run: Run, x: np.ndarray, p: np.ndarray) -> ContinuationError:
        values = dict(zip(self.system.parameter_names, p.tolist(), strict=True))
        state = describe(dict(zip(self.system.state_names, run.x.tolist(), strict=True)))
        where = (
            f"event-exact integration of {self.system.name!r} stopped at phase {run.theta:.6g} (time "
            f"{run.theta / values[str(self.system.frequency)]:.6g}) after {len(run.modes)} accepted steps "
            f"({describe(values)}) in the state {state}: "
        )
        with np.errstate(all="ignore"):
            size, rate = abs(run.x).max(), self.functions.rate(run.x, run.theta, p, *self.law(run.pieces))[0]
        if not np.all(np.isfinite(rate)) or size / _RUNAWAY > 1 + abs(x).max() or size > _LOST:
            text = f"the state runs away, its largest component is {size:.3g}; check the model or start elsewhere"
            return Runaway(where + text, run.theta, values)
        if 4 * len(run.changes) > len(run.modes) and len(run.changes) > 20:
            text = (
                f"contacts chatter, {len(run.changes)} contact changes so far; an argument stays at a breakpoint, "
                "as with zero load: change the load, or use system.smoothed(width)"
            )
            return Chattering(where + text, run.theta, values)
        text = (
            f"{self.steps} steps a period do not suffice, the model is too stiff for an explicit method at rtol = "
            f"{self.rtol:g}, or the state runs away (largest component {size:.3g}); allow more steps, loosen rtol, or "
            "for a smooth System use Shooting(integrator=CVODES(stiff=True))"
        )
        return TooManySteps(where + text, run.theta, values)


def describe(values: Mapping[str, float]) -> str:
    """Return ``name = value`` pairs for messages.

    >>> describe({"omega": 0.75, "zeta": 0.05})
    'omega = 0.75, zeta = 0.05'
    """
    return ", ".join(f"{k} = {v:.10g}" for k, v in values.items())


def _error_norm(scaled: np.ndarray) -> float:
    """Combine the 5th and 3rd order estimates as in the code DOP853 of Hairer and Wanner."""
    fifth, third = (scaled**2).sum(axis=0)
    return 0.0 if fifth == 0 else float(fifth / np.sqrt((fifth + 0.01 * third) * len(scaled)))
