"""The frames that a store was made from, for pictures of them, where they can still be read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import MOST_LENGTH
from planewise.batch.frame_work import fingerprint
from planewise.batch.open_source import open_source
from planewise.batch.source import DepthFolder, Source, SourceFrame, is_registered
from planewise.batch.store import Store, StoredFrame
from planewise.batch.stored_camera import described_camera, description_of
from planewise.camera import Camera
from planewise.datasets.opening import READERS
from planewise.datasets.ros import TOPICS
from planewise.errors import PlanewiseError, SetupError


class StoredSource:
    """Readings and pictures of the frames of a store.

    Parameters
    ----------
    store : Store
        Says where its source was.
    path : path, optional
        Where it is now; ``None`` means where it was.
    poses : bool
        Read the frames' poses, too.

    Attributes
    ----------
    missing : str
        Why it cannot be read; empty if it can.
    registered : bool
        Whether its pictures show the view of the depth images.

    Raises
    ------
    PlanewiseError
        If `path` is given and cannot be read.
    """

    def __init__(self, store: Store, path: Path | None = None, *, poses: bool = True) -> None:
        self._source: Source | None = None
        self.missing = ""
        try:
            self._source = _open(store.info, path, poses)
        except SetupError:
            raise
        except (PlanewiseError, OSError) as error:
            if path is not None:
                raise
            self.missing = str(error)
        self.registered = self._source is None or is_registered(self._source)

    def __getitem__(self, frame: StoredFrame) -> SourceFrame:
        """Read a frame.

        Raises
        ------
        PlanewiseError
            If it cannot be read, or its readings are not those that the store was made from.
        """
        if self._source is None:
            raise PlanewiseError(self.missing)
        try:
            seen = self._source[frame.id]
        except KeyError:
            raise PlanewiseError(f"the source has no frame {frame.id} any more") from None
        if fingerprint(seen.depth) != frame.row["fingerprint"]:
            raise PlanewiseError(f"the readings of {frame.id} are no longer those of the store")
        return seen


def metres(frame: StoredFrame, seen: SourceFrame) -> NDArray[np.float64]:
    """Readings of a frame in metres, shape (H, W); NaN where there is none."""
    scale = frame.row["depth_scale"]
    depth = np.asarray(seen.depth * (1.0 if scale is None else scale), np.float64)
    with np.errstate(invalid="ignore"):
        # Renderers write huge numbers where there is no surface.
        return np.where((depth > 0) & (depth <= MOST_LENGTH), depth, np.nan)


def camera_of(frame: StoredFrame) -> Camera | None:
    """Camera that the planes of a frame were found with; ``None`` for one of a user's own kind.

    Raises
    ------
    PlanewiseError
        If its description is damaged.
    """
    described = description_of(frame.row)
    try:
        return described_camera(described)
    except ValueError as error:
        raise PlanewiseError(
            f"store: the camera of the frame {frame.id} is damaged ({error})"
        ) from None


def _open(info: Mapping[str, Any], path: Path | None, poses: bool) -> Source:
    """Open the source as the batch did, with pictures."""
    recorded, made = info["source"], info["made_with"]
    if path is None:
        if not recorded.get("path"):
            raise PlanewiseError(f"the store does not say where {recorded['name']} is")
        path = Path(recorded["path"])
    if not path.exists():
        raise PlanewiseError(f"source: there is no {path}")
    if recorded["kind"] == DepthFolder.__name__:
        return DepthFolder(path)
    reader = next((each for each in READERS if each.__name__ == recorded["kind"]), None)
    camera = None if made["camera"] is None else described_camera(made["camera"])
    topics = {
        name: names[0]
        for name in TOPICS
        if len(names := recorded.get(name, ())) == 1  # where several: each bag's only one
    }
    return open_source(
        path,
        None if reader is None else reader.kind,
        camera=camera,
        depth_scale=made["depth_scale"],
        pictures=True,
        poses=poses,
        **topics,
    )
