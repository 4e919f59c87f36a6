"""Synthetic rooms as other sensors and drivers deliver them: prints a Markdown table.

python -m benchmarks.other_sensors [--rooms N] [--only WORD]

Every room is read in many ways. given: the noise that a data sheet would state; auto:
``noise="auto"``; 1 %: `planewise.Sensor` as it is; calibrated: what `planewise.calibrate` makes of
other rooms. VOI and SC on the true planes of at least 0.25 % of the image, R: share of these that
are found, P: share of what is found that is a flat face of any size. Last in every cell: planes
found, on average.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.simulated import DRIFT, STEP, WHITE, random_walk
from planewise import noise
from planewise.metrics import evaluate
from planewise.scenes.rooms import _arrange, cast, truth

Array = NDArray[np.float64]
Grid = NDArray[np.integer]
FIRST = 200  # seed of the first room
CALIBRATION = range(300, 308)  # seeds of rooms to calibrate on
SMALLEST = 0.0025  # share of the image from which a true plane counts
VGA = (480, 640)
FB = 525 * 0.05  # focal length times baseline of a small stereo camera, in pixels and metres
SUBPIXEL = 0.08  # standard deviation of its disparity
WIDE_FB = 525 * 0.24  # the same of a wide one


@dataclass(frozen=True)
class Exact:
    """What a camera would see without any error: depth, true labels, numbers of flat faces."""

    z: Array
    labels: Grid
    faces: Grid
    rng: np.random.Generator

    def white(self) -> Array:
        """Independent errors of standard deviation 1."""
        return self.rng.standard_normal(self.z.shape)

    def smooth(self, width: float) -> Array:
        """Errors of standard deviation 1 that a Gaussian of so many pixels has smoothed."""
        squared = sum(np.square(np.fft.fftfreq(n)).reshape(shape) for n, shape in
                      zip(self.z.shape, ((-1, 1), (1, -1)), strict=True))  # fmt: skip
        kernel = np.exp(-2 * (np.pi * width) ** 2 * squared)
        field = np.fft.ifft2(np.fft.fft2(self.white()) * kernel).real
        return np.asarray(field / field.std())

    def nearest(self) -> Array:
        """Least depth of the 5 x 5 pixels about every one: stereo fattens what is in front."""
        padded = np.pad(self.z, 2, mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
        return np.asarray(windows.min(axis=(2, 3)))


def camera_of(size: tuple[int, int]) -> pw.PinholeCamera:
    """The same view at every size."""
    height, width = size
    focal = 525.0 * width / 640
    return pw.PinholeCamera(fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


@cache
def exact(seed: int, size: tuple[int, int], distortion: float = 0.0) -> tuple[Array, Grid, Grid]:
    """Depth, labels and flat faces of a room."""
    camera = replace(camera_of(size), distortion=(distortion, 0.0, 0.0, 0.0))
    solids, view = _arrange(np.random.default_rng(seed))
    hit = cast(solids, view, camera, size)
    everywhere = np.ones(size, bool)
    labels, _ = truth(solids, view, hit, everywhere)
    faces, _ = truth(solids, view, hit, everywhere, every_face=True)
    return hit.depth, labels, faces


def flying(z: Array, rng: np.random.Generator) -> Array:
    """Mix the depths on both sides of jumps, in a band of three pixels."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(z, 1, mode="edge"), (3, 3))
    near, far = windows.min(axis=(2, 3)), windows.max(axis=(2, 3))
    share = rng.random(z.shape)
    mixed = (far - near > 0.05 * z) & (rng.random(z.shape) < 0.7)
    return np.where(mixed, share * near + (1 - share) * far, z)


def enlarged(z: Array, size: tuple[int, int]) -> Array:
    """Interpolate linearly between pixels of a coarser image."""
    for axis in (0, 1):
        n, m = size[axis], z.shape[axis]
        place = (np.arange(n) + 0.5) * m / n - 0.5
        lines = np.moveaxis(z, axis, -1).reshape(-1, m)
        z = np.array([np.interp(place, np.arange(m), line) for line in lines])
        z = np.moveaxis(z.reshape(size[0] if axis else -1, n), -1, axis)
    return z


def filled(depth: Array, hole: NDArray[np.bool_]) -> Array:
    """Fill holes from the left, and smooth what was filled."""
    column = np.where(hole, -1, np.arange(depth.shape[1]))
    column = np.maximum.accumulate(column, axis=1)
    out = np.take_along_axis(depth, np.maximum(column, 0), axis=1)
    for _ in range(8):
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(out, 3, mode="edge"), (7, 7))
        out = np.where(hole, windows.mean(axis=(2, 3)), out)
    return out


def kinect(scene: Exact) -> Array:
    """White noise and steps of disparity."""
    w = 1 / np.maximum(scene.z + noise.KINECT(scene.z) * scene.white(), 0.1)
    return np.asarray(1 / (np.round(w / STEP) * STEP))


def kinect_repeated(scene: Exact) -> Array:
    """Every second row and column, each there twice."""
    every = (slice(None, None, 2),) * 2
    own = replace(scene, z=scene.z[every], labels=scene.labels[every], faces=scene.faces[every])
    return np.asarray(np.kron(kinect(own), np.ones((2, 2))))


def kinect_drift(scene: Exact) -> Array:
    """The same with an error that wanders."""
    shape = (scene.z.shape[0], scene.z.shape[1])
    w = 1 / scene.z + WHITE * scene.white() + random_walk(shape, DRIFT, scene.rng)
    return np.asarray(1 / (np.round(np.maximum(w, 0.1) / STEP) * STEP))


def kinect_filled(scene: Exact) -> Array:
    """In-painted where two fifths of the readings were lost, in patches."""
    patches = scene.smooth(6)
    return filled(kinect(scene), patches < np.quantile(patches, 0.4))


def stereo(width: float, fb: float = FB, scale: float = 1.0) -> Callable[[Exact], Array]:
    """Disparities whose error is smooth over some pixels, in steps of 1/32."""

    def read(scene: Exact) -> Array:
        disparity = fb / (scale * scene.nearest()) + SUBPIXEL * scene.smooth(width)
        return np.asarray(fb / np.maximum(np.round(32 * disparity) / 32, 0.4))

    return read


def small_stereo(width: int, height: int, pixels: float) -> Reading:
    """The same stereo camera with so many pixels, its error smooth over as many of them."""
    fb = FB * width / VGA[1]
    sensor = replace(STEREO, noise=noise.Polynomial(quadratic=SUBPIXEL / fb))
    name = f"stereo, {width} x {height}"
    return Reading(name, stereo(pixels, fb), sensor, (height, width))


def time_of_flight(bumps: float) -> Callable[[Exact], Array]:
    """3 mm, mixed pixels at jumps, and bumps of so many metres, 40 pixels wide."""

    def read(scene: Exact) -> Array:
        z = scene.z + 0.003 * scene.white() + bumps * scene.smooth(40)
        return flying(z, scene.rng)

    return read


def coarse(scene: Exact) -> Array:
    """Noise of 3 mm and 0.3 %, linearly interpolated from a fourth of the rows and columns."""
    z = scene.z[2::4, 2::4]
    z = z * (1 + 0.003 * scene.rng.standard_normal(z.shape))
    return enlarged(z + 0.003 * scene.rng.standard_normal(z.shape), VGA)


def millimetres(sigma: float) -> Callable[[Exact], Array]:
    """White noise."""
    return lambda scene: scene.z + 1e-3 * sigma * scene.white()


def steps(step: float, sigma: float = 0.0) -> Callable[[Exact], Array]:
    """White noise, then steps of so many metres: much coarser, as where depth is kept in 8 bits."""
    return lambda scene: np.round((scene.z + sigma * scene.white()) / step) * step


def whole_disparities(scene: Exact) -> Array:
    """Disparities of a wide stereo camera in whole pixels, without noise."""
    return np.asarray(WIDE_FB / np.round(WIDE_FB / scene.z))


@dataclass(frozen=True)
class Reading:
    """A way to read a room: what comes out, and the noise that a data sheet would state.

    wild, missing: shares of the readings, anywhere, in whose place there are depths of 0.3 to 10 m,
    or none.
    """

    name: str
    read: Callable[[Exact], Array]
    sensor: pw.Sensor
    size: tuple[int, int] = VGA
    distortion: float = 0.0
    wild: float = 0.0
    missing: float = 0.0


KINECT = pw.sensors.KINECT_V1
PHONE = pw.Sensor(noise=0.01)  # +-1 cm
STEREO = pw.Sensor(noise=noise.Polynomial(quadratic=SUBPIXEL / FB))
OUTDOOR = pw.Sensor(
    max_depth=150, resolution=0.01, noise=noise.Polynomial(quadratic=SUBPIXEL / 500)
)
PLAIN = ("Kinect", kinect, KINECT), ("5 mm", millimetres(5), pw.Sensor(noise=0.005))
READINGS = (
    Reading("Kinect", kinect, KINECT),
    Reading("Kinect, error that wanders", kinect_drift, KINECT),
    Reading("Kinect, 2/5 in-painted", kinect_filled, KINECT),
    Reading("Kinect, 1920 x 1080", kinect, KINECT, (1080, 1920)),
    Reading("Kinect, 1280 x 720", kinect, KINECT, (720, 1280)),
    Reading("Kinect, 320 x 240", kinect, KINECT, (240, 320)),
    Reading("Kinect, 160 x 120", kinect, KINECT, (120, 160)),
    Reading("Kinect, 320 x 240, repeated twice", kinect_repeated, KINECT),
    Reading("stereo, smooth over 8 px", stereo(3.4), STEREO),
    Reading("stereo, smooth over 14 px", stereo(6.0), STEREO),
    Reading("stereo, smooth over 20 px", stereo(8.5), STEREO),
    small_stereo(848, 480, 3.4),
    small_stereo(640, 360, 3.0),
    small_stereo(424, 240, 2.0),
    Reading("stereo outdoors, 5-60 m", stereo(3.4, 500.0, 10.0), OUTDOOR),
    Reading("time of flight", time_of_flight(0.0), pw.Sensor(noise=0.003)),
    Reading("time of flight, bumps of 1 cm", time_of_flight(0.01), pw.Sensor(noise=0.003)),
    Reading("phone, 256 x 192", millimetres(5), PHONE, (192, 256)),
    Reading("phone, enlarged 4 times", coarse, PHONE),
    Reading("2 mm", millimetres(2), pw.Sensor(noise=0.002)),
    Reading("2 mm, said to be 20 mm", millimetres(2), pw.Sensor(noise=0.02)),
    Reading("10 mm, said to be 1 mm", millimetres(10), pw.Sensor(noise=0.001)),
    Reading("3 mm, k1 = -0.03 left", millimetres(3), pw.Sensor(noise=0.003), distortion=-0.03),
    Reading("2 mm, steps of 20 mm", steps(0.02, 0.002), pw.Sensor(noise=0.002)),
    Reading("no noise, steps of 20 mm", steps(0.02), pw.Sensor(noise=0.001)),
    Reading("no noise, steps of 39 mm", steps(10 / 255), pw.Sensor(noise=0.001)),
    Reading("no noise, steps of a disparity", whole_disparities, pw.Sensor(noise=0.001)),
    *(
        Reading(f"{name}, {round(100 * share)} % wild", read, sensor, wild=share)
        for name, read, sensor in PLAIN
        for share in (0.02, 0.05, 0.08, 0.15, 0.25)
    ),
    *(
        Reading(f"{name}, {round(100 * share)} % missing", read, sensor, missing=share)
        for name, read, sensor in PLAIN
        for share in (0.3, 0.5, 0.6, 0.75, 0.9, 0.95)
    ),
)


def named(name: str) -> Reading:
    """The way to read a room that has this name."""
    return next(each for each in READINGS if each.name == name)


def frame_in_metres(reading: Reading, seed: int) -> tuple[Array, Grid, Grid]:
    """`frame`, in metres whatever its unit."""
    depth, labels, faces = frame(reading, seed)
    return depth * (reading.sensor.resolution if depth.dtype.kind == "u" else 1.0), labels, faces


def frame(reading: Reading, seed: int) -> tuple[NDArray[Any], Grid, Grid]:
    """Depth image, true labels and flat faces."""
    z, labels, faces = exact(seed, reading.size, reading.distortion)
    rng = np.random.default_rng([seed, *reading.name.encode()])
    depth = reading.read(Exact(z, labels, faces, rng))
    if reading.wild:
        wild = rng.random(depth.shape) < reading.wild
        depth = np.where(wild, rng.uniform(0.3, 10, depth.shape), depth)
        labels, faces = (np.where(wild, 0, each) for each in (labels, faces))
    if reading.missing:
        depth = np.where(rng.random(depth.shape) < reading.missing, 0.0, depth)
    depth[depth > reading.sensor.max_depth] = 0
    if reading.sensor.max_depth / reading.sensor.resolution < np.iinfo(np.uint16).max:
        return np.round(depth / reading.sensor.resolution).astype(np.uint16), labels, faces
    return depth, labels, faces


@cache
def calibrated(number: int) -> pw.Sensor:
    """The sensor that other rooms show, read in that way."""
    reading = READINGS[number]
    depths = (frame(reading, seed)[0] for seed in CALIBRATION)
    found = pw.calibrate(depths, camera_of(reading.size), reading.sensor)
    return found.sensor(reading.sensor)


def scored(number: int, seed: int) -> Array:
    """VOI, SC, P, R and planes of a room under every noise, shape (4, 5), read in that way."""
    reading = READINGS[number]
    depth, labels, faces = frame(reading, seed)
    labels, faces = (np.where(depth > 0, each, 0) for each in (labels, faces))
    out = []
    for sensor in (
        reading.sensor,
        replace(reading.sensor, noise="auto", parts=None),
        replace(reading.sensor, noise=noise.proportional(0.01), parts=None),
        calibrated(number),
    ):
        model = pw.detect_planes(depth, camera_of(reading.size), sensor, threads=1)
        out.append(scores(model, labels, faces))
    return np.array(out)


def scores(model: pw.PlaneModel, labels: Grid, faces: Grid) -> list[float]:
    """VOI, SC, P, R and planes."""
    row = evaluate(model.labels, labels, minimum_pixels=max(1, int(SMALLEST * labels.size))).row()
    precision = evaluate(model.labels, faces).row()["precision@0.5"]
    return [row["voi_labelled"], row["sc_labelled"], precision, row["recall@0.5"], len(model)]


def cell(row: Array) -> str:
    """Cell of a table: scores, and planes at the end."""
    return " ".join(f"{x:.2f}" for x in row[:-1]) + f" {row[-1]:.1f}"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--only", default="", help="readings whose name has this in it")
    given = parser.parse_args()
    chosen = [k for k, each in enumerate(READINGS) if given.only in each.name]
    print("| readings | given: VOI, SC, P, R, planes | auto | 1 % | calibrated |")
    print("|---|---|---|---|---|")
    with ProcessPoolExecutor() as workers:
        for number in chosen:
            seeds = range(FIRST, FIRST + given.rooms)
            rows = list(workers.map(scored, [number] * given.rooms, seeds))
            cells = map(cell, np.nanmean(rows, axis=0))
            print(f"| {READINGS[number].name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
