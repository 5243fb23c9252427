"""The condensed operator on shifted harmonics k + nu, whose null vectors belong to multipliers exp(2 pi i nu).

A perturbation of a periodic orbit with that multiplier is ``v(phase) = sum_k c_k exp(i (k + nu) phase)``; in harmonic
balance it solves ``c_k = T_(k+nu) (sum_l slope_(k-l) c_l + S c_k)`` with the receptance T of the ports. nu = 0 is the
Jacobian of the orbit itself, nu = 1/2 the operator of a period-doubling; these are real, others complex. Derivatives
of ``w . M v`` are exact in everything: orbit, parameters and nu.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from continuation.orbits.contact_series import turns
from continuation.orbits.spectrum import pack, unpack

_ROOT2 = np.sqrt(2.0)
Array = np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Wave:
    """``sum_k amplitudes_k exp(i (k + shift) phase)`` with amplitudes (2 K + 1, c) of orders -K..K, or (2 K, c).

    With shift 1/2 the orders run from 1/2 - K to K - 1/2. ``real`` tells that the values are.
    """

    shift: float
    amplitudes: Array
    real: bool

    @property
    def orders(self) -> Array:
        """Harmonic orders (J,)."""
        reach = len(self.amplitudes) // 2
        return np.arange(-reach, len(self.amplitudes) - reach) + self.shift

    def __call__(self, phases: Array, derivative: int = 0) -> Array:
        """Return the values (c, N) at phases (N,), or a derivative by the phase."""
        amplitudes = self.amplitudes
        if derivative:
            amplitudes = amplitudes * ((1j * self.orders) ** derivative)[:, None]
        values = (turns(phases, self.orders) @ amplitudes).T
        return values.real if self.real else values

    def on_grid(self, count: int) -> Array:
        """Return the values (c, count) at equidistant phases of one period."""
        reach = len(self.amplitudes) // 2
        full = np.zeros((count, self.amplitudes.shape[1]), dtype=complex)
        np.add.at(full, np.arange(-reach, len(self.amplitudes) - reach) % count, self.amplitudes)
        turn = np.exp(2j * np.pi * self.shift * np.arange(count) / count)
        values = (np.fft.ifft(full, axis=0) * (count * turn)[:, None]).T
        return values.real if self.real else values

    def conjugate(self) -> Wave:
        """Return the wave of conjugate values."""
        if self.real:
            return self
        if self.shift == 0.5:
            raise ValueError("waves of shift 1/2 are real here")
        return Wave(-self.shift, self.amplitudes[::-1].conj(), False)


def as_wave(v: Array, k: int, nu: float) -> Wave:
    """Return what a vector of the shifted operator stands for; k is the number of port arguments.

    >>> as_wave(np.array([1.0, 0.0, 2.0]), 1, 0.0)(np.zeros(1)).round(12).tolist()   # 1 - 2 sqrt2 sin(phase), at 0
    [[1.0]]
    """
    if nu == 0.0 and not np.iscomplexobj(v):
        Y = unpack(v, k)
        return Wave(0.0, np.concatenate([Y[:0:-1].conj(), Y]), True)
    if nu == 0.5:
        K = len(v) // (2 * k)
        c = (v[: K * k] + 1j * v[K * k :]).reshape(K, k) / _ROOT2
        return Wave(0.5, np.concatenate([c[::-1].conj(), c]), True)
    return Wave(nu, np.asarray(v, dtype=complex).reshape(-1, k), False)


def as_vector(wave: Wave) -> Array:
    """Return the vector of the shifted operator that a wave stands for; the inverse of :func:`as_wave`."""
    reach = len(wave.amplitudes) // 2
    if wave.real and wave.shift == 0.0:
        return pack(wave.amplitudes[reach:])
    if wave.real:
        c = wave.amplitudes[reach:].ravel() * _ROOT2
        return np.concatenate([c.real, c.imag])
    return wave.amplitudes.ravel()


class ShiftedOperator:
    """The operator at one point (u, p) of a harmonic-balance problem and one nu in (-1, 1).

    ``orders`` (J,) are those of its vectors, ``transfer`` (J, k, m) the receptance there, ``stiffness`` (J, m, k) the
    reference slope it is taken with.
    """

    def __init__(self, problem: Any, u: Array, p: float, nu: float) -> None:
        self.problem, self.u, self.p, self.nu = problem, u, p, nu
        self.Y, self.vector = unpack(u, problem.ports.outputs), problem.vector(p)
        self.real = nu in (0.0, 0.5)
        reach = max(len(self.Y) - 1, 2) if nu == 0.5 else len(self.Y) - 1
        self.orders = np.arange(-reach, reach + (nu != 0.5)) + nu
        self.transfer, self.stiffness = receptances(problem, p, self.orders)

    @cached_property
    def slope(self) -> Array:
        """Two-sided Fourier coefficients (2 J - 1, m, k) of the port slope along the orbit."""
        reach = len(self.orders) - 1
        return np.asarray(self.problem.port_slope(self.u, self.p, reach))

    def matrix(self) -> Array:
        """Return the complex matrix (J k, J k) on the amplitudes."""
        J, k, _ = self.transfer.shape
        step = self.slope.strides
        middle = len(self.slope) // 2
        toeplitz = np.lib.stride_tricks.as_strided(
            self.slope[middle:], (J, J, *self.slope.shape[1:]), (step[0], -step[0], *step[1:]), writeable=False
        )
        if k == 1 and toeplitz.shape[2] == 1:
            out = -self.transfer[:, 0] * toeplitz[:, :, 0, 0]
            out[np.arange(J), np.arange(J)] += 1 - self.transfer[:, 0, 0] * self.stiffness[:, 0, 0]
            return np.asarray(out)
        full = -np.einsum("jam,jlmb->jalb", self.transfer, toeplitz)
        full[np.arange(J), :, np.arange(J), :] += np.eye(k) - self.transfer @ self.stiffness
        return full.reshape(J * k, J * k)

    def load(self, wave: Wave, slope: Array | None = None) -> Array:
        """Return the port load (J, m) of a perturbation: slope times it, and with the orbit's slope also S times it."""
        table = self.slope if slope is None else slope
        middle, J = len(table) // 2, len(self.orders)
        cut = table[middle - J + 1 : middle + J]
        out = np.zeros((J, table.shape[1]), dtype=complex)
        for a, b in np.ndindex(table.shape[1:]):
            out[:, a] += np.convolve(cut[:, a, b], wave.amplitudes[:, b], mode="valid")
        if slope is None:
            out += (self.stiffness @ wave.amplitudes[..., None])[..., 0]
        return out

    def wave(self, amplitudes: Array) -> Wave:
        """Return a wave of this operator's orders."""
        return Wave(self.nu, amplitudes, self.real)

    def adjoint(self, left: Wave) -> Wave:
        """Return ``sum_j conj(left_j) T_j exp(-i order_j phase)`` (m components), what w . M v weighs loads by."""
        amplitudes = np.einsum("jk,jkm->jm", left.amplitudes.conj(), self.transfer)
        if self.real:  # exp(-i order phase) and its conjugate
            return Wave(self.nu, amplitudes.conj(), True)
        return Wave(-self.nu, amplitudes[::-1], False)

    def shift_derivative(self, left: Wave, load: Array) -> complex:
        """Return d(w . M v)/d nu."""
        return -complex(np.sum(left.amplitudes.conj() * self._steepness(load)))

    def _steepness(self, load: Array) -> Array:
        """Return dT/d(order) times a load (J, m)."""
        problem, p = self.problem, self.p
        r, omega = problem.receptance(p), problem.frequency(p)
        part, size = r.part, np.abs(self.orders)
        out = np.zeros((len(size), part.C.shape[0]), dtype=complex)
        moving, back = size > 0, self.orders < 0
        given = np.where(back[:, None], load.conj(), load)
        if not moving.all():
            at_rest = r.at_rest(part.B @ given[~moving][0].real, 2) + 1j * r.at_rest(part.B @ given[~moving][0].imag, 2)
            out[~moving] = -1j * omega * (part.C @ at_rest)
        s = 1j * size[moving] * omega
        out[moving] = -1j * omega * (r.ports(s, 2) @ given[moving][:, :, None])[..., 0]
        return np.where(back[:, None], -out.conj(), out)

    def parameter_derivative(self, left: Wave, load: Array, index: int, bent: complex) -> complex:
        """Return d(w . M v)/d(parameter) at fixed u, v and w; ``bent`` is what the port slope contributes."""
        problem, value = self.problem, -bent
        if index == problem.system.parameter_names.index(problem.system.frequency):
            scale = self.orders / self.vector[index]
            value -= complex(np.sum(left.amplitudes.conj() * self._steepness(load) * scale[:, None]))
        moved = problem.ports.linear_derivative(self.vector, index)
        if moved is not None:
            value -= complex(np.sum(left.amplitudes.conj() * self._linear_change(load, moved)))
        return value

    def _linear_change(self, load: Array, moved: Any) -> Array:
        """Return dT times a load where A, B and C change; S stays what it is."""
        problem, r = self.problem, self.problem.receptance(self.p)
        dA, dB, dC = moved
        X = states(problem, self.p, self.orders, load @ r.part.B.T)
        own = load - (self.stiffness @ (X @ r.part.C.T)[..., None])[..., 0]
        pushed = (self.stiffness @ (X @ dC.T)[..., None])[..., 0]
        change = (dA @ X.T).T + own @ dB.T - pushed @ r.part.B.T
        return states(problem, self.p, self.orders, change) @ r.part.C.T + X @ dC.T


def receptances(problem: Any, p: float, orders: Array) -> tuple[Array, Array]:
    """Return receptance (J, k, m) and reference slope (J, m, k) of the ports at any harmonic orders (J,)."""
    r, size, back = problem.receptance(p), np.abs(orders), orders < 0
    stiffness = np.asarray(r.stiffness(size))
    transfer = np.empty((len(orders), *r.rest_ports.shape), dtype=complex)
    moving = size > 0
    transfer[~moving] = r.rest_ports
    transfer[moving] = r.ports(1j * size[moving] * problem.frequency(p))
    transfer[back], stiffness = transfer[back].conj(), np.where(back[:, None, None], stiffness.conj(), stiffness)
    return transfer, stiffness


def states(problem: Any, p: float, orders: Array, load: Array) -> Array:
    """Return the state amplitudes ``M^-1 load`` (J, n) of loads (J, n) at any harmonic orders (J,)."""
    r, size, back = problem.receptance(p), np.abs(orders), orders < 0
    given = np.where(back[:, None], load.conj(), load)
    out, moving = np.empty(load.shape, dtype=complex), size > 0
    for i in np.flatnonzero(~moving):
        out[i] = r.at_rest(given[i].real) + 1j * r.at_rest(given[i].imag)
    s = 1j * size[moving] * problem.frequency(p)
    out[moving] = r.solve(s, given[moving][:, :, None])[..., 0]
    return np.where(back[:, None], out.conj(), out)


@dataclass(frozen=True, slots=True, eq=False)
class CriticalForm:
    """Derivatives of ``w . M v`` at fixed v and w: in the orbit (N,), in nu, and in any parameter by name."""

    state: Array
    shift: complex
    parameter: Callable[[str], complex]
