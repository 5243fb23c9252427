"""The nonlinear port force of a System as CasADi functions, evaluated on many samples at once.

The force is ``w(y, theta, p, phi_1(a_1(y, theta, p)), ...)`` with w smooth and phi the laws of the contacts that do not
enter linearly. Inside one mode of every contact it is smooth; the modes are given with the samples, so that a sample
next to a corner is taken on the side that is meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from continuation.model.contact import Contact
from continuation.model.law_forms import LawForms

_BLOCKS = (512, 64)  # samples per call of CasADi: making a function for every number of samples would cost more


class PortLaw:
    """Port force (m,) of the port arguments y (k,), the phase, the parameters and g contact forces phi.

    Parameters
    ----------
    symbols : y (k,), phi (g,), theta, p (q,)
    force, slope : SX (m,), SX (m, k)
        Port force in these symbols and its derivative by y at fixed phi.
    arguments : SX (g,)
        Contact arguments in y, theta and p.
    contacts : sequence of Contact, length g

    Examples
    --------
    >>> y, phi, theta, p = (ca.SX.sym(s) for s in ("y", "phi", "theta", "p"))
    >>> stop = Contact(argument=y, breakpoints=(1.0,), slopes=(0.0, 2.0))
    >>> law = PortLaw([y, phi, theta, p], phi**2, ca.SX(1, 1), y, [stop])
    >>> [v.ravel().tolist() for v in law(np.array([[0.0, 2.0]]), np.zeros(2), np.zeros(1))]
    [[0.0, 4.0], [0.0, 8.0]]
    """

    def __init__(
        self, symbols: Sequence[ca.SX], force: ca.SX, slope: ca.SX, arguments: ca.SX, contacts: Sequence[Contact]
    ) -> None:
        y, phi, theta, p = symbols
        self.contacts, self._symbols = tuple(contacts), tuple(symbols)
        self._force, self._slope, self._argument = force, slope, arguments
        self.inputs, self.outputs, g = force.numel(), y.numel(), len(self.contacts)
        self.free = ca.Function("free", [y, phi, theta, p], [ca.densify(force), ca.densify(arguments)])
        self._tables = [_table(c) for c in self.contacts]
        self._maps: dict[tuple[str, int, bool], Any] = {}
        self._changes: dict[int, ca.Function | None] = {}
        moves = [ca.jacobian(force, phi), ca.jacobian(arguments, y)]
        self._function = self._closed("law", [force, slope, *moves]) if g else self._plain("law", [force, slope])

    def _plain(self, name: str, results: Sequence[ca.SX]) -> ca.Function:
        y, _, theta, p = self._symbols
        return ca.Function(name, [y, theta, p], [ca.densify(r) for r in results])

    def _closed(self, name: str, results: Sequence[ca.SX]) -> ca.Function:
        """Return results with phi of given modes put in; per contact: slope, anchor, force there, lower, upper end."""
        y, phi, theta, p = self._symbols
        mode = ca.SX.sym("mode", 5, phi.numel())
        inside = ca.fmin(ca.fmax(self._argument, mode[3, :].T), mode[4, :].T)  # rounding must not leave the mode
        law = mode[2, :].T + mode[0, :].T * (inside - mode[1, :].T)
        closed = ca.substitute([ca.densify(r) for r in results], [phi], [law])
        return ca.Function(name, [y, theta, p, ca.vec(mode)], closed)

    def modes(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the mode of every contact (g, N) at y (k, N), theta (N,)."""
        return np.array([c.mode(a) for c, a in zip(self.contacts, self.arguments(y, theta, p), strict=True)])

    def arguments(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Evaluate the contact arguments (g, N) at y (k, N), theta (N,), p (q,) or (q, N)."""
        return self._run("arguments", self._arguments, y, theta, p, None)[0].T.copy()

    @cached_property
    def _arguments(self) -> ca.Function:
        return self._plain("arguments", [self._argument])

    def __call__(
        self, y: np.ndarray, theta: np.ndarray, p: np.ndarray, modes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the port force (m, N) and its slope (m, k, N) at y (k, N), theta (N,), p (q,) or (q, N).

        ``modes`` (g, N) are the modes of the contacts; those of their arguments when not given.
        """
        count, m, k, g = theta.size, self.inputs, self.outputs, len(self.contacts)
        if not g:
            force, slope = self._run("law", self._function, y, theta, p, None)
            return force.T.copy(), slope.reshape(count, k, m).transpose(2, 1, 0).copy()
        modes = self.modes(y, theta, p) if modes is None else modes
        force, own, push, move = self._run("law", self._function, y, theta, p, modes)
        s = self._slopes(modes)
        through = _where_closed(s[:, None], push.reshape(count, g, m).transpose(1, 2, 0))  # (g, m, N)
        slope = own.reshape(count, k, m).transpose(2, 1, 0)
        return force.T.copy(), slope + np.einsum("gmn,kgn->mkn", through, move.reshape(count, k, g).transpose(1, 2, 0))

    def corner(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray, modes: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return d(force)/d(contact force) (m, g, N) and the slopes of the contact arguments (g, k, N)."""
        count, m, k, g = theta.size, self.inputs, self.outputs, len(self.contacts)
        _, _, push, move = self._run("law", self._function, y, theta, p, modes)
        return push.reshape(count, g, m).transpose(2, 1, 0), move.reshape(count, k, g).transpose(2, 1, 0)

    # ---------------------------------------------------------------- further derivatives
    @cached_property
    def forms(self) -> LawForms:
        """Second and third derivatives along given directions."""
        return LawForms(self._symbols, self._force, self._argument, self._tables)

    def depends(self, index: int) -> bool:
        """Whether force or contact arguments depend on parameter ``index``."""
        if index not in self._changes:
            _, phi, _, p = self._symbols
            own, move = (ca.jacobian(e, p[index]) for e in (self._force, self._argument))
            if own.is_zero() and move.is_zero():
                self._changes[index] = None
            elif self.contacts:
                self._changes[index] = self._closed(f"change_{index}", [own, ca.jacobian(self._force, phi), move])
            else:
                self._changes[index] = self._plain(f"change_{index}", [own])
        return self._changes[index] is not None

    def change(
        self, y: np.ndarray, theta: np.ndarray, p: np.ndarray, index: int, modes: np.ndarray | None = None
    ) -> np.ndarray:
        """Return d(force)/dp[index] (m, N) inside the modes, y held fixed."""
        count, m, g = theta.size, self.inputs, len(self.contacts)
        if not self.depends(index):
            return np.zeros((m, count))
        function: Any = self._changes[index]
        if not g:
            return self._run(f"change_{index}", function, y, theta, p, None)[0].T.copy()
        modes = self.modes(y, theta, p) if modes is None else modes
        own, push, move = self._run(f"change_{index}", function, y, theta, p, modes)
        through = _where_closed(self._slopes(modes)[:, None], push.reshape(count, g, m).transpose(1, 2, 0))
        return own.T + np.einsum("gmn,gn->mn", through, move.T)

    # ---------------------------------------------------------------- evaluation
    def _slopes(self, modes: np.ndarray) -> np.ndarray:
        return np.array([t[j, 0] for t, j in zip(self._tables, modes, strict=True)])

    def _run(
        self, name: str, f: ca.Function, y: np.ndarray, theta: np.ndarray, p: np.ndarray, modes: np.ndarray | None
    ) -> list[np.ndarray]:
        """Call a function on samples, in blocks; returns its results, one row per sample."""
        count = theta.size
        given = [y.T, theta, p.T]
        if modes is not None:
            given.append(np.hstack([t[j] for t, j in zip(self._tables, modes, strict=True)]))
        out = [np.empty((count, f.numel_out(i))) for i in range(f.n_out())]
        start = 0
        while start < count:
            block = _BLOCKS[0] if count - start >= _BLOCKS[0] else _BLOCKS[1]
            arguments, results, run = self._mapped(name, f, block, p.ndim == 1)
            size = min(block, count - start)
            for i, (held, value) in enumerate(zip(arguments, given, strict=True)):
                if i == 2 and p.ndim == 1:
                    held[...] = value
                else:
                    held[:size] = value[start : start + size]
                    held[size:] = value[-1]
            run()
            for array, result in zip(out, results, strict=True):
                array[start : start + size] = result[:size]
            start += size
        return out

    def _mapped(
        self, name: str, f: ca.Function, count: int, common: bool
    ) -> tuple[list[np.ndarray], list[np.ndarray], Any]:
        """Return argument and result arrays, one sample per row, and the call that fills the results (kept)."""
        key = (name, count, common)
        if key not in self._maps:
            many = f.map(name, "serial", count, [2], []) if common else f.map(count)
            sizes = [f.numel_in(i) for i in range(f.n_in())]
            shapes: list[tuple[int, ...]] = [(count, size) for size in sizes]
            shapes[1], shapes[2] = (count,), (sizes[2],) if common else (count, sizes[2])
            arguments = [np.zeros(shape) for shape in shapes]
            results = [np.zeros((count, f.numel_out(i))) for i in range(f.n_out())]
            made: Any = many.buffer()
            buffer, run = made
            for i, array in enumerate(arguments):
                buffer.set_arg(i, memoryview(array.reshape(-1).data))
            for i, array in enumerate(results):
                buffer.set_res(i, memoryview(array.reshape(-1).data))
            self._maps[key] = (arguments, results, run, (many, buffer))  # CasADi does not keep the last two alive
        return self._maps[key][:3]


def _where_closed(slope: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return slope * value, 0 where the slope is 0 even if the value is infinite (as d2/dphi2 of phi**1.5 is)."""
    return np.asarray(slope * np.where(slope == 0, 0.0, value))


def _table(contact: Contact) -> np.ndarray:
    """Return slope, anchor, force at the anchor, lower and upper end of every mode, shape (modes, 5).

    Anchors are the breakpoints towards argument 0 (0 itself in its own mode), so that a force that is zero up to a
    breakpoint is exactly zero there. The ends are off the breakpoints by rounding, where phi * sqrt(|phi|) has a slope.
    """
    b, s = np.array(contact.breakpoints), np.array(contact.slopes)
    off = np.maximum(2 * np.spacing(np.abs(b)), 1e-290)
    lower, upper = np.append(-np.inf, b + off), np.append(b - off, np.inf)
    rest = int(contact.mode(0.0))
    anchor, force = np.zeros(len(s)), np.zeros(len(s))
    for j in range(rest + 1, len(s)):
        anchor[j] = b[j - 1]
        force[j] = force[j - 1] + s[j - 1] * (b[j - 1] - anchor[j - 1])
    for j in range(rest - 1, -1, -1):
        anchor[j] = b[j]
        force[j] = force[j + 1] + s[j + 1] * (b[j] - anchor[j + 1])
    return np.column_stack([s, anchor, force, lower, upper])
