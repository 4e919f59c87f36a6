"""Synthetic scenes with exact truth: the paper's test images, rooms, panoramas and streets."""

from planewise.scenes.panoramas import panorama
from planewise.scenes.planar import corner, flatness, staircase, t_junction, two_planes
from planewise.scenes.rooms import room
from planewise.scenes.scene import Scene
from planewise.scenes.streets import street

__all__ = [
    "Scene",
    "corner",
    "flatness",
    "panorama",
    "room",
    "staircase",
    "street",
    "t_junction",
    "two_planes",
]
