"""The map over excitation periods by any integrator, with samples of the states in between."""

from __future__ import annotations

from typing import Protocol

import casadi as ca
import numpy as np

from continuation.errors import ContinuationError, UnsupportedModel, nearest
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES, DrivenModel
from continuation.timedomain.exact import ExactIntegrator, describe
from continuation.timedomain.fixed_step import FixedStep, FixedStepIntegrator, SuitableSteps
from continuation.timedomain.kernels import Batch
from continuation.timedomain.simulate import EventExact
from continuation.timedomain.waveform import describe_waveform

SAMPLES = 64
"""States kept per excitation period."""

FEW = 256
"""Excitation periods whose samples are held at once: memory must not grow with their number."""

Integrator = CVODES | EventExact | FixedStep


class PeriodMap(Protocol):
    """What a study needs of an integrator.

    Attributes
    ----------
    floor : float
        Size in the unit of the states below which differences mean nothing.
    described_again : bool
        Whether :meth:`describe` integrates the periods it is about once more.
    """

    floor: float
    described_again: bool

    def set(self, p: np.ndarray) -> None:
        """Choose the parameters (q,)."""

    def ahead(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states (count, samples + 1, n) of some periods, each with both ends."""

    def strobe(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states (count, n) at the end of some periods."""

    def describe(self, x: np.ndarray, count: int, waves: np.ndarray, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return rms, mean, minimum and maximum (q, 4) of the quantities over periods from x, and states at phase 0.

        ``waves`` (count, samples + 1, n) are these periods; not looked at where :attr:`described_again`.
        """

    def quantity(self, waves: np.ndarray) -> np.ndarray:
        """Return the first quantity at the samples of periods (count, samples + 1, n), shape (count * samples,)."""

    def step_error(self, x: np.ndarray, count: int) -> float:
        """Return the error of the state after some periods from x, by other steps; NaN where that is not known."""


def period_map(system: System, integrator: Integrator | None, quantities: tuple[str, ...]) -> PeriodMap:
    """Build the map of a driven System.

    Parameters
    ----------
    integrator : CVODES, EventExact or FixedStep, optional
        When absent, ``FixedStep`` of order 4 with as many steps as the System needs at each parameter value.
    quantities : tuple of str
        States or outputs to describe.

    Raises
    ------
    UnsupportedModel
        If the System is autonomous.
    ValueError
        If there is no such quantity.
    """
    if system.frequency is None:
        raise UnsupportedModel(
            f"system {system.name!r} is autonomous and has no excitation period to integrate over; "
            "only models with a phase are treated here"
        )
    known = (*system.state_names, *system.output_names)
    for name in quantities:
        if name not in known:
            raise ValueError(f"system {system.name!r} has no state or output {name!r}; {nearest(name, known)}")
    if integrator is None or isinstance(integrator, FixedStep):
        return FixedMap(system, integrator, quantities)
    return SampledMap(system, integrator, quantities)


class FixedMap:
    """Fixed steps: statistics are integrals along the steps, several periods go in one call of machine code."""

    described_again = True
    floor = 1e-2

    def __init__(self, system: System, settings: FixedStep | None, quantities: tuple[str, ...]) -> None:
        self._base = (FixedStep() if settings is None else settings).compile(system, quantities)
        self._suitable = SuitableSteps(system) if settings is None else None
        self._with = {self._base.settings.steps_per_period: self._base}
        self._phases = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
        self._now, self._p = self._base, system.parameter_vector()
        self._quantities = exact_quantities(system, quantities[:1])

    @property
    def steps(self) -> int:
        """Steps per period at the present parameters."""
        return self._now.settings.steps_per_period

    @property
    def note(self) -> str:
        """What was compiled, or why nothing was."""
        return self._base.note

    def set(self, p: np.ndarray) -> None:
        """Choose the parameters, and the number of steps they need."""
        self._p = p.copy()
        if self._suitable is not None:
            self._now = self._of(self._suitable(p))

    def _of(self, steps: int) -> FixedStepIntegrator:
        if steps not in self._with:
            self._with[steps] = self._base.with_steps(steps)
        return self._with[steps]

    def ahead(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states of some periods."""
        run = self._now.run(x, self._p, count, phases=self._phases)
        return np.concatenate([run.samples, run.strobe[1:, None]], axis=1)

    def strobe(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states at the end of some periods."""
        return self._now.run(x, self._p, count).strobe[1:]

    def describe(self, x: np.ndarray, count: int, waves: np.ndarray, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
        """March the periods once more with statistics."""
        run = self._now.run(x, self._p, count, statistics=True)
        mean = run.mean.mean(axis=0)
        variance = run.variance.mean(axis=0) + run.mean.var(axis=0)
        numbers = [np.sqrt(variance), mean, run.minimum.min(axis=0), run.maximum.max(axis=0)]
        return np.column_stack(numbers), run.strobe

    def quantity(self, waves: np.ndarray) -> np.ndarray:
        """Return the first quantity at the samples."""
        return at_samples(self._quantities, waves, self._p)[0]

    def step_error(self, x: np.ndarray, count: int) -> float:
        """Compare with steps of half the length."""
        whole, half = (f.run(x, self._p, count).end for f in (self._now, self._of(2 * self.steps)))
        return float(abs(whole - half).max())


class SampledMap:
    """CVODES or event-exact integration: statistics from the samples, outputs with the exact contact laws."""

    described_again = False

    def __init__(self, system: System, settings: CVODES | EventExact, quantities: tuple[str, ...]) -> None:
        self._p, self.floor = system.parameter_vector(), settings.atol / settings.rtol
        self._names, self._clock = system.state_names, system.parameter_names.index(str(system.frequency))
        self._period = None if isinstance(settings, EventExact) else settings.compile(DrivenModel.of(system))
        self._exact = None
        if isinstance(settings, EventExact):
            self._exact = ExactIntegrator(system, rtol=settings.rtol, atol=settings.atol, steps=settings.steps)
            self.floor = 1e-2
        self._quantities = exact_quantities(system, quantities)

    def set(self, p: np.ndarray) -> None:
        """Choose the parameters."""
        self._p = p.copy()

    def ahead(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states of some periods, one after the other."""
        waves: list[np.ndarray] = []
        for k in range(count):
            try:
                waves.append(self._one(x))
            except ContinuationError as error:
                state = describe(dict(zip(self._names, x.tolist(), strict=True)))
                begin = 2 * np.pi * k / self._p[self._clock]
                error.args = (f"{error}, in the period that begins at time {begin:.6g} with state {state}",)
                raise
            x = waves[-1][-1]
        return np.array(waves)

    def _one(self, x: np.ndarray) -> np.ndarray:
        if self._period is not None:
            return self._period.period(x, self._p)
        assert self._exact is not None
        run = self._exact.integrate(x, self._p)
        inside = self._exact.sample(run, self._p, 2 * np.pi * np.arange(SAMPLES) / SAMPLES)
        return np.vstack([inside, run.end])

    def strobe(self, x: np.ndarray, count: int) -> np.ndarray:
        """Return the states at the end of some periods."""
        return self.ahead(x, count)[:, -1]

    def describe(self, x: np.ndarray, count: int, waves: np.ndarray, periodic: bool) -> tuple[np.ndarray, np.ndarray]:
        """Describe the samples at hand."""
        values = at_samples(self._quantities, waves, self._p)
        return np.array([describe_waveform(v, periodic) for v in values]), np.vstack([waves[:, 0], waves[-1:, -1]])

    def quantity(self, waves: np.ndarray) -> np.ndarray:
        """Return the first quantity at the samples."""
        return at_samples(self._quantities, waves, self._p)[0]

    def step_error(self, x: np.ndarray, count: int) -> float:
        """Not known: these integrators keep their own tolerances."""
        return np.nan


def exact_quantities(system: System, names: tuple[str, ...]) -> Batch:
    """Return ``x, theta, p -> `` states or outputs of those names, with the exact contact laws, at many points."""
    known = dict(zip(system.state_names, ca.vertsplit(system.x), strict=True))
    if system.output_names:
        law = ca.substitute(system.outputs, system.phi, system.forces()) if system.contacts else system.outputs
        known |= dict(zip(system.output_names, ca.vertsplit(law), strict=True))
    wanted = ca.vertcat(*(known[name] for name in names)) if names else ca.SX(0, 1)
    return Batch(ca.Function("quantities", [system.x, system.theta, system.p], [ca.densify(wanted)]))


def at_samples(quantities: Batch, waves: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return quantities (q, count * samples) at the samples of periods (count, samples + 1, n)."""
    samples = waves.shape[1] - 1
    phases = np.tile(2 * np.pi * np.arange(samples) / samples, len(waves))
    points = waves[:, :-1].reshape(-1, waves.shape[2])
    return quantities(points, phases, np.broadcast_to(p, (len(phases), len(p))))[0][:, 0].T
