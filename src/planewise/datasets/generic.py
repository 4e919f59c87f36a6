"""A folder as anybody can make one: depth images, pictures, and one file that says the rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from planewise import sensors
from planewise.arguments import checked_scale, shown
from planewise.camera import PinholeCamera
from planewise.datasets.paths import inside
from planewise.datasets.picture_folder import PictureFolder, depth_and_colour
from planewise.errors import PlanewiseError, SetupError
from planewise.files.camera import read_camera
from planewise.files.depth import unit_of
from planewise.files.named_values import read_mapping
from planewise.sensor import Sensor

CAMERA = "camera.json"


class GenericFolder(PictureFolder):
    """Folder with ``depth/``, ``camera.json`` and, where there, ``rgb/``.

    Pictures go with the depth image of the same name, else of the same number.

    ``camera.json`` states fx, fy, cx and cy in pixels and, for integer depth, depth_scale in metres
    per unit; width, height, distortion and sensor (a key of `planewise.sensors.PRESETS`) may
    be there, too. `planewise.files.camera.read_camera` says in which other ways a camera may be
    written down.

    Parameters
    ----------
    folder : path
        Ids are the names of the depth images without ending.
    camera : PinholeCamera, optional
        Instead of the one in the file.
    depth_scale : float, optional
        Metres per unit, instead of the one in the file.
    """

    kind: ClassVar[str] = "folder"
    holds: ClassVar[str] = "a folder with depth/ and camera.json (rgb/ optional)"

    def __init__(
        self,
        folder: str | Path,
        *,
        camera: PinholeCamera | None = None,
        depth_scale: float | None = None,
    ) -> None:
        root = Path(folder)
        path = inside(root, CAMERA)
        values = _stated(path) if path.is_file() else {}
        scale = checked_scale(depth_scale)
        if scale is None:
            scale = _scale_of(values.get("depth_scale"))
        self.sensor = _sensor_of(values.get("sensor"))
        super().__init__(
            root,
            depth_and_colour(root, ("rgb", "color", "image")),
            read_camera(str(path)) if camera is None else camera,
            scale,
        )

    def _depth(self, path: Path) -> NDArray[Any]:
        depth = super()._depth(path)
        unit_of(depth, self.depth_scale)  # other kinds have one of their own, which nobody stated
        return depth

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth/ and camera.json."""
        return (path / "depth").is_dir() and (path / CAMERA).is_file()


def _scale_of(value: Any) -> float | None:
    """Metres per unit as the file states it, a positive number; ``None`` where it does not."""
    try:
        return checked_scale(value)
    except ValueError as error:
        raise PlanewiseError(f"{CAMERA}: {error}") from None


def _stated(path: Path) -> Mapping[str, Any]:
    try:
        return read_mapping(path)
    except SetupError:
        raise
    except PlanewiseError as error:
        raise PlanewiseError(f"camera: {path.name} {error}") from None


def _sensor_of(name: Any) -> Sensor | None:
    if name is None:
        return None
    # No path: what a dataset says leads to no file outside it.
    if not isinstance(name, str) or name not in sensors.PRESETS:
        raise PlanewiseError(
            f"sensor: {CAMERA} must name one of {', '.join(sensors.PRESETS)}, got {shown(name)}"
        )
    return sensors.PRESETS[name]
