"""Images that were enlarged, by repeating pixels or by linear interpolation, and their cameras."""

from __future__ import annotations

import numpy as np

import planewise as pw


def models_of(depth, camera, sensor):
    """What every door but `detect_planes` finds in an image."""
    detector = pw.Detector(camera, sensor)
    return detector(depth), detector(depth), *detector.stream([depth, depth])


def repeated(image, shape, *, centred=False):
    """The nearest own pixel for each, as OpenCV or, with centres, as Pillow says."""
    rows, columns = (
        ((np.arange(size) + 0.5 * centred) * (own / size)).astype(int)
        for own, size in zip(image.shape, shape, strict=True)
    )
    return image[np.ix_(rows, columns)]


def places(own, size, *, corners=False):
    """Where each of `size` pixels lies among own ones, as by OpenCV, or with the same corners."""
    at = np.arange(size)
    place = at * (own - 1) / (size - 1) if corners else (at + 0.5) * own / size - 0.5
    return np.clip(place, 0, own - 1)


def along(image, place, *, holes=True):
    """Interpolate rows linearly; holes: a missing reading is a 0, else what it has a part in is."""
    above = np.minimum(np.floor(place).astype(int), len(image) - 2)
    share = (place - above)[:, None]
    here, behind = image[above], image[above + 1]
    out = np.where(share == 0, here, np.where(share == 1, behind, here + share * (behind - here)))
    if not holes:
        lost = (here == 0) & (share < 1) | (behind == 0) & (share > 0)
        out = np.where(lost, 0, out)
    return out


def interpolated(image, shape, *, holes=True, corners=False):
    """Interpolate linearly, rows first."""
    out = np.asarray(image, np.float64)
    for axis in (0, 1):
        place = places(image.shape[axis], shape[axis], corners=corners)
        out = np.moveaxis(along(np.moveaxis(out, axis, 0), place, holes=holes), 0, axis)
    return out


def camera_of(camera, own, shape, *, corners=False):
    """The camera of an image that was enlarged from one size to another."""
    (y, top), (x, left) = (
        ((n - 1) / (k - 1), 0.0) if corners else (n / k, (n / k - 1) / 2)
        for n, k in zip(shape, own, strict=True)
    )
    return pw.PinholeCamera(
        fx=x * camera.fx, fy=y * camera.fy, cx=x * camera.cx + left, cy=y * camera.cy + top
    )
