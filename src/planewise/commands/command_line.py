"""What the commands have in common: how they report, and how they are given a sensor."""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from planewise import sensors
from planewise.commands import terminal
from planewise.commands.exit_codes import FAILED
from planewise.commands.interrupts import interrupted
from planewise.errors import NO_ROOM, PlanewiseError
from planewise.files.camera import camera_file, read_sensor, without_radial
from planewise.sensor import Sensor

if TYPE_CHECKING:
    from planewise.partition import Partitioner

_MILLIMETRE = 0.001  # metres
_NO_THREAD = "can't start new thread"  # by which alone Python tells it from other errors


class _OnStderr(logging.Handler):
    """Shows what the library logs, such as that the first run has to compile."""

    def emit(self, record: logging.LogRecord) -> None:
        terminal.notice(record.getMessage())


@contextmanager
def reported() -> Iterator[None]:
    """Turn what a user can put right into one line on stderr and exit code 2."""
    log = logging.getLogger("planewise")
    log.handlers, log.propagate = [_OnStderr(logging.WARNING)], False
    try:
        yield
    except ValueError as error:
        terminal.error(str(error))
    except MemoryError:
        terminal.error("there is not enough memory for this input")
    except RuntimeError as error:
        if str(error) != _NO_THREAD:
            raise
        terminal.error(
            "no more threads can be started: memory is short, or their number is limited (ulimit)"
        )
    except BrokenPipeError:  # which what reads the output has closed: no error of ours
        raise
    except OSError as error:
        if error.errno in NO_ROOM:
            terminal.error(f"output: there is no room left for the results ({error.strerror})")
        else:
            terminal.error(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        terminal.error("interrupted; nothing was left half-written")
        raise typer.Exit(interrupted()) from None
    else:
        return
    raise typer.Exit(FAILED)


def preset_of(camera: str | None) -> str | None:
    """Name of the sensor preset that a camera's preset shares, or begins with."""
    name = "" if camera is None else without_radial(camera.lower())
    return next(
        (each for each in sensors.PRESETS if name == each or name.startswith(f"{each}-")), None
    )


def sensor_of(
    name: str | None,
    camera: str | None,
    noise: str | None,
    max_depth: float | None,
    resolution: float | None,
) -> Sensor:
    """Sensor as asked for; where it is not named, that of the camera, or one with given noise."""
    if name is None:
        name = preset_of(camera)
    if name is None and noise is None:
        raise PlanewiseError(
            f"sensor: give --sensor as one of {', '.join(sensors.PRESETS)}, or at least --noise"
        )
    return read_sensor(name, noise=noise, max_depth=max_depth, resolution=resolution)


def check_seed(seed: int) -> None:
    """Refuse a seed that is none."""
    if seed < 0:
        raise PlanewiseError(f"seed must not be negative, got {seed}")


def read_size(size: str, sides: range, example: str) -> tuple[int, int]:
    """Height and width of a synthetic image from a size such as 640x480."""
    found = re.fullmatch(r"(\d+)\s*[x×]\s*(\d+)", size.strip().lower())
    width, height = (int(side) for side in found.groups()) if found else (0, 0)
    if width not in sides or height not in sides:
        raise PlanewiseError(
            f"size: expected width x height such as {example}, each {sides[0]} to {sides[-1]} "
            f"pixels, got {size!r}"
        )
    return height, width


def of_samples(
    search: str,
    confidence: float | None,
    inlier_ratio: float | None,
    partition: str | None,
) -> dict[str, Any]:
    """Options of the sequential search as far as they are given.

    The joint one takes no samples, and in the regions of a partition the paper's numbers hold.
    """
    given = {"confidence": confidence, "inlier_ratio": inlier_ratio}
    out = {name: value for name, value in given.items() if value is not None}
    if out and (search != "sequential" or partition is not None):
        raise PlanewiseError(
            f"{next(iter(out))} goes with --search sequential without a --partition"
        )
    return out


def check_output(
    path: Path, ending: str, inputs: Iterable[Path | str | None], option: str = "output"
) -> None:
    """Refuse a file that cannot be written, or that is one of the inputs."""
    if path.is_dir():
        raise PlanewiseError(f"{option}: {path} is a folder; give the name of a {ending} file")
    if path.suffix.lower() != ending:
        raise PlanewiseError(f"{option}: expected a {ending} file, got {path.name}")
    check_kept([path], inputs, option)
    parent = next((each for each in path.parents if each.exists()), path.parent)
    if not (parent.is_dir() and os.access(parent, os.W_OK | os.X_OK)):
        raise PlanewiseError(f"{option}: {parent} is not a folder that can be written to")


def check_kept(
    written: Iterable[Path], inputs: Iterable[Path | str | None], option: str = "output"
) -> None:
    """Refuse to write over what is read; presets and numbers, which name no file, do no harm."""
    targets = {each.resolve() for each in written}
    for each in inputs:
        if each is not None and Path(camera_file(str(each))).resolve() in targets:
            raise PlanewiseError(f"{option}: {each} would be written over; choose another place")


def partition_of(
    partition: str | None, model: str | None, device: str | None
) -> tuple[Partitioner | None, Path | None]:
    """Partition as asked for: one that has a name, or else the file or folder of it."""
    if partition != "sam" and (model is not None or device is not None):
        raise PlanewiseError("partition: --sam-model and --sam-device go with --partition sam")
    if partition is None:
        return None, None
    from planewise.partition import NAMES, SegmentAnything, as_partitioner

    if partition == "sam":
        sam = SegmentAnything()
        return replace(sam, model=model or sam.model, device=device or sam.device), None
    if partition in NAMES:
        return as_partitioner(partition), None
    if not Path(partition).exists():
        raise PlanewiseError(
            f"partition: expected {', '.join(NAMES)}, or a file or folder; there is none named "
            f"{partition}"
        )
    return None, Path(partition)


def unusual_unit(unit: float) -> str:
    """What is to be said where whole numbers are read in units of a sensor's resolution."""
    if math.isclose(unit, _MILLIMETRE):
        return ""
    return (
        f"whole numbers are taken in units of {1000 * unit:g} mm, the sensor's resolution; "
        "if they are millimetres, say so (depth_scale = 0.001)"
    )
