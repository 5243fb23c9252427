"""Which way the new orbits go at a period-doubling or torus point, with a verdict only where it is certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from continuation.branches.branch import Kind
from continuation.branches.criticality import NormalForm, nearest_resonance
from continuation.branches.extended import SHIFT, ExtendedProblem, extended, solve_point
from continuation.branches.reduction import coefficient, null_state
from continuation.errors import ContinuationError
from continuation.orbits.shifted import ShiftedOperator, as_wave

_RESONANT = 2e-3  # distance of the rotation number from a strong resonance at which the coefficient says nothing
_GRAZING = 1e-3  # of the orbit: deviation that makes a contact appear or vanish, below which neither
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
        words = f"a deviation of {graze:.0e} of the orbit makes a contact appear or vanish: near grazing"
        return NormalForm(value, error, "undetermined", words)
    if not abs(value) > _CERTAIN * error:
        return NormalForm(value, error, "undetermined", "the coefficient is zero within its error")
    super_ = (value > 0) == (kind == "period-doubling")
    return NormalForm(value, error, "supercritical" if super_ else "subcritical")


def describe(
    problem: Any,
    kind: Kind,
    orbit: Any,
    at: tuple[np.ndarray, float],
    nu: float,
    solutions: Sequence[tuple[ExtendedProblem, np.ndarray]],
) -> NormalForm | None:
    """Return the normal form of a point, its critical eigenvectors alone where it was located by another way.

    None for grazing and user points, and for many states, which it would take at every harmonic.

    Parameters
    ----------
    at : (array, float)
        The point as an unknown of the problem.
    nu : float
        Angle of the critical multiplier over 2 pi, NaN where only the kind tells it.
    solutions : sequence of (system, unknown)
        Solutions of rising resolution, the first two at least where there are two.
    """
    if kind in ("grazing", "user") or getattr(getattr(problem, "inner", problem), "large", False):
        return None
    M = _monodromy(problem, *at)
    if not solutions:
        return _vectors_alone(problem, kind, M)
    system, U = solutions[-1]
    if hasattr(getattr(problem, "inner", problem), "half_operator"):
        form = normal_form([(s, V, 0.0) for s, V in solutions])
    elif kind == "fold":
        form = NormalForm()
    else:
        form = by_harmonic_balance(problem, kind, orbit, nu)
    rotation = nu if kind == "neimark-sacker" else np.nan
    v = null_state(system, U)
    left = np.zeros(0) if kind == "fold" and problem.system.autonomous else left_state(M, SHIFT.get(kind, nu), v)
    return replace(form, null_vector=v, left_vector=left, rotation_number=rotation)


def _monodromy(problem: Any, u: np.ndarray, p: float) -> np.ndarray:
    """Return the monodromy matrix (n, n) of a point, that of an autonomous System with the flow direction."""
    inner = getattr(problem, "inner", problem)
    return np.asarray(inner.monodromies([(problem.split(u) if inner is not problem else u, p)])[0])


def left_state(M: np.ndarray, nu: float, v: np.ndarray) -> np.ndarray:
    """Return the left eigenvector w (n,) of a matrix (n, n) for the eigenvalue next to exp(2 pi i nu), with w* v > 0.

    >>> left_state(np.array([[-1.0, 1.0], [0.0, 0.5]]), 0.5, np.array([1.0, 0.0])).round(6).tolist()
    [0.83205, -0.5547]
    """
    mu, vectors = np.linalg.eig(M.T)
    w = vectors[:, int(np.argmin(np.abs(mu - np.exp(2j * np.pi * nu))))].conj()
    if not np.iscomplexobj(v):  # of a double eigenvalue the computed vectors may be complex
        w = (w / w[int(np.argmax(np.abs(w)))]).real
    turn = np.vdot(w, v)
    w = w * (turn / abs(turn) if abs(turn) > 0 else 1.0) / np.linalg.norm(w)
    return np.asarray(w if np.iscomplexobj(v) else w.real)


def _vectors_alone(problem: Any, kind: Kind, M: np.ndarray) -> NormalForm | None:
    """Return a normal form that holds the critical eigenvectors only, as at branch points."""
    if problem.system.autonomous and kind in ("fold", "branch-point"):
        return None  # the multiplier 1 of the flow direction is there, too
    mu, vectors = np.linalg.eig(M)
    if kind == "neimark-sacker":
        pairs = np.flatnonzero(mu.imag > 0)
        i = int(pairs[np.argmin(np.abs(np.abs(mu[pairs]) - 1))])
    else:
        i = int(np.argmin(np.abs(mu - np.exp(2j * np.pi * SHIFT.get(kind, 0.0)))))
    v = vectors[:, i] * (1 / np.linalg.norm(vectors[:, i]))
    v = v * (abs(v[np.argmax(np.abs(v))]) / v[np.argmax(np.abs(v))])
    nu = float(np.angle(mu[i]) / (2 * np.pi)) if kind == "neimark-sacker" else SHIFT.get(kind, 0.0)
    v = v if kind == "neimark-sacker" else v.real
    form = NormalForm(null_vector=v, left_vector=left_state(M, nu, v))
    if kind in ("period-doubling", "neimark-sacker"):
        words = "not computed for a point located without second derivatives"
        form = replace(form, criticality="undetermined", reason=words)
    return replace(form, rotation_number=nu) if kind == "neimark-sacker" else form


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


def _grazing(system: ExtendedProblem, U: np.ndarray, q: float = 0.0) -> float:
    """Return the deviation, relative to the orbit, at which along the null vector a contact appears or vanishes."""
    outer = system.at(q)
    u, p, nu = system.split(U)
    problem = getattr(outer, "inner", outer)
    if not problem.system.contacts:
        return np.inf
    u = outer.split(u) if outer is not problem else u
    null = system.null(U, q)
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
