"""Whether planes scatter as much as their covariance says: prints two Markdown tables.

python -m benchmarks.covariance [--data FOLDER] [--draws N]

A wall, and two that meet, are read again and again: the standard deviation of the angle of their
normals, in degrees, found and told. Then the best planes of real frames, cut in two at their middle
row and column: the angle between both halves in degrees, and its size in told standard deviations,
the median of which is 0.83 where what is told is right; with the sensor as it is described, without
the parts of its error, and with noise="auto".
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.frames import DATA, Frame, real
from benchmarks.simulated import DRIFT, WHITE, random_walk

Array = NDArray[np.float64]

_SHAPE = 240, 320
_CAMERA = pw.PinholeCamera(fx=260, fy=260, cx=159.5, cy=119.5)
_SCENES = {
    "a wall": [(0.2, -0.3, -1, 2.2)],
    "two walls": [(0.6, 0.1, -1, 2.4), (-0.7, -0.2, -1, 2.4)],
}
_PLANES = 3  # of a real frame that are cut
_FEWEST = 8_000  # readings of them
_SHARE = 0.7  # of the readings of a half that its plane must have


def across(normal: Array) -> Array:
    """Two directions at right angles to a normal, shape (2, 3)."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    return np.stack((first, np.cross(normal, first)))


def scatter(planes: Array, drift: float, draws: int) -> Iterator[tuple[float, float]]:
    """Standard deviation of the angle of each plane's normal, found and told, in degrees."""
    planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        w = (_CAMERA.rays(_SHAPE) @ planes[:, :3].T / -planes[:, 3]).max(axis=-1)
    detector = pw.Detector(_CAMERA, pw.sensors.KINECT_V1, threads=1)
    off: list[list[Array]] = [[] for _ in planes]
    told: list[list[float]] = [[] for _ in planes]
    for draw in range(draws):
        rng = np.random.default_rng([draw, 1])
        error = WHITE * rng.standard_normal(_SHAPE) + random_walk(_SHAPE, drift, rng)
        for plane in detector(1 / (w + error)).planes[: len(planes)]:
            k = int(np.argmax(planes[:, :3] @ plane.normal))
            both = across(planes[k, :3])
            off[k].append(both @ plane.normal)
            told[k].append(float(np.trace(both @ plane.covariance[:3, :3] @ both.T)))
    for each, variances in zip(off, told, strict=True):
        found = math.sqrt(np.var(each, axis=0, ddof=1).sum())
        yield math.degrees(found), math.degrees(math.sqrt(np.mean(variances)))


def halves(frame: Frame) -> Iterator[tuple[float, float]]:
    """Angle between halves of planes, in degrees and in told standard deviations."""
    labels = frame.detect().labels
    for label in range(1, _PLANES + 1):
        on = labels == label
        if np.count_nonzero(on) < _FEWEST:
            continue
        for axis, at in enumerate(np.nonzero(on)):
            before = np.expand_dims(np.arange(on.shape[axis]) < int(np.median(at)), 1 - axis)
            found = []
            for half in (on & before, on & ~before):
                part = Frame(
                    frame.name,
                    np.where(half, frame.depth, 0).astype(frame.depth.dtype),
                    frame.camera,
                    frame.sensor,
                    frame.depth_scale,
                )
                planes = part.detect().planes[:1]
                found += [p for p in planes if p.count > _SHARE * np.count_nonzero(half)]
            if len(found) == 2:
                one, other = found
                both = across(one.normal)
                angle = both @ (other.normal - one.normal)
                told = both @ (one.covariance + other.covariance)[:3, :3] @ both.T
                size = math.sqrt(angle @ np.linalg.solve(told, angle) / 2)
                yield math.degrees(np.linalg.norm(angle)), size


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--draws", type=int, default=100)
    given = parser.parse_args()
    print("| scene | drift | found | told | told / found |\n|---|---:|---:|---:|---:|")
    for name, planes in _SCENES.items():
        for drift in (0.0, 0.001, DRIFT):
            for found, told in scatter(np.array(planes), drift, given.draws):
                print(f"| {name} | {drift:g} | {found:.4f} | {told:.4f} | {told / found:.2f} |")
    rows: dict[str, tuple[list[tuple[float, float]], ...]] = {}
    for frame in real(given.data):
        row = rows.setdefault(frame.name.partition("/")[0], ([], [], []))
        plain = replace(frame.sensor, parts=None)
        for sensor, pairs in zip(
            (frame.sensor, plain, replace(plain, noise="auto")), row, strict=True
        ):
            pairs.extend(halves(replace(frame, sensor=sensor)))
    print("\n| frames | pairs | angle | described | no parts | auto |\n|" + "---|" + "---:|" * 5)
    for name, row in rows.items():
        angle, *sizes = np.median(row[0], axis=0)[0], *(np.median(each, axis=0)[1] for each in row)
        print(f"| `{name}` | {len(row[0])} | {' | '.join(f'{x:.2f}' for x in (angle, *sizes))} |")


if __name__ == "__main__":
    main()
