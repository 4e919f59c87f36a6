"""Images in which labels of pixels change, and what they see beyond the seams between sectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import labels as label_loops
from planewise.kernels.cells import SIDE
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors


@dataclass(frozen=True)
class Marks:
    """Images with a margin of a pixel in which labels change (`kernels.labels`).

    Attributes
    ----------
    label : ndarray of int16, shape (H + 2, M)
        With `kernels.labels.NONE`.
    state : ndarray of uint8, shape (H + 2, M)
        Whether a pixel waits for a look, or is fixed.
    busy, seen : ndarray of bool, shape (H + 2, M / CHUNK)
        Chunks of a row that hold pixels that wait, and that held some or lay beside a change.
    """

    label: NDArray[np.int16]
    state: NDArray[np.uint8]
    busy: NDArray[np.bool_]
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, shape: tuple[int, int], workspace: Workspace) -> Marks:
        """Arbitrary labels, every margin set."""
        chunks = -(-(shape[1] + 1 + SIDE) // label_loops.CHUNK)
        whole, parts = (shape[0] + 2, chunks * label_loops.CHUNK), (shape[0] + 2, chunks)
        marks = cls(
            label=workspace.empty(whole, np.int16),
            state=workspace.empty(whole, np.uint8),
            busy=workspace.empty(parts, np.bool_),
            seen=workspace.empty(parts, np.bool_),
        )
        for edge in (0, -1):
            marks.label[edge], marks.state[edge] = label_loops.NONE, label_loops.FIXED
        marks.busy[:] = False
        return marks

    def show_beyond(self, sectors: Sectors) -> None:
        """Let pixels beside a seam see the labels beyond it, as of planes in their own sector.

        Pixels of margins change their labels as those that they show do, from the same readings.
        """
        if not sectors.margin.size:
            return
        margin, beyond = sectors.margin + 1, sectors.beyond + 1
        label = self.label[:, beyond]
        first = (label - 1) // sectors.count * sectors.count + 1
        here = sectors.of_columns(sectors.margin)
        self.label[:, margin] = np.where(label > 0, first + here, label)
        self.state[:, margin] = self.state[:, beyond]
        # Cells say which pixels wait, and to cells a seam is the end of the image.
        ends = np.concatenate((sectors.start, sectors.stop))
        ends = np.concatenate((ends, ends + 1))
        self.state[:, ends] |= label_loops.WAITING
        chunks = np.unique(np.concatenate((margin, ends)) // label_loops.CHUNK)
        self.busy[1:-1, chunks] = True

    def hide_beyond(self, sectors: Sectors) -> None:
        """Leave margins without labels again."""
        if sectors.margin.size:
            self.label[:, sectors.margin + 1] = label_loops.NONE
