"""Readings, the ledger and the effect of its rows."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from typer.testing import CliRunner

from sbg_casadi import Dimensionless, UserError, gear_system, load_pair
from sbg_casadi.cli import app
from sbg_casadi.derived import direction_cosines, pitch_cone_angle
from sbg_casadi.ledger import effects, ledger_document, measure, row
from sbg_casadi.ledger_rows import MEASURED, ROWS
from sbg_casadi.quantities import quantities
from sbg_casadi.reading import PRESETS, SWITCHABLE, as_read, parse_reading, printed_cosines, reading_name
from sbg_casadi.study import run_study

SWITCHES = st.frozensets(st.sampled_from(SWITCHABLE))
ANGLES = st.tuples(st.floats(0.01, 1.5), st.floats(0.0, 1.5), st.floats(0.01, 0.78))


@given(SWITCHES)
def test_every_reading_has_a_name_that_gives_it_back(rows: frozenset[int]) -> None:
    assert parse_reading(reading_name(rows)) == rows


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("consistant", "did you mean 'consistent'"),
        ("", "expected consistent, printed, or some of the rows 1, 2, 3, 12"),
        ("1,,2", "expected consistent, printed"),
        ("1;2", "expected consistent, printed"),
        ("1,15", "row 15 of the ledger is no row that changes the equations"),
        ("0", "row 0 of the ledger"),
        ("1" * 5000, "of the ledger is no row"),
        ("²", "expected consistent"),
    ],
)
def test_unknown_readings_are_one_sentence(text: str, words: str) -> None:
    with pytest.raises(UserError) as caught:
        parse_reading(text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@given(ANGLES, st.sampled_from([1, -1]))
def test_direction_cosines_have_unit_length_unless_printed(angles: tuple[float, float, float], side: int) -> None:
    assert sum(a**2 for a in direction_cosines(*angles, side)) == pytest.approx(1, abs=1e-14)
    # Without spiral angle the printed form is right.
    alpha, _, delta = angles
    assert direction_cosines(alpha, 0.0, delta, side, printed=True) == pytest.approx(
        direction_cosines(alpha, 0.0, delta, side), abs=1e-15
    )


def test_the_printed_cosines_of_case_1_have_the_stated_norm() -> None:
    printed = direction_cosines(math.radians(20), math.radians(35), pitch_cone_angle(14, 41), 1, printed=True)
    assert sum(a**2 for a in printed) == pytest.approx(0.928, abs=5e-4)


def test_printed_cosines_follow_from_the_derived_ones() -> None:
    derived = load_pair("iso-f2").derived
    assert derived is not None
    expected = direction_cosines(math.radians(20), math.radians(35), derived.pitch_angle, 1, printed=True)
    assert printed_cosines(derived) == pytest.approx(expected, rel=1e-14)
    shown = {q["name"]: q["value"] for q in quantities(load_pair("iso-f2"), "before", frozenset({1}))}
    assert (shown["a1"], shown["a2"]) == pytest.approx(expected[:2])


def test_row_1_needs_angles() -> None:
    with pytest.raises(UserError, match="such as 2,3,12"):
        as_read(load_pair("example"), None, PRESETS["printed"])
    assert as_read(load_pair("example"), None, frozenset({12})) == load_pair("example").dimensionless()


def random_gear(rng: np.random.Generator) -> Dimensionless:
    return Dimensionless(
        name="random",
        state="only",
        torque=rng.uniform(0.05, 1.0),
        mesh_damping_ratio=rng.uniform(0.01, 0.1),
        tangential_cosine=rng.uniform(0.3, 1.0),
        directions=tuple(rng.uniform(-1, 1, 6).tolist()),
        mass_ratios=tuple(rng.uniform(0.01, 1, 6).tolist()),
        bearing_stiffness=tuple(rng.uniform(0.1, 3, 6).tolist()),
        bearing_damping=tuple(rng.uniform(0, 0.1, 6).tolist()),
        stiffness_cosine=(0.1, 0.05),
        stiffness_sine=(0.0, 0.02),
        error_cosine=(0.2, -0.1),
        error_sine=(0.05, 0.07),
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), SWITCHES)
def test_the_equations_of_any_reading_written_by_hand(seed: int, reading: frozenset[int]) -> None:
    rng = np.random.default_rng(seed)
    d, x, theta, ratio = random_gear(rng), rng.uniform(-3, 3, 14), rng.uniform(0, 7), rng.uniform(0.2, 3)
    j = np.array([1, 2])
    c, s = np.array(d.error_cosine), np.array(d.error_cosine if 3 in reading else d.error_sine)
    gap = x[0] - c @ np.cos(j * theta) - s @ np.sin(j * theta)
    e_rate = 0.0 if 2 in reading else ratio * (-(j * c) @ np.sin(j * theta) + (j * s) @ np.cos(j * theta))
    elastic = float(d.stiffness(theta)) * (np.sign(gap) * max(abs(gap) - 1, 0))
    damping = 2 * d.mesh_damping_ratio * (x[7] - e_rate)
    loads = np.full(6, elastic + damping)
    if 12 in reading:
        loads[5] = elastic + damping / 2  # z_g, equation (25)
    directions, mu = np.array(d.directions), np.array(d.mass_ratios)
    second = -directions * mu * loads - 2 * np.array(d.bearing_damping) * x[8:]
    second -= np.array(d.bearing_stiffness) * x[1:7]
    a3 = d.tangential_cosine
    total = directions @ second + a3 * d.torque - a3**2 * (elastic + damping)
    found = gear_system(d, reading).rhs(x, theta, frequency_ratio=ratio)
    assert found == pytest.approx(np.concatenate([x[7:], [total], second]), rel=1e-12, abs=1e-12)


def test_rows_that_change_no_equation_are_refused() -> None:
    with pytest.raises(UserError, match="row 5; expected some of the rows 1, 2, 3, 12"):
        gear_system(load_pair("example").dimensionless(), frozenset({5}))


def test_the_ledger_is_complete() -> None:
    assert [r.number for r in ROWS] == list(range(1, 21))
    assert all(text.strip() for r in ROWS for text in (r.place, r.printed, r.consistent, r.effect))
    assert set(MEASURED) == {(n, added) for n in (0, *SWITCHABLE) for added in (False, True)}
    with pytest.raises(UserError, match="expected a number from 1 to 20"):
        row(21)


def test_rows_2_and_3_do_nothing_without_transmission_error_and_all_do_something_with_it() -> None:
    for number in SWITCHABLE:
        filed, excited = effects(number)
        assert (filed.printed == filed.consistent) == (number in (2, 3))
        assert abs(excited.peak_change) > 0.02


@pytest.mark.parametrize(("number", "added"), [(0, False), (12, False), (1, False), (3, True)])
def test_stored_effects_are_what_is_computed(number: int, added: bool) -> None:
    found, stored = measure(frozenset({number} - {0}), added_error=added), MEASURED[number, added]
    assert found.peak_rms == pytest.approx(stored.peak_rms, rel=1e-3)
    assert [kind for kind, _ in found.points] == [kind for kind, _ in stored.points]
    assert [v for _, v in found.points] == pytest.approx([v for _, v in stored.points], abs=2e-7)


def test_ledger_command_prints_and_writes_every_row(tmp_path: Path) -> None:
    path = tmp_path / "ledger.json"
    result = CliRunner().invoke(app, ["ledger", "--json", str(path)], env={"COLUMNS": "400"})
    assert result.exit_code == 0
    document = json.loads(path.read_text())
    assert document == json.loads(json.dumps(ledger_document()))
    assert [len(r["measured"]) for r in document["rows"]] == [2 * (n in SWITCHABLE) for n in range(1, 21)]
    assert "-4.0 %" in result.stdout


def test_reading_option_reaches_the_equations_and_the_json(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    options = ["--from", "2.6", "--to", "2.5", "--json", str(path)]
    result = CliRunner().invoke(app, ["response", "iso-f2", *options, "--reading", "12,1"])
    assert result.exit_code == 0
    assert "equations in the reading 1,12" in result.stdout
    printed = json.loads(path.read_text())
    assert printed["reading"] == "1,12"
    assert CliRunner().invoke(app, ["response", "iso-f2", *options]).exit_code == 0
    consistent = json.loads(path.read_text())
    assert consistent["reading"] == "consistent"
    rms = [d["branches"][0]["points"][0]["rms"] for d in (printed, consistent)]
    assert abs(rms[0] / rms[1] - 1) > 1e-3


def test_a_study_says_which_reading_it_used(tmp_path: Path) -> None:
    screen = Console(file=io.StringIO(), width=160)
    more = {"json_file": None, "console": screen, "sweep_points": 2, "reading": frozenset({1})}
    assert run_study("iso-f2", out=tmp_path / "out", start=2.6, stop=2.55, **more) == 0
    document = json.loads((tmp_path / "out" / "study.json").read_text())
    assert document["reading"] == "1"
    # Branch and sweeps are of the same equations.
    assert [s["cross_check"]["compared"] for s in document["states"]] == [4, 4]
    assert all(s["cross_check"]["largest_difference"] < 1e-6 for s in document["states"])
    text = (tmp_path / "out" / "summary.txt").read_text()
    assert "equations in the reading 1" in text
    assert "direction cosine, as printed" in text


@pytest.mark.parametrize("command", ["response", "study"])
def test_a_bad_reading_ends_with_one_sentence(command: str) -> None:
    result = CliRunner().invoke(app, [command, "iso-f2", "--reading", "prnted"])
    assert result.exit_code == 2
    assert "did you mean 'printed'?" in result.stderr
    assert result.stderr.count("\n") == 1
