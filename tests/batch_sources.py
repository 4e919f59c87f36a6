"""Sources for tests of `planewise.batch`; workers import them from here."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from planewise.batch import DepthFolder


class Deadly(DepthFolder):
    """Folder in which a frame kills the process that reads it, always or so many times."""

    def __init__(self, folder, deadly, times=None, marks=None):
        super().__init__(folder)
        self.deadly, self.times, self.marks = deadly, times, marks

    def __getitem__(self, frame):
        if frame == self.deadly:
            marks = len(list(Path(self.marks).iterdir())) if self.marks else 0
            if self.times is None or marks < self.times:
                if self.marks:
                    (Path(self.marks) / str(time.time_ns())).touch()
                os.kill(os.getpid(), signal.SIGKILL)
        return super().__getitem__(frame)


class Slow(DepthFolder):
    """Folder whose frames take a while."""

    def __init__(self, folder, seconds):
        super().__init__(folder)
        self.seconds = seconds

    def __getitem__(self, frame):
        time.sleep(self.seconds)
        return super().__getitem__(frame)


class Renamed:
    """The frames of a folder under other ids."""

    name = "renamed"

    def __init__(self, folder, ids):
        self._folder = DepthFolder(folder)
        self._old = dict(zip(ids, self._folder.ids, strict=False))
        self.ids = tuple(self._old)

    def __getitem__(self, frame):
        return self._folder[self._old[frame]]
