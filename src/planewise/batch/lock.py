"""One process at a time writes a store, or one for each shard.

The locks are the system's (`flock`), which lets go of them however a process ends; the files only
say who has them. A run of all frames holds the store alone. A run of shard i of n shares it with
the other shards of the same n and the same `every`: those of others may have frames in common.
"""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from planewise.batch.segments import FOLDERS
from planewise.batch.staging import refuse_links
from planewise.errors import PlanewiseError

ALL = "all"
"""Name of who writes a whole store."""

_WHOLE = ".lock"
_REWRITING = ".lock-rewriting"
_NO_LOCKS = (errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL)


def writer_name(shard: tuple[int, int], every: int = 1) -> str:
    """Name of who writes a shard (i, n), by which its files differ from those of others."""
    part, parts = shard
    if parts == 1:
        return ALL
    return f"{part}-of-{parts}" + (f"-every-{every}" if every > 1 else "")


def beside(name: str, writer: str) -> bool:
    """Whether a writer's name, or one that ends in it, is of a shard of the same cut."""
    return name.partition("-of-")[2] == writer.partition("-of-")[2]


@contextmanager
def locked(store: Path, writer: str = ALL) -> Iterator[None]:
    """Hold a store, or a shard of it.

    Parameters
    ----------
    store : Path
        Its folder, which exists.
    writer : str
        Name of who writes.

    Raises
    ------
    PlanewiseError
        On entry, if another process holds it; the message says which. Also if what writers open or
        put files into is a link.
    """
    folders = [store / name for name in FOLDERS]
    refuse_links([*folders, *store.glob(f"{_WHOLE}*"), *store.glob("journal/*")])
    with ExitStack() as held:
        if writer == ALL:
            held.enter_context(_lock(store / _WHOLE, store))
        else:
            held.enter_context(_lock(store / _WHOLE, store, shared=True))
            held.enter_context(_lock(store / f"{_WHOLE}-{writer}", store))
            for other in store.glob(f"{_WHOLE}-*-of-*"):
                if not beside(other.name, writer):
                    with _lock(other, store, shared=True):
                        pass
        yield


@contextmanager
def rewriting(store: Path) -> Iterator[None]:
    """Have rows of other writers for oneself, once no other shard rewrites them."""
    with _lock(store / _REWRITING, store, wait=True):
        yield


def lock_files(store: Path) -> list[Path]:
    """Files of the locks of a store; who removes them holds it, and has left nothing to hold."""
    return sorted(store.glob(f"{_WHOLE}*"))


@contextmanager
def _lock(path: Path, store: Path, *, shared: bool = False, wait: bool = False) -> Iterator[None]:
    try:
        import fcntl
    except ImportError:
        raise PlanewiseError(
            "store: locks as Linux and macOS have them are needed; on Windows, use its "
            "Linux subsystem"
        ) from None
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        try:
            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(handle, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PlanewiseError(f"store: {store} is in use by {_holder(path)}") from None
        except OSError as error:
            if error.errno in _NO_LOCKS:  # then nobody else can hold it
                path.unlink(missing_ok=True)
            raise PlanewiseError(
                f"store: {store} cannot be locked by its file system ({error.strerror})"
            ) from None
        if not os.fstat(handle).st_nlink:
            raise PlanewiseError(f"store: {store} was removed by another run; start this one again")
        # Only for messages, so a full disk does not matter here.
        with contextlib.suppress(OSError):
            os.ftruncate(handle, 0)
            if not shared:
                os.write(handle, _who().encode())
        yield
    finally:
        os.close(handle)


def _who() -> str:
    since = time.strftime("%Y-%m-%d %H:%M:%S %Z")
    return f"process {os.getpid()} on {platform.node()} since {since}"


def _holder(path: Path) -> str:
    text = path.read_text(errors="replace").strip()
    if text:
        return f"another run ({text})"
    return "runs of its shards" if path.name == _WHOLE else "another run"
