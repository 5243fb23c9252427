"""Piecewise-linear laws of one scalar argument: exact modes, guards and the smoothed family from one definition."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count, pairwise
from typing import Any

import casadi as ca
import numpy as np

_serial = count()


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Declare a continuous piecewise-linear force of one scalar argument, zero at argument zero.

    Parameters
    ----------
    argument : casadi.SX
        Scalar expression of states, phase and parameters, for a gear ``(lambda - e)`` over half the backlash.
    breakpoints : tuple of float, length m
        Arguments at which the slope changes, strictly increasing.
    slopes : tuple of float, length m + 1
        Slope left of the first breakpoint, between them, and right of the last.
    name : str
        Name used in messages and reports.

    Attributes
    ----------
    force : casadi.SX
        Symbol that stands for the force in the derivatives of a :class:`~continuation.System`.
    intercepts : array (m + 1,)
        Force = slope * argument + intercept in each mode.

    Raises
    ------
    ValueError
        If breakpoints do not increase, or the number of slopes is not one more than that of breakpoints.

    Examples
    --------
    >>> import casadi as ca
    >>> x = ca.SX.sym("x")
    >>> dead_zone = Contact(argument=x, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0))
    >>> dead_zone.value([-3.0, 0.5, 1.5]).tolist()
    [-2.0, 0.0, 0.5]
    """

    argument: ca.SX
    breakpoints: tuple[float, ...]
    slopes: tuple[float, ...]
    name: str = "contact"
    force: ca.SX = field(init=False, repr=False)
    intercepts: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        b = tuple(float(v) for v in self.breakpoints)
        s = tuple(float(v) for v in self.slopes)
        if len(s) != len(b) + 1:
            raise ValueError(
                f"contact {self.name!r}: expected {len(b) + 1} slopes for {len(b)} breakpoints, got {len(s)}"
            )
        if not b or not np.all(np.isfinite(b + s)) or any(u >= v for u, v in pairwise(b)):
            raise ValueError(f"contact {self.name!r}: breakpoints must be finite and strictly increasing, got {b}")
        object.__setattr__(self, "breakpoints", b)
        object.__setattr__(self, "slopes", s)
        c = np.concatenate([[0.0], np.cumsum(-np.diff(s) * np.array(b))])
        c = c - c[self.mode(0.0)]
        c.flags.writeable = False
        object.__setattr__(self, "intercepts", c)
        symbol = type(self.argument).sym(f"{self.name}_force_{next(_serial)}")
        object.__setattr__(self, "force", symbol)

    def mode(self, argument: Any) -> Any:
        """Return the index of the linear piece each argument lies in."""
        return np.searchsorted(self.breakpoints, argument)

    def value(self, argument: Any) -> np.ndarray:
        """Evaluate the exact force at arguments of any shape."""
        arg = np.asarray(argument, dtype=float)
        j = self.mode(arg)
        return np.array(self.slopes)[j] * arg + self.intercepts[j]

    def expression(self, width: float = 0.0) -> ca.SX:
        """Return the force as a CasADi expression of the argument.

        Every corner ``max(x - b, 0)`` becomes ``((x - b) + sqrt((x - b)^2 + w^2))/2``; width 0 gives the exact law.

        Parameters
        ----------
        width : float
            Smoothing width w in the unit of the argument, 0 or positive.
        """
        x, b, s = self.argument, self.breakpoints, self.slopes
        force = s[0] * x
        for position, left, right in zip(b, s, s[1:], strict=False):
            z = x - position
            corner = ca.fmax(z, 0) if width == 0.0 else (z + ca.sqrt(z**2 + width**2)) / 2
            force += (right - left) * (corner - max(-position, 0.0))
        return force
