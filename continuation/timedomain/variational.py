"""Derivatives of event-exact trajectories: step matrices of all steps in one batch, and their products.

Within a step the variational equation is carried by the method that carries the state, through its own stages. A
contact change contributes nothing: the force is continuous. The matrices of many steps are made at once, so that a
14-state gear needs about 20 microseconds a step without machine code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from continuation.errors import RestingContact
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.trajectory import Trajectory

_HALVINGS = 8  # of a step of the state, where its derivatives vary faster
_LOOSER = 10  # the error estimate, of lower order, is that much larger than the error of the matrix, or more
_RESTS = 1e-2  # phase in rad for which an argument must stay at a breakpoint to count as resting


@dataclass(frozen=True, slots=True, eq=False)
class Tangents:
    """Derivatives over the K steps of several trajectories, one after the other.

    Attributes
    ----------
    x, theta, h : ndarray (K, n), (K,), (K,)
        State and phase at the start of each step, and its length.
    slopes, intercepts : ndarray (K, m)
        Of the contacts during the step.
    owner, place : ndarray of int (K,)
        Trajectory, and the step of it that this one is, or is a part of.
    matrices : ndarray (K, n, n)
        Derivative of the state after the step with respect to the state before.
    traces : ndarray (K,)
        Integral of the trace of the Jacobian.
    """

    x: np.ndarray
    theta: np.ndarray
    h: np.ndarray
    slopes: np.ndarray
    intercepts: np.ndarray
    owner: np.ndarray
    place: np.ndarray
    matrices: np.ndarray
    traces: np.ndarray

    def whole(self, trajectory: int) -> np.ndarray:
        """Return the derivative (n, n) of the end of a trajectory by its start."""
        return _product(self.matrices[self.owner == trajectory])


def tangents(integrator: ExactIntegrator, runs: list[Trajectory], p: np.ndarray) -> Tangents:
    """Differentiate trajectories along their own steps.

    Parameters
    ----------
    runs : list of Trajectory
        At the parameters p (q,).

    Raises
    ------
    RestingContact
        If a contact argument stays at a breakpoint, where the derivative does not exist.
    """
    laws = [integrator.laws_of(run.modes) for run in runs]
    counts = [len(run.modes) for run in runs]
    given = [
        np.concatenate([run.states[:-1] for run in runs]),
        np.concatenate([run.phases[:-1] for run in runs]),
        np.concatenate([np.diff(run.phases) for run in runs]),
        np.concatenate([law[0] for law in laws]),
        np.concatenate([law[1] for law in laws]),
        np.repeat(np.arange(len(runs)), counts),
        np.concatenate([np.arange(c) for c in counts]),
    ]
    done = []
    for depth in range(_HALVINGS + 1):
        matrices, traces, accurate = _matrices(integrator, given, p, depth == 0)
        if accurate.all() or depth == _HALVINGS:
            done.append([*given, matrices, traces])
            break
        done.append([v[accurate] for v in (*given, matrices, traces)])
        given = _halves(integrator, [v[~accurate] for v in given], p)
    joined = done[0]
    if len(done) > 1:
        together = [np.concatenate(parts) for parts in zip(*done, strict=True)]
        order = np.lexsort((together[1], together[5]))
        joined = [v[order] for v in together]
    return Tangents(*joined)


def sensitivities(
    integrator: ExactIntegrator, known: Tangents, count: int, p: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """Return the derivatives (count, n) of the ends of the trajectories in another direction of the parameters.

    Cheap after :func:`tangents`: the step matrices are known.
    """
    forcing = _forcing(integrator, [known.x, known.theta, known.h, known.slopes, known.intercepts], p, direction)
    ends = np.zeros((count, known.x.shape[1]))
    for matrix, push, owner in zip(known.matrices, forcing, known.owner, strict=True):
        ends[owner] = matrix @ ends[owner] + push
    return ends


def _halves(integrator: ExactIntegrator, given: list[np.ndarray], p: np.ndarray) -> list[np.ndarray]:
    """Return both halves of steps."""
    x, theta, h, slopes, intercepts, owner, place = given
    middle = integrator.functions.advance(x, theta, h / 2, np.full((len(h), len(p)), p), slopes, intercepts)[0][:, 0]
    pairs = [(x, middle), (theta, theta + h / 2), (h / 2, h / 2)]
    pairs += [(v, v) for v in (slopes, intercepts, owner, place)]
    return [np.concatenate(pair) for pair in pairs]


def _matrices(
    integrator: ExactIntegrator, given: list[np.ndarray], p: np.ndarray, first: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return step matrices (K, n, n), integrated traces (K,), and whether each matrix is accurate (K,)."""
    x, theta, h, slopes, intercepts = given[:5]
    constants = np.full((len(h), len(p)), p), slopes, intercepts
    columns, squares, trace, met = integrator.functions.transition(x, theta, h, *constants)
    if first and met.size:
        _check_rest(integrator, met, theta, h, p)
    matrices = columns.transpose(0, 2, 1)
    fifth, third = squares[..., 0], squares[..., 1]
    error = np.divide(fifth, np.sqrt(fifth + 0.01 * third), out=np.zeros_like(fifth), where=fifth > 0)
    scale = np.sqrt(np.maximum(1.0, (matrices**2).sum(axis=1)))
    return matrices, trace[:, 0, 0], np.all(error <= _LOOSER * integrator.rtol * scale, axis=1)


def _forcing(integrator: ExactIntegrator, given: list[np.ndarray], p: np.ndarray, d: np.ndarray) -> np.ndarray:
    x, theta, h, slopes, intercepts = given[:5]
    constants = np.full((len(h), len(p)), p), slopes, intercepts, np.full((len(h), len(d)), d)
    return integrator.functions.forcing(x, theta, h, *constants)[0][:, 0]


def _check_rest(integrator: ExactIntegrator, met: np.ndarray, theta: np.ndarray, h: np.ndarray, p: np.ndarray) -> None:
    """Refuse contact arguments met (K, 12, m) that stay at a breakpoint for a while."""
    for i, levels in enumerate(integrator.breakpoints()):
        argument = met[:, :, i]
        close = 10 * (integrator.atol + integrator.rtol * float(abs(argument).max()))
        for level in levels:
            rests = abs(argument - level).max(axis=1) <= close
            if not rests.any() or float(h[rests].sum()) < _RESTS:
                continue
            system, at = integrator.system, float(theta[rests][0])
            values = dict(zip(system.parameter_names, p.tolist(), strict=True))
            given = ", ".join(f"{k} = {v:.10g}" for k, v in values.items())
            raise RestingContact(
                f"contact {system.contacts[i].name!r} of {system.name!r} rests on its breakpoint {level:g} from phase "
                f"{at:.6g} on ({given}): the law has a corner there, so that Newton's method and multipliers do not "
                "exist; give the load another value (zero load leaves the contact undecided), or use "
                "system.smoothed(width)",
                at,
                values,
            )


def _product(stack: np.ndarray) -> np.ndarray:
    """Return the product of matrices (K, n, n), the last one leftmost, in pairs."""
    while len(stack) > 1:
        pairs = stack[1::2] @ stack[: 2 * (len(stack) // 2) : 2]
        stack = np.concatenate([pairs, stack[-1:]]) if len(stack) % 2 else pairs
    return stack[0]
