"""Pair files: both forms, sources, and one sentence for everything that is wrong with them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sbg_casadi import Pair, PairError, case_names, load_pair

PHYSICAL = """
name = "mine"
[geometry]
teeth = [14, 39]
module = "4.536 mm"
pressure_angle = "20 deg"
spiral_angle = "35 deg"
side = 1
face_width = "25.4 mm"
backlash = "0.127 mm"
backlash_plane = "outer-normal"
[load]
torque = "300 N m"
member = "pinion"
speed = "1200 rpm"
[inertia]
pinion_mass = "0.4 kg"
added_pinion_inertia = "0 kg m^2"
[bearings]
pinion_x = ["2.1e8 N/m"]
pinion_y = ["3e8 N/m", "300 N/um"]
pinion_z = ["3e8 N/m", "3e8 N/m"]
gear_x = ["3e8 N/m", "3e8 N/m"]
gear_y = ["2.1e8 N/m"]
gear_z = ["3e8 N/m", "3e8 N/m"]
damping_ratio = 0.02
[mesh]
stiffness = {value = "5.08e8 N/m", source = "calibrated", note = "by hand"}
damping_ratio = 0.02
[states.before]
stiffness_cosine = [0.12, 0.03]
stiffness_sine = [0.0, 0.0]
error_cosine = [0.05]
[states.after]
stiffness_sine = [0.1]
"""

DIMENSIONLESS = """
name = "example"
[dimensionless]
torque = 0.14
mesh_damping_ratio = 0.02
tangential_cosine = 0.77
directions = [-0.62, 0.15, 0.77, 0.62, -0.15, -0.77]
mass_ratios = [0.3, 0.3, 0.3, 0.06, 0.06, 0.06]
bearing_stiffness = [2, 2, 2, 1, 1, 1]
bearing_damping = [0.02, 0.02, 0.02, 0.02, 0.02, 0.02]
stiffness_cosine = [0.3, 0.1]
stiffness_sine = [0.0, 0.0]
error_cosine = []
error_sine = []
"""


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str | bytes], Pair]:
    def write_and_load(text: str | bytes) -> Pair:
        path = tmp_path / "pair.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_pair(path)

    return write_and_load


Load = Callable[[str | bytes], Pair]


def changed(text: str, key: str, line: str) -> str:
    """Replace the line of a key; an empty line removes it."""
    new, count = re.subn(rf"^{key} = .*$", lambda _: line, text, count=1, flags=re.M)
    assert count == 1
    return new


def test_physical_form_reads_every_key(load: Load) -> None:
    pair = load(PHYSICAL)
    assert (pair.name, pair.form, pair.states) == ("mine", "physical", ("before", "after"))
    assert pair.derived is not None
    assert pair.derived.pinion_mass == 0.4
    assert pair.derived.mesh_stiffness == 5.08e8
    before, after = pair.dimensionless(), pair.dimensionless("after")
    assert (before.stiffness_cosine, before.error_cosine, before.error_sine) == ((0.12, 0.03), (0.05,), (0.0,))
    assert (after.stiffness_cosine, after.stiffness_sine, after.error_cosine) == ((0.0,), (0.1,), ())
    mean = pair.derived.pinion_mass * pair.derived.natural_frequency**2
    assert before.bearing_stiffness[:2] == pytest.approx((2.1e8 / mean, 6e8 / mean))


def test_dimensionless_form_has_one_state(load: Load) -> None:
    pair = load(DIMENSIONLESS)
    assert (pair.form, pair.states, pair.derived) == ("dimensionless", ("only",), None)
    built_in = load_pair("example").dimensionless()
    assert pair.dimensionless() == built_in == pair.dimensionless("only")


def test_states_after_a_dimensionless_table_take_over_what_they_do_not_give(load: Load) -> None:
    text = DIMENSIONLESS.replace("error_cosine = []", "error_cosine = [0.2]").replace("error_sine = []", "")
    pair = load(text + "[states.before]\n[states.after]\nstiffness_sine = [0.05]\n")
    before, after = pair.dimensionless("before"), pair.dimensionless("after")
    assert pair.states == ("before", "after")
    assert before.stiffness_cosine == (0.3, 0.1)
    assert (after.stiffness_cosine, after.stiffness_sine) == ((0.0,), (0.05,))
    assert before.error_cosine == after.error_cosine == (0.2,)


def test_rows_carry_units_and_sources(load: Load) -> None:
    rows = {(r.section, r.key): r for r in load(PHYSICAL).rows()}
    assert rows["load", "torque"][2:5] == ("300", "N m", "user")
    assert rows["mesh", "stiffness"][2:] == ("5.08e8", "N/m", "calibrated", "by hand")
    assert rows["bearings", "pinion_y"][2:4] == ("3e8 N/m, 300 N/um", "")
    assert rows["inertia", "gear_mass"].source == "derived"
    assert rows["derived", "unit_ratio_rpm"].unit == "rpm"
    assumed = [r.key for r in load_pair("iso-f2").rows() if r.source == "assumed"]
    assert {"pinion_x", "damping_ratio", "stiffness_cosine", "side"} <= set(assumed)


@pytest.mark.parametrize("name", case_names())
def test_every_value_of_a_built_in_case_has_a_source_and_a_note(name: str) -> None:
    for row in load_pair(name).rows():
        assert row.source != "user", row
        assert row.note or row.section == "derived", row


def test_gear_torque_is_the_balanced_one(load: Load) -> None:
    on_gear = PHYSICAL.replace('"300 N m"', f'"{300 * 39 / 14!r} Nm"').replace('"pinion"', '"gear"')
    one, two = load(PHYSICAL).derived, load(on_gear).derived
    assert one is not None
    assert two is not None
    assert two.normal_force == pytest.approx(one.normal_force, rel=1e-14)


@pytest.mark.parametrize(
    ("line", "same"),
    [
        ('module = "0.178582677165354 in"', 1e-12),
        ('module = "4536 µm"', 1e-14),
        ('module = "4.536e-3m"', 1e-14),
        ('module = {value = "+4.536 mm", source = "user"}', 1e-14),
    ],
)
def test_units_are_converted(load: Load, line: str, same: float) -> None:
    one, two = load(PHYSICAL).derived, load(changed(PHYSICAL, "module", line)).derived
    assert one is not None
    assert two is not None
    assert two.outer_cone_distance == pytest.approx(one.outer_cone_distance, rel=same)


WRONG = [  # key, its new line, words of the message
    ("torque", "", ["load.torque is missing", "positive torque", "300 N m"]),
    ("torque", 'torqe = "300 N m"', ["unknown key 'load.torqe'", "did you mean 'torque'"]),
    ("torque", "torque = 300", ["load.torque = 300 has no unit", "300 N m"]),
    ("torque", 'torque = "300"', ["has no unit"]),
    ("torque", 'torque = "300 N"', ["wrong unit 'N'", "positive torque"]),
    ("torque", 'torque = "300 Nn"', ["unknown unit 'Nn'"]),
    ("torque", 'torque = "-300 N m"', ["is not positive"]),
    ("torque", 'torque = "0 N m"', ["is not positive"]),
    ("torque", 'torque = "nan N m"', ["is not finite"]),
    ("torque", 'torque = "1e999 N m"', ["is not finite"]),
    ("torque", 'torque = "10**9**9 N m"', ["unknown unit"]),
    ("torque", "torque = nan", ["torque = nan is not finite"]),
    ("torque", "torque = true", ["is not text"]),
    ("torque", 'torque = ""', ["does not begin with a number"]),
    ("torque", 'torque = {value = "300 N m", sauce = "paper"}', ["unknown key 'sauce'", "'source'"]),
    ("torque", 'torque = {value = "300 N m", source = "hearsay"}', ['"hearsay"', "paper, standard, derived"]),
    ("torque", 'torque = {source = "user"}', ["without value"]),
    ("torque", 'torque = {value = "300 N m", note = 3}', ["note = 3", "expected text"]),
    ("torque", "torque = {value = -inf}", ["torque = -inf is not finite"]),
    ("speed", 'speed = "20 Hz"', ["wrong unit 'Hz'", "1200 rpm"]),
    ("pressure_angle", 'pressure_angle = "20 percent"', ["wrong unit"]),
    ("pressure_angle", 'pressure_angle = "90 deg"', ["too large"]),
    ("spiral_angle", 'spiral_angle = "-35 deg"', ["is negative"]),
    ("member", 'member = "pinon"', ["load.member", "did you mean 'pinion'"]),
    ("backlash_plane", 'backlash_plane = "normal"', ["outer-transverse"]),
    ("backlash", 'backlash = "0 mm"', ["is not positive"]),
    ("face_width", 'face_width = "95 mm"', ["geometry.face_width", "outer cone distance of 93.98 mm"]),
    ("teeth", "teeth = [14, 39.0]", ["holds 39.0", "not a whole number"]),
    ("teeth", "teeth = [14]", ["not a list of two"]),
    ("teeth", "teeth = [true, 39]", ["holds true"]),
    ("teeth", "teeth = [39, 14]", ["more teeth on the pinion"]),
    ("teeth", "teeth = [-1, 39]", ["holds -1"]),
    ("teeth", f"teeth = [{'1' * 5000}, 39]", ["not valid TOML"]),
    ("side", "side = 2", ["geometry.side = 2", "1 or -1"]),
    ("side", "side = true", ["1 or -1"]),
    ("pinion_mass", 'pinion_mass = "-0.4 kg"', ["inertia.pinion_mass", "is not positive"]),
    ("pinion_mass", 'pinion_mass = "0.4 N"', ["wrong unit"]),
    ("added_pinion_inertia", 'added_pinion_inertia = "-1 kg m^2"', ["is negative"]),
    ("pinion_x", "pinion_x = []", ["at least one entry"]),
    ("pinion_x", 'pinion_x = "2e8 N/m"', ["is not a list"]),
    ("pinion_x", 'pinion_x = ["0 N/m"]', ["bearings.pinion_x", "not positive"]),
    ("pinion_x", 'pinion_x = ["2e8 N/m", 3e8]', ["holds 300000000.0, which has no unit"]),
    ("damping_ratio", "damping_ratio = -0.1", ["is negative"]),
    ("damping_ratio", 'damping_ratio = "0.02"', ["not a plain number"]),
    ("damping_ratio", "damping_ratio = inf", ["is not finite"]),
    ("stiffness", "coast_stiffness_ratio = 0", ["mesh.coast_stiffness_ratio = 0 is not positive", "such as 0.9"]),
    ("stiffness_cosine", "stiffness_cosine = [1.2, 0.0]", ["state 'before'", "reach", "phase", "stays positive"]),
    ("stiffness_cosine", "stiffness_cosine = [0.1, nan]", ["holds nan, which is not finite"]),
    ("stiffness_cosine", "stiffness_cosine = [0.1]", ["1 and stiffness_sine 2 entries", "equal numbers"]),
    ("stiffness_cosine", "stiffness_cosine = 0.1", ["not a list"]),
    ("stiffness_cosine", f"stiffness_cosine = {[0.0] * 201}", ["201 entries"]),
    ("stiffness_cosine", f"stiffness_cosine = [1e{400}]", ["not finite"]),
    ("stiffness_cosine", 'stiffness_table = "b.csv"', ["states.before.stiffness_harmonics is missing", "such as 7"]),
    ("stiffness_cosine", "stiffness_harmonics = 7", ["without stiffness_table and stiffness_shape"]),
    ("stiffness_cosine", "stiffness_harmonics = 7.0", ["is not a whole number"]),
    ("stiffness_cosine", "stiffness_shape = {contact_ratio = 2.4, peak_to_peak = 0.2}", ["stiffness in one way"]),
    ("stiffness_cosine", "stiffness_shape = {contact_ratio = 2.4}", ["has no peak_to_peak"]),
    ("stiffness_cosine", "stiffness_shape = {contact = 2.4}", ["unknown key 'contact'", "'contact_ratio'"]),
    ("stiffness_cosine", "stiffness_shape = {contact_ratio = 1, peak_to_peak = 0.2}", ["contact_ratio = 1, which"]),
    ("stiffness_cosine", "stiffness_table = 3", ["states.before.stiffness_table = 3 is not text"]),
    ("error_cosine", "error_cosin = [0.05]", ["unknown key 'states.before.error_cosin'", "'error_cosine'"]),
    ("name", "", ["name is missing"]),
    ("name", 'name = "../mine"', ["can't be part of a file name"]),
    ("name", 'name = ""', ["is empty"]),
    ("name", 'mesh_stiffness = 3\nname = "mine"', ["unknown key 'mesh_stiffness'"]),
]


@pytest.mark.parametrize(("text", "section"), [(PHYSICAL, "mesh"), (DIMENSIONLESS, "dimensionless")])
def test_stiffness_of_the_coast_flank_reaches_numbers_rows_and_text(load: Load, text: str, section: str) -> None:
    key = "coast_stiffness_ratio"
    assert load(text).dimensionless().coast_stiffness_ratio == 1.0
    assert key not in load(text).to_toml()
    entry = f'{key} = {{value = 0.9, source = "assumed", note = "other curvature"}}\n'
    pair = load(text.replace(f"[{section}]\n", f"[{section}]\n{entry}"))
    assert {pair.dimensionless(state).coast_stiffness_ratio for state in pair.states} == {0.9}
    assert (section, key, "0.9", "", "assumed", "other curvature") in pair.rows()
    assert load(pair.to_toml()) == pair


@pytest.mark.parametrize(("key", "line", "words"), WRONG, ids=[f"{k}-{i}" for i, (k, _, _) in enumerate(WRONG)])
def test_a_wrong_value_is_one_sentence(load: Load, key: str, line: str, words: list[str]) -> None:
    with pytest.raises(PairError) as info:
        load(changed(PHYSICAL, key, line))
    message = str(info.value)
    assert "\n" not in message
    assert len(message) < 400
    for word in words:
        assert word in message


WRONG_NUMBERS = [
    ("torque", "torque = -0.1", ["dimensionless.torque = -0.1 is not positive"]),
    ("torque", "torque = nan", ["is not finite"]),
    ("torque", f"torque = {10**400}", ["too large"]),
    ("tangential_cosine", "tangential_cosine = 0.0", ["not positive"]),
    ("mass_ratios", "mass_ratios = [1, 1, 1, 1, 1, 0]", ["holds 0, which is not positive", "x_p, y_p"]),
    ("directions", "directions = [1, 2, 3]", ["has 3 entries", "six"]),
    ("directions", 'directions = [1, 2, 3, 4, 5, "6"]', ['holds "6"']),
    ("bearing_damping", "bearing_damping = [0, 0, 0, 0, 0, -1]", ["is negative"]),
    ("stiffness_cosine", "stiffness_cosine = [1.0, 0.0]", ["reach", "at mesh phase 3.1416 rad"]),
    ("stiffness_cosine", "stiffness_cosin = [1.0]", ["unknown key", "did you mean 'stiffness_cosine'"]),
    ("mesh_damping_ratio", "", ["dimensionless.mesh_damping_ratio is missing"]),
]


@pytest.mark.parametrize(("key", "line", "words"), WRONG_NUMBERS)
def test_a_wrong_number_is_one_sentence(load: Load, key: str, line: str, words: list[str]) -> None:
    with pytest.raises(PairError) as info:
        load(changed(DIMENSIONLESS, key, line))
    for word in words:
        assert word in str(info.value)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"# nothing\n", "holds no key"),
        (b"name = 'x'\nname = 'y'", "not valid TOML"),
        (b"name = \n", "line 1"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b"a = " + b"[" * 100_000, "not valid TOML"),
        (b"name = 'x'\n", "holds no pair"),
        (b"name = 'x'\n[geometri]\n", "did you mean 'geometry'"),
        (b"name = 'x'\n[dimensionles]\n", "did you mean 'dimensionless'"),
        (b"name = 'x'\ngeometry = 3\n", "expected a table [geometry]"),
        (b"#" * 1_000_001, "larger than"),
        ((PHYSICAL + "[dimensionless]\n").encode(), "expected one form"),
        ((PHYSICAL.split("[states")[0]).encode(), "states is missing; expected at least one table [states.NAME]"),
        ((PHYSICAL.split("[states")[0] + "[states]\n").encode(), "states is empty"),
        ((PHYSICAL + '[states."a/b"]\n').encode(), "state name"),
        ((PHYSICAL + "[states]\nx = 3\n").encode(), "states.x = 3; expected a table [states.x]"),
        ((DIMENSIONLESS + "[states]\nx = 3\n").encode(), "states.x = 3; expected a table [states.x]"),
        (PHYSICAL.replace("4.536 mm", "1e-200 mm").encode(), "expected"),
        (PHYSICAL.replace("4.536 mm", "1e200 mm").encode(), "too large or too small"),
    ],
)
def test_a_file_that_is_no_pair_is_one_sentence(load: Load, text: bytes, word: str) -> None:
    with pytest.raises(PairError, match=re.escape(word)):
        load(text)


def test_a_byte_order_mark_and_windows_lines_are_read(load: Load) -> None:
    assert load(b"\xef\xbb\xbf" + PHYSICAL.replace("\n", "\r\n").encode()).name == "mine"


def test_names_and_paths_that_lead_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, word in [
        ("iso-f3", "did you mean 'iso-f2'"),
        ("", "example"),
        ("nowhere/pair.toml", "does not exist"),
        ("pair.toml", "does not exist"),
        (str(tmp_path), "is a folder"),
        ("a\0b", "can't be read"),
        ("x" * 5000, "can't be read"),
    ]:
        with pytest.raises(PairError, match=re.escape(word)):
            load_pair(name)
    with pytest.raises(PairError, match="has no state 'befor'; did you mean 'before'"):
        load_pair("iso-f2").dimensionless("befor")


def test_an_unreadable_file_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "pair.toml"
    path.write_text(PHYSICAL)

    def refuse(*_: object) -> None:  # the tests may run as a user who reads every file
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("sbg_casadi.pair.open", refuse, raising=False)
    with pytest.raises(PairError, match="can't be read: Permission denied; expected a readable TOML file"):
        load_pair(path)


KEYS = sorted(set(re.findall(r"^(\w+) = ", PHYSICAL, flags=re.M)))
VALUES = st.one_of(
    st.integers(),
    st.floats().map(lambda v: "inf" if v == math.inf else repr(v)),
    st.text("0123456789.eE+- Nmkgdegrpm/^*(){}'\u00b5\u00b7%", max_size=14).map(lambda t: '"' + t + '"'),
    st.sampled_from(["[]", "[[]]", "{}", "{value = 1}", "true", "1979-05-27", "[1, 'a']", '["1 N/m"]', "0x10"]),
)


@settings(max_examples=150, deadline=None)
@given(key=st.sampled_from(KEYS), value=VALUES)
def test_no_value_of_any_key_leads_to_another_error(
    tmp_path_factory: pytest.TempPathFactory, key: str, value: object
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "pair.toml"
    path.write_text(changed(PHYSICAL, key, f"{key} = {value}"), encoding="utf-8")
    message, pair = "", None
    try:
        pair = load_pair(path)
    except PairError as error:
        message = str(error)
    assert "\n" not in message
    assert pair is None or all(pair.dimensionless(state).torque > 0 for state in pair.states)
