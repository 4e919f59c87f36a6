"""Instances as COCO has them: ``annotations.json``, of one category, with masks as run lengths.

Masks are run lengths, not polygons: a polygon of COCO has no holes, and planes that are seen
through gaps have many. Beyond the format's own keys, an image has ``frame`` (its id) and
``camera``, an annotation ``plane`` (normal, distance) and ``information`` in nats.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from planewise._version import __version__
from planewise.batch.frame_names import safe_name
from planewise.batch.source import SourceFrame
from planewise.batch.store import Store, StoredFrame
from planewise.batch.stored_camera import description_of
from planewise.drawing.overlay import match_picture
from planewise.errors import PlanewiseError
from planewise.exports.form import Form
from planewise.files.coco_rle import encode_labels
from planewise.results.image import write_image

_PLANE = {"id": 1, "name": "plane", "supercategory": "surface"}


class CocoExport(Form):
    """``annotations.json``, and ``images/ID.png`` if pictures are wanted; see `Form`."""

    places_pictures = True

    def __init__(
        self, folder: Path, store: Store, ids: Sequence[str], *, pictures: bool = False
    ) -> None:
        super().__init__(folder, store, ids, pictures=pictures)
        self._annotated = 0
        self._written = 0
        info = {
            "description": f"Planes of {store.info['source']['name']}",
            "contributor": f"planewise {__version__}",
        }
        head = {"info": info, "licenses": [], "categories": [_PLANE]}
        self._file = self.text("annotations.json")
        self._file.write(json.dumps(head)[:-1] + ',\n"images": [')
        # Two lists grow at a time, and a file at one end only: the second waits beside it.
        self._waiting = self._files.enter_context(TemporaryFile("w+", dir=folder))  # noqa: SIM115

    def add(self, frame: StoredFrame, seen: SourceFrame | None) -> None:
        """See `Form`."""
        masks = self._masks(frame)
        name = f"images/{safe_name(frame.id, '.png')}"
        if self.pictures:
            if seen is None or seen.rgb is None:
                raise PlanewiseError(f"frame {frame.id}: the source has no picture of it")
            height, width = frame.row["height"], frame.row["width"]
            write_image(self.path(name), match_picture(seen.rgb, (height, width)))
        image = self._image(frame, name)
        _append(self._file, image, first=not self._written)
        self._written += 1
        for annotation in masks:
            self._annotated += 1
            numbered = {"id": self._annotated, "image_id": image["id"], **annotation}
            _append(self._waiting, numbered, first=self._annotated == 1)

    @staticmethod
    def _image(frame: StoredFrame, name: str) -> dict[str, Any]:
        row = frame.row
        return {
            "id": row["number"] + 1,
            "file_name": name,
            "width": row["width"],
            "height": row["height"],
            "frame": frame.id,
            "camera": description_of(row),
        }

    @staticmethod
    def _masks(frame: StoredFrame) -> list[dict[str, Any]]:
        """Annotations of a frame but for their numbers; planes without a pixel have none."""
        height, width, count = frame.row["height"], frame.row["width"], frame.row["planes"]
        labels = frame.labels
        texts = frame.plane_table["rle"].to_pylist()
        if None in texts:
            texts = encode_labels(labels, count)
        pixels = np.bincount(labels.ravel(), minlength=count + 1)[1:].tolist()
        found = []
        planes = frame.planes.tolist()
        for label, row in enumerate(frame.plane_table.drop(["rle", "covariance"]).to_pylist()):
            if not pixels[label]:
                continue
            top, left, bottom, right = (row[each] for each in ("top", "left", "bottom", "right"))
            if right > width:  # across the end of a panorama
                columns = np.flatnonzero((labels == label + 1).any(axis=0))
                left, right = int(columns[0]), int(columns[-1]) + 1
            annotation = {
                "category_id": _PLANE["id"],
                "iscrowd": 0,
                "area": pixels[label],
                "bbox": [left, top, right - left, bottom - top],
                "segmentation": {"size": [height, width], "counts": texts[label]},
                "plane": planes[label],
                "information": row["information"],
            }
            found.append(annotation)
        return found

    def finish(self) -> None:
        """See `Form`."""
        self._file.write('],\n"annotations": [')
        self._waiting.seek(0)
        shutil.copyfileobj(self._waiting, self._file, 1 << 20)
        self._file.write("]}\n")


def _append(file: IO[str], each: dict[str, Any], *, first: bool) -> None:
    file.write(("\n" if first else ",\n") + json.dumps(each, separators=(",", ":")))
