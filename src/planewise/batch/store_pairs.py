"""Frames of a store beside their true labels, to be scored."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planewise.batch.frame_names import safe_name
from planewise.batch.store import Store
from planewise.errors import PlanewiseError
from planewise.label_files import LabelFile, Pairs, label_images


@dataclass(frozen=True)
class StoredLabels:
    """Labels and planes of one frame of a store."""

    store: Store
    frame: str

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
        If `truth` is no folder, or no frame is in both.
    """
    if not truth.is_dir():
        raise PlanewiseError(f"truth: {truth} is not a folder; the predicted labels are a store")
    store, true = Store(folder), label_images(truth)
    names = {each: each if each in true else safe_name(each, "") for each in store.ids}
    known = set(names.values())
    pairs = Pairs(
        paired=tuple(
            (each, StoredLabels(store, each), true[name])
            for each, name in names.items()
            if name in true
        ),
        only_predicted=tuple(each for each, name in names.items() if name not in true),
        only_true=tuple(each for each in true if each not in known),
    )
    if not pairs.paired:
        raise PlanewiseError(
            f"no frame is in both: the store {folder} has {len(store)} frames, {truth} has "
            f"{len(true)} label images; ids and names (without ending) must agree"
        )
    return pairs
