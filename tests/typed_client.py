"""What users write and type checkers see; `make types` checks it, nothing runs it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import planewise as pw
from planewise.noise import ErrorParts, RootSum


def halves(seen: pw.partition.View) -> NDArray[np.int64]:
    return np.arange(seen.depth.size).reshape(seen.depth.shape) // seen.depth.size


def of_numbers() -> pw.Sensor:
    parts = ErrorParts(white=0.01, shared=0.0, drift=RootSum((0.003, pw.noise.constant(0.004))))
    return pw.Sensor(noise=0.01, parts=parts)


def of_any_parameter(depth: NDArray[np.float64]) -> pw.PlaneModel:
    return pw.detect_planes(depth, pw.cameras.NYU, of_numbers(), partition=halves)


def of_no_such_name() -> object:
    return pw.detect_plane  # type: ignore[attr-defined]
