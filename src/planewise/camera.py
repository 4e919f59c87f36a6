"""From pixels to rays: what any camera tells, and the pinhole camera.

Frame of the pinhole camera: x right, y down, z forward, origin at the optical centre. Pixel (0, 0)
is the centre of the upper left pixel. The ray of a pixel is r = (u, v, 1) and a reading z on it is
the point z r; where readings are distances (`radial`), r = (u, v, 1) / |(u, v, 1)|.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planewise.arguments import (
    checked_count,
    checked_pixels,
    checked_shape,
    is_finite,
    is_whole,
    make_plain,
    shown,
)
from planewise.lens import COUNTS, ORDER, distort, undistort
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.sectors import Sectors

Array = NDArray[np.float64]

RIG = 16
"""Cameras whose rays are kept, such as all of a robot."""

_LONGEST_FOCAL = 2500.0  # pixels; small crops of long lenses stay below it
_WIDEST = 7.5  # times its focal length is an image wide at most: 150 degrees
_UNSEEN = 0.1  # share of an image that a lens may not see; more is no lens of that image


class Camera(Protocol):
    """Known rays of an image: `PinholeCamera`, `SphericalCamera`, or one of your own.

    It is immutable and hashable, and gives arrays of float64. A reading s on the ray r of its pixel
    is the point s r in the camera's frame.
    """

    def __hash__(self) -> int: ...

    @property
    def frame(self) -> str:
        """The camera's axes in words."""
        ...

    @property
    def wraps(self) -> bool:
        """Whether the last column of an image is beside the first one."""
        ...

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a usual pixel at one metre, in metres."""
        ...

    def check(self, shape: tuple[int, int]) -> None:
        """Raise ValueError for an image (height, width) that it cannot have taken."""
        ...

    def rays(self, shape: tuple[int, int]) -> Array:
        """Rays of all pixels, shape (height, width, 3); NaN where a lens (`bends`) has none."""
        ...

    def ray_rows(self, shape: tuple[int, int]) -> Array:
        """Return the same rays as rows over the flattened image, shape (3, H * W)."""
        ...

    def pixel_area(self, shape: tuple[int, int]) -> Array:
        """Area that pixels cover where readings are 1, square metres, shape (height, width)."""
        ...

    @property
    def bends(self) -> bool:
        """Whether straight lines of space are bent in the image."""
        ...

    def unproject(self, pixels: ArrayLike) -> Array:
        """Rays (..., 3) of places (x, y) in the image, (..., 2); centres of pixels are integers."""
        ...

    def sectors(self, shape: tuple[int, int]) -> Sectors:
        """Coordinates in which inverse depth is affine on planes (`planewise.sectors`)."""
        ...

    def describe(self) -> dict[str, Any]:
        """Say in plain types what the camera is, its ``model`` first, for result files."""
        ...


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """Intrinsics of a camera without skew.

    Parameters
    ----------
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in pixels; pixel centres have integer coordinates.
    width, height : int, optional
        Size of the image they hold for, in pixels. Where given, an image of another size is
        refused.
    distortion : tuple of float, optional
        Coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]) as OpenCV and ROS order them: radial and
        tangential ("plumb_bob"), with k4 to k6 the rational model ("rational_polynomial"), as of
        Azure Kinect. Rays are undistorted once per camera and image size. Pixels that the lens
        cannot have seen, where it folds the image, hold no readings.
    radial : bool
        Readings are distances from the optical centre, as some time-of-flight cameras and renderers
        give them, rather than depth along z: rays are unit directions.

    Raises
    ------
    ValueError
        If a focal length is not positive, a number is not finite, the distortion has not 4, 5
        or 8 coefficients, or width and height are not whole numbers, at least 1, both or neither.

    Examples
    --------
    >>> camera = PinholeCamera(fx=500, fy=500, cx=320, cy=240)
    >>> camera.rays((480, 640))[240, 320]
    array([0., 0., 1.])
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int | None = None
    height: int | None = None
    distortion: tuple[float, ...] = ()
    radial: bool = False

    def __post_init__(self) -> None:
        given: Any = self.distortion
        try:  # OpenCV gives a row, (1, 5), or None
            coefficients = tuple(
                np.ravel(np.asarray(() if given is None else given, np.float64)).tolist()
            )
        except (TypeError, ValueError, OverflowError):
            raise ValueError(
                f"camera: distortion must be numbers, got {self.distortion!r}"
            ) from None
        object.__setattr__(self, "distortion", coefficients)
        for name in ("fx", "fy", "cx", "cy"):  # NumPy's numbers are written as others are
            if is_finite(value := getattr(self, name)):
                object.__setattr__(self, name, float(value))
        for name in ("fx", "fy"):
            value = getattr(self, name)
            if not (is_finite(value) and value > 0):
                raise ValueError(
                    f"camera: {name} must be a positive number of pixels, got {shown(value)}"
                )
        if not all(map(is_finite, (self.cx, self.cy, *coefficients))):
            raise ValueError(f"camera: numbers must be finite, got {' '.join(str(self).split())}")
        if len(self.distortion) not in COUNTS:
            raise ValueError(
                f"camera: distortion must be ({ORDER}), "
                f"got {counted(len(self.distortion), 'number')}"
            )
        size: tuple[Any, Any] = self.width, self.height
        if any(n is not None for n in size) and not all(is_whole(n) and n > 0 for n in size):
            raise ValueError(
                "camera: width and height must be given together and be whole numbers of pixels, "
                f"at least 1, got {shown(self.width)} and {shown(self.height)}"
            )
        make_plain(self, int, "width", "height")
        if not isinstance(self.radial, bool | np.bool_):
            raise ValueError(f"camera: radial must be True or False, got {shown(self.radial)}")
        make_plain(self, bool, "radial")

    @property
    def frame(self) -> str:
        """The camera's axes in words."""
        return "x right, y down, z forward"

    @property
    def wraps(self) -> bool:
        """Whether the last column is beside the first one: not of a pinhole image."""
        return False

    @property
    def bends(self) -> bool:
        """Whether straight lines of space are bent in the image: by distortion."""
        return any(self.distortion)

    @property
    def pixel_size(self) -> tuple[float, float]:
        """Width and height of a pixel on the plane z = 1, in metres: 1 / fx, 1 / fy."""
        return 1.0 / self.fx, 1.0 / self.fy

    def check(self, shape: tuple[int, int]) -> None:
        """Refuse an image that these intrinsics cannot belong to.

        Parameters
        ----------
        shape : (height, width)
            Of the image, in pixels.

        Raises
        ------
        ValueError
            If the image has another size than the camera, a field of view above 150 or below 8
            degrees (small crops of a long lens excepted), or a principal point more than an image
            away from it; 75 degrees where the camera says its size, as one of a crop does.
        """
        height, width = checked_shape("shape", shape)
        if self.width is not None and (self.height, self.width) != (height, width):
            raise ValueError(
                f"camera is for images of {self.width} x {self.height} pixels, "
                f"the depth image has {width} x {height}; give fx, fy, cx, cy of this image "
                "(camera.scaled, camera.cropped)"
            )
        for axis, size, focal, centre in (
            ("x", width, self.fx, self.cx),
            ("y", height, self.fy, self.cy),
        ):
            if not size / _WIDEST <= focal <= max(7 * size, _LONGEST_FOCAL):
                field_of_view = math.degrees(2 * math.atan(size / (2 * focal)))
                raise ValueError(
                    f"camera: f{axis} = {focal:g} px sees {field_of_view:.3g} degrees over {size} "
                    "pixels, which no depth camera does; focal lengths are in pixels of this image"
                )
            crop = self.width is not None and max(centre, size - centre) <= _WIDEST / 2 * focal
            if not (crop or -size <= centre <= 2 * size):
                raise ValueError(
                    f"camera: c{axis} = {centre:g} px lies far outside an image of {size} pixels; "
                    "are the intrinsics for another image size?"
                )

    def rays(self, shape: tuple[int, int]) -> Array:
        """Undistorted rays of all pixels.

        Parameters
        ----------
        shape : (height, width)
            Of the image, in pixels.

        Returns
        -------
        ndarray, shape (height, width, 3)
            (u, v, 1) with u = (x - cx) / fx, v = (y - cy) / fy, or of length one (`radial`); NaN
            where the lens folds the image, at the pixel or beside it. Read-only: it is computed
            once per camera and image size.

        Raises
        ------
        ValueError
            If that is more than a tenth of the image.
        """
        shape = checked_shape("shape", shape)
        return np.moveaxis(_ray_rows(self, shape).reshape(3, *shape), 0, -1)

    def ray_rows(self, shape: tuple[int, int]) -> Array:
        """Return the same rays as rows over the flattened image, shape (3, H * W)."""
        return _ray_rows(self, checked_shape("shape", shape))

    def pixel_area(self, shape: tuple[int, int]) -> Array:
        """Area that each pixel covers where readings are 1, in square metres: du dv at z = 1.

        Parameters
        ----------
        shape : (height, width)
            Of the image, in pixels; at least 2 x 2.
        """
        return _pixel_area(self, checked_shape("shape", shape))

    def sectors(self, shape: tuple[int, int]) -> Sectors:
        """Pixel coordinates: inverse depth of a plane is affine in them all over the image."""
        return _sectors(self, checked_shape("shape", shape))

    def project(self, points: ArrayLike) -> Array:
        """Pixel coordinates (x, y) of points in front of the camera.

        Parameters
        ----------
        points : array_like, shape (..., 3)
            In the camera frame, metres.
        """
        points = np.asarray(points, np.float64)
        u, v = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        if any(self.distortion):
            u, v = distort(self.distortion, u, v)
        return np.stack((self.fx * u + self.cx, self.fy * v + self.cy), axis=-1)

    def unproject(self, pixels: ArrayLike) -> Array:
        """Rays through any pixel coordinates: the inverse of `project`.

        Parameters
        ----------
        pixels : array_like, shape (..., 2)
            x and y; pixel centres are at integers. Where either is NaN, so is its part of the
            ray, or all of it with distortion and `radial`; and where the lens sees nothing.
        """
        pixels = checked_pixels(pixels)
        u = (pixels[..., 0] - self.cx) / self.fx
        v = (pixels[..., 1] - self.cy) / self.fy
        if any(self.distortion):
            known = np.isfinite(u) & np.isfinite(v)
            out = np.full((2, *u.shape), np.nan)
            if known.any():
                out[:, known] = undistort(self.distortion, u[known], v[known])
            u, v = out
        return np.moveaxis(self._rays_of(u, v), 0, -1)

    def scaled(self, factor: float) -> PinholeCamera:
        """Return the camera of the image resized by `factor` (pixel centres at integers)."""
        if not (is_finite(factor) and factor > 0):
            raise ValueError(f"factor must be a positive number, got {factor!r}")
        sides = self.width, self.height
        width, height = (None if n is None else round(n * factor) for n in sides)
        return self._resized(factor, factor, width, height)

    def binned(self, across: int, down: int) -> PinholeCamera:
        """Return the camera of the image whose pixels are `across` x `down` of these each."""
        across, down = checked_count("across", across), checked_count("down", down)
        width = None if self.width is None else self.width // across
        height = None if self.height is None else self.height // down
        return self._resized(1 / across, 1 / down, width, height)

    def _resized(
        self, across: float, down: float, width: int | None, height: int | None
    ) -> PinholeCamera:
        return replace(
            self,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
            width=width,
            height=height,
        )

    def cropped(self, top: int, left: int, shape: tuple[int, int]) -> PinholeCamera:
        """Return the camera of the crop whose first pixel is (`top`, `left`).

        Raises
        ------
        ValueError
            If that is no rectangle of whole pixels inside the image.
        """
        height, width = checked_shape("shape", shape)
        top, left = checked_count("top", top, 0), checked_count("left", left, 0)
        whole = self.width or math.inf, self.height or math.inf
        if left + width > whole[0] or top + height > whole[1]:
            raise ValueError(
                f"a crop of {width} x {height} pixels from row {top}, column {left} is no part of "
                f"the camera's image of {self.width} x {self.height} pixels"
            )
        return replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def describe(self) -> dict[str, float | list[float] | bool]:
        """Say in plain types what the camera is, for result files."""
        out: dict[str, float | list[float] | bool] = {
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
        }
        if any(self.distortion):
            out["distortion"] = list(self.distortion)
        if self.radial:
            out["radial"] = True
        return out

    def directions(self, shape: tuple[int, int]) -> tuple[Array, Array]:
        """Undistorted u and v of all pixels, shape (height, width)."""
        shape = checked_shape("shape", shape)
        if any(self.distortion):
            u, v, z = _ray_rows(self, shape).reshape(3, *shape)
            return (u / z, v / z) if self.radial else (u, v)
        return self._on_plane(shape)

    def _rays_of(self, u: Array, v: Array) -> Array:
        """Rays, shape (3, ...), through places on the plane z = 1."""
        rays = np.stack((u, v, np.ones_like(u)))
        return rays / np.linalg.norm(rays, axis=0) if self.radial else rays

    def _on_plane(self, shape: tuple[int, int], margin: int = 0) -> tuple[Array, Array]:
        """Where pixels lie on the plane z = 1, distorted; with a margin of pixels all around."""
        height, width = (size + 2 * margin for size in shape)
        u = (np.arange(width) - margin - self.cx) / self.fx
        v = (np.arange(height) - margin - self.cy) / self.fy
        return np.broadcast_to(u, (height, width)), np.broadcast_to(v[:, None], (height, width))


@lru_cache(maxsize=RIG)
def _ray_rows(camera: PinholeCamera, shape: tuple[int, int]) -> Array:
    u, v = _undistorted(camera, shape) if any(camera.distortion) else camera._on_plane(shape)
    rows = camera._rays_of(u, v).reshape(3, -1)
    rows.flags.writeable = False
    return rows


def _undistorted(camera: PinholeCamera, shape: tuple[int, int]) -> tuple[Array, Array]:
    u, v = undistort(camera.distortion, *camera._on_plane(shape, margin=1))
    blind = np.isnan(u)
    u, v = u[1:-1, 1:-1], v[1:-1, 1:-1]
    if blind.any():
        # Rays change without bound towards a fold: all about a pixel has to be seen.
        beside = np.lib.stride_tricks.sliding_window_view(blind, (3, 3)).any(axis=(2, 3))
        if beside.mean() > _UNSEEN:
            raise ValueError(
                f"camera: distortion {camera.distortion} cannot be undone over "
                f"{beside.mean():.0%} of the image; are the coefficients in the order {ORDER}?"
            )
        u[beside] = v[beside] = np.nan
    return u, v


def _filled(camera: PinholeCamera, shape: tuple[int, int]) -> tuple[Array, Array]:
    """`directions` with numbers for pixels without rays, too, which hold no readings."""
    (u, v), (flat_u, flat_v) = camera.directions(shape), camera._on_plane(shape)
    blind = np.isnan(u)
    return (np.where(blind, flat_u, u), np.where(blind, flat_v, v)) if blind.any() else (u, v)


@lru_cache(maxsize=RIG)
def _sectors(camera: PinholeCamera, shape: tuple[int, int]) -> Sectors:
    from planewise.sectors import one_sector  # loads Numba

    straight = not any(camera.distortion)
    u, v = camera.directions(shape) if straight else _filled(camera, shape)
    return one_sector(u, v, (camera.fx, camera.fy), straight, radial=camera.radial)


@lru_cache(maxsize=RIG)
def _pixel_area(camera: PinholeCamera, shape: tuple[int, int]) -> Array:
    if any(camera.distortion):
        (u_y, u_x), (v_y, v_x) = map(np.gradient, _filled(camera, shape))
        area = np.abs(u_x * v_y - u_y * v_x)
    else:
        area = np.broadcast_to(1.0 / (camera.fx * camera.fy), shape)  # one number, not an image
    if camera.radial:
        u, v = _filled(camera, shape)
        area = area / (1.0 + u * u + v * v) ** 1.5  # on the sphere of radius one
    area.flags.writeable = False
    return np.asarray(area)
