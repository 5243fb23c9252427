"""Systems with contacts that do not enter linearly, shared by the tests of quadrature and of general contacts."""

from __future__ import annotations

from typing import Any

import casadi as ca
import reference_systems as rs

from continuation import Contact, System


def _oscillator(name: str, contact: Any, push: Any, **parameters: float) -> System:
    """x'' + 0.1 x' + 0.3 x + push(contact force, x, v, theta, extra parameters) = 0.3 + g cos(theta)."""
    x, v, theta, omega, g = rs.symbols("x", "v", "theta", "omega", "g")
    extra = {k: ca.SX.sym(k) for k in parameters}
    law = contact(x, theta, **extra)
    rate = 0.3 + g * ca.cos(theta) - 0.1 * v - 0.3 * x - push(law.force, x, v, theta, **extra)
    return System(
        name=name,
        states={"x": x, "v": v},
        derivatives={"x": v, "v": rate},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.8), "g": (g, 0.8)} | {k: (extra[k], value) for k, value in parameters.items()},
        contacts=[law],
    )


def _stop(x: ca.SX, theta: ca.SX, **extra: ca.SX) -> Contact:
    return Contact(argument=x, breakpoints=(0.5,), slopes=(0.0, 1.0), name="stop")


def hertz() -> System:
    """A Hertzian stop: its force is the 3/2 power of the penetration."""
    return _oscillator("hertz", _stop, lambda f, x, v, t, k: k * f**1.5, k=2.0)


def hertz_in_the_open() -> System:
    """The same model without a Contact: the force is smooth enough for fine sampling."""
    x, v, theta, omega, g = rs.symbols("x", "v", "theta", "omega", "g")
    rate = 0.3 + g * ca.cos(theta) - 0.1 * v - 0.3 * x - 2.0 * ca.fmax(x - 0.5, 0) ** 1.5
    return System(name="hertz", states={"x": x, "v": v}, derivatives={"x": v, "v": rate}, phase=theta,
                  frequency="omega", parameters={"omega": (omega, 0.8), "g": (g, 0.8)})  # fmt: skip


def hunt_crossley() -> System:
    """Contact damping proportional to the penetration, after Hunt and Crossley 1975."""
    return _oscillator("hunt", _stop, lambda f, x, v, t, k, c: k * f * (1 + c * v), k=5.0, c=0.3)


def squared_backlash() -> System:
    """Backlash with a progressive stiffness that varies with the phase."""

    def push(f: ca.SX, x: ca.SX, v: ca.SX, t: ca.SX, a: ca.SX) -> ca.SX:
        return (1 + a * ca.cos(t)) * f * ca.fabs(f) + 0.2 * f

    return _oscillator("squared", lambda x, theta, a: rs.dead_zone(x), push, a=0.2)


def bent_argument() -> System:
    """A contact argument that is not linear in the state, nor constant in its coefficients."""

    def contact(x: ca.SX, theta: ca.SX, b: ca.SX) -> Contact:
        return rs.dead_zone(x * (1 + b * x) + 0.2 * ca.cos(theta) * x)

    return _oscillator("bent", contact, lambda f, x, v, t, b: 0.7 * f, b=0.1)


def radial_gap() -> System:
    """A rotor in a bearing with clearance: contact where the radius exceeds 1, force along the radius."""
    x, v, y, w, theta, omega, g = rs.symbols("x", "v", "y", "w", "theta", "omega", "g")
    r = ca.sqrt(x**2 + y**2)
    gap = Contact(argument=r, breakpoints=(1.0,), slopes=(0.0, 1.0), name="gap")
    push = 3 * gap.force / r
    return System(
        name="radial gap",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v,
            "v": g * ca.cos(theta) + 0.1 - 0.2 * v - 0.05 * x - push * x,
            "y": w,
            "w": g * ca.sin(theta) - 0.5 - 0.2 * w - 0.05 * y - push * y,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.2), "g": (g, 0.6)},
        contacts=[gap],
    )


def three_kinds() -> System:
    """A Hertzian contact with damping, one that enters linearly, and one with a bent argument, on two masses."""
    x, v, y, w, theta, omega, g = rs.symbols("x", "v", "y", "w", "theta", "omega", "g")
    ball = Contact(argument=x - 0.2 * g * ca.sin(theta), breakpoints=(0.4,), slopes=(0.0, 1.0), name="ball")
    mesh = Contact(argument=x - y, breakpoints=(-0.3, 0.3), slopes=(1.0, 0.0, 1.0), name="mesh")
    bent = Contact(argument=y + 0.1 * y**2, breakpoints=(0.2, 0.5), slopes=(0.0, 1.0, 3.0), name="bent")
    drive = mesh.force * (1 + 0.2 * ca.cos(theta))
    return System(
        name="three kinds",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v,
            "v": g * ca.cos(theta) + 0.1 - 0.2 * v - 0.5 * x - 3 * ball.force**1.5 * (1 + 0.1 * v) - drive,
            "y": w,
            "w": -0.2 * w - 1.3 * y + drive - bent.force * (1 + 0.3 * omega) - 0.1 * y**3,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.8), "g": (g, 0.8)},
        contacts=[ball, mesh, bent],
    )


def backlash(general: bool = True) -> System:
    """The backlash oscillator of the reference values, its contact in a product that any state could enter (e = 0)."""
    x, v, theta, omega, e = rs.symbols("x", "v", "theta", "omega", "e")
    mesh = rs.dead_zone(x)
    gain = 1 + e * x if general else 1 + 0.0 * e
    force = 0.1 + 0.05 * omega**2 * ca.cos(theta) - 2 * rs.ZETA * v - gain * mesh.force
    return System(
        name="backlash",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5), "e": (e, 0.0)},
        contacts=[mesh],
    )


GENERAL = {
    "hertz": hertz,
    "hunt": hunt_crossley,
    "squared": squared_backlash,
    "bent": bent_argument,
    "radial gap": radial_gap,
    "three kinds": three_kinds,
}
