"""Second and third derivatives of the port force along an orbit, exact also at contact changes.

With w the port force, w'' and w''' are distributions: inside the modes of the contacts those of the smooth law, at a
contact change jumps of the slope over the speed |a'| of the contact argument there. So everything is finite sums over
contact changes plus integrals of smooth functions, exact for contacts and singular where they graze.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from continuation.errors import UnsupportedModel
from continuation.orbits import contact_series as series
from continuation.orbits.port_force import trimmed
from continuation.orbits.shifted import CriticalForm, ShiftedOperator, Wave, as_wave
from continuation.orbits.spectrum import pack

Array = np.ndarray
_Law = Callable[..., Array]


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes of one contact along an orbit, r of them.

    ``phases`` (r,), ``rate`` (2, r) first and second derivative of the argument by the phase, ``jump`` (r,) slope above
    the breakpoint less slope below, ``push`` (m, r) port force per contact force, ``direction`` (k, r) derivative of
    the argument by the ports.
    """

    phases: Array
    rate: Array
    jump: Array
    push: Array
    direction: Array

    @property
    def weight(self) -> Array:
        """Strength (r,) of the pulse that the slope of the contact force has in its derivative."""
        return self.jump / np.abs(self.rate[0]) / (2 * np.pi)


class Curvature:
    """Second and third derivatives of the port force along one orbit (u, p) of a harmonic-balance problem."""

    def __init__(self, problem: Any, Y: Array, vector: Array) -> None:
        self.problem, self.Y, self.vector = problem, Y, vector
        self.law = problem.ports.law.forms if problem.ports.smooth else None

    @cached_property
    def changes(self) -> list[Changes]:
        """Changes of every contact."""
        return [self._changes(i) for i in range(len(self.problem.system.contacts))]

    def _changes(self, i: int) -> Changes:
        ports, contact, n = self.problem.ports, self.problem.system.contacts[i], self.problem.period_multiple
        argument = self.problem.forces.argument(i, self.Y, self.vector)
        pattern = self.problem.forces.pattern(i, trimmed(argument))
        phases = pattern.phases
        rate = np.array([series.evaluate(argument, phases, d) for d in (1, 2)])
        jump = np.diff(np.array(contact.slopes)[pattern.modes]) * np.sign(rate[0])
        if i in ports.closed:
            push = series.evaluate(ports.forcing(self.vector).gain[i].T, phases * n).T
            direction = np.repeat(ports.linear(self.vector).d[i][:, None], len(phases), axis=1)
            return Changes(phases, rate, jump, push, direction)
        place = ports.general.index(i)
        y, theta = series.evaluate(self.Y, phases).T, phases * n
        modes = ports.law.modes(y, theta, self.vector).reshape(len(ports.general), -1)
        modes[place] = pattern.modes[:-1]
        pushes, directions = ports.law.corner(y, theta, self.vector, modes)
        return Changes(phases, rate, jump, pushes[:, place], directions[place])

    # ---------------------------------------------------------------- scalars and spectra
    def twice(self, left: Wave, a: Wave, b: Wave) -> complex:
        """Return the mean over the period of ``left . w'' a b``; the shifts must add to a whole number."""
        total = 0.0j
        for c in self.changes:
            if c.phases.size:
                total += np.sum(c.weight * _dot(left, c.push, c.phases) * _moved(a, c) * _moved(b, c))
        if self.law is not None:

            def values(y: Array, theta: Array, modes: Array | None, at: Callable[[Wave], Array]) -> Array:
                assert self.law is not None
                bent = _multilinear(lambda *v: self.law.second(y, theta, self.vector, modes, *v), at(a), at(b))  # type: ignore[union-attr]
                return np.asarray((at(left) * bent).sum(axis=0)[None])

            total += self._spectrum(values, 0)[0, 0]
        return complex(total)

    def thrice(self, left: Wave, a: Wave, b: Wave, c: Wave) -> complex:
        """Return the mean over the period of ``left . w''' a b c``.

        A contact adds ``jump delta'(argument)``, whose integral is that of ``-d/dphase (rest / a') / |a'|``.

        Raises
        ------
        UnsupportedModel
            For contacts that enter non-linearly.
        """
        if self.problem.ports.general:
            raise UnsupportedModel("third derivatives at changes of a contact that enters non-linearly are not known")
        total = 0.0j
        for i, change in enumerate(self.changes):
            if change.phases.size:
                total += self._corner_cubic(i, change, left, (a, b, c))
        if self.law is not None:

            def values(y: Array, theta: Array, modes: Array | None, at: Callable[[Wave], Array]) -> Array:
                bent = _multilinear(
                    lambda *v: self.law.third(y, theta, self.vector, modes, *v),  # type: ignore[union-attr]
                    at(a),
                    at(b),
                    at(c),
                )
                return np.asarray((at(left) * bent).sum(axis=0)[None])

            total += self._spectrum(values, 0)[0, 0]
        return complex(total)

    def _corner_cubic(self, i: int, change: Changes, left: Wave, waves: tuple[Wave, ...]) -> complex:
        n, gain = self.problem.period_multiple, self.problem.ports.forcing(self.vector).gain[i].T
        push, slope = change.push, n * series.evaluate(gain, change.phases * n, 1).T
        factors = [_dot(left, push, change.phases)]
        rates = [_dot(left, push, change.phases, 1) + _dot(left, slope, change.phases)]
        for wave in waves:
            factors.append(_moved(wave, change))
            rates.append(_moved(wave, change, 1))
        product = np.prod(factors, axis=0)
        rate = sum(np.prod([*factors[:j], rates[j], *factors[j + 1 :]], axis=0) for j in range(len(factors)))
        first, second = change.rate
        return complex(-np.sum(change.weight * (rate * first - product * second) / first**2))

    def quadratic(self, a: Wave, b: Wave, orders: Array) -> Array:
        """Return the amplitudes (J, m) of ``w'' a b`` at orders that differ from the sum of shifts by integers."""
        shift = orders[0] - round(float(orders[0] - a.shift - b.shift))
        whole = np.rint(orders - shift).astype(int)
        out = np.zeros((len(orders), self.problem.ports.inputs), dtype=complex)
        for c in self.changes:
            if c.phases.size:
                strength = c.weight * _moved(a, c) * _moved(b, c)
                out += series.turns(-c.phases, orders).T @ (strength[:, None] * c.push.T)
        if self.law is not None:

            def values(y: Array, theta: Array, modes: Array | None, at: Callable[[Wave], Array]) -> Array:
                bent = _multilinear(lambda *v: self.law.second(y, theta, self.vector, modes, *v), at(a), at(b))  # type: ignore[union-attr]
                return np.asarray(bent * np.exp(-1j * shift * theta / self.problem.period_multiple))

            reach = int(np.abs(whole).max())
            out += self._spectrum(values, reach)[whole + reach]
        return out

    def gradients(self, left: Wave, right: Wave) -> tuple[Array, Array]:
        """Return the gradients in u (N,) and by all parameters (q,) of the mean of ``left . w' right``.

        The second one holds u fixed and leaves out what gains and arguments of linear contacts do between changes.
        """
        k, q, reach = self.problem.ports.outputs, len(self.vector), len(self.Y) - 1
        spectrum, by_parameter = np.zeros((2 * reach + 1, k), dtype=complex), np.zeros(q, dtype=complex)
        orders = np.arange(-reach, reach + 1)
        for i, c in enumerate(self.changes):
            if c.phases.size:
                strength = c.weight * _dot(left, c.push, c.phases) * _moved(right, c)
                spectrum += series.turns(-c.phases, orders).T @ (strength[:, None] * c.direction.T)
                by_parameter += self._moves(i, c) @ strength
        if self.law is not None:

            def values(y: Array, theta: Array, modes: Array | None, at: Callable[[Wave], Array]) -> Array:
                def both(v: Array, w: Array) -> Array:
                    return np.vstack(self.law.gradients(y, theta, self.vector, modes, v, w))  # type: ignore[union-attr]

                return _multilinear(both, at(left), at(right))

            found = self._spectrum(values, reach)
            spectrum += found[:, :k]
            by_parameter += found[reach, k:]
        return _packed(spectrum), by_parameter

    def _moves(self, i: int, c: Changes) -> Array:
        """Return the derivatives (q, r) of the argument of contact i at its changes by all parameters, u fixed."""
        n, ports, q = self.problem.period_multiple, self.problem.ports, len(self.vector)
        if i not in ports.closed:
            y = series.evaluate(self.Y, c.phases).T
            assert self.law is not None
            return self.law.moves(y, c.phases * n, self.vector)[ports.general.index(i)]
        out, y = np.zeros((q, len(c.phases))), series.evaluate(self.Y, c.phases)
        for index in range(q):
            change = self.problem.forces.parameters.forcing(self.vector, index)
            slopes = self.problem.forces.parameters.argument_slopes(self.vector, index)
            if change.offset[i].any():
                out[index] += series.evaluate(change.offset[i], c.phases * n)
            if slopes is not None:
                out[index] += y @ slopes[i]
        return out

    def gain_slope(self, index: int, reach: int) -> Array | None:
        """Return the coefficients (2 reach + 1, m, k) of what a parameter does to the slope of linear contacts.

        Through their gains and the slopes of their arguments, the contact changes held; None where nothing.
        """
        ports, n = self.problem.ports, self.problem.period_multiple
        out = None
        for i in ports.closed:
            change = self.problem.forces.parameters.forcing(self.vector, index).gain[i]
            slopes = self.problem.forces.parameters.argument_slopes(self.vector, index)
            gain, d = ports.forcing(self.vector).gain[i], ports.linear(self.vector).d[i]
            for factor, direction in ((change, d), (gain, None if slopes is None else slopes[i])):
                if direction is None or not (factor.any() and direction.any()):
                    continue
                out = np.zeros((2 * reach + 1, ports.inputs, ports.outputs), dtype=complex) if out is None else out
                contact = self.problem.system.contacts[i]
                pattern = self.problem.forces.pattern(i, trimmed(self.problem.forces.argument(i, self.Y, self.vector)))
                rigid = series.piecewise_spectrum(pattern, np.array(contact.slopes), reach + (factor.shape[-1] - 1) * n)
                for row in range(ports.inputs):
                    out[:, row] += series.modulate(rigid, factor[row], n)[:, None] * direction
        return out

    # ---------------------------------------------------------------- integrals of the law
    def _spectrum(self, values: _Law, reach: int) -> Array:
        """Return two-sided coefficients (2 reach + 1, c) of a function (c, N) of the law and waves along the orbit."""
        n, Y = self.problem.period_multiple, self.Y
        if self.problem.ports.general:

            def along(y: Array, theta: Array, modes: Array | None) -> Array:
                found = values(y, theta, modes, lambda wave: wave(theta / n))
                return np.concatenate([found.real, found.imag]).T

            both = self.problem.forces.integrated(Y, self.vector, reach, along)
            half = both.shape[1] // 2
            real, imag = (np.concatenate([c[:0:-1].conj(), c]) for c in (both[:, :half], both[:, half:]))
            return np.asarray(real + 1j * imag)
        count = 1 << int(np.ceil(np.log2(max(64, 16 * len(Y), 8 * self.problem.ports.law_order * n, 4 * reach))))
        y = np.fft.irfft(Y, count, axis=0, norm="forward").T
        theta = 2 * np.pi * n * np.arange(count) / count
        found = np.fft.fft(values(y, theta, None, lambda wave: wave.on_grid(count)), axis=1).T / count
        return np.concatenate([found[count - reach :], found[: reach + 1]])


def critical_form(problem: Any, u: Array, p: float, nu: float, v: Array, w: Array) -> CriticalForm:
    """Return the derivatives of ``w . M_nu(u, p) v``; for complex vectors that of ``conj(w) . M v``.

    Parameters
    ----------
    v, w : arrays
        Vectors of the operator: packed as the unknown for nu = 0, packed half-integer harmonics for 1/2, else complex
        amplitudes of the orders -H..H.
    """
    M, k = ShiftedOperator(problem, u, p, nu), problem.ports.outputs
    right, left = as_wave(v, k, nu), as_wave(w, k, nu)
    curvature, adjoint, load = Curvature(problem, M.Y, M.vector), M.adjoint(left), M.load(right)
    state, bent = curvature.gradients(adjoint, right)

    def parameter(name: str) -> complex:
        index = problem.system.parameter_names.index(problem.system.check_parameter(name))
        held = curvature.gain_slope(index, len(M.orders) - 1)
        more = 0.0j
        if held is not None:
            more = complex(np.einsum("jk,jkm,jm->", left.amplitudes.conj(), M.transfer, M.load(right, held)))
        return M.parameter_derivative(left, load, index, complex(bent[index]) + more)

    if M.real:
        state = state.real
    return CriticalForm(-state, M.shift_derivative(left, load), parameter)


def _dot(left: Wave, push: Array, phases: Array, derivative: int = 0) -> Array:
    return np.asarray((left(phases, derivative) * push).sum(axis=0))


def _moved(wave: Wave, c: Changes, derivative: int = 0) -> Array:
    return np.asarray((wave(c.phases, derivative) * c.direction).sum(axis=0))


def _multilinear(function: Callable[..., Array], *vectors: Array) -> Array:
    """Return a real multilinear function at complex vectors."""
    for i, v in enumerate(vectors):
        if np.iscomplexobj(v):
            before, after = vectors[:i], vectors[i + 1 :]
            real = _multilinear(function, *before, v.real, *after)
            return np.asarray(real + 1j * _multilinear(function, *before, v.imag, *after))
    return function(*vectors)


def _packed(two_sided: Array) -> Array:
    """Return the packed gradient of amplitudes (2H+1, k) of a function that may be complex."""
    middle = len(two_sided) // 2
    ahead, back = two_sided[middle:], two_sided[middle::-1].conj()
    return pack((ahead + back) / 2) + 1j * pack((ahead - back) / 2j)
