"""Frames with true planes: synthetic scenes, and labelled real sets where they are at hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.frames import Frame, frame_of
from planewise import scenes

CHOOSE = {
    "nyu_dpd": {2, 19, 78, 161, 163, 271, 294, 295, 336, 337, 342, 353, 384, 408, 415, 417},
    "abw_segcomp": {0, 2, 4, 6, 8},
    "mosd_boxes": {2, 8, 15, 16, 17, 18, 22},
    "mosd_curved": {34, 42},
}
"""Numbers of the frames on which settings are chosen; all others only report.

Rooms in the order of their numbers go to one half and the other by turns. Rooms of nyu_dpd, told
from the pictures: 2, 15, 19, 24-27, 78, 150, 161-163, 171, 271, 284, 294-295, 311, 336-337,
339-341, 342, 345, 353, 369-371, 384, 392, 408, 411-414, 415-417. Arrangements of boxes in
mosd_boxes: 2, 4-5, 8, 11-13, 15-18, 20, 22. Elsewhere every frame is its own.
"""

PER_SURFACE = {"abw_segcomp"}
"""Sets whose labels tell surfaces of one plane apart: there 34 pairs of them lie in one plane. In
`mosd_boxes` none do, and the top of a box has one label on both sides of a box before it."""

REAL = tuple(CHOOSE)
SYNTHETIC = ("rooms", "room_faces", "staircase", "corner")


@dataclass(frozen=True, kw_only=True)
class LabelledFrame:
    """A frame and its truth.

    Attributes
    ----------
    frame : Frame
        Depth image, camera and sensor.
    truth : ndarray of int
        True labels.
    planes : ndarray of float, optional
        True parameters.
    chosen_on : bool
        Whether settings may be chosen on it.
    per_surface : bool
        Whether surfaces that share a plane have labels of their own.
    """

    frame: Frame
    truth: NDArray[np.integer]
    planes: NDArray[np.float64] | None = None
    chosen_on: bool
    per_surface: bool = False

    def cropped(self, top: int, left: int) -> LabelledFrame:
        """The same without its first rows and columns."""
        frame, truth = self.frame, self.truth[top:, left:]
        assert isinstance(frame.camera, pw.PinholeCamera)
        cropped = replace(
            frame,
            name=f"{frame.name}+{top}+{left}",
            depth=frame.depth[top:, left:],
            camera=frame.camera.cropped(top, left, truth.shape),
        )
        return replace(self, frame=cropped, truth=truth)


class AbsentError(Exception):
    """A set is not at hand."""


def frames_of(name: str, folder: Path, *, quick: bool = False) -> Iterator[LabelledFrame]:
    """Frames of a set; real ones from a subfolder of `folder`.

    Raises
    ------
    AbsentError
        If the files of a real set are not there.
    """
    seeds = 5 if quick else 50
    if name == "rooms":
        return _synthetic(name, scenes.room, 5 if quick else 20)
    if name == "room_faces":
        return _synthetic(name, partial(scenes.room, every_face=True), 5 if quick else 20)
    if name == "staircase":
        return _synthetic(name, partial(_seeded, scenes.staircase), seeds)
    if name == "corner":
        return _synthetic(name, partial(_seeded, scenes.corner), seeds)
    paths = sorted((folder / name).glob("*.npz"), key=_number)
    if not paths:
        raise AbsentError(f"there are no files {folder / name}/*.npz")
    return _real(name, paths)


def _seeded(make: Callable[..., pw.scenes.Scene], seed: int) -> pw.scenes.Scene:
    return make(rng=seed)


def _synthetic(
    name: str, make: Callable[[int], pw.scenes.Scene], seeds: int
) -> Iterator[LabelledFrame]:
    """Even seeds to choose on, odd ones to report."""
    for seed in range(seeds):
        scene = make(seed)
        yield LabelledFrame(
            frame=Frame(f"{name}/{seed}", scene.depth, scene.camera, scene.sensor),
            truth=scene.labels,
            planes=scene.planes,
            chosen_on=seed % 2 == 0,
        )


def _real(name: str, paths: list[Path]) -> Iterator[LabelledFrame]:
    for path in paths:
        with np.load(path) as arrays:
            yield LabelledFrame(
                frame=frame_of(path, arrays),
                truth=arrays["gt"],
                chosen_on=_number(path) in CHOOSE[name],
                per_surface=name in PER_SURFACE,
            )


def _number(path: Path) -> int:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else -1
