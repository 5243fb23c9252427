"""A System as plain data, so that it can go to another process, be compared, and be named in a file."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from continuation.model.contact import Contact
from continuation.model.system import System


@dataclass(frozen=True, slots=True)
class PlainSystem:
    """Hold all of a System as text and numbers.

    Attributes
    ----------
    name : str
    state_names, output_names : tuple of str
    parameters : tuple of (str, float)
        Names and default values in order.
    frequency : str or None
    contacts : tuple of (name, breakpoints, slopes)
    functions : str
        CasADi's text form of the function (x, phi, theta, p) -> derivative, contact arguments, outputs.

    Examples
    --------
    >>> x, v = ca.SX.sym("x"), ca.SX.sym("v")
    >>> spring = System(name="spring", states={"x": x, "v": v}, derivatives={"x": v, "v": -x}, parameters={})
    >>> PlainSystem.of(spring).system().rhs([1.0, 2.0], 0.0).tolist()
    [2.0, -1.0]
    """

    name: str
    state_names: tuple[str, ...]
    output_names: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...]
    frequency: str | None
    contacts: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]
    functions: str

    @classmethod
    def of(cls, system: System) -> PlainSystem:
        """Take everything from a System."""
        given = [system.x, system.phi, system.theta, system.p]
        f = ca.Function("system", given, [system.derivative, system.arguments, ca.SX(system.outputs)])
        return cls(
            name=system.name,
            state_names=system.state_names,
            output_names=system.output_names,
            parameters=tuple(system.defaults.items()),
            frequency=system.frequency,
            contacts=tuple((c.name, tuple(c.breakpoints), tuple(c.slopes)) for c in system.contacts),
            functions=f.serialize(),
        )

    def system(self) -> System:
        """Build the System again, on symbols of its own."""
        f = ca.Function.deserialize(self.functions)
        n, m, q = len(self.state_names), len(self.contacts), len(self.parameters)
        x, theta, p = ca.SX.sym("x", n), ca.SX.sym("theta"), ca.SX.sym("p", q)
        arguments = ca.vertsplit(f(x, ca.SX.sym("phi", m), theta, p)[1]) if m else []
        contacts = [
            Contact(argument=a, breakpoints=b, slopes=s, name=name)
            for a, (name, b, s) in zip(arguments, self.contacts, strict=True)
        ]
        derivative, _, outputs = f(x, ca.vertcat(*(c.force for c in contacts)) if m else ca.SX(0, 1), theta, p)
        states = ca.vertsplit(x)
        return System(
            name=self.name,
            states=dict(zip(self.state_names, states, strict=True)),
            derivatives=dict(zip(self.state_names, ca.vertsplit(derivative), strict=True)),
            parameters={k: (s, v) for (k, v), s in zip(self.parameters, ca.vertsplit(p) if q else [], strict=True)},
            phase=None if self.frequency is None else theta,
            frequency=self.frequency,
            contacts=contacts,
            outputs=dict(zip(self.output_names, ca.vertsplit(outputs) if self.output_names else [], strict=True)),
        )
