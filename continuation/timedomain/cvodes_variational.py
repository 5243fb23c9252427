"""CVODES with the forward variational equation, both under error control, over any interval of the phase.

The derivatives are states of the integration themselves. CasADi's reverse mode is not used: its quadratures are outside
the error control by default, and give wrong parameter Jacobians without a warning; nor are differences of two runs,
which are noise of the step selection.
"""

from __future__ import annotations

import re
from typing import Any

import casadi as ca
import numpy as np

from continuation.errors import IntegrationFailed, Runaway, UnsupportedModel
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES, cvodes_options
from continuation.timedomain.exact import describe
from continuation.timedomain.kernels import Kernel

_STEPS = 100_000


class VariationalIntegrator:
    """Integrate a driven System without contacts, alone or together with its derivatives.

    Parameters
    ----------
    system : System
    settings : CVODES
        Tolerances and method; the number of samples is not used.

    Raises
    ------
    UnsupportedModel
        If the System has contacts or is autonomous.

    Examples
    --------
    >>> x, theta, omega, rate = (ca.SX.sym(k) for k in ("x", "theta", "omega", "rate"))
    >>> decay = System(name="decay", states={"x": x}, derivatives={"x": -rate * x}, phase=theta, frequency="omega",
    ...                parameters={"omega": (omega, 1.0), "rate": (rate, 1.0)})
    >>> run = VariationalIntegrator(decay, CVODES())
    >>> M, push, trace = run.derivatives(np.array([2.0]), decay.parameter_vector(), 0.0, 1.0, np.array([0.0, 1.0]))
    >>> M.round(7).tolist(), push.round(7).tolist(), round(trace, 9)           # exp(-1), -2 exp(-1), -1
    ([[0.3678794]], [-0.7357589], -1.0)
    """

    def __init__(self, system: System, settings: CVODES) -> None:
        if system.contacts or system.autonomous:
            raise UnsupportedModel(f"system {system.name!r}: CVODES treats driven Systems without contacts here")
        self.system, self.rtol, self.atol = system, settings.rtol, settings.atol
        self._settings = settings
        omega = system.p[system.parameter_names.index(str(system.frequency))]
        self._rate = system.derivative / omega
        self._kernel = Kernel(ca.Function("rate", [system.x, system.theta, system.p], [self._rate]))
        self._made: dict[tuple[str, int], ca.Function] = {}

    def with_tolerance(self, rtol: float, atol: float) -> VariationalIntegrator:
        """Return the same with other tolerances."""
        stiff = self._settings.stiff
        return VariationalIntegrator(self.system, CVODES(rtol=rtol, atol=atol, stiff=stiff))

    def rate(self, x: np.ndarray, theta: float, p: np.ndarray) -> np.ndarray:
        """Return dx/dphase (n,)."""
        return self._kernel(x, theta, p)[0]

    def end(self, x: np.ndarray, p: np.ndarray, start: float, end: float) -> np.ndarray:
        """Return the state (n,) at the phase ``end`` from x at ``start``."""
        return self._run("state", 1, x, p, start, end, np.zeros(len(p)))[:, -1]

    def samples(self, x: np.ndarray, p: np.ndarray, start: float, end: float, count: int) -> np.ndarray:
        """Return the states (count, n) at equidistant phases, the start among them, the end not."""
        path = self._run("state", count, x, p, start, end, np.zeros(len(p)))
        return np.vstack([x, path.T[:-1]])

    def derivatives(
        self, x: np.ndarray, p: np.ndarray, start: float, end: float, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the derivatives of the end by x (n, n) and in a direction of p (n,), and the integrated trace."""
        n = len(x)
        z = self._run("variation", 1, np.concatenate([x, np.eye(n).ravel(), np.zeros(n + 1)]), p, start, end, direction)
        return z[n : n + n * n, -1].reshape(n, n).T, z[n + n * n : -1, -1], float(z[-1, -1])

    def _run(
        self, kind: str, count: int, z: np.ndarray, p: np.ndarray, start: float, end: float, d: np.ndarray
    ) -> np.ndarray:
        if (kind, count) not in self._made:
            self._made[kind, count] = self._integrator(kind, count)
        try:
            path = self._made[kind, count](x0=z, p=np.concatenate([p, d, [start, end - start]]))["xf"].full()
        except RuntimeError as error:
            flag = re.search(r'returned "(\w+)"', str(error))
            raise self._failure(p, start, f"CVODES stopped ({flag.group(1) if flag else 'see its error'})") from error
        if not np.all(np.isfinite(path)):
            raise self._failure(p, start, "the state left the finite numbers", Runaway)
        return path

    def _integrator(self, kind: str, count: int) -> ca.Function:
        """Build the integrator of the time t = 0 .. 1 over the interval, with results at ``count`` times."""
        s = self.system
        n, q = s.x.numel(), s.p.numel()
        t, p = ca.SX.sym("t"), ca.SX.sym("p", 2 * q + 2)
        z: Any = ca.SX.sym("z", n if kind == "state" else n + n * n + n + 1)
        phase, length = p[2 * q] + p[2 * q + 1] * t, p[2 * q + 1]
        known = ca.Function(
            "linear", [s.x, s.theta, s.p], [self._rate, ca.jacobian(self._rate, s.x), ca.jacobian(self._rate, s.p)]
        )
        f, A, by_p = known(z[:n], phase, p[:q])
        if kind == "variation":
            matrix, push = ca.reshape(z[n : n + n * n], n, n), z[n + n * n : -1]
            f = ca.vertcat(f, ca.vec(ca.densify(A @ matrix)), A @ push + by_p @ p[q : 2 * q], ca.trace(A))
        dae = {"x": z, "t": t, "p": p, "ode": length * f}
        options = {**cvodes_options(self._settings), "max_num_steps": _STEPS}
        grid = [(k + 1) / count for k in range(count)]
        return ca.integrator(kind, "cvodes", dae, 0.0, grid, options)

    def _failure(
        self, p: np.ndarray, start: float, what: str, kind: type[IntegrationFailed] = IntegrationFailed
    ) -> IntegrationFailed:
        values = dict(zip(self.system.parameter_names, p.tolist(), strict=True))
        return kind(
            f"integration of {self.system.name!r} from phase {start:.6g} failed at {describe(values)}: {what}; check "
            f"the model and the start, or try CVODES(stiff=True), or other tolerances than rtol = {self.rtol:g}, "
            f"atol = {self.atol:g}",
            start,
            values,
        )
