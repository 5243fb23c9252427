"""Stability verdicts: multipliers with error bars, and the Orbit that carries them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from continuation.model.linear_part import units_of
from continuation.orbits.contact_residual import contact_defect
from continuation.orbits.contact_series import ContactPattern
from continuation.orbits.hill import corrected
from continuation.orbits.monodromy import monodromy, multipliers, transition_matrices
from continuation.orbits.near_fold import side_unknown
from continuation.orbits.orbit import Orbit, Stability
from continuation.orbits.patterns import Contacts, contact_patterns, named
from continuation.orbits.products import product_eigenvalues
from continuation.orbits.spectrum import resize

FLOOR = 1e-10  # relative error of the transition integrator
_ROUNDING = 1e-12  # the same of the whole matrix, which ill-conditioned multipliers magnify
_WIDE = 1e8  # spread of the multipliers above which the product of the pieces is not formed
_CRITICAL = 10.0  # multiples of the error bar within which a multiplier decides the verdict narrowly
_AMPLIFIED = 3.0  # change at fixed parameter over the shortest that tells that a fold amplifies the error
_DOUBT = 0.25  # of that change: first-order estimates of harmonics left out are about as good
_SAME = 1e-9  # phase error in rad below which contact changes are those of the orbit


def make_orbits(problem: Any, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
    """Return the Orbits of corrected harmonic-balance points (u, p, waveform error).

    The error bar of a multiplier is the larger of the integrator's estimate and, where asked, its difference from
    Hill's method. The estimate is twice the change when the waveform is moved by its estimated error, plus Liouville's
    defect, plus what contact phases that are not the orbit's own and rounding may make, plus next to a fold a quarter
    of the change along the branch, which may cancel the change across it. Hill's method is asked for the
    leading multiplier of every orbit and for those that decide the verdict by less than ten error bars. An orbit with a
    multiplier within its error bar of the unit circle is undecided; so is one that lies at a fold to within its error,
    where it is not known on which side.
    """
    own = [(u, p) for u, p, _ in points]
    estimates = [problem.estimate(u, p) for u, p in own]
    there, back = [_moved(problem, *o, e, e.fixed) for o, e in zip(own, estimates, strict=True)], {}
    for i, e in enumerate(estimates):
        if e.fixed is not None and e.error > 2 * _AMPLIFIED * e.shortest:
            back[i] = _moved(problem, *own[i], e, None)
    flow = monodromy(problem, own + there + list(back.values()))
    n = len(own)
    mu, reach, rounding = spectra(problem, own, flow.matrices[:n])
    shifted = _all_multipliers(problem, there, flow.matrices[n : 2 * n], wide(mu))
    nearest = dict(zip(back, multipliers(flow.matrices[2 * n :]), strict=True))
    bars, defects = [], []
    for i, (u, p) in enumerate(own):
        defect, effect = contact_defect(problem, u, p, flow.patterns[i])
        defects.append(defect)
        bar = 2 * distance(mu[i], shifted[i]) + np.abs(mu[i]) * abs(flow.liouville[i]) + rounding[i] + effect * reach[i]
        if i in nearest:
            bar = bar + _DOUBT * distance(shifted[i], nearest[i])
        if estimates[i].fixed is None:
            bar = side_unknown(mu[i], bar, bool(problem.free))
        bars.append(bar)
    checked = [used if d < _SAME else None for used, d in zip(flow.patterns[:n], defects, strict=True)]
    opinions = second_opinions(problem, own, mu, np.array(bars), checked)
    orbits = []
    for i, (u, p, error) in enumerate(points):
        contacts = named(problem.system, list(flow.patterns[i]), problem.period_multiple)
        states, bar = problem.state_spectrum(u, p), np.fmax(bars[i], opinions[i])
        orbits.append(build_orbit(problem, p, states, mu[i], bar, error, contacts, opinions[i]))
    return orbits


def _moved(problem: Any, u: np.ndarray, p: float, estimate: Any, fixed: np.ndarray | None) -> tuple[np.ndarray, float]:
    """Return (u, p) moved by its estimated error at the same parameter, or the shortest way where that is None."""
    k = problem.ports.outputs
    step, dp = (estimate.step, estimate.dp) if fixed is None else (fixed, 0.0)
    return resize(u, k, (len(step) // k - 1) // 2) + step, p + dp


def _all_multipliers(
    problem: Any, points: list[tuple[np.ndarray, float]], matrices: np.ndarray, widely: np.ndarray
) -> np.ndarray:
    """Return multipliers (N, n) of monodromy matrices, of those that spread widely from the pieces."""
    out = multipliers(matrices)
    for i in widely:
        out[i] = from_pieces(problem, *points[i])[0]
    return out


def spectra(
    problem: Any, points: list[tuple[np.ndarray, float]], matrices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return multipliers of monodromy matrices (N, n, n), largest first, each (N, n) with its sensitivity and rounding.

    The sensitivity is the change of a multiplier per relative change of the matrix. Where multipliers spread by more
    than 1e8 they are taken from the pieces of the period one by one, so that small ones are more than noise.
    """
    values, condition, size = conditioned(matrices)
    reach = condition * size[:, None]
    order = np.argsort(-np.abs(values) - 1e-12 * (values.imag > 0), axis=-1, kind="stable")
    mu, reach = np.take_along_axis(values, order, axis=-1), np.take_along_axis(reach, order, axis=-1)
    rounding = FLOOR * np.abs(mu) + _ROUNDING * reach
    for i in wide(mu):
        mu[i], errors = from_pieces(problem, *points[i])
        rounding[i] = (FLOOR + errors) * np.abs(mu[i])
        reach[i] *= np.abs(mu[i]) / size[i]
    return mu, reach, rounding


def wide(mu: np.ndarray) -> np.ndarray:
    """Return which of several sets of multipliers (N, n), largest first, spread so widely that the last are noise."""
    return np.flatnonzero(np.abs(mu[:, 0]) > _WIDE * np.abs(mu[:, -1]))


def from_pieces(problem: Any, u: np.ndarray, p: float) -> tuple[np.ndarray, np.ndarray]:
    """Return multipliers (n,) that keep their digits however small they are, and their relative errors."""
    logarithms, angles, errors = product_eigenvalues(transition_matrices(problem, u, p))
    return np.exp(np.clip(logarithms, None, 700.0)) * np.exp(1j * angles), errors


def conditioned(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return eigenvalues (N, n) of matrices, the condition number of each (N, n), and the size of the matrix (N,).

    Both are those in balanced units of the states.

    NaN and infinity stand for the eigenvalues of matrices that are not finite, infinity for defective ones.
    """
    values = np.full(matrices.shape[:2], np.nan, dtype=complex)
    condition, size = np.full(values.shape, np.inf), np.ones(len(matrices))
    finite = np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2)))
    if not finite.size:
        return values, condition, size
    d = units_of(np.abs(matrices[finite]).max(axis=0))
    balanced = matrices[finite] * (d[None, :] / d[:, None])
    values[finite], modes = np.linalg.eig(balanced)
    size[finite] = np.linalg.norm(balanced, axis=(1, 2))
    for i, right in zip(finite, modes, strict=True):
        try:
            left = np.linalg.inv(right)
        except np.linalg.LinAlgError:
            continue
        condition[i] = np.linalg.norm(right, axis=0) * np.linalg.norm(left, axis=1)
    return values, condition, size


def second_opinions(
    problem: Any,
    points: list[tuple[np.ndarray, float]],
    mu: np.ndarray,
    bars: np.ndarray,
    patterns: list[tuple[ContactPattern, ...] | None],
) -> np.ndarray:
    """Return differences (N, n) of multipliers from Hill's method, NaN where it is not asked or can't answer.

    It is asked for the largest multiplier (of an autonomous System the largest but that of the flow), and for those
    whose distance from the unit circle is one to ten bars.
    ``patterns`` are the contact changes of the orbits where they have been checked.
    """
    out = np.full(mu.shape, np.nan)
    away = np.abs(np.abs(mu) - 1)
    wanted = (away > bars) & (away < _CRITICAL * bars)
    leading = np.zeros(len(mu), dtype=int)
    if problem.free and mu.shape[1] > 1:
        leading[np.abs(mu[:, 0] - 1) < np.abs(mu[:, 1] - 1)] = 1  # the first is that of the flow direction
    wanted[np.arange(len(mu)), leading] = True
    wanted &= np.isfinite(mu).all(axis=1)[:, None] & (mu.imag >= 0) & (mu != 0)
    places = np.argwhere(wanted)
    found = corrected(problem, points, patterns, [(int(i), complex(mu[i, j])) for i, j in places])
    for (i, j), other in zip(places, found, strict=True):
        partner = np.abs(mu[i] - mu[i, j].conj()) <= 1e-9 * np.abs(mu[i, j])
        out[i, partner] = out[i, j] = abs(other - mu[i, j])
    return out


def build_orbit(
    problem: Any,
    p: float,
    coefficients: np.ndarray,
    mu: np.ndarray,
    bar: np.ndarray,
    error: float,
    contacts: Contacts | None = None,
    opinion: np.ndarray | float = np.nan,
) -> Orbit:
    """Return the Orbit of a problem at p from state harmonics, multipliers, their error bars and the waveform error.

    ``contacts`` are searched along the state harmonics where they are not given; ``opinion`` is the difference of each
    multiplier from a second method.
    """
    return Orbit(
        system=problem.system.name,
        state_names=problem.system.state_names,
        parameter=problem.parameter,
        parameters=dict(zip(problem.system.parameter_names, problem.vector(p).tolist(), strict=True)),
        period=2 * np.pi / problem.frequency(p),
        period_multiple=problem.period_multiple,
        coefficients=coefficients,
        multipliers=mu,
        multiplier_error=bar,
        stability=verdict(mu, bar),
        error=error,
        contacts=contact_patterns(problem, coefficients, p) if contacts is None else contacts,
        second_opinion=np.broadcast_to(opinion, mu.shape),
    )


def distance(mu: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return |mu - its partner| (n,) under the best pairing of two sets of multipliers, infinity where one is NaN."""
    if not (np.isfinite(mu).all() and np.isfinite(other).all()):
        return np.full(len(mu), np.inf)
    return np.abs(mu - paired(mu, other))


def paired(mu: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the second set of multipliers (n,) in the order of the first that pairs them best; NaN where one is."""
    if not (np.isfinite(mu).all() and np.isfinite(other).all()):
        return np.full(len(mu), np.nan, dtype=complex)
    return np.asarray(other)[linear_sum_assignment(np.abs(mu[:, None] - other[None, :]))[1]]


def verdict(mu: np.ndarray, bar: np.ndarray) -> Stability:
    """Return the stability of multipliers (n,) with error bars (n,).

    >>> verdict(np.array([0.5, 0.2]), np.array([1e-6, 1e-6]))
    'stable'
    >>> verdict(np.array([1.0000001, 0.2]), np.array([1e-6, 1e-6]))
    'undecided'
    """
    outside = np.abs(mu) - 1
    if np.any(outside > bar):
        return "unstable"
    return "stable" if np.all(outside < -bar) else "undecided"
