"""Lyapunov spectrum from the variational equations along a trajectory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from continuation.errors import ContinuationError
from continuation.model.system import System
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep, FixedStepIntegrator
from continuation.timedomain.fixed_step_functions import ModeModel, mode_model
from continuation.timedomain.simulate import EventExact
from continuation.timedomain.variational import tangents

_BLOCKS = (8, 16, 32)
_DEPENDENT = 1e-15  # ratio of growth factors over one period at which rounding has replaced the smallest


@dataclass(frozen=True, slots=True, eq=False)
class LyapunovSpectrum:
    """Hold Lyapunov exponents, the largest first.

    Attributes
    ----------
    exponents : ndarray (k,)
        Per unit of time of the System.
    errors : ndarray (k,)
        Standard errors from block averages, with the error of the integration where the whole spectrum is known.
    total, total_error : float
        Sum of the exponents and its standard error; the errors of the exponents are not independent.
    trace : float
        Mean trace of the Jacobian along the trajectory, which the sum of all exponents equals (Liouville).
    period : float
        Excitation period in time, 1 when the System is autonomous.
    periods : int
        Periods averaged over.
    end : ndarray (n,)
        Last state.
    """

    exponents: np.ndarray
    errors: np.ndarray
    total: float
    total_error: float
    trace: float
    period: float
    periods: int
    end: np.ndarray

    @property
    def per_period(self) -> np.ndarray:
        """Return the exponents per excitation period, for a gear per mesh period, shape (k,)."""
        return self.exponents * self.period

    @property
    def verdict(self) -> str:
        """Return ``chaotic`` or ``not chaotic`` when the largest exponent is three errors from 0, else ``undecided``.

        For an autonomous System the exponent along the flow is 0, and so is that of a torus: ``undecided`` then.
        """
        if abs(self.exponents[0]) <= 3 * self.errors[0]:
            return "undecided"
        return "chaotic" if self.exponents[0] > 0 else "not chaotic"

    def __str__(self) -> str:
        shown = ", ".join(f"{v:.6g} +- {e:.1g}" for v, e in zip(self.exponents, self.errors, strict=True))
        return (
            f"Lyapunov exponents per unit time over {self.periods} periods of {self.period:.6g}: {shown}; "
            f"sum {self.total:.8g}, mean trace {self.trace:.8g}"
        )


def lyapunov_spectrum(
    system: System,
    start: Sequence[float] | np.ndarray,
    *,
    periods: int = 1000,
    transient: int = 200,
    count: int | None = None,
    integrator: FixedStep | EventExact | None = None,
    **parameters: float,
) -> LyapunovSpectrum:
    """Compute Lyapunov exponents by repeated QR factorisation of the tangent vectors.

    Parameters
    ----------
    start : array (n,)
        State at phase 0.
    periods : int
        Periods averaged over, 64 or more; units of time when the System is autonomous.
    transient : int
        Periods before that, for the state to reach its attractor; a tenth of ``periods`` follows for the vectors.
    count : int, optional
        Number of exponents, the largest ones; all when absent.
    integrator : FixedStep or EventExact, optional
        ``FixedStep()`` when absent.

    Raises
    ------
    ValueError
        If a name is unknown or a number is out of range.
    ContinuationError
        If the integration fails, or growth factors differ by more than rounding allows over one period.

    Notes
    -----
    Benettin et al., Meccanica 15 (1980) 9-30; Shimada and Nagashima (1979). The force of a Contact is continuous, so
    tangent vectors carry over its changes as they are. The standard error is the largest one from 8, 16 and 32 block
    averages; it knows nothing of attractors that were not visited.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> s = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...            phase=theta, frequency="omega", parameters={"omega": (omega, 0.7)})
    >>> spectrum = lyapunov_spectrum(s, [0.0, 0.0], periods=200)                  # complex multipliers: both -0.1
    >>> bool(abs(spectrum.exponents + 0.1).max() < 3 * spectrum.errors.max() < 0.01), spectrum.verdict
    (True, 'not chaotic')
    """
    n = len(system.state_names)
    k = n if count is None else count
    x, p = np.array(start, dtype=float).ravel(), system.parameter_vector(parameters)
    if not 1 <= k <= n or x.shape != (n,):
        raise ValueError(f"lyapunov_spectrum: expected {n} states and 1 to {n} exponents, got {len(x)} and {k}")
    if periods < 2 * _BLOCKS[-1] or transient < 0:
        raise ValueError(f"lyapunov_spectrum: expected {2 * _BLOCKS[-1]} or more periods, got {periods}")
    method = FixedStep() if integrator is None else integrator
    if isinstance(method, EventExact):
        growth = _exact(system, method, x, p, k, transient)
    else:
        growth = _fixed(system, method, x, p, k, transient)
    length = 1.0 if system.frequency is None else 2 * np.pi / p[system.parameter_names.index(system.frequency)]
    rows = np.empty((periods, k + 1))
    for j in range(-(periods // 10), periods):
        logarithms, trace, x = next(growth)
        if j >= 0:
            rows[j] = *logarithms, trace
    return _summary(rows / length, length, x, n)


def _summary(rows: np.ndarray, length: float, x: np.ndarray, n: int) -> LyapunovSpectrum:
    exponents, trace = rows[:, :-1].mean(axis=0), float(rows[:, -1].mean())
    total = float(exponents.sum())
    missed = abs(total - trace) if len(exponents) == n else 0.0
    errors = np.hypot([standard_error(column) for column in rows[:, :-1].T], missed)
    total_error = float(np.hypot(standard_error(rows[:, :-1].sum(axis=1)), missed))
    order = np.argsort(-exponents, kind="stable")
    return LyapunovSpectrum(exponents[order], errors[order], total, total_error, trace, length, len(rows), x)


def standard_error(values: np.ndarray) -> float:
    """Return the largest standard error of the mean from several numbers of blocks; correlation needs long ones."""
    found = []
    for blocks in _BLOCKS:
        size = len(values) // blocks
        means = values[: size * blocks].reshape(blocks, size).mean(axis=1)
        found.append(means.std(ddof=1) / np.sqrt(blocks))
    return float(max(found))


def _fixed(
    system: System, method: FixedStep, x: np.ndarray, p: np.ndarray, k: int, transient: int
) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    """Yield logarithms of the growth factors (k,), integral of the trace and state after every period."""
    n = len(x)
    x = method.compile(system).run(x, p, transient).end
    integrator = FixedStepIntegrator(method, variational_model(mode_model(system, land=method.land), k), system)
    q = np.eye(n, k)
    while True:
        end = integrator.run(np.concatenate([x, q.ravel(order="F"), [0.0]]), p).end
        q, factors = _orthonormal(end[n:-1].reshape(n, k, order="F"))
        if factors.min() < _DEPENDENT * factors.max():
            raise ContinuationError(
                f"Lyapunov exponents of {system.name!r}: growth factors over one period differ by "
                f"{factors.max() / factors.min():.1g}: rounding hides the smallest; use EventExact() or a smaller count"
            )
        x = end[:n]
        yield np.log(factors), float(end[-1]), x


def variational_model(model: ModeModel, k: int) -> ModeModel:
    """Return the model with k tangent vectors and the integral of the trace as further states."""
    n = model.x.numel()
    jacobian, vectors = ca.jacobian(model.rate, model.x), ca.SX.sym("Q", n, k)
    rate = ca.vertcat(model.rate, ca.vec(jacobian @ vectors), ca.trace(jacobian))
    x = ca.vertcat(model.x, ca.vec(vectors), ca.SX.sym("trace"))
    return replace(model, x=x, rate=rate)


def _exact(
    system: System, method: EventExact, x: np.ndarray, p: np.ndarray, k: int, transient: int
) -> Iterator[tuple[np.ndarray, float, np.ndarray]]:
    driven, values = (system, p) if system.frequency is not None else (system.clocked("turn", 2 * np.pi), None)
    p = p if values is not None else np.append(p, 2 * np.pi)
    integrator = ExactIntegrator(driven, rtol=method.rtol, atol=method.atol, steps=method.steps)
    if transient:
        x = integrator.integrate(x, p, transient).end
    q = np.eye(len(x), k)
    while True:
        run = integrator.integrate(x, p)
        along, total = tangents(integrator, [run], p), np.zeros(k)
        for matrix in along.matrices:
            q, factors = _orthonormal(matrix @ q)
            total += np.log(factors)
        x = run.end
        yield total, float(along.traces.sum()), x


def _orthonormal(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    q, r = np.linalg.qr(vectors)
    return q, np.maximum(abs(np.diag(r)), 1e-300)
