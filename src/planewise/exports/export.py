"""Frames of a store through a format into a folder, which is there whole or not at all."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from planewise.batch.source import Selection
from planewise.batch.store import Store, StoredFrame
from planewise.batch.store_info import check_outside
from planewise.batch.stored_source import StoredSource
from planewise.errors import PlanewiseError, SetupError
from planewise.exports.form import Form
from planewise.whole_files import output_folder

_LOG = logging.getLogger("planewise")


@dataclass(frozen=True, kw_only=True)
class Exported:
    """What became of a frame; `reason` says why it is not there, and is empty if it is."""

    frame: str
    reason: str = ""


def export(
    store: Store,
    form: type[Form],
    output: Path,
    *,
    selection: Selection | None = None,
    source: StoredSource | None = None,
    pictures: bool = False,
) -> Iterator[Exported]:
    """Write frames; the iterator does it, and the folder is there when it is at its end.

    Parameters
    ----------
    store : Store
        Results of ``planewise batch``.
    form : type of Form
        One of the values of `planewise.exports.FORMATS`.
    output : Path
        New or empty folder.
    selection : Selection, optional
        Which of the frames that are done; ``None`` means all.
    source : StoredSource, optional
        What the store was made from, for formats that take readings or pictures.
    pictures : bool
        Write the pictures of frames, too.

    Yields
    ------
    Exported
        For every frame, once it is written or left out.

    Raises
    ------
    PlanewiseError
        If the output cannot be used, or no frame can be written; there is no folder then.
    """
    ids = [each for _, each in (selection or Selection()).of(store.ids)]
    if not ids:
        raise PlanewiseError(f"store: {store.path} holds no frames that are done")
    if form.needs_source or pictures:
        if source is None:
            raise PlanewiseError("source: this format takes the frames themselves")
        if source.missing:
            raise PlanewiseError(f"{source.missing}; give --source")
    if pictures and not form.places_pictures:
        raise PlanewiseError("pictures: to take them or not is a choice of the format coco alone")
    check_outside(store.path, output)
    if output.is_dir() and any(output.iterdir()):
        raise PlanewiseError(f"output: the folder {output} is not empty; give a new one")
    reads = source if form.needs_source or pictures else None
    if reads is not None and not reads.registered:
        _LOG.warning(
            f"the pictures of {store.info['source']['name']} are of a camera beside the depth "
            "camera: they are written as they are, and planes lie some pixels off what they show"
        )
    written, reason = 0, ""
    with (
        output_folder(output) as folder,
        closing(form(folder, store, ids, pictures=pictures)) as writer,
    ):
        for frame in store.chosen(ids):
            done = _one(writer, frame, reads)
            written += not done.reason
            reason = reason or done.reason
            yield done
        writer.finish()
        if not written:
            raise PlanewiseError(f"no frame could be exported; the first: {reason}")


def _one(writer: Form, frame: StoredFrame, source: StoredSource | None) -> Exported:
    try:
        writer.add(frame, None if source is None else source[frame])
    except SetupError:
        raise
    except PlanewiseError as error:
        writer.left_out(frame)
        return Exported(frame=frame.id, reason=str(error))
    return Exported(frame=frame.id)
