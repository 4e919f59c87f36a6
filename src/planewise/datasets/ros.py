"""ROS 1 and ROS 2 bags and MCAP files: a topic of depth images, or one of points. Needs rosbags."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from planewise.camera import Camera, PinholeCamera
from planewise.datasets.bags import Bag, Topic, is_bag
from planewise.datasets.collection import Collection, PointCollection
from planewise.datasets.frames import Dataset, DatasetFrame, PointDataset, PointFrame, numbered
from planewise.datasets.ros_messages import (
    MILLIMETRE,
    camera_of,
    depth_of,
    is_depth,
    points_of,
    seconds,
)
from planewise.errors import PlanewiseError, SetupError

_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_CAMERA = "sensor_msgs/msg/CameraInfo"
_POINTS = "sensor_msgs/msg/PointCloud2"
_COMPRESSED = ("/compressedDepth", "/compressed")

TOPICS = ("topic", "camera_topic")
"""Options of `RosDepth` that say what is read of a bag."""


class RosDepth(Dataset):
    """Depth images of a bag: Image (16UC1, 32FC1) or CompressedImage (compressedDepth, PNG).

    The camera is that of the first message of the ``camera_info`` beside the images; images of a
    topic with ``rect`` in its name have that of P, without distortion. Ids are the numbers of the
    messages in order of time, ``000000`` and so on; timestamps are of their headers.

    Parameters
    ----------
    path : path
        A ``.bag``, ``.mcap`` or ``.db3`` file, or the folder of a ROS 2 bag.
    topic : str, optional
        Of the images; ``None`` means the only one with depth.
    camera_topic : str, optional
        Of the CameraInfo, where it is not beside them.
    camera : Camera, optional
        Instead of a CameraInfo.
    depth_scale : float
        Metres per unit of integer depth.
    """

    kind: ClassVar[str] = "ros"
    holds: ClassVar[str] = "a ROS 1 or 2 bag or an MCAP file with depth images"

    def __init__(
        self,
        path: str | Path,
        *,
        topic: str | None = None,
        camera_topic: str | None = None,
        camera: Camera | None = None,
        depth_scale: float = MILLIMETRE,
    ) -> None:
        self.path, self.depth_scale = Path(path), depth_scale
        self.camera_topic: str | None = None
        if camera is not None and camera_topic is not None:
            raise ValueError("camera_topic is not needed with a camera; give one of them")
        with Bag(self.path) as bag:
            chosen = _depth_topic(bag) if topic is None else _checked(bag, topic, _IMAGES)
            if camera is None:
                self.camera_topic = _camera_topic(bag, chosen, camera_topic)
                camera = _camera(bag, chosen, self.camera_topic)
            self.camera = camera
            self.topic = Topic(self.path, chosen, bag.index(chosen))
        super().__init__(self.path.name, numbered(len(self.topic)))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether it is a bag that has not only points."""
        if not is_bag(path):
            return False
        with Bag(path) as bag:
            return _POINTS not in bag.types.values() or bool(_depth_topics(bag))

    def _read(self, frame: str) -> DatasetFrame:
        message = self.topic.message(int(frame))
        depth = depth_of(message)
        return DatasetFrame(
            id=frame,
            depth=depth,
            camera=self.camera,
            depth_scale=None if depth.dtype.kind == "f" else self.depth_scale,
            timestamp=seconds(message),
        )


class RosPoints(PointDataset):
    """Clouds of a bag: PointCloud2.

    Parameters
    ----------
    path : path
        As of `RosDepth`, and so are the ids.
    topic : str, optional
        ``None`` means the only one with points.
    """

    kind: ClassVar[str] = "ros-points"
    holds: ClassVar[str] = "a ROS 1 or 2 bag or an MCAP file with PointCloud2"

    def __init__(self, path: str | Path, *, topic: str | None = None) -> None:
        self.path = Path(path)
        with Bag(self.path) as bag:
            if topic is None:
                found = [name for name, kind in bag.types.items() if kind == _POINTS]
                topic = _only(bag, found, "points (PointCloud2)")
            self.topic = Topic(self.path, topic, bag.index(_checked(bag, topic, (_POINTS,))))
        super().__init__(self.path.name, numbered(len(self.topic)))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether it is a bag."""
        return is_bag(path)

    def _read(self, frame: str) -> PointFrame:
        message = self.topic.message(int(frame))
        points, intensity = points_of(message)
        return PointFrame(id=frame, points=points, intensity=intensity, timestamp=seconds(message))


def topics_of(dataset: object) -> dict[str, list[str]]:
    """Topics that frames and their cameras are of, by the names of the options; only for bags."""
    parts: list[object] = [dataset]
    if isinstance(dataset, Collection | PointCollection):
        parts = list(dataset.parts.values())
    topics = {part.topic.name for part in parts if isinstance(part, RosDepth | RosPoints)}
    cameras = {part.camera_topic or "" for part in parts if isinstance(part, RosDepth)} - {""}
    found = zip(TOPICS, (topics, cameras), strict=True)
    return {option: sorted(names) for option, names in found if names}


def _depth_topics(bag: Bag) -> list[str]:
    """Topics whose first image is depth; of an image sent in two ways the uncompressed one."""
    images = [name for name, kind in bag.types.items() if kind in _IMAGES]
    found = [name for name in images if _is_depth(bag, name)]
    return [name for name in found if _plain(name) == name or _plain(name) not in found]


def _is_depth(bag: Bag, topic: str) -> bool:
    try:
        message = bag.first(topic)
    except SetupError:
        raise
    except Exception:  # damaged: only its name is left
        return "depth" in topic.lower()
    return message is not None and is_depth(message)


def _depth_topic(bag: Bag) -> str:
    images = any(kind in _IMAGES for kind in bag.types.values())
    hint = "; if the images of one are depth, give the topic (--topic)" if images else ""
    return _only(bag, _depth_topics(bag), "depth images", hint)


def _only(bag: Bag, found: list[str], what: str, hint: str = "") -> str:
    if len(found) == 1:
        return found[0]
    if found:
        raise PlanewiseError(
            f"data: the bag has several topics of {what}; give one (--topic): {', '.join(found)}"
        )
    raise PlanewiseError(f"data: the bag has no topic of {what}; it has {_listed(bag)}{hint}")


def _checked(bag: Bag, topic: str, kinds: tuple[str, ...]) -> str:
    if bag.types.get(topic) not in kinds:
        raise PlanewiseError(
            f"data: {topic} is no topic of {' or '.join(kinds)}; the bag has {_listed(bag)}"
        )
    return topic


def _listed(bag: Bag) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in sorted(bag.types.items())) or "none"


def _plain(topic: str) -> str:
    """Name of the uncompressed images of a topic."""
    ending = next((each for each in _COMPRESSED if topic.endswith(each)), "")
    return topic.removesuffix(ending)


def _camera_topic(bag: Bag, topic: str, given: str | None) -> str:
    cameras = [name for name, kind in bag.types.items() if kind == _CAMERA]
    beside = _plain(topic).rpartition("/")[0] + "/camera_info"
    name = given or (beside if beside in cameras else None)
    if name is None and len(cameras) == 1:
        name = cameras[0]
    if name not in cameras:
        raise PlanewiseError(
            f"camera: the bag has no CameraInfo {name or beside}; give the camera (--camera) or "
            f"its topic (--camera-topic): {', '.join(cameras) or 'there is none'}"
        )
    return str(name)


def _camera(bag: Bag, topic: str, name: str) -> PinholeCamera:
    message: Any = bag.first(name)
    if message is None:
        raise PlanewiseError(f"camera: {name} has no message; give the camera")
    try:
        return camera_of(message, rectified="rect" in _plain(topic).rpartition("/")[2])
    except PlanewiseError as error:
        raise PlanewiseError(f"camera: {name} {error}") from None
