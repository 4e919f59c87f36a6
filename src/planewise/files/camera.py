"""Cameras and sensors as users write them down: preset names, numbers, calibration files."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planewise import cameras, noise, sensors
from planewise.arguments import shown
from planewise.camera import Camera, PinholeCamera
from planewise.errors import PlanewiseError, SetupError
from planewise.files.distortion import distortion_of
from planewise.files.lidar import is_spherical, panorama_camera, spherical_camera
from planewise.files.named_values import read_mapping
from planewise.files.numbers import first_of, numbers_of
from planewise.noise import AUTO, Noise, Polynomial
from planewise.sensor import Sensor
from planewise.wording import counted

_LOG = logging.getLogger("planewise")

REGION = "x_offset", "y_offset", "width", "height"
"""What ROS says of the region of a sensor that is read."""

_RECTIFIED, _RAW = ":rect", ":raw"  # behind a file's name
_RADIAL = ":radial"  # behind that, or any camera
_FOUR = (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy"))  # intrinsics, each by the names it has

NOISE_HELP = (
    "0.005 or 5mm (the same at every depth), 1% (of the depth), 1mm + 0.1%, a formula in z such as "
    "'0.001 + 0.002*z^2' or '0.0012 + 0.0019*(z - 0.4)^2', or a preset's name"
)


def read_camera(text: str) -> Camera:
    """Camera from a preset's name, four numbers or a calibration file.

    Parameters
    ----------
    text : str
        A key of `planewise.cameras.PRESETS`; or ``"fx,fy,cx,cy"`` in pixels; or the path of a JSON
        or YAML file, ROS ``camera_info`` included. A file states the intrinsics as ``K``,
        ``camera_matrix``, ``intrinsic_matrix`` or ``intrinsics`` (nine numbers, three rows or four
        numbers), or as ``fx``, ``fy``, ``cx`` and ``cy``; distortion as ``D``, ``distortion``,
        ``distortion_coefficients`` or the like in the order k1, k2, p1, p2[, k3[, k4, k5, k6]], or
        by these names;
        of ROS also what part of the sensor is read (``roi``, ``binning_x``). ``:rect`` behind a
        file's name says that images are rectified, as those of a ROS topic ``image_rect``: their
        camera is that of P (``projection_matrix``), without distortion; ``:raw`` that they are not.
        Without either they are not, with a warning where the file states a P that is another
        camera. A LiDAR's file states ``elevation`` and ``azimuth`` or ``columns``, or is Ouster's
        metadata (`planewise.files.lidar`). ``panorama:1024x512`` is an equirectangular panorama of
        that width and height, of distances. ``:radial`` behind any of a pinhole camera says that
        readings are distances from it, not depth along z, as does ``radial: true`` in a file.

    Returns
    -------
    Camera
        Where the file states the size of the image, so does the camera.

    Raises
    ------
    PlanewiseError
        If it is none of these, or the camera is neither a pinhole with radial-tangential or
        rational distortion nor a LiDAR.
    """
    if (plain := without_radial(text)) != text:
        camera = read_camera(plain)
        if not isinstance(camera, PinholeCamera):
            raise PlanewiseError(f"camera: {text}: ranges of a LiDAR are distances as they are")
        return replace(camera, radial=True)
    if text.lower() in cameras.PRESETS:
        return cameras.PRESETS[text.lower()]
    if (panorama := panorama_camera(text)) is not None:
        return panorama
    path = Path(camera_file(text))
    told = path.name != Path(text).name
    rectified = told and text.endswith(_RECTIFIED)
    if "," in text and not path.is_file():
        return _from_numbers(text)
    if not path.is_file():
        raise PlanewiseError(
            f"camera: {text!r} is neither a preset ({', '.join(cameras.PRESETS)}), "
            "nor fx,fy,cx,cy in pixels, nor panorama:1024x512, nor a file"
        )
    try:
        content = read_mapping(path)
        values = {str(key).lower(): value for key, value in content.items()}
        if is_spherical(values) and not rectified:
            return spherical_camera(values)
        camera = camera_of_mapping(content, rectified=rectified)
        if not told and any(camera.distortion) and _rectifies(values):
            _LOG.warning(
                f"camera: {path.name} states K and D of raw images, which are taken, and a P of "
                f"rectified ones; say which yours are: {path.name}{_RAW} or {path.name}{_RECTIFIED}"
            )
        return camera
    except PlanewiseError as error:
        if isinstance(error, SetupError):
            raise
        raise PlanewiseError(f"camera: {path.name} {error}") from None
    except ValueError as error:
        raise PlanewiseError(f"{error} (from {path.name})") from None


def without_radial(text: str) -> str:
    """Camera without the ``:radial`` behind it; a file of that name as it is."""
    return text if Path(text).is_file() else text.removesuffix(_RADIAL)


def camera_file(text: str) -> str:
    """Name of the file that a camera is of, without what says more of it; other text as it is."""
    text = without_radial(text)
    if Path(text).is_file():
        return text
    return text.removesuffix(_RECTIFIED).removesuffix(_RAW)


def no_camera(what: str) -> PlanewiseError:
    """Error of depth whose camera nothing tells."""
    return PlanewiseError(
        f"camera: {what} does not state its intrinsics; give --camera as a preset, fx,fy,cx,cy or "
        "a file"
    )


def read_sensor(
    name: str | None,
    *,
    noise: str | None = None,
    max_depth: float | None = None,
    resolution: float | None = None,
) -> Sensor:
    """Sensor from a preset's name or a file, with parts of it replaced.

    Parameters
    ----------
    name : str, optional
        A key of `planewise.sensors.PRESETS`, or the path of a file that ``planewise calibrate``
        wrote; ``None`` means `planewise.Sensor` as it is by default.
    noise : str, optional
        As `read_noise` takes it, or "auto": estimated from each frame.
    max_depth, resolution : float, optional
        Metres.

    Raises
    ------
    PlanewiseError
        If the preset or the noise is unknown, or the file describes no sensor.
    ValueError
        If the numbers make no sensor.
    """
    base = Sensor()
    if name is not None and name.lower() in sensors.PRESETS:
        base = sensors.PRESETS[name.lower()]
    elif name is not None and (Path(name).is_file() or name.lower().endswith(".json")):
        base = sensors.load(name)
    elif name is not None:
        raise PlanewiseError(
            f"sensor: {name!r} is neither a preset ({', '.join(sensors.PRESETS)}) nor a file, "
            "such as planewise calibrate writes"
        )
    return with_changes(base, noise=noise, max_depth=max_depth, resolution=resolution)


def with_changes(
    sensor: Sensor, *, noise: str | None, max_depth: float | None, resolution: float | None
) -> Sensor:
    """Replace of a sensor what is given, each as `read_sensor` takes it."""
    changes: dict[str, Any] = {"max_depth": max_depth, "resolution": resolution}
    if noise is not None:
        if noise.strip().lower() == AUTO:  # the parts are what a frame has that cannot tell
            changes["noise"] = AUTO
        else:
            changes["noise"] = read_noise(noise)
            sensor = replace(sensor, parts=None)  # they were those of another noise
    given = {key: value for key, value in changes.items() if value is not None}
    return replace(sensor, **given)


def read_noise(text: str) -> Noise:
    """Noise model from its short form.

    Parameters
    ----------
    text : str
        ``"0.005"`` or ``"5mm"``: sigma is the same at every depth. ``"1%"``: a share of the depth.
        ``"1mm + 0.1%"``: their sum. ``"a + b*z + c*z^2"``, ``"a + c*(z - d)^2"``: a formula in
        metres, any term may be left out; the square is 0 nearer than d. ``"kinect"`` or a key of
        `planewise.sensors.PRESETS`: that sensor's noise.

    Returns
    -------
    callable
        sigma(z) in metres.

    Raises
    ------
    PlanewiseError
        If the text is none of these, or sigma is not positive and finite.

    Examples
    --------
    >>> print(read_noise("5mm"))
    0.005 m
    >>> print(read_noise("0.0012 + 0.0019*(z - 0.4)^2"))
    0.0012 + 0.0019 (z - 0.4)^2 m
    """
    name = " ".join(text.lower().split())  # _TERM tries every way to share out spaces
    if name == "kinect":
        return noise.KINECT
    if name in sensors.PRESETS:
        model = sensors.PRESETS[name].noise
        assert callable(model)
        return model
    try:
        return _formula(name)
    except ValueError as error:
        detail = f" ({error})" if str(error) else ""
        raise PlanewiseError(f"noise: {shown(text)} is not {NOISE_HELP}{detail}") from None


def read_length(text: str) -> float | None:
    """Metres from ``"0.005"``, ``"0.005 m"``, ``"0.5cm"`` or ``"5mm"``; ``None`` from other text.

    Examples
    --------
    >>> read_length("5mm")
    0.005
    """
    length = re.fullmatch(rf"({_NUMBER})\s*(mm|cm|m)?", text.strip().lower())
    return None if length is None else float(length[1]) / _PARTS.get(length[2], 1)


_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?|nan|[-+]?inf"
_PARTS = {"mm": 1000, "cm": 100, "%": 100}
_TERM = re.compile(
    rf"\s*(?P<size>{_NUMBER})?\s*(?:(?P<unit>mm|cm|%)|\*?\s*"
    r"(?:(?P<linear>z)(?!\s*(?:\^|\*\*))|(?P<square>z|\(\s*z\s*-\s*(?P<offset>[\d.e-]+)\s*\))"
    r"\s*(?:\^|\*\*)\s*2)?\s*m?)\s*(?:\+|$)"
)


def _formula(text: str) -> Polynomial:
    """Parse a sum of terms: a length, number%, number*z, number*z^2, number*(z - number)^2."""
    terms = {"constant": 0.0, "linear": 0.0, "quadratic": 0.0, "offset": 0.0}
    seen: set[str] = set()
    at = 0
    while at < len(text):
        term = _TERM.match(text, at)
        if term is None or not term[0].strip(" +*cm%"):
            raise ValueError(f"cannot read {shown(text[at:].strip())}")
        size = float(term["size"] or 1) / _PARTS.get(term["unit"], 1)
        share = term["linear"] or term["unit"] == "%"
        name = "linear" if share else "quadratic" if term["square"] else "constant"
        if name in seen:
            raise ValueError(f"two {name} terms")
        seen.add(name)
        terms[name] = size
        terms["offset"] = float(term["offset"] or 0) or terms["offset"]
        at = term.end()
    if not seen or text.rstrip().endswith("+"):
        raise ValueError
    return Polynomial(**terms)


def _from_numbers(text: str) -> PinholeCamera:
    try:
        fx, fy, cx, cy = (float(part) for part in text.split(","))
    except ValueError:
        raise PlanewiseError(
            f"camera: expected four numbers fx,fy,cx,cy in pixels, got {text!r}"
        ) from None
    return PinholeCamera(fx=fx, fy=fy, cx=cx, cy=cy)


def camera_of_mapping(content: Mapping[str, Any], *, rectified: bool = False) -> PinholeCamera:
    """Camera of named values, as files state them, or of rectified images; see `read_camera`.

    Raises
    ------
    PlanewiseError
        If they describe no pinhole with a distortion of `planewise.lens`.
    """
    values = {str(key).lower(): value for key, value in content.items()}
    if rectified:
        values = values | {"k": _projection(values)}
    fx, fy, cx, cy = _intrinsics(values)
    width, height = _size(values)
    if not isinstance(radial := values.get("radial", False), bool):
        raise PlanewiseError(f"states radial {shown(radial)}; expected true or false")
    camera = PinholeCamera(
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        width=width,
        height=height,
        distortion=() if rectified else distortion_of(values),
        radial=radial,
    )
    return _read_out(camera, values)


def _read_out(camera: PinholeCamera, values: Mapping[str, Any]) -> PinholeCamera:
    """Camera of the image, where ROS states that it is a region of the sensor's, or binned."""
    region = values.get("roi")
    if isinstance(region, Mapping):
        left, top, width, height = (_pixels(region.get(name)) or 0 for name in REGION)
        if width and height and (height, width) != (camera.height, camera.width):
            camera = camera.cropped(top, left, (height, width))
    across, down = (_pixels(values.get(name)) or 1 for name in ("binning_x", "binning_y"))
    return camera if across == down == 1 else camera.binned(across, down)


def _rectifies(values: Mapping[str, Any]) -> bool:
    """Whether P is stated, and another camera than K."""
    if not _stated_projection(values).any():
        return False
    return not np.allclose(_intrinsics(values), _intrinsics({"k": _projection(values)}))


def _projection(values: Mapping[str, Any]) -> NDArray[np.float64]:
    """Matrix 3 x 3 of P, the camera of rectified images."""
    numbers = _stated_projection(values)
    if numbers.size != 12 or not numbers.any():
        raise PlanewiseError(
            "states no camera of rectified images; expected P or projection_matrix, 3 x 4 numbers"
        )
    return numbers.reshape(3, 4)[:, :3]


def _stated_projection(values: Mapping[str, Any]) -> NDArray[np.float64]:
    given = first_of(values, "p", "projection_matrix")
    return numbers_of(() if given is None else given)


def _intrinsics(values: Mapping[str, Any]) -> tuple[float, float, float, float]:
    if (skew := values.get("skew")) is not None and numbers_of(skew).any():
        raise PlanewiseError(f"has a camera with skew ({shown(skew)}), which is not supported")
    matrix = first_of(values, "k", "camera_matrix", "intrinsic_matrix", "intrinsics")
    if matrix is None or (isinstance(matrix, dict) and "data" not in matrix):
        numbers = [first_of(values, *names) for names in _FOUR]
        if any(number is None for number in numbers):
            raise PlanewiseError(
                "states no intrinsics; expected K, camera_matrix, intrinsic_matrix, intrinsics, "
                "or fx, fy, cx and cy"
            )
        fx, fy, cx, cy = numbers_of(numbers).tolist()
        return fx, fy, cx, cy
    flat = numbers_of(matrix)
    if flat.size == 4:
        fx, fy, cx, cy = flat.tolist()
        return fx, fy, cx, cy
    if flat.size != 9:
        raise PlanewiseError(f"has intrinsics of {counted(flat.size, 'number')}; expected 9 (or 4)")
    k = flat.reshape(3, 3)
    if k[0, 2] == 0 == k[1, 2] and k[2, 0] != 0:
        k = k.T  # Open3D writes its matrix column by column
    if not np.allclose((k[1, 0], k[2, 0], k[2, 1], k[2, 2]), (0, 0, 0, 1)):
        raise PlanewiseError("has intrinsics that are not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    if abs(k[0, 1]) > 1e-6 * abs(k[0, 0]):
        raise PlanewiseError(f"has a camera with skew ({k[0, 1]:g}), which is not supported")
    return float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])


def _size(values: Mapping[str, Any]) -> tuple[int | None, int | None]:
    """Width and height of the image."""
    both = values.get("resolution")  # as Kalibr has it
    if isinstance(both, (list, tuple)) and len(both) == 2:
        return _pixels(both[0]), _pixels(both[1])
    width = first_of(values, "width", "image_width")
    return _pixels(width), _pixels(first_of(values, "height", "image_height"))


def _pixels(value: Any) -> int | None:
    """Side of an image; ROS writes 0 for "unknown"."""
    if not value:
        return None
    size = numbers_of(value)
    if size.size != 1 or not 1 <= size[0] < 1 << 31 or size[0] % 1:
        raise PlanewiseError(f"states a size of {shown(value)}; expected a whole number of pixels")
    return int(size[0])
