"""A cloud that is one depth image: all its points lie on the pixels of one camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import checked_points
from planewise.camera import PinholeCamera
from planewise.model import Plane, PlaneModel
from planewise.pixel_lattice import MOST_OFF, OFF, PixelLattice, may_be_seen, pixel_lattice
from planewise.point_observation import checked_origin

Array = NDArray[np.float64]
Pixels = NDArray[np.intp]

_FEWEST = 1_000  # points; of fewer it is not worth to know their pixels
_SOME = 5_000  # of them that tell whether one camera may see all
_BESIDE = 0.5  # share of the pixels whose right neighbour has a point, too
_LOOKING = 0.7  # cosine of the angle between forward and the cloud's z from which on z is no height


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays do not compare to one bool
class CloudImage:
    """The depth image that the points of a cloud were made of.

    Attributes
    ----------
    depth : ndarray of float64, shape (H, W)
        Metres; 0 where there is no point.
    camera : PinholeCamera
        The points lie on its rays.
    pixel : ndarray of int, shape (k,)
        Of every point the place of its pixel in the flattened image; -1 for none: points that are
        not finite, off their ray, or behind another.
    turn : ndarray, shape (3, 3)
        Axes of the camera in the frame of the cloud, as rows: x right, y down, z forward.
    origin : ndarray, shape (3,)
        Where the camera stood in that frame.
    points : ndarray, shape (k, 3)
        The points.
    """

    depth: Array
    camera: PinholeCamera
    pixel: Pixels
    turn: Array
    origin: Array
    points: NDArray[np.floating]

    def in_cloud(self, model: PlaneModel) -> PlaneModel:
        """What was found in the depth image, as planes and labels of the points.

        Parameters
        ----------
        model : PlaneModel
            Of `depth` and `camera`.

        Returns
        -------
        PlaneModel
            With a label for every point, and planes in the frame of the cloud, whose origin their
            normals face. Information is that of the image. `rms` is across the plane. Its settings
            say the camera.

        Raises
        ------
        ValueError
            If it is the model of an image of another shape.
        """
        if model.labels.shape != self.depth.shape:
            raise ValueError(
                f"model must be that of the image, of shape {self.depth.shape}, "
                f"got one of {model.labels.shape}"
            )
        on_pixel = self.pixel >= 0
        labels = np.where(on_pixel, model.labels.ravel()[self.pixel], 0).astype(np.uint16)
        rank = np.argsort(labels, kind="stable")
        ends = np.searchsorted(labels[rank], np.arange(1, len(model) + 2))
        height, width = self.depth.shape
        image = {
            "width": width,
            "height": height,
            "camera": self.camera.describe(),
            "turn": self.turn.tolist(),
            "origin": self.origin.tolist(),
        }
        return replace(
            model,
            labels=labels,
            planes=tuple(
                self._in_cloud(plane, rank[first:end])
                for plane, first, end in zip(model.planes, ends, ends[1:], strict=False)
            ),
            readings=int(np.count_nonzero(on_pixel)),
            settings={**model.settings, "image": image},
        )

    def _in_cloud(self, plane: Plane, own: Pixels) -> Plane:
        # n . R (x - o) + d = 0
        normal = plane.normal @ self.turn
        distance = plane.distance - float(normal @ self.origin)
        change = np.zeros((4, 4))
        change[:3, :3], change[3, :3], change[3, 3] = self.turn.T, -self.turn @ self.origin, 1.0
        facing = -1.0 if distance < 0 else 1.0
        off = self.points[own].astype(np.float64) @ normal + distance
        return replace(
            plane,
            normal=facing * normal,
            distance=facing * distance,
            count=len(own),
            rms=float(np.sqrt(np.mean(off**2))),
            centroid=plane.centroid @ self.turn + self.origin,
            covariance=change @ plane.covariance @ change.T,
            bounding_box=(),
        )


def image_of_cloud(points: ArrayLike, origin: ArrayLike | None = None) -> CloudImage:
    """Find the depth image that a cloud was made of, whatever the order and frame of its points.

    The camera is told by the points, which have to be those of one depth image and as exact as
    single precision has them; left out may be those without a reading, and all but every n-th row
    and column. Planes of the image are told better than those of the points, for it knows which are
    neighbours, and how far its error, its steps among them, goes along the rays:
    `detect_planes_in_points` searches it where the noise is "auto". `image_of_points` is for points
    in the order of its pixels.

    Parameters
    ----------
    points : array_like, shape (k, 3)
        Metres.
    origin : array_like, shape (3,), optional
        Where the camera stood, in the frame of the points; by default in its origin.

    Returns
    -------
    CloudImage
        ``depth`` and ``camera``, as `detect_planes` takes them, and `CloudImage.in_cloud`, which
        brings the result back to the points.

    Raises
    ------
    ValueError
        If an argument is malformed, or there is no camera on whose pixels a thousand points or more
        lie, but for one in a hundred, within a quarter of a pixel, or none that takes depth images
        (`PinholeCamera.check`).

    Examples
    --------
    >>> import planewise as pw
    >>> room = pw.scenes.room(0, size=(120, 160))
    >>> points = room.camera.rays((120, 160)) * (0.001 * room.depth)[..., None]
    >>> points = points[room.depth > 0] @ [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # z is up, x ahead
    >>> image = pw.image_of_cloud(points)
    >>> round(image.camera.fx - room.camera.fx, 6), image.depth.shape
    (0.0, (120, 160))
    >>> found = image.in_cloud(pw.detect_planes(image.depth, image.camera, room.sensor))
    >>> len(found) > 5, found.labels.shape == (len(points),)
    (True, True)
    """
    array = checked_points(points, 3)
    place = checked_origin(origin, array.shape)
    if place is not None and place.ndim != 1:
        raise ValueError(f"origin must be that of one camera, of shape (3,), got {place.shape}")
    place = np.zeros(3) if place is None else place + 0.0  # not -0
    image = None
    if may_be_seen(array[:: 1 + len(array) // _SOME].astype(np.float64) - place):
        some = np.flatnonzero(np.isfinite(array).all(axis=1))
        towards = array[some].astype(np.float64) - place
        apart = towards.any(axis=1)
        some, towards = some[apart], towards[apart]
        lattice = pixel_lattice(towards) if len(some) >= _FEWEST else None
        image = None if lattice is None else _image(array, some, towards, place, lattice)
    if image is None:
        raise ValueError(
            f"points: no camera at {place.tolist()} has pixels on which {_FEWEST:,} or more lie, "
            f"but for one in a hundred, within {OFF} pixels; they are no depth image's, or rounded"
        )
    return image


def _image(
    points: NDArray[np.floating], some: Pixels, towards: Array, origin: Array, lattice: PixelLattice
) -> CloudImage | None:
    """Lay the points out as an image; None where they are none."""
    lattice = lattice.turned_by(_upright(lattice.turn))
    focal = lattice.intrinsics[[0, 1], [0, 1]]
    centre = lattice.intrinsics[:2, 2]
    with np.errstate(all="ignore"):  # points have no bounds
        x, y, z = lattice.turn @ towards.T
        place = np.stack((x / z, y / z)) * focal[:, None] + centre[:, None]
    there = (z > 0) & (np.abs(place - np.rint(place)) <= OFF).all(axis=0)
    if np.mean(there) < 1 - MOST_OFF:
        return None
    column, row = np.rint(place[:, there]).astype(np.intp)
    left, top = column.min(), row.min()
    width, height = int(np.ptp(column)) + 1, int(np.ptp(row)) + 1
    pixel = (row - top) * width + column - left
    # Of points on one ray the nearest is seen, and copies of it.
    depth = np.full(height * width, np.inf)
    np.minimum.at(depth, pixel, z[there])
    hidden = z[there] > depth[pixel]
    filled = np.isfinite(depth).reshape(height, width)
    beside = np.count_nonzero(filled[:, 1:] & filled[:, :-1])
    if np.mean(hidden) > MOST_OFF or beside < _BESIDE * np.count_nonzero(filled):
        return None
    camera = PinholeCamera(
        fx=float(focal[0]),
        fy=float(focal[1]),
        cx=float(centre[0] - left),
        cy=float(centre[1] - top),
        width=width,
        height=height,
    )
    camera.check((height, width))
    of_points = np.full(len(points), -1, np.intp)
    of_points[some[there]] = np.where(hidden, -1, pixel)
    return CloudImage(
        depth=np.where(filled, depth.reshape(height, width), 0.0),
        camera=camera,
        pixel=of_points,
        turn=lattice.turn,
        origin=origin,
        points=points,
    )


def _upright(turn: Array) -> Array:
    """Signed choice (2, 2) of rows and columns by which the image is the right way up.

    Down is against the cloud's z or, where the camera looks along that, along its y in a camera's
    frame, x right, y down, z forward, and against it in that of graphics, z backward. Right is such
    that the axes are right-handed.
    """
    forward = turn[2]
    up = abs(forward[2]) < _LOOKING
    down = np.array((0.0, 0.0, -1.0)) if up else np.array((0.0, np.sign(forward[2]), 0.0))
    along = turn[:2] @ down
    second = int(np.abs(along).argmax())
    y = np.copysign(1.0, along[second]) * turn[second]
    x = np.copysign(1.0, np.cross(y, forward) @ turn[1 - second])
    out = np.zeros((2, 2))
    out[0, 1 - second], out[1, second] = x, np.copysign(1.0, along[second])
    return out
