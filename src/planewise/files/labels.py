"""Read label images from files."""

from __future__ import annotations

import json
import zipfile
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import is_finite
from planewise.errors import PlanewiseError, naming
from planewise.files.depth import natural_order, numbers_of_picture, opened_picture, read_array
from planewise.files.result_names import LABELS, PARAMETERS

_KEYS = ("labels", "gt", "plane_instance")
_KINDS = (".png", ".tif", ".tiff", ".npy", ".npz")
_MEND = "mend it, or remove it to do without the parameters of the planes"

STORE_FILE = "store.json"
"""What a store is known by."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelFile:
    """What a file says about the planes of one frame.

    Attributes
    ----------
    labels : ndarray of int, shape (H, W)
        0 for no plane.
    valid : ndarray of bool, shape (H, W), optional
        Pixels with a reading, where the file holds the depth, too.
    planes : ndarray, shape (N, 4), optional
        Rows (normal, distance), row j - 1 for label j, where they are known.
    """

    labels: NDArray[np.integer]
    valid: NDArray[np.bool_] | None = None
    planes: NDArray[np.float64] | None = None


@runtime_checkable
class Labelled(Protocol):
    """A frame whose labels are not in a file of their own, such as one of a store."""

    def read(self) -> LabelFile:
        """Read them; raise `PlanewiseError` where that cannot be done."""
        ...


def read_labels(path: str | Path | Labelled, *, name: str = "labels") -> LabelFile:
    """Read one label image.

    Parameters
    ----------
    path : path or Labelled
        A grey or indexed PNG or TIFF of 8 or 16 bits, an array of integers (``.npy``), or an
        archive (``.npz``) with the key ``labels``, ``gt`` or ``plane_instance`` (NYUv2-Plane). An
        archive may also hold ``depth`` (0 or NaN where there is no reading) and ``planes``; beside
        a ``labels.png`` that `planewise detect` wrote lies its ``planes.json``.
    name : str
        What messages call it.

    Returns
    -------
    LabelFile
        Labels, and what else is known.

    Raises
    ------
    PlanewiseError
        If the file is missing, damaged, too large, or holds no labels, or what lies beside it is
        damaged.
    """
    if isinstance(path, Labelled):
        return path.read()
    path = Path(path)
    if not path.is_file():
        raise PlanewiseError(f"{name}: there is no file {path}")
    if path.suffix.lower() not in _KINDS:
        raise PlanewiseError(
            f"{name}: {path.name} is of no known kind; expected one of {', '.join(_KINDS)}"
        )
    with naming(f"{name}: {path.name}"):
        found = _read(path)
    beside = path.with_name(PARAMETERS)
    if path.name != LABELS or not beside.is_file():
        return found
    with naming(f"{name}: {PARAMETERS} beside {path.name}"):
        return replace(found, planes=_read_parameters(beside))


def label_images(folder: Path) -> dict[str, Path]:
    """Label images of a folder by name without ending, in natural order.

    Raises
    ------
    PlanewiseError
        If it holds two of one name.
    """
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir(), key=natural_order):
        file = path / LABELS if path.is_dir() else path
        stem = path.name if path.is_dir() else path.stem
        if path.name.startswith(".") or file.suffix.lower() not in _KINDS or not file.is_file():
            continue
        if stem in files:
            raise PlanewiseError(
                f"{folder} holds two label images of one frame: {files[stem].name} and {path.name}"
            )
        files[stem] = file
    return files


def _read(path: Path) -> LabelFile:
    kind = path.suffix.lower()
    if kind == ".npz":
        return _read_archive(path)
    if kind == ".npy":
        with path.open("rb") as stream:
            return LabelFile(labels=_check(read_array(stream)))
    return LabelFile(labels=_check(_read_picture(path)))


def _read_picture(path: Path) -> NDArray[Any]:
    with opened_picture(path, ("PNG", "TIFF"), f"reading {path.suffix} files") as image:
        if len(image.getbands()) > 1 and image.mode != "LA":
            raise PlanewiseError("is a colour picture; labels are numbers in one channel")
        # Of an indexed picture the indices, not the colours; of a transparent one the grey.
        return numbers_of_picture(image.getchannel(0) if image.mode == "LA" else image)


def _read_archive(path: Path) -> LabelFile:
    with zipfile.ZipFile(path) as archive, ExitStack() as stack:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}

        def array(name: str) -> NDArray[Any] | None:
            if name not in members:
                return None
            return read_array(stack.enter_context(archive.open(members[name])))

        key = next((key for key in _KEYS if key in members), None)
        if key is None:
            names = ", ".join(sorted(members)) or "none"
            raise PlanewiseError(
                f"must hold an array named {' or '.join(map(repr, _KEYS))}; it holds {names}"
            )
        labels, depth, planes = array(key), array("depth"), array("planes")
    assert labels is not None
    labels = _check(labels)
    valid = None
    if depth is not None:
        if depth.shape != labels.shape or depth.dtype.kind not in "uif":
            raise PlanewiseError(
                f"has depth of {depth.dtype} and shape {depth.shape}; expected numbers of the "
                f"shape of '{key}', {labels.shape}, or no depth"
            )
        valid = np.asarray(np.isfinite(depth) & (depth > 0))
    if planes is not None and (planes.ndim != 2 or planes.shape[1] != 4):
        raise PlanewiseError(f"has planes of shape {planes.shape}; expected (N, 4)")
    return LabelFile(
        labels=labels, valid=valid, planes=None if planes is None else planes.astype(np.float64)
    )


def _read_parameters(path: Path) -> NDArray[np.float64]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise PlanewiseError(f"is not valid JSON ({error}); {_MEND}") from None
    planes = record.get("planes") if isinstance(record, dict) else None
    if not isinstance(planes, list):
        raise PlanewiseError(f"holds no list of 'planes'; {_MEND}")
    return np.array([_row(*each) for each in enumerate(planes, 1)], np.float64).reshape(-1, 4)


def _row(label: int, plane: Any) -> list[float]:
    match plane:
        case {"normal": [x, y, z], "distance": d} if all(map(is_finite, (x, y, z, d))):
            return [x, y, z, d]
    raise PlanewiseError(
        f"has no 'normal' of three finite numbers, or no 'distance', for plane {label}; {_MEND}"
    )


def _check(labels: NDArray[Any]) -> NDArray[np.integer]:
    if labels.ndim != 2:
        raise PlanewiseError(f"must hold an image of shape (H, W), got shape {labels.shape}")
    if labels.dtype.kind not in "uib":
        raise PlanewiseError(f"must hold integer labels, got {labels.dtype}")
    return labels.astype(np.uint8) if labels.dtype.kind == "b" else labels
