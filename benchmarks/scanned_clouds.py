"""Planes of clouds with the pattern of a scanner: rings and lines, far apart far off.

python -m benchmarks.scanned_clouds [--seeds 6]

Ground alone is one plane, a hall six; how many are found, least and most of all seeds: before
planes of one sheet were joined and rings paid together, and now.
"""

from __future__ import annotations

from collections.abc import Callable
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.clouds import gaps, model
from planewise.clouds.cloud import Cloud

Array = NDArray[np.float64]

_HALL = np.array([80.0, 50.0, 9.0]), np.array([43.0, 27.0, 1.7])  # its size, and a scanner in it
_HIGHEST = np.radians(-1.5)  # of the rays that see ground


def turning(columns: int, rows: int, lowest: float, highest: float) -> Array:
    """Rays of a scanner on a tripod, (k, 3): a grid of angles in degrees."""
    around, up = np.meshgrid(
        np.radians(np.linspace(0, 360, columns, endpoint=False)),
        np.radians(np.linspace(lowest, highest, rows)),
        indexing="ij",
    )
    x, y = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around)
    return np.stack((x, y, np.sin(up)), axis=-1).reshape(-1, 3)


def ground(rays: Array, height: float, sigma: float, rng: np.random.Generator) -> Array:
    """Level ground below a scanner, which errs along its rays."""
    rays = rays[rays[:, 2] < np.sin(_HIGHEST)]
    return rays * (rng.normal(0, sigma, len(rays)) - height / rays[:, 2])[:, None]


def hall(rays: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Floor, ceiling and walls about a scanner."""
    size, place = _HALL
    with np.errstate(divide="ignore"):
        away = np.abs(np.where(rays > 0, size - place, place) / rays).min(axis=1)
    return np.asarray(rays * (away + rng.normal(0, sigma, len(rays)))[:, None])


def _spinning(name: str) -> Callable[[np.random.Generator], Array]:
    camera = pw.cameras.PRESETS[name]
    assert isinstance(camera, pw.SphericalCamera)
    rays = camera.rays(camera.shape).reshape(-1, 3)
    return lambda rng: ground(rays, 1.8, 0.02, rng)


SCENES: dict[str, tuple[int, float, Callable[[np.random.Generator], Array]]] = {
    "ground, tripod": (
        1,
        0.005,
        lambda rng: ground(turning(1200, 240, -60, -1.5), 2.0, 0.005, rng),
    ),
    "hall, tripod": (6, 0.003, lambda rng: hall(turning(1500, 600, -60, 88), 0.003, rng)),
    "hall, tripod, loud": (6, 0.01, lambda rng: hall(turning(1500, 600, -60, 88), 0.01, rng)),
    **{
        f"ground, {name}": (1, 0.02, _spinning(name))
        for name in ("velodyne-vlp16", "velodyne-hdl64e", "ouster-os1-128", "velodyne-vls128")
    },
}


def apart(
    cloud: Cloud, labels: NDArray[np.uint16], rows: Array, *_: object
) -> tuple[Array, NDArray[np.intp]]:
    """In place of `clouds.joining.joined`: all planes stay as they are."""
    return rows, np.arange(len(rows))


def _counts(points: list[Array], sensor: pw.Sensor) -> str:
    numbers = [len(pw.detect_planes_in_points(each, sensor)) for each in points]
    return " ... ".join(map(str, sorted({min(numbers), max(numbers)})))


def row(name: str, seeds: int) -> tuple[str, ...]:
    """One line of the table."""
    true, sigma, scene = SCENES[name]
    points = [scene(np.random.default_rng(seed)) for seed in range(seeds)]
    cells = []
    for noise in (sigma, "auto"):
        sensor = pw.Sensor(max_depth=100.0, resolution=0.001, noise=noise)
        with (
            patch.object(model, "joined", apart),
            patch.object(gaps, "_MOST_TOGETHER", 0),
        ):
            cells.append(_counts(points, sensor))
        cells.append(_counts(points, sensor))
    return name, f"{len(points[0]):,}", f"{1000 * sigma:g}", str(true), *cells


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=6)
    seeds = parser.parse_args().seeds
    print("| | points | sigma, mm | true | given, before | now | estimated, before | now |")
    print("|---|---|---|---|---|---|---|---|")
    for name in SCENES:
        print(f"| {' | '.join(row(name, seeds))} |", flush=True)


if __name__ == "__main__":
    main()
