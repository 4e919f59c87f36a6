"""Small files in the formats in which NYU-v2 is passed on."""

import h5py
import numpy as np
from PIL import Image

_HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sat Nov 21 12:00:00 2026 HDF5 schema 1.00"
)


def write_mat(path, frames):
    """The labelled .mat: HDF5 behind 512 bytes of MATLAB's, columns first, compressed.

    Each frame has depth in metres (H, W), rgb (H, W, 3), labels and instances (H, W).
    """
    with h5py.File(path, "w", userblock_size=512) as file:

        def store(name, arrays, dtype):
            # (N, H, W[, 3]) as MATLAB holds (H, W[, 3], N) and HDF5 shows it: (N[, 3], W, H).
            data = np.stack([np.transpose(each) for each in arrays]).astype(dtype)
            size = (1, *data.shape[1:-2], 16, 12)
            stored = file.create_dataset(name, data=data, chunks=size, compression="gzip")
            stored.attrs["MATLAB_class"] = np.bytes_(
                np.dtype(dtype).name.replace("float32", "single")
            )

        store("depths", [each["depth"] for each in frames], np.float32)
        store("rawDepths", [each["raw"] for each in frames], np.float32)
        store("images", [each["rgb"] for each in frames], np.uint8)
        store("labels", [each["classes"] for each in frames], np.uint16)
        store("instances", [each["instances"] for each in frames], np.uint8)
    with path.open("r+b") as stream:
        stream.write(_HEADER.ljust(116) + bytes(8) + b"\x00\x02IM")


def frame(number, size=(48, 64)):
    """Two planes, a hole, and objects that are no planes."""
    rng = np.random.default_rng(number)
    rows, columns = np.indices(size)
    depth = np.where(columns < size[1] // 2, 2.0, 1 / (0.632 - 0.00258 * columns))
    depth += rng.normal(0, 0.002, size)
    raw = depth.copy()
    raw[:5, :7] = 0
    planes = np.where(columns < size[1] // 2, 1, 2)
    planes[rows < 3] = 0
    return {
        "depth": depth,
        "raw": raw,
        "rgb": rng.integers(0, 256, (*size, 3), np.uint8),
        "classes": np.where(rows < 10, 0, 21 + (columns > 20)),
        "instances": np.where(rows < 10, 0, 1 + (rows > 30)),
        "planes": planes,
    }


def write_folder(folder, frames, *, kinds=("rgb", "depth", "gt")):
    """Folder layout: rgb/N.png, depth/N.png in 16-bit millimetres, gt/N.png."""
    for number, each in frames.items():
        pictures = {
            "rgb": each["rgb"],
            "depth": np.round(each["raw"] * 1000).astype(np.uint16),
            "gt": each["planes"].astype(np.uint8),
        }
        for kind in kinds:
            (folder / kind).mkdir(parents=True, exist_ok=True)
            Image.fromarray(pictures[kind]).save(folder / kind / f"{number}.png")


def write_archive(path, each, camera):
    """One frame as .npz with depth, K, rgb and gt."""
    np.savez_compressed(
        path,
        depth=np.round(each["raw"] * 1000).astype(np.uint16),
        depth_scale=0.001,
        K=np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        rgb=each["rgb"],
        gt=each["planes"].astype(np.uint8),
    )
