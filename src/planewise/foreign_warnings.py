"""Warnings of other packages, kept down; their filters belong to the whole process."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

_LOCK = threading.Lock()
if hasattr(os, "register_at_fork"):  # else a child might wait for a thread that it does not have
    os.register_at_fork(
        before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
    )


@contextmanager
def without_warnings(kind: type[Warning], message: str = "") -> Iterator[None]:
    """Keep warnings down that begin like this, one thread at a time.

    Of two threads that each change the filters and put them back, one would put back those of the
    other.
    """
    with _LOCK, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message, kind)
        yield
