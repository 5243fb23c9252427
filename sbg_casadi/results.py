"""A folder of results that appears and is replaced as a whole, and never takes the place of anything else."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from sbg_casadi.errors import UserError
from sbg_casadi.files import check_writable

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

MARKER = ".sbg-results"
_EXCHANGE, _HERE = 2, -100  # RENAME_EXCHANGE and AT_FDCWD of Linux


@dataclass(frozen=True, slots=True)
class ResultsFolder:
    """A place for the results of one command, checked before the work and filled after it.

    Attributes
    ----------
    path : Path
        Folder, as the user named it.
    command : str
        Command that makes the results, such as ``"sbg study iso-f2"``; only its own earlier results are replaced.
    extra : str or None
        Name of a JSON file that the user wants inside the folder.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as parent:
    ...     folder = ResultsFolder.claim(Path(parent) / "results", "sbg study iso-f2", ["summary.txt"])
    ...     folder.fill(lambda place: print((place / "summary.txt").write_text("done")))
    ...     sorted(p.name for p in (Path(parent) / "results").iterdir())
    4
    ['.sbg-results', 'summary.txt']
    """

    path: Path
    command: str
    extra: str | None = None

    @classmethod
    def claim(
        cls, path: Path, command: str, own_files: Iterable[str] = (), json_file: Path | None = None
    ) -> ResultsFolder:
        """Check that results can be put at a path; writes nothing.

        Parameters
        ----------
        path : Path
            Folder to make or to replace.
        command : str
            Command that will fill it.
        own_files : iterable of str
            Names of the files the command makes.
        json_file : Path, optional
            A further file the user wants, which may lie inside the folder.

        Raises
        ------
        UserError
            If the path is a file, the current folder or a mount point, holds anything but earlier results of the same
            command, or the JSON file would take the place of another result.
        OSError
            If its parent is missing or can't be written, or the JSON file can't.
        """
        target = path.resolve()
        if Path.cwd().is_relative_to(target) or target.is_mount() or target == target.parent:
            raise UserError(f"--out {path}: expected a folder of its own, not the current one or a mount point")
        if not target.parent.is_dir():
            raise FileNotFoundError(f"there is no folder {target.parent} to put {target.name} into")
        with _alone(target.parent):
            _check_contents(path, command)
        _probe(target.parent)
        extra: str | None = None
        if json_file is not None and json_file.resolve().parent == target:
            extra = json_file.name
        if json_file is not None and extra is None:
            check_writable(json_file)
        taken = {*own_files, MARKER} - {own_json(command)}
        if json_file is not None and (extra in taken or json_file.resolve() == target):
            raise UserError(f"--json {json_file} would take the place of another result; expected another name")
        return cls(path, command, extra)

    def fill(self, make: Callable[[Path], None]) -> None:
        """Make the results in a temporary folder beside the path, then put it there in one step.

        Parameters
        ----------
        make : callable
            Writes all files into the folder it is given.

        Raises
        ------
        UserError
            If something else has come to lie at the path meanwhile.
        OSError
            If a file can't be written; whatever was at the path is untouched then.
        """
        target = self.path.resolve()
        place = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.", suffix=".partial"))
        try:
            make(place)
            names = sorted(p.name for p in place.iterdir())
            marker = {"schema": 1, "command": self.command, "files": names}
            (place / MARKER).write_text(json.dumps(marker, indent=2) + "\n", encoding="utf-8")
            place.chmod(0o755)
            with _alone(target.parent):
                _check_contents(self.path, self.command)
                if not target.exists():
                    os.rename(place, target)
                elif not _exchange(place, target):
                    _replace(place, target)
        finally:
            shutil.rmtree(place, ignore_errors=True)


def own_json(command: str) -> str:
    """Return the name of the JSON file that a command makes: ``sbg study iso-f2`` makes ``study.json``."""
    return f"{command.split()[1]}.json"


def _check_contents(path: Path, command: str) -> None:
    """Refuse a path that holds anything but earlier results of the same command; a missing or empty folder is fine."""
    if not os.path.lexists(path):
        return
    if not path.is_dir():
        raise UserError(f"{path} is a file; expected a folder for the results")
    names = {p.name for p in path.iterdir()}
    if not names:
        return
    if MARKER not in names:
        raise UserError(
            f"{path} holds files that are no earlier results ({min(names)}); expected a new folder or earlier results"
        )
    try:
        marker = json.loads((path / MARKER).read_text(encoding="utf-8"))
        earlier, files = str(marker["command"]), {str(name) for name in marker["files"]}
    except (OSError, ValueError, KeyError, TypeError):
        raise UserError(f"{path}: its {MARKER} can't be read; expected a new folder or earlier results") from None
    if earlier != command:
        raise UserError(f"{path} holds results of {earlier!r}; expected a new folder or results of {command!r}")
    foreign = sorted(n for n in names - {MARKER} if n not in files or not (path / n).is_file())
    if foreign:
        raise UserError(
            f"{path} also holds {foreign[0]}, which is no result of {command!r}; move it or name a new folder"
        )


def _probe(parent: Path) -> None:
    """Make and remove a folder: what a permission bit says is not the whole truth on network and read-only disks."""
    try:
        os.rmdir(tempfile.mkdtemp(dir=parent, prefix=".sbg-", suffix=".partial"))
    except OSError as error:
        raise PermissionError(
            f"{parent} is not writable ({error.strerror}); expected a place for the results"
        ) from None


@contextmanager
def _alone(parent: Path) -> Iterator[None]:
    """Hold other runs off their swaps meanwhile, by a lock on the folder itself, which leaves no file behind."""
    if fcntl is None:
        yield
        return
    handle = os.open(parent, os.O_RDONLY)
    try:
        # Some network disks can't lock folders; each swap is safe in itself there, only its check is not.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _exchange(place: Path, target: Path) -> bool:
    """Exchange two folders in one step; False where the system (not Linux) or the disk can't."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if rename(_HERE, os.fsencode(place), _HERE, os.fsencode(target), _EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code), str(target))


def _replace(place: Path, target: Path) -> None:
    """Exchange two folders in three renames; the earlier one comes back when the new one can't be put."""
    aside = place.with_suffix(".earlier")
    os.rename(target, aside)
    try:
        os.rename(place, target)
    except BaseException:
        os.rename(aside, target)
        raise
    os.rename(aside, place)
