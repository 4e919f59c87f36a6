"""Predicted and true labels of the same frames, to be scored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from planewise.errors import PlanewiseError
from planewise.files.labels import (
    STORE_FILE,
    LabelFile,
    Labelled,
    label_images,
)
from planewise.files.result_names import LABELS, PARAMETERS
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.batch.store import Store


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Frames of two folders.

    Attributes
    ----------
    paired : tuple of (str, Path or Labelled, Path)
        Name, predicted and true file of the frames that both hold.
    only_predicted, only_true : tuple of str
        Names that the other folder lacks.
    """

    paired: tuple[tuple[str, Path | Labelled, Path], ...]
    only_predicted: tuple[str, ...] = ()
    only_true: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """Files of all pairs; a store's are not among them."""
        return [each for _, *both in self.paired for each in both if isinstance(each, Path)]


def pair_files(predicted: Path, truth: Path) -> Pairs:
    """Pair two files, or the files of two folders by name without ending.

    Parameters
    ----------
    predicted, truth : Path
        Label images, or folders of them. A subfolder with a ``labels.png``, as `planewise detect`
        writes one for each frame, is the frame of the subfolder's name. A folder that `planewise
        detect` wrote for one image is one file, its ``labels.png``. `predicted` may be a store
        that `planewise batch` wrote.

    Raises
    ------
    PlanewiseError
        If one is missing, a file where the other is a folder, if the truth is a store, a folder
        holds two files for one frame, or if no frame is in both.
    """
    for name, path in (("predicted", predicted), ("truth", truth)):
        if not path.exists():
            raise PlanewiseError(f"{name}: there is no file or folder {path}")
    if (truth / STORE_FILE).is_file():
        raise PlanewiseError(
            f"truth: {truth} is a store, which only PRED may be; give a folder of label images, "
            f"such as OUT/labels of 'planewise export {truth} --format png -o OUT'"
        )
    predicted, truth = _label_image(predicted), _label_image(truth)
    if (predicted / STORE_FILE).is_file():
        return pair_store(predicted, truth)
    if predicted.is_dir() != truth.is_dir():
        name, path = ("predicted", predicted) if predicted.is_dir() else ("truth", truth)
        raise PlanewiseError(
            f"{name} is a folder of frames and the other is one frame; give two of a kind"
            f"{_of_one_image(path)}"
        )
    if not predicted.is_dir():
        return Pairs(paired=((_stem(truth), predicted, truth),))
    found, true = label_images(predicted), label_images(truth)
    pairs = Pairs(
        paired=tuple((stem, found[stem], true[stem]) for stem in true if stem in found),
        only_predicted=tuple(stem for stem in found if stem not in true),
        only_true=tuple(stem for stem in true if stem not in found),
    )
    if not pairs.paired:
        raise PlanewiseError(
            f"no frame is in both folders: {predicted} has {counted(len(found), 'label image')}"
            f"{_such_as(tuple(found))}, {truth} has {len(true)}{_such_as(tuple(true))}; their "
            "names (without ending) must agree"
            f"{_of_one_image(predicted)}"
        )
    return pairs


def _label_image(path: Path) -> Path:
    """Label image of a folder that holds the result of one image and no others; else the path."""
    alone = all((path / name).is_file() for name in (LABELS, PARAMETERS))
    return path / LABELS if alone and not any(path.glob(f"*/{LABELS}")) else path


def _of_one_image(folder: Path) -> str:
    """What to give in place of a folder that holds the result of one image."""
    return f", or {folder / LABELS} for one image" if (folder / LABELS).is_file() else ""


def _such_as(names: Sequence[str]) -> str:
    return f" such as {names[0]}" if names else ""


def _stem(path: Path) -> str:
    return path.parent.name if path.name == LABELS and path.parent.name else path.stem


@dataclass(frozen=True)
class StoredLabels:
    """Labels and planes of one frame of a store."""

    store: Store
    frame: str

    def __str__(self) -> str:
        return f"the frame {self.frame} of {self.store.path}"

    def read(self) -> LabelFile:
        """Read them."""
        frame = self.store[self.frame]
        return LabelFile(labels=frame.labels, planes=frame.planes)


def pair_store(folder: Path, truth: Path) -> Pairs:
    """Pair the frames of a store with the label images of a folder, by id and name without ending.

    The name may also be that which a store gives the frame's own file.

    Raises
    ------
    PlanewiseError
        If `truth` is no folder, a table of the store is damaged, a label image has the id of one
        frame and the file name of another, or no frame is in both.
    """
    if not truth.is_dir():
        raise PlanewiseError(
            f"truth: {truth} is no folder of frames; the predicted labels are a store"
        )
    from planewise.batch.frame_names import safe_name
    from planewise.batch.store import Store

    store, true = Store(folder), label_images(truth)
    for _ in store:  # so that a damaged table is told once, and not with each of its frames
        pass
    names = {each: each if each in true else safe_name(each, "") for each in store.ids}
    frames: dict[str, str] = {}
    for each, name in names.items():
        other = frames.setdefault(name, each)
        if other != each and name in true:
            raise PlanewiseError(
                f"truth: {true[name]} may be that of the frame {other!r} of the store, or of "
                f"{each!r}; name label images by the ids of their frames"
            )
    pairs = Pairs(
        paired=tuple(
            (each, StoredLabels(store, each), true[name])
            for each, name in names.items()
            if name in true
        ),
        only_predicted=tuple(each for each, name in names.items() if name not in true),
        only_true=tuple(each for each in true if each not in frames),
    )
    if not pairs.paired:
        raise PlanewiseError(
            f"no frame is in both: the store {folder} has {counted(len(store), 'frame')}"
            f"{_such_as(store.ids)}, {truth} has {counted(len(true), 'label image')}"
            f"{_such_as(tuple(true))}; ids and names (without ending) must agree"
        )
    return pairs
