"""Monodromy matrices from the variational equation, integrated piece by piece and never across a contact change.

On every piece the variational equation ``z' = A_S z + B (w' + S) C z`` is freed of its constant part,
``v = exp(-A_S t) z``, and solved by Gauss collocation (order 2 q): q unknowns per port and piece whatever the number
of coordinates. Pieces end at contact changes, and are halved until the port slope is resolved on each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg as sl

from continuation.errors import ContinuationError
from continuation.model.linear_part import units_of
from continuation.model.ports import LinearPart
from continuation.orbits.contact_series import ContactPattern
from continuation.orbits.harmonic_balance import HarmonicBalanceProblem
from continuation.orbits.waves import Waves

_NODES = 14
_PHASE = 3.5  # largest |eigenvalue| * length of a piece
_RESOLVED = 1e-8  # Legendre tail of the port slope, relative; the collocation error is about its square
_DEPTH = 40
_MOST_PIECES = 200_000
_TOGETHER = 600_000  # entries of one piece each of the orbits that are integrated together: bounds the memory


@dataclass(frozen=True, slots=True)
class Monodromy:
    """Monodromy matrices of several orbits: matrices (N, n, n), and the Liouville defect of each (N,).

    The defect is ``log|det M|`` minus the integrated trace of the Jacobian: it checks the integrator, not the orbit.
    ``patterns`` are the contact changes that the integration stopped at, of every orbit one per contact.
    """

    matrices: np.ndarray
    liouville: np.ndarray
    patterns: tuple[tuple[ContactPattern, ...], ...]


@lru_cache(maxsize=4)
def _collocation(q: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Gauss nodes and weights on [0, 1], integration matrix I_ij = int_0^{x_i} l_j, Legendre transform (q, q)."""
    x, w = np.polynomial.legendre.leggauss(q)
    to_legendre = np.polynomial.legendre.legvander(x, q - 1).T * w * (np.arange(q)[:, None] + 0.5)
    integrals = np.empty((q, q))
    for j in range(q):
        integrals[:, j] = np.polynomial.legendre.legval(x, np.polynomial.legendre.legint(np.eye(q)[j], lbnd=-1))
    return (x + 1) / 2, w / 2, integrals @ to_legendre / 2, to_legendre


class _Flow:
    """Exponentials of the constant part A_S in real modal form, or as matrices where that is ill-conditioned.

    A complex pair ``a +- ib`` with eigenvector ``v`` has the basis columns Re v, Im v, in which exp(A t) is
    ``exp(a t)`` times a rotation by ``b t``; ``partner`` and ``side`` name the other column and its sign.
    """

    def __init__(self, matrix: np.ndarray, B: np.ndarray, C: np.ndarray) -> None:
        self.matrix, n = matrix, len(matrix)
        values, modes = np.linalg.eig(matrix)
        first = np.flatnonzero(values.imag >= 0)
        kept = np.concatenate([[i] if values[i].imag == 0 else [i, i] for i in first]).astype(int)
        second = np.append(False, kept[1:] == kept[:-1])
        basis = np.where(second, modes[:, kept].imag, modes[:, kept].real)
        balanced = basis / units_of(matrix)[:, None]  # units of the states are no ill-conditioning
        self.modal = bool(len(kept) == n and np.linalg.cond(balanced / np.linalg.norm(balanced, axis=0)) < 1e6)
        self.basis = basis if self.modal else np.eye(n)
        self.inverse = np.linalg.inv(self.basis)
        self.partner = np.arange(n)
        self.partner[second] -= 1
        self.partner[np.flatnonzero(second) - 1] += 1
        self.side = np.where(second, -1.0, 1.0)
        self.rates = values[first]
        self.poles = values
        self.left, self.right = C @ modes, np.linalg.solve(modes, B) if self.modal else B
        self.column = np.searchsorted(first, kept)
        self.C, self.B, self.CA = C @ self.basis, self.inverse @ B, C @ matrix @ self.basis
        self.radius = float(np.abs(values).max(initial=0.0))

    def _turn(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = t[..., None] * self.rates.imag
        growth = np.exp(t[..., None] * self.rates.real)
        cos, sin = np.cos(angle), np.sin(angle)
        return growth[..., self.column], cos[..., self.column], self.side * sin[..., self.column]

    def sides(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return C exp(A t), shape (..., k, n), and exp(-A t) B, shape (..., n, m)."""
        if not self.modal:
            at = t[..., None, None] * self.matrix
            return self.C @ sl.expm(at), sl.expm(-at) @ self.B
        growth, cos, sin = self._turn(t)
        left = (growth * cos)[..., None, :] * self.C - (growth * sin)[..., None, :] * self.C[:, self.partner]
        right = (cos / growth)[..., None] * self.B - (sin / growth)[..., None] * self.B[self.partner]
        return left, right

    def advance(self, t: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return exp(A t) x for t (P,), x (P, n, n)."""
        if not self.modal:
            return sl.expm(t[..., None, None] * self.matrix) @ x
        growth, cos, sin = self._turn(t)
        return (growth * cos)[..., None] * x + (growth * sin)[..., None] * x[:, self.partner]


def _flow(part: LinearPart) -> _Flow:
    return _Flow(part.A - part.B @ part.S @ part.C, part.B, part.C)


def flow_of(problem: HarmonicBalanceProblem, p: float) -> _Flow:
    """Return modes and exponentials of the linear part at p, kept while it stays the same."""
    flow: _Flow = problem.remember(problem.ports.linear(problem.vector(p)), _flow)
    return flow


def _resolve(waves: Waves, flow: _Flow, S: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, ...]:
    """Halve pieces until the slope is resolved; return lengths (P,), slopes at nodes (P, q, m, k), owners (P,).

    A piece is short enough when neither the constant part nor what the ports add to it turns by more than ``_PHASE``.
    """
    longest = _PHASE * omega / max(flow.radius, 1e-300)
    direct, through = np.abs(flow.C @ flow.B).max(initial=0.0), np.abs(flow.CA @ flow.B).max(initial=0.0)
    x, _, _, transform = _collocation(_NODES)
    start, length, owner = waves.pieces(longest)
    keep = length > 0
    start, length, owner = start[keep], length[keep], owner[keep]
    done = []
    scale = np.zeros(len(longest))
    for depth in range(_DEPTH):
        values = waves.at(start[:, None] + length[:, None] * x, owner)
        size = np.abs(np.tensordot(values, transform, axes=(1, 1))).max(axis=(1, 2), initial=0.0)
        np.maximum.at(scale, owner, size.max(axis=1, initial=0.0))
        excess = np.abs(values + S).max(axis=(1, 2, 3), initial=0.0)
        rate = np.maximum(direct * excess, np.sqrt(through * excess))
        rough = (size[:, -2:].max(axis=1) > _RESOLVED * scale[owner]) | (length * rate > _PHASE * omega[owner])
        if depth == _DEPTH - 1 or 2 * np.sum(rough) > _MOST_PIECES:
            rough[:] = False
        done.append((start[~rough], length[~rough], values[~rough], owner[~rough]))
        if not rough.any():
            break
        half = length[rough] / 2
        start = np.concatenate([start[rough], start[rough] + half])
        length, owner = np.concatenate([half, half]), np.concatenate([owner[rough], owner[rough]])
    starts, lengths, values, owners = (np.concatenate([d[i] for d in done]) for i in range(4))
    order = np.lexsort((starts, owners))
    return lengths[order], values[order], owners[order]


def _pieces(flow: _Flow, h: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Transition matrices (P, n, n) of pieces of duration h with port slopes Q = w' + S (P, q, m, k) at the nodes."""
    x, w, integrals, _ = _collocation(_NODES)
    count, q, m, k = Q.shape
    t = h[:, None] * x
    left, right = flow.sides(t)
    if m == k == 1:
        kernel = left[:, :, 0] @ right[..., 0].transpose(0, 2, 1)
        system = np.eye(q) - (integrals * h[:, None, None]) * kernel * Q[:, None, :, 0, 0]
        eta = np.linalg.solve(system, left[:, :, 0])[:, :, None]
    else:
        push = right @ Q  # (P, q, n, k)
        kernel = np.einsum("pian,pjnb->piajb", left, push) * (integrals * h[:, None, None])[:, :, None, :, None]
        system = np.eye(q * k) - kernel.reshape(count, q * k, q * k)
        eta = np.linalg.solve(system, left.reshape(count, q * k, -1)).reshape(count, q, k, -1)
    weighted = (right @ Q * (h[:, None] * w)[..., None, None]).transpose(0, 2, 1, 3).reshape(count, -1, q * k)
    inner = np.eye(len(flow.matrix)) + weighted @ eta.reshape(count, q * k, -1)
    return flow.advance(h, inner)


def monodromy(problem: HarmonicBalanceProblem, orbits: list[tuple[np.ndarray, float]]) -> Monodromy:
    """Return the monodromy matrices of several orbits (u, p) of one problem, all pieces in one batch.

    Cost about 0.2 ms per orbit for 14 states and one contact.

    Raises
    ------
    ContinuationError
        If the linear part is so stiff that the period needs more pieces than memory allows.
    """
    n = len(problem.system.state_names)
    matrices, defects = np.empty((len(orbits), n, n)), np.empty(len(orbits))
    patterns: list[tuple[ContactPattern, ...]] = [()] * len(orbits)
    for flow, part, members in _batches(problem, orbits):
        pieces = _integrate(problem, flow, part, [orbits[i] for i in members])
        matrices[members] = flow.basis @ _product(pieces) @ flow.inverse
        # the determinant piece by piece: that of a strongly damped period is below rounding
        logs = np.bincount(pieces.owner, np.linalg.slogdet(pieces.matrices)[1], minlength=len(members))
        defects[members] = logs - pieces.traces
        for i, used in zip(members, pieces.patterns, strict=True):
            patterns[i] = used
    return Monodromy(matrices, defects, tuple(patterns))


def transition_matrices(problem: HarmonicBalanceProblem, u: np.ndarray, p: float) -> np.ndarray:
    """Return transition matrices (P, n, n) of consecutive pieces of the period, the first piece in front.

    They are given in one common basis, so that their product is similar to the monodromy matrix; see
    :func:`continuation.orbits.products.product_eigenvalues`.
    """
    ((flow, part, _),) = _batches(problem, [(u, p)])
    return _integrate(problem, flow, part, [(u, p)]).matrices


def _batches(
    problem: HarmonicBalanceProblem, orbits: list[tuple[np.ndarray, float]]
) -> list[tuple[_Flow, LinearPart, list[int]]]:
    """Return the orbits (by number) of the same linear part, at most 64 together, fewer with many states."""
    groups: dict[int, list[int]] = {}
    parts = {}
    for i, (_, p) in enumerate(orbits):
        part = problem.ports.linear(problem.vector(p))
        parts[id(part)] = part
        groups.setdefault(id(part), []).append(i)
    out = []
    for key, members in groups.items():
        flow = problem.remember(parts[key], _flow)
        members.sort(key=lambda i: len(orbits[i][0]))  # those of few harmonics are not padded to many
        most = max(1, min(64, _TOGETHER // len(flow.matrix) ** 2))
        out += [(flow, parts[key], members[start : start + most]) for start in range(0, len(members), most)]
    return out


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Transition matrices (P, n, n) in the basis of the flow, their owners (P,), traces and patterns of each orbit."""

    matrices: np.ndarray
    owner: np.ndarray
    traces: np.ndarray
    patterns: list[tuple[ContactPattern, ...]]


def _integrate(
    problem: HarmonicBalanceProblem, flow: _Flow, part: LinearPart, orbits: list[tuple[np.ndarray, float]]
) -> _Pieces:
    omega = np.array([problem.frequency(p) for _, p in orbits])
    if 2 * np.pi * flow.radius > _MOST_PIECES * _PHASE * omega.min():
        raise ContinuationError(
            f"monodromy matrix: the fastest mode ({flow.radius:.2e} rad per unit time) turns too often in one period; "
            "leave out or soften the stiffest linear coordinates"
        )
    waves = Waves(problem, orbits)
    length, values, owner = _resolve(waves, flow, part.S, omega)
    duration = length / omega[owner]
    weights = _collocation(_NODES)[1]
    power = duration * np.einsum("q,pqmk,km->p", weights, values, part.C @ part.B)
    traces = np.trace(part.A) * 2 * np.pi / omega + np.bincount(owner, power, minlength=len(orbits))
    return _Pieces(_pieces(flow, duration, values + part.S), owner, traces, waves.used())


def _product(pieces: _Pieces) -> np.ndarray:
    """Multiply the pieces of every orbit; returns (N, n, n)."""
    n = pieces.matrices.shape[1]
    product = [np.eye(n)] * len(pieces.traces)
    for owner, piece in zip(pieces.owner.tolist(), pieces.matrices, strict=True):  # in order of the phase
        product[owner] = piece @ product[owner]
    return np.array(product)


def multipliers(matrices: np.ndarray) -> np.ndarray:
    """Return Floquet multipliers (N, n) of monodromy matrices (N, n, n), largest modulus first.

    Where a matrix is not finite, its multipliers are NaN.
    """
    finite = np.isfinite(matrices).all(axis=(1, 2))
    values = np.full(matrices.shape[:2], np.nan, dtype=complex)
    values[finite] = np.linalg.eigvals(matrices[finite])
    order = np.argsort(-np.abs(values) - 1e-12 * (values.imag > 0), axis=-1, kind="stable")
    return np.take_along_axis(values, order, axis=-1)
