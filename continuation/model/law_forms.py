"""Second and third derivatives of the smooth port law along given directions, exact through CasADi.

Inside one mode of every contact the law is smooth: with phi = s (a - a_0) + phi_0 the derivative of an expression
e(y, phi) along v is ``e_y v + e_phi s (a_y v)``, and so on for the next one. Terms of a mode of slope 0 are left out
even where e_phi is infinite, as of phi**1.5 at 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np


class LawForms:
    """Directional derivatives of the port force w(y, theta, p) inside the modes of its contacts.

    Parameters
    ----------
    symbols : y (k,), phi (g,), theta, p (q,)
    force, argument : SX (m,), SX (g,)
    tables : list of arrays (modes, 5)
        Slope, anchor, force there, lower and upper end of every mode of each contact.

    Examples
    --------
    >>> y, phi, theta, p = (ca.SX.sym(s, n) for s, n in (("y", 1), ("phi", 0), ("theta", 1), ("p", 1)))
    >>> forms = LawForms([y, phi, theta, p], p * y**3, ca.SX(0, 1), [])
    >>> one = np.ones((1, 1))
    >>> float(forms.second(2 * one, np.zeros(1), np.array([5.0]), None, one, one)[0, 0])   # 6 p y
    60.0
    >>> [float(g[0, 0]) for g in forms.gradients(2 * one, np.zeros(1), np.array([5.0]), None, one, one)]
    [60.0, 12.0]
    """

    def __init__(self, symbols: Sequence[ca.SX], force: ca.SX, argument: ca.SX, tables: Sequence[np.ndarray]) -> None:
        y, self._phi, theta, p = symbols
        self._y, self._theta, self._p = y, theta, p
        self._argument, self._tables = argument, list(tables)
        self._mode = ca.SX.sym("mode", 5, self._phi.numel())
        left = ca.SX.sym("left", force.numel())
        first, second, third = (ca.SX.sym(f"v{i}", y.numel()) for i in range(3))
        once = self._along(force, first)
        twice = self._along(once, second)
        form = ca.dot(left, once)
        by_state = self._gradient(form, y)
        by_parameter = self._gradient(form, p)
        self._gradients = self._function("gradients", [left, first], [by_state, by_parameter])
        self._second = self._function("second", [first, second], [twice])
        self._third = self._function("third", [first, second, third], [self._along(twice, third)])

        moves = ca.vertcat(*(self._gradient(argument[i], p) for i in range(argument.numel())))
        self._moves = self._function("moves", [], [moves])

    def _along(self, expression: ca.SX, v: ca.SX) -> ca.SX:
        """Return the total derivative of an expression in y and phi along v."""
        out = ca.jtimes(expression, self._y, v)
        move = ca.jtimes(self._argument, self._y, v) if self._phi.numel() else None
        for i in range(self._phi.numel()):
            out += self._through(expression, i) * move[i]  # type: ignore[index]
        return out

    def _gradient(self, scalar: ca.SX, symbol: ca.SX) -> ca.SX:
        """Return the total derivative of a scalar in y or p as a column."""
        out = ca.densify(ca.gradient(scalar, symbol))
        for i in range(self._phi.numel()):
            out += self._through(scalar, i) * ca.gradient(self._argument[i], symbol)
        return out

    def _through(self, expression: ca.SX, i: int) -> ca.SX:
        """Return slope * d(expression)/d(contact force i), 0 in modes of slope 0."""
        s = self._mode[0, i]
        return ca.if_else(s == 0, 0, s * ca.jacobian(expression, self._phi[i]))

    def _function(self, name: str, directions: list[ca.SX], results: list[ca.SX]) -> ca.Function:
        mode, closed = self._mode, [ca.densify(r) for r in results]
        if self._phi.numel():
            inside = ca.fmin(ca.fmax(self._argument, mode[3, :].T), mode[4, :].T)
            law = mode[2, :].T + mode[0, :].T * (inside - mode[1, :].T)
            closed = ca.substitute(closed, [self._phi], [law])
        return ca.Function(
            name, [self._y, self._theta, self._p, ca.vec(mode), *directions], [ca.densify(r) for r in closed]
        )

    def gradients(
        self,
        y: np.ndarray,
        theta: np.ndarray,
        p: np.ndarray,
        modes: np.ndarray | None,
        left: np.ndarray,
        right: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients (k, N) and (q, N) of ``left . w_y right`` by y and p, for left (m, N), right (k, N)."""
        return tuple(self._run(self._gradients, y, theta, p, modes, left, right))  # type: ignore[return-value]

    def moves(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the derivatives (g, q, N) of the contact arguments by the parameters."""
        modes = np.zeros((self._phi.numel(), theta.size), dtype=int)
        return self._run(self._moves, y, theta, p, modes)[0].reshape(self._phi.numel(), -1, theta.size)

    def second(
        self,
        y: np.ndarray,
        theta: np.ndarray,
        p: np.ndarray,
        modes: np.ndarray | None,
        v0: np.ndarray,
        v1: np.ndarray,
    ) -> np.ndarray:
        """Return ``w_yy v0 v1`` (m, N)."""
        return self._run(self._second, y, theta, p, modes, v0, v1)[0]

    def third(
        self,
        y: np.ndarray,
        theta: np.ndarray,
        p: np.ndarray,
        modes: np.ndarray | None,
        v0: np.ndarray,
        v1: np.ndarray,
        v2: np.ndarray,
    ) -> np.ndarray:
        """Return ``w_yyy v0 v1 v2`` (m, N)."""
        return self._run(self._third, y, theta, p, modes, v0, v1, v2)[0]

    def _run(
        self,
        function: ca.Function,
        y: np.ndarray,
        theta: np.ndarray,
        p: np.ndarray,
        modes: np.ndarray | None,
        *directions: np.ndarray,
    ) -> list[np.ndarray]:
        count = theta.size
        table = np.zeros((0, count))
        if modes is not None and self._tables:
            table = np.hstack([t[j] for t, j in zip(self._tables, modes, strict=True)]).T
        found = function(y, theta.reshape(1, -1), p, table, *directions)
        return [np.array(f).reshape(-1, count) for f in (found if isinstance(found, tuple) else (found,))]
