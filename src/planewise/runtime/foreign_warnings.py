"""Warnings of other packages, kept down; their filters belong to the whole process."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from planewise.runtime.forks import lock_of_module

_LOCK = lock_of_module()


@contextmanager
def without_warnings(*kinds: type[Warning], message: str = "") -> Iterator[None]:
    """Keep warnings of these kinds down that begin like this, one thread at a time.

    Of two threads that each change the filters and put them back, one would put back those of the
    other.
    """
    with _LOCK, warnings.catch_warnings():
        for kind in kinds:
            warnings.filterwarnings("ignore", message, kind)
        yield
