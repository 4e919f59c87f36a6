"""Threads for the compiled loops, which release the interpreter's lock."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from planewise.runtime.forks import in_child

if TYPE_CHECKING:
    from concurrent.futures import Future

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 256
"""Threads that are started at most, however many are asked for."""

_PARTS = 4  # a thread, where there is enough to do
_LOOKS, _MORE = 250_000, 3_000  # for a helper that is not done: some 60 us; and when it is: 1 us
_ALLOWED: ContextVar[int] = ContextVar("planewise_threads", default=1)
_QUOTAS = (  # of a container: files that hold microseconds of processors' time, and of what period
    ("/sys/fs/cgroup/cpu.max",),
    ("/sys/fs/cgroup/cpu/cpu.cfs_quota_us", "/sys/fs/cgroup/cpu/cpu.cfs_period_us"),
)


def available() -> int:
    """Processors this process may use: those it may run on, or its container's quota if fewer."""
    try:
        processors = len(os.sched_getaffinity(0))
    except AttributeError:  # macOS, Windows
        processors = os.cpu_count() or 1
    return min(processors, _quota())


@lru_cache(maxsize=1)
def _quota() -> int:
    """Processors of a container's quota, rounded up; as good as endless without one."""
    for files in _QUOTAS:
        with suppress(OSError, ValueError):  # absent, "max"
            quota, period = " ".join(Path(each).read_text() for each in files).split()
            if int(quota) > 0:
                return -(-int(quota) // int(period))
    return sys.maxsize


def chosen(asked: int | None) -> int:
    """Threads to use where so many are asked for, or none in particular."""
    return min(asked or available(), MOST)


class _Helper:
    """A thread that waits for work; a lock wakes it sooner than a pool's queue would.

    Who waits for it looks for a while whether it is done, as it will be soon: waking takes longer.
    """

    def __init__(self) -> None:
        from planewise.kernels.waiting import look_until  # loads Numba, as who has work for it did

        self._work: Callable[[], None] | None = None
        self._error: BaseException | None = None
        self._started, self._finished = 0, np.zeros(1, np.int64)  # pieces of work
        self._look_until = look_until
        self._given, self._done = threading.Lock(), threading.Lock()
        self._given.acquire()
        self._done.acquire()
        threading.Thread(target=self._run, name="planewise", daemon=True).start()

    def _run(self) -> None:
        while True:
            self._given.acquire()
            try:
                assert self._work is not None
                self._work()
            except BaseException as error:  # raised where the result is waited for
                self._error = error
            self._work = None
            work = self._started
            self._done.release()
            self._finished[0] = work  # last of all: then the interpreter's lock is free, too

    def start(self, work: Callable[[], None]) -> None:
        """Let it work."""
        self._work = work
        self._started += 1
        self._given.release()

    def wait(self) -> None:
        """Until it is done; raises what it raised.

        An interrupt waits, too, for what the thread writes to is not free before: the first does.
        """
        interrupt: BaseException | None = None
        try:
            self._look_until(self._finished, self._started, _LOOKS, _MORE)
            self._done.acquire()
        except KeyboardInterrupt as pressed:  # before the lock was taken, or just after
            interrupt = pressed
            while self._finished[0] < self._started:
                time.sleep(0.0005)
            self._done.acquire(blocking=False)
        error, self._error = interrupt or self._error, None
        _idle.append(self)
        if error is not None:
            raise error


_idle: list[_Helper] = []
in_child(_idle.clear)


def _started(work: Callable[[], None]) -> _Helper:
    try:
        helper = _idle.pop()
    except IndexError:
        helper = _Helper()
    helper.start(work)
    return helper


def over_chunks(work: Callable[[int, int], None], size: int, threads: int, least: int = 1) -> None:
    """Call ``work(first, last)`` on consecutive parts of ``range(size)``, some of them a thread.

    What `work` writes for one element must not depend on the part it is in: then results are the
    same for any number of threads. Fewer than `least` elements are not worth a thread. Parts are
    taken by who is free, for some take longer, and not all processors are as fast.
    """
    threads = min(threads, size // least, MOST)
    if threads <= 1:
        work(0, size)
        return
    count = min(size // least, _PARTS * threads)
    parts = iter(list(pairwise(size * part // count for part in range(count + 1))))

    def take() -> None:
        for part in parts:  # each goes to one thread: the interpreter's lock is held
            work(*part)

    helpers: list[_Helper] = []
    try:
        # One by one: an interrupt waits for those that have started.
        helpers.extend(_started(take) for _ in range(threads - 1))
        take()
    finally:
        deque(parts, maxlen=0)  # after an error there is nothing more to do
        _wait(helpers)


def _wait(helpers: list[_Helper]) -> None:
    """For all of them, be there errors or not."""
    if helpers:
        try:
            helpers[0].wait()
        finally:
            _wait(helpers[1:])


@contextmanager
def allowed(threads: int) -> Iterator[None]:
    """Let `beside` and `halves` use so many threads inside the block."""
    token = _ALLOWED.set(threads)
    try:
        yield
    finally:
        _ALLOWED.reset(token)


class beside:  # noqa: N801 - used like a function
    """Do something else while the block runs, or before it where one thread is allowed.

    Neither may write what the other one reads.

    Parameters
    ----------
    work : callable
        What to do; what it raises is raised at the end of the block.
    """

    def __init__(self, work: Callable[[], None]) -> None:
        self._work = work
        self._helper: _Helper | None = None

    def __enter__(self) -> None:
        if _ALLOWED.get() > 1:
            self._helper = _started(self._work)
        else:
            self._work()

    def __exit__(self, *_: object) -> None:
        if self._helper is not None:
            self._helper.wait()


def halves(work: Callable[[int, int], None], size: int) -> None:
    """Call ``work(first, last)`` on both halves of ``range(size)``, together where allowed.

    The halves are the same for any number of threads.
    """
    middle = size // 2
    with beside(lambda: work(middle, size)):
        work(0, middle)


def in_order(
    workers: Sequence[Callable[[Item], Result]], items: Iterable[Item]
) -> Iterator[Result]:
    """Results of items in their order, by workers that each do one at a time, all side by side.

    The first is done alone, for what it prepares serves the others. At most one item more is taken
    than there are workers, and none once a result was an error, which is raised in its place.
    """
    if len(workers) == 1:
        yield from map(workers[0], items)
        return
    # Few have to wait for these imports.
    from concurrent.futures import ThreadPoolExecutor
    from queue import SimpleQueue

    idle: SimpleQueue[Callable[[Item], Result]] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def work(item: Item) -> Result:
        worker = idle.get()
        try:
            return worker(item)
        finally:
            idle.put(worker)

    under_way: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(len(workers), "planewise")
    items = iter(items)
    try:
        yield from map(work, islice(items, 1))
        failed = None
        while True:
            try:
                item = next(items)
            except StopIteration:
                break
            except Exception as error:  # in its place: what came before is under way
                failed = error
                break
            under_way.append(pool.submit(work, item))
            if len(under_way) > len(workers):
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()
        if failed is not None:
            raise failed
    finally:
        pool.shutdown(cancel_futures=True)
