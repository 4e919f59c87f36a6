"""Whether what is given is a camera, and one of another class gives what `Camera` says."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from planewise.arguments import is_finite, shown
from planewise.camera import RIG, Camera, PinholeCamera
from planewise.enlarged.scattered import ScatteredCamera
from planewise.spherical import SphericalCamera

_MEMBERS = [name for name in vars(Camera) if not name.startswith("_")]


def checked_camera(camera: Camera) -> Camera:
    """Refuse what is no camera, such as the name of one or a matrix.

    Raises
    ------
    ValueError
        If it is not a `Camera`.
    """
    if isinstance(camera, type) or not (hasattr(camera, "ray_rows") and hasattr(camera, "check")):
        got = camera.__name__ if isinstance(camera, type) else f"a {type(camera).__name__}"
        raise ValueError(
            "camera must be a planewise.PinholeCamera or SphericalCamera, such as "
            f"planewise.cameras.KINECT_V1, got {got}"
        )
    if lacking := [n for n in _MEMBERS if not (hasattr(type(camera), n) or hasattr(camera, n))]:
        raise ValueError(f"camera: a {type(camera).__name__} lacks {', '.join(lacking)}")
    return camera


def check_own(camera: Camera, shape: tuple[int, int]) -> None:
    """Refuse a camera of one's own that gives anything but `Camera` says, once per image size.

    Raises
    ------
    ValueError
        Which names what is wrong, what was expected and what came.
    """
    if type(camera) in (PinholeCamera, SphericalCamera, ScatteredCamera):
        return
    try:
        hash(camera)
    except TypeError as error:
        raise ValueError(f"camera: a {type(camera).__name__} must be hashable ({error})") from None
    _check(camera, shape)


@lru_cache(maxsize=RIG)
def _check(camera: Camera, shape: tuple[int, int]) -> None:
    size = camera.pixel_size
    numbers = isinstance(size, tuple) and len(size) == 2
    if not (numbers and all(is_finite(each) and each > 0 for each in size)):
        raise _wrong(camera, "pixel_size", "a tuple of two positive metres", size)
    flat = (3, shape[0] * shape[1])
    for name, wanted in (("rays", (*shape, 3)), ("ray_rows", flat), ("pixel_area", shape)):
        given = getattr(camera, name)(shape)
        lacking = name != "pixel_area" and camera.bends
        _check_array(camera, name, given, np.float64, wanted, lacking=lacking)
    _check_sectors(camera, shape)


def _check_sectors(camera: Camera, shape: tuple[int, int]) -> None:
    from planewise.sectors import Sectors  # loads Numba

    given = camera.sectors(shape)
    if not isinstance(given, Sectors):
        raise _wrong(camera, "sectors", "a planewise.sectors.Sectors", given)
    height, width = shape
    across, column = width, given.column
    if column is not None:
        if not np.array_equal(np.asarray(column)[np.asarray(column) >= 0], np.arange(width)):
            wanted = f"the columns 0 ... {width - 1} of the image in order, and -1 in gaps"
            raise _wrong(camera, "sectors.column", wanted, column)
        slices = map(np.arange, np.asarray(given.start), np.asarray(given.stop))
        if not np.array_equal(np.flatnonzero(np.asarray(column) >= 0), np.concatenate([*slices])):
            wanted = "the ends of the columns that are not -1"
            raise _wrong(camera, "sectors.start and stop", wanted, "others")
        across = len(column)
    images = {"x": given.x, "y": given.y, "ratio": given.ratio}
    for name, image in images.items():
        if image is not None:
            _check_array(camera, f"sectors.{name}", image, np.float32, (height, across))
    if given.ratio is not None and not given.ratio.min() > 0:
        raise _wrong(camera, "sectors.ratio", "positive", float(given.ratio.min()))
    turn = np.asarray(given.turn)
    _check_array(camera, "sectors.turn", given.turn, np.float64, (len(turn), 3, 3))
    if not np.abs(np.linalg.det(turn)).min(initial=1.0) > 0:
        raise _wrong(camera, "sectors.turn", "matrices that can be inverted", turn)


def _check_array(
    camera: Camera,
    name: str,
    given: Any,
    kind: DTypeLike,
    shape: tuple[int, ...],
    lacking: bool = False,
) -> None:
    if not (isinstance(given, np.ndarray) and given.dtype == kind and given.shape == shape):
        raise _wrong(camera, name, f"an array of {np.dtype(kind)} of shape {shape}", given)
    if np.isinf(given).any() or (not lacking and np.isnan(given).any()):
        unless = " (NaN is for pixels without rays of a camera that bends)" * ("ray" in name)
        raise _wrong(camera, name, f"finite{unless}", "inf or NaN")


def _wrong(camera: Camera, name: str, wanted: str, given: object) -> ValueError:
    got = given if isinstance(given, str) else shown(given)
    if isinstance(given, np.ndarray):
        got = f"{given.dtype} of shape {given.shape}"
    return ValueError(f"camera: {name} of {type(camera).__name__} must be {wanted}; got {got}")
