"""The command line: cases and show, the plumbing of response and study, exit codes and refusals."""

from __future__ import annotations

import json
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from continuation import ContinuationError
from sbg_casadi import PairError
from sbg_casadi.cli import app
from sbg_casadi.files import check_writable, write_text_atomic


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def test_cases_lists_every_built_in_case(tmp_path: Path) -> None:
    result = run("cases", "--json", str(tmp_path / "cases.json"))
    assert result.exit_code == 0
    assert "iso-f2" in result.stdout
    listed = json.loads((tmp_path / "cases.json").read_text())["cases"]
    assert {"name": "iso-f2", "form": "physical", "states": ["before", "after"]} in listed


def test_show_prints_and_writes_the_same_numbers(tmp_path: Path) -> None:
    target = tmp_path / "pair.json"
    result = run("show", "iso-f2", "--json", str(target))
    assert result.exit_code == 0
    document = json.loads(target.read_text())
    assert document["schema"] == 1
    assert document["derived"]["normal_force"] == pytest.approx(14193.3, abs=0.2)
    assert document["dimensionless"]["after"]["stiffness_cosine"] == [0.08125, 0.0203125]
    for row in document["rows"]:
        assert row["value"] in result.stdout
        assert row["key"] in result.stdout
    assert "[bearings]" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["show", "iso-f3"], "did you mean 'iso-f2'"),
        (["show", "none.toml"], "does not exist"),
        (["show", "iso-f2", "--json", "/no/such/folder/x.json"], "there is no folder /no/such/folder"),
        (["response", "example", "--from", "nan"], "--from = nan; expected a positive"),
        (["response", "example", "--to", "-1"], "--to = -1; expected a positive"),
        (["response", "example", "--from", "0"], "--from = 0;"),
        (["response", "example", "--from", "1", "--to", "1"], "empty range"),
        (["response", "example", "--from", "2.6"], "empty range"),
        (["response", "example", "--smoothing", "-0.1"], "--smoothing = -0.1"),
        (["response", "example", "--smoothing", "inf"], "--smoothing = inf"),
        (["study", "iso-f2", "--from", "inf"], "--from = inf"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(arguments: list[str], words: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


@pytest.mark.parametrize("arguments", [["shwo"], ["show"], ["response", "example", "--from", "abc"], ["show", "--x"]])
def test_usage_errors_exit_with_2(arguments: list[str]) -> None:
    assert run(*arguments).exit_code == 2


def install(monkeypatch: pytest.MonkeyPatch, effect: Callable[..., int]) -> None:
    """Put a stand-in for the module that does the work behind response and study."""
    module: Any = types.ModuleType("sbg_casadi.study")
    module.run_response = module.run_study = effect
    monkeypatch.setitem(sys.modules, "sbg_casadi.study", module)


def test_options_reach_the_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: dict[str, Any] = {}

    def effect(pair: str, **options: Any) -> int:
        seen.update(pair=pair, **options)
        return 3

    install(monkeypatch, effect)
    out = str(tmp_path / "out")
    options = ["--from", "2.6", "--to", "0.4", "--smoothing", "0.01", "--state", "before", "--out", out]
    assert run("response", "example", *options).exit_code == 3
    del seen["console"]
    assert seen == {
        "pair": "example",
        "start": 2.6,
        "stop": 0.4,
        "smoothing": 0.01,
        "tree": 0,
        "state": "before",
        "reading": frozenset(),
        "json_file": None,
        "out": Path(out),
    }
    seen.clear()
    assert run("study", "iso-f2").exit_code == 3
    del seen["console"]
    assert seen == {
        "pair": "iso-f2",
        "start": None,
        "stop": None,
        "reading": frozenset(),
        "json_file": None,
        "out": None,
    }


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (PairError("torque is\nmissing"), 2, "sbg: torque is missing\n"),
        (PermissionError(13, "Permission denied", "/x"), 2, "sbg: /x: Permission denied\n"),
        (ContinuationError("no step left"), 3, "sbg: no step left\n"),
        (KeyboardInterrupt(), 130, "sbg: interrupted; nothing new was written and earlier results are kept\n"),
    ],
)
def test_errors_of_the_work_become_exit_codes(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, words: str
) -> None:
    def effect(*_: Any, **__: Any) -> int:
        raise error

    install(monkeypatch, effect)
    for command in ("study", "response"):
        result = run(command, "iso-f2")
        assert (result.exit_code, result.stderr) == (code, words)


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    def effect(*_: Any, **__: Any) -> int:
        raise ZeroDivisionError

    install(monkeypatch, effect)
    assert isinstance(run("study", "iso-f2").exception, ZeroDivisionError)


HEAVY = ("casadi", "numpy", "scipy", "pint", "matplotlib", "xarray")


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["study", "--help"]])
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    """The half second that help may take is held by what it imports, not by a clock."""
    code = (
        "import sys\nfrom sbg_casadi.cli import main\nsys.argv = ['sbg', *sys.argv[1:]]\n"
        f"try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
        f"print('LOADED', [m for m in {HEAVY} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("LOADED []\n")


def test_module_runs_like_the_script() -> None:
    done = subprocess.run([sys.executable, "-m", "sbg_casadi", "show", "nope"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("sbg: no built-in case and no file is called 'nope'")


def test_a_closed_pipe_is_no_error() -> None:
    code = f"{sys.executable} -m sbg_casadi show iso-f2 | head -n 1"
    done = subprocess.run(code, shell=True, capture_output=True, text=True)
    assert done.stdout.startswith("key")
    assert "Traceback" not in done.stderr


def test_atomic_write_replaces_the_whole_file_or_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "a.json"
    write_text_atomic(target, "one")
    write_text_atomic(str(target), "two")
    assert target.read_text() == "two"
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_text_atomic(target, "three")
    assert target.read_text() == "two"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_atomic_write_keeps_links_and_never_replaces_a_device(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "link.json").symlink_to("real.json")
    write_text_atomic(tmp_path / "link.json", "new")
    assert (tmp_path / "link.json").is_symlink()
    assert (tmp_path / "real.json").read_text() == "new"
    write_text_atomic("/dev/null", "gone")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(IsADirectoryError):
        check_writable(tmp_path)
    with pytest.raises(FileNotFoundError):
        check_writable(tmp_path / "missing" / "a.json")
