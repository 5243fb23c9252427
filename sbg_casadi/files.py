"""Writing results so that a reader never meets half a file."""

from __future__ import annotations

import os
from pathlib import Path


def check_writable(path: Path) -> None:
    """Raise OSError when a file can't be written at a path; called before long work, writes nothing.

    Raises
    ------
    OSError
        If the path is a folder, or its folder is missing or not writable.
    """
    folder = path.parent
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; expected the name of a file to write")
    if not folder.is_dir():
        raise FileNotFoundError(f"there is no folder {folder} to write {path.name} into")
    target = path if path.exists() and not path.is_file() else folder
    if not os.access(target, os.W_OK):
        raise PermissionError(f"{target} is not writable; expected a place to write {path.name}")


def write_text_atomic(path: str | Path, text: str) -> None:
    """Write a text file as a whole: a temporary file in the same folder takes its place, or nothing changes.

    A path that exists and is no regular file (``/dev/stdout``, a pipe) is written directly, for it can't be replaced.

    Parameters
    ----------
    path : str or Path
        File to write; a symbolic link keeps pointing where it does.
    text : str
        Contents, written as UTF-8.

    Raises
    ------
    OSError
        If the file can't be written; an earlier file of that name is then untouched.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_text_atomic(Path(folder) / "a.json", "{}")
    ...     print((Path(folder) / "a.json").read_text())
    {}
    """
    path = Path(path)
    check_writable(path)
    if path.exists() and not path.is_file():
        path.write_text(text, encoding="utf-8")
        return
    path = path.resolve()
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "x", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException:  # also on an interrupt: no leftovers
        temporary.unlink(missing_ok=True)
        raise
