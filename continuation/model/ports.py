"""Find the constant linear part of a System and the few nonlinear or time-varying ports it is closed by.

Any System is written exactly as

    dx/dt = A(p) x + u(theta, p) + B(p) w(theta, p; y),      y = C(p) x,

with the port force ``w = r(y, theta, p) + sum_c gain_c(theta, p) * force_c(d_c . y + offset_c(theta, p))``: a smooth
part and the contact laws. B has as many columns as the forces have independent directions, C as many rows as they
have independent arguments; a gear pair of any number of coordinates has one of each. Where no structure is found, B
and C become square and the same formulas solve the model in full.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg as sl

from continuation.errors import UnsupportedModel
from continuation.model.system import System

_RANK = 1e-10  # relative singular value below which a direction does not count
_SAMPLES = 12
_PROBES = np.mod(np.arange(1, 9) * 2.3999632297286533, 2 * np.pi)  # phases that no regular grid meets


@dataclass(frozen=True, slots=True)
class LinearPart:
    """Numbers of the linear part at one parameter vector: A (n, n), B (n, m), C (k, n), d (contacts, k), S (m, k).

    S is a reference stiffness of the ports (contacts closed): ``A - B S C`` is what receptances are taken of, so
    that an open gap or a rigid body does not make them singular; the ports carry ``w + S y``, which changes nothing.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    d: np.ndarray
    S: np.ndarray


@dataclass(frozen=True, slots=True)
class Forcing:
    """Fourier coefficients over one excitation period, index 0..J: u (J+1, n), gain (contacts, m, J+1), offset."""

    u: np.ndarray
    gain: np.ndarray
    offset: np.ndarray


class Ports:
    """The port structure of a System; evaluates its parts at a parameter vector and caches the last ones.

    Raises
    ------
    UnsupportedModel
        If a contact force enters with a gain that depends on states, or its argument is not linear in the states.

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
        self._maps: dict[tuple[int, bool], Any] = {}
        x, phi, theta, p = system.x, system.phi, system.theta, system.p
        f, arguments = system.derivative, system.arguments
        self._jacobian = ca.jacobian(f, x)
        self._gains, self._slopes = ca.jacobian(f, phi), ca.jacobian(arguments, x)
        self._check_contacts()
        self._constant, self._varying = self._split()
        zero = [ca.SX.zeros(x.shape), ca.SX.zeros(phi.shape)]
        u, offset = ca.substitute([f, arguments], [x, phi], zero)
        self._u, self._offset = ca.densify(u), ca.densify(offset)
        self._find_pivots()
        self._build_functions(theta, p)
        self._check_structure()
        self._slope: np.ndarray | None = None
        self._cache: dict[str, tuple[np.ndarray, bytes, Any]] = {}

    def _check_contacts(self) -> None:
        s = self.system
        for i, contact in enumerate(s.contacts):
            if ca.depends_on(self._gains[:, i], ca.vertcat(s.x, s.phi)):
                raise UnsupportedModel(
                    f"contact {contact.name!r} of system {s.name!r}: its force must enter linearly, with a gain of "
                    "phase and parameters only; use system.smoothed(width) or Shooting instead"
                )
            if ca.depends_on(self._slopes[i, :], ca.vertcat(s.x, s.theta)):
                raise UnsupportedModel(
                    f"contact {contact.name!r} of system {s.name!r}: its argument must be linear in the states with "
                    "constant coefficients; use system.smoothed(width) or Shooting instead"
                )

    def _split(self) -> tuple[ca.SX, ca.SX]:
        """Split df/dx into entries that depend on parameters only and entries that vary along an orbit."""
        jacobian: Any = ca.sparsify(self._jacobian)
        if jacobian.nnz() == 0:
            return jacobian, jacobian
        nonzeros: list[Any] = jacobian.nonzeros()
        entries = ca.vertcat(*nonzeros)
        varies = ca.which_depends(entries, ca.vertcat(self.system.x, self.system.theta), 1, True)
        parts = [ca.vertcat(*(e if v == keep else ca.SX(0) for e, v in zip(nonzeros, varies, strict=True)))
                 for keep in (False, True)]  # fmt: skip
        constant, varying = (ca.SX(jacobian.sparsity(), part) for part in parts)
        return constant, varying

    def _sample_function(self) -> ca.Function:
        s = self.system
        outputs = [ca.densify(e) for e in (self._varying, self._gains, self._slopes)]
        return ca.Function("samples", [s.x, s.theta, s.p], outputs)

    def _stacks(self, p: np.ndarray, samples: int = _SAMPLES) -> tuple[np.ndarray, np.ndarray]:
        """Sample the varying Jacobian: columns that span the port directions (n, .), rows that span the arguments."""
        rng = np.random.default_rng(0)
        n = len(self.system.state_names)
        x, theta = rng.standard_normal((n, samples)), rng.uniform(0, 2 * np.pi, (1, samples))
        varying, gains, slopes = (np.array(v).reshape(v.shape) for v in self._sampler(x, theta, p))
        blocks = [m.reshape(len(m), samples, n).transpose(1, 0, 2) for m in (varying, slopes)]
        return np.hstack([varying, gains]), np.concatenate([b.reshape(-1, n) for b in blocks])

    def _find_pivots(self) -> None:
        """Choose the states that carry the ports, at parameters a little off the defaults so that no zero hides one."""
        self._sampler = self._sample_function()
        p = self.system.parameter_vector()
        off = p * (1 + 0.01 * np.cos(np.arange(p.size))) + 1e-3 * np.sin(1.0 + np.arange(p.size))
        columns, rows = self._stacks(off)
        if not (np.all(np.isfinite(columns)) and np.all(np.isfinite(rows))):
            columns, rows = self._stacks(p)
        self.rows, self.cols = _pivots(columns), _pivots(rows.T)
        if not (self.rows.size and self.cols.size):  # a linear model: one port that carries no force
            self.rows, self.cols = np.array([0]), np.array([0])

    def _build_functions(self, theta: ca.SX, p: ca.SX) -> None:
        s = self.system
        y = ca.SX.sym("y", len(self.cols))
        x = ca.SX.zeros(len(s.state_names), 1)
        for i, col in enumerate(self.cols):
            x[col] = y[i]
        rows = [int(r) for r in self.rows]
        f0 = ca.substitute(s.derivative, s.phi, ca.SX.zeros(s.phi.shape))
        force = ca.substitute(f0, s.x, x) - self._u - ca.substitute(self._constant, s.x, x) @ x
        slope = ca.substitute(self._varying, s.x, x)
        self.smooth = bool(self._varying.nnz()) and not self._varying.is_zero()
        self._law = ca.Function(
            "law", [y, theta, p], [ca.densify(force[rows]), ca.densify(slope[rows, [int(c) for c in self.cols]])]
        )
        gains = ca.densify(self._gains[rows, :]) if rows else ca.SX(0, 1)
        self._periodic = ca.Function("periodic", [theta, p], [self._u, ca.vec(gains), self._offset])
        self._constant_at = ca.Function("constant", [p], [ca.densify(self._constant)])
        parts = (self._constant, self._varying, self._gains, self._slopes)
        linear = ca.vertcat(*(ca.vec(part) for part in parts))
        forcing = ca.vertcat(self._u, ca.vec(gains), self._offset)
        self._linear_depends = _dependence(linear, p)
        self._forcing_depends = _dependence(forcing, p)

    def _check_structure(self) -> None:
        """Put linear part and ports together again and compare with the model: a hidden jump has no derivative."""
        s = self.system
        rng = np.random.default_rng(2)
        whole = ca.Function("whole", [s.x, s.phi, s.theta, s.p], [s.derivative])
        p = s.parameter_vector()
        A = np.array(self._constant_at(p)).reshape(len(s.state_names), -1)
        columns, rows = self._stacks(p)
        B, C = _interpolate(columns, self.rows), _interpolate(rows.T, self.cols).T
        for _ in range(4):
            x, phi = rng.standard_normal(len(A)), rng.standard_normal(len(s.contacts))
            theta = rng.uniform(0, 2 * np.pi)
            f = np.array(whole(x, phi, theta, p)).ravel()
            u, gain, _ = (np.array(v).ravel() for v in self._periodic(theta, p))
            force = np.array(self._law(C @ x, theta, p)[0]).ravel()
            force = force + gain.reshape(len(s.contacts), -1).T @ phi if len(phi) else force
            rebuilt = A @ x + u + B @ force
            if not np.allclose(rebuilt, f, rtol=1e-8, atol=1e-8 * max(np.abs(f).max(), 1e-300)):
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
        return bool(ca.depends_on(s.derivative, s.p[s.parameter_names.index(s.frequency)]))

    def law(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the smooth port force (m, N) and its slope (m, k, N) at y (k, N), theta (N,), p (q,) or (q, N)."""
        count, m, k = theta.size, self.inputs, self.outputs
        arguments, results, run = self._mapped(count, p.ndim == 1)
        for held, given in zip(arguments, (y.T, theta, p.T), strict=True):
            held[...] = given
        run()
        force, slope = results
        return force.T.copy(), slope.reshape(count, k, m).transpose(2, 1, 0).copy()

    def _mapped(self, count: int, common: bool) -> tuple[list[np.ndarray], list[np.ndarray], Any]:
        """Return argument and result arrays, one sample per row, and the call that fills the results (a few kept)."""
        key = (count, common)
        if key not in self._maps:
            if len(self._maps) >= 8:
                self._maps.pop(next(iter(self._maps)))
            f = self._law.map("laws", "serial", count, [2], []) if common else self._law.map(count)
            m, k, q = self.inputs, self.outputs, len(self.system.parameter_names)
            arguments = [np.zeros((count, k)), np.zeros(count), np.zeros(q if common else (count, q))]
            results = [np.zeros((count, m)), np.zeros((count, k * m))]
            made: Any = f.buffer()
            buffer, run = made
            for i, array in enumerate(arguments):
                buffer.set_arg(i, memoryview(array.reshape(-1).data))
            for i, array in enumerate(results):
                buffer.set_res(i, memoryview(array.reshape(-1).data))
            self._maps[key] = (arguments, results, run, (f, buffer))  # CasADi does not keep the last two alive
        return self._maps[key][:3]

    def second(self, y: np.ndarray, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Evaluate the second derivative (m, k, k, N) of the smooth port force at y (k, N), theta (N,)."""
        m, k = self.inputs, self.outputs
        bend = np.array(self._second(y, theta.reshape(1, -1), p)).reshape(k, k, m, theta.size)
        return bend.transpose(2, 1, 0, 3)  # CasADi's vec runs down columns: (m, k) fastest, then the second y

    @cached_property
    def _second(self) -> ca.Function:
        y, theta, p = self._law.sx_in()
        slope = self._law(y, theta, p)[1]
        return ca.Function("second", [y, theta, p], [ca.densify(ca.vec(ca.jacobian(ca.vec(slope), y)))])

    def linear(self, p: np.ndarray) -> LinearPart:
        """Return the linear part at p (kept while only parameters change that it does not depend on)."""
        return self._cached("linear", p, self._linear_depends, self._make_linear)

    def forcing(self, p: np.ndarray) -> Forcing:
        """Return the Fourier coefficients of forcing, contact gains and contact offsets at p (kept likewise)."""
        return self._cached("forcing", p, self._forcing_depends, self._make_forcing)

    def _cached(self, name, p, depends, make):  # type: ignore[no-untyped-def]
        found = self._cache.get(name)
        if found is not None and found[0] is p:  # the same array object, the common case inside one Newton step
            return found[2]
        tag = p[depends].tobytes()
        value = found[2] if found is not None and found[1] == tag else make(p)
        self._cache[name] = (p, tag, value)
        return value

    def _make_linear(self, p: np.ndarray) -> LinearPart:
        columns, rows = self._stacks(p, samples=4)  # the pivots are known, a few samples give the rest
        A = np.array(self._constant_at(p)).reshape(len(columns), -1)
        B = _interpolate(columns, self.rows)
        C = _interpolate(rows.T, self.cols).T
        slopes = np.array(self._sampler(np.zeros(len(A)), 0.0, p)[2]).reshape(len(self.system.contacts), len(A))
        d = slopes[:, self.cols]
        # S is kept while it serves, so that the equations change smoothly with every parameter
        if self._slope is None or _conditioning(A - B @ self._slope @ C) < 1e-9:
            self._slope = self._reference_slope(p, A, B, C, d)
        new = LinearPart(A, B, C, d, self._slope)
        old = self._cache["linear"][2] if "linear" in self._cache else None
        if old is not None and all(np.array_equal(getattr(old, k), getattr(new, k)) for k in ("A", "B", "C", "d", "S")):
            return old  # the same object, so that what was made of it is kept
        return new

    def _reference_slope(self, p: np.ndarray, A: np.ndarray, B: np.ndarray, C: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Return S: minus the mean port slope with contacts closed, at the spread of y that conditions A best."""
        theta = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        contact = np.zeros((self.inputs, self.outputs))
        gain = self.forcing(p).gain
        for c, law in enumerate(self.system.contacts):
            contact += max(law.slopes, key=abs) * np.outer(gain[c, :, 0].real, d[c])
        if not self.smooth:
            return -contact
        rng = np.random.default_rng(1)
        candidates = []
        for spread in (0.0, 1.0, 3.0):
            y = spread * rng.standard_normal((self.outputs, theta.size))
            slope = self.law(y, theta, p)[1]
            candidates += [-contact - slope.mean(axis=2), np.sqrt((slope**2).mean(axis=2)) - contact]
        # The slope at rest is the natural one; one of zero mean would leave undamped modes without their hysteretic
        # shift, and one that leaves A singular is no help, hence the others.
        for S in candidates:
            if np.abs(B @ S @ C).max() > 1e-6 * np.abs(A).max(initial=0.0) and _conditioning(A - B @ S @ C) > 1e-7:
                return S
        return max(candidates, key=lambda S: _conditioning(A - B @ S @ C))

    def _periodic_rows(self, theta: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Evaluate u, gains and offsets, one row each, at phases (N,)."""
        parts = self._periodic(theta.reshape(1, -1), p)
        return np.vstack([np.array(v).reshape(-1, theta.size) for v in parts])

    def forced_order(self, p: np.ndarray) -> int:
        """Return the highest harmonic of forcing, gains and offsets that carries more than 1e-8 of its largest."""
        f = self.forcing(p)
        rows = np.vstack([f.u.T, f.gain.reshape(-1, f.gain.shape[-1]), f.offset])
        size = np.abs(rows)
        used = np.flatnonzero((size > 1e-8 * size.max(axis=1, initial=0.0, keepdims=True)).any(axis=0))
        return int(used[-1]) if used.size else 0

    @cached_property
    def law_order(self) -> int:
        """Highest harmonic with which the phase enters the smooth law explicitly (0 when it does not)."""
        if not self.smooth:
            return 0
        count = 2048
        theta = 2 * np.pi * np.arange(count) / count
        y = np.repeat(np.random.default_rng(3).standard_normal((self.outputs, 1)), count, axis=1)
        force, slope = self.law(y, theta, self.system.parameter_vector())
        rows = np.vstack([force, slope.reshape(-1, count)])
        size = np.abs(np.fft.rfft(rows, axis=1))
        used = np.flatnonzero((size > 1e-10 * size.max(axis=1, initial=0.0, keepdims=True)).any(axis=0))
        return int(used[-1]) if used.size else 0

    def _make_forcing(self, p: np.ndarray) -> Forcing:
        count = 64
        while True:
            theta = 2 * np.pi * np.arange(count) / count
            values = self._periodic_rows(theta, p)
            spectrum = np.fft.rfft(values, axis=1) / count
            size = np.abs(values).max(axis=1, initial=0.0, keepdims=True)
            spectrum[np.abs(spectrum) < 1e-15 * size] = 0.0
            miss = np.abs(_series(spectrum[:, : count // 2], _PROBES) - self._periodic_rows(_PROBES, p))
            worst = float(np.max(miss / np.where(size > 0, size, 1.0), initial=0.0))  # each row against its own size
            if worst <= 1e-12 or count >= 8192:
                break
            count *= 2
        if worst > 1e-9:
            raise UnsupportedModel(
                f"system {self.system.name!r}: forcing or contact gain is not a smooth function of the phase "
                f"({count // 2} harmonics still miss it by {worst:.1e}); write it as a Fourier series"
            )
        used = np.flatnonzero(np.abs(spectrum).max(axis=0, initial=0.0))
        last = int(used[-1]) if used.size else 0
        spectrum = spectrum[:, : last + 1]
        n, c, m = len(self.system.state_names), len(self.system.contacts), self.inputs
        return Forcing(
            u=spectrum[:n].T,
            gain=spectrum[n : n + c * m].reshape(c, m, last + 1),
            offset=spectrum[n + c * m :],
        )


def _series(spectrum: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Evaluate half spectra (rows, J+1) at phases (N,); returns (rows, N)."""
    k = np.arange(spectrum.shape[1])
    waves = np.where(k == 0, 1.0, 2.0)[:, None] * np.exp(1j * np.multiply.outer(k, phases))
    return (spectrum @ waves).real


def _pivots(stack: np.ndarray) -> np.ndarray:
    """Return indices of rows of the stack that span its row space, the best conditioned first."""
    norms = np.linalg.norm(stack, axis=1, keepdims=True)
    scaled = stack / np.where(norms > 0, norms, 1.0)
    if not scaled.any():
        return np.zeros(0, dtype=int)
    _, r, order = sl.qr(scaled.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.sort(order[: int(np.sum(size > _RANK * size[0]))])


def _interpolate(stack: np.ndarray, pivots: np.ndarray) -> np.ndarray:
    """Return X with ``stack = X stack[pivots]``, X[pivots] the identity."""
    result = stack @ np.linalg.pinv(stack[pivots], rcond=_RANK) if len(pivots) else np.zeros((len(stack), 0))
    defect = np.abs(result @ stack[pivots] - stack).max(initial=0.0)
    if defect > 1e-8 * max(np.abs(stack).max(initial=0.0), 1e-300):
        raise UnsupportedModel(
            "the ports of the System change their number with the parameters; build it with default parameter values "
            "at which every nonlinear term is present"
        )
    result[np.abs(result) < 1e-14] = 0.0
    result[pivots] = np.eye(len(pivots))
    return result


def _dependence(expression: ca.SX, p: ca.SX) -> np.ndarray:
    """Return which elements of p an expression depends on, boolean (q,)."""
    return np.array([bool(ca.depends_on(expression, p[i])) for i in range(p.numel())], dtype=bool)


def _conditioning(matrix: np.ndarray) -> float:
    """Return the smallest over the largest singular value after balancing, so that units do not count."""
    if not np.all(np.isfinite(matrix)):
        return -1.0
    values = np.linalg.svd(sl.matrix_balance(matrix, permute=False)[0], compute_uv=False)
    return float(values[-1] / max(values[0], 1e-300))
