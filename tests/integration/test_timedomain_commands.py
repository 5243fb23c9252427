"""The commands sweep, section and basins: contract, one set of numbers everywhere, agreement with the traced branch."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from reference_systems import gear
from rich.console import Console
from typer.testing import CliRunner

import sbg_casadi.sweep_study as sweep_module
import sbg_casadi.timedomain_figure as timedomain_figure
from continuation import FixedStep, Sweep, simulate, sweep
from sbg_casadi import gear_system, load_pair
from sbg_casadi.basins_study import BasinsSettings, run_basins
from sbg_casadi.cli import app
from sbg_casadi.crosscheck import stable_orbits
from sbg_casadi.errors import UserError
from sbg_casadi.model import static_state
from sbg_casadi.pair import case_names
from sbg_casadi.response import trace_response
from sbg_casadi.section_series import no_series, series_document
from sbg_casadi.section_study import run_section
from sbg_casadi.sweep_study import FILES, SweepSettings, run_sweep

QUICK = SweepSettings(points=5, limit=160, recorded=32)


def console() -> Console:
    return Console(file=io.StringIO(), width=160, highlight=False)


def swept(out: Path, **more: Any) -> tuple[int, str]:
    screen = console()
    settings: dict[str, Any] = {
        "start": 1.0, "stop": 1.2, "settings": QUICK, "with_response": False, "state": None, "json_file": None,
    }  # fmt: skip
    code = run_sweep("example", out=out, console=screen, **settings | more)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [name for name in case_names() if not name.endswith("-calibrated")])
def test_period_one_sweeps_lie_on_the_stable_branch(name: str) -> None:
    """RMS of every case to 1e-6 against the traced branch."""
    d = load_pair(name).dimensionless()
    problem, branch = trace_response(d, (1.6, 1.45))
    found = sweep(
        gear_system(d), "frequency_ratio", [1.6, 1.55, 1.5], quantity="lambda", load="mesh_force", start=static_state(d)
    )
    assert (found.period == 1).all()
    for value, rms in zip(found.values.tolist(), found.rms, strict=True):
        assert min(abs(o.rms("lambda") - rms) for o in stable_orbits(problem, branch, value)) < 1e-6
    assert np.all(found.step_error < 1e-6)
    assert np.all(found.dynamic_factor > 1)


def test_one_set_of_numbers(tmp_path: Path) -> None:
    code, text = swept(tmp_path / "out", with_response=True, json_file=tmp_path / "copy.json")
    assert code == 0
    document = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert document == json.loads((tmp_path / "copy.json").read_text())
    assert {p.name for p in (tmp_path / "out").iterdir()} == {".sbg-results", "period-1.nc", *FILES}
    for entry in document["sweeps"]:
        stored = Sweep.load(tmp_path / "out" / f"sweep-{entry['direction']}.nc")
        assert [p["rms"] for p in entry["points"]] == stored.rms.tolist()
        assert [p["verdict"] for p in entry["points"]] == list(stored.verdicts)
        assert sum(s["frequencies"] for s in entry["stretches"]) == 5
        assert "sweep " + entry["direction"] in text
        for s in entry["stretches"]:
            assert s["verdict"] in text
        top = max(p["rms"] for p in entry["points"])
        assert f"largest RMS {top:.6f}" in text
    assert document["response"]["complete"]
    assert document["differences"] == []
    for entry in document["spectra"]["directions"]:  # period-1: no line between whole orders of the mesh frequency
        assert max(p["largest_between"]["amplitude"] for p in entry["points"]) < 1e-6
        with xr.open_dataset(tmp_path / "out" / f"waterfall-{entry['direction']}.nc", engine="h5netcdf") as stored:
            assert stored.amplitudes.shape == (5, 513)
            line = stored.amplitudes.sel(order=1.0).values
        swept_points = next(s for s in document["sweeps"] if s["direction"] == entry["direction"])["points"]
        assert line == pytest.approx([np.hypot(*p["harmonics"][1]) for p in swept_points], rel=1e-5)
    assert [p.name for p in tmp_path.iterdir() if "unfinished" in p.name] == []


def test_an_interrupted_sweep_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = sweep_module.sweep_pair
    monkeypatch.setattr(timedomain_figure, "save", lambda figure, path: path.write_bytes(b""))  # slow

    def interrupted(*args: Any, **more: Any) -> Any:
        def report(fraction: float, text: str) -> None:
            if fraction >= 0.4:
                raise KeyboardInterrupt

        return original(*args, **more | {"report": report})

    monkeypatch.setattr(sweep_module, "sweep_pair", interrupted)
    code, text = swept(tmp_path / "out")
    assert code == 130
    assert "the same command goes on there" in text
    assert not (tmp_path / "out").exists()
    (kept,) = tmp_path.glob(".out.*.unfinished")
    known = sum(len(Sweep.load(f).values) for f in kept.iterdir())
    assert known >= 2
    seen: list[float] = []

    def watched(*args: Any, **more: Any) -> Any:
        return original(*args, **more | {"report": lambda fraction, text: seen.append(fraction)})

    monkeypatch.setattr(sweep_module, "sweep_pair", watched)
    assert swept(tmp_path / "out")[0] == 0
    assert len(seen) <= 10 - known + 1
    assert not kept.exists()


def test_section_of_a_quasi_periodic_response(tmp_path: Path) -> None:
    screen = console()
    code = run_section("example", at=2.25, start=None, state=None, out=tmp_path / "out", json_file=None, console=screen)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    assert code == 0
    document = json.loads((tmp_path / "out" / "section.json").read_text())
    assert document["verdict"] == "quasi-periodic"
    assert "quasi-periodic" in text
    assert document["exponent_sum"]["sum"] == pytest.approx(document["exponent_sum"]["trace"], abs=1e-6)
    largest = document["exponents"][0]
    assert abs(largest["per_tau"]) < 3 * largest["error"] + 0.003
    assert largest["per_mesh_period"] == pytest.approx(largest["per_tau"] * 2 * np.pi / 2.25)
    assert largest["per_second"] is None  # the pair has no unit of time
    series = document["series_exponents"]
    assert [row["method"] for row in series["rows"]] == ["Rosenstein", "Kantz"]
    for row in series["rows"]:  # on a torus neighbours stay together
        assert abs(row["per_tau"]) < max(3 * row["error"], 1e-3)
        assert row["per_mesh_period"] == pytest.approx(row["per_tau"] * 2 * np.pi / 2.25)
        assert row["method"] in text
    assert len(document["strobe"]) == 512
    onset = np.array(document["onset"])
    assert np.all(abs(onset[:, 0] - 1.0) < 1e-9)  # drive contact begins where lambda passes 1: no transmission error
    assert np.all(onset[:, 1] > 0)
    lines = np.array(document["spectrum"]["orders"])[np.argsort(document["spectrum"]["amplitudes"])[-4:]]
    assert min(abs(lines - document["rotation"])) < 1 / 128
    assert sum(document["contact"].values()) == pytest.approx(1.0)


def test_exponents_of_a_chaotic_series_are_those_of_the_model() -> None:
    """Twice the stiffness variation is chaotic at 1.625: 0.224 +- 0.011 per mesh period from the model."""
    system, fixed = gear(2.0), FixedStep(256)
    start = np.array([1.2, *[0.0] * 13])
    x = simulate(system, start, 300, integrator=fixed, phases=[0.0], frequency_ratio=1.625).end
    found = series_document(system, x, fixed, {"frequency_ratio": 1.625}, seconds=1e-3)
    assert found["note"] == ""
    for row in found["rows"]:
        assert abs(row["per_mesh_period"] - 0.224) < 3 * row["per_mesh_period_error"] + 0.011
        assert row["per_mesh_period"] > 3 * row["per_mesh_period_error"]
        assert row["per_second"] == pytest.approx(1000 * row["per_mesh_period"])
        assert row["per_tau"] == pytest.approx(row["per_mesh_period"] * 1.625 / (2 * np.pi))
    assert "repeats" in no_series("the response repeats")["note"]


def test_basins_of_two_responses(tmp_path: Path) -> None:
    """At 0.56 the response beyond the fold and the doubled one share the plane."""
    screen = console()
    settings = BasinsSettings(grid=7)
    code = run_basins("example", at=0.56, settings=settings, state=None, out=tmp_path / "out", json_file=None,
                      console=screen)  # fmt: skip
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    assert code == 0
    found = json.loads((tmp_path / "out" / "basins.json").read_text())["basins"]
    assert sorted(a["period"] for a in found["attractors"]) == [1, 2]
    assert sum(a["fraction"] for a in found["attractors"]) == pytest.approx(1.0)
    for a in found["attractors"]:
        assert f"{a['fraction']:.4f}" in text
        assert f"{a['rms']['lambda']:.6f}" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep", "example", "--points", "1"], "--points = 1"),
        (["sweep", "example", "--limit", "0"], "--limit = 0"),
        (["section", "example", "--at", "-1"], "--at = -1"),
        (["section", "example", "--at", "1", "--from", "0"], "--from = 0"),
        (["basins", "example", "--at", "1", "--axis", "lamda=0:1"], "did you mean 'lambda'"),
        (["basins", "example", "--at", "1", "--axis", "lambda=1:0"], "expected NAME=LOW:HIGH"),
        (["basins", "example", "--at", "1", "--axis", "lambda=0:1"], "two different coordinates"),
        (["basins", "example", "--at", "1", "--random", "0"], "positive numbers of states"),
    ],
)
def test_bad_input_is_one_sentence(arguments: list[str], message: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_foreign_files_are_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("mine")
    with pytest.raises(UserError, match="no earlier results"):
        swept(tmp_path / "out")
