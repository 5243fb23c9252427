"""Brute-force response over a parameter: every value starts from the last state of the value before."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from continuation.errors import ContinuationError, nearest
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES, DrivenModel
from continuation.timedomain.settling import Settled, Settling
from continuation.timedomain.sweep_result import FAILED, Sweep, describe_waveform

logger = logging.getLogger(__name__)

_APPROACH = 50  # excitation periods in compiled code before CVODES takes over
_FAR = 1e8

Progress = Callable[[int, int], None]
"""Called with the number of values done and of all values."""


@dataclass(frozen=True, slots=True)
class SweepTask:
    """Describe a sweep as plain data; running it gives the same result in any process.

    Attributes are the arguments of :func:`sweep`, checked.
    """

    model: DrivenModel
    method: CVODES
    parameter: str
    values: tuple[float, ...]
    quantity: str
    start: tuple[float, ...]
    transient: int
    limit: int
    recorded: int
    tolerance: float
    march: str = ""

    def __post_init__(self) -> None:
        for name, known in ((self.parameter, self.model.parameter_names), (self.quantity, self.model.state_names)):
            if name not in known:
                raise ValueError(f"sweep of {self.model.name!r}: unknown name {name!r}; {nearest(name, known)}")
        if not self.values or not np.all(np.isfinite(self.values)):
            raise ValueError(f"sweep: expected at least one value of {self.parameter!r}, all finite, got {self.values}")
        if self.parameter == self.model.frequency and min(self.values) <= 0:
            raise ValueError(f"sweep: frequency {self.parameter!r} must be positive, got {min(self.values):g}")
        if len(self.start) != len(self.model.state_names):
            raise ValueError(f"sweep: start needs {len(self.model.state_names)} states, got {len(self.start)}")
        for name in ("transient", "limit", "recorded", "tolerance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"sweep: {name} must be positive, got {getattr(self, name)}")

    def run(self, progress: Progress | None = None) -> Sweep:
        """Go through the values in order; a value that fails is reported and the next begins from the first start."""
        integrator = self.method.compile(self.model)
        p = np.array(self.model.defaults)
        index, column = self.model.parameter_names.index(self.parameter), self.model.state_names.index(self.quantity)
        march = ca.external("march", self.march) if self.march else None
        x, rows = np.array(self.start), []
        for value in self.values:
            p[index] = value
            x = _approach(march, x, p) if march else x
            settling = Settling(
                lambda state: integrator.period(state, p),
                tolerance=self.tolerance,
                floor=self.method.atol / self.method.rtol,
                transient=self.transient,
                limit=self.limit,
                recorded=self.recorded,
            )
            try:
                settled = settling.run(x)
                x, failure = settled.state, ""
            except ContinuationError as error:
                settled, failure = None, str(error)
                x = np.array(self.start)
                logger.warning("%s = %g: %s", self.parameter, value, failure)
            rows.append((settled, settling.used, failure))
            if progress:
                progress(len(rows), len(self.values))
        return self._collect(rows, column)

    def _collect(self, rows: list[tuple[Settled | None, int, str]], column: int) -> Sweep:
        fixed = dict(zip(self.model.parameter_names, self.model.defaults, strict=True))
        del fixed[self.parameter]
        nothing = np.full(len(self.model.state_names), np.nan)
        statistics = np.array(
            [describe_waveform(r.waveform[:, column], bool(r.period)) if r else (np.nan,) * 4 for r, _, _ in rows]
        )
        return Sweep(
            system=self.model.name,
            parameter=self.parameter,
            quantity=self.quantity,
            method=repr(self.method) + (f" after {_APPROACH} periods of compiled Runge-Kutta" if self.march else ""),
            fixed=fixed,
            state_names=self.model.state_names,
            values=np.array(self.values),
            **dict(zip(("rms", "mean", "minimum", "maximum"), statistics.T.copy(), strict=True)),
            period=np.array([r.period if r else FAILED for r, _, _ in rows]),
            periods_used=np.array([used for _, used, _ in rows]),
            states=np.array([r.state if r else nothing for r, _, _ in rows]),
            failures=tuple(text for _, _, text in rows),
        )


def _approach(march: ca.Function, x: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Bring a state close to its attractor in compiled code; the state given where that leaves the finite numbers."""
    end = x
    for _ in range(_APPROACH):
        end = march(end, p)
    result = np.array(end, dtype=float).ravel()
    return result if np.all(np.isfinite(result)) and np.abs(result).max() < _FAR else x


def sweep(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    *,
    quantity: str,
    method: CVODES | None = None,
    start: Sequence[float] | np.ndarray | None = None,
    transient: int = 32,
    limit: int = 400,
    recorded: int = 64,
    tolerance: float = 1e-7,
    march: str = "",
    progress: Progress | None = None,
) -> Sweep:
    """Compute the brute-force response over parameter values in the given order.

    Parameters
    ----------
    system : System
        Driven model; its exact contact laws are integrated.
    parameter : str
        Parameter to sweep; the others keep the System's defaults.
    values : array (k,)
        Increasing for a sweep up, decreasing for a sweep down.
    quantity : str
        State that rms, mean and extremes describe.
    method : CVODES, optional
        Integrator settings.
    start : array (n,), optional
        State at phase 0 before the first value, and again after a failure; zeros when absent.
    transient, limit : int
        Excitation periods per value at least and, when the response is not recognised as periodic, about at most.
    recorded : int
        Excitation periods the statistics describe when the response is not recognised as periodic.
    tolerance : float
        Distance to the periodic response, over the largest value of each state, at which it counts as settled.
    march : str
        Library of :func:`~continuation.model.compiled.compiled_march`: every value then begins with 50 periods in
        compiled code, and CVODES, which decides, has less to do. Empty: CVODES alone.
    progress : callable, optional
        Called with the number of values done and of all values.

    Raises
    ------
    ValueError
        If a name is unknown or a number is out of range.
    UnsupportedModel
        If the System is autonomous.

    Notes
    -----
    A response is called period-n when it repeats after n = 1 to 16 excitation periods (see
    :class:`~continuation.timedomain.settling.Settling`); "not recognised" says no more than that. The mean over
    equidistant samples of a periodic waveform errs with the 4th power of their spacing with contact, else much less.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> up = sweep(linear, "omega", [0.5, 2.0], quantity="x")
    >>> up.period.tolist(), [round(float(r), 7) for r in up.rms]        # 1/abs(1 - omega^2 + 0.2i omega)/sqrt(2)
    ([1, 1], [0.9345386, 0.2336347])
    """
    settings = (quantity, method, start, transient, limit, recorded, tolerance, march)
    return task(system, parameter, values, *settings).run(progress)


def task(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    quantity: str,
    method: CVODES | None,
    start: Sequence[float] | np.ndarray | None,
    transient: int,
    limit: int,
    recorded: int,
    tolerance: float,
    march: str = "",
) -> SweepTask:
    """Return the plain description of a sweep; arguments as for :func:`sweep`."""
    begin = np.zeros(len(system.state_names)) if start is None else np.asarray(start, dtype=float)
    model, plain = DrivenModel.of(system), tuple(float(v) for v in np.ravel(values))
    settings = (quantity, tuple(begin.tolist()), transient, limit, recorded, tolerance, march)
    return SweepTask(model, method or CVODES(), parameter, plain, *settings)
