"""The seven-coordinate equations (23)-(29) of a spiral bevel gear pair as a symbolic System."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from continuation import Contact, System
from sbg_casadi.dimensionless import COORDINATES, ONLY_STATE, Dimensionless
from sbg_casadi.reading import CONSISTENT, Reading, check_rows, reading_name

Parameters = Mapping[str, tuple[ca.SX, float]]


def gear_system(dimensionless: Dimensionless, reading: Reading = CONSISTENT) -> System:
    """Build the equations in time tau = omega_n t, lengths over half the backlash.

    One scalar, the mesh force ``G = K(theta) f(lambda - e) + 2 xi (lambda' - e')``, enters everywhere:

    - ``q_i'' + 2 C_i q_i' + K_i q_i = -s_i mu_i G``, (24)-(29) with the factor 2 that (25) is printed without;
    - ``lambda'' = sum_i s_i q_i'' + a3 T - a3^2 G``, (23) with balanced torques.

    The damping acts on lambda' - e' with ``e' = frequency_ratio de/dtheta``, where (12) is printed with lambda' alone.

    Parameters
    ----------
    dimensionless : Dimensionless
        Numbers of one pair in one state; row 1 of a reading acts on them, see :func:`~sbg_casadi.reading.as_read`.
    reading : frozenset of int
        Rows of the ledger taken as printed. Row 2: damping on lambda' in (12). Row 3: the cosine coefficients of (16)
        for its sines, too. Row 12: damping of (25) without the factor 2. Virtual work and the constant trace hold
        without row 12 only.

    Returns
    -------
    System
        14 states, ``lambda, x_p, y_p, z_p, x_g, y_g, z_g`` and their derivatives ``dlambda, dx_p, ...``; parameters
        ``frequency_ratio`` (omega_m / omega_n, the rate of the phase), ``torque`` (T) and ``mesh_damping_ratio`` (xi);
        outputs ``mesh_force`` (G), ``deflection`` (lambda - e) and ``bearing_x_p, ...``, the forces on the bearings of
        every direction in the unit of G; one Contact.

    Raises
    ------
    UserError
        If the reading has a row that changes no equation.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> gear_system(load_pair("example").dimensionless())
    System('example': 14 states, 3 parameters, phase theta with frequency frequency_ratio, 1 contact)
    """
    check_rows(reading)
    d, theta = dimensionless, ca.SX.sym("theta")
    k = 1 + harmonic_sum(d.stiffness_cosine, d.stiffness_sine, theta)  # (21)
    return pair_system(d, reading, theta, k, error_sum(d, reading, theta), gear_parameters(d))


def gear_parameters(dimensionless: Dimensionless) -> Parameters:
    """Return the symbols and values of the parameters that every System of a pair has."""
    values = {
        "frequency_ratio": 1.0,
        "torque": dimensionless.torque,
        "mesh_damping_ratio": dimensionless.mesh_damping_ratio,
    }
    return {name: (ca.SX.sym(name), value) for name, value in values.items()}


def error_sum(dimensionless: Dimensionless, reading: Reading, theta: ca.SX) -> ca.SX:
    """Return e(theta) of (16); row 3 of the ledger has the cosine coefficients twice."""
    d = dimensionless
    return harmonic_sum(d.error_cosine, d.error_cosine if 3 in reading else d.error_sine, theta)


def pair_system(
    dimensionless: Dimensionless,
    reading: Reading,
    theta: ca.SX,
    stiffness: ca.SX,
    error: ca.SX,
    parameters: Parameters,
    load: ca.SX | None = None,
) -> System:
    """Build the equations of :func:`gear_system` for any mesh stiffness, transmission error and load.

    Parameters
    ----------
    dimensionless : Dimensionless
        All else, and the names; its harmonics are not used.
    reading : frozenset of int
    theta : SX
        Phase.
    stiffness, error : SX
        K(theta) over its mean and e(theta) over half the backlash; they may contain parameters.
    parameters : mapping
        Those of :func:`gear_parameters` and any further ones.
    load : SX, optional
        What stands for T in (23), the parameter ``torque`` when absent.
    """
    d = dimensionless
    names = ("lambda", *COORDINATES)
    position = {n: ca.SX.sym(n) for n in names}
    velocity = {f"d{n}": ca.SX.sym(f"d{n}") for n in names}
    ratio, torque, xi = (parameters[n][0] for n in ("frequency_ratio", "torque", "mesh_damping_ratio"))
    lam, dlam = position["lambda"], velocity["dlambda"]
    slopes = (d.coast_stiffness_ratio, 0.0, 1.0)
    mesh = Contact(argument=lam - error, breakpoints=(-1.0, 1.0), slopes=slopes, name="mesh")  # (20)
    damping = xi * (dlam if 2 in reading else dlam - ratio * ca.jacobian(error, theta))
    force = stiffness * mesh.force + 2 * damping  # (12)

    a3, acceleration, bearings = d.tangential_cosine, {}, {}
    total = a3 * (torque if load is None else load) - a3**2 * force
    for i, name in enumerate(COORDINATES):
        bearing = bearing_term(d, i, position[name], velocity[f"d{name}"])
        bearings[f"bearing_{name}"] = bearing / d.mass_ratios[i]
        share = force - damping if name == "z_g" and 12 in reading else force  # (25)
        acceleration[f"d{name}"] = -d.directions[i] * d.mass_ratios[i] * share - bearing  # (24)-(29)
        total += d.directions[i] * acceleration[f"d{name}"]
    label = d.name if d.state == ONLY_STATE else f"{d.name}, {d.state}"
    return System(
        name=label if reading == CONSISTENT else f"{label}, reading {reading_name(reading)}",
        states={**position, **velocity},
        derivatives={**{n: velocity[f"d{n}"] for n in names}, "dlambda": total, **acceleration},  # (23)
        phase=theta,
        frequency="frequency_ratio",
        parameters=parameters,
        contacts=[mesh],
        outputs={"mesh_force": force, "deflection": lam - error, **bearings},
    )


def static_state(dimensionless: Dimensionless) -> np.ndarray:
    """Return the state at rest under the mean mesh force T / a3 with mean stiffness and no transmission error.

    Returns
    -------
    numpy.ndarray, shape (14,)
        In the order of :func:`gear_system`; an equilibrium when the stiffness and error harmonics are zero.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> static_state(load_pair("example").dimensionless())[:2].round(4).tolist()
    [1.1818, 0.0169]
    """
    d = dimensionless
    s, mu, k = (np.array(v) for v in (d.directions, d.mass_ratios, d.bearing_stiffness))
    return np.concatenate([[1 + d.mean_force], -s * mu * d.mean_force / k, np.zeros(7)])


def bearing_term(dimensionless: Dimensionless, i: int, position: Any, velocity: Any) -> Any:
    """Return ``2 C_i q_i' + K_i q_i`` of (24)-(29), the force on the bearings of displacement i over m_i omega_n^2 b.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> bearing_term(load_pair("example").dimensionless(), 0, 1.5, 0.0)
    3.0
    """
    return 2 * dimensionless.bearing_damping[i] * velocity + dimensionless.bearing_stiffness[i] * position


def harmonic_sum(cosine: tuple[float, ...], sine: tuple[float, ...], theta: ca.SX) -> ca.SX:
    """Return ``sum_j c_j cos(j theta) + s_j sin(j theta)`` as an expression; harmonics that are zero leave no term.

    Examples
    --------
    >>> harmonic_sum((0.0, 0.3), (0.0, 0.0), ca.SX.sym("theta"))
    SX((0.3*cos((2.*theta))))
    """
    total = ca.SX(0)
    for j, (c, s) in enumerate(zip(cosine, sine, strict=True), start=1):
        if c:
            total += c * ca.cos(j * theta)
        if s:
            total += s * ca.sin(j * theta)
    return total
