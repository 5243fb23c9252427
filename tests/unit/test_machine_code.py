"""One cache of compiled code: same results, shared between processes, rebuilt when corrupt, never in the way."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

from continuation.model import machine_code
from continuation.model.machine_code import compiled_function, find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler here")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CONTINUATION_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def polynomial(factor=1.0):
    x, y = ca.SX.sym("x", 2), ca.MX.sym("y", 2)
    inner = ca.Function("inner", [x], [ca.vertcat(factor * x[0] * x[1], ca.sin(x[0])), ca.diag(x)])
    return ca.Function("outer", [y], inner(y), ["y"], ["values", "matrix"])


def libraries(cache):
    return sorted(cache.glob("*.so"))


@needs_compiler
def test_same_results_names_and_sparsity_as_the_virtual_machine(cache):
    plain = polynomial()
    fast, note = compiled_function(plain)
    assert "compiled with" in note
    assert (fast.name_in(), fast.name_out()) == (plain.name_in(), plain.name_out())
    assert [fast.sparsity_out(i) == plain.sparsity_out(i) for i in range(2)] == [True, True]
    for x in np.random.default_rng(1).normal(size=(20, 2)):
        for a, b in zip(fast(x), plain(x), strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), rtol=1e-15)
    assert len(libraries(cache)) == 1


@needs_compiler
def test_same_content_is_compiled_once_and_other_content_apart(cache):
    compiled_function(polynomial())
    first = libraries(cache)[0].stat()
    again, _ = compiled_function(polynomial())
    assert libraries(cache)[0].stat() == first
    other, _ = compiled_function(polynomial(2.0))
    assert len(libraries(cache)) == 2
    assert float(other([3.0, 4.0])[0][0]) == 2 * float(again([3.0, 4.0])[0][0]) == 24.0


@needs_compiler
def test_another_compiler_version_is_compiled_apart(cache, monkeypatch):
    compiled_function(polynomial())
    monkeypatch.setattr(machine_code, "_version", lambda compiler: "newer")
    compiled_function(polynomial())
    assert len(libraries(cache)) == 2


@needs_compiler
@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:-9] + b"\0" * 9])
def test_a_corrupt_library_is_never_loaded_but_rebuilt(cache, damage):
    compiled_function(polynomial())
    path = libraries(cache)[0]
    whole = path.read_bytes()
    path.unlink()  # a new file, so that the library loaded above is not torn away under this process
    path.write_bytes(damage(whole))
    fast, note = compiled_function(polynomial())
    assert "compiled with" in note
    assert float(fast([3.0, 4.0])[0][0]) == 12.0
    assert [p.read_bytes() for p in libraries(cache)] == [whole]


RACE = """
import casadi as ca
from continuation.model.machine_code import compiled_function
x = ca.SX.sym("x")
f, note = compiled_function(ca.Function("race", [x], [ca.exp(x) * x]))
print(float(f(1.0)), "compiled with" in note)
"""


@needs_compiler
def test_processes_may_compile_the_same_at_once(cache):
    def run(_):
        return subprocess.run([sys.executable, "-c", RACE], check=True, capture_output=True, text=True).stdout

    with ThreadPoolExecutor(2) as pool:
        said = list(pool.map(run, range(2)))
    assert said == ["2.718281828459045 True\n"] * 2
    assert len(libraries(cache)) == len(list(cache.iterdir())) == 1  # nothing half made is left


@needs_compiler
@pytest.mark.parametrize("where", ["file", "none"])
def test_an_unusable_cache_folder_is_replaced_by_a_private_one(tmp_path, monkeypatch, where):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("CONTINUATION_CACHE", str(tmp_path / "file") if where == "file" else "/proc/no/such/folder")
    fast, note = compiled_function(polynomial())
    assert "compiled with" in note
    assert float(fast([3.0, 4.0])[0][0]) == 12.0
    assert (tmp_path / "file").read_text() == "in the way"


def test_the_cache_folder_follows_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv("CONTINUATION_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert machine_code._cache_folder() == tmp_path / "xdg" / "continuation"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert machine_code._cache_folder() == tmp_path / "home" / ".cache" / "continuation"


def test_without_a_compiler_the_function_itself_and_the_reason(monkeypatch):
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    plain = polynomial()
    same, note = compiled_function(plain)
    assert same is plain
    assert note == "'outer' runs in CasADi's virtual machine: no C compiler was found"


@pytest.mark.parametrize("compiler", ["/bin/false", "/no/such/compiler"])
def test_a_compiler_that_fails_is_named(monkeypatch, compiler):
    monkeypatch.setattr(machine_code, "find_compiler", lambda: compiler)
    plain = polynomial()
    same, note = compiled_function(plain)
    assert same is plain
    assert f"{compiler} failed" in note


@needs_compiler
def test_a_message_of_the_compiler_is_passed_on(cache):
    with pytest.raises(machine_code.NoMachineCode, match=r"failed: .*error"):
        machine_code.library("this is not C;")
    assert list(cache.iterdir()) == []


@needs_compiler
def test_source_beyond_reason_is_left_to_the_virtual_machine(monkeypatch):
    monkeypatch.setattr(machine_code, "_LARGEST", 1000)
    plain = polynomial()
    same, note = compiled_function(plain)
    assert same is plain
    assert "characters" in note


@needs_compiler
def test_a_function_without_c_is_left_to_the_virtual_machine():
    class Twice(ca.Callback):
        def __init__(self):
            ca.Callback.__init__(self)
            self.construct("twice", {})

        def eval(self, arg):
            return [2 * arg[0]]

    twice, x = Twice(), ca.MX.sym("x")
    plain = ca.Function("outer", [x], [twice(x)])
    same, note = compiled_function(plain)
    assert float(same(2.0)) == 4.0
    assert "virtual machine" in note
