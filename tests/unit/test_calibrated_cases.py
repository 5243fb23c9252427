"""The calibrated cases: they are pairs, say where their values come from, and give the stored numbers again."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import pytest

from continuation import HarmonicBalance
from sbg_casadi import gear_system, load_pair
from sbg_casadi.identification import load_targets

CASES = ("case1", "case2", "case3", "case4")
_FROM_THE_PAPER = {"teeth", "module", "pressure_angle", "torque"}


def stored(case: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((files("sbg_casadi") / "cases" / "targets" / f"{case}-found.json").read_text())
    return found


@pytest.mark.parametrize("case", CASES)
def test_values_found_are_tagged_with_the_command(case: str) -> None:
    pair, found = load_pair(f"{case}-calibrated"), stored(case)
    rows = {(row.section, row.key): row for row in pair.rows()}
    keys = {key for unknown in found["unknowns"] for key in unknown["keys"]}
    assert keys == {key for unknown in load_targets(case, load_pair(case)).unknowns for key in unknown.keys}
    for key in keys:
        parts = key.split(".")
        row = rows["states." + parts[1] if parts[0] == "states" else parts[0], parts[2 if parts[0] == "states" else 1]]
        assert row.source == "calibrated", row
        assert "found by sbg identify" in row.note
    calibrated = {row.key for row in pair.rows() if row.source == "calibrated"}
    assert not calibrated & _FROM_THE_PAPER
    assert all(command.startswith("sbg identify") for command in found["commands"])


@pytest.mark.parametrize("case", CASES)
def test_stored_numbers_come_again(case: str) -> None:
    """RMS of stable orbits of both states to 1e-6."""
    pair = load_pair(f"{case}-calibrated")
    for state, orbits in stored(case)["orbits"].items():
        problem = HarmonicBalance().discretise(gear_system(pair.dimensionless(state)), "frequency_ratio")
        assert orbits
        for one in orbits[:1]:
            orbit = problem.guess(frequency_ratio=one["frequency_ratio"])
            assert orbit.stability == "stable"
            assert orbit.rms("lambda") == pytest.approx(one["rms"], rel=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_states_share_all_but_the_mesh_stiffness(case: str) -> None:
    before, after = (load_pair(f"{case}-calibrated").dimensionless(s).to_dict() for s in ("before", "after"))
    differ = {key for key in before if before[key] != after[key]}
    assert differ <= {"state", "stiffness_cosine", "stiffness_sine"}


@pytest.mark.parametrize("case", CASES)
def test_residuals_say_what_was_met(case: str) -> None:
    found = stored(case)
    assert {row["target"] for row in found["targets"]} == {t.name for t in load_targets(case, load_pair(case)).targets}
    for row in found["targets"]:
        if row["quantity"] == "regime":
            assert row["met"] == (row["residual"] < 1)
        else:
            assert row["residual"] == pytest.approx((row["found"] - row["wanted"]) / row["tolerance"], abs=1e-6)
            assert row["met"] == (abs(row["residual"]) <= 1 + 1e-9)
