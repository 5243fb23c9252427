"""CasADi functions and generated C compiled to machine code, kept in one cache folder by content."""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca

FLAGS = ("-O3", "-fno-math-errno", "-fPIC", "-shared")
"""Flags of the C compiler; value-preserving, so that results do not change with them but for contracted products."""

_LARGEST = 1_500_000  # characters of C, some 40,000 operations or 10 s of compilation
_TIMEOUT = 120.0  # seconds


class NoMachineCode(Exception):
    """Machine code can't be had; the message is the reason. Not an error of the model: the same runs without."""


def find_compiler() -> str | None:
    """Return the path of a C compiler (``CC`` of the environment, cc, gcc or clang), or None."""
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


def compiled_function(function: ca.Function) -> tuple[ca.Function, str]:
    """Return the same function as machine code where that can be had, else the function itself.

    Parameters
    ----------
    function : casadi.Function
        Of SX or MX; what it calls is generated with it.

    Returns
    -------
    function : casadi.Function
        Same name, arguments and results. Machine code has no derivatives: differentiate first, then compile.
    note : str
        A sentence on what was compiled, or why nothing was.

    Notes
    -----
    The first compilation takes 0.1 s or more (1 s for 10,000 operations), a later one of the same content 1 ms,
    also in another process: see :func:`library`.

    Examples
    --------
    >>> x = ca.SX.sym("x")
    >>> square, note = compiled_function(ca.Function("square", [x], [x**2]))
    >>> float(square(3.0))
    9.0
    """
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    try:
        generator.add(function)
        source = str(generator.dump())
    except RuntimeError as error:  # for instance a callback or an integrator inside
        return function, f"{function.name()!r} runs in CasADi's virtual machine: no C can be generated ({error})"
    try:
        return ca.external(function.name(), library(source)), f"{function.name()!r} is compiled with {find_compiler()}"
    except NoMachineCode as reason:
        return function, f"{function.name()!r} runs in CasADi's virtual machine: {reason}"
    except RuntimeError as error:  # dlopen
        return function, f"{function.name()!r} runs in CasADi's virtual machine: its library does not load ({error})"


def library(source: str) -> str:
    """Return the path of a shared library compiled from C, from the cache when it is there.

    Parameters
    ----------
    source : str
        C that needs no more than the standard library and libm.

    Raises
    ------
    NoMachineCode
        If there is no compiler, it fails, or the source is too large.

    Notes
    -----
    The cache folder is that of the environment variable CONTINUATION_CACHE, else ``continuation`` in XDG_CACHE_HOME,
    else ``~/.cache/continuation``; a folder of this process alone where that can't be written. The name of a
    library is the SHA-256 of everything that goes into it and the SHA-256 of its bytes: bytes that do not fit their
    name are never loaded but compiled again. Several processes may compile the same at once; whole files replace
    each other. Nothing is ever evicted; the folder may be deleted at any time.
    """
    compiler = find_compiler()
    if compiler is None:
        raise NoMachineCode("no C compiler was found")
    if len(source) > _LARGEST:
        raise NoMachineCode(
            f"its C has {len(source)} characters, more than the {_LARGEST} that compile in reasonable time"
        )
    made_of = (source, _version(compiler), platform.machine(), platform.system(), *FLAGS)
    key = hashlib.sha256("\0".join(made_of).encode()).hexdigest()[:32]
    folder = _cache_folder()
    return _intact(folder, key) or _build(folder, key, compiler, source)


def _intact(folder: Path, key: str) -> str:
    """Return the library of that content whose bytes fit its name; others are removed."""
    for path in sorted(folder.glob(f"{key}-*.so")):
        try:
            if path.name == _name(key, path.read_bytes()):
                return str(path)
            path.unlink()
        except OSError:
            continue  # removed or replaced by another process meanwhile: compiling again is always right
    return ""


def _build(folder: Path, key: str, compiler: str, source: str) -> str:
    try:
        with tempfile.TemporaryDirectory(prefix="build-", dir=folder) as place:
            made = Path(place) / "library.so"
            command = [compiler, *FLAGS, "-x", "c", "-", "-o", str(made), "-lm"]
            subprocess.run(command, input=source, check=True, capture_output=True, text=True, timeout=_TIMEOUT)
            path = folder / _name(key, made.read_bytes())
            os.replace(made, path)
    except (OSError, subprocess.SubprocessError) as error:
        said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
        reason = next((line for line in said if "error" in line), said[-1] if said else "no message")
        raise NoMachineCode(f"the C compiler {compiler} failed: {reason}") from error
    return str(path)


def _name(key: str, content: bytes) -> str:
    return f"{key}-{hashlib.sha256(content).hexdigest()[:32]}.so"


def _cache_folder() -> Path:
    chosen = os.environ.get("CONTINUATION_CACHE")
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = Path(chosen) if chosen else base / "continuation"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):  # read-only, full, or no home folder
        return _private_folder()


@functools.cache
def _private_folder() -> Path:
    folder = tempfile.mkdtemp(prefix="continuation-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


@functools.cache
def _version(compiler: str) -> str:
    try:
        said = subprocess.run([compiler, "--version"], check=True, capture_output=True, text=True, timeout=_TIMEOUT)
    except (OSError, subprocess.SubprocessError) as error:
        raise NoMachineCode(f"the C compiler {compiler} failed: {error}") from error
    return f"{compiler} {said.stdout}"
