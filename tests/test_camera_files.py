from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from planewise import cameras, noise, sensors
from planewise.camera import PinholeCamera
from planewise.errors import PlanewiseError
from planewise.files.camera import read_camera, read_length, read_noise, read_sensor

ROS_FILE = """
image_width: 640
image_height: 480
camera_name: depth
camera_matrix:
  rows: 3
  cols: 3
  data: [525.5, 0., 319.5, 0., 526.5, 239.5, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0.001, 0.002, 0.05]
"""
ROS_ECHO = """header:
  seq: 1
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [525.5, 0.0, 319.5, 0.0, 526.5, 239.5, 0.0, 0.0, 1.0]
---
"""
OPENCV = """%YAML:1.0
---
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 525.5, 0., 319.5, 0., 526.5, 239.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ 0.1, -0.2, 0.001, 0.002 ]
"""
MATRIX = [[525.5, 0, 319.5], [0, 526.5, 239.5], [0, 0, 1]]
NUMBERS = {"fx": 525.5, "fy": 526.5, "cx": 319.5, "cy": 239.5}


def write(tmp_path, content, name="camera.json"):
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return str(path)


def is_right(camera):
    return (camera.fx, camera.fy, camera.cx, camera.cy) == (525.5, 526.5, 319.5, 239.5)


def test_presets_and_numbers():
    assert read_camera("nyu") == cameras.NYU
    assert read_camera("Kinect-V1") == cameras.KINECT_V1
    assert is_right(read_camera("525.5, 526.5,319.5,239.5"))


@pytest.mark.parametrize(
    "content",
    [
        NUMBERS,
        {"camera": NUMBERS},
        {"intrinsics": NUMBERS},
        {"intrinsics": list(NUMBERS.values())},
        {"K": MATRIX},
        {"camera_matrix": MATRIX},
        {"intrinsic_matrix": np.array(MATRIX).T.ravel().tolist()},  # Open3D: by columns
        {"fx": 525.5, "fy": 526.5, "ppx": 319.5, "ppy": 239.5, "model": "distortion.none"},
        {"K": MATRIX, "D": [0] * 8, "distortion_model": "rational_polynomial"},
        {"K": MATRIX, "coeffs": [0] * 5, "model": "distortion.inverse_brown_conrady"},
        {"K": MATRIX, "coeffs": [0] * 5, "distortion": "Brown Conrady"},
        {"K": MATRIX, "coeffs": "0  0\t0 0 0", "Distortion": "Inverse Brown Conrady"},
        {"K": MATRIX, "coeffs": [0] * 5, "model": 0},
        {"K": MATRIX, "coeffs": [0] * 5, "model": 2},
        {"K": MATRIX, "coeffs": [0] * 5, "model": 4},
    ],
)
def test_json_of_many_makers(tmp_path, content):
    camera = read_camera(write(tmp_path, content))
    assert is_right(camera)
    assert not any(camera.distortion)


@pytest.mark.parametrize("text", [ROS_FILE, ROS_ECHO, OPENCV])
def test_yaml_of_many_makers(tmp_path, text):
    camera = read_camera(write(tmp_path, text, "camera.yaml"))
    assert is_right(camera)
    assert (camera.width, camera.height) == ((None, None) if text is OPENCV else (640, 480))
    if text is not ROS_ECHO:
        assert camera.distortion[:4] == (0.1, -0.2, 0.001, 0.002)


COEFFICIENTS = (-0.2, 0.05, 0.001, -0.002)
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [525.5, 526.5, 319.5, 239.5]
  distortion_model: radtan
  distortion_coeffs: [-0.2, 0.05, 0.001, -0.002]
  resolution: [640, 480]
  rostopic: /camera/depth
"""


def test_a_camera_of_kalibr(tmp_path):
    camera = read_camera(write(tmp_path, KALIBR, "camchain.yaml"))
    assert is_right(camera)
    assert (camera.width, camera.height, camera.distortion) == (640, 480, COEFFICIENTS)
    two = KALIBR + KALIBR.replace("cam0", "cam1")
    with pytest.raises(PlanewiseError, match=r"states 2 cameras \(cam0, cam1\); give a file"):
        read_camera(write(tmp_path, two, "camchain.yaml"))


@pytest.mark.parametrize(
    "stated",
    [
        {"distortion_coeffs": COEFFICIENTS},
        {"distCoeffs": [COEFFICIENTS]},
        {"dist": COEFFICIENTS},
        {"distortionCoefficients": COEFFICIENTS},
        {"distortion": {"k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002}},
        {"k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002, "k3": 0.0, "k4": 0},
        {"RadialDistortion": [-0.2, 0.05], "TangentialDistortion": [0.001, -0.002]},
        {"radial_distortion": [-0.2, 0.05, 0.0], "tangential_distortion": [0.001, -0.002]},
        {"distortion": "Brown Conrady", "coeffs": COEFFICIENTS},
        {"model": 4, "coeffs": COEFFICIENTS},
        {"camera_model": "OPENCV", "k1": -0.2, "k2": 0.05, "p1": 0.001, "p2": -0.002},
    ],
)
def test_distortion_by_whatever_name(tmp_path, stated):
    for content in (NUMBERS | stated, {"intrinsics": NUMBERS | stated}):
        camera = read_camera(write(tmp_path, json.loads(json.dumps(content))))
        assert is_right(camera)
        assert camera.distortion[:4] == COEFFICIENTS
        assert not any(camera.distortion[4:])


def test_a_rectified_image_has_the_camera_of_p(tmp_path, caplog):
    p = [[360, 0, 320, 0], [0, 361, 240, 0], [0, 0, 1, 0]]
    stated = {"K": MATRIX, "D": [-0.28, 0.07, 0, 0, 0], "P": p, "width": 640, "height": 480}
    path = write(tmp_path, stated)
    rectified = read_camera(f"{path}:rect")
    assert rectified == PinholeCamera(fx=360, fy=361, cx=320, cy=240, width=640, height=480)
    halved = write(tmp_path, stated | {"binning_x": 2, "binning_y": 2})
    assert read_camera(f"{halved}:rect") == rectified.scaled(0.5)
    path = write(tmp_path, stated | {"distortion_model": "rational_polynomial"})
    raw = read_camera(f"{path}:raw")
    assert raw.distortion
    assert is_right(raw)
    assert not caplog.messages
    assert read_camera(path) == raw
    (told,) = caplog.messages
    assert "camera.json:raw or camera.json:rect" in told


@pytest.mark.parametrize(
    "stated",
    [
        {"D": [0.1, 0, 0, 0, 0]},
        {"D": [0.1, 0, 0, 0, 0], "P": [0] * 12},
        {"D": [0.1, 0, 0, 0, 0], "P": np.c_[MATRIX, [0, 0, 0]].tolist()},
        {"D": [0] * 5, "P": [360, 0, 320, 0, 0, 361, 240, 0, 0, 0, 1, 0]},
    ],
)
def test_one_camera_needs_no_choice(tmp_path, caplog, stated):
    path = write(tmp_path, {"K": MATRIX} | stated)
    assert is_right(read_camera(path))
    assert not caplog.messages
    if not np.any(stated.get("P")):
        with pytest.raises(PlanewiseError, match="no camera of rectified images; expected P"):
            read_camera(f"{path}:rect")


def test_names_that_are_no_files_have_no_rectified_camera(tmp_path):
    for text in ("nyu:rect", "500,500,320,240:rect", str(tmp_path / "none.yaml:raw")):
        with pytest.raises(PlanewiseError, match="camera: "):
            read_camera(text)


RATIONAL = (0.5, -2.6, 0.001, -0.0003, 1.5, 0.4, -2.5, 1.4)


@pytest.mark.parametrize(
    "stated",
    [
        {"D": RATIONAL, "distortion_model": "rational_polynomial"},
        {"distortion_coefficients": {"rows": 1, "cols": 14, "data": [*RATIONAL, *[0] * 6]}},
        dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), RATIONAL, strict=True)),
    ],
)
def test_a_rational_distortion(tmp_path, stated):
    camera = read_camera(write(tmp_path, json.loads(json.dumps(NUMBERS | stated))))
    assert is_right(camera)
    assert camera.distortion == RATIONAL


@pytest.mark.parametrize(
    ("stated", "match"),
    [
        ({"lens_distortion": [0.1, 0, 0, 0]}, "as 'lens_distortion', which is not known"),
        ({"distortion_table": {"rows": [[1, 2]]}}, "'distortion_table'"),
        ({"k1": 0.1, "k4": 0.2}, "k4 without k5 and k6"),
        ({"radial_distortion": [0.1]}, "1 radial and 2 tangential"),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1}, "opencv_fisheye"),
        ({"fisheye_model": 1, "distortion_coefficients": [0.1, 0, 0, 0]}, "model 'fisheye'"),
        ({"is_fisheye": True}, "model 'fisheye'"),
        ({"fisheye": "true"}, "model 'fisheye'"),
        ({"distortion": "Inverse Brown Conrady", "coeffs": [0.1] * 5}, "inverse_brown_conrady"),
        ({"model": 2, "coeffs": [0.1] * 5}, "inverse_brown_conrady"),
        ({"model": 5, "coeffs": [0] * 5}, "kannala_brandt4"),
        ({"model": 17, "coeffs": [0] * 5}, "'17'"),
        ({"xi": 0.9}, "model 'omnidirectional'"),
        ({"distortion_type": "equidistant"}, "equidistant"),
        ({"skew": 5.0}, r"skew \(5\.0\)"),
    ],
)
def test_a_distortion_that_is_not_understood_is_not_left_out(tmp_path, stated, match):
    with pytest.raises(PlanewiseError, match=match):
        read_camera(write(tmp_path, NUMBERS | stated))


def test_what_says_nothing_of_a_distortion_is_read(tmp_path):
    plain = {
        "fisheye_model": 0,
        "is_fisheye": False,
        "skew": 0.0,
        "is_distorted": True,
        "lens_distortion": [0, 0.0],
        "distortion_note": "none",
    }
    camera = read_camera(write(tmp_path, NUMBERS | plain))
    assert is_right(camera)
    assert not camera.distortion


def test_ros_states_what_is_read_of_the_sensor(tmp_path):
    whole = {"K": MATRIX, "width": 640, "height": 480}
    full = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    camera = read_camera(write(tmp_path, whole | {"roi": full, "binning_x": 0, "binning_y": 1}))
    assert camera == read_camera(write(tmp_path, whole))
    halved = read_camera(write(tmp_path, whole | {"binning_x": 2, "binning_y": 2}))
    assert halved == camera.scaled(0.5)
    part = full | {"x_offset": 20, "y_offset": 10, "height": 400, "width": 600}
    camera = read_camera(write(tmp_path, whole | {"roi": part, "binning_x": 2}))
    assert (camera.width, camera.height) == (300, 400)
    assert (camera.fx, camera.fy, camera.cy) == (525.5 / 2, 526.5, 229.5)
    assert camera.cx == (299.5 + 0.5) / 2 - 0.5  # the middle of two pixels is between them


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("{", "JSON"),
        ("[1, 2]", "no named values"),
        ({"width": 3}, "states no intrinsics"),
        ({"K": [1, 2, 3]}, "3 numbers"),
        ({"K": "abc"}, "numbers are expected"),
        ({"K": [[500, 5, 320], [0, 500, 240], [0, 0, 1]]}, "skew"),
        ({"K": [[500, 0, 320], [0, 500, 240], [0, 1, 1]]}, "fx, 0, cx"),
        ({"K": [[0, 0, 320], [0, 500, 240], [0, 0, 1]]}, "fx must be"),
        ({"K": MATRIX, "distortion_model": "equidistant", "D": [0] * 4}, "equidistant"),
        ({"K": MATRIX, "distortion_model": "fisheye", "D": [0.1] * 4}, "fisheye"),
        ({"K": MATRIX, "distortion_model": "fov", "D": [0.1] * 8}, "'fov'"),
        ({"K": MATRIX, "D": [0.1] * 12}, "12 distortion"),  # a thin prism
        ({"K": MATRIX, "D": [0.1] * 3}, "3 distortion"),
        ({"K": MATRIX, "width": "wide", "height": 480}, "'wide' where numbers are expected"),
        ({"fx": 10**400, "fy": 525, "cx": 319.5, "cy": 239.5}, "integer that is too large"),
        ({"K": MATRIX, "width": 640.5, "height": 480}, "size of 640.5; expected a whole number"),
        ({"K": MATRIX, "width": float("inf"), "height": 480}, "size of inf"),
        ({"fx": float("nan"), "fy": 1, "cx": 1, "cy": 1}, "positive number of pixels, got nan"),
    ],
)
def test_unusable_files_are_refused_by_name(tmp_path, content, match):
    with pytest.raises(PlanewiseError, match=match) as error:
        read_camera(write(tmp_path, content))
    assert "camera" in str(error.value)
    assert "\n" not in str(error.value)


def test_unusable_yaml_and_binaries_are_refused(tmp_path):
    with pytest.raises(PlanewiseError, match="YAML"):
        read_camera(write(tmp_path, "a: [1, 2", "camera.yaml"))
    with pytest.raises(PlanewiseError, match="YAML"):
        read_camera(write(tmp_path, "a: !!python/object:os.system x", "camera.yaml"))
    (tmp_path / "c.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PlanewiseError, match="text"):
        read_camera(str(tmp_path / "c.yaml"))


BOMB = "a: &a [1, 1]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (BOMB + "K: *i", "alias"),
        (BOMB + "fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidth: *i", "alias"),
        ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nfoo_distort: &a [*a]", "alias"),
        ("a: &a {x: 1}\nb: {<<: [*a, *a]}", "alias"),
        ("K: " + "[" * 50_000, "nested too deeply|flow level"),
        ("K: " + "[" * 30 + "]" * 30, "nested too deeply"),
        (json.dumps(NUMBERS)[:-1] + f', "my_distort": {"[" * 900}{"]" * 900}}}', "nested too"),
        (f'{{"K": {"[" * 90_000}{"]" * 90_000}}}', "nested too deeply"),
        ("K: [" + "1," * 100_000 + "1]", "too large"),
        (json.dumps({"K": "x" * 900_000}), "'xxx.* where numbers are expected"),
        (json.dumps(NUMBERS | {"width": "x" * 900_000}), "'xxx.* where numbers are expected"),
        (json.dumps(NUMBERS | {"model": "x" * 900_000}), "distortion model 'xxx"),
        (json.dumps(NUMBERS | {"distort" + "x" * 900_000: 1}), "distortion as 'distortx"),
        (json.dumps({"elevation": [1.0], "columns": "x" * 900_000}), "columns 'xxx"),
        ("K: !" + "x" * 100_000 + " 1", "YAML"),
        ("".join(f"cam{number}: 1\n" for number in range(10_000)), "10000 cameras"),
    ],
)  # fmt: skip
def test_files_that_would_take_all_memory_are_refused_at_once(tmp_path, text, match):
    start = time.perf_counter()
    with pytest.raises(PlanewiseError, match=match) as error:
        read_camera(write(tmp_path, text, "camera.yaml"))
    assert time.perf_counter() - start < 5
    assert len(str(error.value)) < 300


@pytest.mark.parametrize("text", ["nikon", "500,500,320", "a,b,c,d", "1,2,3,4,5", ""])
def test_other_texts_are_no_camera(text):
    with pytest.raises(PlanewiseError, match="camera"):
        read_camera(text)


def test_zero_and_nan_focal_lengths_are_refused():
    for text in ("0,500,320,240", "-5,500,320,240", "nan,500,320,240"):
        with pytest.raises(ValueError, match="fx"):
            read_camera(text)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.005", (0.005, 0.005)),
        ("0.005 m", (0.005, 0.005)),
        ("0.5cm", (0.005, 0.005)),
        ("5mm", (0.005, 0.005)),
        ("5e-3", (0.005, 0.005)),
        ("1%", (0.01, 0.03)),
        ("1mm + 0.1%", (0.002, 0.004)),
        ("0.2 % + 0.1 cm + 0.002*z^2", (0.005, 0.025)),
        ("0.001 m + 0.1%", (0.002, 0.004)),
        ("0.01*z", (0.01, 0.03)),
        ("0.01 z", (0.01, 0.03)),
        ("0.001 + 0.002*z^2", (0.003, 0.019)),
        ("0.002*z**2 + 0.001", (0.003, 0.019)),
        ("0.001 + 0.01*z + 0.002*z^2", (0.013, 0.049)),
        ("0.0012 + 0.0019*(z - 0.4)^2", (0.001884, 0.014044)),
        ("kinect", (0.001884, 0.014044)),
        ("structure", (0.0033, 0.0297)),
    ],
)
def test_noise(text, values):
    assert read_noise(text)(np.array((1.0, 3.0))) == pytest.approx(values)


@pytest.mark.parametrize("preset", sensors.PRESETS.values())
def test_noise_reads_back_what_it_prints(preset):
    z = np.array((0.5, 2.0))
    assert read_noise(str(preset.noise))(z) == pytest.approx(preset.noise(z), rel=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0",
        "-1",
        "nan",
        "inf",
        "0%",
        "abc",
        "1+",
        "+",
        "z^3",
        "0.1*z*z",
        "1 + 2",
        "1 2",
        "1mm + 2cm",
        "1mm 0.1%",
        "0.1% + 0.01*z",
        "m",
        "%",
        "0.001*z mm",
        "import os",
    ],
)
def test_bad_noise_is_refused(text):
    with pytest.raises(PlanewiseError, match="noise"):
        read_noise(text)


@pytest.mark.parametrize("filling", [" ", "1", "1.", "1e", "(", "z ^ ", "+ "])
def test_long_noise_is_refused_at_once(filling):
    start = time.perf_counter()
    with pytest.raises(PlanewiseError, match="noise") as error:
        read_noise("1" + filling * 20_000 + "x")
    assert time.perf_counter() - start < 1
    assert len(str(error.value)) < 500
    assert read_length("1" * 20_000 + "x") is None
    assert read_noise("1mm" + " " * 20_000 + "+ 0.1%")(1.0) == pytest.approx(0.002)


def test_sensor_and_its_parts():
    assert read_sensor("kinect-v1") == sensors.KINECT_V1
    sensor = read_sensor("structure", noise="1%", max_depth=3.0, resolution=0.002)
    assert (sensor.max_depth, sensor.resolution, sensor.min_depth) == (3.0, 0.002, 0.4)
    assert sensor.noise == noise.proportional(0.01)
    assert sensor.parts is None
    assert read_sensor(None, noise="2mm").max_depth == 10
    # Frames that cannot tell have these parts, as in Python.
    auto = read_sensor("kinect-v1", noise="auto")
    assert auto == replace(sensors.KINECT_V1, noise="auto")
    assert read_sensor("kinect-v1", noise="1%").parts is None
    with pytest.raises(PlanewiseError, match="sensor"):
        read_sensor("eyes")
    with pytest.raises(ValueError, match="max_depth"):
        read_sensor("kinect-v1", max_depth=float("nan"))
    with pytest.raises(ValueError, match="resolution"):
        read_sensor("kinect-v1", resolution=20.0)
