"""Synthetic rooms as a Kinect sees them, by ray casting, with true planes.

World frame: x right, y into the room, z up, floor at z = 0, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planewise import noise, sensors
from planewise.arguments import checked_seed, checked_shape
from planewise.camera import Camera, PinholeCamera
from planewise.scenes.furniture import Block, Can, Room, Solid, furnish, turned
from planewise.scenes.scene import Scene, Seed

Array = NDArray[np.float64]

_FEWEST, _MOST = 8, 21  # planes of a room
_SMALLEST = 0.0025  # share of the image from which a face counts as a plane
_PREVIEW = (60, 80)
_ATTEMPTS = 200

# Kinect v1: focal length of 580 px and baseline of 75 mm, disparity in eighths of a pixel.
_FOCAL, _BASELINE, _STEPS = 580.0, 0.075, 8
_GRAZING = 0.10  # cosine of incidence below which the pattern is not found


@dataclass(frozen=True, kw_only=True)
class View:
    """Where the camera stands: columns of `rotation` are its axes x, y, z in the world."""

    position: Array
    rotation: Array


def room(
    seed: Seed = 0,
    *,
    sigma: float | None = None,
    size: tuple[int, int] = (480, 640),
    holes: bool = True,
    every_face: bool = False,
) -> Scene:
    """Furnished room with walls, boxes, a table and clutter, seen by a Kinect.

    Parameters
    ----------
    seed : int or numpy.random.Generator
        Every seed is another room, with 8 to 21 planes in view.
    sigma : float, optional
        Standard deviation of the white noise in metres at every depth; ``None`` means the Kinect's
        (`planewise.noise.KINECT`). Whatever it is, readings then fall into the Kinect's steps of
        disparity, 3 mm apart at 1 m and 72 mm at 5 m, and are rounded to millimetres.
    size : (height, width)
        Pixels; the camera has the same view at every size of the same proportions.
    holes : bool
        Leave out the readings that a Kinect loses: in the shadow of its projector, at grazing
        incidence, on a few dark blotches.
    every_face : bool
        Label every flat face in view, however small; table legs and tops of cylinders, too.

    Returns
    -------
    Scene
        Faces that cover less than 0.25 % of the image, table legs, spheres and cylinders are
        clutter: label 0. With `every_face` only what is curved is. The noise and the resolution of
        its sensor leave the Kinect's steps out.
    """
    if sigma is not None and not (math.isfinite(sigma) and sigma > 0):
        raise ValueError(f"sigma must be a positive number of metres, got {sigma}")
    rng = np.random.default_rng(checked_seed("seed", seed))
    solids, view = _arrange(rng)
    camera = _camera(size)
    hit = cast(solids, view, camera, size)
    lamp = _lamp(solids)
    rgb = _picture(solids, view, camera, size, hit, lamp, rng)
    lost = np.zeros(size, bool)
    if holes:
        lost = _shadowed(hit.depth, camera) | (hit.cosine < _GRAZING) | _blotches(size, rng)
    labels, planes = truth(solids, view, hit, ~lost, every_face)

    noise_model = noise.KINECT if sigma is None else noise.constant(sigma)
    z = hit.depth + noise_model(hit.depth) * rng.standard_normal(size)
    step = 1 / (_STEPS * _FOCAL * _BASELINE)
    z = 1 / (np.round(1 / np.maximum(z, 0.1) / step) * step)
    sensor = replace(
        sensors.KINECT_V1,
        noise=noise_model,
        parts=sensors.KINECT_V1.parts if sigma is None else None,
    )
    depth = np.round(z / sensor.resolution).astype(np.uint16)
    depth[lost] = 0
    return Scene(depth=depth, camera=camera, sensor=sensor, labels=labels, planes=planes, rgb=rgb)


def _camera(size: tuple[int, int]) -> PinholeCamera:
    height, width = checked_shape("size", size)
    focal = 525.0 * width / 640
    return PinholeCamera(fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


def _arrange(rng: np.random.Generator) -> tuple[list[Solid], View]:
    """Furnish rooms until one shows a fair number of planes, judged on a small preview."""
    camera = _camera(_PREVIEW)
    for _ in range(_ATTEMPTS):
        solids = furnish(rng)
        view = _stand(solids[0], rng)
        hit = cast(solids, view, camera, _PREVIEW)
        _, planes = truth(solids, view, hit, np.ones(_PREVIEW, bool))
        if _FEWEST <= len(planes) <= _MOST and hit.depth.min() > 0.7:
            return solids, view
    raise AssertionError("no room with a fair number of planes")  # pragma: no cover


def _stand(walls: Solid, rng: np.random.Generator) -> View:
    """Put the camera by the near wall, at eye height, looking into the room and down."""
    half = walls.half
    position = np.array(
        (rng.uniform(-0.5, 0.5) * half[0], rng.uniform(0.3, 0.7), rng.uniform(1.35, 1.8))
    )
    target = np.array((rng.uniform(-0.25, 0.25) * half[0], half[1] * 1.2, rng.uniform(0.4, 0.8)))
    forward = target - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    roll = math.radians(rng.uniform(-3, 3))
    down = np.cross(forward, right)
    x = math.cos(roll) * right + math.sin(roll) * down
    return View(position=position, rotation=np.column_stack((x, np.cross(forward, x), forward)))


@dataclass(frozen=True, kw_only=True)
class Hits:
    """First surface on every ray: which face of which solid, how far, and at what incidence."""

    solid: NDArray[np.intp]
    face: NDArray[np.intp]
    depth: Array
    normal: Array
    cosine: Array


def cast(solids: list[Solid], view: View, camera: Camera, size: tuple[int, int]) -> Hits:
    """First surface on the ray of every pixel; every ray has to meet one."""
    rays = _rays(view, camera, size)
    origin = np.broadcast_to(view.position, rays.shape)
    depth = np.full(len(rays), np.inf)
    solid = np.zeros(len(rays), np.intp)
    face = np.zeros(len(rays), np.intp)
    for number, thing in enumerate(solids):
        near = _in_view(thing, view, camera, size)
        t, side = thing.hit(origin[near], rays[near])
        closer = t < depth[near]
        at = near[closer]
        depth[at], solid[at], face[at] = t[closer], number, side[closer]
    normal = np.empty_like(rays)
    for number in np.unique(solid):
        at = solid == number
        points = view.position + depth[at, None] * rays[at]
        normal[at] = solids[number].normal(points, face[at])
    cosine = -np.einsum("ij,ij->i", normal, rays) / np.linalg.norm(rays, axis=1)
    return Hits(
        solid=solid.reshape(size),
        face=face.reshape(size),
        depth=depth.reshape(size),
        normal=normal.reshape(*size, 3),
        cosine=cosine.reshape(size),
    )


def _rays(view: View, camera: Camera, size: tuple[int, int]) -> Array:
    """Ray of every pixel in the world, shape (k, 3)."""
    return np.ascontiguousarray(turned(camera.rays(size).reshape(-1, 3), view.rotation.T).T)


def _in_view(thing: Solid, view: View, camera: Camera, size: tuple[int, int]) -> NDArray[np.intp]:
    """Flat indices of the pixels whose rays can meet the solid."""
    height, width = size
    if not isinstance(camera, PinholeCamera):
        return np.arange(height * width)
    seen = (thing.corners() - view.position) @ view.rotation
    if isinstance(thing, Room) or seen[:, 2].min() < 0.05:
        return np.arange(height * width)
    xy = camera.project(seen)
    left, top = np.clip(np.floor(xy.min(axis=0)), 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(xy.max(axis=0)) + 1, 0, (width, height)).astype(int)
    flat = np.arange(top, bottom)[:, None] * width + np.arange(left, right)
    return flat.reshape(-1)


def truth(
    solids: list[Solid],
    view: View,
    hit: Hits,
    seen: NDArray[np.bool_],
    every_face: bool = False,
) -> tuple[NDArray[np.uint16], Array]:
    """Label the flat faces, or those that count, largest first; planes in the camera frame."""
    faces = np.where(seen, hit.solid * 6 + hit.face, -1)
    numbers, counts = np.unique(faces[seen], return_counts=True)
    order = np.argsort(-counts, kind="stable")
    labels = np.zeros(faces.shape, np.uint16)
    planes: list[Array] = []
    for number, count in zip(numbers[order], counts[order], strict=True):
        thing, face = solids[number // 6], int(number % 6)
        flat = isinstance(thing, Block) or (isinstance(thing, Can) and face == Can.TOP)
        counts_as_plane = not thing.clutter and count >= _SMALLEST * faces.size
        if not flat or not (every_face or counts_as_plane):
            continue
        at = faces == number
        normal = hit.normal[at][0]
        distance = normal @ (view.position - thing.face_point(face))
        planes.append(np.append(normal @ view.rotation, distance))
        labels[at] = len(planes)
    return labels, np.array(planes).reshape(-1, 4)


def _lamp(solids: list[Solid]) -> Array:
    half = solids[0].half
    return np.array((-0.35 * half[0], 0.7 * half[1], 2 * half[2] - 0.25))


def _picture(
    solids: list[Solid],
    view: View,
    camera: PinholeCamera,
    size: tuple[int, int],
    hit: Hits,
    lamp: Array,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Paint the scene: one lamp with cast shadows, some light from everywhere."""
    rays = _rays(view, camera, size)
    points = view.position + hit.depth.reshape(-1, 1) * rays
    normal = hit.normal.reshape(-1, 3)
    colour = np.empty_like(points)
    for number in np.unique(hit.solid):
        at = (hit.solid == number).ravel()
        colour[at] = solids[number].paint(points[at], hit.face.ravel()[at])
    to_lamp = lamp - points
    distance = np.linalg.norm(to_lamp, axis=1)
    facing = np.clip(np.einsum("ij,ij->i", normal, to_lamp) / distance, 0, 1)
    lit = np.ones(len(points), bool)
    start = points + 1e-3 * normal
    for thing in solids[1:]:
        t, _ = thing.hit(start, to_lamp)
        lit &= ~(t < 1)
    sky = 0.5 + 0.5 * normal[:, 2]
    light = (
        0.30 + 0.16 * sky + 0.75 * facing * np.where(lit, 1.0, 0.25) / (0.6 + 0.12 * distance**2)
    )
    shade = (colour * light[:, None]).reshape(*size, 3)
    shade += rng.normal(0, 0.012, shade.shape)
    return np.asarray(255 * np.clip(shade, 0, 1) ** (1 / 1.8)).astype(np.uint8)


def _shadowed(depth: Array, camera: PinholeCamera) -> NDArray[np.bool_]:
    """Pixels that the projector, a baseline to the right of the camera, does not reach.

    Along a row, places in the projector's image are x - f b / z; what lies behind a nearer surface
    further right has a larger place than that surface.
    """
    place = np.arange(depth.shape[1]) - camera.fx * _BASELINE / depth
    nearest = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(place > nearest + 0.5)


def _blotches(size: tuple[int, int], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw a few patches without readings, with ragged borders, about 1 % of the image."""
    height, width = size
    y, x = np.mgrid[:height, :width] / height
    out = np.zeros(size, bool)
    for _ in range(rng.integers(2, 6)):
        cx, cy, radius = rng.uniform(0, width / height), rng.uniform(0, 1), rng.uniform(0.02, 0.05)
        angle = np.arctan2(y - cy, x - cx)
        waves = sum(
            rng.uniform(0, 0.3) * np.sin(k * angle + rng.uniform(0, 2 * np.pi))
            for k in (2, 3, 5, 9)
        )
        out |= np.hypot(x - cx, (y - cy) * rng.uniform(1, 2)) < radius * (1 + waves)
    return out
