"""A folder of results takes the place of its own earlier results only, and as a whole."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path

import pytest

from sbg_casadi import results
from sbg_casadi.errors import UserError
from sbg_casadi.results import MARKER, ResultsFolder

COMMAND = "sbg study iso-f2"
FILES = ("study.json", "summary.txt")


def write(text: str, names: tuple[str, ...] = FILES) -> object:
    def make(place: Path) -> None:
        for name in names:
            (place / name).write_text(text)

    return make


def claim(path: Path, command: str = COMMAND, json_file: Path | None = None) -> ResultsFolder:
    return ResultsFolder.claim(path, command, FILES, json_file)


def contents(folder: Path) -> dict[str, str]:
    return {p.name: p.read_text() for p in folder.iterdir() if p.name != MARKER}


@pytest.fixture(params=["exchange", "renames"])
def how(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run with the one-step exchange of Linux, and as on systems without it."""
    if request.param == "renames":
        monkeypatch.setattr(results, "_exchange", lambda place, target: False)
    return request.param


def test_a_rerun_replaces_all_of_its_earlier_results(tmp_path: Path, how: str) -> None:
    out = tmp_path / "out"
    claim(out).fill(write("first", (*FILES, "old.nc")))
    assert set(contents(out)) == {*FILES, "old.nc"}
    claim(out).fill(write("second"))
    assert contents(out) == dict.fromkeys(FILES, "second")
    marker = json.loads((out / MARKER).read_text())
    assert marker == {"schema": 1, "command": COMMAND, "files": list(FILES)}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_crash_leaves_the_earlier_results_and_nothing_else(tmp_path: Path, error: BaseException) -> None:
    out = tmp_path / "out"
    claim(out).fill(write("first"))

    def crash(place: Path) -> None:
        (place / "study.json").write_text("half")
        raise error

    with pytest.raises(type(error)):
        claim(out).fill(crash)
    assert contents(out) == dict.fromkeys(FILES, "first")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_failed_rename_brings_the_earlier_results_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    claim(out).fill(write("first"))
    monkeypatch.setattr(results, "_exchange", lambda place, target: False)
    rename = os.rename

    def fail(source: Path, target: Path) -> None:
        if str(source).endswith(".partial"):
            raise OSError(5, "input/output error")
        rename(source, target)

    monkeypatch.setattr(results.os, "rename", fail)
    with pytest.raises(OSError, match="input/output"):
        claim(out).fill(write("second"))
    assert contents(out) == dict.fromkeys(FILES, "first")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_foreign_files_are_refused_and_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    claim(out).fill(write("first"))  # an empty folder is free
    (out / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match=r"also holds notes\.txt"):
        claim(out)
    (out / "notes.txt").unlink()
    (out / "study.json").unlink()
    (out / "study.json").mkdir()
    with pytest.raises(UserError, match=r"also holds study\.json"):
        claim(out)
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "thesis.tex").write_text("years")
    with pytest.raises(UserError, match=r"no earlier results \(thesis\.tex\)"):
        claim(plain)
    assert contents(plain) == {"thesis.tex": "years"}


def test_a_file_that_appears_during_the_work_is_not_swept_away(tmp_path: Path) -> None:
    out = tmp_path / "out"
    folder = claim(out)
    folder.fill(write("first"))
    (out / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match=r"notes\.txt"):
        folder.fill(write("second"))
    assert contents(out) == {**dict.fromkeys(FILES, "first"), "notes.txt": "mine"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_results_of_another_command_and_a_broken_marker_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    claim(out).fill(write("first"))
    with pytest.raises(UserError, match="holds results of 'sbg study iso-f2'"):
        claim(out, "sbg response iso-f2")
    for text in ("", "[]", '{"command": 3}'):
        (out / MARKER).write_text(text)
        with pytest.raises(UserError):
            claim(out)


def test_places_that_can_not_be_a_folder_of_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="is a file"):
        claim(tmp_path / "file")
    with pytest.raises(OSError, match="no folder"):
        claim(tmp_path / "missing" / "out")
    monkeypatch.chdir(tmp_path)
    for place in (Path("."), Path(".."), Path("/")):
        with pytest.raises(UserError, match="folder of its own"):
            claim(place)

    def refuse(**_: object) -> str:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(results.tempfile, "mkdtemp", refuse)
    with pytest.raises(PermissionError, match="Read-only file system"):
        claim(tmp_path / "out")


def test_a_json_file_inside_the_folder_is_one_of_the_results(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert claim(out, json_file=out / "mine.json").extra == "mine.json"
    assert claim(out, json_file=out / "study.json").extra == "study.json"
    assert claim(out, json_file=tmp_path / "x.json").extra is None
    for name in ("summary.txt", MARKER):
        with pytest.raises(UserError, match="take the place"):
            claim(out, json_file=out / name)
    with pytest.raises(UserError, match="take the place"):
        claim(out, json_file=out)
    with pytest.raises(OSError, match="no folder"):
        claim(out, json_file=tmp_path / "missing" / "x.json")


def test_a_link_keeps_pointing_where_it_does(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    claim(tmp_path / "link").fill(write("first"))
    assert (tmp_path / "link").is_symlink()
    assert contents(tmp_path / "real") == dict.fromkeys(FILES, "first")


def test_concurrent_runs_never_mix(tmp_path: Path, how: str) -> None:
    """Each reader sees the files of one run; with the exchange also at every moment."""
    out = tmp_path / "out"
    claim(out).fill(write("start"))
    errors: list[Exception] = []

    def run(text: str) -> None:
        try:
            for _ in range(15):
                ResultsFolder(out, COMMAND).fill(write(text))
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(name,)) for name in ("a", "b", "c")]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert how == "renames" or out.is_dir()
    assert not errors
    assert len(set(contents(out).values())) == 1
    assert set(contents(out)) == set(FILES)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
