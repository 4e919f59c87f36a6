"""What every dataset gives: frames, read one at a time when they are asked for.

A reader is a subclass of `Dataset`. To list its frames, it looks at names and headers only, in
`__init__`; to read one, it has `_read`. What a reader may rely on and has to keep to:

- An id is a string, unique, fit for the name of a file, and stays the same wherever the files lie.
  Ids are in the order of the frames: of time, or natural order (frame 2 before frame 10).
- A dataset keeps no frame in memory, and no file open that it could not open again: it can be
  copied, sent to another process, and read by several threads at once.
- What is wrong with the whole (no folder, no frame, a package that is not installed) is raised by
  `__init__`. What is wrong with one frame is raised when that frame is read, and concerns no other.
  Both are a `PlanewiseError`, one line; that of a frame begins with the dataset and the id.
- Files are not trusted: sizes that they claim are checked before memory is taken, and nothing
  outside the dataset is read because a file says so.
- Arrays are the caller's: no frame shares memory with another.
- What a frame has not got is ``None``, never a guess. Labels are of planes: those of objects or
  classes are none.
"""

from __future__ import annotations

import copy
import operator
import sys
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, SupportsIndex, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera
from planewise.errors import PlanewiseError, SetupError, naming
from planewise.sensor import Sensor
from planewise.wording import counted

_FORBIDDEN = frozenset("/\\\0\n\r")  # in ids, which become names of files


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class DatasetFrame:
    """One depth image of a dataset, and what is known about it.

    Attributes
    ----------
    id : str
        Name in its dataset.
    depth : ndarray, shape (H, W)
        Integer units of `depth_scale`, or floating-point metres; 0 or NaN is no reading.
    camera : Camera
        Intrinsics of this image.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` for metres.
    rgb : ndarray of uint8, shape (h, w, 3), optional
        Picture of the same view if the dataset is `Dataset.registered`, of the same size unless it
        says otherwise.
    timestamp : float, optional
        Seconds, on the dataset's clock.
    labels : ndarray of int, shape (H, W), optional
        True planes: 0 for none, every other value is one plane.
    planes : ndarray, shape (N, 4), optional
        True parameters: rows (normal, distance), row j - 1 for label j.
    pose : ndarray, shape (4, 4), optional
        From the camera's frame to the world's, metres.
    """

    id: str
    depth: NDArray[Any]
    camera: Camera
    depth_scale: float | None = None
    rgb: NDArray[np.uint8] | None = None
    timestamp: float | None = None
    labels: NDArray[np.integer] | None = None
    planes: NDArray[np.float64] | None = None
    pose: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if self.depth.ndim != 2 or self.depth.dtype.kind not in "fiu":
            raise PlanewiseError(
                f"depth must be an image of shape (H, W), got {self.depth.dtype} of shape "
                f"{self.depth.shape}"
            )
        if self.labels is not None and (
            self.labels.shape != self.depth.shape or self.labels.dtype.kind not in "iu"
        ):
            raise PlanewiseError(
                f"labels must be integers of the depth image's shape {self.depth.shape}, got "
                f"{self.labels.dtype} of shape {self.labels.shape}"
            )
        if self.depth_scale is None and self.depth.dtype.kind != "f":
            raise PlanewiseError(
                "nothing states the unit of integer depth: give depth_scale, in metres, as 0.001 "
                "for millimetres (of camera.json, depth_scale= or --depth-scale)"
            )
        if self.depth_scale is not None and self.depth.dtype.kind == "f":
            raise PlanewiseError(
                "depth_scale is for integer depth; floating-point depth is in metres"
            )

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where there is a reading, shape (H, W)."""
        return np.asarray(np.isfinite(self.depth) & (self.depth > 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class PointFrame:
    """One sweep or cloud of a dataset.

    Attributes
    ----------
    id : str
        Name in its dataset.
    points : ndarray of float32 or float64, shape (k, 3)
        Metres, in the sensor's own axes; rows that are not finite are no reading.
    intensity : ndarray of float32, shape (k,), optional
        Strength of the echo, in the dataset's own unit.
    timestamp : float, optional
        Seconds, on the dataset's clock.
    """

    id: str
    points: NDArray[np.floating]
    intensity: NDArray[np.float32] | None = None
    timestamp: float | None = None

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or self.points.dtype.kind != "f":
            raise PlanewiseError(
                f"points must be floats of shape (k, 3), got {self.points.dtype} of shape "
                f"{self.points.shape}"
            )


Frame = TypeVar("Frame", bound=DatasetFrame | PointFrame)


def numbered(count: int) -> list[str]:
    """Ids of frames that have only numbers; datasets share them, for there may be millions."""
    return [sys.intern(f"{n:06d}") for n in range(count)]


def check_text(dataset: str, frame: str) -> None:
    """Refuse an id that no table can hold: the name of a file with bytes that are no text here.

    Raises
    ------
    PlanewiseError
        Which names the dataset and the frame.
    """
    try:
        frame.encode()
    except UnicodeEncodeError:
        name = frame.encode("utf-8", "surrogateescape")
        try:
            shown, encoding = name.decode(), sys.getfilesystemencoding()
            cause = f"cannot be read in this locale ({encoding}); set PYTHONUTF8=1"
        except UnicodeDecodeError:
            shown = name.decode("utf-8", "backslashreplace")
            cause = "is not valid UTF-8; rename it"
        raise PlanewiseError(f"data: {dataset} has a frame {shown}, which {cause}") from None


class Frames(ABC, Generic[Frame]):
    """Frames by id or number, read when they are asked for; see the module for a reader's duties.

    Parameters
    ----------
    name : str
        What the dataset is called in messages: a file or folder, as the user gave it.
    ids : sequence of str
        Of all frames, in their order.

    Attributes
    ----------
    kind, holds : str
        Name of the format, as `planewise.datasets.open` knows it, and what it is recognised by.
    pictures, poses : bool
        Whether frames come with their pictures and poses.

    Examples
    --------
    ``dataset["id"]`` and ``dataset[3]`` read a frame, ``dataset[:100:2]`` is a dataset of fewer
    frames, and nothing is read yet. ``for frame in dataset`` stops at a frame that cannot be read;
    to go on past it, use `readable`, or ask by id:

    >>> def damaged(dataset):
    ...     for each in dataset.ids:
    ...         try:
    ...             dataset[each]
    ...         except PlanewiseError as error:
    ...             yield each, str(error)
    """

    kind: ClassVar[str] = ""
    holds: ClassVar[str] = ""
    name: str
    ids: tuple[str, ...]
    pictures: bool = True
    poses: bool = True

    def __init__(self, name: str, ids: Sequence[str]) -> None:
        if not ids:
            raise PlanewiseError(f"{name} holds no frames")
        self.name, self.ids = name, tuple(ids)
        if len(set(self.ids)) < len(self.ids):
            double = Counter(self.ids).most_common(1)[0][0]
            raise PlanewiseError(f"{name} holds two frames named {double}")
        for each in self.ids:
            if not each or each in (".", "..") or not _FORBIDDEN.isdisjoint(each):
                raise PlanewiseError(f"{name} holds a frame named {each!r}, no name for a file")

    @cached_property
    def _known(self) -> frozenset[str]:
        return frozenset(self.ids)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_known"}

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Frame]:
        return (self[each] for each in self.ids)

    def __contains__(self, frame: object) -> bool:
        return frame in self._known

    @overload
    def __getitem__(self, frame: str | SupportsIndex) -> Frame: ...

    @overload
    def __getitem__(self, frame: slice) -> Self: ...

    def __getitem__(self, frame: str | SupportsIndex | slice) -> Frame | Self:
        """Read one frame, or choose some without reading them.

        Parameters
        ----------
        frame : str, int or slice
            Its id; its number from 0, or from the end if negative; or which numbers.

        Raises
        ------
        PlanewiseError
            If there is none of that id or number, or its files are missing, damaged or too large.
        """
        if isinstance(frame, slice):
            fewer = copy.copy(self)
            fewer.ids = self.ids[frame]
            return fewer
        if not isinstance(frame, str):
            number = operator.index(frame)
            if not -len(self.ids) <= number < len(self.ids):
                raise PlanewiseError(
                    f"{self.name} has {counted(len(self.ids), 'frame')}, no number {number}"
                )
            frame = self.ids[number]
        if frame not in self:
            last = f" ... {self.ids[-1]}" if len(self.ids) > 1 else ""
            has = f"it has {self.ids[0]}{last}" if self.ids else "none were chosen"
            raise PlanewiseError(f"{self.name} has no frame {frame!r}; {has}")
        with naming(f"{self.name}, frame {frame}:", damaged="it is damaged"):
            return self._read(frame)

    def readable(self, report: Callable[[str, PlanewiseError], None]) -> Iterator[Frame]:
        """Read all frames in their order, and go on past those that cannot be read.

        Parameters
        ----------
        report : callable
            Is given the id and the error of each frame that is left out.

        Raises
        ------
        MissingExtraError
            If a package is missing: that concerns all frames.
        """
        for each in self.ids:
            try:
                frame = self[each]
            except SetupError:
                raise
            except PlanewiseError as error:
                report(each, error)
            else:
                yield frame

    def without_pictures(self) -> Self:
        """Return the same frames, whose pictures are not read: decoding them takes longest."""
        bare = copy.copy(self)
        bare.pictures = False
        return bare

    def without_poses(self) -> Self:
        """Return the same frames, whose poses are not read: one that is damaged costs no frame."""
        bare = copy.copy(self)
        bare.poses = False
        return bare

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether a file or folder looks like one of this format: by contents, not by its name."""
        return False

    @abstractmethod
    def _read(self, frame: str) -> Frame:
        """Read the frame of a known id; may raise anything."""


class Dataset(Frames[DatasetFrame]):
    """Depth images; see `Frames`.

    Attributes
    ----------
    sensor : Sensor, optional
        What took them, where the dataset tells.
    registered : bool
        Whether pictures show the view of the depth camera, not that of a camera beside it.
    """

    sensor: Sensor | None = None
    registered: bool = True

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes, as far as names and headers tell."""
        return ()

    @property
    def pictured(self) -> tuple[str, ...] | None:
        """Ids of the frames that have a picture, as far as names tell; ``None``: they do not."""
        return None


class PointDataset(Frames[PointFrame]):
    """Sweeps and clouds of points; see `Frames`."""
