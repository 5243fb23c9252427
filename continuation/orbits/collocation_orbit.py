"""From collocation points to Orbits: Fourier coefficients of the states, multipliers and their error bars."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation.branches.newton import size_of
from continuation.orbits.collocation_equations import products
from continuation.orbits.collocation_mesh import Mesh
from continuation.orbits.floquet import FLOOR, build_orbit, distance
from continuation.orbits.monodromy import multipliers
from continuation.orbits.near_fold import side_unknown
from continuation.orbits.orbit import Orbit

_FEWEST, _MOST = 256, 32768  # samples per orbit

Points = list[tuple[np.ndarray, float]]


def monodromies(problem: Any, points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the products from phase 0 and from the middle (R, n, n) and Liouville's defect (R,) of points (u, p)."""
    at = [(problem.mesh(u), u, problem.vector(p)) for u, p in points]
    return _matrices(problem, at)


def _matrices(problem: Any, at: list[tuple[Mesh, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same of unknowns on meshes with all parameters, those on one mesh in one batch."""
    n = len(problem.system.state_names)
    whole, turned, defect = np.empty((len(at), n, n)), np.empty((len(at), n, n)), np.empty(len(at))
    groups: dict[int, list[int]] = {}
    for i, (mesh, _, _) in enumerate(at):
        groups.setdefault(id(mesh), []).append(i)
    for members in groups.values():
        pairs = [(at[i][1], at[i][2]) for i in members]
        transitions, traces = problem.equations.transitions(at[members[0]][0], pairs)
        whole[members], turned[members] = products(transitions)
        # interval by interval: the determinant of a strongly damped period is below rounding
        defect[members] = np.linalg.slogdet(transitions)[1].sum(axis=1) - traces
    return whole, turned, defect


def make_orbits(problem: Any, points: list[tuple[np.ndarray, float, float]]) -> list[Orbit]:
    """Return the Orbits of corrected points (u, p, waveform error).

    The error bar of a multiplier is three times its change at the better orbit with polynomials of one degree more,
    more where the waveform is not resolved, plus its change when the period starts in its middle (rounding), plus what
    these changes leave unexplained of the defect of Liouville's determinant (that of a strongly damped mode is large,
    but moves no other multiplier). Over 480 orbits of smooth systems on 8 to 60 intervals the true error was a third of
    the bar in the median, and 0.92 of it at the most.
    """
    better = []
    for u, p, _ in points:
        estimate = problem.estimate(u, p)
        vector = problem.vector(p + estimate.shift).copy()
        if problem.free:
            vector[problem.system.parameter_names.index(problem.free)] *= 1 + estimate.dfrequency
        better.append((estimate.mesh, estimate.better, vector))
    whole, turned, defect = monodromies(problem, [(u, p) for u, p, _ in points])
    mu, again, other = multipliers(whole), multipliers(turned), multipliers(_matrices(problem, better)[0])
    orbits = []
    for i, (u, p, error) in enumerate(points):
        bar = _bar(distance(mu[i], other[i]), error / size_of(u)) + distance(mu[i], again[i]) + FLOOR
        explained = float(np.sum(bar / np.maximum(np.abs(mu[i]), 1e-300)))
        bar += np.abs(mu[i]) * max(abs(defect[i]) - explained, 0.0)
        if problem.estimate(u, p).at_fold:
            bar = side_unknown(mu[i], bar, bool(problem.free))
        orbits.append(build_orbit(problem, p, fourier(problem, u, p, error), mu[i], bar, error))
    return orbits


def _bar(change: np.ndarray, error: float) -> np.ndarray:
    """Return error bars (n,) from changes of multipliers and the relative waveform error, whose square they miss."""
    return 3 * (1 + 10 * error) * change if np.isfinite(error) else np.full(change.shape, np.inf)


def fourier(problem: Any, u: np.ndarray, p: float, error: float) -> np.ndarray:
    """Return the half spectrum (K+1, n) of a point (u, p), K so large that what is left out is below the error.

    K is chosen by the better orbit: that of u itself carries its error in harmonics about the number of intervals.
    Sampled at 4 points or more per wave of the highest harmonic kept, so that aliasing is below the error, too.
    """
    estimate, count = problem.estimate(u, p), _FEWEST
    while True:
        amplitudes = 2 * np.abs(_half_spectrum(estimate.mesh, estimate.better, count)).max(axis=1)
        left_out = np.cumsum(amplitudes[::-1])[::-1]  # harmonics k and above
        keep = int(np.searchsorted(-left_out, -max(error / 4, 1e-14 * left_out[0])))
        if keep <= count // 4 or count >= _MOST:
            return _half_spectrum(problem.mesh(u), u, count)[: max(min(keep, count // 4), 2)]
        count *= 2


def _half_spectrum(mesh: Mesh, u: np.ndarray, count: int) -> np.ndarray:
    samples = mesh.evaluate(mesh.values(u), np.arange(count) / count)
    return np.fft.rfft(samples, axis=0)[: count // 2] / count
