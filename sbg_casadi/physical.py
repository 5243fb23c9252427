"""The numbers of the eight-coordinate equations (1)-(8) in SI units, and their scaling (13), (18), (22)."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from sbg_casadi.derived import equivalent_mass
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.errors import UserError

if TYPE_CHECKING:  # a pair is built with the scaling below
    from sbg_casadi.pair import Pair

_BALANCE = 1e-9  # relative difference of T_m / r_p and T_l / r_g that counts as rounding


def natural_frequency(mesh_stiffness: float, mass: float) -> float:
    """Return omega_n = sqrt(k_0 / m_eq) in rad/s, equation (18), from N/m and kg.

    Examples
    --------
    >>> natural_frequency(400.0, 4.0)
    10.0
    """
    return math.sqrt(mesh_stiffness / mass)


def barred_stiffness(stiffness: float, mass: float, omega_n: float) -> float:
    """Return K_i = K / (m omega_n^2), equation (13), from N/m, kg and rad/s; K adds up the ends of the shaft.

    Examples
    --------
    >>> barred_stiffness(600.0, 3.0, 10.0)
    2.0
    """
    return stiffness / (mass * omega_n**2)


def barred_damping(damping: float, mass: float, omega_n: float) -> float:
    """Return C / (2 m omega_n), equations (13) and (22), from N s/m, kg and rad/s.

    With the mass of a member this is C_i of its bearings, or C_p and C_g of the mesh; with m_eq it is xi.

    Examples
    --------
    >>> barred_damping(6.0, 3.0, 10.0)
    0.1
    """
    return damping / (2 * mass * omega_n)


def dimensionless_torque(torque: float, radius: float, mesh_stiffness: float, b: float) -> float:
    """Return T = T_m / (r_p b m_eq omega_n^2) = T_m / (r_p b k_0), equation (22), from N m, m, N/m and m.

    Balanced torques give the same T with the torque on the gear and the mean radius of the gear.

    Examples
    --------
    >>> round(dimensionless_torque(300.0, 0.03, 5e8, 1e-4), 12)
    0.2
    """
    return torque / radius / (mesh_stiffness * b)


@dataclass(frozen=True, slots=True)
class Physical:
    """Hold the numbers of equations (1)-(8) for one pair in one state; SI units.

    Parameters
    ----------
    name, state : str
        Names of the pair and of the state.
    cosines : tuple of float, length 3
        a1, a2, a3 of equations (9)-(11).
    pinion_radius, gear_radius : float
        Mean pitch radii r_p and r_g, m.
    pinion_mass, gear_mass : float
        m_p and m_g, kg.
    pinion_inertia, gear_inertia : float
        I_p about x and I_g about y, kg m^2.
    bearing_stiffness, bearing_damping : tuple of float, length 6
        Sums over the shaft ends, N/m and N s/m, in the order x_p, y_p, z_p, x_g, y_g, z_g.
    mesh_stiffness : float
        k_0, N/m.
    mesh_damping : float
        C_m, N s/m.
    half_backlash : float
        b, m.
    pinion_torque, gear_torque : float
        T_m and T_l, N m; they balance, ``T_m / r_p = T_l / r_g``.
    stiffness_cosine, stiffness_sine : tuple of float, equal lengths
        a_j and b_j of equation (17), N/m.
    error_cosine, error_sine : tuple of float, equal lengths
        Harmonics of e of equation (16), m.
    coast_stiffness_ratio : float
        Mesh stiffness of the coast flank over that of the drive flank; (15) has 1.

    Raises
    ------
    UserError
        If the torques do not balance, a number is not finite, or one that must be positive is not.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> pair = load_pair("iso-f2")
    >>> si = Physical.of(pair, "before")
    >>> round(si.pinion_torque, 6), [f"{k:.3g}" for k in si.bearing_stiffness[:3]]
    (300.0, ['2.1e+08', '6e+08', '6e+08'])
    """

    name: str
    state: str
    cosines: tuple[float, float, float]
    pinion_radius: float
    gear_radius: float
    pinion_mass: float
    gear_mass: float
    pinion_inertia: float
    gear_inertia: float
    bearing_stiffness: tuple[float, ...]
    bearing_damping: tuple[float, ...]
    mesh_stiffness: float
    mesh_damping: float
    half_backlash: float
    pinion_torque: float
    gear_torque: float
    stiffness_cosine: tuple[float, ...] = ()
    stiffness_sine: tuple[float, ...] = ()
    error_cosine: tuple[float, ...] = ()
    error_sine: tuple[float, ...] = ()
    coast_stiffness_ratio: float = 1.0

    def __post_init__(self) -> None:
        place = f"pair {self.name!r}, state {self.state!r}"
        for item in fields(self):
            value = getattr(self, item.name)
            numbers = value if isinstance(value, tuple) else (value,)
            if item.name not in ("name", "state") and not all(math.isfinite(v) for v in numbers):
                raise UserError(f"{place}: {item.name} = {value}; expected finite numbers")
        for key in ("radius", "mass", "inertia"):
            for name in (f"pinion_{key}", f"gear_{key}"):
                if not getattr(self, name) > 0:
                    raise UserError(f"{place}: {name} = {getattr(self, name):g}; expected a positive number")
        for name in ("mesh_stiffness", "half_backlash", "coast_stiffness_ratio"):
            if not getattr(self, name) > 0:
                raise UserError(f"{place}: {name} = {getattr(self, name):g}; expected a positive number")
        driving, braking = self.pinion_torque / self.pinion_radius, self.gear_torque / self.gear_radius
        if abs(driving - braking) > _BALANCE * max(abs(driving), abs(braking)):
            raise UserError(
                f"{place}: pinion_torque {self.pinion_torque:.6g} N m and gear_torque {self.gear_torque:.6g} N m do "
                f"not balance: the speed drifts, so the mesh stiffness K(t) is not periodic; expected gear_torque = "
                f"{driving * self.gear_radius:.6g} N m, equal forces at the mean pitch radii"
            )

    @classmethod
    def of(cls, pair: Pair, state: str | None = None) -> Physical:
        """Return the SI numbers of a physical pair, equations (13), (18) and (22) read backwards; None: first state.

        Raises
        ------
        UserError
            If the file gives plain numbers: masses, radii and lengths are unknown then.
        """
        d, si = pair.dimensionless(state), pair.derived
        if si is None:
            raise UserError(
                f"pair {pair.name!r} is dimensionless, so its masses, radii and backlash are unknown; expected a pair "
                "file with [geometry]"
            )
        masses = (si.pinion_mass,) * 3 + (si.gear_mass,) * 3
        omega_n, b = si.natural_frequency, si.half_backlash
        return cls(
            name=d.name,
            state=d.state,
            cosines=(si.a1, si.a2, si.a3),
            pinion_radius=si.pinion_mean_radius,
            gear_radius=si.gear_mean_radius,
            pinion_mass=si.pinion_mass,
            gear_mass=si.gear_mass,
            pinion_inertia=si.pinion_inertia,
            gear_inertia=si.gear_inertia,
            bearing_stiffness=tuple(k * m * omega_n**2 for k, m in zip(d.bearing_stiffness, masses, strict=True)),
            bearing_damping=tuple(2 * c * m * omega_n for c, m in zip(d.bearing_damping, masses, strict=True)),
            mesh_stiffness=si.mesh_stiffness,
            mesh_damping=2 * d.mesh_damping_ratio * si.equivalent_mass * omega_n,
            half_backlash=b,
            pinion_torque=si.pinion_torque,
            gear_torque=si.gear_torque,
            stiffness_cosine=tuple(a * si.mesh_stiffness for a in d.stiffness_cosine),
            stiffness_sine=tuple(a * si.mesh_stiffness for a in d.stiffness_sine),
            error_cosine=tuple(e * b for e in d.error_cosine),
            error_sine=tuple(e * b for e in d.error_sine),
            coast_stiffness_ratio=d.coast_stiffness_ratio,
        )

    @property
    def masses(self) -> tuple[float, ...]:
        """Mass that moves with each of the six displacements, kg."""
        return (self.pinion_mass,) * 3 + (self.gear_mass,) * 3

    @property
    def equivalent_mass(self) -> float:
        """m_eq of equation (18), kg."""
        return equivalent_mass(self.pinion_radius, self.pinion_inertia, self.gear_radius, self.gear_inertia)

    @property
    def natural_frequency(self) -> float:
        """omega_n of equation (18), rad/s."""
        return natural_frequency(self.mesh_stiffness, self.equivalent_mass)

    def dimensionless(self) -> Dimensionless:
        """Return the numbers of (19)-(29) by equations (13), (18) and (22)."""
        a1, a2, a3 = self.cosines
        k_0, b, m_eq, omega_n = self.mesh_stiffness, self.half_backlash, self.equivalent_mass, self.natural_frequency
        return Dimensionless(
            name=self.name,
            state=self.state,
            torque=dimensionless_torque(self.pinion_torque, self.pinion_radius, k_0, b),
            mesh_damping_ratio=barred_damping(self.mesh_damping, m_eq, omega_n),
            tangential_cosine=a3,
            directions=(-a1, a2, a3, a1, -a2, -a3),
            mass_ratios=tuple(m_eq / m for m in self.masses),
            bearing_stiffness=tuple(
                barred_stiffness(k, m, omega_n) for k, m in zip(self.bearing_stiffness, self.masses, strict=True)
            ),
            bearing_damping=tuple(
                barred_damping(c, m, omega_n) for c, m in zip(self.bearing_damping, self.masses, strict=True)
            ),
            stiffness_cosine=tuple(a / k_0 for a in self.stiffness_cosine),
            stiffness_sine=tuple(a / k_0 for a in self.stiffness_sine),
            error_cosine=tuple(e / b for e in self.error_cosine),
            error_sine=tuple(e / b for e in self.error_sine),
            coast_stiffness_ratio=self.coast_stiffness_ratio,
        )
