"""`sbg response --tree`: doubled branches beside the response, in JSON, figure, text and netCDF."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from continuation import Branch
from sbg_casadi.cli import app
from sbg_casadi.figure import response_figure
from sbg_casadi.response import run_response

BIRTH, NEXT = 1.4160415167, 1.1469848868  # doublings 1 to 2 and 2 to 4 of the example


@dataclass
class Finished:
    """A finished response with its tree."""

    folder: Path
    code: int
    screen: str
    document: dict[str, Any]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("tree") / "out"
    screen = Console(file=io.StringIO(), width=160, highlight=False)
    code = run_response(
        "example", start=1.45, stop=1.13, smoothing=0.0, state=None, json_file=None, out=folder, console=screen, tree=1
    )
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    return Finished(folder, code, text, json.loads((folder / "response.json").read_text()))


def test_the_period_1_response_comes_first_and_is_complete(finished: Finished) -> None:
    first = finished.document["branches"][0]
    assert (first["period_multiple"], first["parent"], first["complete"]) == (1, None, True)
    assert [p["kind"] for p in first["special_points"]] == ["period-doubling"] * 2


def test_the_doubled_branch_leaves_at_the_doubling_and_doubles_again(finished: Finished) -> None:
    doubled = finished.document["branches"][1]
    assert (doubled["period_multiple"], doubled["parent"]) == (2, 0)
    assert doubled["leaves_at"] == {"kind": "period-doubling", "frequency_ratio": pytest.approx(BIRTH, abs=1e-8)}
    assert [p["frequency_ratio"] for p in doubled["special_points"] if p["kind"] == "period-doubling"] == pytest.approx(
        [NEXT], abs=1e-7
    )
    for branch in finished.document["branches"]:
        assert {"frequency_ratio", "rms", "stability", "leading_multiplier"} <= set(branch["points"][0])
        for point in branch["special_points"]:
            if point["kind"] == "period-doubling":  # over the branch's own period
                distances = [abs(complex(*m) + 1) for m in point["multipliers"]]
                assert min(distances) < 1e-5


def test_both_doublings_of_the_tongue_lead_to_branches_of_period_2(finished: Finished) -> None:
    document = finished.document
    leaving = [b["leaves_at"]["frequency_ratio"] for b in document["branches"][1:] if b["parent"] == 0]
    leaving += [k["frequency_ratio"] for k in document["links"] if k["branch"] == 0]
    doublings = [p["frequency_ratio"] for p in document["branches"][0]["special_points"]]
    assert sorted(leaving) == pytest.approx(sorted(doublings), abs=1e-12)
    assert finished.code == (0 if all(b["complete"] for b in document["branches"]) and not document["notes"] else 3)


def test_files_figure_and_text_show_every_branch(finished: Finished) -> None:
    branches = finished.document["branches"]
    names = ["period-1.nc", *(f"branch-{i}-period-2.nc" for i in range(1, len(branches)))]
    assert {p.name for p in finished.folder.iterdir()} == {
        "response.png", "summary.txt", "response.json", ".sbg-results", *names
    }  # fmt: skip
    loaded = [Branch.load(finished.folder / name) for name in names]
    for stored, shown in zip(loaded, branches, strict=True):
        assert stored.period_multiple == shown["period_multiple"]
        assert stored.parameter.tolist() == [p["frequency_ratio"] for p in shown["points"]]
        assert stored.rms("lambda") == pytest.approx([p["rms"] for p in shown["points"]], rel=1e-12)
    figure = response_figure("t", {f"{i}": b for i, b in enumerate(loaded)}, {}, None)
    drawn = np.concatenate([np.asarray(line.get_xdata()) for line in figure.axes[0].get_lines()])
    assert np.isin(loaded[1].parameter, drawn).all()
    summary = (finished.folder / "summary.txt").read_text()
    for text in (summary, finished.screen):
        assert f"branch 1: period 2, leaves branch 0 at the period-doubling {BIRTH:.10f}" in text
        assert f"{branches[1]['special_points'][0]['frequency_ratio']:.10f}" in text


@pytest.mark.parametrize("depth", ["-1", "7"])
def test_a_depth_out_of_range_is_refused(depth: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["response", "example", "--tree", depth, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert f"--tree = {depth}" in result.output
    assert not (tmp_path / "out").exists()
