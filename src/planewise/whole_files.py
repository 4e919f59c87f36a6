"""Files, and folders of them, that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from planewise.errors import PlanewiseError


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a name to write to that becomes `path` when the block ends without error.

    Parameters
    ----------
    path : Path
        Replaced if it exists, or what it links to; its folder has to be there.

    Yields
    ------
    Path
        Beside it, with the same ending.

    Raises
    ------
    PlanewiseError
        On entry, if it is no regular file, or its folder is none or cannot be written to.
    """
    path = path.resolve()
    if path.exists() and not path.is_file():
        raise PlanewiseError(f"output: {path} is not a regular file; give the name of another")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise PlanewiseError(f"output: {path.parent} is not a folder that can be written to")
    partial = path.with_name(f"{_unique()}{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def output_folder(target: str | Path, stale: Iterable[str] = ()) -> Iterator[Path]:
    """Give a folder to write to that becomes `target` when the block ends without error.

    Parameters
    ----------
    target : path
        Folder to make, with its parents. Where it exists, files of the same names are replaced and
        others stay.
    stale : iterable of str
        Names of others that do not stay: an earlier run may have written them, and they belong to
        what is replaced.

    Yields
    ------
    Path
        Empty folder on the same file system.

    Raises
    ------
    PlanewiseError
        On entry, if the folder cannot be made or written to.
    """
    target = Path(target)
    made = [path for path in (target, *target.parents) if not path.exists()]
    # Inside an existing folder, which may be a file system of its own; else beside the new one.
    place = target if target.is_dir() else target.parent
    staging = place / _unique()
    try:
        if target.is_symlink() and not target.exists():
            raise PlanewiseError(f"output: {target} is a link to what is not there")
        if target.exists() and not target.is_dir():
            raise PlanewiseError(f"output: {target} exists and is not a folder")
        if target.exists() and not os.access(target, os.W_OK | os.X_OK):
            raise PlanewiseError(f"output: the folder {target} cannot be written to")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            staging.mkdir()
        except OSError as error:
            raise PlanewiseError(
                f"output: the folder {target} cannot be made ({error.strerror or error})"
            ) from None
        yield staging
        _publish(staging, target, stale)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        remove_empty(made[1:])
        raise


@contextmanager
def parent_folder(target: str | Path) -> Iterator[Path]:
    """Make a folder for the results of many frames; it goes again if it stays empty.

    Raises
    ------
    PlanewiseError
        On entry, if it cannot be made or written to.
    """
    target = Path(target)
    made = [path for path in (target, *target.parents) if not path.exists()]
    if target.exists() and not (target.is_dir() and os.access(target, os.W_OK | os.X_OK)):
        raise PlanewiseError(f"output: {target} is not a folder that can be written to")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlanewiseError(
            f"output: the folder {target} cannot be made ({error.strerror or error})"
        ) from None
    try:
        yield target
    finally:
        remove_empty(made)


def remove_empty(folders: list[Path]) -> None:
    """Remove those folders, in this order, that are empty."""
    for folder in folders:
        with suppress(OSError):  # not empty, or not there
            folder.rmdir()


def _unique() -> str:
    """Name that nobody else has: processes of two containers may have the same number."""
    return f".{secrets.token_hex(8)}.partial"


def _publish(staging: Path, target: Path, stale: Iterable[str]) -> None:
    if not target.exists():
        try:
            staging.rename(target)
            return
        except OSError:
            if not target.is_dir():  # which another process has just made
                raise
    for path in (*staging.iterdir(), *map(Path, stale)):
        if (target / path.name).is_dir():  # before anything is replaced
            raise PlanewiseError(f"output: {target / path.name} is a folder; give another folder")
    for name in stale:
        if not (staging / name).exists():
            (target / name).unlink(missing_ok=True)
    for path in sorted(staging.iterdir()):
        path.replace(target / path.name)
    staging.rmdir()
