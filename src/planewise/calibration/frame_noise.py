"""What one frame says about the error of its sensor: noise, by cells, and waves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planewise.calibration.cells import NoiseCells, noise_cells
from planewise.observation import RayObservation
from planewise.waves import Waves
from planewise.waves.bends import Bends
from planewise.waves.search import waves_of

_KEPT = 5  # one of so many bends is kept of one frame of many


class FrameNoise(NamedTuple):
    """What one frame says about the error of its sensor.

    Attributes
    ----------
    cells : NoiseCells
        Without the waves.
    waves : Waves, optional
        Of its sensor, or else those that it shows.
    bends : Bends, optional
        That tell of waves, where these were looked for.
    """

    cells: NoiseCells
    waves: Waves | None
    bends: Bends | None

    def thinned(self) -> FrameNoise:
        """The same with few bends, of which many frames together have enough."""
        return self if self.bends is None else self._replace(bends=self.bends.thinned(_KEPT))


def noise_of_frame(observation: RayObservation) -> FrameNoise:
    """What a frame says; range images of LiDARs show no waves."""
    waves, bends = observation.sensor.waves, None
    if waves is None and not observation.ranges:
        bends = _bends_of(observation.tame)
        waves = waves_of(bends)
    return FrameNoise(noise_cells(observation, waves), waves, bends)


def _bends_of(observation: RayObservation) -> Bends:
    """Bends of a frame whose noise is not known, as if it were the same at every depth."""
    image, sectors = observation.image, observation.camera.sectors(observation.shape)
    w, p = np.empty((2, *image.shape), np.float32)
    square = image.depth * image.depth
    image.spread(square * square, w, p)

    def step(inverse: float) -> float:
        z = 1.0 / inverse
        return float(np.interp(z, image.depth, image.steps())) / (z * z)

    return Bends.of(*sectors.spread(w, p), sectors, step)
