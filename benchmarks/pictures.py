"""Pictures of docs/method.md, from synthetic frames only.

python -m benchmarks.pictures [--seed 2] [-o docs]

correlated-paper.png and correlated-spatial.png: a room with a Kinect's white noise, steps and
random walk (`benchmarks.simulated`), its planes under the paper's objective and under the spatial
one, both found by the joint search. Prints the paper's Phi of the truth and of both.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.simulated import DRIFT, kinect_room
from planewise.drawing.overlay import draw_labels
from planewise.metrics import evaluate

COLOURS = 40
WIDTH = 400


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--drift", type=float, default=DRIFT, help="1 / m over 100 pixels")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs"))
    given = parser.parse_args()
    frame, scene = kinect_room(given.seed, drift=given.drift)
    rgb = np.asarray(scene.rgb)
    seen = pw.observe(frame.depth, frame.camera, frame.sensor)
    truth = pw.information(seen, scene.planes, scene.labels)
    print(f"{len(scene.planes)} true planes, the paper's Phi {truth:.0f} nats")
    for objective in ("paper", "spatial"):
        model = frame.detect(objective=objective)
        voi = evaluate(model.labels, scene.labels).row()["voi_labelled"]
        phi = pw.information(seen, model.planes, model.labels)
        print(f"{objective}: {len(model)} planes, VOI {voi:.2f} bits, Phi {phi:.0f} nats")
        picture = Image.fromarray(draw_labels(model.labels, rgb))
        height = round(WIDTH * picture.height / picture.width)
        small = picture.resize((WIDTH, height), Image.Resampling.LANCZOS)
        path = given.output / f"correlated-{objective}.png"
        small.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
        print(f"{path}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
