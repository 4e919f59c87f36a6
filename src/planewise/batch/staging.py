"""Files that appear in a store whole, and survive a loss of power once they are there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from planewise.errors import PlanewiseError


class Staging:
    """Folder for unfinished files of one writer; what a killed one left there goes.

    Parameters
    ----------
    folder : Path
        On the file system of the store; made, or emptied.
    """

    def __init__(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.folder = folder
        self._count = 0

    def unfinished(self) -> Path:
        """Give a name that nothing has."""
        self._count += 1
        return self.folder / str(self._count)

    def write(self, data: bytes) -> Path:
        """Write an unfinished file."""
        path = self.unfinished()
        path.write_bytes(data)
        return path

    def publish(self, data: bytes, target: Path) -> None:
        """Make `target`, or replace it, at once and for good."""
        move_whole(self.write(data), target)
        sync_folder(target.parent)

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)


def refuse_links(paths: Iterable[Path]) -> None:
    """Refuse to write to a store where links in it lead elsewhere, as a stranger's may.

    Raises
    ------
    PlanewiseError
        If one of these is a link.
    """
    for path in paths:
        if path.is_symlink():
            raise PlanewiseError(
                f"store: {path} is a link, and what is written to a store stays in it; delete it, "
                "or put there what it leads to"
            )


def move_whole(unfinished: Path, target: Path) -> None:
    """Bring a file to the disk, then into place; `sync_folder` makes its name last."""
    _sync(unfinished, os.O_RDWR)
    unfinished.replace(target)


def sync_folder(folder: Path) -> None:
    """Make names in a folder survive a loss of power."""
    _sync(folder, os.O_RDONLY)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
