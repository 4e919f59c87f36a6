"""Planes at very flat angles, small steps, and smooth surfaces that are one: Markdown tables.

python -m benchmarks.flat_edges [--size WIDTH HEIGHT]

Depth images of relief on a wall 2 m away, by white noise, and of boards before it, by how many
standard deviations of that they stand off: planes found, and the share of the pixels that are not
on a plane of their own; first without the splitting of segments (`spatial.splitting`), then with
it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.spatial import search
from planewise.spatial.cells import Cells
from planewise.spatial.segments import Segments

Array = NDArray[np.float64]
Relief = tuple[Array, Array]

_DISTANCE = 2.0  # metres
_SIGMAS = (0.0005, 0.001, 0.002, 0.004)
_FINE_SIGMAS = (0.0001, 0.0002, 0.0003, 0.0004)
_BEFORE_BOARDS = 0.002
_OFF = (1.0, 1.7, 3.0, 6.0, 12.0)  # standard deviations
_FOCAL = 0.9  # of the width of the image


def _slope(degrees: float) -> float:
    return math.tan(math.radians(degrees))


def edge(x: Array, y: Array, degrees: float) -> Relief:
    """Two walls, by how many degrees the second one turns."""
    return np.maximum(x, 0) * _slope(degrees), np.where(x > 0, 1.0, 0.0)


def facets(x: Array, y: Array, degrees: float) -> Relief:
    """Four strips, every one of which turns from the last."""
    beyond = np.stack([x - at for at in (-0.6, 0.0, 0.6)])
    relief = _slope(degrees) * np.asarray(np.maximum(beyond, 0).sum(axis=0), np.float64)
    return relief, np.count_nonzero(beyond > 0, axis=0).astype(np.float64)


def crossing(x: Array, y: Array, degrees: float) -> Relief:
    """Four planes about a point, as of a floor with a drain."""
    relief = (np.abs(x - 0.2) + np.abs(y - 0.1)) * _slope(degrees)
    return relief, np.where(x > 0.2, 2.0, 0.0) + np.where(y > 0.1, 1.0, 0.0)


def trough(x: Array, y: Array, degrees: float) -> Relief:
    """Three strips, the outer ones of which are parts of other planes."""
    outside = np.maximum(np.abs(x) - 0.3, 0)
    return outside * _slope(degrees), np.where(outside > 0, np.where(x > 0, 1.0, -1.0), 0.0)


def flap(x: Array, y: Array, degrees: float) -> Relief:
    """A wall, and a flap that leans from it: an edge on one side, steps on the others."""
    on = (x > 0) & (y < 0.2)
    return np.where(on, x * _slope(degrees), 0.0), on.astype(float)


def off(on: NDArray[np.bool_], metres: float) -> Relief:
    """What stands off the wall."""
    return np.where(on, metres, 0.0), on.astype(float)


def disc(x: Array, y: Array, metres: float) -> Relief:
    return off(np.hypot(x, y) < 0.3, metres)


def plate(x: Array, y: Array, metres: float) -> Relief:
    return off(np.maximum(np.abs(x), np.abs(y)) < 0.3, metres)


def plates(x: Array, y: Array, metres: float) -> Relief:
    """Two beside each other."""
    return off((np.abs(np.abs(x) - 0.5) < 0.2) & (np.abs(y) < 0.3), metres)


def frame(x: Array, y: Array, metres: float) -> Relief:
    """A frame about a piece of the wall."""
    return off(np.abs(np.maximum(np.abs(x), np.abs(y)) - 0.45) < 0.1, metres)


def boards(x: Array, y: Array, columns: int, rows: int, side: float) -> NDArray[np.bool_]:
    """Where boards are, all on one plane."""
    places = (np.linspace(-0.9, 0.9, columns), np.linspace(-0.6, 0.6, rows))
    near = [
        np.any([np.abs(at - middle) < 0.5 * side for middle in middles], axis=0)
        for at, middles in zip((x, y), places, strict=True)
    ]
    return np.asarray(near[0] & near[1])


EDGES: dict[str, tuple[Callable[..., Relief], float]] = {
    "edge, 3 degrees": (edge, 3.0),
    "edge, 2 degrees": (edge, 2.0),
    "edge, 1.5 degrees": (edge, 1.5),
    "edge, 1 degree": (edge, 1.0),
    "edge, 0.5 degrees": (edge, 0.5),
    "four strips, 1.5 degrees": (facets, 1.5),
    "four strips, 0.7 degrees": (facets, 0.7),
    "four planes about a point, 0.6 degrees": (crossing, 0.6),
    "trough, 1.2 degrees": (trough, 1.2),
    "flap, 1.7 degrees": (flap, 1.7),
}

STEPS: dict[str, tuple[Callable[..., Relief], float]] = {
    "disc, 1.5 mm off": (disc, 0.0015),
    "plate, 1.5 mm off": (plate, 0.0015),
    "two plates, 1.5 mm off": (plates, 0.0015),
    "frame, 1.5 mm off": (frame, 0.0015),
}

BOARDS: dict[str, tuple[int, int, float]] = {
    "four boards of 0.5 m": (2, 2, 0.5),
    "six boards of 0.4 m": (3, 2, 0.4),
    "twenty boards of 0.2 m": (5, 4, 0.2),
    "twenty boards of 0.1 m": (5, 4, 0.1),
}
"""How many side by side and below each other, and their sides in metres."""

SMOOTH: dict[str, Callable[[Array, Array], Array]] = {
    "cylinder, radius 100 m": lambda x, y: x * x / 200,
    "cylinder, radius 300 m": lambda x, y: x * x / 600,
    "sphere, radius 300 m": lambda x, y: (x * x + y * y) / 600,
    "wave of 2 m, 1 mm high": lambda x, y: 0.001 * np.sin(np.pi * x + 1),
    "wave of 2 m, 3 mm high": lambda x, y: 0.003 * np.sin(np.pi * x + 1),
    "wave of 5 m, 3 mm high": lambda x, y: 0.003 * np.sin(0.4 * np.pi * x + 1),
    "swell, 10 mm": lambda x, y: 0.01 * np.exp(-2 * (x * x + y * y)),
}


def camera(size: tuple[int, int]) -> pw.PinholeCamera:
    """Camera of images (H, W) that see about 2.2 m of the wall."""
    height, width = size
    focal = _FOCAL * width
    return pw.PinholeCamera(fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


def wall(size: tuple[int, int]) -> tuple[Array, Array]:
    """Metres to the right of the middle and below it, shapes (H, W)."""
    x, y, _ = np.moveaxis(camera(size).rays(size), -1, 0)
    return _DISTANCE * x, _DISTANCE * y


def found(
    relief: Array, sigma: float, seed: int = 0, *, significance: float = 0.0
) -> pw.PlaneModel:
    """Planes of a relief (H, W) in metres: where it is affine, depth is that of a plane."""
    depth = 1 / (1 / _DISTANCE + relief / _DISTANCE**2)
    depth = depth + np.random.default_rng(seed).normal(0, sigma, depth.shape)
    sensor = pw.Sensor(max_depth=5.0, resolution=1e-4, noise=sigma)
    view = camera((depth.shape[0], depth.shape[1]))
    return pw.detect_planes(depth, view, sensor, significance=significance)


def wrong(labels: NDArray[np.uint16], truth: Array) -> float:
    """Share of the pixels that are not of the plane that most of their label are of."""
    right, number = 0, np.unique(truth, return_inverse=True)[1].reshape(labels.shape)
    for label in range(1, int(labels.max()) + 1):
        right += int(np.bincount(number[labels == label]).max())
    return 1 - right / labels.size


@contextmanager
def unsplit() -> Iterator[None]:
    """Inside the block segments stay as they are."""

    def unchanged(
        cells: Cells, segments: Segments, accepted: NDArray[np.bool_], *_: object
    ) -> tuple[Segments, NDArray[np.bool_]]:
        return segments, np.zeros_like(accepted)

    with patch.object(search, "split", unchanged):
        yield


def _row(relief: Array, truth: Array, sigma: float) -> str:
    model = found(relief, sigma)
    return f"{len(model)} {wrong(model.labels, truth):.3f}"


def _print(name: str, scenes: dict[str, list[tuple[Relief, float]]], columns: list[str]) -> None:
    """Print the table of some scenes, each with reliefs and noises for these columns."""
    print(f"\n| {name} | true | {' | '.join(columns)} |")
    print("|---|---|" + "---|" * len(columns))
    for scene, reliefs in scenes.items():
        cells = []
        for relief, sigma in reliefs:
            with unsplit():
                before = _row(*relief, sigma)
            cells.append(f"{before}, {_row(*relief, sigma)}")
        true = len(np.unique(reliefs[0][0][1]))
        print(f"| {scene} | {true} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480))
    width, height = parser.parse_args().size
    x, y = wall((height, width))
    edges, steps = (
        {name: scene(x, y, much) for name, (scene, much) in scenes.items()}
        for scenes in (EDGES, STEPS)
    )
    smooth = {name: (relief(x, y), np.zeros_like(x)) for name, relief in SMOOTH.items()}
    for name, scenes, sigmas in (
        ("planes", edges, _SIGMAS),
        ("step", steps, _FINE_SIGMAS),
        ("smooth surface", smooth, _SIGMAS),
    ):
        by_noise = {scene: [(each, sigma) for sigma in sigmas] for scene, each in scenes.items()}
        _print(name, by_noise, [f"{1e3 * sigma:g} mm" for sigma in sigmas])
    by_step = {
        name: [(off(boards(x, y, *which), much * _BEFORE_BOARDS), _BEFORE_BOARDS) for much in _OFF]
        for name, which in BOARDS.items()
    }
    _print(f"off by, of {1e3 * _BEFORE_BOARDS:g} mm", by_step, [f"{much:g}" for much in _OFF])


if __name__ == "__main__":
    main()
