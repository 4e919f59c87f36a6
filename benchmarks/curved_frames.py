"""Planes that the detector finds where everything is curved: prints a Markdown table.

python -m benchmarks.curved_frames

Depth images, 640 x 480, that show one curved surface, and a wall behind it where there is room for
one, and range images of an Ouster OS1-128 inside of one. Planes besides that wall, and how many of
a hundred pixels of the surface they hold, by white noise of the same size everywhere, and as a
Kinect reads it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from planewise import noise

Array = NDArray[np.float64]

CAMERA = pw.PinholeCamera(fx=525, fy=525, cx=319.5, cy=239.5)
SHAPE = (480, 640)
LIDAR = pw.cameras.OUSTER_OS1_128
MILLIMETRES = (1, 2, 5, 10, 20)
_FARTHEST = 25.0  # metres


@cache
def rays(lidar: bool = False) -> Array:
    """Rays of the pixels, shape (H, W, 3): 1 deep, of a LiDAR 1 long."""
    rows = LIDAR.ray_rows(LIDAR.shape) if lidar else CAMERA.ray_rows(SHAPE)
    return rows.T.reshape(*(LIDAR.shape if lidar else SHAPE), 3)


def _depth(a: Array, b: Array, c: float, inside: bool) -> Array:
    """Smaller root z > 0 of a z^2 + 2 b z + c, or the larger one; infinite where there is none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        z = (root - b) / a if inside else -(root + b) / a
    return np.where(z > 0, z, np.inf)


def sphere(
    centre: tuple[float, float, float], radius: float, rays: Array, inside: bool = False
) -> Array:
    """Depth, or range, of a sphere along rays, from outside or from inside."""
    at = np.array(centre)
    return _depth((rays**2).sum(axis=-1), -rays @ at, float(at @ at) - radius**2, inside)


def cylinder(
    axis: tuple[float, float, float],
    centre: tuple[float, float, float],
    radius: float,
    rays: Array,
    inside: bool = False,
) -> Array:
    """Depth, or range, of a cylinder without ends about an axis through a point."""
    along = np.array(axis) / np.linalg.norm(axis)
    across = np.eye(3) - np.outer(along, along)
    ray, at = rays @ across, across @ centre
    return _depth((ray**2).sum(axis=-1), -ray @ at, float(at @ at) - radius**2, inside)


def _bowl(rays: Array) -> Array:
    return 2 + 0.5 * (rays[..., 0] ** 2 + rays[..., 1] ** 2)


def _waves(rays: Array) -> Array:
    return 2.5 + 0.1 * np.sin(6 * rays[..., 0]) + 0.1 * np.cos(5 * rays[..., 1])


def _curtain(fold: float, lean: float, rays: Array) -> Array:
    """Folds so many metres wide and 8 cm deep, at 2.5 m; upright, or they lean a little."""
    return 2.5 + 0.04 * np.sin(2 * np.pi * 2.5 * rays[..., 0] / fold + lean * rays[..., 1])


def _hiding_curtain(fold: float, rays: Array) -> Array:
    """Upright folds in space, which hide parts of each other: where a ray meets the first."""

    def beyond(z: Array) -> Array:
        return z - 2.5 - 0.04 * np.sin(2 * np.pi * rays[..., 0] * z / fold)

    near = np.full(rays.shape[:-1], 2.459)
    for _ in range(82):  # millimetres
        near += np.where(beyond(near + 0.001) < 0, 0.001, 0.0)
    far = near + 0.001
    for _ in range(20):
        middle = 0.5 * (near + far)
        behind = beyond(middle) >= 0
        near, far = np.where(behind, near, middle), np.where(behind, middle, far)
    return far


_Z, _Y = (0, 0, 1), (0, 1, 0)
SURFACES: dict[str, Callable[[Array], Array]] = {
    "ball of 1 m": lambda rays: sphere((0, 0, 2.5), 1.0, rays),
    "ball of 1.5 m": lambda rays: sphere((0, 0, 3.0), 1.5, rays),
    "ball of 1 m, nothing behind": lambda rays: sphere((0, 0, 3.0), 1.0, rays),
    "ball of 0.15 m, nothing behind": lambda rays: sphere((0, 0, 0.65), 0.15, rays),
    "pipe": lambda rays: cylinder((1, 0.2, 0.1), (0, 0, 2.0), 0.5, rays),
    "tank": lambda rays: cylinder(_Y, (0, 0, 4.0), 2.0, rays),
    "silo": lambda rays: cylinder(_Y, (0, 0, 10.0), 4.0, rays),
    "tower, inside": lambda rays: cylinder(_Y, (0, 0, 0), 3.0, rays, inside=True),
    "dome, inside": lambda rays: sphere((0, 0, 0), 3.0, rays, inside=True),
    "tunnel": lambda rays: cylinder((0.3, 0.1, 1), (0, 0.3, 0), 2.0, rays, inside=True),
    "bowl": _bowl,
    "waves": _waves,
    "curtain, folds of 20 cm": partial(_curtain, 0.2, 0.3),
    "curtain, folds of 40 cm": partial(_curtain, 0.4, 0.3),
    "curtain, upright folds of 20 cm": partial(_curtain, 0.2, 0.0),
    "curtain, upright folds of 40 cm": partial(_curtain, 0.4, 0.0),
    "curtain in space, folds of 20 cm": partial(_hiding_curtain, 0.2),
    "curtain in space, folds of 40 cm": partial(_hiding_curtain, 0.4),
    "LiDAR in a tunnel": lambda rays: cylinder((1, 0.1, 0), (0, 0.3, 0.5), 3.0, rays, inside=True),
    "LiDAR in a shaft": lambda rays: cylinder(_Z, (0.5, 1, 0), 6.0, rays, inside=True),
    "LiDAR in a dome": lambda rays: sphere((1, 0.5, 1), 8.0, rays, inside=True),
}
_WALLS = {"ball of 1 m": 4.0, "ball of 1.5 m": 4.0, "pipe": 4.0}  # behind them, metres


def found(name: str, millimetres: float | None) -> tuple[int, float]:
    """Planes on a surface, and the share of its pixels that they hold; None: a Kinect's noise."""
    camera: pw.Camera = LIDAR if name.startswith("LiDAR") else CAMERA
    z, wall = SURFACES[name](rays(camera is LIDAR)), _WALLS.get(name, np.inf)
    curved = z < min(wall, _FARTHEST)
    if millimetres is None:
        sensor, sigma = pw.sensors.KINECT_V1, noise.KINECT
    else:
        sensor = pw.Sensor(max_depth=30, resolution=1e-5, noise=1e-3 * millimetres)
        sigma = noise.constant(1e-3 * millimetres)
    depth = np.where(curved, z, wall)
    there = np.isfinite(depth)
    depth[there] += sigma(depth[there]) * np.random.default_rng(0).standard_normal(there.sum())
    model = pw.detect_planes(depth, camera, sensor, threads=1)
    on, off = (np.bincount(model.labels[of], minlength=len(model) + 1) for of in (curved, ~curved))
    return int((on > off)[1:].sum()), float(on[1:].sum() / on.sum())


def main() -> None:
    """Print the table."""
    parser_of(__doc__).parse_args()
    print("| surface |", " | ".join(f"{each} mm" for each in MILLIMETRES), "| Kinect |")
    print("|---|" + "---:|" * (len(MILLIMETRES) + 1))
    for name in SURFACES:
        noises = MILLIMETRES if name.startswith("LiDAR") else (*MILLIMETRES, None)
        cells = [f"{n} ({100 * part:.0f})" for n, part in (found(name, each) for each in noises)]
        print(f"| {name} |", " | ".join([*cells, *[""] * (6 - len(cells))]), "|")


if __name__ == "__main__":
    main()
