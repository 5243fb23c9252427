"""Second derivatives of the event-exact flow: gradients of bilinear forms of its transition matrix.

With xi = v carried by the variational equation, the pair (x, xi) is a flow whose rate ``(f, A xi)`` jumps at a contact
change by ``(0, [A] xi)``: the gradient of ``w . M v`` is its adjoint, carried backwards through the steps by CasADi's
reverse mode and over a contact change by the adjoint of its saltation matrix,

    a(before) = a(after) + (b . [A] xi) / (d argument/dphase) * d argument/dx,     [A] = [slope] gain (d argument/dx)^T.

Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, section 7.3, for the saltation
matrix of a discontinuous flow, here that of state and variation together.
"""

from __future__ import annotations

import numpy as np

from continuation.errors import GrazingContact
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.trajectory import Trajectory
from continuation.timedomain.variational import Tangents

_GRAZES = 10.0  # roots of the tolerance below which the speed at a contact change is not known: it is that of the depth


def form_gradients(
    integrator: ExactIntegrator,
    run: Trajectory,
    known: Tangents,
    owner: int,
    p: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients of ``w . M v``, M the derivative of the end of a trajectory by its start.

    Parameters
    ----------
    run : Trajectory
    known, owner : Tangents, int
        Step matrices, and which of their trajectories this is.
    p : ndarray (q,)
    v, w : ndarray (n,)

    Returns
    -------
    by_state : ndarray (n,)
        Gradient with respect to the state at the start.
    by_parameters : ndarray (q,)
        With respect to all parameters, at a fixed start.

    Raises
    ------
    GrazingContact
        If a contact argument changes its piece with vanishing speed, where the gradient is infinite.
    """
    mine = np.flatnonzero(known.owner == owner)
    xi = [np.asarray(v, dtype=float)]
    for k in mine:
        xi.append(known.matrices[k] @ xi[-1])
    a, b, total = np.zeros(len(v)), np.asarray(w, dtype=float), np.zeros(len(p))
    jumps = _jumps(integrator, run)
    second = integrator.functions.second
    for i in range(len(mine) - 1, -1, -1):
        k = mine[i]
        law = known.slopes[k], known.intercepts[k]
        if i + 1 < len(mine) and known.place[mine[i + 1]] != known.place[k]:  # the start and the end are no changes
            place = int(known.place[k]) + 1
            for contact, jump in jumps.get(place, []):
                push, extra = _over(integrator, run, place, law, p, xi[i + 1], b, contact, jump)
                a, total = a + push, total + extra
        a, b, by_p = second(known.x[k], known.theta[k], known.h[k], p, *law, xi[i], a, b)
        total = total + by_p
    return a, total


def _jumps(integrator: ExactIntegrator, run: Trajectory) -> dict[int, list[tuple[int, float]]]:
    """Return, by the number of steps before, the contacts that change and the jumps of their slopes."""
    found: dict[int, list[tuple[int, float]]] = {}
    pieces: dict[tuple[int, int], int] = {}
    for (_, contact, direction), place in zip(run.changes, run.places, strict=True):
        if place == 0:
            continue
        slopes = np.array(integrator.system.contacts[contact].slopes)
        before = pieces.get((place, contact), int(run.modes[place - 1, contact]))
        pieces[place, contact] = before + direction
        found.setdefault(place, []).append((contact, float(slopes[before + direction] - slopes[before])))
    return found


def _over(
    integrator: ExactIntegrator,
    run: Trajectory,
    place: int,
    law: tuple[np.ndarray, np.ndarray],
    p: np.ndarray,
    xi: np.ndarray,
    b: np.ndarray,
    contact: int,
    jump: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what one contact change adds to the adjoint of the state and to the gradient by the parameters."""
    theta = float(run.phases[place])
    strength, along, by_x, by_p = integrator.functions.jump(run.states[place], theta, p, *law, xi, b)
    m = len(strength)
    speed = float(along[contact])
    if abs(speed) <= _GRAZES * np.sqrt(integrator.atol + integrator.rtol):
        values = dict(zip(integrator.system.parameter_names, p.tolist(), strict=True))
        given = ", ".join(f"{k} = {v:.10g}" for k, v in values.items())
        raise GrazingContact(
            f"contact {integrator.system.contacts[contact].name!r} of {integrator.system.name!r} grazes at phase "
            f"{theta:.10g} ({given}): second derivatives of the flow are infinite there; step over this value",
            theta,
            values,
        )
    scale = jump * float(strength[contact]) / speed
    return scale * by_x.reshape(m, -1)[contact], scale * by_p.reshape(m, -1)[contact]
