"""Frames of several sizes, of which one camera fits one at most."""

from __future__ import annotations

from planewise.camera import Camera, PinholeCamera
from planewise.commands import terminal


class FrameSizes:
    """Warns, once, where frames that share a camera differ in size and it does not say its own.

    Parameters
    ----------
    camera : Camera, optional
        Of all frames; ``None`` where each states its own.
    """

    def __init__(self, camera: Camera | None) -> None:
        self._looks = isinstance(camera, PinholeCamera) and camera.width is None
        self._first: tuple[int, ...] | None = None

    def see(self, name: str, shape: tuple[int, ...]) -> None:
        """Take note of a frame and its height and width."""
        self._first = self._first or shape
        if self._looks and shape != self._first:
            self._looks = False
            (height, width), (rows, columns) = shape[:2], self._first[:2]
            terminal.warning(
                f"{name} has {width} x {height} pixels and frames before it {columns} x {rows}; "
                "--camera is in pixels of one of these sizes, and planes in the others are wrong"
            )
