"""What every dataset gives: frames, read one at a time when they are asked for.

A reader is a subclass of `Dataset`. To list its frames, it looks at names and headers only, in
`__init__`; to read one, it has `_read`. What a reader may rely on and has to keep to:

- An id is a string, unique, and stays the same wherever the files lie. Ids are in the order of the
  frames: of time, or natural order (frame 2 before frame 10).
- A dataset keeps no file open and no frame in memory: it can be copied, sent to another process,
  and read by several threads at once.
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

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import PinholeCamera
from planewise.errors import MissingExtraError, PlanewiseError


@dataclass(frozen=True, kw_only=True)
class DatasetFrame:
    """One depth image of a dataset, and what is known about it.

    Attributes
    ----------
    id : str
        Name in its dataset.
    depth : ndarray, shape (H, W)
        Integer units of `depth_scale`, or floating-point metres; 0 or NaN is no reading.
    camera : PinholeCamera
        Intrinsics of this image.
    depth_scale : float, optional
        Metres per unit of integer depth; ``None`` for metres.
    rgb : ndarray of uint8, shape (h, w, 3), optional
        Picture of the same view, of the same size unless the dataset says otherwise.
    timestamp : float, optional
        Seconds, on the dataset's clock.
    labels : ndarray of int, shape (H, W), optional
        True planes: 0 for none, every other value is one plane.
    planes : ndarray, shape (N, 4), optional
        True parameters: rows (normal, distance), row j - 1 for label j.
    """

    id: str
    depth: NDArray[Any]
    camera: PinholeCamera
    depth_scale: float | None = None
    rgb: NDArray[np.uint8] | None = None
    timestamp: float | None = None
    labels: NDArray[np.integer] | None = None
    planes: NDArray[np.float64] | None = None

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
        if (self.depth_scale is None) == (self.depth.dtype.kind != "f"):
            raise PlanewiseError("depth_scale must be given for integer depth, and for no other")

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where there is a reading, shape (H, W)."""
        return np.asarray(np.isfinite(self.depth) & (self.depth > 0))


class Dataset(ABC):
    """Frames by id, read when they are asked for; see the module for what a reader keeps to.

    Parameters
    ----------
    name : str
        What the dataset is called in messages: a file or folder, as the user gave it.
    ids : sequence of str
        Of all frames, in their order.

    Examples
    --------
    ``for frame in dataset`` stops at a frame that cannot be read; to go on past it, ask by id:

    >>> def readable(dataset):
    ...     for each in dataset.ids:
    ...         try:
    ...             yield dataset[each]
    ...         except PlanewiseError as error:
    ...             print(error)
    """

    def __init__(self, name: str, ids: Sequence[str]) -> None:
        if not ids:
            raise PlanewiseError(f"{name} holds no frames")
        self.name, self.ids = name, tuple(ids)
        self._known = frozenset(self.ids)
        if len(self._known) < len(self.ids):
            double = next(each for i, each in enumerate(self.ids) if each in self.ids[:i])
            raise PlanewiseError(f"{name} holds two frames named {double}")

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes, as far as names and headers tell."""
        return self.ids

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[DatasetFrame]:
        return (self[each] for each in self.ids)

    def __contains__(self, frame: object) -> bool:
        return frame in self._known

    def __getitem__(self, frame: str) -> DatasetFrame:
        """Read one frame.

        Parameters
        ----------
        frame : str
            Its id.

        Raises
        ------
        PlanewiseError
            If there is none of that id, or its files are missing, damaged or too large.
        """
        if frame not in self._known:
            last = f" ... {self.ids[-1]}" if len(self.ids) > 1 else ""
            raise PlanewiseError(f"{self.name} has no frame {frame!r}; it has {self.ids[0]}{last}")
        try:
            return self._read(frame)
        except MissingExtraError:
            raise
        except PlanewiseError as error:
            raise PlanewiseError(f"{self.name}, frame {frame}: {error}") from None
        except Exception as error:  # decoders of foreign bytes may raise anything
            detail = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise PlanewiseError(
                f"{self.name}, frame {frame}: cannot be read; it is damaged ({detail})"
            ) from error

    @abstractmethod
    def _read(self, frame: str) -> DatasetFrame:
        """Read the frame of a known id; may raise anything."""
