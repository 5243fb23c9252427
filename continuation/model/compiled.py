"""Fixed-step integration generated as C and compiled where a C compiler is there; nothing depends on it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from continuation.model.machine_code import NoMachineCode, compiled_function, find_compiler, library
from continuation.model.system import System

__all__ = ["compiled_function", "compiled_march", "find_compiler"]

_SLOWEST = 4096  # steps per period above which a model is too stiff for an explicit method


def compiled_march(system: System, slowest: float) -> tuple[str, str]:
    """Compile classical Runge-Kutta over one excitation period of a System with its exact contact laws.

    Parameters
    ----------
    slowest : float
        Lowest excitation frequency it will be used at; sets the number of steps per period (256 or more).

    Returns
    -------
    path : str
        Shared library with the function ``march(x, p) -> x`` for ``casadi.external``; empty where there is none. It
        lives as long as this process, or longer (:func:`~continuation.model.machine_code.library`).
    note : str
        A sentence on what was compiled, or why nothing was. Cost about 0.3 s, once per model.
    """
    if find_compiler() is None:
        return "", "no C compiler was found"
    steps = _steps(system, slowest)
    if steps > _SLOWEST:
        return "", f"the model needs {steps} explicit steps per period, too many to gain from compiling"
    try:
        return library(_source(system, steps)), f"compiled with {find_compiler()}, {steps} Runge-Kutta steps per period"
    except NoMachineCode as reason:
        return "", str(reason)


def _steps(system: System, slowest: float) -> int:
    """Steps per period that keep |eigenvalue| * step below 1 with contacts closed at their steepest slope."""
    closed = [max(c.slopes, key=abs) * system.arguments[i] for i, c in enumerate(system.contacts)]
    f = ca.substitute(system.derivative, system.phi, ca.vertcat(*closed)) if closed else system.derivative
    jacobian = ca.Function("jacobian", [system.x, system.theta, system.p], [ca.jacobian(f, system.x)])
    p = system.parameter_vector({str(system.frequency): slowest})
    matrix = np.array(jacobian(np.zeros(len(system.state_names)), 0.0, p)).reshape(len(system.state_names), -1)
    if not np.all(np.isfinite(matrix)):
        return _SLOWEST + 1
    radius = float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
    turns = 2 * np.pi * radius / slowest
    return max(256, 1 << int(np.ceil(np.log2(min(max(turns, 1.0), 1e9)))))


def _source(system: System, steps: int) -> str:
    """Return the C source of ``march``; the phase is carried as one more state."""
    n = len(system.state_names)
    z, p = ca.SX.sym("z", n + 1), system.p
    omega = p[system.parameter_names.index(str(system.frequency))]
    f = ca.Function("f", [system.x, system.theta, p], [system.closed() / omega])

    def rate(state: ca.SX) -> ca.SX:
        return ca.vertcat(f(state[:n], state[n], p), 1)

    h = 2 * np.pi / steps
    k1 = rate(z)
    k2 = rate(z + h / 2 * k1)
    k3 = rate(z + h / 2 * k2)
    k4 = rate(z + h * k3)
    step = ca.Function("step", [z, p], [z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)])
    x, q = ca.MX.sym("x", n), ca.MX.sym("p", p.numel())
    end = step.fold(steps)(ca.vertcat(x, 0), ca.repmat(q, 1, steps))
    generator = ca.CodeGenerator("march")
    generator.add(ca.Function("march", [x, q], [end[:n]], ["x", "p"], ["end"]))
    return str(generator.dump())
