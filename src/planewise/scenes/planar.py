"""The paper's test images and other scenes of a few planes, with exact truth.

The camera is a pinhole without distortion; depth is in metres or millimetres. What noise puts
behind the camera, or beyond what 16 bits hold, is no reading.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import checked_seed, checked_shape
from planewise.camera import PinholeCamera
from planewise.noise import constant
from planewise.scenes.scene import Array, Scene, Seed
from planewise.sensor import Sensor

_VGA = (480, 640)
_FARTHEST = 65_535  # millimetres that 16 bits hold


def staircase(
    *,
    sigma: float = 0.005,
    size: tuple[int, int] = _VGA,
    rng: Seed = 0,
    quantise: bool = True,
) -> Scene:
    """Two stairs: four bands of equal height, faces at -45, +45, -45 and +45 degrees (paper).

    Parameters
    ----------
    sigma : float
        Standard deviation of the white noise in metres.
    size : (height, width)
        Pixels; the camera has the same view at every size.
    rng : int or numpy.random.Generator
        Seed of the noise.
    quantise : bool
        Round down to millimetres as uint16, as the paper does; otherwise float metres.
    """
    half = math.sqrt(0.5)
    distances = (1.63 * half, half, half, 1.63 * half)
    planes = [
        (0.0, sign * half, -half, d) for sign, d in zip((1, -1, 1, -1), distances, strict=True)
    ]
    height, _ = checked_shape("size", size)
    bands = np.arange(height) * 4 // height
    labels = np.broadcast_to(bands[:, None] + 1, size)
    return _planes_scene(np.array(planes), labels, size, sigma, rng, quantise)


def corner(
    *,
    sigma: float = 0.005,
    size: tuple[int, int] = _VGA,
    rng: Seed = 0,
    quantise: bool = True,
) -> Scene:
    """Tetrahedron that stands out of a background plane at 1.5 m: four planes (paper).

    Parameters
    ----------
    sigma, size, rng, quantise
        As in `staircase`.
    """
    half = math.sqrt(0.5)
    planes = [
        (-half * math.cos(angle), -half * math.sin(angle), -half, 0.7)
        for angle in np.radians((0, 120, 240))
    ]
    planes.append((0.0, 0.0, -1.0, 1.5))
    depths = _depths(np.array(planes), size)
    sides = depths[:3].max(axis=0)
    first = np.isclose(depths[:3], sides, rtol=1e-9, atol=0).argmax(axis=0)  # on a ridge, of two
    labels = np.where(sides < depths[3], first + 1, 4)
    return _planes_scene(np.array(planes), labels, size, sigma, rng, quantise)


def flatness(
    *,
    amplitude: float = 0.005,
    sigma: float = 0.0,
    size: tuple[int, int] = _VGA,
    rng: Seed = 0,
    quantise: bool = True,
) -> Scene:
    """Four upright bands at 2.5, 2.7, 2.9 and 3.1 m, ever more wavy from left to right (paper).

    The truth is the mean plane of each; the wave is a sine along the image height with 0, 2, 10 and
    100 periods.

    Parameters
    ----------
    amplitude : float
        Of the sine in metres; also what the scene's sensor takes as noise.
    sigma, size, rng, quantise
        As in `staircase`.
    """
    if not math.isfinite(amplitude):
        raise ValueError(f"amplitude must be a number of metres, got {amplitude}")
    planes = np.array([(0.0, 0.0, -1.0, d) for d in (2.5, 2.7, 2.9, 3.1)])
    height, width = checked_shape("size", size)
    band = np.arange(width) * 4 // width
    labels = np.broadcast_to(band + 1, size)
    periods = np.array((0, 2, 10, 100))[band]
    down = np.arange(height)[:, None] / height
    wave = amplitude * np.sin(2 * np.pi * periods * down)
    return _planes_scene(
        planes, labels, size, sigma, rng, quantise, relief=wave, noise=max(amplitude, sigma)
    )


def two_planes(
    angle: float,
    *,
    sigma: float = 0.005,
    size: tuple[int, int] = _VGA,
    rng: Seed = 0,
    quantise: bool = True,
) -> Scene:
    """Two planes that meet in a ridge along the middle row, 1 m away (paper).

    Parameters
    ----------
    angle : float
        Between the two, in degrees, above 55 and below 180: 180 would be one plane, and faces
        steeper than 55 degrees' are not seen over the whole image.
    sigma, size, rng, quantise
        As in `staircase`.
    """
    if not 55 < angle < 180:
        raise ValueError(f"angle must lie between 55 and 180 degrees, got {angle}")
    half = math.radians(angle) / 2
    planes = np.array(
        [(0.0, sign * math.cos(half), -math.sin(half), math.sin(half)) for sign in (-1, 1)]
    )
    height, _ = checked_shape("size", size)
    rows = np.arange(height)[:, None]
    labels = np.broadcast_to(np.where(rows < height / 2, 1, 2), size)
    return _planes_scene(planes, labels, size, sigma, rng, quantise)


def t_junction(
    *,
    edge: float = 0.2,
    sigma: float = 0.005,
    size: tuple[int, int] = _VGA,
    rng: Seed = 0,
    quantise: bool = True,
) -> Scene:
    """Large flat plane seen from above, and a second, disconnected one further away (paper).

    The second plane, if continued, cuts through the first along a line in the middle of it;
    readings there fit both, but belong to the first. A search that finds one plane after the other
    takes a strip of them away where it finds the second one first, as at ``edge=0``.

    Parameters
    ----------
    edge : float
        Where the first plane ends and the second begins to be seen, in metres at 1 m; above -0.1,
        the line.
    sigma, size, rng, quantise
        As in `staircase`.
    """
    if not -0.1 < edge < 0.6:
        raise ValueError(f"edge must lie between -0.1 and 0.6, got {edge}")
    slope = 0.8  # the second plane is z = 1 + slope (x + 0.1): it cuts the first one at x = -0.1 m
    second = np.array((slope, 0.0, -1.0, 1 + 0.1 * slope))
    planes = np.array([(0.0, 0.0, -1.0, 1.0), second / np.linalg.norm(second[:3])])
    u = _camera(size).rays(size)[..., 0]
    return _planes_scene(planes, np.where(u < edge, 1, 2), size, sigma, rng, quantise)


def _camera(size: tuple[int, int]) -> PinholeCamera:
    """Return the paper's camera, scaled to another image size."""
    height, width = checked_shape("size", size)
    across, down = width / _VGA[1], height / _VGA[0]
    return PinholeCamera(fx=500 * across, fy=500 * down, cx=320 * across, cy=240 * down)


def _depths(planes: Array, size: tuple[int, int]) -> Array:
    """Depth of each plane at each pixel, shape (N, H, W): z = -d / (n . r)."""
    rays = _camera(size).rays(size)
    return np.asarray(-planes[:, 3, None, None] / np.einsum("nc,hwc->nhw", planes[:, :3], rays))


def _planes_scene(
    planes: Array,
    labels: NDArray[np.integer],
    size: tuple[int, int],
    sigma: float,
    rng: Seed,
    quantise: bool,
    *,
    relief: Array | float = 0.0,
    noise: float | None = None,
) -> Scene:
    if not (math.isfinite(sigma) and sigma >= 0):
        raise ValueError(f"sigma must be a number of metres, at least 0, got {sigma}")
    truth = labels.astype(np.uint16)
    exact = np.take_along_axis(_depths(planes, size), labels[None].astype(np.int64) - 1, axis=0)[0]
    z = exact + relief + np.random.default_rng(checked_seed("rng", rng)).normal(0, 1, size) * sigma
    resolution = 0.001
    readings = np.floor(z / resolution) if quantise else z
    seen = (readings > 0) & (readings <= _FARTHEST if quantise else True)
    if not seen.any():
        raise ValueError(
            f"no pixel of the scene has a reading: sigma = {sigma} m puts all behind the camera or "
            "too far away; give less noise"
        )
    depth = np.where(seen, readings, 0.0)
    metres = depth[seen] * resolution if quantise else depth[seen]
    spread = float(metres.max() - metres.min())
    assumed = sigma if noise is None else noise
    return Scene(
        depth=depth.astype(np.uint16) if quantise else depth,
        camera=_camera(size),
        sensor=Sensor(
            max_depth=math.ceil(metres.max() / resolution) * resolution + resolution,
            depth_range=spread if spread > resolution else 2 * resolution,  # of at least two steps
            resolution=resolution,
            noise=constant(max(assumed, resolution / math.sqrt(12))),  # rounding is noise, too
        ),
        labels=np.where(seen, truth, 0).astype(np.uint16),
        planes=planes,
        rgb=_shaded(planes, truth),
    )


def _shaded(planes: Array, labels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Grey faces under a lamp at the upper left of the camera."""
    lamp = np.array((-0.35, -0.55, -0.75))
    brightness = np.clip(planes[:, :3] @ lamp / np.linalg.norm(lamp), 0.1, 1)
    grey = (60 + 180 * brightness[labels - 1]).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2)
