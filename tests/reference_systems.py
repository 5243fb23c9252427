"""Systems with known answers, shared by the tests of every method; each names where its numbers come from.

"AUTO-07p" stands for values of its collocation engine, "event-exact" for an independent integrator that lands on every
contact change.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import linear_sum_assignment

from continuation import Contact, System
from sbg_casadi import gear_system
from sbg_casadi.dimensionless import Dimensionless

ZETA = 0.05  # damping ratio of the backlash oscillators


def symbols(*names: str) -> list[ca.SX]:
    """Return one scalar CasADi symbol per name."""
    return [ca.SX.sym(n) for n in names]


# ------------------------------------------------------------------------------------------------ smooth oscillators
def linear_oscillator(zeta: float = 0.03, force: float = 0.4) -> System:
    """x'' + 2 zeta x' + x = force cos(theta): amplitude force / |1 - omega^2 + 2 i zeta omega|."""
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    return System(
        name="linear",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -2 * zeta * v - x + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5), "g": (g, force)},
    )


CHAIN_MASS = np.diag([1.0, 0.5, 2.0])
CHAIN_STIFFNESS = np.array([[3.0, -1.0, 0.0], [-1.0, 2.5, -1.5], [0.0, -1.5, 2.0]])
CHAIN_LOAD = np.array([0.3, 0.0, -0.2 + 0.1j])  # complex amplitude of the load of the first harmonic


def linear_chain(damping: float) -> System:
    """Three masses with M, K above, damping times K, and the load Re(CHAIN_LOAD exp(i theta)) on top of a dead load."""
    theta, omega = symbols("theta", "omega")
    q, v = [ca.SX.sym(f"q{i}") for i in range(3)], [ca.SX.sym(f"v{i}") for i in range(3)]
    load = CHAIN_LOAD.real * ca.cos(theta) - CHAIN_LOAD.imag * ca.sin(theta) + ca.DM([0.1, 0.0, 0.0])
    spring = ca.DM(CHAIN_STIFFNESS) @ (ca.vertcat(*q) + damping * ca.vertcat(*v))
    acceleration = ca.DM(np.linalg.inv(CHAIN_MASS)) @ (load - spring)
    return System(
        name="chain",
        states={f"q{i}": q[i] for i in range(3)} | {f"v{i}": v[i] for i in range(3)},
        derivatives={f"q{i}": v[i] for i in range(3)} | {f"v{i}": acceleration[i] for i in range(3)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5)},
    )


def duffing() -> System:
    """x'' + 0.05 x' + x + 0.1 x^3 = g cos(theta)."""
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    return System(
        name="duffing",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.05 * v - x - 0.1 * x**3 + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0), "g": (g, 0.18)},
    )


DUFFING_FOLDS = (1.2696019555, 1.1157002518)  # AUTO-07p, in the order of the branch from low frequency
DUFFING_FOLDS_ONE_HARMONIC = (1.2675369595, 1.1155859272)


def double_well() -> System:
    """x'' + 0.3 x' - x + x^3 = g cos(1.2 t)."""
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    return System(
        name="double well",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -0.3 * v + x - x**3 + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"g": (g, 0.2), "omega": (omega, 1.2)},
    )


DOUBLE_WELL_DOUBLINGS = (0.2655817860556, 0.2866931578237, 0.2910899087718, 0.2920310002299)  # AUTO-07p


def cubic(bias: float = 0.0) -> System:
    """x'' + 0.3 x' + x^3 = bias + g cos(theta); without bias symmetric under x -> -x, half a period later."""
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    return System(
        name="cubic",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": bias - 0.3 * v - x**3 + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"g": (g, 1.0), "omega": (omega, 1.0)},
    )


DETACHING = (0.1, 0.35, 0.3)  # damping force d1 v - d3 v^3 + d5 v^5


def detached_resonance(force: float) -> System:
    """x'' + 0.1 x' - 0.35 x'^3 + 0.3 x'^5 + x = force cos(theta) (after Habib, Cirillo and Kerschen 2018).

    One harmonic of velocity amplitude V meets ``D(V)^2 + (1/omega - omega)^2 V^2 = force^2`` with
    ``D = d1 V - 3/4 d3 V^3 + 5/8 d5 V^5``: an isola while force lies between the minimum and the maximum of D.
    """
    x, v, theta, omega, g = symbols("x", "v", "theta", "omega", "g")
    d1, d3, d5 = DETACHING
    return System(
        name="detached resonance",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": -x - d1 * v + d3 * v**3 - d5 * v**5 + g * ca.cos(theta)},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0), "g": (g, force)},
    )


def absorber() -> System:
    """Two masses with a cubic absorber (nonlinear tuned vibration absorber)."""
    x1, v1, x2, v2, theta, omega, g = symbols("x1", "v1", "x2", "v2", "theta", "omega", "g")
    pull = 0.013 * (v1 - v2) + 0.0453 * (x1 - x2) + 0.0042 * (x1 - x2) ** 3
    return System(
        name="absorber",
        states={"x1": x1, "v1": v1, "x2": x2, "v2": v2},
        derivatives={
            "x1": v1,
            "v1": g * ca.cos(theta) - 0.002 * v1 - x1 - x1**3 - pull,
            "x2": v2,
            "v2": pull / 0.05,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.0), "g": (g, 0.11)},
    )


def mathieu(q: float) -> System:
    """y'' + (a - 2 q cos 2t) y = 0 with theta = 2 t."""
    y, v, theta, omega, a = symbols("y", "v", "theta", "omega", "a")
    return System(
        name="mathieu",
        states={"y": y, "v": v},
        derivatives={"y": v, "v": -(a - 2 * q * ca.cos(theta)) * y},
        phase=theta,
        frequency="omega",
        parameters={"a": (a, 0.0), "omega": (omega, 2.0)},
    )


MATHIEU_EDGES = {  # a0, b1, a1, b2, a2 of McLachlan's tables
    1.0: (-0.455138604, -0.110248817, 1.859108073, 3.917024773, 4.371300983),
    5.0: (-5.800046021, -5.790080599, 1.858187542, 2.099460445, 7.449109740),
}


def coupled_van_der_pol() -> System:
    """Two coupled forced oscillators with a nonlinear term in every equation: no port structure to condense onto."""
    x, v, y, w, theta, omega, g = symbols("x", "v", "y", "w", "theta", "omega", "g")
    return System(
        name="coupled van der Pol",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v + 0.1 * ca.sin(y),
            "v": 0.1 * (1 - x**2) * v - x + 0.2 * y * w + g * ca.cos(theta),
            "y": w - 0.05 * x * y,
            "w": -0.2 * w - 1.5 * y - y**3 + 0.3 * x + 0.1 * v**2,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.3), "g": (g, 1.5)},
    )


# ------------------------------------------------------------------------------------------------ contact
def dead_zone(argument: ca.SX, name: str = "mesh") -> Contact:
    """Return the dead zone of half width 1."""
    return Contact(argument=argument, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0), name=name)


def backlash() -> System:
    """x'' + 2 zeta x' + f(x) = 0.1 + 0.05 omega^2 cos(theta), f the dead zone of half width 1."""
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    mesh = dead_zone(x)
    return System(
        name="backlash",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.1 + 0.05 * omega**2 * ca.cos(theta) - 2 * ZETA * v - mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.5)},
        contacts=[mesh],
        outputs={"contact force": mesh.force},
    )


def parametric_backlash() -> System:
    """x'' + 0.1 x' + (1 + 0.3 cos theta) f(x) = 0.5, f the dead zone of half width 1."""
    x, v, theta, omega = symbols("x", "v", "theta", "omega")
    mesh = dead_zone(x)
    return System(
        name="parametric backlash",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.5 - 0.1 * v - (1 + 0.3 * ca.cos(theta)) * mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.5)},
        contacts=[mesh],
    )


def stops(*, damping: float, gain: float, force: float, width: float, stops: int = 1, load: float = 0.1) -> System:
    """Oscillator with one or two contacts of different gaps and a modulated gain, for properties on random numbers."""
    x, v, y, w, theta, omega = symbols("x", "v", "y", "w", "theta", "omega")
    first = Contact(argument=x, breakpoints=(-width, width), slopes=(1.0, 0.0, 1.0), name="first")
    second = Contact(argument=x - y, breakpoints=(0.5,), slopes=(0.0, 0.7), name="second")
    contacts = [first, second][:stops]
    push = second.force if stops == 2 else 0
    return System(
        name="stops",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={
            "x": v,
            "v": load + force * ca.cos(theta) - damping * v - (1 + gain * ca.cos(theta)) * first.force - push,
            "y": w,
            "w": -0.3 * w - 1.7 * y + push + 0.1 * x,
        },
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 0.8)},
        contacts=contacts,
    )


GEAR = Dimensionless(
    name="example",
    state="only",
    torque=0.14,
    mesh_damping_ratio=0.02,
    tangential_cosine=0.77,
    directions=(-0.62, 0.15, 0.77, 0.62, -0.15, -0.77),
    mass_ratios=(0.3, 0.3, 0.3, 0.06, 0.06, 0.06),
    bearing_stiffness=(2.0, 2.0, 2.0, 1.0, 1.0, 1.0),
    bearing_damping=(0.02,) * 6,
    stiffness_cosine=(0.3, 0.1),
    stiffness_sine=(0.0, 0.0),
)
GEAR_FOLDS = (1.5210287084, 1.5224413123, 0.5223924391, 0.6076292998)  # two codes, 127 and 255 harmonics
GEAR_DOUBLINGS = (1.4160415167, 1.2774983866, 0.5904190535, 0.5225771384)


def gear(scale: float = 1.0) -> System:
    """Spiral bevel gear pair of 7 coordinates in dimensionless form, its stiffness variation scaled."""
    return gear_system(replace(GEAR, stiffness_cosine=(0.3 * scale, 0.1 * scale)))


# ------------------------------------------------------------------------------------------------ independent checks
class ExactFlow:
    """States and variational equations integrated by SciPy's DOP853, piece by piece between contact changes.

    Nothing of the engine is used but the symbolic right-hand side of the System.
    """

    def __init__(self, system: System, **parameters: float) -> None:
        self.system, self.p = system, system.parameter_vector(parameters)
        self.n, self.contacts = len(system.state_names), system.contacts
        slopes, intercepts = ca.SX.sym("s", len(self.contacts)), ca.SX.sym("c", len(self.contacts))
        matrix = ca.SX.sym("Z", self.n, self.n)
        rate = ca.substitute(system.derivative, system.phi, slopes * system.arguments + intercepts)
        matrix_rate = ca.jacobian(rate, system.x) @ matrix
        omega = self.p[system.parameter_names.index(system.frequency)]
        given = [system.theta, ca.vertcat(system.x, ca.vec(matrix)), slopes, intercepts]
        known = [[rate / omega, matrix_rate / omega], [system.p], [ca.DM(self.p)]]
        rate, matrix_rate = ca.substitute(*known)
        arguments = ca.substitute([system.arguments], [system.p], [ca.DM(self.p)])[0]
        self._rate = ca.Function("rate", given, [ca.vertcat(rate, ca.vec(matrix_rate))])
        self._arguments = ca.Function("arguments", [system.theta, system.x], [arguments])

    def _piece(self, theta: float, z: np.ndarray, end: float, modes: Sequence[int], events: list | None) -> Any:
        """Integrate with the linear laws of the given modes, which go on smoothly behind their corners."""
        s = np.array([c.slopes[m] for c, m in zip(self.contacts, modes, strict=True)])
        c0 = np.array([c.intercepts[m] for c, m in zip(self.contacts, modes, strict=True)])
        return solve_ivp(
            lambda t, y: self._rate(t, y, s, c0).full().ravel(), (theta, end), z,
            method="DOP853", rtol=1e-12, atol=1e-13, events=events, max_step=0.1,
        )  # fmt: skip

    def _modes(self, theta: float, z: np.ndarray) -> list[int]:
        values = self._arguments(theta, z[: self.n]).full().ravel()
        return [int(np.searchsorted(c.breakpoints, a)) for c, a in zip(self.contacts, values, strict=True)]

    def _events(self) -> list[Callable]:
        def crossing(i: int, level: float) -> Callable:
            def gap(theta: float, z: np.ndarray) -> float:
                return float(self._arguments(theta, z[: self.n])[i]) - level

            gap.terminal = True
            return gap

        return [crossing(i, b) for i, c in enumerate(self.contacts) for b in c.breakpoints]

    def __call__(self, start: np.ndarray, turns: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Return the state (n,) after whole excitation periods from phase 0, and its derivative (n, n) by the start."""
        theta, end = 0.0, 2 * np.pi * turns
        z = np.concatenate([np.asarray(start, dtype=float), np.eye(self.n).ravel()])
        events = self._events()
        modes = self._modes(theta, z)
        while end - theta > 1e-9:
            sol = self._piece(theta, z, end, modes, events or None)
            theta, z = sol.t[-1], sol.y[:, -1]
            if sol.status == 1:  # over the corner: which mode follows is seen a moment later
                hop = 1e-7
                modes = self._modes(theta + hop, self._piece(theta, z, theta + hop, modes, None).y[:, -1])
                sol = self._piece(theta, z, theta + hop, modes, None)
                theta, z = sol.t[-1], sol.y[:, -1]
        return z[: self.n], z[self.n :].reshape(self.n, self.n).T

    def orbit(self, start: np.ndarray, turns: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """Return the state at phase 0 of the periodic orbit near a start, by Newton's method, and its monodromy."""
        x = np.asarray(start, dtype=float)
        for _ in range(8):
            end, M = self(x, turns)
            step = np.linalg.solve(np.eye(self.n) - M, end - x)
            x = x + step
            if np.abs(step).max() < 1e-11:
                return x, M
        raise AssertionError("shooting with SciPy did not converge")


def multiplier_distance(mu: np.ndarray, other: np.ndarray) -> float:
    """Return the largest distance between two sets of multipliers, paired one to one."""
    table = np.abs(mu[:, None] - other[None, :])
    rows, columns = linear_sum_assignment(table)
    return float(table[rows, columns].max())


def near(points: Sequence[float], wanted: Sequence[float]) -> float:
    """Return the largest distance of a wanted number from its nearest point; infinite when the counts differ."""
    if len(points) != len(wanted):
        return float("inf")
    return float(np.abs(np.sort(points) - np.sort(wanted)).max())


# ------------------------------------------------------------------------------------------------ autonomous
def lorenz() -> System:
    """The Lorenz equations, sigma = 10, b = 8/3, at high r (Sparrow, The Lorenz Equations)."""
    x, y, z, r = symbols("x", "y", "z", "r")
    return System(
        name="lorenz",
        states={"x": x, "y": y, "z": z},
        derivatives={"x": 10 * (y - x), "y": r * x - y - x * z, "z": x * y - 8 / 3 * z},
        parameters={"r": (r, 240.0)},
    )


def third_order() -> System:
    """x''' + alpha x'' + x' + x = x^2: a cycle is born at the Hopf point alpha = 1 and doubles at 0.6303020062."""
    x, y, z, alpha = symbols("x", "y", "z", "alpha")
    return System(
        name="third-order",
        states={"x": x, "y": y, "z": z},
        derivatives={"x": y, "y": z, "z": -alpha * z - y - x + x**2},
        parameters={"alpha": (alpha, 0.9)},
    )


def enzyme() -> System:
    """Two concentrations with inhibition by the substrate: cycles between two Hopf points, with two folds."""
    s, a, rho = symbols("S", "A", "rho")
    rate = rho * s * a / (1 + s + 0.1 * s**2)
    return System(
        name="enzyme",
        states={"S": s, "A": a},
        derivatives={"S": 110 - s - rate, "A": 0.2 * (500 - a) - rate},
        parameters={"rho": (rho, 4.0)},
    )
