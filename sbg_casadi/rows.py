"""A pair as rows of text: every value with its unit, its source and a note."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from sbg_casadi.derived import Derived, outer_base_radius
from sbg_casadi.dimensionless import ONLY_STATE, Dimensionless
from sbg_casadi.entries import Entry
from sbg_casadi.mesh import peak_to_peak
from sbg_casadi.schema import DimensionlessFile, Harmonics, PhysicalFile, Table
from sbg_casadi.state_series import StateSeries


class Row(NamedTuple):
    """One value of a pair as it is shown."""

    section: str
    key: str
    value: str
    unit: str
    source: str
    note: str


# What a file may leave out: key -> (attribute of Derived, factor, unit, where the default comes from)
_CONE = "solid steel frustum of the pitch cone over the face width, 7860 kg/m^3"
_DEFAULTS = {
    ("geometry", "face_width"): ("face_width", 1e3, "mm", "0.3 R_e"),
    ("inertia", "pinion_mass"): ("pinion_mass", 1.0, "kg", _CONE),
    ("inertia", "gear_mass"): ("gear_mass", 1.0, "kg", _CONE),
    ("inertia", "pinion_inertia"): ("pinion_inertia", 1.0, "kg m^2", _CONE),
    ("inertia", "gear_inertia"): ("gear_inertia", 1.0, "kg m^2", _CONE),
    ("mesh", "stiffness"): ("mesh_stiffness", 1.0, "N/m", "k_0 = 20 N/(mm um) times face width, ISO 10300-1 method B"),
}

_DERIVED = (
    ("pitch_angle", 180 / math.pi, "deg", "pinion pitch cone, tan(delta_1) = z1/z2"),
    ("outer_cone_distance", 1e3, "mm", "R_e"),
    ("mean_cone_distance", 1e3, "mm", "R_m = R_e - face width / 2"),
    ("pinion_mean_radius", 1e3, "mm", "r_m1, mean pitch radius, multiplies a3 in (14)"),
    ("gear_mean_radius", 1e3, "mm", "r_m2"),
    ("pinion_mass", 1.0, "kg", "total"),
    ("gear_mass", 1.0, "kg", "total"),
    ("pinion_inertia", 1.0, "kg m^2", "total"),
    ("gear_inertia", 1.0, "kg m^2", "total"),
    ("a1", 1.0, "", "(9), read so that a1^2 + a2^2 + a3^2 = 1"),
    ("a2", 1.0, "", "(10)"),
    ("a3", 1.0, "", "(11)"),
    ("equivalent_mass", 1.0, "kg", "m_eq, (18)"),
    ("mesh_stiffness", 1.0, "N/m", "k_0"),
    ("natural_frequency", 1.0, "rad/s", "omega_n = sqrt(k_0 / m_eq), (18)"),
    ("half_backlash", 1e3, "mm", "b, half the normal backlash at the mean cone distance"),
    ("pinion_torque", 1.0, "N m", ""),
    ("gear_torque", 1.0, "N m", "balances the pinion's"),
    ("tangential_force", 1.0, "N", "F_mt at the mean pitch radius"),
    ("normal_force", 1.0, "N", "F_n = F_mt / a3"),
    ("torque", 1.0, "", "T = F_mt / (k_0 b), (22)"),
    ("mean_load", 1.0, "", "mean mesh force T / a3"),
    ("unit_ratio_rpm", 1.0, "rpm", "pinion speed at frequency ratio 1"),
    ("rated_ratio", 1.0, "", "frequency ratio at the rated speed"),
)


def physical_rows(
    pair: PhysicalFile, derived: Derived, states: Iterable[Dimensionless], series: Iterable[StateSeries]
) -> tuple[Row, ...]:
    """Return the rows of a physical pair: what is given, the defaults used, the derived quantities."""
    rows = [_row("", "name", pair.name)]
    for section in ("geometry", "load", "inertia", "bearings", "mesh"):
        table: Table = getattr(pair, section)
        for key in type(table).model_fields:
            entry = getattr(table, key)
            if entry is not None:
                rows.append(_row(section, key, entry))
            elif (section, key) in _DEFAULTS:
                rows.append(_default(section, key, pair, derived))
    rows += _state_rows(pair.states, states, series)
    rows += _printed_rows(pair)
    for name, scale, unit, note in _DERIVED:
        value = getattr(derived, name)
        if value is not None:
            published = getattr(pair.published, name, None)
            if published is not None:
                note += f"; published {published.text} {published.unit} ({published.source})"
            rows.append(Row("derived", name, f"{value * scale:.7g}", unit, "derived", note))
    return tuple(rows)


def given_rows(
    pair: DimensionlessFile, states: Iterable[Dimensionless], series: Iterable[StateSeries]
) -> tuple[Row, ...]:
    """Return the rows of a dimensionless pair."""
    rows = [_row("", "name", pair.name)]
    base = pair.dimensionless
    for key in type(base).model_fields:
        if key not in Harmonics.model_fields and (entry := getattr(base, key)) is not None:
            rows.append(_row("dimensionless", key, entry))
    if pair.states:  # the harmonics beside the numbers are then defaults of the states
        given = ((key, getattr(base, key)) for key in Harmonics.model_fields)
        rows += [_row("dimensionless", key, entry) for key, entry in given if entry is not None]
        rows += _state_rows(pair.states, states, series)
    else:
        rows += _state_rows({ONLY_STATE: base}, states, series, section="dimensionless")
    mean = base.torque.value / base.tangential_cosine.value
    rows.append(Row("derived", "mean_load", f"{mean:.7g}", "", "derived", "mean mesh force T / a3"))
    return tuple(rows)


def _row(section: str, key: str, entry: Entry) -> Row:
    return Row(section, key, entry.text, entry.unit, entry.source, entry.note)


def _default(section: str, key: str, pair: PhysicalFile, derived: Derived) -> Row:
    """Return the row of a default; what is added to a member is taken off again, it has a row of its own."""
    name, scale, unit, note = _DEFAULTS[section, key]
    added = getattr(pair.inertia, f"added_{key}", None)
    value = getattr(derived, name) - (added.value if added is not None else 0.0)
    first, table = next(iter(pair.states.items()))
    if (section, key) == ("mesh", "stiffness") and table.stiffness_table is not None:
        note = f"k_0 = mean of states.{first}.stiffness_table, (17)"
    return Row(section, key, f"{value * scale:.7g}", unit, "derived", note)


def _state_rows(
    tables: dict[str, Harmonics], states: Iterable[Dimensionless], series: Iterable[StateSeries], section: str = ""
) -> Iterator[Row]:
    """Yield what each state gives, the harmonics that follow from a table or a shape, and the fluctuation."""
    for state, table, one in zip(states, tables.values(), series, strict=True):
        place = section or f"states.{state.state}"
        for key in Harmonics.model_fields:
            if (entry := getattr(table, key)) is not None:
                yield _row(place, key, entry)
        for key, note in one.notes.items():
            yield Row(place, key, ", ".join(f"{v:.6g}" for v in one.lists[key]), "", "derived", note)
        span = peak_to_peak(state.stiffness_cosine, state.stiffness_sine)
        note = "fluctuation of the mesh stiffness over its mean"
        yield Row(place, "peak_to_peak", f"{span:.7g}", "", "derived", note)


def _printed_rows(pair: PhysicalFile) -> Iterator[Row]:
    """Yield the paper's values that don't fit together, each with the number it should be."""
    geometry, paper = pair.geometry, pair.paper
    module, angle = geometry.module.value, geometry.pressure_angle.value
    for member, teeth in zip(("pinion", "gear"), geometry.teeth.value, strict=True):
        entry = getattr(paper, f"{member}_base_radius")
        if entry is not None:
            right = f"m z cos(alpha) / 2 is {outer_base_radius(module, teeth, angle) * 1e3:.2f} mm"
            yield _noted("paper", f"{member}_base_radius", entry, right)
    if paper.backlash is not None:
        share = f"{100 * paper.backlash.value / module:.1f} % of the module, practice is 3 to 6 %; "
        used = f"b of the equations is half the gap, {geometry.backlash.value / 2 * 1e3:.4g} mm"
        yield _noted("paper", "backlash", paper.backlash, share + used)


def _noted(section: str, key: str, entry: Entry, note: str) -> Row:
    """Return the row of an entry with a computed note after its own."""
    return Row(section, key, entry.text, entry.unit, entry.source, "; ".join(filter(None, (entry.note, note))))
