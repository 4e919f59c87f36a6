"""Frames to measure on: synthetic rooms, and real frames where a folder of them is at hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from planewise import scenes

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
ABW = pw.Sensor(
    max_depth=2.0, resolution=0.001, noise=pw.noise.constant(0.0003)
)  # structured light
KINECT_SETS = ("nyu_dpd", "nyu_mm", "mosd_boxes", "mosd_curved", "kinect_7scenes", "rgbd_misc")


@dataclass(frozen=True)
class Frame:
    """One depth image and what took it."""

    name: str
    depth: NDArray[np.generic]
    camera: pw.Camera
    sensor: pw.Sensor
    depth_scale: float | None = None

    def detect(self, **options: object) -> pw.PlaneModel:
        """Run the detector on the frame."""
        return pw.detect_planes(
            self.depth,
            self.camera,
            self.sensor,
            depth_scale=self.depth_scale,
            **options,  # type: ignore[arg-type]
        )


def rooms(count: int) -> Iterator[Frame]:
    """Synthetic rooms, seeds 0, 1 ..."""
    for seed in range(count):
        scene = scenes.room(seed)
        yield Frame(f"room/{seed}", scene.depth, scene.camera, scene.sensor)


def real(folder: Path = DATA) -> Iterator[Frame]:
    """Real frames (npz with depth, depth_scale, K) of all sets in a folder."""
    for name in (*KINECT_SETS, "abw_segcomp"):
        for path in sorted((folder / name).glob("*.npz")):
            with np.load(path) as arrays:
                yield frame_of(path, arrays)


def frame_of(path: Path, arrays: Mapping[str, NDArray[Any]]) -> Frame:
    """Real frame of a file's arrays; the folder says which set it is of."""
    name = path.parent.name
    fx, fy, cx, cy = arrays["K"].tolist()
    return Frame(
        f"{name}/{path.stem}",
        arrays["depth"],
        pw.PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy),
        ABW if name == "abw_segcomp" else pw.sensors.KINECT_V1,
        float(arrays["depth_scale"]),
    )
