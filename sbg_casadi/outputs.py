"""What a designer wants of an orbit beyond lambda: mesh and bearing forces, separation, accelerations, with units."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import xarray as xr

from continuation import Orbit
from continuation.errors import nearest
from sbg_casadi.dimensionless import COORDINATES, Dimensionless
from sbg_casadi.equations import EIGHT, transmission_error, virtual_work
from sbg_casadi.errors import UserError
from sbg_casadi.model import gear_system
from sbg_casadi.pair import Pair
from sbg_casadi.physical import Physical
from sbg_casadi.reading import CONSISTENT, Reading, as_read

SAMPLES = 2048
"""Phases per excitation period."""

_LEAST = 16

_NAMES = {
    "lambda": "dynamic transmission error",
    "deflection": "lambda - e",
    "mesh_force": "normal mesh force",
    "displacement": "displacement at the bearings",
    "bearing_force": "force of the shaft on the bearings of this direction, all ends together",
    "acceleration": "acceleration of pinion and gear",
    "lambda_acceleration": "second derivative of lambda",
    "mean_mesh_force": "mean normal mesh force",
    "dynamic_factor": "largest over mean mesh force",
    "separation": "part of the period without tooth contact",
    "back_contact": "part of the period with contact on the back flank",
}
_SCALES = dict.fromkeys(("lambda", "deflection", "displacement"), "b")
_SCALES |= dict.fromkeys(("mesh_force", "bearing_force", "mean_mesh_force"), "k_0 b")
_SCALES |= dict.fromkeys(("acceleration", "lambda_acceleration"), "b omega_n^2")
_UNITS = {"b": "m", "k_0 b": "N", "b omega_n^2": "m/s^2"}


def dimensionless_outputs(
    orbit: Orbit, dimensionless: Dimensionless, reading: Reading = CONSISTENT, *, samples: int = SAMPLES
) -> xr.Dataset:
    """Evaluate mesh force, separation, bearing forces and accelerations pointwise on an orbit.

    Nothing is taken from truncated harmonics of the force: its slope jumps at contact changes, so that its series
    converges slowly. The mesh damping of (12) acts without contact as well, so the force there is not exactly zero and
    can pull.

    Parameters
    ----------
    orbit : Orbit
        Periodic orbit of :func:`~sbg_casadi.model.gear_system`, at the parameters it carries.
    dimensionless : Dimensionless
        The numbers the orbit was computed with.
    reading : frozenset of int
        The reading it was computed with.
    samples : int
        Equidistant phases per excitation period, at least 16.

    Returns
    -------
    xarray.Dataset
        Over ``phase`` (rad, one period of the orbit without its end) and ``coordinate`` (x_p, ..., z_g). Every variable
        carries ``units`` (1), ``long_name`` and, where it has one, ``scale``, the quantity it is divided by.

    Raises
    ------
    UserError
        If the orbit has other states than the gear model, or there are too few samples.

    Examples
    --------
    >>> from continuation import HarmonicBalance
    >>> from sbg_casadi import gear_system, load_pair
    >>> d = load_pair("iso-f2").dimensionless("after")
    >>> problem = HarmonicBalance().discretise(gear_system(d), parameter="frequency_ratio")
    >>> result = dimensionless_outputs(problem.solve(problem.guess(frequency_ratio=2.0), 2.0), d)
    >>> round(float(result.mean_mesh_force / d.mean_force), 6), float(result.separation), result.mesh_force.scale
    (1.0, 0.0, 'k_0 b')
    """
    system = gear_system(dimensionless, reading)
    if tuple(orbit.state_names) != system.state_names:
        raise UserError(f"orbit of {orbit.system!r} has states {', '.join(orbit.state_names)}; expected a gear orbit")
    if not samples >= _LEAST:
        raise UserError(f"samples = {samples}; expected at least {_LEAST} phases per excitation period")
    count = samples * orbit.period_multiple
    phase = 2 * np.pi * np.arange(count) / samples
    x = orbit.evaluate(phase).T
    outputs = ca.substitute(system.outputs, system.phi, system.forces()) if system.contacts else system.outputs
    f = ca.Function("f", [system.x, system.theta, system.p], [system.closed(), outputs])
    rate, (force, deflection, *bearing) = (v.full() for v in f(x, phase[None], _parameters(system, orbit)))
    below, back = below_level(deflection, 1.0), below_level(deflection, -1.0)
    values: dict[str, Any] = {
        "lambda": x[0],
        "deflection": deflection,
        "mesh_force": force,
        "displacement": x[1:7],
        "bearing_force": np.array(bearing),
        "acceleration": rate[8:],
        "lambda_acceleration": rate[7],
        "mean_mesh_force": force.mean(),
        "dynamic_factor": force.max() / force.mean(),
        "separation": below - back,
        "back_contact": back,
    }
    result = xr.Dataset({name: _variable(name, value) for name, value in values.items()})
    result = result.assign_coords(phase=("phase", phase, {"units": "rad"}), coordinate=list(COORDINATES))
    result.coordinate.attrs["units"] = "1"
    return result


def si_outputs(
    orbit: Orbit, pair: Pair, state: str | None = None, reading: Reading = CONSISTENT, *, samples: int = SAMPLES
) -> xr.Dataset:
    """Return :func:`dimensionless_outputs` in SI units, with the angular accelerations of pinion and gear.

    Parameters
    ----------
    orbit : Orbit
        Periodic orbit of the pair in this state and reading.
    pair : Pair
        Physical pair; a dimensionless one raises UserError.
    state : str or None
        State of the pair, the first one when None.
    reading : frozenset of int
        The reading the orbit was computed with.
    samples : int
        Equidistant phases per excitation period.

    Returns
    -------
    xarray.Dataset
        The same variables in m, N and m/s^2, ``pinion_angular_acceleration`` and ``gear_angular_acceleration`` in
        rad/s^2 by (7) and (8), and ``time`` in s along ``phase``. Every variable carries ``units`` and ``long_name``.

    Examples
    --------
    >>> from continuation import HarmonicBalance
    >>> from sbg_casadi import gear_system, load_pair
    >>> pair = load_pair("iso-f2")
    >>> problem = HarmonicBalance().discretise(gear_system(pair.dimensionless("after")), parameter="frequency_ratio")
    >>> result = si_outputs(problem.solve(problem.guess(frequency_ratio=2.0), 2.0), pair, "after")
    >>> round(float(result.mean_mesh_force), 1), result.mean_mesh_force.units
    (14193.3, 'N')
    """
    si = Physical.of(pair, state)
    b, omega_n, k_0 = si.half_backlash, si.natural_frequency, si.mesh_stiffness
    factors = {"b": b, "k_0 b": k_0 * b, "b omega_n^2": b * omega_n**2}
    bare = dimensionless_outputs(orbit, as_read(pair, state, reading), reading, samples=samples)
    result = bare.copy()
    for name, variable in bare.items():
        if name in _SCALES:
            attributes = {"units": _UNITS[_SCALES[name]], "long_name": _NAMES[name]}
            result[name] = (variable.dims, variable.values * factors[_SCALES[name]], attributes)
    tangential = orbit.parameters["torque"] * k_0 * b
    angular = _angular_accelerations(si, result["mesh_force"].values, tangential)
    for member, values in zip(("pinion", "gear"), angular, strict=True):
        name = f"angular acceleration of the {member}"
        result[f"{member}_angular_acceleration"] = ("phase", values, {"units": "rad/s^2", "long_name": name})
    time = bare.phase.values / (orbit.parameters["frequency_ratio"] * omega_n)
    return result.assign_coords(time=("phase", time, {"units": "s", "long_name": "time"}))


def below_level(values: np.ndarray, level: float) -> float:
    """Return the part of a period in which a periodic signal is below a level, linear between its samples.

    Parameters
    ----------
    values : ndarray (N,)
        Equidistant samples of one period without its end.
    level : float
        In the unit of the samples.

    Examples
    --------
    >>> below_level(np.array([0.0, 1.0, 2.0, 1.0]), 0.5)
    0.25
    """
    ends = np.array([values, np.roll(values, -1)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    flat = high == low
    part = np.where(flat, low < level, (level - low) / np.where(flat, 1.0, high - low))
    return float(np.clip(part, 0.0, 1.0).mean())


def _parameters(system: Any, orbit: Orbit) -> np.ndarray:
    unknown = [name for name in orbit.parameters if name not in system.parameter_names]
    if unknown:
        raise UserError(f"orbit has parameter {unknown[0]!r}; {nearest(unknown[0], system.parameter_names)}")
    return system.parameter_vector(orbit.parameters)


def _angular_accelerations(si: Physical, force: np.ndarray, tangential: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the second derivatives of phi_p and theta_g, (7) and (8), rad/s^2."""
    q = {name: ca.SX.sym(name) for name in EIGHT}
    symbol = ca.SX.sym("F_n")
    lam = transmission_error(q, si.cosines, si.pinion_radius, si.gear_radius)
    work = virtual_work(q, lam, symbol, ca.SX(tangential * si.pinion_radius), ca.SX(tangential * si.gear_radius))
    f = ca.Function("f", [symbol], [work["phi_p"] / si.pinion_inertia, work["theta_g"] / si.gear_inertia])
    pinion, gear = f(force[None])
    return pinion.full().ravel(), gear.full().ravel()


def _variable(name: str, value: Any) -> tuple[tuple[str, ...], Any, dict[str, str]]:
    attributes = {"units": "1", "long_name": _NAMES[name]}
    if name in _SCALES:
        attributes["scale"] = _SCALES[name]
    return ((), ("phase",), ("coordinate", "phase"))[np.ndim(value)], value, attributes
