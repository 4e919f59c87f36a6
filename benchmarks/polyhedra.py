"""Rooms full of polyhedra at all angles, read as sensors do: prints a Markdown table.

python -m benchmarks.polyhedra [--rooms N] [--only WORD]

No setting was chosen on these. Every flat face of 400 pixels or more counts; edges of 20 to 60
degrees, as of dodecahedra, pyramids and wedges, are as usual as right angles. Read in some ways of
`benchmarks.other_sensors`, with the noise that a data sheet would state and with noise="auto": VOI
in bits and SC on true faces, P and R at an IoU of 0.5, F1 at 0.8, planes found, and the share of
frames with a VOI above 0.4, in percent.
"""

from __future__ import annotations

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import planewise as pw
from benchmarks.arguments import parser_of
from benchmarks.other_sensors import Exact, Grid, camera_of, named
from planewise.metrics import evaluate

Array = NDArray[np.float64]

NAMES = (
    "2 mm", "10 mm, said to be 1 mm", "Kinect", "Kinect, error that wanders", "time of flight",
    "phone, 256 x 192", "stereo, smooth over 8 px", "stereo, smooth over 14 px",
    "2 mm, steps of 20 mm", "no noise, steps of 20 mm", "no noise, steps of 39 mm",
    "no noise, steps of a disparity",
)  # fmt: skip
COLUMNS = "voi_labelled", "sc_labelled", "precision@0.5", "recall@0.5", "f1@0.8"
FIRST = 500  # seed of the first room
WRONG = 0.4  # bits of VOI: something wide is in pieces, or missing


@dataclass(frozen=True)
class Polyhedron:
    """Points x with normals . x <= distances: a convex body, one face a row.

    Attributes
    ----------
    normals : ndarray, shape (n, 3)
        Of unit length, outwards.
    distances : ndarray, shape (n,)
        From the origin in metres.
    """

    normals: Array
    distances: Array

    def placed(self, turn: Array, size: float, place: Array) -> Polyhedron:
        """The same turned, so many times as large, and moved."""
        normals = self.normals @ turn.T
        return Polyhedron(normals, size * self.distances + normals @ place)

    def crossed(self, rays: Array) -> tuple[Array, Array]:
        """How many rays (k, 3) far the plane of each face is crossed inwards, and outwards: (k, n).

        -inf and inf where it is not.
        """
        along = rays @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = self.distances / along
        return np.where(along < 0, at, -np.inf), np.where(along > 0, at, np.inf)

    def hit(self, rays: Array) -> tuple[Array, NDArray[np.intp]]:
        """How many rays (k, 3) far from the origin each meets it, and at which face."""
        entry, leave = self.crossed(rays)
        first = entry.max(axis=1)
        meets = (first > 0) & (first < leave.min(axis=1))
        return np.where(meets, first, np.inf), entry.argmax(axis=1)


CUBE = np.vstack((np.eye(3), -np.eye(3)))  # its normals


def ring(sides: int, slant: float) -> Array:
    """Normals about the z axis that lean up by so much."""
    angle = 2 * math.pi * np.arange(sides) / sides
    up = np.full(sides, math.sin(slant))
    return np.column_stack((math.cos(slant) * np.cos(angle), math.cos(slant) * np.sin(angle), up))


def prism(rng: np.random.Generator) -> Polyhedron:
    """Prism of three to eight sides."""
    sides = int(rng.integers(3, 9))
    ends = np.array([[0.0, 0, 1], [0, 0, -1]])
    normals = np.vstack((ring(sides, 0.0), ends))
    return Polyhedron(normals, np.append(np.full(sides, 0.7), (1.0, 1.0)))


def pyramid(rng: np.random.Generator) -> Polyhedron:
    """Pyramid of three to six sides."""
    sides = int(rng.integers(3, 7))
    normals = np.vstack((ring(sides, math.atan(0.5)), [[0.0, 0, -1]]))
    return Polyhedron(normals, np.full(sides + 1, 0.5))


def box(rng: np.random.Generator) -> Polyhedron:
    """Box."""
    return Polyhedron(CUBE, np.tile(rng.uniform(0.3, 1.0, 3), 2))


def wedge(rng: np.random.Generator) -> Polyhedron:
    """Box with a top that slopes by 11 to 46 degrees."""
    slope = rng.uniform(0.2, 0.8)
    sides = np.vstack((np.eye(3)[:2], -np.eye(3)))
    normals = np.vstack(([[math.sin(slope), 0.0, math.cos(slope)]], sides))
    return Polyhedron(normals, np.array([0.3, 1, 1, 1, 1, 0.6]))


def dodecahedron(_: np.random.Generator) -> Polyhedron:
    """Twelve pentagons."""
    golden = (1 + math.sqrt(5)) / 2
    one = np.array([[0, s, t * golden] for s in (1, -1) for t in (1, -1)])
    normals = np.vstack([np.roll(one, k, axis=1) for k in range(3)])
    return Polyhedron(normals / math.hypot(1, golden), np.full(12, 0.8))


def boulder(rng: np.random.Generator) -> Polyhedron:
    """Cube that was cut seven to twelve times."""
    cuts = rng.normal(size=(int(rng.integers(7, 13)), 3))
    cuts /= np.linalg.norm(cuts, axis=1, keepdims=True)
    distances = np.append(rng.uniform(0.55, 0.9, len(cuts)), np.ones(6))
    return Polyhedron(np.vstack((cuts, CUBE)), distances)


KINDS = boulder, prism, pyramid, wedge, dodecahedron, box


def faces_of(seed: int, size: tuple[int, int]) -> tuple[Array, Grid]:
    """Exact depth of a room with 6 to 13 polyhedra, and the number of the face in every pixel."""
    rng = np.random.default_rng(seed)
    rays = camera_of(size).rays(size).reshape(-1, 3)
    yaw, pitch = rng.uniform(-0.6, 0.6), rng.uniform(0.05, 0.5)  # of a camera that looks down
    view = Rotation.from_euler("YX", (yaw, pitch)).as_matrix()
    rays = rays @ view.T
    # Walls, floor (y points down), ceiling: the inside of a box about the camera.
    right, left, far = *rng.uniform(1.2, 2.5, 2), rng.uniform(3, 4.5)
    _, ends = Polyhedron(CUBE, np.array((right, 1.3, far, left, 1.2, 1.0))).crossed(rays)
    depth, face, found = ends.min(axis=1), ends.argmin(axis=1), len(CUBE)
    for _ in range(rng.integers(6, 14)):
        shape = KINDS[rng.integers(len(KINDS))](rng)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        ahead = rng.uniform(1.5, 3.2)
        place = ahead * np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.1, 0.45), 1.0]) @ view.T
        at, side = shape.placed(turn, rng.uniform(0.2, 0.55), place).hit(rays)
        nearer = at < depth
        depth[nearer], face[nearer] = at[nearer], found + side[nearer]
        found += len(shape.distances)
    labels = np.unique(face, return_inverse=True)[1].reshape(size) + 1
    return depth.reshape(size), labels.astype(np.uint16)


def scored(name: str, seed: int) -> list[list[float]]:
    """Scores of a room that is read so, with the noise that is stated and with noise="auto".

    Those of `COLUMNS`, planes, and whether VOI is high.
    """
    reading, out = named(name), []
    z, faces = faces_of(seed, reading.size)
    scene = Exact(z, faces, faces, np.random.default_rng([seed, *reading.name.encode()]))
    depth = reading.read(scene)
    for sensor in (reading.sensor, replace(reading.sensor, noise="auto", parts=None)):
        model = pw.detect_planes(depth, camera_of(reading.size), sensor, threads=1)
        row = evaluate(model.labels, faces).row()
        scores = [float(row[name]) for name in COLUMNS]
        out.append([*scores, len(model), scores[0] > WRONG])
    return out


def cell(scores: Array) -> str:
    """Cell of a table."""
    *shares, planes, wrong = scores
    return " ".join(f"{x:.3f}" for x in shares) + f" {planes:.1f} {100 * wrong:.0f}"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--rooms", type=int, default=24)
    parser.add_argument("--only", default="", help="readings whose name has this in it")
    given = parser.parse_args()
    print("| readings | given: VOI, SC, P, R, F1@.8, planes, % above 0.4 | auto |")
    print("|---|---|---|")
    with ProcessPoolExecutor() as workers:
        for name in (each for each in NAMES if given.only in each):
            seeds = range(FIRST, FIRST + given.rooms)
            rows = np.mean(list(workers.map(scored, [name] * given.rooms, seeds)), axis=0)
            print(f"| {name} | {' | '.join(map(cell, rows))} |", flush=True)


if __name__ == "__main__":
    main()
