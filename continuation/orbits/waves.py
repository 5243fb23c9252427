"""Port slopes along several orbits at once, piece by piece between contact changes."""

from __future__ import annotations

import numpy as np

from continuation.orbits import contact_series as series
from continuation.orbits.harmonic_balance import HarmonicBalanceProblem

_ROWS = 512  # pieces whose exponentials are held at once
_ALIKE = 8  # pieces of one length from which their exponentials are taken together


class Waves:
    """Port slopes along several orbits at once; ``owner`` tells which orbit a piece belongs to."""

    def __init__(self, problem: HarmonicBalanceProblem, orbits: list[tuple[np.ndarray, float]]) -> None:
        self.problem, self.vectors = problem, [problem.vector(p) for _, p in orbits]
        ports = problem.ports
        spectra = unpacked([u for u, _ in orbits], ports.outputs)
        self.Y = spectra if ports.smooth else np.zeros((len(orbits), 1, ports.outputs))
        self.patterns, self.gains, self.d = [], [], []
        forcings = [ports.forcing(v) for v in self.vectors]
        alike = forcings[:1] if all(f is forcings[0] for f in forcings) else forcings  # as along a frequency
        for i, contact in enumerate(problem.system.contacts):
            arguments = problem.forces.arguments(i, spectra, self.vectors)
            problem.forces.check_rests(i, arguments, spectra, self.vectors)
            self.patterns.append(_padded(series.find_patterns(arguments, contact)))
            gains = stack([f.gain[i].T for f in alike])
            self.gains.append(np.broadcast_to(gains, (len(orbits), *gains.shape[1:])))
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

    def used(self) -> list[tuple[series.ContactPattern, ...]]:
        """Contact changes that the pieces end at, of every orbit one pattern per contact."""
        counts = [np.isfinite(phases).sum(axis=1).tolist() for phases, _ in self.patterns]  # the rest is filling
        return [
            tuple(
                series.ContactPattern(phases[i, : c[i]], modes[i, : c[i] + 1])
                for (phases, modes), c in zip(self.patterns, counts, strict=True)
            )
            for i in range(len(self.vectors))
        ]

    def at(self, phases: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Port slope w' (P, q, m, k) at phases (P, q); each row of phases lies inside one contact mode."""
        problem = self.problem
        ports, n = problem.ports, problem.period_multiple
        slope = np.zeros((*phases.shape, ports.inputs, ports.outputs))
        middle = phases.mean(axis=1)
        found = []
        for contact, patterns, gains, d in zip(problem.system.contacts, self.patterns, self.gains, self.d, strict=True):
            changes, modes = patterns
            mode = modes[owner, np.sum(changes[owner] < middle[:, None], axis=1)]
            found.append(mode)
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
            inside = np.repeat([found[i] for i in ports.general], phases.shape[1], axis=1) if ports.general else None
            tangent = ports.law(y, theta, vectors, inside)[1]
            slope += tangent.transpose(2, 0, 1).reshape(slope.shape)
        return slope


def unpacked(vectors: list[np.ndarray], k: int) -> np.ndarray:
    """Return the half spectra (N, K, k) of packed vectors that may differ in length, padded with zeros."""
    lengths = np.array([len(u) for u in vectors])
    out = np.zeros((len(vectors), (lengths.max() // k + 1) // 2, k), dtype=complex)
    for length in np.unique(lengths):
        rows, H = np.flatnonzero(lengths == length), (length // k - 1) // 2
        u = np.array([vectors[i] for i in rows])
        out[rows, 0] = u[:, :k]
        out[rows, 1 : H + 1] = (u[:, k : k + H * k] + 1j * u[:, k + H * k :]).reshape(len(rows), H, k) / np.sqrt(2.0)
    return out


def stack(arrays: list[np.ndarray]) -> np.ndarray:
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
    if len(k) <= 8:  # few harmonics: powers by multiplication
        first = np.exp(1j * phases)
        out = np.zeros((*phases.shape, spectra.shape[2]))
        power = np.ones_like(first)
        for order in k:
            out += (power[..., None] * scaled[owner, order][:, None, :]).real
            power = power * first
        return out
    # rows of one length are shifted copies of each other: their exponentials are products, e(start) e(length x)
    out = np.empty((*phases.shape, spectra.shape[2]))
    within = phases - phases[:, :1]
    _, like, count = np.unique(within[:, -1].round(13), return_inverse=True, return_counts=True)
    for number in np.flatnonzero(count >= _ALIKE):
        members = np.flatnonzero(like == number)
        inner = np.exp(1j * np.multiply.outer(within[members[0]], k))  # (q, K+1)
        for begin in range(0, len(members), _ROWS):  # bounds the memory
            rows = members[begin : begin + _ROWS]
            outer = np.exp(1j * np.multiply.outer(phases[rows, 0], k))[..., None] * scaled[owner[rows]]
            out[rows] = (inner @ outer).real
    single = np.flatnonzero(count[like] < _ALIKE)
    if single.size:
        out[single] = _in_blocks(scaled, owner[single], phases[single])
    return out


def _in_blocks(scaled: np.ndarray, owner: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return the real part of ``sum_k scaled_k exp(i k phase)`` of the owners (N, K+1, c), shape (P, q, c).

    With k = a + width b the exponentials are products of about 2 sqrt K of them.
    """
    N, count, c = scaled.shape
    width = 1 << int(np.sqrt(count)).bit_length()
    blocks = -(-count // width)
    table = np.zeros((N, blocks * width, c), dtype=complex)
    table[:, :count] = scaled
    table = table.reshape(N, blocks, width, c).transpose(0, 2, 3, 1).reshape(N, width, c * blocks)
    out = np.empty((*phases.shape, c))
    for begin in range(0, len(owner), _ROWS // 4):  # bounds the memory
        rows = slice(begin, begin + _ROWS // 4)
        angle = 1j * phases[rows, :, None]
        inner = (np.exp(angle * np.arange(width)) @ table[owner[rows]]).reshape(*angle.shape[:2], c, blocks)
        out[rows] = (inner @ np.exp(angle * (width * np.arange(blocks)))[..., None])[..., 0].real
    return out
