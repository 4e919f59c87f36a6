"""What is told of the planes of a depth image or a range image, from inverse depth alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera
from planewise.kernels.cells import UNIT
from planewise.kernels.plane_sums import plane_sums
from planewise.kernels.range_sums import range_sums
from planewise.model import Plane
from planewise.paper.describe import boxes_around, planes_of
from planewise.runtime import threads
from planewise.spatial.frame import Frame

Array = NDArray[np.float64]


def describe_image(
    frame: Frame,
    area: Array,
    affine: Array,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.uint16],
    place: NDArray[np.uint16],
    **told: list[float],
) -> tuple[list[Plane], NDArray[np.uint16]]:
    """Describe the planes of a depth image in inverse depth, without its readings one by one.

    Inverse depth and coordinates are in single precision there: lengths agree to 1e-6 of the depth.

    Parameters
    ----------
    frame : Frame
        The readings.
    area : ndarray, shape (H, W)
        That each pixel covers where readings are 1, in square metres.
    affine : ndarray, shape (N, 3)
        (t0, t1, t2) of w = t0 + t1 x + t2 y, the planes that residuals are taken to.
    rows : ndarray, shape (N, 4)
        Unit normal and distance.
    covariances : ndarray, shape (N, 4, 4)
        Of the rows.
    labels : ndarray of uint16, shape (H, W)
        In any order, 0 for none and where there is no reading.
    place : ndarray of uint16
        What becomes of each label: j for row j - 1, 0 for none.
    **told
        What else is known of each plane, by the names of `Plane`.

    Returns
    -------
    planes : list of Plane
        Their information is 0 if it is not told.
    labels : ndarray of uint16, shape (H, W)
        A new image of the labels' places.
    """
    ranked = np.empty_like(labels)
    both = np.empty((2, len(rows), 7))
    boxes = np.empty((2, len(rows), 4), np.int64)

    solid, ratio = area, frame.sectors.ratio
    if ratio is None:
        ratio = np.ones((1, 1), np.float32)
        solid = area[:1, :1].copy() if frame.straight else area  # the same of all pixels

    def add_up(first: int, last: int) -> None:
        half = int(first > 0)
        plane_sums(
            labels, place, frame.w, frame.x, frame.y, frame.straight, affine, solid, ratio, first,
            last, ranked, both[half], boxes[half],
        )  # fmt: skip

    threads.halves(add_up, len(labels))
    sums, (box, lower) = both[0] + both[1], boxes
    np.minimum(box[:, :2], lower[:, :2], out=box[:, :2])
    np.maximum(box[:, 2:], lower[:, 2:], out=box[:, 2:])
    sums[:, 4:6] *= UNIT / frame.sectors.focal[0], UNIT / frame.sectors.focal[1]
    sums[:, 4:] = sums[:, 4:] @ frame.sectors.axes[0].T  # in the frame of the camera
    return planes_of(rows, covariances, sums, box, told), ranked


def describe_ranges(
    frame: Frame,
    camera: Camera,
    rows: Array,
    covariances: Array,
    labels: NDArray[np.uint16],
    place: NDArray[np.uint16],
    **told: list[float],
) -> tuple[list[Plane], NDArray[np.uint16]]:
    """The same of a range image in sectors, whose residuals are those across the planes.

    Many rays of a LiDAR graze the ground: distances along them say little.

    Parameters
    ----------
    frame : Frame
        The readings.
    camera : Camera
        Of the image, (H, W).
    rows, covariances
        As in `describe_image`.
    labels : ndarray of uint16, shape (H, W')
        In sectors.
    place, **told
        As in `describe_image`.

    Returns
    -------
    planes, labels
        As of `describe_image`; labels (H, W).
    """
    sectors = frame.sectors
    column, ratio = sectors.column, sectors.ratio
    assert column is not None
    assert ratio is not None
    shape = len(labels), sectors.width
    ranked = np.empty(shape, np.uint16)
    both, ends = np.empty((2, len(rows), 7)), np.empty((2, len(rows), 2), np.int64)
    there = np.zeros((len(rows), shape[1]), np.bool_)
    rays, solid = camera.ray_rows(shape), camera.pixel_area(shape)

    def add_up(first: int, last: int) -> None:
        half = int(first > 0)
        range_sums(
            labels, place, frame.w, ratio, column, rays, solid, rows, first, last, ranked,
            both[half], ends[half], there,
        )  # fmt: skip

    threads.halves(add_up, len(labels))
    box = np.empty((len(rows), 4), np.int64)
    box[:, 0], box[:, 2] = ends[..., 0].min(axis=0), ends[..., 1].max(axis=0)
    box[:, 1], box[:, 3] = there.argmax(axis=1), shape[1] - there[:, ::-1].argmax(axis=1)
    if camera.wraps:
        box = boxes_around(box, there)
    return planes_of(rows, covariances, both[0] + both[1], box, told), ranked
