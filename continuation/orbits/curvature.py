"""Second derivatives of the condensed operator along an orbit, exact also at contact changes."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.orbits import contact_series as series
from continuation.orbits.spectrum import pack, unpack

_ROOT2 = np.sqrt(2.0)


def form_gradient(problem: Any, u: np.ndarray, p: float, v: np.ndarray, w: np.ndarray, half: bool) -> np.ndarray:
    """Return the gradient in u of ``-w . M(u) v`` at fixed v, w, for M the Jacobian or the half-integer operator.

    Only the port slope depends on u. With the adjoint waveform alpha of w and the waveform of v, the gradient is the
    spectrum of ``alpha_a w''_abc v_b``; at a contact change w'' is a jump over the speed of the argument there, so the
    formula is exact for contacts, and singular where they graze.

    Parameters
    ----------
    v, w : arrays
        Packed vectors of the size of M.
    half : bool
        Whether M acts on half-integer harmonics.
    """
    k = problem.ports.outputs
    Y, vector = unpack(u, k), problem.vector(p)
    orders, v_wave = _waveform(v, k, half)
    _, w_wave = _waveform(w, k, half)
    transfer = problem.transfer(p, orders)
    # w . pack(R) = w_0 R_0 + sum sqrt2 Re(conj(w_k) R_k), with w_k as unpacked here times sqrt2
    adjoint = np.einsum("ka,kam->km", w_wave.conj(), transfer)
    h = np.zeros((len(Y), k), dtype=complex)
    for i, contact in enumerate(problem.system.contacts):
        h += _contact_part(problem, i, contact, Y, vector, orders, v_wave, adjoint)
    if problem.ports.smooth:
        h += _smooth_part(problem, Y, vector, orders, v_wave, adjoint)
    return pack(h)


def _waveform(v: np.ndarray, k: int, half: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return orders (K,) and complex amplitudes (K, k) with value(phase) = Re sum amplitude exp(i order phase)."""
    if half:
        K = len(v) // (2 * k)
        return np.arange(K) + 0.5, _ROOT2 * (v[: K * k] + 1j * v[K * k :]).reshape(K, k)
    Y = unpack(v, k)
    Y[1:] *= 2
    return np.arange(len(Y)).astype(float), Y


def _values(orders: np.ndarray, amplitudes: np.ndarray, phases: np.ndarray, sign: int) -> np.ndarray:
    return (np.exp(sign * 1j * np.multiply.outer(phases, orders)) @ amplitudes).real


def _contact_part(problem, i, contact, Y, vector, orders, v_wave, adjoint):  # type: ignore[no-untyped-def]
    ports, n = problem.ports, problem.period_multiple
    argument = problem.forces.argument(i, Y, vector)
    pattern = series.find_pattern(argument, contact)
    if not pattern.phases.size:
        return 0.0
    phases = pattern.phases
    speed = np.abs(series.evaluate(argument, phases, 1))
    slopes = np.array(contact.slopes)[pattern.modes]
    rising = series.evaluate(argument, phases, 1) > 0
    jump = np.where(rising, np.diff(slopes), -np.diff(slopes))  # slope above the breakpoint less slope below
    gain = series.evaluate(ports.forcing(vector).gain[i].T, phases * n)
    d = ports.linear(vector).d[i]
    alpha = _values(orders, adjoint, phases, -1)
    v = _values(orders, v_wave, phases, +1)
    strength = jump / speed * np.sum(alpha * gain, axis=1) * (v @ d) / (2 * np.pi)
    waves = np.exp(-1j * np.multiply.outer(np.arange(len(Y)), phases))
    return (waves @ strength)[:, None] * d


def _smooth_part(problem, Y, vector, orders, v_wave, adjoint):  # type: ignore[no-untyped-def]
    ports, n = problem.ports, problem.period_multiple
    count = 1 << int(np.ceil(np.log2(max(64, 16 * len(Y), 8 * ports.law_order * n))))
    phases = 2 * np.pi * np.arange(count) / count
    y = np.fft.irfft(Y, count, axis=0, norm="forward").T
    bend = ports.second(y, phases * n, vector)  # (m, k, k, N)
    alpha, v = _values(orders, adjoint, phases, -1), _values(orders, v_wave, phases, +1)
    h = np.einsum("na,abcn,nb->nc", alpha, bend, v)
    return np.fft.rfft(h, axis=0)[: len(Y)] / count
