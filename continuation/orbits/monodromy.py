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
from continuation.model.ports import LinearPart
from continuation.orbits import contact_series as series
from continuation.orbits.harmonic_balance import HarmonicBalanceProblem
from continuation.orbits.spectrum import unpack

_NODES = 14
_PHASE = 3.5  # largest |eigenvalue| * length of a piece
_RESOLVED = 1e-8  # Legendre tail of the port slope, relative; the collocation error is about its square
_DEPTH = 40
_MOST_PIECES = 200_000


@dataclass(frozen=True, slots=True)
class Monodromy:
    """Monodromy matrices of several orbits: matrices (N, n, n), and the Liouville defect of each (N,).

    The defect is ``log|det M|`` minus the integrated trace of the Jacobian: it checks the integrator, not the orbit.
    """

    matrices: np.ndarray
    liouville: np.ndarray


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
        self.modal = bool(len(kept) == n and np.linalg.cond(basis) < 1e6)
        self.basis = basis if self.modal else np.eye(n)
        self.inverse = np.linalg.inv(self.basis)
        self.partner = np.arange(n)
        self.partner[second] -= 1
        self.partner[np.flatnonzero(second) - 1] += 1
        self.side = np.where(second, -1.0, 1.0)
        self.rates = values[first]
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


class _Waves:
    """Port slopes along several orbits at once; ``owner`` tells which orbit a piece belongs to."""

    def __init__(self, problem: HarmonicBalanceProblem, orbits: list[tuple[np.ndarray, float]]) -> None:
        self.problem, self.vectors = problem, [problem.vector(p) for _, p in orbits]
        ports = problem.ports
        spectra = [unpack(u, ports.outputs) for u, _ in orbits]
        self.Y = _stack(spectra) if ports.smooth else np.zeros((len(orbits), 1, ports.outputs))
        self.patterns, self.gains, self.d = [], [], []
        for i, contact in enumerate(problem.system.contacts):
            arguments = [problem.forces.argument(i, Y, v) for Y, v in zip(spectra, self.vectors, strict=True)]
            self.patterns.append(_padded(series.find_patterns(_stack(arguments), contact)))
            self.gains.append(_stack([ports.forcing(v).gain[i].T for v in self.vectors]))
            self.d.append(np.array([ports.linear(v).d[i] for v in self.vectors]))

    def pieces(self, longest: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Starts, lengths and owners of pieces that end at contact changes and are at most ``longest`` (N,) long."""
        tables = [phases for phases, _ in self.patterns]
        ends = np.tile([0.0, 2 * np.pi], (len(longest), 1))
        edges = np.sort(np.minimum(np.concatenate([ends, *tables], axis=1), 2 * np.pi), axis=1)
        gaps = np.diff(edges, axis=1)
        counts = np.ceil(gaps / longest[:, None]).astype(int)  # none for an empty gap
        flat = counts.ravel()
        size = np.repeat(np.divide(gaps, counts, out=np.zeros_like(gaps), where=counts > 0).ravel(), flat)
        order = np.arange(flat.sum()) - np.repeat(np.cumsum(flat) - flat, flat)
        owner = np.repeat(np.repeat(np.arange(len(longest)), gaps.shape[1]), flat)
        return np.repeat(edges[:, :-1].ravel(), flat) + order * size, size, owner

    def at(self, phases: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Port slope w' (P, q, m, k) at phases (P, q); each row of phases lies inside one contact mode."""
        problem = self.problem
        ports, n = problem.ports, problem.period_multiple
        slope = np.zeros((*phases.shape, ports.inputs, ports.outputs))
        middle = phases.mean(axis=1)
        for contact, patterns, gains, d in zip(problem.system.contacts, self.patterns, self.gains, self.d, strict=True):
            changes, modes = patterns
            mode = modes[owner, np.sum(changes[owner] < middle[:, None], axis=1)]
            gain = _series(gains, owner, phases * n)
            rigid = np.array(contact.slopes)[mode][:, None, None]
            slope += (rigid * gain)[..., None] * d[owner][:, None, None, :]
        if ports.smooth:
            y = _series(self.Y, owner, phases).reshape(-1, ports.outputs).T
            theta = (phases * n).ravel()
            if all(np.array_equal(v, self.vectors[0]) for v in self.vectors):
                vectors: np.ndarray = self.vectors[0]
            else:
                vectors = np.repeat(np.array(self.vectors)[owner], phases.shape[1], axis=0).T
            tangent = ports.law(y, theta, vectors)[1]
            slope += tangent.transpose(2, 0, 1).reshape(slope.shape)
        return slope


def _stack(arrays: list[np.ndarray]) -> np.ndarray:
    """Stack arrays whose first axes differ in length, padded with zeros."""
    longest = max(len(a) for a in arrays)
    out = np.zeros((len(arrays), longest, *arrays[0].shape[1:]), dtype=complex)
    for row, a in zip(out, arrays, strict=True):
        row[: len(a)] = a
    return out


def _padded(patterns: list[series.ContactPattern]) -> tuple[np.ndarray, np.ndarray]:
    """Return phases (N, r) and modes (N, r + 1) of patterns as tables, with changes at infinity as filling."""
    longest = max(len(p.phases) for p in patterns)
    phases = np.full((len(patterns), longest), np.inf)
    modes = np.zeros((len(patterns), longest + 1), dtype=int)
    for i, p in enumerate(patterns):
        phases[i, : len(p.phases)], modes[i, : len(p.modes)] = p.phases, p.modes
    return phases, modes


def _series(spectra: np.ndarray, owner: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Evaluate half spectra (N, K+1, c) of the owners at phases (P, q); returns (P, q, c)."""
    k = np.arange(spectra.shape[1])
    scaled = spectra * np.where(k == 0, 1.0, 2.0)[:, None]
    first = np.exp(1j * phases)
    if len(k) <= 8:  # few harmonics: powers by multiplication
        out = np.zeros((*phases.shape, spectra.shape[2]))
        power = np.ones_like(first)
        for order in k:
            out += (power[..., None] * scaled[owner, order][:, None, :]).real
            power = power * first
        return out
    out = np.empty((*phases.shape, spectra.shape[2]))
    for start in range(0, len(owner), 512):  # bounds the memory of the exponentials
        rows = slice(start, start + 512)
        waves = np.exp(1j * phases[rows, :, None] * k)
        out[rows] = (waves @ scaled[owner[rows]]).real
    return out


def _resolve(waves: _Waves, flow: _Flow, S: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, ...]:
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

    Cost about 0.3 ms per orbit for 14 states and one contact.

    Raises
    ------
    ContinuationError
        If the linear part is so stiff that the period needs more pieces than memory allows.
    """
    n = len(problem.system.state_names)
    matrices, defects = np.empty((len(orbits), n, n)), np.empty(len(orbits))
    groups: dict[int, list[int]] = {}
    parts = {}
    for i, (_, p) in enumerate(orbits):
        part = problem.ports.linear(problem.vector(p))
        parts[id(part)] = part
        groups.setdefault(id(part), []).append(i)
    for key, members in groups.items():
        part = parts[key]
        flow = problem.remember(part, _flow)
        for start in range(0, len(members), 64):
            chunk = members[start : start + 64]
            matrices[chunk], defects[chunk] = _chunk(problem, flow, part, [orbits[i] for i in chunk])
    return Monodromy(matrices, defects)


def _chunk(
    problem: HarmonicBalanceProblem, flow: _Flow, part: LinearPart, orbits: list[tuple[np.ndarray, float]]
) -> tuple[np.ndarray, np.ndarray]:
    omega = np.array([problem.frequency(p) for _, p in orbits])
    if 2 * np.pi * flow.radius > _MOST_PIECES * _PHASE * omega.min():
        raise ContinuationError(
            f"monodromy matrix: the fastest mode ({flow.radius:.2e} rad per unit time) turns too often in one period; "
            "leave out or soften the stiffest linear coordinates"
        )
    length, values, owner = _resolve(_Waves(problem, orbits), flow, part.S, omega)
    duration = length / omega[owner]
    weights = _collocation(_NODES)[1]
    power = duration * np.einsum("q,pqmk,km->p", weights, values, part.C @ part.B)
    traces = np.trace(part.A) * 2 * np.pi / omega + np.bincount(owner, power, minlength=len(orbits))
    pieces = _pieces(flow, duration, values + part.S)
    counts = np.bincount(owner, minlength=len(orbits))
    offsets = np.concatenate([[0], np.cumsum(counts)])
    product = np.broadcast_to(np.eye(len(part.A)), (len(orbits), *part.A.shape)).copy()
    for j in range(int(counts.max())):
        active = np.flatnonzero(counts > j)
        product[active] = pieces[offsets[active] + j] @ product[active]
    matrices = flow.basis @ product @ flow.inverse
    # the determinant piece by piece: that of a strongly damped period is below rounding
    logs = np.bincount(owner, np.linalg.slogdet(pieces)[1], minlength=len(orbits))
    return matrices, logs - traces


def multipliers(matrices: np.ndarray) -> np.ndarray:
    """Return Floquet multipliers (N, n) of monodromy matrices (N, n, n), largest modulus first."""
    values = np.linalg.eigvals(matrices).astype(complex)
    order = np.argsort(-np.abs(values) - 1e-12 * (values.imag > 0), axis=-1, kind="stable")
    return np.take_along_axis(values, order, axis=-1)
