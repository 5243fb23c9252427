"""Flows over segments of an orbit: what shooting needs of an integrator, event-exact or CVODES."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from continuation.errors import UnsupportedModel
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.cvodes_variational import VariationalIntegrator
from continuation.timedomain.dormand_prince import LARGEST_STEP
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.second_derivatives import form_gradients
from continuation.timedomain.trajectory import Trajectory, interpolate
from continuation.timedomain.variational import Tangents, sensitivities, tangents

_LOOSE = 1e-6  # relative tolerance while a first orbit is approached


class Path(Protocol):
    """Trajectories from the starts of m segments to their ends, and their derivatives."""

    ends: np.ndarray

    @property
    def matrices(self) -> np.ndarray:
        """Derivatives (m, n, n) of the ends by the starts."""
        ...

    @property
    def traces(self) -> np.ndarray:
        """Integrals (m,) of the trace of the Jacobian."""
        ...

    @property
    def factors(self) -> np.ndarray:
        """Matrices (K, n, n) whose product, the first applied first, is the monodromy matrix."""
        ...

    def sensitivities(self, direction: np.ndarray) -> np.ndarray:
        """Return derivatives (m, n) of the ends in a direction (q,) of the parameters."""
        ...

    def form_gradients(self, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gradients (m, n), (m, q) of ``w_i . M_i v_i`` by the starts and the parameters, for v, w (m, n)."""
        ...

    def waveform(self, count: int) -> np.ndarray:
        """Return states (count, n) at equidistant phases over all segments; count is a multiple of m."""
        ...


class ExactFlow:
    """Event-exact integration of a driven System in the excitation phase.

    ``noise`` is by how many tolerances the flow may fail to be smooth: steps are selected anew in every run.
    """

    noise = 1.0

    def __init__(self, integrator: ExactIntegrator) -> None:
        self.integrator, self.rtol, self.atol = integrator, integrator.rtol, integrator.atol

    def path(self, starts: np.ndarray, p: np.ndarray, phases: np.ndarray) -> ExactPath:
        """Integrate from starts (m, n) at phases[:-1] to phases[1:], (m + 1,)."""
        return ExactPath(self.integrator, starts, p, phases)

    def tight(self) -> ExactFlow:
        """Return the same with a tolerance a hundred times tighter, at least 1e-13, and half the longest step.

        Where the longest step binds and not the tolerance, the results would else be the same and tell no error.
        """
        rtol, atol = max(self.rtol / 100, 1e-13), max(self.atol / 100, 1e-15)
        return ExactFlow(self.integrator.with_tolerance(rtol, atol, LARGEST_STEP / 2))

    def settle(self, x: np.ndarray, p: np.ndarray, periods: int) -> np.ndarray:
        """Return the state after some excitation periods, at a loose tolerance."""
        ratio = max(1.0, _LOOSE / self.rtol)
        return self.integrator.with_tolerance(self.rtol * ratio, self.atol * ratio).integrate(x, p, periods).end

    def rate(self, x: np.ndarray, theta: float, p: np.ndarray) -> np.ndarray:
        """Return dx/dphase (n,)."""
        law = self.integrator.law(self.integrator.modes_at(x, theta, p))
        return self.integrator.functions.rate(x, theta, p, *law)[0]


class ExactPath:
    """See :class:`Path`; derivatives are made when first asked for."""

    def __init__(self, integrator: ExactIntegrator, starts: np.ndarray, p: np.ndarray, phases: np.ndarray) -> None:
        self._integrator, self._p, self._phases = integrator, p, phases
        self.runs: list[Trajectory] = []
        first = LARGEST_STEP / 8
        for x, start, end in zip(starts, phases[:-1], phases[1:], strict=True):
            self.runs.append(integrator.between(x, p, float(start), float(end), first))
            first = self.runs[-1].following
        self.ends = np.array([run.end for run in self.runs])

    @cached_property
    def _tangents(self) -> Tangents:
        return tangents(self._integrator, self.runs, self._p)

    @cached_property
    def matrices(self) -> np.ndarray:
        return np.array([self._tangents.whole(i) for i in range(len(self.runs))])

    @property
    def factors(self) -> np.ndarray:
        return self._tangents.matrices

    @property
    def traces(self) -> np.ndarray:
        return np.bincount(self._tangents.owner, self._tangents.traces, minlength=len(self.runs))

    def sensitivities(self, direction: np.ndarray) -> np.ndarray:
        return sensitivities(self._integrator, self._tangents, len(self.runs), self._p, direction)

    def form_gradients(self, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pairs = [
            form_gradients(self._integrator, run, self._tangents, i, self._p, v[i], w[i])
            for i, run in enumerate(self.runs)
        ]
        return np.array([x for x, _ in pairs]), np.array([y for _, y in pairs])

    def waveform(self, count: int) -> np.ndarray:
        phases = self._phases[0] + (self._phases[-1] - self._phases[0]) * np.arange(count) / count
        at = np.minimum(np.arange(count) * len(self.runs) // count, len(self.runs) - 1)
        return np.concatenate(
            [
                interpolate(run, c, phases[at == i])
                for i, (run, c) in enumerate(zip(self.runs, self._dense, strict=True))
            ]
        )

    @cached_property
    def _dense(self) -> list[np.ndarray]:
        return [self._integrator.interpolant(run, self._p) for run in self.runs]

    def contacts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return of every contact the phases (r,) of its changes and the pieces (r + 1,) before and after them."""
        found = []
        for i in range(self.runs[0].modes.shape[1]):
            changes = [c for run in self.runs for c in run.changes if c[1] == i]
            first = int(self.runs[0].modes[0, i])
            if changes and self.runs[0].places[:1] == (0,) and self.runs[0].changes[0][1] == i:
                first -= self.runs[0].changes[0][2]
            pieces = first + np.cumsum([0, *(c[2] for c in changes)])
            found.append((np.array([c[0] for c in changes]), pieces.astype(int)))
        return found


class SmoothFlow:
    """CVODES with the forward variational equation, for Systems without contacts.

    Raises
    ------
    UnsupportedModel
        If the System has contacts.
    """

    noise = 100.0

    def __init__(self, system: System, settings: CVODES) -> None:
        if system.contacts:
            raise UnsupportedModel(
                f"system {system.name!r} has contacts, whose corners CVODES steps across: use Shooting() without "
                "integrator, which is event-exact, or the smooth law system.smoothed(width)"
            )
        self.integrator, self.rtol, self.atol = VariationalIntegrator(system, settings), settings.rtol, settings.atol

    def path(self, starts: np.ndarray, p: np.ndarray, phases: np.ndarray) -> SmoothPath:
        """Integrate from starts (m, n) at phases[:-1] to phases[1:], (m + 1,)."""
        return SmoothPath(self.integrator, starts, p, phases)

    def tight(self) -> SmoothFlow:
        """Return the same with a tolerance a hundred times tighter, at least 1e-13."""
        new = object.__new__(SmoothFlow)
        new.rtol, new.atol = max(self.rtol / 100, 1e-13), max(self.atol / 100, 1e-15)
        new.integrator = self.integrator.with_tolerance(new.rtol, new.atol)
        return new

    def settle(self, x: np.ndarray, p: np.ndarray, periods: int) -> np.ndarray:
        """Return the state after some excitation periods."""
        return self.integrator.end(x, p, 0.0, 2 * np.pi * periods)

    def rate(self, x: np.ndarray, theta: float, p: np.ndarray) -> np.ndarray:
        """Return dx/dphase (n,)."""
        return self.integrator.rate(x, theta, p)


class SmoothPath:
    """See :class:`Path`; with derivatives the states are integrated once more together with them."""

    def __init__(
        self, integrator: VariationalIntegrator, starts: np.ndarray, p: np.ndarray, phases: np.ndarray
    ) -> None:
        self._integrator, self._starts, self._p, self._phases = integrator, starts, p, phases
        spans = zip(starts, phases[:-1], phases[1:], strict=True)
        self.ends = np.array([integrator.end(x, p, float(a), float(b)) for x, a, b in spans])

    def _all(self, direction: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float]]:
        spans = zip(self._starts, self._phases[:-1], self._phases[1:], strict=True)
        return [self._integrator.derivatives(x, self._p, float(a), float(b), direction) for x, a, b in spans]

    @cached_property
    def _known(self) -> list[tuple[np.ndarray, np.ndarray, float]]:
        return self._all(np.zeros(len(self._p)))

    @property
    def matrices(self) -> np.ndarray:
        return np.array([matrix for matrix, _, _ in self._known])

    @property
    def factors(self) -> np.ndarray:
        return self.matrices

    @property
    def traces(self) -> np.ndarray:
        return np.array([trace for _, _, trace in self._known])

    def sensitivities(self, direction: np.ndarray) -> np.ndarray:
        found = self._all(direction)
        self.__dict__.setdefault("_known", found)
        return np.array([push for _, push, _ in found])

    def form_gradients(self, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        exact = ExactIntegrator(self._integrator.system, rtol=self._integrator.rtol, atol=self._integrator.atol)
        return ExactPath(exact, self._starts, self._p, self._phases).form_gradients(v, w)

    def waveform(self, count: int) -> np.ndarray:
        each = count // len(self._starts)
        spans = zip(self._starts, self._phases[:-1], self._phases[1:], strict=True)
        return np.concatenate([self._integrator.samples(x, self._p, float(a), float(b), each) for x, a, b in spans])

    def contacts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return nothing: there are no contacts."""
        return []
