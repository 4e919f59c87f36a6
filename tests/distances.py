"""Scenes whose readings are distances from the camera rather than depth along z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np


def lengths(camera, shape):
    """|(u, v, 1)| of all pixels."""
    return np.linalg.norm(np.stack((*camera.directions(shape), np.ones(shape))), axis=0)


def with_distances(scene):
    """A scene of depth whose readings are distances, in metres or in steps of the same size."""
    distance = scene.depth * lengths(scene.camera, scene.depth.shape)
    if scene.depth.dtype.kind != "f":
        distance = np.rint(distance).astype(scene.depth.dtype)
    sensor = replace(scene.sensor, max_depth=2 * scene.sensor.max_depth)
    camera = replace(scene.camera, radial=True)
    return replace(scene, depth=distance, camera=camera, sensor=sensor)
