"""Frames whose readings look like something else than they are taken for."""

from __future__ import annotations

from collections.abc import Iterable

from planewise.commands import terminal
from planewise.wording import counted


class FrameDoubts:
    """Counts what is said of frames by its kind, and warns of each kind once.

    Parameters
    ----------
    said : iterable of str
        Of frames (`planewise.misread.misread`), empty where there is nothing to say.
    """

    def __init__(self, said: Iterable[str] = ()) -> None:
        self._frames: dict[str, tuple[int, str]] = {}
        for each in said:
            self.see(each)

    def see(self, said: str) -> None:
        """Take note of a frame."""
        if said:
            kind, _, _ = said.partition(",")  # what follows may differ from frame to frame
            count, first = self._frames.get(kind, (0, said))
            self._frames[kind] = count + 1, first

    def warn(self) -> None:
        """Say how many frames there were of each kind, and what of the first."""
        for count, said in self._frames.values():
            terminal.warning(f"{counted(count, 'frame')}: {said}")
