"""Datasets of one file a depth image: what they have in common. Each says which files these are."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.paths import inside, listed, matrix_of
from planewise.files.colour import is_picture, read_colour
from planewise.files.depth import is_depth_file, read_depth
from planewise.wording import counted

_LOG = logging.getLogger("planewise")

STAMPED = re.compile(r"(\d+)-(\d+)")
"""Names as of Redwood: number of the frame, time in microseconds."""

_NUMBERED = re.compile(r"(.*?)(\d+(?:\.\d+)?)(\D*)", re.DOTALL)


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameFiles:
    """Files of one frame, as paths below the dataset's folder.

    Attributes
    ----------
    id : str
        Of the frame.
    depth : str
        Depth image.
    rgb : str, optional
        Colour picture.
    pose : str, optional
        Text with a 4 x 4 matrix, from the camera's frame to the world's.
    timestamp : float, optional
        Seconds.
    """

    id: str
    depth: str
    rgb: str | None = None
    pose: str | None = None
    timestamp: float | None = None


class PictureFolder(Dataset):
    """Frames that are files of a folder.

    Parameters
    ----------
    folder : Path
        The dataset; no file outside it is read.
    frames : iterable of FrameFiles
        In order.
    camera : Camera
        Of the depth images.
    depth_scale : float, optional
        Metres per unit of integer depth; may be left out where depth is in metres.
    invalid : int, optional
        Integer depth that means no reading, besides 0.
    """

    def __init__(
        self,
        folder: Path,
        frames: Iterable[FrameFiles],
        camera: Camera,
        depth_scale: float | None,
        invalid: int | None = None,
    ) -> None:
        self.folder, self.camera, self.depth_scale = folder, camera, depth_scale
        self._invalid = invalid
        files = list(frames)
        known = list({each.depth: each for each in reversed(files)}.values())[::-1]
        if len(known) < len(files):
            more = counted(len(files) - len(known), "depth image")
            _LOG.warning(f"{folder.name}: {more} listed again, and taken once")
        self._files = {each.id: each for each in known}
        super().__init__(folder.name or str(folder), [each.id for each in known])

    def _read(self, frame: str) -> DatasetFrame:
        files = self._files[frame]
        depth = self._depth(inside(self.folder, files.depth))
        if self._invalid is not None and depth.dtype.kind != "f":
            depth[depth == self._invalid] = 0
        return DatasetFrame(
            id=frame,
            depth=depth,
            camera=self.camera,
            depth_scale=None if depth.dtype.kind == "f" else self.depth_scale,
            rgb=self._picture(files.rgb),
            timestamp=files.timestamp,
            pose=self._pose(files) if self.poses else None,
        )

    def _depth(self, path: Path) -> NDArray[Any]:
        """Depth image of a file."""
        return read_depth(path).depth

    def _pose(self, files: FrameFiles) -> NDArray[np.float64] | None:
        return None if files.pose is None else pose_of(self.folder, files.pose)

    def _picture(self, name: str | None) -> NDArray[np.uint8] | None:
        if name is None or not self.pictures:
            return None
        return read_colour(inside(self.folder, name))

    @property
    def pictured(self) -> tuple[str, ...]:
        """Ids of the frames that have a picture."""
        return tuple(each for each in self.ids if self._files[each].rgb is not None)


def depth_and_colour(folder: Path, colour: Iterable[str]) -> list[FrameFiles]:
    """Pair the depth images of the folder ``depth`` with the pictures of another.

    Parameters
    ----------
    folder : Path
        The dataset; names of depth images become ids, without ending where they differ in more.
    colour : iterable of str
        Names the folder of pictures may have; the first that is there is taken.

    Returns
    -------
    list of FrameFiles
        With the picture of the same name, else of the same frame number, where there is one. A
        warning says how many have none though there are pictures that go with no frame.
    """
    images = listed(inside(folder, "depth"), is_depth_file)
    place = next((name for name in colour if (folder / name).is_dir()), None)
    pictures = [] if place is None else listed(inside(folder, place), is_picture)
    named = {path.stem: path.name for path in pictures}
    of_number = {number: path.name for path, number in _frame_numbers(pictures).items()}
    numbers = _frame_numbers(images)
    found = {path: named.get(path.stem) or of_number.get(numbers.get(path, "")) for path in images}
    alone = sum(name is None for name in found.values())
    if alone and set(named.values()) - set(found.values()):
        _LOG.warning(
            f"{folder.name}: {alone:,} of {counted(len(images), 'frame')} have no picture, for "
            f"none in {place}/ has the name or the number of the depth image"
        )
    unique = len({path.stem for path in images}) == len(images)
    return [
        FrameFiles(
            id=path.stem if unique else path.name,
            depth=f"depth/{path.name}",
            rgb=None if name is None else f"{place}/{name}",
        )
        for path, name in found.items()
    ]


def _frame_numbers(paths: Iterable[Path]) -> dict[Path, str]:
    """Number of the frame in each name that has one, the last but for a time as Redwood's have.

    None where names differ in more than the number, or several have the same: such numbers do not
    tell frames from each other.
    """
    found = {}
    for path in paths:
        stamped = STAMPED.fullmatch(path.stem)
        if name := _NUMBERED.fullmatch(stamped[1] if stamped else path.stem):
            found[path] = name.groups()
    if len({(before, after) for before, _, after in found.values()}) > 1:
        return {}
    numbers = {path: number.lstrip("0") or "0" for path, (_, number, _) in found.items()}
    count = Counter(numbers.values())
    return {path: number for path, number in numbers.items() if count[number] == 1}


def pose_of(root: Path, name: str) -> NDArray[np.float64] | None:
    """Pose in a text file of 4 x 4 numbers; ``None`` where it says that it is not known."""
    return known_pose(matrix_of(root, name))


def known_pose(pose: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the pose; ``None`` for infinities and zeros, by which trackers say they are lost."""
    return pose if np.isfinite(pose).all() and pose[3, 3] else None
