"""The command ``sbg paper``, one case with coarse sweeps: files, scoreboard, resumption, failures, and the page."""

from __future__ import annotations

import base64
import io
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

import sbg_casadi.paper.command as command
from continuation import ContinuationError
from sbg_casadi import load_pair
from sbg_casadi.cli import app
from sbg_casadi.paper.command import run_paper
from sbg_casadi.paper.gallery import gallery
from sbg_casadi.paper.plan import Subject
from sbg_casadi.paper.row import VERDICTS

POINTS = 4
PARTS = ("sweeps_part", "response_part", "motions_part", "least_part", "stiff_bearings_part")


def assumed(case: str) -> Subject:
    """The pair completed by assumed values: its cost does not depend on what a calibration found."""
    return Subject(case, case, load_pair(case), "assumed")


def redo(out: Path, **more: Any) -> tuple[int, str]:
    screen = Console(file=io.StringIO(), width=160, highlight=False)
    settings: dict[str, Any] = {"case": 4, "points": POINTS, "json_file": None} | more
    code = run_paper(out=out, console=screen, **settings)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is interrupted at its third part and finished by the same command."""
    out = tmp_path_factory.mktemp("paper") / "redone"
    calls: list[str] = []

    def counted(name: str) -> Any:
        real = getattr(command, name)

        def call(*arguments: Any) -> Any:
            calls.append(name)
            if len(calls) == 3:
                raise KeyboardInterrupt
            return real(*arguments)

        return call

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "subject", assumed)
        for name in PARTS:
            patch.setattr(command, name, counted(name))
        code, text = redo(out)
        assert code == 130
        assert "the same command goes on there" in text
        assert not out.exists()
        assert calls == ["sweeps_part", "response_part", "motions_part"]
        code, text = redo(out, json_file=out.parent / "copy.json")
    assert code == 0
    assert sorted(calls[3:]) == sorted(["motions_part"] * 2 + ["sweeps_part", "response_part"] + list(PARTS[3:]))
    assert [p.name for p in out.parent.iterdir() if "unfinished" in p.name] == []
    document = json.loads((out / "paper.json").read_text())
    for verdict, count in document["counts"].items():
        assert f"{count:4d} {verdict}" in text
    return out


def test_files_and_scoreboard(finished: Path) -> None:
    names = {p.name for p in finished.iterdir()}
    assert names >= {"index.html", "paper.md", "paper.json", "case4.json", "stiff-bearings.png", "case4-overview.png"}
    assert names >= {f"case4-{n}-{s}.png" for n in ("bifurcation", "motions") for s in ("before", "after")}
    document = json.loads((finished / "paper.json").read_text())
    assert document == json.loads((finished.parent / "copy.json").read_text())
    rows = document["scoreboard"]
    assert {r["verdict"] for r in rows} <= set(VERDICTS)
    assert len({r["key"] for r in rows}) == len(rows) > 120
    for r in rows:
        assert (r["verdict"] in ("reproduced", "contradicted")) == (r["basis"] == "printed")
    assert {r["verdict"]: 0 for r in rows}.keys() == set(VERDICTS) - {"matched after calibration"}
    by_key = {r["key"]: r for r in rows}
    assert by_key["stiff-bearings"]["verdict"] == "reproduced"
    for key in ("peak-case4-before", "motion-case4-before-0.3", "motion-case4-after-0.45"):
        assert by_key[key]["basis"] == "assumed"
        assert by_key[key]["ours"] != "-"
    assert document["failures"] == []


def test_one_set_of_numbers(finished: Path) -> None:
    """The peak of JSON, Markdown and page is the largest of the parts."""
    document = json.loads((finished / "paper.json").read_text())
    parts = json.loads((finished / "case4.json").read_text())
    orbits = [p for b in parts["before"]["response"]["branches"] for p in b["points"] if p["stability"] == "stable"]
    swept = [p for s in parts["before"]["sweeps"]["sweeps"] for p in s["points"]]
    largest = max(p["rms"] for p in [*orbits, *swept])
    assert document["table_7"][0]["before"]["rms"] == largest
    for name in ("paper.md", "index.html"):
        text = (finished / name).read_text()
        assert f"{largest:.4f}" in text
        assert f"from {largest:.4f} at " in text
        assert document["learned"]["case4"][1][:40] in text
    assert {0.3, 0.45, 2.6} <= {p["frequency_ratio"] for p in swept}
    motion = parts["before"]["motions"]["frequencies"][0]["motions"][0]
    value, error = (motion["variational"][k] for k in ("value", "error"))
    assert value < 0 < error
    assert motion["verdict"] == "period-1"


def test_every_picture_is_on_the_page_and_drawn_again_the_same(finished: Path) -> None:
    parts = json.loads((finished / "case4.json").read_text())
    document = json.loads((finished / "paper.json").read_text())
    html = (finished / "index.html").read_text()
    markdown = (finished / "paper.md").read_text()
    pictures = gallery({"case4": parts}, document["stiff_bearings"])
    for picture in pictures:
        assert picture.data == (finished / picture.name).read_bytes()
        assert base64.b64encode(picture.data).decode() in html
        assert f"]({picture.name})" in markdown
    assert html.count("<img ") == len(pictures)


def test_the_page_refers_to_nothing_outside(finished: Path) -> None:
    html = (finished / "index.html").read_text()
    assert re.findall(r"(?i)https?:|\bftp:|@import|url\(|//[a-z0-9.-]+\.[a-z]{2,}", html) == []
    sources = re.findall(r'\b(?:src|href|srcset|data|action)="([^"]{0,30})', html)
    assert sources
    assert all(s.startswith(("data:", "#")) for s in sources)
    assert "default-src 'none'" in html


_CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)

_PROBE = """<script>
addEventListener("load", () => {
  const column = (table, i) => [...table.tBodies[0].rows].map(r => r.cells[i].textContent);
  const table = document.getElementById("table-of-scoreboard");
  const heads = [...table.tHead.rows[0].cells].map(c => c.textContent), out = {heads, before: column(table, 5)};
  out.images = [...document.images].map(i => i.naturalWidth);
  const press = name => table.tHead.rows[0].cells[heads.indexOf(name)].querySelector("button").click();
  press("difference"); out.up = column(table, 5);
  press("difference"); out.down = column(table, 5);
  press("verdict"); out.verdicts = column(table, heads.indexOf("verdict"));
  const box = document.querySelector('input[data-verdict="reproduced"]'); box.click();
  out.shown = [...table.tBodies[0].rows].filter(r => !r.hidden).length;
  out.loaded = performance.getEntriesByType("resource").map(e => e.name.slice(0, 20));
  const place = document.createElement("pre"); place.id = "probe"; place.textContent = JSON.stringify(out);
  document.body.appendChild(place);
});
</script></body>"""


@pytest.mark.skipif(_CHROMIUM is None, reason="no Chromium here: the page is checked as text alone")
def test_the_page_in_a_browser(finished: Path, tmp_path: Path) -> None:
    """Every figure loads, nothing is fetched, and tables sort by a click: asked of the page by a script added to it."""
    html = (finished / "index.html").read_text()
    page = tmp_path / "page.html"
    page.write_text(html.replace("</body>", _PROBE))
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    # No name resolves: a request that left the page would fail.
    offline = ["--host-resolver-rules=MAP * ~NOTFOUND", "--disable-background-networking", "--virtual-time-budget=5000"]
    run = subprocess.run(
        [str(_CHROMIUM), *options, *offline, "--dump-dom", page.as_uri()], capture_output=True, timeout=120, check=True
    )
    found = json.loads(
        re.search(r'<pre id="probe">(.*?)</pre>', run.stdout.decode(), re.S)[1]  # type: ignore[index]
        .replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    )  # fmt: skip
    assert len(found["images"]) == html.count("<img ") > 5
    assert min(found["images"]) > 0
    assert [n for n in found["loaded"] if not n.startswith("data:")] == []

    def numbers(texts: list[str]) -> list[float]:
        return [float(t) for t in texts if t != "-"]

    assert numbers(found["up"]) == sorted(numbers(found["before"]))
    assert numbers(found["down"]) == sorted(numbers(found["before"]), reverse=True)
    assert found["verdicts"] == sorted(found["verdicts"])
    counts = json.loads((finished / "paper.json").read_text())["counts"]
    assert found["shown"] == sum(counts.values()) - counts["reproduced"]


def test_a_part_that_fails_leaves_the_rest(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = json.loads((finished / "case4.json").read_text())
    document = json.loads((finished / "paper.json").read_text())

    def kept(name: str) -> Any:
        def call(one: Subject, state: Any = "", *rest: Any) -> Any:
            if name == "response" and state == "after":
                raise ContinuationError("no orbit at the first ratio")
            return parts[state][name]

        return call

    monkeypatch.setattr(command, "subject", assumed)
    for name in ("sweeps", "response", "motions"):
        monkeypatch.setattr(command, f"{name}_part", kept(name))
    monkeypatch.setattr(command, "least_part", lambda *rest: parts["least"])
    monkeypatch.setattr(command, "stiff_bearings_part", lambda *rest: document["stiff_bearings"])
    code, text = redo(tmp_path / "part")
    assert code == 3
    assert "NOT COMPUTED: case4, after response: no orbit at the first ratio" in text
    assert "Not computed: case4, after response" in (tmp_path / "part" / "index.html").read_text()
    again = json.loads((tmp_path / "part" / "paper.json").read_text())
    assert again["failures"] == ["case4, after response: no orbit at the first ratio"]
    assert len(again["scoreboard"]) == len(document["scoreboard"])


@pytest.mark.parametrize(
    ("options", "words"),
    [(["--case", "5"], "1 to 4"), (["--points", "2"], "from 3 to 5000"), (["--points", "9999"], "from 3 to 5000")],
)
def test_bad_input_is_one_sentence(options: list[str], words: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["paper", "--out", str(tmp_path / "out"), *options])
    assert result.exit_code == 2
    assert words in result.output
    assert list(tmp_path.iterdir()) == []


def test_foreign_folders_are_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    result = CliRunner().invoke(app, ["paper", "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"
