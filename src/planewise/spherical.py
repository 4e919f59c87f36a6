"""The spherical camera: organised range images of LiDAR and laser scanners, and panoramas.

Frame: x forward, y left, z up, origin at the sensor, as LiDAR drivers have it. Row i looks at
`elevation[i]`, column j at `azimuth[j]`, counter-clockwise from x; the ray is the unit vector

    d = (cos e cos a, cos e sin a, sin e),   a = azimuth[j] + azimuth_offset[i],

so that a reading is the range, the distance from the sensor, and the point is range * d. A sensor
that is tilted in that frame has axes of its own (`turn`), of which these are the angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise import angles
from planewise.arguments import (
    checked_count,
    checked_pixels,
    checked_points,
    checked_scale,
    checked_shape,
    is_finite,
    shown,
    unmasked,
)
from planewise.camera import RIG

if TYPE_CHECKING:
    from planewise.sectors import Sectors

Array = NDArray[np.float64]

_FULL_TURN = 1.5  # columns from the last of one to the first, at most
_FINEST = 0.05  # degrees between the beams of a spinning LiDAR; half of what there is
_RADIANS = 3.2  # what all elevations there can be span in radians
_SKEW = 1e-5  # by which axes may be off those of a rotation


@dataclass(frozen=True, kw_only=True, repr=False)  # thousands of angles say nothing
class SphericalCamera:
    """Directions of an organised LiDAR image or a panorama, in degrees.

    Parameters
    ----------
    elevation : sequence of float, length H
        Of every row (beam) above the horizon, degrees; rising or falling. Images are the right way
        up with the highest beam first.
    azimuth : sequence of float, length W
        Of every column, degrees, counter-clockwise seen from above, 0 straight ahead; rising or
        falling, over 360 degrees at most. As far as there is a choice, falling: then the left of
        the image is on the left. Values may jump by 360.
    azimuth_offset : sequence of float, length H, optional
        What every row's azimuth has more than that of the column, 20 degrees at most. Rows have to
        be in step within two columns: destagger raw images.
    turn : 3 sequences of 3 float, optional
        Axes of the sensor, forward, left and up, in the frame of points and planes, as rows, where
        it is tilted; by default they are those of the frame.

    Raises
    ------
    ValueError
        If angles are not finite or not in order, an elevation lies beyond 90 degrees, columns go
        round more than once, rows are off their columns or staggered, or `turn` is no rotation.

    Examples
    --------
    >>> camera = SphericalCamera.spinning([15, 5, -5, -15], columns=360)
    >>> camera
    <SphericalCamera: 4 rows from 15 to -15, 360 columns from 180 to -179 degrees>
    >>> camera.shape, camera.wraps
    ((4, 360), True)
    >>> camera.rays(camera.shape)[1, 180].round(3)  # the middle of the image looks ahead
    array([0.996, 0.   , 0.087])
    """

    elevation: Sequence[float]
    azimuth: Sequence[float]
    azimuth_offset: Sequence[float] = ()
    turn: Sequence[Sequence[float]] = ()

    def __post_init__(self) -> None:
        for name in ("elevation", "azimuth", "azimuth_offset"):
            object.__setattr__(self, name, angles.degrees(name, getattr(self, name)))
        if len(self.elevation) < 2 or len(self.azimuth) < 2:
            raise ValueError(
                "camera: elevation and azimuth must have at least 2 angles each, "
                f"got {len(self.elevation)} and {len(self.azimuth)}"
            )
        if len(self.azimuth_offset) not in (0, len(self.elevation)):
            raise ValueError(
                f"camera: azimuth_offset must have one angle for each of {len(self.elevation)} "
                f"rows, got {len(self.azimuth_offset)}"
            )
        angles.check_elevation(np.array(self.elevation))
        along = self._continuous()
        angles.check_azimuth(along)
        angles.check_offset(np.array(self.azimuth_offset), angles.usual_step(along))
        object.__setattr__(self, "turn", _checked_turn(self.turn))

    def __repr__(self) -> str:
        up, round_about = self.elevation, self.azimuth
        return (
            f"<SphericalCamera: {len(up)} rows from {up[0]:g} to {up[-1]:g}, {len(round_about)} "
            f"columns from {round_about[0]:g} to {round_about[-1]:g} degrees"
            f"{', rows offset' if self.azimuth_offset else ''}{', turned' if self.turn else ''}>"
        )

    @classmethod
    def spinning(
        cls,
        elevation: Sequence[float] | NDArray[np.floating],
        columns: int,
        *,
        start: float = 180.0,
        clockwise: bool = True,
        azimuth_offset: Sequence[float] = (),
    ) -> SphericalCamera:
        """Camera of a full turn in even steps.

        Parameters
        ----------
        elevation, azimuth_offset
            As of the class.
        columns : int
            To a turn.
        start : float
            Azimuth of the first column, degrees; 180 puts what is ahead into the middle.
        clockwise : bool
            Whether azimuth falls from column to column, seen from above.
        """
        columns = checked_count("camera: columns", columns, 2)
        if not is_finite(start):
            raise ValueError(f"camera: start must be an angle in degrees, got {shown(start)}")
        step = (-360.0 if clockwise else 360.0) / columns
        camera = cls(
            elevation=np.asarray(elevation).tolist(),
            azimuth=tuple((start + step * np.arange(columns)).tolist()),
            azimuth_offset=azimuth_offset,
        )
        spread = float(np.ptp(camera.elevation))
        if spread < min(_RADIANS, _FINEST * (len(camera.elevation) - 1)):
            raise ValueError(
                f"camera: elevation spreads by {spread:.3g} degrees over {len(camera.elevation)} "
                "rows, which no spinning LiDAR does; are the angles in degrees?"
            )
        return camera

    @classmethod
    def panorama(cls, rows: int, columns: int | None = None) -> SphericalCamera:
        """Camera of an equirectangular panorama: straight up at the top, ahead in the middle.

        Its depth images hold distances. Other panoramas, as of a scanner that does not see the
        ground below it, are `spinning` ones.

        Parameters
        ----------
        rows : int
            From straight up to straight down.
        columns : int, optional
            All the way round; ``None`` means twice as many as rows.

        Examples
        --------
        >>> camera = SphericalCamera.panorama(512)
        >>> camera.shape, camera.wraps
        ((512, 1024), True)
        >>> camera.unproject([511.5, 255.5]).round(3)  # the middle of the image looks ahead
        array([1., 0., 0.])
        """
        rows = checked_count("camera: rows", rows, 2)
        columns = checked_count("camera: columns", 2 * rows if columns is None else columns, 3)
        step = 180.0 / rows
        elevation = 90.0 - step * (np.arange(rows) + 0.5)
        return cls.spinning(elevation, columns, start=180.0 - 180.0 / columns)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of its images."""
        return len(self.elevation), len(self.azimuth)

    @property
    def frame(self) -> str:
        """The camera's axes in words."""
        return "x forward, y left, z up"

    @property
    def axes(self) -> Array:
        """Axes of the sensor in the camera's frame, as rows, shape (3, 3)."""
        return np.array(self.turn or np.eye(3))

    @property
    def wraps(self) -> bool:
        """Whether the columns go all the way round: the last one is beside the first."""
        along = self._continuous()
        step = abs(along[-1] - along[0]) / (len(along) - 1)
        return bool(abs(along[-1] - along[0]) + _FULL_TURN * step >= 360.0)

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Usual angles between columns and between rows, in radians: metres at one metre."""
        across, down = angles.usual_step(self._continuous()), np.diff(self.elevation)
        return float(np.radians(across)), float(np.radians(np.mean(np.abs(down))))

    def check(self, shape: tuple[int, int]) -> None:
        """Refuse an image of another size.

        Raises
        ------
        ValueError
            If `shape` (height, width) is not that of the camera.
        """
        shape = checked_shape("shape", shape)
        if shape != self.shape:
            height, width = self.shape
            turned = " (transposed?)" if shape[::-1] == self.shape else ""
            raise ValueError(
                f"camera has {height} rows and {width} columns, the range image has {shape[0]} "
                f"and {shape[1]}{turned}"
            )

    def rays(self, shape: tuple[int, int]) -> Array:
        """Unit directions of all pixels, shape (height, width, 3); read-only."""
        return np.moveaxis(self.ray_rows(shape).reshape(3, *self.shape), 0, -1)

    def ray_rows(self, shape: tuple[int, int]) -> Array:
        """Return the same directions as rows over the flattened image, shape (3, H * W)."""
        self.check(shape)
        return _ray_rows(self)

    def pixel_area(self, shape: tuple[int, int]) -> Array:
        """Solid angle of every pixel in steradians, half-way to its neighbours: shape (H, W)."""
        self.check(shape)
        return _pixel_area(self)

    def sectors(self, shape: tuple[int, int]) -> Sectors:
        """Coordinates in which inverse depth is affine on planes, in slices of the panorama."""
        self.check(shape)
        return _sectors(self)

    @property
    def bends(self) -> bool:
        """Whether straight lines of space are bent in the image: they are."""
        return True

    def unproject(self, pixels: ArrayLike) -> Array:
        """Unit directions of places in the image, up to half a pixel beyond the outermost.

        Parameters
        ----------
        pixels : array_like, shape (..., 2)
            Column and row, which is the other order than that of `pixels`; centres of pixels are
            integers.

        Returns
        -------
        ndarray, shape (..., 3)
        """
        column, row = np.moveaxis(checked_pixels(pixels), -1, 0)
        azimuth = angles.between(self._continuous(), column)
        elevation = np.radians(angles.between(np.array(self.elevation), row))
        if self.azimuth_offset:
            azimuth = azimuth + np.interp(row, np.arange(self.shape[0]), self.azimuth_offset)
        rays = self._directions(np.radians(azimuth), elevation)
        return np.ascontiguousarray(np.moveaxis(rays, 0, -1))

    def points(self, depth: ArrayLike, *, depth_scale: float | None = None) -> Array:
        """Points of a range image.

        Parameters
        ----------
        depth : array_like, shape (H, W)
            Ranges: floating point in metres, integer in units of `depth_scale`. 0, NaN and
            infinity are no reading.
        depth_scale : float, optional
            Metres per unit of integer ranges.

        Returns
        -------
        ndarray, shape (H, W, 3)
            Metres; NaN where there is no reading.
        """
        ranges, scale = unmasked("depth", depth), checked_scale(depth_scale)
        if ranges.ndim != 2:
            raise ValueError(f"depth must be a 2-D image of ranges, got shape {ranges.shape}")
        if (ranges.dtype.kind in "iu") != (scale is not None):
            raise ValueError(
                "depth_scale is for integer depth, which needs it; floating-point depth is in "
                f"metres: got {ranges.dtype} and depth_scale = {depth_scale!r}"
            )
        ranges = ranges.astype(np.float64) * (scale or 1.0)
        self.check((ranges.shape[0], ranges.shape[1]))
        with np.errstate(invalid="ignore"):
            there = (ranges > 0) & np.isfinite(ranges)
        return np.asarray(self.rays(self.shape) * np.where(there, ranges, np.nan)[..., None])

    def pixels(self, points: ArrayLike) -> NDArray[np.intp]:
        """Pixels whose rays are nearest to points, by elevation and then azimuth.

        Parameters
        ----------
        points : array_like, shape (k, 3)
            In the camera's frame, metres.

        Returns
        -------
        ndarray of int, shape (k, 2)
            Row and column, to index an image with, which is the other order than `unproject` takes;
            -1 for points at the origin, masked, not finite, or outside the image: farther from its
            outermost rows or columns than half-way to where the next one would be.
        """
        array = checked_points(points, 3)
        with np.errstate(invalid="ignore"):
            x, y, z = self.axes @ array.T if self.turn else array.astype(np.float64).T
            level = np.degrees(np.arctan2(z, np.hypot(x, y)))
            around = np.degrees(np.arctan2(y, x))
        there = np.isfinite(array).all(axis=1) & (np.abs(array).max(axis=1, initial=0.0) > 0)
        row = angles.nearest(np.array(self.elevation), np.where(there, level, 0.0))
        if self.azimuth_offset:
            around = around - np.take(self.azimuth_offset, row)
        along = self._continuous()
        # One turn that begins half a column before the first one, or half of what the gap is less.
        span, sign = abs(along[-1] - along[0]), np.sign(along[-1] - along[0])
        first = along[0] - 0.5 * sign * min(span / (len(along) - 1), 360.0 - span)
        turn = first + sign * np.mod(sign * (np.where(there, around, along[0]) - first), 360.0)
        column = angles.nearest(along, turn)
        inside = there & (row >= 0) & (column >= 0)
        return np.where(inside[:, None], np.stack((row, column), axis=1), -1)

    def from_points(self, points: ArrayLike) -> Array:
        """Range image of an unordered sweep: every point in the nearest pixel, the closest counts.

        Parameters
        ----------
        points : array_like, shape (k, 3)
            Relative to the sensor, in the camera's frame, metres. Rows that are not finite, at the
            origin or outside the image are left out.

        Returns
        -------
        ndarray, shape (H, W)
            Ranges in metres, 0 where there is no point.

        Examples
        --------
        >>> camera = SphericalCamera.spinning([10, 0, -10], columns=4)
        >>> camera.from_points([[2, 0, 0], [3, 0, 0.1], [0, 5, 0]])
        array([[0., 0., 0., 0.],
               [0., 5., 2., 0.],
               [0., 0., 0., 0.]])
        """
        points = checked_points(points, 3)
        pixels = self.pixels(points)
        inside = pixels[:, 0] >= 0
        ranges = np.linalg.norm(points[inside].astype(np.float64), axis=1)
        out = np.full(self.shape, np.inf)
        np.minimum.at(out, tuple(pixels[inside].T), ranges)
        return np.where(np.isfinite(out), out, 0.0)

    def describe(self) -> dict[str, Any]:
        """Say in plain types what the camera is, for result files and camera files."""
        out: dict[str, Any] = {"model": "spherical", "elevation": list(self.elevation)}
        start, clockwise = self.azimuth[0], self._continuous()[1] < self.azimuth[0]
        try:
            even = SphericalCamera.spinning(
                self.elevation, len(self.azimuth), start=start, clockwise=bool(clockwise)
            ).azimuth
        except ValueError:  # rows closer than those of a spinning LiDAR
            even = ()
        if even == self.azimuth:
            out |= {"columns": len(self.azimuth), "start": start, "clockwise": bool(clockwise)}
        else:
            out["azimuth"] = list(self.azimuth)
        if any(self.azimuth_offset):
            out["azimuth_offset"] = list(self.azimuth_offset)
        if self.turn:
            out["turn"] = [list(axis) for axis in self.turn]
        return out

    def _continuous(self) -> Array:
        """Azimuth of the columns without jumps of 360."""
        return np.unwrap(self.azimuth, period=360.0)

    def _directions(self, azimuth: Array, elevation: Array) -> Array:
        """Unit vectors of angles in radians, shape (3, ...)."""
        flat = np.cos(elevation)
        rays = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)))
        return np.tensordot(self.axes.T, rays, 1) if self.turn else rays

    def _angles(self) -> tuple[Array, Array]:
        """Azimuth and elevation of all pixels in radians, shape (H, W)."""
        offset = np.array(self.azimuth_offset or np.zeros(len(self.elevation)))
        azimuth = self._continuous() + offset[:, None]
        return np.radians(azimuth), np.broadcast_to(
            np.radians(self.elevation)[:, None], azimuth.shape
        )


@lru_cache(maxsize=RIG)
def _ray_rows(camera: SphericalCamera) -> Array:
    rows = camera._directions(*camera._angles()).reshape(3, -1)
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=RIG)
def _pixel_area(camera: SphericalCamera) -> Array:
    around = np.abs(np.diff(angles.edges_of(np.radians(camera._continuous()))))
    edges = angles.edges_of(np.radians(camera.elevation)).clip(-0.5 * np.pi, 0.5 * np.pi)
    up = np.abs(np.diff(np.sin(edges)))
    area = up[:, None] * around
    area.flags.writeable = False
    return np.asarray(area)


@lru_cache(maxsize=RIG)
def _sectors(camera: SphericalCamera) -> Sectors:
    from planewise.sectors import of_panorama  # loads Numba

    sectors = of_panorama(*camera._angles(), camera.pixel_size, camera.wraps)
    return replace(sectors, turn=camera.axes.T @ sectors.turn) if camera.turn else sectors


def _checked_turn(turn: object) -> tuple[tuple[float, ...], ...]:
    """Axes as they are kept; none where they are those of the frame."""
    try:
        array = np.asarray(turn, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty((1, 1))
    if array.size == 0:
        return ()
    # Of NaN nothing is close.
    if array.shape != (3, 3) or not (
        np.allclose(array @ array.T, np.eye(3), atol=_SKEW) and np.linalg.det(array) > 0
    ):
        raise ValueError(
            "camera: turn must be three axes of length 1 at right angles, right-handed, got "
            f"{shown(turn)}"
        )
    return () if (array == np.eye(3)).all() else tuple(map(tuple, array.tolist()))
