"""The main job on a real pair over a small range: JSON contract, folder rules, and one set of numbers everywhere."""

from __future__ import annotations

import io
import json
import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

import sbg_casadi.study as study_module
from continuation import Branch, NoConvergence
from continuation.timedomain.sweep import Sweep
from sbg_casadi import load_pair
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.errors import PairError, UserError
from sbg_casadi.figure import response_figure
from sbg_casadi.report import amplitude, ratio, small
from sbg_casadi.results import MARKER
from sbg_casadi.study import run_response, run_study

START, STOP, SWEPT = 0.95, 1.2, 6
FILES = {
    "response.png",
    "summary.txt",
    "study.json",
    *(f"{s}-{k}.nc" for s in ("before", "after") for k in ("period-1", "sweep-up", "sweep-down")),
}


def console() -> Console:
    return Console(file=io.StringIO(), width=160, highlight=False)


def study(out: Path | None, pair: str = "iso-f2", **more: Any) -> tuple[int, str]:
    screen = console()
    settings = {"start": START, "stop": STOP, "json_file": None, "sweep_points": SWEPT} | more
    code = run_study(pair, out=out, console=screen, **settings)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


def response(pair: str = "iso-f2", **more: Any) -> tuple[int, str]:
    screen = console()
    settings = {"start": 1.2, "stop": 0.95, "smoothing": 0.0, "state": None, "json_file": None, "out": None} | more
    code = run_response(pair, console=screen, **settings)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@dataclass
class Finished:
    """One finished study that the tests look at."""

    folder: Path
    code: int
    screen: str
    document: dict[str, Any]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("study") / "out"
    code, screen = study(folder, json_file=folder.parent / "copy.json")
    return Finished(folder, code, screen, json.loads((folder / "study.json").read_text()))


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail when tracing begins: bad input must be refused before."""

    def begin(*_: object, **__: object) -> None:
        raise AssertionError("the work has begun")

    monkeypatch.setattr("sbg_casadi.response.trace", begin)


def folds(document: dict[str, Any]) -> list[float]:
    """Return the frequency ratios of the folds of the first branch, in order along it."""
    return [p["frequency_ratio"] for p in document["branches"][0]["special_points"] if p["kind"] == "fold"]


def check_response(document: dict[str, Any]) -> None:
    """Check the contract that scripts rely on."""
    assert document["schema"] == 1
    assert document["smoothing"] >= 0
    for branch in document["branches"]:
        assert branch["period_multiple"] == 1
        assert isinstance(branch["stop"], str)
        assert branch["points"]
        for p in branch["points"]:
            assert {"frequency_ratio", "rms", "stability", "leading_multiplier"} <= set(p)
            assert p["stability"] in ("stable", "unstable", "undecided")
            re_, im = p["leading_multiplier"]
            assert im >= 0
            assert p["stability"] == "undecided" or (abs(complex(re_, im)) < 1) == (p["stability"] == "stable")
        for s in branch["special_points"]:
            assert {"kind", "frequency_ratio", "rms", "error", "multipliers"} <= set(s)
            assert s["error"] <= 1e-8
            assert len(s["multipliers"]) == 14
            largest = max(abs(complex(*m)) for m in s["multipliers"])
            assert largest == pytest.approx(abs(complex(*s["multipliers"][0])), abs=1e-12)


def test_a_study_of_the_iso_pair_is_complete_and_keeps_the_contract(finished: Finished) -> None:
    assert finished.code == 0
    document = finished.document
    assert [s["state"] for s in document["states"]] == ["before", "after"]
    assert document["range"] == [START, STOP]
    for state in document["states"]:
        check_response(state)
        (branch,) = state["branches"]
        assert branch["complete"]
        assert not branch["unresolved"]
        # contact loss begins, the jump up and the jump down, contact loss ends
        assert [p["kind"] for p in branch["special_points"]] == ["grazing", "fold", "fold", "grazing"]
        assert branch["points"][0]["frequency_ratio"] == START
        assert branch["points"][-1]["frequency_ratio"] == STOP
    assert json.loads((finished.folder.parent / "copy.json").read_text()) == document
    quantities = {q["name"]: q["value"] for q in document["quantities"]}
    assert quantities["F_n"] == pytest.approx(14193.3, abs=0.05)  # ISO/TR 10300-30, sample 1
    assert quantities["a1"] ** 2 + quantities["a2"] ** 2 + quantities["a3"] ** 2 == pytest.approx(1.0, abs=1e-12)
    assert len(document["warnings"]) == 1
    assert {row["source"] for row in document["assumed"]} == {"assumed"}
    assert "[bearings] pinion_x" in finished.screen


def test_sweeps_agree_with_the_stable_branch_where_they_lie_on_it(finished: Finished) -> None:
    for state in finished.document["states"]:
        check = state["cross_check"]
        assert [s["direction"] for s in check["sweeps"]] == ["up", "down"]
        assert check["compared"] + len(check["elsewhere"]) == 2 * SWEPT
        assert check["compared"] >= 2 * SWEPT - 2
        assert check["largest_difference"] < 1e-6
        up, down = ({p["frequency_ratio"]: p["rms"] for p in s["points"]} for s in check["sweeps"])
        fold_up, fold_down = folds(state)
        for r in up:
            apart = abs(up[r] - down[r]) > 0.05
            assert apart == (fold_down < r < fold_up), r  # two attractors between the jumps, one outside


def test_text_and_screen_show_the_numbers_of_the_json(finished: Finished) -> None:
    text = (finished.folder / "summary.txt").read_text()
    for shown in (text, finished.screen):
        for state in finished.document["states"]:
            for p in state["branches"][0]["special_points"]:
                row = next(line for line in shown.splitlines() if ratio(p["frequency_ratio"]) in line)
                assert row.split()[0] == p["kind"]
                assert amplitude(p["rms"]) in row
                assert small(p["error"]) in row
                assert f"{p['pinion_rpm']:.0f}" in row
            difference = small(state["cross_check"]["largest_difference"])
            assert f"largest difference in RMS {difference}" in shown
        for q in finished.document["quantities"]:
            assert re.search(rf"^{re.escape(q['name'])} +{re.escape(q['text'])} ", shown, re.M), q
        change = finished.document["comparison"]["change"]["largest_rms"]
        assert f"{100 * change:+.1f} %" in shown
    assert max(len(line) for line in text.splitlines()) <= 120


def test_the_folder_holds_what_it_says(finished: Finished) -> None:
    names = {p.name for p in finished.folder.iterdir()}
    assert names == {*FILES, MARKER}
    marker = json.loads((finished.folder / MARKER).read_text())
    assert (marker["command"], set(marker["files"])) == ("sbg study iso-f2", FILES)
    for name in FILES:
        assert name in finished.screen
    for state in finished.document["states"]:
        path = finished.folder / f"{state['state']}-period-1.nc"
        branch = Branch.load(path)
        points = state["branches"][0]["points"]
        assert branch.parameter.tolist() == [p["frequency_ratio"] for p in points]
        assert branch.rms("lambda").tolist() == [p["rms"] for p in points]
        with xr.open_dataset(path, engine="h5netcdf") as data:
            assert data["rms"].sel(state="lambda").values.tolist() == [p["rms"] for p in points]
        sweep = Sweep.load(finished.folder / f"{state['state']}-sweep-down.nc")
        assert sweep.values.tolist() == [p["frequency_ratio"] for p in state["cross_check"]["sweeps"][1]["points"]]


def test_the_figure_draws_the_branches_the_sweeps_and_the_speed(finished: Finished) -> None:
    branches = {s: Branch.load(finished.folder / f"{s}-period-1.nc") for s in ("before", "after")}
    sweeps = {
        s: [Sweep.load(finished.folder / f"{s}-sweep-{d}.nc") for d in ("up", "down")] for s in ("before", "after")
    }
    rpm = load_pair("iso-f2").derived.unit_ratio_rpm  # type: ignore[union-attr]
    figure = response_figure("title", branches, sweeps, rpm)
    (ax,) = figure.get_axes()
    kinds = [line.get_gid() for line in ax.get_lines()]
    per_state = ["sweep up", "sweep down", "stable", "unstable", "stable", "fold", "grazing"]
    assert kinds == per_state * 2
    assert len({line.get_color() for line in ax.get_lines()}) == 2
    fold = ax.get_lines()[5]
    points = finished.document["states"][0]["branches"][0]["special_points"]
    expected = [[p["frequency_ratio"], p["rms"]] for p in points if p["kind"] == "fold"]
    np.testing.assert_array_equal(fold.get_xydata(), expected)
    unstable = ax.get_lines()[3]
    assert unstable.get_linestyle() == "--"
    assert sorted([unstable.get_xdata()[0], unstable.get_xdata()[-1]]) == sorted(x for x, _ in expected)
    (upper,) = ax.child_axes
    figure.canvas.draw()
    np.testing.assert_allclose(upper.get_xlim(), np.array(ax.get_xlim()) * rpm, rtol=1e-12)
    assert "rpm" in upper.get_xlabel()
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["before", "after", "stable", "unstable", "fold", "grazing", "sweep up", "sweep down"]


def test_an_interrupt_leaves_earlier_results_and_says_what_was_finished(
    finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = snapshot(finished.folder.parent)
    screen = console()

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sbg_casadi.study.up_and_down", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_study("iso-f2", out=finished.folder, start=1.1, stop=1.2, json_file=None, console=screen, sweep_points=2)
    assert "finished before the interrupt: nothing" in screen.file.getvalue()  # type: ignore[attr-defined]
    assert snapshot(finished.folder.parent) == before


@pytest.mark.usefixtures("no_work")
def test_bad_places_are_refused_before_any_work(finished: Finished, tmp_path: Path) -> None:
    before = snapshot(finished.folder.parent)
    with pytest.raises(OSError, match="no folder"):
        study(tmp_path / "missing" / "out")
    with pytest.raises(OSError, match="no folder"):
        study(finished.folder, json_file=tmp_path / "missing" / "x.json")
    with pytest.raises(UserError, match="holds results of 'sbg study iso-f2'"):
        response(out=finished.folder)
    (tmp_path / "file").write_text("x")
    with pytest.raises(UserError, match="is a file"):
        study(tmp_path / "file")
    with pytest.raises(IsADirectoryError):
        response(json_file=tmp_path)
    assert snapshot(finished.folder.parent) == before
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.usefixtures("no_work")
def test_bad_input_is_refused_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PairError, match="'example' has no state 'before'"):
        study(None, "example")
    with pytest.raises(PairError, match="iso-f2"):
        study(None, "iso-f3")
    with pytest.raises(UserError, match="empty range"):
        study(None, start=1.0, stop=1.0)
    with pytest.raises(UserError, match="--smoothing"):
        response(smoothing=-1.0)
    with pytest.raises(PairError, match="no state 'afetr'"):
        response(state="afetr")
    assert list(tmp_path.iterdir()) == []


def test_a_response_writes_its_json_and_its_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, screen = response(state="after", out=out, json_file=out / "mine.json")
    assert code == 0
    document = json.loads((out / "mine.json").read_text())
    assert document == json.loads((out / "response.json").read_text())
    assert document["state"] == "after"
    check_response(document)
    assert {p.name for p in out.iterdir()} == {
        MARKER, "mine.json", "period-1.nc", "response.json", "response.png", "summary.txt"
    }  # fmt: skip
    for p in document["branches"][0]["special_points"]:
        assert ratio(p["frequency_ratio"]) in screen
        assert ratio(p["frequency_ratio"]) in (out / "summary.txt").read_text()


def test_a_smoothed_response_says_so_and_moves_the_folds_a_little(tmp_path: Path, finished: Finished) -> None:
    path = tmp_path / "r.json"
    code, screen = response(smoothing=0.003, json_file=path)
    document = json.loads(path.read_text())
    assert (code, document["smoothing"]) == (0, 0.003)
    assert "smoothed backlash law, width 0.003" in screen
    exact, smooth = sorted(folds(finished.document["states"][0])), sorted(folds(document))
    assert len(document["branches"][0]["special_points"]) == 2  # a smooth law has no grazing
    assert 1e-7 < np.abs(np.subtract(exact, smooth)).max() < 1e-3


def test_a_branch_that_ends_early_is_written_and_gives_code_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from continuation import trace

    monkeypatch.setattr(
        "sbg_casadi.response.trace", lambda problem, start, span, progress: trace(problem, start, span, max_points=5)
    )
    path = tmp_path / "r.json"
    code, screen = response(json_file=path)
    assert code == 3
    assert "ENDED EARLY" in screen
    (branch,) = json.loads(path.read_text())["branches"]
    assert not branch["complete"]
    assert branch["stop"] in screen


def test_a_state_that_fails_leaves_the_other_one_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    traced = study_module.trace_response

    def fail_after(d: Dimensionless, span: tuple[float, float], **more: Any) -> Any:
        if d.state == "after":
            raise NoConvergence("no orbit was found; start elsewhere")
        return traced(d, span, **more)

    monkeypatch.setattr(study_module, "trace_response", fail_after)
    code, screen = study(tmp_path / "out", start=1.15, sweep_points=2)
    assert code == 3
    assert "FINISHED IN PART: state 'after': no orbit was found" in screen
    document = json.loads((tmp_path / "out" / "study.json").read_text())
    assert [s["state"] for s in document["states"]] == ["before"]
    assert not (tmp_path / "out" / "after-period-1.nc").exists()


def test_a_dimensionless_pair_of_two_states_has_no_speeds(tmp_path: Path) -> None:
    text = (files("sbg_casadi") / "cases" / "example.toml").read_text()
    states = "[states.before]\nstiffness_cosine = [0.3, 0.1]\n[states.after]\nstiffness_cosine = [0.1, 0.03]\n"
    path = tmp_path / "two.toml"
    path.write_text(re.sub(r"^stiffness_(co)?sine.*\n", "", text, flags=re.M) + states)
    code, screen = study(tmp_path / "out", str(path), start=2.5, stop=2.3, sweep_points=3)
    assert code == 0
    assert "rpm" not in screen
    document = json.loads((tmp_path / "out" / "study.json").read_text())
    assert [q["name"] for q in document["quantities"]] == ["a3", "T/a3"]
    assert all(s["cross_check"]["compared"] == 6 for s in document["states"])
    assert document["comparison"]["change"]["largest_rms"] < 0
