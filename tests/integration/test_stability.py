"""Floquet reports of real pairs: known special points, invariants, independent decay, folder rules and exit codes."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner, Result

import sbg_casadi.agreement as agreement_module
import sbg_casadi.stability as stability_module
from continuation import Branch, certify, trace
from sbg_casadi import gear_system, load_pair
from sbg_casadi.cli import app
from sbg_casadi.coexisting import crossings
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.outputs import dimensionless_outputs
from sbg_casadi.report import ratio
from sbg_casadi.response import trace_response
from sbg_casadi.results import MARKER
from sbg_casadi.stability import find_orbits, stability_document

EXAMPLE = load_pair("example")
NUMBERS = EXAMPLE.dimensionless()
SPAN = (0.5, 1.6)
FILES = {MARKER, "stability.png", "summary.txt", "stability.json", "orbit.nc"}

FOLDS = (0.5223924391, 0.6076292998, 1.5210287084, 1.5224413123)  # of the example, by an independent code
DOUBLINGS = (0.5225771384, 0.5904190535, 1.2774983866, 1.4160415167)


@pytest.fixture(scope="module")
def traced() -> tuple[Any, Branch]:
    return trace_response(NUMBERS, SPAN)


Report = Callable[..., dict[str, Any]]


@pytest.fixture(scope="module")
def report(traced: tuple[Any, Branch]) -> Report:
    """Return the document of an orbit of the example; each is computed once."""
    made: dict[tuple[float, int | None], dict[str, Any]] = {}

    def make(at: float, number: int | None = None) -> dict[str, Any]:
        if (at, number) not in made:
            found = find_orbits(*traced, at, number, SPAN[1])
            made[at, number] = stability_document(EXAMPLE, NUMBERS, found, traced[0])
        return made[at, number]

    return make


@pytest.mark.parametrize(
    ("at", "number", "verdict", "lower", "higher"),
    [
        (0.55, 1, "stable", None, ("fold", FOLDS[1])),
        (0.55, 2, "unstable", ("fold", FOLDS[0]), ("fold", FOLDS[1])),
        (0.55, 3, "unstable", ("period-doubling", DOUBLINGS[0]), ("period-doubling", DOUBLINGS[1])),
        (0.5225, 3, "stable", ("fold", FOLDS[0]), ("period-doubling", DOUBLINGS[0])),
        (1.35, 1, "unstable", ("period-doubling", DOUBLINGS[2]), ("period-doubling", DOUBLINGS[3])),
        (1.5217, 1, "stable", ("period-doubling", DOUBLINGS[3]), ("fold", FOLDS[3])),
        (1.5217, 2, "unstable", ("fold", FOLDS[2]), ("fold", FOLDS[3])),
        (1.5217, 3, "stable", ("fold", FOLDS[2]), None),
    ],
)
def test_what_lies_around_an_orbit_is_where_it_is_known_to_lie(
    report: Report,
    at: float,
    number: int,
    verdict: str,
    lower: tuple[str, float] | None,
    higher: tuple[str, float] | None,
) -> None:
    document = report(at, number)
    assert document["stability"] == verdict
    known = {"lower": lower, "higher": higher}
    for way, point in known.items():
        entries = document["around"][way]
        assert len(entries) == (0 if point is None else 1)
        if point is not None:
            (entry,) = entries
            assert entry["kind"] == point[0]
            assert entry["distance"] == pytest.approx(point[1] - at, abs=1e-9)
            assert abs(entry["frequency_ratio"] - point[1]) <= entry["error"] + 1e-10
            assert entry["beyond"] == ("unstable" if verdict == "stable" else "stable")
            assert entry["status"] == "located"
    nearest = min((p for p in known.values() if p is not None), key=lambda p: abs(p[1] - at))
    assert document["nearest"]["kind"] == nearest[0]
    assert document["nearest"]["distance"] == pytest.approx(nearest[1] - at, abs=1e-9)
    assert document["failures"] == []


@pytest.mark.parametrize(("at", "number", "kind"), [(0.55, 2, "fold"), (0.55, 3, "period-doubling")])
def test_the_type_of_instability_is_that_of_the_points_at_its_ends(
    report: Report, at: float, number: int, kind: str
) -> None:
    (found,) = report(at, number)["instabilities"]
    assert found["type"] == kind
    assert np.sign(found["multiplier"][0]) == (1 if kind == "fold" else -1)


def trace_of(d: Dimensionless) -> float:
    """Return the constant trace of the equations: every damping counts twice, the mesh with a3^2 + sum s^2 mu."""
    mesh = d.tangential_cosine**2 + sum(s**2 * mu for s, mu in zip(d.directions, d.mass_ratios, strict=True))
    return -2 * d.mesh_damping_ratio * mesh - 2 * sum(d.bearing_damping)


@pytest.mark.parametrize(("at", "number"), [(0.55, 1), (0.55, 2), (0.55, 3), (1.35, 1), (1.5217, 3)])
def test_the_multipliers_multiply_to_liouville_s_determinant(report: Report, at: float, number: int) -> None:
    document = report(at, number)
    rows = document["multipliers"]
    assert sum(2 if r["pair"] else 1 for r in rows) == 14
    product = np.prod([r["modulus"] ** (2 if r["pair"] else 1) for r in rows])
    bars = sum((2 if r["pair"] else 1) * r["error"] / r["modulus"] for r in rows)
    expected = np.exp(trace_of(NUMBERS) * document["mesh_period"])
    assert product == pytest.approx(expected, rel=bars)
    assert sum((2 if r["pair"] else 1) * r["exponent"][0] for r in rows) == pytest.approx(np.log(expected), abs=bars)


@pytest.mark.parametrize(("at", "number"), [(0.55, 1), (0.55, 2), (0.55, 3), (1.35, 1), (1.5217, 1)])
def test_the_methods_agree_and_the_errors_cover_their_differences(report: Report, at: float, number: int) -> None:
    document = report(at, number)
    found = document["agreement"]
    assert set(found["multipliers"]) == {"Hill, strip", "Hill, symmetric", "shooting"}
    assert max(found["multipliers"].values()) < 1e-5
    assert max(r["error"] for r in document["multipliers"]) >= max(found["multipliers"].values())
    assert found["waveform"] < 1e-6
    assert found["waveform"] <= document["waveform_error"]
    assert found["contact_deg"] < 1e-3
    assert abs(found["liouville"]) < 1e-9
    assert found["missing"] == {}


def test_a_disturbance_decays_as_the_leading_multipliers_say(report: Report, traced: tuple[Any, Branch]) -> None:
    """SciPy integrates a disturbed motion; its deviations at phase 0 obey the recurrence of the leading pair."""
    document, at = report(0.55, 1), 0.55
    system = gear_system(NUMBERS)
    f = ca.Function("f", [system.x, system.theta, system.p], [system.closed()])
    p = system.parameter_vector({"frequency_ratio": at})
    orbit = crossings(*traced, at)[0][0].orbit
    start = orbit.evaluate(np.zeros(1))[0]
    first, count = 22, 34
    run = solve_ivp(
        lambda t, x: f(x, at * t, p).full().ravel(),
        (0.0, count * orbit.period),
        start + 0.02 * np.eye(14)[0],
        method="DOP853",
        t_eval=np.arange(first, count + 1) * orbit.period,
        rtol=1e-9,
        atol=1e-12,
    )
    z = run.y[0] - start[0]
    square, twice_real = np.linalg.lstsq(np.column_stack([-z[:-2], z[1:-1]]), z[2:], rcond=None)[0]
    leading = document["multipliers"][0]
    assert np.sqrt(square) == pytest.approx(leading["modulus"], rel=2e-3)
    assert twice_real / 2 == pytest.approx(leading["multiplier"][0], abs=5e-3)
    assert -2 / np.log(square) == pytest.approx(leading["mesh_periods"], rel=2e-2)


def test_contact_waveform_and_force_are_those_of_the_outputs(report: Report, traced: tuple[Any, Branch]) -> None:
    document = report(0.55, 3)
    orbit = crossings(*traced, 0.55)[0][2].orbit
    outputs = dimensionless_outputs(orbit, NUMBERS)
    assert document["dynamic_factor"] == float(outputs.dynamic_factor)
    assert document["mesh_force"]["mean"] == pytest.approx(NUMBERS.mean_force, abs=1e-6)
    assert document["contact_shares"]["free"] == pytest.approx(float(outputs.separation), abs=1e-5)
    assert document["contact_shares"]["coast"] == float(outputs.back_contact) == 0.0
    assert sum(document["contact_shares"].values()) == pytest.approx(1.0, abs=1e-14)
    for row in document["contact"]:
        ends = np.radians([row["from_deg"], row["to_deg"]])
        lam = orbit.evaluate(ends)[:, 0]
        np.testing.assert_allclose(lam, 1.0, atol=1e-9)  # e = 0: contact ends where lambda = 1
    wave = document["waveform"]
    phases = np.radians(wave["phase_deg"])
    slope = np.gradient(wave["lambda"], phases) * 0.55
    assert np.abs(slope - wave["rate"])[1:-1].max() < 2e-3


def test_harmonics_rebuild_a_smooth_waveform(report: Report) -> None:
    document = report(1.35, 1)
    theta = np.radians(document["waveform"]["phase_deg"])
    wave = document["lambda"]["mean"] + sum(
        h["amplitude"] * np.cos(h["order"] * theta + np.radians(h["phase_deg"])) for h in document["harmonics"]
    )
    np.testing.assert_allclose(wave, document["waveform"]["lambda"], atol=1e-10)
    rms = np.sqrt(sum(h["amplitude"] ** 2 for h in document["harmonics"]) / 2)
    assert rms == pytest.approx(document["lambda"]["rms"], rel=1e-9)


def test_all_sheets_are_found_beside_a_fold_and_in_order(traced: tuple[Any, Branch]) -> None:
    for distance in (1e-4, 1e-6, 1e-8, 3e-10):
        found, missing = crossings(*traced, FOLDS[2] + distance)
        assert missing == []
        assert len(found) == 3
        assert [c.orbit.stability for c in found][1:] == ["unstable", "stable"]
        assert found[1].place < found[2].place
        gap = found[2].orbit.rms("lambda") - found[1].orbit.rms("lambda")
        assert gap > 0  # the sheets meet at the fold like a square root
        assert gap == pytest.approx(0.6767 * np.sqrt(distance), rel=0.6)
    found, missing = crossings(*traced, FOLDS[2] - 1e-8)
    assert (len(found), missing) == (1, [])


def test_an_orbit_at_a_doubling_is_undecided(report: Report, traced: tuple[Any, Branch]) -> None:
    point = next(p for p in traced[1].special_points if abs(p.parameter - DOUBLINGS[1]) < 1e-8)
    document = report(point.parameter + 2 * point.error, 3)
    assert document["stability"] == document["orbits"][2]["stability"] == "undecided"
    assert "lies within its error bar of " in document["reason"]
    assert document["nearest"]["kind"] == "period-doubling"
    assert abs(document["nearest"]["distance"]) <= 3 * point.error
    assert document["instabilities"] == []


def test_a_ratio_within_the_error_of_a_fold_is_reported_in_part(traced: tuple[Any, Branch]) -> None:
    fold = next(p for p in traced[1].special_points if p.kind == "fold" and abs(p.parameter - FOLDS[2]) < 1e-6)
    found = find_orbits(*traced, fold.parameter, None, SPAN[1])
    assert any("its two orbits may or may not exist there" in text for text in found.failures)


# -------------------------------------------------------------------------------------------- the command
def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["stability", *(str(a) for a in arguments)])


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch, traced: tuple[Any, Branch]) -> None:
    """Let the command take the branch that is there already."""
    monkeypatch.setattr(stability_module, "trace_response", lambda *_, **__: traced)


RANGE = ("--from", SPAN[0], "--to", SPAN[1])


@pytest.mark.usefixtures("known")
def test_the_command_writes_one_set_of_numbers(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run("example", "--at", 0.55, "--branch", 3, *RANGE, "--out", out, "--json", out / "mine.json")
    assert result.exit_code == 0, result.stderr
    assert {p.name for p in out.iterdir()} == FILES | {"mine.json"}
    document = json.loads((out / "stability.json").read_text())
    assert document == json.loads((out / "mine.json").read_text())
    assert (document["schema"], document["branch"], document["range"]) == (1, 3, list(SPAN))
    text = (out / "summary.txt").read_text()
    for shown in (text, result.stdout):
        for row in document["multipliers"]:
            assert f"{row['modulus']:.8f}" in shown
            assert f"{row['mesh_periods']:.6g}" in shown
        for row in document["contact"]:
            assert f"{row['from_deg']:.4f}" in shown
        for entry in (*document["around"]["lower"], *document["around"]["higher"]):
            assert ratio(entry["frequency_ratio"]) in shown
        for o in document["orbits"]:
            assert f"{o['rms']:.6f}" in shown
        assert f"dynamic factor {document['dynamic_factor']:.6f}" in shown
    (orbit,) = Branch.load(out / "orbit.nc").orbits
    assert orbit.rms("lambda") == document["lambda"]["rms"]
    assert max(abs(orbit.multipliers)) == document["multipliers"][0]["modulus"]
    assert (out / "stability.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_without_a_number_the_first_stable_orbit_is_taken(traced: tuple[Any, Branch]) -> None:
    assert [find_orbits(*traced, at, None, SPAN[1]).chosen for at in (0.55, 0.5225, 1.35)] == [0, 0, 0]
    whole = find_orbits(*traced, 0.5225, None, SPAN[1])
    assert [c.orbit.stability for c in whole.crossings] == ["stable", "unstable", "stable"]
    backward = dataclasses.replace(
        traced[1],
        orbits=traced[1].orbits[::-1],
        special_points=tuple(
            dataclasses.replace(p, index=len(traced[1]) - 2 - p.index) for p in traced[1].special_points[::-1]
        ),
    )
    found = find_orbits(traced[0], backward, 0.55, None, SPAN[0])
    assert [c.orbit.stability for c in found.crossings] == ["unstable", "unstable", "stable"]
    assert found.chosen == 2  # in the other order along the branch


@pytest.mark.usefixtures("known")
def test_an_unknown_number_lists_the_orbits_and_writes_nothing(tmp_path: Path) -> None:
    result = run("example", "--at", 0.55, "--branch", 4, *RANGE, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "1 (RMS 0.091798, stable), 2 (RMS 0.307389, unstable), 3 (RMS 0.397486, unstable)" in result.stderr
    assert result.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("example", "--at", 3), "--at = 3 lies outside the range that is traced, 0.3 to 2.6"),
        (("example", "--at", "nan"), "--at = nan; expected a positive frequency ratio"),
        (("example", "--at", -1), "--at = -1; expected"),
        (("example", "--at", 0.55, "--branch", 0), "--branch = 0; expected a number from 1"),
        (("example", "--at", 0.55, "--from", 1, "--to", 1), "empty range"),
        (("example", "--at", 0.55, "--reading", "1"), "row 1 is about direction cosines"),
        (("example", "--at", 0.55, "--reading", "nonsense"), "reading 'nonsense'"),
        (("iso-f2", "--at", 0.55, "--state", "afetr"), "no state 'afetr'"),
        (("iso-f3", "--at", 0.55), "did you mean 'iso-f2'"),
        (("example", "--at", 0.55, "--out", "/no/such/folder/out"), "there is no folder"),
    ],
)
def test_bad_input_is_refused_before_any_work(
    arguments: tuple[object, ...], words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def begin(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr(stability_module, "trace_response", begin)
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_response_that_ends_early_is_finished_in_part(
    monkeypatch: pytest.MonkeyPatch, traced: tuple[Any, Branch], tmp_path: Path
) -> None:
    problem, whole = traced
    short = trace(problem, whole.orbits[0], SPAN, max_points=6)
    monkeypatch.setattr(stability_module, "trace_response", lambda *_, **__: (problem, short))
    at = (short.orbits[2].value + short.orbits[3].value) / 2
    result = run("example", "--at", at, *RANGE, "--out", tmp_path / "out")
    assert result.exit_code == 3
    assert "FINISHED IN PART: the response ended early" in result.stdout
    assert short.stop in json.loads((tmp_path / "out" / "stability.json").read_text())["failures"][0]
    beyond = run("example", "--at", 1.5, *RANGE, "--out", tmp_path / "none")
    assert beyond.exit_code == 3
    assert beyond.stderr.startswith("sbg: the response ended early")
    assert not (tmp_path / "none").exists()


@pytest.mark.usefixtures("known")
def test_an_orbit_that_shooting_does_not_confirm_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(
        agreement_module,
        "certify",
        lambda problem, orbit: dataclasses.replace(certify(problem, orbit), missing={"shooting": "it runs away"}),
    )
    result = run("example", "--at", 0.55, *RANGE, "--out", tmp_path / "out")
    assert result.exit_code == 3
    assert "FINISHED IN PART: shooting did not confirm the orbit: it runs away" in result.stdout
    assert "shooting: not available, it runs away" in result.stdout
    assert json.loads((tmp_path / "out" / "stability.json").read_text())["agreement"]["waveform"] is None


def test_a_physical_pair_has_rpm_hertz_and_micrometres(tmp_path: Path) -> None:
    """The whole command, nothing put in its place."""
    out = tmp_path / "out"
    result = run("iso-f2", "--state", "after", "--at", 1.0, "--from", 0.95, "--to", 1.15, "--out", out)
    assert result.exit_code == 0, result.stderr
    document = json.loads((out / "stability.json").read_text())
    derived = load_pair("iso-f2").derived
    assert derived is not None
    assert document["pinion_rpm"] == pytest.approx(derived.unit_ratio_rpm)
    assert document["mesh_frequency_hertz"] == pytest.approx(derived.natural_frequency / (2 * np.pi), rel=1e-12)
    assert document["mesh_frequency_hertz"] == pytest.approx(document["pinion_rpm"] * 14 / 60, rel=1e-12)  # 14 teeth
    assert document["mesh_force_newton"]["mean"] == pytest.approx(14193.3, abs=0.2)
    assert document["micrometres"]["mean"] == pytest.approx(1e6 * derived.half_backlash * document["lambda"]["mean"])
    slowest = document["multipliers"][0]
    seconds = slowest["mesh_periods"] * document["mesh_period_seconds"]
    assert slowest["exponent_per_second"][0] == pytest.approx(-1 / seconds, rel=1e-12)
    assert document["nearest"]["distance_rpm"] == pytest.approx(
        document["nearest"]["distance"] * derived.unit_ratio_rpm
    )
    assert "rpm of the pinion" in " ".join(result.stdout.split())
    assert {row["section"] for row in document["assumed"]} >= {"states.after"}
    assert "states.before" not in {row["section"] for row in document["assumed"]}


@pytest.mark.parametrize(("name", "reading"), [("case1", "consistent"), ("case4", "printed")])
def test_cases_and_readings(name: str, reading: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(name, "--at", 1.9, "--from", 1.8, "--to", 2.0, "--reading", reading, "--out", out)
    assert result.exit_code == 0, result.stderr
    document = json.loads((out / "stability.json").read_text())
    assert document["reading"] == reading
    assert document["agreement"]["waveform"] < 1e-6
    assert document["agreement"]["missing"] == {}
    headline = " ".join(result.stdout.split())[:200]
    assert ("reading" in headline) == (reading != "consistent")
