"""The seven-coordinate equations (23)-(29) of a spiral bevel gear pair as a symbolic System."""

from __future__ import annotations

import casadi as ca
import numpy as np

from continuation import Contact, System
from sbg_casadi.dimensionless import COORDINATES, ONLY_STATE, Dimensionless


def gear_system(dimensionless: Dimensionless) -> System:
    """Build the equations in time tau = omega_n t, lengths over half the backlash.

    One scalar, the mesh force ``G = K(theta) f(lambda - e) + 2 xi (lambda' - e')``, enters everywhere:

    - ``q_i'' + 2 C_i q_i' + K_i q_i = -s_i mu_i G``, (24)-(29) with the factor 2 that (25) is printed without;
    - ``lambda'' = sum_i s_i q_i'' + a3 T - a3^2 G``, (23) with balanced torques.

    The damping acts on lambda' - e' with ``e' = frequency_ratio de/dtheta``, where (12) is printed with lambda' alone.

    Parameters
    ----------
    dimensionless : Dimensionless
        Numbers of one pair in one state.

    Returns
    -------
    System
        14 states, ``lambda, x_p, y_p, z_p, x_g, y_g, z_g`` and their derivatives ``dlambda, dx_p, ...``; parameters
        ``frequency_ratio`` (omega_m / omega_n, the rate of the phase), ``torque`` (T) and ``mesh_damping_ratio`` (xi);
        outputs ``mesh_force`` (G) and ``deflection`` (lambda - e); one Contact.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> gear_system(load_pair("example").dimensionless())
    System('example': 14 states, 3 parameters, phase theta with frequency frequency_ratio, 1 contact)
    """
    d = dimensionless
    names = ("lambda", *COORDINATES)
    position = {n: ca.SX.sym(n) for n in names}
    velocity = {f"d{n}": ca.SX.sym(f"d{n}") for n in names}
    theta, ratio, torque, xi = (ca.SX.sym(n) for n in ("theta", "frequency_ratio", "torque", "mesh_damping_ratio"))
    lam, dlam = position["lambda"], velocity["dlambda"]
    k = 1 + _series(d.stiffness_cosine, d.stiffness_sine, theta)  # (21)
    e = _series(d.error_cosine, d.error_sine, theta)  # (16)
    mesh = Contact(argument=lam - e, breakpoints=(-1.0, 1.0), slopes=(1.0, 0.0, 1.0), name="mesh")  # (20)
    force = k * mesh.force + 2 * xi * (dlam - ratio * ca.jacobian(e, theta))  # (12)

    a3, acceleration = d.tangential_cosine, {}
    total = a3 * torque - a3**2 * force
    for i, name in enumerate(COORDINATES):
        bearing = 2 * d.bearing_damping[i] * velocity[f"d{name}"] + d.bearing_stiffness[i] * position[name]
        acceleration[f"d{name}"] = -d.directions[i] * d.mass_ratios[i] * force - bearing  # (24)-(29)
        total += d.directions[i] * acceleration[f"d{name}"]
    return System(
        name=d.name if d.state == ONLY_STATE else f"{d.name}, {d.state}",
        states={**position, **velocity},
        derivatives={**{n: velocity[f"d{n}"] for n in names}, "dlambda": total, **acceleration},  # (23)
        phase=theta,
        frequency="frequency_ratio",
        parameters={
            "frequency_ratio": (ratio, 1.0),
            "torque": (torque, d.torque),
            "mesh_damping_ratio": (xi, d.mesh_damping_ratio),
        },
        contacts=[mesh],
        outputs={"mesh_force": force, "deflection": lam - e},
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


def _series(cosine: tuple[float, ...], sine: tuple[float, ...], theta: ca.SX) -> ca.SX:
    total = ca.SX(0)
    for j, (c, s) in enumerate(zip(cosine, sine, strict=True), start=1):
        if c or s:  # harmonics that are zero leave no term behind
            total += c * ca.cos(j * theta) + s * ca.sin(j * theta)
    return total
