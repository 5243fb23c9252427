"""The physics of a model as CasADi expressions; knows its parameters, its phase and its contacts, no method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from continuation.errors import UnsupportedModel, nearest
from continuation.model.contact import Contact


class System:
    """Hold a first-order model ``dx/dt = f(x, theta, p)`` with ``dtheta/dt`` = the frequency parameter.

    Parameters
    ----------
    name : str
        Name used in summaries and files.
    states : mapping of str to scalar symbol
        State variables, in order.
    derivatives : mapping of str to scalar expression
        Time derivative of every state; contact forces enter as ``contact.force``.
    parameters : mapping of str to (symbol, value)
        Parameters and their default values.
    phase : symbol, optional
        Excitation phase theta; the right-hand side is 2*pi-periodic in it. None for an autonomous model.
    frequency : str, optional
        Name of the parameter that is dtheta/dt.
    contacts : sequence of Contact
        Piecewise-linear laws whose force symbols appear in the derivatives.
    outputs : mapping of str to scalar expression
        Further quantities of states, phase, parameters and contact forces, evaluated pointwise on orbits.

    Raises
    ------
    ValueError
        If names do not match, a symbol is undeclared, or a default value is not finite.
    UnsupportedModel
        If the argument of a contact depends on a contact force.

    Examples
    --------
    >>> import casadi as ca
    >>> x, v, theta, omega = (ca.SX.sym(n) for n in ("x", "v", "theta", "omega"))
    >>> s = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": -x - 0.1*v + ca.cos(theta)},
    ...            phase=theta, frequency="omega", parameters={"omega": (omega, 0.5)})
    >>> s
    System('linear': 2 states, 1 parameter, phase theta with frequency omega, 0 contacts)
    >>> s.rhs([1.0, 0.0], 0.0).tolist()
    [0.0, 0.0]
    """

    def __init__(
        self,
        *,
        name: str,
        states: Mapping[str, ca.SX],
        derivatives: Mapping[str, Any],
        parameters: Mapping[str, tuple[ca.SX, float]],
        phase: ca.SX | None = None,
        frequency: str | None = None,
        contacts: Sequence[Contact] = (),
        outputs: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = name
        self.state_names = tuple(states)
        self.parameter_names = tuple(parameters)
        self.output_names = tuple(outputs or {})
        self.frequency = frequency
        self.contacts = tuple(contacts)
        self._check_names(states, derivatives, parameters, phase)
        self.defaults = {k: float(v) for k, (_, v) in parameters.items()}
        for key, value in self.defaults.items():
            if not np.isfinite(value):
                raise ValueError(f"parameter {key!r} of system {name!r}: expected a finite number, got {value}")
        self._expand(states, derivatives, parameters, phase, outputs or {})
        self._check_contacts()

    def _check_names(self, states: Mapping, derivatives: Mapping, parameters: Mapping, phase: ca.SX | None) -> None:
        if set(states) != set(derivatives):
            odd = sorted(set(states) ^ set(derivatives))
            raise ValueError(
                f"system {self.name!r}: states and derivatives must have the same names; only one has {odd}"
            )
        if not states:
            raise ValueError(f"system {self.name!r}: expected at least one state")
        if (phase is None) != (self.frequency is None):
            raise ValueError(f"system {self.name!r}: phase and frequency go together; one of them is missing")
        if self.frequency is not None and self.frequency not in parameters:
            raise ValueError(
                f"system {self.name!r}: frequency {self.frequency!r} is not a parameter; "
                f"{nearest(self.frequency, parameters)}"
            )

    def _expand(
        self, states: Mapping, derivatives: Mapping, parameters: Mapping, phase: ca.SX | None, outputs: Mapping
    ) -> None:
        """Rebuild every expression on fresh SX vectors x, phi (contact forces), theta, p; MX models are expanded."""
        kind = type(next(iter(states.values())))
        theta = kind.sym("theta") if phase is None else phase
        given = [
            ca.vertcat(*states.values()),
            ca.vertcat(*(c.force for c in self.contacts)),
            theta,
            ca.vertcat(*(s for s, _ in parameters.values())),
        ]
        expressions = [
            ca.vertcat(*(derivatives[k] for k in states)),
            ca.vertcat(*(c.argument for c in self.contacts)),
            ca.vertcat(*outputs.values()),
        ]
        expressions = [kind(e) for e in expressions]
        f = ca.Function("system", given, expressions, {"allow_free": True})
        if f.has_free():
            raise ValueError(
                f"system {self.name!r}: symbol {f.get_free()[0]!r} is neither state, parameter, phase nor contact force"
            )
        f = f if kind is ca.SX else f.expand()
        n, m, q = len(states), len(self.contacts), len(parameters)
        self.x, self.phi = ca.SX.sym("x", n), ca.SX.sym("phi", m)
        self.theta, self.p = ca.SX.sym("theta"), ca.SX.sym("p", q)
        self.derivative, self.arguments, self.outputs = f(self.x, self.phi, self.theta, self.p)

    def _check_contacts(self) -> None:
        for i, contact in enumerate(self.contacts):
            inner = [c.name for j, c in enumerate(self.contacts) if ca.depends_on(self.arguments[i], self.phi[j])]
            if inner:
                raise UnsupportedModel(
                    f"contact {contact.name!r} of system {self.name!r}: its argument depends on the force of contact "
                    f"{inner[0]!r}, and no method treats a contact inside a contact; make the point between them a "
                    "state (with a small mass or a damper), or merge springs in series into one Contact"
                )

    @property
    def autonomous(self) -> bool:
        """Whether the model has no excitation phase."""
        return self.frequency is None

    def parameter_vector(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Return all parameters in order, defaults replaced by the given values; unknown names raise ValueError."""
        p = dict(self.defaults)
        for key, value in (values or {}).items():
            p[self.check_parameter(key)] = float(value)
        return np.array(list(p.values()))

    def check_parameter(self, name: str) -> str:
        """Return the name if it is a parameter, else raise ValueError that lists the nearest."""
        if name not in self.defaults:
            raise ValueError(f"system {self.name!r} has no parameter {name!r}; {nearest(name, self.parameter_names)}")
        return name

    def forces(self, width: float = 0.0) -> ca.SX:
        """Return the contact forces as expressions of x, theta, p; width 0 is the exact law (with ``fmax``)."""
        laws = []
        for i, contact in enumerate(self.contacts):
            argument = ca.SX.sym("a")
            local = Contact(argument=argument, breakpoints=contact.breakpoints, slopes=contact.slopes)
            laws.append(ca.substitute(local.expression(width), argument, self.arguments[i]))
        return ca.vertcat(*laws)

    def closed(self, width: float = 0.0) -> ca.SX:
        """Return dx/dt with the contact laws put in, an expression of x, theta, p."""
        return ca.substitute(self.derivative, self.phi, self.forces(width)) if self.contacts else self.derivative

    def smoothed(self, width: float) -> System:
        """Return the same System with smoothed contact laws of the given width (unit of the argument); 0 returns self.

        Raises
        ------
        ValueError
            If the width is negative or not finite.
        """
        if not (np.isfinite(width) and width >= 0):
            raise ValueError(f"smoothing width: expected a number >= 0, got {width}")
        if width == 0 or not self.contacts:
            return self
        forces = self.forces(width)
        d, o = ca.substitute([self.derivative, self.outputs], [self.phi], [forces])
        return self._copy(d, o, ())

    def with_parameters(self, **values: float) -> System:
        """Return the same System with other default values; unknown names raise ValueError."""
        new = self._copy(self.derivative, self.outputs, self.contacts)
        new.defaults = dict(zip(self.parameter_names, self.parameter_vector(values).tolist(), strict=True))
        return new

    def clocked(self, frequency: str, value: float) -> System:
        """Return an autonomous System as a driven one whose right-hand side does not depend on the phase.

        The phase is then the time in units of a period, ``frequency`` a further parameter with the given value; orbits
        are found with it as an unknown.
        """
        new = self._copy(self.derivative, self.outputs, self.contacts)
        new.frequency, new.parameter_names = frequency, (*self.parameter_names, frequency)
        new.defaults = {**self.defaults, frequency: float(value)}
        old = [self.derivative, self.arguments, self.outputs]
        f = ca.Function("system", [self.x, self.phi, self.theta, self.p], old)
        new.p = ca.SX.sym("p", len(new.parameter_names))
        new.derivative, new.arguments, new.outputs = f(self.x, self.phi, self.theta, new.p[:-1])
        return new

    def _copy(self, derivative: ca.SX, outputs: ca.SX, contacts: tuple[Contact, ...]) -> System:
        new = object.__new__(System)
        new.__dict__.update(self.__dict__)
        new.derivative, new.outputs, new.contacts = derivative, outputs, contacts
        if not contacts:
            new.phi, new.arguments = ca.SX.sym("phi", 0), ca.SX(0, 1)
        return new

    def rhs(self, x: Any, theta: float, **parameters: float) -> np.ndarray:
        """Evaluate dx/dt with the exact law at one state, shape (n,)."""
        f = ca.Function("rhs", [self.x, self.theta, self.p], [self.closed()])
        return np.array(f(np.asarray(x, dtype=float), theta, self.parameter_vector(parameters))).ravel()

    def __repr__(self) -> str:
        def plural(n: int, word: str) -> str:
            return f"{n} {word}" + ("" if n == 1 else "s")

        drive = "autonomous" if self.autonomous else f"phase theta with frequency {self.frequency}"
        parts = [plural(len(self.state_names), "state"), plural(len(self.parameter_names), "parameter")]
        return f"System({self.name!r}: {', '.join(parts)}, {drive}, {plural(len(self.contacts), 'contact')})"
