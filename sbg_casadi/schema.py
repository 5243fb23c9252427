"""Tables and keys of a pair file: what each may hold, and one sentence when it doesn't."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, ValidationError

from continuation.errors import nearest
from sbg_casadi.derived import BacklashPlane
from sbg_casadi.entries import Choice, Entry, Kind, Name, Number, Numbers, Quantities, Quantity, Teeth, shown
from sbg_casadi.errors import PairError
from sbg_casadi.series_kinds import Shape, TablePath, Whole
from sbg_casadi.shapes import StiffnessShape

_NAME = Name('a short name without path separators, such as "iso-f2"')
_LENGTH = Quantity('a positive length with a unit, such as "4.536 mm"', unit="m")
_MASS = Quantity('a positive mass with a unit, such as "0.4 kg"', unit="kg")
_INERTIA = Quantity('a positive moment of inertia with a unit, such as "1e-4 kg m^2"', unit="kg m^2")
_ADDED_MASS = Quantity('a mass of zero or more with a unit, such as "0.2 kg"', unit="kg", above=None, least=0.0)
_ADDED_INERTIA = Quantity(
    'a moment of inertia of zero or more with a unit, such as "0 kg m^2"', unit="kg m^2", above=None, least=0.0
)
_ENDS = Quantities('a list with one positive stiffness for each shaft end, such as ["3e8 N/m", "3e8 N/m"]', unit="N/m")
_FORCE = Quantity('a positive force with a unit, such as "14193.3 N"', unit="N")
_DAMPING = Number("a plain number of zero or more, such as 0.02", least=0.0)
_COAST = Number("a positive plain number, such as 0.9", above=0.0)
_SERIES = Numbers("a list of at most 200 plain numbers, such as [0.12, 0.03]")
_SIX = "a list of six plain numbers in the order x_p, y_p, z_p, x_g, y_g, z_g"


class Table(BaseModel):
    """A TOML table with known keys only."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class Geometry(Table):
    """Geometry of the tooth system; shaft angle 90 degrees."""

    teeth: Annotated[
        Entry[tuple[int, int]], Teeth("two whole numbers from 3 on, pinion first and not larger, such as [14, 39]")
    ]
    module: Annotated[Entry[float], _LENGTH]
    pressure_angle: Annotated[
        Entry[float],
        Quantity('an angle above 0 and below 90 deg, such as "20 deg"', unit="rad", below=math.pi / 2),
    ]
    spiral_angle: Annotated[
        Entry[float],
        Quantity(
            'an angle from 0 to below 90 deg, such as "35 deg" (the hand goes into side)',
            unit="rad",
            above=None,
            least=0.0,
            below=math.pi / 2,
        ),
    ]
    side: Annotated[Entry[int], Choice("1 or -1, for the hand of spiral and the driving flank", options=(1, -1))]
    face_width: Annotated[Entry[float] | None, _LENGTH] = None
    backlash: Annotated[Entry[float], _LENGTH]
    backlash_plane: Annotated[
        Entry[BacklashPlane],
        Choice(
            "one of outer-normal, mean-normal, outer-transverse, mean-transverse",
            options=("outer-normal", "mean-normal", "outer-transverse", "mean-transverse"),
        ),
    ]


class Load(Table):
    """Constant torque on one member; the torque on the other balances it."""

    torque: Annotated[Entry[float], Quantity('a positive torque with a unit, such as "300 N m"', unit="N m")]
    member: Annotated[Entry[str], Choice("pinion or gear, the member the torque is on", options=("pinion", "gear"))]
    speed: Annotated[
        Entry[float] | None, Quantity('a positive speed of rotation, such as "1200 rpm"', unit="rad/s")
    ] = None


class Inertia(Table):
    """Masses and inertias; what is absent is derived, ``added_*`` (shaft, load) comes on top."""

    pinion_mass: Annotated[Entry[float] | None, _MASS] = None
    gear_mass: Annotated[Entry[float] | None, _MASS] = None
    pinion_inertia: Annotated[Entry[float] | None, _INERTIA] = None
    gear_inertia: Annotated[Entry[float] | None, _INERTIA] = None
    added_pinion_mass: Annotated[Entry[float] | None, _ADDED_MASS] = None
    added_gear_mass: Annotated[Entry[float] | None, _ADDED_MASS] = None
    added_pinion_inertia: Annotated[Entry[float] | None, _ADDED_INERTIA] = None
    added_gear_inertia: Annotated[Entry[float] | None, _ADDED_INERTIA] = None


class Bearings(Table):
    """Bearing stiffness per direction, one entry for each shaft end that carries it, equation (13)."""

    pinion_x: Annotated[Entry[tuple[float, ...]], _ENDS]
    pinion_y: Annotated[Entry[tuple[float, ...]], _ENDS]
    pinion_z: Annotated[Entry[tuple[float, ...]], _ENDS]
    gear_x: Annotated[Entry[tuple[float, ...]], _ENDS]
    gear_y: Annotated[Entry[tuple[float, ...]], _ENDS]
    gear_z: Annotated[Entry[tuple[float, ...]], _ENDS]
    damping_ratio: Annotated[Entry[float], _DAMPING]


class Mesh(Table):
    """Mean mesh stiffness k_0, mesh damping ratio xi, stiffness of the coast flank over that of the drive flank."""

    stiffness: Annotated[
        Entry[float] | None, Quantity('a positive stiffness with a unit, such as "5.08e8 N/m"', unit="N/m")
    ] = None
    damping_ratio: Annotated[Entry[float], _DAMPING]
    coast_stiffness_ratio: Annotated[Entry[float] | None, _COAST] = None


class Harmonics(Table):
    """Mesh stiffness over its mean, in one of three ways, and harmonics of the error over half the backlash."""

    stiffness_cosine: Annotated[Entry[tuple[float, ...]] | None, _SERIES] = None
    stiffness_sine: Annotated[Entry[tuple[float, ...]] | None, _SERIES] = None
    stiffness_table: Annotated[
        Entry[str] | None, TablePath('the path of a CSV table beside the pair file, such as "before.csv"')
    ] = None
    stiffness_shape: Annotated[
        Entry[StiffnessShape] | None,
        Shape("a table such as {contact_ratio = 2.4, peak_to_peak = 0.2, modification = 0.65, rounding = 0.2}"),
    ] = None
    stiffness_harmonics: Annotated[Entry[int] | None, Whole("a whole number of harmonics from 1 to 200, such as 7")] = (
        None
    )
    error_cosine: Annotated[Entry[tuple[float, ...]] | None, _SERIES] = None
    error_sine: Annotated[Entry[tuple[float, ...]] | None, _SERIES] = None


class Published(Table):
    """Published results of the same pair, shown beside the derived ones and used for nothing else."""

    normal_force: Annotated[Entry[float] | None, _FORCE] = None
    tangential_force: Annotated[Entry[float] | None, _FORCE] = None


class Printed(Table):
    """Values of the paper's tables that don't fit together, shown beside what they should be and never used."""

    pinion_base_radius: Annotated[Entry[float] | None, _LENGTH] = None
    gear_base_radius: Annotated[Entry[float] | None, _LENGTH] = None
    backlash: Annotated[Entry[float] | None, _LENGTH] = None


class SevenCoordinates(Harmonics):
    """The dimensionless numbers of the seven-coordinate equations (23)-(29)."""

    torque: Annotated[Entry[float], Number("a positive plain number, such as 0.14", above=0.0)]
    mesh_damping_ratio: Annotated[Entry[float], _DAMPING]
    tangential_cosine: Annotated[Entry[float], Number("a positive plain number, such as 0.77", above=0.0)]
    directions: Annotated[Entry[tuple[float, ...]], Numbers(_SIX, length=6)]
    mass_ratios: Annotated[Entry[tuple[float, ...]], Numbers(f"{_SIX}, all positive", length=6, above=0.0)]
    bearing_stiffness: Annotated[Entry[tuple[float, ...]], Numbers(f"{_SIX}, all positive", length=6, above=0.0)]
    bearing_damping: Annotated[Entry[tuple[float, ...]], Numbers(f"{_SIX}, none negative", length=6, least=0.0)]
    coast_stiffness_ratio: Annotated[Entry[float] | None, _COAST] = None


class PhysicalFile(Table):
    """A pair file with units."""

    name: Annotated[Entry[str], _NAME]
    geometry: Geometry
    load: Load
    inertia: Inertia = Inertia()
    bearings: Bearings
    mesh: Mesh
    states: dict[str, Harmonics]
    published: Published = Published()
    paper: Printed = Printed()


class DimensionlessFile(Table):
    """A pair file of plain numbers."""

    name: Annotated[Entry[str], _NAME]
    dimensionless: SevenCoordinates
    states: dict[str, Harmonics] = {}


def read_file(raw: dict[str, Any], place: str) -> PhysicalFile | DimensionlessFile:
    """Validate the parsed TOML of a pair file.

    Parameters
    ----------
    raw : dict
        What ``tomllib`` returns.
    place : str
        Beginning of every message, names the file.

    Raises
    ------
    PairError
        With one sentence that names the key, its value and what was expected; unknown keys come first.
    """
    physical = [k for k in PhysicalFile.model_fields if k not in DimensionlessFile.model_fields]
    known = [*PhysicalFile.model_fields, "dimensionless"]
    for key in raw:
        if key not in known:
            raise PairError(f"{place}: unknown key {key!r}; {nearest(key, known)}")
    form: type[PhysicalFile] | type[DimensionlessFile] = PhysicalFile
    if "dimensionless" in raw:
        both = [k for k in raw if k in physical]
        if both:
            raise PairError(f"{place}: [dimensionless] and [{both[0]}] in one file; expected one form of the pair")
        form = DimensionlessFile
    elif not any(k in raw for k in physical):
        raise PairError(f"{place}: holds no pair; expected the tables [geometry], [load], ... or [dimensionless]")
    try:
        return form.model_validate(raw)
    except ValidationError as error:
        raise PairError(f"{place}: {_sentence(error.errors(), form)}") from None


def _sentence(errors: Iterable[Any], form: type[Table]) -> str:
    """Turn the first of pydantic's errors into words; unknown keys go first, they often explain missing ones."""
    first = sorted(errors, key=lambda e: e["type"] != "extra_forbidden")[0]
    loc = [str(part) for part in first["loc"]]
    path = ".".join(loc)
    table = _table(form, loc[:-1])
    if first["type"] == "extra_forbidden":
        return f"unknown key {path!r}; {nearest(loc[-1], table.model_fields)}"
    if first["type"] == "missing":
        return f"{path} is missing; expected {_expected(table, loc)}"
    if first["type"] == "value_error":
        return f"{path} {first['ctx']['error']}"
    return f"{path} = {shown(first['input'])}; expected a table [{path}]"


def _table(form: type[Table], loc: list[str]) -> type[Table]:
    """Return the table class that the keys of a location belong to."""
    if not loc:
        return form
    if loc[0] == "states":
        return Harmonics
    annotation = form.model_fields[loc[0]].annotation
    return annotation if isinstance(annotation, type) and issubclass(annotation, Table) else form


def _expected(table: type[Table], loc: list[str]) -> str:
    kinds = [m for m in table.model_fields[loc[-1]].metadata if isinstance(m, Kind)]
    if kinds:
        return kinds[0].expected
    return "at least one table [states.NAME]" if loc[-1] == "states" else f"a table [{'.'.join(loc)}]"
