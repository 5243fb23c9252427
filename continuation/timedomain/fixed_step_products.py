"""Steps of a model that is linear in its contact modes, as products of step matrices: many steps in one product."""

from __future__ import annotations

import casadi as ca
import numpy as np

from continuation.timedomain.fixed_step_functions import TABLEAUS, ModeModel
from continuation.timedomain.kernels import Batch

Table = tuple[np.ndarray, np.ndarray]
"""Matrices (starts, 32 * rows, n) and constants (starts, 32 * rows)."""

BLOCK, EVERY = 32, 16
"""Steps that one product gives at most; a product begins at every sixteenth point of the grid."""

_LARGEST = 4_000_000  # numbers in the table of one mode


class StepProducts:
    """Give the points after many steps from a state as one matrix times that state.

    Parameters
    ----------
    model : ModeModel
    order : int
        One of :data:`~continuation.timedomain.fixed_step_functions.TABLEAUS`.

    Notes
    -----
    In a contact mode ``x' = A(theta) x + b(theta)``, and any explicit Runge-Kutta step is ``x -> M x + c`` with numbers
    known beforehand for every interval of the grid. Their products over up to 32 steps are tabulated, with the
    derivative and the contact arguments and their rates there. For the 14-state gear a table of 256 steps takes 5 ms;
    32 steps from it 6 microseconds, in the virtual machine 60.
    """

    def __init__(self, model: ModeModel, order: int) -> None:
        A, b, c = TABLEAUS[order]
        self._rows, self._weights = [np.array(row, dtype=float) for row in A], np.array(b, dtype=float)
        self._instants = np.array([*c[: len(b)], 1.0], dtype=float)
        along = ca.jtimes(model.arguments, model.x, model.rate)
        along += model.frequency * ca.jacobian(model.arguments, model.theta)
        found = ca.vertcat(model.rate, model.arguments, along)
        matrix = ca.jacobian(found, model.x)
        self.linear = not ca.depends_on(matrix, model.x)
        constant = ca.substitute(found, model.x, ca.DM.zeros(model.x.shape))
        given = [model.theta, model.p, model.slopes, model.intercepts]
        affine = ca.cse(ca.horzcat(matrix, constant))
        self._affine = Batch(ca.Function("affine", given, [ca.densify(affine)])) if self.linear else None
        self._size = model.x.numel(), found.numel()

    def fits(self, steps: int) -> bool:
        """Whether the model is linear in its modes and the table of so many steps a period is of reasonable size."""
        n, rows = self._size
        return self.linear and BLOCK // EVERY * steps * (n + rows) * (n + 1) <= _LARGEST

    def table(self, p: np.ndarray, h: float, turn: float, steps: int, law: tuple[np.ndarray, np.ndarray]) -> Table:
        """Return what a state is multiplied by, and what is added, to give x, k, a, r after each of 32 steps.

        Parameters
        ----------
        p : ndarray (q,)
        h, turn : float
            Step in time, phase per time.
        steps : int
            Number of steps in a period; what lies beyond its end means nothing.
        law : (ndarray (m,), ndarray (m,))
            Slopes and intercepts of the contacts.

        Returns
        -------
        matrices : ndarray (starts, 32 * rows, n)
        constants : ndarray (starts, 32 * rows)
        """
        n, rows = self._size
        distinct, place = np.unique(self._instants, return_inverse=True)
        phases = (h * turn * (np.arange(steps)[:, None] + distinct)).ravel()
        given = [np.broadcast_to(v, (len(phases), len(v))) for v in (p, *law)]
        assert self._affine is not None
        values = self._affine(phases, *given)[0].reshape(steps, len(distinct), n + 1, rows)
        stages = np.ascontiguousarray(values.transpose(1, 0, 3, 2))
        begin = np.eye(n, n + 1)
        slopes: list[np.ndarray] = []
        for row, at in zip(self._rows, place, strict=False):
            state = begin + sum((h * w * k for w, k in zip(row, slopes, strict=False) if w), np.zeros(1))
            slopes.append(_composed(stages[at][:, :n], np.broadcast_to(state, (steps, n, n + 1))))
        step = begin + sum((h * w * k for w, k in zip(self._weights, slopes, strict=True) if w), np.zeros(1))
        short = _short_products(step, begin)
        products = np.empty((len(short), BLOCK, n + rows, n + 1))
        products[:, :EVERY, :n] = short
        products[-1, EVERY:] = 0.0  # beyond the end of the period
        products[:-1, EVERY:, :n] = _composed(short[1:], short[:-1, -1:])
        first = EVERY * np.arange(len(short))[:, None] + np.arange(BLOCK)
        after = stages[place[-1]][np.minimum(first, steps - 1)]
        products[:, :, n:] = _composed(after, products[:, :, :n])
        table = products.reshape(len(short), BLOCK * (n + rows), n + 1)
        return np.ascontiguousarray(table[..., :n]), np.ascontiguousarray(table[..., n])


def _short_products(step: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Return the maps (k, 16, n, n + 1) over the first 1 to 16 steps from every sixteenth point of the grid."""
    count, shape = -(-len(step) // EVERY), begin.shape
    padded = np.concatenate([step, np.broadcast_to(begin, (count * EVERY - len(step), *shape))])
    padded = padded.reshape(count, EVERY, *shape)
    products = np.empty_like(padded)
    products[:, 0] = padded[:, 0]
    for i in range(1, EVERY):
        products[:, i] = _composed(padded[:, i], products[:, i - 1])
    return products


def _composed(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Return the affine maps (..., r, n + 1) after the affine maps (..., n, n + 1)."""
    result = outer[..., :-1] @ inner
    result[..., -1] += outer[..., -1]
    return result
