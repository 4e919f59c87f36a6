"""What is done with one frame: read it, find its planes, write both down. Touches no store."""

from __future__ import annotations

import hashlib
import json
import time
from collections import OrderedDict
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from planewise.arguments import checked_scale, unit_told
from planewise.batch.columns import DONE, FAILED, PLANES, TIMES
from planewise.batch.frame_names import label_path
from planewise.batch.label_png import png_of_labels
from planewise.batch.source import Source, SourceFrame, is_gone, is_registered, path_of
from planewise.camera import Camera, PinholeCamera
from planewise.errors import SetupError
from planewise.files.camera import no_camera
from planewise.files.coco_rle import encode_labels
from planewise.misread import misread
from planewise.model import assumed_noise
from planewise.own_camera import checked_camera
from planewise.results.planes_json import number_or_none
from planewise.sensor import Sensor, checked_sensor

if TYPE_CHECKING:
    from planewise.detect import Detector
    from planewise.model import Plane, PlaneModel
    from planewise.options import Options

Labels = Literal["png", "rle"]

_DETECTORS = 4  # cameras whose detectors are kept, of some 16 MB each


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What all frames of a store have in common.

    Parameters
    ----------
    sensor : Sensor
        Range, resolution and noise.
    options : Options
        How to search; every frame is searched by one thread. A partitioner of one's own has a
        method ``describe()``, which says all that its regions depend on.
    camera : Camera, optional
        Intrinsics of all frames; ``None`` means that each frame states its own.
    depth_scale : float, optional
        Metres per unit of integer depth of all frames; ``None`` as above.
    labels : {"png", "rle"}
        Label images as files, or the mask of every plane as COCO's run lengths in its table.
    """

    sensor: Sensor
    options: Options
    camera: Camera | None = None
    depth_scale: float | None = None
    labels: Labels = "png"

    def __post_init__(self) -> None:
        if self.labels not in ("png", "rle"):
            raise ValueError(f"labels must be 'png' or 'rle', got {self.labels!r}")
        checked_sensor(self.sensor)
        if self.camera is not None:
            checked_camera(self.camera)
        object.__setattr__(self, "depth_scale", checked_scale(self.depth_scale))
        from planewise.options import Options  # loads Numba
        from planewise.partition import describe, tells_itself

        if not isinstance(self.options, Options):
            raise ValueError(f"options must be planewise.Options, got {self.options!r}")
        if not isinstance(self.options.rng, int):
            raise ValueError("rng must be an int: a generator does not give the same answer twice")
        if not isinstance(self.options.objective, str | None):
            raise ValueError("objective must be a name, by which the store can tell it from others")
        partition = self.options.partitioner
        if partition is not None and not tells_itself(partition):
            raise ValueError(
                "partition must be a name or have a method describe() that says all regions depend "
                "on, by which the store can tell it from others; "
                f"got {describe(partition)}"
            )
        object.__setattr__(self, "options", self.options.resolved(spatial=True))
        self.options.check_samples(3)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a frame, ready to be stored.

    Attributes
    ----------
    number : int
        Of the frame in its source.
    frame : str
        Its id.
    record : bytes
        Its rows as JSON, as `journal` keeps them.
    label_file : tuple of (str, bytes), optional
        Path in the store and content.
    planes : int
        How many were found.
    shape : tuple of int
        Height and width.
    present : int
        Pixels with a depth, be it out of the sensor's range.
    out_of_range : bool
        Whether more than half of what the frame holds is outside the sensor's range.
    unit_told : bool
        Whether the unit of its readings is known, be it that they are metres; else they were taken
        in units of the sensor's resolution.
    noise_assumed : bool
        Whether its noise was to be estimated and could not be.
    misread : str
        What its readings look like, where the camera says otherwise; else empty.
    reason : str
        Why it failed; empty if it did not.
    fatal : str
        Why no other frame can be done either; empty if they can.
    milliseconds : tuple of float
        To read, to detect, to encode.
    """

    number: int
    frame: str
    record: bytes = b""
    label_file: tuple[str, bytes] | None = None
    planes: int = 0
    shape: tuple[int, int] = (0, 0)
    present: int = 0
    out_of_range: bool = False
    unit_told: bool = True
    noise_assumed: bool = False
    misread: str = ""
    reason: str = ""
    fatal: str = ""
    milliseconds: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class FrameWork:
    """Does frames of a source; every worker has one of its own.

    Parameters
    ----------
    source : Source
        Where frames come from.
    recipe : Recipe
        What is done with them.
    """

    source: Source
    recipe: Recipe
    _detectors: OrderedDict[Any, Detector] = field(default_factory=OrderedDict)

    def __call__(self, number: int, frame: str) -> Outcome:
        """Do one frame; what is wrong with it becomes its `reason`."""
        try:
            return self._done(number, frame)
        except SetupError as error:
            return Outcome(number=number, frame=frame, fatal=str(error))
        except (ValueError, OSError) as error:
            if is_gone(self.source):
                gone = f"source: {path_of(self.source)} is there no more; once it is, go on"
                return Outcome(number=number, frame=frame, fatal=gone)
            named = f"{self.source.name}, frame {frame}: "  # by datasets, and again by who shows it
            return failure(number, frame, _one_line(error).removeprefix(named))
        except Exception as error:  # one frame must not end a run of days
            return failure(number, frame, f"{type(error).__name__}: {_one_line(error)}")

    def _done(self, number: int, frame: str) -> Outcome:
        start = time.perf_counter()
        seen = self.source[frame]
        read = time.perf_counter()
        detector = self._detector(seen)
        regions = self.recipe.options.partition is not None and is_registered(self.source)
        observed, model = detector.observe_and_find(seen.depth, rgb=seen.rgb if regions else None)
        doubt = misread(observed)  # of every frame: a detector looks at its first alone
        model = model.with_note(doubt)
        detected = time.perf_counter()
        name, label_file, rle = None, None, None
        if self.recipe.labels == "png":
            name = label_path(frame)
            label_file = (name, png_of_labels(model.labels))
        else:
            rle = encode_labels(model.labels, len(model))
        row = _frame_row(number, frame, seen, self.recipe, model) | {"labels": name}
        planes = [
            _plane_row(frame, label, plane, None if rle is None else rle[label - 1])
            for label, plane in enumerate(model.planes, start=1)
        ]
        end = time.perf_counter()
        times = (1e3 * (read - start), 1e3 * (detected - read), 1e3 * (end - detected))
        row |= dict(zip(TIMES, times, strict=True))
        return Outcome(
            number=number,
            frame=frame,
            record=_as_json({"frame": row, "planes": planes}),
            label_file=label_file,
            planes=len(model),
            shape=model.labels.shape,
            present=observed.image.present,
            out_of_range=2 * observed.count < observed.image.present,
            unit_told=unit_told(seen.depth, detector.depth_scale),
            noise_assumed=bool(assumed_noise(model.settings)),
            misread=doubt,
            milliseconds=times,
        )

    def _detector(self, seen: SourceFrame) -> Detector:
        from planewise.detect import Detector

        camera = self.recipe.camera or seen.camera
        if camera is None:
            raise no_camera("the frame")
        scale = seen.depth_scale if self.recipe.depth_scale is None else self.recipe.depth_scale
        key = (camera, scale)
        if key not in self._detectors:
            if len(self._detectors) == _DETECTORS:
                self._detectors.popitem(last=False)
            options = replace(self.recipe.options, threads=1)
            self._detectors[key] = Detector(
                camera,
                self.recipe.sensor,
                depth_scale=scale,
                **{each.name: getattr(options, each.name) for each in fields(options)},
            )
        self._detectors.move_to_end(key)
        return self._detectors[key]


def failure(number: int, frame: str, reason: str) -> Outcome:
    """Outcome of a frame that could not be done."""
    reason = reason.encode("utf-8", "backslashreplace").decode()  # it may name a file of any bytes
    row = {"frame": frame, "number": number, "status": FAILED, "reason": reason}
    record = _as_json({"frame": row, "planes": []})
    return Outcome(number=number, frame=frame, record=record, reason=reason)


def identity(seen: SourceFrame, recipe: Recipe) -> dict[str, Any]:
    """Columns that tell whether a frame is still what it was: readings, their unit, the camera."""
    camera = recipe.camera or seen.camera
    scale = seen.depth_scale if recipe.depth_scale is None else recipe.depth_scale
    return {
        "fingerprint": fingerprint(seen.depth),
        "depth_scale": None if seen.depth.dtype.kind == "f" else scale or recipe.sensor.resolution,
        **({} if camera is None else _camera_columns(camera)),
    }


def fingerprint(depth: NDArray[Any]) -> str:
    """Hash of readings, by which it shows that a frame is no longer what it was."""
    hashed = hashlib.sha256(f"{depth.dtype.str}{depth.shape}".encode())
    hashed.update(np.ascontiguousarray(depth).data)
    return hashed.hexdigest()[:32]


def _as_json(rows: dict[str, Any]) -> bytes:
    return json.dumps(rows, allow_nan=False, separators=(",", ":")).encode()


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _frame_row(
    number: int, frame: str, seen: SourceFrame, recipe: Recipe, model: PlaneModel
) -> dict[str, Any]:
    noise = model.settings.get("noise")
    return {
        "frame": frame,
        "number": number,
        "status": DONE,
        "width": model.labels.shape[1],
        "height": model.labels.shape[0],
        "readings": model.readings,
        "planes": len(model),
        "information": float(model.information),
        "curve": [number_or_none(each) for each in model.curve],
        "note": model.note,
        **identity(seen, recipe),
        "timestamp": getattr(seen, "timestamp", None),
        "noise": None if noise is None else json.dumps(noise),
    }


def _camera_columns(camera: Camera) -> dict[str, Any]:
    if not isinstance(camera, PinholeCamera) or camera.radial:
        return {"camera": json.dumps(camera.describe())}
    numbers = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    return numbers | {"distortion": [float(each) for each in camera.distortion]}


def _plane_row(frame: str, label: int, plane: Plane, rle: str | None) -> list[Any]:
    """Values in the order of `PLANES`."""
    covariance = np.asarray(plane.covariance).ravel()
    row = [
        frame,
        label,
        *plane.normal.tolist(),
        float(plane.distance),
        float(plane.information),
        int(plane.count),
        number_or_none(plane.rms),
        number_or_none(plane.significance),
        number_or_none(plane.residual_correlation),
        number_or_none(plane.area),
        *plane.centroid.tolist(),
        *(int(edge) for edge in plane.bounding_box),
        covariance.tolist() if np.isfinite(covariance).all() else None,
        rle,
    ]
    assert len(row) == len(PLANES)
    return row
