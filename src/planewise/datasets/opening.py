"""One call that opens any dataset, and finds out which kind it is."""

from __future__ import annotations

import inspect
import tarfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from planewise.arguments import checked_scale
from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.collection import BETWEEN, Collection, PointCollection
from planewise.datasets.frames import Dataset, PointDataset
from planewise.datasets.generic import GenericFolder
from planewise.datasets.hypersim import Hypersim
from planewise.datasets.icl_nuim import IclNuim, IclNuimRendered
from planewise.datasets.lidar import LidarFolder
from planewise.datasets.nyu import NyuFolder, NyuLabelled
from planewise.datasets.nyu_raw import NyuRaw
from planewise.datasets.paths import inside, listed
from planewise.datasets.redwood import RedwoodFolder
from planewise.datasets.ros import TOPICS, RosDepth, RosPoints
from planewise.datasets.scannet import ScanNetFolder
from planewise.datasets.sens import SensFile
from planewise.datasets.seven_scenes import SevenScenes
from planewise.datasets.tum import TumSequence
from planewise.errors import PlanewiseError, SetupError
from planewise.files.depth import is_depth_file
from planewise.own_camera import checked_camera
from planewise.wording import counted

Reader = type[Dataset] | type[PointDataset]
Part = Dataset | PointDataset | str

READERS: tuple[Reader, ...] = (
    NyuLabelled,
    SensFile,
    RosDepth,
    RosPoints,
    TumSequence,
    IclNuim,
    IclNuimRendered,
    SevenScenes,
    Hypersim,
    ScanNetFolder,
    RedwoodFolder,
    GenericFolder,
    NyuRaw,
    ArchiveFolder,
    LidarFolder,
    NyuFolder,
)
"""Formats, in the order in which they are tried: what only one has comes first."""

KINDS = tuple(reader.kind for reader in READERS)
"""Names of the formats."""

_DEEPEST = 2  # folders below a folder in which datasets are looked for
_SHOWN = 8  # names of what a folder holds, in messages


def open(path: str | Path, kind: str | None = None, **options: Any) -> Dataset | PointDataset:
    """Open a dataset of any known kind; frames are read when they are asked for.

    Parameters
    ----------
    path : path
        A folder or a file.
    kind : str, optional
        One of `KINDS`; ``None`` means whichever the contents look like.
    options
        Of the format's class, such as ``camera``; those that are ``None`` are left out.

    Returns
    -------
    Dataset or PointDataset
        Of depth images, or of points.

    Raises
    ------
    PlanewiseError
        If it is of no known kind (the message lists them), or cannot be used.
    ValueError
        If the kind has no such option, or it takes no such value.
    """
    return open_offered(path, kind, options, ())


def open_offered(
    path: str | Path, kind: str | None, options: Mapping[str, Any], offered: Sequence[str]
) -> Dataset | PointDataset:
    """Like `open`; of options named in `offered` those are left out that the kind has not."""
    path = Path(path)
    if not path.exists():
        raise PlanewiseError(f"data: there is no file or folder {path}")
    if path.name in ("", ".."):
        path = path.resolve()  # messages want a name
    given = {name: value for name, value in options.items() if value is not None}
    _check(given)
    if kind is not None:
        return _opened_as(_named(kind), path, given, offered)
    reader = reader_of(path)
    if reader is not None:
        return _opened(reader, path, given, offered)
    parts = _parts(path, given, _DEEPEST)
    opened = [type(part) for part in parts.values() if not isinstance(part, str)]
    if opened:
        # What could not be opened may be of any kind.
        kinds = opened if len(opened) == len(parts) else READERS
        known = {name for each in kinds for name in _options_of(each)}
        if unknown := given.keys() - known - set(offered):
            held = _words(sorted({each.kind for each in opened}))
            raise ValueError(f"{min(unknown)} is no option of what {path} holds: {held}")
        return _collected(path, parts)
    if path.is_file() and is_depth_file(path):
        raise PlanewiseError(f"data: {path} is one depth image, no dataset; give its folder")
    if path.is_file() and (zipfile.is_zipfile(path) or tarfile.is_tarfile(path)):
        raise PlanewiseError(f"data: {path} is an archive; unpack it and give the folder")
    if path.is_dir() and not any(path.iterdir()):
        raise PlanewiseError(f"data: {path} is an empty folder")
    images = path / "depth" if (path / "depth").is_dir() else path
    if holds_depth_images(images):
        raise _without_camera(path, images)
    if parts:
        name, why = next(iter(parts.items()))
        all_of_them = "none of which can" if len(parts) > 1 else "which cannot"
        raise PlanewiseError(
            f"data: {path} holds {counted(len(parts), 'dataset')}, {all_of_them} be opened; "
            f"{name}: {str(why).removeprefix('data: ')}"
        )
    looked = "; ".join(f"{each.kind} = {each.holds}" for each in (*READERS, Collection))
    raise PlanewiseError(
        f"data: {path} ({_contents(path)}) is no dataset of a known kind; looked for {looked}"
    )


def _check(given: Mapping[str, Any]) -> None:
    """Refuse values that no reader takes, before something is read by them."""
    if "camera" in given:
        checked_camera(given["camera"])
    checked_scale(given.get("depth_scale"))
    for name in TOPICS:
        if not isinstance(given.get(name, ""), str):
            raise ValueError(f"{name} must be a string, got {given[name]!r}")


def reader_of(path: Path) -> Reader | None:
    """Class that reads what is there; ``None`` where no format is recognised."""
    return next((reader for reader in READERS if reader.recognises(path)), None)


def holds_depth_images(folder: Path) -> bool:
    """Whether it is a folder of depth images, other files aside."""
    return folder.is_dir() and any(map(is_depth_file, folder.iterdir()))


def _without_camera(path: Path, images: Path) -> PlanewiseError:
    return PlanewiseError(
        f"data: {path} ({_contents(path)}) is no dataset of a known kind, for nothing states its "
        "camera: put the images into a folder depth/ with camera.json beside it, or give "
        f"{images} to 'planewise detect' or 'batch' with --camera"
    )


def _options_of(reader: Reader) -> list[str]:
    """Names of a reader's options: what it has beside the path."""
    return list(inspect.signature(reader).parameters)[1:]


def _opened(
    reader: Reader, path: Path, given: Mapping[str, Any], offered: Sequence[str]
) -> Dataset | PointDataset:
    known = _options_of(reader)
    unknown = [name for name in given if name not in known and name not in offered]
    if unknown:
        raise ValueError(
            f"{unknown[0]} is no option of the kind {reader.kind!r}; it has {_words(known)}"
        )
    make: Callable[..., Dataset | PointDataset] = reader
    return make(path, **{name: given[name] for name in known if name in given})


def _opened_as(
    reader: Reader, path: Path, given: Mapping[str, Any], offered: Sequence[str]
) -> Dataset | PointDataset:
    """Open what was called by a kind; where it does not look like it, errors say so."""
    try:
        return _opened(reader, path, given, offered)
    except SetupError:
        raise
    except (PlanewiseError, OSError) as error:
        if reader.recognises(path):
            raise
        reason = str(error).removeprefix("data: ")
        if isinstance(error, OSError):
            reason = f"{error.filename}: {error.strerror}"
        raise PlanewiseError(
            f"data: {path} cannot be opened as the kind {reader.kind!r} ({reason})"
        ) from None


def _named(kind: str) -> Reader:
    found = next((reader for reader in READERS if reader.kind == kind), None)
    if found is None:
        raise PlanewiseError(f"kind must be one of {_words(KINDS)}, got {kind!r}")
    return found


def _parts(root: Path, given: Mapping[str, Any], deep: int) -> dict[str, Part]:
    """Datasets below a folder by name, in natural order; those that cannot be opened by why."""
    found: dict[str, Part] = {}
    for path in listed(root, lambda path: True) if root.is_dir() else ():
        try:
            reader = reader_of(inside(root, path.name))
            if reader is not None:
                found[path.name] = _opened(reader, path, given, list(given))
            elif holds_depth_images(path / "depth"):
                raise _without_camera(path, path / "depth")
        except SetupError:
            raise
        except (PlanewiseError, OSError) as error:
            found[path.name] = str(error)
            continue
        if reader is None and deep > 1 and path.is_dir():
            below = _parts(path, given, deep - 1)
            found |= {f"{path.name}{BETWEEN}{name}": part for name, part in below.items()}
    return found


def _collected(path: Path, parts: Mapping[str, Part]) -> Dataset | PointDataset:
    depth = {name: part for name, part in parts.items() if not isinstance(part, PointDataset)}
    points = {name: part for name, part in parts.items() if not isinstance(part, Dataset)}
    if len(depth) == len(parts):
        return Collection(path.name, depth, path)
    if len(points) == len(parts):
        return PointCollection(path.name, points)
    raise PlanewiseError(
        f"data: {path} holds both depth images and points; open its parts, {_words(list(parts))}"
    )


def _contents(path: Path) -> str:
    if path.is_file():
        return "a file"
    names = sorted(each.name + "/" * each.is_dir() for each in path.iterdir())
    more = " ..." if len(names) > _SHOWN else ""
    return f"it holds {', '.join(names[:_SHOWN])}{more}"


def _words(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
