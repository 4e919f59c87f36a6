"""A frame without what is no noise: wild readings, and waves of the sensor's error."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planewise.information import coordinate_information
from planewise.kernels.waves import take_off
from planewise.observation import RayObservation
from planewise.runtime.workspace import Workspace
from planewise.spatial.frame import Frame, frame_of
from planewise.waves import Waves
from planewise.waves.bends import Bends
from planewise.waves.search import waves_of


def tame_frame(observation: RayObservation, workspace: Workspace | None = None) -> Frame:
    """Images of the readings that are not wild, without waves, and what both cost."""
    workspace = workspace or Workspace()
    frame = frame_of(observation.tame, workspace, wild_information(observation))
    waves = observation.sensor.waves
    # Where noise was measured, waves were looked for before it.
    if waves is None and not frame.measured and not observation.ranges:
        waves = waves_of(bends_of(frame))
    return frame if waves is None else without_waves(frame, waves, workspace)


def bends_of(frame: Frame) -> Bends:
    """How the readings of a frame are bent."""

    def step(w: float) -> float:
        return math.sqrt(12 * frame.table.at(w)[3])

    return Bends.of(frame.w, frame.p, frame.sectors, step)


def wild_information(observation: RayObservation) -> float:
    """Nats of wild readings: which they are, and depths that may be anything at all."""
    every, wild = observation.count, observation.count - observation.tame.count
    if not wild:
        return 0.0
    which = math.lgamma(every + 1) - math.lgamma(wild + 1) - math.lgamma(every - wild + 1)
    which += math.log(every)  # how many they are
    return which + wild * coordinate_information(observation.range, observation.resolution)


def without_waves(frame: Frame, waves: Waves, workspace: Workspace) -> Frame:
    """Take waves off inverse depth.

    That the error grows and shrinks along a wave squeezes and stretches the steps between readings,
    by as much: of Phi that is a second-order term.
    """
    sectors, w = frame.sectors, frame.w[frame.w > 0]
    if not w.size:
        return frame
    first, last, oblique = float(w.min()), float(w.max()), (0.0, 0.0)
    inverse = waves.along == "disparity"
    if not inverse:
        first, last = 1 / last, 1 / first
    if waves.along == "range":
        oblique = sectors.slants
        if sectors.ratio is None:
            last *= float(sectors.stretch(*sectors.coordinates).max())
        else:  # the depth of the table is range
            last = frame.table.step.size / frame.table.ranging[0]
    read, error = waves.table(first, last)
    ranging = (read.size - 1) / (read[-1] - first), *oblique
    right = workspace.kept(frame.w.shape, np.float32)
    take_off(frame.w, *sectors.coordinates, inverse, ranging, first, error, right)
    # Period, amplitude and phase, each half a logarithm of the readings.
    nats = 1.5 * len(waves.parts) * math.log(np.count_nonzero(frame.p))
    return replace(frame, w=right, waves=waves, wild=frame.wild + nats)
