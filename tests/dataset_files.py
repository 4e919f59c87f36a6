"""Small datasets in the formats in which they are passed on; each writer returns what to open."""

import json
import struct
import zlib
from io import BytesIO

import numpy as np
from PIL import Image

import planewise as pw
from planewise.datasets.nyu_raw import metres

from .nyu_files import frame

CAMERA = pw.PinholeCamera(fx=50, fy=52, cx=31.0, cy=24.5)
COUNT = 3
FRAMES = [frame(n) for n in range(COUNT)]
POSES = [np.block([[np.eye(3), np.array([[n], [2.0], [0.5]])], [0, 0, 0, 1]]) for n in range(COUNT)]


def units(each, scale):
    """Depth of a frame as a file has it, 0 where there is no reading."""
    return np.round(each["raw"] / scale).astype(np.uint16)


def png(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path)


def matrix(path, values):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, values, fmt="%.6f")


def intrinsics():
    k = np.eye(4)
    k[0, 0], k[1, 1], k[0, 2], k[1, 2] = CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy
    return k


def write_tum(root):
    root.mkdir()
    depth, rgb = ["# depth maps", "# timestamp filename"], ["# color images"]
    truth = ["# timestamp tx ty tz qx qy qz qw"]
    for n, each in enumerate(FRAMES):
        time = 1305031102.160407 + n / 30
        png(root / f"depth/{time:.6f}.png", units(each, 1 / 5000))
        png(root / f"rgb/{time + 0.01:.6f}.png", each["rgb"])
        depth.append(f"{time:.6f} depth/{time:.6f}.png")
        rgb.append(f"{time + 0.01:.6f} rgb/{time + 0.01:.6f}.png")
        truth.append(f"{time - 0.002:.4f} {n} 2.0 0.5 0 0 0 1")
    rgb.insert(1, "1305031101.000000 rgb/early.png")  # no depth image is near
    for name, lines in (("depth", depth), ("rgb", rgb), ("groundtruth", truth)):
        (root / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return root


def write_icl(root):
    lines = []
    for n, each in enumerate(FRAMES):
        png(root / f"depth/{n}.png", units(each, 1 / 5000))
        png(root / f"rgb/{n}.png", each["rgb"])
        lines.append(f"{n} depth/{n}.png {n} rgb/{n}.png")
    (root / "associations.txt").write_text("\n".join(lines))
    return root


def write_icl_rendered(root):
    root.mkdir()
    lengths = np.linalg.norm(CAMERA.rays((48, 64)), axis=-1)
    for n, each in enumerate(FRAMES):
        distance = " ".join(f"{value:.6f}" for value in (each["raw"] * lengths).ravel())
        (root / f"scene_00_{n:04d}.depth").write_text(distance + " ")
        (root / f"scene_00_{n:04d}.txt").write_text("cam_pos = [0, 0, 0]';\n")
        png(root / f"scene_00_{n:04d}.png", each["rgb"])
    return root


def write_hypersim(root):
    """Two cameras; what a frame has of depth is its distances."""
    import h5py

    for n, each in enumerate(FRAMES):
        camera, number = ("cam_00", n) if n < 2 else ("cam_01", 0)
        place = root / f"images/scene_{camera}_geometry_hdf5"
        place.mkdir(parents=True, exist_ok=True)
        with h5py.File(place / f"frame.{number:04d}.depth_meters.hdf5", "w") as file:
            distance = np.where(each["raw"] > 0, each["raw"], np.nan).astype(np.float32)
            file.create_dataset("dataset", data=distance, chunks=(16, 16), compression="gzip")
        (place / f"frame.{number:04d}.normal_cam.hdf5").write_bytes(b"not looked at")
        name = f"images/scene_{camera}_final_preview/frame.{number:04d}.tonemap.jpg"
        (root / name).parent.mkdir(exist_ok=True)
        Image.fromarray(each["rgb"]).save(root / name)
    return root


def write_seven_scenes(root):
    for n, each in enumerate(FRAMES):
        depth = units(each, 0.001)
        depth[depth == 0] = 65535
        png(root / f"frame-{n:06d}.depth.png", depth)
        png(root / f"frame-{n:06d}.color.png", each["rgb"])
        matrix(root / f"frame-{n:06d}.pose.txt", POSES[n])
    return root


def write_scannet(root):
    for n, each in enumerate(FRAMES):
        png(root / f"depth/{n}.png", units(each, 0.001))
        png(root / f"color/{n}.png", each["rgb"].repeat(2, 0).repeat(2, 1))
        matrix(root / f"pose/{n}.txt", POSES[n] if n != 1 else np.full((4, 4), -np.inf))
    for name in ("depth", "color"):
        matrix(root / f"intrinsic/intrinsic_{name}.txt", intrinsics())
        matrix(root / f"intrinsic/extrinsic_{name}.txt", np.eye(4))
    return root


def sens_frame(each, pose, number, colour, depth):
    """One frame of a recording; `colour` and `depth` are the codes of their compressions."""
    stream = BytesIO()
    if colour:
        Image.fromarray(each["rgb"]).save(stream, {1: "PNG", 2: "JPEG"}[colour])
    picture = stream.getvalue() if colour else each["rgb"].tobytes()
    readings = units(each, 0.001).tobytes()
    readings = zlib.compress(readings) if depth else readings
    times = (number * 33_000, number * 33_000 + 500)
    head = struct.pack("<16f4Q", *pose.ravel(), *times, len(picture), len(readings))
    return head + picture + readings


def write_sens(path, colour=2, depth=1, frames=None, count=None):
    name = b"StructureSensor"
    matrices = [intrinsics(), np.eye(4), intrinsics(), np.eye(4)]
    parts = [struct.pack("<IQ", 4, len(name)), name, np.array(matrices, "<f4").tobytes()]
    frames = frames or [
        sens_frame(each, POSES[n] if n != 1 else np.full((4, 4), -np.inf), n, colour, depth)
        for n, each in enumerate(FRAMES)
    ]
    count = len(frames) if count is None else count
    parts.append(struct.pack("<iiIIIIfQ", colour, depth, 64, 48, 64, 48, 1000.0, count))
    path.write_bytes(b"".join(parts + frames) + struct.pack("<Q", 0))  # no inertial readings
    return path


def write_redwood(root):
    for n, each in enumerate(FRAMES):
        png(root / f"depth/{n + 1:07d}-{n * 33333:012d}.png", units(each, 0.001))
        (root / "image").mkdir(exist_ok=True)
        Image.fromarray(each["rgb"]).save(root / f"image/{n + 1:07d}-{n * 33333 + 9:012d}.jpg")
    k = intrinsics()[:3, :3].T.ravel().tolist()  # column by column
    camera = {"width": 64, "height": 48, "intrinsic_matrix": k}
    (root / "camera_intrinsic.json").write_text(json.dumps(camera))
    return root


def write_generic(root, **more):
    for n, each in enumerate(FRAMES):
        png(root / f"depth/view {n}.png", units(each, 0.0005))
        png(root / f"rgb/view {n}.png", each["rgb"])
    values = {"fx": 50, "fy": 52, "cx": 31.0, "cy": 24.5, "depth_scale": 0.0005, **more}
    (root / "camera.json").write_text(json.dumps(values))
    return root


def raw_readings(each):
    """Readings of 11 bits that give about the frame's depth; 2047 where there is none."""
    with np.errstate(divide="ignore"):
        codes = np.round(1092.5 - 351.3 / each["raw"])
    return np.where(each["raw"] > 0, codes, 2047).astype(np.uint16)


def raw_metres(each):
    return metres(raw_readings(each))


def write_nyu_raw(root, order="<"):
    root.mkdir()
    for n, each in enumerate(FRAMES):
        time = 1315330262.204702 + n / 30
        header = b"P5 64 48 65535\n"
        readings = raw_readings(each).astype(f"{order}u2").tobytes()
        (root / f"d-{time:.6f}-{2916500311 + n}.pgm").write_bytes(header + readings)
        (root / f"a-{time:.6f}-{2916500311 + n}.dump").write_bytes(bytes(20))
        Image.fromarray(each["rgb"]).save(root / f"r-{time + 0.004:.6f}-{2917500311 + n}.ppm")
    (root / "INDEX.txt").write_text("")
    return root


def sweep(number):
    return np.random.default_rng(number).normal(size=(100 + number, 4)).astype("<f4")


def write_kitti(root):
    (root / "velodyne").mkdir(parents=True)
    for n in range(COUNT):
        sweep(n).tofile(root / f"velodyne/{n:06d}.bin")
    (root / "times.txt").write_text("0.000000e+00\n1.036224e-01\n2.072448e-01\n")
    return root


def expected(kind, each):
    """Depth in metres that a reader of that kind has to give for a frame."""
    if kind == "nyu-raw":
        return raw_metres(each)
    return each["raw"]
