"""Small bags of ROS 1, ROS 2 and MCAP, with depth images, their camera, and points."""

import struct
from io import BytesIO

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from .dataset_files import CAMERA, FRAMES, sweep, units

DEPTH, INFO = "/camera/depth/image_raw", "/camera/depth/camera_info"
POINTS = "/lidar/points"
START = 1_700_000_000_000_000_000
FORMS = ("bag", "bag-bz2", "bag-lz4", "db3", "db3-message", "mcap", "mcap-zstd")
STEP = 33_333_333  # nanoseconds


class Messages:
    """Messages of ROS 1 or 2, which differ in a header's number and the letters of a camera."""

    def __init__(self, ros1):
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)

    def make(self, name, **fields):
        return self.store.types[f"sensor_msgs/msg/{name}"](**fields)

    def header(self, number):
        seconds, nanoseconds = divmod(START + number * STEP, 10**9)
        stamp = self.store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        more = {"seq": number} if self.ros1 else {}
        return self.store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera", **more)

    def bytes(self, message):
        name = message.__msgtype__
        if self.ros1:
            return bytes(self.store.serialize_ros1(message, name))
        return bytes(self.store.serialize_cdr(message, name))

    def image(self, number, depth, padding=0, big=False):
        """16UC1 of integers, 32FC1 of floats, with rows longer than they need to be."""
        kind = np.dtype((">" if big else "<") + ("u2" if depth.dtype.kind == "u" else "f4"))
        rows = depth.astype(kind).view(np.uint8).reshape(len(depth), -1)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        return self.make(
            "Image",
            header=self.header(number),
            height=depth.shape[0],
            width=depth.shape[1],
            encoding="16UC1" if depth.dtype.kind == "u" else "32FC1",
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, number, depth, form=None):
        """compressedDepth as its transport writes it: a head of 12 bytes, then a PNG."""
        if depth.dtype.kind == "f":
            scale, offset = 400.0, -1.0
            with np.errstate(divide="ignore"):
                codes = np.where(depth > 0, scale / depth + offset, 0).round().astype(np.uint16)
            form = form or "32FC1; compressedDepth png"
        else:
            scale, offset, codes = 0.0, 0.0, depth
            form = form or "16UC1; compressedDepth"
        stream = BytesIO()
        Image.fromarray(codes).save(stream, "PNG")
        data = struct.pack("<i2f", 0, scale, offset) + stream.getvalue()
        data = np.frombuffer(data, np.uint8)
        return self.make("CompressedImage", header=self.header(number), format=form, data=data)

    def info(self, number=0, distortion=(), fx=CAMERA.fx, binning=0):
        k = np.array([fx, 0, CAMERA.cx, 0, CAMERA.fy, CAMERA.cy, 0, 0, 1])
        p = np.array([60, 0, 30, 0, 0, 61, 20, 0, 0, 0, 1, 0.0])
        roi = self.make(
            "RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        matrices = {"d": np.array(distortion, np.float64), "k": k, "r": np.eye(3).ravel(), "p": p}
        if self.ros1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        return self.make(
            "CameraInfo",
            header=self.header(number),
            height=48,
            width=64,
            distortion_model="plumb_bob",
            binning_x=binning,
            binning_y=binning,
            roi=roi,
            **matrices,
        )

    def cloud(self, number, names=("x", "y", "z", "intensity"), width=None):
        rows = sweep(number)
        point = self.store.types["sensor_msgs/msg/PointField"]
        fields = [
            point(name=name, offset=4 + 4 * n, datatype=7, count=1) for n, name in enumerate(names)
        ]
        table = np.pad(rows.view(np.uint8).reshape(len(rows), -1), ((0, 0), (4, 4)))
        return self.make(
            "PointCloud2",
            header=self.header(number),
            height=1,
            width=len(rows) if width is None else width,
            fields=fields,
            is_bigendian=False,
            point_step=24,
            row_step=24 * len(rows),
            data=table.ravel(),
            is_dense=True,
        )


def frames(messages, topic=DEPTH, compressed=False, metres=False):
    """Depth images of all frames with the times at which they were recorded."""
    make = messages.compressed if compressed else messages.image
    for n, each in enumerate(FRAMES):
        depth = each["raw"].astype(np.float32) if metres else units(each, 0.001)
        yield topic, START + n * STEP + 1000, make(n, depth)


def write_bag(root, form, contents, chunk=None):
    """Write a bag of some form; `contents` gives (topic, time, message) of a `Messages`."""
    messages = Messages(form.startswith("bag"))
    items = sorted(contents(messages), key=lambda item: item[1])
    if messages.ros1:
        path = root.with_suffix(".bag")
        writer = Writer1(path)
        if chunk is not None:
            writer.chunk_threshold = chunk
        if form != "bag":
            writer.set_compression(Writer1.CompressionFormat[form.removeprefix("bag-").upper()])
    else:
        path = root
        plugin = StoragePlugin.MCAP if form.startswith("mcap") else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=plugin)
        mode = {"message": "MESSAGE", "file": "FILE", "zstd": "STORAGE"}.get(form.partition("-")[2])
        if mode:
            writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, time, message in items:
            kind = message.__msgtype__
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=messages.store)
            writer.write(topics[topic], time, messages.bytes(message))
    return path
