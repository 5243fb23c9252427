"""The argument of a contact along an orbit: its waveform, its extrema, and their derivatives, for every method.

Phases are those of the orbit here, 0..2*pi over its period. The derivative of the value of an extremum over the phase
in anything is that of the argument at fixed phase, because the one in the phase vanishes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from continuation.errors import NoConvergence
from continuation.model.system import System
from continuation.orbits.contact_series import evaluate
from continuation.orbits.spectrum import pack, unpack

_SAMPLES = 512  # of a path, per excitation period
_FLAT = 1e-9  # second derivative, relative to the size of the argument, below which an extremum is none


@dataclass(frozen=True, slots=True)
class Extremum:
    """Phase, value and second derivative by the phase of a local extremum of a contact argument."""

    phase: float
    value: float
    curvature: float

    @property
    def side(self) -> int:
        """1 for a maximum, -1 for a minimum."""
        return 1 if self.curvature < 0 else -1


def waves(problem: Any, u: np.ndarray, p: float) -> list[np.ndarray]:
    """Return the half spectrum of every contact argument along an orbit.

    Exact by harmonic balance; by shooting that of samples, good to about 1e-6 of the argument. Cost a Fourier
    transform, and by shooting an integration of the orbit.
    """
    problem, u = _driven(problem, u)
    count = len(problem.system.contacts)
    if hasattr(problem, "forces"):
        Y, vector = unpack(u, problem.ports.outputs), problem.vector(p)
        return [problem.forces.argument(i, Y, vector) for i in range(count)]
    segments, multiple = problem.count(u), problem.period_multiple
    samples = segments * -(-_SAMPLES * multiple // segments)
    states = problem.waveform(u, p, samples)
    theta = np.arange(samples) * (2 * np.pi * multiple / samples)
    found = np.array(_functions(problem.system)[0](states.T, theta.reshape(1, -1), problem.vector(p)))
    return list(np.fft.rfft(found.reshape(count, samples), axis=1)[:, : samples // 4] / samples)


def extremum(problem: Any, u: np.ndarray, p: float, contact: int, phase: float) -> Extremum:
    """Return the extremum of a contact argument next to a phase, exact to rounding or to the integrator's tolerance.

    Raises
    ------
    NoConvergence
        If there is none near.
    """
    problem, u = _driven(problem, u)
    if hasattr(problem, "forces"):
        Y = unpack(u, problem.ports.outputs)
        return nearest_extremum(problem.forces.argument(contact, Y, problem.vector(p)), phase)
    return _integrated_extremum(problem, u, p, contact, phase)


def nearest_extremum(wave: np.ndarray, phase: float) -> Extremum:
    """Return the extremum of a trigonometric polynomial (half spectrum) that Newton's method finds from a phase.

    >>> e = nearest_extremum(np.array([1.0, 0.5]), 0.2)     # 1 + cos(phase)
    >>> round(e.value, 12), round(e.curvature, 12), e.side
    (2.0, -1.0, 1)
    """
    start, reach, floor = phase, np.pi / max(len(wave) - 1, 1), _FLAT * float(np.abs(wave[1:]).sum())
    k = np.arange(len(wave))
    scaled = np.stack([wave * (2j * k), wave * -2.0 * k**2], axis=1)
    for _ in range(20):
        slope, bend = (np.exp(1j * k * phase) @ scaled).real
        if not abs(bend) > floor:
            break
        move = float(np.clip(-slope / bend, -reach, reach))
        phase += move
        if abs(move) < 1e-9:  # quadratic
            value = evaluate(wave, np.array([phase]))
            return Extremum(phase, float(value[0]), float(bend))
        if abs(phase - start) > 2 * np.pi:
            break
    raise NoConvergence("the extremum of the contact argument is lost: it merges with another one")


def extrema(wave: np.ndarray) -> list[Extremum]:
    """Return the local extrema of a trigonometric polynomial (half spectrum).

    >>> [(round(float(e.phase), 6), round(float(e.value), 6)) for e in extrema(np.array([1.0, 0.5]))]
    [(0.0, 2.0), (3.141593, 0.0)]
    """
    samples = np.fft.irfft(wave, 8 << max(len(wave) - 1, 2).bit_length(), norm="forward")
    turns = np.flatnonzero((samples - np.roll(samples, 1)) * (np.roll(samples, -1) - samples) <= 0)
    found: list[Extremum] = []
    for place in turns:
        try:
            top = nearest_extremum(wave, 2 * np.pi * place / len(samples))
        except NoConvergence:
            continue
        if all(abs(top.phase - other.phase) > 1e-6 for other in found):
            found.append(top)
    return found


def gradient(
    problem: Any, u: np.ndarray, p: float, contact: int, phase: float, names: list[str]
) -> tuple[np.ndarray, list[float]]:
    """Return the derivatives of a contact argument at a fixed phase in the unknown u (N,) and in parameters.

    Exact: by harmonic balance it is linear in u or known in closed form, by shooting the transition matrix is used.
    """
    inner, v = _driven(problem, u)
    free = [inner.free] if inner is not problem else []
    at = _of_spectrum if hasattr(inner, "forces") else _of_path
    by_u, by = at(inner, v, p, contact, phase, [*names, *free])
    if free:  # the last unknown of an autonomous System is unit * log(omega / omega_0)
        ahead = np.append(u[:-1], u[-1] + 1.0)
        omega, turn = problem.frequency_of(u), np.log(problem.frequency_of(ahead) / problem.frequency_of(u))
        by_u = np.append(by_u, by[-1] * omega * turn)
    return by_u, by[: len(names)]


def _driven(problem: Any, u: np.ndarray) -> tuple[Any, np.ndarray]:
    """Return the driven problem at the frequency of the unknown of an autonomous System, others as they are."""
    return (problem.inner, problem.split(u)) if problem.system.autonomous else (problem, u)


def _of_spectrum(
    problem: Any, u: np.ndarray, p: float, contact: int, phase: float, names: list[str]
) -> tuple[np.ndarray, list[float]]:
    ports, vector, multiple = problem.ports, problem.vector(p), problem.period_multiple
    Y = unpack(u, ports.outputs)
    y = evaluate(Y, np.array([phase]))[0]
    indices = [problem.system.parameter_names.index(n) for n in names]
    if ports.straight(contact):
        d = ports.linear(vector).d[contact]
        by = []
        for index in indices:
            offset = problem.forces.parameters.forcing(vector, index).offset[contact]
            turned = problem.forces.parameters.argument_slopes(vector, index)
            change = float(evaluate(offset, np.array([phase * multiple]))[0])
            by.append(change if turned is None else change + float(turned[contact] @ y))
    else:
        place, theta = ports.general.index(contact), np.array([phase * multiple])
        modes = ports.law.modes(y[:, None], theta, vector)
        d = ports.law.corner(y[:, None], theta, vector, modes)[1][place, :, 0]
        moves = ports.law.forms.moves(y[:, None], theta, vector)
        by = [float(moves[place, index, 0]) for index in indices]
    wave = np.exp(-1j * np.arange(len(Y)) * phase)
    return pack(wave[:, None] * d), by


def _piece(problem: Any, u: np.ndarray, p: float, phase: float) -> tuple[int, Any, float]:
    """Return the segment of shooting that a phase lies on, the path from its start to there, and the phase theta."""
    m, period = problem.count(u), 2 * np.pi * problem.period_multiple
    theta = phase * problem.period_multiple % period
    i = min(int(theta / period * m), m - 1)
    start = period * i / m
    if theta - start < 1e-6:  # from the start before, so that there is something to integrate
        i, theta = (i - 1, theta) if i else (m - 1, theta + period)
        start = period * i / m
    path = problem.integration.path(problem.states(u)[i : i + 1], problem.vector(p), np.array([start, theta]))
    return i, path, theta


def _integrated_extremum(problem: Any, u: np.ndarray, p: float, contact: int, phase: float) -> Extremum:
    """Find an extremum by the secant on the rate of the argument along the flow."""
    _, by_state, _, by_phase = _functions(problem.system)
    vector, multiple = problem.vector(p), problem.period_multiple

    def rate(at: float) -> tuple[float, np.ndarray, float]:
        _, path, theta = _piece(problem, u, p, at)
        x = path.ends[0]
        row = np.array(by_state(x, theta, vector))[contact]
        move = row @ problem.integration.rate(x, theta, vector) + float(by_phase(x, theta, vector)[contact])
        return multiple * float(move), x, theta

    before, step = rate(phase)[0], 1e-3
    for _ in range(12):
        here, x, theta = rate(phase + step)
        bend = (here - before) / step
        phase, before = phase + step, here
        step = float(np.clip(-here / bend, -0.05, 0.05)) if bend else 0.0
        if abs(step) < 1e-6:  # the value errs by its square
            value = np.array(_functions(problem.system)[0](x, theta, vector)).ravel()[contact]
            return Extremum(phase, float(value) + here * step / 2, float(bend))
    raise NoConvergence("the extremum of the contact argument is lost: it merges with another one")


def _of_path(
    problem: Any, u: np.ndarray, p: float, contact: int, phase: float, names: list[str]
) -> tuple[np.ndarray, list[float]]:
    i, path, theta = _piece(problem, u, p, phase)
    _, by_state, by_parameter, _ = _functions(problem.system)
    x, vector = path.ends[0], problem.vector(p)
    row = np.array(by_state(x, theta, vector))[contact]
    own = np.array(by_parameter(x, theta, vector))[contact]
    m, n = problem.count(u), len(x)
    out = np.zeros(m * n)
    out[i * n : (i + 1) * n] = row @ path.matrices[0] * np.sqrt(m)
    by = []
    for name in names:
        direction = problem.direction(name)
        by.append(float(own @ direction + row @ path.sensitivities(direction)[0]))
    return out, by


@lru_cache(maxsize=16)
def _functions(system: System) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """Return the contact arguments and their Jacobians by states, parameters and phase as functions."""
    a, given = system.arguments, [system.x, system.theta, system.p]
    parts = [a, ca.jacobian(a, system.x), ca.jacobian(a, system.p), ca.jacobian(a, system.theta)]
    return tuple(ca.Function("contact", given, [ca.densify(part)]) for part in parts)  # type: ignore[return-value]
