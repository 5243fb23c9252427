"""Identification: gradients against differences, synthetic targets, what is not determined, the command."""

from __future__ import annotations

import io
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

import sbg_casadi.identification.procedure as procedure
from continuation import ContinuationError, HarmonicBalance
from sbg_casadi import UserError, gear_system, identify, load_pair
from sbg_casadi.cli import app
from sbg_casadi.identification import Identification, Settings, read_targets
from sbg_casadi.identification.following import Follower, follow
from sbg_casadi.identification.parametric import parametric
from sbg_casadi.identification.refinement import build_model
from sbg_casadi.identification.run import run_identify
from sbg_casadi.identification.runs import Runs
from sbg_casadi.identification.sensitivity import fold_at, orbit_at, peak_at
from sbg_casadi.identification.targets import Target
from sbg_casadi.identification.unknowns import Candidates

BAND = [0.9, 1.2]
NAMES = ("torque", "mesh_damping_ratio", "directions_x_p", "stiffness_sine_2")


@pytest.fixture(scope="module")
def problem() -> Any:
    d = load_pair("example").dimensionless()
    return HarmonicBalance(harmonics=31).discretise(parametric(d, 2).system, "frequency_ratio")


def differences(problem: Any, solve: Any, names: tuple[str, ...] = NAMES, step: float = 1e-5) -> np.ndarray:
    """Central differences (names, 2) of ratio and RMS."""
    rows = []
    for name in names:
        value, ends = problem.values[name], []
        for side in (1, -1):
            problem.set_value(name, value + side * step)
            found = solve(())
            ends.append((found.ratio, found.rms))
        problem.set_value(name, value)
        rows.append((np.array(ends[0]) - np.array(ends[1])) / (2 * step))
    return np.array(rows)


def test_orbit_gradient_is_the_derivative(problem: Any) -> None:
    u = problem.unknown(problem.guess(frequency_ratio=0.8))
    found = orbit_at(problem, u, 0.8, NAMES)
    measured = differences(problem, lambda names: orbit_at(problem, found.u, 0.8, names))
    np.testing.assert_allclose(found.rms_gradient, measured[:, 1], rtol=1e-6, atol=1e-8)
    assert not found.ratio_gradient.any()


def test_peak_gradient_is_the_derivative(problem: Any) -> None:
    """The position is a second derivative of the orbit: differences of exact first ones err by 1e-5."""
    u = problem.unknown(problem.guess(frequency_ratio=1.04))
    found = peak_at(problem, u, 1.04, NAMES, (0.95, 1.15))
    measured = differences(problem, lambda names: peak_at(problem, found.u, found.ratio, names, (0.95, 1.15)))
    np.testing.assert_allclose(found.rms_gradient, measured[:, 1], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found.ratio_gradient, measured[:, 0], rtol=1e-3, atol=1e-6)


def test_fold_gradient_is_the_derivative() -> None:
    """A jump is followed as the nearest fold of the traced response."""
    d = load_pair("example").dimensionless()
    equations = parametric(d, 2)
    jump = Target("jump", "only", "jump", float("nan"), (("position", 0.52, 0.001),), band=(0.521, 0.524))
    follower = follow(equations, Runs(equations), jump, 0, d)
    assert isinstance(follower, Follower)
    assert (follower.kind, follower.ratio) == ("fold", pytest.approx(0.5223924391, abs=1e-8))
    problem = follower.problem
    found = fold_at(problem, follower.u, follower.ratio, NAMES[:2])
    measured = differences(problem, lambda names: fold_at(problem, found.u, found.ratio, names), NAMES[:2])
    np.testing.assert_allclose(found.ratio_gradient, measured[:, 0], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(found.rms_gradient, measured[:, 1], rtol=1e-5, atol=1e-7)
    assert abs(found.ratio_gradient[0]) < 1e-10  # one flank alone: lambda - 1 scales with the load, no fold moves


def test_parametric_equations_are_those_of_the_pair() -> None:
    """Right-hand sides at random states, both states of iso-f2 by one System."""
    pair, rng = load_pair("iso-f2"), np.random.default_rng(1)
    equations = parametric(pair.dimensionless("before"), 3)
    for state in pair.states:
        d = pair.dimensionless(state)
        own = gear_system(d)
        for _ in range(3):
            x, theta = rng.standard_normal(14), rng.uniform(0, 6)
            expected = own.rhs(x, theta, frequency_ratio=0.7)
            found = equations.system.rhs(x, theta, frequency_ratio=0.7, **equations.values(d))
            np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


# ------------------------------------------------------------------------------------------ synthetic targets
TRUE = {"dimensionless.mesh_damping_ratio": 0.02, "dimensionless.stiffness_cosine.1": 0.3,
        "dimensionless.bearing_stiffness.z_p": 2.0}  # fmt: skip
UNKNOWNS = [
    {"key": "dimensionless.mesh_damping_ratio", "bounds": [0.01, 0.05], "scale": "log"},
    {"key": "dimensionless.stiffness_cosine.1", "bounds": [0.2, 0.4]},
    {"key": "dimensionless.bearing_stiffness.z_p", "bounds": [1.0, 4.0], "scale": "log"},
    {"key": "dimensionless.bearing_damping.y_p", "bounds": [0.01, 0.04]},
]


@cache
def synthetic() -> dict[str, Any]:
    """Targets of the example as it is."""
    problem = HarmonicBalance().discretise(gear_system(load_pair("example").dimensionless()), "frequency_ratio")
    u = problem.unknown(problem.guess(frequency_ratio=1.04))
    peak = peak_at(problem, u, 1.04, (), (0.95, 1.15))
    at = {ratio: problem.guess(frequency_ratio=ratio).rms("lambda") for ratio in (0.8, 0.45, 2.5)}
    targets: list[dict[str, Any]] = [
        {"kind": "rms", "at": ratio, "value": rms, "tolerance": 0.01 * rms} for ratio, rms in at.items()
    ]
    targets.append({"kind": "peak", "height": peak.rms, "height_tolerance": 0.01 * peak.rms, "band": BAND,
                    "position": peak.ratio, "position_tolerance": 0.002})  # fmt: skip
    targets.append({"kind": "regime", "at": 0.8, "regime": "period-1"})
    return {"title": "the example itself", "unknowns": UNKNOWNS, "targets": targets}


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example with three wrong values."""
    text = load_pair("example").to_toml()
    for old, new in (
        ("[0.3, 0.1]", "[0.24, 0.1]"),
        ("[2.0, 2.0, 2.0,", "[2.0, 2.0, 1.2,"),
        ("{value = 0.02", "{value = 0.04"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path_factory.mktemp("pairs") / "wrong.toml"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def recovered(wrong: Path) -> Identification:
    return identify(wrong, synthetic(), settings=Settings(seed=1, evaluations=8, refined=1))


def test_recovers_what_the_targets_determine(recovered: Identification) -> None:
    for name, value in TRUE.items():
        assert recovered.found[name] == pytest.approx(value, rel=1e-2)
    assert recovered.cost < 1e-3
    assert recovered.words[-1] == "period-1"


def test_names_what_the_targets_do_not_determine(recovered: Identification) -> None:
    judged = recovered.determinacy
    assert judged is not None
    assert judged.determined.tolist() == [True, True, True, False]
    assert judged.singular_values[0] > 50 > 1 > judged.singular_values[-1]
    assert abs(judged.directions[-1][-1]) > 0.95


def test_pair_found_is_a_pair_file(recovered: Identification, tmp_path: Path) -> None:
    path = tmp_path / "found.toml"
    path.write_text(recovered.pair.to_toml())
    again = load_pair(path)
    assert again == recovered.pair
    rows = {row.key: row for row in again.rows()}
    assert rows["mesh_damping_ratio"].source == "calibrated"
    assert rows["mesh_damping_ratio"].note.startswith("found by")
    assert rows["torque"].source == "assumed"


# ------------------------------------------------------------------------------------------ no gradient, conflicts
def test_what_no_target_touches_is_not_determined() -> None:
    """Targets of one state say nothing of the other's stiffness; two targets that exclude each other are named."""
    wanted = {
        "unknowns": [
            {"key": "states.before.stiffness_cosine.1", "bounds": [0.05, 0.2]},
            {"key": "states.after.stiffness_cosine.1", "bounds": [0.05, 0.2]},
        ],
        "targets": [
            {"name": "low", "state": "before", "kind": "rms", "at": 1.5, "value": 0.03, "tolerance": 0.0005},
            {"name": "high", "state": "before", "kind": "rms", "at": 1.5, "value": 0.04, "tolerance": 0.0005},
        ],
    }
    found = identify("iso-f2", wanted, settings=Settings(evaluations=0))
    assert found.determinacy is not None
    assert found.determinacy.determined.tolist() == [True, False]
    assert found.determinacy.errors[1] == pytest.approx(1 / np.sqrt(12), rel=1e-9)
    assert found.residuals == pytest.approx([10.0, -10.0], abs=0.5)  # the middle
    assert {(c.target, c.others) for c in found.conflicts if c.evidence == "gradient"} == {("low", ("high",))}


def test_no_pair_in_the_bounds() -> None:
    wanted = {
        "unknowns": [{"key": "states.before.stiffness_cosine.1", "bounds": [3.0, 4.0]}],
        "targets": [{"state": "before", "kind": "rms", "at": 1.5, "value": 0.01, "tolerance": 0.001}],
    }
    with pytest.raises(UserError, match="no candidate inside the bounds is a pair"):
        identify("iso-f2", wanted, settings=Settings(evaluations=4))


# ------------------------------------------------------------------------------------------ the command
QUICK = """
title = "one number"
[[unknowns]]
key = "dimensionless.stiffness_cosine.1"
bounds = [0.25, 0.35]
[[targets]]
kind = "rms"
at = 2.5
value = 0.009
tolerance = 1e-4
[[targets]]
kind = "regime"
at = 2.5
regime = "chaotic"
"""


def run(tmp_path: Path, **more: Any) -> tuple[int, str]:
    (tmp_path / "targets.toml").write_text(QUICK)
    screen = Console(file=io.StringIO(), width=160, highlight=False)
    settings: dict[str, Any] = {"settings": Settings(evaluations=0), "json_file": None, "out": tmp_path / "out"}
    code = run_identify("example", str(tmp_path / "targets.toml"), console=screen, **settings | more)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


def test_one_set_of_numbers(tmp_path: Path) -> None:
    code, text = run(tmp_path, json_file=tmp_path / "copy.json")
    assert code == 0
    document = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert document == json.loads((tmp_path / "copy.json").read_text())
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "pair.toml",
        "summary.txt",
        "identify.json",
        ".sbg-results",
    }
    assert (document["schema"], document["complete"]) == (1, True)
    rms, regime = document["targets"]
    assert (rms["met"], regime["met"], regime["found"]) == (True, False, "period-1")
    assert rms["found"] == pytest.approx(0.009, rel=1e-6)
    value = document["unknowns"][0]
    assert f"{value['value']:.6g}" in text
    assert f"{value['standard_error']:.2g}" in text
    assert "1 of 2 met" in text
    assert "MISSED" in text
    pair = load_pair(tmp_path / "out" / "pair.toml")
    assert pair.dimensionless().stiffness_cosine[0] == value["value"]
    note = next(row.note for row in pair.rows() if row.key == "stiffness_cosine")
    assert note.startswith("harmonic 1 found by sbg identify example targets --seed 0 --evaluations 0 --refined 2")
    problem = HarmonicBalance().discretise(gear_system(pair.dimensionless()), "frequency_ratio")
    assert problem.guess(frequency_ratio=2.5).rms("lambda") == pytest.approx(rms["found"], rel=1e-6)


def test_interrupt_keeps_the_best_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls, real = iter(range(100)), procedure.score

    def stop(*args: Any) -> Any:
        if next(calls) == 5:
            raise KeyboardInterrupt
        return real(*args)

    monkeypatch.setattr(procedure, "score", stop)
    code, text = run(tmp_path, settings=Settings(evaluations=50))
    assert code == 3
    assert "FINISHED IN PART: interrupted" in text
    document = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert (document["complete"], document["candidates"]) == (False, 5)
    load_pair(tmp_path / "out" / "pair.toml")


def test_interrupt_of_the_check_keeps_the_values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*args: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(procedure, "check_targets", stop)
    code, text = run(tmp_path, settings=Settings(evaluations=0, refined=0))
    assert code == 3
    assert "the values are not checked" in text
    document = json.loads((tmp_path / "out" / "identify.json").read_text())
    assert [row["found"] for row in document["targets"]][1] == "period-1"


def test_bad_input_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "targets.toml").write_text(QUICK.replace("stiffness_cosine", "stifness_cosine"))
    result = CliRunner().invoke(app, ["identify", "example", "targets.toml"])
    assert result.exit_code == 2
    assert "did you mean 'dimensionless.stiffness_cosine.1'" in result.output
    assert [p.name for p in tmp_path.iterdir()] == ["targets.toml"]
    result = CliRunner().invoke(app, ["identify", "example", "none.toml"])
    assert result.exit_code == 2


def test_a_candidate_that_can_not_be_refined_is_told(wrong: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: Any) -> Any:
        raise ContinuationError("no orbit")

    monkeypatch.setattr(procedure, "build_model", fail)
    targets = synthetic()["targets"][:1]
    found = identify(wrong, {"unknowns": UNKNOWNS, "targets": targets}, settings=Settings(evaluations=3, refined=1))
    assert any("was not refined: no orbit" in note for note in found.notes)
    assert found.determinacy is None


def test_the_model_is_exact_in_all_unknowns(wrong: Path) -> None:
    """Derivatives of all residuals in the coordinates of the unknowns against differences."""
    pair = load_pair(wrong)
    targets = read_targets(synthetic(), pair)
    candidates, equations = Candidates(pair, targets.unknowns, Path()), parametric(pair.dimensionless(), 2)
    model = build_model(candidates, equations, Runs(equations), targets.targets, candidates.given())
    t = candidates.given()
    _, exact = model.linearise(t)
    for i in (0, 2):  # a logarithmic unknown and one of a list
        ends = []
        for side in (1, -1):
            moved = t.copy()
            moved[i] += side * 1e-5
            ends.append(model.residuals(moved))
        np.testing.assert_allclose(exact[:, i], (ends[0] - ends[1]) / 2e-5, rtol=1e-3, atol=1e-3)
