"""Rooms as sensors with a periodic error read them, with and without what takes it off: Markdown.

python -m benchmarks.waves [--rooms N] [--picture FILE]

Wiggling of time of flight, an error that is periodic in range, and pixel locking of stereo, which
is periodic in disparity (`planewise.waves`). VOI on the true planes of at least 0.25 % of the
image, P: share of what is found that is a flat face of any size, R: share of the true planes that
are found, and planes found. First where frames are searched as they are; then as they are searched;
then with the sensor that `planewise.calibrate` makes of other rooms. With --picture no table: one
room, without and with.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.other_sensors import FB, FIRST, VGA, Exact, camera_of, cell, exact, scores
from planewise.calibration import frame_noise
from planewise.drawing.overlay import draw_small
from planewise.waves import Wave, Waves

Array = NDArray[np.float64]
Read = Callable[[Exact], Array]
_SENSOR = pw.Sensor(noise="auto")
_CALIBRATED = 12  # rooms
_DRAWN, _ROOM = "2 mm, wave of 5 mm every 0.5 m", FIRST + 5
_HEIGHT, _BETWEEN = 300, 12  # pixels
_CAMERA = camera_of(VGA)


def wiggling(*waves: tuple[float, float], sigma: float = 0.002) -> Read:
    """Time of flight: waves of so many metres that come again after so many; white noise."""
    rays = np.linalg.norm(_CAMERA.ray_rows(VGA), axis=0).reshape(VGA)
    error = Waves("range", tuple(Wave(period, high, k) for k, (high, period) in enumerate(waves)))

    def read(scene: Exact) -> Array:
        true = scene.z * rays
        return np.asarray((true + error.error(true)) / rays + sigma * scene.white())

    return read


def locking(pixels: float, sigma: float, *, second: float = 0.0, smooth: float = 0.0) -> Read:
    """Stereo: disparities that lean towards whole pixels; noise, white or smooth over pixels.

    second: size of the second harmonic against the first one.
    """

    def read(scene: Exact) -> Array:
        d = FB / scene.z
        error = np.sin(2 * np.pi * d) - second * np.sin(4 * np.pi * d)
        noise = scene.smooth(smooth) if smooth else scene.white()
        return np.asarray(FB / (d + pixels * error + sigma * noise))

    return read


READINGS = {
    "2 mm": wiggling((0.0, 1.0)),
    "2 mm, wave of 1 mm every 0.75 m": wiggling((0.001, 0.75)),
    "2 mm, wave of 3 mm every 0.75 m": wiggling((0.003, 0.75)),
    "2 mm, wave of 5 mm every 0.5 m": wiggling((0.005, 0.5)),
    "2 mm, waves of 3 and 4 mm": wiggling((0.003, 0.4), (0.004, 0.93)),
    "5 mm, wave of 5 mm every 0.75 m": wiggling((0.005, 0.75), sigma=0.005),
    "2 mm, wave of 10 mm every 1.5 m": wiggling((0.01, 1.5)),
    "stereo, 0.03 px": locking(0.0, 0.03),
    "stereo, 0.03 px, locking of 0.03 px": locking(0.03, 0.03),
    "stereo, 0.03 px, locking of 0.08 px": locking(0.08, 0.03),
    "stereo, 0.05 px, locking that is no sine": locking(0.05, 0.05, second=0.35),
    "stereo, 0.03 px, smooth over 4 px, locking of 0.05 px": locking(0.05, 0.03, smooth=1.5),
}


def frame(read: Read, seed: int) -> tuple[Array, NDArray[np.integer], NDArray[np.integer]]:
    """Depth in millimetres, labels and flat faces of a room."""
    z, labels, faces = exact(seed, VGA)
    depth = read(Exact(z, labels, faces, np.random.default_rng(seed)))
    return np.round(depth, 3), labels, faces


def scored(read: Read, seed: int, sensor: pw.Sensor) -> list[float]:
    """VOI, P, R and planes of a room."""
    depth, labels, faces = frame(read, seed)
    model = pw.detect_planes(depth, _CAMERA, sensor)
    voi, _, *others = scores(model, labels, faces)
    return [voi, *others]


def unaware() -> AbstractContextManager[object]:
    """Nothing is taken off."""
    return patch.object(frame_noise, "waves_of", lambda _: None)


def draw(path: Path) -> None:
    """Draw the planes of one room, by rank, over the relief that is read."""
    depth, _, _ = frame(READINGS[_DRAWN], _ROOM)
    with unaware():
        models = [pw.detect_planes(depth, _CAMERA, _SENSOR)]
    models.append(pw.detect_planes(depth, _CAMERA, _SENSOR))
    drawn = [draw_small(each.labels, VGA[0], depth=depth, camera=_CAMERA) for each in models]
    white = np.full((VGA[0], _BETWEEN, 3), 255, np.uint8)
    picture = Image.fromarray(np.concatenate((drawn[0], white, drawn[1]), axis=1))
    size = picture.width * _HEIGHT // picture.height, _HEIGHT
    picture.resize(size, Image.Resampling.LANCZOS).save(path, optimize=True)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--picture", type=Path, metavar="FILE")
    given = parser.parse_args()
    if given.picture:
        draw(given.picture)
        return
    rooms = range(FIRST, FIRST + given.rooms)
    others = range(rooms.stop, rooms.stop + _CALIBRATED)
    print("| readings | without: VOI, P, R, planes | with | calibrated |\n|---|---|---|---|")
    for name, read in READINGS.items():
        calibrated = pw.calibrate((frame(read, seed)[0] for seed in others), _CAMERA, _SENSOR)
        with unaware():
            without = [scored(read, seed, _SENSOR) for seed in rooms]
        found = [scored(read, seed, _SENSOR) for seed in rooms]
        known = [scored(read, seed, calibrated.sensor(_SENSOR)) for seed in rooms]
        cells = (cell(np.mean(rows, axis=0)) for rows in (without, found, known))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
