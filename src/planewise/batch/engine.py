"""Who does the frames: what `local_engine` and `ray_engine` have in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from planewise.batch.frame_work import FrameWork, Outcome


class Engine(Protocol):
    """Has frames done by workers; none is lost, none is done twice."""

    def run(self, work: FrameWork, frames: Iterable[tuple[int, str]]) -> Iterator[Outcome]:
        """Do frames (number and id), and give each outcome as soon as it is there.

        Only so many frames are under way as keep the workers busy. Closing the iterator ends the
        workers.

        Raises
        ------
        PlanewiseError
            If there can be no workers.
        """
        ...
