"""Normal-form coefficients of folds, period-doublings and Neimark-Sacker points: which way the new orbits go.

By Lyapunov-Schmidt reduction of the harmonic-balance equations with exact second and third derivatives; w and v are the
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

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from continuation.branches.branch import Kind
from continuation.branches.criticality import NormalForm, nearest_resonance
from continuation.branches.extended import ExtendedProblem, Null, extended, solve_point
from continuation.branches.newton import size_of
from continuation.errors import ContinuationError, UnsupportedModel
from continuation.orbits import contact_series as series
from continuation.orbits.curvature import Curvature
from continuation.orbits.shifted import ShiftedOperator, Wave, as_vector, as_wave, receptances, states
from continuation.orbits.spectrum import unpack

_RESONANT = 2e-3  # distance of the rotation number from a strong resonance at which the coefficient says nothing
_GRAZING = (
    1e-3  # of the size of the orbit: deviation that makes a contact appear or vanish, below which it says nothing
)
_TAIL = 1024  # harmonics up to which answers to contact changes are summed, and at least twice the ones of the orbit
_CERTAIN = 3.0  # errors that a coefficient must exceed to have a sign


def normal_form(systems: list[tuple[ExtendedProblem, np.ndarray, float]]) -> NormalForm:
    """Return the normal form of a located point from solutions (system, unknown, q) of rising resolution.

    The difference between the last two is the error; of a single one it is not known, and taken for certain.
    """
    kind, nu = systems[-1][0].kind, systems[-1][0].split(systems[-1][1])[2]
    if kind == "neimark-sacker":
        name, distance = nearest_resonance(nu)
        if distance < _RESONANT:
            return NormalForm(np.nan, np.nan, "undetermined", f"near the {name} resonance")
    try:
        found = [coefficient(*s) for s in systems]
        graze = _grazing(*systems[-1])
    except (ContinuationError, np.linalg.LinAlgError) as reason:
        return NormalForm(np.nan, np.nan, "" if kind == "fold" else "undetermined", str(reason))
    value = found[-1]
    error = abs(value - found[-2]) if len(found) > 1 else 0.0
    if kind == "fold":
        return NormalForm(value, error, "")
    if value == 0.0:
        return NormalForm(0.0, 0.0, "undetermined", "the model is linear along the orbit")
    if graze < _GRAZING:
        reason = f"a deviation of {graze:.0e} of the orbit makes a contact appear or vanish: near grazing"
        return NormalForm(value, error, "undetermined", reason)
    if not abs(value) > _CERTAIN * error:
        return NormalForm(value, error, "undetermined", "the coefficient is zero within its error")
    super_ = (value > 0) == (kind == "period-doubling")
    return NormalForm(value, error, "supercritical" if super_ else "subcritical")


def describe(
    problem: Any, kind: Kind, orbit: Any, nu: float, solutions: Sequence[tuple[ExtendedProblem, np.ndarray]]
) -> NormalForm | None:
    """Return the normal form of a point located on an extended system, None for any other.

    Parameters
    ----------
    solutions : sequence of (system, unknown)
        Solutions of rising resolution, the first two at least where there are two.
    """
    if not solutions:
        return None
    system, U = solutions[-1]
    if hasattr(getattr(problem, "inner", problem), "half_operator"):
        form = normal_form([(s, V, 0.0) for s, V in solutions])
    elif kind == "fold":
        form = NormalForm()
    else:
        form = by_harmonic_balance(problem, kind, orbit, nu)
    rotation = nu if kind == "neimark-sacker" else np.nan
    return replace(form, null_vector=null_state(system, U), rotation_number=rotation)


def by_harmonic_balance(problem: Any, kind: Kind, orbit: Any, nu: float) -> NormalForm:
    """Return the normal form of a point that another method found, from the same point by harmonic balance."""
    from continuation.orbits.harmonic_balance import HarmonicBalance

    try:
        values = {k: v for k, v in problem.values.items() if k != problem.parameter}
        other = HarmonicBalance().discretise(
            problem.system, problem.parameter, period_multiple=problem.period_multiple, **values
        )
        u, p = other.unknown(orbit), orbit.value
        system = extended(other, kind, u, p)
        U = solve_point(system, system.join(u, p, nu)).u
        for _ in range(6):
            longer, _ = system.adapt(U, 0.0)
            if len(longer) <= len(U):
                break
            U = solve_point(system, longer).u
        finer = system.refined(U, 0.0)
        solved = [] if finer is None else [(system, solve_point(system, finer).u, 0.0)]
        return normal_form([(system, U, 0.0), *solved])
    except (ContinuationError, ValueError, np.linalg.LinAlgError) as reason:
        return NormalForm(np.nan, np.nan, "" if kind == "fold" else "undetermined", f"no harmonic balance: {reason}")


# -------------------------------------------------------------------------------------------- the reduction
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
    null = system.null(U, q)
    problem = getattr(outer, "inner", outer)
    if not hasattr(problem, "half_operator"):
        raise UnsupportedModel("normal forms are computed by harmonic balance")
    u = outer.split(u) if outer is not problem else u
    M = ShiftedOperator(problem, u, p, nu)
    k = problem.ports.outputs
    v = as_wave(null.v, k, nu)
    scale = 1 / float(np.linalg.norm(_state(M, v)))
    v = replace(v, amplitudes=scale * v.amplitudes)
    left = as_wave(null.w, k, nu)
    adjoint, Y = M.adjoint(left), M.Y
    G = M.shift_derivative(left, M.load(v))
    changes = any(pattern.phases.size for pattern in _patterns(problem, M))
    if not changes and not problem.ports.smooth:
        return 0.0  # linear along the orbit
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
    contacts = enumerate(problem.system.contacts)
    return [series.find_pattern(problem.forces.argument(i, M.Y, M.vector), c) for i, c in contacts]


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
        found = sp.linalg.spsolve(J, right) if sp.issparse(J) else np.linalg.solve(J, right)
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


def _grazing(system: ExtendedProblem, U: np.ndarray, q: float = 0.0) -> float:
    """Return the deviation, relative to the orbit, at which along the null vector a contact appears or vanishes."""
    outer = system.at(q)
    u, p, nu = system.split(U)
    problem = getattr(outer, "inner", outer)
    if not problem.system.contacts:
        return np.inf
    u = outer.split(u) if outer is not problem else u
    null: Null = system.null(U, q)
    M = ShiftedOperator(problem, u, p, nu)
    v = as_wave(null.v, problem.ports.outputs, nu)
    count = 8 << len(M.Y).bit_length()
    swing = v.on_grid(count)
    orbit = np.fft.irfft(M.Y, count, axis=0, norm="forward").T
    size = np.abs(orbit - orbit.mean(axis=1, keepdims=True)).max() / (np.abs(swing).max() or 1.0)
    nearest = np.inf
    for i, contact in enumerate(problem.system.contacts):
        a = np.fft.irfft(problem.forces.argument(i, M.Y, M.vector)[: count // 2], count, norm="forward")
        d = problem.ports.linear(M.vector).d[i]
        turns = np.flatnonzero((a - np.roll(a, 1)) * (np.roll(a, -1) - a) <= 0)
        depth = np.abs(a[turns, None] - np.array(contact.breakpoints)).min(axis=1)
        moved = np.abs((swing[:, turns] * d[:, None]).sum(axis=0))
        if turns.size and d.any():
            nearest = min(nearest, float((depth / np.maximum(moved, 1e-300)).min() / size))
    return nearest
