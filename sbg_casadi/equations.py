"""Equations (1)-(8) from the virtual work of one scalar, lambda of (14), and (19)-(29) derived from them by code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from continuation import Contact, System
from sbg_casadi.dimensionless import COORDINATES
from sbg_casadi.model import harmonic_sum
from sbg_casadi.physical import Physical

EIGHT = (*COORDINATES, "phi_p", "theta_g")
"""The six displacements and the rotations of pinion and gear, the coordinates of (1)-(8)."""


def transmission_error(q: Mapping[str, Any], cosines: Any, pinion_radius: Any, gear_radius: Any) -> Any:
    """Return lambda of equation (14), the approach of the tooth flanks along the normal.

    Parameters
    ----------
    q : mapping of str to symbol or number
        Values of the coordinates :data:`EIGHT`, m and rad.
    cosines : three symbols or numbers
        a1, a2, a3.
    pinion_radius, gear_radius : symbol or number
        Mean pitch radii, m.

    Examples
    --------
    >>> transmission_error(dict.fromkeys(EIGHT, 0.0) | {"z_p": 2.0}, (0.5, 0.0, 0.75), 0.03, 0.08)
    1.5
    """
    a1, a2, a3 = cosines
    rotation = pinion_radius * q["phi_p"] - gear_radius * q["theta_g"]
    return (-q["x_p"] + q["x_g"]) * a1 + (q["y_p"] - q["y_g"]) * a2 + (q["z_p"] - q["z_g"] + rotation) * a3


def virtual_work(
    q: Mapping[str, ca.SX], lam: ca.SX, force: ca.SX, pinion_torque: ca.SX, gear_torque: ca.SX
) -> dict[str, ca.SX]:
    """Return the forces on the coordinates, N and N m: ``-F_n d(lambda)/dq``, with T_m on phi_p and -T_l on theta_g.

    These are the right-hand sides of (1)-(8).

    Parameters
    ----------
    q : mapping of str to symbol
        The coordinates :data:`EIGHT`.
    lam : expression
        lambda of :func:`transmission_error` in these coordinates.
    force : expression
        F_n, N.
    pinion_torque, gear_torque : expression
        T_m and T_l, N m.

    Examples
    --------
    >>> q = {name: ca.SX.sym(name) for name in EIGHT}
    >>> F_n, T_m, T_l, a1, a2, a3, r_p, r_g = (ca.SX.sym(n) for n in "F_n T_m T_l a1 a2 a3 r_p r_g".split())
    >>> virtual_work(q, transmission_error(q, (a1, a2, a3), r_p, r_g), F_n, T_m, T_l)["phi_p"]
    SX((T_m-(F_n*(r_p*a3))))
    """
    gradient = dict(zip(q, ca.vertsplit(ca.gradient(lam, ca.vertcat(*q.values()))), strict=True))
    work = {name: -force * slope for name, slope in gradient.items()}
    work["phi_p"] += pinion_torque
    work["theta_g"] -= gear_torque
    return work


def accelerations(
    work: Mapping[str, Any],
    q: Mapping[str, Any],
    rate: Mapping[str, Any],
    masses: Any,
    inertias: Any,
    bearing_stiffness: Any,
    bearing_damping: Any,
) -> dict[str, Any]:
    """Return the second derivatives of the coordinates, m/s^2 and rad/s^2: the left-hand sides of (1)-(8) solved.

    Parameters
    ----------
    work, q, rate : mapping of str to expression
        Forces of :func:`virtual_work`, coordinates and their derivatives.
    masses, bearing_stiffness, bearing_damping : six expressions or numbers
        For each displacement, kg, N/m and N s/m.
    inertias : two expressions or numbers
        I_p and I_g, kg m^2.
    """
    result = {
        name: (work[name] - c * rate[name] - k * q[name]) / m
        for name, m, k, c in zip(COORDINATES, masses, bearing_stiffness, bearing_damping, strict=True)
    }
    return result | {n: work[n] / i for n, i in zip(("phi_p", "theta_g"), inertias, strict=True)}


def eight_coordinate_system(physical: Physical) -> System:
    """Build equations (1)-(8) with (12) and (14)-(17), in SI units and time in seconds.

    The rotations are measured from the uniform rotation at the speed of the mesh frequency. The form has a free rigid
    rotation, so it is for integration in time; periodic orbits need the relative coordinate of
    :func:`relative_system` or :func:`~sbg_casadi.model.gear_system`.

    Returns
    -------
    System
        16 states: the coordinates :data:`EIGHT` (m, rad) and their derivatives ``dx_p, ...``; parameters
        ``mesh_frequency`` (omega_m, rad/s, default omega_n), ``tangential_force`` (T_m / r_p = T_l / r_g, N) and
        ``mesh_damping`` (C_m, N s/m); outputs ``lambda`` (m) and ``mesh_force`` (F_n, N); one Contact.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> eight_coordinate_system(Physical.of(load_pair("iso-f2"), "before"))
    System('iso-f2, before, eight coordinates': 16 states, 3 parameters, phase theta with frequency mesh_frequency, \
1 contact)
    """
    p = physical
    q = {n: ca.SX.sym(n) for n in EIGHT}
    rate = {n: ca.SX.sym(f"d{n}") for n in EIGHT}
    theta, omega, tangential, damping = (
        ca.SX.sym(n) for n in ("theta", "mesh_frequency", "tangential_force", "mesh_damping")
    )
    lam = transmission_error(q, p.cosines, p.pinion_radius, p.gear_radius)
    dlam = ca.jtimes(lam, ca.vertcat(*q.values()), ca.vertcat(*rate.values()))
    mesh, force = _mesh_force(p, lam, dlam, theta, omega, damping)
    work = virtual_work(q, lam, force, tangential * p.pinion_radius, tangential * p.gear_radius)
    second = accelerations(
        work, q, rate, p.masses, (p.pinion_inertia, p.gear_inertia), p.bearing_stiffness, p.bearing_damping
    )
    return System(
        name=f"{p.name}, {p.state}, eight coordinates",
        states={**q, **{f"d{n}": rate[n] for n in EIGHT}},
        derivatives={**rate, **{f"d{n}": second[n] for n in EIGHT}},
        phase=theta,
        frequency="mesh_frequency",
        parameters={
            "mesh_frequency": (omega, p.natural_frequency),
            "tangential_force": (tangential, p.pinion_torque / p.pinion_radius),
            "mesh_damping": (damping, p.mesh_damping),
        },
        contacts=[mesh],
        outputs={"lambda": lam, "mesh_force": force},
    )


def relative_system(physical: Physical) -> System:
    """Derive the seven-coordinate dimensionless equations (23)-(29) from (1)-(8) by substitution.

    Lengths become b times a dimensionless one and time becomes tau = omega_n t (18), (22); lambda'' is the gradient of
    (14) times the eight accelerations, in which the mesh force is a function of lambda and lambda' alone, so that the
    two rotations drop out. The result equals :func:`~sbg_casadi.model.gear_system` of ``physical.dimensionless()``.

    Returns
    -------
    System
        14 states ``lambda, x_p, ..., z_g`` and their derivatives, parameter ``frequency_ratio``, output
        ``mesh_force`` (F_n / (k_0 b)), one Contact.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> relative_system(Physical.of(load_pair("iso-f2"), "before")).state_names[:3]
    ('lambda', 'x_p', 'y_p')
    """
    p, b, omega_n = physical, physical.half_backlash, physical.natural_frequency
    names = ("lambda", *COORDINATES)
    bar, dbar = ({n: ca.SX.sym(f"{d}{n}") for n in names} for d in ("", "d"))
    theta, ratio = ca.SX.sym("theta"), ca.SX.sym("frequency_ratio")
    q = {n: ca.SX.sym(n) for n in EIGHT}
    lam = transmission_error(q, p.cosines, p.pinion_radius, p.gear_radius)
    gradient = ca.gradient(lam, ca.vertcat(*q.values()))  # constant: (14) is linear
    mesh, force = _mesh_force(
        p, b * bar["lambda"], b * omega_n * dbar["lambda"], theta, ratio * omega_n, ca.SX(p.mesh_damping)
    )
    work = virtual_work(q, lam, force, ca.SX(p.pinion_torque), ca.SX(p.gear_torque))
    position, rate = ({n: s * v[n] for n in COORDINATES} for s, v in ((b, bar), (b * omega_n, dbar)))
    second = accelerations(
        work, position, rate, p.masses, (p.pinion_inertia, p.gear_inertia), p.bearing_stiffness, p.bearing_damping
    )
    unit = b * omega_n**2
    derivatives = {n: dbar[n] for n in names} | {f"d{n}": second[n] / unit for n in COORDINATES}
    derivatives["dlambda"] = ca.dot(gradient, ca.vertcat(*(second[n] for n in EIGHT))) / unit
    return System(
        name=f"{p.name}, {p.state}, seven coordinates",
        states={**bar, **{f"d{n}": dbar[n] for n in names}},
        derivatives=derivatives,
        phase=theta,
        frequency="frequency_ratio",
        parameters={"frequency_ratio": (ratio, 1.0)},
        contacts=[mesh],
        outputs={"mesh_force": force / (p.mesh_stiffness * b)},
    )


def relative_state(physical: Physical, eight: Any) -> np.ndarray:
    """Return dimensionless seven-coordinate states from SI ones, equations (18) and (19).

    Parameters
    ----------
    physical : Physical
    eight : array_like, shape (..., 16)
        In the order of :func:`eight_coordinate_system`.

    Returns
    -------
    numpy.ndarray, shape (..., 14)
        In the order of :func:`~sbg_casadi.model.gear_system`.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> si = Physical.of(load_pair("iso-f2"))
    >>> relative_state(si, np.full((3, 16), 1e-5)).shape
    (3, 14)
    """
    p, x = physical, np.asarray(eight, dtype=float)
    parts = []
    for columns, unit in ((x[..., :8], p.half_backlash), (x[..., 8:], p.half_backlash * p.natural_frequency)):
        q = {n: columns[..., i] for i, n in enumerate(EIGHT)}
        lam = transmission_error(q, p.cosines, p.pinion_radius, p.gear_radius)
        parts += [lam[..., None] / unit, columns[..., :6] / unit]
    return np.concatenate(parts, axis=-1)


def _mesh_force(
    p: Physical, lam: ca.SX, dlam: ca.SX, theta: ca.SX, omega: ca.SX, damping: ca.SX
) -> tuple[Contact, ca.SX]:
    """Return the backlash law (15) and F_n of (12) in N, damping on the rate of lambda - e."""
    k = p.mesh_stiffness + harmonic_sum(p.stiffness_cosine, p.stiffness_sine, theta)  # (17)
    e = harmonic_sum(p.error_cosine, p.error_sine, theta)  # (16)
    b = p.half_backlash
    mesh = Contact(argument=lam - e, breakpoints=(-b, b), slopes=(p.coast_stiffness_ratio, 0.0, 1.0), name="mesh")
    return mesh, k * mesh.force + damping * (dlam - omega * ca.jacobian(e, theta))
