"""Transmission error to mesh stiffness: what must hold, through tables, pair files and the command ``stiffness``."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from typer.testing import CliRunner

from sbg_casadi import PairError, load_pair
from sbg_casadi.cli import app
from sbg_casadi.conversion import Conversion, MeshGeometry, convert
from sbg_casadi.mesh import fourier_series, peak_to_peak
from sbg_casadi.shapes import StiffnessShape
from sbg_casadi.stiffness_figure import plot_spectrum, plot_stiffness, series_curve
from sbg_casadi.tables import parse_table

MESH = load_pair("iso-f2").mesh_geometry()
assert MESH is not None
PHASE = np.linspace(0, 1, 33)
COSINE, SINE = (0.1, 0.02, -0.01), (0.03, 0.0, 0.005)
ERROR_COSINE, ERROR_SINE = (2e-6, 0.0, 0.0), (0.0, -1e-6, 0.0)  # m along the normal


def stiffness(phase: np.ndarray) -> np.ndarray:
    return 5.2e8 * (1 + fourier_series(COSINE, SINE, 2 * np.pi * phase))


def csv(head: str, *columns: np.ndarray) -> str:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return head + "\n" + "".join(", ".join(map(repr, row)) + "\n" for row in rows)


def errors(mesh: MeshGeometry = MESH, torque: float = 300.0) -> tuple[np.ndarray, np.ndarray]:
    """Return loaded and unloaded error in m along the normal."""
    unloaded = fourier_series(ERROR_COSINE, ERROR_SINE, 2 * np.pi * PHASE)
    return unloaded + mesh.normal_force(torque) / stiffness(PHASE), unloaded


A3 = MESH.tangential_cosine
UNITS = {  # words of the head, metres along the normal for one unit
    "gear [urad]": 1e-6 * MESH.gear_radius * A3,
    "pinion [urad]": 1e-6 * MESH.pinion_radius * A3,
    "gear [arcsec]": np.pi / 180 / 3600 * MESH.gear_radius * A3,
    "pinion [um]": 1e-6 * A3,
    "normal [um]": 1e-6,
}


def check(result: Conversion) -> None:
    cosine, sine = result.relative()
    assert result.stiffness.mean == pytest.approx(5.2e8, rel=1e-12)
    np.testing.assert_allclose(cosine[:3], COSINE, atol=1e-12)
    np.testing.assert_allclose(sine[:3], SINE, atol=1e-12)


@pytest.mark.parametrize("words", UNITS)
def test_errors_in_every_unit_lead_to_the_same_stiffness(words: str) -> None:
    member, unit = words.split()
    loaded, unloaded = (values / UNITS[words] for values in errors())
    head = f"phase [1], loaded TE {member} 300 N m {unit}, unloaded TE {words}"
    result = convert(parse_table(csv(head, PHASE, loaded, unloaded)), MESH, 7)
    check(result)
    assert result.error is not None
    np.testing.assert_allclose(result.error.cosine[:3], ERROR_COSINE, atol=1e-18)
    np.testing.assert_allclose(result.error.sine[:3], ERROR_SINE, atol=1e-18)
    assert result.stiffness.deviation < 1e-12 * 5.2e8


def test_roll_angles_of_either_member_are_mesh_phases() -> None:
    for member, teeth in (("pinion", 14), ("gear", 39)):
        angle = 360 / teeth * PHASE
        check(convert(parse_table(csv(f"{member} angle [deg], stiffness [N/m]", angle, stiffness(PHASE))), MESH, 5))


def test_loads_between_columns_are_interpolated() -> None:
    low, high = 0.8 * stiffness(PHASE), 1.1 * stiffness(PHASE)
    table = parse_table(csv("phase [1], stiffness 400 N m [N/m], stiffness 250 N m [N/m]", PHASE, high, low))
    assert convert(table, MESH, 5).stiffness.mean == pytest.approx((0.8 * 2 / 3 + 1.1 / 3) * 5.2e8, rel=1e-12)
    head = "phase [1], loaded TE normal 300 N m [um], loaded TE normal 500 N m [um], unloaded TE normal [um]"
    (one, none), (two, _) = errors(), errors(torque=500.0)
    check(convert(parse_table(csv(head, PHASE, one * 1e6, two * 1e6, none * 1e6)), MESH, 5))
    between = MeshGeometry(MESH.teeth, MESH.pinion_radius, MESH.gear_radius, A3, "pinion", 420.0)
    check(convert(parse_table(csv(head, PHASE, one * 1e6, two * 1e6, none * 1e6)), between, 5))


LOADED, UNLOADED = (values * 1e6 for values in errors())
STEEP = 1.05 + np.where((PHASE > 0.2) & (PHASE < 0.8), -1.0, 1.0)
WRONG = [
    ("phase [1], loaded TE normal [um]", (LOADED,), "has no unloaded TE, without which it would count as deflection"),
    ("phase [1], unloaded TE normal [um]", (UNLOADED,), "has neither loaded TE nor stiffness"),
    (
        "phase [1], loaded TE normal [um], stiffness [N/m], unloaded TE normal [um]",
        (LOADED, LOADED, UNLOADED),
        "has both loaded TE and stiffness; expected columns of one of them",
    ),
    (
        "phase [1], loaded TE normal [um], unloaded TE normal [um], unloaded TE gear [um]",
        (LOADED, UNLOADED, UNLOADED),
        "has 2 columns of unloaded TE; expected one",
    ),
    (
        "phase [1], loaded TE normal [um], unloaded TE normal [um]",
        (-LOADED, UNLOADED),
        "line 2: loaded minus unloaded TE is -28.59 um along the normal; expected a positive deflection",
    ),
    ("phase [1], stiffness [N/m]", (np.cos(2 * np.pi * PHASE) + 1 - 1e-3,), "line 18: stiffness is -0.001 N"),
    ("phase [1], stiffness [N/m], stiffness 300 N m [N/m]", (LOADED, LOADED), "a different torque in the head"),
    ("phase [1], stiffness 200 N m [N/m], stiffness 250 N m [N/m]", (LOADED, LOADED), "torques 200, 250 N m; expected"),
    ("phase [1], stiffness 400 N m [N/m]", (LOADED,), "torques 400 N m; expected the pair's 300 N m on the pinion"),
    ("phase [1], stiffness [N/m]", (STEEP,), "truncation to 7 harmonics makes the mesh stiffness reach"),
]


@pytest.mark.parametrize(("head", "columns", "words"), WRONG)
def test_a_table_that_can_not_be_converted_is_one_sentence(
    head: str, columns: tuple[np.ndarray, ...], words: str
) -> None:
    with pytest.raises(PairError, match=re.escape(words)) as info:
        convert(parse_table(csv(head, PHASE, *columns), "table 'a.csv'"), MESH, 7)
    assert "\n" not in str(info.value)
    assert str(info.value).startswith("table 'a.csv'")


NUMBERS = (st.sampled_from([0.0, 1e-310, 1e-9, -1e15, 1e15, 1e308]) | st.floats(-1e15, 1e15) | st.floats(0.1, 9)).map(
    repr
)
CELLS = NUMBERS | st.text("0123456789.eE+-,;#nai ", max_size=6)
HEADS = st.sampled_from(
    ["phase [1], stiffness [N/um]", "gear angle [deg], loaded TE gear [urad], unloaded TE gear [urad]"]
)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(HEADS, st.lists(CELLS, min_size=9) | st.lists(NUMBERS, min_size=9, max_size=12), st.booleans())
def test_no_table_leads_to_another_error_than_one_sentence(head: str, cells: list[str], ordered: bool) -> None:
    columns = head.count(",")
    lines = [cells[i : i + columns] for i in range(0, len(cells), columns)]
    step = 360 / 39 if "gear" in head else 1.0
    first = [repr(step * i / max(1, len(lines) - 1)) for i in range(len(lines))]
    body = "\n".join(", ".join([a, *row] if ordered else row) for a, row in zip(first, lines, strict=True))
    message = ""
    try:
        result = convert(parse_table(f"{head}\n{body}\n"), MESH, 1)
        assert np.isfinite([result.stiffness.mean, *result.stiffness.cosine, *result.stiffness.sine]).all()
    except PairError as error:
        message = str(error)
    assert "\n" not in message


def test_a_shape_spans_what_it_says_and_repeats_the_closed_form() -> None:
    shape = StiffnessShape(contact_ratio=2.392, peak_to_peak=0.2, modification=0.65, rounding=0.3)
    for harmonics in (1, 5, 40):
        assert peak_to_peak(*shape.coefficients(harmonics)) == pytest.approx(0.13, rel=1e-11)
    theta = 2 * np.pi * np.linspace(-0.5, 0.5, 2001)
    curve = fourier_series(*shape.coefficients(200), theta)
    share = np.abs(theta) / (2 * np.pi)
    plateau, valley = curve[share < 0.196 - 0.16], curve[share > 0.196 + 0.16]
    assert np.ptp(plateau) < 2e-5
    assert np.ptp(valley) < 2e-5
    assert plateau.mean() - valley.mean() == pytest.approx(0.13, abs=2e-5)
    with pytest.raises(PairError, match="contact_ratio = 2 leaves no fluctuation"):
        StiffnessShape(contact_ratio=2.0, peak_to_peak=0.2).coefficients(5)


@pytest.fixture
def pair_file(tmp_path: Path) -> Callable[..., Path]:
    """Return a writer of iso-f2 with another state ``before`` (without its harmonics) and a table beside it."""

    def write(lines: str, *, remove: tuple[str, ...] = ("stiffness_cosine", "stiffness_sine")) -> Path:
        text = load_pair("iso-f2").to_toml()
        head, rest = text.split('[states."before"]\n')
        before, after = rest.split('\n[states."after"]', 1)
        kept = [line for line in before.splitlines() if not line.startswith(remove)]
        path = tmp_path / "pair.toml"
        path.write_text("\n".join([head + '[states."before"]', lines, *kept, '\n[states."after"]']) + after)
        columns = (PHASE, LOADED, UNLOADED)
        text = csv("phase [1], loaded TE normal 300 N m [um], unloaded TE normal [um]", *columns)
        (tmp_path / "before.csv").write_text(text)
        return path

    return write


TABLE = 'stiffness_table = "before.csv"\nstiffness_harmonics = 5'
ALL = ("stiffness_cosine", "stiffness_sine", "error_cosine", "error_sine")


def test_a_pair_file_takes_a_table_beside_it(pair_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    path = pair_file(TABLE, remove=ALL)
    pair = load_pair(path)
    before = pair.dimensionless("before")
    assert pair.derived is not None
    assert pair.derived.mesh_stiffness == pytest.approx(5.2e8, rel=1e-12)  # the mean of the table is k_0
    np.testing.assert_allclose(before.stiffness_cosine, (*COSINE, 0, 0), atol=1e-12)
    np.testing.assert_allclose(before.error_cosine[0] * pair.derived.half_backlash, 2e-6, rtol=1e-12)
    assert pair.dimensionless("after").stiffness_cosine == (0.08125, 0.0203125)
    rows = {(row.section, row.key): row for row in pair.rows()}
    assert rows["states.before", "stiffness_table"][2:5] == ("before.csv", "", "user")
    assert rows["states.before", "stiffness_cosine"].source == "derived"
    assert "mean 5.2e+08 N/m" in rows["states.before", "stiffness_cosine"].note
    assert "mean of states.before.stiffness_table" in rows["mesh", "stiffness"].note
    monkeypatch.chdir(path.parent)
    assert load_pair("pair.toml") == pair
    path.write_text(pair.to_toml())
    assert load_pair(path) == pair


def test_a_table_in_a_pair_file_that_can_not_be_used_is_one_sentence(pair_file: Callable[..., Path]) -> None:
    for lines, remove, words in [
        (TABLE, ALL[:2], "states.before.error_cosine stands beside the unloaded TE of stiffness_table"),
        (
            TABLE,
            ("error",),
            "states.before has stiffness_cosine and stiffness_table; expected the stiffness in one way",
        ),
        (TABLE.replace("5", "16"), ALL, "states.before.stiffness_table: table"),
        (TABLE.replace("before", "nope"), ALL, "states.before.stiffness_table: table"),
        ("stiffness_shape = {contact_ratio = 2, peak_to_peak = 0.1}\nstiffness_harmonics = 5", ALL, "no fluctuation"),
    ]:
        path = pair_file(lines, remove=remove)
        with pytest.raises(PairError, match=re.escape(words)) as info:
            load_pair(path)
        assert "\n" not in str(info.value)


def test_a_dimensionless_pair_takes_a_shape_but_no_table(tmp_path: Path) -> None:
    lines = load_pair("example").to_toml().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("stiffness_"))
    path = tmp_path / "pair.toml"
    path.write_text(text + "\nstiffness_shape = {contact_ratio = 1.4, peak_to_peak = 0.3}\nstiffness_harmonics = 4\n")
    state = load_pair(path).dimensionless()
    assert peak_to_peak(state.stiffness_cosine, state.stiffness_sine) == pytest.approx(0.3, rel=1e-11)
    path.write_text(text + '\nstiffness_table = "a.csv"\nstiffness_harmonics = 4\n')
    with pytest.raises(PairError, match=re.escape("dimensionless.stiffness_table needs the geometry of the pair")):
        load_pair(path)


def test_the_command_prints_and_writes_before_and_after(
    pair_file: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair_file(TABLE, remove=ALL)
    monkeypatch.chdir(tmp_path)
    weaker = 5.2e8 * (1 + 0.65 * fourier_series(COSINE, SINE, 2 * np.pi * PHASE))
    (tmp_path / "after.csv").write_text(csv("phase [1], stiffness [N/m]", PHASE, weaker))
    arguments = ["stiffness", "before.csv", "after.csv", "--pair", "iso-f2", "--json", "all.json", "--harmonics", "3"]
    for _ in range(2):  # its own earlier results are replaced
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output
    folder = tmp_path / "sbg-stiffness-iso-f2"
    assert {p.name for p in folder.iterdir()} >= {"stiffness.png", "summary.txt", "stiffness.json"}
    document = json.loads((tmp_path / "all.json").read_text())
    assert document == json.loads((folder / "stiffness.json").read_text())
    before, after = document["tables"]
    np.testing.assert_allclose(before["stiffness_cosine"], COSINE, atol=1e-12)
    np.testing.assert_allclose(after["stiffness_cosine"], 0.65 * np.array(COSINE), atol=1e-12)
    assert after["error_cosine"] == []
    assert document["normal_force"] == pytest.approx(14193.3, abs=0.1)
    assert "stiffness_cosine = [0.1, 0.02, -0.01]" in result.output
    upper, lower = Figure().subplots(2, 1)
    plot_stiffness(document["tables"], ax=upper)
    samples, line = upper.get_lines()[:2]
    np.testing.assert_allclose(samples.get_ydata(), np.array(before["samples"]) / 1e6)
    np.testing.assert_allclose(line.get_ydata() * 1e6, stiffness(series_curve(before)[0]), rtol=1e-12)
    plot_spectrum(document["tables"], ax=lower)
    heights = [bar.get_height() for bar in lower.patches]
    np.testing.assert_allclose(heights, [*np.hypot(COSINE, SINE), *0.65 * np.hypot(COSINE, SINE)], atol=1e-12)


def test_the_command_ends_with_2_and_a_sentence(pair_file: Callable[..., Path], tmp_path: Path) -> None:
    table = pair_file(TABLE, remove=ALL).with_name("before.csv")
    out = tmp_path / "out"
    for arguments, words in [
        ([table, "--pair", "iso-f2", "--harmonics", "16"], "32 samples in a mesh cycle are enough for 15 harmonics"),
        ([table, "--pair", "iso-f2", "--harmonics", "0"], "--harmonics = 0; expected a whole number from 1 to 200"),
        ([table, "--pair", "iso-f2", "--tolerance", "-1"], "--tolerance = -1; expected a share"),
        ([table, "--pair", "example"], "pair 'example' is dimensionless"),
        ([table, "--pair", "case1"], "expected the pair's 250 N m on the pinion"),
        ([tmp_path / "none.csv", "--pair", "iso-f2"], "No such file"),
    ]:
        result = CliRunner().invoke(app, ["stiffness", *map(str, arguments), "--out", str(out)])
        assert result.exit_code == 2
        assert words in result.output
        assert len(result.output.splitlines()) == 1
        assert not out.exists()
