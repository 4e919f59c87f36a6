"""Planes of simulated rooms that a scanner or panoramic camera sees all around it.

python -m benchmarks.panoramas [--rooms N] [--picture FILE]

With --picture, which draws one room, no table. Means over rooms: VOI in bits over pixels with a
true plane, P of planes that are flat faces, R of the true ones from 0.25 % of the pixels on, and
the errors of those found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.drawing.overlay import draw_labels
from planewise.metrics import evaluate

Array = NDArray[np.float64]
Error = Callable[[Array, np.random.Generator], Array]

_FROM = 100  # seeds of rooms on which nothing was looked at
_SHARED = 10.0  # pixels over which the Kinect's error is smooth
_SENSOR = pw.Sensor(max_depth=20.0, resolution=0.001)
_DRAWN, _SIZE = 1, (800, 400)
_UP, _DOWN = 60.0, 60.0  # degrees that a scanner sees which sees no pole


def _kinect(ranges: Array, rng: np.random.Generator) -> Array:
    """White error, and one that near readings share, both growing with the square of the range."""
    smooth: Array = np.empty(ranges.shape)
    noise = rng.standard_normal(ranges.shape)
    ndimage.gaussian_filter(noise, _SHARED, mode=("nearest", "wrap"), output=smooth)
    white = rng.standard_normal(ranges.shape)
    return np.asarray((0.0015 * white + 0.001 * smooth / smooth.std()) * ranges**2)


def _white(share: float) -> Error:
    return lambda ranges, rng: share * ranges * rng.standard_normal(ranges.shape)


_READINGS: tuple[tuple[str, pw.Sensor, Error | None], ...] = (
    ("2 mm", replace(_SENSOR, noise=0.002), None),
    ("2 mm, noise auto", replace(_SENSOR, noise="auto"), None),
    ("1 % of the range", replace(_SENSOR, noise=pw.noise.proportional(0.01)), _white(0.01)),
    ("as a Kinect's", pw.sensors.KINECT_V1, _kinect),
)


def cameras() -> dict[str, pw.SphericalCamera]:
    """Those of the table by name."""
    whole = {f"{rows} x {2 * rows}": pw.SphericalCamera.panorama(rows) for rows in (256, 512, 1024)}
    high = np.array(whole["512 x 1024"].elevation)
    seen = high[(high < _UP) & (high > -_DOWN)]
    part = pw.SphericalCamera.spinning(seen, 1024)
    return {**whole, f"{len(seen)} x 1024, {-_DOWN:.0f} to {_UP:.0f} degrees": part}


def row(
    camera: pw.SphericalCamera, sensor: pw.Sensor, error: Error | None, rooms: int
) -> list[float]:
    """VOI, P, R, planes, true ones, and errors in degrees and millimetres."""
    rows = []
    for seed in range(_FROM, _FROM + rooms):
        sigma = 0.002 if error is None else 1e-6
        scene = pw.scenes.panorama(seed, camera=camera, sigma=sigma)
        faces = pw.scenes.panorama(seed, camera=camera, sigma=sigma, every_face=True).labels
        ranges: Array = 0.001 * scene.depth.astype(np.float64)
        if error is not None:
            ranges = np.round(ranges + error(ranges, np.random.default_rng(seed)), 3)
        model = pw.detect_planes(ranges, camera, sensor)
        truth = evaluate(
            model.labels,
            scene.labels,
            predicted_planes=model.coefficients,
            truth_planes=scene.planes,
            minimum_pixels=0,
        )
        scores, off = truth.row(), truth.errors
        assert off is not None
        precision = evaluate(model.labels, faces).row()["precision@0.5"]
        rows.append(
            [
                scores["voi_labelled"],
                precision,
                scores["recall@0.5"],
                len(model),
                len(scene.planes),
                off.mean_normal,
                1000 * off.mean_distance,
            ]
        )
    return [float(value) for value in np.mean(rows, axis=0)]


def draw(path: Path) -> None:
    """Draw one room, its planes by rank."""
    scene = pw.scenes.panorama(_DRAWN)
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor)
    picture = Image.fromarray(draw_labels(model.labels, np.asarray(scene.rgb)))
    picture.resize(_SIZE, Image.Resampling.LANCZOS).save(path, optimize=True)


def main() -> None:
    """Print a table of the documentation."""
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=10)
    parser.add_argument("--picture", type=Path, metavar="FILE")
    given = parser.parse_args()
    if given.picture:
        draw(given.picture)
        return
    rooms = given.rooms
    print("| pixels | readings err by | VOI | P@.5 | R@.5 | planes | true | deg | mm |")
    print("|---|---|---|---|---|---|---|---|---|")
    for pixels, camera in cameras().items():
        for name, sensor, error in _READINGS:
            voi, precision, recall, planes, true, normal, distance = row(
                camera, sensor, error, rooms
            )
            scores = f"{voi:.3f} | {precision:.2f} | {recall:.2f} | {planes:.1f} | {true:.1f}"
            print(
                f"| {pixels} | {name} | {scores} | {normal:.3f} | {distance:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
