"""Folders as Open3D and its Redwood scans have them.

Park, Zhou, Koltun, "Colored point cloud registration revisited", ICCV 2017 (indoor scans); Choi,
Zhou, Miller, Koltun, "A large dataset of object scans", 2016.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from planewise.camera import PinholeCamera
from planewise.datasets.paths import inside
from planewise.datasets.picture_folder import STAMPED, FrameFiles, PictureFolder, depth_and_colour
from planewise.files.camera import read_camera

_CAMERAS = ("camera_intrinsic.json", "intrinsic.json", "camera_primesense.json")


class RedwoodFolder(PictureFolder):
    """Folder with ``depth/``, ``color/``, ``image/`` or ``rgb/``, and ``camera_intrinsic.json``.

    Pictures go with the depth image of the same name, else of the same number. Names such as
    ``0000001-000000033369.png`` state the number of the frame, and a time in microseconds.

    Parameters
    ----------
    folder : path
        Ids are the names of the depth images without ending.
    camera : PinholeCamera, optional
        Instead of the one in the file.
    depth_scale : float
        Metres per unit; Open3D writes millimetres.
    """

    kind: ClassVar[str] = "redwood"
    holds: ClassVar[str] = (
        "a folder with depth/, color/ or image/, and camera_intrinsic.json (Redwood, Open3D)"
    )

    def __init__(
        self,
        folder: str | Path,
        *,
        camera: PinholeCamera | None = None,
        depth_scale: float = 0.001,
    ) -> None:
        root = Path(folder)
        name = next((name for name in _CAMERAS if (root / name).is_file()), _CAMERAS[0])
        super().__init__(
            root,
            map(_stamped, depth_and_colour(root, ("color", "image", "rgb"))),
            read_camera(str(inside(root, name))) if camera is None else camera,
            depth_scale,
        )

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth/ and one of Open3D's camera files."""
        return (path / "depth").is_dir() and any((path / name).is_file() for name in _CAMERAS)


def _stamped(files: FrameFiles) -> FrameFiles:
    stamp = STAMPED.fullmatch(Path(files.depth).stem)
    return files if stamp is None else replace(files, timestamp=int(stamp[2]) / 1e6)
