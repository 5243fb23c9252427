"""Random pair files: from file to Pair and back without a change, and corruptions answered by one sentence."""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sbg_casadi import Pair, PairError, case_names, load_pair
from sbg_casadi.entries import SOURCES

Sections = dict[str, dict[str, str]]
STEADY = settings(max_examples=100, deadline=None, derandomize=True)


def read(text: str) -> Pair:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pair.toml"
        path.write_text(text, encoding="utf-8")
        return load_pair(path)


@pytest.mark.parametrize("name", case_names())
def test_built_in_cases_come_back(name: str) -> None:
    pair = load_pair(name)
    again = read(pair.to_toml())
    assert again == pair
    assert again.to_toml() == pair.to_toml()


def text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")


NOTES = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)


@st.composite
def tagged(draw: st.DrawFn, value: str) -> str:
    """Return a TOML value, plain or as a table with a source and perhaps a note."""
    if draw(st.booleans()):
        return value
    parts = [f"value = {value}", f"source = {text(draw(st.sampled_from(SOURCES)))}"]
    if draw(st.booleans()):
        parts.append(f"note = {text(draw(NOTES))}")
    return "{" + ", ".join(draw(st.permutations(parts))) + "}"


def number(low: float, high: float) -> st.SearchStrategy[str]:
    return st.floats(low, high).map(repr)


def quantity(low: float, high: float, *units: str) -> st.SearchStrategy[str]:
    blank = st.sampled_from(["", " ", "  "])
    return st.tuples(st.floats(low, high), blank, st.sampled_from(units)).map(lambda v: text(f"{v[0]!r}{v[1]}{v[2]}"))


def listed(item: st.SearchStrategy[str], least: int, most: int) -> st.SearchStrategy[str]:
    return st.lists(item, min_size=least, max_size=most).map(lambda items: f"[{', '.join(items)}]")


@st.composite
def table(
    draw: st.DrawFn, required: dict[str, st.SearchStrategy[str]], optional: dict[str, st.SearchStrategy[str]]
) -> dict[str, str]:
    chosen = [*required.items(), *(item for item in optional.items() if draw(st.booleans()))]
    return {key: draw(values.flatmap(tagged)) for key, values in draw(st.permutations(chosen))}


ENDS = listed(quantity(1e8, 1e9, "N/m", "newton/meter") | quantity(100, 1000, "N/um"), 1, 3)
TEETH = st.tuples(st.integers(3, 40), st.integers(40, 90)).map(lambda z: f"[{z[0]}, {z[1]}]")
PLANES = ["outer-normal", "mean-normal", "outer-transverse", "mean-transverse"]
GEOMETRY = table(
    {
        "teeth": TEETH,
        "module": quantity(2, 9, "mm") | quantity(2000, 9000, "um"),
        "pressure_angle": quantity(14, 25, "deg"),
        "spiral_angle": quantity(0, 0.7, "rad"),
        "side": st.sampled_from(["1", "-1"]),
        "backlash": quantity(0.05, 0.7, "mm"),
        "backlash_plane": st.sampled_from(PLANES).map(text),
    },
    {"face_width": quantity(5, 30, "mm")},
)
LOAD = table(
    {"torque": quantity(10, 20000, "N m", "Nm"), "member": st.sampled_from(["pinion", "gear"]).map(text)},
    {"speed": quantity(100, 9000, "rpm", "rev/min")},
)
MASS, INERTIA = quantity(0.1, 9, "kg") | quantity(100, 9000, "g"), quantity(1e-4, 1, "kg m^2", "kg*m**2")
MEMBERS = ("pinion", "gear")
INERTIAS = table(
    {},
    {f"{a}{m}_mass": MASS for a in ("", "added_") for m in MEMBERS}
    | {f"{a}{m}_inertia": INERTIA for a in ("", "added_") for m in MEMBERS},
)
BEARINGS = table(
    {**{f"{m}_{axis}": ENDS for m in MEMBERS for axis in "xyz"}, "damping_ratio": number(0, 0.2) | st.just("0")}, {}
)
COAST = number(0.5, 1.5) | st.just("1")
MESH = table(
    {"damping_ratio": number(0, 0.2)}, {"stiffness": quantity(1e8, 2e9, "N/m"), "coast_stiffness_ratio": COAST}
)
SMALL = number(-0.1, 0.1)
THREE = listed(SMALL, 3, 3)
ERRORS = {"error_cosine": THREE | st.just("[]"), "error_sine": THREE}
SHAPE = st.tuples(st.floats(1.1, 1.9), st.floats(0.01, 0.5), st.floats(0.1, 1), st.floats(0.05, 0.9)).map(
    lambda v: "{" + f"contact_ratio = {v[0]!r}, rounding = {v[3]!r}, peak_to_peak = {v[1]!r}, modification = {v[2]!r}}}"
)
STATE = table({}, {"stiffness_cosine": THREE, "stiffness_sine": THREE, **ERRORS}) | table(
    {"stiffness_shape": SHAPE, "stiffness_harmonics": st.integers(1, 9).map(str)}, ERRORS
)
STATE_NAMES = st.text("abcXYZ 0_é", min_size=1, max_size=8).filter(lambda name: name == name.strip())


def six(item: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return listed(item, 6, 6)


SEVEN = {
    "torque": number(0.01, 1),
    "mesh_damping_ratio": number(0, 0.2),
    "tangential_cosine": number(0.3, 1),
    "directions": six(number(-1, 1)),
    "mass_ratios": six(number(0.01, 1)),
    "bearing_stiffness": six(number(0.1, 9) | st.integers(1, 9).map(str)),
    "bearing_damping": six(number(0, 0.2)),
}


@st.composite
def physical(draw: st.DrawFn) -> Sections:
    parts = {"geometry": GEOMETRY, "load": LOAD, "inertia": INERTIAS, "bearings": BEARINGS, "mesh": MESH}
    sections: Sections = {name: draw(values) for name, values in parts.items()}
    for state in draw(st.lists(STATE_NAMES, min_size=1, max_size=3, unique=True)):
        sections[f"states.{text(state)}"] = draw(STATE)
    return sections


@st.composite
def dimensionless(draw: st.DrawFn) -> Sections:
    sections: Sections = {"dimensionless": draw(table(SEVEN, {"coast_stiffness_ratio": COAST, **ERRORS})) | draw(STATE)}
    for state in draw(st.lists(STATE_NAMES, max_size=2, unique=True)):
        sections[f"states.{text(state)}"] = draw(STATE)
    return sections


def document(sections: Sections) -> str:
    lines = ['name = "mine"']
    for section, values in sections.items():
        lines += [f"[{section}]", *(f"{key} = {value}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


@STEADY
@given(st.one_of(physical(), dimensionless()))
def test_random_valid_files_come_back(sections: Sections) -> None:
    pair = read(document(sections))
    written = pair.to_toml()
    again = read(written)
    assert again == pair
    assert again.rows() == pair.rows()
    assert again.to_toml() == written
    for section, values in sections.items():
        for key in values:
            assert f"\n{key} = " in written, (section, key)


def _misspell(key: str, value: str) -> tuple[str, str]:
    return key + "x", value


def _without_meaning(key: str, value: str) -> tuple[str, str]:
    return key, "1979-05-27"


def _not_finite(key: str, value: str) -> tuple[str, str]:
    return key, "nan"


def _unknown_source(key: str, value: str) -> tuple[str, str]:
    return key, '{value = 1, source = "hearsay"}'


def _unknown_part(key: str, value: str) -> tuple[str, str]:
    return key, '{value = 1, sauce = "paper"}'


Corruption = Callable[[str, str], tuple[str, str]]
CORRUPTIONS: list[Corruption] = [_misspell, _without_meaning, _not_finite, _unknown_source, _unknown_part]


@STEADY
@given(st.one_of(physical(), dimensionless()), st.sampled_from(CORRUPTIONS), st.data())
def test_a_random_corruption_is_one_sentence_that_names_the_key(
    sections: Sections, corrupt: Corruption, data: Any
) -> None:
    section = data.draw(st.sampled_from([name for name, values in sections.items() if values]))
    key = data.draw(st.sampled_from(list(sections[section])))
    changed, value = corrupt(key, sections[section][key])
    replaced = {(changed if k == key else k): (value if k == key else v) for k, v in sections[section].items()}
    with pytest.raises(PairError) as info:
        read(document(sections | {section: replaced}))
    message = str(info.value)
    assert "\n" not in message
    assert f"{section.replace(chr(34), '')}.{changed}" in message
    assert len(message) < 500


@STEADY
@given(physical(), st.data())
def test_a_missing_key_is_one_sentence_that_names_it(sections: Sections, data: Any) -> None:
    needed = {
        "geometry": ["teeth", "module", "pressure_angle", "spiral_angle", "side", "backlash", "backlash_plane"],
        "load": ["torque", "member"],
        "bearings": ["pinion_x", "gear_z", "damping_ratio"],
        "mesh": ["damping_ratio"],
    }
    section = data.draw(st.sampled_from(list(needed)))
    key = data.draw(st.sampled_from(needed[section]))
    left = {k: v for k, v in sections[section].items() if k != key}
    with pytest.raises(PairError, match=rf"{section}\.{key} is missing; expected ") as info:
        read(document(sections | {section: left}))
    assert "\n" not in str(info.value)
