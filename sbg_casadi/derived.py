"""Quantities that follow from the geometry, inertia and load of a pair, all in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

STEEL_DENSITY = 7860.0  # kg/m^3
MESH_STIFFNESS_PER_FACE_WIDTH = 20e9  # N/m per m of face width: c_gamma = 20 N/(mm um), ISO 10300-1 method B

BacklashPlane = Literal["outer-normal", "mean-normal", "outer-transverse", "mean-transverse"]


@dataclass(frozen=True, slots=True)
class Derived:
    """Hold what follows from a physical pair; SI units throughout, angles in radians.

    Attributes
    ----------
    pitch_angle : float
        Pitch cone angle of the pinion delta_1, rad.
    outer_cone_distance, mean_cone_distance, face_width : float
        R_e, R_m and the face width, m.
    pinion_mean_radius, gear_mean_radius : float
        Mean pitch radii r_m1 and r_m2, m; they multiply a3 in equation (14).
    pinion_mass, gear_mass, pinion_inertia, gear_inertia : float
        Totals with what is added, kg and kg m^2.
    a1, a2, a3 : float
        Direction cosines of the mesh force.
    equivalent_mass : float
        m_eq, kg, equation (18).
    mesh_stiffness : float
        k_0, N/m.
    natural_frequency : float
        omega_n = sqrt(k_0 / m_eq), rad/s, equation (18).
    half_backlash : float
        b, half the normal backlash at the mean cone distance, m.
    pinion_torque, gear_torque : float
        Balanced torques, N m.
    tangential_force : float
        F_mt = torque / mean pitch radius, N.
    normal_force : float
        F_n = F_mt / a3, N.
    torque : float
        Dimensionless T = F_mt / (k_0 b), equation (22).
    mean_load : float
        Mean mesh force T / a3 = F_n / (k_0 b).
    unit_ratio_rpm : float
        Pinion speed at frequency ratio 1, rev/min: the mesh frequency is the pinion speed times its teeth.
    rated_ratio : float or None
        Frequency ratio at the rated speed, None when the file gives no speed.
    """

    pitch_angle: float
    outer_cone_distance: float
    mean_cone_distance: float
    face_width: float
    pinion_mean_radius: float
    gear_mean_radius: float
    pinion_mass: float
    gear_mass: float
    pinion_inertia: float
    gear_inertia: float
    a1: float
    a2: float
    a3: float
    equivalent_mass: float
    mesh_stiffness: float
    natural_frequency: float
    half_backlash: float
    pinion_torque: float
    gear_torque: float
    tangential_force: float
    normal_force: float
    torque: float
    mean_load: float
    unit_ratio_rpm: float
    rated_ratio: float | None

    def pinion_rpm(self, frequency_ratio: float) -> float:
        """Return the pinion speed in rev/min at a frequency ratio omega_m / omega_n."""
        return frequency_ratio * self.unit_ratio_rpm


def pitch_cone_angle(pinion_teeth: int, gear_teeth: int) -> float:
    """Return delta_1 in radians for a shaft angle of 90 degrees: tan(delta_1) = z1 / z2.

    Examples
    --------
    >>> round(math.degrees(pitch_cone_angle(14, 39)), 3)
    19.747
    """
    return math.atan2(pinion_teeth, gear_teeth)


def outer_cone_distance(module: float, pinion_teeth: int, gear_teeth: int) -> float:
    """Return R_e = d_e2 / (2 sin delta_2) in m from the outer transverse module in m, shaft angle 90 degrees.

    Examples
    --------
    >>> round(outer_cone_distance(3.105e-3, 14, 41) * 1e3, 2)
    67.26
    """
    return module * math.hypot(pinion_teeth, gear_teeth) / 2


def outer_base_radius(module: float, teeth: int, pressure_angle: float) -> float:
    """Return m z cos(alpha) / 2 in m at the outer end, from m and rad: the radius of the paper's Tables 2 to 5.

    The equations use the mean pitch radius instead: with a base radius cos(alpha) of a3 would count twice.

    Examples
    --------
    >>> round(outer_base_radius(3.105e-3, 41, math.radians(20)) * 1e3, 2)
    59.81
    """
    return module * teeth * math.cos(pressure_angle) / 2


def default_face_width(cone_distance: float) -> float:
    """Return the face width 0.3 R_e in m, the usual upper limit for spiral bevel gears (ISO 23509).

    Examples
    --------
    >>> round(default_face_width(0.06726), 4)
    0.0202
    """
    return 0.3 * cone_distance


def default_mesh_stiffness(face_width: float) -> float:
    """Return k_0 in N/m from the face width in m: c_gamma = 20 N/(mm um) of ISO 10300-1 method B.

    Examples
    --------
    >>> round(default_mesh_stiffness(0.0254) / 1e8, 3)
    5.08
    """
    return MESH_STIFFNESS_PER_FACE_WIDTH * face_width


def frustum_mass(outer_radius: float, cone_angle: float, face_width: float, cone_distance: float) -> float:
    """Return the mass in kg of a solid steel frustum bounded by the pitch cone over the face width.

    Parameters
    ----------
    outer_radius : float
        Outer pitch radius, m.
    cone_angle : float
        Pitch cone angle of this member, rad.
    face_width, cone_distance : float
        Face width and outer cone distance, m; the inner radius is the outer one times 1 - b / R_e.

    Examples
    --------
    >>> round(frustum_mass(0.021735, pitch_cone_angle(14, 41), 0.020178, 0.06726), 3)
    0.163
    """
    inner = outer_radius * (1 - face_width / cone_distance)
    height = face_width * math.cos(cone_angle)
    return STEEL_DENSITY * math.pi * height / 3 * (outer_radius**2 + outer_radius * inner + inner**2)


def frustum_inertia(mass: float, outer_radius: float, face_width: float, cone_distance: float) -> float:
    """Return the inertia in kg m^2 of that frustum about its axis: 3 m (R^5 - r^5) / (10 (R^3 - r^3)).

    Examples
    --------
    >>> round(frustum_inertia(0.1626, 0.021735, 0.020178, 0.06726) * 1e5, 2)
    2.92
    """
    ratio = 1 - face_width / cone_distance
    return 0.3 * mass * outer_radius**2 * (1 - ratio**5) / (1 - ratio**3)


def direction_cosines(
    pressure_angle: float, spiral_angle: float, pitch_angle: float, side: int, *, printed: bool = False
) -> tuple[float, float, float]:
    """Return a1, a2, a3 of equations (9)-(11), by default in the reading whose squares sum to 1.

    Equation (9) is printed with sin(alpha) sin(beta) cos(delta) and (10) with a plus; the force of the mesh on the
    pinion has the components below, with ``side`` +1 or -1 for the hand of spiral and the driving flank.

    Parameters
    ----------
    pressure_angle, spiral_angle, pitch_angle : float
        Normal pressure angle alpha, mean spiral angle beta and pinion pitch cone angle delta, rad.
    side : int
        +1 or -1.
    printed : bool
        Take (9) and (10) as they are printed, which leaves out ``side``; the squares no longer sum to 1.

    Examples
    --------
    >>> angles = math.radians(20), math.radians(35), pitch_cone_angle(14, 39)
    >>> [round(v, 4) for v in direction_cosines(*angles, 1)]
    [0.6228, 0.1398, 0.7698]
    >>> [round(v, 4) for v in direction_cosines(*angles, 1, printed=True)]
    [0.3002, 0.504, 0.7698]
    """
    sa, ca = math.sin(pressure_angle), math.cos(pressure_angle)
    sd, cd = math.sin(pitch_angle), math.cos(pitch_angle)
    if printed:
        sb = math.sin(spiral_angle)
        return sa * sd + sa * sb * cd, sa * cd + ca * sb * sd, ca * math.cos(spiral_angle)
    lead = side * ca * math.sin(spiral_angle)
    return sa * sd + lead * cd, sa * cd - lead * sd, ca * math.cos(spiral_angle)


def mean_normal_backlash(
    backlash: float, plane: BacklashPlane, mean_over_outer: float, tangential_cosine: float
) -> float:
    """Return the full normal backlash in m at the mean cone distance.

    The gap is a rotation of the gear, so its arc shrinks with the radius by R_m / R_e; across the teeth at one
    radius the normal gap is the arc times a3 = cos(alpha) cos(beta). The mean spiral angle is used at both places.

    Parameters
    ----------
    backlash : float
        Full gap in the named plane, m.
    plane : {"outer-normal", "mean-normal", "outer-transverse", "mean-transverse"}
        Where it is measured.
    mean_over_outer : float
        R_m / R_e.
    tangential_cosine : float
        a3.

    Examples
    --------
    >>> round(mean_normal_backlash(0.127e-3, "outer-normal", 81.273 / 93.973, 0.7698) * 1e3, 4)
    0.1098
    """
    place, direction = plane.split("-")
    gap = backlash * (mean_over_outer if place == "outer" else 1.0)
    return gap * (tangential_cosine if direction == "transverse" else 1.0)


def equivalent_mass(pinion_radius: float, pinion_inertia: float, gear_radius: float, gear_inertia: float) -> float:
    """Return m_eq = 1 / (r_p^2 / I_p + r_g^2 / I_g) in kg, equation (18), from m and kg m^2.

    Examples
    --------
    >>> equivalent_mass(1.0, 2.0, 2.0, 8.0)
    1.0
    """
    return 1.0 / (pinion_radius**2 / pinion_inertia + gear_radius**2 / gear_inertia)
