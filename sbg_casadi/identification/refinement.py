"""Gradient refinement: least squares over all targets that can be followed, with exact sensitivities."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from continuation import ContinuationError
from sbg_casadi.errors import PairError
from sbg_casadi.identification.following import Follower, follow
from sbg_casadi.identification.parametric import Parametric
from sbg_casadi.identification.runs import Runs
from sbg_casadi.identification.targets import Target
from sbg_casadi.identification.unknowns import Candidates

NO_ORBIT = (PairError, ContinuationError, np.linalg.LinAlgError)
"""What a candidate raises that is no pair, or whose orbits can't be followed."""

_FAILED = 1e3  # residual of a candidate without the orbit that is followed
_LEAST_GAIN, _SHORTEST = 1e-4, 1e-7  # of the sum of squares, of the ranges: a step with less is the last


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Hold the targets that are followed near a candidate.

    Attributes
    ----------
    candidates : Candidates
    equations : Parametric
    followers : tuple of Follower
    reasons : dict of str to str
        Why a target is not followed, by its name.
    free : ndarray of int
        Indices of the unknowns that are no choices.
    """

    candidates: Candidates
    equations: Parametric
    followers: tuple[Follower, ...]
    reasons: dict[str, str]
    free: np.ndarray

    def residuals(self, t: np.ndarray) -> np.ndarray:
        """Return the residuals of all followed targets (raises PairError, ContinuationError)."""
        return self.linearise(t, with_gradient=False)[0]

    def linearise(self, t: np.ndarray, with_gradient: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (m,) and their derivatives (m, n) in all coordinates; the solutions are kept."""
        states, rows, values = self.candidates.states(t), [np.zeros((0, len(t)))], [np.zeros(0)]
        own = [f.target.state for f in self.followers] if with_gradient else []
        slopes = self.candidates.slopes(t, own, self.equations.numbers)
        for follower in self.followers:
            state = follower.target.state
            chain = slopes.get(state, np.zeros((0, len(t))))
            moved = np.flatnonzero(np.abs(chain).max(axis=1, initial=0.0))
            names = [self.equations.names[i] for i in moved]
            found = follower.solve(self.equations.values(states[state]), names)
            follower.keep(found)
            values.append(follower.residuals(found))
            rows.append(follower.gradient(found) @ chain[moved])
        return np.concatenate(values), np.vstack(rows)


def build_model(
    candidates: Candidates, equations: Parametric, runs: Runs, targets: Sequence[Target], t: np.ndarray
) -> Model:
    """Find the orbits behind the targets at a candidate."""
    states, followers, reasons, place = candidates.states(t), [], {}, 0
    for target in targets:
        found = follow(equations, runs, target, place, states[target.state])
        place += len(target.labels)
        if isinstance(found, Follower):
            followers.append(found)
        else:
            reasons[target.name] = found
    free = np.flatnonzero([not unknown.choices for unknown in candidates.unknowns])
    return Model(candidates, equations, tuple(followers), reasons, free)


def refine(model: Model, t: np.ndarray, *, steps: int = 30, tell: Callable[[float], None] | None = None) -> np.ndarray:
    """Return coordinates (n,) with the least sum of squares of the followed targets near a start, inside the bounds.

    Trust-region reflective steps of SciPy with exact derivatives; a candidate without a pair or an orbit counts as
    bad, so that the step is taken shorter.

    Parameters
    ----------
    model : Model
    t : ndarray (n,)
    steps : int
        Candidates at most.
    tell : callable, optional
        Told the sum of squares after each.
    """
    if not model.followers or not model.free.size:
        return t
    whole, count = t.copy(), sum(len(f.target.wanted) for f in model.followers)
    least, best = [np.inf], [t.copy()]
    known: dict[bytes, np.ndarray] = {}  # the derivatives of the last candidate: most steps are taken

    def expand(x: np.ndarray) -> np.ndarray:
        whole[model.free] = x
        return whole

    def residuals(x: np.ndarray) -> np.ndarray:
        try:
            found, matrix = model.linearise(expand(x))
        except NO_ORBIT:
            return np.full(count, _FAILED)
        known.clear()
        known[x.tobytes()] = matrix
        squares = float(found @ found)
        if squares < least[0]:
            least[0], best[0] = squares, whole.copy()
        if tell:
            tell(squares)
        return found

    def jacobian(x: np.ndarray) -> np.ndarray:
        matrix = known[x.tobytes()] if x.tobytes() in known else model.linearise(expand(x))[1]
        return matrix[:, model.free]

    inside = np.clip(t[model.free], 1e-6, 1 - 1e-6)
    with suppress(*NO_ORBIT):  # an orbit without derivatives ends the refinement where it is best
        least_squares(
            residuals, inside, jac=jacobian, bounds=(0.0, 1.0), method="trf", x_scale=1.0, max_nfev=steps,
            ftol=_LEAST_GAIN, xtol=_SHORTEST, gtol=1e-10,
        )  # fmt: skip
    return best[0]
