"""Label images as 16-bit PNG, and two tables: ``frames.csv`` and ``planes.csv``."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planewise.batch.columns import FRAMES, PLANES, TIMES
from planewise.batch.frame_names import safe_name
from planewise.batch.label_png import png_of_labels
from planewise.batch.source import SourceFrame
from planewise.batch.store import Store, StoredFrame
from planewise.exports.form import Form

_OTHER = ("status", "reason", "curve", "fingerprint", "labels", *TIMES)
_FRAME = tuple(name for name in FRAMES if name not in _OTHER)
_PLANE = tuple(name for name in PLANES if name not in ("frame", "covariance", "rle"))


class PngExport(Form):
    """``labels/ID.png``: 0 for no plane, j for the plane of label j; see `Form`."""

    def __init__(
        self, folder: Path, store: Store, ids: Sequence[str], *, pictures: bool = False
    ) -> None:
        super().__init__(folder, store, ids, pictures=pictures)
        self._frames = csv.writer(self.text("frames.csv"))
        self._planes = csv.writer(self.text("planes.csv"))
        self._frames.writerow((*_FRAME, "labels"))
        self._planes.writerow(("frame", *_PLANE))

    def add(self, frame: StoredFrame, seen: SourceFrame | None) -> None:
        """See `Form`."""
        labels = png_of_labels(frame.labels)  # not a copy: a damaged file is found here
        name = f"labels/{safe_name(frame.id, '.png')}"
        self.path(name).write_bytes(labels)
        self._frames.writerow([*(_cell(frame.row[each]) for each in _FRAME), name])
        for row in frame.plane_table.select(list(_PLANE)).to_pylist():
            self._planes.writerow([frame.id, *row.values()])

    def finish(self) -> None:
        """See `Form`."""


def _cell(value: Any) -> Any:
    """What a table of text can hold: lists, such as a distortion, as JSON."""
    return json.dumps(value) if isinstance(value, list) else value
