"""First-order error of a harmonic-balance point: what the harmonics left out would add, and do to those kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from continuation.branches.bordered import bordered_factors
from continuation.branches.newton import size_of
from continuation.orbits.near_fold import measures_error
from continuation.orbits.spectrum import pack, product, unpack
from continuation.orbits.split_operator import SplitMatrix

_LINEAR = 1e-6  # accuracy of the linear equations where they are solved by iteration
_DIRECT = 50_000  # products of two coefficients from which Fourier transforms are faster


@dataclass(frozen=True, slots=True)
class Estimate:
    """First-order error of a point (u, p): what the harmonics left out would add and change.

    ``step`` (twice the harmonics or more), ``dp`` and, for an autonomous System, ``dfrequency`` (relative) are the
    shortest way back to the branch, ``shortest`` its size in the waveform; ``fixed`` is the change at the same
    parameter, None next to a fold, where that is no measure. ``error`` is twice the size of ``fixed``, or of ``step``
    where there is none, plus what the stated error of a fitted receptance may change. ``port_force`` (H+1, m) is that
    of the orbit.
    """

    step: np.ndarray
    fixed: np.ndarray | None
    dp: float
    dfrequency: float
    shortest: float
    error: float
    port_force: np.ndarray


def estimate_error(problem: Any, u: np.ndarray, p: float) -> Estimate:
    """Return the estimate of a point (u, p) of a HarmonicBalanceProblem; cost about a Newton step."""
    left, unit = _left_out(problem, u, p), problem.parameter_scale(p)
    low = pack(left.pushed - left.balance.residual[: len(left.pushed)])
    z, t = _changes(problem, u, p, low, unit)
    return _judged(problem, u, p, left, (z, t), left.balance.load[: len(left.pushed)])


def finish(
    problem: Any, u: np.ndarray, p: float, factors: Any, tangent: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Estimate]:
    """Return a chord step, the tangent, and the error estimate behind that step, from one port force at (u, p).

    Parameters
    ----------
    factors : Factors
        Of the bordered Jacobian of a point close by, from which Newton's method came.
    tangent : array (N+1,)
        Solution of that matrix for the right-hand side [0, .., 0, 1].

    Returns
    -------
    step, tangent : arrays (N+1,)
        The tangent is that at (u, p), one step of iterative refinement from the one given.
    estimate : Estimate
        Of (u, p) + step, to first order.
    """
    k, unit, N = problem.ports.outputs, problem.parameter_scale(p), len(u)
    left = _left_out(problem, u, p)
    kept = left.balance.first((N // k - 1) // 2 + 1)
    bent, _ = _linear(kept, left.slope, unpack(tangent[:-1], k))
    right = np.zeros((N + 1, 3), order="F")
    right[:N, 0] = -pack(kept.residual)
    right[:N, 1] = pack(left.pushed)
    right[:N, 2] = -pack(bent) - tangent[-1] * pack(problem.derivative(unpack(u, k), p, kept))
    step, z, turn = factors.solve(right, accuracy=_LINEAR).T
    t, unscaled = tangent + turn, np.append(np.ones(N), unit)
    moved = _linear(kept, left.slope, unpack(step[:-1], k))[1] + step[-1] * problem.force_derivative(unpack(u, k), p)
    return step, t, _judged(problem, u + step[:-1], p, left, (z / unscaled, t / unscaled), kept.load + moved)


def _linear(balance: Any, slope: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the linearised balance (H+1, k) of a change of the orbit, and the port load (H+1, m) that it makes."""
    load = _times_waveform(slope, Y) + product(balance.stiffness, Y[..., None])[..., 0]
    return Y - product(balance.transfer, load[..., None])[..., 0], load


def _judged(
    problem: Any, u: np.ndarray, p: float, left: _LeftOut, change: tuple[np.ndarray, np.ndarray], load: np.ndarray
) -> Estimate:
    """Return the estimate from the change (du, dp / unit) found, the direction of the branch, and the port load."""
    k, unit = problem.ports.outputs, problem.parameter_scale(p)
    (z, t), tail, H = change, left.tail, (len(u) // k - 1) // 2
    # shortest change of (u, p) instead of the one at fixed p, so that it stays finite at folds
    weights = np.ones(len(z))
    weights[len(u) :] = 0.0
    weights[-1] = size_of(u) ** 2
    least = z - float(z @ (weights * t)) / float(t @ (weights * t)) * t
    tail[: H + 1] = unpack(least[: len(u)], k)
    step = pack(tail)
    error = shortest = waveform_size(step, k)
    fixed = None
    if abs(t[-1]) > 0:
        tail[: H + 1] = unpack((z - z[-1] / t[-1] * t)[: len(u)], k)
        there = pack(tail)
        size = waveform_size(there, k)
        if measures_error(size, shortest, waveform_size(u, k)):
            fixed, error = there, size
    dp = float(least[-1])
    turn = float(least[-2]) if problem.free else 0.0
    error = 2 * error + _of_receptance(problem, u, p, load)
    force = load - product(left.balance.stiffness[: H + 1], unpack(u, k)[..., None])[..., 0]
    return Estimate(step, fixed, dp * unit, turn, shortest, error, force)


@dataclass(frozen=True, slots=True)
class _LeftOut:
    """Harmonics left out and what they do.

    ``tail`` (n, k) holds those left out; ``pushed`` (H+1, k) is what they add to the balance of those kept; ``balance``
    and ``slope`` are those of the orbit as one of n harmonics.
    """

    tail: np.ndarray
    pushed: np.ndarray
    balance: Any
    slope: np.ndarray


def _left_out(problem: Any, u: np.ndarray, p: float) -> _LeftOut:
    k = problem.ports.outputs
    Y = unpack(u, k)
    H = len(Y) - 1
    n = max(2 * len(Y), problem.forced(p) + 1)  # forcing beyond twice the harmonics counts as left out, too
    longer = np.zeros((n, k), dtype=complex)
    longer[: H + 1] = Y
    force = problem.forces(longer, problem.vector(p), n - 1, n + H)
    balance = problem.balance(longer, force.W, p)
    transfer, R = balance.transfer, balance.residual
    middle = len(force.slope) // 2
    tail = np.zeros_like(longer)
    own = np.eye(k) - product(transfer[H + 1 :], force.slope[middle] + balance.stiffness[H + 1 :])
    tail[H + 1 :] = -R[H + 1 :] / own[:, 0] if k == 1 else -np.linalg.solve(own, R[H + 1 :, :, None])[..., 0]
    # what the tail does to the harmonics kept: the port force it adds, through the linearised balance
    added = _times_waveform(force.slope, tail)[: H + 1]
    pushed = product(transfer[: H + 1], added[..., None])[..., 0]
    return _LeftOut(tail, pushed, balance, force.slope)


def _times_waveform(slope: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Return harmonics 0..n-1 of slope (2L+1, m, k, two-sided) times a waveform (n, k); right for orders <= L - n."""
    n, middle = len(tail), len(slope) // 2
    two_sided = np.concatenate([tail[:0:-1].conj(), tail])
    if slope.shape[1:] == (1, 1) and len(slope) * len(two_sided) < _DIRECT:
        return np.convolve(slope[:, 0, 0], two_sided[:, 0])[middle + n - 1 : middle + 2 * n - 1, None]
    size = 1 << (len(slope) + len(two_sided) - 1).bit_length()
    spectra = np.fft.fft(slope, size, axis=0), np.fft.fft(two_sided, size, axis=0)
    full = np.fft.ifft(np.einsum("fmk,fk->fm", *spectra), axis=0)
    return full[middle + n - 1 : middle + 2 * n - 1]


def _changes(problem: Any, u: np.ndarray, p: float, low: np.ndarray, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a change (du, dp / unit) of orbit and parameter that ``low`` makes, and the direction of the branch.

    The matrix is bordered by a row that no branch is normal to in practice, so that it is regular at folds, too.
    """
    factors = problem.factors(u, p)
    if factors is not None:  # those of the last Newton step, bordered by the normal of its hyperplane
        right = np.zeros((len(u) + 1, 2), order="F")
        right[: len(low), 0], right[-1, 1] = low, 1.0
        z, t = (factors.solve(right, accuracy=_LINEAR) / np.append(np.ones(len(u)), unit)[:, None]).T
        return z, t
    matrix, Fp = _balance_matrix(problem, u, p)
    problem.factorisations += 1
    n, k = len(Fp), problem.ports.outputs
    right = np.zeros((n + 1, 2))
    right[: len(low), 0], right[n, 1] = low, 1.0
    largest = np.abs(matrix.inner.block if isinstance(matrix, SplitMatrix) else matrix).max()
    row = largest * np.random.default_rng(0).standard_normal(n + 1) / np.sqrt(n + 1)
    falling = 1.0 / (1.0 + np.arange((len(u) // k - 1) // 2 + 1)) ** 2
    row[: len(u)] *= pack(np.repeat(falling[:, None], k, axis=1) * (1 + 1j))
    factors = bordered_factors(matrix, unit * Fp, row)
    if factors is None:
        raise np.linalg.LinAlgError("the bordered balance is singular")
    z, t = factors.solve(right, accuracy=_LINEAR).T
    return z, t


def through_balance(problem: Any, u: np.ndarray, p: float, low: np.ndarray) -> np.ndarray:
    """Solve the linearised balance for the change (N or N+1, 2) that ``low`` and the parameter make.

    With a free frequency the matrix has its column and the row that keeps the phase; the last row of the result is
    then the relative change of the frequency.
    """
    matrix, Fp = _balance_matrix(problem, u, p)
    problem.factorisations += 1
    return np.linalg.solve(np.asarray(matrix), np.stack([np.append(low, np.zeros(len(Fp) - len(low))), Fp], axis=1))


def _balance_matrix(problem: Any, u: np.ndarray, p: float) -> tuple[Any, np.ndarray]:
    """Return the matrix of the linearised balance, bordered where the frequency is free, and its parameter column."""
    J, Fp = problem.linearised(u, p)
    if not problem.free:
        return J, Fp
    direction = problem.phase_direction(u, p)
    row = direction / size_of(direction)
    column = problem.parameter_derivative(u, p, problem.free) * problem.values[problem.free]
    if isinstance(J, SplitMatrix):
        return J.bordered(column[:, None], row[None], np.zeros((1, 1))), np.append(Fp, 0.0)
    return np.block([[J, column[:, None]], [row[None], np.zeros((1, 1))]]), np.append(Fp, 0.0)


def _of_receptance(problem: Any, u: np.ndarray, p: float, load: np.ndarray) -> float:
    """Return a bound of what the stated error of a fitted receptance changes in the waveform; 0 for an exact one."""
    r = problem.receptance(p)
    if not r.error:
        return 0.0
    driven = problem.driven(p, len(load) - 1)
    forcing = np.zeros((len(load) - 1, driven.shape[1]), dtype=complex)
    forcing[: len(driven) - 1] = driven[1:]
    doubt = r.doubt(1j * np.arange(1, len(load)) * problem.frequency(p), load[1:], forcing)
    matrix, Fp = _balance_matrix(problem, u, p)
    # the way back may move the parameter, too
    extended = np.column_stack([np.asarray(matrix), Fp * problem.parameter_scale(p)])
    least = float(np.linalg.svd(extended, compute_uv=False)[-1])
    return float(np.sqrt(2 * len(u)) * np.linalg.norm(np.sqrt(2) * doubt) / max(least, 1e-300))


def waveform_size(u: np.ndarray, k: int) -> float:
    """Return a bound of the waveform of a packed spectrum: the sum of its amplitudes."""
    pairs = u[k:].reshape(2, -1)
    return float(np.abs(u[:k]).sum() + np.sqrt(2.0) * np.hypot(pairs[0], pairs[1]).sum())
