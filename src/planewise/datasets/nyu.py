"""NYU-v2 as people have it: the labelled .mat, a folder of pictures, or cut out as archives.

Silberman, Hoiem, Kohli, Fergus, "Indoor segmentation and support inference from RGBD images",
ECCV 2012. Frames are numbered from 1, as in its toolbox.

True planes come from elsewhere. The labels inside the .mat are of classes of objects, so planes are
read from a folder beside it: one label image a frame, ``N.png``, ``N.npy`` or ``N.npz``, or the
``plane_instance_N.npz`` of the set that the literature calls NYUv2-Plane (Yu et al.,
"Single-image piece-wise planar 3D reconstruction via associative embedding", CVPR 2019), which
label the crop of `PLANE_CROP`, scaled to 192 x 256.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from planewise import sensors
from planewise.camera import PinholeCamera
from planewise.cameras import NYU
from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.hdf5 import array_of, is_hdf5, opened, row_of
from planewise.datasets.paths import inside, listed
from planewise.errors import PlanewiseError
from planewise.files.colour import read_colour
from planewise.files.depth import is_depth_file, read_depth
from planewise.files.labels import read_labels

FULL = (480, 640)
"""Rows and columns of a whole frame."""

PLANE_CROP = (slice(44, 471), slice(40, 601))
"""Part of the frame that NYUv2-Plane labels: where depth and picture both see (the toolbox's 45:471
and 41:601, counted from 1)."""

SCORED_CROP = (slice(45, 471), slice(41, 601))
"""Part of the frame whose pixels are scored."""

_MILLIMETRE = 0.001
_PLANE_SET = "plane_instance"
_PICTURES = (".png", ".jpg", ".jpeg")
_TRUTH = re.compile(rf"(?:{_PLANE_SET}_)?(\d+)")

Depth = Literal["depths", "rawDepths"]


class NyuTruth:
    """True planes of NYU-v2 by frame number, from a folder.

    Parameters
    ----------
    folder : path
        See the module. Where a frame has several files, ``plane_instance_N.npz`` comes first.

    Attributes
    ----------
    is_plane_set : bool
        Whether all are files of NYUv2-Plane.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise PlanewiseError(f"truth: {folder} is not a folder")
        self.files: dict[str, Path] = {}
        for path in listed(self.folder, Path.is_file):
            number = _TRUTH.fullmatch(path.stem)
            picture = path.suffix == ".png" and path.stem.startswith(_PLANE_SET)  # to look at
            if number and not picture and path.suffix.lower() in (".png", ".npy", ".npz"):
                frame = _number(number[1])
                if frame not in self.files or path.stem.startswith(_PLANE_SET):
                    self.files[frame] = path
        if not self.files:
            raise PlanewiseError(
                f"truth: {folder} holds no labels named 1.png, 2.png ... or plane_instance_1.npz"
            )
        self.is_plane_set = all(path.stem.startswith(_PLANE_SET) for path in self.files.values())

    def labels(self, frame: str, shape: tuple[int, int]) -> NDArray[np.integer] | None:
        """Labels of a frame, for a depth image of that shape; ``None`` where there are none."""
        path = self.files.get(_number(frame))
        if path is None:
            return None
        labels = read_labels(inside(self.folder, path.name)).labels
        if not path.stem.startswith(_PLANE_SET):
            return labels
        rows, columns = PLANE_CROP
        crop = _nearest(labels, (rows.stop - rows.start, columns.stop - columns.start))
        if shape == crop.shape:
            return crop
        if shape != FULL:
            raise PlanewiseError(
                f"{path.name} labels a part of the whole frame of {FULL[0]} x {FULL[1]} pixels, "
                f"the depth image has {shape[0]} x {shape[1]}"
            )
        whole = np.zeros(FULL, crop.dtype)
        whole[PLANE_CROP] = crop
        return whole


class NyuLabelled(Dataset):
    """``nyu_depth_v2_labeled.mat``: 1449 frames in one HDF5 file.

    Needs h5py, extra ``datasets``. Pictures and depth are turned upright: MATLAB writes columns
    first, so the file has images (N, 3, W, H) and depths (N, W, H).

    Parameters
    ----------
    path : path
        The file.
    depth : {"depths", "rawDepths"}
        Depth with its holes painted in, or as measured; both seen from the colour camera.
    truth : path, optional
        Folder of true planes; see the module. Without it frames have no labels.
    camera : PinholeCamera, optional
        ``None`` means `planewise.cameras.NYU`, for whole frames.
    """

    kind: ClassVar[str] = "nyu-labelled"
    holds: ClassVar[str] = "nyu_depth_v2_labeled.mat, or another HDF5 file with depths"
    sensor = sensors.NYU

    def __init__(
        self,
        path: str | Path,
        *,
        depth: Depth = "depths",
        truth: str | Path | None = None,
        camera: PinholeCamera | None = None,
    ) -> None:
        if depth not in ("depths", "rawDepths"):
            raise ValueError(f"depth must be 'depths' or 'rawDepths', got {depth!r}")
        self.path, self.depth, self.camera = Path(path), depth, camera
        if self.path.is_dir():
            raise PlanewiseError(f"data: {path} is a folder; give the file in it")
        self.truth = None if truth is None else NyuTruth(truth)
        with opened(self.path) as file:
            try:
                count = array_of(file, depth, 3, "f").shape[0]
            except PlanewiseError as error:
                raise PlanewiseError(f"data: {self.path.name} {error}") from None
            except Exception as error:  # of the library, whose own index is damaged
                raise PlanewiseError(f"data: {self.path.name} is damaged ({error})") from error
        super().__init__(self.path.name, [str(n) for n in range(1, count + 1)])

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes."""
        return _labelled(self.ids, self.truth)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether it is an HDF5 file, as MATLAB writes them since version 7.3, with depths."""
        if not is_hdf5(path):
            return False
        try:
            with opened(path) as file:
                return "depths" in file
        except Exception:  # damaged, or h5py is missing: that is told when it is opened
            return True

    def _read(self, frame: str) -> DatasetFrame:
        row = int(frame) - 1
        with opened(self.path) as file:
            depth = row_of(array_of(file, self.depth, 3, "f"), row).T.astype(np.float32)
            rgb = None
            if self.pictures and "images" in file:
                rgb = row_of(array_of(file, "images", 4, "u"), row).transpose(2, 1, 0)
        shape = (depth.shape[0], depth.shape[1])
        if rgb is not None and (rgb.shape != (*shape, 3) or rgb.dtype != np.uint8):
            raise PlanewiseError(f"images: expected 8 bits of shape {(*shape, 3)}, got {rgb.shape}")
        return DatasetFrame(
            id=frame,
            depth=np.ascontiguousarray(depth),
            camera=self.camera or camera_of(shape),
            rgb=None if rgb is None else np.ascontiguousarray(rgb),
            labels=None if self.truth is None else self.truth.labels(frame, shape),
        )


class NyuFolder(Dataset):
    """Folder with ``depth/N.png`` (16 bits, millimetres), and, where there, ``rgb/`` and ``gt/``.

    Parameters
    ----------
    folder : path
        Frames are what ``depth/`` holds, of any kind that `planewise.files.depth.read_depth` reads;
        ids are the names without ending.
    truth : path, optional
        Folder of true planes instead of ``gt/``; see the module.
    camera : PinholeCamera, optional
        ``None`` means `planewise.cameras.NYU`, moved where the frames are a usual crop.
    """

    kind: ClassVar[str] = "nyu"
    holds: ClassVar[str] = "a folder with depth/ and no camera (NYU-v2; only where asked for)"
    sensor = sensors.NYU

    def __init__(
        self,
        folder: str | Path,
        *,
        truth: str | Path | None = None,
        camera: PinholeCamera | None = None,
    ) -> None:
        self.folder, self.camera = Path(folder), camera
        depth = self.folder / "depth"
        if not depth.is_dir():
            raise PlanewiseError(f"data: {folder} has no folder depth/")
        paths = listed(depth, is_depth_file)
        self._depth = {path.stem: path for path in paths}
        given = self.folder / "gt" if truth is None else Path(truth)
        self.truth = NyuTruth(given) if truth is not None or given.is_dir() else None
        super().__init__(self.folder.name, [path.stem for path in paths])

    @property
    def labelled(self) -> tuple[str, ...]:
        """Ids of the frames that have true planes."""
        return _labelled(self.ids, self.truth)

    def _read(self, frame: str) -> DatasetFrame:
        seen = read_depth(inside(self.folder, f"depth/{self._depth[frame].name}"))
        shape = (seen.depth.shape[0], seen.depth.shape[1])
        return DatasetFrame(
            id=frame,
            depth=seen.depth,
            camera=self.camera or seen.camera or camera_of(shape),
            depth_scale=None if seen.depth.dtype.kind == "f" else seen.depth_scale or _MILLIMETRE,
            rgb=self._picture(frame),
            labels=None if self.truth is None else self.truth.labels(frame, shape),
        )

    def _picture(self, frame: str) -> NDArray[np.uint8] | None:
        paths = (self.folder / "rgb" / f"{frame}{suffix}" for suffix in _PICTURES)
        path = next((path for path in paths if path.is_file()), None)
        if path is None or not self.pictures:
            return None
        return read_colour(inside(self.folder, f"rgb/{path.name}"))


def open_nyu(
    data: str | Path,
    *,
    truth: str | Path | None = None,
    depth: Depth = "depths",
    camera: PinholeCamera | None = None,
) -> Dataset:
    """Open NYU-v2 in whichever form it is there.

    Parameters
    ----------
    data : path
        The labelled ``.mat``; a folder with ``depth/``; or a folder of ``.npz`` with depth, K and
        gt.
    truth, depth, camera
        As of `NyuLabelled` and `NyuFolder`.

    Raises
    ------
    PlanewiseError
        If it is none of them.
    """
    path = Path(data)
    if path.is_file():
        return NyuLabelled(path, depth=depth, truth=truth, camera=camera)
    if (path / "depth").is_dir():
        return NyuFolder(path, truth=truth, camera=camera)
    if path.is_dir() and any(path.glob("*.npz")):
        if truth is not None:
            raise PlanewiseError("truth: the archives hold their own labels (gt)")
        return ArchiveFolder(path, camera=camera)
    if not path.exists():
        raise PlanewiseError(f"data: there is no file or folder {path}")
    raise PlanewiseError(
        f"data: {path} is neither nyu_depth_v2_labeled.mat, nor a folder with depth/, nor one of "
        ".npz files"
    )


def camera_of(shape: tuple[int, int]) -> PinholeCamera:
    """Camera of a whole frame, or of one of the usual crops of it.

    Raises
    ------
    PlanewiseError
        If an image of that shape is neither.
    """
    if shape == FULL:
        return NYU
    for rows, columns in (PLANE_CROP, SCORED_CROP):
        if shape == (rows.stop - rows.start, columns.stop - columns.start):
            return NYU.cropped(rows.start, columns.start, shape)
    raise PlanewiseError(
        f"camera: an image of {shape[0]} x {shape[1]} pixels is no whole frame ({FULL[0]} x "
        f"{FULL[1]}) and none of its usual crops; give the camera"
    )


def _labelled(ids: tuple[str, ...], truth: NyuTruth | None) -> tuple[str, ...]:
    if truth is None:
        return ()
    return tuple(frame for frame in ids if _number(frame) in truth.files)


def _number(name: str) -> str:
    """Frame 0012 is frame 12."""
    return name.lstrip("0") or "0"


def _nearest(labels: NDArray[np.integer], shape: tuple[int, int]) -> NDArray[np.integer]:
    """Labels at the nearest pixel of an image of another size."""
    rows, columns = (
        ((np.arange(n) + 0.5) * m / n).astype(np.intp)
        for n, m in zip(shape, labels.shape, strict=True)
    )
    return labels[np.ix_(rows, columns)]
