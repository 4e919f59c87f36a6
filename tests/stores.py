"""Stores for tests of what is made from them, and the small frames they come from."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from benchmarks.faults import InOrder

import planewise as pw
from planewise import scenes
from planewise.batch import Batch, DepthFolder, Recipe, Store
from planewise.files.depth import DepthFile

SIZE = (60, 80)


def write_frames(folder, count, *, rgb=True, size=SIZE):
    """Write archives of depth, picture and camera; one is damaged and one without a reading."""
    folder.mkdir(parents=True)
    for number in range(count):
        room = scenes.room(number, size=size)
        camera = room.camera
        arrays = {"depth": room.depth, "K": [camera.fx, camera.fy, camera.cx, camera.cy]}
        if rgb:
            arrays["rgb"] = room.rgb
        np.savez(folder / f"room {number}.npz", **arrays)
    (folder / "broken.npz").write_bytes(b"none")
    np.savez(folder / "empty.npz", depth=np.zeros(size), K=arrays["K"], rgb=room.rgb)


def make_store(source, path, *, labels="png", engine=None):
    """Fill a store in this process."""
    recipe = Recipe(sensor=pw.sensors.KINECT_V1, options=pw.Options(), labels=labels)
    batch = Batch(source=source, store=path, recipe=recipe)
    with batch.started(engine or InOrder()) as run:
        for _ in run:
            pass
    return Store(path)


def make_folder_store(folder, path, **options):
    """As `make_store`, of a folder."""
    return make_store(DepthFolder(folder), path, **options)


class Sweeps:
    """Range images of a LiDAR, whose camera is no pinhole."""

    name = "sweeps"
    ids = ("sweep",)

    def __getitem__(self, frame):
        street = scenes.street(0)
        return DepthFile(depth=street.depth, camera=street.camera)


class Many:
    """The frames of a folder again and again, under as many ids as are wanted."""

    name = "many"

    def __init__(self, folder, count):
        self._folder = DepthFolder(folder)
        self.ids = tuple(f"{number:05}" for number in range(count))

    def __getitem__(self, frame):
        return self._folder[self._folder.ids[int(frame) % len(self._folder)]]


class Cloning:
    """Engine that does `distinct` frames and gives their results to all others."""

    def __init__(self, distinct):
        self.distinct = distinct

    def run(self, work, frames):
        done = {}
        for number, frame in frames:
            kind = number % self.distinct
            if kind not in done:
                done[kind] = work(number, frame)
            record = json.loads(done[kind].record)
            record["frame"] |= {"frame": frame, "number": number}
            for plane in record["planes"]:
                plane[0] = frame
            yield replace(
                done[kind], number=number, frame=frame, record=json.dumps(record).encode()
            )
