"""Gauss collocation of ``dx/dtheta = f(x, theta, p) / omega`` over a period: residual, sparse Jacobian, transitions."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from continuation.errors import UnsupportedModel
from continuation.model.system import System
from continuation.orbits.collocation_mesh import Mesh, table

_CORNERS = {
    ca.OP_FABS: "fabs", ca.OP_FMAX: "fmax", ca.OP_FMIN: "fmin", ca.OP_SIGN: "sign", ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_REMAINDER: "remainder", ca.OP_COPYSIGN: "copysign", ca.OP_LT: "<",
    ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_NOT: "not", ca.OP_AND: "and", ca.OP_OR: "or",
    ca.OP_IF_ELSE_ZERO: "if_else",
}  # fmt: skip
_KEPT = 12  # maps and sparse structures
_BLOCK = 1024  # points of several orbits evaluated at once
_CHUNK = 3e6  # numbers in one batch of interval blocks


class Field:
    """The right-hand side in the phase with its Jacobian, evaluated at many points by one mapped CasADi function.

    The Jacobian is known by its entries at ``rows``, ``columns`` (K,), the diagonal among them.
    """

    def __init__(self, system: System, parameter: str) -> None:
        self.system = system
        _refuse_corners(system)
        n = len(system.state_names)
        omega = system.p[system.parameter_names.index(str(system.frequency))]
        self._rate = system.derivative / omega
        jacobian = ca.jacobian(self._rate, system.x)
        pattern = np.eye(n, dtype=bool)
        pattern[jacobian.sparsity().row(), jacobian.sparsity().get_col()] = True
        self.rows, self.columns = np.nonzero(pattern)
        entries = ca.vertcat(*(jacobian[int(r), int(c)] for r, c in zip(self.rows, self.columns, strict=True)))
        outputs = [self._rate, entries, self._by_parameter(parameter)]
        self._all = self._function(outputs)
        self._derivatives = {parameter: self._function(outputs[2:])}
        self._maps: OrderedDict[tuple[Any, int, bool], Any] = OrderedDict()

    def _function(self, outputs: list[ca.SX]) -> ca.Function:
        s = self.system
        return ca.Function("field", [s.x, s.theta, s.p], [ca.densify(e) for e in outputs])

    def _by_parameter(self, name: str) -> ca.SX:
        s = self.system
        return ca.jacobian(self._rate, s.p[s.parameter_names.index(s.check_parameter(name))])

    def __call__(self, x: np.ndarray, theta: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return f/omega (P, n), its Jacobian's entries (P, K), its parameter derivative (P, n).

        ``x`` (P, n), ``theta`` (P,), ``p`` (q,) or (P, q).
        """
        f, entries, by_parameter = self._evaluate("", self._all, x, theta, p)
        return f, entries, by_parameter

    def derivative(self, name: str, x: np.ndarray, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the derivative (P, n) of f/omega in any parameter."""
        if name not in self._derivatives:
            self._derivatives[name] = self._function([self._by_parameter(name)])
        return self._evaluate(name, self._derivatives[name], x, theta, p)[0]

    def _evaluate(self, name: str, function: ca.Function, x: Any, theta: Any, p: np.ndarray) -> list[np.ndarray]:
        if p.ndim == 1:
            return self._mapped(name, function, (x, theta, p))
        parts = [
            self._mapped(name, function, (x[k : k + _BLOCK], theta[k : k + _BLOCK], p[k : k + _BLOCK]))
            for k in range(0, len(theta), _BLOCK)
        ]
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def _mapped(self, name: str, function: ca.Function, given: tuple[np.ndarray, ...]) -> list[np.ndarray]:
        count, common = len(given[1]), given[2].ndim == 1
        key = (name, count if common else _BLOCK, common)
        if key not in self._maps:
            if len(self._maps) >= _KEPT:
                self._maps.popitem(last=False)
            self._maps[key] = _mapped(function, *key[1:])
        arguments, results, run = self._maps[key][:3]
        for held, values in zip(arguments, given, strict=True):
            held[: len(values)] = values
        run()
        return [r[:count].copy() for r in results]


def _mapped(function: ca.Function, count: int, common: bool) -> tuple[list[np.ndarray], list[np.ndarray], Any, Any]:
    """Return argument and result arrays, one point per row, the call that fills the results, and what it needs kept."""
    f = function.map("fields", "serial", count, [2], []) if common else function.map(count)
    n, _, q = (function.numel_in(i) for i in range(3))
    arguments = [np.zeros((count, n)), np.zeros(count), np.zeros(q if common else (count, q))]
    results = [np.zeros((count, function.numel_out(i))) for i in range(function.n_out())]
    made: Any = f.buffer()
    buffer, run = made
    for i, array in enumerate(arguments):
        buffer.set_arg(i, memoryview(array.reshape(-1).data))
    for i, array in enumerate(results):
        buffer.set_res(i, memoryview(array.reshape(-1).data))
    return arguments, results, run, (f, buffer)


def _refuse_corners(system: System) -> None:
    """Refuse a right-hand side that is not smooth.

    The waveform would still converge, but a multiplier errs by the part of an interval that a corner cuts off, which
    changes at random with mesh and degree: its error bar was measured to be too small by up to 1e6.
    """
    if system.contacts:
        raise UnsupportedModel(
            f"system {system.name!r} has contacts, and collocation treats smooth models: use HarmonicBalance or "
            "Shooting, which treat contacts exactly, or discretise system.smoothed(width)"
        )
    f = ca.Function("f", [system.x, system.theta, system.p], [system.derivative])
    for k in range(f.n_instructions()):
        if f.instruction_id(k) in _CORNERS:
            raise UnsupportedModel(
                f"system {system.name!r}: collocation treats smooth models, but the right-hand side uses "
                f"{_CORNERS[f.instruction_id(k)]!r}; smooth it, e.g. fabs(x) as sqrt(x**2 + width**2) and sign(v) as "
                "tanh(v / width), or declare corners as a Contact and use HarmonicBalance or Shooting"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Structure:
    """Where the entries of interval blocks go in the compressed columns of the Jacobian."""

    order: np.ndarray
    indices: np.ndarray
    starts: np.ndarray
    scale: np.ndarray  # (N, m, m+1, 1): root of the weight of the equation over that of the node
    flipped: float  # -1 where the determinant of the linear decay would be negative


class Equations:
    """Collocation equations of one System in one parameter, on any mesh.

    The residual is ``sqrt(weight) * (dx/dtheta - f / omega)`` at the Gauss points; its norm is the root mean square
    over time. The sign of one equation is chosen so that the determinant of the Jacobian has the sign of
    ``det(I - M)`` on every mesh.
    """

    def __init__(self, system: System, parameter: str, multiple: int) -> None:
        self.field = Field(system, parameter)
        self.states, self.multiple = len(system.state_names), multiple
        self._period = 2 * np.pi * multiple
        self._diagonal = self.field.rows == self.field.columns
        self._structures: OrderedDict[int, tuple[Mesh, _Structure]] = OrderedDict()

    def _at_points(self, mesh: Mesh, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return dx/dtheta and x (N*m, n) at the collocation points, and their phases (N*m,)."""
        t, n = table(mesh.degree), self.states
        local = mesh.values(u)[mesh.index]  # (N, m+1, n)
        x = (t.value @ local).reshape(-1, n)
        rate = t.slope @ local / (self._period * mesh.lengths)[:, None, None]
        return rate.reshape(-1, n), x, (self._period * mesh.points()).ravel()

    def residual(self, mesh: Mesh, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return F (N*m*n,) of an unknown u at all parameters p (q,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            rate, x, theta = self._at_points(mesh, u)
            return self._weighted(mesh, rate - self.field(x, theta, p)[0])

    def _weighted(self, mesh: Mesh, rows: np.ndarray) -> np.ndarray:
        weights = np.sqrt(mesh.lengths[:, None] * table(mesh.degree).gauss_weights)
        out: np.ndarray = (rows * weights.reshape(-1, 1)).ravel()
        out[0] *= self._structure(mesh).flipped
        return out

    def derivative(self, mesh: Mesh, u: np.ndarray, p: np.ndarray, name: str) -> np.ndarray:
        """Return dF/d(parameter) (N*m*n,) at fixed u, exact, for any parameter."""
        _, x, theta = self._at_points(mesh, u)
        return self._weighted(mesh, -self.field.derivative(name, x, theta, p))

    def linearise(self, mesh: Mesh, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, sp.csc_array, np.ndarray]:
        """Return F, its sparse Jacobian and its derivative in the continuation parameter."""
        t, (N, m), s = table(mesh.degree), mesh.points().shape, self._structure(mesh)
        with np.errstate(over="ignore", invalid="ignore"):
            rate, x, theta = self._at_points(mesh, u)
            f, entries, by_parameter = self.field(x, theta, p)
            blocks = -t.value[:, :, None] * entries.reshape(N, m, 1, -1)  # (N, m, m+1, K)
            slope = t.slope / (self._period * mesh.lengths)[:, None, None]
            blocks[..., self._diagonal] += slope[..., None]
            blocks *= s.scale
            blocks[0, 0, :, self.field.rows == 0] *= s.flipped
            size = N * m * self.states
            J = sp.csc_array((blocks.ravel()[s.order], s.indices, s.starts), shape=(size, size))
            return self._weighted(mesh, rate - f), J, self._weighted(mesh, -by_parameter)

    def _structure(self, mesh: Mesh) -> _Structure:
        found = self._structures.get(id(mesh))
        if found is None:
            if len(self._structures) >= _KEPT:
                self._structures.popitem(last=False)
            found = self._structures[id(mesh)] = (mesh, self._make_structure(mesh))  # the mesh keeps its id
        return found[1]

    def _make_structure(self, mesh: Mesh) -> _Structure:
        t, n, (N, m) = table(mesh.degree), self.states, mesh.points().shape
        equation = (np.arange(N)[:, None] * m + np.arange(m))[:, :, None, None] * n + self.field.rows
        unknown = mesh.index[:, None, :, None] * n + self.field.columns
        shape = (N, m, m + 1, len(self.field.rows))
        rows, columns = (np.broadcast_to(a, shape).ravel() for a in (equation, unknown))
        order = np.lexsort((rows, columns))
        size = N * m * n
        starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=size))])
        weights = np.sqrt(mesh.lengths[:, None] * t.gauss_weights)
        scale = weights[:, :, None, None] / mesh.root[mesh.index][:, None, :, None]
        # nodes 1, 2, ..., 0 in turn make the matrix block triangular but for the corner that closes the period
        turn = (-1.0) ** (N * m - 1) * np.sign(np.linalg.det(t.slope[:, 1:])) ** N
        flipped = turn if n % 2 else 1.0
        return _Structure(order, rows[order].astype(np.int32), starts.astype(np.int32), scale, float(flipped))

    def along(self, mesh: Mesh, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states (N*m, n) and phases (N*m,) of the collocation points, and the field's Jacobian (N, m, K)."""
        _, x, theta = self._at_points(mesh, u)
        return x, theta, self.field(x, theta, p)[1].reshape(*mesh.points().shape, -1)

    def transitions(self, mesh: Mesh, points: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivative of the state over every interval, (R, N, n, n), and traces integrated, (R,).

        ``points`` are R pairs of an unknown on the mesh and all parameters (q,). The derivatives are those of the
        collocation equations themselves, condensed interval by interval. Cost per orbit: N solutions of m n equations.
        """
        t, n, (N, m) = table(mesh.degree), self.states, mesh.points().shape
        chunk = max(1, int(_CHUNK / (N * (m * n) * (m + 2) * n)))
        matrices, traces = np.empty((len(points), N, n, n)), np.empty(len(points))
        slope = (t.slope / (self._period * mesh.lengths)[:, None, None])[..., None] * np.ones(n)
        weights = self._period * mesh.lengths[:, None] * t.gauss_weights
        each = np.arange(n)
        for first in range(0, len(points), chunk):
            part = points[first : first + chunk]
            entries = self._entries(mesh, part)
            here = slice(first, first + len(part))
            traces[here] = np.einsum("rick,ic->r", entries[..., self._diagonal], weights)
            full = np.zeros((len(part), N, m, n, n))
            full[..., self.field.rows, self.field.columns] = entries
            blocks = -t.value[:, None, :, None] * full[:, :, :, :, None, :]  # (R, N, m, n, m+1, n)
            blocks[..., each, :, each] += slope.transpose(3, 0, 1, 2)[:, None]
            blocks = blocks.reshape(len(part), N, m * n, (m + 1) * n)
            matrices[here] = -np.linalg.solve(blocks[..., n:], blocks[..., :n])[..., -n:, :]
        return matrices, traces

    def _entries(self, mesh: Mesh, points: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return the entries (R, N, m, K) of the Jacobian of the field along several orbits."""
        N, m = mesh.points().shape
        if len(points) == 1:
            _, x, theta = self._at_points(mesh, points[0][0])
            return self.field(x, theta, points[0][1])[1].reshape(1, N, m, -1)
        x = np.concatenate([self._at_points(mesh, u)[1] for u, _ in points])
        theta = np.tile((self._period * mesh.points()).ravel(), len(points))
        p = np.repeat(np.array([vector for _, vector in points]), N * m, axis=0)
        return self.field(x, theta, p)[1].reshape(len(points), N, m, -1)


def products(transitions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the products (R, n, n) of transitions (R, N, n, n) over the period from its start and from its middle.

    Both have the same eigenvalues; the difference of those found is what rounding does to them.
    """
    while transitions.shape[1] > 2:
        odd = transitions[:, -1:] if transitions.shape[1] % 2 else transitions[:, :0]
        even = transitions[:, : transitions.shape[1] // 2 * 2]
        transitions = np.concatenate([even[:, 1::2] @ even[:, ::2], odd], axis=1)
    first, second = transitions[:, 0], transitions[:, 1]
    return second @ first, first @ second
