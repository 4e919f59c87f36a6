"""Frames done by Ray's workers, on this machine or a cluster whose nodes come and go."""

from __future__ import annotations

import logging
import socket
import time
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from planewise.arguments import make_counts
from planewise.batch.frame_work import FrameWork, Outcome, failure
from planewise.errors import PlanewiseError, needs

Frame = tuple[int, str]

_AHEAD = 2  # frames under way for every one that can be done at a time
_TRIES = 4  # of a frame whose worker or node dies
_SECONDS_A_LOOK = 5.0  # at how large the cluster is now
_SECONDS_TO_ANSWER = 10.0
_works: dict[str, FrameWork] = {}  # of this worker: what it has loaded stays


def _do(key: str, work: list[Any], number: int, frame: str) -> Outcome:
    """Do a frame: what a worker runs. In a list, `work` is not copied for every frame."""
    if key not in _works:
        import ray

        from planewise.compilation import without_help  # loads Numba

        without_help()
        _works.clear()
        _works[key] = ray.get(work[0])
    return _works[key](number, frame)


def _check_reachable(address: str) -> None:
    """Refuse an address at once where nothing answers: Ray itself tries for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return  # a name that Ray knows, such as auto
    try:
        socket.create_connection((host, int(port)), timeout=_SECONDS_TO_ANSWER).close()
    except (OSError, ValueError) as error:
        raise PlanewiseError(f"address: no cluster answers at {address} ({error})") from None


@dataclass(frozen=True, kw_only=True)
class RayEngine:
    """Tasks of Ray. One that is lost with its worker or node is done by another.

    Parameters
    ----------
    address : str, optional
        Of a cluster, "auto" for the one this machine is part of; ``None`` starts one of this
        machine alone, or takes the one that this process is connected to.
    workers : int, optional
        Frames done at a time, at most; ``None`` means as many as the cluster can.
    gpus : float
        GPUs for each, or the part of one.
    """

    address: str | None = None
    workers: int | None = None
    gpus: float = 0.0

    def __post_init__(self) -> None:
        if self.workers is not None:
            make_counts(self, "workers")
        if not 0 <= self.gpus < float("inf"):
            raise PlanewiseError(f"gpus must not be negative, got {self.gpus}")

    def run(self, work: FrameWork, frames: Iterable[Frame]) -> Iterator[Outcome]:
        """See `planewise.batch.engine.Engine`."""
        with needs("ray", "--engine ray", "ray"):
            import ray
        connected = ray.is_initialized()
        if not connected:
            self._connect(ray)
        try:
            yield from self._stream(ray, work, iter(frames))
        finally:
            if not connected:
                ray.shutdown()

    def _connect(self, ray: Any) -> None:
        if self.address is not None:
            _check_reachable(self.address)
        own = {"num_cpus": self.workers, "include_dashboard": False}
        try:
            ray.init(
                address=self.address,
                log_to_driver=False,
                logging_level=logging.ERROR,
                **(own if self.address is None else {}),
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise PlanewiseError(f"address: there is no cluster to be had ({reason})") from None

    def _stream(self, ray: Any, work: FrameWork, frames: Iterator[Frame]) -> Iterator[Outcome]:
        """Keep a bounded number of tasks under way, and give each outcome as it comes."""
        # max_calls=0: Ray ends the worker after every task with a GPU otherwise.
        task = ray.remote(
            num_cpus=1, num_gpus=self.gpus or None, max_calls=0, max_retries=_TRIES - 1
        )(_do)
        key, shared = uuid.uuid4().hex, ray.put(work)
        under_way: dict[Any, Frame] = {}
        most, looked = self._at_a_time(ray), time.monotonic()
        try:
            while True:
                while len(under_way) < _AHEAD * most and (frame := next(frames, None)) is not None:
                    under_way[task.remote(key, [shared], *frame)] = frame
                if not under_way:
                    return
                ready, _ = ray.wait(list(under_way), num_returns=1, timeout=_SECONDS_A_LOOK)
                for reference in ready:
                    yield self._outcome(ray, reference, under_way.pop(reference))
                if time.monotonic() - looked > _SECONDS_A_LOOK:
                    most, looked = self._at_a_time(ray), time.monotonic()
        finally:
            for reference in under_way:
                ray.cancel(reference, force=True)

    def _at_a_time(self, ray: Any) -> int:
        """Frames that the cluster, as large as it is now, can do at a time."""
        has = ray.cluster_resources()
        fits = int(has.get("CPU", 1))
        if self.gpus:
            fits = min(fits, int(has.get("GPU", 0) / self.gpus + 1e-9))
        return max(1, min(fits, self.workers or fits))

    @staticmethod
    def _outcome(ray: Any, reference: Any, frame: Frame) -> Outcome:
        try:
            outcome: Outcome = ray.get(reference)
        except ray.exceptions.RayTaskError as error:  # of ours: planewise is missing there
            reason = str(error).strip().splitlines()[-1]
            return Outcome(number=frame[0], frame=frame[1], fatal=f"ray: {reason}")
        except ray.exceptions.RayError as error:
            kind = type(error).__name__
            return failure(*frame, f"{_TRIES} workers were lost with this frame ({kind})")
        return outcome
