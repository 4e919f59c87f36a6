"""Where the time of a call goes: its stages, named in the code and recorded on request."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from types import TracebackType


class _Record:
    """Seconds of every stage, and of the stages that ended inside the one under way."""

    __slots__ = ("inside", "seconds")

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.inside = 0.0


class _Stage:
    __slots__ = ("before", "name", "record", "start")

    def __init__(self, name: str, record: _Record) -> None:
        self.name, self.record = name, record

    def __enter__(self) -> None:
        self.before, self.record.inside = self.record.inside, 0.0
        self.start = time.perf_counter()

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        spent = time.perf_counter() - self.start
        seconds, record = self.record.seconds, self.record
        seconds[self.name] = seconds.get(self.name, 0.0) + spent - record.inside
        record.inside = self.before + spent


_RECORD: ContextVar[_Record | None] = ContextVar("planewise_stages", default=None)
_UNRECORDED = nullcontext()


def stage(name: str) -> AbstractContextManager[None]:
    """Name a part of the work; costs a fraction of a microsecond where nobody records."""
    record = _RECORD.get()
    return _UNRECORDED if record is None else _Stage(name, record)


@contextmanager
def recorded() -> Iterator[dict[str, float]]:
    """Record the stages that end inside the block, in this thread.

    Yields
    ------
    dict
        Seconds by name in the order in which stages first ended: all times a stage was entered
        together, without the stages inside it.

    Examples
    --------
    >>> with recorded() as seconds, stage("outer"), stage("inner"):
    ...     pass
    >>> list(seconds)
    ['inner', 'outer']
    """
    record = _Record()
    token = _RECORD.set(record)
    try:
        yield record.seconds
    finally:
        _RECORD.reset(token)
