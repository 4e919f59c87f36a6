"""Segments from cells: neighbours are merged where they are one plane.

Two become one where the evidence that they are one plane and the border that disappears outweigh
their discord; squares of cells that clearly are one plane are joined at once before.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import borders, squares
from planewise.kernels import forms as comparing
from planewise.kernels import segments as loops
from planewise.kernels.cells import COUNT, FREE, SEGMENT, SIDE
from planewise.runtime import threads
from planewise.runtime.workspace import Workspace
from planewise.sectors import Sectors
from planewise.spatial.cells import Cells
from planewise.spatial.frame_error import FrameError
from planewise.spatial.seams import Neighbours, neighbours
from planewise.spatial.segments import Segments
from planewise.spatial.units import sector_of_units

Array = NDArray[np.float64]
Border = tuple[float, float, float]  # as `kernels.borders.border_price` takes it

# Price where error is white, and where it drifts (`FrameError.drifting`): nats per pixel where the
# surface breaks and where it goes on, and the discord half-way.
_MERGE_BORDER = (0.7, 2.0, 8.0), (0.7, 2.0, 10.0)  # that a merge saves
_COARSE = 0.25  # power of an image's pixels that its price falls with, where error drifts
_FITTED_AWAY = 1.5  # half the mean of chi^2 with three degrees of freedom: what a free plane fits
_SHARE_POWER = 0.25  # cells of few pixels are worth less: the surface about them is one
_WHOLE = 64.0  # pixels of a cell whose error is its own in a fine image (`_shares`)
_TAILS = 4.0, 2.5  # degrees of freedom of the error of one cell of 6 x 6 pixels (`_tails`)
_ACROSS = 0.4  # pixels^2: error across the image with which they are the fewest
_SAME = 11.34  # discord up to which squares are joined at once: chi^2 of three, 99 %
# Times 3 ln(R / eps), all that a merge saves of a border: where error drifts, and at most.
_LONGEST = 6.0, 20.0
_UNIT = 2 * SIDE  # pixels to a side of most units
_LEVELS = 3  # such squares have at most 6 x 2^3 pixels to a side


def merged(
    cells: Cells,
    sectors: Sectors,
    cost: float,
    workspace: Workspace,
    grid: NDArray[np.int32] | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> tuple[Segments, Neighbours]:
    """Merge neighbouring cells into segments; those of `grid` only, where it is given.

    Returns which cells are neighbours, too.
    """
    grid = cells.grid if grid is None else grid
    forms = workspace.empty((len(cells.rows), comparing.FORM))
    comparing.write_forms(cells.rows, cells.drift, sectors.lean, forms)
    right = workspace.empty(cells.squares.shape)
    below = workspace.empty(cells.squares.shape)
    comparing.square_discords(cells.squares, forms, right, below)
    tails = _tails(cells.error)
    segments, shapes = _joined_squares(cells, sectors, grid, forms, right, tails, workspace)
    discords = workspace.empty((2, *cells.grid.shape))
    sides = borders.border_discords(
        cells.grid, cells.whole, segments.of_unit, forms, right, below, discords
    )
    beside = neighbours(cells, grid, segments.of_unit, discords, sides, sectors)
    price, longest = _merge_border(segments.rows, cells.error, _fineness(sectors), cost)
    ints, floats = loops.room(beside.sides, len(segments.rows))
    roots, segment = np.empty((2, len(segments.rows)), np.int32)
    with workspace.stage(), threads.beside(meanwhile or _nothing_else):
        found = loops.agglomerate(
            segments.of_cell(beside.grid, workspace),
            beside.discords,
            price,
            segments.rows,
            shapes,
            segments.drift,
            sectors.lean,
            segments.offset_prior,
            segments.slope_prior,
            segments.home,
            sectors.turns,
            beside.wraps,
            cost,
            longest,
            tails,
            roots,
            segment,
            workspace.empty(ints, np.int32),
            workspace.empty(floats),
        )
    return segments.kept(roots[:found], segment), beside


def _joined_squares(
    cells: Cells,
    sectors: Sectors,
    grid: NDArray[np.int32],
    forms: Array,
    right: Array,
    tails: float,
    workspace: Workspace,
) -> tuple[Segments, Array]:
    """Units of `grid`, and what squares of them are at once, and their forms."""
    count = len(cells.rows)
    free, drift = workspace.empty(count), workspace.copy(cells.drift)
    comparing.free_prices(
        forms,
        cells.offset_prior,
        cells.slope_prior,
        cells.rows[:, COUNT],
        _FITTED_AWAY,
        _shares(_fineness(sectors)),
        free,
    )
    root, square = np.empty(count, np.int32), workspace.empty(count, np.int32)
    joined = workspace.empty((count // 4, SEGMENT)), workspace.empty((count // 4, comparing.FORM))
    left = squares.join_blocks(
        grid, cells.whole, right, cells.rows, forms, free, drift, sectors.lean, _SAME, _LEVELS,
        tails, root, square, *joined,
    )  # fmt: skip
    home = np.zeros(left, np.int32)
    if sectors.count > 1:
        home = sector_of_units(cells, sectors)[root == np.arange(count)]
    rows, shapes = workspace.empty((left, SEGMENT)), workspace.empty((left, comparing.FORM))
    numbers = workspace.empty((3, left))
    squares.keep_roots(
        root, square, cells.rows, forms, free, *joined, drift, cells.offset_prior,
        cells.slope_prior, np.empty(count, np.int32), rows, shapes, numbers,
    )  # fmt: skip
    segments = Segments(
        rows=rows,
        drift=numbers[0],
        offset_prior=numbers[1],
        slope_prior=numbers[2],
        home=home,
        of_unit=root,
    )
    return segments, shapes


def _fineness(sectors: Sectors) -> float:
    """Pixels against those of a fine image; range images, which hardly profit, count as fine."""
    return sectors.fineness if sectors.count == 1 else 1.0


def _shares(fineness: float) -> Array:
    """What units of 0, 1 ... pixels are worth; in an image of few, each sees more of a surface."""
    pixels = np.arange((2 * SIDE) ** 2 + 1) / (_WHOLE * math.sqrt(fineness))
    return np.minimum(pixels, 1.0) ** _SHARE_POWER


def _tails(error: FrameError) -> float:
    """Degrees of freedom of the error of one cell.

    A sensor that errs across the image as well, as one that matches windows does, mixes what is
    near an edge or a crease: the cells there lie far off their plane.
    """
    usual, fewest = _TAILS
    return usual + min(1.0, error.lateral / _ACROSS) * (fewest - usual)


def _merge_border(
    segments: Array, error: FrameError, fineness: float, cost: float
) -> tuple[Border, float]:
    """What a merge saves of a border: its price, and the most of it.

    The cells on both sides cost no more if they are free. Where the error drifts, and as surfaces
    lean, the discord of wide segments stops to grow with them, and so does what their border is
    worth. In an image of few pixels an error drifts more from one to the next, and so does discord.
    """
    low, high, knee = between(_MERGE_BORDER, error.drifting)
    free = float(segments[:, FREE].sum() / segments[:, COUNT].sum())  # nats per pixel
    coarse = fineness ** (-_COARSE * error.drifting)
    price = coarse * low, coarse * max(low, min(high, 2 * _UNIT * free)), knee
    few, most = _LONGEST
    return price, cost * (most if few > most * error.drifting else few / error.drifting)


def between(prices: tuple[Border, Border], drifting: float) -> Border:
    """Price of borders in a frame whose error drifts, 0 ... 1."""
    low, high, knee = (a + drifting * (b - a) for a, b in zip(*prices, strict=True))
    return low, high, knee


def _nothing_else() -> None:
    pass
