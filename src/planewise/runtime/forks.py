"""Forked processes have none of their parent's threads, but what these had locked."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable


def in_child(renew: Callable[[], None]) -> None:
    """Have something called in every process that is forked from this one."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=renew)


def lock_of_module() -> threading.Lock:
    """Lock that no fork leaves locked: one waits until no thread has it."""
    lock = threading.Lock()
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(
            before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release
        )
    return lock
