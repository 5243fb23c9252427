"""How the port structure of a System changes with one of its parameters: exact derivatives through CasADi."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from continuation.model.forcing import Forcing
from continuation.model.ports import Ports


class PortParameters:
    """Derivatives of forcing, contact gains and contact arguments with respect to any parameter.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega, g = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega", "g"))
    >>> s = System(name="duffing", states={"x": x, "v": v}, phase=theta, frequency="omega",
    ...            derivatives={"x": v, "v": -x - x**3 - 0.1*v + g*ca.cos(theta)},
    ...            parameters={"omega": (omega, 1.0), "g": (g, 0.3)})
    >>> PortParameters(Ports(s)).forcing(s.parameter_vector(), 1).u.real.tolist()
    [[0.0, 0.0], [0.0, 0.5]]
    """

    def __init__(self, ports: Ports) -> None:
        self.ports = ports
        self._slopes: dict[int, ca.Function | None] = {}

    def forcing(self, p: np.ndarray, index: int) -> Forcing:
        """Return the Fourier coefficients of d(forcing, gain, offset)/dp[index] over one excitation period.

        Raises
        ------
        UnsupportedModel
            If the derivative is not a smooth function of the phase.
        """
        return self.ports.excitation.derivative(p, index)

    def argument_slopes(self, p: np.ndarray, index: int) -> np.ndarray | None:
        """Return the derivative (contacts, k) of the slopes of the contact arguments, None where it is zero."""
        return _value(self._slopes, index, self.ports.argument_slope, p)


def _derivative(expression: ca.SX, given: list[ca.SX], symbol: ca.SX) -> ca.Function | None:
    change = ca.densify(ca.jacobian(expression, symbol))
    return None if change.is_zero() else ca.Function("parameter_derivative", given, [change])


def _value(known: dict[int, Any], index: int, function: ca.Function, p: np.ndarray) -> np.ndarray | None:
    """Evaluate d(function)/dp[index], made once, as an array shaped like the function's result."""
    if index not in known:
        symbols = function.sx_in()
        known[index] = _derivative(ca.vec(function(*symbols)), symbols, symbols[0][index])
    change = known[index]
    return None if change is None else np.array(change(p)).reshape(function.size_out(0), order="F")
