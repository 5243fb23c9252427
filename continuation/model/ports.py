"""Find the constant linear part of a System and the few nonlinear or time-varying ports it is closed by.

Any System is written exactly as

    dx/dt = A(p) x + u(theta, p) + B(p) w(theta, p; y),      y = C(p) x,

with the port force ``w = r(y, theta, p) + sum_c gain_c(theta, p) * force_c(d_c . y + offset_c(theta, p))``: the
contacts that enter linearly, and a rest r that is smooth but for the contacts that do not (a gain that depends on
states, a force that is squared, an argument that is not linear). B has as many columns as the forces have independent
directions, C as many rows as they have independent arguments; a gear pair of any number of coordinates has one of
each. Where no structure is found, B and C become square and the same formulas solve the model in full.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from continuation.errors import UnsupportedModel
from continuation.model.forcing import PROBES, Excitation, Forcing, dependence
from continuation.model.linear_part import (
    LinearPart,
    Matrix,
    add_ports,
    as_matrix,
    conditioning,
    interpolate,
    large,
    largest,
    pivots,
)
from continuation.model.port_law import PortLaw
from continuation.model.recent import Recent
from continuation.model.system import System

_SAMPLES = 12
_PARTS, _FEW = 256, 32  # linear parts that are kept, of Systems with as few states; one of others


class Ports:
    """The port structure of a System; evaluates its parts at a parameter vector and caches the last ones.

    Attributes
    ----------
    law : PortLaw
        The rest r of the port force.
    closed, general : tuple of int
        Contacts that enter linearly (with a gain of phase and parameters only, and an argument linear in the states
        with constant coefficients), and those that are part of ``law``.
    smooth : bool
        Whether there is a rest at all.
    rest : array (n,)
        A state at which the model is finite: 0 if it is finite there.
    parts_kept : int
        Number of linear parts, of different parameters, that are worth keeping, with what is made of them.

    Raises
    ------
    UnsupportedModel
        If the right-hand side jumps, or the ports change their number with the parameters.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega"))
    >>> s = System(name="duffing", states={"x": x, "v": v},
    ...            derivatives={"x": v, "v": -x - x**3 - 0.1*v + ca.cos(theta)}, phase=theta, frequency="omega",
    ...            parameters={"omega": (omega, 1.0)})
    >>> ports = Ports(s)
    >>> ports.inputs, ports.outputs
    (1, 1)
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self._derivatives: dict[int, Any] = {}
        x, phi, theta, p = system.x, system.phi, system.theta, system.p
        f, arguments = system.derivative, system.arguments
        self._jacobian = ca.jacobian(f, x)
        self._gains, self._slopes = ca.jacobian(f, phi), ca.jacobian(arguments, x)
        self._sort_contacts()
        self._constant, self._varying = self._split()
        self._active_rows, self._active_cols = self._support()
        self._find_pivots()
        u, offset = self._at_rest()
        self._u, self._offset = ca.sparsify(u), ca.densify(_kept_rows(offset, self._straight))
        self._forced = np.array(self._u.sparsity().row(), dtype=int)  # the states that are forced
        self._build_functions(theta, p)
        self._check_structure()
        self._slope: np.ndarray | None = None
        self.parts_kept = _PARTS if len(system.state_names) <= _FEW else 1
        self._parts: Recent[LinearPart] = Recent(self.parts_kept)
        self._last: tuple[np.ndarray, LinearPart] | None = None

    def _sort_contacts(self) -> None:
        s, count = self.system, range(len(self.system.contacts))
        self._straight = [not ca.depends_on(self._slopes[i, :], ca.vertcat(s.x, s.theta)) for i in count]
        closed = [self._straight[i] and not ca.depends_on(self._gains[:, i], ca.vertcat(s.x, s.phi)) for i in count]
        self.closed = tuple(i for i in count if closed[i])
        self.general = tuple(i for i in count if not closed[i])

    def straight(self, i: int) -> bool:
        """Whether the argument of contact i is linear in the states, with constant coefficients."""
        return self._straight[i]

    def _at_rest(self) -> tuple[ca.SX, ca.SX]:
        """Return what drives the states, and the contact arguments, at a state where the law carries no force.

        That state is 0, or another one where the model is singular at 0, as a direction ``x / sqrt(x^2 + y^2)`` is.
        """
        s = self.system
        zero = [ca.SX.zeros(s.x.shape), ca.SX.zeros(s.phi.shape)]
        u, arguments = ca.substitute([s.derivative, s.arguments], [s.x, s.phi], zero)
        closed = s.closed() if self.general else ca.SX(0, 1)
        rates = ca.Function("rest", [s.x, s.theta, s.p], [ca.sparsify(u), closed])
        values = rates(np.zeros(len(s.state_names)), PROBES.reshape(1, -1), s.parameter_vector())
        fine = [bool(np.all(np.isfinite(np.array(v.nonzeros())))) for v in values]
        self.rest = np.zeros(len(s.state_names)) if all(fine) else self._points[0][:, 0]
        if fine[0]:
            return u, arguments
        x = ca.SX(ca.DM(self._points[0][:, 0]))
        return ca.substitute([s.derivative], [s.x, s.phi], [x, zero[1]])[0] - self._constant @ x, arguments

    def _split(self) -> tuple[ca.SX, ca.SX]:
        """Split df/dx into entries that depend on parameters only and entries that vary along an orbit."""
        jacobian: Any = ca.sparsify(self._jacobian)
        if jacobian.nnz() == 0:
            return jacobian, jacobian
        nonzeros: list[Any] = jacobian.nonzeros()
        entries = ca.vertcat(*nonzeros)
        varies = ca.which_depends(entries, ca.vertcat(self.system.x, self.system.phi, self.system.theta), 1, True)
        parts = [ca.vertcat(*(e if v == keep else ca.SX(0) for e, v in zip(nonzeros, varies, strict=True)))
                 for keep in (False, True)]  # fmt: skip
        constant, varying = (ca.sparsify(ca.SX(jacobian.sparsity(), part)) for part in parts)
        return constant, varying

    def _support(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states whose rates the ports act on, and the states that their arguments depend on."""
        places = [np.array(e.sparsity().get_triplet(), dtype=int) for e in (self._varying, self._gains, self._slopes)]
        rows, cols = (np.unique(np.concatenate(found)) for found in ([places[0][0], places[1][0]],
                                                                     [places[0][1], places[2][1]]))  # fmt: skip
        return (rows, cols) if rows.size and cols.size else (np.array([0]), np.array([0]))

    def _sample_function(self) -> ca.Function:
        s = self.system
        return ca.Function("samples", [s.x, s.phi, s.theta, s.p], [ca.densify(e) for e in self.sampled_parts()])

    def sampled_parts(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return what B and C are made of: varying Jacobian, contact gains, argument slopes, each where not zero."""
        rows, cols = self._active_rows.tolist(), self._active_cols.tolist()
        return self._varying[rows, cols], self._gains[rows, :], self._slopes[:, cols]

    @property
    def constant(self) -> ca.SX:
        """The part of df/dx that depends on parameters only."""
        return self._constant

    def stacks(
        self, p: np.ndarray, samples: int = _SAMPLES, sampler: ca.Function | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sample the varying Jacobian (or a derivative of it).

        Returns columns that span the port directions and rows that span the port arguments, without the states that
        no port acts on or depends on; :meth:`port_matrices` puts those back.
        """
        width, points = len(self._active_cols), [a[:, :samples] for a in self._points]
        samples = points[0].shape[1]
        varying, gains, slopes = (np.array(v).reshape(v.shape) for v in (sampler or self._sampler)(*points, p))
        blocks = [m.reshape(len(m), samples, width).transpose(1, 0, 2) for m in (varying, slopes)]
        return np.hstack([varying, gains]), np.concatenate([b.reshape(-1, width) for b in blocks])

    def _find_pivots(self) -> None:
        """Choose the states that carry the ports, at parameters a little off the defaults so that no zero hides one."""
        self._sampler = self._sample_function()
        p = self.system.parameter_vector()
        self._points = self._sample_points(p)
        off = p * (1 + 0.01 * np.cos(np.arange(p.size))) + 1e-3 * np.sin(1.0 + np.arange(p.size))
        columns, rows = self.stacks(off)
        if not (np.all(np.isfinite(columns)) and np.all(np.isfinite(rows))):
            columns, rows = self.stacks(p)
        chosen = pivots(columns), pivots(rows.T)
        if not (chosen[0].size and chosen[1].size):  # a linear model: one port that carries no force
            chosen = np.array([0]), np.array([0])
        self.pivots = chosen
        self.rows, self.cols = self._active_rows[chosen[0]], self._active_cols[chosen[1]]

    def _sample_points(self, p: np.ndarray) -> list[np.ndarray]:
        """Return random states (n, .), contact forces and phases where the model is finite (phi**1.5 needs phi > 0)."""
        rng = np.random.default_rng(0)
        n, c, count = len(self.system.state_names), len(self.system.contacts), _SAMPLES * 8
        points = [
            rng.standard_normal((n, count)),
            rng.standard_normal((c, count)),
            rng.uniform(0, 2 * np.pi, (1, count)),
        ]
        good = np.ones(count, dtype=bool)
        for part, found in zip(self.sampled_parts(), self._sampler(*points, p), strict=True):
            if found.numel():
                values = np.array(found).reshape(part.shape[0], count, part.shape[1])
                good &= np.isfinite(values).all(axis=(0, 2))
        chosen = np.flatnonzero(good)[:_SAMPLES] if good.any() else np.arange(_SAMPLES)
        return [a[:, chosen] for a in points]

    def port_matrices(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return B (n, m) and C (k, n) of what they are on the states that the ports act on and depend on."""
        n = len(self.system.state_names)
        B, C = np.zeros((n, columns.shape[1])), np.zeros((len(rows), n))
        B[self._active_rows], C[:, self._active_cols] = columns, rows
        return B, C

    def _directions(self, p: np.ndarray, samples: int = _SAMPLES) -> tuple[np.ndarray, np.ndarray]:
        """Return B (n, m) and C (k, n) at p."""
        columns, rows = self.stacks(p, samples)
        return self.port_matrices(interpolate(columns, self.pivots[0]), interpolate(rows.T, self.pivots[1]).T)

    def _build_functions(self, theta: ca.SX, p: ca.SX) -> None:
        s = self.system
        y = ca.SX.sym("y", len(self.cols))
        x = ca.SX.zeros(len(s.state_names), 1)
        for i, col in enumerate(self.cols):
            x[col] = y[i]
        rows, cols = [int(r) for r in self.rows], [int(c) for c in self.cols]
        closed, general = list(self.closed), list(self.general)
        f0 = ca.substitute(s.derivative, s.phi[closed], ca.SX.zeros(len(closed), 1)) if closed else s.derivative
        force = ca.substitute(f0, s.x, x) - self._u - ca.substitute(self._constant, s.x, x) @ x
        slope = ca.substitute(self._varying, s.x, x)[rows, cols]
        arguments = ca.substitute(s.arguments, s.x, x)[general]
        self.smooth = bool(general) or bool(self._varying.nnz() and not self._varying.is_zero())
        self.law = PortLaw(
            [y, s.phi[general], theta, p], force[rows], slope, arguments, [s.contacts[i] for i in general]
        )
        gains = ca.densify(_kept_rows(self._gains[rows, :].T, [i in closed for i in range(len(s.contacts))]).T)
        forced = _entries(self._u)
        self.excitation = Excitation(s.name, theta, p, forced, self._forced, len(s.state_names), gains, self._offset)
        slopes = ca.densify(_kept_rows(self._slopes[:, cols], self._straight))
        self.argument_slope = ca.Function("argument_slope", [p], [slopes])
        self._constant_at = ca.Function("constant", [p], [self._constant])
        parts = (self._constant, self._varying, self._gains, self._slopes)
        linear = ca.vertcat(*(_entries(part) for part in parts))
        self._linear_depends = dependence(linear, p)

    def _check_structure(self) -> None:
        """Put linear part and ports together again and compare with the model: a hidden jump has no derivative."""
        s = self.system
        whole = ca.Function("whole", [s.x, s.phi, s.theta, s.p], [s.derivative, s.arguments])
        p, general = s.parameter_vector(), list(self.general)
        A = as_matrix(self._constant_at(p))
        B, C = self._directions(p)
        if not all(np.all(np.isfinite(part)) for part in self.excitation.at(0.3, p)):
            raise UnsupportedModel(
                f"system {s.name!r}: the right-hand side is not finite where all states are 0, and harmonic balance "
                "splits it there; shift the states, or use Shooting or Collocation"
            )
        for x, phi, theta in zip(*(a.T[-4:] for a in self._points), strict=True):
            f, arguments = (np.array(v).ravel() for v in whole(x, phi, theta, p))
            u, gain, offset = self.excitation.at(float(theta[0]), p)
            force, met = (np.array(v).ravel() for v in self.law.free(C @ x, phi[general], theta, p))
            force = force + gain.T @ phi
            straight = np.array(self._straight, dtype=bool)
            found = np.array(self.argument_slope(p)).reshape(len(offset), len(C)) @ (C @ x) + offset
            found[general] = np.where(straight[general], found[general], met)
            if not (_same(A @ x + u + B @ force, f) and _same(found, arguments)):
                raise UnsupportedModel(
                    f"system {s.name!r}: the right-hand side jumps (sign, floor, if_else) where its derivative does "
                    "not show it; declare corners as a Contact and smooth jumps, e.g. sign(v) as tanh(v / width)"
                )

    @property
    def inputs(self) -> int:
        """Number of independent port forces m."""
        return len(self.rows)

    @property
    def outputs(self) -> int:
        """Number of independent port arguments k."""
        return len(self.cols)

    @cached_property
    def frequency_explicit(self) -> bool:
        """Whether the right-hand side depends on the frequency other than through the phase."""
        s = self.system
        if s.frequency is None:
            return False
        model = ca.vertcat(s.derivative, s.arguments)
        return bool(ca.depends_on(model, s.p[s.parameter_names.index(s.frequency)]))

    @property
    def large(self) -> bool:
        """Whether the linear part is sparse: many states, few of them coupled."""
        return large(self._constant.shape[0], self._constant.nnz())

    def hold(self, S: np.ndarray) -> None:
        """Use a reference slope S (m, k) as long as it serves."""
        if S.shape == (self.inputs, self.outputs):
            self._slope, self._last = S, None
            self._parts.clear()

    def linear_moves(self, index: int) -> bool:
        """Whether the linear part (A, B, C) depends on a parameter."""
        return bool(self._linear_depends[index])

    def linear_derivative(self, p: np.ndarray, index: int) -> tuple[Any, np.ndarray, np.ndarray] | None:
        """Return the derivatives of A (sparse), B and C in one parameter, None where it does not act on them."""
        from continuation.model.linear_derivative import LinearDerivative

        if not self._linear_depends[index]:
            return None
        if index not in self._derivatives:
            self._derivatives[index] = LinearDerivative(self, index)
        return self._derivatives[index](p)

    def linear(self, p: np.ndarray) -> LinearPart:
        """Return the linear part at p (kept while only parameters change that it does not depend on)."""
        if self._last is None or self._last[0] is not p:  # the same array object, the common case in one Newton step
            self._last = p, self._parts.get(p[self._linear_depends].tobytes(), lambda: self._make_linear(p))
        return self._last[1]

    def forcing(self, p: np.ndarray) -> Forcing:
        """Return the Fourier coefficients of forcing, contact gains and contact offsets at p (kept likewise)."""
        return self.excitation(p)

    def _make_linear(self, p: np.ndarray) -> LinearPart:
        A = as_matrix(self._constant_at(p))
        B, C = self._directions(p, samples=4)  # the pivots are known, a few samples give the rest
        d = np.array(self.argument_slope(p)).reshape(len(self.system.contacts), len(C))
        # S is kept while it serves, so that the equations change smoothly with every parameter
        if self._slope is None or conditioning(add_ports(A, B, -self._slope, C)) < 1e-9:
            self._slope = self._reference_slope(p, A, B, C, d)
        new = LinearPart(A, B, C, d, self._slope)
        if self._last is not None and self._last[1].same(new):
            return self._last[1]  # the same object, so that what was made of it is kept
        return new

    def _reference_slope(self, p: np.ndarray, A: Matrix, B: np.ndarray, C: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Return S: minus the mean port slope with contacts closed, at the spread of y that conditions A best."""
        theta = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        contact = np.zeros((self.inputs, self.outputs))
        gain = self.forcing(p).gain
        for c in self.closed:
            contact += max(self.system.contacts[c].slopes, key=abs) * np.outer(gain[c, :, 0].real, d[c])
        if not self.smooth:
            return -contact
        rng = np.random.default_rng(1)
        candidates = []
        unit = self._unit()
        for spread in (0.0, unit, 3.0 * unit):
            y = spread * rng.standard_normal((self.outputs, theta.size))
            slope = self.law(y, theta, p)[1]
            slope = slope[:, :, np.isfinite(slope).all(axis=(0, 1))]  # a power or root has no slope everywhere
            if not slope.size:
                continue
            candidates += [-contact - slope.mean(axis=2), np.sqrt((slope**2).mean(axis=2)) - contact]
        # The slope at rest is the natural one; one of zero mean would leave undamped modes without their hysteretic
        # shift, and one that leaves A singular is no help, hence the others.
        candidates = candidates or [-contact]
        for S in candidates:
            reach = np.abs(B[self._active_rows] @ S @ C[:, self._active_cols])
            if reach.max() > 1e-6 * largest(A) and conditioning(add_ports(A, B, -S, C)) > 1e-7:
                return S
        return max(candidates, key=lambda S: conditioning(add_ports(A, B, -S, C)))

    def _unit(self) -> float:
        """Return the size of port arguments to sample the law at: twice its farthest breakpoint, 1 without any."""
        return 2 * max((abs(b) for c in self.law.contacts for b in c.breakpoints), default=0.5) or 1.0

    def forced_order(self, p: np.ndarray) -> int:
        """Return the highest harmonic of forcing, gains and offsets that carries more than 1e-8 of its largest."""
        return self.forcing(p).order

    @cached_property
    def law_order(self) -> int:
        """Highest harmonic with which the phase enters the smooth law explicitly (0 when it does not)."""
        if not self.smooth:
            return 0
        count = 2048
        theta = 2 * np.pi * np.arange(count) / count
        y = np.repeat(np.random.default_rng(3).standard_normal((self.outputs, 1)), count, axis=1)
        p = self.system.parameter_vector()
        if self.general:  # the contact forces held, so that no corner is met
            phi = np.repeat(self._points[1][list(self.general), :1], count, axis=1)
            rows = np.vstack([np.array(v) for v in self.law.free(y, phi, theta.reshape(1, -1), p)])
        else:
            force, slope = self.law(y, theta, p)
            rows = np.vstack([force, slope.reshape(-1, count)])
        size = np.abs(np.fft.rfft(rows, axis=1))
        used = np.flatnonzero((size > 1e-10 * size.max(axis=1, initial=0.0, keepdims=True)).any(axis=0))
        return int(used[-1]) if used.size else 0


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.allclose(a, b, rtol=1e-8, atol=1e-8 * max(np.abs(b).max(initial=0.0), 1e-300)))


def _kept_rows(matrix: ca.SX, keep: list[bool]) -> ca.SX:
    """Return a matrix with the rows that are not kept set to zero."""
    return (
        ca.vertcat(*(matrix[i, :] if k else ca.SX(1, matrix.shape[1]) for i, k in enumerate(keep))) if keep else matrix
    )


def _entries(matrix: ca.SX) -> ca.SX:
    """Return the entries that are not zero by structure, as a column."""
    found: Any = matrix.nonzeros()
    return ca.vertcat(*found)
