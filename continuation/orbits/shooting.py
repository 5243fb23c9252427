"""Shooting, single and multiple: periodic orbits as fixed points of the flow, exact at contact changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from continuation.model.system import System
from continuation.orbits.shooting_problem import ShootingProblem
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.flows import ExactFlow, SmoothFlow

__all__ = ["Shooting", "ShootingProblem"]


@dataclass(frozen=True, slots=True)
class Shooting:
    """Choose shooting.

    Parameters
    ----------
    segments : int, optional
        Segments of equal phase the period is cut into; 1 is single shooting. None chooses at the first orbit, so that
        no segment magnifies a deviation more than a thousandfold.
    rtol, atol : float
        Tolerances of the local error of the event-exact integration, relative and absolute in the unit of the states.
    steps : int
        Largest number of its steps per excitation period.
    machine_code : bool, optional
        Whether its steps are compiled, which needs a C compiler: at once (True), never (False), or after the
        thousands of steps that make it pay (None).
    integrator : CVODES, optional
        Integrate by CVODES instead, with its own tolerances: smooth Systems, stiff ones with ``CVODES(stiff=True)``.

    Raises
    ------
    ValueError
        If a tolerance, the number of steps or of segments is not positive, or tolerances are given beside those of the
        integrator.

    Notes
    -----
    Nayfeh and Balachandran, Applied Nonlinear Dynamics, section 6.5; Seydel, Practical Bifurcation and Stability
    Analysis, section 7.6, for several segments.

    With contacts, the instants of contact changes are unknowns of every segment, each fixed by its own equation
    "argument = breakpoint". They are eliminated inside the integration, where Newton's method lands on each to
    rounding: the equations are triangular in the instants, so that elimination gives the same Newton steps as one
    system of states and instants would, but needs no contact pattern fixed beforehand. As the forces are continuous, an
    instant has no influence on the end of its segment to first order; in second derivatives it has, and is there.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> orbit = Shooting().discretise(linear, "omega").guess(omega=2.0)
    >>> [round(float(value), 8) for value in orbit.evaluate(0.0)[0]]          # response 1/(1 - 4 + 0.4i)
    [-0.32751092, 0.08733624]
    """

    segments: int | None = None
    rtol: float = 1e-10
    atol: float = 1e-12
    steps: int = 2000
    machine_code: bool | None = None
    integrator: CVODES | None = None

    def __post_init__(self) -> None:
        for name in ("rtol", "atol", "steps"):
            if not getattr(self, name) > 0:
                raise ValueError(f"Shooting: {name} must be positive, got {getattr(self, name)}")
        if self.segments is not None and (self.segments < 1 or self.segments != int(self.segments)):
            raise ValueError(f"Shooting: segments must be a whole number >= 1 or None, got {self.segments}")
        if self.integrator is None:
            return
        if not isinstance(self.integrator, CVODES):
            raise ValueError(f"Shooting: integrator must be CVODES(...) or None, got {self.integrator!r}")
        fields = type(self).__dataclass_fields__
        for name in ("rtol", "atol", "steps", "machine_code"):
            if getattr(self, name) != fields[name].default:
                raise ValueError(f"Shooting: {name} belongs to the event-exact integration; give it to CVODES(...)")

    def discretise(self, system: System, parameter: str, period_multiple: int = 1, **parameters: float) -> Any:
        """Make the problem of orbits whose period is a multiple of the excitation period.

        Parameters
        ----------
        system : System
            For an autonomous one the period is an unknown, and ``period_multiple`` counts cycles.
        parameter : str
            Name of the continuation parameter.
        period_multiple : int
            Orbit period over the excitation period.
        **parameters : float
            Other parameters, fixed along the branch; defaults of the System where absent.

        Raises
        ------
        UnsupportedModel
            If the System has contacts and the integrator is CVODES.
        ValueError
            If a parameter is unknown or the period multiple is not a positive integer.
        """
        if period_multiple < 1 or period_multiple != int(period_multiple):
            raise ValueError(f"period_multiple: expected an integer >= 1, got {period_multiple}")
        system.check_parameter(parameter)
        if system.autonomous:
            from continuation.orbits.free_period import free_period

            return free_period(self, system, parameter, int(period_multiple), parameters)
        flow: ExactFlow | SmoothFlow
        if self.integrator is None:
            exact = ExactIntegrator(
                system, rtol=self.rtol, atol=self.atol, steps=self.steps, machine_code=self.machine_code
            )
            flow = ExactFlow(exact)
        else:
            flow = SmoothFlow(system, self.integrator)
        return ShootingProblem(self, system, parameter, int(period_multiple), parameters, flow)
