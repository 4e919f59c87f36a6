"""Readers of datasets: frames with camera, picture and true planes, one at a time.

>>> from planewise import datasets
>>> datasets.KINDS[:4]
('nyu-labelled', 'sens', 'ros', 'ros-points')
"""

from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.frames import Dataset, DatasetFrame, Frames, PointDataset, PointFrame
from planewise.datasets.generic import GenericFolder
from planewise.datasets.hypersim import Hypersim
from planewise.datasets.icl_nuim import IclNuim, IclNuimRendered
from planewise.datasets.lidar import LidarFolder
from planewise.datasets.nyu import NyuFolder, NyuLabelled, open_nyu
from planewise.datasets.nyu_raw import NyuRaw
from planewise.datasets.opening import KINDS, open
from planewise.datasets.redwood import RedwoodFolder
from planewise.datasets.ros import RosDepth, RosPoints
from planewise.datasets.scannet import ScanNetFolder
from planewise.datasets.sens import SensFile
from planewise.datasets.seven_scenes import SevenScenes
from planewise.datasets.tum import TumSequence

__all__ = [
    "KINDS",
    "ArchiveFolder",
    "Dataset",
    "DatasetFrame",
    "Frames",
    "GenericFolder",
    "Hypersim",
    "IclNuim",
    "IclNuimRendered",
    "LidarFolder",
    "NyuFolder",
    "NyuLabelled",
    "NyuRaw",
    "PointDataset",
    "PointFrame",
    "RedwoodFolder",
    "RosDepth",
    "RosPoints",
    "ScanNetFolder",
    "SensFile",
    "SevenScenes",
    "TumSequence",
    "open",
    "open_nyu",
]
