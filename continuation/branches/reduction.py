"""Lyapunov-Schmidt reduction at folds, period-doublings and Neimark-Sacker points: coefficients of normal forms.

Of the harmonic-balance equations, with exact second and third derivatives; w and v are the
null vectors, B and C the second and third derivatives of the residual, M_nu its linearisation on harmonics k + nu:

    fold              A = w . B(v, v) / 2
    period-doubling   A = w . B(v, h) + w . C(v, v, v) / 6            M_0 h = -B(v, v) / 2
    Neimark-Sacker    A = w . B(v, h) + w . B(v*, k) + w . C(v, v, v*) / 2
                                                  M_0 h = -B(v, v*),  M_2nu k = -B(v, v) / 2

and with G = w . dM/dnu v the coefficients of the map over one period of the orbit (Kuznetsov, Elements of Applied
Bifurcation Theory, sections 5.4 and 9.7), for a critical eigenvector of length 1 in the states at phase 0, are

    fold              xi -> xi + a xi^2                          a = 2 pi Im(A / G)
    period-doubling   xi -> -xi + c xi^3                         c = -2 pi Im(A / G), supercritical if positive
    Neimark-Sacker    xi -> exp(2 pi i nu) xi (1 + d |xi|^2)     Re d = 2 pi Im(A / G), supercritical if negative
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.extended import ExtendedProblem
from continuation.branches.newton import size_of
from continuation.errors import UnsupportedModel
from continuation.orbits import contact_series as series
from continuation.orbits.curvature import Curvature
from continuation.orbits.dense_factors import lu_of
from continuation.orbits.port_force import trimmed
from continuation.orbits.shifted import ShiftedOperator, Wave, as_vector, as_wave, receptances, states
from continuation.orbits.spectrum import unpack
from continuation.orbits.split_operator import SplitMatrix

_TAIL = 1024  # harmonics up to which answers to contact changes are summed, and at least twice the ones of the orbit


def coefficient(system: ExtendedProblem, U: np.ndarray, q: float = 0.0) -> float:
    """Return the coefficient at one solution of an extended system of harmonic balance; cost about two Newton steps.

    Raises
    ------
    UnsupportedModel
        For another method, for period-doublings and torus points of contacts that enter non-linearly, and for torus
        points of autonomous Systems.
    """
    outer = system.at(q)
    u, p, nu = system.split(U)
    problem = getattr(outer, "inner", outer)
    if not hasattr(problem, "half_operator"):
        raise UnsupportedModel("normal forms are computed by harmonic balance")
    u = outer.split(u) if outer is not problem else u
    M = ShiftedOperator(problem, u, p, nu)
    k = problem.ports.outputs
    changes = any(pattern.phases.size for pattern in _patterns(problem, M))
    if not changes and not problem.ports.smooth:
        return 0.0  # linear along the orbit
    null = system.null(U, q)
    v = as_wave(null.v, k, nu)
    x = _state(M, v)
    scale = 1 / float(np.linalg.norm(x))
    if system.kind == "fold" and x[int(np.argmax(np.abs(x)))].real < 0:
        scale = -scale  # the eigenvector of :func:`null_state`
    v = replace(v, amplitudes=scale * v.amplitudes)
    left = as_wave(null.w, k, nu)
    adjoint, Y = M.adjoint(left), M.Y
    G = M.shift_derivative(left, M.load(v))
    if changes and system.kind != "fold":
        v, adjoint, Y = _longer(M, v, adjoint)
    curvature = Curvature(problem, Y, M.vector)
    if system.kind == "fold":
        A = -curvature.twice(adjoint, v, v) / 2
        return float(2 * np.pi * (A / G).imag)
    solve = _Responses(outer, problem, curvature, system.split(U)[0], u, p)
    if system.kind == "period-doubling":
        h, pull = solve.mean(v, v, 0.5)
        A = -curvature.twice(adjoint, h, v) - curvature.thrice(adjoint, v, v, v) / 6
        if pull:
            A += pull * problem.critical_form(u, p, nu, scale * null.v, null.w).parameter(problem.free)
        return float(-2 * np.pi * (A / G).imag)
    if outer is not problem:
        raise UnsupportedModel("the direction of a torus of an autonomous System is not computed")
    other = v.conjugate()
    h, _ = solve.mean(v, other, 1.0)
    A = -curvature.twice(adjoint, h, v) - curvature.twice(adjoint, solve.second(v, nu), other)
    A -= curvature.thrice(adjoint, v, v, other) / 2
    return float(2 * np.pi * (A / G).imag)


def null_state(system: ExtendedProblem, U: np.ndarray, q: float = 0.0) -> np.ndarray:
    """Return the critical eigenvector (n,) of the monodromy matrix at phase 0, of length 1, its largest entry positive.

    It is complex at a Neimark-Sacker point.
    """
    outer = system.at(q)
    u, p, nu = system.split(U)
    problem = getattr(outer, "inner", outer)
    if hasattr(problem, "half_operator"):
        u = outer.split(u) if outer is not problem else u
        null = system.null(U, q)
        M = ShiftedOperator(problem, u, p, nu)
        x = _state(M, as_wave(null.v, problem.ports.outputs, nu))
    else:
        u = outer.split(u) if outer is not problem else u
        mu, vectors = np.linalg.eig(problem.monodromies([(u, p)])[0])
        x = vectors[:, int(np.argmin(np.abs(mu - np.exp(2j * np.pi * nu))))]
    x = x / np.linalg.norm(x)
    top = x[int(np.argmax(np.abs(x)))]
    x = x * (abs(top) / top)
    return np.asarray(x if system.extra == 2 else x.real)


def _state(M: ShiftedOperator, v: Wave) -> np.ndarray:
    """Return the states (n,) at phase 0 of a null wave, from the load that it puts on the ports."""
    load = M.load(v) @ M.problem.receptance(M.p).part.B.T
    return np.asarray(states(M.problem, M.p, M.orders, load).sum(axis=0))


def _reach(harmonics: int) -> int:
    return max(2 * harmonics, _TAIL)


def _patterns(problem: Any, M: ShiftedOperator) -> list[series.ContactPattern]:
    forces = problem.forces
    return [forces.pattern(i, trimmed(forces.argument(i, M.Y, M.vector))) for i in range(len(problem.system.contacts))]


def _longer(M: ShiftedOperator, v: Wave, adjoint: Wave) -> tuple[Wave, Wave, np.ndarray]:
    """Return null wave, adjoint wave and orbit with the harmonics that the operator leaves out, answers to those kept.

    Where a contact changes, third derivatives take the slope of waves that have a corner in it: without its
    high harmonics it errs with the first power of their number.
    """
    problem, n = M.problem, len(M.orders)
    tail = _reach(len(M.Y) - 1)
    whole = np.arange(-tail, tail + (M.nu != 0.5))
    transfer, _ = receptances(problem, M.p, whole + M.nu)
    slope = problem.port_slope(M.u, M.p, tail + n)
    middle, kept = len(slope) // 2, slice(tail - n // 2, tail - n // 2 + n)

    def against(wave: Wave, table: np.ndarray) -> np.ndarray:
        cut = table[middle - len(whole) // 2 - (n - 1) // 2 : middle + (len(whole) - 1) // 2 + n // 2 + 1]
        out = np.zeros((len(whole), table.shape[1]), dtype=complex)
        for a, b in np.ndindex(table.shape[1:]):
            out[:, a] += np.convolve(cut[:, a, b], wave.amplitudes[:, b], mode="valid")
        return out

    right = (transfer @ against(v, slope)[..., None])[..., 0]
    right[kept] = v.amplitudes
    loads = against(adjoint, slope.transpose(0, 2, 1))  # orders of the adjoint: those of -nu
    back = transfer if M.real else transfer[::-1]
    left = np.einsum("jk,jkm->jm", loads, back.conj() if M.real else back)
    left[kept] = adjoint.amplitudes
    force = problem.forces(M.Y, M.vector, tail, 0).W
    at_orbit, _ = receptances(problem, M.p, np.arange(tail + 1.0))
    Y = (at_orbit @ force[..., None])[..., 0]
    Y[: len(M.Y)] = M.Y
    return replace(v, amplitudes=right), replace(adjoint, amplitudes=left), Y


class _Responses:
    """Answers of the orbit to what the null vector does at second order."""

    def __init__(self, outer: Any, problem: Any, curvature: Curvature, U: np.ndarray, u: np.ndarray, p: float) -> None:
        self.outer, self.problem, self.curvature, self.U, self.u, self.p = outer, problem, curvature, U, u, p
        self.contacts = any(c.phases.size for c in curvature.changes)

    def mean(self, a: Wave, b: Wave, factor: float) -> tuple[Wave, float]:
        """Return h with ``J h = -factor B(a, b)`` and, of an autonomous System, what it adds to the frequency."""
        H, k = len(unpack(self.u, self.problem.ports.outputs)) - 1, self.problem.ports.outputs
        driven = self._driven(a, b, np.arange(-self._reach(H), self._reach(H) + 1).astype(float)) * factor
        middle = len(driven) // 2
        own = driven[middle - H : middle + H + 1]
        J = self.outer.linearise(self.U, self.p)[1]
        right = np.zeros(len(self.U))
        right[: len(self.u)] = as_vector(Wave(0.0, own, True))
        found = _solved(J, right)
        driven[middle - H : middle + H + 1] = as_wave(found[: len(self.u)], k, 0.0).amplitudes
        pull = 0.0
        if len(found) > len(self.u):  # the last entry is the scaled logarithm of the frequency
            before, step = self.outer.frequency_of(self.U), np.zeros(len(self.U))
            step[-1] = 1e-6 * size_of(self.u)
            rate = (np.log(self.outer.frequency_of(self.U + step)) - np.log(before)) / step[-1]
            pull = float(found[-1] * before * rate)
        return Wave(0.0, driven, True), pull

    def second(self, v: Wave, nu: float) -> Wave:
        """Return k with ``M_2nu k = -B(v, v) / 2``."""
        M = ShiftedOperator(self.problem, self.u, self.p, 2 * nu)
        H, k = len(M.orders) // 2, self.problem.ports.outputs
        reach = self._reach(H)
        driven = self._driven(v, v, np.arange(-reach, reach + 1) + 2 * nu) / 2
        own = driven[reach - H : reach + H + 1]
        driven[reach - H : reach + H + 1] = np.linalg.solve(M.matrix(), own.ravel()).reshape(-1, k)
        return Wave(2 * nu, driven, False)

    def _reach(self, H: int) -> int:
        return _reach(H) if self.contacts else H

    def _driven(self, a: Wave, b: Wave, orders: np.ndarray) -> np.ndarray:
        """Return ``-B(a, b)``, amplitudes (J, k): the receptance times the port force of second order.

        Pulses at contact changes make it fall only with the square of the order; beyond the harmonics of the orbit it
        is its own answer, to the same power once more.
        """
        load = self.curvature.quadratic(a, b, orders)
        transfer, _ = receptances(self.problem, self.p, orders)
        return np.asarray((transfer @ load[..., None])[..., 0])


def _solved(J: Any, right: np.ndarray) -> np.ndarray:
    """Return the solution (N,) for a Jacobian, dense, sparse or split."""
    if sp.issparse(J):
        return np.asarray(sp.linalg.spsolve(J, right))
    factors = J.factors() if isinstance(J, SplitMatrix) else lu_of(np.array(J, order="F"))
    if factors is None:
        raise np.linalg.LinAlgError("the Jacobian is singular")
    return factors.solve(right)
