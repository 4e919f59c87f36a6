"""Bends: three blocks of pixels in a row, and how far they are from being on one plane."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planewise.kernels import medians
from planewise.kernels import waves as kernels
from planewise.sectors import Sectors
from planewise.waves.waves import Along

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_LAGS = np.array([1, 2, 4])  # blocks from the middle of three in a row to the others
_SIDES = 6, 3  # pixels of blocks, and in images of fewer than ...
_SMALL = 100_000  # ... pixels
_ENOUGH = 10_000  # about so many tell
_AROUND = 4  # blocks to both sides of the middle one that say how it leans
_LEANING = 0.8  # usual bends that w has to differ by there
_WIDEST = 3.0  # usual bends: those of as much count a fourth
_TINY = 1e-30


@dataclass(frozen=True)
class Bends:
    """Blocks of pixels, and how three of them in a row are bent.

    Attributes
    ----------
    w, stretch : ndarray, shape (blocks,)
        Inverse depth, 0 where readings are missing, and range / depth.
    index : ndarray of int32, shape (3, n)
        First, middle and last block.
    bend, variance : ndarray, shape (n,)
        2 w_b - w_a - w_c, and what independent errors as described make of it.
    lean : ndarray, shape (2, n)
        By how much w differs about the middle one along x and y; 0 where that is not known.
    step : float
        Usual step between two readings of w; 0 where none is known.
    ends : ndarray of int
        Behind the last of every lag in a frame.
    """

    w: Array
    stretch: Array
    index: NDArray[np.int32]
    bend: Array
    variance: Array
    lean: Array
    step: float
    ends: NDArray[np.int64]

    @classmethod
    def of(cls, w: Image, p: Image, sectors: Sectors, step: Callable[[float], float]) -> Bends:
        """Those of an image of inverse depth, w (H, W), and its precision p, 0 for no reading.

        step: between two readings of w, at some w.
        """
        side = _SIDES[w.size < _SMALL]
        rows, columns = (n // side for n in w.shape)
        blocks = np.empty((2, rows, columns))
        kernels.block_readings(w, p, side, blocks)
        every = max(1, -(-_in_a_row(blocks[0] > 0) // _ENOUGH))
        room = _LAGS.size * (rows * -(-columns // every) + columns * -(-rows // every))
        index, ends = np.empty((3, room), np.int32), np.empty(_LAGS.size, np.int64)
        (bend, variance), lean = np.empty((2, room)), np.empty((2, room))
        kernels.blocks_in_a_row(blocks, _LAGS, every, _AROUND, index, bend, variance, lean, ends)
        n = int(ends[-1])
        x, y = (_of_blocks(each, (rows, columns), side) for each in sectors.coordinates)
        oblique = np.broadcast_to(sectors.stretch(x, y), (rows, columns))
        return cls(
            w=blocks[0].reshape(-1),
            stretch=oblique.reshape(-1),
            index=index[:, :n],
            bend=bend[:n],
            variance=variance[:n],
            lean=lean[:, :n],
            step=step(float(np.median(blocks[0, blocks[0] > 0]))) if n else 0.0,
            ends=ends,
        )

    @classmethod
    def together(cls, frames: Sequence[Bends]) -> Bends:
        """Those of several frames."""
        first = np.cumsum([0, *(each.w.size for each in frames)])
        before = np.cumsum([0, *(each.bend.size for each in frames)])
        return cls(
            w=np.concatenate([each.w for each in frames]),
            stretch=np.concatenate([each.stretch for each in frames]),
            index=np.concatenate(
                [each.index + start for each, start in zip(frames, first, strict=False)], axis=1
            ).astype(np.int32),
            bend=np.concatenate([each.bend for each in frames]),
            variance=np.concatenate([each.variance for each in frames]),
            lean=np.concatenate([each.lean for each in frames], axis=1),
            step=float(np.median([each.step for each in frames])),
            ends=np.concatenate(
                [each.ends + start for each, start in zip(frames, before, strict=False)]
            ),
        )

    def thinned(self, every: int) -> Bends:
        """One of so many, and the blocks that these are of."""
        used, index = np.unique(self.index[:, ::every], return_inverse=True)
        return Bends(
            w=self.w[used],
            stretch=self.stretch[used],
            index=index.reshape(3, -1).astype(np.int32),
            bend=self.bend[::every].copy(),
            variance=self.variance[::every].copy(),
            lean=self.lean[:, ::every].copy(),
            step=self.step,
            ends=-(-self.ends // every),
        )

    def coordinate(self, along: Along) -> tuple[Array, Array]:
        """u of the blocks, 0 where there is none, and r = dw/du."""
        if along == "disparity":
            return self.w, np.ones_like(self.w)
        z = np.divide(1.0, self.w, out=np.zeros_like(self.w), where=self.w > 0)
        if along == "depth":
            return z, -self.w * self.w
        return z * self.stretch, -self.w * self.w / self.stretch

    def of_blocks(self, error: Array) -> Array:
        """Bends of an error of w of the blocks."""
        a, b, c = self.index
        return np.asarray(2 * error[b] - error[a] - error[c])

    def usual(self, left: Array) -> Array:
        """Variance of bends by the median of what is left of them, of each lag in a frame."""
        out, first = np.empty(left.size), 0
        for end in self.ends.tolist():
            some = slice(first, end)
            square = left[some] ** 2 / self.variance[some]
            if square.size:
                usual = float(np.median(square)) / medians.OF_CHI2
                out[some] = max(usual, _TINY) * self.variance[some]
            first = end
        return out

    def weights(self, left: Array) -> Array:
        """Weights of bends by what is left of them: those across an edge hardly count."""
        usual = self.usual(left)
        small = 1.0 / (1.0 + left * left / (_WIDEST**2 * usual))
        return np.asarray(small * small / usual)

    def saved(self, before: Array, after: Array) -> tuple[float, float]:
        """By how much squares of what is left fell, those across an edge hardly counted.

        Of all bends; and of those on surfaces that lean across the ones that gain most, in the
        image: a relief such as that of stairs is on surfaces that lean alike, or against each
        other.
        """
        usual = self.usual(before)
        fell = np.zeros(before.size)
        for left, sign in ((before, 1.0), (after, -1.0)):
            square = left * left / usual
            fell += sign * square / (1.0 + square / _WIDEST**2)
        x, y = self.lean
        square = x * x + y * y
        leaning = square > _LEANING**2 * usual
        x, y, of = x[leaning], y[leaning], fell[leaning]
        twice = np.stack((x * x - y * y, 2 * x * y)) / square[leaning]  # of twice the angle
        return float(fell.sum()), float(of[(twice @ of) @ twice < 0].sum())


def _in_a_row(there: NDArray[np.bool_]) -> int:
    """How many times three blocks in a row have readings."""
    return sum(
        int(np.count_nonzero(each[: -2 * lag] & each[lag:-lag] & each[2 * lag :]))
        for lag in _LAGS.tolist()
        for each in (there, there.T)
    )


def _of_blocks(coordinate: Image, blocks: tuple[int, int], side: int) -> Image:
    """Coordinates of the middles of blocks, of an image or of one row or column of it."""
    rows, columns = (slice(side // 2, n * side, side) for n in blocks)
    if coordinate.shape[0] == 1:
        return coordinate[:, columns]
    return coordinate[rows] if coordinate.shape[1] == 1 else coordinate[rows, columns]
