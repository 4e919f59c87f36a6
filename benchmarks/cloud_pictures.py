"""Picture of docs/clouds.md, from a synthetic room only.

python -m benchmarks.cloud_pictures [--seed 3] [-o docs]

clouds.png: the points of one depth image of a room, the planes found in them as free points, and
their outlines.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import planewise as pw
from benchmarks.arguments import parser_of
from planewise.drawing.cloud import draw_cloud

COLOURS = 64
EVERY = 3  # readings of the image that are taken
WIDTH = 1000


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs"))
    given = parser.parse_args()
    room = pw.scenes.room(given.seed)
    seen = pw.observe(room.depth, room.camera, room.sensor).positions()[::EVERY]
    points = seen[:, [0, 2, 1]] * (1, 1, -1)  # z up
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    model = pw.detect_planes_in_points(points, pw.Sensor(max_depth=extent, noise=room.sensor.noise))
    surfaces = pw.outline_points(model, points)
    picture = Image.fromarray(draw_cloud(points, model, surfaces=surfaces))
    height = round(WIDTH * picture.height / picture.width)
    small = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
    path = given.output / "clouds.png"
    # Rare colours are kept, too: the legend has them.
    few = small.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    print(
        f"{len(points):,} points, {len(model)} planes; {path}, {path.stat().st_size / 1000:.0f} kB"
    )


if __name__ == "__main__":
    main()
