"""Frames done by processes of this machine, of which any may die."""

from __future__ import annotations

import contextlib
import signal
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from planewise.arguments import make_counts
from planewise.batch import workers
from planewise.batch.frame_work import FrameWork, Outcome, failure
from planewise.errors import PlanewiseError

Frame = tuple[int, str]

_AHEAD = 2  # frames a worker has been given: the one that it does, and the next one
_TRIES = 2  # of a frame with which a worker dies
_DEAD_STARTS = 3  # workers in a row that die before they begin
_PATIENCE = 5.0  # seconds for a worker to end by itself
_READY = "ready"


def _serve(pipe: Connection) -> None:
    """Do frames until the pipe closes: what a worker runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    with contextlib.suppress(EOFError, OSError):  # that process has ended
        work: FrameWork = pipe.recv()
        pipe.send(_READY)
        while True:
            pipe.send(work(*pipe.recv()))


@dataclass(eq=False)
class _Worker:
    process: BaseProcess
    pipe: Connection
    ready: bool = False
    given: deque[Frame] = field(default_factory=deque)

    def end(self) -> None:
        self.pipe.close()
        self.process.terminate()
        self.process.join(_PATIENCE)
        if self.process.exitcode is None:
            self.process.kill()
            self.process.join()
        self.process.close()


@dataclass(frozen=True, kw_only=True)
class LocalEngine:
    """Processes of this machine, one frame each at a time.

    The frame with which a worker dies is tried once more, then it has failed; the frames that
    waited behind it go to others.

    Parameters
    ----------
    workers : int
        How many processes.
    """

    workers: int

    def __post_init__(self) -> None:
        make_counts(self, "workers")

    def run(self, work: FrameWork, frames: Iterable[Frame]) -> Iterator[Outcome]:
        """See `planewise.batch.engine.Engine`."""
        pool = _Pool(work, iter(frames))
        try:
            # The first loads or compiles what the others then find.
            pool.start()
            while pool.workers:
                yield from pool.step()
                while pool.begun and pool.frames_left and len(pool.workers) < self.workers:
                    pool.start()
        finally:
            pool.close()


class _Pool:
    """Workers, and the frames that no one has been given yet."""

    def __init__(self, work: FrameWork, frames: Iterator[Frame]) -> None:
        self._work, self._frames = work, frames
        self._again: deque[Frame] = deque()
        self._deaths: dict[Frame, int] = {}
        self._dead_starts = 0
        self.frames_left = True
        self.begun = False
        self.workers: list[_Worker] = []

    def start(self) -> None:
        """Start a worker."""
        ours, theirs = Pipe()
        process = workers.started(_serve, theirs)
        theirs.close()
        worker = _Worker(process, ours)
        self.workers.append(worker)
        with contextlib.suppress(OSError):  # it is dead already, as `step` will see
            ours.send(self._work)

    def step(self) -> Iterator[Outcome]:
        """Wait until a worker has something to say, or dies."""
        talking = wait([worker.pipe for worker in self.workers])
        for worker in [each for each in self.workers if each.pipe in talking]:
            if worker not in self.workers:  # ended with the last frame of another
                continue
            try:
                said = worker.pipe.recv()
            except (EOFError, OSError):
                yield from self._buried(worker)
                continue
            if said == _READY:
                worker.ready = self.begun = True
                self._dead_starts = 0
            else:
                self._deaths.pop(worker.given.popleft(), None)
                yield said
            self._give(worker)

    def close(self) -> None:
        """End all workers."""
        for worker in self.workers:
            worker.process.terminate()
        for worker in self.workers:
            worker.end()
        self.workers.clear()

    def _give(self, worker: _Worker) -> None:
        """Give a worker frames, or an end where there are none."""
        while len(worker.given) < _AHEAD:
            frame = self._next()
            if frame is None:
                break
            try:
                worker.pipe.send(frame)
            except OSError:  # dead: `step` will see
                self._again.appendleft(frame)
                return
            worker.given.append(frame)
        if not worker.given and not self._anyone_busy():
            for each in self.workers:
                each.end()
            self.workers.clear()

    def _next(self) -> Frame | None:
        if self._again:
            return self._again.popleft()
        frame = next(self._frames, None)
        self.frames_left = frame is not None
        return frame

    def _anyone_busy(self) -> bool:
        # An idle worker stays as long as a frame of another may come back.
        return any(worker.given for worker in self.workers)

    def _buried(self, worker: _Worker) -> Iterator[Outcome]:
        """Hand on what a dead worker had been given."""
        self.workers.remove(worker)
        worker.process.join(_PATIENCE)
        cause = _cause(worker.process.exitcode)
        worker.end()
        if not worker.ready:
            self._dead_starts += 1
            if self._dead_starts >= _DEAD_STARTS:
                raise PlanewiseError(f"workers: {self._dead_starts} in a row {cause} at the start")
        if worker.given:
            frame = worker.given.popleft()
            self._deaths[frame] = self._deaths.get(frame, 0) + 1
            if self._deaths[frame] < _TRIES:
                self._again.append(frame)
            else:
                yield failure(*frame, f"{_TRIES} workers {cause} with this frame")
            self._again.extendleft(reversed(worker.given))
        self.start()


def _cause(code: int | None) -> str:
    if code is not None and code < 0:
        names = {each.value: each.name for each in signal.Signals}  # of those that have one
        return f"were killed by {names.get(-code, f'signal {-code}')}"
    return f"ended with code {code}"
