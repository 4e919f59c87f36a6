"""Read depth images from files: PNG, TIFF, PGM, NumPy, OpenEXR, organised PCD, PTX and E57.

Integer depth stays integer (its unit is a matter of the sensor); floating-point depth is in metres.
Files are not trusted: what they claim to hold is checked before it is unpacked, and nothing in them
is ever executed.
"""

from __future__ import annotations

import logging
import math
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planewise.camera import Camera, PinholeCamera
from planewise.errors import PlanewiseError, naming, needs
from planewise.files.camera import camera_of_mapping
from planewise.files.npy import array_header
from planewise.files.result_names import PARAMETERS, PICTURES
from planewise.runtime.foreign_warnings import without_warnings

if TYPE_CHECKING:
    from PIL.Image import Image as PILImage

    from planewise.organised import PointImage

MAX_PIXELS = 50_000_000
"""Largest image that is read; no depth camera comes near, a file made to exhaust memory does."""

_LOG = logging.getLogger("planewise")
_BESIDE = {"depth_scale", "K", "rgb", "gt"}  # what an archive may hold beside its depth
_FEW = 16  # numbers of a scale or of intrinsics, at most
_TIFF = b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"  # how its files begin
_SAMPLES = 339  # its tag that says whether numbers are signed
_EIGHT_BIT = (
    "holds 8 bits per reading: 256 steps cannot carry depth to the millimetre; "
    "export the depth as 16-bit integers or as floating-point metres"
)
COLOUR = (
    "is a colour picture, not depth: a depth image has one channel; "
    "export the raw readings, not a rendering of them"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthFile:
    """What a file says about one frame.

    Attributes
    ----------
    depth : ndarray, shape (H, W)
        Integer units or floating-point metres.
    depth_scale : float, optional
        Metres per unit of integer depth, where the file knows.
    camera : Camera, optional
        Intrinsics, where the file knows.
    rgb : ndarray of uint8, shape (H, W, 3), optional
        Picture of the same view, where the file holds one.
    """

    depth: NDArray[Any]
    depth_scale: float | None = None
    camera: Camera | None = None
    rgb: NDArray[np.uint8] | None = None


def read_depth(path: str | Path, *, scan: int | None = None) -> DepthFile:
    """Read one depth image.

    Parameters
    ----------
    path : path
        A 16-bit or floating-point image (``.png``, ``.tif``, ``.tiff``, ``.pgm``, ``.exr``),
        an array (``.npy``), or an archive (``.npz``) with the key ``depth``, or with one array
        only. An archive may also hold ``depth_scale`` (metres per unit), ``K`` (fx, fy, cx, cy or a
        3 x 3 matrix) and ``rgb``. Or organised points (``.pcd`` with a HEIGHT; ``.ptx``; ``.e57``
        with rows and columns), whose camera they tell (`planewise.image_of_points`).
    scan : int, optional
        Which scan of a ``.ptx`` or ``.e57``, from 0. Default: the only one.

    Returns
    -------
    DepthFile
        The readings, and the camera and unit where the file states them.

    Raises
    ------
    PlanewiseError
        If the file is missing, damaged, too large, 8-bit, in colour, or not a depth image; or
        points that are not organised, or lie on the rays of no camera.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if not path.exists():
        raise PlanewiseError(f"depth: there is no file {path}")
    if not path.is_file():
        raise PlanewiseError(f"depth: {path} is not a file")
    if kind not in _READERS and kind not in _SCANS:
        known = ", ".join(sorted((*_READERS, *_SCANS)))
        raise PlanewiseError(f"depth: {path.name} is of no known kind; expected one of {known}")
    with naming(f"depth: {path.name}"):
        if kind in _SCANS:
            return _read_scan(path, kind, scan)
        if scan is not None:
            raise PlanewiseError(
                f"holds no scans to choose from; those that do: {', '.join(_SCANS)}"
            )
        return _READERS[kind](path)


def is_depth_file(path: Path) -> bool:
    """Whether the name is that of a depth image in a folder of them."""
    return path.suffix.lower() in _IMAGES and not path.name.startswith(".")


def without_results(paths: Iterable[Path]) -> list[Path]:
    """Of the files of a folder those that are no pictures of a run's, which has a planes.json."""
    known = list(paths)
    written = PICTURES if any(path.name == PARAMETERS for path in known) else ()
    return [path for path in known if path.name not in written]


def list_depth_files(folder: str | Path) -> list[Path]:
    """Depth files of a folder in natural order (frame 2 before frame 10), others ignored.

    Pictures that a run wrote into it are none of them. Links are followed wherever they lead.

    Raises
    ------
    PlanewiseError
        If it is no folder, or holds no depth file.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise PlanewiseError(f"depth: {folder} is not a folder")
    paths = without_results(folder.iterdir())
    files = [path for path in paths if is_depth_file(path) and not path.is_dir()]
    if not files:
        known = ", ".join(sorted(_IMAGES))
        raise PlanewiseError(f"depth: the folder {folder} holds no depth files ({known})")
    return sorted(files, key=natural_order)


def natural_order(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Sort key by which frame 2 comes before frame 10; 1 and 01 are in one order everywhere."""
    parts = re.split(r"(\d+)", path.name)
    rough = [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in parts]
    return rough, path.name


def _check_array(depth: NDArray[Any]) -> NDArray[Any]:
    """Refuse what no depth image can be; a single channel is dropped."""
    if depth.ndim == 3 and depth.shape[2] == 1:
        depth = depth[:, :, 0]
    if depth.ndim == 3 and depth.shape[2] in (3, 4):
        raise PlanewiseError(COLOUR)
    if depth.ndim != 2:
        raise PlanewiseError(f"must hold an image of shape (H, W), got shape {depth.shape}")
    if depth.dtype.kind in "biu" and depth.dtype.itemsize == 1:
        raise PlanewiseError(_EIGHT_BIT)
    if depth.dtype.kind not in "fiu":
        raise PlanewiseError(f"must hold integers or floating-point numbers, got {depth.dtype}")
    return depth


def check_size(values: int, most: int | None = None) -> None:
    """Refuse a file that claims to hold more than `most` values, by default `MAX_PIXELS`."""
    most = MAX_PIXELS if most is None else most
    if values > most:
        raise PlanewiseError(f"claims {values:,} values; at most {most:,} are read")


def _beginning(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(4)


@contextmanager
def opened_picture(
    source: Path | IO[bytes], formats: tuple[str, ...], purpose: str
) -> Iterator[PILImage]:
    """Open a picture of these formats, of no more than `MAX_PIXELS`.

    Pillow warns of tags that are damaged, with its own lines of code, and reads on; the picture is
    what counts. Checksums of a PNG's pixels it passes over, unless asked.
    """
    with needs("pillow", purpose):
        from PIL import Image
    with (
        without_warnings(UserWarning, Image.DecompressionBombWarning),
        ExitStack() as stack,
    ):
        image = stack.enter_context(Image.open(source, formats=formats))
        check_size(image.width * image.height)
        if image.format == "PNG":
            image.verify()  # and then it has to be opened once more
            image = stack.enter_context(Image.open(source, formats=formats))
        yield image


def _read_picture(path: Path) -> DepthFile:
    return DepthFile(depth=read_depth_picture(path))


def read_depth_picture(source: Path | IO[bytes]) -> NDArray[Any]:
    """Read a depth image of one channel from a PNG or TIFF; raises what its decoder does."""
    with needs("pillow", "reading PNG and TIFF files"):
        from PIL import UnidentifiedImageError
    try:
        with opened_picture(source, ("PNG", "TIFF"), "reading PNG and TIFF files") as image:
            return _check_array(_readings(image))
    except UnidentifiedImageError:
        if isinstance(source, Path) and _beginning(source) in _TIFF:
            raise PlanewiseError(
                "is a TIFF of a kind that is not read; write integers of 16 bits or "
                "floating-point numbers of 32"
            ) from None
        raise


def _readings(image: PILImage) -> NDArray[Any]:
    if image.mode in ("1", "L", "P"):
        raise PlanewiseError(_EIGHT_BIT)
    if len(image.getbands()) > 1:
        raise PlanewiseError(COLOUR)
    if getattr(image, "n_frames", 1) > 1:
        raise PlanewiseError("holds several images; export one frame a file")
    depth = numbers_of_picture(image)
    # Pillow has no unsigned integers of 32 bits, which those of a TIFF are if it is silent.
    tags = getattr(image, "tag_v2", None)
    if depth.dtype == np.int32 and tags is not None and tags.get(_SAMPLES, (1,)) == (1,):
        depth = depth.view(np.uint32)
    return depth


def numbers_of_picture(image: PILImage) -> NDArray[Any]:
    """Numbers of a picture of one channel, in the machine's byte order."""
    # What libtiff unpacks is in that order; Pillow takes some of it for that of the file.
    codec, _, _, form = next(iter(getattr(image, "tile", ())), ("", None, 0, ""))
    swapped = re.fullmatch(r"[IF];(\d+)B[SF]", form[0]) if codec == "libtiff" else None
    numbers = np.asarray(image)
    if swapped:
        numbers = numbers.astype(f"{numbers.dtype.kind}{int(swapped[1]) // 8}").byteswap()
    return numbers.astype(numbers.dtype.newbyteorder("="))


def _read_pgm(path: Path) -> DepthFile:
    """Read a PGM; general image readers stretch its values to the full 16 bits."""
    data = path.read_bytes()
    header = re.match(rb"(P[25])((?:\s|#[^\n]*\n)+)(\d+)\s+(?:#[^\n]*\n\s*)*(\d+)\s+"
                      rb"(?:#[^\n]*\n\s*)*(\d+)\s", data)  # fmt: skip
    if header is None:
        raise PlanewiseError("is not a grey PGM (P2 or P5)")
    width, height, largest = (int(header[group]) for group in (3, 4, 5))
    check_size(width * height)
    if largest < 256:
        raise PlanewiseError(_EIGHT_BIT)
    body = data[header.end() :]
    if header[1] == b"P5":
        values = np.frombuffer(body[: 2 * width * height], ">u2")
    else:
        values = np.array(body.split(maxsplit=width * height)[: width * height], np.uint16)
    if values.size < width * height:
        raise PlanewiseError(f"is cut short: {values.size} of {width * height} values are there")
    return DepthFile(depth=values.reshape(height, width).astype(np.uint16))


def _read_npy(path: Path) -> DepthFile:
    with path.open("rb") as stream:
        return DepthFile(depth=_check_array(read_array(stream)))


def _read_npz(path: Path) -> DepthFile:
    with zipfile.ZipFile(path) as archive, ExitStack() as stack:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

        def opened(name: str) -> IO[bytes]:
            return stack.enter_context(archive.open(members[name]))

        def few(name: str) -> NDArray[Any]:
            with naming(name):
                return read_array(opened(name), _FEW)

        if "depth" not in members and (len(members) != 1 or members.keys() & _BESIDE):
            names = ", ".join(sorted(members)) or "none"
            raise PlanewiseError(f"must hold an array named 'depth', or one only; it holds {names}")
        name = "depth" if "depth" in members else next(iter(members))
        depth = _check_array(read_array(opened(name)))
        stated = _scale_of(few("depth_scale")) if "depth_scale" in members else None
        scale = unit_of(depth, stated)
        camera = _camera_of(few("K")) if "K" in members else None
        rgb = _rgb_of(opened("rgb"), depth.shape, path) if "rgb" in members else None
    return DepthFile(depth=depth, depth_scale=scale, camera=camera, rgb=rgb)


def _rgb_of(stream: IO[bytes], pixels: tuple[int, ...], path: Path) -> NDArray[np.uint8] | None:
    """Picture of so many pixels; what is none is not read."""
    shape, fortran, dtype = array_header(stream)
    if dtype == np.uint8 and shape == (*pixels, 3):
        return _contents(stream, shape, fortran, dtype)
    # Only a decoration, as a rule: not worth refusing the readings for.
    _LOG.warning(
        f"{path.name}: rgb has shape {shape} and type {dtype}, which is no picture of its pixels: "
        "left out"
    )
    return None


def unit_of(depth: NDArray[Any], stated: float | None) -> float | None:
    """Metres per unit of integer depth, as stated; ``None`` of floats, whose unit is the metre.

    Raises
    ------
    PlanewiseError
        If another one is stated of floats.
    """
    if depth.dtype.kind != "f":
        return stated
    if stated not in (None, 1):
        raise PlanewiseError("depth_scale is for integer depth; floating-point depth is in metres")
    return None


def _scale_of(stated: NDArray[Any]) -> float:
    scale = float(stated.item()) if stated.size == 1 and stated.dtype.kind in "fiu" else math.nan
    if not 0 < scale < math.inf:
        raise PlanewiseError(
            f"has depth_scale {stated.tolist()}; expected one positive number of metres"
        )
    return scale


def _camera_of(matrix: NDArray[Any]) -> PinholeCamera:
    try:
        return camera_of_mapping({"K": matrix})
    except PlanewiseError:
        raise
    except ValueError as error:
        raise PlanewiseError(f"has intrinsics K of no camera ({error})") from None


def read_array(stream: IO[bytes], most: int | None = None) -> NDArray[Any]:
    """Read one NumPy array of at most so many numbers (`check_size`); pickles are refused."""
    shape, fortran, dtype = array_header(stream)
    check_size(math.prod(shape), most)
    return _contents(stream, shape, fortran, dtype)


def _contents(
    stream: IO[bytes], shape: tuple[int, ...], fortran: bool, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Numbers behind a header."""
    count = math.prod(shape)
    # Only what the header claims is unpacked, so an archive cannot swell beyond it.
    data = stream.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise PlanewiseError(
            f"is cut short: {len(data)} of {count * dtype.itemsize} bytes are there"
        )
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C").copy()


def _read_exr(path: Path) -> DepthFile:
    from planewise.files.exr import depth_channel

    return DepthFile(depth=_check_array(depth_channel(path)))


def _read_pcd(path: Path) -> DepthFile:
    from planewise.files.pcd import open_pcd

    file = open_pcd(path)
    if file.shape is None:
        raise PlanewiseError(
            "holds points that are no image: its HEIGHT or WIDTH is 1; 'planewise points' takes it"
        )
    pixels = math.prod(file.shape)
    check_size(pixels)
    (cloud,) = file.blocks(pixels)
    rgb = None if cloud.colour is None else cloud.colour.reshape(*file.shape, 3)
    image = _image_of(cloud.coordinates.reshape(*file.shape, 3))
    return DepthFile(depth=image.depth, camera=image.camera, rgb=rgb)


def _read_scan(path: Path, kind: str, scan: int | None) -> DepthFile:
    from planewise.files.scans import upright

    points, rgb = import_module(_SCANS[kind]).grid_of(path, scan)
    image, rgb = upright(_image_of(points), rgb)
    return DepthFile(depth=image.depth, camera=image.camera, rgb=rgb)


def _image_of(points: NDArray[np.floating]) -> PointImage:
    from planewise.organised import image_of_points  # depth images are read sooner without

    try:
        return image_of_points(points)
    except ValueError as error:
        raise PlanewiseError(f"is no depth image; {error}") from None


_IMAGES: dict[str, Callable[[Path], DepthFile]] = {
    ".png": _read_picture,
    ".tif": _read_picture,
    ".tiff": _read_picture,
    ".pgm": _read_pgm,
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".exr": _read_exr,
}
# Clouds lie beside the depth images they were made of, and would be frames once more.
_READERS = {**_IMAGES, ".pcd": _read_pcd}
_SCANS = {".ptx": "planewise.files.ptx", ".e57": "planewise.files.e57"}
