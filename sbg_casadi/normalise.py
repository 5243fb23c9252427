"""From the tables of a pair file to :class:`Derived` and :class:`Dimensionless`, equations (9)-(13), (18) and (22)."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

from sbg_casadi import derived as d
from sbg_casadi.derived import Derived
from sbg_casadi.dimensionless import ONLY_STATE, Dimensionless
from sbg_casadi.entries import Entry
from sbg_casadi.errors import PairError
from sbg_casadi.physical import barred_stiffness, dimensionless_torque, natural_frequency
from sbg_casadi.schema import DimensionlessFile, Harmonics, Inertia, PhysicalFile
from sbg_casadi.state_series import StateSeries, check_groups, state_series, table_conversions


def derive(pair: PhysicalFile, folder: Path | None = None) -> Derived:
    """Compute all derived quantities of a physical pair; what its file leaves out gets its default.

    Parameters
    ----------
    pair : PhysicalFile
    folder : Path, optional
        Folder of the pair file. Where [mesh] gives no stiffness and the first state has a table, k_0 is the table's
        mean, equation (17).

    Raises
    ------
    PairError
        If the face width is not smaller than the outer cone distance, or numbers leave the range of floats.
    """
    try:
        result = _derive(pair)
        first = next(iter(pair.states.values()), None)
        if pair.mesh.stiffness is None and first is not None and first.stiffness_table is not None:
            converted = next(iter(table_conversions(pair, result, folder).values()))
            result = _derive(pair, converted.stiffness.mean)
    except (OverflowError, ZeroDivisionError):
        raise PairError("the values are too large or too small to compute with") from None
    for item in fields(result):
        value = getattr(result, item.name)
        zero_allowed = item.name in ("a1", "a2", "rated_ratio")
        if value is not None and not (math.isfinite(value) and (value > 0 or zero_allowed)):
            raise PairError(f"the derived {item.name} is {value}; expected values of a size it can be computed from")
    return result


def _derive(pair: PhysicalFile, measured: float | None = None) -> Derived:
    """Compute without checks; ``measured`` is the mean mesh stiffness in N/m that stands in for the formula's."""
    geometry, load = pair.geometry, pair.load
    z1, z2 = geometry.teeth.value
    module, angle = geometry.module.value, d.pitch_cone_angle(z1, z2)
    outer = d.outer_cone_distance(module, z1, z2)
    width = _value(geometry.face_width, d.default_face_width(outer))
    if not width < outer:
        raise PairError(
            f"geometry.face_width = {width * 1e3:.4g} mm; expected less than the outer cone distance of "
            f"{outer * 1e3:.4g} mm"
        )
    mean = outer - width / 2
    r_p, r_g = (module * z / 2 * mean / outer for z in (z1, z2))
    a1, a2, a3 = d.direction_cosines(
        geometry.pressure_angle.value, geometry.spiral_angle.value, angle, geometry.side.value
    )
    m_p, i_p = _member(pair.inertia, "pinion", module * z1 / 2, angle, width, outer)
    m_g, i_g = _member(pair.inertia, "gear", module * z2 / 2, math.pi / 2 - angle, width, outer)
    m_eq = d.equivalent_mass(r_p, i_p, r_g, i_g)
    k_0 = _value(pair.mesh.stiffness, d.default_mesh_stiffness(width) if measured is None else measured)
    omega_n = natural_frequency(k_0, m_eq)
    b = d.mean_normal_backlash(geometry.backlash.value, geometry.backlash_plane.value, mean / outer, a3) / 2
    loaded = r_p if load.member.value == "pinion" else r_g
    force = load.torque.value / loaded
    rpm = omega_n / z1 * 30 / math.pi  # omega_m = z1 * pinion speed
    return Derived(
        pitch_angle=angle,
        outer_cone_distance=outer,
        mean_cone_distance=mean,
        face_width=width,
        pinion_mean_radius=r_p,
        gear_mean_radius=r_g,
        pinion_mass=m_p,
        gear_mass=m_g,
        pinion_inertia=i_p,
        gear_inertia=i_g,
        a1=a1,
        a2=a2,
        a3=a3,
        equivalent_mass=m_eq,
        mesh_stiffness=k_0,
        natural_frequency=omega_n,
        half_backlash=b,
        pinion_torque=force * r_p,
        gear_torque=force * r_g,
        tangential_force=force,
        normal_force=force / a3,
        torque=dimensionless_torque(load.torque.value, loaded, k_0, b),
        mean_load=force / (a3 * k_0 * b),
        unit_ratio_rpm=rpm,
        rated_ratio=None if load.speed is None else load.speed.value * 30 / math.pi / rpm,
    )


def _value(entry: Entry | None, default: float) -> float:
    return default if entry is None else float(entry.value)


def _member(
    inertia: Inertia, member: str, radius: float, angle: float, width: float, outer: float
) -> tuple[float, float]:
    """Return mass and inertia of a member: given, or of its teeth cone, plus what is added."""
    cone = d.frustum_mass(radius, angle, width, outer)
    # The inertia of an unnamed body follows from the cone, not from a mass given for another shape.
    mass = _value(getattr(inertia, f"{member}_mass"), cone)
    moment = _value(getattr(inertia, f"{member}_inertia"), d.frustum_inertia(cone, radius, width, outer))
    mass += _value(getattr(inertia, f"added_{member}_mass"), 0.0)
    return mass, moment + _value(getattr(inertia, f"added_{member}_inertia"), 0.0)


def physical_series(pair: PhysicalFile, derived: Derived, folder: Path | None = None) -> tuple[StateSeries, ...]:
    """Return the harmonics of every state of a physical pair, in the order of the file."""
    converted = table_conversions(pair, derived, folder)
    return tuple(
        state_series(table, f"states.{state}", conversion=converted.get(state), half_backlash=derived.half_backlash)
        for state, table in pair.states.items()
    )


def physical_states(pair: PhysicalFile, derived: Derived, series: tuple[StateSeries, ...]) -> tuple[Dimensionless, ...]:
    """Return the dimensionless numbers of every state of a physical pair, in the order of the file."""
    bearings = pair.bearings
    given = (bearings.pinion_x, bearings.pinion_y, bearings.pinion_z, bearings.gear_x, bearings.gear_y, bearings.gear_z)
    masses = (derived.pinion_mass,) * 3 + (derived.gear_mass,) * 3
    # (13): the ends of a shaft add up; C_i = zeta sqrt(K_i).
    stiffness = tuple(
        barred_stiffness(sum(entry.value), m, derived.natural_frequency) for entry, m in zip(given, masses, strict=True)
    )
    zeta = bearings.damping_ratio.value
    a1, a2, a3 = derived.a1, derived.a2, derived.a3
    return tuple(
        Dimensionless(
            name=pair.name.value,
            state=state,
            torque=derived.torque,
            mesh_damping_ratio=pair.mesh.damping_ratio.value,
            tangential_cosine=a3,
            directions=(-a1, a2, a3, a1, -a2, -a3),  # (19)
            mass_ratios=tuple(derived.equivalent_mass / m for m in masses),
            bearing_stiffness=stiffness,
            bearing_damping=tuple(zeta * math.sqrt(k) for k in stiffness),
            coast_stiffness_ratio=_value(pair.mesh.coast_stiffness_ratio, 1.0),
            **one.lists,
        )
        for state, one in zip(pair.states, series, strict=True)
    )


def given_series(pair: DimensionlessFile) -> tuple[StateSeries, ...]:
    """Return the harmonics of every state of a dimensionless pair.

    Without ``[states.*]`` there is one, with the harmonics inside ``[dimensionless]``. With them, those harmonics hold
    for every state that does not give its own: stiffness and error are taken over or replaced each as a whole.
    """
    base = pair.dimensionless
    if not pair.states:
        return (state_series(base, "dimensionless"),)
    check_groups(base, "dimensionless")
    return tuple(state_series(table, f"states.{state}", base=base) for state, table in pair.states.items())


def given_states(pair: DimensionlessFile, series: tuple[StateSeries, ...]) -> tuple[Dimensionless, ...]:
    """Return the dimensionless numbers of every state of a dimensionless pair, in the order of the file."""
    base = pair.dimensionless
    common: dict[str, Any] = {
        key: entry.value
        for key in type(base).model_fields
        if key not in Harmonics.model_fields and (entry := getattr(base, key)) is not None
    }
    return tuple(
        Dimensionless(name=pair.name.value, state=state, **common, **one.lists)
        for state, one in zip(pair.states or (ONLY_STATE,), series, strict=True)
    )
